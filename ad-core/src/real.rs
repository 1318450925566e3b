//! The scalar abstraction: [`Real`] for everything that can be differentiated, [`Float`] for the
//! machine numbers underneath, [`Const`] for operands that carry no tangent.

use crate::lanes::TangentLanes;
use std::fmt::{Debug, Display, LowerExp};
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// A primal constant in mixed arithmetic: `x * Const(p)` does no tangent work beyond scaling.
///
/// Rust's coherence rules forbid `impl Add<P::Primal> for Dual<P, N>`, so constants are wrapped.
/// In generic code write `x * R::c(2.0)` or `R::c(1.0) - x`; both orders work.
///
/// ```
/// use ad_core::{Const, Dual, Real};
/// let x = Dual::<f64, 1>::var(3.0, 0);
/// let y = Const(1.0) - x * Const(2.0);
/// assert_eq!((y.re, y.eps), (-5.0, [-2.0]));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Const<P>(pub P);

/// A real scalar: `f32`, `f64`, an [`Interval`](crate::Interval), or a (possibly nested) [`Dual`](crate::Dual) over one of
/// them.
///
/// Code written once over `R: Real` evaluates in any precision and in any differentiation mode.
/// Comparisons look at the primal part only, so control flow is the same for every scalar.
///
/// Values follow IEEE 754 for every scalar; tangents are always finite for finite tangents in
/// (up to overflow of the product itself). What happens where a derivative does not exist is
/// decided, and tabulated, in [`elementary`](crate::elementary).
pub trait Real:
    Copy
    + Debug
    + Default
    + PartialEq
    + PartialOrd
    + Send
    + Sync
    + 'static
    + Neg<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + DivAssign
    + Add<Const<Self::Primal>, Output = Self>
    + Sub<Const<Self::Primal>, Output = Self>
    + Mul<Const<Self::Primal>, Output = Self>
    + Div<Const<Self::Primal>, Output = Self>
    + Sum
    + TangentLanes
{
    /// The machine number at the bottom: `f32` or `f64`, also for nested duals.
    type Primal: Float;

    /// True for `f32` and `f64`: no tangent can exist, so derivative-only work may be skipped.
    const IS_PRIMAL: bool;

    /// The constant `x`, with zero tangent.
    fn lift(x: Self::Primal) -> Self;

    /// The value, stripped of every level of tangents.
    fn primal(self) -> Self::Primal;

    /// The same value with zero tangent.
    #[inline]
    fn detach(self) -> Self {
        Self::lift(self.primal())
    }

    /// The constant `x` as `Self`, rounded to the primal type.
    #[inline]
    fn of(x: f64) -> Self {
        Self::lift(Self::Primal::from_f64(x))
    }

    /// The constant `x` for mixed arithmetic, as in `y * R::c(2.0)`.
    #[inline]
    fn c(x: f64) -> Const<Self::Primal> {
        Const(Self::Primal::from_f64(x))
    }

    /// Zero, with zero tangent.
    #[inline]
    fn zero() -> Self {
        Self::of(0.0)
    }

    /// One, with zero tangent.
    #[inline]
    fn one() -> Self {
        Self::of(1.0)
    }

    /// Whether any tangent, at any level, is non-zero.
    fn has_tangent(self) -> bool;

    /// Whether the value and all tangents are finite.
    fn is_finite(self) -> bool;

    /// Square root.
    fn sqrt(self) -> Self;
    /// Cube root, also of negative numbers.
    fn cbrt(self) -> Self;
    /// `1 / self`.
    fn recip(self) -> Self;
    /// `c / self` for a constant numerator.
    fn div_into(self, c: Const<Self::Primal>) -> Self;
    /// `e^self`.
    fn exp(self) -> Self;
    /// `e^self - 1`, accurate near zero.
    fn exp_m1(self) -> Self;
    /// Natural logarithm.
    fn ln(self) -> Self;
    /// `ln(1 + self)`, accurate near zero.
    fn ln_1p(self) -> Self;
    /// Sine of an angle in radians.
    fn sin(self) -> Self;
    /// Cosine of an angle in radians.
    fn cos(self) -> Self;
    /// Sine and cosine of an angle in radians.
    fn sin_cos(self) -> (Self, Self);
    /// Tangent of an angle in radians.
    fn tan(self) -> Self;
    /// Arcsine in radians.
    fn asin(self) -> Self;
    /// Arccosine in radians.
    fn acos(self) -> Self;
    /// Arctangent in radians.
    fn atan(self) -> Self;
    /// Four-quadrant arctangent of `self / x` in radians (`self` is the ordinate).
    fn atan2(self, x: Self) -> Self;
    /// Hyperbolic sine.
    fn sinh(self) -> Self;
    /// Hyperbolic cosine.
    fn cosh(self) -> Self;
    /// Hyperbolic tangent.
    fn tanh(self) -> Self;
    /// Integer power.
    fn powi(self, n: i32) -> Self;
    /// Real power; tangents of base and exponent both count.
    fn powf(self, y: Self) -> Self;
    /// `sqrt(self^2 + y^2)` without overflow.
    fn hypot(self, y: Self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// The smaller of two numbers; `self` when equal, the other one when one is NaN.
    fn min(self, other: Self) -> Self;
    /// The larger of two numbers; `self` when equal, the other one when one is NaN.
    fn max(self, other: Self) -> Self;
    /// `self` limited to `[lo, hi]`; keeps the tangent of `self` on the boundary. Never panics.
    #[inline]
    fn clamp(self, lo: Self, hi: Self) -> Self {
        self.max(lo).min(hi)
    }
    /// `1` for positive numbers and `+0`, `-1` for negative ones and `-0`.
    fn signum(self) -> Self;
    /// Error function `2/sqrt(pi) * integral of exp(-t^2) over [0, self]`.
    fn erf(self) -> Self;
    /// Least non-negative remainder of `self` modulo `m`.
    fn rem_euclid(self, m: Const<Self::Primal>) -> Self;
    /// `self * a + b`.
    #[inline]
    fn mul_add(self, a: Self, b: Self) -> Self {
        self * a + b
    }
    /// `self * self`.
    fn square(self) -> Self;
    /// The magnitude of `self` with the sign bit of `sign`.
    #[inline]
    fn copysign(self, sign: Self::Primal) -> Self {
        if self.primal().sign_bit() == sign.sign_bit() {
            self
        } else {
            -self
        }
    }
    /// `a` if `cond` holds, else `b`.
    #[inline]
    fn select(cond: bool, a: Self, b: Self) -> Self {
        if cond { a } else { b }
    }
}

/// A machine number: `f32` or `f64`.
pub trait Float: Real<Primal = Self> + Into<f64> + LowerExp + Display {
    /// Distance from 1 to the next larger number.
    const EPSILON: Self;
    /// Largest finite number.
    const MAX: Self;
    /// Smallest positive normal number.
    const MIN_POSITIVE: Self;

    /// Nearest number of this type.
    fn from_f64(x: f64) -> Self;
    /// Nearest number of this type.
    fn from_f32(x: f32) -> Self;
    /// Conversion to double precision (exact).
    fn to_f64(self) -> f64;
    /// Conversion to single precision (rounded).
    fn to_f32(self) -> f32;
    /// A number in `[0, 1)` from the leading bits of 64 random bits.
    fn from_bits_unit(u: u64) -> Self;
    /// Whether the sign bit is set (true for `-0`).
    fn sign_bit(self) -> bool;
    /// Largest integer not above `self`.
    fn floor(self) -> Self;
}

macro_rules! mixed_primal {
    ($t:ty: $($op:ident $f:ident $sym:tt),*) => {$(
        impl $op<Const<$t>> for $t {
            type Output = $t;
            #[inline(always)]
            fn $f(self, c: Const<$t>) -> $t {
                self $sym c.0
            }
        }
    )*};
}

macro_rules! forward {
    ($t:ident: $($f:ident)*) => {$(
        #[inline(always)]
        fn $f(self) -> Self {
            $t::$f(self)
        }
    )*};
}

macro_rules! real_float {
    ($t:ident, $bits:expr, $erf:path, $scale:expr) => {
        mixed_primal!($t: Add add +, Sub sub -, Mul mul *, Div div /);

        impl Real for $t {
            type Primal = $t;
            const IS_PRIMAL: bool = true;

            #[inline(always)]
            fn lift(x: $t) -> $t {
                x
            }
            #[inline(always)]
            fn primal(self) -> $t {
                self
            }
            #[inline(always)]
            fn has_tangent(self) -> bool {
                false
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                $t::is_finite(self)
            }
            forward!($t: sqrt cbrt recip exp exp_m1 ln ln_1p sin cos tan asin acos atan);
            forward!($t: sinh cosh tanh abs signum);
            #[inline(always)]
            fn div_into(self, c: Const<$t>) -> $t {
                c.0 / self
            }
            #[inline(always)]
            fn sin_cos(self) -> ($t, $t) {
                $t::sin_cos(self)
            }
            #[inline(always)]
            fn atan2(self, x: $t) -> $t {
                $t::atan2(self, x)
            }
            #[inline(always)]
            fn powi(self, n: i32) -> $t {
                $t::powi(self, n)
            }
            #[inline(always)]
            fn powf(self, y: $t) -> $t {
                $t::powf(self, y)
            }
            #[inline(always)]
            fn hypot(self, y: $t) -> $t {
                $t::hypot(self, y)
            }
            #[inline(always)]
            fn min(self, other: $t) -> $t {
                $t::min(self, other)
            }
            #[inline(always)]
            fn max(self, other: $t) -> $t {
                $t::max(self, other)
            }
            #[inline(always)]
            fn erf(self) -> $t {
                $erf(self)
            }
            #[inline(always)]
            fn rem_euclid(self, m: Const<$t>) -> $t {
                $t::rem_euclid(self, m.0)
            }
            #[inline(always)]
            fn mul_add(self, a: $t, b: $t) -> $t {
                // Without hardware support `mul_add` is a slow library call.
                if cfg!(target_feature = "fma") { $t::mul_add(self, a, b) } else { self * a + b }
            }
            #[inline(always)]
            fn square(self) -> $t {
                self * self
            }
            #[inline(always)]
            fn copysign(self, sign: $t) -> $t {
                $t::copysign(self, sign)
            }
        }

        impl Float for $t {
            const EPSILON: $t = $t::EPSILON;
            const MAX: $t = $t::MAX;
            const MIN_POSITIVE: $t = $t::MIN_POSITIVE;

            #[inline(always)]
            fn from_f64(x: f64) -> $t {
                x as $t
            }
            #[inline(always)]
            fn from_f32(x: f32) -> $t {
                x as $t
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                self as f64
            }
            #[inline(always)]
            fn to_f32(self) -> f32 {
                self as f32
            }
            #[inline(always)]
            fn from_bits_unit(u: u64) -> $t {
                (u >> (64 - $bits)) as $t * $scale
            }
            #[inline(always)]
            fn sign_bit(self) -> bool {
                self.is_sign_negative()
            }
            #[inline(always)]
            fn floor(self) -> $t {
                $t::floor(self)
            }
        }
    };
}

real_float!(f32, 24, libm::erff, 1.0 / (1u32 << 24) as f32);
real_float!(f64, 53, libm::erf, 1.0 / (1u64 << 53) as f64);

impl<R: Real> Add<R> for Const<R::Primal> {
    type Output = R;
    #[inline(always)]
    fn add(self, x: R) -> R {
        x + self
    }
}

impl<R: Real> Sub<R> for Const<R::Primal> {
    type Output = R;
    #[inline(always)]
    fn sub(self, x: R) -> R {
        -x + self
    }
}

impl<R: Real> Mul<R> for Const<R::Primal> {
    type Output = R;
    #[inline(always)]
    fn mul(self, x: R) -> R {
        x * self
    }
}

impl<R: Real> Div<R> for Const<R::Primal> {
    type Output = R;
    #[inline(always)]
    fn div(self, x: R) -> R {
        x.div_into(self)
    }
}

/// The array of `f(0)`, `f(1)`, and so on. Unlike `std::array::from_fn` and `map` of arrays it is inlined wherever
/// it is called: they are not marked so, and between parts of a crate that are compiled apart they would be a call
/// per number.
#[inline(always)]
pub fn array<R: Real, const N: usize>(mut f: impl FnMut(usize) -> R) -> [R; N] {
    let mut all = [R::zero(); N];
    for (k, x) in all.iter_mut().enumerate() {
        *x = f(k);
    }
    all
}
