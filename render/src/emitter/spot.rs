//! Spot lights.

use std::f64::consts::{PI, TAU};

use ad_core::{Float, Real, Vec2, Vec3};

use super::point::{constant_colour, moving, towards, towards_in_line};
use super::{
    Ball, Border, Connection, Emission, EmittedRay, Emitter, EmitterSample, INSIDE_BORDER, Lights,
    Rays,
};
use crate::error::SceneError;
use crate::math::{Frame, Ray, angle, warp};
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
    cone: Cone,
}

/// Where a spot shines.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cone {
    /// A unit vector.
    axis: [f32; 3],
    /// Angle from the axis up to which all is sent, in radians.
    beam: f64,
    /// That from which nothing is.
    cutoff: f64,
}

impl Cone {
    /// One minus the cosine of the cutoff angle.
    fn opening(&self) -> f64 {
        2.0 * (0.5 * self.cutoff).sin().powi(2)
    }

    /// Fraction of the intensity in the unit direction `d`: without branches where nothing moves, for loops over many.
    #[inline(always)]
    fn profile<R: Real>(&self, d: Vec3<R>) -> R {
        let axis = lift3::<R>(self.axis);
        let across = axis.cross(d);
        // What is too short for the quick norm is no angle.
        let across = if R::IS_PRIMAL {
            across.length_squared().sqrt()
        } else {
            across.length()
        };
        // Not the arccosine, which knows small angles to four digits only.
        let angle = angle::atan2(across, axis.dot(d));
        let at = angle.primal();
        let whole = at <= R::Primal::of(self.beam);
        let lit = at < R::Primal::of(self.cutoff);
        let fading = -(angle - R::c(self.cutoff)) / R::c(self.cutoff - self.beam);
        R::select(whole, R::one(), R::select(lit, fading, R::zero()))
    }

    /// Direction from `from` to a spot at `position`, distance, and what arrives: zero where that is nothing; and whether
    /// this is right. Without branches, for loops over many.
    #[inline(always)]
    pub(crate) fn sample_in_line<P: Float>(
        &self,
        position: [f32; 3],
        from: Vec3<P>,
    ) -> ((Vec3<P>, P, P), bool) {
        let ((d, distance, inverse_square), right) = towards_in_line(position, from);
        ((d, distance, inverse_square * self.profile(-d)), right)
    }
}

impl Spot {
    /// Where it is, world space, and where it shines.
    pub(crate) fn cone(&self) -> ([f32; 3], Cone) {
        (self.position, self.cone)
    }

    /// Whether its light ends at once, and somewhere.
    pub(super) fn has_border(&self) -> bool {
        self.cone.beam == self.cone.cutoff && self.cone.cutoff < PI
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
            cone: Cone {
                axis: axis.to_array().map(|x| x as f32),
                beam: beam.to_radians(),
                cutoff: cutoff.to_radians(),
            },
        })
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
        let falloff = inverse_square * self.cone.profile(-d);
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
        let opening = self.cone.opening();
        let local = warp::square_to_cone([u2, u3], P::of(opening));
        let d = Frame::from_normal(lift3::<P>(self.cone.axis)).to_world(local);
        let falloff = self.cone.profile(d);
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
        let falloff = self.cone.profile(d);
        let emission = Emission {
            uv: Vec2::zero(),
            falloff,
        };
        (falloff > P::zero()).then_some((emission, P::of(0.5 / (PI * self.cone.opening()))))
    }

    fn connect<R: Real>(&self, sample: &EmitterSample<R::Primal>, from: Vec3<R>) -> Connection<R> {
        moving(self.position, sample, from, |d| self.cone.profile(d))
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
        let (sin, cos) = self.cone.cutoff.sin_cos();
        let axis = lift3::<f64>(self.cone.axis);
        let frame = Frame::from_normal(axis);
        let (y, x) = (TAU * u).sin_cos();
        let out = frame.s * x + frame.t * y;
        let inside = axis * sin - out * cos;
        let d = axis * cos + out * sin + inside * (INSIDE_BORDER * self.cone.cutoff);
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

#[cfg(test)]
mod tests {
    use ad_core::Dual;

    use super::*;
    use crate::params::ParamRef;
    use crate::sampler::{Independent, Sampler};
    use crate::texture::Texture;

    /// The profile is linear in the library's angle to a few roundings, and its slope that of differences; what loops find
    /// is what a single sample is, bit by bit.
    #[test]
    fn a_spot_shines_by_the_angle_from_its_axis() {
        let intensity = Texture::Constant(ParamRef { id: 0, offset: 0 });
        let angles = [(10.0, 30.0), (0.0, 180.0), (25.0, 25.0), (60.0, 120.0)];
        for (i, (beam, cutoff)) in angles.into_iter().enumerate() {
            let spot = Spot::new(
                intensity.clone(),
                [1.0, 2.0, 3.0],
                [1.0, -2.0, 0.5],
                beam,
                cutoff,
            );
            let spot = spot.expect("a spot");
            let (position, cone) = spot.cone();
            let axis = lift3::<f64>(cone.axis);
            let exact = |d: Vec3<f64>| {
                let angle = axis.cross(d).length().atan2(axis.dot(d)).to_degrees();
                ((cutoff - angle) / (cutoff - beam)).clamp(0.0, 1.0)
            };
            for k in 0..1000 {
                let mut s = Independent::new(7, i as u64, k);
                let mut unit = || warp::square_to_sphere(s.next_2d::<f64>());
                let (d, aside) = (unit(), unit());
                let angle = axis.cross(d).length().atan2(axis.dot(d)).to_degrees();
                let [from_beam, from_end] = [beam, cutoff].map(|x| (angle - x).abs());
                if from_beam.min(from_end) > 0.01 {
                    let found = cone.profile(d);
                    assert!((found - exact(d)).abs() < 1e-12, "{beam} {cutoff} {d:?}");
                    let single = d.map(|x| x as f32);
                    let near = (f64::from(cone.profile(single)) - found).abs();
                    assert!(near < 1e-4, "{beam} {cutoff} {d:?}");
                    let moved = Vec3::new(
                        Dual::<f64, 1>::new(d.x, [aside.x]),
                        Dual::new(d.y, [aside.y]),
                        Dual::new(d.z, [aside.z]),
                    );
                    let h = 1e-6;
                    let ends = [h, -h].map(|h| cone.profile(d + aside * h));
                    let slope = cone.profile(moved).eps[0];
                    let difference = (ends[0] - ends[1]) / (2.0 * h);
                    assert!((slope - difference).abs() < 1e-4, "{beam} {cutoff} {d:?}");
                }
                let from = (lift3(position) - d * 2.0).map(|x: f64| x as f32);
                let (found, right) = cone.sample_in_line(position, from);
                assert!(right);
                let (d, distance, square) = towards(position, from).expect("not there");
                let falloff = square * cone.profile(-d);
                assert_eq!(found.0.to_array(), d.to_array());
                assert_eq!([found.1, found.2], [distance, falloff]);
            }
            // At the light itself, nothing is right.
            assert!(!cone.sample_in_line(position, lift3::<f32>(position)).1);
        }
    }
}
