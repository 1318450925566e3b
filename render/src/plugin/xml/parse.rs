//! From files to plugins whose values are typed but whose references are still names.

use std::collections::BTreeMap;
use std::ops::Bound;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use roxmltree as xml;

use super::element::{Attribute, Element};
use super::node::Property;
use super::raw::{RawChild, RawNode, Target};
use super::source::{self, Source, Version};
use super::spectrum::{self, Role, Samples};
use super::upgrade::upgrade;
use super::value::{self, Value};
use super::{
    Directories, Fault, MAX_DEPTH, MAX_ELEMENTS, MAX_INCLUDES, MAX_PATHS, MAX_SUBSTITUTED,
    MAX_TEXT, Notice, check_limit,
};
use crate::error::{Location, SceneError, quoted};
use crate::image_io::srgb_to_linear;
use crate::math::Transform;
use crate::plugin::refused;

/// Elements that are plugins.
const PLUGINS: [&str; 9] = [
    "bsdf",
    "emitter",
    "film",
    "integrator",
    "rfilter",
    "sampler",
    "sensor",
    "shape",
    "texture",
];
const PROPERTIES: [&str; 11] = [
    "blackbody",
    "boolean",
    "float",
    "integer",
    "point",
    "rgb",
    "spectrum",
    "srgb",
    "string",
    "transform",
    "vector",
];
const DIRECTIVES: [&str; 5] = ["alias", "default", "include", "path", "ref"];
const OPERATIONS: [&str; 5] = ["lookat", "matrix", "rotate", "scale", "translate"];

/// A `$name` and where it comes from.
struct Parameter {
    value: String,
    /// Whether the scene declares or uses it, so that `-D` of it has a meaning.
    known: bool,
}

/// All that is gathered while the files are read. Node 0 is the scene.
pub(super) struct Parser {
    pub nodes: Vec<RawNode>,
    /// Targets of references, aliases included.
    ids: BTreeMap<String, (usize, Location)>,
    aliases: Vec<(String, String, Location)>,
    parameters: BTreeMap<String, Parameter>,
    /// The files between the scene and the current one, to notice cycles.
    open: Vec<PathBuf>,
    elements: usize,
    substituted: usize,
    /// How many files were included, and the bytes of all.
    included: usize,
    bytes: usize,
    /// Folders that were named to look in.
    paths: usize,
    /// What has no effect, or another one than was meant.
    pub warnings: Vec<(Location, Notice, String)>,
    /// What is wrong, if reading goes on after that.
    pub faults: Option<Vec<Fault>>,
}

impl Parser {
    pub fn new(defines: &[(String, String)]) -> Self {
        let parameter = |(name, value): &(String, String)| {
            let value = value.clone();
            (
                name.clone(),
                Parameter {
                    value,
                    known: false,
                },
            )
        };
        Self {
            nodes: Vec::new(),
            ids: BTreeMap::new(),
            aliases: Vec::new(),
            parameters: defines.iter().map(parameter).collect(),
            open: Vec::new(),
            elements: 0,
            substituted: 0,
            included: 0,
            bytes: 0,
            paths: 0,
            warnings: Vec::new(),
            faults: None,
        }
    }

    /// The scene file itself.
    pub fn file(&mut self, path: &Path) -> Result<(), SceneError> {
        let text = source::read(path)?;
        self.open.push(source::canonical(path));
        self.text(&text, path, path.parent().unwrap_or(Path::new("")))
    }

    /// The text of the scene file, which lies in `directory`.
    pub fn text(&mut self, text: &str, name: &Path, directory: &Path) -> Result<(), SceneError> {
        self.bytes = text.len();
        let source = Source::new(name, Directories::new(directory, None), text);
        let tree = source.parse(text)?;
        let root = tree.root_element();
        let element = self.element(root, &source)?;
        if element.tag != "scene" {
            return Err(element.syntax("<scene>"));
        }
        let location = element.location.clone();
        let id = scene_id(element, &source)?;
        let scene = self.add("scene".to_owned(), "scene".to_owned(), id, location, false)?;
        self.body(root, &source, scene, 1)?;
        self.add_aliases()
    }

