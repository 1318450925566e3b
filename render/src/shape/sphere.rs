//! The sphere.

use std::f64::consts::{FRAC_1_PI, PI};

use ad_core::{Const, Dual, Float, Real, Vec2, Vec3};

use super::partials::{constant, variables};
use super::{
    DirectionSample, Partials, Shape, ShapeSample, SurfaceCoordinates, SurfaceInteraction,
    area_to_solid_angle, double, hit_is_exact, lift3, misplaced,
};
use crate::accel::{Hit, MAX_COORDINATE, MIN_THICKNESS, Primitive};
use crate::error::SceneError;
use crate::math::{Frame, Ray, Transform, angle, each, warp};
use crate::params::Theta;
use crate::plugin::{FromNode, Node, Registry};

/// Two axes count as equally long and orthogonal up to this relative error, that of a matrix
/// written with six digits.
pub(super) const SIMILARITY_TOLERANCE: f64 = 1e-4;

/// A sphere. `uv = (phi / 2 pi, theta / pi)` in the spherical coordinates around its local z axis;
/// normals point outward unless flipped, by a flag or by a transform that mirrors.
#[derive(Clone, Copy, Debug)]
pub struct Sphere {
    center: [f32; 3],
    radius: f32,
    /// Local x, y and z axis, world space.
    axes: [[f32; 3]; 3],
    flip: bool,
    /// See [`Shape::skip_uv`].
    skips_uv: bool,
}

impl Sphere {
    /// From centre and radius, with the axes of the world. `None` if the radius is not positive or
    /// something is not finite (or out of reach of [`crate::accel`]).
    pub fn new(center: [f64; 3], radius: f64, flip_normals: bool) -> Option<Self> {
        let axes = Transform::IDENTITY.linear;
        Self::with_axes(center, radius, axes, flip_normals)
    }

    /// The image of the unit sphere. `None` if the transform is not a similarity, or see
    /// [`Sphere::new`].
    pub fn transformed(to_world: &Transform, flip_normals: bool) -> Option<Self> {
        let columns =
            [0, 1, 2].map(|j| Vec3::from([0, 1, 2].map(|i: usize| to_world.linear[i][j])));
        let radius = columns[2].length();
        for (i, a) in columns.iter().enumerate() {
            for (j, b) in columns.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                let cosine = (*a * radius.recip()).dot(*b * radius.recip());
                // Written so that NaN fails.
                let error = (cosine - expected).abs();
                if error.is_nan() || error > SIMILARITY_TOLERANCE {
                    return None;
                }
            }
        }
        let axes = columns.map(|c| c.normalize().to_array());
        // As Mitsuba 3 has it: a reflection turns the sphere inside out.
        let flip = flip_normals ^ (to_world.determinant() < 0.0);
        Self::with_axes(to_world.translation, radius, axes, flip)
    }

    fn with_axes(center: [f64; 3], radius: f64, axes: [[f64; 3]; 3], flip: bool) -> Option<Self> {
        let center = center.map(|x| x as f32);
        let radius = radius as f32;
        let reachable = center.iter().all(|x| x.abs() <= MAX_COORDINATE);
        let valid = (MIN_THICKNESS..=MAX_COORDINATE).contains(&radius);
        (reachable && valid).then(|| Self {
            center,
            radius,
            axes: axes.map(|a| a.map(|x| x as f32)),
            flip,
            skips_uv: false,
        })
    }

    /// Whether normals point outward, and nothing needs texture coordinates: [`sample_cone`] is all of
    /// [`Shape::sample`] from outside.
    pub(crate) fn is_plain(&self) -> bool {
        !self.flip && self.skips_uv
    }

    /// Centre, world space.
    pub fn center(&self) -> [f32; 3] {
        self.center
    }

    /// Radius.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Its numbers, in those of a scalar.
    #[inline(always)]
    pub(crate) fn ball<R: Real>(&self) -> SphereNumbers<R> {
        SphereNumbers {
            center: lift3(self.center),
            radius: R::Primal::from_f32(self.radius),
            axes: each(self.axes, lift3),
            flip: self.flip,
        }
    }

    /// Whether texture coordinates are asked for.
    pub(crate) fn is_mapped(&self) -> bool {
        !self.skips_uv
    }

    #[inline(always)]
    fn side<R: Real>(&self, outward: Vec3<R>) -> Vec3<R> {
        self.ball().side(outward)
    }

    /// [`SphereNumbers::uv`], zero where nothing looks it up.
    #[inline(always)]
    fn uv<R: Real>(&self, outward: Vec3<R>) -> Vec2<R> {
        if self.skips_uv {
            Vec2::new(R::zero(), R::zero())
        } else {
            self.ball().uv(outward)
        }
    }

    /// The point with this outward unit normal, at the distance `t` of a ray.
    #[inline(always)]
    fn surface<R: Real>(&self, outward: Vec3<R>, t: R) -> SurfaceInteraction<R> {
        let ball = self.ball();
        let n = ball.side(outward);
        SurfaceInteraction {
            p: ball.point(outward),
            t,
            n_geo: n,
            frame: Frame::from_normal_and_tangent(n, ball.dp_du(outward)),
            uv: self.uv(outward),
        }
    }

    /// Its axes, at right angles in the digits of the scalar.
    fn own_axes<R: Real>(&self) -> [Vec3<R>; 3] {
        let [x, y, z] = each(self.axes, lift3::<R>);
        let x = x.normalize();
        let y = (y - x * x.dot(y)).normalize();
        let right = x.cross(y);
        let side = R::Primal::one().copysign(right.dot(z).primal());
        [x, y, right * Const(side)]
    }

    /// The outward normal with these surface coordinates.
    fn outward<R: Real>(&self, at: SurfaceCoordinates<R>) -> Vec3<R> {
        let [x, y, z] = self.own_axes::<R>();
        let n = from_octahedron(at.0);
        x * n.x + y * n.y + z * n.z
    }

    /// Surface coordinates of a point with this outward normal.
    fn place<P: Float>(&self, outward: Vec3<P>) -> SurfaceCoordinates<P> {
        let own = each(self.own_axes::<P>(), |a| a.dot(outward));
        SurfaceCoordinates(to_octahedron(own.into()))
    }

    /// Whether `from` lies inside or on the sphere.
    #[inline]
    fn contains<P: Float>(&self, from: Vec3<P>) -> bool {
        (lift3::<P>(self.center) - from).length()
            <= P::from_f32(self.radius) * P::of(1.0 + ON_SURFACE)
    }
}

