//! Measured moments of estimators in one dimension beside the exact ones [Zeltner 2021, figures 4.10, 4.11 and 4.14].

use ad_core::{Dual, Real};

use super::integration_1d::Moments;
use super::taxonomy::expectation;

/// Exact mean and standard deviation over the random number.
pub(super) fn exact(f: impl Fn(f64) -> f64) -> (f64, f64) {
    let mean = expectation(|u| Dual::lift(f(u))).re;
    let variance = expectation(|u| Dual::lift((f(u) - mean).powi(2))).re;
    (mean, variance.sqrt())
}

/// Whether measured moments agree with their exact values: mean and variance within 4 standard errors.
pub(super) fn agrees(m: &Moments, (mean, std): (f64, f64)) -> bool {
    m.z(mean).abs() < 4.0 && (m.variance() - std * std).abs() < 4.0 * m.variance_error()
}

pub(super) fn describe(m: &Moments, (mean, std): (f64, f64)) -> String {
    format!(
        "mean {:.4} ± {:.4}, std {:.4}; by quadrature {mean:.4} and {std:.4}",
        m.mean,
        m.error(),
        m.variance().sqrt()
    )
}
