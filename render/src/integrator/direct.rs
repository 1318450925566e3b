//! Direct light found by scattering, when the sampled direction is differentiated and the rest of the
//! path is not: attached and reparameterised samples, and MIS weights that are differentiated.
//!
//! The path is traced with primal numbers. Where it finds light, the last edge is evaluated once more
//! over the full scalar: the direction is sampled again from the same random numbers, now moving with the
//! parameters, and followed to the surface that is known to be hit. Forward mode does this as it
//! goes, reverse mode for the recorded edges; edges that find no light cost nothing. Samples of emitters that
//! move ([`aimed_light`]) are treated alike.

use ad_core::{Const, Float, Real, Vec2, Vec3};

use super::boundary::Freeze;
use super::path::{MODE, frozen_pdf};
use crate::accel::Hit;
use crate::bsdf::{Bsdf, BsdfSample, Component, Material, Part, Shading};
use crate::emitter::{Emission, Emitter, Moved};
use crate::estimator::{Direct, Sampling, Strategy};
use crate::math::{Frame, Rgb};
use crate::params::Theta;
use crate::scene::{Intersection, Scene};
use crate::shape::SurfaceInteraction;

/// A vertex that a scattered direction left: all that is needed to sample it again.
#[derive(Clone, Copy, Debug)]
pub struct Departure<P> {
    /// Index of the shape.
    pub shape: u32,
    /// Where on it.
    pub si: SurfaceInteraction<P>,
    /// Direction the path came from, local frame.
    pub wo: Vec3<P>,
    /// Random numbers that the direction was made of.
    pub u: [P; 3],
    /// One over the probability that roulette let the path live.
    pub survival: P,
    /// What of the BSDF is differentiated.
    pub part: Part,
    /// How much slower it moves.
    pub freeze: Freeze<P>,
}

/// Whether a strategy differentiates the light that an edge finds by itself.
pub const fn follows_edges<S: Strategy>() -> bool {
    let moves = !matches!(S::Bsdf::DIRECT, Direct::AsPath);
    moves || (S::Bsdf::DETACHED_PATH && S::DIFFERENTIATED_WEIGHTS)
}

/// Light found at the end of an edge that left `from`.
#[derive(Clone, Copy, Debug)]
pub struct FoundLight<P> {
    /// The vertex it left.
    pub from: Departure<P>,
    /// Index of the primitive it hit, and how far away; `None` for an infinite emitter.
    pub end: Option<(u32, P)>,
    /// Index of the emitter.
    pub emitter: u32,
    /// Its share of the samples of emitters, see [`crate::scene::LightChoice::share`].
    pub share: P,
}

/// How a strategy weighs its techniques, as values: what is called seldom is then compiled once per scalar
/// instead of once per strategy.
#[derive(Clone, Copy, Debug)]
pub struct Weighing<R> {
    /// [`Strategy::weight_hit`]; `None` where nothing else finds that light.
    hit: Option<fn(R, R) -> R>,
    /// [`Strategy::weight_sampled`]; likewise.
    sampled: Option<fn(R, R) -> R>,
    /// [`Strategy::FROZEN_WEIGHTS`].
    frozen: bool,
}

impl<R: Real> Weighing<R> {
    /// That of `S`.
    pub fn of<S: Strategy>() -> Self {
        Self {
            hit: S::SAMPLES_EMITTERS.then_some(S::weight_hit),
            sampled: S::COUNTS_HITS.then_some(S::weight_sampled),
            frozen: S::FROZEN_WEIGHTS,
        }
    }
}

