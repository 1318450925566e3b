//! The integral over paths from the camera: its image, its gradient, and its recorded samples one by one.

use std::marker::PhantomData;

use ad_core::{Float, Real};

use super::active::Active;
use super::exact::ExactBuffer;
use super::local::LocalFn;
use super::noise::{Noise, PixelNoise};
use super::pass::Pass;
use super::path::{Context, shifts};
use super::record::Recorder;
use super::record::derivatives::Tangents;
use super::rendering::{Components, NonFinite, Rendering, is_single};
use super::sink::{GradientSums, Sink, add};
use super::tile::{Paths, Sample, place, start};
use super::wave::{LayerAdjoints, Record, WAVE_SIZE, Wave};
use crate::estimator::{Sampling, Strategy, goes_in_waves};
use crate::math::Rgb;
use crate::parallel;
use crate::params::Theta;
use crate::sampler::Sampler;
use crate::scene::{Caustics, Scene};

/// The image is split into this many jobs, whatever the number of threads, and their sums are added in
/// order.
pub(super) const JOBS: usize = 128;

/// `[component][height][width][3]` of a tile, added up, and what went wrong there; empty if it was cut short.
pub(super) type TileSums = (Vec<f64>, NonFinite);

/// Adds a sample to the sums of a tile, as if there were as many samples of each pixel.
#[inline]
pub(super) fn deposit<R: Components>(sums: &mut [f64], at: usize, l: Rgb<R>, weight: f64) {
    let pixels = sums.len() / (3 * R::COUNT);
    for k in 0..R::COUNT {
        for c in 0..3 {
            sums[(k * pixels + at) * 3 + c] += weight * l[c].component(k);
        }
    }
}

