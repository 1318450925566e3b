//! What materials, textures, shapes and emitters need to read themselves from a scene: the description of a plugin
//! ([`Node`]), and where its parameters go ([`Registry`]).
//!
//! This lies below all plugins, which know no scene; the scene that collects them lies above.

mod attributes;
mod origin;
mod refused;
mod registry;
mod view;
pub mod xml;

pub(crate) use attributes::{Attribute, Attributes};
pub(crate) use origin::{Origins, address};
pub use registry::Registry;
pub(crate) use registry::range_text;
pub use xml::Node;

use crate::error::SceneError;

/// Builds a plugin from its description.
pub trait FromNode: Sized {
    /// The plugin's names in scene files.
    const PLUGINS: &'static [&'static str];
    /// Whether the node is one of these: it has one of the names, unless several plugins share that.
    fn takes(node: &Node) -> bool {
        Self::PLUGINS.contains(&node.plugin.as_str())
    }
    /// Reads the description.
    ///
    /// # Errors
    /// With file, line and key, what was expected and what was found.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError>;
}
