//! Guided paths: what light through water gains from knowing where it comes from.

use std::time::Instant;

use render::Job;
use render::auto;
use render::instances::{Direction, Estimator};
use render::integrator::render::Rendering;
use render::sampler::Points;
use render::shape::Mesh;
use render::statistics::z_limit;
use render::{RenderError, Scene, Settings};

use super::two_ways::{noise_over_time, panels, series};
use crate::statistics::{check_same, gradients};
use crate::veach::pool::{water, waves};
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View};

const SEED: u64 = 1312;
const E: Estimator = Estimator::MisBalance;
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;
/// Parameters by which images are differentiated, and what they are in the scene.
const PARAMS: [(&str, &str); 2] = [
    ("floor.reflectance.value", "albedo of the floor"),
    ("lamp.emitter.radiance.value", "emission"),
];
/// How directions are sampled, and whether that is guided.
const WAYS: [(&str, bool); 2] = [("by the material", false), ("guided", true)];

/// A basin of water with waves, below a small lamp.
fn basin(size: u32) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let floor = builder.matt("floor", [0.6, 0.7, 0.72])?;
    let side = builder.matt("side", [0.5, 0.45, 0.4])?;
    let black = builder.matt("black", [0.0; 3])?;
    let (x, y, z) = ([2.0, 0.0, 0.0], [0.0, 1.1, 0.0], [0.0, 0.0, 2.0]);
    let minus = |v: [f64; 3]| v.map(|c| -c);
    builder.quad("floor", [[-1.0, -1.0, 1.0], x, minus(z)], &floor)?;
    builder.quad("back", [[-1.0, -1.0, -1.0], x, y], &side)?;
    builder.quad("front", [[1.0, -1.0, 1.0], minus(x), y], &side)?;
    builder.quad("left", [[-1.0, -1.0, 1.0], minus(z), y], &side)?;
    builder.quad("right", [[1.0, -1.0, -1.0], z, y], &side)?;
    let water = water(&mut builder, 1.0)?;
    builder.shape("water", Mesh::new(waves(128, 0.016), false)?, &water);
    // Its front is below.
    let edges = [[0.4, 0.0, 0.0], [0.0, 0.0, 0.4]];
    let lamp = builder.quad("lamp", [[2.0, 2.6, -0.6], edges[0], edges[1]], &black)?;
    builder.lamp("lamp", lamp, [140.0, 128.0, 112.0])?;
    let view = View {
        eye: [0.0, 3.4, 1.0],
        target: [0.0, -0.7, -0.08],
        fov: 30.0,
        size: [size; 2],
    };
    let mut scene = builder.finish(&view, 6)?;
    scene.settings.rr_depth = 100;
    Ok(scene)
}

fn settings(scene: &Scene) -> Settings {
    Settings {
        points: Points::Sobol,
        ..scene.settings
    }
}

/// Trains the guiding distributions, and returns the seconds that it took.
fn learn(scene: &mut Scene) -> Result<f64> {
    let (start, settings) = (Instant::now(), settings(scene));
    if auto::guide(scene, &settings, SEED, &()) {
        Ok(start.elapsed().as_secs_f64())
    } else {
        Err("light that meets something diffuse".into())
    }
}

/// The image and its derivative in the floor's albedo.
fn images(scene: &Scene, seed: u64, spp: u64) -> std::result::Result<Rendering, RenderError> {
    let along = [Direction::uniform(scene.params(), PARAMS[0].0)?];
    E.forward_f32(
        &Job::new(scene, &settings(scene), seed, 0..spp, &()),
        scene.params().values(),
        &along,
    )
}

/// `guided-pool`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    fig.note("seed", SEED);
    same(fig)?;
    pictures(fig)?;
    clock(fig)?;
    room(fig)
}

/// Checks that guided and plain paths have the same expectation in every block of pixels.
fn same(fig: &mut Figure) -> Result {
    let (size, runs, spp) = (32, 64, fig.pick(64, 256));
    let mut scene = basin(size)?;
    let of =
        |scene: &Scene, seed: u64| series(size, runs, spp, |run| images(scene, seed + run, spp));
    let plain = of(&scene, SEED)?;
    learn(&mut scene)?;
    let guided = of(&scene, 10 * SEED)?;
    let statements = [
        "(a) the same picture, guided or not",
        "(b) the same derivative in the floor's albedo, guided or not",
    ];
    check_same(fig, &statements, [&plain, &guided], runs, LEVEL);
    Ok(())
}

