//! Direct light found by scattering, when the sampled direction is differentiated and the rest of the
//! path is not: attached and reparameterised samples, and MIS weights that are differentiated.
//!
//! The path is traced with primal numbers. Where it finds light, the last edge is evaluated once more
//! over the full scalar: the direction is sampled again from the same random numbers, now moving with the
//! parameters, and followed to the surface that is known to be hit. Single paths in forward mode do this as
//! they go, waves and reverse mode for the recorded edges; edges that find no light cost nothing. Samples of
//! emitters that move ([`moving_emitter_light`]) are treated alike.

use std::marker::PhantomData;

use ad_core::{Const, Float, Real, Vec2, Vec3};

use super::local::LocalFn;
use super::reparameterisation::{Freeze, freeze};
use super::vertex::MODE;
use super::vertex::light::frozen_pdf;
use crate::accel::Hit;
use crate::bsdf::{Bsdf, BsdfSample, Component, Material, Part, Shading};
use crate::emitter::{Emission, Emitter, Moved};
use crate::estimator::{Direct, Sampling, Strategy};
use crate::math::{Frame, Rgb};
use crate::params::Theta;
use crate::sampler::{Purpose, Sampler};
use crate::scene::Scene;
use crate::shape::{Exit, SurfaceInteraction};

/// How a sampled direction moves with the parameters that it was made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion<P> {
    /// Not at all: only the MIS weight of the light does.
    Still,
    /// As samples do.
    Free,
    /// Slower, near discontinuities.
    Slowed(Freeze<P>),
}

/// A vertex that a scattered direction left: all that is needed to sample it again.
#[derive(Clone, Copy, Debug)]
pub struct Departure<P> {
    /// Index of the material.
    pub material: u32,
    /// How rays leave the surface.
    pub exit: Exit,
    /// Where on it.
    pub si: SurfaceInteraction<P>,
    /// Direction the path came from, local frame.
    pub wo: Vec3<P>,
    /// Random numbers that the direction was made of.
    pub u: [P; 3],
    /// One over the probability that roulette let the path live.
    pub inverse_survival: P,
    /// What of the BSDF is differentiated.
    pub part: Part,
}

impl<P: Float> Departure<P> {
    /// How strategy `S` moves a direction that found light, `d`. `depth` is the number of edges so far.
    #[inline(always)]
    pub fn motion<S: Strategy, X: Sampler>(
        &self,
        scene: &Scene,
        d: Vec3<P>,
        depth: u32,
        sampler: &mut X,
    ) -> Motion<P> {
        match S::Bsdf::DIRECT {
            Direct::AsPath => Motion::Still,
            Direct::Attached => Motion::Free,
            Direct::Reparameterised { rays } => {
                sampler.seek(Purpose::AuxiliaryRays(rays as u32).at(depth));
                let start = self.si.spawn_ray(d, self.exit);
                let w = self.si.frame.to_local(d);
                Motion::Slowed(freeze(scene, &start, &self.si.frame, w, rays, sampler))
            }
        }
    }
}

/// An edge that found light.
#[derive(Clone, Copy, Debug)]
pub struct FoundEdge<P> {
    /// How its direction moves.
    pub motion: Motion<P>,
    /// Index of the primitive it hit, and how far away; `None` if it left the scene.
    pub end: Option<(u32, P)>,
}

/// Light at the end of an edge.
#[derive(Clone, Copy, Debug)]
pub struct FoundLight<P> {
    /// Index of the emitter.
    pub emitter: u32,
    /// Where on it.
    pub emission: Emission<P>,
    /// Its share of the samples of emitters, see [`crate::scene::LightChoice::share`].
    pub share: P,
}

/// What an edge found.
#[derive(Clone, Copy, Debug)]
pub struct Found<'a, P> {
    /// The vertex it left.
    pub from: &'a Departure<P>,
    /// The edge.
    pub edge: &'a FoundEdge<P>,
    /// Light at its end: several infinite emitters, perhaps.
    pub lights: &'a [FoundLight<P>],
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
    /// How strategy `S` weighs.
    pub fn of<S: Strategy>() -> Self {
        Self {
            hit: S::SAMPLES_EMITTERS.then_some(S::weight_hit),
            sampled: S::COUNTS_HITS.then_some(S::weight_sampled),
            frozen: S::FROZEN_WEIGHTS,
        }
    }
}

