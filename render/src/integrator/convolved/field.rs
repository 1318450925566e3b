//! A smooth field of velocities of directions that tends to that of outlines on them: harmonic convolution, from a few
//! directions around one.
//!
//! The thesis takes a quotient of two integrals over the sphere, with the weight `(B + exp(kappa (1 - cos)) - 1)^-3` of a
//! neighbour at an angle, whose boundary test `B` vanishes on outlines [Zeltner 2021, Eqs. 4.23, 4.24, power by errata
//! Z-4.24]. Estimates of both by the same few neighbours have a quotient that is biased (errata Z-4.23), and so is the
//! divergence that they give.
//!
//! Here the *expectation* of the quotient over [`Neighbour`]s is the field, whatever their number: it is smooth, and tends to
//! the velocity of an outline as surely as one of the neighbours is beyond it. Its divergence has a second term, from how the
//! density of the neighbours depends on the direction,
//!
//! `div V = E[sum_i grad c_i . (V_i - V) / Z + sum_i s_i . (V - V_without_i)]`,
//!
//! with `V = sum_i c_i V_i / Z`, `Z = sum_i c_i`, weights over densities `c_i` whose neighbours stay, and gradients `s_i` of
//! the logarithms of the densities. Without neighbour i, `V` does not depend on it, so that it may be subtracted: the term is
//! there only where a neighbour differs from all others. Nothing is lost for few neighbours then, and no limit of many is
//! needed; what is left of a bias is the width of the kernel.

use ad_core::Vec3;

use crate::math::Frame;

/// Concentration of the distribution of neighbours: their angles are about one over its root, radians.
pub const KAPPA: f64 = 1e5;

/// Largest value of the boundary test, and that of what has no outline. Within an outline and beyond it, neighbours count as the cubes of these.
pub const LARGEST: f64 = 30.0;

/// How much faster the boundary test rises than the kernel: neighbours that are closer to an outline than to the direction
/// decide. On curved surfaces the velocity at an outline is that of the outline only.
const STEEPNESS: f64 = 30.0;

/// A value of the boundary test and a distance that are next to nothing: on the outline itself.
const LEAST: f64 = 1e-12;

/// A direction close to another one.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour {
    /// Unit vector.
    pub d: Vec3<f64>,
    /// Its part at right angles to the direction that it is a neighbour of.
    across: Vec3<f64>,
    /// Density, as a part of the largest one.
    level: f64,
}

impl Neighbour {
    /// Distributed about the axis of `frame` by von Mises and Fisher, from two numbers in `[0, 1)`.
    pub fn sample(frame: &Frame<f64>, kappa: f64, [u, v]: [f64; 2]) -> Self {
        let level = 1.0 - u;
        // One minus the cosine.
        let away = (-level.ln() / kappa).min(2.0);
        let sine = (away * (2.0 - away)).sqrt();
        let (y, x) = (std::f64::consts::TAU * v).sin_cos();
        let across = frame.s * (sine * x) + frame.t * (sine * y);
        Self {
            d: frame.n * (1.0 - away) + across,
            across,
            level,
        }
    }
}

/// The boundary test at an angle from an outline, radians: it rises with the square of the angle, as a kernel does.
pub fn boundary_test(kappa: f64, distance: f64) -> f64 {
    (0.5 * STEEPNESS * kappa * distance * distance).min(LARGEST)
}

/// What the velocity of one neighbour does to the field and to its divergence.
#[derive(Clone, Copy, Debug, Default)]
pub struct Influence {
    /// Part of the field.
    pub share: f64,
    /// The divergence is the sum of the scalar products with the velocities.
    pub divergence: Vec3<f64>,
}

/// The field at the unit direction `w` from at least two neighbours and their boundary tests. It is the sum of velocities
/// times shares, as far as that is at right angles to `w`; the divergence is that on the sphere (errata Z-4.22). A neighbour
/// that stands several times in a row has as many velocities, each with a test of its own.
pub fn convolve(
    w: Vec3<f64>,
    kappa: f64,
    neighbours: &[(Neighbour, f64)],
    influences: &mut Vec<Influence>,
) {
    // The weight over the density, without factors of both.
    let height = |(n, test): &(Neighbour, f64)| (test * n.level + (1.0 - n.level)).max(LEAST);
    let count = |each: &(Neighbour, f64)| each.0.level.powi(2) / height(each).powi(3);
    let counts: Vec<f64> = neighbours.iter().map(count).collect();
    let total: f64 = counts.iter().sum();
    influences.clear();
    influences.extend(neighbours.iter().zip(&counts).map(|(each, count)| {
        let share = count / total;
        Influence {
            share,
            // The gradient of the weight.
            divergence: each.0.across * (3.0 * kappa * share / height(each)),
        }
    }));
    let slopes = (influences.iter()).fold(Vec3::zero(), |sum, i| sum + i.divergence);
    for influence in influences.iter_mut() {
        influence.divergence -= (slopes + w * 2.0) * influence.share;
    }
    let mut own = 0..0;
    for alike in neighbours.chunk_by(|a, b| a.0.d == b.0.d) {
        own = own.end..own.end + alike.len();
        let share: f64 = influences[own.clone()].iter().map(|i| i.share).sum();
        let score = alike[0].0.across * (kappa * share);
        let others = || (counts.iter().enumerate()).filter(|(j, _)| !own.contains(j));
        let rest: f64 = others().map(|(_, c)| c).sum();
        for influence in &mut influences[own.clone()] {
            influence.divergence += score * influence.share;
        }
        if rest > 0.0 {
            for (j, count) in others() {
                influences[j].divergence -= score * (share * count / rest);
            }
        }
    }
}
