//! Combinations of techniques for the direct light at a vertex.

use std::marker::PhantomData;

use ad_core::Real;

use super::memory::{Forget, Memory};
use super::weights::trusted;
use super::{
    Detached, DetachedWeights, Direct, EmitterSampling, Heuristic, Power, Sampling, Weights,
};
use crate::bsdf::Component;

/// Which techniques estimate the light arriving at a vertex, and how they are combined.
pub trait Strategy: Send + Sync + 'static {
    /// What is compiled for it: itself, or what it wraps, if that differs only in where it is allowed.
    type Runs: Strategy;
    /// What paths run of it: itself, or what it wraps, if that differs only in what other integrals do.
    type Paths: Strategy;
    /// Itself where nothing has tangents, so that nothing moves.
    type Still: Strategy<Bsdf = Detached, Edge = Forget, EmitterMotion = Forget>;
    /// What makes its images, where nothing is differentiated: the same techniques with constant samples and weights.
    type Primal: Strategy;
    /// How scattered directions are drawn.
    type Bsdf: Sampling;
    /// Whether paths remember edges, to differentiate them by themselves.
    type Edge: Memory;
    /// Whether samples of emitters are remembered, and follow the parameters.
    type EmitterMotion: Memory;
    /// Whether emitters are sampled.
    const SAMPLES_EMITTERS: bool;
    /// Whether emitters hit by a scattered direction count.
    const COUNTS_HITS: bool;
    /// Whether densities in weights are those of constant parameters, see [`FrozenWeights`](super::FrozenWeights).
    const FROZEN_WEIGHTS: bool = false;
    /// Whether they are differentiated in the parameters.
    const DIFFERENTIATED_WEIGHTS: bool = false;
    /// Whether that differs between the techniques: wrong (F4), for study.
    const MIXED_WEIGHTS: bool = false;
    /// Whether the survival probability of Russian roulette is differentiated: wrong (F5), for study.
    const ATTACHED_ROULETTE: bool = false;
    /// Whether the probabilities of choosing between lobes are: wrong (F6), for study.
    const ATTACHED_CHOICE: bool = false;
    /// Whether the vertices of paths move with what moves: [`Interior`].
    const INTERIOR: bool = false;
    /// Whether the rays between them do not: wrong (F44), for study.
    const RAYS_AT_REST: bool = false;
    /// Whether outlines that move have samples of their own: [`Outlines`].
    const OUTLINES: bool = false;
    /// How directions follow outlines that move: [`Convolved`], [`Followed`].
    const FOLLOWS: Follows = Follows::Nothing;
    /// Whether nothing says that the derivative has the right expectation: [`AllowBias`].
    const ALLOWS_BIAS: bool = false;
    /// Whether the scene must be free of discontinuities, see [`crate::Scene::admits`].
    const NEEDS_CONTINUITY: bool = Self::Bsdf::NEEDS_CONTINUITY || Self::EmitterMotion::KEEPS;
    /// Weight of a scattered direction with density `a` when a sampled light has density `b`.
    fn weight_hit<R: Real>(a: R, b: R) -> R;
    /// Weight of a sampled light with density `a` when a scattered direction has density `b`.
    fn weight_sampled<R: Real>(a: R, b: R) -> R;
}

/// How directions of paths follow outlines that move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Follows {
    /// Not at all.
    Nothing,
    /// By a convolution over so many auxiliary rays.
    Sampled(u32),
    /// By outlines that are known in closed form.
    Closed,
}

impl Follows {
    /// Whether they follow any.
    pub const fn any(self) -> bool {
        !matches!(self, Self::Nothing)
    }

    /// The number of auxiliary rays.
    pub const fn rays(self) -> u32 {
        match self {
            Self::Sampled(rays) => rays,
            Self::Nothing | Self::Closed => 0,
        }
    }
}

/// Scalar of the geometry of a strategy.
pub type Geometry<S, R> = <<S as Strategy>::Bsdf as Sampling>::Geometry<R>;

