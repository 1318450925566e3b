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
//! there is nothing behind. Faces that meet at an angle are no outline there. Where it is a lamp that is behind an edge, and
//! the first vertex that sees it, such samples are drawn from the lamp instead ([`shadows`]).
//!
//! A camera with a lens is a pinhole beside its axis for every point of the lens: samples on the film take such a point, and
//! are the derivative of what that pinhole sees. By parallel rays, curves move across the rays, and lengths and areas are those
//! of a film in the scene; divided by the distance from it and by its square, they are what angles are otherwise.
//!
//! Everything but the velocities is a constant. A sample is therefore a colour times a [linear form](Form) in the
//! velocities of a few points: forward mode evaluates it, reverse mode adds its transpose to adjoints.
//!
//! # Reference
//! [Li et al. 2018] for derivatives by samples of edges, and for the tree over them; the form that follows the material
//! beyond the first vertex is that of [Zhang et al. 2020], in directions.

mod candidates;
mod crossings;
mod form;
mod shadows;
mod turning;

use std::f64::consts::TAU;
use std::ops::Range;

use ad_core::{Const, Float, Vec3};
use smallvec::SmallVec;

use self::candidates::{CANDIDATES, Candidates};
use self::form::{Contribution, Form, Mover, Moving, Term, hit_at};
use self::shadows::Lights;
use super::active::Active;
use super::exact::ExactBuffer;
use super::particle;
use super::pass::Pass;
use super::path::{Context, Walk};
use super::paths::{TileSums, assemble, deposit};
use super::record::{Interest, Observer, Place};
use super::rendering::{Components, NonFinite, Rendering};
use super::sink::{GradientSums, Sink};
use super::tile::{Paths, Sample, on_lens, place, spot};
use super::vertex::MODE;
use crate::bsdf::{Bsdf, Shading};
use crate::camera::{CameraSample, Viewer};
use crate::edges::Inside;
use crate::edges::crossing::Crossings;
use crate::edges::film::{FilmCurves, FilmPoint, Sides};
use crate::edges::{Dice, EdgePoint, Edges, Eye, Seeker, Surfaces};
use crate::emitter::{AnyEmitter, Ball, Emitter};
use crate::estimator::Strategy;
use crate::math::{Frame, NOWHERE, Ray, RayAdjoint, Rgb, Segment};
use crate::parallel;
use crate::params::Theta;
use crate::sampler::{Family, Purpose, Sampler};
use crate::scene::{Caustics, Intersection};
use crate::shape::{Shape, SurfaceInteraction};

/// How far rays pass from an edge that they are to clear, relative to its distance, and to the largest coordinate of its
/// shape: several roundings of an f32.
const CLEARANCE: [f64; 2] = [3e-5, 1e-6];
/// What is met beside an edge nearer than this part of its distance hides it.
const SAME_DEPTH: f64 = 1.0 - 1e-3;
/// What is met nearer than this part of the distance of the point itself, and is none of its faces, hides it.
const BEFORE: f64 = 1.0 - 1e-5;
/// Rays in the plane of a face are so far beside it, relative to its size, that they pass the seams of its neighbours.
const OFF_PLANE: f64 = 2e-5;
/// The normal of an edge and that of a face whose plane it lies in have a cosine above this.
const IN_PLANE: f64 = 1.0 - 1e-8;
/// What edges that do not move count beside others, where the vertex does not move either: what is behind them may.
const STILL: f64 = 0.1;
/// What an edge counts that no lamp is behind, as far as that can be told.
const UNLIT: f64 = 0.1;
/// What the first vertex of a path counts among all that look for edges, where those before lights are drawn from these.
const WITHOUT_LIGHTS: f64 = 0.25;
/// Pixels per sample of an edge on the film.
const PIXELS_PER_SAMPLE: u64 = 2;
/// Jobs of a pass over the film at a time, and samples of each.
const JOBS: u64 = 64;
const CHUNK: u64 = 1024;

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
    crossings: &'a Crossings,
    /// Whether paths look for lines along which surfaces cross, and whether any of those is on a lamp.
    crossed: [bool; 2],
    surfaces: Surfaces<'a>,
    curves: FilmCurves,
    shadows: Lights,
    /// Around the scene, if shadows are drawn from any light without area.
    ball: Option<Ball>,
    /// How light goes on from what lights that are points illuminate, if paths are long enough for that.
    onwards: Option<particle::Context<'a, P>>,
    turning: Lights,
    /// From the middle of its lens, if the camera has one.
    viewer: Viewer<P>,
    moving: Moving,
    seed: u64,
}

