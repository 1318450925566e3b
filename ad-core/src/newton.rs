//! Newton's method on small systems, with the Jacobian from dual numbers.

use crate::mat::solve_dense;
use crate::real::{Float, Real, array};
use crate::vjp::{DiffFn, jacobian};

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewtonOptions<P> {
    /// Largest number of steps.
    pub max_iterations: usize,
    /// Converged when no component of the residual exceeds this.
    pub tolerance: P,
}

impl<P: Float> Default for NewtonOptions<P> {
    /// Fifty steps, residual below 100 rounding units.
    fn default() -> Self {
        Self {
            max_iterations: 50,
            tolerance: P::EPSILON * P::of(100.0),
        }
    }
}

/// How the iteration ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NewtonStatus {
    /// The residual is within tolerance.
    Converged,
    /// The iteration limit was reached first.
    IterationLimit,
    /// The Jacobian became singular.
    Singular,
    /// The iterate or the residual left the finite numbers; the last finite iterate is returned.
    NotFinite,
}

/// Outcome of [`newton`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewtonResult<P, const N: usize> {
    /// The last finite iterate.
    pub x: [P; N],
    /// Largest absolute component of the residual at `x` (infinite if not finite there).
    pub residual: P,
    /// Number of steps taken.
    pub iterations: usize,
    /// How the iteration ended.
    pub status: NewtonStatus,
}

impl<P, const N: usize> NewtonResult<P, N> {
    /// Whether a root was found.
    pub fn converged(&self) -> bool {
        self.status == NewtonStatus::Converged
    }
}

/// Finds a root of `f` from the start `x0` by full Newton steps. Never panics.
///
/// ```
/// use ad_core::{diff_fn, newton};
/// diff_fn! { fn circle_and_line<R>([x, y]: [R; 2]) -> [R; 2] {
///     [x * x + y * y - R::c(2.0), x - y]
/// } }
/// let root = newton(&circle_and_line, [2.0f64, 0.5], &Default::default());
/// assert!(root.converged() && (root.x[0] - 1.0).abs() < 1e-12);
/// ```
pub fn newton<P: Float, F: DiffFn<N, N>, const N: usize>(
    f: &F,
    x0: [P; N],
    options: &NewtonOptions<P>,
) -> NewtonResult<P, N> {
    let (mut x, mut last, mut residual) = (x0, x0, P::MAX + P::MAX);
    let mut iterations = 0;
    let status = loop {
        let (y, jac) = jacobian(f, x);
        if !x.iter().chain(&y).all(|v| v.is_finite()) {
            break NewtonStatus::NotFinite;
        }
        last = x;
        residual = y.iter().fold(P::zero(), |m, y| Real::max(m, y.abs()));
        if residual <= options.tolerance {
            break NewtonStatus::Converged;
        }
        if iterations >= options.max_iterations {
            break NewtonStatus::IterationLimit;
        }
        let Some(step) = solve_dense(jac, y) else {
            break NewtonStatus::Singular;
        };
        x = array(|i| x[i] - step[i]);
        iterations += 1;
    };
    NewtonResult {
        x: last,
        residual,
        iterations,
        status,
    }
}
