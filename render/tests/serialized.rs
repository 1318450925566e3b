//! Mitsuba's compressed meshes: every version and precision gives the same mesh, and damaged ones an error.

use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use render::Scene;
use render::scene::LoadOptions;
use render::shape::{Mesh, ObjOptions};

const SQUARE: [[f64; 3]; 4] = [
    [0.0, 0.0, 0.5],
    [1.0, 0.0, 0.5],
    [1.0, 1.0, 0.5],
    [0.0, 1.0, 0.5],
];

/// What a mesh is written with.
#[derive(Clone, Copy)]
struct Style {
    version: u16,
    double: bool,
    normals: bool,
    uvs: bool,
    colours: bool,
    flat: bool,
}

const FULL: Style = Style {
    version: 4,
    double: false,
    normals: true,
    uvs: true,
    colours: true,
    flat: false,
};

/// One mesh: a square at this height.
fn mesh(style: Style, height: f64, triangles: &[[u32; 3]]) -> Vec<u8> {
    let flag = |set: bool, flag: u32| if set { flag } else { 0 };
    let flags = flag(style.normals, 1)
        | flag(style.uvs, 2)
        | flag(style.colours, 8)
        | flag(style.flat, 16)
        | if style.double { 0x2000 } else { 0x1000 };
    let mut body = flags.to_le_bytes().to_vec();
    if style.version == 4 {
        body.extend(b"square\0");
    }
    body.extend(4u64.to_le_bytes());
    body.extend((triangles.len() as u64).to_le_bytes());
    let mut float = |x: f64| {
        if style.double {
            body.extend(x.to_le_bytes())
        } else {
            body.extend((x as f32).to_le_bytes())
        }
    };
    SQUARE
        .map(|[x, y, _]| [x, y, height])
        .as_flattened()
        .iter()
        .for_each(|&x| float(x));
    if style.normals {
        (0..4).for_each(|_| [0.0, 0.0, 2.0].into_iter().for_each(&mut float));
    }
    if style.uvs {
        SQUARE
            .iter()
            .for_each(|p| [p[0], 0.25 * p[1]].into_iter().for_each(&mut float));
    }
    if style.colours {
        (0..12).for_each(|_| float(0.5));
    }
    body.extend(
        triangles
            .as_flattened()
            .iter()
            .flat_map(|i| i.to_le_bytes()),
    );
    let head = [0x041c_u16, style.version].map(u16::to_le_bytes).concat();
    let mut encoder = ZlibEncoder::new(head, Compression::default());
    encoder.write_all(&body).unwrap();
    encoder.finish().unwrap()
}

/// A file of these meshes.
fn file(version: u16, meshes: &[Vec<u8>]) -> Vec<u8> {
    let (mut bytes, mut table) = (Vec::new(), Vec::new());
    for mesh in meshes {
        match version {
            4 => table.extend((bytes.len() as u64).to_le_bytes()),
            _ => table.extend((bytes.len() as u32).to_le_bytes()),
        }
        bytes.extend(mesh);
    }
    bytes.extend(table);
    bytes.extend((meshes.len() as u32).to_le_bytes());
    bytes
}

const FACES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

fn read(bytes: &[u8], index: usize, face_normals: bool) -> Result<(Mesh, bool), String> {
    let options = ObjOptions {
        flip_v: false,
        face_normals,
        ..ObjOptions::default()
    };
    Mesh::from_serialized_bytes(bytes, index, Path::new("m.serialized"), &options)
        .map_err(|e| e.to_string())
}

#[test]
fn every_version_and_precision_gives_the_same_mesh() {
    for version in [3, 4] {
        for double in [false, true] {
            let style = Style {
                version,
                double,
                ..FULL
            };
            let meshes = [0.0, 0.5, 1.0].map(|height| mesh(style, height, &FACES));
            let bytes = file(version, &meshes);
            for (index, height) in [(0, 0.0), (1, 0.5), (2, 1.0)] {
                let (mesh, colours) = read(&bytes, index, false).unwrap();
                let data = mesh.data();
                let expected = SQUARE.map(|[x, y, _]| [x as f32, y as f32, height]);
                assert_eq!(data.positions, expected);
                assert_eq!(data.triangles, FACES);
                assert_eq!(data.normals, [[0.0, 0.0, 1.0]; 4]);
                assert_eq!(data.uvs, SQUARE.map(|p| [p[0] as f32, 0.25 * p[1] as f32]));
                assert!(colours);
            }
        }
    }
}

