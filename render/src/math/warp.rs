//! Maps from the unit square to discs, hemispheres, triangles and cones.
//!
//! Naming: `square_to_x(u)` and its density `x_pdf`. Densities are per solid angle or per area of
//! the target, as said. Everything is written over [`Real`], so that attached sampling can follow
//! a sample with its parameters; the random numbers themselves are primal.

use std::f64::consts::{FRAC_1_PI, FRAC_PI_4, PI};

use ad_core::{Float, Real, Vec2, Vec3};

/// Concentric map to the unit disc [Shirley and Chiu 1997]; density 1/pi per area.
#[inline(always)]
pub fn square_to_disk<P: Float>(u: [P; 2]) -> Vec2<P> {
    let two = P::of(2.0);
    let (x, y) = (two * u[0] - P::one(), two * u[1] - P::one());
    // Both halves of the map are one formula with the axes exchanged; no branch to mispredict.
    let wide = x.abs() > y.abs();
    let (long, short) = (P::select(wide, x, y), P::select(wide, y, x));
    let ratio = P::select(long == P::zero(), P::zero(), short / long);
    let (sin, cos) = sin_cos_octant(ratio * P::of(FRAC_PI_4));
    let (along, across) = (long * cos, long * sin);
    Vec2::new(
        P::select(wide, along, across),
        P::select(wide, across, along),
    )
}

/// Sine and cosine for angles in [-pi/4, pi/4], to rounding: the Taylor series, without a call.
#[inline(always)]
fn sin_cos_octant<P: Float>(x: P) -> (P, P) {
    const SIN: [f64; 9] = [
        1.0,
        -1.0 / 6.0,
        1.0 / 120.0,
        -1.0 / 5040.0,
        1.0 / 362_880.0,
        -1.0 / 39_916_800.0,
        1.0 / 6_227_020_800.0,
        -1.0 / 1_307_674_368_000.0,
        1.0 / 355_687_428_096_000.0,
    ];
    const COS: [f64; 9] = [
        1.0,
        -0.5,
        1.0 / 24.0,
        -1.0 / 720.0,
        1.0 / 40_320.0,
        -1.0 / 3_628_800.0,
        1.0 / 479_001_600.0,
        -1.0 / 87_178_291_200.0,
        1.0 / 20_922_789_888_000.0,
    ];
    // Terms below half a rounding of the result are left out.
    let terms = if P::EPSILON > P::of(1e-10) { 5 } else { 9 };
    let x2 = x * x;
    (horner(&SIN, terms, x2) * x, horner(&COS, terms, x2))
}

/// The first terms of a series. By a plain loop: folds over iterators become calls.
#[inline(always)]
pub(super) fn horner<P: Float, const N: usize>(c: &[f64; N], terms: usize, x: P) -> P {
    let (mut sum, mut k) = (P::zero(), terms);
    while k > 0 {
        k -= 1;
        sum = sum.mul_add(x, P::of(c[k]));
    }
    sum
}

/// Sine and cosine of `u` turns, `u` in [0, 1]: to rounding, without a call or a branch.
#[inline(always)]
pub fn sin_cos_of_turns<P: Float>(u: P) -> (P, P) {
    // Whole quarters are exact, and so is what is left.
    let quarter = (P::of(4.0) * u + P::of(0.5)).floor();
    let (sin, cos) = sin_cos_octant((u - P::of(0.25) * quarter) * P::of(2.0 * PI));
    let is = |q: f64| quarter == P::of(q);
    let across = is(1.0) | is(3.0);
    let (y, x) = (P::select(across, cos, sin), P::select(across, sin, cos));
    (
        P::select(is(2.0) | is(3.0), -y, y),
        P::select(is(1.0) | is(2.0), -x, x),
    )
}

/// Cosine-weighted direction around +z; density `cos(theta) / pi` per solid angle.
#[inline(always)]
pub fn square_to_cosine_hemisphere<P: Float>(u: [P; 2]) -> Vec3<P> {
    let d = square_to_disk(u);
    let z = (P::one() - d.x * d.x - d.y * d.y).max(P::zero()).sqrt();
    Vec3::new(d.x, d.y, z)
}

