//! Samples of the area of shapes, and of directions to them.

use std::f64::consts::PI;

use ad_core::{Float, Vec3};
use render::math::Ray;
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::shape::{AnyShape, Shape, Sphere, SurfaceInteraction};
use render::statistics::{p_value, sidak, z_limit};

use crate::common::shapes::{Tracer, random_direction, shapes, vec3};

/// None of them sees a face of the cube nearly edge-on: its quadrature would need more points.
const FROM: [[f64; 3]; 2] = [[1.9, 0.2, 1.4], [-0.9, 0.5, 2.6]];

/// A point in the tube.
const INSIDE: [f64; 3] = [0.2, 0.1, 0.1];

/// Directions to the sampled points against `pdf`, summed over all hits along a direction where the
/// whole area is sampled. Significance 1 % over all cases.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn samples_follow_their_density() {
    const N: u64 = 50_000;
    const ROWS: usize = 24;
    const COLUMNS: usize = 48;
    const FINE: usize = 24;
    let cases = shapes();
    let inside = (
        "sphere from inside",
        Sphere::new([0.1, 0.2, 0.3], 2.0, false).unwrap(),
    );
    let mut all: Vec<(&str, AnyShape, [f64; 3])> = Vec::new();
    for (name, shape) in cases {
        // Seen from outside, a tube's density is infinite at its silhouette: samples are compared one by
        // one elsewhere.
        let from = if name.ends_with("cylinder") {
            [INSIDE; 2]
        } else {
            FROM
        };
        all.extend(from.map(|from| (name, shape.clone(), from)));
    }
    all.push((inside.0, inside.1.into(), [0.8, 0.5, -0.2]));
    let limit = sidak(all.len(), 0.01);
    for (k, (name, shape, from)) in all.into_iter().enumerate() {
        let from = vec3(from);
        let tracer = Tracer::new(&shape);
        let cone = name.ends_with("sphere");
        let mut observed = vec![0.0; ROWS * COLUMNS];
        let mut drawn = 0.0;
        for i in 0..N {
            let u = Independent::new(3, k as u64, i).next_2d();
            let Some(s) = shape.sample(from, u) else {
                continue;
            };
            drawn += 1.0;
            let d = s.d;
            let row = ((0.5 * (1.0 - d.z)) * ROWS as f64) as usize;
            let turn = d.y.atan2(d.x).rem_euclid(2.0 * PI) / (2.0 * PI);
            let column = (turn * COLUMNS as f64) as usize;
            observed[row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)] += 1.0;
        }
        assert!(drawn > 0.999 * N as f64, "{name}: {drawn}");
        let mut expected = vec![0.0; ROWS * COLUMNS];
        let cell = 4.0 * PI / (ROWS * COLUMNS * FINE * FINE) as f64;
        for (i, e) in expected.iter_mut().enumerate() {
            for j in 0..FINE * FINE {
                let y = ((j / FINE) as f64 + 0.5) / FINE as f64;
                let x = ((j % FINE) as f64 + 0.5) / FINE as f64;
                let z = 1.0 - 2.0 * ((i / COLUMNS) as f64 + y) / ROWS as f64;
                let phi = 2.0 * PI * ((i % COLUMNS) as f64 + x) / COLUMNS as f64;
                let r = (1.0 - z * z).sqrt();
                let ray = Ray::new(from, Vec3::new(r * phi.cos(), r * phi.sin(), z));
                let hits = tracer.all(ray);
                let seen = if cone { hits.len().min(1) } else { hits.len() };
                let pdf = hits[..seen].iter().map(|si| shape.pdf(from, si));
                *e += drawn * cell * pdf.sum::<f64>();
            }
        }
        let total: f64 = expected.iter().sum::<f64>() / drawn;
        assert!(
            (total - 1.0).abs() < 0.01,
            "{name}: density integrates to {total}"
        );
        let p = p_value(observed.iter().copied().zip(expected));
        assert!(p > limit, "{name} from {from:?}: p = {p}");
    }
}

