//! Normals of many rough surfaces, all of one shape.

use std::marker::PhantomData;

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::Scattering;
use crate::bsdf::microfacet::{Alpha, Microfacet, Ndf};
use crate::bsdf::{Facets, upwards};

/// The shape of all normals of a kind: what differs there would not be one loop.
pub trait Shape {
    /// Which it is.
    const NDF: Ndf;
}

/// GGX.
pub struct Ggx;
/// Beckmann's.
pub struct Beckmann;

impl Shape for Ggx {
    const NDF: Ndf = Ndf::Ggx;
}
impl Shape for Beckmann {
    const NDF: Ndf = Ndf::Beckmann;
}

lanes! {
    /// [`Facets`], and the roughness of their surfaces along both axes.
    FacetLanes {
        along: Lane<P>,
        across: Lane<P>,
        m: Lanes<P>,
        d: Lane<P>,
        sigma_o: Lane<P>,
        sigma_i: Lane<P>,
    }
}

/// Surfaces of which visible normals are sampled, and their facets.
pub struct Surfaces<P, A, N> {
    lanes: FacetLanes<P>,
    shape: PhantomData<(A, N)>,
}

impl<P: Float, A: Alpha<Scalar = P>, N: Shape> Surfaces<P, A, N> {
    pub fn new() -> Self {
        Self {
            lanes: FacetLanes::zero(),
            shape: PhantomData,
        }
    }

    /// Makes the `k`-th as rough as that.
    #[inline(always)]
    pub fn put(&mut self, k: usize, alpha: impl Alpha<Scalar = P>) {
        [self.lanes.along[k], self.lanes.across[k]] = alpha.axes();
    }

    /// Makes the `k`-th as rough as an earlier one.
    #[inline(always)]
    pub fn repeat(&mut self, k: usize, earlier: usize) {
        self.lanes.along[k] = self.lanes.along[earlier];
        self.lanes.across[k] = self.lanes.across[earlier];
    }

    #[inline(always)]
    pub fn surface(&self, k: usize) -> Microfacet<A> {
        Microfacet {
            kind: N::NDF,
            alpha: A::along([self.lanes.along[k], self.lanes.across[k]]),
            visible: true,
        }
    }

    /// The normal of the `k`-th.
    #[inline(always)]
    pub fn normal(&self, k: usize) -> Vec3<P> {
        self.lanes.m.vec(k)
    }

    /// Replaces the `k`-th normal.
    #[inline(always)]
    pub fn put_normal(&mut self, k: usize, m: Vec3<P>) {
        self.lanes.m.put_vec(k, m);
    }

    #[inline(always)]
    pub fn facets(&self, k: usize) -> Facets<P> {
        Facets {
            m: self.normal(k),
            d: self.lanes.d[k],
            sigma: [self.lanes.sigma_o[k], self.lanes.sigma_i[k]],
        }
    }

    /// Keeps what facets with the normal `m` do between two directions.
    #[inline(always)]
    pub fn keep(&mut self, k: usize, m: Vec3<P>, directions: [Vec3<P>; 2]) {
        let facets = Facets::of(&self.surface(k), m, directions);
        self.lanes.m.put_vec(k, facets.m);
        self.lanes.d[k] = facets.d;
        [self.lanes.sigma_o[k], self.lanes.sigma_i[k]] = facets.sigma;
    }

    /// The normal that reflects `wi` to `wo`, and whether it is right.
    #[inline(always)]
    pub fn between(wo: Vec3<P>, wi: Vec3<P>) -> (Vec3<P>, bool) {
        let (m, right) = (wo + wi).unit();
        // Below the horizon there is no normal.
        let below = (wo.z <= P::zero()) | (wi.z <= P::zero());
        (m, right | below)
    }

    /// A normal on the upper side, made of random numbers, and whether it is right. `through`: whether it is wanted where
    /// `wo` is below.
    #[inline(always)]
    pub fn drawn(&self, k: usize, of: &Scattering<P>, through: bool) -> (Vec3<P>, bool) {
        let (wo, u) = (of.wo.vec(k), of.u.vec(k));
        let surface = self.surface(k);
        let (m, right) = surface.sample_visible_in_line(upwards(wo), [u.y, u.z]);
        (m, right | !(through | (wo.z > P::zero())))
    }

    /// [`Surfaces::between`] of the first `n`, and what such facets do.
    #[inline(never)]
    pub fn reflecting(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let (m, right) = Self::between(wo, wi);
            self.keep(k, m, [wo, wi]);
            of.right[k] = u32::from(right);
        }
    }

    /// [`Surfaces::drawn`] for the first `n`.
    #[inline(never)]
    pub fn sample(&mut self, n: usize, of: &mut Scattering<P>, through: bool) {
        for k in 0..whole(n) {
            let (m, right) = self.drawn(k, of, through);
            self.put_normal(k, m);
            of.sampled[k] = u32::from(right);
        }
    }
}
