//! Orthonormal frames.

use ad_core::{Real, Vec3};

/// A tangent is parallel to a normal if this part of its squared length, or less, lies across it.
const PARALLEL: f64 = 1e-12;

/// An orthonormal frame; `n` is the local z axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame<R> {
    /// Local x axis, in world space.
    pub s: Vec3<R>,
    /// Local y axis, in world space.
    pub t: Vec3<R>,
    /// Local z axis, in world space.
    pub n: Vec3<R>,
}

impl<R: Real> Frame<R> {
    /// Some frame around the unit vector `n`: continuous except across `n.z = 0`, without the
    /// singular direction of Stam's `make_frame` (errata S-D7).
    ///
    /// Source: [Duff et al. 2017].
    #[inline]
    pub fn from_normal(n: Vec3<R>) -> Self {
        let sign = R::Primal::one().copysign(n.z.primal());
        let sign = R::lift(sign);
        let a = -(sign + n.z).recip();
        let b = n.x * n.y * a;
        let s = Vec3::new(sign * n.x * n.x * a + R::one(), sign * b, -(sign * n.x));
        let t = Vec3::new(b, sign + n.y * n.y * a, -n.y);
        Self { s, t, n }
    }

    /// The frame around the unit vector `n` whose `s` axis is the projection of `dp_du`; falls back
    /// to [`Frame::from_normal`] where `dp_du` vanishes or is parallel to `n`.
    #[inline]
    pub fn from_normal_and_tangent(n: Vec3<R>, dp_du: Vec3<R>) -> Self {
        let s = dp_du - n * n.dot(dp_du);
        let limit = R::Primal::of(PARALLEL) * dp_du.primal().length_squared();
        if s.primal().length_squared() > limit {
            let s = s.normalize();
            Self {
                s,
                t: n.cross(s),
                n,
            }
        } else {
            Self::from_normal(n)
        }
    }

    /// [`Frame::from_normal_and_tangent`] in loops over many, without a branch. Whether it is right: not where the
    /// projection of `dp_du` is too short or too long for [`Vec3::unit`].
    #[inline(always)]
    pub(crate) fn in_line(n: Vec3<R>, dp_du: Vec3<R>) -> (Self, bool) {
        let some = Self::from_normal(n);
        let across = dp_du - n * n.dot(dp_du);
        let limit = R::Primal::of(PARALLEL) * dp_du.primal().length_squared();
        let there = across.primal().length_squared() > limit;
        let (s, right) = across.unit();
        let frame = Self {
            s: Vec3::select(there, s, some.s),
            t: Vec3::select(there, n.cross(s), some.t),
            n,
        };
        (frame, right | !there)
    }

    /// World to local coordinates.
    #[inline]
    pub fn to_local(&self, v: Vec3<R>) -> Vec3<R> {
        Vec3::new(self.s.dot(v), self.t.dot(v), self.n.dot(v))
    }

    /// Local to world coordinates.
    #[inline]
    pub fn to_world(&self, v: Vec3<R>) -> Vec3<R> {
        self.s * v.x + self.t * v.y + self.n * v.z
    }

    /// A constant frame: zero tangents.
    #[inline]
    pub fn lift(f: Frame<R::Primal>) -> Self {
        Self {
            s: Vec3::lift(f.s),
            t: Vec3::lift(f.t),
            n: Vec3::lift(f.n),
        }
    }

    /// The frame without its tangents.
    #[inline]
    pub fn primal(self) -> Frame<R::Primal> {
        Frame {
            s: self.s.primal(),
            t: self.t.primal(),
            n: self.n.primal(),
        }
    }
}
