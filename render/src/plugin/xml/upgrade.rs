//! Plugins of versions 0.4 to 0.6 as those of version 3.
//!
//! What has another name gets the new one, what means the same in other words is said in those, and what stands in for
//! something is warned of. Names in another case are the parser's business.

use std::collections::{BTreeMap, BTreeSet};

use super::Notice;
use super::node::{Kind, Property};
use super::raw::{RawChild, RawNode, Target};
use super::value::{self, Value};
use crate::error::{Location, quoted};
use crate::math::Transform;

/// The element, its plugins (all if there are none here), and the old and the new name of an attribute.
const RENAMED: &[(&str, &[&str], &str, &str)] = &[
    ("bsdf", &["diffuse"], "diffuse_reflectance", "reflectance"),
    ("bsdf", &[], "int_eta", "int_ior"),
    ("bsdf", DIELECTRICS, "ext_eta", "ext_ior"),
];
/// Those of them whose outer index is that of a dielectric against another; metals have an `ext_eta`.
const DIELECTRICS: &[&str] = &[
    "dielectric",
    "plastic",
    "roughdielectric",
    "roughplastic",
    "thindielectric",
];
const METALS: &[&str] = &["conductor", "roughconductor"];

/// A row of the table of those.
type Old = (
    &'static str,
    &'static [&'static str],
    &'static [&'static str],
    Kind,
    bool,
);

/// Attributes that are no longer there: the element, its plugins (all if there are none here), names, what they hold, and
/// whether they change no image here; others become something else.
const OLD: &[Old] = &[
    ("integrator", &[], &["strict_normals"], Kind::Boolean, false),
    (
        "integrator",
        &[],
        &["luminaire_samples"],
        Kind::Integer,
        true,
    ),
    ("emitter", &["envmap"], &["cache"], Kind::Boolean, true),
    (
        "shape",
        &["obj"],
        &["collapse", "load_materials"],
        Kind::Boolean,
        true,
    ),
    ("shape", &["ply"], &["srgb"], Kind::Boolean, true),
    ("texture", &["bitmap"], &["cache"], Kind::Boolean, true),
    (
        "texture",
        &["bitmap"],
        &["max_anisotropy"],
        Kind::Number,
        true,
    ),
    (
        "texture",
        &["bitmap"],
        &["wrap_mode_u", "wrap_mode_v"],
        Kind::Text,
        false,
    ),
    (
        "texture",
        &["bitmap", "checkerboard"],
        &["uoffset", "voffset", "uscale", "vscale"],
        Kind::Number,
        false,
    ),
];

/// Whether a row of a table is about a plugin.
fn is_of(node: (&str, &str), tag: &str, plugins: &[&str]) -> bool {
    node.0 == tag && (plugins.is_empty() || plugins.contains(&node.1))
}

/// What a plugin may be given in old files besides what it asks for: names, and what stands there.
pub(crate) fn old_attributes(
    tag: &str,
    plugin: &str,
    asked: &BTreeMap<String, BTreeSet<Kind>>,
) -> Vec<(&'static str, BTreeSet<Kind>)> {
    let is = |of: &str, plugins: &[&str]| is_of((tag, plugin), of, plugins);
    let renamed = RENAMED.iter().filter(|(of, plugins, ..)| is(of, plugins));
    let renamed = renamed.filter_map(|(_, _, from, to)| Some((*from, asked.get(*to)?.clone())));
    let others = OLD.iter().filter(|(of, plugins, ..)| is(of, plugins));
    let others = others.flat_map(|(_, _, names, kind, _)| {
        names.iter().map(|name| (*name, BTreeSet::from([*kind])))
    });
    renamed.chain(others).collect()
}

/// The plugins of a file so far, and what is warned of.
struct Plugins<'a> {
    nodes: &'a mut Vec<RawNode>,
    warnings: &'a mut Vec<(Location, Notice, String)>,
}

