//! Differentiable light transport.

pub mod accel;
pub mod error;
pub mod math;
pub mod scene;
