//! Where spheres and tubes cross other surfaces: ellipses in planes, and curves on tubes.

use std::f64::consts::TAU;

use ad_core::Vec3;
use smallvec::{SmallVec, smallvec};

use super::Path;
use super::flat::{Flat, FlatKind, LEAST_SINE};
use crate::math::Frame;

/// A plane whose normal has a smaller cosine to the axis of a tube is parallel to it; and two tubes whose axes have a smaller
/// sine are.
const PARALLEL: f64 = 1e-6;
/// Points of a curve at which it is asked where it is, if that does not follow from linear conditions ..
const PROBES: u32 = 256;
/// .. and how often the way between two is halved.
const HALVINGS: u32 = 50;

/// A sphere, or a tube.
#[derive(Clone, Copy, Debug)]
pub(super) struct Round {
    /// Centre, or foot of the axis.
    pub origin: Vec3<f64>,
    /// Of a tube.
    pub axis: Option<Vec3<f64>>,
    pub radius: f64,
}

/// An ellipse, by its centre and half axes that need not be at right angles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ellipse {
    pub origin: Vec3<f64>,
    pub axes: [Vec3<f64>; 2],
}

/// One of the two curves in which a tube, whose points have a direction and a height, meets something round.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pierced {
    /// Feet of the tube's lines.
    foot: Ellipse,
    axis: Vec3<f64>,
    other: Round,
    upper: bool,
}

impl Ellipse {
    /// The point after a part of a turn, and how it changes with that.
    pub fn at(&self, turn: f64) -> (Vec3<f64>, Vec3<f64>) {
        let [e1, e2] = self.axes;
        let (sin, cos) = (TAU * turn).sin_cos();
        (
            self.origin + e1 * cos + e2 * sin,
            (e2 * cos - e1 * sin) * TAU,
        )
    }

    pub fn reach(&self) -> f64 {
        self.axes[0].length().hypot(self.axes[1].length())
    }

    /// The arcs where linear conditions hold, and some other one, those much shorter than a part in [`PROBES`] of which may
    /// be missed.
    fn arcs(
        self,
        conditions: &[[f64; 3]],
        other: Option<&dyn Fn(Vec3<f64>) -> bool>,
    ) -> SmallVec<[Path; 2]> {
        let mut bounds: SmallVec<[f64; 8]> = conditions.iter().flat_map(zeros).collect();
        if let Some(other) = other {
            changes(&|turn| other(self.at(turn).0), &mut bounds);
        }
        let holds = |turn: f64| {
            let (sin, cos) = (TAU * turn).sin_cos();
            (conditions.iter()).all(|[a, b, c]| a + b * cos + c * sin >= 0.0)
                && other.is_none_or(|other| other(self.at(turn).0))
        };
        between(&mut bounds, &holds)
            .into_iter()
            .map(|turns| Path::Arc(self, turns))
            .collect()
    }
}

impl Pierced {
    /// The point after a part of a turn, and how it changes with that.
    pub fn at(&self, turn: f64) -> (Vec3<f64>, Vec3<f64>) {
        let (point, by_turn, _) = self.of(turn);
        (point, by_turn)
    }

    /// The same, and what is negative where the line of the tube does not meet the other surface.
    fn of(&self, turn: f64) -> (Vec3<f64>, Vec3<f64>, f64) {
        let (foot, by_turn) = self.foot.at(turn);
        let [c, d] = [foot - self.other.origin, self.axis].map(|v| self.other.across(v));
        let a = d.length_squared();
        let b = c.dot(d);
        let discriminant = b * b - a * (c.length_squared() - self.other.radius.powi(2));
        let root = discriminant.max(0.0).sqrt();
        let height = (if self.upper { root - b } else { -root - b }) / a;
        let p = foot + self.axis * height;
        let out = self.other.across(p - self.other.origin);
        let climb = -out.dot(by_turn) / out.dot(self.axis);
        (p, by_turn + self.axis * climb, discriminant)
    }

    /// A ball around it: where it is on the tube.
    pub fn ball(&self) -> (Vec3<f64>, f64) {
        let half = self.axis * 0.5;
        (self.foot.origin + half, self.foot.reach() + half.length())
    }

    fn holds(&self, turn: f64) -> bool {
        let on = |p: Vec3<f64>, origin: Vec3<f64>, axis: Vec3<f64>| {
            (0.0..=1.0).contains(&(axis.dot(p - origin) / axis.length_squared()))
        };
        let (p, _, discriminant) = self.of(turn);
        discriminant >= 0.0
            && on(p, self.foot.origin, self.axis)
            && (self.other.axis).is_none_or(|axis| on(p, self.other.origin, axis))
    }
}

