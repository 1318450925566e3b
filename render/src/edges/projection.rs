//! The camera, through one place of its lens, as linear maps.

use ad_core::Vec3;

use super::Eye;
use crate::camera::{Camera, inverse};

/// Homogeneous coordinates of a point as the film sees it: `(x w, y w, w)`, and how far in front of the camera it is.
pub(super) type Projected = [f64; 4];

/// The camera through one place of its lens: its rays, and where it sees what.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Projection {
    pub eye: Eye,
    origin: Vec3<f64>,
    /// The ray through the point `(x, y)` of the film has the direction `x dx + y dy + corner`; parallel ones start there
    /// instead, in the direction `corner`.
    dx: Vec3<f64>,
    dy: Vec3<f64>,
    corner: Vec3<f64>,
    rows: [Vec3<f64>; 3],
    /// The magnitude of that of the matrix of the three vectors.
    determinant: f64,
}

pub(super) fn flat([x, y, w, _]: Projected) -> [f64; 2] {
    [x / w, y / w]
}

impl Projection {
    /// From the middle of the lens, if there is one.
    pub fn of(camera: &Camera) -> Self {
        let corner: Vec3<f64> = camera.direction(0.0, 0.0);
        let dx = camera.direction(1.0, 0.0) - corner;
        let dy = camera.direction(0.0, 1.0) - corner;
        let Some(direction) = camera.parallel_direction() else {
            let origin = camera.origin().into();
            return Self::new(Eye::point(origin), origin, [dx, dy, corner]);
        };
        let origin = camera.ray(0.0, 0.0).o;
        let columns = [dx, dy, direction];
        let ([.., depth], _) = inverse(columns);
        let eye = Eye::Parallel {
            direction,
            origin,
            depth,
        };
        Self::new(eye, origin, columns)
    }

    fn new(eye: Eye, origin: Vec3<f64>, [dx, dy, corner]: [Vec3<f64>; 3]) -> Self {
        let (rows, determinant) = inverse([dx, dy, corner]);
        Self {
            eye,
            origin,
            dx,
            dy,
            corner,
            rows,
            determinant,
        }
    }

    /// From a place of the lens, or beside it, that is `off` from its middle: rays through a point of the film meet that of
    /// the middle in the plane in focus.
    pub fn beside(&self, camera: &Camera, off: Vec3<f64>) -> Self {
        let Some(lens) = camera.thin_lens() else {
            return *self;
        };
        let at = self.origin + off;
        let eye = Eye::Point {
            at,
            about: self.origin,
        };
        let through = |v: Vec3<f64>| v - off * lens.depth(v);
        Self::new(eye, at, [self.dx, self.dy, self.corner].map(through))
    }

    /// A point as it is seen.
    pub fn seen(&self, p: Vec3<f64>) -> Projected {
        self.seen_from_origin(p - self.origin)
    }

    /// The point at `v` from the origin.
    pub fn seen_from_origin(&self, v: Vec3<f64>) -> Projected {
        let [x, y, depth] = self.rows.map(|row| row.dot(v));
        [x, y, if self.is_parallel() { 1.0 } else { depth }, depth]
    }

    fn is_parallel(&self) -> bool {
        matches!(self.eye, Eye::Parallel { .. })
    }

    pub fn origin(&self) -> Vec3<f64> {
        self.origin
    }

    /// How far a point is moved on the film as it moves along `by`.
    pub fn speed(&self, p: Projected, by: Vec3<f64>) -> f64 {
        let d = self.rows.map(|row| row.dot(by));
        let at = flat(p);
        let w = if self.is_parallel() { 0.0 } else { d[2] };
        let [x, y] = [0, 1].map(|k: usize| (d[k] - at[k] * w) / p[2]);
        x.hypot(y)
    }

    /// The area on the film, in pixels, of a unit of area across the ray at this point of it, times the square of the
    /// distance: of a unit of solid angle, if rays leave one point.
    pub fn pixels(&self, [x, y]: [f64; 2], distance: f64) -> f64 {
        let cube = if self.is_parallel() {
            distance * distance
        } else {
            let d = self.dx * x + self.dy * y + self.corner;
            d.length().powi(3)
        };
        cube / self.determinant
    }

    /// How far along both axes of the film, for each unit of depth, the corners of a square around a lens see what the
    /// middle sees, if that is at infinity.
    pub fn spread(&self, corners: &[Vec3<f64>]) -> [f64; 2] {
        [0, 1].map(|k: usize| {
            let offs = corners.iter().map(|off| self.rows[k].dot(*off).abs());
            offs.fold(0.0, f64::max)
        })
    }
}