/// `f w L_e / p` of the edge that left `from` and found light: what it adds to the radiance leaving `from`, MIS weight included.
///
/// # Derivatives
/// First derivatives in the parameters `theta` of the material, through the sampled direction, and in those that
/// emitters read, `emission`.
///
/// # Reference
/// [Zeltner 2021, Eqs. 4.31, 4.53, 4.54], with the sign of errata Z-4.54:
/// `d|J| = -(1 - B) d ln p - grad B . d omega`.
#[inline(never)]
pub fn direct_light<R: Real>(
    scene: &Scene,
    theta: &Theta<R>,
    emission: &Theta<R>,
    &Found { from, edge, lights }: &Found<R::Primal>,
    weighing: &Weighing<R>,
) -> Rgb<R> {
    let material = &scene.materials()[from.material as usize];
    let at = Shading::new(*theta, Vec2::lift(from.si.uv));
    let Some(Moving { wi, weight, pdf }) =
        scattered_again(material, &at, from, &edge.motion, weighing)
    else {
        return Rgb::black();
    };

    let si: SurfaceInteraction<R> = from.si.lift();
    let d = si.frame.to_world(wi);
    let end = edge.end.map(|(prim, t)| {
        // Over a scalar with tangents, the place on the primitive is computed anew.
        let (t, u, v) = (t.to_f32(), 0.0, 0.0);
        let hit = Hit { t, u, v, prim };
        // What shapes do that move is another integral's.
        let ray = si.spawn_ray(d, from.exit);
        scene
            .interaction(&Theta::constant(theta.values()), &ray, &hit)
            .si
    });
    let mut light = Rgb::black();
    for found in lights {
        let e = &scene.emitters()[found.emitter as usize];
        let Some(place) = e.hit_again(d, end.as_ref(), &found.emission) else {
            continue;
        };
        let le = e.eval(emission, &place);
        light += match (pdf, weighing.hit) {
            (Some(pdf), Some(weight)) => {
                let emitter_pdf = e.pdf(scene.lights(), si.p, d, end.as_ref());
                le * weight(pdf, emitter_pdf * Const(found.share))
            }
            _ => le,
        };
    }
    weight * light.map(|x| x * Const(from.inverse_survival))
}

/// A sampled direction as it moves.
struct Moving<R> {
    /// Local frame.
    wi: Vec3<R>,
    /// Value of the BSDF over the density, as both change with the motion.
    weight: Rgb<R>,
    /// The density that MIS weights are made of; `None` along deltas, and where nothing is weighed.
    pdf: Option<R>,
}

/// The direction that left a vertex.
#[inline]
fn scattered_again<R: Real>(
    material: &Material,
    at: &Shading<R>,
    from: &Departure<R::Primal>,
    motion: &Motion<R::Primal>,
    weighing: &Weighing<R>,
) -> Option<Moving<R>> {
    let wo = Vec3::lift(from.wo);
    let weighed = weighing.hit.is_some();
    if *motion == Motion::Free && from.part == Part::All && !weighed {
        let (wi, weight) = material.sample_weight(at, wo, from.u, MODE)?;
        return Some(Moving {
            wi,
            weight,
            pdf: None,
        });
    }
    let (wi, per_density, component, known) = match motion {
        Motion::Free => {
            let (sample, f) = material.sample_eval::<R>(at, wo, from.u, MODE)?;
            let known = Some((f, sample.pdf));
            (sample.wi, sample.pdf.recip(), sample.component, known)
        }
        Motion::Slowed(freeze) => {
            let sample = material.sample::<R>(at, wo, from.u, MODE)?;
            let (wi, per_density) = slow_down(&sample, freeze);
            (wi, per_density, sample.component, None)
        }
        Motion::Still => {
            let sample = material.sample(&at.primal(), from.wo, from.u, MODE)?;
            let per_density = R::lift(sample.pdf.recip());
            (Vec3::lift(sample.wi), per_density, sample.component, None)
        }
    };
    let weighed = weighed && component == Component::Continuous;
    // The density shares most of its work with the value.
    let (mut f, pdf) = known.unwrap_or_else(|| {
        if weighed {
            material.eval_pdf(at, wo, wi, MODE)
        } else {
            (
                material.eval_component(at, wo, wi, component, MODE),
                R::zero(),
            )
        }
    });
    if from.part == Part::Rest {
        f = f - material.eval_normals(at, from.wo, wi.primal(), MODE);
    }
    let pdf = weighed.then(|| {
        if weighing.frozen {
            frozen_pdf(material, at, wo, wi)
        } else {
            pdf
        }
    });
    Some(Moving {
        wi,
        weight: f * per_density,
        pdf,
    })
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

/// A sampled light whose MIS weight is differentiated.
#[derive(Clone, Copy, Debug)]
pub struct Connected<P> {
    /// Direction to it, local frame of the vertex.
    pub wi: Vec3<P>,
    /// Emitted radiance.
    pub le: Rgb<P>,
    /// As [`super::record::SampledLight::mis_pdf`].
    pub mis_pdf: P,
    /// As [`super::record::SampledLight::kept`].
    pub kept: P,
    /// Whether the change of normals has samples of its own.
    pub splits: bool,
}

/// The light at a vertex that strategy `S` differentiates by itself: a function of the material there.
pub struct SeparateLight<'a, P, S> {
    scene: &'a Scene,
    material: &'a Material,
    uv: Vec2<P>,
    wo: Vec3<P>,
    connected: Option<Connected<P>>,
    found: Option<Found<'a, P>>,
    strategy: PhantomData<S>,
}

