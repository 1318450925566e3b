//! Many paths at one emitter, at once: samples of it, and environments that paths leave the scene towards.

use ad_core::{Float, Vec2, Vec3};

use super::lamps::FacesOfLamps;
use super::lanes::{Field, Lane, Lanes, WAVE_SIZE, lanes, whole};
use super::lookups::{Lookups, image};
use super::searches::Searches;
use super::state::Lights;
use crate::emitter::{
    AnyEmitter, Area, Cone, Constant, Directional, Emission, Emitter, EmitterSample, Envmap,
    LocalSums, MapPoint, Plane, Vmf, towards_in_line,
};
use crate::estimator::Strategy;
use crate::integrator::vertex::light::{Met, counts_hits, has_rival, may_have_rival, met_weight};
use crate::math::{NOWHERE, Rgb};
use crate::params::Theta;
use crate::scene::Scene;
use crate::shape::{AnyShape, Cylinder, Disk, Mesh, Rectangle, Shape, sample_cone};
use crate::texture::Texture;

/// Emitters beyond so many are sampled one by one: few paths of a wave meet at one of them.
pub const MOST_TOGETHER: usize = 16;

/// Up to so many emitters, all paths sample each, and take the sample of the one that they have chosen: less work than to
/// gather those that have.
pub const FEW: usize = 8;

