//! Linear RGB triples.

use std::ops::{Add, AddAssign, Div, Index, Mul, Neg, Sub};

use ad_core::{Const, Float, Real};

use super::each;

/// A linear RGB colour: reflectance, radiance or a weight, one scalar per channel.
///
/// All arithmetic is channel by channel. That is what makes one tangent direction enough for an
/// RGB parameter: see [`crate::params`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rgb<R> {
    /// Red.
    pub r: R,
    /// Green.
    pub g: R,
    /// Blue.
    pub b: R,
}

/// What the channels count in relative luminance (Rec. 709).
pub const LUMINANCE: [f64; 3] = [0.212_671, 0.715_160, 0.072_169];

/// Linear sRGB of CIE XYZ (ITU-R BT.709), to the digits that Mitsuba has.
const XYZ_TO_RGB: [[f64; 3]; 3] = [
    [3.240_479, -1.537_150, -0.498_535],
    [-0.969_256, 1.875_991, 0.041_556],
    [0.055_648, -0.204_043, 1.057_311],
];

/// The linear RGB of a colour in CIE XYZ; outside of the gamut channels are negative.
pub fn rgb_of_xyz(xyz: [f64; 3]) -> [f64; 3] {
    XYZ_TO_RGB.map(|row| (0..3).map(|c| row[c] * xyz[c]).sum())
}

impl<R: Real> Rgb<R> {
    /// From three channels.
    #[inline]
    pub fn new(r: R, g: R, b: R) -> Self {
        Self { r, g, b }
    }

    /// The same value in every channel.
    #[inline]
    pub fn splat(x: R) -> Self {
        Self::new(x, x, x)
    }

    /// Zero.
    #[inline]
    pub fn black() -> Self {
        Self::splat(R::zero())
    }

    /// A constant colour: zero tangents.
    #[inline]
    pub fn lift(c: Rgb<R::Primal>) -> Self {
        Self::new(R::lift(c.r), R::lift(c.g), R::lift(c.b))
    }

    /// The values without their tangents.
    #[inline]
    pub fn primal(self) -> Rgb<R::Primal> {
        Rgb {
            r: self.r.primal(),
            g: self.g.primal(),
            b: self.b.primal(),
        }
    }

    /// Every channel times a constant: no tangent work.
    #[inline]
    pub fn scale(self, s: R::Primal) -> Self {
        self.map(|c| c * Const(s))
    }

    /// `a` if `cond` holds, else `b`: no branch.
    #[inline(always)]
    pub fn select(cond: bool, a: Self, b: Self) -> Self {
        Self {
            r: R::select(cond, a.r, b.r),
            g: R::select(cond, a.g, b.g),
            b: R::select(cond, a.b, b.b),
        }
    }

    /// Applies `f` to every channel.
    #[inline(always)]
    pub fn map<S>(self, mut f: impl FnMut(R) -> S) -> Rgb<S> {
        Rgb {
            r: f(self.r),
            g: f(self.g),
            b: f(self.b),
        }
    }

    /// The channels as `[r, g, b]`.
    #[inline]
    pub fn to_array(self) -> [R; 3] {
        [self.r, self.g, self.b]
    }

    /// Sum of the channels.
    #[inline]
    pub fn sum(self) -> R {
        self.r + self.g + self.b
    }

    /// Mean of the channels.
    #[inline]
    pub fn mean(self) -> R {
        self.sum() * R::c(1.0 / 3.0)
    }

    /// Relative luminance ([`LUMINANCE`]).
    #[inline]
    pub fn luminance(self) -> R {
        let [r, g, b] = each(LUMINANCE, R::c);
        self.r * r + self.g * g + self.b * b
    }

    /// Whether every primal channel is zero.
    #[inline]
    pub fn is_black(self) -> bool {
        let zero = R::Primal::zero();
        self.r.primal() == zero && self.g.primal() == zero && self.b.primal() == zero
    }

    /// Whether every value and every tangent is finite.
    #[inline]
    pub fn is_finite(self) -> bool {
        self.r.is_finite() && self.g.is_finite() && self.b.is_finite()
    }
}

impl<P: Float> Rgb<P> {
    /// Largest channel.
    #[inline]
    pub fn max_component(self) -> P {
        self.r.max(self.g).max(self.b)
    }

    /// Converts from any array of `f32` or `f64`.
    pub fn of(c: [f64; 3]) -> Self {
        Self::new(P::of(c[0]), P::of(c[1]), P::of(c[2]))
    }

    /// The channels in f64.
    #[inline]
    pub fn to_f64(self) -> [f64; 3] {
        [self.r.to_f64(), self.g.to_f64(), self.b.to_f64()]
    }
}

impl<R> Index<usize> for Rgb<R> {
    type Output = R;
    #[inline]
    fn index(&self, i: usize) -> &R {
        match i {
            0 => &self.r,
            1 => &self.g,
            _ => &self.b,
        }
    }
}

impl<R> From<[R; 3]> for Rgb<R> {
    #[inline]
    fn from([r, g, b]: [R; 3]) -> Self {
        Self { r, g, b }
    }
}

macro_rules! channelwise {
    ($trait:ident, $method:ident, $op:tt) => {
        impl<R: Real> $trait for Rgb<R> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                Self::new(self.r $op o.r, self.g $op o.g, self.b $op o.b)
            }
        }
    };
}
channelwise!(Add, add, +);
channelwise!(Sub, sub, -);
channelwise!(Mul, mul, *);
channelwise!(Div, div, /);

impl<R: Real> Mul<R> for Rgb<R> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, s: R) -> Self {
        self.map(|c| c * s)
    }
}

impl<R: Real> Neg for Rgb<R> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|c| -c)
    }
}

impl<R: Real> AddAssign for Rgb<R> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
