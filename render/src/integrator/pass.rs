//! Passes: what is asked of every integral that an image is the sum of.
//!
//! Paths from the camera and particles from the emitters are two integrals with samples of their own;
//! [`every`](super::integrals::every) lists those of a pass. Images, derivative images and gradients ask each of them, and
//! add up.

use std::ops::Range;
use std::sync::Arc;

use ad_core::{Float, Real};

use super::active::Active;
use super::exact::ExactBuffer;
use super::job::Job;
use super::path::Context;
use super::progress::Progress;
use super::rendering::{Components, Rendering};
use super::sink::{GradientSums, largest_of};
use super::tile::{Tile, tiles};
use crate::estimator::{Sampling, Strategy};
use crate::glint::glinty_shapes;
use crate::manifold::Split;
use crate::params::Theta;
use crate::sampler::Sampler;
use crate::scene::{CasterLight, Caustics, Connections, Scene, Settings};

/// The samples of an image.
pub(super) struct Pass<'a, R: Real> {
    pub scene: &'a Scene,
    pub theta: &'a Theta<'a, R>,
    pub settings: &'a Settings,
    /// Who finds caustics: decides which integrals there are.
    pub caustics: Caustics,
    /// What manifold connections and walks to glints find, if there are any.
    pub split: Option<Arc<Split>>,
    pub seed: u64,
    pub samples: Range<u64>,
    pub progress: &'a dyn Progress,
}

impl<'a, R: Real> Pass<'a, R> {
    /// Those of a job, at these parameters, with all that finds light.
    pub fn of<S: Strategy>(job: &Job<'a>, theta: &'a Theta<'a, R>) -> Self {
        let &Job {
            scene, settings, ..
        } = job;
        let deep = |edges: u32| S::Bsdf::DETACHED_PATH && settings.max_depth >= edges;
        let connections = settings.connections.as_ref();
        // Fewest edges over a chain, or of a light that the camera sees in a caster.
        let fewest = |c: &Connections| match c.light {
            CasterLight::All => 3,
            CasterLight::Published(_) => 2,
        };
        let connections = connections.filter(|c| deep(fewest(c)));
        let split = connections.and_then(|c| Split::of(scene, c));
        let glints = settings.glints.filter(|_| deep(2));
        let glinty = glints.and_then(|_| glinty_shapes(scene));
        Self {
            split: Split::with_glints(split, glinty).map(Arc::new),
            ..Self::new(job, theta, settings.caustics_of::<S>(scene))
        }
    }

    /// Those of a job, at these parameters, without manifold connections and glints.
    pub fn new(job: &Job<'a>, theta: &'a Theta<'a, R>, caustics: Caustics) -> Self {
        Self {
            scene: job.scene,
            theta,
            settings: job.settings,
            caustics,
            split: None,
            seed: job.seed,
            samples: job.samples.clone(),
            progress: job.progress,
        }
    }

    /// The same pass with another progress to report to.
    pub fn reporting<'b>(&'b self, progress: &'b dyn Progress) -> Pass<'b, R> {
        Pass {
            samples: self.samples.clone(),
            split: self.split.clone(),
            progress,
            ..*self
        }
    }

    /// Who finds light besides paths.
    pub fn finders(&self) -> Finders {
        Finders {
            particles: self.caustics == Caustics::Particles,
            connections: self.split.as_ref().is_some_and(|s| s.connects())
                && (self.settings.connections).is_some_and(|c| c.method.walks()),
            glints: (self.split.as_ref()).is_some_and(|s| !s.glinty().is_empty()),
        }
    }

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

    /// What its paths have in common, if no samples of emitters move.
    pub fn context(&self) -> Context<'_, R> {
        Context {
            scene: self.scene,
            theta: self.theta,
            settings: self.settings,
            shifts: &[],
            caustics: self.caustics,
            split: self.split.as_deref(),
            progress: self.progress,
        }
    }

    /// The tiles of its image.
    pub fn tiles(&self) -> Vec<Tile> {
        let [width, height] = self.scene.film.crop_size;
        tiles(width, height)
    }
}

/// Who finds light besides paths.
#[derive(Clone, Copy, Debug)]
pub(super) struct Finders {
    pub particles: bool,
    pub connections: bool,
    pub glints: bool,
}

/// A part of the light, as strategy `S` estimates it.
pub(super) trait Integral<S: Strategy, X: Sampler> {
    /// Its part of the image, and of derivative images.
    fn image<R: Components>(pass: &Pass<R>) -> Rendering;
    /// The derivative of its part of `<adjoint, image>`. The large ranges are added to `large`.
    fn gradient<P: Float>(
        pass: &Pass<P>,
        active: &Active,
        adjoint: &[f32],
        large: &ExactBuffer,
    ) -> GradientSums;
}

/// Something that is asked of every integral, one after another.
pub(super) trait Question<S: Strategy, X: Sampler> {
    /// Asks one of them, which reports its work in pixels.
    fn ask<I: Integral<S, X>>(&mut self, progress: &dyn Progress);
}
