//! Attached sampling of environment maps with their texels as parameters: forward and reverse mode are the same
//! sum, and both equal finite differences.

use std::path::Path;

use rayon::prelude::*;
use render::Job;
use render::estimator::{
    Attached, AttachedDirect, AttachedWeights, Detached, EmitterOnly, FrozenWeights, Mis, Unbiased,
};
use render::image_io::write_exr;
use render::instances::{Estimator, render_f64};
use render::integrator::gradient::{Active, backward};
use render::integrator::render::render;
use render::params::Theta;
use render::sampler::{Independent, mix64};
use render::scene::LightChoice;
use render::{Image, Scene, Settings};
use tests::stats::{Estimate, z_limit};
use tests::{dot, forward_by, mean_adjoint, on_any_threads, scene, values};

type Emitter = EmitterOnly<Detached, Attached>;
type Both = Mis<AttachedDirect, Attached, AttachedWeights>;
type Frozen = Mis<Detached, Attached, FrozenWeights>;

/// [`reverse`] of some estimator.
type Reverse = fn(&Scene, &[&str], &[f32], u64, u64) -> Vec<f64>;

const DIFFUSE: &str =
    r#"<bsdf type="diffuse" id="metal"><rgb name="reflectance" value="0.7, 0.5, 0.3"/></bsdf>"#;
const GLOSSY: &str = r#"<bsdf type="roughconductor" id="metal"><string name="distribution" value="ggx"/>
    <float name="alpha" value="0.25"/><rgb name="specular_reflectance" value="0.9, 0.8, 0.7"/></bsdf>"#;
/// A second light, so that the choice between them counts.
const SKY: &str =
    r#"<emitter type="constant"><rgb name="radiance" value="0.2, 0.3, 0.4"/></emitter>"#;

/// In [-1, 1).
fn noise(i: usize) -> f64 {
    mix64(i as u64 + 1) as f64 / u64::MAX as f64 * 2.0 - 1.0
}

/// Texels from 0 to 2, cubed; every fifth one is black.
fn sky(width: usize, height: usize) -> Image {
    let mut image = Image::new(width, height);
    for (i, texel) in image.data.chunks_exact_mut(3).enumerate() {
        if i % 5 != 3 {
            texel.fill((1.0 + noise(i)).powi(3) as f32);
            texel[0] *= 1.2 + 0.5 * noise(i + 1000) as f32;
        }
    }
    image
}

/// A plane under a map, `size` pixels wide.
fn plane(dir: &Path, bsdf: &str, map: &Image, rest: &str, size: u32) -> Scene {
    let path = dir.join(format!("{}-{}.exr", map.width, map.height));
    write_exr(&path, map).expect("a folder to write to");
    scene(&format!(
        r#"<sensor type="perspective"><float name="fov" value="30"/>
        <transform name="to_world"><lookat origin="0, 1.6, 2.8" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{size}"/><integer name="height" value="{size}"/>
        <rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="3"/></integrator>
        <shape type="rectangle" id="plane"><transform name="to_world"><rotate x="1" angle="-90"/></transform>
        {bsdf}</shape>
        <emitter type="envmap" id="sky"><string name="filename" value="{}"/>
        <transform name="to_world"><rotate x="1" z="0.4" angle="35"/></transform></emitter>{rest}"#,
        path.display()
    ))
}

/// The gradient of `<adjoint, image>` with respect to all `names`, one number per parameter of the scene.
fn reverse<S: Unbiased>(
    s: &Scene,
    names: &[&str],
    adjoint: &[f32],
    seed: u64,
    spp: u64,
) -> Vec<f64> {
    let values = values::<f64>(s);
    let theta = Theta::constant(&values);
    let active = Active::new(s, names).expect("known names");
    let samples = 0..spp;
    let g = backward::<f64, S, Independent>(
        &Job::new(s, &s.settings, seed, samples, &()),
        &theta,
        &active,
        adjoint,
    )
    .expect("a scene without discontinuities");
    assert_eq!(g.non_finite.count, 0);
    let mut all = vec![0.0; values.len()];
    for (info, g) in active.ranges().iter().zip(g.values) {
        all[info.range()].copy_from_slice(&g);
    }
    all
}

