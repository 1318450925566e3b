//! [Zeltner 2021, figure 3.30]: glints of a sun on a Gaussian normal map: their memory, their noise, and what large footprints
//! do to them.
//!
//! The tree of positions and normals that the source compares with [Yan et al. 2016] is not built: its size is counted, on the
//! same map, in pieces within which a linear function misses the slopes by no more than its intrinsic roughness. Nor is its
//! time compared.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Instant;

use ad_core::Vec2;
use render::glint::{SlopeMap, mapped_metal};
use render::instances::{Estimator, render_f32};
use render::manifold::Statistics;
use render::params::Theta;
use render::scene::{GlintMethod, Glints};
use render::{Job, Scene, Settings};

use super::glint_scenes::Slopes;
use crate::chart::{LineChart, Panel};
use crate::figure::{Figure, Result};
use crate::figures::statistics::Estimate;
use crate::scene_builder::{SceneBuilder, View};

const SEED: u64 = 330;
const DEVIATION: f64 = 0.12;
/// Roughness of the pieces of the other method, from the public scenes.
const INTRINSIC: f64 = 0.001;
/// Bytes of such a piece: a Gaussian in four dimensions, and two bounds of as many, in single precision.
const PIECE: f64 = 4.0 * (8.0 + 2.0 * 8.0);
const TRIALS: u32 = 16;

/// A ball under a sun, `tiles` copies of the map around it.
fn ball(size: u32, texels: usize, tiles: f32) -> Result<Scene> {
    let mut scene = SceneBuilder::default();
    let metal = Slopes::gaussian(texels, DEVIATION, SEED).metal(&mut scene.build, tiles)?;
    scene.ball("ball", [0.0; 3], 1.0, &Arc::new(metal.into()))?;
    scene.lobe("sun", [27_000.0; 3], [1.0, 0.4, 0.3], 180_000.0)?;
    scene.ambient([0.2; 3])?;
    let view = View {
        eye: [6.0, 0.0, 0.0],
        target: [0.0; 3],
        fov: 10.0,
        size: [size; 2],
    };
    scene.finish(&view, 2)
}

/// How often the map goes around the ball, of which 0.88 are seen, for so many texels a pixel.
fn tiles(size: u32, texels: usize, per_pixel: f64) -> f32 {
    let around = per_pixel * f64::from(size) / 0.88 * TAU;
    (around / texels as f64).round().max(1.0) as f32
}

/// Images of independent runs.
struct Measured {
    mean: Estimate,
    /// Mean over pixels of their variance.
    variance: f64,
    seconds: f64,
    statistics: Statistics,
    /// Pixels of all runs.
    pixels: Vec<f64>,
    picture: Vec<f64>,
}

fn measure(scene: &Scene, glints: Option<Glints>, seed: u64, runs: u64, spp: u64) -> Measured {
    let settings = Settings {
        glints,
        ..scene.settings
    };
    let theta = Theta::constant(scene.params().values());
    let mut statistics = Statistics::default();
    let start = Instant::now();
    let images: Vec<Vec<f64>> = (0..runs)
        .map(|run| {
            let job = Job::new(scene, &settings, seed + run, 0..spp, &());
            let r = render_f32(&job, &theta, Estimator::Mis);
            statistics.merge(&r.glints);
            r.sums[0]
                .chunks_exact(3)
                .map(|p| p[1] / spp as f64)
                .collect()
        })
        .collect();
    let seconds = start.elapsed().as_secs_f64();
    let n = images[0].len();
    let pixels: Vec<Estimate> = (0..n)
        .map(|p| Estimate::of(images.iter().map(|i| i[p])))
        .collect();
    let mean = Estimate::of(images.iter().map(|i| i.iter().sum::<f64>() / n as f64));
    Measured {
        mean,
        variance: pixels
            .iter()
            .map(|e| e.error.powi(2) * runs as f64)
            .sum::<f64>()
            / n as f64,
        seconds,
        statistics,
        pixels: images.into_iter().flatten().collect(),
        picture: pixels.iter().map(|e| e.mean).collect(),
    }
}

/// Of the sorted values, the one that a thousandth exceeds.
fn outlier(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted[(sorted.len() * 999 / 1000).min(sorted.len() - 1)]
}

/// Pieces of a map within which a linear function misses the slopes by no more than the intrinsic roughness, a texel.
fn pieces(scene: &Scene, texels: usize) -> Result<(f64, usize)> {
    let theta = Theta::<f32>::constant(scene.params().values());
    let metal = mapped_metal(scene.material(0), false).ok_or("no normal map")?;
    let map = SlopeMap::new(metal, &theta).ok_or("a map that is no image")?;
    let mut sum = 0.0;
    for k in 0..texels * texels {
        let at = |x: f64, y: f64| {
            let t = Vec2::new((k % texels) as f64 + x, (k / texels) as f64 + y);
            map.slope(&theta, t).map(|(s, _)| s).unwrap_or_default()
        };
        let (low, high) = (1e-6, 1.0 - 1e-6);
        let twist = at(low, low) - at(high, low) - at(low, high) + at(high, high);
        // In the middle of a piece of side h a plane through its corners is off by a quarter of h^2 times the twist.
        sum += (twist.length() / (4.0 * INTRINSIC))
            .sqrt()
            .ceil()
            .max(1.0)
            .powi(2);
    }
    Ok((sum / (texels * texels) as f64, map.bytes()))
}

