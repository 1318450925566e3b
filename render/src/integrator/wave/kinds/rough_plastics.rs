//! Rough plastic, of which visible normals are sampled.

use ad_core::Float;

use super::super::lanes::{Field, Lane, WAVE_SIZE, lanes, whole};
use super::facets::FacetLanes;
use super::plastics::Coatings;
use super::{Among, CONTINUOUS, Members, Scattering};
use crate::bsdf::microfacet::Ndf;
use crate::bsdf::{Leaf, Material, Passes, Shading};

lanes! {
    /// Rough plastic, but for its tables.
    RoughCoatings {
        facets: FacetLanes<P>,
        coated: Coatings<P>,
        /// What passes of light along `wo`; negative where that is not known.
        t_o: Lane<P>,
        /// The same of light along `wi`.
        t_i: Lane<P>,
        /// What does not of diffuse light from below.
        inside: Lane<P>,
    }
}

/// Rough plastic.
pub struct RoughPlastics<P> {
    lanes: RoughCoatings<P>,
    /// In the order of their places.
    passes: Vec<Passes<'static, P>>,
}

impl<P: Float> RoughPlastics<P> {
    /// Looked up one by one: what passes along `wo` once, for all that is asked.
    #[inline(never)]
    fn look_out(&mut self, of: &Scattering<P>) {
        for (k, passes) in self.passes.iter().enumerate().take(WAVE_SIZE) {
            let cos = of.wo.vec(k).z;
            if self.lanes.t_o[k] < P::zero() && cos > P::zero() {
                self.lanes.t_o[k] = passes.transmit(cos);
            }
        }
    }

    #[inline(never)]
    fn look_in(&mut self, of: &Scattering<P>) {
        for (k, passes) in self.passes.iter().enumerate().take(WAVE_SIZE) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            if wo.z > P::zero() && wi.z > P::zero() {
                self.lanes.t_i[k] = passes.transmit(wi.z);
            }
        }
    }
}

impl<P: Float> RoughCoatings<P> {
    #[inline(never)]
    fn value(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let directions = [of.wo.vec(k), of.wi.vec(k)];
            let passes = [self.t_o[k], self.t_i[k], self.inside[k]];
            let coated = self.coated.at(k);
            let (f, pdf) = coated.rough_eval_pdf(&self.facets.at(k), directions, passes);
            of.f.put_rgb(k, f);
            of.pdf[k] = pdf;
        }
    }

    #[inline(never)]
    fn turn(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, u) = (of.wo.vec(k), of.u.vec(k).to_array());
            let coated = self.coated.at(k);
            let wi = coated.rough_sample(wo, self.facets.m.vec(k), u, self.t_o[k]);
            of.wi.put_vec(k, wi);
            of.eta[k] = P::one();
            of.component[k] = CONTINUOUS;
        }
    }
}

impl<P: Float> Members<P> for RoughPlastics<P> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self {
            lanes: RoughCoatings::zero(),
            passes: Vec::with_capacity(WAVE_SIZE),
        }
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, at: &Shading<P>) -> Option<Ndf> {
        let Material::RoughPlastic(m) = material else {
            return None;
        };
        let lobe = m.lobe(&mut { *at });
        let (lanes, alpha) = (&mut self.lanes, lobe.microfacet.alpha);
        let passes = lobe.table.passes(alpha);
        lanes.facets.alpha[k] = alpha;
        lanes.coated.put(k, &lobe.coated);
        lanes.inside[k] = passes.inside();
        lanes.t_o[k] = -P::one();
        self.passes.truncate(k);
        self.passes.push(passes);
        Some(lobe.microfacet.kind)
    }

    #[inline(always)]
    fn eval_pdf(&mut self, among: Among, of: &mut Scattering<P>) {
        self.look_out(of);
        self.look_in(of);
        self.lanes.facets.reflecting(among, of);
        self.lanes.value(among.n, of);
    }

    #[inline(always)]
    fn sample(&mut self, among: Among, of: &mut Scattering<P>) {
        self.look_out(of);
        self.lanes.facets.sample(among, of, false);
        self.lanes.turn(among.n, of);
        self.eval_pdf(among, of);
    }
}
