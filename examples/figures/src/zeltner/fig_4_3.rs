//! Images of derivatives: a table that becomes rougher, and a rook that moves to the left [Zeltner 2021, figure 4.3].

use std::collections::BTreeMap;

use render::instances::{Direction, Estimator, render_f32};
use render::math::Ray;
use render::params::Theta;
use render::statistics::{Estimate, z_limit};
use render::{Job, RenderError, Scene};

use crate::common_scenes::chess;
use crate::statistics::{Series, check_same, grey};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::scene_builder::{picture, unit};

const SEED: u64 = 43;
const ROUGHNESS: &str = "table.alpha.value";
const PLACE: &str = "rook.translation";
/// Between the rook and the table: surfaces that touch would meet in a line that moves with neither, and light between those
/// that nearly do is rare and bright in derivatives.
const GAP: f32 = 0.05;
/// Independent images behind every error.
const RUNS: u64 = 16;
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;
/// Pixels along a side of the blocks that are compared.
const BLOCK: usize = 8;
/// Middle of the lamp of [`chess`].
const LAMP: [f64; 3] = [-1.8, 4.0, 0.4];

/// What is differentiated: `sign` along `at` of a parameter, with half the step of differences. That of a place is a small
/// part of a pixel: an outline on the side of a block leaves it within a step.
struct Change {
    name: &'static str,
    at: usize,
    sign: f32,
    step: f32,
}

const CHANGES: [Change; 2] = [
    Change {
        name: ROUGHNESS,
        at: 0,
        sign: 1.0,
        step: 0.02,
    },
    Change {
        name: PLACE,
        at: 0,
        sign: -1.0,
        step: 1.0 / 256.0,
    },
];

type Images = std::result::Result<Vec<Vec<f64>>, RenderError>;

/// One derivative image per run.
fn derivatives(scene: &Scene, e: Estimator, change: &Change, seed: u64, spp: u64) -> Images {
    let params = scene.params();
    let info = params.find(change.name)?;
    let mut along = vec![0.0; info.shape.len()];
    along[change.at] = change.sign;
    let along = [Direction::Dense(params.handle(info), along)];
    let run = |run: u64| {
        let job = Job::new(scene, &scene.settings, seed + run, 0..spp, &());
        let seen = e.forward_f32(&job, params.values(), &along)?;
        Ok(grey(&seen.sums[1], 1.0 / spp as f64))
    };
    (0..RUNS).map(run).collect()
}

/// Central differences with common random numbers, one image per run.
fn differences(scene: &mut Scene, change: &Change, spp: u64) -> Images {
    let start = scene.params().values().to_vec();
    let at = scene.params().find(change.name)?.offset + change.at;
    let mut sides = [Vec::new(), Vec::new()];
    for (sign, images) in [1.0, -1.0].into_iter().zip(&mut sides) {
        let mut values = start.clone();
        values[at] += sign * change.sign * change.step;
        scene.set_params(&values)?;
        for run in 0..RUNS {
            let job = Job::new(scene, &scene.settings, SEED + 500 + run, 0..spp, &());
            let theta = Theta::constant(scene.params().values());
            let seen = render_f32(&job, &theta, Estimator::Mis);
            let scale = 1.0 / (spp as f64 * 2.0 * f64::from(change.step));
            images.push(grey(&seen.sums[0], scale));
        }
    }
    scene.set_params(&start)?;
    let [up, down] = &sides;
    let pairs = up.iter().zip(down);
    Ok(pairs
        .map(|(up, down)| up.iter().zip(down).map(|(a, b)| a - b).collect())
        .collect())
}

/// What the middles of pixels see.
struct Places {
    /// Pixels in a row.
    width: usize,
    table: Vec<bool>,
    /// Where the rook begins and where it ends, from left to right: both pixels beside each such side.
    lines: [Vec<bool>; 2],
    /// On the table and at least two pixels from the rook: where the rook stands before the middle of the lamp, and where
    /// a mirror would show it, with the pixels around.
    shadow: Vec<bool>,
    mirrored: Vec<bool>,
}

