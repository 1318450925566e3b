//! [Zeltner 2021, figure 3.14]: how many reflections in a ring light a point of the floor, and from where walks find which.

use ad_core::Vec3;
use rayon::prelude::*;
use render::bsdf::DeltaKind;
use render::manifold::{Connector, Solution, Target, distinct, trials};
use render::sampler::{Independent, Sampler};
use render::scene::{Constraint, Method, Starts, Uniqueness};
use render::shape::Shape;
use render::statistics::{Estimate, z_limit};

use super::authors::{Authors, compare};
use super::manifold_methods::{Effort, single};
use super::specular_scenes::{Laboratory, RING, View, load};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::ranks::median;

/// The point of the floor that the figure shows, x and z, and that of the light.
const FLOOR: [f64; 2] = [4.218, -3.074];
const LIGHT: [f64; 3] = [-11.982, 10.0, 8.05];
/// The three reflections (errata section 9).
const LISTED: [[f64; 3]; 3] = [
    [9.476, 2.711, 3.194],
    [0.731, 2.595, -9.973],
    [7.808, 1.641, -6.248],
];
/// The ring among the shapes.
const SHAPE: u32 = 1;
const SEED: u64 = 14;

fn same(a: &Solution, b: &Solution) -> bool {
    a.is(b, Uniqueness::ErrorBounds)
}

/// `zeltner-3-14`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let view = View {
        lookat: [[0.0, 40.0, 40.0], [0.0; 3]],
        fov: 28.0,
        size: 16,
    };
    let ring = Laboratory::new(load(RING, &view, 4)?);
    fig.note("seed", SEED);
    shown(fig, ["", "basins", "counts"], &ring)?;
    published(fig)
}

/// The ring of the authors, where it is.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let file = "Figure_4_5_RingSolutions/ring.xml";
    let of = authors.scene(fig, "authors' ring", file, fig.pick(24, 96), &[])?;
    let ways = [("unbiased", single(Method::Sms, Starts::Particles))];
    let effort = Effort::of(fig, [8, 32], 2 * SEED);
    let accuracy = fig.pick((1 << 14, 0.1), (1 << 18, 0.02));
    let found = compare(fig, &of, &ways, effort, accuracy)?;
    if fig.pick(false, true) {
        let gain = found.gain(0);
        fig.check(
            "authors' ring: in the same time unbiased estimates have hundreds of times less variance than paths",
            gain > 300.0,
            format!("{gain:.0} times"),
        );
    }
    let ring = Laboratory::new(of.scene);
    let names = ["authors' ring: ", "authors-basins", "authors-counts"];
    shown(fig, names, &ring)
}

