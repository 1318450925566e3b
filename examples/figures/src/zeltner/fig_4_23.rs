//! Time and memory of a derivative in a position: by adjoints that are handed along each path, and by a tape of all operations
//! on all paths [Zeltner 2021, figure 4.23].
//!
//! The tape records the same estimator as the library has, for a chair of blocks above a floor, two bounces and light that is
//! sampled: the fields of velocities around camera rays, scattered directions and directions to the lamp, by the same kernel,
//! and what flows through the borders of pixels. What is a constant is not recorded. The loss is the squared difference to the
//! image of the chair elsewhere. As where images are arrays of numbers, the tape is complete, loss and all, before it is
//! walked back. Where it would be larger than a budget, the samples are taken in several passes, each with a tape of its own;
//! the adjoints of the pixels must be known before, so that the image is made once more, by as few rays as that takes.
//!
//! Times are those of one thread on its processor, where the system has a clock for that.

use std::f64::consts::FRAC_1_PI;

use ad_core::Vec3;
use rayon::prelude::*;
use render::estimator::{AllowBias, Convolved, EmitterOnly, Reparameterised};
use render::integrator::convolved::field::{
    Influence, KAPPA, LARGEST, Neighbour, boundary_test, convolve,
};
use render::integrator::gradient::{Active, backward};
use render::math::warp::square_to_cosine_hemisphere;
use render::math::{Frame, Ray};
use render::params::Theta;
use render::sampler::{Independent, Points, Sampler};
use render::scene::Intersection;
use render::statistics::{Estimate, z_limit};
use render::{Image, Job, RenderError, Scene};

use crate::statistics::grey;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::memory;
use examples::say;
use examples::scene_builder::{SceneBuilder, View, picture};

const SEED: u64 = 423;
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;
const RAYS: u32 = 8;
/// Two bounces.
const EDGES: u32 = 3;
/// How far to the right the chair is in the target.
const AWAY: f32 = 0.15;
/// Images of this size have a tile for each of the jobs in which derivatives are added up; smaller ones take less memory.
const ALL_JOBS: u32 = 256;
/// Groups of runs that say how well a variance is known.
const GROUPS: usize = 16;
const ALBEDO: f64 = 0.5;
const LIGHT: f64 = 10.0;
/// Corner and sides of the lamp, which looks down.
const LAMP: [[f64; 3]; 3] = [[-0.2, 3.0, -0.8], [1.2, 0.0, 0.0], [0.0, 0.0, 1.2]];
/// Blocks of the chair: name, centre, half sides.
const CHAIR: [(&str, [f64; 3], [f64; 3]); 6] = [
    ("seat", [0.0, 0.8, 0.0], [0.5, 0.06, 0.5]),
    ("back", [0.0, 1.35, -0.44], [0.5, 0.45, 0.05]),
    ("leg1", [-0.42, 0.4, -0.42], [0.06, 0.3, 0.06]),
    ("leg2", [0.42, 0.4, -0.42], [0.06, 0.3, 0.06]),
    ("leg3", [-0.42, 0.4, 0.42], [0.06, 0.3, 0.06]),
    ("leg4", [0.42, 0.4, 0.42], [0.06, 0.3, 0.06]),
];

type Follows = AllowBias<Convolved<EmitterOnly<Reparameterised>, RAYS>>;

fn scene(size: u32) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let grey = builder.matt("grey", [ALBEDO; 3])?;
    let black = builder.matt("black", [0.0; 3])?;
    builder.quad(
        "floor",
        [[-4.0, 0.0, 4.0], [8.0, 0.0, 0.0], [0.0, 0.0, -8.0]],
        &grey,
    )?;
    for (name, centre, half) in CHAIR {
        builder.block(name, centre, half, 0.0, &grey)?;
    }
    let lamp = builder.quad("lamp", LAMP, &black)?;
    builder.lamp("lamp", lamp, [LIGHT; 3])?;
    let view = View {
        eye: [1.5, 2.6, 4.5],
        target: [0.0, 0.6, 0.0],
        fov: 40.0,
        size: [size; 2],
    };
    let mut scene = builder.finish(&view, EDGES)?;
    scene.make_movable(&names())?;
    Ok(scene)
}

fn names() -> [String; CHAIR.len()] {
    CHAIR.map(|(name, ..)| format!("{name}.translation"))
}

/// The image of the chair where it would have to be, its mean over the channels.
fn target(scene: &mut Scene, spp: u64) -> Result<Vec<f64>> {
    let at = |x: f32| names().map(|name| (name, [x, 0.0, 0.0]));
    scene.set(at(AWAY).iter().map(|(name, x)| (name, &x[..])))?;
    let image = image_of(scene, SEED + 1, spp);
    scene.set(at(0.0).iter().map(|(name, x)| (name, &x[..])))?;
    Ok(image)
}

