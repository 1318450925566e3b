//! The path tracer.

use ad_core::{Const, Float, Real, Vec2, Vec3};
use smallvec::SmallVec;

use super::batch;
use super::direct::{
    Aimed, Departure, Edges, Found, FoundEdge, FoundLight, Weighing, aimed_light, direct_light,
    follows_edges,
};
use super::render::Progress;
use crate::bsdf::{
    Bsdf, BsdfSample, Component, Material, Part, Scattered, Shading, TextureRef, TransportMode,
};
use crate::emitter::{AnyEmitter, Emission, Emitter, Shift};
use crate::estimator::memory::{Memory, Store};
use crate::estimator::{Sampling, Strategy};
use crate::guide::{Directions, PART_GUIDED};
use crate::math::{Frame, Ray, Rgb};
use crate::params::Theta;
use crate::sampler::{AUXILIARY_DIMENSIONS, BOUNCE_DIMENSIONS, CAMERA_DIMENSIONS, Sampler};
use crate::scene::{Caustics, Intersection, LightChoice, Scene, Settings};
use crate::shape::SurfaceInteraction;

/// What paths carry.
pub(super) const MODE: TransportMode = TransportMode::Radiance;

/// Probability of surviving Russian roulette is at most this.
pub(super) const MAX_SURVIVAL: f64 = 0.95;

/// When derivatives are wanted, a vertex counts as reflecting at least this much for roulette: at zero
/// albedo the throughput vanishes, but the derivative behind that vertex does not (F7).
pub(super) const LEAST_STEP: f64 = 0.2;

/// Probability of keeping any one of the emitters' samples, see [`LightChoice::All`].
const LEAST_KEPT: f64 = 0.1;

/// Scalar of the geometry of a strategy.
pub type Geometry<S, R> = <<S as Strategy>::Bsdf as Sampling>::Geometry<R>;

/// The last departure of a path and the throughput there, if its strategy wants to know.
type Remembered<S, R> =
    <<S as Strategy>::Edge as Memory>::Of<(Departure<<R as Real>::Primal>, Rgb<R>)>;

/// A sampled emitter as it moves, if its strategy moves those.
type Aiming<S, R> = <<S as Strategy>::Aim as Memory>::Of<Aimed<<R as Real>::Primal>>;

/// Light found by a ray that hit an emitter, or left the scene towards one.
#[derive(Clone, Copy, Debug)]
pub struct HitLight<R> {
    /// Index of the emitter.
    pub emitter: u32,
    /// Where on it.
    pub emission: Emission<R>,
    /// MIS weight.
    pub weight: R,
}

/// A connection to a sampled light.
#[derive(Clone, Copy, Debug)]
pub struct SampledLight<R: Real> {
    /// Index of the emitter.
    pub emitter: u32,
    /// Where on it.
    pub emission: Emission<R>,
    /// Direction to it, local frame of the vertex.
    pub wi: Vec3<R>,
    /// Emitted radiance.
    pub le: Rgb<R>,
    /// MIS weight over density and the probability of being kept.
    pub weight: R,
    /// Value of the BSDF.
    pub f: Rgb<R>,
    /// The same for the derivative through normals, where that has samples of its own.
    pub normals_weight: Option<R>,
    /// Density per solid angle that the MIS weight is made of; zero where there is none.
    pub mis_pdf: R::Primal,
    /// One over the probability that this emitter's sample was kept, see [`LightChoice::All`].
    pub kept: R::Primal,
}

/// Light that arrives along a sample of the derivative of a distribution of normals.
#[derive(Clone, Copy, Debug)]
pub struct NormalsLight<R> {
    /// Direction it comes from, local frame of the vertex.
    pub wi: Vec3<R>,
    /// Radiance over density, times the throughput up to the vertex, MIS weights included.
    pub li: Rgb<R>,
}

/// The sampled continuation of a path.
#[derive(Clone, Copy, Debug)]
pub struct Bounce<R> {
    /// Sampled direction, local frame of the vertex.
    pub wi: Vec3<R>,
    /// What the direction belongs to.
    pub component: Component,
    /// One over density (or probability) and survival probability.
    pub weight: R,
    /// Value of the BSDF.
    pub f: Rgb<R>,
    /// What of it is differentiated.
    pub part: Part,
}

