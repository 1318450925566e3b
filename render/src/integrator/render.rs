//! Images and derivative images: every integral of a pass, added up.

use ad_core::Real;

pub use super::integrals::stays;
use super::integrals::{Wanted, check, every};
use super::job::Job;
use super::pass::{Integral, Pass, Question};
pub use super::progress::Progress;
pub use super::rendering::{Components, NonFinite, PixelConnections, Rendering};
use super::sink::check_values;
pub use super::tile::TILE;
use crate::error::RenderError;
use crate::estimator::{self, Strategy, Unbiased};
use crate::params::{ParamInfo, Theta};
use crate::sampler::Sampler;

/// The image of a job: sums over its samples of every pixel of the crop window, `[height][width][3]`, linear RGB.
///
/// Over a dual number, the result holds the derivative images of its tangents as well (forward mode).
/// It depends on the arguments only, not on the number of threads.
///
/// # Errors
/// Another number of values than the scene has. With tangents, a strategy that is wrong in this scene
/// ([`Scene::admits`](crate::Scene::admits)) or for a parameter that moves ([`estimator::check_parameter`]).
pub fn render<R: Components, S: Unbiased, X: Sampler>(
    job: &Job,
    theta: &Theta<R>,
) -> Result<Rendering, RenderError> {
    let &Job { scene, .. } = job;
    check_values(scene, theta)?;
    if !R::IS_PRIMAL {
        scene.admits::<S>()?;
        let moves = |info: &&ParamInfo| theta.moves(scene.params().handle(info));
        let moving = scene.params().infos().iter().filter(moves);
        for info in moving.clone() {
            stays(job.settings, info)?;
            estimator::check_parameter::<S>(info)?;
            scene.admits_motion::<S>(info)?;
            scene.admits_outlines::<S>(info, job.settings.max_depth)?;
        }
        check::<S>(scene, job.settings, moving)?;
    }
    Ok(unchecked::<R, S, X>(job, theta))
}

/// [`render`] of what has been checked, or has no tangents.
pub(crate) fn unchecked<R: Components, S: Strategy, X: Sampler>(
    job: &Job,
    theta: &Theta<R>,
) -> Rendering {
    let scene = job.scene;
    let pass = Pass::of::<S>(job, theta);
    let mut question = ImageOf {
        pass: &pass,
        sum: Rendering::black(scene.film.crop_size, &pass.samples, R::COUNT),
    };
    let moves =
        |info: &ParamInfo| info.kind.is_motion() && theta.moves(scene.params().handle(info));
    let wanted = Wanted {
        finders: pass.finders(),
        light: true,
        motion: !R::IS_PRIMAL && scene.params().infos().iter().any(moves),
    };
    every::<S::Runs, X>(wanted, job.progress, &mut question);
    question.sum
}

/// An image that is asked of every integral.
struct ImageOf<'a, R: Real> {
    pass: &'a Pass<'a, R>,
    sum: Rendering,
}

impl<R: Components, S: Strategy, X: Sampler> Question<S, X> for ImageOf<'_, R> {
    fn ask<I: Integral<S, X>>(&mut self, progress: &dyn Progress) {
        let part = I::image(&self.pass.reporting(progress));
        self.sum.add(&part);
    }
}
