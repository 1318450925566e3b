//! [Zeltner 2021, figure 2.14]: shadowing and masking.

use std::f64::consts::{FRAC_PI_2, PI};

use ad_core::Vec3;
use render::bsdf::microfacet::Ndf;

use super::integration_1d::{integrate, positions};
use super::microfacet::{ALPHA, KINDS, direction, surface};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// `G1` by its definition [Zeltner 2021, Eq. 2.42], integrated over all normals: in closed form over
/// azimuth, where `w.m` is a constant plus a cosine, and by quadrature over elevation.
fn by_definition(kind: Ndf, theta: f64, steps: usize) -> f64 {
    let w = direction(theta);
    let seen = |theta_m: f64| {
        // Not quite at the horizon, where D drops to 0.
        let m = Vec3::new(theta_m.sin(), 0.0, theta_m.cos());
        let (constant, amplitude) = (w.z * m.z, w.x * m.x);
        // Of |phi| below this, normals face w.
        let phi = if amplitude <= constant {
            PI
        } else {
            (-constant / amplitude).acos()
        };
        let facing = 2.0 * (constant * phi + amplitude * phi.sin());
        surface(kind).d(m) * facing * m.x
    };
    // The azimuth ceases to be cut where the normal is as far from the pole as w from the horizon.
    let kink = FRAC_PI_2 - theta;
    let area = [[0.0, kink], [kink, FRAC_PI_2]].map(|range| {
        // Substituting a square softens the root at the kink.
        let length = range[1] - range[0];
        integrate([0.0, 1.0], steps, |t| {
            let (u, slope) = if range[0] == kink {
                (kink + length * t * t, 2.0 * length * t)
            } else {
                (kink - length * t * t, 2.0 * length * t)
            };
            seen(u.clamp(0.0, FRAC_PI_2)) * slope
        })
    });
    w.z / (area[0] + area[1])
}

/// `zeltner-2-14`.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(1000, 10_000);
    fig.note("alpha", ALPHA);
    fig.note("integration_steps", 4 * n);
    let g1 = |kind: Ndf, theta: f64| {
        let w = direction(theta);
        // A normal that w sees from above.
        surface(kind).g1(w, Vec3::new(0.6, 0.0, 0.8))
    };
    let pair = |theta: f64| KINDS.map(|(_, kind)| g1(kind, theta));
    let [b, g] = pair(0.0);
    fig.check(
        "1 at theta 0",
        b == 1.0 && g == 1.0,
        format!("Beckmann {b}, GGX {g}"),
    );
    let ([b, g], [b1, g1_near]) = (pair(FRAC_PI_2), pair(FRAC_PI_2 - 1e-6));
    fig.check(
        "0 at 90 degrees, and tends to it",
        b == 0.0 && g == 0.0 && b1 < 1e-5 && g1_near < 1e-5,
        format!("Beckmann {b}, GGX {g}; 1e-6 rad before {b1:.1e}, {g1_near:.1e}"),
    );
    let angles: Vec<f64> = positions([0.0, FRAC_PI_2], 1000).collect();
    let inner = &angles[1..angles.len() - 1];
    let below = inner.iter().filter(|&&t| {
        let [b, g] = pair(t);
        g < b
    });
    let below = below.count();
    fig.check(
        "GGX below Beckmann everywhere between",
        below == inner.len(),
        format!("at {below} of {} angles", inner.len()),
    );
    for (theta, expected) in [(1.0, [0.993, 0.882]), (1.4, [0.708, 0.492])] {
        let found = pair(theta);
        fig.check(
            format!(
                "at {theta} rad: Beckmann {}, GGX {}",
                expected[0], expected[1]
            ),
            (0..2).all(|k| (found[k] - expected[k]).abs() <= 5e-4),
            format!("{:.6}, {:.6}", found[0], found[1]),
        );
    }
    let grid: Vec<f64> = positions([0.0, 1.55], 31).collect();
    let rows: Vec<_> = grid
        .iter()
        .map(|&t| {
            let [b, g] = pair(t);
            let [db, dg] = KINDS.map(|(_, kind)| by_definition(kind, t, n));
            [t, b, g, db, dg]
        })
        .collect();
    for (k, (name, _)) in KINDS.into_iter().enumerate() {
        let gap = rows
            .iter()
            .map(|r| (r[k + 1] - r[k + 3]).abs())
            .fold(0.0, f64::max);
        fig.check(
            format!("{name} matches numerical integration of the definition"),
            gap < 1e-7,
            format!(
                "largest gap {gap:.1e} at {} angles up to 1.55 rad",
                rows.len()
            ),
        );
    }
    let curve = |k: usize| angles.iter().map(move |&t| (t.to_degrees(), pair(t)[k]));
    let points = |k: usize| {
        rows.iter()
            .map(|r| (r[0].to_degrees(), r[k]))
            .collect::<Vec<_>>()
    };
    let chart = LineChart::new(
        "Shadowing and masking, alpha = 0.5",
        "angle of the direction, degrees",
        "G1",
    )
    .x_range(0.0, 90.0)
    .y_range(0.0, 1.35)
    .line("Beckmann", curve(0))
    .line("GGX", curve(1))
    .points("Beckmann, definition integrated", points(3))
    .points("GGX, definition integrated", points(4));
    let header = [
        "theta",
        "beckmann",
        "ggx",
        "beckmann_integrated",
        "ggx_integrated",
    ];
    fig.csv("masking", &header, rows);
    fig.chart("masking", &chart);
    Ok(())
}
