//! Samples shared unevenly among pixels: the same expectations, less noise, and a measurement of that noise.

use render::Job;
use render::auto;
use render::instances::{Direction, Estimator, gauss_newton_f32};
use render::params::Theta;
use render::{RenderError, Scene};
use tests::stats::{Estimate, z_limit};
use tests::{dot, mean_adjoint, scene};

const REPEATS: u64 = 64;
/// Chance of a false alarm of one test.
const ALPHA: f64 = 1e-3;
const NAMES: [&str; 3] = [
    "shiny.alpha.value",
    "matt.reflectance.value",
    "ball.emitter.radiance.value",
];

/// A small shiny plate on a large matt one, below a ball.
fn small_plate() -> Scene {
    below_ball(9.0)
}

/// The same below a ball of this radiance.
fn below_ball(radiance: f64) -> Scene {
    let text = r#"<sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 2, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="21"/><integer name="height" value="18"/>
        <rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="3"/></integrator>
        <bsdf type="diffuse" id="matt"><rgb name="reflectance" value="0.3, 0.5, 0.7"/></bsdf>
        <bsdf type="roughconductor" id="shiny"><string name="material" value="none"/>
        <float name="alpha" value="0.1"/></bsdf>
        <shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/>
        </transform><ref id="matt"/></shape>
        <shape type="rectangle"><transform name="to_world"><scale value="0.3"/><rotate x="1" angle="-70"/>
        <translate x="0.5" y="0.5"/></transform><ref id="shiny"/></shape>
        <shape type="sphere" id="ball"><point name="center" value="-0.5, 2, -2"/>
        <float name="radius" value="0.3"/><emitter type="area"><rgb name="radiance" value="RADIANCE"/></emitter></shape>"#;
    scene(&text.replace("RADIANCE", &radiance.to_string()))
}

/// From a quarter to sixty-four times as many samples.
fn uneven(s: &Scene) -> Vec<f32> {
    let random = |i: usize| render::sampler::mix64(i as u64 + 1) as f32 / u64::MAX as f32;
    (0..s.film.pixels()).map(|i| random(i).powi(6)).collect()
}

fn weighed(mut s: Scene) -> Scene {
    s.set_pixel_weights(&uneven(&s)).expect("weights");
    s
}

/// Anything but the same everywhere.
fn adjoint(s: &Scene) -> Vec<f32> {
    let random = |i: usize| render::sampler::mix64(i as u64) as f32 / u64::MAX as f32;
    (0..s.film.pixels() * 3).map(random).collect()
}

fn gradient(s: &Scene, e: Estimator, seed: u64, spp: u64) -> Vec<f64> {
    let theta = Theta::constant(s.params().values());
    let active = e.active(s, &NAMES).expect("parameters");
    let g = e.backward_f32(
        &Job::new(s, &s.settings, seed, 0..spp, &()),
        &theta,
        &active,
        &adjoint(s),
    );
    g.expect("a gradient").values.concat()
}

const ESTIMATORS: [Estimator; 3] = [
    Estimator::MisBalance,
    Estimator::DifferentialMis,
    Estimator::ReparameterisedMis,
];

/// Gradients with and without weights agree, of 64 repeats of 64 samples per pixel (significance 1e-3 over 3
/// estimators and 7 values), and so does the image, in three channels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn weights_change_no_expectation() {
    let (even, uneven) = (small_plate(), weighed(small_plate()));
    let limit = z_limit(ESTIMATORS.len() * 7, REPEATS, ALPHA);
    for e in ESTIMATORS {
        // Other seeds: with the same ones, the samples of a pixel begin alike.
        let [a, b] = [(&even, 0), (&uneven, 1000)].map(|(s, first)| -> Vec<Vec<f64>> {
            let seeds = first..first + REPEATS;
            seeds.map(|seed| gradient(s, e, seed, 64)).collect()
        });
        for i in 0..7 {
            let of = |runs: &[Vec<f64>]| {
                let numbers: Vec<f64> = runs.iter().map(|r| r[i]).collect();
                Estimate::of(&numbers)
            };
            let (a, b) = (of(&a), of(&b));
            assert!(a.mean != 0.0 && a.mean != b.mean);
            let z = a.z(&b);
            assert!(z.abs() < limit, "{} {i}: {a:?} {b:?}, z {z}", e.name());
        }
    }
    let image = |s: &Scene, first: u64, c: usize| {
        let one = |seed| {
            let v = s.params().values();
            let e = Estimator::Mis;
            let r = e.forward_f32(&Job::new(s, &s.settings, seed, 0..16, &()), v, &[]);
            r.expect("an image").mean(0)[c]
        };
        Estimate::of(&(first..first + REPEATS).map(one).collect::<Vec<f64>>())
    };
    for c in 0..3 {
        let z = image(&even, 0, c).z(&image(&uneven, 1000, c));
        assert!(z.abs() < z_limit(3, REPEATS, ALPHA), "{c}: {z}");
    }
}

