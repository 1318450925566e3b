//! A field of velocities of directions that is that of outlines on them, where they are known in closed form: those of
//! spheres and of flat faces.
//!
//! The field is a mean of the velocities of [`Anchor`]s, which are points of material: what the direction meets, with the
//! weight one, and for each outline a point on it or beside it, with a weight that grows without bound towards the outline
//! and vanishes far from it. On an outline it has the velocity of that, whatever else is near. Creases are outlines here, as
//! what is seen jumps there, too; those that something hides are followed as well, which is not needed and does no harm.
//!
//! Everything is a function of the direction in closed form, and so is the divergence: nothing is traced, and no limit is
//! left. Where two outlines cross, the field has no limit, and its divergence goes with one over the distance from there:
//! it can be integrated, with a variance that grows slowly with the number of samples.
//!
//! All shapes move as a whole, so that the velocity of a point is affine in the point: how it changes along a surface or an
//! outline is a difference of two velocities.

use ad_core::Vec3;
use smallvec::SmallVec;

use super::field::Influence;
use crate::edges::Edges;
use crate::math::Frame;

/// Outlines within this angle of a direction are followed, radians. On the film it is at most half of its width, beyond which
/// nothing is seen.
pub const REACH: f64 = 0.3;
/// A part of the square of the reach that is next to nothing: on the outline itself.
const LEAST: f64 = 1e-18;
/// Planes through a point of view that are as near to that of its surface as this, as one less the cosine, are its
/// horizon, where it scatters nothing.
const HORIZON: f64 = 1e-9;
/// Balls are followed from points of view at more than this part of the radius from their surface.
const AWAY: f64 = 1e-5;

/// A point of material that the field follows.
#[derive(Clone, Copy, Debug)]
pub struct Anchor {
    /// The shape, and one of its primitives.
    pub shape: u32,
    pub local: u32,
    /// World space.
    pub p: Vec3<f64>,
    /// One over its distance.
    near: f64,
    /// How the point slides as the direction turns by one along each axis across it; and the logarithm of its distance.
    slides: [Vec3<f64>; 2],
    grows: [f64; 2],
    /// Its weight, and the gradient of that.
    weight: f64,
    slope: Vec3<f64>,
}

/// A point of material, and what its velocity does to the field and to its divergence; the velocity is not divided by the
/// distance, and not projected.
pub type Pull = (Vec3<f64>, Influence);

impl Anchor {
    /// What a ray from `o` along the axis of `frame` meets, on a surface with this normal.
    pub fn met(
        (shape, local): (u32, u32),
        frame: &Frame<f64>,
        o: Vec3<f64>,
        p: Vec3<f64>,
        normal: Vec3<f64>,
    ) -> Self {
        let w = frame.n;
        let distance = (p - o).length();
        let facing = normal.dot(w);
        let tilt = [frame.s, frame.t].map(|e| {
            let tilt = normal.dot(e) / facing;
            // Seen from the side, outlines count alone.
            if tilt.is_finite() { tilt } else { 0.0 }
        });
        let slide = |e: Vec3<f64>, tilt: f64| (e - w * tilt) * distance;
        Self {
            shape,
            local,
            p,
            near: distance.recip(),
            slides: [slide(frame.s, tilt[0]), slide(frame.t, tilt[1])],
            grows: tilt.map(|t| -t),
            weight: 1.0,
            slope: Vec3::zero(),
        }
    }

    /// With the weight of an outline at `nearest`, a unit vector, in directions of which the square of the reach is given.
    fn beside(mut self, w: Vec3<f64>, nearest: Vec3<f64>, reach2: f64) -> Option<Self> {
        // Twice one less the cosine, without losing digits.
        let away = (w - nearest).length_squared().max(LEAST * reach2);
        let ratio = reach2 / away;
        if ratio <= 1.0 {
            return None;
        }
        let (rest, back) = (ratio - 1.0, nearest - w * w.dot(nearest));
        self.weight = rest.powi(3);
        self.slope = back * (6.0 * rest * rest * ratio / away);
        Some(self)
    }

