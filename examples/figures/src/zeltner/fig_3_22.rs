//! [Zeltner 2021, figure 3.22]: walks find bright lights in scratches, scattered directions everything else.

use std::sync::Arc;

use rayon::prelude::*;
use render::Scene;
use render::bsdf::{Bsdf, DeltaKind, Shading, TransportMode};
use render::emitter::Emitter;
use render::glint::{Drawn, Finder, Pixel, SlopeMap, glinty_shapes, mapped_metal};
use render::manifold::Statistics;
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::scene::{GlintMethod, GlintRegion, GlintTechniques, GlintWeights, Glints};
use render::statistics::{Estimate, z_limit};

use super::glint_scenes::Slopes;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View};

const SEED: u64 = 322;
/// Concentration of the bright lights, and how bright they are in the middle.
const CONCENTRATION: f64 = 40_000.0;
const BRIGHT: f64 = 1200.0;
/// Slopes above this are scratches.
const SCRATCH: f64 = 0.02;

fn ball(size: u32) -> Result<(Scene, u32)> {
    let mut scene = SceneBuilder::default();
    let slopes = Slopes::scratched(256, 60, 2.0, 0.35, SEED);
    let metal = slopes.metal(&mut scene.build, 3.0 * size as f32 / 32.0)?;
    let metal = Arc::new(metal.into());
    scene.ball("ball", [0.0; 3], 1.0, &metal)?;
    let lights = [
        [1.0, 0.5, 0.2],
        [1.0, 0.2, -0.5],
        [1.0, -0.1, 0.6],
        [1.0, -0.6, -0.2],
    ];
    for (i, d) in lights.into_iter().enumerate() {
        scene.lobe(&format!("light{i}"), [BRIGHT; 3], d, CONCENTRATION)?;
    }
    scene.ambient([0.3; 3])?;
    let view = View {
        eye: [6.0, 0.0, 0.0],
        target: [0.0; 3],
        fov: 10.0,
        size: [size; 2],
    };
    Ok((scene.finish(&view, 2)?, lights.len() as u32))
}

/// What one technique found: in scratches and on flat parts, of bright lights and of the rest.
#[derive(Clone, Copy, Default)]
struct Found {
    /// By whether in a scratch, whether by a walk.
    light: [[f64; 2]; 2],
    /// That of bright lights.
    bright: [[f64; 2]; 2],
}

/// Samples of every pixel.
fn samples(
    scene: &Scene,
    bright: u32,
    glints: Glints,
    seed: u64,
    spp: u64,
) -> Result<Vec<Vec<Found>>> {
    let values: Vec<f64> = (scene.params().values().iter())
        .map(|&x| f64::from(x))
        .collect();
    let theta = Theta::<f64>::constant(&values);
    let glinty = glinty_shapes(scene).ok_or("nothing glitters")?;
    let finder = Finder::new(scene, theta, &glinty, glints);
    let metal = mapped_metal(scene.material(0), false).ok_or("no normal map")?;
    let map = SlopeMap::new(metal, &theta).ok_or("a map that is no image")?;
    let [width, height] = scene.film.size;
    let sample = |number: u64, pixel: &Pixel, index: u64| {
        let mut rng = Independent::new(seed, number, index);
        let middle = pixel.middle;
        let [u, v] = rng.next_2d::<f64>();
        let at = [middle[0] + u - 0.5, middle[1] + v - 0.5];
        let mut found = Found::default();
        let view = Drawn {
            film: at,
            lens: [0.5; 2],
            part: rng.next_3d(),
        };
        let mut all = Vec::new();
        let mut came_to = Statistics::default();
        finder.find(pixel, &view, &mut rng, &|| false, &mut came_to, &mut all);
        for glint in all {
            let at = Shading::new(theta, glint.si.uv);
            let material = scene.material(glint.shape);
            let f = material.eval_delta(
                &at,
                glint.wo,
                glint.wi,
                DeltaKind::Reflection,
                0,
                TransportMode::Radiance,
            );
            let e = &scene.emitters()[glint.emitter as usize];
            let light = (f * e.eval(&theta, &glint.emission)).mean() * glint.weight;
            let slope = map.slope(&theta, map.texels(glint.si.uv));
            let scratch = slope.is_some_and(|(s, _)| s.length() > SCRATCH);
            found.light[usize::from(scratch)][usize::from(glint.by_walk)] += light;
            if glint.emitter < bright {
                found.bright[usize::from(scratch)][usize::from(glint.by_walk)] += light;
            }
        }
        found
    };
    let pixels = u64::from(width) * u64::from(height);
    let of_pixel = |p: u64| {
        let middle = [p % u64::from(width), p / u64::from(width)].map(|p| p as f64 + 0.5);
        let pixel = finder.pixel(middle, false);
        (0..spp).map(|i| sample(p, &pixel, i)).collect()
    };
    Ok((0..pixels).into_par_iter().map(of_pixel).collect())
}

