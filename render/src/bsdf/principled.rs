//! The material of [Burley 2012] and [Burley 2015] that modelling programs write.

use std::f64::consts::{FRAC_1_PI, PI};

use ad_core::{Const, Float, Real, Vec3};

use super::microfacet::{Alpha, Axes, Microfacet, Ndf};
use super::nesting::attached_choice;
use super::rough_conductor::{Facets, reflect};
use super::rough_dielectric::{Facet, scatter, scatter_in_line, upwards};
use super::{
    BsdfSample, Component, Leaf, Lobe, Reader, Scattered, TransportMode, constant, fresnel,
};
use crate::error::SceneError;
use crate::math::gauss::exp_m1;
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
pub(super) const LEAST_ALPHA: f64 = 1e-3;
/// A dielectric of less `specular` reflects nothing.
const LEAST_SPECULAR: f64 = 1e-4;
/// The least `specular` of glass: with less, refraction degenerates to a Dirac delta.
const LEAST_GLASS: f64 = 1e-3;
/// Roughness of the clear coat without gloss and with all of it.
const COAT: [f64; 2] = [0.1, 1e-3];
/// Roughness in the masking of the clear coat.
const COAT_MASKING: f64 = 0.25;
/// Least share of samples of each part that is there: what has no weight has a derivative (errata F7).
pub(super) const LEAST_SHARE: f64 = 0.05;
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
    pub(crate) base_color: Rgb<R>,
    pub(crate) roughness: R,
    pub(crate) microfacet: Microfacet<A>,
    pub(crate) metallic: R,
    /// Index of the dielectric; one where there is none.
    pub(crate) eta: R,
    pub(crate) flatness: Option<R>,
    pub(crate) sheen: Option<R>,
    pub(crate) clearcoat: Option<ClearCoat<R>>,
    pub(crate) transmission: Option<R>,
    pub(crate) tints: Option<Tints<R>>,
}

/// A second, colourless reflection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ClearCoat<R> {
    pub strength: R,
    /// Its roughness.
    pub alpha: R,
    /// Logarithm of the square of that.
    pub ln: R,
}

/// What has the hue of the base.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tints<R> {
    pub hue: Rgb<R>,
    /// How much of the reflection of the dielectric has.
    pub dielectric: R,
    /// How much of the sheen has.
    pub sheen: R,
}

impl<R: Real> Tints<R> {
    /// Those that change nothing.
    #[inline(always)]
    pub fn none() -> Self {
        Self {
            hue: Rgb::splat(R::one()),
            dielectric: R::zero(),
            sheen: R::zero(),
        }
    }
}

/// How directions are chosen: shares of facets, the base and the clear coat among samples from above, and how often light
/// that a facet transmits is taken for that of glass. What there is none of is zero.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Choices<S> {
    pub main: S,
    pub base: S,
    pub coat: S,
    pub glass: S,
}

impl<S: Real> Choices<S> {
    /// Not zero without glass that could be, which has a derivative (errata F7).
    #[inline]
    fn of(metallic: S, clearcoat: Option<S>, transmission: Option<S>) -> Self {
        let least = S::of(LEAST_SHARE);
        let base = opaque(metallic, transmission) + least;
        let coat = clearcoat.map_or(S::zero(), |c| c * S::c(0.25) + least);
        let main = S::one();
        let whole = (main + base + coat).recip();
        let glass = transmission.map_or(S::zero(), |t| attached_choice(glass(metallic, t)));
        Self {
            main: main * whole,
            base: base * whole,
            coat: coat * whole,
            glass,
        }
    }

    /// Shares of those that are reflected, where `transmit` is the transmittance of the facet.
    #[inline(always)]
    fn reflecting(&self, transmit: S) -> [S; 3] {
        let main = self.main * (-self.refracts(transmit) + S::c(1.0));
        [main, self.base, self.coat]
    }

    /// Probability that a sampled facet refracts.
    #[inline(always)]
    fn refracts(&self, transmit: S) -> S {
        self.glass * transmit
    }

