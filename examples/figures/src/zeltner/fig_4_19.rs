//! All estimators of the derivative in roughness, on the plates [Zeltner 2021, figure 4.19].
//!
//! Columns get the same time: samples in proportion to the inverse of [`auto::costs`] in forward mode, so that results
//! depend on the seed alone. `costs.csv` has their number and the time that was measured. Standard deviations
//! are those of the work of one sample of `mis`, in outcomes (b) and (c) and in pictures; outcome (e) is about
//! weights, so it compares single samples, and reports the ratio at equal time beside it.

use std::time::Instant;

use rayon::prelude::*;
use render::Job;
use render::auto;
use render::instances::{Direction, Estimator, Mode};
use render::statistics::{Estimate, z_limit};
use render::{RenderError, Scene};

use crate::common_scenes::{LAMP_RADII, Plates, textured_plates};
use crate::differences::central;
use crate::statistics::{grey, variance};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::ranks::median;
use examples::say;
use examples::scene_builder::picture;

const SEED: u64 = 419;
/// Roughness of the plates from top to bottom, as in the thesis.
pub(crate) const ALPHAS: [f64; 4] = [0.01, 0.02, 0.06, 0.13];
/// The columns of the figure, naive attached sampling last.
const COLUMNS: [Estimator; 8] = [
    Estimator::Emitter,
    Estimator::Detached,
    Estimator::Differential,
    Estimator::Reparameterised,
    Estimator::Mis,
    Estimator::DifferentialMis,
    Estimator::ReparameterisedMis,
    Estimator::AttachedNaive,
];
const NAIVE: usize = 7;
const MIS: usize = 4;
/// Combination with light sampling, and its two ingredients.
const COMBINED: [[usize; 3]; 3] = [[4, 0, 1], [5, 0, 2], [6, 0, 3]];

/// Mean over the pixels of a window, its standard error, and the standard deviation of a pixel for one unit of work.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    mean: Estimate,
    std: f64,
}

impl Cell {
    /// From independent images of the window, each with `work` per pixel.
    fn of(images: &[Vec<f64>], work: f64) -> Self {
        let pixels = images[0].len() as f64;
        let means = images
            .iter()
            .map(|image| image.iter().sum::<f64>() / pixels);
        Self {
            mean: Estimate::of(&means.collect::<Vec<_>>()),
            std: (variance(images) / pixels * work).sqrt(),
        }
    }
}

/// Samples of a column in the time of `spp` samples of `mis`, if one of its own costs so many of those.
fn samples(cost: f64, spp: u64) -> u64 {
    ((spp as f64 / cost).round() as u64).max(1)
}

/// What a sample of each column costs along the roughness of one plate, on average.
fn costs(scene: &Scene) -> std::result::Result<[f64; COLUMNS.len()], RenderError> {
    let mut out = [0.0; COLUMNS.len()];
    for plate in 0..ALPHAS.len() {
        let s = &scene.settings;
        let found = auto::costs(scene, &[name(plate)], &COLUMNS, Mode::Forward, s, SEED)?;
        let part = found.iter().map(|c| c / ALPHAS.len() as f64);
        out.iter_mut().zip(part).for_each(|(sum, c)| *sum += c);
    }
    Ok(out)
}

fn name(plate: usize) -> String {
    format!("plate {plate}.alpha.data")
}

fn direction(scene: &Scene, plate: usize) -> std::result::Result<Direction, RenderError> {
    Direction::uniform(scene.params(), &name(plate))
}

type Grid = [[Cell; 4]; 4];

