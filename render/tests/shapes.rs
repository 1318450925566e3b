//! Geometry: interactions, their derivatives, sampling, and the messages of bad input.

use std::f64::consts::PI;
use std::path::Path;

use ad_core::{Dual, Float, Real, Vec2, Vec3};
use proptest::prelude::*;
use render::SceneError;
use render::accel::{Accel, Hit, surfaces};
use render::math::{NOWHERE, Ray, Transform};
use render::params::Theta;
use render::plugin::xml::Document;
use render::sampler::{Independent, Sampler};
use render::scene::Builder;
use render::shape::{
    AnyShape, Cube, Cylinder, Disk, Mesh, MeshData, ObjOptions, Partials, Patch, Rectangle, Shape,
    Sphere, SurfaceCoordinates, SurfaceInteraction,
};
use render::statistics::{p_value, sidak, z_limit};

use crate::common;

/// Similar to the identity, but nothing is aligned or of unit size.
fn similarity() -> Transform {
    Transform::sequence([
        Transform::scale([0.7; 3]),
        Transform::rotate([1.0, 2.0, -0.5], 70.0).unwrap(),
        Transform::translate([0.3, -0.2, 0.4]),
    ])
}

fn affine() -> Transform {
    Transform::scale([1.2, 0.6, 0.9]).then(&similarity())
}

