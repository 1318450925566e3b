//! Flat parallelograms: the rectangle, and the faces of the cube.

use ad_core::{Const, Float, Real, Vec2, Vec3};

use super::partials::{constant, variables};
use super::{
    Partials, Shape, ShapeSample, SurfaceCoordinates, SurfaceInteraction, coordinates_in_plane,
    double, hit_is_exact, lift3, misplaced,
};
use crate::accel::{Hit, MAX_COORDINATE, MIN_THICKNESS, Primitive};
use crate::error::SceneError;
use crate::math::{Frame, Ray, Transform, each};
use crate::params::Theta;
use crate::plugin::{FromNode, Node, Registry};

/// A parallelogram `corner + u e1 + v e2`, with surface coordinates `(u, v)` in [0, 1]^2.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Corner at `uv = (0, 0)`, world space.
    pub corner: [f32; 3],
    /// Edge along u.
    pub e1: [f32; 3],
    /// Edge along v.
    pub e2: [f32; 3],
    frame: Frame<f32>,
    area: f64,
    inv_area: f64,
}

impl Patch {
    /// From a corner and two edges, with the unit normal along `e1 x e2`, or against it if `flip`.
    /// `None` if the area is zero or not finite.
    pub fn new(corner: [f64; 3], e1: [f64; 3], e2: [f64; 3], flip: bool) -> Option<Self> {
        let (a, b): (Vec3<f64>, Vec3<f64>) = (e1.into(), e2.into());
        let n = a.cross(b);
        let area = n.length();
        let finite = corner.iter().all(|x| x.is_finite()) && area.is_finite();
        // What `accel` would never hit.
        let thin = f64::from(MIN_THICKNESS) * a.length().max(b.length());
        if !finite || area <= thin {
            return None;
        }
        let n = n.normalize();
        let f = Frame::from_normal_and_tangent(if flip { -n } else { n }, a);
        let single = |v: Vec3<f64>| Vec3::new(v.x as f32, v.y as f32, v.z as f32);
        Some(Self {
            corner: corner.map(|x| x as f32),
            e1: e1.map(|x| x as f32),
            e2: e2.map(|x| x as f32),
            frame: Frame {
                s: single(f.s),
                t: single(f.t),
                n: single(f.n),
            },
            area,
            inv_area: 1.0 / area,
        })
    }

    /// What the acceleration structure intersects.
    pub fn primitive(&self) -> Primitive {
        Primitive::Parallelogram {
            v0: self.corner,
            e1: self.e1,
            e2: self.e2,
        }
    }

    /// Area, world space.
    pub fn area(&self) -> f64 {
        self.area
    }

    /// Its unit normal, world space.
    pub(crate) fn normal(&self) -> Vec3<f64> {
        lift3(self.frame.n.to_array())
    }

    /// Its middle, world space.
    pub fn centroid(&self) -> [f64; 3] {
        let [corner, e1, e2] = [self.corner, self.e1, self.e2].map(lift3::<f64>);
        (corner + (e1 + e2) * 0.5).to_array()
    }

    /// See [`Shape::placed`].
    pub fn placed(&self, by: &Transform) -> Option<Self> {
        let [e1, e2] = [self.e1, self.e2].map(double);
        let along = Vec3::from(e1).cross(e2.into());
        let flip = along.dot(lift3(self.frame.n.to_array())) < 0.0;
        let corner = by.point(double(self.corner));
        let near = |v: f64| v.abs() <= f64::from(MAX_COORDINATE);
        let placed = Self::new(corner, by.vector(e1), by.vector(e2), flip);
        placed.filter(|_| corner.into_iter().all(near))
    }

    /// Largest absolute coordinate.
    pub fn extent(&self) -> f32 {
        (0..3).fold(0.0, |m, i| {
            m.max(self.corner[i].abs() + self.e1[i].abs() + self.e2[i].abs())
        })
    }

