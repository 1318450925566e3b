//! Outlines of shadows, drawn from the light: what edges before lights hide from the vertices that the camera sees.
//!
//! Lines that touch an occluder have three dimensions, and a measure that both ends agree on: with `l` the length of the
//! outline in radians as seen from one end, and `d` the distance of the edge from there,
//!
//! `dl dA |cos| / d` is the same for both ends,
//!
//! since it is what the occluder cuts out of all lines as it moves by a unit along its normal. A point on a lamp and a point
//! of an outline that is seen from there are therefore a sample of the integral over the receiver and the outlines that
//! it sees; the ray goes on to the receiver, and that is connected to the camera. No sample looks for a lamp that may be
//! small, and lights that are points are no special case: they have no area to choose from. By parallel light, lengths across
//! it stand for radians, and the receiver moves against the edge as it is.
//!
//! Projectors and beams end at a border, which hides and shows nothing, but which what moves goes through as through the
//! outline of a shadow: it has samples as well.
//!
//! From a receiver light goes on by scattering, and each surface that it comes to may be what the camera sees. Lights that
//! have an area leave that to paths, whose later vertices look for edges before them; where a light is a point, no path
//! would find any, and the receiver sends a [particle](super::super::particle). It stays on its material then: nothing on
//! the film is followed.
//!
//! # Does not handle
//! Environments; receivers that the camera sees in others before lights with an area, which paths look for.

use std::ops::Range;

use ad_core::{Float, Vec3};

use super::super::particle::Particle;
use super::super::tile::on_lens;
use super::form::{Contribution, Form, Mover, Term};
use super::{Boundary, MODE, Source, wide};
use crate::bsdf::{Bsdf, Shading};
use crate::camera::{CameraSample, SightLine};
use crate::edges::{EdgePoint, Eye, Seeker};
use crate::emitter::{AnyEmitter, Emission, Emitter, Rays};
use crate::math::{Frame, NOWHERE, Ray, Rgb, Segment};
use crate::params::Theta;
use crate::sampler::{Family, Points, Sampler, Spread};
use crate::scene::{Intersection, Scene};
use crate::shape::{Shape, SurfaceInteraction, lift3};

/// What edges that do not move count beside others, where the light does not either: what they shade may.
const STILL: f64 = 0.1;
/// How often the border of a light is chosen, if it has one, and not an edge before it.
const BORDERS: f64 = 0.5;
/// Parallel rays start before an edge by this part of the largest coordinate of its shape, so that their rounding is that of
/// the shape, however large the scene is.
const BEFORE_EDGE: f64 = 0.5;

/// Lights that samples start from.
pub(super) struct Lights {
    /// Indices of emitters, and running sums of how often they are chosen.
    lights: Vec<(u32, f64)>,
}

impl Lights {
    /// Those of a scene that are `wanted`, for paths of so many edges.
    pub fn of(scene: &Scene, max_depth: u32, wanted: impl Fn(&AnyEmitter) -> bool) -> Self {
        let mut lights = Vec::new();
        let mut sum = 0.0;
        if max_depth >= 2 {
            for (e, i) in scene.emitters().iter().zip(0..) {
                if wanted(e) {
                    sum += scene.shares().of(i as usize);
                    lights.push((i, sum));
                }
            }
        }
        Self { lights }
    }

    /// Whether there are any.
    pub fn any(&self) -> bool {
        !self.lights.is_empty()
    }

    /// A light, and one over the probability that it is this one.
    pub fn choose(&self, u: f64) -> Option<(u32, f64)> {
        let total = self.lights.last()?.1;
        let i = self.lights.partition_point(|l| l.1 <= u * total);
        let i = i.min(self.lights.len() - 1);
        let before = if i == 0 { 0.0 } else { self.lights[i - 1].1 };
        let (light, end) = self.lights[i];
        Some((light, total / (end - before)))
    }
}

