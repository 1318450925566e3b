//! Exponentials, logarithms, the error function and the quantile of Gaussians without a call or a branch, for loops over many.
//!
//! All is written in the tail `exp(-x^2)` and in what is left of `erfc(x)` without it, `exp(x^2) erfc(x)`, so that
//! nothing cancels however far out `x` is.

use ad_core::{Const, Float, Real};

/// Polynomials for one precision, in fours: of `exp(r)` in powers of `r`, up to half a binary order, and of
/// `(x + 2) exp(x^2) erfc(x)` in powers of `(x - 2) / (x + 2)`, all by Chebyshev interpolation.
#[derive(Debug)]
pub struct Precision<const E: usize, const C: usize> {
    exp: [[f64; 4]; E],
    erfcx: [[f64; 4]; C],
}

/// Up to `x = 6`, less than the rounding of single precision.
pub const SINGLE: Precision<2, 3> = Precision {
    exp: [
        [
            0.999_999_999_959_529_4,
            0.999_999_999_995_505_5,
            0.500_000_010_779_387_6,
            0.166_666_667_863_804_4,
        ],
        [
            0.041_666_218_139_710_595,
            0.008_333_283_518_768_105,
            0.001_394_859_028_686_338_3,
            0.000_199_075_825_913_251_34,
        ],
    ],
    erfcx: [
        [
            1.021_582_705_282_244_8,
            -0.687_160_685_393_064_1,
            0.279_472_087_692_813_45,
            -0.036_442_181_915_330_24,
        ],
        [
            -0.021_510_544_124_301_08,
            0.006_478_502_361_390_989,
            0.003_089_307_973_577_585_6,
            -0.000_833_612_168_141_128_3,
        ],
        [
            -0.000_655_579_926_433_773_5,
            2.709_138_861_437_096e-05,
            0.000_123_586_716_648_255_14,
            3.244_945_397_202_36e-05,
        ],
    ],
};

/// Relative errors of 6e-11 and, up to `x = 8`, 1e-12: what is rounded to single precision later.
pub const BETWEEN: Precision<2, 4> = Precision {
    exp: SINGLE.exp,
    erfcx: [
        [
            1.021_582_705_242_405_8,
            -0.687_160_684_423_649_6,
            0.279_472_092_468_708_1,
            -0.036_442_230_859_451_384,
        ],
        [
            -0.021_510_658_410_879_333,
            0.006_479_173_803_538_649,
            0.003_090_557_828_735_048_3,
            -0.000_837_226_170_913_028_7,
        ],
        [
            -0.000_662_664_316_342_646_1,
            3.429_808_803_803_889e-05,
            0.000_142_909_461_819_767_66,
            3.329_392_707_920_285_6e-05,
        ],
        [
            -1.898_769_311_880_936e-05,
            -1.287_319_381_898_246_5e-05,
            -2.032_485_472_282_139e-06,
            1.709_254_159_212_093_4e-07,
        ],
    ],
};

/// Up to `x = 8`, the rounding of double precision.
pub const DOUBLE: Precision<3, 6> = Precision {
    exp: [
        [1.0, 1.0, 0.500_000_000_000_001_9, 0.166_666_666_666_666_8],
        [
            0.041_666_666_666_487_95,
            0.008_333_333_333_319_589,
            0.001_388_888_895_235_286_3,
            0.000_198_412_698_900_764_03,
        ],
        [
            2.480_148_544_156_131_3e-05,
            2.755_724_088_722_987e-06,
            2.763_265_472_252_779e-07,
            2.511_004_920_481_865_8e-08,
        ],
    ],
    erfcx: [
        [
            1.021_582_705_242_023,
            -0.687_160_684_413_810_6,
            0.279_472_092_556_055_1,
            -0.036_442_231_506_877_12,
        ],
        [
            -0.021_510_661_889_519_094,
            0.006_479_185_067_641_394,
            0.003_090_612_060_396_023_6,
            -0.000_837_296_059_929_213_9,
        ],
        [
            -0.000_663_073_526_774_156_3,
            3.437_139_720_839_351e-05,
            0.000_144_470_961_347_561_46,
            3.414_926_509_059_727e-05,
        ],
        [
            -2.169_747_403_220_125e-05,
            -1.612_317_002_964_118_2e-05,
            -1.121_101_549_146_576_7e-06,
            3.652_915_549_074_567e-06,
        ],
        [
            1.992_870_778_094_328_7e-06,
            -2.244_860_223_481_978_4e-08,
            -5.639_344_722_560_84e-07,
            -2.824_955_611_307_943e-07,
        ],
        [
            5.484_834_093_915_666e-09,
            6.966_119_714_235_797e-08,
            3.212_616_281_798_120_4e-08,
            5.163_373_132_723_338e-09,
        ],
    ],
};

