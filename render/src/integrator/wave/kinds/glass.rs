//! Smooth glass, and thin sheets of it: everything is along deltas.

use ad_core::Float;

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::super::readings::Reading;
use super::{Members, REFLECTED, Scattering, TRANSMITTED};
use crate::bsdf::{DielectricLobe, Leaf, Material, Passage, ThinDielectricLobe};
use crate::integrator::vertex::MODE;

lanes! {
    /// Glass.
    Glass {
        eta: Lane<P>,
        specular_reflectance: Lanes<P>,
        specular_transmittance: Lanes<P>,
        /// Whether it is a sheet.
        thin: Lane<u32>,
    }
}

impl<P: Float> Members<P> for Glass<P> {
    const CONNECTS: bool = false;

    fn new() -> Self {
        Self::zero()
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool {
        let (eta, reflectance, transmittance, thin) = match material {
            Material::Dielectric(m) => {
                let m = m.lobe(read);
                (
                    m.eta,
                    m.specular_reflectance,
                    m.specular_transmittance,
                    false,
                )
            }
            Material::ThinDielectric(m) => {
                let m = m.lobe(read);
                (
                    m.eta,
                    m.specular_reflectance,
                    m.specular_transmittance,
                    true,
                )
            }
            _ => return false,
        };
        self.eta[k] = eta;
        self.specular_reflectance.put_rgb(k, reflectance);
        self.specular_transmittance.put_rgb(k, transmittance);
        self.thin[k] = u32::from(thin);
        true
    }

    #[inline(always)]
    fn repeat(&mut self, k: usize, earlier: usize) {
        self.relocate(k, earlier);
    }

    fn eval_pdf(&mut self, _n: usize, _of: &mut Scattering<P>) {}

    #[inline(never)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, u) = (of.wo.vec(k), of.u.vec(k).x);
            let glass = DielectricLobe {
                eta: self.eta[k],
                specular_reflectance: self.specular_reflectance.rgb(k),
                specular_transmittance: self.specular_transmittance.rgb(k),
            };
            let sheet = ThinDielectricLobe {
                eta: glass.eta,
                specular_reflectance: glass.specular_reflectance,
                specular_transmittance: glass.specular_transmittance,
            };
            let thin = self.thin[k] != 0;
            let passage = Passage::select(thin, sheet.pass(wo, u), glass.pass(wo, u, MODE));
            of.wi.put_vec(k, passage.wi);
            of.f.put_rgb(k, passage.value);
            of.pdf[k] = passage.pdf;
            of.eta[k] = passage.eta;
            of.component[k] = if passage.reflects {
                REFLECTED
            } else {
                TRANSMITTED
            };
            (of.sampled[k], of.right[k]) = (1, 1);
        }
    }
}
