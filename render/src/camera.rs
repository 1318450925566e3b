//! Cameras: the perspective pinhole, and what differs from it.

mod differential;
mod lens;

use std::f64::consts::PI;

use ad_core::{Const, Float, Real, Vec3};

use crate::error::SceneError;
use crate::film::Film;
use crate::math::{Ray, RayAdjoint, Transform, each};
use crate::motion::Placement;
use crate::params::{GradSink, ParamRef, Params, Theta};
pub use differential::PerPixel;
pub(crate) use lens::ThinLens;
use lens::{Lens, bad};

/// What the angle of view refers to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FovAxis {
    /// Image width.
    #[default]
    X,
    /// Image height.
    Y,
    /// The diagonal.
    Diagonal,
    /// The shorter side.
    Smaller,
    /// The longer side.
    Larger,
}

impl FovAxis {
    /// Its name in scene files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Diagonal => "diagonal",
            Self::Smaller => "smaller",
            Self::Larger => "larger",
        }
    }

    /// Half the width of an image of `[width, height]` at unit distance, for the full angle `fov` in degrees. `None` for
    /// an angle outside (0, 180).
    pub fn half_width(self, fov: f64, [w, h]: [f64; 2]) -> Option<f64> {
        let tan = (fov.to_radians() / 2.0).tan();
        let half = match self {
            Self::X => tan,
            Self::Y => tan * w / h,
            Self::Diagonal => tan * w / w.hypot(h),
            Self::Smaller => tan * w / w.min(h),
            Self::Larger => tan * w / w.max(h),
        };
        (fov > 0.0 && fov < 180.0).then_some(half)
    }
}

/// What a camera was made of.
#[derive(Clone, Copy, Debug)]
struct Rest {
    to_world: Transform,
    /// Full angle in degrees.
    fov: f64,
    axis: FovAxis,
    /// Of the principal point, in parts of the image's width and height.
    shift: [f64; 2],
}

/// A pinhole camera with Mitsuba's conventions: it looks along its local +z, +x of the world is on
/// the right when it looks along -z with y up, and row 0 of the image is the top.
///
/// # Parameters
/// None, unless the scene is told that the camera moves ([`crate::Scene::make_movable`]): a translation, a rotation about
/// the pinhole and the angle of view. A camera inside of a shape sees its inside.
#[derive(Clone, Debug)]
pub struct Camera {
    /// What it was made of.
    rest: Rest,
    placement: Placement,
    /// Full angle in degrees.
    fov: Option<ParamRef>,
    origin: [f64; 3],
    /// Where it looks, as long as the camera's own z axis.
    forward: [f64; 3],
    /// The direction through the point `(x, y)` of the image is `x dx + y dy + corner`, not normalised.
    dx: [f64; 3],
    dy: [f64; 3],
    corner: [f64; 3],
    /// Inverse of the matrix with the columns dx, dy, corner, by rows, and one over the magnitude of the matrix's
    /// determinant.
    inverse: [[f64; 3]; 3],
    inverse_determinant: f64,
    resolution: [u32; 2],
    /// What makes it none.
    lens: Option<Lens>,
}

impl Camera {
    /// A camera for an image of `resolution = [width, height]` with the full angle `fov` in degrees.
    ///
    /// # Errors
    /// An angle outside (0, 180) or a transform without inverse.
    pub fn new(
        to_world: Transform,
        fov: f64,
        axis: FovAxis,
        resolution: [u32; 2],
    ) -> Result<Self, SceneError> {
        let (w, h) = (f64::from(resolution[0]), f64::from(resolution[1]));
        let half_x = (axis.half_width(fov, [w, h]))
            .ok_or_else(|| bad("fov", "an angle in (0, 180) degrees", fov))?;
        if to_world.inverse().is_none() {
            let found = format!("{:?}", to_world.matrix());
            return Err(bad("to_world", "an invertible transform", found));
        }
        let half_y = half_x * h / w;
        // The camera's local x axis points left in the image, y up.
        let dx = to_world.vector([-2.0 * half_x / w, 0.0, 0.0]);
        let dy = to_world.vector([0.0, -2.0 * half_y / h, 0.0]);
        let corner = to_world.vector([half_x, half_y, 1.0]);
        let origin = to_world.point([0.0; 3]);
        let mut camera = Self {
            rest: Rest {
                to_world,
                fov,
                axis,
                shift: [0.0; 2],
            },
            placement: Placement::about(origin),
            fov: None,
            origin,
            forward: to_world.vector([0.0, 0.0, 1.0]),
            dx,
            dy,
            corner,
            inverse: [[0.0; 3]; 3],
            inverse_determinant: 0.0,
            resolution,
            lens: None,
        };
        camera.invert();
        Ok(camera)
    }

    /// Finds the inverse of what leads to directions.
    fn invert(&mut self) {
        let [a, b, c] = [self.dx, self.dy, self.corner].map(Vec3::<f64>::from);
        let volume = a.dot(b.cross(c));
        self.inverse =
            [b.cross(c), c.cross(a), a.cross(b)].map(|v| (v * volume.recip()).to_array());
        self.inverse_determinant = volume.abs().recip();
    }

