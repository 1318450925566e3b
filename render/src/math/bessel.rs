//! A modified Bessel function, over any scalar.

use std::f64::consts::PI;

use ad_core::Real;

use super::gauss::is_single;

/// Up to here the power series is used, from here on that for large arguments.
const LARGE: f64 = 12.0;

/// `exp(-x) I_0(x)`, for `x` from zero: the modified Bessel function of the first kind and order zero without its growth. By
/// its power series and, from 12 on, by its asymptotic one: to rounding in single precision, and to 1e-10 in double
/// precision.
///
/// # Derivatives
/// In `x`.
pub(crate) fn i0_scaled<R: Real>(x: R) -> R {
    let single = is_single::<R::Primal>();
    if x.primal() < R::Primal::of(LARGE) {
        // sum of (x^2 / 4)^k / (k!)^2
        let terms = if single { 18 } else { 26 };
        let series = nested(x.square() * R::c(0.25), terms, |k| (k * k).recip());
        return series * (-x).exp();
    }
    // 1 / sqrt(2 pi x) times the sum of ((2k - 1)!!)^2 / (k! (8 x)^k)
    let terms = if single { 7 } else { 20 };
    let ratio = |k: f64| (2.0 * k - 1.0) * (2.0 * k - 1.0) / (8.0 * k);
    nested(x.recip(), terms, ratio) / (x * R::c(2.0 * PI)).sqrt()
}

/// The series in `x` whose terms have these ratios, of each to the one before.
#[inline(always)]
fn nested<R: Real>(x: R, terms: u32, ratio: impl Fn(f64) -> f64) -> R {
    let mut sum = R::one();
    for k in (1..=terms).rev() {
        sum = sum * x * R::c(ratio(k.into())) + R::c(1.0);
    }
    sum
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