/// Whether numbers are of single precision.
#[inline(always)]
pub fn is_single<P: Float>() -> bool {
    P::EPSILON > P::of(1e-10)
}

/// The largest number whose negative has an exponential that is a normal number.
#[inline(always)]
pub fn largest<P: Float>() -> P {
    P::of(if is_single::<P>() { 87.336_54 } else { 708.396 })
}

/// Four terms at a time, so that numbers wait for few others. By a plain loop, which is unrolled before those around it
/// become vectors: folds over iterators become calls.
#[inline(always)]
fn polynomial<P: Float, const N: usize>(c: &[[f64; 4]; N], x: P) -> P {
    let x2 = x * x;
    let x4 = x2 * x2;
    let (mut sum, mut k) = (P::zero(), N);
    while k > 0 {
        k -= 1;
        let [a, b, c, d] = c[k];
        let low = P::of(b).mul_add(x, P::of(a));
        let high = P::of(d).mul_add(x, P::of(c));
        sum = sum.mul_add(x4, high.mul_add(x2, low));
    }
    sum
}

impl<const E: usize, const C: usize> Precision<E, C> {
    /// `exp(-x)`, for `x` from zero to [`largest`].
    #[inline(always)]
    fn exp_minus<P: Float>(&self, x: P) -> P {
        let (rest, power) = in_octave(-x);
        polynomial(&self.exp, rest) * power
    }

    /// `exp(-x^2)` and `exp(x^2) erfc(x)` of a number that is not negative.
    #[inline(always)]
    pub fn tail<P: Float>(&self, x: P) -> [P; 2] {
        let tail = self.exp_minus((x * x).min(largest()));
        let inverse = (x + P::of(2.0)).recip();
        let y = P::one() - inverse * P::of(4.0);
        [tail, polynomial(&self.erfcx, y) * inverse]
    }
}

/// `x` without whole multiples of the logarithm of two, and two to the power of their number: two numbers with the
/// exponential of `x`, up to [`largest`] on both sides.
#[inline(always)]
fn in_octave<P: Float>(x: P) -> (P, P) {
    const LOG2_E: f64 = std::f64::consts::LOG2_E;
    // Added to a small number, this rounds it to a whole one, which is then in the last bits.
    let (rounds, high, low) = if is_single::<P>() {
        (12_582_912.0, 0.693_359_375, -2.121_944_4e-4)
    } else {
        (
            6_755_399_441_055_744.0,
            0.693_147_180_369_123_8,
            1.908_214_929_270_587_7e-10,
        )
    };
    let rounds = P::of(rounds);
    let shifted = rounds + x * P::of(LOG2_E);
    let whole = shifted - rounds;
    let rest = (x - whole * P::of(high)) - whole * P::of(low);
    (rest, two_to(shifted))
}

