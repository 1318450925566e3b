//! Discontinuities that sampling moves [Zeltner 2021, figure 4.12]: the hemisphere above a point of a
//! room, seen through the map from random numbers to reflected directions.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, TAU};

use ad_core::{Dual, Real, Vec3};
use rayon::prelude::*;
use render::bsdf::microfacet::{Microfacet, Ndf};
use render::math::Ray;
use render::statistics::z_limit;
use render::{Image, Scene};

use super::radiance_split::radiance;
use crate::common_scenes::{CORNELL_LAMP, Walls, cornell};
use crate::statistics::Moments;
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::scene_builder::{add, dot, sub, unit};

type D = Dual<f64, 1>;

const SEED: u64 = 412;
const ALPHAS: [f64; 2] = [0.4, 0.6];
/// The reference point: on the floor, in front of the tall block.
const POINT: [f64; 3] = [-0.3, -1.0, 0.5];

/// Towards the viewer, in the local frame.
fn viewer() -> Vec3<f64> {
    Vec3::new(0.1, -0.4, 0.9).normalize()
}

/// From the world (y up, z to the front) to the local frame of the floor, and back.
fn local(v: [f64; 3]) -> Vec3<f64> {
    Vec3::new(v[0], -v[2], v[1])
}

fn world(w: Vec3<f64>) -> [f64; 3] {
    [w.x, w.z, -w.y]
}

/// The square to the unit disc, area-preserving, through concentric squares and circles.
fn to_disc<R: Real<Primal = f64>>(u: [R; 2]) -> [R; 2] {
    let [a, b] = u.map(|u| u * R::c(2.0) - R::one());
    if a.primal() == 0.0 && b.primal() == 0.0 {
        return [a, b];
    }
    let (r, phi) = if a.primal().abs() > b.primal().abs() {
        (a, b / a * R::c(FRAC_PI_4))
    } else {
        (b, R::of(FRAC_PI_2) - a / b * R::c(FRAC_PI_4))
    };
    let (sin, cos) = phi.sin_cos();
    [r * cos, r * sin]
}

/// The inverse of [`to_disc`].
fn to_square<R: Real<Primal = f64>>([x, y]: [R; 2]) -> [R; 2] {
    let r = x.hypot(y);
    let ab = if x.primal().abs() > y.primal().abs() {
        let a = r.copysign(x.primal());
        [a, a * (y / x).atan() * R::c(1.0 / FRAC_PI_4)]
    } else if y.primal() != 0.0 {
        let b = r.copysign(y.primal());
        [b * (x / y).atan() * R::c(1.0 / FRAC_PI_4), b]
    } else {
        [x, y]
    };
    ab.map(|a| (a + R::one()) * R::c(0.5))
}

/// The sampled direction for two random numbers: a Beckmann normal by a concentric map, reflected about. May
/// be below the horizon.
fn sample<R: Real<Primal = f64>>(u: [R; 2], alpha: R) -> Vec3<R> {
    let [x, y] = to_disc(u);
    let square = x.square() + y.square();
    // The squared radius is uniform: tan^2 = -alpha^2 ln(1 - r^2).
    let stretch = if square.primal() > 0.0 {
        alpha * (-(-square).ln_1p() / square).sqrt()
    } else {
        alpha
    };
    let m = Vec3::new(x * stretch, y * stretch, R::one()).normalize();
    let wo = Vec3::lift(viewer());
    m * (wo.dot(m) * R::c(2.0)) - wo
}

/// The random numbers that [`sample`] sends to a direction.
fn inverse<R: Real<Primal = f64>>(w: Vec3<R>, alpha: R) -> [R; 2] {
    let m = Vec3::lift(viewer()) + w;
    let [x, y] = [m.x / m.z, m.y / m.z];
    let square = x.square() + y.square();
    let shrink = if square.primal() > 0.0 {
        (-(-square / alpha.square()).exp_m1() / square).sqrt()
    } else {
        alpha.recip()
    };
    to_square([x * shrink, y * shrink])
}

/// A discontinuity of the light from the hemisphere; it does not depend on the roughness.
struct Edge {
    name: &'static str,
    colour: [u8; 3],
    /// Visible directions along it.
    directions: Vec<Vec3<f64>>,
}

/// Points on the way from `a` to `b`.
fn between(a: [f64; 3], b: [f64; 3], n: usize) -> impl Iterator<Item = [f64; 3]> {
    (0..n).map(move |i| add(a, sub(b, a), i as f64 / n as f64))
}

