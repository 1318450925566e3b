//! Errors of loaders and builders. Every message names the place (file and line, or the parameter's
//! key), what was expected there and what was found.
//!
//! ```
//! use render::{Scene, SceneError};
//!
//! let folder = tempfile::tempdir()?;
//! let file = folder.path().join("wide.xml");
//! let text = "<scene version='3.0.0'><sensor type='perspective'>
//!     <float name='fov' value='wide'/></sensor></scene>";
//! std::fs::write(&file, text)?;
//! let error = Scene::load(&file, &Default::default()).unwrap_err();
//! let message = error.to_string();
//! assert!(message.contains("wide.xml:2") && message.contains("`wide`"), "{message}");
//!
//! // A program can ask which one it is.
//! let missing = Scene::load("nowhere.xml".as_ref(), &Default::default());
//! assert!(matches!(missing, Err(SceneError::Io { path, .. }) if path.ends_with("nowhere.xml")));
//!
//! // Names that are not there come with those that are like them.
//! let room = render::scene::room(8, 8)?;
//! let unknown = room.params().find("sphere.alfa.value").unwrap_err().to_string();
//! assert!(unknown.contains("sphere.alpha.value"), "{unknown}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A line of a file, as `file:line`, and what of it is meant: elements of one line are at different locations.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Location {
    /// The file that holds the line, as it was named when it was opened.
    pub file: Arc<Path>,
    /// Line number, counted from one.
    pub line: u32,
    /// Where in the file that begins, in bytes; none for a whole line.
    byte: Option<usize>,
}

impl Location {
    /// Line `line` (from one) of `file`.
    pub fn new(file: impl Into<Arc<Path>>, line: u32) -> Self {
        Self {
            file: file.into(),
            line,
            byte: None,
        }
    }

    /// The same line, and what begins at this byte of the file.
    pub(crate) fn at_byte(self, byte: usize) -> Self {
        Self {
            byte: Some(byte),
            ..self
        }
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.file.display(), self.line)
    }
}

