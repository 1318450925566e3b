//! PLY meshes: text and binary of both orders of bytes give the same mesh, and damaged ones an error.

use std::path::Path;

use render::Scene;
use render::math::Transform;
use render::scene::LoadOptions;
use render::shape::{Mesh, ObjOptions, Shape};

#[derive(Clone, Copy, PartialEq, Debug)]
enum Encoding {
    Text,
    Little,
    Big,
}

const ENCODINGS: [Encoding; 3] = [Encoding::Text, Encoding::Little, Encoding::Big];

/// A file, and how it is encoded.
struct Writer {
    encoding: Encoding,
    bytes: Vec<u8>,
}

impl Writer {
    fn new(encoding: Encoding, header: &str) -> Self {
        let format = match encoding {
            Encoding::Text => "ascii",
            Encoding::Little => "binary_little_endian",
            Encoding::Big => "binary_big_endian",
        };
        let text = format!("ply\nformat {format} 1.0\ncomment made by code\n{header}end_header\n");
        let bytes = text.into_bytes();
        Self { encoding, bytes }
    }

    fn float(mut self, x: f32) -> Self {
        match self.encoding {
            Encoding::Text => self.bytes.extend(format!("{x} ").bytes()),
            Encoding::Little => self.bytes.extend(x.to_le_bytes()),
            Encoding::Big => self.bytes.extend(x.to_be_bytes()),
        }
        self
    }

    fn int(mut self, x: i32) -> Self {
        match self.encoding {
            Encoding::Text => self.bytes.extend(format!("{x} ").bytes()),
            Encoding::Little => self.bytes.extend(x.to_le_bytes()),
            Encoding::Big => self.bytes.extend(x.to_be_bytes()),
        }
        self
    }

    fn byte(mut self, x: u8) -> Self {
        match self.encoding {
            Encoding::Text => self.bytes.extend(format!("{x} ").bytes()),
            _ => self.bytes.push(x),
        }
        self
    }

    fn end(mut self) -> Self {
        if self.encoding == Encoding::Text {
            self.bytes.push(b'\n');
        }
        self
    }

    fn face(mut self, indices: &[i32]) -> Self {
        self = self.byte(indices.len() as u8);
        for &i in indices {
            self = self.int(i);
        }
        self.end()
    }
}

const POSITIONS: &str = "property float x\nproperty float y\nproperty float z\n";
const FACES: &str = "property list uchar int vertex_indices\n";
const SQUARE: [[f32; 3]; 4] = [
    [0.0, 0.0, 0.5],
    [1.0, 0.0, 0.5],
    [1.0, 1.0, 0.5],
    [0.0, 1.0, 0.5],
];

/// A square with colours, normals, surface coordinates and an element of no use.
fn square(encoding: Encoding) -> Vec<u8> {
    let header = format!(
        "element vertex 4\n{POSITIONS}property uchar red\nproperty float nx\nproperty float ny\nproperty float nz\n\
         property float s\nproperty float t\nelement camera 1\nproperty float focus\nelement face 1\n{FACES}"
    );
    let mut w = Writer::new(encoding, &header);
    for p in SQUARE {
        w = w.float(p[0]).float(p[1]).float(p[2]).byte(200);
        w = w
            .float(0.0)
            .float(0.0)
            .float(2.0)
            .float(p[0])
            .float(0.25 * p[1])
            .end();
    }
    w.float(3.5).end().face(&[0, 1, 2, 3]).bytes
}

fn read(bytes: &[u8], options: &ObjOptions) -> Result<(Mesh, Vec<String>), String> {
    Mesh::from_ply_bytes(bytes, Path::new("m.ply"), options).map_err(|e| e.to_string())
}

fn plain() -> ObjOptions {
    ObjOptions {
        flip_v: false,
        ..ObjOptions::default()
    }
}

