//! Light at a vertex: met by an edge, or sampled.

use ad_core::{Const, Float, Real, Vec2, Vec3};

use super::MODE;
use super::interest::PathInterest;
use crate::bsdf::{Bsdf, BsdfSample, Component, Material, Scattered, Shading};
use crate::emitter::{AnyEmitter, Emission, Emitter};
use crate::estimator::{Geometry, Sampling, Strategy, is_guided};
use crate::guide::{Directions, Guide, PART_GUIDED};
use crate::manifold::Split;
use crate::math::{Frame, Rgb};
use crate::params::Theta;
use crate::scene::{LightChoice, Scene, Settings, ShapeInfo};
use crate::shape::SurfaceInteraction;

/// Probability of keeping any one of the emitters' samples, see [`LightChoice::All`].
const LEAST_KEPT: f64 = 0.1;

/// What the weight of a light that was hit, but could have been sampled, depends on.
#[derive(Clone, Copy)]
pub struct Rival<R: Real, G> {
    /// Density of the direction.
    pub pdf_bsdf: R,
    /// The vertex it left.
    pub from: Vec3<G>,
    /// The emitter's share there.
    pub share: R::Primal,
}

/// Where an emitter was met, and the MIS weight of that.
#[derive(Clone, Copy, Debug)]
pub struct Met<R> {
    /// Where on it.
    pub emission: Emission<R>,
    /// MIS weight.
    pub weight: R,
}

/// The density that light along a scattered direction is weighed with: `pdf` of continuous components, and zero along
/// deltas, since no sample of an emitter finds what they lead to.
#[inline(always)]
pub fn density<R: Real>(component: Component, pdf: impl FnOnce() -> R) -> R {
    match component {
        Component::Continuous => pdf(),
        Component::Delta { .. } => R::zero(),
    }
}

/// Whether a direction with this [`density`] left its vertex along a delta.
#[inline(always)]
pub fn is_along_delta<P: Float>(pdf: P) -> bool {
    pdf == P::zero()
}

/// Whether emitters were sampled where the `depth`-th edge starts, unless it left along a delta.
#[inline(always)]
pub fn may_have_rival<S: Strategy>(depth: u32) -> bool {
    S::SAMPLES_EMITTERS && depth > 1
}

/// Whether light at the end of the `depth`-th edge could have been sampled at its start; `pdf` is the [`density`] of its
/// direction.
#[inline(always)]
pub fn has_rival<S: Strategy, P: Float>(depth: u32, pdf: P) -> bool {
    may_have_rival::<S>(depth) && pdf > P::zero()
}

/// MIS weight of light that an edge with the density `pdf_bsdf` met, where samples of the emitter have the density `pdf` and
/// it has this `share` of them.
#[inline(always)]
pub fn met_weight<S: Strategy, R: Real>(pdf_bsdf: R, pdf: R, share: R::Primal) -> R {
    S::weight_hit(pdf_bsdf, pdf * Const(share))
}

/// Whether light that an edge with this [`density`] meets counts.
#[inline(always)]
pub fn counts_hits<S: Strategy, P: Float>(pdf: P) -> bool {
    S::COUNTS_HITS | !S::SAMPLES_EMITTERS | is_along_delta(pdf)
}

/// Whether the last edge is followed, which only looks for light: if that counts, and if the edge `meets` any, as far as can
/// be told.
#[inline(always)]
pub fn looks_for_light<S: Strategy, P: Float>(pdf: P, meets: bool) -> bool {
    counts_hits::<S, P>(pdf) & meets
}

/// The emitters whose light the `depth`-th edge may meet: those of the shape at its end, or those around the scene, but for
/// lights that are hidden from the camera. `bent` as [`PathInterest::bent`].
#[inline(always)]
pub fn emitters_at<'a>(
    scene: &'a Scene,
    settings: &Settings,
    depth: u32,
    bent: bool,
    shape: Option<u32>,
) -> &'a [u32] {
    match shape {
        Some(shape) if !settings.hides(depth) => scene.shape_info(shape).emitter.as_slice(),
        None if !settings.hides_sky(bent) => scene.infinite_emitters(),
        _ => &[],
    }
}

/// What a ray in direction `d` receives from an emitter it hit at `si`, or missed everything towards:
/// where, with which MIS weight, and the radiance. `sampled` if the vertex it left also sampled emitters.
///
/// A call of its own, by value: lights are seldom hit, and references to the loop's state would keep
/// that in memory.
#[inline(never)]
pub fn find_light<R: Real, S: Strategy>(
    scene: &Scene,
    theta: &Theta<R>,
    emitter: u32,
    d: Vec3<Geometry<S, R>>,
    si: Option<SurfaceInteraction<Geometry<S, R>>>,
    sampled: Option<Rival<R, Geometry<S, R>>>,
) -> Option<(Met<R>, Rgb<R>)> {
    if sampled.is_some() && !S::COUNTS_HITS {
        return None;
    }
    let e = &scene.emitters()[emitter as usize];
    let found = e.hit(d, si.as_ref())?;
    let emission = Emission {
        uv: Vec2::new(S::Bsdf::embed(found.uv.x), S::Bsdf::embed(found.uv.y)),
        falloff: S::Bsdf::embed(found.falloff),
    };
    let weight = match sampled {
        Some(rival) => {
            let pdf = e.pdf(scene.lights(), rival.from, d, si.as_ref());
            met_weight::<S, R>(rival.pdf_bsdf, S::Bsdf::embed(pdf), rival.share)
        }
        None => R::one(),
    };
    Some((Met { emission, weight }, e.eval(theta, &emission)))
}

