//! Still paths, many at a time and field by field.
//!
//! This is the path tracer of [`super::path`], number by number, for what is rendered most: scalars without
//! tangents, where no sample or weight moves. Derivatives of both modes are made of what a wave keeps ([`record`]).
//!
//! The vertices of a wave of paths do the same things at the same time, in loops over arrays that call what the path
//! tracer calls for one vertex. Nothing in such a loop is decided by a branch, so the compiler makes vector instructions
//! of it. What is not the same for all vertices is sorted: those of one kind of material ([`kinds`]) or at one emitter
//! ([`lights`]) go through a loop of their own. Other materials and emitters are called vertex by vertex in between.

// Each loop is over many arrays at a time.
#![allow(clippy::needless_range_loop)]

mod balls;
mod derivatives;
mod faces;
mod kinds;
mod lamps;
mod lanes;
mod lights;
mod lookups;
mod numbers;
mod readings;
mod record;
mod searches;
mod slopes;
mod start;
mod state;
mod surfaces;
mod waiting;

use ad_core::{Float, Vec2, Vec3};
pub(super) use derivatives::LayerAdjoints;
use derivatives::albedo;
use kinds::{Kinds, has_two_sides, seen_from, side, visit_textures};
pub(super) use lanes::WAVE_SIZE;
use lanes::{Field, Lane, Lanes, whole};
use lights::{
    FEW, Group, Leaving, MOST_TOGETHER, constant_radiances, image_radiances, leave_deltas,
    meet_evenly, sample_balls, together,
};
use lookups::{Lookups, image};
use numbers::{bits, draw_units, sobol};
use readings::{Reading, Readings, reads_images};
pub(super) use record::Record;
use smallvec::SmallVec;
use state::{Bounces, Lights, Paths, Vertices};
use surfaces::Surfaces;
use waiting::Waiting;

use super::direct::{Departure, FoundEdge};
use super::lockstep;
use super::path::Context;
use super::vertex::interest::Interest;
use super::vertex::light::{
    LitVertex, Looking, Met, Rival, choose, density, emitters_at, find_light, find_lights,
    guide_of, guided, has_rival, is_along_delta, is_led, looks_for_light, matters, mis_weight,
    mixed, per_density, weighs,
};
use super::vertex::normals::{normals_pair, normals_weight, splits};
use super::vertex::roulette::{play, probability, roulette_weight};
use super::vertex::{MODE, assert_finite, has_more, may_go_on};
use crate::accel::{Hit, PACKET_SIZE, RayPacket};
use crate::bsdf::{Bsdf, Component, DiffuseLobe, Lobe, Material, Shading, TextureRef};
use crate::emitter::{AnyEmitter, Area, Emitter};
use crate::estimator::{Detached, Sampling, Strategy, differentiates_edges};
use crate::guide::{Directions, Guide};
use crate::manifold::Split;
use crate::math::{NOWHERE, Ray, Rgb, Segment};
use crate::params::Theta;
use crate::sampler::{Points, Purpose, Sampler, index_below, sobol_bits};
use crate::scene::{LightChoice, Scene, Shares};
use crate::shape::{AnyShape, Shape, SurfaceInteraction};
use crate::texture::Texture;

/// Keeps what happens to the paths of a wave.
pub(super) trait Log<P: Float>: Interest {
    /// Most paths that it is told of from start to end. Where those are more than a wave holds, it does not mind which
    /// of them are in one wave.
    const CROWD: usize = WAVE_SIZE;
    /// The vertex that the edge of path `i` left, if light on that edge is differentiated by itself.
    fn departure(&self, _paths: &Paths<P>, _i: usize) -> Option<&Departure<P>> {
        None
    }
    /// Path `i` found light at the end of an edge; `apart`: the emitter's share, if it is differentiated by itself.
    fn hit(
        &mut self,
        paths: &Paths<P>,
        i: usize,
        emitter: u32,
        light: &Met<P>,
        le: Rgb<P>,
        apart: Option<P>,
    );
    /// The edge of all light that it found there, in that case: called after that.
    fn found(&mut self, _paths: &Paths<P>, _i: usize, _edge: FoundEdge<P>) {}
    /// All that happened at the vertices, before throughputs change. Gives them their new places.
    fn layer<X>(&mut self, wave: &mut Wave<P, X>);
    /// Directions of all samples of the change of normals (local frame of the vertex), in their order, and the light
    /// from there: over density, times the throughput up to the vertex. Called once the paths have ended.
    fn normals(&mut self, _samples: impl Iterator<Item = (Vec3<P>, Rgb<P>)>) {}
}

/// Nothing is kept.
impl<P: Float> Log<P> for () {
    /// So many that few edges are left for waves that are not full.
    const CROWD: usize = 16 * WAVE_SIZE;
    fn hit(
        &mut self,
        _paths: &Paths<P>,
        _i: usize,
        _emitter: u32,
        _light: &Met<P>,
        _le: Rgb<P>,
        _apart: Option<P>,
    ) {
    }
    fn layer<X>(&mut self, _wave: &mut Wave<P, X>) {}
}

/// A path that starts with a sample of the change of normals.
#[derive(Clone, Copy, Debug)]
struct Branch<P> {
    /// The path it leaves.
    at: usize,
    /// Local frame.
    wi: Vec3<P>,
    pdf: P,
}

/// Up to [`WAVE_SIZE`] paths with equally many edges.
pub(super) struct Wave<P, X> {
    /// How many are on their way.
    n: usize,
    /// How their numbers are spread.
    points: Points,
    samplers: Vec<X>,
    paths: Paths<P>,
    /// Paths that wait for others.
    waiting: Waiting<P>,
    hits: [Option<Hit>; WAVE_SIZE],
    at: Vertices<P>,
    /// Surfaces that the paths have met.
    surfaces: Surfaces<P>,
    /// Plain vertices whose albedo has to be looked up.
    textured: Vec<usize>,
    /// Others whose materials read images.
    imaged: Vec<usize>,
    /// Whether materials do, by their index.
    reads_images: Vec<bool>,
    readings: Readings<P>,
    /// Vertices that are not plain, by kinds.
    kinds: Kinds<P>,
    /// Paths that leave the scene.
    leaving: Leaving<P>,
    /// Paths that sample the same emitter.
    group: Group<P>,
    /// Of one image at a time.
    lookups: Lookups<P>,
    /// Direction the paths came from, local frame.
    wo: Lanes<P>,
    /// Random bits that choose an emitter.
    choice: Lane<u64>,
    /// Random numbers: two for the emitter, three for the BSDF, one for roulette.
    numbers: [Lane<P>; 6],
    lights: Lights<P>,
    bounces: Bounces<P>,
    /// What the scattered directions belong to.
    components: [Component; WAVE_SIZE],
    /// Whether the change of normals has samples of its own anywhere.
    splits: bool,
    /// The paths of these: those of the first vertices first, then in the order of those that they leave.
    branches: Vec<Branch<P>>,
    /// How many of them started at vertices before.
    before: usize,
    /// Where they are followed, with as many edges as those that they left.
    aside: Option<Box<Self>>,
    /// Number of edges with the next one, for paths that are followed aside.
    next: u32,
    /// Radiance of each path in the order of their start, once it has ended.
    pub l: Vec<Rgb<P>>,
}

