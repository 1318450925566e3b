//! [Zeltner 2021, figure 3.30]: glints of a sun on a Gaussian normal map: their memory, their noise, and what large footprints
//! do to them.
//!
//! The tree of positions and normals that the source compares with [Yan et al. 2016] is not built: its size is counted, on the
//! same map, in pieces within which a linear function misses the slopes by no more than its intrinsic roughness. What it sums is
//! estimated without it, from samples of the footprint.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Instant;

use ad_core::Vec2;
use render::bsdf::microfacet::Ndf;
use render::bsdf::{RoughConductor, Roughness};
use render::glint::{SlopeMap, mapped_metal};
use render::instances::{Estimator, render_f32};
use render::manifold::Statistics;
use render::params::Theta;
use render::scene::{GlintMethod, Glints};
use render::statistics::{Estimate, z_limit};
use render::{Job, Scene, Settings};

use super::authors::Authors;
use super::glint_scenes::{Slopes, smooth_metal};
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View};

const SEED: u64 = 330;
const DEVIATION: f64 = 0.12;
/// Roughness of the pieces of the other method, from the public scenes.
const INTRINSIC: f64 = 0.001;
/// Bytes of such a piece: a Gaussian in four dimensions, and two bounds of as many, in single precision.
const PIECE: f64 = 4.0 * (8.0 + 2.0 * 8.0);
const TRIALS: u32 = 16;
const RUNS: u64 = 8;

/// What shines.
#[derive(Clone, Copy)]
enum Light {
    Sun,
    Hall,
}