    /// Rejects definitions from outside that the scene neither declares nor uses.
    pub fn check_defines(&self, file: &Path) -> Result<(), SceneError> {
        match self.parameters.iter().find(|(_, p)| !p.known) {
            None => Ok(()),
            Some((name, _)) => Err(SceneError::UnusedDefine {
                file: file.to_owned(),
                name: name.clone(),
                known: self.known_parameters(""),
            }),
        }
    }

    fn known_parameters(&self, prefix: &str) -> Vec<String> {
        let known = self.parameters.iter().filter(|(_, p)| p.known);
        known.map(|(name, _)| format!("{prefix}{name}")).collect()
    }

    /// The elements inside a plugin, or inside the root of an included file.
    fn body(
        &mut self,
        parent: xml::Node,
        source: &Source,
        owner: usize,
        depth: usize,
    ) -> Result<(), SceneError> {
        for child in source.elements(parent) {
            // Without what is included, all else would be missed, too.
            let is_include = (child.as_ref()).is_ok_and(|child| child.has_tag_name("include"));
            match child.and_then(|child| self.member(child, source, owner, depth)) {
                Err(e) if !is_include => {
                    let owner = self.nodes[owner].location.clone();
                    self.note(e, Some(owner))?;
                }
                read => read?,
            }
        }
        Ok(())
    }

    /// Notes an error and leaves out what it is about, if reading goes on after that: not after one that protects memory, nor
    /// where a value has to be found first.
    pub fn note(&mut self, error: SceneError, owner: Option<Location>) -> Result<(), SceneError> {
        use SceneError::{Limit, UndefinedParameter};
        match &mut self.faults {
            Some(faults) if !matches!(error, Limit { .. } | UndefinedParameter { .. }) => {
                faults.push(Fault { error, owner });
                Ok(())
            }
            _ => Err(error),
        }
    }

    /// One element inside the plugin `owner`.
    fn member(
        &mut self,
        xml: xml::Node,
        source: &Source,
        owner: usize,
        depth: usize,
    ) -> Result<(), SceneError> {
        let mut element = self.element(xml, source)?;
        check_limit(depth, MAX_DEPTH, "levels of nesting", &element.location)?;
        let tag = match element.tag.as_str() {
            "spectrum" if element.has("type") => "texture".to_owned(),
            tag => tag.to_owned(),
        };
        if PLUGINS.contains(&tag.as_str()) {
            return self.plugin(element, tag, xml, source, owner, depth);
        }
        if let Some(tag) = PROPERTIES.into_iter().find(|t| *t == tag) {
            return self.property(element, tag, xml, source, owner);
        }
        match tag.as_str() {
            "ref" => {
                let id = element.require("id")?;
                let name = element.take("name");
                self.leaf(element, xml, source)?;
                let target = Target::Reference(id.text);
                self.child(owner, name, id.location, target)
            }
            "alias" => {
                let id = element.require("id")?;
                let alias = element.require("as")?;
                self.leaf(element, xml, source)?;
                self.aliases.push((id.text, alias.text, alias.location));
                Ok(())
            }
            "default" => {
                let name = element.require("name")?;
                let value = element.require("value")?;
                self.leaf(element, xml, source)?;
                self.declare(name, value)
            }
            "include" => {
                let file = element.require("filename")?;
                self.leaf(element, xml, source)?;
                self.include(&file, source, owner, depth)
            }
            "path" => {
                let folder = element.require("value")?;
                if owner != 0 {
                    return Err(element.syntax("<path> in <scene> itself"));
                }
                self.leaf(element, xml, source)?;
                self.path(&folder, source)
            }
            tag => {
                let plugin = element.peek("type").unwrap_or_default().to_owned();
                if let Some(what) = refused::reason(tag, &plugin) {
                    let location = element.location.clone();
                    let refused = SceneError::Refused {
                        plugin: plugin.clone(),
                        tag: tag.to_owned(),
                        location: location.clone(),
                        what,
                    };
                    self.note(refused, None)?;
                    // So that what refers to it finds it.
                    let id = element.take("id").map(|a| a.text);
                    self.add(tag.to_owned(), plugin, id, location, false)?;
                    return Ok(());
                }
                let mut allowed = [&PLUGINS[..], &PROPERTIES, &DIRECTIVES].concat();
                allowed.sort_unstable();
                Err(element.syntax(&format!("one of the elements {}", allowed.join(", "))))
            }
        }
    }

