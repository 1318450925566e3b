//! Curves: what rays meet, by other formulas; files and their messages; what is refused where there are curves.

use std::path::Path;

use ad_core::Vec3;
use render::accel::{Accel, Hit, Primitive, RayPacket, surfaces};
use render::instances::{Direction, Estimator};
use render::math::{NOWHERE, Ray, Transform};
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::scene::LoadOptions;
use render::shape::{AnyShape, CurveKind, Curves, Shape, SurfaceInteraction};
use render::statistics::{Estimate, z_limit};
use render::{Job, Scene};

use crate::common;
use crate::common::shapes::{Tracer, curves, rays};

/// Centre, first derivative, radius and its derivative of a span of a uniform cubic B-spline, by its basis functions.
fn span(points: &[[f32; 4]], u: f64) -> (Vec3<f64>, Vec3<f64>, f64, f64) {
    let v = 1.0 - u;
    let basis = [
        v * v * v,
        3.0 * u * u * u - 6.0 * u * u + 4.0,
        3.0 * v * v * v - 6.0 * v * v + 4.0,
        u * u * u,
    ];
    let slopes = [
        -3.0 * v * v,
        9.0 * u * u - 12.0 * u,
        12.0 * v - 9.0 * v * v,
        3.0 * u * u,
    ];
    let sum = |weights: [f64; 4], k: usize| -> f64 {
        let terms = weights.iter().zip(points).map(|(w, p)| w * f64::from(p[k]));
        terms.sum::<f64>() / 6.0
    };
    let vector = |weights| Vec3::from([0, 1, 2].map(|k| sum(weights, k)));
    (vector(basis), vector(slopes), sum(basis, 3), sum(slopes, 3))
}

