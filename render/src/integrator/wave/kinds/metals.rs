//! Metals, rough ones of which visible normals are sampled, and mirrors.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::super::readings::Reading;
use super::facets::{Shape, Surfaces};
use super::{CONTINUOUS, Members, REFLECTED, Scattering};
use crate::bsdf::microfacet::Alpha;
use crate::bsdf::{ConductorLobe, Facets, Leaf, Material, Metal, reflect};
use crate::math::Rgb;

lanes! {
    /// Metals, but for their normals.
    MetalLanes {
        specular_reflectance: Lanes<P>,
        eta: Lanes<P>,
        k: Lanes<P>,
        has_index: Lane<u32>,
        /// Whether it is a mirror.
        smooth: Lane<u32>,
    }
}

/// Metals whose normals are of one shape; mirrors may be among them.
pub struct Metals<P, A, N> {
    lanes: MetalLanes<P>,
    facets: Surfaces<P, A, N>,
}

impl<P: Float> MetalLanes<P> {
    #[inline(always)]
    fn metal(&self, k: usize) -> Metal<P> {
        Metal {
            specular_reflectance: self.specular_reflectance.rgb(k),
            index: [self.eta.rgb(k), self.k.rgb(k)],
            has_index: self.has_index[k] != 0,
        }
    }

    #[inline(always)]
    fn put(&mut self, k: usize, facet: &ConductorLobe<P>, smooth: bool) {
        let metal = Metal::of(facet);
        self.specular_reflectance
            .put_rgb(k, metal.specular_reflectance);
        self.eta.put_rgb(k, metal.index[0]);
        self.k.put_rgb(k, metal.index[1]);
        self.has_index[k] = u32::from(metal.has_index);
        self.smooth[k] = u32::from(smooth);
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

impl<P: Float, A: Alpha<Scalar = P>, N: Shape> Metals<P, A, N> {
    /// Normals, and what they reflect.
    #[inline(never)]
    fn value(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let (m, right) = Surfaces::<P, A, N>::between(wo, wi);
            let facets = Facets::of(&self.facets.surface(k), m, [wo, wi]);
            let (f, pdf) = self.lanes.metal(k).eval_pdf(wo, wi, &facets);
            // Nothing comes from a light to a mirror.
            let rough = self.lanes.smooth[k] == 0;
            of.f.put_rgb(k, Rgb::select(rough, f, Rgb::black()));
            of.pdf[k] = P::select(rough, pdf, P::zero());
            of.right[k] = u32::from(right | !rough);
        }
    }

    /// Normals, and where they lead.
    #[inline(never)]
    fn turn(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (m, right) = self.facets.drawn(k, of, false);
            of.sampled[k] = u32::from(right);
            of.wi.put_vec(k, reflect(of.wo.vec(k), m));
        }
    }
}

impl<P: Float, A: Alpha<Scalar = P>, N: Shape> Members<P> for Metals<P, A, N> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self {
            lanes: MetalLanes::zero(),
            facets: Surfaces::new(),
        }
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool {
        match material {
            Material::RoughConductor(m) => {
                let lobe = m.lobe(read);
                self.facets.put(k, lobe.microfacet.alpha);
                self.lanes.put(k, &lobe.facet, false);
            }
            Material::AnisotropicConductor(m) => {
                let lobe = m.lobe(read);
                self.facets.put(k, lobe.microfacet.alpha);
                self.lanes.put(k, &lobe.facet, false);
            }
            Material::Conductor(m) => {
                self.facets.put(k, P::one());
                self.lanes.put(k, &m.lobe(read), true);
            }
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
        self.value(n, of);
    }

    #[inline(always)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        self.turn(n, of);
        self.value(n, of);
        let lanes = whole(n);
        of.eta[..lanes].fill(P::one());
        of.component[..lanes].fill(CONTINUOUS);
        if self.lanes.smooth[..n].contains(&1) {
            self.lanes.reflect(n, of);
        }
    }
}