/// What the surface of a sphere follows from, number by number.
pub(crate) struct SphereNumbers<R: Real> {
    pub center: Vec3<R>,
    pub radius: R::Primal,
    /// Local x, y and z axis, world space.
    pub axes: [Vec3<R>; 3],
    /// Whether normals point inward.
    pub flip: bool,
}

impl<R: Real> SphereNumbers<R> {
    /// The normal where this is the outward one, or the other way around.
    #[inline(always)]
    pub fn side(&self, n: Vec3<R>) -> Vec3<R> {
        Vec3::select(self.flip, -n, n)
    }

    /// The point with this outward unit normal.
    #[inline(always)]
    fn point(&self, outward: Vec3<R>) -> Vec3<R> {
        self.center + outward * Const(self.radius)
    }

    /// The direction of increasing u there; zero at the poles.
    #[inline(always)]
    fn dp_du(&self, outward: Vec3<R>) -> Vec3<R> {
        let [x, y, _] = self.axes;
        y * x.dot(outward) - x * y.dot(outward)
    }

    /// Texture coordinates there.
    #[inline(always)]
    pub fn uv(&self, outward: Vec3<R>) -> Vec2<R> {
        let [x, y, z] = each(self.axes, |a| a.dot(outward));
        Vec2::new(turn(y, x), angle::polar(x, y, z) * R::c(FRAC_1_PI))
    }
}

impl<P: Float> SphereNumbers<P> {
    /// What lies at the distance `t` of a ray that meets it there: [`Shape::interaction`] of hits that are exact, but for
    /// texture coordinates, which are zero. In loops over many, without a branch. Whether it is right; otherwise
    /// [`Shape::interaction`] has to be asked.
    #[inline(always)]
    pub fn interaction_in_line(&self, ray: &Ray<P>, t: P) -> (SurfaceInteraction<P>, bool) {
        let (outward, normal_is_right) = (ray.at(t) - self.center).unit();
        let n = self.side(outward);
        let (frame, frame_is_right) = Frame::in_line(n, self.dp_du(outward));
        let si = SurfaceInteraction {
            p: self.point(outward),
            t,
            n_geo: n,
            frame,
            uv: Vec2::zero(),
        };
        (si, normal_is_right & frame_is_right)
    }
}