impl<P: Float, X: Sampler> Wave<P, X> {
    /// Without paths.
    pub fn new() -> Box<Self> {
        Box::new(Self {
            n: 0,
            points: Points::Independent,
            samplers: Vec::with_capacity(WAVE_SIZE),
            paths: Paths::zero(),
            waiting: Waiting::new(),
            hits: [None; WAVE_SIZE],
            at: Vertices::zero(),
            surfaces: Surfaces::new(),
            textured: Vec::with_capacity(WAVE_SIZE),
            imaged: Vec::with_capacity(WAVE_SIZE),
            reads_images: Vec::new(),
            readings: Readings::new(),
            kinds: Kinds::new(),
            leaving: Leaving::new(),
            group: Group::new(),
            lookups: Lookups::new(),
            wo: Lanes::zero(),
            choice: Lane::zero(),
            numbers: [Lane::zero(); 6],
            lights: Lights::zero(),
            bounces: Bounces::zero(),
            components: [Component::Continuous; WAVE_SIZE],
            splits: false,
            branches: Vec::new(),
            before: 0,
            aside: None,
            next: 1,
            l: Vec::new(),
        })
    }

    /// Follows the paths of `n` camera rays to their ends, at most [`Log::CROWD`]. `begin` tells the pixel of each on the
    /// full film, and its numbers.
    pub fn trace<S: Strategy, L: Log<P>>(
        &mut self,
        context: &Context<P>,
        n: usize,
        begin: impl Fn(usize) -> ([u32; 2], X),
        log: &mut L,
    ) {
        self.branches.clear();
        self.l.clear();
        self.l.resize(n, Rgb::black());
        for first in (0..n).step_by(WAVE_SIZE) {
            self.samplers.clear();
            let mut pixels = [[0; 2]; WAVE_SIZE];
            for i in 0..(n - first).min(WAVE_SIZE) {
                let sampler;
                (pixels[i], sampler) = begin(first + i);
                self.start(i, first + i, &sampler);
                self.samplers.push(sampler);
            }
            self.n = self.samplers.len();
            self.look_from(context.scene, &pixels);
            self.advance_all::<S, L>(context, 1, log);
        }
        // Some of these wait once more, before later edges.
        while let Some(depth) = self.waiting.shortest() {
            self.n = self.waiting.join(depth, &mut self.paths, 0);
            self.advance_all::<S, L>(context, depth, log);
        }
        if const { S::Bsdf::DIFFERENTIAL && L::ENABLED }
            && let Some(aside) = &mut self.aside
        {
            aside.advance::<S, S::Still>(context, u32::MAX);
            let samples = self.branches.iter().zip(&aside.l);
            log.normals(samples.map(|(b, l)| (b.wi, l.scale(b.pdf.recip()))));
        }
    }

    /// Follows the paths, whose next edge is the `next`-th, until they end, or wait for others.
    fn advance_all<S: Strategy, L: Log<P>>(
        &mut self,
        context: &Context<P>,
        next: u32,
        log: &mut L,
    ) {
        for depth in next.. {
            if context.progress.cancelled() {
                self.waiting.clear();
                break;
            }
            self.edge::<S, S::Still, L>(context, depth, log);
            if const { L::CROWD > WAVE_SIZE } {
                self.n = self.waiting.fill_up(depth + 1, &mut self.paths, self.n);
            }
            if self.n == 0 {
                break;
            }
        }
    }

    /// Follows the paths until their next edge is the `end`-th, without a log.
    fn advance<Of: Strategy, S: Strategy<Bsdf = Detached>>(
        &mut self,
        context: &Context<P>,
        end: u32,
    ) {
        while self.n > 0 && self.next < end {
            if context.progress.cancelled() {
                // Other paths may start here before this is asked again.
                self.n = 0;
                break;
            }
            self.edge::<Of, S, ()>(context, self.next, &mut ());
            self.next += 1;
        }
    }

    /// Follows all paths along one edge, their `depth`-th, and through what happens at its end. `S` is `Of` where nothing
    /// moves.
    fn edge<Of: Strategy, S: Strategy<Bsdf = Detached>, L: Log<P>>(
        &mut self,
        context: &Context<P>,
        depth: u32,
        log: &mut L,
    ) {
        let &Context {
            scene, settings, ..
        } = context;
        self.find_surfaces(scene);
        if settings.hides(depth) {
            self.look_through_lamps(scene);
        }
        let guide = guide_of::<Of>(scene);
        (self.surfaces).find(scene, &self.paths, &self.hits[..self.n], &mut self.at);
        if !self.arrive::<Of, S, L>(context, guide, depth, log) {
            self.bounces.continues = Lane::zero();
            self.leave();
            return;
        }
        self.draw(depth);
        self.look_back();
        if S::SAMPLES_EMITTERS && !scene.emitters().is_empty() {
            self.sample_lights(context, S::COUNTS_HITS);
            if let Some(split) = context.split.filter(|split| split.is_rough()) {
                self.leave_lights(split);
            }
            self.face_lights::<L>(context, guide);
            self.connect::<S>(context);
            self.find_shadows(scene);
        } else {
            self.lights.shadow_t = Lane::zero();
        }
        let more = has_more(depth, settings);
        // The constant again: where nothing splits, this is not even compiled.
        self.splits = const { Of::Bsdf::DIFFERENTIAL && L::ENABLED };
        if const { Of::Bsdf::DIFFERENTIAL && L::ENABLED } {
            self.split::<Of, S, L>(context, depth, log);
        }
        let before = settings.hide_emitters.then_some(self.paths.eta);
        self.scatter::<S>(context, guide, more);
        if let Some(before) = before {
            self.bend(&before);
        }
        if let Some(split) = context.split.filter(|split| split.selects()) {
            self.leave_casters(split);
        }
        if cfg!(debug_assertions) {
            self.assert_finite();
        }
        self.choose::<L>(more, depth >= settings.rr_depth);
        log.layer(self);
        self.go_on::<L>();
        if !more {
            self.keep_last::<S>(scene);
        }
        self.leave();
    }