/// Forward and reverse mode see the same samples.
#[test]
fn forward_is_reverse() {
    let s = weighed(small_plate());
    let along: Vec<Direction> = NAMES
        .map(|n| Direction::uniform(s.params(), n).expect("a parameter"))
        .into();
    for e in ESTIMATORS {
        let v = s.params().values();
        let r = e.forward_f32(&Job::new(&s, &s.settings, 5, 0..16, &()), v, &along);
        let forward = dot(&adjoint(&s), &r.expect("an image"), 1);
        let reverse: f64 = gradient(&s, e, 5, 16).iter().sum();
        let error = (forward - reverse).abs() / reverse.abs();
        assert!(error < 2e-5, "{}: {forward} {reverse}", e.name());
    }
}

/// The Gauss-Newton matrix takes squares and pairs of as many samples as each pixel has (significance 1e-3 over 28
/// entries, 64 repeats).
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn gauss_newton_knows_the_counts() {
    let (even, uneven) = (small_plate(), weighed(small_plate()));
    let matrix = |s: &Scene, first: u64| -> Vec<Vec<f64>> {
        let theta = Theta::constant(s.params().values());
        let active = Estimator::Mis.active(s, &NAMES).expect("parameters");
        let d = adjoint(s);
        let each = (first..first + REPEATS).map(|seed| {
            let found = gauss_newton_f32(
                &Job::new(s, &s.settings, seed, 0..16, &()),
                &theta,
                &active,
                [&d, &d],
            );
            found.expect("a matrix").matrix
        });
        each.collect()
    };
    let (a, b) = (matrix(&even, 0), matrix(&uneven, 1000));
    for i in 0..49 {
        let of = |runs: &[Vec<f64>]| Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>());
        let z = of(&a).z(&of(&b));
        assert!(z.abs() < z_limit(28, REPEATS, ALPHA), "{i}: {z}");
    }
}

/// What a pass says of its noise is the variance between passes, of each parameter times its scale and of all together,
/// over 512 passes (whose variance is good to 6 %), with and without weights.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn noise_is_the_variance_between_passes() {
    const PASSES: u64 = 512;
    let scales = [7.0, 0.3];
    for s in [small_plate(), weighed(small_plate())] {
        let e = Estimator::MisBalance;
        let theta = Theta::constant(s.params().values());
        let active = e.active(&s, &NAMES).expect("parameters");
        let active = active.with_noise(&s, &scales);
        let d = adjoint(&s);
        let (mut said, mut of_pixels) = ([0.0; 3], 0.0);
        let runs: Vec<Vec<Vec<f64>>> = (0..PASSES)
            .map(|seed| {
                let g = e.backward_f32(
                    &Job::new(&s, &s.settings, seed, 0..8, &()),
                    &theta,
                    &active,
                    &d,
                );
                let g = g.expect("a gradient");
                let noise = g.noise.expect("noise");
                assert_eq!(noise.pixels.len(), s.film.pixels());
                for p in &noise.pixels {
                    let n = p.samples as f64;
                    assert!(p.samples >= 2 && p.work >= p.samples);
                    of_pixels += p.squares / (n - 1.0) / n / PASSES as f64;
                }
                for (said, v) in said.iter_mut().zip(&noise.variances) {
                    *said += v / PASSES as f64;
                }
                g.values
            })
            .collect();
        let seen: [f64; 3] = std::array::from_fn(|k| {
            let of = |i: usize| Estimate::of(&runs.iter().map(|r| r[k][i]).collect::<Vec<f64>>());
            let scale = scales.get(k).copied().unwrap_or(1.0);
            (0..runs[0][k].len())
                .map(|i| (of(i).se * scale).powi(2) * PASSES as f64)
                .sum()
        });
        for k in 0..3 {
            let ratio = said[k] / seen[k];
            assert!((ratio - 1.0).abs() < 0.3, "{}: {said:?} {seen:?}", NAMES[k]);
        }
        let all: f64 = said.iter().sum();
        assert!((of_pixels / all - 1.0).abs() < 1e-9, "{of_pixels} {all}");
    }
}

