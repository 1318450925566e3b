//! Russian roulette.

use ad_core::Float;

use crate::math::Rgb;

/// The probability of surviving is at most this.
pub const MAX_SURVIVAL: f64 = 0.95;

/// When derivatives are wanted, a vertex counts as reflecting at least this much: at zero albedo the throughput vanishes,
/// but the derivative behind that vertex does not (F7).
pub const LEAST_STEP: f64 = 0.2;

/// What roulette goes by behind a vertex that was `before`, reflects `step` and leaves the throughput `beta`.
#[inline(always)]
pub fn roulette_weight<P: Float>(differentiates: bool, before: P, step: Rgb<P>, beta: Rgb<P>) -> P {
    if differentiates {
        before * step.max_component().max(P::of(LEAST_STEP))
    } else {
        beta.max_component()
    }
}

/// The probability of surviving with this [`roulette_weight`]; `eta` is the relative index along the path.
#[inline(always)]
pub fn probability<P: Float>(weight: P, eta: P) -> P {
    (weight * eta * eta).min(P::of(MAX_SURVIVAL))
}

/// Whether a path lives, and one over the probability of that. `u` decides, if it is played at all.
#[inline(always)]
pub fn play<P: Float>(plays: bool, q: P, u: P) -> (bool, P) {
    (!plays | (u < q), P::select(plays, q.recip(), P::one()))
}
