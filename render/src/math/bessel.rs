//! A modified Bessel function, over any scalar.

use std::f64::consts::PI;

use ad_core::Real;

use super::gauss::{exp_minus, is_single};

/// Up to here the power series is used, from here on that for large arguments.
const LARGE: f64 = 12.0;

/// `exp(-x) I_0(x)`, for `x` from zero: the modified Bessel function of the first kind and order zero without its growth. By
/// its power series and, from 12 on, by its asymptotic one: to rounding in single precision, and to 1e-10 in double
/// precision. Without a branch where nothing is differentiated, for loops over many; elsewhere one of both series is summed.
///
/// # Derivatives
/// In `x`.
#[inline(always)]
pub(crate) fn i0_scaled<R: Real>(x: R) -> R {
    let small = x.primal() < R::Primal::of(LARGE);
    if R::IS_PRIMAL {
        let large = R::of(LARGE);
        return R::select(small, near(x.min(large)), far(x.max(large)));
    }
    one_of_both(small, x)
}

/// Apart, because it is much for every number of tangents.
fn one_of_both<R: Real>(small: bool, x: R) -> R {
    if small { near(x) } else { far(x) }
}

/// The sum of `(x^2 / 4)^k / (k!)^2`, times `exp(-x)`.
#[inline(always)]
fn near<R: Real>(x: R) -> R {
    let y = x.square() * R::c(0.25);
    let series = if is_single::<R::Primal>() {
        series(&const { powers::<19>() }, y)
    } else {
        series(&const { powers::<27>() }, y)
    };
    series * exp_minus(x)
}

/// The sum of `((2k - 1)!!)^2 / (k! (8 x)^k)`, over the root of `2 pi x`.
#[inline(always)]
fn far<R: Real>(x: R) -> R {
    let y = x.recip();
    let series = if is_single::<R::Primal>() {
        series(&const { asymptotic::<8>() }, y)
    } else {
        series(&const { asymptotic::<21>() }, y)
    };
    series / (x * R::c(2.0 * PI)).sqrt()
}

/// By a plain loop: folds over iterators become calls.
#[inline(always)]
fn series<R: Real, const N: usize>(c: &[f64; N], x: R) -> R {
    let (mut sum, mut k) = (R::of(c[N - 1]), N - 1);
    while k > 0 {
        k -= 1;
        sum = sum * x + R::c(c[k]);
    }
    sum
}

const fn powers<const N: usize>() -> [f64; N] {
    let (mut c, mut k) = ([1.0; N], 1);
    while k < N {
        c[k] = c[k - 1] / (k * k) as f64;
        k += 1;
    }
    c
}

const fn asymptotic<const N: usize>() -> [f64; N] {
    let (mut c, mut k) = ([1.0; N], 1);
    while k < N {
        let odd = (2 * k - 1) as f64;
        c[k] = c[k - 1] * odd * odd / (8 * k) as f64;
        k += 1;
    }
    c
}

#[cfg(test)]
mod tests {
    use super::*;
    use ad_core::Dual;

    /// Its integral, the mean of `exp(x (cos t - 1))`: for periodic functions, sums over equal steps are exact.
    fn reference(x: f64, slope: bool) -> f64 {
        let n = 4096;
        let term = |k: i32| {
            let below = (2.0 * PI * f64::from(k) / f64::from(n)).cos() - 1.0;
            (x * below).exp() * if slope { below } else { 1.0 }
        };
        (0..n).map(term).sum::<f64>() / f64::from(n)
    }

    #[test]
    fn it_is_its_integral_and_so_is_its_slope() {
        for k in 0..400 {
            let x = 1.05f64.powi(k) * 1e-3 - 1e-3;
            let (value, slope) = (reference(x, false), reference(x, true));
            let found = i0_scaled(Dual::<f64, 1>::var(x, 0));
            assert!((found.re / value - 1.0).abs() < 1e-9, "{x}: {found:?}");
            assert!((found.eps[0] / slope - 1.0).abs() < 1e-7, "{x}: {found:?}");
            let single = f64::from(i0_scaled(x as f32));
            assert!((single / value - 1.0).abs() < 2e-6, "{x}: {single}");
        }
        // Large numbers, as of smooth fibres that are seen from the side.
        let far = i0_scaled(1e30f32);
        assert!(far > 0.0 && far < 1e-14);
    }
}
