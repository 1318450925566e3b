//! Reverse mode of the light tracer: recorded particles and their adjoint.
//!
//! [`super::record`] serves paths from both ends. Along a path from the camera, radiance flows back and meets its adjoint;
//! along a particle the importance of the adjoint image flows back, `W_k = seen_k + f_k w_k W_(k+1)`, and meets its power. It
//! is the same sum over paths, taken from the other end: adjoint radiance *is* importance [Stam 2020].

use std::cell::Cell;
use std::ops::Range;

use ad_core::{Float, Real};

use super::active::Active;
use super::exact::ExactBuffer;
use super::particle::{self, Context, ParticleObserver, pixels, trace_particles};
use super::pass::Pass;
use super::progress::Progress;
use super::record::{Contribution, Interest, Observer, PathRecord, Place, Recorder};
use super::rendering::{Components, NonFinite, Rendering};
use super::sink::{Gradient, GradientSums, Sink, check_size, collect, largest_of};
use crate::error::RenderError;
use crate::estimator::{DetachedMis, Sampling, Strategy};
use crate::film::Film;
use crate::math::Rgb;
use crate::parallel;
use crate::sampler::Sampler;

/// Particles are split into this many jobs, whatever the number of threads, and their sums are added in
/// order.
const JOBS: usize = 128;

/// Keeps one particle at a time, and what the adjoint image makes of it.
#[derive(Clone, Debug)]
struct ParticleRecorder<'a, P: Float> {
    sensor: &'a Sensor<'a>,
    recorder: Recorder<'a, P>,
}

impl<P: Float> Interest for ParticleRecorder<'_, P> {
    #[inline]
    fn differentiates_roughness(&self, material: u32) -> bool {
        self.recorder.differentiates_roughness(material)
    }
}

impl<P: Float> Observer<P> for ParticleRecorder<'_, P> {
    #[inline]
    fn vertex(&mut self, beta: Rgb<P>, place: &Place<P>) {
        self.recorder.vertex(beta, place);
    }
    #[inline]
    fn contribution(&mut self, contribution: Contribution<P>) {
        self.recorder.contribution(contribution);
    }
}

impl<P: Float> ParticleObserver<P> for ParticleRecorder<'_, P> {
    fn importance(&self, at: [P; 2]) -> Rgb<P> {
        self.sensor.importance(at)
    }
}

/// The adjoint image as the camera's emitted importance.
#[derive(Debug)]
struct Sensor<'a> {
    film: &'a Film,
    adjoint: &'a [f32],
    /// One over the number of particles.
    scale: f64,
}

impl Sensor<'_> {
    /// What a unit of light at `at` changes.
    fn importance<P: Float>(&self, at: [P; 2]) -> Rgb<P> {
        let mut sum = [0.0; 3];
        let rows = 0..self.film.crop_size[1];
        (self.film).splat(at.map(|x| x.to_f64()), rows, |pixel, weight| {
            let adjoint = &self.adjoint[pixel * 3..pixel * 3 + 3];
            for (sum, &a) in sum.iter_mut().zip(adjoint) {
                *sum += f64::from(a) * weight;
            }
        });
        Rgb::of(sum.map(|x| x * self.scale))
    }
}

/// Whether every value that the adjoint of a particle is made of is finite.
fn is_finite<P: Float>(path: &PathRecord<P>) -> bool {
    let vertices = path.vertices().iter().enumerate();
    vertices.into_iter().all(|(k, vertex)| {
        let finite = |contribution: &Contribution<P>| match contribution {
            Contribution::Seen(s) => (vertex.beta * s.f * s.importance).is_finite(),
            Contribution::Scattered(b) => (b.f * b.weight).is_finite(),
            Contribution::Normals(n) => n.li.is_finite(),
            _ => true,
        };
        vertex.beta.is_finite() && path.contributions(k).iter().all(finite)
    })
}

/// What the particles of a pass have in common: those that find caustics.
fn caustics<'a, R: Real, S: Strategy>(pass: &'a Pass<'a, R>) -> Context<'a, R> {
    let context = Context::caustics(pass.scene, pass.theta, pass.settings);
    Context {
        differential: S::Bsdf::DIFFERENTIAL,
        progress: pass.progress,
        ..context
    }
}

/// Caustics: [`super::pass::Integral::image`].
pub(super) fn image<R: Components, S: Strategy, X: Sampler>(pass: &Pass<R>) -> Rendering {
    let context = caustics::<_, S>(pass);
    particle::render::<R, X>(&context, pass.seed, pass.samples.clone(), pass.progress)
}

/// The derivative of caustics: [`super::pass::Integral::gradient`].
pub(super) fn gradient<P: Float, S: Strategy, X: Sampler>(
    pass: &Pass<P>,
    active: &Active,
    adjoint: &[f32],
    large: &ExactBuffer,
) -> GradientSums {
    let context = caustics::<_, S>(pass);
    let particles = ParticlePass::new(&context, adjoint, pass.seed, pass.samples.clone());
    let (sums, _) = particles.sums::<X>(active, large, pass.progress);
    sums
}

