//! Functions written once over [`Real`], and the drivers that differentiate them.
//!
//! Small functions (up to some sixteen active inputs: a material, an emitter, a camera) are
//! differentiated by dual numbers in every direction of interest at once; their adjoints are the
//! transposed local Jacobian applied to a vector. Long computations chain such functions: see
//! [`chain`](crate::chain). There is no tape, no allocation and no global state.

use crate::dual::Dual;
use crate::real::{Real, array};

/// A function of `I` inputs and `O` outputs that can be evaluated with any scalar.
///
/// A trait rather than a closure, because Rust closures cannot be generic over the scalar. For a
/// function without data, [`diff_fn!`](crate::diff_fn) writes the implementation.
pub trait DiffFn<const I: usize, const O: usize> {
    /// The function's value, in any precision and differentiation mode.
    fn eval<R: Real>(&self, x: [R; I]) -> [R; O];
}

/// Declares a function over any scalar ([`crate::Real`]) that the drivers of this crate can
/// differentiate.
///
/// The name becomes a unit struct: within its scope, variables must be called otherwise.
///
/// ```
/// use ad_core::{diff_fn, gradient};
/// diff_fn! {
///     fn product<R>([x, y]: [R; 2]) -> [R; 1] { [x * y.sin()] }
/// }
/// let (value, [dx, dy]) = gradient(&product, [3.0f64, 0.5]);
/// assert_eq!((value, dx, dy), (3.0 * 0.5f64.sin(), 0.5f64.sin(), 3.0 * 0.5f64.cos()));
/// ```
#[macro_export]
macro_rules! diff_fn {
    ($(#[$meta:meta])* $vis:vis fn $name:ident<$R:ident>($x:tt: [$R1:ident; $I:expr])
        -> [$R2:ident; $O:expr] $body:block) => {
        $(#[$meta])*
        #[allow(non_camel_case_types)]
        #[derive(Clone, Copy, Debug)]
        $vis struct $name;

        impl $crate::DiffFn<{ $I }, { $O }> for $name {
            #[inline]
            fn eval<$R: $crate::Real>(&self, $x: [$R; $I]) -> [$R2; $O] $body
        }
    };
}

/// The independent variables `x`, one direction each.
#[inline(always)]
pub fn variables<P: Real, const I: usize>(x: [P; I]) -> [Dual<P, I>; I] {
    array(|i| Dual::var(x[i], i))
}

/// Value and derivative of a function of one variable.
///
/// ```
/// use ad_core::{derivative, diff_fn};
/// diff_fn! { fn cube<R>([x]: [R; 1]) -> [R; 1] { [x * x * x] } }
/// assert_eq!(derivative(&cube, 2.0f64), (8.0, 12.0));
/// ```
#[inline]
pub fn derivative<P: Real, F: DiffFn<1, 1>>(f: &F, x: P) -> (P, P) {
    let [y] = f.eval([Dual::<P, 1>::var(x, 0)]);
    (y.re, y.eps[0])
}

/// Value and gradient of a scalar function.
#[inline]
pub fn gradient<P: Real, F: DiffFn<I, 1>, const I: usize>(f: &F, x: [P; I]) -> (P, [P; I]) {
    let [y] = f.eval(variables(x));
    (y.re, y.eps)
}

/// Value and Jacobian; row `o` holds the derivatives of output `o`.
#[inline]
pub fn jacobian<P: Real, F: DiffFn<I, O>, const I: usize, const O: usize>(
    f: &F,
    x: [P; I],
) -> ([P; O], [[P; I]; O]) {
    let y = f.eval(variables(x));
    let mut rows = [[P::zero(); I]; O];
    for (row, y) in rows.iter_mut().zip(&y) {
        *row = y.eps;
    }
    (array(|o| y[o].re), rows)
}

/// Value and derivative along `dx` (forward mode, `J dx`).
#[inline]
pub fn jvp<P: Real, F: DiffFn<I, O>, const I: usize, const O: usize>(
    f: &F,
    x: [P; I],
    dx: [P; I],
) -> ([P; O], [P; O]) {
    let y = f.eval(array(|i| Dual::new(x[i], [dx[i]])));
    (array(|o| y[o].re), array(|o| y[o].eps[0]))
}

/// Value and adjoint of the inputs for the adjoint `w` of the outputs (reverse mode, `J^T w`).
#[inline]
pub fn vjp<P: Real, F: DiffFn<I, O>, const I: usize, const O: usize>(
    f: &F,
    x: [P; I],
    w: [P; O],
) -> ([P; O], [P; I]) {
    let (y, jac) = jacobian(f, x);
    (y, transpose_mul(&jac, w))
}

/// `J^T w` for a Jacobian stored by rows.
#[inline(always)]
pub fn transpose_mul<P: Real, const I: usize, const O: usize>(
    jac: &[[P; I]; O],
    w: [P; O],
) -> [P; I] {
    let mut adjoint = [P::zero(); I];
    for (row, w) in jac.iter().zip(w) {
        for (a, d) in adjoint.iter_mut().zip(row) {
            *a = d.mul_add(w, *a);
        }
    }
    adjoint
}

/// Value, gradient and Hessian of a scalar function, by duals of duals.
#[inline]
pub fn hessian<P: Real, F: DiffFn<I, 1>, const I: usize>(
    f: &F,
    x: [P; I],
) -> (P, [P; I], [[P; I]; I]) {
    let (y, g) = gradient(f, variables(x));
    (y.re, y.eps, g.map(|d| d.eps))
}

/// Value, gradient and Hessian-vector product `H v` of a scalar function, at the cost of a
/// gradient with two numbers per scalar.
#[inline]
pub fn hvp<P: Real, F: DiffFn<I, 1>, const I: usize>(
    f: &F,
    x: [P; I],
    v: [P; I],
) -> (P, [P; I], [P; I]) {
    let (y, g) = gradient(f, array(|i| Dual::new(x[i], [v[i]])));
    (y.re, array(|i| g[i].re), array(|i| g[i].eps[0]))
}

/// Value and gradient of a composition `outer(inner(x))` by local Jacobians.
///
/// Where a few intermediate quantities `M` summarise many inputs, the expensive outer function
/// carries `M` tangents instead of `I`.
#[inline(always)]
pub fn gradient_composed<P, F, G, const I: usize, const M: usize>(
    inner: &F,
    outer: &G,
    x: [P; I],
) -> (P, [P; I])
where
    P: Real,
    F: DiffFn<I, M>,
    G: DiffFn<M, 1>,
{
    let (mid, jac) = jacobian(inner, x);
    let (y, adjoint) = gradient(outer, mid);
    (y, transpose_mul(&jac, adjoint))
}
