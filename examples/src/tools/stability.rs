//! `stability`: where estimators of derivatives fail, as a picture.

mod picture;
mod setup;
mod sweeps;
mod verdict;

use std::path::PathBuf;
use std::time::Instant;

use clap::Parser;
use render::Job;
use render::image_io;
use render::instances::{Direction, Estimator};
use render::statistics;
use serde::Serialize;

use crate::cli::{ListArgs, Outcome, ThreadArgs, ToolError, sample_count};
use crate::output;
use crate::progress::{Bar, Interrupt};
use crate::{complain, print};

use setup::{SIZE, Setup};
use sweeps::Sweep;
use verdict::Probes;

const EXAMPLES: &str = "\
Examples:
  stability --out folder
  stability --quick --estimators detached,attached,differential

All estimators of the derivative in roughness are swept over roughness, size of the light, angle of
the viewer, path length and number of samples, on scenes whose derivatives are known from quadrature. A
point fails if it differs from those beyond chance (significance 1e-3 over all points), or has samples that
are not finite; those of estimators that should be right are measured once more with 16 times the
samples before they are called biased. The folder receives stability.png, stability.svg,
points.csv, report.json and verdict.txt, which names failure modes by the numbers F1 to F43 of the
table in docs/errata.md. Everything but times depends on the seed alone. Ctrl-C keeps the points so
far (exit code 130).";

/// Charts where estimators of derivatives fail
#[derive(Parser, Clone, Debug)]
#[command(name = "stability", after_help = EXAMPLES)]
pub struct Args {
    /// `all`, or names separated by commas
    #[arg(
        long,
        value_name = "NAMES",
        default_value = "all",
        value_delimiter = ','
    )]
    pub estimators: Vec<String>,
    /// Few points with few samples: seconds
    #[arg(long)]
    pub quick: bool,
    /// Samples per pixel, 256 pixels a point [default: 128, quick: 16]
    #[arg(long, value_name = "N", value_parser = sample_count())]
    pub spp: Option<u32>,
    /// Seed
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Folder for tables and charts
    #[arg(long, value_name = "DIR", default_value = "out/stability")]
    pub out: PathBuf,
    /// Write the report to this file as well
    #[arg(long, value_name = "OUT.JSON")]
    pub json: Option<PathBuf>,
    /// Threads
    #[command(flatten)]
    pub threads: ThreadArgs,
    /// What there is
    #[command(flatten)]
    pub list_estimators: ListArgs,
}

/// Probability that a set of unbiased estimators has a point that is called biased.
const SIGNIFICANCE: f64 = 1e-3;
/// Standard error of `d ln I / d ln alpha` from rounding in f32, beside that from chance.
const ROUNDING: f64 = 1e-4;
/// A measured standard deviation below this part of the true one has not seen the lobe.
const SEEN: f64 = 0.3;
/// Nor have so few pixels that differ from zero.
const PIXELS: usize = 48;

/// What the samples of an estimator say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Finding {
    /// As it should be.
    Right,
    /// Differs from the truth beyond chance.
    Biased,
    /// So few samples met what matters that mean and error say nothing.
    Unresolved,
    /// Some samples were not finite.
    NonFinite,
}

impl Finding {
    /// As it is written in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Biased => "biased",
            Self::Unresolved => "unresolved",
            Self::NonFinite => "non-finite",
        }
    }
}

/// One estimator at one point.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the sweep.
    pub sweep: &'static str,
    /// Where on its axis.
    pub x: f64,
    /// Name of the estimator.
    pub estimator: &'static str,
    /// Radiance.
    pub radiance: f64,
    /// True derivative, and how far it may be off.
    pub truth: [f64; 2],
    /// Its estimate, and the standard error of that.
    pub mean: [f64; 2],
    /// Difference in standard errors.
    pub z: f64,
    /// Difference over the radiance, times the roughness: of `d ln I / d ln alpha`.
    pub relative_bias: f64,
    /// Standard deviation of one sample over the radiance.
    pub std: f64,
    /// The same by a law or by quadrature, if known.
    pub expected_std: Option<f64>,
    /// Wall time of a sample.
    pub seconds_per_sample: f64,
    /// Samples that were not finite.
    pub non_finite: u64,
    /// What this point says.
    pub finding: Finding,
}