    /// The nearest point of a straight outline.
    fn side(
        (shape, local): (u32, u32),
        frame: &Frame<f64>,
        o: Vec3<f64>,
        end_points: [Vec3<f64>; 2],
        (reach, horizon): (f64, Option<Vec3<f64>>),
    ) -> Option<Self> {
        let w = frame.n;
        let [a, b] = end_points.map(|p| p - o);
        let plane = a.cross(b);
        let size = plane.length();
        if !(size > 0.0 && size.is_finite()) {
            return None;
        }
        let plane = plane * size.recip();
        if horizon.is_some_and(|n| 1.0 - plane.dot(n).abs() < HORIZON) {
            return None;
        }
        let height = plane.dot(w);
        if height * height > reach * reach {
            return None;
        }
        let foot = w - plane * height;
        let along = b - a;
        let inside = a.cross(foot).dot(plane) > 0.0 && foot.cross(b).dot(plane) > 0.0;
        let (at, slides) = if inside {
            let length = foot.length();
            let nearest = foot * length.recip();
            let forward = plane.cross(nearest);
            let rate = along.dot(forward);
            let part = -a.dot(forward) / rate;
            let at = a + along * part;
            let slide = |e: Vec3<f64>| along * (at.length() * forward.dot(e) / (length * rate));
            (at, [slide(frame.s), slide(frame.t)])
        } else {
            let first = a.normalize().dot(w) > b.normalize().dot(w);
            (if first { a } else { b }, [Vec3::zero(); 2])
        };
        let distance = at.length();
        let anchor = Self {
            shape,
            local,
            p: o + at,
            near: distance.recip(),
            slides,
            grows: slides.map(|s| s.dot(at) / (distance * distance)),
            weight: 0.0,
            slope: Vec3::zero(),
        };
        anchor.beside(w, at * distance.recip(), reach * reach)
    }

    /// A point of the plane of a ball's outline.
    fn ball(
        shape: u32,
        frame: &Frame<f64>,
        o: Vec3<f64>,
        (centre, radius): (Vec3<f64>, f64),
        reach: f64,
    ) -> Option<Self> {
        let w = frame.n;
        let to = centre - o;
        let distance = to.length();
        if distance <= radius * (1.0 + AWAY) {
            return None;
        }
        let axis = to * distance.recip();
        let sin = radius / distance;
        let cos = ((1.0 - sin) * (1.0 + sin)).sqrt();
        // Directions along the plane do not meet it.
        let reach = reach.min(0.5 * cos.asin());
        let facing = axis.dot(w);
        let across = w - axis * facing;
        let out = across.length();
        let out = if out > 0.0 {
            across * out.recip()
        } else {
            frame.s
        };
        let depth = distance * cos * cos / facing;
        if !(depth > 0.0 && depth.is_finite()) {
            return None;
        }
        let tilt = [frame.s, frame.t].map(|e| axis.dot(e) / facing);
        let slide = |e: Vec3<f64>, tilt: f64| (e - w * tilt) * depth;
        let anchor = Self {
            shape,
            local: 0,
            p: o + w * depth,
            near: depth.recip(),
            slides: [slide(frame.s, tilt[0]), slide(frame.t, tilt[1])],
            grows: tilt.map(|t| -t),
            weight: 0.0,
            slope: Vec3::zero(),
        };
        anchor.beside(w, axis * cos + out * sin, reach * reach)
    }

    /// Those near the direction `frame.n` from `o`, up to an angle of `reach`: of straight outlines and of balls. `horizon` is
    /// the normal of the surface around `o`.
    pub fn of_outlines(
        edges: &Edges,
        frame: &Frame<f64>,
        o: Vec3<f64>,
        (reach, horizon): (f64, Option<Vec3<f64>>),
    ) -> SmallVec<[Self; 8]> {
        let straight = edges.straight_jumps(o);
        let sides = straight.filter_map(|(shape, local, end_points)| {
            Self::side((shape, local), frame, o, end_points, (reach, horizon))
        });
        let balls = edges.balls();
        let balls = balls.filter_map(|(shape, centre, radius)| {
            Self::ball(shape, frame, o, (centre, radius), reach)
        });
        sides.chain(balls).collect()
    }

    /// Calls `each` with what the anchor's shape does to the field, given all weights and the gradient of their sum: at its
    /// point, and, if the shape moves, beside it.
    pub fn pulls(
        &self,
        frame: &Frame<f64>,
        (total, slope): (f64, Vec3<f64>),
        moves: bool,
        mut each: impl FnMut(Pull),
    ) {
        let share = self.weight / total;
        let changes = self.slope * total.recip() - slope * (share / total);
        let part = share * self.near;
        let mut divergence = changes * self.near - frame.n * (2.0 * part);
        for (k, e) in [frame.s, frame.t].into_iter().enumerate() {
            divergence -= e * (part * self.grows[k]);
            if moves {
                divergence -= e * part;
                let beside = Influence {
                    share: 0.0,
                    divergence: e * part,
                };
                each((self.p + self.slides[k], beside));
            }
        }
        let own = Influence {
            share: part,
            divergence,
        };
        each((self.p, own));
    }
}

