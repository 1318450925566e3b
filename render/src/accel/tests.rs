use super::*;
use crate::math::NOWHERE;

/// Small deterministic generator; tests need nothing better.
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    /// In [-1, 1).
    fn signed(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
    fn vector(&mut self, scale: f32) -> [f32; 3] {
        [0; 3].map(|_| self.signed() * scale)
    }
    fn direction(&mut self) -> [f32; 3] {
        loop {
            let d = self.vector(1.0);
            let l = d.iter().map(|x| x * x).sum::<f32>();
            if l > 0.01 && l <= 1.0 {
                return d.map(|x| x / l.sqrt());
            }
        }
    }
    fn primitive(&mut self, scale: f32) -> Primitive {
        let p = self.vector(scale);
        let s = 0.2 * scale;
        let radius = s * (0.1 + 0.9 * self.signed().abs());
        match self.bits() % 5 {
            0 => Primitive::Triangle {
                v0: p,
                e1: self.vector(s),
                e2: self.vector(s),
            },
            1 => Primitive::Parallelogram {
                v0: p,
                e1: self.vector(s),
                e2: self.vector(s),
            },
            2 => Primitive::Sphere { center: p, radius },
            3 => {
                let n = self.direction();
                let h = self.direction();
                let e1 = unit(cross64(n.map(f64::from), h.map(f64::from)));
                let e2 = unit(cross64(n.map(f64::from), e1));
                Primitive::Disk {
                    center: p,
                    e1: e1.map(|x| x as f32 * radius),
                    e2: e2.map(|x| x as f32 * radius * 0.5),
                }
            }
            _ => Primitive::Cylinder {
                p0: p,
                axis: self.vector(s),
                radius: 0.3 * radius,
            },
        }
    }
}

