//! Connections from one vertex: a sampled point of a light, starts of walks, and what their ends are worth.

use std::cell::Cell;

use ad_core::{Float, Vec3};
use smallvec::SmallVec;

use super::chain::{Event, Events, Surface, Vertex, towards};
use super::enumeration::{Every, Pieces};
use super::estimate::{Asking, distinct, trials};
use super::landing::{Landing, Landings};
use super::normal::{Normal, Slopes, facet};
use super::sameness::Sameness;
use super::space::{Space, Start, Target};
use super::split::{Split, refracts};
use super::walk::{End, Seed, Solution};
use crate::accel::Hit;
use crate::bsdf::nesting::{Specular, facets};
use crate::bsdf::{Bsdf, DeltaKind, Shading, TransportMode, fresnel};
use crate::emitter::{Ball, Emission, Emitter};
use crate::math::{NOWHERE, Ray, Rgb};
use crate::sampler::{Independent, Sampler};
use crate::scene::{ChainKind, Connections, Method, Starts, Uniqueness};
use crate::shape::{Shape, SurfaceInteraction};

/// A start goes on over a further caster, or over either event of glass, at least as often as this, so that every chain
/// has starts.
const LEAST_PROBABILITY: f64 = 0.1;
/// How many walks start where particles passed; the others reach every solution. What particles miss takes no more than twice
/// the trials.
const PART_LANDED: f64 = 0.5;

/// What connections came to: sums over all of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Vertices and light samples that were to be connected.
    pub attempts: u64,
    /// Those for which any walk found light that counts.
    pub found: u64,
    /// Walks.
    pub walks: u64,
    /// Walks that converged.
    pub converged: u64,
    /// Steps of walks, those that were halved included; boxes of complete searches.
    pub steps: u64,
    /// Solutions that count, by an estimate of one over their probability or as they are.
    pub solutions: u64,
    /// Walks that it took to know how much they count.
    pub trials: u64,
    /// Reciprocals that ran out of trials, and complete searches that ran out of boxes: where there is one, the image is biased.
    pub exhausted: u64,
    /// Walks of which it is proved that they ended in the solution that they were taken for ([`Connections::proofs`]).
    pub proved: u64,
    /// Those of which there is no proof.
    pub unproved: u64,
    /// Paths that met light over a chain, where those are asked for that walks miss.
    pub met: u64,
    /// Those of which no walk found the chain: they count. Walks to find out are not counted above.
    pub missed: u64,
}

impl Statistics {
    /// Adds those of other connections.
    pub fn merge(&mut self, other: &Self) {
        self.attempts += other.attempts;
        self.found += other.found;
        self.walks += other.walks;
        self.converged += other.converged;
        self.steps += other.steps;
        self.solutions += other.solutions;
        self.trials += other.trials;
        self.exhausted += other.exhausted;
        self.proved += other.proved;
        self.unproved += other.unproved;
        self.met += other.met;
        self.missed += other.missed;
    }

    /// Counts what is proved of two walks that were taken for one.
    fn count(&mut self, sameness: Sameness) {
        if sameness == Sameness::Proved {
            self.proved += 1;
        } else {
            self.unproved += 1;
        }
    }
}

/// A vertex of a chain, as materials see it.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// Index of the shape.
    pub shape: u32,
    /// Index of the primitive in the scene.
    pub prim: u32,
    /// Where on it.
    pub si: SurfaceInteraction<f64>,
    /// Direction to the vertex before, local frame.
    pub wo: Vec3<f64>,
    /// Direction on to the light, local frame.
    pub wi: Vec3<f64>,
    /// What happens there.
    pub kind: DeltaKind,
    /// On rough surfaces, density per solid angle of `wi` where the facet is drawn; `None` along a delta.
    pub density: Option<f64>,
}

/// A chain to a light. What it brings is the value of the start's material, times the weights of the deltas, times the
/// emission, times [`Connection::weight`].
#[derive(Clone, Debug)]
pub struct Connection {
    /// Unit direction that it leaves its start in, world space.
    pub direction: Vec3<f64>,
    /// The specular vertices.
    pub links: SmallVec<[Link; 2]>,
    /// Index of the emitter.
    pub emitter: u32,
    /// Where on it, and how it sends light along the chain.
    pub emission: Emission<f64>,
    /// Solid angle at the start over densities at the light, times the estimate of one over the probability of the chain.
    pub weight: f64,
}

