//! Diffuse parts of materials that are made of others.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lanes, lanes, whole};
use super::super::readings::Reading;
use super::{CONTINUOUS, Members, Scattering};
use crate::bsdf::{DiffuseLobe, Leaf, Lobe, Material};
use crate::integrator::vertex::MODE;

lanes! {
    /// Diffuse surfaces.
    Matt {
        reflectance: Lanes<P>,
    }
}

impl<P: Float> Members<P> for Matt<P> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self::zero()
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool {
        let Material::Diffuse(m) = material else {
            return false;
        };
        let lobe = m.lobe(read);
        self.reflectance.put_rgb(k, lobe.reflectance);
        true
    }

    #[inline(always)]
    fn repeat(&mut self, k: usize, earlier: usize) {
        self.relocate(k, earlier);
    }

    #[inline(never)]
    fn eval_pdf(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let lobe = DiffuseLobe {
                reflectance: self.reflectance.rgb(k),
            };
            of.f.put_rgb(k, lobe.eval(wo, wi, MODE));
            of.pdf[k] = lobe.pdf(wo, wi, MODE);
            of.right[k] = 1;
        }
    }

    #[inline(always)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        self.draw(n, of);
        self.eval_pdf(n, of);
    }
}

impl<P: Float> Matt<P> {
    #[inline(never)]
    fn draw(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let lobe = DiffuseLobe {
                reflectance: self.reflectance.rgb(k),
            };
            let sample = lobe.sample(of.wo.vec(k), of.u.vec(k).to_array(), MODE);
            of.wi.put_vec(k, sample.map_or(Vec3::zero(), |s| s.wi));
            of.eta[k] = P::one();
            of.component[k] = CONTINUOUS;
            of.sampled[k] = 1;
        }
    }
}
