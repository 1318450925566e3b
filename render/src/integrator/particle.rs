//! The light tracer: particles from the emitters, connected to the pinhole at every vertex.
//!
//! ```
//! use render::Job;
//! use render::bsdf::kernel::Rules;
//! use render::instances::{Estimator, particles_f32, render_f32};
//! use render::params::Theta;
//!
//! let room = render::scene::room(16, 16)?;
//! let theta = Theta::constant(room.params().values());
//! let job = Job::new(&room, &room.settings, 1, 0..64, &());
//! let particles = particles_f32(&job, &theta, Rules::default())?.image(0);
//! let paths = render_f32(&job, &theta, Estimator::Mis).image(0);
//! let mean = |data: &[f32]| data.iter().sum::<f32>() / data.len() as f32;
//! assert!((mean(&particles.data) / mean(&paths.data) - 1.0).abs() < 0.1); // within their noise
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::ops::Range;

use ad_core::{Float, Real, Vec2, Vec3};

use super::lockstep::{self, GROUP, Traveller};
use super::progress::Progress;
use super::projection_map::turn_to_casters;
use super::record::{
    Bounce, Contribution, EmittedLight, NormalsLight, Observer, Place, SeenVertex,
};
use super::rendering::{Components, NonFinite, Rendering};
use super::sink::check_values;
use super::vertex::light::{has_tangent, matters};
use super::vertex::normals::{has_pair, normals_pair};
use super::vertex::roulette::{play, probability, roulette_weight};
use super::vertex::{assert_finite, has_more, part_of};
use crate::bsdf::differential::Part;
use crate::bsdf::kernel::{Rules, kernel_weight};
use crate::bsdf::{Bsdf, Component, Material, Shading, TransportMode};
use crate::camera::Pinhole;
use crate::emitter::{Ball, Emission, Emitter};
use crate::error::RenderError;
use crate::manifold::Statistics;
use crate::math::{NOWHERE, Ray, Rgb, Segment};
use crate::parallel;
use crate::params::Theta;
use crate::sampler::{Family, Purpose, Sampler};
use crate::scene::{Intersection, Scene, Settings};
use crate::shape::{Exit, SurfaceInteraction};

/// Particles of one job.
const CHUNK: u64 = 1024;
/// Jobs whose splats are kept until they are added to the image, in order.
const CHUNKS: u64 = 64;
/// The image's rows are split into at most this many bands, to which splats are added in parallel.
const BANDS: usize = 16;

const MODE: TransportMode = TransportMode::Importance;

/// What stays the same from particle to particle.
#[derive(Clone, Copy, Debug)]
pub struct Context<'a, R: Real> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its parameters.
    pub theta: &'a Theta<'a, R>,
    /// Depths; edges of the whole path, the one to the camera included.
    pub settings: &'a Settings,
    /// How particles scatter.
    pub rules: Rules,
    /// What they are seen through.
    pub pinhole: Pinhole<R::Primal>,
    /// Where particles from environments start.
    pub ball: Option<Ball>,
    /// Whether only [`crate::scene::Caustics`] count.
    pub caustics_only: bool,
    /// Whether derivatives through the distribution of normals have samples of their own where particles
    /// scatter, as [`crate::estimator::Differential`] has.
    pub differential: bool,
    /// Particles per sample: one per pixel of the full film, or fewer where they find caustics only.
    pub per_sample: u64,
    /// Asked now and then whether particles are to be followed any further, as
    /// [`super::path::Context::progress`].
    pub(crate) progress: &'a dyn Progress,
}

impl<'a, R: Real> Context<'a, R> {
    /// With the correct rules.
    ///
    /// # Errors
    /// Another number of values than the scene has, or a scene that particles see otherwise than paths do ([`check`]).
    pub fn new(
        scene: &'a Scene,
        theta: &'a Theta<'a, R>,
        settings: &'a Settings,
    ) -> Result<Self, RenderError> {
        check_values(scene, theta)?;
        check(scene)?;
        Ok(Self::unchecked(scene, theta, settings))
    }

    /// [`Context::new`] of a scene of which it is known that particles see it as paths do.
    pub(super) fn unchecked(
        scene: &'a Scene,
        theta: &'a Theta<'a, R>,
        settings: &'a Settings,
    ) -> Self {
        let ball = match scene.infinite_emitters() {
            [] => None,
            _ => Ball::around(scene.shapes()),
        };
        Self {
            scene,
            theta,
            settings,
            rules: Rules::default(),
            pinhole: scene.camera.pinhole(&scene.film),
            ball,
            caustics_only: false,
            differential: false,
            per_sample: pixels(scene),
            progress: &(),
        }
    }