    fn plugin(
        &mut self,
        mut element: Element,
        tag: String,
        xml: xml::Node,
        source: &Source,
        owner: usize,
        depth: usize,
    ) -> Result<(), SceneError> {
        let name = element.require("type")?;
        // No plugin has capitals, but files of others do: theirs are looked up without regard to case.
        let plugin = name.text.to_lowercase();
        if plugin != name.text {
            let message = format!("{tag} {}: read as {}", quoted(&name.text), quoted(&plugin));
            self.warn(name.location, message);
        }
        let id = element.take("id").map(|a| a.text);
        let name = element.take("name");
        if xml.parent().is_some_and(|p| p.is_root())
            && let Some(version) = element.take("version")
        {
            source.version.set(known_version(&version)?);
        }
        element.finish()?;
        let location = element.location;
        let at_root = owner == 0;
        let node = self.add(tag, plugin, id, location.clone(), at_root)?;
        self.child(owner, name, location, Target::Node(node))?;
        self.body(xml, source, node, depth + 1)?;
        if source.version.get() < (2, 0) {
            upgrade(&mut self.nodes, &mut self.warnings, node);
        }
        Ok(())
    }

    /// `<path>`: files are looked up in another folder first, from here on.
    fn path(&mut self, folder: &Attribute, source: &Source) -> Result<(), SceneError> {
        self.paths += 1;
        check_limit(self.paths, MAX_PATHS, "<path> elements", &folder.location)?;
        let directories = source.directories();
        match directories.find_folder(Path::new(&folder.text)) {
            Some(path) => {
                source.look_in(&path);
                if let Some(what) = directories.substitution(&folder.text, &path) {
                    self.warn(folder.location.clone(), format!("<path>: {what}"));
                }
            }
            // Whatever should lie there is missed by name later on.
            None => self.warn(
                folder.location.clone(),
                format!(
                    "<path>: there is no folder {} (looked in {directories})",
                    quoted(&folder.text)
                ),
            ),
        }
        Ok(())
    }

    /// The file that an attribute names.
    fn find_file(
        &mut self,
        file: &Attribute,
        key: &str,
        source: &Source,
    ) -> Result<PathBuf, SceneError> {
        let directories = source.directories();
        let Some(path) = directories.find(Path::new(&file.text)) else {
            return Err(SceneError::NoFile {
                location: file.location.clone(),
                key: key.to_owned(),
                folders: directories.to_string(),
                name: file.text.clone(),
            });
        };
        if let Some(what) = directories.substitution(&file.text, &path) {
            self.warn(file.location.clone(), format!("{}: {what}", quoted(key)));
        }
        Ok(path)
    }

    /// The colour of a `<spectrum>`: three numbers are RGB.
    fn spectrum(
        &mut self,
        element: &mut Element,
        source: &Source,
        owner: usize,
    ) -> Result<[f64; 3], SceneError> {
        let role = role(&self.nodes[owner], &element.key);
        let samples = if let Some(file) = element.take("filename") {
            let path = self.find_file(&file, &element.key, source)?;
            let text = source::read(&path)?;
            self.bytes += text.len();
            check_limit(self.bytes, MAX_TEXT, "bytes of scene files", &file.location)?;
            Samples::of_lines(&text).map_err(|e| SceneError::Asset {
                path,
                line: None,
                expected: e.expected.to_owned(),
                found: e.found,
            })?
        } else if element.peek("value").is_some_and(|v| v.contains(':')) {
            element.parse("value", Samples::parse)?
        } else {
            let flat = element.peek("value").and_then(|v| value::float(v).ok());
            let colour = element.parse("value", value::triple_or_uniform)?;
            // Mitsuba 2 took flat lamps for white.
            let seen = source.version.get() >= (3, 0);
            return Ok(flat
                .filter(|_| seen)
                .map_or(colour, |v| spectrum::flat(v, role)));
        };
        let (colour, cut) = spectrum::rgb(&samples, role);
        if cut {
            let message = format!(
                "{}: a spectrum whose colour RGB cannot show; the nearest is {colour:?}",
                quoted(&element.key)
            );
            self.warn(element.location.clone(), message);
        }
        Ok(colour)
    }

