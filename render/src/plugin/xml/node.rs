//! The resolved tree: one node per plugin, its properties typed and its references replaced by
//! their targets.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::spectrum::{self, Role, Samples};
use super::value::{self, Value};
use super::{Directories, Notice, Warnings};
use crate::error::{Location, SceneError, quoted};
use crate::math::{Rgb, Transform};
use crate::plugin::refused;

/// One plugin of the scene file, such as `<bsdf type="diffuse" id="white">`.
///
/// The constructor of a plugin asks for what it understands and then calls
/// [`finish`](Self::finish), which rejects what is left over. All getters return `Ok(None)` for an
/// absent attribute and an error for one of the wrong type.
#[derive(Debug)]
pub struct Node {
    /// The kind: `scene`, `bsdf`, `shape`, `emitter`, `sensor`, `film`, `rfilter`, `sampler`,
    /// `integrator`, `texture`. A `<spectrum>` that has a `type` is a `texture`.
    pub tag: String,
    /// The `type`, such as `diffuse`; "scene" for the root.
    pub plugin: String,
    /// The `id`, if there is one: unique in the scene.
    pub id: Option<String>,
    /// The line that opens the element, in the file that contains it.
    pub location: Location,
    pub(super) properties: BTreeMap<String, Property>,
    pub(super) children: Vec<Child>,
    pub(super) asked: Mutex<BTreeMap<String, BTreeSet<Kind>>>,
    pub(super) warnings: Warnings,
}

/// What a plugin notes that it asks for, where anything may stand in it.
pub(crate) const ANYTHING: &str = "*";

/// What an attribute or a child is asked for as.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Kind {
    Number,
    Integer,
    Boolean,
    Text,
    Colour,
    Point,
    Vector,
    Transform,
    /// A nested plugin.
    Child,
    /// Anything that is there.
    Either,
}

impl Kind {
    /// What an error says that was expected.
    fn expected(self) -> &'static str {
        match self {
            Self::Number => "a number (<float>)",
            Self::Integer => "an integer (<integer>)",
            Self::Boolean => "true or false (<boolean>)",
            Self::Text => "a text (<string>)",
            Self::Colour => "a colour (<rgb>)",
            Self::Point => "a point (<point>)",
            Self::Vector => "a vector (<vector>)",
            Self::Transform => "a <transform>",
            Self::Child => "a nested plugin",
            Self::Either => "an attribute or a nested plugin",
        }
    }
}

/// `<float name=.. value=..>` and its kin.
#[derive(Debug)]
pub(super) struct Property {
    pub value: Value,
    /// The element, such as `float`.
    pub tag: &'static str,
    /// The text of the value, for messages.
    pub text: String,
    pub location: Location,
    /// Where file names are looked up.
    pub directories: Directories,
    pub used: AtomicBool,
}

/// A nested plugin, or a reference to one.
#[derive(Debug)]
pub(super) struct Child {
    pub name: Option<String>,
    pub node: Arc<Node>,
    pub location: Location,
    pub used: AtomicBool,
}

impl Property {
    /// One that no file gives.
    pub fn made(tag: &'static str, text: &str, value: Value, location: &Location) -> Self {
        Self {
            value,
            tag,
            text: text.to_owned(),
            location: location.clone(),
            directories: Directories::new(Path::new(""), None),
            used: AtomicBool::new(false),
        }
    }

    /// The same, not asked for yet.
    fn fresh(&self) -> Self {
        Self {
            value: self.value.clone(),
            tag: self.tag,
            text: self.text.clone(),
            location: self.location.clone(),
            directories: self.directories.clone(),
            used: AtomicBool::new(false),
        }
    }

    /// As errors name it: `<float>` and its value.
    fn describe(&self) -> String {
        match self.value {
            Value::Transform(_) => "a <transform>".to_owned(),
            Value::Point([x, y, z]) | Value::Vector([x, y, z]) if self.text.is_empty() => {
                format!("<{}> `{x}, {y}, {z}`", self.tag)
            }
            _ => format!("<{}> {}", self.tag, quoted(&self.text)),
        }
    }
}

