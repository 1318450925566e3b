//! The functions on which the cost of derivatives is measured.

use ad_core::{Const, DiffFn, Float, Real, Vec3};

/// Isotropic GGX: distribution x Smith shadowing x Schlick Fresnel x cosine, in the f32-stable form
/// (`1 - cos^2` never formed, `4 cos cos` cancelled analytically).
///
/// Inputs: alpha, F0, then incident and outgoing direction in the local frame.
pub struct Ggx;

impl DiffFn<8, 1> for Ggx {
    #[inline(always)]
    fn eval<R: Real>(&self, [alpha, f0, ix, iy, iz, ox, oy, oz]: [R; 8]) -> [R; 1] {
        let (wi, wo) = (Vec3::new(ix, iy, iz), Vec3::new(ox, oy, oz));
        let h = (wi + wo).normalize();
        let f = schlick(f0, wi.dot(h));
        [distribution(alpha, h) * f * shadowing(alpha, wi) * shadowing(alpha, wo) * iz]
    }
}

/// The same function of alpha alone: everything else is passive and stays in primal numbers, as
/// directions do in detached sampling.
pub struct GgxOfAlpha<P> {
    pub f0: P,
    pub wi: Vec3<P>,
    pub wo: Vec3<P>,
}

impl<P: Float> GgxOfAlpha<P> {
    /// Value for `alpha`, of which `P` is the primal type.
    #[inline(always)]
    pub fn eval<R: Real<Primal = P>>(&self, alpha: R) -> R {
        let h = (self.wi + self.wo).normalize();
        let f = schlick(self.f0, self.wi.dot(h));
        // D / (cos_i + l_i) / (cos_o + l_o) with passive directions.
        let a2 = alpha.square();
        let s = a2 * Const(h.z * h.z) + Const(h.x * h.x + h.y * h.y);
        let l =
            |w: Vec3<P>| (a2 * Const(w.x * w.x + w.y * w.y) + Const(w.z * w.z)).sqrt() + Const(w.z);
        let passive = f * self.wi.z * P::of(std::f64::consts::FRAC_1_PI);
        a2 * Const(passive) / (s.square() * l(self.wi) * l(self.wo))
    }
}

/// `D = 1 / (pi alpha^2 s^2)`, `s = (h_xy / alpha)^2 + h_z^2`.
#[inline(always)]
fn distribution<R: Real>(alpha: R, h: Vec3<R>) -> R {
    let inv = alpha.recip();
    let s = (h.x * inv).square() + (h.y * inv).square() + h.z.square();
    (inv / s).square() * R::c(std::f64::consts::FRAC_1_PI)
}

/// `1 / (cos + sqrt(cos^2 + alpha^2 sin^2))`: Smith's `G1 / (2 cos)`.
#[inline(always)]
fn shadowing<R: Real>(alpha: R, w: Vec3<R>) -> R {
    let l = w.z.square() + alpha.square() * (w.x.square() + w.y.square());
    (w.z + l.sqrt()).recip()
}

#[inline(always)]
fn schlick<R: Real>(f0: R, cos: R) -> R {
    let m = R::c(1.0) - cos;
    let m2 = m.square();
    f0 + (R::c(1.0) - f0) * (m2 * m2 * m)
}

/// One step of a nonlinear chain, `x + (p - x^3) (1 + x) / 20`: state `x`, local parameter `p`. No
/// divisions or roots, behind whose latency derivatives would hide.
pub struct Relax;

impl DiffFn<2, 1> for Relax {
    #[inline(always)]
    fn eval<R: Real>(&self, [x, p]: [R; 2]) -> [R; 1] {
        [x + (p - x.square() * x) * (x + R::c(1.0)) * R::c(0.05)]
    }
}