/// What went wrong while a scene was loaded or built.
///
/// ```
/// use render::{Scene, SceneError};
///
/// let text = r#"<scene version="3.0.0">
///     <sensor type="perspective"><float name="fov" value="40"/></sensor>
///     <shape type="sphare"/>
/// </scene>"#;
/// let error = Scene::from_xml(text, "".as_ref(), &Default::default()).unwrap_err();
/// assert_eq!(error.location().map(|l| l.line), Some(3));
/// assert!(error.message().contains("sphare"), "{error}"); // without the place, which `to_string` begins with
/// assert!(matches!(error, SceneError::UnknownPlugin { .. }));
/// ```
#[non_exhaustive]
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The operating system refused to read a file.
    #[error("{}: cannot read the file: {source}", Name(path))]
    Io {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: std::io::Error,
    },

    /// The operating system refused to write a file.
    #[error("{}: cannot write the file: {source}", Name(path))]
    Write {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: std::io::Error,
    },

    /// A mesh or image was read, but its content is not what was expected.
    #[error("{}{}: expected {expected}, found {}", Name(path), Line(*line), Sentence(found))]
    Asset {
        /// The file.
        path: PathBuf,
        /// The line, for text formats.
        line: Option<u32>,
        /// What the reader expected.
        expected: String,
        /// What the file contains.
        found: String,
    },

    /// A parameter given in code (not by a file) is out of range.
    #[error(
        "parameter {}: expected {expected}, found {}",
        quoted(key),
        Sentence(found)
    )]
    Parameter {
        /// The key of the parameter, such as `red.reflectance.value`.
        key: String,
        /// The values that are allowed.
        expected: String,
        /// The value that was given.
        found: String,
    },

    /// The text does not have the structure of a scene file: not XML, an unknown or misplaced
    /// element, stray text.
    #[error("{location}: expected {expected}, found {}", Sentence(found))]
    Syntax {
        /// The offending line.
        location: Location,
        /// What may stand there.
        expected: String,
        /// What stands there.
        found: String,
    },

    /// The value of an attribute has the wrong type or is out of range.
    #[error(
        "{location}: {}: expected {expected}, found {}",
        quoted(key),
        Sentence(found)
    )]
    Value {
        /// The line of the value.
        location: Location,
        /// The name of the attribute.
        key: String,
        /// The values that are allowed.
        expected: String,
        /// The value in the file.
        found: String,
    },

    /// A file that a scene names does not exist.
    #[error(
        "{location}: {}: expected an existing file (looked in {folders}), found {}",
        quoted(key),
        quoted(name)
    )]
    NoFile {
        /// The line that names it.
        location: Location,
        /// The name of the attribute.
        key: String,
        /// Where it was looked for.
        folders: String,
        /// Its name in the scene.
        name: String,
    },

    /// An attribute or child that a plugin needs is absent.
    #[error(
        "{location}: {} has no {}: expected {expected}, found nothing",
        Sentence(owner),
        quoted(key)
    )]
    Missing {
        /// The line of the plugin.
        location: Location,
        /// The plugin, such as "shape `obj`".
        owner: String,
        /// The name of the attribute.
        key: String,
        /// What should have been given.
        expected: String,
    },

    /// An attribute or child that the plugin never asked for.
    #[error(
        "{location}: unknown {} of {}; known: {}",
        Sentence(what),
        Sentence(owner),
        List(known)
    )]
    Unknown {
        /// The line of the attribute.
        location: Location,
        /// The attribute or child, such as "attribute `foo`".
        what: String,
        /// The plugin, such as "bsdf `diffuse`".
        owner: String,
        /// All names that the plugin asked for.
        known: Vec<String>,
    },

    /// No plugin has this name.
    #[error("{location}: unknown {tag} {}; known: {}", quoted(plugin), List(known))]
    UnknownPlugin {
        /// The line of the plugin.
        location: Location,
        /// The kind of plugin, such as `bsdf`.
        tag: String,
        /// The name in the file.
        plugin: String,
        /// The names that exist.
        known: Vec<String>,
    },

    /// A plugin or element that is known, and stands for something that is left out.
    #[error("{location}: {tag} {}: {what} not there", quoted(plugin))]
    Refused {
        /// The line of the plugin.
        location: Location,
        /// The kind of plugin, such as `bsdf`.
        tag: String,
        /// The name in the file.
        plugin: String,
        /// What it would need, with its verb: "polarisation is".
        what: &'static str,
    },

    /// A name that must be unique is given twice.
    #[error("{location}: {} is given twice, first at {first}", Sentence(what))]
    Duplicate {
        /// The second occurrence.
        location: Location,
        /// The name, such as "id `white`".
        what: String,
        /// The first occurrence.
        first: Location,
    },

    /// `$name` without a `<default>` above it and without a value from outside.
    #[error("{location}: {} is not defined; known: {}", quoted(name), List(known))]
    UndefinedParameter {
        /// The line that uses the name.
        location: Location,
        /// The name, with its dollar sign.
        name: String,
        /// The names that are defined.
        known: Vec<String>,
    },

    /// A value from outside (`-D name=value`) that the scene does not use.
    #[error(
        "{}: no parameter {} to define; known: {}",
        Name(file),
        quoted(name),
        List(known)
    )]
    UnusedDefine {
        /// The scene file.
        file: PathBuf,
        /// The name that was given.
        name: String,
        /// The names that the scene uses.
        known: Vec<String>,
    },

    /// `<ref>` to an id that no element has.
    #[error(
        "{location}: no element has the id {}; known: {}",
        quoted(id),
        List(known)
    )]
    UnknownReference {
        /// The line of the reference.
        location: Location,
        /// The id that was asked for.
        id: String,
        /// The ids that exist.
        known: Vec<String>,
    },

    /// A reference or an include that leads back to itself.
    #[error("{location}: {} contains itself", Sentence(what))]
    Cycle {
        /// The line that closes the cycle.
        location: Location,
        /// The element or file.
        what: String,
    },

    /// The input exceeds a limit that protects against runaway recursion and memory use.
    #[error("{location}: expected at most {limit} {what}, found more")]
    Limit {
        /// Where the limit was passed.
        location: Location,
        /// What is limited, in the plural.
        what: &'static str,
        /// The limit.
        limit: usize,
    },
}

