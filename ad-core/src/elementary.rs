//! Elementary functions as (value, slope), and the only place where singular points are decided.
//!
//! Every function takes the value at one level of nesting and returns the function's value
//! together with its derivative(s). Values follow IEEE 754. **A slope is always finite**: where
//! the derivative does not exist, is infinite, or overflows, it is the number in this table.
//! Hence zero tangent in gives zero tangent out, and a unit tangent in gives a finite tangent out,
//! at every point whatsoever. The one exception are products, whose slopes are their own factors.
//!
//! | function | singular point | value | slope |
//! |---|---|---|---|
//! | `a * b`, `square` | non-finite factor | IEEE | that factor (twice, for `square`) |
//! | `a / b`, `recip`, `div_into` | `b = 0` | IEEE: ±inf or NaN | 0 for `a` and `b` |
//! | `sqrt` | 0; below 0 | 0; NaN | 0 |
//! | `cbrt` | 0 | 0 | 0 |
//! | `ln` | 0; below 0 | -inf; NaN | 0 |
//! | `ln_1p` | -1; below -1 | -inf; NaN | 0 |
//! | `exp`, `exp_m1`, `sinh`, `cosh` | overflow | ±inf | 0 |
//! | `tan` | near a pole | finite | finite (0 on overflow) |
//! | `asin`, `acos` | ±1; beyond | ±π/2, 0 or π; NaN | 0 |
//! | `atan2(y, x)` | (0, 0) | IEEE (0 or ±π) | 0 for `y` and `x` |
//! | `hypot(x, y)` | (0, 0) | 0 | 0 for `x` and `y` |
//! | `powi(x, n)` | `x = 0`, `n < 0` | inf | 0 |
//! | `powi(x, 0)` | everywhere | 1 | 0 |
//! | `powf(x, y)` | `x = 0`, `0 < y < 1` | 0 | 0 for `x` and `y` |
//! | | `x = 0`, `y = 0` | 1 | 0 for `x` and `y` |
//! | | `x = 0`, `y = 1` | 0 | 1 for `x`, 0 for `y` |
//! | | `x = 0`, `y > 1` | 0 | 0 for `x` and `y` |
//! | | `x = 0`, `y < 0` | inf | 0 for `x` and `y` |
//! | | `x < 0`, integer `y` | finite | `y x^(y-1)` for `x`, 0 for `y` |
//! | | `x < 0`, other `y` | NaN | 0 for `x` and `y` |
//! | `abs` | 0 | 0 | 0 |
//! | `min`, `max` | equal arguments | that value | that of the first argument |
//! | `clamp` | on the boundary | that value | that of the clamped argument |
//! | `signum` | everywhere | ±1 | 0 |
//! | `copysign` | 0 | ±0 | ±1, from the sign bits |
//! | `rem_euclid` | at the jumps | 0 | 1 |
//! | `Vec2`/`Vec3` `length`, `normalize` | zero or nearly subnormal vector | 0, zero vector | 0 |

use crate::real::{Const, Float, Real};

/// The slope `d` where it is finite, else zero; sheds only the offending level of nested tangents.
#[inline(always)]
pub(crate) fn finite<P: Real>(d: P) -> P {
    if d.is_finite() {
        d
    } else if !P::IS_PRIMAL && d.primal().is_finite() {
        d.detach()
    } else {
        P::zero()
    }
}

/// Quotient `a / b`; slopes with respect to `a` and `b`.
#[inline(always)]
pub fn div<P: Real>(a: P, b: P) -> (P, P, P) {
    let q = a / b;
    let da = b.recip();
    (q, finite(da), finite(-q * da))
}

/// Reciprocal.
#[inline(always)]
pub fn recip<P: Real>(x: P) -> (P, P) {
    let q = x.recip();
    (q, finite(-q.square()))
}

/// Quotient `x / c` by a constant; the slope is a constant too.
#[inline(always)]
pub fn div_const<P: Real>(x: P, c: Const<P::Primal>) -> (P, Const<P::Primal>) {
    (x / c, Const(finite(c.0.recip())))
}

/// Quotient `c / x` of a constant.
#[inline(always)]
pub fn div_into<P: Real>(x: P, c: Const<P::Primal>) -> (P, P) {
    let q = x.div_into(c);
    (q, finite(-q / x))
}

/// Square root.
#[inline(always)]
pub fn sqrt<P: Real>(x: P) -> (P, P) {
    let s = x.sqrt();
    let slope = if s > P::zero() {
        s.div_into(P::c(0.5))
    } else {
        P::zero()
    };
    // The root of the smallest positive number is far from zero: only nested tangents overflow.
    (s, if P::IS_PRIMAL { slope } else { finite(slope) })
}

/// Cube root.
#[inline]
pub fn cbrt<P: Real>(x: P) -> (P, P) {
    let c = x.cbrt();
    (c, finite((c * P::c(3.0)).recip() / c))
}

/// Exponential.
#[inline]
pub fn exp<P: Real>(x: P) -> (P, P) {
    let e = x.exp();
    (e, finite(e))
}

/// `e^x - 1`.
#[inline]
pub fn exp_m1<P: Real>(x: P) -> (P, P) {
    // Not `value + 1`: that cancels for very negative arguments.
    (x.exp_m1(), finite(x.exp()))
}

