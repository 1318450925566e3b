//! Rough glass, of which visible normals are sampled.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::super::readings::Reading;
use super::facets::{Shape, Surfaces};
use super::{CONTINUOUS, Members, Scattering};
use crate::bsdf::microfacet::Alpha;
use crate::bsdf::{Facet, Leaf, Material, RoughDielectricLobe, upwards};

lanes! {
    /// Rough glass, but for its normals.
    GlassLanes {
        eta: Lane<P>,
        specular_reflectance: Lanes<P>,
        specular_transmittance: Lanes<P>,
    }
}

/// Rough glass whose normals are of one shape.
pub struct RoughGlass<P, A, N> {
    lanes: GlassLanes<P>,
    facets: Surfaces<P, A, N>,
}

impl<P: Float, A: Alpha<Scalar = P>, N: Shape> RoughGlass<P, A, N> {
    #[inline(always)]
    fn at(&self, k: usize) -> RoughDielectricLobe<P, A> {
        RoughDielectricLobe {
            microfacet: self.facets.surface(k),
            eta: self.lanes.eta[k],
            specular_reflectance: self.lanes.specular_reflectance.rgb(k),
            specular_transmittance: self.lanes.specular_transmittance.rgb(k),
        }
    }

    #[inline(always)]
    fn put<B: Alpha<Scalar = P>>(&mut self, k: usize, lobe: &RoughDielectricLobe<P, B>) {
        self.facets.put(k, lobe.microfacet.alpha);
        let lanes = &mut self.lanes;
        lanes.eta[k] = lobe.eta;
        lanes
            .specular_reflectance
            .put_rgb(k, lobe.specular_reflectance);
        lanes
            .specular_transmittance
            .put_rgb(k, lobe.specular_transmittance);
    }

    /// The facets that connect both directions.
    #[inline(never)]
    fn connect(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let (m, right) = Facet::along(wo, wi, self.lanes.eta[k]).unit();
            self.facets.keep(k, upwards(m), [wo, wi]);
            let none = (wo.z == P::zero()) | (wi.z == P::zero());
            of.right[k] = u32::from(right | none);
        }
    }

    #[inline(never)]
    fn value(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let (f, pdf) = self.at(k).eval_pdf_where(&self.facets.facets(k), wo, wi);
            of.f.put_rgb(k, f);
            of.pdf[k] = pdf;
        }
    }

    /// Where the sampled normals lead.
    #[inline(never)]
    fn scatter(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, m, u) = (of.wo.vec(k), self.facets.normal(k), of.u.vec(k).x);
            let (wi, eta, goes) = self.at(k).scatter(wo, m, u);
            // Where nothing goes, nothing is found.
            of.wi.put_vec(k, Vec3::select(goes, wi, Vec3::zero()));
            of.eta[k] = eta;
            of.component[k] = CONTINUOUS;
        }
    }
}

impl<P: Float, A: Alpha<Scalar = P>, N: Shape> Members<P> for RoughGlass<P, A, N> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self {
            lanes: GlassLanes::zero(),
            facets: Surfaces::new(),
        }
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool {
        match material {
            Material::RoughDielectric(m) => self.put(k, &m.lobe(read)),
            Material::AnisotropicDielectric(m) => self.put(k, &m.lobe(read)),
            _ => return false,
        }
        true
    }

    #[inline(always)]
    fn repeat(&mut self, k: usize, earlier: usize) {
        self.lanes.relocate(k, earlier);
        self.facets.repeat(k, earlier);
    }

    #[inline(always)]
    fn eval_pdf(&mut self, n: usize, of: &mut Scattering<P>) {
        self.connect(n, of);
        self.value(n, of);
    }

    #[inline(always)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        self.facets.sample(n, of, true);
        self.scatter(n, of);
        self.eval_pdf(n, of);
    }
}