fn ray(w: Vec3<f64>) -> Ray<f32> {
    let o = [POINT[0], POINT[1] + 1e-4, POINT[2]];
    let cast = |v: [f64; 3]| Vec3::from(v.map(|c| c as f32));
    Ray::new(cast(o), cast(world(w)).normalize())
}

fn edges(scene: &Scene, n: usize) -> Vec<Edge> {
    let [half, height] = CORNELL_LAMP;
    let corner = |x: f64, z: f64| [half * x, height, half * z];
    let lamp = [
        corner(-1.0, -1.0),
        corner(1.0, -1.0),
        corner(1.0, 1.0),
        corner(-1.0, 1.0),
    ];
    let lamp: Vec<_> = (0..4)
        .flat_map(|k| between(lamp[k], lamp[(k + 1) % 4], n))
        .collect();
    let ceiling = between([-1.0, 1.0, -1.0], [1.0, 1.0, -1.0], n).collect();
    let corner = between([1.0, -1.0, -1.0], [1.0, 1.0, -1.0], n).collect();
    let left = between([-1.0, 1.0, -1.0], [-1.0, 1.0, 1.0], n).collect();
    // Nothing in front: the room is hit where the edge is.
    let seen = |p: &[f64; 3]| {
        let to = sub(*p, POINT);
        let hit = scene.intersect(&ray(local(unit(to))));
        hit.is_some_and(|hit| {
            let at = sub(hit.si.p.to_array().map(f64::from), POINT);
            dot(at, at) > 0.99 * dot(to, to)
        })
    };
    let edge = |name, colour, points: Vec<[f64; 3]>| Edge {
        name,
        colour,
        directions: (points.iter().filter(|p| seen(p)))
            .map(|p| local(unit(sub(*p, POINT))))
            .collect(),
    };
    let horizon = (0..4 * n).map(|i| {
        let (sin, cos) = (TAU * i as f64 / (4 * n) as f64).sin_cos();
        Vec3::new(cos, sin, 0.0)
    });
    vec![
        edge("lamp", [220, 30, 30], lamp),
        edge("back wall and ceiling", [40, 90, 230], ceiling),
        edge("back and right wall", [40, 90, 230], corner),
        edge("left wall and ceiling", [40, 90, 230], left),
        Edge {
            name: "horizon",
            colour: [240, 160, 0],
            directions: horizon.collect(),
        },
    ]
}

/// Random numbers of a direction, and how fast they move with roughness.
fn preimage(w: Vec3<f64>, alpha: f64) -> [D; 2] {
    inverse(Vec3::lift(w), D::var(alpha, 0))
}

/// `zeltner-4-12`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    fig.note("alpha", format!("{ALPHAS:?}"));
    fig.note("seed", SEED);
    let scene = cornell(8, Walls::Matt, 4)?;
    let edges = edges(&scene, 200);
    let length = |[x, y]: [f64; 2]| x.hypot(y);
    let mut rows = Vec::new();
    for edge in &edges {
        let name = edge.name;
        let (mut loss, mut gap, mut balance): (f64, f64, f64) = (0.0, 0.0, 0.0);
        let mut speeds = [f64::INFINITY, 0.0];
        let mut shifts = [f64::INFINITY, 0.0];
        let mut moved = 0;
        let widen = |range: &mut [f64; 2], x: f64| *range = [range[0].min(x), range[1].max(x)];
        for &w in &edge.directions {
            let mut places = [[0.0; 2]; 2];
            for (place, alpha) in places.iter_mut().zip(ALPHAS) {
                let u = preimage(w, alpha);
                *place = u.map(|u| u.re);
                let motion = u.map(|u| u.eps[0]);
                loss = loss.max((sample(*place, alpha) - w).length());
                let h = 1e-5;
                let [a, b] = [alpha + h, alpha - h].map(|alpha| inverse(w, alpha));
                let slope = [0, 1].map(|k| (a[k] - b[k]) / (2.0 * h));
                gap = gap.max(length([motion[0] - slope[0], motion[1] - slope[1]]));
                // A random number that moves with its edge keeps its direction.
                let moving = [0, 1].map(|k| D::new(place[k], [motion[k]]));
                let kept = sample(moving, D::var(alpha, 0));
                let kept = [kept.x, kept.y, kept.z].map(|c| c.eps[0].abs());
                balance = kept.into_iter().fold(balance, f64::max);
                widen(&mut speeds, length(motion));
                rows.push([
                    name.to_owned(),
                    alpha.to_string(),
                    place[0].to_string(),
                    place[1].to_string(),
                    motion[0].to_string(),
                    motion[1].to_string(),
                ]);
            }
            let [a, b] = places;
            let shift = length([a[0] - b[0], a[1] - b[1]]);
            widen(&mut shifts, shift);
            moved += usize::from(shift > 0.01);
        }
        let n = edge.directions.len();
        // Half of the horizon is where almost no sample gets: at the border of the square, for any roughness.
        // Little is left of 1 - r^2 there, and its digits are few.
        let (share, loss_limit, balance_limit) = if edge.name == "horizon" {
            (0.4, 1e-9, 1e-7)
        } else {
            (1.0, 1e-12, 1e-10)
        };
        let part = moved as f64 / n as f64;
        fig.check(
            format!("{name}: preimages map back, and differ between the two roughnesses"),
            n > 50 && loss < loss_limit && part >= share && shifts[1] > 0.05,
            format!(
                "{n} points, by {:.4} to {:.4} of the square, {:.0} % by over 0.01; largest error {loss:.0e}",
                shifts[0],
                shifts[1],
                100.0 * part
            ),
        );
        fig.check(
            format!("{name}: motion equals differences of the inverse, and keeps the direction"),
            gap < 1e-7 && balance < balance_limit && speeds[1] > 0.1,
            format!(
                "gaps {gap:.0e} and {balance:.0e}; speed {:.3} to {:.3}",
                speeds[0], speeds[1]
            ),
        );
    }
    let header = ["edge", "alpha", "u", "v", "du_dalpha", "dv_dalpha"];
    fig.csv_text("edges", &header, rows);
    lamp_share(fig, &scene, &edges[0].directions);

    let mut panels = vec![hemisphere(&scene, fig.pick((96, 4), (320, 32)), &edges)?];
    for alpha in ALPHAS {
        panels.push(square(&scene, fig.pick((96, 4), (320, 32)), &edges, alpha)?);
    }
    fig.images("edges", 3, &panels);
    Ok(())
}

