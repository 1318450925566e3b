//! Images of single plugins against Mitsuba 3, rendered by both where its package is present: `RENDER_PYTHON`, or
//! `python3`, has to be able to import it; skipped otherwise.
//!
//! Rule: 32 runs of each renderer with 16 samples per pixel; the means of all blocks of 4 x 4 pixels agree within the Sidak
//! limit at 1e-3 over all blocks, channels and scenes. `roughplastic` is not among them: as `RoughPlastic` says, ours
//! conserves energy where Mitsuba's loses some.

use std::path::{Path, PathBuf};
use std::process::Command;

use ad_core::Vec3;
use render::image_io::{Pixels, write_exr, write_exr_pixels, write_png};
use render::instances::{Estimator, render_f32};
use render::math::Ray;
use render::params::Theta;
use render::sampler::{Independent, Sampler};
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
        // Of rough panes, Mitsuba leaves out directions behind a facet.
        (
            "principledthin",
            r#"<rgb name="base_color" value="0.7, 0.5, 0.4"/><float name="roughness" value="0.2"/>
            <float name="spec_trans" value="0.7"/><float name="eta" value="1.3"/><float name="spec_tint" value="0.6"/>
            <float name="diff_trans" value="0.6"/>"#,
        ),
        (
            "principledthin",
            r#"<rgb name="base_color" value="0.7, 0.5, 0.4"/><float name="roughness" value="0.7"/>
            <float name="diff_trans" value="1.2"/><float name="flatness" value="0.4"/><float name="sheen" value="0.8"/>
            <float name="sheen_tint" value="0.5"/>"#,
        ),
        (
            "principledthin",
            r#"<rgb name="base_color" value="0.7, 0.9, 0.8"/><float name="roughness" value="0.2"/>
            <float name="spec_trans" value="1"/><float name="anisotropic" value="0.6"/>"#,
        ),
        ("hair", ""),
        (
            "hair",
            r#"<rgb name="sigma_a" value="0.1, 0.2, 0.4"/><float name="scale" value="0.7"/>
            <float name="longitudinal_roughness" value="0.6"/><float name="azimuthal_roughness" value="0.5"/>
            <float name="scale_tilt" value="-6"/><float name="int_ior" value="1.4"/>"#,
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
    for plugin in ["bsplinecurve", "linearcurve"] {
        let tuft = format!(
            r#"{LIGHT}<shape type="{plugin}"><string name="filename" value="tuft.txt"/>
            <transform name="to_world"><scale x="1.2" y="1" z="0.8"/><translate y="0.6"/></transform>
            <bsdf type="diffuse"><texture name="reflectance" type="checkerboard"><transform name="to_uv">
            <scale x="2" y="20"/></transform></texture></bsdf></shape>"#
        );
        all.push((plugin.into(), scene(PINHOLE, false, &tuft, DIFFUSE)));
    }
    all
}

/// Curves around the origin: a tuft of thick and thin ones, which bend.
fn tuft() -> String {
    let mut text = String::new();
    let mut state = 1u32;
    let mut number = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24)
    };
    for i in 0..24 {
        let [x, z] = [number(), number()].map(|x| 2.0 * x - 1.0);
        let thick = if i % 3 == 0 { 0.12 } else { 0.03 };
        for k in 0..6 {
            let [a, b, r] = [number(), number(), number()];
            let y = 0.3 * f64::from(k) - 0.6 + 0.2 * a;
            text += &format!(
                "{} {y} {} {}\n",
                x + 0.4 * a,
                z + 0.4 * b,
                thick * (0.4 + r)
            );
        }
        text += "\n";
    }
    text
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
fn by_mitsuba(files: &[PathBuf]) -> Option<Vec<Vec<Vec<f64>>>> {
    serde_json::from_value(run(MITSUBA, &RUNS.to_string(), files)?).ok()
}

/// What a script prints for an argument and these files, as JSON; `None` where Mitsuba is not there.
fn run(script: &str, argument: &str, files: &[PathBuf]) -> Option<Value> {
    let python = std::env::var_os("RENDER_PYTHON").unwrap_or_else(|| "python3".into());
    let found = Command::new(&python)
        .args(["-c", "import mitsuba, numpy"])
        .output();
    if !found.is_ok_and(|o| o.status.success()) {
        println!("skipped: {} has no mitsuba", Path::new(&python).display());
        return None;
    }
    let output = Command::new(&python)
        .args(["-c", script, argument])
        .args(files)
        .output()
        .expect("it ran before");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let text = String::from_utf8_lossy(&output.stdout);
    Some(serde_json::from_str(text.trim()).expect("JSON"))
}

/// What rays of a file meet first in a scene: nothing, or distance, normal, texture coordinates and the axis around.
const HITS: &str = r#"
import json, sys
import numpy as np
import mitsuba as mi
mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)
scene = mi.load_file(sys.argv[2])
out = []
for ray in json.load(open(sys.argv[1])):
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(*ray[:3]), mi.Vector3f(*ray[3:])))
    numbers = [si.t, *si.n, *si.uv, *si.sh_frame.s] if si.is_valid() else []
    out.append([float(x) for x in numbers])
