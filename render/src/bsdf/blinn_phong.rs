//! Blinn-Phong microfacets over a diffuse base: the material M2 of [Stam 2020].

use std::f64::consts::PI;

use ad_core::{Const, Float, Real, Vec3};

use super::{BsdfSample, Component, Leaf, Lobe, Reader, TransportMode, constant};
use crate::error::SceneError;
use crate::math::gauss::{exp_m1, exp_minus, fading, ln_1p};
use crate::math::{Rgb, warp};
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::{RgbTexture, ScalarTexture};

/// Largest valid exponent.
const MAX_EXPONENT: f64 = 1e6;

/// Each part is sampled at least this often: the derivative with respect to an albedo that is zero
/// is not (F7).
const LEAST_SHARE: f64 = 0.05;

/// A one-sided glossy reflector [Stam 2020, appendix C], as corrected in errata S-C1 to S-C4.
///
/// # Does not handle
/// Reciprocity and shadowing: the geometric term is the paper's, `cos_m / (4 cos_mo cos_i)`. For a
/// fixed viewing direction it conserves energy; for a fixed light direction it does not (errata
/// S-C2), and particles gain energy at grazing angles. Rough conductors and plastics are free of this.
#[derive(Clone, Debug)]
pub struct BlinnPhong {
    /// Albedo of the base, in [0, 1].
    pub diffuse: RgbTexture,
    /// Colour of the microfacets, in [0, 1].
    pub specular: RgbTexture,
    /// Exponent of the distribution of normals, in [0, 1e6]; `2 / alpha^2 - 2` for roughness alpha.
    pub exponent: ScalarTexture,
    /// How directions are sampled.
    pub sampling: BlinnPhongSampling,
}

/// How [`BlinnPhong`] samples directions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BlinnPhongSampling {
    /// Base or microfacets, in proportion to their albedos [Stam 2020, figure 8].
    #[default]
    Importance,
    /// Always cosine-weighted [Stam 2020, figure 7].
    Cosine,
}

/// `f_s = diffuse / pi + specular D(m) cos_m / (4 cos_mo cos_i)` above the surface.
#[derive(Clone, Copy, Debug)]
pub struct BlinnPhongLobe<R: Real> {
    /// Albedo of the base.
    pub diffuse: Rgb<R>,
    /// Colour of the microfacets.
    pub specular: Rgb<R>,
    /// Exponent.
    pub exponent: R,
    /// Probability of sampling the microfacets: primal, as every discrete decision.
    pub(crate) share: R::Primal,
}

/// Probability of sampling the microfacets, in proportion to the albedos.
#[inline]
fn choice<R: Real>(diffuse: Rgb<R>, specular: Rgb<R>) -> R {
    let (d, s) = (diffuse.mean(), specular.mean());
    if (d + s).primal() > R::Primal::zero() {
        let least = R::of(LEAST_SHARE);
        (s / (d + s)).clamp(least, R::one() - least)
    } else {
        R::of(0.5)
    }
}

impl<R: Real> BlinnPhongLobe<R> {
    /// From evaluated parameters.
    #[inline]
    pub fn new(
        diffuse: Rgb<R>,
        specular: Rgb<R>,
        exponent: R,
        sampling: BlinnPhongSampling,
    ) -> Self {
        let share = match sampling {
            BlinnPhongSampling::Cosine => R::Primal::zero(),
            BlinnPhongSampling::Importance => choice(diffuse.primal(), specular.primal()),
        };
        Self {
            diffuse,
            specular,
            exponent,
            share,
        }
    }

    /// Density of the directions that sampled microfacets reflect `wo` into, per solid angle:
    /// `(e + 2) / (2 pi) cos_m^(e + 1) / (4 cos_mo)`. Both directions above the horizon.
    ///
    /// It is also the lobe times `cos_i` for a white specular colour in radiance mode: the weight
    /// of a sample is 1. Its derivative in the exponent is the density times
    /// `1 / (e + 2) + ln cos_m` (errata S-C3), finite at `cos_m = 1` (errata S-C4).
    ///
    /// Source: [Stam 2020, appendix C] with errata S-C1; `ln cos_m` by the tangent, because `cos_m^e`
    /// from a rounded cosine has a relative error of `e` roundings.
    #[inline(always)]
    pub fn microfacet_pdf(&self, wo: Vec3<R>, wi: Vec3<R>) -> R {
        let h = wo + wi;
        let tan2 = (h.x * h.x + h.y * h.y) / (h.z * h.z);
        // Above the horizon, lengths are normal numbers.
        let cos_mo = h.length_squared().sqrt() * R::c(0.5);
        let e = self.exponent;
        let steepness = (e + R::one()) * (ln_1p(tan2) * R::c(0.5));
        (e + R::of(2.0)) * fading(steepness) / (cos_mo * R::c(8.0 * PI))
    }

    /// A microfacet normal with density `(e + 2) / (2 pi) cos_m^(e + 1)` per solid angle
    /// [Stam 2020, appendix B with errata S-B2].
    #[inline(always)]
    pub fn sample_normal(&self, u: [R::Primal; 2]) -> Vec3<R> {
        // ln cos^2, then sin^2 without cancellation.
        let ln_cos2 =
            (self.exponent + R::of(2.0)).recip() * Const(R::Primal::of(2.0) * ln_1p(-u[0]));
        let cos = exp_minus(ln_cos2 * R::c(-0.5));
        let sin = (-exp_m1(ln_cos2)).sqrt();
        let (sin_phi, cos_phi) = warp::sin_cos_of_turns(u[1]);
        Vec3::new(sin * Const(cos_phi), sin * Const(sin_phi), cos)
    }

