//! The surfaces of [Zeltner 2021, figures 2.13 and 2.14]: Beckmann and GGX, at roughness 0.5.

use std::f64::consts::FRAC_PI_2;

use ad_core::Vec3;
use render::bsdf::microfacet::{Microfacet, Ndf};

pub(super) const ALPHA: f64 = 0.5;
pub(super) const KINDS: [(&str, Ndf); 2] = [("Beckmann", Ndf::Beckmann), ("GGX", Ndf::Ggx)];

/// The direction at an angle to the normal; exact at both ends.
pub(super) fn direction(theta: f64) -> Vec3<f64> {
    let cos = if theta == FRAC_PI_2 { 0.0 } else { theta.cos() };
    Vec3::new(theta.sin(), 0.0, cos)
}

pub(super) fn surface(kind: Ndf) -> Microfacet<f64> {
    Microfacet {
        kind,
        alpha: ALPHA,
        visible: false,
    }
}
