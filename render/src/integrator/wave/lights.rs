//! Many paths at one emitter, at once: samples of it, and environments that paths leave the scene towards.

use ad_core::{Float, Vec2, Vec3};

use super::lanes::{Field, Lane, Lanes, WAVE_SIZE, lanes, whole};
use super::lookups::{Lookups, image};
use crate::emitter::{
    AnyEmitter, Area, Emission, Emitter, EmitterSample, Envmap, LocalSums, MapPoint,
};
use crate::estimator::Strategy;
use crate::integrator::vertex::light::{Met, counts_hits, has_rival, may_have_rival, met_weight};
use crate::math::{NOWHERE, Rgb};
use crate::params::Theta;
use crate::scene::Scene;
use crate::shape::{AnyShape, Rectangle, Shape};

/// Emitters beyond so many are sampled one by one: few paths of a wave meet at one of them.
pub const MOST_TOGETHER: usize = 16;

/// What paths that choose an emitter do together.
#[derive(Clone, Copy, Debug)]
pub enum Together<'a> {
    /// A rectangle that sends the same everywhere, and the surface it lies on.
    Rectangle(Rectangle, u32),
    /// An environment map.
    Envmap(&'a Envmap),
}

/// What paths that choose this emitter may do together.
pub fn together<'a>(scene: &'a Scene, emitter: &'a AnyEmitter) -> Option<Together<'a>> {
    match emitter {
        AnyEmitter::Area(area) if area.exponent == 0.0 => match scene.shapes()[area.shape as usize]
        {
            AnyShape::Rectangle(rectangle) => {
                let surface = scene.lights().surface(area.shape, 0);
                Some(Together::Rectangle(rectangle, surface))
            }
            _ => None,
        },
        AnyEmitter::Envmap(e) if e.is_known() => Some(Together::Envmap(e)),
        _ => None,
    }
}

lanes! {
    /// Samples of one emitter.
    Samples {
        /// Reference point.
        p: Lanes<P>,
        d: Lanes<P>,
        distance: Lane<P>,
        /// Zero if there is no sample.
        pdf: Lane<P>,
        falloff: Lane<P>,
        u: Lane<P>,
        v: Lane<P>,
    }
}

/// Samples of one emitter for several paths.
pub struct Group<P> {
    /// The paths.
    pub paths: Vec<usize>,
    numbers: [Lane<P>; 2],
    samples: Box<Samples<P>>,
    draws: Box<Draws>,
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
}

impl<P: Float> Group<P> {
    /// Without paths.
    pub fn new() -> Self {
        Self {
            paths: Vec::with_capacity(WAVE_SIZE),
            numbers: [Lane::zero(); 2],
            samples: Box::new(Samples::zero()),
            draws: Box::new(Draws::zero()),
        }
    }

    /// Samples an emitter for `paths`, which stand at `p`, with two random numbers of each, and calls `put` with each
    /// path and its sample.
    #[inline(always)]
    pub fn sample(
        &mut self,
        emitter: Together,
        p: &Lanes<P>,
        [a, b]: [&Lane<P>; 2],
        mut put: impl FnMut(usize, Option<EmitterSample<P>>),
    ) {
        let n = self.paths.len();
        for (k, &i) in self.paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            self.samples.p.put_vec(k, p.vec(i));
            (self.numbers[0][k], self.numbers[1][k]) = (a[i], b[i]);
        }
        let surface = match emitter {
            Together::Rectangle(rectangle, surface) => {
                self.samples.of_rectangle(rectangle, n, &self.numbers);
                surface
            }
            Together::Envmap(e) => {
                self.draws.find(e, n, &self.numbers);
                self.samples.of_envmap(e, n, &self.draws, &self.numbers[0]);
                NOWHERE
            }
        };
        let s = &*self.samples;
        for (k, &i) in self.paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            let sample = EmitterSample {
                d: s.d.vec(k),
                distance: s.distance[k],
                normals: [Vec3::zero(); 2],
                surface,
                prim: 0,
                pdf: s.pdf[k],
                emission: Emission {
                    uv: Vec2::new(s.u[k], s.v[k]),
                    falloff: s.falloff[k],
                },
            };
            put(i, (s.pdf[k] > P::zero()).then_some(sample));
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
    }

    #[inline(never)]
    fn of_rectangle(&mut self, rectangle: Rectangle, n: usize, [a, b]: &[Lane<P>; 2]) {
        let (zero, none) = (P::zero(), Vec3::zero());
        for k in 0..whole(n) {
            let seen = rectangle.sample(self.p.vec(k), [a[k], b[k]]);
            let sample = seen.and_then(|s| Area::facing(0.0, NOWHERE, s));
            let nothing = EmitterSample {
                d: none,
                distance: zero,
                normals: [none; 2],
                surface: NOWHERE,
                prim: 0,
                pdf: zero,
                emission: Emission {
                    uv: Vec2::zero(),
                    falloff: zero,
                },
            };
            self.put(k, &sample.unwrap_or(nothing));
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

    /// Bands, latitudes and cells: looked up one by one, between what is done in vectors.
    #[inline(never)]
    fn find<P: Float>(&mut self, e: &Envmap, n: usize, [a, b]: &[Lane<P>; 2]) {
        for k in 0..n.min(WAVE_SIZE) {
            let (band, around, cover) = e.draw_band(b[k].to_f64());
            self.band[k] = band as u32;
            (self.cover[k], self.before[k]) = (cover, around.before);
            (self.rows[0][k], self.rows[1][k]) = (around.rows[0], around.rows[1]);
        }
        for k in 0..whole(n) {
            self.y[k] = e.draw_latitude(self.cover[k], b[k].to_f64(), &self.local(k));
        }
        for k in 0..n.min(WAVE_SIZE) {
            let (cell, local, edges) = e.draw_cell(self.band[k] as usize, a[k].to_f64(), self.y[k]);
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
