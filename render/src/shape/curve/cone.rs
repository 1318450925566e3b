//! Segments of linear curves: the surface of all balls along one.

use ad_core::{Float, Real, Vec3};

use super::super::sphere::root_near;
use super::super::{hit_is_exact, lift3};
use super::Point;
use crate::accel::{Hit, Primitive};
use crate::math::Ray;

use std::f64::consts::PI;

/// A segment over a scalar.
pub(super) struct Segment<R> {
    p0: Vec3<R>,
    /// Unit direction.
    along: Vec3<R>,
    length: R,
    radii: [R; 2],
    /// Of the angle between the cone's normals and the plane across: how much of the length the radius falls by.
    sine: R,
    /// The larger ball, if it contains all.
    alone: Option<usize>,
}

pub(super) fn primitive(&[a, b]: &[[f32; 4]; 2]) -> Primitive {
    Primitive::Cone {
        p0: [a[0], a[1], a[2]],
        axis: [0, 1, 2].map(|k: usize| b[k] - a[k]),
        radii: [a[3], b[3]],
    }
}

pub(super) fn area(balls: &[[f32; 4]; 2]) -> f64 {
    let Segment {
        length,
        radii: [a, b],
        sine,
        alone,
        ..
    } = Segment::<f64>::new(balls);
    match alone {
        Some(_) => 4.0 * PI * a.max(b) * a.max(b),
        None => {
            // All lengths of the cone are as much shorter as its tangents are steep.
            let side = PI * (a + b) * length * (1.0 - sine * sine);
            side + 2.0 * PI * (a * a * (1.0 + sine) + b * b * (1.0 - sine))
        }
    }
}

/// Which part of the surface.
enum Side {
    Ball(usize),
    Cone,
}

impl<R: Real> Segment<R> {
    pub fn new(&[a, b]: &[[f32; 4]; 2]) -> Self {
        // The same numbers as rays see.
        let axis = lift3::<R>([0, 1, 2].map(|k: usize| b[k] - a[k]));
        let radii = [a[3], b[3]].map(|r| R::lift(R::Primal::from_f32(r)));
        let length = axis.length();
        let falls = f64::from(a[3]) - f64::from(b[3]);
        let alone = if falls.abs() >= length.primal().to_f64() {
            Some(usize::from(falls < 0.0))
        } else {
            None
        };
        let unit = axis.normalize();
        let none = unit.primal().length_squared() == R::Primal::zero();
        let upright = Vec3::new(R::zero(), R::zero(), R::one());
        let sine = match alone {
            None => (radii[0] - radii[1]) / length,
            Some(end) => R::of(if end == 0 { 1.0 } else { -1.0 }),
        };
        Self {
            p0: lift3([a[0], a[1], a[2]]),
            along: Vec3::select(none, upright, unit),
            length,
            radii,
            sine,
            alone,
        }
    }

    fn centre(&self, end: usize) -> Vec3<R> {
        match end {
            0 => self.p0,
            _ => self.p0 + self.along * self.length,
        }
    }

    /// Squared cosine of the angle whose sine is kept.
    fn steep(&self) -> R {
        (R::one() - self.sine) * (R::one() + self.sine)
    }

    /// The part of the length where the ball is that a point at this height over the first end lies on, if that is one
    /// of the cone.
    fn height(&self, y: R) -> R {
        (y - self.sine * self.radii[0]) / (self.steep() * self.length)
    }

    fn side(&self, p: Vec3<R>) -> Side {
        if let Some(end) = self.alone {
            return Side::Ball(end);
        }
        let v = self.height(self.along.dot(p - self.p0)).primal();
        if v < R::Primal::zero() {
            Side::Ball(0)
        } else if v > R::Primal::one() {
            Side::Ball(1)
        } else {
            Side::Cone
        }
    }

    fn on_ball(&self, end: usize, n: Vec3<R>) -> Point<R> {
        Point {
            p: self.centre(end) + n * self.radii[end],
            n,
            along: self.along,
            v: R::of(end as f64),
        }
    }

