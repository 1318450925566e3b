//! The density that [Zeltner 2021, figures 2.22 and 2.23] sample.

use super::integration_1d::Piecewise;

pub(super) const RANGE: [f64; 2] = [0.0, 1.0];

/// The density of both figures: two bumps.
pub(super) fn target() -> Piecewise {
    let bump = |x: f64, at: f64, width: f64| (-((x - at) / width).powi(2)).exp();
    Piecewise::interpolating(RANGE, 32, |x| {
        0.1 + bump(x, 0.3, 0.12) + 0.55 * bump(x, 0.72, 0.14)
    })
}
