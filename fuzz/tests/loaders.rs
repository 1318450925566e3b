//! Files that are damaged in every way must give a scene or an error, never a panic.

use std::fs;
use std::path::Path;

use fuzz::memory::{Counting, peak};
use fuzz::{apply, check_message, config, corpus, mutations};
use proptest::prelude::*;
use render::Scene;
use render::image_io::{Encoding, read};
use render::math::Transform;
use render::plugin::xml::{Document, Node};
use render::scene::LoadOptions;
use render::shape::{CurveKind, Curves, Mesh, ObjOptions, Shape};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Most memory that reading a small file may take: an image of the largest size allowed, and its copy.
const MOST_MEMORY: usize = 3 << 30;
/// Most that reading a text of some kilobytes may take.
const MOST_MEMORY_OF_TEXT: usize = 64 << 20;

/// Pieces that mean something to the parser of scenes.
const XML: [&[u8]; 26] = [
    b"<",
    b"/>",
    b"\"",
    b"&amp;",
    b"&#0;",
    b"]]>",
    b"<![CDATA[x]]>",
    b"<!--",
    b"<?x?>",
    b"$",
    b"$spp",
    b"nan",
    b"1e999",
    b"1e30",
    b"-1",
    "\u{feff}".as_bytes(),
    "é".as_bytes(),
    b"<ref id=\"white\"/>",
    b"<include filename=\".\"/>",
    b"<default name=\"c\" value=\"$c$c\"/>",
    b"<bsdf type=\"x\" id=\"white\"/>",
    b"<scale value=\"0\"/>",
    b"<!DOCTYPE x>",
    b"<!ENTITY a \"b\">",
    b"400:1",
    b"version=\"0.6\"",
];

/// Pieces that mean something to the reader of meshes.
const OBJ: [&[u8]; 16] = [
    b"\n",
    b"\\\n",
    b"\r",
    b"#",
    b"v ",
    b"vn nan 0 0\n",
    b"vt 1\n",
    b"f 1 2 3\n",
    b"f 1/1/1 2/2/2 3/3/3\n",
    b"//",
    b"-9",
    b"99999999999999999999",
    b"1e38",
    b"1e-45",
    b"g\n",
    "\u{feff}".as_bytes(),
];

/// Pieces that mean something to the reader of curves.
const CURVES: [&[u8]; 12] = [
    b"\n",
    b"\n\n",
    b"\r",
    b" ",
    b"nan",
    b"inf",
    b"-1",
    b"1e39",
    b"1e12",
    b"1e-45",
    b"0 0 0 0\n",
    "\u{feff}".as_bytes(),
];

/// Pieces that mean something to the reader of polygon files.
const PLY: [&[u8]; 12] = [
    b"\n",
    b"end_header\n",
    b"element face 4000000000\n",
    b"element vertex 1\n",
    b"element x 99999999999\n",
    b"property list uint double vertex_index\n",
    b"property double x\n",
    b"nan ",
    b"1e39 ",
    b"-1 ",
    b"\xff\xff\xff\xff",
    b"\x00\x00\xc0\x7f",
];

/// Pieces of image files: markers, names of chunks, large numbers.
const BYTES: [&[u8]; 10] = [
    b"\xff\xd9",
    b"\xff\xda",
    b"\xff\xc2",
    b"\xff\xff\xff\xff",
    b"\x7f\xff\xff\xff",
    b"\x00\x00\x00\x00",
    b"IDAT",
    b"IEND",
    b"dataWindow\0box2i\0",
    b"channels\0",
];