/// Follows a path as it grows. All methods do nothing by default.
pub trait Observer<R: Real> {
    /// Whether events are wanted; if not, none is made.
    const ENABLED: bool = true;
    /// Whether it wants to know the light behind a vertex of this material: because that is differentiated.
    fn follows(&self, _material: u32) -> bool {
        true
    }
    /// Whether the roughness of this material is: only then its normals have samples of their own.
    fn follows_normals(&self, _material: u32) -> bool {
        true
    }
    /// Whether it wants to know all light, since emission is differentiated.
    fn follows_light(&self) -> bool {
        true
    }
    /// The path found light at its current end.
    fn light(&mut self, _depth: u32, _beta: Rgb<R>, _light: HitLight<R>) {}
    /// Called after that, once for all light at this end, if the strategy differentiates the last edge by itself
    /// ([`Edges`]).
    fn followed(&mut self, _found: Found<R::Primal>) {}
    /// A vertex was reached. `depth` is the number of edges so far, `beta` the throughput up to it.
    fn vertex(
        &mut self,
        _depth: u32,
        _beta: Rgb<R>,
        _shape: u32,
        _uv: Vec2<R>,
        _wo: Vec3<R>,
        _p: Vec3<R>,
    ) {
    }
    /// A light was sampled at the current vertex, and is visible. Known, and called, last: after
    /// [`Observer::bounce`], before the next edge's events.
    fn sampled(&mut self, _depth: u32, _light: SampledLight<R>) {}
    /// Called after that, if the sample moves.
    fn aimed(&mut self, _aimed: Aimed<R::Primal>) {}
    /// A sample of the derivative of the current vertex's normals met light.
    fn normals(&mut self, _light: NormalsLight<R>) {}
    /// Called before that with the number of edges that the sample took, whatever it met.
    fn walked(&mut self, _edges: u32) {}
    /// The path is about to go on, since a roulette that is differentiated let it: with a probability in proportion to
    /// this channel of its throughput.
    fn survives(&mut self, _channel: usize) {}
    /// The path goes on from the current vertex.
    fn bounce(&mut self, _bounce: Bounce<R>) {}
    /// In this direction, world space.
    fn departs(&mut self, _d: Vec3<R::Primal>) {}
}

/// Nobody watches.
impl<R: Real> Observer<R> for () {
    const ENABLED: bool = false;
}

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
    /// Asked now and then whether paths are to be followed any further: once it says no, what they found counts
    /// for nothing.
    pub progress: &'a dyn Progress,
}

/// How the samples of all emitters move, for strategies and scalars that want to know: made once per pass.
pub fn shifts<R: Real, S: Strategy>(scene: &Scene, theta: &Theta<R>) -> Vec<Option<Shift<R>>> {
    if R::IS_PRIMAL || !S::Aim::KEEPS {
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
        scene,
        theta,
        settings,
        shifts: &shifts::<R, S>(scene, theta),
        caustics: Caustics::Paths,
        progress: &(),
    };
    Walk::<R, S, X>::new(ray, sampler).finish(&context, observer)
}