/// All cells of one estimator.
fn cells(
    setup: &mut Plates,
    width: u32,
    runs: u64,
    image: impl Fn(&Scene, usize, u64) -> std::result::Result<Vec<f64>, RenderError> + Sync,
    work: f64,
) -> Result<Grid> {
    let mut out = Grid::default();
    for (i, row) in out.iter_mut().enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            let [offset, size] = setup.window(width, i, j);
            setup.scene.film.crop_offset = offset;
            setup.scene.film.crop_size = size;
            let scene = &setup.scene;
            let images: std::result::Result<Vec<_>, _> = (0..runs)
                .into_par_iter()
                .map(|run| image(scene, i, run))
                .collect();
            *cell = Cell::of(&images?, work);
        }
    }
    setup.scene.film.crop_offset = [0; 2];
    setup.scene.film.crop_size = setup.scene.film.size;
    Ok(out)
}

/// The derivatives by central differences in double precision.
fn differences(setup: &mut Plates, width: u32, runs: u64, spp: u64) -> Result<Grid> {
    cells(
        setup,
        width,
        runs,
        |scene, plate, run| {
            let h = 1e-4 * ALPHAS[plate];
            let range = scene.params().find(&name(plate))?.range();
            let steps: Vec<_> = range.map(|i| (i, h)).collect();
            let seed = SEED ^ (run + 1) << 20;
            let job = Job::new(scene, &scene.settings, seed, 0..4 * spp, &());
            // Light sampling does not move with roughness: common random numbers are smooth.
            let difference = central(&job, Estimator::Emitter, &steps);
            Ok(grey(&difference, 1.0 / (2.0 * h * 4.0 * spp as f64)))
        },
        (4 * spp) as f64,
    )
}

/// The derivatives by every column.
fn columns(
    setup: &mut Plates,
    width: u32,
    runs: u64,
    spp: u64,
    costs: [f64; COLUMNS.len()],
) -> Result<Vec<Grid>> {
    let mut found = Vec::new();
    for (k, (e, cost)) in COLUMNS.into_iter().zip(costs).enumerate() {
        let n = samples(cost, spp);
        found.push(cells(
            setup,
            width,
            runs,
            |scene, plate, run| {
                let values = scene.params().values();
                let seed = SEED + (k as u64 + 1) * 1000 + run;
                let along = direction(scene, plate)?;
                let s = &scene.settings;
                let r = e.forward_f32(&Job::new(scene, s, seed, 0..n, &()), values, &[along])?;
                Ok(grey(&r.sums[1], 1.0 / n as f64))
            },
            n as f64 * cost,
        )?);
    }
    Ok(found)
}

/// (a) What is unbiased agrees with differences.
fn agreement(fig: &mut Figure, found: &[Grid], reference: &Grid, runs: u64) {
    let limit = z_limit(NAIVE * 16, runs, 1e-3);
    let mut largest = (0.0f64, 0, 0, 0);
    for (k, grid) in found.iter().enumerate().take(NAIVE) {
        for (i, row) in grid.iter().enumerate() {
            for (j, c) in row.iter().enumerate() {
                let z = c.mean.z(&reference[i][j].mean);
                if z.abs() > largest.0.abs() {
                    largest = (z, k, i, j);
                }
            }
        }
    }
    let (z, k, i, j) = largest;
    fig.check(
        "(a) every unbiased estimator equals finite differences in every cell",
        z.abs() < limit,
        format!(
            "largest |z| of 112: {z:.2} ({}, roughness {}, radius {}), limit {limit:.1}",
            COLUMNS[k].name(),
            ALPHAS[i],
            LAMP_RADII[j]
        ),
    );
}

