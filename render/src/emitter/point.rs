//! Point lights.

use std::f64::consts::PI;

use ad_core::{Float, Real, Vec2, Vec3};

use super::{Ball, Connection, Emission, EmittedRay, Emitter, EmitterSample, Lights, Rays};
use crate::error::SceneError;
use crate::math::{Ray, Transform, warp};
use crate::params::{ParamRef, Params, Theta};
use crate::plugin::{FromNode, Node, Registry};
use crate::shape::{Exit, SurfaceInteraction, lift3};
use crate::texture::RgbTexture;

/// The same intensity in all directions from a point.
#[derive(Clone, Debug)]
pub struct Point {
    /// Radiant intensity, W sr^-1.
    pub intensity: RgbTexture,
    position: [f32; 3],
    /// If that is a parameter.
    moved_by: Option<ParamRef>,
}

impl Point {
    /// A light at `position`, world space.
    pub fn new(intensity: RgbTexture, position: [f32; 3]) -> Self {
        Self {
            intensity,
            position,
            moved_by: None,
        }
    }

    /// Where it is, world space.
    pub fn position(&self) -> [f32; 3] {
        self.position
    }
}

/// Direction from `from` to `position`, distance, and one over its square. `None` where that is not
/// finite.
#[inline]
pub(super) fn towards<R: Real>(position: [f32; 3], from: Vec3<R>) -> Option<(Vec3<R>, R, R)> {
    let to = lift3::<R>(position) - from;
    let distance = to.length();
    let inverse_square = distance.recip() * distance.recip();
    let size = inverse_square.primal();
    let usable = size.is_finite() && size > R::Primal::zero();
    usable.then(|| (to.normalize(), distance, inverse_square))
}

/// [`towards`] without branches, for loops over many, and whether that is right.
#[inline(always)]
pub(crate) fn towards_in_line<P: Float>(
    position: [f32; 3],
    from: Vec3<P>,
) -> ((Vec3<P>, P, P), bool) {
    let to = lift3::<P>(position) - from;
    let (d, long) = to.unit();
    let distance = to.length_squared().sqrt();
    let inverse_square = distance.recip() * distance.recip();
    let usable = (inverse_square > P::zero()) & (inverse_square <= P::MAX);
    ((d, distance, inverse_square), long & usable)
}

/// [`Emitter::connect`] for a light at `position` with a directional `profile`.
#[inline]
pub(super) fn moving<R: Real>(
    position: [f32; 3],
    sample: &EmitterSample<R::Primal>,
    from: Vec3<R>,
    profile: impl Fn(Vec3<R>) -> R,
) -> Connection<R> {
    let (d, falloff) = match towards(position, from) {
        Some((d, _, inverse_square)) => (d, inverse_square * profile(-d)),
        None => (Vec3::lift(sample.d), R::zero()),
    };
    Connection {
        d,
        pdf: R::one(),
        emission: Emission {
            uv: Vec2::zero(),
            falloff,
        },
    }
}

impl Emitter for Point {
    #[inline]
    fn radiance(&self) -> &RgbTexture {
        &self.intensity
    }

    #[inline]
    fn hit<R: Real>(&self, _: Vec3<R>, _: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        None
    }

    #[inline]
    fn sample<P: Float>(&self, _: Lights, from: Vec3<P>, _: [P; 2]) -> Option<EmitterSample<P>> {
        let (d, distance, falloff) = towards(self.position, from)?;
        Some(EmitterSample::without_surface(
            d,
            distance,
            P::one(),
            Emission {
                uv: Vec2::zero(),
                falloff,
            },
        ))
    }

    fn sample_ray<P: Float>(
        &self,
        _theta: &Theta<P>,
        _: Lights,
        _: Option<Ball>,
        [_, _, u2, u3]: [P; 4],
    ) -> Option<EmittedRay<P>> {
        Some(EmittedRay {
            ray: Ray::new(lift3(self.position), warp::square_to_sphere([u2, u3])),
            surface: None,
            exit: Exit::default(),
            pdf_position: P::one(),
            pdf_direction: P::of(0.25 / PI),
            emission: Emission::whole(),
        })
    }

    fn leaves<P: Float>(
        &self,
        _: Vec3<P>,
        _: Option<&SurfaceInteraction<P>>,
    ) -> Option<(Emission<P>, P)> {
        let emission = Emission::whole();
        Some((emission, P::of(0.25 / PI)))
    }

    fn connect<R: Real>(&self, sample: &EmitterSample<R::Primal>, from: Vec3<R>) -> Connection<R> {
        moving(self.position, sample, from, |_| R::one())
    }

    fn update(&mut self, params: &Params) {
        if let Some(p) = self.moved_by {
            let values = &params.values()[p.offset as usize..];
            self.position = [values[0], values[1], values[2]];
        }
    }

    fn mobility(&self) -> Option<(&'static str, [f32; 3])> {
        Some(("position", self.position))
    }

    fn make_movable(&mut self, p: ParamRef) {
        self.moved_by = Some(p);
    }

    fn moved_by(&self) -> Option<ParamRef> {
        self.moved_by
    }

    fn rays(&self, _: Lights) -> Option<Rays> {
        Some(Rays::From(self.position))
    }

    fn is_delta(&self) -> bool {
        true
    }
}

/// The constant colour `key`, a parameter that textures cannot stand in for.
pub(super) fn constant_colour(
    node: &Node,
    registry: &mut Registry,
    key: &str,
) -> Result<RgbTexture, SceneError> {
    let value = node.rgb_or(key, [1.0; 3])?;
    if value.iter().any(|&x| x < 0.0) {
        return Err(node.invalid(key, "a colour without negative channels"));
    }
    let name = format!("{}.{key}.value", registry.prefix());
    let texture = registry.rgb(&name, value, (0.0, f64::INFINITY))?;
    texture.visit_params(&mut |p| registry.origins.of_value(node, key, p));
    Ok(texture)
}

impl FromNode for Point {
    const PLUGINS: &'static [&'static str] = &["point"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let to_world = node.transform("to_world")?;
        let position = match (node.point("position")?, to_world) {
            (Some(_), Some(_)) => {
                return Err(node.invalid("position", "either position or to_world, not both"));
            }
            (Some(p), None) => p,
            (None, t) => t.unwrap_or(Transform::IDENTITY).translation,
        };
        let intensity = constant_colour(node, registry, "intensity")?;
        Ok(Self::new(intensity, position.map(|x| x as f32)))
    }
}
