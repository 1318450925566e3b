//! Light sources: lookups against formulas, samples against densities, and what must not break.

use std::f64::consts::PI;
use std::path::Path;

use ad_core::{Const, Dual, Float, Real, Vec3};
use render::bsdf::Diffuse;
use render::camera::{Camera, FovAxis};
use render::emitter::{
    AnyEmitter, Area, Ball, Constant, Emitter, EmitterSample, Envmap, Moved, Point, Spot, Vmf,
};
use render::film::Image;
use render::image_io;
use render::math::{Frame, Transform, warp};
use render::params::{GradSink, ParamRef, Tangent, Theta};
use render::plugin::xml::Document;
use render::sampler::{Independent, Sampler};
use render::scene::{Builder, Settings};
use render::shape::{Patch, Rectangle, Shape, Sphere};
use render::statistics::{p_value, sidak, z_limit};
use render::{Film, Scene, SceneError};

const POSITIVE: (f64, f64) = (0.0, f64::INFINITY);

/// A scene with a sphere, a rectangle, and emitters: `make` gets the index of the sphere.
fn scene(make: impl FnOnce(&mut Builder, u32) -> Vec<AnyEmitter>) -> Scene {
    let mut build = Builder::new();
    let reflectance = build.rgb("grey", [0.5; 3], (0.0, 1.0)).unwrap();
    let grey = build.add_material(Diffuse { reflectance });
    let ball = Sphere::new([0.0, 0.0, 3.0], 0.5, false).unwrap();
    let ball = build.add_shape("ball", ball, grey);
    for emitter in make(&mut build, ball) {
        build.add_emitter(emitter, None);
    }
    let film = Film::new(1, 1);
    let camera = Camera::new(Transform::IDENTITY, 40.0, FovAxis::X, film.size).unwrap();
    build.build(camera, film, Settings::default()).unwrap()
}

/// An image of `width` x `height` texels with every number in (0, 4).
fn noise(width: usize, height: usize, seed: u64) -> Image {
    let mut image = Image::new(width, height);
    for (i, x) in image.data.iter_mut().enumerate() {
        *x = 4.0 * Independent::new(seed, 0, i as u64).next_1d::<f32>().powi(3);
    }
    image
}

fn turned() -> Transform {
    Transform::sequence([
        Transform::rotate([0.3, 1.0, 0.2], 50.0).unwrap(),
        Transform::scale([-2.0; 3]),
    ])
}

/// Environments under test, with names.
fn environments() -> (Scene, Vec<&'static str>) {
    let names = vec![
        "constant",
        "map",
        "turned map",
        "spiky map",
        "black map",
        "one texel",
        "two texels",
        "wide vmf",
        "narrow vmf",
    ];
    let scene = scene(|b, _| {
        let grey = |b: &mut Builder| b.rgb("radiance", [1.0, 2.0, 3.0], POSITIVE).unwrap();
        let map = |b: &mut Builder, image: &Image, t: Transform| -> AnyEmitter {
            Envmap::new(b.registry(), "env", image, &t, 0.5)
                .unwrap()
                .into()
        };
        let mut spiky = Image::new(16, 8);
        spiky.data[3 * (5 * 16 + 15)..][..3].fill(1e4);
        let identity = Transform::IDENTITY;
        vec![
            Constant { radiance: grey(b) }.into(),
            map(b, &noise(6, 5, 1), identity),
            map(b, &noise(7, 4, 2), turned()),
            map(b, &spiky, identity),
            map(b, &Image::new(4, 3), identity),
            map(b, &noise(1, 1, 3), identity),
            map(b, &noise(2, 1, 4), identity),
            Vmf::new(grey(b), [1.0, -2.0, 0.5], 0.8).unwrap().into(),
            Vmf::new(grey(b), [0.0, 0.3, -1.0], 30.0).unwrap().into(),
        ]
    });
    (scene, names)
}

fn cell_direction(i: f64, rows: f64, j: f64, columns: f64) -> Vec3<f64> {
    let z = 1.0 - 2.0 * i / rows;
    let phi = 2.0 * PI * j / columns;
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * phi.cos(), r * phi.sin(), z)
}

/// Directions counted in bins, to be compared with a density.
struct Histogram {
    observed: Vec<f64>,
    n: f64,
}

impl Histogram {
    const ROWS: usize = 24;
    const COLUMNS: usize = 36;

    fn of(directions: impl Iterator<Item = Vec3<f64>>) -> Self {
        let (mut observed, mut n) = (vec![0.0; Self::ROWS * Self::COLUMNS], 0.0);
        for d in directions {
            let row = (0.5 * (1.0 - d.z) * Self::ROWS as f64) as usize;
            let turn = d.y.atan2(d.x).rem_euclid(2.0 * PI) / (2.0 * PI);
            let column = ((turn * Self::COLUMNS as f64) as usize).min(Self::COLUMNS - 1);
            observed[row.min(Self::ROWS - 1) * Self::COLUMNS + column] += 1.0;
            n += 1.0;
        }
        Self { observed, n }
    }

    /// Probability of a chi-square statistic as large as that of the counts against `density`, integrated by
    /// quadrature; its integral is one.
    fn p_value(self, name: &str, density: impl Fn(Vec3<f64>) -> f64) -> f64 {
        const FINE: usize = 40;
        let bins = Self::ROWS * Self::COLUMNS;
        let area = 4.0 * PI / (bins * FINE * FINE) as f64;
        let (mut total, mut counts) = (0.0, Vec::with_capacity(bins));
        for (cell, o) in self.observed.into_iter().enumerate() {
            let mut e = 0.0;
            for fine in 0..FINE * FINE {
                let i = (cell / Self::COLUMNS) as f64 + ((fine / FINE) as f64 + 0.5) / FINE as f64;
                let j = (cell % Self::COLUMNS) as f64 + ((fine % FINE) as f64 + 0.5) / FINE as f64;
                e += area
                    * density(cell_direction(
                        i,
                        Self::ROWS as f64,
                        j,
                        Self::COLUMNS as f64,
                    ));
            }
            total += e;
            counts.push((o, e * self.n));
        }
        assert!(
            (total - 1.0).abs() < 1e-3,
            "{name}: density integrates to {total}"
        );
        p_value(counts)
    }
}

