//! The path tracer.

use ad_core::{Const, Float, Real, Vec2, Vec3};

use crate::bsdf::{Bsdf, Component, Shading, TransportMode};
use crate::emitter::{Emission, Emitter, EmitterSample};
use crate::estimator::{Sampling, Strategy};
use crate::math::{Ray, Rgb};
use crate::params::Theta;
use crate::sampler::{BOUNCE_DIMENSIONS, CAMERA_DIMENSIONS, Sampler};
use crate::scene::{Intersection, Scene, Settings};
use crate::shape::SurfaceInteraction;

/// Probability of surviving Russian roulette is at most this.
const MAX_SURVIVAL: f64 = 0.95;

/// When derivatives are wanted, a vertex counts as reflecting at least this much for roulette: at zero
/// albedo the throughput vanishes, but the derivative behind that vertex does not (F7).
const LEAST_STEP: f64 = 0.2;

/// Scalar of the geometry of a strategy.
pub type Geometry<S, R> = <<S as Strategy>::Bsdf as Sampling>::Geometry<R>;

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
pub struct SampledLight<R> {
    /// Index of the emitter.
    pub emitter: u32,
    /// Where on it.
    pub emission: Emission<R>,
    /// Direction to it, local frame of the vertex.
    pub wi: Vec3<R>,
    /// Emitted radiance.
    pub le: Rgb<R>,
    /// MIS weight over density.
    pub weight: R,
    /// Value of the BSDF.
    pub f: Rgb<R>,
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
}

/// Follows a path as it grows. All methods do nothing by default.
pub trait Observer<R: Real> {
    /// Whether events are wanted; if not, none is made.
    const ENABLED: bool = true;
    /// The path found light at its current end.
    fn light(&mut self, _depth: u32, _beta: Rgb<R>, _light: HitLight<R>) {}
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
    /// The path goes on from the current vertex.
    fn bounce(&mut self, _bounce: Bounce<R>) {}
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
    };
    let mut walk = Walk::<R, S, X>::new(ray, sampler);
    while !walk.ended() {
        let hit = walk.ray.and_then(|ray| scene.intersect(&ray));
        let visible = walk
            .shadow
            .is_some_and(|(ray, t_max)| !scene.occluded(&ray, t_max));
        walk.step(&context, hit, visible, observer);
    }
    walk.l
}

