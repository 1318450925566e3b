//! Parallel light from a flat surface.

use std::f64::consts::TAU;

use ad_core::{Float, Real, Vec2, Vec3};

use super::point::constant_colour;
use super::{
    Ball, Border, Emission, EmittedRay, Emitter, EmitterSample, INSIDE_BORDER, Lights, Rays,
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

/// Coordinates of a point of the border of a surface, chosen by a number in [0, 1), their change with it, and those of the
/// middle.
fn border(shape: &AnyShape, u: f64) -> Option<[[f64; 2]; 3]> {
    match shape {
        AnyShape::Rectangle(_) => {
            let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
            let side = ((4.0 * u) as usize).min(3);
            let [a, b] = [corners[side], corners[(side + 1) % 4]];
            let along = [0, 1].map(|k: usize| b[k] - a[k]);
            let at = [0, 1].map(|k: usize| a[k] + along[k] * (4.0 * u - side as f64));
            Some([at, along.map(|x| 4.0 * x), [0.5; 2]])
        }
        AnyShape::Disk(_) => {
            let (sin, cos) = (TAU * u).sin_cos();
            Some([[cos, sin], [-TAU * sin, TAU * cos], [0.0; 2]])
        }
        _ => None,
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
        let [at, change, middle] = border(shape, u)?.map(Vec2::from);
        // Both surfaces are linear in their coordinates.
        let on = |at| shape.point_at::<f64>(&Theta::still(), 0, SurfaceCoordinates(at));
        let n = on(middle).n_geo;
        let tangent = on(middle + change).p - on(middle).p;
        let plane = n.cross(tangent);
        let towards = on(middle).p - on(at).p;
        let start = on(at + (middle - at) * INSIDE_BORDER).p;
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
