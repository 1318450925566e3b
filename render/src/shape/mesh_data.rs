//! What meshes are made of.

use ad_core::{Const, Vec3};

use super::lift3;
use crate::math::each;

/// What a mesh is made of. Arrays with one entry per vertex may be empty.
#[derive(Clone, Debug, Default)]
pub struct MeshData {
    /// World space.
    pub positions: Vec<[f32; 3]>,
    /// World space, of any length; zero for "as the triangle". Without them every triangle is flat.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates. Without them `uv` are the barycentric coordinates of the second and third
    /// vertex.
    pub uvs: Vec<[f32; 2]>,
    /// Vertices of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Vertex normals as averages over the adjacent triangles, weighted by their angle at the vertex
/// [Thuermer and Wuethrich 1998], as Mitsuba 3 computes them. Zero where there is no such triangle.
pub fn smooth_normals(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut sums = vec![Vec3::<f64>::zero(); positions.len()];
    for t in triangles {
        let corners = each(*t, |i| lift3::<f64>(positions[i as usize]));
        let n = (corners[1] - corners[0])
            .cross(corners[2] - corners[0])
            .normalize();
        for k in 0..3 {
            let a = corners[(k + 1) % 3] - corners[k];
            let b = corners[(k + 2) % 3] - corners[k];
            let angle = a.cross(b).length().atan2(a.dot(b));
            sums[t[k] as usize] += n * Const(angle);
        }
    }
    let single = |s: Vec3<f64>| each(s.normalize().to_array(), |x| x as f32);
    sums.into_iter().map(single).collect()
}