    /// Probability that a facet, seen from above or not, is taken for one that reflects or not, where that is not above the
    /// surface.
    #[inline(always)]
    fn beyond(&self, above: bool, reflects: bool, fresnel: &fresnel::Dielectric<S>) -> S {
        let from_above = self.main * self.refracts(fresnel.transmit);
        let refracts = S::select(above, from_above, fresnel.transmit);
        S::select(reflects, fresnel.reflect, refracts)
    }
}

impl<P: Float> Choices<P> {
    /// Whether a sampled facet, seen from above or not, reflects.
    #[inline(always)]
    fn reflects(&self, fresnel: &fresnel::Dielectric<P>, above: bool, u: P) -> bool {
        let from_above = u >= self.main * self.refracts(fresnel.transmit);
        (above & from_above) | (!above & (u < fresnel.reflect))
    }
}

/// Roughness along all tangents, of that of the model, squared.
#[inline]
pub(super) fn even<R: Real>(squared: R) -> R {
    squared.max(R::of(LEAST_ALPHA))
}

/// Roughness along both tangents, of highlights that are longer along the first one.
#[inline]
pub(super) fn brushed<R: Real>(squared: R, anisotropic: R) -> Axes<R> {
    let aspect = (-(anisotropic * R::c(ELONGATION)) + R::c(1.0)).sqrt();
    Axes([squared / aspect, squared * aspect].map(even))
}

impl Leaf for Principled {
    type Lobe<R: Real> = PrincipledLobe<R>;
    const MANY: bool = true;

    fn transmits(&self) -> bool {
        self.transmission.is_some()
    }

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> PrincipledLobe<R> {
        self.read(read, |_, squared| even(squared))
    }
}

impl Leaf for AnisotropicPrincipled {
    type Lobe<R: Real> = PrincipledLobe<R, Axes<R>>;
    const MANY: bool = true;