    /// Ends the paths that do not go on. Others from the end take their places.
    #[inline(never)]
    fn leave(&mut self) {
        // Lists of both, made without branches.
        let (mut ended, mut going) = ([0; WAVE_SIZE], [0; WAVE_SIZE]);
        let (mut n_ended, mut n_going) = (0, 0);
        for i in 0..self.n {
            (ended[n_ended % WAVE_SIZE], going[n_going % WAVE_SIZE]) = (i, i);
            n_going += (self.bounces.continues[i] & 1) as usize;
            n_ended = i + 1 - n_going;
        }
        for &i in &ended[..n_ended] {
            self.l[self.paths.id[i] as usize] = self.paths.l.rgb(i);
        }
        self.n = n_going;
        let holes = ended[..n_ended].iter().take_while(|&&i| i < n_going);
        for (&to, &from) in holes.zip(going[..n_going].iter().rev()) {
            self.paths.relocate(to, from);
        }
    }

    #[inline(never)]
    fn find_surfaces(&mut self, scene: &Scene) {
        let (n, paths) = (self.n, &self.paths);
        let single = |v: Vec3<P>| v.map(P::to_f32).to_array();
        let ray = |i: usize| {
            let (o, d) = (paths.o.vec(i), paths.d.vec(i));
            (
                single(o),
                single(d),
                f32::INFINITY,
                [paths.surface[i], NOWHERE],
            )
        };
        let mut rays = RayPacket::default();
        if !scene.has_hierarchy() {
            for (k, hits) in self.hits[..n].chunks_mut(PACKET_SIZE).enumerate() {
                rays.fill(hits.len(), |i| ray((k * PACKET_SIZE + i) % WAVE_SIZE));
                for (hit, found) in hits.iter_mut().zip(scene.nearest_packet(&rays)) {
                    *hit = found;
                }
            }
            return;
        }
        let mut all = [0; WAVE_SIZE];
        for (i, path) in all.iter_mut().enumerate() {
            *path = i;
        }
        let mut order = [0; WAVE_SIZE];
        let octant = |i: usize| lockstep::octant(paths.d.vec(i));
        for like in lockstep::sorted(&all[..n], octant, &mut order).chunks(PACKET_SIZE) {
            rays.fill(like.len(), |k| ray(like[k % like.len()]));
            for (&i, found) in like.iter().zip(scene.nearest_packet(&rays)) {
                found.iter().for_each(|hit| scene.expect(hit));
                self.hits[i] = found;
            }
        }
        for hit in self.hits[..n].iter().flatten() {
            scene.fetch(hit);
        }
    }

    /// Finds what the camera sees behind lamps.
    #[cold]
    #[inline(never)]
    fn look_through_lamps(&mut self, scene: &Scene) {
        let paths = &self.paths;
        for (i, hit) in self.hits[..self.n].iter_mut().enumerate() {
            let ray = Ray::new(paths.o.vec(i), paths.d.vec(i)).leaving(paths.surface[i]);
            *hit = hit.and_then(|hit| scene.behind_lamps(&ray, hit));
        }
    }

    /// Adds the light that the edges end at, and looks at the surfaces there. Whether there are any that paths may go
    /// on from.
    #[inline(never)]
    fn arrive<Of: Strategy, S: Strategy<Bsdf = Detached>, L: Log<P>>(
        &mut self,
        context: &Context<P>,
        guide: Option<&Guide>,
        depth: u32,
        log: &mut L,
    ) -> bool {
        let &Context {
            scene,
            theta,
            settings,
            caustics,
            split,
            ..
        } = context;
        let paths = &mut self.paths;
        let mut any = false;
        self.textured.clear();
        self.imaged.clear();
        self.kinds.clear();
        if self.reads_images.is_empty() {
            // It is always the same scene.
            let materials = scene.materials().iter();
            self.reads_images = materials.map(|m| reads_images(m)).collect();
        }
        self.leaving.paths.clear();
        for i in 0..self.n {
            let ray = Ray::new(paths.o.vec(i), paths.d.vec(i)).leaving(paths.surface[i]);
            let mut interest = paths.interest(i);
            let lit = interest.lit(log);
            let sampled = has_rival::<S, P>(depth, paths.pdf[i]);
            let samplers = &mut self.samplers;
            let mut find = |paths: &mut Paths<P>,
                            emitters: &[u32],
                            end: Option<(u32, SurfaceInteraction<P>)>| {
                // The constant again: where no edge is differentiated by itself, this is not even compiled.
                let apart = const { L::ENABLED && differentiates_edges::<Of>() }
                    && log.departure(paths, i).is_some();
                let mut any = false;
                let edge = Looking {
                    emitters,
                    si: end.map(|(_, si)| si),
                    interest,
                    split,
                    lights: settings.lights,
                    d: ray.d,
                    sampled: sampled.then_some((paths.pdf[i], paths.from.vec(i))),
                };
                find_lights::<P, S>(scene, theta, edge, |emitter, share, light, le| {
                    (paths.l).add_rgb(i, paths.beta.rgb(i) * le * light.weight);
                    log.hit(paths, i, emitter, &light, le, apart.then_some(share));
                    any = true;
                });
                if apart
                    && any
                    && let Some(from) = log.departure(paths, i)
                {
                    let sampler = &mut samplers[paths.id[i] as usize % WAVE_SIZE];
                    let edge = FoundEdge {
                        motion: from.motion::<Of, X>(scene, ray.d, depth, sampler),
                        end: end.map(|(prim, si)| (prim, si.t)),
                    };
                    log.found(paths, i, edge);
                }
            };
            // Where there is no surface, or nothing happens: like one that is plain, but without light.
            (self.at.there[i], self.at.lit[i], self.at.plain[i]) = (0, 0, 1);
            (self.at.guide[i], self.at.sorted[i]) = (0, 0);
            let Some(hit) = &self.hits[i] else {
                let emitters = emitters_at(scene, settings, depth, interest.bent, None);
                let lit = lit && !emitters.is_empty();
                if lit && const { L::ENABLED && differentiates_edges::<Of>() } {
                    find(paths, emitters, None);
                } else if lit {
                    self.leaving.paths.push(i);
                }
                continue;
            };
            // Apart, so that the common case stays in registers.
            let (shape, exit, patch) = scene.patch(hit);
            match patch {
                Some(patch) => self.at.put(i, &patch.interaction(&ray, hit)),
                None if self.surfaces.have(i) => {}
                None => self.at.put(i, &scene.interaction(theta, &ray, hit).si),
            }
            let info = scene.shape_info(shape);
            let emitters = emitters_at(scene, settings, depth, interest.bent, Some(shape));
            if lit && !emitters.is_empty() {
                let t = P::from_f32(hit.t);
                let si = SurfaceInteraction {
                    t,
                    ..self.at.interaction(i)
                };
                find(paths, emitters, Some((hit.prim, si)));
            }
            if depth >= settings.max_depth {
                continue;
            }
            interest.arrive(log, caustics, depth, info);
            interest.arrive_on(split, shape, is_along_delta(paths.pdf[i]));
            paths.put_interest(i, interest);
            let differentiated = !L::ENABLED || log.differentiates(info.material);
            any = true;
            self.at.there[i] = 1;
            self.at.material[i] = info.material;
            self.at.delta[i] = u32::from(info.delta);
            self.at.differentiated[i] = u32::from(differentiated);
            self.at.lit[i] = u32::from(interest.lit(log));
            self.at.guide[i] = match guide {
                Some(guide) if is_led(info) => guide.part_at(self.at.p.vec(i)) + 1,
                _ => 0,
            };
            (self.at.offset[i], self.at.surface[i]) = (exit.offset, exit.surface);
            let material = scene.material(shape);
            let back =
                has_two_sides(material) && self.at.frame(i).to_local(-paths.d.vec(i)).z < P::zero();
            let (material, both) = side(material, back);
            (self.at.both[i], self.at.back[i]) = (u32::from(both), u32::from(back));
            let mut plain = 0;
            match material {
                Material::Diffuse(m) => {
                    match m.reflectance {
                        Texture::Constant(albedo) => {
                            (self.at.albedo).put_rgb(i, theta.texel(albedo, 0).into());
                        }
                        _ => self.textured.push(i),
                    }
                    plain = 1;
                }
                _ if self.reads_images[info.material as usize] => self.imaged.push(i),
                _ => {
                    let read = &mut Reading::new(Shading::new(*theta, self.at.uv(i)));
                    let (at, d) = (&self.at, paths.d.vec(i));
                    let taken = (self.kinds).take(i, material, read, &|| at.seen_along(i, d));
                    self.at.sorted[i] = u32::from(taken);
                }
            }
            self.at.plain[i] = plain;
        }
        if !self.leaving.paths.is_empty() {
            self.meet_environments::<S, L>(context, depth, log);
        }
        if !self.textured.is_empty() {
            self.find_albedos(scene, theta);
        }
        if !self.imaged.is_empty() {
            self.read_images(scene, theta);
        }
        any
    }

