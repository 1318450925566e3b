//! [Zeltner 2021, figure 4.13]: which techniques and weights may be mixed.

use render::sampler::Sampler;
use render::statistics::z_limit;

use super::estimator_parts::{DETECTED, name};
use super::taxonomy::{
    Differentiation, Falling, Ramp, Rising, Sampling, Weight, combined, expectation, is_unbiased,
};
use crate::statistics::Moments;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// `zeltner-4-13`.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(100_000, 4_000_000), 413);
    fig.note("samples", n);
    fig.note("seed", seed);
    let truth = -2.0 * (1.0 / 9.0 + 1.0 / 16.0);
    use Sampling::{Attached as A, Detached as D};
    use Weight::{Attached as WA, Detached as WD, Frozen as WF};
    // Errata Z-4.13f, and the weights that are taken at the moving sample with a constant parameter.
    let table = [
        (
            "both detached, detached weights",
            [(D, WD), (D, WD)],
            -0.347222,
        ),
        (
            "both attached, attached weights",
            [(A, WA), (A, WA)],
            -0.347222,
        ),
        (
            "both detached, attached weights",
            [(D, WA), (D, WA)],
            -0.347222,
        ),
        (
            "attached and detached, attached weights",
            [(A, WA), (D, WA)],
            -0.347222,
        ),
        (
            "both attached, frozen weights",
            [(A, WF), (A, WF)],
            -0.347222,
        ),
        (
            "attached, frozen weight; detached, detached weight",
            [(A, WF), (D, WD)],
            -0.347222,
        ),
        (
            "both attached, detached weights [Eq. 4.38]",
            [(A, WD), (A, WD)],
            -0.398472,
        ),
        (
            "attached, attached weight; detached, detached weight",
            [(A, WA), (D, WD)],
            -0.340278,
        ),
        (
            "detached, detached weight; detached, attached weight",
            [(D, WD), (D, WA)],
            -0.354167,
        ),
    ];
    let table = table.map(|(label, parts, expected)| {
        let parts = parts.map(|(sampling, weight)| Differentiation { sampling, weight });
        (label, parts, expected)
    });
    let right = table.iter().filter(|row| is_unbiased(row.1)).count();
    let limit = z_limit(right, n, 1e-3);
    let mut rows = Vec::new();
    for (label, parts, expected) in table {
        let one = |u: [f64; 2]| combined(&Ramp, (&Rising, &Falling), parts, 1, 1.0, u).eps[0];
        let mean = expectation(|u| ad_core::Dual::new(one([u, u]), [0.0])).re;
        let m = Moments::of(n, seed, |s| one(s.next_2d()));
        let z = m.z(truth);
        let valid = is_unbiased(parts);
        let found = if valid {
            z.abs() < limit
        } else {
            z.abs() > DETECTED
        };
        let verdict = if valid {
            "unbiased"
        } else {
            "biased, and detected"
        };
        fig.check(
            format!("{label}: {expected}, {verdict}"),
            (mean - expected).abs() < 1e-6
                && found
                && valid == ((expected - truth).abs() < 1e-6),
            format!(
                "{mean:.6} by quadrature; {:.5} ± {:.5}, {z:.1} standard errors from {truth:.6}, limit {limit:.2}; std {:.3}",
                m.mean,
                m.of_mean().se,
                m.variance().sqrt()
            ),
        );
        let numbers = [mean, m.mean, m.of_mean().se, z, m.variance().sqrt()];
        let [a, b, c, d, e] = numbers.map(|v| v.to_string());
        let parts = parts.map(|p| name(p).to_owned());
        let [first, second] = parts;
        rows.push([first, second, valid.to_string(), a, b, c, d, e]);
    }
    let points = |valid: &str| {
        let chosen = rows.iter().enumerate().filter(|(_, r)| r[2] == valid);
        chosen
            .map(|(k, r)| (k as f64 + 1.0, r[3].parse().unwrap_or(f64::NAN)))
            .collect::<Vec<_>>()
    };
    let chart = LineChart::new(
        "Two techniques and their weights, attached or not",
        "row of the table",
        "mean of the estimate",
    )
    // Space for the legend.
    .y_range(-0.41, -0.31)
    .points("valid", points("true"))
    .points("biased", points("false"))
    .dashed("true derivative", [(1.0, truth), (9.0, truth)]);
    fig.chart("combinations", &chart);
    let header = [
        "first",
        "second",
        "valid",
        "quadrature",
        "mean",
        "mean_error",
        "z",
        "std",
    ];
    fig.csv_text("combinations", &header, rows);
    Ok(())
}
