//! The material of [Burley 2015] for surfaces that have no inside: leaves, paper, panes.

use std::f64::consts::FRAC_1_PI;

use ad_core::{Const, Float, Real, Vec3};

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

impl<R, A> Pane<R, A> {
    /// The facets that let light pass, or those that reflect it.
    #[inline]
    fn surface(&self, passes: bool) -> &Microfacet<A> {
        if passes {
            &self.transmitting
        } else {
            &self.reflecting
        }
    }
}

/// Two directions as if both were above the surface, and whether the second is on the other side of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sides<R> {
    pub directions: [Vec3<R>; 2],
    pub passes: bool,
    /// Normal of the facet between the directions.
    m: Vec3<R>,
    /// Cosine of both to it.
    cos: R,
}

impl<R: Real> Sides<R> {
    #[inline]
    fn of(wo: Vec3<R>, wi: Vec3<R>) -> Option<Self> {
        let m = Self::along(wo, wi).normalize();
        let (sides, scatters) = Self::with(m, wo, wi);
        scatters.then_some(sides)
    }

    /// A vector along the normal of the facet between the directions.
    #[inline(always)]
    pub fn along(wo: Vec3<R>, wi: Vec3<R>) -> Vec3<R> {
        above(wo) + above(wi)
    }

    /// [`Sides`] where the normal, of unit length, is known, and whether anything is scattered there: without a branch, for
    /// loops over many.
    #[inline(always)]
    pub fn with(m: Vec3<R>, wo: Vec3<R>, wi: Vec3<R>) -> (Self, bool) {
        let zero = R::Primal::zero();
        let [o, i] = [above(wo), above(wi)];
        let sides = Self {
            directions: [o, i],
            passes: (wo.z.primal() > zero) != (wi.z.primal() > zero),
            m,
            cos: o.dot(m),
        };
        (sides, (wo.z.primal() != zero) & (wi.z.primal() != zero))
    }
}

/// The direction, or its image above the surface.
#[inline(always)]
pub(crate) fn above<R: Real>(w: Vec3<R>) -> Vec3<R> {
    Vec3::new(w.x, w.y, w.z.abs())
}

/// Shares of samples: facets that reflect and that let pass, diffuse reflection and transmission. What there is none of is
/// zero.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ThinShares<S>(pub [S; 4]);

/// What a sample is of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ThinPart {
    /// The pane; otherwise, what is diffuse.
    pub of_facets: bool,
    /// What goes to the other side.
    pub passes: bool,
}

impl<P: Float> ThinShares<P> {
    /// The part that a random number chooses.
    #[inline(always)]
    pub fn choose(&self, u: P) -> ThinPart {
        let [reflects, passes, base, _] = self.0;
        let of_facets = u < reflects + passes;
        let through = of_facets & (u >= reflects);
        ThinPart {
            of_facets,
            passes: through | (u >= reflects + passes + base),
        }
    }
}

impl ThinPart {
    /// Where a direction that was chosen above the surface leads from `wo`, and whether anywhere.
    #[inline(always)]
    pub fn turned<R: Real>(&self, wo: Vec3<R>, on_side: Vec3<R>) -> (Vec3<R>, bool) {
        let zero = R::Primal::zero();
        let mirrored = Vec3::new(on_side.x, on_side.y, -on_side.z);
        let behind = (wo.z.primal() < zero) != self.passes;
        let goes = (wo.z.primal() != zero) & (on_side.z.primal() > zero);
        (Vec3::select(behind, mirrored, on_side), goes)
    }
}

impl<S: Real> ThinShares<S> {
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

/// What the parts are worth, without branches but for those that the material has none of: for loops over many, too.
impl<R: Real, A> PrincipledThinLobe<R, A> {
    /// What is seen of the second direction, which is on the side of the first.
    #[inline(always)]
    fn reflected(&self, s: &Sides<R>, facets: Option<&Facets<R>>) -> Rgb<R> {
        let [wo, wi] = s.directions;
        let back = self.rest() * (-self.through() + R::one());
        let base = matt(self.roughness, self.flatness, [wo, wi], s.cos) * back;
        let mut value = self.base_color * base;
        if let Some(sheen) = self.sheen {
            let sheen = sheen * back * schlick(s.cos) * wi.z;
            value += self.tinted(self.tints.map(|t| t.sheen)) * sheen;
        }
        if let (Some(pane), Some(facets)) = (&self.pane, facets) {
            let fresnel = fresnel::dielectric(s.cos, pane.eta);
            let main = facets.reflection(wi) * pane.share;
            value += self.reflectance(fresnel.reflect, pane.eta, s.cos) * main;
        }
        value
    }