    fn property(
        &mut self,
        mut element: Element,
        tag: &'static str,
        xml: xml::Node,
        source: &Source,
        owner: usize,
    ) -> Result<(), SceneError> {
        let name = element.require("name")?;
        let key = value::snake_case(&name.text);
        element.key = key.clone();
        let text = element.peek("value").unwrap_or_default().to_owned();
        if source.version.get() < (2, 0) && matches!(tag, "rgb" | "srgb" | "spectrum") {
            // What it stands for is known from its place.
            element.take("intent");
        }
        let value = match tag {
            "float" => Value::Float(element.parse("value", value::float)?),
            "integer" => Value::Integer(element.parse("value", value::integer)?),
            "boolean" => Value::Boolean(element.parse("value", value::boolean)?),
            "string" => Value::String(element.require("value")?.text),
            "rgb" => Value::Color(element.parse("value", value::colour)?),
            "srgb" => {
                let encoded = element.parse("value", value::colour)?;
                Value::Color(encoded.map(srgb_to_linear))
            }
            "spectrum" => Value::Color(self.spectrum(&mut element, source, owner)?),
            "blackbody" => Value::Color(blackbody(&mut element)?),
            "point" => Value::Point(element.coordinates(0.0, value::triple)?),
            "vector" => Value::Vector(element.coordinates(0.0, value::triple)?),
            _ => {
                element.finish()?;
                Value::Transform(self.transform(&element, xml, source)?)
            }
        };
        let location = element.location.clone();
        if tag != "transform" {
            self.leaf(element, xml, source)?;
        }
        let twice = self.nodes[owner].properties.contains_key(&key);
        if source.version.get() < (3, 0) && twice {
            // As in Mitsuba 2; Mitsuba 3 refuses it.
            let message = format!("{}: given twice; the last one counts", quoted(&key));
            self.warn(name.location.clone(), message);
            self.nodes[owner].names.remove(&key);
        }
        self.reserve(owner, &key, &name.location)?;
        let property = Property {
            value,
            tag,
            text,
            location,
            directories: source.directories(),
            used: AtomicBool::new(false),
        };
        self.nodes[owner].properties.insert(key, property);
        Ok(())
    }

    /// Says that something stands in for what was asked for.
    fn warn(&mut self, location: Location, message: String) {
        self.warnings.push((location, Notice::Replaced, message));
    }

    fn warn_of_length(&mut self, rotation: &Element, axis: [f64; 3]) {
        let length = axis.iter().map(|x| x * x).sum::<f64>().sqrt();
        if (length - 1.0).abs() > 1e-3 {
            let message = format!(
                "<rotate>: an axis of length {length:.4}, where only its direction counts; Mitsuba 3 shears and scales then"
            );
            let location = rotation.location.clone();
            self.warn(location, message);
        }
    }

