//! Directional distributions: nodes on the projected hemisphere, interpolated bilinearly.
//!
//! A direction above the surface is a point of the unit disk, its projection, and the disk is mapped
//! to the square without distortion of area [Shirley and Chiu 1997]. Cells of the square have equal
//! projected solid angle, the measure in which reflection is symmetric, so the matrix of a reciprocal
//! material is symmetric without weights. Outgoing radiance and outgoing importance are continuous in
//! direction [Christensen et al. 1993, section 4]: hat functions on a grid follow a lobe with second
//! order, where constant bins are of first, and touch four numbers per link where spherical harmonics of
//! the same sharpness touch all.

use std::f64::consts::FRAC_PI_4;

use ad_core::{Vec2, Vec3};

use crate::math::warp;

/// Up to four nodes and their weights, which sum to one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stencil {
    /// Nodes of the element; unused entries have weight zero.
    pub index: [u16; 4],
    /// Bilinear weights.
    pub weight: [f32; 4],
}

impl Stencil {
    /// The only node of an element without directions.
    pub const SINGLE: Self = Self {
        index: [0; 4],
        weight: [1.0, 0.0, 0.0, 0.0],
    };

    /// The interpolated value of a distribution.
    #[inline]
    pub fn read(&self, values: &[[f64; 3]]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (i, w) in self.index.iter().zip(self.weight) {
            if w != 0.0 {
                let v = values[usize::from(*i)];
                for c in 0..3 {
                    sum[c] += f64::from(w) * v[c];
                }
            }
        }
        sum
    }

    /// Adds what arrives from the direction: the transpose of [`Stencil::read`].
    #[inline]
    pub fn add(&self, values: &mut [[f64; 3]], amount: [f64; 3]) {
        for (i, w) in self.index.iter().zip(self.weight) {
            if w != 0.0 {
                let v = &mut values[usize::from(*i)];
                for c in 0..3 {
                    v[c] += f64::from(w) * amount[c];
                }
            }
        }
    }
}

/// The directions that an extended element is seen in: nodes and weights that sum to one; none stand for
/// the only node of an element without directions. With one direction instead, large glossy elements
/// would reflect everything at the peaks of their lobes, and light would grow from bounce to bounce.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Spread(Box<[(u16, f32)]>);

impl Spread {
    /// The mean of stencils with these weights.
    pub fn mean(stencils: &[(Stencil, f64)]) -> Self {
        let total: f64 = stencils.iter().map(|s| s.1).sum();
        let mut entries: Vec<(u16, f64)> = Vec::with_capacity(4 * stencils.len());
        for (s, weight) in stencils {
            for (i, w) in s.index.iter().zip(s.weight) {
                if w != 0.0 && *weight != 0.0 {
                    entries.push((*i, f64::from(w) * weight / total));
                }
            }
        }
        // Stable: equal nodes are summed in the order given.
        entries.sort_by_key(|e| e.0);
        let mut merged: Vec<(u16, f32)> = Vec::new();
        let mut sum = 0.0;
        for (k, (i, w)) in entries.iter().enumerate() {
            sum += w;
            if entries.get(k + 1).is_none_or(|next| next.0 != *i) {
                merged.push((*i, sum as f32));
                sum = 0.0;
            }
        }
        Self(merged.into())
    }

    /// The mean of a distribution over the directions.
    #[inline]
    pub fn read(&self, values: &[[f64; 3]]) -> [f64; 3] {
        if self.0.is_empty() {
            return values[0];
        }
        let mut sum = [0.0; 3];
        for &(i, w) in &self.0 {
            let v = values[usize::from(i)];
            for c in 0..3 {
                sum[c] += f64::from(w) * v[c];
            }
        }
        sum
    }

    /// Adds what arrives from the directions: the transpose of [`Spread::read`].
    #[inline]
    pub fn add(&self, values: &mut [[f64; 3]], amount: [f64; 3]) {
        let one = [(0, 1.0)];
        let entries = if self.0.is_empty() { &one } else { &self.0[..] };
        for &(i, w) in entries {
            let v = &mut values[usize::from(i)];
            for c in 0..3 {
                v[c] += f64::from(w) * amount[c];
            }
        }
    }