/// The sum of the weights of anchors, and its gradient. Without a point that is met, what is far away and stays counts one.
pub fn total(anchors: &[Anchor], met: Option<&Anchor>) -> (f64, Vec3<f64>) {
    let of_met = met.map_or(1.0, |m| m.weight);
    let weights = anchors.iter().map(|a| a.weight).sum::<f64>();
    let slope = (anchors.iter()).fold(Vec3::zero(), |sum, a| sum + a.slope);
    (of_met + weights, slope)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{AnyShape, Patch, Rectangle, Sphere};

    /// A ball before a rectangle before a wall.
    fn scene() -> Vec<AnyShape> {
        let patch = |corner, e1, e2| Patch::new(corner, e1, e2, false).unwrap();
        let small = patch([-0.3, -0.4, 2.0], [0.7, 0.0, 0.1], [0.1, 0.6, 0.0]);
        vec![
            Sphere::new([0.3, 0.1, 1.6], 0.25, false).unwrap().into(),
            Rectangle(small).into(),
        ]
    }

    /// Affine velocities of the shapes, of a wall at z = 3, and the velocity of the point of view.
    fn velocity(shape: u32, p: Vec3<f64>) -> Vec3<f64> {
        match shape {
            0 => Vec3::new(0.4 + 0.5 * p.x, -0.3 + 0.5 * p.y, 0.2 + 0.5 * p.z),
            1 => Vec3::new(0.1 - 0.7 * p.y, 0.7 * p.x, -0.2),
            _ => Vec3::new(0.2, 0.3, 0.1) + Vec3::new(p.y, 0.0, p.x) * 0.3,
        }
    }

    const DRIFT: [f64; 3] = [0.1, 0.05, -0.2];

    /// The field and its divergence.
    fn field(edges: &Edges, w: Vec3<f64>) -> (Vec3<f64>, f64) {
        let o = Vec3::new(0.02, -0.01, 0.03);
        let frame = Frame::from_normal(w);
        let anchors = Anchor::of_outlines(edges, &frame, o, (REACH, None));
        let met = o + w * ((3.0 - o.z) / w.z);
        let met = Anchor::met((2, 0), &frame, o, met, Vec3::new(0.0, 0.0, -1.0));
        let sum = total(&anchors, Some(&met));
        let (mut v, mut divergence) = (Vec3::zero(), 0.0);
        for anchor in anchors.iter().chain([&met]) {
            anchor.pulls(&frame, sum, true, |(p, influence)| {
                let y = velocity(anchor.shape, p) - Vec3::from(DRIFT);
                v += y * influence.share;
                divergence += influence.divergence.dot(y);
            });
        }
        (v - w * w.dot(v), divergence)
    }

    #[test]
    fn the_divergence_is_that_of_the_field() {
        let edges = Edges::of(&scene());
        let mut seen = 0;
        for i in 0..400 {
            let [x, y] = [0.618, 0.755].map(|step: f64| (f64::from(i) * step).fract() - 0.5);
            let w = Vec3::new(0.8 * x + 0.1, 0.8 * y, 1.0).normalize();
            let frame = Frame::from_normal(w);
            let o = Vec3::new(0.02, -0.01, 0.03);
            let anchors = Anchor::of_outlines(&edges, &frame, o, (REACH, None));
            seen += usize::from(!anchors.is_empty());
            let h = 1e-6;
            let along = |e: Vec3<f64>| {
                let at = |h: f64| field(&edges, (w + e * h).normalize()).0.dot(e);
                (at(h) - at(-h)) / (2.0 * h)
            };
            // The second derivative of a geodesic is along `w`, which the field has no part of.
            let expected = along(frame.s) + along(frame.t);
            let found = field(&edges, w).1;
            let scale = expected.abs().max(1.0);
            assert!(
                (found - expected).abs() < 1e-4 * scale,
                "{i}: {found} {expected}"
            );
        }
        assert!(seen > 100);
    }

    #[test]
    fn outlines_have_their_velocity() {
        let edges = Edges::of(&scene());
        let o = Vec3::new(0.02, -0.01, 0.03);
        let near = |p: Vec3<f64>| {
            let v = velocity(1, p) - Vec3::from(DRIFT);
            let (to, distance) = ((p - o).normalize(), (p - o).length());
            (to, (v - to * to.dot(v)) * distance.recip())
        };
        for (.., [a, b]) in edges.straight_jumps(o) {
            for part in [0.1, 0.5, 0.8] {
                let (w, expected) = near(a + (b - a) * part);
                let found = field(&edges, w).0;
                assert!((found - expected).length() < 1e-9, "{found:?} {expected:?}");
            }
        }
        // Of a ball, across its outline.
        for (_, centre, radius) in edges.balls() {
            let axis = (centre - o).normalize();
            let sin = radius / (centre - o).length();
            let frame = Frame::from_normal(axis);
            for turn in [0.3f64, 2.0, 4.0] {
                let out = frame.s * turn.cos() + frame.t * turn.sin();
                let cos = (1.0 - sin * sin).sqrt();
                let (w, across) = (axis * cos + out * sin, out * cos - axis * sin);
                let p = o + w * ((centre - o).length() * cos);
                let y = velocity(0, p) - Vec3::from(DRIFT);
                let expected = y.dot(across) / (p - o).length();
                let found = field(&edges, w).0.dot(across);
                assert!((found - expected).abs() < 1e-9, "{found} {expected}");
            }
        }
    }
}
