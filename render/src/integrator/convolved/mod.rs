//! What moves, by a change of variables: directions follow the outlines of what they meet, so that nothing jumps across them
//! when it is differentiated.
//!
//! Around each direction of a path a few auxiliary rays find out how what they meet moves; a [harmonic convolution](field)
//! makes a smooth field of that, which has the velocity of outlines there. The path follows the field, its divergence
//! counts how directions spread, and no edge is looked for. It is the integral of `integrator::motion` and that of
//! `integrator::boundary` in one, with samples of its own.
//!
//! On the film, points of samples follow the field of the camera's rays, and the pixel filter is differentiated where they
//! are. A box filter has a derivative on the borders of its pixel only: what flows through them has samples of its own, on
//! a border each.
//!
//! Where all outlines are those of spheres and of flat faces, a field that has their velocities is known in closed form, and
//! takes the place of the convolution: nothing is traced but the path, and no limit is left.
//!
//! Mirrors and glass turn directions on; what is seen over them has outlines that directions before them follow (`chain`).
//!
//! # Does not handle
//! By auxiliary rays it is right in the limit of a narrow kernel only ([`field::KAPPA`]): what is smaller than that is
//! blurred. Textures that jump and shadows of lights without area are refused, as other estimators of motion do, Dirac deltas
//! where outlines are to be known in closed form, parallel rays of a camera, and pixel filters other than a box or a Gaussian
//! ([`Scene::admits_outlines`](crate::Scene::admits_outlines)).
//!
//! # Reference
//! [Zeltner 2021, section 4.4] after [Bangaru et al. 2020].

mod chain;
mod closed;
mod course;
pub mod field;
mod outlines;

use ad_core::{Const, Float, Real, array};

use self::course::{Follow, Known, Numbers};
use super::active::Active;
use super::exact::ExactBuffer;
use super::motion::trail::Trail;
use super::motion::{Held, context};
use super::pass::Pass;
use super::path::{Context, Walk};
use super::paths::{JOBS, collect_parts};
use super::rendering::{Components, NonFinite, Rendering};
use super::sink::{GradientSums, Sink};
use super::tile::{Paths, Sample, Tile, camera_sample, on_lens, place};
use crate::camera::CameraSample;
use crate::estimator::Strategy;
use crate::film::PixelFilter;
use crate::math::Rgb;
use crate::parallel;
use crate::sampler::{Family, Sampler};
use crate::scene::Scene;

/// Who the random numbers of a sample belong to.
fn numbers(scene: &Scene, seed: u64, sample: &Sample) -> Numbers {
    Numbers {
        seed,
        pixel: scene.film.full_pixel(sample.pixel).1,
        sample: sample.index,
    }
}

/// The slopes of the logarithm of the filter at a point of the image around a pixel.
fn filter_slopes<P: Float>(scene: &Scene, sample: &Sample, film: [P; 2]) -> [f64; 2] {
    let PixelFilter::Gaussian { stddev } = scene.film.filter else {
        return [0.0; 2];
    };
    std::array::from_fn(|k| {
        let pixel = f64::from(sample.pixel[k] + scene.film.crop_offset[k]);
        (pixel + 0.5 - film[k].to_f64()) / (stddev * stddev)
    })
}

/// A point on a border of a pixel.
struct Border {
    /// The axis across it.
    axis: usize,
    /// Where it is on the film.
    at: [f64; 2],
    /// Whether the pixel lies before it along the axis.
    after: bool,
    /// The pixel on the other side, if there is one.
    other: Option<[u32; 2]>,
    /// The length of all borders that it may be on.
    length: f64,
}

/// A point on a border of the sample's pixel, for box filters: every pixel has those on its right and below, the first ones
/// of rows and columns also the others, so that all borders have as many samples as pixels.
fn border<X: Sampler>(
    pass_points: crate::sampler::Points,
    scene: &Scene,
    sample: &Sample,
    numbers: Numbers,
) -> (Border, X) {
    let Numbers { seed, pixel, .. } = numbers;
    let mut sampler = X::spread(
        pass_points,
        Family::PixelBorders.seed(seed),
        pixel,
        sample.index,
    );
    let [u, v]: [f64; 2] = sampler.next_2d();
    let [x, y] = sample.pixel;
    let first = [x == 0, y == 0];
    let sides = [(0, true), (1, true), (0, false), (1, false)];
    let sides = sides
        .into_iter()
        .filter(|(axis, after)| *after || first[*axis]);
    let sides: smallvec::SmallVec<[(usize, bool); 4]> = sides.collect();
    let length = sides.len() as f64;
    let (axis, after) = sides[((u * length) as usize).min(sides.len() - 1)];
    let mut at = [0, 1].map(|k| f64::from(sample.pixel[k] + scene.film.crop_offset[k]));
    at[axis] += f64::from(u8::from(after));
    at[1 - axis] += v;
    let mut beyond = [x, y];
    beyond[axis] += 1;
    let inside = after && beyond[axis] < scene.film.crop_size[axis];
    let border = Border {
        axis,
        at,
        after,
        other: inside.then_some(beyond),
        length,
    };
    (border, sampler)
}