impl Node {
    /// `<float>` or `<integer>`: finite, also in single precision.
    pub fn float(&self, name: &str) -> Result<Option<f64>, SceneError> {
        self.get(name, Kind::Number, |value| match *value {
            Value::Float(x) => Some(x),
            Value::Integer(i) => Some(i as f64),
            _ => None,
        })
    }

    /// [`float`](Self::float), or `default` if absent.
    pub fn float_or(&self, name: &str, default: f64) -> Result<f64, SceneError> {
        Ok(self.float(name)?.unwrap_or(default))
    }

    /// [`float_or`](Self::float_or) with both ends of the allowed range.
    pub fn float_in(
        &self,
        name: &str,
        default: f64,
        range: RangeInclusive<f64>,
    ) -> Result<f64, SceneError> {
        let x = self.float_or(name, default)?;
        if range.contains(&x) {
            return Ok(x);
        }
        let (low, high) = (range.start(), range.end());
        Err(self.invalid(name, &format!("a number from {low} to {high}")))
    }

    /// `<integer>`.
    pub fn integer(&self, name: &str) -> Result<Option<i64>, SceneError> {
        self.get(name, Kind::Integer, |value| match *value {
            Value::Integer(i) => Some(i),
            _ => None,
        })
    }

    /// [`integer`](Self::integer), or `default` if absent.
    pub fn integer_or(&self, name: &str, default: i64) -> Result<i64, SceneError> {
        Ok(self.integer(name)?.unwrap_or(default))
    }

    /// [`integer_or`](Self::integer_or) with both ends of the allowed range.
    pub fn integer_in(
        &self,
        name: &str,
        default: i64,
        range: RangeInclusive<i64>,
    ) -> Result<i64, SceneError> {
        let i = self.integer_or(name, default)?;
        if range.contains(&i) {
            return Ok(i);
        }
        let (low, high) = (range.start(), range.end());
        Err(self.invalid(name, &format!("an integer from {low} to {high}")))
    }

    /// `<boolean>`.
    pub fn boolean(&self, name: &str) -> Result<Option<bool>, SceneError> {
        self.get(name, Kind::Boolean, |value| match *value {
            Value::Boolean(b) => Some(b),
            _ => None,
        })
    }

    /// [`boolean`](Self::boolean), or `default` if absent.
    pub fn boolean_or(&self, name: &str, default: bool) -> Result<bool, SceneError> {
        Ok(self.boolean(name)?.unwrap_or(default))
    }

    /// `<string>`.
    pub fn string(&self, name: &str) -> Result<Option<&str>, SceneError> {
        self.get(name, Kind::Text, |value| match value {
            Value::String(s) => Some(s.as_str()),
            _ => None,
        })
    }

    /// [`string`](Self::string), or `default` if absent.
    pub fn string_or<'a>(&'a self, name: &str, default: &'a str) -> Result<&'a str, SceneError> {
        Ok(self.string(name)?.unwrap_or(default))
    }

    /// `<string>` that is one of a few words; the value that belongs to the word.
    pub fn choice<T: Copy>(
        &self,
        name: &str,
        choices: &[(&str, T)],
    ) -> Result<Option<T>, SceneError> {
        let Some(text) = self.string(name)? else {
            return Ok(None);
        };
        if let Some((_, value)) = choices.iter().find(|(word, _)| *word == text) {
            return Ok(Some(*value));
        }
        let words: Vec<_> = choices
            .iter()
            .map(|(word, _)| format!("`{word}`"))
            .collect();
        Err(self.invalid(name, &words.join(" or ")))
    }

