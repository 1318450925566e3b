//! What materials, textures, shapes and emitters need to read themselves from a scene: the description of a plugin
//! ([`Node`]), and where its parameters go ([`Registry`]).
//!
//! This lies below all plugins, which know no scene; the scene that collects them lies above.

mod registry;
pub mod xml;

pub use registry::Registry;
pub(crate) use registry::range_text;
pub use xml::Node;

use crate::error::SceneError;

/// Builds a plugin from its description.
pub trait FromNode: Sized {
    /// The plugin's names in scene files.
    const PLUGINS: &'static [&'static str];
    /// Reads the description.
    ///
    /// # Errors
    /// With file, line and key, what was expected and what was found.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError>;
}