/// Mean over pixels of the variance of a sample.
fn variance(all: &[Vec<Found>], of: impl Fn(&Found) -> f64) -> f64 {
    let one = |samples: &Vec<Found>| {
        let mean = Estimate::of(&samples.iter().map(&of).collect::<Vec<_>>());
        mean.se.powi(2) * samples.len() as f64
    };
    all.iter().map(one).sum::<f64>() / all.len() as f64
}

fn total(all: &[Vec<Found>], of: impl Fn(&Found) -> f64) -> f64 {
    let n = all.first().map_or(1, Vec::len) * all.len();
    all.iter().flatten().map(of).sum::<f64>() / n as f64
}

/// Means over the pixels of samples of equal index: independent images.
fn images(all: &[Vec<Found>], of: impl Fn(&Found) -> f64) -> Vec<f64> {
    let spp = all.first().map_or(0, Vec::len);
    let image = |i: usize| all.iter().map(|pixel| of(&pixel[i])).sum::<f64>() / all.len() as f64;
    (0..spp).map(image).collect()
}

/// Samples that are weighed in one way.
struct Weighed<'a> {
    name: &'a str,
    by_both: &'a [Vec<Found>],
    /// What scattered directions leave to walks, at the seed of such that leave nothing.
    left: Vec<Vec<Found>>,
}

/// That both techniques weigh a path in the same way, whichever finds it: walks bring the light that scattered directions leave to
/// them. `alone` are those that leave nothing.
fn check_weights(fig: &mut Figure, kind: &Weighed, alone: &[Vec<Found>]) {
    let &Weighed {
        name,
        by_both,
        ref left,
    } = kind;
    // Of flat parts and of scratches, by two kinds of weights.
    let samples = by_both.first().map_or(0, Vec::len) as u64;
    let limit = z_limit(4, samples, 1e-3);
    let places = [(0, "flat parts"), (1, "scratches")].map(|(scratch, place)| {
        let walks = Estimate::of(&images(by_both, |f| f.light[scratch][1]));
        let scattered = |found: &[Vec<Found>]| images(found, |f| f.light[scratch][0]);
        // Of as many samples as there are of both.
        let differences = scattered(alone).into_iter().zip(scattered(left));
        let theirs = differences.map(|(all, rest)| all - rest);
        let theirs = Estimate::of(&theirs.collect::<Vec<_>>());
        let all = total(alone, |f| f.light[scratch][0]);
        (place, walks, theirs, all)
    });
    // Lights are taken to be far.
    let agree = places.iter().all(|(_, walks, theirs, all)| {
        let apart = (walks.mean - theirs.mean).abs();
        apart < (0.03 * all).max(limit * walks.se.hypot(theirs.se))
    });
    let found = places.map(|(place, walks, theirs, all)| {
        format!(
            "{place}: {:.4} ± {:.4} and {:.4} ± {:.4} of {all:.4}",
            walks.mean, walks.se, theirs.mean, theirs.se
        )
    });
    fig.check(
        format!("walks bring what scattered directions leave to them, by {name}"),
        agree,
        found.join(", "),
    );
}

/// The weights of walks: by pixel, and of the single paths to bright lights that scattered directions find.
fn draw_weights(fig: &mut Figure, width: usize, kinds: &[Weighed], alone: &[Vec<Found>]) {
    const BINS: usize = 20;
    let part = |pixel: &Vec<Found>| {
        let of = |walk: usize| {
            let sums = pixel.iter().map(|f| f.bright[0][walk] + f.bright[1][walk]);
            sums.sum::<f64>()
        };
        let (walks, scattered) = (of(1), of(0));
        walks / (walks + scattered).max(f64::MIN_POSITIVE)
    };
    let panels = kinds.iter().map(|Weighed { name, by_both, .. }| {
        let parts: Vec<f64> = by_both.iter().map(part).collect();
        let label = format!("weight of walks, by {name}");
        Panel::false_colour(&label, width, &parts, 0.0, 1.0).enlarged(fig.pick(12, 4))
    });
    let panels: Vec<Panel> = panels.collect();
    let mut chart = LineChart::new(
        "paths to bright lights",
        "weight of walks",
        "share of the light",
    );
    for Weighed { name, left, .. } in kinds {
        for (scratch, place) in [(1, "in scratches"), (0, "on flat parts")] {
            let mut bins = [0.0; BINS];
            let pixels = alone.iter().zip(left);
            for (all, rest) in pixels.flat_map(|(all, rest)| all.iter().zip(rest)) {
                let [all, rest] = [all, rest].map(|f| f.bright[scratch][0]);
                if all > 0.0 {
                    let bin = ((1.0 - rest / all) * BINS as f64) as usize;
                    bins[bin.min(BINS - 1)] += all;
                }
            }
            let sum: f64 = bins.iter().sum();
            let middle = |k: usize| (k as f64 + 0.5) / BINS as f64;
            let points = (0..BINS).map(|k| (middle(k), bins[k] / sum.max(f64::MIN_POSITIVE)));
            chart = chart.measured(&format!("{place}, by {name}"), points);
        }
    }
    fig.images("weights", 2, &panels);
    fig.chart("paths", &chart);
}