    /// Linear RGB: `<rgb>`, `<spectrum>` with one or three numbers, `<float>` or `<integer>` for a
    /// grey.
    ///
    /// A texture of this name is an error, unless it is a spectrum that [is constant](Self::is_constant): a plugin that
    /// accepts others asks for the [`child`](Self::child) first.
    pub fn rgb(&self, name: &str) -> Result<Option<[f64; 3]>, SceneError> {
        if let Some(child) = self.child_quietly(name)
            && child.node.is_constant()
        {
            self.note(name.to_owned(), Kind::Colour);
            let emits = self.tag == "emitter";
            return child.take().constant_colour(emits).map(Some);
        }
        self.get(name, Kind::Colour, |value| match *value {
            Value::Color(c) => Some(c),
            Value::Float(x) => Some([x; 3]),
            Value::Integer(i) => Some([i as f64; 3]),
            _ => None,
        })
    }

    /// `<float>` or `<integer>`, or the luminance of a colour where one stands in its place, as in Mitsuba.
    pub fn grey(&self, name: &str) -> Result<Option<f64>, SceneError> {
        self.note(name.to_owned(), Kind::Colour);
        let colour = match self.properties.get(name) {
            Some(property) => matches!(property.value, Value::Color(_)),
            None => (self.child_quietly(name)).is_some_and(|c| c.node.is_constant()),
        };
        if !colour {
            return self.float(name);
        }
        let luminance = |[r, g, b]: [f64; 3]| {
            // Exactly, where it is grey.
            if r == g && g == b {
                r
            } else {
                Rgb::new(r, g, b).luminance()
            }
        };
        Ok(self.rgb(name)?.map(luminance))
    }

    /// Whether this is a spectrum that is the same everywhere: `uniform`, `d65`, `srgb`, `rawconstant`, `blackbody`, `regular`
    /// or `irregular`. [`rgb`](Self::rgb) of its owner is its colour.
    pub fn is_constant(&self) -> bool {
        self.tag == "texture" && spectrum::PLUGINS.contains(&self.plugin.as_str())
    }

    /// The colour of a constant spectrum, which an emitter has, or something that it lights.
    fn constant_colour(&self, emits: bool) -> Result<[f64; 3], SceneError> {
        let role = if emits { Role::Emission } else { Role::Other };
        let colour = match self.plugin.as_str() {
            // One number at all wavelengths is one in all channels, for light too: what is flat as a list is not.
            "uniform" => [self.float_or("value", 1.0)?; 3],
            // As it is, whatever it is for.
            "rawconstant" => {
                let colour = self.rgb("value")?;
                colour.ok_or_else(|| self.missing("value", "a colour (<rgb>)"))?
            }
            "srgb" => {
                let colour = self.rgb("color")?;
                colour.ok_or_else(|| self.missing("color", "a colour (<rgb>)"))?
            }
            "d65" => {
                let scale = self.float_or("scale", 1.0)?;
                self.rgb_or("color", [1.0; 3])?.map(|x| scale * x)
            }
            "blackbody" => {
                let temperature = self.float("temperature")?;
                let expected = "a number of kelvin, of at most a million";
                let temperature =
                    temperature.ok_or_else(|| self.missing("temperature", expected))?;
                if !(temperature > 0.0 && temperature <= 1e6) {
                    return Err(self.invalid("temperature", expected));
                }
                spectrum::blackbody(temperature)
            }
            _ => {
                let (samples, cut) = spectrum::rgb(&self.samples()?, role);
                if cut {
                    self.warn(format!(
                        "its colour is one that RGB cannot show; the nearest is {samples:?}"
                    ));
                }
                samples
            }
        };
        self.finish()?;
        Ok(colour)
    }