/// A measurement by particles: the inner product of an adjoint image and the image, and its gradient.
#[derive(Clone, Debug)]
pub struct Measurement {
    /// `<adjoint, image>`, summed where the particles start: emission times the importance that arrives
    /// there, `<W, L_e>`.
    pub value: f64,
    /// Its derivative.
    pub gradient: Gradient,
}

/// The derivative of `sum over pixels and channels of adjoint x image` by particles, as
/// [`super::gradient::backward`] gives it by paths: the arguments and the layout of the result are the same.
///
/// # Does not handle
/// Geometry, deltas in the parameter, and what a pinhole sees through deltas.
///
/// # Errors
/// An adjoint image of the wrong size, or parameters that move something.
///
/// # Reference
/// [Stam 2020, Eqs. 12 to 14]; [Veach 1996, section 2.4].
pub fn backward<P: Float, X: Sampler>(
    context: &Context<P>,
    active: &Active,
    adjoint: &[f32],
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Measurement, RenderError> {
    check_size("adjoint image", context.scene, adjoint)?;
    active.check_motion::<DetachedMis>()?;
    let particles = ParticlePass::new(context, adjoint, seed, samples);
    let value = Cell::new(0.0);
    let largest = particles.largest();
    let gradient = collect(context.scene, active, largest, progress, &|large| {
        let (sums, carried) = particles.sums::<X>(active, large, progress);
        value.set(carried);
        sums
    });
    Ok(Measurement {
        value: value.get(),
        gradient,
    })
}

/// The recorded particles of an image.
struct ParticlePass<'a, P: Float> {
    context: &'a Context<'a, P>,
    sensor: Sensor<'a>,
    seed: u64,
    samples: Range<u64>,
}

impl<'a, P: Float> ParticlePass<'a, P> {
    /// As the arguments of [`backward`].
    fn new(
        context: &'a Context<'a, P>,
        adjoint: &'a [f32],
        seed: u64,
        samples: Range<u64>,
    ) -> Self {
        let particles = samples.end.saturating_sub(samples.start) * context.per_sample;
        let sensor = Sensor {
            film: &context.scene.film,
            adjoint,
            scale: 1.0 / (particles.max(1) as f64),
        };
        Self {
            context,
            sensor,
            seed,
            samples,
        }
    }

    /// The largest adjoint of one particle.
    fn largest(&self) -> f64 {
        let spp = self.samples.end.saturating_sub(self.samples.start);
        let shared = pixels(self.context.scene) as f64 / self.context.per_sample as f64;
        largest_of(self.sensor.adjoint) * shared / spp.max(1) as f64
    }

    /// Follows all particles. The large ranges are added to `large`. The second result is the measurement itself.
    fn sums<X: Sampler>(
        &self,
        active: &Active,
        large: &ExactBuffer,
        progress: &dyn Progress,
    ) -> (GradientSums, f64) {
        let context = &Context {
            progress,
            ..*self.context
        };
        let n = context.per_sample;
        let total = self.samples.end.saturating_sub(self.samples.start) * n;
        let (first, step) = (self.samples.start * n, total.div_ceil(JOBS as u64).max(1));
        let pixels = self.sensor.film.pixels() as u64;
        let parts = parallel::map(JOBS, |job| {
            let job = job as u64;
            let mut sink = Sink::new(active, large);
            let mut non_finite = NonFinite::default();
            let mut value = 0.0;
            let (start, end) = ((job * step).min(total), (job * step + step).min(total));
            // In parts, to be stopped between them.
            for start in (start..end).step_by(4096) {
                if progress.cancelled() {
                    break;
                }
                let observer = ParticleRecorder {
                    sensor: &self.sensor,
                    recorder: Recorder::of(active),
                };
                trace_particles::<P, X, ParticleRecorder<P>>(
                    context,
                    &observer,
                    self.seed,
                    first + start..first + end.min(start + 4096),
                    |_, _, _| {},
                    |i, ParticleRecorder { recorder, .. }| {
                        if is_finite(&recorder.path) {
                            let (scene, theta) = (context.scene, context.theta);
                            let one = Rgb::splat(P::one());
                            let carried =
                                recorder.backward::<DetachedMis>(scene, theta, one, &mut sink);
                            value += carried.sum().to_f64();
                        } else {
                            non_finite.add(i % n, i / n);
                        }
                        recorder.clear();
                    },
                );
            }
            let done =
                |i: u64| (u128::from(pixels) * u128::from(i) / u128::from(total.max(1))) as u64;
            progress.advance(done(end) - done(start));
            let sums = GradientSums {
                small: sink.into_small(),
                non_finite,
                ..GradientSums::zero(active)
            };
            (sums, value)
        });
        let mut all = (GradientSums::zero(active), 0.0);
        for (sums, value) in parts {
            all.0.merge(sums);
            all.1 += value;
        }
        all
    }
}
