//! What samples cost.

use crate::error::RenderError;
use crate::instances::{Estimator, Mode};
use crate::integrator::Job;
use crate::integrator::gradient::Active;
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
/// ```
/// use render::auto::costs;
/// use render::instances::{Estimator, Mode};
///
/// let room = render::scene::room(8, 8)?;
/// let estimators = [Estimator::Mis, Estimator::Detached, Estimator::DifferentialMis];
/// let found = costs(&room, &["sphere.alpha.value"], &estimators, Mode::Reverse, &room.settings, 1)?;
/// assert_eq!(found[0], 1.0);
/// assert!(found[1] < 1.0 && found[2] > 1.0, "{found:?}"); // without sampled lights, and with a pair of samples
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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
    let job = Job::new(scene, settings, Family::Pilots.seed(seed), 0..PATHS, &());
    let unit = Estimator::Mis.work(&job, &active, mode);
    let works = estimators.iter().map(|e| e.work(&job, &active, mode));
    Ok(works.map(|w| w / unit).collect())
}
