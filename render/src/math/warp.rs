//! Maps from the unit square to discs, hemispheres, triangles and cones.
//!
//! Naming: `square_to_x(u)` and its density `x_pdf`. Densities are per solid angle or per area of
//! the target, as said. Everything is written over [`Real`], so that attached sampling can follow
//! a sample with its parameters; the random numbers themselves are primal.

use std::f64::consts::{FRAC_1_PI, FRAC_PI_2, FRAC_PI_4, PI};

use ad_core::{Float, Real, Vec2, Vec3};

/// Concentric map to the unit disc [Shirley and Chiu 1997]; density 1/pi per area.
#[inline]
pub fn square_to_disk<P: Float>(u: [P; 2]) -> Vec2<P> {
    let two = P::of(2.0);
    let (x, y) = (two * u[0] - P::one(), two * u[1] - P::one());
    if x == P::zero() && y == P::zero() {
        return Vec2::new(P::zero(), P::zero());
    }
    let (r, phi) = if x.abs() > y.abs() {
        (x, P::of(FRAC_PI_4) * (y / x))
    } else {
        (y, P::of(FRAC_PI_2) - P::of(FRAC_PI_4) * (x / y))
    };
    let (sin, cos) = phi.sin_cos();
    Vec2::new(r * cos, r * sin)
}

/// Cosine-weighted direction around +z; density `cos(theta) / pi` per solid angle.
#[inline]
pub fn square_to_cosine_hemisphere<P: Float>(u: [P; 2]) -> Vec3<P> {
    let d = square_to_disk(u);
    let z = (P::one() - d.x * d.x - d.y * d.y).max(P::zero()).sqrt();
    Vec3::new(d.x, d.y, z)
}

/// Density of [`square_to_cosine_hemisphere`] per solid angle, zero below the horizon.
#[inline]
pub fn cosine_hemisphere_pdf<R: Real>(cos_theta: R) -> R {
    if cos_theta.primal() > R::Primal::zero() {
        cos_theta * R::c(FRAC_1_PI)
    } else {
        R::zero()
    }
}

/// Uniform direction on the unit sphere; density 1/(4 pi) per solid angle.
#[inline]
pub fn square_to_sphere<P: Float>(u: [P; 2]) -> Vec3<P> {
    let z = P::one() - P::of(2.0) * u[0];
    let r = (P::of(4.0) * u[0] * (P::one() - u[0]))
        .max(P::zero())
        .sqrt();
    let (sin, cos) = (P::of(2.0 * PI) * u[1]).sin_cos();
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
    let (sin, cos) = (R::Primal::of(2.0 * PI) * u[1]).sin_cos();
    Vec3::new(r * ad_core::Const(cos), r * ad_core::Const(sin), z)
}