/// The share of samples that hit the lamp, and its derivative: all of it comes from the edge.
fn lamp_share(fig: &mut Figure, scene: &Scene, outline: &[Vec3<f64>]) {
    let n = fig.pick(100_000, 2_000_000);
    fig.note("samples", n);
    let area = |at: &dyn Fn(Vec3<f64>) -> [D; 2]| -> D {
        let u: Vec<_> = outline.iter().map(|&w| at(w)).collect();
        let next = u.iter().cycle().skip(1);
        let twice: D = (u.iter().zip(next))
            .map(|(a, b)| a[0] * b[1] - b[0] * a[1])
            .sum();
        twice * D::c(0.5)
    };
    let limit = z_limit(2 * ALPHAS.len(), n, 1e-3);
    for alpha in ALPHAS {
        let exact = area(&|w| preimage(w, alpha));
        let exact = if exact.re < 0.0 { -exact } else { exact };
        let surface = Microfacet {
            kind: Ndf::Beckmann,
            alpha: D::var(alpha, 0),
            visible: false,
        };
        let mut hits = Moments::default();
        // One sample: whether it hits, and the detached derivative.
        let detached = Moments::of(n, SEED, |s| {
            use render::sampler::Sampler;
            let w = sample(s.next_2d(), alpha);
            let hit = (w.z > 0.0).then(|| scene.intersect(&ray(w))).flatten();
            let hit = hit.is_some_and(|hit| scene.shape_info(hit.shape).emitter.is_some());
            hits.add(f64::from(u8::from(hit)));
            let d = surface.d(Vec3::lift((viewer() + w).normalize()));
            if hit { d.eps[0] / d.re } else { 0.0 }
        });
        let (share, slope) = (exact.re, exact.eps[0]);
        fig.check(
            format!(
                "alpha {alpha}: the area within the lamp's outline is the share of rays that hit it"
            ),
            hits.z(share).abs() < limit,
            format!(
                "{share:.5} and {:.5} ± {:.5}, limit {limit:.2} of these",
                hits.mean,
                hits.of_mean().se
            ),
        );
        fig.check(
            format!("alpha {alpha}: its derivative, by motion of the outline alone, is the detached estimate"),
            detached.z(slope).abs() < limit && detached.z(0.0).abs() > 8.0,
            format!(
                "{slope:.5} and {:.5} ± {:.5}; attached samples that ignore the edge find 0",
                detached.mean,
                detached.of_mean().se
            ),
        );
    }
}

