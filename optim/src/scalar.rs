//! The two scalar types of parameters: f32 and f64.

use std::fmt::{Debug, Display};
use std::ops::{Add, Div, Mul, Neg, Sub};

pub(crate) mod sealed {
    /// Keeps [`Scalar`](super::Scalar) to f32 and f64, and gives access to their bits.
    pub trait Sealed: Sized {
        /// Hexadecimal digits of the bit pattern.
        const DIGITS: usize;
        /// The bit pattern, zero-extended.
        fn bits(self) -> u64;
        /// The inverse of [`bits`](Self::bits); `None` where the pattern is too wide.
        fn of_bits(bits: u64) -> Option<Self>;
    }
}

/// A floating-point type that parameters and gradients are stored in: f32 or f64.
pub trait Scalar:
    sealed::Sealed
    + Copy
    + Debug
    + Display
    + Default
    + PartialEq
    + PartialOrd
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// Largest finite value.
    const MAX: Self;
    /// Smallest positive normal value.
    const MIN_POSITIVE: Self;
    /// The nearest value of this type.
    fn from_f64(x: f64) -> Self;
    /// The same value in double precision.
    fn to_f64(self) -> f64;
    /// Neither NaN nor infinite.
    fn is_finite(self) -> bool;
    /// Square root.
    fn sqrt(self) -> Self;
}

macro_rules! scalar {
    ($t:ty, $bits:ty, $digits:literal) => {
        impl sealed::Sealed for $t {
            const DIGITS: usize = $digits;
            fn bits(self) -> u64 {
                self.to_bits().into()
            }
            fn of_bits(bits: u64) -> Option<Self> {
                <$bits>::try_from(bits).ok().map(Self::from_bits)
            }
        }
        impl Scalar for $t {
            const MAX: Self = <$t>::MAX;
            const MIN_POSITIVE: Self = <$t>::MIN_POSITIVE;
            fn from_f64(x: f64) -> Self {
                x as $t
            }
            fn to_f64(self) -> f64 {
                self.into()
            }
            fn is_finite(self) -> bool {
                <$t>::is_finite(self)
            }
            fn sqrt(self) -> Self {
                <$t>::sqrt(self)
            }
        }
    };
}

scalar!(f32, u32, 8);
scalar!(f64, u64, 16);