/// (b), (c) Who has less noise where.
fn noise(fig: &mut Figure, found: &[Grid]) {
    let ratio = |a: usize, b: usize, i: usize, j: usize| found[a][i][j].std / found[b][i][j].std;
    let (smooth, rough) = (ratio(1, 2, 0, 3), ratio(1, 2, 3, 0));
    fig.check(
        "(b) large lamp, roughness 0.01: std of detached above 5 times that of differential, at equal time",
        smooth > 5.0,
        format!("{smooth:.1} times, variance {:.0} times", smooth * smooth),
    );
    fig.check(
        "(b) small lamp, roughness 0.13: the ratio falls below 2, at equal time",
        rough < 2.0 && rough < 0.5 * smooth,
        format!("{rough:.2}"),
    );
    let rank = |i: usize, j: usize, best: bool| {
        let stds = (1..4).map(|k| found[k][i][j].std);
        let own = found[0][i][j].std;
        if best {
            (own, stds.fold(f64::INFINITY, f64::min))
        } else {
            (own, stds.fold(0.0, f64::max))
        }
    };
    let (own, other) = rank(3, 0, true);
    fig.check(
        "(c) emitter sampling is best at the small lamp in the rough plate, at equal time",
        own < other,
        format!("std {own:.4} against {other:.4} of the best other"),
    );
    let (own, other) = rank(0, 3, false);
    fig.check(
        "(c) emitter sampling is worst at the large lamp in the smooth plate, at equal time",
        own > other,
        format!("std {own:.4} against {other:.4} of the worst other"),
    );
}

/// (e) What a combination loses against the better ingredient.
fn combinations(fig: &mut Figure, found: &[Grid], costs: [f64; COLUMNS.len()]) {
    let per_sample = |k: usize| costs[k].sqrt().recip();
    let over_plate = |k: usize, i: usize| {
        let squares = found[k][i].iter().map(|c| c.std * c.std);
        (squares.sum::<f64>() / 4.0).sqrt()
    };
    // Against the better ingredient, with a scale for each estimator.
    let worst = |scale: &dyn Fn(usize) -> f64| {
        let mut worst = (0.0, 0, 0);
        for [both, a, b] in COMBINED {
            for i in 0..4 {
                let [both_std, a, b] = [both, a, b].map(|k| over_plate(k, i) * scale(k));
                let r = both_std / a.min(b);
                if r > worst.0 {
                    worst = (r, both, i);
                }
            }
        }
        worst
    };
    let (by_samples, by_time) = (worst(&per_sample), worst(&|_| 1.0));
    let text = |(r, k, i): (f64, usize, usize)| {
        format!(
            "{r:.2} times ({}, roughness {})",
            COLUMNS[k].name(),
            ALPHAS[i]
        )
    };
    fig.check(
        "(e) combined with light sampling, the std on every plate is at most 1.3 times the better one, at equal samples",
        by_samples.0 < 1.3,
        format!("at most {}, at equal time {}", text(by_samples), text(by_time)),
    );
}

/// All cells as a table.
fn table(fig: &mut Figure, found: &[Grid], reference: &Grid, costs: [f64; COLUMNS.len()]) {
    let rows = COLUMNS
        .iter()
        .zip(costs)
        .zip(found)
        .flat_map(|((e, cost), grid)| {
            (0..16).map(move |c| {
                let (i, j) = (c / 4, c % 4);
                let (cell, r) = (grid[i][j], reference[i][j]);
                [
                    e.name().to_owned(),
                    ALPHAS[i].to_string(),
                    LAMP_RADII[j].to_string(),
                    cell.mean.mean.to_string(),
                    cell.mean.se.to_string(),
                    cell.std.to_string(),
                    (cell.std / cost.sqrt()).to_string(),
                    r.mean.mean.to_string(),
                    r.mean.se.to_string(),
                ]
            })
        });
    let rows: Vec<_> = rows.collect();
    let header = [
        "estimator",
        "alpha",
        "radius",
        "mean",
        "error",
        "std at equal time",
        "std of a sample",
        "reference",
        "its error",
    ];
    fig.csv_text("cells", &header, rows);
}

