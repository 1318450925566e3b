//! Angles by polynomials: without a call or a branch, for loops over many of them.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

use ad_core::{Const, Float, Real};

use super::warp::{horner, sin_cos_of_turns};

/// `tan(pi / 8)`: up to there the polynomials are good.
const LARGEST: f64 = 0.414_213_562_373_095_05;

/// `atan(x) / x` in powers of `x^2`, by Chebyshev interpolation: relative errors of 6e-10 and 2e-21.
const SINGLE: [f64; 6] = [
    0.999_999_999_371_192_9,
    -0.333_333_068_918_312_6,
    0.199_981_829_754_153_7,
    -0.142_395_314_524_325_59,
    0.105_698_197_284_723_84,
    -0.060_262_818_014_215_3,
];
const DOUBLE: [f64; 14] = [
    1.0,
    -0.333_333_333_333_333_3,
    0.199_999_999_999_998_5,
    -0.142_857_142_856_921_02,
    0.111_111_111_093_741_87,
    -0.090_909_090_092_672_56,
    0.076_923_051_994_141_29,
    -0.066_666_148_104_008_21,
    0.058_815_973_116_730_28,
    -0.052_553_405_299_155_44,
    0.047_044_331_308_876_82,
    -0.040_511_390_233_324_03,
    0.029_532_970_811_899_906,
    -0.012_911_128_341_268_36,
];

/// Four-quadrant arctangent of `y / x` in radians, to a few roundings; 0 or pi at the origin. For numbers whose sum
/// does not overflow.
///
/// # Derivatives
/// Those of [`Real::atan2`].
#[inline(always)]
pub fn atan2<R: Real>(y: R, x: R) -> R {
    let value = primal_atan2(y.primal(), x.primal());
    if R::IS_PRIMAL {
        return R::lift(value);
    }
    revalued(y.atan2(x), value)
}

/// The angle between the unit vector `(x, y, z)` and the third axis in radians, to a few roundings.
///
/// # Derivatives
/// Those of [`Real::atan2`] and [`Real::hypot`].
#[inline(always)]
pub fn polar<R: Real>(x: R, y: R, z: R) -> R {
    let sine = (x.primal().square() + y.primal().square()).sqrt();
    let value = primal_atan2(sine, z.primal());
    if R::IS_PRIMAL {
        return R::lift(value);
    }
    revalued(x.hypot(y).atan2(z), value)
}

/// Sine and cosine of `u` turns, `u` in [0, 1]: [`sin_cos_of_turns`].
///
/// # Derivatives
/// In `u`.
#[inline(always)]
pub fn sin_cos<R: Real>(u: R) -> (R, R) {
    let (sin, cos) = sin_cos_of_turns(u.primal());
    if R::IS_PRIMAL {
        return (R::lift(sin), R::lift(cos));
    }
    let (s, c) = (u * R::c(2.0 * PI)).sin_cos();
    (revalued(s, sin), revalued(c, cos))
}

/// Sine and cosine of `x` radians, to a few roundings of `x`.
///
/// # Derivatives
/// In `x`.
#[inline(always)]
pub fn sin_cos_of<R: Real>(x: R) -> (R, R) {
    let half = R::Primal::of(0.5);
    let turns = x.primal() * R::Primal::of(1.0 / TAU);
    let turns = turns - (turns + half).floor();
    let (sin, cos) = sin_cos_of_turns(turns.abs());
    let sin = R::Primal::select(turns.sign_bit(), -sin, sin);
    if R::IS_PRIMAL {
        return (R::lift(sin), R::lift(cos));
    }
    let (s, c) = x.sin_cos();
    (revalued(s, sin), revalued(c, cos))
}

/// The angle `x`, in radians, between minus and plus half a turn.
///
/// # Derivatives
/// In `x`.
#[inline(always)]
pub fn in_one_turn<R: Real>(x: R) -> R {
    let half = R::Primal::of(0.5);
    let turns = (x.primal() * R::Primal::of(1.0 / TAU) + half).floor();
    x - Const(turns * R::Primal::of(TAU))
}

/// Length of `(x, y)`, whose square does not overflow; zero where that is too small a number.
///
/// # Derivatives
/// Those of [`Real::hypot`].
#[inline(always)]
pub fn length<R: Real>(x: R, y: R) -> R {
    let value = (x.primal().square() + y.primal().square()).sqrt();
    if R::IS_PRIMAL {
        return R::lift(value);
    }
    revalued(x.hypot(y), value)
}

/// `x` with another value.
#[inline(always)]
fn revalued<R: Real>(x: R, value: R::Primal) -> R {
    x - Const(x.primal()) + Const(value)
}

