//! Rays that follow what they have met, and the smooth field that a few of them make [Zeltner 2021, figure 4.7].
//!
//! The first part is about the library's shapes: a point that stays on the material as that moves, against the intersection of
//! a ray that stays. The second one is about numbers of auxiliary rays: a ball turns about the viewer, and the derivative of
//! an integral over the sky that it leaves free is the divergence of a field of velocities, by neighbours of directions.
//! The quotient of two estimates, as it is printed, is far from its limit; the expectation of the quotient as the field is not.

use std::f64::consts::{PI, TAU};

use ad_core::{Dual, Vec3};
use rayon::prelude::*;
use render::Scene;
use render::integrator::convolved::field::{
    Influence, LARGEST, Neighbour, boundary_test, convolve,
};
use render::math::Frame;
use render::params::{Tangent, Theta};
use render::sampler::{Independent, Points, Sampler};
use render::shape::SurfaceCoordinates;
use render::statistics::{Estimate, z_limit};

use examples::chart::LineChart;
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View};

const SEED: u64 = 47;
const KAPPA: f64 = 1e4;
/// Angular radius of the ball.
const RADIUS: f64 = 0.3;
/// Independent runs.
const RUNS: u64 = 12;
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;

type R = Dual<f64, 1>;

/// A box, a ball and a turned piece, which move as parameters say.
fn things() -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let grey = builder.matt("grey", [0.5; 3])?;
    builder.block("block", [-1.2, 0.0, 0.0], [0.5, 0.4, 0.3], 30.0, &grey)?;
    builder.ball("ball", [0.0, 0.1, 0.0], 0.5, &grey)?;
    builder.turned(
        "piece",
        &[[0.0, -0.5], [0.4, -0.4], [0.2, 0.1], [0.0, 0.5]],
        [1.2, 0.0, 0.0],
        &grey,
    )?;
    builder.ambient([1.0; 3])?;
    let view = View {
        eye: [0.0, 0.8, 4.0],
        target: [0.0; 3],
        fov: 30.0,
        size: [48, 24],
    };
    let mut scene = builder.finish(&view, 1)?;
    scene.make_movable(&NAMES)?;
    Ok(scene)
}

const NAMES: [&str; 6] = [
    "block.translation",
    "block.rotation",
    "ball.translation",
    "ball.scale",
    "piece.rotation",
    "piece.vertex_positions",
];

/// The direction from the camera to the point of the material with these coordinates.
fn direction<S: ad_core::Real<Primal = f64>>(
    scene: &Scene,
    theta: &Theta<S>,
    prim: u32,
    at: SurfaceCoordinates<f64>,
) -> Vec3<S> {
    let p = scene
        .point_at(theta, prim, SurfaceCoordinates::<S>::lift(at))
        .p;
    (p - Vec3::lift(Vec3::from(scene.camera.origin()))).normalize()
}

/// Rays that follow, against differences, and against intersections of rays that stay.
fn rays_that_follow(fig: &mut Figure) -> Result {
    let mut scene = things()?;
    let [width, height] = scene.film.crop_size;
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
    let mut met = Vec::new();
    for [x, y] in pixels {
        let ray = scene.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
        if let Some(hit) = scene.intersect(&ray) {
            let at = scene.coordinates(hit.prim, &hit.si);
            met.push((ray, hit.prim, at));
        }
    }
    let start = scene.params().values().to_vec();
    let wide: Vec<f64> = start.iter().map(|&v| v.into()).collect();
    let (mut worst, mut across, mut fastest) = (0.0f64, 0.0f64, 0.0f64);
    for name in NAMES {
        let info = scene.params().find(name)?.clone();
        let along: Vec<f64> = (0..info.shape.len())
            .map(|i| (1.0 + i as f64).sin())
            .collect();
        let mut tangents = vec![Tangent::None; scene.params().infos().len()];
        let id = scene.params().handle(&info).id as usize;
        tangents[id] = Tangent::Dense(along.iter().map(|d| R::new(0.0, [*d])).collect());
        let theta = Theta::<R>::with_tangents(&wide, &tangents);
        let velocity = |v: Vec3<R>| Vec3::new(v.x.eps[0], v.y.eps[0], v.z.eps[0]);
        let followed: Vec<Vec3<f64>> = (met.iter())
            .map(|(_, prim, at)| velocity(direction(&scene, &theta, *prim, *at)))
            .collect();
        for (ray, ..) in &met {
            let moving = render::math::Ray::lift(*ray);
            if let Some(hit) = scene.intersect_moving::<R>(&theta, &moving) {
                let v = velocity(hit.si.p);
                across = across.max((v - ray.d * ray.d.dot(v)).length());
            }
        }
        let h = 1.0 / 256.0;
        let mut shifted = |sign: f64| -> Result<Vec<Vec3<f64>>> {
            let mut values = start.clone();
            for (v, d) in values[info.range()].iter_mut().zip(&along) {
                *v += (sign * h * d) as f32;
            }
            scene.set_params(&values)?;
            let still = Theta::<f64>::still();
            Ok(met
                .iter()
                .map(|(_, prim, at)| direction(&scene, &still, *prim, *at))
                .collect())
        };
        let (plus, minus) = (shifted(1.0)?, shifted(-1.0)?);
        for ((f, p), m) in followed.iter().zip(&plus).zip(&minus) {
            worst = worst.max((*f - (*p - *m) * (0.5 / h)).length());
            fastest = fastest.max(f.length());
        }
        scene.set_params(&start)?;
    }
    fig.check(
        "directions towards constant points of the material move as differences say",
        worst < 1e-3 * fastest,
        format!(
            "largest error {worst:.1e}, fastest {fastest:.2}, {} rays",
            met.len()
        ),
    );
    fig.check(
        "the intersection with a ray that stays has no velocity across it",
        across < 1e-9 * fastest,
        format!("largest {across:.1e}"),
    );
    Ok(())
}