/// Two to the power that is in the last bits of a number that was rounded by being added to a large one.
#[inline(always)]
fn two_to<P: Float>(shifted: P) -> P {
    if is_single::<P>() {
        let power = shifted.to_f32().to_bits() << 23;
        P::from_f32(f32::from_bits(power.wrapping_add(127 << 23)))
    } else {
        let power = shifted.to_f64().to_bits() << 52;
        P::from_f64(f64::from_bits(power.wrapping_add(1023 << 52)))
    }
}

/// `exp(-x)`, for `x` from zero to [`largest`].
///
/// # Derivatives
/// In `x`.
#[inline(always)]
pub fn exp_minus<R: Real>(x: R) -> R {
    let at = x.primal();
    let value = if is_single::<R::Primal>() {
        SINGLE.exp_minus(at)
    } else {
        DOUBLE.exp_minus(at)
    };
    if R::IS_PRIMAL {
        return R::lift(value);
    }
    (Const(at) - x).exp() * Const(value)
}

/// `exp(-x)`, for any `x` from zero: zero where that is no normal number.
///
/// # Derivatives
/// In `x`; none where it is zero.
#[inline(always)]
pub fn fading<R: Real>(x: R) -> R {
    let far = x.primal() > largest();
    let near = exp_minus(R::select(far, R::zero(), x));
    R::select(far, R::zero(), near)
}

/// `1 - exp(-x)` without cancellation, for any `x` from zero.
///
/// # Derivatives
/// In `x`; none beyond [`largest`].
#[inline(always)]
pub fn faded<R: Real>(x: R) -> R {
    let far = x.primal() > largest();
    -exp_m1(R::select(far, R::lift(-largest::<R::Primal>()), -x))
}

/// `exp(x) - 1` without cancellation, up to [`largest`] on both sides.
///
/// # Derivatives
/// In `x`.
#[inline(always)]
pub fn exp_m1<R: Real>(x: R) -> R {
    let at = x.primal();
    let value = if is_single::<R::Primal>() {
        grown::<R::Primal, 2>(at)
    } else {
        grown::<R::Primal, 4>(at)
    };
    if R::IS_PRIMAL {
        return R::lift(value);
    }
    (x - Const(at)).exp_m1() * Const(value + R::Primal::one()) + Const(value)
}

/// [`exp_m1`] by so many fours of terms of a series.
#[inline(always)]
fn grown<P: Float, const N: usize>(x: P) -> P {
    let (rest, power) = in_octave(x);
    rest * polynomial(&const { growth::<N>() }, rest) * power + (power - P::one())
}

/// That of `(exp(x) - 1) / x`.
const fn growth<const N: usize>() -> [[f64; 4]; N] {
    let mut series = [[0.0; 4]; N];
    let (mut term, mut k) = (1.0, 0);
    while k < 4 * N {
        term /= (k + 1) as f64;
        series[k / 4][k % 4] = term;
        k += 1;
    }
    series
}

/// `ln(1 + x)` without cancellation, where `1 + x` is a positive normal number.
///
/// # Derivatives
/// In `x`.
#[inline(always)]
pub fn ln_1p<R: Real>(x: R) -> R {
    let (at, one) = (x.primal(), R::Primal::one());
    let (number, power, inverse) = octave_of(at + one);
    let value = logarithm(number, (at - (power - one)) * inverse);
    if R::IS_PRIMAL {
        return R::lift(value);
    }
    let change = (x - Const(at)) / Const(at + one);
    change.ln_1p() + Const(value)
}

/// `ln x` of a positive normal number.
///
/// # Derivatives
/// In `x`.
#[inline(always)]
pub fn ln<R: Real>(x: R) -> R {
    let at = x.primal();
    let (number, power, inverse) = octave_of(at);
    let value = logarithm(number, (at - power) * inverse);
    if R::IS_PRIMAL {
        return R::lift(value);
    }
    let change = (x - Const(at)) / Const(at);
    change.ln_1p() + Const(value)
}

