//! Which parts of a scene file parameters were read from, so that they can be written again.

use std::collections::{BTreeMap, HashMap};

use super::Node;
use crate::params::ParamRef;

/// The parameters that were read from a node.
#[derive(Debug, Default)]
pub(crate) struct Origin {
    /// Attributes, given or not, by name.
    pub values: BTreeMap<String, u32>,
    /// The image that is named.
    pub image: Option<u32>,
    /// The relative index of refraction.
    pub index: Option<u32>,
}

/// The same for each node, by where it lies.
#[derive(Debug, Default)]
pub(crate) struct Origins(HashMap<usize, Origin>);

/// Nodes are told apart by where they lie, as long as they are there.
pub(crate) fn address(node: &Node) -> usize {
    std::ptr::from_ref(node).addr()
}

impl Origins {
    pub fn of_value(&mut self, node: &Node, key: &str, param: ParamRef) {
        self.at(node).values.insert(key.to_owned(), param.id);
    }

    pub fn of_image(&mut self, node: &Node, param: ParamRef) {
        self.at(node).image = Some(param.id);
    }

    pub fn of_index(&mut self, node: &Node, param: ParamRef) {
        self.at(node).index = Some(param.id);
    }

    /// Nothing of a node can be written again.
    pub fn forget(&mut self, node: &Node) {
        self.0.remove(&address(node));
    }

    /// What was read from a node belongs to another one, around it.
    pub fn hand_on(&mut self, from: &Node, to: &Node) {
        if let Some(origin) = self.0.remove(&address(from)) {
            self.0.insert(address(to), origin);
        }
    }

    fn at(&mut self, node: &Node) -> &mut Origin {
        self.0.entry(address(node)).or_default()
    }

    /// What was read from a node.
    pub fn of(&self, node: &Node) -> Option<&Origin> {
        self.0.get(&address(node))
    }

    /// All parameters that can be written again.
    pub fn params(&self) -> impl Iterator<Item = u32> {
        let one = |o: &Origin| {
            let own: Vec<u32> = (o.values.values().copied())
                .chain(o.image)
                .chain(o.index)
                .collect();
            own
        };
        self.0.values().flat_map(one)
    }
}
