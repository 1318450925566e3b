//! The integrals that an image is the sum of, one line each.

use std::sync::atomic::{AtomicU64, Ordering};

use ad_core::Float;

use super::active::Active;
use super::boundary;
use super::connections;
use super::convolved;
use super::exact::ExactBuffer;
use super::glints;
use super::motion;
use super::particle_gradient;
use super::pass::{Finders, Integral, Pass, Question};
use super::paths;
use super::progress::Progress;
use super::rendering::{Components, Rendering};
use super::sink::GradientSums;
use super::solved::Solved;
use crate::error::RenderError;
use crate::estimator::Strategy;
use crate::params::ParamInfo;
use crate::sampler::Sampler;
use crate::scene::{Scene, Settings};

/// What of a pass is asked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    /// Who finds light besides paths.
    pub finders: Finders,
    /// Light where it is, and what changes it there.
    pub light: bool,
    /// What moves.
    pub motion: bool,
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

/// The list: of each its name, the module whose functions are its image and its gradient, for which strategies it is
/// compiled (a constant, if not for all), when a pass asks it, and a [`Solved`] of the module, if it refuses anything.
macro_rules! integrals {
    (|$wanted:ident| $(
        $(#[$doc:meta])*
        $name:ident: $module:ident::<$($by:ty),*> $(if $of:expr)?, $asked:expr $(, $solved:ident)?;
    )*) => {
        $(
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
        )*

        /// What refuses anything, in their order.
        const SOLVED: &[Solved] = &[$($($module::$solved,)?)*];

        /// Asks every integral of a pass, one after the other, until it is cancelled.
        pub(super) fn every<S: Strategy, X: Sampler>(
            $wanted: Wanted,
            progress: &dyn Progress,
            question: &mut impl Question<S, X>,
        ) {
            let asked = [$($(const { $of } &&)? $asked),*];
            let integrals: u64 = asked.into_iter().map(u64::from).sum();
            let share = Share {
                progress,
                integrals: integrals.max(1),
                done: AtomicU64::new(0),
            };
            $(
                if $(const { $of } &&)? $asked {
                    question.ask::<$name>(&share);
                    if share.cancelled() {
                        return;
                    }
                }
            )*
        }
    };
}

integrals! {
    |wanted|
    /// Light along paths from the camera: all of it, or what others leave.
    Paths: paths::<S::Paths, X>, wanted.light;
    /// Caustics, along particles from the emitters.
    Particles: particle_gradient::<S, X>, wanted.light && wanted.finders.particles;
    /// Light over specular chains, by manifold connections.
    Connections: connections::<X>, wanted.light && wanted.finders.connections, CHAINS;
    /// Lights in glinty surfaces.
    Glints: glints::<X>, wanted.light && wanted.finders.glints, GLINTS;
    /// What vertices of paths that move do to light.
    Motion: motion::<S, X> if S::INTERIOR, wanted.motion;
    /// What outlines that move hide and show.
    Boundaries: boundary::<S::Still, X> if S::OUTLINES, wanted.motion;
    /// What moves, along directions that follow outlines.
    Convolved: convolved::<S, X> if S::FOLLOWS.any(), wanted.motion;
}

/// Asks every integral whether it has derivatives in what moves.
///
/// # Errors
/// Those of [`Solved::check`].
pub(super) fn check<'a, S: Strategy>(
    scene: &Scene,
    settings: &Settings,
    moving: impl IntoIterator<Item = &'a ParamInfo> + Clone,
) -> Result<(), RenderError> {
    (SOLVED.iter()).try_for_each(|solved| solved.check::<S>(scene, settings, moving.clone()))
}

/// Whether light that is found by solving equations, over chains and in glints, stays where it is when a parameter changes, so
/// that it has a derivative in it, by whatever estimator.
///
/// # Errors
/// Names the parameter, and what it moves.
pub fn stays(settings: &Settings, info: &ParamInfo) -> Result<(), RenderError> {
    (SOLVED.iter()).try_for_each(|solved| solved.check_stays(settings, info))
}

/// Asks every integral whether a pass over paths alone has all light that the settings ask for; `whose`: what it computes.
///
/// # Errors
/// Those of [`Solved::check_absent`].
pub(super) fn check_paths_alone(settings: &Settings, whose: &str) -> Result<(), RenderError> {
    (SOLVED.iter()).try_for_each(|solved| solved.check_absent(settings, whose))
}
