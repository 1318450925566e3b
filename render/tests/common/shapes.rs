//! Every shape, and rays that meet them.

use ad_core::{Float, Vec3};
use render::accel::{Accel, Hit, surfaces};
use render::math::{NOWHERE, Ray, Transform};
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::shape::{
    AnyShape, Cube, CurveKind, Curves, Cylinder, Disk, Mesh, MeshData, Patch, Rectangle, Shape,
    Sphere, SurfaceInteraction,
};

/// Similar to the identity, but nothing is aligned or of unit size.
pub fn similarity() -> Transform {
    Transform::sequence([
        Transform::scale([0.7; 3]),
        Transform::rotate([1.0, 2.0, -0.5], 70.0).unwrap(),
        Transform::translate([0.3, -0.2, 0.4]),
    ])
}

pub fn affine() -> Transform {
    Transform::scale([1.2, 0.6, 0.9]).then(&similarity())
}

/// Two triangles with smooth normals and surface coordinates.
pub fn bent_mesh() -> Mesh {
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
pub fn shapes() -> Vec<(&'static str, AnyShape)> {
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
pub fn curves() -> Vec<(&'static str, AnyShape)> {
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

pub fn vec3(v: [f64; 3]) -> Vec3<f64> {
    v.into()
}

pub fn random_direction(u: [f64; 2]) -> Vec3<f64> {
    render::math::warp::square_to_sphere(u)
}

/// Finds hits, and makes interactions from them.
pub struct Tracer<'a> {
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
    pub fn all(&self, mut ray: Ray<f64>) -> Vec<SurfaceInteraction<f64>> {
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
pub fn rays(n: u64, seed: u64) -> impl Iterator<Item = Ray<f64>> {
    (0..n).map(move |i| {
        let mut s = Independent::new(seed, 0, i);
        let target = random_direction(s.next_2d()) * 0.9 * s.next_1d::<f64>();
        let o = random_direction(s.next_2d()) * (0.2 + 3.0 * s.next_1d::<f64>());
        Ray::new(o, (target - o).normalize())
    })
}

/// Every shape, and a rectangle, and meshes without texture coordinates or normals.
pub fn all_shapes() -> Vec<(&'static str, AnyShape)> {
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

pub fn interact(shape: &AnyShape, o: [f64; 3], d: [f64; 3]) -> SurfaceInteraction<f64> {
    let ray = Ray::new(vec3(o), vec3(d).normalize());
    Tracer::new(shape).first(&ray).expect("a hit")
}

pub fn assert_near(a: Vec3<f64>, b: [f64; 3]) {
    assert!((a - vec3(b)).length() < 1e-5, "{a:?} instead of {b:?}");
}
