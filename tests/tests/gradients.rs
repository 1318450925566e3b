//! Every parameter of every material and emitter: reverse mode equals forward mode to rounding, and both
//! equal central differences.

use render::bsdf::kernel::Rules;
use render::estimator::{AllowBias, AttachedChoice, AttachedRoulette, DetachedMis, Unbiased};
use render::instances::{Estimator, backward_particles_f32, particles_f32, tangent_f32};
use render::params::{ParamInfo, Theta};
use render::{Job, Settings};
use tests::cases;
use tests::stats::{Estimate, z_limit};
use tests::{
    dot, forward_by, image, mean_adjoint, reverse, reverse_by, scene, smooth_params, values,
};

/// A cheap, fixed sequence in [-1, 1).
fn noise(i: usize) -> f64 {
    render::sampler::mix64(i as u64 + 1) as f64 / u64::MAX as f64 * 2.0 - 1.0
}

/// `<adjoint, J d_theta> = <J^T adjoint, d_theta>` for a random adjoint image and a random direction
/// over all parameters at once, same seed: to 1e-9 in f64.
#[test]
fn reverse_equals_forward_to_rounding() {
    modes_agree::<DetachedMis>();
}

/// The same with probabilities that are differentiated: of lobes, and of lobes and roulette, which decides by a
/// throughput that was divided by the former.
#[test]
fn reverse_equals_forward_through_probabilities() {
    type Choice = AttachedChoice<DetachedMis>;
    modes_agree::<AllowBias<Choice>>();
    modes_agree::<AllowBias<AttachedRoulette<Choice>>>();
}

fn modes_agree<S: Unbiased>() {
    for case in cases::all() {
        let s = scene(&case.body);
        let params = smooth_params(&s);
        let adjoint: Vec<f32> = (0..s.film.pixels() * 3).map(|i| noise(i) as f32).collect();
        let mut direction = vec![0.0; s.params().values().len()];
        for p in &params {
            for i in p.range() {
                direction[i] = noise(i + 7919);
            }
        }
        let j = forward_by::<S>(&s, &direction, &adjoint, &s.settings, 5, 16);
        let g = reverse_by::<f64, S>(&s, &params, &adjoint, &s.settings, 5, 16);
        let terms = || {
            let pairs = params.iter().zip(&g).flat_map(|(p, g)| p.range().zip(g));
            pairs.map(|(i, g)| direction[i] * g)
        };
        let (jt, scale) = (terms().sum::<f64>(), terms().map(f64::abs).sum::<f64>());
        assert!(scale > 0.0, "{}: no derivative at all", case.name);
        assert!(
            (j - jt).abs() < 1e-9 * scale,
            "{}: forward {j} reverse {jt}",
            case.name
        );
    }
}

/// One value too few or too many is an error that says so, in both modes, by paths and by particles.
#[test]
fn values_of_another_scene_are_refused() {
    let s = scene(&cases::all()[0].body);
    let estimator = Estimator::Mis;
    let names = [smooth_params(&s)[0].name.clone()];
    let active = estimator.active(&s, &names).expect("known");
    let adjoint = mean_adjoint(&s);
    let right = s.params().values();
    let direction = vec![1.0; active.len()];
    for wrong in [&right[1..], &[right, &[0.5]].concat()] {
        let job = Job::new(&s, &s.settings, 1, 0..1, &());
        let theta = Theta::constant(wrong);
        let found = [
            estimator
                .backward_f32(&job, &theta, &active, &adjoint)
                .err(),
            backward_particles_f32(&job, &theta, &active, &adjoint).err(),
            particles_f32(&job, &theta, Rules::default()).err(),
            tangent_f32(&job, wrong, &active, &direction).err(),
        ];
        for (k, found) in found.into_iter().enumerate() {
            let message = found.map(|e| e.to_string()).unwrap_or_default();
            let counts = [right.len(), wrong.len()].map(|n| n.to_string());
            let named = message.contains("values of parameters");
            assert!(
                named && counts.iter().all(|n| message.contains(n)),
                "{k}: {message}"
            );
        }
    }
}

