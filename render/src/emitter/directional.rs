//! Parallel light.

use ad_core::{Float, Real, Vec3};

use super::point::constant_colour;
use super::{Emission, Emitter, EmitterSample, Lights, Rays};
use crate::error::SceneError;
use crate::motion::Placement;
use crate::params::{ParamRef, Params};
use crate::plugin::{FromNode, Node, Registry};
use crate::shape::{SurfaceInteraction, lift3};
use crate::texture::RgbTexture;

/// Light from infinitely far away along one direction, as of the sun: a Dirac delta, which no ray meets by itself.
#[derive(Clone, Debug)]
pub struct Directional {
    /// Irradiance of a surface that faces the light, W m^-2.
    pub irradiance: RgbTexture,
    /// The unit direction that light travels in, world space.
    direction: [f32; 3],
    /// The same before it is turned, and how it is.
    direction_at_rest: [f32; 3],
    turned: Placement,
}

impl Directional {
    /// Light that travels along `direction`, of any length. `None` if that is none.
    pub fn new(irradiance: RgbTexture, direction: [f64; 3]) -> Option<Self> {
        let direction = Vec3::from(direction).normalize();
        let single = direction.to_array().map(|x| x as f32);
        ((direction.length() - 1.0).abs() < 0.5).then(|| Self {
            irradiance,
            direction: single,
            direction_at_rest: single,
            turned: Placement::default(),
        })
    }
}

impl Emitter for Directional {
    #[inline]
    fn radiance(&self) -> &RgbTexture {
        &self.irradiance
    }

    #[inline]
    fn hit<R: Real>(&self, _: Vec3<R>, _: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        None
    }

    #[inline]
    fn sample<P: Float>(&self, _: Lights, _: Vec3<P>, _: [P; 2]) -> Option<EmitterSample<P>> {
        Some(EmitterSample::without_surface(
            -lift3::<P>(self.direction).normalize(),
            P::of(f64::INFINITY),
            P::one(),
            Emission::whole(),
        ))
    }

    fn rays(&self, _: Lights) -> Option<Rays> {
        Some(Rays::Along(lift3(self.direction).normalize()))
    }

    fn is_delta(&self) -> bool {
        true
    }

    fn is_infinite(&self) -> bool {
        true
    }

    fn update(&mut self, params: &Params) {
        self.direction = self.turned.turn(params, self.direction_at_rest);
    }

    fn make_movable(&mut self, p: ParamRef) {
        self.turned.rotation = Some(p);
    }

    fn turned(&self) -> Option<&Placement> {
        Some(&self.turned)
    }
}

impl FromNode for Directional {
    const PLUGINS: &'static [&'static str] = &["directional"];

    /// `irradiance` (1), and either `direction` or the z axis of `to_world`.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let (key, direction) = match (node.vector("direction")?, node.transform("to_world")?) {
            (Some(_), Some(_)) => {
                let expected = "either direction or to_world, not both";
                return Err(node.invalid("direction", expected));
            }
            (Some(d), None) => ("direction", d),
            (None, t) => ("to_world", t.unwrap_or_default().vector([0.0, 0.0, 1.0])),
        };
        let irradiance = constant_colour(node, registry, "irradiance")?;
        Self::new(irradiance, direction)
            .ok_or_else(|| node.invalid(key, "a direction that is not zero"))
    }
}