/// Chi-square of sampled directions against the density; 60 000 samples, significance 1 % over all
/// environments.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn environments_are_sampled_by_their_density() {
    let (scene, names) = environments();
    let limit = sidak(names.len(), 0.01);
    let origin = Vec3::<f64>::zero();
    for (k, (emitter, name)) in scene.emitters().iter().zip(names).enumerate() {
        let directions = (0..60_000).map(|i| {
            let u = Independent::new(1, k as u64, i).next_2d();
            let s = emitter.sample(scene.lights(), origin, u).unwrap();
            let pdf = emitter.pdf(scene.lights(), origin, s.d, None);
            assert!(
                (pdf / s.pdf - 1.0).abs() < 1e-5,
                "{name}: {pdf} for {}",
                s.pdf
            );
            assert_eq!(s.distance, f64::INFINITY);
            s.d
        });
        let density = |d| emitter.pdf(scene.lights(), origin, d, None);
        let p = Histogram::of(directions).p_value(name, density);
        assert!(p > limit, "{name}: p = {p}");
    }
}

/// Particles start by the densities that they state, in position and direction: chi-square of 60 000 of each
/// kind, significance 1 % over all. Positions are mapped to a sphere so that equal areas stay equal.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn particles_start_by_their_densities() {
    const N: u64 = 60_000;
    let (around, names) = environments();
    let mut tests: Vec<(String, f64)> = Vec::new();
    let start = |scene: &Scene, k: usize, i: u64| {
        let mut numbers = Independent::new(31, k as u64, i);
        let [a, b] = numbers.next_2d::<f64>();
        let [c, d] = numbers.next_2d::<f64>();
        let ball = Ball::around(scene.shapes());
        let e = &scene.emitters()[k];
        let start = e
            .sample_ray(&Theta::still(), scene.lights(), ball, [a, b, c, d])
            .unwrap();
        if !e.is_infinite() {
            let si = start.surface.as_ref().map(|(_, si)| si);
            let (emission, pdf) = e.leaves(start.ray.d, si).unwrap();
            assert!((pdf / start.pdf_direction - 1.0).abs() < 1e-9);
            assert!((emission.falloff - start.emission.falloff).abs() < 1e-9);
            assert_eq!(emission.uv, start.emission.uv);
        }
        start
    };
    let uniform = |_| 0.25 / PI;
    // A place on the unit disc.
    let disc = |x: f64, y: f64| {
        let turn = y.atan2(x);
        let z: f64 = 1.0 - 2.0 * (x * x + y * y);
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * turn.cos(), r * turn.sin(), z)
    };

    let ball = Ball::around(around.shapes()).unwrap();
    let (centre, radius) = (Vec3::from(ball.centre), ball.radius);
    for (k, name) in names.into_iter().enumerate() {
        let e = &around.emitters()[k];
        let density = |d| e.pdf(around.lights(), Vec3::zero(), d, None);
        let directions = (0..N).map(|i| {
            let s = start(&around, k, i);
            assert!((s.pdf_direction / density(-s.ray.d) - 1.0).abs() < 1e-5);
            assert!((s.pdf_position * PI * radius * radius - 1.0).abs() < 1e-9);
            -s.ray.d
        });
        let p = Histogram::of(directions).p_value(name, density);
        tests.push((format!("{name}, direction"), p));
        let positions = (0..N).map(|i| {
            let s = start(&around, k, i);
            let local = Frame::from_normal(-s.ray.d).to_local(s.ray.o - centre) * radius.recip();
            assert!((local.z - 1.0).abs() < 1e-6, "{name}: {local:?}");
            disc(local.x, local.y)
        });
        let p = Histogram::of(positions).p_value(name, uniform);
        tests.push((format!("{name}, position"), p));
    }

    let at = [0.5, -1.0, 2.0];
    let axis = Vec3::new(0.6, 0.0, 0.8);
    let near = scene(|b, sphere| {
        let mut white = |name: &str| b.rgb(name, [1.0; 3], POSITIVE).unwrap();
        let mut area = |exponent, shape| {
            let radiance = white("area");
            Area {
                radiance,
                exponent,
                shape,
            }
        };
        let lights: Vec<AnyEmitter> = vec![
            area(0.0, sphere).into(),
            area(30.0, sphere).into(),
            area(0.0, sphere + 1).into(),
            area(3.0, sphere + 1).into(),
            Point::new(white("point"), at.map(|x| x as f32)).into(),
            Spot::new(white("spot"), at, axis.to_array(), 40.0, 60.0)
                .unwrap()
                .into(),
        ];
        let grey = b.rgb("board", [0.5; 3], (0.0, 1.0)).unwrap();
        let sides = [[4.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let board = Patch::new([-2.0, -0.5, 0.0], sides[0], sides[1], false).unwrap();
        let grey = b.add_material(Diffuse { reflectance: grey });
        assert_eq!(b.add_shape("board", Rectangle(board), grey), sphere + 1);
        lights
    });
    let lobe =
        |exponent: f64| move |z: f64| 0.5 * (exponent + 2.0) / PI * z.max(0.0).powf(exponent + 1.0);
    let cone = |z: f64| if z > 0.5 { 1.0 / PI } else { 0.0 };
    type Profile = Box<dyn Fn(f64) -> f64>;
    let densities: [(&str, Profile); 6] = [
        ("ball light", Box::new(lobe(0.0))),
        ("ball of lobes", Box::new(lobe(30.0))),
        ("board", Box::new(lobe(0.0))),
        ("board of lobes", Box::new(lobe(3.0))),
        ("point", Box::new(|_| 0.25 / PI)),
        ("spot", Box::new(cone)),
    ];
    for (k, (name, density)) in densities.into_iter().enumerate() {
        let directions = (0..N).map(|i| {
            let s = start(&near, k, i);
            let frame = match &s.surface {
                Some((_, si)) => si.frame,
                None => Frame::from_normal(axis),
            };
            let d = frame.to_local(s.ray.d);
            assert!(
                (s.pdf_direction / density(d.z) - 1.0).abs() < 1e-5,
                "{name}"
            );
            d
        });
        let p = Histogram::of(directions).p_value(name, |d| density(d.z));
        tests.push((format!("{name}, direction"), p));
        let positions = (0..N).filter_map(|i| {
            let s = start(&near, k, i);
            let Some((shape, si)) = &s.surface else {
                assert_eq!(s.pdf_position, 1.0);
                assert!((s.ray.o - Vec3::from(at)).length() < 1e-6);
                return None;
            };
            assert_eq!(s.ray.o, si.p);
            if *shape == 0 {
                assert!((s.pdf_position * 4.0 * PI * 0.25 - 1.0).abs() < 1e-6);
                return Some((si.p - Vec3::new(0.0, 0.0, 3.0)) * 2.0);
            }
            assert!(
                (s.pdf_position * 4.0 - 1.0).abs() < 1e-6,
                "{}",
                s.pdf_position
            );
            let (x, y) = (0.25 * si.p.x + 0.5, si.p.y + 0.5);
            Some(cell_direction(x, 1.0, y, 1.0))
        });
        let positions = Histogram::of(positions);
        if positions.n > 0.0 {
            tests.push((
                format!("{name}, position"),
                positions.p_value(name, uniform),
            ));
        }
    }
    assert_eq!(tests.len(), 2 * 9 + 2 * 4 + 2);
    let limit = sidak(tests.len(), 0.01);
    for (name, p) in tests {
        assert!(p > limit, "{name}: p = {p}");
    }
}

/// Luminance over density hardly varies: an environment is importance sampled.
#[test]
fn maps_are_sampled_by_luminance() {
    let (scene, names) = environments();
    for (emitter, name) in scene.emitters().iter().zip(names) {
        if !name.ends_with("map") || name == "black map" {
            continue;
        }
        let values: Vec<f64> = scene.params().values().iter().map(|&x| x.into()).collect();
        let theta = Theta::<f64>::constant(&values);
        let (mut sum, mut squares, n) = (0.0, 0.0, 20_000);
        for i in 0..n {
            let u = Independent::new(2, 0, i).next_2d();
            let s = emitter.sample(scene.lights(), Vec3::zero(), u).unwrap();
            let x: f64 = emitter.eval(&theta, &s.emission).luminance() / s.pdf;
            sum += x;
            squares += x * x;
        }
        let relative = squares * n as f64 / (sum * sum) - 1.0;
        // Uniform directions: from 0.5 up to 60 for the spike.
        assert!(relative < 0.12, "{name}: relative variance {relative}");
    }
}

/// Mitsuba's lookup, written down independently: u W - 1/2 periodic, v (H - 1).
fn lookup(image: &Image, d: Vec3<f64>) -> [f64; 3] {
    let (w, h) = (image.width as f64, image.height as f64);
    let x = d.x.atan2(-d.z) / (2.0 * PI) * w - 0.5;
    let y = d.y.clamp(-1.0, 1.0).acos() / PI * (h - 1.0);
    let row = (y.floor() as usize).min(image.height.saturating_sub(2));
    let fy = y - row as f64;
    let (column, fx) = (x.floor(), x - x.floor());
    [0, 1, 2].map(|c| {
        let texel = |i: usize, j: f64| {
            let j = j.rem_euclid(w) as usize;
            f64::from(image.pixel(j, i.min(image.height - 1))[c])
        };
        let line = |i: usize| texel(i, column) * (1.0 - fx) + texel(i, column + 1.0) * fx;
        line(row) * (1.0 - fy) + line(row + 1) * fy
    })
}

#[test]
fn maps_are_looked_up_as_by_mitsuba() {
    let image = noise(6, 5, 1);
    let scene = scene(|b, _| {
        let t = Transform::IDENTITY;
        vec![
            Envmap::new(b.registry(), "env", &image, &t, 0.5)
                .unwrap()
                .into(),
            Envmap::new(b.registry(), "turned", &image, &turned(), 0.5)
                .unwrap()
                .into(),
        ]
    });
    let values: Vec<f64> = scene.params().values().iter().map(|&x| x.into()).collect();
    let theta = Theta::<f64>::constant(&values);
    let eval = |k: usize, d: Vec3<f64>| {
        let e = &scene.emitters()[k];
        e.eval(&theta, &e.hit(d, None).unwrap()).to_array()
    };
    let back = turned().inverse().unwrap();
    for i in 0..2000 {
        let d: Vec3<f64> = warp::square_to_sphere(Independent::new(3, 0, i).next_2d());
        let expected = lookup(&image, d).map(|x| 0.5 * x);
        let local = Vec3::from(back.vector(d.to_array())).normalize();
        let turned = lookup(&image, local).map(|x| 0.5 * x);
        for c in 0..3 {
            assert!((eval(0, d)[c] - expected[c]).abs() < 1e-5, "{d:?}");
            assert!((eval(1, d)[c] - turned[c]).abs() < 1e-5, "{d:?}");
        }
    }
    // By hand: texel (row 2, column 1) of 5 x 6 lies at v = 1/2, u = 1/4, which is +x.
    let texel = image.pixel(1, 2);
    assert!((eval(0, Vec3::new(1.0, 0.0, 0.0))[0] - 0.5 * f64::from(texel[0])).abs() < 1e-5);
    // The poles are the means of two texels of the first and the last row, next to u = 0.
    for (y, row) in [(1.0, 0), (-1.0, 4)] {
        let mean = 0.5 * (image.pixel(0, row)[1] + image.pixel(5, row)[1]);
        let found = eval(0, Vec3::new(0.0, y, -1e-9))[1];
        assert!(
            (found - 0.5 * f64::from(mean)).abs() < 1e-5,
            "{found} {mean}"
        );
    }
}

/// Collects adjoints of all parameters.
struct Gradient(Vec<f64>, Vec<usize>);

impl GradSink<f64> for Gradient {
    fn active(&self, _: ParamRef) -> bool {
        true
    }
    fn add(&mut self, p: ParamRef, i: usize, d: f64) {
        self.0[self.1[p.id as usize] + i] += d;
    }
}

/// F7: the derivative with respect to a texel that is zero, of the light on a horizontal plane, is
/// the integral of the texel's footprint times the cosine; no sampling density may miss it. Among two
/// texels interpolation reaches everywhere, so the map has four, and one that shines.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn dark_texels_can_be_switched_on() {
    let mut image = Image::new(4, 1);
    image.data[..3].fill(1.0);
    let scene = scene(|b, _| {
        let map = Envmap::new(b.registry(), "env", &image, &Transform::IDENTITY, 1.0).unwrap();
        vec![map.into()]
    });
    let emitter = &scene.emitters()[0];
    let offsets: Vec<usize> = scene.params().infos().iter().map(|i| i.offset).collect();
    let first = scene.params().find("env.data").unwrap().offset;
    // Faces texel 2, so that the dark side counts.
    let normal = Vec3::new(-0.6, 0.0, 0.8);
    let n = 400_000;
    let (mut sum, mut squares) = ([0.0; 4], [0.0; 4]);
    let values: Vec<f64> = scene.params().values().iter().map(|&x| x.into()).collect();
    let theta = Theta::constant(&values);
    let mut gradient = Gradient(vec![0.0; scene.params().values().len()], offsets);
    for i in 0..n {
        let u = Independent::new(4, 0, i).next_2d();
        let s = emitter
            .sample(scene.lights(), Vec3::<f64>::zero(), u)
            .unwrap();
        gradient.0.fill(0.0);
        let one = render::math::Rgb::splat(normal.dot(s.d).max(0.0) / s.pdf);
        emitter.backward(&theta, &s.emission, one, &mut gradient);
        for k in 0..4 {
            let x = gradient.0[first + 3 * k];
            sum[k] += x;
            squares[k] += x * x;
        }
    }
    let (mut expected, m) = ([0.0; 4], 1000);
    for i in 0..m {
        for j in 0..m {
            let [z, phi] = [i, j].map(|i| (f64::from(i) + 0.5) / f64::from(m));
            let d = cell_direction(z, 1.0, phi, 1.0);
            let column = (d.x.atan2(-d.z) / (2.0 * PI)).rem_euclid(1.0) * 4.0 - 0.5;
            for (k, e) in expected.iter_mut().enumerate() {
                let off = (column - k as f64).rem_euclid(4.0);
                let weight = (1.0 - off.min(4.0 - off)).max(0.0);
                *e += weight * normal.dot(d).max(0.0) * 4.0 * PI / f64::from(m * m);
            }
        }
    }
    for k in 0..4 {
        let mean = sum[k] / n as f64;
        let error = ((squares[k] / n as f64 - mean * mean) / n as f64).sqrt();
        let z = (mean - expected[k]) / error;
        let found = format!("{mean} +- {error}, expected {}", expected[k]);
        assert!(
            z.abs() < z_limit(4, n, 1e-3) && error < 0.03,
            "texel {k}: {found}"
        );
    }
    assert!(expected[2] > 1.0, "{expected:?}");
}