    fn transmits(&self) -> bool {
        self.transmission.is_some()
    }

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> PrincipledLobe<R, Axes<R>> {
        self.read(read, |read, squared| {
            let anisotropic = read.scalar(&self.anisotropic);
            brushed(squared, anisotropic)
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
        let is_tinted = self.tints.iter().any(Option::is_some);
        let base_color = if is_tinted {
            read.mixed(&self.base_color)
        } else {
            read.rgb(&self.base_color)
        };
        let roughness = read.alpha(&self.roughness);
        let alpha = alpha(read, roughness.square());
        let mut number = |t: &Option<ScalarTexture>| t.as_ref().map(|t| read.scalar(t));
        let metallic = number(&self.metallic).unwrap_or(R::zero());
        let (flatness, sheen) = (number(&self.flatness), number(&self.sheen));
        let eta = self.dielectric.as_ref().map_or(R::one(), |d| d.index(read));
        let clearcoat = self.clearcoat.as_ref().map(|[strength, gloss]| {
            let (strength, gloss) = (read.scalar(strength), read.scalar(gloss));
            let alpha = gloss * R::c(COAT[1] - COAT[0]) + R::c(COAT[0]);
            let ln = alpha.square().ln();
            ClearCoat {
                strength,
                alpha,
                ln,
            }
        });
        let transmission = self.transmission.as_ref().map(|t| read.scalar(t));
        let [dielectric, of_sheen] = &self.tints;
        let mut tint = |t: &Option<ScalarTexture>| match t {
            Some(t) => read.scalar(t),
            None => R::zero(),
        };
        let (dielectric, of_sheen) = (tint(dielectric), tint(of_sheen));
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
            tints: is_tinted.then(|| Tints {
                hue: hue(base_color),
                dielectric,
                sheen: of_sheen,
            }),
        }
    }
}

impl Reflectivity {
    /// The relative index of refraction.
    #[inline]
    fn index<R: Real>(&self, read: &mut impl Reader<R>) -> R {
        match self {
            Self::Index(eta) => read.scalar(eta),
            Self::Specular(s) => {
                let root = (read.scalar(s) * R::c(0.08)).sqrt();
                (root + R::c(1.0)) / (-root + R::c(1.0))
            }
        }
    }
}

/// A colour over its luminance, white where that is zero.
#[inline]
pub(super) fn hue<R: Real>(colour: Rgb<R>) -> Rgb<R> {
    let luminance = colour.luminance();
    if luminance.primal() > R::Primal::zero() {
        colour.map(|c| c / luminance)
    } else {
        Rgb::splat(R::one())
    }
}

/// `(1 - cos)^5`.
#[inline(always)]
pub(super) fn schlick<R: Real>(cos: R) -> R {
    let m = (-cos + R::c(1.0)).max(R::zero()).min(R::one());
    m.square().square() * m
}

/// Diffuse and retro-reflection of a white surface, cosine included: of a roughness before it is squared, and as translucent
/// as `flatness` says, if it is. `cos_d` is the cosine to the normal of a facet between the directions.
#[inline(always)]
pub(super) fn matt<R: Real>(
    roughness: R,
    flatness: Option<R>,
    [wo, wi]: [Vec3<R>; 2],
    cos_d: R,
) -> R {
    let (one, (f_o, f_i)) = (R::one(), (schlick(wo.z), schlick(wi.z)));
    let half = R::c(0.5);
    let diffuse = (-(f_i * half) + R::c(1.0)) * (-(f_o * half) + R::c(1.0));
    let rr = roughness * cos_d.square() * R::c(2.0);
    let retro = rr * (f_o + f_i + f_o * f_i * (rr - one));
    let surface = diffuse + retro;
    let value = match flatness {
        None => surface,
        Some(flatness) => {
            // One, and the value at grazing angles, by Schlick's weight.
            let grazing = rr * half - one;
            let mixed = (grazing * f_o + one) * (grazing * f_i + one);
            let cosines = (wo.z + wi.z).max(R::of(GRAZING));
            let below = mixed * (cosines.recip() - R::of(0.5)) + R::of(0.5);
            let below = below * R::c(1.25);
            surface + (below - surface) * flatness
        }
    };
    value * wi.z * R::c(FRAC_1_PI)
}

impl<R: Real> ClearCoat<R> {
    /// Density of normals with the long tail of [Burley 2012, Eq. 4], exponent one.
    #[inline(always)]
    fn d(&self, m: Vec3<R>) -> R {
        let a2 = self.alpha.square();
        let below = -a2 + R::c(1.0);
        // 1 + (a^2 - 1) cos^2 without cancellation.
        let spread = a2 * m.z.square() + m.x.square() + m.y.square();
        -below / (self.ln * spread * R::c(PI))
    }

    /// A normal with the density [`ClearCoat::d`] times its cosine.
    #[inline(always)]
    fn normal(&self, u: [R::Primal; 2]) -> Vec3<R> {
        let a2 = self.alpha.square();
        let least = R::Primal::EPSILON * R::Primal::of(0.25);
        let u0 = Const(u[0].max(least));
        let sin2 = a2 * exp_m1(-(self.ln * u0)) / (-a2 + R::c(1.0));
        let sin2 = sin2.min(R::one());
        let (sin_phi, cos_phi) = warp::sin_cos_of_turns(u[1]);
        let sin = sin2.max(R::of(1e-30)).sqrt();
        let cos = (-sin2 + R::c(1.0)).max(R::of(1e-12)).sqrt();
        // As long as one but for rounding: no branch.
        let (m, _) = Vec3::new(sin * Const(cos_phi), sin * Const(sin_phi), cos).unit();
        m
    }

    /// What it reflects, cosine included.
    #[inline(always)]
    fn reflection(&self, m: Vec3<R>, [wo, wi]: [Vec3<R>; 2], grazing: R) -> R {
        let f = grazing * R::c(0.96) + R::c(0.04);
        let masking = Self::masking(wo) * Self::masking(wi);
        self.strength * f * self.d(m) * masking * wi.z * R::c(0.25)
    }