/// A path between two vertices. It asks for its rays to be traced and goes on with the answers, so that
/// the rays of many paths can be traced together.
///
/// Depth counts edges: a light that is seen has depth 1, direct light 2. Dimensions of the
/// sampler: [`CAMERA_DIMENSIONS`] for the camera, then [`BOUNCE_DIMENSIONS`] per vertex (light
/// choice, light position 2, BSDF 3, roulette).
///
/// # Derivatives
/// In theta, as the strategy says. Discrete decisions (light, lobe, roulette) are primal, and so are their
/// probabilities unless it asks for others.
///
/// # Does not handle
/// Moving discontinuities.
///
/// # Reference
/// [Zeltner 2021, section 2.5.1]; roulette from `rr_depth` edges with the peer's
/// probability `min(max(beta) eta^2, 0.95)`.
#[derive(Clone, Copy, Debug)]
pub struct Walk<R: Real, S: Strategy, X: Sampler> {
    /// The next edge, if there is one.
    pub ray: Option<Ray<Geometry<S, R>>>,
    /// Towards the light sampled at the last vertex, and how far it must be free.
    pub shadow: Option<(Ray<R::Primal>, R::Primal)>,
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
    survival: R::Primal,
    /// Number of edges with the next one.
    depth: u32,
    /// Whether a vertex so far is one that the observer follows.
    followed: bool,
    /// Whether others find caustics on the first vertex, and whether light on this edge would be one.
    left_out: (bool, bool),
    /// What comes through the shadow ray if it is free, and its record for the observer.
    direct: Rgb<R>,
    sampled: Option<SampledLight<R>>,
    aimed: Aiming<S, R>,
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
            survival: R::Primal::one(),
            depth: 1,
            followed: false,
            left_out: (false, false),
            direct: Rgb::black(),
            sampled: None,
            aimed: Default::default(),
        }
    }

    /// Goes on to the end, tracing ray by ray.
    pub fn finish<O: Observer<R>>(mut self, context: &Context<R>, observer: &mut O) -> Rgb<R> {
        self.go(context, observer);
        self.l
    }

    /// [`Walk::finish`] for one that is still of interest.
    fn go<O: Observer<R>>(&mut self, context: &Context<R>, observer: &mut O) {
        batch::trace_alone(
            context.scene,
            context.progress,
            self,
            |walk, hit, visible| {
                walk.step(context, hit, visible, observer);
            },
        );
    }

    /// Goes on to the next vertex: `hit` is what [`Walk::ray`] met, `visible` whether
    /// [`Walk::shadow`] was free.
    #[inline]
    pub fn step<O: Observer<R>>(
        &mut self,
        context: &Context<R>,
        hit: Option<Intersection<Geometry<S, R>>>,
        visible: bool,
        observer: &mut O,
    ) {
        let &Context {
            scene,
            theta,
            settings,
            shifts,
            caustics,
            progress,
        } = context;
        let depth = self.depth;

        // ---- Light sampled at the last vertex ----
        if self.shadow.take().is_some() && visible {
            self.l += self.direct;
            if let Some(light) = self.sampled.take() {
                observer.sampled(depth - 1, light);
                if let Some(aimed) = self.aimed.get() {
                    observer.aimed(aimed);
                }
            }
        }
        let Some(ray) = self.ray.take() else {
            return;
        };
        let beta = self.beta;
        // What no derivative needs is not looked at.
        let wanted = !O::ENABLED || self.followed || observer.follows_light();
        let lit = wanted && !self.left_out.1;

        // ---- Emission ----
        let emitters = match &hit {
            Some(hit) => scene.shape_info(hit.shape).emitter.as_slice(),
            None => scene.infinite_emitters(),
        };
        if lit && !emitters.is_empty() {
            let end = hit.map(|hit| (hit.prim, hit.si));
            self.find_lights(context, emitters, ray.d, end, observer);
        }
        let Some(Intersection { shape, si, .. }) = hit else {
            return;
        };
        let info = scene.shape_info(shape);
        if depth >= settings.max_depth {
            return;
        }

        let material = scene.material(shape);
        let wo = si.frame.to_local(-ray.d);
        let uv = Vec2::new(S::Bsdf::embed(si.uv.x), S::Bsdf::embed(si.uv.y));
        let at = Shading { theta: *theta, uv };
        let wo_r = S::Bsdf::embed3(wo);
        if O::ENABLED {
            observer.vertex(depth, beta, shape, uv, wo_r, S::Bsdf::embed3(si.p));
        }
        let differentiates = O::ENABLED || !R::IS_PRIMAL;
        let follows = !O::ENABLED || observer.follows(info.material);
        self.followed |= follows;
        if depth == 1 {
            self.left_out.0 = caustics == Caustics::Particles && !info.glossy;
        }
        self.left_out.1 = self.left_out.0 && info.glossy;
        let lit = (wanted || follows) && !self.left_out.1;
        // With one edge more there may be light, or vertices to find it from.
        let goes_on = lit || depth + 1 < settings.max_depth;
        let splits = S::Bsdf::DIFFERENTIAL
            && differentiates
            && goes_on
            && (!O::ENABLED || observer.follows_normals(info.material))
            && material.has_differential()
            && (R::IS_PRIMAL || roughness_moves(material, theta));
        let sampler = &mut self.sampler;
        let dim = CAMERA_DIMENSIONS + (depth - 1) * BOUNCE_DIMENSIONS;
        let guide = match const { is_guided::<S>() } && !info.glossy {
            true => (scene.guide()).and_then(|guide| guide.at(si.p.primal())),
            false => None,
        };

        // ---- Emitter sampling ----
        if S::SAMPLES_EMITTERS && lit && !info.delta && !scene.emitters().is_empty() {
            sampler.seek(dim);
            let p = si.p.primal();
            let choice = sampler.next_bits();
            let u = sampler.next_2d();
            let (emitter, kept) = match settings.lights {
                // The only light needs no number; the branch is always predicted.
                _ if scene.emitters().len() == 1 => (0, R::Primal::one()),
                LightChoice::One => (scene.shares().choose(choice, 1).0 as u32, R::Primal::one()),
                LightChoice::All => {
                    let seen = Seen {
                        material,
                        at: at.primal(),
                        frame: si.primal().frame,
                        wo: wo.primal(),
                    };
                    weigh_lights(scene, p, &seen, S::COUNTS_HITS, choice, u)
                }
            };
            let e = &scene.emitters()[emitter as usize];
            let share = settings.lights.share(scene, emitter);
            let sample = e.sample(scene.lights(), p, u).map(|mut sample| {
                sample.pdf *= share;
                sample
            });
            if let Some(sample) = sample
                && sample.pdf > R::Primal::zero()
            {
                // Where the vertex moves, its direction to the point on the light does.
                let seen = (!Geometry::<S, R>::IS_PRIMAL).then(|| e.connect(&sample, si.p));
                let d = seen.map_or(Vec3::lift(sample.d), |s| s.d);
                let wi = si.frame.to_local(d);
                let (f, mut pdf) = material.eval_pdf(&at, wo_r, S::Bsdf::embed3(wi), MODE);
                if let Some(guide) = guide {
                    pdf = mixed(pdf, guide.pdf(sample.d));
                }
                // Where the derivative may be non-zero although the value is (zero albedo).
                let matters = !f.is_black()
                    || (O::ENABLED && pdf.primal() > R::Primal::zero())
                    || has_tangent(f);
                if matters {
                    let shadow = si
                        .primal()
                        .shadow_ray(sample.d, sample.distance, info.offset);
                    let (pdf_light, emission) = match seen {
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
                    let mis = if S::COUNTS_HITS && !e.is_delta() {
                        let pdf = if S::FROZEN_WEIGHTS && !R::IS_PRIMAL {
                            frozen_pdf(material, &at, wo_r, S::Bsdf::embed3(wi))
                        } else {
                            pdf
                        };
                        S::weight_sampled(pdf_light, pdf)
                    } else {
                        R::one()
                    };
                    let weight = if Geometry::<S, R>::IS_PRIMAL {
                        mis * Const(kept / sample.pdf)
                    } else {
                        mis / pdf_light * Const(kept)
                    };
                    self.shadow = Some(shadow);
                    self.direct = beta * f * le * weight;
                    if S::Aim::KEEPS && differentiates {
                        let aimed = Aimed {
                            u,
                            frame: si.frame.primal(),
                            share,
                            kept,
                        };
                        let shift = shifts.get(emitter as usize).and_then(Option::as_ref);
                        if let (Some(map), Some(shift)) = (e.moving(), shift)
                            && let Some(aim) = map.aim(u)
                        {
                            let moved = map.follow(&aim, theta, shift);
                            self.direct = beta
                                * aimed_light(
                                    scene,
                                    material,
                                    &at,
                                    wo_r,
                                    &aimed,
                                    emitter,
                                    &moved,
                                    &Weighing::of::<S>(),
                                );
                        }
                        let moves = O::ENABLED && e.moving().is_some();
                        self.aimed.put(moves.then_some(aimed));
                    }
                    let normals_weight = splits.then(|| {
                        let mis = if S::COUNTS_HITS && !e.is_delta() {
                            let (at, wo, wi) = (at.primal(), wo.primal(), wi.primal());
                            let pair = material.pdf_differential(&at, wo, wi);
                            S::weight_sampled(sample.pdf, pair)
                        } else {
                            R::Primal::one()
                        };
                        R::lift(mis * kept / sample.pdf)
                    });
                    if let (Some(w), false) = (normals_weight, R::IS_PRIMAL) {
                        let change = material.eval_normals(&at, wo.primal(), wi.primal(), MODE);
                        self.direct += beta * change * le * (w - weight);
                    }
                    if O::ENABLED {
                        self.sampled = Some(SampledLight {
                            emitter,
                            emission,
                            wi: S::Bsdf::embed3(wi),
                            le,
                            weight,
                            f,
                            normals_weight,
                            kept,
                            mis_pdf: if S::COUNTS_HITS && !e.is_delta() {
                                sample.pdf
                            } else {
                                R::Primal::zero()
                            },
                        });
                    }
                }
            }
        }

        // ---- Samples of the derivative of normals ----
        // The constant again: where nothing splits, the path of a sample is not even compiled.
        if S::Bsdf::DIFFERENTIAL && splits && !beta.is_black() {
            let first = AUXILIARY_DIMENSIONS + depth * BOUNCE_DIMENSIONS;
            let (at, wo) = (at.primal(), wo.primal());
            let context = Context {
                scene,
                theta: &theta.primal(),
                settings,
                shifts: &[],
                caustics,
                progress,
            };
            sampler.seek(first);
            let u = sampler.next_3d();
            let pair = material.sample_differential(&at, wo, u, MODE);
            for sample in pair.into_iter().flatten() {
                let change = match R::IS_PRIMAL {
                    true => Rgb::black(),
                    false => {
                        material.eval_normals(&Shading { theta: *theta, uv }, wo, sample.wi, MODE)
                    }
                };
                if !O::ENABLED && !has_tangent(change) {
                    continue;
                }
                // From here on both are ordinary paths of this throughput, made of the same numbers: what
                // they find is alike, and its noise cancels.
                let d = si.primal().frame.to_world(sample.wi);
                let ray = si.primal().spawn_ray(d, info.offset);
                let mut walk = Walk::<R::Primal, S, X> {
                    beta: beta.primal(),
                    pdf_bsdf: sample.pdf,
                    from: Vec3::lift(si.p.primal()),
                    depth: depth + 1,
                    eta: self.eta * sample.eta,
                    left_out: self.left_out,
                    ..Walk::new(Ray::lift(ray), *sampler)
                };
                walk.go(&context, &mut ());
                if O::ENABLED {
                    observer.walked(walk.depth - depth);
                }
                if walk.l.is_black() {
                    continue;
                }
                let li = Rgb::lift(walk.l.scale(sample.pdf.recip()));
                if !R::IS_PRIMAL {
                    self.l += change * li;
                }
                if O::ENABLED {
                    let wi = Vec3::lift(sample.wi);
                    observer.normals(NormalsLight { wi, li });
                }
            }
        }

        // ---- BSDF sampling ----
        self.depth = depth + 1;
        if !goes_on {
            return;
        }
        sampler.seek(dim + 3);
        let u = sampler.next_3d();
        let scattered = match guide {
            None => S::Bsdf::scatter(material, &at, wo, u, MODE),
            Some(guide) => {
                let frame = si.frame.primal();
                guided::<R, S>(guide, material, &at, &frame, wo, u)
            }
        };
        let Some((sample, f)) = scattered else {
            return;
        };
        let wi = S::Bsdf::embed3(sample.wi);
        let pdf = S::Bsdf::embed(sample.pdf);
        let mut weight = match const { S::ATTACHED_CHOICE } && !R::IS_PRIMAL {
            true => (material.choice_pdf(&at, wo_r, wi, sample.component, MODE)).recip(),
            false => pdf.recip(),
        };

        // ---- Update ----
        self.eta *= sample.eta;
        let mut next_beta = beta * f * weight;
        let mut lives = R::Primal::one(); // one over the probability of that

        // ---- Roulette ----
        self.survival = if differentiates {
            let step = (f.primal() * weight.primal()).max_component();
            self.survival * step.max(R::Primal::of(LEAST_STEP))
        } else {
            next_beta.primal().max_component()
        };
        if depth >= settings.rr_depth {
            let q = (self.survival * self.eta * self.eta).min(R::Primal::of(MAX_SURVIVAL));
            if sampler.next_1d::<R::Primal>() >= q {
                return;
            }
            let inv_q = q.recip();
            self.survival *= inv_q;
            lives = inv_q;
            weight = weight * Const(inv_q);
            next_beta = next_beta.scale(inv_q);
            if S::ATTACHED_ROULETTE {
                let c = next_beta.primal();
                let largest = (0..3).fold(0, |m, i| if c[i] > c[m] { i } else { m });
                let p = c[largest] * q * self.eta * self.eta;
                if p > R::Primal::zero() && p < R::Primal::of(MAX_SURVIVAL) {
                    // One, with the tangent of one over a moving probability.
                    if !R::IS_PRIMAL {
                        let factor = next_beta[largest].recip() * Const(c[largest]);
                        weight *= factor;
                        next_beta = next_beta * factor;
                    }
                    observer.survives(largest);
                }
            }
        }
        // Deltas have no distribution of normals.
        let part = match sample.component {
            Component::Continuous if splits => Part::Rest,
            _ => Part::All,
        };
        if follows_edges::<S>() {
            let followed = differentiates && follows && Edges::of::<S>().contain(sample.component);
            self.departure.put(followed.then(|| {
                let from = Departure {
                    material: info.material,
                    offset: info.offset,
                    si: si.primal(),
                    wo: wo.primal(),
                    u,
                    survival: lives,
                    part,
                };
                (from, beta)
            }));
        }
        if O::ENABLED {
            observer.bounce(Bounce {
                wi,
                component: sample.component,
                weight,
                f,
                part,
            });
        }
        self.beta = match part {
            Part::Rest if !R::IS_PRIMAL => {
                let change = material.eval_normals(&at, wo.primal(), wi.primal(), MODE);
                next_beta - beta * change * weight
            }
            _ => next_beta,
        };
        if !O::ENABLED && next_beta.is_black() && !has_tangent(next_beta) {
            return;
        }
        self.pdf_bsdf = match sample.component {
            Component::Continuous if S::FROZEN_WEIGHTS && !R::IS_PRIMAL => {
                frozen_pdf(material, &at, wo_r, wi)
            }
            Component::Continuous => pdf,
            Component::Delta { .. } => R::zero(),
        };
        self.from = si.p;
        let d = si.frame.to_world(sample.wi);
        if O::ENABLED {
            observer.departs(d.primal());
        }
        let ray = si.spawn_ray(d, info.offset);
        // The last edge only looks for light, and only where light that is hit counts.
        let last = self.depth >= settings.max_depth;
        let delta = self.pdf_bsdf.primal() == R::Primal::zero();
        let counts = S::COUNTS_HITS || !S::SAMPLES_EMITTERS || delta;
        if !last || (counts && scene.may_meet_light(&ray.primal())) {
            self.ray = Some(ray);
        }
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
            ..
        }: &Context<R>,
        emitters: &[u32],
        d: Vec3<Geometry<S, R>>,
        end: Option<(u32, SurfaceInteraction<Geometry<S, R>>)>,
        observer: &mut O,
    ) {
        let (depth, beta) = (self.depth, self.beta);
        // How light here could have been sampled at the start of the edge.
        let (pdf_bsdf, from) = (self.pdf_bsdf, self.from);
        let sampled = S::SAMPLES_EMITTERS && depth > 1 && pdf_bsdf.primal() > R::Primal::zero();
        // Whether the edge is not differentiated like the rest of the path.
        let follows = const { follows_edges::<S>() } && self.departure.get().is_some();
        let mut lights = SmallVec::<[FoundLight<R::Primal>; 1]>::new();
        for &emitter in emitters {
            let share = settings.lights.share(scene, emitter);
            let rival = Rival {
                pdf_bsdf,
                from,
                share,
            };
            let (si, rival) = (end.map(|(_, si)| si), sampled.then_some(rival));
            let found = find_light::<R, S>(scene, theta, emitter, d, si, rival);
            let Some((light, le)) = found else {
                continue;
            };
            if follows {
                lights.push(FoundLight {
                    emitter,
                    emission: light.emission.primal(),
                    share,
                });
            }
            if !follows || R::IS_PRIMAL {
                self.l += beta * le * light.weight;
            }
            if O::ENABLED {
                observer.light(depth, beta, light);
            }
        }
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
                observer.followed(found);
            }
        }
    }
}

