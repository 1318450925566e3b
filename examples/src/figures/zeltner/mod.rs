//! [Zeltner 2021], Light path gradients for forward and inverse rendering.
//!
//! Experiments of chapters 2 and 3 that need no scene. Those with random numbers in one dimension
//! share [`mc1`].

pub mod antithetic;
pub mod automatic;
pub mod fresnel;
pub mod importance;
pub mod mc1;
pub mod microfacet;
pub mod mis;
pub mod newton;
pub mod transform;
