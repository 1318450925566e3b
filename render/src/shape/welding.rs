//! Vertices that are one point.

use std::collections::HashMap;

use super::mesh_data::MeshData;
use crate::math::each;

/// Which vertices of a mesh are one point: those at equal positions, whatever their normals and texture coordinates are.
/// Seams of texture coordinates are no borders, and do not tear.
#[derive(Clone, Debug, Default)]
pub struct Welding {
    /// Per vertex, the number of its point; points are numbered in the order of their first vertices.
    pub points: Vec<u32>,
    /// Per point, its first vertex.
    pub firsts: Vec<u32>,
}

impl Welding {
    /// Of vertices at these positions.
    pub fn new(positions: &[[f32; 3]]) -> Self {
        let mut known = HashMap::with_capacity(positions.len());
        let mut found = Self::default();
        for (i, p) in (0..).zip(positions) {
            // Zeros of both signs are one.
            let key = each(*p, |x| (x + 0.0).to_bits());
            let next = found.firsts.len() as u32;
            let point = *known.entry(key).or_insert(next);
            if point == next {
                found.firsts.push(i);
            }
            found.points.push(point);
        }
        found
    }

    /// Triangles of a mesh by points.
    pub fn triangles(&self, mesh: &MeshData) -> Vec<[u32; 3]> {
        let points = |t: &[u32; 3]| each(*t, |i| self.points[i as usize]);
        mesh.triangles.iter().map(points).collect()
    }
}
