//! The camera as points of the scene see it, through one place of its lens.

use ad_core::{Float, Vec3};

use super::{Camera, Pinhole};
use crate::film::Film;
use crate::math::each;

/// Through a place of a lens, a camera is a pinhole beside its axis: directions through the film are those of its middle,
/// less where the place is over the distance of focus.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Viewer<P> {
    Pinhole(Pinhole<P>),
    /// Rays in one direction, from a plane.
    Parallel {
        origin: Vec3<P>,
        direction: Vec3<P>,
        /// Image coordinates and the distance from the plane, of points from the origin.
        rows: [Vec3<P>; 3],
        /// The area on the film, in pixels, of a unit of area across the rays.
        area: P,
        /// Least and largest x, then y, of what reaches the film.
        reach: [[P; 2]; 2],
    },
}

/// A point as a camera sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SightLine<P> {
    /// Where on the image.
    pub film: [P; 2],
    /// Unit direction from the point to the camera, and how far that is.
    pub towards: Vec3<P>,
    pub distance: P,
    /// The area on the film, in pixels, of a unit of area around the point, across the ray.
    pub area: P,
}

/// The inverse of a matrix of columns, by rows, and the magnitude of its determinant.
pub(crate) fn inverse([a, b, c]: [Vec3<f64>; 3]) -> ([Vec3<f64>; 3], f64) {
    let volume = a.dot(b.cross(c));
    let rows = [b.cross(c), c.cross(a), a.cross(b)];
    (rows.map(|v| v * volume.recip()), volume.abs())
}

impl Camera {
    /// The rows of the inverse of the map from the image to directions, through a place of the lens.
    pub(super) fn rows_through(&self, lens: [f64; 2]) -> [Vec3<f64>; 3] {
        let rows = self.inverse.map(Vec3::<f64>::from);
        let Some(thin) = self.thin_lens() else {
            return rows;
        };
        // What leaves there in a direction passes the plane in focus where the middle sees it.
        let (off, forward) = (thin.off(lens), Vec3::<f64>::from(thin.forward));
        rows.map(|row| row + forward * (row.dot(off) / thin.focus))
    }

    /// The camera through a place of its lens.
    pub(crate) fn viewer<P: Float>(&self, film: &Film, lens: [P; 2]) -> Viewer<P> {
        let vector = |v: Vec3<f64>| v.map(P::of);
        let Some(direction) = self.parallel_direction() else {
            let middle = self.pinhole(film);
            let Some(thin) = self.thin_lens() else {
                return Viewer::Pinhole(middle);
            };
            let lens = lens.map(P::to_f64);
            return Viewer::Pinhole(Pinhole {
                origin: vector(Vec3::from(self.origin) + thin.off(lens)),
                rows: self.rows_through(lens).map(vector),
                ..middle
            });
        };
        let [dx, dy, corner] = [self.dx, self.dy, self.corner].map(Vec3::<f64>::from);
        let (rows, volume) = inverse([dx, dy, direction]);
        let origin = Vec3::from(self.origin) + corner - Vec3::from(self.forward);
        Viewer::Parallel {
            origin: vector(origin),
            direction: vector(direction),
            rows: rows.map(vector),
            area: P::of(volume.recip()),
            reach: film.reach().map(|axis| axis.map(P::of)),
        }
    }
}

impl<P: Float> Viewer<P> {
    /// A point as it sees it; `None` behind it and beyond the film, whatever hides it.
    pub fn sees(&self, p: Vec3<P>) -> Option<SightLine<P>> {
        match self {
            Self::Pinhole(pinhole) => {
                let v = p - pinhole.origin;
                let (film, area) = pinhole.project_point(v)?;
                let distance = v.length();
                Some(SightLine {
                    film,
                    towards: -v * distance.recip(),
                    distance,
                    area,
                })
            }
            Self::Parallel {
                origin,
                direction,
                rows,
                area,
                reach,
            } => {
                let [x, y, distance] = each(*rows, |row| row.dot(p - *origin));
                let film = [x, y];
                let within = |k: usize| reach[k][0] <= film[k] && film[k] <= reach[k][1];
                let seen = distance > P::zero() && within(0) && within(1);
                seen.then_some(SightLine {
                    film,
                    towards: -*direction,
                    distance,
                    area: *area,
                })
            }
        }
    }
}
