//! Forward-mode dual numbers with `N` tangents; nesting gives second and higher orders.

use std::cmp::Ordering;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

use crate::elementary;
use crate::lanes::TangentLanes;
use crate::real::{Const, Real, array};

/// A value and its derivatives along `N` directions: `re + sum_i eps[i] e_i` with `e_i e_j = 0`.
///
/// `P` is `f32`, `f64` or another `Dual`; `Dual<Dual<f64, N>, M>` carries `N x M` second
/// derivatives. Equality and order compare the primal part only.
///
/// ```
/// use ad_core::{Dual, Real};
/// let x = Dual::<f64, 1>::var(2.0, 0);
/// let y = x * x.exp();
/// assert_eq!(y.eps[0], 3.0 * 2f64.exp());
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Dual<P, const N: usize> {
    /// The value.
    pub re: P,
    /// The tangents: derivatives of the value along each of the `N` directions.
    pub eps: [P; N],
}

impl<P: Real, const N: usize> Dual<P, N> {
    /// A value with explicit tangents.
    #[inline(always)]
    pub fn new(re: P, eps: [P; N]) -> Self {
        Self { re, eps }
    }

    /// A constant of the inner scalar: keeps inner tangents, has none of its own.
    #[inline(always)]
    pub fn constant(re: P) -> Self {
        Self {
            re,
            eps: [P::zero(); N],
        }
    }

    /// The `i`-th independent variable: tangent 1 along direction `i`. An `i` of `N` or more gives
    /// a constant, which is how inputs are processed in chunks of `N`.
    #[inline(always)]
    pub fn var(re: P, i: usize) -> Self {
        Self {
            re,
            eps: array(|k| if k == i { P::one() } else { P::zero() }),
        }
    }

    /// Chain rule of a function of one argument: value `y`, derivative `slope`.
    #[inline(always)]
    pub fn chain(self, y: P, slope: P) -> Self {
        Self {
            re: y,
            eps: P::scale(self.eps, slope),
        }
    }

    /// Chain rule of a function of two arguments: value `y`, derivatives `da` and `db`.
    #[inline(always)]
    pub fn chain2(a: Self, b: Self, y: P, da: P, db: P) -> Self {
        let eps = P::combine(a.eps, da, b.eps, db);
        Self { re: y, eps }
    }
}

impl<P: Real, const N: usize> Default for Dual<P, N> {
    #[inline]
    fn default() -> Self {
        Self::constant(P::zero())
    }
}

impl<P: Real, const N: usize> PartialEq for Dual<P, N> {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        self.re == other.re
    }
}

impl<P: Real, const N: usize> PartialOrd for Dual<P, N> {
    #[inline(always)]
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        self.re.partial_cmp(&other.re)
    }
    #[inline(always)]
    fn lt(&self, other: &Self) -> bool {
        self.re < other.re
    }
    #[inline(always)]
    fn le(&self, other: &Self) -> bool {
        self.re <= other.re
    }
    #[inline(always)]
    fn gt(&self, other: &Self) -> bool {
        self.re > other.re
    }
    #[inline(always)]
    fn ge(&self, other: &Self) -> bool {
        self.re >= other.re
    }
}

impl<P: Real, const N: usize> Neg for Dual<P, N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self {
            re: -self.re,
            eps: array(|k| -self.eps[k]),
        }
    }
}

impl<P: Real, const N: usize> Add for Dual<P, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self {
            re: self.re + o.re,
            eps: <P as TangentLanes>::add(self.eps, o.eps),
        }
    }
}

impl<P: Real, const N: usize> Sub for Dual<P, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self {
            re: self.re - o.re,
            eps: <P as TangentLanes>::sub(self.eps, o.eps),
        }
    }
}

impl<P: Real, const N: usize> Mul for Dual<P, N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self::chain2(self, o, self.re * o.re, o.re, self.re)
    }
}

impl<P: Real, const N: usize> Div for Dual<P, N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        let (q, da, db) = elementary::div(self.re, o.re);
        Self::chain2(self, o, q, da, db)
    }
}

impl<P: Real, const N: usize> Add<Const<P::Primal>> for Dual<P, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, c: Const<P::Primal>) -> Self {
        Self {
            re: self.re + c,
            eps: self.eps,
        }
    }
}

impl<P: Real, const N: usize> Sub<Const<P::Primal>> for Dual<P, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, c: Const<P::Primal>) -> Self {
        Self {
            re: self.re - c,
            eps: self.eps,
        }
    }
}

impl<P: Real, const N: usize> Mul<Const<P::Primal>> for Dual<P, N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, c: Const<P::Primal>) -> Self {
        Self {
            re: self.re * c,
            eps: P::scale_const(self.eps, c),
        }
    }
}

impl<P: Real, const N: usize> Div<Const<P::Primal>> for Dual<P, N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, c: Const<P::Primal>) -> Self {
        let (re, slope) = elementary::div_const(self.re, c);
        Self {
            re,
            eps: P::scale_const(self.eps, slope),
        }
    }
}