/// Light from the direction that `direction` makes of a place in [0, 1]^2, row 0 at the top; black where it
/// makes none.
fn picture(
    scene: &Scene,
    (size, spp): (usize, u64),
    direction: impl Fn([f64; 2]) -> Option<Vec3<f64>> + Sync,
) -> Result<Image> {
    let rows: Vec<Vec<f32>> = (0..size)
        .into_par_iter()
        .map(|y| {
            let row = (0..size).map(|x| {
                let place = [x as f64 + 0.5, (size - 1 - y) as f64 + 0.5].map(|c| c / size as f64);
                let Some(w) = direction(place) else {
                    return Ok([0.0; 3]);
                };
                let stream = (y * size + x) as u64;
                let light = radiance(scene, |_| ray(w), 4, SEED, stream, 0..spp);
                Ok(light.map_err(|e| e.to_string())?.total)
            });
            let row = row.collect::<std::result::Result<Vec<_>, String>>()?;
            Ok(row.into_iter().flatten().map(|c| c as f32).collect())
        })
        .collect::<std::result::Result<_, String>>()?;
    let mut image = Image::new(size, size);
    image.data = rows.concat();
    Ok(image)
}

/// Size of the pictures.
const SIDE: usize = 480;

/// A picture, enlarged so that lines can be drawn over it.
fn panel(label: &str, image: &Image) -> Panel {
    // To a size that the small and the large one divide, or nearly.
    Panel::tonemapped(label, image, 0.8).enlarged((SIDE / image.width).max(1))
}

/// Where a place in [0, 1]^2 is in a panel of an image that is `size` wide.
fn position(size: usize, [u, v]: [f64; 2]) -> [f64; 2] {
    let side = (size * (SIDE / size).max(1)) as f64;
    [u * side, (1.0 - v) * side]
}

/// Lines between neighbouring points, not across gaps.
fn outline(panel: &mut Panel, points: &[[f64; 2]], colour: [u8; 3]) {
    let next = points.iter().cycle().skip(1);
    for (a, b) in points.iter().zip(next) {
        if (a[0] - b[0]).hypot(a[1] - b[1]) < 24.0 {
            panel.line(*a, *b, colour);
            panel.line([a[0] + 1.0, a[1]], [b[0] + 1.0, b[1]], colour);
        }
    }
}

/// The hemisphere from above.
fn hemisphere(scene: &Scene, (size, spp): (usize, u64), edges: &[Edge]) -> Result<Panel> {
    let image = picture(scene, (size, spp), |place| {
        let [x, y] = place.map(|c| 2.0 * c - 1.0);
        let squared = 1.0 - x * x - y * y;
        (squared > 0.0).then(|| Vec3::new(x, y, squared.sqrt()))
    })?;
    let mut panel = panel("directions, from above", &image);
    for edge in edges {
        let place = |w: &Vec3<f64>| position(size, [w.x, w.y].map(|c| 0.5 * (c + 1.0)));
        let points: Vec<_> = edge.directions.iter().map(place).collect();
        outline(&mut panel, &points, edge.colour);
    }
    Ok(panel)
}

/// The hemisphere over random numbers, with the motion of the edges.
fn square(scene: &Scene, (size, spp): (usize, u64), edges: &[Edge], alpha: f64) -> Result<Panel> {
    let image = picture(scene, (size, spp), |u| {
        let w = sample(u, alpha);
        (w.z > 0.0).then_some(w)
    })?;
    let mut panel = panel(&format!("random numbers, alpha = {alpha}"), &image);
    for edge in edges {
        let ends = edge.directions.iter().map(|&w| {
            let u = preimage(w, alpha);
            // As far as edges would get if roughness grew by 0.15 at this speed.
            let to = u.map(|u| u.re + 0.15 * u.eps[0]);
            [u.map(|u| u.re), to].map(|p| position(size, p))
        });
        let ends: Vec<_> = ends.collect();
        let points: Vec<_> = ends.iter().map(|e| e[0]).collect();
        outline(&mut panel, &points, edge.colour);
        for [from, to] in ends.into_iter().step_by(40) {
            arrow(&mut panel, from, to);
        }
    }
    Ok(panel)
}

fn arrow(panel: &mut Panel, from: [f64; 2], to: [f64; 2]) {
    let yellow = [255, 240, 60];
    panel.line(from, to, yellow);
    let angle = (to[1] - from[1]).atan2(to[0] - from[0]);
    for turn in [2.6, -2.6] {
        let (sin, cos) = (angle + turn).sin_cos();
        panel.line(to, [to[0] + 6.0 * cos, to[1] + 6.0 * sin], yellow);
    }
}
