//! Reparameterised radiative backpropagation: ten parameters in one pass, a position among them [Zeltner 2021, algorithms 4.3
//! and 4.4].

use ad_core::Dual;
use render::estimator::{AttachedWeights, Convolved, Detached, Mis, Reparameterised};
use render::film::PixelFilter;
use render::instances::{Estimator, render_f64};
use render::integrator::gradient::{Active, backward};
use render::integrator::render::render;
use render::params::{Tangent, Theta};
use render::sampler::Spread;
use render::statistics::{Estimate, z_limit};
use render::{Job, Scene};

use super::propagation::memory_stays;
use crate::common_scenes::{below_lamp, lamp_above_floor};
use examples::figure::{Figure, Result};
use examples::scene_builder::SceneBuilder;

const SEED: u64 = 4304;
const NAMES: [&str; 4] = [
    "floor.reflectance.value",
    "ball.alpha.value",
    "lamp.emitter.radiance.value",
    "ball.translation",
];
const LABELS: [&str; 10] = [
    "albedo r",
    "albedo g",
    "albedo b",
    "roughness",
    "emission r",
    "emission g",
    "emission b",
    "x",
    "y",
    "z",
];
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;
/// What the kernel may change of a derivative in a position, relative to the largest of them.
const KERNEL: f64 = 0.02;

type Follows = Convolved<Mis<Reparameterised, Detached, AttachedWeights>>;

/// A glossy ball above a floor, below a lamp.
fn scene(size: u32) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let metal = builder.metal("ball", [0.9, 0.8, 0.7], 0.4)?;
    builder.ball("ball", [0.2, 1.1, 0.3], 0.6, &metal)?;
    lamp_above_floor(&mut builder, [0.6, 0.5, 0.4], 0.1)?;
    let mut scene = builder.finish(&below_lamp(size), 3)?;
    // The sensor counts once (errata Z-4.15): a box would hide it.
    scene.film.filter = PixelFilter::Gaussian { stddev: 0.5 };
    scene.make_movable(&["ball.translation"])?;
    Ok(scene)
}

/// Weights of pixels and channels: the adjoint image.
fn weights(scene: &Scene) -> Vec<f32> {
    let n = scene.film.pixels() * 3;
    let weight = |i: usize| (1.0 + 0.5 * (0.37 * i as f64).sin()) / n as f64;
    (0..n).map(|i| weight(i) as f32).collect()
}

fn wide(scene: &Scene) -> Vec<f64> {
    scene.params().values().iter().map(|&v| v.into()).collect()
}

fn reverse(scene: &Scene, seed: u64, spp: u64) -> Result<Vec<f64>> {
    let values = wide(scene);
    let active = Active::seen_by::<Follows, _>(scene, &NAMES)?;
    let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
    let theta = Theta::constant(&values);
    let found = backward::<f64, Follows, Spread>(&job, &theta, &active, &weights(scene))?;
    Ok(found.values.concat())
}

fn against(scene: &Scene, sums: &[f64], spp: u64) -> f64 {
    let products = sums.iter().zip(weights(scene));
    products.map(|(s, w)| s * f64::from(w)).sum::<f64>() / spp as f64
}

fn forward(scene: &Scene, seed: u64, spp: u64) -> Result<Vec<f64>> {
    type R = Dual<f64, 1>;
    let values = wide(scene);
    let mut out = Vec::new();
    for name in NAMES {
        let info = scene.params().find(name)?;
        for i in 0..info.shape.len() {
            let mut tangents = vec![Tangent::None; scene.params().infos().len()];
            let unit = |k| R::new(0.0, [f64::from(u8::from(k == i))]);
            let id = scene.params().handle(info).id as usize;
            tangents[id] = Tangent::Dense((0..info.shape.len()).map(unit).collect());
            let theta = Theta::<R>::with_tangents(&values, &tangents);
            let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
            let found = render::<R, Follows, Spread>(&job, &theta)?;
            out.push(against(scene, &found.sums[1], spp));
        }
    }
    Ok(out)
}

/// Central differences, of images with common random numbers.
fn differences(scene: &mut Scene, seed: u64, spp: u64) -> Result<Vec<f64>> {
    let start = scene.params().values().to_vec();
    let mut out = Vec::new();
    for name in NAMES {
        for i in scene.params().find(name)?.range() {
            let h = if name == NAMES[2] { 0.5 } else { 1.0 / 32.0 };
            let mut at = |by: f32| -> Result<f64> {
                let mut values = start.clone();
                values[i] += by;
                scene.set_params(&values)?;
                let values = wide(scene);
                let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
                let shot = render_f64(&job, &Theta::constant(&values), Estimator::Mis);
                Ok(against(scene, &shot.sums[0], spp))
            };
            let found = (at(h)? - at(-h)?) / (2.0 * f64::from(h));
            out.push(found);
        }
    }
    scene.set_params(&start)?;
    Ok(out)
}

fn estimates(runs: &[Vec<f64>]) -> Vec<Estimate> {
    (0..LABELS.len())
        .map(|i| Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>()))
        .collect()
}

/// `zeltner-alg-4-3`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let mut scene = scene(16)?;
    let (runs, spp): (u64, u64) = (12, fig.pick(32, 512));
    fig.note("runs", runs);
    fig.note("samples per pixel and run", spp);
    fig.note("seed", SEED);

    let pulled = reverse(&scene, SEED, 4)?;
    let pushed = forward(&scene, SEED, 4)?;
    let pairs = pulled.iter().zip(&pushed);
    let off = pairs
        .map(|(a, b)| (a - b).abs() / b.abs())
        .fold(0.0, f64::max);
    fig.check(
        "one reverse pass equals ten forward passes with the same seeds: 1e-9 in f64",
        off < 1e-9 && pulled.len() == LABELS.len(),
        format!("largest relative difference {off:.1e}"),
    );

    let many: Result<Vec<_>> = (0..runs)
        .map(|k| reverse(&scene, SEED + 100 + k, spp))
        .collect();
    let found = estimates(&many?);
    let more = fig.pick(2, 4) * spp;
    let many: Result<Vec<_>> = (0..runs)
        .map(|k| differences(&mut scene, SEED + 200 + k, more))
        .collect();
    let expected = estimates(&many?);
    let most = z_limit(LABELS.len(), runs, LEVEL);
    let largest = expected[7..]
        .iter()
        .fold(0.0, |m: f64, e| m.max(e.mean.abs()));
    for (i, (a, b)) in found.iter().zip(&expected).enumerate() {
        let allowed = if i < 7 { 0.0 } else { KERNEL * largest };
        let error = a.se.hypot(b.se);
        let off = ((a.mean - b.mean).abs() - allowed).max(0.0) / error;
        fig.check(
            format!("{}: equals finite differences", LABELS[i]),
            off < most,
            format!(
                "{:.5} +- {:.5}, differences {:.5} +- {:.5}, limit {most:.2} standard errors",
                a.mean, a.se, b.mean, b.se
            ),
        );
    }
    let rows = found.iter().zip(&expected);
    let rows = rows.map(|(a, b)| [a.mean, a.se, b.mean, b.se]);
    let names = ["derivative", "error", "differences", "error of differences"];
    fig.csv("derivatives", &names, rows);

    let ladder: &[u64] = fig.pick(&[64, 128, 256], &[64, 512, 4096]);
    let small = self::scene(8)?;
    memory_stays(fig, ladder, |spp| {
        let gradient = reverse(&small, SEED, spp);
        gradient.map(|_| ()).map_err(|e| e.to_string())
    })?;
    Ok(())
}
