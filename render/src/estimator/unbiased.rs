//! Which combinations are right: a list of them, and no rule.

use super::{
    AllowBias, Attached, AttachedDirect, AttachedWeights, Balance, BsdfOnly, Convolved, Detached,
    DetachedWeights, Differential, EmitterOnly, Followed, FrozenWeights, Interior, Mis, Outlines,
    Power, Reparameterised, Strategy, TrustBsdf, TrustLights,
};

/// The estimator's derivative has the right expectation.
///
/// It is said for each combination by itself, the valid rows of [Zeltner 2021, table in section 4.5.1], as corrected. A new
/// way of sampling, heuristic or weighting is not among them until somebody has shown that it is right, and adds its rows;
/// until then it takes [`AllowBias`]. Outside this crate that is a [`Strategy`] of one's own:
///
/// ```
/// use ad_core::Real;
/// use render::estimator::{AllowBias, DetachedWeights, Detached, Heuristic, Mis, Unbiased};
///
/// /// The technique that is the likelier one takes all.
/// struct Maximum;
/// impl Heuristic for Maximum {
///     type Primal = Self;
///     fn weight<R: Real>(a: R, b: R) -> R {
///         if a.primal() > b.primal() { R::one() } else { R::zero() }
///     }
/// }
///
/// fn differentiate<S: Unbiased>() {}
/// differentiate::<AllowBias<Mis<Detached, Detached, DetachedWeights, Maximum>>>();
/// ```
///
/// What is right in a limit only is among them, too, and says so ([`Capabilities::in_the_limit`](super::Capabilities)):
/// [`Convolved`].
///
/// Naive attached sampling is among them: it is right where nothing can occlude, which [`crate::Scene::admits`] decides
/// when the scene is known.
#[diagnostic::on_unimplemented(
    message = "nobody has shown that the derivative by `{Self}` is unbiased",
    label = "not among the unbiased combinations",
    note = "attached sampling needs `AttachedWeights` or `FrozenWeights`; weights must be alike for all techniques, and \
            roulette and the choice of lobes must take constant probabilities",
    note = "a new sampling, heuristic or weighting is listed in `estimator/unbiased.rs` once it agrees with finite \
            differences; a `Strategy` of your own may implement `Unbiased` itself",
    note = "until then, or to study the bias on purpose, wrap the combination: `AllowBias<{Self}>`"
)]
pub trait Unbiased: Strategy {}

impl<S: Strategy> Unbiased for AllowBias<S> {}

macro_rules! unbiased {
    ($($strategy:ty;)*) => {
        $(impl Unbiased for $strategy {})*
    };
}

/// The same whatever the number of auxiliary rays.
macro_rules! unbiased_for_all_rays {
    ($($strategy:ty;)*) => {
        $(impl<const RAYS: usize> Unbiased for $strategy {})*
    };
}

/// Samples of the BSDF and of emitters with these weights, by each heuristic.
macro_rules! by_each_heuristic {
    ($list:ident: $($bsdf:ty, $emitter:ty, $weights:ty;)*) => {$(
        $list! {
            Mis<$bsdf, $emitter, $weights, Balance>;
            Mis<$bsdf, $emitter, $weights, Power>;
            Mis<$bsdf, $emitter, $weights, TrustLights>;
            Mis<$bsdf, $emitter, $weights, TrustBsdf>;
        }
    )*};
}

by_each_heuristic! { unbiased:
    Detached, Detached, DetachedWeights;
    Detached, Detached, AttachedWeights;
    Detached, Detached, FrozenWeights;
    Detached, Attached, AttachedWeights;
    Detached, Attached, FrozenWeights;
    Differential, Detached, DetachedWeights;
    Differential, Detached, AttachedWeights;
    Differential, Detached, FrozenWeights;
    AttachedDirect, Detached, AttachedWeights;
    AttachedDirect, Detached, FrozenWeights;
    AttachedDirect, Attached, AttachedWeights;
    AttachedDirect, Attached, FrozenWeights;
    Attached, Detached, AttachedWeights;
    Attached, Detached, FrozenWeights;
}

by_each_heuristic! { unbiased_for_all_rays:
    Reparameterised<RAYS>, Detached, AttachedWeights;
    Reparameterised<RAYS>, Detached, FrozenWeights;
    Reparameterised<RAYS>, Attached, AttachedWeights;
    Reparameterised<RAYS>, Attached, FrozenWeights;
}

unbiased! {
    Outlines<Interior<Mis<Detached, Detached, DetachedWeights>>>;
    BsdfOnly<Detached>;
    BsdfOnly<Differential>;
    BsdfOnly<AttachedDirect>;
    BsdfOnly<Attached>;
    EmitterOnly<Detached>;
    EmitterOnly<Differential>;
    EmitterOnly<AttachedDirect>;
    EmitterOnly<Attached>;
    EmitterOnly<Detached, Attached>;
    EmitterOnly<AttachedDirect, Attached>;
}

unbiased_for_all_rays! {
    Convolved<BsdfOnly<Reparameterised<RAYS>>>;
    Convolved<Mis<Reparameterised<RAYS>, Detached, AttachedWeights>>;
    Followed<Mis<Reparameterised<RAYS>, Detached, AttachedWeights>>;
    BsdfOnly<Reparameterised<RAYS>>;
    EmitterOnly<Reparameterised<RAYS>>;
    EmitterOnly<Reparameterised<RAYS>, Attached>;
}