print(json.dumps(out))
"#;

/// Rays through a tuft of curves, some of which begin within one, meet what they meet in Mitsuba: distances to 2e-4,
/// normals to 5e-3, and axes of B-splines, texture coordinates to 1e-3 along and, of B-splines, 2e-3 around, where they are not close to grazing; of 4000 rays, 2 may miss in one
/// of both, and 40 of those that begin within linear curves.
#[test]
fn curves_are_met_where_mitsuba_meets_them() {
    let dir = tempfile::tempdir().expect("a folder");
    std::fs::write(dir.path().join("tuft.txt"), tuft()).expect("a file");
    let rays: Vec<[f32; 6]> = (0..4000)
        .map(|i| {
            let mut s = Independent::new(7, 1, i);
            let [o, to] = [1.0, 0.6].map(|size| {
                let v = render::math::warp::square_to_sphere::<f64>(s.next_2d());
                v * (size * s.next_1d::<f64>().sqrt() * if i % 4 == 0 { 1.0 } else { 2.0 })
            });
            let d = (to - o).normalize();
            [o.x, o.y, o.z, d.x, d.y, d.z].map(|x| x as f32)
        })
        .collect();
    let list = dir.path().join("rays.json");
    std::fs::write(&list, serde_json::to_string(&rays).expect("JSON")).expect("a file");
    for plugin in ["bsplinecurve", "linearcurve"] {
        let text = format!(
            r#"<scene version="3.0.0"><sensor type="perspective"/>
            <shape type="{plugin}"><string name="filename" value="tuft.txt"/><bsdf type="diffuse">
            <texture type="checkerboard" name="reflectance"/></bsdf></shape></scene>"#
        );
        let path = dir.path().join("curves.xml");
        std::fs::write(&path, text).expect("a file");
        let list = list.to_str().expect("a name");
        let Some(theirs) = run(HITS, list, std::slice::from_ref(&path)) else {
            return;
        };
        let theirs: Vec<Vec<f64>> = serde_json::from_value(theirs).expect("lists");
        let (scene, _) =
            Scene::load(&path, &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        let (mut hits, mut missed) = (0, 0);
        for (ray, expected) in rays.iter().zip(&theirs) {
            let [ox, oy, oz, dx, dy, dz] = ray.map(f64::from);
            let ray = Ray::new(Vec3::new(ox, oy, oz), Vec3::new(dx, dy, dz));
            let found = scene.intersect(&ray);
            let ([t, nx, ny, nz, u, v, sx, sy, sz], Some(hit)) = (
                <[f64; 9]>::try_from(expected.as_slice()).unwrap_or([f64::NAN; 9]),
                &found,
            ) else {
                missed += usize::from(found.is_some() == expected.is_empty());
                continue;
            };
            let si = &hit.si;
            if expected.is_empty() || (si.t - t).abs() > 2e-4 {
                missed += 1;
                continue;
            }
            hits += 1;
            if si.n_geo.dot(ray.d).abs() < 0.1 {
                continue;
            }
            let n = Vec3::new(nx, ny, nz);
            assert!(
                (si.n_geo - n).length() < 5e-3,
                "{plugin}: {:?} {n:?}",
                si.n_geo
            );
            assert!(
                (si.uv.y - v).abs() < 1e-3,
                "{plugin}: {ray:?}: {si:?}, not {expected:?}"
            );
            // On the balls at ends of linear curves the angle is that of little.
            let s = Vec3::new(sx, sy, sz);
            if plugin == "bsplinecurve" {
                let turn = (si.uv.x - u).abs();
                assert!(turn.min(1.0 - turn) < 2e-3, "{plugin}: {} {u}", si.uv.x);
                assert!(
                    (si.frame.s - s).length() < 5e-3,
                    "{plugin}: {:?} {s:?}",
                    si.frame.s
                );
            }
        }
        println!("{plugin}: {hits} hits alike, {missed} not");
        // Rays that begin within a linear curve meet what of the next segment is inside of this one, not so in Mitsuba.
        let most = if plugin == "linearcurve" { 40 } else { 2 };
        assert!(hits > 1000 && missed <= most, "{plugin}: {hits} {missed}");
    }
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
    std::fs::write(dir.path().join("tuft.txt"), tuft()).expect("a file");
    let scenes = scenes();
    let files: Vec<_> = (scenes.iter())
        .map(|(name, text)| {
            let path = dir.path().join(format!("{name}.xml"));
            std::fs::write(&path, text).expect("a file");
            path
        })
        .collect();
    let names: Vec<String> = scenes.into_iter().map(|(name, _)| name).collect();
    compare(&names, &files, &files);
}

/// Renders one list of files here and another by Mitsuba, and expects the same images; says so where it is not there.
fn compare(names: &[String], ours: &[PathBuf], theirs: &[PathBuf]) {
    let Some(theirs) = by_mitsuba(theirs) else {
        return;
    };
    let count = (SIZE / BLOCK) * (SIZE / BLOCK) * 3;
    let limit = z_limit(count * names.len(), RUNS, 1e-3);
    let mut wrong = Vec::new();
    for ((path, name), theirs) in ours.iter().zip(names).zip(&theirs) {
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

/// An OBJ file of a tent that Mitsuba does not read: lines that go on, indices from the end, or line ends of old.
const ODD: [&str; 3] = [
    "v -1 0 \\\n 0\nv 1 0 0\nv 0 0.2 1\nv 0 0.9 0\nf 1 2 4\nf 1 \\\n4 3\nf 2 3 4\n",
    "v -1 0 0\nv 1 0 0\nv 0 0.2 1\nv 0 0.9 0\nf -4 -3 -1\nf -4 -1 -2\nf -3 -2 -1\n",
    "v -1 0 0\rv 1 0 0\rv 0 0.2 1\rv 0 0.9 0\rf 1 2 4\rf 1 4 3\rf 2 3 4\r",
];

/// What was substituted when a scene was read is what is written, so that both renderers read it and see the same.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn scenes_that_were_saved_look_the_same_in_both() {
    let dir = tempfile::tempdir().expect("a folder");
    let at = |name: &str| dir.path().join(name);
    let steps = Image {
        width: 4,
        height: 4,
        data: (0..48).map(|i| ((i * 7919 % 101) as f32) / 101.0).collect(),
    };
    write_png(&at("steps.png"), &steps, 0.0).expect("a file");
    let diffuse = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf>"#;
    let scaled = r#"<bsdf type="diffuse"><texture type="scale" name="reflectance"><rgb name="scale" value="0.9, 0.5, 0.7"/>
        <texture type="bitmap"><string name="filename" value="steps.png"/><float name="gamma" value="1.8"/>
        <float name="uscale" value="2"/><string name="wrapModeU" value="mirror"/><string name="wrapModeV" value="mirror"/>
        </texture></texture></bsdf>"#;
    let squares = r#"<bsdf type="diffuse"><texture type="scale" name="reflectance"><float name="scale" value="0.5"/>
        <texture type="checkerboard"><rgb name="color0" value="0.9, 0.4, 0.2"/><float name="uscale" value="4"/>
        </texture></texture></bsdf>"#;
    let metal = r#"<bsdf type="roughconductor"><string name="distribution" value="phong"/><float name="alpha" value="0.3"/>
        <string name="material" value="Al"/><float name="extEta" value="1.33"/></bsdf>"#;
    let mixed = format!(
        "<bsdf type=\"mixturebsdf\"><string name=\"weights\" value=\"0.3, 0.5\"/>{diffuse}<bsdf type=\"diffuse\"/></bsdf>"
    );
    let integrators = [
        r#"<integrator type="bdpt"><integer name="maxDepth" value="4"/><boolean name="lightImage" value="true"/></integrator>"#,
        r#"<integrator type="adaptive"><integrator type="direct"><integer name="maxDepth" value="3"/>
            <boolean name="strictNormals" value="true"/></integrator></integrator>"#,
        r#"<integrator type="prb_projective"/>"#,
    ];
    let film = FILM
        .replace("type=\"hdrfilm\"", "type=\"ldrfilm\"")
        .replace(
            "<rfilter",
            "<boolean name=\"banner\" value=\"false\"/><rfilter",
        )
        .replace(
            "type=\"independent\">",
            "type=\"halton\"><integer name=\"dimension\" value=\"4\"/>",
        );
    let (mut names, mut ours, mut theirs) = (Vec::new(), Vec::new(), Vec::new());
    for (i, material) in [diffuse, scaled, squares, metal, &mixed]
        .into_iter()
        .enumerate()
    {
        let (odd, integrator) = (ODD[i % 3], integrators[i % 3]);
        std::fs::write(at(&format!("tent{i}.obj")), odd).expect("a file");
        let text = format!(
            "<scene version=\"0.6.0\">{integrator}<sensor type=\"perspective\">{film}</sensor>{FLOOR}{LIGHT}
            <shape type=\"obj\"><string name=\"filename\" value=\"tent{i}.obj\"/><boolean name=\"collapse\" value=\"true\"/>
            <boolean name=\"faceNormals\" value=\"true\"/><bsdf type=\"twosided\">{diffuse}</bsdf></shape>
            <shape type=\"rectangle\"><transform name=\"toWorld\"><scale value=\"0.8\"/><translate x=\"-0.6\" y=\"0.8\" z=\"-0.8\"/>
            </transform>{material}</shape></scene>"
        );
        let (old, new) = (at(&format!("old{i}.xml")), at(&format!("new{i}/scene.xml")));
        std::fs::write(&old, text).expect("a file");
        let (scene, _) =
            Scene::load(&old, &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        scene.save(&new).unwrap_or_else(|e| panic!("{e}"));
        // Without Mitsuba at least here.
        let (again, warnings) =
            Scene::load(&new, &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        assert!(warnings.is_empty(), "{warnings:?}");
        assert_eq!(again.settings.max_depth, scene.settings.max_depth);
        assert_eq!(blocks(&again, 7), blocks(&scene, 7), "{i}");
        names.push(format!("saved {i}"));
        ours.push(old);
        theirs.push(new);
    }
    compare(&names, &ours, &theirs);
}
