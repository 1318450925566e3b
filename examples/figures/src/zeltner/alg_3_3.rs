//! [Zeltner 2021, algorithm 3.3], as corrected (errata Z-Alg-3.1): trial sets where solutions have a known probability and value.

use render::manifold::distinct;
use render::sampler::{Independent, Sampler};
use render::statistics::{Estimate, z_limit};

use super::known_solutions::{F, LEVEL, M, P, draw, found, total};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const SEED: u64 = 33;

/// Trial sets of one size.
struct Sets {
    walks: u32,
    runs: u64,
    /// The value of distinct solutions.
    distinct: Estimate,
    /// That of the ends of all walks (line 9 as printed, where two walks to a solution end in two points).
    all: Estimate,
    /// How many solutions there are.
    solutions: Estimate,
}

impl Sets {
    fn of(walks: u32, runs: u64) -> Self {
        let sets = (0..runs).map(|i| {
            let mut s = Independent::new(SEED, u64::from(walks), i);
            let mut all = 0.0;
            let walk = || {
                let end = draw(&mut s);
                all += end.map_or(0.0, |k| F[k]);
                end
            };
            let found = distinct(walks, walk, |a, b| a == b);
            let sum: f64 = found.iter().map(|&k| F[k]).sum();
            [sum, all, found.len() as f64]
        });
        let sets: Vec<[f64; 3]> = sets.collect();
        let [distinct, all, solutions] =
            [0, 1, 2].map(|k| Estimate::of(&sets.iter().map(|s| s[k]).collect::<Vec<_>>()));
        Self {
            walks,
            runs,
            distinct,
            all,
            solutions,
        }
    }
}

/// `zeltner-alg-3-3`.
///
/// # Errors
/// None.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(200_000u64, 2_000_000);
    fig.note("walks", n);
    fig.note("seed", SEED);
    let sets = M.map(|m| Sets::of(m, (n / u64::from(m)).max(2000)));
    let total = total();
    // Three numbers of each.
    let limit = |s: &Sets| z_limit(3 * M.len(), s.runs, LEVEL);
    let agrees = |s: &Sets, measured: &Estimate, exact: f64| {
        measured.z(&Estimate::exact(exact)).abs() < limit(s)
    };
    let listed = |of: fn(&Sets) -> f64| sets.each_ref().map(of);
    let exact = M.map(found);
    fig.check(
        "trial sets of M walks have the mean of f (1 - (1 - P)^M), which grows towards that of all",
        sets.iter()
            .zip(exact)
            .all(|(s, exact)| agrees(s, &s.distinct, exact))
            && exact.windows(2).all(|e| e[0] < e[1] && e[1] < total),
        format!("{:.3?} of {exact:.3?}", listed(|s| s.distinct.mean)),
    );
    let number = |m: u32| P.iter().map(|p| 1.0 - (1.0 - p).powi(m as i32)).sum();
    let numbers: [f64; 5] = M.map(number);
    fig.check(
        "each solution counts once, however many walks find it",
        sets.iter()
            .zip(numbers)
            .all(|(s, exact)| agrees(s, &s.solutions, exact)),
        format!(
            "{:.3?} solutions of {numbers:.3?}",
            listed(|s| s.solutions.mean)
        ),
    );
    let one: f64 = P.iter().zip(F).map(|(p, f)| p * f).sum();
    let printed = |s: &Sets| f64::from(s.walks) * one;
    fig.check(
        "were each walk to count that finds one, the mean would grow without bound",
        sets.iter().all(|s| agrees(s, &s.all, printed(s))) && sets[4].all.mean > 10.0 * total,
        format!("{:.3?} for a value of {total}", listed(|s| s.all.mean)),
    );
    let of = |value: fn(&Sets) -> f64| sets.iter().map(move |s| (f64::from(s.walks), value(s)));
    let chart = LineChart::new("light that trial sets find", "walks", "light")
        .log_x()
        .log_y()
        .measured("distinct solutions", of(|s| s.distinct.mean))
        .line("expected", of(|s| found(s.walks)))
        .measured("all ends", of(|s| s.all.mean))
        .dashed("all solutions", of(|_| self::total()));
    fig.chart("trial-sets", &chart);
    let rows = sets.iter().map(|s| {
        let [a, b] = [&s.distinct, &s.all];
        [f64::from(s.walks), a.mean, a.se, found(s.walks), b.mean]
    });
    let columns = ["walks", "mean", "error", "expected", "all_ends"];
    fig.csv("trial-sets", &columns, rows);
    Ok(())
}
