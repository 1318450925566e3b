//! Spheres, discs and cylinders, and the tubes around curves. Their quadratics cancel badly in f32, so they are solved in f64,
//! which costs the same and needs no rearrangement for far-away small ones.

use super::tube::{Cone, Entry, Span};
use super::{MIN_THICKNESS, Ray};
use crate::math::each;
use std::ops::{Add, Div, Mul, Sub};
use wide::f64x8;

/// Rays per [`f64x8`].
pub(super) const LANES_F64: usize = 8;

/// The operations of the tests, rounded alike for one ray and for eight.
pub(super) trait Double:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    fn splat(x: f64) -> Self;
    /// NaN for negative numbers.
    fn sqrt(self) -> Self;
    /// Whether any is zero or more.
    fn reaches_zero(self) -> bool;
    /// `self` where `lo <= x <= hi`, NaN elsewhere.
    fn where_within(self, x: Self, lo: f64, hi: f64) -> Self;
    /// What of a line is a function of that line alone, one by one.
    fn one_by_one(o: [Self; 3], d: [Self; 3], f: impl Fn([f64; 3], [f64; 3]) -> Entry)
    -> [Self; 4];
}

impl Double for f64 {
    #[inline(always)]
    fn splat(x: f64) -> f64 {
        x
    }
    #[inline(always)]
    fn sqrt(self) -> f64 {
        self.sqrt()
    }
    #[inline(always)]
    fn reaches_zero(self) -> bool {
        self >= 0.0
    }
    #[inline(always)]
    fn where_within(self, x: f64, lo: f64, hi: f64) -> f64 {
        if x >= lo && x <= hi { self } else { f64::NAN }
    }
    #[inline(always)]
    fn one_by_one(o: [f64; 3], d: [f64; 3], f: impl Fn([f64; 3], [f64; 3]) -> Entry) -> [f64; 4] {
        f(o, d)
    }
}

impl Double for f64x8 {
    #[inline(always)]
    fn splat(x: f64) -> f64x8 {
        f64x8::splat(x)
    }
    #[inline(always)]
    fn sqrt(self) -> f64x8 {
        self.sqrt()
    }
    #[inline(always)]
    fn reaches_zero(self) -> bool {
        self.simd_ge(f64x8::splat(0.0)).to_bitmask() != 0
    }
    #[inline(always)]
    fn where_within(self, x: f64x8, lo: f64, hi: f64) -> f64x8 {
        let inside = x.simd_ge(f64x8::splat(lo)) & x.simd_le(f64x8::splat(hi));
        inside.select(self, f64x8::splat(f64::NAN))
    }
    #[inline(never)]
    fn one_by_one(
        o: [f64x8; 3],
        d: [f64x8; 3],
        f: impl Fn([f64; 3], [f64; 3]) -> Entry,
    ) -> [f64x8; 4] {
        let (o, d) = (o.map(|x| x.to_array()), d.map(|x| x.to_array()));
        let mut out = [[0.0; LANES_F64]; 4];
        for i in 0..LANES_F64 {
            let found = f(o.map(|x| x[i]), d.map(|x| x[i]));
            for (out, x) in out.iter_mut().zip(found) {
                out[i] = x;
            }
        }
        out.map(f64x8::from)
    }
}

/// One curved primitive.
#[derive(Clone, Copy, Debug)]
pub(super) enum Curved {
    Sphere {
        center: [f64; 3],
        squared_radius: f64,
    },
    /// `normal` of any length; `du`, `dv` are dual to the half axes.
    Disk {
        center: [f64; 3],
        normal: [f64; 3],
        du: [f64; 3],
        dv: [f64; 3],
    },
    /// `axis` has unit length.
    Cylinder {
        p0: [f64; 3],
        axis: [f64; 3],
        length: f64,
        squared_radius: f64,
    },
    Cone(Cone),
    Span(Span),
}

/// A line, or eight, and what all spheres need of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line<N> {
    o: [N; 3],
    d: [N; 3],
    /// `1 / |d|^2`
    inverse: N,
}

impl<N: Double> Line<N> {
    #[inline(always)]
    pub(super) fn new(o: [N; 3], d: [N; 3]) -> Self {
        let inverse = N::splat(1.0) / dot(d, d);
        Self { o, d, inverse }
    }
}

impl Line<f64> {
    #[inline(always)]
    pub(super) fn of(ray: &Ray) -> Self {
        Self::new(each(ray.o, f64::from), each(ray.d, f64::from))
    }
}

