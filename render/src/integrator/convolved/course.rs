//! A path whose directions follow what they meet, and its adjoint.

use ad_core::{Dual, Float, Vec2, Vec3};
use smallvec::SmallVec;

use super::chain::{self, Sight};
use super::closed::{self, Anchor};
use super::field::{Influence, KAPPA, LARGEST, Neighbour, convolve};
use super::outlines::Outlines;
use crate::bsdf::{Component, Shading};
use crate::camera::{CameraSample, FilmPoint};
use crate::edges::Edges;
use crate::emitter::{Emitter, EmitterSample, Rays};
use crate::estimator::{Follows, Strategy};
use crate::integrator::active::Active;
use crate::integrator::delta::{self, Delta};
use crate::integrator::motion::slopes::{across, slope, slopes, varied};
use crate::integrator::motion::trail::{Edge, Trail, met, sampled_point};
use crate::integrator::path::Context;
use crate::integrator::record::{Place, SampledLight};
use crate::math::{Frame, Ray, RayAdjoint, Rgb};
use crate::params::{GradSink, Theta};
use crate::sampler::{Family, Points, Purpose, Sampler};
use crate::scene::Scene;
use crate::shape::{SurfaceAdjoint, SurfaceCoordinates, SurfaceInteraction};

fn wide<P: Float>(v: Vec3<P>) -> Vec3<f64> {
    v.map(P::to_f64)
}

/// What is known of outlines.
pub(super) enum Known<'a> {
    /// How far what so many auxiliary rays meet is from them.
    Sampled(Outlines<'a>, u32),
    /// All of them, in closed form.
    Closed(&'a Edges),
}

impl<'a> Known<'a> {
    pub fn of<S: Strategy>(scene: &'a Scene) -> Self {
        match S::FOLLOWS {
            Follows::Sampled(rays) => Self::Sampled(Outlines::of(scene), rays),
            Follows::Nothing | Follows::Closed => Self::Closed(scene.edges()),
        }
    }
}

/// Where a ray starts.
#[derive(Clone, Copy)]
enum Start<P> {
    /// At this place of its lens.
    Camera([P; 2]),
    /// On a surface with this normal.
    Surface(Vec3<f64>),
}

/// A neighbour, or a point beside the direction, whose velocity counts.
struct Follower<P> {
    /// Unit direction, which its velocity has no part along; zero for points, whose velocities are taken as they are.
    d: Vec3<f64>,
    /// One over the distance of what it met; zero where it met nothing, one for points.
    near: f64,
    /// What it met, or the point, if that moves.
    met: Option<(u32, SurfaceInteraction<P>)>,
    /// What of the camera sees it, if it leaves one that moves.
    at_camera: Option<CameraSample<P>>,
    /// Over which mirrors and glass it is seen, which have a velocity of their own to add; `near` and `met` say nothing then.
    sight: Option<Box<Sight<P>>>,
    influence: Influence,
}

/// The velocity field around a direction.
pub(super) struct Field<P> {
    w: Vec3<f64>,
    followers: SmallVec<[Follower<P>; 16]>,
}

/// The adjoints of what an edge ends at and of its direction.
#[derive(Clone, Copy)]
struct EdgeAdjoint<P> {
    end: SurfaceAdjoint<P>,
    d: Vec3<P>,
}

impl<P: Float> EdgeAdjoint<P> {
    fn zero() -> Self {
        Self {
            end: SurfaceAdjoint::zero(),
            d: Vec3::zero(),
        }
    }
}

/// A vertex of a path, and what follows from it.
struct Bend<P> {
    /// What arrives along the scattered direction.
    arriving: Rgb<P>,
    scattered: Option<Field<P>>,
    sampled: Option<Field<P>>,
}

/// A path with the fields around its directions.
pub(super) struct Course<P> {
    at: CameraSample<P>,
    camera: Ray<P>,
    /// Radiance.
    l: Rgb<P>,
    first: Option<Field<P>>,
    /// One per stop of the trail.
    bends: Vec<Bend<P>>,
}

/// Where the random numbers of a sample come from.
#[derive(Clone, Copy)]
pub(super) struct Numbers {
    pub seed: u64,
    /// Of the whole film.
    pub pixel: u64,
    pub sample: u64,
}

/// For auxiliary rays around an edge: neighbours have to be independent of each other.
fn sampler<X: Sampler>(numbers: Numbers, family: Family, rays: u32, depth: u32) -> X {
    let Numbers {
        seed,
        pixel,
        sample,
    } = numbers;
    let mut sampler = X::spread(Points::Independent, family.seed(seed), pixel, sample);
    sampler.seek(Purpose::AuxiliaryRays(rays).at(depth));
    sampler
}

/// Makes fields, and adds the adjoints of paths in them to the parameters that move anything.
///
/// A path is a sequence of rays: each starts where the one before it ended, in a direction whose velocity is that of the field
/// around it, and everything at a vertex follows from where both rays are. So adjoints are handed on from the end of the path
/// to the camera, through each intersection, and on the way from every direction to what its auxiliary rays met.
///
/// # Reference
/// [Zeltner 2021, algorithms 4.3 and 4.4] with errata Z-4.15, Z-Alg-4.3, Z-4.22 and Z-4.48.
pub(super) struct Follow<'a, P: Float> {
    scene: &'a Scene,
    theta: &'a Theta<'a, P>,
    /// Whether the camera looks through lamps.
    hidden: bool,
    active: &'a Active,
    known: &'a Known<'a>,
    neighbours: Vec<(Neighbour, f64)>,
    influences: Vec<Influence>,
}

