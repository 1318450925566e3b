//! Textures that are numbers of the vertices or faces of a mesh.

use std::sync::Arc;

use ad_core::{Float, Real, Vec2};

use super::Footprint;
use crate::params::ParamRef;

/// Side of the part of a cell that a triangle fills, and where that begins: the rest is room for rounding.
pub(crate) const CELL_FILLED: f64 = 0.5;
pub(crate) const CELL_BEGIN: f64 = 0.25;
/// Most cells along one side: beyond, single precision knows too little of places in a cell.
const MOST_COLUMNS: usize = 4096;

/// Values of the faces of a mesh, or of its vertices and interpolated between them.
///
/// A texture sees surface coordinates only. Those of a mesh with attributes say which triangle a point lies on: triangle
/// number `i` of a mesh with `n` columns has the cell of column `i % n` and row `i / n`, and the barycentric coordinates of
/// its second and third vertex are the place in it (`place`).
#[derive(Clone, Debug)]
pub struct Attribute {
    pub(super) param: ParamRef,
    /// Vertices of each triangle; none for values of faces.
    vertices: Option<Arc<[[u32; 3]]>>,
    /// Number of triangles.
    triangles: u32,
    columns: u32,
}

/// Cells along one side for so many triangles. `None` if there are too many.
pub(crate) fn columns(triangles: usize) -> Option<u32> {
    let side = (triangles as f64).sqrt().ceil() as usize;
    (side <= MOST_COLUMNS).then_some(side.max(1) as u32)
}

/// The surface coordinates of a triangle's vertices.
pub(crate) fn place(triangle: u32, columns: u32) -> [[f32; 2]; 3] {
    let [column, row] = [triangle % columns, triangle / columns].map(f64::from);
    [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|[a, b]: [f64; 2]| {
        let at = |cell: f64, x: f64| (cell + CELL_BEGIN + CELL_FILLED * x) as f32;
        [at(column, a), at(row, b)]
    })
}

impl Attribute {
    /// Values in `param`, of the vertices that are given or else of the faces. `None` for too many triangles, or none.
    pub(crate) fn new(
        param: ParamRef,
        triangles: &Arc<[[u32; 3]]>,
        of_faces: bool,
    ) -> Option<Self> {
        let count = u32::try_from(triangles.len()).ok()?;
        (count > 0).then_some(())?;
        Some(Self {
            param,
            vertices: (!of_faces).then(|| triangles.clone()),
            triangles: count,
            columns: columns(triangles.len())?,
        })
    }

    /// Values and weights of a lookup.
    ///
    /// # Derivatives
    /// In `uv`, within the triangle.
    #[inline]
    pub fn footprint<R: Real>(&self, uv: Vec2<R>) -> Footprint<R> {
        // Anything finite leads to a triangle, also beyond all cells.
        let last = f64::from(self.columns) - 1.0;
        let cell = |x: R| x.primal().to_f64().floor().clamp(0.0, last);
        let (column, row) = (cell(uv.x), cell(uv.y));
        let triangle = (row as u32 * self.columns + column as u32).min(self.triangles - 1);
        let (zero, one) = (R::zero(), R::one());
        let Some(vertices) = &self.vertices else {
            return Footprint {
                param: self.param,
                texel: [triangle; 4],
                weight: [one, zero, zero, zero],
            };
        };
        let within = |x: R, cell: f64| {
            let b = (x - R::c(cell + CELL_BEGIN)) * R::c(1.0 / CELL_FILLED);
            b.max(zero).min(one)
        };
        let (b, c) = (within(uv.x, column), within(uv.y, row));
        let a = (-(b + c) + R::c(1.0)).max(zero);
        let [i, j, k] = vertices[triangle as usize];
        Footprint {
            param: self.param,
            texel: [i, j, k, i],
            weight: [a, b, c, zero],
        }
    }
}