    /// At the part `v` of the length, in the unit direction `outward` across it.
    fn on_cone(&self, v: R, outward: Vec3<R>) -> Point<R> {
        let [r0, r1] = self.radii;
        let n = outward * self.steep().sqrt() + self.along * self.sine;
        let centre = self.p0 + self.along * (self.length * v);
        Point {
            p: centre + n * (r0 + (r1 - r0) * v),
            n,
            along: self.along,
            v,
        }
    }

    /// Where a ray enters the cone, as if it had no ends.
    fn entry(&self, ray: &Ray<R>) -> R {
        let dd = ray.d.length_squared();
        let shift = (self.p0 - ray.o).dot(ray.d) / dd;
        let q = ray.at(shift) - self.p0;
        let (y, dy) = (q.dot(self.along), ray.d.dot(self.along));
        let across = q - self.along * y;
        let (m, r) = (self.steep(), self.radii[0] - self.sine * y);
        let a = m * dd - dy * dy;
        let b = m * across.dot(ray.d) + self.sine * dy * r;
        let c = m * across.length_squared() - r * r;
        let root = (b * b - a * c).max(R::zero()).sqrt();
        let step = if b.primal() < R::Primal::zero() {
            c / (root - b)
        } else {
            -(b + root) / a
        };
        shift + step
    }

    pub fn hit(&self, ray: &Ray<R>, hit: &Hit) -> (R, Point<R>) {
        let near = R::Primal::from_f32(hit.t);
        let known = R::lift(near);
        let side = self.side(ray.at(known));
        let t = match side {
            _ if hit_is_exact::<R>() => known,
            Side::Ball(end) => root_near(self.centre(end) - ray.o, ray.d, self.radii[end], near),
            Side::Cone => {
                let t = self.entry(ray);
                if t.is_finite() { t } else { known }
            }
        };
        let p = ray.at(t);
        let point = match side {
            Side::Ball(end) => self.on_ball(end, (p - self.centre(end)).normalize()),
            Side::Cone => {
                let from = p - self.p0;
                let y = self.along.dot(from);
                let outward = (from - self.along * y).normalize();
                self.on_cone(self.height(y), outward)
            }
        };
        (t, point)
    }

    /// The point with a second surface coordinate, in the unit direction that `outward` chooses across the segment.
    pub fn at(&self, y: R, outward: impl Fn(Vec3<R>) -> Vec3<R>) -> Point<R> {
        let outward = outward(self.along);
        let on_ball = |end: usize, z: R| {
            let across = (R::one() - z * z).max(R::zero()).sqrt();
            self.on_ball(end, self.along * z + outward * across)
        };
        if y.primal() < R::Primal::zero() {
            on_ball(0, self.sine + y * (R::one() + self.sine))
        } else if y.primal() > R::Primal::one() {
            on_ball(1, self.sine + (y - R::one()) * (R::one() - self.sine))
        } else {
            self.on_cone(y, outward)
        }
    }
}

impl Segment<f64> {
    /// The direction of the segment, that from it to a point, and the second coordinate of the point next to that.
    pub fn locate(&self, p: Vec3<f64>) -> (Vec3<f64>, Vec3<f64>, f64) {
        let from = p - self.p0;
        let y = self.along.dot(from);
        let outward = (from - self.along * y).normalize();
        let on_ball = |end: usize| (p - self.centre(end)).normalize().dot(self.along) - self.sine;
        let part = |over: f64, of: f64| if of > 0.0 { over / of } else { 0.0 };
        let at = match self.side(p) {
            Side::Ball(0) => part(on_ball(0), 1.0 + self.sine).clamp(-1.0, 0.0),
            Side::Ball(_) => 1.0 + part(on_ball(1), 1.0 - self.sine).clamp(0.0, 1.0),
            Side::Cone => self.height(y),
        };
        (self.along, outward, at)
    }
}
