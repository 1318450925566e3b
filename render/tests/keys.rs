//! Names of parameters: whatever a scene file calls a thing, and the way to it as Mitsuba has it.

use render::Scene;
use render::image_io::{self, Pixels};
use render::scene::LoadOptions;

const SENSOR: &str = r#"<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="4"/>
    <integer name="height" value="4"/></film></sensor>"#;

/// A scene beside which there is the texture `t.exr` of two texels.
fn load(body: &str) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let pixels = Pixels {
        width: 2,
        height: 1,
        channels: 3,
        data: vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
    };
    image_io::write_exr_pixels(&folder.path().join("t.exr"), &pixels).unwrap();
    let text = format!("<scene version=\"3.0.0\">{SENSOR}{body}</scene>");
    let loaded = Scene::from_xml(&text, folder.path(), &LoadOptions::default());
    loaded.unwrap().0
}

/// The own name of what a key stands for.
fn own<'a>(scene: &'a Scene, key: &str) -> Option<&'a str> {
    Some(scene.params().find(key).ok()?.name.as_str())
}

const TEXTURE: &str =
    r#"<texture type="bitmap" id="wood"><string name="filename" value="t.exr"/></texture>"#;

#[test]
fn textures_that_are_shared_answer_to_every_place_and_to_their_id() {
    let scene = load(&format!(
        r#"{TEXTURE}<bsdf type="diffuse" id="floor"><ref id="wood" name="reflectance"/></bsdf>
        <shape type="rectangle"><ref id="floor"/></shape>
        <shape type="sphere" id="ball"><bsdf type="plastic"><ref id="wood" name="diffuse_reflectance"/></bsdf></shape>
        <emitter type="constant"/>"#
    ));
    for key in [
        "floor.reflectance.data",
        "floor.reflectance",
        "Rectangle.bsdf.reflectance.data",
        "ball.bsdf.diffuse_reflectance.data",
        "ball.bsdf.diffuse_reflectance",
        "wood.data",
        "wood",
    ] {
        assert_eq!(own(&scene, key), Some("floor.reflectance.data"), "{key}");
    }
    let names: Vec<_> = scene.params().infos().iter().map(|i| &i.name[..]).collect();
    assert_eq!(names.iter().filter(|n| n.ends_with(".data")).count(), 1);
}

/// As a colour and as a number it has different parameters, and its id alone does not say which.
#[test]
fn an_id_of_several_parameters_is_none() {
    let scene = load(&format!(
        r#"{TEXTURE}<shape type="sphere" id="ball"><bsdf type="roughconductor">
        <ref id="wood" name="specular_reflectance"/><ref id="wood" name="alpha"/></bsdf></shape>
        <emitter type="constant"/>"#
    ));
    for key in [
        "ball.bsdf.specular_reflectance.data",
        "ball.bsdf.alpha.data",
    ] {
        assert_eq!(own(&scene, key), Some(key));
    }
    assert_eq!(own(&scene, "wood.data"), None);
    let lamps = load(
        r#"<emitter type="area" id="lamp"/><shape type="sphere" id="one"><ref id="lamp"/></shape>
        <shape type="rectangle" id="two"><ref id="lamp"/></shape>"#,
    );
    assert_eq!(own(&lamps, "lamp.radiance.value"), None);
}

#[test]
fn lamps_of_shapes_answer_to_their_id() {
    let scene = load(
        r#"<emitter type="area" id="lamp"><rgb name="radiance" value="1, 2, 3"/></emitter>
        <shape type="sphere"><ref id="lamp"/></shape>
        <shape type="rectangle" id="sheet"><emitter type="area" id="glow"/></shape>"#,
    );
    for (key, name) in [
        ("lamp.radiance.value", "shape0.emitter.radiance.value"),
        ("lamp.radiance", "shape0.emitter.radiance.value"),
        (
            "Sphere.emitter.radiance.value",
            "shape0.emitter.radiance.value",
        ),
        ("glow.radiance.value", "sheet.emitter.radiance.value"),
    ] {
        assert_eq!(own(&scene, key), Some(name), "{key}");
    }
}

/// Mitsuba numbers what has no id, from the second on; instances share the materials of their group.
#[test]
fn materials_of_groups_answer_to_the_name_of_the_group() {
    let scene = load(
        r#"<bsdf type="plastic" id="shiny"/>
        <shape type="shapegroup" id="trees"><shape type="sphere" id="crown"><bsdf type="diffuse"/></shape>
        <shape type="cube"><bsdf type="diffuse"/></shape><shape type="cube"><ref id="shiny"/></shape></shape>
        <shape type="instance" id="here"><ref id="trees"/></shape>
        <shape type="instance" id="there"><ref id="trees"/></shape><emitter type="constant"/>"#,
    );
    for (key, name) in [
        (
            "trees.crown.bsdf.reflectance.value",
            "here.crown.bsdf.reflectance.value",
        ),
        (
            "trees.shape.bsdf.reflectance.value",
            "here.shape1.bsdf.reflectance.value",
        ),
        (
            "trees.shape_1.bsdf.diffuse_reflectance.value",
            "shiny.diffuse_reflectance.value",
        ),
    ] {
        assert_eq!(own(&scene, key), Some(name), "{key}");
    }
}

#[test]
fn patterns_fit_every_name() {
    let scene = load(&format!(
        r#"{TEXTURE}<bsdf type="diffuse" id="floor"><ref id="wood" name="reflectance"/></bsdf>
        <emitter type="area" id="lamp"/><shape type="rectangle"><ref id="floor"/></shape>
        <shape type="sphere" id="ball"><bsdf type="plastic"><ref id="wood" name="diffuse_reflectance"/></bsdf></shape>
        <shape type="disk"><ref id="lamp"/></shape>"#
    ));
    let matching = |pattern: &str| -> Vec<&str> {
        let found = scene.params().matching(pattern);
        let names = found.iter().flatten().map(|info| &info.name[..]);
        names.collect()
    };
    for (pattern, expected) in [
        ("wood*", &["floor.reflectance.data"][..]),
        ("Rectangle.*.data", &["floor.reflectance.data"]),
        ("ball.*.diffuse_reflectance", &["floor.reflectance.data"]),
        (
            "ball.*",
            &[
                "floor.reflectance.data",
                "ball.bsdf.eta.value",
                "ball.bsdf.specular_reflectance.value",
            ],
        ),
        ("ball.*.eta", &["ball.bsdf.eta.value"]),
        ("lamp.*", &["shape2.emitter.radiance.value"]),
        ("Disk.emitter*", &["shape2.emitter.radiance.value"]),
        ("*.emitter.*", &["shape2.emitter.radiance.value"]),
        ("chair.*", &[]),
    ] {
        assert_eq!(matching(pattern), expected, "{pattern}");
    }
}