/// A ball under this map, `tiles` copies of it around, of smooth metal or of the intrinsic roughness.
fn ball(size: u32, map: &Slopes, tiles: f32, light: Light, smooth: bool) -> Result<Scene> {
    let mut scene = SceneBuilder::default();
    let conductor = smooth_metal(&mut scene.build)?;
    let metal = if smooth {
        conductor.into()
    } else {
        // Whose slopes have the deviation of pieces along either axis.
        let alpha = 2f64.sqrt() * INTRINSIC;
        let roughness = Roughness {
            kind: Ndf::Beckmann,
            alpha: scene
                .build
                .scalar("metal.alpha.value", alpha, (1e-4, 1.0))?,
            visible: true,
        };
        RoughConductor {
            roughness,
            conductor,
        }
        .into()
    };
    let metal = map.over(&mut scene.build, tiles, metal)?;
    scene.ball("ball", [0.0; 3], 1.0, &Arc::new(metal.into()))?;
    match light {
        Light::Sun => {
            scene.lobe("sun", [27_000.0; 3], [1.0, 0.4, 0.3], 180_000.0)?;
            scene.ambient([0.2; 3])?;
        }
        Light::Hall => scene.hall(1.0)?,
    }
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
        .map(|p| Estimate::of(&images.iter().map(|i| i[p]).collect::<Vec<_>>()))
        .collect();
    let mean = images.iter().map(|i| i.iter().sum::<f64>() / n as f64);
    let mean = Estimate::of(&mean.collect::<Vec<_>>());
    Measured {
        mean,
        variance: pixels
            .iter()
            .map(|e| e.se.powi(2) * runs as f64)
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
    fig.note("size", size);
    fig.note("texels", texels * texels);
    fig.note("spp", fig.pick(8, 64));
    fig.note("runs", RUNS);
    fig.note("seed", SEED);
    let gaussian = Slopes::gaussian(texels, DEVIATION, SEED);
    memory(fig, &gaussian, size)?;
    let sun = noise(fig, "sun", &gaussian, size, Light::Sun)?;
    let brushed = Slopes::brushed(texels, DEVIATION, SEED);
    let hall = noise(fig, "hall", &brushed, size, Light::Hall)?;
    fig.images("glints", 3, &[sun, hall].concat());
    footprints(fig, &gaussian, size)?;
    published(fig)
}

/// Of the map, its moments, and the tree of pieces that it would take.
fn memory(fig: &mut Figure, slopes: &Slopes, size: u32) -> Result {
    let texels = slopes.n;
    let near = ball(size, slopes, tiles(size, texels, 4.0), Light::Sun, true)?;
    let (pieces, moments) = pieces(&near, texels)?;
    let map = texels * texels * 3 * size_of::<f32>();
    let tree = pieces * (texels * texels) as f64 * PIECE;
    let ratio = tree / (map + moments) as f64;
    let mib = |bytes: f64| bytes / f64::from(1 << 20);
    fig.check(
        "the map and its moments take less than a fiftieth of the memory of a tree",
        ratio > 50.0 && moments < map,
        format!(
            "{:.1} MiB, {:.1} of them moments; a tree of {pieces:.0} pieces a texel takes {:.0} MiB, {ratio:.0} times as much",
            mib((map + moments) as f64),
            mib(moments as f64),
            mib(tree)
        ),
    );
    Ok(())
}

/// Glints by walks, by paths, and by a histogram of the slopes in a footprint: paths over metal of the intrinsic roughness, whose
/// lobe around the slope of each sample is the kernel of one that pieces have.
fn noise(
    fig: &mut Figure,
    name: &str,
    slopes: &Slopes,
    size: u32,
    light: Light,
) -> Result<[Panel; 3]> {
    let spp = fig.pick(8, 64);
    let tiles = tiles(size, slopes.n, 4.0);
    let smooth = ball(size, slopes, tiles, light, true)?;
    let rough = ball(size, slopes, tiles, light, false)?;
    let paths = measure(&smooth, None, SEED, RUNS, 128 * spp);
    let histogram = measure(&rough, None, 3 * SEED, RUNS, 16 * spp);
    let unbiased = Glints::new(GlintMethod::Unbiased);
    let walks = measure(&smooth, Some(unbiased), 2 * SEED, RUNS, spp);
    let gain = |m: &Measured| m.variance * m.seconds / (walks.variance * walks.seconds);
    let gains = [&paths, &histogram].map(gain);
    fig.note(
        &format!("{name}: gains over paths and a histogram"),
        gains.to_vec(),
    );
    // Scattered directions meet the wide lamps of a hall, so that walks only cost time there.
    if matches!(light, Light::Sun) {
        fig.check(
            format!("{name}: glints in less noise at equal time than by paths, and than by a histogram of the footprint"),
            gains.iter().all(|g| *g > 1.0),
            format!(
                "variance times time is {:.1} times smaller than that of paths, {:.1} than that of a histogram",
                gains[0], gains[1]
            ),
        );
    }
    let of_one = walks.variance / (128.0 * paths.variance);
    fig.check(
        format!("{name}: one sample has no more noise with walks than without"),
        of_one < 1.5,
        format!("its variance is {of_one:.3} of that of paths"),
    );
    let limit = z_limit(1, RUNS, 1e-2);
    let ratio = walks.mean.mean / paths.mean.mean;
    let error = walks.mean.se.hypot(paths.mean.se) / paths.mean.mean;
    fig.check(
        format!("{name}: the light is that of paths"),
        (ratio - 1.0).abs() < f64::max(0.03, limit * error) && error < 0.1,
        format!("{ratio:.4} ± {error:.4}"),
    );
    let rows = [&walks, &paths, &histogram].map(|m| [m.mean.mean, m.variance, m.seconds]);
    fig.csv(name, &["mean", "variance", "seconds"], rows);
    let factor = fig.pick(8, 3);
    let panel = |label: &str, m: &Measured| {
        let values: Vec<f64> = m.picture.iter().map(|x| x.max(0.0).powf(0.45)).collect();
        let label = format!("{name}: {label}");
        Panel::false_colour(&label, size as usize, &values, 0.0, 3.0).enlarged(factor)
    };
    Ok([
        panel("paths", &paths),
        panel("histogram", &histogram),
        panel("walks in cells", &walks),
    ])
}

/// What growing footprints do to walks that start anywhere in them.
fn footprints(fig: &mut Figure, slopes: &Slopes, size: u32) -> Result {
    let unbiased = Glints::new(GlintMethod::Unbiased);
    let published = Glints {
        budget: fig.pick(1 << 12, 1 << 16),
        ..Glints::published(GlintMethod::Unbiased)
    };
    let sets = Glints::published(GlintMethod::Biased(TRIALS));
    let mut rows = Vec::new();
    for (i, texels_per_pixel) in [2.0, 4.0, 8.0, 16.0].into_iter().enumerate() {
        let tiles = tiles(size, slopes.n, texels_per_pixel);
        let texels_per_pixel = f64::from(tiles) * slopes.n as f64 * 0.88 / TAU / f64::from(size);
        let scene = ball(size, slopes, tiles, Light::Sun, true)?;
        let seed = SEED * (10 + i as u64);
        let spp = fig.pick(2, 16);
        let ours = measure(&scene, Some(unbiased), seed, RUNS, 4 * spp);
        let trial_set = measure(&scene, Some(sets), 2 * seed, RUNS, spp);
        let old = measure(&scene, Some(published), 3 * seed, RUNS, spp);
        let per = |s: &Statistics| s.trials as f64 / s.solutions.max(1) as f64;
        rows.push([
            texels_per_pixel,
            ours.mean.mean,
            trial_set.mean.mean,
            old.mean.mean,
            per(&ours.statistics),
            per(&old.statistics),
            ours.mean.se,
            trial_set.mean.se,
            outlier(&trial_set.pixels),
            outlier(&old.pixels),
        ]);
    }
    let column = |k: usize| rows.iter().map(|r| r[k]).collect::<Vec<f64>>();
    let [sets, old] = [8, 9].map(&column);
    fig.check(
        "trial sets have fewer outliers than trials over a footprint, whatever its size",
        (0..4).all(|i| sets[i] < old[i]),
        format!("a thousandth of all pixels exceeds {sets:.2?}, and {old:.2?}"),
    );
    let shares: Vec<f64> = rows.iter().map(|r| r[2] / r[1]).collect();
    let trials = column(5);
    fig.check(
        "the larger footprints are, the more light trial sets lose, and the more trials others take",
        shares.windows(2).all(|w| w[1] < w[0])
            && shares[3] < 0.9
            && trials.windows(2).all(|w| w[1] > w[0])
            && trials[3] > 4.0 * trials[0],
        format!(
            "{shares:.3?} of the light, {trials:.1?} trials, at {:.1?} texels a pixel",
            column(0)
        ),
    );
    let ours = column(4);
    fig.check(
        "in cells, footprints may be of any size",
        ours.iter().all(|t| *t < 4.0),
        format!(
            "{:.2} trials at most",
            ours.iter().copied().fold(0.0, f64::max)
        ),
    );
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
        "outliers_of_trial_sets",
        "outliers_of_trials",
    ];
    fig.csv("footprints", &columns, rows);
    Ok(())
}