/// A sampled point of a light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Light {
    pub emitter: u32,
    pub target: Target,
    /// The surface there, if it lies on one, and its number.
    pub surface: Option<SurfaceInteraction<f64>>,
    pub number: u32,
    /// Density per area or solid angle, or one for a point; the choice of the emitter included.
    pub pdf: f64,
    /// What an environment sends from there.
    pub emission: Emission<f64>,
}

/// Makes connections.
#[derive(Debug)]
pub struct Connector<'a> {
    pub(super) space: Space<'a>,
    pub(super) split: &'a Split,
    pub(super) options: Connections,
    /// Around the scene.
    ball: Option<Ball>,
    /// Around each caster, by shape: of a mesh it takes all of its triangles to know.
    pub(super) around: Vec<Option<Ball>>,
    /// Of normal maps, by shape, where walks have two stages.
    slopes: Vec<Option<Slopes>>,
    pub(super) landings: Landings,
    /// Casters and their surfaces, where all solutions are sought.
    pieces: Vec<(u32, Pieces)>,
    /// Whether these are all that chains lead over ([`Split::admits`]).
    covered: bool,
    /// How often starts go to each caster or one before it in the list; empty where all are alike.
    pub(super) reach: Vec<f64>,
}

/// Which facets of rough surfaces scatter.
#[derive(Clone, Copy, Debug)]
pub(super) enum Facets<'e> {
    /// Those that these numbers draw, vertex by vertex.
    Drawn([[f64; 2]; Connections::MOST_BOUNCES as usize]),
    /// Those of a chain that is known.
    Of(&'e [Event]),
}

impl Facets<'_> {
    /// The normal of vertex `i`, where that is on this shape.
    fn normal(&self, space: &Space, shape: u32, i: usize) -> Normal {
        match self {
            Self::Drawn(u) => facet(space, shape, u[i]),
            Self::Of(events) => events.get(i).map_or(Normal::Own, |e| e.normal),
        }
    }
}

/// What stays the same over the walks of one estimate.
pub(super) struct Estimate<'e> {
    start: &'e Start,
    target: &'e Target,
    /// Longest chain.
    most: u32,
    facets: Facets<'e>,
    /// Particles that landed around the start.
    around: &'e [Landing],
}

impl<'a> Connector<'a> {
    /// In a scene at these parameters.
    pub fn new(space: Space<'a>, split: &'a Split, options: Connections) -> Self {
        let shapes = 0..space.scene.shapes().len() as u32;
        let slopes = match options.starts {
            Starts::TwoStage | Starts::Particles => shapes.map(|i| Slopes::of(&space, i)).collect(),
            Starts::Uniform => Vec::new(),
        };
        let around = |(shape, i)| {
            if split.is_caster(i) {
                Ball::around([shape])
            } else {
                None
            }
        };
        let casters = split.caster_list.iter();
        let complete = options.method == Method::Complete;
        let pieces = casters
            .filter(|_| complete)
            .filter_map(|&shape| Some((shape, Pieces::of(space.scene, shape).ok()?)));
        Self {
            pieces: pieces.collect(),
            covered: split.admits(space.scene, options.method).is_ok(),
            space,
            split,
            options,
            ball: Ball::around(space.scene.shapes()),
            around: space.scene.shapes().iter().zip(0..).map(around).collect(),
            slopes,
            landings: Landings::default(),
            reach: Vec::new(),
        }
    }