/// What paths that choose an emitter do together. All numbers are copies, which no store of a loop can change.
#[derive(Clone, Copy, Debug)]
pub enum Together<'a> {
    /// A rectangle without a lobe, and the surface it lies on. So are all other shapes.
    Rectangle(Rectangle, u32),
    /// A ball that does: centre, radius, and surface.
    Ball([f32; 3], f32, u32),
    /// A point light, where it is.
    Point([f32; 3]),
    /// A spot: where it is, and where it shines.
    Spot([f32; 3], Cone),
    /// A disk, and its surface.
    Disk(Disk, u32),
    /// A tube, and its surface.
    Cylinder(Cylinder, u32),
    /// A mesh, and its shape.
    Mesh(&'a Mesh, u32),
    /// A projector: where it is, and its image.
    Projector([f32; 3], Plane),
    /// A spot with an image: where it is, where it shines, and the image.
    Slide([f32; 3], Cone, Plane),
    /// A lobe around everything.
    Lobe(&'a Vmf),
    /// Parallel light.
    Directional(&'a Directional),
    /// An even environment.
    Constant(&'a Constant),
    /// An environment map.
    Envmap(&'a Envmap),
}

/// What paths that choose this emitter may do together.
pub fn together<'a>(scene: &'a Scene, emitter: &'a AnyEmitter) -> Option<Together<'a>> {
    Some(match emitter {
        AnyEmitter::Area(area) => {
            if area.exponent != 0.0 {
                return None;
            }
            let surface = || scene.lights().surface(area.shape, 0);
            match &scene.shapes()[area.shape as usize] {
                AnyShape::Rectangle(rectangle) => Together::Rectangle(*rectangle, surface()),
                AnyShape::Disk(disk) => Together::Disk(*disk, surface()),
                AnyShape::Cylinder(cylinder) => Together::Cylinder(*cylinder, surface()),
                AnyShape::Mesh(mesh) => Together::Mesh(mesh, area.shape),
                _ => {
                    let (center, radius) = even_ball(scene, area)?;
                    Together::Ball(center, radius, surface())
                }
            }
        }
        AnyEmitter::Projector(e) => {
            let (position, plane) = e.lens();
            Together::Projector(position, plane)
        }
        AnyEmitter::Slide(e) => {
            let (position, cone, plane) = e.lens();
            Together::Slide(position, cone, plane)
        }
        AnyEmitter::Vmf(e) => Together::Lobe(e),
        AnyEmitter::Point(e) => Together::Point(e.position()),
        AnyEmitter::Spot(e) => {
            let (position, cone) = e.cone();
            Together::Spot(position, cone)
        }
        AnyEmitter::Directional(e) => Together::Directional(e),
        AnyEmitter::Constant(e) => Together::Constant(e),
        AnyEmitter::Envmap(e) if e.is_known() => Together::Envmap(e),
        _ => return None,
    })
}

impl Together<'_> {
    /// Whether something is looked up for each of its samples: then, only the paths that have chosen it are sampled.
    #[inline(always)]
    pub fn looks_up(&self) -> bool {
        matches!(self, Self::Envmap(_) | Self::Mesh(..))
    }

    /// Whether it takes less time to gather the paths that have chosen it than to sample it path by path.
    #[inline(always)]
    pub fn gathers(&self) -> bool {
        let flat = matches!(self, Self::Rectangle(..) | Self::Disk(..));
        flat | self.looks_up() | matches!(self, Self::Cylinder(..) | Self::Lobe(_))
    }
}

/// Centre and radius, if light comes from a ball that sends the same everywhere, and [`sample_cone`] is all of its samples.
#[inline(always)]
fn even_ball(scene: &Scene, area: &Area) -> Option<([f32; 3], f32)> {
    match &scene.shapes()[area.shape as usize] {
        AnyShape::Sphere(sphere) if area.exponent == 0.0 && sphere.is_plain() => {
            Some((sphere.center(), sphere.radius()))
        }
        _ => None,
    }
}

lanes! {
    /// Samples of one emitter.
    Samples {
        d: Lanes<P>,
        distance: Lane<P>,
        /// Zero if there is no sample.
        pdf: Lane<P>,
        falloff: Lane<P>,
        u: Lane<P>,
        v: Lane<P>,
        /// Whether they are right; otherwise, the functions of the emitter have to be called.
        right: Lane<u32>,
    }
}

/// No sample.
#[inline(always)]
fn nothing<P: Float>() -> EmitterSample<P> {
    let emission = Emission {
        uv: Vec2::zero(),
        falloff: P::zero(),
    };
    EmitterSample::without_surface(Vec3::zero(), P::zero(), P::zero(), emission)
}

/// The sample of a light without size: direction, distance, and what arrives.
#[inline(always)]
fn from_point<P: Float>((d, distance, falloff): (Vec3<P>, P, P)) -> EmitterSample<P> {
    let emission = Emission {
        uv: Vec2::zero(),
        falloff,
    };
    EmitterSample::without_surface(d, distance, P::one(), emission)
}

/// Samples of one emitter for several paths.
pub struct Group<P> {
    /// The paths.
    pub paths: Vec<usize>,
    numbers: [Lane<P>; 2],
    samples: Box<Samples<P>>,
    draws: Box<Draws>,
    faces: FacesOfLamps<P>,
}

/// How samples of an environment map come about.
#[derive(Clone, Debug)]
struct Draws {
    band: Lane<u32>,
    cover: Lane<f64>,
    before: Lane<f64>,
    rows: [Lane<f64>; 2],
    lines: [Lane<f64>; 2],
    corners: [[Lane<f64>; 2]; 2],
    /// How far down in the band.
    y: Lane<f64>,
    cell: Lane<f64>,
    edges: [Lane<f64>; 2],
    /// Where searches are.
    searches: Searches,
    /// The sum that each cell reaches.
    target: Lane<f64>,
}

impl<P: Float> Group<P> {
    /// Without paths.
    pub fn new() -> Self {
        Self {
            paths: Vec::with_capacity(WAVE_SIZE),
            numbers: [Lane::zero(); 2],
            samples: Box::new(Samples::zero()),
            draws: Box::new(Draws::zero()),
            faces: FacesOfLamps::new(),
        }
    }

    /// Samples an emitter for `paths`, which stand at `p` and have chosen it, with two random numbers of each. They take what
    /// is right.
    #[inline(always)]
    pub fn sample(
        &mut self,
        scene: &Scene,
        (index, emitter): (u32, Together),
        p: &Lanes<P>,
        [a, b]: [&Lane<P>; 2],
        lights: &mut Lights<P>,
    ) {
        let n = self.paths.len();
        let mut at = Lanes::zero();
        for (k, &i) in self.paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            at.put_vec(k, p.vec(i));
            (self.numbers[0][k], self.numbers[1][k]) = (a[i], b[i]);
        }
        let [a, b] = &self.numbers;
        let mut surface = NOWHERE;
        let mut on_mesh = false;
        match emitter {
            Together::Envmap(e) => {
                self.draws.find(e, n, [a, b]);
                self.samples.of_envmap(e, n, &self.draws, a);
            }
            Together::Mesh(mesh, shape) => {
                self.faces.draw(scene, (mesh, shape), n, [a, b]);
                self.samples.of_faces(&self.faces, n, &at);
                on_mesh = true;
            }
            _ => surface = self.samples.find(scene, emitter, n, &at, [a, b]),
        }
        let s = &*self.samples;
        for (k, &i) in self.paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            let pdf = s.pdf[k];
            let sample = EmitterSample {
                surface: if on_mesh {
                    self.faces.surface(k)
                } else {
                    surface
                },
                pdf: P::select(pdf > P::zero(), pdf, P::zero()),
                ..s.sample(k)
            };
            lights.take(i, index, s.right[k] != 0, &sample);
        }
    }

    /// The same for the first `n` of all paths: those that have chosen this emitter take what is right.
    #[inline(always)]
    pub fn sample_all(
        &mut self,
        scene: &Scene,
        (index, emitter): (u32, Together),
        n: usize,
        p: &Lanes<P>,
        numbers: [&Lane<P>; 2],
        lights: &mut Lights<P>,
    ) {
        let surface = self.samples.find(scene, emitter, n, p, numbers);
        let s = &*self.samples;
        for i in 0..whole(n) {
            let sample = EmitterSample {
                surface,
                ..s.sample(i)
            };
            lights.take(i, index, s.right[i] != 0, &sample);
        }
    }
}

impl<P: Float> Samples<P> {
    #[inline(always)]
    fn put(&mut self, k: usize, sample: &EmitterSample<P>) {
        self.d.put_vec(k, sample.d);
        self.distance[k] = sample.distance;
        self.pdf[k] = sample.pdf;
        self.falloff[k] = sample.emission.falloff;
        (self.u[k], self.v[k]) = (sample.emission.uv.x, sample.emission.uv.y);
        self.right[k] = 1;
    }

    /// What [`Samples::put`] has put there.
    #[inline(always)]
    fn sample(&self, k: usize) -> EmitterSample<P> {
        let emission = Emission {
            uv: Vec2::new(self.u[k], self.v[k]),
            falloff: self.falloff[k],
        };
        EmitterSample::without_surface(self.d.vec(k), self.distance[k], self.pdf[k], emission)
    }

    /// Samples of an emitter that is no map, and the surface that they lie on.
    #[inline(always)]
    fn find(
        &mut self,
        scene: &Scene,
        emitter: Together,
        n: usize,
        p: &Lanes<P>,
        numbers: [&Lane<P>; 2],
    ) -> u32 {
        match emitter {
            Together::Rectangle(rectangle, surface) => {
                self.of_flat(rectangle, n, p, numbers);
                return surface;
            }
            Together::Ball(center, radius, surface) => {
                self.of_ball(center, radius, n, p, numbers);
                return surface;
            }
            Together::Disk(disk, surface) => {
                self.of_flat(disk, n, p, numbers);
                return surface;
            }
            Together::Cylinder(cylinder, surface) => {
                self.of_cylinder(cylinder, n, p, numbers);
                return surface;
            }
            Together::Projector(position, plane) => self.of_projector(position, plane, n, p),
            Together::Slide(position, cone, plane) => {
                self.of_spot(position, cone, n, p);
                self.of_slide(plane, n);
            }
            Together::Lobe(e) => self.of_lobe(e, n, scene, numbers),
            Together::Point(position) => self.of_point(position, n, p),
            Together::Spot(position, cone) => self.of_spot(position, cone, n, p),
            Together::Directional(e) => {
                let from = [P::zero(); 2];
                let sample = e.sample(scene.lights(), Vec3::zero(), from);
                self.of_all(&sample.unwrap_or(nothing()), n);
            }
            Together::Constant(e) => self.of_sky(e, n, scene, numbers),
            Together::Envmap(_) | Together::Mesh(..) => self.right = Lane::zero(),
        }
        NOWHERE
    }

    /// Samples of a shape whose area is sampled without a branch.
    #[inline(never)]
    fn of_flat(&mut self, shape: impl Shape, n: usize, p: &Lanes<P>, [a, b]: [&Lane<P>; 2]) {
        let still = Theta::still();
        for k in 0..whole(n) {
            let s = shape.sample_area(&still, [a[k], b[k]]);
            let seen = s.seen_in_line(p.vec(k), s.n);
            self.put(k, &Area::facing_in_line(NOWHERE, seen));
        }
    }

    #[inline(never)]
    fn of_ball(
        &mut self,
        center: [f32; 3],
        radius: f32,
        n: usize,
        p: &Lanes<P>,
        [a, b]: [&Lane<P>; 2],
    ) {
        for k in 0..whole(n) {
            let seen = sample_cone(center, radius, p.vec(k), [a[k], b[k]]);
            let sample = seen.and_then(|s| Area::facing(0.0, NOWHERE, s));
            self.put(k, &sample.unwrap_or(nothing()));
            // From within, it is seen otherwise.
            self.right[k] = u32::from(self.pdf[k] > P::zero());
        }
    }

    #[inline(never)]
    fn of_cylinder(&mut self, cylinder: Cylinder, n: usize, p: &Lanes<P>, [a, b]: [&Lane<P>; 2]) {
        for k in 0..whole(n) {
            let seen = cylinder.sample_in_line(p.vec(k), [a[k], b[k]]);
            self.put(k, &Area::facing_in_line(NOWHERE, seen));
        }
    }

    #[inline(never)]
    fn of_faces(&mut self, faces: &FacesOfLamps<P>, n: usize, p: &Lanes<P>) {
        let Some(corners) = faces.corners() else {
            return;
        };
        for k in 0..whole(n) {
            let (s, flat, right) = faces.sample(corners, k);
            let seen = s.seen_in_line(p.vec(k), flat);
            self.put(k, &Area::facing_in_line(NOWHERE, seen));
            self.right[k] = u32::from(right);
        }
    }

    #[inline(never)]
    fn of_projector(&mut self, position: [f32; 3], plane: Plane, n: usize, p: &Lanes<P>) {
        for k in 0..whole(n) {
            let ((d, distance, inverse_square), right) = towards_in_line(position, p.vec(k));
            let (mut emission, is_met) = plane.profile_in_line(-d);
            emission.falloff *= inverse_square;
            let lit = is_met & (emission.falloff > P::zero()) & (emission.falloff <= P::MAX);
            let pdf = P::select(lit, P::one(), P::zero());
            self.put(
                k,
                &EmitterSample::without_surface(d, distance, pdf, emission),
            );
            self.right[k] = u32::from(right);
        }
    }

    /// The image of a spot that has been sampled.
    #[inline(never)]
    fn of_slide(&mut self, plane: Plane, n: usize) {
        for k in 0..whole(n) {
            let (uv, _, ahead) = plane.meet_in_line(-self.d.vec(k));
            (self.u[k], self.v[k]) = (uv.x, uv.y);
            self.pdf[k] = P::select(ahead, self.pdf[k], P::zero());
        }
    }

    #[inline(never)]
    fn of_lobe(&mut self, e: &Vmf, n: usize, scene: &Scene, [a, b]: [&Lane<P>; 2]) {
        let lights = scene.lights();
        for k in 0..whole(n) {
            let sample = e.sample(lights, Vec3::zero(), [a[k], b[k]]);
            self.put(k, &sample.unwrap_or(nothing()));
        }
    }

    #[inline(never)]
    fn of_point(&mut self, position: [f32; 3], n: usize, p: &Lanes<P>) {
        for k in 0..whole(n) {
            let (seen, right) = towards_in_line(position, p.vec(k));
            self.put(k, &from_point(seen));
            self.right[k] = u32::from(right);
        }
    }

    #[inline(never)]
    fn of_spot(&mut self, position: [f32; 3], cone: Cone, n: usize, p: &Lanes<P>) {
        for k in 0..whole(n) {
            let (seen, right) = cone.sample_in_line(position, p.vec(k));
            self.put(k, &from_point(seen));
            self.pdf[k] = P::select(seen.2 > P::zero(), P::one(), P::zero());
            self.right[k] = u32::from(right);
        }
    }

    /// The same for all.
    #[inline(never)]
    fn of_all(&mut self, sample: &EmitterSample<P>, n: usize) {
        let sample = *sample;
        for k in 0..whole(n) {
            self.put(k, &sample);
        }
    }

    #[inline(never)]
    fn of_sky(&mut self, e: &Constant, n: usize, scene: &Scene, [a, b]: [&Lane<P>; 2]) {
        let lights = scene.lights();
        for k in 0..whole(n) {
            let sample = e.sample(lights, Vec3::zero(), [a[k], b[k]]);
            self.put(k, &sample.unwrap_or(nothing()));
        }
    }

    #[inline(never)]
    fn of_envmap(&mut self, e: &Envmap, n: usize, draws: &Draws, a: &Lane<P>) {
        for k in 0..whole(n) {
            let edges = [draws.edges[0][k], draws.edges[1][k]];
            let at = (draws.cell[k], edges);
            let (d, pdf, uv) = e.draw_place(at, a[k].to_f64(), draws.y[k], &draws.local(k));
            self.put(k, &e.sampled(d, pdf, uv));
        }
    }
}

impl Draws {
    fn zero() -> Self {
        let none = Lane::zero();
        Self {
            band: Lane::zero(),
            cover: none,
            before: none,
            rows: [none; 2],
            lines: [none; 2],
            corners: [[none; 2]; 2],
            y: none,
            cell: none,
            edges: [none; 2],
            searches: Searches::new(),
            target: none,
        }
    }

    #[inline(always)]
    fn local(&self, k: usize) -> LocalSums<f64> {
        let [[a, b], [c, d]] = &self.corners;
        LocalSums {
            before: self.before[k],
            rows: [self.rows[0][k], self.rows[1][k]],
            lines: [self.lines[0][k], self.lines[1][k]],
            corners: [[a[k], b[k]], [c[k], d[k]]],
        }
    }

    /// Bands, latitudes and cells: looked up one by one, between what is done in vectors. All searches take their steps
    /// together, so that none waits for what another reads.
    #[inline(never)]
    fn find<P: Float>(&mut self, e: &Envmap, n: usize, [a, b]: [&Lane<P>; 2]) {
        let n = n.min(WAVE_SIZE);
        for k in 0..n {
            self.searches.put(k, e.bands_left(b[k].to_f64()));
        }
        (self.searches).run(n, |k, band| e.is_above(band, b[k].to_f64()));
        for k in 0..n {
            let band = self.searches.found(k);
            let (around, cover) = e.draw_band(band);
            self.band[k] = band as u32;
            (self.cover[k], self.before[k]) = (cover, around.before);
            (self.rows[0][k], self.rows[1][k]) = (around.rows[0], around.rows[1]);
        }
        for k in 0..whole(n) {
            self.y[k] = e.draw_latitude(self.cover[k], b[k].to_f64(), &self.local(k));
        }
        for k in 0..n {
            let (range, target) = e.cells_left(self.band[k] as usize, a[k].to_f64(), self.y[k]);
            self.searches.put(k, range);
            self.target[k] = target;
        }
        let (band, y, target) = (&self.band, &self.y, &self.target);
        (self.searches).run(n, |k, cell| {
            e.is_before([band[k] as usize, cell], y[k], target[k])
        });
        for k in 0..n {
            let cell = self.searches.found(k);
            let (local, edges) = e.draw_cell([self.band[k] as usize, cell]);
            self.cell[k] = cell as f64;
            for side in 0..2 {
                self.edges[side][k] = edges[side];
                self.lines[side][k] = local.lines[side];
                for along in 0..2 {
                    self.corners[side][along][k] = local.corners[side][along];
                }
            }
        }
    }
}

/// Paths that leave the scene.
pub struct Leaving<P> {
    /// Which.
    pub paths: Vec<usize>,
    lanes: Box<Skies<P>>,
}

lanes! {
    /// Where paths meet an environment map.
    Skies {
        d: Lanes<P>,
        u: Lane<P>,
        v: Lane<P>,
        h: Lane<P>,
        band: Lane<u32>,
        cell: Lane<u32>,
        fx: Lane<P>,
        above: Lane<f64>,
        below: Lane<f64>,
        upper_left: Lane<f64>,
        upper_right: Lane<f64>,
        lower_left: Lane<f64>,
        lower_right: Lane<f64>,
        /// Density of the direction the path had.
        pdf_bsdf: Lane<P>,
        /// Of light that is found.
        weight: Lane<P>,
        /// The light of a lobe.
        falloff: Lane<P>,
    }
}

impl<P: Float> Leaving<P> {
    /// Without paths.
    pub fn new() -> Self {
        Self {
            paths: Vec::with_capacity(WAVE_SIZE),
            lanes: Box::new(Skies::zero()),
        }
    }

    /// What [`crate::integrator::vertex::light::find_light`] finds where `paths`, with these directions, leave towards
    /// an environment map with their `depth`-th edge, where it has this `share` of samples. Calls `put` with each path.
    #[inline(always)]
    pub fn meet<S: Strategy>(
        &mut self,
        e: &Envmap,
        theta: &Theta<P>,
        lookups: &mut Lookups<P>,
        (d, pdf): (&Lanes<P>, &Lane<P>),
        (depth, share): (u32, P),
        mut put: impl FnMut(usize, Met<P>, Rgb<P>),
    ) {
        let (paths, at) = (&self.paths, &mut *self.lanes);
        for (k, &i) in paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            at.d.put_vec(k, d.vec(i));
            at.pdf_bsdf[k] = pdf[i];
        }
        at.find(e, paths.len());
        if may_have_rival::<S>(depth) {
            at.weigh::<S>(e, paths.len(), (depth, share));
        } else {
            at.weight = [P::one(); WAVE_SIZE];
        }
        let image = image(e.radiance());
        if let Some(image) = image {
            lookups.find(image, paths.len(), &at.u, &at.v);
        }
        for (k, &i) in paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            if !counts_hits::<S, P>(at.pdf_bsdf[k]) {
                continue;
            }
            let emission = e.emission(Vec2::new(at.u[k], at.v[k]));
            let weight = at.weight[k];
            let le = match image {
                Some(image) => {
                    let radiance = lookups.value(theta, image, k);
                    e.scaled(theta, radiance * emission.falloff)
                }
                None => e.eval_in_line(theta, &emission),
            };
            put(i, Met { emission, weight }, le);
        }
    }
}