fn cross64(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
fn dot64(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}
fn sub64(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}
fn unit(a: [f64; 3]) -> [f64; 3] {
    let l = dot64(a, a).sqrt();
    a.map(|x| x / l)
}
fn wide64(a: [f32; 3]) -> [f64; 3] {
    a.map(f64::from)
}

/// All distances at which the line meets the primitive, in f64 and by other formulas: vertices
/// and triple products for flat ones, the plain quadratic for curved ones. The second number is
/// how far inside the boundary the point is, in surface coordinates.
fn reference(p: &Primitive, o: [f32; 3], d: [f32; 3]) -> Vec<(f64, f64)> {
    let (o, d) = (wide64(o), wide64(d));
    let at = |t: f64| -> [f64; 3] { std::array::from_fn(|k| o[k] + t * d[k]) };
    let solve = |a: f64, b: f64, c: f64| {
        let disc = b * b - a * c;
        let s = disc.sqrt();
        if disc >= 0.0 {
            vec![(-b - s) / a, (-b + s) / a]
        } else {
            vec![]
        }
    };
    let plane = |v0: [f32; 3], e1: [f32; 3], e2: [f32; 3]| {
        let (a, b) = (wide64(e1), wide64(e2));
        let q = cross64(d, b);
        let det = dot64(a, q);
        let s = sub64(o, wide64(v0));
        let r = cross64(s, a);
        (dot64(b, r) / det, dot64(s, q) / det, dot64(d, r) / det)
    };
    match *p {
        Primitive::Triangle { v0, e1, e2 } => {
            let (t, u, v) = plane(v0, e1, e2);
            vec![(t, u.min(v).min(1.0 - u - v))]
        }
        Primitive::Parallelogram { v0, e1, e2 } => {
            let (t, u, v) = plane(v0, e1, e2);
            vec![(t, u.min(v).min(1.0 - u).min(1.0 - v))]
        }
        Primitive::Disk { center, e1, e2 } => {
            let (t, u, v) = plane(center, e1, e2);
            vec![(t, 1.0 - (u * u + v * v).sqrt())]
        }
        Primitive::Sphere { center, radius } => {
            let s = sub64(o, wide64(center));
            let r = f64::from(radius);
            let roots = solve(dot64(d, d), dot64(s, d), dot64(s, s) - r * r);
            let spread = roots.iter().fold(0.0, |m, t| t - m).abs() / r;
            roots.into_iter().map(|t| (t, spread)).collect()
        }
        Primitive::Cylinder { p0, axis, radius } => {
            let (c, x) = (wide64(p0), wide64(axis));
            let n = unit(x);
            let l = dot64(x, x).sqrt();
            let s = sub64(o, c);
            let flat = |w: [f64; 3]| cross64(n, w);
            let (sf, df, r) = (flat(s), flat(d), f64::from(radius));
            let roots = solve(dot64(df, df), dot64(sf, df), dot64(sf, sf) - r * r);
            let spread = roots.iter().fold(0.0, |m, t| t - m).abs() / r;
            roots
                .into_iter()
                .map(|t| {
                    let h = dot64(sub64(at(t), c), n) / l;
                    (t, h.min(1.0 - h).min(spread))
                })
                .collect()
        }
        Primitive::Cone { .. } | Primitive::Span { .. } => {
            unreachable!("curves are compared with roots of their own in render/tests/curves.rs")
        }
    }
}

/// Nearest clear hit of the reference, or `None` in the outer layer if a boundary is too close to
/// call in f32.
fn nearest(prims: &[Primitive], o: [f32; 3], d: [f32; 3]) -> Option<Option<(f64, usize)>> {
    let margin = 2e-4;
    let mut best: Option<(f64, usize)> = None;
    let mut unclear = f64::INFINITY;
    for (i, p) in prims.iter().enumerate() {
        for (t, inside) in reference(p, o, d) {
            if t <= 0.0 || !t.is_finite() {
                continue;
            }
            if inside.abs() < margin {
                unclear = unclear.min(t);
            } else if inside > 0.0 && best.is_none_or(|b| t < b.0) {
                best = Some((t, i));
            }
        }
    }
    (best.map_or(f64::INFINITY, |b| b.0) < unclear || unclear == f64::INFINITY).then_some(best)
}

fn both(prims: &[Primitive]) -> [Accel; 2] {
    let items = prepare(prims, &surfaces(prims, |_| false), &[]).unwrap();
    [
        Accel::linear(&items, &[]),
        Accel::tree(&items, &[]).unwrap(),
    ]
}

#[test]
fn agrees_with_brute_force_in_f64() {
    for (seed, scale) in [(1, 1.0), (2, 1e6), (3, 1e-4)] {
        let mut random = Random(seed);
        let prims: Vec<_> = (0..300).map(|_| random.primitive(scale)).collect();
        let [linear, tree] = both(&prims);
        let mut hits = 0;
        for _ in 0..40_000 {
            let (o, d) = (random.vector(1.2 * scale), random.direction());
            let found = linear.intersect(o, d, f32::INFINITY, NOWHERE);
            assert_eq!(found, tree.intersect(o, d, f32::INFINITY, NOWHERE));
            let Some(expected) = nearest(&prims, o, d) else {
                continue;
            };
            assert_eq!(
                found.map(|h| h.prim as usize),
                expected.map(|e| e.1),
                "{o:?} {d:?} {found:?} {expected:?}"
            );
            let (Some(h), Some((t, _))) = (found, expected) else {
                continue;
            };
            hits += 1;
            let scale = f64::from(scale);
            assert!(
                (f64::from(h.t) - t).abs() <= 2e-5 * (t + 0.01 * scale),
                "{} {t}",
                h.t
            );
            for accel in [&linear, &tree] {
                assert!(accel.occluded(o, d, f32::INFINITY, [NOWHERE; 2]));
                assert!(accel.occluded(o, d, h.t * 1.001, [NOWHERE; 2]));
                assert!(!accel.occluded(o, d, h.t * 0.999, [NOWHERE; 2]));
                assert_eq!(accel.intersect(o, d, h.t, NOWHERE), None);
            }
        }
        assert!(hits > 8_000, "{hits}");
    }
}

/// A lane per ray and a lane per primitive are the same test: equal bits, also among coinciding
/// primitives, with limits, and when a ray of the packet needs special care.
#[test]
fn packets_agree_with_single_rays() {
    let mut random = Random(31);
    let mut prims: Vec<_> = (0..40).map(|_| random.primitive(1.0)).collect();
    prims.extend_from_within(..20);
    for accel in both(&prims) {
        let mut hits = 0;
        for round in 0..2_000 {
            let rays: Vec<_> = (0..1 + round % PACKET_SIZE)
                .map(|i| {
                    let odd = if round % 7 == 0 && i == 3 { 1e3 } else { 1.0 };
                    let t_max = match i % 3 {
                        0 => f32::INFINITY,
                        1 => random.signed().abs(),
                        _ => f32::NAN,
                    };
                    let d = random.direction().map(|x| x * odd);
                    (random.vector(1.2), d, t_max)
                })
                .collect();
            let mut packet = RayPacket::default();
            packet.push([0.0; 3], [1.0, 0.0, 0.0], 1.0, [NOWHERE; 2]);
            packet.clear();
            rays.iter()
                .for_each(|&(o, d, t)| packet.push(o, d, t, [NOWHERE; 2]));
            assert_eq!(packet.is_full(), rays.len() == PACKET_SIZE);
            let (found, occluded) = (
                accel.intersect_packet(&packet),
                accel.occluded_packet(&packet),
            );
            for (i, &(o, d, t_max)) in rays.iter().enumerate() {
                assert_eq!(found[i], accel.intersect(o, d, t_max, NOWHERE));
                assert_eq!(
                    occluded >> i & 1 != 0,
                    accel.occluded(o, d, t_max, [NOWHERE; 2])
                );
                hits += usize::from(found[i].is_some());
            }
        }
        assert!(hits > 500, "{hits}");
    }
}

/// What lies on the surfaces that a ray leaves, or goes to, might as well not be there: for single rays and for packets
/// whose rays have one goal or several, among primitives that share planes.
#[test]
fn surfaces_that_are_left_out_are_not_met() {
    let mut random = Random(57);
    let mut prims: Vec<_> = (0..20).map(|_| random.primitive(1.0)).collect();
    prims.extend_from_within(..10);
    let surfaces = surfaces(&prims, |_| true);
    assert!((20..30).any(|i| surfaces[i] == i as u32 - 20));
    let items = prepare(&prims, &surfaces, &[]).unwrap();
    let without = |skip: [u32; 2]| {
        let left = items.iter().filter(|i| !skip.contains(&i.tag.surface));
        Accel::linear(&left.copied().collect::<Vec<_>>(), &[])
    };
    let without: Vec<Vec<_>> = (0..20)
        .map(|i| (0..20).map(|j| without([i, j])).collect())
        .collect();
    for accel in [
        Accel::linear(&items, &[]),
        Accel::tree(&items, &[]).unwrap(),
    ] {
        let mut changed = 0;
        for round in 0..500 {
            let goal = random.bits() as u32 % 20;
            let rays: Vec<_> = (0..PACKET_SIZE)
                .map(|_| {
                    let (o, d) = (random.vector(1.2), random.direction());
                    let met = accel.intersect(o, d, f32::INFINITY, NOWHERE);
                    let from = met.map_or(0, |h| surfaces[h.prim as usize] % 20);
                    let to = match round % 2 {
                        0 => goal,
                        _ => random.bits() as u32 % 20,
                    };
                    (o, d, [from, to])
                })
                .collect();
            let mut packet = RayPacket::default();
            rays.iter()
                .for_each(|&(o, d, skip)| packet.push(o, d, 1.0, skip));
            let found = accel.intersect_packet(&packet);
            let occluded = accel.occluded_packet(&packet);
            for (i, &(o, d, [from, to])) in rays.iter().enumerate() {
                let expected = without[from as usize][from as usize].intersect(o, d, 1.0, NOWHERE);
                assert_eq!(accel.intersect(o, d, 1.0, from), expected);
                assert_eq!(found[i], expected);
                let all = accel.intersect(o, d, 1.0, NOWHERE);
                changed += usize::from(all != expected);
                let blocked = without[from as usize][to as usize].occluded(o, d, 1.0, [NOWHERE; 2]);
                assert_eq!(accel.occluded(o, d, 1.0, [from, to]), blocked);
                assert_eq!(occluded >> i & 1 != 0, blocked);
            }
        }
        assert!(changed > 50, "{changed}");
    }
}

/// Most rays meet a plane at a moderate angle; there all three numbers are good to a few ulps of
/// the distance.
#[test]
fn distances_and_coordinates_are_precise() {
    let mut random = Random(4);
    for _ in 0..50_000 {
        let p = random.primitive(1.0);
        let accel = Accel::build(&[p]).unwrap();
        let (o, d) = (random.vector(3.0), random.direction());
        let Some(h) = accel.intersect(o, d, f32::INFINITY, NOWHERE) else {
            continue;
        };
        let (v0, e1, e2) = match p {
            Primitive::Triangle { v0, e1, e2 } | Primitive::Parallelogram { v0, e1, e2 } => {
                (wide64(v0), wide64(e1), wide64(e2))
            }
            _ => continue,
        };
        let n = unit(cross64(e1, e2));
        let cosine = dot64(n, wide64(d)).abs();
        if cosine < 0.1 {
            continue;
        }
        let t = reference(&p, o, d)[0].0;
        assert!(
            (f64::from(h.t) - t).abs() < 1e-6 * t / cosine,
            "{} {t} {cosine}",
            h.t
        );
        for k in 0..3 {
            let surface = v0[k] + f64::from(h.u) * e1[k] + f64::from(h.v) * e2[k];
            let ray = f64::from(o[k]) + t * f64::from(d[k]);
            assert!(
                (surface - ray).abs() < 3e-6 / cosine,
                "{surface} {ray} {cosine}"
            );
        }
    }
}

#[test]
fn far_small_spheres_are_hit_where_they_are() {
    let mut random = Random(5);
    for _ in 0..20_000 {
        let d = random.direction();
        let distance = 1e4 * (1.0 + random.signed().abs());
        let center = d.map(|x| x * distance);
        let p = Primitive::Sphere {
            center,
            radius: 0.05,
        };
        let accel = Accel::build(&[p]).unwrap();
        let o = random.vector(0.02);
        let found = accel.intersect(o, d, f32::INFINITY, NOWHERE);
        if let Some(Some((t, _))) = nearest(&[p], o, d) {
            assert!((f64::from(found.unwrap().t) / t - 1.0).abs() < 1e-7);
        }
    }
}

/// A bumpy closed surface: every ray from inside must hit it.
fn blob(n: usize, offset: f32) -> Vec<Primitive> {
    let vertex = |i: usize, j: usize| -> [f32; 3] {
        let theta = std::f64::consts::PI * i as f64 / n as f64;
        let phi = std::f64::consts::TAU * (j % (2 * n)) as f64 / (2 * n) as f64;
        let s = if i.is_multiple_of(n) {
            0.0
        } else {
            theta.sin()
        };
        let r = 1.0
            + if i.is_multiple_of(n) {
                0.0
            } else {
                0.1 * (7.0 * theta).sin() * (5.0 * phi).cos()
            };
        [r * s * phi.cos(), r * s * phi.sin(), r * theta.cos()].map(|x| x as f32 + offset)
    };
    let mut prims = Vec::new();
    for i in 0..n {
        for j in 0..2 * n {
            let [a, b, c, d] = [
                vertex(i, j),
                vertex(i + 1, j),
                vertex(i + 1, j + 1),
                vertex(i, j + 1),
            ];
            for (p, q, r) in [(a, b, c), (a, c, d)] {
                let minus = |x: [f32; 3]| std::array::from_fn(|k| x[k] - p[k]);
                prims.push(Primitive::Triangle {
                    v0: p,
                    e1: minus(q),
                    e2: minus(r),
                });
            }
        }
    }
    prims
}

#[test]
fn closed_mesh_does_not_leak() {
    for (n, offset) in [(100, 0.0), (40, 100.0)] {
        let accel = Accel::build(&blob(n, offset)).unwrap();
        let mut random = Random(6);
        let mut leaks = 0;
        for _ in 0..500_000 {
            let o = random.vector(0.3).map(|x| x + offset);
            let d = random.direction();
            leaks += usize::from(accel.intersect(o, d, f32::INFINITY, NOWHERE).is_none());
            leaks += usize::from(!accel.occluded(o, d, f32::INFINITY, [NOWHERE; 2]));
        }
        assert_eq!(leaks, 0);
    }
}

/// Rays aimed at vertices and edges, where a leak would be if there were any.
#[test]
fn edges_and_vertices_do_not_leak() {
    let prims = blob(30, 0.0);
    let [linear, tree] = both(&prims);
    let mut random = Random(7);
    for p in &prims {
        let Primitive::Triangle { v0, e1, e2 } = *p else {
            unreachable!()
        };
        for k in 0..20 {
            let w = if k < 4 {
                0.0
            } else {
                0.5 + 0.5 * random.signed()
            };
            let e = match k % 3 {
                0 => e1.map(|x| x * w),
                1 => e2.map(|x| x * w),
                _ => std::array::from_fn(|i| e1[i] * w + e2[i] * (1.0 - w)),
            };
            let o = random.vector(0.3);
            let d = std::array::from_fn(|i| v0[i] + e[i] - o[i]);
            let found = linear.intersect(o, d, f32::INFINITY, NOWHERE);
            assert!(found.is_some(), "{o:?} {d:?}");
            assert_eq!(found, tree.intersect(o, d, f32::INFINITY, NOWHERE));
        }
    }
}

/// Slivers reach over none of their sides by more than roundings of the ray, whichever corner comes first, and coordinates
/// belong to the corners as they were given.
#[test]
fn thin_triangles_end_at_their_sides() {
    let tip = [-1.0, 0.0, 0.0];
    let (right, left) = ([1.0, 1e-4, 0.0], [1.0, -1e-4, 0.0]);
    for (a, b, c) in [(tip, left, right), (left, right, tip), (right, tip, left)] {
        let to = |p: [f32; 3]| each([0, 1, 2], |k: usize| p[k] - a[k]);
        let (e1, e2) = (to(b), to(c));
        let triangle = Primitive::Triangle { v0: a, e1, e2 };
        // Beside others, of which none is met, it lies in a hierarchy as well.
        let far = |k: usize| Primitive::Sphere {
            center: [0.0, 50.0 + k as f32, 0.0],
            radius: 0.1,
        };
        let many: Vec<_> = [triangle].into_iter().chain((0..100).map(far)).collect();
        for accel in [vec![triangle], many].map(|prims| Accel::build(&prims).unwrap()) {
            let ray = |x: f32, y: f32| accel.intersect([x, y, 2.0], [0.0, 0.0, -1.0], 9.0, NOWHERE);
            assert_eq!(ray(1.0 + 1e-5, 0.0), None, "over the short side");
            assert_eq!(ray(-1.02, 1e-5), None, "beyond the tip, beside its axis");
            assert_eq!(ray(0.0, 5e-5 + 1e-5), None, "over a long side");
            for x in [-0.9_f32, -0.3, 0.5, 0.99] {
                let hit = ray(x, 2e-5 * (1.0 + x)).expect("a hit");
                let p: [f32; 3] = each([0, 1, 2], |k: usize| a[k] + hit.u * e1[k] + hit.v * e2[k]);
                assert!((p[0] - x).abs() < 1e-3, "{p:?}, expected {x}");
                assert!(
                    (p[1] - 2e-5 * (1.0 + x)).abs() < 1e-6,
                    "{p:?}, expected {x}"
                );
            }
        }
    }
}

/// A tube of slivers, of which each side is shared by two, seen from its axis.
#[test]
fn thin_triangles_do_not_leak() {
    const COUNT: usize = 1500;
    let corner = |k: usize, y: f32| {
        let (z, x) = (std::f64::consts::TAU * (k % COUNT) as f64 / COUNT as f64).sin_cos();
        [7.0 + x as f32, y, 3.0 + z as f32]
    };
    let triangle = |[a, b, c]: [[f32; 3]; 3]| Primitive::Triangle {
        v0: a,
        e1: each([0, 1, 2], |k: usize| b[k] - a[k]),
        e2: each([0, 1, 2], |k: usize| c[k] - a[k]),
    };
    let (low, high) = (-5.0, 6.0);
    let mut prims = Vec::new();
    for k in 0..COUNT {
        let [a, b] = [corner(k, low), corner(k, high)];
        let [d, c] = [corner(k + 1, low), corner(k + 1, high)];
        // Corners in all orders.
        let mut faces = [[a, b, c], [c, d, a]];
        faces.iter_mut().for_each(|f| f.rotate_left(k % 3));
        prims.extend(faces.map(triangle));
    }
    let accel = Accel::build(&prims).unwrap();
    let mut random = Random(17);
    for i in 0..60_000 {
        let origin = [7.0, random.signed(), 3.0];
        // Every other one at a side that two faces share.
        let mut at = corner(i % COUNT, 4.0 * random.signed());
        if i % 2 == 1 {
            let other = corner(i % COUNT + 1, high);
            let s = 0.5 + 0.5 * random.signed();
            let start = corner(i % COUNT, low);
            at = each([0, 1, 2], |k: usize| start[k] + s * (other[k] - start[k]));
            at[1] = at[1].clamp(-4.0, 5.0);
        }
        let d = each([0, 1, 2], |k: usize| at[k] - origin[k]);
        let hit = accel.intersect(origin, d, f32::INFINITY, NOWHERE);
        assert!(hit.is_some(), "a leak at {at:?}");
    }
}

fn cube(half: f32) -> Vec<Primitive> {
    let mut prims = Vec::new();
    for axis in 0..3 {
        for side in [-half, half] {
            let mut v0 = [-half; 3];
            v0[axis] = side;
            let (mut e1, mut e2) = ([0.0; 3], [0.0; 3]);
            e1[(axis + 1) % 3] = 2.0 * half;
            e2[(axis + 2) % 3] = 2.0 * half;
            prims.push(Primitive::Parallelogram { v0, e1, e2 });
        }
    }
    prims
}

/// Directions and origins on the axes, faces, edges and corners of a box.
#[test]
fn axis_aligned_rays_hit_boxes() {
    let prims = cube(1.0);
    let values = [-1.0, -0.5, -0.0, 0.0, 0.25, 1.0];
    for accel in both(&prims) {
        for x in values {
            for y in values {
                for z in [-0.75, 0.0, 0.75] {
                    for axis in 0..3 {
                        for sign in [-1.0, 1.0] {
                            let mut o = [x, y, z];
                            o.rotate_right(axis);
                            let mut d = [-0.0, 0.0, sign];
                            d.rotate_right(axis);
                            let h = accel.intersect(o, d, f32::INFINITY, NOWHERE).unwrap();
                            assert_eq!(h.t, 1.0 - sign * z, "{o:?} {d:?}");
                            assert!(accel.occluded(o, d, f32::INFINITY, [NOWHERE; 2]));
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn rays_from_a_surface_do_not_hit_it_again() {
    let mut prims = cube(1.0);
    prims.push(Primitive::Disk {
        center: [0.0; 3],
        e1: [0.5, 0.0, 0.0],
        e2: [0.0, 0.5, 0.0],
    });
    let mut random = Random(8);
    for accel in both(&prims) {
        for _ in 0..2000 {
            let mut d = random.direction();
            d[2] = d[2].abs();
            let o = [0.2 * random.signed(), 0.2 * random.signed(), -1.0];
            assert_ne!(
                accel
                    .intersect(o, d, f32::INFINITY, NOWHERE)
                    .map(|h| h.prim),
                Some(4)
            );
            let h = accel
                .intersect([o[0], o[1], 0.0], d, f32::INFINITY, NOWHERE)
                .unwrap();
            assert_ne!(h.prim, 6);
        }
    }
}

#[test]
fn lowest_primitive_wins_ties() {
    let one = Primitive::Parallelogram {
        v0: [-1.0, -1.0, 0.0],
        e1: [2.0, 0.0, 0.0],
        e2: [0.0, 2.0, 0.0],
    };
    let mut prims = vec![one; 100];
    prims[0] = Primitive::Sphere {
        center: [0.0, 0.0, 9.0],
        radius: 1.0,
    };
    prims[1] = Primitive::Disk {
        center: [0.0; 3],
        e1: [1.0, 0.0, 0.0],
        e2: [0.0, 1.0, 0.0],
    };
    let mut random = Random(9);
    for accel in both(&prims) {
        for _ in 0..1000 {
            let o = [1.5 * random.signed(), 1.5 * random.signed(), -1.0];
            let prim = accel
                .intersect(o, [0.0, 0.0, 1.0], 5.0, NOWHERE)
                .map(|h| h.prim);
            let inside = o[0].abs() < 1.0 && o[1].abs() < 1.0;
            let round = o[0] * o[0] + o[1] * o[1] < 1.0;
            assert_eq!(prim, inside.then_some(if round { 1 } else { 2 }));
        }
    }
}

#[test]
fn degenerate_primitives_are_never_hit() {
    let x = [1.0, 0.0, 0.0];
    let prims = [
        Primitive::Triangle {
            v0: [0.0; 3],
            e1: x,
            e2: x,
        },
        Primitive::Triangle {
            v0: [0.0; 3],
            e1: [0.1, 0.2, 0.3],
            e2: [0.3, 0.6, 0.9],
        },
        Primitive::Parallelogram {
            v0: [0.0; 3],
            e1: [0.0; 3],
            e2: x,
        },
        Primitive::Sphere {
            center: [0.0; 3],
            radius: 0.0,
        },
        Primitive::Sphere {
            center: [0.0; 3],
            radius: -1.0,
        },
        Primitive::Disk {
            center: [0.0; 3],
            e1: x,
            e2: [0.0; 3],
        },
        Primitive::Cylinder {
            p0: [0.0; 3],
            axis: [0.0; 3],
            radius: 1.0,
        },
        Primitive::Cylinder {
            p0: [0.0; 3],
            axis: x,
            radius: 0.0,
        },
    ];
    let mut random = Random(10);
    for accel in both(&prims) {
        for _ in 0..1000 {
            let o = random.vector(1.0);
            let d = if random.bits().is_multiple_of(2) {
                o.map(|x| -x)
            } else {
                random.direction()
            };
            assert_eq!(accel.intersect(o, d, f32::INFINITY, NOWHERE), None);
            assert!(!accel.occluded(o, d, f32::INFINITY, [NOWHERE; 2]));
        }
    }
}

#[test]
fn empty_set_is_never_hit() {
    for accel in both(&[]).into_iter().chain([Accel::build(&[]).unwrap()]) {
        assert_eq!(
            accel.intersect([0.0; 3], [0.0, 0.0, 1.0], f32::INFINITY, NOWHERE),
            None
        );
        assert!(!accel.occluded([0.0; 3], [0.0, 0.0, 1.0], f32::INFINITY, [NOWHERE; 2]));
    }
}

#[test]
fn bad_coordinates_name_the_primitive() {
    let good = Primitive::Sphere {
        center: [0.0; 3],
        radius: 1.0,
    };
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e20] {
        for p in [
            Primitive::Sphere {
                center: [0.0, bad, 0.0],
                radius: 1.0,
            },
            Primitive::Sphere {
                center: [0.0; 3],
                radius: bad,
            },
            Primitive::Triangle {
                v0: [0.0; 3],
                e1: [0.0, 1.0, 0.0],
                e2: [0.0, 0.0, bad],
            },
        ] {
            let error = Accel::build(&[good, good, p]).unwrap_err();
            assert!(matches!(error, AccelError::Coordinate { primitive: 2, .. }));
            assert!(error.to_string().contains("primitive 2"), "{error}");
        }
    }
}

#[test]
fn strange_rays_miss_or_give_finite_hits() {
    let mut random = Random(11);
    let prims: Vec<_> = (0..100).map(|_| random.primitive(1.0)).collect();
    let odd = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        1e-45,
        1e-38,
        1e-30,
        -1e-19,
        1e-10,
        1e10,
        1e19,
        -1e30,
        3e38,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
    ];
    let accels = both(&prims);
    for _ in 0..200_000 {
        let mut pick = || odd[(random.bits() % odd.len() as u64) as usize];
        let o = [pick(), pick(), pick()];
        let d = [pick(), pick(), pick()];
        let t_max = pick();
        let found = accels[0].intersect(o, d, t_max, NOWHERE);
        assert_eq!(
            found,
            accels[1].intersect(o, d, t_max, NOWHERE),
            "{o:?} {d:?} {t_max}"
        );
        let blocked = accels[0].occluded(o, d, t_max, [NOWHERE; 2]);
        assert_eq!(blocked, accels[1].occluded(o, d, t_max, [NOWHERE; 2]));
        assert_eq!(blocked, found.is_some());
        if let Some(h) = found {
            assert!(h.t > 0.0 && h.t < t_max && h.u.is_finite() && h.v.is_finite());
            assert!(d.iter().all(|x| x.is_finite()) && d != [0.0; 3]);
        }
    }
}

#[test]
fn direction_length_only_scales_the_distance() {
    let mut random = Random(12);
    let prims: Vec<_> = (0..50).map(|_| random.primitive(1.0)).collect();
    for accel in both(&prims) {
        for _ in 0..2000 {
            let (o, d) = (random.vector(1.0), random.direction());
            let one = accel.intersect(o, d, f32::INFINITY, NOWHERE);
            for exponent in [-50, -20, -3, 2, 20, 50] {
                let s = 2f32.powi(exponent);
                let other = accel.intersect(o, d.map(|x| x * s), f32::INFINITY, NOWHERE);
                assert_eq!(one.map(|h| Hit { t: h.t / s, ..h }), other);
            }
        }
    }
}

/// Identical and geometrically shrinking primitives make lopsided trees.
#[test]
fn lopsided_scenes_build() {
    let sphere = |x: f32, radius: f32| Primitive::Sphere {
        center: [x, 0.0, 0.0],
        radius,
    };
    let same = vec![sphere(2.0, 1.0); 50_000];
    let shrinking: Vec<_> = (0..5000)
        .map(|i| {
            let x = 1e9 * 0.99f32.powi(i);
            sphere(x, 0.001 * x + 1e-6)
        })
        .collect();
    for prims in [same, shrinking] {
        let accel = Accel::tree(
            &prepare(&prims, &surfaces(&prims, |_| false), &[]).unwrap(),
            &[],
        )
        .expect("shallow enough");
        let h = accel
            .intersect([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], f32::INFINITY, NOWHERE)
            .unwrap();
        assert!(h.t > 0.9 && h.t < 2.1);
    }
}

/// Shapes that contain each other: of these, clustering alone would take minutes.
#[test]
fn nested_shapes_build_and_are_hit() {
    let n = 100_000;
    let size = |i: usize| 1.0 + i as f32 / 1024.0;
    let balls: Vec<_> = (0..n)
        .map(|i| Primitive::Sphere {
            center: [0.0; 3],
            radius: size(i),
        })
        .collect();
    let triangles: Vec<_> = (0..n)
        .map(|i| Primitive::Triangle {
            v0: [-size(i), -size(i), -size(i)],
            e1: [2.0 * size(i), 0.0, 0.0],
            e2: [size(i), 2.0 * size(i), 0.0],
        })
        .collect();
    for (prims, down) in [(balls, true), (triangles, false)] {
        let accel = Accel::build(&prims).unwrap();
        assert!(accel.has_hierarchy());
        let d = if down {
            [0.0, 0.0, -1.0]
        } else {
            [0.0, 0.0, 1.0]
        };
        let h = accel.intersect([0.0, 0.0, -200.0 * d[2]], d, f32::INFINITY, NOWHERE);
        let h = h.expect("the outermost is hit");
        assert_eq!(h.prim as usize, n - 1);
        assert!((h.t - (200.0 - size(n - 1))).abs() < 1e-3, "{}", h.t);
        // From inside, the innermost.
        let h = accel.intersect([0.0; 3], [0.0, 0.0, -1.0], f32::INFINITY, NOWHERE);
        let h = h.expect("the innermost is hit");
        assert_eq!(h.prim, 0);
        assert!((h.t - 1.0).abs() < 1e-5, "{}", h.t);
    }
}

#[test]
fn memory_grows_with_the_scene() {
    let small = Accel::build(&cube(1.0)).unwrap().memory_bytes();
    let large = Accel::build(&blob(40, 0.0)).unwrap().memory_bytes();
    assert!((512..4096).contains(&small), "{small}");
    assert!((6400 * 64..6400 * 220).contains(&large), "{large}");
}

/// A waving sheet of triangles with balls and tubes in front of it, at some time; what stands in `gone` has shrunk to
/// nothing.
fn sheet(time: f32, gone: &[usize]) -> Vec<Primitive> {
    const N: usize = 24;
    let corner = |i: usize, j: usize| {
        let (x, y) = (i as f32 / N as f32 - 0.5, j as f32 / N as f32 - 0.5);
        let z = 0.2 * (5.0 * x + time).sin() * (4.0 * y - 0.5 * time).cos();
        [x + 0.1 * time * y, y, z]
    };
    let minus = |a: [f32; 3], b: [f32; 3]| std::array::from_fn(|k| a[k] - b[k]);
    let mut prims = Vec::new();
    for i in 0..N {
        for j in 0..N {
            let [a, b, c, d] = [
                corner(i, j),
                corner(i + 1, j),
                corner(i + 1, j + 1),
                corner(i, j + 1),
            ];
            for (e1, e2) in [(b, c), (c, d)] {
                prims.push(Primitive::Triangle {
                    v0: a,
                    e1: minus(e1, a),
                    e2: minus(e2, a),
                });
            }
        }
    }
    for i in 0..12 {
        let x = i as f32 / 12.0 - 0.5;
        let center = [x, 0.3 * (x * 9.0 + time).sin(), 0.4];
        prims.push(Primitive::Sphere {
            center,
            radius: 0.02,
        });
        prims.push(Primitive::Cylinder {
            p0: center,
            axis: [0.0, 0.1, 0.05 * time],
            radius: 0.01,
        });
    }
    for &i in gone {
        match &mut prims[i] {
            Primitive::Triangle { e1, .. } => *e1 = [0.0; 3],
            Primitive::Sphere { radius, .. } => *radius = 0.0,
            _ => panic!("neither a triangle nor a ball"),
        }
    }
    prims
}

/// Both structures see the same, bit by bit, ray by ray and in packets.
fn assert_equal_hits(a: &Accel, b: &Accel, random: &mut Random) {
    let mut hits = 0;
    for _ in 0..200 {
        let mut packet = RayPacket::default();
        while !packet.is_full() {
            let (o, at) = (random.direction().map(|x| 2.0 * x), random.vector(0.4));
            let d = unit(sub64(wide64(at), wide64(o))).map(|x| x as f32);
            packet.push(o, d, f32::INFINITY, [NOWHERE; 2]);
            let hit = b.intersect(o, d, f32::INFINITY, NOWHERE);
            assert_eq!(a.intersect(o, d, f32::INFINITY, NOWHERE), hit);
            assert_eq!(
                a.occluded(o, d, 2.0, [NOWHERE; 2]),
                b.occluded(o, d, 2.0, [NOWHERE; 2])
            );
            hits += usize::from(hit.is_some());
        }
        assert_eq!(a.intersect_packet(&packet), b.intersect_packet(&packet));
        assert_eq!(a.occluded_packet(&packet), b.occluded_packet(&packet));
    }
    assert!(hits > 1000, "{hits}");
}

/// A hierarchy whose primitives move gives the hits of one that is built around them; it says when it got too loose,
/// and is then built anew.
#[test]
fn refitted_hierarchies_give_the_hits_of_new_ones() {
    let mut random = Random(77);
    let start = sheet(0.0, &[]);
    let mut moving = Accel::build(&start).expect("in reach");
    assert!(moving.has_hierarchy());
    let surfaces = |prims: &[Primitive]| surfaces(prims, |_| false);

    // At rest nothing changes.
    let at_rest = moving.refit(&start, &surfaces(&start), &[]);
    assert_eq!(at_rest, Ok(Refit::Kept { looseness: 1.0 }));
    for time in [0.1, 0.4, 0.3] {
        let prims = sheet(time, &[]);
        let refit = moving
            .refit(&prims, &surfaces(&prims), &[])
            .expect("in reach");
        let Refit::Kept { looseness } = refit else {
            panic!("rebuilt at {time}");
        };
        assert!((0.9..1.5).contains(&looseness), "{looseness}");
        assert_equal_hits(
            &moving,
            &Accel::build(&prims).expect("in reach"),
            &mut random,
        );
    }

    // Triangles may vanish and come back.
    for gone in [&[3, 4, 5, 6, 7, 8, 100][..], &[]] {
        let prims = sheet(0.3, gone);
        let refit = moving
            .refit(&prims, &surfaces(&prims), &[])
            .expect("in reach");
        assert!(matches!(refit, Refit::Kept { .. }));
        assert_equal_hits(
            &moving,
            &Accel::build(&prims).expect("in reach"),
            &mut random,
        );
    }

    // A ball that vanishes, and one that comes, need a new hierarchy.
    let ball = start.len() - 2;
    for gone in [&[ball][..], &[]] {
        let prims = sheet(0.3, gone);
        let refit = moving.refit(&prims, &surfaces(&prims), &[]);
        assert_eq!(refit, Ok(Refit::Rebuilt));
        assert_equal_hits(
            &moving,
            &Accel::build(&prims).expect("in reach"),
            &mut random,
        );
    }

    // Neighbours that are neighbours no more.
    let mut mixed = sheet(0.3, &[]);
    for i in 0..mixed.len() / 2 {
        let j = i + random.bits() as usize % (mixed.len() - i);
        mixed.swap(i, j);
    }
    let refit = moving.refit(&mixed, &surfaces(&mixed), &[]);
    assert_eq!(refit, Ok(Refit::Rebuilt));
    assert_equal_hits(
        &moving,
        &Accel::build(&mixed).expect("in reach"),
        &mut random,
    );
    let tree = |accel: &Accel| match &accel.layout {
        Layout::Tree(tree) => tree.clone(),
        Layout::Linear(..) => panic!("no hierarchy"),
    };
    let items = prepare(&sheet(0.3, &[]), &surfaces(&mixed), &[]).expect("in reach");
    let mut scattered: Vec<Item> = items.clone();
    let n = 2 * 24 * 24;
    for (i, item) in scattered.iter_mut().enumerate().take(n) {
        // The primitive that item `i` is stands somewhere else, and is of the same kind.
        item.tag.id = 4 * ((i * 389) % n) as u32;
    }
    let sorted = Accel::build(&sheet(0.3, &[])).expect("in reach");
    let looseness = tree(&sorted)
        .refit(&scattered, &[])
        .expect("the same primitives");
    assert!(looseness > 10.0, "{looseness}");

    // What is out of reach changes nothing.
    let mut far = mixed.clone();
    if let Primitive::Sphere { center, .. } | Primitive::Cylinder { p0: center, .. } =
        &mut far[ball]
    {
        center[0] = f32::NAN;
    }
    if let Primitive::Triangle { v0, .. } = &mut far[ball] {
        v0[0] = f32::NAN;
    }
    assert!(moving.refit(&far, &surfaces(&mixed), &[]).is_err());
    assert_equal_hits(
        &moving,
        &Accel::build(&mixed).expect("in reach"),
        &mut random,
    );
}

/// Few primitives have no hierarchy; they are taken over as they are.
#[test]
fn lists_follow_what_moves() {
    let mut random = Random(78);
    let some = |random: &mut Random| -> Vec<Primitive> {
        (0..20).map(|_| random.primitive(0.4)).collect()
    };
    let mut moving = Accel::build(&some(&mut random)).expect("in reach");
    let prims = some(&mut random);
    let refit = moving.refit(&prims, &surfaces(&prims, |_| false), &[]);
    assert_eq!(refit, Ok(Refit::Rebuilt));
    for _ in 0..1000 {
        let (o, d) = (random.vector(1.0), random.direction());
        let new = Accel::build(&prims).expect("in reach");
        let hit = new.intersect(o, d, f32::INFINITY, NOWHERE);
        assert_eq!(moving.intersect(o, d, f32::INFINITY, NOWHERE), hit);
    }
}