/// Which edges a strategy differentiates by themselves, where they find light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edges {
    /// None: they are constants, or move as the whole path does.
    None,
    /// Only weights are differentiated. Edges along deltas have none, and are constants.
    Weighed,
    /// All of them move.
    All,
}

impl Edges {
    /// Those that strategy `S` differentiates.
    pub const fn of<S: Strategy>() -> Self {
        match S::Bsdf::DIRECT {
            Direct::AsPath if S::Bsdf::DETACHED_PATH && S::DIFFERENTIATED_WEIGHTS => Self::Weighed,
            Direct::AsPath => Self::None,
            Direct::Attached | Direct::Reparameterised { .. } => Self::All,
        }
    }

    /// Whether one along a direction that was sampled from `component` is among them.
    #[inline(always)]
    pub fn contain(self, component: Component) -> bool {
        match self {
            Self::None => false,
            Self::Weighed => component == Component::Continuous,
            Self::All => true,
        }
    }
}

/// Whether a strategy differentiates the light that an edge finds by itself.
pub const fn differentiates_edges<S: Strategy>() -> bool {
    !matches!(Edges::of::<S>(), Edges::None)
}

/// Whether a [`Guide`](crate::guide::Guide) may lead scattered directions: only if neither they nor weights move, nor
/// what they are divided by.
pub const fn is_guided<S: Strategy>() -> bool {
    S::Bsdf::DETACHED_PATH
        && !S::FROZEN_WEIGHTS
        && !differentiates_edges::<S>()
        && !S::ATTACHED_CHOICE
}

/// Whether waves estimate derivatives as strategy `S` does: paths and samples of emitters stand still, and decisions are
/// constants.
pub const fn goes_in_waves<S: Strategy>() -> bool {
    S::Bsdf::DETACHED_PATH
        && !S::EmitterMotion::KEEPS
        && !S::ATTACHED_ROULETTE
        && !S::ATTACHED_CHOICE
}

/// Both techniques, combined by multiple importance sampling.
///
/// Densities of emitters in weights are functions of the direction, at constant texels: whatever the
/// parameters do, the weights add up to one at every direction.
#[derive(Clone, Copy, Debug)]
pub struct Mis<B, E, W, H = Power>(PhantomData<(B, E, W, H)>);

impl<B, E, W, H> Strategy for Mis<B, E, W, H>
where
    B: Sampling,
    E: EmitterSampling<B>,
    W: Weights,
    H: Heuristic,
{
    type Runs = Self;
    type Paths = Self;
    type Still = Mis<Detached, Detached, DetachedWeights, H>;
    type Primal = Mis<Detached, Detached, DetachedWeights, H::Primal>;
    type Bsdf = B;
    type Edge = <B::Edge as Memory>::Or<W::Edge>;
    type EmitterMotion = E::EmitterMotion;
    const SAMPLES_EMITTERS: bool = true;
    const COUNTS_HITS: bool = true;
    const FROZEN_WEIGHTS: bool = W::FROZEN;
    const DIFFERENTIATED_WEIGHTS: bool = W::DIFFERENTIATED;
    const MIXED_WEIGHTS: bool = W::MIXED;
    #[inline(always)]
    fn weight_hit<R: Real>(a: R, b: R) -> R {
        W::hit::<H, R>(a, trusted::<H, R>(b))
    }
    #[inline(always)]
    fn weight_sampled<R: Real>(a: R, b: R) -> R {
        W::sampled::<H, R>(trusted::<H, R>(a), b)
    }
}

/// Directions are sampled from the BSDF; lights count where they are hit.
#[derive(Clone, Copy, Debug)]
pub struct BsdfOnly<B>(PhantomData<B>);

