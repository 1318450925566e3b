//! Interval arithmetic: bounds of a function over a box, rounding included.

use std::cmp::Ordering;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

use crate::lanes::TangentLanes;
use crate::real::{Const, Real, array};

/// All numbers from `lo` to `hi`. A function of intervals contains its value at all numbers in them, whatever the rounding:
/// bounds are rounded outwards, by up to two units in the last place, those of functions of the system's library by eight.
///
/// `Dual<Interval, N>` bounds derivatives too, which is what proofs of roots are made of ([`krawczyk`](crate::krawczyk())).
///
/// # Decisions
/// Code over [`Real`] branches on single numbers. [`Real::primal`] is the lower end of an interval, or the upper one of
/// those that come from [`Interval::deciding_by_upper`], and comparisons of two intervals look at the ends that are
/// nearest to each other, or farthest. So a function that is evaluated both ways takes the same branches twice where the
/// whole box does, and otherwise has two different results.
///
/// What is undefined somewhere in an interval, as a root of negative numbers, is the whole line. It counts as finite
/// ([`Real::is_finite`]), or slopes without bounds would be taken for zero ([`elementary`](crate::elementary)).
///
/// ```
/// use ad_core::{Interval, Real};
/// let x = Interval::new(1.0, 2.0);
/// let y = x * x - x;
/// assert!(y.contains(0.0) && y.contains(2.0) && y.lo() >= -1.1 && y.hi() <= 3.1);
/// assert!((x - x).contains(0.0));
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Interval {
    lo: f64,
    hi: f64,
    upper: bool,
}

/// Functions of the system's library are right to so much of their value.
const LIBRARY: f64 = 4.0 * f64::EPSILON;
/// The rounding of what nearly vanishes.
const TINY: f64 = f64::from_bits(2);

impl Interval {
    /// The whole line.
    pub const LINE: Self = Self {
        lo: f64::NEG_INFINITY,
        hi: f64::INFINITY,
        upper: false,
    };

    /// From `lo` to `hi`; the whole line if they are not in that order, or no numbers.
    pub fn new(lo: f64, hi: f64) -> Self {
        Self::of_both(lo, hi, false)
    }

    /// All numbers at most `radius` from `x`.
    pub fn around(x: f64, radius: f64) -> Self {
        Self::outwards(x - radius, x + radius, false)
    }

    /// The same interval, whose upper end decides.
    #[must_use]
    pub fn deciding_by_upper(self) -> Self {
        Self {
            upper: true,
            ..self
        }
    }

    /// The least number.
    pub fn lo(self) -> f64 {
        self.lo
    }

    /// The greatest number.
    pub fn hi(self) -> f64 {
        self.hi
    }

    /// A number in the middle; of the whole line zero.
    pub fn middle(self) -> f64 {
        let middle = 0.5 * self.lo + 0.5 * self.hi;
        if middle.is_finite() { middle } else { 0.0 }
    }

    /// How long it is, at least.
    pub fn width(self) -> f64 {
        self.hi - self.lo
    }

    /// The greatest absolute value.
    pub fn magnitude(self) -> f64 {
        f64::max(-self.lo, self.hi)
    }

    /// Whether `x` is one of its numbers.
    pub fn contains(self, x: f64) -> bool {
        self.lo <= x && x <= self.hi
    }

    /// The smallest interval with the numbers of both.
    #[must_use]
    pub fn hull(self, o: Self) -> Self {
        let (lo, hi) = (f64::min(self.lo, o.lo), f64::max(self.hi, o.hi));
        Self::of_both(lo, hi, self.upper || o.upper)
    }

    /// The numbers of both; its own where there are none.
    #[must_use]
    pub fn and(self, o: Self) -> Self {
        let (lo, hi) = (f64::max(self.lo, o.lo), f64::min(self.hi, o.hi));
        if lo <= hi {
            Self { lo, hi, ..self }
        } else {
            self
        }
    }

    #[inline(always)]
    fn of_both(lo: f64, hi: f64, upper: bool) -> Self {
        let right = lo <= hi;
        Self {
            lo: if right { lo } else { f64::NEG_INFINITY },
            hi: if right { hi } else { f64::INFINITY },
            upper,
        }
    }

