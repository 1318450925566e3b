//! The material of [Burley 2012] and [Burley 2015] that modelling programs write.

use std::f64::consts::{FRAC_1_PI, PI};

use ad_core::{Const, Float, Real, Vec3};

use super::microfacet::{Alpha, Axes, Microfacet, Ndf};
use super::nesting::attached_choice;
use super::rough_conductor::{half_vector, reflect, reflection};
use super::rough_dielectric::{Facet, scatter, upwards};
use super::{BsdfSample, Component, Leaf, Lobe, Reader, TransportMode, constant, fresnel};
use crate::error::SceneError;
use crate::math::{Rgb, warp};
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::{RgbTexture, ScalarTexture};

/// A surface between a metal and a coloured dielectric, with sheen and a clear coat: one-sided, unless some of it is glass.
/// What a scene file does not mention costs nothing and is no parameter. `T` is a texture where the main reflection is
/// anisotropic.
#[derive(Clone, Debug)]
pub struct Principled<T = ()> {
    /// Colour of the base, and of reflection by metal.
    pub base_color: RgbTexture,
    /// The root of the roughness of the microsurface, where that is at least `LEAST_ALPHA`.
    pub roughness: ScalarTexture,
    /// From a dielectric, 0, to a metal, 1.
    pub metallic: Option<ScalarTexture>,
    /// How much a dielectric reflects.
    pub dielectric: Option<Reflectivity>,
    /// From diffuse reflection, 0, to that of something translucent, 1.
    pub flatness: Option<ScalarTexture>,
    /// Light at grazing angles, as of cloth.
    pub sheen: Option<ScalarTexture>,
    /// Strength and gloss of a second, colourless reflection.
    pub clearcoat: Option<[ScalarTexture; 2]>,
    /// How much the reflection of a dielectric, and the sheen, have the hue of the base, from 0 to 1; not without a
    /// `dielectric`, and without sheen.
    pub tints: [Option<ScalarTexture>; 2],
    /// How much of what is no metal is rough glass, from 0 to 1; then there is a `dielectric`.
    pub transmission: Option<ScalarTexture>,
    /// How much longer than wide highlights are, from 0 to 1.
    pub anisotropic: T,
}

/// The same with highlights that are longer along dp/du than across.
pub type AnisotropicPrincipled = Principled<ScalarTexture>;

/// How the reflectance of a dielectric is given.
#[derive(Clone, Debug)]
pub enum Reflectivity {
    /// Its index of refraction.
    Index(ScalarTexture),
    /// Its reflectance at normal incidence over 0.08.
    Specular(ScalarTexture),
}

/// The square of width over length of a highlight is one minus this times `anisotropic` [Burley 2012].
const ELONGATION: f64 = 0.9;
/// Smallest roughness of the microsurface.
const LEAST_ALPHA: f64 = 1e-3;
/// A dielectric of less `specular` reflects nothing.
const LEAST_SPECULAR: f64 = 1e-4;
/// The least `specular` of glass: with less, refraction degenerates to a Dirac delta.
const LEAST_GLASS: f64 = 1e-3;
/// Roughness of the clear coat without gloss and with all of it.
const COAT: [f64; 2] = [0.1, 1e-3];
/// Roughness in the masking of the clear coat.
const COAT_MASKING: f64 = 0.25;
/// Least share of samples of each part that is there: what has no weight has a derivative (errata F7).
const LEAST_SHARE: f64 = 0.05;
/// Closer to grazing on both sides, what is translucent stays as it is.
const GRAZING: f64 = 1e-4;

