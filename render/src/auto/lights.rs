//! How often to sample each emitter.

use super::pilot::{directions, noise};
use crate::emitter::{AnyEmitter, Emitter};
use crate::error::RenderError;
use crate::instances::{Direction, Estimator};
use crate::integrator::Job;
use crate::integrator::gradient::check_size;
use crate::integrator::render::Progress;
use crate::params::{ParamInfo, ParamRef};
use crate::sampler::{Family, Points};
use crate::scene::{LightChoice, Scene, Settings};

/// Samples that each emitter is measured with, as far as two per pixel are not more.
const SAMPLES: usize = 1 << 15;
/// Part of the samples that is spread evenly, whatever the pilots say: they may have missed something.
const EVEN: f64 = 0.1;

/// Sampling weights, for [`Scene::set_sampling_weights`], with which `estimator` has least variance, as far as
/// pilots can tell: of the derivatives of `<adjoint, image>` in the named parameters, or of `<adjoint, image>`
/// itself where none is named.
///
/// Light is linear in emission. So every emitter is left alone in turn (with its own emission among the
/// parameters, but not that of others), two samples of every pixel in forward mode tell the variance of what it
/// contributes, and its weight is the root of that (the allocation of Neyman, as if all variance came from samples of
/// emitters). Several parameters count in proportion to their size. It pays where few of the lights matter, or
/// matter for what is wanted: the large ones for derivatives in emission, say. It takes two samples per pixel and
/// emitter, more where pixels are few.
///
/// # Errors
/// An unknown name, an adjoint of the wrong size, a parameter or scene that is not for this estimator.
pub fn sampling_weights<N: AsRef<str>>(
    scene: &Scene,
    names: &[N],
    adjoint: &[f32],
    estimator: Estimator,
    settings: &Settings,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Vec<f64>, RenderError> {
    check_size("adjoint image", scene, adjoint)?;
    let mut params: Vec<ParamInfo> = Vec::new();
    for name in names {
        let info = scene.params().find(name.as_ref())?;
        if !params.contains(info) {
            params.push(info.clone());
        }
    }
    let settings = Settings {
        points: Points::Independent,
        lights: LightChoice::One,
        ..*settings
    };
    let pairs = (SAMPLES / 2).div_ceil(scene.film.pixels().max(1)) as u64;
    let seed = Family::Pilots.seed(seed);
    let mut deviations = Vec::with_capacity(scene.emitters().len());
    let emission: Vec<ParamRef> = scene.emitters().iter().flat_map(emission_of).collect();
    for (k, emitter) in scene.emitters().iter().enumerate() {
        let own = emission_of(emitter);
        let mut others = emission.clone();
        others.retain(|p| !own.contains(p));
        let values = without(scene, &others);
        let mut seen = params.clone();
        seen.retain(|info| !others.contains(&scene.params().handle(info)));
        let mut variance = 0.0;
        for pair in 0..pairs {
            let along = if params.is_empty() {
                // Emission times its derivative: all of its light.
                contribution(scene, &own)
            } else {
                directions(scene.params(), &seen, seed, pair)
            };
            if along.is_empty() || progress.cancelled() {
                break;
            }
            let sample = |i: u64| {
                let i = 2 * pair + i;
                estimator.forward_f32(
                    &Job::new(scene, &settings, seed, i..i + 1, progress),
                    &values,
                    &along,
                )
            };
            let (a, b) = (sample(0)?, sample(1)?);
            let both = a.sums[1].iter().zip(&b.sums[1]).zip(adjoint);
            variance += both
                .map(|((a, b), &d)| noise([a, b].map(|x| f64::from(d) * x)))
                .sum::<f64>();
        }
        deviations.push((variance * scene.shares().of(k)).sqrt());
    }
    let total: f64 = deviations.iter().sum();
    let n = deviations.len() as f64;
    let weight = |d: f64| {
        if total > 0.0 && total.is_finite() {
            (1.0 - EVEN) * d / total + EVEN / n
        } else {
            1.0
        }
    };
    Ok(deviations.into_iter().map(weight).collect())
}

/// What an emitter emits.
fn emission_of(emitter: &AnyEmitter) -> Vec<ParamRef> {
    let mut out = Vec::new();
    emitter.radiance().visit_params(&mut |p| out.push(p));
    out
}

/// All values where these are dark.
fn without(scene: &Scene, dark: &[ParamRef]) -> Vec<f32> {
    let params = scene.params();
    let mut values = params.values().to_vec();
    for p in dark {
        values[params.infos()[p.id as usize].range()].fill(0.0);
    }
    values
}

/// The direction of all of an emitter's light.
fn contribution(scene: &Scene, own: &[ParamRef]) -> Vec<Direction> {
    let params = scene.params();
    let values = |p: &ParamRef| params.values()[params.infos()[p.id as usize].range()].to_vec();
    let along = own.iter().map(|p| Direction::Dense(*p, values(p)));
    along.collect()
}