    /// The node with the largest weight.
    pub fn nearest(&self) -> usize {
        let best = self
            .0
            .iter()
            .fold((0, 0.0), |b, e| if e.1 > b.1 { *e } else { b });
        usize::from(best.0)
    }

    /// Bytes on the heap.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.0[..])
    }
}

/// A grid of `side * side` directions; a side of 1 is a constant, for diffuse surfaces and lamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Directions {
    /// Nodes along one side of the square.
    pub side: usize,
}

impl Directions {
    /// Number of nodes.
    pub fn len(self) -> usize {
        self.side * self.side
    }

    /// Whether there are no nodes; never for a grid in use.
    pub fn is_empty(self) -> bool {
        self.side == 0
    }

    /// The direction of a node: local, unit length, above the horizon.
    pub fn node(self, i: usize) -> Vec3<f64> {
        if self.side == 1 {
            return Vec3::new(0.0, 0.0, 1.0);
        }
        let at = |k: usize| (k as f64 + 0.5) / self.side as f64;
        let p = warp::square_to_disk([at(i % self.side), at(i / self.side)]);
        let z = (1.0 - p.x * p.x - p.y * p.y).max(0.0).sqrt();
        Vec3::new(p.x, p.y, z)
    }

    /// The stencil of a local direction; the sign of its z does not matter.
    pub fn stencil(self, w: Vec3<f64>) -> Stencil {
        if self.side == 1 {
            return Stencil::SINGLE;
        }
        let n = self.side;
        let q = disk_to_square(Vec2::new(w.x, w.y));
        let split = |t: f64| {
            let t = (t * n as f64 - 0.5).clamp(0.0, n as f64 - 1.0);
            let i = (t as usize).min(n - 2);
            (i, (t - i as f64) as f32)
        };
        let ((i, a), (j, b)) = (split(q.x), split(q.y));
        let at = |i: usize, j: usize| (j * n + i) as u16;
        Stencil {
            index: [at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)],
            weight: [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b],
        }
    }
}

/// The inverse of [`warp::square_to_disk`].
fn disk_to_square(p: Vec2<f64>) -> Vec2<f64> {
    let r = p.x.hypot(p.y);
    if r == 0.0 {
        return Vec2::new(0.5, 0.5);
    }
    let (a, b) = if p.x.abs() > p.y.abs() {
        let a = r.copysign(p.x);
        (a, a * (p.y / p.x).atan() / FRAC_PI_4)
    } else {
        let b = r.copysign(p.y);
        (b * (p.x / p.y).atan() / FRAC_PI_4, b)
    };
    Vec2::new(0.5 * (a + 1.0), 0.5 * (b + 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_is_its_own_stencil_and_neighbours_blend() {
        let d = Directions { side: 12 };
        for i in 0..d.len() {
            let s = d.stencil(d.node(i));
            let own: f32 = (0..4)
                .filter(|&k| usize::from(s.index[k]) == i)
                .map(|k| s.weight[k])
                .sum();
            assert!((own - 1.0).abs() < 1e-5, "node {i}: {own}");
        }
        // A smooth function is interpolated with second order.
        let f = |w: Vec3<f64>| w.x * 0.7 - w.y * 0.3 + w.x * w.y;
        let worst = |side| {
            let d = Directions { side };
            let values: Vec<[f64; 3]> = (0..d.len()).map(|i| [f(d.node(i)); 3]).collect();
            let mut worst: f64 = 0.0;
            for k in 0..500 {
                let u = [k as f64 / 500.0, (k as f64 * 0.618).fract()];
                let p = warp::square_to_disk([0.1 + 0.8 * u[0], 0.1 + 0.8 * u[1]]);
                let w = Vec3::new(p.x, p.y, (1.0 - p.x * p.x - p.y * p.y).sqrt());
                worst = worst.max((d.stencil(w).read(&values)[0] - f(w)).abs());
            }
            worst
        };
        let (coarse, fine) = (worst(8), worst(32));
        assert!(fine < 0.02 && fine < 0.35 * coarse, "{coarse} {fine}");
    }
}
