//! [Zeltner 2021, figure 3.6]: the Jacobian of the constraints of a chain, whose blocks couple neighbours only.
//!
//! The chain goes into a ball of glass, is reflected in it twice, and leaves it.

use ad_core::{Mat2, Vec2, Vec3, block_tridiagonal_solve, solve_dense};
use render::bsdf::DeltaKind;
use render::manifold::constraint::{self, Facet, equator};
use render::manifold::{Chain, Start, Target};
use render::math::{Frame, warp};
use render::sampler::{Independent, Sampler};
use render::scene::Constraint;

use super::manifold_scenes::glass;
use super::specular_scenes::Laboratory;
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View};

const SEED: u64 = 36;
/// Vertices of the chain, and unknowns.
const K: usize = 4;
const N: usize = 2 * K;
/// The ball among the shapes.
const SHAPE: u32 = 1;
const CENTRE: [f64; 3] = [0.0, 3.0, 0.0];
const RADIUS: f64 = 2.0;
const ETA: f64 = 1.5;
/// Step of differences, a length.
const STEP: f64 = 1e-4;

const LIKE: [(u32, DeltaKind); K] = [
    (SHAPE, DeltaKind::Transmission),
    (SHAPE, DeltaKind::Reflection),
    (SHAPE, DeltaKind::Reflection),
    (SHAPE, DeltaKind::Transmission),
];

/// A ball of glass over a floor.
fn scene() -> Result<render::Scene> {
    let mut b = SceneBuilder::default();
    let matt = b.matt("floor", [0.6; 3])?;
    let floor = [[-9.0, 0.0, -9.0], [0.0, 0.0, 18.0], [18.0, 0.0, 0.0]];
    b.quad("floor", floor, &matt)?;
    let smooth = glass(&mut b)?;
    b.ball("ball", CENTRE, RADIUS, &smooth)?;
    let view = View {
        eye: [0.0, 4.0, 12.0],
        target: CENTRE,
        fov: 40.0,
        size: [16; 2],
    };
    b.finish(&view, 4)
}

/// All constraints where the vertices are at these points of the ball.
fn constraints(start: &Start, points: &[Vec3<f64>; K], at: Vec3<f64>) -> Option<[f64; N]> {
    let frame = equator(at - start.si.p);
    let mut all = [0.0; N];
    for i in 0..K {
        let p = points[i];
        let before = if i == 0 { start.si.p } else { points[i - 1] };
        let next = points.get(i + 1).copied().unwrap_or(at);
        let n = (p - Vec3::from(CENTRE)).normalize();
        let facet = Facet { n, eta: ETA };
        let [w, onward] = [before, next].map(|q| (q - p).normalize());
        let c = constraint::value(Constraint::Angle, LIKE[i].1, w, onward, &facet, &frame)?;
        all[2 * i..2 * i + 2].copy_from_slice(&c);
    }
    Some(all)
}

/// The Jacobian by central differences of all constraints in all positions.
fn differences(start: &Start, chain: &Chain, at: Vec3<f64>) -> Option<[[f64; N]; N]> {
    let points: [Vec3<f64>; K] = std::array::from_fn(|i| chain[i].si.p);
    let mut jacobian = [[0.0; N]; N];
    for j in 0..N {
        let Frame { s, t, .. } = Frame::from_normal(chain[j / 2].si.n_geo);
        let along = if j % 2 == 0 { s } else { t };
        let moved = |h: f64| {
            let mut points = points;
            let out = points[j / 2] + along * h - Vec3::from(CENTRE);
            points[j / 2] = Vec3::from(CENTRE) + out.normalize() * RADIUS;
            constraints(start, &points, at)
        };
        let slope = |h: f64| {
            let (a, b) = (moved(h)?, moved(-h)?);
            Some(std::array::from_fn::<f64, N, _>(|i| {
                (a[i] - b[i]) / (2.0 * h)
            }))
        };
        // The error of both cancels to fourth order.
        let (near, far) = (slope(STEP)?, slope(2.0 * STEP)?);
        for i in 0..N {
            jacobian[i][j] = (4.0 * near[i] - far[i]) / 3.0;
        }
    }
    Some(jacobian)
}

