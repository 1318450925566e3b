//! Meshes that are placed somewhere, and share their arrays with others.

use std::sync::{Arc, OnceLock};

use ad_core::{Float, Real, Vec3};

use super::mesh::{Triangle, choose, corners, running_areas};
use super::{
    DirectionSample, Mesh, MeshData, Partials, Shape, ShapeSample, SurfaceCoordinates,
    SurfaceInteraction, lift3, misplaced,
};
use crate::accel::{Hit, MAX_COORDINATE, Primitive};
use crate::error::SceneError;
use crate::math::{Ray, Transform, each};
use crate::params::Theta;
use crate::plugin::{FromNode, Node, Registry};

/// Transforms that lengthen or shorten more are refused.
const LARGEST_SCALE: f64 = 1e12;

/// Part of a length by which a transform that keeps angles may miss others.
const CONFORMAL: f64 = 1e-6;

/// A mesh of another space, carried into the world by an affine map. Cheap to clone: whatever the number of instances,
/// the arrays of the mesh are there once.
///
/// It is what a mesh with the carried arrays would be: corners are rounded to single precision in the world, normals are
/// carried by the inverse transpose to their former lengths, and the outside stays outside under reflections.
#[derive(Clone, Debug)]
pub struct Instance(Arc<Placed>);

#[derive(Debug)]
struct Placed {
    mesh: Mesh,
    to_world: Transform,
    /// Whether the map reflects.
    mirrored: bool,
    /// Corners of a box around all corners, world space.
    bounds: [[f32; 3]; 2],
    /// Largest coordinate, here or, carried, before.
    extent: f32,
    /// Made by the first call that asks for it: a scene may have many instances.
    area: OnceLock<f64>,
    /// Running sums of the triangles' areas, made when the first of them is sampled.
    cdf: OnceLock<Vec<f64>>,
}

impl Instance {
    /// A mesh whose points stay, carried by a map.
    ///
    /// # Errors
    /// What was expected: an invertible map, coordinates in reach, something with an area, points that are no parameters.
    pub fn new(mesh: Mesh, to_world: Transform) -> Result<Self, String> {
        if mesh.has_moving_points() {
            return Err("expected a mesh whose points stay".into());
        }
        let size = |t: &Transform| {
            let numbers = t.linear.iter().flatten();
            numbers.fold(0.0, |m: f64, x| m.max(x.abs()))
        };
        let sane = |t: &Transform| t.is_finite() && size(t) <= LARGEST_SCALE;
        let inverse = to_world.inverse().filter(sane);
        if !sane(&to_world) || inverse.is_none() {
            return Err("expected an invertible transform".into());
        }
        let mut placed = Placed {
            mirrored: to_world.determinant() < 0.0,
            mesh,
            to_world,
            bounds: [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]],
            extent: 0.0,
            area: OnceLock::new(),
            cdf: OnceLock::new(),
        };
        let data = placed.mesh.data();
        let mut reach = [0.0f64; 3];
        for p in &data.positions {
            let at = placed.point(*p);
            let [low, high] = &mut placed.bounds;
            for k in 0..3 {
                low[k] = low[k].min(at[k]);
                high[k] = high[k].max(at[k]);
                reach[k] = reach[k].max(f64::from(p[k].abs()));
            }
        }
        let extent = (placed.bounds.as_flattened().iter()).fold(0.0, |m: f32, x| m.max(x.abs()));
        let carried = each(placed.to_world.linear, |row| {
            (0..3).map(|k| row[k].abs() * reach[k]).sum::<f64>() as f32
        });
        placed.extent = carried.into_iter().fold(extent, f32::max);
        if placed.extent.is_nan() || placed.extent > MAX_COORDINATE {
            return Err(misplaced());
        }
        // One with an area is enough, and most have one.
        let mut areas = (0..placed.mesh.data().triangles.len()).map(|i| placed.area_of(i));
        if !areas.any(|area| area > 0.0) {
            return Err(misplaced());
        }
        Ok(Self(Arc::new(placed)))
    }

    /// What is placed, in its own space.
    pub fn mesh(&self) -> &Mesh {
        &self.0.mesh
    }

    /// From there to the world.
    pub fn to_world(&self) -> &Transform {
        &self.0.to_world
    }

    /// The mesh with arrays of its own, in the world. Primitives and surface coordinates are the same.
    pub fn copied(&self) -> Mesh {
        let Placed {
            mesh,
            to_world,
            mirrored,
            ..
        } = &*self.0;
        let data = mesh.data();
        let copy = MeshData {
            positions: data.positions.iter().map(|p| self.0.point(*p)).collect(),
            normals: (data.normals.iter().map(|n| normal(to_world, *n))).collect(),
            uvs: data.uvs.clone(),
            triangles: data.triangles.clone(),
        };
        let flip = mesh.is_flipped() ^ mirrored;
        let copy = Mesh::with_normals(copy, flip, self.follows_points());
        // All that is checked there was here.
        copy.unwrap_or_else(|_| mesh.clone()).welded_like(mesh)
    }

    /// Whether normals are those that follow from the points in the world: made of them, and angles stay.
    fn follows_points(&self) -> bool {
        self.0.mesh.has_smooth_normals() && is_conformal(&self.0.to_world)
    }

    /// Whether normals follow from the points in another space only, where angles are others.
    pub(crate) fn has_foreign_normals(&self) -> bool {
        self.0.mesh.has_smooth_normals() && !self.follows_points()
    }

    /// How far numbers of half a rounding may move a point of it, relative to [`f32::EPSILON`].
    pub(crate) fn rounding(&self) -> f64 {
        1.5 * f64::from(f32::EPSILON) * f64::from(self.0.extent)
    }

    #[inline(always)]
    fn triangle(&self, prim: u32) -> Triangle {
        self.0.triangle(prim as usize)
    }
}

