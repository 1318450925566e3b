//! Fresnel reflectance of smooth interfaces for unpolarised light.
//!
//! All forms are free of cancellation and of 0/0: nothing here is made from `1 - F` or from sines
//! and tangents of the angles (errata Z-2.20).

use ad_core::{Const, Float, Real};

use crate::math::both;

/// Up to here, an index of refraction is used as it is.
const LARGE_INDEX: f64 = 1e6;

/// What a dielectric interface does with light arriving under one angle.
#[derive(Clone, Copy, Debug)]
pub struct Dielectric<R> {
    /// Reflected fraction.
    pub reflect: R,
    /// The same of light polarised perpendicular and parallel to the plane of incidence; their mean
    /// is `reflect`.
    pub polarised: [R; 2],
    /// Transmitted fraction; the two sum to one.
    pub transmit: R,
    /// Cosine of the angle of refraction, positive; zero at total internal reflection.
    pub cos_t: R,
}

impl<R: Real> Dielectric<R> {
    /// The same without tangents.
    #[inline(always)]
    pub fn primal(&self) -> Dielectric<R::Primal> {
        Dielectric {
            reflect: self.reflect.primal(),
            polarised: [self.polarised[0].primal(), self.polarised[1].primal()],
            transmit: self.transmit.primal(),
            cos_t: self.cos_t.primal(),
        }
    }
}

impl<P: Float> Dielectric<P> {
    /// The same values, with tangents that are zero.
    #[inline]
    fn lift<R: Real<Primal = P>>(&self) -> Dielectric<R> {
        Dielectric {
            reflect: R::lift(self.reflect),
            polarised: [R::lift(self.polarised[0]), R::lift(self.polarised[1])],
            transmit: R::lift(self.transmit),
            cos_t: R::lift(self.cos_t),
        }
    }
}

/// A dielectric interface seen under `cos_i` (positive), where `eta` is the index on the far side
/// over that on the near side [Zeltner 2021, Eqs. 2.20 to 2.24].
///
/// # Derivatives
/// In both arguments. At total internal reflection everything is reflected, with zero derivative;
/// exactly grazing light counts as such. Constant arguments, as directions are to detached estimators, cost
/// primal work only, and there is no branch where all are.
#[inline(always)]
pub fn dielectric<R: Real>(cos_i: R, eta: R) -> Dielectric<R> {
    if !R::IS_PRIMAL && !cos_i.has_tangent() && !eta.has_tangent() {
        return dielectric_in_line(cos_i.primal(), eta.primal()).lift();
    }
    dielectric_in_line(cos_i, eta)
}

#[inline(always)]
fn dielectric_in_line<R: Real>(cos_i: R, eta: R) -> Dielectric<R> {
    // eta cos_t = sqrt(eta^2 - sin^2), in factors that do not cancel.
    let radicand = (eta - R::c(1.0)) * (eta + R::c(1.0)) + cos_i.square();
    let zero = R::Primal::zero();
    let passes = (radicand.primal() > zero) & (cos_i.primal() > zero);
    let q = radicand.sqrt();
    let (s, p) = (cos_i + q, eta * cos_i + q / eta);
    let (r_s, r_p) = ((cos_i - q) / s, (eta * cos_i - q / eta) / p);
    let polarised = [r_s.square(), r_p.square()];
    let reflect = (polarised[0] + polarised[1]) * R::c(0.5);
    let transmit = cos_i * q * R::c(2.0) * (s.square().recip() + p.square().recip());
    Dielectric {
        reflect: R::select(passes, reflect, R::one()),
        polarised: both(polarised, |r| R::select(passes, r, R::one())),
        transmit: R::select(passes, transmit, R::zero()),
        cos_t: R::select(passes, q / eta, R::zero()),
    }
}

/// Reflectance of a conductor with complex index `eta + i k` (or `eta - i k`: no difference), relative
/// to the near side, under `cos_i`.
///
/// # Derivatives
/// In all arguments; one-sided at `eta = 0`. Constant arguments cost primal work only.
#[inline]
pub fn conductor<R: Real>(cos_i: R, eta: R, k: R) -> R {
    if !R::IS_PRIMAL && !cos_i.has_tangent() && !eta.has_tangent() && !k.has_tangent() {
        return R::lift(conductor(cos_i.primal(), eta.primal(), k.primal()));
    }
    let [r_s, r_p] = conductor_polarised(cos_i, eta, k);
    (r_s + r_p) * R::c(0.5)
}

/// [`conductor`] for light polarised perpendicular and parallel to the plane of incidence.
#[inline]
pub fn conductor_polarised<R: Real>(cos_i: R, eta: R, k: R) -> [R; 2] {
    conductor_in_line(cos_i, eta, k)
}

/// [`conductor_polarised`] without a branch, for loops over many.
#[inline(always)]
pub(super) fn conductor_in_line<R: Real>(cos_i: R, eta: R, k: R) -> [R; 2] {
    let zero = R::Primal::zero();
    // The fourth powers of a larger index leave single precision: there, all is measured in units of it.
    let largest = eta.primal().abs().max(k.primal().abs());
    let unit = R::Primal::select(
        largest > R::Primal::of(LARGE_INDEX),
        largest.recip(),
        R::Primal::one(),
    );
    let (eta, k) = (eta * Const(unit), k.abs() * Const(unit));
    let c2 = cos_i.square();
    let eta_k = eta * k;
    // a + ib = sqrt((eta + ik)^2 - sin^2), the component of the wave vector along the normal.
    let t = (eta - k) * (eta + k) - Const(unit * unit) + c2 * Const(unit * unit);
    let modulus = (t.square() + (eta_k * R::c(2.0)).square()).sqrt();
    // The larger of both without cancellation, and the other from it.
    let real = t.primal() > zero;
    let size = R::select(real, t, -t);
    let root = ((modulus + size) * R::c(0.5)).sqrt();
    let other = R::select(root.primal() > zero, eta_k / root, R::zero());
    let (a, b) = (R::select(real, root, other), R::select(real, other, root));
    let (b2, c) = (b.square(), cos_i * Const(unit));
    let r_s = ((c - a).square() + b2) / ((c + a).square() + b2);
    // (eta + ik)^2 cos_i
    let (re, im) = ((eta - k) * (eta + k) * cos_i, eta_k * cos_i * R::c(2.0));
    let (a, b) = (a * Const(unit), b * Const(unit));
    let numerator = (re - a).square() + (im - b).square();
    let denominator = (re + a).square() + (im + b).square();
    let r_p = R::select(
        denominator.primal() > zero,
        numerator / denominator,
        R::one(),
    );
    let grazing = cos_i.primal() <= zero;
    both([r_s, r_p], |r| R::select(grazing, R::one(), r))
}

/// Average of [`dielectric`]'s reflectance over cosine-weighted directions on the near side, to
/// about 1e-7: what a diffuse emitter behind the interface gets back.
pub fn dielectric_diffuse(eta: f64) -> f64 {
    // Total internal reflection starts at this cosine: integrate on either side of the kink, where
    // the substitution `mu = critical + (1 - critical) t^2` removes the square root.
    let critical = (1.0 - eta * eta).max(0.0).sqrt();
    let n = 256;
    let transmitted: f64 = (0..n)
        .map(|i| {
            let t = (f64::from(i) + 0.5) / f64::from(n);
            let mu = critical + (1.0 - critical) * t * t;
            dielectric(mu, eta).transmit * mu * t
        })
        .sum();
    1.0 - transmitted * 4.0 * (1.0 - critical) / f64::from(n)
}