/// The shown point, and the whole floor of a ring. `scene` is said before each statement; pictures have the other names.
fn shown(fig: &mut Figure, [scene, basins, of_counts]: [&str; 3], ring: &Laboratory) -> Result {
    let connections = single(Method::Sms, Starts::Particles);
    let split = ring.split(&connections)?;
    let connector = Connector::new(ring.space(Constraint::Angle), &split, connections);
    let target = Target::Point(Vec3::from(LIGHT));

    // ---- The shown point ----
    let start = ring.floor(FLOOR[0], FLOOR[1]).ok_or("no floor")?;
    let mut rng = Independent::new(SEED, 0, 0);
    let walk = || connector.explore(&start, &target, 1, &mut rng);
    let mut found = distinct(2000, walk, same);
    let nearest = |at: [f64; 3]| {
        let distances = found.iter().enumerate().map(|(i, s)| {
            let d = (s.chain[0].si.p - Vec3::from(at)).length();
            (d, i)
        });
        distances
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((f64::INFINITY, 0))
    };
    let distances = LISTED.map(|at| nearest(at).0);
    fig.check(
        format!("{scene}2000 walks end in exactly three reflections, those listed"),
        found.len() == 3 && distances.iter().all(|d| *d < 3e-3),
        format!(
            "{} solutions, {distances:.4?} from the listed points",
            found.len()
        ),
    );
    let order = LISTED.map(|at| nearest(at).1);
    if found.len() == 3 {
        found = order.map(|i| found[i].clone()).to_vec();
    }

    // ---- Basins ----
    let size = fig.pick(96, 384);
    fig.note("basins", size);
    let shape = &ring.scene.shapes()[SHAPE as usize];
    let space = ring.space(Constraint::Angle);
    let like = [(SHAPE, DeltaKind::Reflection)];
    let end = |u: [f64; 2]| {
        let d = shape.sample(start.si.p, u)?.d;
        let chain = space.trace_own(&start, d, &like)?;
        let solution = space.walk(&start, chain, &target).solution?;
        found.iter().position(|s| same(s, &solution))
    };
    let ends: Vec<Option<usize>> = (0..size * size)
        .into_par_iter()
        .map(|i| {
            let at = |k: usize| (k as f64 + 0.5) / size as f64;
            end([at(i % size), 1.0 - at(i / size)])
        })
        .collect();
    let areas: [f64; 3] = std::array::from_fn(|k| {
        ends.iter().filter(|e| **e == Some(k)).count() as f64 / ends.len() as f64
    });
    fig.check(
        format!("{scene}each of the three solutions has a basin, and they do not cover all"),
        areas.iter().all(|a| *a > 0.01) && areas.iter().sum::<f64>() < 1.0,
        format!("{areas:.3?} of the square"),
    );
    let colours: Vec<f64> = ends
        .iter()
        .map(|e| e.map_or(0.0, |k| 1.0 + k as f64))
        .collect();
    fig.image(
        basins,
        &Panel::false_colour("basins of the three solutions", size, &colours, 0.0, 3.0)
            .enlarged(fig.pick(4, 2)),
    );

    // ---- The estimate at the shown point ----
    let worth: f64 = found.iter().map(Solution::angle_per_target).sum();
    let n = fig.pick(4_000, 40_000);
    fig.note("estimates", n);
    let each: Vec<(f64, u32)> = (0..n)
        .into_par_iter()
        .map(|i| {
            let mut rng = Independent::new(SEED, 1, i);
            let mut walk = || connector.explore(&start, &target, 1, &mut rng);
            let Some(first) = walk() else {
                return (0.0, 0);
            };
            let (n, _) = trials(|| walk().is_some_and(|s| same(&first, &s)), 1 << 20);
            (first.angle_per_target() * f64::from(n), n)
        })
        .collect();
    let sum = Estimate::of(&each.iter().map(|e| e.0).collect::<Vec<_>>());
    let z = sum.z(&Estimate::exact(worth));
    // The sum, and the number of trials.
    let limit = z_limit(2, n, 1e-3);
    fig.check(
        format!("{scene}the sum over the solutions is the mean of unbiased estimates"),
        z.abs() < limit && sum.se < 0.05 * worth,
        format!(
            "{:.4e} ± {:.1e} of {worth:.4e}, deviate {z:.2}, limit {limit:.2}",
            sum.mean, sum.se
        ),
    );
    let made: Vec<f64> = each
        .iter()
        .filter(|e| e.1 > 0)
        .map(|e| f64::from(e.1))
        .collect();
    let mean = Estimate::of(&made);
    // One over the basin of the one that was found first, on average over those found: three over all of them.
    let expected = 3.0 / areas.iter().sum::<f64>();
    fig.check(
        format!("{scene}trials are the reciprocals of basins, on average"),
        (mean.mean / expected - 1.0).abs() < 0.1 + limit * mean.se / expected,
        format!(
            "{:.2} ± {:.2}, {expected:.2} by the picture",
            mean.mean, mean.se
        ),
    );
    counts(fig, [scene, of_counts], ring, &connector, &target)
}

