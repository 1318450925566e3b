//! Reverse mode: the adjoint of an image, pulled back to the parameters.

use std::marker::PhantomData;
use std::ops::Range;
use std::sync::Arc;

use ad_core::{Float, Real};

use super::exact::ExactBuffer;
use super::local::{ActiveTexture, LocalFn};
use super::noise::{Noise, PixelNoise, Watch};
use super::path::Context;
use super::record::{Recorder, SumSink};
use super::render::{
    InParts, NonFinite, Paths, Progress, Sample, Tile, is_single, place, start, tiles,
};
use super::wave::{self, LayerAdjoints, Record, Wave};
use super::{particle, particle_gradient};
use crate::bsdf::{Bsdf, Material, TextureRef};
use crate::emitter::{AnyEmitter, Emitter};
use crate::error::RenderError;
use crate::estimator::memory::Memory;
use crate::estimator::{self, DetachedMis, Sampling, Strategy, Unbiased};
use crate::math::Rgb;
use crate::parallel;
use crate::params::{GradSink, ParamInfo, ParamRef, Theta};
use crate::sampler::Sampler;
use crate::scene::{Caustics, Scene, Settings};

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
    /// Per range of the layout: its place in the values of all ranges, one after another.
    places: Vec<Option<u32>>,
    /// Per material: what of it reads one.
    textures: Vec<Vec<ActiveTexture>>,
    /// Per material: whether its roughness reads one.
    roughness: Vec<bool>,
    emitters: Vec<bool>,
    /// Whether any emitter does.
    emission: bool,
    /// Per emitter: where the adjoints of the sums go that its samples are made of. Empty unless samples of
    /// emitters move.
    sums: Vec<Option<SumSlot>>,
    /// Per range of the layout: its number among those asked for, and its scale. Empty unless the noise is asked for.
    scales: Vec<(usize, f64)>,
    small_len: usize,
    large_len: usize,
}

#[derive(Clone, Copy, Debug)]
enum Slot {
    Inactive,
    Small(u32),
    Large(u32),
}

