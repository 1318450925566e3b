//! Tiles of an image and their samples: single paths in lockstep, or waves.

use std::ops::Range;

use ad_core::{Float, Real, array};

use super::lockstep::{self, GROUP};
use super::path::{Context, Walk};
use super::record::Observer;
use super::wave::{Log, Wave};
use crate::camera::CameraSample;
use crate::estimator::{Geometry, Sampling, Strategy};
use crate::math::{Ray, Rgb};
use crate::sampler::{Points, Purpose, Sampler};
use crate::scene::Scene;

/// Tiles are squares of this many pixels.
pub const TILE: u32 = 16;

/// A rectangle of pixels, `[x0, y0, x1, y1)` within the crop window.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tile {
    pub x: Range32,
    pub y: Range32,
}

/// Half-open range that is `Copy`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Range32 {
    pub start: u32,
    pub end: u32,
}

/// The tiles of an image, row by row.
pub(super) fn tiles(width: u32, height: u32) -> Vec<Tile> {
    let cuts = |n: u32| {
        (0..n.div_ceil(TILE)).map(move |i| Range32 {
            start: i * TILE,
            end: (i * TILE + TILE).min(n),
        })
    };
    cuts(height)
        .flat_map(|y| cuts(width).map(move |x| Tile { x, y }))
        .collect()
}

/// The number of a pixel of the crop window, row by row.
#[inline]
pub(super) fn place(scene: &Scene, [x, y]: [u32; 2]) -> usize {
    y as usize * scene.film.crop_size[0] as usize + x as usize
}

/// A sample of a pixel of the crop window.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub pixel: [u32; 2],
    pub index: u64,
    /// How many the pixel has.
    pub count: u64,
    /// What the filter makes of it: one, unless that is negative in places.
    pub weight: f64,
}

impl Sample {
    /// What it counts in the mean of its pixel.
    #[inline]
    pub fn scale(&self) -> f64 {
        self.weight / self.count as f64
    }

    /// The pixel's entry of an image.
    #[inline]
    pub fn of_image<P: Float>(&self, image: &[f32], scene: &Scene) -> Rgb<P> {
        let i = place(scene, self.pixel) * 3;
        Rgb::from(array(|c| P::from_f32(image[i + c])))
    }
}

/// The start of sample `index` of the pixel `(x, y)` of the crop window.
#[inline(always)]
pub(super) fn start<R: Real, S: Strategy, X: Sampler>(
    scene: &Scene,
    points: Points,
    seed: u64,
    pixel: [u32; 2],
    index: u64,
) -> Walk<R, S, X> {
    let (at, sampler) = spot(scene, points, seed, pixel, index);
    let ray = scene.camera.ray_of(&at);
    Walk::new(Ray::<Geometry<S, R>>::lift(ray), sampler)
}

/// A place on the lens, if there is one, by numbers that nothing else in a stream is made of.
pub(super) fn on_lens<P: Float, X: Sampler>(scene: &Scene, mut sampler: X) -> [P; 2] {
    if !scene.camera.has_lens() {
        return [P::zero(); 2];
    }
    sampler.seek(Purpose::Lens.at(1));
    sampler.next_2d()
}

/// The point of the image that sample `index` of the pixel `(x, y)` of the crop window sees, with a place on the lens
/// if there is one, and the numbers of the path to come.
#[inline(always)]
pub(super) fn spot<P: Float, X: Sampler>(
    scene: &Scene,
    points: Points,
    seed: u64,
    pixel: [u32; 2],
    index: u64,
) -> (CameraSample<P>, X) {
    let (pixel, mut sampler): (_, X) = stream(scene, points, seed, pixel, index);
    let film = scene.film.point_in(pixel, sampler.next_2d::<P>());
    let lens = if scene.camera.has_lens() {
        sampler.next_2d::<P>()
    } else {
        [P::zero(); 2]
    };
    (CameraSample { film, lens }, sampler)
}

/// The pixel on the full film, and all numbers of a sample of it.
#[inline(always)]
fn stream<X: Sampler>(
    scene: &Scene,
    points: Points,
    seed: u64,
    pixel: [u32; 2],
    index: u64,
) -> ([u32; 2], X) {
    let (at, number) = scene.film.full_pixel(pixel);
    let mut sampler = X::spread(points, seed, number, index);
    if scene.camera.has_lens() {
        sampler.seek(Purpose::Lens.at(1));
    }
    (at, sampler)
}

/// The point of the image that a sample of a pass sees, and the place on the lens.
pub(super) fn camera_sample<P: Float, X: Sampler>(
    scene: &Scene,
    points: Points,
    seed: u64,
    at: &Sample,
) -> CameraSample<P> {
    spot::<P, X>(scene, points, seed, at.pixel, at.index).0
}

/// What a filter that is negative in places makes of the sample that [`spot`] places.
fn weight<P: Float, X: Sampler>(
    scene: &Scene,
    points: Points,
    seed: u64,
    pixel: [u32; 2],
    index: u64,
) -> f64 {
    let filter = &scene.film.filter;
    let (_, mut sampler): (_, X) = stream(scene, points, seed, pixel, index);
    filter.weight(filter.sample(sampler.next_2d::<P>()))
}