/// [`Principled`] at a point: diffuse and retro-reflection, a fake of subsurface scattering, sheen and clear coat are those
/// of [Burley 2012] and [Burley 2015]; the main reflection is, as in Mitsuba 3, the Fresnel reflectance of a dielectric instead
/// of Schlick's fit, mixed with Schlick's of the metal, over GGX with separable masking; the clear coat has Mitsuba's
/// masking, too. Roughness along and across is that of [Burley 2012], where highlights are longer. Glass, seen from both
/// sides, is that of [Burley 2015] as Mitsuba 3 has it: refraction by the facets of the main reflection, times the
/// root of the colour, so that what passes two surfaces has the colour. From below, nothing but glass is seen.
///
/// Tints are Mitsuba's: the hue is the base colour over its luminance, white where that is zero, and what of the
/// dielectric is tinted reflects by Schlick's fit.
///
/// # Derivatives
/// None in a roughness whose square is below `LEAST_ALPHA`: the model is constant there. None of refraction in a colour that
/// is zero, where the root has no slope, nor in the hue of black. A hue mixes colour channels.
#[derive(Clone, Copy, Debug)]
pub struct PrincipledLobe<R, A = R> {
    base_color: Rgb<R>,
    roughness: R,
    microfacet: Microfacet<A>,
    metallic: R,
    /// Index of the dielectric.
    eta: Option<R>,
    flatness: Option<R>,
    sheen: Option<R>,
    /// Strength and roughness.
    clearcoat: Option<[R; 2]>,
    transmission: Option<R>,
    tints: [Option<R>; 2],
}

impl Leaf for Principled {
    type Lobe<R: Real> = PrincipledLobe<R>;
    const MANY: bool = true;

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> PrincipledLobe<R> {
        self.read(read, |_, squared| squared.max(R::of(LEAST_ALPHA)))
    }
}

impl Leaf for AnisotropicPrincipled {
    type Lobe<R: Real> = PrincipledLobe<R, Axes<R>>;
    const MANY: bool = true;

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> PrincipledLobe<R, Axes<R>> {
        self.read(read, |read, squared| {
            let anisotropic = read.scalar(&self.anisotropic);
            let aspect = (-(anisotropic * R::c(ELONGATION)) + R::c(1.0)).sqrt();
            Axes([squared / aspect, squared * aspect].map(|a| a.max(R::of(LEAST_ALPHA))))
        })
    }
}

impl<T> Principled<T> {
    /// All parameters; `alpha` makes roughness along the surface of that of the model, squared.
    #[inline]
    fn read<R: Real, A, X: Reader<R>>(
        &self,
        read: &mut X,
        alpha: impl FnOnce(&mut X, R) -> A,
    ) -> PrincipledLobe<R, A> {
        let base_color = if self.is_tinted() {
            read.mixed(&self.base_color)
        } else {
            read.rgb(&self.base_color)
        };
        let roughness = read.alpha(&self.roughness);
        let alpha = alpha(read, roughness.square());
        let mut number = |t: &Option<ScalarTexture>| t.as_ref().map(|t| read.scalar(t));
        let metallic = number(&self.metallic).unwrap_or(R::zero());
        let (flatness, sheen) = (number(&self.flatness), number(&self.sheen));
        let eta = self.dielectric.as_ref().map(|d| match d {
            Reflectivity::Index(eta) => read.scalar(eta),
            Reflectivity::Specular(s) => {
                let root = (read.scalar(s) * R::c(0.08)).sqrt();
                (root + R::c(1.0)) / (-root + R::c(1.0))
            }
        });
        let clearcoat = self.clearcoat.as_ref().map(|[strength, gloss]| {
            let (strength, gloss) = (read.scalar(strength), read.scalar(gloss));
            [strength, gloss * R::c(COAT[1] - COAT[0]) + R::c(COAT[0])]
        });
        let transmission = self.transmission.as_ref().map(|t| read.scalar(t));
        let [spec, sheen_tint] = &self.tints;
        let mut tint = |t: &Option<ScalarTexture>| t.as_ref().map(|t| read.scalar(t));
        let tints = [tint(spec), tint(sheen_tint)];
        PrincipledLobe {
            base_color,
            roughness,
            microfacet: Microfacet {
                kind: Ndf::Ggx,
                alpha,
                visible: true,
            },
            metallic,
            eta,
            flatness,
            sheen,
            clearcoat,
            transmission,
            tints,
        }
    }

    /// Whether something has the hue of the base.
    #[inline]
    fn is_tinted(&self) -> bool {
        self.tints.iter().any(Option::is_some)
    }
}

/// `(1 - cos)^5`.
#[inline]
fn schlick<R: Real>(cos: R) -> R {
    let m = (-cos + R::c(1.0)).clamp(R::zero(), R::one());
    m.square().square() * m
}

