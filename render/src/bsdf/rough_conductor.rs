//! Rough conductors: a microfacet distribution of mirrors.

use ad_core::{Const, Float, Real, Vec2, Vec3};

use super::microfacet::{ALPHA_RANGE, Alpha, Axes, Microfacet, Ndf};
use super::{
    BsdfSample, Component, Conductor, ConductorLobe, Leaf, Lobe, Part, Reader, Scattered,
    TransportMode,
};
use crate::error::SceneError;
use crate::math::{Rgb, both};
use crate::params::Theta;
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::ScalarTexture;

/// Roughness and shape of a microsurface; `T` is one texture, or one for each axis of the surface.
#[derive(Clone, Debug)]
pub struct Roughness<T = ScalarTexture> {
    /// Shape of the distribution of normals.
    pub kind: Ndf,
    /// Roughness, in [`ALPHA_RANGE`].
    pub alpha: T,
    /// Sample visible normals only.
    pub visible: bool,
}

impl Roughness {
    /// The distribution at a point.
    #[inline]
    pub fn read<R: Real>(&self, read: &mut impl Reader<R>) -> Microfacet<R> {
        Microfacet {
            kind: self.kind,
            alpha: read.alpha(&self.alpha),
            visible: self.visible,
        }
    }

    /// The distribution of all normals, of a surface that is as rough everywhere; elsewhere, that of one corner.
    pub fn everywhere<R: Real>(&self, theta: &Theta<R>) -> Microfacet<R> {
        Microfacet {
            kind: self.kind,
            alpha: self.alpha.scalar(theta, Vec2::zero()),
            visible: false,
        }
    }

    /// `distribution` (`beckmann`), `alpha` (0.1), or `alpha_u` and `alpha_v` of equal value, and `sample_visible` (true)
    /// of a scene file.
    ///
    /// # Errors
    /// Another roughness across than along, which is left out here. A roughness outside [`ALPHA_RANGE`]: it is not
    /// clamped, since that would silently stop its derivative; but zero, of a file, is the least there is, with a warning.
    pub fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        if is_anisotropic(node) {
            return Err(SceneError::Refused {
                location: node.location.clone(),
                tag: node.tag.clone(),
                plugin: format!("{} with {ALONG} and {ACROSS}", node.plugin),
                what: "anisotropic roughness is",
            });
        }
        let given = node.has(ALONG) || node.has(ACROSS);
        if given && node.has("alpha") {
            return Err(node.invalid("alpha", "none beside `alpha_u` and `alpha_v`"));
        }
        let key = if given { ALONG } else { "alpha" };
        // It is the same.
        node.grey(ACROSS)?;
        let alpha = registry.scalar_texture(node, key, 0.1, ALPHA_RANGE)?;
        Self::of(node, alpha)
    }
}

impl<T> Roughness<T> {
    /// With what a scene file says besides.
    fn of(node: &Node, alpha: T) -> Result<Self, SceneError> {
        let kinds = [("beckmann", Ndf::Beckmann), ("ggx", Ndf::Ggx)];
        let kind = node.choice("distribution", &kinds)?;
        Ok(Self {
            kind: kind.unwrap_or(Ndf::Beckmann),
            alpha,
            visible: node.boolean_or("sample_visible", true)?,
        })
    }
}

impl Roughness<[ScalarTexture; 2]> {
    /// The distribution at a point.
    #[inline]
    pub fn read<R: Real>(&self, read: &mut impl Reader<R>) -> Microfacet<Axes<R>> {
        let [along, across] = &self.alpha;
        Microfacet {
            kind: self.kind,
            alpha: Axes([read.alpha(along), read.alpha(across)]),
            visible: self.visible,
        }
    }

    /// [`Roughness::from_node`] of `alpha_u` and `alpha_v`, along dp/du and across.
    ///
    /// # Errors
    /// As there; one of the two without the other.
    pub fn along_axes(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let mut alpha = |key| {
            if node.has(key) {
                return registry.scalar_texture(node, key, 0.1, ALPHA_RANGE);
            }
            Err(node.missing(key, "a roughness, as there is along the other axis"))
        };
        let alpha = [alpha(ALONG)?, alpha(ACROSS)?];
        Self::of(node, alpha)
    }
}

/// Roughness along the axes of the surface.
const ALONG: &str = "alpha_u";
const ACROSS: &str = "alpha_v";

/// Whether a node asks for another roughness across the surface than along it, or may do so.
pub(super) fn is_anisotropic(node: &Node) -> bool {
    let number = |key| node.grey(key).ok().flatten();
    let asked = (node.has(ALONG) || node.has(ACROSS)) && !node.has("alpha");
    let same = || matches!((number(ALONG), number(ACROSS)), (Some(a), Some(b)) if a == b);
    asked && !same()
}

