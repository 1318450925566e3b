//! [Zeltner 2021, figure 2.25]: antithetic pairs for a monotone and for a signed integrand.

use std::f64::consts::TAU;

use ad_core::{DiffFn, diff_fn, newton};
use render::sampler::Sampler;
use render::statistics::z_limit;

use super::integration_1d::{integrate, positions};
use crate::statistics::Moments;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const RANGE: [f64; 2] = [0.0, 1.0];

diff_fn! {
    /// The monotone integrand; it decreases.
    pub fn monotone<R>([x]: [R; 1]) -> [R; 1] { [(x * R::c(-2.0)).exp()] }
}

diff_fn! {
    /// The integrand of both signs: nearly symmetric about 1/2, nearly antisymmetric about its root near 1/4.
    pub fn signed<R>([x]: [R; 1]) -> [R; 1] {
        [(x * R::c(TAU)).cos() + x * R::c(0.15)]
    }
}

/// Means that are compared: of pairs by three rules, and of single samples of two functions.
const TESTS: usize = 5;

/// Results for one integrand and one rule for the second sample.
struct Pairing {
    name: &'static str,
    pairs: Moments,
    rows: Vec<(f64, f64)>,
}

/// `zeltner-2-25`.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(100_000, 4_000_000), 4);
    fig.note("pairs", n);
    fig.note("seed", seed);
    let root = newton(&signed, [0.25], &Default::default()).x[0];
    fig.note("root", root);
    let flip = |x: f64| 1.0 - x;
    // The interval is a circle: nothing falls off its ends, and uniform stays uniform.
    let mirror = move |x: f64| (2.0 * root - x).rem_euclid(1.0);
    study(
        fig,
        n,
        seed,
        "monotone",
        &monotone,
        &[("x~ = 1 - x", &flip, true)],
    );
    fig.check(
        "the mirror is at a root of the signed function",
        signed.eval([root])[0].abs() < 1e-12,
        format!("x0 = {root:.6}, f(x0) = {:.1e}", signed.eval([root])[0]),
    );
    let rules: [Rule; 2] = [
        ("x~ mirrored at the root", &mirror, true),
        ("x~ = 1 - x", &flip, false),
    ];
    study(fig, n, seed + 1, "signed", &signed, &rules);
    Ok(())
}

/// Name, partner of a sample, and whether the partner should help.
type Rule<'a> = (&'static str, &'a dyn Fn(f64) -> f64, bool);

fn study(
    fig: &mut Figure,
    n: u64,
    seed: u64,
    name: &str,
    function: &impl DiffFn<1, 1>,
    rules: &[Rule],
) {
    let f = |x: f64| function.eval([x])[0];
    let truth = integrate(RANGE, 4000, f);
    let plain = Moments::of(n, seed, |s| f(s.next_1d()));
    let limit = z_limit(TESTS, n, 1e-3);
    let mut results = Vec::new();
    for (rule, partner, helps) in rules {
        let pair = |x: f64| 0.5 * (f(x) + f(partner(x)));
        let pairs = Moments::of(n, seed, |s| pair(s.next_1d()));
        fig.check(
            format!("{name} function, {rule}: the same mean"),
            pairs.z(truth).abs() < limit && plain.z(truth).abs() < limit,
            format!(
                "pairs {:.6} ± {:.6}, single {:.6} ± {:.6}, quadrature {truth:.6}: deviates {:.2}, {:.2}, limit {limit:.2} ({n} each)",
                pairs.mean,
                pairs.of_mean().se,
                plain.mean,
                plain.of_mean().se,
                pairs.z(truth),
                plain.z(truth)
            ),
        );
        // A pair has two evaluations.
        let ratio = plain.variance() / (2.0 * pairs.variance());
        let relative = |m: &Moments| m.of_variance().se / m.variance();
        let error = ratio * relative(&plain).hypot(relative(&pairs));
        if *helps {
            fig.check(
                format!("{name} function, {rule}: variance at equal evaluations falls by > 5 x"),
                ratio - 5.0 * error > 5.0,
                format!("by {ratio:.2} ± {error:.2}"),
            );
        } else {
            fig.check(
                format!("{name} function, {rule}: the wrong pairing increases variance"),
                ratio + 5.0 * error < 1.0,
                format!(
                    "to {:.3} ± {:.3} of it",
                    1.0 / ratio,
                    error / (ratio * ratio)
                ),
            );
        }
        let rows = positions(RANGE, 800).map(|x| (x, pair(x))).collect();
        results.push(Pairing {
            name: rule,
            pairs,
            rows,
        });
    }
    let title = format!("Antithetic sampling of a {name} function (p = 1)");
    let (low, high) = positions(RANGE, 400)
        .map(f)
        .fold((0.0f64, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
    let mut chart = LineChart::new(&title, "x", "sample weight")
        .x_range(0.0, 1.0)
        .y_range(low * 1.1, high + 0.45 * (high - low))
        .line("single: f", positions(RANGE, 400).map(|x| (x, f(x))));
    for r in &results {
        let label = format!(
            "pairs, {}: variance {:.5} per pair",
            r.name,
            r.pairs.variance()
        );
        chart = chart.line(&label, r.rows.clone());
    }
    chart = chart.dashed("integral", [(0.0, truth), (1.0, truth)]);
    fig.chart(name, &chart);
    let rows = results.iter().flat_map(|r| {
        let text = |(x, v): &(f64, f64)| {
            [
                r.name.to_string(),
                x.to_string(),
                f(*x).to_string(),
                v.to_string(),
            ]
        };
        r.rows.iter().map(text)
    });
    let rows: Vec<_> = rows.collect();
    fig.csv_text(name, &["pairing", "x", "single", "pair"], rows);
}
