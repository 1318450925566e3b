//! [Zeltner 2021, figure 4.16]: samples of distributions of normals and of the two parts of their derivatives.

use std::f64::consts::{FRAC_PI_2, TAU};

use ad_core::Vec3;
use render::bsdf::DiffLobe;
use render::sampler::{Independent, Sampler};
use render::statistics::sidak;

use super::differential_normals::{ALPHA, KINDS, angle, direction, part, surface};
use super::integration_1d::integrate;
use crate::statistics::ChiSquare;
use examples::chart::Panel;
use examples::figure::{Figure, Result};

/// Cells of the chi-square test in elevation (equal steps of the angle) and azimuth.
const CELLS: [usize; 2] = [40, 12];

/// Chi-square tests of normals against `density` of the angle: of both coordinates, and of azimuth
/// alone.
fn test(normals: &[Vec3<f64>], density: impl Fn(f64) -> f64) -> [ChiSquare; 2] {
    let mut counts = vec![0.0; CELLS[0] * CELLS[1]];
    let step = FRAC_PI_2 / CELLS[0] as f64;
    let cell = |x: f64, m: usize| (x as usize).min(m - 1);
    for m in normals {
        let theta = m.x.hypot(m.y).atan2(m.z);
        let phi = (m.y.atan2(m.x) / TAU).rem_euclid(1.0);
        let column = cell(phi * CELLS[1] as f64, CELLS[1]);
        counts[cell(theta / step, CELLS[0]) * CELLS[1] + column] += 1.0;
    }
    let n = normals.len() as f64;
    // Not to the pole of the tangent.
    let edge = |i: usize| (step * i as f64).min(FRAC_PI_2 - 1e-9);
    let mut bins = Vec::new();
    let mut pool = (0.0, 0.0);
    for (i, row) in counts.chunks(CELLS[1]).enumerate() {
        // The densities have a kink at atan alpha: short steps.
        let expected = n / CELLS[1] as f64 * integrate([edge(i), edge(i + 1)], 2000, &density);
        for count in row {
            pool = (pool.0 + count, pool.1 + expected);
            if pool.1 >= 5.0 {
                bins.push(pool);
                pool = (0.0, 0.0);
            }
        }
    }
    let azimuth = (0..CELLS[1]).map(|j| {
        let count: f64 = counts.iter().skip(j).step_by(CELLS[1]).sum();
        (count, n / CELLS[1] as f64)
    });
    let azimuth: Vec<_> = azimuth.collect();
    [&bins, &azimuth].map(|bins| ChiSquare::of(bins))
}

/// `zeltner-4-16`.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(100_000, 1_000_000), 416);
    fig.note("alpha", ALPHA);
    fig.note("samples", n);
    fig.note("seed", seed);
    let root = ALPHA.atan();
    let draw = |f: &dyn Fn([f64; 2]) -> Vec3<f64>| -> Vec<Vec3<f64>> {
        (0..n)
            .map(|i| f(Independent::new(seed, 0, i).next_2d()))
            .collect()
    };
    // Of three densities for each kind.
    let least = sidak(2 * 3 * KINDS.len(), 1e-3);
    let near = |normals: &[Vec3<f64>]| {
        let close = normals
            .iter()
            .filter(|m| (m.x.hypot(m.y).atan2(m.z) - root).abs() < 0.02);
        close.count() as f64 / normals.len() as f64
    };
    let mut panels = Vec::new();
    let mut table = Vec::new();
    let mut pictures = Vec::new();
    for (name, kind) in KINDS {
        let d = surface(kind, ALPHA);
        let primal = draw(&|u| d.sample_all(u));
        let parts = [0, 1].map(|k: usize| draw(&|u| d.sample_differential(u)[k]));
        let tests = [
            (
                name.to_owned(),
                test(&primal, |t| angle(t, d.pdf_all(direction(t)))),
            ),
            (
                format!("d{name}, plus"),
                test(&parts[0], |t| part(kind, t, DiffLobe::Plus)),
            ),
            (
                format!("d{name}, minus"),
                test(&parts[1], |t| part(kind, t, DiffLobe::Minus)),
            ),
        ];
        for (label, [both, azimuth]) in tests {
            fig.check(
                format!("{label}: samples follow their density, azimuth uniform"),
                both.p_value > least && azimuth.p_value > least,
                format!(
                    "p-values {:.3} and {:.3}, at least {least:.5}, chi-square deviates {:.2} and {:.2} ({n} samples)",
                    both.p_value, azimuth.p_value, both.deviate, azimuth.deviate
                ),
            );
            let deviates = [both, azimuth].map(|test| test.deviate.to_string());
            let [both, azimuth] = deviates;
            table.push([label, both, azimuth]);
        }
        let shares = [near(&primal), near(&parts[0]), near(&parts[1])];
        fig.check(
            format!("d{name}: samples avoid theta_0 (within 0.02 rad of it)"),
            shares[1] < 0.1 * shares[0] && shares[2] < 0.1 * shares[0],
            format!(
                "{:.2} % of the primal samples, {:.3} % of plus, {:.3} % of minus",
                100.0 * shares[0],
                100.0 * shares[1],
                100.0 * shares[2]
            ),
        );
        let wrong = parts[0]
            .iter()
            .filter(|m| m.x.hypot(m.y) < ALPHA * m.z * (1.0 - 1e-12));
        let wrong = wrong.count()
            + (parts[1]
                .iter()
                .filter(|m| m.x.hypot(m.y) > ALPHA * m.z * (1.0 + 1e-12)))
            .count();
        fig.check(
            format!("d{name}: plus outside theta_0, minus inside"),
            wrong == 0,
            format!("{wrong} of {} on the wrong side", 2 * n),
        );
        let black = [60, 60, 60];
        let (green, red) = ([20, 150, 60], [200, 40, 40]);
        pictures.push((name.to_owned(), vec![(primal, black)]));
        let [plus, minus] = parts;
        pictures.push((
            format!("d{name}: plus green, minus red"),
            vec![(plus, green), (minus, red)],
        ));
    }
    // Primal distributions above, their derivatives below.
    for k in [0, 2, 1, 3] {
        let (label, clouds) = &pictures[k];
        panels.push(cloud(label, clouds));
    }
    fig.images("clouds", 2, &panels);
    let header = ["distribution", "deviate", "deviate_of_azimuth"];
    fig.csv_text("tests", &header, table);
    Ok(())
}

/// A few normals as dots on the hemisphere, seen from above.
fn cloud(label: &str, clouds: &[(Vec<Vec3<f64>>, [u8; 3])]) -> Panel {
    const SIZE: usize = 420;
    let mut panel = Panel::signed("", SIZE, &vec![0.0; SIZE * SIZE], Some(1.0));
    panel.label = label.into();
    let middle = SIZE as f64 / 2.0;
    let at = |x: f64, y: f64| [middle + x * (middle - 6.0), middle - y * (middle - 6.0)];
    let ring = |panel: &mut Panel, r: f64, colour| {
        let point = |phi: f64| at(r * phi.cos(), r * phi.sin());
        for i in 0..180 {
            let [a, b] = [i, i + 1].map(|i| point(TAU * f64::from(i) / 180.0));
            panel.line(a, b, colour);
        }
    };
    for (normals, colour) in clouds {
        for m in normals.iter().take(1500 / clouds.len()) {
            panel.dot(at(m.x, m.y), 1.6, *colour);
        }
    }
    ring(&mut panel, 1.0, [0; 3]);
    ring(&mut panel, ALPHA.atan().sin(), [0, 114, 178]);
    panel
}
