//! Segments of cubic B-splines: circles across a curve.

use ad_core::{Float, Real, Vec3};

use super::super::hit_is_exact;
use super::Point;
use crate::accel::{self, Along, Cubic, Hit, Primitive};
use crate::math::Ray;

/// A part of a segment turns by less than this, as a rule, radians: boxes around it are narrow.
const TURN: f64 = 0.5;

/// Most parts of a segment.
const MOST_PARTS: u8 = 8;

/// Parts of a segment are not longer than this many radii of it, as a rule.
const LENGTH: f64 = 64.0;

/// Steps of Newton's method from a hit in single precision: two for the digits of an f64, and one for every order of
/// derivatives, up to the second.
const STEPS: usize = 4;

/// How many primitives a segment is.
pub(super) fn parts(points: &[[f32; 4]; 4]) -> u8 {
    let cubic = Cubic::<f64>::new(points);
    let capsule = cubic.capsule([0.0, 1.0]);
    let turns = if capsule.bend.is_finite() {
        2.0 * capsule.bend / TURN
    } else {
        4.0
    };
    let radius = cubic.at(0.5).r;
    let long = ((capsule.to - capsule.from).length() / (LENGTH * radius)).min(2.0);
    let most = f64::from(MOST_PARTS);
    turns.max(long).ceil().clamp(1.0, most) as u8
}

pub(super) fn primitive(points: &[[f32; 4]; 4], first: u32, part: [u8; 2]) -> Primitive {
    let capsule = Cubic::<f64>::new(points).capsule(accel::range(part));
    let (end_points, radius, _) = accel::rounded(&capsule);
    Primitive::Span {
        end_points,
        radius,
        first,
        part,
    }
}

/// Of a part of a segment.
pub(super) fn area(points: &[[f32; 4]; 4], part: [u8; 2]) -> f64 {
    let cubic = Cubic::<f64>::new(points);
    let [low, high] = accel::range(part);
    let around = |u: f64| {
        let Along { c1, r, r1, .. } = cubic.at(u);
        2.0 * std::f64::consts::PI * r * (c1.length_squared() + r1 * r1).sqrt()
    };
    // The rule of Gauss with three points.
    let [middle, half] = [0.5 * (low + high), 0.5 * (high - low)];
    let aside = half * 0.6f64.sqrt();
    let sides = around(middle - aside) + around(middle + aside);
    half * (5.0 * sides + 8.0 * around(middle)) / 9.0
}

/// The unit direction of the curve: that of the whole segment where it stands still.
fn direction<R: Real>(points: &[[f32; 4]; 4], along: &Along<R>) -> Vec3<R> {
    let unit = along.c1.normalize();
    if unit.primal().length_squared() > R::Primal::zero() {
        return unit;
    }
    let point = |k: usize| Vec3::from([0, 1, 2].map(|i: usize| f64::from(points[k][i])));
    let chord = (point(3) - point(0)).normalize();
    let chord = if chord == Vec3::zero() {
        Vec3::new(1.0, 0.0, 0.0)
    } else {
        chord
    };
    Vec3::lift(chord.map(R::Primal::of))
}

/// The point in the unit direction `outward` across the curve.
fn on<R: Real>(along: &Along<R>, direction: Vec3<R>, outward: Vec3<R>, u: R) -> Point<R> {
    let Along { c, c1, c2, r, r1 } = *along;
    let speed = c1.length_squared() - r * outward.dot(c2);
    let n = (outward * speed - c1 * r1).normalize();
    let none = n.primal().length_squared() == R::Primal::zero();
    Point {
        p: c + outward * r,
        n: Vec3::select(none, outward, n),
        along: direction,
        v: u,
    }
}

/// The point with a parameter, in the unit direction that `outward` chooses across the curve.
pub(super) fn at<R: Real>(
    points: &[[f32; 4]; 4],
    u: R,
    outward: impl Fn(Vec3<R>) -> Vec3<R>,
) -> Point<R> {
    let along = Cubic::<R>::new(points).at(u);
    let direction = direction(points, &along);
    on(&along, direction, outward(direction), u)
}

