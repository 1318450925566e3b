//! Numbers that a mesh has for its vertices or faces, for the textures of the shape that is being built.

use std::collections::BTreeMap;
use std::sync::Arc;

/// One attribute of a mesh.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Attribute {
    /// Of faces instead of vertices.
    pub of_faces: bool,
    /// 1 or 3.
    pub channels: usize,
    /// `[vertex or face][channels]`
    pub values: Vec<f32>,
}

/// What the textures of a shape want to know of its mesh, and what is known.
#[derive(Debug, Default)]
pub(crate) struct Attributes {
    /// Tells shapes that ask for some from each other.
    pub serial: u64,
    /// Name of the shape.
    pub shape: String,
    /// Names that textures ask for: `vertex_color`, `face_weight`, ..; without them meshes keep none.
    pub wanted: Vec<String>,
    /// Vertices of each triangle, as values are numbered.
    pub triangles: Arc<[[u32; 3]]>,
    /// By name; none as long as no mesh was read.
    pub found: Option<BTreeMap<String, Attribute>>,
    /// The mesh is not there, and need not be.
    pub absent: bool,
}
