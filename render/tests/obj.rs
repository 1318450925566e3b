//! Meshes from arrays and from OBJ files.

use std::path::Path;

use proptest::prelude::*;
use render::SceneError;
use render::accel::Accel;
use render::math::Transform;
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::shape::{Mesh, MeshData, ObjOptions, Shape};

use crate::common::{
    self,
    shapes::{assert_near, bent_mesh, interact, vec3},
};

fn obj(text: &str) -> Result<Mesh, SceneError> {
    obj_with(text, &ObjOptions::default())
}

fn obj_with(text: &str, options: &ObjOptions) -> Result<Mesh, SceneError> {
    Mesh::from_obj_text(text.as_bytes(), Path::new("m.obj"), options).map(|(mesh, _)| mesh)
}

const QUAD: &str = "# a square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

/// What is no face is said, once for each kind, with its first line; what only groups faces is not.
#[test]
fn what_an_obj_file_has_besides_faces_is_said() {
    let text = format!(
        "mtllib a.mtl\no square\n{QUAD}s 1\ng all\nusemtl white\nl 1 2\nf 1 2 3 4\nl 3 4\np 1\ncurv 0 1 1 2\nweather fine\n"
    );
    let read = |text: &[u8]| Mesh::from_obj_text(text, Path::new("m.obj"), &ObjOptions::default());
    let (mesh, skipped) = read(text.as_bytes()).unwrap();
    assert_eq!(mesh.data().triangles.len(), 2);
    let expected = ["11: `l`", "14: `p`", "15: `curv`", "16: `weather`"];
    let expected = expected.map(|what| format!("m.obj:{what} has no effect"));
    assert_eq!(skipped, expected);
    assert!(
        read(format!("{QUAD}f 1 2 3 4\n").as_bytes())
            .unwrap()
            .1
            .is_empty()
    );
    // Nothing but such.
    let error = read(format!("{QUAD}l 1 2\n").as_bytes())
        .unwrap_err()
        .to_string();
    assert!(
        error.ends_with("expected at least one face, found none, but `l` in line 6"),
        "{error}"
    );
    let wide: Vec<u8> = [0xfeff]
        .into_iter()
        .chain(QUAD.encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    let error = read(&wide).unwrap_err().to_string();
    assert!(
        error.ends_with("m.obj:1: expected text in UTF-8, found UTF-16"),
        "{error}"
    );
    // However many kinds there are.
    let many: String = (0..1000).map(|i| format!("word{i}\n")).collect();
    assert!(
        read(format!("{QUAD}f 1 2 3\n{many}").as_bytes())
            .unwrap()
            .1
            .len()
            < 100
    );
}

#[test]
fn obj_polygons_become_fans() {
    let mesh = obj(&format!("{QUAD}f 1 2 3 4\n")).unwrap();
    assert_eq!(mesh.data().triangles, [[0, 1, 2], [0, 2, 3]]);
    assert!((mesh.area() - 1.0).abs() < 1e-12);
    // Relative indices, line ends, groups and materials.
    let text = format!(
        "{QUAD}mtllib a.mtl\r\ng one\r\nusemtl red\r\nf -4 -3 -2\r\no two\ns 1\nf -4 -2 -1"
    );
    let mesh = obj(&text).unwrap();
    assert_eq!(mesh.data().triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(mesh.data().positions.len(), 4, "groups share vertices");
}

/// What other programs write: marks, comments, colours, continued lines, line ends of any kind.
#[test]
fn obj_lines_are_read_as_they_are_written() {
    let plain = obj("v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n").unwrap();
    for text in [
        "\u{feff}v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4",
        "v -1 -1 0\nv 1 -1 0#\nv 1 1 0 # corner 3 \\\nv -1 1 0\nf 1 2 3 4# nan\n",
        "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 \\\n3 4\n",
        "v -1 -1 0\r\nv 1 \\ \r\n-1 \\\r\n0\r\nv 1 1 0\r\nv -1 1 0\r\nf 1 2 3 4\\",
        "v -1 -1 0\rv 1 -1 0\rv 1 1 0\rv -1 1 0\rf 1 2 3 4",
        "v -1 -1 0\nv 1 -1 0\nv 1 1 0 1 0 0\nv -1 1 0\nf 1 2 3 4\n",
        "v -1 -1 0\nv 2 -2 0 2\nv 1 1 0\nv -1 1 0 1 0 0.5\nf 1 2 3 4\n",
    ] {
        let mesh = obj(text).unwrap_or_else(|e| panic!("{text}: {e}"));
        assert_eq!(mesh.data().positions, plain.data().positions, "{text}");
        assert_eq!(mesh.data().triangles, plain.data().triangles, "{text}");
    }
    for (line, message) in [
        (
            "v 0 0 0 1 1",
            "m.obj:7: expected `v` with three numbers, alone or with a weight",
        ),
        (
            "v 0 0 0 0",
            "m.obj:7: expected a weight other than zero, found `0`",
        ),
        (
            "v 0 0 1e39",
            "m.obj:7: expected a finite number, found `1e39`",
        ),
        (
            "vn nan 0 1",
            "m.obj:7: expected a finite number, found `nan`",
        ),
        ("vt 0.5", "m.obj:7: expected `vt` with two or three numbers"),
        (
            "f 1 \\\n2 \\\n9",
            "m.obj:7: expected the index of an earlier line, found `9`",
        ),
    ] {
        let found = obj(&format!("{QUAD}# comment \\\n{line}\nf 1 2 3")).unwrap_err();
        assert!(found.to_string().starts_with(message), "{found}");
    }
    let long = obj(&format!("{QUAD}f 1 2 {}", "x".repeat(1 << 20))).unwrap_err();
    assert!(long.to_string().len() < 300, "{long}");
}

#[test]
fn devices_are_no_obj_files() {
    if cfg!(unix) {
        let found = Mesh::from_obj(Path::new("/dev/zero"), &ObjOptions::default()).unwrap_err();
        let found = found.to_string();
        assert_eq!(found, "/dev/zero: expected a regular file, found a device");
    }
}

/// What is written is read as the same mesh, to the last bit: with and without normals and texture coordinates, where some
/// faces are flat, turned around or not.
#[test]
fn obj_files_are_written_as_they_are_read() {
    let corners = "v 1e-30 -1 0.1\nv 1 0.33333334 16777216\nv 0.7 1 -0\nv -1 1 3e9\n";
    let more = "vt 0.25 0.1\nvt 1.7 -0.3\nvn 0 0.6 0.8\nvn 0 0 2\n";
    for faces in [
        "f 1 2 3 4\n",
        "f 4/1 2/2 3/1\n",
        "f 1//1 2//2 3//1\n",
        "f 1/1/1 2/2/2 3/1/2\nf 1/2/2 3/2/2 4/1/2\nf 2/1 1/1 4/2\n",
    ] {
        for flip_v in [true, false] {
            let options = ObjOptions {
                flip_v,
                ..Default::default()
            };
            let mesh = obj_with(&format!("{corners}{more}{faces}"), &options).unwrap();
            let text = mesh.to_obj(flip_v);
            let options = ObjOptions {
                face_normals: mesh.data().normals.is_empty(),
                ..options
            };
            let again = obj_with(&text, &options).unwrap_or_else(|e| panic!("{text}: {e}"));
            let (a, b) = (mesh.data(), again.data());
            assert_eq!((&a.positions, &a.uvs), (&b.positions, &b.uvs), "{text}");
            assert_eq!((&a.normals, &a.triangles), (&b.normals, &b.triangles));
            assert_eq!(again.to_obj(flip_v), text);
        }
    }
    // Normals that nobody has given are those that whoever reads the file makes.
    let smooth = obj(&format!("{corners}f 1 2 3\n")).unwrap();
    assert!(!smooth.data().normals.is_empty() && !smooth.to_obj(true).contains("vn"));
}

#[test]
fn obj_normals_and_coordinates_are_those_of_mitsuba() {
    let text = format!(
        "{QUAD}vt 0.25 0.1\nvt 1 0\nvn 0 0.6 0.8\nvn 0 0 2\nf 1/1/1 2/2/2 3/2/2\nf 1/2/2 3/2/2 4/1/2\n"
    );
    let mesh = obj(&text).unwrap();
    // Vertex 1 occurs with two normals.
    assert_eq!(mesh.data().positions.len(), 5);
    assert_eq!(mesh.data().uvs[0], [0.25, 0.9]);
    assert_eq!(mesh.data().normals[0], [0.0, 0.6, 0.8]);
    let unflipped = obj_with(
        &text,
        &ObjOptions {
            flip_v: false,
            ..Default::default()
        },
    )
    .unwrap();
    assert_eq!(unflipped.data().uvs[0], [0.25, 0.1]);
    let flat = obj_with(
        &text,
        &ObjOptions {
            face_normals: true,
            ..Default::default()
        },
    )
    .unwrap();
    assert!(flat.data().normals.is_empty());
    let si = interact(&flat.into(), [0.7, 0.2, 1.0], [0.0, 0.0, -1.0]);
    assert_near(si.frame.n, [0.0, 0.0, 1.0]);
    // Half way between the normals of vertices 1 and 2.
    let si = interact(&mesh.into(), [0.5, 1e-4, 1.0], [0.0, 0.0, -1.0]);
    let middle = (vec3([0.0, 0.6, 0.8]) + vec3([0.0, 0.0, 1.0])).normalize();
    assert!((si.frame.n - middle).length() < 1e-3);
}

#[test]
fn obj_transforms_keep_normals_perpendicular() {
    let text = "v 0 0 0\nv 1 0 1\nv 0 1 0\nvn -1 0 1\nf 1//1 2//1 3//1\n";
    for scale in [[2.0, 1.0, 1.0], [-2.0, 1.0, 1.0]] {
        let to_world = Transform::scale(scale);
        let mesh = obj_with(
            text,
            &ObjOptions {
                to_world,
                ..Default::default()
            },
        )
        .unwrap();
        let n = vec3(mesh.data().normals[0].map(f64::from));
        assert!(n.dot(vec3(to_world.vector([1.0, 0.0, 1.0]))).abs() < 1e-6);
        assert!(n.z > 0.0);
    }
}

/// Without normals in the file, those of a tetrahedron's corners point away from its centre: all
/// angles are equal there.
#[test]
fn missing_normals_are_made() {
    let text = "v 1 1 1\nv 1 -1 -1\nv -1 1 -1\nv -1 -1 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n";
    let mesh = obj(text).unwrap();
    let m = mesh.data();
    for (p, n) in m.positions.iter().zip(&m.normals) {
        let (p, n) = (vec3(p.map(f64::from)).normalize(), vec3(n.map(f64::from)));
        assert!((p - n).length() < 1e-6 || (p + n).length() < 1e-6);
    }
    // Angles count, not areas or the number of triangles: a right angle split unevenly.
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0.1 0 1\nv 0 0 1\nf 1 2 3\nf 1 5 4\nf 1 4 2\n";
    let n = obj(text).unwrap().data().normals[0];
    assert_near(vec3(n.map(f64::from)), [0.0, 0.5f64.sqrt(), 0.5f64.sqrt()]);
}

#[test]
fn faces_with_and_without_coordinates_may_be_mixed() {
    let text =
        format!("{QUAD}vt 0 1\nvt 1 1\nvn 0 0 1\nf 1/1 2/2 3/2\nf 1//1 3//1 4//1\nf 1/1 2/2 3/1\n");
    let mesh = obj(&text).unwrap();
    let m = mesh.data();
    assert_eq!(m.triangles.len(), 3);
    assert_eq!(
        (m.uvs.len(), m.normals.len()),
        (m.positions.len(), m.positions.len())
    );
    // Where normals are missing, the triangle's own counts.
    let si = interact(&mesh.into(), [0.6, 0.2, 1.0], [0.0, 0.0, -1.0]);
    assert_near(si.frame.n, [0.0, 0.0, 1.0]);
}

#[test]
fn broken_meshes_name_the_line() {
    let quad = |rest: &str| format!("{QUAD}{rest}");
    let cases = [
        (String::new(), "face"),
        (QUAD.to_owned(), "face"),
        ("v 0 0 x\nf 1 1 1".to_owned(), "m.obj:1"),
        ("v 0 0\nf 1 1 1".to_owned(), "m.obj:1"),
        ("v 0 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3".to_owned(), "m.obj:1"),
        (
            "v 0 1e39 0\nv 1 0 0\nv 0 1 0\nf 1 2 3".to_owned(),
            "m.obj:1",
        ),
        (quad("f 1 2 5"), "m.obj:6"),
        (quad("f 1 2 0"), "m.obj:6"),
        (quad("f 1 2 -5"), "m.obj:6"),
        (quad("f 1 2"), "m.obj:6"),
        (quad("f 1 2 3/1"), "m.obj:6"),
        (quad("vt 0 0\nf 1/1 2 3/1"), "m.obj:7"),
        (quad("f 1 2 99999999999999999999"), "m.obj:6"),
        (quad("f 1 2 9223372036854775807"), "m.obj:6"),
        (quad("f 1//1 2//1 3//1"), "m.obj:6"),
        (quad("vn 0 0\nf 1//1 2//1 3//1"), "m.obj:6"),
        (quad("f 1 1 2\nf 2 2 3"), "degenerate"),
        (quad("f 1/ 2/ 3/ x"), "m.obj:6"),
    ];
    for (text, mention) in cases {
        let message = match obj(&text) {
            Ok(_) => panic!("{text:?} was accepted"),
            Err(e) => e.to_string(),
        };
        assert!(
            message.contains("m.obj") && message.contains(mention),
            "{text:?}: {message}"
        );
    }
    let missing = Mesh::from_obj(Path::new("/nowhere/m.obj"), &ObjOptions::default()).unwrap_err();
    assert!(matches!(missing, SceneError::Io { .. }));
    // A degenerate triangle among others is kept, and never chosen.
    let mesh = obj(&quad("f 1 1 2\nf 1 2 3\nf 2 2 3")).unwrap();
    assert_eq!(mesh.data().triangles.len(), 3);
    for i in 0..1000 {
        let s = mesh.sample_area::<f64>(&Theta::still(), Independent::new(8, 0, i).next_2d());
        assert!(s.p.x >= s.p.y && s.p.z == 0.0);
    }
}

#[test]
fn arrays_are_checked() {
    let good = bent_mesh().data().clone();
    let refused = |change: &dyn Fn(&mut MeshData)| {
        let mut data = good.clone();
        change(&mut data);
        Mesh::new(data, false).unwrap_err().to_string()
    };
    assert!(refused(&|d| d.triangles.clear()).contains("triangle"));
    assert!(refused(&|d| d.triangles[1][2] = 4).contains("below 4"));
    assert!(refused(&|d| d.normals.truncate(3)).contains("normals"));
    assert!(refused(&|d| d.uvs.truncate(3)).contains("uvs"));
    assert!(refused(&|d| d.positions[2][1] = f32::NAN).contains("vertex 2"));
    assert!(refused(&|d| d.positions[2][1] = f32::INFINITY).contains("vertex 2"));
    assert!(refused(&|d| d.normals[2][1] = f32::NAN).contains("normals"));
    assert!(refused(&|d| d.uvs[2][1] = f32::NAN).contains("uvs"));
    assert!(refused(&|d| d.positions.fill([1.0; 3])).contains("degenerate"));
}

/// Smooth normals against the winding turn the geometric normal, which emission does not go by.
#[test]
fn the_shading_normal_decides_the_side() {
    let text = format!("{QUAD}vn 0 0 -1\nf 1//1 2//1 3//1\n");
    let si = interact(
        &obj(&text).unwrap().into(),
        [0.7, 0.2, 1.0],
        [0.0, 0.0, -1.0],
    );
    assert_near(si.frame.n, [0.0, 0.0, -1.0]);
    assert_near(si.n_geo, [0.0, 0.0, -1.0]);
}

#[test]
fn shared_meshes_load() {
    let Some(shared) = common::shared_dir() else {
        return;
    };
    for path in common::files_below(&shared, "obj") {
        let (mesh, _) = Mesh::from_obj(&path, &ObjOptions::default()).unwrap();
        assert!(
            mesh.area() > 0.0 && mesh.memory_bytes() > 0,
            "{}",
            path.display()
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(9), cases: 2000, ..ProptestConfig::default() })]

    /// Whatever happens to the bytes of a file: a mesh or an error, and no mesh with numbers that are
    /// not.
    #[test]
    fn damaged_files_never_panic(edits in prop::collection::vec((0usize..200, any::<u8>(), 0u8..4), 1..12)) {
        let mut bytes = format!("{QUAD}vt 0 1\nvt 1 1\nvn 0 0 1\ng a\nf 1/1/1 2/2/1 3/2/1\nf -4//1 -2//1 -1//1\nf 1 2 3 4\n").into_bytes();
        for (at, byte, kind) in edits {
            if bytes.is_empty() {
                break;
            }
            let at = at % bytes.len();
            match kind {
                0 => bytes[at] = byte,
                1 => bytes.insert(at, b"0123456789-/.e\n "[usize::from(byte) % 16]),
                2 => drop(bytes.remove(at)),
                _ => bytes.truncate(at),
            }
        }
        if let Ok((mesh, _)) = Mesh::from_obj_text(&bytes, Path::new("m.obj"), &ObjOptions::default()) {
            let m = mesh.data();
            prop_assert!(mesh.area() > 0.0);
            prop_assert!(m.positions.as_flattened().iter().all(|x| x.is_finite()));
            prop_assert!(m.normals.as_flattened().iter().all(|x| x.is_finite()));
            prop_assert!(Accel::build(&mesh.primitives()).is_ok());
            prop_assert!(mesh.sample_area::<f32>(&Theta::still(), [0.3, 0.7]).p.is_finite());
        }
    }
}