impl<P: Float> Leaving<P> {
    /// [`Leaving::meet`] of a lobe.
    #[inline(always)]
    pub fn meet_lobe<S: Strategy>(
        &mut self,
        e: &Vmf,
        theta: &Theta<P>,
        (d, pdf): (&Lanes<P>, &Lane<P>),
        light: (u32, P),
        mut put: impl FnMut(usize, Met<P>, Rgb<P>),
    ) {
        let (paths, at) = (&self.paths, &mut *self.lanes);
        for (k, &i) in paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            at.d.put_vec(k, d.vec(i));
            at.pdf_bsdf[k] = pdf[i];
        }
        at.see_lobe::<S>(e, paths.len(), light);
        for (k, &i) in paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            if counts_hits::<S, P>(at.pdf_bsdf[k]) {
                let emission = Emission {
                    uv: Vec2::zero(),
                    falloff: at.falloff[k],
                };
                let weight = at.weight[k];
                let le = e.eval_in_line(theta, &emission);
                put(i, Met { emission, weight }, le);
            }
        }
    }
}

/// What [`Leaving::meet`] finds of `paths` that leave towards an even environment, where their directions had these densities.
#[inline(always)]
pub fn meet_evenly<P: Float, S: Strategy>(
    e: &Constant,
    theta: &Theta<P>,
    paths: &[usize],
    pdf: &Lane<P>,
    (depth, share): (u32, P),
    mut put: impl FnMut(usize, Met<P>, Rgb<P>),
) {
    let emission = Emission::whole();
    let le = e.eval_in_line(theta, &emission);
    for &i in paths {
        if !counts_hits::<S, P>(pdf[i]) {
            continue;
        }
        let weight = met_weight::<S, P>(pdf[i], Constant::density(), share);
        let weight = P::select(has_rival::<S, P>(depth, pdf[i]), weight, P::one());
        put(i, Met { emission, weight }, le);
    }
}