/// The image by the library, its mean over the channels.
fn image_of(scene: &Scene, seed: u64, spp: u64) -> Vec<f64> {
    let image = picture(scene, seed, spp);
    grey(&image.sums[0], 1.0 / image.samples as f64)
}

/// The derivative of the loss in every pixel of an image.
fn adjoint(image: &[f64], target: &[f64]) -> Vec<f64> {
    let n = image.len() as f64;
    let pixels = image.iter().zip(target);
    pixels.map(|(i, t)| 2.0 * (i - t) / n).collect()
}

/// The derivative of `<adjoint, image>` as the chair moves along x, by the library.
fn by_paths(
    scene: &Scene,
    seed: u64,
    spp: u64,
    adjoint: &[f32],
) -> std::result::Result<f64, RenderError> {
    let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
    let active = Active::seen_by::<Follows, _>(scene, &names())?;
    let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
    let theta = Theta::constant(&values);
    let found = backward::<f64, Follows, Independent>(&job, &theta, &active, adjoint)?;
    Ok(found.values.iter().map(|v| v[0]).sum())
}

/// An adjoint of grey pixels as the library takes it.
fn channels(adjoint: &[f64]) -> Vec<f32> {
    let pixel = |a: &f64| [(a / 3.0) as f32; 3];
    adjoint.iter().flat_map(pixel).collect()
}

/// An operation: what it reads, and its derivatives.
struct Operation {
    reads: [u32; 2],
    slopes: [f64; 2],
}

/// All operations so far, in blocks that never move: a tape takes as much memory as it says.
#[derive(Default)]
struct Tape {
    blocks: Vec<Vec<Operation>>,
    len: usize,
}

/// Operations of a block.
const BLOCK: usize = 1 << 12;

/// A number, and the operation that it comes from; a constant has none.
#[derive(Clone, Copy)]
struct Number {
    value: f64,
    from: u32,
}

const NOTHING: u32 = u32::MAX;

fn constant(value: f64) -> Number {
    Number {
        value,
        from: NOTHING,
    }
}

impl Tape {
    fn put(&mut self, value: f64, a: Number, da: f64, b: Number, db: f64) -> Number {
        if a.from == NOTHING && b.from == NOTHING {
            return constant(value);
        }
        let from = self.push(Operation {
            reads: [a.from, b.from],
            slopes: [da, db],
        });
        Number { value, from }
    }

    fn push(&mut self, operation: Operation) -> u32 {
        if self.len == self.blocks.len() * BLOCK {
            self.blocks.push(Vec::with_capacity(BLOCK));
        }
        self.blocks[self.len / BLOCK].push(operation);
        self.len += 1;
        (self.len - 1) as u32
    }

    /// A number that derivatives are taken in.
    fn variable(&mut self, value: f64) -> Number {
        let from = self.push(Operation {
            reads: [NOTHING; 2],
            slopes: [0.0; 2],
        });
        Number { value, from }
    }

    fn add(&mut self, a: Number, b: Number) -> Number {
        self.put(a.value + b.value, a, 1.0, b, 1.0)
    }

    fn sub(&mut self, a: Number, b: Number) -> Number {
        self.put(a.value - b.value, a, 1.0, b, -1.0)
    }

    fn mul(&mut self, a: Number, b: Number) -> Number {
        self.put(a.value * b.value, a, b.value, b, a.value)
    }

    fn div(&mut self, a: Number, b: Number) -> Number {
        let q = a.value / b.value;
        self.put(q, a, b.value.recip(), b, -q / b.value)
    }

    fn sqrt(&mut self, a: Number) -> Number {
        let root = a.value.sqrt();
        self.put(root, a, 0.5 / root, constant(0.0), 0.0)
    }

    fn add3(&mut self, a: [Number; 3], b: [Number; 3]) -> [Number; 3] {
        std::array::from_fn(|k| self.add(a[k], b[k]))
    }

    fn sub3(&mut self, a: [Number; 3], b: [Number; 3]) -> [Number; 3] {
        std::array::from_fn(|k| self.sub(a[k], b[k]))
    }

    fn scale(&mut self, a: [Number; 3], s: Number) -> [Number; 3] {
        a.map(|x| self.mul(x, s))
    }

    fn dot(&mut self, a: [Number; 3], b: [Number; 3]) -> Number {
        let [x, y, z] = std::array::from_fn(|k| self.mul(a[k], b[k]));
        let xy = self.add(x, y);
        self.add(xy, z)
    }

    fn normalize(&mut self, a: [Number; 3]) -> [Number; 3] {
        let square = self.dot(a, a);
        let length = self.sqrt(square);
        a.map(|x| self.div(x, length))
    }

    /// The derivative of a number in the variable `of`.
    fn walk_back(&self, end: Number, of: Number) -> f64 {
        let mut adjoints = vec![0.0; self.len];
        if end.from == NOTHING {
            return 0.0;
        }
        adjoints[end.from as usize] = 1.0;
        let all = self
            .blocks
            .iter()
            .rev()
            .flat_map(|block| block.iter().rev());
        for (i, op) in (0..self.len).rev().zip(all) {
            let d = adjoints[i];
            if d != 0.0 {
                for (read, slope) in op.reads.iter().zip(op.slopes) {
                    if *read != NOTHING {
                        adjoints[*read as usize] += d * slope;
                    }
                }
            }
        }
        adjoints[of.from as usize]
    }

