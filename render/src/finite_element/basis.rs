//! Directional distributions: nodes on the hemisphere, interpolated bilinearly.
//!
//! The hemisphere is mapped to the unit disk, and that to the square, without distortion of area
//! [Shirley and Chiu 1997], so cells have equal solid angle. (Equal *projected* solid angle leaves the last 17 degrees
//! above the horizon to the outermost of 24 rings: at grazing angles it was 13 % off.) Outgoing radiance and
//! outgoing importance are continuous in direction [Christensen et al. 1993, section 4]: hat functions on a grid follow
//! a lobe with second order, where constant bins are of first, and touch four numbers per direction where spherical
//! harmonics of the same sharpness touch all.

use std::f64::consts::{FRAC_PI_4, PI, TAU};

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
        let r2 = p.x * p.x + p.y * p.y;
        let scale = (2.0 - r2).sqrt();
        Vec3::new(p.x * scale, p.y * scale, 1.0 - r2)
    }

    /// Projected solid angle of the cell of a node.
    pub fn cell(self, i: usize) -> f64 {
        if self.side == 1 {
            PI
        } else {
            TAU / self.len() as f64 * self.node(i).z
        }
    }

    /// The stencil of a local direction; the sign of its z does not matter.
    pub fn stencil(self, w: Vec3<f64>) -> Stencil {
        if self.side == 1 {
            return Stencil::SINGLE;
        }
        let n = self.side;
        let scale = (1.0 + w.z.abs()).sqrt().recip();
        let q = disk_to_square(Vec2::new(w.x * scale, w.y * scale));
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

/// Turns values at pairs of nodes into coefficients of hat functions: less a twelfth of the second differences along
/// the four axes, so that what is interpolated between nodes has the mean of the function there, instead of less at
/// its peaks. Symmetric matrices stay symmetric, sums stay as they are.
pub(super) fn fit(nodes: usize, values: &mut [[f64; 3]]) {
    let side = nodes.isqrt();
    if side < 2 {
        return;
    }
    let mut line = vec![[0.0; 3]; side];
    for stride in [1, side, nodes, nodes * side] {
        for first in (0..nodes * nodes).filter(|i| i / stride % side == 0) {
            for (k, l) in line.iter_mut().enumerate() {
                *l = values[first + k * stride];
            }
            for k in 0..side {
                // Directions beyond the outermost nodes are given those.
                let (before, after) = (line[k.saturating_sub(1)], line[(k + 1).min(side - 1)]);
                for c in 0..3 {
                    values[first + k * stride][c] -=
                        (before[c] - 2.0 * line[k][c] + after[c]) / 12.0;
                }
            }
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

    /// Between nodes a lobe about as wide as the grid loses a fifth of its height, fitted a third of that.
    #[test]
    fn fitted_lobes_keep_their_height() {
        let d = Directions { side: 12 };
        let lobe = |a: Vec3<f64>, b: Vec3<f64>| (-8.0 * (a - b).length_squared()).exp();
        let n = d.len();
        let values = |k: usize| [lobe(d.node(k / n), d.node(k % n)); 3];
        let plain: Vec<_> = (0..n * n).map(values).collect();
        let mut fitted = plain.clone();
        fit(n, &mut fitted);
        for i in 0..n {
            for j in 0..i {
                let (a, b) = (fitted[i * n + j][0], fitted[j * n + i][0]);
                assert!((a - b).abs() < 1e-12, "{i} {j}: {a} {b}");
            }
        }
        // Mean of the lobe in its middle, over directions that are not nodes.
        let mean = |table: &[[f64; 3]]| {
            let (mut sum, mut count) = (0.0, 0.0);
            for k in 0..400 {
                let (z, phi) = (0.3 + 0.0015 * k as f64, 2.399_963 * k as f64);
                let r = (1.0 - z * z).sqrt();
                let s = d.stencil(Vec3::new(r * phi.cos(), r * phi.sin(), z));
                let column: Vec<[f64; 3]> =
                    (0..n).map(|i| s.read(&table[i * n..(i + 1) * n])).collect();
                sum += s.read(&column)[0];
                count += 1.0;
            }
            sum / count
        };
        let (plain, fitted) = (mean(&plain), mean(&fitted));
        assert!(
            (fitted - 1.0).abs() < 0.35 * (1.0 - plain),
            "{plain} {fitted}"
        );
    }

    #[test]
    fn cells_make_up_the_hemisphere() {
        for side in [1, 8, 16] {
            let d = Directions { side };
            let sum: f64 = (0..d.len()).map(|i| d.cell(i)).sum();
            // Midpoints: second order.
            assert!(
                (sum - PI).abs() < 7.0 / (side * side) as f64,
                "{side}: {sum}"
            );
        }
    }

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
