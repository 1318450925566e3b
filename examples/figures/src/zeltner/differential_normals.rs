//! Distributions of normals and the two parts of their derivatives with respect to roughness [Zeltner 2021,
//! figures 4.15 and 4.16].

use std::f64::consts::TAU;

use ad_core::Vec3;
use render::bsdf::DiffLobe;
use render::bsdf::microfacet::{Microfacet, Ndf};

pub(super) const ALPHA: f64 = 0.5;
pub(super) const KINDS: [(&str, Ndf); 2] = [("Beckmann", Ndf::Beckmann), ("GGX", Ndf::Ggx)];

pub(super) fn surface<R>(kind: Ndf, alpha: R) -> Microfacet<R> {
    Microfacet {
        kind,
        alpha,
        visible: false,
    }
}

pub(super) fn direction(theta: f64) -> Vec3<f64> {
    Vec3::new(theta.sin(), 0.0, theta.cos())
}

/// Density of the angle `theta` from a density of normals.
pub(super) fn angle(theta: f64, density: f64) -> f64 {
    TAU * theta.sin() * density
}

pub(super) fn part(kind: Ndf, theta: f64, sign: DiffLobe) -> f64 {
    let (surface, m) = (surface(kind, ALPHA), direction(theta));
    if surface.part_of(m) == sign {
        angle(theta, surface.pdf_differential(m))
    } else {
        0.0
    }
}
