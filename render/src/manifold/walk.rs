//! Newton's method on chains.

use ad_core::{Mat2, Vec2, Vec3};

use super::chain::{Chain, Derivative, Event, Events, Space, Start, Target, Vertex};
use super::constraint::equator;
use crate::math::Frame;
use crate::scene::Uniqueness;

/// Most steps of a walk.
const MOST_STEPS: u32 = 20;
/// A walk has converged when no component of the last constraint exceeds this, radians.
const TOLERANCE: f64 = 1e-9;
/// Further steps, which bring it to rounding.
const POLISH: u32 = 3;
/// Shortest part of a step that is tried.
const LEAST_PART: f64 = 1.0 / 64.0;
/// Rounding of constraints, and of positions relative to the first edge.
const ROUNDING: [f64; 2] = [1e-13, 1e-12];

/// A chain whose constraints all hold.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Its vertices.
    pub chain: Chain,
    /// Position of its start.
    pub start: Vec3<f64>,
    /// How its last constraint changes.
    pub derivative: Derivative,
    /// How far the first vertex may be from that of the exact root.
    pub error: f64,
}

impl Solution {
    /// Solid angle at the start per area across the last edge at the target, or per solid angle of its direction: the
    /// generalised geometric term without the cosine of the start, by the determinant over orthonormal tangents, where the
    /// elements of area that (3.9) lacks are one.
    ///
    /// It is anchored at the start: radiance is scaled by squared indices, as [`crate::bsdf::TransportMode::Radiance`] does.
    ///
    /// # Source
    /// [Zeltner 2021, Eq. 3.9] with errata Z-3.9.
    pub fn angle_per_target(&self) -> f64 {
        let Derivative { first, target, .. } = self.derivative;
        let si = &self.chain[0].si;
        let edge = si.p - self.start;
        let d2 = edge.length_squared();
        let cos = si.n_geo.dot(edge).abs() / d2.sqrt();
        (target.determinant() / first.determinant()).abs() * cos / d2
    }

    /// Unit direction that the chain leaves its start in.
    pub fn direction(&self) -> Vec3<f64> {
        -self.chain[0].wo
    }

    /// Whether another solution, of the same start and target, is this one.
    pub fn is(&self, other: &Self, uniqueness: Uniqueness) -> bool {
        let same = |a: &super::Vertex, b: &super::Vertex| a.kind == b.kind;
        let alike = self.chain.len() == other.chain.len()
            && self.chain.iter().zip(&other.chain).all(|(a, b)| same(a, b));
        alike
            && match uniqueness {
                Uniqueness::ErrorBounds => {
                    let apart = (self.chain[0].si.p - other.chain[0].si.p).length();
                    apart <= self.error + other.error
                }
                Uniqueness::Threshold(threshold) => {
                    1.0 - self.direction().dot(other.direction()) < threshold
                }
            }
    }
}

/// How a walk went.
#[derive(Clone, Debug)]
pub struct Walked {
    /// Where to; `None` if nowhere.
    pub solution: Option<Solution>,
    /// How many steps were taken or tried.
    pub steps: u32,
}

/// Largest component.
fn size(c: Vec2<f64>) -> f64 {
    c.x.abs().max(c.y.abs())
}

/// Largest stretch of a matrix, at most.
fn norm(m: &Mat2<f64>) -> f64 {
    let squares = m.rows.iter().flatten().map(|x| x * x);
    squares.sum::<f64>().sqrt()
}

impl Space<'_> {
    /// Walks from a chain to one with the same events on the same shapes that meets the target.
    ///
    /// The unknown is the first vertex, and with it the direction from the start; the vertices behind it are traced, so
    /// that their constraints hold, and the step is that of the whole block-tridiagonal system. It is halved while the ray
    /// misses, meets another shape, or leaves the last constraint larger than it was. At most 20 steps.
    ///
    /// # Source
    /// [Zeltner 2021, Eq. 3.11]; step control and tolerances are ours (errata Z-3.11).
    pub fn walk(&self, start: &Start, mut chain: Chain, target: &Target) -> Walked {
        let x1 = start.si.p;
        let frame = match target {
            Target::Point(p) => equator(*p - x1),
            Target::Direction(d) => equator(*d),
        };
        let like: Events = chain.iter().map(Vertex::event).collect();
        let mut tried = 0;
        let failed = |steps| Walked {
            solution: None,
            steps,
        };
        let mut part = 1.0;
        let mut polish = 0;
        for _ in 0..MOST_STEPS + POLISH {
            let Some(at) = self.derivative(x1, &chain, target, &frame) else {
                return failed(tried);
            };
            let Some(inverse) = at.first.inverse() else {
                return failed(tried);
            };
            let step = inverse * at.value;
            let converged = size(at.value) <= TOLERANCE;
            let arrived = |chain: Chain, steps: u32| {
                let edge = (chain[0].si.p - x1).length();
                let [angles, lengths] = ROUNDING;
                let error = 2.0 * length(step) + norm(&inverse) * angles + lengths * edge;
                Walked {
                    solution: error.is_finite().then_some(Solution {
                        chain,
                        start: x1,
                        derivative: at,
                        error,
                    }),
                    steps,
                }
            };
            if converged && polish == POLISH {
                return arrived(chain, tried);
            }
            polish += u32::from(converged);
            // A part of the step that leaves less.
            let next = loop {
                tried += 1;
                let q = chain[0].moved(step * -part);
                let found = self.less(start, (q - x1).normalize(), &like, target, &frame, at.value);
                if found.is_some() {
                    break found;
                }
                part *= 0.5;
                if converged || part < LEAST_PART {
                    break None;
                }
            };
            match next {
                Some(next) => chain = next,
                // No better than this.
                None if converged => return arrived(chain, tried),
                None => return failed(tried),
            }
            part = (2.0 * part).min(1.0);
        }
        failed(tried)
    }

    /// The chain in another direction, if its last constraint is smaller than `than`.
    fn less(
        &self,
        start: &Start,
        d: Vec3<f64>,
        like: &[Event],
        target: &Target,
        frame: &Frame<f64>,
        than: Vec2<f64>,
    ) -> Option<Chain> {
        if !d.is_finite() {
            return None;
        }
        let chain = self.trace(start, d, like)?;
        let value = self.last_value(start.si.p, &chain, target, frame)?;
        (length(value) < length(than)).then_some(chain)
    }
}

fn length(v: Vec2<f64>) -> f64 {
    v.x.hypot(v.y)
}
