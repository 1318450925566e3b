//! Meshes of scene files, in any of their formats.

use super::displacement::HEIGHTS;
use super::{Mesh, ObjOptions, ply, serialized};
use crate::error::SceneError;
use crate::plugin::{FromNode, Node, Registry};

impl FromNode for Mesh {
    const PLUGINS: &'static [&'static str] = &["obj", "ply", "serialized"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let mesh = match node.plugin.as_str() {
            "ply" => ply::from_node(node, registry),
            "serialized" => serialized::from_node(node, registry),
            _ => obj(node, registry),
        }?;
        if node.child("displacement").is_none() {
            return Ok(mesh);
        }
        let texture = registry.scalar_texture(node, "displacement", 0.0, HEIGHTS)?;
        mesh.displaced(&texture, registry.params())
            .map_err(|e| match e {
                SceneError::Parameter { key, expected, .. } => node.invalid(&key, &expected),
                other => other,
            })
    }
}

/// A Wavefront OBJ file.
fn obj(node: &Node, registry: &mut Registry) -> Result<Mesh, SceneError> {
    let to_world = node.transform("to_world")?.unwrap_or_default();
    let options = ObjOptions {
        to_world,
        face_normals: node.boolean_or("face_normals", false)?,
        flip_normals: node.boolean_or("flip_normals", false)?,
        flip_v: node.boolean_or("flip_tex_coords", true)?,
    };
    let path = node
        .path("filename")?
        .ok_or_else(|| node.missing("filename", "an OBJ file"))?;
    let (mesh, skipped) = Mesh::from_obj(&path, &options)?;
    registry.warnings.extend(skipped);
    Ok(mesh)
}
