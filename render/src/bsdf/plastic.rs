//! Smooth plastic: a diffuse base under a smooth dielectric coat.

use std::f64::consts::FRAC_1_PI;

use ad_core::{Const, Real, Vec3};

use super::dielectric::{INDEX_RANGE, relative_index, wrong_index};
use super::{
    BsdfSample, Component, DeltaKind, Leaf, Lobe, Reader, TransportMode, coat, constant, fresnel,
};
use crate::error::SceneError;
use crate::math::{Rgb, both, warp};
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::{RgbTexture, ScalarTexture};

/// Colours and index of a coated diffuse surface.
#[derive(Clone, Debug)]
pub struct Coated {
    /// Albedo of the base, in [0, 1].
    pub diffuse_reflectance: RgbTexture,
    /// Factor on the reflection of the coat, in [0, 1]; 1 is physical.
    pub specular_reflectance: RgbTexture,
    /// Index of the coat over that above it.
    pub eta: ScalarTexture,
    /// The number that `eta` begins with. What passes the coat is known there; elsewhere it is interpolated.
    pub first_eta: f32,
    /// Whether the base's colour is saturated by light that the coat sends back to it.
    pub nonlinear: bool,
}

impl Coated {
    /// `diffuse_reflectance` (0.5), `specular_reflectance` (1), `int_ior` (`polypropylene`), `ext_ior`
    /// (`air`), `nonlinear` (false). A rough coat is denser than what is above it: where total reflection begins, a
    /// [`Coat`](super::Coat) is not exact.
    ///
    /// # Errors
    /// Anything out of range.
    pub fn from_node(
        node: &Node,
        registry: &mut Registry,
        rough: bool,
    ) -> Result<Self, SceneError> {
        let index = relative_index(node, "polypropylene")?;
        let (thinnest, densest) = INDEX_RANGE;
        let valid = (if rough { 1.0 } else { thinnest }, densest);
        if index < valid.0 {
            let expected = "a rough coat denser than what is above it (a smooth one, `plastic`, may be either)";
            return Err(wrong_index(node, expected));
        }
        let name = format!("{}.eta.value", registry.prefix());
        let eta = registry.scalar(&name, index, valid)?;
        eta.visit_params(&mut |p| registry.origins.of_index(node, p));
        Ok(Self {
            diffuse_reflectance: registry.rgb_texture(
                node,
                "diffuse_reflectance",
                [0.5; 3],
                (0.0, 1.0),
            )?,
            specular_reflectance: registry.rgb_texture(
                node,
                "specular_reflectance",
                [1.0; 3],
                (0.0, 1.0),
            )?,
            eta,
            first_eta: index as f32,
            nonlinear: node.boolean_or("nonlinear", false)?,
        })
    }
}

/// [`Coated`] at a point.
#[derive(Clone, Copy, Debug)]
pub struct CoatedLobe<R: Real> {
    /// Albedo of the base.
    pub diffuse_reflectance: Rgb<R>,
    /// Factor on the reflection of the coat.
    pub specular_reflectance: Rgb<R>,
    /// Index of the coat over that above it.
    pub eta: R,
    /// See [`Coated::nonlinear`].
    pub nonlinear: bool,
}

impl<R: Real> CoatedLobe<R> {
    #[inline]
    pub(super) fn read(coated: &Coated, read: &mut impl Reader<R>) -> Self {
        Self {
            diffuse_reflectance: read.rgb(&coated.diffuse_reflectance),
            specular_reflectance: read.rgb(&coated.specular_reflectance),
            eta: read.scalar(&coated.eta),
            nonlinear: coated.nonlinear,
        }
    }

    /// Whether the index has tangents. Where it has none, the compiler is to know.
    #[inline(always)]
    pub(super) fn index_moves(&self) -> bool {
        !R::IS_PRIMAL && self.eta.has_tangent()
    }

    /// The coat, met at this cosine.
    #[inline(always)]
    pub(super) fn coat(&self, cos: R) -> fresnel::Dielectric<R> {
        if self.index_moves() {
            fresnel::dielectric(cos, self.eta)
        } else {
            fresnel::dielectric(cos, R::lift(self.eta.primal()))
        }
    }

