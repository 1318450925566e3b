//! Measured moments of estimators in one dimension beside the exact ones [Zeltner 2021, figures 4.10, 4.11 and 4.14].

use ad_core::{Dual, Real};
use render::statistics::{Estimate, z_limit};

use super::taxonomy::expectation;
use crate::statistics::Moments;

/// Exact mean and standard deviation over the random number.
pub(super) fn exact(f: impl Fn(f64) -> f64) -> (f64, f64) {
    let mean = expectation(|u| Dual::lift(f(u))).re;
    let variance = expectation(|u| Dual::lift((f(u) - mean).powi(2))).re;
    (mean, variance.sqrt())
}

/// Whether measured mean and variance agree with their exact values, of so many of each that are compared; significance
/// 1 in 1000 together.
pub(super) fn agrees(m: &Moments, (mean, std): (f64, f64), pairs: usize) -> bool {
    let limit = z_limit(2 * pairs, m.samples(), 1e-3);
    let variance = Estimate::exact(std * std);
    m.z(mean).abs() < limit && m.of_variance().z(&variance).abs() < limit
}

pub(super) fn describe(m: &Moments, (mean, std): (f64, f64)) -> String {
    format!(
        "mean {:.4} ± {:.4}, std {:.4}; by quadrature {mean:.4} and {std:.4}",
        m.mean,
        m.of_mean().se,
        m.variance().sqrt()
    )
}