/// Brings a plugin of an old file, whose attributes and children are there, up to date.
pub(super) fn upgrade(
    nodes: &mut Vec<RawNode>,
    warnings: &mut Vec<(Location, Notice, String)>,
    index: usize,
) {
    let plugins = &mut Plugins { nodes, warnings };
    let is = |plugins: &Plugins, tag: &str, names: &[&str]| {
        let node = &plugins.nodes[index];
        is_of((&node.tag, &node.plugin), tag, names)
    };
    for &(tag, of, from, to) in RENAMED {
        if is(plugins, tag, of) {
            rename(&mut plugins.nodes[index], from, to);
        }
    }
    for &(tag, of, names, _, idle) in OLD {
        if idle && is(plugins, tag, of) {
            names.iter().for_each(|name| ignore(plugins, index, name));
        }
    }
    match plugins.nodes[index].tag.as_str() {
        "bsdf" => material(plugins, index),
        "film" => captions(plugins, index),
        "integrator" => normals(plugins, index),
        "emitter" => encoding(&mut plugins.nodes[index]),
        "texture" => {
            coordinates(&mut plugins.nodes[index]);
            encoding(&mut plugins.nodes[index]);
            wraps(&mut plugins.nodes[index]);
            filter(plugins, index);
        }
        _ => {}
    }
}

impl Plugins<'_> {
    /// Adds a material that no file has.
    fn add(&mut self, plugin: &str, location: &Location) -> usize {
        let node = RawNode::new("bsdf".to_owned(), plugin.to_owned(), None, location.clone());
        self.nodes.push(node);
        self.nodes.len() - 1
    }
}

/// Removes an attribute, with a warning that it does nothing.
fn ignore(plugins: &mut Plugins, index: usize, name: &str) {
    if let Some(property) = take(&mut plugins.nodes[index], name) {
        let message = format!("{} has no effect", quoted(name));
        warn(plugins, index, property.location, Notice::Ignored, &message);
    }
}

fn warn(plugins: &mut Plugins, index: usize, at: Location, notice: Notice, message: &str) {
    let node = &plugins.nodes[index];
    let message = format!("{} {}: {message}", node.tag, quoted(&node.plugin));
    plugins.warnings.push((at, notice, message));
}

fn take(node: &mut RawNode, name: &str) -> Option<Property> {
    let property = node.properties.remove(name)?;
    node.names.remove(name);
    Some(property)
}

fn put(node: &mut RawNode, name: &str, property: Property) {
    node.names
        .insert(name.to_owned(), property.location.clone());
    node.properties.insert(name.to_owned(), property);
}

fn text(word: &str, location: &Location) -> Property {
    Property::made("string", word, Value::String(word.to_owned()), location)
}

fn number(x: f64, location: &Location) -> Property {
    Property::made("float", &x.to_string(), Value::Float(x), location)
}

/// The text of an attribute, if it is one.
fn word<'a>(node: &'a RawNode, name: &str) -> Option<(&'a str, Location)> {
    match node.properties.get(name)? {
        Property {
            value: Value::String(s),
            location,
            ..
        } => Some((s, location.clone())),
        _ => None,
    }
}

fn material(plugins: &mut Plugins, index: usize) {
    let node = &mut plugins.nodes[index];
    let given = ["material", "eta", "k"].map(|name| node.names.contains_key(name));
    if METALS.contains(&node.plugin.as_str()) && given == [false; 3] {
        // Version 2 made it a perfect mirror, and Mitsuba 3 reads old files like that, too.
        let at = node.location.clone();
        put(node, "material", text("Cu", &at));
        let message = "copper, as a metal without `material` was before version 2; Mitsuba 3 would make it a perfect mirror";
        warn(plugins, index, at, Notice::Replaced, message);
    }
    let node = &mut plugins.nodes[index];
    if let Some((old @ ("phong" | "as"), at)) = word(node, "distribution") {
        let message = format!(
            "distribution {}: Beckmann's of the same roughness instead, which is close to it where that is small",
            quoted(old)
        );
        put(node, "distribution", text("beckmann", &at));
        warn(plugins, index, at, Notice::Replaced, &message);
    }
    match plugins.nodes[index].plugin.as_str() {
        "mixturebsdf" => mixture(plugins, index),
        "normalmap" => map_of_normals(plugins, index),
        _ => {}
    }
}