/// An estimator that a scene rules out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refused {
    /// Name of the sweep.
    pub sweep: &'static str,
    /// Name of the estimator.
    pub estimator: &'static str,
    /// Why.
    pub reason: String,
}

/// All there is to say.
#[derive(Debug, Serialize)]
pub struct Report {
    seed: u64,
    spp: u32,
    samples_per_point: u64,
    threads: usize,
    z_limit: f64,
    rows: Vec<Row>,
    refused: Vec<Refused>,
    probes: Probes,
}

/// Mean, standard error and standard deviation of one sample.
#[derive(Clone, Copy, Debug)]
struct Measured {
    mean: f64,
    error: f64,
    std: f64,
    seconds: f64,
    non_finite: u64,
    /// Pixels that differ from zero.
    pixels: usize,
}

/// Derivative in `param` of one pixel, from all of them. `None` if interrupted.
fn measure(
    setup: &Setup,
    param: &str,
    e: Estimator,
    spp: u32,
    seed: u64,
    interrupt: &Interrupt,
) -> Result<Option<Measured>, ToolError> {
    let scene = &setup.scene;
    let along = Direction::uniform(scene.params(), param)?;
    let (values, settings) = (scene.params().values(), &scene.settings);
    let start = Instant::now();
    let samples = 0..u64::from(spp);
    let r = e.forward_f32(
        &Job::new(scene, settings, seed, samples, interrupt),
        values,
        &[along],
    )?;
    if r.cancelled {
        return Ok(None);
    }
    let seconds = start.elapsed().as_secs_f64();
    let n = f64::from(spp);
    // All lights and materials are grey.
    let pixels: Vec<f64> = r.sums[1].iter().step_by(3).map(|s| s / n).collect();
    let count = pixels.len() as f64;
    let mean = pixels.iter().sum::<f64>() / count;
    let spread = pixels.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / (count - 1.0);
    Ok(Some(Measured {
        mean,
        error: (spread / count).sqrt(),
        std: (spread * n).sqrt(),
        seconds: seconds / (count * n),
        non_finite: r.non_finite.count,
        pixels: pixels.iter().filter(|p| **p != 0.0).count(),
    }))
}

fn row(sweep: &Sweep, x: f64, setup: &Setup, e: Estimator, m: &Measured, z_limit: f64) -> Row {
    let truth = setup.truth;
    let alpha = (sweep.alpha)(x);
    let off = m.mean - truth.slope;
    let rounding = ROUNDING * truth.value / alpha;
    let z = off / m.error.hypot(truth.error).hypot(rounding);
    let expected = truth.std.and_then(|[by_light, by_lobe]| match e {
        Estimator::Emitter => Some(by_light),
        Estimator::Detached => Some(by_lobe),
        _ => None,
    });
    let relative_bias = off / truth.value * alpha;
    let unseen = m.pixels < PIXELS || expected.is_some_and(|s| m.std < SEEN * s);
    let finding = if m.non_finite > 0 {
        Finding::NonFinite
    } else if unseen {
        Finding::Unresolved
    } else if z.abs() > z_limit {
        Finding::Biased
    } else {
        Finding::Right
    };
    Row {
        sweep: sweep.name,
        x,
        estimator: e.name(),
        radiance: truth.value,
        truth: [truth.slope, truth.error],
        mean: [m.mean, m.error],
        z,
        relative_bias,
        std: m.std / truth.value,
        expected_std: expected.map(|s| s / truth.value),
        seconds_per_sample: m.seconds,
        non_finite: m.non_finite,
        finding,
    }
}

