//! Reverse mode: the adjoint of an image, pulled back to the parameters.

use std::marker::PhantomData;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};

use ad_core::{Float, Real};
use rayon::prelude::*;

use super::local::LocalFn;
use super::path::Context;
use super::record::{Activity, Recorder};
use super::render::{NonFinite, Paths, Progress, start, tiles};
use crate::error::RenderError;
use crate::estimator::{self, DetachedMis, Sampling, Strategy, Unbiased};
use crate::math::Rgb;
use crate::params::{GradSink, ParamInfo, ParamRef, Theta};
use crate::sampler::Sampler;
use crate::scene::{Scene, Settings};

/// Ranges of up to this many values are summed in f64 per job; larger ones share one exact buffer.
const SMALL: usize = 256;

/// The image is split into this many jobs, whatever the number of threads, and their sums are added in
/// order.
const JOBS: usize = 128;

/// Parameters to differentiate with respect to, and who reads them.
#[derive(Clone, Debug)]
pub struct Active {
    /// Names and places, in the order asked for.
    ranges: Vec<ParamInfo>,
    /// Per range of the layout: where its gradient goes.
    slots: Vec<Slot>,
    materials: Vec<bool>,
    emitters: Vec<bool>,
    small_len: usize,
    large_len: usize,
}

#[derive(Clone, Copy, Debug)]
enum Slot {
    Inactive,
    Small(u32),
    Large(u32),
}

impl Active {
    /// The named parameters of a scene.
    ///
    /// # Errors
    /// An unknown name, or a parameter whose derivative detached sampling cannot see.
    pub fn new<N: AsRef<str>>(scene: &Scene, names: &[N]) -> Result<Self, RenderError> {
        Self::seen_by::<DetachedMis, N>(scene, names)
    }

    /// The same for another estimator: a path that moves has derivatives in deltas too.
    ///
    /// # Errors
    /// As [`Active::new`], for what this estimator cannot see.
    pub fn seen_by<S: Strategy, N: AsRef<str>>(
        scene: &Scene,
        names: &[N],
    ) -> Result<Self, RenderError> {
        let params = scene.params();
        let mut slots = vec![Slot::Inactive; params.infos().len()];
        let mut ranges: Vec<ParamInfo> = Vec::new();
        let (mut small_len, mut large_len) = (0, 0);
        for name in names {
            let info = params.find(name.as_ref())?;
            estimator::check_parameter::<S>(info)?;
            if ranges.iter().any(|r| r.name == info.name) {
                continue;
            }
            let len = info.shape.len();
            slots[params.handle(info).id as usize] = if len <= SMALL {
                small_len += len;
                Slot::Small((small_len - len) as u32)
            } else {
                large_len += len;
                Slot::Large((large_len - len) as u32)
            };
            ranges.push(info.clone());
        }
        let on = |p: ParamRef| !matches!(slots[p.id as usize], Slot::Inactive);
        let materials = scene.materials_with(on);
        let emitters = scene
            .emitters()
            .iter()
            .map(|e| crate::emitter::Emitter::radiance(e).any_param(on))
            .collect();
        Ok(Self {
            ranges,
            slots,
            materials,
            emitters,
            small_len,
            large_len,
        })
    }

    /// The ranges, in the order asked for.
    pub fn ranges(&self) -> &[ParamInfo] {
        &self.ranges
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.small_len + self.large_len
    }

    /// Whether there is nothing to differentiate.
    pub fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }
}

/// The derivative of `<adjoint, image>`.
#[derive(Clone, Debug)]
pub struct Gradient {
    /// One slice per range of the [`Active`] set, in its order.
    pub values: Vec<Vec<f64>>,
    /// What went wrong.
    pub non_finite: NonFinite,
    /// Whether it was stopped early; the sums are then incomplete.
    pub cancelled: bool,
}

/// A sum of many numbers that does not depend on their order: fixed-point integers.
///
/// A quantum of 2^-36 of the largest adjoint keeps 1e-8 of a contribution of a thousandth of it, and
/// leaves room for 6e7 of the largest; more than that is noticed, and the pass repeated with a
/// coarser quantum.
pub(super) struct ExactBuffer {
    cells: Vec<AtomicI64>,
    scale: f64,
    overflow: AtomicBool,
}

