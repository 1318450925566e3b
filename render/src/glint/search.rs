//! Which cell of a map is searched for glints: drawn down the pyramid of moments, by how well its slopes fit the half vector.

use ad_core::{Float, Vec2};

use super::footprint::HalfVectors;
use super::map::SlopeMap;
use crate::params::Theta;
use crate::sampler::{Independent, Sampler};
use crate::texture::Wrap;

/// The part of every choice that goes by area alone: where moments mislead, cells have their turn all the same.
const BY_AREA: f64 = 0.1;

/// Which child is taken.
pub(super) enum Pick<'a> {
    /// A random one.
    Random(&'a mut Independent),
    /// The one with this cell.
    Of([i64; 2]),
}

/// A rectangle of cells of a level within a copy of the map.
#[derive(Clone, Copy, Default)]
struct Child {
    at: [usize; 2],
    area: f64,
    fit: f64,
}

/// A copy of the map along one axis: the first texel of the one that is chosen, and its probability. What lies beyond the ends
/// of a map that does not repeat is a copy, too, whose cells are all those of its border.
fn copy(bounds: [f64; 2], n: usize, pick: &mut Pick, axis: usize) -> Option<(i64, f64)> {
    let n = n as i64;
    let [from, to] = bounds;
    let place = match pick {
        Pick::Random(rng) => from + (to - from) * rng.next_1d::<f64>(),
        Pick::Of(cell) => cell[axis] as f64,
    };
    let first = (place.floor() as i64).div_euclid(n) * n;
    let overlap = (to.min((first + n) as f64) - from.max(first as f64)).max(0.0);
    let p = overlap / (to - from);
    (p > 0.0).then_some((first, p))
}

impl SlopeMap {
    /// A cell that meets the footprint, and its probability. `None` if none of those that were looked at can have a solution,
    /// or the one that is asked for cannot be drawn.
    pub(super) fn choose<P: Float>(
        &self,
        theta: &Theta<P>,
        halves: &HalfVectors,
        mut pick: Pick,
    ) -> Option<([i64; 2], f64)> {
        let (middle, half) = halves.bounds();
        let bounds = [0, 1].map(|k: usize| {
            let [m, h] = [middle.to_array()[k], half[k].max(1e-9)];
            [m - h, m + h]
        });
        let size = self.size();
        let (x, p_x) = copy(bounds[0], size[0], &mut pick, 0)?;
        let (y, p_y) = copy(bounds[1], size[1], &mut pick, 1)?;
        let first = [x, y];
        let mut p = p_x * p_y;
        let mut at = [0usize; 2];
        for k in (0..self.height()).rev() {
            let nodes = self.nodes(k);
            let mut children = [Child::default(); 4];
            for (c, child) in children.iter_mut().enumerate() {
                child.at = [2 * at[0] + (c & 1), 2 * at[1] + (c >> 1)];
                if child.at[0] < nodes[0] && child.at[1] < nodes[1] {
                    child.area = self.overlap(halves, bounds, first, k, child.at);
                }
            }
            let several = children.iter().filter(|c| c.area > 0.0).count() > 1;
            if several || k == 0 {
                for child in children.iter_mut().filter(|c| c.area > 0.0) {
                    match self.fit(theta, halves, first, k, child) {
                        Some(fit) => child.fit = fit * child.area,
                        None => child.area = 0.0,
                    }
                }
            }
            let (chosen, of) = take(&children, k, first, &mut pick)?;
            at = chosen;
            p *= of;
        }
        let cell = [first[0] + at[0] as i64, first[1] + at[1] as i64];
        Some((cell, p))
    }

    /// Rectangle of a node of a copy, in texel coordinates: middle and half extents.
    fn rectangle(&self, first: [i64; 2], k: usize, at: [usize; 2]) -> (Vec2<f64>, [f64; 2]) {
        let size = self.size();
        let side = |axis: usize| {
            let from = at[axis] << k;
            let to = (from + (1 << k)).min(size[axis]);
            let first = first[axis] as f64;
            (first + 0.5 * (from + to) as f64, 0.5 * (to - from) as f64)
        };
        let ((x, half_x), (y, half_y)) = (side(0), side(1));
        (Vec2::new(x, y), [half_x, half_y])
    }

