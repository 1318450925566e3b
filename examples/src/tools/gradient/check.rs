//! `gradient --check`: whether gradients are right, by differences.

use std::collections::BTreeMap;
use std::path::Path;

use render::check::{Along, Checked, Comparison, Options, Verdict, check, most_passes};
use render::integrator::render::Progress;
use render::{Scene, Settings};
use serde::Serialize;

use super::{Args, Objective};
use crate::cli::{Outcome, SampleArgs, ToolError};
use crate::output;
use crate::progress::{Bar, Interrupt};
use crate::{complain, print, say};

/// Exit code where a derivative is wrong.
pub const WRONG: u8 = 3;
/// Exit code where the budget does not suffice to tell.
pub const CANNOT_TELL: u8 = 4;

#[derive(Debug, Serialize)]
struct ComparisonReport {
    /// Index of the value, if it is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    index: Option<u32>,
    /// Number of the random direction, if it is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    direction: Option<u32>,
    gradient: f64,
    std_error: f64,
    differences: f64,
    differences_std_error: f64,
    step: f64,
    step_error: f64,
    z: f64,
    /// None where nothing was seen.
    resolution: Option<f64>,
    verdict: &'static str,
}

impl ComparisonReport {
    fn new(c: &Comparison) -> Self {
        let (index, direction) = match c.along {
            Along::Value(i) => (Some(i), None),
            Along::Random(k) => (None, Some(k)),
        };
        Self {
            index,
            direction,
            gradient: c.gradient.mean,
            std_error: c.gradient.se,
            differences: c.differences.mean,
            differences_std_error: c.differences.se,
            step: c.step,
            step_error: c.step_error,
            z: c.z,
            resolution: Some(c.resolution).filter(|r| r.is_finite()),
            verdict: c.verdict.name(),
        }
    }
}

#[derive(Debug, Serialize)]
struct ParamReport {
    verdict: &'static str,
    comparisons: Vec<ComparisonReport>,
}

impl ParamReport {
    fn new(found: &Checked) -> Self {
        Self {
            verdict: found.verdict().name(),
            comparisons: found
                .comparisons
                .iter()
                .map(ComparisonReport::new)
                .collect(),
        }
    }
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct Report {
    scene: String,
    estimator: &'static str,
    spp: u32,
    #[serde(flatten)]
    samples: SampleArgs,
    repeats: u32,
    seed: u64,
    threads: usize,
    tolerance: f64,
    significance: f64,
    z_limit: f64,
    non_finite: u64,
    verdict: &'static str,
    params: BTreeMap<String, ParamReport>,
    /// Parameters that were not asked for by name, and that the estimator does not see.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    refused: BTreeMap<String, String>,
}

/// The parameters asked for, or all that the estimator sees, and why it does not see the others.
fn names(args: &Args, scene: &Scene) -> (Vec<String>, BTreeMap<String, String>) {
    if !args.params.is_empty() {
        return (args.params.clone(), BTreeMap::new());
    }
    let able = super::measuring(args);
    let mut seen = Vec::new();
    let mut refused = BTreeMap::new();
    for info in scene.params().infos() {
        match able.active(scene, &[&info.name]) {
            Ok(_) => seen.push(info.name.clone()),
            Err(e) => {
                refused.insert(info.name.clone(), e.to_string());
            }
        }
    }
    (seen, refused)
}

/// Runs the check instead of the gradient.
pub(super) fn run(
    args: &Args,
    scene: &mut Scene,
    settings: &Settings,
    objective: &Objective,
    read: &[&Path],
    interrupt: &Interrupt,
) -> Result<Outcome, ToolError> {
    let (names, refused) = names(args, scene);
    for reason in refused.values() {
        say!("not seen: {reason}");
    }
    if names.is_empty() {
        return Err(ToolError::Usage(
            "--check: the estimator sees no parameter of this scene".into(),
        ));
    }
    let args = &Args {
        params: names,
        ..args.clone()
    };
    output::prepare(&args.json.iter().cloned().collect::<Vec<_>>(), read)?;
    let options = Options {
        repeats: args.repeats,
        tolerance: args.tolerance,
        seed: args.seed,
        ..Options::default()
    };
    let found = args.threads.run(|threads| {
        let Some(mixture) = super::learn(args, scene, settings, objective, interrupt)?.mixture
        else {
            return Ok(None);
        };
        let passes = most_passes(scene, &args.params, &options);
        let pixels = scene.film.pixels() as u64;
        let bar = Bar::new("check", passes * pixels, interrupt);
        let adjoint = objective.adjoint(args, scene, settings, &bar)?;
        if bar.cancelled() {
            return Ok(None);
        }
        let names = &args.params;
        let report = check(scene, settings, names, &mixture, &adjoint, &options, &bar)?;
        bar.finish();
        Ok(report.map(|report| (report, threads)))
    })?;
    let Some((found, threads)) = found else {
        complain!("interrupted before the check was complete: nothing was written");
        return Ok(Outcome::Interrupted);
    };
    print::out(format_args!("{found}"));
    if let Some(path) = &args.json {
        let params = found.params.iter();
        let report = Report {
            scene: args.scene.display().to_string(),
            estimator: args.estimator.name(),
            spp: settings.spp,
            samples: args.samples.filled(),
            repeats: args.repeats,
            seed: args.seed,
            threads,
            tolerance: args.tolerance,
            significance: options.significance,
            z_limit: found.z_limit,
            non_finite: found.non_finite,
            verdict: found.verdict().name(),
            params: params
                .map(|p| (p.name.clone(), ParamReport::new(p)))
                .collect(),
            refused,
        };
        output::write_json(path, &report)?;
    }
    Ok(match found.verdict() {
        Verdict::Right => Outcome::Done,
        Verdict::CannotTell => Outcome::Answered(CANNOT_TELL),
        Verdict::Wrong => Outcome::Answered(WRONG),
    })
}
