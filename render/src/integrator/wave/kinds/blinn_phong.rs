//! Blinn-Phong materials.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::super::readings::Reading;
use super::{CONTINUOUS, Members, Scattering};
use crate::bsdf::{BlinnPhongLobe, Leaf, Material};

lanes! {
    /// Blinn-Phong materials.
    Phong {
        diffuse: Lanes<P>,
        specular: Lanes<P>,
        exponent: Lane<P>,
        share: Lane<P>,
    }
}

impl<P: Float> Phong<P> {
    #[inline(always)]
    fn at(&self, k: usize) -> BlinnPhongLobe<P> {
        BlinnPhongLobe {
            diffuse: self.diffuse.rgb(k),
            specular: self.specular.rgb(k),
            exponent: self.exponent[k],
            share: self.share[k],
        }
    }

    #[inline(never)]
    fn turn(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, u) = (of.wo.vec(k), of.u.vec(k).to_array());
            let (wi, goes) = self.at(k).scatter(wo, u);
            // Where nothing goes, nothing is found.
            of.wi.put_vec(k, Vec3::select(goes, wi, Vec3::zero()));
            of.eta[k] = P::one();
            of.component[k] = CONTINUOUS;
            of.sampled[k] = 1;
        }
    }
}

impl<P: Float> Members<P> for Phong<P> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self::zero()
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool {
        let Material::BlinnPhong(m) = material else {
            return false;
        };
        let lobe = m.lobe(read);
        self.diffuse.put_rgb(k, lobe.diffuse);
        self.specular.put_rgb(k, lobe.specular);
        (self.exponent[k], self.share[k]) = (lobe.exponent, lobe.share);
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

    #[inline(always)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        self.turn(n, of);
        self.eval_pdf(n, of);
    }
}