impl<'a, P: Float, S: Strategy> SeparateLight<'a, P, S> {
    /// Of the light that was sampled at a vertex, and of what was found at the end of the edge from there.
    pub fn at(
        scene: &'a Scene,
        (material, uv, wo): (u32, Vec2<P>, Vec3<P>),
        connected: Option<Connected<P>>,
        found: Option<Found<'a, P>>,
    ) -> Self {
        Self {
            scene,
            material: &scene.materials()[material as usize],
            uv,
            wo,
            connected,
            found,
            strategy: PhantomData,
        }
    }
}

impl<P: Float, S: Strategy> LocalFn<P> for SeparateLight<'_, P, S> {
    fn eval<R: Real<Primal = P>>(&self, theta: &Theta<R>) -> Rgb<R> {
        let connected = self.connected.map(|light| {
            let (wo, wi) = (self.wo, light.wi);
            let at = Shading::new(*theta, Vec2::lift(self.uv));
            let (mut f, pdf) = self
                .material
                .eval_pdf(&at, Vec3::lift(wo), Vec3::lift(wi), MODE);
            if light.splits {
                f = f - self.material.eval_normals(&at, wo, wi, MODE);
            }
            let weight = S::weight_sampled(R::lift(light.mis_pdf), pdf);
            f * Rgb::lift(light.le) * (weight * Const(light.kept / light.mis_pdf))
        });
        let found = self.found.as_ref().map(|found| {
            let emission = theta.primal().lift();
            direct_light(self.scene, theta, &emission, found, &Weighing::of::<S>())
        });
        connected.unwrap_or(Rgb::black()) + found.unwrap_or(Rgb::black())
    }
}

/// A sample of an emitter that moves: all that is needed to make it again.
#[derive(Clone, Copy, Debug)]
pub struct EmitterDraw<P> {
    /// Index of the emitter.
    pub emitter: u32,
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
pub fn moving_emitter_light<R: Real>(
    scene: &Scene,
    material: &Material,
    at: &Shading<R>,
    wo: Vec3<R>,
    draw: &EmitterDraw<R::Primal>,
    light: &Moved<R>,
    weighing: &Weighing<R>,
) -> Rgb<R> {
    let wi = Frame::lift(draw.frame).to_local(light.d);
    let (f, pdf) = material.eval_pdf(at, wo, wi, MODE);
    let le = scene.emitters()[draw.emitter as usize].eval(&at.theta, &light.emission);
    let share = Const(draw.share);
    let mis = weighing.sampled.map_or(R::one(), |weight| {
        let pdf = if weighing.frozen {
            frozen_pdf(material, at, wo, wi)
        } else {
            pdf
        };
        weight(light.frozen_pdf * share, pdf)
    });
    f * le * (mis / (light.pdf * share) * Const(draw.kept))
}