/// A path between two vertices. It asks for its rays to be traced and goes on with the answers, so that
/// the rays of many paths can be traced together.
///
/// Depth counts edges: a light that is seen has depth 1, direct light 2. Dimensions of the
/// sampler: [`CAMERA_DIMENSIONS`] for the camera, then [`BOUNCE_DIMENSIONS`] per vertex (light
/// choice, light position 2, BSDF 3, roulette).
///
/// # Derivatives
/// In theta, as the strategy says. Discrete decisions (light, lobe, roulette) are primal.
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
    from: Vec3<R::Primal>,
    /// What roulette goes by.
    survival: R::Primal,
    /// Number of edges with the next one.
    depth: u32,
    /// What comes through the shadow ray if it is free, and its record for the observer.
    direct: Rgb<R>,
    sampled: Option<SampledLight<R>>,
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
            survival: R::Primal::one(),
            depth: 1,
            direct: Rgb::black(),
            sampled: None,
        }
    }

    /// Whether no ray is asked for.
    #[inline(always)]
    pub fn ended(&self) -> bool {
        self.ray.is_none() && self.shadow.is_none()
    }

    /// Goes on to the next vertex: `hit` is what [`Walk::ray`] met, `visible` whether
    /// [`Walk::shadow`] was free.
    #[inline]
    pub fn step<O: Observer<R>>(
        &mut self,
        &Context {
            scene,
            theta,
            settings,
        }: &Context<R>,
        hit: Option<Intersection<Geometry<S, R>>>,
        visible: bool,
        observer: &mut O,
    ) {
        let mode = TransportMode::Radiance;
        let depth = self.depth;

        // ---- Light sampled at the last vertex ----
        if self.shadow.take().is_some() && visible {
            self.l += self.direct;
            if let Some(light) = self.sampled.take() {
                observer.sampled(depth - 1, light);
            }
        }
        let Some(ray) = self.ray.take() else {
            return;
        };
        let beta = self.beta;

        // ---- Emission ----
        // How the light at the end of this edge could have been sampled at its start.
        let sampled =
            (S::SAMPLES_EMITTERS && depth > 1 && self.pdf_bsdf.primal() > R::Primal::zero())
                .then_some((self.pdf_bsdf, self.from));
        let Some(Intersection { shape, si }) = hit else {
            for &e in scene.infinite_emitters() {
                if let Some((light, le)) = find_light::<R, S>(scene, theta, e, ray.d, None, sampled)
                {
                    self.l += beta * le * light.weight;
                    if O::ENABLED {
                        observer.light(depth, beta, light);
                    }
                }
            }
            return;
        };
        let info = scene.shape_info(shape);
        if let Some(e) = info.emitter {
            let found = find_light::<R, S>(scene, theta, e, ray.d, Some(si), sampled);
            if let Some((light, le)) = found {
                self.l += beta * le * light.weight;
                if O::ENABLED {
                    observer.light(depth, beta, light);
                }
            }
        }
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
        let sampler = &mut self.sampler;
        let dim = CAMERA_DIMENSIONS + (depth - 1) * BOUNCE_DIMENSIONS;

        // ---- Emitter sampling ----
        if S::SAMPLES_EMITTERS && !material.is_delta() && !scene.emitters().is_empty() {
            sampler.seek(dim);
            let p = si.p.primal();
            if let Some(light) = sample_light(scene, p, sampler) {
                let sample = light.sample;
                let wi = si.frame.to_local(Vec3::lift(sample.d));
                let (f, pdf) = material.eval_pdf(&at, wo_r, S::Bsdf::embed3(wi), mode);
                // Where the derivative may be non-zero although the value is (zero albedo).
                let matters = !f.is_black()
                    || (O::ENABLED && pdf.primal() > R::Primal::zero())
                    || has_tangent(f);
                if matters {
                    let shadow = si
                        .primal()
                        .shadow_ray(sample.d, sample.distance, info.offset);
                    let e = &scene.emitters()[light.emitter as usize];
                    let emission = Emission {
                        uv: Vec2::lift(sample.emission.uv),
                        falloff: R::lift(sample.emission.falloff),
                    };
                    let le = e.eval(theta, &emission);
                    let mis = if S::COUNTS_HITS && !e.is_delta() {
                        S::weight(R::lift(sample.pdf), pdf)
                    } else {
                        R::one()
                    };
                    let weight = mis * Const(sample.pdf.recip());
                    self.shadow = Some(shadow);
                    self.direct = beta * f * le * weight;
                    if O::ENABLED {
                        self.sampled = Some(SampledLight {
                            emitter: light.emitter,
                            emission,
                            wi: S::Bsdf::embed3(wi),
                            le,
                            weight,
                            f,
                        });
                    }
                }
            }
        }

        // ---- BSDF sampling ----
        self.depth = depth + 1;
        sampler.seek(dim + 3);
        let Some(sample) = S::Bsdf::draw(material, &at, wo, sampler.next_3d(), mode) else {
            return;
        };
        let wi = S::Bsdf::embed3(sample.wi);
        let f = material.eval_component(&at, wo_r, wi, sample.component, mode);
        let pdf = S::Bsdf::embed(sample.pdf);
        let mut weight = pdf.recip();

        // ---- Update ----
        self.eta *= sample.eta;
        let mut next_beta = beta * f * weight;

        // ---- Roulette ----
        let differentiates = O::ENABLED || !R::IS_PRIMAL;
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
            weight = weight * Const(inv_q);
            next_beta = next_beta.scale(inv_q);
        }
        if O::ENABLED {
            observer.bounce(Bounce {
                wi,
                component: sample.component,
                weight,
                f,
            });
        }
        self.beta = next_beta;
        if !O::ENABLED && next_beta.is_black() && !has_tangent(next_beta) {
            return;
        }
        self.pdf_bsdf = match sample.component {
            Component::Continuous => pdf,
            Component::Delta { .. } => R::zero(),
        };
        self.from = si.p.primal();
        self.ray = Some(si.spawn_ray(si.frame.to_world(sample.wi), info.offset));
    }
}

/// What a ray in direction `d` receives from an emitter it hit at `si`, or missed everything towards:
/// where, with which MIS weight, and the radiance. `sampled` is the density of the direction and the
/// vertex it left, if that vertex also sampled emitters.
///
/// A call of its own, by value: lights are seldom hit, and references to the loop's state would keep
/// that in memory.
#[inline(never)]
fn find_light<R: Real, S: Strategy>(
    scene: &Scene,
    theta: &Theta<R>,
    emitter: u32,
    d: Vec3<Geometry<S, R>>,
    si: Option<SurfaceInteraction<Geometry<S, R>>>,
    sampled: Option<(R, Vec3<R::Primal>)>,
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
        Some((pdf_bsdf, from)) => {
            let si = si.map(|si| si.primal());
            let pdf = e.pdf(scene.lights(), from, d.primal(), si.as_ref());
            S::weight(
                pdf_bsdf,
                R::lift(pdf * scene.emitter_probability::<R::Primal>()),
            )
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

#[inline]
fn has_tangent<R: Real>(c: Rgb<R>) -> bool {
    !R::IS_PRIMAL && (c.r.has_tangent() || c.g.has_tangent() || c.b.has_tangent())
}

/// A sampled light; the density includes the choice.
struct LightSample<P> {
    emitter: u32,
    sample: EmitterSample<P>,
}

/// 64 random bits as an index below `n`, at most 2^32.
#[inline]
fn index_below(bits: u64, n: usize) -> usize {
    (((bits >> 32) * n as u64) >> 32) as usize
}

/// Chooses an emitter uniformly and samples it.
#[inline(always)]
fn sample_light<P: Float, X: Sampler>(
    scene: &Scene,
    from: Vec3<P>,
    sampler: &mut X,
) -> Option<LightSample<P>> {
    let n = scene.emitters().len();
    let choice = sampler.next_bits();
    // The only light needs no number; the branch is always predicted.
    let emitter = if n == 1 { 0 } else { index_below(choice, n) };
    let mut sample =
        scene.emitters()[emitter].sample(scene.lights(), from, sampler.next_2d::<P>())?;
    sample.pdf *= scene.emitter_probability::<P>();
    (sample.pdf > P::zero()).then_some(LightSample {
        emitter: emitter as u32,
        sample,
    })
}