impl SceneError {
    /// The line of the scene file, if it is one of that.
    pub fn location(&self) -> Option<&Location> {
        match self {
            Self::Syntax { location, .. }
            | Self::Value { location, .. }
            | Self::NoFile { location, .. }
            | Self::Missing { location, .. }
            | Self::Unknown { location, .. }
            | Self::UnknownPlugin { location, .. }
            | Self::Refused { location, .. }
            | Self::Duplicate { location, .. }
            | Self::UndefinedParameter { location, .. }
            | Self::UnknownReference { location, .. }
            | Self::Cycle { location, .. }
            | Self::Limit { location, .. } => Some(location),
            Self::Io { .. }
            | Self::Write { .. }
            | Self::Asset { .. }
            | Self::Parameter { .. }
            | Self::UnusedDefine { .. } => None,
        }
    }

    /// The file that is wrong, if it is none of the scene's text.
    pub(crate) fn file(&self) -> Option<&Path> {
        match self {
            Self::Io { path, .. } | Self::Asset { path, .. } => Some(path),
            _ => None,
        }
    }

    /// The message without that line.
    pub fn message(&self) -> String {
        let all = self.to_string();
        let place = self.location().map(|l| format!("{l}: "));
        match place.as_deref().and_then(|place| all.strip_prefix(place)) {
            Some(rest) => rest.to_owned(),
            None => all,
        }
    }

    /// A parameter given in code, where the code follows this line of a file.
    pub(crate) fn at(self, location: &Location) -> Self {
        match self {
            Self::Parameter {
                key,
                expected,
                found,
            } => Self::Value {
                location: location.clone(),
                key,
                expected,
                found,
            },
            other => other,
        }
    }
}

/// `:12`, or nothing.
struct Line(Option<u32>);

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.map_or(Ok(()), |line| write!(f, ":{line}"))
    }
}

/// Most characters that a message quotes of a file or a command line: enough to find the place, little enough to read.
const MOST_QUOTED: usize = 80;
/// Most characters of a part of a message that quotes something and says what it is.
const MOST_SAID: usize = 3 * MOST_QUOTED;
/// Most characters of the name of a file.
const MOST_OF_A_PATH: usize = 1024;
/// Most names of a list.
const MOST_NAMES: usize = 40;

/// The start of `text`, and whether something is missing.
fn cut(text: &str, most: usize) -> (&str, bool) {
    match text.char_indices().nth(most) {
        Some((end, _)) => (&text[..end], true),
        None => (text, false),
    }
}

/// `text` in backquotes, shortened so that a message stays readable.
pub(crate) fn quoted(text: &str) -> String {
    match cut(text, MOST_QUOTED) {
        (start, true) => format!("`{start}...`"),
        (all, false) => format!("`{all}`"),
    }
}

/// The name of a file; scenes may ask for any.
struct Name<'a>(&'a Path);

impl fmt::Display for Name<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.0.to_string_lossy();
        let (start, shortened) = cut(&name, MOST_OF_A_PATH);
        f.write_str(start)?;
        f.write_str(if shortened { "..." } else { "" })
    }
}

/// A part of a message, shortened in case that it quotes at length.
struct Sentence<'a>(&'a str);

impl fmt::Display for Sentence<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (start, shortened) = cut(self.0, MOST_SAID);
        f.write_str(start)?;
        f.write_str(if shortened { "..." } else { "" })
    }
}

/// A comma-separated list of names, or "(none)".
struct List<'a>(&'a [String]);

