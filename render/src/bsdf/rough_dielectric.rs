//! Rough dielectrics: a microfacet distribution of glass facets.

use ad_core::{Const, Float, Real, Vec3};

use super::dielectric::{eta_across, relative_index, wrong_index};
use super::fresnel;
use super::microfacet::{Alpha, Axes, Microfacet};
use super::rough_conductor::{Facets, Roughness, is_anisotropic, reflect, reflection};
use super::{BsdfSample, Component, Leaf, Lobe, Reader, TransportMode, constant};
use crate::error::SceneError;
use crate::math::{Rgb, both};
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::{RgbTexture, ScalarTexture};

/// A rough interface between two dielectrics; `T` as of [`Roughness`].
#[derive(Clone, Debug)]
pub struct RoughDielectric<T = ScalarTexture> {
    /// Its microsurface.
    pub roughness: Roughness<T>,
    /// Index of refraction below the surface over that above. Its valid range ends before 1, where
    /// refraction degenerates to a Dirac delta.
    pub eta: ScalarTexture,
    /// Factor on the reflectance, in [0, 1]; 1 is physical.
    pub specular_reflectance: RgbTexture,
    /// Factor on the transmittance, in [0, 1]; 1 is physical.
    pub specular_transmittance: RgbTexture,
}

/// Rough glass that was brushed: another roughness across dp/du than along it.
///
/// # Derivatives
/// As of [`super::AnisotropicConductor`].
pub type AnisotropicDielectric = RoughDielectric<[ScalarTexture; 2]>;

/// Reflection [Zeltner 2021, Eq. 2.36] and refraction [Eq. 2.37, corrected: errata Z-2.38, Z-2.42],
/// with separable masking.
///
/// # Derivatives
/// Seen from the denser side, the reflectance of facets has an infinite slope at the critical angle.
/// It is integrable, but attached sampling, which moves facets through that angle, has infinite
/// variance there; detached sampling has not, unless the index itself moves.
#[derive(Clone, Copy, Debug)]
pub struct RoughDielectricLobe<R, A = R> {
    /// Distribution of facets.
    pub microfacet: Microfacet<A>,
    /// Index below over index above.
    pub eta: R,
    /// Factor on the reflectance.
    pub specular_reflectance: Rgb<R>,
    /// Factor on the transmittance.
    pub specular_transmittance: Rgb<R>,
}

/// The facet that connects two directions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet<R> {
    /// Its normal, in the upper hemisphere.
    pub(super) m: Vec3<R>,
    /// Cosine between facet and `wo`, positive.
    pub(super) cos_o: R,
    /// Cosine between facet and `wi`, positive.
    cos_i: R,
    /// Index on the far side over that on the side of `wo`.
    eta: R,
    /// Whether it reflects; else it refracts.
    pub(super) reflects: bool,
    /// What it does with the light.
    pub(super) fresnel: fresnel::Dielectric<R>,
}

impl<R: Real> Facet<R> {
    /// `None` if no facet does, or if it would be seen from its back.
    #[inline]
    pub(super) fn between(wo: Vec3<R>, wi: Vec3<R>, eta: R) -> Option<Self> {
        let zero = R::Primal::zero();
        if wo.z.primal() == zero || wi.z.primal() == zero {
            return None;
        }
        let m = Self::along(wo, wi, eta).normalize();
        let (facet, faces) = Self::with(m, [wo, wi], eta);
        faces.then_some(facet)
    }

    /// A vector along the normal of the facet that would connect them.
    #[inline(always)]
    pub(crate) fn along(wo: Vec3<R>, wi: Vec3<R>, eta: R) -> Vec3<R> {
        let eta = R::select(same_side(wo, wi), R::one(), eta_across(eta, wo));
        wo + wi * eta
    }