/// The texture of a normal map had no name, and its normals were never corrected.
fn map_of_normals(plugins: &mut Plugins, index: usize) {
    let node = &mut plugins.nodes[index];
    for name in ["flip_invalid_normals", "use_shadowing_function"] {
        if !node.names.contains_key(name) {
            let at = node.location.clone();
            let off = Property::made("boolean", "false", Value::Boolean(false), &at);
            put(node, name, off);
        }
    }
    let is_texture = |child: &RawChild| {
        let node = match child.target {
            Target::Node(node) => plugins.nodes.get(node),
            Target::Reference(_) => None,
        };
        child.name.is_none() && node.is_some_and(|node| node.tag == "texture")
    };
    let found = plugins.nodes[index].children.iter().position(is_texture);
    let node = &mut plugins.nodes[index];
    if let Some(i) = found.filter(|_| !node.names.contains_key("normalmap")) {
        let location = node.children[i].location.clone();
        node.children[i].name = Some("normalmap".to_owned());
        node.names.insert("normalmap".to_owned(), location);
    }
}

/// A weighted sum of materials as blends of two, and of black for what the weights leave over.
fn mixture(plugins: &mut Plugins, index: usize) {
    let node = &plugins.nodes[index];
    let Some((list, at)) = word(node, "weights") else {
        return;
    };
    let numbers = list
        .split([',', ';', ' '])
        .filter(|t| !t.is_empty())
        .map(value::float);
    let Ok(mut weights) = numbers.collect::<Result<Vec<f64>, _>>() else {
        return;
    };
    let sum: f64 = weights.iter().sum();
    let valid = weights.iter().all(|w| *w >= 0.0) && sum > 0.0;
    if !valid || weights.is_empty() || weights.len() != node.children.len() {
        // Refused by its name.
        return;
    }
    let location = node.location.clone();
    let mut parts = std::mem::take(&mut plugins.nodes[index].children);
    let nested = |target: usize| RawChild {
        name: None,
        location: location.clone(),
        target: Target::Node(target),
    };
    let rest = 1.0 - sum;
    if rest > 1e-6 || parts.len() == 1 {
        let black = plugins.add("diffuse", &location);
        let none = Property::made("rgb", "0", Value::Color([0.0; 3]), &location);
        put(&mut plugins.nodes[black], "reflectance", none);
        parts.push(nested(black));
        weights.push(rest.max(0.0));
    }
    // From the last two on, each blend is the second part of the one around it.
    let (mut second, mut weight) = (parts.pop(), weights.pop().unwrap_or_default());
    while let (Some(first), Some(own)) = (parts.pop(), weights.pop()) {
        let both = own + weight;
        let share = if both > 0.0 { weight / both } else { 0.0 };
        let blend = if parts.is_empty() {
            index
        } else {
            plugins.add("blendbsdf", &location)
        };
        let node = &mut plugins.nodes[blend];
        put(node, "weight", number(share, &at));
        node.children.push(first);
        node.children.extend(second.take());
        second = Some(nested(blend));
        weight = both;
    }
    let node = &mut plugins.nodes[index];
    take(node, "weights");
    node.plugin = "blendbsdf".to_owned();
    // Names are those of a blend's parts.
    for child in &mut node.children {
        if let Some(name) = child.name.take() {
            node.names.remove(&name);
        }
    }
}

/// What a film writes into its file besides the image.
fn captions(plugins: &mut Plugins, index: usize) {
    let node = &plugins.nodes[index];
    let about = |name: &&String| name.starts_with("label[") || name.starts_with("metadata[");
    let names: Vec<String> = node.properties.keys().filter(about).cloned().collect();
    for name in names {
        ignore(plugins, index, &name);
    }
}