/// An edge that looks for light, and what lies at its end.
#[derive(Clone, Copy)]
pub struct Looking<'a, R: Real, G> {
    /// The emitters there.
    pub emitters: &'a [u32],
    /// The surface; none if the edge leaves the scene.
    pub si: Option<SurfaceInteraction<G>>,
    /// Why light on it counts, or does not.
    pub interest: PathInterest,
    /// Which light manifold connections find.
    pub split: Option<&'a Split>,
    /// How emitters were chosen at its start.
    pub lights: LightChoice,
    /// Its direction.
    pub d: Vec3<G>,
    /// Density of the direction and the vertex it left, if that also sampled emitters.
    pub sampled: Option<(R, Vec3<G>)>,
}

/// [`find_light`] for each emitter at the end of an edge, but for light that others find. Calls `found` with the emitter,
/// its share, where and with which weight it was met, and the radiance.
#[inline(always)]
pub fn find_lights<R: Real, S: Strategy>(
    scene: &Scene,
    theta: &Theta<R>,
    edge: Looking<R, Geometry<S, R>>,
    mut found: impl FnMut(u32, R::Primal, Met<R>, Rgb<R>),
) {
    let is_own = |e: &&u32| !edge.interest.leaves(edge.split, **e);
    for &emitter in edge.emitters.iter().filter(is_own) {
        let share = edge.lights.share(scene, emitter);
        let rival = edge.sampled.map(|(pdf_bsdf, from)| Rival {
            pdf_bsdf,
            from,
            share,
        });
        let met = find_light::<R, S>(scene, theta, emitter, edge.d, edge.si, rival);
        if let Some((met, le)) = met {
            found(emitter, share, met, le);
        }
    }
}

/// A vertex as lights see it.
pub struct LitVertex<'a, P: Float> {
    /// The material there.
    pub material: &'a Material,
    /// Its parameters, and where.
    pub at: Shading<'a, P>,
    /// Shading frame.
    pub frame: Frame<P>,
    /// Direction that the path came from, local frame.
    pub wo: Vec3<P>,
}

/// The emitter to sample, and one over the probability that its sample is kept. `bits` decide; `u` are the numbers of the
/// samples.
#[inline(always)]
pub fn choose<'a, P: Float>(
    scene: &Scene,
    lights: LightChoice,
    counts_hits: bool,
    bits: u64,
    u: [P; 2],
    p: Vec3<P>,
    seen: impl FnOnce() -> LitVertex<'a, P>,
) -> (u32, P) {
    match lights {
        // The only light needs no number; the branch is always predicted.
        _ if scene.emitters().len() == 1 => (0, P::one()),
        LightChoice::One => (scene.shares().choose(bits, 1).0 as u32, P::one()),
        LightChoice::All => weigh_lights(scene, p, &seen(), counts_hits, bits, u),
    }
}

/// Samples every emitter with the same numbers `u`, and keeps one in proportion to the light that its sample would
/// bring if nothing were in between, or any one with probability [`LEAST_KEPT`]: where the light vanishes its
/// derivative may not. The index of that emitter, and one over the probability of keeping it.
///
/// Only the choice is returned, and in registers; its sample is made once more. `counts_hits`: whether lights
/// that are hit count, too.
///
/// # Reference
/// [Talbot et al. 2005], with one candidate from each technique.
#[inline(never)]
fn weigh_lights<P: Float>(
    scene: &Scene,
    from: Vec3<P>,
    seen: &LitVertex<P>,
    counts_hits: bool,
    choice: u64,
    u: [P; 2],
) -> (u32, P) {
    // One number, used up bit by bit: whether by light, then which.
    let choice = f64::from_bits_unit(choice);
    let by_light = choice >= LEAST_KEPT;
    let mut rest = if by_light {
        (choice - LEAST_KEPT) / (1.0 - LEAST_KEPT)
    } else {
        choice / LEAST_KEPT
    };
    let mut kept = (0, 0.0);
    let (mut total, mut found) = (0.0, 0.0);
    for (i, e) in scene.emitters().iter().enumerate() {
        let Some(sample) = e.sample(scene.lights(), from, u) else {
            continue;
        };
        let wi = seen.frame.to_local(sample.d);
        let (f, pdf) = (seen.material).eval_pdf(&seen.at, seen.wo, wi, MODE);
        let density = if weighs(counts_hits, e) {
            sample.pdf + pdf
        } else {
            sample.pdf
        };
        let light = (f * e.eval(&seen.at.theta, &sample.emission)).sum() / density;
        // Zero over zero, where the sample is worth nothing.
        let light = Some(light.to_f64())
            .filter(|l| l.is_finite())
            .unwrap_or(0.0);
        total += light;
        found += 1.0;
        let p = if by_light && total > 0.0 {
            light / total
        } else {
            1.0 / found
        };
        if rest < p {
            rest /= p;
            kept = (i as u32, light);
        } else {
            rest = (rest - p) / (1.0 - p);
        }
    }
    if found == 0.0 {
        return (0, P::one());
    }
    let (emitter, light) = kept;
    let share = if total > 0.0 {
        light / total
    } else {
        1.0 / found
    };
    let p = share * (1.0 - LEAST_KEPT) + LEAST_KEPT / found;
    (emitter, P::of(p.recip()))
}