impl<'a, P: Float> Follow<'a, P> {
    pub fn new(context: &Context<'a, P>, active: &'a Active, known: &'a Known<'a>) -> Self {
        Self {
            scene: context.scene,
            theta: context.theta,
            hidden: context.settings.hides(1),
            active,
            known,
            neighbours: Vec::new(),
            influences: Vec::new(),
        }
    }

    /// The field around the direction of a ray, which starts at a point that may move and goes on along these deltas. `None`
    /// if nothing moves there.
    fn field<X: Sampler>(
        &mut self,
        (ray, deltas): (Ray<P>, &[Delta]),
        origin_moves: bool,
        start: Start<P>,
        (numbers, family, depth): (Numbers, Family, u32),
    ) -> Option<Field<P>> {
        match self.known {
            Known::Sampled(outlines, rays) => {
                let sampler = sampler::<X>(numbers, family, *rays, depth);
                self.sampled_field(
                    (ray, deltas),
                    origin_moves,
                    start,
                    (outlines, *rays),
                    sampler,
                )
            }
            Known::Closed(edges) => self.closed_field(ray, origin_moves, start, edges),
        }
    }

    /// Where outlines are known in closed form: [`closed`].
    fn closed_field(
        &self,
        ray: Ray<P>,
        origin_moves: bool,
        start: Start<P>,
        edges: &Edges,
    ) -> Option<Field<P>> {
        let scene = self.scene;
        let w = wide(ray.d).normalize();
        let (frame, o) = (Frame::from_normal(w), wide(ray.o));
        let reach = match start {
            Start::Camera(_) => (closed::REACH.min(scene.camera.half_angle()), None),
            Start::Surface(normal) => (closed::REACH, Some(normal)),
        };
        let anchors = Anchor::of_outlines(edges, &frame, o, reach);
        let through = matches!(start, Start::Camera(_)) && self.hidden;
        let met = scene.seen(&ray, through).map(|hit| {
            let met = scene.interaction(&Theta::still(), &ray, &hit);
            let (shape, si) = (scene.shape_of(hit.prim), met.si);
            let local = hit.prim - scene.primitive(shape, 0);
            Anchor::met((shape, local), &frame, o, wide(si.p), wide(si.n_geo))
        });
        let moves = |a: &Anchor| self.active.moves_shape(a.shape);
        if !(origin_moves || anchors.iter().chain(&met).any(moves)) {
            return None;
        }
        let sum = closed::total(&anchors, met.as_ref());
        let mut followers = SmallVec::new();
        for anchor in anchors.iter().chain(&met) {
            let moves = moves(anchor);
            let prim = scene.primitive(anchor.shape, anchor.local);
            let somewhere = SurfaceCoordinates(Vec2::new(P::of(0.25), P::of(0.25)));
            let at: Option<SurfaceInteraction<P>> =
                moves.then(|| scene.point_at(&Theta::still(), prim, somewhere));
            anchor.pulls(&frame, sum, moves, |(p, influence)| {
                let p = p.map(P::of);
                followers.push(Follower {
                    d: Vec3::zero(),
                    near: 1.0,
                    // A shape that moves as a whole moves points that are not on it alike.
                    met: at.map(|si| (prim, SurfaceInteraction { p, ..si })),
                    at_camera: None,
                    sight: None,
                    influence,
                });
            });
        }
        if let Start::Camera(lens) = start
            && origin_moves
            && let Some(at) = self.seen(w, lens)
        {
            // A turn of all directions has no divergence.
            followers.push(Follower {
                d: w,
                near: 0.0,
                met: None,
                at_camera: Some(at),
                sight: None,
                influence: Influence {
                    share: 1.0,
                    divergence: Vec3::zero(),
                },
            });
        }
        Some(Field { w, followers })
    }