/// Room for the adjoints of the sums of an emitter.
#[derive(Clone, Copy, Debug)]
struct SumSlot {
    /// All but the last one, which every sample depends on: that is summed in f64.
    slot: Slot,
    last: u32,
    len: usize,
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
        let found = names.iter().map(|name| {
            let info = scene.params().find(name.as_ref())?;
            estimator::check_parameter::<S>(info)?;
            Ok(info)
        });
        Ok(Self::of(scene, &found.collect::<Result<Vec<_>, _>>()?))
    }

    /// These parameters, each once.
    pub(crate) fn of(scene: &Scene, infos: &[&ParamInfo]) -> Self {
        let params = scene.params();
        let mut slots = vec![Slot::Inactive; params.infos().len()];
        let mut ranges: Vec<ParamInfo> = Vec::new();
        let mut places = vec![None; slots.len()];
        let (mut small_len, mut large_len) = (0, 0);
        for &info in infos {
            if ranges.iter().any(|r| r.name == info.name) {
                continue;
            }
            let len = info.shape.len();
            let id = params.handle(info).id as usize;
            places[id] = Some((small_len + large_len) as u32);
            slots[id] = if len <= SMALL {
                small_len += len;
                Slot::Small((small_len - len) as u32)
            } else {
                large_len += len;
                Slot::Large((large_len - len) as u32)
            };
            ranges.push(info.clone());
        }
        let on = |p: ParamRef| !matches!(slots[p.id as usize], Slot::Inactive);
        let textures = (scene.materials().iter()).map(|m| ActiveTexture::of(m, on));
        let textures = textures.collect();
        let rough = |m: &Arc<Material>| {
            let mut any = false;
            m.visit_textures(&mut |t| any |= matches!(t, TextureRef::Alpha(t) if t.any_param(on)));
            any
        };
        let roughness = scene.materials().iter().map(rough).collect();
        let emitters: Vec<bool> = scene
            .emitters()
            .iter()
            .map(|e| e.radiance().any_param(on))
            .collect();
        Self {
            ranges,
            slots,
            places,
            textures,
            roughness,
            emission: emitters.contains(&true),
            emitters,
            sums: Vec::new(),
            scales: Vec::new(),
            small_len,
            large_len,
        }
    }

    /// The same, and gradient passes tell their noise ([`Gradient::noise`]): derivatives in range `i` of
    /// [`Active::ranges`] are multiplied by `scales[i]`, and by one beyond its end.
    #[must_use]
    pub fn with_noise(mut self, scene: &Scene, scales: &[f64]) -> Self {
        self.scales = vec![(0, 0.0); self.slots.len()];
        for (i, r) in self.ranges.iter().enumerate() {
            let id = scene.params().handle(r).id as usize;
            self.scales[id] = (i, scales.get(i).copied().unwrap_or(1.0));
        }
        self
    }

    /// Who watches the noise of these, if somebody wants to know.
    fn watch(&self) -> Option<Watch> {
        if self.scales.is_empty() {
            return None;
        }
        let mut range = vec![0; self.small_len];
        for (slot, &(i, _)) in self.slots.iter().zip(&self.scales) {
            if let Slot::Small(at) = *slot {
                let len = self.ranges[i].shape.len();
                range[at as usize..][..len].fill(i as u32);
            }
        }
        Some(Watch::new(self.ranges.len(), range))
    }

    /// The same with room for the sums that moving samples of emitters are made of.
    fn with_sums(mut self, scene: &Scene) -> Self {
        let each = |e: &AnyEmitter| {
            let map = e.moving()?;
            let len = map.sums();
            let last = self.small_len as u32;
            self.small_len += 1;
            // Added up as the texels are.
            let slot = match self.slots[map.texels().id as usize] {
                Slot::Inactive => return None,
                Slot::Small(_) => {
                    self.small_len += len - 1;
                    Slot::Small(last + 1)
                }
                Slot::Large(_) => {
                    self.large_len += len - 1;
                    Slot::Large((self.large_len - (len - 1)) as u32)
                }
            };
            Some(SumSlot { slot, last, len })
        };
        self.sums = scene.emitters().iter().map(each).collect();
        self
    }

    /// The ranges, in the order asked for.
    pub fn ranges(&self) -> &[ParamInfo] {
        &self.ranges
    }

    /// What of a material reads one of them: a vertex where nothing does takes primal work only.
    #[inline]
    pub(super) fn textures(&self, material: u32) -> &[ActiveTexture] {
        &self.textures[material as usize]
    }

    /// Whether anything of a material does.
    #[inline]
    pub(super) fn follows(&self, material: u32) -> bool {
        !self.textures(material).is_empty()
    }

    /// Whether its roughness does.
    #[inline]
    pub(super) fn follows_normals(&self, material: u32) -> bool {
        self.roughness[material as usize]
    }

    /// Whether an emitter does.
    #[inline]
    pub(super) fn emitter_active(&self, emitter: u32) -> bool {
        self.emitters[emitter as usize]
    }

    /// Whether any emitter does.
    #[inline]
    pub(super) fn follows_light(&self) -> bool {
        self.emission
    }

    /// Whether the range is one of them.
    #[inline]
    pub(super) fn contains(&self, p: ParamRef) -> bool {
        self.place(p).is_some()
    }

    /// The first element of a range among the values of all ranges in the order asked for.
    #[inline]
    pub(super) fn place(&self, p: ParamRef) -> Option<usize> {
        self.places[p.id as usize].map(|at| at as usize)
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
    /// How noisy the derivatives are, if somebody wants to know ([`Active::with_noise`]).
    pub noise: Option<Noise>,
    /// Whether it was stopped early; the sums are then incomplete.
    pub cancelled: bool,
}

/// Where one job's adjoints go.
pub(super) struct Sink<'a> {
    active: &'a Active,
    small: Vec<f64>,
    large: &'a ExactBuffer,
    /// Where somebody wants to know the noise of pixels.
    watch: Option<Watch>,
}

impl<'a> Sink<'a> {
    pub(super) fn new(active: &'a Active, large: &'a ExactBuffer) -> Self {
        Self {
            active,
            small: vec![0.0; active.small_len],
            large,
            watch: None,
        }
    }

    /// The same for samples whose ends [`Sink::finish`] is told.
    fn of_samples(active: &'a Active, large: &'a ExactBuffer) -> Self {
        Self {
            watch: active.watch(),
            ..Self::new(active, large)
        }
    }

    /// What was added last belongs to this sample.
    #[inline]
    fn finish(&mut self, scene: &Scene, at: Sample, work: u32) {
        if let Some(watch) = &mut self.watch {
            watch.finish(place(scene, at.pixel), at.count, work);
        }
    }