/// Runs the tool.
///
/// # Errors
/// Anything wrong with the arguments or the files.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Outcome, ToolError> {
    let estimators = match &args.estimators[..] {
        [all] if all == "all" => Estimator::ALL.to_vec(),
        names => {
            let found: Result<Vec<_>, _> = names.iter().map(|n| Estimator::from_name(n)).collect();
            found?
        }
    };
    let reports = [args.out.join("report.json")]
        .into_iter()
        .chain(args.json.clone());
    interrupt.keep();
    output::prepare(&reports.collect::<Vec<_>>(), &[])?;
    let spp = args.spp.unwrap_or(if args.quick { 16 } else { 128 });
    let sweeps = sweeps::all(args.quick);
    let points: usize = sweeps.iter().map(|s| s.points.len()).sum();
    let z_limit = statistics::z_limit(
        points * estimators.len(),
        // Errors come from the pixels.
        u64::from(SIZE * SIZE),
        SIGNIFICANCE,
    );
    let threads = args.threads.run(|threads| {
        let mut report = Report {
            seed: args.seed,
            spp,
            samples_per_point: u64::from(spp * SIZE * SIZE),
            threads,
            z_limit,
            rows: Vec::new(),
            refused: Vec::new(),
            probes: Probes::default(),
        };
        let bar = Bar::new("points", points as u64, interrupt);
        let mut done = 0;
        'sweeps: for (s, sweep) in sweeps.iter().enumerate() {
            bar.message(sweep.name.into());
            for (p, &x) in sweep.points.iter().enumerate() {
                let setup = (sweep.setup)(x).map_err(|e| ToolError::Usage(e.to_string()))?;
                for &e in &estimators {
                    if let Err(reason) = e.check(&setup.scene) {
                        let refused = Refused {
                            sweep: sweep.name,
                            estimator: e.name(),
                            reason: reason.to_string(),
                        };
                        if !report.refused.contains(&refused) {
                            report.refused.push(refused);
                        }
                        continue;
                    }
                    // Numbers depend on no other estimator and no other point.
                    let index = Estimator::ALL.iter().position(|x| *x == e).unwrap_or(0);
                    let seed = [s, p, index]
                        .iter()
                        .fold(args.seed, |seed, i| seed.wrapping_mul(1009) + 1 + *i as u64);
                    let found = measure(&setup, setup::ROUGHNESS, e, spp, seed, interrupt)?;
                    let Some(m) = found else {
                        break 'sweeps;
                    };
                    let mut found = row(sweep, x, &setup, e, &m, z_limit);
                    // Rare samples may all have been missed: a second look with many more.
                    if found.finding == Finding::Biased && !e.capabilities().study {
                        let (spp, seed) = (16 * spp, !seed);
                        let again = measure(&setup, setup::ROUGHNESS, e, spp, seed, interrupt)?;
                        let Some(m) = again else {
                            break 'sweeps;
                        };
                        found = row(sweep, x, &setup, e, &m, z_limit);
                    }
                    report.rows.push(found);
                }
                done += 1;
                bar.set(done);
            }
        }
        bar.finish();
        if !interrupt.is_set() {
            report.probes = verdict::probe(args.quick, args.seed, &estimators, interrupt)?;
        }
        write(args, &sweeps, &report)?;
        Ok(threads)
    });
    threads?;
    if interrupt.is_set() {
        complain!("interrupted: the points so far were written");
        return Ok(Outcome::Interrupted);
    }
    Ok(Outcome::Done)
}

fn write(args: &Args, sweeps: &[Sweep], report: &Report) -> Result<(), ToolError> {
    let text = verdict::text(report);
    print::out(format_args!("{text}"));
    let mut table = String::from(
        "sweep,x,estimator,radiance,truth,truth_error,mean,std_error,z,relative_bias,std,\
         expected_std,seconds_per_sample,non_finite,finding\n",
    );
    for r in &report.rows {
        let finding = serde_json::to_string(&r.finding).unwrap_or_default();
        table += &format!(
            "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}\n",
            r.sweep,
            r.x,
            r.estimator,
            r.radiance,
            r.truth[0],
            r.truth[1],
            r.mean[0],
            r.mean[1],
            r.z,
            r.relative_bias,
            r.std,
            r.expected_std.map(|s| s.to_string()).unwrap_or_default(),
            r.seconds_per_sample,
            r.non_finite,
            finding.trim_matches('"')
        );
    }
    let file = |name: &str, bytes: &[u8]| {
        image_io::write_atomically(&args.out.join(name), bytes).map_err(ToolError::from)
    };
    file("points.csv", table.as_bytes())?;
    file("verdict.txt", text.as_bytes())?;
    output::write_json(&args.out.join("report.json"), report)?;
    if let Some(path) = &args.json {
        output::write_json(path, report)?;
    }
    let sheet = picture::sheet(sweeps, report);
    let drawn = |e| ToolError::file(&args.out.join("stability"), e);
    file("stability.svg", sheet.svg().map_err(drawn)?.as_bytes())?;
    file("stability.png", &sheet.png().map_err(drawn)?)
}