    /// Full angle of view in degrees, as it was made.
    pub fn fov(&self) -> (f64, FovAxis) {
        (self.rest.fov, self.rest.axis)
    }

    /// Half the angle of view along the shorter side of the image, radians.
    pub(crate) fn half_angle(&self) -> f64 {
        let length = |v: [f64; 3]| Vec3::from(v).length();
        let [w, h] = self.resolution.map(f64::from);
        let side = (length(self.dx) * w).min(length(self.dy) * h);
        (0.5 * side / length(self.forward)).atan()
    }

    /// How far it is from where it was made.
    pub(crate) fn displacement(&self, params: &Params) -> Transform {
        self.placement.transform(params)
    }

    /// What moves it.
    pub(crate) fn placement(&mut self) -> &mut Placement {
        &mut self.placement
    }

    /// Whether this parameter is its angle of view.
    pub(crate) fn zooms(&self, p: ParamRef) -> bool {
        self.fov == Some(p)
    }

    /// Says that this parameter is its angle of view, in degrees.
    pub(crate) fn set_fov(&mut self, p: ParamRef) {
        self.fov = Some(p);
    }

    /// Whether a parameter moves it.
    pub(crate) fn moves(&self) -> bool {
        self.depends_on(|_| true)
    }

    /// Whether it depends on a parameter for which `changed` holds.
    pub(crate) fn depends_on(&self, changed: impl Fn(ParamRef) -> bool) -> bool {
        self.placement.params().chain(self.fov).any(changed)
    }

    /// The same at these parameters.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub(crate) fn at(&self, params: &Params) -> Result<Self, SceneError> {
        let Rest {
            to_world,
            fov,
            axis,
            shift,
        } = self.rest;
        let now = (self.fov).map_or(fov, |p| f64::from(params.values()[p.offset as usize]));
        let placed = to_world.then(&self.placement.transform(params));
        let placed = Self::new(placed, now, axis, self.resolution)?.with_principal_point(shift);
        Ok(Self {
            rest: self.rest,
            placement: self.placement,
            fov: self.fov,
            lens: self.lens,
            ..placed
        })
    }

    /// The ray through a point of the image that stays: [`Camera::ray`].
    ///
    /// # Derivatives
    /// In `theta`.
    pub fn ray_moving<R: Real>(&self, theta: &Theta<R>, x: R::Primal, y: R::Primal) -> Ray<R> {
        let mut d = Vec3::<R>::lift(self.direction(x, y));
        let mut o = Vec3::<R>::lift(each(self.origin, R::Primal::of).into());
        if let Some(p) = self.fov
            && theta.moves(p)
        {
            let widens = (theta.get(p, 0) * R::c(PI / 360.0)).tan();
            let widens = (widens - Const(widens.primal())) * Const(widens.primal().recip());
            let forward = Vec3::<R>::lift(each(self.forward, R::Primal::of).into());
            d += (d - forward) * widens;
        }
        if let Some(drift) = self.placement.drift(theta) {
            o = drift.point(o);
            d = drift.direction(d);
        }
        Ray::new(o, d.normalize())
    }

    /// Adds the adjoints of its parameters, given those of the ray through a point of the image: the transpose of
    /// [`Camera::ray_moving`].
    pub fn scatter_ray<P: Float>(
        &self,
        theta: &Theta<P>,
        [x, y]: [P; 2],
        adjoint: &RayAdjoint<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let v = self.direction(x, y);
        let n = v.normalize();
        let d_v = (adjoint.d - n * n.dot(adjoint.d)) * v.length().recip();
        if let Some(p) = self.fov
            && grad.active(p)
        {
            let forward = Vec3::from(each(self.forward, P::of));
            let angle = theta.get(p, 0) * P::of(PI / 180.0);
            let widens = P::of(PI / 180.0) / angle.sin();
            grad.add(p, 0, (v - forward).dot(d_v) * widens);
        }
        if self.placement.params().any(|p| grad.active(p)) {
            let mut wrench = self.placement.wrench(theta);
            wrench.point(each(self.origin, P::of).into(), adjoint.o);
            wrench.direction(v, d_v);
            self.placement.scatter(theta, &wrench, grad);
        }
    }

    /// The camera and its film for particles.
    pub fn pinhole<P: Float>(&self, film: &Film) -> Pinhole<P> {
        Pinhole {
            origin: self.origin.map(P::of).into(),
            rows: self.inverse.map(|row| row.map(P::of).into()),
            inverse_determinant: P::of(self.inverse_determinant),
            reach: film.reach().map(|axis| axis.map(P::of)),
        }
    }

    /// The ray through a point of the image: `x` in [0, width], `y` in [0, height], from the top left; where there is a
    /// lens, through its middle.
    #[inline]
    pub fn ray<P: Float>(&self, x: P, y: P) -> Ray<P> {
        if let Some(Lens::Parallel { direction, forward }) = &self.lens {
            return self.parallel(x, y, direction, forward);
        }
        Ray::new(
            each(self.origin, P::of).into(),
            self.direction(x, y).normalize(),
        )
    }

    /// Its direction, not normalised, if it leaves the origin.
    #[inline(always)]
    pub(crate) fn direction<P: Float>(&self, x: P, y: P) -> Vec3<P> {
        let component =
            |i: usize| x * P::c(self.dx[i]) + y * P::c(self.dy[i]) + P::c(self.corner[i]);
        Vec3::new(component(0), component(1), component(2))
    }

    /// Where on the image a unit direction is seen, on the film or not, and how that changes with it. `None` behind the
    /// camera.
    pub(crate) fn seen(&self, d: Vec3<f64>) -> Option<Seen> {
        let [x, y, depth] = self.inverse.map(Vec3::<f64>::from);
        let z = depth.dot(d);
        if z <= 0.0 {
            return None;
        }
        let at = [x, y].map(|row| row.dot(d) / z);
        Some(Seen {
            at,
            slopes: [x - depth * at[0], y - depth * at[1]].map(|slope| slope * z.recip()),
            log_area: depth * (-3.0 / z),
        })
    }

    /// Width and height of the image that the camera was made for.
    pub fn resolution(&self) -> [u32; 2] {
        self.resolution
    }

    /// Position, world space.
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }
}

