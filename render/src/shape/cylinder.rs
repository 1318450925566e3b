//! The cylinder.

use std::f64::consts::PI;

use ad_core::{Const, Dual, Float, Real, Vec2, Vec3};

use super::partials::{constant, variables};
use super::sphere::{ON_SURFACE, SIMILARITY_TOLERANCE, root_near};
use super::{
    DirectionSample, Partials, Shape, ShapeSample, SurfaceCoordinates, SurfaceInteraction, double,
    hit_is_exact, lift3, misplaced, turn,
};
use crate::accel::{Hit, MAX_COORDINATE, MIN_THICKNESS, Primitive};
use crate::error::SceneError;
use crate::math::{Frame, Ray, Transform, each, warp};
use crate::params::Theta;
use crate::plugin::{FromNode, Node, Registry};

/// An open tube around the segment from `p0` to `p1`. `uv = (phi / 2 pi, z / length)`; normals
/// point away from the axis, or towards it if flipped.
#[derive(Clone, Copy, Debug)]
pub struct Cylinder {
    p0: [f32; 3],
    /// p1 - p0.
    axis: [f32; 3],
    radius: f32,
    /// Unit vectors across the axis, where u = 0 and u = 1/4.
    across: [[f32; 3]; 2],
    flip: bool,
    area: f64,
}

/// That of a tube.
fn area(axis: [f32; 3], radius: f32) -> f64 {
    2.0 * PI * f64::from(radius) * lift3::<f64>(axis).length()
}

impl Cylinder {
    /// From the ends of the axis and the radius. `None` if radius or length is zero, or something is
    /// not finite (or out of reach of [`crate::accel`]).
    pub fn new(p0: [f64; 3], p1: [f64; 3], radius: f64, flip_normals: bool) -> Option<Self> {
        Self::transformed(p0, p1, radius, &Transform::IDENTITY, flip_normals)
    }

    /// The image of a cylinder. `None` if the transform does not leave it a circular cylinder, or see
    /// [`Cylinder::new`].
    pub fn transformed(
        p0: [f64; 3],
        p1: [f64; 3],
        radius: f64,
        to_world: &Transform,
        flip: bool,
    ) -> Option<Self> {
        let local = Frame::from_normal((Vec3::from(p1) - Vec3::from(p0)).normalize());
        let image = |v: Vec3<f64>| Vec3::from(to_world.vector(v.to_array()));
        let (s, t) = (image(local.s * radius), image(local.t * radius));
        let axis = image(Vec3::from(p1) - Vec3::from(p0));
        let (radius, direction) = (s.length(), axis.normalize());
        let skew = [
            t.length() / radius - 1.0,
            s.dot(t) / (radius * radius),
            s.dot(direction) / radius,
            t.dot(direction) / radius,
        ];
        // Written so that NaN fails.
        if !skew.iter().all(|x| x.abs() <= SIMILARITY_TOLERANCE) {
            return None;
        }
        let single = |v: [f64; 3]| v.map(|x| x as f32);
        let x = (s - direction * s.dot(direction)).normalize();
        // Mirrored frames turn the other way round, as the local coordinates do.
        let y = direction.cross(x);
        let y = if y.dot(t) < 0.0 { -y } else { y };
        let (axis, radius) = (single(axis.to_array()), radius as f32);
        let cylinder = Self {
            p0: single(to_world.point(p0)),
            axis,
            radius,
            across: [single(x.to_array()), single(y.to_array())],
            flip,
            area: area(axis, radius),
        };
        cylinder.is_usable().then_some(cylinder)
    }

    /// Whether rays can meet it.
    fn is_usable(&self) -> bool {
        let coordinates = || self.p0.iter().chain(&self.axis);
        let reachable = coordinates().all(|x| x.abs() <= MAX_COORDINATE);
        let allowed = f64::from(MIN_THICKNESS)..=f64::from(MAX_COORDINATE);
        let length = lift3::<f64>(self.axis).length();
        reachable && allowed.contains(&f64::from(self.radius)) && allowed.contains(&length)
    }

