//! Rough plastic, of which visible normals are sampled.

use ad_core::Float;

use super::super::lanes::{Field, Lane, WAVE_SIZE, lanes, whole};
use super::facets::{Shape, Surfaces};
use super::plastics::Coatings;
use super::{CONTINUOUS, Members, Scattering};
use crate::bsdf::{Leaf, Material, Passes, Shading};

lanes! {
    /// Rough plastic, but for its normals and tables.
    RoughCoatings {
        coated: Coatings<P>,
        /// What passes of light along `wo`; negative where that is not known.
        t_o: Lane<P>,
        /// The same of light along `wi`.
        t_i: Lane<P>,
        /// What does not of diffuse light from below.
        inside: Lane<P>,
    }
}

/// Rough plastic whose normals are of one shape.
pub struct RoughPlastics<P, N> {
    lanes: RoughCoatings<P>,
    facets: Surfaces<P, P, N>,
    /// In the order of their places.
    passes: Vec<Passes<'static, P>>,
}

impl<P: Float, N: Shape> RoughPlastics<P, N> {
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

    #[inline(never)]
    fn value(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let directions = [of.wo.vec(k), of.wi.vec(k)];
            let passes = [self.lanes.t_o[k], self.lanes.t_i[k], self.lanes.inside[k]];
            let coated = self.lanes.coated.at(k);
            let (f, pdf) = coated.rough_eval_pdf(&self.facets.facets(k), directions, passes);
            of.f.put_rgb(k, f);
            of.pdf[k] = pdf;
        }
    }

    #[inline(never)]
    fn turn(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, u) = (of.wo.vec(k), of.u.vec(k).to_array());
            let coated = self.lanes.coated.at(k);
            let wi = coated.rough_sample(wo, self.facets.normal(k), u, self.lanes.t_o[k]);
            of.wi.put_vec(k, wi);
            of.eta[k] = P::one();
            of.component[k] = CONTINUOUS;
        }
    }
}

impl<P: Float, N: Shape> Members<P> for RoughPlastics<P, N> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self {
            lanes: RoughCoatings::zero(),
            facets: Surfaces::new(),
            passes: Vec::with_capacity(WAVE_SIZE),
        }
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, at: &Shading<P>) -> bool {
        let Material::RoughPlastic(m) = material else {
            return false;
        };
        let lobe = m.lobe(&mut { *at });
        let (lanes, alpha) = (&mut self.lanes, lobe.microfacet.alpha);
        let passes = lobe.table.passes(alpha, lobe.coated.eta);
        self.facets.put(k, alpha);
        lanes.coated.put(k, &lobe.coated);
        lanes.inside[k] = passes.inside();
        lanes.t_o[k] = -P::one();
        self.passes.truncate(k);
        self.passes.push(passes);
        true
    }

    #[inline(always)]
    fn eval_pdf(&mut self, n: usize, of: &mut Scattering<P>) {
        self.look_out(of);
        self.look_in(of);
        self.facets.reflecting(n, of);
        self.value(n, of);
    }

    #[inline(always)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        self.look_out(of);
        self.facets.sample(n, of, false);
        self.turn(n, of);
        self.eval_pdf(n, of);
    }
}
