//! [Zeltner 2021, figure 3.26]: trial sets of growing size, in a ring of metal: what they lose, at one point and in the image.

use ad_core::Vec3;
use rayon::prelude::*;
use render::manifold::{Connector, Solution, Target, distinct};
use render::sampler::{Independent, Sampler};
use render::scene::{Connections, Constraint, Method, Starts, Uniqueness};
use render::statistics::{Estimate, z_limit};

use super::manifold_methods::{Effort, Measured, Rare, measure, single};
use super::specular_scenes::{Laboratory, RING, View, load};
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::ranks::percentile;

/// A point of the floor with three reflections, x and z, and the middle of the light.
const FLOOR: [f64; 2] = [4.218, -3.074];
const LIGHT: [f64; 3] = [-12.0, 10.0, 8.0];
/// Sizes of trial sets.
const WALKS: [u32; 5] = [1, 4, 16, 64, 256];
const SEED: u64 = 326;

fn same(a: &Solution, b: &Solution) -> bool {
    a.is(b, Uniqueness::ErrorBounds)
}

/// Connections whose walks start anywhere.
fn from_anywhere(method: Method) -> Connections {
    single(method, Starts::Uniform)
}

/// `zeltner-3-26`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let view = View {
        lookat: [[0.0, 40.0, 40.0], [0.0; 3]],
        fov: 28.0,
        size: fig.pick(16, 48),
    };
    let ring = Laboratory::new(load(RING, &view, 4)?);
    probe(fig, &ring)?;

    // ---- The image ----
    let effort = Effort::of(fig, [2, 8], SEED);
    effort.note(fig, view.size);
    // Unbiased with any starts, and with these of least noise.
    let connections = single(Method::Sms, Starts::Particles);
    let more = Effort {
        spp: 4 * effort.spp,
        ..effort
    };
    let all = measure(&ring.scene, connections, false, more)?;
    let whole = all.whole();
    let rare = Rare::of(&ring.scene, from_anywhere(Method::Sms), effort.other(9))?;
    let mut rows = Vec::new();
    let mut panels = Vec::new();
    let mut errors = Vec::new();
    let mut cost = Vec::new();
    let mut losses = Vec::new();
    let mut parts = Vec::new();
    let factor = fig.pick(10, 4);
    for (k, walks) in (1..).zip(WALKS) {
        let connections = from_anywhere(Method::SmsBiased(walks));
        // The largest have little noise, and take long.
        let fewer = Effort {
            spp: (64 * effort.spp / u64::from(walks)).clamp(1, effort.spp),
            ..effort.other(k)
        };
        let found = measure(&ring.scene, connections, false, fewer)?;
        let part = found.whole();
        let ratio = part.mean / whole.mean;
        let relative = (part.se / part.mean).hypot(whole.se / whole.mean);
        rows.push([f64::from(walks), ratio, ratio * relative]);
        parts.push(part);
        cost.push(found.found.walks as f64 / found.found.attempts.max(1) as f64);
        panels.push(found.panel(&format!("{walks} walks"), &all, factor));
        errors.push((walks, found.squared_bias_by_pixel(&all)));
        losses.push((walks, rare.losses(&found, &all)));
    }
    panels.push(all.panel("unbiased", &all, factor));
    let repeats = Measured::repeats(&[&all]);
    check_losses(fig, &losses, repeats);
    error_maps(fig, &rare, &errors, view.size as usize);
    // Each with the one before, and with all.
    let limit = z_limit(2 * WALKS.len() - 1, repeats, 1e-2);
    let steps: Vec<f64> = parts.windows(2).map(|p| p[1].z(&p[0])).collect();
    fig.check(
        "the energy grows with the trial set, towards that of unbiased estimates",
        steps.iter().all(|z| *z > -limit)
            && steps[0] > limit
            && steps[1] > limit
            && rows.iter().all(|r| r[1] < 1.0 + limit * r[2]),
        format!(
            "{:.3?}, steps of {steps:.1?} standard errors, limit {limit:.2}",
            rows.iter().map(|r| r[1]).collect::<Vec<_>>()
        ),
    );
    fig.check(
        "samples in the same number of walks go down as one over the size of the trial set",
        (cost.iter().zip(WALKS)).all(|(c, m)| (c / f64::from(m) - 1.0).abs() < 1e-12),
        format!("{cost:?} walks for each"),
    );
    fig.csv("energy", &["walks", "ratio", "error"], rows);
    fig.images("trial-sets", 3, &panels);
    Ok(())
}

/// That trial sets of few walks lose more where solutions are rare.
fn check_losses(fig: &mut Figure, losses: &[(u32, [Estimate; 2])], repeats: u64) {
    // Larger sets lose next to nothing anywhere, single walks nearly all; few samples do not tell what 16 lose.
    let compared: &[u32] = fig.pick(&[4], &[4, 16]);
    let limit = z_limit(compared.len(), repeats, 1e-2);
    let z = losses.iter().filter(|(walks, _)| compared.contains(walks));
    let z: Vec<f64> = z.map(|(_, [rare, common])| rare.z(common)).collect();
    let each = losses.iter().map(|(walks, loss)| {
        let [a, b] = loss.map(|e| format!("{:.3} ± {:.3}", e.mean, e.se));
        format!("{walks}: {a} and {b}")
    });
    fig.check(
        "trial sets lose more where solutions are rare: in the half of the pixels where these take most trials",
        z.iter().all(|z| *z > limit),
        format!(
            "{} of the light; deviates {z:.1?} of {compared:?} walks, limit {limit:.2}",
            each.collect::<Vec<_>>().join(", ")
        ),
    );
    let of = |k: usize| {
        let share = move |(walks, loss): &(u32, [Estimate; 2])| (f64::from(*walks), loss[k].mean);
        losses.iter().map(share)
    };
    let chart = LineChart::new("what trial sets lose", "walks", "share of the light")
        .log_x()
        .measured("where solutions are rare", of(0))
        .measured("where they are not", of(1));
    fig.chart("losses", &chart);
}