/// Tables follow the parameters.
#[test]
fn maps_are_resampled_when_they_change() {
    let mut scene = scene(|b, _| {
        let t = Transform::IDENTITY;
        vec![
            Envmap::new(b.registry(), "env", &Image::new(8, 5), &t, 1.0)
                .unwrap()
                .into(),
        ]
    });
    let range = scene.params().find("env.data").unwrap().range();
    let mut values = scene.params().values().to_vec();
    // Row 2, column 1: +x is between columns 1 and 2.
    values[range.start + 3 * (2 * 8 + 1)..][..3].fill(10.0);
    let d = Vec3::new(
        (PI / 2.0 - PI / 8.0).sin(),
        0.0,
        -(PI / 2.0 - PI / 8.0).cos(),
    );
    let pdf = |scene: &Scene| scene.emitters()[0].pdf::<f64>(scene.lights(), Vec3::zero(), d, None);
    assert!(
        (pdf(&scene) * 4.0 * PI - 1.0).abs() < 1e-5,
        "black is uniform"
    );
    scene.set_params(&values).unwrap();
    assert!(pdf(&scene) * 4.0 * PI > 10.0, "{}", pdf(&scene) * 4.0 * PI);
}

/// A map under test and its scene.
fn map(image: &Image) -> Scene {
    scene(|b, _| {
        vec![
            Envmap::new(b.registry(), "env", image, &turned(), 0.5)
                .unwrap()
                .into(),
        ]
    })
}

