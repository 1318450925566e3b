//! Every estimator against finite differences, for every kind of parameter, in three kinds of scene: unbiased
//! ones agree, block by block, and each of those that are biased on purpose is found out by the same
//! comparison.
//!
//! Attached samples without reparameterisation are refused where something can be hidden, and on mapped normals,
//! whose horizon they would cross (F9): they take part on a plane without normals to differentiate. Differentiated
//! probabilities of lobes take part where there are two.

use std::fmt::Write as _;
use std::path::Path;

use rayon::prelude::*;
use render::Job;
use render::estimator::{Failure, Scenes};
use render::image_io::write_exr;
use render::instances::{Estimator, render_f64};
use render::params::Theta;
use render::{Image, Scene};
use tests::stats::{Estimate, z_limit};
use tests::{mean_adjoint, scene, values};

/// Pixels per side. A block is a half or all of them.
const SIZE: u32 = 8;
/// 128 repeats of 8192 samples: 1.05e6 per block.
const REPEATS: u64 = 128;
const SAMPLES: u64 = 8192;
/// Some 320 comparisons, with a significance of 3 % over all of them. Seeds are fixed.
const COMPARISONS: usize = 320;
const ALPHA: f64 = 0.03;

/// The only case where lobes are chosen between.
const WORN: &str = "worn paint";

/// A kind of parameter: what is added to which elements of which ranges.
struct Move {
    kind: &'static str,
    along: Vec<(String, Vec<f32>)>,
    /// Step of the differences.
    step: f64,
}

impl Move {
    /// `pattern(i)` for element `i` of each range.
    fn new(
        scene: &Scene,
        kind: &'static str,
        names: &[impl AsRef<str>],
        step: f64,
        pattern: impl Fn(usize) -> f64,
    ) -> Self {
        let along = names.iter().map(|name| {
            let name = name.as_ref();
            let info = scene.params().find(name).expect("a parameter");
            let pattern = (0..info.shape.len()).map(|i| pattern(i) as f32);
            (name.to_owned(), pattern.collect())
        });
        Self {
            kind,
            along: along.collect(),
            step,
        }
    }

    fn applied(&self, scene: &Scene, h: f64) -> Vec<f64> {
        let mut v = values::<f64>(scene);
        for (name, along) in &self.along {
            let info = scene.params().find(name).expect("a parameter");
            for (v, d) in v[info.range()].iter_mut().zip(along) {
                *v += h * f64::from(*d);
            }
        }
        v
    }
}

struct Case {
    name: &'static str,
    scene: Scene,
    moves: Vec<Move>,
    /// Into how many upright blocks the film is cut.
    blocks: u32,
    /// Differences are made from sampled lights alone: with common random numbers they are smooth where light
    /// takes one bounce.
    one_bounce: bool,
}

/// Along the first axis of the normal and a little along the second, differently per texel.
fn tilt(i: usize) -> f64 {
    let texel = (i / 3) as f64;
    [1.0 + 0.3 * (1.7 * texel).sin(), 0.4, 0.0][i % 3]
}

/// A uniform change with a ripple, so that texels matter one by one.
fn ripple(i: usize) -> f64 {
    1.0 + 0.5 * (2.3 * i as f64).cos()
}

/// An image in a file: `f(texel, channel)`.
fn file(dir: &Path, name: &str, size: [usize; 2], f: impl Fn(usize, usize) -> f64) -> String {
    let mut image = Image::new(size[0], size[1]);
    for (i, x) in image.data.iter_mut().enumerate() {
        *x = f(i / 3, i % 3) as f32;
    }
    let path = dir.join(name);
    write_exr(&path, &image).expect("a folder to write to");
    path.display().to_string()
}

/// Normals up to some twelve degrees off.
fn normals(dir: &Path, name: &str) -> String {
    file(dir, name, [3, 3], |t, c| {
        let t = t as f64;
        [
            0.5 + 0.1 * (2.1 * t).sin(),
            0.5 + 0.1 * (1.3 * t).cos(),
            1.0,
        ][c]
    })
}

fn bitmap(key: &str, path: &str) -> String {
    format!(
        r#"<texture type="bitmap" name="{key}"><string name="filename" value="{path}"/>
        <boolean name="raw" value="true"/></texture>"#
    )
}

fn camera(eye: &str, fov: f64, depth: u32) -> String {
    format!(
        r#"<sensor type="perspective"><float name="fov" value="{fov}"/>
        <transform name="to_world"><lookat origin="{eye}" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{SIZE}"/><integer name="height" value="{SIZE}"/>
        <rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>"#
    )
}

