//! Cameras: the perspective pinhole, and what differs from it.
//!
//! ```
//! let room = render::scene::room(64, 32)?;
//! let ray = room.camera.ray(40.0f64, 10.0); // from the top left, in pixels
//! let point = ray.at(2.5);
//!
//! // Particles ask the other way round: where is a point seen?
//! let pinhole = room.camera.pinhole::<f64>(&room.film);
//! let ([x, y], _pixels_per_steradian) = pinhole.project(point - pinhole.origin).expect("seen");
//! assert!((x - 40.0).abs() < 1e-9 && (y - 10.0).abs() < 1e-9);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod differential;
mod lens;
mod viewer;

use std::f64::consts::PI;

use ad_core::{Const, Float, Real, Vec3};

use crate::error::SceneError;
use crate::film::Film;
use crate::math::{Ray, RayAdjoint, Transform, both, each};
use crate::motion::Placement;
use crate::params::{GradSink, ParamRef, Params, Theta};
pub use differential::PerPixel;
use lens::{Lens, bad};
pub(crate) use lens::{Pupil, ThinLens};
pub(crate) use viewer::{SightLine, Viewer, inverse};

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

/// What a camera's ray belongs to, beside its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraSample<P> {
    /// The point of the image: x in [0, width], y in [0, height], from the top left.
    pub film: [P; 2],
    /// The place on the lens in the unit square, which only a lens looks at.
    pub lens: [P; 2],
}

/// A number of a camera's optics that may be a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Optic {
    /// Full angle of view in degrees.
    Fov,
    /// Radius of a thin lens.
    Aperture,
    /// Distance of what it sees sharply.
    Focus,
}

impl Optic {
    /// Its name in scene files.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Fov => "fov",
            Self::Aperture => "aperture_radius",
            Self::Focus => "focus_distance",
        }
    }
}

/// A camera with Mitsuba's conventions: it looks along its local +z, +x of the world is on
/// the right when it looks along -z with y up, and row 0 of the image is the top. A pinhole, unless it is given a lens
/// ([`Camera::with_lens`]) or parallel rays ([`Camera::orthographic`]).
///
/// # Parameters
/// None, unless the scene is told that the camera moves ([`crate::Scene::make_movable`]): a translation, a rotation about
/// its origin, the angle of view, and radius and distance of focus of a lens. A camera inside of a shape sees its inside.
#[derive(Clone, Debug)]
pub struct Camera {
    /// What it was made of.
    rest: Rest,
    placement: Placement,
    /// By [`Optic`].
    optics: [Option<ParamRef>; 3],
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
            optics: [None; 3],
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
        let (rows, volume) = inverse([self.dx, self.dy, self.corner].map(Vec3::from));
        self.inverse = rows.map(|v| v.to_array());
        self.inverse_determinant = volume.recip();
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

    /// Where it was made.
    pub(crate) fn loaded(&self) -> Transform {
        self.rest.to_world
    }

    /// Where it is placed, to be moved.
    pub(crate) fn placement(&mut self) -> &mut Placement {
        &mut self.placement
    }

    /// What of its optics this parameter is.
    pub(crate) fn optic_of(&self, p: ParamRef) -> Option<Optic> {
        [Optic::Fov, Optic::Aperture, Optic::Focus]
            .into_iter()
            .find(|&optic| self.optic(optic) == Some(p))
    }

    #[inline(always)]
    fn optic(&self, optic: Optic) -> Option<ParamRef> {
        self.optics[optic as usize]
    }

    /// Its value, if it has it.
    pub(crate) fn value_of(&self, optic: Optic) -> Option<f64> {
        match (optic, &self.lens) {
            (Optic::Fov, Some(Lens::Parallel { .. })) => None,
            (Optic::Fov, _) => Some(self.rest.fov),
            (Optic::Aperture, _) => self.thin_lens().map(|lens| lens.radius),
            (Optic::Focus, _) => self.thin_lens().map(|lens| lens.focus),
        }
    }

    /// Says that this parameter is that.
    pub(crate) fn set_optic(&mut self, optic: Optic, p: ParamRef) {
        self.optics[optic as usize] = Some(p);
    }

    /// Whether a parameter moves it.
    pub(crate) fn moves(&self) -> bool {
        self.depends_on(|_| true)
    }

    /// Whether it depends on a parameter for which `changed` holds.
    pub(crate) fn depends_on(&self, changed: impl Fn(ParamRef) -> bool) -> bool {
        let optics = self.optics.iter().copied().flatten();
        self.placement.params().chain(optics).any(changed)
    }

    /// The same at these parameters.
    ///
    /// # Errors
    /// As [`Camera::new`] and [`Camera::with_lens`].
    pub(crate) fn at(&self, params: &Params) -> Result<Self, SceneError> {
        let Rest {
            to_world,
            fov,
            axis,
            shift,
        } = self.rest;
        let now = |optic: Optic, rest: f64| {
            let p = self.optic(optic);
            p.map_or(rest, |p| f64::from(params.values()[p.offset as usize]))
        };
        let to_world = to_world.then(&self.placement.transform(params));
        let placed = Self::new(to_world, now(Optic::Fov, fov), axis, self.resolution)?;
        let mut placed = placed.with_principal_point(shift);
        match &self.lens {
            None => {}
            Some(Lens::Thin(lens)) => {
                let radius = now(Optic::Aperture, lens.radius);
                placed = placed.with_lens(&to_world, radius, now(Optic::Focus, lens.focus))?;
            }
            Some(Lens::Parallel { .. }) => placed = placed.with_parallel_rays(),
        }
        Ok(Self {
            rest: self.rest,
            placement: self.placement,
            optics: self.optics,
            ..placed
        })
    }