/// Density of normals with the long tail of [Burley 2012, Eq. 4], exponent one.
#[inline]
fn coat_d<R: Real>(alpha: R, m: Vec3<R>) -> R {
    let a2 = alpha.square();
    let below = -a2 + R::c(1.0);
    // 1 + (a^2 - 1) cos^2 without cancellation.
    let spread = a2 * m.z.square() + m.x.square() + m.y.square();
    -below / (a2.ln() * spread * R::c(PI))
}

/// A normal with the density [`coat_d`] times its cosine.
#[inline]
fn coat_normal<R: Real>(alpha: R, u: [R::Primal; 2]) -> Vec3<R> {
    let a2 = alpha.square();
    let least = R::Primal::EPSILON * R::Primal::of(0.25);
    let u0 = Const(u[0].max(least));
    let sin2 = a2 * (-(a2.ln() * u0)).exp_m1() / (-a2 + R::c(1.0));
    let sin2 = sin2.min(R::one());
    let (sin_phi, cos_phi) = warp::sin_cos_of_turns(u[1]);
    let sin = sin2.max(R::of(1e-30)).sqrt();
    let cos = (-sin2 + R::c(1.0)).max(R::of(1e-12)).sqrt();
    Vec3::new(sin * Const(cos_phi), sin * Const(sin_phi), cos).normalize()
}

/// What is neither metal nor glass.
#[inline]
fn opaque<S: Real>(metallic: S, transmission: Option<S>) -> S {
    let matt = -metallic + S::c(1.0);
    transmission.map_or(matt, |t| matt * (-t + S::c(1.0)))
}

/// Shares of facets, the base and the clear coat among samples from above.
#[inline]
fn shares<S: Real>(metallic: S, clearcoat: Option<S>, transmission: Option<S>) -> [S; 3] {
    let least = S::of(LEAST_SHARE);
    let base = opaque(metallic, transmission) + least;
    let coat = clearcoat.map_or(S::zero(), |c| c * S::c(0.25) + least);
    let main = S::one();
    let whole = (main + base + coat).recip();
    [main * whole, base * whole, coat * whole]
}

impl<R: Real, A: Alpha<Scalar = R>> PrincipledLobe<R, A> {
    #[inline]
    fn shares(&self) -> [R; 3] {
        let strength = self.clearcoat.map(|[strength, _]| strength);
        shares(self.metallic, strength, self.transmission)
    }

    #[inline]
    fn primal_shares(&self) -> [R::Primal; 3] {
        let strength = self.clearcoat.map(|[strength, _]| strength.primal());
        let transmission = self.transmission.map(Real::primal);
        shares(self.metallic.primal(), strength, transmission)
    }

    /// `shares` of what is reflected, given the probability that a facet refracts.
    #[inline]
    fn reflecting<S: Real>(mut shares: [S; 3], refracts: Option<S>) -> [S; 3] {
        if let Some(refracts) = refracts {
            shares[0] *= -refracts + S::c(1.0);
        }
        shares
    }

    /// Probability that a sampled facet, seen from above under `cos`, refracts. Not zero without glass, which
    /// has a derivative (errata F7).
    #[inline]
    fn refracts(&self, cos: R) -> Option<R> {
        let (transmission, eta) = (self.transmission?, self.eta?);
        let glass = (-self.metallic + R::c(1.0)) * transmission;
        Some(attached_choice(glass) * fresnel::dielectric(cos, eta).transmit)
    }