impl Placed {
    #[inline(always)]
    fn point(&self, p: [f32; 3]) -> [f32; 3] {
        each(self.to_world.point(each(p, f64::from)), |x| x as f32)
    }

    /// That of a triangle in the world.
    fn area_of(&self, i: usize) -> f64 {
        let data = self.mesh.data();
        let at = corners(&data.positions, data.triangles[i]).map(|p| self.point(p));
        0.5 * Triangle::new(at, false).double_area()
    }

    fn area(&self) -> f64 {
        *self.area.get_or_init(|| {
            let all = 0..self.mesh.data().triangles.len();
            all.map(|i| self.area_of(i)).sum()
        })
    }

    /// A triangle in the world. Reflections turn it around, and so it is turned around once more.
    #[inline]
    fn triangle(&self, i: usize) -> Triangle {
        let data = self.mesh.data();
        let t = data.triangles[i];
        let [a, b, c] = corners(&data.positions, t);
        let normals = || {
            let [a, b, c] = corners(&data.normals, t);
            let carried = |n| normal(&self.to_world, n);
            [carried(a), carried(b), carried(c)]
        };
        let at = [self.point(a), self.point(b), self.point(c)];
        Triangle {
            normals: (!data.normals.is_empty()).then(normals),
            uvs: (!data.uvs.is_empty()).then(|| corners(&data.uvs, t)),
            ..Triangle::new(at, self.mesh.is_flipped() ^ self.mirrored)
        }
    }
}

/// A normal on the side of the winding, which keeps its length: lengths weigh normals where they are interpolated.
#[inline]
fn normal(to_world: &Transform, n: [f32; 3]) -> [f32; 3] {
    let length = lift3::<f64>(n).length();
    let carried = Vec3::from(to_world.normal(each(n, f64::from))).normalize() * length;
    each(carried.to_array(), |x| x as f32)
}