    /// By auxiliary rays: [`convolve`]. They go over mirrors and glass as the path does.
    fn sampled_field<X: Sampler>(
        &mut self,
        (ray, deltas): (Ray<P>, &[Delta]),
        origin_moves: bool,
        start: Start<P>,
        (outlines, rays): (&Outlines, u32),
        mut sampler: X,
    ) -> Option<Field<P>> {
        let from_camera = matches!(start, Start::Camera(_));
        let scene = self.scene;
        let w = wide(ray.d).normalize();
        let frame = Frame::from_normal(w);
        self.neighbours.clear();
        let mut followers = SmallVec::new();
        let mut moves = false;
        for _ in 0..rays {
            let neighbour = Neighbour::sample(&frame, KAPPA, sampler.next_2d());
            let around = Ray {
                d: neighbour.d.map(P::of).normalize(),
                ..ray
            };
            let mut follower = Follower {
                d: neighbour.d,
                near: 0.0,
                met: None,
                at_camera: None,
                sight: None,
                influence: Influence::default(),
            };
            if let Start::Camera(lens) = start
                && origin_moves
            {
                follower.at_camera = self.seen(neighbour.d, lens);
                moves |= follower.at_camera.is_some();
            }
            // Beyond everything there is no outline.
            let mut test = LARGEST;
            let hit = scene.seen(&around, from_camera && self.hidden);
            if let Some(hit) = hit {
                test = outlines.test(KAPPA, &around, &hit, false);
                follower.near = f64::from(hit.t).recip();
                if self.active.moves_shape(scene.shape_of(hit.prim)) {
                    let met = scene.interaction(&Theta::still(), &around, &hit);
                    follower.near = met.si.t.to_f64().recip();
                    follower.met = Some((met.prim, met.si));
                }
                moves |= origin_moves || follower.met.is_some();
            }
            let at_camera = follower.at_camera;
            self.neighbours.push((neighbour, test));
            followers.push(follower);
            let Some(hit) = hit.filter(|_| !deltas.is_empty()) else {
                continue;
            };
            let which = (scene, self.theta, self.active);
            let Some(seen) = chain::look(which, outlines, (around, hit), deltas) else {
                continue;
            };
            if let Some((_, test)) = self.neighbours.last_mut() {
                *test = chain::aside(*test);
            }
            for (test, sight) in seen {
                moves |= origin_moves || sight.moves;
                self.neighbours.push((neighbour, test));
                followers.push(Follower {
                    d: neighbour.d,
                    near: 0.0,
                    met: None,
                    at_camera,
                    sight: Some(Box::new(sight)),
                    influence: Influence::default(),
                });
            }
        }
        if !moves {
            return None;
        }
        convolve(w, KAPPA, &self.neighbours, &mut self.influences);
        let pairs = followers.iter_mut().zip(&self.influences);
        pairs.for_each(|(f, i): (&mut Follower<P>, _)| f.influence = *i);
        Some(Field { w, followers })
    }