/// The logarithm of two to the power of `number`, times one plus `rest`, which is between -1/3 and 1/3.
#[inline(always)]
fn logarithm<P: Float>(number: P, rest: P) -> P {
    let z = rest / (rest + P::of(2.0));
    let series = if is_single::<P>() {
        polynomial(&const { area_tangent::<2>() }, z * z)
    } else {
        polynomial(&const { area_tangent::<3>() }, z * z)
    };
    number * P::of(std::f64::consts::LN_2) + series * z
}

/// That of `ln((1 + z) / (1 - z)) / z` in squares.
const fn area_tangent<const N: usize>() -> [[f64; 4]; N] {
    let mut series = [[0.0; 4]; N];
    let mut k = 0;
    while k < 4 * N {
        series[k / 4][k % 4] = 2.0 / (2 * k + 1) as f64;
        k += 1;
    }
    series
}

/// The power of two that leaves of `x` a number between 2/3 and 4/3: its number, itself, and its inverse.
#[inline(always)]
fn octave_of<P: Float>(x: P) -> (P, P, P) {
    if is_single::<P>() {
        let bits = x.to_f32().to_bits().wrapping_sub(0x3f2a_aaab) & 0xff80_0000;
        let power = |bits: u32| P::from_f32(f32::from_bits(bits.wrapping_add(127 << 23)));
        let number = P::from_f32((bits.cast_signed() >> 23) as f32);
        (number, power(bits), power(bits.wrapping_neg()))
    } else {
        let two_thirds = 0x3fe5_5555_5555_5555;
        let bits = x.to_f64().to_bits().wrapping_sub(two_thirds) & 0xfff0_0000_0000_0000;
        let power = |bits: u64| P::from_f64(f64::from_bits(bits.wrapping_add(1023 << 52)));
        let number = P::from_f64((bits.cast_signed() >> 52) as f64);
        (number, power(bits), power(bits.wrapping_neg()))
    }
}

/// Natural logarithm of a positive normal number, to 1e-6 of it or of one, whichever is more.
#[inline(always)]
fn rough_ln(x: f32) -> f32 {
    // The mantissa, between 2/3 and 4/3, and the power of two beside it.
    let power = x.to_bits().wrapping_sub(0x3f2a_aaab) & 0xff80_0000;
    let mantissa = f32::from_bits(x.to_bits().wrapping_sub(power));
    let whole = (power.cast_signed() >> 23) as f32;
    let z = (mantissa - 1.0) / (mantissa + 1.0);
    let z2 = z * z;
    let series = polynomial(&[[2.0, 2.0 / 3.0, 0.4, 2.0 / 7.0]], z2);
    whole * std::f32::consts::LN_2 + series * z
}