/// Where samples come from that each have a place on the film of their own.
#[derive(Clone, Copy)]
enum Source {
    /// Edges on the film.
    Film,
    /// Edges before lights.
    Shadows,
    /// Where lamps turn away.
    Turns,
}

impl Source {
    const ALL: [Self; 3] = [Self::Film, Self::Shadows, Self::Turns];
}

fn wide<P: Float>(v: Vec3<P>) -> Vec3<f64> {
    v.map(P::to_f64)
}

impl<'a, P: Float> Boundary<'a, P> {
    fn new(context: Context<'a, P>, seed: u64, moving: Moving) -> Self {
        let scene = context.scene;
        let edges = scene.edges();
        let hidden = context.settings.hides(1);
        // Those that nobody sees draw nothing.
        let of_film = |shapes: Range<u32>| {
            let shown = !hidden || shapes.clone().any(|shape| !scene.is_lamp(shape));
            shown && (moving.camera || moving.any(shapes))
        };
        let crossings = scene.crossings();
        // A lamp that nobody sees ends nothing else.
        let of_pair = |pair: [u32; 2]| {
            let shown = !hidden || !pair.iter().any(|&shape| scene.is_lamp(shape));
            shown && (moving.camera || moving.parts(pair))
        };
        let curves = edges.on_film(&scene.camera, &scene.film, &of_film, crossings, &of_pair);
        let max_depth = context.settings.max_depth;
        let apart = |pair: &[u32; 2]| moving.parts(*pair);
        let deltas = scene.emitters().iter().any(AnyEmitter::is_delta);
        let longer = max_depth > 2 && deltas;
        let lamp = |pair: [u32; 2]| pair.iter().any(|&shape| scene.is_lamp(shape));
        let crossed = [
            crossings.shapes().any(|pair| apart(&pair)),
            crossings.shapes().filter(apart).any(lamp),
        ];
        Self {
            context: Context {
                caustics: Caustics::Paths,
                ..context
            },
            edges,
            crossings,
            crossed,
            surfaces: scene.surfaces(),
            curves,
            shadows: Lights::of(scene, max_depth, AnyEmitter::draws_shadows),
            ball: (deltas.then(|| Ball::around(scene.shapes()))).flatten(),
            onwards: longer
                .then(|| particle::Context::unchecked(scene, context.theta, context.settings)),
            turning: Lights::of(scene, max_depth, |e| scene.turns_away(e)),
            viewer: scene.camera.viewer(&scene.film, [P::of(0.5); 2]),
            moving,
            seed,
        }
    }

    /// How many samples of a source there are for every sample of all pixels.
    fn per_sample(&self, source: Source) -> u64 {
        let any = match source {
            Source::Film => self.curves.length() > 0.0,
            Source::Shadows => self.shadows.any(),
            Source::Turns => self.turning.any(),
        };
        let pixels = self.context.scene.film.pixels() as u64;
        if any {
            pixels.div_ceil(PIXELS_PER_SAMPLE)
        } else {
            0
        }
    }

    /// Calls `each` with what number `i` of all samples of a source brings: where on the film, and of what.
    fn sample<S: Strategy, X: Sampler>(
        &self,
        source: Source,
        i: u64,
        each: &mut dyn FnMut([f64; 2], Contribution<P>),
    ) {
        let one = match source {
            Source::Film => {
                let count = self.per_sample(source);
                self.on_film::<S, X>([i % count, count], i / count)
            }
            Source::Shadows => return self.before_light(i, each),
            Source::Turns => self.at_turn(i),
        };
        if let Some((at, c)) = one {
            each(at, c);
        }
    }

    /// Whether paths look for edges, or for horizons of their own vertices.
    fn at_vertices(&self) -> bool {
        let horizons = self.edges.has_turns() && self.context.settings.max_depth > 1;
        horizons || self.crossings_at(1) || self.edges_at_vertices()
    }