    fn bytes(&self) -> usize {
        // With the adjoints.
        self.blocks.len() * BLOCK * size_of::<Operation>() + self.len * size_of::<f64>()
    }
}

fn constants(v: Vec3<f64>) -> [Number; 3] {
    v.to_array().map(constant)
}

/// Where what is recorded goes.
enum Gather<'a> {
    /// Into the image, pixel by pixel.
    Pixels(Vec<Number>),
    /// Into the inner product with an adjoint image.
    Product(Number, &'a [f64]),
}

/// What the tape is made of.
struct Taped<'a> {
    scene: &'a Scene,
    tape: Tape,
    /// Where the chair is along x.
    x: Number,
    into: Gather<'a>,
    neighbours: Vec<(Neighbour, f64)>,
    influences: Vec<Influence>,
}

/// A direction that follows, and the divergence of the field around it.
struct Followed {
    w: [Number; 3],
    divergence: Number,
}

impl<'a> Taped<'a> {
    fn new(scene: &'a Scene, into: Gather<'a>) -> Self {
        let mut tape = Tape::default();
        let x = tape.variable(0.0);
        Self {
            scene,
            tape,
            x,
            into,
            neighbours: Vec::new(),
            influences: Vec::new(),
        }
    }

    fn is_chair(&self, shape: u32) -> bool {
        let name = &self.scene.shape_info(shape).name;
        CHAIR.iter().any(|(own, ..)| own == name)
    }

    /// A point of the material.
    fn point(&mut self, p: Vec3<f64>, moves: bool) -> [Number; 3] {
        let mut p = constants(p);
        if moves {
            p[0] = self.tape.add(p[0], self.x);
        }
        p
    }

    /// The field around a ray from `origin`.
    fn follow(
        &mut self,
        ray: &Ray<f64>,
        origin: [Number; 3],
        sampler: &mut Independent,
    ) -> Followed {
        let frame = Frame::from_normal(ray.d);
        self.neighbours.clear();
        let mut met = Vec::new();
        for _ in 0..RAYS {
            let neighbour = Neighbour::sample(&frame, KAPPA, sampler.next_2d());
            let around = Ray {
                d: neighbour.d.normalize(),
                ..*ray
            };
            let hit = self.scene.nearest(&around);
            let test = hit.map_or(LARGEST, |h| {
                boundary_test(KAPPA, self.scene.border(&around, &h))
            });
            self.neighbours.push((neighbour, test));
            met.push(hit.map(|h| {
                let found = self.scene.interaction(&Theta::still(), &around, &h);
                (found.si.p, found.shape)
            }));
        }
        let mut influences = std::mem::take(&mut self.influences);
        convolve(ray.d, KAPPA, &self.neighbours, &mut influences);
        let mut w = constants(ray.d);
        let mut divergence = constant(0.0);
        for (met, influence) in met.iter().zip(&influences) {
            let Some((p, shape)) = *met else { continue };
            let moves = self.is_chair(shape);
            let p = self.point(p, moves);
            let way = self.tape.sub3(p, origin);
            let towards = self.tape.normalize(way);
            let still = constants(Vec3::from(towards.map(|n| n.value)));
            let change = self.tape.sub3(towards, still);
            let part = self.tape.scale(change, constant(influence.share));
            w = self.tape.add3(w, part);
            let spread = self.tape.dot(change, constants(influence.divergence));
            divergence = self.tape.add(divergence, spread);
        }
        self.influences = influences;
        // The field is at right angles to the direction: so is what a unit vector changes by.
        Followed {
            w: self.tape.normalize(w),
            divergence,
        }
    }

    /// Where a ray that follows, from this point in this direction, meets the plane of a face.
    fn meet(&mut self, hit: &Intersection<f64>, [o, w]: [[Number; 3]; 2]) -> [Number; 3] {
        let chair = self.is_chair(hit.shape);
        let q = self.point(hit.si.p, chair);
        let n = constants(hit.si.n_geo);
        let to = self.tape.sub3(q, o);
        let (height, slope) = (self.tape.dot(to, n), self.tape.dot(w, n));
        let t = self.tape.div(height, slope);
        let along = self.tape.scale(w, t);
        self.tape.add3(o, along)
    }

    /// What becomes of light in direction `ray` from the point `p` of a face with the normal `n`, as the direction follows: its
    /// cosine, and how directions spread.
    fn followed(
        &mut self,
        ray: &Ray<f64>,
        (p, n): ([Number; 3], Vec3<f64>),
        aside: &mut Independent,
    ) -> ([Number; 3], Number) {
        let field = self.follow(ray, p, aside);
        let cos = self.tape.dot(constants(n), field.w);
        let spread = self.tape.add(constant(1.0), field.divergence);
        (field.w, self.tape.mul(cos, spread))
    }