/// Attached samples must not jump [Zeltner 2021, section 4.2.2]: along both random numbers the direction is
/// continuous, across cells, bands and the seam. In steps of 1e-6 a density of at least 5 % of the uniform one
/// moves it by at most 0.01 (next to the poles), while cells are wider than 0.4.
#[test]
fn directions_are_continuous_in_random_numbers() {
    let (width, height) = (7, 5);
    let scene = map(&noise(width, height, 21));
    let sample = |u: [f64; 2]| {
        let s = scene.emitters()[0].sample(scene.lights(), Vec3::zero(), u);
        s.unwrap().d
    };
    for fixed in [0.1, 0.37, 0.8] {
        for along in 0..2 {
            let at = |i: u32| {
                let mut u = [fixed; 2];
                u[along] = f64::from(i) * 1e-6;
                sample(u)
            };
            let mut last = at(0);
            for i in 1..1_000_000 {
                let next = at(i);
                let jump = (next - last).length();
                assert!(jump < 0.01, "{fixed} {along} {i}: {jump}");
                last = next;
            }
        }
        assert!((sample([0.0, fixed]) - sample([1.0, fixed])).length() < 1e-5);
    }
}

/// With the random numbers held, directions, densities and what arrives follow the texels as differences of
/// [`Emitter::sample`] do, from tables that are rebuilt. Tables hold densities in f32: differences are good to a
/// thousandth. Kinks between cells spoil a few of them.
#[test]
fn samples_of_maps_follow_the_texels() {
    for (name, mut image) in [
        ("map", noise(6, 5, 1)),
        ("one row", noise(5, 1, 2)),
        ("two rows", noise(3, 2, 3)),
        ("one column", noise(1, 4, 4)),
    ] {
        // Bright enough for the step.
        image.data.iter_mut().for_each(|x| *x += 0.2);
        let mut scene = map(&image);
        let range = scene.params().find("env.data").unwrap().range();
        let before = scene.params().values().to_vec();
        let mut direction = vec![0.0; before.len()];
        for i in range.clone() {
            direction[i] = 2.0 * Independent::new(22, 1, i as u64).next_1d::<f64>() - 1.0;
        }
        let values: Vec<f64> = before.iter().map(|&x| x.into()).collect();
        let tangents: Vec<Tangent<Dual<f64, 1>>> = (scene.params().infos().iter())
            .map(|info| {
                let each = direction[info.range()].iter();
                Tangent::Dense(each.map(|d| Dual::new(0.0, [*d])).collect())
            })
            .collect();
        let theta = Theta::with_tangents(&values, &tangents);
        let u = |i: u64| Independent::new(23, 0, i).next_2d::<f64>();
        let numbers = |s: &EmitterSample<f64>| {
            let (d, uv) = (s.d, s.emission.uv);
            let turn = 2.0 * PI * uv.x;
            [d.x, d.y, d.z, s.pdf, turn.cos(), turn.sin(), uv.y]
        };
        const N: u64 = 400;
        let moved: Vec<[Dual<f64, 1>; 7]> = (0..N)
            .map(|i| {
                let e = scene.emitters()[0].moving().unwrap();
                let drawn = e.moving_draw(u(i)).unwrap();
                let m = e.moved(&drawn, &theta, &e.shift(&theta).unwrap());
                let Moved {
                    d, pdf, emission, ..
                } = m;
                let turn = emission.uv.x * Const(2.0 * PI);
                [d.x, d.y, d.z, pdf, turn.cos(), turn.sin(), emission.uv.y]
            })
            .collect();
        let h = 4e-3;
        let mut shifted = |h: f64| -> Vec<[f64; 7]> {
            let v: Vec<f32> = (before.iter().zip(&direction))
                .map(|(v, d)| (f64::from(*v) + h * d) as f32)
                .collect();
            scene.set_params(&v).unwrap();
            let e = &scene.emitters()[0];
            let sample = |i| e.sample(scene.lights(), Vec3::zero(), u(i)).unwrap();
            (0..N).map(|i| numbers(&sample(i))).collect()
        };
        let (plus, minus) = (shifted(h), shifted(-h));
        let mut off = 0;
        for (m, (p, q)) in moved.iter().zip(plus.iter().zip(&minus)) {
            let expected: Vec<f64> = p.iter().zip(q).map(|(p, q)| (p - q) / (2.0 * h)).collect();
            let size: f64 = expected.iter().map(|x| x.abs()).sum();
            let near = |(m, e): (&Dual<f64, 1>, &f64)| (m.eps[0] - e).abs() < 2e-3 * (0.1 + size);
            off += u32::from(!m.iter().zip(&expected).all(near));
        }
        assert!(off < 20, "{name}: {off} of {N} differ");
        let motion: f64 = moved.iter().map(|m| m[0].eps[0].abs()).sum();
        assert!(motion > 0.0 || name == "one column", "{name} stands still");
    }
}

