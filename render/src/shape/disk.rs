//! The disk.

use std::f64::consts::PI;

use ad_core::{Dual, Float, Real, Vec2, Vec3};

use super::partials::{constant, variables};
use super::patch::intersect_plane;
use super::{
    Partials, Shape, ShapeSample, SurfaceCoordinates, SurfaceInteraction, coordinates_in_plane,
    double, hit_is_exact, lift3, misplaced, turn,
};
use crate::accel::{Hit, MAX_COORDINATE, MIN_THICKNESS, Primitive};
use crate::error::SceneError;
use crate::math::{Frame, Ray, Transform, angle, each, warp};
use crate::params::Theta;
use crate::plugin::{FromNode, Node, Registry};

/// The unit disk in the local xy plane, normal +z, under an affine transform (an ellipse in general).
/// `uv = (r, phi / 2 pi)` in local polar coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Disk {
    center: [f32; 3],
    e1: [f32; 3],
    e2: [f32; 3],
    n: [f32; 3],
    area: f64,
}

impl Disk {
    /// From the transform of the unit disk. `None` if the area is zero or not finite.
    pub fn new(to_world: &Transform, flip_normals: bool) -> Option<Self> {
        let single = |v: [f64; 3]| v.map(|x| x as f32);
        let center = single(to_world.translation);
        let e1 = single(to_world.vector([1.0, 0.0, 0.0]));
        let e2 = single(to_world.vector([0.0, 1.0, 0.0]));
        let flip = flip_normals ^ (to_world.determinant() < 0.0);
        Self::of(center, e1, e2, flip)
    }

    /// From its centre and half axes; its normal is along `e1 x e2`, or against it if `flip`.
    fn of(center: [f32; 3], e1: [f32; 3], e2: [f32; 3], flip: bool) -> Option<Self> {
        let n = lift3::<f64>(e1).cross(lift3(e2));
        let area = PI * n.length();
        let reachable = [center, e1, e2]
            .iter()
            .flatten()
            .all(|x| x.abs() <= MAX_COORDINATE);
        let (a, b) = (lift3::<f64>(e1).length(), lift3::<f64>(e2).length());
        // What `accel` would never hit.
        let thin = n.length() < f64::from(MIN_THICKNESS) * a.max(b) || n.length() < 1e-6 * a * b;
        if !reachable || thin || area == 0.0 {
            return None;
        }
        let n = n.normalize() * if flip { -1.0 } else { 1.0 };
        Some(Self {
            center,
            e1,
            e2,
            n: n.to_array().map(|x| x as f32),
            area,
        })
    }
}

impl Disk {
    /// The point with these coordinates, world space, and its texture coordinates: without a branch where nothing moves.
    #[inline(always)]
    fn place<R: Real>(&self, SurfaceCoordinates(at): SurfaceCoordinates<R>) -> (Vec3<R>, Vec2<R>) {
        let [center, e1, e2] = each([self.center, self.e1, self.e2], lift3::<R>);
        let Vec2 { x, y } = at;
        let uv = Vec2::new(angle::length(x, y), turn(y, x));
        (center + e1 * x + e2 * y, uv)
    }

    /// From the centre to the rim, world space.
    pub(super) fn half_axes(&self) -> [Vec3<f64>; 2] {
        [self.e1, self.e2].map(lift3)
    }
}

impl Shape for Disk {
    fn primitives(&self) -> Vec<Primitive> {
        vec![Primitive::Disk {
            center: self.center,
            e1: self.e1,
            e2: self.e2,
        }]
    }

    #[inline]
    fn interaction<R: Real>(
        &self,
        theta: &Theta<R>,
        prim: u32,
        ray: &Ray<R>,
        hit: &Hit,
    ) -> SurfaceInteraction<R> {
        let (t, x, y) = if hit_is_exact::<R>() {
            let exact = |x: f32| R::lift(R::Primal::from_f32(x));
            (exact(hit.t), exact(hit.u), exact(hit.v))
        } else {
            let [center, e1, e2] = each([self.center, self.e1, self.e2], lift3::<R>);
            intersect_plane(ray, center, e1, e2)
        };
        SurfaceInteraction {
            t,
            ..self.point_at(theta, prim, SurfaceCoordinates(Vec2::new(x, y)))
        }
    }