/// Whether a map keeps angles.
fn is_conformal(map: &Transform) -> bool {
    let columns = [0, 1, 2].map(|k| Vec3::from(map.linear.map(|row| row[k])));
    let size = columns[0].length_squared();
    let off = |a: usize, b: usize| {
        let expected = if a == b { size } else { 0.0 };
        (columns[a].dot(columns[b]) - expected).abs()
    };
    let pairs = [(1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
    pairs.iter().all(|&(a, b)| off(a, b) <= CONFORMAL * size)
}

impl Shape for Instance {
    fn primitives(&self) -> Vec<Primitive> {
        (0..self.0.mesh.data().triangles.len() as u32)
            .map(|i| {
                let Triangle {
                    v0,
                    edges: [e1, e2],
                    ..
                } = self.triangle(i);
                Primitive::Triangle { v0, e1, e2 }
            })
            .collect()
    }

    fn bounds(&self) -> [[f32; 3]; 2] {
        let [low, high] = self.0.bounds;
        [each(low, f32::next_down), each(high, f32::next_up)]
    }

    fn interaction<R: Real>(
        &self,
        _theta: &Theta<R>,
        prim: u32,
        ray: &Ray<R>,
        hit: &Hit,
    ) -> SurfaceInteraction<R> {
        self.triangle(prim).seen(ray, hit, None)
    }

    fn coordinates<P: Float>(
        &self,
        prim: u32,
        si: &SurfaceInteraction<P>,
    ) -> SurfaceCoordinates<P> {
        if self.0.mesh.data().uvs.is_empty() {
            return SurfaceCoordinates(si.uv);
        }
        self.locate(prim, si.p)
    }

    fn locate<P: Float>(&self, prim: u32, p: Vec3<P>) -> SurfaceCoordinates<P> {
        self.triangle(prim).locate(p)
    }

    fn point_at<R: Real>(
        &self,
        _theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> SurfaceInteraction<R> {
        self.triangle(prim).point(at.0.x, at.0.y, None)
    }

    fn partials<R: Real>(
        &self,
        _theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> Option<Partials<R>> {
        self.triangle(prim).partials(at, None)
    }

    fn area_element<R: Real>(&self, _theta: &Theta<R>, prim: u32) -> R {
        R::of(self.triangle(prim).double_area())
    }

    fn carries_frame(&self, prim: u32) -> bool {
        self.0.mesh.carries_frame(prim)
    }

    fn centroid(&self) -> [f64; 3] {
        let mut sum = Vec3::<f64>::zero();
        for i in 0..self.0.mesh.data().triangles.len() as u32 {
            let triangle = self.triangle(i);
            let third = triangle.point::<f64>(1.0 / 3.0, 1.0 / 3.0, None).p;
            sum += third * (0.5 * triangle.double_area());
        }
        (sum * self.0.area().recip()).to_array()
    }

    fn placed(&self, by: &Transform) -> Result<Self, String> {
        Self::new(self.0.mesh.clone(), self.0.to_world.then(by)).map_err(|_| misplaced())
    }

    #[inline]
    fn fetch(&self, prim: u32) {
        self.0.mesh.fetch(prim);
    }

    fn border<R: Real>(&self, prim: u32, ray: &Ray<R>) -> R {
        self.triangle(prim).border(ray)
    }

    fn area(&self) -> f64 {
        self.0.area()
    }

    /// The normal returned is the shading normal.
    fn sample_area<R: Real>(&self, _theta: &Theta<R>, u: [R::Primal; 2]) -> ShapeSample<R> {
        let cdf = self.0.cdf.get_or_init(|| {
            let count = self.0.mesh.data().triangles.len() as u32;
            running_areas((0..count).map(|i| self.triangle(i)))
        });
        let (i, at) = choose(cdf, u);
        (self.triangle(i as u32)).sampled(i as u32, at, self.0.area(), None)
    }

    fn sample_surface<R: Real>(
        &self,
        theta: &Theta<R>,
        u: [R::Primal; 2],
    ) -> (ShapeSample<R>, Vec3<R>) {
        let s = self.sample_area(theta, u);
        (s, self.triangle(s.prim).flat_normal())
    }

    fn sample<P: Float>(&self, from: Vec3<P>, u: [P; 2]) -> Option<DirectionSample<P>> {
        let (s, n_geo) = self.sample_surface(&Theta::still(), u);
        s.seen_from(from, n_geo)
    }

    fn extent(&self) -> f32 {
        self.0.extent
    }
}

impl FromNode for Instance {
    /// None by itself: scenes place groups of shapes.
    const PLUGINS: &'static [&'static str] = &[];

    fn from_node(node: &Node, _registry: &mut Registry) -> Result<Self, SceneError> {
        Err(node.unknown_plugin(Self::PLUGINS))
    }
}
