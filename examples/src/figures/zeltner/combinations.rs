//! [Zeltner 2021, footnote 4 and figure 4.13]: what may be attached on its own, and what may not.

use render::sampler::Sampler;

use super::mc1::Moments;
use super::taxonomy::{
    Falling, Part, Power, Ramp, Rising, Sampling, Weight, combined, expectation, is_unbiased,
    partly_attached,
};
use crate::chart::LineChart;
use crate::figure::{Figure, Result};

/// Distance in standard errors beyond which a mean is wrong; one below 4 is not suspicious.
const DETECTED: f64 = 8.0;

/// `zeltner-4-2-1-foot4`.
pub fn factors(fig: &mut Figure) -> Result {
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
        let label = match chosen.is_empty() {
            true => "nothing".to_owned(),
            false => chosen.join(" and "),
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
            z.abs() < 4.0
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
                m.error(),
                z
            ),
        );
        let numbers = [mean, m.mean, m.error(), z].map(|v| v.to_string());
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

/// A short name: `d.` and `a.` for the sampling, and what becomes of its weight.
fn name(p: Part) -> &'static str {
    match (p.sampling, p.weight) {
        (Sampling::Detached, Weight::Detached) => "d./detached",
        (Sampling::Detached, Weight::Frozen) => "d./frozen",
        (Sampling::Detached, Weight::Attached) => "d./attached",
        (Sampling::Attached, Weight::Detached) => "a./detached",
        (Sampling::Attached, Weight::Frozen) => "a./frozen",
        (Sampling::Attached, Weight::Attached) => "a./attached",
    }
}

/// `zeltner-4-13`.
pub fn mixed(fig: &mut Figure) -> Result {
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
    let mut rows = Vec::new();
    for (label, parts, expected) in table {
        let parts = parts.map(|(sampling, weight)| Part { sampling, weight });
        let one = |u: [f64; 2]| combined(&Ramp, (&Rising, &Falling), parts, 1, 1.0, u).eps[0];
        let mean = expectation(|u| ad_core::Dual::new(one([u, u]), [0.0])).re;
        let m = Moments::of(n, seed, |s| one(s.next_2d()));
        let z = m.z(truth);
        let valid = is_unbiased(parts);
        let found = if valid {
            z.abs() < 4.0
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
                "{mean:.6} by quadrature; {:.5} ± {:.5}, {z:.1} standard errors from {truth:.6}; std {:.3}",
                m.mean,
                m.error(),
                m.variance().sqrt()
            ),
        );
        let numbers = [mean, m.mean, m.error(), z, m.variance().sqrt()];
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
