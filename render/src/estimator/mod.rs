//! Where derivatives may flow, as types.
//!
//! A [`Strategy`] says how directions are sampled ([`Sampling`]), how the techniques are weighted
//! ([`Weights`], [`Heuristic`]) and which techniques take part. All of it is chosen at compile time: the
//! path tracer is written once, and a combination is one line at the call site.
//!
//! *Detached is a type, not a call.* [`Detached`] sampling has primal geometry: rays,
//! interactions, directions and densities are `f32` or `f64`, so no tangent can exist there.
//! [`Attached`] sampling keeps the full scalar, and samples move with the parameters.
//!
//! MIS weights are attached or detached for the whole combination, never per technique
//! (errata Z-4.13f). Which combinations give the right derivative is said by [`Unbiased`], one by one; the others
//! do not compile unless wrapped in [`AllowBias`].
//!
//! What a strategy sees, where it is right and what it refuses is read from its constants: [`Capabilities`].
//!
//! ```
//! use render::estimator::{AllowBias, AttachedWeights, Capabilities, Detached, Mis, Reparameterised, Unbiased};
//! use render::instances::Estimator;
//!
//! // A technique, how scattered directions follow the parameters, and how weights do.
//! type Follows = Mis<Reparameterised, Detached, AttachedWeights>;
//! fn right<S: Unbiased>() -> Capabilities {
//!     Capabilities::of::<S>()
//! }
//! assert!(right::<Follows>().samples_emitters);
//! // What is said of no combination does not compile, unless the bias is asked for.
//! # type Wrong = Mis<Reparameterised, Detached, render::estimator::DetachedWeights>;
//! let wrong = right::<AllowBias<Wrong>>(); // the same with weights that stay
//! assert!(wrong.study && wrong.failures.iter().count() > 0);
//!
//! // The combinations that have names say the same of themselves.
//! for estimator in Estimator::ALL {
//!     println!("{}: {}", estimator.name(), estimator.capabilities());
//! }
//! ```

mod capabilities;
pub mod memory;
mod sampling;
mod strategy;
mod study;
mod unbiased;
mod weights;

pub use capabilities::{Capabilities, Failure, Failures, Modes, Motion, Refusal, Scenes};
pub use sampling::{
    Attached, AttachedDirect, Detached, Differential, Direct, EmitterSampling, Reparameterised,
    Sampling, Unsplit,
};
pub use strategy::{
    AllowBias, BsdfOnly, Convolved, Edges, EmitterOnly, Followed, Follows, Geometry, Interior, Mis,
    Outlines, Strategy, differentiates_edges, goes_in_waves, is_guided,
};
pub use study::{
    AttachedChoice, AttachedRoulette, MixedWeights, RaysAtRest, TrustBsdf, TrustLights,
};
pub use unbiased::Unbiased;
pub use weights::{
    AttachedWeights, Balance, DetachedWeights, FrozenWeights, Heuristic, Power, Weights,
};

use crate::error::RenderError;
use crate::params::{ParamInfo, ParamKind};

/// The default: detached sampling of BSDF and emitters, power heuristic.
pub type DetachedMis = Mis<Detached, Detached, DetachedWeights, Power>;

/// Whether the estimator sees the derivative in a parameter ([`Capabilities::sees`]): constant paths do not see one that
/// moves a Dirac delta, and would give zero (F2).
///
/// # Errors
/// Names the parameter.
pub fn check_parameter<S: Strategy>(info: &ParamInfo) -> Result<(), RenderError> {
    let name = || info.name.clone();
    match Capabilities::of::<S>().refusal_of(info.kind) {
        None => Ok(()),
        Some(_) if info.kind == ParamKind::Delta => {
            Err(RenderError::DeltaParameter { name: name() })
        }
        Some(Refusal { what, why }) => Err(RenderError::UnseenParameter {
            name: name(),
            what,
            why,
        }),
    }
}

/// Which way derivatives are carried.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Derivative images along a direction.
    Forward,
    /// Gradients.
    #[default]
    Reverse,
}