/// What a ray in direction `d` receives from an emitter it hit at `si`, or missed everything towards:
/// where, with which MIS weight, and the radiance. `sampled` if the vertex it left also sampled emitters.
///
/// A call of its own, by value: lights are seldom hit, and references to the loop's state would keep
/// that in memory.
#[inline(never)]
pub(super) fn find_light<R: Real, S: Strategy>(
    scene: &Scene,
    theta: &Theta<R>,
    emitter: u32,
    d: Vec3<Geometry<S, R>>,
    si: Option<SurfaceInteraction<Geometry<S, R>>>,
    sampled: Option<Rival<R, Geometry<S, R>>>,
) -> Option<(HitLight<R>, Rgb<R>)> {
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
            S::weight_hit(rival.pdf_bsdf, S::Bsdf::embed(pdf) * Const(rival.share))
        }
        None => R::one(),
    };
    let light = HitLight {
        emitter,
        emission,
        weight,
    };
    Some((light, e.eval(theta, &emission)))
}

/// Whether a [`Guide`](crate::guide::Guide) may lead scattered directions: only if neither they nor weights move, nor
/// what they are divided by.
pub(crate) const fn is_guided<S: Strategy>() -> bool {
    S::Bsdf::DETACHED_PATH && !S::FROZEN_WEIGHTS && !follows_edges::<S>() && !S::ATTACHED_CHOICE
}

