//! [Zeltner 2021, figure 2.21]: one integrand, a bad, a uniform and a good sampling density.

use render::statistics::{Estimate, z_limit};

use super::integration_1d::{Density, Piecewise, Uniform, integrate, positions};
use crate::statistics::Moments;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// The integrand: a bump on a floor.
fn f(x: f64) -> f64 {
    0.2 + (-((x - 0.65) / 0.15).powi(2)).exp()
}

/// `zeltner-2-21`.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(100_000, 4_000_000), 1);
    fig.note("samples", n);
    fig.note("seed", seed);
    let range = [0.0, 1.0];
    let good = Piecewise::interpolating(range, 8, f);
    let bad = Piecewise::interpolating(range, 8, |x| f(1.0 - x));
    let uniform = Uniform { range };
    let densities: [(&str, &dyn Density<f64>); 3] =
        [("mismatched", &bad), ("uniform", &uniform), ("good", &good)];
    let truth = integrate(range, 4000, f);
    fig.note("integral", truth);
    // Mean and variance of each.
    let limit = z_limit(2 * densities.len(), n, 1e-3);
    let mut found = Vec::new();
    for (i, (name, p)) in densities.iter().enumerate() {
        let weight = |x: f64| f(x) / p.pdf(x);
        let mut largest: f64 = 0.0;
        let m = Moments::of(n, seed + i as u64, |s| {
            use render::sampler::Sampler;
            let w = weight(p.sample(s.next_1d()));
            largest = largest.max(w);
            w
        });
        fig.check(
            format!("{name} density: the same mean"),
            m.z(truth).abs() < limit,
            format!(
                "{:.6} ± {:.6}, quadrature {truth:.6}: deviate {:.2}, limit {limit:.2} ({n} samples)",
                m.mean,
                m.of_mean().se,
                m.z(truth)
            ),
        );
        let exact = integrate(range, 4000, |x| f(x).powi(2) / p.pdf(x)) - truth * truth;
        let z = m.of_variance().z(&Estimate::exact(exact));
        fig.check(
            format!(
                "{name} density: the variance is the integral of f^2 / p less the mean's square"
            ),
            z.abs() < limit,
            format!(
                "{:.3e} ± {:.0e}, quadrature {exact:.3e}: deviate {z:.2}, limit {limit:.2}",
                m.variance(),
                m.of_variance().se
            ),
        );
        let peak = positions(range, 4000).map(weight).fold(0.0, f64::max);
        found.push((m, peak, largest));
    }
    let gaps = [0, 1].map(|k| {
        let (a, b) = (found[k].0, found[k + 1].0);
        a.of_variance().z(&b.of_variance())
    });
    fig.check(
        "variance: mismatched > uniform > good",
        gaps.iter().all(|z| *z > 5.0),
        format!(
            "{:.4} > {:.4} > {:.4}, apart by {:.0} and {:.0} standard errors, at least 5",
            found[0].0.variance(),
            found[1].0.variance(),
            found[2].0.variance(),
            gaps[0],
            gaps[1]
        ),
    );
    fig.check(
        "largest f / p: mismatched > uniform > good",
        found.windows(2).all(|w| w[0].1 > w[1].1 && w[0].2 > w[1].2),
        format!(
            "{:.3} > {:.3} > {:.3}; among the samples {:.3}, {:.3}, {:.3}",
            found[0].1, found[1].1, found[2].1, found[0].2, found[1].2, found[2].2
        ),
    );
    let rows: Vec<[f64; 8]> = positions(range, 400)
        .map(|x| {
            let p = densities.map(|(_, p)| p.pdf(x));
            let w = p.map(|p| f(x) / p);
            [x, f(x), p[0], p[1], p[2], w[0], w[1], w[2]]
        })
        .collect();
    let curve = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let chart = LineChart::new("Integrand and three sampling densities", "x", "f, p")
        .x_range(0.0, 1.0)
        .y_range(0.0, 3.6)
        .line("mismatched p", curve(2))
        .line("uniform p", curve(3))
        .line("good p", curve(4))
        .dashed("f", curve(1));
    fig.chart("densities", &chart);
    let mut chart = LineChart::new("Sample weights; dashed: the largest", "x", "f / p")
        .x_range(0.0, 1.0)
        .log_y()
        .y_range(0.05, 20.0);
    for (k, (name, _)) in densities.iter().enumerate() {
        chart = chart.line(
            &format!("{name}, variance {:.4}", found[k].0.variance()),
            curve(5 + k),
        );
    }
    // The colours come in a cycle of seven.
    for _ in 0..4 {
        chart = chart.line("", []);
    }
    for (_, peak, _) in &found {
        chart = chart.dashed("", [(0.0, *peak), (1.0, *peak)]);
    }
    fig.chart("weights", &chart);
    let header = [
        "x",
        "f",
        "p_mismatched",
        "p_uniform",
        "p_good",
        "w_mismatched",
        "w_uniform",
        "w_good",
    ];
    fig.csv("curves", &header, rows);
    let rows = found
        .iter()
        .zip(&densities)
        .map(|((m, peak, largest), (name, _))| {
            let numbers = [
                m.mean,
                m.of_mean().se,
                m.variance(),
                m.of_variance().se,
                *peak,
                *largest,
            ];
            let [a, b, c, d, e, f] = numbers.map(|v| v.to_string());
            [name.to_string(), a, b, c, d, e, f]
        });
    let rows: Vec<_> = rows.collect();
    let header = [
        "density",
        "mean",
        "mean_error",
        "variance",
        "variance_error",
        "largest",
        "largest_sampled",
    ];
    fig.csv_text("moments", &header, rows);
    Ok(())
}
