//! The material of [Burley 2015] for surfaces that have no inside: leaves, paper, panes.

use std::f64::consts::FRAC_1_PI;

use ad_core::{Const, Real, Vec3};

use super::microfacet::{Alpha, Axes, Microfacet, Ndf};
use super::principled::{
    ANISOTROPIC, LEAST_ALPHA, LEAST_SHARE, asks_for, brushed, even, hue, matt, schlick,
};
use super::rough_conductor::{Facets, reflect};
use super::{
    BsdfSample, Component, Leaf, Lobe, Reader, Scattered, Tints, TransportMode, constant, fresnel,
};
use crate::error::SceneError;
use crate::math::{Rgb, warp};
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::{RgbTexture, ScalarTexture};

/// A thin surface, the same from both sides: diffuse reflection and transmission, sheen, and a rough pane of glass. What a
/// scene file does not mention costs nothing and is no parameter. `T` is a texture where the pane is anisotropic.
#[derive(Clone, Debug)]
pub struct PrincipledThin<T = ()> {
    /// Colour of what is scattered and of what passes.
    pub base_color: RgbTexture,
    /// The root of the roughness of the pane, where that is at least `LEAST_ALPHA`.
    pub roughness: ScalarTexture,
    /// How much of the surface is a pane, from 0 to 1, and its index of refraction.
    pub pane: Option<[ScalarTexture; 2]>,
    /// Twice the share of what is no pane that is transmitted instead of reflected, from 0 to 2.
    pub diff_trans: Option<ScalarTexture>,
    /// From diffuse reflection, 0, to that of something translucent, 1.
    pub flatness: Option<ScalarTexture>,
    /// Light at grazing angles, as of cloth.
    pub sheen: Option<ScalarTexture>,
    /// How much the reflection of a pane, and the sheen, have the hue of the base, from 0 to 1.
    pub tints: [Option<ScalarTexture>; 2],
    /// How much longer than wide highlights are, from 0 to 1.
    pub anisotropic: T,
}

/// The same with highlights that are longer along dp/du than across.
pub type AnisotropicThin = PrincipledThin<ScalarTexture>;

/// Of samples of a pane, the share that is reflected.
const REFLECTED: f64 = 0.3;
/// Facets of what passes have a roughness of `SPREAD[0] eta - SPREAD[1]` times that of the surface [Burley 2015, Fig. 15],
/// both before they are squared.
const SPREAD: [f64; 2] = [0.65, 0.35];

/// [`PrincipledThin`] at a point, as Mitsuba 3 has it: the sides of [Burley 2015], a pane whose two interfaces are one
/// Fresnel reflectance, and what passes it is reflected light on the other side, times the colour.
///
/// Of what passes, Mitsuba 3 leaves out directions behind the facet from which they are mirrored, grazing ones; here they
/// are there, so that both directions can change places.
///
/// # Derivatives
/// None in a roughness whose square is below `LEAST_ALPHA`, nor in the hue of black. A hue mixes colour channels.
#[derive(Clone, Copy, Debug)]
pub struct PrincipledThinLobe<R, A = R> {
    pub(crate) base_color: Rgb<R>,
    pub(crate) roughness: R,
    pub(crate) pane: Option<Pane<R, A>>,
    /// The share of what is transmitted.
    pub(crate) diff_trans: Option<R>,
    pub(crate) flatness: Option<R>,
    pub(crate) sheen: Option<R>,
    pub(crate) tints: Option<Tints<R>>,
}

/// Glass without an inside.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pane<R, A> {
    /// How much of the surface it is.
    pub share: R,
    pub eta: R,
    pub reflecting: Microfacet<A>,
    pub transmitting: Microfacet<A>,
}

/// Two directions as if both were above the surface, and whether the second is on the other side of it.
struct Sides<R> {
    directions: [Vec3<R>; 2],
    passes: bool,
    /// Normal of the facet between the directions.
    m: Vec3<R>,
    /// Cosine of both to it.
    cos: R,
}

impl<R: Real> Sides<R> {
    #[inline]
    fn of(wo: Vec3<R>, wi: Vec3<R>) -> Option<Self> {
        let zero = R::Primal::zero();
        if wo.z.primal() == zero || wi.z.primal() == zero {
            return None;
        }
        let passes = (wo.z.primal() > zero) != (wi.z.primal() > zero);
        let [wo, wi] = [wo, wi].map(above);
        let m = (wo + wi).normalize();
        Some(Self {
            directions: [wo, wi],
            passes,
            m,
            cos: wo.dot(m),
        })
    }
}

