//! Smooth plastic.

use ad_core::Float;

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::super::readings::Reading;
use super::{CONTINUOUS, Members, REFLECTED, Scattering};
use crate::bsdf::{CoatedLobe, Leaf, Material, PlasticLobe};
use crate::math::Rgb;

lanes! {
    /// [`CoatedLobe`]s.
    Coatings {
        diffuse_reflectance: Lanes<P>,
        specular_reflectance: Lanes<P>,
        eta: Lane<P>,
        nonlinear: Lane<u32>,
    }
}

impl<P: Float> Coatings<P> {
    #[inline(always)]
    pub fn at(&self, k: usize) -> CoatedLobe<P> {
        CoatedLobe {
            diffuse_reflectance: self.diffuse_reflectance.rgb(k),
            specular_reflectance: self.specular_reflectance.rgb(k),
            eta: self.eta[k],
            nonlinear: self.nonlinear[k] != 0,
        }
    }

    #[inline(always)]
    pub fn put(&mut self, k: usize, coated: &CoatedLobe<P>) {
        self.diffuse_reflectance
            .put_rgb(k, coated.diffuse_reflectance);
        self.specular_reflectance
            .put_rgb(k, coated.specular_reflectance);
        self.eta[k] = coated.eta;
        self.nonlinear[k] = u32::from(coated.nonlinear);
    }
}

lanes! {
    /// Plastic.
    Plastics {
        coated: Coatings<P>,
        inside: Lane<P>,
    }
}

impl<P: Float> Plastics<P> {
    #[inline(always)]
    fn at(&self, k: usize) -> PlasticLobe<P> {
        PlasticLobe {
            coated: self.coated.at(k),
            inside: self.inside[k],
        }
    }
}

impl<P: Float> Members<P> for Plastics<P> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self::zero()
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool {
        let Material::Plastic(m) = material else {
            return false;
        };
        let lobe = m.lobe(read);
        self.coated.put(k, &lobe.coated);
        self.inside[k] = lobe.inside;
        true
    }

    #[inline(always)]
    fn repeat(&mut self, k: usize, earlier: usize) {
        self.relocate(k, earlier);
    }

    #[inline(never)]
    fn eval_pdf(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (f, pdf) = self.at(k).eval_pdf_in_line(of.wo.vec(k), of.wi.vec(k));
            of.f.put_rgb(k, f);
            of.pdf[k] = pdf;
            of.right[k] = 1;
        }
    }

    #[inline(never)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (lobe, wo) = (self.at(k), of.wo.vec(k));
            let (wi, coat, value) = lobe.choose(wo, of.u.vec(k).to_array());
            let (f, pdf) = lobe.eval_pdf_in_line(wo, wi);
            let reflects = coat > P::zero();
            of.wi.put_vec(k, wi);
            of.f.put_rgb(k, Rgb::select(reflects, value, f));
            let pdf = P::select(reflects, coat, pdf);
            of.pdf[k] = P::select(wo.z > P::zero(), pdf, P::zero());
            of.eta[k] = P::one();
            of.component[k] = if reflects { REFLECTED } else { CONTINUOUS };
            (of.sampled[k], of.right[k]) = (1, 1);
        }
    }
}
