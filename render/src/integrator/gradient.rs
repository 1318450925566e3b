//! Reverse mode: the adjoint of an image, pulled back to the parameters.

use std::marker::PhantomData;
use std::ops::Range;

use ad_core::{Float, Real};

pub use super::active::Active;
use super::exact::ExactBuffer;
use super::local::LocalFn;
use super::noise::{Noise, PixelNoise};
use super::pass::{Integral, Pass, Question, every};
use super::path::Context;
use super::record::Recorder;
use super::render::{NonFinite, Paths, Progress, Sample, is_single, place, start};
use super::sink::{GradientSums, Sink, add, collect};
use super::wave::{self, LayerAdjoints, Record, Wave};
use crate::error::RenderError;
use crate::estimator::memory::Memory;
use crate::estimator::{self, Sampling, Strategy, Unbiased};
use crate::math::Rgb;
use crate::parallel;
use crate::params::Theta;
use crate::sampler::Sampler;
use crate::scene::{Caustics, Scene, Settings};

/// The image is split into this many jobs, whatever the number of threads, and their sums are added in
/// order.
const JOBS: usize = 128;

/// The derivative of `<adjoint, image>`.
#[derive(Clone, Debug)]
pub struct Gradient {
    /// One slice per range of the [`Active`] set, in its order.
    pub values: Vec<Vec<f64>>,
    /// What went wrong.
    pub non_finite: NonFinite,
    /// How noisy the derivatives are, if somebody wants to know ([`Active::with_noise`]).
    pub noise: Option<Noise>,
    /// Whether it was stopped early; the sums are then incomplete.
    pub cancelled: bool,
}

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
/// Geometry, and deltas in the parameter: detached sampling.
///
/// # Errors
/// An adjoint image of the wrong size; an estimator that the scene's discontinuities would bias
/// ([`estimator::check`]).
///
/// # Reference
/// [Stam 2020, section 5.1] with errata S-5.1 and S-D3 to S-D6; [Zeltner 2021, algorithms 4.1 and 4.2] with
/// errata Z-4.15.
pub fn backward<P: Float, S: Unbiased, X: Sampler>(
    scene: &Scene,
    theta: &Theta<P>,
    active: &Active,
    adjoint: &[f32],
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Gradient, RenderError> {
    check_size("adjoint image", scene, adjoint)?;
    estimator::check::<S>(scene)?;
    let pass = Pass {
        scene,
        theta,
        settings,
        caustics: settings.caustics_of::<S>(scene),
        seed,
        samples,
        progress,
    };
    Ok(pass.gradient::<S::Runs, X>(active, adjoint))
}

/// Whether an image with three channels has the size of the film.
///
/// # Errors
/// It has not.
pub(crate) fn check_size(
    what: &'static str,
    scene: &Scene,
    image: &[f32],
) -> Result<(), RenderError> {
    let (expected, found) = (scene.film.pixels() * 3, image.len());
    if expected == found {
        return Ok(());
    }
    Err(RenderError::WrongLength {
        what,
        expected,
        found,
    })
}

/// The largest magnitude of an entry.
pub(super) fn largest_of(image: &[f32]) -> f64 {
    image.iter().fold(0.0, |m, &a| m.max(f64::from(a.abs())))
}

impl<P: Float> Pass<'_, P> {
    /// The derivative of `<adjoint, image>`, once everything has been checked; see [`backward`].
    fn gradient<S: Strategy, X: Sampler>(&self, active: &Active, adjoint: &[f32]) -> Gradient {
        let moving = S::Aim::KEEPS.then(|| active.clone().with_sums(self.scene));
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
                every::<S, X>(self.caustics, self.progress, &mut question);
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

/// The paths of [`backward`]. The large ranges are added to `large`.
pub(super) fn of_paths<P: Float, S: Strategy, X: Sampler>(
    pass: &Pass<P>,
    active: &Active,
    adjoint: &[f32],
    large: &ExactBuffer,
) -> GradientSums {
    // In double precision, single paths check on waves.
    if const { wave::fits::<S>() && is_single::<P>() } && active.scales.is_empty() {
        return pass.sums_of_waves::<S, X>(active, adjoint, large);
    }
    let (scene, theta) = (pass.scene, pass.theta);
    let each =
        |context: &Context<P>, at: Sample, recorder: &mut Recorder<'_, P>, sink: &mut Sink| {
            let d = at.of_image::<P>(adjoint, scene) * P::of(at.scale());
            if S::Bsdf::DETACHED_PATH {
                recorder.backward::<S>(scene, theta, d, sink);
            } else {
                let again = Again::<P, S, X> {
                    pass,
                    at,
                    types: PhantomData,
                };
                recorder.backward_moving(context, &again, d, sink);
            }
            sink.finish(scene, at, recorder.work());
        };
    pass.sums::<S, X>(active, large, each)
}

impl<P: Float> Pass<'_, P> {
    /// All paths. The large ranges are added to `large`.
    pub fn sums<S: Strategy, X: Sampler>(
        &self,
        active: &Active,
        large: &ExactBuffer,
        each: impl Fn(&Context<P>, Sample, &mut Recorder<'_, P>, &mut Sink) + Sync,
    ) -> GradientSums {
        let new = || Sink::of_samples(active, large);
        let (parts, non_finite) = self.paths::<S, X, _>(active, JOBS, new, each);
        let mut small = vec![0.0; active.small_len];
        let mut noise = (!active.scales.is_empty()).then(|| Noise {
            pixels: vec![PixelNoise::default(); self.scene.film.pixels()],
            variances: vec![0.0; active.ranges.len()],
        });
        for part in parts {
            add(&mut small, &part.small);
            if let (Some(noise), Some(watch)) = (&mut noise, part.watch) {
                let (pixels, variances) = watch.finished();
                add(&mut noise.variances, &variances);
                for (pixel, found) in pixels {
                    noise.pixels[pixel] = found;
                }
            }
        }
        GradientSums {
            small,
            non_finite,
            noise,
        }
    }

    /// [`Pass::sums`] of the derivative of `<adjoint, image>`, by waves.
    fn sums_of_waves<S: Strategy, X: Sampler>(
        &self,
        active: &Active,
        adjoint: &[f32],
        large: &ExactBuffer,
    ) -> GradientSums {
        let (scene, context) = (self.scene, self.context());
        let tiles = self.tiles();
        let jobs = JOBS.min(tiles.len());
        let parts = parallel::map(jobs, |job| {
            let mut sink = Sink::new(active, large);
            let mut non_finite = NonFinite::default();
            let mut wave = Wave::<P, X>::new();
            let mut record = Record::of::<S>(active, scene, false);
            let mut adjoints = LayerAdjoints::of(scene, active, self.theta, &mut sink);
            for tile in tiles.iter().skip(job).step_by(jobs) {
                if self.progress.cancelled() {
                    break;
                }
                let begin = |record: &mut Record<'_, P>, which: &[(usize, Sample)]| {
                    let adjoint = |(_, at): &(usize, Sample)| {
                        at.of_image::<P>(adjoint, scene) * P::of(at.scale())
                    };
                    record.start(which.iter().map(adjoint));
                };
                let done = |record: &mut Record<'_, P>, which: &[(usize, Sample)], l: &[Rgb<P>]| {
                    for ((_, at), _) in which.iter().zip(l).filter(|(_, l)| !l.is_finite()) {
                        non_finite.add(place(scene, at.pixel) as u64, at.index);
                    }
                    record.differentiate::<S>(l, &mut adjoints);
                };
                tile.trace_waves::<P, S, X, _>(
                    &context,
                    self.seed,
                    &self.samples,
                    &mut wave,
                    &mut record,
                    begin,
                    done,
                );
                self.progress.advance(tile.pixels() as u64);
            }
            (sink.into_small(), non_finite)
        });
        let mut sums = GradientSums::zero(active);
        for (small, non_finite) in parts {
            sums.merge(GradientSums {
                small,
                non_finite,
                noise: None,
            });
        }
        sums
    }

    /// Records every path, as far as the parameters `active` matter to it, and calls `each` with it, pixel by
    /// pixel within a tile. The tiles are shared by `jobs` states, whatever the number of threads.
    pub fn paths<S: Strategy, X: Sampler, J: Send>(
        &self,
        active: &Active,
        jobs: usize,
        new: impl Fn() -> J + Sync,
        each: impl Fn(&Context<P>, Sample, &mut Recorder<'_, P>, &mut J) + Sync,
    ) -> (Vec<J>, NonFinite) {
        let (context, tiles) = (self.context(), self.tiles());
        let jobs = jobs.min(tiles.len());
        let parts = parallel::map(jobs, |job| {
            let mut state = new();
            let mut paths = Paths::<P, S, X, _>::new(Recorder::of(active));
            let mut non_finite = NonFinite::default();
            for tile in tiles.iter().skip(job).step_by(jobs) {
                if self.progress.cancelled() {
                    break;
                }
                let done = |_, sample: Sample, l: Rgb<P>, recorder: &mut Recorder<'_, P>| {
                    if l.is_finite() {
                        each(&context, sample, recorder, &mut state);
                    } else {
                        non_finite.add(place(self.scene, sample.pixel) as u64, sample.index);
                    }
                    recorder.clear();
                };
                tile.trace(&context, self.seed, &self.samples, &mut paths, done);
                self.progress.advance(tile.pixels() as u64);
            }
            (state, non_finite)
        });
        let mut non_finite = NonFinite::default();
        let join = |(state, bad)| {
            non_finite.merge(&bad);
            state
        };
        (parts.into_iter().map(join).collect(), non_finite)
    }
}

/// The radiance of one sample as a function of the parameters: its path once more, moving.
struct Again<'a, P: Float, S, X> {
    pass: &'a Pass<'a, P>,
    at: Sample,
    types: PhantomData<fn() -> (S, X)>,
}

impl<P: Float, S: Strategy, X: Sampler> LocalFn<P> for Again<'_, P, S, X> {
    fn eval<R: Real<Primal = P>>(&self, theta: &Theta<R>) -> Rgb<R> {
        let Pass {
            scene,
            settings,
            seed,
            ..
        } = *self.pass;
        let context = Context {
            scene,
            theta,
            settings,
            shifts: &[],
            caustics: Caustics::Paths,
            progress: self.pass.progress,
        };
        start::<R, S, X>(scene, settings.points, seed, self.at.pixel, self.at.index)
            .finish(&context, &mut ())
    }
}
