//! Textures of scene files: what is read, where it ends up, what is refused.

use std::path::Path;

use ad_core::Vec2;
use render::bsdf::{Bsdf, Shading, TextureRef, TransportMode};
use render::image_io::{Pixels, srgb_to_linear, write_exr_pixels};
use render::math::{Rgb, Vec3};
use render::params::{ParamShape, Theta};
use render::scene::LoadOptions;
use render::{Scene, SceneError};
use tempfile::TempDir;

use crate::common::Gradient;

/// Images that the tests refer to, and a place for scenes.
fn folder() -> TempDir {
    let dir = TempDir::new().unwrap();
    let rgb = |name: &str, pixels: &[[u8; 3]]| {
        let bytes = pixels.concat();
        let image = image::RgbImage::from_raw(pixels.len() as u32 / 2, 2, bytes).unwrap();
        image.save(dir.path().join(name)).unwrap();
    };
    // Two columns, two rows.
    rgb(
        "rgb.png",
        &[[0, 51, 102], [153, 204, 255], [255, 0, 0], [0, 255, 0]],
    );
    let exr = |name: &str, channels: usize, data: Vec<f32>| {
        let pixels = Pixels {
            width: 2,
            height: 2,
            channels,
            data,
        };
        write_exr_pixels(&dir.path().join(name), &pixels).unwrap();
    };
    exr("grey.exr", 1, vec![0.1, 0.2, 0.3, 0.4]);
    exr("bright.exr", 1, vec![0.1, 0.2, 1.5, 0.4]);
    exr("ringing.exr", 1, vec![9.0, -0.1, 5.0, -0.0]);
    exr("negative.exr", 1, vec![9.0, -0.4, 5.0, 0.0]);
    exr("infinite.exr", 1, vec![9.0, f32::INFINITY, -5.0, 0.0]);
    exr("smooth.exr", 1, vec![0.0, 0.5, 0.00005, 0.25]);
    exr("nan.exr", 1, vec![0.1, f32::NAN, 0.5, 0.4]);
    std::fs::write(dir.path().join("cut.exr"), b"\x76\x2f\x31\x01").unwrap();
    dir
}

fn load_in(
    dir: &Path,
    shapes: &str,
    allow_missing: bool,
) -> Result<(Scene, Vec<String>), SceneError> {
    let path = dir.join("scene.xml");
    let xml = format!(
        r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor>
{shapes}</scene>"#
    );
    std::fs::write(&path, xml).unwrap();
    let options = LoadOptions {
        allow_missing,
        ..LoadOptions::default()
    };
    Scene::load(&path, &options)
}

fn load(shapes: &str) -> Result<Scene, SceneError> {
    load_in(folder().path(), shapes, false).map(|(scene, _)| scene)
}

fn bitmap(name: &str, file: &str, extra: &str) -> String {
    format!(
        r#"<texture name="{name}" type="bitmap"><string name="filename" value="{file}"/>{extra}</texture>"#
    )
}

