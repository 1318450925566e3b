//! What of a scene file is understood.

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

use super::load::Reading;
use super::{LoadOptions, Scene};
use crate::error::{Location, SceneError};
use crate::plugin::Node;
use crate::plugin::xml::{Document, Notice};

/// So many `$names` are defined in place of the user at most.
const MOST_DEFINED: usize = 64;

/// What becomes of a part of a scene file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Verdict {
    /// It is what it says.
    Understood,
    /// It has no effect.
    Ignored,
    /// Something else stands in for it.
    Replaced,
    /// It needs a file that is not there, or a value for a `$name`.
    Missing,
    /// It stands for something that is left out on purpose.
    Refused,
    /// It is wrong, or unknown.
    Wrong,
}

impl Verdict {
    /// All of them, by name.
    pub const NAMES: [(&'static str, Self); 6] = [
        ("understood", Self::Understood),
        ("ignored", Self::Ignored),
        ("substituted", Self::Replaced),
        ("missing", Self::Missing),
        ("refused", Self::Refused),
        ("wrong", Self::Wrong),
    ];
}

/// A part of a scene file, and what becomes of it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Finding {
    /// What becomes of it.
    pub verdict: Verdict,
    /// Its line; none for what stands in another file.
    pub location: Option<Location>,
    /// What it is, or what is wrong with it.
    pub message: String,
}

/// Whether a scene would render.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// As it is.
    Renders,
    /// If some files were there, or values for all `$names`.
    Incomplete,
    /// No: all that stops it is left out on purpose.
    Refused,
    /// No.
    Wrong,
}

impl Outcome {
    /// All of them, by name.
    pub const NAMES: [(&'static str, Self); 4] = [
        ("renders", Self::Renders),
        ("incomplete", Self::Incomplete),
        ("refused", Self::Refused),
        ("wrong", Self::Wrong),
    ];
}

/// All parts of a scene file, and what becomes of them: [`Scene::check`].
///
/// ```
/// use render::Scene;
/// use render::scene::{Outcome, Verdict};
///
/// let check = Scene::check("../examples/scenes/cornell.xml".as_ref(), &Default::default());
/// assert_eq!(check.outcome(), Outcome::Renders);
///
/// // It reads on where loading ends at the first fault.
/// let folder = tempfile::tempdir()?;
/// let file = folder.path().join("two.xml");
/// let text = "<scene version='3.0.0'><sensor type='perspective'/>
///     <shape type='sphere'><bsdf type='roughconductor'><float name='alpha' value='abc'/></bsdf></shape>
///     <shape type='disk' radius='2'/></scene>";
/// std::fs::write(&file, text)?;
/// let check = Scene::check(&file, &Default::default());
/// assert_eq!(check.outcome(), Outcome::Wrong);
/// let wrong = check.findings.iter().filter(|f| f.verdict == Verdict::Wrong);
/// let lines: Vec<u32> = wrong.filter_map(|f| Some(f.location.as_ref()?.line)).collect();
/// assert_eq!(lines, [2, 3]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Check {
    /// The worst first, then in the order of the file.
    pub findings: Vec<Finding>,
}

impl Check {
    /// Whether the scene would render.
    pub fn outcome(&self) -> Outcome {
        let worst = self.findings.iter().map(|f| f.verdict).max();
        match worst {
            Some(Verdict::Wrong) => Outcome::Wrong,
            Some(Verdict::Refused) => Outcome::Refused,
            Some(Verdict::Missing) => Outcome::Incomplete,
            _ => Outcome::Renders,
        }
    }
}