    /// See [`Shape::interaction`].
    #[inline(always)]
    pub fn interaction<R: Real>(&self, ray: &Ray<R>, hit: &Hit) -> SurfaceInteraction<R> {
        let (v0, e1, e2) = (
            lift3::<R>(self.corner),
            lift3::<R>(self.e1),
            lift3::<R>(self.e2),
        );
        let (t, u, v) = if hit_is_exact::<R>() {
            let exact = |x: f32| R::lift(R::Primal::from_f32(x));
            (exact(hit.t), exact(hit.u), exact(hit.v))
        } else {
            intersect_plane(ray, v0, e1, e2)
        };
        SurfaceInteraction {
            t,
            ..self.point_at(SurfaceCoordinates(Vec2::new(u, v)))
        }
    }

    /// See [`Shape::coordinates`].
    #[inline]
    pub fn coordinates<P: Float>(&self, si: &SurfaceInteraction<P>) -> SurfaceCoordinates<P> {
        SurfaceCoordinates(si.uv)
    }

    /// See [`Shape::locate`].
    pub fn locate<P: Float>(&self, p: Vec3<P>) -> SurfaceCoordinates<P> {
        coordinates_in_plane(p, self.corner, self.e1, self.e2)
    }

    /// See [`Shape::point_at`].
    #[inline(always)]
    pub fn point_at<R: Real>(&self, at: SurfaceCoordinates<R>) -> SurfaceInteraction<R> {
        let [v0, e1, e2] = each([self.corner, self.e1, self.e2], lift3::<R>);
        let frame = self.frame();
        let SurfaceCoordinates(uv) = at;
        SurfaceInteraction {
            p: v0 + e1 * uv.x + e2 * uv.y,
            t: R::zero(),
            n_geo: frame.n,
            frame,
            uv,
        }
    }

    #[inline(always)]
    fn frame<R: Real>(&self) -> Frame<R> {
        let lift = |v: Vec3<f32>| lift3::<R>(v.to_array());
        Frame {
            s: lift(self.frame.s),
            t: lift(self.frame.t),
            n: lift(self.frame.n),
        }
    }

    /// See [`Shape::partials`].
    pub fn partials<R: Real>(&self, at: SurfaceCoordinates<R>) -> Partials<R> {
        let [v0, e1, e2] = each([self.corner, self.e1, self.e2], |v| constant(lift3::<R>(v)));
        let [u, v] = variables(at.0.x, at.0.y);
        Partials::of(v0 + e1 * u + e2 * v, &self.frame())
    }

    /// See [`Shape::area_element`].
    pub fn area_element<R: Real>(&self) -> R {
        lift3::<R>(self.e1).cross(lift3(self.e2)).length()
    }

    /// See [`Shape::border`].
    pub fn border<R: Real>(&self, ray: &Ray<R>) -> R {
        let [v0, e1, e2] = each([self.corner, self.e1, self.e2], lift3::<R>);
        let (t, u, v) = intersect_plane(ray, v0, e1, e2);
        // Height of the parallelogram over each edge.
        let height = |edge: Vec3<R>| R::Primal::of(self.area) / edge.length().primal();
        let outside = |x: R, height| (-x).max(x - R::c(1.0)) * Const(height);
        super::flat_border(t, [outside(u, height(e2)), outside(v, height(e1))])
    }

    /// A uniform point; density per area of this patch.
    #[inline(always)]
    pub fn sample_area<R: Real>(&self, u: [R::Primal; 2]) -> ShapeSample<R> {
        let coordinates = SurfaceCoordinates(Vec2::new(u[0], u[1]));
        let at = self.point_at(SurfaceCoordinates::<R>::lift(coordinates));
        ShapeSample {
            p: at.p,
            n: at.n_geo,
            uv: at.uv,
            pdf: R::Primal::of(self.inv_area),
            prim: 0,
            coordinates,
        }
    }
}

