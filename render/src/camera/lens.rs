//! Cameras that are no pinholes: with a thin lens, or with parallel rays.

use ad_core::{Float, Vec3};

use super::{Camera, CameraSample, FovAxis};
use crate::error::SceneError;
use crate::math::{Ray, Transform, both, each, warp};

/// Where rays of a camera start that all leave its origin otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Lens {
    /// On a disk around the origin.
    Thin(ThinLens),
    /// On a plane through the origin; all are parallel to this unit vector.
    Parallel { direction: [f64; 3] },
}

/// A disk around the origin, given by two half axes. Rays meet the pinhole's ray at a depth, the distance of the plane
/// that is in focus: the `forward` component of a direction to there, of any length, is `focus`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ThinLens {
    pub(super) axes: [[f64; 3]; 2],
    pub(super) forward: [f64; 3],
    pub(super) radius: f64,
    pub(super) focus: f64,
}

impl ThinLens {
    /// From its middle to a place of it.
    #[inline(always)]
    pub fn off<P: Float>(&self, u: [P; 2]) -> Vec3<P> {
        let [right, up] = both(self.axes, |a| Vec3::from(each(a, P::of)));
        let disk = warp::square_to_disk(u);
        right * disk.x + up * disk.y
    }

    /// How many times as far as the plane in focus something is, seen by pinholes at all of its places: what a pinhole in
    /// its middle sees at `v` is seen from the place that is `off` from there at `v` plus this less one times `off`.
    pub fn depth(&self, v: Vec3<f64>) -> f64 {
        v.dot(Vec3::from(self.forward)) / self.focus
    }

    /// The corners of a square around it, from its middle.
    pub fn corners(&self) -> [Vec3<f64>; 4] {
        let [right, up] = self.axes.map(Vec3::from);
        [right + up, right - up, -right - up, up - right]
    }

    /// Its radius, in units of the scene.
    pub fn radius(&self) -> f64 {
        self.radius
    }
}

/// A surface that rays of a camera begin on, world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Pupil {
    /// Corners in order.
    Rectangle([Vec3<f64>; 4]),
    /// Middle and half axes.
    Disk([Vec3<f64>; 3]),
}

/// What else is known of a camera that is none.
pub(super) fn bad(key: &str, expected: &str, found: impl ToString) -> SceneError {
    SceneError::Parameter {
        key: key.into(),
        expected: expected.into(),
        found: found.to_string(),
    }
}

impl Camera {
    /// The same camera behind a thin lens of this radius, which is focused at this distance along the viewing direction.
    ///
    /// # Errors
    /// A radius or a distance that is not positive, or a transform that scales.
    pub fn with_lens(
        mut self,
        to_world: &Transform,
        radius: f64,
        focus: f64,
    ) -> Result<Self, SceneError> {
        if !(radius > 0.0 && radius.is_finite()) {
            return Err(bad("aperture_radius", "a positive number", radius));
        }
        if !(focus > 0.0 && focus.is_finite()) {
            return Err(bad("focus_distance", "a positive number", focus));
        }
        let axis = |v: [f64; 3]| Vec3::from(to_world.vector(v));
        let [right, up, forward] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(axis);
        let rigid = [right, up, forward]
            .iter()
            .all(|a| (a.length() - 1.0).abs() < 1e-3)
            && [right.dot(up), up.dot(forward), forward.dot(right)]
                .iter()
                .all(|x| x.abs() < 1e-3);
        if !rigid {
            let expected = "a transform that turns and moves, but does not scale";
            return Err(bad(
                "to_world",
                expected,
                format!("{:?}", to_world.matrix()),
            ));
        }
        self.lens = Some(Lens::Thin(ThinLens {
            axes: [right, up].map(|a| (a * radius).to_array()),
            forward: forward.normalize().to_array(),
            radius,
            focus,
        }));
        Ok(self)
    }

    /// A camera whose rays are parallel: it sees what lies before the rectangle from -1 to 1 along its x axis, as high as
    /// the form of the image says.
    ///
    /// # Errors
    /// A transform without inverse.
    pub fn orthographic(to_world: Transform, resolution: [u32; 2]) -> Result<Self, SceneError> {
        // At unit distance, half a width of one.
        Ok(Self::new(to_world, 90.0, FovAxis::X, resolution)?.with_parallel_rays())
    }