    fn transform(
        &mut self,
        owner: &Element,
        xml: xml::Node,
        source: &Source,
    ) -> Result<Transform, SceneError> {
        let mut total = Transform::IDENTITY;
        for child in source.elements(xml) {
            let child = child?;
            let mut element = self.element(child, source)?;
            element.key = format!("{}.{}", owner.key, element.tag);
            let operation = match element.tag.as_str() {
                "translate" => Transform::translate(element.coordinates(0.0, value::triple)?),
                "scale" => Transform::scale(element.coordinates(1.0, value::triple_or_uniform)?),
                "rotate" => {
                    let axis = element.coordinates(0.0, value::triple)?;
                    let angle = element.parse("angle", value::float)?;
                    self.warn_of_length(&element, axis);
                    Transform::rotate(axis, angle)
                        .ok_or_else(|| element.value_error("an axis", "the zero vector"))?
                }
                "lookat" | "lookAt" => {
                    let origin = element.parse("origin", value::triple)?;
                    let target = element.parse("target", value::triple)?;
                    let up = if element.has("up") {
                        element.parse("up", value::triple)?
                    } else {
                        any_perpendicular(origin, target)
                    };
                    Transform::look_at(origin, target, up).ok_or_else(|| {
                        let expected = "a target away from the origin and not along `up`";
                        element.value_error(expected, "no view direction")
                    })?
                }
                "matrix" => element.parse("value", value::matrix)?,
                _ => {
                    let expected = format!("one of {}", OPERATIONS.join(", "));
                    return Err(element.syntax(&expected));
                }
            };
            self.leaf(element, child, source)?;
            total = total.then(&operation);
        }
        let limit = f64::from(f32::MAX);
        let representable = total
            .matrix()
            .as_flattened()
            .iter()
            .all(|x| x.abs() <= limit);
        if !representable || total.inverse().is_none() {
            let expected = "an invertible transform with finite entries";
            return Err(owner.value_error(expected, "one that is singular or overflows"));
        }
        Ok(total)
    }

    /// `<include>`: the content of a `<scene>`, or a single plugin, takes the place of the element.
    fn include(
        &mut self,
        file: &Attribute,
        source: &Source,
        owner: usize,
        depth: usize,
    ) -> Result<(), SceneError> {
        let path = self.find_file(file, "include", source)?;
        let identity = source::canonical(&path);
        if self.open.contains(&identity) {
            return Err(SceneError::Cycle {
                location: file.location.clone(),
                what: format!("the file {}", quoted(&file.text)),
            });
        }
        self.included += 1;
        check_limit(
            self.included,
            MAX_INCLUDES,
            "included files",
            &file.location,
        )?;
        let text = source::read(&path)?;
        self.bytes += text.len();
        check_limit(self.bytes, MAX_TEXT, "bytes of scene files", &file.location)?;
        let directory = path.parent().unwrap_or(Path::new(""));
        let directories = Directories::new(directory, Some(&source.directories()));
        let inner = Source::new(&path, directories, &text);
        inner.version.set(source.version.get());
        let tree = inner.parse(&text)?;
        let root = tree.root_element();
        self.open.push(identity);
        let read = if root.has_tag_name("scene") {
            let id = (self.element(root, &inner)).and_then(|scene| scene_id(scene, &inner));
            id.and_then(|_| self.body(root, &inner, owner, depth + 1))
        } else {
            self.member(root, &inner, owner, depth + 1)
        };
        self.open.pop();
        read
    }

    /// `<default>`: the first one wins, and a definition from outside comes before all.
    fn declare(&mut self, name: Attribute, value: Attribute) -> Result<(), SceneError> {
        if name.text.is_empty() {
            return Err(SceneError::Value {
                location: name.location,
                key: "default.name".to_owned(),
                expected: "a name".to_owned(),
                found: quoted(""),
            });
        }
        let value = value.text;
        self.parameters
            .entry(name.text)
            .or_insert(Parameter { value, known: true })
            .known = true;
        Ok(())
    }

    fn add(
        &mut self,
        tag: String,
        plugin: String,
        id: Option<String>,
        location: Location,
        at_root: bool,
    ) -> Result<usize, SceneError> {
        let index = self.nodes.len();
        if let Some(id) = &id {
            self.add_id(id, index, &location)?;
        }
        self.nodes.push(RawNode {
            at_root,
            ..RawNode::new(tag, plugin, id, location)
        });
        Ok(index)
    }

