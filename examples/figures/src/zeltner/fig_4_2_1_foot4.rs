//! [Zeltner 2021, footnote 4]: which factors of a product may be attached on their own.

use render::sampler::Sampler;
use render::statistics::z_limit;

use super::estimator_parts::DETECTED;
use super::taxonomy::{Power, Rising, expectation, partly_attached};
use crate::statistics::Moments;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// `zeltner-4-2-1-foot4`.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(20_000, 1_000_000), 424);
    fig.note("samples", n);
    fig.note("seed", seed);
    let names = ["g", "h", "1/p"];
    let truth = -3.0 / 16.0;
    // Errata Z-footnote 4; the exponents differ because with g = h some mixtures are right by symmetry.
    let expected = [
        0.0, -0.09375, -0.0625, -0.15625, -0.03125, -0.125, -0.09375, -0.1875,
    ];
    let mut rows = Vec::new();
    for (k, expected) in expected.into_iter().enumerate() {
        let attached = [k & 4 != 0, k & 2 != 0, k & 1 != 0];
        let chosen: Vec<&str> = (names.iter().zip(attached))
            .filter_map(|(name, a)| a.then_some(*name))
            .collect();
        let label = if chosen.is_empty() {
            "nothing".to_owned()
        } else {
            chosen.join(" and ")
        };
        let one =
            |u: f64| partly_attached((&Power(1.0), &Power(2.0)), &Rising, attached, 1.0, u).eps[0];
        let mean = expectation(|u| ad_core::Dual::new(one(u), [0.0])).re;
        let m = Moments::of(n, seed, |s| one(s.next_1d()));
        let right = attached == [true; 3];
        // Attaching nothing gives 0 without variance.
        let z = if m.variance() > 0.0 {
            m.z(truth)
        } else {
            f64::NEG_INFINITY
        };
        let found = if right {
            z.abs() < z_limit(1, n, 1e-3)
        } else {
            z.abs() > DETECTED
        };
        let verdict = if right {
            "right"
        } else {
            "wrong, and detected"
        };
        fig.check(
            format!("attached {label}: {expected}, {verdict}"),
            (mean - expected).abs() < 1e-6 && found,
            format!(
                "{mean:.6} by quadrature; {:.5} ± {:.5}, {:.1} standard errors from {truth}",
                m.mean,
                m.of_mean().se,
                z
            ),
        );
        let numbers = [mean, m.mean, m.of_mean().se, z].map(|v| v.to_string());
        let [a, b, c, d] = numbers;
        rows.push([label, a, b, c, d]);
    }
    let bars = rows.iter().enumerate();
    let bars: Vec<(f64, f64)> = bars
        .map(|(k, r)| (k as f64, r[1].parse().unwrap_or(f64::NAN)))
        .collect();
    let chart = LineChart::new(
        "Derivative of the integral of g h, by what is attached",
        "attached: 4 for g, 2 for h, 1 for 1 / p",
        "mean of the estimate",
    )
    .y_range(-0.2, 0.02)
    .points("mean", bars)
    .dashed("true derivative", [(0.0, truth), (7.0, truth)]);
    fig.chart("factors", &chart);
    let header = ["attached", "quadrature", "mean", "mean_error", "z"];
    fig.csv_text("factors", &header, rows);
    Ok(())
}
