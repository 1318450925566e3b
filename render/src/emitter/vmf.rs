//! Environments with one smooth lobe.

use std::f64::consts::PI;

use ad_core::{Float, Real, Vec2, Vec3};

use super::point::constant_colour;
use super::{Emission, Emitter, EmitterSample, Lights, WIDE};
use crate::error::SceneError;
use crate::math::{Frame, gauss, warp};
use crate::motion::Placement;
use crate::params::{ParamRef, Params};
use crate::plugin::{FromNode, Node, Registry};
use crate::shape::{SurfaceInteraction, lift3};
use crate::texture::RgbTexture;

/// A distant light with the radiance `radiance exp(kappa (cos theta - 1))` at angle theta from its
/// direction: an unnormalised von Mises-Fisher density. Several of them add up.
#[derive(Clone, Debug)]
pub struct Vmf {
    /// Radiance in the middle of the lobe, W m^-2 sr^-1.
    pub radiance: RgbTexture,
    /// Unit direction towards the middle, world space.
    direction: [f32; 3],
    /// The same before it is turned, and how it is.
    direction_at_rest: [f32; 3],
    turned: Placement,
    kappa: f64,
    /// 1 - exp(-2 kappa)
    mass: f64,
}

/// Range of concentrations: below, it is a constant; above, f32 directions are too coarse.
const KAPPA: std::ops::RangeInclusive<f64> = 1e-3..=1e7;

impl Vmf {
    /// A lobe around `direction` (any length) with concentration `kappa`. `None` without a direction
    /// or if kappa is not in [1e-3, 1e7].
    pub fn new(radiance: RgbTexture, direction: [f64; 3], kappa: f64) -> Option<Self> {
        let direction = Vec3::from(direction).normalize();
        let usable = (direction.length() - 1.0).abs() < 0.5 && KAPPA.contains(&kappa);
        let single = direction.to_array().map(|x| x as f32);
        usable.then(|| Self {
            radiance,
            direction: single,
            direction_at_rest: single,
            turned: Placement::default(),
            kappa,
            mass: -(-2.0 * kappa).exp_m1(),
        })
    }

    /// exp(kappa (cos theta - 1))
    #[inline(always)]
    fn lobe<R: Real>(&self, d: Vec3<R>) -> R {
        // 1 - cos theta = |d - mean|^2 / 2, without cancellation.
        let off = d - lift3::<R>(self.direction);
        gauss::fading(off.length_squared() * R::c(0.5 * self.kappa))
    }

    /// What comes from the unit direction `d`, and the density of samples there: without a branch or a call, for loops over
    /// many.
    #[inline(always)]
    pub(crate) fn seen_in_line<P: Float>(&self, d: Vec3<P>) -> (Emission<P>, P) {
        let falloff = self.lobe(d);
        let uv = Vec2::zero();
        (
            Emission { uv, falloff },
            falloff * self.normalisation::<P>(),
        )
    }

    #[inline(always)]
    fn normalisation<P: Float>(&self) -> P {
        P::of(self.kappa / (2.0 * PI * self.mass))
    }
}

impl Emitter for Vmf {
    #[inline]
    fn radiance(&self) -> &RgbTexture {
        &self.radiance
    }

    #[inline]
    fn hit<R: Real>(&self, d: Vec3<R>, si: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        si.is_none().then(|| Emission {
            uv: Vec2::zero(),
            falloff: self.lobe(d),
        })
    }

    #[inline(always)]
    fn sample<P: Float>(&self, _: Lights, _: Vec3<P>, u: [P; 2]) -> Option<EmitterSample<P>> {
        // The inverse of the distribution of 1 - cos theta.
        let w = -gauss::ln_1p(u[0] * P::of(-self.mass)) / P::of(self.kappa);
        let w = w.min(P::of(2.0));
        let r = (w * (P::of(2.0) - w)).sqrt();
        let (sin, cos) = warp::sin_cos_of_turns(u[1]);
        let mean = Frame::from_normal(lift3::<P>(self.direction));
        let d = mean.to_world(Vec3::new(r * cos, r * sin, P::one() - w));
        let (emission, pdf) = self.seen_in_line(d);
        let distance = P::of(f64::INFINITY);
        Some(EmitterSample::without_surface(d, distance, pdf, emission))
    }

    #[inline]
    fn pdf<R: Real>(
        &self,
        _: Lights,
        _: Vec3<R>,
        d: Vec3<R>,
        si: Option<&SurfaceInteraction<R>>,
    ) -> R {
        match si {
            Some(_) => R::zero(),
            None => self.lobe(d) * R::lift(self.normalisation::<R::Primal>()),
        }
    }

    fn is_infinite(&self) -> bool {
        true
    }

    fn update(&mut self, params: &Params) {
        self.direction = self.turned.turn(params, self.direction_at_rest);
    }

    fn make_movable(&mut self, p: ParamRef) {
        self.turned.rotation = Some(p);
    }

    fn turned(&self) -> Option<&Placement> {
        Some(&self.turned)
    }

    fn is_wide(&self) -> bool {
        1.0 / self.kappa >= WIDE
    }
}

impl FromNode for Vmf {
    const PLUGINS: &'static [&'static str] = &["vmf"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let direction = node
            .vector("direction")?
            .ok_or_else(|| node.missing("direction", "a vector towards the light"))?;
        let kappa = node
            .float("kappa")?
            .ok_or_else(|| node.missing("kappa", "a concentration"))?;
        if !KAPPA.contains(&kappa) {
            return Err(node.invalid("kappa", "a number in [1e-3, 1e7]"));
        }
        let radiance = constant_colour(node, registry, "radiance")?;
        Self::new(radiance, direction, kappa)
            .ok_or_else(|| node.invalid("direction", "a non-zero vector"))
    }
}