    #[inline]
    fn put(&mut self, slot: Slot, i: usize, d: f64) {
        match slot {
            Slot::Inactive => {}
            Slot::Small(at) => self.small[at as usize + i] += d,
            Slot::Large(at) => self.large.add(at as usize + i, d),
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
        self.add_all(p, i, [d]);
    }
    #[inline(always)]
    fn add_all<const C: usize>(&mut self, p: ParamRef, i: usize, d: [P; C]) {
        let slot = self.active.slots[p.id as usize];
        for (c, d) in d.iter().enumerate() {
            self.put(slot, i + c, d.to_f64());
        }
        if let Some(watch) = &mut self.watch {
            let (range, scale) = self.active.scales[p.id as usize];
            for (c, d) in d.iter().enumerate() {
                let d = d.to_f64() * scale;
                match slot {
                    Slot::Inactive => {}
                    Slot::Small(at) => watch.add(at as usize + i + c, d),
                    Slot::Large(_) => watch.add_alone(range, d),
                }
            }
        }
    }
    #[inline(always)]
    fn expect(&mut self, p: ParamRef, i: usize) {
        if let Slot::Large(at) = self.active.slots[p.id as usize] {
            self.large.fetch(at as usize + i);
        }
    }
}

impl SumSink for Sink<'_> {
    #[inline]
    fn add_sum(&mut self, emitter: u32, sum: usize, d: f64) {
        let Some(Some(sums)) = self.active.sums.get(emitter as usize) else {
            return;
        };
        if sum + 1 == sums.len {
            self.small[sums.last as usize] += d;
        } else {
            self.put(sums.slot, sum, d);
        }
    }
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
    };
    Ok(pass.gradient::<S::Runs, X>(active, adjoint, progress))
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

/// What a pass adds up, besides the large ranges.
pub(super) struct Sums {
    /// Derivatives in the small ranges.
    pub small: Vec<f64>,
    pub non_finite: NonFinite,
    /// As [`Gradient::noise`].
    pub noise: Option<Noise>,
}

/// The gradient that `pass` adds up. `largest` is the magnitude of the largest adjoint of one path.
pub(super) fn exactly(
    scene: &Scene,
    active: &Active,
    largest: f64,
    progress: &dyn Progress,
    pass: &dyn Fn(&ExactBuffer) -> Sums,
) -> Gradient {
    let large = ExactBuffer::new(active.large_len, largest);
    let Sums {
        small,
        non_finite,
        noise,
    } = pass(&large);
    let read = |slot, len| match slot {
        Slot::Inactive => Vec::new(),
        Slot::Small(at) => small[at as usize..at as usize + len].to_vec(),
        Slot::Large(at) => large.get(at as usize..at as usize + len),
    };
    let mut values: Vec<Vec<f64>> = (active.ranges.iter())
        .map(|r| {
            let id = scene.params().handle(r).id as usize;
            read(active.slots[id], r.shape.len())
        })
        .collect();
    for (e, sums) in scene.emitters().iter().zip(&active.sums) {
        let (Some(map), Some(s)) = (e.moving(), sums) else {
            continue;
        };
        let mut sums = read(s.slot, s.len - 1);
        sums.push(small[s.last as usize]);
        for (r, values) in active.ranges.iter().zip(&mut values) {
            if scene.params().handle(r) == map.texels() {
                map.fold(&sums, values);
            }
        }
    }
    Gradient {
        values,
        non_finite,
        noise,
        cancelled: progress.cancelled(),
    }
}

/// Adds a part to sums.
fn add(sums: &mut [f64], part: &[f64]) {
    sums.iter_mut().zip(part).for_each(|(s, p)| *s += p);
}

/// The recorded paths of an image.
pub(super) struct Pass<'a, P: Float> {
    pub scene: &'a Scene,
    pub theta: &'a Theta<'a, P>,
    pub settings: &'a Settings,
    pub caustics: Caustics,
    pub seed: u64,
    pub samples: Range<u64>,
}

