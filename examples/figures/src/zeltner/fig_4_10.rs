//! [Zeltner 2021, figure 4.10]: detached sampling of an integral over one dimension.

use std::f64::consts::PI;

use ad_core::Real;
use render::sampler::Sampler;

use super::exact_moments::{agrees, describe, exact};
use super::integration_1d::positions;
use super::taxonomy::{D, Integrand, Sampling, Wrapped, estimate};
use crate::statistics::Moments;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// `zeltner-4-10`.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(20_000, 400_000), 410);
    fig.note("samples", n);
    fig.note("seed", seed);
    let mut peaks = Vec::new();
    let deviations = [0.2, 1.0];
    for sd in deviations {
        let one = |u| estimate(&Wrapped, &Wrapped, Sampling::Detached, sd, u);
        let primal = Moments::of(n, seed, |s| one(s.next_1d()).re);
        let derivative = Moments::of(n, seed, |s| one(s.next_1d()).eps[0]);
        fig.check(
            format!("sigma {sd}: p = f, and the primal estimate does not vary"),
            primal.variance() < 1e-24 && (primal.mean - 1.0).abs() < 1e-12,
            format!("{:.6}, variance {:.0e}", primal.mean, primal.variance()),
        );
        let expected = exact(|u| one(u).eps[0]);
        fig.check(
            format!("sigma {sd}: the detached estimate of the derivative, 0, is unbiased"),
            expected.0.abs() < 1e-9 && agrees(&derivative, expected, deviations.len()),
            describe(&derivative, expected),
        );
        // Wrapping only matters where the tails meet.
        let before = 2f64.sqrt() / sd;
        fig.check(
            format!("sigma {sd}: its std is sqrt 2 / sigma = {before:.3} before wrapping"),
            (expected.1 / before - 1.0).abs() < if sd < 0.5 { 1e-6 } else { 0.1 },
            format!("{:.4} with wrapping", expected.1),
        );
        let weight = |x: f64| {
            let moving = Wrapped.eval(D::lift(x), D::var(sd, 0));
            moving.eps[0] / moving.re
        };
        let gap = positions([-2.0 * sd, 2.0 * sd], 200)
            .map(|x| (weight(x) - (x * x / sd.powi(3) - 1.0 / sd)).abs() * sd);
        let gap = gap.fold(0.0, f64::max);
        if sd < 0.5 {
            fig.check(
                "sigma 0.2: the weight is x^2 / sigma^3 - 1 / sigma, up to 2 sigma",
                gap < 1e-9,
                format!("largest relative gap {gap:.1e}"),
            );
        }
        peaks.push(expected.1);

        let rows: Vec<_> = positions([-PI, PI], 600)
            .map(|x| {
                let f = Wrapped.eval(D::lift(x), D::var(sd, 0));
                [x, f.re, f.eps[0]]
            })
            .collect();
        let name = format!("sigma-{sd}");
        let title = format!("Wrapped normal distribution, sigma = {sd}");
        let column = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
        let chart = LineChart::new(&title, "x", "f, df / d sigma")
            .line("f = p", column(1))
            .line("df / d sigma", column(2));
        fig.chart(&format!("{name}-function"), &chart);
        fig.csv(&format!("{name}-function"), &["x", "f", "derivative"], rows);
        let weights: Vec<_> = positions([0.001, 0.999], 600)
            .map(|u| [u, one(u).re, one(u).eps[0]])
            .collect();
        let column = |k: usize| weights.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
        let title = format!("Sample weights over random numbers, sigma = {sd}");
        // The same scale for both.
        let chart = LineChart::new(&title, "u", "weight")
            .y_range(-8.0, 30.0)
            .line("f / p", column(1))
            .line("(df / d sigma) / p, detached", column(2));
        fig.chart(&format!("{name}-weights"), &chart);
        let header = ["u", "primal", "detached"];
        fig.csv(&format!("{name}-weights"), &header, weights);
    }
    fig.check(
        "weights are smaller for the larger sigma",
        peaks[1] < 0.5 * peaks[0],
        format!("std {:.3} against {:.3}", peaks[1], peaks[0]),
    );
    Ok(())
}