/// The direction, or its image above the surface.
#[inline]
fn above<R: Real>(w: Vec3<R>) -> Vec3<R> {
    Vec3::new(w.x, w.y, w.z.abs())
}

/// Shares of samples: facets that reflect and that let pass, diffuse reflection and transmission. What there is none of is
/// zero.
struct Shares<S>([S; 4]);

impl<S: Real> Shares<S> {
    /// Not zero where it could be more, which has a derivative (errata F7).
    #[inline]
    fn of(pane: Option<S>, diff_trans: Option<S>) -> Self {
        let (zero, least) = (S::zero(), S::of(LEAST_SHARE));
        let part = |share: Option<S>, of: f64| share.map_or(zero, |s| s * S::of(of) + least);
        let matt = -pane.unwrap_or(zero) + S::c(1.0);
        let passes = diff_trans.unwrap_or(zero);
        let parts = [
            part(pane, REFLECTED),
            part(pane, 1.0 - REFLECTED),
            matt * (-passes + S::c(1.0)) + least,
            part(diff_trans.map(|t| matt * t), 1.0),
        ];
        let whole = (parts[0] + parts[1] + parts[2] + parts[3]).recip();
        Self(parts.map(|p| p * whole))
    }
}

impl Leaf for PrincipledThin {
    type Lobe<R: Real> = PrincipledThinLobe<R>;
    const MANY: bool = true;

    fn transmits(&self) -> bool {
        true
    }

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> PrincipledThinLobe<R> {
        self.read(read, even)
    }
}

impl Leaf for AnisotropicThin {
    type Lobe<R: Real> = PrincipledThinLobe<R, Axes<R>>;
    const MANY: bool = true;

    fn transmits(&self) -> bool {
        true
    }

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> PrincipledThinLobe<R, Axes<R>> {
        let anisotropic = read.scalar(&self.anisotropic);
        self.read(read, |squared| brushed(squared, anisotropic))
    }
}

impl<T> PrincipledThin<T> {
    /// Whether some light goes on behind it.
    pub(super) fn lets_light_through(&self) -> bool {
        self.pane.is_some() || self.diff_trans.is_some()
    }

    /// All parameters but the last; `alpha` makes roughness along the surface of that of the model, squared.
    #[inline]
    fn read<R: Real, A>(
        &self,
        read: &mut impl Reader<R>,
        alpha: impl Fn(R) -> A,
    ) -> PrincipledThinLobe<R, A> {
        let is_tinted = self.tints.iter().any(Option::is_some);
        let base_color = if is_tinted {
            read.mixed(&self.base_color)
        } else {
            read.rgb(&self.base_color)
        };
        let roughness = read.alpha(&self.roughness);
        let pane = self.pane.as_ref().map(|[share, eta]| {
            let (share, eta) = (read.scalar(share), read.scalar(eta));
            let facets = |root: R| Microfacet {
                kind: Ndf::Ggx,
                alpha: alpha(root.square()),
                visible: true,
            };
            let spread = eta * R::of(SPREAD[0]) - R::of(SPREAD[1]);
            Pane {
                share,
                eta,
                reflecting: facets(roughness),
                transmitting: facets(roughness * spread),
            }
        });
        let mut number = |t: &Option<ScalarTexture>| t.as_ref().map(|t| read.scalar(t));
        let diff_trans = number(&self.diff_trans).map(|t| t * R::c(0.5));
        let (flatness, sheen) = (number(&self.flatness), number(&self.sheen));
        let tints = self.tints.each_ref().map(&mut number);
        PrincipledThinLobe {
            base_color,
            roughness,
            pane,
            diff_trans,
            flatness,
            sheen,
            tints: is_tinted.then(|| Tints {
                hue: hue(base_color),
                dielectric: tints[0].unwrap_or(R::zero()),
                sheen: tints[1].unwrap_or(R::zero()),
            }),
        }
    }
}

impl<R: Real, A: Alpha<Scalar = R>> PrincipledThinLobe<R, A> {
    #[inline]
    fn shares(&self) -> Shares<R> {
        Shares::of(self.pane.map(|p| p.share), self.diff_trans)
    }

    #[inline]
    fn primal_shares(&self) -> Shares<R::Primal> {
        let pane = self.pane.map(|p| p.share.primal());
        Shares::of(pane, self.diff_trans.map(Real::primal))
    }