    #[inline(always)]
    fn masking(w: Vec3<R>) -> R {
        let (c, s2) = (w.z.abs(), w.x.square() + w.y.square());
        let root = (c.square() + s2 * R::c(COAT_MASKING * COAT_MASKING)).sqrt();
        c * R::c(2.0) / (c + root)
    }

    /// Density of directions that are reflected by its normals, of which this is one, under an angle with that cosine.
    #[inline(always)]
    fn density(&self, m: Vec3<R>, cos: R) -> R {
        // As in `Microfacet::pdf_reflected`.
        let faces = cos.primal() >= R::Primal::of(1e-8);
        R::select(faces, self.d(m) * m.z / (cos * R::c(4.0)), R::zero())
    }
}

/// What is neither metal nor glass.
#[inline(always)]
fn opaque<S: Real>(metallic: S, transmission: Option<S>) -> S {
    let matt = -metallic + S::c(1.0);
    transmission.map_or(matt, |t| matt * (-t + S::c(1.0)))
}

/// The share that is glass, of what is not metal.
#[inline(always)]
fn glass<S: Real>(metallic: S, transmission: S) -> S {
    (-metallic + S::c(1.0)) * transmission
}

impl<R: Real, A: Alpha<Scalar = R>> PrincipledLobe<R, A> {
    #[inline]
    fn choices(&self) -> Choices<R> {
        let strength = self.clearcoat.map(|coat| coat.strength);
        Choices::of(self.metallic, strength, self.transmission)
    }

    #[inline]
    pub(crate) fn primal_choices(&self) -> Choices<R::Primal> {
        let strength = self.clearcoat.map(|coat| coat.strength.primal());
        let transmission = self.transmission.map(Real::primal);
        Choices::of(self.metallic.primal(), strength, transmission)
    }

    /// The facet that connects two directions, if anything is seen of it, and what such facets do.
    #[inline]
    fn facets(&self, wo: Vec3<R>, wi: Vec3<R>) -> Option<(Facet<R>, Facets<R>)> {
        if self.transmission.is_none() && !is_above(wo, wi) {
            return None;
        }
        let f = Facet::between(wo, wi, self.eta)?;
        Some((f, Facets::at(&self.microfacet, f.m, [wo, wi])))
    }
}

/// Whether both directions are above the surface.
#[inline(always)]
fn is_above<R: Real>(wo: Vec3<R>, wi: Vec3<R>) -> bool {
    let zero = R::Primal::zero();
    (wo.z.primal() > zero) & (wi.z.primal() > zero)
}

/// What the parts are worth, without branches but for those that the material has none of: for loops over many, too.
impl<R: Real, A> PrincipledLobe<R, A> {
    /// Light that is reflected above the surface by such facets.
    #[inline(always)]
    fn reflected(&self, f: &Facet<R>, facets: &Facets<R>, [wo, wi]: [Vec3<R>; 2]) -> Rgb<R> {
        let (grazing, matt) = (schlick(f.cos_o), -self.metallic + R::c(1.0));
        let dielectric = f.fresnel.reflect * matt;
        let main = facets.reflection(wi);
        let base = self.base(wo, wi, f.cos_o) * opaque(self.metallic, self.transmission);
        let mut white = R::zero();
        if let Some(sheen) = self.sheen {
            white += sheen * matt * grazing * wi.z;
        }
        if let Some(coat) = self.clearcoat {
            white += coat.reflection(facets.m, [wo, wi], grazing);
        }
        let colour = self.base_color;
        let metal = colour + (Rgb::splat(R::one()) - colour) * grazing;
        let reflectance = metal * self.metallic + Rgb::splat(dielectric);
        let value = reflectance * main + colour * base + Rgb::splat(white);
        match &self.tints {
            Some(tints) => value + self.tinted(tints, [grazing, dielectric, main, wi.z]),
            None => value,
        }
    }

