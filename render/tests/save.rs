//! Scenes that are written and read again are the same.

use std::path::Path;

use render::Job;
use render::Scene;
use render::image_io::{Pixels, write_exr_pixels};
use render::instances::{Estimator, render_f32};
use render::params::Theta;
use render::scene::LoadOptions;
use render::shape::{AnyShape, Mesh, MeshData, Shape};

const SCENE: &str = r#"<scene version="2.1.0">
<default name="grey" value="0.25"/>
<integrator type="path"><integer name="maxDepth" value="4"/></integrator>
<sensor type="perspective" id="eye"><float name="fov" value="45"/>
  <transform name="toWorld"><lookat origin="0, 1, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
  <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/><rfilter type="box"/></film>
  <sampler type="independent"><integer name="sampleCount" value="4"/></sampler></sensor>
<bsdf type="twosided" id="both"><bsdf type="diffuse" id="inner"><rgb name="reflectance" value="0.2, 0.5, 0.7"/></bsdf></bsdf>
<bsdf type="diffuse" id="default"/>
<texture type="bitmap" id="picture"><string name="filename" value="picture.exr"/></texture>
<shape type="obj" id="mesh"><string name="filename" value="deep/mesh &amp; more.obj"/><ref id="both"/></shape>
<shape type="rectangle"><transform name="toWorld"><rotate x="1" angle="-90"/><translate y="-1"/></transform>
  <bsdf type="diffuse"><ref name="reflectance" id="picture"/></bsdf></shape>
<shape type="sphere"><point name="center" x="0.5" y="0.25"/><float name="radius" value="0.4"/><ref id="inner"/></shape>
<shape type="sphere"><point name="center" x="-1"/><float name="radius" value="0.3"/><bsdf type="dielectric" id="glass">
  <string name="intIOR" value="bk7"/></bsdf></shape>
<shape type="cube"><transform name="toWorld"><scale value="0.2"/><translate x="1.5"/></transform>
  <bsdf type="roughconductor"><float name="alpha" value="$grey"/><string name="material" value="Cu"/></bsdf></shape>
<shape type="disk"><transform name="toWorld"><translate z="-2"/></transform><ref id="default"/>
  <emitter type="area"><texture name="radiance" type="checkerboard"><rgb name="color0" value="1, 2, 3"/></texture></emitter></shape>
<emitter type="envmap" id="env"><string name="filename" value="sky.exr"/><float name="scale" value="0.5"/></emitter>
<emitter type="point"><point name="position" value="1, 3, 1"/><spectrum name="intensity" value="400:1, 700:2"/></emitter>
</scene>"#;

fn folder() -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("a folder");
    std::fs::create_dir(dir.path().join("deep")).expect("a folder");
    let mesh = "v -1 0 0\nv 1 0 0\nv 0 1 0.5\nf 1 2 3\n";
    std::fs::write(dir.path().join("deep/mesh & more.obj"), mesh).expect("a mesh");
    let image = |name: &str, width: usize, height: usize| {
        let data = (0..3 * width * height)
            .map(|i| 0.1 + 0.02 * (i % 40) as f32)
            .collect();
        let pixels = Pixels {
            width,
            height,
            channels: 3,
            data,
        };
        write_exr_pixels(&dir.path().join(name), &pixels).expect("an image");
    };
    image("picture.exr", 4, 3);
    image("sky.exr", 8, 4);
    std::fs::write(dir.path().join("scene.xml"), SCENE).expect("a scene");
    dir
}

fn load(path: &Path) -> Scene {
    let loaded = Scene::load(path, &LoadOptions::default());
    loaded.unwrap_or_else(|e| panic!("{e}")).0
}

fn picture(scene: &Scene) -> Vec<f32> {
    let job = Job::new(scene, &scene.settings, 1, 0..4, &());
    render_f32(
        &job,
        &Theta::constant(scene.params().values()),
        Estimator::Mis,
    )
    .image(0)
    .data
}

