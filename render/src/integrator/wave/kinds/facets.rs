//! Normals of many rough surfaces: as if all were GGX, then one by one those that are not.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::{Among, Scattering};
use crate::bsdf::microfacet::ggx_sample_visible;
use crate::bsdf::{Facets, beckmann, upwards};

lanes! {
    /// [`Facets`], and the roughness of their surfaces.
    FacetLanes {
        alpha: Lane<P>,
        m: Lanes<P>,
        d: Lane<P>,
        sigma_o: Lane<P>,
        sigma_i: Lane<P>,
    }
}

impl<P: Float> FacetLanes<P> {
    #[inline(always)]
    pub fn at(&self, k: usize) -> Facets<P> {
        Facets {
            m: self.m.vec(k),
            d: self.d[k],
            sigma: [self.sigma_o[k], self.sigma_i[k]],
        }
    }

    #[inline(always)]
    pub fn put(&mut self, k: usize, facets: &Facets<P>) {
        self.m.put_vec(k, facets.m);
        self.d[k] = facets.d;
        [self.sigma_o[k], self.sigma_i[k]] = facets.sigma;
    }

    /// Those of a GGX surface that reflect `wi` to `wo`, and whether they are right.
    #[inline(always)]
    pub fn between(&self, k: usize, of: &Scattering<P>) -> (Facets<P>, bool) {
        let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
        let (m, right) = (wo + wi).unit();
        // Below the horizon there is no normal.
        let below = (wo.z <= P::zero()) | (wi.z <= P::zero());
        (Facets::ggx(self.alpha[k], m, [wo, wi]), right | below)
    }

    /// A normal on the upper side of a GGX surface, made of random numbers, and whether it is right. `through`: whether
    /// it is wanted where `wo` is below.
    #[inline(always)]
    pub fn drawn(&self, k: usize, of: &Scattering<P>, through: bool) -> (Vec3<P>, bool) {
        let (wo, u) = (of.wo.vec(k), of.u.vec(k));
        let (m, right) = ggx_sample_visible(self.alpha[k], upwards(wo), [u.y, u.z]);
        (m, right | !(through | (wo.z > P::zero())))
    }

    /// [`FacetLanes::between`] of all.
    #[inline(never)]
    pub fn reflecting(&mut self, among: Among, of: &mut Scattering<P>) {
        for k in 0..whole(among.n) {
            let (facets, right) = self.between(k, of);
            self.put(k, &facets);
            of.right[k] = u32::from(right);
        }
        for &k in among.one_by_one {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let above = (wo.z > P::zero()) & (wi.z > P::zero());
            let asked = above & (of.asked[k] != 0);
            let facets = Facets::beckmann(self.alpha[k], self.m.vec(k), [wo, wi], asked);
            self.put(k, &facets);
        }
    }

    /// [`FacetLanes::drawn`] for all.
    #[inline(never)]
    pub fn sample(&mut self, among: Among, of: &mut Scattering<P>, through: bool) {
        for k in 0..whole(among.n) {
            let (m, right) = self.drawn(k, of, through);
            self.m.put_vec(k, m);
            of.sampled[k] = u32::from(right);
        }
        for &k in among.one_by_one {
            let (wo, u) = (of.wo.vec(k), of.u.vec(k));
            let asked = (wo.z > P::zero()) | (through & (wo.z < P::zero()));
            if asked & (of.asked[k] != 0) {
                let m = beckmann(self.alpha[k]).sample_visible(upwards(wo), [u.y, u.z]);
                self.m.put_vec(k, m);
                of.sampled[k] = 1;
            }
        }
    }
}
