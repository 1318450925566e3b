//! `stability`: where estimators of derivatives fail, as a picture.

mod moving;
mod picture;
mod setup;
mod sweeps;
mod verdict;

use std::ops::Range;
use std::path::PathBuf;
use std::time::Instant;

use clap::Parser;
use render::Job;
use render::estimator::Failure;
use render::image_io;
use render::instances::{Direction, Estimator};
use render::statistics;
use serde::Serialize;

use crate::cli::{ListArgs, Outcome, ThreadArgs, ToolError, sample_count};
use crate::output::{self, Named};
use crate::progress::{Bar, Interrupt};
use crate::{complain, print};

use setup::{SIZE, Setup, Values};
use sweeps::{Of, Sweep};
use verdict::Probes;

const EXAMPLES: &str = "\
Examples:
  stability --out folder
  stability --quick --estimators detached,attached,differential

All estimators of the derivative in roughness are swept over roughness, size of the light, angle of
the viewer, path length and number of samples; those of derivatives in what moves over the size of a
silhouette, the distance of what casts a shadow, roughness, path length and number of faces: on scenes
whose derivatives are known in closed form or from quadrature. A point fails if it differs from those beyond chance (significance 1e-3 over all points), or has samples that
are not finite; those of estimators that should be right are measured once more with 16 times the
samples before they are called biased. The folder receives stability.png and motion.png, the same as
SVG files, points.csv, report.json and verdict.txt, which names failure modes by the numbers F1 to F44
of the table in docs/errata.md. Everything but times depends on the seed alone. Ctrl-C keeps the points so
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
/// Standard error of `d ln I / d ln alpha`, and of the derivative in what moves over itself, from rounding in f32, beside
/// that from chance.
const ROUNDING: f64 = 1e-4;
/// A measured standard deviation below this part of the true one has not seen the lobe.
const SEEN: f64 = 0.3;
/// Nor have so few pixels, or images, that differ from zero.
const PIXELS: usize = 48;
/// Images, where pixels are not alike.
const IMAGES: u64 = (SIZE * SIZE) as u64;

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
    /// What the derivative is in.
    pub param: &'static str,
    /// Where on its axis.
    pub x: f64,
    /// The estimator.
    pub estimator: Named,
    /// Radiance, or the mean of the image.
    pub radiance: f64,
    /// True derivative, and how far it may be off.
    pub truth: [f64; 2],
    /// Its estimate, and the standard error of that.
    pub mean: [f64; 2],
    /// Difference in standard errors.
    pub z: f64,
    /// Difference over the radiance, times the roughness: of `d ln I / d ln alpha`. Of what moves, over the derivative.
    pub relative_bias: f64,
    /// Standard deviation of one sample over the radiance; of what moves, over the derivative.
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
    /// The estimator.
    pub estimator: Named,
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

/// The derivative of one pixel, or of the mean of an image, from all of them. `None` if interrupted.
fn measure(
    setup: &Setup,
    e: Estimator,
    spp: u32,
    seed: u64,
    interrupt: &Interrupt,
) -> Result<Option<Measured>, ToolError> {
    let scene = &setup.scene;
    let along = [Direction::uniform(scene.params(), setup.param)?];
    let (values, settings) = (scene.params().values(), &scene.settings);
    let start = Instant::now();
    let mut non_finite = 0;
    // All lights and materials are grey.
    let mut pixels = |samples: Range<u64>| -> Result<Option<Vec<f64>>, ToolError> {
        let n = (samples.end - samples.start) as f64;
        let job = Job::new(scene, settings, seed, samples, interrupt);
        let r = e.forward_f32(&job, values, &along)?;
        non_finite += r.non_finite.count;
        let means = r.sums[1].iter().step_by(3).map(|s| s / n);
        Ok((!r.cancelled).then(|| means.collect()))
    };
    let mut found: Vec<f64> = Vec::new();
    // Samples that each of them is the mean of.
    let each = match setup.values {
        Values::Pixels => {
            let Some(all) = pixels(0..u64::from(spp))? else {
                return Ok(None);
            };
            found = all;
            f64::from(spp)
        }
        Values::Images => {
            let size: u32 = scene.film.size.iter().product();
            let each = u64::from(spp.div_ceil(size));
            for k in 0..IMAGES {
                let Some(image) = pixels(k * each..(k + 1) * each)? else {
                    return Ok(None);
                };
                found.push(image.iter().sum::<f64>() / image.len() as f64);
            }
            each as f64 * f64::from(size)
        }
    };
    let seconds = start.elapsed().as_secs_f64();
    let count = found.len() as f64;
    let mean = found.iter().sum::<f64>() / count;
    let spread = found.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / (count - 1.0);
    Ok(Some(Measured {
        mean,
        error: (spread / count).sqrt(),
        std: (spread * each).sqrt(),
        seconds: seconds / (count * each),
        non_finite,
        pixels: found.iter().filter(|p| **p != 0.0).count(),
    }))
}

