//! Lambertian reflection.

use std::f64::consts::FRAC_1_PI;

use ad_core::{Real, Vec3};

use super::{BsdfSample, Leaf, Lobe, Reader, TransportMode};
use crate::error::SceneError;
use crate::math::{Rgb, warp};
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::RgbTexture;

/// An ideally diffuse, one-sided reflector.
#[derive(Clone, Debug)]
pub struct Diffuse {
    /// Albedo, in [0, 1].
    pub reflectance: RgbTexture,
}

/// `f_s = reflectance / pi` above the surface.
#[derive(Clone, Copy, Debug)]
pub struct DiffuseLobe<R> {
    /// Albedo.
    pub reflectance: Rgb<R>,
}

impl Leaf for Diffuse {
    type Lobe<R: Real> = DiffuseLobe<R>;

    #[inline(always)]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> DiffuseLobe<R> {
        DiffuseLobe {
            reflectance: read.rgb(&self.reflectance),
        }
    }
}

impl<R: Real> Lobe<R> for DiffuseLobe<R> {
    #[inline(always)]
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
        let zero = R::Primal::zero();
        if wo.z.primal() <= zero || wi.z.primal() <= zero {
            return Rgb::black();
        }
        self.reflectance * (wi.z * R::c(FRAC_1_PI))
    }

    #[inline(always)]
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> R {
        if wo.z.primal() <= R::Primal::zero() {
            return R::zero();
        }
        warp::cosine_hemisphere_pdf(wi.z)
    }

    #[inline(always)]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        if wo.z.primal() <= R::Primal::zero() {
            return None;
        }
        let wi = Vec3::lift(warp::square_to_cosine_hemisphere([u[1], u[2]]));
        let pdf = self.pdf(wo, wi, mode);
        BsdfSample::reflected(wi, pdf)
    }
}

impl FromNode for Diffuse {
    const PLUGINS: &'static [&'static str] = &["diffuse"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        Ok(Self {
            reflectance: registry.rgb_texture(node, "reflectance", [0.5; 3], (0.0, 1.0))?,
        })
    }
}