/// Asks for everything in every way.
fn exercise(node: &Node) {
    for name in [
        "value",
        "filename",
        "reflectance",
        "radiance",
        "to_world",
        "alpha",
        "p0",
        "width",
    ] {
        let errors = [
            node.float(name).err(),
            node.integer(name).err(),
            node.boolean(name).err(),
            node.string(name).err(),
            node.path(name).err(),
            node.rgb(name).err(),
            node.point(name).err(),
            node.vector(name).err(),
            node.transform(name).err(),
        ];
        for error in errors.into_iter().flatten() {
            assert!(!error.to_string().is_empty());
        }
        if let Ok(Some(x)) = node.float(name) {
            assert!((x as f32).is_finite());
        }
        if let Ok(Some(t)) = node.transform(name) {
            assert!(t.to_f32().as_flattened().iter().all(|x| x.is_finite()));
            assert!(t.inverse().is_some());
        }
    }
    if let Err(error) = node.finish() {
        assert!(error.to_string().contains(": unknown "));
    }
    for (_, child) in node.children() {
        exercise(child);
    }
    node.finish().ok();
}

proptest! {
    #![proptest_config(config(3000))]

    #[test]
    fn damaged_documents_do_not_panic(changes in mutations(XML.len())) {
        let text = apply(corpus::DOCUMENT.as_bytes(), &changes, &XML);
        let text = String::from_utf8_lossy(&text);
        let (read, memory) = peak(|| Document::from_str(&text, Path::new("."), &[]));
        prop_assert!(memory < MOST_MEMORY_OF_TEXT, "{} bytes", memory);
        match read {
            Ok(document) => exercise(document.root()),
            Err(error) => check_message(&error),
        }
    }
}

proptest! {
    #![proptest_config(config(3000))]

    /// What loads can be traced: its numbers are finite.
    #[test]
    fn damaged_scenes_do_not_panic(changes in mutations(XML.len()), which in 0..3usize) {
        thread_local!(static FOLDER: tempfile::TempDir = folder());
        let scene = [corpus::SCENE, corpus::OTHERS, corpus::LATEST][which];
        let text = apply(scene.as_bytes(), &changes, &XML);
        let text = String::from_utf8_lossy(&text);
        let load = |base: &Path| Scene::from_xml(&text, base, &LoadOptions::default());
        let (read, memory) = peak(|| FOLDER.with(|folder| load(folder.path())));
        prop_assert!(memory < MOST_MEMORY_OF_TEXT, "{} bytes", memory);
        match read {
            Ok((scene, _)) => prop_assert!(scene.params().values().iter().all(|x| x.is_finite())),
            Err(error) => check_message(&error),
        }
    }
}

/// A folder with what scenes of the corpus name.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, bytes) in corpus::files() {
        fs::write(folder.path().join(name), bytes).expect("a file");
    }
    folder
}

proptest! {
    #![proptest_config(config(20_000))]

    #[test]
    fn damaged_polygons_do_not_panic(changes in mutations(PLY.len()), which in 0..2usize) {
        let bytes = apply(&corpus::polygons()[which], &changes, &PLY);
        let read = || Mesh::from_ply_bytes(&bytes, Path::new("a.ply"), &ObjOptions::default());
        let (read, memory) = peak(read);
        prop_assert!(memory < MOST_MEMORY_OF_TEXT, "{} bytes", memory);
        match read {
            Ok((mesh, _)) => {
                let data = mesh.data();
                prop_assert!(data.positions.as_flattened().iter().all(|x| x.is_finite()));
                prop_assert!(data.normals.as_flattened().iter().all(|x| x.is_finite()));
                prop_assert!(data.uvs.as_flattened().iter().all(|x| x.is_finite()));
            }
            Err(error) => check_message(&error),
        }
    }

    #[test]
    fn damaged_curves_do_not_panic(changes in mutations(CURVES.len()), linear in any::<bool>()) {
        let text = apply(corpus::CURVES.as_bytes(), &changes, &CURVES);
        let kind = if linear { CurveKind::Linear } else { CurveKind::Spline };
        let read = || Curves::from_text(&text, Path::new("a.txt"), kind, &Transform::IDENTITY);
        let (read, memory) = peak(read);
        prop_assert!(memory < MOST_MEMORY_OF_TEXT, "{} bytes", memory);
        match read {
            Ok((curves, _)) => {
                prop_assert!(curves.points().as_flattened().iter().all(|x| x.is_finite()));
                prop_assert!(curves.bounds().as_flattened().iter().all(|x| x.is_finite()));
                prop_assert!(curves.area().is_finite() && curves.area() > 0.0);
            }
            Err(error) => check_message(&error),
        }
    }

    #[test]
    fn damaged_meshes_do_not_panic(changes in mutations(OBJ.len())) {
        let text = apply(corpus::MESH.as_bytes(), &changes, &OBJ);
        let read = || Mesh::from_obj_text(&text, Path::new("a.obj"), &ObjOptions::default());
        let (read, memory) = peak(read);
        prop_assert!(memory < MOST_MEMORY_OF_TEXT, "{} bytes", memory);
        match read {
            Ok((mesh, _)) => {
                let data = mesh.data();
                prop_assert!(data.positions.as_flattened().iter().all(|x| x.is_finite()));
                prop_assert!(data.normals.as_flattened().iter().all(|x| x.is_finite()));
                prop_assert!(data.uvs.as_flattened().iter().all(|x| x.is_finite()));
            }
            Err(error) => check_message(&error),
        }
    }
}