    /// Sorts the vertices whose materials read images, one material after the other.
    #[inline(never)]
    fn read_images(&mut self, scene: &Scene, theta: &Theta<P>) {
        let (at, paths) = (&mut self.at, &self.paths);
        while let Some(&first) = self.imaged.first() {
            let of = (at.material[first], at.back[first]);
            let (material, _) = side(&scene.materials()[of.0 as usize], of.1 != 0);
            let (mut u, mut v) = (Lane::<P>::zero(), Lane::<P>::zero());
            let mut alike = [0; WAVE_SIZE];
            let mut n = 0;
            self.imaged.retain(|&i| {
                let same = (at.material[i], at.back[i]) == of;
                if same {
                    let uv = own_coordinates(material, at.uv(i));
                    (u[n], v[n], alike[n]) = (uv.x, uv.y, i);
                    n += 1;
                }
                !same
            });
            let visit = |f: &mut dyn FnMut(TextureRef)| visit_textures(material, f);
            self.readings.look(theta, &visit, n, [&u, &v]);
            for (k, &i) in alike[..n].iter().enumerate() {
                let read = &mut self.readings.at(Shading::new(*theta, at.uv(i)), k);
                let (vertices, d) = (&*at, paths.d.vec(i));
                let wo = || vertices.seen_along(i, d);
                let taken = (self.kinds).take(i, material, read, &wo);
                at.sorted[i] = u32::from(taken);
            }
        }
    }

    /// Adds the light that comes from outside along the edges that leave the scene.
    #[inline(never)]
    fn meet_environments<S: Strategy<Bsdf = Detached>, L: Log<P>>(
        &mut self,
        &Context {
            scene,
            theta,
            settings,
            split,
            ..
        }: &Context<P>,
        depth: u32,
        log: &mut L,
    ) {
        // Apart from what is added to.
        let (d, pdf) = (self.paths.d, self.paths.pdf);
        let paths = &mut self.paths;
        let mut found = |i: usize, emitter: u32, light: Met<P>, le: Rgb<P>| {
            if paths.interest(i).leaves(split, emitter) {
                return;
            }
            (paths.l).add_rgb(i, paths.beta.rgb(i) * le * light.weight);
            log.hit(paths, i, emitter, &light, le, None);
        };
        for &emitter in scene.infinite_emitters() {
            let share = settings.lights.share(scene, emitter);
            let light = (depth, share);
            let put = |i, light, le| found(i, emitter, light, le);
            match &scene.emitters()[emitter as usize] {
                e if e.is_delta() => continue,
                AnyEmitter::Envmap(e) if e.is_known() => {
                    let of = (&d, &pdf);
                    (self.leaving).meet::<S>(e, theta, &mut self.lookups, of, light, put);
                    continue;
                }
                AnyEmitter::Vmf(e) => {
                    (self.leaving).meet_lobe::<S>(e, theta, (&d, &pdf), light, put);
                    continue;
                }
                AnyEmitter::Constant(e) => {
                    meet_evenly::<P, S>(e, theta, &self.leaving.paths, &pdf, light, put);
                    continue;
                }
                _ => {}
            }
            for &i in &self.leaving.paths {
                // Environments are the same from everywhere.
                let rival = Rival {
                    pdf_bsdf: pdf[i],
                    from: Vec3::zero(),
                    share,
                };
                let rival = has_rival::<S, P>(depth, pdf[i]).then_some(rival);
                let met = find_light::<P, S>(scene, theta, emitter, d.vec(i), None, rival);
                if let Some((light, le)) = met {
                    found(i, emitter, light, le);
                }
            }
        }
    }