    /// The same where the second direction is on the other side.
    #[inline(always)]
    fn transmitted(&self, s: &Sides<R>, facets: Option<&Facets<R>>) -> Rgb<R> {
        let [_, wi] = s.directions;
        let through = self.rest() * self.through() * wi.z * R::c(FRAC_1_PI);
        let mut value = self.base_color * through;
        if let (Some(pane), Some(facets)) = (&self.pane, facets) {
            let fresnel = fresnel::dielectric(s.cos, pane.eta);
            let main = facets.reflection(wi) * pane.share;
            value += self.base_color * (fresnel.transmit * main);
        }
        value
    }

    /// What is no pane.
    #[inline(always)]
    fn rest(&self) -> R {
        -self.pane.as_ref().map_or(R::zero(), |p| p.share) + R::one()
    }

    /// The share of that which is transmitted.
    #[inline(always)]
    fn through(&self) -> R {
        self.diff_trans.unwrap_or(R::zero())
    }

    /// White, or as much of the hue as that.
    #[inline(always)]
    fn tinted(&self, tint: Option<R>) -> Rgb<R> {
        let white = Rgb::splat(R::one());
        match (&self.tints, tint) {
            (Some(tints), Some(tint)) => white + (tints.hue - white) * tint,
            _ => white,
        }
    }

    /// What a facet of the pane reflects: where it is tinted, by Schlick's fit.
    #[inline(always)]
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
    #[inline(always)]
    fn densities(s: &Sides<R>, facets: Option<&Facets<R>>) -> [R; 2] {
        let of_facets = match facets {
            Some(facets) => facets.pdf_reflected(),
            None => R::zero(),
        };
        [of_facets, warp::cosine_hemisphere_pdf(s.directions[1].z)]
    }

    /// Density of the second direction among all samples.
    #[inline(always)]
    fn density(
        s: &Sides<R>,
        facets: Option<&Facets<R>>,
        ThinShares(shares): &ThinShares<R::Primal>,
    ) -> R {
        let [of_facets, other] = Self::densities(s, facets);
        let of_pane = R::Primal::select(s.passes, shares[1], shares[0]);
        let of_rest = R::Primal::select(s.passes, shares[3], shares[2]);
        of_facets * Const(of_pane) + other * Const(of_rest)
    }
}

impl<P: Float, A> PrincipledThinLobe<P, A> {
    /// [`Lobe::eval_pdf`] where the facets of a pane, if there may be one, are known: without a branch, for loops over many.
    /// Of a part that some others have, there may be none: then its share is zero.
    #[inline(always)]
    pub(crate) fn eval_pdf_where(
        &self,
        shares: &ThinShares<P>,
        (sides, scatters): (&Sides<P>, bool),
        facets: Option<&Facets<P>>,
    ) -> (Rgb<P>, P) {
        let (back, through) = (
            self.reflected(sides, facets),
            self.transmitted(sides, facets),
        );
        let value = Rgb::select(sides.passes, through, back);
        let pdf = Self::density(sides, facets, shares);
        (
            Rgb::select(scatters, value, Rgb::black()),
            P::select(scatters, pdf, P::zero()),
        )
    }
}

impl<R: Real, A: Alpha<Scalar = R>> PrincipledThinLobe<R, A> {
    #[inline]
    fn shares(&self) -> ThinShares<R> {
        ThinShares::of(self.pane.map(|p| p.share), self.diff_trans)
    }

    #[inline]
    pub(crate) fn primal_shares(&self) -> ThinShares<R::Primal> {
        let pane = self.pane.map(|p| p.share.primal());
        ThinShares::of(pane, self.diff_trans.map(Real::primal))
    }

    /// Facets of the side on which the second direction is.
    #[inline]
    fn facets(&self, s: &Sides<R>) -> Option<Facets<R>> {
        let surface = self.pane.as_ref()?.surface(s.passes);
        Some(Facets::at(surface, s.m, s.directions))
    }

    /// What is seen of the second direction.
    #[inline]
    fn value(&self, s: &Sides<R>, facets: Option<&Facets<R>>) -> Rgb<R> {
        if s.passes {
            self.transmitted(s, facets)
        } else {
            self.reflected(s, facets)
        }
    }

    #[inline]
    fn direction(&self, wo: Vec3<R>, u: [R::Primal; 3]) -> Option<Vec3<R>> {
        let part = self.primal_shares().choose(u[0]);
        let on_side = match &self.pane {
            Some(pane) if part.of_facets => {
                let seen = above(wo);
                reflect(seen, pane.surface(part.passes).sample(seen, [u[1], u[2]]))
            }
            _ => Vec3::lift(warp::square_to_cosine_hemisphere([u[1], u[2]])),
        };
        let (wi, goes) = part.turned(wo, on_side);
        goes.then_some(wi)
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
            Some(s) => Self::density(&s, self.facets(&s).as_ref(), &self.primal_shares()),
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
            Self::density(&s, facets.as_ref(), &self.primal_shares()),
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
        let ThinShares(shares) = self.shares();
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
