//! Reverse mode of the light tracer: recorded particles and their adjoint.
//!
//! The mirror image of [`super::record`]. There, radiance flows back along a path from the camera and
//! meets its adjoint; here the importance of the adjoint image flows back along a particle,
//! `W_k = connected_k + f_k w_k W_(k+1)`, and meets its power. It is the same sum over paths, taken
//! from the other end: adjoint radiance *is* importance [Stam 2020].

use std::cell::Cell;
use std::ops::Range;

use ad_core::{Float, Vec2, Vec3};

use super::gradient::{self, Active, ExactBuffer, Gradient, Sink, check_size, exactly, largest_of};
use super::particle::{Bounce, Connected, Context, Observer, follow, pixels};
use super::render::{NonFinite, Progress};
use crate::bsdf::differential::Part;
use crate::bsdf::{Bsdf, Component, Shading, TransportMode, Use};
use crate::emitter::{Emission, Emitter};
use crate::error::RenderError;
use crate::film::Film;
use crate::math::Rgb;
use crate::parallel;
use crate::sampler::Sampler;
use crate::scene::Intersection;

/// Particles are split into this many jobs, whatever the number of threads, and their sums are added in
/// order.
const JOBS: usize = 128;

#[derive(Clone, Copy, Debug)]
struct Vertex<P: Float> {
    beta: Rgb<P>,
    shape: u32,
    uv: Vec2<P>,
    wo: Vec3<P>,
    connected: Option<(Vec3<P>, Connected<P>)>,
    bounce: Option<Bounce<P>>,
    /// Samples of the change of normals, in the recorder's list: the first, and how many.
    normals: (u32, u32),
}

/// Keeps the vertices of one particle at a time.
#[derive(Clone, Debug)]
struct Recorder<'a, P: Float> {
    sensor: &'a Sensor<'a>,
    active: &'a Active,
    emitted: Option<(u32, Emission<P>, P)>,
    seen: Option<(u32, Emission<P>, Connected<P>)>,
    vertices: Vec<Vertex<P>>,
    normals: Vec<(Vec3<P>, Rgb<P>)>,
}