    /// The values of `regular`, at wavelengths of equal distance, and of `irregular`.
    fn samples(&self) -> Result<Samples, SceneError> {
        let list = |name: &str| -> Result<Vec<f64>, SceneError> {
            let text = self.string(name)?;
            let text = text.ok_or_else(|| self.missing(name, "a list of numbers (<string>)"))?;
            value::list(text).map_err(|_| self.invalid(name, "a list of numbers"))
        };
        let values = list("values")?;
        let wavelengths = if self.plugin == "irregular" {
            list("wavelengths")?
        } else {
            let end = |name: &str, default| self.float_or(name, default);
            let (low, high) = (end("wavelength_min", 360.0)?, end("wavelength_max", 830.0)?);
            let last = values.len().saturating_sub(1).max(1) as f64;
            (0..values.len())
                .map(|i| low + (high - low) * i as f64 / last)
                .collect()
        };
        let expected = "at least two numbers, one for each of increasing wavelengths";
        if wavelengths.len() != values.len() {
            return Err(self.invalid("values", expected));
        }
        let pairs = wavelengths.into_iter().zip(values).map(<[f64; 2]>::from);
        Samples::new(pairs.collect()).ok_or_else(|| self.invalid("values", expected))
    }

    /// [`rgb`](Self::rgb), or `default` if absent.
    pub fn rgb_or(&self, name: &str, default: [f64; 3]) -> Result<[f64; 3], SceneError> {
        Ok(self.rgb(name)?.unwrap_or(default))
    }

    /// `<point>`.
    pub fn point(&self, name: &str) -> Result<Option<[f64; 3]>, SceneError> {
        self.get(name, Kind::Point, |value| match *value {
            Value::Point(p) => Some(p),
            _ => None,
        })
    }

    /// `<vector>`.
    pub fn vector(&self, name: &str) -> Result<Option<[f64; 3]>, SceneError> {
        self.get(name, Kind::Vector, |value| match *value {
            Value::Vector(v) => Some(v),
            _ => None,
        })
    }

    /// `<transform>`: invertible, with all entries finite in single precision.
    pub fn transform(&self, name: &str) -> Result<Option<Transform>, SceneError> {
        self.get(name, Kind::Transform, |value| match *value {
            Value::Transform(t) => Some(t),
            _ => None,
        })
    }

    /// `<string>` that names an existing file: relative to the file that contains it, or else to
    /// the files that include that one. With a warning also one whose name has other capitals, or backslashes.
    pub fn path(&self, name: &str) -> Result<Option<PathBuf>, SceneError> {
        let Some(text) = self.string(name)? else {
            return Ok(None);
        };
        let property = &self.properties[name];
        match property.directories.find(Path::new(text)) {
            Some(path) => {
                if let Some(what) = property.directories.substitution(text, &path) {
                    let message = format!("{}: {}: {what}", self.describe(), quoted(name));
                    (self.warnings).push(property.location.clone(), Notice::Replaced, message);
                }
                Ok(Some(path))
            }
            None => Err(SceneError::NoFile {
                location: property.location.clone(),
                key: name.to_owned(),
                folders: property.directories.to_string(),
                name: text.to_owned(),
            }),
        }
    }

    /// The nested or referenced plugin with this `name`. A shared id gives the same `Arc`
    /// everywhere.
    pub fn child(&self, name: &str) -> Option<&Arc<Node>> {
        self.note(name.to_owned(), Kind::Child);
        self.child_quietly(name).map(Child::take)
    }

    /// All nested or referenced plugins with their `name`, in the order of the file.
    pub fn children(&self) -> impl Iterator<Item = (Option<&str>, &Arc<Node>)> {
        self.children
            .iter()
            .map(|child| (child.name.as_deref(), child.take()))
    }

    /// The same without their names; counts as asking for none.
    pub(crate) fn parts(&self) -> impl Iterator<Item = &Arc<Node>> {
        self.children.iter().map(|child| &child.node)
    }

    /// Where its attributes and its references to others stand; counts as asking for none.
    pub(crate) fn places(&self) -> impl Iterator<Item = &Location> {
        let references = self.children.iter().map(|c| (&c.location, &c.node));
        let references = references.filter(|(at, node)| **at != node.location);
        (self.properties.values().map(|p| &p.location)).chain(references.map(|(at, _)| at))
    }

