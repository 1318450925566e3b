//! [Zeltner 2021, figure 4.15]: the derivative of distributions of normals with respect to roughness.

use std::f64::consts::{E, FRAC_PI_2};

use ad_core::{Const, Dual, Vec3};
use render::bsdf::DiffLobe;
use render::bsdf::microfacet::Ndf;

use super::differential_normals::{ALPHA, KINDS, angle, direction, part, surface};
use super::integration_1d::{integrate, positions};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// Density of the angle, and its derivative with respect to roughness [Eqs. 4.44 to 4.46, corrected].
fn derivative(kind: Ndf, theta: f64) -> Dual<f64, 1> {
    let m = direction(theta);
    let d = surface(kind, Dual::var(ALPHA, 0)).d(Vec3::lift(m));
    d * Const(angle(theta, m.z))
}

/// `zeltner-4-15`.
pub fn figure(fig: &mut Figure) -> Result {
    fig.note("alpha", ALPHA);
    let root = ALPHA.atan();
    let grid: Vec<f64> = positions([0.0, FRAC_PI_2 - 1e-9], 4000).skip(1).collect();
    for (name, kind) in KINDS {
        let mass = match kind {
            Ndf::Ggx => 1.0 / (2.0 * ALPHA),
            Ndf::Beckmann => 2.0 / (E * ALPHA),
        };
        let slope = |theta: f64| derivative(kind, theta).eps[0];
        let changes: Vec<f64> = grid
            .windows(2)
            .filter(|w| (slope(w[0]) < 0.0) != (slope(w[1]) < 0.0))
            .map(|w| 0.5 * (w[0] + w[1]))
            .collect();
        let sides = [1e-6, -1e-6].map(|h| slope(root + h));
        fig.check(
            format!("{name}: a single crossing of zero, at atan 0.5 = 0.4636 rad"),
            changes.len() == 1
                && (changes[0] - root).abs() < 1e-3
                && sides[0] > 0.0
                && sides[1] < 0.0,
            format!(
                "{changes:.4?}; {:.1e} and {:.1e} within 1e-6 of it",
                sides[1], sides[0]
            ),
        );
        let ranges = [[root, FRAC_PI_2 - 1e-9], [0.0, root]];
        let areas = ranges.map(|range| integrate(range, 20_000, slope));
        fig.check(
            format!("{name}: both lobes have the area {mass:.5}"),
            (areas[0] - mass).abs() < 1e-7 && (areas[1] + mass).abs() < 1e-7,
            format!("{:.7} and {:.7}", areas[0], areas[1]),
        );
        for (sign, range) in DiffLobe::BOTH.into_iter().zip(ranges) {
            let total = integrate(range, 20_000, |theta| part(kind, theta, sign));
            fig.check(
                format!("{name}: p {sign:?} integrates to 1"),
                (total - 1.0).abs() < 1e-7,
                format!("{total:.9}"),
            );
        }
        let gap = grid.iter().map(|&theta| {
            let [plus, minus] = DiffLobe::BOTH.map(|sign| part(kind, theta, sign));
            (slope(theta) - mass * (plus - minus)).abs()
        });
        let gap = gap.fold(0.0, f64::max);
        fig.check(
            format!("{name}: the two densities, times the area, are the derivative"),
            gap < 1e-11,
            format!("largest gap {gap:.1e} at {} angles", grid.len()),
        );
        let rows: Vec<_> = positions([0.0, FRAC_PI_2], 400)
            .map(|theta| {
                let d = derivative(kind, theta);
                let [plus, minus] = DiffLobe::BOTH.map(|sign| part(kind, theta, sign));
                [theta, d.re, d.eps[0], plus, minus]
            })
            .collect();
        let column = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
        let title = format!("{name}, alpha = 0.5, and its derivative");
        let label = "angle of the normal, radians";
        let chart = LineChart::new(&title, label, "density of the angle")
            .x_range(0.0, FRAC_PI_2)
            .y_range(-6.0, 6.0)
            .line("d/d alpha (D cos)", column(2))
            .line("p-", column(4))
            .line("p+", column(3))
            .dashed("D cos", column(1))
            .points("atan alpha", [(root, 0.0)]);
        let file = name.to_lowercase();
        fig.chart(&file, &chart);
        let header = ["theta", "density", "derivative", "plus", "minus"];
        fig.csv(&file, &header, rows);
    }
    Ok(())
}