    /// Light that enters (fraction `t_i`), is scattered by the base, and leaves (`t_o`), cosine
    /// included; `inside` is what the coat reflects back of diffuse light from below.
    #[inline(always)]
    pub(super) fn diffuse(&self, cos_i: R, t_i: R, t_o: R, inside: R) -> Rgb<R> {
        let passes = cos_i * t_i * t_o;
        let entering = if self.index_moves() {
            passes * self.eta.square().recip()
        } else {
            let eta = self.eta.primal();
            passes * Const(R::Primal::one() / (eta * eta))
        } * R::c(FRAC_1_PI);
        self.diffuse_reflectance.map(|albedo| {
            let again = R::select(self.nonlinear, albedo * inside, inside);
            albedo * entering / (R::one() - again)
        })
    }

    /// Probability of sampling the coat where it reflects the fraction `f`. Never quite 0 or 1: a
    /// black base still has a derivative with respect to its colour.
    #[inline(always)]
    pub(super) fn choose_coat(&self, f: R::Primal) -> R::Primal {
        let colours = [self.specular_reflectance, self.diffuse_reflectance];
        choice(f, both(colours, |c| c.primal()))
    }

    /// [`CoatedLobe::choose_coat`] with the tangents of the colours and of `f`, for [`Lobe::choice_pdf`].
    #[inline]
    pub(super) fn attached_choice(&self, f: R) -> R {
        choice(f, [self.specular_reflectance, self.diffuse_reflectance])
    }
}

#[inline(always)]
fn choice<R: Real>(f: R, [specular, diffuse]: [Rgb<R>; 2]) -> R {
    let (one, floor) = (R::one(), R::of(0.05));
    let coat = f * specular.mean();
    let base = (one - f) * diffuse.mean();
    let sum = coat + base;
    let share = floor + coat / sum * (one - floor - floor);
    R::select(sum.primal() > R::Primal::zero(), share, R::of(0.5))
}

/// A diffuse surface under a smooth coat.
#[derive(Clone, Debug)]
pub struct Plastic {
    /// Colours and index.
    pub coated: Coated,
    /// Reflectance of the coat for diffuse light from below, for the index that it begins with.
    first_inside: f64,
}

/// Mirror reflection by the coat, and what comes back from below it: the model of Mitsuba's
/// `plastic`.
///
/// Nothing is lost by a white base with [`Coated::nonlinear`]: of diffuse light from above the coat lets through the fraction
/// `eta^2 (1 - inside)`, whichever side is denser. Where that above is, light that grazes the coat does not get in.
#[derive(Clone, Copy, Debug)]
pub struct PlasticLobe<R: Real> {
    /// Colours and index.
    pub coated: CoatedLobe<R>,
    /// Reflectance of the coat for diffuse light from below.
    pub inside: R,
}

impl Plastic {
    /// From its colours and index.
    pub fn new(coated: Coated) -> Self {
        let first_inside = coat::diffuse_below(f64::from(coated.first_eta));
        Self {
            coated,
            first_inside,
        }
    }

    /// Reflectance of a coat of index `eta` for diffuse light from below: the same number over any scalar.
    #[inline]
    fn inside<R: Real>(&self, eta: R) -> R {
        let known = R::Primal::of(self.first_inside);
        let first = eta.primal() == R::Primal::of(self.coated.first_eta.into());
        if first && (R::IS_PRIMAL || !eta.has_tangent()) {
            return R::lift(known);
        }
        let inside = coat::diffuse_below(eta);
        if first {
            inside + Const(known - inside.primal())
        } else {
            inside
        }
    }
}

impl Leaf for Plastic {
    type Lobe<R: Real> = PlasticLobe<R>;

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> PlasticLobe<R> {
        let coated = CoatedLobe::read(&self.coated, read);
        let inside = self.inside(coated.eta);
        PlasticLobe { coated, inside }
    }
}

impl<R: Real> PlasticLobe<R> {
    #[inline(always)]
    fn coat(&self, w: Vec3<R>) -> fresnel::Dielectric<R> {
        self.coated.coat(w.z)
    }

    #[inline(always)]
    fn base(&self, cos_i: R, t_i: R, t_o: R) -> Rgb<R> {
        let inside = if self.coated.index_moves() {
            self.inside
        } else {
            R::lift(self.inside.primal())
        };
        self.coated.diffuse(cos_i, t_i, t_o, inside)
    }

