//! The path tracer.

use ad_core::{Const, Real, Vec2, Vec3};
use smallvec::SmallVec;

use super::direct::{
    Departure, EmitterDraw, Found, FoundEdge, FoundLight, Weighing, direct_light,
    moving_emitter_light,
};
use super::lockstep::{self, Traveller};
use super::progress::Progress;
use super::record::{Bounce, Contribution, MetLight, NormalsLight, Observer, Place, SampledLight};
use super::vertex::interest::PathInterest;
use super::vertex::light::{
    LitVertex, Looking, choose, density, emitters_at, find_lights, frozen_pdf, guide_of, guided,
    has_rival, has_tangent, is_along_delta, is_led, looks_for_light, matters, mis_weight, mixed,
    per_density, weighs,
};
use super::vertex::normals::{normals_pair, normals_weight, splits};
use super::vertex::roulette::{MAX_SURVIVAL, play, probability, roulette_weight};
use super::vertex::{MODE, assert_finite, has_more, may_go_on, part_of};
use crate::bsdf::{Bsdf, Material, Part, Shading, TextureRef};
use crate::emitter::{AnyEmitter, Emission, Emitter, Shift};
use crate::estimator::memory::{Memory, Store};
use crate::estimator::{Edges, Geometry, Sampling, Strategy, differentiates_edges};
use crate::guide::Directions;
use crate::manifold::Split;
use crate::math::{Ray, Rgb, Segment};
use crate::params::Theta;
use crate::sampler::{Purpose, Sampler};
use crate::scene::{Caustics, Intersection, Scene, Settings, ShapeInfo};
use crate::shape::{Exit, SurfaceInteraction};

/// The last departure of a path and the throughput there, if its strategy wants to know.
type Remembered<S, R> =
    <<S as Strategy>::Edge as Memory>::Of<(Departure<<R as Real>::Primal>, Rgb<R>)>;

/// A sampled emitter as it moves, if its strategy moves those.
type KeptDraw<S, R> =
    <<S as Strategy>::EmitterMotion as Memory>::Of<EmitterDraw<<R as Real>::Primal>>;

/// What stays the same from path to path.
#[derive(Clone, Copy, Debug)]
pub struct Context<'a, R: Real> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its parameters.
    pub theta: &'a Theta<'a, R>,
    /// Depths.
    pub settings: &'a Settings,
    /// Per emitter, how its samples move: see [`shifts`]. They stand still where there is none.
    pub shifts: &'a [Option<Shift<R>>],
    /// Who finds caustics: paths leave them out where particles do.
    pub caustics: Caustics,
    /// Which light manifold connections find, if they are made: paths leave it out.
    pub split: Option<&'a Split>,
    /// Asked now and then whether paths are to be followed any further: once it says no, what they found counts
    /// for nothing.
    pub progress: &'a dyn Progress,
}

impl<'a, R: Real> Context<'a, R> {
    /// For paths in a scene whose samples of emitters stand still, and that leave nothing to manifold connections.
    pub(super) fn new(
        scene: &'a Scene,
        theta: &'a Theta<'a, R>,
        settings: &'a Settings,
        caustics: Caustics,
        progress: &'a dyn Progress,
    ) -> Self {
        Self {
            scene,
            theta,
            settings,
            shifts: &[],
            caustics,
            split: None,
            progress,
        }
    }

    /// The same where nothing moves: with the values of the parameters, `theta`.
    pub(super) fn still<'b>(&self, theta: &'b Theta<'b, R::Primal>) -> Context<'b, R::Primal>
    where
        'a: 'b,
    {
        Context {
            scene: self.scene,
            theta,
            settings: self.settings,
            shifts: &[],
            caustics: self.caustics,
            split: self.split,
            progress: self.progress,
        }
    }
}

/// How the samples of all emitters move, for strategies and scalars that want to know: made once per pass.
pub fn shifts<R: Real, S: Strategy>(scene: &Scene, theta: &Theta<R>) -> Vec<Option<Shift<R>>> {
    if R::IS_PRIMAL || !S::EmitterMotion::KEEPS {
        return Vec::new();
    }
    let each = |e: &AnyEmitter| e.moving().and_then(|map| map.shift(theta));
    scene.emitters().iter().map(each).collect()
}