    /// Looks up the albedos that are not the same everywhere.
    #[inline(never)]
    fn find_albedos(&mut self, scene: &Scene, theta: &Theta<P>) {
        let (at, lookups) = (&mut self.at, &mut self.lookups);
        let of = |at: &Vertices<P>, i: usize| albedo(scene, at.material[i], at.back[i] != 0);
        // One image after the other.
        while let Some(&first) = self.textured.first() {
            let Some(texture) = of(at, first) else {
                break;
            };
            let (mut u, mut v) = (Lane::<P>::zero(), Lane::<P>::zero());
            let mut alike = [0; WAVE_SIZE];
            let mut n = 0;
            self.textured.retain(|&i| {
                let same = of(at, i).is_some_and(|t| std::ptr::eq(t, texture));
                if same {
                    (u[n], v[n], alike[n]) = (at.u[i], at.v[i], i);
                    n += 1;
                }
                !same
            });
            let alike = &alike[..n];
            if let Some(image) = image(texture) {
                lookups.find(image, n, &u, &v);
                lookups.expect(theta, image, n, 3);
                for (k, &i) in alike.iter().enumerate() {
                    at.albedo.put_rgb(i, lookups.value(theta, image, k));
                }
                continue;
            }
            for &i in alike {
                texture.expect(theta, at.uv(i));
            }
            for &i in alike {
                let albedo = texture.eval_in_line(theta, at.uv(i));
                at.albedo.put_rgb(i, albedo.into());
            }
        }
    }

    /// All random numbers of the vertices at the end of the `depth`-th edge.
    #[inline(never)]
    fn draw(&mut self, depth: u32) {
        let (light, scattering) = (Purpose::Light.at(depth), Purpose::Scattering.at(depth));
        let (n, paths) = (whole(self.n), &self.paths);
        let [a, b, c, d, e, f] = &mut self.numbers;
        if self.points == Points::Sobol {
            let [x, y, z, _] = sobol(n, paths, light);
            for i in 0..n {
                self.choice[i] = sobol_bits(x[i]);
            }
            for (lane, x) in [(a, &y), (b, &z)] {
                for i in 0..n {
                    lane[i] = P::from_bits_unit(sobol_bits(x[i]));
                }
            }
        } else {
            // Counted from one.
            for i in 0..n {
                self.choice[i] = bits(self.points, paths, i, light + 1);
            }
            draw_units(self.points, n, paths, light + 1, [a, b]);
        }
        draw_units(self.points, n, paths, scattering, [c, d, e, f]);
    }

    /// Where the paths came from.
    #[inline(never)]
    fn look_back(&mut self) {
        for i in 0..whole(self.n) {
            let wo = self.at.frame(i).to_local(-self.paths.d.vec(i));
            let behind = (self.at.both[i] != 0) & (wo.z < P::zero());
            self.at.side[i] = P::select(behind, -P::one(), P::one());
            self.wo.put_vec(i, wo);
        }
    }

    /// `counts_hits`: whether lights that are hit count, too.
    #[inline(never)]
    fn sample_lights(&mut self, context: &Context<P>, counts_hits: bool) {
        let &Context {
            scene, settings, ..
        } = context;
        let emitters = scene.emitters();
        if let [AnyEmitter::Area(area)] = emitters
            && let AnyShape::Rectangle(rectangle) = &scene.shapes()[area.shape as usize]
            && area.exponent == 0.0
        {
            let (at, lights) = (&self.at, &mut self.lights);
            let [a, b, ..] = &self.numbers;
            // A copy, which no store of the loop can change.
            let rectangle = *rectangle;
            let still = Theta::still();
            let share = settings.lights.share(scene, 0);
            let surface = scene.lights().surface(area.shape, 0);
            for i in 0..whole(self.n) {
                let s = rectangle.sample_area(&still, [a[i], b[i]]);
                let seen = s.seen_in_line(at.p.vec(i), s.n);
                let sample = Area::facing_in_line(surface, seen);
                lights.emitter[i] = 0;
                lights.kept[i] = P::one();
                lights.share[i] = share;
                lights.take(i, 0, true, &sample);
            }
            return;
        }
        self.choose_lights(context, counts_hits);
        let (at, lights) = (&self.at, &mut self.lights);
        let [a, b, ..] = &self.numbers;
        lights.pdf = Lane::zero();
        let few = emitters.len() <= FEW;
        if !few {
            sample_balls(scene, (&at.p, [a, b]), self.n, lights);
        }
        for (index, emitter) in (0..).zip(emitters).take(MOST_TOGETHER) {
            let Some(together) = together(scene, emitter) else {
                continue;
            };
            if few && !together.looks_up() {
                let emitter = (index, together);
                (self.group).sample_all(scene, emitter, self.n, &at.p, [a, b], lights);
                continue;
            }
            // All others take less time one by one than to be gathered.
            if !together.gathers() {
                continue;
            }
            let mut chosen = [0; WAVE_SIZE];
            let mut n = 0;
            for i in 0..self.n {
                chosen[n % WAVE_SIZE] = i;
                n += usize::from((lights.emitter[i] == index) & lights.wants(i));
            }
            if n == 0 {
                continue;
            }
            self.group.paths.clear();
            self.group.paths.extend_from_slice(&chosen[..n]);
            (self.group).sample(scene, (index, together), &at.p, [a, b], lights);
        }
        // All others, and spheres from within.
        let mut any = false;
        for i in 0..whole(self.n) {
            any |= lights.wants(i);
        }
        if !any {
            return;
        }
        for i in 0..self.n {
            if lights.wants(i) {
                let (emitter, kept) = (lights.emitter[i], lights.kept[i]);
                let (p, u) = (at.p.vec(i), [a[i], b[i]]);
                let sample = emitters[emitter as usize].sample(scene.lights(), p, u);
                lights.put(i, (emitter, kept), lights.share[i], sample);
            }
        }
    }