    /// Of bounds with one rounding each: half a unit in the last place, of which this takes one or two.
    #[inline(always)]
    fn outwards(lo: f64, hi: f64, upper: bool) -> Self {
        Self::of_both(below(lo), above(hi), upper)
    }

    /// Of bounds from the system's library, of a function with values between `least` and `most`.
    fn by_library(self, lo: f64, hi: f64, [least, most]: [f64; 2]) -> Self {
        let off = |x: f64| x.abs() * LIBRARY + f64::MIN_POSITIVE;
        // Written so that NaN becomes the whole line.
        let (lo, hi) = (lo - off(lo), hi + off(hi));
        let lo = if lo < least { least } else { lo };
        let hi = if hi > most { most } else { hi };
        Self::of_both(lo, hi, self.upper)
    }

    fn increasing(self, f: impl Fn(f64) -> f64, range: [f64; 2]) -> Self {
        self.by_library(f(self.lo), f(self.hi), range)
    }

    fn line(self) -> Self {
        Self {
            upper: self.upper,
            ..Self::LINE
        }
    }

    /// Whether it has a number `at + k period` with a whole `k`, or nearly; also if that is not to be known.
    fn meets(self, at: f64, period: f64) -> bool {
        let slack = 8.0 * f64::EPSILON * (self.magnitude() + period);
        let k = ((self.lo - slack - at) / period).ceil();
        let beyond = at + k * period > self.hi + slack;
        !beyond
    }

    /// Of the products or quotients of bounds. Some may be none: zero times infinity, where zero is among the others, and infinity
    /// over infinity, where both are.
    #[inline(always)]
    fn spanning([a, b, c, d]: [f64; 4], upper: bool) -> Self {
        let lo = f64::min(f64::min(a, b), f64::min(c, d));
        let hi = f64::max(f64::max(a, b), f64::max(c, d));
        Self::outwards(lo, hi, upper)
    }
}

/// A number below another, by more than a rounding.
#[inline(always)]
fn below(x: f64) -> f64 {
    x - (x.abs() * f64::EPSILON + TINY)
}

/// A number above another, by more than a rounding.
#[inline(always)]
fn above(x: f64) -> f64 {
    x + (x.abs() * f64::EPSILON + TINY)
}

impl PartialEq for Interval {
    fn eq(&self, o: &Self) -> bool {
        self.lo == o.lo && self.hi == o.hi
    }
}

impl PartialOrd for Interval {
    fn partial_cmp(&self, o: &Self) -> Option<Ordering> {
        if self.upper || o.upper {
            self.hi.partial_cmp(&o.lo)
        } else {
            self.lo.partial_cmp(&o.hi)
        }
    }
}

impl Neg for Interval {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self {
            lo: -self.hi,
            hi: -self.lo,
            upper: self.upper,
        }
    }
}

impl Add for Interval {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self::outwards(self.lo + o.lo, self.hi + o.hi, self.upper || o.upper)
    }
}

impl Sub for Interval {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self::outwards(self.lo - o.hi, self.hi - o.lo, self.upper || o.upper)
    }
}

impl Mul for Interval {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        let all = [
            self.lo * o.lo,
            self.lo * o.hi,
            self.hi * o.lo,
            self.hi * o.hi,
        ];
        Self::spanning(all, self.upper || o.upper)
    }
}

impl Div for Interval {
    type Output = Self;
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        let upper = self.upper || o.upper;
        if o.contains(0.0) {
            return Self {
                upper,
                ..Self::LINE
            };
        }
        let all = [
            self.lo / o.lo,
            self.lo / o.hi,
            self.hi / o.lo,
            self.hi / o.hi,
        ];
        Self::spanning(all, upper)
    }
}

