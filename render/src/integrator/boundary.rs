//! What outlines that move do to an image: the derivative of visibility, by samples of edges.
//!
//! Two integrals over outlines, with samples of their own. On the film, across which the point of a sample stays, what is
//! seen jumps along curves, and both sides count: the derivative is that of the area which the inside gains, times the
//! difference of radiance. From all further vertices the material is followed: whatever is in front keeps its own points,
//! up to its outline, and what counts is the radiance from behind, which an edge hides or shows as it moves over that,
//!
//! `dI = - sum over outlines of the integral of f |cos| L_b (omega_e' - omega_b') . n dl`,
//!
//! with `n` out of the occluder, `omega' = (1 - omega omega^T) (x'_point - x'_vertex) / distance`, and `omega_b' = 0` where
//! there is nothing behind. Faces that meet at an angle are no outline there.
//!
//! Everything but the velocities is a constant. A sample is therefore a colour times a [linear form](Form) in the
//! velocities of a few points: forward mode evaluates it, reverse mode adds its transpose to adjoints.
//!
//! # Reference
//! [Li et al. 2018] for derivatives by samples of edges, and for the tree over them; the form that follows the material
//! beyond the first vertex is that of [Zhang et al. 2020], in directions.

use std::ops::Range;

use ad_core::{Const, Float, Real, Vec3};
use smallvec::SmallVec;

use super::active::Active;
use super::exact::ExactBuffer;
use super::pass::Pass;
use super::path::{Context, Walk};
use super::paths::{TileSums, assemble, deposit};
use super::record::{Interest, Observer, Place};
use super::rendering::{Components, NonFinite, Rendering};
use super::sink::{GradientSums, Sink};
use super::tile::{Paths, Sample, place, spot};
use super::vertex::MODE;
use crate::accel::Hit;
use crate::bsdf::{Bsdf, Shading};
use crate::edges::film::{FilmCurves, FilmPoint, Inside, Sides};
use crate::edges::{EdgePoint, Edges, Seeker, Surfaces};
use crate::estimator::{Still, Strategy};
use crate::math::{NOWHERE, Ray, RayAdjoint, Rgb, Segment};
use crate::parallel;
use crate::params::{ParamRef, Theta};
use crate::sampler::{Purpose, Sampler};
use crate::scene::{Caustics, Intersection, Scene};
use crate::shape::{Shape, SurfaceAdjoint, SurfaceInteraction};

/// How far rays pass from an edge that they are to clear, relative to its distance, and to the largest coordinate of its
/// shape: several roundings of an f32.
const CLEARANCE: [f64; 2] = [3e-5, 1e-6];
/// What is met nearer than this part of the distance of an edge hides it.
const SAME_DEPTH: f64 = 1.0 - 1e-3;
/// Edges that a vertex chooses among.
const CANDIDATES: u32 = 4;
/// What edges that do not move count beside others, where the vertex does not move either: what is behind them may.
const STILL: f64 = 0.1;
/// What an edge counts that no lamp is behind, as far as that can be told.
const UNLIT: f64 = 0.1;
/// Pixels per sample of an edge on the film.
const PIXELS_PER_SAMPLE: u64 = 2;
/// Jobs of a pass over the film at a time, and samples of each.
const JOBS: u64 = 64;
const CHUNK: u64 = 1024;
/// Tells the random numbers of edges from those of paths, and those on the film from others.
const SALTS: [u64; 2] = [0x6a09_e667_f3bc_c908, 0xbb67_ae85_84ca_a73b];

/// What moves: a shape, the camera, both or neither.
struct Moving {
    camera: bool,
    shapes: Vec<bool>,
    /// Running sums of how many of the shapes do.
    counts: Vec<u32>,
}

impl Moving {
    fn of(scene: &Scene, moves: impl Fn(ParamRef) -> bool) -> Self {
        let mut shapes = vec![false; scene.shapes().len()];
        for &(shape, p) in scene.movers() {
            shapes[shape as usize] |= moves(p);
        }
        let mut count = 0;
        let counts = std::iter::once(0)
            .chain(shapes.iter().map(|&m| {
                count += u32::from(m);
                count
            }))
            .collect();
        Self {
            camera: scene.camera.depends_on(&moves),
            shapes,
            counts,
        }
    }

    fn any(&self, shapes: Range<u32>) -> bool {
        self.counts[shapes.start as usize] < self.counts[shapes.end as usize]
    }

    fn anything(&self) -> bool {
        self.camera || self.counts.last().is_some_and(|&n| n > 0)
    }
}

/// Something that moves.
#[derive(Clone, Copy)]
enum Mover<P> {
    /// A point that stays on the material.
    Material(u32, SurfaceInteraction<P>),
    /// What the ray through a point of the film meets, which stays.
    Seen(u32, [P; 2], SurfaceInteraction<P>),
    /// That ray.
    Camera([P; 2]),
}

/// A multiple of a velocity: of a point along `o`; of a ray besides, of its direction along `d`.
#[derive(Clone, Copy)]
struct Term<P> {
    mover: Mover<P>,
    along: RayAdjoint<P>,
}

/// A sum of multiples of velocities.
type Form<P> = SmallVec<[Term<P>; 3]>;

/// A sample: a colour times a speed.
struct Contribution<P> {
    value: Rgb<P>,
    form: Form<P>,
}

impl<P: Float> Contribution<P> {
    fn is_finite(&self) -> bool {
        let finite = |t: &Term<P>| t.along.o.is_finite() && t.along.d.is_finite();
        self.value.is_finite() && self.form.iter().all(finite)
    }
}

impl<P: Float> Term<P> {
    fn point(mover: Mover<P>, along: Vec3<f64>) -> Self {
        let along = RayAdjoint {
            o: along.map(P::of),
            d: Vec3::zero(),
        };
        Self { mover, along }
    }