    /// The emitters that paths sample, and their shares: zero where none is sampled.
    #[inline(never)]
    fn choose_lights(
        &mut self,
        &Context {
            scene,
            theta,
            settings,
            ..
        }: &Context<P>,
        counts_hits: bool,
    ) {
        let (at, lights) = (&self.at, &mut self.lights);
        let asks = |i: usize| (at.lit[i] != 0) & (at.delta[i] == 0);
        if settings.lights == LightChoice::One {
            lights.kept = [P::one(); WAVE_SIZE];
            let choice = settings.lights;
            match scene.shares() {
                Shares::Even(n, _) => {
                    for i in 0..WAVE_SIZE {
                        lights.emitter[i] = index_below(self.choice[i], *n) as u32;
                    }
                    lights.share = [choice.share(scene, 0); WAVE_SIZE];
                }
                weighted => {
                    for i in 0..self.n {
                        lights.emitter[i] = weighted.choose(self.choice[i], 1).0 as u32;
                        lights.share[i] = choice.share(scene, lights.emitter[i]);
                    }
                }
            }
            let last = self.n;
            for i in 0..WAVE_SIZE {
                let wanted = asks(i) & (i < last);
                lights.share[i] = P::select(wanted, lights.share[i], P::zero());
            }
            return;
        }
        lights.share = Lane::zero();
        let [a, b, ..] = &self.numbers;
        for i in (0..self.n).filter(|&i| asks(i)) {
            let seen = || LitVertex {
                material: &scene.materials()[at.material[i] as usize],
                at: Shading::new(*theta, at.uv(i)),
                frame: at.frame(i),
                wo: self.wo.vec(i),
            };
            let (bits, p) = (self.choice[i], at.p.vec(i));
            (lights.emitter[i], lights.kept[i]) = choose(
                scene,
                settings.lights,
                counts_hits,
                bits,
                [a[i], b[i]],
                p,
                seen,
            );
            lights.share[i] = settings.lights.share(scene, lights.emitter[i]);
        }
    }

    /// Leaves out the lights that manifold connections find, from rough casters.
    #[inline(never)]
    fn leave_lights(&mut self, split: &Split) {
        for i in 0..self.n {
            let emitter = self.lights.emitter[i];
            let cos = self.at.frame(i).n.dot(self.lights.d.vec(i));
            let reflects = self.wo.vec(i).z * cos > P::zero();
            let (interest, material) = (self.paths.interest(i), self.at.material[i]);
            if interest.leaves_sampled(Some(split), emitter, material, reflects) {
                self.lights.pdf[i] = P::zero();
            }
        }
    }

    /// Tells where paths are on chains how they leave their casters.
    #[inline(never)]
    fn leave_casters(&mut self, split: &Split) {
        for i in 0..self.n {
            let mut interest = self.paths.interest(i);
            let reflects = self.wo.vec(i).z * self.bounces.wi.vec(i).z > P::zero();
            let along_delta = is_along_delta(self.paths.pdf[i]);
            interest.leave_by(Some(split), self.at.material[i], along_delta, reflects);
            self.paths.put_interest(i, interest);
        }
    }

    /// Tells which paths have gone on otherwise than straight; relative indices `before` that.
    #[cold]
    #[inline(never)]
    fn bend(&mut self, before: &Lane<P>) {
        for i in 0..self.n {
            let mut interest = self.paths.interest(i);
            interest.bend(self.components[i], [before[i], self.paths.eta[i]]);
            self.paths.put_interest(i, interest);
        }
    }

    /// What the materials make of light from there.
    #[inline(never)]
    fn face_lights<L: Log<P>>(
        &mut self,
        &Context { scene, theta, .. }: &Context<P>,
        guide: Option<&Guide>,
    ) {
        let (at, lights) = (&self.at, &mut self.lights);
        for i in 0..whole(self.n) {
            let side = at.side[i];
            let wi = at.frame(i).to_local(lights.d.vec(i));
            lights.wi.put_vec(i, wi);
            let (wo, wi) = (seen_from(side, self.wo.vec(i)), seen_from(side, wi));
            let white = white();
            let f = white.eval(wo, wi, MODE).r;
            lights.white[i] = f;
            lights.f.put_rgb(i, at.albedo.rgb(i) * f);
            lights.pdf_bsdf[i] = white.pdf(wo, wi, MODE);
        }
        let mut others = SmallVec::<[usize; WAVE_SIZE]>::new();
        for i in 0..self.n {
            if at.plain[i] == 0 && at.sorted[i] == 0 {
                others.push(i);
            }
        }
        let (f, pdf_bsdf) = (&mut lights.f, &mut lights.pdf_bsdf);
        for &(i, found) in self.kinds.eval_pdf(&self.wo, &at.side, &lights.wi) {
            match found {
                Some((value, pdf)) => {
                    f.put_rgb(i, value);
                    pdf_bsdf[i] = pdf;
                }
                None => others.push(i),
            }
        }
        for i in others {
            if lights.pdf[i] > P::zero() {
                let shading = Shading::new(*theta, at.uv(i));
                let material = &scene.materials()[at.material[i] as usize];
                let (f, pdf) = material.eval_pdf(&shading, self.wo.vec(i), lights.wi.vec(i), MODE);
                lights.f.put_rgb(i, f);
                lights.pdf_bsdf[i] = pdf;
            }
        }
        for i in 0..self.n {
            if let Some(directions) = directions(guide, at.guide[i]) {
                let pdf = directions.pdf(lights.d.vec(i));
                lights.pdf_bsdf[i] = mixed(lights.pdf_bsdf[i], pdf);
            }
        }
        // No ray where nothing depends on it.
        for i in 0..whole(self.n) {
            let matters = matters(L::ENABLED, lights.f.rgb(i), lights.pdf_bsdf[i]);
            let matters = matters & (at.lit[i] != 0) & (at.delta[i] == 0);
            lights.pdf[i] = P::select(matters, lights.pdf[i], P::zero());
        }
    }