/// A point on a light, or all of one whose rays are parallel.
pub(super) struct Start<P> {
    /// From where edges are seen.
    eye: Eye,
    /// Primitive of the scene, shape and surface, of areas.
    pub surface: Option<(u32, u32, SurfaceInteraction<P>)>,
    /// One over the density per area; of all others one.
    pub weight: f64,
}

/// An edge before a light.
struct Before<P: Float> {
    edge: EdgePoint,
    /// From where rays pass it, and one that meets it.
    eye: Eye,
    from: Ray<P>,
    /// What goes there.
    le: Rgb<P>,
    /// What of the light an edge that moves by a unit hides, over the density: a solid angle, times the cosine to a surface;
    /// an area across parallel light.
    width: f64,
}

/// What a ray from a light meets, as the camera sees it.
pub(super) struct Receiver<P> {
    /// Of [`Mover::Seen`]: primitive, what of the camera sees it, surface.
    seen: (u32, CameraSample<P>, SurfaceInteraction<P>),
    /// Of the scene.
    shape: u32,
    /// What it scatters towards the camera, with the cosine of the ray.
    pub f: Rgb<P>,
    /// Area on the film that an area across the ray takes there.
    pub area: f64,
    /// Unit direction to the camera.
    towards: Vec3<f64>,
}

/// What an edge before a light shades.
struct Shade<P: Float> {
    /// The edge, unless it is the border of the light.
    edge: Option<EdgePoint>,
    /// From the light past the edge, and what it meets.
    ray: Ray<P>,
    hit: Intersection<P>,
    /// Where the camera looks at it through its lens.
    lens: [P; 2],
    /// Whether the light has no area.
    delta: bool,
    /// What arrives, over the density of the sample, as an edge that moves by a unit hides it.
    power: Rgb<P>,
    /// How fast the edge and the light move.
    form: Form<P>,
    /// Along what the receiver moves against them.
    receiver_moves: Vec3<f64>,
}

impl<P: Float> Receiver<P> {
    /// Where on the film.
    pub fn at(&self) -> [f64; 2] {
        self.seen.1.film.map(P::to_f64)
    }
}

