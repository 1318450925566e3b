//! How a surface bends: first derivatives with respect to its texture coordinates.

use ad_core::{Dual, Real, Vec2, Vec3};

use crate::math::Frame;
use crate::motion::Drift;

/// Derivatives of position and shading frame with respect to the texture coordinates `uv` of an interaction, world
/// space. The third axis of the frame follows: `t = n x s`.
#[derive(Clone, Copy, Debug)]
pub struct Partials<R> {
    /// Of the position.
    pub dp_du: Vec3<R>,
    /// Of the position.
    pub dp_dv: Vec3<R>,
    /// Of the unit shading normal `frame.n`.
    pub dn_du: Vec3<R>,
    /// Of the unit shading normal.
    pub dn_dv: Vec3<R>,
    /// Of the first axis of the shading frame, `frame.s`.
    pub ds_du: Vec3<R>,
    /// Of the first axis of the shading frame.
    pub ds_dv: Vec3<R>,
}

/// The derivative of a vector along each of two directions.
#[inline]
fn slopes<R: Real>(v: Vec3<Dual<R, 2>>) -> [Vec3<R>; 2] {
    [0, 1].map(|k| v.map(|x| x.eps[k]))
}

/// A vector with its derivative along each of two directions.
#[inline]
fn moving<R: Real>(v: Vec3<R>, [du, dv]: [Vec3<R>; 2]) -> Vec3<Dual<R, 2>> {
    Vec3::new(
        Dual::new(v.x, [du.x, dv.x]),
        Dual::new(v.y, [du.y, dv.y]),
        Dual::new(v.z, [du.z, dv.z]),
    )
}

/// Two independent variables.
#[inline]
pub(super) fn variables<R: Real>(x: R, y: R) -> [Dual<R, 2>; 2] {
    [Dual::var(x, 0), Dual::var(y, 1)]
}

/// A constant vector.
#[inline]
pub(super) fn constant<R: Real>(v: Vec3<R>) -> Vec3<Dual<R, 2>> {
    v.map(Dual::constant)
}

impl<R: Real> Partials<R> {
    /// Of a position and a frame that are functions of two [`variables`], with respect to these.
    #[inline]
    pub(super) fn of(p: Vec3<Dual<R, 2>>, frame: &Frame<Dual<R, 2>>) -> Self {
        let [dp_du, dp_dv] = slopes(p);
        let [dn_du, dn_dv] = slopes(frame.n);
        let [ds_du, ds_dv] = slopes(frame.s);
        Self {
            dp_du,
            dp_dv,
            dn_du,
            dn_dv,
            ds_du,
            ds_dv,
        }
    }

    /// The same with respect to `uv`, which is a function of the same variables. `None` where that has no inverse.
    #[inline]
    pub(super) fn with_respect_to(self, uv: Vec2<Dual<R, 2>>) -> Option<Self> {
        let ([a, b], [c, d]) = (uv.x.eps, uv.y.eps);
        let inverse = (a * d - b * c).recip();
        let rows = [d * inverse, -(c * inverse), -(b * inverse), a * inverse];
        if !rows.iter().all(|x| x.is_finite()) {
            return None;
        }
        let [xu, yu, xv, yv] = rows;
        let turned = |du: Vec3<R>, dv: Vec3<R>| (du * xu + dv * yu, du * xv + dv * yv);
        let (dp_du, dp_dv) = turned(self.dp_du, self.dp_dv);
        let (dn_du, dn_dv) = turned(self.dn_du, self.dn_dv);
        let (ds_du, ds_dv) = turned(self.ds_du, self.ds_dv);
        let partials = Self {
            dp_du,
            dp_dv,
            dn_du,
            dn_dv,
            ds_du,
            ds_dv,
        };
        partials.is_finite().then_some(partials)
    }

    /// The same surface with a frame of its own, as normal maps give it: `local` in the coordinates of the shading
    /// frame `frame`, as it changes with `uv` ([`crate::bsdf::Bsdf::shading_frame`] over these duals). The new frame,
    /// world space, comes first.
    #[inline]
    pub fn mapped(&self, frame: &Frame<R>, local: &Frame<Dual<R, 2>>) -> (Frame<R>, Self) {
        let n = moving(frame.n, [self.dn_du, self.dn_dv]);
        let s = moving(frame.s, [self.ds_du, self.ds_dv]);
        let t = moving(
            frame.t,
            [
                self.dn_du.cross(frame.s) + frame.n.cross(self.ds_du),
                self.dn_dv.cross(frame.s) + frame.n.cross(self.ds_dv),
            ],
        );
        let own = Frame { s, t, n };
        let mapped = Frame {
            s: own.to_world(local.s),
            t: own.to_world(local.t),
            n: own.to_world(local.n),
        };
        let value = |v: Vec3<Dual<R, 2>>| v.map(|x| x.re);
        let now = Frame {
            s: value(mapped.s),
            t: value(mapped.t),
            n: value(mapped.n),
        };
        let p = moving(Vec3::zero(), [self.dp_du, self.dp_dv]);
        (now, Self::of(p, &mapped))
    }

    /// Those of a surface that moves so.
    pub(crate) fn carried(&self, drift: &Drift<R>) -> Self {
        Self {
            dp_du: drift.vector(self.dp_du),
            dp_dv: drift.vector(self.dp_dv),
            dn_du: drift.direction(self.dn_du),
            dn_dv: drift.direction(self.dn_dv),
            ds_du: drift.direction(self.ds_du),
            ds_dv: drift.direction(self.ds_dv),
        }
    }

    /// Whether all of them are finite numbers.
    pub fn is_finite(&self) -> bool {
        [
            self.dp_du, self.dp_dv, self.dn_du, self.dn_dv, self.ds_du, self.ds_dv,
        ]
        .iter()
        .all(|v| v.is_finite())
    }
}