/// A common factor of all texels moves nothing; it only changes what arrives.
#[test]
fn samples_stand_still_when_a_map_is_scaled() {
    type D = Dual<f64, 1>;
    let image = noise(9, 6, 24);
    let scene = map(&image);
    let e = scene.emitters()[0].moving().unwrap();
    let values: Vec<f64> = scene.params().values().iter().map(|&x| x.into()).collect();
    let tangents: Vec<Tangent<D>> = (scene.params().infos().iter())
        .map(|i| {
            Tangent::Dense(
                values[i.range()]
                    .iter()
                    .map(|v| D::new(0.0, [*v]))
                    .collect(),
            )
        })
        .collect();
    let theta = Theta::with_tangents(&values, &tangents);
    let shift = e.shift(&theta).unwrap();
    for i in 0..500 {
        let drawn = e
            .moving_draw::<f64>(Independent::new(25, 0, i).next_2d())
            .unwrap();
        let m = e.moved(&drawn, &theta, &shift);
        for x in [m.d.x, m.d.y, m.d.z, m.pdf, m.frozen_pdf] {
            assert!(x.eps[0].abs() < 1e-6 * (1.0 + x.re.abs()), "{x:?}");
        }
    }
}

fn all_finite<R: Real>(m: &Moved<R>) -> bool {
    let uv = m.emission.uv;
    let numbers = [m.d.x, m.d.y, m.d.z, m.pdf, m.frozen_pdf, uv.x, uv.y];
    numbers.iter().all(|x| x.is_finite())
}

