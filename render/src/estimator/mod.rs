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
//! (errata Z-4.13f). Which combinations give the right derivative is said by [`Unbiased`]; the others
//! do not compile unless wrapped in [`AllowBias`].

pub mod memory;
mod sampling;
mod strategy;
mod weights;

pub use sampling::{
    Attached, AttachedDirect, Detached, Differential, Direct, EmitterSampling, Reparameterised,
    Sampling, Unsplit,
};
pub(crate) use strategy::Still;
pub use strategy::{
    AllowBias, AttachedChoice, AttachedRoulette, BsdfOnly, Edges, EmitterOnly, Geometry, Mis,
    Strategy, Unbiased, differentiates_edges,
};
pub use weights::{
    AttachedWeights, Balance, DetachedWeights, FrozenWeights, Heuristic, MixedWeights, Power,
    TrustBsdf, TrustLights, Weights,
};

use crate::error::RenderError;
use crate::params::{Differentiability, ParamInfo};

/// The default: detached sampling of BSDF and emitters, power heuristic.
pub type DetachedMis = Mis<Detached, Detached, DetachedWeights, Power>;

/// Whether the estimator sees the derivative in a parameter: constant paths do not see one that moves a
/// Dirac delta, and would give zero (F2).
///
/// # Errors
/// Names the parameter.
pub fn check_parameter<S: Strategy>(info: &ParamInfo) -> Result<(), RenderError> {
    if S::Bsdf::DETACHED_PATH && info.differentiability == Differentiability::Delta {
        return Err(RenderError::DeltaParameter {
            name: info.name.clone(),
        });
    }
    Ok(())
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