#[test]
fn normals_are_smooth_where_there_are_none_unless_faces_are_flat() {
    let plain = Style {
        normals: false,
        uvs: false,
        colours: false,
        ..FULL
    };
    let one = |style: Style| file(4, &[mesh(style, 0.5, &FACES)]);
    let (smooth, colours) = read(&one(plain), 0, false).unwrap();
    assert_eq!(smooth.data().normals, [[0.0, 0.0, 1.0]; 4]);
    assert!(smooth.data().uvs.is_empty() && !colours);
    let flat = Style {
        flat: true,
        ..plain
    };
    for (bytes, face_normals) in [(one(flat), false), (one(plain), true), (one(FULL), true)] {
        assert!(
            read(&bytes, 0, face_normals)
                .unwrap()
                .0
                .data()
                .normals
                .is_empty()
        );
    }
}

#[test]
fn what_is_wrong_is_said() {
    let good = mesh(FULL, 0.5, &FACES);
    let other = |version: u16| {
        let mut bytes = good.clone();
        bytes[2..4].copy_from_slice(&version.to_le_bytes());
        bytes
    };
    let absurd = {
        let mut body = 0x1000u32.to_le_bytes().to_vec();
        body.extend(b"x\0");
        body.extend([0xff; 16]);
        let mut encoder = ZlibEncoder::new(good[..4].to_vec(), Compression::default());
        encoder.write_all(&body).unwrap();
        encoder.finish().unwrap()
    };
    for (bytes, index, expected) in [
        (
            b"ply".to_vec(),
            0,
            "m.serialized: expected a mesh that Mitsuba serialized, found another start",
        ),
        (file(4, &[other(2)]), 0, "expected version 3 or 4, found 2"),
        (
            file(4, std::slice::from_ref(&good)),
            1,
            "expected a mesh of number 1, found 1 meshes",
        ),
        (
            file(4, &[good.clone(), other(3)]),
            1,
            "expected a mesh of version 4, found another",
        ),
        (
            file(4, &[mesh(FULL, 0.5, &[[0, 1, 4]])]),
            0,
            "expected indices of vertices below 4, found [0, 1, 4]",
        ),
        (file(4, &[mesh(FULL, 0.5, &[])]), 0, "at least one triangle"),
        (
            file(4, &[mesh(FULL, f64::NAN, &FACES)]),
            0,
            "expected finite vertices",
        ),
        (
            file(4, &[absurd]),
            0,
            "expected a mesh of at most 1073741824 bytes, found 18446744073709551615 vertices",
        ),
        (file(4, &[good[..good.len() / 2].to_vec()]), 0, "bytes of "),
        (
            file(4, &[good[..4].to_vec()]),
            0,
            "expected 4 bytes of flags",
        ),
    ] {
        let found = read(&bytes, index, false).err();
        let found = found.unwrap_or_else(|| panic!("accepted, not: {expected}"));
        assert!(found.contains(expected), "{found}\nnot {expected}");
    }
}

#[test]
fn files_cut_off_or_damaged_are_errors_or_meshes() {
    let whole = file(4, &[mesh(FULL, 0.5, &FACES), mesh(FULL, 1.0, &FACES)]);
    for n in 0..whole.len() {
        assert!(read(&whole[..n], 1, false).is_err(), "cut at {n}");
        for byte in [0, 1, 0x7f, 0xff] {
            let mut damaged = whole.clone();
            damaged[n] = byte;
            let _ = read(&damaged, 0, false);
        }
    }
}

#[test]
fn scenes_load_them_by_their_number() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = file(4, &[0.0, 1.0].map(|height| mesh(FULL, height, &FACES)));
    std::fs::write(dir.path().join("a.serialized"), bytes).unwrap();
    let text = |index: u32| {
        format!(
            "<scene version=\"3.0.0\"><sensor type=\"perspective\"><float name=\"fov\" value=\"40\"/></sensor>
            <shape type=\"serialized\"><string name=\"filename\" value=\"a.serialized\"/>
            <integer name=\"shape_index\" value=\"{index}\"/><emitter type=\"area\"/></shape></scene>"
        )
    };
    let load = |index| Scene::from_xml(&text(index), dir.path(), &LoadOptions::default());
    let (_, warnings) = load(1).unwrap();
    assert_eq!(warnings.len(), 1);
    assert!(
        warnings[0].ends_with("a.serialized: `colours of vertices` have no effect"),
        "{warnings:?}"
    );
    let found = load(2).unwrap_err().to_string();
    assert!(
        found.contains("a.serialized: expected a mesh of number 2, found 2 meshes"),
        "{found}"
    );
}
