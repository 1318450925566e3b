//! Scene files of versions 0.4 to 0.6: what they say in other words, what stands in for it, and what is refused by name.

use std::path::Path;

use render::image_io::{Pixels, write_exr_pixels, write_png};
use render::instances::{Estimator, render_f32};
use render::params::Theta;
use render::scene::LoadOptions;
use render::{Image, Job, Scene};

/// A picture of eight by two grey steps as `steps.png` and its linear values as `steps.exr`, and a triangle, in a folder.
fn folder() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let image = Image {
        width: 8,
        height: 2,
        data: (0..16).flat_map(|i| [0.05 * i as f32; 3]).collect(),
    };
    write_png(&dir.path().join("steps.png"), &image, 0.0).unwrap();
    let pixels = Pixels {
        width: 8,
        height: 2,
        channels: 3,
        data: image.data,
    };
    write_exr_pixels(&dir.path().join("steps.exr"), &pixels).unwrap();
    let mesh = "v -1 -1 0\nv 1 -1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n";
    std::fs::write(dir.path().join("mesh.obj"), mesh).unwrap();
    dir
}

const VIEW: &str = r#"<sensor type="perspective"><float name="fov" value="40"/>
<transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/><rfilter type="box"/></film></sensor>
<emitter type="constant"><rgb name="radiance" value="1"/></emitter>"#;

/// A scene of a version, and its warnings.
fn load(dir: &Path, version: &str, body: &str) -> Result<(Scene, Vec<String>), String> {
    let text = format!("<scene version=\"{version}\">{body}</scene>");
    Scene::from_xml(&text, dir, &LoadOptions::default()).map_err(|e| e.to_string())
}

fn picture(scene: &Scene) -> Vec<f32> {
    let job = Job::new(scene, &scene.settings, 1, 0..4, &());
    let theta = Theta::constant(scene.params().values());
    render_f32(&job, &theta, Estimator::Mis).image(0).data
}

/// A rectangle of this material in view.
fn wall(material: &str) -> String {
    format!("{VIEW}<shape type=\"rectangle\">{material}</shape>")
}

fn bitmap(inner: &str) -> String {
    wall(&format!(
        "<bsdf type=\"diffuse\"><texture type=\"bitmap\" name=\"reflectance\"><string name=\"filename\" \
         value=\"steps.png\"/>{inner}</texture></bsdf>"
    ))
}

fn conductor(inner: &str) -> String {
    wall(&format!("<bsdf type=\"conductor\">{inner}</bsdf>"))
}

fn glass(inner: &str) -> String {
    wall(&format!("<bsdf type=\"dielectric\">{inner}</bsdf>"))
}

fn rough(plugin: &str, distribution: &str, inner: &str) -> String {
    let distribution = string("distribution", distribution);
    wall(&format!(
        "<bsdf type=\"{plugin}\">{distribution}{inner}</bsdf>"
    ))
}

/// A normal map whose texture may have a name.
fn mapped(name: &str, encoding: &str) -> String {
    wall(&format!(
        "<bsdf type=\"normalmap\"><texture type=\"bitmap\"{name}><string name=\"filename\" value=\"steps.png\"/>\
         {encoding}</texture><bsdf type=\"diffuse\"/></bsdf>"
    ))
}

fn mesh(inner: &str) -> String {
    let name = string("filename", "mesh.obj");
    format!("{VIEW}<shape type=\"obj\">{name}{inner}</shape>")
}

fn film(plugin: &str, inner: &str) -> String {
    wall("").replace(
        "<film type=\"hdrfilm\">",
        &format!("<film type=\"{plugin}\">{inner}"),
    )
}

fn integrator(plugin: &str, inner: &str) -> String {
    let rest = wall("");
    format!("<integrator type=\"{plugin}\">{inner}</integrator>{rest}")
}

fn string(name: &str, value: &str) -> String {
    format!("<string name=\"{name}\" value=\"{value}\"/>")
}

fn float(name: &str, value: f64) -> String {
    format!("<float name=\"{name}\" value=\"{value}\"/>")
}