/// The parameter of the point of a part of the curve next to one.
fn nearest(cubic: &Cubic<f64>, [low, high]: [f64; 2], p: Vec3<f64>) -> f64 {
    let width = high - low;
    let mut u = 0.5 * (low + high);
    for _ in 0..16 {
        let Along { c, c1, c2, .. } = cubic.at(u);
        let speed = c1.length_squared();
        let h = (speed - (p - c).dot(c2)).max(0.1 * speed);
        let step = (p - c).dot(c1) / h.max(f64::MIN_POSITIVE);
        let next = (u + step).clamp(low - 0.1 * width, high + 0.1 * width);
        let moved = (next - u).abs();
        u = next;
        if moved < 1e-14 {
            break;
        }
    }
    u
}

/// Direction of the curve next to a point, the unit direction from there to it, and the parameter.
pub(super) fn locate(
    points: &[[f32; 4]; 4],
    part: [u8; 2],
    p: Vec3<f64>,
) -> (Vec3<f64>, Vec3<f64>, f64) {
    let cubic = Cubic::<f64>::new(points);
    let u = nearest(&cubic, accel::range(part), p);
    let along = cubic.at(u);
    let direction = direction(points, &along);
    (direction, (p - along.c).normalize(), u)
}

/// The same root with more digits, and as it moves: where the ray is at right angles to the curve, as far as the radius.
fn refined<R: Real>(cubic: &Cubic<R>, ray: &Ray<R>, t: R, u: R) -> (R, R) {
    let Along { c, c1, c2, r, r1 } = cubic.at(u);
    let w = ray.at(t) - c;
    let (across, size) = (w.dot(c1), (w.length_squared() - r * r) * R::c(0.5));
    let h = c1.length_squared() - w.dot(c2);
    let along = ray.d.dot(c1);
    let pull = across + r * r1;
    let determinant = h * w.dot(ray.d) - along * pull;
    let inverse = determinant.recip();
    let step = (across * pull - h * size) * inverse;
    let slide = (across * w.dot(ray.d) - along * size) * inverse;
    // Where the ray only touches the tube there is no derivative.
    let limit = (r.primal() * r.primal()).max(R::Primal::MIN_POSITIVE);
    let short = step.primal() * step.primal() * ray.d.primal().length_squared() <= limit;
    if short && step.is_finite() && slide.is_finite() {
        (t + step, u + slide)
    } else {
        (t, u)
    }
}

/// What a ray meets of a part of a segment; `fallback` chooses a direction across the curve where it has no thickness.
pub(super) fn hit<R: Real>(
    points: &[[f32; 4]; 4],
    part: [u8; 2],
    ray: &Ray<R>,
    hit: &Hit,
    fallback: impl Fn(Vec3<R>) -> Vec3<R>,
) -> (R, Point<R>) {
    let cubic = Cubic::<R>::new(points);
    let mut t = R::lift(R::Primal::from_f32(hit.t));
    let mut u = R::lift(R::Primal::from_f32(hit.u));
    if !hit_is_exact::<R>() {
        // Not all who ask know more of a hit than its distance.
        let p = ray.primal().at(t.primal()).map(|x| x.to_f64());
        let near = nearest(&Cubic::new(points), accel::range(part), p);
        u = R::of(near);
        for _ in 0..STEPS {
            (t, u) = refined(&cubic, ray, t, u);
        }
    }
    let along = cubic.at(u);
    let direction = direction(points, &along);
    let beside = ray.at(t) - along.c;
    let outward = (beside - direction * direction.dot(beside)).normalize();
    let none = outward.primal().length_squared() == R::Primal::zero();
    let outward = Vec3::select(none, fallback(direction), outward);
    (t, on(&along, direction, outward, u))
}