impl<P: Float> Skies<P> {
    #[inline(always)]
    fn spot(&self, k: usize) -> MapPoint<P> {
        MapPoint {
            uv: Vec2::new(self.u[k], self.v[k]),
            h: self.h[k],
        }
    }

    #[inline(never)]
    fn find(&mut self, e: &Envmap, n: usize) {
        for k in 0..whole(n) {
            let spot = e.spot(self.d.vec(k));
            let ([band, cell], fx) = e.cell(&spot);
            (self.u[k], self.v[k], self.h[k]) = (spot.uv.x, spot.uv.y, spot.h);
            (self.band[k], self.cell[k], self.fx[k]) = (band, cell, fx);
        }
    }

    #[inline(never)]
    fn see_lobe<S: Strategy>(&mut self, e: &Vmf, n: usize, (depth, share): (u32, P)) {
        for k in 0..whole(n) {
            let (emission, pdf) = e.seen_in_line(self.d.vec(k));
            let pdf_bsdf = self.pdf_bsdf[k];
            let weight = met_weight::<S, P>(pdf_bsdf, pdf, share);
            let sampled = has_rival::<S, P>(depth, pdf_bsdf);
            self.falloff[k] = emission.falloff;
            self.weight[k] = P::select(sampled, weight, P::one());
        }
    }

