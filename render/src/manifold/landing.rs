//! Where particles from the lights went over casters and landed: starts of walks from points nearby.

use ad_core::Vec3;
use smallvec::SmallVec;

use crate::bsdf::DeltaKind;

/// At most so many landings are neighbours.
const NEIGHBOURS: usize = 16;
/// Fewer landings than this say nothing about places.
pub(super) const FEWEST: usize = 4 * NEIGHBOURS;

/// A particle that went from a light over casters to a receiver.
#[derive(Clone, Debug)]
pub(super) struct Landing {
    /// Where it landed, world space.
    pub at: [f64; 3],
    /// The vertex of its chain next to there.
    pub through: Vec3<f64>,
    /// Shapes and events of the chain, from there on.
    pub like: SmallVec<[(u32, DeltaKind); 2]>,
}

/// Landings, in the cells of a k-d tree.
#[derive(Clone, Debug, Default)]
pub(super) struct Landings {
    /// Halved again and again, down to neighbours.
    all: Vec<Landing>,
    /// Where each part is halved: along which axis, and where; the halves of part `k` are `2 k + 1` and `2 k + 2`.
    planes: Vec<(usize, f64)>,
}

impl Landings {
    /// Of these, in any order.
    pub fn new(mut all: Vec<Landing>) -> Self {
        let mut planes = Vec::new();
        halve(&mut all, 0, &mut planes);
        Self { all, planes }
    }

    /// The cell that a point is in: neighbours, most of them.
    fn cell(&self, p: Vec3<f64>) -> &[Landing] {
        let (mut part, mut k) = (self.all.as_slice(), 0);
        while part.len() > NEIGHBOURS {
            let (below, above) = part.split_at(part.len() / 2);
            let (axis, at) = self.planes[k];
            let goes_below = p.to_array()[axis] < at;
            (part, k) = if goes_below {
                (below, 2 * k + 1)
            } else {
                (above, 2 * k + 2)
            };
        }
        part
    }

    /// The landings around a point; none where it is far from all of them.
    pub fn around(&self, p: Vec3<f64>) -> &[Landing] {
        let cell = self.cell(p);
        let (mut beside, mut across) = (0.0, 0.0);
        for (axis, p) in p.to_array().into_iter().enumerate() {
            let bounds = cell
                .iter()
                .fold([f64::INFINITY, f64::NEG_INFINITY], |b, l| {
                    [b[0].min(l.at[axis]), b[1].max(l.at[axis])]
                });
            let away = (bounds[0] - p).max(p - bounds[1]).max(0.0);
            beside += away * away;
            across += (bounds[1] - bounds[0]).powi(2);
        }
        // No further than the cell is wide; of no landings that is not true either.
        if beside <= across { cell } else { &[] }
    }
}

/// Halves a part at the median of its longest side, and its halves.
fn halve(part: &mut [Landing], k: usize, planes: &mut Vec<(usize, f64)>) {
    if part.len() <= NEIGHBOURS {
        return;
    }
    let side = |axis: usize| {
        let bounds = part
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |b, l| {
                [b[0].min(l.at[axis]), b[1].max(l.at[axis])]
            });
        bounds[1] - bounds[0]
    };
    let sides = [side(0), side(1), side(2)];
    let axis = (1..3).fold(0, |a, b| if sides[b] > sides[a] { b } else { a });
    let middle = part.len() / 2;
    let (_, at, _) = part.select_nth_unstable_by(middle, |a, b| a.at[axis].total_cmp(&b.at[axis]));
    let plane = (axis, at.at[axis]);
    if planes.len() <= k {
        planes.resize(k + 1, (0, 0.0));
    }
    planes[k] = plane;
    let (below, above) = part.split_at_mut(middle);
    halve(below, 2 * k + 1, planes);
    halve(above, 2 * k + 2, planes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{Independent, Sampler};

    fn landing(x: f64, y: f64) -> Landing {
        Landing {
            at: [x, y, 0.0],
            through: Vec3::zero(),
            like: SmallVec::new(),
        }
    }

    /// Each landing is in the cell of its own place, cells are small and together are all; where several are at one point they
    /// share cells, and nothing is found among none or far away.
    #[test]
    fn cells_hold_neighbours() {
        let of = |i: u64| {
            let mut s = Independent::new(1, 0, i);
            let [x, y] = s.next_2d::<f64>();
            landing(x, 3.0 * y)
        };
        for n in [1, NEIGHBOURS, NEIGHBOURS + 1, 1000] {
            let tree = Landings::new((0..n as u64).map(of).collect());
            for l in &tree.all {
                let cell = tree.cell(Vec3::from(l.at));
                assert!(!cell.is_empty() && cell.len() <= NEIGHBOURS);
                assert!(cell.iter().any(|c| c.at == l.at), "{n}");
            }
        }
        let same = Landings::new(vec![landing(1.0, 2.0); 100]);
        assert!(!same.around(Vec3::new(1.0, 2.0, 0.0)).is_empty());
        assert!(same.around(Vec3::new(1.0, 2.1, 0.0)).is_empty());
        assert!(Landings::default().around(Vec3::zero()).is_empty());
        let square = Landings::new((0..1000).map(of).collect());
        assert!(square.around(Vec3::new(0.5, 1.5, 0.01)).len() > 1);
        assert!(square.around(Vec3::new(0.5, 1.5, 2.0)).is_empty());
    }
}
