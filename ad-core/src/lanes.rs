//! Arithmetic on arrays of tangents, in vector registers where the scalar is a machine number.
//!
//! Left to itself the compiler splits an array of tangents into scalars and then re-packs some of
//! them with shuffles; explicit vector types halve the cost of a gradient.

use crate::real::{Const, Real, array};

use wide::{f32x4, f32x8, f64x2, f64x4};

/// Tangent arithmetic of a scalar type; an implementation detail of [`Real`](crate::Real).
pub trait TangentLanes: Sized + Copy {
    /// `a + b`
    fn add<const N: usize>(a: [Self; N], b: [Self; N]) -> [Self; N];
    /// `a - b`
    fn sub<const N: usize>(a: [Self; N], b: [Self; N]) -> [Self; N];
    /// `s a`
    fn scale<const N: usize>(a: [Self; N], s: Self) -> [Self; N];
    /// `c a` for a constant
    fn scale_const<const N: usize>(a: [Self; N], c: Const<Self::Primal>) -> [Self; N]
    where
        Self: Real;
    /// `s a + b`
    fn combine_add<const N: usize>(a: [Self; N], s: Self, b: [Self; N]) -> [Self; N];
    /// `s a + t b`
    fn combine<const N: usize>(a: [Self; N], s: Self, b: [Self; N], t: Self) -> [Self; N];
}

/// Applies one expression to chunks of `$W`, of `$H` and to single elements.
macro_rules! map_lanes {
    ($t:ident, $H:literal $h:ident, $W:literal $w:ident, $N:ident; |$($a:ident),*; $($s:ident),*| $e:expr) => {{
        let mut out = [0.0; $N];
        let mut k = 0;
        while k + $W <= $N {
            $(let $a = $w::new(array(|j| $a[k + j]));)*
            $(let $s = $w::splat($s);)*
            let r: $w = $e;
            let r = r.to_array();
            // Slices are copied by a call, for a few numbers.
            for (j, r) in r.iter().enumerate() {
                out[k + j] = *r;
            }
            k += $W;
        }
        if k + $H <= $N {
            $(let $a = $h::new(array(|j| $a[k + j]));)*
            $(let $s = $h::splat($s);)*
            let r: $h = $e;
            let r = r.to_array();
            for (j, r) in r.iter().enumerate() {
                out[k + j] = *r;
            }
            k += $H;
        }
        while k < $N {
            $(let $a = $a[k];)*
            out[k] = $e;
            k += 1;
        }
        out
    }};
}

/// `self * a + b`, in one rounding where the hardware can.
trait Fused {
    fn fused(self, a: Self, b: Self) -> Self;
}

macro_rules! fused {
    ($($t:ident)*) => {$(
        impl Fused for $t {
            #[inline(always)]
            fn fused(self, a: $t, b: $t) -> $t {
                if cfg!(target_feature = "fma") { self.mul_add(a, b) } else { self * a + b }
            }
        }
    )*};
}
fused!(f32 f32x4 f32x8 f64 f64x2 f64x4);

macro_rules! lanes {
    ($t:ident, $($chunks:tt)*) => {
        impl TangentLanes for $t {
            #[inline(always)]
            fn add<const N: usize>(a: [$t; N], b: [$t; N]) -> [$t; N] {
                map_lanes!($t, $($chunks)*, N; |a, b; | a + b)
            }
            #[inline(always)]
            fn sub<const N: usize>(a: [$t; N], b: [$t; N]) -> [$t; N] {
                map_lanes!($t, $($chunks)*, N; |a, b; | a - b)
            }
            #[inline(always)]
            fn scale<const N: usize>(a: [$t; N], s: $t) -> [$t; N] {
                map_lanes!($t, $($chunks)*, N; |a; s| a * s)
            }
            #[inline(always)]
            fn scale_const<const N: usize>(a: [$t; N], c: Const<$t>) -> [$t; N] {
                Self::scale(a, c.0)
            }
            #[inline(always)]
            fn combine_add<const N: usize>(a: [$t; N], s: $t, b: [$t; N]) -> [$t; N] {
                map_lanes!($t, $($chunks)*, N; |a, b; s| a.fused(s, b))
            }
            #[inline(always)]
            fn combine<const N: usize>(a: [$t; N], s: $t, b: [$t; N], t: $t) -> [$t; N] {
                map_lanes!($t, $($chunks)*, N; |a, b; s, t| a.fused(s, b * t))
            }
        }
    };
}

lanes!(f32, 4 f32x4, 8 f32x8);
lanes!(f64, 2 f64x2, 4 f64x4);