macro_rules! assign {
    ($($op:ident $f:ident $sym:tt),*) => {$(
        impl<P: Real, const N: usize> $op for Dual<P, N> {
            #[inline(always)]
            fn $f(&mut self, o: Self) {
                *self = *self $sym o;
            }
        }
    )*};
}
assign!(AddAssign add_assign +, SubAssign sub_assign -, MulAssign mul_assign *, DivAssign div_assign /);

impl<P: Real, const N: usize> Sum for Dual<P, N> {
    #[inline]
    fn sum<I: Iterator<Item = Self>>(iter: I) -> Self {
        iter.fold(Self::default(), |a, b| a + b)
    }
}

macro_rules! chain_rule {
    ($($f:ident)*) => {$(
        #[inline]
        fn $f(self) -> Self {
            let (y, slope) = elementary::$f(self.re);
            self.chain(y, slope)
        }
    )*};
}

impl<P: Real, const M: usize> TangentLanes for Dual<P, M> {
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
    fn scale_const<const N: usize>(a: [Self; N], c: Const<<Self as Real>::Primal>) -> [Self; N] {
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

impl<P: Real, const N: usize> Real for Dual<P, N> {
    type Primal = P::Primal;
    const IS_PRIMAL: bool = false;

    #[inline(always)]
    fn lift(x: P::Primal) -> Self {
        Self::constant(P::lift(x))
    }
    #[inline(always)]
    fn primal(self) -> P::Primal {
        self.re.primal()
    }
    #[inline(always)]
    fn detach(self) -> Self {
        Self::constant(self.re.detach())
    }
    #[inline(always)]
    fn has_tangent(self) -> bool {
        self.re.has_tangent() || self.eps.iter().any(|e| *e != P::zero() || e.has_tangent())
    }
    #[inline(always)]
    fn is_finite(self) -> bool {
        self.re.is_finite() && self.eps.iter().all(|e| e.is_finite())
    }

    chain_rule!(sqrt cbrt exp exp_m1 ln ln_1p tan asin acos atan tanh abs erf);

    #[inline(always)]
    fn recip(self) -> Self {
        let (y, slope) = elementary::recip(self.re);
        self.chain(y, slope)
    }
    #[inline(always)]
    fn div_into(self, c: Const<P::Primal>) -> Self {
        let (y, slope) = elementary::div_into(self.re, c);
        self.chain(y, slope)
    }
    #[inline]
    fn sin(self) -> Self {
        let (s, c) = self.re.sin_cos();
        self.chain(s, elementary::finite(c))
    }
    #[inline]
    fn cos(self) -> Self {
        let (s, c) = self.re.sin_cos();
        self.chain(c, elementary::finite(-s))
    }
    #[inline]
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = self.re.sin_cos();
        (
            self.chain(s, elementary::finite(c)),
            self.chain(c, elementary::finite(-s)),
        )
    }
    #[inline]
    fn sinh(self) -> Self {
        self.chain(self.re.sinh(), elementary::finite(self.re.cosh()))
    }
    #[inline]
    fn cosh(self) -> Self {
        self.chain(self.re.cosh(), elementary::finite(self.re.sinh()))
    }
    #[inline]
    fn atan2(self, x: Self) -> Self {
        let (v, dy, dx) = elementary::atan2(self.re, x.re);
        Self::chain2(self, x, v, dy, dx)
    }
    #[inline]
    fn powi(self, n: i32) -> Self {
        let (y, slope) = elementary::powi(self.re, n);
        self.chain(y, slope)
    }
    #[inline]
    fn powf(self, y: Self) -> Self {
        if y.has_tangent() {
            let (v, dx, dy) = elementary::powf(self.re, y.re);
            Self::chain2(self, y, v, dx, dy)
        } else {
            let (v, dx) = elementary::powf_base(self.re, y.re);
            self.chain(v, dx)
        }
    }
    #[inline]
    fn hypot(self, y: Self) -> Self {
        let (v, dx, dy) = elementary::hypot(self.re, y.re);
        Self::chain2(self, y, v, dx, dy)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::select(elementary::takes_min(self.re, other.re), self, other)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::select(elementary::takes_max(self.re, other.re), self, other)
    }
    #[inline(always)]
    fn signum(self) -> Self {
        Self::lift(self.primal().signum())
    }
    #[inline]
    fn rem_euclid(self, m: Const<P::Primal>) -> Self {
        Self {
            re: self.re.rem_euclid(m),
            eps: self.eps,
        }
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        let eps = array(|k| self.eps[k].mul_add(a.re, a.eps[k].mul_add(self.re, b.eps[k])));
        Self {
            re: self.re.mul_add(a.re, b.re),
            eps,
        }
    }
    #[inline(always)]
    fn square(self) -> Self {
        self.chain(self.re.square(), self.re + self.re)
    }
}