    /// Where an attribute stands, or else the plugin.
    pub(crate) fn place(&self, name: &str) -> &Location {
        let child = || self.child_quietly(name).map(|c| &c.location);
        let own = self.properties.get(name).map(|p| &p.location);
        own.or_else(child).unwrap_or(&self.location)
    }

    /// Where the attribute stands that names this file, if one does; counts as asking for none.
    pub(crate) fn names_file(&self, file: &Path) -> Option<&Location> {
        let names = |p: &&Property| match &p.value {
            Value::String(name) => p.directories.find(Path::new(name)).as_deref() == Some(file),
            _ => false,
        };
        self.properties.values().find(names).map(|p| &p.location)
    }

    /// The same shape elsewhere, under another name: moved by a transform after its own.
    ///
    /// # Errors
    /// A `to_world` of another type, or a product that cannot be inverted.
    pub(crate) fn moved(&self, id: String, by: &Transform) -> Result<Node, SceneError> {
        let moved = self.transform("to_world")?.unwrap_or_default().then(by);
        if moved.inverse().is_none() || !moved.is_finite() {
            return Err(self.invalid("to_world", "an invertible transform in each instance"));
        }
        let mut properties: BTreeMap<String, Property> = (self.properties.iter())
            .map(|(name, p)| (name.clone(), p.fresh()))
            .collect();
        let own = properties.remove("to_world");
        let value = Value::Transform(moved);
        let to_world = match own {
            Some(own) => Property { value, ..own },
            None => Property::made("transform", "", value, &self.location),
        };
        properties.insert("to_world".to_owned(), to_world);
        Ok(Node {
            tag: self.tag.clone(),
            plugin: self.plugin.clone(),
            id: Some(id),
            location: self.location.clone(),
            properties,
            children: (self.children.iter())
                .map(|c| Child {
                    name: c.name.clone(),
                    node: c.node.clone(),
                    location: c.location.clone(),
                    used: AtomicBool::new(false),
                })
                .collect(),
            asked: Mutex::default(),
            warnings: self.warnings.clone(),
        })
    }

    /// Gives a boolean, false where there is none, the other value.
    ///
    /// # Errors
    /// A property of that name and another type.
    pub(crate) fn turn_over(&mut self, name: &str) -> Result<(), SceneError> {
        let value = Value::Boolean(!self.boolean_or(name, false)?);
        let used = AtomicBool::new(false);
        let turned = match self.properties.remove(name) {
            Some(own) => Property { value, used, ..own },
            None => Property::made("boolean", "", value, &self.location),
        };
        self.properties.insert(name.to_owned(), turned);
        Ok(())
    }

    /// All nested or referenced plugins of one kind, such as `bsdf`, in the order of the file.
    pub fn children_with_tag(&self, tag: &str) -> Vec<&Arc<Node>> {
        self.note(format!("<{tag}>"), Kind::Child);
        self.children
            .iter()
            .filter(|child| child.node.tag == tag)
            .map(Child::take)
            .collect()
    }

    /// The only plugin of one kind; more than one is an error.
    pub fn child_with_tag(&self, tag: &str) -> Result<Option<&Arc<Node>>, SceneError> {
        self.note(format!("<{tag}>"), Kind::Child);
        let mut matching = self.children.iter().filter(|c| c.node.tag == tag);
        let first = matching.next();
        match (first, matching.next()) {
            (Some(first), Some(second)) => Err(SceneError::Duplicate {
                location: second.location.clone(),
                what: format!("<{tag}> of {}", self.describe()),
                first: first.location.clone(),
            }),
            _ => Ok(first.map(Child::take)),
        }
    }

    /// Whether an attribute or child has this name; counts as asking for neither.
    pub fn has(&self, name: &str) -> bool {
        self.note(name.to_owned(), Kind::Either);
        self.properties.contains_key(name) || self.child_quietly(name).is_some()
    }

