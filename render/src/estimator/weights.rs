//! Multiple importance sampling weights.

use ad_core::{Const, Real};

use super::memory::{Forget, Keep, Memory};

/// A weighting function for two techniques.
pub trait Heuristic: Send + Sync + 'static {
    /// What weighs images, where nothing is differentiated: [`Balance`] or [`Power`], or a heuristic of its own, for which
    /// another path tracer is compiled.
    type Primal: Heuristic;
    /// What densities of sampled lights are multiplied by first: how much more they are trusted than those of
    /// scattered directions.
    const LIGHTS: f64 = 1.0;
    /// Weight of a sample with density `a` when the other technique has density `b`. Both finite and
    /// not negative; `a` positive.
    fn weight<R: Real>(a: R, b: R) -> R;
}

/// `a / (a + b)` [Veach 1997].
#[derive(Clone, Copy, Debug)]
pub struct Balance;

impl Heuristic for Balance {
    type Primal = Self;
    #[inline]
    fn weight<R: Real>(a: R, b: R) -> R {
        // As a ratio of at most one: no overflow for densities up to 1e38.
        if a.primal() >= b.primal() {
            (R::one() + b / a).recip()
        } else {
            let r = a / b;
            r / (R::one() + r)
        }
    }
}

/// `a^2 / (a^2 + b^2)` [Veach 1997], Mitsuba's choice.
#[derive(Clone, Copy, Debug)]
pub struct Power;

impl Heuristic for Power {
    type Primal = Self;
    #[inline]
    fn weight<R: Real>(a: R, b: R) -> R {
        // Which one is larger cannot be predicted: no branch.
        let wins = a.primal() >= b.primal();
        let r = R::select(wins, b, a) / R::select(wins, a, b);
        let r2 = r * r;
        R::select(wins, R::one(), r2) / (R::one() + r2)
    }
}

/// The density of a sampled light as heuristic `H` sees it.
#[inline(always)]
pub(super) fn trusted<H: Heuristic, R: Real>(pdf: R) -> R {
    if H::LIGHTS == 1.0 {
        pdf
    } else {
        pdf * Const(R::Primal::of(H::LIGHTS))
    }
}

/// Whether weights carry derivatives.
pub trait Weights: Send + Sync + 'static {
    /// Whether the densities in the weights are those of frozen parameters, at samples that move.
    const FROZEN: bool = false;
    /// Whether an edge must be remembered to be differentiated by itself.
    type Edge: Memory;
    /// Whether the densities of scattered directions are differentiated in the parameters.
    const DIFFERENTIATED: bool = false;
    /// Whether weights of one technique carry derivatives and those of the other do not: wrong (F4), for study.
    const MIXED: bool = false;
    /// The weight of a direction with density `a` against `b`, found by scattering; zero if `a` is.
    fn hit<H: Heuristic, R: Real>(a: R, b: R) -> R;
    /// The weight of a sampled light with density `a` against `b`; zero if `a` is.
    #[inline]
    fn sampled<H: Heuristic, R: Real>(a: R, b: R) -> R {
        Self::hit::<H, R>(a, b)
    }
}

#[inline(always)]
pub(super) fn constant<H: Heuristic, R: Real>(a: R, b: R) -> R {
    R::lift(varying::<H, R::Primal>(a.primal(), b.primal()))
}

#[inline(always)]
pub(super) fn varying<H: Heuristic, R: Real>(a: R, b: R) -> R {
    if a.primal() > R::Primal::zero() {
        H::weight(a, b)
    } else {
        R::zero()
    }
}

/// Weights are constants.
#[derive(Clone, Copy, Debug)]
pub struct DetachedWeights;

impl Weights for DetachedWeights {
    type Edge = Forget;
    #[inline]
    fn hit<H: Heuristic, R: Real>(a: R, b: R) -> R {
        constant::<H, R>(a, b)
    }
}

/// Weights are differentiated with the densities they are made of.
#[derive(Clone, Copy, Debug)]
pub struct AttachedWeights;

impl Weights for AttachedWeights {
    type Edge = Keep;
    const DIFFERENTIATED: bool = true;
    #[inline]
    fn hit<H: Heuristic, R: Real>(a: R, b: R) -> R {
        varying::<H, R>(a, b)
    }
}

/// Weights are functions of the direction, made of the densities at the current parameters, which
/// are constants: only the motion of attached samples changes them. They sum to one at every direction,
/// so they are right for attached and detached samples alike.
#[derive(Clone, Copy, Debug)]
pub struct FrozenWeights;

impl Weights for FrozenWeights {
    type Edge = Forget;
    const FROZEN: bool = true;
    #[inline]
    fn hit<H: Heuristic, R: Real>(a: R, b: R) -> R {
        varying::<H, R>(a, b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_over_the_whole_range() {
        for a in [1e-30f32, 1e-3, 0.7, 1.0, 42.0, 1e30] {
            for b in [1e-30f32, 1e-3, 0.7, 1.0, 42.0, 1e30] {
                let sum = |w: fn(f32, f32) -> f32| w(a, b) + w(b, a);
                assert!((sum(Balance::weight) - 1.0).abs() < 1e-6, "{a} {b}");
                assert!((sum(Power::weight) - 1.0).abs() < 1e-6, "{a} {b}");
            }
            assert_eq!(Balance::weight(a, 0.0), 1.0);
            assert_eq!(DetachedWeights::hit::<Power, f32>(0.0, a), 0.0);
        }
    }
}
