//! Differentiable light transport.

pub mod error;
pub mod math;