/// Density of a direction of which the guide draws its part and the material the rest.
#[inline(always)]
pub(super) fn mixed<R: Real>(material: R, guide: R::Primal) -> R {
    let part = R::Primal::of(PART_GUIDED);
    material * Const(R::Primal::one() - part) + Const(guide * part)
}

/// A direction scattered by the material, which is diffuse and so without deltas, or drawn from the guide. The first
/// random number decides.
#[inline(never)]
pub(super) fn guided<R: Real, S: Strategy>(
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
pub(super) fn frozen_pdf<R: Real>(
    material: &Material,
    at: &Shading<R>,
    wo: Vec3<R>,
    wi: Vec3<R>,
) -> R {
    let theta = at.theta.primal().lift();
    material
        .eval_pdf(&Shading { theta, uv: at.uv }, wo, wi, MODE)
        .1
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

#[inline]
fn has_tangent<R: Real>(c: Rgb<R>) -> bool {
    !R::IS_PRIMAL && (c.r.has_tangent() || c.g.has_tangent() || c.b.has_tangent())
}

/// What the weight of a light that was hit, but could have been sampled, depends on.
#[derive(Clone, Copy)]
pub(super) struct Rival<R: Real, G> {
    /// Density of the direction.
    pub pdf_bsdf: R,
    /// The vertex it left.
    pub from: Vec3<G>,
    /// The emitter's share there.
    pub share: R::Primal,
}

/// A vertex as lights see it.
pub(super) struct Seen<'a, P: Float> {
    pub material: &'a Material,
    pub at: Shading<'a, P>,
    pub frame: Frame<P>,
    pub wo: Vec3<P>,
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
pub(super) fn weigh_lights<P: Float>(
    scene: &Scene,
    from: Vec3<P>,
    seen: &Seen<P>,
    counts_hits: bool,
    choice: u64,
    u: [P; 2],
) -> (u32, P) {
    // One number, used up bit by bit: whether by light, then which.
    let choice = f64::from_bits_unit(choice);
    let by_light = choice >= LEAST_KEPT;
    let mut rest = match by_light {
        true => (choice - LEAST_KEPT) / (1.0 - LEAST_KEPT),
        false => choice / LEAST_KEPT,
    };
    let mut kept = (0, 0.0);
    let (mut total, mut found) = (0.0, 0.0);
    for (i, e) in scene.emitters().iter().enumerate() {
        let Some(sample) = e.sample(scene.lights(), from, u) else {
            continue;
        };
        let wi = seen.frame.to_local(sample.d);
        let (f, pdf) = (seen.material).eval_pdf(&seen.at, seen.wo, wi, MODE);
        let density = match counts_hits && !e.is_delta() {
            true => sample.pdf + pdf,
            false => sample.pdf,
        };
        let light = (f * e.eval(&seen.at.theta, &sample.emission)).sum() / density;
        // Zero over zero, where the sample is worth nothing.
        let light = Some(light.to_f64())
            .filter(|l| l.is_finite())
            .unwrap_or(0.0);
        total += light;
        found += 1.0;
        let p = match by_light && total > 0.0 {
            true => light / total,
            false => 1.0 / found,
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