    #[inline(always)]
    fn side<R: Real>(&self, outward: Vec3<R>) -> Vec3<R> {
        Vec3::select(self.flip, -outward, outward)
    }

    /// [`Shape::sample_area`] without a branch.
    #[inline(always)]
    fn sample_surface_at<R: Real>(&self, u: [R::Primal; 2]) -> ShapeSample<R> {
        let (sin, cos) = warp::sin_cos_of_turns(u[0]);
        let x = lift3::<R::Primal>(self.across[0]);
        let y = lift3::<R::Primal>(self.across[1]);
        let outward = Vec3::<R>::lift(x * cos + y * sin);
        let along = lift3::<R>(self.axis) * Const(u[1]);
        ShapeSample {
            p: lift3::<R>(self.p0) + along + outward * Const(R::Primal::from_f32(self.radius)),
            n: self.side(outward),
            uv: Vec2::new(R::lift(u[0]), R::lift(u[1])),
            pdf: R::Primal::of(1.0 / self.area),
            prim: 0,
            coordinates: SurfaceCoordinates(Vec2::new(u[0], u[1])),
        }
    }

    /// [`Shape::sample`], and whether anything is seen: the inside may be hidden by the tube itself. Without branches, for
    /// loops over many.
    #[inline(always)]
    pub(crate) fn sample_in_line<P: Float>(
        &self,
        from: Vec3<P>,
        u: [P; 2],
    ) -> (DirectionSample<P>, bool) {
        let s = self.sample_surface_at::<P>(u);
        let (seen, is_seen) = s.seen_in_line(from, s.n);
        let axis = lift3::<P>(self.axis);
        // As long as axes are, their squares are normal.
        let direction = axis.unit().0;
        let p0 = lift3::<P>(self.p0);
        let flat = |v: Vec3<P>| v - direction * direction.dot(v);
        let (to, d, out) = (flat(p0 - from), flat(seen.d), flat(s.p - p0));
        let radius = P::from_f32(self.radius);
        let outside = to.length_squared().sqrt() > radius * P::of(1.0 + ON_SURFACE);
        let near = root_near(to, d, radius, P::zero());
        let height = direction.dot(from + seen.d * near - p0);
        let within = (height >= P::zero()) & (height <= axis.length_squared().sqrt());
        let hidden = outside & (out.dot(d) > P::zero()) & (near > P::zero()) & within;
        (seen, is_seen & !hidden)
    }

    /// Unit vectors where u = 0 and u = 1/4, at right angles to the axis and each other in the digits of the scalar.
    fn round<R: Real>(&self) -> [Vec3<R>; 2] {
        let direction = lift3::<R>(self.axis).normalize();
        let [x, y] = self.across.map(lift3::<R>);
        let x = (x - direction * direction.dot(x)).normalize();
        let z = direction.cross(x);
        [
            x,
            if z.dot(y).primal() < R::Primal::zero() {
                -z
            } else {
                z
            },
        ]
    }

    /// The point at a height over the foot of the axis, in an outward unit direction across it.
    #[inline(always)]
    fn surface<R: Real>(&self, outward: Vec3<R>, height: R, t: R) -> SurfaceInteraction<R> {
        let p0 = lift3::<R>(self.p0);
        let axis = lift3::<R::Primal>(self.axis);
        let length = axis.length();
        let direction = Vec3::<R>::lift(axis.normalize());
        let radius = Const(R::Primal::from_f32(self.radius));
        let (x, y) = (lift3::<R>(self.across[0]), lift3::<R>(self.across[1]));
        let (cos, sin) = (x.dot(outward), y.dot(outward));
        let n = self.side(outward);
        SurfaceInteraction {
            p: p0 + direction * height + outward * radius,
            t,
            n_geo: n,
            frame: Frame::from_normal_and_tangent(n, y * cos - x * sin),
            uv: Vec2::new(turn(sin, cos), height * Const(length.recip())),
        }
    }
}

impl Shape for Cylinder {
    fn primitives(&self) -> Vec<Primitive> {
        vec![Primitive::Cylinder {
            p0: self.p0,
            axis: self.axis,
            radius: self.radius,
        }]
    }