/// Radiance arriving along `ray`: a [`Walk`] to its end.
pub fn trace<R: Real, S: Strategy, X: Sampler, O: Observer<R>>(
    scene: &Scene,
    theta: &Theta<R>,
    settings: &Settings,
    ray: Ray<Geometry<S, R>>,
    sampler: X,
    observer: &mut O,
) -> Rgb<R> {
    let context = Context {
        shifts: &shifts::<R, S>(scene, theta),
        ..Context::new(scene, theta, settings, Caustics::Paths, &())
    };
    Walk::<R, S, X>::new(ray, sampler).finish(&context, observer)
}

/// A path between two vertices. It asks for its rays to be traced and goes on with the answers, so that
/// the rays of many paths can be traced together.
///
/// Depth counts edges: a light that is seen has depth 1, direct light 2. Dimensions of the
/// sampler: see [`Purpose`].
///
/// # Derivatives
/// In theta, as the strategy says. Discrete decisions (light, lobe, roulette) are primal, and so are their
/// probabilities unless it asks for others.
///
/// # Does not handle
/// Moving discontinuities.
///
/// # Reference
/// [Zeltner 2021, section 2.5.1]; roulette from `rr_depth` edges with Mitsuba's
/// probability `min(max(beta) eta^2, 0.95)`.
#[derive(Clone, Copy, Debug)]
pub struct Walk<R: Real, S: Strategy, X: Sampler> {
    /// The next edge, if there is one.
    pub ray: Option<Ray<Geometry<S, R>>>,
    /// Towards the light sampled at the last vertex.
    pub shadow: Option<Segment<R::Primal>>,
    /// Radiance so far.
    pub l: Rgb<R>,
    sampler: X,
    /// Throughput.
    beta: Rgb<R>,
    /// Relative index along the path.
    eta: R::Primal,
    /// Density of the last direction; zero if it was a delta.
    pdf_bsdf: R,
    /// The vertex it left.
    from: Vec3<Geometry<S, R>>,
    /// The same in full, and the throughput there, for strategies that differentiate the edge by itself.
    departure: Remembered<S, R>,
    /// What roulette goes by.
    roulette_weight: R::Primal,
    /// Number of edges with the next one.
    depth: u32,
    /// Whether light on this edge counts.
    interest: PathInterest,
    /// What comes through the shadow ray if it is free, and its record for the observer.
    direct: Rgb<R>,
    sampled: Option<SampledLight<R>>,
    draw: KeptDraw<S, R>,
}

/// A vertex that a path has reached.
struct Here<'a, R: Real, S: Strategy> {
    info: &'a ShapeInfo,
    material: &'a Material,
    si: SurfaceInteraction<Geometry<S, R>>,
    at: Shading<'a, R>,
    /// Direction the path came from, local frame.
    wo: Vec3<Geometry<S, R>>,
    /// The same in the scalar of the estimate.
    wo_r: Vec3<R>,
    /// How rays leave it.
    exit: Exit,
    /// What leads scattered directions, if anything does.
    guide: Option<&'a Directions>,
    /// Whether the change of normals has samples of its own.
    splits: bool,
}

impl<R: Real, S: Strategy, X: Sampler> Walk<R, S, X> {
    /// A path that starts with a camera ray. The sampler has given the camera's numbers.
    #[inline(always)]
    pub fn new(ray: Ray<Geometry<S, R>>, sampler: X) -> Self {
        Self {
            ray: Some(ray),
            shadow: None,
            l: Rgb::black(),
            sampler,
            beta: Rgb::splat(R::one()),
            eta: R::Primal::one(),
            pdf_bsdf: R::zero(),
            from: Vec3::zero(),
            departure: Default::default(),
            roulette_weight: R::Primal::one(),
            depth: 1,
            interest: PathInterest::default(),
            direct: Rgb::black(),
            sampled: None,
            draw: Default::default(),
        }
    }