impl Tile {
    /// Number of pixels.
    pub(super) fn pixels(&self) -> usize {
        ((self.x.end - self.x.start) * (self.y.end - self.y.start)) as usize
    }

    /// The pixel with index `i` within the tile, row by row.
    #[inline]
    pub(super) fn pixel(&self, i: usize) -> [u32; 2] {
        let width = self.x.end - self.x.start;
        let i = i as u32;
        [self.x.start + i % width, self.y.start + i / width]
    }

    /// The samples `samples` of all pixels, as the scene shares them, with the index of their pixel within the tile.
    pub(super) fn samples<'a, P: Float, X: Sampler>(
        &'a self,
        scene: &'a Scene,
        points: Points,
        seed: u64,
        samples: &'a Range<u64>,
    ) -> impl Iterator<Item = (usize, Sample)> + 'a {
        let weighted = scene.film.filter.is_weighted();
        (0..self.pixels()).flat_map(move |at| {
            let pixel = self.pixel(at);
            let samples = scene.pixel_shares().samples(place(scene, pixel), samples);
            let count = samples.end - samples.start;
            samples.map(move |index| {
                let sample = Sample {
                    pixel,
                    index,
                    count,
                    weight: if weighted {
                        weight::<P, X>(scene, points, seed, pixel, index)
                    } else {
                        1.0
                    },
                };
                (at, sample)
            })
        })
    }

    /// Follows the samples of all pixels with this seed and these numbers, as the scene shares them, and calls `done` with the pixel's
    /// index within the tile, the sample, the radiance and the observer of each, in order. Samples that were cut short
    /// are left out, and those after them.
    pub(super) fn trace<R: Real, S: Strategy, X: Sampler, O: Observer<R>>(
        &self,
        context: &Context<R>,
        (seed, samples): (u64, &Range<u64>),
        paths: &mut Paths<R, S, X, O>,
        mut done: impl FnMut(usize, Sample, Rgb<R>, &mut O),
    ) {
        let (scene, points) = (context.scene, context.settings.points);
        let mut all = self.samples::<R::Primal, X>(scene, points, seed, samples);
        loop {
            paths.which.clear();
            paths.which.extend(all.by_ref().take(GROUP));
            if paths.which.is_empty() {
                break;
            }
            paths.walks.clear();
            paths.walks.extend(
                (paths.which.iter())
                    .map(|(_, sample)| start(scene, points, seed, sample.pixel, sample.index)),
            );
            let observers = &mut paths.observers;
            lockstep::trace(
                scene,
                &S::Bsdf::geometry(context.theta),
                context.settings.hides(1),
                context.progress,
                &mut paths.walks,
                |i, walk, hit, visible| {
                    walk.step(context, hit, visible, &mut observers[i]);
                },
            );
            if context.progress.cancelled() {
                break;
            }
            let found = paths.walks.iter().zip(&mut paths.observers);
            for (&(at, sample), (walk, observer)) in paths.which.iter().zip(found) {
                done(at, sample, walk.l, observer);
            }
        }
    }

    /// The same by waves, for strategies and contexts that these take. `begin` is called before each crowd of paths with its
    /// samples, `done` after it with the radiance of each.
    pub(super) fn trace_waves<P: Float, S: Strategy, X: Sampler, L: Log<P>>(
        &self,
        context: &Context<P>,
        (seed, samples): (u64, &Range<u64>),
        wave: &mut Wave<P, X>,
        log: &mut L,
        mut begin: impl FnMut(&mut L, &[(usize, Sample)]),
        mut done: impl FnMut(&mut L, &[(usize, Sample)], &[Rgb<P>]),
    ) {
        let (scene, points) = (context.scene, context.settings.points);
        let mut all = self.samples::<P, X>(scene, points, seed, samples);
        let mut which = Vec::with_capacity(L::CROWD);
        loop {
            which.clear();
            which.extend(all.by_ref().take(L::CROWD));
            if which.is_empty() {
                break;
            }
            begin(log, &which);
            let begin = |i: usize| {
                let (_, sample) = &which[i];
                stream(scene, points, seed, sample.pixel, sample.index)
            };
            wave.trace::<S, L>(context, which.len(), begin, log);
            if context.progress.cancelled() {
                break;
            }
            done(log, &which, &wave.l[..which.len()]);
        }
    }
}

/// Room for the paths of one thread.
pub(super) struct Paths<R: Real, S: Strategy, X: Sampler, O> {
    /// Index within the tile of each one's pixel, and its sample.
    which: Vec<(usize, Sample)>,
    walks: Vec<Walk<R, S, X>>,
    observers: Vec<O>,
}

impl<R: Real, S: Strategy, X: Sampler, O: Clone> Paths<R, S, X, O> {
    /// Each path is watched by an observer like this one.
    pub(super) fn new(observer: O) -> Self {
        Self {
            which: Vec::with_capacity(GROUP),
            walks: Vec::with_capacity(GROUP),
            observers: vec![observer; GROUP],
        }
    }
}
