//! [Stam 2020, appendix B]: sampling normals from the Blinn-Phong density, as printed and as corrected.

use std::f64::consts::TAU;

use render::bsdf::{BlinnPhongLobe, BlinnPhongSampling};
use render::math::Rgb;
use render::sampler::{Independent, Sampler};
use render::statistics::{Estimate, sidak, z_limit};

use super::printed;
use crate::statistics::ChiSquare;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// Cells of the chi-square test: in `cos^(e+2)` (uniform if the density is right) and in azimuth.
const CELLS: [usize; 2] = [32, 16];

/// Chi-square test, mean cosine and density of the cosine of `n` normals.
fn test(
    n: u64,
    exponent: f64,
    mut normal: impl FnMut(u64) -> [f64; 3],
) -> (ChiSquare, f64, Vec<f64>) {
    let mut counts = vec![0.0; CELLS[0] * CELLS[1]];
    let mut mean = 0.0;
    let mut cosines = vec![0.0; 64];
    for i in 0..n {
        let [x, y, z] = normal(i);
        let u = z.clamp(0.0, 1.0).powf(exponent + 2.0);
        let v = (y.atan2(x) / TAU).rem_euclid(1.0);
        let cell = |x: f64, m: usize| ((x * m as f64) as usize).min(m - 1);
        counts[cell(u, CELLS[0]) * CELLS[1] + cell(v, CELLS[1])] += 1.0;
        cosines[cell(z.clamp(0.0, 1.0), 64)] += 64.0 / n as f64;
        mean += z / n as f64;
    }
    let expected = n as f64 / counts.len() as f64;
    let bins: Vec<_> = counts.iter().map(|c| (*c, expected)).collect();
    (ChiSquare::of(&bins), mean, cosines)
}

/// `stam-alg-b`.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(200_000, 4_000_000);
    let seed = 1;
    fig.note("samples", n);
    fig.note("seed", seed);
    let mut rows = Vec::new();
    let mut chart = LineChart::new("Sampled normals", "cos theta_m", "density of cos theta_m");
    let exponents = [0.0, 5.0, 50.0, 500.0];
    let least = sidak(exponents.len(), 1e-3);
    let limit = z_limit(exponents.len(), n, 1e-3);
    for exponent in exponents {
        let grey = |v| Rgb::splat(v);
        let sampling = BlinnPhongSampling::Importance;
        let lobe = BlinnPhongLobe::<f32>::new(grey(0.5), grey(0.5), exponent as f32, sampling);
        let u = |i: u64| Independent::new(seed, exponent as u64, i).next_2d::<f32>();
        let (found, mean, cosines) = test(n, exponent, |i| {
            lobe.sample_normal(u(i)).to_array().map(f64::from)
        });
        let (wrong, mean_printed, _) = test(n, exponent, |i| {
            let u = u(i).map(f64::from);
            // arccos((1 - u)^(1 / (e + 2)))
            let theta = (1.0 - u[0]).powf(1.0 / (exponent + 2.0)).min(1.0).acos();
            printed::vector(theta, TAU * u[1])
        });
        let expected = (exponent + 2.0) / (exponent + 3.0);
        let sd = ((exponent + 2.0) / (exponent + 4.0) - expected * expected).sqrt();
        let se = sd / (n as f64).sqrt();
        let z = Estimate { mean, se }.z(&Estimate::exact(expected)).abs();
        fig.check(
            format!("(a) exponent {exponent}: normals pass the chi-square test"),
            found.p_value > least,
            format!(
                "p-value {:.3}, at least {least:.5}, deviate {:.2} ({} cells, {n} normals)",
                found.p_value,
                found.deviate,
                CELLS[0] * CELLS[1]
            ),
        );
        fig.check(
            format!("(a) exponent {exponent}: mean cosine (e+2)/(e+3)"),
            z < limit,
            format!("{mean:.5}, expected {expected:.5}, {z:.1} standard errors, limit {limit:.2}"),
        );
        // For exponent 0, cos and sin of the angle have the same distribution: invisible.
        let visible = exponent > 0.0;
        fig.check(
            format!(
                "exponent {exponent}: the printed vector {} (errata S-B2)",
                if visible { "fails" } else { "happens to pass" }
            ),
            (wrong.deviate > 100.0) == visible,
            format!(
                "mean cosine {mean_printed:.3} instead of {expected:.3}, deviate {:.1}",
                wrong.deviate
            ),
        );
        rows.push([
            exponent,
            expected,
            mean,
            mean_printed,
            found.deviate,
            wrong.deviate,
        ]);
        let bins = cosines
            .iter()
            .enumerate()
            .map(|(i, p)| ((i as f64 + 0.5) / 64.0, *p));
        let density = |c: f64| (exponent + 2.0) * c.powf(exponent + 1.0);
        let curve = (0..=400)
            .map(|i| f64::from(i) / 400.0)
            .map(|c| (c, density(c)));
        if exponent < 100.0 {
            chart = chart
                .line(&format!("e = {exponent}: (e+2) cos^(e+1)"), curve)
                .points(&format!("e = {exponent}: sampled"), bins);
        }
    }
    let header = [
        "exponent",
        "mean_expected",
        "mean",
        "mean_printed",
        "deviate",
        "deviate_printed",
    ];
    fig.csv("normals", &header, rows);
    fig.chart("normals", &chart.y_range(0.0, 12.0));
    Ok(())
}