    /// The rest of a path, behind a vertex that others have dealt with: `depth` edges with this ray. What the ray meets
    /// could not have been sampled. `lit`: whether light on it counts.
    #[inline(always)]
    pub(super) fn behind(ray: Ray<Geometry<S, R>>, sampler: X, depth: u32, lit: bool) -> Self {
        let interest = PathInterest {
            caustic: !lit,
            bent: depth > 1,
            ..PathInterest::default()
        };
        Self {
            interest,
            depth,
            ..Self::new(ray, sampler)
        }
    }

    /// [`Walk::finish`] for a ray of which it is known what it meets.
    pub(super) fn finish_at(
        mut self,
        context: &Context<R>,
        hit: Option<Intersection<Geometry<S, R>>>,
    ) -> Rgb<R> {
        self.step(context, hit, false, &mut ());
        self.finish(context, &mut ())
    }

    /// Goes on to the end, tracing ray by ray.
    pub fn finish<O: Observer<R>>(mut self, context: &Context<R>, observer: &mut O) -> Rgb<R> {
        self.go(context, observer);
        self.l
    }

    /// [`Walk::finish`] for one that is still of interest.
    fn go<O: Observer<R>>(&mut self, context: &Context<R>, observer: &mut O) {
        lockstep::trace_alone(
            context.scene,
            &S::Bsdf::geometry(context.theta),
            context.settings.hides(1),
            context.progress,
            self,
            |walk, hit, visible| {
                walk.step(context, hit, visible, observer);
            },
        );
    }

    /// Goes on to the next vertex: `hit` is what `Walk::ray` met, `visible` whether
    /// `Walk::shadow` was free.
    #[inline]
    pub fn step<O: Observer<R>>(
        &mut self,
        context: &Context<R>,
        hit: Option<Intersection<Geometry<S, R>>>,
        visible: bool,
        observer: &mut O,
    ) {
        let scene = context.scene;
        // ---- Light sampled at the last vertex ----
        if self.shadow.take().is_some() && visible {
            self.l += self.direct;
            if let Some(mut light) = self.sampled.take() {
                light.draw = self.draw.get();
                observer.contribution(Contribution::Sampled(light));
            }
        }
        let Some(ray) = self.ray.take() else {
            return;
        };
        if O::ENABLED
            && let Some(Intersection { prim, si, .. }) = &hit
        {
            observer.arrives(*prim, &S::Bsdf::embed_interaction(si));
        }

        // ---- Light at the end of the edge ----
        let (settings, bent) = (context.settings, self.interest.bent);
        let shape = hit.as_ref().map(|hit| hit.shape);
        let emitters = emitters_at(scene, settings, self.depth, bent, shape);
        if !emitters.is_empty() && self.interest.lit(observer) {
            let end = hit.map(|hit| (hit.prim, hit.si));
            self.find_lights(context, emitters, ray.d, end, observer);
        }
        let Some(Intersection { shape, prim, si }) = hit else {
            return;
        };
        if self.depth >= context.settings.max_depth {
            return;
        }

        // ---- The vertex ----
        let info = scene.shape_info(shape);
        let uv = Vec2::new(S::Bsdf::embed(si.uv.x), S::Bsdf::embed(si.uv.y));
        let wo = si.frame.to_local(-ray.d);
        let mut here = Here {
            info,
            material: scene.material(shape),
            si,
            at: Shading::new(*context.theta, uv),
            wo,
            wo_r: S::Bsdf::embed3(wo),
            exit: scene.exit(prim),
            guide: None,
            splits: false,
        };
        if O::ENABLED {
            let place = Place {
                shape,
                prim,
                si: S::Bsdf::embed_interaction(&si),
                wo: here.wo_r,
            };
            observer.vertex(self.beta, &place);
        }
        (self.interest).arrive(observer, context.caustics, self.depth, info);
        let along_delta = is_along_delta(self.pdf_bsdf.primal());
        (self.interest).arrive_on(context.split, shape, along_delta);
        let lit = self.interest.lit(observer);
        let goes_on = may_go_on(lit, has_more(self.depth, context.settings));
        let differentiates = const { O::ENABLED || !R::IS_PRIMAL };
        here.splits = differentiates
            && splits::<S, O>(observer, goes_on, info.material, here.material)
            && (R::IS_PRIMAL || roughness_moves(here.material, context.theta));
        if let Some(guide) = guide_of::<S>(scene).filter(|_| is_led(info)) {
            here.guide = guide.at(si.p.primal());
        }

        if S::SAMPLES_EMITTERS && lit && !info.delta && !scene.emitters().is_empty() {
            self.sample_light(context, &here, observer);
        }
        // The constant again: where nothing splits, the path of a sample is not even compiled.
        if S::Bsdf::DIFFERENTIAL && here.splits && !self.beta.is_black() {
            self.branch(context, &here, observer);
        }
        self.depth += 1;
        if goes_on {
            self.scatter(context, &here, observer);
        }
    }

