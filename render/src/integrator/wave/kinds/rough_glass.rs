//! Rough glass, of which visible normals are sampled.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::facets::FacetLanes;
use super::{Among, CONTINUOUS, Members, Scattering};
use crate::bsdf::microfacet::{Microfacet, Ndf};
use crate::bsdf::{Facet, Facets, Leaf, Material, RoughDielectricLobe, Shading, upwards};

lanes! {
    /// Rough glass.
    RoughGlass {
        facets: FacetLanes<P>,
        eta: Lane<P>,
        specular_reflectance: Lanes<P>,
        specular_transmittance: Lanes<P>,
    }
}

impl<P: Float> RoughGlass<P> {
    #[inline(always)]
    fn at(&self, k: usize) -> RoughDielectricLobe<P> {
        RoughDielectricLobe {
            microfacet: Microfacet {
                kind: Ndf::Ggx,
                alpha: self.facets.alpha[k],
                visible: true,
            },
            eta: self.eta[k],
            specular_reflectance: self.specular_reflectance.rgb(k),
            specular_transmittance: self.specular_transmittance.rgb(k),
        }
    }

    /// The facets that connect both directions.
    #[inline(never)]
    fn connect(&mut self, among: Among, of: &mut Scattering<P>) {
        for k in 0..whole(among.n) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let (m, right) = Facet::along(wo, wi, self.eta[k]).unit();
            let facets = Facets::ggx(self.facets.alpha[k], upwards(m), [wo, wi]);
            self.facets.put(k, &facets);
            let none = (wo.z == P::zero()) | (wi.z == P::zero());
            of.right[k] = u32::from(right | none);
        }
        for &k in among.one_by_one {
            let (m, directions) = (self.facets.m.vec(k), [of.wo.vec(k), of.wi.vec(k)]);
            let asked = of.asked[k] != 0;
            let facets = Facets::beckmann(self.facets.alpha[k], m, directions, asked);
            self.facets.put(k, &facets);
        }
    }

    #[inline(never)]
    fn value(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let (f, pdf) = self.at(k).eval_pdf_where(&self.facets.at(k), wo, wi);
            of.f.put_rgb(k, f);
            of.pdf[k] = pdf;
        }
    }

    /// Where the sampled normals lead.
    #[inline(never)]
    fn scatter(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, m, u) = (of.wo.vec(k), self.facets.m.vec(k), of.u.vec(k).x);
            let (wi, eta, goes) = self.at(k).scatter(wo, m, u);
            // Where nothing goes, nothing is found.
            of.wi.put_vec(k, Vec3::select(goes, wi, Vec3::zero()));
            of.eta[k] = eta;
            of.component[k] = CONTINUOUS;
        }
    }
}

impl<P: Float> Members<P> for RoughGlass<P> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self::zero()
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, at: &Shading<P>) -> Option<Ndf> {
        let Material::RoughDielectric(m) = material else {
            return None;
        };
        let lobe = m.lobe(&mut { *at });
        self.facets.alpha[k] = lobe.microfacet.alpha;
        self.eta[k] = lobe.eta;
        self.specular_reflectance
            .put_rgb(k, lobe.specular_reflectance);
        self.specular_transmittance
            .put_rgb(k, lobe.specular_transmittance);
        Some(lobe.microfacet.kind)
    }

    #[inline(always)]
    fn eval_pdf(&mut self, among: Among, of: &mut Scattering<P>) {
        self.connect(among, of);
        self.value(among.n, of);
    }

    #[inline(always)]
    fn sample(&mut self, among: Among, of: &mut Scattering<P>) {
        self.facets.sample(among, of, true);
        self.scatter(among.n, of);
        self.eval_pdf(among, of);
    }
}