/// Where a line meets a tube from outside, by another way: at every parameter, the ball around the curve is met at two
/// points; those of the tube are where they lie at right angles to the curve, which is a root in the parameter. `None`
/// where two roots may lie between samples.
fn entries(points: &[[f32; 4]], ray: &Ray<f64>) -> Option<Vec<(f64, f64)>> {
    const SAMPLES: usize = 3000;
    let at = |u: f64, side: f64| {
        let (c, c1, r, r1) = span(points, u);
        let middle = (c - ray.o).dot(ray.d);
        let spare = r * r - (c - ray.at(middle)).length_squared();
        let t = middle + side * spare.sqrt();
        (spare >= 0.0).then(|| (t, (ray.at(t) - c).dot(c1), (c, c1, r, r1)))
    };
    let mut found = Vec::new();
    for side in [-1.0, 1.0] {
        let mut last: Option<(f64, f64)> = None;
        for i in 0..=SAMPLES {
            let u = i as f64 / SAMPLES as f64;
            let now = at(u, side).map(|(_, h, _)| (u, h));
            if now.is_some() != last.is_some() && i > 0 {
                // Both branches end here: a root may lie where they meet.
                let whole = now.or(last).map(|(u, _)| u)?;
                let values = [-1.0, 1.0].map(|s| at(whole, s).map_or(0.0, |(_, h, _)| h));
                if values[0] * values[1] <= 0.0 {
                    return None;
                }
            }
            if let (Some((a, low)), Some((b, high))) = (last, now)
                && low * high < 0.0
            {
                let (mut a, mut b) = (a, b);
                for _ in 0..60 {
                    let middle = 0.5 * (a + b);
                    match at(middle, side) {
                        Some((_, h, _)) if h * low > 0.0 => a = middle,
                        _ => b = middle,
                    }
                }
                let (t, _, (c, c1, r, r1)) = at(a, side)?;
                let w = ray.at(t) - c;
                // The second derivative by differences.
                let c2 = (span(points, a + 1e-6).1 - span(points, a - 1e-6).1) * 0.5e6;
                let bent = c1.length_squared() - w.dot(c2);
                if bent <= 0.0 {
                    // The tube folds over itself.
                    return None;
                }
                let n = w * bent - c1 * (r * r1);
                let cosine = n.dot(ray.d) / n.length();
                if cosine.abs() < 0.02 {
                    return None;
                }
                if cosine < 0.0 {
                    found.push((t, a));
                }
            }
            last = now;
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    Some(found)
}

/// Control points of a curve that bends, about as long as wide, with this radius.
fn random_points(seed: u64, radius: f32, count: usize) -> Vec<[f32; 4]> {
    let mut s = Independent::new(seed, 1, 0);
    (0..count)
        .map(|_| {
            let mut number = || s.next_1d::<f64>() as f32;
            let at = [number(), number(), number()].map(|x| 2.0 * x - 1.0);
            [at[0], at[1], at[2], radius * (0.5 + number())]
        })
        .collect()
}

/// Against roots that are searched for in the parameter: distances to 1e-5, parameters to 1e-4, for thick curves and thin
/// ones, and for rays that run along the curve.
#[test]
fn tubes_are_met_where_they_are() {
    let mut compared = 0;
    for (radius, least) in [(0.15, 200), (0.02, 100), (0.001, 60)] {
        let mut hits = 0;
        for seed in 0..12 {
            let points = random_points(seed, radius, 4);
            let shape: AnyShape = match Curves::new(CurveKind::Spline, points.clone(), &[0]) {
                Ok(curves) => curves.into(),
                Err(e) => panic!("{e}"),
            };
            let tracer = Tracer::new(&shape);
            for i in 0..60 {
                let mut s = Independent::new(seed, 2, i);
                let [a, b, far, turn]: [f64; 4] = std::array::from_fn(|_| s.next_1d());
                let (c, along, r, _) = span(&points, a);
                let off = render::math::warp::square_to_sphere::<f64>(s.next_2d()) * (r * b);
                let d = render::math::warp::square_to_sphere::<f64>(s.next_2d());
                // Every third along the curve.
                let d = if i % 3 == 0 {
                    (along.normalize() + d * (0.3 * turn)).normalize()
                } else {
                    d
                };
                let o = (c + off - d * (0.5 + 2.0 * far)).map(|x| f64::from(x as f32));
                let d = d.map(|x| f64::from(x as f32));
                let ray = Ray::new(o, d);
                let Some(expected) = entries(&points, &ray) else {
                    continue;
                };
                compared += 1;
                let expected = expected.into_iter().find(|(t, _)| *t > 0.0);
                let found = tracer.hit(&ray);
                let what = format!("radius {radius}, curve {seed}, ray {i}");
                match (expected, found) {
                    (None, None) => {}
                    (Some((t, u)), Some(hit)) => {
                        hits += 1;
                        assert!(
                            (f64::from(hit.t) - t).abs() < 1e-5,
                            "{what}: {hit:?}, not {t}"
                        );
                        assert!(
                            (f64::from(hit.u) - u).abs() < 1e-4,
                            "{what}: {hit:?}, not {u}"
                        );
                    }
                    other => panic!("{what}: {other:?}"),
                }
            }
        }
        assert!(hits > least, "{radius}: {hits}");
    }
    assert!(compared > 1200, "{compared}");
}

/// Balls along a segment, one by one: none is met before the cone, and the nearest of many is as near as 1e-4 of it.
#[test]
fn cones_are_the_surface_of_balls() {
    let cases = [
        [[0.0, 0.1, 0.2, 0.3], [0.9, -0.4, 0.1, 0.1]],
        [[0.0, 0.1, 0.2, 0.3], [0.1, 0.0, 0.2, 0.9]],
        [[0.0, 0.1, 0.2, 0.3], [0.0, 0.1, 0.2, 0.2]],
        [[0.0, 0.1, 0.2, 0.3], [0.0, 0.1, -0.9, 0.3]],
        [[0.0, 0.1, 0.2, 0.4], [0.5, 0.6, 0.2, 0.0]],
    ];
    for (k, points) in cases.into_iter().enumerate() {
        let shape: AnyShape = Curves::new(CurveKind::Linear, points.to_vec(), &[0])
            .unwrap()
            .into();
        let tracer = Tracer::new(&shape);
        let mut hits = 0;
        for ray in rays(600, 31) {
            const BALLS: usize = 4000;
            let ball = |i: usize| {
                let s = i as f64 / BALLS as f64;
                let mix =
                    |k: usize| f64::from(points[0][k]) * (1.0 - s) + f64::from(points[1][k]) * s;
                (Vec3::new(mix(0), mix(1), mix(2)), mix(3))
            };
            let (mut nearest, mut inside) = (f64::INFINITY, false);
            for (c, r) in (0..=BALLS).map(ball) {
                inside |= (ray.o - c).length() < r;
                let middle = (c - ray.o).dot(ray.d);
                let spare = r * r - (c - ray.at(middle)).length_squared();
                if spare >= 0.0 && middle - spare.sqrt() > 0.0 {
                    nearest = nearest.min(middle - spare.sqrt());
                }
            }
            let found = tracer.first(&ray);
            if inside {
                assert!(found.is_none(), "{k}: from within");
                continue;
            }
            let Some(si) = found else {
                assert!(nearest == f64::INFINITY, "{k}: {nearest} is missed");
                continue;
            };
            hits += 1;
            let grazing = si.n_geo.dot(ray.d).abs().max(1e-2);
            let (off, limit) = (nearest - si.t, 1e-4 / grazing);
            assert!(
                off > -1e-6 && (off < limit || nearest == f64::INFINITY && grazing < 0.02),
                "{k}: {off}"
            );
        }
        assert!(hits > 60, "{k}: {hits}");
    }
}

/// Many curves in a hierarchy, packets of rays and single ones, all of them and each by itself: the same bits.
#[test]
fn packets_and_hierarchies_meet_the_same() {
    for kind in [CurveKind::Spline, CurveKind::Linear] {
        let mut points = Vec::new();
        let mut starts = Vec::new();
        for seed in 0..40 {
            starts.push(points.len() as u32);
            points.extend(random_points(100 + seed, 0.05, 6));
        }
        let shape = Curves::new(kind, points, &starts).unwrap();
        let prims = shape.primitives();
        let numbers = surfaces(&prims, |_| false);
        let all = Accel::with_curves(&prims, &numbers, shape.control_points()).unwrap();
        assert!(all.has_hierarchy());
        let few: Vec<Accel> = (0..prims.len())
            .map(|i| Accel::with_curves(&prims[i..=i], &[0], shape.control_points()).unwrap())
            .collect();
        let mut hits = 0;
        let rays: Vec<_> = rays(320, 32).collect();
        for sixteen in rays.chunks(16) {
            let single = |v: Vec3<f64>| v.map(|x| x as f32).to_array();
            let mut packet = RayPacket::default();
            for ray in sixteen {
                packet.push(single(ray.o), single(ray.d), 9.0, [NOWHERE; 2]);
            }
            let together = all.intersect_packet(&packet);
            let blocked = all.occluded_packet(&packet);
            let one_by_one: Vec<[Option<Hit>; 16]> =
                few.iter().map(|a| a.intersect_packet(&packet)).collect();
            for (i, ray) in sixteen.iter().enumerate() {
                let (o, d) = (single(ray.o), single(ray.d));
                let alone = all.intersect(o, d, 9.0, NOWHERE);
                assert_eq!(alone, together[i]);
                assert_eq!(alone.is_some(), blocked >> i & 1 != 0);
                assert_eq!(alone.is_some(), all.occluded(o, d, 9.0, [NOWHERE; 2]));
                let mut best: Option<Hit> = None;
                for (k, hits) in one_by_one.iter().enumerate() {
                    if let Some(hit) = hits[i]
                        && best.is_none_or(|b| hit.t < b.t)
                    {
                        best = Some(Hit {
                            prim: k as u32,
                            ..hit
                        });
                    }
                }
                assert_eq!(alone, best);
                hits += usize::from(alone.is_some());
            }
        }
        assert!(hits > 80, "{hits}");
    }
}

/// The distance from a curve less its radius, by the nearest of many parameters and halving.
fn implicit(points: &[[f32; 4]], p: Vec3<f64>) -> f64 {
    let off = |u: f64| (p - span(points, u).0).dot(span(points, u).1);
    let nearest = (0..=400)
        .map(|i| f64::from(i) / 400.0)
        .min_by(|a, b| {
            let far = |u: &f64| (p - span(points, *u).0).length();
            far(a).total_cmp(&far(b))
        })
        .unwrap_or(0.0);
    let (mut a, mut b) = (nearest - 1.0 / 400.0, nearest + 1.0 / 400.0);
    for _ in 0..60 {
        let middle = 0.5 * (a + b);
        if off(middle) > 0.0 {
            a = middle
        } else {
            b = middle
        }
    }
    let (c, _, r, _) = span(points, a);
    (p - c).length() - r
}

/// Points lie on the surface to 1e-12, and normals are its gradient, by central differences, to 1e-6.
#[test]
fn normals_are_gradients_of_the_distance() {
    let points = [
        [-1.1, -0.9, 0.1, 0.35],
        [-0.9, 0.1, 0.3, 0.25],
        [-0.1, 0.7, -0.2, 0.3],
        [0.5, 0.2, 0.1, 0.2f32],
    ];
    let shape: AnyShape = Curves::new(CurveKind::Spline, points.to_vec(), &[0])
        .unwrap()
        .into();
    let tracer = Tracer::new(&shape);
    let mut tested = 0;
    for ray in rays(3000, 33) {
        let Some(si) = tracer.first(&ray) else {
            continue;
        };
        if !(0.01..0.99).contains(&si.uv.y) {
            continue;
        }
        tested += 1;
        let off = implicit(&points, si.p);
        assert!(off.abs() < 1e-12, "{off:e}");
        let gradient = Vec3::from([0, 1, 2].map(|k: usize| {
            let step = |h: f64| {
                let mut p = si.p.to_array();
                p[k] += h;
                implicit(&points, p.into())
            };
            (step(1e-5) - step(-1e-5)) / 2e-5
        }));
        let off = (gradient.normalize() - si.n_geo).length();
        assert!(off < 1e-6, "{off:e}");
        assert!(si.n_geo.dot(ray.d) < 0.0);
        // The second axis lies along the curve, the first around it.
        let (_, along, ..) = span(&points, si.uv.y);
        assert!(si.frame.t.dot(along) > 0.0 && si.frame.s.dot(along).abs() < 1e-9);
    }
    assert!(tested > 100, "{tested}");
}

/// Control points on top of each other, ends without thickness, curves that stand still: all numbers are finite.
#[test]
fn degenerate_curves_have_finite_hits() {
    let cases: [&[[f32; 4]]; 5] = [
        &[[-1.0, 0.0, 0.0, 0.2]; 3],
        &[[0.0, 0.1, 0.0, 0.3]; 4],
        &[
            [-1.0, 0.0, 0.0, 0.0],
            [-1.0, 0.0, 0.0, 0.0],
            [-1.0, 0.0, 0.0, 0.0],
            [1.0, 0.3, 0.0, 0.3],
            [1.0, 0.3, 0.0, 0.3],
            [1.0, 0.3, 0.0, 0.3],
        ],
        &[
            [0.0, 0.0, 0.0, 0.1],
            [1.0, 0.0, 0.0, 0.1],
            [-1.0, 0.0, 0.0, 0.1],
            [1.0, 0.0, 0.0, 0.1],
            [-1.0, 0.0, 0.0, 0.0],
        ],
        &[
            [0.0, -1.0, 0.0, 0.9],
            [0.3, 0.0, 0.0, 0.9],
            [0.0, 0.1, 0.1, 0.9],
            [0.0, -0.1, 0.0, 0.9],
            [0.1, 0.1, 0.1, 0.9],
        ],
    ];
    let mut hits = 0;
    for points in cases {
        for kind in [CurveKind::Spline, CurveKind::Linear] {
            let Ok(curves) = Curves::new(kind, points.to_vec(), &[0]) else {
                continue;
            };
            let shape = AnyShape::from(curves);
            let tracer = Tracer::new(&shape);
            for ray in rays(400, 34) {
                let check = |si: &SurfaceInteraction<f64>| {
                    assert!(si.p.is_finite() && si.n_geo.is_finite() && si.uv.is_finite());
                    assert!((si.n_geo.length() - 1.0).abs() < 1e-6);
                    assert!((si.frame.s.length() - 1.0).abs() < 1e-6);
                };
                if let Some(hit) = tracer.hit(&ray) {
                    hits += 1;
                    let si = shape.interaction(&Theta::still(), hit.prim, &ray, &hit);
                    check(&si);
                    let at = shape.coordinates(hit.prim, &si);
                    check(&shape.point_at(&Theta::still(), hit.prim, at));
                    if let Some(p) = shape.partials(&Theta::still(), hit.prim, at) {
                        assert!(p.is_finite());
                    }
                }
            }
        }
    }
    assert!(hits > 300, "{hits}");
}

/// What starts within a curve passes; tubes are open, and what looks through their ends sees nothing of their inside.
#[test]
fn curves_are_met_from_outside() {
    for (name, shape) in curves() {
        let tracer = Tracer::new(&shape);
        let mut passed = 0;
        for ray in rays(600, 35) {
            let Some(si) = tracer.first(&ray) else {
                continue;
            };
            assert!(si.n_geo.dot(ray.d) < 0.0, "{name}");
            let within = Ray::new(si.p - si.n_geo * 1e-3, ray.d);
            let back = Ray::new(si.p - si.n_geo * 1e-3, -ray.d);
            // Not the same place again.
            for ray in [within, back] {
                passed += 1;
                // Balls at the joints of linear curves reach into each other.
                if name == "curves"
                    && let Some(next) = tracer.first(&ray)
                {
                    assert!((next.p - si.p).length() > 5e-3, "{name}");
                }
            }
        }
        assert!(passed > 100, "{name}");
    }
    let straight: Vec<[f32; 4]> = (0..5).map(|i| [i as f32, 0.0, 0.0, 0.2]).collect();
    let shape: AnyShape = Curves::new(CurveKind::Spline, straight, &[0])
        .unwrap()
        .into();
    let tracer = Tracer::new(&shape);
    let towards =
        |o: [f64; 3], d: [f64; 3]| tracer.first(&Ray::new(o.into(), Vec3::from(d).normalize()));
    assert!(towards([-3.0, 0.1, 0.0], [1.0, 0.0, 0.02]).is_none());
    assert!(towards([2.0, 0.0, 3.0], [0.0, 0.0, -1.0]).is_some());
    assert!(towards([0.5, 0.0, 3.0], [0.0, 0.0, -1.0]).is_none());
    assert!(towards([2.0, 0.0, 0.0], [0.0, 0.0, -1.0]).is_none());
}

/// Moved curves are met where they are, at the same surface coordinates; a scale is one of the radii.
#[test]
fn curves_move_with_their_points() {
    let by = Transform::sequence([
        Transform::scale([1.5; 3]),
        Transform::rotate([1.0, 2.0, -0.5], 70.0).unwrap(),
        Transform::translate([0.25, -0.25, 0.5]),
    ]);
    for (name, shape) in curves() {
        let moved = shape.placed(&by).unwrap();
        let (tracer, other) = (Tracer::new(&shape), Tracer::new(&moved));
        let mut tested = 0;
        for ray in rays(500, 36) {
            let Some(hit) = tracer.hit(&ray) else {
                continue;
            };
            let si = shape.interaction(&Theta::still(), hit.prim, &ray, &hit);
            if si.n_geo.dot(ray.d).abs() < 0.1 {
                continue;
            }
            let [o, d] = [by.point(ray.o.to_array()), by.vector(ray.d.to_array())].map(Vec3::from);
            let seen = other
                .first(&Ray::new(o, d.normalize()))
                .expect("it moved along");
            tested += 1;
            let expected = Vec3::from(by.point(si.p.to_array()));
            assert!((seen.p - expected).length() < 2e-5, "{name}");
            let n = Vec3::from(by.vector(si.n_geo.to_array())).normalize();
            assert!((seen.n_geo - n).length() < 2e-5, "{name}");
            // On the ball at an end the angle is that of little, next to the axis.
            let end = (hit.u == 0.0 || hit.u == 1.0) && name == "linear curves";
            let turn = (seen.uv.x - si.uv.x).abs();
            assert!(
                (end || turn.min(1.0 - turn) < 1e-4) && (seen.uv.y - si.uv.y).abs() < 1e-4,
                "{name}: {:?} {:?}",
                seen.uv,
                si.uv
            );
        }
        assert!(tested > 60, "{name}: {tested}");
        assert!((moved.area() / shape.area() / 2.25 - 1.0).abs() < 1e-5);
    }
    let nowhere = Transform::scale([1e20; 3]);
    assert!(curves()[0].1.placed(&nowhere).is_err());
}

fn read(text: &str, kind: CurveKind) -> Result<(Curves, Option<String>), String> {
    let read = Curves::from_text(
        text.as_bytes(),
        Path::new("a.txt"),
        kind,
        &Transform::IDENTITY,
    );
    read.map_err(|e| e.to_string())
}

#[test]
fn files_are_read_as_mitsuba_reads_them() {
    let text = "\n\n0 0 0 1\r\n 1 0 0 .5\t\n2 0 0 1e-1\n3 0 0 1\n \t\n\n0 1 0 1\n1 1 0 1 7 x\n2 1 0 1\n3 1 0 1\n4 1 0 0";
    let (curves, ignored) = read(text, CurveKind::Spline).unwrap();
    assert_eq!((curves.points().len(), curves.segments()), (9, 3));
    assert_eq!(curves.points()[1], [1.0, 0.0, 0.0, 0.5]);
    assert_eq!(
        ignored.unwrap(),
        "a.txt:10: what follows the radius of a point has no effect"
    );
    assert_eq!(read(text, CurveKind::Linear).unwrap().0.segments(), 7);
    // Radii stay.
    let double = Transform::scale([2.0, 1.0, 3.0]);
    let path = Path::new("a.txt");
    let (curves, _) = Curves::from_text(text.as_bytes(), path, CurveKind::Linear, &double).unwrap();
    assert_eq!(curves.points()[1], [2.0, 0.0, 0.0, 0.5]);
}

#[test]
fn bad_files_get_errors_with_their_line() {
    for (text, kind, message) in [
        (
            "",
            CurveKind::Linear,
            "a.txt: expected at least one curve, found none",
        ),
        (
            "0 0 0 1",
            CurveKind::Linear,
            "a.txt:1: expected at least 2 points of a curve, found 1 before this line",
        ),
        (
            "0 0 0 1\n1 0 0 1\n2 0 0 1\n\n0 0 0 1\n",
            CurveKind::Spline,
            "a.txt:4: expected at least 4 points of a curve, found 3 before this line",
        ),
        (
            "0 0 0\n",
            CurveKind::Linear,
            "a.txt:1: expected four numbers, x, y, z and a radius: a radius, found the end of the line",
        ),
        (
            "0 0 0 1\n0 y 0 1\n",
            CurveKind::Linear,
            "a.txt:2: expected a finite number as y, found `y`",
        ),
        (
            "0 0 0 1\n0 0 0 nan\n",
            CurveKind::Linear,
            "a.txt:2: expected a finite number as a radius, found `nan`",
        ),
        (
            "0 0 1e39 1\n",
            CurveKind::Linear,
            "a.txt:1: expected a finite number as z, found `1e39`",
        ),
        (
            "0 0 0 -1\n",
            CurveKind::Linear,
            "a.txt:1: expected a radius of at least 0, found -1",
        ),
        (
            "0 0 1e30 1\n",
            CurveKind::Linear,
            "a.txt:1: expected numbers of magnitude at most 1e12 in the world, found 1000000000000000000000000000000",
        ),
        (
            "0 0 0 0\n1 0 0 0\n",
            CurveKind::Linear,
            "a.txt: expected a radius that is not zero and a length, found none",
        ),
    ] {
        let error = read(text, kind).map(|_| ()).unwrap_err();
        assert_eq!(error, message);
    }
    let utf16 = Curves::from_text(
        b"\xff\xfe0\0",
        Path::new("a.txt"),
        CurveKind::Linear,
        &Transform::IDENTITY,
    );
    assert!(utf16.unwrap_err().to_string().contains("UTF-16"));
}

/// A file of curves that bend, in front of the camera of [`scene`].
fn tuft_file() -> String {
    let mut text = String::new();
    for i in 0..30 {
        let mut s = Independent::new(5, 3, i);
        let [x, y] = s.next_2d::<f64>().map(|x| 2.0 * x - 1.0);
        for k in 0..6 {
            let [a, b] = s.next_2d::<f64>().map(|x| 0.3 * x);
            let z = 0.4 * f64::from(k) - 1.0;
            text += &format!("{} {} {z} {}\n", x + a, y + b, 0.06 + 0.02 * a);
        }
        text += "\n";
    }
    text
}

fn scene(plugin: &str, more: &str) -> String {
    format!(
        r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="1, 5, 1" target="0, 0, 0" up="0, 0, 1"/></transform>
        <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/>
        <rfilter type="box"/></film></sensor>
        <shape type="{plugin}" id="tuft"><string name="filename" value="tuft.txt"/>{more}</shape></scene>"#
    )
}

/// A scene with a tuft of these curves.
fn tuft(plugin: &str, more: &str) -> Result<Scene, String> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("tuft.txt"), tuft_file()).unwrap();
    let heights = render::Image {
        width: 2,
        height: 2,
        data: vec![0.5; 12],
    };
    render::image_io::write_exr(&folder.path().join("heights.exr"), &heights).unwrap();
    let read = Scene::from_xml(&scene(plugin, more), folder.path(), &LoadOptions::default());
    read.map(|(scene, _)| scene).map_err(|e| e.to_string())
}