#[test]
fn what_is_written_is_what_was_read() {
    let dir = folder();
    let scene = load(&dir.path().join("scene.xml"));
    let to = dir.path().join("out/new.xml");
    let files = scene.save(&to).expect("a file");
    assert_eq!(files.len(), 4, "{files:?}");
    assert!(
        dir.path().join("out/meshes/mesh___more.obj").is_file(),
        "{files:?}"
    );
    let again = load(&to);
    let names =
        |s: &Scene| -> Vec<String> { s.params().infos().iter().map(|i| i.name.clone()).collect() };
    assert_eq!(names(&again), names(&scene));
    for (info, (a, b)) in scene
        .params()
        .infos()
        .iter()
        .zip(scene.params().values().iter().zip(again.params().values()))
    {
        assert_eq!(a, b, "{}", info.name);
    }
    assert_eq!(picture(&again), picture(&scene));
    let error = again
        .save(&dir.path().join("out/other.xml"))
        .expect_err("its own textures");
    assert!(
        error
            .to_string()
            .contains("no file of the scene would be replaced"),
        "{error}"
    );
    // Once more it is the same text.
    let twice = dir.path().join("twice/new.xml");
    again.save(&twice).expect("a file");
    let read = |path: &Path| std::fs::read_to_string(path).expect("a text");
    assert_eq!(read(&twice), read(&to));
    // Mitsuba 3 takes this version without its upgrade.
    assert!(read(&to).starts_with("<scene version=\"3.0.0\">"));
}

#[test]
fn parameters_are_written_as_they_are() {
    let dir = folder();
    let mut scene = load(&dir.path().join("scene.xml"));
    let mut values = scene.params().values().to_vec();
    for (k, info) in scene.params().infos().iter().enumerate() {
        for value in &mut values[info.range()] {
            *value = (*value * (0.99 - 0.01 * k as f32)).max(info.valid.0 as f32);
        }
    }
    scene.set_params(&values).expect("valid values");
    let to = dir.path().join("out/new.xml");
    scene.save(&to).expect("a file");
    let again = load(&to);
    assert_eq!(again.params().values(), scene.params().values());
    assert_eq!(picture(&again), picture(&scene));
}