    #[inline(never)]
    fn weigh<S: Strategy>(&mut self, e: &Envmap, n: usize, (depth, share): (u32, P)) {
        for k in 0..n.min(WAVE_SIZE) {
            let ([above, below], [[a, b], [c, d]]) = e.corners([self.band[k], self.cell[k]]);
            (self.above[k], self.below[k]) = (above, below);
            (self.upper_left[k], self.upper_right[k]) = (a, b);
            (self.lower_left[k], self.lower_right[k]) = (c, d);
        }
        for k in 0..whole(n) {
            let corners = [
                [self.upper_left[k], self.upper_right[k]],
                [self.lower_left[k], self.lower_right[k]],
            ];
            let edges = [self.above[k], self.below[k]];
            let pdf = Envmap::density_in(&self.spot(k), self.fx[k], edges, corners);
            let pdf_bsdf = self.pdf_bsdf[k];
            let weight = met_weight::<S, P>(pdf_bsdf, pdf, share);
            let sampled = has_rival::<S, P>(depth, pdf_bsdf);
            self.weight[k] = P::select(sampled, weight, P::one());
        }
    }
}

/// Samples of all plain balls that paths have chosen, whichever they are.
#[inline(never)]
pub fn sample_balls<P: Float>(
    scene: &Scene,
    (p, [a, b]): (&Lanes<P>, [&Lane<P>; 2]),
    n: usize,
    lights: &mut Lights<P>,
) {
    // A radius of zero is no sphere.
    let (mut center, mut radius) = (Lanes::<f32>::zero(), Lane::<f32>::zero());
    let mut surfaces = Lane::<u32>::zero();
    let mut any = false;
    for i in 0..n.min(WAVE_SIZE) {
        if let AnyEmitter::Area(area) = &scene.emitters()[lights.emitter[i] as usize]
            && let Some((at, r)) = even_ball(scene, area)
        {
            center.put_vec(i, at.into());
            radius[i] = r;
            surfaces[i] = scene.lights().surface(area.shape, 0);
            any = true;
        }
    }
    if !any {
        return;
    }
    for i in 0..whole(n) {
        let center = center.vec(i).to_array();
        let seen = sample_cone(center, radius[i], p.vec(i), [a[i], b[i]]);
        let sample = seen.and_then(|s| Area::facing(0.0, surfaces[i], s));
        lights.put(
            i,
            (lights.emitter[i], lights.kept[i]),
            lights.share[i],
            sample,
        );
    }
}

