//! Spot lights.

use std::f64::consts::{PI, TAU};

use ad_core::{Float, Real, Vec2, Vec3};

use super::point::{constant_colour, moving, towards};
use super::{
    Ball, Border, Connection, Emission, EmittedRay, Emitter, EmitterSample, INSIDE_BORDER, Lights,
    Rays,
};
use crate::error::SceneError;
use crate::math::{Frame, Ray, warp};
use crate::params::{ParamRef, Params, Theta};
use crate::plugin::{FromNode, Node, Registry};
use crate::shape::{Exit, SurfaceInteraction, lift3};
use crate::texture::RgbTexture;

/// A point light with a cone: full intensity up to the beam angle from the axis, from there to the
/// cutoff a linear decrease *in the angle* to zero, as in Mitsuba 3.
#[derive(Clone, Debug)]
pub struct Spot {
    /// Radiant intensity along the axis, W sr^-1.
    pub intensity: RgbTexture,
    position: [f32; 3],
    /// If that is a parameter.
    moved_by: Option<ParamRef>,
    axis: [f32; 3],
    beam: f64,
    cutoff: f64,
}

impl Spot {
    /// One minus the cosine of the cutoff angle.
    fn opening(&self) -> f64 {
        2.0 * (0.5 * self.cutoff).sin().powi(2)
    }

    /// Whether its light ends at once, and somewhere.
    pub(super) fn has_border(&self) -> bool {
        self.beam == self.cutoff && self.cutoff < PI
    }

    /// A light at `position` that shines along `axis`; angles from the axis in degrees. `None` unless
    /// `0 <= beam <= cutoff <= 180`, cutoff positive, and the axis has a direction.
    pub fn new(
        intensity: RgbTexture,
        position: [f64; 3],
        axis: [f64; 3],
        beam: f64,
        cutoff: f64,
    ) -> Option<Self> {
        let axis = Vec3::from(axis).normalize();
        let angles = 0.0 <= beam && beam <= cutoff && 0.0 < cutoff && cutoff <= 180.0;
        let usable = (axis.length() - 1.0).abs() < 0.5 && position.iter().all(|x| x.is_finite());
        (angles && usable).then(|| Self {
            intensity,
            position: position.map(|x| x as f32),
            moved_by: None,
            axis: axis.to_array().map(|x| x as f32),
            beam: beam.to_radians(),
            cutoff: cutoff.to_radians(),
        })
    }

    /// Fraction of the intensity in the unit direction `d`.
    #[inline]
    fn profile<R: Real>(&self, d: Vec3<R>) -> R {
        let axis = lift3::<R>(self.axis);
        // Not the arccosine, which knows small angles to four digits only.
        let angle = axis.cross(d).length().atan2(axis.dot(d));
        let at = angle.primal().to_f64();
        if at <= self.beam {
            R::one()
        } else if at < self.cutoff {
            -(angle - R::c(self.cutoff)) / R::c(self.cutoff - self.beam)
        } else {
            R::zero()
        }
    }
}

impl Emitter for Spot {
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
        let (d, distance, inverse_square) = towards(self.position, from)?;
        let falloff = inverse_square * self.profile(-d);
        (falloff > P::zero()).then_some(EmitterSample::without_surface(
            d,
            distance,
            P::one(),
            Emission {
                uv: Vec2::zero(),
                falloff,
            },
        ))
    }

    /// Uniform over the cone.
    fn sample_ray<P: Float>(
        &self,
        _theta: &Theta<P>,
        _: Lights,
        _: Option<Ball>,
        [_, _, u2, u3]: [P; 4],
    ) -> Option<EmittedRay<P>> {
        let opening = self.opening();
        let local = warp::square_to_cone([u2, u3], P::of(opening));
        let d = Frame::from_normal(lift3::<P>(self.axis)).to_world(local);
        let falloff = self.profile(d);
        let pdf_direction = P::of(0.5 / (PI * opening));
        (pdf_direction <= P::MAX).then_some(EmittedRay {
            ray: Ray::new(lift3(self.position), d),
            surface: None,
            exit: Exit::default(),
            pdf_position: P::one(),
            pdf_direction,
            emission: Emission {
                uv: Vec2::zero(),
                falloff,
            },
        })
    }

    fn leaves<P: Float>(
        &self,
        d: Vec3<P>,
        _: Option<&SurfaceInteraction<P>>,
    ) -> Option<(Emission<P>, P)> {
        let falloff = self.profile(d);
        let emission = Emission {
            uv: Vec2::zero(),
            falloff,
        };
        (falloff > P::zero()).then_some((emission, P::of(0.5 / (PI * self.opening()))))
    }

    fn connect<R: Real>(&self, sample: &EmitterSample<R::Primal>, from: Vec3<R>) -> Connection<R> {
        moving(self.position, sample, from, |d| self.profile(d))
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

    fn border<P: Float>(&self, _: Lights, u: f64) -> Option<Border<P>> {
        let (sin, cos) = self.cutoff.sin_cos();
        let axis = lift3::<f64>(self.axis);
        let frame = Frame::from_normal(axis);
        let (y, x) = (TAU * u).sin_cos();
        let out = frame.s * x + frame.t * y;
        let inside = axis * sin - out * cos;
        let d = axis * cos + out * sin + inside * (INSIDE_BORDER * self.cutoff);
        Some(Border {
            ray: Ray::new(lift3(self.position), d.map(P::of).normalize()),
            inside,
            length: TAU * sin,
            emission: Emission {
                uv: Vec2::zero(),
                falloff: P::one(),
            },
        })
    }

    fn is_delta(&self) -> bool {
        true
    }
}

impl FromNode for Spot {
    const PLUGINS: &'static [&'static str] = &["spot"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let to_world = node.transform("to_world")?.unwrap_or_default();
        let cutoff = node.float_or("cutoff_angle", 20.0)?;
        if !(cutoff > 0.0 && cutoff <= 180.0) {
            return Err(node.invalid("cutoff_angle", "a number of degrees in (0, 180]"));
        }
        let beam = node.float_or("beam_width", 0.75 * cutoff)?;
        if !(0.0..=cutoff).contains(&beam) {
            return Err(node.invalid("beam_width", "a number of degrees in [0, cutoff_angle]"));
        }
        let intensity = constant_colour(node, registry, "intensity")?;
        let axis = to_world.vector([0.0, 0.0, 1.0]);
        Self::new(intensity, to_world.translation, axis, beam, cutoff).ok_or_else(|| {
            node.invalid("to_world", "a transform that leaves the z axis a direction")
        })
    }
}