    /// [`matt`] of a white base without metal.
    #[inline(always)]
    fn base(&self, wo: Vec3<R>, wi: Vec3<R>, cos_d: R) -> R {
        matt(self.roughness, self.flatness, [wo, wi], cos_d)
    }

    /// What tints change: `dielectric` is the reflectance without, `main` what it is multiplied with.
    #[inline(always)]
    fn tinted(&self, tints: &Tints<R>, [grazing, dielectric, main, cos]: [R; 4]) -> Rgb<R> {
        let matt = -self.metallic + R::c(1.0);
        let root = (self.eta - R::one()) / (self.eta + R::one());
        let (white, hue) = (Rgb::splat(R::one()), tints.hue);
        let normal = hue * root.square();
        let coloured = (normal + (white - normal) * grazing) * matt;
        let reflection = (coloured - Rgb::splat(dielectric)) * tints.dielectric * main;
        let Some(sheen) = self.sheen else {
            return reflection;
        };
        reflection + (hue - white) * tints.sheen * sheen * matt * grazing * cos
    }

    /// Densities of `wi` above the surface among samples of facets, the base and the clear coat.
    #[inline(always)]
    fn densities(&self, f: &Facet<R>, facets: &Facets<R>, wi: Vec3<R>) -> [R; 3] {
        let main = facets.pdf_reflected();
        let base = warp::cosine_hemisphere_pdf(wi.z);
        let coat = match &self.clearcoat {
            Some(coat) => coat.density(facets.m, f.cos_o),
            None => R::zero(),
        };
        [main, base, coat]
    }

    /// Radiance that glass reflects from below, and that it refracts.
    #[inline(always)]
    fn glass(&self, f: &Facet<R>, facets: &Facets<R>, wi: Vec3<R>) -> (R, Rgb<R>) {
        let glass = match self.transmission {
            Some(t) => glass(self.metallic, t),
            None => R::zero(),
        };
        let reflected = glass * f.fresnel.reflect * facets.reflection(wi);
        let [refracted, _] = f.refracted(facets.d, facets.sigma, wi);
        let Rgb { r, g, b } = self.base_color;
        let colour = Rgb::new(r.sqrt(), g.sqrt(), b.sqrt());
        (reflected, colour * (refracted * glass))
    }
}

/// Density of a direction that is not reflected above the surface, where facets do that.
#[inline(always)]
fn glass_density<R: Real>(f: &Facet<R>, facets: &Facets<R>, wi: Vec3<R>) -> R {
    let [_, refracted] = f.refracted(facets.d, facets.sigma, wi);
    R::select(f.reflects, facets.pdf_reflected(), refracted)
}

impl<P: Float, A> PrincipledLobe<P, A> {
    /// [`Lobe::eval_pdf`] of radiance where the facets are known: without a branch, for loops over many. `facets.m` is of unit
    /// length. Of a part that some others have, there may be none: then its share is zero.
    #[inline(always)]
    pub(crate) fn eval_pdf_where(
        &self,
        choices: &Choices<P>,
        facets: &Facets<P>,
        directions: [Vec3<P>; 2],
    ) -> (Rgb<P>, P) {
        let ([wo, wi], zero) = (directions, P::zero());
        let (f, faces) = Facet::with(facets.m, directions, self.eta);
        let above = is_above(wo, wi);
        let mut value = self.reflected(&f, facets, directions);
        let [main, base, coat] = self.densities(&f, facets, wi);
        let shares = choices.reflecting(f.fresnel.transmit);
        let mut pdf = main * shares[0] + base * shares[1] + coat * shares[2];
        let mut seen = above;
        if self.transmission.is_some() {
            let (reflected, refracted) = self.glass(&f, facets, wi);
            let glass = Rgb::select(f.reflects, Rgb::splat(reflected), refracted);
            value = Rgb::select(above, value, glass);
            let chosen = choices.beyond(wo.z > zero, f.reflects, &f.fresnel);
            pdf = P::select(above, pdf, glass_density(&f, facets, wi) * chosen);
            let somewhere = (wo.z != zero) & (wi.z != zero);
            seen |= (choices.glass > zero) & somewhere;
        }
        let seen = seen & faces;
        let value = Rgb::select(seen, value, Rgb::black());
        (value, P::select(seen, pdf, zero))
    }

