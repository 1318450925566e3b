//! Multiple importance sampling weights.

use ad_core::Real;

/// A weighting function for two techniques.
pub trait Heuristic: Send + Sync + 'static {
    /// Weight of a sample with density `a` when the other technique has density `b`. Both finite and
    /// not negative; `a` positive.
    fn weight<R: Real>(a: R, b: R) -> R;
}

/// `a / (a + b)` [Veach 1997].
#[derive(Clone, Copy, Debug)]
pub struct Balance;

impl Heuristic for Balance {
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

/// `a^2 / (a^2 + b^2)` [Veach 1997], the peer's choice.
#[derive(Clone, Copy, Debug)]
pub struct Power;

impl Heuristic for Power {
    #[inline]
    fn weight<R: Real>(a: R, b: R) -> R {
        // The larger one is anybody's guess: nothing to branch on.
        let wins = a.primal() >= b.primal();
        let r = R::select(wins, b, a) / R::select(wins, a, b);
        let r2 = r * r;
        R::select(wins, R::one(), r2) / (R::one() + r2)
    }
}

/// Whether weights carry derivatives.
pub trait Weights: Send + Sync + 'static {
    /// The weight of a sample with density `a` against `b`; zero if `a` is.
    fn weight<H: Heuristic, R: Real>(a: R, b: R) -> R;
}

/// Weights are constants.
#[derive(Clone, Copy, Debug)]
pub struct DetachedWeights;

impl Weights for DetachedWeights {
    #[inline]
    fn weight<H: Heuristic, R: Real>(a: R, b: R) -> R {
        if a.primal() > R::Primal::zero() {
            R::lift(H::weight(a.primal(), b.primal()))
        } else {
            R::zero()
        }
    }
}

/// Weights are differentiated with the densities they are made of.
#[derive(Clone, Copy, Debug)]
pub struct AttachedWeights;

impl Weights for AttachedWeights {
    #[inline]
    fn weight<H: Heuristic, R: Real>(a: R, b: R) -> R {
        if a.primal() > R::Primal::zero() {
            H::weight(a, b)
        } else {
            R::zero()
        }
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
            assert_eq!(DetachedWeights::weight::<Power, f32>(0.0, a), 0.0);
        }
    }
}