    /// Samples a light, to be seen if the shadow ray is free.
    #[inline(always)]
    fn sample_light<O: Observer<R>>(
        &mut self,
        context: &Context<R>,
        here: &Here<R, S>,
        observer: &mut O,
    ) {
        let &Context {
            scene,
            theta,
            settings,
            ..
        } = context;
        let &Here {
            material,
            ref si,
            ref at,
            wo,
            wo_r,
            ..
        } = here;
        let (sampler, beta) = (&mut self.sampler, self.beta);
        sampler.seek(Purpose::Light.at(self.depth));
        let bits = sampler.next_bits();
        let u = sampler.next_2d();
        let p = si.p.primal();
        let seen = || LitVertex {
            material,
            at: at.primal(),
            frame: si.primal().frame,
            wo: wo.primal(),
        };
        let (emitter, kept) = choose(scene, settings.lights, S::COUNTS_HITS, bits, u, p, seen);
        let e = &scene.emitters()[emitter as usize];
        let share = settings.lights.share(scene, emitter);
        let sample = e.sample(scene.lights(), p, u).map(|mut sample| {
            sample.pdf *= share;
            sample
        });
        let Some(sample) = sample.filter(|s| s.pdf > R::Primal::zero()) else {
            return;
        };
        // Where the vertex moves, its direction to the point on the light does.
        let moved = (!Geometry::<S, R>::IS_PRIMAL).then(|| e.connect(&sample, si.p));
        let d = moved.map_or(Vec3::lift(sample.d), |s| s.d);
        let wi = si.frame.to_local(d);
        let reflects = wo.z.primal() * wi.z.primal() > R::Primal::zero();
        // From a rough caster.
        if (self.interest).leaves_sampled(context.split, emitter, here.info.material, reflects) {
            return;
        }
        let (f, mut pdf) = material.eval_pdf(at, wo_r, S::Bsdf::embed3(wi), MODE);
        if let Some(guide) = here.guide {
            pdf = mixed(pdf, guide.pdf(sample.d));
        }
        if !matters(O::ENABLED, f, pdf) {
            return;
        }
        let from = si.primal();
        let shadow = from.shadow_ray(sample.d, sample.distance, here.exit, sample.surface);
        let (pdf_light, emission) = match moved {
            None => (R::lift(sample.pdf), sample.emission.lift()),
            Some(s) => (
                S::Bsdf::embed(s.pdf),
                Emission {
                    uv: S::Bsdf::embed2(s.emission.uv),
                    falloff: S::Bsdf::embed(s.emission.falloff),
                },
            ),
        };
        let le = e.eval(theta, &emission);
        let weighs = weighs(S::COUNTS_HITS, e);
        if weighs && S::FROZEN_WEIGHTS && !R::IS_PRIMAL {
            pdf = frozen_pdf(material, at, wo_r, S::Bsdf::embed3(wi));
        }
        let mis = mis_weight::<S, R>(weighs, pdf_light, pdf);
        let weight = if Geometry::<S, R>::IS_PRIMAL {
            per_density(mis, kept, sample.pdf)
        } else {
            mis / pdf_light * Const(kept)
        };
        self.shadow = Some(shadow);
        self.direct = beta * f * le * weight;
        if S::EmitterMotion::KEEPS && const { O::ENABLED || !R::IS_PRIMAL } {
            let draw = EmitterDraw {
                emitter,
                u,
                frame: si.frame.primal(),
                share,
                kept,
            };
            let shift = context
                .shifts
                .get(emitter as usize)
                .and_then(Option::as_ref);
            if let (Some(map), Some(shift)) = (e.moving(), shift)
                && let Some(drawn) = map.moving_draw(u)
            {
                let moved = map.moved(&drawn, theta, shift);
                let weighing = Weighing::of::<S>();
                self.direct = beta
                    * moving_emitter_light(scene, material, at, wo_r, &draw, &moved, &weighing);
            }
            let moves = O::ENABLED && e.moving().is_some();
            self.draw.put(moves.then_some(draw));
        }
        let normals_weight = here.splits.then(|| {
            let (at, directions) = (at.primal(), [wo.primal(), wi.primal()]);
            let pdf = sample.pdf;
            let weight = normals_weight::<S, _>(material, &at, directions, weighs, pdf, kept);
            R::lift(weight)
        });
        if let (Some(w), false) = (normals_weight, R::IS_PRIMAL) {
            let change = material.eval_normals(at, wo.primal(), wi.primal(), MODE);
            self.direct += beta * change * le * (w - weight);
        }
        if O::ENABLED {
            observer.sampled(&sample);
            self.sampled = Some(SampledLight {
                emitter,
                emission,
                wi: S::Bsdf::embed3(wi),
                le,
                weight,
                f,
                normals_weight,
                kept,
                mis_pdf: if weighs {
                    sample.pdf
                } else {
                    R::Primal::zero()
                },
                draw: None,
            });
        }
    }