    /// What [`Lobe::sample`] makes of a sampled normal in the upper hemisphere: direction and relative index, and whether there
    /// is one. Without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn scatter(
        &self,
        choices: &Choices<P>,
        wo: Vec3<P>,
        m: Vec3<P>,
        u: [P; 3],
    ) -> (Vec3<P>, P, bool) {
        let (zero, one) = (P::zero(), P::one());
        let (above, of_facets) = (wo.z > zero, u[0] < choices.main);
        let mut turned = warp::square_to_cosine_hemisphere([u[1], u[2]]);
        if let Some(coat) = &self.clearcoat {
            let chosen = (choices.coat > zero) & (u[0] >= choices.main + choices.base);
            let reflected = reflect(wo, coat.normal([u[1], u[2]]));
            turned = Vec3::select(chosen, reflected, turned);
        }
        if self.transmission.is_none() {
            let faces = !of_facets | (wo.dot(m) > zero);
            let wi = Vec3::select(of_facets, reflect(wo, m), turned);
            return (wi, one, above & faces & (wi.z > zero));
        }
        let reflects = |f: &fresnel::Dielectric<P>| choices.reflects(f, above, u[0]);
        let (wi, eta, goes) = scatter_in_line(wo, m, self.eta, reflects);
        let of_facets = of_facets | !above;
        let seen = above | ((choices.glass > zero) & (wo.z < zero));
        let goes = (of_facets & goes) | (!of_facets & (turned.z > zero));
        (
            Vec3::select(of_facets, wi, turned),
            P::select(of_facets, eta, one),
            seen & goes,
        )
    }
}

impl<R: Real, A: Alpha<Scalar = R>> PrincipledLobe<R, A> {
    /// A sampled direction, and the relative index there.
    #[inline]
    fn direction(&self, wo: Vec3<R>, u: [R::Primal; 3]) -> Option<(Vec3<R>, R::Primal)> {
        let (zero, choices) = (R::Primal::zero(), self.primal_choices());
        let (above, below) = (wo.z.primal() > zero, wo.z.primal() < zero);
        let seen = above || (below && self.transmission.is_some());
        if !seen {
            return None;
        }
        let wi = if below || u[0] < choices.main {
            let m = self.microfacet.sample(upwards(wo), [u[1], u[2]]);
            if self.transmission.is_some() {
                let reflects =
                    |f: &fresnel::Dielectric<R>| choices.reflects(&f.primal(), above, u[0]);
                return scatter(wo, m, self.eta, reflects);
            }
            if wo.dot(m).primal() <= zero {
                return None;
            }
            reflect(wo, m)
        } else {
            match &self.clearcoat {
                Some(coat) if u[0] >= choices.main + choices.base => {
                    reflect(wo, coat.normal([u[1], u[2]]))
                }
                _ => Vec3::lift(warp::square_to_cosine_hemisphere([u[1], u[2]])),
            }
        };
        // Below the horizon there is glass, but it was not asked for.
        (wi.z.primal() > zero).then_some((wi, R::Primal::one()))
    }

    #[inline]
    fn value(
        &self,
        f: &Facet<R>,
        facets: &Facets<R>,
        [wo, wi]: [Vec3<R>; 2],
        mode: TransportMode,
    ) -> Rgb<R> {
        if is_above(wo, wi) {
            return self.reflected(f, facets, [wo, wi]);
        }
        let (reflected, refracted) = self.glass(f, facets, wi);
        if f.reflects {
            return Rgb::splat(reflected);
        }
        refracted.map(|c| f.transported(c, mode))
    }