    /// The facet whose normal, of unit length, is `m` or the opposite, and whether it is seen from its front: without a
    /// branch, for loops over many.
    #[inline(always)]
    pub(crate) fn with(m: Vec3<R>, [wo, wi]: [Vec3<R>; 2], eta: R) -> (Self, bool) {
        let zero = R::Primal::zero();
        let eta = eta_across(eta, wo);
        // Refraction into the denser medium makes it point down.
        let m = upwards(m);
        let (cos_o, cos_i) = (wo.dot(m), wi.dot(m));
        let faces =
            |cos: R, z: R| (cos.primal() != zero) & ((cos.primal() > zero) == (z.primal() > zero));
        let facet = Self {
            m,
            cos_o: cos_o.abs(),
            cos_i: cos_i.abs(),
            eta,
            reflects: same_side(wo, wi),
            fresnel: fresnel::dielectric(cos_o.abs(), eta),
        };
        (facet, faces(cos_o, wo.z) & faces(cos_i, wi.z))
    }

    /// Of [`Facet::refraction`] all but the factor of importance, and the density [`Facet::pdf_refracted`] where visible
    /// normals are sampled.
    #[inline(always)]
    pub(super) fn refracted(&self, d: R, sigma: [R; 2], wi: Vec3<R>) -> [R; 2] {
        let stretch = self.stretch();
        let value = self.fresnel.transmit
            * d
            * (wi.z.abs() / (sigma[0] * sigma[1]))
            * (self.cos_o * self.cos_i / stretch);
        let jacobian = self.eta.square() * self.cos_i / stretch;
        let pdf = d * self.cos_o / sigma[0] * jacobian;
        let passes = stretch.primal() > R::Primal::zero();
        both([value, pdf], |x| R::select(passes, x, R::zero()))
    }

    /// `(wo.m + eta wi.m)^2`, for refraction: `eta^2 cos_i` over this is the Jacobian of normals with
    /// respect to `wi`.
    #[inline(always)]
    fn stretch(&self) -> R {
        (self.eta * self.cos_i - self.cos_o).square()
    }

    /// What is refracted, if `value` is that of radiance.
    #[inline(always)]
    pub(super) fn transported(&self, value: R, mode: TransportMode) -> R {
        match mode {
            TransportMode::Radiance => value,
            TransportMode::Importance => value * self.eta.square(),
        }
    }

    /// What a surface of such facets refracts from `wi` to `wo`, cosine included.
    #[inline]
    fn refraction<A: Alpha<Scalar = R>>(
        &self,
        microfacet: &Microfacet<A>,
        [wo, wi]: [Vec3<R>; 2],
        mode: TransportMode,
    ) -> R {
        let sigma = both([wo, wi], |w| microfacet.sigma(w));
        let [value, _] = self.refracted(microfacet.d(self.m), sigma, wi);
        self.transported(value, mode)
    }

    /// Density of `wi` where `wo` is refracted at a sampled facet.
    #[inline]
    fn pdf_refracted<A: Alpha<Scalar = R>>(&self, microfacet: &Microfacet<A>, wo: Vec3<R>) -> R {
        let stretch = self.stretch();
        if stretch.primal() <= R::Primal::zero() {
            return R::zero();
        }
        microfacet.pdf(upwards(wo), self.m) * (self.eta.square() * self.cos_i / stretch)
    }
}

impl Leaf for RoughDielectric {
    type Lobe<R: Real> = RoughDielectricLobe<R>;
    const DIFFERENTIAL: bool = true;

    fn transmits(&self) -> bool {
        true
    }

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> RoughDielectricLobe<R> {
        RoughDielectricLobe {
            microfacet: self.roughness.read(read),
            eta: read.scalar(&self.eta),
            specular_reflectance: read.rgb(&self.specular_reflectance),
            specular_transmittance: read.rgb(&self.specular_transmittance),
        }
    }
}

impl Leaf for AnisotropicDielectric {
    type Lobe<R: Real> = RoughDielectricLobe<R, Axes<R>>;
    const MANY: bool = true;