    /// For the light that paths leave to particles: they leave none where normals are flipped.
    pub(super) fn caustics(
        scene: &'a Scene,
        theta: &'a Theta<'a, R>,
        settings: &'a Settings,
    ) -> Self {
        let n = settings.pixels_per_particle.max(1);
        Self {
            caustics_only: true,
            per_sample: pixels(scene).div_ceil(n.into()),
            ..Self::unchecked(scene, theta, settings)
        }
    }
}

/// Whether particles see the scene as paths do.
///
/// # Errors
/// Normals that are flipped to the viewer, whom particles do not know; a camera that is no pinhole.
pub fn check(scene: &Scene) -> Result<(), RenderError> {
    if !scene.camera.is_pinhole() {
        return Err(RenderError::NoPinhole);
    }
    if scene.flips_normals() {
        Err(RenderError::FlippedNormals)
    } else {
        Ok(())
    }
}

/// Follows a particle.
pub trait ParticleObserver<R: Real>: Observer<R> {
    /// Whether vertices are connected to the camera.
    const CONNECTS: bool = true;
    /// What light at a point of the full film is worth.
    fn importance(&self, _at: [R::Primal; 2]) -> Rgb<R::Primal> {
        Rgb::black()
    }
}

impl<R: Real> ParticleObserver<R> for () {}

/// The record of a connection to the camera on the way to be tested.
#[derive(Clone, Copy, Debug)]
enum Pending<R: Real> {
    /// Of the emitter that the particle starts at: its index, where on it, and what a unit of its light is worth there.
    Emitter(u32, Emission<R>, R::Primal),
    /// Of the current vertex; the importance is that of a unit of light on the film.
    Vertex(SeenVertex<R>),
}

/// A particle between two vertices, which asks for its rays to be traced, as a
/// [`super::path::Walk`] does.
///
/// Depth counts the edges of the whole path: a light that the camera sees has depth 1, a particle seen at
/// its first surface 2.
///
/// # Derivatives
/// In theta, with detached sampling: emission and scattering over `R`, everything geometric over its primal.
///
/// # Does not handle
/// Deltas at the camera's end: what is seen in mirrors, through glass or through masks. A pinhole
/// receives nothing from there (see [`super::density`]).
///
/// # Reference
/// [Veach 1996, section 3.2 and footnote 20]; [Zeltner 2021, section 2.5.3].
#[derive(Clone, Copy, Debug)]
pub struct Particle<R: Real, X: Sampler> {
    ray: Option<Ray<R::Primal>>,
    shadow: Option<Segment<R::Primal>>,
    /// What the film receives if the shadow ray is free, where, and its record for the observer.
    value: Rgb<R>,
    film: [R::Primal; 2],
    pending: Option<Pending<R>>,
    sampler: X,
    beta: Rgb<R>,
    roulette_weight: R::Primal,
    depth: u32,
}

/// A surface that a particle has reached.
struct Here<'a, R: Real> {
    material: &'a Material,
    exit: Exit,
    si: &'a SurfaceInteraction<R::Primal>,
    at: Shading<'a, R>,
    /// Geometric normal, local frame.
    n_geo: Vec3<R::Primal>,
    /// Direction that the particle came from, local frame.
    wo: Vec3<R::Primal>,
}

impl<'a, R: Real> Here<'a, R> {
    #[inline(always)]
    fn new(
        context: &Context<'a, R>,
        ray: &Ray<R::Primal>,
        hit: &'a Intersection<R::Primal>,
    ) -> Self {
        let si = &hit.si;
        Self {
            material: context.scene.material(hit.shape),
            exit: context.scene.exit(hit.prim),
            si,
            at: Shading::new(*context.theta, Vec2::lift(si.uv)),
            n_geo: si.local_geometric_normal(),
            wo: si.frame.to_local(-ray.d),
        }
    }
}

/// Direction to the pinhole, distance, film position, importance over squared distance.
#[inline(always)]
fn towards_camera<P: Float>(pinhole: &Pinhole<P>, p: Vec3<P>) -> Option<(Vec3<P>, P, [P; 2], P)> {
    let v = p - pinhole.origin;
    let (at, weight) = pinhole.project_point(v)?;
    let distance = v.length();
    Some((-v * distance.recip(), distance, at, weight))
}

