//! [Zeltner 2021, figure 3.15]: where Newton's method ends by the start, for `z^3 = 1`, and in a bumpy ring of metal.

use std::f64::consts::TAU;

use ad_core::{NewtonOptions, Vec3, diff_fn, newton};
use rayon::prelude::*;
use render::Scene;
use render::bsdf::DeltaKind;
use render::manifold::{Solution, Target};
use render::sampler::{Independent, Sampler};
use render::scene::{Constraint, Uniqueness};
use render::shape::Shape;
use render::statistics::z_limit;

use super::authors::Authors;
use super::manifold_scenes::{RING_SHAPE, bumpy_ring};
use super::specular_scenes::Laboratory;
use examples::chart::Panel;
use examples::figure::{Figure, Result};

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

/// `zeltner-3-15`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    fractal(fig);
    ring(fig, ["", "ring"], bumpy_ring(0.2, BUMPS)?)?;
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let file = "Figure_4_5_RingSolutions/ring_notebook_normalmapped.xml";
    let of = authors.scene(fig, "authors' ring", file, 16, &[])?;
    ring(fig, ["authors' ring: ", "authors-ring"], of.scene)
}

/// Part (a).
fn fractal(fig: &mut Figure) {
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
    // Three basins in a disc, three in a square.
    let limit = z_limit(6, n, 1e-3);
    let z = deviates(counts, n, [1.0 / 3.0; 3]);
    fig.check(
        "basins cover a third of a centred disc each",
        z.iter().all(|z| z.abs() < limit),
        format!(
            "shares {:.5?}, deviates {z:.2?}, limit {limit:.2} ({n} starts)",
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
    let close = (0..3).all(|k| (shares[k] - known[k]).abs() < 1e-3 + limit * errors[k]);
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
}

/// Seed of the bumps.
const BUMPS: u64 = 315;
/// A point of the floor in the ring, and the middle of the light.
const FLOOR: [f64; 2] = [4.218, -3.074];
const LIGHT: [f64; 3] = [-12.0, 10.0, 8.0];

/// Part (b): basins on the ring of figure 3.14 under a normal map. `name` is said before each statement.
fn ring(fig: &mut Figure, [name, picture]: [&str; 2], scene: Scene) -> Result {
    let lab = Laboratory::new(scene);
    let space = lab.space(Constraint::Angle);
    let start = lab.floor(FLOOR[0], FLOOR[1]).ok_or("no floor")?;
    let target = Target::Point(Vec3::from(LIGHT));
    let size = fig.pick(96usize, 384);
    fig.note("basins", size);
    let shape = &lab.scene.shapes()[RING_SHAPE as usize];
    let like = [(RING_SHAPE, DeltaKind::Reflection)];
    let ends: Vec<Option<Solution>> = (0..size * size)
        .into_par_iter()
        .map(|i| {
            let at = |k: usize| (k as f64 + 0.5) / size as f64;
            let d = shape
                .sample(start.si.p, [at(i % size), 1.0 - at(i / size)])?
                .d;
            let chain = space.trace_own(&start, d, &like)?;
            let found = space.walk(&start, chain, &target).solution?;
            // In front of the bumps, too.
            let vertex = &found.chain[0];
            let seen = |p: Vec3<f64>| (p - vertex.si.p).dot(vertex.normal());
            (seen(start.si.p) * seen(Vec3::from(LIGHT)) > 0.0).then_some(found)
        })
        .collect();
    let mut solutions: Vec<Solution> = Vec::new();
    let mut basins: Vec<Option<usize>> = Vec::new();
    for end in &ends {
        basins.push(end.as_ref().map(|end| {
            let known = solutions
                .iter()
                .position(|s| s.is(end, Uniqueness::ErrorBounds));
            known.unwrap_or_else(|| {
                solutions.push(end.clone());
                solutions.len() - 1
            })
        }));
    }
    let covered = basins.iter().flatten().count() as f64 / basins.len() as f64;
    fig.check(
        format!("{name}a point in a bumpy ring has more than three solutions, whose basins do not cover all"),
        solutions.len() > 3 && covered < 1.0,
        format!("{} solutions, {covered:.3} of the square", solutions.len()),
    );
    let parts: Vec<usize> = (0..solutions.len())
        .map(|k| parts_of(&basins, size, k))
        .collect();
    fig.check(
        format!("{name}basins are scattered: some are of several parts"),
        parts.iter().filter(|&&n| n > 1).count() > 1,
        format!("{parts:?} parts of more than three starts"),
    );
    let colours: Vec<f64> = (basins.iter())
        .map(|k| k.map_or(0.0, |k| 2.0 + (k % 9) as f64))
        .collect();
    let panel = Panel::false_colour("basins in a bumpy ring", size, &colours, 0.0, 10.0);
    fig.image(picture, &panel.enlarged(fig.pick(4, 2)));
    Ok(())
}

/// Parts of more than three starts of the basin of solution `k` that are not joined along sides of the square's cells.
fn parts_of(basins: &[Option<usize>], size: usize, k: usize) -> usize {
    let mut left: Vec<bool> = basins.iter().map(|b| *b == Some(k)).collect();
    let mut parts = 0;
    for first in 0..left.len() {
        let (mut open, mut n) = (vec![first], 0);
        while let Some(i) = open.pop() {
            if !std::mem::take(&mut left[i]) {
                continue;
            }
            n += 1;
            let (x, y) = (i % size, i / size);
            open.extend((x > 0).then(|| i - 1));
            open.extend((x + 1 < size).then(|| i + 1));
            open.extend((y > 0).then(|| i - size));
            open.extend((y + 1 < size).then(|| i + size));
        }
        parts += usize::from(n > 3);
    }
    parts
}