    /// The facets of an estimate: numbers are drawn only where there is something rough.
    fn estimate<'e>(
        &'e self,
        start: &'e Start,
        target: &'e Target,
        most: u32,
        rng: &mut Independent,
    ) -> Estimate<'e> {
        let mut facets = [[0.5; 2]; Connections::MOST_BOUNCES as usize];
        if self.split.rough {
            for u in &mut facets[..most.min(self.split.bounces()) as usize] {
                *u = rng.next_2d();
            }
        }
        self.estimate_over(start, target, most, Facets::Drawn(facets))
    }

    /// The same over facets that are given.
    pub(super) fn estimate_over<'e>(
        &'e self,
        start: &'e Start,
        target: &'e Target,
        most: u32,
        facets: Facets<'e>,
    ) -> Estimate<'e> {
        Estimate {
            start,
            target,
            most: most.min(self.split.bounces()),
            facets,
            around: self.landings.around(start.si.p),
        }
    }

    /// One walk from a random start to a target, over at most `most` vertices and random facets: to a chain that light goes
    /// along, if nothing is in the way of its last edge. Basins and counts of solutions are made of these.
    pub fn explore(
        &self,
        start: &Start,
        target: &Target,
        most: u32,
        rng: &mut Independent,
    ) -> Option<Solution> {
        let estimate = self.estimate(start, target, most, rng);
        let solution = self.random(&estimate, rng, &mut Statistics::default())?;
        self.links(&solution, target).map(|_| solution)
    }

    /// Adds to `out` connections from a vertex to one sampled point of a light, over chains of at most `most` vertices. What
    /// they bring, added up, is an estimate of the light that belongs to them, as the method says. Takes as many random
    /// numbers as it needs. Returns what it came to. Once `cancelled` says so, which is asked now and then, nothing of it counts.
    pub fn connect(
        &self,
        start: &Start,
        most: u32,
        rng: &mut Independent,
        cancelled: &dyn Fn() -> bool,
        out: &mut Vec<Connection>,
    ) -> Statistics {
        let mut s = Statistics::default();
        if most < self.split.fewest() || !self.options.method.walks() {
            return s;
        }
        let stops = Asking::new(cancelled);
        let Some(light) = self.light(rng) else {
            return s;
        };
        s.attempts = 1;
        let before = out.len();
        let estimate = self.estimate(start, &light.target, most, rng);
        let compared = Cell::new(Statistics::default());
        let same = |a: &Solution, b: &Solution| {
            let mut s = compared.get();
            let same = self.is_same(&estimate, a, b, &mut s);
            compared.set(s);
            same
        };
        match self.options.method {
            Method::Sms => {
                let shown = self.shown(&estimate, &mut s);
                out.extend(shown.iter().filter_map(|f| self.worth(f, &light)));
                if out.len() > before {
                    s.solutions += (out.len() - before) as u64;
                    s.trials += s.walks;
                }
                out.extend(self.rest(&estimate, &shown, &light, rng, &stops, &mut s));
            }
            Method::SmsBiased(walks) => {
                let walk = || {
                    let goes_on = !stops.now();
                    goes_on.then(|| self.random(&estimate, rng, &mut s))?
                };
                let found = distinct(walks, walk, same);
                out.extend(found.iter().filter_map(|f| self.worth(f, &light)));
            }
            Method::Mnee | Method::MneeUnbiased => {
                let mut starts = self.deterministic_starts(&estimate).into_iter();
                let n = starts.len() as u32;
                let walk = || {
                    let seed = starts.next()?;
                    s.walks += 1;
                    self.walk(&estimate, seed, &mut s)
                };
                let found = distinct(n, walk, same);
                out.extend(found.iter().filter_map(|f| self.worth(f, &light)));
            }
            Method::Complete => {
                let every = self.every(&estimate, &mut s);
                out.extend(every.iter().filter_map(|f| self.worth(f, &light)));
                s.solutions += (out.len() - before) as u64;
                s.trials += s.walks;
            }
            Method::LeftOut | Method::Paths => {}
        }
        s.merge(&compared.get());
        s.found += u64::from(out.len() > before);
        s
    }

    /// All chains of one vertex, by proof.
    fn every(&self, estimate: &Estimate, s: &mut Statistics) -> Vec<Solution> {
        let mut every = Every::default();
        for (shape, pieces) in &self.pieces {
            for kind in [DeltaKind::Reflection, DeltaKind::Transmission] {
                let reflects = kind == DeltaKind::Reflection;
                let possible = reflects || refracts(self.space.scene.material(*shape));
                if possible && self.takes(std::iter::once((*shape, kind))) {
                    let ends = (estimate.start, estimate.target);
                    self.space.every(pieces, ends, (*shape, kind), &mut every);
                }
            }
        }
        s.walks += every.roots;
        s.converged += every.solutions.len() as u64;
        s.steps += every.boxes;
        // Images are rendered of what is not admitted, too.
        s.exhausted += u64::from(every.undecided > 0 || !self.covered);
        every.solutions
    }

    /// Distinct solutions that landings around the start lead to, one after the other until one leads to nothing new; with
    /// those that bring nothing. A function of start, target, facets and landings: no random numbers are drawn.
    fn shown(&self, estimate: &Estimate, s: &mut Statistics) -> SmallVec<[Solution; 1]> {
        let mut shown: SmallVec<[Solution; 1]> = SmallVec::new();
        for landing in estimate.around {
            let Some(another) = self.another(estimate, landing, &shown, s) else {
                break;
            };
            shown.push(another);
        }
        shown
    }

    /// The solution that a landing leads to, if it is none of these.
    fn another(
        &self,
        estimate: &Estimate,
        landing: &Landing,
        known: &[Solution],
        s: &mut Statistics,
    ) -> Option<Solution> {
        let seed = self.landed(estimate, landing)?;
        s.walks += 1;
        let end = self.approach(estimate, seed, s)?;
        let is_new = !known.iter().any(|f| self.is_near(estimate, &end, f, s));
        is_new.then(|| self.polish(estimate, &end, s)).flatten()
    }

    /// One of the other solutions, at random, over an estimate of its probability.
    fn rest(
        &self,
        estimate: &Estimate,
        shown: &[Solution],
        light: &Light,
        rng: &mut Independent,
        stops: &Asking,
        s: &mut Statistics,
    ) -> Option<Connection> {
        let first = self.anywhere(estimate, rng, s)?;
        if shown.iter().any(|f| self.is_near(estimate, &first, f, s)) {
            return None;
        }
        let solution = self.polish(estimate, &first, s)?;
        let mut connection = self.worth(&solution, light)?;
        let again = || {
            if stops.now() {
                return true;
            }
            let end = self.anywhere(estimate, rng, s);
            end.is_some_and(|end| self.is_near(estimate, &end, &solution, s))
        };
        let (n, exhausted) = trials(again, self.options.budget);
        s.solutions += 1;
        s.trials += u64::from(n);
        s.exhausted += u64::from(exhausted);
        connection.weight *= f64::from(n);
        Some(connection)
    }

    /// Any of the emitters.
    pub(super) fn any_emitter(&self, rng: &mut Independent) -> u32 {
        let lights = &self.split.emitter_list;
        let choice = (rng.next_1d::<f64>() * lights.len() as f64) as usize;
        lights[choice.min(lights.len() - 1)]
    }

    /// Any of the casters.
    pub(super) fn any_caster(&self, rng: &mut Independent) -> u32 {
        let casters = &self.split.caster_list;
        let choice = (rng.next_1d::<f64>() * casters.len() as f64) as usize;
        casters[choice.min(casters.len() - 1)]
    }

    /// The caster that a start goes to: mostly one that light reaches, as particles show.
    fn reached_caster(&self, rng: &mut Independent) -> u32 {
        if self.reach.is_empty() {
            return self.any_caster(rng);
        }
        let u = rng.next_1d::<f64>();
        let i = self.reach.partition_point(|&part| part <= u);
        self.split.caster_list[i.min(self.reach.len() - 1)]
    }

    /// A point of a light: any of them equally often.
    fn light(&self, rng: &mut Independent) -> Option<Light> {
        let emitter = self.any_emitter(rng);
        let [a, b] = rng.next_2d::<f64>();
        let Space { scene, theta, .. } = self.space;
        let e = &scene.emitters()[emitter as usize];
        let ray = e.sample_ray(&theta, scene.lights(), self.ball, [a, b, a, b])?;
        let (target, pdf) = if e.is_infinite() {
            (Target::Direction(-ray.ray.d), ray.pdf_direction)
        } else {
            let at = ray.surface.map_or(ray.ray.o, |(_, si)| si.p);
            (Target::Point(at), ray.pdf_position)
        };
        let light = Light {
            emitter,
            target,
            surface: ray.surface.map(|(_, si)| si),
            number: ray.surface.map_or(NOWHERE, |_| ray.exit.surface),
            pdf: pdf / self.split.emitter_list.len() as f64,
            emission: ray.emission,
        };
        (light.pdf > 0.0).then_some(light)
    }

    /// A walk to a solution.
    pub(super) fn walk(
        &self,
        estimate: &Estimate,
        seed: Seed,
        s: &mut Statistics,
    ) -> Option<Solution> {
        let end = self.approach(estimate, seed, s)?;
        self.polish(estimate, &end, s)
    }

    /// A walk to where its root is certain.
    fn approach(&self, estimate: &Estimate, seed: Seed, s: &mut Statistics) -> Option<End> {
        let mut steps = 0;
        let end = (self.space).approach(estimate.start, seed, estimate.target, &mut steps);
        s.steps += u64::from(steps);
        s.converged += u64::from(end.is_some());
        end
    }

    /// The solution that a walk ended near.
    fn polish(&self, estimate: &Estimate, end: &End, s: &mut Statistics) -> Option<Solution> {
        let mut steps = 0;
        let solution = (self.space).polish(estimate.start, end, estimate.target, &mut steps);
        s.steps += u64::from(steps);
        solution
    }

    /// Whether a walk ended near this solution.
    fn is_near(
        &self,
        estimate: &Estimate,
        end: &End,
        solution: &Solution,
        s: &mut Statistics,
    ) -> bool {
        let (&Estimate { start, target, .. }, mut steps) = (estimate, 0);
        let uniqueness = self.options.uniqueness;
        let near = (self.space).is_near(start, end, target, solution, uniqueness, &mut steps);
        s.steps += u64::from(steps);
        let by_bounds = uniqueness == Uniqueness::ErrorBounds;
        if near && by_bounds && self.options.proves(end.direction()) {
            let proof = (self.space).sameness_of_end(start, target, solution, end);
            s.count(proof);
        }
        near
    }

    /// Whether two solutions are one.
    pub(super) fn is_same(
        &self,
        estimate: &Estimate,
        a: &Solution,
        b: &Solution,
        s: &mut Statistics,
    ) -> bool {
        let uniqueness = self.options.uniqueness;
        let same = a.is(b, uniqueness);
        let by_bounds = uniqueness == Uniqueness::ErrorBounds;
        if same && by_bounds && self.options.proves(b.direction()) {
            s.count((self.space).sameness(estimate.start, estimate.target, a, b));
        }
        same
    }

    /// A walk from a random start to a solution.
    fn random(
        &self,
        estimate: &Estimate,
        rng: &mut Independent,
        s: &mut Statistics,
    ) -> Option<Solution> {
        let end = self.anywhere(estimate, rng, s)?;
        self.polish(estimate, &end, s)
    }

    /// A walk from a random start to where its root is certain.
    fn anywhere(
        &self,
        estimate: &Estimate,
        rng: &mut Independent,
        s: &mut Statistics,
    ) -> Option<End> {
        s.walks += 1;
        let around = estimate.around;
        let landed = !around.is_empty() && rng.next_1d::<f64>() < PART_LANDED;
        let seed = if landed {
            let landing = around.get((rng.next_1d::<f64>() * around.len() as f64) as usize)?;
            self.landed(estimate, landing)
        } else if self.slopes.is_empty() {
            self.grow(estimate, rng, |shape, i, _| {
                estimate.facets.normal(&self.space, shape, i)
            })
        } else {
            self.staged(estimate, rng, s)
        };
        self.approach(estimate, seed?, s)
    }

    /// As a particle went that landed near the start.
    fn landed(&self, estimate: &Estimate, landing: &Landing) -> Option<Seed> {
        (landing.like.len() <= estimate.most as usize).then(|| Seed {
            d: (landing.through - estimate.start.si.p).normalize(),
            like: self.own(estimate, landing.like.iter().copied()),
        })
    }

    /// Whether chains of these shapes and events are looked for.
    pub(super) fn takes(
        &self,
        like: impl ExactSizeIterator<Item = (u32, DeltaKind)> + Clone,
    ) -> bool {
        let material = |shape: u32| self.space.scene.shape_info(shape).material;
        self.split
            .takes(like.map(|(shape, kind)| (shape, material(shape), kind)))
    }

    /// From the end of a walk over surfaces without their normal maps, turned by normals of those.
    fn staged(
        &self,
        estimate: &Estimate,
        rng: &mut Independent,
        s: &mut Statistics,
    ) -> Option<Seed> {
        let seed = self.grow(estimate, rng, |shape, i, rng| {
            match &self.slopes[shape as usize] {
                Some(slopes) => slopes.draw(rng.next_2d()),
                None => estimate.facets.normal(&self.space, shape, i),
            }
        })?;
        let smoothed = |e: &Event| matches!(e.normal, Normal::Smoothed(_));
        if !seed.like.iter().any(smoothed) {
            return Some(seed);
        }
        let like = self.own(estimate, seed.like.iter().map(|e| (e.shape, e.kind)));
        let (before, mut steps) = (seed.d, 0);
        let end = (self.space).approach(estimate.start, seed, estimate.target, &mut steps);
        s.steps += u64::from(steps);
        let d = end.map_or(before, |end| end.direction());
        Some(Seed { d, like })
    }

    /// The same events by the surfaces' own normals, or those of the estimate's facets.
    fn own(&self, estimate: &Estimate, like: impl Iterator<Item = (u32, DeltaKind)>) -> Events {
        let own = |(i, (shape, kind)): (usize, (u32, DeltaKind))| Event {
            shape,
            kind,
            normal: estimate.facets.normal(&self.space, shape, i),
        };
        like.enumerate().map(own).collect()
    }

    /// A chain that starts towards a random point of a caster and goes on as light would, by the surfaces' own normals.
    #[cfg(test)]
    pub(super) fn seed(
        &self,
        start: &Start,
        most: u32,
        rng: &mut Independent,
    ) -> Option<super::Chain> {
        let target = Target::Point(Vec3::zero());
        let estimate = self.estimate(start, &target, most, rng);
        let seed = self.grow(&estimate, rng, |_, _, _| Normal::Own)?;
        self.space.trace(start, seed.d, &seed.like)
    }

    /// A start towards a random point of a caster that goes on as light would: at glass in either way, in
    /// proportion to its reflectance or nearly so, and over further casters that it meets, mostly. `normal` says which
    /// scatters on a shape, at a vertex.
    ///
    /// Every chain has starts next to it: its own events are possible there, and it may end where the next ray meets a
    /// caster beyond the light.
    fn grow(
        &self,
        estimate: &Estimate,
        rng: &mut Independent,
        mut normal: impl FnMut(u32, usize, &mut Independent) -> Normal,
    ) -> Option<Seed> {
        let &Estimate { start, most, .. } = estimate;
        let shape = &self.space.scene.shapes()[self.reached_caster(rng) as usize];
        let seed = shape.sample(start.si.p, rng.next_2d::<f64>())?.d;
        let (hit, met) = self.space.meet(&start.si.spawn_ray(seed, start.exit))?;
        if !self.split.is_caster(met) {
            return None;
        }
        let mut like = Events::new();
        let (mut from, mut d, mut hit, mut met) = (start.si.p, seed, hit, met);
        loop {
            let scatters = normal(met, like.len(), rng);
            let u = rng.next_1d();
            let last = like.len() as u32 + 1 == most;
            let ends = rng.next_1d::<f64>() < LEAST_PROBABILITY;
            let mut event = Event {
                shape: met,
                kind: DeltaKind::Reflection,
                normal: scatters,
            };
            let mut next = None;
            // What is met, and where light goes on, is looked up only where something depends on it.
            if !last || refracts(self.space.scene.material(met)) {
                let refracted = |e: &Event| e.kind == DeltaKind::Transmission;
                let before = like
                    .iter()
                    .fold(ChainKind::NONE, |f, e| f.then(refracted(e)));
                let may = self.split.goes_on(before);
                let (here, kind) = self.event(from, d, &hit, scatters, (u, may));
                event.kind = kind;
                if !last {
                    next = self.space.onward(&here, -d, kind);
                }
                from = here.si.p;
            }
            like.push(event);
            match next {
                Some((onward, next, shape)) if self.split.is_caster(shape) && !ends => {
                    (d, hit, met) = (onward, next, shape);
                }
                _ => {
                    let takes = self.takes(like.iter().map(|e| (e.shape, e.kind)));
                    return takes.then_some(Seed { d: seed, like });
                }
            }
        }
    }

    /// The surface at a hit on a caster, and a random event there, of those that may be: reflection, refraction.
    pub(super) fn event(
        &self,
        from: Vec3<f64>,
        d: Vec3<f64>,
        hit: &Hit,
        normal: Normal,
        (u, [may_reflect, may_refract]): (f64, [bool; 2]),
    ) -> (Surface<f64>, DeltaKind) {
        let here = (self.space).surface(&Ray::new(from, d), -d, hit, normal);
        if !refracts(self.space.scene.material(here.shape)) {
            return (here, DeltaKind::Reflection);
        }
        let (cos, eta) = (-here.facet.n.dot(d), here.facet.eta);
        let across = if cos < 0.0 { eta.recip() } else { eta };
        let light = fresnel::dielectric(cos.abs(), across);
        let reflects = match (may_reflect, may_refract) {
            (true, true) => (light.reflect).clamp(LEAST_PROBABILITY, 1.0 - LEAST_PROBABILITY),
            (true, false) => 1.0,
            _ => 0.0,
        };
        let kind = if light.transmit <= 0.0 || u < reflects {
            DeltaKind::Reflection
        } else {
            DeltaKind::Transmission
        };
        (here, kind)
    }

    /// Straight at the light, through whatever refracts, and at the middle of what reflects.
    pub(super) fn deterministic_starts(&self, estimate: &Estimate) -> Vec<Seed> {
        let &Estimate {
            start,
            target,
            most,
            ..
        } = estimate;
        let scene = self.space.scene;
        let mut seeds = Vec::new();
        let mut start_in = |d: Vec3<f64>, like: Events| {
            if self.takes(like.iter().map(|e| (e.shape, e.kind)))
                && self.space.trace(start, d, &like).is_some()
            {
                seeds.push(Seed { d, like });
            }
        };
        // The casters on the straight way.
        let d = towards(start.si.p, target);
        let end = match *target {
            Target::Point(at) => (at - start.si.p).length(),
            Target::Direction(_) => f64::INFINITY,
        };
        let mut like: SmallVec<[(u32, DeltaKind); 4]> = SmallVec::new();
        let (mut si, mut exit) = (start.si, start.exit);
        while let Some((hit, shape)) = self.space.meet(&si.spawn_ray(d, exit)) {
            if !self.split.is_caster(shape) || !refracts(scene.material(shape)) {
                break;
            }
            let here = (self.space).surface(&Ray::new(si.p, d), -d, &hit, Normal::Own);
            if (here.si.p - start.si.p).length() >= end || like.len() as u32 == most {
                break;
            }
            like.push((shape, DeltaKind::Transmission));
            (si, exit) = (here.si, scene.exit(here.prim));
        }
        if !like.is_empty() {
            let events = self.own(estimate, like.into_iter());
            start_in(d, events);
        }
        for &shape in &self.split.caster_list {
            let Some(ball) = self.around[shape as usize] else {
                continue;
            };
            let middle = Vec3::from(ball.centre);
            let d = (middle - start.si.p).normalize();
            let events = self.own(estimate, [(shape, DeltaKind::Reflection)].into_iter());
            start_in(d, events);
        }
        seeds
    }

    /// What light along a solution is worth, before trials. `None` where there is none: in between something, or light does
    /// not go that way.
    pub(super) fn worth(&self, solution: &Solution, light: &Light) -> Option<Connection> {
        let scene = self.space.scene;
        let last = solution.chain.last()?;
        let out = towards(last.si.p, &light.target);
        // ---- Emission ----
        let e = &scene.emitters()[light.emitter as usize];
        let (emission, area) = match light.target {
            Target::Direction(_) => (light.emission, 1.0),
            Target::Point(_) => {
                let (emission, _) = e.leaves(-out, light.surface.as_ref())?;
                let cos = light.surface.map_or(1.0, |si| si.n_geo.dot(out).abs());
                (emission, cos)
            }
        };
        let links = self.links(solution, &light.target)?;
        // ---- The last edge ----
        let distance = match light.target {
            Target::Point(at) => (at - last.si.p).length(),
            Target::Direction(_) => f64::INFINITY,
        };
        let exit = scene.exit(last.prim);
        let shadow = last.si.shadow_ray(out, distance, exit, light.number);
        if scene.occluded(&shadow) {
            return None;
        }
        let weight = solution.angle_per_target() * area / light.pdf;
        Some(Connection {
            direction: solution.direction(),
            links,
            emitter: light.emitter,
            emission,
            weight,
        })
    }

    /// The vertices of a solution as materials see them. `None` where light does not go that way.
    fn links(&self, solution: &Solution, target: &Target) -> Option<SmallVec<[Link; 2]>> {
        let Space { scene, theta, .. } = self.space;
        let mut links = SmallVec::new();
        for (i, vertex) in solution.chain.iter().enumerate() {
            let next = match solution.chain.get(i + 1) {
                Some(next) => -next.wo,
                None => towards(vertex.si.p, target),
            };
            let link = self.link(vertex, next)?;
            let at = Shading::new(theta, link.si.uv);
            let (material, mode) = (scene.material(link.shape), TransportMode::Radiance);
            if link.density.is_some() {
                // Zero reflectance may have a derivative, here, too.
                let (_, pdf) = material.eval_pdf(&at, link.wo, link.wi, mode);
                if pdf <= 0.0 {
                    return None;
                }
                links.push(link);
                continue;
            }
            let value: Rgb<f64> = material.eval_delta(&at, link.wo, link.wi, link.kind, 0, mode);
            // Zero reflectance may have a derivative; at total reflection nothing goes on.
            if value.is_black() && !self.passes(vertex) {
                return None;
            }
            links.push(link);
        }
        Some(links)
    }

    /// Whether some light goes over a vertex, whatever the factors on it.
    fn passes(&self, vertex: &Vertex) -> bool {
        let material = self.space.scene.material(vertex.shape);
        match (facets(material).map(|f| f.specular), vertex.kind) {
            (Some(Specular::Interface(_)), DeltaKind::Transmission) => {
                let cos = vertex.normal().dot(vertex.wo);
                let eta = vertex.eta();
                let across = if cos < 0.0 { eta.recip() } else { eta };
                fresnel::dielectric(cos.abs(), across).transmit > 0.0
            }
            (Some(Specular::Interface(_)), _) => true,
            // Metal may have one side only.
            _ => {
                let at = Shading::new(self.space.theta, vertex.si.uv);
                let wo = vertex.si.frame.to_local(vertex.wo);
                material
                    .sample(&at, wo, [0.5; 3], TransportMode::Radiance)
                    .is_some()
            }
        }
    }

    /// A vertex as materials see it: on the sides that they scatter between. `None` if light does not go on like that.
    pub(super) fn link(&self, vertex: &Vertex, wi: Vec3<f64>) -> Option<Link> {
        let (n, wo, frame) = (vertex.normal(), vertex.wo, &vertex.si.frame);
        let reflects = vertex.kind == DeltaKind::Reflection;
        let one_side = n.dot(wo) * n.dot(wi) > 0.0;
        // Where half vectors are roots that are no solutions.
        let onward = super::constraint::scatter(vertex.kind, wo, n, vertex.eta())?;
        if one_side != reflects || (onward - wi).length() > 1e-6 {
            return None;
        }
        let density = match vertex.normal_is {
            Normal::Facet(m) => Some(self.density(vertex, wi, m)?),
            Normal::Own | Normal::Smoothed(_) => None,
        };
        let along = |w: Vec3<f64>| frame.n.dot(w);
        let possible = match density {
            // Materials tell reflection from refraction by the surface's sides, and would take another facet for the one drawn.
            Some(_) => (along(wo) * along(wi) > 0.0) == reflects,
            // As mapped normals have it: on the same side of both.
            None => [wo, wi].iter().all(|w| along(*w) * n.dot(*w) > 0.0),
        };
        possible.then(|| Link {
            shape: vertex.shape,
            prim: vertex.prim,
            si: vertex.si,
            wo: frame.to_local(wo),
            wi: frame.to_local(wi),
            kind: vertex.kind,
            density,
        })
    }

    /// Density per solid angle of the direction `wi` that the facet with the normal `m` scatters into, where facets are drawn
    /// from all normals. `None` where it is nothing that could be divided by.
    ///
    /// # Source
    /// The Jacobians of [Zeltner 2021, Eqs. 2.36 and 2.37] with errata Z-2.38 and Z-2.42.
    fn density(&self, vertex: &Vertex, wi: Vec3<f64>, m: Vec3<f64>) -> Option<f64> {
        let roughness = facets(self.space.scene.material(vertex.shape))?.roughness?;
        let n = vertex.normal();
        let (signed, cos_i) = (n.dot(vertex.wo), n.dot(wi).abs());
        let cos_o = signed.abs();
        let stretch = match vertex.kind {
            DeltaKind::Transmission => {
                let eta = vertex.eta();
                // The index on the side of `wi` over that on the other.
                let across = if signed < 0.0 { eta.recip() } else { eta };
                across * across * cos_i / (across * cos_i - cos_o).powi(2)
            }
            DeltaKind::Reflection | DeltaKind::Passthrough => 0.25 / cos_o,
        };
        let density = roughness.everywhere(&self.space.theta).pdf_all(m) * stretch;
        (density > 0.0 && density.is_finite()).then_some(density)
    }
}

/// The same point in another precision.
pub(crate) fn cast<A: Float, B: Float>(si: &SurfaceInteraction<A>) -> SurfaceInteraction<B> {
    let number = |x: A| B::from_f64(x.to_f64());
    let vector = |v: Vec3<A>| v.map(number);
    SurfaceInteraction {
        p: vector(si.p),
        t: number(si.t),
        n_geo: vector(si.n_geo),
        frame: crate::math::Frame {
            s: vector(si.frame.s),
            t: vector(si.frame.t),
            n: vector(si.frame.n),
        },
        uv: si.uv.map(number),
    }
}