    fn coordinates<P: Float>(
        &self,
        _prim: u32,
        si: &SurfaceInteraction<P>,
    ) -> SurfaceCoordinates<P> {
        coordinates_in_plane(si.p, self.center, self.e1, self.e2)
    }

    fn locate<P: Float>(&self, _prim: u32, p: Vec3<P>) -> SurfaceCoordinates<P> {
        coordinates_in_plane(p, self.center, self.e1, self.e2)
    }

    #[inline]
    fn point_at<R: Real>(
        &self,
        _theta: &Theta<R>,
        _prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> SurfaceInteraction<R> {
        let [e1, e2, n] = each([self.e1, self.e2, self.n], lift3::<R>);
        let (p, uv) = self.place(at);
        let outward = if uv.x.primal() > R::Primal::zero() {
            (e1 * at.0.x + e2 * at.0.y).normalize()
        } else {
            e1
        };
        SurfaceInteraction {
            p,
            t: R::zero(),
            n_geo: n,
            frame: Frame::from_normal_and_tangent(n, outward),
            uv,
        }
    }

    fn partials<R: Real>(
        &self,
        _theta: &Theta<R>,
        _prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> Option<Partials<R>> {
        let SurfaceCoordinates(Vec2 { x, y }) = at;
        let [r, turns] = variables(x.hypot(y), turn(y, x));
        let (sin, cos) = (turns * Dual::<R, 2>::c(2.0 * PI)).sin_cos();
        let [center, e1, e2, n] =
            [self.center, self.e1, self.e2, self.n].map(|v| constant(lift3::<R>(v)));
        let outward = e1 * cos + e2 * sin;
        let frame = Frame::from_normal_and_tangent(n, outward);
        Some(Partials::of(center + outward * r, &frame))
    }

    fn area_element<R: Real>(&self, _theta: &Theta<R>, _prim: u32) -> R {
        lift3::<R>(self.e1).cross(lift3(self.e2)).length()
    }

    fn centroid(&self) -> [f64; 3] {
        double(self.center)
    }

    fn placed(&self, by: &Transform) -> Result<Self, String> {
        let single = |v: [f64; 3]| each(v, |x| x as f32);
        let center = single(by.point(double(self.center)));
        let [e1, e2] = [self.e1, self.e2].map(|e| single(by.vector(double(e))));
        let along = lift3::<f64>(self.e1).cross(lift3(self.e2));
        let flip = along.dot(lift3(self.n)) < 0.0;
        Self::of(center, e1, e2, flip).ok_or_else(misplaced)
    }

    fn area(&self) -> f64 {
        self.area
    }

    #[inline(always)]
    fn sample_area<R: Real>(&self, _theta: &Theta<R>, u: [R::Primal; 2]) -> ShapeSample<R> {
        let coordinates = SurfaceCoordinates(warp::square_to_disk(u));
        let (p, uv) = self.place(SurfaceCoordinates::<R>::lift(coordinates));
        ShapeSample {
            p,
            n: lift3(self.n),
            uv,
            pdf: R::Primal::of(1.0 / self.area),
            prim: 0,
            coordinates,
        }
    }

    fn border<R: Real>(&self, _prim: u32, ray: &Ray<R>) -> R {
        let [center, e1, e2] = each([self.center, self.e1, self.e2], lift3::<R>);
        let (t, x, y) = intersect_plane(ray, center, e1, e2);
        let least = e1.length().min(e2.length());
        super::flat_border(t, [(x.hypot(y) - R::c(1.0)) * least])
    }

    fn extent(&self) -> f32 {
        (0..3).fold(0.0, |m, i| {
            m.max(self.center[i].abs() + self.e1[i].hypot(self.e2[i]))
        })
    }
}

impl FromNode for Disk {
    const PLUGINS: &'static [&'static str] = &["disk"];

    fn from_node(node: &Node, _registry: &mut Registry) -> Result<Self, SceneError> {
        let to_world = node.transform("to_world")?.unwrap_or_default();
        let flip = node.boolean_or("flip_normals", false)?;
        Self::new(&to_world, flip).ok_or_else(|| {
            node.invalid(
                "to_world",
                "a transform that leaves a finite, non-zero area",
            )
        })
    }
}