fn wall(texture: &str) -> String {
    format!(r#"<shape type="rectangle" id="s"><bsdf type="diffuse">{texture}</bsdf></shape>"#)
}

const RAW: &str = r#"<boolean name="raw" value="true"/>"#;

/// The albedo of the first material at `uv`.
fn albedo(scene: &Scene, uv: [f32; 2]) -> [f32; 3] {
    let at = Shading::new(
        Theta::constant(scene.params().values()),
        Vec2::new(uv[0], uv[1]),
    );
    let up = Vec3::new(0.0, 0.0, 1.0);
    let f = scene.materials()[0].eval(&at, up, up, TransportMode::Radiance);
    f.to_array().map(|x| x * std::f32::consts::PI)
}

fn assert_near(found: [f32; 3], expected: [f32; 3]) {
    for c in 0..3 {
        assert!(
            (found[c] - expected[c]).abs() < 1e-6,
            "{found:?} {expected:?}"
        );
    }
}

#[test]
fn row_zero_is_at_v_zero() {
    let scene = load(&wall(&bitmap("reflectance", "rgb.png", RAW))).unwrap();
    let info = &scene.params().infos()[0];
    assert_eq!(info.name, "s.bsdf.reflectance.data");
    let shape = ParamShape::Texture {
        height: 2,
        width: 2,
        channels: 3,
    };
    assert_eq!((info.shape, info.valid), (shape, (0.0, 1.0)));
    assert_near(albedo(&scene, [0.25, 0.25]), [0.0, 0.2, 0.4]);
    assert_near(albedo(&scene, [0.75, 0.25]), [0.6, 0.8, 1.0]);
    assert_near(albedo(&scene, [0.25, 0.75]), [1.0, 0.0, 0.0]);
    assert_near(albedo(&scene, [0.5, 0.25]), [0.3, 0.5, 0.7]);
}

#[test]
fn eight_bits_are_srgb_unless_raw() {
    let scene = load(&wall(&bitmap("reflectance", "rgb.png", ""))).unwrap();
    let linear = [0.0, 0.2, 0.4].map(|x| srgb_to_linear(x) as f32);
    assert_near(albedo(&scene, [0.25, 0.25]), linear);
    let scene = load(&wall(&bitmap("reflectance", "grey.exr", ""))).unwrap();
    assert_near(albedo(&scene, [0.75, 0.75]), [0.4; 3]);
}

#[test]
fn filters_wraps_and_transforms_are_obeyed() {
    let with = |extra: &str| {
        let extra = format!("{RAW}{extra}");
        load(&wall(&bitmap("reflectance", "rgb.png", &extra))).unwrap()
    };
    let scene = with(r#"<string name="filter_type" value="nearest"/>"#);
    assert_near(albedo(&scene, [0.45, 0.1]), [0.0, 0.2, 0.4]);
    assert_near(albedo(&scene, [1.45, -0.9]), [0.0, 0.2, 0.4]);
    let scene = with(r#"<string name="wrap_mode" value="clamp"/>"#);
    assert_near(albedo(&scene, [-3.0, -3.0]), [0.0, 0.2, 0.4]);
    let scene = with(r#"<string name="wrap_mode" value="mirror"/>"#);
    assert_near(albedo(&scene, [1.75, 0.25]), [0.0, 0.2, 0.4]);
    // As in Mitsuba 3: u' = 2 (u + 1/4), v' = 2 (v + 1/2).
    let scene = with(
        r#"<transform name="to_uv"><translate x="0.25" y="0.5"/><scale x="2" y="2"/></transform>"#,
    );
    assert_near(albedo(&scene, [0.125, 0.125]), [0.6, 0.8, 1.0]);
}

#[test]
fn numbers_from_colours_are_luminances() {
    let blend = format!(
        r#"<shape type="rectangle" id="s"><bsdf type="blendbsdf">{}
        <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
        <bsdf type="diffuse"><rgb name="reflectance" value="1"/></bsdf></bsdf></shape>"#,
        bitmap("weight", "rgb.png", RAW)
    );
    let scene = load(&blend).unwrap();
    let expected = 0.2 * 0.715_160 + 0.4 * 0.072_169;
    assert_near(albedo(&scene, [0.25, 0.25]), [expected; 3]);
}

#[test]
fn checkerboards_have_two_colours() {
    let texture = r#"<texture name="reflectance" type="checkerboard"><rgb name="color1" value="0.9 0.1 0.2"/>
        <transform name="to_uv"><scale x="2" y="2"/></transform></texture>"#;
    let scene = load(&wall(texture)).unwrap();
    let names: Vec<_> = scene.params().infos().iter().map(|i| &i.name[..]).collect();
    let of = |k| format!("s.bsdf.reflectance.color{k}.value");
    assert_eq!(names, [of(0), of(1)]);
    assert_near(albedo(&scene, [0.1, 0.1]), [0.4; 3]);
    assert_near(albedo(&scene, [0.3, 0.1]), [0.9, 0.1, 0.2]);
    assert_near(albedo(&scene, [0.3, 0.4]), [0.4; 3]);
}

/// At coordinates of the surface, whatever the squares are.
#[test]
fn checkerboards_show_images() {
    let texture = format!(
        r#"<texture name="reflectance" type="checkerboard">{}<rgb name="color1" value="0.9 0.1 0.2"/>
        <transform name="to_uv"><scale x="2" y="2"/></transform></texture>"#,
        bitmap("color0", "rgb.png", RAW)
    );
    let board = load(&wall(&texture)).unwrap();
    let image = load(&wall(&bitmap("reflectance", "rgb.png", RAW))).unwrap();
    let names: Vec<_> = board.params().infos().iter().map(|i| &i.name[..]).collect();
    let of = |name| format!("s.bsdf.reflectance.{name}");
    assert_eq!(names, [of("color0.data"), of("color1.value")]);
    assert_near(albedo(&board, [0.1, 0.1]), albedo(&image, [0.1, 0.1]));
    assert_near(albedo(&board, [0.3, 0.4]), albedo(&image, [0.3, 0.4]));
    assert_near(albedo(&board, [0.3, 0.1]), [0.9, 0.1, 0.2]);
    // Where the image is not there and may be absent, a constant stands for it.
    let missing = wall(&texture.replace("rgb.png", "none.png"));
    let (scene, warnings) = load_in(folder().path(), &missing, true).unwrap();
    assert_near(albedo(&scene, [0.1, 0.1]), [0.5; 3]);
    assert!(warnings[0].contains("none.png"), "{warnings:?}");
}

/// Numbers are on the other squares, as without images; the texels of both squares have their derivatives.
#[test]
fn squares_of_images_scatter_what_they_show() {
    let texture = format!(
        r#"<texture name="alpha" type="checkerboard">{}{}</texture>"#,
        bitmap("color0", "grey.exr", ""),
        bitmap(
            "color1",
            "grey.exr",
            r#"<string name="filter_type" value="nearest"/>"#
        )
    );
    let metal = format!(
        r#"<shape type="rectangle" id="s"><bsdf type="roughconductor">{texture}</bsdf></shape>"#
    );
    let scene = load(&metal).unwrap();
    let mut values = scene.params().values().to_vec();
    let [smooth, nearest] = ["color0", "color1"].map(|name| {
        let name = format!("s.bsdf.alpha.{name}.data");
        scene.params().find(&name).unwrap().range()
    });
    values[nearest.clone()].fill(0.9);
    let mut alpha = None;
    scene.materials()[0].visit_textures(&mut |t| {
        if let TextureRef::Alpha(t) = t {
            alpha = Some(t.clone());
        }
    });
    let alpha = alpha.unwrap();
    let theta = Theta::<f32>::constant(&values);
    assert_eq!(alpha.eval(&theta, Vec2::new(0.2, 0.3)), [0.9]);
    for [x, y] in [[0.2, 0.3], [0.7, 0.2], [0.1, 0.8], [0.9, 0.6]] {
        let uv = Vec2::new(x, y);
        let mut gradient = Gradient(vec![0.0; values.len()]);
        alpha.scatter(uv, Rgb::splat(1.0), &mut gradient);
        let shown = if (x > 0.5) == (y > 0.5) {
            &nearest
        } else {
            &smooth
        };
        let terms = gradient.0.iter().zip(&values);
        let sum: f32 = terms.map(|(d, v)| d * v).sum();
        assert!((sum - 3.0 * alpha.eval(&theta, uv)[0]).abs() < 1e-5);
        let mut all = gradient.0.iter().enumerate();
        assert!(all.all(|(i, d)| *d == 0.0 || shown.contains(&i)));
    }
}

/// As Mitsuba 3 has it.
#[test]
fn numbers_of_a_checkerboard_are_on_the_other_squares() {
    let blend = r#"<shape type="rectangle" id="s"><bsdf type="blendbsdf">
        <texture name="weight" type="checkerboard"><float name="color0" value="0.1"/><float name="color1" value="0.8"/></texture>
        <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
        <bsdf type="diffuse"><rgb name="reflectance" value="1"/></bsdf></bsdf></shape>"#;
    let scene = load(blend).unwrap();
    let names: Vec<_> = scene.params().infos().iter().map(|i| &i.name[..]).collect();
    assert_eq!(
        names[..2],
        ["s.bsdf.weight.color0.value", "s.bsdf.weight.color1.value"]
    );
    assert_near(albedo(&scene, [0.2, 0.2]), [0.8; 3]);
    assert_near(albedo(&scene, [0.7, 0.7]), [0.8; 3]);
    assert_near(albedo(&scene, [0.7, 0.2]), [0.1; 3]);
}

#[test]
fn a_shared_texture_has_its_parameters_once() {
    let shapes = format!(
        r#"<texture type="bitmap" id="t"><string name="filename" value="rgb.png"/></texture>
        <shape type="rectangle" id="a"><bsdf type="diffuse"><ref name="reflectance" id="t"/></bsdf></shape>
        <shape type="rectangle" id="b"><bsdf type="diffuse"><ref name="reflectance" id="t"/></bsdf></shape>
        {}"#,
        wall(&bitmap("reflectance", "rgb.png", ""))
    );
    let scene = load(&shapes).unwrap();
    let names: Vec<_> = scene.params().infos().iter().map(|i| &i.name[..]).collect();
    assert_eq!(
        names,
        ["a.bsdf.reflectance.data", "s.bsdf.reflectance.data"]
    );
    assert_eq!(scene.materials().len(), 3);
}

#[test]
fn missing_files_are_errors_or_grey() {
    let dir = folder();
    let shapes = wall(&bitmap("reflectance", "none.png", ""));
    let error = load_in(dir.path(), &shapes, false).unwrap_err().to_string();
    assert!(error.contains("scene.xml:2: `filename`"), "{error}");
    assert!(
        error.contains("an existing file") && error.contains("none.png"),
        "{error}"
    );
    let (scene, warnings) = load_in(dir.path(), &shapes, true).unwrap();
    assert_near(albedo(&scene, [0.3, 0.3]), [0.5; 3]);
    assert_eq!(scene.params().infos()[0].name, "s.bsdf.reflectance.value");
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].contains("scene.xml:2:") && warnings[0].contains("none.png"));
    assert!(warnings[0].contains("`s.bsdf.reflectance` is [0.5, 0.5, 0.5] instead"));
    // What is there but damaged is not missing.
    let shapes = wall(&bitmap("reflectance", "cut.exr", ""));
    assert!(load_in(dir.path(), &shapes, true).is_err());
}

/// A roughness of zero is that of Mitsuba, the least there is; nothing else is changed.
#[test]
fn zero_roughness_is_the_least_and_said() {
    let dir = folder();
    let load = |alpha: &str| {
        let metal = format!(
            r#"<shape type="rectangle" id="s"><bsdf type="roughconductor">{alpha}</bsdf></shape>"#
        );
        load_in(dir.path(), &metal, false)
    };
    let (scene, warnings) = load(r#"<float name="alpha" value="0"/>"#).unwrap();
    assert_eq!(scene.params().get("s.bsdf.alpha").unwrap(), [1e-4]);
    let expected = "scene.xml:2: bsdf `roughconductor`: `alpha` is 0.0001 instead of 0, the least that it may be";
    assert!(
        warnings.len() == 1 && warnings[0].ends_with(expected),
        "{warnings:?}"
    );
    let (scene, warnings) = load(&bitmap("alpha", "smooth.exr", RAW)).unwrap();
    assert_eq!(
        scene.params().get("s.bsdf.alpha").unwrap(),
        [1e-4, 0.5, 1e-4, 0.25]
    );
    let expected =
        "smooth.exr: 2 numbers for `s.bsdf.alpha` are less than 0.0001; they are that instead";
    assert!(
        warnings.len() == 1 && warnings[0].ends_with(expected),
        "{warnings:?}"
    );
    let board =
        r#"<texture type="checkerboard" name="alpha"><float name="color0" value="0"/></texture>"#;
    let (scene, warnings) = load(board).unwrap();
    assert_eq!(scene.params().get("s.bsdf.alpha.color0").unwrap(), [1e-4]);
    assert_eq!(warnings.len(), 1);
    for (alpha, found) in [("1.5", "1.5"), ("-0.1", "-0.1")] {
        let error = load(&format!(r#"<float name="alpha" value="{alpha}"/>"#)).unwrap_err();
        let expected = format!(
            "scene.xml:2: `s.bsdf.alpha.value`: expected a number in [0.0001, 1], found {found}"
        );
        assert!(error.to_string().ends_with(&expected), "{error}");
    }
    // Zero means something where it is one of the values.
    let (_, warnings) = load(r#"<rgb name="specular_reflectance" value="0"/>"#).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
}

/// Environment maps are negative beside the sun, once they have been resampled.
#[test]
fn slightly_negative_emission_is_zero_and_said() {
    let dir = folder();
    let sky = |file: &str| {
        format!(
            r#"<emitter type="envmap" id="sky"><string name="filename" value="{file}"/></emitter>"#
        )
    };
    let (scene, warnings) = load_in(dir.path(), &sky("ringing.exr"), false).unwrap();
    assert_eq!(scene.params().values()[..6], [9.0, 9.0, 9.0, 0.0, 0.0, 0.0]);
    let expected =
        "ringing.exr: 3 of 12 numbers for `sky` are slightly negative; they are zero instead";
    assert!(
        matches!(&warnings[..], [w] if w.contains(expected)),
        "{warnings:?}"
    );
    let error = load_in(dir.path(), &sky("negative.exr"), false)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("texels from 0 to inf for `sky`, found -0.4 at column 1, row 0"),
        "{error}"
    );
    let error = load_in(dir.path(), &sky("infinite.exr"), false).unwrap_err();
    assert!(
        error.to_string().contains("found inf at column 1, row 0"),
        "{error}"
    );
    // Nothing else may be negative.
    let error = load(&wall(&bitmap("reflectance", "ringing.exr", ""))).unwrap_err();
    assert!(error.to_string().contains("texels from 0 to 1"), "{error}");
}

#[test]
fn faulty_textures_are_named() {
    let reflectance = |file: &str, extra: &str| wall(&bitmap("reflectance", file, extra));
    for (shapes, expected) in [
        (
            reflectance("bright.exr", ""),
            "bright.exr: expected texels from 0 to 1 for `s.bsdf.reflectance`, found 1.5 at column 0, row 1",
        ),
        (reflectance("nan.exr", ""), "found NaN at column 1, row 0"),
        (reflectance("cut.exr", ""), "cut.exr: expected"),
        (
            reflectance("scene.xml", ""),
            "an OpenEXR, Radiance, PFM, PNG, JPEG, BMP, TGA, PBM, PGM or PPM image",
        ),
        (
            reflectance("rgb.png", r#"<string name="wrap_mode" value="x"/>"#),
            "`mirror`",
        ),
        (
            reflectance("rgb.png", r#"<string name="filter_type" value="x"/>"#),
            "`nearest`",
        ),
        (
            reflectance("rgb.png", r#"<float name="raw" value="1"/>"#),
            "true or false",
        ),
        (
            reflectance("rgb.png", r#"<float name="gamma" value="0"/>"#),
            "`gamma`: expected a positive number",
        ),
        (
            wall(r#"<texture name="reflectance" type="bitmap"/>"#),
            "has no `filename`",
        ),
        (
            wall(r#"<texture name="reflectance" type="marble"/>"#),
            "known: bitmap, checkerboard",
        ),
        (
            wall(
                r#"<texture name="reflectance" type="checkerboard"><float name="color0" value="2"/></texture>"#,
            ),
            "s.bsdf.reflectance.color0.value",
        ),
    ] {
        let error = load(&shapes).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}