    /// Light over at most `edges` edges that arrives against `ray`; if that follows, from a point in a direction, with all that
    /// depends on it.
    fn radiance(
        &mut self,
        ray: &Ray<f64>,
        from: Option<[[Number; 3]; 2]>,
        edges: u32,
        [path, aside]: [&mut Independent; 2],
    ) -> Number {
        let numbers: [[f64; 2]; 2] = [path.next_2d(), path.next_2d()];
        let hit = self.scene.intersect(ray);
        let Some(hit) = hit.filter(|hit| self.scene.shape_info(hit.shape).emitter.is_none()) else {
            return constant(0.0);
        };
        let n = hit.si.n_geo;
        if n.dot(ray.d) >= 0.0 {
            return constant(0.0);
        }
        let exit = self.scene.exit(hit.prim);
        let met = from.map(|from| self.meet(&hit, from));
        let mut sum = constant(0.0);

        // ---- The lamp ----
        let [corner, a, b] = LAMP.map(Vec3::from);
        let on_lamp = corner + a * numbers[0][0] + b * numbers[0][1];
        let way = on_lamp - hit.si.p;
        let d = way.normalize();
        let (cos, lamp) = (n.dot(d), d.y);
        let shadow = hit.si.spawn_ray(d, exit);
        let is_lit = cos > 0.0 && lamp > 0.0 && {
            let end = self.scene.intersect(&shadow);
            end.is_some_and(|end| self.scene.shape_info(end.shape).emitter.is_some())
        };
        if is_lit {
            let area = a.cross(b).length();
            let weight = LIGHT * ALBEDO * FRAC_1_PI * area * lamp / way.length_squared();
            let cos = match met {
                Some(p) => self.followed(&shadow, (p, n), aside).1,
                None => constant(cos),
            };
            sum = self.tape.mul(cos, constant(weight));
        }
        if edges <= 2 {
            return sum;
        }

        // ---- The next bounce ----
        let local = square_to_cosine_hemisphere(numbers[1]);
        let d = Frame::from_normal(n).to_world(local);
        let next = hit.si.spawn_ray(d, exit);
        let (from, weight) = match met {
            Some(p) => {
                let (w, cos) = self.followed(&next, (p, n), aside);
                (Some([p, w]), self.tape.mul(cos, constant(ALBEDO / local.z)))
            }
            None => (None, constant(ALBEDO)),
        };
        let l = self.radiance(&next, from, edges - 1, [path, aside]);
        let bounced = self.tape.mul(l, weight);
        self.tape.add(sum, bounced)
    }

    /// Records a sample of a pixel.
    fn sample(&mut self, pixel: [u32; 2], index: u64, seed: u64, scale: f64) {
        let size = self.scene.film.crop_size;
        let camera = &self.scene.camera;
        let origin = constants(Vec3::from(camera.origin()));
        let place = |[x, y]: [u32; 2]| (y * size[0] + x) as usize;

        // ---- The pixel ----
        let [mut path, mut aside, mut border, mut around] =
            [0, 1, 2, 3].map(|k| numbers(seed ^ (k << 40), place(pixel), index));
        let ray = camera_ray(self.scene, pixel, &mut path);
        let seen = self.follow(&ray, origin, &mut aside);
        let from = Some([origin, seen.w]);
        let l = self.radiance(&ray, from, EDGES, [&mut path, &mut aside]);
        let forward = camera
            .ray(f64::from(size[0]) / 2.0, f64::from(size[1]) / 2.0)
            .d;
        let log_area = forward * (-3.0 / forward.dot(ray.d));
        let moved = self.tape.sub3(seen.w, constants(ray.d));
        let area = self.tape.dot(moved, constants(log_area));
        let spread = self.tape.add(area, seen.divergence);
        let spread = self.tape.add(constant(1.0), spread);
        let value = self.tape.mul(l, spread);
        self.count(place(pixel), value, scale);

        // ---- A border ----
        let [u, v]: [f64; 2] = border.next_2d();
        let first = [pixel[0] == 0, pixel[1] == 0];
        let sides = [(0, true), (1, true), (0, false), (1, false)];
        let sides: Vec<(usize, bool)> = sides
            .into_iter()
            .filter(|(axis, after)| *after || first[*axis])
            .collect();
        let length = sides.len() as f64;
        let (axis, after) = sides[((u * length) as usize).min(sides.len() - 1)];
        let mut at = pixel.map(f64::from);
        at[axis] += f64::from(u8::from(after));
        at[1 - axis] += v;
        let ray = camera.ray(at[0], at[1]);
        let l = self.radiance(&ray, None, EDGES, [&mut border, &mut around]);
        let l = l.value;
        if l == 0.0 {
            return;
        }
        let seen = self.follow(&ray, origin, &mut around);
        let h = 1e-4;
        let tangent = |k: usize| {
            let mut ends = [at, at];
            ends[0][k] -= h;
            ends[1][k] += h;
            let [a, b] = ends.map(|e| camera.ray(e[0], e[1]).d);
            (b - a) * (0.5 / h)
        };
        // The coordinate along the axis, as a linear form in directions.
        let (own, other) = (tangent(axis), tangent(1 - axis));
        let across = own - other * (own.dot(other) / other.length_squared());
        let form = across * across.length_squared().recip();
        let moved = self.tape.sub3(seen.w, constants(ray.d));
        let speed = self.tape.dot(moved, constants(form));
        // What leaves a pixel is lost for it, and won by the next one.
        let sign = if after { -1.0 } else { 1.0 };
        let flow = l * length * scale;
        self.count(place(pixel), speed, sign * flow);
        let mut beyond = pixel;
        beyond[axis] += 1;
        if after && beyond[axis] < size[axis] {
            self.count(place(beyond), speed, flow);
        }
    }