    pub(super) fn with_parallel_rays(mut self) -> Self {
        self.lens = Some(Lens::Parallel {
            direction: Vec3::from(self.forward).normalize().to_array(),
        });
        self
    }

    /// The direction of all rays, where they are parallel.
    pub fn parallel_direction(&self) -> Option<Vec3<f64>> {
        match &self.lens {
            Some(Lens::Parallel { direction }) => Some((*direction).into()),
            _ => None,
        }
    }

    /// The surface that its rays begin on, unless that is a point: the corners of a rectangle, in order, or the middle and two
    /// half axes of a disk.
    pub(crate) fn pupil(&self) -> Option<Pupil> {
        let [origin, forward, corner] = [self.origin, self.forward, self.corner].map(Vec3::from);
        match &self.lens {
            None => None,
            Some(Lens::Thin(lens)) => {
                let [right, up] = lens.axes.map(Vec3::from);
                Some(Pupil::Disk([origin, right, up]))
            }
            Some(Lens::Parallel { .. }) => {
                let [w, h] = self.resolution.map(f64::from);
                let (dx, dy) = (Vec3::from(self.dx) * w, Vec3::from(self.dy) * h);
                let first = origin + corner - forward;
                Some(Pupil::Rectangle([
                    first,
                    first + dx,
                    first + dx + dy,
                    first + dy,
                ]))
            }
        }
    }

    /// The same camera with its principal point beside the middle of the image, by these parts of its width and height,
    /// as in Mitsuba 3.
    pub fn with_principal_point(mut self, [x, y]: [f64; 2]) -> Self {
        self.rest.shift = [self.rest.shift[0] + x, self.rest.shift[1] + y];
        let [w, h] = self.resolution.map(f64::from);
        for i in 0..3 {
            self.corner[i] += self.dx[i] * w * x + self.dy[i] * h * y;
        }
        self.invert();
        self
    }

    /// Whether all rays leave one point, to which particles can be connected.
    #[inline]
    pub fn is_pinhole(&self) -> bool {
        self.lens.is_none()
    }

    /// Whether rays depend on where they pass the lens.
    #[inline(always)]
    pub fn has_lens(&self) -> bool {
        self.thin_lens().is_some()
    }

    /// That lens.
    #[inline(always)]
    pub(crate) fn thin_lens(&self) -> Option<&ThinLens> {
        match &self.lens {
            Some(Lens::Thin(lens)) => Some(lens),
            _ => None,
        }
    }

    /// [`Camera::ray`] through a place of the lens: `u` in the unit square, which only a lens looks at.
    #[inline]
    pub fn ray_through<P: Float>(&self, x: P, y: P, u: [P; 2]) -> Ray<P> {
        let Some(lens) = self.thin_lens() else {
            return self.ray(x, y);
        };
        let (o, to) = self.through(lens, x, y, u);
        Ray::new(o, to.normalize())
    }

    /// The ray of a sample.
    #[inline(always)]
    pub fn ray_of<P: Float>(&self, at: &CameraSample<P>) -> Ray<P> {
        let [x, y] = at.film;
        self.ray_through(x, y, at.lens)
    }