impl<P: Float> Boundary<'_, P> {
    pub(super) fn start(&self, emitter: &AnyEmitter, u: [P; 2]) -> Option<Start<P>> {
        let scene = self.context.scene;
        let AnyEmitter::Area(area) = emitter else {
            let eye = match emitter.rays(scene.lights())? {
                Rays::From(p) => Eye::point(lift3(p)),
                Rays::Along(d) => Eye::Parallel {
                    direction: d,
                    origin: self.far_before(d)?,
                    depth: d,
                },
            };
            return Some(Start {
                eye,
                surface: None,
                weight: 1.0,
            });
        };
        let shape = area.shape;
        let of = &self.surfaces.shapes[shape as usize];
        let (s, n_geo) = of.sample_surface(&Theta::still(), u);
        let si = SurfaceInteraction {
            p: s.p,
            t: P::zero(),
            n_geo,
            frame: Frame::from_normal(s.n),
            uv: s.uv,
        };
        let prim = self.surfaces.firsts[shape as usize] + s.prim;
        Some(Start {
            eye: Eye::point(wide(s.p)),
            surface: Some((prim, shape, si)),
            weight: s.pdf.to_f64().recip(),
        })
    }

    /// So far before the scene that all of it is about as far away.
    fn far_before(&self, direction: Vec3<f64>) -> Option<Vec3<f64>> {
        let ball = self.ball?;
        Some(Vec3::from(ball.centre) - direction * (16.0 * ball.radius))
    }

    /// Calls `each` with what sample `index` of edges before lights brings: where on the film, and of what.
    pub(super) fn before_light(&self, index: u64, each: &mut dyn FnMut([f64; 2], Contribution<P>)) {
        // The samples of all pixels together are spread.
        let sampler = Spread::spread(
            Points::Sobol,
            Family::EdgesBeforeLights.seed(self.seed),
            0,
            index,
        );
        let Some(shade) = self.shade(sampler) else {
            return;
        };
        if let Some((at, c)) = self.as_seen(&shade) {
            each(at, c);
        }
        let Some(onwards) = &self.onwards else {
            return;
        };
        if !shade.delta {
            return;
        }
        let mut form = shade.form.clone();
        let Intersection { prim, shape, si } = shade.hit;
        form.extend(self.material(prim, shape, || si, shade.receiver_moves));
        if form.is_empty() {
            return;
        }
        let particle = Particle::scattered(onwards, &shade.ray, &shade.hit, -shade.power, sampler);
        particle.finish(onwards, &mut |at, value| {
            let form = form.clone();
            each(at.map(P::to_f64), Contribution { value, form });
        });
    }

    /// What an edge before a light shades, or where its border falls.
    fn shade<X: Sampler>(&self, mut sampler: X) -> Option<Shade<P>> {
        let scene = self.context.scene;
        let count = self.per_sample(Source::Shadows) as f64;
        let mut u: [f64; 2] = sampler.next_2d();
        let on_light: [P; 2] = sampler.next_2d();
        let (light, weight) = self.shadows.choose(sampler.next_1d())?;
        let lens = on_lens(scene, sampler);
        let emitter = &scene.emitters()[light as usize];
        let mut weight = weight / count;
        if emitter.has_border() {
            if u[0] < BORDERS {
                return self.border(emitter, weight / BORDERS, (u[1], lens));
            }
            u[0] = (u[0] - BORDERS) / (1.0 - BORDERS);
            weight /= 1.0 - BORDERS;
        }
        let start = self.start(emitter, on_light)?;
        let moves = match &start.surface {
            Some((_, shape, _)) => self.moving.shapes[*shape as usize],
            None => emitter
                .moved_by()
                .is_some_and(|p| self.moving.lights.contains(&p)),
        };
        let Before {
            edge,
            eye,
            from,
            le,
            width,
        } = self.edge_before(emitter, &start, moves, u)?;

        // ---- What it shades ----
        let (ray, hit) = self.past(&edge, (&eye, from), 2)?;
        let hit = hit?;
        let x = wide(hit.si.p);
        // Where it stands on that, it shades nothing that it does not hide on the film, with rays as near as these.
        let beside = self.clearance(edge.shape, hit.si.t.to_f64()).max(edge.seam);
        if wide(hit.si.n_geo).dot(edge.p - x).abs() <= beside {
            return None;
        }
        let to_edge = (edge.p - x).length();
        let part = match start.eye {
            Eye::Point { at, .. } => to_edge / (at - x).length(),
            Eye::Parallel { .. } => 0.0,
        };

        // ---- How fast, times the distance of the edge, which may be small ----
        let n = edge.normal;
        let mut form: Form<P> = self.of_edge(&edge, n).into_iter().collect();
        match &start.surface {
            Some((prim, shape, si)) => {
                form.extend(self.material(*prim, *shape, || *si, n * -part));
            }
            None if moves => form.extend(match start.eye {
                Eye::Point { .. } => {
                    let mover = emitter.moved_by().map(Mover::Light);
                    mover.map(|mover| Term::point(mover, n * -part))
                }
                Eye::Parallel { direction, .. } => {
                    let mover = Mover::Parallel(light, direction.map(P::of));
                    Some(Term::point(mover, n * to_edge))
                }
            }),
            None => {}
        }
        Some(Shade {
            edge: Some(edge),
            ray,
            hit,
            lens,
            delta: start.surface.is_none(),
            power: le.scale(P::of(weight * start.weight * width)),
            form,
            receiver_moves: n * (part - 1.0),
        })
    }

    /// An edge that a light sees, if nothing hides it there.
    fn edge_before(
        &self,
        emitter: &AnyEmitter,
        start: &Start<P>,
        moves: bool,
        u: [f64; 2],
    ) -> Option<Before<P>> {
        let scene = self.context.scene;
        let interest = |shapes: Range<u32>| {
            if moves || self.moving.camera || self.moving.any(shapes) {
                1.0
            } else {
                STILL
            }
        };
        let surface = start.surface.as_ref().map(|(_, _, si)| si);
        let n_geo = surface.map(|si| wide(si.n_geo));
        let seeker = Seeker {
            eye: start.eye,
            normal: n_geo.unwrap_or(Vec3::zero()),
            lamps: None,
            lamps_only: false,
            interest: &interest,
        };
        let edge = self.edges.draw(&seeker, &[], u)?;
        let leaving = edge.direction.map(P::of).normalize();
        let Eye::Point { at, .. } = start.eye else {
            return self.edge_along(emitter, edge, leaving);
        };
        // No light leaves in the plane of its own face, which the sides of that are in.
        let level = self.clearance(edge.shape, edge.distance);
        if n_geo.is_some_and(|n| n.dot(edge.p - at).abs() <= level) {
            return None;
        }
        let (emission, _): (Emission<P>, P) = emitter.leaves(leaving, surface)?;
        let le = emitter.eval(self.context.theta, &emission);
        let from = match &start.surface {
            Some((prim, _, si)) => si.spawn_ray(leaving, scene.exit(*prim)),
            None => Ray::new(at.map(P::of), leaving),
        };
        let cos_light = n_geo.map_or(1.0, |n| n.dot(edge.direction).abs());
        (!le.is_black()).then(|| Before {
            eye: Eye::point(wide(from.o)),
            from,
            le,
            width: edge.weight * cos_light / edge.distance,
            edge,
        })
    }

    /// An edge in parallel light, which is seen from nearby.
    fn edge_along(
        &self,
        emitter: &AnyEmitter,
        mut edge: EdgePoint,
        leaving: Vec3<P>,
    ) -> Option<Before<P>> {
        let scene = self.context.scene;
        let half = P::of(0.5);
        let light = emitter.sample::<P>(scene.lights(), edge.p.map(P::of), [half; 2])?;
        let le = emitter.eval(self.context.theta, &light.emission);
        let to_light = light.distance.to_f64();
        // The sides of the light itself are its border.
        if to_light <= self.clearance(edge.shape, 0.0) {
            return None;
        }
        let extent = f64::from(self.surfaces.shapes[edge.shape as usize].extent());
        let distance = (extent * BEFORE_EDGE).min(0.5 * to_light);
        let o = edge.p - edge.direction * distance;
        let from = Ray::new(o.map(P::of), leaving);
        let way = Segment {
            ray: Ray {
                d: -leaving,
                ..from
            },
            length: light.distance - P::of(distance),
            to: light.surface,
        };
        if le.is_black() || scene.occluded(&way) {
            return None;
        }
        let eye = Eye::Parallel {
            direction: edge.direction,
            origin: o,
            depth: edge.direction,
        };
        let width = edge.weight * edge.distance;
        edge.distance = distance;
        Some(Before {
            edge,
            eye,
            from,
            le,
            width,
        })
    }

    /// Where the border of a light falls: it moves with the light, and stays in its directions.
    fn border(
        &self,
        emitter: &AnyEmitter,
        weight: f64,
        (u, lens): (f64, [P; 2]),
    ) -> Option<Shade<P>> {
        let scene = self.context.scene;
        let border = emitter.border::<P>(scene.lights(), u)?;
        let le = emitter.eval(self.context.theta, &border.emission);
        if le.is_black() {
            return None;
        }
        let hit = scene.seen(&border.ray, self.context.settings.hides(2))?;
        let hit = scene.interaction(&Theta::still(), &border.ray, &hit);
        let near = match emitter.rays(scene.lights())? {
            Rays::From(_) => hit.si.t.to_f64().recip(),
            Rays::Along(_) => 1.0,
        };
        let moved = (emitter.moved_by()).filter(|p| self.moving.lights.contains(p));
        let form = moved.map(|p| Term::point(Mover::Light(p), border.inside * near));
        Some(Shade {
            edge: None,
            ray: border.ray,
            hit,
            lens,
            delta: true,
            power: le.scale(P::of(weight * border.length)),
            form: form.into_iter().collect(),
            receiver_moves: border.inside * -near,
        })
    }

    /// That as the camera sees it, whose point of the film stays.
    fn as_seen(&self, shade: &Shade<P>) -> Option<([f64; 2], Contribution<P>)> {
        let receiver = self.receiver(&shade.ray, shade.hit, shade.lens)?;
        let edge = shade.edge.as_ref();
        if edge.is_some_and(|edge| self.is_covered(edge, &receiver)) {
            return None;
        }
        let mut form = shade.form.clone();
        form.extend(self.of_receiver(&receiver, shade.receiver_moves));
        let value = -(receiver.f * shade.power).scale(P::of(receiver.area));
        (!form.is_empty()).then_some((receiver.at(), Contribution { value, form }))
    }

    /// Whether the camera, from beside the light, sees the edge before its shadow. Rays that pass the edge on the film meet what is
    /// lit then, and what changes there is all that changes.
    fn is_covered(&self, edge: &EdgePoint, receiver: &Receiver<P>) -> bool {
        let si = &receiver.seen.2;
        let to = edge.p - wide(si.p);
        let along = to.dot(receiver.towards);
        let from_eye = si.t.to_f64() - along;
        let across = (to - receiver.towards * along).length();
        let beside = |distance| self.clearance(edge.shape, distance).max(edge.seam);
        along > 0.0 && from_eye > 0.0 && across <= beside(edge.distance) + beside(from_eye)
    }

    /// What a ray from a light meets, if the camera sees that through a place of its lens and it scatters light to it.
    pub(super) fn receiver(
        &self,
        ray: &Ray<P>,
        hit: Intersection<P>,
        lens: [P; 2],
    ) -> Option<Receiver<P>> {
        let scene = self.context.scene;
        let info = scene.shape_info(hit.shape);
        let hidden = self.context.settings.hides(1);
        if info.delta || (hidden && info.emitter.is_some()) {
            return None;
        }
        let si = &hit.si;
        let SightLine {
            film,
            towards,
            distance,
            area,
        } = if scene.camera.has_lens() {
            scene.camera.viewer(&scene.film, lens).sees(si.p)?
        } else {
            self.viewer.sees(si.p)?
        };
        let [wo, wi] = [towards, -ray.d].map(|d| si.frame.to_local(d));
        let shading = Shading::new(*self.context.theta, si.uv);
        let f: Rgb<P> = scene.material(hit.shape).eval(&shading, wo, wi, MODE);
        if f.is_black() {
            return None;
        }
        let exit = scene.exit(hit.prim);
        if scene.out_of_sight(&si.shadow_ray(towards, distance, exit, NOWHERE), hidden) {
            return None;
        }
        let [across, along] = [towards, ray.d].map(|d| wide(si.n_geo).dot(wide(d)).abs());
        let surface = SurfaceInteraction { t: distance, ..*si };
        Some(Receiver {
            seen: (hit.prim, CameraSample { film, lens }, surface),
            shape: hit.shape,
            f,
            area: area.to_f64() * across / along,
            towards: wide(towards),
        })
    }

    /// The term of a receiver, whose point of the film stays, if it moves.
    pub(super) fn of_receiver(&self, receiver: &Receiver<P>, along: Vec3<f64>) -> Option<Term<P>> {
        let (prim, at, si) = receiver.seen;
        let moves = self.moving.camera || self.moving.shapes[receiver.shape as usize];
        moves.then(|| Term::point(Mover::Seen(prim, at, si), along))
    }
}