proptest! {
    #![proptest_config(config(6000))]

    #[test]
    fn damaged_images_do_not_panic(
        which in any::<prop::sample::Index>(),
        changes in mutations(BYTES.len()),
    ) {
        thread_local!(static IMAGES: (tempfile::TempDir, Vec<(&'static str, Vec<u8>)>) =
            (folder(), corpus::images()));
        IMAGES.with(|(folder, images)| {
            let (ending, whole) = which.get(images);
            let path = folder.path().join(format!("damaged.{ending}"));
            fs::write(&path, apply(whole, &changes, &BYTES)).expect("a file");
            let (found, memory) = peak(|| read(&path, Encoding::Srgb));
            prop_assert!(memory < MOST_MEMORY, "{} bytes", memory);
            match found {
                Ok(pixels) => {
                    let all = pixels.width * pixels.height * pixels.channels;
                    prop_assert_eq!(pixels.data.len(), all);
                    prop_assert!(pixels.data.iter().all(|x| x.is_finite()));
                }
                Err(error) => check_message(&error),
            }
            Ok(())
        })?;
    }
}

/// The corpus is valid, so that the changes start from something that is read to the end.
#[test]
fn undamaged_files_are_read() {
    let document = Document::from_str(corpus::DOCUMENT, Path::new("."), &[]).unwrap();
    exercise(document.root());
    let folder = folder();
    let (scene, warnings) =
        Scene::from_xml(corpus::SCENE, folder.path(), &LoadOptions::default()).unwrap();
    // Of lines and points of the mesh.
    let of_mesh = |w: &str| w.contains("a.obj:") && w.ends_with("has no effect");
    let told: Vec<String> = warnings.iter().map(ToString::to_string).collect();
    assert!(
        told.len() == 2 && told.iter().all(|w| of_mesh(w)),
        "{told:?}"
    );
    assert!(!scene.params().values().is_empty());
    let (scene, _) =
        Scene::from_xml(corpus::OTHERS, folder.path(), &LoadOptions::default()).unwrap();
    assert!(scene.params().find("PLYMesh.vertex_color").is_ok());
    let (scene, _) =
        Scene::from_xml(corpus::LATEST, folder.path(), &LoadOptions::default()).unwrap();
    assert!(scene.params().find("grown.displacement.data").is_ok());
    for (ending, bytes) in corpus::images() {
        let path = folder.path().join(format!("b.{ending}"));
        fs::write(&path, bytes).unwrap();
        read(&path, Encoding::Srgb).unwrap();
    }
}

/// A file that ends anywhere is an error, unless nothing but white space is missing.
#[test]
fn documents_cut_off_anywhere_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.xml");
    for end in 0..corpus::DOCUMENT.len() {
        fs::write(&path, &corpus::DOCUMENT.as_bytes()[..end]).unwrap();
        let whole = corpus::DOCUMENT[..end].trim_end().ends_with("</scene>");
        assert_eq!(
            Document::load(&path, &[]).is_ok(),
            whole,
            "cut at byte {end}"
        );
    }
}
