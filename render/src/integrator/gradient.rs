//! Reverse mode: the adjoint of an image, pulled back to the parameters.

use ad_core::Float;

pub use super::active::Active;
use super::exact::ExactBuffer;
use super::integrals::{Wanted, check, every};
use super::job::Job;
use super::pass::{Integral, Pass, Question};
use super::progress::Progress;
pub use super::sink::Gradient;
pub(crate) use super::sink::check_size;
use super::sink::{GradientSums, check_values, collect};
use crate::error::RenderError;
use crate::estimator::memory::Memory;
use crate::estimator::{Strategy, Unbiased};
use crate::params::Theta;
use crate::sampler::Sampler;

/// The derivative of `sum over pixels and channels of adjoint x image`, where the image is the mean
/// over the samples `samples` of each pixel with seed `seed`: one pass, all parameters.
///
/// `adjoint` is `[height][width][3]`, the size of the film's crop window. To be unbiased for a loss
/// that is not linear, it must come from an image with another seed (errata Z-4.4).
///
/// Memory: the recorded path of one sample per thread, and twice the size of the large parameters
/// in f32 (and 8 bytes per texel of environment maps whose samples move), whatever the number of
/// samples, the resolution and the depth; as much again for texels, 64 at a time, that see contributions
/// 4e-9 times as large as the largest adjoint of a path, or smaller, or 4096 times, or larger. Every derivative is good
/// relative to what it is the sum of, whatever the others are. The result depends on the arguments only, not
/// on the number of threads.
///
/// # Does not handle
/// What the [`Capabilities`](crate::estimator::Capabilities) of the strategy say that it does not see.
///
/// # Errors
/// Values of parameters or an adjoint image of the wrong size; an estimator that the scene's discontinuities would bias
/// ([`Scene::admits`](crate::Scene::admits)), or that has no terms for what moves.
///
/// # Reference
/// [Stam 2020, section 5.1] with errata S-5.1 and S-D3 to S-D6; [Zeltner 2021, algorithms 4.1 and 4.2] with
/// errata Z-4.15.
pub fn backward<P: Float, S: Unbiased, X: Sampler>(
    job: &Job,
    theta: &Theta<P>,
    active: &Active,
    adjoint: &[f32],
) -> Result<Gradient, RenderError> {
    let scene = job.scene;
    check_values(scene, theta)?;
    check_size("adjoint image", scene, adjoint)?;
    scene.admits::<S>()?;
    active.check_motion::<S>()?;
    for info in active.ranges() {
        scene.admits_outlines::<S>(info, job.settings.max_depth)?;
    }
    check::<S>(scene, job.settings, &active.ranges)?;
    let pass = Pass::of::<S>(job, theta);
    Ok(pass.gradient::<S::Runs, X>(active, adjoint))
}

impl<P: Float> Pass<'_, P> {
    /// The derivative of `<adjoint, image>`, once everything has been checked; see [`backward`].
    fn gradient<S: Strategy, X: Sampler>(&self, active: &Active, adjoint: &[f32]) -> Gradient {
        let moving = S::EmitterMotion::KEEPS.then(|| active.clone().with_sums(self.scene));
        let active = moving.as_ref().unwrap_or(active);
        collect(
            self.scene,
            active,
            self.largest(adjoint),
            self.progress,
            &|large| {
                let mut question = GradientOf {
                    pass: self,
                    active,
                    adjoint,
                    large,
                    sums: GradientSums::zero(active),
                };
                let wanted = Wanted {
                    finders: self.finders(),
                    light: active.rests(),
                    motion: active.moves(),
                };
                every::<S, X>(wanted, self.progress, &mut question);
                question.sums
            },
        )
    }
}

/// A gradient that is asked of every integral.
struct GradientOf<'a, P: Float> {
    pass: &'a Pass<'a, P>,
    active: &'a Active,
    adjoint: &'a [f32],
    large: &'a ExactBuffer,
    sums: GradientSums,
}

impl<P: Float, S: Strategy, X: Sampler> Question<S, X> for GradientOf<'_, P> {
    fn ask<I: Integral<S, X>>(&mut self, progress: &dyn Progress) {
        let pass = self.pass.reporting(progress);
        let part = I::gradient(&pass, self.active, self.adjoint, self.large);
        self.sums.merge(part);
    }
}