/// Distance and coordinates `(t, u, v)` of the intersection of a ray with the plane
/// `v0 + u e1 + v e2` [Moeller and Trumbore 1997]. The ray must not be parallel to the plane.
#[inline]
pub fn intersect_plane<R: Real>(ray: &Ray<R>, v0: Vec3<R>, e1: Vec3<R>, e2: Vec3<R>) -> (R, R, R) {
    let h = ray.d.cross(e2);
    let inv_det = e1.dot(h).recip();
    let s = ray.o - v0;
    let q = s.cross(e1);
    (
        e2.dot(q) * inv_det,
        s.dot(h) * inv_det,
        ray.d.dot(q) * inv_det,
    )
}

/// The square [-1, 1]^2 in the local xy plane, normal +z, `uv = ((x + 1) / 2, (y + 1) / 2)`.
#[derive(Clone, Copy, Debug)]
pub struct Rectangle(pub Patch);

impl Shape for Rectangle {
    fn primitives(&self) -> Vec<Primitive> {
        vec![self.0.primitive()]
    }
    #[inline(always)]
    fn interaction<R: Real>(
        &self,
        _theta: &Theta<R>,
        _prim: u32,
        ray: &Ray<R>,
        hit: &Hit,
    ) -> SurfaceInteraction<R> {
        self.0.interaction(ray, hit)
    }
    fn coordinates<P: Float>(
        &self,
        _prim: u32,
        si: &SurfaceInteraction<P>,
    ) -> SurfaceCoordinates<P> {
        self.0.coordinates(si)
    }
    fn locate<P: Float>(&self, _prim: u32, p: Vec3<P>) -> SurfaceCoordinates<P> {
        self.0.locate(p)
    }
    fn point_at<R: Real>(
        &self,
        _theta: &Theta<R>,
        _prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> SurfaceInteraction<R> {
        self.0.point_at(at)
    }
    fn partials<R: Real>(
        &self,
        _theta: &Theta<R>,
        _prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> Option<Partials<R>> {
        Some(self.0.partials(at))
    }
    fn area_element<R: Real>(&self, _theta: &Theta<R>, _prim: u32) -> R {
        self.0.area_element()
    }
    fn patch(&self, _prim: u32) -> Option<&Patch> {
        Some(&self.0)
    }
    fn centroid(&self) -> [f64; 3] {
        self.0.centroid()
    }
    fn placed(&self, by: &Transform) -> Result<Self, String> {
        self.0.placed(by).map(Self).ok_or_else(misplaced)
    }
    fn area(&self) -> f64 {
        self.0.area()
    }
    #[inline(always)]
    fn sample_area<R: Real>(&self, _theta: &Theta<R>, u: [R::Primal; 2]) -> ShapeSample<R> {
        self.0.sample_area(u)
    }
    fn border<R: Real>(&self, _prim: u32, ray: &Ray<R>) -> R {
        self.0.border(ray)
    }
    fn extent(&self) -> f32 {
        self.0.extent()
    }
}

impl FromNode for Rectangle {
    const PLUGINS: &'static [&'static str] = &["rectangle"];

    fn from_node(node: &Node, _registry: &mut Registry) -> Result<Self, SceneError> {
        let to_world = node.transform("to_world")?.unwrap_or_default();
        let flip = node.boolean_or("flip_normals", false)?;
        let corner = to_world.point([-1.0, -1.0, 0.0]);
        let patch = Patch::new(
            corner,
            to_world.vector([2.0, 0.0, 0.0]),
            to_world.vector([0.0, 2.0, 0.0]),
            flip ^ (to_world.determinant() < 0.0),
        );
        // The normal transforms by the inverse transpose: a mirrored transform turns e1 x e2 around.
        patch.map(Rectangle).ok_or_else(|| {
            node.invalid(
                "to_world",
                "a transform that leaves a finite, non-zero area",
            )
        })
    }
}