impl ExactBuffer {
    fn new(len: usize, largest: f64, bits: i32) -> Self {
        let quantum = largest.max(f64::MIN_POSITIVE * 1e20) * f64::from(-bits).exp2();
        Self {
            cells: (0..len).map(|_| AtomicI64::new(0)).collect(),
            scale: 1.0 / quantum,
            overflow: AtomicBool::new(false),
        }
    }

    #[inline]
    fn add(&self, i: usize, d: f64) {
        const LIMIT: f64 = (1u64 << 61) as f64;
        let q = d * self.scale;
        if q.abs() < LIMIT {
            let old = self.cells[i].fetch_add(q.round_ties_even() as i64, Ordering::Relaxed);
            if old.unsigned_abs() < 1 << 61 {
                return;
            }
        }
        self.overflow.store(true, Ordering::Relaxed);
    }

    fn get(&self, i: usize) -> f64 {
        self.cells[i].load(Ordering::Relaxed) as f64 / self.scale
    }
}

/// Where one job's adjoints go.
pub(super) struct Sink<'a> {
    active: &'a Active,
    small: Vec<f64>,
    large: &'a ExactBuffer,
}

impl<'a> Sink<'a> {
    pub(super) fn new(active: &'a Active, large: &'a ExactBuffer) -> Self {
        Self {
            active,
            small: vec![0.0; active.small_len],
            large,
        }
    }

    /// Sums of the small ranges.
    pub(super) fn into_small(self) -> Vec<f64> {
        self.small
    }
}

impl<P: Float> GradSink<P> for Sink<'_> {
    #[inline]
    fn active(&self, p: ParamRef) -> bool {
        !matches!(self.active.slots[p.id as usize], Slot::Inactive)
    }
    #[inline]
    fn add(&mut self, p: ParamRef, i: usize, d: P) {
        match self.active.slots[p.id as usize] {
            Slot::Inactive => {}
            Slot::Small(at) => self.small[at as usize + i] += d.to_f64(),
            Slot::Large(at) => self.large.add(at as usize + i, d.to_f64()),
        }
    }
}

impl Activity for Sink<'_> {
    #[inline]
    fn material_active(&self, material: u32) -> bool {
        self.active.materials[material as usize]
    }
    #[inline]
    fn emitter_active(&self, emitter: u32) -> bool {
        self.active.emitters[emitter as usize]
    }
}

/// The derivative of `sum over pixels and channels of adjoint x image`, where the image is the mean
/// over the samples `samples` of each pixel with seed `seed`: one pass, all parameters.
///
/// `adjoint` is `[height][width][3]`, the size of the film's crop window. To be unbiased for a loss
/// that is not linear, it must come from an image with another seed (errata Z-4.4).
///
/// Memory: the recorded path of one sample per thread, and twice the size of the large parameters
/// in f32, whatever the number of samples, the resolution and the depth. The result depends on the arguments
/// only, not on the number of threads.
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
    progress: &impl Progress,
) -> Result<Gradient, RenderError> {
    if adjoint.len() != scene.film.pixels() * 3 {
        return Err(RenderError::WrongLength {
            what: "adjoint image",
            expected: scene.film.pixels() * 3,
            found: adjoint.len(),
        });
    }
    estimator::check::<S>(scene)?;
    let spp = samples.end.saturating_sub(samples.start).max(1);
    let largest = adjoint
        .iter()
        .fold(0.0f64, |m, &a| m.max(f64::from(a.abs())))
        / spp as f64;
    let pass = Pass {
        scene,
        theta,
        active,
        adjoint,
        settings,
        seed,
        samples,
    };
    Ok(exactly(scene, active, largest, progress, |large| {
        pass.run::<S, X>(large, progress)
    }))
}

