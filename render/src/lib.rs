//! Light transport over a scalar: render, differentiate, compare estimators.
//!
//! The renderer is written once over [`ad_core::Real`]. With `f32` it renders; with `f64` it is its
//! own reference; with [`ad_core::Dual`] it renders derivative images (forward mode); and over recorded
//! paths it pulls an adjoint image back to all parameters at once (reverse mode). Where derivatives may
//! flow is a type: see [`estimator`].

pub mod accel;
pub mod auto;
pub mod bsdf;
pub mod camera;
mod dispatch;
pub mod emitter;
pub mod error;
pub mod estimator;
pub mod files;
pub mod film;
pub mod finite_element;
pub mod guide;
pub mod image_io;
pub mod instances;
pub mod integrator;
pub mod math;
mod parallel;
pub mod params;
mod prefetch;
pub mod sampler;
pub mod scene;
pub mod shape;
pub mod texture;

pub use error::{RenderError, SceneError};
pub use film::{Film, Image};
pub use scene::{Scene, Settings};