    #[inline]
    fn interaction<R: Real>(
        &self,
        _theta: &Theta<R>,
        _prim: u32,
        ray: &Ray<R>,
        hit: &Hit,
    ) -> SurfaceInteraction<R> {
        let p0 = lift3::<R>(self.p0);
        let axis = lift3::<R::Primal>(self.axis);
        let direction = Vec3::<R>::lift(axis.normalize());
        let radius = Const(R::Primal::from_f32(self.radius));
        let flat = |v: Vec3<R>| v - direction * direction.dot(v);
        let near = R::Primal::from_f32(hit.t);
        let t = if hit_is_exact::<R>() {
            R::lift(near)
        } else {
            root_near(flat(p0 - ray.o), flat(ray.d), R::lift(radius.0), near)
        };
        let from_p0 = ray.at(t) - p0;
        let height = direction.dot(from_p0);
        // Back onto the cylinder, which rounding of t has left.
        self.surface(flat(from_p0).normalize(), height, t)
    }

    fn coordinates<P: Float>(
        &self,
        _prim: u32,
        si: &SurfaceInteraction<P>,
    ) -> SurfaceCoordinates<P> {
        let [x, y] = self.round::<P>().map(|a| a.dot(self.side(si.n_geo)));
        SurfaceCoordinates(Vec2::new(turn(y, x), si.uv.y))
    }

    fn locate<P: Float>(&self, _prim: u32, p: Vec3<P>) -> SurfaceCoordinates<P> {
        let from_p0 = p - lift3(self.p0);
        let [x, y] = self.round::<P>().map(|a| a.dot(from_p0));
        let axis = lift3::<P>(self.axis);
        let height = axis.dot(from_p0) / axis.length_squared();
        SurfaceCoordinates(Vec2::new(turn(y, x), height))
    }