    /// Follows samples of the derivative of the distribution of normals to their ends.
    #[inline(always)]
    fn branch<O: Observer<R>>(
        &mut self,
        context: &Context<R>,
        here: &Here<R, S>,
        observer: &mut O,
    ) {
        let (si, material) = (here.si.primal(), here.material);
        let (at, wo) = (here.at.primal(), here.wo.primal());
        let theta = context.theta.primal();
        let still = context.still(&theta);
        let sampler = &mut self.sampler;
        let dimension = Purpose::NormalsPair.at(self.depth);
        for sample in normals_pair(material, &at, wo, MODE, sampler, dimension) {
            let change = if R::IS_PRIMAL {
                Rgb::black()
            } else {
                material.eval_normals(&here.at, wo, sample.wi, MODE)
            };
            if !O::ENABLED && !has_tangent(change) {
                continue;
            }
            let d = si.frame.to_world(sample.wi);
            let ray = si.spawn_ray(d, here.exit);
            let reflects = wo.z * sample.wi.z > R::Primal::zero();
            let interest = (self.interest).branch(context.split, here.info.material, reflects);
            let mut walk = Walk::<R::Primal, S, X> {
                beta: self.beta.primal(),
                pdf_bsdf: sample.pdf,
                from: Vec3::lift(si.p),
                depth: self.depth + 1,
                eta: self.eta * sample.eta,
                interest,
                ..Walk::new(Ray::lift(ray), *sampler)
            };
            walk.go(&still, &mut ());
            if O::ENABLED {
                observer.branch(walk.depth - self.depth);
            }
            if walk.l.is_black() {
                continue;
            }
            let li = Rgb::lift(walk.l.scale(sample.pdf.recip()));
            if !R::IS_PRIMAL {
                self.l += change * li;
            }
            if O::ENABLED {
                observer.contribution(Contribution::Normals(NormalsLight {
                    wi: Vec3::lift(sample.wi),
                    mode: MODE,
                    li,
                }));
            }
        }
    }