/// `zeltner-4-19`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let width: u32 = fig.pick(160, 320);
    let (runs, spp): (u64, u64) = (fig.pick(32, 64), fig.pick(48, 256));
    fig.note("width", width);
    fig.note("runs", runs);
    fig.note("samples of mis per pixel and run", spp);
    fig.note("seed", SEED);
    let mut setup = textured_plates(width, ALPHAS)?;

    let reference = differences(&mut setup, width, runs, spp)?;
    let costs = costs(&setup.scene)?;
    let found = columns(&mut setup, width, runs, spp, costs)?;
    agreement(fig, &found, &reference, runs);
    noise(fig, &found);
    // ---- (d) ----
    let magnitude = |grid: &Grid| {
        let all = grid.iter().flatten();
        all.map(|c| c.mean.mean.abs()).sum::<f64>() / 16.0
    };
    let naive = magnitude(&found[NAIVE]) / magnitude(&reference);
    fig.check(
        "(d) naive attached sampling sees less than a tenth of the derivative",
        naive < 0.1,
        format!("{naive:.4} of it"),
    );
    combinations(fig, &found, costs);
    table(fig, &found, &reference, costs);
    pictures(fig, &setup, costs)
}

/// The image, and derivative and standard deviation of every estimator; also what they cost.
fn pictures(fig: &mut Figure, setup: &Plates, costs: [f64; COLUMNS.len()]) -> Result {
    let scene = &setup.scene;
    let (spp, runs) = (fig.pick(8u64, 16), 4u64);
    let width = scene.film.size[0] as usize;
    let values = scene.params().values();
    let s = &scene.settings;
    let image = picture(scene, SEED, fig.pick(64, 256));
    let mut panels = vec![Panel::tonemapped("image", &image.image(0), 1.0)];
    let mut spreads = Vec::new();
    let mut times: Vec<(Estimator, u64, f64)> = Vec::new();
    for (e, cost) in COLUMNS.into_iter().zip(costs) {
        let count = samples(cost, spp);
        let pixels = scene.film.pixels();
        let (mut sum, mut squares) = (vec![0.0; pixels], vec![0.0; pixels]);
        let mut seconds = Vec::new();
        for run in 0..runs {
            let mut total = vec![0.0; pixels];
            for plate in 0..4 {
                let along = direction(scene, plate)?;
                let start = Instant::now();
                let r = e.forward_f32(
                    &Job::new(scene, s, SEED + run, 0..count, &()),
                    values,
                    &[along],
                )?;
                seconds.push(start.elapsed().as_secs_f64());
                let part = grey(&r.sums[1], 1.0 / count as f64);
                total.iter_mut().zip(part).for_each(|(t, p)| *t += p);
            }
            for (p, t) in total.iter().enumerate() {
                sum[p] += t;
                squares[p] += t * t;
            }
        }
        let n = runs as f64;
        let mean: Vec<f64> = sum.iter().map(|x| x / n).collect();
        let std = squares.iter().zip(&mean);
        let std: Vec<f64> = std
            .map(|(q, m)| ((q / n - m * m).max(0.0) * n / (n - 1.0) * count as f64 * cost).sqrt())
            .collect();
        let (label, gain) = match e {
            Estimator::AttachedNaive => (format!("{} x 50", e.name()), 50.0),
            _ => (e.name().to_owned(), 1.0),
        };
        let shown: Vec<f64> = mean.iter().map(|x| x * gain).collect();
        panels.push(Panel::signed(&label, width, &shown, Some(40.0)));
        let label = format!("std: {}", e.name());
        spreads.push(Panel::signed(&label, width, &std, Some(400.0)));
        times.push((e, count, median(&seconds).ok_or("no runs")?));
    }
    fig.images("derivatives", 3, &panels);
    fig.images("deviations", 3, &spreads);
    let base = times[MIS].2;
    let rows: Vec<[String; 4]> = times
        .iter()
        .map(|(e, n, t)| {
            say!(
                "        {}: {n} samples, {t:.3} s, {:.2} x the time of mis",
                e.name(),
                t / base
            );
            let name = e.name().to_owned();
            [name, n.to_string(), t.to_string(), (t / base).to_string()]
        })
        .collect();
    let header = ["estimator", "samples", "seconds", "time over mis"];
    fig.csv_text("costs", &header, rows);
    Ok(())
}
