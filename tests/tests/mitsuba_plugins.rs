//! Images of single plugins against Mitsuba 3, rendered by both where its package is present: `RENDER_PYTHON`, or
//! `python3`, has to be able to import it; skipped otherwise.
//!
//! Rule: 32 runs of each renderer with 16 samples per pixel; the means of all blocks of 4 x 4 pixels agree within the Sidak
//! limit at 1e-3 over all blocks, channels and scenes. `roughplastic` is not among them: as `RoughPlastic` says, ours
//! conserves energy where Mitsuba's loses some.

use std::path::Path;
use std::process::Command;

use render::image_io::{Pixels, write_exr, write_exr_pixels};
use render::instances::{Estimator, render_f32};
use render::params::Theta;
use render::scene::LoadOptions;
use render::{Image, Job, Scene};
use serde_json::Value;
use tests::stats::{Estimate, z_limit};

const RUNS: u64 = 32;
const SIZE: usize = 32;
const BLOCK: usize = 4;

/// Means of blocks, for each run of each scene: a list of lists of lists.
const MITSUBA: &str = r#"
import json, sys
import numpy as np
import mitsuba as mi
mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)
out = []
for path in sys.argv[2:]:
    scene = mi.load_file(path)
    runs = []
    for seed in range(int(sys.argv[1])):
        image = np.array(mi.render(scene, seed=seed))[..., :3]
        n = image.shape[0] // 4
        runs.append(image.reshape(n, 4, n, 4, 3).mean((1, 3)).ravel().tolist())
    out.append(runs)
print(json.dumps(out))
"#;

const FILM: &str = r#"<film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/>
    <rfilter type="box"/></film><sampler type="independent"><integer name="sample_count" value="16"/></sampler>
    <transform name="to_world"><lookat origin="0.3, 1.4, 4" target="0, 0.4, 0" up="0, 1, 0"/></transform>
    <float name="fov" value="40"/>"#;
const FLOOR: &str = r#"<shape type="rectangle">
    <transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf></shape>"#;
const LIGHT: &str = r#"<shape type="rectangle">
    <transform name="to_world"><scale value="0.8"/><rotate x="1" angle="90"/><translate x="0.5" y="3" z="1"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
    <emitter type="area"><rgb name="radiance" value="5, 4, 3"/></emitter></shape>
    <emitter type="constant"><rgb name="radiance" value="0.4, 0.5, 0.6"/></emitter>"#;
const BEAM: &str = r#"<shape type="rectangle"><transform name="to_world"><scale x="0.9" y="0.6"/><rotate x="1" angle="70"/>
    <translate x="0.2" y="2.5" z="0.3"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
    <emitter type="directionalarea"><rgb name="radiance" value="5, 4, 3"/></emitter></shape>"#;
const IN_THE_WAY: &str = r#"<shape type="sphere"><point name="center" x="0.1" y="0.9" z="2"/>
    <float name="radius" value="0.3"/><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>
    <emitter type="area"><rgb name="radiance" value="5, 4, 3"/></emitter></shape>
    <shape type="cube"><transform name="to_world"><scale value="0.2"/><rotate x="1" angle="150"/>
    <translate x="-0.2" y="0.8" z="1.4"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.2"/></bsdf>
    <emitter type="area"><rgb name="radiance" value="3, 4, 5"/></emitter></shape>"#;
const DIFFUSE: &str =
    r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf>"#;
const AIMED: &str = r#"<transform name="to_world"><lookat origin="1, 2.5, 1" target="0, 0, 0" up="0, 0, 1"/></transform>"#;

/// What both renderers call a conductor.
const METALS: [&str; 6] = ["Au", "Ag", "Al", "Cu", "Cr", "W"];