    /// Adds a number to a pixel.
    fn count(&mut self, place: usize, value: Number, scale: f64) {
        match &mut self.into {
            Gather::Pixels(pixels) => {
                let value = self.tape.mul(value, constant(scale));
                pixels[place] = self.tape.add(pixels[place], value);
            }
            Gather::Product(sum, adjoint) => {
                let value = self.tape.mul(value, constant(scale * adjoint[place]));
                *sum = self.tape.add(*sum, value);
            }
        }
    }

    /// The derivative of what was recorded: of the loss, if that is an image.
    fn derivative(mut self, target: &[f64]) -> f64 {
        let end = match std::mem::replace(&mut self.into, Gather::Pixels(Vec::new())) {
            Gather::Product(sum, _) => sum,
            Gather::Pixels(pixels) => {
                let mut loss = constant(0.0);
                for (pixel, target) in pixels.iter().zip(target) {
                    let off = self.tape.sub(*pixel, constant(*target));
                    let square = self.tape.mul(off, off);
                    loss = self.tape.add(loss, square);
                }
                self.tape.mul(loss, constant(1.0 / target.len() as f64))
            }
        };
        self.tape.walk_back(end, self.x)
    }
}

/// Random numbers of a sample.
fn numbers(seed: u64, place: usize, index: u64) -> Independent {
    Independent::spread(Points::Independent, seed, place as u64, index)
}

fn camera_ray(scene: &Scene, pixel: [u32; 2], path: &mut Independent) -> Ray<f64> {
    let [u, v]: [f64; 2] = path.next_2d();
    scene
        .camera
        .ray(f64::from(pixel[0]) + u, f64::from(pixel[1]) + v)
}

/// All pixels and samples, samples first.
fn samples(scene: &Scene, spp: u64) -> impl Iterator<Item = (u64, [u32; 2])> {
    let [width, height] = scene.film.crop_size;
    let pixels = move || (0..height).flat_map(move |y| (0..width).map(move |x| [x, y]));
    (0..spp).flat_map(move |index| pixels().map(move |pixel| (index, pixel)))
}

/// The image that a tape would have, without one: no ray is traced for derivatives alone.
fn forward(scene: &Scene, seed: u64, spp: u64) -> Vec<f64> {
    let width = scene.film.crop_size[0];
    let mut image = vec![0.0; scene.film.pixels()];
    let mut still = Taped::new(scene, Gather::Pixels(Vec::new()));
    for (index, pixel) in samples(scene, spp) {
        let place = (pixel[1] * width + pixel[0]) as usize;
        let [mut path, mut aside] = [0, 1].map(|k| numbers(seed ^ (k << 40), place, index));
        let ray = camera_ray(scene, pixel, &mut path);
        let l = still.radiance(&ray, None, EDGES, [&mut path, &mut aside]);
        image[place] += l.value / spp as f64;
    }
    image
}

/// The derivative of `<adjoint, image>` by tapes of at most about so many bytes, and how many there were.
fn product_by_tape(
    scene: &Scene,
    seed: u64,
    spp: u64,
    adjoint: &[f64],
    budget: usize,
) -> (f64, u32) {
    let begin = || Taped::new(scene, Gather::Product(constant(0.0), adjoint));
    let mut taped = begin();
    let (mut derivative, mut passes) = (0.0, 1);
    for (index, pixel) in samples(scene, spp) {
        if taped.tape.bytes() > budget {
            derivative += taped.derivative(&[]);
            taped = begin();
            passes += 1;
        }
        taped.sample(pixel, index, seed, 1.0 / spp as f64);
    }
    (derivative + taped.derivative(&[]), passes)
}

