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
use crate::estimator::Strategy;
use crate::sampler::Sampler;

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
/// compiled (a constant, if not for all), and when a pass asks it.
macro_rules! integrals {
    (|$wanted:ident| $(
        $(#[$doc:meta])*
        $name:ident: $module:ident::<$($by:ty),*> $(if $of:expr)?, $asked:expr;
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
    Connections: connections::<X>, wanted.light && wanted.finders.connections;
    /// Lights in glinty surfaces.
    Glints: glints::<X>, wanted.light && wanted.finders.glints;
    /// What vertices of paths that move do to light.
    Motion: motion::<S, X> if S::INTERIOR, wanted.motion;
    /// What outlines that move hide and show.
    Boundaries: boundary::<S::Still, X> if S::OUTLINES, wanted.motion;
    /// What moves, along directions that follow outlines.
    Convolved: convolved::<S, X> if S::FOLLOWS.any(), wanted.motion;
}