macro_rules! with_constants {
    ($($op:ident $f:ident $sym:tt, $assign:ident $g:ident);*) => {$(
        impl $op<Const<f64>> for Interval {
            type Output = Self;
            #[inline(always)]
            fn $f(self, c: Const<f64>) -> Self {
                self $sym Self::lift(c.0)
            }
        }
        impl $assign for Interval {
            #[inline(always)]
            fn $g(&mut self, o: Self) {
                *self = *self $sym o;
            }
        }
    )*};
}
with_constants!(Add add +, AddAssign add_assign; Sub sub -, SubAssign sub_assign;
    Mul mul *, MulAssign mul_assign; Div div /, DivAssign div_assign);

impl Sum for Interval {
    fn sum<I: Iterator<Item = Self>>(iter: I) -> Self {
        iter.fold(Self::zero(), |a, b| a + b)
    }
}

impl TangentLanes for Interval {
    #[inline(always)]
    fn add<const N: usize>(a: [Self; N], b: [Self; N]) -> [Self; N] {
        array(|k| a[k] + b[k])
    }
    #[inline(always)]
    fn sub<const N: usize>(a: [Self; N], b: [Self; N]) -> [Self; N] {
        array(|k| a[k] - b[k])
    }
    #[inline(always)]
    fn scale<const N: usize>(a: [Self; N], s: Self) -> [Self; N] {
        array(|k| a[k] * s)
    }
    #[inline(always)]
    fn scale_const<const N: usize>(a: [Self; N], c: Const<f64>) -> [Self; N] {
        array(|k| a[k] * c)
    }
    #[inline(always)]
    fn combine<const N: usize>(a: [Self; N], s: Self, b: [Self; N], t: Self) -> [Self; N] {
        array(|k| a[k] * s + b[k] * t)
    }
    #[inline(always)]
    fn combine_add<const N: usize>(a: [Self; N], s: Self, b: [Self; N]) -> [Self; N] {
        array(|k| a[k] * s + b[k])
    }
}

const ALL: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];
const POSITIVE: [f64; 2] = [0.0, f64::INFINITY];

impl Real for Interval {
    type Primal = f64;
    const IS_PRIMAL: bool = true;

