//! How far a direction is from the outlines of what it meets.

use std::collections::HashMap;

use ad_core::{Float, Vec3};

use super::field::{LARGEST, boundary_test};
use crate::accel::Hit;
use crate::math::Ray;
use crate::scene::Scene;
use crate::shape::{AnyShape, FAR, Mesh, lift3};

/// Surfaces of small triangles that are seen at this cosine count as far from an outline.
const FACING: f64 = 0.5;

/// Triangles whose sides are below so many times the angle of a kernel are small.
const SMALL: f64 = 3.0;

/// The neighbours of a triangle: per side, the vertex of another one that is opposite to it.
type Opposite = [Option<[f32; 3]>; 3];

/// What meshes add to [`Scene::border`], which does not know which sides of a triangle are outlines: those beyond which
/// there is no neighbour, or one on the same side of the plane through the point of view.
pub(super) struct Outlines<'a> {
    scene: &'a Scene,
    /// Per shape, if it is a mesh, and what is opposite to the sides of each triangle.
    meshes: Vec<Option<(Mesh, Vec<Opposite>)>>,
}

/// Neighbours share two welded points. A side with more than two triangles counts as one without a neighbour.
fn opposite(mesh: &Mesh) -> Vec<Opposite> {
    let data = mesh.data();
    let welding = mesh.welding();
    let side = |t: &[u32; 3], k: usize| {
        let [a, b] = [t[k], t[(k + 1) % 3]].map(|v| welding.points[v as usize]);
        (a.min(b), a.max(b))
    };
    let mut sides: HashMap<(u32, u32), Vec<(u32, u32)>> = HashMap::new();
    for (t, i) in data.triangles.iter().zip(0u32..) {
        for k in 0..3 {
            sides
                .entry(side(t, k))
                .or_default()
                .push((i, t[(k + 2) % 3]));
        }
    }
    let of = |(t, i): (&[u32; 3], u32)| {
        std::array::from_fn(|k| match sides[&side(t, k)].as_slice() {
            [(a, va), (b, vb)] => {
                let other = if *a == i { *vb } else { *va };
                (a != b).then(|| data.positions[other as usize])
            }
            _ => None,
        })
    };
    data.triangles.iter().zip(0..).map(of).collect()
}

impl<'a> Outlines<'a> {
    pub fn of(scene: &'a Scene) -> Self {
        let with = |mesh: Mesh| Some((mesh.clone(), opposite(&mesh)));
        let each = |shape: &AnyShape| match shape {
            AnyShape::Mesh(mesh) => with(mesh.clone()),
            AnyShape::Instance(instance) => with(instance.copied()),
            _ => None,
        };
        Self {
            scene,
            meshes: scene.shapes().iter().map(each).collect(),
        }
    }

    /// The boundary test at what a ray hit: zero on its outline. Of triangles smaller than a kernel, whose outlines are far
    /// from most of them, the cosine to the normal is asked, too [Zeltner 2021, section 4.1.3].
    pub fn test<P: Float>(&self, kappa: f64, ray: &Ray<P>, hit: &Hit) -> f64 {
        let shape = self.scene.shape_of(hit.prim);
        let Some((mesh, triangles)) = &self.meshes[shape as usize] else {
            return boundary_test(kappa, self.scene.border(ray, hit).to_f64());
        };
        let local = (hit.prim - self.scene.primitive(shape, 0)) as usize;
        let data = mesh.data();
        let (o, d) = (ray.o.map(P::to_f64), ray.d.map(P::to_f64));
        let corners = data.triangles[local].map(|v| lift3::<f64>(data.positions[v as usize]) - o);
        let mut least = FAR;
        let mut size: f64 = 0.0;
        for k in 0..3 {
            let [a, b, c] = [0, 1, 2].map(|j| corners[(k + j) % 3]);
            size = size.max((b - a).length());
            let plane = a.cross(b);
            let length = plane.length();
            if length == 0.0 {
                continue;
            }
            let side = |p: Vec3<f64>| plane.dot(p) > 0.0;
            let beyond = triangles[local][k].map(|v| side(lift3::<f64>(v) - o));
            if beyond.is_none_or(|beyond| beyond == side(c)) {
                least = least.min(plane.dot(d).abs() / length);
            }
        }
        let test = boundary_test(kappa, least);
        if size * kappa.sqrt() > SMALL * f64::from(hit.t) {
            return test;
        }
        let [a, b, c] = corners;
        let normal: Vec3<f64> = (b - a).cross(c - a);
        let cosine = normal.dot(d).abs() / normal.length();
        test.min(LARGEST * (cosine / FACING).powi(4))
    }
}