    fn add_id(&mut self, id: &str, node: usize, location: &Location) -> Result<(), SceneError> {
        match self.ids.get(id) {
            None => {
                self.ids.insert(id.to_owned(), (node, location.clone()));
                Ok(())
            }
            Some((_, first)) => Err(SceneError::Duplicate {
                location: location.clone(),
                what: format!("id {}", quoted(id)),
                first: first.clone(),
            }),
        }
    }

    /// In the order of the file, so an alias of an alias works.
    fn add_aliases(&mut self) -> Result<(), SceneError> {
        for (id, alias, location) in std::mem::take(&mut self.aliases) {
            let node = self.find(&id, &location)?;
            self.add_id(&alias, node, &location)?;
        }
        Ok(())
    }

    /// The node with this id.
    pub fn find(&self, id: &str, location: &Location) -> Result<usize, SceneError> {
        self.ids
            .get(id)
            .map(|(node, _)| *node)
            .ok_or_else(|| SceneError::UnknownReference {
                location: location.clone(),
                id: id.to_owned(),
                known: self.ids.keys().cloned().collect(),
            })
    }

    fn child(
        &mut self,
        owner: usize,
        name: Option<Attribute>,
        location: Location,
        target: Target,
    ) -> Result<(), SceneError> {
        let name = name.map(|n| value::snake_case(&n.text));
        if let Some(name) = &name {
            self.reserve(owner, name, &location)?;
        }
        self.nodes[owner].children.push(RawChild {
            name,
            location,
            target,
        });
        Ok(())
    }

    fn reserve(&mut self, owner: usize, name: &str, at: &Location) -> Result<(), SceneError> {
        let names = &mut self.nodes[owner].names;
        match names.insert(name.to_owned(), at.clone()) {
            None => Ok(()),
            Some(first) => Err(SceneError::Duplicate {
                location: at.clone(),
                what: format!("attribute {}", quoted(name)),
                first,
            }),
        }
    }

    /// An element with its attributes after substitution.
    fn element(&mut self, xml: xml::Node, source: &Source) -> Result<Element, SceneError> {
        let location = source.at(xml.range().start);
        self.elements += 1;
        check_limit(self.elements, MAX_ELEMENTS, "elements", &location)?;
        let mut attributes = Vec::new();
        for attribute in xml.attributes() {
            let location = source.at(attribute.range().start);
            attributes.push(Attribute {
                name: attribute.name().to_owned(),
                text: self.substitute(attribute.value(), &location)?,
                location,
            });
        }
        let tag = xml.tag_name().name().to_owned();
        Ok(Element {
            key: tag.clone(),
            tag,
            location,
            attributes,
            asked: Vec::new(),
        })
    }

    /// Replaces each `$name`: the longest known name that does not end inside a word.
    fn substitute(&mut self, text: &str, location: &Location) -> Result<String, SceneError> {
        let mut out = String::new();
        let mut rest = text;
        while let Some(dollar) = rest.find('$') {
            out.push_str(&rest[..dollar]);
            let tail = &rest[dollar + 1..];
            let word = |c: char| c.is_alphanumeric() || c == '_';
            let Some((length, parameter)) = longest_known(&mut self.parameters, tail, word) else {
                let end = tail.find(|c| !word(c)).unwrap_or(tail.len());
                return Err(SceneError::UndefinedParameter {
                    location: location.clone(),
                    name: format!("${}", &tail[..end]),
                    known: self.known_parameters("$"),
                });
            };
            parameter.known = true;
            // Without a bound, a chain of defaults that each double the last one fills the memory.
            self.substituted += parameter.value.len();
            let what = "bytes of substituted text";
            check_limit(self.substituted, MAX_SUBSTITUTED, what, location)?;
            out.push_str(&parameter.value);
            rest = &tail[length..];
        }
        out.push_str(rest);
        Ok(out)
    }