#[test]
fn every_encoding_gives_the_same_mesh() {
    for encoding in ENCODINGS {
        let (mesh, ignored) = read(&square(encoding), &plain()).unwrap();
        let data = mesh.data();
        assert_eq!(data.positions, SQUARE);
        assert_eq!(data.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(data.normals, [[0.0, 0.0, 1.0]; 4]);
        assert_eq!(data.uvs, SQUARE.map(|p| [p[0], 0.25 * p[1]]));
        assert_eq!(ignored, ["vertex.red", "camera.focus"]);
        assert!((mesh.area() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn options_and_transforms_are_those_of_obj_files() {
    let bytes = square(Encoding::Little);
    let flipped = ObjOptions::default();
    let uvs = read(&bytes, &flipped).unwrap().0.data().uvs.clone();
    assert_eq!(uvs, SQUARE.map(|p| [p[0], 1.0 - 0.25 * p[1]]));
    let flat = ObjOptions {
        face_normals: true,
        ..plain()
    };
    assert!(read(&bytes, &flat).unwrap().0.data().normals.is_empty());
    let mirrored = ObjOptions {
        to_world: Transform::scale([-2.0, 1.0, 1.0]),
        ..plain()
    };
    let (mesh, _) = read(&bytes, &mirrored).unwrap();
    assert_eq!(mesh.data().positions[1], [-2.0, 0.0, 0.5]);
    // What is outside stays outside.
    assert_eq!(mesh.data().normals, [[0.0, 0.0, 1.0]; 4]);
}

/// Two triangles that share an edge, faces before vertices, indices of another type and in double precision.
#[test]
fn types_and_orders_are_free_and_missing_normals_are_smooth() {
    let text = "ply\r\nformat ascii 1.0\r\nelement face 2\r\nproperty list int ushort vertex_index\r\nelement vertex 4\r\n\
        property double z\r\nproperty double y\r\nproperty double x\r\nend_header\r\n3 0 1 2\r\n3 0 2 3\r\n0 0 0\r\n0 0 1\r\n0 1 1\r\n1 1 0\r\n";
    let (mesh, ignored) = read(text.as_bytes(), &plain()).unwrap();
    assert!(ignored.is_empty());
    let data = mesh.data();
    assert_eq!(
        data.positions,
        [[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 1.0]]
    );
    assert_eq!(data.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(data.normals.len(), 4);
    assert_eq!(data.normals[1], [0.0, 0.0, 1.0]);
    assert!(data.normals[0][2] > 0.5 && data.normals[0] != data.normals[1]);
    assert!(data.uvs.is_empty());
}

#[test]
fn what_is_wrong_is_said_with_its_line() {
    let header = format!(
        "ply\nformat ascii 1.0\nelement vertex 3\n{POSITIONS}element face 1\n{FACES}end_header\n"
    );
    let body = "0 0 0\n1 0 0\n0 1 0\n";
    let file = |rest: &str| format!("{header}{rest}");
    for (text, expected) in [
        (
            "obj".to_owned(),
            "m.ply: expected a PLY file, which starts with `ply`",
        ),
        (
            "ply\nformat ascii 1.0\n".to_owned(),
            "m.ply: expected `end_header` within 65536 bytes, found none",
        ),
        (
            "ply\nformat ascii 1.0\nelement vertex x\nend_header\n".to_owned(),
            "m.ply:3: expected a well-formed header, found `element vertex x`",
        ),
        (
            "ply\nformat ascii 1.0\nelement face 0\nend_header\n".to_owned(),
            "expected the element `vertex`, found `face`",
        ),
        (
            header.replace("element face", "element tristrips"),
            "m.ply: expected the element `face`, found `vertex`, `tristrips`",
        ),
        (
            header.replace("float z", "float w"),
            "expected vertices with `x`, `y` and `z`, found `x, y, w`",
        ),
        (
            header.replace("vertex_indices", "corners"),
            "expected faces with `vertex_index` or `vertex_indices`, found `corners`",
        ),
        (
            format!(
                "{}{body}3 0 1 2\n",
                header.replace("uchar int", "uchar float")
            ),
            "m.ply:13: expected indices of vertices that are whole numbers, found others",
        ),
        (
            header.replace("vertex 3", "vertex 99999999999999"),
            "expected 99999999999999 of `vertex`, found 0 bytes",
        ),
        (
            file("0 0 0\n1 0 0\n0 1\n3 0 1 2\n"),
            "m.ply:12: expected a number for `z` of `vertex` 3 of 3, found the end of the line",
        ),
        (
            file("0 0 0\n1 0 x\n0 1 0\n3 0 1 2\n"),
            "m.ply:11: expected a number for `z` of `vertex` 2 of 3, found `x`",
        ),
        (
            file("0 0 0\n1 0 0 0\n0 1 0\n3 0 1 2\n"),
            "m.ply:11: expected the end of the line behind `vertex` 2 of 3, found `0`",
        ),
        (
            file(&format!("{body}3 0 1 2.5\n")),
            "m.ply:13: expected a whole number from -2147483648 to 2147483647 for `vertex_indices` of `face` 1 of 1, found `2.5`",
        ),
        (
            file("0 0 0\n1 0 0\n\n \n"),
            "m.ply: expected `vertex` 3 of 3, found the end of the file",
        ),
        (file("0 0 nan\n1 0 0\n0 1 0\n3 0 1 2\n"), "m.ply"),
        (file(body), "expected 1 of `face`, found 0 bytes"),
        (
            file(&format!("{body}2 0 1\n")),
            "m.ply:13: expected at least three vertices of face 0, found 2",
        ),
        (
            file(&format!("{body}3 0 1 -2\n")),
            "m.ply:13: expected indices of vertices, found -2",
        ),
        (
            file(&format!("{body}3 0 1 3\n")),
            "m.ply: expected indices of vertices below 3, found [0, 1, 3]",
        ),
        (file(&format!("{body}3 0 1 1\n")), "only degenerate ones"),
        (file("0 0 0\n1 0 0\n0 1e39 0\n3 0 1 2\n"), "m.ply"),
    ] {
        let found = read(text.as_bytes(), &plain()).err();
        let found = found.unwrap_or_else(|| panic!("accepted: {text}"));
        assert!(found.contains(expected), "{found}\nnot {expected}");
    }
}

#[test]
fn text_gives_the_bits_of_binary() {
    let header = format!("element vertex 3\n{POSITIONS}element face 1\n{FACES}");
    let moved = ObjOptions {
        to_world: Transform::scale([1.7, 0.3, 2.9]).then(&Transform::translate([0.1, 0.7, -0.3])),
        ..plain()
    };
    let [text, binary, _] = ENCODINGS.map(|encoding| {
        let mut w = Writer::new(encoding, &header);
        for i in 0..3 {
            let x = 0.1 + i as f32 / 3.0;
            w = w.float(x).float(x * x * 7.3).float(1e-3 / x).end();
        }
        let bytes = w.face(&[0, 1, 2]).bytes;
        read(&bytes, &moved).unwrap().0.data().positions.clone()
    });
    assert_eq!(text, binary);
}

/// As C and C++ print them, and with lines between them.
#[test]
fn numbers_in_text_are_those_of_other_programs() {
    let file = |lines: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 4\n{POSITIONS}element face 1\n{FACES}end_header\n{lines}"
        )
    };
    let plainly = file("0 0 0.5\n1 0 0.5\n1 1 0.5\n0 1 0.5\n4 0 1 2 3\n");
    let (expected, _) = read(plainly.as_bytes(), &plain()).unwrap();
    for lines in [
        "0. -0 .5\n+1 0 5e-1\n1.000000e+00 1E0 0.5\n0 1 0.5\n4 0 1 2 3\n",
        "\n0 0 0.5\n\n\n  1\t0   0.5 \n1 1 0.5\n \n0 1 0.5\n\n4 0 1 2 3",
        "0 0 0.5\r\n1 0 0.5\r\n1 1 0.5\r\n0 1 0.5\r\n4 0 1 2 3\r\n\r\n",
    ] {
        let (found, _) = read(file(lines).as_bytes(), &plain()).unwrap();
        assert_eq!(
            found.data().positions,
            expected.data().positions,
            "{lines:?}"
        );
        assert_eq!(found.data().triangles, expected.data().triangles);
    }
}

/// Normals that are no numbers, of degenerate faces, are those of the faces: in text as in binary.
#[test]
fn normals_that_are_no_numbers_are_made_anew() {
    let normals = "property float nx\nproperty float ny\nproperty float nz\n";
    let header = format!("element vertex 3\n{POSITIONS}{normals}element face 1\n{FACES}");
    let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
    let mut binary = Writer::new(Encoding::Little, &header);
    for [x, y] in corners {
        binary = binary.float(x).float(y).float(0.5);
        binary = binary.float(f32::NAN).float(f32::NAN).float(f32::NAN);
    }
    let binary = binary.face(&[0, 1, 2]).bytes;
    let (expected, _) = read(&binary, &plain()).unwrap();
    for nan in ["nan", "-nan", "NaN", "-nan(ind)", "NAN"] {
        let mut text = format!("ply\nformat ascii 1.0\n{header}end_header\n");
        for [x, y] in corners {
            text += &format!("{x} {y} 0.5 {nan} {nan} {nan}\n");
        }
        let (found, _) = read(format!("{text}3 0 1 2\n").as_bytes(), &plain()).unwrap();
        assert_eq!(found.data().normals, expected.data().normals, "{nan}");
    }
    let finite = |n: &[f32; 3]| n.iter().all(|x| x.is_finite());
    assert!(expected.data().normals.iter().all(finite));
}

/// Also those that would be elements without a byte, of which any number would fit.
#[test]
fn files_cut_off_or_damaged_are_errors_or_meshes() {
    for encoding in ENCODINGS {
        let whole = square(encoding);
        let needed = whole.len() - usize::from(encoding == Encoding::Text) * 2;
        for n in 0..needed {
            assert!(
                read(&whole[..n], &plain()).is_err(),
                "{encoding:?} cut at {n}"
            );
        }
        for n in 0..whole.len() {
            for byte in [0, b'9', 0xff] {
                let mut damaged = whole.clone();
                damaged[n] = byte;
                let _ = read(&damaged, &plain());
            }
        }
    }
    let empty = "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        element nothing 4000000000\nelement face 1\nproperty list uchar int vertex_index\nend_header\n";
    let bytes = [empty.as_bytes(), &[0; 64]].concat();
    let found = read(&bytes, &plain()).unwrap_err();
    assert!(found.contains("of `nothing`"), "{found}");
}

#[test]
fn scenes_load_them_and_warn_of_what_is_left_out() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("a.ply"), square(Encoding::Big)).unwrap();
    let text = "<scene version=\"3.0.0\"><sensor type=\"perspective\"><float name=\"fov\" value=\"40\"/></sensor>
        <shape type=\"ply\"><string name=\"filename\" value=\"a.ply\"/><boolean name=\"face_normals\" value=\"true\"/>
        <emitter type=\"area\"/></shape></scene>";
    let (scene, warnings) = Scene::from_xml(text, dir.path(), &LoadOptions::default()).unwrap();
    assert_eq!(scene.shapes().len(), 1);
    assert_eq!(warnings.len(), 1);
    assert!(
        warnings[0].ends_with("a.ply: `vertex.red, camera.focus` have no effect"),
        "{warnings:?}"
    );
    let missing = text.replace("a.ply", "b.ply");
    let found = Scene::from_xml(&missing, dir.path(), &LoadOptions::default()).unwrap_err();
    assert!(
        found
            .to_string()
            .contains("`filename`: expected an existing file"),
        "{found}"
    );
}