impl fmt::Display for List<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("(none)");
        }
        for (i, name) in self.0.iter().take(MOST_NAMES).enumerate() {
            let (start, shortened) = cut(name, MOST_QUOTED);
            let separator = if i == 0 { "" } else { ", " };
            write!(
                f,
                "{separator}{start}{}",
                if shortened { "..." } else { "" }
            )?;
        }
        match self.0.len().saturating_sub(MOST_NAMES) {
            0 => Ok(()),
            more => write!(f, " and {more} more"),
        }
    }
}

/// What went wrong while rendering or differentiating.
///
/// Nothing has changed where one is returned.
///
/// ```
/// use render::RenderError;
///
/// let mut room = render::scene::room(8, 8)?;
/// let before = room.params().values().to_vec();
/// match room.set([("sphere.alpha.value", &[1.5][..])]) {
///     Err(RenderError::ParameterOutOfRange { name, valid, found, .. }) => {
///         assert_eq!((name.as_str(), valid, found), ("sphere.alpha.value", (1e-4, 1.0), 1.5));
///     }
///     other => panic!("{other:?}"),
/// }
/// assert_eq!(room.params().values(), before);
///
/// let unknown = room.params().find("sphere.alpa.value");
/// assert!(matches!(unknown, Err(RenderError::UnknownParameter { closest, .. }) if closest[0] == "sphere.alpha.value"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[non_exhaustive]
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// No parameter has this name.
    #[error(
        "no parameter {}; closest: {}; `gradient SCENE --list` prints all",
        quoted(name),
        List(closest)
    )]
    UnknownParameter {
        /// The name that was asked for.
        name: String,
        /// Names that resemble it.
        closest: Vec<String>,
    },

    /// A slice of the wrong length.
    #[error("{what}: expected {expected} values, found {found}")]
    WrongLength {
        /// What the slice holds.
        what: &'static str,
        /// Length that was needed.
        expected: usize,
        /// Length that was given.
        found: usize,
    },

    /// A parameter that is given too many or too few values.
    #[error(
        "parameter {}: expected {expected} values, found {found}",
        quoted(name)
    )]
    ParameterLength {
        /// Its name.
        name: String,
        /// How many it has.
        expected: usize,
        /// How many were given.
        found: usize,
    },

    /// A weight with which nothing could be sampled.
    #[error("sampling weight of emitter {emitter}: expected a positive number, found {found}")]
    SamplingWeight {
        /// Index of the emitter.
        emitter: usize,
        /// Its weight.
        found: f64,
    },

    /// A weight of a pixel that is negative or not finite.
    #[error("weight of pixel {pixel}: expected a number not below zero, found {found}")]
    PixelWeight {
        /// Its number, row by row.
        pixel: usize,
        /// Its weight.
        found: f32,
    },

    /// Too many or too few of something.
    #[error("{what}: expected {expected}, found {found}")]
    Count {
        /// What is counted.
        what: &'static str,
        /// How many there may be.
        expected: &'static str,
        /// How many there are.
        found: u64,
    },

    /// A parameter outside its valid range.
    #[error("parameter {}[{index}]: expected a value in [{}, {}], found {found}", quoted(name), valid.0, valid.1)]
    ParameterOutOfRange {
        /// Its name.
        name: String,
        /// Element within the range.
        index: usize,
        /// Smallest and largest valid value.
        valid: (f64, f64),
        /// The value given.
        found: f64,
    },

    /// The sampled direction is a Dirac delta in the parameter.
    #[error(
        "parameter {} moves a Dirac delta: detached sampling has no derivative there (it would \
         silently be zero); `attached-path` has one, where nothing is discontinuous",
        quoted(name)
    )]
    DeltaParameter {
        /// Its name.
        name: String,
    },
    /// A kind of parameter that an estimator does not see.
    #[error(
        "parameter {}: {what} are not differentiated: {why}; estimators with `motion` have one, such as `edges`",
        quoted(name)
    )]
    UnseenParameter {
        /// Its name.
        name: String,
        /// Its kind.
        what: &'static str,
        /// Why.
        why: &'static str,
    },
    /// A parameter that moves vertices of paths which cannot be differentiated in it.
    #[error(
        "parameter {}: no derivative where vertices of paths move: {culprit}",
        quoted(name)
    )]
    Motion {
        /// Its name.
        name: String,
        /// What stands in the way.
        culprit: String,
    },
    /// A matrix that cannot be set, or differentiated.
    #[error("parameter {}: {reason}", quoted(name))]
    Matrix {
        /// Its name.
        name: String,
        /// Why.
        reason: String,
    },
    /// A name that no estimator has.
    #[error(
        "unknown estimator {}; {}known: {known}",
        quoted(name),
        near_misses(name, known)
    )]
    UnknownEstimator {
        /// The name.
        name: String,
        /// All names.
        known: String,
    },
    /// An estimator whose samples move by themselves, in a scene with discontinuities.
    #[error(
        "attached samples would move across discontinuities ({culprit}): the derivative would be \
         biased; use a detached or reparameterised estimator, or one that allows the bias to study it: \
         `attached-naive`, in code `AllowBias`"
    )]
    Discontinuous {
        /// What makes them.
        culprit: String,
    },
    /// Parameters that move a shape to where no rays are traced.
    #[error("{}: {reason}", match shape { Some(name) => format!("shape {}", quoted(name)), None => "geometry".to_owned() })]
    OutOfReach {
        /// Its name; none if it is all of them together.
        shape: Option<String>,
        /// What was expected, and what was found.
        reason: String,
    },
    /// A light tracer in a scene whose camera has a lens, or parallel rays.
    #[error("the camera is no pinhole: particles are connected to nothing else; use paths")]
    NoPinhole,
    /// Normals flipped to a viewer, whom particles do not know.
    #[error(
        "flip_invalid_normals: particles do not know their viewer; expected `--integrator path` and \
         `--caustics paths`"
    )]
    FlippedNormals,
    /// A number that should be a part of one.
    #[error("{what}: expected a number between 0 and 1, found {found}")]
    Fraction {
        /// What.
        what: &'static str,
        /// The number.
        found: f64,
    },
    /// A derivative that left the range of numbers: lights or adjoints near the end of single precision do that.
    #[error(
        "parameter {}: expected a finite derivative, found one that overflows",
        quoted(name)
    )]
    NonFiniteDerivative {
        /// Its name.
        name: String,
    },
    /// What manifold connections do not have.
    #[error("manifold connections (`--manifold`, or the scene's integrator): {what}")]
    Connections {
        /// What is asked for, and what would be right.
        what: String,
    },
    /// What glints do not have.
    #[error("glints (`--glints`, or the scene's integrator): {what}")]
    Glints {
        /// What is asked for, and what would be right.
        what: String,
    },
    /// A radius within which nothing could be gathered.
    #[error("radius: expected a positive number, neither tiny nor huge, found {found}")]
    Radius {
        /// The radius.
        found: f64,
    },
}