/// Mitsuba 3.9 corrects what does not say that it is not to be.
#[test]
fn normal_maps_are_written_as_they_are_seen() {
    let dir = folder();
    let map = |said: &str| {
        let bsdf = format!(
            r#"<bsdf type="normalmap"><texture type="bitmap" name="normalmap"><string name="filename" value="picture.exr"/>
            </texture>{said}<bsdf type="diffuse"/></bsdf>"#
        );
        let view = r#"<sensor type="perspective"/><emitter type="constant"/>"#;
        let text =
            format!(r#"<scene version="3.0.0">{view}<shape type="sphere">{bsdf}</shape></scene>"#);
        let path = dir.path().join("map.xml");
        std::fs::write(&path, text).expect("a scene");
        let to = dir.path().join("out/map.xml");
        load(&path).save(&to).expect("a file");
        let (_, warnings) = Scene::load(&to, &LoadOptions::default()).expect("a scene");
        assert_eq!(warnings, Vec::<String>::new());
        std::fs::read_to_string(&to).expect("a text")
    };
    let flag = |name: &str, value: bool| format!(r#"<boolean name="{name}" value="{value}"/>"#);
    let [flip, shadow] = ["flip_invalid_normals", "use_shadowing_function"];
    for (said, flips, shadows) in [
        (String::new(), false, false),
        (flag(flip, true), true, false),
        (flag(flip, true) + &flag(shadow, true), true, true),
    ] {
        let text = map(&said);
        assert!(text.contains(&flag(flip, flips)), "{text}");
        assert!(text.contains(&flag(shadow, shadows)), "{text}");
        assert_eq!(text.matches("<boolean").count(), 2, "{text}");
    }
}

#[test]
fn what_cannot_be_written_is_an_error() {
    let text = r#"<scene version="3.0.0"><sensor type="perspective"/><shape type="sphere"/>
        <emitter type="spot" id="lamp"><texture name="texture" type="checkerboard"/></emitter></scene>"#;
    let loaded = Scene::from_xml(text, Path::new("."), &LoadOptions::default());
    let (mut scene, _) = loaded.expect("a scene");
    let dir = tempfile::tempdir().expect("a folder");
    let to = dir.path().join("new.xml");
    scene.save(&to).expect("a file");
    let mut values = scene.params().values().to_vec();
    let board = scene
        .params()
        .find("lamp.intensity.color0")
        .expect("a range")
        .range();
    values[board].fill(0.75);
    scene.set_params(&values).expect("valid values");
    let error = scene.save(&to).expect_err("a product").to_string();
    assert!(error.contains("`lamp.intensity.color0.value`"), "{error}");
}

const MOVING: &str = r#"<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="3"/></integrator>
<sensor type="perspective" id="other"><float name="fov" value="30"/>
  <transform name="to_world"><lookat origin="2, 1, 5" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
<sensor type="perspective" id="eye"><string name="focal_length" value="40mm"/>
  <transform name="to_world"><lookat origin="0, 1, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
  <film type="hdrfilm"><integer name="width" value="20"/><integer name="height" value="14"/><rfilter type="box"/></film>
  <sampler type="independent"><integer name="sample_count" value="4"/></sampler></sensor>
<bsdf type="twosided" id="grey"><bsdf type="diffuse"/></bsdf>
<shape type="obj" id="smooth"><string name="filename" value="tent.obj"/><transform name="to_world"><scale value="0.7"/>
  <translate x="-1.2" y="0.8"/></transform><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
  <string name="filename" value="picture.exr"/></texture></bsdf></shape>
<shape type="obj" id="given"><string name="filename" value="given.obj"/><transform name="to_world">
  <translate x="0.4" y="0.9"/></transform><ref id="grey"/></shape>
<shape type="obj" id="flat"><string name="filename" value="tent.obj"/><boolean name="face_normals" value="true"/>
  <boolean name="flip_tex_coords" value="false"/><ref id="grey"/></shape>
<shape type="ply" id="sheet"><string name="filename" value="sheet.ply"/><transform name="to_world">
  <translate x="-0.4" y="1.5" z="-1"/></transform><ref id="grey"/></shape>
<shape type="sphere" id="ball"><point name="center" x="1.5" y="-0.5"/><float name="radius" value="0.4"/><ref id="grey"/></shape>
<shape type="cylinder" id="tube"><point name="p0" x="-2" y="-1"/><point name="p1" x="-1.5" y="0"/>
  <float name="radius" value="0.2"/><ref id="grey"/></shape>
<shape type="merge"><shape type="cube" id="cube"><transform name="to_world"><scale value="0.3"/>
  <translate x="0.5" y="-0.8"/></transform><ref id="grey"/></shape></shape>
<shape type="rectangle" id="floor"><transform name="to_world"><scale value="6"/><rotate x="1" angle="-90"/>
  <translate y="-1.5"/></transform><ref id="grey"/></shape>
<shape type="shapegroup" id="group"><shape type="disk" id="plate"><ref id="grey"/></shape></shape>
<shape type="instance" id="copy"><ref id="group"/><transform name="to_world"><translate y="-1" z="-3"/></transform></shape>
<emitter type="point" id="bulb"><point name="position" value="1, 3, 2"/><rgb name="intensity" value="9, 8, 7"/></emitter>
<emitter type="spot" id="beam"><transform name="to_world"><lookat origin="-1, 4, 2" target="0, 0, 0" up="0, 0, 1"/></transform>
  <rgb name="intensity" value="20"/><float name="cutoff_angle" value="40"/></emitter>
<emitter type="envmap" id="sky"><string name="filename" value="sky.exr"/><transform name="to_world">
  <rotate y="1" angle="30"/></transform></emitter>
<emitter type="directional" id="sun"><vector name="direction" value="0.3, -1, -0.2"/></emitter>
<emitter type="directional" id="moon"><transform name="to_world"><lookat origin="0, 0, 0" target="-0.2, -1, 0.3"
  up="0, 0, 1"/></transform><rgb name="irradiance" value="0.3"/></emitter>
</scene>"#;

fn moving() -> (tempfile::TempDir, Scene) {
    let dir = folder();
    let tent = "v -1 0 0\nv 1 0 0\nv 0 1 0.5\nv 0 -1 0.5\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0.3 1\nvn 0.2 0 1\n";
    let faces = "f 1/1 2/2 3/3\nf 2/4 1/1 4/2\n";
    let given = "f 1/1/1 2/2/2 3/3/1\nf 2/4/1 1/1/2 4/2/2\n";
    for (name, faces) in [("tent.obj", faces), ("given.obj", given)] {
        std::fs::write(dir.path().join(name), format!("{tent}{faces}")).expect("a mesh");
    }
    let sheet = MeshData {
        positions: vec![[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.1]],
        triangles: vec![[0, 1, 2]],
        ..Default::default()
    };
    let sheet = Mesh::smoothed(sheet, false).expect("a mesh").to_ply();
    std::fs::write(dir.path().join("sheet.ply"), sheet).expect("a mesh");
    let path = dir.path().join("moving.xml");
    std::fs::write(&path, MOVING).expect("a scene");
    let options = LoadOptions {
        sensor: Some("eye".into()),
        ..Default::default()
    };
    let scene = Scene::load(&path, &options).expect("a scene").0;
    (dir, scene)
}

/// What has moved is written where it is: shapes, meshes with their normals and texture coordinates, in the format that they
/// came in, to the last bit, the sensor that is looked through, lights. The image is the same up to roundings, which move
/// outlines of few pixels.
#[test]
fn what_has_moved_is_written_where_it_is() {
    let (dir, mut scene) = moving();
    let start = picture(&scene);
    let movables = scene.movables();
    let names: Vec<&str> = movables.iter().map(|m| m.name.as_str()).collect();
    assert!(
        names.len() >= 35
            && ["copy.plate.scale", "sun.rotation", "moon.rotation"]
                .iter()
                .all(|n| names.contains(n)),
        "{names:?}"
    );
    scene.make_movable(&names).expect("they may move");
    let mut values = scene.params().values().to_vec();
    for name in names {
        let range = scene.params().find(name).expect("known").range();
        for (k, value) in values[range].iter_mut().enumerate() {
            *value += match name.rsplit_once('.').map_or("", |(_, key)| key) {
                "scale" => 0.1,
                "fov" => 3.0,
                "vertex_positions" => 0.1 * (k as f32).sin(),
                _ => 0.05 * (k as f32 + 1.0),
            };
        }
    }
    scene.set_params(&values).expect("valid");
    let to = dir.path().join("out/new.xml");
    let files = scene.save(&to).expect("files");
    let written = |ending: &str| {
        let with = |f: &&std::path::PathBuf| f.extension().is_some_and(|e| e == ending);
        files.iter().filter(with).count()
    };
    assert_eq!([written("obj"), written("ply")], [3, 1], "{files:?}");
    let options = LoadOptions {
        sensor: Some("eye".into()),
        ..Default::default()
    };
    let (again, warnings) = Scene::load(&to, &options).expect("a scene");
    assert!(
        warnings.iter().all(|w| w.contains("instance")),
        "{warnings:?}"
    );
    let mut meshes = 0;
    for (a, b) in scene.shapes().iter().zip(again.shapes()) {
        if let (AnyShape::Mesh(a), AnyShape::Mesh(b)) = (a, b) {
            let (a, b) = (a.data(), b.data());
            assert_eq!((&a.positions, &a.uvs), (&b.positions, &b.uvs));
            assert_eq!(a.triangles, b.triangles);
            meshes += 1;
        }
    }
    assert_eq!(meshes, 4);
    let (a, b) = (picture(&scene), picture(&again));
    let far = |a: &[f32], b: &[f32]| {
        let off = a
            .iter()
            .zip(b)
            .filter(|(a, b)| (*a - *b).abs() > 1e-3 * a.abs().max(0.1));
        off.count() as f64 / a.len() as f64
    };
    assert!(far(&a, &b) < 0.02, "{}", far(&a, &b));
    assert!(far(&a, &start) > 0.5, "nothing has moved");
    // The other sensor has stayed.
    let still = |s: &Scene| s.sensors()[0].camera.origin();
    assert_eq!(still(&again), still(&scene));
}

/// Lenses are written as they are now, and so is where they and parallel rays have moved.
#[test]
fn lenses_are_written() {
    let dir = tempfile::tempdir().expect("a folder");
    let lens = r#"<float name="fov" value="40"/><float name="aperture_radius" value="0.25"/>
        <float name="focus_distance" value="5"/>"#;
    for (plugin, own, keys) in [
        ("thinlens", lens, &["aperture_radius", "focus_distance"][..]),
        ("orthographic", "", &[][..]),
    ] {
        let text = format!(
            r#"<scene version="3.0.0"><sensor type="{plugin}">{own}<transform name="to_world">
            <lookat origin="0, 1, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/></film></sensor>
            <shape type="sphere" id="ball"/><emitter type="constant"/></scene>"#
        );
        let path = dir.path().join(format!("{plugin}.xml"));
        std::fs::write(&path, text).expect("a scene");
        let mut scene = Scene::load(&path, &LoadOptions::default())
            .expect("a scene")
            .0;
        let names = keys.iter().copied().chain(["translation", "rotation"]);
        let names: Vec<String> = names.map(|key| format!("sensor.{key}")).collect();
        scene.make_movable(&names).expect("they may move");
        let mut values = scene.params().values().to_vec();
        for name in &names {
            values[scene.params().find(name).expect("known").offset] += 0.125;
        }
        scene.set_params(&values).expect("valid");
        let to = dir.path().join(format!("new/{plugin}.xml"));
        scene.save(&to).expect("files");
        let mut again = Scene::load(&to, &LoadOptions::default())
            .expect("a scene")
            .0;
        again.make_movable(&names).expect("they may move");
        for key in keys {
            let name = format!("sensor.{key}");
            let of = |s: &Scene| s.params().get(&name).expect("known").to_vec();
            assert_eq!(of(&again), of(&scene), "{name}");
        }
        for at in [[3.0, 4.0], [12.0, 9.0]] {
            let of = |s: &Scene| s.camera.ray_through::<f64>(at[0], at[1], [0.3, 0.9]);
            let (a, b) = (of(&scene), of(&again));
            assert!(
                (a.o - b.o).length() < 1e-5 && (a.d - b.d).length() < 1e-5,
                "{a:?} {b:?}"
            );
        }
    }
}

/// The parts of an instance have one transform in the file.
#[test]
fn parts_of_instances_are_written_where_they_move_alike() {
    let (dir, _) = moving();
    let part = r#"<shape type="obj" id="tent"><string name="filename" value="tent.obj"/><ref id="grey"/></shape></shape>
        <shape type="instance" id="still"><ref id="group"/></shape>"#;
    let text = MOVING.replace(
        "<ref id=\"grey\"/></shape></shape>\n<shape type=\"instance\"",
        &format!("<ref id=\"grey\"/></shape>{part}\n<shape type=\"instance\""),
    );
    assert_ne!(text, MOVING);
    std::fs::write(dir.path().join("two.xml"), text).expect("a scene");
    let mut scene = load(&dir.path().join("two.xml"));
    let names = ["copy.plate.translation", "copy.tent.translation"];
    scene.make_movable(&names).expect("known");
    scene
        .save(&dir.path().join("a/new.xml"))
        .expect("it has not moved");
    let by = [0.5f32, 0.25, 0.0];
    scene.set([(names[0], &by[..])]).expect("valid");
    let error = scene
        .save(&dir.path().join("b/new.xml"))
        .expect_err("moved");
    let error = error.to_string();
    assert!(
        error.contains("`copy.plate.translation`")
            && error.contains("`copy.plate` and `copy.tent`"),
        "{error}"
    );
    scene.set([(names[1], &by[..])]).expect("valid");
    scene.save(&dir.path().join("c/new.xml")).expect("files");
    let again = load(&dir.path().join("c/new.xml"));
    let corners = |s: &Scene| -> Vec<_> { s.shapes().iter().map(|s| s.bounds()).collect() };
    let before = corners(&load(&dir.path().join("two.xml")));
    let mut moved = 0;
    for ((now, read), old) in corners(&scene).iter().zip(&corners(&again)).zip(&before) {
        for (a, b) in now.as_flattened().iter().zip(read.as_flattened()) {
            assert!((a - b).abs() < 1e-5, "{now:?} {read:?}");
        }
        moved += usize::from((now[0][0] - old[0][0]).abs() > 0.4);
    }
    // Both parts of the one, and none of the other.
    assert_eq!(moved, 2);
}

/// Points of meshes in instances stand nowhere by themselves.
#[test]
fn what_stands_nowhere_in_the_file_cannot_be_written_elsewhere() {
    let (dir, _) = moving();
    let text = MOVING.replace(
        "<shape type=\"disk\" id=\"plate\">",
        "<shape type=\"obj\" id=\"plate\"><string name=\"filename\" value=\"tent.obj\"/>",
    );
    let path = dir.path().join("points.xml");
    std::fs::write(&path, text).expect("a scene");
    let mut scene = load(&path);
    let name = "copy.plate.vertex_positions";
    scene.make_movable(&[name]).expect("known");
    let mut points = scene.params().get(name).expect("known").to_vec();
    points[0] += 0.5;
    scene.set([(name, &points[..])]).expect("valid");
    let error = scene
        .save(&dir.path().join("again/new.xml"))
        .expect_err("moved")
        .to_string();
    assert!(error.contains(&format!("`{name}`")), "{error}");
}