/// Pictures by guided and by plain paths, from the same small number of samples.
fn pictures(fig: &mut Figure) -> Result {
    let (size, spp) = fig.pick((128, 16), (384, 64));
    let mut scene = basin(size)?;
    let plain = images(&scene, SEED, spp)?;
    learn(&mut scene)?;
    let guided = images(&scene, SEED, spp)?;
    let found = [(guided, "guided"), (plain, "by the material")].map(|(r, name)| {
        let labels = [
            format!("paths {name}"),
            format!("change with the floor's albedo, {name}"),
        ];
        (labels, r)
    });
    fig.images("pool", 2, &panels(&found, spp));
    Ok(())
}

/// Error of the derivatives against time, learning included, at growing numbers of samples.
fn clock(fig: &mut Figure) -> Result {
    let (size, runs) = fig.pick((64, 16), (128, 24));
    let ladder: Vec<u64> = (fig.pick(3, 4)..fig.pick(6, 8)).map(|k| 1 << k).collect();
    let names = PARAMS.map(|(name, _)| name);
    let mut lines = vec![[Vec::new(), Vec::new()]; PARAMS.len()];
    let mut rows = Vec::new();
    let mut scene = basin(size)?;
    for (way, (name, guided)) in WAYS.into_iter().enumerate() {
        let learning = if guided { learn(&mut scene)? } else { 0.0 };
        for &spp in &ladder {
            let (found, seconds) =
                gradients(&scene, E, &settings(&scene), &names, SEED, spp, runs)?;
            for ((line, g), (_, what)) in lines.iter_mut().zip(&found).zip(PARAMS) {
                let deviation = g.se * (runs as f64).sqrt();
                line[way].push((seconds + learning, deviation));
                rows.push([
                    name.to_owned(),
                    what.to_owned(),
                    spp.to_string(),
                    seconds.to_string(),
                    learning.to_string(),
                    g.mean.to_string(),
                    deviation.to_string(),
                ]);
            }
        }
    }
    let header = [
        "directions",
        "derivative in",
        "samples per pixel",
        "seconds",
        "seconds of learning",
        "mean",
        "std of a run",
    ];
    fig.csv_text("time", &header, rows);
    for (line, (_, what)) in lines.into_iter().zip(PARAMS) {
        let gain = |k: usize| (line[0][k].1 / line[1][k].1).powi(2);
        let gains: Vec<f64> = (0..ladder.len()).map(gain).collect();
        let mean = (gains.iter().map(|g| g.ln()).sum::<f64>() / gains.len() as f64).exp();
        let [plain, guided] = [0, 1].map(|way| line[way].last().copied().unwrap_or_default());
        fig.check(
            format!("(c) derivative in {what}: at equal samples, at most a third of the variance in the (geometric) mean"),
            mean > 3.0,
            format!(
                "gains {}; by the clock, learning included, {:.1} at {} samples per pixel",
                gains.iter().map(|g| format!("{g:.1}")).collect::<Vec<_>>().join(", "),
                plain.1.powi(2) * plain.0 / (guided.1.powi(2) * guided.0),
                ladder.last().copied().unwrap_or_default(),
            ),
        );
        let mut chart = noise_over_time(what, "seconds, learning included");
        for ((name, _), line) in WAYS.iter().zip(line) {
            chart = chart.measured(name, line);
        }
        let name = what.split(' ').next().unwrap_or_default();
        fig.chart(&format!("time-{name}"), &chart);
    }
    Ok(())
}

/// Checks that guiding gains little in a room where all points see the lamp.
fn room(fig: &mut Figure) -> Result {
    let (size, spp, runs) = fig.pick((32, 16, 32), (64, 64, 64));
    let mut scene = render::scene::room(size, size)?;
    let names = ["left.reflectance.value"];
    let (plain, before) = gradients(&scene, E, &settings(&scene), &names, SEED, spp, runs)?;
    learn(&mut scene)?;
    let (guided, after) = gradients(&scene, E, &settings(&scene), &names, SEED, spp, runs)?;
    let (gain, time) = ((plain[0].se / guided[0].se).powi(2), after / before);
    let z = plain[0].z(&guided[0]).abs();
    fig.check(
        "(d) in a room whose lamp is in sight: the same derivative in a wall's albedo",
        z < z_limit(1, runs, LEVEL),
        format!(
            "|z| {z:.2}; variance {gain:.2} times less, for {time:.2} times the time of a pass"
        ),
    );
    fig.csv("room", &["gain in variance", "time"], [[gain, time]]);
    Ok(())
}