    /// Light that glass refracts, or reflects from below.
    #[inline]
    fn glass(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> Rgb<R> {
        let (Some(transmission), Some(eta)) = (self.transmission, self.eta) else {
            return Rgb::black();
        };
        let Some(f) = Facet::between(wo, wi, eta) else {
            return Rgb::black();
        };
        let glass = (-self.metallic + R::c(1.0)) * transmission;
        if f.reflects {
            let value = reflection(&self.microfacet, wo, wi, f.m);
            return Rgb::splat(glass * f.fresnel.reflect * value);
        }
        let value = f.refraction(&self.microfacet, [wo, wi], mode) * glass;
        self.base_color.map(|colour| colour.sqrt() * value)
    }

    /// Density of such directions where facets do that, and the probability that they are chosen to.
    #[inline]
    fn glass_density(&self, wo: Vec3<R>, wi: Vec3<R>) -> Option<[R; 2]> {
        self.transmission?;
        let f = Facet::between(wo, wi, self.eta?)?;
        if f.reflects {
            let density = self.microfacet.pdf_reflected(upwards(wo), f.m);
            return Some([density, f.fresnel.reflect]);
        }
        let density = f.pdf_refracted(&self.microfacet, wo);
        let chosen = if wo.z.primal() > R::Primal::zero() {
            self.shares()[0] * self.refracts(wo.dot(f.m))?
        } else {
            f.fresnel.transmit
        };
        Some([density, chosen])
    }

    /// [`Lobe::sample`] from below: a facet reflects or refracts.
    #[inline]
    fn sample_below(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        let zero = R::Primal::zero();
        if self.transmission.is_none() || wo.z.primal() == zero {
            return None;
        }
        let m = self.microfacet.sample(upwards(wo), [u[1], u[2]]);
        let reflects = |f: &fresnel::Dielectric<R>| u[0] < f.reflect.primal();
        let (wi, eta) = scatter(wo, m, self.eta?, reflects)?;
        self.sampled(wo, wi, eta, mode)
    }

    /// A sampled direction, with its density.
    #[inline]
    fn sampled(
        &self,
        wo: Vec3<R>,
        wi: Vec3<R>,
        eta: R::Primal,
        mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        let sample = BsdfSample::reflected(wi, self.pdf(wo, wi, mode))?;
        Some(BsdfSample { eta, ..sample })
    }

    /// Densities of `wi` in each of those, given the half vector.
    #[inline]
    fn densities(&self, wo: Vec3<R>, wi: Vec3<R>, m: Vec3<R>) -> [R; 3] {
        let main = self.microfacet.pdf_reflected(wo, m);
        let base = warp::cosine_hemisphere_pdf(wi.z);
        let coat = self.clearcoat.map_or(R::zero(), |[_, alpha]| {
            let cos = wo.dot(m).abs();
            // As in `Microfacet::pdf_reflected`.
            if cos.primal() < R::Primal::of(1e-8) {
                R::zero()
            } else {
                coat_d(alpha, m) * m.z / (cos * R::c(4.0))
            }
        });
        [main, base, coat]
    }

    /// Diffuse and retro-reflection and their like, cosine included, for a white base without metal.
    #[inline]
    fn base(&self, wo: Vec3<R>, wi: Vec3<R>, cos_d: R) -> R {
        let (one, (f_o, f_i)) = (R::one(), (schlick(wo.z), schlick(wi.z)));
        let half = R::c(0.5);
        let diffuse = (-(f_i * half) + R::c(1.0)) * (-(f_o * half) + R::c(1.0));
        let rr = self.roughness * cos_d.square() * R::c(2.0);
        let retro = rr * (f_o + f_i + f_o * f_i * (rr - one));
        let surface = diffuse + retro;
        let value = match self.flatness {
            None => surface,
            Some(flatness) => {
                // One, and the value at grazing angles, by Schlick's weight.
                let mix = |f: R| (rr * half - one) * f + one;
                let cosines = (wo.z + wi.z).max(R::of(GRAZING));
                let below = mix(f_o) * mix(f_i) * (cosines.recip() - R::of(0.5)) + R::of(0.5);
                let below = below * R::c(1.25);
                surface + (below - surface) * flatness
            }
        };
        value * wi.z * R::c(FRAC_1_PI)
    }

    /// What tints change: `dielectric` is the reflectance without, `main` what it is multiplied with.
    #[inline]
    fn tinted(&self, grazing: R, dielectric: R, main: R, cos: R) -> Rgb<R> {
        let matt = -self.metallic + R::c(1.0);
        let luminance = self.base_color.luminance();
        let hue = if luminance.primal() > R::Primal::zero() {
            self.base_color.map(|c| c / luminance)
        } else {
            Rgb::splat(R::one())
        };
        let [spec, sheen] = self.tints;
        let normal = self.eta.map(|eta| {
            let root = (eta - R::one()) / (eta + R::one());
            root.square()
        });
        hue.map(|hue| {
            let mut change = R::zero();
            if let (Some(tint), Some(normal)) = (spec, normal) {
                let normal = hue * normal;
                let coloured = normal + (R::one() - normal) * grazing;
                change += (coloured * matt - dielectric) * tint * main;
            }
            if let (Some(tint), Some(sheen)) = (sheen, self.sheen) {
                change += (hue - R::one()) * tint * sheen * matt * grazing * cos;
            }
            change
        })
    }

    /// Masking of the clear coat.
    #[inline]
    fn coat_masking(w: Vec3<R>) -> R {
        let (c, s2) = (w.z.abs(), w.x.square() + w.y.square());
        let root = (c.square() + s2 * R::c(COAT_MASKING * COAT_MASKING)).sqrt();
        c * R::c(2.0) / (c + root)
    }
}

impl<R: Real, A: Alpha<Scalar = R>> Lobe<R> for PrincipledLobe<R, A> {
    #[inline]
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> Rgb<R> {
        let Some(m) = half_vector(wo, wi) else {
            return self.glass(wo, wi, mode);
        };
        let cos_d = wo.dot(m);
        let (grazing, matt) = (schlick(cos_d), -self.metallic + R::c(1.0));
        let dielectric = match self.eta {
            Some(eta) => fresnel::dielectric(cos_d, eta).reflect * matt,
            None => R::zero(),
        };
        let main = reflection(&self.microfacet, wo, wi, m);
        let base = self.base(wo, wi, cos_d) * opaque(self.metallic, self.transmission);
        let mut white = R::zero();
        if let Some(sheen) = self.sheen {
            white += sheen * matt * grazing * wi.z;
        }
        if let Some([strength, alpha]) = self.clearcoat {
            let f = grazing * R::c(0.96) + R::c(0.04);
            let masking = Self::coat_masking(wo) * Self::coat_masking(wi);
            white += strength * f * coat_d(alpha, m) * masking * wi.z * R::c(0.25);
        }
        let value = self.base_color.map(|colour| {
            let metal = colour + (R::one() - colour) * grazing;
            (metal * self.metallic + dielectric) * main + colour * base + white
        });
        if let [None, None] = self.tints {
            return value;
        }
        value + self.tinted(grazing, dielectric, main, wi.z)
    }