/// Whether a connection with this value and density is tested for visibility: also where the derivative may not vanish
/// although the value does (zero albedo), if derivatives are wanted.
#[inline(always)]
pub fn matters<R: Real>(differentiates: bool, f: Rgb<R>, pdf: R) -> bool {
    !f.is_black() | (differentiates & (pdf.primal() > R::Primal::zero())) | has_tangent(f)
}

/// Whether a sampled light is weighed against scattered directions, of strategies that count the lights which these hit:
/// nothing hits a delta.
#[inline(always)]
pub fn weighs(counts_hits: bool, e: &AnyEmitter) -> bool {
    counts_hits && !e.is_delta()
}

/// MIS weight of a sampled light with density `pdf` where scattered directions have the density `pdf_bsdf`; for `weighs`,
/// see there.
#[inline(always)]
pub fn mis_weight<S: Strategy, R: Real>(weighs: bool, pdf: R, pdf_bsdf: R) -> R {
    R::select(weighs, S::weight_sampled(pdf, pdf_bsdf), R::one())
}

/// Weight of a sampled light whose sample stands still: MIS weight over density and the probability of being kept, whose
/// inverse is `kept`.
#[inline(always)]
pub fn per_density<R: Real>(mis: R, kept: R::Primal, pdf: R::Primal) -> R {
    mis * Const(kept / pdf)
}

/// Whether a colour moves.
#[inline(always)]
pub fn has_tangent<R: Real>(c: Rgb<R>) -> bool {
    !R::IS_PRIMAL && (c.r.has_tangent() || c.g.has_tangent() || c.b.has_tangent())
}

/// The guide that leads paths of a strategy, if the scene has one.
#[inline(always)]
pub fn guide_of<S: Strategy>(scene: &Scene) -> Option<&Guide> {
    scene.guide().filter(|_| const { is_guided::<S>() })
}

/// Whether a guide learns what arrives at a shape, and leads directions from there: only where it is diffuse.
#[inline(always)]
pub fn is_led(info: &ShapeInfo) -> bool {
    !info.glossy
}

/// Density of a direction of which the guide draws its part and the material the rest.
#[inline(always)]
pub fn mixed<R: Real>(material: R, guide: R::Primal) -> R {
    let part = R::Primal::of(PART_GUIDED);
    material * Const(R::Primal::one() - part) + Const(guide * part)
}

/// A direction scattered by the material, which is diffuse and so without deltas, or drawn from the guide. The first
/// random number decides.
#[inline(never)]
pub fn guided<R: Real, S: Strategy>(
    guide: &Directions,
    material: &Material,
    at: &Shading<R>,
    frame: &Frame<R::Primal>,
    wo: Vec3<Geometry<S, R>>,
    [choice, u, v]: [R::Primal; 3],
) -> Option<Scattered<Geometry<S, R>, R>> {
    let part = R::Primal::of(PART_GUIDED);
    let rest = R::Primal::one() - part;
    if choice >= part {
        let u = [(choice - part) / rest, u, v];
        let (mut sample, f) = S::Bsdf::scatter(material, at, wo, u, MODE)?;
        let d = frame.to_world(sample.wi.primal());
        sample.pdf = mixed(sample.pdf, guide.pdf(d));
        return Some((sample, f));
    }
    let (d, density) = guide.sample([u, v]);
    let wi = Vec3::lift(frame.to_local(d));
    let (f, pdf) = material.eval_pdf(at, S::Bsdf::embed3(wo), S::Bsdf::embed3(wi), MODE);
    // Below the surface.
    if pdf.primal() <= R::Primal::zero() {
        return None;
    }
    let sample = BsdfSample {
        wi,
        pdf: mixed(Real::lift(pdf.primal()), density),
        component: Component::Continuous,
        eta: R::Primal::one(),
    };
    Some((sample, f))
}

/// Density of a scattered direction for constant parameters, see [`crate::estimator::FrozenWeights`].
#[inline]
pub fn frozen_pdf<R: Real>(material: &Material, at: &Shading<R>, wo: Vec3<R>, wi: Vec3<R>) -> R {
    let theta = at.theta.primal().lift();
    material.eval_pdf(&Shading { theta, ..*at }, wo, wi, MODE).1
}