/// Motion is finite at the poles, in corners and for every map: dark, bright, with one row or one texel.
#[test]
fn motion_is_finite() {
    fn sweep<P: Float>(scene: &Scene, name: &str) {
        let values: Vec<P> = (scene.params().values().iter())
            .map(|&x| P::from_f32(x))
            .collect();
        let tangents: Vec<Tangent<Dual<P, 1>>> = (scene.params().infos().iter())
            .map(|_| Tangent::Uniform(Dual::new(P::zero(), [P::one()])))
            .collect();
        let theta = Theta::with_tangents(&values, &tangents);
        let e = scene.emitters()[0].moving().unwrap();
        let last = P::one() - P::EPSILON;
        let unit = [
            P::zero(),
            P::MIN_POSITIVE,
            P::EPSILON,
            P::of(0.25),
            P::of(0.5),
            last,
        ];
        for a in unit {
            for b in unit {
                let Some(drawn) = e.moving_draw([a, b]) else {
                    assert!(name.starts_with("black"), "{name} stands still");
                    continue;
                };
                let m = e.vary::<P>(&drawn);
                assert!(all_finite(&m), "{name} {m:?}");
                let m = e.moved(&drawn, &theta, &e.shift(&theta).unwrap());
                assert!(all_finite(&m), "{name} {m:?}");
                let offsets: Vec<usize> = scene.params().infos().iter().map(|i| i.offset).collect();
                let mut grad = Gradient(vec![0.0; values.len()], offsets);
                let mut sums = vec![0.0; e.sums()];
                e.pull_back(&drawn, [1.0; 3], &mut grad, |_, i, d| sums[i] += d);
                e.fold(
                    &sums,
                    &mut grad.0[scene.params().find("env.data").unwrap().range()],
                );
                assert!(grad.0.iter().all(|x| x.is_finite()), "{name}");
            }
        }
    }
    let scaled = |k: f32| {
        let mut image = noise(6, 5, 26);
        image.data.iter_mut().for_each(|x| *x *= k);
        image
    };
    let mut spike = Image::new(16, 8);
    spike.data[3 * (5 * 16 + 15)..][..3].fill(1e4);
    for (name, image) in [
        ("map", scaled(1.0)),
        ("dark", scaled(1e-20)),
        ("black but for denormals", scaled(1e-41)),
        ("bright", scaled(1e30)),
        ("black", Image::new(4, 3)),
        ("black texel", Image::new(1, 1)),
        ("one texel", noise(1, 1, 3)),
        ("one row", noise(5, 1, 4)),
        ("one column", noise(1, 5, 5)),
        ("spike", spike),
    ] {
        let scene = map(&image);
        sweep::<f32>(&scene, name);
        sweep::<f64>(&scene, name);
    }
}

/// With a ball of radius r, radiance L and distance D that is all above the horizon, the irradiance is
/// pi L (r / D)^2 cos(theta). Samples from inside the cone all arrive.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn ball_lights_irradiate_as_they_should() {
    let scene = scene(|b, ball| {
        let radiance = b.rgb("l", [1.0; 3], POSITIVE).unwrap();
        vec![
            Area {
                radiance,
                exponent: 0.0,
                shape: ball,
            }
            .into(),
        ]
    });
    let light = &scene.emitters()[0];
    for (from, normal) in [
        ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
        ([2.0, 1.0, 1.5], [-0.6, 0.0, 0.8]),
    ] {
        let (from, normal) = (Vec3::from(from), Vec3::from(normal));
        let to = Vec3::new(0.0, 0.0, 3.0) - from;
        let exact = PI * 0.25 / to.length_squared() * normal.dot(to.normalize());
        let (mut sum, mut squares, n) = (0.0, 0.0, 20_000);
        for i in 0..n {
            let u = Independent::new(5, 0, i).next_2d();
            let s = light.sample::<f64>(scene.lights(), from, u);
            let x = s.map_or(0.0, |s| {
                s.emission.falloff * normal.dot(s.d).max(0.0) / s.pdf
            });
            sum += x;
            squares += x * x;
        }
        let mean = sum / n as f64;
        let error = ((squares / n as f64 - mean * mean).max(0.0) / n as f64).sqrt();
        assert!(
            (mean - exact).abs() < z_limit(2, n, 1e-3) * error + 1e-6,
            "{mean} +- {error}, exact {exact}"
        );
    }
}

#[test]
fn points_and_spots_follow_their_formulas() {
    let scene = scene(|b, _| {
        let mut white = |name: &str| b.rgb(name, [1.0; 3], POSITIVE).unwrap();
        let point = Point::new(white("p"), [0.0, 0.0, 2.0]);
        let spot = Spot::new(white("s"), [0.0, 0.0, 2.0], [0.0, 0.0, -3.0], 15.0, 20.0).unwrap();
        vec![point.into(), spot.into()]
    });
    let at = |k: usize, x: f64| -> Option<EmitterSample<f64>> {
        scene.emitters()[k].sample(scene.lights(), Vec3::new(x, 0.0, 0.0), [0.3, 0.7])
    };
    for e in scene.emitters() {
        assert!(e.is_delta() && !e.is_infinite());
        assert!(e.hit(Vec3::new(0.0, 0.0, 1.0), None).is_none());
        assert_eq!(
            e.pdf::<f64>(scene.lights(), Vec3::zero(), Vec3::new(0.0, 0.0, 1.0), None),
            0.0
        );
    }
    let s = at(0, 1.5).unwrap();
    assert!((s.distance - 2.5).abs() < 1e-12 && (s.emission.falloff - 0.16).abs() < 1e-12);
    assert_eq!(s.pdf, 1.0);
    for (degrees, profile) in [
        (0.0, 1.0),
        (14.9, 1.0),
        (17.0, 0.6),
        (19.0, 0.2),
        (19.999, 0.0002),
    ] {
        let x = 2.0 * f64::tan(f64::to_radians(degrees));
        let s = at(1, x).unwrap();
        let falloff = s.emission.falloff * (4.0 + x * x);
        assert!((falloff - profile).abs() < 1e-9, "{degrees}: {falloff}");
    }
    assert!(at(1, 2.0 * f64::tan(f64::to_radians(20.1))).is_none());
    // At the light itself nothing can be said.
    let here = Vec3::new(0.0, 0.0, 2.0);
    assert!(
        scene.emitters()[0]
            .sample::<f64>(scene.lights(), here, [0.5; 2])
            .is_none()
    );
    assert!(
        scene.emitters()[1]
            .sample::<f64>(scene.lights(), here, [0.5; 2])
            .is_none()
    );
}