/// Whether light is left out on sides where a surface and its shading normal disagree: here it never is.
fn normals(plugins: &mut Plugins, index: usize) {
    let strict = take(&mut plugins.nodes[index], "strict_normals");
    if let Some(Property {
        value: Value::Boolean(true),
        location,
        ..
    }) = strict
    {
        let message = "`strict_normals`: light is not left out where a surface and its shading normal face different ways";
        warn(plugins, index, location, Notice::Replaced, message);
    }
}

/// The gamma of an image: none is sRGB, and so is -1; 1 is that of numbers. Others stay.
fn encoding(node: &mut RawNode) {
    let gamma = match node.properties.get("gamma").map(|p| &p.value) {
        Some(Value::Float(x)) => *x,
        Some(Value::Integer(i)) => *i as f64,
        _ => return,
    };
    if gamma == -1.0 {
        take(node, "gamma");
    } else if gamma == 1.0
        && !node.names.contains_key("raw")
        && let Some(property) = take(node, "gamma")
    {
        let raw = Property::made("boolean", "true", Value::Boolean(true), &property.location);
        put(node, "raw", raw);
    }
}

/// `wrap_mode_u` and `wrap_mode_v`, where they say the same; others stay.
fn wraps(node: &mut RawNode) {
    let both = ["wrap_mode_u", "wrap_mode_v"];
    let words = both.map(|name| word(node, name));
    let Some(location) = words.iter().flatten().map(|(_, at)| at.clone()).next() else {
        return;
    };
    let absent = word(node, "wrap_mode").map_or("repeat", |(word, _)| word);
    let [u, v] = words.map(|w| w.map_or(absent, |(word, _)| word).to_owned());
    if u == v {
        both.iter().for_each(|name| drop(take(node, name)));
        put(node, "wrap_mode", text(&u, &location));
    }
}

/// Filters over several sizes of an image: there is only one here.
fn filter(plugins: &mut Plugins, index: usize) {
    let node = &mut plugins.nodes[index];
    if let Some((old @ ("ewa" | "trilinear"), at)) = word(node, "filter_type") {
        let message = format!(
            "filter {}: `bilinear` instead; samples of a pixel blur what is smaller",
            quoted(old)
        );
        put(node, "filter_type", text("bilinear", &at));
        warn(plugins, index, at, Notice::Replaced, &message);
    }
}

/// Offsets and scales of surface coordinates as a transform.
fn coordinates(node: &mut RawNode) {
    let parts = [
        ("uoffset", 0.0),
        ("voffset", 0.0),
        ("uscale", 1.0),
        ("vscale", 1.0),
    ];
    if node.names.contains_key("to_uv") {
        return;
    }
    // Those that are no numbers stay, and are refused as unknown.
    let mut first = None;
    let [u, v, du, dv] = parts.map(|(name, absent)| {
        let x = match node.properties.get(name).map(|p| &p.value) {
            Some(Value::Float(x)) => *x,
            Some(Value::Integer(i)) => *i as f64,
            _ => return absent,
        };
        let property = take(node, name);
        first = first.take().or(property);
        x
    });
    if let Some(property) = first {
        let [offset, scale] = [[u, v, 0.0], [du, dv, 1.0]];
        let value = Transform::translate(offset).then(&Transform::scale(scale));
        let to_uv = Property {
            value: Value::Transform(value),
            tag: "transform",
            ..property
        };
        put(node, "to_uv", to_uv);
    }
}

/// Gives a property or a child another name, if that is free.
fn rename(node: &mut RawNode, from: &str, to: &str) {
    if node.names.contains_key(to) {
        return;
    }
    if let Some(property) = node.properties.remove(from) {
        node.properties.insert(to.to_owned(), property);
    }
    for child in &mut node.children {
        if child.name.as_deref() == Some(from) {
            child.name = Some(to.to_owned());
        }
    }
    if let Some(location) = node.names.remove(from) {
        node.names.insert(to.to_owned(), location);
    }
}
