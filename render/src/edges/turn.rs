//! Where interpolated normals turn away from the view within a face: what is seen jumps there, since materials scatter
//! light on one side of the shading normal only, or differently on both.
//!
//! With the corners `c` and normals `n` of a triangle, both linear in barycentric coordinates, the curve is the conic
//! `n . (x - c) = 0`. It is met once or twice on every line through the corner whose sign is alone, if one is.

use ad_core::Vec3;

use super::{EdgePoint, Eye, Inside, Rim, Spot};
use crate::shape::lift3;

/// How far beside the curve a surface is looked at, as a part of the line through the corner.
const BESIDE: f64 = 1e-3;

/// A face with other normals than its own.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    pub shape: u32,
    /// Primitive of the shape.
    pub local: u32,
    pub corners: [[f32; 3]; 3],
    pub normals: [[f32; 3]; 3],
}

type Weights = [f64; 3];

impl Turn {
    fn sum(of: &[[f32; 3]; 3], weights: Weights) -> Vec3<f64> {
        (of.iter().zip(weights)).fold(Vec3::zero(), |sum, (v, w)| sum + lift3::<f64>(*v) * w)
    }

    fn facing(&self, weights: Weights, eye: &Eye) -> f64 {
        Self::sum(&self.normals, weights).dot(-eye.to(Self::sum(&self.corners, weights)))
    }

    /// The change of [`Turn::facing`] with the weights.
    fn facing_along(&self, weights: Weights, change: Weights, eye: &Eye) -> f64 {
        Self::sum(&self.normals, change).dot(-eye.to(Self::sum(&self.corners, weights)))
            - Self::sum(&self.normals, weights).dot(eye.change(Self::sum(&self.corners, change)))
    }

    /// Whether normals may turn away from an eye, or from a point that is no farther than `radius` from it: not if all
    /// coefficients of Bernstein have one sign there.
    pub fn may_turn(&self, eye: &Eye, radius: f64) -> bool {
        let corner = [0, 1, 2].map(|k| self.facing(unit(k), eye));
        let normal = self.normals.map(lift3::<f64>);
        let all = [0, 1, 2].map(|k| {
            let [a, b] = [k, (k + 1) % 3];
            let middle = self.facing(
                [0, 1, 2].map(|i| if i == a || i == b { 0.5 } else { 0.0 }),
                eye,
            );
            let of_two = 2.0 * middle - 0.5 * (corner[a] + corner[b]);
            [
                (corner[k], normal[k].length()),
                (of_two, 0.5 * (normal[a] + normal[b]).length()),
            ]
        });
        let mut all = all.iter().flatten();
        let first = corner[0] > 0.0;
        all.any(|(g, by)| (*g > 0.0) != first || g.abs() < by * radius)
    }

    /// Weights on the line with parameter `s` through the corner `apex`, at a part of it, and their changes with `s` and
    /// with the part.
    fn line(apex: usize, s: f64, part: f64) -> [Weights; 3] {
        let [j, k] = [(apex + 1) % 3, (apex + 2) % 3];
        let mut all = [[0.0; 3]; 3];
        (all[0][apex], all[0][j], all[0][k]) = (1.0 - part, part * (1.0 - s), part * s);
        (all[1][j], all[1][k]) = (-part, part);
        (all[2][apex], all[2][j], all[2][k]) = (-1.0, 1.0 - s, s);
        all
    }

    /// The point with parameter `s` on the first or second part of the curve, as an eye sees it, and what is on both sides:
    /// first towards the corner.
    pub fn rim(&self, s: f64, root: usize, eye: &Eye) -> Option<(Rim, [Inside; 2])> {
        let corner = [0, 1, 2].map(|k| self.facing(unit(k), eye) > 0.0);
        let alone =
            |k: &usize| corner[*k] != corner[(k + 1) % 3] && corner[*k] != corner[(k + 2) % 3];
        let apex = (0..3).find(alone).unwrap_or(0);
        let g = [0.0, 0.5, 1.0].map(|part| self.facing(Self::line(apex, s, part)[0], eye));
        let part = *roots(g).get(root)?;
        let [at, by_s, by_part] = Self::line(apex, s, part);
        let slope = self.facing_along(at, by_part, eye);
        let turn = -self.facing_along(at, by_s, eye) / slope;
        let across = Self::sum(&self.corners, by_part);
        let spot = |weights: Weights| Spot::At(self.local, [weights[1], weights[2]]);
        let beside = |by: f64| Inside {
            spot: spot([0, 1, 2].map(|i| at[i] + by * by_part[i])),
            p: Vec3::zero(),
            beside: None,
        };
        let rim = Rim {
            p: Self::sum(&self.corners, at),
            tangent: Self::sum(&self.corners, by_s) + across * turn,
            into: -across,
            spot: spot(at),
        };
        Some((rim, [beside(-BESIDE), beside(BESIDE)]))
    }