    /// What of the camera sees a direction, through a place of its lens.
    fn seen(&self, d: Vec3<f64>, lens: [P; 2]) -> Option<CameraSample<P>> {
        let seen = self.scene.camera.seen(d, lens.map(P::to_f64))?;
        let film = seen.at.map(P::of);
        Some(CameraSample { film, lens })
    }

    /// That around a ray of the camera, through a place of its lens, for light that comes along these deltas.
    pub fn camera_field<X: Sampler>(
        &mut self,
        (ray, lens): (Ray<P>, [P; 2]),
        deltas: &[Delta],
        numbers: Numbers,
        family: Family,
    ) -> Option<Field<P>> {
        let moves = self.active.moves_camera();
        let start = Start::Camera(lens);
        self.field::<X>((ray, deltas), moves, start, (numbers, family, 0))
    }

    /// The fields of a path that the camera sees `at` a point of the image.
    pub fn course<X: Sampler>(
        &mut self,
        trail: &Trail<P>,
        at: CameraSample<P>,
        numbers: Numbers,
    ) -> Course<P> {
        let camera: Ray<P> = self.scene.camera.ray_of(&at);
        // ---- Radiance ----
        let mut bends: Vec<Bend<P>> = Vec::with_capacity(trail.stops.len());
        let mut next = Rgb::black();
        for stop in trail.stops.iter().rev() {
            let radiance = stop.radiance(self.scene, self.theta, next);
            next = radiance.leaving;
            bends.push(Bend {
                arriving: radiance.arriving,
                scattered: None,
                sampled: None,
            });
        }
        bends.reverse();
        let l = next + met(self.scene, self.theta, &trail.first);

        // ---- Fields ----
        let mut first = None;
        if !l.is_black() {
            let deltas = chain::ahead(&trail.stops);
            let family = Family::FieldsOfScattering;
            first = self.camera_field::<X>((camera, at.lens), &deltas, numbers, family);
        }
        let mut moves = self.active.moves_camera() || first.is_some();
        for (k, (stop, bend)) in trail.stops.iter().zip(&mut bends).enumerate() {
            let Place {
                prim, si, shape, ..
            } = &stop.place;
            moves |= self.active.moves_shape(*shape);
            let exit = self.scene.exit(*prim);
            let depth = k as u32 + 1;
            let start = Start::Surface(wide(si.n_geo));
            if let Some((s, sample)) = &stop.sampled
                && !self.scene.emitters()[s.emitter as usize].is_delta()
            {
                let ray = (si.spawn_ray(sample.d, exit), &[][..]);
                bend.sampled =
                    self.field::<X>(ray, moves, start, (numbers, Family::FieldsOfLights, depth));
            }
            // Deltas are followed by the field before them.
            if let Some(b) = &stop.bounce
                && b.component == Component::Continuous
                && !bend.arriving.is_black()
            {
                let ray = si.spawn_ray(si.frame.to_world(b.wi), exit);
                let deltas = chain::ahead(&trail.stops[k + 1..]);
                bend.scattered = self.field::<X>(
                    (ray, &deltas),
                    moves,
                    start,
                    (numbers, Family::FieldsOfScattering, depth),
                );
                moves |= bend.scattered.is_some();
            }
        }
        Course {
            at,
            camera,
            l,
            first,
            bends,
        }
    }