    #[inline(never)]
    fn connect<S: Strategy>(&mut self, &Context { scene, theta, .. }: &Context<P>) {
        let (at, lights) = (&self.at, &mut self.lights);
        let emitters = scene.emitters();
        let mut weighed = weighs(S::COUNTS_HITS, &emitters[0]);
        match emitters {
            [e] if matches!(e.radiance(), Texture::Constant(_)) && e.scale().is_none() => {
                let radiance: Rgb<P> = e.radiance().rgb(theta, Vec2::zero());
                for i in 0..whole(self.n) {
                    lights.le.put_rgb(i, radiance * lights.falloff[i]);
                }
            }
            _ => {
                // Where there is no sample, any radiance is right.
                let (mut others, rest) = constant_radiances(theta, emitters, self.n, lights);
                let images = (&mut others, rest);
                let rest = image_radiances(theta, emitters, &mut self.lookups, lights, images);
                for &i in &others[..rest] {
                    let e = &emitters[lights.emitter[i] as usize];
                    lights
                        .le
                        .put_rgb(i, e.eval_in_line(theta, &lights.emission(i)));
                }
            }
        }
        if emitters.len() > 1 && S::COUNTS_HITS {
            // All alike: what is not weighed as if scattering had no density.
            leave_deltas(emitters, self.n, lights);
            weighed = true;
        }
        for i in 0..whole(self.n) {
            let mis = mis_weight::<S, P>(weighed, lights.pdf[i], lights.pdf_bsdf[i]);
            let weight = per_density(mis, lights.kept[i], lights.pdf[i]);
            let f = lights.f.rgb(i);
            let direct = self.paths.beta.rgb(i) * f * lights.le.rgb(i) * weight;
            let (d, distance) = (lights.d.vec(i), lights.distance[i]);
            let Segment { ray, length, .. } =
                (at.interaction(i)).shadow_ray(d, distance, at.exit(i), NOWHERE);
            lights.weight[i] = weight;
            lights.direct.put_rgb(i, direct);
            lights.shadow_o.put_vec(i, ray.o);
            lights.shadow_d.put_vec(i, ray.d);
            lights.shadow_t[i] = P::select(lights.pdf[i] > P::zero(), length, P::zero());
        }
    }

    /// Adds the light that nothing hides.
    #[inline(never)]
    fn find_shadows(&mut self, scene: &Scene) {
        let (at, paths, lights) = (&self.at, &mut self.paths, &mut self.lights);
        let mut asked = [0; WAVE_SIZE];
        let mut n = 0;
        for i in 0..self.n {
            asked[n] = i;
            n += usize::from(lights.shadow_t[i] > P::zero());
        }
        let mut rays = RayPacket::default();
        for asked in asked[..n].chunks(PACKET_SIZE) {
            let single = |v: Vec3<P>| v.map(P::to_f32).to_array();
            rays.fill(asked.len(), |k| {
                let i = asked[k % asked.len()];
                let (o, d) = (lights.shadow_o.vec(i), lights.shadow_d.vec(i));
                let skip = [at.surface[i], lights.surface[i]];
                (single(o), single(d), lights.shadow_t[i].to_f32(), skip)
            });
            let occluded = scene.occluded_packet(&rays);
            for (k, &i) in asked.iter().enumerate() {
                // No branch: hardly anything is as hard to predict.
                let hidden = occluded >> k & 1 != 0;
                let light = lights.direct.rgb(i);
                let light = light.map(|c| P::select(hidden, P::zero(), c));
                paths.l.add_rgb(i, light);
                lights.shadow_t[i] = P::select(hidden, P::zero(), lights.shadow_t[i]);
            }
        }
    }

    /// Samples of the change of normals, where log and materials know one, and the paths that start with them.
    #[inline(never)]
    fn split<Of: Strategy, S: Strategy<Bsdf = Detached>, L: Log<P>>(
        &mut self,
        context: &Context<P>,
        depth: u32,
        log: &L,
    ) {
        let &Context {
            scene,
            theta,
            settings,
            ..
        } = context;
        let more = has_more(depth, settings);
        let dimension = Purpose::NormalsPair.at(depth);
        let mut aside = self.aside.take().unwrap_or_else(Self::new);
        if self.branches.is_empty() {
            aside.l.clear();
        }
        self.before = self.branches.len();
        // Those of vertices before are as far as the new ones now: all are followed together.
        aside.advance::<Of, S>(context, depth + 1);
        aside.next = depth + 1;
        let (at, paths, lights) = (&mut self.at, &self.paths, &mut self.lights);
        for i in 0..self.n {
            let index = at.material[i];
            let material = &scene.materials()[index as usize];
            let goes_on = at.there[i] != 0 && may_go_on(at.lit[i] != 0, more);
            at.splits[i] = u32::from(splits::<Of, L>(log, goes_on, index, material));
            if at.splits[i] == 0 {
                continue;
            }
            let shading = Shading::new(*theta, at.uv(i));
            let wo = self.wo.vec(i);
            if lights.shadow_t[i] > P::zero() {
                let e = &scene.emitters()[lights.emitter[i] as usize];
                let (directions, weighs) = ([wo, lights.wi.vec(i)], weighs(S::COUNTS_HITS, e));
                let (pdf, kept) = (lights.pdf[i], lights.kept[i]);
                lights.normals_weight[i] =
                    normals_weight::<S, P>(material, &shading, directions, weighs, pdf, kept);
            }
            if paths.beta.rgb(i).is_black() {
                continue;
            }
            let mut sampler = self.samplers[paths.id[i] as usize % WAVE_SIZE];
            let pair = normals_pair(material, &shading, wo, MODE, &mut sampler, dimension);
            for sample in pair {
                if aside.n == WAVE_SIZE {
                    aside.advance::<Of, S>(context, u32::MAX);
                    aside.next = depth + 1;
                }
                let k = aside.n;
                aside.n += 1;
                aside.start(k, self.branches.len(), &sampler);
                aside.l.push(Rgb::black());
                let d = at.frame(i).to_world(sample.wi);
                let ray = at.interaction(i).spawn_ray(d, at.exit(i));
                aside.paths.surface[k] = ray.from;
                aside.paths.o.put_vec(k, ray.o);
                aside.paths.d.put_vec(k, ray.d);
                aside.paths.beta.put_rgb(k, paths.beta.rgb(i));
                aside.paths.from.put_vec(k, at.p.vec(i));
                aside.paths.pdf[k] = sample.pdf;
                aside.paths.eta[k] = paths.eta[i] * sample.eta;
                let reflects = wo.z * sample.wi.z > P::zero();
                let interest = paths.interest(i).branch(context.split, index, reflects);
                aside.paths.put_interest(k, interest);
                self.branches.push(Branch {
                    at: i,
                    wi: sample.wi,
                    pdf: sample.pdf,
                });
            }
        }
        self.aside = Some(aside);
    }