/// The derivative of the loss by tapes of at most about so many bytes, and how many there were: one, if `fits` says that this
/// is enough, or those of passes after an image was made for their adjoints.
fn loss_by_tape(
    scene: &Scene,
    seed: u64,
    spp: u64,
    target: &[f64],
    budget: usize,
    fits: bool,
) -> (f64, u32) {
    if !fits {
        let image = forward(scene, seed, spp);
        return product_by_tape(scene, seed, spp, &adjoint(&image, target), budget);
    }
    let mut taped = Taped::new(scene, Gather::Pixels(vec![constant(0.0); target.len()]));
    for (index, pixel) in samples(scene, spp) {
        taped.sample(pixel, index, seed, 1.0 / spp as f64);
    }
    (taped.derivative(target), 1)
}

/// Costs of one derivative of the loss.
#[derive(Clone, Copy)]
struct Costs {
    size: u32,
    spp: u64,
    /// Seconds and bytes along paths.
    paths: (f64, usize),
    /// Seconds and bytes of the tape.
    tape: (f64, usize),
    passes: u32,
}

impl Costs {
    fn samples(&self) -> f64 {
        f64::from(self.size * self.size) * self.spp as f64
    }
}

/// Seconds that this thread has been on a processor.
#[cfg(unix)]
fn seconds_of_thread() -> f64 {
    use rustix::time::{ClockId, clock_gettime};
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Seconds, where no clock of a thread is at hand.
#[cfg(not(unix))]
fn seconds_of_thread() -> f64 {
    static START: std::sync::LazyLock<std::time::Instant> =
        std::sync::LazyLock::new(std::time::Instant::now);
    START.elapsed().as_secs_f64()
}

/// What a computation takes on a thread of its own: seconds and bytes.
fn costs<T: Send>(alone: &rayon::ThreadPool, run: impl FnOnce() -> T + Send) -> (T, (f64, usize)) {
    alone.install(|| {
        let start = seconds_of_thread();
        let (found, bytes) = memory::peak(run);
        (found, (seconds_of_thread() - start, bytes))
    })
}

/// A scene, its target, and how costs are measured there.
struct Bench<'a> {
    alone: &'a rayon::ThreadPool,
    scene: Scene,
    target: Vec<f64>,
    size: u32,
    budget: usize,
}

impl<'a> Bench<'a> {
    fn new(alone: &'a rayon::ThreadPool, size: u32, budget: usize) -> Result<Self> {
        let mut scene = scene(size)?;
        let target = target(&mut scene, 16)?;
        Ok(Self {
            alone,
            scene,
            target,
            size,
            budget,
        })
    }

    fn samples(&self, spp: u64) -> f64 {
        self.scene.film.pixels() as f64 * spp as f64
    }

    /// Of the tape, where a sample takes so many bytes, and how many passes there were.
    fn tape(&self, spp: u64, per_sample: f64) -> ((f64, usize), u32) {
        let fits = per_sample * self.samples(spp) < 0.95 * self.budget as f64;
        let run = || loss_by_tape(&self.scene, SEED, spp, &self.target, self.budget, fits);
        let ((_, passes), costs) = costs(self.alone, run);
        (costs, passes)
    }

    /// Of both. Images and their adjoints are there in any case: memory is what the derivative takes besides.
    fn both(&self, spp: u64, per_sample: f64) -> Result<Costs> {
        let (three, primal) = costs(self.alone, || {
            let image = image_of(&self.scene, SEED + 2, spp);
            channels(&adjoint(&image, &self.target))
        });
        let (found, paths) = costs(self.alone, || by_paths(&self.scene, SEED, spp, &three));
        found?;
        let (tape, passes) = self.tape(spp, per_sample);
        Ok(Costs {
            size: self.size,
            spp,
            paths: (primal.0 + paths.0, paths.1),
            tape,
            passes,
        })
    }
}