impl<R: Real, X: Sampler> Particle<R, X> {
    /// Without a ray to trace, after so many edges.
    #[inline(always)]
    fn waiting(sampler: X, beta: Rgb<R>, depth: u32) -> Self {
        Self {
            ray: None,
            shadow: None,
            value: Rgb::black(),
            film: [R::Primal::zero(); 2],
            pending: None,
            sampler,
            beta,
            roulette_weight: R::Primal::one(),
            depth,
        }
    }

    /// Sends a particle from one of the emitters. Without emitters, or where nothing is emitted, it
    /// has ended already.
    #[inline]
    pub fn new<O: ParticleObserver<R>>(context: &Context<R>, sampler: X, observer: &mut O) -> Self {
        let scene = context.scene;
        let mut this = Self::waiting(sampler, Rgb::black(), 0);
        let n = scene.emitters().len();
        if n == 0 {
            return this;
        }
        // The caster to turn to, if there is one, is chosen with the emitter, from one number.
        let targets = if context.caustics_only {
            scene.casters()
        } else {
            &[]
        };
        let per_emitter = targets.len().max(1);
        let sampler = &mut this.sampler;
        let (index, target) = match n * per_emitter {
            1 => (0, 0),
            _ => scene.shares().choose(sampler.next_bits(), per_emitter),
        };
        let [a, b] = sampler.next_2d::<R::Primal>();
        let [c, d] = sampler.next_2d::<R::Primal>();
        let e = &scene.emitters()[index];
        let inverse_choice = R::Primal::of(scene.shares().of(index)).recip();
        let lift = |e: Emission<R::Primal>| Emission {
            uv: Vec2::lift(e.uv),
            falloff: R::lift(e.falloff),
        };

        // ---- The light as the camera sees it ----
        let seen = context.settings.max_depth >= 1 && !context.settings.hides(1);
        let connects = O::CONNECTS && !context.caustics_only && seen;
        if connects && e.is_infinite() && !e.is_delta() {
            this.see_environment::<O>(context, index, [c, d], inverse_choice);
        }
        let Some(mut start) = e.sample_ray(
            &context.theta.primal(),
            scene.lights(),
            context.ball,
            [a, b, c, d],
        ) else {
            return this;
        };
        if !targets.is_empty() {
            let u = if e.is_infinite() { [a, b] } else { [c, d] };
            match turn_to_casters(e, context.ball, targets, target, start, u) {
                Some(turned) => start = turned,
                None => return this,
            }
        }
        if connects
            && let Some((_, si)) = &start.surface
            && let Some((wi, distance, at, weight)) = towards_camera(&context.pinhole, si.p)
            && let Some(found) = e.hit(-wi, Some(si))
        {
            let cos = si.n_geo.dot(wi).abs();
            let weight = weight * cos * inverse_choice / start.pdf_position;
            let emission = lift(found);
            let f = e.eval(context.theta, &emission);
            this.shadow = Some(si.shadow_ray(wi, distance, start.exit, NOWHERE));
            this.value = f.scale(weight);
            this.film = at;
            if O::ENABLED {
                this.pending = Some(Pending::Emitter(index as u32, emission, weight));
            }
        }

        // ---- The particle ----
        let weight = start.weight() * inverse_choice;
        let emission = lift(start.emission);
        if !weight.is_finite() {
            return this;
        }
        this.beta = e.eval(context.theta, &emission).scale(weight);
        if O::ENABLED {
            observer.contribution(Contribution::Emitted(EmittedLight {
                emitter: index as u32,
                emission,
                weight,
            }));
        }
        let dark = !O::ENABLED && this.beta.is_black() && !has_tangent(this.beta);
        if context.settings.max_depth >= 2 && !dark {
            let ray = match &start.surface {
                Some((_, si)) => si.spawn_ray(start.ray.d, start.exit),
                None => start.ray,
            };
            this.ray = Some(ray);
        }
        this
    }