#[inline(always)]
fn primal_atan2<P: Float>(y: P, x: P) -> P {
    let (across, along) = (y.abs(), x.abs());
    let swapped = across > along;
    let long = P::select(swapped, across, along);
    let short = P::select(swapped, along, across);
    // Beyond the reach of the polynomials the angle is the rest of an eighth of a turn.
    let steep = short > long * P::of(LARGEST);
    let above = P::select(steep, short - long, short);
    let below = P::select(steep, short + long, long);
    let q = P::select(below == P::zero(), P::zero(), above / below);
    let z = q * q;
    let part = if P::EPSILON > P::of(1e-10) {
        horner(&SINGLE, SINGLE.len(), z)
    } else {
        horner(&DOUBLE, DOUBLE.len(), z)
    };
    let a = part * q + P::select(steep, P::of(FRAC_PI_4), P::zero());
    let a = P::select(swapped, P::of(FRAC_PI_2) - a, a);
    P::select(x.sign_bit(), P::of(PI) - a, a).copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ad_core::Dual;

    /// All around, on the axes and diagonals, and for all sizes.
    #[test]
    fn angles_are_right_to_a_few_roundings() {
        for k in 0..4000 {
            let angle = (f64::from(k) - 2000.0) / 2000.0 * PI;
            for size in [1e-18, 1.0, 3e17] {
                let (y, x) = (size * angle.sin(), size * angle.cos());
                let (found, right) = (atan2(y, x), y.atan2(x));
                assert!(
                    (found - right).abs() <= 4.5e-16 * right.abs().max(0.5),
                    "{k}"
                );
                let (y, x) = (y as f32, x as f32);
                let (found, right) = (f64::from(atan2(y, x)), f64::from(y).atan2(f64::from(x)));
                assert!(
                    (found - right).abs() <= 2.4e-7 * right.abs().max(0.5),
                    "{k}"
                );
                assert!(
                    (found - right).abs() <= 2.4e-7 * right.abs().max(1e-30),
                    "{k}"
                );
            }
        }
        for (y, x) in [
            (0.0, 1.0),
            (-0.0, 1.0),
            (0.0, -1.0),
            (-0.0, -1.0),
            (0.0, 0.0),
            (1.0, 0.0),
        ] {
            assert_eq!(atan2::<f64>(y, x), y.atan2(x), "{y} {x}");
            assert_eq!(atan2::<f64>(-y, x), (-y).atan2(x), "{y} {x}");
        }
        assert!(atan2(f32::NAN, 1.0).is_nan());
    }

    #[test]
    fn angles_of_several_turns_are_right_to_a_few_roundings() {
        for k in -6000..=6000 {
            let x = f64::from(k) / 300.0;
            let (sin, cos) = sin_cos_of(x);
            let bound = 6e-16 * x.abs().max(1.0);
            assert!((sin - x.sin()).abs() < bound && (cos - x.cos()).abs() < bound);
            let y = in_one_turn(x);
            assert!(y.abs() < PI + 1e-14 && (y.sin() - x.sin()).abs() < 3.0 * bound);
            let (sin, cos) = sin_cos_of(x as f32);
            let x = f64::from(x as f32);
            let bound = 3.6e-7 * x.abs().max(1.0);
            let off = [f64::from(sin) - x.sin(), f64::from(cos) - x.cos()];
            assert!(off.into_iter().all(|off| off.abs() < bound), "{x}: {off:?}");
        }
        // Small angles are their sines, on both sides.
        for x in [1e-30f32, -1e-30, 1e-5, -1e-5] {
            assert!((sin_cos_of(x).0 / x - 1.0).abs() < 1e-6);
        }
        let x = Dual::<f64, 1>::var(5.3, 0);
        let (s, c) = sin_cos_of(x);
        assert!((s.eps[0] - c.re).abs() < 1e-15 && (c.eps[0] + s.re).abs() < 1e-15);
        assert_eq!(in_one_turn(x).eps, [1.0]);
    }

    #[test]
    fn derivatives_are_those_of_the_functions() {
        for k in 0..50 {
            let (y, x) = ((f64::from(k) * 0.7).sin(), (f64::from(k) * 0.7).cos() + 0.1);
            let [y, x] = [Dual::<f64, 2>::var(y, 0), Dual::var(x, 1)];
            let (found, exact) = (atan2(y, x), y.atan2(x));
            assert_eq!(found.eps, exact.eps);
            assert_eq!(found.re, atan2(y.re, x.re));
            let u = Dual::<f64, 1>::var(f64::from(k) / 50.0, 0);
            let (s, c) = sin_cos(u);
            assert!((s.eps[0] - 2.0 * PI * c.re).abs() < 1e-13);
            assert!((c.eps[0] + 2.0 * PI * s.re).abs() < 1e-13);
        }
    }
}
