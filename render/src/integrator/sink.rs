//! Where adjoints of parameters are added up.

use ad_core::{Float, Real};

use super::active::{Active, Slot};
use super::exact::ExactBuffer;
use super::noise::{Noise, Watch};
use super::progress::Progress;
use super::record::SumSink;
use super::rendering::NonFinite;
use super::tile::{Sample, place};
use crate::error::RenderError;
use crate::manifold::Statistics;
use crate::params::{GradSink, ParamRef, Theta};
use crate::scene::Scene;

/// The derivative of `<adjoint, image>`.
#[derive(Clone, Debug)]
pub struct Gradient {
    /// One slice per range of the [`Active`] set, in its order.
    pub values: Vec<Vec<f64>>,
    /// What went wrong.
    pub non_finite: NonFinite,
    /// How noisy the derivatives are, if that is asked for ([`Active::with_noise`]).
    pub noise: Option<Noise>,
    /// What manifold connections came to.
    pub connections: Statistics,
    /// What walks to glints came to.
    pub glints: Statistics,
    /// Whether it was stopped early; the sums are then incomplete.
    pub cancelled: bool,
}

/// Where one job's adjoints go.
pub(super) struct Sink<'a> {
    active: &'a Active,
    pub(super) small: Vec<f64>,
    large: &'a ExactBuffer,
    /// Sums for the noise of pixels, if that is asked for.
    pub(super) watch: Option<Watch>,
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
    pub(super) fn of_samples(active: &'a Active, large: &'a ExactBuffer) -> Self {
        Self {
            watch: active.watch(),
            ..Self::new(active, large)
        }
    }

    /// What was added last belongs to this sample.
    #[inline]
    pub(super) fn finish(&mut self, scene: &Scene, at: Sample, work: u32) {
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

/// What a pass adds up, besides the large ranges.
pub(super) struct GradientSums {
    /// Derivatives in the small ranges.
    pub small: Vec<f64>,
    pub non_finite: NonFinite,
    /// As [`Gradient::noise`].
    pub noise: Option<Noise>,
    /// As [`Gradient::connections`].
    pub connections: Statistics,
    /// As [`Gradient::glints`].
    pub glints: Statistics,
}

impl GradientSums {
    /// All sums zero.
    pub fn zero(active: &Active) -> Self {
        Self {
            small: vec![0.0; active.small_len],
            non_finite: NonFinite::default(),
            noise: None,
            connections: Statistics::default(),
            glints: Statistics::default(),
        }
    }

    /// These, and what jobs have added up, in their order.
    pub fn with_parts(mut self, parts: Vec<(Vec<f64>, NonFinite)>) -> Self {
        for (small, non_finite) in parts {
            add(&mut self.small, &small);
            self.non_finite.merge(&non_finite);
        }
        self
    }

    /// Adds what another integral, or another part of one, has.
    pub fn merge(&mut self, other: Self) {
        add(&mut self.small, &other.small);
        self.non_finite.merge(&other.non_finite);
        self.noise = self.noise.take().or(other.noise);
        self.connections.merge(&other.connections);
        self.glints.merge(&other.glints);
    }
}

/// The gradient that `pass` adds up. `largest` is the magnitude of the largest adjoint of one path.
pub(super) fn collect(
    scene: &Scene,
    active: &Active,
    largest: f64,
    progress: &dyn Progress,
    pass: &dyn Fn(&ExactBuffer) -> GradientSums,
) -> Gradient {
    let large = ExactBuffer::new(active.large_len, largest);
    let GradientSums {
        small,
        non_finite,
        noise,
        connections,
        glints,
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
        connections,
        glints,
        cancelled: progress.cancelled(),
    }
}

/// Adds a part to sums.
pub(super) fn add(sums: &mut [f64], part: &[f64]) {
    sums.iter_mut().zip(part).for_each(|(s, p)| *s += p);
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

/// Whether there are as many values as the scene has parameters.
///
/// # Errors
/// There are not.
pub(super) fn check_values<R: Real>(scene: &Scene, theta: &Theta<R>) -> Result<(), RenderError> {
    let (expected, found) = (scene.params().values().len(), theta.values().len());
    if expected == found {
        return Ok(());
    }
    Err(RenderError::WrongLength {
        what: "values of parameters",
        expected,
        found,
    })
}

/// The largest magnitude of an entry.
pub(super) fn largest_of(image: &[f32]) -> f64 {
    image.iter().fold(0.0, |m, &a| m.max(f64::from(a.abs())))
}
