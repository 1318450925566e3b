//! Direct light by BSDF sampling, emitter sampling and both [Zeltner 2021, figure 2.27].

use rayon::prelude::*;
use render::Job;
use render::instances::{Estimator, render_f32};
use render::params::Theta;
use render::statistics::{Estimate, z_limit};

use super::radiance_split::radiance;
use crate::common_scenes::{LAMP_RADII, PLATE_ALPHAS, Plates, plates};
use crate::statistics::{per_pixel, variance};
use examples::chart::Panel;
use examples::figure::{Figure, Result};

const SEED: u64 = 227;
const TECHNIQUES: [(&str, Estimator, u64); 3] = [
    ("BSDF, 64 spp", Estimator::Detached, 64),
    ("emitter, 64 spp", Estimator::Emitter, 64),
    // One sample of either kind counts as two. The balance heuristic is the one with a proven bound.
    ("both, 32 + 32 spp", Estimator::MisBalance, 32),
];

/// Results of one technique in one cell.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    mean: Estimate,
    /// Values that its error is from: pixels of all runs.
    count: u64,
    std: f64,
    /// Mean square over the pixels of their means.
    square: f64,
}

impl Cell {
    /// What the bound adds to the variance of a technique with 32 samples when it is combined with
    /// another, 32 samples of both: `(1 / 32 - 1 / 64)` times the square of the mean [Veach 1997,
    /// theorem 9.2].
    ///
    /// A sample of a pixel is a point and one direction of each technique, and the theorem holds at every
    /// point; over a pixel, that is the mean square over the points. It is at most the second moment of this
    /// technique, known from its variance with 64 samples.
    fn added(&self) -> f64 {
        (self.square + 64.0 * self.std.powi(2)) / 64.0
    }

    /// Bound of the standard deviation of the combination. With half of the samples, the variance is twice as
    /// large.
    fn bound(&self) -> f64 {
        (2.0 * self.std.powi(2) + self.added()).sqrt()
    }
}

/// How near the combination comes to the better technique, and that all agree.
fn combination(fig: &mut Figure, found: &[[[Cell; 3]; 4]; 4]) {
    // Where the better technique hardly varies, no combination can follow it within a constant factor: half of
    // its samples come from the worse one, and the weights differ from 0 and 1. The bound says by how
    // much; elsewhere the factor is 1.5.
    let (mut factor, mut bound) = ((0.0, 0, 0), (0.0, 0, 0));
    let mut compared = 0;
    for (i, row) in found.iter().enumerate() {
        for (j, [bsdf, emitter, both]) in row.iter().enumerate() {
            let better = if bsdf.std < emitter.std {
                bsdf
            } else {
                emitter
            };
            let share = both.std / bsdf.bound().min(emitter.bound());
            if share > bound.0 {
                bound = (share, i, j);
            }
            let ratio = both.std / better.std;
            if better.std.powi(2) > better.square / 64.0 {
                compared += 1;
                if ratio > factor.0 {
                    factor = (ratio, i, j);
                }
            }
        }
    }
    let place = |(_, i, j): (f64, usize, usize)| {
        let (alpha, radius) = (PLATE_ALPHAS[i], LAMP_RADII[j]);
        format!("at roughness {alpha} and radius {radius}")
    };
    fig.check(
        "the std of both is within 1.5 times that of the better one, where that exceeds mean / 8",
        factor.0 < 1.5 && compared > 0,
        format!(
            "at most {:.2} times, {}; {compared} of 16 cells",
            factor.0,
            place(factor)
        ),
    );
    fig.check(
        "it is within Veach's bound for the balance heuristic in all 16 cells",
        bound.0 < 1.0,
        format!("at most {:.3} of the bound, {}", bound.0, place(bound)),
    );
    let (mut largest, mut count) = (0.0f64, u64::MAX);
    for cell in found.iter().flatten() {
        for single in &cell[..2] {
            largest = largest.max(single.mean.z(&cell[2].mean).abs());
            count = count.min(single.count);
        }
    }
    let limit = z_limit(2 * 16, count, 1e-2);
    fig.check(
        "all means are equal: 16 cells, either technique against both",
        largest < limit,
        format!("largest |z| of 32: {largest:.2}, limit {limit:.2} (joint level 1 %)"),
    );
}