/// The tip of a shoe of the authors, where it is, under the normal map that their other scenes have.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let map = authors.path("Figure_6_Sequence/textures/normalmap_gaussian.exr");
    let side = fig.pick(32, 128);
    let format = r#"<string name="pixel_format" value="rgb"/>"#;
    let crop = [
        ("offset_x", 160 - side / 2),
        ("offset_y", 592 - side / 2),
        ("width", side),
        ("height", side),
    ];
    let crop = crop.map(|(key, n)| format!(r#"<integer name="crop_{key}" value="{n}"/>"#));
    let cropped = format!("{format}{}", crop.concat());
    let changes = [
        ("textures/normalmap_gaussian.exr", map.as_str()),
        (format, cropped.as_str()),
        (
            r#"<integer name="max_depth" value="-1"/>"#,
            r#"<integer name="max_depth" value="2"/>"#,
        ),
    ];
    let file = "Figure_19_GlintsComparison/shoes_sms.xml";
    let scene = authors
        .scene(fig, "authors' shoes", file, 800, &changes)?
        .scene;
    fig.note("authors' shoes: normal map", "that of Figure_6_Sequence");
    let spp = fig.pick(4, 32);
    let unbiased = Glints::new(GlintMethod::Unbiased);
    let old = Glints {
        budget: fig.pick(1 << 12, 1 << 16),
        ..Glints::published(GlintMethod::Unbiased)
    };
    let sets = Glints::published(GlintMethod::Biased(TRIALS));
    let paths = measure(&scene, None, SEED, RUNS, 32 * spp);
    let [walks, sets, old] = [(unbiased, 4 * spp), (sets, spp), (old, spp)]
        .map(|(glints, spp)| measure(&scene, Some(glints), 2 * SEED, RUNS, spp));
    let gain = paths.variance * paths.seconds / (walks.variance * walks.seconds);
    let limit = z_limit(1, RUNS, 1e-2);
    let ratio = walks.mean.mean / paths.mean.mean;
    let error = walks.mean.se.hypot(paths.mean.se) / paths.mean.mean;
    fig.check(
        "authors' shoes: the light is that of paths, and walks find some of it",
        (ratio - 1.0).abs() < f64::max(0.03, limit * error)
            && error < 0.1
            && walks.statistics.found > 0,
        format!(
            "{ratio:.4} ± {error:.4}; {} of {} walks find a glint",
            walks.statistics.found, walks.statistics.attempts
        ),
    );
    fig.note("authors' shoes: gain over paths", gain);
    let outliers = [&sets, &old].map(|m| outlier(&m.pixels));
    fig.check(
        "authors' shoes: trial sets have no more outliers than trials over a footprint",
        outliers[0] <= outliers[1],
        format!("a thousandth of all pixels exceeds {outliers:.2?}"),
    );
    let all = [
        ("paths", &paths),
        ("walks in cells", &walks),
        ("trial sets", &sets),
        ("trials over the footprint", &old),
    ];
    let panels = all.map(|(label, m)| {
        let values: Vec<f64> = m.picture.iter().map(|x| x.max(0.0).powf(0.45)).collect();
        Panel::false_colour(label, side as usize, &values, 0.0, 3.0).enlarged(256 / side as usize)
    });
    fig.images("authors-shoes", 2, &panels);
    let rows = all.map(|(_, m)| [m.mean.mean, m.mean.se, m.variance, m.seconds]);
    fig.csv(
        "authors-shoes",
        &["mean", "error", "variance", "seconds"],
        rows,
    );
    Ok(())
}
