//! [Zeltner 2021, figure 2.13]: distributions of normals.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use render::bsdf::microfacet::Ndf;

use super::integration_1d::{integrate, positions};
use super::microfacet::{ALPHA, KINDS, direction, surface};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// `zeltner-2-13`.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(2000, 20_000);
    fig.note("alpha", ALPHA);
    fig.note("integration_steps", 2 * n);
    let d = |kind: Ndf, theta: f64| surface(kind).d(direction(theta));
    let pair = |theta: f64| KINDS.map(|(_, kind)| d(kind, theta));
    let [b, g] = pair(0.0);
    let top = 1.0 / (PI * ALPHA * ALPHA);
    fig.check(
        "equal at theta = 0: 1 / (pi alpha^2) = 1.27324",
        (b - top).abs() < 1e-12 && (g - top).abs() < 1e-12 && (b - 1.27324).abs() < 1e-5,
        format!("Beckmann {b:.6}, GGX {g:.6}"),
    );
    let excess = |theta: f64| {
        let [b, g] = pair(theta);
        g - b
    };
    let grid: Vec<f64> = positions([0.0, FRAC_PI_2], 4000).skip(1).collect();
    let changes: Vec<_> = grid
        .windows(2)
        .filter(|w| (excess(w[0]) > 0.0) != (excess(w[1]) > 0.0) && w[1] < FRAC_PI_2)
        .collect();
    let crossing = changes.first().map_or(f64::NAN, |w| {
        let (mut a, mut b) = (w[0], w[1]);
        for _ in 0..60 {
            let m = 0.5 * (a + b);
            if excess(m) > 0.0 { b = m } else { a = m }
        }
        0.5 * (a + b)
    });
    fig.check(
        "a single crossing, at 0.670 rad",
        changes.len() == 1 && (crossing - 0.67021).abs() < 1e-5,
        format!(
            "{} crossing(s) on {} angles, at {crossing:.6} rad",
            changes.len(),
            grid.len()
        ),
    );
    let beyond = grid.iter().filter(|&&t| t > crossing && t < FRAC_PI_2);
    let larger = beyond.clone().filter(|&&t| excess(t) > 0.0).count();
    fig.check(
        "GGX larger beyond it",
        larger > 0 && larger == beyond.clone().count(),
        format!("at {larger} of {} angles", beyond.count()),
    );
    let [b, g] = pair(1.2);
    fig.check(
        "at 1.2 rad, GGX 0.0979 and Beckmann 2.4e-10",
        (g - 0.0979).abs() < 5e-5 && (b - 2.4e-10).abs() < 5e-12,
        format!("GGX {g:.5}, Beckmann {b:.3e}"),
    );
    for (name, kind) in KINDS {
        let integral = integrate([0.0, FRAC_PI_2], n, |theta| {
            let w = direction(theta);
            d(kind, theta) * w.z * w.x * TAU
        });
        fig.check(
            format!("{name} integrates to 1 over projected solid angle"),
            (integral - 1.0).abs() < 1e-8,
            format!("{integral:.12}"),
        );
    }
    let rows: Vec<_> = positions([-89.75, 89.75], 718)
        .map(|degrees| {
            let [b, g] = pair(degrees.to_radians().abs().min(FRAC_PI_2));
            [degrees, b, g]
        })
        .collect();
    let curve = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let at_crossing = pair(crossing)[0];
    let chart = LineChart::new(
        "Distributions of normals, alpha = 0.5",
        "angle of the normal, degrees",
        "D, per steradian",
    )
    .x_range(-90.0, 90.0)
    .y_range(0.0, 1.4)
    .line("Beckmann", curve(1))
    .line("GGX", curve(2))
    .points(
        "crossings",
        [-1.0, 1.0].map(|s| (s * crossing.to_degrees(), at_crossing)),
    );
    fig.csv("normals", &["degrees", "beckmann", "ggx"], rows);
    fig.chart("normals", &chart);
    Ok(())
}