    fn transmits(&self) -> bool {
        true
    }

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> RoughDielectricLobe<R, Axes<R>> {
        RoughDielectricLobe {
            microfacet: self.roughness.read(read),
            eta: read.scalar(&self.eta),
            specular_reflectance: read.rgb(&self.specular_reflectance),
            specular_transmittance: read.rgb(&self.specular_transmittance),
        }
    }
}

/// Refracts `w` about the normal `m` on its side, given both cosines and the index on the far side
/// over that on the near side [Zeltner 2021, Eq. 2.23].
#[inline(always)]
fn refract<R: Real>(w: Vec3<R>, m: Vec3<R>, cos_i: R, cos_t: R, eta: R) -> Vec3<R> {
    let inverse = eta.recip();
    m * (cos_i * inverse - cos_t) - w * inverse
}

impl<P: Float, A> RoughDielectricLobe<P, A> {
    /// [`Lobe::eval_pdf`] of radiance where the facets are known and visible normals are sampled: without a branch, for
    /// loops over many. `facets.m` is of unit length.
    #[inline(always)]
    pub(crate) fn eval_pdf_where(
        &self,
        facets: &Facets<P>,
        wo: Vec3<P>,
        wi: Vec3<P>,
    ) -> (Rgb<P>, P) {
        let (f, faces) = Facet::with(facets.m, [wo, wi], self.eta);
        let faces = faces & (wo.z != P::zero()) & (wi.z != P::zero());
        let reflected = self.specular_reflectance * (f.fresnel.reflect * facets.reflection(wi));
        let [value, density] = f.refracted(facets.d, facets.sigma, wi);
        let value = Rgb::select(f.reflects, reflected, self.specular_transmittance * value);
        let pdf = P::select(
            f.reflects,
            facets.pdf_reflected() * f.fresnel.reflect,
            density * f.fresnel.transmit,
        );
        let value = Rgb::select(faces, value, Rgb::black());
        (value, P::select(faces, pdf, P::zero()))
    }

    /// What [`Lobe::sample`] makes of a sampled normal in the upper hemisphere: direction and relative index, and whether
    /// there is one. Without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn scatter(&self, wo: Vec3<P>, m: Vec3<P>, u: P) -> (Vec3<P>, P, bool) {
        let (wi, eta, goes) = scatter_in_line(wo, m, self.eta, |f| u < f.reflect);
        (wi, eta, goes & (wo.z != P::zero()))
    }
}

impl<R: Real, A: Alpha<Scalar = R>> RoughDielectricLobe<R, A> {
    #[inline]
    fn primal(&self) -> RoughDielectricLobe<R::Primal, A::Primal> {
        RoughDielectricLobe {
            microfacet: self.microfacet.primal(),
            eta: self.eta.primal(),
            specular_reflectance: self.specular_reflectance.primal(),
            specular_transmittance: self.specular_transmittance.primal(),
        }
    }
}

impl<R: Real, A: Alpha<Scalar = R>> Lobe<R> for RoughDielectricLobe<R, A> {
    #[inline]
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> Rgb<R> {
        let Some(f) = Facet::between(wo, wi, self.eta) else {
            return Rgb::black();
        };
        if f.reflects {
            let value = reflection(&self.microfacet, wo, wi, f.m);
            return self.specular_reflectance * (f.fresnel.reflect * value);
        }
        self.specular_transmittance * f.refraction(&self.microfacet, [wo, wi], mode)
    }

    #[inline]
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> R {
        let Some(f) = Facet::between(wo, wi, self.eta) else {
            return R::zero();
        };
        if f.reflects {
            let chosen = Const(f.fresnel.reflect.primal());
            return self.microfacet.pdf_reflected(upwards(wo), f.m) * chosen;
        }
        let chosen = Const(f.fresnel.transmit.primal());
        f.pdf_refracted(&self.microfacet, wo) * chosen
    }

