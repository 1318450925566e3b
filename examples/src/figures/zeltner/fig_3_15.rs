//! [Zeltner 2021, figure 3.15 a]: where Newton's method ends for `z^3 = 1`, by the start.

use std::f64::consts::TAU;

use ad_core::{NewtonOptions, diff_fn, newton};
use rayon::prelude::*;
use render::sampler::{Independent, Sampler};

use crate::chart::Panel;
use crate::figure::{Figure, Result};

diff_fn! {
    /// `z^3 - 1`, as two real equations.
    pub fn cube_less_one<R>([x, y]: [R; 2]) -> [R; 2] {
        [x * (x.square() - y.square() * R::c(3.0)) - R::c(1.0),
         y * (x.square() * R::c(3.0) - y.square())]
    }
}

/// Half the side of the square, and radius of the disc.
const SIZE: f64 = 2.0;

/// The root `exp(2 pi i k / 3)` in which Newton's method ends, and the steps it takes.
fn basin(start: [f64; 2]) -> Option<(usize, usize)> {
    let options = NewtonOptions {
        max_iterations: 200,
        tolerance: 1e-12,
    };
    let result = newton(&cube_less_one, start, &options);
    let near = |k: &usize| {
        let angle = TAU * *k as f64 / 3.0;
        (result.x[0] - angle.cos()).hypot(result.x[1] - angle.sin()) < 1e-9
    };
    let root = (0..3).find(near).filter(|_| result.converged())?;
    Some((root, result.iterations))
}

/// Deviates, in standard errors, of the shares of the roots from `expected`.
fn deviates(counts: [u64; 3], n: u64, expected: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| {
        let (share, p) = (counts[k] as f64 / n as f64, expected[k]);
        (share - p) / (p * (1.0 - p) / n as f64).sqrt()
    })
}

/// `zeltner-3-15`, part (a).
pub fn figure(fig: &mut Figure) -> Result {
    let (n, size, seed) = (fig.pick(40_000, 4_000_000), fig.pick(256, 768), 1);
    fig.note("starts", n);
    fig.note("resolution", size);
    fig.note("seed", seed);
    // Uniform in the disc; and turned by a third of a circle.
    let in_disc = |i: u64| {
        let [u, v] = Independent::new(seed, 0, i).next_2d::<f64>();
        let (r, phi) = (SIZE * u.sqrt(), TAU * v);
        [phi, phi + TAU / 3.0].map(|phi| [r * phi.cos(), r * phi.sin()])
    };
    let ends: Vec<_> = (0..n)
        .into_par_iter()
        .map(|i| in_disc(i).map(basin))
        .collect();
    let count = |ends: &mut dyn Iterator<Item = Option<(usize, usize)>>| {
        let mut counts = [0u64; 3];
        ends.flatten().for_each(|(root, _)| counts[root] += 1);
        counts
    };
    let counts = count(&mut ends.iter().map(|e| e[0]));
    let found = counts.iter().sum::<u64>();
    fig.check(
        "every start reaches a root",
        found == n,
        format!("{found} of {n} starts"),
    );
    // Three two-sided tests at 4 standard errors: significance 2e-4 together.
    let z = deviates(counts, n, [1.0 / 3.0; 3]);
    fig.check(
        "basins cover a third of a centred disc each",
        z.iter().all(|z| z.abs() < 4.0),
        format!(
            "shares {:.5?}, deviates {z:.2?}, at most 4 ({n} starts)",
            counts.map(|c| c as f64 / n as f64)
        ),
    );
    let turned = |[a, b]: &[Option<(usize, usize)>; 2]| match (a, b) {
        (Some(a), Some(b)) => (a.0 + 1) % 3 == b.0,
        _ => false,
    };
    let symmetric = ends.iter().filter(|e| turned(e)).count();
    let share = symmetric as f64 / n as f64;
    // A start so near to a boundary that rounding decides may go either way.
    fig.check(
        "3-fold symmetry: a start turned by 120 degrees ends in the next root",
        share > 0.9999,
        format!("{symmetric} of {n} starts, at least 99.99 %"),
    );
    let in_square = |i: u64| {
        let u = Independent::new(seed, 1, i).next_2d::<f64>();
        u.map(|u| SIZE * (2.0 * u - 1.0))
    };
    let ends: Vec<_> = (0..n)
        .into_par_iter()
        .map(|i| basin(in_square(i)))
        .collect();
    let counts = count(&mut ends.iter().copied());
    let shares = counts.map(|c| c as f64 / n as f64);
    let errors = shares.map(|s| (s * (1.0 - s) / n as f64).sqrt());
    let known = [0.353, 0.323, 0.323];
    // The known numbers are rounded to three digits.
    let close = (0..3).all(|k| (shares[k] - known[k]).abs() < 1e-3 + 4.0 * errors[k]);
    fig.check(
        "shares of the square [-2, 2]^2: 0.353, 0.323, 0.323",
        close,
        format!("{shares:.5?} ± {:.5} ({n} starts)", errors[0]),
    );

    let pixels: Vec<_> = (0..size * size)
        .into_par_iter()
        .map(|i| {
            let at = |k: usize| SIZE * (2.0 * (k as f64 + 0.5) / size as f64 - 1.0);
            let start = [at(i % size), -at(i / size)];
            (start, basin(start))
        })
        .collect();
    // Colours that differ in lightness, so that prints in grey show the basins too.
    let roots: Vec<f64> = pixels
        .iter()
        .map(|(_, end)| end.map_or(f64::NAN, |e| e.0 as f64))
        .collect();
    let steps: Vec<f64> = pixels
        .iter()
        .map(|(_, end)| end.map_or(f64::NAN, |e| e.1 as f64))
        .collect();
    let mut panels = [
        Panel::false_colour("root exp(2 pi i k / 3): k", size, &roots, 0.0, 2.0),
        Panel::false_colour("steps", size, &steps, 0.0, 25.0),
    ];
    let scale = size as f64 / (2.0 * SIZE);
    for panel in &mut panels {
        for k in 0..3 {
            let angle = TAU * f64::from(k) / 3.0;
            let centre = [(SIZE + angle.cos()) * scale, (SIZE - angle.sin()) * scale];
            panel.dot(centre, 0.008 * size as f64, [0, 0, 0]);
            panel.dot(centre, 0.005 * size as f64, [255, 255, 255]);
        }
    }
    fig.images("fractal", 2, &panels);
    let rows = pixels.iter().step_by(fig.pick(4, 16)).map(|(z, end)| {
        let (root, steps) = end.map_or((f64::NAN, f64::NAN), |e| (e.0 as f64, e.1 as f64));
        [z[0], z[1], root, steps]
    });
    let rows: Vec<_> = rows.collect();
    fig.csv("fractal", &["re", "im", "root", "steps"], rows);
    Ok(())
}