    /// Whether a direction is above the horizon by more than the rounding of its components. Closer
    /// to it, the densities below are larger than any number.
    #[inline(always)]
    fn above(w: Vec3<R>) -> bool {
        w.z.primal() > R::Primal::EPSILON
    }

    #[inline(always)]
    fn mixture(&self, wi: Vec3<R>, microfacets: R) -> R {
        let base = warp::cosine_hemisphere_pdf(wi.z);
        base * Const(R::Primal::one() - self.share) + microfacets * Const(self.share)
    }

    #[inline(always)]
    fn value(&self, wo: Vec3<R>, wi: Vec3<R>, microfacets: R, mode: TransportMode) -> Rgb<R> {
        let specular = match mode {
            TransportMode::Radiance => microfacets,
            // f*(i -> o) = f(o -> i): cos_i in the geometric term becomes cos_o.
            TransportMode::Importance => microfacets * wi.z / wo.z,
        };
        self.diffuse * (wi.z * R::c(1.0 / PI)) + self.specular * specular
    }

    /// [`Lobe::eval_pdf`], and whether anything is scattered: without a branch, for loops over many.
    #[inline(always)]
    fn eval_pdf_where(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> (Rgb<R>, R, bool) {
        let microfacets = self.microfacet_pdf(wo, wi);
        (
            self.value(wo, wi, microfacets, mode),
            self.mixture(wi, microfacets),
            Self::above(wo) & Self::above(wi),
        )
    }

    /// Where a normal leads, and whether it is seen from its front. A facet seen from behind reflects nothing; mirroring
    /// it would change the density (errata S-D2).
    #[inline(always)]
    fn mirrored(&self, wo: Vec3<R>, u: [R::Primal; 2]) -> (Vec3<R>, bool) {
        let m = self.sample_normal(u);
        let cos_mo = m.dot(wo);
        // As long as one but for rounding: no branch.
        let (wi, _) = (m * (cos_mo * R::c(2.0)) - wo).unit();
        (wi, cos_mo.primal() > R::Primal::zero())
    }
}

impl<P: Float> BlinnPhongLobe<P> {
    /// [`Lobe::eval_pdf`] of radiance without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn eval_pdf_in_line(&self, wo: Vec3<P>, wi: Vec3<P>) -> (Rgb<P>, P) {
        let (f, pdf, above) = self.eval_pdf_where(wo, wi, TransportMode::Radiance);
        let f = Rgb::select(above, f, Rgb::black());
        (f, P::select(above, pdf, P::zero()))
    }

    /// The direction of [`Lobe::sample`], and whether there is one: without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn scatter(&self, wo: Vec3<P>, u: [P; 3]) -> (Vec3<P>, bool) {
        let (mirrored, faces) = self.mirrored(wo, [u[1], u[2]]);
        let of_facets = u[0] < self.share;
        let cosine = warp::square_to_cosine_hemisphere([u[1], u[2]]);
        let wi = Vec3::select(of_facets, mirrored, cosine);
        (wi, Self::above(wo) & (faces | !of_facets))
    }
}

impl Leaf for BlinnPhong {
    type Lobe<R: Real> = BlinnPhongLobe<R>;

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> BlinnPhongLobe<R> {
        BlinnPhongLobe::new(
            read.rgb(&self.diffuse),
            read.rgb(&self.specular),
            read.exponent(&self.exponent),
            self.sampling,
        )
    }
}

impl<R: Real> Lobe<R> for BlinnPhongLobe<R> {
    #[inline]
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> Rgb<R> {
        if !Self::above(wo) || !Self::above(wi) {
            return Rgb::black();
        }
        self.value(wo, wi, self.microfacet_pdf(wo, wi), mode)
    }

    #[inline]
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> R {
        if !Self::above(wo) || !Self::above(wi) {
            return R::zero();
        }
        self.mixture(wi, self.microfacet_pdf(wo, wi))
    }

    #[inline]
    fn eval_pdf(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> (Rgb<R>, R) {
        if !Self::above(wo) || !Self::above(wi) {
            return (Rgb::black(), R::zero());
        }
        let (f, pdf, _) = self.eval_pdf_where(wo, wi, mode);
        (f, pdf)
    }

    #[inline]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        if !Self::above(wo) {
            return None;
        }
        let wi = if u[0] < self.share {
            let (wi, faces) = self.mirrored(wo, [u[1], u[2]]);
            if !faces {
                return None;
            }
            wi
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
        mode: TransportMode,
    ) -> R {
        // Importance sampling never leaves the microfacets out.
        if self.share == R::Primal::zero() {
            return constant(self.pdf(wo, wi, mode));
        }
        if !Self::above(wo) || !Self::above(wi) {
            return R::zero();
        }
        let share = choice(self.diffuse, self.specular);
        constant(warp::cosine_hemisphere_pdf(wi.z)) * (R::one() - share)
            + constant(self.microfacet_pdf(wo, wi)) * share
    }
}

impl FromNode for BlinnPhong {
    const PLUGINS: &'static [&'static str] = &["blinnphong"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let unit = (0.0, 1.0);
        Ok(Self {
            diffuse: registry.rgb_texture(node, "diffuse_reflectance", [0.5; 3], unit)?,
            specular: registry.rgb_texture(node, "specular_reflectance", [0.2; 3], unit)?,
            exponent: registry.scalar_texture(node, "exponent", 30.0, (0.0, MAX_EXPONENT))?,
            sampling: if node.boolean_or("importance_sampling", true)? {
                BlinnPhongSampling::Importance
            } else {
                BlinnPhongSampling::Cosine
            },
        })
    }
}