impl Round {
    /// The part of a vector across the axis, if there is one.
    fn across(&self, v: Vec3<f64>) -> Vec3<f64> {
        match self.axis {
            Some(axis) => v - axis * (axis.dot(v) / axis.length_squared()),
            None => v,
        }
    }

    /// The rim at the foot of a tube with this axis.
    fn foot(&self, axis: Vec3<f64>) -> Ellipse {
        let frame = Frame::from_normal(axis.normalize());
        Ellipse {
            origin: self.origin,
            axes: [frame.s * self.radius, frame.t * self.radius],
        }
    }

    /// Lines along which a flat surface crosses it.
    pub fn cut(&self, flat: &Flat, near: f64) -> SmallVec<[Path; 2]> {
        let oval = |p: Vec3<f64>| flat.holds(p);
        let oval: Option<&dyn Fn(Vec3<f64>) -> bool> = match flat.kind {
            FlatKind::Polygon(_) => None,
            FlatKind::Oval(_) => Some(&oval),
        };
        let n = flat.normal;
        let height = n.dot(flat.point() - self.origin);
        let Some(axis) = self.axis else {
            let circle = self.circle(n, height, near);
            return circle.map_or_else(SmallVec::new, |circle| {
                circle.arcs(&flat.conditions(circle.origin, circle.axes), oval)
            });
        };
        let slope = n.dot(axis);
        if slope.abs() < PARALLEL * axis.length() {
            let lines = self.sides(axis, n, height, near);
            let on = lines
                .into_iter()
                .filter_map(|start| flat.clipped(start, axis));
            return on
                .map(|[start, along]| Path::Straight { start, along })
                .collect();
        }
        let foot = self.foot(axis);
        let climbs = foot.axes.map(|e| -n.dot(e) / slope);
        // A rim that lies in the plane only stands there.
        let steep = foot.axes.map(|e| n.dot(e));
        let stands = |h: f64| h.abs() + steep[0].hypot(steep[1]) <= near;
        if stands(height) || stands(height - slope) {
            return SmallVec::new();
        }
        let ellipse = Ellipse {
            origin: self.origin + axis * (height / slope),
            axes: [0, 1].map(|k| foot.axes[k] + axis * climbs[k]),
        };
        let mut conditions = flat.conditions(ellipse.origin, ellipse.axes);
        conditions.push([height / slope, climbs[0], climbs[1]]);
        conditions.push([1.0 - height / slope, -climbs[0], -climbs[1]]);
        ellipse.arcs(&conditions, oval)
    }

    /// The circle in which a plane at a height over its centre cuts a sphere.
    fn circle(&self, normal: Vec3<f64>, height: f64, near: f64) -> Option<Ellipse> {
        let squared = self.radius.powi(2) - height * height;
        if height.abs() > self.radius - near || squared < (LEAST_SINE * self.radius).powi(2) {
            return None;
        }
        let frame = Frame::from_normal(normal);
        let r = squared.sqrt();
        Some(Ellipse {
            origin: self.origin + normal * height,
            axes: [frame.s * r, frame.t * r],
        })
    }

    /// Where the lines start in which a plane at a height over the axis of a tube, parallel to it, cuts that.
    fn sides(
        &self,
        axis: Vec3<f64>,
        normal: Vec3<f64>,
        height: f64,
        near: f64,
    ) -> SmallVec<[Vec3<f64>; 2]> {
        let squared = self.radius.powi(2) - height * height;
        if height.abs() > self.radius - near || squared < (LEAST_SINE * self.radius).powi(2) {
            return SmallVec::new();
        }
        let beside = normal.cross(axis).normalize() * squared.sqrt();
        let middle = self.origin + normal * height;
        smallvec![middle - beside, middle + beside]
    }

    /// Lines along which another one crosses it.
    pub fn meets(&self, other: &Self, near: f64) -> SmallVec<[Path; 2]> {
        match [self.axis, other.axis] {
            [None, None] => self.balls(other, near),
            [Some(axis), None] => self.pierces(axis, other),
            [None, Some(axis)] => other.pierces(axis, self),
            [Some(a), Some(b)] => {
                if a.normalize().cross(b.normalize()).length() < PARALLEL {
                    return self.tubes(a, other, b, near);
                }
                // Every line of the thinner one may meet the other one.
                if self.radius <= other.radius {
                    self.pierces(a, other)
                } else {
                    other.pierces(b, self)
                }
            }
        }
    }

