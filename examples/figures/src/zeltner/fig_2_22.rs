//! [Zeltner 2021, figure 2.22]: samples of a density by inverting its CDF.

use render::sampler::{Independent, Sampler};

use super::integration_1d::{Density, Histogram, positions};
use super::two_bumps::{RANGE, target};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// `zeltner-2-22`.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(100_000, 4_000_000), 1);
    fig.note("samples", n);
    fig.note("seed", seed);
    let p = target();
    let number = |i: u64| Independent::new(seed, 0, i).next_1d::<f64>();
    let samples: Vec<f64> = (0..n).map(|i| p.sample(number(i))).collect();
    let histogram = Histogram::of(&samples, &p);
    let test = histogram.test;
    fig.check(
        "the histogram of inverse-transform samples matches p (chi-square)",
        test.p_value > 1e-3,
        format!(
            "p-value {:.3}, at least 0.001, deviate {:.2} ({} cells, {n} samples)",
            test.p_value,
            test.deviate,
            Histogram::CELLS
        ),
    );
    let unmoved: Vec<f64> = (0..n).map(number).collect();
    let wrong = Histogram::of(&unmoved, &p).test.deviate;
    fig.check(
        "the test notices the random numbers themselves, not passed through the inverse",
        wrong > 10.0,
        format!("deviate {wrong:.0}, at least 10"),
    );
    let gap = positions(RANGE, 10_000).map(|u| {
        let x: f64 = p.sample(u);
        (p.cdf(x) - u).abs()
    });
    let gap = gap.fold(0.0, f64::max);
    fig.check(
        "P(P^-1(u)) = u",
        gap < 1e-12,
        format!("largest gap {gap:.1e} at 10001 numbers"),
    );

    let grid: Vec<f64> = positions(RANGE, 400).collect();
    let drawn = [0.15, 0.45, 0.8].map(|u| (u, p.sample(u)));
    let mut pdf = LineChart::new("Inverse transform: density and histogram", "x", "p(x)")
        .x_range(0.0, 1.0)
        .y_range(0.0, 2.6)
        .line("p", grid.iter().map(|&x| (x, p.pdf(x))))
        .points("histogram of the samples", histogram.bars.clone());
    let mut cdf = LineChart::new("Inverse transform: from u to x", "x", "P(x), u")
        .x_range(0.0, 1.0)
        .y_range(0.0, 1.45)
        .line("CDF P", grid.iter().map(|&x| (x, p.cdf(x))))
        .line("", []);
    for (i, (u, x)) in drawn.into_iter().enumerate() {
        let name = format!("x{}", i + 1);
        pdf = pdf.dashed(&name, [(x, 0.0), (x, p.pdf(x))]);
        cdf = cdf.dashed(
            &format!("u{} = {u} to x = {x:.3}", i + 1),
            [(0.0, u), (x, u), (x, 0.0)],
        );
    }
    fig.chart("density", &pdf);
    fig.chart("cdf", &cdf);
    fig.csv(
        "curves",
        &["x", "pdf", "cdf"],
        grid.iter().map(|&x| [x, p.pdf(x), p.cdf(x)]),
    );
    let bars: Vec<_> = histogram
        .bars
        .iter()
        .map(|&(x, d)| [x, d, p.pdf(x)])
        .collect();
    fig.csv("histogram", &["x", "measured", "pdf"], bars);
    Ok(())
}