    /// The slope of the cosine between the view and the unit shading normal, per radian that the view turns towards the
    /// normal of a point that an eye sees, and that shading normal. Parallel rays do not turn: they move as far as that.
    /// The face has these coordinates there.
    pub fn slope(&self, [u, v]: [f64; 2], eye: &Eye, point: &EdgePoint) -> (f64, Vec3<f64>) {
        let EdgePoint {
            direction: d,
            normal,
            distance,
            ..
        } = *point;
        let [a, b, c] = self.corners.map(lift3::<f64>);
        let (e1, e2) = (b - a, c - a);
        let n = e1.cross(e2);
        let step = (normal - d * (normal.dot(n) / d.dot(n))) * distance;
        let squared = n.length_squared();
        let du = step.cross(e2).dot(n) / squared;
        let dv = e1.cross(step).dot(n) / squared;
        let shading = Self::sum(&self.normals, [1.0 - u - v, u, v]);
        let change = Self::sum(&self.normals, [-du - dv, du, dv]);
        let length = shading.length();
        let shading = shading * length.recip();
        let turns = shading.dot(eye.change(normal));
        (change.dot(d) / length + turns, shading)
    }
}

fn unit(k: usize) -> Weights {
    let mut all = [0.0; 3];
    all[k] = 1.0;
    all
}

/// Where a quadratic function on [0, 1] is zero, given its values at the ends and in the middle, in order.
fn roots([start, middle, end]: [f64; 3]) -> smallvec::SmallVec<[f64; 2]> {
    let a = 2.0 * (start + end - 2.0 * middle);
    let b = end - start - a;
    let discriminant = b * b - 4.0 * a * start;
    let mut all = smallvec::SmallVec::new();
    if discriminant.is_nan() || discriminant < 0.0 {
        return all;
    }
    // Without cancellation.
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    for root in [q / a, start / q] {
        if root > 0.0 && root < 1.0 {
            all.push(root);
        }
    }
    all.sort_by(f64::total_cmp);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Zeros are those of products, and of straight lines.
    #[test]
    fn roots_of_quadratics() {
        let of = |f: &dyn Fn(f64) -> f64| roots([0.0, 0.5, 1.0].map(f)).to_vec();
        let near = |found: Vec<f64>, known: &[f64]| {
            let close = found.iter().zip(known).all(|(a, b)| (a - b).abs() < 1e-12);
            assert!(
                found.len() == known.len() && close,
                "{found:?}, not {known:?}"
            );
        };
        near(of(&|x| (x - 0.25) * (x - 0.75)), &[0.25, 0.75]);
        near(of(&|x| (x - 0.25) * (x + 2.0)), &[0.25]);
        near(of(&|x| 0.4 - x), &[0.4]);
        near(of(&|x| x * x + 1.0), &[]);
    }

    /// The point is on the curve, and moves along its tangent; the slope is that of differences.
    #[test]
    fn curves_are_where_normals_turn() {
        let turn = Turn {
            shape: 0,
            local: 0,
            corners: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            normals: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        };
        let x = Vec3::new(4.0, 0.5, 0.2);
        let eye = Eye::point(x);
        assert!(turn.may_turn(&eye, 0.0));
        let (rim, _) = turn.rim(0.3, 0, &eye).expect("a curve");
        let later = turn.rim(0.3 + 1e-6, 0, &eye).expect("a curve").0;
        assert!(((later.p - rim.p) * 1e6 - rim.tangent).length() < 1e-4);
        // Normals are where points are.
        assert!(rim.p.dot(x - rim.p).abs() < 1e-12);
        let (point, _) = rim.seen(&eye, 0).expect("seen");
        let Spot::At(_, at) = rim.spot else {
            panic!("{:?}", rim.spot)
        };
        let (slope, n) = turn.slope(at, &eye, &point);
        assert!((n - rim.p.normalize()).length() < 1e-12);
        let step = 1e-6;
        let d = (point.direction + point.normal * step).normalize();
        let t = (1.0 - (x.x + x.y + x.z)) / (d.x + d.y + d.z);
        let found = (x + d * t).normalize().dot(d) / step;
        assert!((found - slope).abs() < 1e-4, "{found}, not {slope}");
    }
}