    /// The ray through a point of the image and a place of the lens that stay: [`Camera::ray_of`].
    ///
    /// # Derivatives
    /// In `theta`.
    pub fn ray_moving<R: Real>(&self, theta: &Theta<R>, at: &CameraSample<R::Primal>) -> Ray<R> {
        let lift = |v: [f64; 3]| Vec3::<R>::lift(each(v, R::Primal::of).into());
        let moving = |optic: Optic| self.optic(optic).filter(|&p| theta.moves(p));
        let [x, y] = at.film;
        let mut v = Vec3::<R>::lift(self.direction(x, y));
        if let Some(p) = moving(Optic::Fov) {
            let widens = (theta.get(p, 0) * R::c(PI / 360.0)).tan();
            let widens = (widens - Const(widens.primal())) * Const(widens.primal().recip());
            v += (v - lift(self.forward)) * widens;
        }
        let (mut o, mut d) = match &self.lens {
            None => (lift(self.origin), v),
            Some(Lens::Thin(lens)) => {
                let tangent = |optic: Optic| {
                    let x = moving(optic).map(|p| theta.get(p, 0));
                    x.map_or(R::zero(), |x| x - Const(x.primal()))
                };
                let grows = tangent(Optic::Aperture) * R::c(lens.radius.recip());
                let off = Vec3::<R>::lift(lens.off(at.lens)) * (grows + R::one());
                let focus = tangent(Optic::Focus) + R::c(lens.focus);
                let to = v * (focus / v.dot(lift(lens.forward))) - off;
                (lift(self.origin) + off, to)
            }
            Some(Lens::Parallel { direction }) => {
                let off = v - lift(self.forward);
                (lift(self.origin) + off, lift(*direction))
            }
        };
        if let Some(drift) = self.placement.drift(theta) {
            o = drift.point(o);
            d = drift.direction(d);
        }
        Ray::new(o, d.normalize())
    }

    /// Adds the adjoints of its parameters, given those of the ray through a point of the image and a place of the lens:
    /// the transpose of [`Camera::ray_moving`].
    pub fn scatter_ray<P: Float>(
        &self,
        theta: &Theta<P>,
        at: &CameraSample<P>,
        adjoint: &RayAdjoint<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let vector = |v: [f64; 3]| Vec3::from(each(v, P::of));
        let [x, y] = at.film;
        let v = self.direction(x, y);
        let (o, to) = match &self.lens {
            None => (vector(self.origin), v),
            Some(Lens::Thin(lens)) => self.through(lens, x, y, at.lens),
            Some(Lens::Parallel { direction }) => (
                vector(self.origin) + (v - vector(self.forward)),
                vector(*direction),
            ),
        };
        let n = to.normalize();
        let d_to = (adjoint.d - n * n.dot(adjoint.d)) * to.length().recip();
        // The adjoint of the pinhole's direction.
        let mut d_v = d_to;
        if let Some(lens) = self.thin_lens() {
            let forward = vector(lens.forward);
            let per_depth = v.dot(forward).recip();
            let along = d_to.dot(v) * per_depth;
            d_v = (d_to - forward * along) * (P::of(lens.focus) * per_depth);
            let optics = both([Optic::Aperture, Optic::Focus], |optic| self.optic(optic));
            let [aperture, focus] = optics.map(|p| p.filter(|&p| grad.active(p)));
            if let Some(p) = aperture {
                let off = lens.off(at.lens);
                grad.add(p, 0, off.dot(adjoint.o - d_to) * P::of(lens.radius.recip()));
            }
            if let Some(p) = focus {
                grad.add(p, 0, along);
            }
        }
        if let Some(p) = self.optic(Optic::Fov)
            && grad.active(p)
        {
            let angle = theta.get(p, 0) * P::of(PI / 180.0);
            let widens = P::of(PI / 180.0) / angle.sin();
            grad.add(p, 0, (v - vector(self.forward)).dot(d_v) * widens);
        }
        if self.placement.params().any(|p| grad.active(p)) {
            let mut wrench = self.placement.wrench(theta);
            wrench.point(o, adjoint.o);
            wrench.direction(to, d_to);
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
        if let Some(Lens::Parallel { direction }) = &self.lens {
            return self.parallel(x, y, direction);
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

    /// Where on the image a unit direction is seen through a place of the lens, on the film or not, and how that changes
    /// with it. `None` behind the camera. Not for parallel rays, which have one direction.
    pub(crate) fn seen(&self, d: Vec3<f64>, lens: [f64; 2]) -> Option<FilmPoint> {
        let [x, y, depth] = self.rows_through(lens);
        let z = depth.dot(d);
        if z <= 0.0 {
            return None;
        }
        let at = [x, y].map(|row| row.dot(d) / z);
        Some(FilmPoint {
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
pub(crate) struct FilmPoint {
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