/// Materials of a ball between a lamp and a floor.
fn materials() -> Vec<(String, String)> {
    let fixed = [
        (
            "thindielectric",
            r#"<float name="int_ior" value="1.5"/><rgb name="specular_transmittance" value="0.8, 0.9, 0.7"/>"#,
        ),
        ("null", ""),
        (
            "principled",
            r#"<rgb name="base_color" value="0.7, 0.3, 0.2"/><float name="roughness" value="0.6"/>
            <float name="metallic" value="0.3"/><float name="specular" value="0.6"/><float name="flatness" value="0.3"/>
            <float name="sheen" value="0.4"/><float name="clearcoat" value="0.5"/><float name="clearcoat_gloss" value="0.1"/>"#,
        ),
        (
            "principled",
            r#"<rgb name="base_color" value="0.7, 0.3, 0.2"/><float name="roughness" value="0.3"/>
            <float name="metallic" value="1"/>"#,
        ),
        (
            "principled",
            r#"<rgb name="base_color" value="0.2, 0.3, 0.2"/><float name="roughness" value="0.8"/>
            <float name="clearcoat" value="1"/><float name="clearcoat_gloss" value="0.9"/>"#,
        ),
        (
            "principled",
            r#"<rgb name="base_color" value="0.7, 0.3, 0.2"/><float name="roughness" value="0.5"/>
            <float name="metallic" value="0.6"/><float name="anisotropic" value="0.8"/>"#,
        ),
        (
            "principled",
            r#"<rgb name="base_color" value="0.7, 0.5, 0.4"/><float name="roughness" value="0.5"/>
            <float name="metallic" value="0.2"/><float name="spec_trans" value="0.8"/><float name="eta" value="1.5"/>
            <float name="sheen" value="0.4"/><float name="clearcoat" value="0.5"/><float name="clearcoat_gloss" value="0.1"/>"#,
        ),
        (
            "principled",
            r#"<rgb name="base_color" value="0.7, 0.9, 0.8"/><float name="roughness" value="0.4"/>
            <float name="anisotropic" value="0.6"/><float name="spec_trans" value="1"/><float name="specular" value="0.5"/>"#,
        ),
        (
            "principled",
            r#"<rgb name="base_color" value="0.7, 0.3, 0.2"/><float name="roughness" value="0.3"/>
            <float name="metallic" value="0.2"/><float name="specular" value="0.9"/><float name="spec_tint" value="0.8"/>
            <float name="sheen" value="1"/><float name="sheen_tint" value="0.7"/>"#,
        ),
        (
            "principled",
            r#"<rgb name="base_color" value="0.2, 0.5, 0.7"/><float name="roughness" value="0.5"/>
            <float name="eta" value="1.8"/><float name="spec_tint" value="1"/><float name="anisotropic" value="0.6"/>
            <float name="spec_trans" value="0.5"/>"#,
        ),
        (
            "roughconductor",
            r#"<string name="distribution" value="ggx"/><float name="alpha_u" value="0.4"/>
            <float name="alpha_v" value="0.1"/><string name="material" value="Cu"/>"#,
        ),
        (
            "roughconductor",
            r#"<string name="distribution" value="beckmann"/><float name="alpha_u" value="0.1"/>
            <float name="alpha_v" value="0.5"/>"#,
        ),
        (
            "roughdielectric",
            r#"<string name="distribution" value="ggx"/><float name="alpha_u" value="0.4"/>
            <float name="alpha_v" value="0.15"/><float name="int_ior" value="1.5"/>"#,
        ),
    ];
    let mut all: Vec<_> = (fixed.iter().enumerate())
        .map(|(i, (plugin, body))| {
            (
                format!("{plugin}{i}"),
                format!(r#"<bsdf type="{plugin}">{body}</bsdf>"#),
            )
        })
        .collect();
    for metal in METALS {
        let bsdf =
            format!(r#"<bsdf type="conductor"><string name="material" value="{metal}"/></bsdf>"#);
        all.push((format!("conductor-{metal}"), bsdf));
    }
    // Numbers on a checkerboard are not where colours are. Mitsuba's path tracer is wrong about masks, and about blends with
    // what is not rough.
    let squares = |name: &str| {
        format!(
            r#"<texture name="{name}" type="checkerboard"><float name="color0" value="0.2"/><float name="color1" value="0.9"/>
            <transform name="to_uv"><scale x="4" y="3"/></transform></texture>"#
        )
    };
    let metal = format!(r#"<bsdf type="roughconductor">{}</bsdf>"#, squares("alpha"));
    let blend = format!(
        r#"<bsdf type="blendbsdf">{}{metal}{DIFFUSE}</bsdf>"#,
        squares("weight")
    );
    all.extend([
        ("checkered weight".into(), blend),
        ("checkered alpha".into(), metal),
    ]);
    all
}

/// A bump map over `nested`, with heights up to `scale`.
fn bumps(scale: f64, options: &str, nested: &str) -> String {
    format!(
        r#"<bsdf type="bumpmap"><texture name="heights" type="bitmap"><string name="filename" value="heights.exr"/>
        <boolean name="raw" value="true"/></texture><float name="scale" value="{scale}"/>{options}{nested}</bsdf>"#
    )
}

/// A ball with a bump map, a stretched cube and a mesh with normals and coordinates of its own, all but the ball before a
/// floor: with the corrections of Mitsuba 3.9, and without.
fn bumped() -> Vec<(String, String)> {
    let metal = r#"<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>"#;
    let plain = r#"<boolean name="flip_invalid_normals" value="false"/><boolean name="use_shadowing_function" value="false"/>"#;
    let of = |name: &str, options: &str, ball: &str| {
        let cube = format!(
            r#"<shape type="cube"><transform name="to_world"><scale x="0.3" y="0.5" z="0.2"/><rotate y="1" angle="30"/>
            <translate x="-1.2" y="0.5" z="0.3"/></transform>{}</shape>"#,
            bumps(0.05, options, DIFFUSE)
        );
        let mesh = format!(
            r#"<shape type="obj"><string name="filename" value="patch.obj"/><transform name="to_world">
            <translate x="1.2" y="0.2" z="0.3"/></transform><bsdf type="twosided">{}</bsdf></shape>"#,
            bumps(0.1, options, metal)
        );
        let ball = bumps(0.1, options, ball);
        let body = format!("{LIGHT}{cube}{mesh}");
        (
            format!("bumpmap{name}"),
            scene(r#"type="perspective">"#, false, &body, &ball),
        )
    };
    vec![
        of("", "", DIFFUSE),
        of("-plain", plain, metal),
        of("-mirror", "", r#"<bsdf type="conductor"/>"#),
    ]
}

/// A bent patch of four quadrilaterals, with normals that are not those of its faces.
fn patch() -> String {
    let mut text = String::new();
    for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
        let [x, y] = [i, j].map(|k| f64::from(k) * 0.4 - 0.4);
        text += &format!("v {x} {} {}\n", y + 0.5, 0.2 * (x * 3.0).cos() - 0.1 * y);
        text += &format!(
            "vt {} {}\n",
            0.9 - 0.4 * f64::from(j),
            0.3 * f64::from(i) + 0.1 * f64::from(j)
        );
        text += &format!("vn {} 0.15 1\n", 0.6 * (x * 3.0).sin());
    }
    for (i, j) in (0..2).flat_map(|i| (0..2).map(move |j| (i, j))) {
        let at = |i: u32, j: u32| format!("{0}/{0}/{0}", 3 * i + j + 1);
        text += &format!(
            "f {} {} {} {}\n",
            at(i, j),
            at(i + 1, j),
            at(i + 1, j + 1),
            at(i, j + 1)
        );
    }
    text
}

/// Lights that shine on a diffuse ball.
fn lights() -> [(&'static str, String); 6] {
    let image = r#"<string name="filename" value="slide.exr"/><boolean name="raw" value="true"/>"#;
    [
        (
            "directional",
            r#"<emitter type="directional"><vector name="direction" x="-0.4" y="-1" z="-0.5"/>
            <rgb name="irradiance" value="3, 2, 1"/></emitter>"#
                .to_owned(),
        ),
        (
            "projector",
            format!(
                r#"<emitter type="projector">{AIMED}<float name="fov" value="50"/><float name="scale" value="1.5"/>
            <texture name="irradiance" type="bitmap">{image}</texture></emitter>"#
            ),
        ),
        (
            "spot",
            format!(
                r#"<emitter type="spot">{AIMED}<float name="cutoff_angle" value="35"/>
            <rgb name="intensity" value="9, 8, 7"/></emitter>"#
            ),
        ),
        (
            "slide",
            format!(
                r#"<emitter type="spot">{AIMED}<float name="cutoff_angle" value="35"/>
            <rgb name="intensity" value="9, 8, 7"/><texture name="texture" type="bitmap">{image}</texture></emitter>"#
            ),
        ),
        (
            "envmap",
            r#"<emitter type="envmap"><string name="filename" value="slide.exr"/><float name="scale" value="1.7"/>
            <transform name="to_world"><rotate y="1" angle="30"/></transform></emitter>"#
                .to_owned(),
        ),
        ("lamp", LIGHT.to_owned()),
    ]
}

fn scene(sensor: &str, hide: bool, body: &str, bsdf: &str) -> String {
    format!(
        r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="6"/>
        <integer name="rr_depth" value="100"/><boolean name="hide_emitters" value="{hide}"/></integrator>
        <sensor {sensor}{FILM}</sensor>{FLOOR}{body}<shape type="sphere"><point name="center" x="0" y="0.6" z="0"/>
        <float name="radius" value="0.6"/>{bsdf}</shape></scene>"#
    )
}

/// All scenes, with their names.
fn scenes() -> Vec<(String, String)> {
    const PINHOLE: &str = r#"type="perspective">"#;
    let mut all: Vec<(String, String)> = (materials().into_iter())
        .map(|(name, bsdf)| (name, scene(PINHOLE, false, LIGHT, &bsdf)))
        .collect();
    for (name, body) in lights() {
        all.push((name.into(), scene(PINHOLE, false, &body, DIFFUSE)));
    }
    all.extend(bumped());
    // Mitsuba finds it with particles only.
    let beam = scene(PINHOLE, false, BEAM, DIFFUSE)
        .replace(r#"integrator type="path""#, r#"integrator type="ptracer""#);
    all.push(("directionalarea".into(), beam));
    let sky = r#"<emitter type="constant"><rgb name="radiance" value="0.4, 0.5, 0.6"/></emitter>"#;
    all.push(("hidden".into(), scene(PINHOLE, true, sky, DIFFUSE)));
    // Points of balls behind lamps are elsewhere in Mitsuba 3.9: distances are counted from the lamp there, and points from
    // the camera. Those of triangles and rectangles are not found by distances.
    let lamps = format!("{LIGHT}{IN_THE_WAY}");
    for (name, bsdf) in [
        ("hidden lamps", DIFFUSE),
        ("hidden lamps in a mirror", r#"<bsdf type="conductor"/>"#),
    ] {
        let ball = r#"<shape type="sphere"><point name="center" x="0" y="0.6" z="0"/>
        <float name="radius" value="0.6"/>"#;
        let block = r#"<shape type="cube"><transform name="to_world"><scale value="0.5"/><rotate y="1" angle="25"/>
            <translate y="0.6"/></transform>"#;
        let text = scene(PINHOLE, true, &lamps, bsdf);
        assert!(text.contains(ball));
        all.push((name.into(), text.replace(ball, block)));
    }
    let lens = r#"type="thinlens"><float name="aperture_radius" value="0.15"/><float name="focus_distance" value="4"/>"#;
    all.push(("thinlens".into(), scene(lens, false, LIGHT, DIFFUSE)));
    all
}

/// Means of the blocks of one run.
fn blocks(scene: &Scene, seed: u64) -> Vec<f64> {
    let theta = Theta::constant(scene.params().values());
    let job = Job::new(scene, &scene.settings, seed, 0..16, &());
    let rendered = render_f32(&job, &theta, Estimator::Mis);
    assert_eq!(rendered.non_finite.count, 0);
    let image = rendered.image(0).data;
    let n = SIZE / BLOCK;
    let mut sums = vec![0.0; n * n * 3];
    for (i, x) in image.iter().enumerate() {
        let (row, column, c) = (i / 3 / SIZE, i / 3 % SIZE, i % 3);
        sums[(row / BLOCK * n + column / BLOCK) * 3 + c] += f64::from(*x) / (BLOCK * BLOCK) as f64;
    }
    sums
}

/// What Mitsuba makes of these files; `None` where it is not there.
fn by_mitsuba(files: &[std::path::PathBuf]) -> Option<Vec<Vec<Vec<f64>>>> {
    let python = std::env::var_os("RENDER_PYTHON").unwrap_or_else(|| "python3".into());
    let found = Command::new(&python)
        .args(["-c", "import mitsuba, numpy"])
        .output();
    if !found.is_ok_and(|o| o.status.success()) {
        println!("skipped: {} has no mitsuba", Path::new(&python).display());
        return None;
    }
    let output = Command::new(&python)
        .args(["-c", MITSUBA, &RUNS.to_string()])
        .args(files)
        .output()
        .expect("it ran before");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let text = String::from_utf8_lossy(&output.stdout);
    let found: Value = serde_json::from_str(text.trim()).expect("JSON");
    serde_json::from_value(found).ok()
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn plugins_look_as_in_mitsuba() {
    let dir = tempfile::tempdir().expect("a folder");
    let texels = (0..16 * 8 * 3).map(|i| ((i * 7919 % 101) as f32) / 101.0);
    let image = Image {
        width: 16,
        height: 8,
        data: texels.collect(),
    };
    write_exr(&dir.path().join("slide.exr"), &image).expect("a file");
    let heights = Pixels {
        width: 8,
        height: 8,
        channels: 1,
        data: (0..64).map(|i| ((i * 7919 % 101) as f32) / 101.0).collect(),
    };
    write_exr_pixels(&dir.path().join("heights.exr"), &heights).expect("a file");
    std::fs::write(dir.path().join("patch.obj"), patch()).expect("a file");
    let scenes = scenes();
    let files: Vec<_> = (scenes.iter())
        .map(|(name, text)| {
            let path = dir.path().join(format!("{name}.xml"));
            std::fs::write(&path, text).expect("a file");
            path
        })
        .collect();
    let Some(theirs) = by_mitsuba(&files) else {
        return;
    };
    let count = (SIZE / BLOCK) * (SIZE / BLOCK) * 3;
    let limit = z_limit(count * scenes.len(), RUNS, 1e-3);
    let mut wrong = Vec::new();
    for ((path, (name, _)), theirs) in files.iter().zip(&scenes).zip(&theirs) {
        let (scene, _) =
            Scene::load(path, &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        let ours: Vec<_> = (0..RUNS).map(|r| blocks(&scene, 1000 + r)).collect();
        let of = |runs: &[Vec<f64>], k: usize| {
            Estimate::of(&runs.iter().map(|run| run[k]).collect::<Vec<_>>())
        };
        let z = (0..count).map(|k| {
            let (a, b) = (of(&ours, k), of(theirs, k));
            // Roundings of single precision, where nothing is random.
            if (a.mean - b.mean).abs() <= 1e-5 * b.mean.abs() {
                0.0
            } else {
                a.z(&b).abs()
            }
        });
        let worst = z.fold(0.0, f64::max);
        println!("{name}: worst |z| {worst:.2} of {count} blocks");
        if worst.is_nan() || worst > limit {
            wrong.push(name);
        }
    }
    assert!(wrong.is_empty(), "beyond {limit:.2}: {wrong:?}");
}
