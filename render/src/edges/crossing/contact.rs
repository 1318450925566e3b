//! Where surfaces of two shapes meet without crossing, as far as lines say: side on side, where one may cover the other, and
//! where it is not told how they cross.

use std::collections::HashMap;
use std::f64::consts::TAU;

use ad_core::Vec3;

use super::LineSide;
use super::flat::{Chord, Flat, FlatKind, LEAST_SINE};
use crate::edges::EdgePoint;

/// Start and direction of a part of a side.
pub(super) type Side = [Vec3<f64>; 2];

/// Why derivatives may be wrong where two shapes meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Doubt {
    /// They cross at a small angle.
    Grazing,
    /// Their faces lie in the same place and look the same way.
    Twice,
    /// They cross in what is a side of both.
    FourSides,
}

impl Doubt {
    pub const ALL: [Self; 3] = [Self::Grazing, Self::Twice, Self::FourSides];

    /// What the two do.
    pub fn describe(self) -> &'static str {
        match self {
            Self::Grazing => "cross at less than a thousandth of a radian",
            Self::Twice => "have faces in the same place that look the same way",
            Self::FourSides => "cross in a line that is a side of both",
        }
    }
}

/// Sides of two faces of different shapes that lie on each other.
pub(super) struct Touch {
    pub parts: [LineSide; 2],
    /// Both sides.
    pub sides: [[Vec3<f64>; 2]; 2],
    /// Unit vectors from there into the faces.
    pub into: [Vec3<f64>; 2],
    /// What they have in common.
    pub common: Side,
    /// How far they may be apart.
    pub near: f64,
}

/// Another face at the side of one.
#[derive(Debug)]
struct Guest {
    shape: u32,
    common: Side,
    near: f64,
    /// Into the face itself and into the other one.
    into: [Vec3<f64>; 2],
}

/// Faces at sides of others, by shape and primitive of those.
#[derive(Debug, Default)]
pub(super) struct Guests(HashMap<(u32, u32), Vec<Guest>>);

/// The part of a line that two chords have in common, if it is longer than `near`. `along`: its unit direction.
pub(super) fn common(along: Vec3<f64>, a: &Chord, b: &Chord, near: f64) -> Option<Side> {
    let start = a.end_points[0];
    let span = |chord: &Chord| {
        let [x, y] = chord.end_points.map(|p| along.dot(p - start));
        [x.min(y), x.max(y)]
    };
    let (x, y) = (span(a), span(b));
    let [from, to] = [x[0].max(y[0]), x[1].min(y[1])];
    (to - from > near).then(|| [start + along * from, along * (to - from)])
}

/// What is not told of two surfaces in planes that are nearly one, if they look the same way.
pub(super) fn doubt(of: [&Flat; 2], near: f64) -> Option<Doubt> {
    let [x, y] = of;
    if let (Some(a), Some(b)) = (x.chord(y, near), y.chord(x, near)) {
        let through = a.sides == [true; 2] && b.sides == [true; 2];
        let along = x.normal.cross(y.normal).normalize();
        return (through && common(along, &a, &b, near).is_some()).then_some(Doubt::Grazing);
    }
    lie_on_each_other(of, near).then_some(Doubt::Twice)
}

/// Whether two polygons have more than their borders in common, in one plane.
pub(super) fn lie_on_each_other([x, y]: [&Flat; 2], near: f64) -> bool {
    let (FlatKind::Polygon(a), FlatKind::Polygon(b)) = (&x.kind, &y.kind) else {
        return false;
    };
    let on = |flat: &Flat, corners: &[Vec3<f64>]| {
        let height = |p: &Vec3<f64>| flat.normal.dot(*p - flat.point()).abs();
        corners.iter().all(|p| height(p) <= near)
    };
    on(x, b) && on(y, a) && overlap(x.normal, a, b, near)
}

/// Whether convex polygons in one plane have more than their borders in common.
fn overlap(normal: Vec3<f64>, a: &[Vec3<f64>], b: &[Vec3<f64>], near: f64) -> bool {
    let apart = |corners: &[Vec3<f64>], k: usize| {
        let across = normal.cross(corners[(k + 1) % corners.len()] - corners[k]);
        let across = across.normalize();
        let range = |corners: &[Vec3<f64>]| {
            let at = corners.iter().map(|&p| across.dot(p));
            at.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| {
                [low.min(x), high.max(x)]
            })
        };
        let ([low, high], [low2, high2]) = (range(a), range(b));
        high.min(high2) - low.max(low2) <= 2.0 * near
    };
    !(0..a.len()).any(|k| apart(a, k)) && !(0..b.len()).any(|k| apart(b, k))
}

