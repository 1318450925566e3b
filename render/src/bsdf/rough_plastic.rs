//! Rough plastic: a diffuse base under a rough dielectric coat.

use ad_core::{Const, Float, Real, Vec3};

use super::coat::Coat;
use super::microfacet::Microfacet;
use super::plastic::{Coated, CoatedLobe};
use super::rough_conductor::{
    Facets as Known, Roughness, half_vector, pdf_reflected_differential, reflect, reflection,
    reflection_of_normals, sample_reflected_differential,
};
use super::{BsdfSample, Component, Leaf, Lobe, Reader, TransportMode, constant, fresnel};
use crate::error::SceneError;
use crate::math::{Rgb, warp};
use crate::plugin::{FromNode, Node, Registry};

/// A diffuse surface under a rough coat.
#[derive(Clone, Debug)]
pub struct RoughPlastic {
    /// The coat's microsurface.
    pub roughness: Roughness,
    /// Colours and index.
    pub coated: Coated,
    table: &'static Coat,
}

/// Reflection by the coat's facets, and what comes back from below it: the model of Mitsuba's
/// `roughplastic`.
///
/// What passes the coat is all that its facets do not reflect at once. Mitsuba lets through what rough glass of the same
/// roughness transmits, which is less: what facets hide from each other is lost there. Ours is brighter by some percent,
/// the more the rougher; neither returns all light where nothing absorbs any.
///
/// How much light passes the coat has no closed form and is interpolated in a [`Coat`]. The
/// interpolant *is* the model: it is continuously differentiable in roughness, angle and index, and
/// derivatives are exactly those of the values.
#[derive(Clone, Copy, Debug)]
pub struct RoughPlasticLobe<R: Real> {
    /// The coat's facets.
    pub microfacet: Microfacet<R>,
    /// Colours and index.
    pub coated: CoatedLobe<R>,
    /// What passes the coat.
    pub table: &'static Coat,
}

impl RoughPlastic {
    /// From its parts.
    pub fn new(roughness: Roughness, coated: Coated) -> Self {
        let table = Coat::get(roughness.kind, coated.first_eta.into());
        Self {
            roughness,
            coated,
            table,
        }
    }
}

impl Leaf for RoughPlastic {
    type Lobe<R: Real> = RoughPlasticLobe<R>;
    const DIFFERENTIAL: bool = true;

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> RoughPlasticLobe<R> {
        RoughPlasticLobe {
            microfacet: self.roughness.read(read),
            coated: CoatedLobe::read(&self.coated, read),
            table: self.table,
        }
    }
}

impl<R: Real> RoughPlasticLobe<R> {
    #[inline]
    fn choose_coat(&self, wo: Vec3<R>) -> R::Primal {
        let [alpha, eta] = [self.microfacet.alpha, self.coated.eta].map(R::primal);
        let passes = self.table.passes(alpha, eta).transmit(wo.z.primal());
        self.coated.choose_coat(R::Primal::one() - passes)
    }
}

impl<P: Float> CoatedLobe<P> {
    /// [`Lobe::eval_pdf`] of a rough coat where the facets and what of it [passes](super::coat::Passes) for `wo` and `wi` are
    /// known, and visible normals are sampled: without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn rough_eval_pdf(
        &self,
        facets: &Known<P>,
        [wo, wi]: [Vec3<P>; 2],
        [t_o, t_i, inside]: [P; 3],
    ) -> (Rgb<P>, P) {
        let (zero, one) = (P::zero(), P::one());
        let f = fresnel::dielectric(wo.dot(facets.m), self.eta).reflect;
        let coat = f * facets.reflection(wi);
        let value = self.specular_reflectance * coat + self.diffuse(wi.z, t_i, t_o, inside);
        let coat = self.choose_coat(one - t_o);
        let base = warp::cosine_hemisphere_pdf(wi.z) * (one - coat);
        let pdf = facets.pdf_reflected() * coat + base;
        let lit = (wo.z > zero) & (wi.z > zero);
        let value = Rgb::select(lit, value, Rgb::black());
        (value, P::select(lit, pdf, zero))
    }

    /// The direction that [`Lobe::sample`] of a rough coat finds by a normal of its facets: likewise.
    #[inline(always)]
    pub(crate) fn rough_sample(&self, wo: Vec3<P>, m: Vec3<P>, u: [P; 3], t_o: P) -> Vec3<P> {
        let reflects = u[0] < self.choose_coat(P::one() - t_o);
        let base = warp::square_to_cosine_hemisphere([u[1], u[2]]);
        Vec3::select(reflects, reflect(wo, m), base)
    }
}