    fn edges_at_vertices(&self) -> bool {
        match self.context.settings.max_depth {
            0..=1 => false,
            2 => self.context.scene.has_sky(),
            _ => true,
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
        // What is drawn from lights sees those of areas behind edges from the first vertex.
        let found = depth == 2 && hit.is_some() && self.shadows.any();
        Walk::<P, S::Still, X>::behind(ray, sampler, depth, !found).finish_at(&self.context, hit)
    }

    /// How far beside an edge of a shape rays pass that see it at a distance.
    fn clearance(&self, shape: u32, distance: f64) -> f64 {
        let extent = f64::from(self.surfaces.shapes[shape as usize].extent());
        (CLEARANCE[0] * distance).max(CLEARANCE[1] * extent)
    }

    /// Whether a vertex with this normal, on that shape, cannot tell on which side of an edge it is: it is as near to it as
    /// roundings are, or sees it along its own surface, where nothing is scattered. What is behind such an edge would be
    /// chance, and count the inverse of its distance.
    fn is_touched(
        &self,
        edge: &EdgePoint,
        (x, shape): (Vec3<f64>, u32),
        normal: Vec3<f64>,
    ) -> bool {
        let rounding = [edge.shape, shape].map(|shape| self.clearance(shape, edge.distance));
        let rounding = rounding[0].max(rounding[1]);
        let height = (edge.p - x).dot(normal);
        height.abs() <= rounding || edge.distance <= rounding
    }

    /// The ray that passes an edge, by an eye that sees that along another ray, and what it meets as the edge number `depth` of
    /// a path, if it is one that the camera may see; `None` if something hides the edge.
    fn past(
        &self,
        edge: &EdgePoint,
        (eye, from): (&Eye, Ray<P>),
        depth: u32,
    ) -> Option<(Ray<P>, Option<Intersection<P>>)> {
        let scene = self.context.scene;
        let hidden = self.context.settings.hides(depth);
        let clearance = self.clearance(edge.shape, edge.distance).max(edge.seam);
        let beside = edge.p + edge.normal * clearance;
        let o = eye.origin(beside).map(P::of);
        let d = (beside - wide(o)).normalize();
        let ray = Ray {
            o,
            d: d.map(P::of).normalize(),
            ..from
        };
        let hit = scene.seen(&ray, hidden);
        let nearer = |part: f64| hit.is_some_and(|hit| f64::from(hit.t) < part * edge.distance);
        if nearer(SAME_DEPTH) || nearer(BEFORE) && self.hidden(edge, from, hidden) {
            return None;
        }
        let theta = Theta::still();
        Some((ray, hit.map(|hit| scene.interaction(&theta, &ray, &hit))))
    }

    /// Whether something just before the edge of a face hides it, that the ray beside it does not tell from what the edge
    /// touches. `through`: whether that may be a lamp.
    fn hidden(&self, edge: &EdgePoint, from: Ray<P>, through: bool) -> bool {
        let scene = self.context.scene;
        let to = scene.exit(self.surfaces.material::<P>(edge).0).surface;
        let d = edge.direction.map(P::of).normalize();
        let segment = Segment {
            ray: Ray { d, ..from },
            length: P::of(edge.distance * BEFORE),
            to,
        };
        to != NOWHERE && scene.out_of_sight(&segment, through)
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
        let mut sampler = X::spread(points, Family::EdgesOnFilm.seed(self.seed), index, sample);
        let u: f64 = sampler.next_1d();
        let lens = on_lens(scene, sampler);
        let beside = (scene.camera.thin_lens()).map(|thin| {
            let off = thin.off(lens.map(P::to_f64));
            self.curves.middle().beside(&scene.camera, off)
        });
        let point = self.curves.point(
            (self.edges, self.crossings),
            beside.as_ref().unwrap_or(self.curves.middle()),
            (index as f64 + u) / count as f64,
        )?;
        let FilmPoint {
            at,
            eye,
            edge,
            sides,
        } = point;
        let film = at.map(P::of);
        let seen = CameraSample { film, lens };
        let origin = eye.origin(edge.p).map(P::of);
        let ray = Ray::new(origin, edge.direction.map(P::of).normalize());
        let inside = |inside: &Inside| {
            let (prim, at) = self.surfaces.inside::<P>(edge.shape, inside);
            let mut si = scene.point_at(&Theta::still(), prim, at);
            si.t = P::of(edge.distance);
            let shape = edge.shape;
            let hit = Intersection { shape, prim, si };
            let mut walk = Walk::<P, S::Still, X>::behind(ray, sampler, 1, true);
            walk.step(&self.context, Some(hit), false, &mut ());
            if let Some(beside) = inside.beside {
                let other = self.surfaces.firsts[shape as usize] + beside.local;
                let surface = scene.exit(other).surface;
                let shadow = walk.shadow.iter_mut().map(|s| &mut s.ray);
                for ray in walk.ray.iter_mut().chain(shadow) {
                    if !beside.is_met(wide(ray.d)) {
                        ray.from = surface;
                    }
                }
            }
            walk.finish(&self.context, &mut ())
        };
        let mut weight = edge.weight / count as f64;
        let jump = match &sides {
            Sides::Outline(front) => {
                let (past, hit) = self.past(&edge, (&eye, ray), 1)?;
                weight *= hit.map_or(1.0, |hit| self.share_of_contact(&edge, &past, &hit));
                inside(front) - self.radiance::<S, X>(past, hit, 1, sampler)
            }
            Sides::Crease(near, far) | Sides::Turn([near, far], ..) => {
                // Nothing but the faces themselves: others may be as near as faces are small.
                let [from, to] = [near, far].map(|inside| {
                    let (prim, _) = self.surfaces.inside::<P>(edge.shape, inside);
                    scene.exit(prim).surface
                });
                let segment = Segment {
                    ray: Ray { from, ..ray },
                    length: P::of(edge.distance * BEFORE),
                    to,
                };
                if scene.out_of_sight(&segment, self.context.settings.hides(1)) {
                    return None;
                }
                // Where that lies on another surface, one of them may be behind it.
                if let Some(faces) = sides.faces()
                    && self.crossings.hold(faces, &edge)
                {
                    return None;
                }
                inside(near) - inside(far)
            }
            Sides::Crossing(parts) => {
                let c =
                    self.crossing_on_film::<S, X>((seen, &eye, &edge, *parts), count, sampler)?;
                return Some((at, c));
            }
        };
        if jump.is_black() {
            return None;
        }
        let value = jump.scale(P::of(weight));
        if let Sides::Turn(_, slope, shading) = sides {
            let form = self.of_turn(&edge, slope, shading, seen);
            return Some((at, Contribution { value, form }));
        }
        let n = edge.normal * edge.distance.recip();
        let mut form: Form<P> = self.of_edge(&edge, n).into_iter().collect();
        if self.moving.camera {
            form.push(Term {
                mover: Mover::Camera(seen),
                along: RayAdjoint {
                    o: (-n).map(P::of),
                    d: (-edge.normal).map(P::of),
                },
            });
        }
        Some((at, Contribution { value, form }))
    }

    /// The speed on the film of a curve where normals turn away: it slides over the material, so that the cosine between
    /// view and normal stays zero.
    fn of_turn(
        &self,
        edge: &EdgePoint,
        slope: f64,
        shading: Vec3<f64>,
        at: CameraSample<P>,
    ) -> Form<P> {
        let scene = self.context.scene;
        let (prim, spot) = self.surfaces.material::<P>(edge);
        let mut si = scene.point_at(&Theta::still(), prim, spot);
        si.t = P::of(edge.distance);
        // Meshes may be turned inside out.
        let slope = slope * wide(si.frame.n).dot(shading).signum();
        let term = |mover: Mover<P>, along: Vec3<f64>| Term {
            mover,
            along: RayAdjoint {
                o: Vec3::zero(),
                d: along.map(P::of),
            },
        };
        let mut form = Form::new();
        form.push(term(
            Mover::Seen(prim, at, si),
            edge.direction * -slope.recip(),
        ));
        if self.moving.camera {
            form.push(term(Mover::Camera(at), wide(si.frame.n) * -slope.recip()));
        }
        form
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
        let both = from_border.abs() * edge.distance
            < 10.0 * self.clearance(edge.shape, edge.distance)
            && !self.crossings.go_on(edge, hit.shape);
        if both { 0.5 } else { 1.0 }
    }

    /// An edge that hides light from the vertex number `depth` of a path, of which the camera's side stays.
    fn at_vertex<S: Strategy, X: Sampler>(
        &self,
        beta: Rgb<P>,
        here: &Place<P>,
        depth: u32,
        at: CameraSample<P>,
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
        // Lamps behind edges have samples of their own.
        let found = depth == 1 && self.shadows.any();
        let seen_from_above = wo.z >= P::zero();
        let normal = wide(si.n_geo) * if seen_from_above { 1.0 } else { -1.0 };
        let seeker = Seeker {
            eye: Eye::point(x),
            normal,
            lamps: if found { None } else { scene.lamps() },
            lamps_only: depth + 1 >= self.context.settings.max_depth,
            interest: &interest,
        };
        let lamps = seeker.cones();
        let material = scene.material(here.shape);
        let shading = Shading::new(*self.context.theta, si.uv);

        // ---- One of a few candidates ----
        sampler.seek(Purpose::Edges(CANDIDATES).at(depth));
        let draws: [[f64; 2]; CANDIDATES as usize] = std::array::from_fn(|_| sampler.next_2d());
        let mut candidates = Candidates::new(sampler.next_1d());
        for u in draws {
            let Some(edge) = self.edges.draw(&seeker, &lamps, u) else {
                continue;
            };
            if self.is_touched(&edge, (x, here.shape), normal) {
                continue;
            }
            // The sides of its own face are its horizon.
            if si.n_geo != si.frame.n && edge.normal.dot(normal).abs() > IN_PLANE {
                continue;
            }
            let d = edge.direction.map(P::of).normalize();
            let wi = si.frame.to_local(d);
            let f = material.eval(&shading, *wo, wi, MODE);
            let lit = if found || scene.may_meet_light(&Ray::new(si.p, d)) {
                1.0
            } else if seeker.lamps_only {
                0.0
            } else {
                UNLIT
            };
            let speed = interest(edge.shape..edge.shape + 1) / edge.distance;
            let target = f.max_component().to_f64() * lit * speed;
            candidates.add((edge, f), target, edge.weight);
        }
        let ((edge, f), weight) = candidates.kept()?;

        // ---- What is behind it ----
        let from = si.spawn_ray(edge.direction.map(P::of).normalize(), scene.exit(here.prim));
        let eye = Eye::point(wide(from.o));
        let (ray, hit) = self.past(&edge, (&eye, from), depth + 1)?;
        let light = self.radiance::<S, X>(ray, hit, depth + 1, sampler);
        if light.is_black() {
            return None;
        }
        let n = edge.normal;
        let near = edge.distance.recip();
        let mut form: Form<P> = self.of_edge(&edge, n * near).into_iter().collect();
        self.add_sight(&mut form, (here, depth, at), hit, (n, near));
        let value = -(beta * f * light).scale(P::of(weight));
        (!form.is_empty()).then_some(Contribution { value, form })
    }

    /// Adds to the motion of an edge, seen at the inverse distance `near` across the plane with the normal `n`, those of what
    /// is behind it and of the vertex that looks past it, which the camera sees `at` a point if it is the first one.
    fn add_sight(
        &self,
        form: &mut Form<P>,
        (here, depth, at): (&Place<P>, u32, CameraSample<P>),
        hit: Option<Intersection<P>>,
        (n, near): (Vec3<f64>, f64),
    ) {
        let mut far = 0.0;
        if let Some(hit) = hit {
            far = (wide(hit.si.p) - wide(here.si.p)).length().recip();
            form.extend(self.material(hit.prim, hit.shape, || hit.si, n * -far));
        }
        let along = n * (far - near);
        if depth > 1 {
            form.extend(self.material(here.prim, here.shape, || here.si, along));
        } else if self.moving.shapes[here.shape as usize] || self.moving.camera {
            form.push(Term::point(Mover::Seen(here.prim, at, here.si), along));
        }
    }

    /// The horizon of the face of a vertex whose shading normal is another one: light from just above and just below, which
    /// the face itself hides. A point of its plane stays there, so that the horizon moves as an edge.
    fn at_horizon<S: Strategy, X: Sampler>(
        &self,
        beta: Rgb<P>,
        here: &Place<P>,
        depth: u32,
        at: CameraSample<P>,
        mut sampler: X,
        each: &mut impl FnMut(Contribution<P>),
    ) {
        let scene = self.context.scene;
        let Place { si, wo, .. } = here;
        if scene.shape_info(here.shape).delta
            || beta.is_black()
            || depth >= self.context.settings.max_depth
        {
            return;
        }
        sampler.seek(Purpose::Horizon.at(depth));
        let u: f64 = sampler.next_1d();
        let normal = wide(si.n_geo);
        let around = Frame::from_normal(normal);
        let (sin, cos) = (TAU * u).sin_cos();
        let direction = around.s * cos + around.t * sin;
        let shading = Shading::new(*self.context.theta, si.uv);
        let wi = si.frame.to_local(direction.map(P::of).normalize());
        let f = (scene.material(here.shape)).eval(&shading, *wo, wi, MODE);
        if f.is_black() {
            return;
        }
        let shape = &self.surfaces.shapes[here.shape as usize];
        let reach = f64::from(shape.extent());
        let x = wide(si.p);
        let local = here.prim - self.surfaces.firsts[here.shape as usize];
        let area = shape.area_element(self.context.theta, local).to_f64();
        let beside = OFF_PLANE * area.sqrt();
        let edge = {
            let p = (x + direction * reach).map(P::of);
            let uv = shape.locate(local, p).0;
            SurfaceInteraction { p, uv, ..*si }
        };
        for side in [1.0, -1.0] {
            let n = normal * side;
            let d = (direction + n * CLEARANCE[0]).map(P::of).normalize();
            let mut ray = si.spawn_ray(d, scene.exit(here.prim));
            ray.o += (n * beside).map(P::of);
            let hit =
                (scene.nearest(&ray)).map(|hit| scene.interaction(&Theta::still(), &ray, &hit));
            let light = Walk::<P, S::Still, X>::behind(ray, sampler, depth + 1, true)
                .finish_at(&self.context, hit);
            if light.is_black() {
                continue;
            }
            let near = reach.recip();
            let mut form: Form<P> = Form::new();
            form.extend(self.material(here.prim, here.shape, || edge, n * near));
            self.add_sight(&mut form, (here, depth, at), hit, (n, near));
            if !form.is_empty() {
                let value = -(beta * f * light).scale(P::of(TAU));
                each(Contribution { value, form });
            }
        }
    }

    /// Calls `each` with contributions to the pixel of a sample at one of the vertices of its path, which is drawn in
    /// proportion to what they bring of what they see: an edge costs more than the path that leads to it.
    fn along_path<S: Strategy, X: Sampler>(
        &self,
        sample: &Sample,
        vertices: &Vertices<P>,
        mut each: impl FnMut(Contribution<P>),
    ) {
        let points = self.context.settings.points;
        let (at, sampler) = spot::<P, X>(
            self.context.scene,
            points,
            Family::EdgesAtVertices.seed(self.seed),
            sample.pixel,
            sample.index,
        );
        let Some((depth, weight)) = self.choose_vertex(vertices, sampler) else {
            return;
        };
        let (beta, here) = &vertices.0[depth as usize - 1];
        let beta = beta.scale(P::of(weight));
        if self.edges_at_vertices()
            && let Some(c) = self.at_vertex::<S, X>(beta, here, depth, at, sampler)
        {
            each(c);
        }
        if self.crossings_at(depth)
            && let Some(c) = self.crossing_at_vertex::<S, X>(beta, here, depth, sampler)
        {
            each(c);
        }
        if here.si.n_geo != here.si.frame.n {
            self.at_horizon::<S, X>(beta, here, depth, at, sampler, &mut each);
        }
    }

    /// The number of a vertex that sees something, counted from one, and one over the probability that it is this one.
    fn choose_vertex<X: Sampler>(
        &self,
        vertices: &Vertices<P>,
        mut sampler: X,
    ) -> Option<(u32, f64)> {
        let scene = self.context.scene;
        let found = self.shadows.any() && !scene.has_sky();
        let share = |((beta, here), depth): (&(Rgb<P>, Place<P>), u32)| {
            let brings = if scene.shape_info(here.shape).delta {
                0.0
            } else if depth == 1 && found {
                WITHOUT_LIGHTS
            } else {
                1.0
            };
            let beta = beta.to_array().map(|b| b.to_f64().abs());
            brings * beta.into_iter().fold(0.0, f64::max)
        };
        let see = self.context.settings.max_depth.saturating_sub(1) as usize;
        let looking = vertices.0.iter().take(see).zip(1..);
        let shares: SmallVec<[f64; 8]> = looking.map(share).collect();
        sampler.seek(Purpose::Vertex.at(1));
        let (chosen, p) = Dice::new(sampler.next_1d()).choose(&shares)?;
        Some((chosen as u32 + 1, p.recip()))
    }
}

/// Adds the samples of a source to derivative images. Whether all of them were.
fn splat<R: Components, S: Strategy, X: Sampler>(
    pass: &Pass<R>,
    boundary: &Boundary<R::Primal>,
    source: Source,
    color: &(impl Fn(&Contribution<R::Primal>) -> Rgb<R> + Sync),
    out: &mut Rendering,
) -> bool {
    let film = &pass.scene.film;
    let per_sample = boundary.per_sample(source);
    let first = pass.samples.start * per_sample;
    let end = pass.samples.end.max(pass.samples.start) * per_sample;
    for start in (first..end).step_by((JOBS * CHUNK) as usize) {
        if pass.progress.cancelled() {
            return false;
        }
        let stop = (start + JOBS * CHUNK).min(end);
        let jobs = (stop - start).div_ceil(CHUNK) as usize;
        let parts = parallel::map(jobs, |job| {
            let own = start + job as u64 * CHUNK;
            let mut splats = Vec::new();
            let mut non_finite = NonFinite::default();
            for i in own..(own + CHUNK).min(stop) {
                boundary.sample::<S, X>(source, i, &mut |at, c| {
                    let value = color(&c);
                    if value.is_finite() {
                        splats.push((at, value));
                    } else {
                        non_finite.add(i % per_sample, i / per_sample);
                    }
                });
            }
            (splats, non_finite)
        });
        for (splats, non_finite) in &parts {
            out.non_finite.merge(non_finite);
            for (at, value) in splats {
                film.splat(*at, film.rows(at[1]), |pixel, weight| {
                    for (k, sums) in out.sums.iter_mut().enumerate() {
                        for c in 0..3 {
                            sums[pixel * 3 + c] += value[c].component(k) * weight;
                        }
                    }
                });
            }
        }
    }
    true
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

    for source in Source::ALL {
        if !splat::<R, S, X>(pass, &boundary, source, &color, &mut out) {
            out.cancelled = true;
            return out;
        }
    }
    if !boundary.at_vertices() {
        pass.progress.advance(scene.film.pixels() as u64);
        return out;
    }

    // ---- Edges that hide light from later vertices ----
    let tiles = pass.tiles();
    let spp = pass.samples.end.saturating_sub(pass.samples.start) as f64;
    let parts = parallel::map(tiles.len(), |i| -> TileSums {
        let tile = &tiles[i];
        let pixels = tile.pixels();
        let mut sums = vec![0.0f64; R::COUNT * pixels * 3];
        let mut non_finite = NonFinite::default();
        let mut paths = Paths::<R::Primal, S::Still, X, _>::new(Vertices(Vec::new()));
        let seed = Family::EdgesAtVertices.seed(boundary.seed);
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
        tile.trace(&boundary.context, (seed, &pass.samples), &mut paths, done);
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

    // ---- Samples with places of their own on the film ----
    for source in Source::ALL {
        let per_sample = boundary.per_sample(source);
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
                boundary.sample::<S, X>(source, i, &mut |at, c| {
                    if !c.is_finite() {
                        non_finite.add(i % per_sample, i / per_sample);
                        return;
                    }
                    let mut d = [0.0; 3];
                    let film = &scene.film;
                    film.splat(at, film.rows(at[1]), |pixel, weight| {
                        for (k, d) in d.iter_mut().enumerate() {
                            *d += weight * f64::from(adjoint[pixel * 3 + k]);
                        }
                    });
                    let d = d.map(|d| P::of(d / samples as f64));
                    scatter(&c, Rgb::from(d), &mut sink);
                });
            }
            (sink.into_small(), non_finite)
        });
        out = out.with_parts(parts);
    }
    if !boundary.at_vertices() {
        pass.progress.advance(scene.film.pixels() as u64);
        return out;
    }

    // ---- Edges that hide light from later vertices ----
    let tiles = pass.tiles();
    let jobs = (2 * JOBS as usize).min(tiles.len());
    let parts = parallel::map(jobs, |job| {
        let mut sink = Sink::new(active, large);
        let mut non_finite = NonFinite::default();
        let mut paths = Paths::<P, S::Still, X, _>::new(Vertices(Vec::new()));
        let seed = Family::EdgesAtVertices.seed(boundary.seed);
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
            tile.trace(&boundary.context, (seed, &pass.samples), &mut paths, done);
            pass.progress.advance(tile.pixels() as u64);
        }
        (sink.into_small(), non_finite)
    });
    out = out.with_parts(parts);
    out
}

#[cfg(test)]
mod tests;