/// The radiance of samples of emitters that send the same everywhere, without a branch where there are few of them. Which
/// others there are.
#[inline(never)]
pub fn constant_radiances<P: Float>(
    theta: &Theta<P>,
    emitters: &[AnyEmitter],
    n: usize,
    lights: &mut Lights<P>,
) -> ([usize; WAVE_SIZE], usize) {
    let mut waits = Lane::<u32>::zero();
    for i in 0..n.min(WAVE_SIZE) {
        waits[i] = u32::from(lights.pdf[i] > P::zero());
    }
    let few = emitters.len() <= FEW;
    for (index, e) in (0..).zip(emitters).take(FEW) {
        if few && matches!(e.radiance(), Texture::Constant(_)) && e.scale().is_none() {
            let radiance: Rgb<P> = e.radiance().rgb(theta, Vec2::zero());
            for i in 0..whole(n) {
                let own = lights.emitter[i] == index;
                let le = Rgb::select(own, radiance * lights.falloff[i], lights.le.rgb(i));
                lights.le.put_rgb(i, le);
                waits[i] &= u32::from(!own);
            }
        }
    }
    let (mut others, mut rest) = ([0; WAVE_SIZE], 0);
    for i in 0..n.min(WAVE_SIZE) {
        others[rest % WAVE_SIZE] = i;
        rest += waits[i] as usize;
    }
    (others, rest)
}