/// `zeltner-3-22`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let (size, spp) = (fig.pick(16, 64), fig.pick(64, 512));
    fig.note("size", size);
    fig.note("spp", spp);
    fig.note("seed", SEED);
    let (scene, bright) = ball(size)?;
    let unbiased = Glints::new(GlintMethod::Unbiased);
    let of =
        |glints: Glints, seed: u64, spp: u64| samples(&scene, bright, glints, SEED + seed, spp);
    let only = |techniques| Glints {
        techniques,
        ..unbiased
    };
    let both = of(unbiased, 0, spp)?;
    let lobe = Glints {
        weights: GlintWeights::Lobe,
        region: GlintRegion::Texels,
        ..unbiased
    };
    let by_lobe = of(lobe, 1, spp)?;
    let walks = of(only(GlintTechniques::Walks), 2, spp)?;
    let many = fig.pick(16, 4) * spp;
    let scattering = of(only(GlintTechniques::Scattering), 3, many)?;
    let all = |f: &Found| f.light.iter().flatten().sum::<f64>();
    // ---- The same light ----
    let [brute, sum, sum_by_lobe] =
        [&scattering, &both, &by_lobe].map(|found| Estimate::of(&images(found, all)));
    for (name, e) in [("densities", &sum), ("the lobe", &sum_by_lobe)] {
        // Of two comparisons.
        let limit = z_limit(2, spp, 1e-3);
        let ratio = e.mean / brute.mean;
        let error = brute.se.hypot(e.se) / brute.mean;
        fig.check(
            format!("both techniques together find the light, weighed by {name}"),
            (ratio - 1.0).abs() < f64::max(0.03, limit * error) && error < fig.pick(0.1, 0.03),
            format!("{ratio:.4} ± {error:.4} of what scattering alone finds"),
        );
    }
    // ---- Who finds what ----
    let share = |found: &[Vec<Found>], scratch: usize| {
        let walks = total(found, |f| f.bright[scratch][1]);
        walks / (walks + total(found, |f| f.bright[scratch][0]))
    };
    let flat = |found: &[Vec<Found>]| {
        let scattered = total(found, |f| f.light[0][0]);
        scattered / (scattered + total(found, |f| f.light[0][1]))
    };
    for (name, found) in [("densities", &both), ("the lobe", &by_lobe)] {
        let (walked, scattered) = (share(found, 1), flat(found));
        fig.check(
            format!("walks find bright lights in scratches, scattering the light of flat parts, by {name}"),
            walked > 0.5 && scattered > 0.5,
            format!(
                "{:.1} % of bright light in scratches is that of walks, {:.1} % of flat parts' light of scattering",
                100.0 * walked,
                100.0 * scattered
            ),
        );
    }
    // What scattered directions leave to walks, at the seed of those that leave nothing. Walks do not matter.
    let left = |weights: Glints| {
        let one = Glints {
            method: GlintMethod::Biased(1),
            ..weights
        };
        of(one, 3, 4 * spp)
    };
    let kinds = [
        Weighed {
            name: "densities",
            by_both: &both,
            left: left(unbiased)?,
        },
        Weighed {
            name: "the lobe",
            by_both: &by_lobe,
            left: left(lobe)?,
        },
    ];
    for kind in &kinds {
        check_weights(fig, kind, &scattering);
    }
    draw_weights(fig, size as usize, &kinds, &scattering);
    // ---- Noise ----
    let mut rows = Vec::new();
    for (scratch, place) in [(1, "in scratches"), (0, "on flat parts")] {
        let of = |f: &Found| f.light[scratch].iter().sum::<f64>();
        let [a, b, c, d] = [&both, &by_lobe, &walks, &scattering].map(|found| variance(found, of));
        fig.check(
            format!("{place} both are hardly noisier than the better one"),
            a < 1.5 * c.min(d),
            format!(
                "variance {a:.3e} by densities, {b:.3e} by the lobe; walks {c:.3e}, scattering {d:.3e}"
            ),
        );
        rows.push([scratch as f64, a, b, c, d]);
    }
    let picture = |found: &[Vec<Found>], of: &dyn Fn(&Found) -> f64| -> Vec<f64> {
        found
            .iter()
            .map(|p| p.iter().map(of).sum::<f64>() / p.len() as f64)
            .collect()
    };
    let width = size as usize;
    let by = |walk: usize| move |f: &Found| f.light[0][walk] + f.light[1][walk];
    let panels = [
        ("walks", picture(&both, &by(1))),
        ("scattering", picture(&both, &by(0))),
        ("both", picture(&both, &all)),
        ("scattering alone", picture(&scattering, &all)),
    ]
    .map(|(label, values)| {
        let values: Vec<f64> = values.into_iter().map(|x| x.max(0.0).powf(0.45)).collect();
        Panel::false_colour(label, width, &values, 0.0, 2.0).enlarged(fig.pick(6, 3))
    });
    fig.images("techniques", 2, &panels);
    let columns = ["scratches", "densities", "lobe", "walks", "scattering"];
    fig.csv("variance", &columns, rows);
    Ok(())
}
