//! What moves, by three ways: samples of edges, directions that follow, and differences, on the clock. Blocks above a floor
//! cast shadows and move together: a few, many, and so many that each is narrower than the kernel of directions that follow.

use std::time::Instant;

use render::instances::{Estimator, render_f64};
use render::params::Theta;
use render::shape::{Mesh, MeshData};
use render::statistics::{Estimate, z_limit};
use render::{Job, Scene};

use crate::common_scenes::{below_lamp, lamp_above_floor};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};
use examples::ranks::median;
use examples::scene_builder::{SceneBuilder, picture};

const SEED: u64 = 4801;
const NAME: &str = "blocks.translation";
/// Independent runs behind every error.
const RUNS: u64 = 8;
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;
/// Step of differences, the height of the blocks being 1.2.
const STEP: f32 = 1.0 / 32.0;
/// The largest side of all blocks together.
const SPAN: f64 = 1.6;

/// Blocks per side, and what they are called.
const CASES: [(&str, u32); 3] = [("few", 1), ("many", 8), ("microscopic", 160)];

/// Flat blocks in a square grid with gaps as wide as they are, as one mesh.
fn blocks(side: u32) -> MeshData {
    let mut mesh = MeshData::default();
    let cell = SPAN / f64::from(side);
    let half = [0.25 * cell, 0.25 * cell.min(0.2), 0.25 * cell];
    const FACES: [[u32; 4]; 6] = [
        [0, 1, 3, 2],
        [4, 6, 7, 5],
        [0, 4, 5, 1],
        [2, 3, 7, 6],
        [0, 2, 6, 4],
        [1, 5, 7, 3],
    ];
    for i in 0..side * side {
        let at = |k: u32| (f64::from(k) + 0.5) * cell - 0.5 * SPAN;
        let centre = [at(i % side), 1.2, at(i / side)];
        let first = mesh.positions.len() as u32;
        for corner in 0..8u32 {
            let sign = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
            let p = [0, 1, 2].map(|k: usize| centre[k] + sign(2 - k as u32) * half[k]);
            mesh.positions.push(p.map(|x| x as f32));
        }
        for [a, b, c, d] in FACES.map(|face| face.map(|k| first + k)) {
            mesh.triangles.push([a, b, c]);
            mesh.triangles.push([a, c, d]);
        }
    }
    mesh
}

fn scene(side: u32, size: u32) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let blue = builder.matt("blue", [0.3, 0.4, 0.6])?;
    builder.shape("blocks", Mesh::new(blocks(side), true)?, &blue);
    lamp_above_floor(&mut builder, [0.6, 0.5, 0.4], 0.4)?;
    let mut scene = builder.finish(&below_lamp(size), 2)?;
    scene.make_movable(&[NAME])?;
    Ok(scene)
}

/// The derivative of the mean image as the blocks rise.
fn derivative(scene: &Scene, e: Estimator, seed: u64, spp: u64) -> Result<f64> {
    let n = scene.film.pixels() * 3;
    let adjoint = vec![1.0 / n as f32; n];
    let theta = Theta::constant(scene.params().values());
    let active = e.active(scene, &[NAME])?;
    let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
    Ok(e.backward_f32(&job, &theta, &active, &adjoint)?.values[0][1])
}

/// The same by central differences with common random numbers.
fn difference(scene: &mut Scene, seed: u64, spp: u64) -> Result<f64> {
    let start = scene.params().values().to_vec();
    let at = scene.params().find(NAME)?.offset + 1;
    let mut sides = [0.0; 2];
    for (sign, side) in [1.0, -1.0].into_iter().zip(&mut sides) {
        let mut values = start.clone();
        values[at] += sign * STEP;
        scene.set_params(&values)?;
        let wide: Vec<f64> = values.iter().map(|&v| v.into()).collect();
        let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
        let shot = render_f64(&job, &Theta::constant(&wide), Estimator::Mis);
        *side = shot.mean(0).iter().sum::<f64>() / 3.0;
    }
    scene.set_params(&start)?;
    Ok((sides[0] - sides[1]) / (2.0 * f64::from(STEP)))
}

/// Runs of one way with one number of samples.
struct Point {
    seconds: f64,
    found: Estimate,
    values: Vec<f64>,
}