    /// Area of a node within the bounds of the footprint, if it meets that.
    fn overlap(
        &self,
        halves: &HalfVectors,
        bounds: [[f64; 2]; 2],
        first: [i64; 2],
        k: usize,
        at: [usize; 2],
    ) -> f64 {
        let (middle, half) = self.rectangle(first, k, at);
        if !halves.meets(middle, half) {
            return 0.0;
        }
        let side = |axis: usize| {
            let m = middle.to_array()[axis];
            ((m + half[axis]).min(bounds[axis][1]) - (m - half[axis]).max(bounds[axis][0])).max(0.0)
        };
        side(0) * side(1)
    }

    /// How well the slopes of a node fit; `None` for cells in which none can.
    fn fit<P: Float>(
        &self,
        theta: &Theta<P>,
        halves: &HalfVectors,
        first: [i64; 2],
        k: usize,
        child: &Child,
    ) -> Option<f64> {
        let (middle, half) = self.rectangle(first, k, child.at);
        let content = if k == 0 {
            let cell = [0, 1].map(|axis: usize| first[axis] + child.at[axis] as i64);
            if self.patch(theta, cell).excludes(halves, cell) {
                return None;
            }
            cell
        } else {
            self.content(first, k, child.at)
        };
        let variance = half.map(|h| h * h / 3.0);
        let own = self.node(theta, k, content);
        let spread = own.spread(&halves.half_per_texel, variance);
        let fit = spread.tailed(halves.half(middle));
        Some(if fit.is_finite() { fit } else { 0.0 })
    }

    /// The node whose moments a node of a copy has: mirrored copies have it elsewhere, the border goes on.
    fn content(&self, first: [i64; 2], k: usize, at: [usize; 2]) -> [i64; 2] {
        let nodes = self.nodes(k);
        let size = self.size();
        [0, 1].map(|axis: usize| {
            let copy = first[axis].div_euclid(size[axis] as i64);
            let (at, n) = (at[axis] as i64, nodes[axis] as i64);
            match self.wrap() {
                Wrap::Repeat => at,
                Wrap::Mirror if copy.rem_euclid(2) == 1 => n - 1 - at,
                Wrap::Mirror => at,
                Wrap::Clamp => (at + copy.signum() * n).clamp(0, n - 1),
            }
        })
    }
}

/// The child that is taken, and its probability.
fn take(
    children: &[Child; 4],
    k: usize,
    first: [i64; 2],
    pick: &mut Pick,
) -> Option<([usize; 2], f64)> {
    let area: f64 = children.iter().map(|c| c.area).sum();
    let fits: f64 = children.iter().map(|c| c.fit).sum();
    let any = area > 0.0;
    if !any {
        return None;
    }
    let probability = |c: &Child| {
        let by_area = c.area / area;
        if fits > 0.0 && fits.is_finite() {
            BY_AREA * by_area + (1.0 - BY_AREA) * (c.fit / fits)
        } else {
            by_area
        }
    };
    let chosen = match pick {
        Pick::Of(cell) => children
            .iter()
            .find(|c| (0..2).all(|axis| (cell[axis] - first[axis]) >> k == c.at[axis] as i64))?,
        Pick::Random(rng) => {
            let some = children.iter().filter(|c| c.area > 0.0);
            if some.clone().count() == 1 {
                some.clone().next()?
            } else {
                let mut u = rng.next_1d::<f64>();
                let drawn = some.clone().find(|c| {
                    u -= probability(c);
                    u < 0.0
                });
                drawn.or_else(|| some.clone().next_back())?
            }
        }
    };
    let p = probability(chosen);
    (chosen.area > 0.0 && p > 0.0).then_some((chosen.at, p))
}
