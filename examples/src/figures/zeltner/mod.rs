//! [Zeltner 2021], Light path gradients for forward and inverse rendering.
//!
//! Experiments that need no scene. Those with random numbers in one dimension share [`mc1`], those with
//! differential estimators [`taxonomy`].

pub mod antithetic;
pub mod automatic;
pub mod combinations;
pub mod differential_normals;
pub mod fresnel;
pub mod importance;
pub mod mc1;
pub mod microfacet;
pub mod mis;
pub mod newton;
pub mod strategies;
pub mod taxonomy;
pub mod transform;
