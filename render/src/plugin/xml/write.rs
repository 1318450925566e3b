//! Nodes as text again.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::node::{Node, Property};
use super::value::Value;
use crate::math::Transform;

/// What stands in a file in place of what was read.
pub(crate) trait Rewrite {
    /// Attributes of a node that have other values now, or stand for their defaults.
    fn values(&mut self, node: &Node) -> Vec<(String, Content)>;
    /// Whether an attribute or a nested plugin belongs to what a node named, and no longer to what stands in its place.
    fn is_gone(&self, node: &Node, name: &str) -> bool;
    /// What stands in place of a plugin: itself, or one that it has inside.
    fn inside<'n>(&self, node: &'n Node) -> &'n Node;
    /// The plugin that a node is now, if it is another.
    fn plugin(&self, node: &Node) -> Option<&'static str>;
    /// The name of a file, relative to the new scene.
    fn file(&mut self, node: &Node, path: Option<PathBuf>, name: &str) -> String;
}

/// What an attribute holds now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Content {
    Scalar(f32),
    Integer(i64),
    Colour([f32; 3]),
    Point([f32; 3]),
    Vector([f64; 3]),
    Boolean(bool),
    Text(&'static str),
    Transform(Transform),
}

/// The text of a scene file of version 3: names, values and colours as they were resolved, shared plugins once.
pub(crate) fn scene(root: &Node, with: &mut dyn Rewrite) -> String {
    let mut writer = Writer {
        uses: HashMap::new(),
        written: HashSet::new(),
        text: "<scene version=\"3.0.0\">\n".to_owned(),
        with,
    };
    writer.count(root);
    writer.body(root, root, 1);
    writer.text.push_str("</scene>\n");
    writer.text
}

struct Writer<'a> {
    /// How often each node is referred to or nested.
    uses: HashMap<*const Node, u32>,
    written: HashSet<*const Node>,
    text: String,
    with: &'a mut dyn Rewrite,
}

fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    text.replace('>', "&gt;").replace('"', "&quot;")
}

impl Writer<'_> {
    fn count(&mut self, node: &Node) {
        for child in &node.children {
            let uses = self.uses.entry(Arc::as_ptr(&child.node)).or_default();
            *uses += 1;
            if *uses == 1 {
                self.count(&child.node);
            }
        }
    }

    fn line(&mut self, depth: usize, line: std::fmt::Arguments) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.text, "{:1$}{line}", "", 4 * depth);
    }

    /// Attributes and nested plugins: those of `of`, with what has become of those of `node`.
    fn body(&mut self, node: &Node, of: &Node, depth: usize) {
        let new = self.with.values(node);
        let given = of.properties.keys().map(String::as_str);
        let names: BTreeSet<&str> = given
            .chain(new.iter().map(|(key, _)| key.as_str()))
            .collect();
        for name in names {
            let content = new.iter().find(|(key, _)| key == name);
            match (content, of.properties.get(name)) {
                _ if self.with.is_gone(node, name) => {}
                (Some((_, content)), _) => self.content(name, *content, depth),
                (None, Some(property)) => self.property(node, name, property, depth),
                (None, None) => {}
            }
        }
        for child in &of.children {
            let name = child.name.as_deref();
            let replaced = |name| new.iter().any(|(key, _)| key == name);
            if name.is_some_and(|name| replaced(name) || self.with.is_gone(node, name)) {
                continue;
            }
            self.plugin(&child.node, name, depth);
        }
    }

    fn plugin(&mut self, node: &Arc<Node>, name: Option<&str>, depth: usize) {
        let name = name.map_or(String::new(), |n| format!(" name=\"{}\"", escaped(n)));
        if !self.written.insert(Arc::as_ptr(node))
            && let Some(id) = &node.id
        {
            self.line(depth, format_args!("<ref id=\"{}\"{name}/>", escaped(id)));
            return;
        }
        let id = node
            .id
            .as_ref()
            .map_or(String::new(), |id| format!(" id=\"{}\"", escaped(id)));
        let tag = if node.is_constant() {
            "spectrum"
        } else {
            node.tag.as_str()
        };
        let of = self.with.inside(node);
        let plugin = escaped(self.with.plugin(of).unwrap_or(&of.plugin));
        self.line(depth, format_args!("<{tag} type=\"{plugin}\"{id}{name}>"));
        self.body(node, of, depth + 1);
        self.line(depth, format_args!("</{tag}>"));
    }

    fn content(&mut self, name: &str, content: Content, depth: usize) {
        let (tag, value) = match content {
            Content::Scalar(x) => ("float", x.to_string()),
            Content::Integer(i) => ("integer", i.to_string()),
            Content::Colour([r, g, b]) => ("rgb", format!("{r}, {g}, {b}")),
            Content::Point([x, y, z]) => ("point", format!("{x}, {y}, {z}")),
            Content::Vector([x, y, z]) => ("vector", format!("{x}, {y}, {z}")),
            Content::Boolean(b) => ("boolean", b.to_string()),
            Content::Text(text) => ("string", text.to_owned()),
            Content::Transform(t) => return self.transform(name, &t, depth),
        };
        self.line(
            depth,
            format_args!("<{tag} name=\"{}\" value=\"{value}\"/>", escaped(name)),
        );
    }

    fn transform(&mut self, name: &str, t: &Transform, depth: usize) {
        let rows = t.matrix();
        let numbers: Vec<String> = rows.as_flattened().iter().map(f64::to_string).collect();
        let name = escaped(name);
        self.line(depth, format_args!("<transform name=\"{name}\">"));
        let numbers = numbers.join(" ");
        self.line(depth + 1, format_args!("<matrix value=\"{numbers}\"/>"));
        self.line(depth, format_args!("</transform>"));
    }

    fn property(&mut self, node: &Node, name: &str, property: &Property, depth: usize) {
        let key = escaped(name);
        let (tag, value) = match &property.value {
            Value::Float(x) => ("float", x.to_string()),
            Value::Integer(i) => ("integer", i.to_string()),
            Value::Boolean(b) => ("boolean", b.to_string()),
            Value::Color([r, g, b]) => ("rgb", format!("{r}, {g}, {b}")),
            Value::Point([x, y, z]) => ("point", format!("{x}, {y}, {z}")),
            Value::Vector([x, y, z]) => ("vector", format!("{x}, {y}, {z}")),
            Value::String(s) if name == "filename" => {
                let found = property.directories.find(Path::new(s));
                ("string", self.with.file(node, found, s))
            }
            Value::String(s) => ("string", s.clone()),
            Value::Transform(t) => return self.transform(name, t, depth),
        };
        let value = escaped(&value);
        self.line(
            depth,
            format_args!("<{tag} name=\"{key}\" value=\"{value}\"/>"),
        );
    }
}