/// Light that no wanted derivative needs is not looked at: each parameter alone has, to the last bit, the
/// gradient that it has among all of them.
#[test]
fn what_is_left_out_does_not_matter() {
    for case in cases::all() {
        let s = scene(&case.body);
        let params = smooth_params(&s);
        let adjoint = mean_adjoint(&s);
        let of = |p: &[ParamInfo]| reverse::<f64>(&s, p, &adjoint, &s.settings, 4, 16);
        let together = of(&params);
        for (p, among) in params.iter().zip(&together) {
            let alone = of(std::slice::from_ref(p)).concat();
            assert_eq!(&alone, among, "{}: {}", case.name, p.name);
        }
    }
}

/// Reverse mode in f32 follows f64 with the same seed within 2 % of the gradient's size: a few paths
/// take other turns, nothing drifts.
#[test]
fn single_precision_follows_double() {
    for case in cases::all() {
        let s = scene(&case.body);
        let params = smooth_params(&s);
        let adjoint = mean_adjoint(&s);
        let a = reverse::<f32>(&s, &params, &adjoint, &s.settings, 3, 64).concat();
        let b = reverse::<f64>(&s, &params, &adjoint, &s.settings, 3, 64).concat();
        let norm = b.iter().map(|x| x * x).sum::<f64>().sqrt();
        let diff = a
            .iter()
            .zip(&b)
            .map(|(a, b)| (a - b).powi(2))
            .sum::<f64>()
            .sqrt();
        assert!(diff < 2e-2 * norm, "{}: {diff:e} of {norm:e}", case.name);
    }
}

/// Gradients against central differences in f64 with common random numbers (roulette off: its
/// probabilities depend on the parameters). 32 repetitions of 64 samples per pixel; |z| below the
/// Sidak limit over all parameters at a significance of 1e-3, plus 15 % for Student's t.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn gradients_equal_central_differences() {
    const REPEATS: u64 = 32;
    const SPP: u64 = 64;
    let mut rows = Vec::new();
    for (n, case) in cases::all().into_iter().enumerate() {
        let seed = 10_000 * n as u64;
        let s = scene(&case.body);
        let settings = Settings {
            rr_depth: u32::MAX,
            ..s.settings
        };
        let params = smooth_params(&s);
        let adjoint = mean_adjoint(&s);
        let gradients: Vec<Vec<Vec<f64>>> = (0..REPEATS)
            .map(|r| reverse::<f64>(&s, &params, &adjoint, &settings, seed + r, SPP))
            .collect();
        for (k, p) in params.iter().enumerate() {
            // All elements of a range move together.
            let total = |g: &Vec<Vec<f64>>| g[k].iter().sum::<f64>();
            let g = Estimate::of(&gradients.iter().map(total).collect::<Vec<_>>());
            let base = values::<f64>(&s);
            let h = 2e-2 * base[p.offset].abs().max(0.05);
            let shifted = |d: f64, seed| {
                let mut v = base.clone();
                p.range().for_each(|i| v[i] += d);
                dot(&adjoint, &image::<f64>(&s, &v, &settings, seed, SPP), 0)
            };
            let fd: Vec<f64> = (0..REPEATS)
                .map(|r| (shifted(h, seed + 5000 + r) - shifted(-h, seed + 5000 + r)) / (2.0 * h))
                .collect();
            rows.push((case.name, p.name.clone(), g, Estimate::of(&fd)));
        }
    }
    let limit = z_limit(rows.len(), REPEATS, 1e-3);
    let mut failures = Vec::new();
    for (case, name, g, fd) in &rows {
        let z = g.z(fd);
        println!(
            "{case:>20} {name:42} {:+.4e} +- {:.0e}  fd {:+.4e} +- {:.0e}  z {z:+.2}",
            g.mean, g.se, fd.mean, fd.se
        );
        if z.is_nan() || z.abs() >= limit {
            failures.push(format!("{case}/{name}: z = {z}"));
        }
    }
    assert!(failures.is_empty(), "limit {limit}: {failures:?}");
}