    /// The tangent of the term, over a number whose primal part is zero.
    fn evaluate<R: Real<Primal = P>>(&self, scene: &Scene, theta: &Theta<R>) -> R {
        let form = |v: Vec3<R>, d: Vec3<P>| v.x * Const(d.x) + v.y * Const(d.y) + v.z * Const(d.z);
        let sum = match self.mover {
            Mover::Material(prim, si) => {
                let at = scene.coordinates(prim, &si);
                let at = crate::shape::SurfaceCoordinates::<R>::lift(at);
                form(scene.point_at(theta, prim, at).p, self.along.o)
            }
            Mover::Seen(prim, [x, y], si) => {
                let ray = scene.camera.ray_moving(theta, x, y);
                let seen = scene.interaction(theta, &ray, &hit_at(prim, si.t));
                form(seen.si.p, self.along.o)
            }
            Mover::Camera([x, y]) => {
                let ray = scene.camera.ray_moving(theta, x, y);
                form(ray.o, self.along.o) + form(ray.d, self.along.d)
            }
        };
        sum - Const(sum.primal())
    }

    /// Adds its transpose, for an adjoint of its value.
    fn scatter(&self, scene: &Scene, theta: &Theta<P>, adjoint: P, sink: &mut Sink) {
        let RayAdjoint { o, d } = self.along;
        let surface = SurfaceAdjoint {
            p: o * adjoint,
            ..SurfaceAdjoint::zero()
        };
        match self.mover {
            Mover::Material(prim, si) => {
                scene.scatter_point(theta, prim, &si, &surface, P::zero(), sink);
            }
            Mover::Seen(prim, at, si) => {
                let ray = scene.camera.ray(at[0], at[1]);
                let back = scene.scatter_interaction(theta, prim, &ray, &si, &surface, sink);
                scene.camera.scatter_ray(theta, at, &back, sink);
            }
            Mover::Camera(at) => {
                let back = RayAdjoint {
                    o: o * adjoint,
                    d: d * adjoint,
                };
                scene.camera.scatter_ray(theta, at, &back, sink);
            }
        }
    }
}

/// Where along a ray it met a primitive.
fn hit_at<P: Float>(prim: u32, t: P) -> Hit {
    Hit {
        t: t.to_f32(),
        u: 0.0,
        v: 0.0,
        prim,
    }
}

/// The vertices of a path, for the camera's side of what edges hide.
#[derive(Clone)]
struct Vertices<P: Float>(Vec<(Rgb<P>, Place<P>)>);

impl<P: Float> Interest for Vertices<P> {
    const LIGHT: bool = false;
}

impl<P: Float> Observer<P> for Vertices<P> {
    fn vertex(&mut self, beta: Rgb<P>, place: &Place<P>) {
        self.0.push((beta, *place));
    }
}

/// What all samples have in common.
struct Boundary<'a, P: Float> {
    context: Context<'a, P>,
    edges: &'a Edges,
    surfaces: Surfaces<'a>,
    curves: FilmCurves,
    moving: Moving,
    seed: u64,
}

fn wide<P: Float>(v: Vec3<P>) -> Vec3<f64> {
    v.map(P::to_f64)
}

impl<'a, P: Float> Boundary<'a, P> {
    fn new(context: Context<'a, P>, seed: u64, moving: Moving) -> Self {
        let scene = context.scene;
        let edges = scene.edges();
        let of_film = |shapes: Range<u32>| moving.camera || moving.any(shapes);
        let curves = edges.on_film(&scene.camera, &scene.film, &of_film);
        Self {
            context: Context {
                caustics: Caustics::Paths,
                ..context
            },
            edges,
            surfaces: scene.surfaces(),
            curves,
            moving,
            seed,
        }
    }

    /// Samples of edges on the film for every sample of all pixels.
    fn per_sample(&self) -> u64 {
        let pixels = self.context.scene.film.pixels() as u64;
        if self.curves.length() > 0.0 {
            pixels.div_ceil(PIXELS_PER_SAMPLE)
        } else {
            0
        }
    }

    /// Radiance along a ray of which it is known what it meets.
    fn radiance<S: Strategy, X: Sampler>(
        &self,
        ray: Ray<P>,
        hit: Option<Intersection<P>>,
        depth: u32,
        sampler: X,
    ) -> Rgb<P> {
        Walk::<P, Still<S>, X>::behind(ray, sampler, depth).finish_at(&self.context, hit)
    }

    fn clearance(&self, edge: &EdgePoint) -> f64 {
        let extent = self.surfaces.shapes[edge.shape as usize].extent();
        (CLEARANCE[0] * edge.distance).max(CLEARANCE[1] * f64::from(extent))
    }

    /// The ray that passes an edge, from an origin, and what it meets; `None` if something hides the edge.
    fn past(&self, edge: &EdgePoint, from: Ray<P>) -> Option<(Ray<P>, Option<Intersection<P>>)> {
        let scene = self.context.scene;
        let beside = edge.p + edge.normal * self.clearance(edge);
        let d = (beside - wide(from.o)).normalize();
        let ray = Ray {
            d: d.map(P::of).normalize(),
            ..from
        };
        let hit = scene.nearest(&ray);
        if hit.is_some_and(|hit| f64::from(hit.t) < SAME_DEPTH * edge.distance) {
            return None;
        }
        let theta = Theta::still();
        Some((ray, hit.map(|hit| scene.interaction(&theta, &ray, &hit))))
    }

    /// The term of a point of the material, if that moves.
    fn material(
        &self,
        prim: u32,
        shape: u32,
        si: impl FnOnce() -> SurfaceInteraction<P>,
        along: Vec3<f64>,
    ) -> Option<Term<P>> {
        let moves = self.moving.shapes[shape as usize];
        moves.then(|| Term::point(Mover::Material(prim, si()), along))
    }