impl Point {
    fn of(mut run: impl FnMut(u64) -> Result<f64>, stream: u64) -> Result<Self> {
        let mut values = Vec::new();
        let mut seconds = Vec::new();
        for k in 0..RUNS {
            let start = Instant::now();
            values.push(run(SEED + 1000 * stream + k)?);
            seconds.push(start.elapsed().as_secs_f64());
        }
        Ok(Self {
            seconds: median(&seconds).ok_or("no runs")?,
            found: Estimate::of(&values),
            values,
        })
    }

    /// Root mean square of the error, relative to the truth.
    fn error(&self, truth: f64) -> f64 {
        let squares = self.values.iter().map(|x| (x / truth - 1.0).powi(2));
        (squares.sum::<f64>() / self.values.len() as f64).sqrt()
    }
}

/// `moving-outlines`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 32);
    let ladder: &[u64] = fig.pick(&[8, 32], &[8, 32, 128, 512]);
    fig.note("runs", RUNS);
    fig.note("step of differences", f64::from(STEP));
    for (c, (name, side)) in CASES.into_iter().enumerate() {
        let mut scene = scene(side, size)?;
        let most = ladder[ladder.len() - 1];
        let truth = Point::of(
            |seed| difference(&mut scene, seed, 16 * most),
            90 + c as u64,
        )?
        .found;
        let mut ways = Vec::new();
        for (w, way) in ["edges", "reparameterised", "differences"]
            .into_iter()
            .enumerate()
        {
            let mut points = Vec::new();
            for (k, &spp) in ladder.iter().enumerate() {
                let stream = (100 * c + 10 * w + k) as u64;
                points.push(match way {
                    "edges" => Point::of(|s| derivative(&scene, Estimator::Edges, s, spp), stream)?,
                    "differences" => Point::of(|s| difference(&mut scene, s, spp), stream)?,
                    _ => Point::of(
                        |s| derivative(&scene, Estimator::ReparameterisedMis, s, spp),
                        stream,
                    )?,
                });
            }
            ways.push((way, points));
        }
        let last = |w: usize| &ways[w].1[ladder.len() - 1];
        let limit = z_limit(2 * CASES.len(), RUNS, LEVEL);
        for (w, allowed) in [(0, 0.01), (1, if name == "few" { 0.02 } else { 0.05 })] {
            let found = last(w).found;
            let off = (found.mean - truth.mean).abs() - allowed * truth.mean.abs();
            let error = found.se.hypot(truth.se);
            let text = format!(
                "{:.5} +- {:.5}, differences {:.5} +- {:.5}",
                found.mean, found.se, truth.mean, truth.se
            );
            if name == "microscopic" && w == 1 {
                fig.note(
                    "microscopic silhouettes, reparameterised over the truth",
                    found.mean / truth.mean,
                );
                continue;
            }
            fig.check(
                format!("{name}: {} agree with differences", ways[w].0),
                off < limit * error,
                text,
            );
        }
        let mut chart = LineChart::new(
            &format!("A derivative in a position: {name} outlines"),
            "seconds",
            "relative error (root mean square)",
        )
        .log_x()
        .log_y();
        let mut rows = Vec::new();
        for (way, points) in &ways {
            let line = points.iter().map(|p| (p.seconds, p.error(truth.mean)));
            chart = chart.measured(way, line.collect::<Vec<_>>());
            for (spp, p) in ladder.iter().zip(points) {
                rows.push([
                    (*way).to_string(),
                    spp.to_string(),
                    p.seconds.to_string(),
                    p.error(truth.mean).to_string(),
                    p.found.mean.to_string(),
                    p.found.se.to_string(),
                ]);
            }
        }
        fig.chart(name, &chart);
        let names = ["way", "spp", "seconds", "error", "mean", "standard error"];
        fig.csv_text(name, &names, rows);
        let panel =
            examples::chart::Panel::tonemapped(name, &picture(&scene, SEED, 64).image(0), 1.0);
        fig.image(&format!("scene-{name}"), &panel.enlarged(4));
        let efficiency = |w: usize| 1.0 / (last(w).seconds * last(w).error(truth.mean).powi(2));
        let [e, r, d] = [0, 1, 2].map(efficiency);
        fig.note(
            &format!("{name}: efficiency of edges over reparameterised"),
            e / r,
        );
        fig.note(
            &format!("{name}: efficiency of reparameterised over differences"),
            r / d,
        );
    }
    Ok(())
}
