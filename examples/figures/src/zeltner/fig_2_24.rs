//! [Zeltner 2021, figure 2.24]: weights of multiple importance sampling.

use render::sampler::Sampler;
use render::statistics::{Estimate, z_limit};

use super::integration_1d::{Density, Normal, integrate, positions};
use crate::statistics::Moments;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const RANGE: [f64; 2] = [0.0, 1.0];

/// The integrand: three bumps.
fn f(x: f64) -> f64 {
    let bump = |at: f64, width: f64| (-((x - at) / width).powi(2)).exp();
    0.8 * bump(0.18, 0.12) + bump(0.5, 0.09) + 1.2 * bump(0.82, 0.14)
}

/// One density per bump.
fn densities() -> [Normal<f64>; 3] {
    [(0.18, 0.17), (0.5, 0.15), (0.82, 0.18)].map(|(mean, sd)| Normal {
        mean,
        sd,
        range: RANGE,
    })
}

/// Weights of the power heuristic at `x`; of the balance heuristic for exponent 1.
fn weights(p: &[Normal<f64>; 3], x: f64, exponent: i32) -> [f64; 3] {
    let powers = p.map(|p| p.pdf(x).powi(exponent));
    let sum: f64 = powers.iter().sum();
    powers.map(|v| v / sum)
}

/// The densities and their weights.
fn curves(fig: &mut Figure, p: &[Normal<f64>; 3]) {
    let rows: Vec<[f64; 11]> = positions(RANGE, 400)
        .map(|x| {
            let (d, b, w) = (p.map(|p| p.pdf(x)), weights(p, x, 1), weights(p, x, 2));
            [
                x,
                f(x),
                d[0],
                d[1],
                d[2],
                b[0],
                b[1],
                b[2],
                w[0],
                w[1],
                w[2],
            ]
        })
        .collect();
    let curve = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let chart = LineChart::new("Three densities for one integrand", "x", "f, p")
        .x_range(0.0, 1.0)
        .y_range(0.0, 3.8)
        .line("p1", curve(2))
        .line("p2", curve(3))
        .line("p3", curve(4))
        .dashed("f", curve(1));
    fig.chart("densities", &chart);
    for (file, title, first) in [
        ("balance", "Weights of the balance heuristic", 5),
        ("power", "Weights of the power heuristic, beta = 2", 8),
    ] {
        let chart = LineChart::new(title, "x", "weight")
            .x_range(0.0, 1.0)
            .y_range(0.0, 1.3)
            .line("w1", curve(first))
            .line("w2", curve(first + 1))
            .line("w3", curve(first + 2));
        fig.chart(file, &chart);
    }
    let header = [
        "x", "f", "p1", "p2", "p3", "balance1", "balance2", "balance3", "power1", "power2",
        "power3",
    ];
    fig.csv("curves", &header, rows);
}

/// `zeltner-2-24`.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(50_000, 500_000), 3);
    fig.note("samples_per_density", n);
    fig.note("seed", seed);
    let p = densities();
    let truth = integrate(RANGE, 4000, f);
    fig.note("integral", truth);
    let heuristics = [("balance", 1), ("power, beta 2", 2)];
    let grid: Vec<f64> = positions(RANGE, 4000).collect();
    for (name, beta) in heuristics {
        let gap = grid
            .iter()
            .map(|&x| (weights(&p, x, beta).iter().sum::<f64>() - 1.0).abs());
        let gap = gap.fold(0.0, f64::max);
        fig.check(
            format!("{name}: weights sum to 1 everywhere"),
            gap < 1e-14,
            format!("largest gap {gap:.1e} at {} positions", grid.len()),
        );
    }
    // 0 where all weights are 0 or 1, 2/3 where they are equal.
    let mixing = |beta: i32, x: f64| {
        weights(&p, x, beta)
            .iter()
            .map(|w| w * (1.0 - w))
            .sum::<f64>()
    };
    let closer = grid
        .iter()
        .filter(|&&x| mixing(2, x) <= mixing(1, x) + 1e-15)
        .count();
    let average = [1, 2].map(|beta| integrate(RANGE, 4000, |x| mixing(beta, x)));
    fig.check(
        "power weights are closer to 0 and 1 than balance weights",
        closer == grid.len() && average[1] < average[0],
        format!(
            "sum of w (1 - w) smaller at {closer} of {} positions, on average {:.4} against {:.4}",
            grid.len(),
            average[1],
            average[0]
        ),
    );
    // Variance of one sample of each technique alone; the sum of three has three evaluations.
    let mut single = Vec::new();
    for (j, p) in p.iter().enumerate() {
        let m = Moments::of(n, seed, |s| {
            s.seek(j as u32);
            let x = p.sample(s.next_1d());
            f(x) / p.pdf(x)
        });
        let exact = integrate(RANGE, 4000, |x| f(x).powi(2) / p.pdf(x)) - truth * truth;
        single.push((m, exact));
    }
    let exact_average = single.iter().map(|(_, v)| v).sum::<f64>() / 3.0;
    // Mean and variance of each.
    let limit = z_limit(2 * heuristics.len(), n, 1e-3);
    let mut combined = Vec::new();
    for (name, beta) in heuristics {
        let term = |j: usize, x: f64| weights(&p, x, beta)[j] * f(x) / p[j].pdf(x);
        let m = Moments::of(n, seed + 1, |s| {
            (0..3).map(|j| term(j, p[j].sample(s.next_1d()))).sum()
        });
        fig.check(
            format!("{name}: the estimate is unbiased"),
            m.z(truth).abs() < limit,
            format!(
                "{:.6} ± {:.6}, quadrature {truth:.6}: deviate {:.2}, limit {limit:.2} ({n} samples of each density)",
                m.mean,
                m.of_mean().se,
                m.z(truth)
            ),
        );
        let exact: f64 = (0..3)
            .map(|j| {
                let mean = integrate(RANGE, 4000, |x| p[j].pdf(x) * term(j, x));
                integrate(RANGE, 4000, |x| p[j].pdf(x) * term(j, x).powi(2)) - mean * mean
            })
            .sum();
        let z = m.of_variance().z(&Estimate::exact(exact));
        let per_evaluation = 3.0 * m.variance();
        let error = 3.0 * m.of_variance().se;
        fig.check(
            format!("{name}: variance below the average of the three, at equal evaluations"),
            per_evaluation + 5.0 * error < exact_average && z.abs() < limit,
            format!(
                "{per_evaluation:.4} ± {error:.4} (quadrature {:.4}) against {exact_average:.4} = average of {:.3}, {:.3}, {:.3}",
                3.0 * exact, single[0].1, single[1].1, single[2].1
            ),
        );
        combined.push((name, m, exact));
    }
    curves(fig, &p);
    let line = |name: String, m: &Moments, evaluations: f64, exact: f64| {
        let numbers = [
            m.mean,
            m.of_mean().se,
            evaluations * m.variance(),
            evaluations * exact,
        ];
        let [a, b, c, d] = numbers.map(|v| v.to_string());
        [name, a, b, c, d]
    };
    let alone = single.iter().enumerate();
    let alone = alone.map(|(j, (m, exact))| line(format!("p{}", j + 1), m, 1.0, *exact));
    let together = combined
        .iter()
        .map(|(name, m, exact)| line(name.to_string(), m, 3.0, *exact));
    let rows: Vec<_> = alone.chain(together).collect();
    let header = [
        "estimator",
        "mean",
        "mean_error",
        "variance_per_evaluation",
        "by_quadrature",
    ];
    fig.csv_text("moments", &header, rows);
    Ok(())
}