    /// Samples the next edge, which has been counted.
    #[inline(always)]
    fn scatter<O: Observer<R>>(
        &mut self,
        context: &Context<R>,
        here: &Here<R, S>,
        observer: &mut O,
    ) {
        let &Context {
            scene, settings, ..
        } = context;
        let &Here {
            info,
            material,
            ref si,
            ref at,
            wo,
            wo_r,
            splits,
            ..
        } = here;
        let depth = self.depth - 1;
        self.sampler.seek(Purpose::Scattering.at(depth));
        let u = self.sampler.next_3d();
        let scattered = match here.guide {
            None => S::Bsdf::scatter(material, at, wo, u, MODE),
            Some(guide) => guided::<R, S>(guide, material, at, &si.frame.primal(), wo, u),
        };
        let Some((sample, f)) = scattered else {
            return;
        };
        let wi = S::Bsdf::embed3(sample.wi);
        let pdf = S::Bsdf::embed(sample.pdf);
        let mut weight = if const { S::ATTACHED_CHOICE } && !R::IS_PRIMAL {
            (material.choice_pdf(at, wo_r, wi, sample.component, MODE)).recip()
        } else {
            pdf.recip()
        };
        let before = self.eta;
        self.eta *= sample.eta;
        self.interest.bend(sample.component, [before, self.eta]);
        let beta = self.beta;
        let mut next_beta = beta * f * weight;
        assert_finite(next_beta, self.l);

        // ---- Roulette ----
        let differentiates = const { O::ENABLED || !R::IS_PRIMAL };
        let step = f.primal() * weight.primal();
        self.roulette_weight = roulette_weight(
            differentiates,
            self.roulette_weight,
            step,
            next_beta.primal(),
        );
        let mut inv_q = R::Primal::one();
        let mut deciding = None;
        if depth >= settings.rr_depth {
            let q = probability(self.roulette_weight, self.eta);
            let survives;
            (survives, inv_q) = play(true, q, self.sampler.next_1d());
            if !survives {
                return;
            }
            self.roulette_weight *= inv_q;
            weight = weight * Const(inv_q);
            next_beta = next_beta.scale(inv_q);
            if S::ATTACHED_ROULETTE {
                deciding = self.decide(&mut weight, &mut next_beta, q);
            }
        }

        // ---- Records ----
        let part = part_of(sample.component, splits);
        if differentiates_edges::<S>() {
            let active = differentiates
                && (!O::ENABLED || observer.differentiates(info.material))
                && Edges::of::<S>().contain(sample.component);
            self.departure.put(active.then(|| {
                let from = Departure {
                    material: info.material,
                    exit: here.exit,
                    si: si.primal(),
                    wo: wo.primal(),
                    u,
                    inverse_survival: inv_q,
                    part,
                };
                (from, beta)
            }));
        }
        if O::ENABLED {
            observer.contribution(Contribution::Scattered(Bounce {
                wi,
                component: sample.component,
                mode: MODE,
                weight,
                f,
                part,
                deciding,
            }));
        }

        // ---- The next edge ----
        self.beta = match part {
            Part::Rest if !R::IS_PRIMAL => {
                let change = material.eval_normals(at, wo.primal(), wi.primal(), MODE);
                next_beta - beta * change * weight
            }
            _ => next_beta,
        };
        if !O::ENABLED && next_beta.is_black() && !has_tangent(next_beta) {
            return;
        }
        self.pdf_bsdf = density(sample.component, || {
            if S::FROZEN_WEIGHTS && !R::IS_PRIMAL {
                frozen_pdf(material, at, wo_r, wi)
            } else {
                pdf
            }
        });
        let along_delta = is_along_delta(self.pdf_bsdf.primal());
        let reflects = wo.z.primal() * sample.wi.z.primal() > R::Primal::zero();
        (self.interest).leave_by(context.split, info.material, along_delta, reflects);
        self.from = si.p;
        let ray = si.spawn_ray(si.frame.to_world(sample.wi), here.exit);
        let pdf = self.pdf_bsdf.primal();
        let is_of_use = has_more(depth, settings)
            || looks_for_light::<S, _>(pdf, scene.may_meet_light(&ray.primal()));
        self.ray = is_of_use.then_some(ray);
    }