/// Maps in ranges that are summed per job and in one buffer, with one row, with one texel, black, and beside a
/// second light, chosen at random or weighed; random directions over texels and materials at once, to 1e-9 in f64.
#[test]
fn reverse_equals_forward_to_rounding() {
    fn same<S: Unbiased>(s: &Scene, what: &str) {
        let adjoint: Vec<f32> = (0..s.film.pixels() * 3).map(|i| noise(i) as f32).collect();
        let infos = s.params().infos();
        let names: Vec<&str> = infos.iter().map(|i| i.name.as_str()).collect();
        let mut direction = vec![0.0; s.params().values().len()];
        for (i, d) in direction.iter_mut().enumerate() {
            *d = noise(i + 7919);
        }
        let j = forward_by::<S>(s, &direction, &adjoint, &s.settings, 5, 16);
        let g = reverse::<S>(s, &names, &adjoint, 5, 16);
        let terms = || g.iter().zip(&direction).map(|(g, d)| g * d);
        let (jt, scale) = (terms().sum::<f64>(), terms().map(f64::abs).sum::<f64>());
        assert!(scale > 0.0, "{what}: no derivative at all");
        let difference = (j - jt).abs() / scale;
        assert!(difference < 1e-9, "{what}: forward {j} reverse {jt}");
    }
    let dir = tempfile::tempdir().expect("a folder");
    for (name, bsdf) in [("diffuse", DIFFUSE), ("glossy", GLOSSY)] {
        for (map, rest) in [
            (sky(7, 5), ""),
            (sky(16, 8), SKY),
            (sky(5, 1), SKY),
            (sky(1, 1), ""),
            (Image::new(4, 3), SKY),
        ] {
            let mut s = plane(dir.path(), bsdf, &map, rest, 8);
            for lights in [LightChoice::One, LightChoice::All] {
                s.settings.lights = lights;
                let what = format!("{name} {} x {} {rest} {lights:?}", map.width, map.height);
                same::<Emitter>(&s, &format!("emitter {what}"));
                same::<Both>(&s, &format!("both {what}"));
                same::<Frozen>(&s, &format!("frozen {what}"));
            }
        }
    }
}

/// The derivative of light sampling is that of the *picture* light sampling makes with equal random numbers while
/// its tables follow the texels: nothing is left that does not move. Differences over tables in f32, so to a tenth of
/// what detached sampling is off.
#[test]
fn the_derivative_is_that_of_the_picture() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut map = sky(6, 5);
    map.data.iter_mut().for_each(|x| *x += 0.3);
    for bsdf in [DIFFUSE, GLOSSY] {
        let mut s = plane(dir.path(), bsdf, &map, "", 8);
        let adjoint: Vec<f32> = (0..s.film.pixels() * 3).map(|i| noise(i) as f32).collect();
        let before = s.params().values().to_vec();
        let mut direction = vec![0.0; before.len()];
        for i in s.params().find("sky.data").expect("a map").range() {
            direction[i] = noise(i + 31);
        }
        let attached = forward_by::<Emitter>(&s, &direction, &adjoint, &s.settings, 7, 256);
        let detached =
            forward_by::<EmitterOnly<Detached>>(&s, &direction, &adjoint, &s.settings, 7, 256);
        let h = 1e-3;
        let mut at = |h: f64| {
            let v: Vec<f32> = (before.iter().zip(&direction))
                .map(|(v, d)| (f64::from(*v) + h * d) as f32)
                .collect();
            s.set_params(&v).expect("positive texels");
            let values = values::<f64>(&s);
            let theta = Theta::constant(&values);
            let samples = 0..256;
            let image = render::<f64, Emitter, Independent>(
                &Job::new(&s, &s.settings, 7, samples, &()),
                &theta,
            )
            .expect("nothing moves");
            dot(&adjoint, &image, 0)
        };
        let differences = (at(h) - at(-h)) / (2.0 * h);
        let off = (attached - differences).abs();
        let apart = (attached - detached).abs();
        println!("attached {attached:.5} detached {detached:.5} differences {differences:.5}");
        assert!(off < 0.1 * apart, "{attached} {detached} {differences}");
    }
}