fn flag(name: &str, value: bool) -> String {
    format!("<boolean name=\"{name}\" value=\"{value}\"/>")
}

/// An old file, what it means in version 3, and what is warned of, if anything.
type Pair = (String, String, &'static str);

/// What old files say is what these of version 3 say.
fn same(pairs: &[Pair]) {
    let dir = folder();
    for (old, new, warned) in pairs {
        let expected = load(dir.path(), "3.0.0", new);
        let expected = expected.unwrap_or_else(|e| panic!("{e}\n{new}")).0;
        for version in ["0.4.0", "0.6.0"] {
            let found = load(dir.path(), version, old);
            let (scene, warnings) = found.unwrap_or_else(|e| panic!("{e}\n{old}"));
            if warned.is_empty() {
                assert!(warnings.is_empty(), "{old}\n{warnings:?}");
            } else {
                let said = warnings.iter().any(|w| w.contains(warned));
                assert!(said, "{old}\n{warnings:?}");
            }
            let (a, b) = (scene.params(), expected.params());
            assert_eq!(a.values().len(), b.values().len(), "{old}");
            for (a, b) in a.values().iter().zip(b.values()) {
                assert!((a - b).abs() <= 1e-6 * b.abs(), "{old}: {a} {b}");
            }
            for (a, b) in picture(&scene).iter().zip(picture(&expected)) {
                assert!((a - b).abs() <= 1e-5 * (1.0 + b.abs()), "{old}: {a} {b}");
            }
        }
    }
}

#[test]
fn old_textures_mean_what_new_ones_do() {
    let both = |mode: &str| string("wrapModeU", mode) + &string("wrapModeV", mode);
    same(&[
        (
            bitmap(&string("filterType", "ewa")),
            bitmap(""),
            "filter `ewa`: `bilinear` instead",
        ),
        (
            bitmap(&string("filterType", "trilinear")),
            bitmap(""),
            "filter `trilinear`: `bilinear` instead",
        ),
        (
            bitmap(&float("maxAnisotropy", 8.0)),
            bitmap(""),
            "`max_anisotropy` has no effect",
        ),
        (
            bitmap(&flag("cache", true)),
            bitmap(""),
            "`cache` has no effect",
        ),
        (bitmap(&float("gamma", -1.0)), bitmap(""), ""),
        (bitmap(&float("gamma", 1.0)), bitmap(&flag("raw", true)), ""),
        (
            bitmap(&both("clamp")),
            bitmap(&string("wrap_mode", "clamp")),
            "",
        ),
        (bitmap(&string("wrapModeV", "repeat")), bitmap(""), ""),
        (
            mapped("", &float("gamma", 1.0)),
            mapped(" name=\"normalmap\"", &flag("raw", true)),
            "",
        ),
    ]);
}

#[test]
fn old_materials_mean_what_new_ones_do() {
    let of_eta = |eta: f64, k: f64| float("eta", eta) + &float("k", k);
    let gold = string("material", "Au");
    let grey = |intent: &str| {
        wall(&format!(
            "<bsdf type=\"diffuse\"><rgb name=\"reflectance\"{intent} value=\"0.3\"/></bsdf>"
        ))
    };
    same(&[
        (
            conductor(""),
            conductor(&string("material", "Cu")),
            "copper, as a metal without `material` was before version 2; Mitsuba 3 would make it a perfect mirror",
        ),
        (conductor(&string("material", "none")), conductor(""), ""),
        (
            conductor(&(of_eta(0.6, 3.0) + &float("extEta", 1.5))),
            conductor(&of_eta(0.4, 2.0)),
            "",
        ),
        (
            conductor(&(of_eta(0.6, 3.0) + &string("extEta", "vacuum"))),
            conductor(&of_eta(0.6, 3.0)),
            "",
        ),
        (
            rough("roughconductor", "phong", &gold),
            rough("roughconductor", "beckmann", &gold),
            "distribution `phong`: Beckmann's",
        ),
        (
            rough("roughplastic", "as", ""),
            rough("roughplastic", "beckmann", ""),
            "distribution `as`: Beckmann's",
        ),
        (
            glass(&(float("intEta", 1.7) + &float("extEta", 1.2))),
            glass(&(float("int_ior", 1.7) + &float("ext_ior", 1.2))),
            "",
        ),
        (grey(" intent=\"reflectance\""), grey(""), ""),
    ]);
}

#[test]
fn old_films_shapes_and_integrators_mean_what_new_ones_do() {
    let path = integrator("path", "");
    let hdr = film("hdrfilm", "");
    let toned = float("gamma", 2.2) + &string("tonemapMethod", "reinhard") + &flag("banner", true);
    let both = flag("lightImage", true) + &flag("sampleDirect", true);
    same(&[
        (
            mesh(&flag("collapse", true)),
            mesh(""),
            "`collapse` has no effect",
        ),
        (
            integrator("path", &flag("strictNormals", false)),
            path.clone(),
            "",
        ),
        (
            integrator("path", &flag("strictNormals", true)),
            path.clone(),
            "`strict_normals`: light is not left out",
        ),
        (
            integrator("bdpt", &both),
            path.clone(),
            "traced like `path` instead",
        ),
        (
            integrator("transientpath", ""),
            path,
            "traced like `path` instead",
        ),
        (
            film("ldrfilm", &toned),
            hdr.clone(),
            "film `ldrfilm`: written as OpenEXR",
        ),
        (
            film("mfilm", &string("variable", "data")),
            hdr.clone(),
            "film `mfilm`: written as OpenEXR",
        ),
        (
            film("pngfilm", ""),
            hdr.clone(),
            "film `pngfilm`: written as OpenEXR",
        ),
        (
            film("streakhdrfilm", ""),
            hdr.clone(),
            "film `streakhdrfilm`: light is summed",
        ),
        (
            film("hdrfilm", &string("pixelFormat", "luminance")),
            hdr.clone(),
            "`pixel_format`: written in red",
        ),
        (
            film("hdrfilm", &string("label[10, 10]", "hello")),
            hdr,
            "`label[10, 10]` has no effect",
        ),
    ]);
    // An alpha channel is one in any format.
    let dir = folder();
    for (format, alpha) in [("luminanceAlpha", true), ("xyza", true), ("xyz", false)] {
        let body = film("hdrfilm", &string("pixelFormat", format));
        let (scene, _) = load(dir.path(), "0.6.0", &body).unwrap();
        assert_eq!(scene.film.alpha, alpha, "{format}");
    }
    // Files of today do not speak like that.
    for old in [
        bitmap(&string("filterType", "ewa")),
        bitmap(&flag("cache", true)),
        mesh(&flag("collapse", true)),
        integrator("path", &flag("strictNormals", true)),
        rough("roughplastic", "as", ""),
    ] {
        assert!(load(dir.path(), "3.0.0", &old).is_err(), "{old}");
    }
}

/// Texels of images with a gamma are their samples to that power.
#[test]
fn images_have_a_gamma() {
    let dir = folder();
    let texels = |inner: &str| {
        let (scene, _) = load(dir.path(), "0.6.0", &bitmap(inner)).unwrap();
        scene
            .params()
            .get("shape0.bsdf.reflectance")
            .unwrap()
            .to_vec()
    };
    let raw = texels("<float name=\"gamma\" value=\"1\"/>");
    let steep = texels("<float name=\"gamma\" value=\"2.5\"/>");
    assert!(raw.len() == 48 && raw[45] > 0.5);
    for (raw, steep) in raw.iter().zip(steep) {
        assert!((raw.powf(2.5) - steep).abs() < 1e-6, "{raw} {steep}");
    }
    let exr = bitmap("<float name=\"gamma\" value=\"2.2\"/>").replace("steps.png", "steps.exr");
    let error = load(dir.path(), "0.6.0", &exr).unwrap_err();
    assert!(
        error.contains(
            "expected an image of 8 or 16 bits, which has a gamma, found one of linear numbers"
        ),
        "{error}"
    );
    let error = load(
        dir.path(),
        "0.6.0",
        &bitmap("<float name=\"gamma\" value=\"0\"/>"),
    )
    .unwrap_err();
    assert!(
        error.contains("`gamma`: expected a positive number"),
        "{error}"
    );
}

/// What stands for something that is left out says so.
#[test]
fn old_plugins_are_refused_by_name() {
    let dir = folder();
    let shape = |inner: &str| wall(inner);
    let mesh = format!(
        "{VIEW}<shape type=\"obj\"><string name=\"filename\" value=\"mesh.obj\"/><float name=\"maxSmoothAngle\" value=\"30\"/></shape>"
    );
    for (body, expected) in [
        (
            mesh,
            "shape `obj with max_smooth_angle`: normals that break where faces meet at an angle are not there",
        ),
        (
            bitmap("<string name=\"channel\" value=\"r\"/>"),
            "texture `bitmap with channel`: a single channel of an image is not there",
        ),
        (
            bitmap("<string name=\"wrapModeU\" value=\"clamp\"/>"),
            "texture `bitmap with wrap_mode_u`: an image that goes on in another way along u than along v is not there",
        ),
        (
            shape("<subsurface type=\"dipole\"/>"),
            "subsurface `dipole`: scattering below surfaces is not there",
        ),
        (
            shape("<animation name=\"toWorld\"/>"),
            "motion while the shutter is open is not there",
        ),
        (
            shape("<bsdf type=\"ward\"/>"),
            "bsdf `ward`: a model of roughness that Mitsuba 3 has no more is not there",
        ),
        (
            shape("<bsdf type=\"phong\"/>"),
            "bsdf `phong`: a model of roughness that Mitsuba 3 has no more is not there",
        ),
        (
            shape(
                "<bsdf type=\"mixturebsdf\"><string name=\"weights\" value=\"0.5, -0.5\"/><bsdf type=\"diffuse\"/><bsdf type=\"diffuse\"/></bsdf>",
            ),
            "bsdf `mixturebsdf`: a sum of materials other than `blendbsdf` is not there",
        ),
    ] {
        let error = load(dir.path(), "0.6.0", &body).unwrap_err();
        assert!(error.contains(expected), "{error}");
    }
}

/// A factor on a texture is in its texels, and one on heights is one on the displacement.
#[test]
fn scaled_textures_are_products() {
    let dir = folder();
    let scaled = |factor: &str, inside: &str| {
        wall(&format!(
            "<bsdf type=\"diffuse\"><texture type=\"scale\" name=\"reflectance\">{factor}{inside}</texture></bsdf>"
        ))
    };
    const STEPS: &str =
        "<texture type=\"bitmap\"><string name=\"filename\" value=\"steps.exr\"/></texture>";
    let texels = |body: &str| {
        let (scene, _) = load(dir.path(), "0.6.0", body).unwrap();
        scene
            .params()
            .get("shape0.bsdf.reflectance")
            .unwrap()
            .to_vec()
    };
    let plain = texels(&bitmap("").replace("steps.png", "steps.exr"));
    let half = texels(&scaled("<float name=\"scale\" value=\"0.5\"/>", STEPS));
    let red = texels(&scaled("<rgb name=\"scale\" value=\"1, 0, 0.25\"/>", STEPS));
    for (i, x) in plain.iter().enumerate() {
        assert_eq!(half[i], 0.5 * x);
        assert_eq!(red[i], [1.0, 0.0, 0.25][i % 3] * x);
    }
    let squares = "<texture type=\"checkerboard\"><rgb name=\"color0\" value=\"0.8\"/><rgb name=\"color1\" value=\"0.4\"/></texture>";
    let (scene, _) = load(
        dir.path(),
        "0.6.0",
        &scaled("<float name=\"scale\" value=\"0.5\"/>", squares),
    )
    .unwrap();
    let colour = |key: &str| {
        scene
            .params()
            .get(&format!("shape0.bsdf.reflectance.{key}"))
            .unwrap()[0]
    };
    assert_eq!([colour("color0"), colour("color1")], [0.4, 0.2]);
    let error = load(
        dir.path(),
        "0.6.0",
        &scaled("<float name=\"scale\" value=\"2\"/>", STEPS),
    )
    .unwrap_err();
    assert!(
        error
            .contains("`scale`: expected a factor that leaves a number in [0, 1], none of them 1."),
        "{error}"
    );

    let bumps = |inside: &str| {
        wall(&format!(
            "<bsdf type=\"bumpmap\">{inside}<bsdf type=\"diffuse\"/></bsdf>"
        ))
    };
    let nested =
        format!("<texture type=\"scale\"><float name=\"scale\" value=\"0.25\"/>{STEPS}</texture>");
    let own = format!("<float name=\"scale\" value=\"0.25\"/>{STEPS}");
    let [nested, own, flat] = [
        nested,
        own,
        "<float name=\"scale\" value=\"0\"/>".to_owned() + STEPS,
    ]
    .map(|inside| picture(&load(dir.path(), "0.6.0", &bumps(&inside)).unwrap().0));
    let largest = |a: &[f32], b: &[f32]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max)
    };
    assert!(largest(&nested, &own) < 1e-5 && largest(&nested, &flat) > 1e-3);
}