    /// Facets of the side on which the second direction is.
    #[inline]
    fn facets(&self, s: &Sides<R>) -> Option<Facets<R>> {
        self.pane.as_ref().map(|pane| {
            let surface = if s.passes {
                &pane.transmitting
            } else {
                &pane.reflecting
            };
            Facets::at(surface, s.m, s.directions)
        })
    }

    /// What is seen of the second direction.
    #[inline]
    fn value(&self, s: &Sides<R>, facets: Option<&Facets<R>>) -> Rgb<R> {
        let (one, [wo, wi]) = (R::one(), s.directions);
        let rest = -self.pane.map_or(R::zero(), |p| p.share) + one;
        let through = self.diff_trans.unwrap_or(R::zero());
        let mut value = if s.passes {
            self.base_color * (rest * through * wi.z * R::c(FRAC_1_PI))
        } else {
            let back = rest * (-through + one);
            let mut value =
                self.base_color * (matt(self.roughness, self.flatness, [wo, wi], s.cos) * back);
            if let Some(sheen) = self.sheen {
                let sheen = sheen * back * schlick(s.cos) * wi.z;
                value += self.tinted(self.tints.map(|t| t.sheen)) * sheen;
            }
            value
        };
        if let (Some(pane), Some(facets)) = (&self.pane, facets) {
            let fresnel = fresnel::dielectric(s.cos, pane.eta);
            let main = facets.reflection(wi) * pane.share;
            value += if s.passes {
                self.base_color * (fresnel.transmit * main)
            } else {
                self.reflectance(fresnel.reflect, pane.eta, s.cos) * main
            };
        }
        value
    }

    /// White, or as much of the hue as that.
    #[inline]
    fn tinted(&self, tint: Option<R>) -> Rgb<R> {
        let white = Rgb::splat(R::one());
        match (&self.tints, tint) {
            (Some(tints), Some(tint)) => white + (tints.hue - white) * tint,
            _ => white,
        }
    }

    /// What a facet of the pane reflects: where it is tinted, by Schlick's fit.
    #[inline]
    fn reflectance(&self, fresnel: R, eta: R, cos: R) -> Rgb<R> {
        let exact = Rgb::splat(fresnel);
        let Some(tints) = &self.tints else {
            return exact;
        };
        let root = (eta - R::one()) / (eta + R::one());
        let normal = tints.hue * root.square();
        let coloured = normal + (Rgb::splat(R::one()) - normal) * schlick(cos);
        exact + (coloured - exact) * tints.dielectric
    }

    /// Densities of the second direction among samples of facets, and of all others.
    #[inline]
    fn densities(s: &Sides<R>, facets: Option<&Facets<R>>) -> [R; 2] {
        let of_facets = facets.map_or(R::zero(), Facets::pdf_reflected);
        [of_facets, warp::cosine_hemisphere_pdf(s.directions[1].z)]
    }

    #[inline]
    fn density(&self, s: &Sides<R>, facets: Option<&Facets<R>>) -> R {
        let Shares(shares) = self.primal_shares();
        let side = usize::from(s.passes);
        let [of_facets, other] = Self::densities(s, facets);
        of_facets * Const(shares[side]) + other * Const(shares[2 + side])
    }

    #[inline]
    fn direction(&self, wo: Vec3<R>, u: [R::Primal; 3]) -> Option<Vec3<R>> {
        let (zero, Shares([reflects, passes, base, _])) = (R::Primal::zero(), self.primal_shares());
        if wo.z.primal() == zero {
            return None;
        }
        let of_facets = reflects + passes;
        let facets = match &self.pane {
            Some(pane) if u[0] < reflects => Some(&pane.reflecting),
            Some(pane) if u[0] < of_facets => Some(&pane.transmitting),
            _ => None,
        };
        let on_side = match facets {
            Some(facets) => {
                let seen = above(wo);
                reflect(seen, facets.sample(seen, [u[1], u[2]]))
            }
            None => Vec3::lift(warp::square_to_cosine_hemisphere([u[1], u[2]])),
        };
        if on_side.z.primal() <= zero {
            return None;
        }
        let other = (u[0] >= reflects && u[0] < of_facets) || u[0] >= of_facets + base;
        let turned = (wo.z.primal() < zero) != other;
        let mirrored = Vec3::new(on_side.x, on_side.y, -on_side.z);
        Some(Vec3::select(turned, mirrored, on_side))
    }
}

