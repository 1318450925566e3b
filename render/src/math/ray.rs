//! Rays.

use ad_core::{Real, Vec3};

/// A half line. Origins are already moved off their surface where they are made
/// ([`crate::shape::SurfaceInteraction::spawn_ray`]), so a ray starts at distance zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray<R> {
    /// Origin, world space.
    pub o: Vec3<R>,
    /// Unit direction, world space.
    pub d: Vec3<R>,
}

impl<R: Real> Ray<R> {
    /// From origin and unit direction.
    #[inline]
    pub fn new(o: Vec3<R>, d: Vec3<R>) -> Self {
        Self { o, d }
    }

    /// The point at distance `t`.
    #[inline]
    pub fn at(&self, t: R) -> Vec3<R> {
        self.o + self.d * t
    }

    /// A constant ray: zero tangents.
    #[inline]
    pub fn lift(r: Ray<R::Primal>) -> Self {
        Self {
            o: Vec3::lift(r.o),
            d: Vec3::lift(r.d),
        }
    }

    /// The ray without its tangents.
    #[inline]
    pub fn primal(self) -> Ray<R::Primal> {
        Ray {
            o: self.o.primal(),
            d: self.d.primal(),
        }
    }
}
