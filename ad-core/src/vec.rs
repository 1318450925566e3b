//! Two- and three-component vectors over any [`Real`].

use std::ops::{Add, AddAssign, Div, Index, Mul, MulAssign, Neg, Sub, SubAssign};

use crate::real::{Const, Float, Real};

macro_rules! vector {
    ($(#[$doc:meta])* $V:ident, $n:literal, $($f:ident = $i:tt),*) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct $V<R> {
            $(
                #[doc = concat!("Component `", stringify!($f), "`.")]
                pub $f: R,
            )*
        }

        impl<R> $V<R> {
            /// A vector from its components.
            #[inline(always)]
            pub const fn new($($f: R),*) -> Self {
                Self { $($f),* }
            }
            /// Applies `f` to every component.
            #[inline(always)]
            pub fn map<S>(self, mut f: impl FnMut(R) -> S) -> $V<S> {
                $V { $($f: f(self.$f)),* }
            }
            /// The components as an array.
            #[inline(always)]
            pub fn to_array(self) -> [R; $n] {
                [$(self.$f),*]
            }
        }

        impl<R: Real> $V<R> {
            /// All components equal to `x`.
            #[inline(always)]
            pub fn splat(x: R) -> Self {
                Self { $($f: x),* }
            }
            /// The zero vector.
            #[inline(always)]
            pub fn zero() -> Self {
                Self::splat(R::zero())
            }
            /// A constant vector, with zero tangent.
            #[inline(always)]
            pub fn lift(v: $V<R::Primal>) -> Self {
                v.map(R::lift)
            }
            /// The values, stripped of tangents.
            #[inline(always)]
            pub fn primal(self) -> $V<R::Primal> {
                self.map(R::primal)
            }
            /// The same values with zero tangent.
            #[inline(always)]
            pub fn detach(self) -> Self {
                self.map(R::detach)
            }
            /// `a` if `cond` holds, else `b`: no branch.
            #[inline(always)]
            pub fn select(cond: bool, a: Self, b: Self) -> Self {
                Self { $($f: R::select(cond, a.$f, b.$f)),* }
            }
            /// Inner product.
            #[inline(always)]
            pub fn dot(self, o: Self) -> R {
                vector!(@sum $(self.$f * o.$f),*)
            }
            /// Inner product with a constant vector: no work on tangents of the second factor.
            #[inline(always)]
            pub fn dot_const(self, o: $V<R::Primal>) -> R {
                vector!(@sum $(self.$f * Const(o.$f)),*)
            }
            /// Euclidean length. Zero, with zero tangent, for the zero vector (and for vectors
            /// without a component of 16 times the smallest normal number).
            #[inline(always)]
            pub fn length(self) -> R {
                let l2 = self.length_squared();
                if well_scaled(l2) {
                    return l2.sqrt();
                }
                let m = self.primal().magnitude();
                if m > R::Primal::zero() && m.is_finite() {
                    (self * Const(m.recip())).length_squared().sqrt() * Const(m)
                } else {
                    R::lift(m)
                }
            }
            /// Squared Euclidean length.
            #[inline(always)]
            pub fn length_squared(self) -> R {
                vector!(@sum $(self.$f.square()),*)
            }
            /// Unit vector of the same direction. Vectors of [`length`](Self::length) zero and
            /// infinite ones map to zero, with zero tangent.
            #[inline(always)]
            pub fn normalize(self) -> Self {
                let (unit, right) = self.unit();
                if right {
                    return unit;
                }
                let m = self.primal().magnitude();
                if !(m > R::Primal::zero() && m.is_finite()) {
                    return Self::zero();
                }
                (self * Const(m.recip())).unit().0
            }
            /// [`normalize`](Self::normalize), and whether that is right: for vectors whose squared length is a
            /// normal number. Without branches, for loops over many vectors.
            #[inline(always)]
            pub fn unit(self) -> (Self, bool) {
                let l2 = self.length_squared();
                (self * l2.sqrt().recip(), well_scaled(l2))
            }
            /// Largest absolute component; zero if so small that the derivative of the direction,
            /// 1 / length, would overflow.
            #[cold]
            fn magnitude(self) -> R {
                let m = self.max_abs();
                let least = R::Primal::MIN_POSITIVE * <R::Primal as Real>::of(16.0);
                R::select(m.primal() >= least, m, R::zero())
            }
            /// Componentwise linear interpolation, `self` at `t = 0` and `o` at `t = 1`.
            #[inline(always)]
            pub fn lerp(self, o: Self, t: R) -> Self {
                self + (o - self) * t
            }
            /// Smallest component.
            #[inline(always)]
            pub fn min_component(self) -> R {
                vector!(@fold min $(self.$f),*)
            }
            /// Largest component.
            #[inline(always)]
            pub fn max_component(self) -> R {
                vector!(@fold max $(self.$f),*)
            }
            /// Largest absolute value of a component.
            #[inline(always)]
            pub fn max_abs(self) -> R {
                vector!(@fold max $(self.$f.abs()),*)
            }
            /// Componentwise minimum.
            #[inline(always)]
            pub fn min(self, o: Self) -> Self {
                Self { $($f: self.$f.min(o.$f)),* }
            }
            /// Componentwise maximum.
            #[inline(always)]
            pub fn max(self, o: Self) -> Self {
                Self { $($f: self.$f.max(o.$f)),* }
            }
            /// Whether all values and tangents are finite.
            #[inline(always)]
            pub fn is_finite(self) -> bool {
                true $(&& self.$f.is_finite())*
            }
        }

        impl<R> From<[R; $n]> for $V<R> {
            #[inline(always)]
            fn from([$($f),*]: [R; $n]) -> Self {
                Self { $($f),* }
            }
        }

        impl<R> Index<usize> for $V<R> {
            type Output = R;
            #[inline(always)]
            fn index(&self, i: usize) -> &R {
                match i {
                    $($i => &self.$f,)*
                    _ => panic!("component {i} of a vector of {}", $n),
                }
            }
        }

        impl<R: Real> Neg for $V<R> {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                self.map(|x| -x)
            }
        }

        vector!(@op $V Add add + $($f)*);
        vector!(@op $V Sub sub - $($f)*);
        vector!(@op $V Mul mul * $($f)*);

        impl<R: Real> Mul<R> for $V<R> {
            type Output = Self;
            #[inline(always)]
            fn mul(self, s: R) -> Self {
                self.map(|x| x * s)
            }
        }
        impl<R: Real> Mul<Const<R::Primal>> for $V<R> {
            type Output = Self;
            #[inline(always)]
            fn mul(self, s: Const<R::Primal>) -> Self {
                self.map(|x| x * s)
            }
        }
        impl<R: Real> Div<R> for $V<R> {
            type Output = Self;
            #[inline(always)]
            fn div(self, s: R) -> Self {
                self.map(|x| x / s)
            }
        }
        impl<R: Real> Div<Const<R::Primal>> for $V<R> {
            type Output = Self;
            #[inline(always)]
            fn div(self, s: Const<R::Primal>) -> Self {
                self.map(|x| x / s)
            }
        }
        impl<R: Real> AddAssign for $V<R> {
            #[inline(always)]
            fn add_assign(&mut self, o: Self) {
                *self = *self + o;
            }
        }
        impl<R: Real> SubAssign for $V<R> {
            #[inline(always)]
            fn sub_assign(&mut self, o: Self) {
                *self = *self - o;
            }
        }
        impl<R: Real> MulAssign for $V<R> {
            #[inline(always)]
            fn mul_assign(&mut self, o: Self) {
                *self = *self * o;
            }
        }
        impl<R: Real> MulAssign<R> for $V<R> {
            #[inline(always)]
            fn mul_assign(&mut self, s: R) {
                *self = *self * s;
            }
        }
        impl<R: Real> std::iter::Sum for $V<R> {
            #[inline]
            fn sum<I: Iterator<Item = Self>>(iter: I) -> Self {
                iter.fold(Self::zero(), |a, b| a + b)
            }
        }
    };
    (@op $V:ident $Op:ident $op:ident $sym:tt $($f:ident)*) => {
        impl<R: Real> $Op for $V<R> {
            type Output = Self;
            /// Componentwise.
            #[inline(always)]
            fn $op(self, o: Self) -> Self {
                Self { $($f: self.$f $sym o.$f),* }
            }
        }
    };
    (@sum $a:expr $(, $b:expr)*) => { $a $(+ $b)* };
    (@fold $f:ident $a:expr $(, $b:expr)*) => { $a$(.$f($b))* };
}