/// What a sampled direction brings is what a ray in that direction finds.
#[test]
fn samples_and_hits_agree() {
    let (scene, names) = environments();
    let values: Vec<f64> = scene.params().values().iter().map(|&x| x.into()).collect();
    let theta = Theta::<f64>::constant(&values);
    for (emitter, name) in scene.emitters().iter().zip(names) {
        assert!(emitter.is_infinite() && !emitter.is_delta());
        for i in 0..2000 {
            let u = Independent::new(6, 0, i).next_2d();
            let s = emitter
                .sample::<f64>(scene.lights(), Vec3::zero(), u)
                .unwrap();
            let hit = emitter.hit(s.d, None).unwrap();
            let (a, b) = (
                emitter.eval(&theta, &s.emission),
                emitter.eval(&theta, &hit),
            );
            for c in 0..3 {
                let scale = 1e-4 * (1.0 + a[c].abs()) * if name == "spiky map" { 1e4 } else { 1.0 };
                assert!((a[c] - b[c]).abs() < scale, "{name}: {a:?} {b:?}");
            }
        }
    }
}

/// Lobes and maps move with the direction: duals against central differences.
#[test]
fn what_arrives_follows_the_direction() {
    type D = Dual<f64, 3>;
    let (scene, names) = environments();
    let values: Vec<f64> = scene.params().values().iter().map(|&x| x.into()).collect();
    for (emitter, name) in scene.emitters().iter().zip(names) {
        for i in 0..50 {
            let d: Vec3<f64> = warp::square_to_sphere(Independent::new(7, 0, i).next_2d());
            let red = |d: Vec3<f64>| {
                let theta = Theta::<f64>::constant(&values);
                emitter.eval(&theta, &emitter.hit(d, None).unwrap()).r
            };
            let theta = Theta::<D>::constant(&values);
            let moving = Vec3::new(D::var(d.x, 0), D::var(d.y, 1), D::var(d.z, 2));
            let dual = emitter.eval(&theta, &emitter.hit(moving, None).unwrap()).r;
            for (k, axis) in Transform::IDENTITY.linear.into_iter().enumerate() {
                let step = Vec3::from(axis) * 1e-6;
                let expected = (red(d + step) - red(d - step)) / 2e-6;
                let error = (dual.eps[k] - expected).abs();
                assert!(
                    error < 1e-5 * (1.0 + expected.abs()),
                    "{name} {k}: {} {expected}",
                    dual.eps[k]
                );
            }
        }
    }
}

/// Every emitter, from anywhere, in every scalar: finite, or nothing.
#[test]
fn nothing_is_infinite() {
    fn sweep<P: Float>(scene: &Scene, what: &str) {
        let last = P::one() - P::EPSILON;
        let unit = [P::zero(), P::EPSILON, P::of(0.25), P::of(0.5), last];
        let ball = &scene.shapes()[0];
        let mut origins = vec![
            Vec3::<P>::zero(),
            Vec3::splat(P::of(1e6)),
            Vec3::new(P::zero(), P::zero(), P::of(3.0)),
        ];
        for i in 0..20 {
            let s = ball.sample_area::<P>(&Theta::still(), Independent::new(8, 0, i).next_2d());
            origins.extend([
                s.p,
                s.p - s.n * P::of(1e-6),
                s.p + s.n * P::of(1e-6),
                s.p - s.n * P::of(0.1),
            ]);
        }
        for e in scene.emitters() {
            for &from in &origins {
                for a in unit {
                    for b in unit {
                        let Some(s) = e.sample(scene.lights(), from, [a, b]) else {
                            continue;
                        };
                        assert!(
                            s.d.is_finite() && (s.d.length() - P::one()).abs() < P::of(1e-3),
                            "{what} {s:?}"
                        );
                        assert!(s.pdf.is_finite() && s.pdf >= P::zero(), "{what} {s:?}");
                        assert!(s.emission.falloff.is_finite(), "{what} {s:?}");
                        assert!(s.emission.uv.x.is_finite() && s.emission.uv.y.is_finite());
                        assert!(s.distance > P::zero(), "{what} {s:?}");
                    }
                }
            }
            for d in [
                [0.0, 1.0, 0.0],
                [0.0, -1.0, 0.0],
                [0.0, 0.0, 1.0],
                [0.0, 0.0, -1.0],
                [1.0, 0.0, 0.0],
            ] {
                let d = Vec3::from(d.map(P::of));
                assert!(e.pdf(scene.lights(), Vec3::zero(), d, None).is_finite());
                if let Some(hit) = e.hit(d, None) {
                    assert!(
                        hit.falloff.is_finite() && hit.uv.x.is_finite() && hit.uv.y.is_finite()
                    );
                }
            }
        }
    }
    let (environments, _) = environments();
    let local = scene(|b, ball| {
        let mut white = |name: &str| b.rgb(name, [1.0; 3], POSITIVE).unwrap();
        vec![
            Area {
                radiance: white("a"),
                exponent: 0.0,
                shape: ball,
            }
            .into(),
            Area {
                radiance: white("b"),
                exponent: 30.0,
                shape: ball,
            }
            .into(),
            Point::new(white("p"), [0.0; 3]).into(),
            Spot::new(white("s"), [0.0; 3], [0.0, 1.0, 0.0], 0.0, 180.0)
                .unwrap()
                .into(),
        ]
    });
    sweep::<f32>(&environments, "environment f32");
    sweep::<f64>(&environments, "environment f64");
    sweep::<f32>(&local, "local f32");
    sweep::<f64>(&local, "local f64");
}

