//! What is there to be studied: strategies whose derivatives are wrong, by the failure modes of `docs/errata.md`, section 8,
//! and weights that are right and noisy.

use std::marker::PhantomData;

use ad_core::Real;

use super::memory::{Forget, Keep};
use super::strategy::wrapper;
use super::weights::{constant, varying};
use super::{Detached, Follows, Heuristic, Power, Strategy, Weights};

/// [`Power`] that trusts sampled lights eight times as much as their density deserves. Densities of primal
/// samples say little about the spread of a derivative; a constant that is right for it is found by measuring, see
/// [`crate::auto`].
///
/// What it weighs is as right as it is by [`Power`], and only noisier. [`Capabilities::study`](super::Capabilities::study) means
/// what is wrong on purpose, which tools warn of and do not look at twice, and does not hold.
#[derive(Clone, Copy, Debug)]
pub struct TrustLights;

impl Heuristic for TrustLights {
    type Primal = Power;
    const LIGHTS: f64 = 8.0;
    #[inline]
    fn weight<R: Real>(a: R, b: R) -> R {
        Power::weight(a, b)
    }
}

/// [`Power`] that trusts scattered directions eight times as much, as [`TrustLights`].
#[derive(Clone, Copy, Debug)]
pub struct TrustBsdf;

impl Heuristic for TrustBsdf {
    type Primal = Power;
    const LIGHTS: f64 = 0.125;
    #[inline]
    fn weight<R: Real>(a: R, b: R) -> R {
        Power::weight(a, b)
    }
}

/// Attached weights for scattered directions, detached ones for sampled lights: derivatives of the
/// weights no longer cancel. The caption of [Zeltner 2021, figure 4.13] allows it, errata
/// Z-4.13f does not. For study.
#[derive(Clone, Copy, Debug)]
pub struct MixedWeights;

impl Weights for MixedWeights {
    type Edge = Keep;
    const DIFFERENTIATED: bool = true;
    const MIXED: bool = true;
    #[inline]
    fn hit<H: Heuristic, R: Real>(a: R, b: R) -> R {
        varying::<H, R>(a, b)
    }
    #[inline]
    fn sampled<H: Heuristic, R: Real>(a: R, b: R) -> R {
        constant::<H, R>(a, b)
    }
}

/// `S` with a roulette whose survival probability is differentiated (F5). Needs [`AllowBias`](super::AllowBias).
#[derive(Clone, Copy, Debug)]
pub struct AttachedRoulette<S>(PhantomData<S>);

/// `S` whose scattered directions are weighed by one over a density in which the probabilities of choosing between
/// lobes are differentiated, although the choices do not move (F6) [Zeltner 2021, section 4.2.2]. Needs
/// [`AllowBias`](super::AllowBias).
///
/// `I = pi A + (1 - pi) B` with `pi` as the probability of `A` has the derivative `A - B`, and zero here. In general,
/// with the density `p = sum_i P_i p_i` of a direction (the probability of a delta is `P_i p_i`), what is missing is the
/// mean of `f L / p` times the derivative of `ln p` through all `P_i` ([`crate::bsdf::Lobe::choice_pdf`]). Lobes without
/// deltas are weighed by the density of their mixture, whichever was chosen: nothing is missing where they are alike.
///
/// Nothing else changes: `S` scatters constant directions and has MIS weights that are not differentiated.
#[derive(Clone, Copy, Debug)]
pub struct AttachedChoice<S>(PhantomData<S>);

/// `S`, which moves the vertices of paths, with constant rays beyond the first vertex: vertices are where a ray that stays
/// meets what moves, and samples of lights are constant directions, although the vertices that they start from move (F44).
/// Needs [`AllowBias`](super::AllowBias).
///
/// So do systems that hold directions and forget that the next vertex moves with the last one: what a shape that moves does
/// to its own light, or to what is lit through it, is partly lost.
#[derive(Clone, Copy, Debug)]
pub struct RaysAtRest<S>(PhantomData<S>);

wrapper!(RaysAtRest<Strategy<Bsdf = Detached, Edge = Forget, EmitterMotion = Forget>> {
    type Runs = Self;
    type Paths = S::Paths;
    const RAYS_AT_REST: bool = true;
    const OUTLINES: bool = S::OUTLINES;
    const INTERIOR: bool = S::INTERIOR;
    const ALLOWS_BIAS: bool = S::ALLOWS_BIAS;
    const ATTACHED_ROULETTE: bool = S::ATTACHED_ROULETTE;
    const ATTACHED_CHOICE: bool = S::ATTACHED_CHOICE;
});
wrapper!(AttachedRoulette<Strategy> {
    type Runs = Self;
    type Paths = Self;
    const FOLLOWS: Follows = S::FOLLOWS;
    const OUTLINES: bool = S::OUTLINES;
    const INTERIOR: bool = S::INTERIOR;
    const RAYS_AT_REST: bool = S::RAYS_AT_REST;
    const ALLOWS_BIAS: bool = S::ALLOWS_BIAS;
    const ATTACHED_ROULETTE: bool = true;
    const ATTACHED_CHOICE: bool = S::ATTACHED_CHOICE;
});
wrapper!(AttachedChoice<Strategy<Bsdf = Detached, Edge = Forget>> {
    type Runs = Self;
    type Paths = Self;
    const FOLLOWS: Follows = S::FOLLOWS;
    const OUTLINES: bool = S::OUTLINES;
    const INTERIOR: bool = S::INTERIOR;
    const RAYS_AT_REST: bool = S::RAYS_AT_REST;
    const ALLOWS_BIAS: bool = S::ALLOWS_BIAS;
    const ATTACHED_ROULETTE: bool = S::ATTACHED_ROULETTE;
    const ATTACHED_CHOICE: bool = true;
});
