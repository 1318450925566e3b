//! The exponential, the error function and the quantile of Gaussians without a call or a branch, for loops over many.
//!
//! All is written in the tail `exp(-x^2)` and in what is left of `erfc(x)` without it, `exp(x^2) erfc(x)`, so that
//! nothing cancels however far out `x` is.

use ad_core::{Const, Float, Real};

/// Polynomials for one precision: of `exp(r)` in powers of `r`, up to half a binary order, and of `(x + 2) exp(x^2) erfc(x)`
/// in powers of `(x - 2) / (x + 2)`, all by Chebyshev interpolation.
#[derive(Debug)]
pub struct Precision<const E: usize, const C: usize> {
    exp: [f64; E],
    erfcx: [f64; C],
}

/// Relative errors of 3e-9 and, up to `x = 6`, 9e-9: rounding, in single precision.
pub const SINGLE: Precision<7, 10> = Precision {
    exp: [
        1.0,
        1.000_000_037_738_871_4,
        0.500_000_004_714_605_7,
        0.166_664_154_140_411_77,
        0.041_666_352_771_112_21,
        0.008_375_134_774_624_326,
        0.001_394_111_889_583_7,
    ],
    erfcx: [
        1.021_582_700_820_762_5,
        -0.687_160_671_812_840_1,
        0.279_472_552_720_175_5,
        -0.036_442_163_309_088_386,
        -0.021_518_254_219_832_635,
        0.006_470_516_468_408_18,
        0.003_127_723_940_449_600_4,
        -0.000_763_121_881_524_416,
        -0.000_684_780_276_205_795_8,
        -0.000_124_615_147_282_049_4,
    ],
};

/// Relative errors of 1e-12 and, up to `x = 8`, 2e-11: what is rounded to single precision later.
pub const BETWEEN: Precision<9, 14> = Precision {
    exp: [
        1.0,
        0.999_999_999_979_769,
        0.499_999_999_997_977_73,
        0.166_666_668_911_805_45,
        0.041_666_666_891_091_7,
        0.008_333_266_071_022_454,
        0.001_388_882_165_071_769,
        0.000_199_158_818_713_960_35,
        2.487_617_895_908_551_3e-5,
    ],
    erfcx: [
        1.021_582_705_255_453_8,
        -0.687_160_684_517_164_2,
        0.279_472_090_355_475_2,
        -0.036_442_226_407_110_25,
        -0.021_510_600_921_314_356,
        0.006_479_129_537_329_238_5,
        0.003_089_966_627_550_996_4,
        -0.000_837_220_479_150_557_3,
        -0.000_659_866_606_826_202_4,
        3.576_449_475_290_504_5e-5,
        0.000_136_923_584_660_561_86,
        2.745_817_626_438_347_7e-5,
        -1.508_592_590_622_876_2e-5,
        -6.088_449_463_998_763e-6,
    ],
};

/// Up to `x = 8`, the rounding of double precision.
pub const DOUBLE: Precision<12, 21> = Precision {
    exp: [
        1.0,
        1.0,
        0.500_000_000_000_001_9,
        0.166_666_666_666_666_8,
        0.041_666_666_666_487_95,
        0.008_333_333_333_319_589,
        0.001_388_888_895_235_286_3,
        0.000_198_412_698_900_764_03,
        2.480_148_544_156_131_3e-5,
        2.755_724_088_722_987e-6,
        2.763_265_472_252_779e-7,
        2.511_004_920_481_865_8e-8,
    ],
    erfcx: [
        1.021_582_705_242_023,
        -0.687_160_684_413_810_5,
        0.279_472_092_556_054_3,
        -0.036_442_231_506_910_325,
        -0.021_510_661_889_408_155,
        0.006_479_185_069_628_617,
        0.003_090_612_057_215_961_5,
        -0.000_837_296_108_403_430_2,
        -0.000_663_073_501_748_657_7,
        3.437_200_085_849_742_5e-5,
        0.000_144_471_109_814_925,
        3.414_508_521_872_185_6e-5,
        -2.170_101_838_573_556_2e-5,
        -1.610_709_931_438_061e-5,
        -1.097_965_573_783_456_8e-6,
        3.623_203_606_399_649e-6,
        1.920_752_938_064_462_7e-6,
        -1.816_526_044_983_045e-8,
        -4.589_824_286_228_1e-7,
        -2.149_643_115_476_775_4e-7,
        -3.525_919_970_032_779e-8,
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

/// Even and odd powers apart, so that each number waits for half as many others; by plain loops: folds over iterators
/// become calls.
#[inline(always)]
fn polynomial<P: Float, const N: usize>(c: &[f64; N], x: P) -> P {
    let x2 = x * x;
    let (mut even, mut odd, mut k) = (P::zero(), P::zero(), N);
    while k > 0 {
        k -= 1;
        if k % 2 == 0 {
            even = even.mul_add(x2, P::of(c[k]));
        } else {
            odd = odd.mul_add(x2, P::of(c[k]));
        }
    }
    odd.mul_add(x, even)
}

impl<const E: usize, const C: usize> Precision<E, C> {
    /// `exp(-x)`, for `x` from zero to [`largest`].
    #[inline(always)]
    fn exp_minus<P: Float>(&self, x: P) -> P {
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
        let shifted = rounds - x * P::of(LOG2_E);
        let whole = shifted - rounds;
        let rest = (-x - whole * P::of(high)) - whole * P::of(low);
        polynomial(&self.exp, rest) * two_to(shifted)
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

/// Natural logarithm of a positive normal number, to 1e-6 of it or of one, whichever is more.
#[inline(always)]
fn rough_ln(x: f32) -> f32 {
    // The mantissa, between 2/3 and 4/3, and the power of two beside it.
    let power = x.to_bits().wrapping_sub(0x3f2a_aaab) & 0xff80_0000;
    let mantissa = f32::from_bits(x.to_bits().wrapping_sub(power));
    let whole = (power.cast_signed() >> 23) as f32;
    let z = (mantissa - 1.0) / (mantissa + 1.0);
    let z2 = z * z;
    let series = polynomial(&[2.0, 2.0 / 3.0, 0.4, 2.0 / 7.0], z2);
    whole * std::f32::consts::LN_2 + series * z
}

/// The place below which the part `below` of a Gaussian of standard deviation `1 / sqrt(2)` lies and above which the rest
/// does, `above`: the polynomials of [Giles 2011] for the inverse of the error function, which are right to 1e-4 as far out as
/// random numbers of single precision lead.
#[inline(always)]
pub fn rough_quantile(below: f32, above: f32) -> f32 {
    const NEAR: [f64; 9] = [
        1.501_409_4,
        0.246_640_73,
        -0.004_177_681_6,
        -0.001_253_725,
        0.000_218_580_87,
        -4.391_506_5e-6,
        -3.523_387_7e-6,
        3.432_739_4e-7,
        2.810_226_4e-8,
    ];
    const FAR: [f64; 9] = [
        2.832_976_8,
        1.001_674_1,
        0.009_438_870_5,
        -0.007_622_461_3,
        0.005_739_507_7,
        -0.003_673_428_4,
        0.001_349_343_2,
        0.000_100_950_56,
        -0.000_200_214_26,
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
            near(BETWEEN.tail(x), 3e-11);
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