/// `zeltner-2-27`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let width: u32 = fig.pick(160, 480);
    let runs: u64 = fig.pick(24, 32);
    fig.note("width", width);
    fig.note("runs", runs);
    fig.note("seed", SEED);
    let mut setup = plates(width)?;
    let found = cells(&mut setup, width, runs);

    let ratio = |i: usize, j: usize, a: usize, b: usize| found[i][j][a].std / found[i][j][b].std;
    let bsdf_worst = ratio(3, 0, 0, 1);
    fig.check(
        "BSDF sampling is worst at the small lamp in the rough plate: 5 times the std",
        bsdf_worst > 5.0,
        format!("{bsdf_worst:.1} times that of emitter sampling"),
    );
    let emitter_worst = ratio(0, 3, 1, 0);
    fig.check(
        "emitter sampling is worst at the large lamp in the smooth plate: 5 times the std",
        emitter_worst > 5.0,
        format!("{emitter_worst:.1} times that of BSDF sampling"),
    );
    combination(fig, &found);
    let rows = (0..16).flat_map(|k| {
        let (i, j) = (k / 4, k % 4);
        let cell = found[i][j];
        (0..3).map(move |t| {
            let c = cell[t];
            [
                PLATE_ALPHAS[i],
                LAMP_RADII[j],
                t as f64,
                c.mean.mean,
                c.mean.se,
                c.std,
            ]
        })
    });
    let header = [
        "alpha",
        "radius",
        "technique",
        "mean",
        "error of mean",
        "std of a pixel",
    ];
    fig.csv("cells", &header, rows);

    let shares = shares(&setup, fig.pick(16, 64))?;
    let share = |i: usize, j: usize| {
        let (mut bsdf, mut all) = (0.0, 0.0);
        for [x, y] in window(&setup, width, i, j) {
            let [b, e] = shares[(y * width + x) as usize];
            bsdf += b;
            all += b + e;
        }
        bsdf / all
    };
    let (high, low) = (share(0, 3), share(3, 0));
    fig.check(
        "weight of BSDF sampling above 0.8 at the large lamp in the smooth plate",
        high > 0.8,
        format!("{high:.3}"),
    );
    fig.check(
        "weight of BSDF sampling below 0.2 at the small lamp in the rough plate",
        low < 0.2,
        format!("{low:.3}"),
    );
    let table = (0..4).map(|i| {
        [
            PLATE_ALPHAS[i],
            share(i, 0),
            share(i, 1),
            share(i, 2),
            share(i, 3),
        ]
    });
    let table: Vec<_> = table.collect();
    let header = [
        "alpha",
        "radius 0.03",
        "radius 0.1",
        "radius 0.3",
        "radius 0.9",
    ];
    fig.csv("weights", &header, table);

    let enlarge = fig.pick(2, 1);
    let theta = Theta::constant(setup.scene.params().values());
    let settings = &setup.scene.settings;
    let mut panels: Vec<Panel> = TECHNIQUES
        .map(|(label, technique, spp)| {
            let image = render_f32(
                &Job::new(&setup.scene, settings, SEED, 0..spp, &()),
                &theta,
                technique,
            );
            Panel::tonemapped(label, &image.image(0), 1.0).enlarged(enlarge)
        })
        .into();
    let weights: Vec<f64> = shares
        .iter()
        .map(|[b, e]| if b + e > 0.0 { b / (b + e) } else { 0.0 })
        .collect();
    let label = "weight of BSDF sampling";
    let weights = Panel::false_colour(label, width as usize, &weights, 0.0, 1.0);
    panels.push(weights.enlarged(enlarge));
    fig.images("direct-light", 2, &panels);
    Ok(())
}

/// Pixels around the mirror image of lamp j in plate i.
fn window(setup: &Plates, width: u32, i: usize, j: usize) -> Vec<[u32; 2]> {
    let [[x0, y0], [w, h]] = setup.window(width, i, j);
    (0..h)
        .flat_map(|y| (0..w).map(move |x| [x0 + x, y0 + y]))
        .collect()
}

/// Mean over a window, its standard error, and the root mean square over its pixels of the standard
/// deviation between runs, for all cells and techniques.
fn cells(setup: &mut Plates, width: u32, runs: u64) -> [[[Cell; 3]; 4]; 4] {
    let mut out = [[[Cell::default(); 3]; 4]; 4];
    let film = setup.scene.film;
    for (i, row) in out.iter_mut().enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            let [offset, size] = setup.window(width, i, j);
            setup.scene.film.crop_offset = offset;
            setup.scene.film.crop_size = size;
            let scene = &setup.scene;
            let theta = Theta::constant(scene.params().values());
            for (t, (_, technique, spp)) in TECHNIQUES.into_iter().enumerate() {
                let grey = |run: u64| -> Vec<f64> {
                    let seed = SEED + 1 + t as u64;
                    let samples = run * spp..(run + 1) * spp;
                    let settings = &scene.settings;
                    let r = render_f32(
                        &Job::new(scene, settings, seed, samples, &()),
                        &theta,
                        technique,
                    );
                    let pixels = r.sums[0].chunks_exact(3);
                    pixels
                        .map(|p| p.iter().sum::<f64>() / (3.0 * spp as f64))
                        .collect()
                };
                let images: Vec<_> = (0..runs).into_par_iter().map(grey).collect();
                let each = per_pixel(&images);
                let pixels = each.len() as f64;
                let variance = variance(&images) / pixels;
                let count = runs * each.len() as u64;
                cell[t] = Cell {
                    mean: Estimate {
                        mean: each.iter().map(|e| e.mean).sum::<f64>() / pixels,
                        se: (variance / count as f64).sqrt(),
                    },
                    count,
                    std: variance.sqrt(),
                    square: each.iter().map(|e| e.mean.powi(2)).sum::<f64>() / pixels,
                };
            }
        }
    }
    setup.scene.film = film;
    out
}

/// Per pixel, what BSDF sampling and emitter sampling contribute to the estimate with both.
fn shares(setup: &Plates, spp: u64) -> Result<Vec<[f64; 2]>> {
    let scene = &setup.scene;
    let [width, height] = scene.film.size;
    let rows: Vec<Vec<[f64; 2]>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let row = (0..width).map(|x| {
                let ray = |u: [f32; 2]| scene.camera.ray(x as f32 + u[0], y as f32 + u[1]);
                let stream = u64::from(y * width + x);
                let split =
                    radiance(scene, ray, 2, SEED + 9, stream, 0..spp).map_err(|e| e.to_string())?;
                Ok([split.bsdf, split.emitter].map(|c| c.iter().sum()))
            });
            row.collect()
        })
        .collect::<std::result::Result<_, String>>()?;
    Ok(rows.concat())
}