impl<B: Sampling> Strategy for BsdfOnly<B> {
    type Runs = Self;
    type Paths = Self;
    type Still = BsdfOnly<Detached>;
    type Primal = BsdfOnly<Detached>;
    type Bsdf = B;
    type Edge = B::Edge;
    type EmitterMotion = Forget;
    const SAMPLES_EMITTERS: bool = false;
    const COUNTS_HITS: bool = true;
    #[inline(always)]
    fn weight_hit<R: Real>(_a: R, _b: R) -> R {
        R::one()
    }
    #[inline(always)]
    fn weight_sampled<R: Real>(_a: R, _b: R) -> R {
        R::one()
    }
}

/// Lights are sampled; a light that is hit counts only where it could not have been sampled (seen
/// directly or through deltas). `E` says whether their samples move, see [`EmitterSampling`].
#[derive(Clone, Copy, Debug)]
pub struct EmitterOnly<B, E = Detached>(PhantomData<(B, E)>);

impl<B: Sampling, E: EmitterSampling<B>> Strategy for EmitterOnly<B, E> {
    type Runs = Self;
    type Paths = Self;
    type Still = EmitterOnly<Detached>;
    type Primal = EmitterOnly<Detached>;
    type Bsdf = B;
    type Edge = B::Edge;
    type EmitterMotion = E::EmitterMotion;
    const SAMPLES_EMITTERS: bool = true;
    const COUNTS_HITS: bool = false;
    #[inline(always)]
    fn weight_hit<R: Real>(_a: R, _b: R) -> R {
        R::one()
    }
    #[inline(always)]
    fn weight_sampled<R: Real>(_a: R, _b: R) -> R {
        R::one()
    }
}

/// Opts in to a combination whose derivative is biased.
#[derive(Clone, Copy, Debug)]
pub struct AllowBias<S>(PhantomData<S>);

/// `S`, and what moves: derivatives in positions of shapes, cameras and lights, as far as nothing becomes visible or hidden
/// (F10), by an integral with samples of its own. Needs [`AllowBias`].
///
/// The first vertex of a path is where the ray through its point of the film meets the surface that moves; all others stay
/// on their material, with constant densities, weights and roulette.
#[derive(Clone, Copy, Debug)]
pub struct Interior<S>(PhantomData<S>);

/// `S`, which moves the vertices of paths, and what becomes visible or hidden as outlines move: by samples of edges, which
/// are an integral of its own ([`crate::scene::Scene::admits_outlines`] says where).
///
/// # Reference
/// [Li et al. 2018], with the material followed beyond the first vertex.
#[derive(Clone, Copy, Debug)]
pub struct Outlines<S>(PhantomData<S>);

/// `S`, and what moves: directions of paths follow the outlines of what they meet, found by `RAYS` auxiliary rays for each
/// direction and a harmonic convolution of their velocities, by an integral with samples of its own.
///
/// Derivatives in what moves are right in the limit of a narrow kernel: what is smaller than about 0.3 % of its distance,
/// edges that are closer to each other, and triangles that are smaller, are blurred. `RAYS` is at least two; with few of
/// them an outline may be missed: by one in `2^RAYS` on a straight edge, by more in corners.
///
/// # Reference
/// [Zeltner 2021, section 4.4], with another estimate of the divergence.
#[derive(Clone, Copy, Debug)]
pub struct Convolved<S, const RAYS: u32 = 16>(PhantomData<S>);

/// `S`, and what moves: directions of paths follow the outlines of what they meet as [`Convolved`] does, by a field that is
/// known in closed form. There is no kernel, and no limit: it is right for outlines of spheres and of flat faces that move as
/// a whole; all others are refused ([`crate::scene::Scene::admits_outlines`]).
///
/// Each direction looks at all outlines: it is for scenes of few of them.
#[derive(Clone, Copy, Debug)]
pub struct Followed<S>(PhantomData<S>);