/// The image by paths.
pub(super) fn image<R: Components, S: Strategy, X: Sampler>(pass: &Pass<R>) -> Rendering {
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
    let active = Active::moving(scene, theta);
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
            let weight = spp * sample.scale();
            deposit(&mut sums, at, l, weight);
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
            tile.trace_waves::<_, S, X, _>(&still, (seed, samples), &mut wave, log, begin, done);
        } else if const { R::ORDER == 1 && is_single::<R::Primal>() && goes_in_waves::<S>() } {
            let mut wave = Wave::<R::Primal, X>::new();
            let mut record = Record::of::<S>(&active, scene, true);
            let mut lifted = Vec::with_capacity(WAVE_SIZE);
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
            tile.trace_waves::<_, S, X, _>(&still, (seed, samples), &mut wave, log, begin, done);
        } else {
            let mut paths = Paths::<R, S, X, _>::new(());
            tile.trace(&context, (seed, samples), &mut paths, |at, sample, l, _| {
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
pub(super) fn assemble<R: Real>(pass: &Pass<R>, count: usize, parts: &[TileSums]) -> Rendering {
    let width = pass.scene.film.crop_size[0];
    let samples = &pass.samples;
    let tiles = pass.tiles();
    let mut out = Rendering::black(pass.scene.film.crop_size, samples, count);
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

/// The derivative of `<adjoint, image>` by paths. The large ranges are added to `large`.
pub(super) fn gradient<P: Float, S: Strategy, X: Sampler>(
    pass: &Pass<P>,
    active: &Active,
    adjoint: &[f32],
    large: &ExactBuffer,
) -> GradientSums {
    // In double precision, single paths check on waves.
    if const { goes_in_waves::<S>() && is_single::<P>() } && active.scales.is_empty() {
        return pass.sums_of_waves::<S, X>(active, adjoint, large);
    }
    let (scene, theta) = (pass.scene, pass.theta);
    let each = |_: &Context<P>, at: Sample, recorder: &mut Recorder<'_, P>, sink: &mut Sink| {
        let d = at.of_image::<P>(adjoint, scene) * P::of(at.scale());
        if S::Bsdf::DETACHED_PATH {
            recorder.backward::<S>(scene, theta, d, sink);
        } else {
            let again = Again::<P, S, X> {
                pass,
                at,
                types: PhantomData,
            };
            recorder.backward_moving(scene, theta, &again, d, sink);
        }
        sink.finish(scene, at, recorder.work());
    };
    pass.sums::<S, X>(active, large, each)
}

/// The sums of jobs that add up sample by sample.
pub(super) fn collect_parts<'a>(
    scene: &Scene,
    active: &Active,
    parts: impl IntoIterator<Item = (Sink<'a>, NonFinite)>,
) -> GradientSums {
    let mut sums = GradientSums::zero(active);
    let mut noise = (!active.scales.is_empty()).then(|| Noise {
        pixels: vec![PixelNoise::default(); scene.film.pixels()],
        variances: vec![0.0; active.ranges.len()],
    });
    for (part, non_finite) in parts {
        add(&mut sums.small, &part.small);
        sums.non_finite.merge(&non_finite);
        if let (Some(noise), Some(watch)) = (&mut noise, part.watch) {
            let (pixels, variances) = watch.finished();
            add(&mut noise.variances, &variances);
            for (pixel, found) in pixels {
                noise.pixels[pixel] = found;
            }
        }
    }
    GradientSums { noise, ..sums }
}

impl<P: Float> Pass<'_, P> {
    /// All paths. The large ranges are added to `large`.
    pub fn sums<S: Strategy, X: Sampler>(
        &self,
        active: &Active,
        large: &ExactBuffer,
        each: impl Fn(&Context<P>, Sample, &mut Recorder<'_, P>, &mut Sink) + Sync,
    ) -> GradientSums {
        let new = || Sink::of_samples(active, large);
        let (parts, non_finite) = self.paths::<S, X, _>(active, JOBS, new, each);
        let parts = parts.into_iter().map(|sink| (sink, NonFinite::default()));
        let sums = collect_parts(self.scene, active, parts);
        GradientSums { non_finite, ..sums }
    }

    /// [`Pass::sums`] of the derivative of `<adjoint, image>`, by waves.
    fn sums_of_waves<S: Strategy, X: Sampler>(
        &self,
        active: &Active,
        adjoint: &[f32],
        large: &ExactBuffer,
    ) -> GradientSums {
        let (scene, context) = (self.scene, self.context());
        let tiles = self.tiles();
        let jobs = JOBS.min(tiles.len());
        let parts = parallel::map(jobs, |job| {
            let mut sink = Sink::new(active, large);
            let mut non_finite = NonFinite::default();
            let mut wave = Wave::<P, X>::new();
            let mut record = Record::of::<S>(active, scene, false);
            let mut adjoints = LayerAdjoints::of(scene, active, self.theta, &mut sink);
            for tile in tiles.iter().skip(job).step_by(jobs) {
                if self.progress.cancelled() {
                    break;
                }
                let begin = |record: &mut Record<'_, P>, which: &[(usize, Sample)]| {
                    let adjoint = |(_, at): &(usize, Sample)| {
                        at.of_image::<P>(adjoint, scene) * P::of(at.scale())
                    };
                    record.start(which.iter().map(adjoint));
                };
                let done = |record: &mut Record<'_, P>, which: &[(usize, Sample)], l: &[Rgb<P>]| {
                    for ((_, at), _) in which.iter().zip(l).filter(|(_, l)| !l.is_finite()) {
                        non_finite.add(place(scene, at.pixel) as u64, at.index);
                    }
                    record.differentiate::<S>(l, &mut adjoints);
                };
                tile.trace_waves::<P, S, X, _>(
                    &context,
                    (self.seed, &self.samples),
                    &mut wave,
                    &mut record,
                    begin,
                    done,
                );
                self.progress.advance(tile.pixels() as u64);
            }
            adjoints.complete();
            (sink.into_small(), non_finite)
        });
        GradientSums::zero(active).with_parts(parts)
    }

    /// Records every path, as far as the parameters `active` matter to it, and calls `each` with it, pixel by
    /// pixel within a tile. The tiles are shared by `jobs` states, whatever the number of threads.
    pub fn paths<S: Strategy, X: Sampler, J: Send>(
        &self,
        active: &Active,
        jobs: usize,
        new: impl Fn() -> J + Sync,
        each: impl Fn(&Context<P>, Sample, &mut Recorder<'_, P>, &mut J) + Sync,
    ) -> (Vec<J>, NonFinite) {
        let (context, tiles) = (self.context(), self.tiles());
        let jobs = jobs.min(tiles.len());
        let parts = parallel::map(jobs, |job| {
            let mut state = new();
            let mut paths = Paths::<P, S, X, _>::new(Recorder::of(active));
            let mut non_finite = NonFinite::default();
            for tile in tiles.iter().skip(job).step_by(jobs) {
                if self.progress.cancelled() {
                    break;
                }
                let done = |_, sample: Sample, l: Rgb<P>, recorder: &mut Recorder<'_, P>| {
                    if l.is_finite() {
                        each(&context, sample, recorder, &mut state);
                    } else {
                        non_finite.add(place(self.scene, sample.pixel) as u64, sample.index);
                    }
                    recorder.clear();
                };
                tile.trace(&context, (self.seed, &self.samples), &mut paths, done);
                self.progress.advance(tile.pixels() as u64);
            }
            (state, non_finite)
        });
        let mut non_finite = NonFinite::default();
        let join = |(state, bad)| {
            non_finite.merge(&bad);
            state
        };
        (parts.into_iter().map(join).collect(), non_finite)
    }
}

/// The radiance of one sample as a function of the parameters: its path once more, moving.
struct Again<'a, P: Float, S, X> {
    pass: &'a Pass<'a, P>,
    at: Sample,
    types: PhantomData<fn() -> (S, X)>,
}

impl<P: Float, S: Strategy, X: Sampler> LocalFn<P> for Again<'_, P, S, X> {
    fn eval<R: Real<Primal = P>>(&self, theta: &Theta<R>) -> Rgb<R> {
        let Pass {
            scene,
            settings,
            seed,
            ..
        } = *self.pass;
        let progress = self.pass.progress;
        let context = Context::new(scene, theta, settings, Caustics::Paths, progress);
        start::<R, S, X>(scene, settings.points, seed, self.at.pixel, self.at.index)
            .finish(&context, &mut ())
    }
}