impl<R: Real> Lobe<R> for RoughPlasticLobe<R> {
    #[inline]
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
        let Some(m) = half_vector(wo, wi) else {
            return Rgb::black();
        };
        let f = self.coated.coat(wo.dot(m)).reflect;
        let coat = f * reflection(&self.microfacet, wo, wi, m);
        let passes = self.table.passes(self.microfacet.alpha, self.coated.eta);
        let (t_i, t_o) = (passes.transmit(wi.z), passes.transmit(wo.z));
        self.coated.specular_reflectance * coat
            + self.coated.diffuse(wi.z, t_i, t_o, passes.inside())
    }

    #[inline]
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> R {
        let Some(m) = half_vector(wo, wi) else {
            return R::zero();
        };
        let coat = self.choose_coat(wo);
        self.microfacet.pdf_reflected(wo, m) * Const(coat)
            + warp::cosine_hemisphere_pdf(wi.z) * Const(R::Primal::one() - coat)
    }

    /// Chooses coat or base by the (primal) light they send on.
    #[inline]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        if wo.z.primal() <= R::Primal::zero() {
            return None;
        }
        let wi = if u[0] < self.choose_coat(wo) {
            reflect(wo, self.microfacet.sample(wo, [u[1], u[2]]))
        } else {
            Vec3::lift(warp::square_to_cosine_hemisphere([u[1], u[2]]))
        };
        let pdf = self.pdf(wo, wi, mode);
        BsdfSample::reflected(wi, pdf)
    }

    #[inline]
    fn choice_pdf(
        &self,
        wo: Vec3<R>,
        wi: Vec3<R>,
        _component: Component,
        _mode: TransportMode,
    ) -> R {
        let Some(m) = half_vector(wo, wi) else {
            return R::zero();
        };
        let passes = self.table.passes(self.microfacet.alpha, self.coated.eta);
        let coat = self
            .coated
            .attached_choice(R::one() - passes.transmit(wo.z));
        constant(self.microfacet.pdf_reflected(wo, m)) * coat
            + constant(warp::cosine_hemisphere_pdf(wi.z)) * (R::one() - coat)
    }

    /// Of the coat only: the base changes little with roughness.
    #[inline]
    fn eval_normals(
        &self,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        _mode: TransportMode,
    ) -> Rgb<R> {
        let Some(m) = half_vector(wo, wi) else {
            return Rgb::black();
        };
        let f = fresnel::dielectric(wo.dot(m), self.coated.eta.primal()).reflect;
        let coat = self.coated.specular_reflectance.primal() * f;
        Rgb::lift(coat) * reflection_of_normals(&self.microfacet, wo, wi, m)
    }

    #[inline]
    fn sample_differential(
        &self,
        wo: Vec3<R::Primal>,
        u: [R::Primal; 3],
        _mode: TransportMode,
    ) -> [Option<BsdfSample<R::Primal>>; 2] {
        sample_reflected_differential(&self.microfacet.primal(), wo, [u[1], u[2]])
    }

    #[inline]
    fn pdf_differential(&self, wo: Vec3<R::Primal>, wi: Vec3<R::Primal>) -> R::Primal {
        pdf_reflected_differential(&self.microfacet.primal(), wo, wi)
    }
}

impl FromNode for RoughPlastic {
    const PLUGINS: &'static [&'static str] = &["roughplastic"];

    /// As [`Roughness::from_node`] and [`Coated::from_node`].
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let roughness = Roughness::from_node(node, registry)?;
        let coated = Coated::from_node(node, registry, true)?;
        Ok(Self::new(roughness, coated))
    }
}