/// A rough, one-sided metal; `T` as of [`Roughness`].
#[derive(Clone, Debug)]
pub struct RoughConductor<T = ScalarTexture> {
    /// Its microsurface.
    pub roughness: Roughness<T>,
    /// The reflectance of each facet.
    pub conductor: Conductor,
}

/// Rough metal that was brushed: another roughness across dp/du than along it.
///
/// # Derivatives
/// In both. The change of normals has no samples of its own ([`super::differential`]): estimators that make such sample
/// this material as all others do.
pub type AnisotropicConductor = RoughConductor<[ScalarTexture; 2]>;

/// `f_s = F D G / (4 cos cos)` [Zeltner 2021, Eq. 2.36], with separable masking.
#[derive(Clone, Copy, Debug)]
pub struct RoughConductorLobe<R, A = R> {
    /// Distribution of facets.
    pub microfacet: Microfacet<A>,
    /// Reflectance of a facet.
    pub facet: ConductorLobe<R>,
}

impl Leaf for RoughConductor {
    type Lobe<R: Real> = RoughConductorLobe<R>;
    const DIFFERENTIAL: bool = true;

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> RoughConductorLobe<R> {
        RoughConductorLobe {
            microfacet: self.roughness.read(read),
            facet: self.conductor.lobe(read),
        }
    }
}

impl Leaf for AnisotropicConductor {
    type Lobe<R: Real> = RoughConductorLobe<R, Axes<R>>;
    const MANY: bool = true;

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> RoughConductorLobe<R, Axes<R>> {
        RoughConductorLobe {
            microfacet: self.roughness.read(read),
            facet: self.conductor.lobe(read),
        }
    }
}

/// The normal of a facet that reflects `wi` to `wo`, both above the horizon.
#[inline]
pub(super) fn half_vector<R: Real>(wo: Vec3<R>, wi: Vec3<R>) -> Option<Vec3<R>> {
    let zero = R::Primal::zero();
    (wo.z.primal() > zero && wi.z.primal() > zero).then(|| (wo + wi).normalize())
}

/// `D G cos_i / (4 cos_i cos_o)`: reflection of a surface whose facets, here those with normal `m`,
/// reflect everything; cosine included.
#[inline]
pub(super) fn reflection<R: Real, A: Alpha<Scalar = R>>(
    microfacet: &Microfacet<A>,
    wo: Vec3<R>,
    wi: Vec3<R>,
    m: Vec3<R>,
) -> R {
    reflection_where(microfacet, [microfacet.d(m), microfacet.sigma(wo)], wi)
}

/// [`reflection`] where the distribution at the normal and the `sigma` of `wo` are known already.
#[inline]
fn reflection_where<R: Real, A: Alpha<Scalar = R>>(
    microfacet: &Microfacet<A>,
    [d, sigma]: [R; 2],
    wi: Vec3<R>,
) -> R {
    d * (wi.z.abs() / (sigma * microfacet.sigma(wi) * R::c(4.0)))
}

/// The change of [`reflection`] through the distribution of normals alone: tangents with primal part zero.
#[inline]
pub(super) fn reflection_of_normals<R: Real, A: Alpha<Scalar = R>>(
    microfacet: &Microfacet<A>,
    wo: Vec3<R::Primal>,
    wi: Vec3<R::Primal>,
    m: Vec3<R::Primal>,
) -> R {
    let d = microfacet.d(Vec3::lift(m));
    let still = microfacet.primal();
    let per_normal = reflection_where(&still, [R::Primal::one(), still.sigma(wo)], wi);
    (d - Const(d.primal())) * Const(per_normal)
}

/// Density of [`sample_reflected_differential`] at `wi`.
#[inline]
pub(super) fn pdf_reflected_differential<P: Float>(
    microfacet: &Microfacet<P>,
    wo: Vec3<P>,
    wi: Vec3<P>,
) -> P {
    match half_vector(wo, wi) {
        Some(m) => microfacet.pdf_differential_reflected(wo, m),
        None => P::zero(),
    }
}

/// Reflection about a normal from each part of the derivative of the distribution; `None` below the
/// horizon.
#[inline]
pub(super) fn sample_reflected_differential<P: Float>(
    microfacet: &Microfacet<P>,
    wo: Vec3<P>,
    u: [P; 2],
) -> [Option<BsdfSample<P>>; 2] {
    both(microfacet.sample_differential(u), |m| {
        let wi = reflect(wo, m);
        let pdf = pdf_reflected_differential(microfacet, wo, wi);
        (pdf > P::zero()).then_some(BsdfSample {
            wi,
            pdf,
            component: Component::Continuous,
            eta: P::one(),
        })
    })
}