#[inline(always)]
fn dot<N: Double>(a: [N; 3], b: [N; 3]) -> N {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn minus<N: Double>(a: [N; 3], b: [N; 3]) -> [N; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a - s b`
#[inline(always)]
fn less<N: Double>(a: [N; 3], s: N, b: [N; 3]) -> [N; 3] {
    [a[0] - s * b[0], a[1] - s * b[1], a[2] - s * b[2]]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Whether an f64 distance is a hit; the caller's limit is f32, so both sides are rounded alike.
#[inline(always)]
fn within(t: f64, t_max: f32) -> Option<f32> {
    let t = t as f32;
    (t > 0.0 && t <= t_max).then_some(t)
}

impl Curved {
    /// `None` if the radius is not positive.
    pub(super) fn sphere(center: [f32; 3], radius: f32) -> Option<Curved> {
        (radius >= MIN_THICKNESS).then(|| Curved::Sphere {
            center: center.map(f64::from),
            squared_radius: f64::from(radius) * f64::from(radius),
        })
    }

    /// `None` if the half axes are parallel or vanish.
    pub(super) fn disk(center: [f32; 3], e1: [f32; 3], e2: [f32; 3]) -> Option<Curved> {
        let (a, b) = (e1.map(f64::from), e2.map(f64::from));
        let normal = cross(a, b);
        let (aa, bb, nn) = (dot(a, a), dot(b, b), dot(normal, normal));
        let thin = f64::from(MIN_THICKNESS) * f64::from(MIN_THICKNESS);
        (nn >= thin * aa.max(bb) && nn > 1e-13 * aa * bb).then(|| Curved::Disk {
            center: center.map(f64::from),
            normal,
            du: cross(b, normal).map(|x| x / nn),
            dv: cross(normal, a).map(|x| x / nn),
        })
    }

    /// `None` if the radius or the axis vanishes.
    pub(super) fn cylinder(p0: [f32; 3], axis: [f32; 3], radius: f32) -> Option<Curved> {
        let axis = axis.map(f64::from);
        let length = dot(axis, axis).sqrt();
        (radius >= MIN_THICKNESS && length >= f64::from(MIN_THICKNESS)).then(|| Curved::Cylinder {
            p0: p0.map(f64::from),
            axis: axis.map(|x| x / length),
            length,
            squared_radius: f64::from(radius) * f64::from(radius),
        })
    }

    /// Nearest `(t, u, v)` with `0 < t <= t_max`.
    #[inline]
    pub(super) fn intersect(&self, line: &Line<f64>, t_max: f32) -> Option<(f32, f32, f32)> {
        let [near, far, u, v] = self.candidates(line)?;
        within(near, t_max)
            .or_else(|| within(far, t_max))
            .map(|t| (t, u as f32, v as f32))
    }

    /// Where the line meets the surface: two distances, ascending, and surface coordinates. NaN where it does
    /// not; `None` if that is everywhere and was noticed early.
    #[inline(always)]
    pub(super) fn candidates<N: Double>(
        &self,
        &Line { o, d, inverse }: &Line<N>,
    ) -> Option<[N; 4]> {
        let none = N::splat(0.0);
        match *self {
            Curved::Sphere {
                center,
                squared_radius,
            } => {
                let to = minus(each(center, N::splat), o);
                let (near, far) = roots(to, d, inverse, squared_radius)?;
                Some([near, far, none, none])
            }
            Curved::Disk {
                center,
                normal,
                du,
                dv,
            } => {
                let splat = |x| each(x, N::splat);
                let (center, normal) = (splat(center), splat(normal));
                let (du, dv) = (splat(du), splat(dv));
                let to = minus(center, o);
                let t = dot(normal, to) / dot(normal, d);
                let p = less(to, t, d);
                let (u, v) = (none - dot(du, p), none - dot(dv, p));
                let t = t.where_within(u * u + v * v, 0.0, 1.0);
                Some([t, t, u, v])
            }
            Curved::Cylinder {
                p0,
                axis,
                length,
                squared_radius,
            } => {
                let (p0, axis) = (each(p0, N::splat), each(axis, N::splat));
                let to = minus(p0, o);
                let (along_to, along_d) = (dot(to, axis), dot(d, axis));
                // Seen along the axis the tube is a circle.
                let flat_d = less(d, along_d, axis);
                let inverse = N::splat(1.0) / dot(flat_d, flat_d);
                let flat_to = less(to, along_to, axis);
                let (near, far) = roots(flat_to, flat_d, inverse, squared_radius)?;
                let on = |t: N| t.where_within(t * along_d - along_to, 0.0, length);
                Some([on(near), on(far), none, none])
            }
            Curved::Cone(cone) => Some(N::one_by_one(o, d, |o, d| cone.entry(o, d))),
            Curved::Span(span) => Some(N::one_by_one(o, d, |o, d| span.entry(o, d))),
        }
    }

    /// Whether there is a hit with `0 < t < t_max`.
    #[inline]
    pub(super) fn occluded(&self, line: &Line<f64>, t_max: f32) -> bool {
        self.intersect(line, t_max)
            .is_some_and(|(t, _, _)| t < t_max)
    }
}

/// Both `t` with `|t d - to|^2 = rr`, ascending, given `1 / |d|^2`; NaN where there are none, `None` if that is
/// everywhere.
#[inline(always)]
fn roots<N: Double>(to: [N; 3], d: [N; 3], inverse: N, rr: f64) -> Option<(N, N)> {
    let middle = dot(to, d) * inverse;
    // Distance of the centre from the line; the usual b^2 - a c would lose a small far sphere.
    let off = less(to, middle, d);
    let spare = N::splat(rr) - dot(off, off);
    spare.reaches_zero().then(|| {
        let half = (spare * inverse).sqrt();
        (middle - half, middle + half)
    })
}