    /// The environment behind everything: a direction from the pinhole.
    #[inline(never)]
    fn see_environment<O: ParticleObserver<R>>(
        &mut self,
        context: &Context<R>,
        emitter: usize,
        u: [R::Primal; 2],
        inverse_choice: R::Primal,
    ) {
        let scene = context.scene;
        let e = &scene.emitters()[emitter];
        let origin = context.pinhole.origin;
        let Some(sample) = e.sample(scene.lights(), origin, u) else {
            return;
        };
        let Some((at, area)) = context.pinhole.project(sample.d) else {
            return;
        };
        let weight = area * inverse_choice / sample.pdf;
        if !weight.is_finite() {
            return;
        }
        let emission = Emission {
            uv: Vec2::lift(sample.emission.uv),
            falloff: R::lift(sample.emission.falloff),
        };
        let f = e.eval(context.theta, &emission);
        self.shadow = Some(Segment {
            ray: Ray::new(origin, sample.d),
            length: R::Primal::of(f64::INFINITY),
            to: NOWHERE,
        });
        self.value = f.scale(weight);
        self.film = at;
        if O::ENABLED {
            self.pending = Some(Pending::Emitter(emitter as u32, emission, weight));
        }
    }

    /// Goes on to the next vertex: `hit` is what the particle met, `visible` whether the camera sees the
    /// last one. What the film receives goes to `splat`.
    #[inline]
    fn step<O: ParticleObserver<R>>(
        &mut self,
        context: &Context<R>,
        hit: Option<Intersection<R::Primal>>,
        visible: bool,
        observer: &mut O,
        splat: &mut (impl FnMut([R::Primal; 2], Rgb<R>) + ?Sized),
    ) {
        let scene = context.scene;
        if self.shadow.take().is_some() && visible {
            splat(self.film, self.value);
            if let Some(pending) = self.pending.take() {
                let importance = observer.importance(self.film);
                observer.contribution(match pending {
                    Pending::Emitter(emitter, emission, weight) => {
                        Contribution::SeenEmitter(emitter, emission, importance * weight)
                    }
                    Pending::Vertex(seen) => Contribution::Seen(SeenVertex {
                        importance: importance * seen.importance,
                        ..seen
                    }),
                });
            }
        }
        let (Some(ray), Some(hit)) = (self.ray.take(), hit) else {
            return;
        };
        self.depth += 1;
        let depth = self.depth;
        let si = &hit.si;
        let info = scene.shape_info(hit.shape);
        if context.caustics_only && depth == 1 && !info.throws_caustics() {
            return;
        }
        let here = Here::new(context, &ray, &hit);
        let wo = here.wo;
        if O::ENABLED {
            let place = Place {
                shape: hit.shape,
                prim: hit.prim,
                si: si.lift(),
                wo: Vec3::lift(wo),
            };
            observer.vertex(self.beta, &place);
        }
        let unseen = info.delta || (info.emitter.is_some() && context.settings.hides(1));
        if O::CONNECTS && !unseen && (!context.caustics_only || info.shows_caustics()) {
            self.connect::<O>(context, &here);
        }
        if !has_more(depth, context.settings) {
            return;
        }
        let splits = context.differential
            && const { O::ENABLED || !R::IS_PRIMAL }
            && has_pair(observer, info.material, here.material);
        if splits && !self.beta.is_black() {
            self.split(context, &hit, wo, observer, splat);
        }
        self.scatter(context, &here, splits, observer);
    }

    /// Connects the current vertex to the camera, to be seen if the shadow ray is free.
    #[inline(always)]
    fn connect<O: ParticleObserver<R>>(&mut self, context: &Context<R>, here: &Here<R>) {
        let &Here {
            material,
            exit,
            si,
            ref at,
            n_geo,
            wo,
        } = here;
        let Some((to_camera, distance, film, weight)) = towards_camera(&context.pinhole, si.p)
        else {
            return;
        };
        let wi = si.frame.to_local(to_camera);
        let shading = kernel_weight(n_geo, [wo, wi], MODE, context.rules);
        let mode = context.rules.mode(MODE, [wo, wi], Component::Continuous);
        let (wo, wi) = (Vec3::<R>::lift(wo), Vec3::<R>::lift(wi));
        let (f, matters) = if O::ENABLED {
            let (f, pdf) = material.eval_pdf(at, wo, wi, mode);
            (f, matters(true, f, pdf))
        } else {
            let f = material.eval(at, wo, wi, mode);
            (f, matters(false, f, R::zero()))
        };
        let weight = weight * shading;
        if matters && weight > R::Primal::zero() {
            self.shadow = Some(si.shadow_ray(to_camera, distance, exit, NOWHERE));
            self.value = self.beta * f.scale(weight);
            self.film = film;
            if O::ENABLED {
                self.pending = Some(Pending::Vertex(SeenVertex {
                    wi,
                    mode,
                    f,
                    importance: Rgb::splat(weight),
                }));
            }
        }
    }