impl RenderError {
    /// [`RenderError::UnknownParameter`] with up to three similar names.
    pub(crate) fn unknown_parameter<'a>(
        name: &str,
        known: impl Iterator<Item = &'a String>,
    ) -> Self {
        Self::unknown_key(name, [known.collect(), Vec::new()])
    }

    /// The same, with up to two behind them of what may become a parameter. Where a thing has many names of that kind, they
    /// would leave no place for those of its parameters.
    pub(crate) fn unknown_key(name: &str, [known, movable]: [Vec<&String>; 2]) -> Self {
        let mut groups = [(known, 3), (movable, 2)].map(|(names, most)| {
            let mut ranked: Vec<_> = (names.into_iter())
                .map(|k| (shared_pairs(name, k), k))
                .collect();
            ranked.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(b.1)));
            ranked.truncate(most);
            ranked
        });
        let best = groups.iter().flatten().map(|(shared, _)| *shared).max();
        for group in &mut groups {
            group.retain(|(shared, _)| 2 * shared >= best.unwrap_or(0));
        }
        let closest = groups.iter().flatten().map(|(_, k)| (*k).clone()).collect();
        Self::UnknownParameter {
            name: name.into(),
            closest,
        }
    }
}

/// Pairs of neighbouring bytes.
fn pairs(text: &str) -> Vec<&[u8]> {
    text.as_bytes().windows(2).collect()
}

