//! Time and memory of a derivative in a position: by adjoints that are handed along each path, and by a tape of all operations
//! on all paths [Zeltner 2021, figure 4.23].
//!
//! The tape records the same estimator as the library has, for a chair of blocks above a floor and light that is sampled:
//! the fields of velocities around camera rays and around directions to the lamp, by the same kernel, and what flows through
//! the borders of pixels. What is a constant is not recorded. As where images are arrays of numbers, the tape is complete
//! before it is walked back; where it would be larger than a budget, the samples are taken in several passes.

use std::f64::consts::FRAC_1_PI;
use std::time::Instant;

use ad_core::Vec3;
use render::estimator::{AllowBias, Convolved, EmitterOnly, Reparameterised};
use render::integrator::convolved::field::{
    Influence, KAPPA, LARGEST, Neighbour, boundary_test, convolve,
};
use render::integrator::gradient::{Active, backward};
use render::math::{Frame, Ray};
use render::params::Theta;
use render::sampler::{Independent, Points, Sampler};
use render::{Job, Scene};

use crate::chart::LineChart;
use crate::figure::{Figure, Result};
use crate::figures::statistics::{Estimate, limit};
use crate::memory;
use crate::scene_builder::{SceneBuilder, View};

const SEED: u64 = 423;
const RUNS: u64 = 12;
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;
const RAYS: u32 = 16;
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
    let mut scene = builder.finish(&view, 2)?;
    let names = CHAIR.map(|(name, ..)| format!("{name}.translation"));
    scene.make_movable(&names)?;
    Ok(scene)
}

/// The derivative of the mean image as the chair moves along x, by the library, on one thread.
fn by_paths(scene: &Scene, seed: u64, spp: u64) -> Result<f64> {
    let n = scene.film.pixels() * 3;
    let adjoint = vec![1.0 / n as f32; n];
    let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
    let names = CHAIR.map(|(name, ..)| format!("{name}.translation"));
    let active = Active::seen_by::<Follows, _>(scene, &names)?;
    let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
    let theta = Theta::constant(&values);
    let found = backward::<f64, Follows, Independent>(&job, &theta, &active, &adjoint)?;
    Ok(found.values.iter().map(|v| v[0]).sum())
}

/// An operation: what it reads, and its derivatives.
struct Operation {
    reads: [u32; 2],
    slopes: [f64; 2],
}

/// All operations so far.
#[derive(Default)]
struct Tape(Vec<Operation>);

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
        self.0.push(Operation {
            reads: [a.from, b.from],
            slopes: [da, db],
        });
        Number {
            value,
            from: (self.0.len() - 1) as u32,
        }
    }

    /// A number that derivatives are taken in.
    fn variable(&mut self, value: f64) -> Number {
        self.0.push(Operation {
            reads: [NOTHING; 2],
            slopes: [0.0; 2],
        });
        Number {
            value,
            from: (self.0.len() - 1) as u32,
        }
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
        let mut adjoints = vec![0.0; self.0.len()];
        if end.from == NOTHING {
            return 0.0;
        }
        adjoints[end.from as usize] = 1.0;
        for (i, op) in self.0.iter().enumerate().rev() {
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
        self.0.len() * (size_of::<Operation>() + size_of::<f64>())
    }
}

fn constants(v: Vec3<f64>) -> [Number; 3] {
    v.to_array().map(constant)
}

/// What the tape is made of.
struct Taped<'a> {
    scene: &'a Scene,
    tape: Tape,
    /// Where the chair is along x.
    x: Number,
    /// The sum over all samples.
    sum: Number,
    neighbours: Vec<(Neighbour, f64)>,
    influences: Vec<Influence>,
}

/// A direction that follows, and the divergence of the field around it.
struct Followed {
    w: [Number; 3],
    divergence: Number,
}