impl Places {
    fn of(scene: &Scene) -> Self {
        let [width, height] = scene.film.crop_size.map(|s| s as usize);
        let mut names = Vec::new();
        let [mut shadow, mut mirrored] = [Vec::new(), Vec::new()];
        let seen = |ray: &Ray<f64>| {
            let hit = scene.intersect(ray);
            hit.map(|h| scene.shape_info(h.shape).name.clone())
        };
        for i in 0..width * height {
            let ray = scene
                .camera
                .ray((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let name = seen(&ray);
            let on_table = name.as_deref() == Some("table");
            let [o, d] = [ray.o, ray.d].map(|v| v.to_array());
            let towards = |d: [f64; 3]| {
                let t = -o[1] / ray.d.to_array()[1];
                let at = [0, 1, 2].map(|k: usize| o[k] + t * ray.d.to_array()[k] + 1e-3 * d[k]);
                let ray = Ray::new(at.into(), d.into());
                on_table && seen(&ray).as_deref() == Some("rook")
            };
            let t = -o[1] / d[1];
            let lamp = [0, 1, 2].map(|k: usize| LAMP[k] - o[k] - t * d[k]);
            shadow.push(towards(unit(lamp)));
            mirrored.push(towards([d[0], -d[1], d[2]]));
            names.push(name);
        }
        let near = |mask: &[bool], reach: usize| -> Vec<bool> {
            let near = |i: usize| {
                let (x, y) = (i % width, i / width);
                (y.saturating_sub(reach)..(y + reach + 1).min(height)).any(|y| {
                    (x.saturating_sub(reach)..(x + reach + 1).min(width))
                        .any(|x| mask[y * width + x])
                })
            };
            (0..mask.len()).map(near).collect()
        };
        let is = |name: &str| -> Vec<bool> {
            names.iter().map(|n| n.as_deref() == Some(name)).collect()
        };
        let (table, rook) = (is("table"), is("rook"));
        let around = near(&rook, 2);
        let far = |mask: &[bool]| -> Vec<bool> {
            let mask = near(mask, 1);
            let all = mask.iter().zip(&table).zip(&around);
            all.map(|((m, t), a)| *m && *t && !*a).collect()
        };
        let mut lines = [vec![false; rook.len()], vec![false; rook.len()]];
        for i in (0..rook.len()).filter(|i| i % width > 0) {
            match (rook[i - 1], rook[i]) {
                (false, true) => lines[0][i - 1..=i].fill(true),
                (true, false) => lines[1][i - 1..=i].fill(true),
                _ => {}
            }
        }
        Self {
            width,
            lines,
            shadow: far(&shadow),
            mirrored: far(&mirrored),
            table,
        }
    }
}

/// The mean over some pixels, from independent images.
fn mean(images: &[Vec<f64>], mask: &[bool]) -> Estimate {
    let count = mask.iter().filter(|m| **m).count().max(1) as f64;
    let means = images.iter().map(|image| {
        let own = image.iter().zip(mask).filter(|(_, m)| **m);
        own.map(|(v, _)| v).sum::<f64>() / count
    });
    Estimate::of(&means.collect::<Vec<_>>())
}

/// Among blocks with some of these pixels: how many there are, and the lowest and highest of their means, in standard
/// errors.
fn extremes(images: &[Vec<f64>], mask: &[bool], width: usize) -> (usize, [f64; 2]) {
    let side = BLOCK / 2;
    let block = |i: usize| i / width / side * width.div_ceil(side) + i % width / side;
    let mut blocks: BTreeMap<usize, Vec<bool>> = BTreeMap::new();
    for i in (0..mask.len()).filter(|&i| mask[i]) {
        blocks.entry(block(i)).or_insert(vec![false; mask.len()])[i] = true;
    }
    let z = blocks
        .values()
        .map(|own| mean(images, own).z(&Estimate::default()));
    let ends = z.fold([0.0f64; 2], |[low, high], z| [low.min(z), high.max(z)]);
    (blocks.len(), ends)
}

fn series(images: &[Vec<f64>], width: usize) -> Result<Series> {
    let image = |k: u64| Ok::<_, RenderError>(images[k as usize].clone());
    Ok(Series::of(images.len() as u64, [width, BLOCK], image)?)
}

/// `zeltner-4-3`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick([64, 48], [128, 96]);
    let spp = fig.pick(8, 32);
    fig.note("samples per pixel of an image", spp);
    fig.note("images", RUNS);
    fig.note("seed", SEED);
    let mut scene = chess(size, 3)?;
    scene.make_movable(&[PLACE])?;
    scene.set([(PLACE, &[0.0, GAP, 0.0][..])])?;
    let places = Places::of(&scene);
    let width = size[0] as usize;
    let mut found = Vec::new();
    let mut reference = Vec::new();
    for (change, seed) in CHANGES.iter().zip([SEED, SEED + 100]) {
        found.push(derivatives(&scene, Estimator::Edges, change, seed, spp)?);
        reference.push(differences(&mut scene, change, 2 * spp)?);
    }
    let interior = derivatives(&scene, Estimator::Interior, &CHANGES[1], SEED + 100, spp)?;
    for (statement, k) in [
        (
            "(a) roughness: the image of derivatives is that of central differences",
            0,
        ),
        (
            "(b) translation: the image of derivatives is that of central differences",
            1,
        ),
    ] {
        let [a, b] = [series(&found[k], width)?, series(&reference[k], width)?];
        check_same(fig, &[statement], [&a, &b], RUNS, LEVEL);
    }
    reached(fig, &places, &found);
    lines(fig, &places, [&found[1], &reference[1], &interior]);
    let enlarge = fig.pick(4, 2);
    let mut panels = vec![
        Panel::tonemapped("image", &picture(&scene, SEED, 8 * spp).image(0), 1.0).enlarged(enlarge),
    ];
    let all = [
        ("rougher table", &found[0]),
        ("differences", &reference[0]),
        ("interior alone", &interior),
        ("rook to the left", &found[1]),
        ("differences", &reference[1]),
    ];
    for (label, images) in all {
        let means: Vec<f64> = (0..images[0].len())
            .map(|p| images.iter().map(|i| i[p]).sum::<f64>() / images.len() as f64)
            .collect();
        panels.push(Panel::signed(label, width, &means, None).enlarged(enlarge));
    }
    fig.images("gradients", 3, &panels);
    Ok(())
}

/// Where changes are felt that are not seen directly.
fn reached(fig: &mut Figure, places: &Places, found: &[Vec<Vec<f64>>]) {
    let elsewhere: Vec<bool> = places.table.iter().map(|t| !t).collect();
    let claims = [
        (
            "(c) a rougher table changes what does not show the table",
            0,
            &elsewhere,
        ),
        (
            "(d) the shadow of the rook moves on the table",
            1,
            &places.shadow,
        ),
        (
            "(e) the reflection of the rook moves in the table",
            1,
            &places.mirrored,
        ),
    ];
    for (statement, k, mask) in claims {
        let (count, [low, high]) = extremes(&found[k], mask, places.width);
        let least = z_limit(count, RUNS, LEVEL);
        fig.check(
            statement,
            high.max(-low) > least,
            format!("z of {count} blocks there from {low:.1} to {high:.1}, limit {least:.2}"),
        );
    }
}

/// What the outline of the rook covers to the left and uncovers to the right.
fn lines(fig: &mut Figure, places: &Places, [edges, differences, interior]: [&[Vec<f64>]; 3]) {
    // The same paths: what is left is what outlines add.
    let added: Vec<Vec<f64>> = (edges.iter().zip(interior))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect())
        .collect();
    let [left, right] = places.lines.each_ref();
    let [(first, [_, high]), (second, [low, _])] =
        [left, right].map(|line| extremes(&added, line, places.width));
    let least = z_limit(first + second, RUNS, LEVEL);
    fig.check(
        "(f) outlines add lines, of one sign where the rook covers what is to the left of it, and of the other where it uncovers",
        high > least && low < -least,
        format!("z up to {high:.1} and down to {low:.1} in {first} and {second} blocks, limit {least:.2}"),
    );
    let [by_edges, by_differences, within] =
        [edges, differences, interior].map(|images| mean(images, left));
    let least = z_limit(1, RUNS, LEVEL);
    fig.check(
        "(g) in the interior alone the line to the left is missing",
        by_differences.z(&within).abs() > least
            && within.mean.abs() < 0.5 * by_differences.mean.abs(),
        format!(
            "{:.3} +- {:.3}; by edges {:.3} +- {:.3}, by differences {:.3} +- {:.3}",
            within.mean,
            within.se,
            by_edges.mean,
            by_edges.se,
            by_differences.mean,
            by_differences.se
        ),
    );
}