/// Density of [`square_to_cosine_hemisphere`] per solid angle, zero below the horizon.
#[inline(always)]
pub fn cosine_hemisphere_pdf<R: Real>(cos_theta: R) -> R {
    let above = cos_theta.primal() > R::Primal::zero();
    R::select(above, cos_theta * R::c(FRAC_1_PI), R::zero())
}

/// Uniform direction on the unit sphere; density 1/(4 pi) per solid angle.
#[inline(always)]
pub fn square_to_sphere<P: Float>(u: [P; 2]) -> Vec3<P> {
    let z = P::one() - P::of(2.0) * u[0];
    let r = (P::of(4.0) * u[0] * (P::one() - u[0]))
        .max(P::zero())
        .sqrt();
    let (sin, cos) = sin_cos_of_turns(u[1]);
    Vec3::new(r * cos, r * sin, z)
}

/// Uniform barycentric coordinates `(b1, b2)` of a triangle; density 1 / area.
#[inline]
pub fn square_to_triangle<P: Float>(u: [P; 2]) -> Vec2<P> {
    let t = (P::one() - u[0]).max(P::zero()).sqrt();
    Vec2::new(P::one() - t, t * u[1])
}

/// Uniform direction in the cone around +z with `one_minus_cos_max = 1 - cos(theta_max)`, which a
/// caller can form without cancellation; density `1 / (2 pi one_minus_cos_max)` per solid angle.
#[inline]
pub fn square_to_cone<R: Real>(u: [R::Primal; 2], one_minus_cos_max: R) -> Vec3<R> {
    let h = one_minus_cos_max * ad_core::Const(u[0]);
    let z = R::one() - h;
    let r = (h * (R::of(2.0) - h)).max(R::zero()).sqrt();
    let (sin, cos) = sin_cos_of_turns(u[1]);
    Vec3::new(r * ad_core::Const(cos), r * ad_core::Const(sin), z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_of_turns_to_rounding() {
        for i in 0..=4000 {
            let u = f64::from(i) / 4000.0;
            let (sin, cos) = sin_cos_of_turns(u);
            let (expected_sin, expected_cos) = (2.0 * PI * u).sin_cos();
            assert!((sin - expected_sin).abs() < 1e-15, "{u}");
            assert!((cos - expected_cos).abs() < 1e-15, "{u}");
        }
        for i in 0..=4 {
            let (sin, cos) = sin_cos_of_turns(0.25 * f64::from(i));
            let expected = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 1.0)];
            assert_eq!((sin, cos), expected[i as usize], "{i} quarters are exact");
        }
    }

    #[test]
    fn sine_and_cosine_of_an_octant_to_rounding() {
        for i in -1000..=1000 {
            let x = f64::from(i) * 1e-3 * FRAC_PI_4;
            let (sin, cos) = sin_cos_octant(x);
            assert!(
                (sin - x.sin()).abs() < 2e-16 && (cos - x.cos()).abs() < 3e-16,
                "{x}"
            );
            let x = x as f32;
            let (sin, cos) = sin_cos_octant(x);
            assert!(
                (sin - x.sin()).abs() < 1e-7 && (cos - x.cos()).abs() < 1.2e-7,
                "{x}"
            );
        }
    }

    #[test]
    fn the_concentric_map_keeps_rings_and_covers_the_disc() {
        let n = 200;
        let mut inside = 0;
        for i in 0..n {
            for j in 0..n {
                let u = [
                    (f64::from(i) + 0.5) / f64::from(n),
                    (f64::from(j) + 0.5) / f64::from(n),
                ];
                let d = square_to_disk(u);
                let ring = (2.0 * u[0] - 1.0).abs().max((2.0 * u[1] - 1.0).abs());
                assert!((d.length() - ring).abs() < 1e-12);
                inside += i32::from(d.x > 0.0 && d.length() < 0.5);
            }
        }
        assert!((f64::from(inside) / f64::from(n * n) - 0.125).abs() < 0.005);
        assert_eq!(square_to_disk([0.5f32, 0.5]).to_array(), [0.0, 0.0]);
    }
}
