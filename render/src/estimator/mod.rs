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

mod sampling;
mod strategy;
mod weights;

pub use sampling::{Attached, Detached, Sampling};
pub use strategy::{AllowBias, BsdfOnly, EmitterOnly, Mis, Strategy, Unbiased};
pub use weights::{AttachedWeights, Balance, DetachedWeights, Heuristic, Power, Weights};

/// The default: detached sampling of BSDF and emitters, power heuristic.
pub type DetachedMis = Mis<Detached, Detached, DetachedWeights, Power>;