/// How the divergence is estimated.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    /// As the library does.
    Expectation,
    /// The quotient and its derivative, with the boundary test by distance and this power [Zeltner 2021, Eqs. 4.23, 4.24].
    Quotient(i32),
}

/// The quotient of estimates by the same neighbours, differentiated as if they stayed.
fn quotient(w: Vec3<f64>, neighbours: &[(Neighbour, f64)], power: i32, out: &mut Vec<Influence>) {
    let power_of = f64::from(power);
    let terms: Vec<(f64, Vec3<f64>)> = (neighbours.iter())
        .map(|(n, distance)| {
            let away = (n.d - w).length_squared() / 2.0;
            let rise = (KAPPA * away).exp();
            let base = (distance + rise - 1.0).max(1e-12);
            let across = n.d - w * w.dot(n.d);
            (
                rise * base.powi(-power),
                across * (power_of * KAPPA * rise / base),
            )
        })
        .collect();
    let total: f64 = terms.iter().map(|(c, _)| c).sum();
    let slopes = terms
        .iter()
        .fold(Vec3::zero(), |sum, (c, g)| sum + *g * (c / total));
    out.clear();
    out.extend(terms.iter().map(|(c, g)| Influence {
        share: c / total,
        divergence: (*g - slopes - w * 2.0) * (c / total),
    }));
}

/// The velocity of the turning ball's material.
fn speed(d: Vec3<f64>) -> Vec3<f64> {
    Vec3::new(-d.y, d.x, 0.0)
}

/// Velocity field and divergence at a direction.
fn field(w: Vec3<f64>, way: Way, rays: usize, sampler: &mut Independent) -> (Vec3<f64>, f64) {
    let frame = Frame::from_normal(w);
    let neighbours: Vec<(Neighbour, f64)> = (0..rays)
        .map(|_| {
            let n = Neighbour::sample(&frame, KAPPA, sampler.next_2d());
            let inside = RADIUS - n.d.x.min(1.0).acos();
            let test = match way {
                Way::Expectation if inside > 0.0 => boundary_test(KAPPA, inside),
                Way::Expectation => LARGEST,
                Way::Quotient(_) if inside > 0.0 => inside,
                Way::Quotient(_) => 1.0,
            };
            (n, test)
        })
        .collect();
    let mut influences = Vec::new();
    match way {
        Way::Expectation => convolve(w, KAPPA, &neighbours, &mut influences),
        Way::Quotient(power) => quotient(w, &neighbours, power, &mut influences),
    }
    let (mut v, mut divergence) = (Vec3::zero(), 0.0);
    for ((n, _), i) in neighbours.iter().zip(&influences) {
        if n.d.x > RADIUS.cos() {
            v += speed(n.d) * i.share;
            divergence += i.divergence.dot(speed(n.d));
        }
    }
    (v - w * w.dot(v), divergence)
}

