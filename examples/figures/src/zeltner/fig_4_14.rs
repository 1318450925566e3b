//! [Zeltner 2021, figure 4.14]: differential sampling of an integral over one dimension.

use std::f64::consts::{PI, TAU};

use ad_core::Real;
use render::sampler::Sampler;
use render::statistics::{sidak, z_limit};

use super::exact_moments::exact;
use super::integration_1d::{Density, Histogram, integrate, positions};
use super::taxonomy::{
    D, Integrand, Lobe, Sampling, Technique, Wrapped, WrappedNormal, differential, estimate,
};
use crate::statistics::Moments;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// `zeltner-4-14`.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(20_000, 400_000), 414);
    let sd = 0.5;
    fig.note("samples", n);
    fig.note("seed", seed);
    fig.note("sigma", sd);
    let lobes = Lobe::pair(sd);
    let names = ["p+", "p-"];
    let slope = |x: f64| Wrapped.eval(D::lift(x), D::var(sd, 0)).eps[0];
    for (lobe, name) in lobes.iter().zip(names) {
        let total = integrate(lobe.range(), 4000, |x| lobe.pdf(x));
        fig.check(
            format!("{name} integrates to 1"),
            (total - 1.0).abs() < 1e-9,
            format!("{total:.12}"),
        );
        let weights: Vec<f64> = positions([0.001, 0.999], 1000)
            .map(|u| {
                let x = lobe.sample(u);
                slope(x) / lobe.pdf(x)
            })
            .collect();
        let spread = weights.iter().map(|w| (w / lobe.mass - 1.0).abs());
        let spread = spread.fold(0.0, f64::max);
        fig.check(
            format!("{name}: weights of constant magnitude"),
            spread < 1e-9,
            format!("{:.6} everywhere, relative spread {spread:.0e}", lobe.mass),
        );
        let samples: Vec<f64> = (0..n)
            .map(|i| lobe.sample(render::sampler::Independent::new(seed, 0, i).next_1d()))
            .collect();
        let histogram = Histogram::of(&samples, lobe);
        let (test, least) = (histogram.test, sidak(lobes.len(), 1e-3));
        fig.check(
            format!("{name}: samples follow the density"),
            test.p_value > least,
            format!(
                "p-value {:.3}, at least {least:.4}, chi-square deviate {:.2} ({n} samples)",
                test.p_value, test.deviate
            ),
        );
    }
    let pair = Moments::of(n, seed, |s| differential(&Wrapped, &lobes, sd, s.next_1d()));
    fig.check(
        "one sample from each lobe: std 0, and the total gradient is 0",
        pair.variance().sqrt() < 1e-9 && pair.mean.abs() < 1e-9,
        format!("{:.1e} ± {:.1e}", pair.mean, pair.variance().sqrt()),
    );
    // The pair has two evaluations, so one lobe at random is the estimator of the same cost as one
    // sample of p; both are far behind.
    let random = Moments::of(n, seed, |s| {
        let lobe = &lobes[usize::from(s.next_1d::<f64>() < 0.5)];
        let x = lobe.sample(s.next_1d());
        2.0 * slope(x) / lobe.pdf(x)
    });
    let plain = exact(|u| estimate(&Wrapped, &Wrapped, Sampling::Detached, sd, u).eps[0]);
    fig.check(
        "one lobe chosen at random helps little: std twice the mass, against that of p = f",
        (random.variance().sqrt() / (2.0 * lobes[0].mass) - 1.0).abs() < 1e-3
            && random.variance().sqrt() > 0.5 * plain.1,
        format!("{:.4} against {:.4}", random.variance().sqrt(), plain.1),
    );
    let narrow = Lobe::pair(0.2);
    let scaled = narrow.map(|l| l.mass.abs() * 0.2);
    fig.check(
        "mass of each lobe 0.483941 / sigma before wrapping (sigma 0.2)",
        scaled.iter().all(|m| (m - 0.483941).abs() < 1e-6),
        format!("{:.6} and {:.6} / sigma", scaled[0], scaled[1]),
    );
    // Light that varies: the pair no longer cancels, but stays ahead.
    let lit = |x: f64| slope(x) * (1.0 + 0.9 * x.cos());
    let truth = integrate([-PI, PI], 4000, lit);
    let weight = |lobe: &Lobe, u: f64| {
        let x = lobe.sample(u);
        lit(x) / lobe.pdf(x)
    };
    let paired = Moments::of(n, seed + 1, |s| {
        let u = s.next_1d();
        lobes.iter().map(|lobe| weight(lobe, u)).sum()
    });
    let plain = exact(|u| {
        let x = Wrapped.sample(u, sd);
        lit(x) / WrappedNormal { sd }.pdf(x)
    });
    let std = paired.variance().sqrt();
    fig.check(
        "under light 1 + 0.9 cos x: the pair is unbiased and varies less than a fifth of p = f",
        paired.z(truth).abs() < z_limit(1, n, 1e-3) && std < 0.2 * plain.1,
        format!(
            "{:.5} ± {:.5}, true {truth:.5}; std {std:.3} against {:.3}",
            paired.mean,
            paired.of_mean().se,
            plain.1
        ),
    );

    // The positive lobe ends beyond pi: shown where it comes back.
    let rows: Vec<_> = positions([-PI, PI], 600)
        .map(|x| {
            let at = |l: &Lobe| {
                let [a, b] = l.range();
                let inside = [x, x + TAU].into_iter().find(|x| (a..=b).contains(x));
                inside.map_or(0.0, |x| l.pdf(x))
            };
            let p = WrappedNormal { sd }.pdf(x);
            [x, p, slope(x), at(&lobes[0]), at(&lobes[1])]
        })
        .collect();
    let column = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let title = "Densities for the derivative of a wrapped normal distribution";
    let chart = LineChart::new(title, "x", "f, df / d sigma, p")
        .line("df / d sigma", column(2))
        .line("p-", column(4))
        .line("p+", column(3))
        .dashed("f", column(1));
    fig.chart("densities", &chart);
    fig.csv(
        "densities",
        &["x", "f", "derivative", "plus", "minus"],
        rows,
    );
    let weights: Vec<_> = positions([0.001, 0.999], 600)
        .map(|u| {
            let one = estimate(&Wrapped, &Wrapped, Sampling::Detached, sd, u).eps[0];
            [u, one, lobes[0].mass, lobes[1].mass]
        })
        .collect();
    let column = |k: usize| weights.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let chart = LineChart::new("Sample weights of the derivative", "u", "weight")
        .line("p = f", column(1))
        .line("p-", column(3))
        .line("p+", column(2));
    fig.chart("weights", &chart);
    fig.csv("weights", &["u", "primal", "plus", "minus"], weights);
    Ok(())
}