/// Squared errors by pixel of trial sets, noise taken off, on one scale, and how rare solutions are.
fn error_maps(fig: &mut Figure, rare: &Rare, errors: &[(u32, Vec<f64>)], width: usize) {
    let factor = fig.pick(10, 4);
    let scale = errors.first().map(|(_, first)| percentile(first, 0.95));
    let mut panels: Vec<Panel> = (errors.iter())
        .map(|(walks, error)| {
            let label = format!("squared error, {walks} walks");
            Panel::signed(&label, width, error, scale).enlarged(factor)
        })
        .collect();
    let most = percentile(&rare.trials, 0.95);
    let trials = Panel::false_colour("trials per solution", width, &rare.trials, 0.0, most);
    panels.push(trials.enlarged(factor));
    fig.images("errors", 3, &panels);
}

/// At one point of the floor: `sum f (1 - (1 - P)^M)` over its solutions.
fn probe(fig: &mut Figure, ring: &Laboratory) -> Result {
    let connections = from_anywhere(Method::Sms);
    let split = ring.split(&connections)?;
    let connector = Connector::new(ring.space(Constraint::Angle), &split, connections);
    let target = Target::Point(Vec3::from(LIGHT));
    let start = ring.floor(FLOOR[0], FLOOR[1]).ok_or("no floor")?;
    let walk = |rng: &mut Independent| connector.explore(&start, &target, 1, rng);
    let mut rng = Independent::new(SEED, 0, 0);
    let solutions = distinct(2000, || walk(&mut rng), same);
    let n = fig.pick(20_000u64, 200_000);
    fig.note("walks", n);
    let ends: Vec<Option<usize>> = (0..n)
        .into_par_iter()
        .map(|i| {
            let end = walk(&mut Independent::new(SEED, 1, i))?;
            solutions.iter().position(|s| same(s, &end))
        })
        .collect();
    let found: Vec<(f64, f64)> = (solutions.iter().enumerate())
        .map(|(k, s)| {
            let hits = ends.iter().filter(|e| **e == Some(k)).count();
            (hits as f64 / n as f64, s.angle_per_target())
        })
        .collect();
    let whole: f64 = found.iter().map(|(_, f)| f).sum();
    let mut rows = Vec::new();
    for walks in WALKS {
        let sets = (n / u64::from(walks)).max(1000);
        let sums: Vec<f64> = (0..sets)
            .into_par_iter()
            .map(|i| {
                let mut rng = Independent::new(SEED, 2 + u64::from(walks), i);
                let found = distinct(walks, || walk(&mut rng), same);
                found.iter().map(Solution::angle_per_target).sum()
            })
            .collect();
        let mean = Estimate::of(&sums);
        let m = f64::from(walks);
        let expected: f64 = (found.iter())
            .map(|(p, f)| f * (1.0 - (1.0 - p).powf(m)))
            .sum();
        // What is missed so seldom that no set may show it has an error, too.
        let seldom = (found.iter())
            .map(|(p, f)| (1.0 - p).powf(m) * f * f / sets as f64)
            .sum::<f64>()
            .sqrt();
        // Of the measured probabilities.
        let error = (found.iter())
            .map(|(p, f)| (f * m * (1.0 - p).powf(m - 1.0)).powi(2) * p * (1.0 - p) / n as f64)
            .sum::<f64>()
            .sqrt();
        rows.push([
            m,
            mean.mean / whole,
            mean.se.max(seldom).hypot(error) / whole,
            expected / whole,
        ]);
    }
    let worst = rows.iter().map(|r| ((r[1] - r[3]) / r[2].max(1e-9)).abs());
    let worst = worst.fold(0.0, f64::max);
    // Of at least 1000 sets.
    let limit = z_limit(rows.len(), 1000, 1e-2);
    fig.check(
        "at a point with three solutions, trial sets of M walks find the sum of f (1 - (1 - P)^M)",
        solutions.len() == 3 && worst < limit,
        format!(
            "{:.4?} of {:.4?}, largest deviate {worst:.2}, limit {limit:.2}",
            rows.iter().map(|r| r[1]).collect::<Vec<_>>(),
            rows.iter().map(|r| r[3]).collect::<Vec<_>>()
        ),
    );
    let chart = LineChart::new("light that trial sets find at a point", "walks", "share")
        .log_x()
        .measured("measured", rows.iter().map(|r| (r[0], r[1])))
        .line("expected", rows.iter().map(|r| (r[0], r[3])));
    fig.chart("probe", &chart);
    fig.csv("probe", &["walks", "share", "error", "expected"], rows);
    Ok(())
}
