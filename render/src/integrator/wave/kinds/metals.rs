//! Metals, rough ones of which visible normals are sampled, and mirrors.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::facets::FacetLanes;
use super::{Among, CONTINUOUS, Members, REFLECTED, Scattering};
use crate::bsdf::microfacet::Ndf;
use crate::bsdf::{Facets, Material, Metal, Shading, reflect};
use crate::math::Rgb;

lanes! {
    /// Metals.
    Metals {
        facets: FacetLanes<P>,
        specular_reflectance: Lanes<P>,
        eta: Lanes<P>,
        k: Lanes<P>,
        has_index: Lane<u32>,
        /// Whether it is a mirror.
        smooth: Lane<u32>,
    }
}

impl<P: Float> Metals<P> {
    #[inline(always)]
    fn metal(&self, k: usize) -> Metal<P> {
        Metal {
            alpha: self.facets.alpha[k],
            specular_reflectance: self.specular_reflectance.rgb(k),
            index: [self.eta.rgb(k), self.k.rgb(k)],
            has_index: self.has_index[k] != 0,
        }
    }

    /// Where all normals have steps in vectors: theirs, and what they reflect, in one loop.
    #[inline(never)]
    fn value_at_once(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (facets, right) = self.facets.between(k, of);
            self.put_value(k, &facets, right, of);
        }
    }

    #[inline(never)]
    fn value(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            self.put_value(k, &self.facets.at(k), of.right[k] != 0, of);
        }
    }

    #[inline(always)]
    fn put_value(&self, k: usize, facets: &Facets<P>, right: bool, of: &mut Scattering<P>) {
        let (f, pdf) = self.metal(k).eval_pdf(of.wo.vec(k), of.wi.vec(k), facets);
        // Nothing comes from a light to a mirror.
        let rough = self.smooth[k] == 0;
        of.f.put_rgb(k, Rgb::select(rough, f, Rgb::black()));
        of.pdf[k] = P::select(rough, pdf, P::zero());
        of.right[k] = u32::from(right | !rough);
    }

    /// Where all normals have steps in vectors: they, and where they lead, in one loop.
    #[inline(never)]
    fn turn_at_once(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (m, right) = self.facets.drawn(k, of, false);
            of.sampled[k] = u32::from(right);
            of.wi.put_vec(k, reflect(of.wo.vec(k), m));
        }
    }

    #[inline(never)]
    fn turn(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let wo = of.wo.vec(k);
            of.wi.put_vec(k, reflect(wo, self.facets.m.vec(k)));
        }
    }

    /// Mirrors, whose directions are not drawn.
    #[inline(never)]
    fn reflect(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let wo = of.wo.vec(k);
            let (smooth, above) = (self.smooth[k] != 0, wo.z > P::zero());
            let f = Rgb::select(above, self.metal(k).reflectance(wo.z), Rgb::black());
            let pdf = P::select(above, P::one(), P::zero());
            let mirrored = Vec3::new(-wo.x, -wo.y, wo.z);
            let wi = Vec3::select(smooth, mirrored, of.wi.vec(k));
            of.wi.put_vec(k, wi);
            of.f.put_rgb(k, Rgb::select(smooth, f, of.f.rgb(k)));
            of.pdf[k] = P::select(smooth, pdf, of.pdf[k]);
            of.component[k] = if smooth { REFLECTED } else { CONTINUOUS };
            of.sampled[k] |= self.smooth[k];
        }
    }
}

impl<P: Float> Members<P> for Metals<P> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self::zero()
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, at: &Shading<P>) -> Option<Ndf> {
        let (normals, metal, smooth) = match material {
            Material::RoughConductor(m) => {
                let (normals, metal) = Metal::rough(m, at);
                (normals, metal, false)
            }
            Material::Conductor(m) => (Ndf::Ggx, Metal::mirror(m, at), true),
            _ => return None,
        };
        self.facets.alpha[k] = metal.alpha;
        self.specular_reflectance
            .put_rgb(k, metal.specular_reflectance);
        self.eta.put_rgb(k, metal.index[0]);
        self.k.put_rgb(k, metal.index[1]);
        self.has_index[k] = u32::from(metal.has_index);
        self.smooth[k] = u32::from(smooth);
        Some(normals)
    }

    #[inline(always)]
    fn eval_pdf(&mut self, among: Among, of: &mut Scattering<P>) {
        if among.one_by_one.is_empty() {
            self.value_at_once(among.n, of);
        } else {
            self.facets.reflecting(among, of);
            self.value(among.n, of);
        }
    }

    #[inline(always)]
    fn sample(&mut self, among: Among, of: &mut Scattering<P>) {
        if among.one_by_one.is_empty() {
            self.turn_at_once(among.n, of);
        } else {
            self.facets.sample(among, of, false);
            self.turn(among.n, of);
        }
        self.eval_pdf(among, of);
        let n = whole(among.n);
        of.eta[..n].fill(P::one());
        of.component[..n].fill(CONTINUOUS);
        if self.smooth[..among.n].contains(&1) {
            self.reflect(among.n, of);
        }
    }
}