/// The number of solutions over the floor.
fn counts(
    fig: &mut Figure,
    [scene, name]: [&str; 2],
    ring: &Laboratory,
    connector: &Connector,
    target: &Target,
) -> Result {
    let (size, walks) = (fig.pick(40, 160), fig.pick(300, 600));
    fig.note("counts", size);
    fig.note("walks per point", walks);
    let half = 9.8;
    let solve = |i: usize| {
        let at = |k: usize| half * (2.0 * (k as f64 + 0.5) / size as f64 - 1.0);
        let (x, z) = (at(i % size), at(i / size));
        // Within the ring.
        if x.hypot(z) > half {
            return None;
        }
        let start = ring.floor(x, z)?;
        let mut rng = Independent::new(SEED, 2, i as u64);
        let walk = || connector.explore(&start, target, 1, &mut rng);
        // On the inner wall, above the floor.
        let found = distinct(walks, walk, same);
        Some(found.iter().map(|s| s.chain[0].si.p).collect())
    };
    let solved: Vec<Option<Vec<Vec3<f64>>>> = (0..size * size).into_par_iter().map(solve).collect();
    let found: Vec<Option<usize>> = (solved.iter())
        .map(|at| at.as_ref().map(Vec::len))
        .collect();
    let with = |n: usize| found.iter().filter(|c| **c == Some(n)).count();
    let histogram: [usize; 5] = std::array::from_fn(with);
    let inside = found.iter().flatten().count();
    fig.check(
        format!("{scene}points within the ring have no solution, one, or three, but for those near the edges of the light"),
        histogram[0] + histogram[1] + histogram[3] > inside * 8 / 10 && histogram[1] > 0 && histogram[3] > 0,
        format!("{histogram:?} points with 0 to 4 solutions, of {inside}"),
    );
    vanishing(fig, scene, &solved, size, 2.0 * half / size as f64);
    let colours: Vec<f64> = found
        .iter()
        .map(|c| c.map_or(f64::NAN, |n| n as f64))
        .collect();
    fig.image(
        name,
        &Panel::false_colour("number of solutions", size, &colours, 0.0, 4.0)
            .enlarged(fig.pick(4, 2)),
    );
    Ok(())
}

/// How solutions vanish from one point of the floor to the next: two together, or one over an edge of the ring. `solved` are the
/// reflections of the points of a grid with so many columns, `step` apart.
fn vanishing(
    fig: &mut Figure,
    scene: &str,
    solved: &[Option<Vec<Vec3<f64>>>],
    size: usize,
    step: f64,
) {
    const HEIGHT: f64 = 4.0;
    let at_edge = |p: &Vec3<f64>| p.y.min(HEIGHT - p.y) < 1.5 * step;
    let nearest = |points: &[Vec3<f64>]| {
        let pairs = (0..points.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
        let lengths = pairs.map(|(i, j)| (points[i] - points[j]).length());
        lengths.fold(f64::INFINITY, f64::min)
    };
    let mut jumps = [0usize; 5];
    let (mut over_edges, mut closest) = (0, Vec::new());
    for i in 0..size * size {
        for next in [i + 1, i + size] {
            let wraps = next == i + 1 && next % size == 0;
            let (Some(Some(a)), Some(Some(b)), false) = (solved.get(i), solved.get(next), wraps)
            else {
                continue;
            };
            let more = if a.len() > b.len() { a } else { b };
            match a.len().abs_diff(b.len()) {
                1 if more.iter().any(at_edge) => over_edges += 1,
                2 => closest.push(nearest(more)),
                _ => {}
            }
            jumps[a.len().abs_diff(b.len()).min(4)] += 1;
        }
    }
    let everywhere: Vec<f64> = (solved.iter().flatten())
        .filter(|points| points.len() > 1)
        .map(|points| nearest(points))
        .collect();
    let [pairs, all] = [&closest, &everywhere].map(|x| median(x).unwrap_or(f64::NAN));
    fig.check(
        format!("{scene}where two solutions vanish from one point of the floor to the next, two are next to each other"),
        jumps[2] > 10 && pairs < 0.5 * all,
        format!("{} times, {pairs:.2} apart, {all:.2} over all points; medians", jumps[2]),
    );
    fig.check(
        format!("{scene}where a single one vanishes, one is at an edge of the ring"),
        over_edges as f64 >= 0.9 * jumps[1] as f64,
        format!(
            "{over_edges} of {} times; counts differ by 0 to 4 in {jumps:?}",
            jumps[1]
        ),
    );
}