impl Touch {
    /// What all pairs of faces at the same two sides have in common.
    fn key(&self) -> ([u32; 2], [[[u64; 3]; 2]; 2]) {
        let bits = |p: Vec3<f64>| p.to_array().map(f64::to_bits);
        let side = |[a, b]: [Vec3<f64>; 2]| {
            let [a, b] = [bits(a), bits(b)];
            [a.min(b), a.max(b)]
        };
        (self.parts.map(|part| part.shape), self.sides.map(side))
    }

    /// The angles between a face of the first shape and both of this pair, around an axis along the side.
    fn turns(&self, axis: Vec3<f64>, first: Vec3<f64>) -> [f64; 2] {
        let second = axis.cross(first);
        let turn = |m: Vec3<f64>| second.dot(m).atan2(first.dot(m)).rem_euclid(TAU);
        self.into.map(turn)
    }
}

/// Shapes that cross in a side of both: of the faces there, those of one are on different sides of those of the other.
pub(super) fn four_sides(touches: &mut [Touch]) -> Vec<[u32; 2]> {
    touches.sort_by_cached_key(Touch::key);
    let crosses = |group: &[Touch]| {
        // Pairs have the side in either direction.
        let (axis, first) = (group[0].common[1].normalize(), group[0].into[0]);
        let turns = group.iter().map(|touch| touch.turns(axis, first));
        let turns: Vec<[f64; 2]> = turns.collect();
        let within = |x: f64, [from, to]: [f64; 2]| from + LEAST_SINE < x && x < to - LEAST_SINE;
        turns.iter().any(|&[own, _]| {
            let other = |range| turns.iter().any(|&[_, other]| within(other, range));
            other([0.0, own]) && other([own, TAU])
        })
    };
    let groups = touches.chunk_by(|a, b| a.key() == b.key());
    let pair = |group: &[Touch]| group[0].parts.map(|part| part.shape);
    groups.filter(|group| crosses(group)).map(pair).collect()
}

impl Guests {
    pub fn of(touches: &[Touch]) -> Self {
        let mut all = Self::default();
        for touch in touches {
            for k in [0, 1] {
                let LineSide { shape, locals } = touch.parts[k];
                let guest = Guest {
                    shape: touch.parts[1 - k].shape,
                    common: touch.common,
                    near: touch.near,
                    into: [touch.into[k], touch.into[1 - k]],
                };
                all.0.entry((shape, locals[0])).or_default().push(guest);
            }
        }
        all
    }

    /// Those of a face at a point of its sides.
    fn at(&self, local: u32, point: &EdgePoint) -> impl Iterator<Item = &Guest> {
        let all = self.0.get(&(point.shape, local));
        let p = point.p;
        all.into_iter()
            .flatten()
            .filter(move |guest| guest.holds(p))
    }

    /// Whether a face of another shape, whose side is in the same place, is in front of one of these two at a point of the
    /// side that they have in common.
    pub fn cover(&self, faces: [u32; 2], point: &EdgePoint) -> bool {
        let covers = |guest: &Guest| {
            let [own, other] = guest.into.map(|m| point.normal.dot(m));
            // What is in front rises less behind the side.
            let [rise, rise_of_other] = guest.into.map(|m| point.direction.dot(m));
            own * other > 0.0 && rise_of_other * own.abs() < rise * other.abs()
        };
        let mut guests = faces.into_iter().flat_map(|local| self.at(local, point));
        guests.any(covers)
    }

    /// Whether a shape has a face behind this one that ends at a point of its outline, too.
    pub fn behind(&self, local: u32, point: &EdgePoint, shape: u32) -> bool {
        let behind = |guest: &Guest| guest.shape == shape && point.normal.dot(guest.into[1]) < 0.0;
        self.at(local, point).any(behind)
    }
}

impl Guest {
    fn holds(&self, p: Vec3<f64>) -> bool {
        let [start, along] = self.common;
        let to = p - start;
        let part = to.dot(along) / along.length_squared();
        (0.0..=1.0).contains(&part) && (to - along * part).length() <= self.near
    }
}