    /// Differentiates the survival probability `q` (F5): the channel of the throughput that it is in proportion to, if any.
    #[inline(always)]
    fn decide(&self, weight: &mut R, beta: &mut Rgb<R>, q: R::Primal) -> Option<usize> {
        let c = beta.primal();
        let largest = (0..3).fold(0, |m, i| if c[i] > c[m] { i } else { m });
        let p = c[largest] * q * self.eta * self.eta;
        if !(p > R::Primal::zero() && p < R::Primal::of(MAX_SURVIVAL)) {
            return None;
        }
        // One, with the tangent of one over a moving probability.
        if !R::IS_PRIMAL {
            let factor = beta[largest].recip() * Const(c[largest]);
            *weight *= factor;
            *beta = *beta * factor;
        }
        Some(largest)
    }
}

impl<R: Real, S: Strategy, X: Sampler> Traveller for Walk<R, S, X> {
    type Geometry = Geometry<S, R>;
    const IS_SEEN: bool = false;
    #[inline(always)]
    fn ray(&self) -> Option<&Ray<Self::Geometry>> {
        self.ray.as_ref()
    }
    #[inline(always)]
    fn shadow(&self) -> Option<&Segment<R::Primal>> {
        self.shadow.as_ref()
    }
    #[inline(always)]
    fn looks(&self) -> bool {
        self.depth == 1
    }
}

impl<R: Real, S: Strategy, X: Sampler> Walk<R, S, X> {
    /// Adds the light that the last edge finds, in direction `d` and from those of the `emitters` that are there, where it
    /// met a primitive or left the scene.
    #[inline(always)]
    fn find_lights<O: Observer<R>>(
        &mut self,
        &Context {
            scene,
            theta,
            settings,
            split,
            ..
        }: &Context<R>,
        emitters: &[u32],
        d: Vec3<Geometry<S, R>>,
        end: Option<(u32, SurfaceInteraction<Geometry<S, R>>)>,
        observer: &mut O,
    ) {
        let (depth, beta) = (self.depth, self.beta);
        let sampled = has_rival::<S, R::Primal>(depth, self.pdf_bsdf.primal());
        let edge = Looking {
            emitters,
            si: end.map(|(_, si)| si),
            interest: self.interest,
            split,
            lights: settings.lights,
            d,
            sampled: sampled.then_some((self.pdf_bsdf, self.from)),
        };
        // Whether the edge is not differentiated like the rest of the path.
        let apart = const { differentiates_edges::<S>() } && self.departure.get().is_some();
        let mut lights = SmallVec::<[FoundLight<R::Primal>; 1]>::new();
        find_lights::<R, S>(scene, theta, edge, |emitter, share, light, le| {
            if apart {
                lights.push(FoundLight {
                    emitter,
                    emission: light.emission.primal(),
                    share,
                });
            }
            if !apart || R::IS_PRIMAL {
                self.l += beta * le * light.weight;
            }
            if O::ENABLED {
                observer.contribution(Contribution::Met(MetLight {
                    emitter,
                    emission: light.emission,
                    weight: light.weight,
                    beta,
                    share,
                }));
            }
        });
        if !lights.is_empty()
            && let Some((from, beta)) = self.departure.get()
        {
            let edge = FoundEdge {
                motion: from.motion::<S, X>(scene, d.primal(), depth, &mut self.sampler),
                end: end.map(|(prim, si)| (prim, si.t.primal())),
            };
            let found = Found {
                from: &from,
                edge: &edge,
                lights: &lights,
            };
            if !R::IS_PRIMAL {
                self.l += beta * direct_light(scene, theta, theta, &found, &Weighing::of::<S>());
            }
            if O::ENABLED {
                observer.contribution(Contribution::Edge(from, edge));
            }
        }
    }
}

/// Whether the roughness of a material does with the parameters.
#[inline(never)]
fn roughness_moves<R: Real>(material: &Material, theta: &Theta<R>) -> bool {
    let mut moves = false;
    material.visit_textures(&mut |t| {
        moves |= matches!(t, TextureRef::Alpha(t) if t.any_param(|p| theta.moves(p)));
    });
    moves
}