    /// That of a point on an edge.
    fn of_edge(&self, edge: &EdgePoint, along: Vec3<f64>) -> Option<Term<P>> {
        let (prim, at) = self.surfaces.material::<P>(edge);
        let si = || self.context.scene.point_at(&Theta::still(), prim, at);
        self.material(prim, edge.shape, si, along)
    }

    /// Sample `index` of `count` on the film, in sample `sample` of the image: where, and of what.
    fn on_film<S: Strategy, X: Sampler>(
        &self,
        [index, count]: [u64; 2],
        sample: u64,
    ) -> Option<([f64; 2], Contribution<P>)> {
        let scene = self.context.scene;
        let points = self.context.settings.points;
        let mut sampler = X::spread(points, self.seed ^ SALTS[1], index, sample);
        let u: f64 = sampler.next_1d();
        let point = self
            .curves
            .point(self.edges, (index as f64 + u) / count as f64)?;
        let FilmPoint { at, edge, sides } = point;
        let origin = scene.camera.origin().map(P::of).into();
        let ray = Ray::new(origin, edge.direction.map(P::of).normalize());
        let inside = |inside: &Inside| {
            let (prim, at) = self.surfaces.inside::<P>(edge.shape, inside);
            let mut si = scene.point_at(&Theta::still(), prim, at);
            si.t = P::of(edge.distance);
            let shape = edge.shape;
            let hit = Intersection { shape, prim, si };
            self.radiance::<S, X>(ray, Some(hit), 1, sampler)
        };
        let mut weight = edge.weight / count as f64;
        let jump = match &sides {
            Sides::Outline(front) => {
                let (past, hit) = self.past(&edge, ray)?;
                weight *= hit.map_or(1.0, |hit| self.share_of_contact(&edge, &past, &hit));
                inside(front) - self.radiance::<S, X>(past, hit, 1, sampler)
            }
            Sides::Crease(near, far) => {
                let segment = Segment {
                    ray,
                    length: P::of(edge.distance * SAME_DEPTH),
                    to: NOWHERE,
                };
                if scene.occluded(&segment) {
                    return None;
                }
                inside(near) - inside(far)
            }
        };
        if jump.is_black() {
            return None;
        }
        let n = edge.normal * edge.distance.recip();
        let mut form: Form<P> = self.of_edge(&edge, n).into_iter().collect();
        if self.moving.camera {
            form.push(Term {
                mover: Mover::Camera(at.map(P::of)),
                along: RayAdjoint {
                    o: (-n).map(P::of),
                    d: (-edge.normal).map(P::of),
                },
            });
        }
        let value = jump.scale(P::of(weight));
        Some((at, Contribution { value, form }))
    }

    /// Where the borders of two shapes are in one place, as those of walls in the corners of a room, each has half of the
    /// curve that they are.
    fn share_of_contact(&self, edge: &EdgePoint, past: &Ray<P>, hit: &Intersection<P>) -> f64 {
        let scene = self.context.scene;
        let moves = self.moving.camera || self.moving.shapes[hit.shape as usize];
        let t = hit.si.t;
        if !moves || hit.shape == edge.shape || t.to_f64() * SAME_DEPTH > edge.distance {
            return 1.0;
        }
        let from_border = scene.border(past, &hit_at(hit.prim, t)).to_f64();
        if from_border.abs() * edge.distance < 10.0 * self.clearance(edge) {
            0.5
        } else {
            1.0
        }
    }

    /// An edge that hides light from the vertex number `depth` of a path, which stays at the point `film`.
    fn at_vertex<S: Strategy, X: Sampler>(
        &self,
        beta: Rgb<P>,
        here: &Place<P>,
        depth: u32,
        film: [P; 2],
        mut sampler: X,
    ) -> Option<Contribution<P>> {
        let scene = self.context.scene;
        let info = scene.shape_info(here.shape);
        if info.delta || beta.is_black() {
            return None;
        }
        let Place { si, wo, .. } = here;
        let x = wide(si.p);
        let shape_moves = self.moving.shapes[here.shape as usize];
        let x_moves = shape_moves || (depth == 1 && self.moving.camera);
        let interest = |shapes: Range<u32>| {
            if x_moves || self.moving.any(shapes) {
                1.0
            } else {
                STILL
            }
        };
        let seen_from_above = wo.z >= P::zero();
        let normal = wide(si.n_geo) * if seen_from_above { 1.0 } else { -1.0 };
        let seeker = Seeker {
            from: x,
            normal,
            lamps: scene.lamps(),
            lamps_only: depth + 1 >= self.context.settings.max_depth,
            interest: &interest,
        };
        let lamps = seeker.cones();
        let material = scene.material(here.shape);
        let shading = Shading {
            theta: *self.context.theta,
            uv: si.uv,
        };

        // ---- One of a few candidates ----
        sampler.seek(Purpose::Edges(CANDIDATES).at(depth));
        let mut kept: Option<(EdgePoint, Rgb<P>, f64)> = None;
        let mut total = 0.0;
        let draws: [[f64; 2]; CANDIDATES as usize] = std::array::from_fn(|_| sampler.next_2d());
        let mut choice: f64 = sampler.next_1d();
        for u in draws {
            let Some(edge) = self.edges.draw(&seeker, &lamps, u) else {
                continue;
            };
            let d = edge.direction.map(P::of).normalize();
            let wi = si.frame.to_local(d);
            let f = material.eval(&shading, *wo, wi, MODE);
            let lit = if scene.may_meet_light(&Ray::new(si.p, d)) {
                1.0
            } else if seeker.lamps_only {
                0.0
            } else {
                UNLIT
            };
            let speed = interest(edge.shape..edge.shape + 1) / edge.distance;
            let target = f.max_component().to_f64() * lit * speed;
            let weight = target * edge.weight;
            if !(weight > 0.0 && weight.is_finite()) {
                continue;
            }
            total += weight;
            let p = weight / total;
            if choice < p {
                choice /= p;
                kept = Some((edge, f, target));
            } else {
                choice = (choice - p) / (1.0 - p);
            }
        }
        let (edge, f, target) = kept?;
        let weight = total / f64::from(CANDIDATES) / target;

        // ---- What is behind it ----
        let from = si.spawn_ray(edge.direction.map(P::of).normalize(), scene.exit(here.prim));
        let (ray, hit) = self.past(&edge, from)?;
        let light = self.radiance::<S, X>(ray, hit, depth + 1, sampler);
        if light.is_black() {
            return None;
        }
        let n = edge.normal;
        let near = edge.distance.recip();
        let far = hit.map_or(0.0, |hit| (wide(hit.si.p) - x).length().recip());
        let mut form: Form<P> = self.of_edge(&edge, n * near).into_iter().collect();
        if let Some(hit) = hit {
            form.extend(self.material(hit.prim, hit.shape, || hit.si, n * -far));
        }
        let along = n * (far - near);
        if depth > 1 {
            form.extend(self.material(here.prim, here.shape, || *si, along));
        } else if x_moves {
            form.push(Term::point(Mover::Seen(here.prim, film, *si), along));
        }
        let value = -(beta * f * light).scale(P::of(weight));
        (!form.is_empty()).then_some(Contribution { value, form })
    }