/// What one thread needs.
struct Worker<'a, P: Float, S: Strategy, X: Sampler> {
    follow: Follow<'a, P>,
    context: &'a Context<'a, P>,
    seed: u64,
    /// The path from a border of a pixel, where that may go along Dirac deltas.
    trail: Option<Trail<P>>,
    strategy: std::marker::PhantomData<(S, X)>,
}

impl<P: Float, S: Strategy, X: Sampler> Worker<'_, P, S, X> {
    /// Calls `each` with what flows through borders of the sample's pixel: where, the radiance there, and something that adds
    /// the derivative of a number times the speed of the film across the border.
    fn borders(
        &mut self,
        sample: &Sample,
        mut each: impl FnMut(&Border, Rgb<P>, &dyn Fn(f64, &mut Held)),
    ) {
        let scene = self.context.scene;
        if scene.film.filter != PixelFilter::Box {
            return;
        }
        let points = self.context.settings.points;
        let numbers = numbers(scene, self.seed, sample);
        let (border, sampler) = border::<X>(points, scene, sample, numbers);
        let film = border.at.map(P::of);
        let lens = on_lens(scene, sampler);
        let at = CameraSample { film, lens };
        let ray = scene.camera.ray_of(&at);
        let walk = || Walk::<P, S::Still, X>::new(ray, sampler);
        let along = self.trail.as_mut().map(|trail| {
            trail.clear();
            let l = walk().finish(self.context, trail);
            (l, chain::ahead(&trail.stops))
        });
        if along.as_ref().is_some_and(|(l, _)| l.is_black()) {
            return;
        }
        let deltas = along.as_ref().map_or(&[][..], |(_, deltas)| deltas);
        let family = Family::PixelBorders;
        let of_camera = (ray, lens);
        let Some(field) = (self.follow).camera_field::<X>(of_camera, deltas, numbers, family)
        else {
            return;
        };
        let l = along.map_or_else(|| walk().finish(self.context, &mut ()), |(l, _)| l);
        if l.is_black() {
            return;
        }
        let follow = &self.follow;
        each(&border, l, &|d, held| {
            follow.add_border(&field, border.axis, &at, d, held);
        });
    }
}

/// Sums of a tile and of the pixels to the right of it and below.
struct Window {
    tile: Tile,
    width: usize,
    sums: Vec<f64>,
}

impl Window {
    fn of(tile: Tile, count: usize) -> Self {
        let width = (tile.x.end - tile.x.start) as usize + 1;
        let height = (tile.y.end - tile.y.start) as usize + 1;
        Self {
            tile,
            width,
            sums: vec![0.0; count * width * height * 3],
        }
    }

    fn add<R: Components>(&mut self, [x, y]: [u32; 2], l: Rgb<R>, weight: f64) {
        let [x, y] = [x - self.tile.x.start, y - self.tile.y.start].map(|k| k as usize);
        super::paths::deposit(&mut self.sums, y * self.width + x, l, weight);
    }

    /// Adds them to an image.
    fn add_to(&self, out: &mut Rendering) {
        let pixels = self.sums.len() / (3 * out.sums.len());
        for (k, image) in out.sums.iter_mut().enumerate() {
            for at in 0..pixels {
                let x = self.tile.x.start as usize + at % self.width;
                let y = self.tile.y.start as usize + at / self.width;
                if x < out.width && y < out.height {
                    for c in 0..3 {
                        image[(y * out.width + x) * 3 + c] += self.sums[(k * pixels + at) * 3 + c];
                    }
                }
            }
        }
    }
}

