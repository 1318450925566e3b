//! Combinations of techniques for the direct light at a vertex.

use std::marker::PhantomData;

use ad_core::Real;

use super::{
    Attached, AttachedWeights, Detached, DetachedWeights, Heuristic, Power, Sampling, Weights,
};

/// Which techniques estimate the light arriving at a vertex, and how they are combined.
pub trait Strategy: Send + Sync + 'static {
    /// How scattered directions are drawn.
    type Bsdf: Sampling;
    /// Whether emitters are sampled.
    const SAMPLES_EMITTERS: bool;
    /// Whether emitters hit by a scattered direction count.
    const COUNTS_HITS: bool;
    /// Weight of a sample with density `a` when the other technique has density `b`.
    fn weight<R: Real>(a: R, b: R) -> R;
}

/// The estimator's derivative has the right expectation (in scenes without moving discontinuities).
///
/// Implemented for the valid rows of [Zeltner 2021, table in section 4.5.1], as corrected.
#[diagnostic::on_unimplemented(
    message = "`{Self}` gives a biased derivative",
    label = "not an unbiased combination",
    note = "attached sampling needs attached MIS weights: use `AttachedWeights`",
    note = "to study the bias on purpose, wrap the combination: `AllowBias<{Self}>`"
)]
pub trait Unbiased: Strategy {}

/// Both techniques, combined by multiple importance sampling.
#[derive(Clone, Copy, Debug)]
pub struct Mis<B, E, W, H = Power>(PhantomData<(B, E, W, H)>);

impl<B: Sampling, W: Weights, H: Heuristic> Strategy for Mis<B, Detached, W, H> {
    type Bsdf = B;
    const SAMPLES_EMITTERS: bool = true;
    const COUNTS_HITS: bool = true;
    #[inline]
    fn weight<R: Real>(a: R, b: R) -> R {
        W::weight::<H, R>(a, b)
    }
}

impl<H: Heuristic> Unbiased for Mis<Detached, Detached, DetachedWeights, H> {}
impl<H: Heuristic> Unbiased for Mis<Detached, Detached, AttachedWeights, H> {}
impl<H: Heuristic> Unbiased for Mis<Attached, Detached, AttachedWeights, H> {}

/// Directions are sampled from the BSDF; lights count where they are hit.
#[derive(Clone, Copy, Debug)]
pub struct BsdfOnly<B>(PhantomData<B>);

impl<B: Sampling> Strategy for BsdfOnly<B> {
    type Bsdf = B;
    const SAMPLES_EMITTERS: bool = false;
    const COUNTS_HITS: bool = true;
    #[inline]
    fn weight<R: Real>(_a: R, _b: R) -> R {
        R::one()
    }
}

impl<B: Sampling> Unbiased for BsdfOnly<B> {}

/// Lights are sampled; a light that is hit counts only where it could not have been sampled (seen
/// directly or through deltas).
#[derive(Clone, Copy, Debug)]
pub struct EmitterOnly<B>(PhantomData<B>);

impl<B: Sampling> Strategy for EmitterOnly<B> {
    type Bsdf = B;
    const SAMPLES_EMITTERS: bool = true;
    const COUNTS_HITS: bool = false;
    #[inline]
    fn weight<R: Real>(_a: R, _b: R) -> R {
        R::one()
    }
}

impl<B: Sampling> Unbiased for EmitterOnly<B> {}

/// Opts in to a combination whose derivative is biased.
#[derive(Clone, Copy, Debug)]
pub struct AllowBias<S>(PhantomData<S>);

impl<S: Strategy> Strategy for AllowBias<S> {
    type Bsdf = S::Bsdf;
    const SAMPLES_EMITTERS: bool = S::SAMPLES_EMITTERS;
    const COUNTS_HITS: bool = S::COUNTS_HITS;
    #[inline]
    fn weight<R: Real>(a: R, b: R) -> R {
        S::weight(a, b)
    }
}

impl<S: Strategy> Unbiased for AllowBias<S> {}