/// A scene that is saved has its curves, where they have been moved to.
#[test]
fn curves_are_saved() {
    for plugin in ["bsplinecurve", "linearcurve"] {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("tuft.txt"), tuft_file()).unwrap();
        let more = r#"<transform name="to_world"><scale x="2" y="1" z="0.5"/></transform>"#;
        std::fs::write(at("scene.xml"), scene(plugin, more)).unwrap();
        let load = |name: &str| Scene::load(&at(name), &LoadOptions::default()).unwrap().0;
        let mut scene = load("scene.xml");
        scene.make_movable(&["tuft.translation"]).unwrap();
        scene
            .set([("tuft.translation", &[0.5, 0.0, 0.25][..])])
            .unwrap();
        std::fs::create_dir(at("other")).unwrap();
        scene.save(&at("other/scene.xml")).unwrap();
        let saved = load("other/scene.xml");
        let bounds = |scene: &Scene| scene.shapes()[0].bounds();
        for (a, b) in (bounds(&scene).as_flattened().iter()).zip(bounds(&saved).as_flattened()) {
            assert!((a - b).abs() < 1e-5, "{plugin}: {a} {b}");
        }
    }
}

const WHITE: &str = r#"<bsdf type="diffuse"><rgb name="reflectance" value="1, 1, 1"/></bsdf></shape>
    <emitter type="constant"/><integrator type="path"><integer name="rr_depth" value="200"/></integrator>
    <shape type="sphere"><point name="center" x="0" y="0" z="-50"/><float name="radius" value="0.01"/>"#;