    /// Calls `each` with a contribution to the pixel of a sample for every vertex of its path.
    fn along_path<S: Strategy, X: Sampler>(
        &self,
        sample: &Sample,
        vertices: &Vertices<P>,
        mut each: impl FnMut(Contribution<P>),
    ) {
        let points = self.context.settings.points;
        let ([x, y, ..], sampler) = spot::<P, X>(
            self.context.scene,
            points,
            self.seed ^ SALTS[0],
            sample.pixel,
            sample.index,
        );
        for ((beta, here), depth) in vertices.0.iter().zip(1..) {
            if let Some(c) = self.at_vertex::<S, X>(*beta, here, depth, [x, y], sampler) {
                each(c);
            }
        }
    }
}

/// The derivative images of outlines that move: their values are zero.
pub(super) fn image<R: Components, S: Strategy, X: Sampler>(pass: &Pass<R>) -> Rendering {
    let (scene, theta) = (pass.scene, pass.theta);
    let primal = theta.primal();
    let context = pass.context().still(&primal);
    let moving = Moving::of(scene, |p| theta.moves(p));
    let mut out = Rendering::black(scene.film.crop_size, &pass.samples, R::COUNT);
    if !moving.anything() {
        pass.progress.advance(scene.film.pixels() as u64);
        return out;
    }
    let boundary = Boundary::new(context, pass.seed, moving);
    let color = |c: &Contribution<R::Primal>| {
        let zero = R::zero();
        let speed = (c.form.iter()).fold(zero, |sum, t| sum + t.evaluate(scene, theta));
        c.value.map(|v| speed * Const(v))
    };

    // ---- Edges on the film ----
    let per_sample = boundary.per_sample();
    let first = pass.samples.start * per_sample;
    let end = pass.samples.end.max(pass.samples.start) * per_sample;
    for start in (first..end).step_by((JOBS * CHUNK) as usize) {
        if pass.progress.cancelled() {
            out.cancelled = true;
            return out;
        }
        let stop = (start + JOBS * CHUNK).min(end);
        let jobs = (stop - start).div_ceil(CHUNK) as usize;
        let parts = parallel::map(jobs, |job| {
            let own = start + job as u64 * CHUNK;
            let mut splats = Vec::new();
            let mut non_finite = NonFinite::default();
            for i in own..(own + CHUNK).min(stop) {
                let index = [i % per_sample, per_sample];
                let Some((at, c)) = boundary.on_film::<S, X>(index, i / per_sample) else {
                    continue;
                };
                let value = color(&c);
                if value.is_finite() {
                    splats.push((at, value));
                } else {
                    non_finite.add(i % per_sample, i / per_sample);
                }
            }
            (splats, non_finite)
        });
        for (splats, non_finite) in &parts {
            out.non_finite.merge(non_finite);
            for (at, value) in splats {
                scene
                    .film
                    .splat(*at, scene.film.rows(at[1]), |pixel, weight| {
                        for (k, sums) in out.sums.iter_mut().enumerate() {
                            for c in 0..3 {
                                sums[pixel * 3 + c] += value[c].component(k) * weight;
                            }
                        }
                    });
            }
        }
    }

    // ---- Edges that hide light from later vertices ----
    let tiles = pass.tiles();
    let spp = pass.samples.end.saturating_sub(pass.samples.start) as f64;
    let parts = parallel::map(tiles.len(), |i| -> TileSums {
        let tile = &tiles[i];
        let pixels = tile.pixels();
        let mut sums = vec![0.0f64; R::COUNT * pixels * 3];
        let mut non_finite = NonFinite::default();
        let mut paths = Paths::<R::Primal, Still<S>, X, _>::new(Vertices(Vec::new()));
        let seed = boundary.seed ^ SALTS[0];
        let done = |at: usize, sample: Sample, _, vertices: &mut Vertices<R::Primal>| {
            boundary.along_path::<S, X>(&sample, vertices, |c| {
                let value = color(&c);
                if !value.is_finite() {
                    non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                    return;
                }
                let weight = spp * sample.scale();
                deposit(&mut sums, at, value, weight);
            });
            vertices.0.clear();
        };
        tile.trace(&boundary.context, seed, &pass.samples, &mut paths, done);
        if pass.progress.cancelled() {
            return (Vec::new(), NonFinite::default());
        }
        pass.progress.advance(pixels as u64);
        (sums, non_finite)
    });
    let rest = assemble(pass, R::COUNT, &parts);
    out.add(&rest);
    out
}