/// Repeats `pass`, which gives the sums of the small ranges, until the large ones fit their integers.
/// `largest` is the magnitude of the largest adjoint of one path.
pub(super) fn exactly(
    scene: &Scene,
    active: &Active,
    largest: f64,
    progress: &impl Progress,
    pass: impl Fn(&ExactBuffer) -> (Vec<f64>, NonFinite),
) -> Gradient {
    let mut bits = 36;
    loop {
        let large = ExactBuffer::new(active.large_len, largest, bits);
        let (small, non_finite) = pass(&large);
        if large.overflow.load(Ordering::Relaxed) && bits > 0 {
            bits -= 12;
            continue;
        }
        let values = active
            .ranges
            .iter()
            .map(|r| {
                let id = scene.params().handle(r).id as usize;
                let len = r.shape.len();
                match active.slots[id] {
                    Slot::Inactive => Vec::new(),
                    Slot::Small(at) => small[at as usize..at as usize + len].to_vec(),
                    Slot::Large(at) => (0..len).map(|i| large.get(at as usize + i)).collect(),
                }
            })
            .collect();
        return Gradient {
            values,
            non_finite,
            cancelled: progress.cancelled(),
        };
    }
}

struct Pass<'a, P: Float> {
    scene: &'a Scene,
    theta: &'a Theta<'a, P>,
    active: &'a Active,
    adjoint: &'a [f32],
    settings: &'a Settings,
    seed: u64,
    samples: Range<u64>,
}

impl<P: Float> Pass<'_, P> {
    /// Sums of the small ranges.
    fn run<S: Unbiased, X: Sampler>(
        &self,
        large: &ExactBuffer,
        progress: &impl Progress,
    ) -> (Vec<f64>, NonFinite) {
        let [width, height] = self.scene.film.crop_size;
        let tiles = tiles(width, height);
        let jobs = JOBS.min(tiles.len());
        let spp = self.samples.end.saturating_sub(self.samples.start).max(1);
        let scale = P::of(1.0 / spp as f64);
        let parts: Vec<_> = (0..jobs)
            .into_par_iter()
            .map(|job| {
                let mut sink = Sink::new(self.active, large);
                let context = Context {
                    scene: self.scene,
                    theta: self.theta,
                    settings: self.settings,
                };
                let mut paths = Paths::<P, S, X, Recorder<P>>::default();
                let mut non_finite = NonFinite::default();
                for tile in tiles.iter().skip(job).step_by(jobs) {
                    if progress.cancelled() {
                        break;
                    }
                    let done = |at, index, l: Rgb<P>, recorder: &mut Recorder<P>| {
                        let [x, y] = tile.pixel(at);
                        let pixel = y * width + x;
                        if l.is_finite() {
                            let i = pixel as usize * 3;
                            let a: [P; 3] =
                                std::array::from_fn(|c| P::from_f32(self.adjoint[i + c]));
                            let d = Rgb::from(a) * scale;
                            if S::Bsdf::DETACHED_PATH {
                                recorder.backward::<S>(self.scene, self.theta, d, &mut sink);
                            } else {
                                let again = Again::<P, S, X> {
                                    pass: self,
                                    pixel: [x, y],
                                    index,
                                    types: PhantomData,
                                };
                                recorder.backward_moving(&context, &again, d, &mut sink);
                            }
                        } else {
                            non_finite.add(u64::from(pixel), index);
                        }
                        recorder.clear();
                    };
                    tile.trace(&context, self.seed, &self.samples, &mut paths, done);
                    progress.advance(tile.pixels() as u64);
                }
                (sink.small, non_finite)
            })
            .collect();
        let mut small = vec![0.0; self.active.small_len];
        let mut non_finite = NonFinite::default();
        for (part, bad) in &parts {
            small.iter_mut().zip(part).for_each(|(s, p)| *s += p);
            non_finite.merge(bad);
        }
        (small, non_finite)
    }
}

/// The radiance of one sample as a function of the parameters: its path once more, moving.
struct Again<'a, P: Float, S, X> {
    pass: &'a Pass<'a, P>,
    pixel: [u32; 2],
    index: u64,
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
        };
        start::<R, S, X>(scene, seed, self.pixel, self.index).finish(&context, &mut ())
    }
}