/// `zeltner-3-6`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let wanted = fig.pick(200, 2000);
    fig.note("chains", wanted);
    fig.note("seed", SEED);
    let lab = Laboratory::new(scene()?);
    let space = lab.space(Constraint::Angle);
    // Relative to the largest entry.
    let (mut outside, mut apart, mut solved, mut shot): (f64, f64, f64, f64) = Default::default();
    let mut shown = None;
    let mut seen = 0;
    for i in 0..20 * wanted {
        if seen == wanted {
            break;
        }
        let mut rng = Independent::new(SEED, 0, i);
        let [a, b] = rng.next_2d::<f64>().map(|u| 4.0 * u - 2.0);
        let start = lab.floor(a, b).ok_or("no floor")?;
        let inside = warp::square_to_sphere(rng.next_2d::<f64>()) * (0.9 * RADIUS);
        let d = (Vec3::from(CENTRE) + inside - start.si.p).normalize();
        let at = Vec3::new(8.0, 6.0, 0.0) + warp::square_to_sphere(rng.next_2d::<f64>()) * 2.0;
        let target = Target::Point(at);
        let Some(chain) = space.trace_own(&start, d, &LIKE) else {
            continue;
        };
        let frame = equator(at - start.si.p);
        let rows: Option<Vec<_>> = (0..K)
            .map(|i| space.row(start.si.p, &chain, i, &target, &frame))
            .collect();
        let (Some(rows), Some(whole)) = (rows, differences(&start, &chain, at)) else {
            continue;
        };
        // As blocks, and all of it.
        let mut dense = [[0.0; N]; N];
        for (i, (_, row)) in rows.iter().enumerate() {
            let columns = [i.checked_sub(1), Some(i), Some(i + 1).filter(|j| *j < K)];
            for (block, j) in row.iter().zip(columns) {
                let Some(j) = j else { continue };
                for (r, line) in block.rows.iter().enumerate() {
                    dense[2 * i + r][2 * j..2 * j + 2].copy_from_slice(line);
                }
            }
        }
        let scale = whole.iter().flatten().fold(0.0, |m: f64, x| m.max(x.abs()));
        // Not across the jump of azimuths, nor next to total reflection.
        if !scale.is_finite() || scale > 100.0 {
            continue;
        }
        let mut rhs = [0.0; N];
        let last = rows[K - 1].0;
        rhs[N - 2..].copy_from_slice(&[last.x, last.y]);
        let mut blocks = [Vec2::zero(); K];
        blocks[K - 1] = last;
        let of = |k: usize| rows.iter().map(|r| r.1[k]).collect::<Vec<Mat2<f64>>>();
        let (lower, mut diagonal, upper) = (of(0), of(1), of(2));
        let by_blocks = block_tridiagonal_solve(&lower, &mut diagonal, &upper, &mut blocks);
        let (Some(by_all), true) = (solve_dense(dense, rhs), by_blocks) else {
            continue;
        };
        let shooting = space.derivative(start.si.p, &chain, &target, &frame);
        let Some(step) = shooting.and_then(|at| Some(at.first.inverse()? * at.value)) else {
            continue;
        };
        seen += 1;
        for i in 0..N {
            for j in 0..N {
                if (i / 2).abs_diff(j / 2) > 1 {
                    outside = outside.max(whole[i][j].abs() / scale);
                } else {
                    apart = apart.max((whole[i][j] - dense[i][j]).abs() / scale);
                }
            }
        }
        let size = by_all.iter().fold(1e-300, |m: f64, x| m.max(x.abs()));
        for (k, block) in blocks.iter().enumerate() {
            let off = Vec2::new(by_all[2 * k], by_all[2 * k + 1]) - *block;
            solved = solved.max(off.x.abs().max(off.y.abs()) / size);
        }
        let off = blocks[0] - step;
        shot = shot.max(off.x.abs().max(off.y.abs()) / size);
        shown.get_or_insert(whole.map(|row| row.map(|x| x / scale)));
    }
    fig.check(
        "constraints change with the vertex and its two neighbours only",
        seen == wanted && outside < 1e-12,
        format!("differences beyond are {outside:.1e} of the largest at most, on {seen} chains of {K} vertices"),
    );
    fig.check(
        "all other blocks are those of central differences to 1e-6",
        apart < 1e-6,
        format!("{apart:.1e} of the largest at most"),
    );
    fig.check(
        "elimination by blocks solves the whole system",
        solved < 1e-9,
        format!("{solved:.1e} off at most, relative to the step"),
    );
    fig.check(
        "the step of the first vertex is that of walks, which trace all others from it",
        shot < 1e-9,
        format!("{shot:.1e} off at most"),
    );
    let shown = shown.ok_or("no chain")?;
    let values: Vec<f64> = shown.iter().flatten().copied().collect();
    fig.image(
        "jacobian",
        &Panel::signed("Jacobian by differences", N, &values, Some(1.0)).enlarged(32),
    );
    let columns: [String; N] = std::array::from_fn(|j| format!("vertex {}.{}", j / 2 + 1, j % 2));
    fig.csv("jacobian", &columns.each_ref().map(String::as_str), shown);
    Ok(())
}