impl<R: Real, A: Alpha<Scalar = R>> Lobe<R> for PrincipledThinLobe<R, A> {
    #[inline]
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
        match Sides::of(wo, wi) {
            Some(s) => self.value(&s, self.facets(&s).as_ref()),
            None => Rgb::black(),
        }
    }

    #[inline]
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> R {
        match Sides::of(wo, wi) {
            Some(s) => self.density(&s, self.facets(&s).as_ref()),
            None => R::zero(),
        }
    }

    #[inline]
    fn eval_pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> (Rgb<R>, R) {
        let Some(s) = Sides::of(wo, wi) else {
            return (Rgb::black(), R::zero());
        };
        let facets = self.facets(&s);
        (
            self.value(&s, facets.as_ref()),
            self.density(&s, facets.as_ref()),
        )
    }

    /// Chooses a part by the (primal) shares.
    #[inline]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        let wi = self.direction(wo, u)?;
        BsdfSample::reflected(wi, self.pdf(wo, wi, mode))
    }

    #[inline]
    fn sample_eval(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        let wi = self.direction(wo, u)?;
        let (f, pdf) = self.eval_pdf(wo, wi, mode);
        Some((BsdfSample::reflected(wi, pdf)?, f))
    }

    #[inline]
    fn choice_pdf(
        &self,
        wo: Vec3<R>,
        wi: Vec3<R>,
        _component: Component,
        _mode: TransportMode,
    ) -> R {
        let Some(s) = Sides::of(wo, wi) else {
            return R::zero();
        };
        let Shares(shares) = self.shares();
        let side = usize::from(s.passes);
        let parts = Self::densities(&s, self.facets(&s).as_ref()).map(constant);
        parts[0] * shares[side] + parts[1] * shares[2 + side]
    }
}

impl FromNode for PrincipledThin {
    const PLUGINS: &'static [&'static str] = &["principledthin"];

    /// `base_color` (0.5), `roughness` (0.5), `spec_trans` (0) with `eta` (1.5) and `spec_tint` (0), `diff_trans` (0),
    /// `flatness` (0), `sheen` (0) with `sheen_tint` (0).
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        // Zero, or there is another plugin for it.
        node.grey(ANISOTROPIC)?;
        Self::of(node, registry, ())
    }
}

impl FromNode for AnisotropicThin {
    const PLUGINS: &'static [&'static str] = PrincipledThin::<()>::PLUGINS;

    fn takes(node: &Node) -> bool {
        asks_for(node, Self::PLUGINS, ANISOTROPIC)
    }

    /// As that, and `anisotropic`.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let anisotropic = registry.scalar_texture(node, ANISOTROPIC, 0.0, (0.0, 1.0))?;
        Self::of(node, registry, anisotropic)
    }
}

impl<T> PrincipledThin<T> {
    fn of(node: &Node, registry: &mut Registry, anisotropic: T) -> Result<Self, SceneError> {
        node.ignore(
            &[
                "diffuse_reflectance_sampling_rate",
                "diffuse_transmittance_sampling_rate",
                "specular_reflectance_sampling_rate",
                "specular_transmittance_sampling_rate",
            ],
            Node::float,
        )?;
        let unit = (0.0, 1.0);
        let base_color = registry.rgb_texture(node, "base_color", [0.5; 3], unit)?;
        let roughness = registry.scalar_texture(node, "roughness", 0.5, unit)?;
        let mut given = |key: &str, valid: (f64, f64)| {
            let read = |_| registry.scalar_texture(node, key, 0.0, valid);
            node.has(key).then_some(()).map(read).transpose()
        };
        let share = given("spec_trans", unit)?;
        let diff_trans = given("diff_trans", (0.0, 2.0))?;
        let (flatness, sheen) = (given("flatness", unit)?, given("sheen", unit)?);
        // Of what is not there, there is nothing to tint.
        let mut tint = |key: &str, of: bool| match node.grey(key) {
            Ok(Some(0.0)) => Ok(None),
            _ if of => given(key, unit),
            _ => node.ignore_texture(key).map(|()| None),
        };
        let tints = [
            tint("spec_tint", share.is_some())?,
            tint("sheen_tint", sheen.is_some())?,
        ];
        let pane = match share {
            Some(share) => {
                let valid = (1.0 + LEAST_ALPHA, 10.0);
                Some([share, registry.scalar_texture(node, "eta", 1.5, valid)?])
            }
            None => {
                node.ignore_texture("eta")?;
                None
            }
        };
        Ok(Self {
            base_color,
            roughness,
            pane,
            diff_trans,
            flatness,
            sheen,
            tints,
            anisotropic,
        })
    }
}