    /// Samples a facet, then chooses by its (primal) reflectance.
    #[inline]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        let zero = R::Primal::zero();
        if wo.z.primal() == zero {
            return None;
        }
        let m = self.microfacet.sample(upwards(wo), [u[1], u[2]]);
        let reflects = |f: &fresnel::Dielectric<R>| u[0] < f.reflect.primal();
        let (wi, eta) = scatter(wo, m, self.eta, reflects)?;
        let pdf = self.pdf(wo, wi, mode);
        (pdf.primal() > zero).then_some(BsdfSample {
            wi,
            pdf,
            component: Component::Continuous,
            eta,
        })
    }

    #[inline]
    fn choice_pdf(
        &self,
        wo: Vec3<R>,
        wi: Vec3<R>,
        _component: Component,
        _mode: TransportMode,
    ) -> R {
        let Some(f) = Facet::between(wo, wi, self.eta) else {
            return R::zero();
        };
        if f.reflects {
            return constant(self.microfacet.pdf_reflected(upwards(wo), f.m)) * f.fresnel.reflect;
        }
        constant(f.pdf_refracted(&self.microfacet, wo)) * f.fresnel.transmit
    }

    #[inline]
    fn eval_normals(
        &self,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        mode: TransportMode,
    ) -> Rgb<R> {
        let Some(Facet { m, .. }) = Facet::between(wo, wi, self.eta.primal()) else {
            return Rgb::black();
        };
        let value = self.primal().eval(wo, wi, mode);
        Rgb::lift(value) * self.microfacet.change(m)
    }

    #[inline]
    fn sample_differential(
        &self,
        wo: Vec3<R::Primal>,
        u: [R::Primal; 3],
        _mode: TransportMode,
    ) -> [Option<BsdfSample<R::Primal>>; 2] {
        let Some(isotropic) = self.microfacet.isotropic() else {
            return [None; 2];
        };
        let normals = isotropic.primal().sample_differential([u[1], u[2]]);
        both(normals, |m| {
            let reflects = |f: &fresnel::Dielectric<R::Primal>| u[0] < f.reflect;
            let (wi, eta) = scatter(wo, m, self.eta.primal(), reflects)?;
            let pdf = self.pdf_differential(wo, wi);
            (pdf > R::Primal::zero()).then_some(BsdfSample {
                wi,
                pdf,
                component: Component::Continuous,
                eta,
            })
        })
    }

    #[inline]
    fn pdf_differential(&self, wo: Vec3<R::Primal>, wi: Vec3<R::Primal>) -> R::Primal {
        let isotropic = self.microfacet.isotropic();
        isotropic.map_or(R::Primal::zero(), |m| {
            pdf_differential(&m.primal(), self.eta.primal(), wo, wi)
        })
    }
}

/// Reflects or refracts `wo` at a facet with the upper normal `m`, whichever `reflects` chooses by what a
/// facet does with light; also the index of refraction on the new side over that on the old. `None` if `wo`
/// sees the facet's back, or if the direction ends up on the wrong side of the surface: another kind of
/// facet would connect the two.
#[inline]
pub(super) fn scatter<R: Real>(
    wo: Vec3<R>,
    m: Vec3<R>,
    eta: R,
    reflects: impl FnOnce(&fresnel::Dielectric<R>) -> bool,
) -> Option<(Vec3<R>, R::Primal)> {
    let (wi, eta, goes) = scatter_in_line(wo, m, eta, reflects);
    goes.then_some((wi, eta))
}

/// [`scatter`], and whether it is there, without a branch.
#[inline(always)]
pub(super) fn scatter_in_line<R: Real>(
    wo: Vec3<R>,
    m: Vec3<R>,
    eta: R,
    reflects: impl FnOnce(&fresnel::Dielectric<R>) -> bool,
) -> (Vec3<R>, R::Primal, bool) {
    let (zero, one) = (R::Primal::zero(), R::Primal::one());
    let cos = upwards(wo).dot(m);
    // The normal on the side of wo.
    let up = wo.z.primal() > zero;
    let m = Vec3::select(up, m, -m);
    let across = eta_across(eta, wo);
    let f = fresnel::dielectric(cos, across);
    let reflects = reflects(&f);
    let (reflected, refracted) = (reflect(wo, m), refract(wo, m, cos, f.cos_t, across));
    let wi = Vec3::select(reflects, reflected, refracted);
    let right_side = (wi.z.primal() > zero) == (up == reflects);
    let eta = R::Primal::select(reflects, one, across.primal());
    (wi, eta, right_side & (cos.primal() > zero))
}

