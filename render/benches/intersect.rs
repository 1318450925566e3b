//! Ray throughput on one thread: a box of 18 parallelograms and wavy meshes inside it.
//!
//! `camera` rays are coherent; `bounce` rays leave the second diffuse vertex of a path; `shadow`
//! rays go from the first vertex to the light and only ask whether anything is in between.

use criterion::{BenchmarkGroup, Criterion, Throughput, measurement::WallTime};
use render::accel::{Accel, Primitive};
use render::math::NOWHERE;
use std::hint::black_box;
use std::time::Duration;

type V = [f32; 3];

fn add(a: V, b: V) -> V {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}
fn sub(a: V, b: V) -> V {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}
fn scale(a: V, s: f32) -> V {
    a.map(|x| x * s)
}
fn dot(a: V, b: V) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
fn cross(a: V, b: V) -> V {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
fn unit(a: V) -> V {
    scale(a, 1.0 / dot(a, a).sqrt())
}

struct Random(u64);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1 << 24) as f32
    }
    fn sphere(&mut self) -> V {
        let z = 1.0 - 2.0 * self.unit();
        let (s, c) = (std::f32::consts::TAU * self.unit()).sin_cos();
        let r = (1.0 - z * z).sqrt();
        [r * c, r * s, z]
    }
}

fn sheet(v0: V, e1: V, e2: V) -> Primitive {
    Primitive::Parallelogram { v0, e1, e2 }
}

fn block(half: V, angle: f32, at: V) -> impl Iterator<Item = Primitive> {
    let (s, c) = angle.to_radians().sin_cos();
    let turn = move |v: V| [c * v[0] + s * v[2], v[1], c * v[2] - s * v[0]];
    (0..6).map(move |face| {
        let axis = face / 2;
        let mut v0 = scale(half, -1.0);
        v0[axis] = if face % 2 == 0 {
            -half[axis]
        } else {
            half[axis]
        };
        let (mut e1, mut e2) = ([0.0; 3], [0.0; 3]);
        e1[(axis + 1) % 3] = 2.0 * half[(axis + 1) % 3];
        e2[(axis + 2) % 3] = 2.0 * half[(axis + 2) % 3];
        sheet(add(turn(v0), at), turn(e1), turn(e2))
    })
}

/// Walls and light of the usual box, `[-1, 1]^3`, open towards `+z`.
fn walls() -> Vec<Primitive> {
    let (x, y, z) = ([2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]);
    vec![
        sheet([-1.0, -1.0, -1.0], x, z),
        sheet([-1.0, 1.0, -1.0], x, z),
        sheet([-1.0, -1.0, -1.0], x, y),
        sheet([-1.0, -1.0, -1.0], y, z),
        sheet([1.0, -1.0, -1.0], y, z),
        sheet([-0.25, 0.99, -0.25], [0.5, 0.0, 0.0], [0.0, 0.0, 0.5]),
    ]
}

fn cornell() -> Vec<Primitive> {
    let mut prims = walls();
    prims.extend(block([0.3, 0.3, 0.3], -17.0, [0.335, -0.7, 0.38]));
    prims.extend(block([0.3, 0.6, 0.3], 18.25, [-0.335, -0.4, -0.28]));
    prims
}

/// The box with a wavy water surface of `2 n^2` triangles.
fn waves(n: usize) -> Vec<Primitive> {
    let mut prims = walls();
    let point = |i: usize, j: usize| {
        let (x, z) = (
            2.0 * i as f32 / n as f32 - 1.0,
            2.0 * j as f32 / n as f32 - 1.0,
        );
        let ripple = (9.0 * x + 3.0 * z).sin() + (7.0 * z - 4.0 * x).cos() + (23.0 * x * z).sin();
        [x, -0.6 + 0.06 * ripple, z]
    };
    for i in 0..n {
        for j in 0..n {
            let [a, b, c, d] = [
                point(i, j),
                point(i + 1, j),
                point(i + 1, j + 1),
                point(i, j + 1),
            ];
            prims.push(Primitive::Triangle {
                v0: a,
                e1: sub(b, a),
                e2: sub(c, a),
            });
            prims.push(Primitive::Triangle {
                v0: a,
                e1: sub(c, a),
                e2: sub(d, a),
            });
        }
    }
    prims
}

type Segment = (V, V, f32);

struct Rays {
    camera: Vec<Segment>,
    bounce: Vec<Segment>,
    shadow: Vec<Segment>,
}

/// Leaves the hit diffusely, on the side the ray came from.
fn scatter(
    prims: &[Primitive],
    accel: &Accel,
    ray: Segment,
    random: &mut Random,
) -> Option<Segment> {
    let (o, d, t_max) = ray;
    let hit = accel.intersect(o, d, t_max, NOWHERE)?;
    let (Primitive::Triangle { e1, e2, .. } | Primitive::Parallelogram { e1, e2, .. }) =
        prims[hit.prim as usize]
    else {
        return None;
    };
    let n = unit(cross(e1, e2));
    let n = if dot(n, d) > 0.0 { scale(n, -1.0) } else { n };
    let from = add(add(o, scale(d, hit.t)), scale(n, 1e-4));
    Some((
        from,
        unit(add(n, scale(random.sphere(), 0.999))),
        f32::INFINITY,
    ))
}

fn rays(prims: &[Primitive], accel: &Accel) -> Rays {
    const SIDE: usize = 384;
    let mut random = Random(1);
    let mut rays = Rays {
        camera: vec![],
        bounce: vec![],
        shadow: vec![],
    };
    for y in 0..SIDE {
        for x in 0..SIDE {
            let at = |k: usize| (2.0 * (k as f32 + 0.5) / SIDE as f32 - 1.0) * 0.357;
            rays.camera
                .push(([0.0, 0.0, 3.9], unit([at(x), -at(y), -1.0]), f32::INFINITY));
        }
    }
    for &ray in &rays.camera {
        let Some(first) = scatter(prims, accel, ray, &mut random) else {
            continue;
        };
        let light = [0.5 * random.unit() - 0.25, 0.99, 0.5 * random.unit() - 0.25];
        rays.shadow.push((first.0, sub(light, first.0), 0.999));
        rays.bounce
            .extend(scatter(prims, accel, first, &mut random));
    }
    rays
}

fn run(criterion: &mut Criterion, name: &str, prims: &[Primitive]) {
    let accel = Accel::build(prims).expect("finite scene");
    let rays = rays(prims, &accel);
    let mut group: BenchmarkGroup<WallTime> = criterion.benchmark_group(name);
    group
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300));
    group.measurement_time(Duration::from_secs(1));
    for (kind, set) in [("camera", &rays.camera), ("bounce", &rays.bounce)] {
        group.throughput(Throughput::Elements(set.len() as u64));
        group.bench_function(kind, |b| {
            b.iter(|| {
                let mut sum = 0.0;
                for &(o, d, t) in set {
                    if let Some(h) = accel.intersect(o, d, t, NOWHERE) {
                        sum += h.t + h.u + h.v + h.prim as f32;
                    }
                }
                black_box(sum)
            });
        });
    }
    group.throughput(Throughput::Elements(rays.shadow.len() as u64));
    group.bench_function("shadow", |b| {
        b.iter(|| {
            let blocked = rays
                .shadow
                .iter()
                .filter(|&&(o, d, t)| accel.occluded(o, d, t, [NOWHERE; 2]));
            black_box(blocked.count())
        });
    });
    group.finish();
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    run(&mut criterion, "cornell", &cornell());
    run(&mut criterion, "waves-131k", &waves(256));
    run(&mut criterion, "waves-1M", &waves(708));
    criterion.final_summary();
}