impl<'a> Taped<'a> {
    fn new(scene: &'a Scene) -> Self {
        let mut tape = Tape::default();
        let x = tape.variable(0.0);
        Self {
            scene,
            tape,
            x,
            sum: constant(0.0),
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

    /// Light that a point of the lamp sends to the camera along `ray` by way of what that meets, and all that it depends on
    /// once the ray follows.
    fn radiance(
        &mut self,
        ray: &Ray<f64>,
        w: Option<[Number; 3]>,
        sampler: &mut Independent,
        aside: &mut Independent,
    ) -> Number {
        let Some(hit) = self.scene.intersect(ray) else {
            return constant(0.0);
        };
        let [u, v]: [f64; 2] = sampler.next_2d();
        let [corner, a, b] = LAMP.map(Vec3::from);
        let on_lamp = corner + a * u + b * v;
        let way = on_lamp - hit.si.p;
        let distance = way.length();
        let d = way.normalize();
        let n = hit.si.n_geo;
        let (cos, lamp) = (n.dot(d), d.y);
        if cos <= 0.0 || lamp <= 0.0 || n.dot(ray.d) >= 0.0 {
            return constant(0.0);
        }
        let shadow = hit.si.spawn_ray(d, self.scene.exit(hit.prim));
        let end = self.scene.intersect(&shadow);
        if end.is_none_or(|end| self.scene.shape_info(end.shape).emitter.is_none()) {
            return constant(0.0);
        }
        let area = a.cross(b).length();
        let weight = LIGHT * ALBEDO * FRAC_1_PI * area * lamp / (distance * distance);
        let Some(w) = w else {
            return constant(weight * cos);
        };
        // Where the ray meets the plane of the face.
        let chair = self.is_chair(hit.shape);
        let q = self.point(hit.si.p, chair);
        let (o, n) = (constants(ray.o), constants(n));
        let to = self.tape.sub3(q, o);
        let (height, slope) = (self.tape.dot(to, n), self.tape.dot(w, n));
        let t = self.tape.div(height, slope);
        let along = self.tape.scale(w, t);
        let p = self.tape.add3(o, along);
        let light = self.follow(&shadow, p, aside);
        let cos = self.tape.dot(n, light.w);
        let spread = self.tape.add(constant(1.0), light.divergence);
        let value = self.tape.mul(cos, spread);
        self.tape.mul(value, constant(weight))
    }

    /// Records a sample of a pixel.
    fn sample(&mut self, pixel: [u32; 2], index: u64, seed: u64, scale: f64) {
        let size = self.scene.film.crop_size;
        let number = u64::from(pixel[1] * size[0] + pixel[0]);
        let numbers =
            |k: u64| Independent::spread(Points::Independent, seed ^ (k << 40), number, index);
        let (mut path, mut aside) = (numbers(0), numbers(1));
        let camera = &self.scene.camera;
        let origin = constants(Vec3::from(camera.origin()));

        // ---- The pixel ----
        let [u, v]: [f64; 2] = path.next_2d();
        let film = [f64::from(pixel[0]) + u, f64::from(pixel[1]) + v];
        let ray = camera.ray(film[0], film[1]);
        let seen = self.follow(&ray, origin, &mut aside);
        let l = self.radiance(&ray, Some(seen.w), &mut path, &mut aside);
        let forward = camera
            .ray(f64::from(size[0]) / 2.0, f64::from(size[1]) / 2.0)
            .d;
        let log_area = forward * (-3.0 / forward.dot(ray.d));
        let moved = self.tape.sub3(seen.w, constants(ray.d));
        let area = self.tape.dot(moved, constants(log_area));
        let spread = self.tape.add(area, seen.divergence);
        let spread = self.tape.add(constant(1.0), spread);
        let value = self.tape.mul(l, spread);
        self.count(value, scale);

        // ---- A border ----
        let mut border = numbers(2);
        let mut aside = numbers(3);
        let [u, v]: [f64; 2] = border.next_2d();
        let first = [pixel[0] == 0, pixel[1] == 0];
        let sides = [(0, true), (1, true), (0, false), (1, false)];
        let sides: Vec<(usize, bool)> = sides
            .into_iter()
            .filter(|(axis, after)| *after || first[*axis])
            .collect();
        let length = sides.len() as f64;
        let (axis, after) = sides[((u * length) as usize).min(sides.len() - 1)];
        // What leaves one pixel of the mean image for another one stays in it.
        if after && pixel[axis] + 1 < size[axis] {
            return;
        }
        let mut at = pixel.map(f64::from);
        at[axis] += f64::from(u8::from(after));
        at[1 - axis] += v;
        let ray = camera.ray(at[0], at[1]);
        let seen = self.follow(&ray, origin, &mut aside);
        let l = self.radiance(&ray, None, &mut border, &mut aside).value;
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
        let sign = if after { -1.0 } else { 1.0 };
        self.count(speed, sign * l * length * scale);
    }

    fn count(&mut self, value: Number, scale: f64) {
        let value = self.tape.mul(value, constant(scale));
        self.sum = self.tape.add(self.sum, value);
    }
}

/// The same derivative by a tape of at most about so many bytes; the derivative, and how many passes it took.
fn by_tape(scene: &Scene, seed: u64, spp: u64, budget: usize) -> (f64, u32) {
    let [width, height] = scene.film.crop_size;
    let scale = 1.0 / (f64::from(width * height) * spp as f64);
    let mut taped = Taped::new(scene);
    let (mut derivative, mut passes) = (0.0, 1);
    for index in 0..spp {
        for pixel in (0..height).flat_map(|y| (0..width).map(move |x| [x, y])) {
            if taped.tape.bytes() > budget {
                derivative += taped.tape.walk_back(taped.sum, taped.x);
                taped = Taped::new(scene);
                passes += 1;
            }
            taped.sample(pixel, index, seed, scale);
        }
    }
    (
        derivative + taped.tape.walk_back(taped.sum, taped.x),
        passes,
    )
}

/// `zeltner-4-23`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let budget: usize = fig.pick(32 << 20, 1 << 30);
    let spp: u64 = 4;
    let sizes: &[u32] = fig.pick(&[16, 32, 64], &[16, 32, 64, 128, 256]);
    fig.note("budget of the tape, bytes", budget as u64);
    fig.note("samples per pixel", spp);
    fig.note("seed", SEED);
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;

    // ---- The same estimator ----
    let small = scene(16)?;
    let runs_spp = fig.pick(16, 2048);
    // A quick run cannot tell the derivative from zero.
    let sure = fig.pick(f64::INFINITY, 0.3);
    let paths: Result<Vec<f64>> = (0..RUNS)
        .map(|k| by_paths(&small, SEED + k, runs_spp))
        .collect();
    let paths = paths?;
    let tape: Vec<f64> = (0..RUNS)
        .map(|k| by_tape(&small, SEED + 100 + k, runs_spp, budget).0)
        .collect();
    let [a, b] = [&paths, &tape].map(|v| Estimate::of(v.iter().copied()));
    let z = a.z(&b);
    let most = limit(1, RUNS, LEVEL);
    fig.check(
        "both have the same derivative",
        z.abs() < most && a.error <= sure * a.mean.abs(),
        format!(
            "{:.5} +- {:.5} and {:.5} +- {:.5}, z {z:.2}",
            a.mean, a.error, b.mean, b.error
        ),
    );
    let ratio = (a.error / b.error).powi(2);
    // Of so few runs, a variance is known to a factor of about two.
    fig.check(
        "and the same variance, as far as twelve runs tell",
        (0.2..5.0).contains(&ratio),
        format!("ratio {ratio:.2}"),
    );

    // ---- Time and memory ----
    let mut rows = Vec::new();
    for &size in sizes {
        let scene = scene(size)?;
        let start = Instant::now();
        let run = || alone.install(|| by_paths(&scene, SEED, spp).map_err(|e| e.to_string()));
        let (found, bytes) = memory::peak(run);
        found?;
        let seconds = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let ((_, passes), taped) = memory::peak(|| by_tape(&scene, SEED, spp, budget));
        let mib = |b: usize| b as f64 / f64::from(1 << 20);
        let samples = f64::from(size * size) * spp as f64;
        let tape_seconds = start.elapsed().as_secs_f64();
        rows.push([
            samples,
            seconds,
            mib(bytes),
            tape_seconds,
            mib(taped),
            f64::from(passes),
        ]);
    }
    let [first, last] = [rows[0], rows[rows.len() - 1]];
    let growth = last[0] / first[0];
    fig.check(
        "the memory of adjoints along paths does not depend on the resolution, but for the image",
        last[2] > 0.0 && last[2] < first[2] + 1.0 + last[0] / spp as f64 * 3e-5,
        format!(
            "{:.2} MiB and {:.2} MiB for {growth} times as many pixels",
            first[2], last[2]
        ),
    );
    let whole: Vec<_> = rows.iter().filter(|r| r[5] == 1.0).collect();
    let per_sample: Vec<f64> = whole.iter().map(|r| r[4] / r[0]).collect();
    let least = per_sample.iter().fold(f64::INFINITY, |m, p| m.min(*p));
    let largest = per_sample.iter().fold(0.0f64, |m, p| m.max(*p));
    fig.check(
        "that of the tape is in proportion to the samples, until a budget makes it take several passes",
        whole.len() >= 2 && largest < 3.0 * least && last[5] > 1.0,
        format!(
            "{:.1} to {:.1} KiB per sample, {} passes for the largest image",
            1024.0 * least, 1024.0 * largest, last[5]
        ),
    );
    let exponent = (last[1] / first[1]).ln() / growth.ln();
    // The first passes of a quick run take milliseconds.
    let proportional = fig.pick(0.5..1.3, 0.75..1.15);
    fig.check(
        "the time of adjoints along paths is in proportion to the samples",
        proportional.contains(&exponent),
        format!(
            "exponent {exponent:.2}; {:.1} us per sample, the tape {:.1} us",
            1e6 * last[1] / last[0],
            1e6 * last[3] / last[0]
        ),
    );
    let column = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let chart = LineChart::new("Time of a derivative in a position", "samples", "seconds")
        .log_x()
        .log_y()
        .measured("along paths", column(1))
        .measured("tape", column(3));
    fig.chart("time", &chart);
    let chart = LineChart::new("Memory of a derivative in a position", "samples", "MiB")
        .log_x()
        .log_y()
        .measured("along paths", column(2))
        .measured("tape", column(4));
    fig.chart("memory", &chart);
    let names = [
        "samples",
        "seconds",
        "MiB",
        "tape seconds",
        "tape MiB",
        "tape passes",
    ];
    fig.csv("costs", &names, rows);
    Ok(())
}