    /// Samples the next edge. `splits`: whether the change of normals has samples of its own.
    #[inline(always)]
    fn scatter<O: ParticleObserver<R>>(
        &mut self,
        context: &Context<R>,
        here: &Here<R>,
        splits: bool,
        observer: &mut O,
    ) {
        let &Here {
            material,
            exit,
            si,
            ref at,
            n_geo,
            wo,
        } = here;
        let (sampler, beta) = (&mut self.sampler, self.beta);
        sampler.seek(Purpose::ParticleScattering.at(self.depth));
        let Some((sample, mut f)) = material.scatter(at, wo, sampler.next_3d(), MODE) else {
            return;
        };
        let shading = kernel_weight(n_geo, [wo, sample.wi], MODE, context.rules);
        let mode = (context.rules).mode(MODE, [wo, sample.wi], sample.component);
        let wi = Vec3::<R>::lift(sample.wi);
        if mode != MODE {
            f = material.eval_component(at, Vec3::lift(wo), wi, sample.component, mode);
        }
        let mut weight = shading / sample.pdf;
        let (step, before) = (f.primal().scale(weight), self.roulette_weight);
        let differentiates = const { O::ENABLED || !R::IS_PRIMAL };
        self.roulette_weight = roulette_weight(differentiates, before, step, step.scale(before));
        if self.depth >= context.settings.rr_depth {
            let q = probability(self.roulette_weight, R::Primal::one());
            let (survives, inv_q) = play(true, q, sampler.next_1d());
            if !survives {
                return;
            }
            self.roulette_weight *= inv_q;
            weight *= inv_q;
        }
        // Grazing shading normals, or nothing to go on with.
        if weight == R::Primal::zero() {
            return;
        }
        let part = part_of(sample.component, splits);
        if O::ENABLED {
            observer.contribution(Contribution::Scattered(Bounce {
                wi,
                component: sample.component,
                mode,
                weight: R::lift(weight),
                f,
                part,
                deciding: None,
            }));
        }
        if part == Part::Rest && !R::IS_PRIMAL {
            f = f - material.eval_normals(at, wo, sample.wi, mode);
        }
        self.beta = beta * f.scale(weight);
        assert_finite(self.beta, beta);
        if !O::ENABLED && self.beta.is_black() && !has_tangent(self.beta) {
            return;
        }
        self.ray = Some(si.spawn_ray(si.frame.to_world(sample.wi), exit));
    }
}

impl<R: Real, X: Sampler> Particle<R, X> {
    /// What goes on from the first surface of a particle that arrives there with `beta`, where paths have more than two edges; the
    /// camera sees that surface some other way. The numbers of a start have been drawn from `sampler`.
    pub(super) fn scattered(
        context: &Context<R>,
        ray: &Ray<R::Primal>,
        hit: &Intersection<R::Primal>,
        beta: Rgb<R>,
        sampler: X,
    ) -> Self {
        let mut this = Self::waiting(sampler, beta, 1);
        this.scatter(context, &Here::new(context, ray, hit), false, &mut ());
        this
    }