/// White curves under a white sky are as white: no light is lost at joints, or where pieces meet. 8 runs of 64 samples per
/// pixel, at a significance of 1e-3 for both kinds.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn white_curves_cannot_be_seen_under_a_white_sky() {
    const RUNS: u64 = 8;
    for plugin in ["bsplinecurve", "linearcurve"] {
        let scene = tuft(plugin, WHITE).unwrap();
        let means: Vec<f64> = (0..RUNS)
            .map(|seed| mean(&common::image_of_seed(&scene, seed, 64).data))
            .collect();
        let found = Estimate::of(&means);
        let z = found.z(&Estimate::exact(1.0)).abs();
        println!(
            "{plugin}: {}, {z:.2} standard errors from white",
            found.mean
        );
        assert!(
            found.se < 2e-3 && z < z_limit(2, RUNS, 1e-3),
            "{plugin}: {found:?}"
        );
    }
}

fn mean(image: &[f32]) -> f64 {
    image.iter().map(|x| f64::from(*x)).sum::<f64>() / image.len() as f64
}

const GREY: &str = r#"<bsdf type="roughconductor"><float name="alpha" value="0.4"/>
    <rgb name="specular_reflectance" value="0.7, 0.5, 0.3"/></bsdf></shape>
    <shape type="sphere" id="lamp"><point name="center" x="1" y="3" z="4"/><float name="radius" value="0.4"/>
    <emitter type="area"><rgb name="radiance" value="9, 9, 9"/></emitter>"#;