    #[inline]
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> R {
        let Some(m) = half_vector(wo, wi) else {
            let glass = self.glass_density(wo, wi);
            return glass.map_or(R::zero(), |[pdf, chosen]| pdf * Const(chosen.primal()));
        };
        let refracts = self.refracts(wo.dot(m)).map(Real::primal);
        let shares = Self::reflecting(self.primal_shares(), refracts);
        let parts = self.densities(wo, wi, m).into_iter().zip(shares);
        parts.fold(R::zero(), |sum, (pdf, share)| sum + pdf * Const(share))
    }

    /// Chooses a part by the (primal) shares, and between reflection and refraction by the reflectance of a facet.
    #[inline]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        if wo.z.primal() <= R::Primal::zero() {
            return self.sample_below(wo, u, mode);
        }
        let [main, base, _] = self.primal_shares();
        let wi = match self.clearcoat {
            _ if u[0] < main => {
                let m = self.microfacet.sample(wo, [u[1], u[2]]);
                if let (Some(refracts), Some(eta)) = (self.refracts(wo.dot(m)), self.eta) {
                    let reflects = u[0] >= main * refracts.primal();
                    let (wi, eta) = scatter(wo, m, eta, |_| reflects)?;
                    return self.sampled(wo, wi, eta, mode);
                }
                reflect(wo, m)
            }
            Some([_, alpha]) if u[0] >= main + base => {
                reflect(wo, coat_normal(alpha, [u[1], u[2]]))
            }
            _ => Vec3::lift(warp::square_to_cosine_hemisphere([u[1], u[2]])),
        };
        // Below the horizon there is glass, but it was not asked for.
        if wi.z.primal() <= R::Primal::zero() {
            return None;
        }
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
            let glass = self.glass_density(wo, wi);
            return glass.map_or(R::zero(), |[pdf, chosen]| constant(pdf) * chosen);
        };
        let shares = Self::reflecting(self.shares(), self.refracts(wo.dot(m)));
        let parts = self.densities(wo, wi, m).into_iter().zip(shares);
        parts.fold(R::zero(), |sum, (pdf, share)| sum + constant(pdf) * share)
    }
}

