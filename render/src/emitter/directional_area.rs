//! Parallel light from a flat surface.

use std::f64::consts::TAU;

use ad_core::{Float, Real, Vec2, Vec3};

use super::point::constant_colour;
use super::{
    Ball, Border, Emission, EmittedRay, Emitter, EmitterSample, INSIDE_BORDER, Lights, Rays, around,
};
use crate::error::SceneError;
use crate::math::Ray;
use crate::params::Theta;
use crate::plugin::{FromNode, Node, Registry};
use crate::shape::{AnyShape, Shape, SurfaceCoordinates, SurfaceInteraction};
use crate::texture::RgbTexture;

/// Light that leaves a flat surface along its normal, from every point of it: a Dirac delta, which no ray meets by itself.
/// Seen from a point it comes from that point's projection onto the surface, if there is one.
///
/// `directionalarea` of Mitsuba 3, which finds it with particles only. Its `radiance` is power per area.
///
/// # Does not handle
/// Surfaces that are not flat: scenes with such are refused.
#[derive(Clone, Debug)]
pub struct DirectionalArea {
    /// Power per area, which is the irradiance of a surface that faces the light, W m^-2: the same everywhere.
    pub radiance: RgbTexture,
    /// Index of the shape: a rectangle or a disk.
    pub shape: u32,
}

impl DirectionalArea {
    /// Whether light leaves such a surface in one direction.
    pub(crate) fn admits(shape: &AnyShape) -> bool {
        matches!(shape, AnyShape::Rectangle(_) | AnyShape::Disk(_))
    }
}

/// Whether coordinates are on the surface.
fn contains<P: Float>(shape: &AnyShape, SurfaceCoordinates(at): SurfaceCoordinates<P>) -> bool {
    let within = |x: P| x >= P::zero() && x <= P::one();
    match shape {
        AnyShape::Rectangle(_) => within(at.x) && within(at.y),
        AnyShape::Disk(_) => at.x * at.x + at.y * at.y <= P::one(),
        _ => false,
    }
}

impl Emitter for DirectionalArea {
    #[inline]
    fn radiance(&self) -> &RgbTexture {
        &self.radiance
    }

    #[inline]
    fn hit<R: Real>(&self, _: Vec3<R>, _: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        None
    }

    fn sample<P: Float>(
        &self,
        lights: Lights,
        from: Vec3<P>,
        _: [P; 2],
    ) -> Option<EmitterSample<P>> {
        let shape = &lights.shapes[self.shape as usize];
        let at = shape.locate(0, from);
        if !contains(shape, at) {
            return None;
        }
        let si = shape.point_at(&Theta::still(), 0, at);
        let distance = (from - si.p).dot(si.n_geo);
        (distance > P::zero()).then(|| EmitterSample {
            surface: lights.surface(self.shape, 0),
            ..EmitterSample::without_surface(-si.n_geo, distance, P::one(), Emission::whole())
        })
    }

    fn sample_ray<P: Float>(
        &self,
        theta: &Theta<P>,
        lights: Lights,
        _: Option<Ball>,
        [u0, u1, ..]: [P; 4],
    ) -> Option<EmittedRay<P>> {
        let shape = &lights.shapes[self.shape as usize];
        let s = shape.sample_area(theta, [u0, u1]);
        let at = SurfaceCoordinates::lift(s.coordinates);
        let si = shape.point_at(theta, s.prim, at);
        Some(EmittedRay {
            ray: Ray::new(si.p, si.n_geo),
            surface: Some((self.shape, si)),
            exit: lights.prim(self.shape, s.prim).exit,
            pdf_position: s.pdf,
            pdf_direction: P::one(),
            emission: Emission::whole(),
        })
    }

    fn rays(&self, lights: Lights) -> Option<Rays> {
        let shape = &lights.shapes[self.shape as usize];
        let at = SurfaceCoordinates(Vec2::splat(0.5));
        let si = shape.point_at::<f64>(&Theta::still(), 0, at);
        Some(Rays::Along(si.n_geo))
    }

    fn border<P: Float>(&self, lights: Lights, u: f64) -> Option<Border<P>> {
        let shape = &lights.shapes[self.shape as usize];
        let on = |at: [f64; 2]| {
            let at = SurfaceCoordinates(at.into());
            shape.point_at::<f64>(&Theta::still(), 0, at)
        };
        let (middle, [p, tangent]) = match shape {
            AnyShape::Rectangle(_) => {
                let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
                (on([0.5; 2]), around(corners.map(|at| on(at).p), u))
            }
            AnyShape::Disk(_) => {
                let (sin, cos) = (TAU * u).sin_cos();
                let [middle, rim, ahead] = [[0.0; 2], [cos, sin], [-sin, cos]].map(on);
                (middle, [rim.p, (ahead.p - middle.p) * TAU])
            }
            _ => return None,
        };
        let n = middle.n_geo;
        let plane = n.cross(tangent);
        let towards = middle.p - p;
        let start = p + towards * INSIDE_BORDER;
        let exit = lights.prim(self.shape, 0).exit;
        Some(Border {
            ray: Ray {
                from: exit.surface,
                ..Ray::new(start.map(P::of), n.map(P::of).normalize())
            },
            inside: plane.normalize() * plane.dot(towards).signum(),
            length: tangent.length(),
            emission: Emission::whole(),
        })
    }

    fn is_delta(&self) -> bool {
        true
    }
}

impl FromNode for DirectionalArea {
    const PLUGINS: &'static [&'static str] = &["directionalarea"];

    /// `radiance` (1).
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let shape = registry.current_shape(node)?;
        let radiance = constant_colour(node, registry, "radiance")?;
        Ok(Self { radiance, shape })
    }
}