/// `1 - cos` of half the angle that a sphere subtends at `from`, and the unit direction to its centre. `None` inside
/// and on the sphere, also where only rounding puts the point outside: a point on the surface sees all of the inside,
/// not the tangent cone.
#[inline(always)]
fn cone<R: Real>(center: [f32; 3], radius: f32, from: Vec3<R>) -> Option<(R, Vec3<R>)> {
    let to = lift3::<R>(center) - from;
    let r = R::Primal::from_f32(radius);
    // As large as radii are, its square is normal.
    let d = to.length_squared().sqrt();
    let inv_d = d.recip();
    let sine = inv_d * Const(r);
    let cosine = ((d - Const(r)) * inv_d * ((d + Const(r)) * inv_d)).sqrt();
    let outside = d.primal() > r * R::Primal::of(1.0 + ON_SURFACE);
    // The last condition keeps the density finite.
    let seen = outside & (sine.primal() * sine.primal() > R::Primal::MIN_POSITIVE);
    seen.then_some((sine * sine / (cosine + R::c(1.0)), to * inv_d))
}

/// A direction towards a sphere from outside, uniform in its cone, and outward normals; without texture coordinates.
/// `None` where there is no [`cone`]. A function of numbers alone, for loops over many spheres.
#[inline(always)]
pub(crate) fn sample_cone<P: Float>(
    center: [f32; 3],
    radius: f32,
    from: Vec3<P>,
    u: [P; 2],
) -> Option<DirectionSample<P>> {
    let (one_minus_cos_max, axis) = cone(center, radius, from)?;
    // A ray at angle theta to the axis meets the sphere at angle beta to the normal, with
    // sin(beta) = sin(theta) / sin(theta_max); seen from the centre that point lies beta - theta
    // off the axis. None of it cancels, however far or near the sphere.
    let h = one_minus_cos_max * u[0];
    let two = P::of(2.0);
    let ratio = u[0] * (two - h) / (two - one_minus_cos_max);
    let (sin_beta, cos_beta) = (ratio.sqrt(), (P::one() - ratio).max(P::zero()).sqrt());
    let (sin_theta, cos_theta) = ((h * (two - h)).sqrt(), P::one() - h);
    let cos_alpha = cos_beta * cos_theta + sin_beta * sin_theta;
    let sin_alpha = (sin_beta * cos_theta - cos_beta * sin_theta).max(P::zero());
    let (sin_phi, cos_phi) = warp::sin_cos_of_turns(u[1]);
    let local = Vec3::new(sin_alpha * cos_phi, sin_alpha * sin_phi, cos_alpha);
    let outward = Frame::from_normal(-axis).to_world(local);
    let v = lift3::<P>(center) + outward * P::from_f32(radius) - from;
    let distance = v.length_squared().sqrt();
    (distance > P::zero()).then_some(DirectionSample {
        d: v * distance.recip(),
        distance,
        n: outward,
        n_geo: outward,
        uv: Vec2::zero(),
        pdf: cone_pdf(one_minus_cos_max),
        prim: 0,
    })
}

/// The octahedral map of a unit vector [Cigolle et al. 2014].
fn to_octahedron<P: Float>(n: Vec3<P>) -> Vec2<P> {
    let scale = (n.x.abs() + n.y.abs() + n.z.abs()).recip();
    let (x, y) = (n.x * scale, n.y * scale);
    if n.z < P::zero() {
        Vec2::new(
            (P::one() - y.abs()).copysign(x),
            (P::one() - x.abs()).copysign(y),
        )
    } else {
        Vec2::new(x, y)
    }
}

/// The unit vector with this octahedral map.
fn from_octahedron<R: Real>(at: Vec2<R>) -> Vec3<R> {
    let (x, y) = (at.x.abs(), at.y.abs());
    let z = R::one() - x - y;
    let (x, y) = if z.primal() < R::Primal::zero() {
        (R::one() - y, R::one() - x)
    } else {
        (x, y)
    };
    let (x, y) = (x.copysign(at.x.primal()), y.copysign(at.y.primal()));
    Vec3::new(x, y, z).normalize()
}

