//! [Zeltner 2021, algorithm 3.2], as corrected (errata Z-Alg-3.1): solutions of known probability and value.

use render::manifold::trials;
use render::sampler::{Independent, Sampler};
use render::statistics::{Estimate, z_limit};

use super::known_solutions::{F, LEVEL, M, P, draw, found, total};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const SEED: u64 = 31;

/// The estimate, and how many trials it took, of `budget` at most. A first walk that fails is worth nothing at once
/// (line 6, corrected: as printed, its end would be looked for for ever).
fn unbiased(s: &mut Independent, budget: u32) -> (f64, u32) {
    match draw(s) {
        None => (0.0, 0),
        Some(k) => {
            let (n, _) = trials(|| draw(s) == Some(k), budget);
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
    // The mean, trials, those that fail, and budgets.
    let tests = 3 + M.len();
    let each: Vec<(f64, u32)> = (0..n)
        .map(|i| unbiased(&mut Independent::new(SEED, 0, i), u32::MAX))
        .collect();
    let mean = Estimate::of(&each.iter().map(|e| e.0).collect::<Vec<_>>());
    let (total, limit) = (total(), z_limit(tests, n, LEVEL));
    let z = mean.z(&Estimate::exact(total));
    fig.check(
        "unbiased estimates have the mean of all solutions",
        z.abs() < limit && mean.se < 0.05 * total,
        format!(
            "{:.4} ± {:.4} of {total}, deviate {z:.2}, limit {limit:.2}",
            mean.mean, mean.se
        ),
    );
    // Of those that found something: as many solutions as there are over the probability to find any.
    let made = each.iter().filter(|e| e.1 > 0).map(|e| f64::from(e.1));
    let made: Vec<f64> = made.collect();
    let taken = Estimate::of(&made);
    let any: f64 = P.iter().sum();
    let expected = P.len() as f64 / any;
    let z = taken.z(&Estimate::exact(expected));
    let limit = z_limit(tests, made.len() as u64, LEVEL);
    fig.check(
        "trials per solution are the number of solutions over the success rate",
        z.abs() < limit,
        format!(
            "{:.4} ± {:.4} of {expected:.4}, deviate {z:.2}, limit {limit:.2}",
            taken.mean, taken.se
        ),
    );
    let fails: Vec<f64> = each.iter().map(|e| f64::from(u8::from(e.1 == 0))).collect();
    let fails = Estimate::of(&fails);
    let z = fails.z(&Estimate::exact(1.0 - any));
    let limit = z_limit(tests, n, LEVEL);
    fig.check(
        "first walks that fail are worth nothing and cost no trials",
        z.abs() < limit && each.iter().all(|e| (e.1 == 0) == (e.0 == 0.0)),
        format!(
            "{:.4} ± {:.4} of all estimates, of {:.4}, deviate {z:.2}, limit {limit:.2}",
            fails.mean,
            fails.se,
            1.0 - any
        ),
    );
    budgets(fig, n, tests);
    Ok(())
}

/// With a budget of trials the mean is that of trial sets of as many walks (F13).
fn budgets(fig: &mut Figure, n: u64, tests: usize) {
    let mut rows = Vec::new();
    for budget in M {
        let each = (0..n).map(|i| {
            let mut s = Independent::new(SEED, u64::from(budget), i);
            unbiased(&mut s, budget).0
        });
        let mean = Estimate::of(&each.collect::<Vec<_>>());
        rows.push([f64::from(budget), mean.mean, mean.se, found(budget)]);
    }
    let z = rows.iter().map(|r| (r[1] - r[3]).abs() / r[2]);
    let worst = z.fold(0.0, f64::max);
    let limit = z_limit(tests, n, LEVEL);
    let total = total();
    fig.check(
        "a budget of trials loses light: the sum of f (1 - (1 - P)^budget) is left",
        worst < limit && rows[0][1] < 0.2 * total,
        format!(
            "{:.3?} of {:.3?}, largest deviate {worst:.2}, limit {limit:.2}",
            rows.iter().map(|r| r[1]).collect::<Vec<_>>(),
            rows.iter().map(|r| r[3]).collect::<Vec<_>>()
        ),
    );
    let chart = LineChart::new(
        "light that a budget of trials leaves",
        "most trials",
        "light",
    )
    .log_x()
    .measured("measured", rows.iter().map(|r| (r[0], r[1])))
    .line("expected", rows.iter().map(|r| (r[0], r[3])))
    .dashed("all", [(1.0, total), (256.0, total)]);
    fig.chart("budgets", &chart);
    fig.csv("budgets", &["trials", "mean", "error", "expected"], rows);
}
