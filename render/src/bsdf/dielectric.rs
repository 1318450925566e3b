//! Smooth dielectrics: glass and water, reflecting and refracting.

use ad_core::{Const, Real, Vec3};

use super::{
    BsdfSample, Component, DeltaKind, Leaf, Lobe, Passage, Reader, Scattered, TransportMode,
    fresnel,
};
use crate::error::SceneError;
use crate::math::Rgb;
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::{RgbTexture, ScalarTexture};

/// A smooth interface between two dielectrics.
#[derive(Clone, Debug)]
pub struct Dielectric {
    /// Index of refraction below the surface over that above.
    pub eta: ScalarTexture,
    /// Factor on the reflectance, in [0, 1]; 1 is physical.
    pub specular_reflectance: RgbTexture,
    /// Factor on the transmittance, in [0, 1]; 1 is physical.
    pub specular_transmittance: RgbTexture,
}

/// Fresnel-weighted mirror reflection and refraction [Zeltner 2021, Eqs. 2.28 to 2.30, corrected].
#[derive(Clone, Copy, Debug)]
pub struct DielectricLobe<R> {
    /// Index below over index above.
    pub eta: R,
    /// Factor on the reflectance.
    pub specular_reflectance: Rgb<R>,
    /// Factor on the transmittance.
    pub specular_transmittance: Rgb<R>,
}

impl Leaf for Dielectric {
    type Lobe<R: Real> = DielectricLobe<R>;
    const DELTA: bool = true;

    fn transmits(&self) -> bool {
        true
    }

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> DielectricLobe<R> {
        DielectricLobe {
            eta: read.scalar(&self.eta),
            specular_reflectance: read.rgb(&self.specular_reflectance),
            specular_transmittance: read.rgb(&self.specular_transmittance),
        }
    }
}

/// Index on the side that `w` does not point to over that on the side it does.
#[inline(always)]
pub(super) fn eta_across<R: Real>(eta: R, w: Vec3<R>) -> R {
    R::select(w.z.primal() > R::Primal::zero(), eta, eta.recip())
}

impl<R: Real> DielectricLobe<R> {
    /// What becomes of light, chosen by the (primal) reflectance of the interface: without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn pass(&self, wo: Vec3<R>, u: R::Primal, mode: TransportMode) -> Passage<R> {
        let (zero, one) = (R::Primal::zero(), R::Primal::one());
        let eta = eta_across(self.eta, wo);
        let f = fresnel::dielectric(wo.z.abs(), eta);
        let reflects = u < f.reflect.primal();
        let inverse = eta.recip();
        let side = R::Primal::select(wo.z.primal() < zero, -one, one);
        let refracted = Vec3::new(
            -(wo.x * inverse),
            -(wo.y * inverse),
            -(f.cos_t * Const(side)),
        );
        let wi = Vec3::select(reflects, Vec3::new(-wo.x, -wo.y, wo.z), refracted);
        let pdf = R::Primal::select(reflects, f.reflect.primal(), f.transmit.primal());
        let goes = (wo.z.primal() != zero) & (wi.z.primal() != zero);
        let reflected = self.specular_reflectance * f.reflect;
        let refracted = self.specular_transmittance * self.refracted(&f, eta, mode);
        Passage {
            reflects,
            wi,
            value: Rgb::select(reflects, reflected, refracted),
            pdf: R::Primal::select(goes, pdf, zero),
            eta: R::Primal::select(reflects, one, eta.primal()),
        }
    }

    /// The weight of what is refracted into an index that is `eta` times as large.
    #[inline(always)]
    fn refracted(&self, f: &fresnel::Dielectric<R>, eta: R, mode: TransportMode) -> R {
        match mode {
            TransportMode::Importance => f.transmit,
            TransportMode::Radiance => f.transmit / eta.square(),
        }
    }
}

impl<R: Real> Lobe<R> for DielectricLobe<R> {
    #[inline]
    fn eval(&self, _wo: Vec3<R>, _wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
        Rgb::black()
    }

    #[inline]
    fn pdf(&self, _wo: Vec3<R>, _wi: Vec3<R>, _mode: TransportMode) -> R {
        R::zero()
    }