/// Natural logarithm.
#[inline]
pub fn ln<P: Real>(x: P) -> (P, P) {
    let slope = if x > P::zero() { x.recip() } else { P::zero() };
    (x.ln(), finite(slope))
}

/// `ln(1 + x)`.
#[inline]
pub fn ln_1p<P: Real>(x: P) -> (P, P) {
    let y = x + P::c(1.0);
    let slope = if y > P::zero() { y.recip() } else { P::zero() };
    (x.ln_1p(), finite(slope))
}

/// Tangent.
#[inline]
pub fn tan<P: Real>(x: P) -> (P, P) {
    let t = x.tan();
    (t, finite(t.square() + P::c(1.0)))
}

/// Slope of the arcsine.
#[inline]
fn asin_slope<P: Real>(x: P) -> P {
    // (1 - x)(1 + x) instead of 1 - x^2: exact factors, no cancellation next to the ends.
    let c = (P::c(1.0) - x) * (x + P::c(1.0));
    if c > P::zero() {
        finite(c.sqrt().recip())
    } else {
        P::zero()
    }
}

/// Arcsine.
#[inline]
pub fn asin<P: Real>(x: P) -> (P, P) {
    (x.asin(), asin_slope(x))
}

/// Arccosine.
#[inline]
pub fn acos<P: Real>(x: P) -> (P, P) {
    (x.acos(), -asin_slope(x))
}

/// Arctangent.
#[inline]
pub fn atan<P: Real>(x: P) -> (P, P) {
    (x.atan(), finite((x.square() + P::c(1.0)).recip()))
}

/// `atan2(y, x)`; slopes with respect to `y` and `x`.
#[inline]
pub fn atan2<P: Real>(y: P, x: P) -> (P, P, P) {
    // Of the smaller over the larger, so that no square overflows or vanishes.
    let slope = |larger: P, q: P| (larger * (q.square() + P::c(1.0))).recip();
    let (dy, dx) = if y.abs() > x.abs() {
        let q = x / y;
        let s = slope(y, q);
        (q * s, -s)
    } else if x != P::zero() {
        let q = y / x;
        let s = slope(x, q);
        (s, -q * s)
    } else {
        (P::zero(), P::zero())
    };
    (y.atan2(x), finite(dy), finite(dx))
}

/// Hyperbolic tangent.
#[inline]
pub fn tanh<P: Real>(x: P) -> (P, P) {
    // sech^2 in terms of e^(-2|x|): neither overflow nor the cancellation of 1 - tanh^2.
    let e = (if x < P::zero() { x } else { -x } * P::c(2.0)).exp();
    let slope = e * P::c(4.0) / (e + P::c(1.0)).square();
    (x.tanh(), finite(slope))
}

/// Integer power.
#[inline]
pub fn powi<P: Real>(x: P, n: i32) -> (P, P) {
    let slope = if n == 0 {
        P::zero()
    } else {
        x.powi(n.saturating_sub(1)) * P::c(f64::from(n))
    };
    (x.powi(n), finite(slope))
}

/// Real power `x^y`; slopes with respect to `x` and `y`.
#[inline]
pub fn powf<P: Real>(x: P, y: P) -> (P, P, P) {
    let v = x.powf(y);
    let dx = if y == P::zero() {
        P::zero()
    } else {
        y * x.powf(y - P::c(1.0))
    };
    let dy = if x > P::zero() { v * x.ln() } else { P::zero() };
    (v, finite(dx), finite(dy))
}

/// Slope of `x^y` with respect to `x` alone, for exponents without tangent (saves a logarithm).
#[inline]
pub(crate) fn powf_base<P: Real>(x: P, y: P) -> (P, P) {
    let dx = if y == P::zero() {
        P::zero()
    } else {
        y * x.powf(y - P::c(1.0))
    };
    (x.powf(y), finite(dx))
}

/// `sqrt(x^2 + y^2)`; slopes with respect to `x` and `y`.
#[inline]
pub fn hypot<P: Real>(x: P, y: P) -> (P, P, P) {
    let r = x.hypot(y);
    let (dx, dy) = if r > P::zero() {
        (x / r, y / r)
    } else {
        (P::zero(), P::zero())
    };
    (r, finite(dx), finite(dy))
}

/// Absolute value.
#[inline]
pub fn abs<P: Real>(x: P) -> (P, P) {
    let slope = if x > P::zero() {
        P::one()
    } else if x < P::zero() {
        -P::one()
    } else {
        P::zero()
    };
    (x.abs(), slope)
}

/// Error function.
#[inline]
pub fn erf<P: Real>(x: P) -> (P, P) {
    let slope = (-x.square()).exp() * P::c(std::f64::consts::FRAC_2_SQRT_PI);
    (x.erf(), finite(slope))
}

/// Whether `min(a, b)` is `a`.
#[inline(always)]
pub(crate) fn takes_min<P: Real>(a: P, b: P) -> bool {
    a <= b || is_nan(b)
}

/// Whether `max(a, b)` is `a`.
#[inline(always)]
pub(crate) fn takes_max<P: Real>(a: P, b: P) -> bool {
    a >= b || is_nan(b)
}

#[inline(always)]
fn is_nan<P: Real>(x: P) -> bool {
    x.primal().to_f64().is_nan()
}
