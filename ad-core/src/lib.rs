//! Differentiation without a tape: dual numbers and local adjoints over one scalar trait.
//!
//! Write a function once over [`Real`], then evaluate it as it stands in `f32` or `f64`, or ask a
//! driver for its derivatives:
//!
//! ```
//! use ad_core::{diff_fn, gradient};
//! diff_fn! { fn rosenbrock<R>([x, y]: [R; 2]) -> [R; 1] {
//!     [(x - R::c(1.0)).square() + (y - x * x).square() * R::c(100.0)]
//! } }
//! let (value, grad) = gradient(&rosenbrock, [1.0, 2.0]);
//! assert_eq!((value, grad), (100.0, [-400.0, 200.0]));
//! ```
//!
//! The same function, unchanged, in second order:
//!
//! ```
//! # use ad_core::*;
//! # diff_fn! { fn rosenbrock<R>([x, y]: [R; 2]) -> [R; 1] {
//! #     [(x - R::c(1.0)).square() + (y - x * x).square() * R::c(100.0)]
//! # } }
//! let (_, _, h) = hessian(&rosenbrock, [1.0, 1.0]);
//! assert_eq!(h, [[802.0, -400.0], [-400.0, 200.0]]);
//! let (_, _, hv) = hvp(&rosenbrock, [1.0, 1.0], [1.0, 2.0]);
//! assert_eq!(hv, [2.0, 0.0]);
//! ```
//!
//! # Which driver
//!
//! | need | use |
//! |---|---|
//! | all derivatives of a small function | [`gradient`], [`jacobian`], [`derivative`] |
//! | one direction (forward mode) | [`jvp`] |
//! | adjoint of a small function (reverse mode) | [`vjp()`] |
//! | small core behind many inputs | [`gradient_composed`] |
//! | gradient of a long chain | [`Chain`] |
//! | second order | [`hessian`], [`hvp`] |
//! | roots of a small system | [`newton()`] |
//! | bounds over a box | [`Interval`], `Dual<Interval, N>` |
//! | proof that a root is the only one in a box | [`krawczyk()`] |
//! | trust | [`check`] |
//!
//! There is no tape, no heap allocation per evaluation, no global state and no unsafe code.
//! Comparisons look at values only, so all scalars take the same branches. Derivatives are finite
//! everywhere; [`elementary`] tabulates the choice at every singular point.
#![forbid(unsafe_code)]

pub mod chain;
pub mod check;
pub mod dual;
pub mod elementary;
pub mod interval;
pub mod krawczyk;
#[doc(hidden)]
pub mod lanes;
pub mod mat;
pub mod newton;
pub mod real;
pub mod vec;
pub mod vjp;

pub use chain::Chain;
pub use dual::Dual;
pub use interval::Interval;
pub use krawczyk::{Isolated, krawczyk};
pub use mat::{Mat2, Mat3, block_tridiagonal_solve, solve_dense};
pub use newton::{NewtonOptions, NewtonResult, NewtonStatus, newton};
pub use real::{Const, Float, Real, array};
pub use vec::{Vec2, Vec3};
pub use vjp::{
    DiffFn, derivative, gradient, gradient_composed, hessian, hvp, jacobian, jvp, transpose_mul,
    variables, vjp,
};