/// Relative distance from the surface up to which a point counts as on it.
pub(super) const ON_SURFACE: f64 = 1e-4;

/// The angle of (x, y) in turns, in [0, 1].
#[inline(always)]
pub(crate) fn turn<R: Real>(y: R, x: R) -> R {
    let u = angle::atan2(y, x) * R::c(0.5 * FRAC_1_PI);
    R::select(u.primal() < R::Primal::zero(), u + R::c(1.0), u)
}

/// The `t` nearest to `near` with `|t d - to| = r`. On rays that miss by rounding, the closest
/// approach. Without a branch.
#[inline(always)]
pub(super) fn root_near<R: Real>(to: Vec3<R>, d: Vec3<R>, r: R, near: R::Primal) -> R {
    let dd = d.length_squared();
    let middle = to.dot(d) / dd;
    // Distance of the centre from the line; the usual b^2 - a c would lose a small far sphere.
    let off = to - d * middle;
    let half = ((r * r - off.length_squared()) / dd).max(R::zero()).sqrt();
    R::select(near < middle.primal(), middle - half, middle + half)
}

impl Shape for Sphere {
    fn primitives(&self) -> Vec<Primitive> {
        vec![Primitive::Sphere {
            center: self.center,
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
        let center = lift3::<R>(self.center);
        let radius = Const(R::Primal::from_f32(self.radius));
        let near = R::Primal::from_f32(hit.t);
        let t = if hit_is_exact::<R>() {
            R::lift(near)
        } else {
            root_near(center - ray.o, ray.d, R::lift(radius.0), near)
        };
        // Back onto the sphere, which rounding of t has left.
        self.surface((ray.at(t) - center).normalize(), t)
    }

    fn coordinates<P: Float>(
        &self,
        _prim: u32,
        si: &SurfaceInteraction<P>,
    ) -> SurfaceCoordinates<P> {
        self.place(self.side(si.n_geo))
    }

    fn locate<P: Float>(&self, _prim: u32, p: Vec3<P>) -> SurfaceCoordinates<P> {
        self.place((p - lift3(self.center)).normalize())
    }

    fn point_at<R: Real>(
        &self,
        _theta: &Theta<R>,
        _prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> SurfaceInteraction<R> {
        self.surface(self.outward(at), R::zero())
    }

    fn partials<R: Real>(
        &self,
        _theta: &Theta<R>,
        _prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> Option<Partials<R>> {
        let axes = each(self.axes, lift3::<R>);
        let outward = self.outward(at);
        let uv = self.ball().uv(outward);
        let [turns, halves] = variables(uv.x, uv.y);
        let (sin_phi, cos_phi) = (turns * Dual::<R, 2>::c(2.0 * PI)).sin_cos();
        let (sin_theta, cos_theta) = (halves * Dual::<R, 2>::c(PI)).sin_cos();
        let axes = each(axes, constant);
        let outward = (axes[0] * (sin_theta * cos_phi)
            + axes[1] * (sin_theta * sin_phi)
            + axes[2] * cos_theta)
            .normalize();
        let frame = Frame::from_normal_and_tangent(
            self.side(outward),
            axes[1] * cos_phi - axes[0] * sin_phi,
        );
        let radius = Const(R::Primal::from_f32(self.radius));
        Some(Partials::of(
            constant(lift3::<R>(self.center)) + outward * radius,
            &frame,
        ))
    }

    fn area_element<R: Real>(&self, _theta: &Theta<R>, _prim: u32) -> R {
        R::lift(R::Primal::from_f32(self.radius)).square()
    }

    fn centroid(&self) -> [f64; 3] {
        double(self.center)
    }

    fn placed(&self, by: &Transform) -> Result<Self, String> {
        let along = each(self.axes, |a| Vec3::from(by.vector(double(a))));
        let radius = f64::from(self.radius) * along[2].length();
        let axes = each(along, |a| a.normalize().to_array());
        let placed = Self::with_axes(by.point(double(self.center)), radius, axes, self.flip);
        placed
            .map(|s| Self {
                skips_uv: self.skips_uv,
                ..s
            })
            .ok_or_else(misplaced)
    }

    fn area(&self) -> f64 {
        4.0 * PI * f64::from(self.radius) * f64::from(self.radius)
    }

    fn sample_area<R: Real>(&self, _theta: &Theta<R>, u: [R::Primal; 2]) -> ShapeSample<R> {
        let outward = warp::square_to_sphere(u);
        let at = self.surface(Vec3::<R>::lift(outward), R::zero());
        ShapeSample {
            p: at.p,
            n: at.n_geo,
            uv: at.uv,
            pdf: R::Primal::of(1.0 / self.area()),
            prim: 0,
            coordinates: self.place(outward),
        }
    }

    /// Uniform in the cone that the sphere subtends, as Mitsuba 3 does; over the area from inside.
    #[inline]
    fn sample<P: Float>(&self, from: Vec3<P>, u: [P; 2]) -> Option<DirectionSample<P>> {
        let Some(s) = sample_cone(self.center, self.radius, from, u) else {
            if !self.contains(from) {
                return None;
            }
            let s = self.sample_area(&Theta::still(), u);
            return s.seen_from(from, s.n);
        };
        let n = self.side(s.n);
        Some(DirectionSample {
            n,
            n_geo: n,
            uv: self.uv(s.n),
            ..s
        })
    }

    #[inline]
    fn pdf<R: Real>(&self, from: Vec3<R>, si: &SurfaceInteraction<R>) -> R {
        match cone(self.center, self.radius, from) {
            Some((one_minus_cos_max, _)) => cone_pdf(one_minus_cos_max),
            None if self.contains(from.primal()) => {
                let pdf_area = R::of(1.0 / self.area());
                area_to_solid_angle(pdf_area, from, si.p, si.n_geo).unwrap_or(R::zero())
            }
            None => R::zero(),
        }
    }

    fn border<R: Real>(&self, _prim: u32, ray: &Ray<R>) -> R {
        let to = lift3::<R>(self.center) - ray.o;
        let along = to.dot(ray.d);
        let r = R::Primal::from_f32(self.radius);
        if along.primal() <= R::Primal::zero() || to.length().primal() <= r {
            return R::of(super::FAR);
        }
        let off = (to - ray.d * along).length();
        ((off - Const(r)) / to.length()).abs()
    }

    fn skip_uv(&mut self) {
        self.skips_uv = true;
    }

    fn extent(&self) -> f32 {
        self.center.iter().fold(0.0f32, |m, x| m.max(x.abs())) + self.radius
    }
}

#[inline]
fn cone_pdf<R: Real>(one_minus_cos_max: R) -> R {
    one_minus_cos_max.recip() * R::c(0.5 * FRAC_1_PI)
}

impl Sphere {
    /// What takes the unit sphere to the one that a node describes, without its `to_world`.
    pub(super) fn local(node: &Node) -> Result<Transform, SceneError> {
        let center = node.point("center")?.unwrap_or_default();
        let size = Transform::scale([node.float_or("radius", 1.0)?; 3]);
        Ok(size.then(&Transform::translate(center)))
    }
}

impl FromNode for Sphere {
    const PLUGINS: &'static [&'static str] = &["sphere"];

    fn from_node(node: &Node, _registry: &mut Registry) -> Result<Self, SceneError> {
        let center = node.point("center")?.unwrap_or_default();
        let radius = node.float_or("radius", 1.0)?;
        let to_world = node.transform("to_world")?.unwrap_or_default();
        let flip = node.boolean_or("flip_normals", false)?;
        if radius <= 0.0 {
            return Err(node.invalid("radius", "a positive number"));
        }
        Self::transformed(&Self::local(node)?.then(&to_world), flip).ok_or_else(|| {
            if Self::new([0.0; 3], radius, flip).is_none() {
                let expected = format!("a length from {MIN_THICKNESS:e} to {MAX_COORDINATE:e}");
                return node.invalid("radius", &expected);
            }
            if Self::new(center, radius, flip).is_none() {
                let expected = format!("coordinates of magnitude at most {MAX_COORDINATE:e}");
                return node.invalid("center", &expected);
            }
            node.invalid(
                "to_world",
                "a uniform scale that leaves a sphere of finite, non-zero size",
            )
        })
    }
}