/// The radiance of samples of emitters with images, one image after the other. Those of the `others` that are left.
#[inline(never)]
pub fn image_radiances<P: Float>(
    theta: &Theta<P>,
    emitters: &[AnyEmitter],
    lookups: &mut Lookups<P>,
    lights: &mut Lights<P>,
    (others, rest): (&mut [usize; WAVE_SIZE], usize),
) -> usize {
    let mut left = rest;
    for (index, e) in (0..).zip(emitters).take(MOST_TOGETHER) {
        let Some(image) = image(e.radiance()).filter(|_| left > 0) else {
            continue;
        };
        let (mut u, mut v) = (Lane::<P>::zero(), Lane::<P>::zero());
        let (mut own, mut n, mut kept) = ([0; WAVE_SIZE], 0, 0);
        for k in 0..left {
            let i = others[k];
            let is_own = lights.emitter[i] == index;
            (own[n % WAVE_SIZE], others[kept % WAVE_SIZE]) = (i, i);
            (u[n % WAVE_SIZE], v[n % WAVE_SIZE]) = (lights.u[i], lights.v[i]);
            n += usize::from(is_own);
            kept += usize::from(!is_own);
        }
        left = kept;
        lookups.find(image, n, &u, &v);
        lookups.expect(theta, image, n, 3);
        for (k, &i) in own[..n].iter().enumerate() {
            let radiance = lookups.value(theta, image, k);
            let le = e.scaled(theta, radiance * lights.falloff[i]);
            lights.le.put_rgb(i, le);
        }
    }
    left
}

/// Forgets the densities of scattered directions where nothing scattered meets the light that is sampled.
#[inline(never)]
pub fn leave_deltas<P: Float>(emitters: &[AnyEmitter], n: usize, lights: &mut Lights<P>) {
    // A bit for each of the first emitters.
    let mut deltas = 0u64;
    for (index, e) in emitters.iter().enumerate().take(64) {
        deltas |= u64::from(e.is_delta()) << index;
    }
    for i in 0..whole(n) {
        let index = lights.emitter[i];
        let delta = (deltas >> (index % 64) & 1 != 0) & (index < 64);
        lights.pdf_bsdf[i] = P::select(delta, P::zero(), lights.pdf_bsdf[i]);
    }
    if emitters.len() > 64 {
        for i in 0..n.min(WAVE_SIZE) {
            if emitters[lights.emitter[i] as usize].is_delta() {
                lights.pdf_bsdf[i] = P::zero();
            }
        }
    }
}