    /// Where that ray leaves the lens, and where to, not normalised: without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn through<P: Float>(
        &self,
        lens: &ThinLens,
        x: P,
        y: P,
        u: [P; 2],
    ) -> (Vec3<P>, Vec3<P>) {
        let off = lens.off(u);
        let d = self.direction(x, y);
        let depth = d.dot(Vec3::from(each(lens.forward, P::of)));
        let to = d * (P::of(lens.focus) / depth) - off;
        (Vec3::from(each(self.origin, P::of)) + off, to)
    }

    /// The ray of a camera whose rays are parallel.
    #[inline]
    pub(super) fn parallel<P: Float>(&self, x: P, y: P, direction: &[f64; 3]) -> Ray<P> {
        let vector = |v: [f64; 3]| Vec3::from(each(v, P::of));
        let off = self.direction(x, y) - vector(self.forward);
        Ray::new(vector(self.origin) + off, vector(*direction).normalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{Independent, Sampler};

    fn view() -> Transform {
        Transform::look_at([1.0, 2.0, 3.0], [0.3, -0.2, 0.1], [0.1, 1.0, 0.0]).unwrap()
    }

    /// Rays through the lens meet in the plane in focus, and nowhere else.
    #[test]
    fn a_lens_sees_one_plane_sharply() {
        let pinhole = Camera::new(view(), 50.0, FovAxis::X, [40, 30]).unwrap();
        assert!(pinhole.is_pinhole() && !pinhole.has_lens());
        let camera = pinhole.clone().with_lens(&view(), 0.3, 2.5).unwrap();
        assert!(!camera.is_pinhole() && camera.has_lens());
        let forward = Vec3::from(view().vector([0.0, 0.0, 1.0]));
        let origin = Vec3::from(view().point([0.0; 3]));
        let (mut mean, n) = (Vec3::<f64>::zero(), 4000);
        for i in 0..n {
            let mut s = Independent::new(3, 0, i);
            let (x, y) = (40.0 * s.next_1d::<f64>(), 30.0 * s.next_1d::<f64>());
            let middle = pinhole.ray(x, y);
            let ray = camera.ray_through(x, y, s.next_2d());
            let at = |r: &Ray<f64>, depth: f64| {
                r.o + r.d * ((depth - (r.o - origin).dot(forward)) / r.d.dot(forward))
            };
            assert!((ray.d.length() - 1.0).abs() < 1e-12);
            assert!((at(&ray, 2.5) - at(&middle, 2.5)).length() < 1e-12);
            let off = ray.o - origin;
            assert!(off.length() <= 0.3 + 1e-12 && off.dot(forward).abs() < 1e-12);
            mean += off * (1.0 / n as f64);
            assert_eq!(pinhole.ray_through(x, y, s.next_2d()).d, middle.d);
        }
        // Five standard deviations of the mean of a uniform disk.
        assert!(mean.length() < 5.0 * 0.15 * 2f64.sqrt() / (n as f64).sqrt());
        for (radius, focus, key) in [
            (0.0, 1.0, "aperture_radius"),
            (f64::NAN, 1.0, "aperture_radius"),
            (1.0, -1.0, "focus_distance"),
            (1.0, f64::INFINITY, "focus_distance"),
        ] {
            let error = pinhole.clone().with_lens(&view(), radius, focus);
            assert!(error.unwrap_err().to_string().contains(key));
        }
        let scaled = Transform::scale([2.0; 3]).then(&view());
        assert!(pinhole.with_lens(&scaled, 0.1, 1.0).is_err());
    }

    #[test]
    fn parallel_rays_start_on_a_plane() {
        let to_world = Transform::scale([1.5, 1.5, 1.0]).then(&view());
        let camera = Camera::orthographic(to_world, [40, 20]).unwrap();
        assert!(!camera.is_pinhole() && !camera.has_lens());
        for (x, y, local) in [
            (0.0, 0.0, [1.0, 0.5, 0.0]),
            (40.0, 20.0, [-1.0, -0.5, 0.0]),
            (20.0, 10.0, [0.0; 3]),
            (30.0, 10.0, [-0.5, 0.0, 0.0]),
        ] {
            let ray = camera.ray_through::<f64>(x, y, [0.9, 0.1]);
            let expected = Vec3::from(to_world.point(local));
            assert!((ray.o - expected).length() < 1e-12, "{x} {y}");
            let forward = Vec3::from(view().vector([0.0, 0.0, 1.0]));
            assert!((ray.d - forward).length() < 1e-12);
        }
    }

    #[test]
    fn principal_points_shift_the_image() {
        let camera = Camera::new(view(), 50.0, FovAxis::X, [40, 30]).unwrap();
        let shifted = camera.clone().with_principal_point([0.25, -0.1]);
        let (a, b) = (shifted.ray::<f64>(12.0, 20.0), camera.ray(22.0, 17.0));
        assert!((a.d - b.d).length() < 1e-12);
        let film = crate::film::Film::new(40, 30);
        let ([x, y], _) = shifted.pinhole(&film).project(a.d).unwrap();
        assert!((x - 12.0).abs() < 1e-11 && (y - 20.0).abs() < 1e-11);
    }
}
