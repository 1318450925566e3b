//! Thin sheets of glass, such as windows: light is reflected, or goes straight on.

use ad_core::{Real, Vec3};

use super::dielectric::{INDEX_RANGE, relative_index};
use super::{
    BsdfSample, Component, DeltaKind, Leaf, Lobe, Passage, Reader, Scattered, TransportMode,
    fresnel,
};
use crate::error::SceneError;
use crate::math::Rgb;
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::{RgbTexture, ScalarTexture};

/// A sheet of a dielectric between two parallel interfaces, too thin to shift what passes.
#[derive(Clone, Debug)]
pub struct ThinDielectric {
    /// Index of refraction of the sheet over that around it.
    pub eta: ScalarTexture,
    /// Factor on the reflectance, in [0, 1]; 1 is physical.
    pub specular_reflectance: RgbTexture,
    /// Factor on the transmittance, in [0, 1]; 1 is physical.
    pub specular_transmittance: RgbTexture,
}

/// Reflection by both interfaces and all that goes to and fro between them: of the reflectance `r` of one,
/// `2 r / (1 + r)`, as Mitsuba's `thindielectric`.
///
/// # Derivatives
/// In the index, too: no direction depends on it.
#[derive(Clone, Copy, Debug)]
pub struct ThinDielectricLobe<R> {
    /// Index inside over that outside.
    pub eta: R,
    /// Factor on the reflectance.
    pub specular_reflectance: Rgb<R>,
    /// Factor on the transmittance.
    pub specular_transmittance: Rgb<R>,
}

impl<R: Real> ThinDielectricLobe<R> {
    /// What becomes of light, chosen by the (primal) shares: without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn pass(&self, wo: Vec3<R>, u: R::Primal) -> Passage<R> {
        let zero = R::Primal::zero();
        let [reflect, pass] = self.shares(wo);
        let reflects = u < reflect.primal();
        let pdf = R::Primal::select(reflects, reflect.primal(), pass.primal());
        Passage {
            reflects,
            wi: Vec3::new(-wo.x, -wo.y, R::select(reflects, wo.z, -wo.z)),
            value: Rgb::select(
                reflects,
                self.specular_reflectance * reflect,
                self.specular_transmittance * pass,
            ),
            pdf: R::Primal::select(wo.z.primal() != zero, pdf, zero),
            eta: R::Primal::one(),
        }
    }

    /// The share of light that does not pass, on average over the channels.
    pub(super) fn opacity(&self, wo: Vec3<R>) -> R {
        let [_, passes] = self.shares(wo);
        R::one() - passes * self.specular_transmittance.mean()
    }

    /// The reflected share of light, and that which passes.
    #[inline(always)]
    fn shares(&self, wo: Vec3<R>) -> [R; 2] {
        let f = fresnel::dielectric(wo.z.abs(), self.eta);
        let inverse = (f.reflect + R::c(1.0)).recip();
        [f.reflect * inverse * R::c(2.0), f.transmit * inverse]
    }
}

impl Leaf for ThinDielectric {
    type Lobe<R: Real> = ThinDielectricLobe<R>;
    const DELTA: bool = true;

    fn transmits(&self) -> bool {
        true
    }

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> ThinDielectricLobe<R> {
        ThinDielectricLobe {
            eta: read.scalar(&self.eta),
            specular_reflectance: read.rgb(&self.specular_reflectance),
            specular_transmittance: read.rgb(&self.specular_transmittance),
        }
    }
}

impl<R: Real> Lobe<R> for ThinDielectricLobe<R> {
    #[inline]
    fn eval(&self, _wo: Vec3<R>, _wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
        Rgb::black()
    }

    #[inline]
    fn pdf(&self, _wo: Vec3<R>, _wi: Vec3<R>, _mode: TransportMode) -> R {
        R::zero()
    }

    /// Chooses by the (primal) shares.
    #[inline]
    fn sample(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        _mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        self.pass(wo, u[0]).sample()
    }

    #[inline]
    fn sample_eval(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        _mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        let passage = self.pass(wo, u[0]);
        Some((passage.sample()?, passage.value))
    }

    #[inline]
    fn eval_delta(&self, wo: Vec3<R>, kind: DeltaKind, _mode: TransportMode) -> Rgb<R> {
        if wo.z.primal() == R::Primal::zero() {
            return Rgb::black();
        }
        let [reflect, pass] = self.shares(wo);
        match kind {
            DeltaKind::Reflection => self.specular_reflectance * reflect,
            DeltaKind::Transmission => self.specular_transmittance * pass,
            DeltaKind::Passthrough => Rgb::black(),
        }
    }

    #[inline]
    fn choice_pdf(
        &self,
        wo: Vec3<R>,
        _wi: Vec3<R>,
        component: Component,
        _mode: TransportMode,
    ) -> R {
        let [reflect, pass] = self.shares(wo);
        match component {
            Component::Delta {
                kind: DeltaKind::Reflection,
                ..
            } => reflect,
            Component::Delta { .. } => pass,
            Component::Continuous => R::zero(),
        }
    }
}

impl FromNode for ThinDielectric {
    const PLUGINS: &'static [&'static str] = &["thindielectric"];

    /// `int_ior` (`bk7`) and `ext_ior` (`air`), numbers or names; `specular_reflectance` (1) and
    /// `specular_transmittance` (1).
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let eta = relative_index(node, "bk7")?;
        let name = format!("{}.eta.value", registry.prefix());
        let eta = registry.scalar(&name, eta, INDEX_RANGE)?;
        eta.visit_params(&mut |p| registry.origins.of_index(node, p));
        let mut factor = |key| registry.rgb_texture(node, key, [1.0; 3], (0.0, 1.0));
        Ok(Self {
            eta,
            specular_reflectance: factor("specular_reflectance")?,
            specular_transmittance: factor("specular_transmittance")?,
        })
    }
}