/// What moves in derivative images.
pub(super) fn image<R: Components, S: Strategy, X: Sampler>(pass: &Pass<R>) -> Rendering {
    let scene = pass.scene;
    let theta = pass.theta.primal();
    let active = Active::moving(scene, pass.theta);
    let context = context(pass, &theta);
    let known = Known::of::<S>(scene);
    let deltas = scene.scatters_deltas();
    let spp = pass.samples.end.saturating_sub(pass.samples.start) as f64;
    let tiles = pass.tiles();
    let parts = parallel::map(tiles.len(), |i| {
        let tile = &tiles[i];
        let mut window = Window::of(*tile, R::COUNT);
        let mut non_finite = NonFinite::default();
        if pass.progress.cancelled() {
            return (window, non_finite);
        }
        let mut paths = Paths::<R::Primal, S::Still, X, _>::new(Trail::default());
        let mut worker = Worker::<R::Primal, S, X> {
            follow: Follow::new(&context, &active, &known),
            context: &context,
            seed: pass.seed,
            trail: deltas.then(Trail::default),
            strategy: std::marker::PhantomData,
        };
        let mut held = Held::new(&active);
        let done = |_: usize, sample: Sample, l: Rgb<R::Primal>, trail: &mut Trail<R::Primal>| {
            let at = camera_sample::<R::Primal, X>(scene, pass.settings.points, pass.seed, &sample);
            let numbers = numbers(scene, pass.seed, &sample);
            let course = worker.follow.course::<X>(trail, at, numbers);
            let filter = filter_slopes(scene, &sample, at.film);
            let mut tangents = [R::zero(); 3];
            let mut finite = l.is_finite();
            for (c, sum) in tangents.iter_mut().enumerate() {
                held.found.clear();
                let unit = |i| R::Primal::select(i == c, R::Primal::one(), R::Primal::zero());
                let d_l = array(unit).into();
                worker.follow.add(trail, &course, filter, d_l, &mut held);
                finite &= held.is_finite();
                *sum = held.tangent(pass.theta);
            }
            trail.clear();
            let found = Rgb::from(tangents);
            let weight = spp * sample.scale();
            if finite && found.is_finite() {
                window.add(sample.pixel, found, weight);
            } else {
                non_finite.add(place(scene, sample.pixel) as u64, sample.index);
            }
            worker.borders(&sample, |border, l, speed| {
                held.found.clear();
                speed(border.length, &mut held);
                let outwards = held.tangent(pass.theta);
                let flow = l.map(|l| outwards * Const(l));
                if !(held.is_finite() && flow.is_finite()) {
                    non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                    return;
                }
                let sign = if border.after { 1.0 } else { -1.0 };
                window.add(sample.pixel, flow, -sign * weight);
                if let Some(other) = border.other {
                    window.add(other, flow, weight);
                }
            });
        };
        tile.trace(&context, (pass.seed, &pass.samples), &mut paths, done);
        pass.progress.advance(tile.pixels() as u64);
        (window, non_finite)
    });
    let mut out = Rendering::black(scene.film.crop_size, &pass.samples, R::COUNT);
    for (window, non_finite) in &parts {
        out.non_finite.merge(non_finite);
        window.add_to(&mut out);
    }
    out.cancelled = pass.progress.cancelled();
    out
}

/// The derivative of `<adjoint, image>` in what moves. The large ranges are added to `large`.
pub(super) fn gradient<P: Float, S: Strategy, X: Sampler>(
    pass: &Pass<P>,
    active: &Active,
    adjoint: &[f32],
    large: &ExactBuffer,
) -> GradientSums {
    let (scene, theta) = (pass.scene, pass.theta);
    let context = context(pass, theta);
    let known = Known::of::<S>(scene);
    let deltas = scene.scatters_deltas();
    let tiles = pass.tiles();
    let jobs = JOBS.min(tiles.len());
    let parts = parallel::map(jobs, |job| {
        let mut sink = Sink::of_samples(active, large);
        let mut non_finite = NonFinite::default();
        let mut paths = Paths::<P, S::Still, X, _>::new(Trail::default());
        let mut worker = Worker::<P, S, X> {
            follow: Follow::new(&context, active, &known),
            context: &context,
            seed: pass.seed,
            trail: deltas.then(Trail::default),
            strategy: std::marker::PhantomData,
        };
        let mut held = Held::new(active);
        for tile in tiles.iter().skip(job).step_by(jobs) {
            if pass.progress.cancelled() {
                break;
            }
            let done = |_, sample: Sample, l: Rgb<P>, trail: &mut Trail<P>| {
                let at = camera_sample::<P, X>(scene, pass.settings.points, pass.seed, &sample);
                let scale = P::of(sample.scale());
                let of = |pixel| Sample { pixel, ..sample }.of_image::<P>(adjoint, scene) * scale;
                let d = of(sample.pixel);
                held.found.clear();
                if !d.is_black() {
                    let numbers = numbers(scene, pass.seed, &sample);
                    let course = worker.follow.course::<X>(trail, at, numbers);
                    let filter = filter_slopes(scene, &sample, at.film);
                    worker.follow.add(trail, &course, filter, d, &mut held);
                }
                worker.borders(&sample, |border, l, speed| {
                    // What leaves a pixel is lost for it, and won by the next one.
                    let own = if border.after { -d } else { d };
                    let d = border.other.map_or(own, |other| own + of(other));
                    speed((d * l).sum().to_f64() * border.length, &mut held);
                });
                // Auxiliary rays are edges, too.
                let edges = (trail.stops.len() as u32 + 1) * (1 + S::FOLLOWS.rays());
                let which = (scene, sample);
                held.settle(which, l.is_finite(), edges, &mut sink, &mut non_finite);
                trail.clear();
            };
            tile.trace(&context, (pass.seed, &pass.samples), &mut paths, done);
            pass.progress.advance(tile.pixels() as u64);
        }
        (sink, non_finite)
    });
    collect_parts(scene, active, parts)
}