/// The derivative of `<adjoint, image>` by outlines that move. The large ranges are added to `large`.
pub(super) fn gradient<P: Float, S: Strategy, X: Sampler>(
    pass: &Pass<P>,
    active: &Active,
    adjoint: &[f32],
    large: &ExactBuffer,
) -> GradientSums {
    let (scene, theta) = (pass.scene, pass.theta);
    let moving = Moving::of(scene, |p| active.contains(p));
    let mut out = GradientSums::zero(active);
    if !moving.anything() {
        pass.progress.advance(scene.film.pixels() as u64);
        return out;
    }
    let boundary = Boundary::new(pass.context(), pass.seed, moving);
    let samples = pass.samples.end.saturating_sub(pass.samples.start);
    let scatter = |c: &Contribution<P>, d: Rgb<P>, sink: &mut Sink| {
        let adjoint = (d * c.value).sum();
        for term in &c.form {
            term.scatter(scene, theta, adjoint, sink);
        }
    };

    // ---- Edges on the film ----
    let per_sample = boundary.per_sample();
    let first = pass.samples.start * per_sample;
    let total = samples * per_sample;
    let jobs = (2 * JOBS).min(total);
    let parts = parallel::map(jobs as usize, |job| {
        let job = job as u64;
        let mut sink = Sink::new(active, large);
        let mut non_finite = NonFinite::default();
        for i in first + total * job / jobs..first + total * (job + 1) / jobs {
            if i % CHUNK == 0 && pass.progress.cancelled() {
                break;
            }
            let index = [i % per_sample, per_sample];
            let Some((at, c)) = boundary.on_film::<S, X>(index, i / per_sample) else {
                continue;
            };
            if !c.is_finite() {
                non_finite.add(i % per_sample, i / per_sample);
                continue;
            }
            let mut d = [0.0; 3];
            scene
                .film
                .splat(at, scene.film.rows(at[1]), |pixel, weight| {
                    for (k, d) in d.iter_mut().enumerate() {
                        *d += weight * f64::from(adjoint[pixel * 3 + k]);
                    }
                });
            let d = d.map(|d| P::of(d / samples as f64));
            scatter(&c, Rgb::from(d), &mut sink);
        }
        (sink.into_small(), non_finite)
    });
    out = out.with_parts(parts);

    // ---- Edges that hide light from later vertices ----
    let tiles = pass.tiles();
    let jobs = (2 * JOBS as usize).min(tiles.len());
    let parts = parallel::map(jobs, |job| {
        let mut sink = Sink::new(active, large);
        let mut non_finite = NonFinite::default();
        let mut paths = Paths::<P, Still<S>, X, _>::new(Vertices(Vec::new()));
        let seed = boundary.seed ^ SALTS[0];
        for tile in tiles.iter().skip(job).step_by(jobs) {
            if pass.progress.cancelled() {
                break;
            }
            let done = |_, sample: Sample, _, vertices: &mut Vertices<P>| {
                let d = sample.of_image::<P>(adjoint, scene) * P::of(sample.scale());
                boundary.along_path::<S, X>(&sample, vertices, |c| {
                    if c.is_finite() {
                        scatter(&c, d, &mut sink);
                    } else {
                        non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                    }
                });
                vertices.0.clear();
            };
            tile.trace(&boundary.context, seed, &pass.samples, &mut paths, done);
            pass.progress.advance(tile.pixels() as u64);
        }
        (sink.into_small(), non_finite)
    });
    out = out.with_parts(parts);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Job;
    use crate::estimator::DetachedMis;
    use crate::integrator::sink::collect;
    use crate::motion::rotation;
    use crate::sampler::Independent;
    use crate::statistics::{Estimate, z_limit};

    const RUNS: u64 = 8;
    const SIZE: f64 = 24.0;
    const FOV: f64 = 50.0;

    fn scene(body: &str, depth: u32) -> Scene {
        let text = format!(
            r#"<scene version="3.0.0">
            <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
            <sensor type="perspective"><float name="fov" value="{FOV}"/>
                <film type="hdrfilm">
                    <integer name="width" value="24"/><integer name="height" value="24"/>
                    <rfilter type="box"/>
                </film>
            </sensor>{body}</scene>"#
        );
        match Scene::from_xml(&text, "".as_ref(), &Default::default()) {
            Ok((scene, _)) => scene,
            Err(e) => panic!("{e}\n{text}"),
        }
    }

    /// The derivative of the mean of all pixels and channels by outlines, in reverse mode.
    fn gradient_of<P: Float>(scene: &Scene, names: &[&str], spp: u64) -> Vec<Estimate> {
        let found = names.iter().map(|n| scene.params().find(n).expect("known"));
        let active = Active::of(scene, &found.collect::<Vec<_>>());
        let values: Vec<P> = (scene.params().values().iter())
            .map(|&v| P::from_f32(v))
            .collect();
        let theta = Theta::constant(&values);
        let n = scene.film.pixels() * 3;
        let adjoint = vec![1.0 / n as f32; n];
        let runs: Vec<Vec<f64>> = (0..RUNS)
            .map(|seed| {
                let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
                let pass = Pass::new(&job, &theta, Caustics::Paths);
                let found = collect(scene, &active, 1.0, &(), &|large| {
                    gradient::<P, DetachedMis, Independent>(&pass, &active, &adjoint, large)
                });
                assert_eq!(found.non_finite.count, 0);
                found.values.concat()
            })
            .collect();
        (0..runs[0].len())
            .map(|i| Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>()))
            .collect()
    }

    type Point = [f64; 2];
    type Move<'a> = &'a dyn Fn(Vec3<f64>) -> Vec3<f64>;

    /// On the film, in pixels.
    fn project(p: &Vec3<f64>) -> Point {
        let scale = 0.5 * SIZE / (0.5 * FOV.to_radians()).tan();
        [-p.x / p.z, -p.y / p.z].map(|x| 0.5 * SIZE + scale * x)
    }

    /// The area of the convex hull of points, as far as it is on the film.
    fn hull_area(points: &[Vec3<f64>]) -> f64 {
        let mut sorted: Vec<Point> = points.iter().map(project).collect();
        sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        let turn = |a: Point, b: Point, c: Point| {
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        };
        let half = |points: &mut dyn Iterator<Item = &Point>| {
            let mut chain: Vec<Point> = Vec::new();
            for &p in points {
                while let [.., a, b] = chain[..] {
                    if turn(a, b, p) > 0.0 {
                        break;
                    }
                    chain.pop();
                }
                chain.push(p);
            }
            chain.pop();
            chain
        };
        let mut hull = half(&mut sorted.iter());
        hull.extend(half(&mut sorted.iter().rev()));
        for (axis, sign, limit) in [
            (0, 1.0, 0.0),
            (0, -1.0, -SIZE),
            (1, 1.0, 0.0),
            (1, -1.0, -SIZE),
        ] {
            let mut cut = Vec::new();
            for (i, &b) in hull.iter().enumerate() {
                let a = hull[(i + hull.len() - 1) % hull.len()];
                let [x, y] = [a, b].map(|p: Point| sign * p[axis] - limit);
                if (x < 0.0) != (y < 0.0) {
                    let t = x / (x - y);
                    cut.push([0, 1].map(|k: usize| a[k] + t * (b[k] - a[k])));
                }
                if y >= 0.0 {
                    cut.push(b);
                }
            }
            hull = cut;
        }
        let pairs = hull.iter().zip(hull.iter().cycle().skip(1));
        0.5 * pairs
            .map(|(a, b)| a[0] * b[1] - a[1] * b[0])
            .sum::<f64>()
            .abs()
    }

    /// The derivative of an area on the film, as a mean over pixels, by everything that moves a shape or the camera:
    /// translation, rotation and scale about `centre`; translation and rotation of the camera; angle of view.
    fn derivatives(area: &dyn Fn(Move) -> f64, centre: Vec3<f64>) -> Vec<f64> {
        let unit = |k: usize, h: f64| {
            let mut v = [0.0; 3];
            v[k] = h;
            Vec3::from(v)
        };
        let h = 1e-5;
        let slope = |of: &dyn Fn(f64) -> f64| (of(h) - of(-h)) / (2.0 * h) / (SIZE * SIZE);
        let mut out = Vec::new();
        for k in 0..3 {
            out.push(slope(&|h| area(&|p| p + unit(k, h))));
        }
        for k in 0..3 {
            out.push(slope(&|h| {
                area(&|p| centre + rotation(unit(k, h)) * (p - centre))
            }));
        }
        out.push(slope(&|h| area(&|p| centre + (p - centre) * (1.0 + h))));
        for k in 0..3 {
            out.push(slope(&|h| area(&|p| p - unit(k, h))));
        }
        for k in 0..3 {
            out.push(slope(&|h| area(&|p| rotation(unit(k, -h)) * p)));
        }
        let angle = |h: f64| ((FOV + h) / 2.0).to_radians().tan() / (FOV / 2.0).to_radians().tan();
        out.push(slope(&|h| {
            area(&|p| Vec3::new(p.x / angle(h), p.y / angle(h), p.z))
        }));
        out
    }

    const ALL: [&str; 6] = [
        "it.translation",
        "it.rotation",
        "it.scale",
        "sensor.translation",
        "sensor.rotation",
        "sensor.fov",
    ];

    fn emits(shape: &str) -> String {
        let light = r#"<emitter type="area"><rgb name="radiance" value="2, 1, 0"/></emitter>"#;
        shape.replace("LIGHT", light)
    }

    fn agrees(body: &str, expected: &[f64]) {
        let mut s = scene(&emits(body), 1);
        s.make_movable(&ALL).expect("known");
        let found = gradient_of::<f64>(&s, &ALL, 20);
        assert_eq!(found.len(), expected.len());
        let scale = expected.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        for (i, (e, &x)) in found.iter().zip(expected).enumerate() {
            // Single precision of vertices, and what the clearance and the inside of edges leave.
            let se = e.se + 3e-5 * scale;
            let z = (e.mean - x) / se;
            assert!(
                z.abs() < z_limit(14, RUNS, 1e-3),
                "{i}: {} +- {}, not {x}\n{body}",
                e.mean,
                e.se
            );
            assert!(e.se < 0.02 * scale, "{i}: {e:?}");
        }
    }

    fn turned(points: &[[f64; 3]]) -> Vec<Vec3<f64>> {
        let m = rotation(Vec3::new(0.0f64, 1.0, 0.0) * 0.5)
            * rotation(Vec3::new(1.0f64, 0.0, 0.0) * 0.4);
        points
            .iter()
            .map(|&p| m * Vec3::from(p) + Vec3::new(0.3, -0.2, 5.0))
            .collect()
    }

    const TURNED: &str = r#"<transform name="to_world">
        <rotate x="1" angle="22.918311805232928"/><rotate y="1" angle="28.64788975654116"/>
        <translate x="0.3" y="-0.2" z="5"/></transform>"#;

    /// Flat polygons, a disk, cubes and spheres of constant radiance before black, translated, turned and scaled, seen by a
    /// camera that moves, too: the derivative of the mean image is that of an area on the film. The creases of a cube
    /// count for nothing. 8 runs of 5760 samples of edges.
    #[test]
    #[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
    fn outlines_are_those_of_areas_on_the_film() {
        let square = [
            [-1.0, -1.0, 0.0],
            [1.0, -1.0, 0.0],
            [1.0, 1.0, 0.0],
            [-1.0, 1.0, 0.0],
        ];
        let points = turned(&square);
        let centre = turned(&[[0.0; 3]])[0];
        let of = |points: &[Vec3<f64>]| {
            let points = points.to_vec();
            derivatives(
                &move |f| hull_area(&points.iter().map(|&p| f(p)).collect::<Vec<_>>()),
                centre,
            )
        };
        let both = r#"<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>"#;
        let flip = r#"<boolean name="flip_normals" value="true"/>"#;
        agrees(
            &format!(r#"<shape type="rectangle" id="it">{flip}{TURNED}{both}LIGHT</shape>"#),
            &of(&points),
        );
        let cube: Vec<[f64; 3]> = (0..8)
            .map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|b| f64::from(2 * b - 1)))
            .collect();
        agrees(
            &format!(r#"<shape type="cube" id="it">{TURNED}LIGHT</shape>"#),
            &of(&turned(&cube)),
        );
        let n = 20_000;
        let rim: Vec<[f64; 3]> = (0..n)
            .map(|i| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(n)).sin_cos();
                [cos, sin, 0.0]
            })
            .collect();
        agrees(
            &format!(r#"<shape type="disk" id="it">{flip}{TURNED}LIGHT</shape>"#),
            &of(&turned(&rim)),
        );
        // A tube between whose ends the camera is.
        let ends: Vec<[f64; 3]> = (rim.iter().map(|p| [p[0], p[1], -2.0]))
            .chain(rim.iter().map(|p| [p[0], p[1], 2.0]))
            .map(|[x, y, z]| [0.3 * x, z * 0.4, 0.3 * y])
            .collect();
        let tilt = |p: &[f64; 3]| {
            rotation(Vec3::new(0.0, 0.0, 0.3f64)) * Vec3::from(*p) + Vec3::new(0.3, -0.2, 5.0)
        };
        let tilted = r#"<transform name="to_world"><rotate z="1" angle="17.188733853924695"/>
            <translate x="0.3" y="-0.2" z="5"/></transform>"#;
        let tube = r#"<shape type="cylinder" id="it"><point name="p0" x="0" y="-0.8" z="0"/>
            <point name="p1" x="0" y="0.8" z="0"/><float name="radius" value="0.3"/>"#;
        let ends: Vec<_> = ends.iter().map(tilt).collect();
        agrees(&format!("{tube}{tilted}LIGHT</shape>"), &of(&ends));
        // A sphere, whose area on the film is known.
        let radius = 0.8;
        let sphere = derivatives(
            &|f| {
                let c = f(centre);
                let edge = |k: usize, d: f64| {
                    let mut v = [0.0; 3];
                    v[k] = d;
                    f(centre + Vec3::from(v))
                };
                // What scales, scales the radius; the angle of view scales the film alone.
                let r = 0.5 * radius * (edge(2, 1.0) - edge(2, -1.0)).length();
                let wide = (edge(0, 1.0) - edge(0, -1.0)).length()
                    / (edge(2, 1.0) - edge(2, -1.0)).length();
                let c = Vec3::new(c.x / wide, c.y / wide, c.z);
                let scale = 0.5 * SIZE / (0.5 * FOV.to_radians()).tan() * wide;
                let area = std::f64::consts::PI * r * r * (c.length_squared() - r * r).sqrt()
                    / (c.z * c.z - r * r).powf(1.5);
                area * scale * scale
            },
            centre,
        );
        agrees(
            &format!(
                r#"<shape type="sphere" id="it"><float name="radius" value="{radius}"/>{TURNED}LIGHT</shape>"#
            ),
            &sphere,
        );
    }

    /// A room with a lamp, a cube, a ball and a tube, and a glossy mesh, all of which may move.
    const ROOM: &str = r#"
        <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.5, 0.4, 0.6"/></bsdf>
        <bsdf type="roughconductor" id="metal"><float name="alpha" value="0.4"/></bsdf>
        <shape type="cube" id="room"><boolean name="flip_normals" value="true"/>
            <transform name="to_world"><scale x="3" y="3" z="5"/></transform><ref id="grey"/></shape>
        <shape type="cube" id="block"><transform name="to_world"><scale value="0.4"/><rotate y="1" angle="30"/>
            <translate x="0.8" y="-1" z="3"/></transform><ref id="grey"/></shape>
        <shape type="sphere" id="ball"><point name="center" x="-0.7" y="-0.5" z="3"/>
            <float name="radius" value="0.6"/><ref id="grey"/></shape>
        <shape type="cylinder" id="tube"><point name="p0" x="-1" y="0.6" z="3"/><point name="p1" x="1" y="0.8" z="3.2"/>
            <float name="radius" value="0.2"/><bsdf type="twosided"><ref id="grey"/></bsdf></shape>
        <shape type="disk" id="plate"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="70"/>
            <translate x="0.3" y="0.1" z="2.5"/></transform><bsdf type="twosided"><ref id="metal"/></bsdf></shape>
        <shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.7"/><rotate x="1" angle="90"/>
            <translate y="2.5" z="2.5"/></transform>
            <emitter type="area"><rgb name="radiance" value="3, 4, 5"/></emitter></shape>"#;
    const THINGS: [&str; 6] = ["room", "block", "ball", "tube", "plate", "lamp"];

    fn room(depth: u32) -> Scene {
        let mut s = scene(ROOM, depth);
        let mut names: Vec<String> = THINGS.iter().map(|t| format!("{t}.translation")).collect();
        names.extend(THINGS.iter().map(|t| format!("{t}.rotation")));
        names.push("sensor.translation".into());
        s.make_movable(&names).expect("known");
        s
    }

    /// Where everything moves alike, the camera with it, nothing changes: every sample is zero by itself.
    #[test]
    fn nothing_changes_where_all_move_alike() {
        for depth in [2, 4] {
            let s = room(depth);
            let mut names: Vec<String> =
                THINGS.iter().map(|t| format!("{t}.translation")).collect();
            names.push("sensor.translation".into());
            let names: Vec<&str> = names.iter().map(|n| n.as_str()).collect();
            let found = gradient_of::<f64>(&s, &names, 1);
            let size = found.iter().fold(0.0, |m: f64, e| m.max(e.mean.abs()));
            assert!(size > 1e-3, "{depth}: {size}");
            for k in 0..3 {
                let sum: f64 = found.iter().skip(k).step_by(3).map(|e| e.mean).sum();
                assert!(sum.abs() < 1e-9 * size, "{depth}: {sum} of {size}");
            }
        }
    }

    /// Forward and reverse mode are one linear map.
    #[test]
    fn forward_is_reverse() {
        use crate::params::Tangent;
        use ad_core::Dual;
        let s = room(3);
        let names: Vec<&str> = (s.params().infos().iter())
            .filter(|i| i.kind.is_motion())
            .map(|i| i.name.as_str())
            .collect();
        let infos: Vec<_> = names
            .iter()
            .map(|n| s.params().find(n).expect("known"))
            .collect();
        let active = Active::of(&s, &infos);
        let values: Vec<f64> = s.params().values().iter().map(|&v| v.into()).collect();
        let n = s.film.pixels() * 3;
        let adjoint: Vec<f32> = (0..n).map(|i| (i % 7) as f32 / n as f32).collect();
        let job = Job::new(&s, &s.settings, 3, 0..1, &());
        let theta = Theta::constant(&values);
        let pass = Pass::new(&job, &theta, Caustics::Paths);
        let reverse = collect(&s, &active, 1.0, &(), &|large| {
            gradient::<f64, DetachedMis, Independent>(&pass, &active, &adjoint, large)
        });
        let reverse = reverse.values.concat();
        // All at once, each along a number of its own.
        let along = |i: usize| ((i * 37 % 11) as f64) - 5.0;
        let mut count = 0;
        let tangents: Vec<_> = (s.params().infos().iter())
            .map(|info| {
                if !info.kind.is_motion() {
                    return Tangent::None;
                }
                let own = (0..info.shape.len()).map(|_| {
                    count += 1;
                    Dual::<f64, 1>::new(0.0, [along(count - 1)])
                });
                Tangent::Dense(own.collect())
            })
            .collect();
        let theta = Theta::with_tangents(&values, &tangents);
        let pass = Pass::new(&job, &theta, Caustics::Paths);
        let image = image::<Dual<f64, 1>, DetachedMis, Independent>(&pass);
        let forward: f64 = (image.sums[1].iter().zip(&adjoint))
            .map(|(s, &a)| s * f64::from(a))
            .sum();
        let expected: f64 = reverse.iter().enumerate().map(|(i, d)| d * along(i)).sum();
        let size: f64 = reverse
            .iter()
            .enumerate()
            .map(|(i, d)| (d * along(i)).abs())
            .sum();
        assert!(
            size > 1e-3 && (forward - expected).abs() < 1e-9 * size,
            "{forward} {expected}"
        );
        assert!(image.sums[0].iter().all(|x| *x == 0.0));
    }

    /// A half-plane between a floor and a uniform sky: the irradiance is known, and how it changes as the half-plane moves.
    /// The camera is below it and sees the floor alone. 8 runs of 64 samples for each pixel.
    #[test]
    #[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
    fn a_half_plane_hides_the_sky() {
        let body = r#"
            <emitter type="constant"><rgb name="radiance" value="1, 2, 3"/></emitter>
            <shape type="rectangle" id="floor"><transform name="to_world"><scale value="100"/>
                <rotate y="1" angle="180"/><translate z="2"/></transform>
                <bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf></shape>
            <shape type="rectangle" id="it"><transform name="to_world"><scale x="100" y="400"/>
                <translate x="-99.7" z="-1"/></transform>
                <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf></bsdf></shape>"#;
        let mut s = scene(body, 2);
        let names = ["it.translation"];
        s.make_movable(&names).expect("known");
        let found = gradient_of::<f64>(&s, &names, 64);
        // Per unit of radiance: half of the sine of the angle of the edge to the vertical is hidden.
        let (edge, height) = (0.3, 3.0);
        let half = 2.0 * (0.5 * FOV.to_radians()).tan();
        let n = 2000;
        let mut expected = [0.0; 2];
        for i in 0..n {
            let x = ((f64::from(i) + 0.5) / f64::from(n) * 2.0 - 1.0) * half;
            let (to, r2) = (edge - x, (edge - x).powi(2) + height * height);
            let cosine = height / r2.sqrt();
            let scale = -0.5 * 0.5 * 2.0 * cosine / r2 / f64::from(n);
            expected[0] += scale * height;
            // Upwards is towards negative z.
            expected[1] += scale * to;
        }
        let known = [expected[0], 0.0, expected[1]];
        for (k, (e, x)) in found.iter().zip(known).enumerate() {
            let z = (e.mean - x) / e.se.hypot(1e-5);
            assert!(z.abs() < z_limit(3, RUNS, 1e-3), "{k}: {e:?}, not {x}");
            assert!(e.se < 0.02 * expected[0].abs(), "{k}: {e:?}");
        }
    }
}
