//! Rays.

use ad_core::{Real, Vec3};

/// No surface: see [`Ray::from`].
pub const NOWHERE: u32 = u32::MAX;

/// A half line.
///
/// One that leaves a flat surface cannot meet it again, and is not tested against it. Where that is not so, and for
/// rounding, origins are moved off their surface where rays are made
/// ([`crate::shape::SurfaceInteraction::spawn_ray`]): a ray starts at distance zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray<R> {
    /// Origin, world space.
    pub o: Vec3<R>,
    /// Unit direction, world space.
    pub d: Vec3<R>,
    /// The flat surface that it leaves, as [`crate::accel::surfaces`] numbers them; or [`NOWHERE`].
    pub from: u32,
}

/// The adjoints of a ray.
#[derive(Clone, Copy, Debug)]
pub struct RayAdjoint<P> {
    /// Of its origin.
    pub o: Vec3<P>,
    /// Of its direction.
    pub d: Vec3<P>,
}

/// A ray as far as the point that it is to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment<P> {
    /// Origin and direction.
    pub ray: Ray<P>,
    /// How far it must be free.
    pub length: P,
    /// The surface that the point lies on, which does not hide it; or [`NOWHERE`].
    pub to: u32,
}

impl<R: Real> Ray<R> {
    /// From origin and unit direction; it leaves no surface.
    #[inline]
    pub fn new(o: Vec3<R>, d: Vec3<R>) -> Self {
        Self {
            o,
            d,
            from: NOWHERE,
        }
    }

    /// The same, leaving a surface.
    #[inline]
    pub fn leaving(self, from: u32) -> Self {
        Self { from, ..self }
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
            from: r.from,
        }
    }

    /// The ray without its tangents.
    #[inline]
    pub fn primal(self) -> Ray<R::Primal> {
        Ray {
            o: self.o.primal(),
            d: self.d.primal(),
            from: self.from,
        }
    }
}