/// Measured weights go to the few pixels that see a roughness, and leave less than two thirds of the variance (64
/// repeats each, whose ratio is good to a quarter); the same seed measures the same.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn measured_weights_make_less_noise() {
    let mut s = small_plate();
    // Direct light: what the plate throws on the other one is found so rarely that no few repeats tell its variance.
    s.settings.max_depth = 2;
    let (e, name) = (Estimator::MisBalance, ["shiny.alpha.value"]);
    let ones = mean_adjoint(&s);
    let variance = |s: &Scene| {
        let theta = Theta::constant(s.params().values());
        let active = e.active(s, &name).expect("a parameter");
        let one = |seed| {
            let g = e.backward_f32(
                &Job::new(s, &s.settings, seed, 0..16, &()),
                &theta,
                &active,
                &ones,
            );
            g.expect("a gradient").values[0][0]
        };
        Estimate::of(&(0..REPEATS).map(one).collect::<Vec<f64>>())
            .se
            .powi(2)
    };
    let measure = |s: &Scene, seed| {
        auto::pixel_weights(s, &name, &ones, e, &s.settings, seed, &()).expect("weights")
    };
    let even = variance(&s);
    let weights = measure(&s, 1);
    assert_eq!(weights, measure(&s, 1));
    assert_ne!(weights, measure(&s, 2));
    s.set_pixel_weights(&weights).expect("weights");
    let ratio = even / variance(&s);
    assert!(ratio > 1.5, "{ratio}");
}

/// No parameter pays for another whose derivatives are larger, here a thousand times in variance: each has less noise
/// than with even samples, and the one that few pixels see far less (64 repeats each, whose ratio is good to a quarter;
/// 2.0 for both if derivatives count by the size of their parameters).
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn parameters_count_alike_whatever_their_units() {
    let mut s = below_ball(0.09);
    s.settings.max_depth = 2;
    let (e, names) = (
        Estimator::MisBalance,
        ["shiny.alpha.value", "ball.emitter.radiance.value"],
    );
    let ones = mean_adjoint(&s);
    let variances = |s: &Scene| -> [f64; 2] {
        let theta = Theta::constant(s.params().values());
        let active = e.active(s, &names).expect("parameters");
        let runs: Vec<_> = (0..REPEATS)
            .map(|seed| {
                let g = e.backward_f32(
                    &Job::new(s, &s.settings, seed, 0..16, &()),
                    &theta,
                    &active,
                    &ones,
                );
                g.expect("a gradient").values
            })
            .collect();
        std::array::from_fn(|k| {
            let of: Vec<f64> = runs.iter().map(|r| r[k].iter().sum()).collect();
            Estimate::of(&of).se.powi(2)
        })
    };
    let even = variances(&s);
    let weights = auto::pixel_weights(&s, &names, &ones, e, &s.settings, 1, &()).expect("weights");
    s.set_pixel_weights(&weights).expect("weights");
    let found = variances(&s);
    let ratio: [f64; 2] = std::array::from_fn(|k| even[k] / found[k]);
    assert!(
        even[0] / even[1] > 1e3 || even[1] / even[0] > 1e3,
        "{even:?}"
    );
    assert!(ratio[0] > 4.0 && ratio[1] > 1.0, "{ratio:?}");
}

#[test]
fn wrong_weights_are_refused() {
    let mut s = small_plate();
    let n = s.film.pixels();
    let short = s.set_pixel_weights(&vec![1.0; n - 1]);
    assert!(matches!(short, Err(RenderError::WrongLength { .. })));
    for bad in [-1.0, f32::NAN, f32::INFINITY] {
        let mut weights = vec![1.0; n];
        weights[7] = bad;
        let error = s.set_pixel_weights(&weights).unwrap_err().to_string();
        assert!(error.starts_with("weight of pixel 7"), "{error}");
    }
    let none = auto::pixel_weights(
        &s,
        &["roof"],
        &mean_adjoint(&s),
        Estimator::Mis,
        &s.settings,
        1,
        &(),
    );
    assert!(none.is_err());
}