/// How many pairs of neighbours of `of` are in `name`, too.
fn shared_pairs(name: &str, of: &str) -> usize {
    let own = pairs(name);
    pairs(of).iter().filter(|p| own.contains(p)).count()
}

/// Those of a list of names that share at least half of their pairs with this one, closest first, as a clause.
fn near_misses(name: &str, known: &str) -> String {
    let alike = |k: &str| {
        let all = pairs(name).len() + pairs(k).len();
        2.0 * shared_pairs(name, k) as f64 / all.max(1) as f64
    };
    let mut near: Vec<_> = (known.split(", "))
        .map(|k| (alike(k), k))
        .filter(|(alike, _)| *alike >= 0.5)
        .collect();
    near.sort_by(|a, b| b.0.total_cmp(&a.0));
    let near: Vec<&str> = near.iter().take(3).map(|(_, k)| *k).collect();
    if near.is_empty() {
        return String::new();
    }
    format!("closest: {}; ", near.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quoting_shortens_at_a_character_boundary() {
        assert_eq!(quoted("ab"), "`ab`");
        let long = quoted(&"é".repeat(100));
        assert_eq!(long.chars().filter(|&c| c == 'é').count(), MOST_QUOTED);
    }

    #[test]
    fn near_misses_of_estimators_are_proposed() {
        let error = |name: &str| RenderError::UnknownEstimator {
            name: name.into(),
            known: "emitter, mis, mis-balance, reparameterised, edges".into(),
        };
        let message = error("miss").to_string();
        assert!(message.starts_with("unknown estimator `miss`; closest: mis; known: emitter, "));
        let message = error("reparametrized").to_string();
        assert!(
            message.contains("closest: reparameterised; known"),
            "{message}"
        );
        assert!(!error("x").to_string().contains("closest"));
        assert!(!error(&"é".repeat(1 << 10)).to_string().contains("closest"));
    }

    #[test]
    fn parameters_are_proposed_before_what_may_become_one() {
        let names = |all: &[&str]| all.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>();
        let known = names(&["sphere.alpha.value", "wall.reflectance.value"]);
        let movable = names(&[
            "sphere.rotation",
            "sphere.scale",
            "sphere.translation",
            "sensor.fov",
        ]);
        let closest = |name: &str| {
            let lists = [&known, &movable].map(|list| list.iter().collect());
            match RenderError::unknown_key(name, lists) {
                RenderError::UnknownParameter { closest, .. } => closest,
                _ => Vec::new(),
            }
        };
        assert_eq!(
            closest("sphere.roughness"),
            ["sphere.alpha.value", "sphere.rotation", "sphere.scale"]
        );
        assert_eq!(closest("sensor.fow"), ["sensor.fov"]);
    }

    #[test]
    fn messages_stay_readable() {
        let long = "x".repeat(1 << 20);
        let location = || Location::new(Path::new("a.xml"), 3);
        let all = [
            SceneError::Asset {
                path: "a.obj".into(),
                line: Some(2),
                expected: "a number".into(),
                found: long.clone(),
            },
            SceneError::UnknownReference {
                location: location(),
                id: long.clone(),
                known: vec![long.clone(); 1000],
            },
            SceneError::Unknown {
                location: location(),
                what: long.clone(),
                owner: long.clone(),
                known: Vec::new(),
            },
            SceneError::Value {
                location: location(),
                key: long.clone(),
                expected: "a number".into(),
                found: long,
            },
        ];
        for error in all {
            let message = error.to_string();
            assert!(
                message.len() < 5000 && message.starts_with("a."),
                "{message}"
            );
        }
        let names: Vec<String> = (0..50).map(|i| i.to_string()).collect();
        assert!(List(&names).to_string().ends_with("38, 39 and 10 more"));
    }
}