impl<P: Float> Observer<P> for Recorder<'_, P> {
    #[inline]
    fn follows_normals(&self, material: u32) -> bool {
        self.active.roughness_active(material)
    }
    fn importance(&self, at: [P; 2]) -> Rgb<P> {
        self.sensor.importance(at)
    }
    fn normals(&mut self, wi: Vec3<P>, w: Rgb<P>) {
        self.normals.push((wi, w));
        if let Some(v) = self.vertices.last_mut() {
            v.normals.1 += 1;
        }
    }
    fn emitted(&mut self, emitter: u32, emission: Emission<P>, weight: P) {
        self.emitted = Some((emitter, emission, weight));
    }
    fn seen(&mut self, emitter: u32, emission: Emission<P>, connected: Connected<P>) {
        self.seen = Some((emitter, emission, connected));
    }
    #[inline]
    fn vertex(&mut self, _depth: u32, beta: Rgb<P>, hit: &Intersection<P>, wo: Vec3<P>) {
        self.vertices.push(Vertex {
            beta,
            shape: hit.shape,
            uv: hit.si.uv,
            wo,
            connected: None,
            bounce: None,
            normals: (self.normals.len() as u32, 0),
        });
    }
    #[inline]
    fn connected(&mut self, wi: Vec3<P>, connected: Connected<P>) {
        if let Some(v) = self.vertices.last_mut() {
            v.connected = Some((wi, connected));
        }
    }
    #[inline]
    fn bounce(&mut self, bounce: Bounce<P>) {
        if let Some(v) = self.vertices.last_mut() {
            v.bounce = Some(bounce);
        }
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

impl<'a, P: Float> Recorder<'a, P> {
    fn new(sensor: &'a Sensor, active: &'a Active) -> Self {
        Self {
            sensor,
            active,
            emitted: None,
            seen: None,
            vertices: Vec::new(),
            normals: Vec::new(),
        }
    }

    /// Whether every value that the adjoint is made of is.
    fn is_finite(&self) -> bool {
        let vertices = self.vertices.iter().all(|v| {
            let connected = v
                .connected
                .is_none_or(|(_, c)| (v.beta * c.f * c.weight).is_finite());
            connected && v.beta.is_finite() && v.bounce.is_none_or(|b| (b.f * b.weight).is_finite())
        });
        vertices && self.normals.iter().all(|(_, w)| w.is_finite())
    }

    fn clear(&mut self) {
        self.emitted = None;
        self.seen = None;
        self.vertices.clear();
        self.normals.clear();
    }

    /// Adds the derivative of the recorded particle's part of `<adjoint, image>` and returns that part.
    fn backward(&self, context: &Context<P>, grad: &mut Sink) -> f64 {
        let Context { scene, theta, .. } = *context;
        let sensor = self.sensor;
        let mut w = Rgb::<P>::black(); // importance arriving at the next vertex
        for v in self.vertices.iter().rev() {
            let mut here = Rgb::black();
            let mut uses = [Use {
                wi: Vec3::zero(),
                component: Component::Continuous,
                part: Part::All,
                d: Rgb::black(),
            }; 2];
            let material = scene.shape_info(v.shape).material;
            let active = self.active.material_active(material);
            let at = Shading {
                theta: *theta,
                uv: v.uv,
            };
            let mut mode = TransportMode::Importance;
            if let Some((wi, c)) = &v.connected {
                let s = sensor.importance(c.at) * c.weight;
                here += c.f * s;
                uses[0].wi = *wi;
                uses[0].d = v.beta * s;
                mode = context.rules.mode(mode, [v.wo, *wi], Component::Continuous);
                if active {
                    let m = &scene.materials()[material as usize];
                    m.backward(&at, v.wo, &uses[..1], mode, grad);
                }
            }
            let (first, count) = (v.normals.0 as usize, v.normals.1 as usize);
            for (wi, w) in &self.normals[first..first + count] {
                let change = Use {
                    wi: *wi,
                    component: Component::Continuous,
                    part: Part::Normals,
                    d: v.beta * *w,
                };
                let m = &scene.materials()[material as usize];
                m.backward(&at, v.wo, &[change], TransportMode::Importance, grad);
            }
            if let Some(b) = &v.bounce {
                here += b.f * w * b.weight;
                if active && !w.is_black() {
                    uses[1] = Use {
                        wi: b.wi,
                        component: b.component,
                        part: b.part,
                        d: v.beta * w * b.weight,
                    };
                    let m = &scene.materials()[material as usize];
                    m.backward(&at, v.wo, &uses[1..], b.mode, grad);
                }
            }
            w = here;
        }
        let mut total = P::zero();
        if let Some((emitter, emission, weight)) = &self.emitted {
            let e = &scene.emitters()[*emitter as usize];
            total += (e.eval(theta, emission) * w * *weight).sum();
            if self.active.emitter_active(*emitter) {
                e.backward(emission, w * *weight, grad);
            }
        }
        if let Some((emitter, emission, c)) = &self.seen {
            let s = sensor.importance(c.at) * c.weight;
            total += (c.f * s).sum();
            if self.active.emitter_active(*emitter) {
                scene.emitters()[*emitter as usize].backward(emission, s, grad);
            }
        }
        total.to_f64()
    }
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
/// An adjoint image of the wrong size.
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
    let pass = Pass::new(context, adjoint, seed, samples);
    let value = Cell::new(0.0);
    let gradient = exactly(context.scene, active, pass.largest(), progress, &|large| {
        let sums = pass.sums::<X>(active, large, progress);
        value.set(sums.value);
        gradient::Sums {
            small: sums.small,
            non_finite: sums.non_finite,
            noise: None,
        }
    });
    Ok(Measurement {
        value: value.get(),
        gradient,
    })
}

/// The recorded particles of an image.
pub(super) struct Pass<'a, P: Float> {
    context: &'a Context<'a, P>,
    sensor: Sensor<'a>,
    seed: u64,
    samples: Range<u64>,
}

/// What a [`Pass`] adds up.
pub(super) struct Sums {
    /// Derivatives with respect to the small ranges.
    pub small: Vec<f64>,
    /// The measurement itself.
    pub value: f64,
    /// What went wrong.
    pub non_finite: NonFinite,
}

impl<'a, P: Float> Pass<'a, P> {
    /// As the arguments of [`backward`].
    pub(super) fn new(
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

    /// Follows all particles. The large ranges are added to `large`.
    pub(super) fn sums<X: Sampler>(
        &self,
        active: &Active,
        large: &ExactBuffer,
        progress: &dyn Progress,
    ) -> Sums {
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
                follow::<P, X, Recorder<P>>(
                    context,
                    &Recorder::new(&self.sensor, active),
                    self.seed,
                    first + start..first + end.min(start + 4096),
                    |_, _, _| {},
                    |i, recorder| {
                        if recorder.is_finite() {
                            value += recorder.backward(context, &mut sink);
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
            Sums {
                small: sink.into_small(),
                value,
                non_finite,
            }
        });
        let mut sums = Sums {
            small: Vec::new(),
            value: 0.0,
            non_finite: NonFinite::default(),
        };
        for part in &parts {
            sums.small.resize(part.small.len(), 0.0);
            let small = sums.small.iter_mut().zip(&part.small);
            small.for_each(|(s, p)| *s += p);
            sums.value += part.value;
            sums.non_finite.merge(&part.non_finite);
        }
        sums
    }
}