/// A rectangle of metal, turned and moved, with normals from a file if there is one.
fn plate(
    id: &str,
    [half_x, half_y]: [f64; 2],
    place: &str,
    [ndf, visible]: [&str; 2],
    [alpha, reflectance, normals]: [&str; 3],
) -> String {
    let metal = format!(
        r#"<bsdf type="roughconductor" id="{id}_metal">
        <string name="distribution" value="{ndf}"/><boolean name="sample_visible" value="{visible}"/>
        <string name="material" value="none"/>{alpha}{reflectance}</bsdf>"#
    );
    let bsdf = match normals {
        "" => metal,
        file => {
            let map = bitmap("normalmap", file);
            format!(r#"<bsdf type="normalmap" id="{id}_map">{map}{metal}</bsdf>"#)
        }
    };
    format!(
        r#"<shape type="rectangle" id="{id}">
        <transform name="to_world"><scale x="{half_x}" y="{half_y}"/>{place}</transform>
        {bsdf}</shape>"#
    )
}

fn constants(alpha: f64) -> [String; 2] {
    [
        format!(r#"<float name="alpha" value="{alpha}"/>"#),
        r#"<rgb name="specular_reflectance" value="0.8, 0.7, 0.5"/>"#.into(),
    ]
}

fn ball(id: &str, center: &str, radius: f64, radiance: &str) -> String {
    format!(
        r#"<shape type="sphere" id="{id}"><point name="center" value="{center}"/>
        <float name="radius" value="{radius}"/>
        <emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter></shape>"#
    )
}

/// Of two plates and these lights; `step` for roughness and normals, in which sampled paths may jump.
fn moves(s: &Scene, plates: [&str; 2], lights: &[&str], step: f64) -> Vec<Move> {
    let of = |key| plates.map(|id| format!("{id}_{key}"));
    let alphas = of("metal.alpha.value");
    let reflectances = of("metal.specular_reflectance.value");
    let normals = of("map.normalmap.data");
    vec![
        Move::new(s, "roughness", &alphas, step, |_| 1.0),
        Move::new(s, "albedo", &reflectances, 1e-3, |_| 1.0),
        Move::new(s, "normal", &normals, step, tilt),
        Move::new(s, "emission", lights, 1e-2, |_| 1.0),
    ]
}

/// Two plates of different roughness side by side, one per block, that mirror ball lights.
fn plates(dir: &Path) -> Case {
    let map = normals(dir, "plates.exr");
    let [a, white] = constants(0.1);
    let [b, _] = constants(0.25);
    let turn = r#"<rotate x="1" angle="-90"/>"#;
    let left = format!(r#"{turn}<translate x="-0.85"/>"#);
    let right = format!(r#"{turn}<translate x="0.85"/>"#);
    let s = scene(&format!(
        "{}{}{}{}{}",
        camera("0, 2.2, 3.6", 22.0, 2),
        plate(
            "a",
            [0.8, 1.0],
            &left,
            ["beckmann", "false"],
            [&a, &white, &map]
        ),
        plate("b", [0.8, 1.0], &right, ["ggx", "true"], [&b, &white, &map]),
        ball("sun", "-0.6, 2, -3.2", 0.6, "4, 3, 2"),
        ball("moon", "1.2, 2.2, -3", 0.3, "6, 7, 8"),
    ));
    let lights = ["sun.emitter.radiance.value", "moon.emitter.radiance.value"];
    let moves = moves(&s, ["a", "b"], &lights, 1e-5);
    Case {
        name: "plates",
        scene: s,
        moves,
        blocks: 2,
        one_bounce: true,
    }
}

/// A floor and a wall of metal that see each other, a ball light and a dim sky; three bounces.
fn interreflections(dir: &Path) -> Case {
    let map = normals(dir, "interreflections.exr");
    let [a, white] = constants(0.2);
    let [b, _] = constants(0.3);
    let sky = r#"<emitter type="constant"><rgb name="radiance" value="0.2, 0.3, 0.4"/></emitter>"#;
    let s = scene(&format!(
        "{}{}{}{}{sky}",
        camera("0, 2.2, 3.6", 24.0, 4),
        plate(
            "floor",
            [1.0, 1.0],
            r#"<rotate x="1" angle="-90"/>"#,
            ["ggx", "true"],
            [&a, &white, &map]
        ),
        plate(
            "wall",
            [1.0, 0.8],
            r#"<translate y="0.95" z="-1.1"/>"#,
            ["beckmann", "true"],
            [&b, &white, &map]
        ),
        ball("sun", "0.3, 1.6, 0.9", 0.35, "6, 5, 4"),
    ));
    let moves = moves(&s, ["floor", "wall"], &["sun.emitter.radiance.value"], 4e-3);
    Case {
        name: "interreflections",
        scene: s,
        moves,
        blocks: 1,
        one_bounce: false,
    }
}

/// Paint that wears off metal, under a wide sky, which scattered directions find, and a ball light: a choice of lobes.
fn worn(_: &Path) -> Case {
    let sky = r#"<emitter type="constant"><rgb name="radiance" value="0.6, 0.5, 0.4"/></emitter>"#;
    let s = scene(&format!(
        r#"{}<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/></transform>
        <bsdf type="blendbsdf" id="worn"><float name="weight" value="0.4"/>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.3, 0.5, 0.2"/></bsdf>
        <bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf></bsdf></shape>{}{sky}"#,
        camera("0, 2.2, 3.6", 22.0, 2),
        ball("sun", "-0.6, 2, -3.2", 0.6, "4, 3, 2"),
    ));
    let weight = Move::new(&s, "weight", &["worn.weight.value"], 1e-3, |_| 1.0);
    Case {
        name: WORN,
        scene: s,
        moves: vec![weight],
        blocks: 1,
        one_bounce: true,
    }
}

/// Roughness, reflectance, normal and light are all images.
fn mapped(dir: &Path) -> Case {
    textured(dir, "mapped plane", &normals(dir, "textured.exr"))
}

/// The same without the image of normals.
fn flat(dir: &Path) -> Case {
    textured(dir, "flat plane", "")
}

fn textured(dir: &Path, name: &'static str, map: &str) -> Case {
    let t = |i: usize, k: f64| (k * i as f64).sin();
    let alpha = file(dir, "alpha.exr", [4, 4], |i, _| 0.25 + 0.1 * t(i, 1.9));
    let reflectance = file(dir, "reflectance.exr", [4, 4], |i, c| {
        0.6 + 0.3 * t(3 * i + c, 2.7)
    });
    // Bright on one side: tilting normals to it matters.
    let sky = file(dir, "sky.exr", [16, 8], |i, c| {
        let side = (std::f64::consts::TAU * ((i % 16) as f64 + 0.5) / 16.0).sin();
        1.1 + 0.9 * side + 0.1 * t(i + 7 * c, 3.1)
    });
    let s = scene(&format!(
        r#"{}{}<emitter type="envmap" id="sky"><string name="filename" value="{sky}"/></emitter>"#,
        camera("0, 1.5, 2.6", 22.0, 2),
        plate(
            "plane",
            [1.5, 1.5],
            r#"<rotate x="1" angle="-90"/>"#,
            ["ggx", "true"],
            [
                &bitmap("alpha", &alpha),
                &bitmap("specular_reflectance", &reflectance),
                map
            ]
        ),
    ));
    let mut moves = vec![
        Move::new(&s, "roughness", &["plane_metal.alpha.data"], 1e-5, ripple),
        Move::new(
            &s,
            "albedo",
            &["plane_metal.specular_reflectance.data"],
            1e-3,
            ripple,
        ),
        Move::new(&s, "emission", &["sky.data"], 1e-2, ripple),
    ];
    if !map.is_empty() {
        let normals = Move::new(&s, "normal", &["plane_map.normalmap.data"], 1e-5, tilt);
        moves.push(normals);
    }
    Case {
        name,
        scene: s,
        moves,
        blocks: 1,
        one_bounce: true,
    }
}

impl Case {
    /// With this block of the film only.
    fn crop(&mut self, block: u32) {
        let width = SIZE / self.blocks;
        self.scene.film.crop_offset = [block * width, 0];
        self.scene.film.crop_size = [width, SIZE];
    }

    /// Samples per pixel and repeat.
    fn spp(&self) -> u64 {
        SAMPLES / self.scene.film.pixels() as u64
    }
}

/// Central differences in f64 with common random numbers.
fn differences(case: &Case, m: &Move, seed: u64) -> Estimate {
    let s = &case.scene;
    let means: Vec<f64> = (0..REPEATS)
        .into_par_iter()
        .map(|r| {
            let at = |h: f64| {
                let v = m.applied(s, h);
                let theta = Theta::constant(&v);
                let estimator = if case.one_bounce {
                    Estimator::Emitter
                } else {
                    Estimator::Mis
                };
                let (seed, spp) = (seed + r, 0..case.spp());
                let image =
                    render_f64(&Job::new(s, &s.settings, seed, spp, &()), &theta, estimator);
                image.mean(0).iter().sum::<f64>() / 3.0
            };
            (at(m.step) - at(-m.step)) / (2.0 * m.step)
        })
        .collect();
    Estimate::of(&means)
}

/// Whether an estimator is wrong on purpose in what moves nothing.
fn wrong(e: Estimator) -> bool {
    let c = e.capabilities();
    let of_motion = |f| matches!(f, Failure::Boundaries | Failure::RaysAtRest);
    c.study && !c.failures.iter().all(of_motion)
}

/// The derivative of the mean along every move at once, in reverse mode.
fn estimates(case: &Case, e: Estimator, seed: u64) -> Vec<Estimate> {
    let s = &case.scene;
    let names: Vec<&str> = (case.moves.iter())
        .flat_map(|m| m.along.iter().map(|(name, _)| name.as_str()))
        .collect();
    let active = e
        .active(s, &names)
        .expect("parameters of metals and lights");
    let theta = Theta::constant(s.params().values());
    let adjoint = mean_adjoint(s);
    let mut settings = s.settings;
    if (e.capabilities().failures).contains(Failure::AttachedRoulette) {
        settings.rr_depth = 1; // without roulette it is `mis`
    }
    let repeats: Vec<Vec<f64>> = (0..REPEATS)
        .into_par_iter()
        .map(|r| {
            let g = e
                .backward_f32(
                    &Job::new(s, &settings, seed + r, 0..case.spp(), &()),
                    &theta,
                    &active,
                    &adjoint,
                )
                .expect("an estimator that is allowed here");
            assert_eq!(g.non_finite.count, 0, "{} {}", case.name, e.name());
            let mut ranges = g.values.iter();
            let mut along = |m: &Move| {
                let range = |(_, d): &(_, Vec<f32>)| {
                    let gradient = ranges.next().expect("a range per name");
                    gradient
                        .iter()
                        .zip(d)
                        .map(|(g, d)| g * f64::from(*d))
                        .sum::<f64>()
                };
                m.along.iter().map(range).sum()
            };
            case.moves.iter().map(&mut along).collect()
        })
        .collect();
    (0..case.moves.len())
        .map(|k| Estimate::of(&repeats.iter().map(|r| r[k]).collect::<Vec<_>>()))
        .collect()
}

#[test]
fn all_estimators_and_kinds_of_parameters() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut failed = String::new();
    let limit = z_limit(COMPARISONS, REPEATS, ALPHA);
    let mut noticed = vec![0.0f64; Estimator::ALL.len()];
    let mut compared = 0;
    let mut seen = vec![0; Estimator::ALL.len()];
    for make in [plates, interreflections, mapped, flat, worn] {
        let mut case = make(dir.path());
        for block in 0..case.blocks {
            case.crop(block);
            let start = std::time::Instant::now();
            let references: Vec<Estimate> = (case.moves.iter().enumerate())
                .map(|(k, m)| differences(&case, m, 1_000_000 * (k as u64 + 1)))
                .collect();
            println!(
                "{} block {block}  ({:.1} s)",
                case.name,
                start.elapsed().as_secs_f64()
            );
            for (m, r) in case.moves.iter().zip(&references) {
                println!("  {:<9} {:.6} +- {:.6}", m.kind, r.mean, r.se);
                assert!(r.mean.abs() > 10.0 * r.se, "the reference says nothing");
            }
            for (i, &e) in Estimator::ALL.iter().enumerate() {
                // Those that mapped normals rule out are compared on the flat plane, the others on the mapped one.
                let moves = e.capabilities().scenes != Scenes::Any;
                let chooses = (e.capabilities().failures).contains(Failure::AttachedChoice);
                assert_eq!(
                    e.check(&case.scene).is_err(),
                    moves && case.name != "flat plane"
                );
                let takes_part = match case.name {
                    "flat plane" => moves,
                    WORN => e == Estimator::Mis || chooses,
                    _ => !moves && !chooses,
                };
                if !takes_part {
                    continue;
                }
                let start = std::time::Instant::now();
                seen[i] += 1;
                let found = estimates(&case, e, 10_000 * (i as u64 + 1));
                let mut line = format!("  {:<34}", e.name());
                for (m, (f, r)) in case.moves.iter().zip(found.iter().zip(&references)) {
                    let z = f.z(r);
                    let _ = write!(line, " {} {z:>6.2} ({:.4})", m.kind, f.mean / r.mean);
                    if wrong(e) {
                        noticed[i] = noticed[i].max(z.abs());
                        continue;
                    }
                    compared += 1;
                    if z.abs() > limit {
                        let _ =
                            writeln!(failed, "{}, {}, {}: z {z:.2}", case.name, e.name(), m.kind);
                    }
                }
                println!("{line}  ({:.1} s)", start.elapsed().as_secs_f64());
            }
        }
    }
    for (&e, z) in Estimator::ALL.iter().zip(&noticed) {
        if wrong(e) {
            println!("{} is noticed: |z| up to {z:.1}", e.name());
            if *z < limit {
                let _ = writeln!(failed, "{} is not noticed: |z| {z:.2}", e.name());
            }
        }
    }
    assert!(seen.iter().all(|n| *n > 0), "{seen:?}");
    println!("{compared} comparisons, limit {limit:.2}");
    assert!(compared <= COMPARISONS, "{compared}");
    assert!(failed.is_empty(), "\n{failed}");
}