    /// Adds the derivative of `d_l . L` for a path with these fields, and of the filter around it, whose logarithm has these
    /// slopes.
    pub fn add(
        &self,
        trail: &Trail<P>,
        course: &Course<P>,
        filter: [f64; 2],
        d_l: Rgb<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let mut behind = EdgeAdjoint::zero();
        for k in (0..trail.stops.len()).rev() {
            behind = self.stop(trail, course, k, behind, d_l, grad);
        }
        let (ray, edge) = (&course.camera, &trail.first);
        let end = edge.end.as_ref().map(|(prim, si)| (*prim, *si));
        self.emissions(edge, ray.d, end, d_l, &mut behind, grad);
        let mut back = self.ends_at(*ray, end, &behind, grad);
        if let Some(field) = &course.first
            && let Some(seen) = (self.scene.camera).seen(field.w, course.at.lens.map(P::to_f64))
        {
            let FilmPoint {
                slopes, log_area, ..
            } = seen;
            let total = (d_l * course.l).sum().to_f64();
            let of_film = slopes[0] * filter[0] + slopes[1] * filter[1] + log_area;
            let d = wide(back.d) + of_film * total;
            back.o += self.velocity(field, d, total, grad);
        }
        if self.active.moves_camera() {
            self.scene
                .camera
                .scatter_ray(self.theta, &course.at, &back, grad);
        }
    }

    /// Adds the derivative of `d` times the velocity of an axis of the film, where a field has that.
    pub fn add_border(
        &self,
        field: &Field<P>,
        axis: usize,
        at: &CameraSample<P>,
        d: f64,
        grad: &mut impl GradSink<P>,
    ) {
        let lens = at.lens.map(P::to_f64);
        let Some(seen) = self.scene.camera.seen(field.w, lens) else {
            return;
        };
        let o = self.velocity(field, seen.slopes[axis] * d, 0.0, grad);
        if self.active.moves_camera() {
            let back = RayAdjoint { o, d: Vec3::zero() };
            self.scene.camera.scatter_ray(self.theta, at, &back, grad);
        }
    }

    /// Adds the derivatives of what neighbours met, given the adjoints of a field and of its divergence. The adjoint of the
    /// point that the rays leave.
    fn velocity(
        &self,
        field: &Field<P>,
        d: Vec3<f64>,
        d_divergence: f64,
        grad: &mut impl GradSink<P>,
    ) -> Vec3<P> {
        let d = d - field.w * field.w.dot(d);
        let mut origin = Vec3::zero();
        for f in &field.followers {
            let d = d * f.influence.share + f.influence.divergence * d_divergence;
            let d = d - f.d * f.d.dot(d);
            if let Some(sight) = &f.sight {
                origin += wide(self.along_sight(sight, d, grad));
            }
            let d_p = (d * f.near).map(P::of);
            origin -= d * f.near;
            if let Some((prim, si)) = &f.met {
                let surface = SurfaceAdjoint {
                    p: d_p,
                    ..SurfaceAdjoint::zero()
                };
                self.scene
                    .scatter_point(self.theta, *prim, si, &surface, P::zero(), grad);
            }
            if let Some(at) = &f.at_camera {
                let back = RayAdjoint {
                    o: Vec3::zero(),
                    d: (-d).map(P::of),
                };
                self.scene.camera.scatter_ray(self.theta, at, &back, grad);
            }
        }
        origin.map(P::of)
    }

