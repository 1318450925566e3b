//! The scattering kernel for viewing rays and particles, with shading normals [Veach 1996].

use ad_core::{Float, Real, Vec3};

use super::{Bsdf, Component, DeltaKind, Shading, TransportMode};
use crate::math::Rgb;

/// Whether particles obey the adjoint of the rules for viewing rays, as they have to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Symmetry {
    /// Adjoint kernels for particles: shading normals weigh them, refraction scales radiance only.
    #[default]
    Respected,
    /// The mistake, on purpose: one rule for both. No weight for shading normals, and neither
    /// radiance nor particles are scaled at refraction.
    Ignored,
}

/// Which kernel is evaluated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rules {
    /// Adjoint kernels, or the mistake.
    pub symmetry: Symmetry,
    /// No light for directions on different sides of the geometric and the shading normal, so that none
    /// leaks through the surface. Off by default: the path tracer has no such test, nor has Mitsuba 3.
    pub side_tests: bool,
}

/// `EVAL-KERNEL` of [Veach 1996, section 3.2], the factor `|wi . N_g|` of the measure included: the
/// value of the material times the weight that makes it the kernel K (radiance) or its adjoint K*
/// (importance, particles).
///
/// All directions are in the shading frame (N_s = z) and leave the surface; `n_geo` is the geometric
/// normal there, on either side. `wo` is where the walk came from, `wi` where it goes: a viewing ray collects
/// light from `wi`, a particle arrived from `wo`. With [`TransportMode::Importance`] a particle's
/// weight is `f(wo -> wi) |wo . N_s| |wi . N_g| / |wo . N_g|` [Veach 1996, Eq. 13]; at refraction it is
/// also free of the factor eta^2 (footnote 20).
///
/// # Derivatives
/// In the material; the weight is a constant (fixed geometry).
#[inline(always)]
pub fn eval_kernel<R: Real>(
    material: &impl Bsdf,
    at: &Shading<R>,
    n_geo: Vec3<R::Primal>,
    [wo, wi]: [Vec3<R>; 2],
    component: Component,
    mode: TransportMode,
    rules: Rules,
) -> Rgb<R> {
    let weight = kernel_weight(n_geo, [wo.primal(), wi.primal()], mode, rules);
    if weight == R::Primal::zero() {
        return Rgb::black();
    }
    let mode = rules.mode(mode, [wo.primal(), wi.primal()], component);
    material
        .eval_component(at, wo, wi, component, mode)
        .scale(weight)
}

impl Rules {
    /// The mode in which the material is evaluated.
    #[inline]
    pub fn mode<P: Float>(
        &self,
        mode: TransportMode,
        [wo, wi]: [Vec3<P>; 2],
        component: Component,
    ) -> TransportMode {
        if self.symmetry == Symmetry::Respected {
            return mode;
        }
        let transmits = match component {
            Component::Continuous => wo.z * wi.z < P::zero(),
            Component::Delta { kind, .. } => kind == DeltaKind::Transmission,
        };
        // A normal map weighs particles itself: it must not know that this is one.
        if transmits {
            TransportMode::Importance
        } else {
            TransportMode::Radiance
        }
    }
}

/// What [`eval_kernel`] multiplies the material's value with: 0 if a side test fails, otherwise
/// [`particle_weight`] for particles and 1 for viewing rays.
#[inline(always)]
pub fn kernel_weight<P: Float>(
    n_geo: Vec3<P>,
    [wo, wi]: [Vec3<P>; 2],
    mode: TransportMode,
    rules: Rules,
) -> P {
    if rules.side_tests && !(sides_agree(n_geo, wo) && sides_agree(n_geo, wi)) {
        return P::zero();
    }
    match (mode, rules.symmetry) {
        (TransportMode::Importance, Symmetry::Respected) => particle_weight(n_geo, [wo, wi]),
        _ => P::one(),
    }
}

/// `|wo . N_s| |wi . N_g| / (|wo . N_g| |wi . N_s|)` for the shading normal z: what a kernel with the
/// cosine `|wi . N_s|` lacks for particles that go from `wo` to `wi`. Zero where it is not finite.
///
/// Unbounded as `wo` becomes parallel to the surface (errata V-13): the price of shading normals.
#[inline(always)]
pub fn particle_weight<P: Float>(n_geo: Vec3<P>, [wo, wi]: [Vec3<P>; 2]) -> P {
    // Exactly one without a shading normal of its own.
    if n_geo.x == P::zero() && n_geo.y == P::zero() {
        return P::one();
    }
    let weight = (wo.z * wi.dot(n_geo)).abs() / (wo.dot(n_geo) * wi.z).abs();
    P::select(weight.is_finite(), weight, P::zero())
}

/// Whether `w` is on the same side of the shading normal z and of the geometric normal, which is
/// flipped first if the two normals disagree. Not if it lies in either plane.
#[inline]
pub fn sides_agree<P: Float>(n_geo: Vec3<P>, w: Vec3<P>) -> bool {
    let n_geo = if n_geo.z < P::zero() { -n_geo } else { n_geo };
    w.dot(n_geo) * w.z > P::zero()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn direction(theta: f64, phi: f64) -> Vec3<f64> {
        let ((st, ct), (sp, cp)) = (theta.sin_cos(), phi.sin_cos());
        Vec3::new(st * cp, st * sp, ct)
    }

    #[test]
    fn the_weight_is_that_of_equation_13_and_finite_everywhere() {
        let n = direction(0.5, 0.3);
        let (wo, wi) = (direction(0.4, 2.0), direction(1.2, -1.0));
        let f = particle_weight(n, [wo, wi]);
        assert!((f - wo.z * wi.dot(n) / (wo.dot(n) * wi.z)).abs() < 1e-15);
        // There and back again.
        assert!((f * particle_weight(n, [wi, wo]) - 1.0).abs() < 1e-14);
        // Straight through, nothing changes.
        assert!((particle_weight(n, [wo, -wo]) - 1.0).abs() < 1e-14);
        let edge = Vec3::new(n.z, 0.0, -n.x).normalize();
        for w in [edge, Vec3::new(1.0, 0.0, 0.0), Vec3::zero()] {
            assert!(particle_weight(n, [w, wi]).is_finite());
            assert!(particle_weight(n, [wo, w]).is_finite());
        }
        let flat = Vec3::new(0.0, 0.0, 1.0);
        assert_eq!(particle_weight(flat, [edge, Vec3::new(1.0, 0.0, 0.0)]), 1.0);
    }

    #[test]
    fn side_tests_flip_the_normal_and_exclude_the_planes() {
        let n = direction(0.5, 0.0);
        let between = direction(std::f64::consts::FRAC_PI_2 - 0.2, std::f64::consts::PI);
        for n in [n, -n] {
            assert!(sides_agree(n, direction(0.2, 1.0)));
            assert!(sides_agree(n, -direction(0.2, 1.0)));
            assert!(!sides_agree(n, between));
            assert!(!sides_agree(n, Vec3::new(1.0, 0.0, 0.0)));
            assert!(!sides_agree(n, Vec3::new(0.0, 1.0, 0.0)));
        }
        let rules = Rules {
            side_tests: true,
            ..Rules::default()
        };
        let wo = direction(0.2, 1.0);
        for mode in [TransportMode::Radiance, TransportMode::Importance] {
            assert_eq!(kernel_weight(n, [wo, between], mode, rules), 0.0);
            assert_eq!(kernel_weight(n, [between, wo], mode, rules), 0.0);
            assert!(kernel_weight(n, [wo, wo], mode, rules) > 0.0);
        }
    }
}
