//! What samples cost.

use crate::error::RenderError;
use crate::instances::{Estimator, Mode};
use crate::integrator::gradient::Active;
use crate::integrator::render::Progress;
use crate::params::ParamInfo;
use crate::sampler::Family;
use crate::scene::{Scene, Settings};

/// Paths that are counted for each estimator: enough for a few per cent.
pub(super) const PATHS: u64 = 4096;

/// Work of a sample of each of these estimators of derivatives in the named parameters, in samples of
/// [`Estimator::Mis`] in the same mode.
///
/// Not a clock, so that what is chosen by it depends on the seed alone: some paths are followed, and what they are made
/// of (edges, samples of lights, of the derivative of normals, auxiliary rays, ..) is counted and multiplied by what
/// each part takes. Most times in the scenes of the figures are met within 15 per cent.
///
/// # Errors
/// An unknown name.
pub fn costs<N: AsRef<str>>(
    scene: &Scene,
    names: &[N],
    estimators: &[Estimator],
    mode: Mode,
    settings: &Settings,
    seed: u64,
) -> Result<Vec<f64>, RenderError> {
    let infos = names.iter().map(|n| scene.params().find(n.as_ref()));
    let infos: Vec<&ParamInfo> = infos.collect::<Result<_, _>>()?;
    let active = Active::of(scene, &infos);
    let works = |estimators: &[Estimator]| {
        let seed = Family::Pilots.seed(seed);
        works(scene, &active, estimators, mode, settings, seed, PATHS, &())
    };
    let unit = works(&[Estimator::Mis])[0];
    Ok(works(estimators).iter().map(|w| w / unit).collect())
}

/// Work of a sample of each estimator by so many paths, in edges, which are the same in both modes.
pub(super) fn works(
    scene: &Scene,
    active: &Active,
    estimators: &[Estimator],
    mode: Mode,
    settings: &Settings,
    seed: u64,
    paths: u64,
    progress: &dyn Progress,
) -> Vec<f64> {
    let work = |&e: &Estimator| e.work(scene, active, settings, mode, seed, paths, progress);
    estimators.iter().map(work).collect()
}