#[test]
fn the_lobe_has_the_power_it_should() {
    // 2 pi (1 - exp(-2 kappa)) / kappa
    let (scene, names) = environments();
    for (emitter, name) in scene.emitters().iter().zip(names) {
        let kappa = match name {
            "wide vmf" => 0.8f64,
            "narrow vmf" => 30.0,
            _ => continue,
        };
        let exact = 2.0 * PI * (1.0 - (-2.0 * kappa).exp()) / kappa;
        let s = emitter
            .sample::<f64>(scene.lights(), Vec3::zero(), [0.4, 0.1])
            .unwrap();
        assert!(
            (s.emission.falloff / s.pdf / exact - 1.0).abs() < 1e-9,
            "{name}"
        );
    }
}

// ---- Scene files --------------------------------------------------------------------------------

fn from_xml(text: &str, folder: &Path) -> Result<(AnyEmitter, Builder), SceneError> {
    let text = format!("<scene version=\"3.0.0\">\n{text}\n</scene>");
    let document = Document::from_str(&text, folder, &[]).unwrap();
    let node = document.root().children_with_tag("emitter")[0];
    let mut build = Builder::new();
    let emitter = AnyEmitter::from_node(node, build.registry())?;
    node.finish()?;
    Ok((emitter, build))
}

#[test]
fn descriptions_of_bad_emitters_name_their_line() {
    let squeeze = "<transform name=\"to_world\"><matrix value=\"1 .5 0 0  0 1 0 0  0 0 1 0  0 0 0 1\"/></transform>";
    let cases = [
        (
            "point",
            "<rgb name=\"intensity\" value=\"-1 0 0\"/>",
            "intensity",
        ),
        (
            "point",
            "<point name=\"position\" value=\"0 0 0\"/><transform name=\"to_world\"><translate x=\"1\"/></transform>",
            "position",
        ),
        (
            "spot",
            "<float name=\"cutoff_angle\" value=\"0\"/>",
            "cutoff_angle",
        ),
        (
            "spot",
            "<float name=\"beam_width\" value=\"30\"/>",
            "beam_width",
        ),
        (
            "constant",
            "<rgb name=\"radiance\" value=\"0 -1 0\"/>",
            "radiance",
        ),
        (
            "constant",
            "<float name=\"radiant\" value=\"1\"/>",
            "radiant",
        ),
        ("vmf", "<float name=\"kappa\" value=\"3\"/>", "direction"),
        (
            "vmf",
            "<vector name=\"direction\" value=\"0 0 1\"/>",
            "kappa",
        ),
        (
            "vmf",
            "<vector name=\"direction\" value=\"0 0 1\"/><float name=\"kappa\" value=\"-3\"/>",
            "kappa",
        ),
        (
            "vmf",
            "<vector name=\"direction\" value=\"0 0 0\"/><float name=\"kappa\" value=\"3\"/>",
            "direction",
        ),
        ("envmap", "", "filename"),
        (
            "envmap",
            "<string name=\"filename\" value=\"nowhere.exr\"/>",
            "nowhere.exr",
        ),
        ("envmap", squeeze, "to_world"),
        ("envmap", "<float name=\"scale\" value=\"-1\"/>", "scale"),
        ("lantern", "", "known"),
    ];
    for (plugin, content, mention) in cases {
        let text = format!("<emitter type=\"{plugin}\">\n{content}</emitter>");
        let message = match from_xml(&text, Path::new(".")) {
            Ok(_) => panic!("{text} was accepted"),
            Err(e) => e.to_string(),
        };
        let place = message.contains("<text>:2") || message.contains("<text>:3");
        assert!(place && message.contains(mention), "{text}: {message}");
    }
}

/// An EXR file keeps every bit on its way into the parameters.
#[test]
fn maps_come_from_files() {
    let folder = tempfile::tempdir().unwrap();
    let image = noise(5, 4, 11);
    image_io::write_exr(&folder.path().join("env.exr"), &image).unwrap();
    let text = "<emitter type=\"envmap\" id=\"sky\"><string name=\"filename\" value=\"env.exr\"/><float name=\"scale\" value=\"2\"/></emitter>";
    let (emitter, mut build) = from_xml(text, folder.path()).unwrap();
    build.add_emitter(emitter, None);
    let film = Film::new(1, 1);
    let camera = Camera::new(Transform::IDENTITY, 40.0, FovAxis::X, film.size).unwrap();
    let scene = build.build(camera, film, Settings::default()).unwrap();
    assert_eq!(scene.params().values()[..image.data.len()], image.data);
    let values: Vec<f64> = scene.params().values().iter().map(|&x| x.into()).collect();
    let d = Vec3::new(0.6, 0.48, -0.64);
    let e = &scene.emitters()[0];
    let found = e.eval(&Theta::<f64>::constant(&values), &e.hit(d, None).unwrap());
    assert!((found.g - 2.0 * lookup(&image, d)[1]).abs() < 1e-5);
    // Cut off in the middle: an error that names the file.
    let bytes = std::fs::read(folder.path().join("env.exr")).unwrap();
    std::fs::write(folder.path().join("env.exr"), &bytes[..bytes.len() / 2]).unwrap();
    let message = from_xml(text, folder.path())
        .map(drop)
        .unwrap_err()
        .to_string();
    assert!(message.contains("env.exr"), "{message}");
}

#[test]
fn images_are_checked() {
    let refused = |image: Image| {
        let mut build = Builder::new();
        Envmap::new(build.registry(), "env", &image, &Transform::IDENTITY, 1.0)
            .map(drop)
            .unwrap_err()
            .to_string()
    };
    let mut image = noise(4, 3, 1);
    image.data[7] = f32::NAN;
    assert!(refused(image.clone()).contains("env.data"));
    image.data[7] = -1.0;
    assert!(refused(image.clone()).contains("-1"));
    image.data[7] = 1.0;
    image.data.pop();
    assert!(refused(image).contains("4 x 3"));
    assert!(refused(Image::new(0, 0)).contains("0 x 0"));
    let huge = Image {
        width: usize::MAX,
        height: 2,
        data: vec![1.0; 3],
    };
    assert!(refused(huge).contains("values"));
}
