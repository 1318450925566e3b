//! Scene files in the XML format of Mitsuba, versions 0.4 to 3: from text to a tree of typed, resolved
//! plugins.
//!
//! This layer knows the format, not the plugins. It substitutes `$name`, splices `<include>`,
//! follows `<ref>` and `<path>`, converts `toWorld` to `to_world`, takes spectra to RGB and parses every value. What a `bsdf` of type
//! `diffuse` may contain is decided by its constructor, which asks its [`Node`] for it.
//!
//! ```
//! use render::plugin::xml::Document;
//! let text = r#"<scene version="3.0.0">
//!     <default name="albedo" value="0.5"/>
//!     <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="$albedo"/></bsdf>
//!     <shape type="sphere"><ref id="grey"/></shape>
//! </scene>"#;
//! let defines = [("albedo".to_owned(), "0.2, 0.3, 0.4".to_owned())];
//! let document = Document::from_str(text, std::path::Path::new("."), &defines)?;
//! let shape = document.root().children_with_tag("shape")[0];
//! let bsdf = shape.child_with_tag("bsdf")?.unwrap();
//! assert_eq!(bsdf.rgb("reflectance")?, Some([0.2, 0.3, 0.4]));
//! bsdf.finish()?;
//! # Ok::<(), render::error::SceneError>(())
//! ```

mod directories;
mod element;
mod node;
mod observer;
mod parse;
mod raw;
mod resolve;
mod source;
mod spectrum;
mod upgrade;
mod value;
mod write;

use std::collections::HashSet;
use std::fmt;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

pub use crate::error::Location;
use crate::error::SceneError;
use directories::Directories;
pub use node::Node;
pub(crate) use node::{ANYTHING, Kind};
use parse::Parser;
pub(crate) use spectrum::PLUGINS as SPECTRA;
pub(crate) use upgrade::old_attributes;
pub(crate) use write::{Content, Rewrite, scene as written};

/// Deepest nesting of elements, includes and references together: far above any real scene, far
/// below any stack.
const MAX_DEPTH: usize = 64;
/// Most elements, counting an included or referenced element once per use.
const MAX_ELEMENTS: usize = 1 << 20;
/// Most bytes of text that substitution of `$name` may produce.
const MAX_SUBSTITUTED: usize = 1 << 26;

/// Most bytes of text in a scene file and all that it includes, counted once per use.
const MAX_TEXT: usize = 1 << 28;
/// Most files that are included, counted once per use: of files that each include another twice, few make many.
const MAX_INCLUDES: usize = 1 << 17;
/// Most attributes of an element: far more than any has.
const MAX_ATTRIBUTES: usize = 64;
/// Most folders that a file names for others to be looked up in: each name is looked up in all of them.
const MAX_PATHS: usize = 64;
/// Most declarations of namespaces, which mean nothing here.
const MAX_NAMESPACES: usize = 64;

/// A scene file with everything it includes.
#[derive(Debug)]
pub struct Document {
    root: Arc<Node>,
    warnings: Warnings,
}

impl Document {
    /// Reads `path` and all files that it includes. `defines` are `name = value` pairs that take
    /// precedence over the `<default>` of the same name (the last pair wins); one that the scene
    /// does not know is an error.
    pub fn load(path: &Path, defines: &[(String, String)]) -> Result<Self, SceneError> {
        let mut parser = Parser::new(defines);
        parser.file(path)?;
        Ok(Self::resolve(parser, path)?.0)
    }

    /// The same, which goes on without elements that are wrong or left out on purpose, and what it found of these.
    pub(crate) fn load_to_its_end(
        path: &Path,
        defines: &[(String, String)],
    ) -> Result<(Self, Vec<Fault>), SceneError> {
        let mut parser = Parser::new(defines);
        parser.faults = Some(Vec::new());
        parser.file(path)?;
        Self::resolve(parser, path)
    }

    /// Parses `text` as a scene file that lies in `base_dir`.
    pub fn from_str(
        text: &str,
        base_dir: &Path,
        defines: &[(String, String)],
    ) -> Result<Self, SceneError> {
        let name = Path::new("<text>");
        let mut parser = Parser::new(defines);
        parser.text(text, name, base_dir)?;
        Ok(Self::resolve(parser, name)?.0)
    }

    /// The `<scene>`.
    pub fn root(&self) -> &Node {
        &self.root
    }

    /// The same, to be kept.
    pub(crate) fn shared_root(&self) -> Arc<Node> {
        self.root.clone()
    }

    /// What was accepted but has no effect, in the order in which it was noticed. Plugin
    /// constructors add to this.
    pub fn warnings(&self) -> Vec<Warning> {
        // A shared node may be read once per use, and warn each time.
        let mut seen = HashSet::new();
        let all = self.warnings.lock();
        all.iter().filter(|w| seen.insert(*w)).cloned().collect()
    }

    fn resolve(mut parser: Parser, file: &Path) -> Result<(Self, Vec<Fault>), SceneError> {
        if let Err(e) = parser.check_defines(file) {
            parser.note(e, None)?;
        }
        let warnings = Warnings::default();
        for (location, notice, message) in std::mem::take(&mut parser.warnings) {
            warnings.push(location, notice, message);
        }
        let (root, faults) = resolve::resolve(parser, &warnings)?;
        Ok((Self { root, warnings }, faults))
    }
}

/// What is wrong with an element, and which plugin it is part of.
#[derive(Debug)]
pub(crate) struct Fault {
    pub error: SceneError,
    /// Where that begins; none where it is complete without the element.
    pub owner: Option<Location>,
}

/// What a warning is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Notice {
    /// Something has no effect.
    Ignored,
    /// Something else stands in for what was asked for.
    Replaced,
    /// The same for a file that is not there.
    Absent,
}

/// Something in a scene file that has no effect, or another one than was asked for.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Warning {
    /// The line.
    pub location: Location,
    /// Which of both.
    pub notice: Notice,
    /// What it is.
    pub message: String,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.location, self.message)
    }
}

/// The warnings of a document, shared by all its nodes.
#[derive(Debug, Clone, Default)]
struct Warnings(Arc<Mutex<Vec<Warning>>>);

impl Warnings {
    fn push(&self, location: Location, notice: Notice, message: String) {
        self.lock().push(Warning {
            location,
            notice,
            message,
        });
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<Warning>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

pub(crate) fn check_limit(
    value: usize,
    limit: usize,
    what: &'static str,
    location: &Location,
) -> Result<(), SceneError> {
    if value <= limit {
        return Ok(());
    }
    let location = location.clone();
    Err(SceneError::Limit {
        location,
        what,
        limit,
    })
}