    /// Chooses by the (primal) reflectance of the interface.
    #[inline]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        self.pass(wo, u[0], mode).sample()
    }

    #[inline]
    fn sample_eval(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        let passage = self.pass(wo, u[0], mode);
        Some((passage.sample()?, passage.value))
    }

    #[inline]
    fn eval_delta(&self, wo: Vec3<R>, kind: DeltaKind, mode: TransportMode) -> Rgb<R> {
        if wo.z.primal() == R::Primal::zero() {
            return Rgb::black();
        }
        let eta = eta_across(self.eta, wo);
        let f = fresnel::dielectric(wo.z.abs(), eta);
        match kind {
            DeltaKind::Reflection => self.specular_reflectance * f.reflect,
            DeltaKind::Transmission => self.specular_transmittance * self.refracted(&f, eta, mode),
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
        let f = fresnel::dielectric(wo.z.abs(), eta_across(self.eta, wo));
        match component {
            Component::Delta {
                kind: DeltaKind::Reflection,
                ..
            } => f.reflect,
            Component::Delta { .. } => f.transmit,
            Component::Continuous => R::zero(),
        }
    }
}

impl FromNode for Dielectric {
    const PLUGINS: &'static [&'static str] = &["dielectric"];

    /// `int_ior` (`bk7`) and `ext_ior` (`air`), numbers or names; `specular_reflectance` (1) and
    /// `specular_transmittance` (1).
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let eta = relative_index(node, "bk7")?;
        let name = format!("{}.eta.value", registry.prefix());
        let eta = registry.scalar(&name, eta, INDEX_RANGE)?;
        eta.visit_params(&mut |p| registry.origins.of_index(node, p));
        Ok(Self {
            eta,
            specular_reflectance: registry.rgb_texture(
                node,
                "specular_reflectance",
                [1.0; 3],
                (0.0, 1.0),
            )?,
            specular_transmittance: registry.rgb_texture(
                node,
                "specular_transmittance",
                [1.0; 3],
                (0.0, 1.0),
            )?,
        })
    }
}

/// Valid relative indices of refraction.
pub(super) const INDEX_RANGE: (f64, f64) = (0.1, 10.0);

/// An index of refraction of a scene file, a number or a name; `absent` by name, if there is none.
pub(super) fn index(node: &Node, key: &str, absent: &str) -> Result<f64, SceneError> {
    // A word, if it is not a number.
    let value = match node.float(key) {
        Ok(Some(value)) => Some(value),
        _ => node.choice(key, INDICES)?,
    };
    let value = value.or_else(|| INDICES.iter().find(|(n, _)| *n == absent).map(|i| i.1));
    match value {
        Some(x) if x > 0.0 => Ok(x),
        _ => Err(node.invalid(key, "a positive index of refraction")),
    }
}

/// The error for an index inside that is wrong beside that outside: where one of both is given.
pub(super) fn wrong_index(node: &Node, expected: &str) -> SceneError {
    let outside = node.has("ext_ior") && !node.has("int_ior");
    node.invalid(if outside { "ext_ior" } else { "int_ior" }, expected)
}

/// `int_ior / ext_ior` of a scene file.
pub(super) fn relative_index(node: &Node, default_inside: &str) -> Result<f64, SceneError> {
    let eta = index(node, "int_ior", default_inside)? / index(node, "ext_ior", "air")?;
    let (lo, hi) = INDEX_RANGE;
    if (lo..=hi).contains(&eta) {
        return Ok(eta);
    }
    let expected = format!("an index inside between {lo} and {hi} times that outside");
    Err(wrong_index(node, &expected))
}

/// Indices of refraction by name.
const INDICES: &[(&str, f64)] = &[
    ("vacuum", 1.0),
    ("helium", 1.000_036),
    ("hydrogen", 1.000_132),
    ("air", 1.000_277),
    ("carbon dioxide", 1.000_45),
    ("water", 1.333),
    ("acetone", 1.36),
    ("ethanol", 1.361),
    ("carbon tetrachloride", 1.461),
    ("glycerol", 1.4729),
    ("benzene", 1.501),
    ("silicone oil", 1.520_45),
    ("bromine", 1.661),
    ("water ice", 1.31),
    ("fused quartz", 1.458),
    ("pyrex", 1.47),
    ("acrylic glass", 1.49),
    ("polypropylene", 1.49),
    ("bk7", 1.5046),
    ("sodium chloride", 1.544),
    ("amber", 1.55),
    ("pet", 1.575),
    ("diamond", 2.419),
];
