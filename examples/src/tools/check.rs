//! `render --check`: what of a scene file is understood.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use render::Scene;
use render::scene::{self, Check, Finding, Verdict};
use serde::Serialize;

use crate::cli::{LoadArgs, Outcome, ToolError};
use crate::{output, print};

/// Most lines that are said of equal things.
const MOST_LINES: usize = 8;

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct Report<'a> {
    scene: String,
    outcome: &'static str,
    findings: Vec<Entry<'a>>,
}

#[derive(Debug, Serialize)]
struct Entry<'a> {
    verdict: &'static str,
    file: Option<String>,
    line: Option<u32>,
    message: &'a str,
}

impl<'a> Entry<'a> {
    fn of(f: &'a Finding) -> Self {
        Self {
            verdict: name_of(&Verdict::NAMES, &f.verdict),
            file: f.location.as_ref().map(|l| l.file.display().to_string()),
            line: f.location.as_ref().map(|l| l.line),
            message: &f.message,
        }
    }
}

fn name_of<T: PartialEq>(names: &[(&'static str, T)], value: &T) -> &'static str {
    let found = names.iter().find(|(_, v)| v == value);
    found.map_or("", |(name, _)| name)
}

/// Runs the check.
///
/// # Errors
/// The scene would not render.
pub fn run(path: &Path, load: &LoadArgs, json: Option<&Path>) -> Result<Outcome, ToolError> {
    if let Some(json) = json {
        output::prepare(&[json.to_owned()], &[path])?;
    }
    let check = Scene::check(path, &load.options());
    let outcome = check.outcome();
    let name = name_of(&scene::Outcome::NAMES, &outcome);
    print::out(format_args!("{}", text(path, &check)));
    if let Some(json) = json {
        let report = Report {
            scene: path.display().to_string(),
            outcome: name,
            findings: check.findings.iter().map(Entry::of).collect(),
        };
        output::write_json(json, &report)?;
    }
    match outcome {
        scene::Outcome::Renders => {
            if !load.values.is_empty() {
                let (mut scene, _) = Scene::load(path, &load.options())?;
                load.set(&mut scene)?;
            }
            Ok(Outcome::Done)
        }
        scene::Outcome::Incomplete => Err(ToolError::file(
            path,
            "would not render as it is: files or values are missing",
        )),
        scene::Outcome::Refused => Err(ToolError::file(
            path,
            "would not render: it asks for what is left out",
        )),
        scene::Outcome::Wrong => Err(ToolError::file(
            path,
            "would not render: something is wrong or unknown",
        )),
    }
}

/// What is wrong line by line; what is understood together with its like.
fn text(path: &Path, check: &Check) -> String {
    let place = |f: &Finding| match &f.location {
        Some(l) if *l.file == *path => l.line.to_string(),
        Some(l) => l.to_string(),
        None => String::new(),
    };
    let mut text = String::new();
    let mut like: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for f in &check.findings {
        if f.verdict == Verdict::Understood {
            like.entry(&f.message).or_default().push(place(f));
            continue;
        }
        let (verdict, at) = (name_of(&Verdict::NAMES, &f.verdict), place(f));
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{verdict:12} {at:>5}  {}", f.message);
    }
    for (message, lines) in like {
        let few = lines
            .iter()
            .take(MOST_LINES)
            .cloned()
            .collect::<Vec<_>>()
            .join(", ");
        let more = match lines.len().saturating_sub(MOST_LINES) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let _ = writeln!(
            text,
            "{:12} {:>5}  {message}: {few}{more}",
            "understood",
            lines.len()
        );
    }
    text
}
