//! Caustics by paths and by particles: the same light, the same derivatives, less noise.

use render::Job;
use render::instances::{Direction, Estimator};
use render::integrator::render::Rendering;
use render::sampler::Points;
use render::scene::Caustics;
use render::shape::Cylinder;
use render::statistics::Estimate;
use render::{RenderError, Scene, Settings};

use super::two_ways::{noise_over_time, panels, series};
use crate::statistics::{check_same, gradients};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View};

const SEED: u64 = 96;
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;
/// Parameters by which images are differentiated, and what they are in the scene.
const PARAMS: [(&str, &str); 3] = [
    ("ring.alpha.value", "roughness of the ring"),
    ("table.reflectance.value", "albedo of the table"),
    ("lamp.emitter.radiance.value", "emission"),
];
/// Roughness of the ring, except where it is varied.
const ALPHA: f64 = 0.05;
/// Angle of view, degrees.
const FOV: f64 = 40.0;

/// A ring of gold on a table, before a wall, under a small lamp.
fn ring(size: u32, alpha: f64, fov: f64) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let table = builder.matt("table", [0.7, 0.68, 0.65])?;
    let wall = builder.matt("wall", [0.45, 0.5, 0.6])?;
    let black = builder.matt("black", [0.0; 3])?;
    let gold = builder.metal("ring", [0.95, 0.75, 0.4], alpha)?;
    let (x, y) = ([8.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
    builder.quad("table", [[-4.0, 0.0, 3.0], x, [0.0, 0.0, -5.0]], &table)?;
    builder.quad("wall", [[-4.0, 0.0, -2.0], x, y], &wall)?;
    let band = Cylinder::new([0.0, 0.0, 0.0], [0.0, 0.5, 0.0], 1.0, false);
    builder.shape("ring", band.ok_or("a ring without size")?, &gold);
    // Its front is below.
    let edges = [[0.3, 0.0, 0.0], [0.0, 0.0, 0.3]];
    let lamp = builder.quad("lamp", [[1.6, 2.4, 1.2], edges[0], edges[1]], &black)?;
    builder.lamp("lamp", lamp, [60.0, 57.0, 52.0])?;
    let view = View {
        eye: [0.0, 3.2, 3.6],
        target: [0.0, 0.1, 0.0],
        fov,
        size: [size; 2],
    };
    builder.finish(&view, 6)
}

fn settings(scene: &Scene, caustics: Caustics) -> Settings {
    Settings {
        points: Points::Sobol,
        caustics,
        ..scene.settings
    }
}

/// Derivatives of the mean of the image in all [`PARAMS`], summed over channels, from `runs` runs, and
/// seconds per run.
fn derivatives(
    scene: &Scene,
    e: Estimator,
    caustics: Caustics,
    spp: u64,
    runs: u64,
) -> Result<([Estimate; 3], f64)> {
    let names = PARAMS.map(|(name, _)| name);
    let settings = settings(scene, caustics);
    let (each, seconds) = gradients(scene, e, &settings, &names, SEED, spp, runs)?;
    Ok(([each[0], each[1], each[2]], seconds))
}

/// The image and its derivative in the ring's roughness, by the differential pair.
fn images(
    scene: &Scene,
    caustics: Caustics,
    seed: u64,
    spp: u64,
) -> std::result::Result<Rendering, RenderError> {
    let along = [Direction::uniform(scene.params(), PARAMS[0].0)?];
    let settings = settings(scene, caustics);
    let (e, values) = (Estimator::DifferentialMis, scene.params().values());
    e.forward_f32(
        &Job::new(scene, &settings, seed, 0..spp, &()),
        values,
        &along,
    )
}

/// `caustic-ring`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    fig.note("seed", SEED);
    same(fig)?;
    pictures(fig)?;
    clock(fig)?;
    sweeps(fig)
}

/// Checks that paths and particles have the same expectation in every block of pixels.
fn same(fig: &mut Figure) -> Result {
    let (size, runs, spp) = (32, 64, fig.pick(64, 128));
    let scene = ring(size, 0.1, FOV)?;
    let by = |caustics, seed: u64| {
        series(size, runs, spp, |run| {
            images(&scene, caustics, seed + run, spp)
        })
    };
    let paths = by(Caustics::Paths, SEED)?;
    let particles = by(Caustics::Particles, 10 * SEED)?;
    let statements = [
        "(a) the same picture, whoever finds caustics",
        "(b) the same derivative in roughness, whoever finds caustics",
    ];
    check_same(fig, &statements, [&paths, &particles], runs, LEVEL);
    Ok(())
}

/// Pictures by paths and by particles, from the same small number of samples.
fn pictures(fig: &mut Figure) -> Result {
    let (size, spp) = fig.pick((128, 16), (384, 64));
    let scene = ring(size, ALPHA, FOV)?;
    let mut found = Vec::new();
    for (name, caustics) in Caustics::NAMES.into_iter().rev() {
        let labels = [
            format!("caustics by {name}"),
            format!("change with roughness, by {name}"),
        ];
        found.push((labels, images(&scene, caustics, SEED, spp)?));
    }
    fig.images("caustics", 2, &panels(&found, spp));
    Ok(())
}

