//! What [Stam 2020, figures 7 and 8] share: the scene, and images with one derivative image per control, in batches.

use ad_core::Dual;
use render::Job;
use render::Scene;
use render::bsdf::BlinnPhongSampling;
use render::estimator::Unbiased;
use render::instances::{Direction, forward_f32};
use render::integrator::render::{Rendering, render};
use render::params::{Tangent, Theta};
use render::sampler::Independent;
use render::statistics::Estimate;

use super::cornell::{CONTROLS, Cornell, LABELS, NAMES, perturbed};
use crate::statistics::per_pixel;
use examples::chart::Panel;
use examples::figure::{Figure, Result};

/// Values of the controls: the light is bright, and the sphere has a wide highlight.
pub(super) const THETA: [f64; CONTROLS] = [12.0, 0.0, 0.15, 0.45, 40.0, 0.0, 0.7];
pub(super) const EXPONENT: usize = 4;
pub(super) const BATCHES: u64 = 16;
pub(super) const FD_STEP: f64 = 1e-3;

pub(super) fn scene(
    theta: [f64; CONTROLS],
    sampling: BlinnPhongSampling,
    size: u32,
    depth: u32,
) -> Result<Scene> {
    Cornell {
        theta,
        sampling,
        size,
        max_depth: depth,
    }
    .build()
}

/// Image and seven derivative images in double precision. The paper samples the BSDF alone. The first
/// channel of [`Rendering`] is meant: all colours are grey.
pub(super) fn forward<S: Unbiased>(
    scene: &Scene,
    seed: u64,
    samples: std::ops::Range<u64>,
) -> Result<Rendering> {
    let values = perturbed(scene, 0, 0.0)?;
    let mut tangents = vec![Tangent::None; scene.params().infos().len()];
    for (k, name) in NAMES.iter().enumerate() {
        let id = scene.params().handle(scene.params().find(name)?).id as usize;
        let direction = Dual::<f64, CONTROLS>::var(0.0, k);
        tangents[id] = Tangent::Uniform(direction);
    }
    let theta = Theta::with_tangents(&values, &tangents);
    render::<Dual<f64, CONTROLS>, S, Independent>(
        &Job::new(scene, &scene.settings, seed, samples, &()),
        &theta,
    )
    .map_err(Into::into)
}

/// Per component and pixel: mean and its standard error, from independent batches.
pub(super) struct Batched {
    pub(super) mean: Vec<Vec<f64>>,
    pub(super) error: Vec<Vec<f64>>,
    /// Sum over the pixels of each component.
    pub(super) totals: Vec<Estimate>,
    pub(super) bad: u64,
}

pub(super) fn batched(
    spp: u64,
    mut one: impl FnMut(std::ops::Range<u64>) -> Result<Vec<Vec<f64>>>,
) -> Result<Batched> {
    let per = (spp / BATCHES).max(1);
    let mut components: Vec<Vec<Vec<f64>>> = Vec::new();
    for b in 0..BATCHES {
        let images = one(b * per..(b + 1) * per)?;
        components.resize_with(images.len(), Vec::new);
        for (batches, image) in components.iter_mut().zip(images) {
            batches.push(image);
        }
    }
    let pixels: Vec<_> = components
        .iter()
        .map(|batches| per_pixel(batches))
        .collect();
    let total = |batches: &Vec<Vec<f64>>| {
        let sums = batches.iter().map(|image| image.iter().sum());
        Estimate::of(&sums.collect::<Vec<_>>())
    };
    let of = |f: fn(&Estimate) -> f64| pixels.iter().map(|k| k.iter().map(f).collect()).collect();
    Ok(Batched {
        mean: of(|e| e.mean),
        error: of(|e| e.se),
        totals: components.iter().map(total).collect(),
        bad: 0,
    })
}

/// Grey pixel values of all components.
pub(super) fn grey(r: &Rendering) -> Vec<Vec<f64>> {
    let n = r.samples.max(1) as f64;
    r.sums
        .iter()
        .map(|s| s.iter().step_by(3).map(|x| x / n).collect())
        .collect()
}

pub(super) fn forward_batched<S: Unbiased>(scene: &Scene, seed: u64, spp: u64) -> Result<Batched> {
    let mut bad = 0;
    let mut out = batched(spp, |samples| {
        let r = forward::<S>(scene, seed, samples)?;
        bad += r.non_finite.count;
        Ok(grey(&r))
    })?;
    out.bad = bad;
    Ok(out)
}

pub(super) fn panels(mean: &[Vec<f64>], size: u32, title: &str, factor: usize) -> Vec<Panel> {
    let width = size as usize;
    let data = mean[0].iter().flat_map(|&v| [v as f32; 3]).collect();
    let image = render::Image {
        width,
        height: width,
        data,
    };
    let mut all = vec![Panel::tonemapped(title, &image, 1.3).enlarged(factor)];
    for (k, label) in LABELS.iter().enumerate() {
        // Noise in the brightest pixels must not set the scale.
        all.push(
            Panel::signed(&format!("d / d {label}"), width, &mean[k + 1], None).enlarged(factor),
        );
    }
    all
}

/// Derivative image along the directions of all controls by MIS: less noise than the paper has.
pub(super) fn clean(scene: &Scene, seed: u64, spp: u64) -> Result<Rendering> {
    let directions = NAMES.map(|n| Direction::uniform(scene.params(), n));
    let directions = directions
        .into_iter()
        .collect::<std::result::Result<Vec<_>, _>>()?;
    let values = scene.params().values();
    Ok(forward_f32(
        &Job::new(scene, &scene.settings, seed, 0..spp, &()),
        values,
        &directions,
    )?)
}

/// Settings shared by both figures.
pub(super) struct Setup {
    pub(super) size: u32,
    pub(super) spp: u64,
    pub(super) depth: u32,
    pub(super) seed: u64,
    pub(super) factor: usize,
}

pub(super) fn setup(fig: &mut Figure) -> Setup {
    let s = Setup {
        size: fig.pick(40, 128),
        spp: fig.pick(64, 128),
        depth: 5,
        seed: 7,
        factor: fig.pick(6, 2),
    };
    fig.note("theta", THETA.to_vec());
    fig.note("size", s.size);
    fig.note("spp", s.spp);
    fig.note("seed", s.seed);
    fig.note("max_depth", s.depth);
    s
}

/// Pixels whose direct specular light is at least 0.3 of the brightest.
pub(super) fn highlight(theta: [f64; CONTROLS], s: &Setup) -> Result<Vec<usize>> {
    let direct = scene(theta, BlinnPhongSampling::Cosine, s.size, 2)?;
    let shine = &grey(&clean(&direct, s.seed, 32)?)[4];
    let peak = shine.iter().fold(0.0f64, |m, x| m.max(*x));
    Ok((0..shine.len())
        .filter(|&i| shine[i] > 0.3 * peak)
        .collect())
}