/// The two derivatives of one inner product, and their variances, from so many runs each.
fn same_estimator(fig: &mut Figure) -> Result {
    let mut small = scene(16)?;
    let target = target(&mut small, 1024)?;
    let adjoint = adjoint(&image_of(&small, SEED + 3, 1024), &target);
    let three = channels(&adjoint);
    let runs: u64 = fig.pick(256, 4096);
    let spp = 4;
    fig.note("runs for the variance", runs);
    let all = (0..runs).into_par_iter();
    let paths = all.clone().map(|k| by_paths(&small, SEED + k, spp, &three));
    let paths: Vec<f64> = paths.collect::<std::result::Result<_, _>>()?;
    let seed = SEED + (1 << 20);
    let tape = all.map(|k| product_by_tape(&small, seed + k, spp, &adjoint, usize::MAX).0);
    let tape: Vec<f64> = tape.collect();
    let [a, b] = [&paths, &tape].map(|v| Estimate::of(v));
    let z = a.z(&b);
    let most = z_limit(1, runs, LEVEL);
    // A quick run does not tell the derivative well from zero.
    let sure = fig.pick(0.5, 0.1);
    fig.check(
        "both have the same derivative",
        z.abs() < most && a.se <= sure * a.mean.abs(),
        format!(
            "{:.5e} +- {:.1e} and {:.5e} +- {:.1e}, z {z:.2}",
            a.mean, a.se, b.mean, b.se
        ),
    );
    // Logarithms of variances of groups, which say how well they are known.
    let logs = |v: &[f64]| {
        let variance = |group: &[f64]| Estimate::of(group).se.powi(2).ln();
        let groups = v.chunks_exact(v.len() / GROUPS).map(variance);
        Estimate::of(&groups.collect::<Vec<_>>())
    };
    let [l, m] = [&paths, &tape].map(|v| logs(v));
    let ratio = (a.se / b.se).powi(2);
    let error = l.se.hypot(m.se);
    let within = fig.pick(
        1.2f64.ln().hypot(z_limit(1, GROUPS as u64, LEVEL) * error),
        1.2f64.ln(),
    );
    fig.check(
        "and the same variance within 20 %",
        ratio.ln().abs() < within,
        format!("ratio {ratio:.3}, known to {:.0} %", 100.0 * error),
    );

    // ---- Passes change nothing ----
    let image = forward(&small, SEED, spp);
    let whole = loss_by_tape(&small, SEED, spp, &target, usize::MAX, true);
    let split = loss_by_tape(&small, SEED, spp, &target, 1 << 20, false);
    fig.check(
        "several passes have the derivative of one",
        split.1 > 1 && (whole.0 - split.0).abs() < 1e-9 * whole.0.abs().max(1e-6),
        format!(
            "{:.9e} in one, {:.9e} in {} passes",
            whole.0, split.0, split.1
        ),
    );
    let panels = [("chair", &image), ("target", &target)]
        .map(|(label, pixels)| Panel::tonemapped(label, &to_image(16, pixels), 1.0).enlarged(12));
    fig.images("scene", 2, &panels);
    Ok(())
}

fn to_image(width: usize, pixels: &[f64]) -> Image {
    let mut image = Image::new(width, pixels.len() / width);
    for (out, &x) in image.data.chunks_exact_mut(3).zip(pixels) {
        out.fill(x as f32);
    }
    image
}

/// The exponent of a power law through points, by least squares of logarithms.
fn exponent(points: impl Iterator<Item = (f64, f64)>) -> f64 {
    let logs: Vec<(f64, f64)> = points.map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let [x, y] = [0, 1].map(|k| logs.iter().map(|p| [p.0, p.1][k]).sum::<f64>() / n);
    let slope = logs.iter().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>();
    slope / logs.iter().map(|p| (p.0 - x).powi(2)).sum::<f64>()
}

const MIB: f64 = (1 << 20) as f64;