    /// Adds the derivatives of the direction in which a point is seen over mirrors and glass, given its adjoint. The adjoint of
    /// the point that the rays leave.
    ///
    /// Where the ray of a constant direction ends slides over the surface there, as everything moves; the direction turns so
    /// that it stays on the material.
    fn along_sight(&self, sight: &Sight<P>, d: Vec3<f64>, grad: &mut impl GradSink<P>) -> Vec3<P> {
        let Sight { legs, ray, end, .. } = sight;
        let slides = sight.slides(d).map(P::of);
        let surface = |p| SurfaceAdjoint {
            p,
            ..SurfaceAdjoint::zero()
        };
        if self.active.moves_shape(self.scene.shape_of(end.0)) {
            let stays = surface(-slides);
            self.scene
                .scatter_point(self.theta, end.0, &end.1, &stays, P::zero(), grad);
        }
        let behind = EdgeAdjoint {
            end: surface(slides),
            d: Vec3::zero(),
        };
        let mut back = self.ends_at(*ray, Some(*end), &behind, grad);
        for leg in legs.iter().rev() {
            let mut own = EdgeAdjoint::zero();
            own.end.p += back.o;
            let black = Rgb::black();
            self.turns(&leg.place, leg.ray.d, leg.delta, (black, back.d), &mut own);
            let end = (leg.place.prim, leg.place.si);
            back = self.ends_at(leg.ray, Some(end), &own, grad);
        }
        back.o
    }

    /// A delta of a material with the adjoint `a` of its weight and `d_w` of the direction that it goes on in, in the world,
    /// for a path that arrives in direction `before`.
    fn turns(
        &self,
        place: &Place<P>,
        before: Vec3<P>,
        which: Delta,
        (a, d_w): (Rgb<P>, Vec3<P>),
        own: &mut EdgeAdjoint<P>,
    ) {
        type D<P> = Dual<P, 4>;
        let material = self.scene.material(place.shape);
        let uv = place.si.uv;
        let uv = Vec2::new(D::var(uv.x, 2), D::var(uv.y, 3));
        let at = Shading::new(self.theta.lift::<D<P>>(), uv);
        let Some((wi, weight)) = delta::scatter(material, &at, varied(place.wo, 0), which) else {
            return;
        };
        let frame = &place.si.frame;
        let local = frame.to_local(d_w);
        let slope = |k: usize| {
            let turned = wi.x.eps[k] * local.x + wi.y.eps[k] * local.y + wi.z.eps[k] * local.z;
            slope(&weight, a, k) + turned
        };
        let [s, t] = across(place.wo);
        let d_o = s * slope(0) + t * slope(1);
        own.end.uv += Vec2::new(slope(2), slope(3));
        let wi = wi.map(|x| x.re);
        let of_frame = &mut own.end.frame;
        of_frame.s += d_w * wi.x - before * d_o.x;
        of_frame.t += d_w * wi.y - before * d_o.y;
        of_frame.n += d_w * wi.z - before * d_o.z;
        own.d -= frame.to_world(d_o);
    }

    /// The adjoints of a ray, given those of what it ends at and of its direction.
    fn ends_at(
        &self,
        ray: Ray<P>,
        end: Option<(u32, SurfaceInteraction<P>)>,
        adjoint: &EdgeAdjoint<P>,
        grad: &mut impl GradSink<P>,
    ) -> RayAdjoint<P> {
        let mut back = RayAdjoint {
            o: Vec3::zero(),
            d: adjoint.d,
        };
        if let Some((prim, si)) = end {
            let own =
                (self.scene).scatter_interaction(self.theta, prim, &ray, &si, &adjoint.end, grad);
            back.o += own.o;
            back.d += own.d;
        }
        back
    }