/// The derivative of the mean image in the reflectance and the roughness of curves: forward and reverse mode to 1e-4, and
/// central differences of 8 runs of 256 samples per pixel, at a significance of 1e-3 over all cases.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn materials_of_curves_have_derivatives() {
    const RUNS: u64 = 8;
    const STEP: f32 = 0.01;
    for plugin in ["bsplinecurve", "linearcurve"] {
        let mut scene = tuft(plugin, GREY).unwrap();
        for name in [
            "tuft.bsdf.specular_reflectance.value",
            "tuft.bsdf.alpha.value",
        ] {
            let values = scene.params().values().to_vec();
            let info = scene.params().find(name).unwrap();
            let range = info.range();
            let mut pictures = Vec::new();
            for step in [STEP, -STEP] {
                let mut moved = values.clone();
                moved[range.clone()].iter_mut().for_each(|x| *x += step);
                scene.set_params(&moved).unwrap();
                let runs = (0..RUNS).map(|seed| common::image_of_seed(&scene, seed, 256).data);
                pictures.push(runs.map(|data| mean(&data)).collect::<Vec<_>>());
            }
            scene.set_params(&values).unwrap();
            let differences: Vec<f64> = (pictures[0].iter().zip(&pictures[1]))
                .map(|(a, b)| (a - b) / (2.0 * f64::from(STEP)))
                .collect();
            let direction = [Direction::uniform(scene.params(), name).unwrap()];
            let derivatives: Vec<f64> = (0..RUNS)
                .map(|seed| {
                    let job = Job::new(&scene, &scene.settings, 100 + seed, 0..256, &());
                    let found = Estimator::Mis
                        .forward_f32(&job, &values, &direction)
                        .unwrap();
                    mean(&found.image(1).data)
                })
                .collect();
            let [a, b] = [&differences, &derivatives].map(|x| Estimate::of(x));
            let z = a.z(&b).abs();
            println!(
                "{plugin}, {name}: {} and {}, {z:.2} standard errors",
                a.mean, b.mean
            );
            // The roughness of linear curves hardly matters to the mean.
            let says_something = a.mean.abs() > 1e-3 || name.ends_with("alpha.value");
            assert!(
                says_something && z < z_limit(4, RUNS, 1e-3),
                "{plugin}, {name}"
            );

            let forward = common::derivative(&scene, name, 16).data;
            let adjoint = vec![1.0 / forward.len() as f32; forward.len()];
            let reverse: f64 = common::gradient(&scene, name, &adjoint, 16).iter().sum();
            let off = (reverse - mean(&forward)).abs();
            assert!(
                off < 1e-4 * mean(&forward).abs().max(5e-3),
                "{plugin}, {name}: {reverse}"
            );
        }
    }
}