/// Claims of one sweep, over the resolution or the samples of a pixel.
fn claims(fig: &mut Figure, over: &str, sweep: &[Costs], budget: usize) {
    // Images of a quick run are too small for all jobs.
    let (from, part) = fig.pick((0, 20), (ALL_JOBS, 5));
    let is_one = sweep.iter().all(|c| c.size == sweep[0].size);
    let bytes = sweep.iter().filter(|c| is_one || c.size >= from);
    let bytes = bytes.map(|c| c.paths.1 as f64);
    let [least, most] = [
        bytes.clone().fold(f64::INFINITY, f64::min),
        bytes.fold(0.0, f64::max),
    ];
    fig.check(
        format!("over {over}: the memory of adjoints along paths varies by less than {part} %"),
        least > 0.0 && most < (1.0 + 0.01 * f64::from(part)) * least,
        format!("{:.3} to {:.3} MiB", least / MIB, most / MIB),
    );
    let whole = || sweep.iter().filter(|c| c.passes == 1);
    let power = exponent(whole().map(|c| (c.samples(), c.tape.1 as f64)));
    fig.check(
        format!("over {over}: that of the tape grows in proportion to the samples"),
        // The smallest of a quick run are mostly scene.
        whole().count() >= 3 && (power - 1.0).abs() < fig.pick(0.1, 0.05),
        format!("exponent {power:.3} over {} points", whole().count()),
    );
    let last = sweep[sweep.len() - 1];
    let per_sample = whole()
        .next_back()
        .map_or(0.0, |c| c.tape.1 as f64 / c.samples());
    let needed = per_sample * last.samples();
    // Beside the tape there are images, and a block that has just begun.
    let most = sweep.iter().map(|c| c.tape.1).max().unwrap_or(0) as f64;
    fig.check(
        format!("over {over}: until it would exceed the budget, which passes keep"),
        needed > 1.5 * budget as f64 && last.passes > 1 && most < 1.05 * budget as f64,
        format!(
            "{:.1} MiB needed, {:.1} MiB used in {} passes, budget {:.1} MiB",
            needed / MIB,
            most / MIB,
            last.passes,
            budget as f64 / MIB
        ),
    );
    let power = exponent(sweep.iter().map(|c| (c.samples(), c.paths.0)));
    // The shortest of a quick run take a few hundredths of a second.
    let near = fig.pick(0.2, 0.08);
    fig.check(
        format!("over {over}: the time along paths is in proportion to the samples"),
        (power - 1.0).abs() < near,
        format!(
            "exponent {power:.3}; {:.1} us per sample, the tape {:.1} us",
            1e6 * last.paths.0 / last.samples(),
            1e6 * last.tape.0 / last.samples()
        ),
    );
    let column = |of: &dyn Fn(&Costs) -> f64| {
        sweep
            .iter()
            .map(|c| (c.samples(), of(c)))
            .collect::<Vec<_>>()
    };
    // With room above for the legend.
    let chart = |what: &str, unit: &str, of: [&dyn Fn(&Costs) -> f64; 2]| {
        let title = format!("{what} of a derivative in a position, over {over}");
        let all = sweep.iter().flat_map(|c| of.map(|of| of(c)));
        let low = all.clone().fold(f64::INFINITY, f64::min);
        let chart = LineChart::new(&title, "samples", unit).log_x().log_y();
        chart.y_range(0.7 * low, 8.0 * all.fold(0.0, f64::max))
    };
    let file = |what: &str| format!("{what}-{}", over.replace(' ', "-"));
    let passes = sweep.iter().filter(|c| c.passes > 1);
    let time = chart("Time", "seconds", [&|c| c.paths.0, &|c| c.tape.0])
        .measured("along paths", column(&|c| c.paths.0))
        .measured("tape", column(&|c| c.tape.0))
        .points(
            "tape, several passes",
            passes.clone().map(|c| (c.samples(), c.tape.0)),
        );
    fig.chart(&file("time"), &time);
    let memory = chart(
        "Memory",
        "MiB",
        [&|c| c.paths.1 as f64 / MIB, &|_| budget as f64 / MIB],
    )
    .measured("along paths", column(&|c| c.paths.1 as f64 / MIB))
    .measured("tape", column(&|c| c.tape.1 as f64 / MIB))
    .points(
        "tape, several passes",
        passes.map(|c| (c.samples(), c.tape.1 as f64 / MIB)),
    )
    .dashed("budget", column(&|_| budget as f64 / MIB));
    fig.chart(&file("memory"), &memory);
    let names = [
        "size",
        "samples per pixel",
        "seconds",
        "bytes",
        "tape seconds",
        "tape bytes",
        "tape passes",
    ];
    let row = |c: &Costs| {
        let [size, passes] = [c.size, c.passes].map(f64::from);
        [
            size,
            c.spp as f64,
            c.paths.0,
            c.paths.1 as f64,
            c.tape.0,
            c.tape.1 as f64,
            passes,
        ]
    };
    fig.csv(&file("costs"), &names, sweep.iter().map(row));
}

/// `zeltner-4-23`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let budget: usize = fig.pick(24 << 20, 512 << 20);
    let sizes: &[u32] = fig.pick(&[16, 32, 64, 128], &[16, 32, 64, 128, 256, 512]);
    let counts: &[u64] = fig.pick(&[1, 2, 4, 16], &[1, 4, 16, 64]);
    let (spp, size) = fig.pick((1, 32), (4, 64));
    fig.note("budget of the tape, bytes", budget as u64);
    fig.note("samples per pixel", spp);
    fig.note("auxiliary rays", RAYS);
    fig.note("seed", SEED);
    same_estimator(fig)?;

    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    // The first one of all pays for what is set up once, and says how large a tape is.
    let per_sample = |c: &Costs| c.tape.1 as f64 / c.samples();
    let mut known = per_sample(&Bench::new(&alone, sizes[0], budget)?.both(spp, 0.0)?);
    let mut of_size: Vec<Costs> = Vec::new();
    for &size in sizes {
        let found = Bench::new(&alone, size, budget)?.both(spp, known)?;
        if found.passes == 1 {
            known = per_sample(&found);
        }
        of_size.push(found);
    }
    let bench = Bench::new(&alone, size, budget)?;
    let of_spp: Result<Vec<Costs>> = counts.iter().map(|&spp| bench.both(spp, known)).collect();
    let of_spp = of_spp?;
    claims(fig, "resolution", &of_size, budget);
    claims(fig, "samples per pixel", &of_spp, budget);

    // ---- What passes cost ----
    let last = of_spp[of_spp.len() - 1];
    let whole = of_spp
        .iter()
        .rfind(|c| c.passes == 1)
        .ok_or("no tape fits into the budget")?;
    let rounds = fig.pick(8, 12);
    let per_sample = |spp: u64| bench.tape(spp, known).0.0 / bench.samples(spp);
    let ratios = (0..rounds).map(|_| per_sample(last.spp) / per_sample(whole.spp));
    let found = Estimate::of(&ratios.collect::<Vec<_>>());
    fig.note(
        "time of a sample of the tape in several passes, over that in one, and its error",
        vec![found.mean, found.se],
    );
    say!(
        "        a sample of the tape takes {:.3} +- {:.3} times as long in {} passes as in one",
        found.mean,
        found.se,
        last.passes
    );
    Ok(())
}
