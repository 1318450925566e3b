//! Replaces references by their targets.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use super::node::{Child, Node};
use super::parse::Parser;
use super::raw::{RawChild, Target};
use super::{Fault, MAX_DEPTH, MAX_ELEMENTS, Notice, Warnings, check_limit};
use crate::error::{Location, SceneError, quoted};

/// A node that is being built, or is finished.
enum State {
    Waiting,
    Open,
    Done(Built),
}

#[derive(Clone)]
struct Built {
    node: Arc<Node>,
    /// Longest way down to a leaf, in nodes: walking or dropping the tree recurses that far.
    height: usize,
    /// Nodes that a walk of the tree visits, shared ones once per use: sharing must not hide an
    /// exponential.
    size: usize,
}

struct Resolver<'a> {
    parser: Parser,
    states: Vec<State>,
    referenced: BTreeSet<usize>,
    warnings: &'a Warnings,
}

/// The tree below the scene, and what was wrong with it, if reading goes on after that.
pub(super) fn resolve(
    parser: Parser,
    warnings: &Warnings,
) -> Result<(Arc<Node>, Vec<Fault>), SceneError> {
    let states = parser.nodes.iter().map(|_| State::Waiting).collect();
    let mut resolver = Resolver {
        parser,
        states,
        referenced: BTreeSet::new(),
        warnings,
    };
    let location = resolver.parser.nodes[0].location.clone();
    let scene = resolver.build(0, &location, 1)?.node;
    resolver.warn_about_unreferenced();
    Ok((scene, resolver.parser.faults.unwrap_or_default()))
}

impl Resolver<'_> {
    /// Builds a node, which `from` nests or refers to.
    fn build(&mut self, index: usize, from: &Location, depth: usize) -> Result<Built, SceneError> {
        match &self.states[index] {
            State::Done(built) => return Ok(built.clone()),
            State::Open => {
                let raw = &self.parser.nodes[index];
                let what = format!("{} at {}", raw.tag, raw.location);
                let location = from.clone();
                return Err(SceneError::Cycle { location, what });
            }
            State::Waiting => self.states[index] = State::Open,
        }
        check_limit(depth, MAX_DEPTH, "levels of nesting", from)?;
        let mut children = Vec::new();
        let (mut height, mut size) = (1, 1_usize);
        for raw in std::mem::take(&mut self.parser.nodes[index].children) {
            let target = match self.target(&raw) {
                Ok(target) => target,
                Err(e) => {
                    let owner = self.parser.nodes[index].location.clone();
                    self.parser.note(e, Some(owner))?;
                    continue;
                }
            };
            let built = self.build(target, &raw.location, depth + 1)?;
            height = height.max(1 + built.height);
            size = size.saturating_add(built.size);
            check_limit(height, MAX_DEPTH, "levels of nesting", &raw.location)?;
            check_limit(size, MAX_ELEMENTS, "elements", &raw.location)?;
            children.push(Child {
                name: raw.name,
                node: built.node,
                location: raw.location,
                used: AtomicBool::new(false),
            });
        }
        let raw = &mut self.parser.nodes[index];
        let node = Arc::new(Node {
            tag: raw.tag.clone(),
            plugin: raw.plugin.clone(),
            id: raw.id.clone(),
            location: raw.location.clone(),
            properties: std::mem::take(&mut raw.properties),
            children,
            asked: Mutex::default(),
            warnings: self.warnings.clone(),
        });
        let built = Built { node, height, size };
        self.states[index] = State::Done(built.clone());
        Ok(built)
    }

    fn target(&mut self, child: &RawChild) -> Result<usize, SceneError> {
        match &child.target {
            Target::Node(index) => Ok(*index),
            Target::Reference(id) => {
                let index = self.parser.find(id, &child.location)?;
                self.referenced.insert(index);
                Ok(index)
            }
        }
    }

    /// A material or an area light at the top level does nothing unless something refers to it. Shapes, other
    /// emitters and the rest do.
    fn warn_about_unreferenced(&self) {
        for (index, raw) in self.parser.nodes.iter().enumerate() {
            let passive = matches!(
                raw.tag.as_str(),
                "bsdf" | "texture" | "film" | "sampler" | "rfilter"
            ) || raw.tag == "emitter" && raw.plugin == "area";
            if let (Some(id), true) = (&raw.id, raw.at_root && passive)
                && !self.referenced.contains(&index)
            {
                let message = format!("{} {} is not referenced by anything", raw.tag, quoted(id));
                (self.warnings).push(raw.location.clone(), Notice::Ignored, message);
            }
        }
    }
}
