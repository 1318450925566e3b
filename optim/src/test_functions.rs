//! Objectives with known minima, and the inputs of the comparison with Mitsuba 3.

use crate::{Optimizer, Scalar};

/// The start of the reference trajectories.
pub const MITSUBA_START: [f64; 3] = [0.3, -0.7, 1.1];

/// The gradients of the reference trajectories.
pub const MITSUBA_GRADIENTS: [[f64; 3]; 5] = [
    [1.0, -2.0, 0.5],
    [0.0, 3.0, -0.25],
    [-0.75, 0.125, 4.0],
    [2.0, 0.0, -1.5],
    [0.5, -0.5, 0.25],
];

/// Gradient of `(x - 1)^2 / 2 + 5 (y + 0.5)^2`.
pub fn quadratic(p: [f64; 2]) -> [f64; 2] {
    [p[0] - 1.0, 10.0 * (p[1] + 0.5)]
}

/// Gradient of `(1 - x)^2 + 100 (y - x^2)^2`, minimum at (1, 1).
pub fn rosenbrock([x, y]: [f64; 2]) -> [f64; 2] {
    let d = y - x * x;
    [-2.0 * (1.0 - x) - 400.0 * x * d, 200.0 * d]
}

/// The parameters after some steps.
pub fn descend<T: Scalar, const N: usize>(
    optimizer: &mut impl Optimizer<T>,
    gradient: impl Fn([T; N]) -> [T; N],
    mut p: [T; N],
    steps: usize,
) -> [T; N] {
    for _ in 0..steps {
        let g = gradient(p);
        optimizer.step(&mut p, &g).unwrap();
    }
    p
}