    /// The height over this one of the plane or line in which both are, if they cross, seen along the axis of tubes; and
    /// the direction.
    fn middle(&self, other: &Self, to: Vec3<f64>, near: f64) -> Option<(Vec3<f64>, f64)> {
        let d = to.length();
        let (r1, r2) = (self.radius, other.radius);
        let crosses = d < r1 + r2 - near && d > (r1 - r2).abs() + near;
        crosses.then(|| (to.normalize(), (d * d + r1 * r1 - r2 * r2) / (2.0 * d)))
    }

    fn balls(&self, other: &Self, near: f64) -> SmallVec<[Path; 2]> {
        let middle = self.middle(other, other.origin - self.origin, near);
        let circle = middle.and_then(|(n, height)| self.circle(n, height, near));
        circle
            .map(|circle| Path::Arc(circle, [0.0, 1.0]))
            .into_iter()
            .collect()
    }

    /// Of parallel tubes.
    fn tubes(
        &self,
        axis: Vec3<f64>,
        other: &Self,
        other_axis: Vec3<f64>,
        near: f64,
    ) -> SmallVec<[Path; 2]> {
        let to = self.across(other.origin - self.origin);
        let Some((n, height)) = self.middle(other, to, near) else {
            return SmallVec::new();
        };
        let at = |p: Vec3<f64>| axis.dot(p - self.origin) / axis.length_squared();
        let [a, b] = [other.origin, other.origin + other_axis].map(at);
        let (from, to) = (a.min(b).max(0.0), a.max(b).min(1.0));
        if from >= to {
            return SmallVec::new();
        }
        self.sides(axis, n, height, near)
            .into_iter()
            .map(|foot| Path::Straight {
                start: foot + axis * from,
                along: axis * (to - from),
            })
            .collect()
    }

    /// Where the lines of a tube with this axis meet another surface.
    fn pierces(&self, axis: Vec3<f64>, other: &Self) -> SmallVec<[Path; 2]> {
        let mut paths = SmallVec::new();
        for upper in [false, true] {
            let curve = Pierced {
                foot: self.foot(axis),
                axis,
                other: *other,
                upper,
            };
            let holds = |turn: f64| curve.holds(turn);
            let mut bounds = SmallVec::<[f64; 8]>::new();
            changes(&holds, &mut bounds);
            let arcs = between(&mut bounds, &holds).into_iter();
            paths.extend(arcs.map(|turns| Path::Pierced(curve, turns)));
        }
        paths
    }
}

/// Where `a + b cos + c sin` is zero, in turns.
fn zeros([a, b, c]: &[f64; 3]) -> SmallVec<[f64; 2]> {
    let cosine = -a / b.hypot(*c);
    if cosine.is_nan() || cosine.abs() >= 1.0 {
        return SmallVec::new();
    }
    let (middle, half) = (c.atan2(*b), cosine.acos());
    let turn = |angle: f64| (angle / TAU).rem_euclid(1.0);
    smallvec![turn(middle - half), turn(middle + half)]
}

/// Adds where, in turns, something begins or ends to hold.
fn changes(holds: &dyn Fn(f64) -> bool, bounds: &mut SmallVec<[f64; 8]>) {
    for k in 0..PROBES {
        let [mut a, mut b] = [k, k + 1].map(|k| f64::from(k) / f64::from(PROBES));
        let start = holds(a);
        if holds(b) == start {
            continue;
        }
        for _ in 0..HALVINGS {
            let middle = 0.5 * (a + b);
            if holds(middle) == start {
                a = middle;
            } else {
                b = middle;
            }
        }
        // The last point at which it does.
        bounds.push(if start { a } else { b });
    }
}

/// The arcs where something holds, given all points where that may change.
fn between(
    bounds: &mut SmallVec<[f64; 8]>,
    holds: &dyn Fn(f64) -> bool,
) -> SmallVec<[[f64; 2]; 2]> {
    bounds.sort_unstable_by(f64::total_cmp);
    let Some(&first) = bounds.first() else {
        return if holds(0.0) {
            smallvec![[0.0, 1.0]]
        } else {
            SmallVec::new()
        };
    };
    let next = bounds[1..].iter().copied().chain([first + 1.0]);
    (bounds.iter().copied().zip(next))
        .filter(|(a, b)| b > a && holds(0.5 * (a + b)))
        .map(|(a, b)| [a, b])
        .collect()
}

/// A part of a turn between two ends at which a curve may run along a line of its tube, by a parameter in [0, 1]: slower
/// there. And how it changes.
pub(super) fn eased([from, to]: [f64; 2], s: f64) -> (f64, f64) {
    let way = to - from;
    let turn = from + way * s * s * (3.0 - 2.0 * s);
    (turn.clamp(from, to), way * 6.0 * s * (1.0 - s))
}