    /// Samples the change of normals at the vertex `hit`, and follows both samples to their ends.
    #[inline(never)]
    fn split<O: ParticleObserver<R>>(
        &self,
        context: &Context<R>,
        hit: &Intersection<R::Primal>,
        wo: Vec3<R::Primal>,
        observer: &mut O,
        splat: &mut (impl FnMut([R::Primal; 2], Rgb<R>) + ?Sized),
    ) {
        let scene = context.scene;
        let theta = context.theta.primal();
        let still = Context {
            scene,
            theta: &theta,
            settings: context.settings,
            rules: context.rules,
            pinhole: context.pinhole,
            ball: context.ball,
            caustics_only: context.caustics_only,
            differential: false,
            per_sample: context.per_sample,
            progress: context.progress,
        };
        let si = &hit.si;
        let n_geo = si.local_geometric_normal();
        let material = scene.material(hit.shape);
        let at = Shading::new(theta, si.uv);
        let mut sampler = self.sampler;
        let dimension = Purpose::ParticleNormalsPair.at(self.depth);
        for sample in normals_pair(material, &at, wo, MODE, &mut sampler, dimension) {
            let shading = kernel_weight(n_geo, [wo, sample.wi], MODE, context.rules);
            let weight = shading / sample.pdf;
            if weight == R::Primal::zero() || !weight.is_finite() {
                continue;
            }
            let mut change = Rgb::black();
            if !R::IS_PRIMAL {
                let at = Shading::new(*context.theta, Vec2::lift(si.uv));
                change = self.beta
                    * material
                        .eval_normals(&at, wo, sample.wi, MODE)
                        .scale(weight);
            }
            if !O::ENABLED && !has_tangent(change) {
                continue;
            }
            let d = si.frame.to_world(sample.wi);
            let particle = Particle::<R::Primal, X> {
                ray: Some(si.spawn_ray(d, scene.exit(hit.prim))),
                roulette_weight: self.roulette_weight,
                ..Particle::waiting(sampler, Rgb::splat(R::Primal::one()), self.depth)
            };
            let mut w = Rgb::black();
            particle.finish(&still, &mut |at, value| {
                if O::ENABLED {
                    w += observer.importance(at) * value;
                }
                if !R::IS_PRIMAL {
                    splat(at, change * Rgb::lift(value));
                }
            });
            if O::ENABLED {
                observer.contribution(Contribution::Normals(NormalsLight {
                    wi: Vec3::lift(sample.wi),
                    mode: MODE,
                    li: self.beta * Rgb::lift(w.scale(weight)),
                }));
            }
        }
    }

    /// Goes on to the end, tracing ray by ray.
    pub(super) fn finish(
        mut self,
        context: &Context<R>,
        splat: &mut dyn FnMut([R::Primal; 2], Rgb<R>),
    ) {
        lockstep::trace_alone(
            context.scene,
            &context.theta.primal(),
            context.settings.hides(1),
            context.progress,
            &mut self,
            |particle, hit, visible| {
                particle.step(context, hit, visible, &mut (), splat);
            },
        );
    }
}

impl<R: Real, X: Sampler> Traveller for Particle<R, X> {
    type Geometry = R::Primal;
    const IS_SEEN: bool = true;
    #[inline(always)]
    fn ray(&self) -> Option<&Ray<R::Primal>> {
        self.ray.as_ref()
    }
    #[inline(always)]
    fn shadow(&self) -> Option<&Segment<R::Primal>> {
        self.shadow.as_ref()
    }
    #[inline(always)]
    fn looks(&self) -> bool {
        false
    }
}

/// The particles `first .. first + count` of all samples, of which there is one per pixel of the full
/// film and sample. Calls `done` with each one's index after its end, in order; those that are
/// cut short are left out, and those after them.
pub(super) fn trace_particles<R: Real, X: Sampler, O: ParticleObserver<R> + Clone>(
    context: &Context<R>,
    observer: &O,
    seed: u64,
    particles: Range<u64>,
    mut splat: impl FnMut(u64, [R::Primal; 2], Rgb<R>),
    mut done: impl FnMut(u64, &mut O),
) {
    let mut observers = vec![observer.clone(); GROUP];
    let mut group = Vec::with_capacity(GROUP);
    let mut first = particles.start;
    while first < particles.end {
        let n = (particles.end - first).min(GROUP as u64);
        group.clear();
        for k in 0..n {
            let i = first + k;
            // One sequence, so that spread points are spread over the light of all emitters.
            let sampler = X::spread(context.settings.points, Family::Particles.seed(seed), 0, i);
            group.push(Particle::new(context, sampler, &mut observers[k as usize]));
        }
        lockstep::trace(
            context.scene,
            &context.theta.primal(),
            context.settings.hides(1),
            context.progress,
            &mut group,
            |k, particle, hit, visible| {
                let mut to_film = |at, value| splat(first + k as u64, at, value);
                particle.step(context, hit, visible, &mut observers[k], &mut to_film);
            },
        );
        if context.progress.cancelled() {
            break;
        }
        for (k, observer) in observers.iter_mut().enumerate().take(n as usize) {
            done(first + k as u64, observer);
        }
        first += n;
    }
}

/// Pixels of the full film: a crop shows the same particles.
pub(super) fn pixels(scene: &Scene) -> u64 {
    let [width, height] = scene.film.size;
    u64::from(width) * u64::from(height)
}

/// One light that the film received.
#[derive(Clone, Copy)]
struct Splat<R: Real> {
    at: [R::Primal; 2],
    value: Rgb<R>,
}