    fn point_at<R: Real>(
        &self,
        _theta: &Theta<R>,
        _prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> SurfaceInteraction<R> {
        let [x, y] = self.round::<R>();
        let (sin, cos) = (at.0.x * R::c(2.0 * PI)).sin_cos();
        let length = lift3::<R::Primal>(self.axis).length();
        self.surface(x * cos + y * sin, at.0.y * Const(length), R::zero())
    }

    fn partials<R: Real>(
        &self,
        _theta: &Theta<R>,
        _prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> Option<Partials<R>> {
        let [turns, height] = variables(at.0.x, at.0.y);
        let [x, y] = self.round::<R>().map(constant);
        let (sin, cos) = (turns * Dual::<R, 2>::c(2.0 * PI)).sin_cos();
        let outward = x * cos + y * sin;
        let [p0, axis] = [self.p0, self.axis].map(|v| constant(lift3::<R>(v)));
        let frame = Frame::from_normal_and_tangent(self.side(outward), y * cos - x * sin);
        let radius = Const(R::Primal::from_f32(self.radius));
        Some(Partials::of(p0 + axis * height + outward * radius, &frame))
    }

    fn area_element<R: Real>(&self, _theta: &Theta<R>, _prim: u32) -> R {
        let radius = Const(R::Primal::from_f32(self.radius));
        lift3::<R>(self.axis).length() * radius * R::c(2.0 * PI)
    }

    /// The sides, and the two rims where the line of the ray passes them.
    fn border<R: Real>(&self, _prim: u32, ray: &Ray<R>) -> R {
        let p0 = lift3::<R>(self.p0);
        let axis = lift3::<R>(self.axis);
        let length = axis.length();
        let direction = axis / length;
        let flat = |v: Vec3<R>| v - direction * direction.dot(v);
        let (to, d) = (flat(p0 - ray.o), flat(ray.d));
        let radius = R::lift(R::Primal::from_f32(self.radius));
        let middle = to.dot(d) / d.length_squared();
        let side = (to - d * middle).length() - radius;
        let mut nearest = super::flat_border(middle, [side]);
        for near in [R::Primal::zero(), R::Primal::MAX] {
            let t = root_near(to, d, radius, near);
            let height = direction.dot(ray.at(t) - p0);
            for end in [R::zero(), length] {
                nearest = nearest.min(super::flat_border(t, [height - end]));
            }
        }
        nearest
    }

    fn centroid(&self) -> [f64; 3] {
        (lift3::<f64>(self.p0) + lift3::<f64>(self.axis) * 0.5).to_array()
    }

    fn placed(&self, by: &Transform) -> Result<Self, String> {
        let single = |v: [f64; 3]| each(v, |x| x as f32);
        let across = self.across.map(|a| Vec3::from(by.vector(double(a))));
        let scale = across[0].length();
        let axis = single(by.vector(double(self.axis)));
        let radius = (f64::from(self.radius) * scale) as f32;
        let placed = Self {
            p0: single(by.point(double(self.p0))),
            axis,
            radius,
            across: across.map(|a| single(a.normalize().to_array())),
            flip: self.flip,
            area: area(axis, radius),
        };
        placed.is_usable().then_some(placed).ok_or_else(misplaced)
    }

    fn area(&self) -> f64 {
        self.area
    }

    #[inline]
    fn sample_area<R: Real>(&self, _theta: &Theta<R>, u: [R::Primal; 2]) -> ShapeSample<R> {
        self.sample_surface_at(u)
    }

    fn sample<P: Float>(&self, from: Vec3<P>, u: [P; 2]) -> Option<DirectionSample<P>> {
        let (seen, is_seen) = self.sample_in_line(from, u);
        is_seen.then_some(seen)
    }

    fn extent(&self) -> f32 {
        let along = (0..3).fold(0.0f32, |m, i| {
            m.max(self.p0[i].abs())
                .max((self.p0[i] + self.axis[i]).abs())
        });
        along + self.radius
    }
}

impl Cylinder {
    /// What takes the cylinder of radius one along the z axis, from zero to one, to the one that a node describes, without its
    /// `to_world`.
    pub(super) fn local(node: &Node) -> Result<Transform, SceneError> {
        let p0 = node.point("p0")?.unwrap_or([0.0; 3]);
        let p1 = node.point("p1")?.unwrap_or([0.0, 0.0, 1.0]);
        let radius = node.float_or("radius", 1.0)?;
        let axis = Vec3::from(p1) - Vec3::from(p0);
        let frame = Frame::from_normal(axis.normalize());
        let columns = [frame.s * radius, frame.t * radius, axis];
        Ok(Transform {
            linear: [0, 1, 2].map(|i: usize| columns.map(|c| c[i])),
            translation: p0,
        })
    }
}

impl FromNode for Cylinder {
    const PLUGINS: &'static [&'static str] = &["cylinder"];

    fn from_node(node: &Node, _registry: &mut Registry) -> Result<Self, SceneError> {
        let p0 = node.point("p0")?.unwrap_or([0.0; 3]);
        let p1 = node.point("p1")?.unwrap_or([0.0, 0.0, 1.0]);
        let radius = node.float_or("radius", 1.0)?;
        let to_world = node.transform("to_world")?.unwrap_or_default();
        let flip = node.boolean_or("flip_normals", false)?;
        if radius <= 0.0 {
            return Err(node.invalid("radius", "a positive number"));
        }
        if p0 == p1 {
            return Err(node.invalid("p1", "a point other than p0"));
        }
        Self::transformed(p0, p1, radius, &to_world, flip).ok_or_else(|| {
            let thin = format!("a length from {MIN_THICKNESS:e} to {MAX_COORDINATE:e}");
            let own = |p0, p1, radius| Self::new(p0, p1, radius, flip);
            if own([0.0; 3], [0.0, 0.0, 1.0], radius).is_none() {
                return node.invalid("radius", &thin);
            }
            if own(p0, p1, radius).is_none() {
                let expected = format!("points in reach, {thin} apart");
                return node.invalid("p1", &expected);
            }
            node.invalid(
                "to_world",
                "a transform that leaves a circular cylinder of finite, non-zero size",
            )
        })
    }
}