/// What curves do not do is refused with their name.
#[test]
fn what_curves_do_not_do_is_refused() {
    let lamp = r#"<emitter type="area"><rgb name="radiance" value="1"/></emitter>"#;
    let error = tuft("bsplinecurve", lamp).unwrap_err();
    assert!(error.contains("curves that emit are"), "{error}");
    let bump = r#"<bsdf type="bumpmap"><texture type="bitmap"><string name="filename" value="heights.exr"/></texture><bsdf type="diffuse"/></bsdf>"#;
    let error = tuft("linearcurve", bump).unwrap_err();
    assert!(
        error.contains("under a bump map, a surface that is no curve"),
        "{error}"
    );
    let group = r#"</shape><shape type="shapegroup" id="g"><shape type="linearcurve">
        <string name="filename" value="tuft.txt"/></shape></shape><shape type="instance"><ref id="g"/>"#;
    let error = tuft("linearcurve", group).unwrap_err();
    assert!(error.contains("curves in groups are"), "{error}");

    let mut scene = tuft("bsplinecurve", GREY).unwrap();
    assert!(scene.make_movable(&["tuft.scale"]).is_err());
    scene
        .make_movable(&["tuft.translation", "lamp.translation"])
        .unwrap();
    let values = scene.params().values().to_vec();
    let job = Job::new(&scene, &scene.settings, 1, 0..1, &());
    for name in ["tuft.translation", "lamp.translation"] {
        let direction = [Direction::uniform(scene.params(), name).unwrap()];
        let mut named = 0;
        for &estimator in Estimator::ALL {
            let refused = estimator.forward_f32(&job, &values, &direction);
            let error = refused.map(|_| ()).unwrap_err().to_string();
            named += usize::from(error.contains("`tuft` is made of curves"));
        }
        assert!(named > 2, "{name}: {named}");
    }
    // Values move.
    let at = |scene: &Scene| scene.shapes()[0].bounds()[0][0];
    let (before, offset) = (
        at(&scene),
        scene.params().find("tuft.translation").unwrap().offset,
    );
    let mut moved = values;
    moved[offset] = 0.5;
    scene.set_params(&moved).unwrap();
    assert!((at(&scene) - before - 0.5).abs() < 1e-5);
}

/// Primitives hold on to their curve: what is not there is never hit.
#[test]
fn spans_without_points_are_not_hit() {
    let span = Primitive::Span {
        end_points: [[0.0; 3], [1.0, 0.0, 0.0]],
        radius: 1.0,
        first: 7,
        part: [0, 1],
    };
    let accel = Accel::build(&[span]).unwrap();
    assert_eq!(
        accel.intersect([0.0, 0.0, 3.0], [0.0, 0.0, -1.0], 9.0, NOWHERE),
        None
    );
}