/// Two triangles with smooth normals and surface coordinates.
fn bent_mesh() -> Mesh {
    let data = MeshData {
        positions: vec![
            [-1.0, -1.0, 0.1],
            [1.0, -0.9, 0.0],
            [0.9, 1.0, 0.3],
            [-0.8, 1.1, -0.2],
        ],
        normals: vec![
            [-0.3, 0.0, 1.0],
            [0.4, -0.2, 1.0],
            [0.1, 0.5, 2.0],
            [0.0, 0.1, 1.0],
        ],
        uvs: vec![[0.0, 0.0], [1.0, 0.1], [0.9, 1.0], [0.2, 0.8]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    Mesh::new(data, false).unwrap()
}

/// Every shape, with a name.
fn shapes() -> Vec<(&'static str, AnyShape)> {
    let (p0, p1) = ([0.1, -0.8, 0.2], [0.3, 0.7, -0.1]);
    vec![
        ("cube", Cube::new(&affine(), false).unwrap().into()),
        (
            "sphere",
            Sphere::transformed(&similarity(), false).unwrap().into(),
        ),
        (
            "inside-out sphere",
            Sphere::new([0.1, 0.2, 0.3], 0.8, true).unwrap().into(),
        ),
        ("disk", Disk::new(&affine(), false).unwrap().into()),
        (
            "cylinder",
            Cylinder::new(p0, p1, 0.6, false).unwrap().into(),
        ),
        (
            "inside-out cylinder",
            Cylinder::new(p0, p1, 0.6, true).unwrap().into(),
        ),
        ("mesh", bent_mesh().into()),
    ]
}

/// Curves of both kinds, which bend and change their radius.
pub(crate) fn curves() -> Vec<(&'static str, AnyShape)> {
    use render::shape::{CurveKind, Curves};
    let points = vec![
        [-1.1, -0.9, 0.1, 0.35],
        [-0.9, 0.1, 0.3, 0.25],
        [-0.1, 0.7, -0.2, 0.3],
        [0.5, 0.2, 0.1, 0.2],
        [1.2, -0.3, 0.8, 0.3],
        [1.5, -1.2, 0.9, 0.4],
        [0.3, -1.4, -0.9, 0.2],
        [0.2, -0.4, -0.9, 0.2],
        [0.1, 0.5, -0.8, 0.25],
        [0.4, 1.2, -0.9, 0.2],
    ];
    let of = |kind| Curves::new(kind, points.clone(), &[0, 6]).unwrap().into();
    vec![
        ("curves", of(CurveKind::Spline)),
        ("linear curves", of(CurveKind::Linear)),
    ]
}

fn vec3(v: [f64; 3]) -> Vec3<f64> {
    v.into()
}

fn random_direction(u: [f64; 2]) -> Vec3<f64> {
    render::math::warp::square_to_sphere(u)
}

/// Finds hits, and makes interactions from them.
pub(crate) struct Tracer<'a> {
    shape: &'a AnyShape,
    accel: Accel,
}

impl<'a> Tracer<'a> {
    pub fn new(shape: &'a AnyShape) -> Self {
        let all = shape.primitives();
        let surfaces = surfaces(&all, |_| false);
        let accel = Accel::with_curves(&all, &surfaces, shape.control_points()).unwrap();
        Self { shape, accel }
    }

    pub fn hit<P: Float>(&self, ray: &Ray<P>) -> Option<Hit> {
        let single = |v: Vec3<P>| v.map(P::to_f32).to_array();
        self.accel
            .intersect(single(ray.o), single(ray.d), f32::INFINITY, NOWHERE)
    }

    pub fn first<P: Float>(&self, ray: &Ray<P>) -> Option<SurfaceInteraction<P>> {
        let hit = self.hit(ray)?;
        Some(self.shape.interaction(&Theta::still(), hit.prim, ray, &hit))
    }

    /// All hits along a ray.
    fn all(&self, mut ray: Ray<f64>) -> Vec<SurfaceInteraction<f64>> {
        let mut found = Vec::new();
        while let Some(si) = self.first(&ray) {
            // Far enough that a grazing ray is off the surface.
            let step = (1e-5 / si.n_geo.dot(ray.d).abs()).min(1e-3);
            ray.o = si.p + ray.d * step;
            found.push(si);
            assert!(found.len() < 20);
        }
        found
    }
}

/// Rays towards the shapes, from everywhere.
pub(crate) fn rays(n: u64, seed: u64) -> impl Iterator<Item = Ray<f64>> {
    (0..n).map(move |i| {
        let mut s = Independent::new(seed, 0, i);
        let target = random_direction(s.next_2d()) * 0.9 * s.next_1d::<f64>();
        let o = random_direction(s.next_2d()) * (0.2 + 3.0 * s.next_1d::<f64>());
        Ray::new(o, (target - o).normalize())
    })
}

#[test]
fn interactions_lie_on_the_ray_and_on_the_surface() {
    for (name, shape) in shapes().into_iter().chain(curves()) {
        let tracer = Tracer::new(&shape);
        let mut hits = 0;
        for ray in rays(2000, 1) {
            let Some(si) = tracer.first(&ray) else {
                continue;
            };
            hits += 1;
            assert!((si.p - ray.at(si.t)).length() < 1e-6, "{name}");
            assert!((si.n_geo.length() - 1.0).abs() < 1e-6, "{name}");
            let f = si.frame;
            let orthonormal = [
                f.s.length() - 1.0,
                f.t.length() - 1.0,
                f.n.length() - 1.0,
                f.s.dot(f.t),
                f.t.dot(f.n),
                f.n.dot(f.s),
                f.s.cross(f.t).dot(f.n) - 1.0,
            ];
            assert!(
                orthonormal.iter().all(|x| x.abs() < 1e-6),
                "{name} {orthonormal:?}"
            );
            assert!(f.n.dot(si.n_geo) > 0.0, "{name}");
            assert!((-1e-6..1.0 + 1e-6).contains(&si.uv.x), "{name} {:?}", si.uv);
            assert!((-1e-6..1.0 + 1e-6).contains(&si.uv.y), "{name} {:?}", si.uv);
            // The same in f32, which trusts the traversal's distance.
            let single = |v: Vec3<f64>| v.map(|x| x as f32);
            let ray32 = Ray::new(single(ray.o), single(ray.d));
            let si32 = tracer.first(&ray32).unwrap();
            let grazing = si.n_geo.dot(ray.d).abs();
            let error = (si32.p.map(f64::from) - si.p).length();
            assert!(
                error * grazing.max(1e-3) < 4e-6,
                "{name}: {error:e} at cosine {grazing}"
            );
        }
        assert!(hits > 200, "{name}: {hits}");
    }
}

/// Numbers of an interaction, and what they are.
fn numbers<R: Real>(si: &SurfaceInteraction<R>) -> [(&'static str, R); 18] {
    let ([px, py, pz], [nx, ny, nz]) = (si.p.to_array(), si.n_geo.to_array());
    let [s, t, n] = [si.frame.s, si.frame.t, si.frame.n].map(|v| v.to_array());
    [
        ("p.x", px),
        ("p.y", py),
        ("p.z", pz),
        ("n_geo.x", nx),
        ("n_geo.y", ny),
        ("n_geo.z", nz),
        ("s.x", s[0]),
        ("s.y", s[1]),
        ("s.z", s[2]),
        ("t.x", t[0]),
        ("t.y", t[1]),
        ("t.z", t[2]),
        ("n.x", n[0]),
        ("n.y", n[1]),
        ("n.z", n[2]),
        ("u", si.uv.x),
        ("v", si.uv.y),
        ("distance", si.t),
    ]
}

/// Against central differences with step 1e-6 in f64; error 1e-5 relative to the largest curvature on
/// these rays, which grazing hits would not bound.
#[test]
fn interactions_move_with_the_ray() {
    type D = Dual<f64, 6>;
    for (name, shape) in shapes().into_iter().chain(curves()) {
        let tracer = Tracer::new(&shape);
        let mut tested = 0;
        for ray in rays(400, 2) {
            let Some(hit) = tracer.hit(&ray) else {
                continue;
            };
            let at = |x: [f64; 6]| {
                let ray = Ray::new(vec3([x[0], x[1], x[2]]), vec3([x[3], x[4], x[5]]));
                shape.interaction(&Theta::still(), hit.prim, &ray, &hit)
            };
            let x: [f64; 6] = [ray.o.x, ray.o.y, ray.o.z, ray.d.x, ray.d.y, ray.d.z];
            let si = at(x);
            let wrap = si.uv.x.min(1.0 - si.uv.x);
            if si.n_geo.dot(ray.d).abs() < 0.2 || wrap < 1e-3 {
                continue;
            }
            tested += 1;
            let lift = |k: usize| D::var(x[k], k);
            let moving = Ray::new(
                Vec3::new(lift(0), lift(1), lift(2)),
                Vec3::new(lift(3), lift(4), lift(5)),
            );
            let dual = shape.interaction(&Theta::still(), hit.prim, &moving, &hit);
            for k in 0..6 {
                let step = |h: f64| {
                    let mut y = x;
                    y[k] += h;
                    at(y)
                };
                let (above, below) = (step(1e-6), step(-1e-6));
                let values = numbers(&above).into_iter().zip(numbers(&below));
                for ((what, d), ((_, a), (_, b))) in numbers(&dual).into_iter().zip(values) {
                    let expected = (a - b) / 2e-6;
                    let error = (d.eps[k] - expected).abs() / (1.0 + expected.abs());
                    assert!(
                        error < 1e-5,
                        "{name}: d {what} / d x{k} = {} vs {expected}",
                        d.eps[k]
                    );
                }
            }
        }
        assert!(tested > 40, "{name}: {tested}");
    }
}

/// Every shape, and a rectangle, and meshes without texture coordinates or normals.
fn all_shapes() -> Vec<(&'static str, AnyShape)> {
    let stripped = |change: &dyn Fn(&mut MeshData)| {
        let mut data = bent_mesh().data().clone();
        change(&mut data);
        Mesh::new(data, true).unwrap().into()
    };
    let patch = Patch::new([-0.9, -0.8, 0.1], [1.7, 0.2, 0.3], [0.1, 1.6, -0.2], true);
    let mut all = shapes();
    all.extend([
        ("rectangle", Rectangle(patch.unwrap()).into()),
        (
            "mesh without coordinates",
            stripped(&|data| data.uvs.clear()),
        ),
        (
            "mesh of flat triangles",
            stripped(&|data| data.normals.clear()),
        ),
        (
            "bare mesh",
            stripped(&|data| {
                data.uvs.clear();
                data.normals.clear();
            }),
        ),
    ]);
    all
}

/// Largest difference of two points on a surface, but for the distance along a ray: `u` may be off by whole turns.
fn difference<P: Float>(
    a: &SurfaceInteraction<P>,
    b: &SurfaceInteraction<P>,
) -> (f64, &'static str) {
    let pairs = numbers(a).into_iter().zip(numbers(b));
    let off = pairs.filter(|((what, _), _)| *what != "distance");
    off.map(|((what, x), (_, y))| {
        let d = (x - y).to_f64().abs();
        let turned = matches!(what, "u" | "v");
        (if turned { d.min((1.0 - d).abs()) } else { d }, what)
    })
    .max_by(|x, y| x.0.total_cmp(&y.0))
    .expect("numbers")
}

/// The coordinates of a hit are where it was: in f64 to rounding of the recomputed point, in f32 to some of them.
#[test]
fn coordinates_lead_back_to_the_point() {
    fn check<P: Float>(name: &str, shape: &AnyShape, limit: f64) {
        let tracer = Tracer::new(shape);
        let mut tested = 0;
        for ray in rays(2000, 11) {
            let of = |v: Vec3<f64>| v.map(P::of);
            let Some(hit) = tracer.hit(&Ray::new(of(ray.o), of(ray.d))) else {
                continue;
            };
            let ray = Ray::new(of(ray.o), of(ray.d));
            let si = shape.interaction(&Theta::still(), hit.prim, &ray, &hit);
            let at = shape.coordinates(hit.prim, &si);
            let back = shape.point_at(&Theta::still(), hit.prim, at);
            assert!(back.t == P::zero());
            // Around the middle of a disk, and the poles of a ball, directions are less well known than points.
            let middle = match name {
                "disk" => si.uv.x,
                "sphere" | "inside-out sphere" => (si.uv.y * P::of(PI)).sin(),
                "linear curves" => (P::one() + at.0.y).min(P::of(2.0) - at.0.y).min(P::one()),
                _ => P::one(),
            };
            let (off, what) = difference(&si, &back);
            assert!(
                off * middle.to_f64() < limit,
                "{name}: {what} is off by {off:e}"
            );
            tested += 1;
        }
        assert!(tested > 200, "{name}: {tested}");
    }
    for (name, shape) in all_shapes().into_iter().chain(curves()) {
        check::<f64>(name, &shape, 1e-12);
        // Across a thin curve directions are known less well than points.
        let thin = if name.ends_with("curves") { 10.0 } else { 1.0 };
        check::<f32>(name, &shape, 3e-6 * thin);
    }
}

/// A sample says where it is on its primitive.
#[test]
fn samples_lie_at_their_coordinates() {
    for (name, shape) in all_shapes().into_iter().chain(curves()) {
        for i in 0..500 {
            let u = Independent::new(12, 0, i).next_2d::<f64>();
            let (s, n_geo) = shape.sample_surface::<f64>(&Theta::still(), u);
            let at = shape.point_at(&Theta::still(), s.prim, s.coordinates);
            // The axes of balls and tubes are unit vectors in single precision only.
            assert!((at.p - s.p).length() < 1e-6, "{name}");
            assert!((at.frame.n - s.n).length() < 1e-6, "{name}");
            assert!(at.n_geo.cross(n_geo).length() < 1e-6, "{name}");
            let du = (at.uv.x - s.uv.x).abs();
            assert!(du.min(1.0 - du) < 1e-6, "{name}");
            assert!((at.uv.y - s.uv.y).abs() < 1e-6, "{name}");
        }
    }
}

/// The element of area over all coordinates is the area.
#[test]
fn elements_of_area_add_up() {
    for (name, shape) in all_shapes() {
        let measure = match &shape {
            AnyShape::Sphere(_) => 4.0 * PI,
            AnyShape::Disk(_) => PI,
            AnyShape::Mesh(_) | AnyShape::Instance(_) => 0.5,
            AnyShape::Rectangle(_) | AnyShape::Cube(_) | AnyShape::Cylinder(_) => 1.0,
            AnyShape::Curves(_) => unreachable!("not among them"),
        };
        let prims = shape.primitives().len() as u32;
        let element = |prim| shape.area_element::<f64>(&Theta::still(), prim);
        let sum: f64 = (0..prims).map(|prim| element(prim) * measure).sum();
        assert!((sum / shape.area() - 1.0).abs() < 1e-6, "{name}: {sum}");
    }
}

/// Position, normal and first axis, as functions of the surface coordinates, and the texture coordinates.
fn bends(at: &SurfaceInteraction<f64>) -> [Vec3<f64>; 3] {
    [at.p, at.frame.n, at.frame.s]
}

/// Both partial derivatives of each of [`bends`].
fn partials_of(p: &Partials<f64>) -> [[Vec3<f64>; 2]; 3] {
    [[p.dp_du, p.dp_dv], [p.dn_du, p.dn_dv], [p.ds_du, p.ds_dv]]
}

/// Central differences in f64 with step 1e-5 in each surface coordinate: `d x = x_u du + x_v dv`, to 1e-6 of the largest
/// term, at random points of every shape.
#[test]
fn partials_are_those_of_differences() {
    const STEP: f64 = 1e-5;
    for (name, shape) in all_shapes().into_iter().chain(curves()) {
        let tracer = Tracer::new(&shape);
        let mut tested = 0;
        for ray in rays(1500, 13) {
            let Some(hit) = tracer.hit(&ray) else {
                continue;
            };
            let si = shape.interaction(&Theta::still(), hit.prim, &ray, &hit);
            let SurfaceCoordinates(at) = shape.coordinates(hit.prim, &si);
            // Neither at a pole nor where an angle jumps, nor at a fold of the octahedron.
            let pole = match name {
                "disk" => si.uv.x < 0.05,
                _ if name.ends_with("sphere") => {
                    let fold = [at.x, at.y, 1.0 - at.x.abs() - at.y.abs()];
                    !(0.05..0.95).contains(&si.uv.y) || fold.iter().any(|x| x.abs() < 1e-3)
                }
                _ => false,
            };
            let wrap = |x: f64| x.min(1.0 - x) < 1e-3;
            if pole || wrap(si.uv.x) || wrap(si.uv.y) {
                continue;
            }
            tested += 1;
            let found = shape.partials(&Theta::still(), hit.prim, SurfaceCoordinates(at));
            if name == "linear curves" && !(0.01..0.99).contains(&at.y) {
                // The balls have one coordinate only.
                let ball = !(-0.01..1.01).contains(&at.y);
                assert!(found.is_none() || !ball);
                continue;
            }
            let found = found.expect("texture coordinates");
            for k in 0..2 {
                let point = |h: f64| {
                    let mut at = at.to_array();
                    at[k] += h;
                    shape.point_at(&Theta::still(), hit.prim, SurfaceCoordinates(at.into()))
                };
                let (above, below) = (point(STEP), point(-STEP));
                let slope = |x: f64, y: f64| (x - y) / (2.0 * STEP);
                let du = slope(above.uv.x, below.uv.x);
                let dv = slope(above.uv.y, below.uv.y);
                let all = bends(&above).into_iter().zip(bends(&below));
                for ((x, y), [x_u, x_v]) in all.zip(partials_of(&found)) {
                    let expected = (x - y) * (0.5 / STEP);
                    let off = (x_u * du + x_v * dv - expected).length();
                    let scale = 1.0 + (x_u * du).length() + (x_v * dv).length();
                    assert!(off < 1e-6 * scale, "{name}: off by {off:e} of {scale}");
                }
            }
        }
        assert!(tested > 80, "{name}: {tested}");
    }
}

/// Also over scalars with tangents: those of the partial derivatives are second derivatives.
#[test]
fn partials_carry_tangents() {
    type D = Dual<f64, 2>;
    let shape: AnyShape = bent_mesh().into();
    let at = [0.3, 0.2];
    let found = |at: [f64; 2]| {
        let at = SurfaceCoordinates(Vec2::from(at));
        shape.partials::<f64>(&Theta::still(), 0, at).unwrap()
    };
    let moving = SurfaceCoordinates(Vec2::new(D::var(at[0], 0), D::var(at[1], 1)));
    let dual = shape.partials::<D>(&Theta::still(), 0, moving).unwrap();
    for k in 0..2 {
        let step = |h: f64| {
            let mut x = at;
            x[k] += h;
            found(x)
        };
        let expected = (step(1e-5).dn_du - step(-1e-5).dn_du) * (0.5 / 1e-5);
        let off = (dual.dn_du.map(|x| x.eps[k]) - expected).length();
        assert!(off < 1e-6, "{off:e}");
    }
}

/// Where a coordinate is none, partial derivatives are limits: finite, and zero along it.
#[test]
fn partials_at_poles_are_finite() {
    fn finite<P: Float>() {
        let ball: AnyShape = Sphere::new([0.1, 0.2, 0.3], 2.0, false).unwrap().into();
        let disk: AnyShape = Disk::new(&affine(), false).unwrap().into();
        let zero = Vec2::new(P::zero(), P::zero());
        let south = Vec2::new(P::one(), P::one());
        for (shape, at) in [(&ball, zero), (&ball, south), (&disk, zero)] {
            let at = SurfaceCoordinates(at);
            let found = shape.partials::<P>(&Theta::still(), 0, at).unwrap();
            assert!(found.is_finite(), "{found:?}");
            let along = if matches!(shape, AnyShape::Disk(_)) {
                found.dp_dv
            } else {
                found.dp_du
            };
            assert!(along.length() < P::of(1e-5), "{found:?}");
            let across = if matches!(shape, AnyShape::Disk(_)) {
                found.dp_du
            } else {
                found.dp_dv
            };
            assert!(across.length() > P::of(0.3), "{found:?}");
        }
    }
    finite::<f32>();
    finite::<f64>();
}

/// Degenerate triangles, and texture coordinates that are none, have no partial derivatives; everything else is finite.
#[test]
fn degenerate_triangles_have_no_partials() {
    let mut data = bent_mesh().data().clone();
    data.triangles.push([0, 1, 1]);
    data.triangles.push([2, 2, 2]);
    data.uvs[3] = data.uvs[2];
    let mesh = Mesh::new(data, false).unwrap();
    let at = SurfaceCoordinates(Vec2::new(0.3f32, 0.3));
    let found = |prim| mesh.partials::<f32>(&Theta::still(), prim, at);
    assert!(found(0).is_some_and(|p| p.is_finite()));
    for prim in 1..4 {
        assert!(found(prim).is_none(), "{prim}");
        let si = mesh.point_at::<f32>(&Theta::still(), prim, at);
        assert!(si.p.is_finite() && si.uv.x.is_finite() && si.uv.y.is_finite());
        let back = mesh.coordinates(prim, &si).0;
        assert!(back.x.is_finite() && back.y.is_finite());
    }
}

/// A random map of slopes that are not small.
fn normal_texels(width: usize, height: usize) -> Vec<f32> {
    let texel = |i| {
        let mut s = Independent::new(14, 0, i as u64);
        let [x, y] = s.next_2d::<f32>();
        [0.3 + 0.4 * x, 0.3 + 0.4 * y, 0.9]
    };
    (0..width * height).flat_map(texel).collect()
}

/// The normal of a normal map, by itself and in other materials, on every shape: how it changes over the surface, against
/// central differences as above.
#[test]
fn partials_of_mapped_normals_are_those_of_differences() {
    use render::bsdf::{Blend, Conductor, Interpolation, Mask, NormalMap, TwoSided};
    use render::camera::{Camera, FovAxis};
    use render::{Film, Settings};
    use std::sync::Arc;

    const STEP: f64 = 1e-5;
    for (name, shape) in all_shapes() {
        for (interpolation, composite) in [
            (Interpolation::Normals, 0),
            (Interpolation::Slopes, 1),
            (Interpolation::Slopes, 2),
            (Interpolation::Normals, 3),
            (Interpolation::Slopes, 4),
        ] {
            let mut build = Builder::new();
            let mut map = |name: &str, size: [u32; 2]| {
                let texels = normal_texels(size[0] as usize, size[1] as usize);
                build.texels(name, size, &texels, (-1.0, 2.0)).unwrap()
            };
            let (first, second) = (map("first", [5, 4]), map("second", [3, 6]));
            let tint = build.rgb("tint", [0.9; 3], (0.0, 1.0)).unwrap();
            let half = build.scalar("half", 0.5, (0.0, 1.0)).unwrap();
            let mirror: Arc<_> = Arc::new(
                Conductor {
                    index: None,
                    specular_reflectance: tint,
                }
                .into(),
            );
            let mapped = |map: &render::texture::RgbTexture,
                          nested: &Arc<render::bsdf::Material>| {
                let map = NormalMap::new(map.clone(), interpolation, nested.clone()).unwrap();
                Arc::new(render::bsdf::Material::from(map))
            };
            let one = mapped(&first, &mirror);
            let other = mapped(&second, &mirror);
            // What is nested how, and the part that is looked at.
            let (material, route, behind) = match composite {
                0 => (one, 0, false),
                1 => (mapped(&second, &one), 0, false),
                2 => (
                    Arc::new(TwoSided::new([one, other]).unwrap().into()),
                    0,
                    true,
                ),
                3 => (
                    Arc::new(Blend::new(half, [one, other]).unwrap().into()),
                    1,
                    false,
                ),
                _ => (Arc::new(Mask::new(half, one).unwrap().into()), 1, false),
            };
            let material = build.add_shared_material(material);
            build.add_shape("it", shape.clone(), material);
            let view = Transform::look_at([0.0, 0.0, 9.0], [0.0; 3], [0.0, 1.0, 0.0]).unwrap();
            let camera = Camera::new(view, 40.0, FovAxis::Smaller, [8, 8]).unwrap();
            let scene = build
                .build(camera, Film::new(8, 8), Settings::default())
                .unwrap();
            let values: Vec<f64> = scene
                .params()
                .values()
                .iter()
                .map(|&x| f64::from(x))
                .collect();
            let theta = Theta::<f64>::constant(&values);
            let mut tested = 0;
            for ray in rays(400, 15) {
                let Some(hit) = scene.intersect(&ray) else {
                    continue;
                };
                let prim = hit.prim;
                let SurfaceCoordinates(at) = scene.coordinates(prim, &hit.si);
                let side = if behind { -1.0 } else { 1.0 };
                let look = |at: Vec2<f64>| {
                    let at = SurfaceCoordinates(at);
                    let si = scene.point_at(&theta, prim, at);
                    let wo = si.frame.n * side;
                    let (frame, partials) = scene.mapped_partials(&theta, prim, at, wo, route)?;
                    Some((si, frame, partials))
                };
                let (si, frame, partials) = look(at).expect("texture coordinates");
                let fold = [at.x, at.y, 1.0 - at.x.abs() - at.y.abs()];
                let round = name.ends_with("sphere");
                // Neither where coordinates jump nor where the interpolation of texels bends.
                let bend = |x: f64, n: [f64; 2]| {
                    n.iter()
                        .any(|n| ((x * n - 0.5) - (x * n - 0.5).round()).abs() < 1e-3)
                };
                let edge = |x: f64| x.min(1.0 - x) < 0.06;
                if (round && fold.iter().any(|x| x.abs() < 1e-3))
                    || edge(si.uv.x)
                    || edge(si.uv.y)
                    || bend(si.uv.x, [5.0, 3.0])
                    || bend(si.uv.y, [4.0, 6.0])
                {
                    continue;
                }
                tested += 1;
                assert!((frame.n.length() - 1.0).abs() < 1e-6, "{name}");
                assert!(frame.n.dot(si.frame.n) > 0.0, "{name}");
                assert!((frame.n - si.frame.n).length() > 1e-3, "{name}: not mapped");
                for k in 0..2 {
                    let point = |h: f64| {
                        let mut at = at.to_array();
                        at[k] += h;
                        look(at.into()).unwrap()
                    };
                    let (above, below) = (point(STEP), point(-STEP));
                    let du = (above.0.uv.x - below.0.uv.x) * (0.5 / STEP);
                    let dv = (above.0.uv.y - below.0.uv.y) * (0.5 / STEP);
                    for (x, y, x_u, x_v) in [
                        (above.1.n, below.1.n, partials.dn_du, partials.dn_dv),
                        (above.1.s, below.1.s, partials.ds_du, partials.ds_dv),
                        (above.0.p, below.0.p, partials.dp_du, partials.dp_dv),
                    ] {
                        let off = (x_u * du + x_v * dv - (x - y) * (0.5 / STEP)).length();
                        let scale = 1.0 + (x_u * du).length() + (x_v * dv).length();
                        assert!(
                            off < 1e-6 * scale,
                            "{name}, {composite}: off by {off:e} of {scale}"
                        );
                    }
                }
            }
            assert!(tested > 15, "{name}, {composite}: {tested}");
        }
    }
}

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

fn interact(shape: &AnyShape, o: [f64; 3], d: [f64; 3]) -> SurfaceInteraction<f64> {
    let ray = Ray::new(vec3(o), vec3(d).normalize());
    Tracer::new(shape).first(&ray).expect("a hit")
}

fn assert_near(a: Vec3<f64>, b: [f64; 3]) {
    assert!((a - vec3(b)).length() < 1e-5, "{a:?} instead of {b:?}");
}

/// Surface coordinates of Mitsuba 3.9.
#[test]
fn surface_coordinates_are_those_of_mitsuba() {
    let sphere: AnyShape = Sphere::new([0.0; 3], 2.0, false).unwrap().into();
    let si = interact(&sphere, [3.0, 3.0, 0.0], [-1.0, -1.0, 0.0]);
    assert!((si.uv.x - 0.125).abs() < 1e-6 && (si.uv.y - 0.5).abs() < 1e-6);
    let si = interact(&sphere, [0.0, -5.0, 0.0], [0.0, 1.0, 0.0]);
    assert!((si.uv.x - 0.75).abs() < 1e-6);
    assert_near(si.frame.s, [1.0, 0.0, 0.0]);
    let si = interact(&sphere, [0.0, 0.0, 5.0], [0.0, 0.0, -1.0]);
    assert!(si.uv.y.abs() < 1e-6);

    let disk: AnyShape = Disk::new(&Transform::scale([2.0; 3]), false)
        .unwrap()
        .into();
    let si = interact(&disk, [0.0, 1.0, 1.0], [0.0, 0.0, -1.0]);
    assert!((si.uv.x - 0.5).abs() < 1e-6 && (si.uv.y - 0.25).abs() < 1e-6);
    assert_near(si.frame.s, [0.0, 1.0, 0.0]);
    assert_near(si.n_geo, [0.0, 0.0, 1.0]);

    let tube: AnyShape = Cylinder::new([0.0; 3], [0.0, 0.0, 4.0], 1.0, false)
        .unwrap()
        .into();
    let si = interact(&tube, [0.0, 3.0, 1.0], [0.0, -1.0, 0.0]);
    assert!((si.uv.x - 0.25).abs() < 1e-6 && (si.uv.y - 0.25).abs() < 1e-6);
    assert_near(si.n_geo, [0.0, 1.0, 0.0]);
    assert_near(si.frame.s, [-1.0, 0.0, 0.0]);

    let cube: AnyShape = Cube::new(&Transform::IDENTITY, false).unwrap().into();
    // Face by face: a point off the centre, its normal, its surface coordinates.
    let faces = [
        ([0.5, -1.0, 0.2], [0.0, -1.0, 0.0], [0.6, 0.75]),
        ([0.5, 1.0, 0.2], [0.0, 1.0, 0.0], [0.25, 0.4]),
        ([1.0, 0.5, 0.2], [1.0, 0.0, 0.0], [0.75, 0.4]),
        ([0.5, 0.2, 1.0], [0.0, 0.0, 1.0], [0.6, 0.75]),
        ([-1.0, 0.5, 0.2], [-1.0, 0.0, 0.0], [0.75, 0.6]),
        ([0.5, 0.2, -1.0], [0.0, 0.0, -1.0], [0.4, 0.75]),
    ];
    for (p, n, uv) in faces {
        let si = interact(&cube, [0, 1, 2].map(|i| p[i] + n[i]), n.map(|x| -x));
        assert_near(si.p, p);
        assert_near(si.n_geo, n);
        assert!(
            (si.uv.x - uv[0]).abs() < 1e-6 && (si.uv.y - uv[1]).abs() < 1e-6,
            "{p:?} {:?}",
            si.uv
        );
    }
    // Mirrored cubes keep their outside.
    let mirrored: AnyShape = Cube::new(&Transform::scale([1.0, -1.0, 1.0]), false)
        .unwrap()
        .into();
    assert_near(
        interact(&mirrored, [0.1, 5.0, 0.2], [0.0, -1.0, 0.0]).n_geo,
        [0.0, 1.0, 0.0],
    );
    let flipped: AnyShape = Cube::new(&Transform::IDENTITY, true).unwrap().into();
    assert_near(
        interact(&flipped, [0.1, 5.0, 0.2], [0.0, -1.0, 0.0]).n_geo,
        [0.0, -1.0, 0.0],
    );
}

#[test]
fn areas_are_exact() {
    let area = |s: AnyShape| s.area();
    let scale = Transform::scale([1.0, 2.0, 3.0]);
    assert!((area(Cube::new(&scale, false).unwrap().into()) - 88.0).abs() < 1e-9);
    assert!((area(Disk::new(&scale, false).unwrap().into()) - 2.0 * PI).abs() < 1e-6);
    assert!((area(Sphere::new([1.0; 3], 2.0, false).unwrap().into()) - 16.0 * PI).abs() < 1e-9);
    let tube = Cylinder::transformed(
        [0.0; 3],
        [0.0, 0.0, 1.0],
        1.0,
        &Transform::scale([10.0, 10.0, 4.0]),
        false,
    );
    assert!((area(tube.unwrap().into()) - 80.0 * PI).abs() < 1e-4);
}

// ---- Scene files --------------------------------------------------------------------------------

fn from_xml(text: &str) -> Result<AnyShape, SceneError> {
    let text = format!("<scene version=\"3.0.0\">\n{text}\n</scene>");
    let document = Document::from_str(&text, Path::new("."), &[]).unwrap();
    let node = document.root().children_with_tag("shape")[0];
    AnyShape::from_node(node, Builder::new().registry())
}

#[test]
fn descriptions_of_bad_shapes_name_their_line() {
    let scale = |x: f64, y: f64, z: f64| {
        format!("<transform name=\"to_world\"><scale x=\"{x}\" y=\"{y}\" z=\"{z}\"/></transform>")
    };
    let cases = [
        ("sphere", scale(1.0, 1.0, 2.0), "to_world"),
        (
            "sphere",
            "<float name=\"radius\" value=\"-1\"/>".into(),
            "radius",
        ),
        ("sphere", scale(1e-30, 1e-30, 1e-30), "to_world"),
        ("disk", scale(1e-30, 1e-30, 1e-30), "to_world"),
        ("disk", scale(1.0, 1e-20, 1e5), "to_world"),
        ("cube", scale(1e-40, 1e-40, 1e-40), "to_world"),
        ("cylinder", scale(1.0, 2.0, 1.0), "to_world"),
        (
            "cylinder",
            "<float name=\"radius\" value=\"0\"/>".into(),
            "radius",
        ),
        (
            "cylinder",
            "<point name=\"p1\" value=\"0 0 0\"/>".into(),
            "p1",
        ),
        ("obj", String::new(), "filename"),
        (
            "obj",
            "<string name=\"filename\" value=\"nowhere.obj\"/>".into(),
            "nowhere.obj",
        ),
        ("teapot", String::new(), "known"),
    ];
    for (plugin, content, mention) in cases {
        let text = format!("<shape type=\"{plugin}\">\n{content}</shape>");
        let message = match from_xml(&text) {
            Ok(_) => panic!("{text} was accepted"),
            Err(e) => e.to_string(),
        };
        let place = message.contains("<text>:2") || message.contains("<text>:3");
        assert!(place && message.contains(mention), "{text}: {message}");
    }
    let good = "<shape type=\"sphere\"><point name=\"center\" value=\"1 2 3\"/><float name=\"radius\" value=\"2\"/>
        <transform name=\"to_world\"><scale value=\"2\"/><translate x=\"1\"/></transform></shape>";
    let AnyShape::Sphere(s) = from_xml(good).unwrap() else {
        panic!("not a sphere")
    };
    assert_eq!((s.center(), s.radius()), ([3.0, 4.0, 6.0], 4.0));
}

// ---- Meshes -------------------------------------------------------------------------------------

fn obj(text: &str) -> Result<Mesh, SceneError> {
    obj_with(text, &ObjOptions::default())
}

fn obj_with(text: &str, options: &ObjOptions) -> Result<Mesh, SceneError> {
    Mesh::from_obj_text(text.as_bytes(), Path::new("m.obj"), options).map(|(mesh, _)| mesh)
}

const QUAD: &str = "# a square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

/// What is no face is said, once for each kind, with its first line; what only groups faces is not.
#[test]
fn what_an_obj_file_has_besides_faces_is_said() {
    let text = format!(
        "mtllib a.mtl\no square\n{QUAD}s 1\ng all\nusemtl white\nl 1 2\nf 1 2 3 4\nl 3 4\np 1\ncurv 0 1 1 2\nweather fine\n"
    );
    let read = |text: &[u8]| Mesh::from_obj_text(text, Path::new("m.obj"), &ObjOptions::default());
    let (mesh, skipped) = read(text.as_bytes()).unwrap();
    assert_eq!(mesh.data().triangles.len(), 2);
    let expected = ["11: `l`", "14: `p`", "15: `curv`", "16: `weather`"];
    let expected = expected.map(|what| format!("m.obj:{what} has no effect"));
    assert_eq!(skipped, expected);
    assert!(
        read(format!("{QUAD}f 1 2 3 4\n").as_bytes())
            .unwrap()
            .1
            .is_empty()
    );
    // Nothing but such.
    let error = read(format!("{QUAD}l 1 2\n").as_bytes())
        .unwrap_err()
        .to_string();
    assert!(
        error.ends_with("expected at least one face, found none, but `l` in line 6"),
        "{error}"
    );
    let wide: Vec<u8> = [0xfeff]
        .into_iter()
        .chain(QUAD.encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    let error = read(&wide).unwrap_err().to_string();
    assert!(
        error.ends_with("m.obj:1: expected text in UTF-8, found UTF-16"),
        "{error}"
    );
    // However many kinds there are.
    let many: String = (0..1000).map(|i| format!("word{i}\n")).collect();
    assert!(
        read(format!("{QUAD}f 1 2 3\n{many}").as_bytes())
            .unwrap()
            .1
            .len()
            < 100
    );
}

#[test]
fn obj_polygons_become_fans() {
    let mesh = obj(&format!("{QUAD}f 1 2 3 4\n")).unwrap();
    assert_eq!(mesh.data().triangles, [[0, 1, 2], [0, 2, 3]]);
    assert!((mesh.area() - 1.0).abs() < 1e-12);
    // Relative indices, line ends, groups and materials.
    let text = format!(
        "{QUAD}mtllib a.mtl\r\ng one\r\nusemtl red\r\nf -4 -3 -2\r\no two\ns 1\nf -4 -2 -1"
    );
    let mesh = obj(&text).unwrap();
    assert_eq!(mesh.data().triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(mesh.data().positions.len(), 4, "groups share vertices");
}

/// What other programs write: marks, comments, colours, continued lines, line ends of any kind.
#[test]
fn obj_lines_are_read_as_they_are_written() {
    let plain = obj("v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n").unwrap();
    for text in [
        "\u{feff}v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4",
        "v -1 -1 0\nv 1 -1 0#\nv 1 1 0 # corner 3 \\\nv -1 1 0\nf 1 2 3 4# nan\n",
        "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 \\\n3 4\n",
        "v -1 -1 0\r\nv 1 \\ \r\n-1 \\\r\n0\r\nv 1 1 0\r\nv -1 1 0\r\nf 1 2 3 4\\",
        "v -1 -1 0\rv 1 -1 0\rv 1 1 0\rv -1 1 0\rf 1 2 3 4",
        "v -1 -1 0\nv 1 -1 0\nv 1 1 0 1 0 0\nv -1 1 0\nf 1 2 3 4\n",
        "v -1 -1 0\nv 2 -2 0 2\nv 1 1 0\nv -1 1 0 1 0 0.5\nf 1 2 3 4\n",
    ] {
        let mesh = obj(text).unwrap_or_else(|e| panic!("{text}: {e}"));
        assert_eq!(mesh.data().positions, plain.data().positions, "{text}");
        assert_eq!(mesh.data().triangles, plain.data().triangles, "{text}");
    }
    for (line, message) in [
        (
            "v 0 0 0 1 1",
            "m.obj:7: expected `v` with three numbers, alone or with a weight",
        ),
        (
            "v 0 0 0 0",
            "m.obj:7: expected a weight other than zero, found `0`",
        ),
        (
            "v 0 0 1e39",
            "m.obj:7: expected a finite number, found `1e39`",
        ),
        (
            "vn nan 0 1",
            "m.obj:7: expected a finite number, found `nan`",
        ),
        ("vt 0.5", "m.obj:7: expected `vt` with two or three numbers"),
        (
            "f 1 \\\n2 \\\n9",
            "m.obj:7: expected the index of an earlier line, found `9`",
        ),
    ] {
        let found = obj(&format!("{QUAD}# comment \\\n{line}\nf 1 2 3")).unwrap_err();
        assert!(found.to_string().starts_with(message), "{found}");
    }
    let long = obj(&format!("{QUAD}f 1 2 {}", "x".repeat(1 << 20))).unwrap_err();
    assert!(long.to_string().len() < 300, "{long}");
}

#[test]
fn devices_are_no_obj_files() {
    if cfg!(unix) {
        let found = Mesh::from_obj(Path::new("/dev/zero"), &ObjOptions::default()).unwrap_err();
        let found = found.to_string();
        assert_eq!(found, "/dev/zero: expected a regular file, found a device");
    }
}

/// What is written is read as the same mesh, to the last bit: with and without normals and texture coordinates, where some
/// faces are flat, turned around or not.
#[test]
fn obj_files_are_written_as_they_are_read() {
    let corners = "v 1e-30 -1 0.1\nv 1 0.33333334 16777216\nv 0.7 1 -0\nv -1 1 3e9\n";
    let more = "vt 0.25 0.1\nvt 1.7 -0.3\nvn 0 0.6 0.8\nvn 0 0 2\n";
    for faces in [
        "f 1 2 3 4\n",
        "f 4/1 2/2 3/1\n",
        "f 1//1 2//2 3//1\n",
        "f 1/1/1 2/2/2 3/1/2\nf 1/2/2 3/2/2 4/1/2\nf 2/1 1/1 4/2\n",
    ] {
        for flip_v in [true, false] {
            let options = ObjOptions {
                flip_v,
                ..Default::default()
            };
            let mesh = obj_with(&format!("{corners}{more}{faces}"), &options).unwrap();
            let text = mesh.to_obj(flip_v);
            let options = ObjOptions {
                face_normals: mesh.data().normals.is_empty(),
                ..options
            };
            let again = obj_with(&text, &options).unwrap_or_else(|e| panic!("{text}: {e}"));
            let (a, b) = (mesh.data(), again.data());
            assert_eq!((&a.positions, &a.uvs), (&b.positions, &b.uvs), "{text}");
            assert_eq!((&a.normals, &a.triangles), (&b.normals, &b.triangles));
            assert_eq!(again.to_obj(flip_v), text);
        }
    }
    // Normals that nobody has given are those that whoever reads the file makes.
    let smooth = obj(&format!("{corners}f 1 2 3\n")).unwrap();
    assert!(!smooth.data().normals.is_empty() && !smooth.to_obj(true).contains("vn"));
}

#[test]
fn obj_normals_and_coordinates_are_those_of_mitsuba() {
    let text = format!(
        "{QUAD}vt 0.25 0.1\nvt 1 0\nvn 0 0.6 0.8\nvn 0 0 2\nf 1/1/1 2/2/2 3/2/2\nf 1/2/2 3/2/2 4/1/2\n"
    );
    let mesh = obj(&text).unwrap();
    // Vertex 1 occurs with two normals.
    assert_eq!(mesh.data().positions.len(), 5);
    assert_eq!(mesh.data().uvs[0], [0.25, 0.9]);
    assert_eq!(mesh.data().normals[0], [0.0, 0.6, 0.8]);
    let unflipped = obj_with(
        &text,
        &ObjOptions {
            flip_v: false,
            ..Default::default()
        },
    )
    .unwrap();
    assert_eq!(unflipped.data().uvs[0], [0.25, 0.1]);
    let flat = obj_with(
        &text,
        &ObjOptions {
            face_normals: true,
            ..Default::default()
        },
    )
    .unwrap();
    assert!(flat.data().normals.is_empty());
    let si = interact(&flat.into(), [0.7, 0.2, 1.0], [0.0, 0.0, -1.0]);
    assert_near(si.frame.n, [0.0, 0.0, 1.0]);
    // Half way between the normals of vertices 1 and 2.
    let si = interact(&mesh.into(), [0.5, 1e-4, 1.0], [0.0, 0.0, -1.0]);
    let middle = (vec3([0.0, 0.6, 0.8]) + vec3([0.0, 0.0, 1.0])).normalize();
    assert!((si.frame.n - middle).length() < 1e-3);
}

#[test]
fn obj_transforms_keep_normals_perpendicular() {
    let text = "v 0 0 0\nv 1 0 1\nv 0 1 0\nvn -1 0 1\nf 1//1 2//1 3//1\n";
    for scale in [[2.0, 1.0, 1.0], [-2.0, 1.0, 1.0]] {
        let to_world = Transform::scale(scale);
        let mesh = obj_with(
            text,
            &ObjOptions {
                to_world,
                ..Default::default()
            },
        )
        .unwrap();
        let n = vec3(mesh.data().normals[0].map(f64::from));
        assert!(n.dot(vec3(to_world.vector([1.0, 0.0, 1.0]))).abs() < 1e-6);
        assert!(n.z > 0.0);
    }
}

/// Without normals in the file, those of a tetrahedron's corners point away from its centre: all
/// angles are equal there.
#[test]
fn missing_normals_are_made() {
    let text = "v 1 1 1\nv 1 -1 -1\nv -1 1 -1\nv -1 -1 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n";
    let mesh = obj(text).unwrap();
    let m = mesh.data();
    for (p, n) in m.positions.iter().zip(&m.normals) {
        let (p, n) = (vec3(p.map(f64::from)).normalize(), vec3(n.map(f64::from)));
        assert!((p - n).length() < 1e-6 || (p + n).length() < 1e-6);
    }
    // Angles count, not areas or the number of triangles: a right angle split unevenly.
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0.1 0 1\nv 0 0 1\nf 1 2 3\nf 1 5 4\nf 1 4 2\n";
    let n = obj(text).unwrap().data().normals[0];
    assert_near(vec3(n.map(f64::from)), [0.0, 0.5f64.sqrt(), 0.5f64.sqrt()]);
}

#[test]
fn faces_with_and_without_coordinates_may_be_mixed() {
    let text =
        format!("{QUAD}vt 0 1\nvt 1 1\nvn 0 0 1\nf 1/1 2/2 3/2\nf 1//1 3//1 4//1\nf 1/1 2/2 3/1\n");
    let mesh = obj(&text).unwrap();
    let m = mesh.data();
    assert_eq!(m.triangles.len(), 3);
    assert_eq!(
        (m.uvs.len(), m.normals.len()),
        (m.positions.len(), m.positions.len())
    );
    // Where normals are missing, the triangle's own counts.
    let si = interact(&mesh.into(), [0.6, 0.2, 1.0], [0.0, 0.0, -1.0]);
    assert_near(si.frame.n, [0.0, 0.0, 1.0]);
}

#[test]
fn broken_meshes_name_the_line() {
    let quad = |rest: &str| format!("{QUAD}{rest}");
    let cases = [
        (String::new(), "face"),
        (QUAD.to_owned(), "face"),
        ("v 0 0 x\nf 1 1 1".to_owned(), "m.obj:1"),
        ("v 0 0\nf 1 1 1".to_owned(), "m.obj:1"),
        ("v 0 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3".to_owned(), "m.obj:1"),
        (
            "v 0 1e39 0\nv 1 0 0\nv 0 1 0\nf 1 2 3".to_owned(),
            "m.obj:1",
        ),
        (quad("f 1 2 5"), "m.obj:6"),
        (quad("f 1 2 0"), "m.obj:6"),
        (quad("f 1 2 -5"), "m.obj:6"),
        (quad("f 1 2"), "m.obj:6"),
        (quad("f 1 2 3/1"), "m.obj:6"),
        (quad("vt 0 0\nf 1/1 2 3/1"), "m.obj:7"),
        (quad("f 1 2 99999999999999999999"), "m.obj:6"),
        (quad("f 1 2 9223372036854775807"), "m.obj:6"),
        (quad("f 1//1 2//1 3//1"), "m.obj:6"),
        (quad("vn 0 0\nf 1//1 2//1 3//1"), "m.obj:6"),
        (quad("f 1 1 2\nf 2 2 3"), "degenerate"),
        (quad("f 1/ 2/ 3/ x"), "m.obj:6"),
    ];
    for (text, mention) in cases {
        let message = match obj(&text) {
            Ok(_) => panic!("{text:?} was accepted"),
            Err(e) => e.to_string(),
        };
        assert!(
            message.contains("m.obj") && message.contains(mention),
            "{text:?}: {message}"
        );
    }
    let missing = Mesh::from_obj(Path::new("/nowhere/m.obj"), &ObjOptions::default()).unwrap_err();
    assert!(matches!(missing, SceneError::Io { .. }));
    // A degenerate triangle among others is kept, and never chosen.
    let mesh = obj(&quad("f 1 1 2\nf 1 2 3\nf 2 2 3")).unwrap();
    assert_eq!(mesh.data().triangles.len(), 3);
    for i in 0..1000 {
        let s = mesh.sample_area::<f64>(&Theta::still(), Independent::new(8, 0, i).next_2d());
        assert!(s.p.x >= s.p.y && s.p.z == 0.0);
    }
}

#[test]
fn arrays_are_checked() {
    let good = bent_mesh().data().clone();
    let refused = |change: &dyn Fn(&mut MeshData)| {
        let mut data = good.clone();
        change(&mut data);
        Mesh::new(data, false).unwrap_err().to_string()
    };
    assert!(refused(&|d| d.triangles.clear()).contains("triangle"));
    assert!(refused(&|d| d.triangles[1][2] = 4).contains("below 4"));
    assert!(refused(&|d| d.normals.truncate(3)).contains("normals"));
    assert!(refused(&|d| d.uvs.truncate(3)).contains("uvs"));
    assert!(refused(&|d| d.positions[2][1] = f32::NAN).contains("vertex 2"));
    assert!(refused(&|d| d.positions[2][1] = f32::INFINITY).contains("vertex 2"));
    assert!(refused(&|d| d.normals[2][1] = f32::NAN).contains("normals"));
    assert!(refused(&|d| d.uvs[2][1] = f32::NAN).contains("uvs"));
    assert!(refused(&|d| d.positions.fill([1.0; 3])).contains("degenerate"));
}

/// Smooth normals against the winding turn the geometric normal, which emission does not go by.
#[test]
fn the_shading_normal_decides_the_side() {
    let text = format!("{QUAD}vn 0 0 -1\nf 1//1 2//1 3//1\n");
    let si = interact(
        &obj(&text).unwrap().into(),
        [0.7, 0.2, 1.0],
        [0.0, 0.0, -1.0],
    );
    assert_near(si.frame.n, [0.0, 0.0, -1.0]);
    assert_near(si.n_geo, [0.0, 0.0, -1.0]);
}

#[test]
fn shared_meshes_load() {
    let Some(shared) = common::shared_dir() else {
        return;
    };
    for path in common::files_below(&shared, "obj") {
        let (mesh, _) = Mesh::from_obj(&path, &ObjOptions::default()).unwrap();
        assert!(
            mesh.area() > 0.0 && mesh.memory_bytes() > 0,
            "{}",
            path.display()
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(9), cases: 2000, ..ProptestConfig::default() })]

    /// Whatever happens to the bytes of a file: a mesh or an error, and no mesh with numbers that are
    /// not.
    #[test]
    fn damaged_files_never_panic(edits in prop::collection::vec((0usize..200, any::<u8>(), 0u8..4), 1..12)) {
        let mut bytes = format!("{QUAD}vt 0 1\nvt 1 1\nvn 0 0 1\ng a\nf 1/1/1 2/2/1 3/2/1\nf -4//1 -2//1 -1//1\nf 1 2 3 4\n").into_bytes();
        for (at, byte, kind) in edits {
            if bytes.is_empty() {
                break;
            }
            let at = at % bytes.len();
            match kind {
                0 => bytes[at] = byte,
                1 => bytes.insert(at, b"0123456789-/.e\n "[usize::from(byte) % 16]),
                2 => drop(bytes.remove(at)),
                _ => bytes.truncate(at),
            }
        }
        if let Ok((mesh, _)) = Mesh::from_obj_text(&bytes, Path::new("m.obj"), &ObjOptions::default()) {
            let m = mesh.data();
            prop_assert!(mesh.area() > 0.0);
            prop_assert!(m.positions.as_flattened().iter().all(|x| x.is_finite()));
            prop_assert!(m.normals.as_flattened().iter().all(|x| x.is_finite()));
            prop_assert!(Accel::build(&mesh.primitives()).is_ok());
            prop_assert!(mesh.sample_area::<f32>(&Theta::still(), [0.3, 0.7]).p.is_finite());
        }
    }
}
