//! Images: paths over all pixels, in tiles.

use std::ops::Range;

use ad_core::{Dual, Float, Real, array};

use super::active::Active;
use super::batch::{self, PATHS};
use super::pass::{Integral, Pass, Question, every};
use super::path::{Context, Geometry, Walk, shifts};
use super::record::Observer;
use super::record::ends::Tangents;
use super::wave::{self, Log, Record, WIDTH, Wave};
use crate::error::RenderError;
use crate::estimator::{self, Strategy, Unbiased};
use crate::film::Image;
use crate::math::{Ray, Rgb};
use crate::parallel;
use crate::params::Theta;
use crate::sampler::{Points, Sampler};
use crate::scene::{Scene, Settings};

/// Tiles are squares of this many pixels.
pub const TILE: u32 = 16;

/// How a long computation reports, and whether it is wanted at all.
///
/// Computations ask many times a second whether they are cancelled, between the edges of paths as well. One that was
/// must stay so: what has been cut short is recognised by asking again afterwards.
pub trait Progress: Sync {
    /// `n` more units of work are done.
    fn advance(&self, _n: u64) {}
    /// Whether to stop early.
    fn cancelled(&self) -> bool {
        false
    }
}

impl Progress for () {}

impl std::fmt::Debug for dyn Progress + '_ {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let state = if self.cancelled() {
            "cancelled"
        } else {
            "wanted"
        };
        f.write_str(state)
    }
}

/// Samples that were not finite. They are left out of the sums, counted and reported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NonFinite {
    /// How many.
    pub count: u64,
    /// Pixel and sample index of the first one.
    pub first: Option<(u64, u64)>,
}

impl NonFinite {
    pub(super) fn add(&mut self, pixel: u64, sample: u64) {
        self.count += 1;
        self.first.get_or_insert((pixel, sample));
    }

    /// Joins the counts of two disjoint sets of samples; `self` comes first.
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.first = self.first.or(other.first);
    }
}

/// A scalar as a list of numbers: its value and its tangents.
pub trait Components: Real {
    /// How many numbers.
    const COUNT: usize;
    /// How often tangents have tangents: zero without any.
    const ORDER: u32;
    /// Number `k`; 0 is the value.
    fn component(&self, k: usize) -> f64;
}

macro_rules! single_component {
    ($($float:ty),*) => {$(
        impl Components for $float {
            const COUNT: usize = 1;
            const ORDER: u32 = 0;
            #[inline]
            fn component(&self, _k: usize) -> f64 {
                self.to_f64()
            }
        }
    )*};
}
single_component!(f32, f64);

/// The components of the value, then those of each tangent.
impl<P: Components, const N: usize> Components for Dual<P, N> {
    const COUNT: usize = P::COUNT * (N + 1);
    const ORDER: u32 = P::ORDER + 1;
    #[inline]
    fn component(&self, k: usize) -> f64 {
        let (outer, inner) = (k / P::COUNT, k % P::COUNT);
        if outer == 0 {
            self.re.component(inner)
        } else {
            self.eps[outer - 1].component(inner)
        }
    }
}

/// Sums over samples, per pixel.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Samples per pixel in the sums: where pixels have more or fewer, they weigh as much as these.
    pub samples: u64,
    /// `[component][height][width][3]`: the image, then one derivative image per tangent.
    pub sums: Vec<Vec<f64>>,
    /// What went wrong.
    pub non_finite: NonFinite,
    /// Whether it was stopped early; the sums are then incomplete.
    pub cancelled: bool,
}

impl Rendering {
    /// Mean over the samples of component `k`: 0 is the image, `k` the derivative along tangent `k - 1`.
    pub fn image(&self, k: usize) -> Image {
        let mut image = Image::new(self.width, self.height);
        let scale = 1.0 / self.samples.max(1) as f64;
        for (out, sum) in image.data.iter_mut().zip(&self.sums[k]) {
            *out = (sum * scale) as f32;
        }
        image
    }

