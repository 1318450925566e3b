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

/// Sine of the angle between triangles below which they are one surface.
const FLAT: f64 = 1e-5;

/// Triangles whose sides are below so many times the angle of a kernel are small.
const SMALL: f64 = 3.0;

/// What is beyond a side of a triangle: the vertex that is opposite to it there, if there is one triangle, and whether the
/// surface has another normal on that side.
#[derive(Clone, Copy)]
struct Beyond {
    vertex: Option<[f32; 3]>,
    creased: bool,
}

/// What meshes add to [`Scene::border`], which does not know which sides of a triangle are outlines: those beyond which
/// there is no neighbour, or one on the same side of the plane through the point of view.
pub(super) struct Outlines<'a> {
    scene: &'a Scene,
    /// Per shape, if it is a mesh, and what is beyond the sides of each triangle.
    meshes: Vec<Option<(Mesh, Vec<[Beyond; 3]>)>>,
}

/// Neighbours share two welded points. A side with more than two triangles counts as one without a neighbour.
fn beyond(mesh: &Mesh) -> Vec<[Beyond; 3]> {
    let data = mesh.data();
    let welding = mesh.welding();
    let point = |v: u32| welding.points[v as usize];
    let end_points = |t: &[u32; 3], k: usize| [t[k], t[(k + 1) % 3]];
    let side = |t: &[u32; 3], k: usize| {
        let [a, b] = end_points(t, k).map(point);
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
    let normal = |v: u32| data.normals[v as usize];
    let at = |v: u32| lift3::<f64>(data.positions[v as usize]);
    let creased = |t: &[u32; 3], k: usize, other: u32, opposite: u32| {
        if !data.normals.is_empty() {
            let other = data.triangles[other as usize];
            return !end_points(t, k).iter().all(|&v| {
                let same = other.iter().find(|&&w| point(w) == point(v));
                same.is_some_and(|&w| normal(w) == normal(v))
            });
        }
        let [a, b, c, d] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3], opposite].map(at);
        let plane = (b - a).cross(c - a);
        plane.dot(d - a).abs() > FLAT * plane.length() * (d - a).length()
    };
    let of = |(t, i): (&[u32; 3], u32)| {
        std::array::from_fn(|k| match sides[&side(t, k)].as_slice() {
            [one, two] if one.0 != two.0 => {
                let (other, opposite) = if one.0 == i { *two } else { *one };
                Beyond {
                    vertex: Some(data.positions[opposite as usize]),
                    creased: creased(t, k, other, opposite),
                }
            }
            _ => Beyond {
                vertex: None,
                creased: true,
            },
        })
    };
    data.triangles.iter().zip(0..).map(of).collect()
}

impl<'a> Outlines<'a> {
    pub fn of(scene: &'a Scene) -> Self {
        let with = |mesh: Mesh| Some((mesh.clone(), beyond(&mesh)));
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
    /// from most of them, the cosine to the normal is asked, too [Zeltner 2021, section 4.1.3]. `creases`: whether sides at which
    /// a surface has two normals are outlines, too.
    pub fn test<P: Float>(&self, kappa: f64, ray: &Ray<P>, hit: &Hit, creases: bool) -> f64 {
        let shape = self.scene.shape_of(hit.prim);
        let Some((mesh, triangles)) = &self.meshes[shape as usize] else {
            return boundary_test(kappa, self.scene.border(ray, hit).to_f64());
        };
        let local = (hit.prim - self.scene.primitive(shape, 0)) as usize;
        let data = mesh.data();
        let (o, d) = (ray.o.map(P::to_f64), ray.d.map(P::to_f64));
        let corners = data.triangles[local].map(|v| lift3::<f64>(data.positions[v as usize]) - o);
        let (mut least, mut crease) = (FAR, FAR);
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
            let angle = plane.dot(d).abs() / length;
            let Beyond { vertex, creased } = triangles[local][k];
            if vertex.is_none_or(|v| side(lift3::<f64>(v) - o) == side(c)) {
                least = least.min(angle);
            } else if creased && creases {
                crease = crease.min(angle);
            }
        }
        if size * kappa.sqrt() > SMALL * f64::from(hit.t) {
            return boundary_test(kappa, least.min(crease));
        }
        let test = boundary_test(kappa, least);
        let [a, b, c] = corners;
        let normal: Vec3<f64> = (b - a).cross(c - a);
        let cosine = normal.dot(d).abs() / normal.length();
        test.min(LARGEST * (cosine / FACING).powi(4))
    }
}