impl Scene {
    /// Reads a scene file to its end, whatever is wrong with it and whether the files that it names are there, and says
    /// what of it is understood. What is wrong with the XML itself, or with an include, ends it early. Textures that are not there are substituted
    /// where `options` allow it, and missing otherwise.
    pub fn check(path: &Path, options: &LoadOptions) -> Check {
        let mut found = Vec::new();
        let mut defines = options.defines.clone();
        loop {
            match Document::load_to_its_end(path, &defines) {
                Ok((document, faults)) => {
                    found.extend(faults.iter().map(|f| fault(&f.error)));
                    let owners = faults.into_iter().filter_map(|f| f.owner);
                    read(&document, options, owners.collect(), &mut found);
                }
                // One number is as good as another, to read on.
                Err(e @ SceneError::UndefinedParameter { .. }) if defines.len() < MOST_DEFINED => {
                    if let SceneError::UndefinedParameter { name, .. } = &e {
                        let name = name.trim_start_matches('$').to_owned();
                        defines.push((name, "1".to_owned()));
                    }
                    found.push(fault(&e));
                    continue;
                }
                Err(e) => found.push(fault(&e)),
            }
            break;
        }
        let mut seen = HashSet::new();
        found.retain(|f| seen.insert(f.clone()));
        // Stable: in the order of the file otherwise.
        found.sort_by_key(|f| std::cmp::Reverse(f.verdict));
        Check { findings: found }
    }
}

/// Adds what becomes of a document; `incomplete` are plugins of which something is left out.
fn read(
    document: &Document,
    options: &LoadOptions,
    incomplete: Vec<Location>,
    found: &mut Vec<Finding>,
) {
    let to_its_end = LoadOptions {
        allow_missing: true,
        ..options.clone()
    };
    let mut reading = Reading::new(&to_its_end, Some(Vec::new()));
    let read = reading.scene(document.root(), &to_its_end);
    let errors = reading.faults.iter().flatten().chain(read.as_ref().err());
    found.extend(errors.map(|e| {
        let mut finding = fault(e);
        // What is wrong with a file concerns those who name it.
        if let (None, Some(file)) = (&finding.location, e.file()) {
            finding.location = naming(document.root(), file).cloned();
        }
        finding
    }));
    found.extend(document.warnings().into_iter().map(|w| Finding {
        verdict: match w.notice {
            Notice::Ignored => Verdict::Ignored,
            Notice::Replaced => Verdict::Replaced,
            Notice::Absent if options.allow_missing => Verdict::Replaced,
            Notice::Absent => Verdict::Missing,
        },
        location: Some(w.location),
        message: w.message,
    }));
    found.extend(reading.warnings.into_iter().map(|message| Finding {
        verdict: Verdict::Replaced,
        location: None,
        message,
    }));
    let incomplete = incomplete.into_iter().map(|at| (at, Verdict::Wrong));
    let mut worst: HashMap<Location, Verdict> = incomplete.collect();
    for f in found.iter() {
        if let Some(at) = &f.location {
            let here = worst.entry(at.clone()).or_insert(f.verdict);
            *here = f.verdict.max(*here);
        }
    }
    let mut seen = HashSet::new();
    visit(document.root(), &mut seen, &mut |node| {
        if !is_concerned(node, &worst) {
            found.push(Finding {
                verdict: Verdict::Understood,
                location: Some(node.location.clone()),
                message: node.describe(),
            });
        }
    });
}

/// Whether something was found about a plugin as a whole, or about one of its attributes or references. One that has no
/// effect leaves the rest as it is.
fn is_concerned(node: &Node, worst: &HashMap<Location, Verdict>) -> bool {
    let is_more = |at: &Location| worst.get(at).is_some_and(|v| *v > Verdict::Ignored);
    worst.contains_key(&node.location) || node.places().any(is_more)
}

/// The attribute that names a file.
fn naming<'a>(root: &'a Node, file: &Path) -> Option<&'a Location> {
    let mut found = None;
    visit(root, &mut HashSet::new(), &mut |node| {
        found = found.or_else(|| node.names_file(file));
    });
    found
}

/// Calls `f` with every plugin below a node, once.
fn visit<'a>(node: &'a Node, seen: &mut HashSet<*const Node>, f: &mut dyn FnMut(&'a Node)) {
    for child in node.parts() {
        if seen.insert(Arc::as_ptr(child)) {
            f(child);
            visit(child, seen, f);
        }
    }
}

fn fault(e: &SceneError) -> Finding {
    Finding {
        verdict: match e {
            SceneError::NoFile { .. } | SceneError::UndefinedParameter { .. } => Verdict::Missing,
            SceneError::Refused { .. } => Verdict::Refused,
            _ => Verdict::Wrong,
        },
        location: e.location().cloned(),
        message: e.message(),
    }
}
