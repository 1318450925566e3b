//! Newton's method for the constraint on slopes.

use ad_core::{Float, Mat2, Vec2};

use super::footprint::HalfVectors;
use super::map::{Patch, SlopeMap, cell_of};
use crate::params::Theta;

/// Walks end where a step is below this, in texels.
const LAST_STEP: f64 = 1e-10;
/// Walks in a cell that get this far from it, in texels, are given up.
const LEASH: f64 = 4.0;

/// A solution: where in the texture the normal is the half vector.
#[derive(Clone, Copy, Debug)]
pub(super) struct Root {
    /// Texel coordinates.
    pub t: Vec2<f64>,
    /// Determinant of the constraint's derivatives in texel coordinates, its magnitude.
    pub det: f64,
    /// Within which the root lies: twice the last step, and rounding.
    pub radius: f64,
}

impl Root {
    /// Whether two walks have ended in the same root.
    pub fn is(&self, other: &Self, threshold: Option<f64>) -> bool {
        let limit = threshold.unwrap_or(self.radius + other.radius);
        (self.t - other.t).length() <= limit
    }
}

/// A step from a point: how far, and the magnitude of the determinant. `None` where it is singular.
struct Step {
    by: Vec2<f64>,
    det: f64,
    rounding: f64,
}

fn step(
    halves: &HalfVectors,
    t: Vec2<f64>,
    slope: Vec2<f64>,
    derivative: &Mat2<f64>,
) -> Option<Step> {
    let half = halves.half(t);
    let c = half - slope;
    let inverse = (halves.half_per_texel - *derivative).inverse()?;
    let by = -(inverse * c);
    let stretch = inverse.rows.iter().flatten().map(|x| x * x).sum::<f64>();
    let size = half.length() + slope.length() + 1.0;
    by.is_finite().then(|| Step {
        by,
        det: (halves.half_per_texel - *derivative).determinant().abs(),
        rounding: 8.0 * f64::EPSILON * size * stretch.sqrt() + f64::EPSILON * t.length(),
    })
}

impl Patch {
    /// Whether no normal in the cell can be the half vector: a bilinear function stays between its corners.
    pub fn excludes(&self, halves: &HalfVectors, cell: [i64; 2]) -> bool {
        if !self.slopes {
            return false;
        }
        let slopes = self.corners();
        let c = |k: usize| {
            let at = Vec2::new(
                cell[0] as f64 + (k & 1) as f64,
                cell[1] as f64 + (k >> 1) as f64,
            );
            halves.half(at) - slopes[k]
        };
        let c = [0, 1, 2, 3].map(c);
        // Rounding must not exclude a root on a side.
        let margin = 1e-9 * (1.0 + c[0].length());
        let beyond = |x: [f64; 4]| x.iter().all(|&x| x > margin) || x.iter().all(|&x| x < -margin);
        beyond(c.map(|c| c.x)) || beyond(c.map(|c| c.y))
    }

    /// A walk in a cell from `start` within it; the second value counts steps.
    pub fn walk(
        &self,
        halves: &HalfVectors,
        cell: [i64; 2],
        start: [f64; 2],
        most: u32,
    ) -> (Option<Root>, u32) {
        let corner = Vec2::new(cell[0] as f64, cell[1] as f64);
        let mut at = Vec2::new(start[0], start[1]);
        for n in 1..=most {
            let stepped = (self.slope(at.to_array()))
                .and_then(|(slope, derivative)| step(halves, corner + at, slope, &derivative));
            let Some(step) = stepped else {
                return (None, n);
            };
            at += step.by;
            if !((at.x - 0.5).abs() <= LEASH && (at.y - 0.5).abs() <= LEASH) {
                return (None, n);
            }
            if step.by.length() < LAST_STEP {
                let inside = (0.0..1.0).contains(&at.x) && (0.0..1.0).contains(&at.y);
                let root = inside.then(|| Root {
                    t: corner + at,
                    det: step.det,
                    radius: 2.0 * step.by.length() + step.rounding,
                });
                return (root, n);
            }
        }
        (None, most)
    }
}

/// A walk over the whole footprint: steps that would leave it are halved [Zeltner 2021, section 3.3.3].
pub(super) fn over_footprint<P: Float>(
    map: &SlopeMap,
    theta: &Theta<P>,
    halves: &HalfVectors,
    start: Vec2<f64>,
    most: u32,
) -> (Option<Root>, u32) {
    let (mut t, mut scale) = (start, 1.0f64);
    for n in 1..=most {
        let cell = cell_of(t);
        let local = [t.x - cell[0] as f64, t.y - cell[1] as f64];
        let stepped = (map.patch(theta, cell).slope(local))
            .and_then(|(slope, derivative)| step(halves, t, slope, &derivative));
        let Some(step) = stepped else {
            return (None, n);
        };
        if step.by.length() < LAST_STEP {
            let root = Root {
                t: t + step.by,
                det: step.det,
                radius: 2.0 * step.by.length() + step.rounding,
            };
            return (Some(root), n);
        }
        let proposed = t + step.by * scale;
        if halves.contains(proposed) {
            t = proposed;
            scale = (2.0 * scale).min(1.0);
        } else {
            scale *= 0.5;
        }
    }
    (None, most)
}