    /// The adjoints of the edge that leads to stop `k`, given those of the edge behind it.
    fn stop(
        &self,
        trail: &Trail<P>,
        course: &Course<P>,
        k: usize,
        mut behind: EdgeAdjoint<P>,
        d_l: Rgb<P>,
        grad: &mut impl GradSink<P>,
    ) -> EdgeAdjoint<P> {
        let mut own = EdgeAdjoint::zero();
        let stop = &trail.stops[k];
        let place = &stop.place;
        let from = place.si.p;
        let before = match k {
            0 => course.camera.d,
            _ => (from - trail.stops[k - 1].place.si.p).normalize(),
        };
        let bend = &course.bends[k];
        let beta = d_l * stop.beta;
        if let Some(b) = &stop.bounce
            && !bend.arriving.is_black()
        {
            let end = stop.edge.end.map(|(prim, si)| seen_from(from, prim, si));
            let w = match &end {
                Some((_, si)) => (si.p - from).normalize(),
                None => place.si.frame.to_world(b.wi),
            };
            let a = beta * bend.arriving;
            let met = beta * b.f.scale(b.weight);
            self.emissions(&stop.edge, w, end, met, &mut behind, grad);
            let ray = Ray::new(from, w);
            match b.component {
                Component::Delta { kind, route } => {
                    let back = self.ends_at(ray, end, &behind, grad);
                    own.end.p += back.o;
                    self.turns(place, before, (kind, route), (a, back.d), &mut own);
                }
                Component::Continuous => {
                    let d_w = &mut behind.d;
                    self.scatters(place, [before, w], b.wi, a, &mut own, d_w);
                    let total = (a * b.f).sum();
                    let field = bend.scattered.as_ref();
                    self.leaves(ray, end, &behind, (field, total), &mut own, grad);
                }
            }
        }
        if let Some(light @ (s, sample)) = &stop.sampled {
            let e = &self.scene.emitters()[s.emitter as usize];
            if e.is_delta() {
                self.delta_light(place, before, light, beta, &mut own, grad);
            } else {
                let end = sampled_point(self.scene, e, place, sample)
                    .map(|(prim, si)| seen_from(from, prim, si));
                let w = end.map_or(sample.d, |(_, si)| (si.p - from).normalize());
                let mut adjoint = EdgeAdjoint::zero();
                let a = beta * s.le.scale(s.weight);
                self.scatters(place, [before, w], s.wi, a, &mut own, &mut adjoint.d);
                let a_le = beta * s.f.scale(s.weight);
                self.emission(s.emitter, w, end, a_le, &mut adjoint, grad);
                let ray = Ray::new(from, w);
                let total = (a * s.f).sum();
                let field = (bend.sampled.as_ref(), total);
                self.leaves(ray, end, &adjoint, field, &mut own, grad);
            }
        }
        own
    }

    /// The adjoints of a ray that leaves a vertex, of the velocity of its direction and of its divergence, as those of the
    /// vertex; `total` is that of the logarithm of what arrives along it.
    fn leaves(
        &self,
        ray: Ray<P>,
        end: Option<(u32, SurfaceInteraction<P>)>,
        adjoint: &EdgeAdjoint<P>,
        (field, total): (Option<&Field<P>>, P),
        own: &mut EdgeAdjoint<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let back = self.ends_at(ray, end, adjoint, grad);
        own.end.p += back.o;
        if let Some(field) = field {
            own.end.p += self.velocity(field, wide(back.d), total.to_f64(), grad);
        }
    }

    /// A material's value without deltas with the adjoint `a`, for a path that arrives in direction `before`, goes on in
    /// direction `w`, both in the world, and leaves in the local direction `wi`.
    fn scatters(
        &self,
        place: &Place<P>,
        [before, w]: [Vec3<P>; 2],
        wi: Vec3<P>,
        a: Rgb<P>,
        own: &mut EdgeAdjoint<P>,
        d_w: &mut Vec3<P>,
    ) {
        let material = self.scene.material(place.shape);
        let s = slopes::<P, 6>(material, self.theta, place, wi, Component::Continuous, a);
        let frame = &place.si.frame;
        for (world, local) in [(-before, s.wo), (w, s.wi)] {
            own.end.frame.s += world * local.x;
            own.end.frame.t += world * local.y;
            own.end.frame.n += world * local.z;
        }
        own.end.uv += s.uv;
        own.d -= frame.to_world(s.wo);
        *d_w += frame.to_world(s.wi);
    }