impl<P: Float> Pass<'_, P> {
    /// How many samples a pixel has.
    pub fn count(&self, pixel: usize) -> u64 {
        let samples = self.scene.pixel_shares().samples(pixel, &self.samples);
        samples.end - samples.start
    }

    /// The magnitude of the largest adjoint of one path.
    pub fn largest(&self, adjoint: &[f32]) -> f64 {
        let pixels = adjoint.chunks_exact(3).enumerate();
        let each = pixels.map(|(i, adjoint)| largest_of(adjoint) / self.count(i).max(1) as f64);
        each.fold(0.0, f64::max)
    }

    /// The derivative of `<adjoint, image>`, once everything has been checked; see [`backward`].
    fn gradient<S: Strategy, X: Sampler>(
        &self,
        active: &Active,
        adjoint: &[f32],
        progress: &dyn Progress,
    ) -> Gradient {
        let (scene, theta) = (self.scene, self.theta);
        let each =
            |context: &Context<P>, at: Sample, recorder: &mut Recorder<'_, P>, sink: &mut Sink| {
                let d = at.of_image::<P>(adjoint, scene) * P::of(at.scale());
                if S::Bsdf::DETACHED_PATH {
                    recorder.backward::<S>(scene, theta, d, sink);
                } else {
                    let again = Again::<P, S, X> {
                        pass: self,
                        at,
                        progress: context.progress,
                        types: PhantomData,
                    };
                    recorder.backward_moving(context, &again, d, sink);
                }
                sink.finish(scene, at, recorder.work());
            };
        let largest = self.largest(adjoint);
        let moving = S::Aim::KEEPS.then(|| active.clone().with_sums(scene));
        let active = moving.as_ref().unwrap_or(active);
        exactly(scene, active, largest, progress, &|large| {
            let progress = InParts::new(progress, self.caustics);
            // In double precision, single paths check on waves.
            let waves = const { wave::fits::<S>() && is_single::<P>() } && active.scales.is_empty();
            let mut sums = match waves {
                true => self.sums_of_waves::<S, X>(active, adjoint, large, &progress),
                false => self.sums::<S, X>(active, large, &progress, each),
            };
            if self.caustics == Caustics::Particles && !progress.cancelled() {
                let differential = S::Bsdf::DIFFERENTIAL;
                let context =
                    particle::Context::caustics(scene, theta, self.settings, differential);
                let samples = self.samples.clone();
                let particles = particle_gradient::Pass::new(&context, adjoint, self.seed, samples);
                let part = particles.sums::<X>(active, large, &progress);
                add(&mut sums.small, &part.small);
                sums.non_finite.merge(&part.non_finite);
            }
            sums
        })
    }

    /// All paths. The large ranges are added to `large`.
    pub fn sums<S: Strategy, X: Sampler>(
        &self,
        active: &Active,
        large: &ExactBuffer,
        progress: &dyn Progress,
        each: impl Fn(&Context<P>, Sample, &mut Recorder<'_, P>, &mut Sink) + Sync,
    ) -> Sums {
        let new = || Sink::of_samples(active, large);
        let (parts, non_finite) = self.paths::<S, X, _>(active, JOBS, progress, new, each);
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
        Sums {
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
        progress: &dyn Progress,
    ) -> Sums {
        let (scene, context) = (self.scene, self.context(progress));
        let tiles = self.tiles();
        let jobs = JOBS.min(tiles.len());
        let parts = parallel::map(jobs, |job| {
            let mut sink = Sink::new(active, large);
            let mut non_finite = NonFinite::default();
            let mut wave = Wave::<P, X>::new();
            let mut record = Record::of::<S>(active, scene, false);
            let mut adjoints = LayerAdjoints::of(scene, active, self.theta, &mut sink);
            for tile in tiles.iter().skip(job).step_by(jobs) {
                if progress.cancelled() {
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
                progress.advance(tile.pixels() as u64);
            }
            (sink.into_small(), non_finite)
        });
        let mut sums = Sums {
            small: vec![0.0; active.small_len],
            non_finite: NonFinite::default(),
            noise: None,
        };
        for (small, non_finite) in parts {
            add(&mut sums.small, &small);
            sums.non_finite.merge(&non_finite);
        }
        sums
    }

    fn context<'b>(&'b self, progress: &'b dyn Progress) -> Context<'b, P> {
        Context {
            scene: self.scene,
            theta: self.theta,
            settings: self.settings,
            shifts: &[],
            caustics: self.caustics,
            progress,
        }
    }

    fn tiles(&self) -> Vec<Tile> {
        let [width, height] = self.scene.film.crop_size;
        tiles(width, height)
    }

    /// Records every path, as far as the parameters `active` matter to it, and calls `each` with it, pixel by
    /// pixel within a tile. The tiles are shared by `jobs` states, whatever the number of threads.
    pub fn paths<S: Strategy, X: Sampler, J: Send>(
        &self,
        active: &Active,
        jobs: usize,
        progress: &dyn Progress,
        new: impl Fn() -> J + Sync,
        each: impl Fn(&Context<P>, Sample, &mut Recorder<'_, P>, &mut J) + Sync,
    ) -> (Vec<J>, NonFinite) {
        let (context, tiles) = (self.context(progress), self.tiles());
        let jobs = jobs.min(tiles.len());
        let parts = parallel::map(jobs, |job| {
            let mut state = new();
            let mut paths = Paths::<P, S, X, _>::new(Recorder::of(active));
            let mut non_finite = NonFinite::default();
            for tile in tiles.iter().skip(job).step_by(jobs) {
                if progress.cancelled() {
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
                progress.advance(tile.pixels() as u64);
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
    progress: &'a dyn Progress,
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
            progress: self.progress,
        };
        start::<R, S, X>(scene, settings.points, seed, self.at.pixel, self.at.index)
            .finish(&context, &mut ())
    }
}