    /// Accepts attributes that cannot change the image, with a warning for each that is present. They are
    /// of the type that `read` reads.
    pub fn ignore<'a, T>(
        &'a self,
        names: &[&str],
        read: impl Fn(&'a Self, &str) -> Result<Option<T>, SceneError>,
    ) -> Result<(), SceneError> {
        for &name in names {
            if read(self, name)?.is_some() {
                self.warn_at(self.place(name), format!("`{name}` has no effect"));
            }
        }
        Ok(())
    }

    /// [`ignore`](Self::ignore) of a number, a colour or a texture.
    pub(crate) fn ignore_texture(&self, name: &str) -> Result<(), SceneError> {
        if self.child(name).is_none_or(|child| child.is_constant()) {
            return self.ignore(&[name], Self::grey);
        }
        self.warn_at(self.place(name), format!("`{name}` has no effect"));
        Ok(())
    }

    /// Accepts all attributes and children that were not asked for, with a warning for each: those of a plugin that another
    /// stands in for.
    pub fn ignore_rest(&self) {
        self.note(ANYTHING.to_owned(), Kind::Either);
        for (name, property) in &self.properties {
            if !property.used.swap(true, Ordering::Relaxed) {
                self.warn_at(&property.location, format!("`{name}` has no effect"));
            }
        }
        for child in &self.children {
            if !child.used.swap(true, Ordering::Relaxed) {
                let message = format!("{} has no effect", child.node.describe());
                self.warn_at(&child.location, message);
            }
        }
    }

    /// An error for the first attribute or child that was not asked for.
    ///
    /// At the root, elements with an id are declarations and need not be asked for.
    pub fn finish(&self) -> Result<(), SceneError> {
        let unused = |flag: &AtomicBool| !flag.load(Ordering::Relaxed);
        let known = || -> Vec<String> {
            (self.lock_asked().iter())
                .filter(|(_, kinds)| kinds.iter().any(|k| *k != Kind::Either))
                .map(|(name, _)| name.clone())
                .collect()
        };
        let unknown = |location: &Location, what: String| SceneError::Unknown {
            location: location.clone(),
            what,
            owner: self.describe(),
            known: known(),
        };
        let refused = |location: &Location, tag: &str, plugin: String, what| SceneError::Refused {
            location: location.clone(),
            tag: tag.to_owned(),
            plugin,
            what,
        };
        let properties =
            self.properties
                .iter()
                .filter(|(_, p)| unused(&p.used))
                .map(|(name, p)| {
                    let error = match refused::attribute(&self.tag, name) {
                        Some(what) => refused(
                            &p.location,
                            &self.tag,
                            format!("{} with {name}", self.plugin),
                            what,
                        ),
                        None => unknown(&p.location, format!("attribute {}", quoted(name))),
                    };
                    (p.location.line, error)
                });
        let declaration = |c: &Child| self.tag == "scene" && c.node.id.is_some();
        let children = self
            .children
            .iter()
            .filter(|&c| unused(&c.used) && !declaration(c))
            .map(|c| {
                let error = match refused::reason(&c.node.tag, &c.node.plugin) {
                    Some(what) => refused(&c.location, &c.node.tag, c.node.plugin.clone(), what),
                    None => {
                        let name = c.name.as_ref().map(|n| format!(" named {}", quoted(n)));
                        let name = name.unwrap_or_default();
                        unknown(&c.location, format!("child {}{name}", c.node.describe()))
                    }
                };
                (c.location.line, error)
            });
        match properties.chain(children).min_by_key(|(line, _)| *line) {
            None => Ok(()),
            Some((_, error)) => Err(error),
        }
    }

    /// The error for an attribute that is present but has a value that the plugin cannot accept.
    pub fn invalid(&self, name: &str, expected: &str) -> SceneError {
        let (location, found) = match self.properties.get(name) {
            Some(property) => (&property.location, property.describe()),
            None => match self.child_quietly(name) {
                Some(child) => (&child.location, child.node.describe()),
                None => (&self.location, "nothing".to_owned()),
            },
        };
        SceneError::Value {
            location: location.clone(),
            key: name.to_owned(),
            expected: expected.to_owned(),
            found,
        }
    }