/// A ray towards a sample meets the shape there, with the density that the sample stated.
#[test]
fn samples_are_hit_where_they_say() {
    for (name, shape) in shapes() {
        let tracer = Tracer::new(&shape);
        let mut met = 0;
        for i in 0..4000 {
            let mut r = Independent::new(4, 0, i);
            let from = random_direction(r.next_2d()) * (1.6 + 2.0 * r.next_1d::<f64>());
            let u = r.next_2d();
            let Some(s) = shape.sample(from, u) else {
                // Hidden by the shape itself, or facing nowhere.
                let way = shape.sample_area(&Theta::still(), u).p - from;
                let hits = tracer.all(Ray::new(from, way.normalize()));
                let between =
                    |si: &SurfaceInteraction<f64>| (si.p - from).length() < way.length() - 1e-4;
                met += usize::from(hits.iter().any(between));
                continue;
            };
            let ray = Ray::new(from, s.d);
            // By distance and normal: a ray through an edge may meet the neighbouring face.
            let at_distance =
                |si: &&SurfaceInteraction<f64>| ((si.p - from).length() - s.distance).abs() < 1e-4;
            let hits = tracer.all(ray);
            let mut near = hits.iter().filter(at_distance);
            let Some(si) = near.find(|si| (si.frame.n - s.n).length() < 1e-3) else {
                let grazing = s.n.dot(ray.d).abs();
                let edge = name == "cube" || name.contains("cylinder");
                assert!(grazing < 1e-2 || edge, "{name}: missed, cosine {grazing}");
                continue;
            };
            met += 1;
            let pdf = shape.pdf(from, si);
            if s.n.dot(ray.d).abs() > 0.02 {
                assert!(
                    (pdf / s.pdf - 1.0).abs() < 1e-3,
                    "{name}: {pdf} for {}",
                    s.pdf
                );
                let du = (si.uv.x - s.uv.x).abs();
                assert!(
                    du.min(1.0 - du) < 1e-2,
                    "{name}: {:?} for {:?}",
                    si.uv,
                    s.uv
                );
                assert!(
                    (si.uv.y - s.uv.y).abs() < 1e-2,
                    "{name}: {:?} for {:?}",
                    si.uv,
                    s.uv
                );
            }
        }
        assert!(met > 3800, "{name}: {met}");
    }
}

/// In every scalar, from anywhere, including the surface itself: finite, or nothing.
#[test]
fn sampling_is_finite_everywhere() {
    fn sweep<P: Float>(name: &str, shape: &AnyShape) {
        let last = P::one() - P::EPSILON;
        let unit = [P::zero(), P::EPSILON, P::of(0.3), P::of(0.5), last];
        let mut origins = vec![Vec3::<P>::zero(), Vec3::splat(P::of(1e6))];
        for i in 0..40 {
            let mut r = Independent::new(5, 0, i);
            let s = shape.sample_area::<P>(&Theta::still(), r.next_2d());
            origins.push(s.p);
            origins.push(s.p + s.n * P::of(1e-6));
            origins.push(s.p - s.n * P::of(1e-6));
        }
        for from in origins {
            for a in unit {
                for b in unit {
                    let Some(s) = shape.sample(from, [a, b]) else {
                        continue;
                    };
                    assert!(
                        s.d.is_finite()
                            && s.distance.is_finite()
                            && s.n.is_finite()
                            && s.pdf.is_finite(),
                        "{name} {s:?}"
                    );
                    assert!(s.uv.x.is_finite() && s.uv.y.is_finite(), "{name} {s:?}");
                    assert!(s.pdf >= P::zero(), "{name} {s:?}");
                }
            }
        }
    }
    let mut all = shapes();
    for (center, radius) in [([0.0; 3], 1e-12), ([1e5, 0.0, 0.0], 1e-3), ([0.0; 3], 1e6)] {
        all.push((
            "extreme sphere",
            Sphere::new(center, radius, false).unwrap().into(),
        ));
    }
    for (name, shape) in &all {
        sweep::<f32>(name, shape);
        sweep::<f64>(name, shape);
    }
}

/// The cone's density keeps its digits in f32 however small the sphere, and samples lie on the side
/// that is seen.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn far_and_near_spheres_lose_no_digits() {
    for distance in [1.001f64, 1.01, 2.0, 50.0, 1e3, 1e5] {
        let sphere = Sphere::new([0.0, 0.0, 0.0], 1.0, false).unwrap();
        let axis = vec3([0.48, 0.6, 0.64]);
        let from = (axis * distance).map(|x| x as f32);
        let exact_distance = from.map(f64::from).length();
        let sine = 1.0 / exact_distance;
        // 1 - cos = 2 sin^2(theta / 2)
        let exact = 1.0 / (4.0 * PI * (0.5 * sine.asin()).sin().powi(2));
        for i in 0..1000 {
            let u = Independent::new(6, 0, i).next_2d();
            let s = sphere.sample::<f32>(from, u).unwrap();
            let error = (f64::from(s.pdf) / exact - 1.0).abs();
            let allowed = 1e-6 + 1e-7 / (distance - 1.0).sqrt();
            assert!(error < allowed, "{distance}: {error:e}");
            let p = from + s.d * s.distance;
            assert!((p.length() - 1.0).abs() < 1e-6 * distance as f32);
            let towards = -s.d;
            assert!(s.n.dot(towards) > -1e-3, "{distance}: {}", s.n.dot(towards));
        }
        // The fraction of the seen cap that lies within half of the cone's solid angle.
        let inner = (0..20_000).filter(|&i| {
            let u: [f32; 2] = Independent::new(7, 0, i).next_2d();
            let s = sphere
                .sample::<f64>(from.map(f64::from), [f64::from(u[0]), f64::from(u[1])])
                .unwrap();
            let off = s.d + from.map(f64::from).normalize();
            0.5 * off.length_squared() < 0.5 * 2.0 * (0.5 * sine.asin()).sin().powi(2)
        });
        let z = (inner.count() as f64 - 10_000.0) / 5000f64.sqrt();
        assert!(z.abs() < z_limit(6, 20_000, 1e-3), "{distance}: z = {z}");
    }
}