/// Whether both are on one side of the surface.
#[inline(always)]
fn same_side<R: Real>(a: Vec3<R>, b: Vec3<R>) -> bool {
    let zero = R::Primal::zero();
    (a.z.primal() > zero) == (b.z.primal() > zero)
}

/// Density of facets from one part of the derivative, times the probability of what they do and the
/// Jacobian of their normals.
fn pdf_differential<P: Float>(microfacet: &Microfacet<P>, eta: P, wo: Vec3<P>, wi: Vec3<P>) -> P {
    let Some(f) = Facet::between(wo, wi, eta) else {
        return P::zero();
    };
    if f.reflects {
        let reflected = microfacet.pdf_differential_reflected(upwards(wo), f.m);
        return reflected * f.fresnel.reflect;
    }
    let stretch = f.stretch();
    if stretch <= P::zero() {
        return P::zero();
    }
    let jacobian = f.eta.square() * f.cos_i / stretch;
    microfacet.pdf_differential(f.m) * jacobian * f.fresnel.transmit
}

/// `w` or its opposite, whichever is in the upper hemisphere: microsurfaces look the same from
/// below.
#[inline(always)]
pub(crate) fn upwards<R: Real>(w: Vec3<R>) -> Vec3<R> {
    Vec3::select(w.z.primal() > R::Primal::zero(), w, -w)
}

impl<T> RoughDielectric<T> {
    /// With what a scene file says besides.
    fn of(
        node: &Node,
        registry: &mut Registry,
        roughness: impl FnOnce(&Node, &mut Registry) -> Result<Roughness<T>, SceneError>,
    ) -> Result<Self, SceneError> {
        let eta = relative_index(node, "bk7")?;
        let valid = if eta > 1.0 { DENSER } else { THINNER };
        if !(valid.0..=valid.1).contains(&eta) {
            let expected = "an index inside at least 0.1 % from that outside";
            return Err(wrong_index(node, expected));
        }
        let name = format!("{}.eta.value", registry.prefix());
        let eta = registry.scalar(&name, eta, valid)?;
        eta.visit_params(&mut |p| registry.origins.of_index(node, p));
        let roughness = roughness(node, registry)?;
        let mut factor = |key| registry.rgb_texture(node, key, [1.0; 3], (0.0, 1.0));
        Ok(Self {
            roughness,
            eta,
            specular_reflectance: factor("specular_reflectance")?,
            specular_transmittance: factor("specular_transmittance")?,
        })
    }
}

impl FromNode for RoughDielectric {
    const PLUGINS: &'static [&'static str] = &["roughdielectric"];

    /// As [`Roughness::from_node`]; `int_ior` (`bk7`) and `ext_ior` (`air`), different numbers or
    /// names; `specular_reflectance` (1) and `specular_transmittance` (1).
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        Self::of(node, registry, Roughness::from_node)
    }
}

impl FromNode for AnisotropicDielectric {
    const PLUGINS: &'static [&'static str] = RoughDielectric::<ScalarTexture>::PLUGINS;

    fn takes(node: &Node) -> bool {
        Self::PLUGINS.contains(&node.plugin.as_str()) && is_anisotropic(node)
    }

    /// As [`Roughness::along_axes`], and the rest as [`RoughDielectric::from_node`].
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        Self::of(node, registry, Roughness::along_axes)
    }
}

/// Valid relative indices of a denser inside.
const DENSER: (f64, f64) = (1.001, 10.0);
/// Valid relative indices of a thinner inside.
const THINNER: (f64, f64) = (0.1, 0.999);
