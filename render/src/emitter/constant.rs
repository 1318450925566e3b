//! The uniform environment.

use std::f64::consts::PI;

use ad_core::{Float, Real, Vec3};

use super::point::constant_colour;
use super::{Emission, Emitter, EmitterSample, Lights};
use crate::error::SceneError;
use crate::math::warp;
use crate::plugin::{FromNode, Node, Registry};
use crate::shape::SurfaceInteraction;
use crate::texture::RgbTexture;

/// The same radiance from every direction.
#[derive(Clone, Debug)]
pub struct Constant {
    /// Radiance, W m^-2 sr^-1.
    pub radiance: RgbTexture,
}

impl Constant {
    /// Density of sampled directions, per solid angle.
    #[inline(always)]
    pub(crate) fn density<R: Real>() -> R {
        R::of(0.25 / PI)
    }
}

impl Emitter for Constant {
    #[inline]
    fn radiance(&self) -> &RgbTexture {
        &self.radiance
    }

    #[inline]
    fn hit<R: Real>(&self, _: Vec3<R>, si: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        si.is_none().then(|| Emission::whole())
    }

    #[inline]
    fn sample<P: Float>(&self, _: Lights, _: Vec3<P>, u: [P; 2]) -> Option<EmitterSample<P>> {
        Some(EmitterSample::without_surface(
            warp::square_to_sphere(u),
            P::of(f64::INFINITY),
            Self::density(),
            Emission::whole(),
        ))
    }

    #[inline]
    fn pdf<R: Real>(
        &self,
        _: Lights,
        _: Vec3<R>,
        _: Vec3<R>,
        si: Option<&SurfaceInteraction<R>>,
    ) -> R {
        R::select(si.is_none(), Self::density(), R::zero())
    }

    fn is_infinite(&self) -> bool {
        true
    }

    fn is_wide(&self) -> bool {
        true
    }
}

impl FromNode for Constant {
    const PLUGINS: &'static [&'static str] = &["constant"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        Ok(Self {
            radiance: constant_colour(node, registry, "radiance")?,
        })
    }
}