    /// All light that an edge met, which arrives with the adjoint `a` before MIS.
    fn emissions(
        &self,
        edge: &Edge<P>,
        d: Vec3<P>,
        end: Option<(u32, SurfaceInteraction<P>)>,
        a: Rgb<P>,
        adjoint: &mut EdgeAdjoint<P>,
        grad: &mut impl GradSink<P>,
    ) {
        for met in &edge.met {
            self.emission(met.emitter, d, end, a * met.weight, adjoint, grad);
        }
    }

    /// Light that arrives with the adjoint `a` in direction `d` from an emitter, at a point or from afar.
    fn emission(
        &self,
        emitter: u32,
        d: Vec3<P>,
        end: Option<(u32, SurfaceInteraction<P>)>,
        a: Rgb<P>,
        adjoint: &mut EdgeAdjoint<P>,
        grad: &mut impl GradSink<P>,
    ) {
        if a.is_black() {
            return;
        }
        type D<P> = Dual<P, 7>;
        let e = &self.scene.emitters()[emitter as usize];
        let seen = end.map(|(_, si)| {
            let mut si = si.lift::<D<P>>();
            let n = &mut si.frame.n;
            let var = |k| D::<P>::var(P::zero(), k);
            *n = Vec3::new(n.x + var(2), n.y + var(3), n.z + var(4));
            (si.uv.x, si.uv.y) = (si.uv.x + var(5), si.uv.y + var(6));
            si
        });
        let Some(found) = e.hit(varied::<P, 7>(d, 0), seen.as_ref()) else {
            return;
        };
        let le = e.eval(&self.theta.lift::<D<P>>(), &found);
        let slope = |k: usize| slope(&le, a, k);
        let [s, t] = across(d);
        let d_d = s * slope(0) + t * slope(1);
        adjoint.d += d_d;
        if end.is_some() {
            adjoint.end.frame.n += Vec3::new(slope(2), slope(3), slope(4));
            adjoint.end.uv.x += slope(5);
            adjoint.end.uv.y += slope(6);
        } else if self.active.moves_emitter(emitter)
            && let Some(turned) = e.turned()
        {
            turned.scatter_turn(self.theta, d, d_d, grad);
        }
    }

    /// Light from a point that is a light.
    fn delta_light(
        &self,
        place: &Place<P>,
        before: Vec3<P>,
        (s, sample): &(SampledLight<P>, EmitterSample<P>),
        beta: Rgb<P>,
        own: &mut EdgeAdjoint<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let e = &self.scene.emitters()[s.emitter as usize];
        let from = place.si.p;
        let mut d_w = Vec3::zero();
        let a = beta * s.le.scale(s.weight);
        self.scatters(place, [before, sample.d], s.wi, a, own, &mut d_w);
        let moves = self.active.moves_emitter(s.emitter);
        if let Some(Rays::Along(_)) = e.rays(self.scene.lights()) {
            if let Some(turned) = e.turned().filter(|_| moves) {
                turned.scatter_direction(self.theta, sample.d, d_w, grad);
            }
            return;
        }
        // As the adjoint of the light.
        let mut d = (d_w - sample.d * sample.d.dot(d_w)) * sample.distance.recip();
        let var = |x: P, i: usize| Dual::<P, 3>::var(x, i);
        let moving = Vec3::new(var(from.x, 0), var(from.y, 1), var(from.z, 2));
        let le = e.eval(&self.theta.lift(), &e.connect(sample, moving).emission);
        let a_le = beta * s.f.scale(s.weight);
        d -= Vec3::new(
            slope(&le, a_le, 0),
            slope(&le, a_le, 1),
            slope(&le, a_le, 2),
        );
        own.end.p -= d;
        if let Some(p) = e.moved_by()
            && moves
        {
            grad.add_all(p, 0, d.to_array());
        }
    }
}

/// What a ray from a point ends at: with the distance from there.
fn seen_from<P: Float>(
    from: Vec3<P>,
    prim: u32,
    si: SurfaceInteraction<P>,
) -> (u32, SurfaceInteraction<P>) {
    let t = (si.p - from).length();
    (prim, SurfaceInteraction { t, ..si })
}