/// The derivative of the integral of `y` over the free sky, in units of the true one.
fn derivative(way: Way, rays: usize, run: u64, samples: u64) -> f64 {
    // Beyond, there is hardly a neighbour on the ball.
    let [most, least] = [RADIUS, RADIUS + 7.0 / KAPPA.sqrt()].map(f64::cos);
    let mut sum = 0.0;
    for i in 0..samples {
        let mut sampler = Independent::spread(Points::Independent, SEED + run, rays as u64, i);
        let [u, v]: [f64; 2] = sampler.next_2d();
        let x = least + (most - least) * u;
        let (sin, cos) = (TAU * v).sin_cos();
        let r = (1.0 - x * x).sqrt();
        let w = Vec3::new(x, r * cos, r * sin);
        let (v, divergence) = field(w, way, rays, &mut sampler);
        sum += v.y + w.y * divergence;
    }
    sum / samples as f64 * TAU * (most - least) / (-PI * RADIUS.sin().powi(2))
}

/// `zeltner-4-7`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    rays_that_follow(fig)?;

    let samples = fig.pick(4000, 50_000);
    fig.note("directions per run", samples);
    fig.note("runs", RUNS);
    fig.note("kappa", KAPPA);
    let counts = [2usize, 4, 8, 16, 32, 64];
    let ways = [Way::Expectation, Way::Quotient(3), Way::Quotient(1)];
    let found = ways.map(|way| {
        counts.map(|rays| {
            let runs: Vec<f64> = (0..RUNS)
                .into_par_iter()
                .map(|run| derivative(way, rays, run, samples))
                .collect();
            Estimate::of(&runs)
        })
    });
    let most = z_limit(1, RUNS, LEVEL);
    let [ours, third, first] = &found;
    let list = |e: &[Estimate; 6]| {
        let texts = counts
            .iter()
            .zip(e)
            .map(|(n, e)| format!("{n}: {:.3} +- {:.3}", e.mean, e.se));
        texts.collect::<Vec<_>>().join(", ")
    };
    fig.check(
        "the expectation of the quotient as the field: right from eight neighbours on, within 3 %",
        ours[2..]
            .iter()
            .all(|e| (e.mean - 1.0).abs() < 0.03 + most * e.se),
        list(ours),
    );
    fig.check(
        "the quotient as printed, with power 3: at 16 neighbours a twentieth or more is missing, and less for more of them",
        1.0 - third[3].mean > 0.05 + most * third[3].se && third[5].mean > third[2].mean,
        list(third),
    );
    fig.check(
        "with the printed power 1, 64 neighbours do not help",
        1.0 - first[5].mean > 0.1 + most * first[5].se,
        list(first),
    );

    // The field itself, along the way out of the ball.
    let profile = |way: Way| -> Vec<(f64, f64)> {
        let each = |i: u64| {
            let distance = (i as f64 + 0.5) / 40.0 * 5.0 / KAPPA.sqrt();
            let angle = RADIUS + distance;
            let w = Vec3::new(angle.cos(), angle.sin(), 0.0);
            let out = Vec3::new(-angle.sin(), angle.cos(), 0.0);
            let repeats = samples / 10;
            let sum: f64 = (0..repeats)
                .map(|k| {
                    let mut sampler = Independent::spread(Points::Independent, SEED, i, k);
                    field(w, way, 16, &mut sampler).0.dot(out)
                })
                .sum();
            (distance * KAPPA.sqrt(), sum / repeats as f64)
        };
        (0..40).into_par_iter().map(each).collect()
    };
    let profiles = ways.map(profile);
    let near = profiles[0][0].1;
    fig.check(
        "next to the outline the field has its velocity",
        (near - 1.0).abs() < 0.02,
        format!("{near:.3} of it"),
    );
    let chart = LineChart::new(
        "A field of velocities beyond an outline, by 16 neighbours",
        "distance, in widths of the kernel",
        "part of the outline's velocity",
    )
    .line("expectation", profiles[0].clone())
    .line("quotient, power 3", profiles[1].clone())
    .dashed("quotient, power 1", profiles[2].clone());
    fig.chart("field", &chart);
    let points = |e: &[Estimate; 6]| {
        counts
            .map(|n| n as f64)
            .into_iter()
            .zip(e.map(|e| e.mean))
            .collect::<Vec<_>>()
    };
    let chart = LineChart::new(
        "A derivative by the divergence of the field",
        "neighbours",
        "part of the true one",
    )
    .log_x()
    .line("expectation", points(ours))
    .line("quotient, power 3", points(third))
    .dashed("quotient, power 1", points(first));
    fig.chart("neighbours", &chart);
    let rows = (0..counts.len()).map(|i| {
        let [a, b, c] = [ours[i], third[i], first[i]];
        [counts[i] as f64, a.mean, a.se, b.mean, b.se, c.mean, c.se]
    });
    let names = [
        "neighbours",
        "expectation",
        "error",
        "power 3",
        "error 3",
        "power 1",
        "error 1",
    ];
    fig.csv("neighbours", &names, rows);
    Ok(())
}