    /// An element that must be empty and have no further attributes.
    fn leaf(&self, element: Element, xml: xml::Node, source: &Source) -> Result<(), SceneError> {
        element.finish()?;
        match source.elements(xml).next() {
            None => Ok(()),
            Some(child) => {
                let child = child?;
                Err(SceneError::Syntax {
                    location: source.at(child.range().start),
                    expected: format!("nothing inside {}", element.name()),
                    found: format!("<{}>", child.tag_name().name()),
                })
            }
        }
    }
}

/// The longest name that `text` starts with and that does not end inside a word: its length, and what it stands for.
fn longest_known<'a>(
    known: &'a mut BTreeMap<String, Parameter>,
    text: &str,
    word: impl Fn(char) -> bool,
) -> Option<(usize, &'a mut Parameter)> {
    // All names that `text` starts with come before it in the order of the map, the longest last.
    let mut bound = text;
    let mut bounds = Bound::Included(text);
    let length = loop {
        let (name, _) = known
            .range::<str, _>((Bound::Unbounded, bounds))
            .next_back()?;
        let same = name.chars().zip(bound.chars()).take_while(|(a, b)| a == b);
        let same = same.map(|(c, _)| c.len_utf8()).sum();
        if same == name.len() {
            if !text[same..].starts_with(&word) {
                break same;
            }
            bound = &text[..same];
            bounds = Bound::Excluded(bound);
        } else {
            bound = &text[..same];
            bounds = Bound::Included(bound);
        }
    };
    known.get_mut(&text[..length]).map(|p| (length, p))
}

/// Some direction across the view, where roll does not matter.
fn any_perpendicular(origin: [f64; 3], target: [f64; 3]) -> [f64; 3] {
    let along = [0, 1, 2].map(|i| (target[i] - origin[i]).abs());
    let least = if along[1] <= along[0] && along[1] <= along[2] {
        1
    } else if along[0] <= along[2] {
        0
    } else {
        2
    };
    [0, 1, 2].map(|i| if i == least { 1.0 } else { 0.0 })
}

/// `<blackbody temperature="5000K" scale="1"/>` of the format's first versions.
fn blackbody(element: &mut Element) -> Result<[f64; 3], SceneError> {
    let kelvin = |text: &str| {
        let number = text.trim().trim_end_matches(['k', 'K']);
        let expected = "a temperature in kelvin, of at most a million";
        match value::float(number) {
            Ok(t) if t > 0.0 && t <= 1e6 => Ok(t),
            _ => Err(value::mismatch(expected, text)),
        }
    };
    let temperature = element.parse("temperature", kelvin)?;
    let scale = if element.has("scale") {
        element.parse("scale", value::float)?
    } else {
        1.0
    };
    Ok(spectrum::blackbody(temperature).map(|x| scale * x))
}

/// What a spectrum means for the plugin that it belongs to.
fn role(owner: &RawNode, key: &str) -> Role {
    match owner.tag.as_str() {
        "emitter" => Role::Emission,
        "bsdf" if key.contains("reflectance") || key.contains("transmittance") => Role::Reflectance,
        _ => Role::Other,
    }
}

/// The attributes of `<scene>`: its id, if any. The version must be known because the format changed meaning between
/// them, silently in places.
fn scene_id(mut element: Element, source: &Source) -> Result<Option<String>, SceneError> {
    let version = element.require("version")?;
    source.version.set(known_version(&version)?);
    let id = element.take("id").map(|a| a.text);
    element.finish()?;
    Ok(id)
}

fn known_version(version: &Attribute) -> Result<Version, SceneError> {
    let mut numbers = version.text.trim().split('.').map(str::parse::<u32>);
    let major = numbers.next().and_then(Result::ok);
    let minor = numbers.next().unwrap_or(Ok(0)).ok();
    match (major, minor) {
        (Some(0), Some(minor @ 4..=6)) => Ok((0, minor)),
        (Some(major @ 2..=3), Some(minor)) => Ok((major, minor)),
        _ => Err(SceneError::Value {
            location: version.location.clone(),
            key: "version".to_owned(),
            expected: "0.4 to 0.6, 2.x.x or 3.x.x".to_owned(),
            found: quoted(&version.text),
        }),
    }
}
