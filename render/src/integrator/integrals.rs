//! The integrals that an image is the sum of: one line each in [`every`].

use std::sync::atomic::{AtomicU64, Ordering};

use ad_core::{Float, Real};

use super::active::Active;
use super::boundary;
use super::connections;
use super::convolved;
use super::exact::ExactBuffer;
use super::glints;
use super::motion;
use super::particle;
use super::particle_gradient::ParticlePass;
use super::pass::{Finders, Integral, Pass, Question};
use super::paths;
use super::progress::Progress;
use super::rendering::{Components, Rendering};
use super::sink::GradientSums;
use crate::estimator::{Sampling, Strategy};
use crate::sampler::Sampler;

/// What of a pass somebody wants to know.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    /// Who finds light besides paths.
    pub finders: Finders,
    /// Light where it is, and what changes it there.
    pub light: bool,
    /// What moves.
    pub motion: bool,
}

/// Asks every integral of a pass.
pub(super) fn every<S: Strategy, X: Sampler>(
    wanted: Wanted,
    progress: &dyn Progress,
    question: &mut impl Question<S, X>,
) {
    let by_particles = wanted.light && wanted.finders.particles;
    let by_connections = wanted.light && wanted.finders.connections;
    let by_glints = wanted.light && wanted.finders.glints;
    let moves = S::INTERIOR && wanted.motion;
    let outlines = S::OUTLINES && wanted.motion;
    let follows = S::FOLLOWS.any() && wanted.motion;
    let all = [
        wanted.light,
        by_particles,
        by_connections,
        by_glints,
        moves,
        outlines,
        follows,
    ];
    let integrals: u64 = all.into_iter().map(u64::from).sum();
    let share = Share {
        progress,
        integrals: integrals.max(1),
        done: AtomicU64::new(0),
    };
    if wanted.light {
        question.ask::<Paths>(&share);
    }
    if by_particles && !share.cancelled() {
        question.ask::<Particles>(&share);
    }
    if by_connections && !share.cancelled() {
        question.ask::<Connections>(&share);
    }
    if by_glints && !share.cancelled() {
        question.ask::<Glints>(&share);
    }
    // A constant: it is not even compiled for strategies that do not move vertices.
    if const { S::INTERIOR } && wanted.motion && !share.cancelled() {
        question.ask::<Motion>(&share);
    }
    if const { S::OUTLINES } && wanted.motion && !share.cancelled() {
        question.ask::<Boundaries>(&share);
    }
    if const { S::FOLLOWS.any() } && wanted.motion && !share.cancelled() {
        question.ask::<Convolved>(&share);
    }
}

/// The progress of several integrals, each of which counts all pixels.
struct Share<'a> {
    progress: &'a dyn Progress,
    integrals: u64,
    done: AtomicU64,
}

impl Progress for Share<'_> {
    fn advance(&self, n: u64) {
        let before = self.done.fetch_add(n, Ordering::Relaxed);
        (self.progress).advance((before + n) / self.integrals - before / self.integrals);
    }
    fn cancelled(&self) -> bool {
        self.progress.cancelled()
    }
}

/// An integral whose image and gradient are functions of a module.
macro_rules! integrals {
    ($($(#[$doc:meta])* $name:ident: $module:ident::<$($by:ident),*>;)*) => {$(
        $(#[$doc])*
        struct $name;

        impl<S: Strategy, X: Sampler> Integral<S, X> for $name {
            fn image<R: Components>(pass: &Pass<R>) -> Rendering {
                $module::image::<R, $($by),*>(pass)
            }
            fn gradient<P: Float>(
                pass: &Pass<P>,
                active: &Active,
                adjoint: &[f32],
                large: &ExactBuffer,
            ) -> GradientSums {
                $module::gradient::<P, $($by),*>(pass, active, adjoint, large)
            }
        }
    )*};
}

integrals! {
    /// Light along paths from the camera: all of it, or what particles leave.
    Paths: paths::<S, X>;
    /// What vertices of paths that move do to light.
    Motion: motion::<S, X>;
    /// What outlines that move hide and show.
    Boundaries: boundary::<S, X>;
    /// What moves, along directions that follow outlines.
    Convolved: convolved::<S, X>;
    /// Light over specular chains, by manifold connections.
    Connections: connections::<X>;
    /// Lights in glinty surfaces.
    Glints: glints::<X>;
}

/// What particles of a pass have in common.
fn caustics<'a, R: Real, S: Strategy>(pass: &'a Pass<'a, R>) -> particle::Context<'a, R> {
    let context = particle::Context::caustics(pass.scene, pass.theta, pass.settings);
    particle::Context {
        differential: S::Bsdf::DIFFERENTIAL,
        progress: pass.progress,
        ..context
    }
}

/// Caustics, along particles from the emitters.
struct Particles;

impl<S: Strategy, X: Sampler> Integral<S, X> for Particles {
    fn image<R: Components>(pass: &Pass<R>) -> Rendering {
        let context = caustics::<_, S>(pass);
        particle::render::<R, X>(&context, pass.seed, pass.samples.clone(), pass.progress)
    }
    fn gradient<P: Float>(
        pass: &Pass<P>,
        active: &Active,
        adjoint: &[f32],
        large: &ExactBuffer,
    ) -> GradientSums {
        let context = caustics::<_, S>(pass);
        let samples = pass.samples.clone();
        let particles = ParticlePass::new(&context, adjoint, pass.seed, samples);
        let (sums, _) = particles.sums::<X>(active, large, pass.progress);
        sums
    }
}
