//! Plugins as they stand in a file.

use std::collections::BTreeMap;

use super::node::Property;
use crate::error::Location;

/// A plugin before its references are resolved.
#[derive(Debug)]
pub(super) struct RawNode {
    pub tag: String,
    pub plugin: String,
    pub id: Option<String>,
    pub location: Location,
    /// Whether the scene itself is the parent.
    pub at_root: bool,
    pub properties: BTreeMap<String, Property>,
    pub children: Vec<RawChild>,
    /// The names of properties and children, which share one namespace.
    pub names: BTreeMap<String, Location>,
}

#[derive(Debug)]
pub(super) struct RawChild {
    pub name: Option<String>,
    pub location: Location,
    pub target: Target,
}

#[derive(Debug)]
pub(super) enum Target {
    Node(usize),
    Reference(String),
}

impl RawNode {
    /// One without anything inside.
    pub fn new(tag: String, plugin: String, id: Option<String>, location: Location) -> Self {
        Self {
            tag,
            plugin,
            id,
            location,
            at_root: false,
            properties: BTreeMap::new(),
            children: Vec::new(),
            names: BTreeMap::new(),
        }
    }
}
