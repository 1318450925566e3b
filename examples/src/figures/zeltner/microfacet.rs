//! [Zeltner 2021, figures 2.13 and 2.14]: Beckmann and GGX, at roughness 0.5.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use ad_core::Vec3;
use render::bsdf::microfacet::{Microfacet, Ndf};

use super::mc1::{integrate, positions};
use crate::chart::LineChart;
use crate::figure::{Figure, Result};

const ALPHA: f64 = 0.5;
const KINDS: [(&str, Ndf); 2] = [("Beckmann", Ndf::Beckmann), ("GGX", Ndf::Ggx)];

/// The direction at an angle to the normal; exact at both ends.
fn direction(theta: f64) -> Vec3<f64> {
    let cos = if theta == FRAC_PI_2 { 0.0 } else { theta.cos() };
    Vec3::new(theta.sin(), 0.0, cos)
}

fn surface(kind: Ndf) -> Microfacet<f64> {
    Microfacet {
        kind,
        alpha: ALPHA,
        visible: false,
    }
}

/// `zeltner-2-13`.
pub fn normals(fig: &mut Figure) -> Result {
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
pub fn masking(fig: &mut Figure) -> Result {
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