/// Error of the derivatives against time, at growing numbers of samples.
fn clock(fig: &mut Figure) -> Result {
    let (size, runs) = fig.pick((32, 16), (48, 24));
    let scene = ring(size, ALPHA, FOV)?;
    let contestants = [
        ("mis-balance", Estimator::MisBalance),
        ("differential-mis", Estimator::DifferentialMis),
    ];
    let ladder: Vec<u64> = (4..fig.pick(8, 9)).map(|k| 1 << k).collect();
    let mut charts: Vec<LineChart> = (PARAMS.iter())
        .map(|(_, what)| noise_over_time(what, "seconds"))
        .collect();
    let mut rows = Vec::new();
    for (name, e) in contestants {
        for (who, caustics) in Caustics::NAMES {
            let mut lines: [Vec<(f64, f64)>; 3] = Default::default();
            for &spp in &ladder {
                let (found, seconds) = derivatives(&scene, e, caustics, spp, runs)?;
                for ((line, g), (_, what)) in lines.iter_mut().zip(&found).zip(PARAMS) {
                    let deviation = g.se * (runs as f64).sqrt();
                    line.push((seconds, deviation));
                    rows.push([
                        name.to_owned(),
                        who.to_owned(),
                        what.to_owned(),
                        spp.to_string(),
                        seconds.to_string(),
                        g.mean.to_string(),
                        deviation.to_string(),
                    ]);
                }
            }
            charts = (charts.into_iter().zip(lines))
                .map(|(chart, line)| chart.measured(&format!("{name}, caustics by {who}"), line))
                .collect();
        }
    }
    let header = [
        "estimator",
        "caustics by",
        "derivative in",
        "samples per pixel",
        "seconds",
        "mean",
        "std of a run",
    ];
    fig.csv_text("time", &header, rows);
    for (chart, name) in charts
        .iter()
        .zip(["time-roughness", "time-albedo", "time-emission"])
    {
        fig.chart(name, chart);
    }
    Ok(())
}

/// The gain of particles over paths, against the roughness of the ring and against the angle of view.
fn sweeps(fig: &mut Figure) -> Result {
    let (size, spp, runs) = fig.pick((32, 32, 32), (48, 64, 128));
    let alphas: &[f64] = fig.pick(&[0.02, 0.05, 0.2], &[0.01, 0.02, 0.05, 0.1, 0.2, 0.4]);
    let views: &[f64] = fig.pick(&[FOV, 10.0], &[FOV, 20.0, 10.0, 5.0]);
    let mut rows = Vec::new();
    let mut gains = |alpha: f64, fov: f64| -> Result<[f64; 3]> {
        let scene = ring(size, alpha, fov)?;
        let e = Estimator::DifferentialMis;
        let (paths, before) = derivatives(&scene, e, Caustics::Paths, spp, runs)?;
        let (particles, after) = derivatives(&scene, e, Caustics::Particles, spp, runs)?;
        let gain = |k: usize| (paths[k].se / particles[k].se).powi(2);
        let gains = [gain(0), gain(1), gain(2)];
        rows.push([alpha, fov, gains[0], gains[1], gains[2], after / before]);
        Ok(gains)
    };
    let mut by_alpha = Vec::new();
    for &alpha in alphas {
        by_alpha.push((alpha, gains(alpha, FOV)?));
    }
    let mut by_view = Vec::new();
    for &fov in views {
        by_view.push((fov, gains(ALPHA, fov)?));
    }
    let list = |of: &[(f64, [f64; 3])]| {
        let each = of
            .iter()
            .map(|(at, g)| format!("at {at}: {:.1}, {:.1}, {:.1}", g[0], g[1], g[2]));
        each.collect::<Vec<_>>().join("; ")
    };
    fig.check(
        "(c) at equal samples, however rough the ring: its derivative has less variance, those in albedo and emission \
         less than half where it is smooth, and never twice as much",
        by_alpha.iter().all(|(alpha, g)| {
            let least = if *alpha <= ALPHA { 2.0 } else { 0.5 };
            g[0] > 1.0 && g[1] > least && g[2] > least
        }),
        format!("gains in roughness, albedo, emission {}", list(&by_alpha)),
    );
    fig.check(
        "(d) however little of the scene is seen, where most particles land elsewhere: never 1.5 times the variance down \
         to 10 degrees, nor five times below",
        by_view.iter().all(|(fov, g)| {
            let least = if *fov < 10.0 { 1.0 / 5.0 } else { 1.0 / 1.5 };
            g.iter().all(|g| *g > least)
        }),
        format!("gains at angles of view {}", list(&by_view)),
    );
    let header = [
        "roughness",
        "angle of view",
        "gain: roughness",
        "gain: albedo",
        "gain: emission",
        "time: particles over paths",
    ];
    fig.csv("gains", &header, rows);
    for (name, title, x, points) in [
        (
            "gain-roughness",
            "caustics by particles: gain in variance",
            "roughness of the ring",
            &by_alpha,
        ),
        (
            "gain-view",
            "caustics by particles: gain in variance",
            "angle of view, degrees",
            &by_view,
        ),
    ] {
        let mut chart = LineChart::new(title, x, "variance of paths over that with particles")
            .log_x()
            .log_y();
        for (k, (_, what)) in PARAMS.iter().enumerate() {
            chart = chart.measured(what, points.iter().map(|(at, g)| (*at, g[k])));
        }
        fig.chart(name, &chart);
    }
    Ok(())
}