    /// Mean over pixels of component `k`, per channel, in full precision.
    pub fn mean(&self, k: usize) -> [f64; 3] {
        let n = self.samples.max(1) as f64 * (self.width * self.height).max(1) as f64;
        let mut sum = [0.0; 3];
        for p in self.sums[k].chunks_exact(3) {
            for c in 0..3 {
                sum[c] += p[c];
            }
        }
        sum.map(|s| s / n)
    }

    /// Adds further samples of the same image.
    pub fn merge(&mut self, other: &Self) {
        self.samples += other.samples;
        self.add(other);
    }

    /// Adds another part of the light, of as many samples.
    fn add(&mut self, other: &Self) {
        self.non_finite.merge(&other.non_finite);
        self.cancelled |= other.cancelled;
        for (a, b) in self.sums.iter_mut().zip(&other.sums) {
            for (a, b) in a.iter_mut().zip(b) {
                *a += b;
            }
        }
    }
}

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
}

impl Sample {
    /// What it counts in the mean of its pixel.
    #[inline]
    pub fn scale(&self) -> f64 {
        1.0 / self.count as f64
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
    let ([x, y], sampler) = spot(scene, points, seed, pixel, index);
    Walk::new(Ray::<Geometry<S, R>>::lift(scene.camera.ray(x, y)), sampler)
}

/// The point of the image that sample `index` of the pixel `(x, y)` of the crop window sees, and the numbers of the
/// path to come.
#[inline(always)]
fn spot<P: Float, X: Sampler>(
    scene: &Scene,
    points: Points,
    seed: u64,
    [x, y]: [u32; 2],
    index: u64,
) -> ([P; 2], X) {
    let film = &scene.film;
    // Counted on the full film, so that a crop shows the same samples.
    let [px, py] = [x + film.crop_offset[0], y + film.crop_offset[1]];
    let pixel = u64::from(py) * u64::from(film.size[0]) + u64::from(px);
    let mut sampler = X::spread(points, seed, pixel, index);
    let [dx, dy] = film.filter.sample(sampler.next_2d::<P>());
    let centre = |p: u32| P::of(f64::from(p) + 0.5);
    ([centre(px) + dx, centre(py) + dy], sampler)
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
    fn samples<'a>(
        &'a self,
        scene: &'a Scene,
        samples: &'a Range<u64>,
    ) -> impl Iterator<Item = (usize, Sample)> + 'a {
        (0..self.pixels()).flat_map(move |at| {
            let pixel = self.pixel(at);
            let samples = scene.pixel_shares().samples(place(scene, pixel), samples);
            let count = samples.end - samples.start;
            samples.map(move |index| {
                let sample = Sample {
                    pixel,
                    index,
                    count,
                };
                (at, sample)
            })
        })
    }

    /// Follows the samples `samples` of all pixels, as the scene shares them, and calls `done` with the pixel's
    /// index within the tile, the sample, the radiance and the observer of each, in order. Samples that were cut short
    /// are left out, and those after them.
    pub(super) fn trace<R: Real, S: Strategy, X: Sampler, O: Observer<R>>(
        &self,
        context: &Context<R>,
        seed: u64,
        samples: &Range<u64>,
        paths: &mut Paths<R, S, X, O>,
        mut done: impl FnMut(usize, Sample, Rgb<R>, &mut O),
    ) {
        let scene = context.scene;
        let mut all = self.samples(scene, samples);
        loop {
            paths.which.clear();
            paths.which.extend(all.by_ref().take(PATHS));
            if paths.which.is_empty() {
                break;
            }
            let points = context.settings.points;
            paths.walks.clear();
            paths.walks.extend(
                (paths.which.iter())
                    .map(|(_, sample)| start(scene, points, seed, sample.pixel, sample.index)),
            );
            let observers = &mut paths.observers;
            batch::trace(
                scene,
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

    /// The same by waves, for strategies and contexts that these take. `begin` is called before each wave with its
    /// samples, `done` after it with the radiance of each.
    pub(super) fn trace_waves<P: Float, S: Strategy, X: Sampler, L: Log<P>>(
        &self,
        context: &Context<P>,
        seed: u64,
        samples: &Range<u64>,
        wave: &mut Wave<P, X>,
        log: &mut L,
        mut begin: impl FnMut(&mut L, &[(usize, Sample)]),
        mut done: impl FnMut(&mut L, &[(usize, Sample)], &[Rgb<P>]),
    ) {
        let (scene, points) = (context.scene, context.settings.points);
        let mut all = self.samples(scene, samples);
        let mut which = Vec::with_capacity(WIDTH);
        loop {
            which.clear();
            which.extend(all.by_ref().take(WIDTH));
            if which.is_empty() {
                break;
            }
            begin(log, &which);
            let spot = |i: usize| {
                let (_, sample) = &which[i];
                spot::<P, X>(scene, points, seed, sample.pixel, sample.index)
            };
            wave.trace::<S, L>(context, which.len(), spot, log);
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
            which: Vec::with_capacity(PATHS),
            walks: Vec::with_capacity(PATHS),
            observers: vec![observer; PATHS],
        }
    }
}

/// Renders the samples `samples` of every pixel with seed `seed`.
///
/// Over a dual number, the result holds the derivative images of its tangents as well (forward mode).
/// It depends on the arguments only, not on the number of threads.
///
/// # Errors
/// A strategy that is wrong in this scene ([`estimator::check`]) or for a parameter that moves
/// ([`estimator::check_parameter`]); none without tangents.
pub fn render<R: Components, S: Unbiased, X: Sampler>(
    scene: &Scene,
    theta: &Theta<R>,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Rendering, RenderError> {
    if !R::IS_PRIMAL {
        estimator::check::<S>(scene)?;
        for info in scene.params().infos() {
            if theta.moves(scene.params().handle(info)) {
                estimator::check_parameter::<S>(info)?;
            }
        }
    }
    Ok(unchecked::<R, S, X>(
        scene, theta, settings, seed, samples, progress,
    ))
}

/// [`render`] of what has been checked, or has no tangents.
pub(crate) fn unchecked<R: Components, S: Unbiased, X: Sampler>(
    scene: &Scene,
    theta: &Theta<R>,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Rendering {
    let pass = Pass {
        scene,
        theta,
        settings,
        caustics: settings.caustics_of::<S>(scene),
        seed,
        samples,
        progress,
    };
    let mut question = ImageOf {
        pass: &pass,
        sum: None,
    };
    every::<S::Runs, X>(pass.caustics, progress, &mut question);
    question
        .sum
        .unwrap_or_else(|| assemble(&pass, R::COUNT, &[]))
}

/// An image that is asked of every integral.
struct ImageOf<'a, R: Real> {
    pass: &'a Pass<'a, R>,
    sum: Option<Rendering>,
}

impl<R: Components, S: Strategy, X: Sampler> Question<S, X> for ImageOf<'_, R> {
    fn ask<I: Integral<S, X>>(&mut self, progress: &dyn Progress) {
        let part = I::image(&self.pass.reporting(progress));
        match &mut self.sum {
            None => self.sum = Some(part),
            Some(sum) => sum.add(&part),
        }
    }
}

/// `[component][height][width][3]` of a tile, added up, and what went wrong there; empty if it was cut short.
type TileSums = (Vec<f64>, NonFinite);

/// Whether a number has single precision.
pub(super) const fn is_single<P: Float>() -> bool {
    size_of::<P>() == size_of::<f32>()
}

/// The image by paths.
pub(super) fn of_paths<R: Components, S: Strategy, X: Sampler>(pass: &Pass<R>) -> Rendering {
    let tiles = tile_sums::<R, S, X>(pass);
    assemble(pass, R::COUNT, &tiles)
}

/// All tiles, row by row.
fn tile_sums<R: Components, S: Strategy, X: Sampler>(pass: &Pass<R>) -> Vec<TileSums> {
    let &Pass {
        scene,
        theta,
        seed,
        ref samples,
        progress,
        ..
    } = pass;
    let tiles = pass.tiles();
    let shifts = shifts::<R, S>(scene, theta);
    let context = Context {
        shifts: &shifts,
        ..pass.context()
    };
    let primal = theta.primal();
    let still = context.still(&primal);
    let infos = scene.params().infos().iter();
    let moving: Vec<_> = infos
        .filter(|info| theta.moves(scene.params().handle(info)))
        .collect();
    let active = Active::of(scene, &moving);
    let spp = samples.end.saturating_sub(samples.start) as f64;
    parallel::map(tiles.len(), |i| {
        let tile = &tiles[i];
        let pixels = tile.pixels();
        let mut sums = vec![
            0.0f64;
            if progress.cancelled() {
                0
            } else {
                R::COUNT * pixels * 3
            }
        ];
        let mut non_finite = NonFinite::default();
        if sums.is_empty() {
            return (sums, non_finite);
        }
        let mut add = |at: usize, sample: Sample, l: Rgb<R>| {
            if !l.is_finite() {
                non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                return;
            }
            // Sums as if there were as many samples of each pixel.
            let weight = spp * sample.scale();
            for k in 0..R::COUNT {
                for c in 0..3 {
                    sums[(k * pixels + at) * 3 + c] += weight * l[c].component(k);
                }
            }
        };
        // In double precision, single paths check on waves.
        if const { R::IS_PRIMAL && is_single::<R::Primal>() } {
            let mut wave = Wave::<R::Primal, X>::new();
            let begin = |_: &mut (), _: &[(usize, Sample)]| ();
            let done = |_: &mut (), which: &[(usize, Sample)], l: &[Rgb<R::Primal>]| {
                for (&(at, sample), &l) in which.iter().zip(l) {
                    add(at, sample, Rgb::lift(l));
                }
            };
            let log = &mut ();
            tile.trace_waves::<_, S, X, _>(&still, seed, samples, &mut wave, log, begin, done);
        } else if const { R::ORDER == 1 && is_single::<R::Primal>() && wave::fits::<S>() } {
            let mut wave = Wave::<R::Primal, X>::new();
            let mut record = Record::of::<S>(&active, scene, true);
            let mut lifted = Vec::with_capacity(WIDTH);
            let begin = |record: &mut Record<'_, _>, which: &[(usize, Sample)]| {
                record.start(which.iter().map(|_| Rgb::splat(R::Primal::one())));
            };
            let done =
                |record: &mut Record<'_, _>, which: &[(usize, Sample)], l: &[Rgb<R::Primal>]| {
                    lifted.clear();
                    lifted.extend(l.iter().map(|&l| Rgb::<R>::lift(l)));
                    let mut tangents = Tangents {
                        theta,
                        l: &mut lifted,
                    };
                    record.differentiate::<S>(l, &mut tangents);
                    for (&(at, sample), &l) in which.iter().zip(&lifted) {
                        add(at, sample, l);
                    }
                };
            let log = &mut record;
            tile.trace_waves::<_, S, X, _>(&still, seed, samples, &mut wave, log, begin, done);
        } else {
            let mut paths = Paths::<R, S, X, _>::new(());
            tile.trace(&context, seed, samples, &mut paths, |at, sample, l, _| {
                add(at, sample, l);
            });
        }
        if progress.cancelled() {
            return (Vec::new(), NonFinite::default());
        }
        progress.advance(pixels as u64);
        (sums, non_finite)
    })
}

/// The image made of its tiles.
fn assemble<R: Real>(pass: &Pass<R>, count: usize, parts: &[TileSums]) -> Rendering {
    let [width, height] = pass.scene.film.crop_size;
    let samples = &pass.samples;
    let tiles = pass.tiles();
    let mut out = Rendering {
        width: width as usize,
        height: height as usize,
        samples: samples.end.saturating_sub(samples.start),
        sums: vec![vec![0.0; width as usize * height as usize * 3]; count],
        non_finite: NonFinite::default(),
        cancelled: false,
    };
    for (tile, (sums, non_finite)) in tiles.iter().zip(parts) {
        if sums.is_empty() {
            out.cancelled = true;
            continue;
        }
        out.non_finite.merge(non_finite);
        let row = (tile.x.end - tile.x.start) as usize * 3;
        let rows = (tile.y.end - tile.y.start) as usize;
        for k in 0..count {
            for r in 0..rows {
                let from = (k * rows + r) * row;
                let to = ((tile.y.start as usize + r) * width as usize + tile.x.start as usize) * 3;
                out.sums[k][to..to + row].copy_from_slice(&sums[from..from + row]);
            }
        }
    }
    out
}