    #[inline]
    fn density(&self, f: &Facet<R>, facets: &Facets<R>, [wo, wi]: [Vec3<R>; 2]) -> R {
        let choices = self.primal_choices();
        if !is_above(wo, wi) {
            let above = wo.z.primal() > R::Primal::zero();
            let chosen = choices.beyond(above, f.reflects, &f.fresnel.primal());
            return glass_density(f, facets, wi) * Const(chosen);
        }
        let [main, base, coat] = self.densities(f, facets, wi);
        let shares = choices.reflecting(f.fresnel.transmit.primal());
        main * Const(shares[0]) + base * Const(shares[1]) + coat * Const(shares[2])
    }
}

impl<R: Real, A: Alpha<Scalar = R>> Lobe<R> for PrincipledLobe<R, A> {
    #[inline]
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> Rgb<R> {
        match self.facets(wo, wi) {
            Some((f, facets)) => self.value(&f, &facets, [wo, wi], mode),
            None => Rgb::black(),
        }
    }

    #[inline]
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> R {
        match self.facets(wo, wi) {
            Some((f, facets)) => self.density(&f, &facets, [wo, wi]),
            None => R::zero(),
        }
    }

    #[inline]
    fn eval_pdf(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> (Rgb<R>, R) {
        let Some((f, facets)) = self.facets(wo, wi) else {
            return (Rgb::black(), R::zero());
        };
        let value = self.value(&f, &facets, [wo, wi], mode);
        (value, self.density(&f, &facets, [wo, wi]))
    }

    /// Chooses a part by the (primal) shares, and between reflection and refraction by the reflectance of a facet.
    #[inline]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        let (wi, eta) = self.direction(wo, u)?;
        let sample = BsdfSample::reflected(wi, self.pdf(wo, wi, mode))?;
        Some(BsdfSample { eta, ..sample })
    }

    #[inline]
    fn sample_eval(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        let (wi, eta) = self.direction(wo, u)?;
        let (f, pdf) = self.eval_pdf(wo, wi, mode);
        let sample = BsdfSample::reflected(wi, pdf)?;
        Some((BsdfSample { eta, ..sample }, f))
    }

    #[inline]
    fn choice_pdf(
        &self,
        wo: Vec3<R>,
        wi: Vec3<R>,
        _component: Component,
        _mode: TransportMode,
    ) -> R {
        let Some((f, facets)) = self.facets(wo, wi) else {
            return R::zero();
        };
        let choices = self.choices();
        if !is_above(wo, wi) {
            let above = wo.z.primal() > R::Primal::zero();
            let chosen = choices.beyond(above, f.reflects, &f.fresnel);
            return constant(glass_density(&f, &facets, wi)) * chosen;
        }
        let parts = self.densities(&f, &facets, wi).map(constant);
        let shares = choices.reflecting(f.fresnel.transmit);
        parts[0] * shares[0] + parts[1] * shares[1] + parts[2] * shares[2]
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
        asks_for(node, Self::PLUGINS, ANISOTROPIC)
    }

    /// As that, and `anisotropic`.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let anisotropic = registry.scalar_texture(node, ANISOTROPIC, 0.0, (0.0, 1.0))?;
        Self::of(node, registry, anisotropic)
    }
}

/// The attributes.
pub(super) const ANISOTROPIC: &str = "anisotropic";
const TRANSMISSION: &str = "spec_trans";

/// Whether a node is such a material that transmits. Zero is the opaque one, which is seen from one side.
fn transmits(node: &Node) -> bool {
    asks_for(node, Principled::<()>::PLUGINS, TRANSMISSION)
}

/// Whether a node is one of these plugins and has this attribute, which is not zero.
pub(super) fn asks_for(node: &Node, plugins: &[&str], attribute: &str) -> bool {
    let is_zero = matches!(node.grey(attribute), Ok(Some(x)) if x == 0.0);
    plugins.contains(&node.plugin.as_str()) && node.has(attribute) && !is_zero
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
            _ => node.ignore_texture(key).map(|()| None),
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
                node.ignore_texture("clearcoat_gloss")?;
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