    #[inline(always)]
    fn lift(x: f64) -> Self {
        Self::of_both(x, x, false)
    }
    #[inline(always)]
    fn primal(self) -> f64 {
        if self.upper { self.hi } else { self.lo }
    }
    #[inline(always)]
    fn detach(self) -> Self {
        self
    }
    #[inline(always)]
    fn has_tangent(self) -> bool {
        false
    }
    #[inline(always)]
    fn is_finite(self) -> bool {
        true
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        if self.lo < 0.0 {
            return self.line();
        }
        let lo = f64::max(below(self.lo.sqrt()), 0.0);
        Self::of_both(lo, above(self.hi.sqrt()), self.upper)
    }
    fn cbrt(self) -> Self {
        self.increasing(f64::cbrt, ALL)
    }
    #[inline(always)]
    fn recip(self) -> Self {
        Self::lift(1.0) / self
    }
    #[inline(always)]
    fn div_into(self, c: Const<f64>) -> Self {
        Self::lift(c.0) / self
    }
    fn exp(self) -> Self {
        self.increasing(f64::exp, POSITIVE)
    }
    fn exp_m1(self) -> Self {
        self.increasing(f64::exp_m1, [-1.0, f64::INFINITY])
    }
    fn ln(self) -> Self {
        self.increasing(f64::ln, ALL)
    }
    fn ln_1p(self) -> Self {
        self.increasing(f64::ln_1p, ALL)
    }
    fn sin(self) -> Self {
        let (a, b) = (self.lo.sin(), self.hi.sin());
        let least = if self.meets(-FRAC_PI_2, TAU) {
            -1.0
        } else {
            f64::min(a, b)
        };
        let most = if self.meets(FRAC_PI_2, TAU) {
            1.0
        } else {
            f64::max(a, b)
        };
        self.by_library(least, most, [-1.0, 1.0])
    }
    fn cos(self) -> Self {
        let (a, b) = (self.lo.cos(), self.hi.cos());
        let least = if self.meets(PI, TAU) {
            -1.0
        } else {
            f64::min(a, b)
        };
        let most = if self.meets(0.0, TAU) {
            1.0
        } else {
            f64::max(a, b)
        };
        self.by_library(least, most, [-1.0, 1.0])
    }
    fn sin_cos(self) -> (Self, Self) {
        (self.sin(), self.cos())
    }
    fn tan(self) -> Self {
        if self.meets(FRAC_PI_2, PI) {
            return self.line();
        }
        self.increasing(f64::tan, ALL)
    }
    fn asin(self) -> Self {
        self.increasing(f64::asin, ALL)
    }
    fn acos(self) -> Self {
        self.by_library(self.hi.acos(), self.lo.acos(), ALL)
    }
    fn atan(self) -> Self {
        self.increasing(f64::atan, ALL)
    }
    /// Half turns apart where the box contains the origin or some of the half line `self = 0`, `x < 0`.
    fn atan2(self, x: Self) -> Self {
        let upper = self.upper || x.upper;
        let flagged = Self { upper, ..self };
        if self.contains(0.0) && x.lo <= 0.0 {
            return flagged.by_library(-PI, PI, ALL);
        }
        // Extreme at corners, of which those count that the box looks widest from.
        let corners = [
            self.lo.atan2(x.lo),
            self.lo.atan2(x.hi),
            self.hi.atan2(x.lo),
            self.hi.atan2(x.hi),
        ];
        let lo = corners.iter().fold(f64::INFINITY, |m, x| f64::min(m, *x));
        let hi = corners
            .iter()
            .fold(f64::NEG_INFINITY, |m, x| f64::max(m, *x));
        flagged.by_library(lo, hi, ALL)
    }
    fn sinh(self) -> Self {
        self.increasing(f64::sinh, ALL)
    }
    fn cosh(self) -> Self {
        let (a, b) = (self.lo.cosh(), self.hi.cosh());
        let least = if self.contains(0.0) {
            1.0
        } else {
            f64::min(a, b)
        };
        self.by_library(least, f64::max(a, b), [1.0, f64::INFINITY])
    }
    fn tanh(self) -> Self {
        self.increasing(f64::tanh, [-1.0, 1.0])
    }
    fn powi(self, n: i32) -> Self {
        let (mut rest, mut square, mut power) = (n.unsigned_abs(), self, Self::lift(1.0));
        power.upper = self.upper;
        while rest > 0 {
            if rest % 2 == 1 {
                power *= square;
            }
            square = square.square();
            rest /= 2;
        }
        if n < 0 { power.recip() } else { power }
    }
    /// The whole line where the base is not positive.
    fn powf(self, y: Self) -> Self {
        if self.lo <= 0.0 {
            return Self {
                upper: self.upper || y.upper,
                ..Self::LINE
            };
        }
        (self.ln() * y).exp()
    }
    fn hypot(self, y: Self) -> Self {
        (self.square() + y.square()).sqrt()
    }
    #[inline(always)]
    fn abs(self) -> Self {
        if self.lo >= 0.0 {
            self
        } else if self.hi <= 0.0 {
            -self
        } else {
            Self {
                lo: 0.0,
                hi: self.magnitude(),
                upper: self.upper,
            }
        }
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        let (lo, hi) = (f64::min(self.lo, o.lo), f64::min(self.hi, o.hi));
        Self::of_both(lo, hi, self.upper || o.upper)
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        let (lo, hi) = (f64::max(self.lo, o.lo), f64::max(self.hi, o.hi));
        Self::of_both(lo, hi, self.upper || o.upper)
    }
    fn signum(self) -> Self {
        Self::of_both(self.lo.signum(), self.hi.signum(), self.upper)
    }
    fn erf(self) -> Self {
        self.increasing(libm::erf, [-1.0, 1.0])
    }
    fn rem_euclid(self, m: Const<f64>) -> Self {
        let m = m.0;
        let period = m.abs();
        if self.meets(0.0, period) {
            return Self::of_both(0.0, period, self.upper);
        }
        Self::outwards(self.lo.rem_euclid(m), self.hi.rem_euclid(m), self.upper)
    }
    #[inline(always)]
    fn square(self) -> Self {
        let x = self.abs();
        let lo = f64::max(below(x.lo * x.lo), 0.0);
        Self::of_both(lo, above(x.hi * x.hi), self.upper)
    }
}