    #[inline(always)]
    fn choose_coat(&self, wo: Vec3<R>) -> R::Primal {
        self.coated.choose_coat(self.coat(wo).reflect.primal())
    }

    /// [`Lobe::eval_pdf`] without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn eval_pdf_in_line(&self, wo: Vec3<R>, wi: Vec3<R>) -> (Rgb<R>, R) {
        let (coat_o, coat_i) = (self.coat(wo), self.coat(wi));
        let base = R::Primal::one() - self.coated.choose_coat(coat_o.reflect.primal());
        let pdf = warp::cosine_hemisphere_pdf(wi.z) * Const(base);
        let f = self.base(wi.z, coat_i.transmit, coat_o.transmit);
        let lit = above(wo) & above(wi);
        let f = Rgb::select(lit, f, Rgb::black());
        (f, R::select(above(wo), pdf, R::zero()))
    }

    /// Direction and probability of the coat's reflection, or a direction from the base and zero; and the weight of that
    /// reflection: from above the surface, without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn choose(&self, wo: Vec3<R>, u: [R::Primal; 3]) -> (Vec3<R>, R::Primal, Rgb<R>) {
        let reflect = self.coat(wo).reflect;
        let coat = self.coated.choose_coat(reflect.primal());
        let reflects = u[0] < coat;
        let base = warp::square_to_cosine_hemisphere([u[1], u[2]]);
        let mirrored = Vec3::new(-wo.x, -wo.y, wo.z);
        let wi = Vec3::select(reflects, mirrored, Vec3::lift(base));
        let probability = R::Primal::select(reflects, coat, R::Primal::zero());
        (wi, probability, self.coated.specular_reflectance * reflect)
    }
}

#[inline(always)]
fn above<R: Real>(w: Vec3<R>) -> bool {
    w.z.primal() > R::Primal::zero()
}

impl<R: Real> Lobe<R> for PlasticLobe<R> {
    #[inline]
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
        if !(above(wo) && above(wi)) {
            return Rgb::black();
        }
        let (t_i, t_o) = (self.coat(wi).transmit, self.coat(wo).transmit);
        self.base(wi.z, t_i, t_o)
    }

    #[inline]
    fn eval_pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> (Rgb<R>, R) {
        self.eval_pdf_in_line(wo, wi)
    }

    #[inline]
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> R {
        if !above(wo) {
            return R::zero();
        }
        let base = R::Primal::one() - self.choose_coat(wo);
        warp::cosine_hemisphere_pdf(wi.z) * Const(base)
    }

    /// Chooses coat or base by the (primal) light they send on.
    #[inline]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        if !above(wo) {
            return None;
        }
        let (wi, coat, _) = self.choose(wo, u);
        if coat > R::Primal::zero() {
            return Some(BsdfSample {
                wi,
                pdf: R::lift(coat),
                component: Component::Delta {
                    kind: DeltaKind::Reflection,
                    route: 0,
                },
                eta: R::Primal::one(),
            });
        }
        BsdfSample::reflected(wi, self.pdf(wo, wi, mode))
    }

    #[inline]
    fn eval_delta(&self, wo: Vec3<R>, kind: DeltaKind, _mode: TransportMode) -> Rgb<R> {
        if kind == DeltaKind::Reflection && above(wo) {
            self.coated.specular_reflectance * self.coat(wo).reflect
        } else {
            Rgb::black()
        }
    }

    #[inline]
    fn choice_pdf(
        &self,
        wo: Vec3<R>,
        wi: Vec3<R>,
        component: Component,
        _mode: TransportMode,
    ) -> R {
        if !above(wo) {
            return R::zero();
        }
        let coat = self.coated.attached_choice(self.coat(wo).reflect);
        match component {
            Component::Continuous => {
                constant(warp::cosine_hemisphere_pdf(wi.z)) * (R::one() - coat)
            }
            Component::Delta { .. } => coat,
        }
    }
}

impl FromNode for Plastic {
    const PLUGINS: &'static [&'static str] = &["plastic"];

    /// As [`Coated::from_node`].
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        Coated::from_node(node, registry, false).map(Self::new)
    }
}
