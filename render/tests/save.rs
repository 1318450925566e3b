//! Scenes that are written and read again are the same.

use std::path::Path;

use render::Job;
use render::Scene;
use render::image_io::{Pixels, write_exr_pixels};
use render::instances::{Estimator, render_f32};
use render::params::Theta;
use render::scene::LoadOptions;

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
    // The peer takes this version without its upgrade.
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