/// Reverse mode against central differences in f64, over tables that stay: a random direction, a common factor, one
/// bright texel, one black texel; 64 repeats of 8 x 8 x 64 = 2.6e5 samples. significance 1e-3 over all 36
/// comparisons. (Forward mode is the same sum.)
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn gradients_equal_central_differences() {
    const REPEATS: u64 = 64;
    const SPP: u64 = 64;
    let dir = tempfile::tempdir().expect("a folder");
    let map = sky(7, 5);
    let mut failed = Vec::new();
    let limit = z_limit(36, REPEATS, 1e-3);
    let mut compared = 0;
    for (name, bsdf, rest, lights) in [
        ("diffuse", DIFFUSE, "", LightChoice::One),
        ("glossy", GLOSSY, "", LightChoice::One),
        ("weighed", GLOSSY, SKY, LightChoice::All),
    ] {
        let mut s = plane(dir.path(), bsdf, &map, rest, 8);
        s.settings.lights = lights;
        let s = s;
        let range = s.params().find("sky.data").expect("a map").range();
        let adjoint = mean_adjoint(&s);
        let before = values::<f64>(&s);
        let (bright, dark) = extremes(&s, &adjoint);
        let direction = |f: &dyn Fn(usize) -> f64| -> Vec<f64> {
            let inside = |i: usize| range.contains(&i).then(|| f(i - range.start));
            (0..before.len())
                .map(|i| inside(i).unwrap_or(0.0))
                .collect()
        };
        let directions = [
            ("random", direction(&|i| noise(i + 3))),
            ("factor", direction(&|i| before[range.start + i])),
            ("bright texel", direction(&|i| f64::from(i / 3 == bright))),
            ("black texel", direction(&|i| f64::from(i / 3 == dark))),
        ];
        let references = directions.each_ref().map(|(_, d)| {
            let h = 1e-2;
            let each = |r: u64| {
                let at = |h: f64| {
                    let v: Vec<f64> = before.iter().zip(d).map(|(v, d)| v + h * d).collect();
                    let (theta, estimator) = (Theta::constant(&v), Estimator::Emitter);
                    let settings = Settings {
                        lights: LightChoice::One,
                        ..s.settings
                    };
                    let image = render_f64(
                        &Job::new(&s, &settings, 9000 + r, 0..SPP, &()),
                        &theta,
                        estimator,
                    );
                    dot(&adjoint, &image, 0)
                };
                (at(h) - at(-h)) / (2.0 * h)
            };
            Estimate::of(&(0..REPEATS).into_par_iter().map(each).collect::<Vec<_>>())
        });
        let estimators: [(&str, Reverse); 3] = [
            ("emitter", reverse::<Emitter>),
            ("both", reverse::<Both>),
            ("frozen", reverse::<Frozen>),
        ];
        for (k, (estimator, run)) in estimators.into_iter().enumerate() {
            let seed = 1000 * (k as u64 + 1);
            let gradients: Vec<Vec<f64>> = (0..REPEATS)
                .into_par_iter()
                .map(|r| run(&s, &["sky.data"], &adjoint, seed + r, SPP))
                .collect();
            for ((what, d), reference) in directions.iter().zip(&references) {
                let along = |g: &Vec<f64>| g.iter().zip(d).map(|(g, d)| g * d).sum::<f64>();
                let found = Estimate::of(&gradients.iter().map(along).collect::<Vec<_>>());
                let z = found.z(reference);
                compared += 1;
                println!(
                    "{name:8} {estimator:8} {what:13} {:.6} +- {:.6}  {:.6} +- {:.6}  z {z:.2}",
                    found.mean, found.se, reference.mean, reference.se
                );
                assert!(reference.mean.abs() > 10.0 * reference.se, "says nothing");
                if z.is_nan() || z.abs() > limit {
                    failed.push(format!("{name} {estimator} {what}: {z:.2}"));
                }
            }
        }
    }
    assert_eq!(compared, 36);
    assert!(failed.is_empty(), "limit {limit:.2}: {failed:?}");
}

