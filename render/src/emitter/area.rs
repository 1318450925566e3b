//! Surfaces that emit.

use ad_core::{Float, Real, Vec3};

use super::{Emission, Emitter, EmitterSample, Lights};
use crate::bsdf::FromNode;
use crate::error::SceneError;
use crate::scene::{Builder, Node};
use crate::shape::{Shape, SurfaceInteraction};
use crate::texture::RgbTexture;

/// One-sided emission `radiance(uv) cos^exponent(theta)` from the outside of a shape. Exponent 0 is
/// the peer's area light; larger ones are the directional lights of [Christensen et al. 1993].
#[derive(Clone, Debug)]
pub struct Area {
    /// Emitted radiance along the normal, W m^-2 sr^-1.
    pub radiance: RgbTexture,
    /// Sharpness of the lobe; 0 for a diffuse light.
    pub exponent: f32,
    /// Index of the shape.
    pub shape: u32,
}

impl Area {
    #[inline(always)]
    fn lobe<R: Real>(&self, cos_theta: R) -> Option<R> {
        if cos_theta.primal() <= R::Primal::zero() {
            None
        } else if self.exponent == 0.0 {
            Some(R::one())
        } else {
            Some(cos_theta.powf(R::of(f64::from(self.exponent))))
        }
    }
}

impl Emitter for Area {
    #[inline(always)]
    fn radiance(&self) -> &RgbTexture {
        &self.radiance
    }

    #[inline(always)]
    fn hit<R: Real>(&self, d: Vec3<R>, si: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        let si = si?;
        let falloff = self.lobe(-si.frame.n.dot(d))?;
        Some(Emission { uv: si.uv, falloff })
    }

    #[inline(always)]
    fn sample<P: Float>(
        &self,
        lights: Lights,
        from: Vec3<P>,
        u: [P; 2],
    ) -> Option<EmitterSample<P>> {
        let s = lights.shapes[self.shape as usize].sample(from, u)?;
        let falloff = self.lobe(-s.n.dot(s.d))?;
        let emission = Emission { uv: s.uv, falloff };
        Some(EmitterSample {
            d: s.d,
            distance: s.distance,
            pdf: s.pdf,
            emission,
        })
    }

    #[inline(always)]
    fn pdf<P: Float>(
        &self,
        lights: Lights,
        from: Vec3<P>,
        _d: Vec3<P>,
        si: Option<&SurfaceInteraction<P>>,
    ) -> P {
        si.map_or(P::zero(), |si| {
            lights.shapes[self.shape as usize].pdf(from, si)
        })
    }
}

impl FromNode for Area {
    const PLUGINS: &'static [&'static str] = &["area"];

    fn from_node(node: &Node, build: &mut Builder) -> Result<Self, SceneError> {
        let shape = build.current_shape(node)?;
        let exponent = node.float_or("exponent", 0.0)?;
        if !(0.0..=1e4).contains(&exponent) {
            return Err(node.invalid("exponent", "a number in [0, 10000]"));
        }
        let radiance = build.rgb_texture(node, "radiance", [1.0; 3], (0.0, f64::INFINITY))?;
        Ok(Self {
            radiance,
            exponent: exponent as f32,
            shape,
        })
    }
}
