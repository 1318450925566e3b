//! Where edges are seen from.

use ad_core::Vec3;

use crate::math::Frame;

/// Where edges are seen from.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Eye {
    /// A point.
    Point {
        at: Vec3<f64>,
        /// A point next to it, the middle of a lens: outlines of spheres are numbered as from there, so that their numbers
        /// mean nearly the same from all of the lens.
        about: Vec3<f64>,
    },
    /// A plane, by parallel rays.
    Parallel {
        /// Unit vector.
        direction: Vec3<f64>,
        /// A point of the plane.
        origin: Vec3<f64>,
        /// The scalar product with what leads from there to a point is the length of the ray to that.
        depth: Vec3<f64>,
    },
}

impl Eye {
    #[inline(always)]
    pub fn point(at: Vec3<f64>) -> Self {
        Self::Point { at, about: at }
    }

    /// From the eye to a point: the length means nothing where rays are parallel.
    #[inline(always)]
    pub fn to(&self, p: Vec3<f64>) -> Vec3<f64> {
        match *self {
            Self::Point { at, .. } => p - at,
            Self::Parallel { direction, .. } => direction,
        }
    }

    /// The change of [`Eye::to`] with that of the point.
    #[inline(always)]
    pub fn change(&self, by: Vec3<f64>) -> Vec3<f64> {
        match self {
            Self::Point { .. } => by,
            Self::Parallel { .. } => Vec3::zero(),
        }
    }

    /// Unit direction to a point, and how far that is.
    #[inline(always)]
    pub fn sight(&self, p: Vec3<f64>) -> (Vec3<f64>, f64) {
        match *self {
            Self::Point { at, .. } => {
                let to = p - at;
                let distance = to.length();
                (to * distance.recip(), distance)
            }
            Self::Parallel {
                direction,
                origin,
                depth,
            } => (direction, depth.dot(p - origin)),
        }
    }

    /// Where the ray starts that meets a point.
    pub fn origin(&self, p: Vec3<f64>) -> Vec3<f64> {
        match *self {
            Self::Point { at, .. } => at,
            Self::Parallel { direction, .. } => p - direction * self.sight(p).1,
        }
    }

    /// The sine of half the angle that a ball of this radius covers at this distance.
    #[inline(always)]
    pub fn sine(&self, radius: f64, distance: f64) -> f64 {
        match self {
            Self::Point { .. } => radius / distance,
            Self::Parallel { .. } => 0.0,
        }
    }

    /// A frame around the direction `axis` from a point to the eye.
    pub fn frame(&self, axis: Vec3<f64>, from: Vec3<f64>) -> Frame<f64> {
        match *self {
            Self::Point { at, about } if at != about => {
                let near = Frame::from_normal((about - from).normalize());
                Frame::from_normal_and_tangent(axis, near.s)
            }
            _ => Frame::from_normal(axis),
        }
    }
}