/// Where on the image a direction is seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// The point, as in [`Camera::ray`].
    pub at: [f64; 2],
    /// How its coordinates change with a unit direction, pixels per radian.
    pub slopes: [Vec3<f64>; 2],
    /// How the logarithm of the area does that a unit of solid angle covers there.
    pub log_area: Vec3<f64>,
}

/// A camera as particles meet it, in their scalar.
#[derive(Clone, Copy, Debug)]
pub struct Pinhole<P> {
    /// Position, world space.
    pub origin: Vec3<P>,
    rows: [Vec3<P>; 3],
    inverse_determinant: P,
    /// Least and largest x, then y, of what reaches the film.
    reach: [[P; 2]; 2],
}

impl<P: Float> Pinhole<P> {
    /// Where the camera sees what lies in the direction `v` (any length, from the pinhole): the point
    /// `(x, y)` of the image plane as in [`Camera::ray`], and the area that a unit of solid angle covers there,
    /// in pixels. `None` behind the camera, beyond the film, or if not finite.
    ///
    /// That area is the importance emitted per solid angle by a sensor with the density 1 per pixel.
    #[inline]
    pub fn project(&self, v: Vec3<P>) -> Option<([P; 2], P)> {
        let (at, area) = self.project_point(v)?;
        let area = area * v.length_squared();
        area.is_finite().then_some((at, area))
    }

    /// [`Pinhole::project`] of the point at `v` from the pinhole, with the area that a unit of area across `v`
    /// covers: the importance over the squared distance.
    #[inline(always)]
    pub fn project_point(&self, v: Vec3<P>) -> Option<([P; 2], P)> {
        let [x, y, depth] = each(self.rows, |row| row.dot(v));
        if depth <= P::zero() {
            return None;
        }
        let inverse_depth = depth.recip();
        let area = v.length() * (inverse_depth * inverse_depth) * inverse_depth;
        let area = area * self.inverse_determinant;
        let at = [x * inverse_depth, y * inverse_depth];
        let within = |k: usize| self.reach[k][0] <= at[k] && at[k] <= self.reach[k][1];
        (within(0) && within(1) && area.is_finite()).then_some((at, area))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::PixelFilter;

    #[test]
    fn projection_inverts_rays_and_knows_their_density() {
        let to_world = Transform::look_at([1.0, 2.0, 3.0], [0.3, -0.2, 0.1], [0.1, 1.0, 0.0]);
        let camera = Camera::new(to_world.unwrap(), 50.0, FovAxis::X, [40, 30]).unwrap();
        let mut film = Film::new(40, 30);
        film.filter = PixelFilter::Gaussian { stddev: 1.0 };
        let pinhole = camera.pinhole(&film);
        let at = |x: f64, y: f64| camera.ray(x, y).d;
        for [x, y] in [[3.0, 4.5], [20.0, 15.0], [39.9, 0.1], [-2.0, 33.0]] {
            let ([px, py], area) = pinhole.project(at(x, y) * 2.7).unwrap();
            assert!((px - x).abs() < 1e-11 && (py - y).abs() < 1e-11);
            // Solid angle of a small square, by differences.
            let h = 1e-4;
            let du = at(x + h, y) - at(x - h, y);
            let dv = at(x, y + h) - at(x, y - h);
            let solid_angle = du.cross(dv).length() / (4.0 * h * h);
            assert!((area * solid_angle - 1.0).abs() < 1e-6, "{x} {y}");
            assert!(pinhole.project(-at(x, y)).is_none());
        }
        assert!(pinhole.project(Vec3::<f64>::zero()).is_none());
        assert!(pinhole.project(at(-3.6, 20.0)).is_none());
    }
}
