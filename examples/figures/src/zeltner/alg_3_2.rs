//! [Zeltner 2021, algorithms 3.2 and 3.3], as corrected (errata Z-Alg-3.1): solutions of known probability and value.

use render::manifold::{distinct, trials};
use render::sampler::{Independent, Sampler};
use render::statistics::{Estimate, z_limit};

use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// Probability and value of each solution (errata Z-3.18).
const P: [f64; 4] = [0.5, 0.2, 0.05, 0.01];
const F: [f64; 4] = [1.0, 2.0, 3.0, 4.0];
/// Sizes of trial sets.
const M: [u32; 5] = [1, 4, 16, 64, 256];
const SEED: u64 = 31;
/// Significance of all comparisons together.
const LEVEL: f64 = 1e-3;

/// Draws a solution, or none.
fn draw(s: &mut Independent) -> Option<usize> {
    let mut u = s.next_1d::<f64>();
    P.iter().position(|p| {
        u -= p;
        u < 0.0
    })
}

/// Algorithm 3.2: the estimate, and how many trials it took. A first walk that fails is worth nothing at once
/// (line 6, corrected: as printed, its end would be looked for for ever).
fn unbiased(s: &mut Independent) -> (f64, u32) {
    match draw(s) {
        None => (0.0, 0),
        Some(k) => {
            let (n, _) = trials(|| draw(s) == Some(k), u32::MAX);
            (F[k] * f64::from(n), n)
        }
    }
}

/// `zeltner-alg-3-2`.
///
/// # Errors
/// None.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(100_000u64, 1_000_000);
    fig.note("estimates", n);
    fig.note("seed", SEED);
    let total: f64 = F.iter().sum();

    // ---- Algorithm 3.2 ----
    let each: Vec<(f64, u32)> = (0..n)
        .map(|i| unbiased(&mut Independent::new(SEED, 0, i)))
        .collect();
    let mean = Estimate::of(&each.iter().map(|e| e.0).collect::<Vec<_>>());
    // Seven comparisons, of which those of trial sets have fewest samples.
    let tests = 2 + M.len();
    let (z, limit) = (mean.z(&Estimate::exact(total)), z_limit(tests, n, LEVEL));
    fig.check(
        "unbiased estimates have the mean of all solutions",
        z.abs() < limit && mean.se < 0.05 * total,
        format!(
            "{:.4} ± {:.4} of {total}, deviate {z:.2}, limit {limit:.2}",
            mean.mean, mean.se
        ),
    );
    // Of those that found something: as many solutions as there are over the probability to find any.
    let found = each.iter().filter(|e| e.1 > 0).map(|e| f64::from(e.1));
    let found: Vec<f64> = found.collect();
    let taken = Estimate::of(&found);
    let expected = P.len() as f64 / P.iter().sum::<f64>();
    let z = taken.z(&Estimate::exact(expected));
    let limit = z_limit(tests, found.len() as u64, LEVEL);
    fig.check(
        "trials per solution are the number of solutions over the success rate",
        z.abs() < limit,
        format!(
            "{:.4} ± {:.4} of {expected:.4}, deviate {z:.2}, limit {limit:.2}",
            taken.mean, taken.se
        ),
    );

    // ---- Algorithm 3.3 ----
    let mut rows = Vec::new();
    let mut within = true;
    for m in M {
        let runs = (n / u64::from(m)).max(2000);
        let sums = (0..runs).map(|i| {
            let mut s = Independent::new(SEED, u64::from(m), i);
            let found = distinct(m, || draw(&mut s), |a, b| a == b);
            found.iter().map(|&k| F[k]).sum()
        });
        let mean = Estimate::of(&sums.collect::<Vec<_>>());
        let exact: f64 = (P.iter().zip(F))
            .map(|(p, f)| f * (1.0 - (1.0 - p).powi(m as i32)))
            .sum();
        within &= mean.z(&Estimate::exact(exact)).abs() < z_limit(tests, runs, LEVEL);
        rows.push([f64::from(m), mean.mean, mean.se, exact]);
    }
    fig.check(
        "trial sets of M walks have the mean of f (1 - (1 - P)^M), which grows towards that of all",
        within
            && rows
                .windows(2)
                .all(|r| r[0][3] < r[1][3] && r[1][3] < total),
        format!(
            "{:.3?} of {:.3?}",
            rows.iter().map(|r| r[1]).collect::<Vec<_>>(),
            rows.iter().map(|r| r[3]).collect::<Vec<_>>()
        ),
    );

    let chart = LineChart::new("light that trial sets find", "walks", "light")
        .log_x()
        .measured("measured", rows.iter().map(|r| (r[0], r[1])))
        .line("expected", rows.iter().map(|r| (r[0], r[3])))
        .dashed("all", [(1.0, total), (256.0, total)]);
    fig.chart("trial-sets", &chart);
    fig.csv("trial-sets", &["walks", "mean", "error", "expected"], rows);
    Ok(())
}
