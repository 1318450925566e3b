//! [Zeltner 2021, figure 3.26]: trial sets of growing size, in a ring of metal: what they lose, at one point and in the image.

use ad_core::Vec3;
use rayon::prelude::*;
use render::manifold::{Connector, Solution, Target, distinct};
use render::sampler::{Independent, Sampler};
use render::scene::{Connections, Constraint, Method, Starts, Uniqueness};
use render::statistics::{Estimate, z_limit};

use super::manifold_methods::{Effort, measure, single};
use super::specular_scenes::{Laboratory, RING, View, load};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

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
    let all = measure(&ring.scene, from_anywhere(Method::Sms), false, effort)?;
    let whole = all.whole();
    let mut rows = Vec::new();
    let mut panels = Vec::new();
    let mut cost = Vec::new();
    let factor = fig.pick(10, 4);
    for (k, walks) in (1..).zip(WALKS).take(fig.pick(3, 4)) {
        let connections = from_anywhere(Method::SmsBiased(walks));
        let found = measure(&ring.scene, connections, false, effort.other(k))?;
        let part = found.whole();
        let ratio = part.mean / whole.mean;
        let relative = (part.se / part.mean).hypot(whole.se / whole.mean);
        rows.push([f64::from(walks), ratio, ratio * relative]);
        cost.push(found.found.walks as f64 / found.found.attempts.max(1) as f64);
        panels.push(found.panel(&format!("{walks} walks"), &all, factor));
    }
    panels.push(all.panel("unbiased", &all, factor));
    fig.check(
        "the energy grows with the trial set, towards that of unbiased estimates",
        rows.windows(2).all(|r| r[1][1] > r[0][1]) && rows.iter().all(|r| r[1] < 1.0 + 4.0 * r[2]),
        format!("{:.3?}", rows.iter().map(|r| r[1]).collect::<Vec<_>>()),
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