/// `zeltner-3-30`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let (size, texels) = (fig.pick(24, 96), fig.pick(256, 1024));
    let (runs, spp) = (8, fig.pick(8, 64));
    fig.note("size", size);
    fig.note("texels", texels * texels);
    fig.note("spp", spp);
    fig.note("runs", runs);
    fig.note("seed", SEED);
    // ---- Memory ----
    let near = ball(size, texels, tiles(size, texels, 4.0))?;
    let (pieces, moments) = pieces(&near, texels)?;
    let map = texels * texels * 3 * size_of::<f32>();
    let tree = pieces * (texels * texels) as f64 * PIECE;
    let ratio = tree / (map + moments) as f64;
    let mib = |bytes: f64| bytes / f64::from(1 << 20);
    fig.check(
        "the map and its moments take little memory",
        ratio > 50.0 && moments < map,
        format!(
            "{:.1} MiB, {:.1} of them moments; a tree of {pieces:.0} pieces a texel takes {:.0} MiB, {ratio:.0} times as much",
            mib((map + moments) as f64),
            mib(moments as f64),
            mib(tree)
        ),
    );
    // ---- Noise ----
    let unbiased = Glints::new(GlintMethod::Unbiased);
    let paths = measure(&near, None, SEED, runs, 128 * spp);
    let walks = measure(&near, Some(unbiased), 2 * SEED, runs, spp);
    let gain = paths.variance * paths.seconds / (walks.variance * walks.seconds);
    fig.check(
        "glints in less noise at equal time",
        gain > 1.0,
        format!("variance times time is {gain:.1} times smaller than that of paths"),
    );
    let ratio = walks.mean.mean / paths.mean.mean;
    let error = walks.mean.error.hypot(paths.mean.error) / paths.mean.mean;
    fig.check(
        "the light is that of paths",
        (ratio - 1.0).abs() < f64::max(0.03, 4.0 * error) && error < 0.1,
        format!("{ratio:.4} ± {error:.4}"),
    );
    // ---- Large footprints ----
    let published = Glints {
        budget: fig.pick(1 << 12, 1 << 16),
        ..Glints::published(GlintMethod::Unbiased)
    };
    let sets = Glints::published(GlintMethod::Biased(TRIALS));
    let mut rows = Vec::new();
    let mut outliers = [0.0; 2];
    let mut trials = Vec::new();
    for (i, texels_per_pixel) in [2.0, 4.0, 8.0, 16.0].into_iter().enumerate() {
        let tiles = tiles(size, texels, texels_per_pixel);
        let texels_per_pixel = f64::from(tiles) * texels as f64 * 0.88 / TAU / f64::from(size);
        let scene = ball(size, texels, tiles)?;
        let seed = SEED * (10 + i as u64);
        let spp = spp / 4;
        let ours = measure(&scene, Some(unbiased), seed, runs, 4 * spp);
        let trial_set = measure(&scene, Some(sets), 2 * seed, runs, spp);
        let old = measure(&scene, Some(published), 3 * seed, runs, spp);
        let per = |s: &Statistics| s.trials as f64 / s.solutions.max(1) as f64;
        rows.push([
            texels_per_pixel,
            ours.mean.mean,
            trial_set.mean.mean,
            old.mean.mean,
            per(&ours.statistics),
            per(&old.statistics),
            ours.mean.error,
            trial_set.mean.error,
        ]);
        trials.push((per(&ours.statistics), per(&old.statistics)));
        if i == 1 {
            outliers = [outlier(&trial_set.pixels), outlier(&old.pixels)];
        }
    }
    fig.check(
        "trial sets have fewer outliers than trials over a footprint",
        outliers[0] < outliers[1],
        format!(
            "a thousandth of all pixels exceeds {:.2}, and {:.2}",
            outliers[0], outliers[1]
        ),
    );
    let last = rows[rows.len() - 1];
    let lost = 1.0 - last[2] / last[1];
    fig.check(
        "in large footprints trial sets lose light, and trials are many",
        lost > 0.1 && trials[3].1 > 4.0 * trials[0].1,
        format!(
            "{:.0} % is lost at {:.0} texels a pixel; trials rise from {:.1} to {:.1}",
            100.0 * lost,
            last[0],
            trials[0].1,
            trials[3].1
        ),
    );
    fig.check(
        "in cells, footprints may be of any size",
        trials.iter().all(|t| t.0 < 4.0),
        format!(
            "{:.2} trials at most",
            trials.iter().map(|t| t.0).fold(0.0, f64::max)
        ),
    );
    let width = size as usize;
    let panels = [("paths", &paths), ("walks in cells", &walks)].map(|(label, m)| {
        let values: Vec<f64> = m.picture.iter().map(|x| x.max(0.0).powf(0.45)).collect();
        Panel::false_colour(label, width, &values, 0.0, 3.0).enlarged(fig.pick(8, 4))
    });
    fig.images("glints", 2, &panels);
    let line = |k: usize| rows.iter().map(move |r| (r[0], r[k] / r[1]));
    let chart = LineChart::new(
        "light in large footprints",
        "texels a pixel",
        "of all light",
    )
    .log_x()
    .line("walks in cells", line(1))
    .line("trial sets", line(2))
    .line("trials over the footprint", line(3));
    fig.chart("footprints", &chart);
    let columns = [
        "texels_per_pixel",
        "cells",
        "trial_sets",
        "trials",
        "trials_in_cells",
        "trials_in_footprints",
        "error_of_cells",
        "error_of_trial_sets",
    ];
    fig.csv("footprints", &columns, rows);
    Ok(())
}