/// The place below which the part `below` of a Gaussian of standard deviation `1 / sqrt(2)` lies and above which the rest
/// does, `above`: the polynomials of [Giles 2011] for the inverse of the error function, which are right to 1e-4 as far out as
/// random numbers of single precision lead.
#[inline(always)]
pub fn rough_quantile(below: f32, above: f32) -> f32 {
    const NEAR: [[f64; 4]; 3] = [
        [1.501_409_4, 0.246_640_73, -0.004_177_681_6, -0.001_253_725],
        [
            0.000_218_580_87,
            -4.391_506_5e-6,
            -3.523_387_7e-6,
            3.432_739_4e-7,
        ],
        [2.810_226_4e-8, 0.0, 0.0, 0.0],
    ];
    const FAR: [[f64; 4]; 3] = [
        [2.832_976_8, 1.001_674_1, 0.009_438_870_5, -0.007_622_461_3],
        [
            0.005_739_507_7,
            -0.003_673_428_4,
            0.001_349_343_2,
            0.000_100_950_56,
        ],
        [-0.000_200_214_26, 0.0, 0.0, 0.0],
    ];
    let w = -rough_ln((below * above * 4.0).max(f32::MIN_POSITIVE));
    let near = polynomial(&NEAR, w - 2.5);
    let far = polynomial(&FAR, w.max(0.0).sqrt() - 3.0);
    (below - above) * f32::select(w < 5.0, near, far)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ad_core::Dual;

    #[test]
    fn exponentials_are_right_to_a_few_roundings() {
        for k in 0..=8000 {
            let x = f64::from(k) / 8000.0 * largest::<f64>();
            let ratio = exp_minus(x) / (-x).exp();
            assert!((ratio - 1.0).abs() < 5e-16, "{x}: {ratio}");
            let x = (f64::from(k) / 8000.0) as f32 * largest::<f32>();
            let ratio = f64::from(exp_minus(x)) / (-f64::from(x)).exp();
            assert!((ratio - 1.0).abs() < 2e-7, "{x}: {ratio}");
        }
        assert!(exp_minus(largest::<f32>()) >= f32::MIN_POSITIVE);
        assert!(exp_minus(largest::<f64>()) >= f64::MIN_POSITIVE);
        let x = Dual::<f64, 1>::var(0.7, 0);
        let (found, right) = (exp_minus(x), (-x).exp());
        assert!((found.eps[0] - right.eps[0]).abs() < 1e-15);
        assert_eq!(found.re, exp_minus(0.7));
    }

    #[test]
    fn what_exponentials_grow_by_is_right_to_a_few_roundings() {
        for k in -9000..=9000 {
            let x = f64::from(k) / 9000.0;
            // Everywhere, and near zero.
            for x in [x * 80.0, x, x * 1e-3, x * 1e-9] {
                let right = x.exp_m1();
                assert!((exp_m1(x) - right).abs() <= 5e-16 * right.abs(), "{x}");
                let rounded = x as f32;
                let right = f64::from(rounded).exp_m1();
                let found = f64::from(exp_m1(rounded));
                assert!((found - right).abs() <= 2.5e-7 * right.abs(), "{x}");
            }
        }
        let x = Dual::<f64, 1>::var(-0.7, 0);
        let (found, right) = (exp_m1(x), x.exp_m1());
        assert!((found.eps[0] - right.eps[0]).abs() < 1e-15);
    }

    #[test]
    fn logarithms_are_right_to_a_few_roundings() {
        for k in 0..=9000 {
            let x = f64::from(k) / 9000.0;
            for x in [
                x,
                x * 1e-3,
                x * 1e-9,
                x * 30.0,
                x * 1e13,
                -0.999 * x,
                1e-7 - x,
            ] {
                let right = x.ln_1p();
                assert!((ln_1p(x) - right).abs() <= 7e-16 * right.abs(), "{x}");
                let rounded = x as f32;
                if rounded > -1.0 {
                    let right = f64::from(rounded).ln_1p();
                    let found = f64::from(ln_1p(rounded));
                    assert!((found - right).abs() <= 4e-7 * right.abs(), "{x}");
                }
            }
        }
        let x = Dual::<f64, 1>::var(-0.3, 0);
        let (found, right) = (ln_1p(x), x.ln_1p());
        assert!((found.eps[0] - right.eps[0]).abs() < 1e-15);
    }

    #[test]
    fn logarithms_of_small_and_large_numbers_are_right_to_a_few_roundings() {
        for k in -2400..=2400 {
            let x = (f64::from(k) / 30.0).exp();
            let bound = |right: f64| 4e-16 * right.abs() + 2.5e-16;
            assert!((ln(x) - x.ln()).abs() <= bound(x.ln()), "{x}");
            let rounded = x as f32;
            let right = f64::from(rounded).ln();
            let off = (f64::from(ln(rounded)) - right).abs();
            assert!(off <= 2.0f64.powi(29) * bound(right), "{x}");
        }
        // Near one, nothing cancels.
        for k in 1..=1000 {
            let x = f64::from(k) * 1e-9 + 1.0;
            assert!((ln(x) / (x - 1.0).ln_1p() - 1.0).abs() < 1e-15, "{x}");
        }
        let x = Dual::<f64, 1>::var(0.3, 0);
        let (found, right) = (ln(x), x.ln());
        assert!((found.eps[0] - right.eps[0]).abs() < 1e-15);
        assert_eq!(found.re, ln(0.3));
    }

    #[test]
    fn what_fades_is_there_or_zero() {
        for k in 0..=3000 {
            let x = f64::from(k) / 10.0;
            assert!((fading(x) - (-x).exp()).abs() <= 5e-16 * (-x).exp(), "{x}");
            assert!((faded(x) + (-x).exp_m1()).abs() < 3e-16, "{x}");
        }
        assert_eq!((fading(1e30f32), faded(1e30f32)), (0.0, 1.0));
        assert_eq!((fading(f64::INFINITY), faded(f64::INFINITY)), (0.0, 1.0));
        assert!((faded(1e-20f32) / 1e-20 - 1.0).abs() < 1e-6);
        let x = Dual::<f64, 1>::var(0.7, 0);
        for slope in [-fading(x).eps[0], faded(x).eps[0]] {
            assert!((slope - (-0.7f64).exp()).abs() < 1e-15);
        }
        let x = Dual::<f32, 1>::var(f32::MAX, 0);
        assert_eq!([fading(x).eps, faded(x).eps], [[0.0]; 2]);
    }

    /// `exp(x^2) erfc(x)` by Simpson's rule for the integral of `exp(-t^2 - 2 x t)`.
    fn scaled(x: f64) -> f64 {
        const N: u32 = 60_000;
        let h = 6.0 / f64::from(N);
        let f = |k: u32| {
            let t = f64::from(k) * h;
            (-t * (t + 2.0 * x)).exp()
        };
        let weighted = |k: u32| f(k) * if k % 2 == 1 { 4.0 } else { 2.0 };
        let sum = f(0) + f(N) + (1..N).map(weighted).sum::<f64>();
        sum * h / 3.0 * 2.0 / std::f64::consts::PI.sqrt()
    }

    #[test]
    fn tails_are_those_of_the_error_function() {
        for k in 0..=5000 {
            let x = f64::from(k) / 1000.0;
            let [tail, erfcx] = DOUBLE.tail(x);
            assert!((1.0 - tail * erfcx - Real::erf(x)).abs() < 1e-15, "{x}");
        }
        for k in 0..=30 {
            let x = f64::from(k) * 0.2;
            let right = scaled(x);
            let near = |[tail, erfcx]: [f64; 2], bound: f64| {
                assert!((erfcx / right - 1.0).abs() < bound, "{x}");
                assert!((tail / (-x * x).exp() - 1.0).abs() < bound, "{x}");
            };
            near(DOUBLE.tail(x), 1e-13);
            near(BETWEEN.tail(x), 1e-10);
            let [tail, erfcx] = SINGLE.tail(x as f32).map(f64::from);
            assert!((erfcx / right - 1.0).abs() < 4e-7, "{x}");
            let rounded = f64::from(x as f32);
            // The square is rounded, too.
            let bound = 2e-7 + 6e-8 * x * x;
            assert!(
                (tail / (-rounded * rounded).exp() - 1.0).abs() < bound,
                "{x}"
            );
        }
    }

    #[test]
    fn quantiles_are_right_to_a_few_digits() {
        for k in 1..=26 {
            let below = 0.5f64.powi(k);
            let right = -statrs::function::erf::erfc_inv(2.0 * below);
            for sign in [1.0, -1.0] {
                let parts = [below, 1.0 - below].map(|p| p as f32);
                let [low, high] = if sign > 0.0 {
                    parts
                } else {
                    [parts[1], parts[0]]
                };
                let found = f64::from(rough_quantile(low, high)) * sign;
                assert!((found - right).abs() < 1e-4, "{below}: {found} {right}");
            }
        }
    }
}