/// `f w L_e / p` of that edge: what it adds to the radiance leaving `from`, MIS weight included.
///
/// # Derivatives
/// First derivatives in all parameters, through the sampled direction.
///
/// # Reference
/// [Zeltner 2021, Eqs. 4.31, 4.53, 4.54], with the sign of errata Z-4.54:
/// `d|J| = -(1 - B) d ln p - grad B . d omega`.
#[inline(never)]
pub fn direct_light<R: Real>(
    scene: &Scene,
    theta: &Theta<R>,
    found: &FoundLight<R::Primal>,
    weighing: &Weighing<R>,
) -> Rgb<R> {
    let from = &found.from;
    let info = scene.shape_info(from.shape);
    let material = scene.material(from.shape);
    let at = Shading {
        theta: *theta,
        uv: Vec2::lift(from.si.uv),
    };
    let wo = Vec3::lift(from.wo);
    let Some(sample) = material.sample::<R>(&at, wo, from.u, MODE) else {
        return Rgb::black();
    };
    let (wi, weight) = slow_down(&sample, &from.freeze);
    // The density is for the weight, and shares most of its work with the value.
    let (mut f, pdf) = match (sample.component, weighing.hit) {
        (Component::Continuous, Some(_)) => material.eval_pdf(&at, wo, wi, MODE),
        (component, _) => {
            let f = material.eval_component(&at, wo, wi, component, MODE);
            (f, R::zero())
        }
    };
    if from.part == Part::Rest {
        f = f - material.eval_normals(&at, from.wo, wi.primal(), MODE);
    }

    let si: SurfaceInteraction<R> = from.si.lift();
    let d = si.frame.to_world(wi);
    let end = found.end.map(|(prim, t)| {
        // Over a scalar with tangents, the place on the primitive is computed anew.
        let (t, u, v) = (t.to_f32(), 0.0, 0.0);
        let hit = Hit { t, u, v, prim };
        let Intersection { si, .. } = scene.interaction(&si.spawn_ray(d, info.offset), &hit);
        si
    });
    let e = &scene.emitters()[found.emitter as usize];
    let Some(emission) = e.hit(d, end.as_ref()) else {
        return Rgb::black();
    };
    let emission: Emission<R> = emission;
    let le = e.eval(theta, &emission);
    let mis = match (sample.component, weighing.hit) {
        (Component::Continuous, Some(weight)) => {
            let pdf = match weighing.frozen {
                true => frozen_pdf(material, &at, wo, wi),
                false => pdf,
            };
            let emitter_pdf = e.pdf(scene.lights(), si.p, d, end.as_ref());
            weight(pdf, emitter_pdf * Const(found.share))
        }
        _ => R::one(),
    };
    f * le * (weight * mis * Const(from.survival))
}

/// The direction that moves with `1 - B` of the velocity of `sample`, and one over its density with the
/// Jacobian of that change.
#[inline]
fn slow_down<R: Real>(sample: &BsdfSample<R>, freeze: &Freeze<R::Primal>) -> (Vec3<R>, R) {
    let pdf = Const(sample.pdf.primal());
    if matches!(sample.component, Component::Delta { .. }) {
        return (sample.wi, sample.pdf.recip());
    }
    let free = Const(R::Primal::one() - freeze.b);
    let wi = Vec3::lift(sample.wi.primal());
    let motion = sample.wi - wi;
    let relative = (sample.pdf - pdf) / pdf;
    let jacobian = -(relative * free) - motion.dot(Vec3::lift(freeze.gradient)) + R::c(1.0);
    (wi + motion * free, jacobian / pdf)
}

/// A sample of an emitter that moves: all that is needed to make it again.
#[derive(Clone, Copy, Debug)]
pub struct Aimed<P> {
    /// Random numbers that the direction was made of.
    pub u: [P; 2],
    /// The surface's frame, world space.
    pub frame: Frame<P>,
    /// The emitter's share, see [`crate::scene::LightChoice::share`].
    pub share: P,
    /// One over the probability that it was kept, see [`crate::scene::LightChoice::All`].
    pub kept: P,
}

/// `f w L_e / p` of a sampled emitter whose direction and density move: what it adds to the radiance that
/// leaves the surface towards `wo`, if it is visible.
///
/// # Derivatives
/// In the parameters of the material and of the emitter, and through the direction. In the weights, those of
/// the emitter are constants.
///
/// # Reference
/// [Zeltner 2021, section 4.2.2, Eq. 4.31].
#[inline(never)]
pub fn aimed_light<R: Real>(
    scene: &Scene,
    material: &Material,
    at: &Shading<R>,
    wo: Vec3<R>,
    aimed: &Aimed<R::Primal>,
    emitter: u32,
    light: &Moved<R>,
    weighing: &Weighing<R>,
) -> Rgb<R> {
    let wi = Frame::lift(aimed.frame).to_local(light.d);
    let (f, pdf) = material.eval_pdf(at, wo, wi, MODE);
    let le = scene.emitters()[emitter as usize].eval(&at.theta, &light.emission);
    let share = Const(aimed.share);
    let mis = weighing.sampled.map_or(R::one(), |weight| {
        let pdf = match weighing.frozen {
            true => frozen_pdf(material, at, wo, wi),
            false => pdf,
        };
        weight(light.frozen_pdf * share, pdf)
    });
    f * le * (mis / (light.pdf * share) * Const(aimed.kept))
}
