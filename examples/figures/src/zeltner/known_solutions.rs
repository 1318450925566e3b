//! Solutions of known probability and value, on which the estimators of [Zeltner 2021, algorithms 3.2 and 3.3] are tried.

use render::sampler::{Independent, Sampler};

/// Probability and value of each solution (errata Z-3.18).
pub const P: [f64; 4] = [0.5, 0.2, 0.05, 0.01];
pub const F: [f64; 4] = [1.0, 2.0, 3.0, 4.0];
/// Sizes of trial sets, and most trials of an estimate.
pub const M: [u32; 5] = [1, 4, 16, 64, 256];
/// Significance of all comparisons of a figure together.
pub const LEVEL: f64 = 1e-3;

/// Draws a solution, or none.
pub fn draw(s: &mut Independent) -> Option<usize> {
    let mut u = s.next_1d::<f64>();
    P.iter().position(|p| {
        u -= p;
        u < 0.0
    })
}

/// The value of all solutions.
pub fn total() -> f64 {
    F.iter().sum()
}

/// What `m` walks find of it on average: the sum of `f (1 - (1 - P)^m)`.
pub fn found(m: u32) -> f64 {
    let each = P.iter().zip(F);
    each.map(|(p, f)| f * (1.0 - (1.0 - p).powi(m as i32)))
        .sum()
}
