//! Surfaces that are not there.

use ad_core::Float;

use super::super::lanes::whole;
use super::super::readings::Reading;
use super::{Members, PASSED, Scattering};
use crate::bsdf::Material;
use crate::math::Rgb;

/// Light goes through unchanged.
pub struct Nothing;

impl<P: Float> Members<P> for Nothing {
    const CONNECTS: bool = false;

    fn new() -> Self {
        Self
    }

    #[inline(always)]
    fn gather(&mut self, _k: usize, material: &Material, _read: &mut Reading<P>) -> bool {
        matches!(material, Material::Null(_))
    }

    fn repeat(&mut self, _k: usize, _earlier: usize) {}

    fn eval_pdf(&mut self, _n: usize, _of: &mut Scattering<P>) {}

    #[inline(never)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            of.wi.put_vec(k, -of.wo.vec(k));
            of.f.put_rgb(k, Rgb::splat(P::one()));
            (of.pdf[k], of.eta[k]) = (P::one(), P::one());
            of.component[k] = PASSED;
            (of.sampled[k], of.right[k]) = (1, 1);
        }
    }
}