impl FromNode for Principled {
    const PLUGINS: &'static [&'static str] = &["principled"];

    /// `base_color` (0.5), `roughness` (0.5), `metallic` (0), `specular` (0.5) or `eta`, `flatness` (0), `sheen` (0),
    /// `clearcoat` (0), `clearcoat_gloss` (0), `spec_trans` (0), `spec_tint` (0) and `sheen_tint` (0).
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        // Zero, or there is another plugin for it.
        node.grey(ANISOTROPIC)?;
        Self::of(node, registry, ())
    }
}

impl FromNode for AnisotropicPrincipled {
    const PLUGINS: &'static [&'static str] = Principled::<()>::PLUGINS;

    fn takes(node: &Node) -> bool {
        let is_zero = matches!(node.grey(ANISOTROPIC), Ok(Some(x)) if x == 0.0);
        Self::PLUGINS.contains(&node.plugin.as_str()) && node.has(ANISOTROPIC) && !is_zero
    }

    /// As that, and `anisotropic`.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let anisotropic = registry.scalar_texture(node, ANISOTROPIC, 0.0, (0.0, 1.0))?;
        Self::of(node, registry, anisotropic)
    }
}

/// The attributes.
const ANISOTROPIC: &str = "anisotropic";
const TRANSMISSION: &str = "spec_trans";

/// Whether a node is such a material that transmits. Zero is the opaque one, which is seen from one side.
pub(super) fn transmits(node: &Node) -> bool {
    let is_zero = matches!(node.grey(TRANSMISSION), Ok(Some(x)) if x == 0.0);
    Principled::<()>::PLUGINS.contains(&node.plugin.as_str()) && node.has(TRANSMISSION) && !is_zero
}

impl<T> Principled<T> {
    fn of(node: &Node, registry: &mut Registry, anisotropic: T) -> Result<Self, SceneError> {
        node.ignore(
            &[
                "diffuse_reflectance_sampling_rate",
                "main_specular_sampling_rate",
                "clearcoat_sampling_rate",
            ],
            Node::float,
        )?;
        let unit = (0.0, 1.0);
        let base_color = registry.rgb_texture(node, "base_color", [0.5; 3], unit)?;
        let roughness = registry.scalar_texture(node, "roughness", 0.5, unit)?;
        let mut given = |key: &str| -> Result<Option<ScalarTexture>, SceneError> {
            if node.has(key) {
                registry.scalar_texture(node, key, 0.0, unit).map(Some)
            } else {
                Ok(None)
            }
        };
        let (metallic, flatness) = (given("metallic")?, given("flatness")?);
        let (sheen, coat) = (given("sheen")?, given("clearcoat")?);
        // A tint of zero is none, and without sheen there is nothing to tint.
        let mut tint = |key: &str, of: bool| match node.grey(key) {
            Ok(Some(0.0)) => Ok(None),
            _ if of => given(key),
            value => value.map(|_| None),
        };
        let tints = [
            tint("spec_tint", true)?,
            tint("sheen_tint", sheen.is_some())?,
        ];
        let transmission = if transmits(node) {
            given(TRANSMISSION)?
        } else {
            None
        };
        let clearcoat = match coat {
            None => {
                node.grey("clearcoat_gloss")?;
                None
            }
            Some(strength) => {
                let gloss = registry.scalar_texture(node, "clearcoat_gloss", 0.0, unit)?;
                Some([strength, gloss])
            }
        };
        let least = if transmission.is_some() {
            LEAST_GLASS
        } else {
            LEAST_SPECULAR
        };
        let dielectric = match (node.has("eta"), node.grey("specular")?) {
            (true, Some(_)) => return Err(node.invalid("specular", "none beside `eta`")),
            (true, None) => {
                let valid = (1.0 + LEAST_ALPHA, 10.0);
                Some(Reflectivity::Index(
                    registry.scalar_texture(node, "eta", 1.5, valid)?,
                ))
            }
            (false, Some(s))
                if transmission.is_none() && tints[0].is_none() && (0.0..least).contains(&s) =>
            {
                None
            }
            (false, _) => {
                let valid = (least, 1.0);
                let specular = registry.scalar_texture(node, "specular", 0.5, valid)?;
                Some(Reflectivity::Specular(specular))
            }
        };
        Ok(Self {
            base_color,
            roughness,
            metallic,
            dielectric,
            flatness,
            sheen,
            clearcoat,
            transmission,
            tints,
            anisotropic,
        })
    }
}