/// Reflects `w` about `m`.
#[inline(always)]
pub(crate) fn reflect<R: Real>(w: Vec3<R>, m: Vec3<R>) -> Vec3<R> {
    m * (w.dot(m) * R::c(2.0)) - w
}

impl<R: Real, A: Alpha<Scalar = R>> RoughConductorLobe<R, A> {
    /// A facet's normal, and the direction it reflects `wo` to.
    #[inline]
    fn sample_facet(&self, wo: Vec3<R>, u: [R::Primal; 3]) -> Option<(Vec3<R>, Vec3<R>)> {
        let above = wo.z.primal() > R::Primal::zero();
        above.then(|| {
            let m = self.microfacet.sample(wo, [u[1], u[2]]);
            (m, reflect(wo, m))
        })
    }

    #[inline]
    fn found(wi: Vec3<R>, pdf: R) -> Option<BsdfSample<R>> {
        BsdfSample::reflected(wi, pdf)
    }
}

/// The lobe of a metal: a [`RoughConductorLobe`] whose visible normals are sampled, or a mirror. Number by number, in steps
/// without branches, so that loops over many become vector instructions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Metal<P> {
    /// Factor on the reflectance.
    pub specular_reflectance: Rgb<P>,
    /// Real and imaginary part of the index, if it has one.
    pub index: [Rgb<P>; 2],
    /// Whether it has.
    pub has_index: bool,
}

/// What facets of a normal reflect, without colour.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facets<P> {
    /// The normal.
    pub m: Vec3<P>,
    /// Density of such normals.
    pub d: P,
    /// `sigma` of both directions.
    pub sigma: [P; 2],
}

impl<P: Float> Facets<P> {
    /// Those of a surface with the normal `m`, for two directions.
    #[inline(always)]
    pub fn of<A: Alpha<Scalar = P>>(
        surface: &Microfacet<A>,
        m: Vec3<P>,
        directions: [Vec3<P>; 2],
    ) -> Self {
        let [wo, wi] = directions;
        // Closures become calls.
        let sigma = [surface.sigma_in_line(wo), surface.sigma_in_line(wi)];
        let d = surface.d_in_line(m);
        Self { m, d, sigma }
    }
}

impl<R: Real> Facets<R> {
    /// [`Facets::of`] where nothing is in line.
    #[inline]
    pub(super) fn at<A: Alpha<Scalar = R>>(
        surface: &Microfacet<A>,
        m: Vec3<R>,
        [wo, wi]: [Vec3<R>; 2],
    ) -> Self {
        Self {
            m,
            d: surface.d(m),
            sigma: [surface.sigma(wo), surface.sigma(wi)],
        }
    }

    /// [`reflection`] of these facets.
    #[inline(always)]
    pub fn reflection(&self, wi: Vec3<R>) -> R {
        let [o, i] = self.sigma;
        self.d * (wi.z.abs() / (o * i * R::c(4.0)))
    }

    /// [`Microfacet::pdf_reflected`] where visible normals are sampled.
    #[inline(always)]
    pub fn pdf_reflected(&self) -> R {
        self.d / (self.sigma[0] * R::c(4.0))
    }
}

impl<P: Float> Metal<P> {
    /// Metal with such facets.
    #[inline(always)]
    pub fn of(facet: &ConductorLobe<P>) -> Self {
        Self {
            specular_reflectance: facet.specular_reflectance,
            index: facet.index.unwrap_or([Rgb::black(); 2]),
            has_index: facet.index.is_some(),
        }
    }

    /// [`Lobe::eval_pdf`] by what the facets do.
    #[inline(always)]
    pub fn eval_pdf(&self, wo: Vec3<P>, wi: Vec3<P>, facets: &Facets<P>) -> (Rgb<P>, P) {
        let zero = P::zero();
        let f = self.reflectance(wo.dot(facets.m)) * facets.reflection(wi);
        let scatters = (wo.z > zero) & (wi.z > zero) & (facets.d != zero);
        let pdf = facets.pdf_reflected();
        let f = f.map(|f| P::select(scatters, f, zero));
        (f, P::select(scatters, pdf, zero))
    }

    /// Reflectance under the angle whose cosine is `cos`.
    #[inline(always)]
    pub fn reflectance(&self, cos: P) -> Rgb<P> {
        let facet = ConductorLobe {
            specular_reflectance: self.specular_reflectance,
            index: Some(self.index),
        };
        facet.reflectance_in_line(self.has_index, cos)
    }
}