/// Renders by particles: the samples `samples`, each of which sends [`Context::per_sample`], with seed `seed`.
/// The expectation is the path tracer's image, without what a pinhole sees through deltas.
///
/// Over a dual number, the result holds the derivative images of its tangents as well (forward mode).
/// It depends on the arguments only, not on the number of threads: jobs leave lists of splats, which are
/// added in their order. Memory: the image, and a few megabytes for these lists.
///
/// A pinhole within the geometry sees what is there; an emitter that emits nothing sends nothing.
pub fn render<R: Components, X: Sampler>(
    context: &Context<R>,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Rendering {
    let context = &Context {
        progress,
        ..*context
    };
    let scene = context.scene;
    let [width, height] = scene.film.crop_size.map(|n| n as usize);
    let n = context.per_sample;
    let total = samples.end.saturating_sub(samples.start) * n;
    let mut out = Rendering {
        width,
        height,
        samples: samples.end.saturating_sub(samples.start),
        sums: vec![vec![0.0; width * height * 3]; R::COUNT],
        non_finite: NonFinite::default(),
        connections: Statistics::default(),
        light_of_connections: 0.0,
        connections_by_pixel: Vec::new(),
        glints: Statistics::default(),
        cancelled: false,
    };
    // `[pixel][component][3]` while splats are added.
    let mut sums = vec![0.0f64; width * height * R::COUNT * 3];
    let row = width * R::COUNT * 3;
    let rows_per_band = height.div_ceil(BANDS).next_power_of_two();
    let band_of = rows_per_band.trailing_zeros();
    let mut reported = 0;
    let round = CHUNK * (CHUNKS / R::COUNT as u64).max(4);
    for start in (0..total).step_by(round as usize) {
        if progress.cancelled() {
            out.cancelled = true;
            break;
        }
        let end = (start + round).min(total);
        let jobs = (end - start).div_ceil(CHUNK) as usize;
        let parts = parallel::map(jobs, |job| {
            let job = start + job as u64 * CHUNK;
            let mut splats = [const { Vec::<Splat<R>>::new() }; BANDS];
            let mut non_finite = NonFinite::default();
            let first = samples.start * n;
            trace_particles::<R, X, ()>(
                context,
                &(),
                seed,
                first + job..first + (job + CHUNK).min(end),
                |i, at, value| {
                    if value.is_finite() {
                        // Near a border, to the bands on both sides.
                        let rows = scene.film.rows(at[1].to_f64());
                        let (first, end) = (rows.start as usize, rows.end as usize);
                        let bands = first >> band_of..(end + rows_per_band - 1) >> band_of;
                        let splat = Splat { at, value };
                        splats[bands].iter_mut().for_each(|s| s.push(splat));
                    } else {
                        non_finite.add(i % n, i / n)
                    }
                },
                |_, ()| {},
            );
            (splats, non_finite)
        });
        if progress.cancelled() {
            out.cancelled = true;
            break;
        }
        // Every band of rows goes through its splats, in order.
        parallel::over(sums.chunks_mut(row * rows_per_band), |band, sums| {
            let first_row = band * rows_per_band;
            let rows = first_row as u32..(first_row + sums.len() / row) as u32;
            let base = first_row * width;
            for splat in parts.iter().flat_map(|(splats, _)| &splats[band]) {
                let at = splat.at.map(|x| x.to_f64());
                scene.film.splat(at, rows.clone(), |pixel, weight| {
                    let to = &mut sums[(pixel - base) * R::COUNT * 3..][..R::COUNT * 3];
                    for k in 0..R::COUNT {
                        for c in 0..3 {
                            to[k * 3 + c] += splat.value[c].component(k) * weight;
                        }
                    }
                });
            }
        });
        for (_, non_finite) in &parts {
            out.non_finite.merge(non_finite);
        }
        // In units of pixels, as the path tracer.
        let pixels = (width * height) as u128;
        let done = (pixels * u128::from(end) / u128::from(total)) as u64;
        progress.advance(done - reported);
        reported = done;
    }
    let scale = 1.0 / n as f64;
    for (pixel, values) in sums.chunks_exact(R::COUNT * 3).enumerate() {
        for (k, value) in values.chunks_exact(3).enumerate() {
            let to = &mut out.sums[k][pixel * 3..pixel * 3 + 3];
            to.iter_mut().zip(value).for_each(|(to, v)| *to = v * scale);
        }
    }
    out
}