/// A mixture of materials is one of blends, each part with its weight; what the weights leave over is black.
#[test]
fn mixtures_are_blends() {
    use render::plugin::Node;
    use render::plugin::xml::Document;
    fn shares(node: &Node, share: f64, out: &mut Vec<(f64, f64)>) {
        match node.plugin.as_str() {
            "blendbsdf" => {
                let weight = node.float("weight").unwrap().unwrap();
                let parts = node.children_with_tag("bsdf");
                assert_eq!(parts.len(), 2);
                shares(parts[0], share * (1.0 - weight), out);
                shares(parts[1], share * weight, out);
            }
            _ => out.push((node.rgb("reflectance").unwrap().unwrap()[0], share)),
        }
    }
    let part =
        |x: f64| format!("<bsdf type=\"diffuse\"><rgb name=\"reflectance\" value=\"{x}\"/></bsdf>");
    for (weights, expected) in [
        ("0.2, 0.3, 0.5", vec![(0.1, 0.2), (0.2, 0.3), (0.3, 0.5)]),
        ("0.2 0.3", vec![(0.1, 0.2), (0.2, 0.3), (0.0, 0.5)]),
        ("0.6", vec![(0.1, 0.6), (0.0, 0.4)]),
        ("1", vec![(0.1, 1.0), (0.0, 0.0)]),
        // More than all is all, in these proportions.
        ("3, 1", vec![(0.1, 0.75), (0.2, 0.25)]),
    ] {
        let count = weights.split([',', ' ']).filter(|w| !w.is_empty()).count();
        let parts: String = (1..=count).map(|i| part(0.1 * i as f64)).collect();
        let text = format!(
            "<scene version=\"0.5.0\"><bsdf type=\"mixturebsdf\"><string name=\"weights\" value=\"{weights}\"/>{parts}</bsdf></scene>"
        );
        let document = Document::from_str(&text, Path::new("."), &[]).unwrap();
        let mut found = Vec::new();
        shares(
            document.root().children_with_tag("bsdf")[0],
            1.0,
            &mut found,
        );
        assert_eq!(found.len(), expected.len(), "{weights}: {found:?}");
        for ((a, share), (b, wanted)) in found.iter().zip(&expected) {
            assert!(
                (a - b).abs() < 1e-9 && (share - wanted).abs() < 1e-9,
                "{weights}: {found:?}"
            );
        }
    }
    let dir = folder();
    let mixed = wall(&format!(
        "<bsdf type=\"mixturebsdf\"><string name=\"weights\" value=\"0.2, 0.3, 0.5\"/>{}{}{}</bsdf>",
        part(0.1),
        part(0.2),
        part(0.3)
    ));
    assert!(load(dir.path(), "0.6.0", &mixed).unwrap().1.is_empty());
}