    /// `more`: whether there may be vertices beyond the next one.
    #[inline(never)]
    fn scatter<S: Strategy<Bsdf = Detached>>(
        &mut self,
        &Context { scene, theta, .. }: &Context<P>,
        guide: Option<&Guide>,
        more: bool,
    ) {
        let (at, paths, bounces) = (&self.at, &mut self.paths, &mut self.bounces);
        let [.., a, b, c, _] = &self.numbers;
        for i in 0..whole(self.n) {
            let side = at.side[i];
            let (lobe, wo) = (white(), seen_from(side, self.wo.vec(i)));
            let sample = lobe.sample(wo, [a[i], b[i], c[i]], MODE);
            let none = (Vec3::zero(), P::zero());
            let (wi, pdf) = sample.map_or(none, |s| (s.wi, s.pdf));
            let f = lobe.eval(wo, wi, MODE).r;
            bounces.wi.put_vec(i, seen_from(side, wi));
            bounces.white[i] = f;
            bounces.f.put_rgb(i, at.albedo.rgb(i) * f);
            bounces.weight[i] = pdf.recip();
            bounces.continues[i] = u32::from(pdf > P::zero()) & at.there[i];
            paths.pdf[i] = pdf;
        }
        self.components = [Component::Continuous; WAVE_SIZE];
        let mut others = SmallVec::<[usize; WAVE_SIZE]>::new();
        for i in 0..self.n {
            let together = at.plain[i] != 0 || at.sorted[i] != 0;
            if !together || directions(guide, at.guide[i]).is_some() {
                others.push(i);
            }
        }
        let components = &mut self.components;
        for &(i, found) in self.kinds.sample(&self.wo, &at.side, [a, b, c]) {
            if directions(guide, at.guide[i]).is_some() {
                continue;
            }
            let Some((wi, f, pdf, component, eta)) = found else {
                others.push(i);
                continue;
            };
            let goes_on = (pdf > P::zero()) & may_go_on(at.lit[i] != 0, more);
            bounces.continues[i] = u32::from(goes_on);
            if goes_on {
                bounces.wi.put_vec(i, wi);
                bounces.f.put_rgb(i, f);
                bounces.weight[i] = pdf.recip();
                components[i] = component;
                paths.eta[i] *= eta;
                paths.pdf[i] = density(component, || pdf);
            }
        }
        for i in others {
            let directions = directions(guide, at.guide[i]);
            if !may_go_on(at.lit[i] != 0, more) {
                bounces.continues[i] = 0;
                continue;
            }
            let shading = Shading::new(*theta, at.uv(i));
            let material = &scene.materials()[at.material[i] as usize];
            let (wo, u) = (self.wo.vec(i), [a[i], b[i], c[i]]);
            let scattered = match directions {
                None => material.scatter(&shading, wo, u, MODE),
                Some(directions) => {
                    guided::<P, S>(directions, material, &shading, &at.frame(i), wo, u)
                }
            };
            bounces.continues[i] = u32::from(scattered.is_some());
            if let Some((sample, f)) = scattered {
                bounces.wi.put_vec(i, sample.wi);
                bounces.f.put_rgb(i, f);
                let side = at.side[i];
                let (wo, wi) = (seen_from(side, wo), seen_from(side, sample.wi));
                bounces.white[i] = white().eval(wo, wi, MODE).r;
                bounces.weight[i] = sample.pdf.recip();
                self.components[i] = sample.component;
                paths.eta[i] *= sample.eta;
                paths.pdf[i] = density(sample.component, || sample.pdf);
            }
        }
    }

    /// [`assert_finite`] of the paths that may go on.
    fn assert_finite(&self) {
        let (paths, bounces) = (&self.paths, &self.bounces);
        for i in (0..self.n).filter(|&i| bounces.continues[i] != 0) {
            let beta = paths.beta.rgb(i) * bounces.f.rgb(i) * bounces.weight[i];
            assert_finite(beta, paths.l.rgb(i));
        }
    }

    /// Decides which paths go on, `more`: if there may be vertices beyond the next one. Roulette, if it is played.
    #[inline(never)]
    fn choose<L: Log<P>>(&mut self, more: bool, plays: bool) {
        let (paths, bounces) = (&mut self.paths, &mut self.bounces);
        let [.., u] = &self.numbers;
        for i in 0..whole(self.n) {
            let (f, weight) = (bounces.f.rgb(i), bounces.weight[i]);
            let beta = paths.beta.rgb(i) * f * weight;
            let weight_here =
                roulette_weight(L::ENABLED, paths.roulette_weight[i], f * weight, beta);
            let q = probability(weight_here, paths.eta[i]);
            let (survives, inv_q) = play(plays, q, u[i]);
            let goes_on = survives & may_go_on(self.at.lit[i] != 0, more);
            paths.roulette_weight[i] = weight_here * inv_q;
            bounces.inverse_survival[i] = inv_q;
            bounces.continues[i] &= u32::from(goes_on);
        }
    }

    /// The next edges.
    #[inline(never)]
    fn go_on<L: Log<P>>(&mut self) {
        let (at, paths, bounces) = (&self.at, &mut self.paths, &mut self.bounces);
        for i in 0..whole(self.n) {
            let beta = paths.beta.rgb(i) * bounces.f.rgb(i) * bounces.weight[i];
            let beta = beta.scale(bounces.inverse_survival[i]);
            bounces.continues[i] &= u32::from(L::ENABLED | !beta.is_black());
            paths.beta.put_rgb(i, beta);
            let d = at.frame(i).to_world(bounces.wi.vec(i));
            let ray = at.interaction(i).spawn_ray(d, at.exit(i));
            paths.surface[i] = ray.from;
            paths.o.put_vec(i, ray.o);
            paths.d.put_vec(i, ray.d);
            paths.from.put_vec(i, at.p.vec(i));
        }
    }

    /// Ends paths whose last edge is of no use.
    #[inline(never)]
    fn keep_last<S: Strategy>(&mut self, scene: &Scene) {
        let (n, paths) = (whole(self.n), &self.paths);
        let mut meets = Lane::<u32>::zero();
        let ray = |i: usize| Ray::new(paths.o.vec(i), paths.d.vec(i));
        scene.may_meet_light_each(&mut meets[..n], ray);
        for i in 0..n {
            let is_of_use = looks_for_light::<S, P>(paths.pdf[i], meets[i] != 0);
            self.bounces.continues[i] &= u32::from(is_of_use);
        }
    }
}

/// Where a material reads its images, at a point with these coordinates.
#[inline(always)]
fn own_coordinates<P: Float>(material: &Material, uv: Vec2<P>) -> Vec2<P> {
    match material {
        Material::Charted(m) => m.chart().own(uv).0,
        _ => uv,
    }
}

/// The densities that lead directions, if there are any.
#[inline(always)]
fn directions(guide: Option<&Guide>, one_more: u32) -> Option<&Directions> {
    guide?.directions(one_more.checked_sub(1)?)
}

/// Every plain material is this one times its albedo.
#[inline(always)]
fn white<P: Float>() -> DiffuseLobe<P> {
    DiffuseLobe {
        reflectance: Rgb::splat(P::one()),
    }
}