fn row(sweep: &Sweep, x: f64, setup: &Setup, e: Estimator, m: &Measured, z_limit: f64) -> Row {
    let truth = setup.truth;
    let unit = sweep.of.unit(x, &truth);
    let off = m.mean - truth.slope;
    let rounding = ROUNDING * unit;
    let z = off / m.error.hypot(truth.error).hypot(rounding);
    // Of constant samples by one technique alone.
    let can = e.capabilities();
    let expected = truth.std.filter(|_| can.is_constant());
    let expected =
        expected.and_then(
            |[by_light, by_lobe]| match (can.samples_emitters, can.counts_hits) {
                (true, false) => Some(by_light),
                (false, true) => Some(by_lobe),
                _ => None,
            },
        );
    // A lobe shows in the radiance whatever its width.
    let scale = match sweep.of {
        Of::Roughness(_) => truth.value,
        Of::Motion => unit,
    };
    // Without a term for outlines there is nothing to be seen.
    let blind = can.failures.contains(Failure::Boundaries) && m.pixels == 0;
    let unseen = !blind && m.pixels < PIXELS || expected.is_some_and(|s| m.std < SEEN * s);
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
        param: setup.param,
        x,
        estimator: Named(e),
        radiance: truth.value,
        truth: [truth.slope, truth.error],
        mean: [m.mean, m.error],
        z,
        relative_bias: off / unit,
        std: m.std / scale,
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
    let mut sweeps = sweeps::all(args.quick);
    sweeps.extend(sweeps::motion(args.quick));
    let asked = |sweep: &Sweep| -> Vec<Estimator> {
        let moves = matches!(sweep.of, Of::Motion);
        let sees = |e: &Estimator| !moves || e.capabilities().moves_vertices;
        estimators.iter().copied().filter(sees).collect()
    };
    let tests = |sweep: &Sweep| sweep.points.len() * asked(sweep).len();
    let points: usize = sweeps.iter().map(|s| s.points.len()).sum();
    let z_limit = statistics::z_limit(
        sweeps.iter().map(tests).sum(),
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
                for e in asked(sweep) {
                    if let Err(reason) = e.check(&setup.scene) {
                        let refused = Refused {
                            sweep: sweep.name,
                            estimator: Named(e),
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
                    let found = measure(&setup, e, spp, seed, interrupt)?;
                    let Some(m) = found else {
                        break 'sweeps;
                    };
                    let mut found = row(sweep, x, &setup, e, &m, z_limit);
                    // Rare samples may all have been missed: a second look with many more.
                    if found.finding == Finding::Biased && !e.capabilities().study {
                        let (spp, seed) = (16 * spp, !seed);
                        let again = measure(&setup, e, spp, seed, interrupt)?;
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
        "sweep,param,x,estimator,radiance,truth,truth_error,mean,std_error,z,relative_bias,std,\
         expected_std,seconds_per_sample,non_finite,finding\n",
    );
    for r in &report.rows {
        let finding = serde_json::to_string(&r.finding).unwrap_or_default();
        table += &format!(
            "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}\n",
            r.sweep,
            r.param,
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
    for (name, sheet) in picture::sheets(sweeps, report) {
        let drawn = |e| ToolError::file(&args.out.join(name), e);
        file(
            &format!("{name}.svg"),
            sheet.svg().map_err(drawn)?.as_bytes(),
        )?;
        file(&format!("{name}.png"), &sheet.png().map_err(drawn)?)?;
    }
    Ok(())
}