impl<R: Real, A: Alpha<Scalar = R>> Lobe<R> for RoughConductorLobe<R, A> {
    #[inline]
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
        let Some(m) = half_vector(wo, wi) else {
            return Rgb::black();
        };
        self.facet.reflectance(wo.dot(m)) * reflection(&self.microfacet, wo, wi, m)
    }

    #[inline]
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> R {
        match half_vector(wo, wi) {
            Some(m) => self.microfacet.pdf_reflected(wo, m),
            None => R::zero(),
        }
    }

    #[inline]
    fn eval_pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> (Rgb<R>, R) {
        let dark = (Rgb::black(), R::zero());
        let Some(m) = half_vector(wo, wi) else {
            return dark;
        };
        let d = self.microfacet.d(m);
        // Far off a narrow lobe, as most lights are.
        if d.primal() == R::Primal::zero() {
            return dark;
        }
        let sigma = self.microfacet.sigma(wo);
        let reflection = reflection_where(&self.microfacet, [d, sigma], wi);
        let f = self.facet.reflectance(wo.dot(m)) * reflection;
        let pdf = (self.microfacet).pdf_reflected_where(d, wo, m, || sigma);
        (f, pdf)
    }

    #[inline]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        let (_, wi) = self.sample_facet(wo, u)?;
        Self::found(wi, self.pdf(wo, wi, mode))
    }

    #[inline]
    fn sample_eval(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        let (_, wi) = self.sample_facet(wo, u)?;
        let (f, pdf) = self.eval_pdf(wo, wi, mode);
        Some((Self::found(wi, pdf)?, f))
    }

    /// `D` cancels, and so does the masking of `wo` if visible normals are sampled: `F G1(wi)`
    /// [Heitz and d'Eon 2014, Eq. 19, with separable masking].
    #[inline]
    fn sample_weight(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        _mode: TransportMode,
    ) -> Option<(Vec3<R>, Rgb<R>)> {
        let (m, wi) = self.sample_facet(wo, u)?;
        if wi.z.primal() <= R::Primal::zero() {
            return None;
        }
        let (cos, surface) = (wo.dot(m), &self.microfacet);
        let mut weight = wi.z / surface.sigma(wi);
        if !surface.visible {
            // As in `pdf_reflected`.
            if cos.primal() < R::Primal::of(1e-8) {
                return None;
            }
            weight *= cos / (surface.sigma(wo) * m.z);
        }
        Some((wi, self.facet.reflectance(cos) * weight))
    }

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
        let facet = self.facet.primal().reflectance(wo.dot(m));
        Rgb::lift(facet) * reflection_of_normals(&self.microfacet, wo, wi, m)
    }

    /// The normal is a constant, too.
    #[inline]
    fn eval_still(
        &self,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        part: Part,
        mode: TransportMode,
    ) -> Rgb<R> {
        if part == Part::Normals {
            return self.eval_normals(wo, wi, mode);
        }
        let Some(m) = half_vector(wo, wi) else {
            return Rgb::black();
        };
        let d = match part {
            Part::Rest => R::lift(self.microfacet.primal().d(m)),
            _ => self.microfacet.d(Vec3::lift(m)),
        };
        let sigma = self.microfacet.sigma(Vec3::lift(wo));
        self.facet.reflectance(R::lift(wo.dot(m)))
            * reflection_where(&self.microfacet, [d, sigma], Vec3::lift(wi))
    }

    #[inline]
    fn sample_differential(
        &self,
        wo: Vec3<R::Primal>,
        u: [R::Primal; 3],
        _mode: TransportMode,
    ) -> [Option<BsdfSample<R::Primal>>; 2] {
        let isotropic = self.microfacet.isotropic();
        isotropic.map_or([None; 2], |m| {
            sample_reflected_differential(&m.primal(), wo, [u[1], u[2]])
        })
    }

    #[inline]
    fn pdf_differential(&self, wo: Vec3<R::Primal>, wi: Vec3<R::Primal>) -> R::Primal {
        let isotropic = self.microfacet.isotropic();
        isotropic.map_or(R::Primal::zero(), |m| {
            pdf_reflected_differential(&m.primal(), wo, wi)
        })
    }
}

impl FromNode for RoughConductor {
    const PLUGINS: &'static [&'static str] = &["roughconductor"];

    /// As [`Roughness::from_node`] and [`Conductor::from_node`].
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        Ok(Self {
            roughness: Roughness::from_node(node, registry)?,
            conductor: Conductor::from_node(node, registry)?,
        })
    }
}

impl FromNode for AnisotropicConductor {
    const PLUGINS: &'static [&'static str] = RoughConductor::<ScalarTexture>::PLUGINS;

    fn takes(node: &Node) -> bool {
        Self::PLUGINS.contains(&node.plugin.as_str()) && is_anisotropic(node)
    }

    /// As [`Roughness::along_axes`] and [`Conductor::from_node`].
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        Ok(Self {
            roughness: Roughness::along_axes(node, registry)?,
            conductor: Conductor::from_node(node, registry)?,
        })
    }
}