/// What a wrapped strategy says, but for these constants.
macro_rules! wrapper {
    ($name:ident <$inner:path $(, const $number:ident: $of:ty)?> { $($item:item)* }) => {
        impl<S: $inner $(, const $number: $of)?> Strategy for $name<S $(, $number)?> {
            type Still = S::Still;
            type Primal = S::Primal;
            type Bsdf = S::Bsdf;
            type Edge = S::Edge;
            type EmitterMotion = S::EmitterMotion;
            const SAMPLES_EMITTERS: bool = S::SAMPLES_EMITTERS;
            const COUNTS_HITS: bool = S::COUNTS_HITS;
            const FROZEN_WEIGHTS: bool = S::FROZEN_WEIGHTS;
            const DIFFERENTIATED_WEIGHTS: bool = S::DIFFERENTIATED_WEIGHTS;
            const MIXED_WEIGHTS: bool = S::MIXED_WEIGHTS;
            $($item)*
            #[inline]
            fn weight_hit<R: Real>(a: R, b: R) -> R {
                S::weight_hit(a, b)
            }
            #[inline]
            fn weight_sampled<R: Real>(a: R, b: R) -> R {
                S::weight_sampled(a, b)
            }
        }
    };
}
pub(super) use wrapper;

wrapper!(Interior<Strategy<Bsdf = Detached, Edge = Forget, EmitterMotion = Forget>> {
    type Runs = Self;
    type Paths = S::Paths;
    const INTERIOR: bool = true;
    const RAYS_AT_REST: bool = S::RAYS_AT_REST;
    const ALLOWS_BIAS: bool = S::ALLOWS_BIAS;
    const ATTACHED_ROULETTE: bool = S::ATTACHED_ROULETTE;
    const ATTACHED_CHOICE: bool = S::ATTACHED_CHOICE;
});
wrapper!(Outlines<Strategy<Bsdf = Detached, Edge = Forget, EmitterMotion = Forget>> {
    type Runs = Self;
    type Paths = S::Paths;
    const OUTLINES: bool = true;
    const INTERIOR: bool = S::INTERIOR;
    const RAYS_AT_REST: bool = S::RAYS_AT_REST;
    const ALLOWS_BIAS: bool = S::ALLOWS_BIAS;
    const ATTACHED_ROULETTE: bool = S::ATTACHED_ROULETTE;
    const ATTACHED_CHOICE: bool = S::ATTACHED_CHOICE;
});
wrapper!(AllowBias<Strategy> {
    type Runs = S::Runs;
    type Paths = S::Paths;
    const FOLLOWS: Follows = S::FOLLOWS;
    const OUTLINES: bool = S::OUTLINES;
    const INTERIOR: bool = S::INTERIOR;
    const RAYS_AT_REST: bool = S::RAYS_AT_REST;
    const ALLOWS_BIAS: bool = true;
    const ATTACHED_ROULETTE: bool = S::ATTACHED_ROULETTE;
    const ATTACHED_CHOICE: bool = S::ATTACHED_CHOICE;
    const NEEDS_CONTINUITY: bool = false;
});

wrapper!(Convolved<Strategy, const RAYS: u32> {
    type Runs = Self;
    type Paths = S::Paths;
    const ATTACHED_ROULETTE: bool = S::ATTACHED_ROULETTE;
    const ATTACHED_CHOICE: bool = S::ATTACHED_CHOICE;
    const ALLOWS_BIAS: bool = S::ALLOWS_BIAS;
    const NEEDS_CONTINUITY: bool = S::NEEDS_CONTINUITY;
    const FOLLOWS: Follows = {
        assert!(RAYS >= 2, "neighbours are compared with each other");
        Follows::Sampled(RAYS)
    };
});
wrapper!(Followed<Strategy> {
    type Runs = Self;
    type Paths = S::Paths;
    const ATTACHED_ROULETTE: bool = S::ATTACHED_ROULETTE;
    const ATTACHED_CHOICE: bool = S::ATTACHED_CHOICE;
    const ALLOWS_BIAS: bool = S::ALLOWS_BIAS;
    const NEEDS_CONTINUITY: bool = S::NEEDS_CONTINUITY;
    const FOLLOWS: Follows = Follows::Closed;
});