/// The bright and the black texel that matter most.
fn extremes(s: &Scene, adjoint: &[f32]) -> (usize, usize) {
    let range = s.params().find("sky.data").expect("a map").range();
    let g = reverse::<EmitterOnly<Detached>>(s, &["sky.data"], adjoint, 1, 64);
    let texels = &s.params().values()[range.clone()];
    let largest = |black: bool| {
        let weight = |t: &usize| (g[range.start + 3 * t + 1] * 1e9) as i64;
        let all = 0..texels.len() / 3;
        all.filter(|t| (texels[3 * t + 1] == 0.0) == black)
            .max_by_key(weight)
            .expect("black and bright texels")
    };
    (largest(false), largest(true))
}

/// Sums of moving samples are the same bits for 1, 2 and 7 threads: a map in one exact buffer, one summed per job.
#[test]
fn gradients_do_not_depend_on_threads() {
    let dir = tempfile::tempdir().expect("a folder");
    for map in [sky(16, 8), sky(7, 5)] {
        let s = plane(dir.path(), GLOSSY, &map, SKY, 40);
        let adjoint = mean_adjoint(&s);
        for e in [Estimator::EmitterAttached, Estimator::AttachedBoth] {
            let active = e
                .active(&s, &["sky.data", "metal.alpha.value"])
                .expect("names");
            println!("{}", e.name());
            let values = on_any_threads(|| {
                let theta = Theta::constant(s.params().values());
                let samples = 0..4;
                e.backward_f32(
                    &Job::new(&s, &s.settings, 6, samples, &()),
                    &theta,
                    &active,
                    &adjoint,
                )
                .expect("a scene without discontinuities")
                .values
            });
            assert!(values[0].iter().any(|&x| x != 0.0));
        }
    }
}

/// Samples of lights that move cross what hides them (F8).
#[test]
fn occluders_are_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let ball = r#"<shape type="sphere"><point name="center" value="0, 1, 0"/><float name="radius" value="0.3"/>
        <bsdf type="diffuse"/></shape>"#;
    let open = plane(dir.path(), DIFFUSE, &sky(7, 5), SKY, 8);
    let hidden = plane(dir.path(), DIFFUSE, &sky(7, 5), ball, 8);
    for e in [Estimator::EmitterAttached, Estimator::AttachedBoth] {
        assert!(e.check(&open).is_ok());
        let message = e.check(&hidden).unwrap_err().to_string();
        assert!(message.contains("occlusion"), "{message}");
    }
    assert!(Estimator::Emitter.check(&hidden).is_ok());
}

/// Everything finite for black maps and single rows, in single precision.
#[test]
fn gradients_are_finite() {
    let dir = tempfile::tempdir().expect("a folder");
    let spike = {
        let mut image = Image::new(16, 8);
        image.data[3 * (2 * 16 + 15)..][..3].fill(1e6);
        image
    };
    for map in [Image::new(4, 3), sky(5, 1), sky(1, 1), sky(1, 4), spike] {
        let s = plane(dir.path(), GLOSSY, &map, "", 8);
        let adjoint = mean_adjoint(&s);
        for e in [Estimator::EmitterAttached, Estimator::AttachedBoth] {
            let active = e.active(&s, &["sky.data"]).expect("names");
            let theta = Theta::constant(s.params().values());
            let g = e
                .backward_f32(
                    &Job::new(&s, &s.settings, 8, 0..64, &()),
                    &theta,
                    &active,
                    &adjoint,
                )
                .expect("a scene without discontinuities");
            assert_eq!(g.non_finite.count, 0);
            assert!(g.values[0].iter().all(|x| x.is_finite()));
            assert!(g.values[0].iter().any(|x| *x != 0.0), "no derivative");
        }
    }
}