/// Whether a squared length is a normal number with digits to spare.
#[inline(always)]
fn well_scaled<R: Real>(l2: R) -> bool {
    (l2.primal() > R::Primal::MIN_POSITIVE / R::Primal::EPSILON) & (l2.primal() <= R::Primal::MAX)
}

vector!(
    /// A vector of two components.
    Vec2, 2, x = 0, y = 1
);
vector!(
    /// A vector of three components: a point, a direction, or a linear RGB colour.
    Vec3, 3, x = 0, y = 1, z = 2
);

impl<R: Real> Vec2<R> {
    /// The determinant of the matrix with columns `self` and `o`.
    #[inline(always)]
    pub fn perp_dot(self, o: Self) -> R {
        self.x * o.y - self.y * o.x
    }
}

impl<R: Real> Vec3<R> {
    /// Right-handed cross product.
    #[inline(always)]
    pub fn cross(self, o: Self) -> Self {
        Self {
            x: self.y * o.z - self.z * o.y,
            y: self.z * o.x - self.x * o.z,
            z: self.x * o.y - self.y * o.x,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Dual;

    #[test]
    fn zero_vector_has_zero_tangents() {
        let x = std::array::from_fn(|i| Dual::<f32, 3>::var(0.0, i));
        let v = Vec3::from(x);
        assert_eq!(v.length().eps, [0.0; 3]);
        assert!(v.normalize().is_finite() && !v.normalize().x.has_tangent());
    }

    #[test]
    fn normalize_of_tiny_and_huge() {
        for s in [1e-36f32, 1e-30, 1.0, 1e30, 3e38] {
            let v = Vec3::new(0.6 * s, 0.0, 0.8 * s).normalize();
            assert!((v.length() - 1.0).abs() < 1e-3, "{s:e}: {v:?}");
        }
    }
}