    /// The error for an attribute that the plugin cannot do without.
    pub fn missing(&self, name: &str, expected: &str) -> SceneError {
        SceneError::Missing {
            location: self.location.clone(),
            owner: self.describe(),
            key: name.to_owned(),
            expected: expected.to_owned(),
        }
    }

    /// The error for a plugin that is known, and stands here for something that is left out: what that is, with its verb.
    pub fn refused(&self, what: &'static str) -> SceneError {
        SceneError::Refused {
            location: self.location.clone(),
            tag: self.tag.clone(),
            plugin: self.plugin.clone(),
            what,
        }
    }

    /// The error for a `type` without an implementation: what is left out on purpose, or the names that exist.
    pub fn unknown_plugin(&self, known: &[&str]) -> SceneError {
        if let Some(what) = refused::reason(&self.tag, &self.plugin) {
            return self.refused(what);
        }
        let mut known: Vec<String> = known.iter().map(|&name| name.to_owned()).collect();
        // Several implementations may share a name.
        known.dedup();
        SceneError::UnknownPlugin {
            location: self.location.clone(),
            tag: self.tag.clone(),
            plugin: self.plugin.clone(),
            known,
        }
    }

    /// Adds a warning about this plugin to those of the document: something stands in for what it asks for.
    pub fn warn(&self, message: impl Into<String>) {
        let message = format!("{}: {}", self.describe(), message.into());
        (self.warnings).push(self.location.clone(), Notice::Replaced, message);
    }

    /// Adds a warning that this plugin does nothing, and why.
    pub(crate) fn warn_of_no_effect(&self, why: &str) {
        self.warn_at(&self.location, format!("no effect: {why}"));
    }

    /// Adds a warning that something stands in for a file that is not there.
    pub(crate) fn warn_of_file(&self, error: &SceneError, instead: &str) {
        let location = error.location().unwrap_or(&self.location);
        let message = format!("{}; {instead}", error.message());
        (self.warnings).push(location.clone(), Notice::Absent, message);
    }

    /// "bsdf `diffuse`"
    pub fn describe(&self) -> String {
        match self.tag.as_str() {
            "scene" => "the scene".to_owned(),
            tag => format!("{tag} {}", quoted(&self.plugin)),
        }
    }

    /// A warning about what has no effect.
    fn warn_at(&self, location: &Location, message: String) {
        let message = format!("{}: {message}", self.describe());
        (self.warnings).push(location.clone(), Notice::Ignored, message);
    }

    fn get<'a, T>(
        &'a self,
        name: &str,
        kind: Kind,
        convert: impl FnOnce(&'a Value) -> Option<T>,
    ) -> Result<Option<T>, SceneError> {
        let expected = kind.expected();
        self.note(name.to_owned(), kind);
        let Some(property) = self.properties.get(name) else {
            return match self.child_quietly(name) {
                Some(_) => Err(self.invalid(name, expected)),
                None => Ok(None),
            };
        };
        property.used.store(true, Ordering::Relaxed);
        match convert(&property.value) {
            Some(value) => Ok(Some(value)),
            None => Err(self.invalid(name, expected)),
        }
    }

    fn child_quietly(&self, name: &str) -> Option<&Child> {
        self.children
            .iter()
            .find(|c| c.name.as_deref() == Some(name))
    }

    /// What has been asked for, and as what: attributes and children by their names, children of a kind as `<bsdf>`.
    pub(crate) fn asked(&self) -> BTreeMap<String, BTreeSet<Kind>> {
        self.lock_asked().clone()
    }

    fn note(&self, name: String, kind: Kind) {
        self.lock_asked().entry(name).or_default().insert(kind);
    }

    fn lock_asked(&self) -> std::sync::MutexGuard<'_, BTreeMap<String, BTreeSet<Kind>>> {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Child {
    fn take(&self) -> &Arc<Node> {
        self.used.store(true, Ordering::Relaxed);
        &self.node
    }
}
