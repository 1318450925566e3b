//! Textures from scene files.

use super::Texture;
use crate::error::SceneError;
use crate::params::Differentiability;
use crate::scene::{Builder, Node};

/// The texture `key` of `node`: a nested texture plugin, a constant, or the default.
pub(crate) fn from_node<const C: usize>(
    build: &mut Builder,
    node: &Node,
    key: &str,
    default: &[f64],
    valid: (f64, f64),
) -> Result<Texture<C>, SceneError> {
    let name = format!("{}.{key}.value", build.prefix());
    let value = if C == 1 {
        node.float(key)?.map(|x| vec![x])
    } else {
        node.rgb(key)?.map(|c| c.to_vec())
    };
    let value = value.unwrap_or_else(|| default.to_vec());
    build.constant(&name, &value, valid, Differentiability::Smooth)
}
