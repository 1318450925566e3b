//! `compare`: all estimators of a derivative against each other, speed against accuracy.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Parser;
use render::Job;
use render::auto::{self, Mixture};
use render::check::{self, Span};
use render::image_io::Labels;
use render::instances::{Direction, Estimator, Mode, forward_f64, render_f64};
use render::integrator::render::{NonFinite, Progress, Rendering, stays};
use render::params::{ParamInfo, Theta};
use render::statistics::{self, Estimate};
use render::{Image, RenderError, Scene, Settings, image_io};
use serde::{Serialize, Serializer};

use crate::chart::{LineChart, Panel};
use crate::cli::{
    self, Choice, ListArgs, LoadArgs, Outcome, SampleArgs, ThreadArgs, ToolError, depth,
    report_non_finite, sample_count,
};
use crate::output;
use crate::progress::{Bar, Interrupt};
use crate::ranks::median;
use crate::solved::{ManifoldArgs, SolvedReport, Walks};
use crate::tools::stability::Finding;
use crate::{complain, print, say};

const EXAMPLES: &str = "\
Examples:
  compare scene.xml --param plate.alpha.value --out folder
  compare scene.xml --param a.alpha.value --estimators mis,differential-mis --repeats 64
  compare scene.xml --param a.alpha.value --reference fd

One number is added to all elements of each parameter; its derivative image is estimated by every estimator
that is right in the scene, and by those that are wrong on purpose; mis-f64 is mis in double precision, auto
is chosen by pilots. One that differs from the reference beyond chance in any block of the image, out of
4 x 4 (significance 1e-3 over all blocks and estimators), is called biased if it is wrong on purpose. Any
other gets a second look with four times the samples: biased if it differs again in that block, and by more
than the noise of all blocks explains; unresolved if not, or if it sees nothing there: it hardly ever samples
what matters. `fd` extrapolates differences of two steps, and counts what that changes as an error; where
shapes, cameras or lights move, pilots choose the steps. Efficiency is 1 / (variance x time). The folder
receives table.csv, ladder.csv, report.json, verdict.txt, a chart and standard-deviation images per
parameter. What auto chooses, and everything else but times, depends on the seed alone. Ctrl-C keeps the
estimators so far (exit code 130).";

/// Compares estimators of derivatives: bias, variance, time
#[derive(Parser, Clone, Debug)]
#[command(name = "compare", after_help = EXAMPLES)]
pub struct Args {
    /// Scene file, Mitsuba XML
    pub scene: PathBuf,
    /// Parameter to differentiate with respect to; may be given several times
    #[arg(long = "param", value_name = "KEY", required = true)]
    pub params: Vec<String>,
    /// Scene options
    #[command(flatten)]
    pub load: LoadArgs,
    /// `all`, or names separated by commas, `auto` among them: pilots choose and mix, for the work of as many
    /// samples of mis; its time includes the pilots
    #[arg(
        long,
        value_name = "NAMES",
        default_value = "all",
        value_delimiter = ','
    )]
    pub estimators: Vec<String>,
    /// An estimator's name, or `fd` for finite differences in double precision [default: mis; where it does not see the
    /// parameters, edges or reparameterised-mis]
    #[arg(long, value_name = "NAME")]
    pub reference: Option<String>,
    /// Samples per pixel and repeat [default: the scene's]
    #[arg(long, value_name = "N", value_parser = sample_count())]
    pub spp: Option<u32>,
    /// How samples are made
    #[command(flatten)]
    pub samples: SampleArgs,
    /// Light over specular chains
    #[command(flatten)]
    pub manifold: ManifoldArgs,
    /// Largest number of path edges; -1 for no limit [default: the scene's]
    #[arg(long, value_name = "N", value_parser = depth)]
    pub max_depth: Option<u32>,
    /// Independent repeats of each estimator; the reference has four times as many
    #[arg(long, value_name = "K", default_value_t = 16,
          value_parser = clap::value_parser!(u32).range(4..=1 << 20))]
    pub repeats: u32,
    /// Seed
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Folder for tables, charts and images
    #[arg(long, value_name = "DIR", default_value = "out/compare")]
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

/// Blocks of the image per side.
const BLOCKS: usize = 4;
/// Probability that a set of unbiased estimators has one that differs.
const SIGNIFICANCE: f64 = 1e-3;
/// Repeats of the reference, and of a second look, for one of an estimator.
const MORE_REPEATS: u64 = 4;
/// Seeds of a second look start so many streams later.
const SECOND_LOOK: u64 = 1 << 16;
/// Those of pilots that choose a step, here.
const PILOT: u64 = 1 << 17;

/// What takes part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contestant {
    choice: Choice,
    /// In double precision: only [`Estimator::DOUBLE`] is compiled for that.
    double: bool,
}

impl Contestant {
    const DEFAULT: Self = Self::single(Choice::One(Estimator::Mis));
    /// The default in double precision.
    const DOUBLE: Self = Self {
        choice: Choice::One(Estimator::DOUBLE),
        double: true,
    };

    const fn single(choice: Choice) -> Self {
        Self {
            choice,
            double: false,
        }
    }

    fn name(self) -> &'static str {
        if self.double {
            "mis-f64"
        } else {
            self.choice.name()
        }
    }

    /// Whether it is wrong on purpose.
    fn is_for_study(self) -> bool {
        matches!(self.choice, Choice::One(e) if e.capabilities().study)
    }

    /// Whether the scene and the parameter allow it.
    fn able(self, scene: &Scene, info: &ParamInfo) -> Result<(), RenderError> {
        match self.choice {
            Choice::One(e) => auto::able(scene, info, &[e]),
            Choice::Auto => auto::able(scene, info, &auto::candidates(scene)),
        }
        .map(|_| ())
    }

    fn from_name(name: &str) -> Result<Self, RenderError> {
        let others = [Self::single(Choice::Auto), Self::DOUBLE].map(|c| (c.name(), c));
        cli::estimator_or(name, &others, |e| Self::single(Choice::One(e)))
    }
}

impl fmt::Display for Contestant {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(self.name())
    }
}

impl Serialize for Contestant {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(self.name())
    }
}

/// What was found about one estimator.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Key of the parameter.
    pub param: String,
    /// The estimator, by its name.
    pub estimator: Contestant,
    /// Mean over pixels and channels, and its standard error.
    pub mean: [f64; 2],
    /// Difference of that to the reference's, in standard errors.
    pub z: f64,
    /// Largest such difference of a block.
    pub z_block: f64,
    /// What that says.
    pub finding: Finding,
    /// Variance of one sample of one pixel, mean over pixels and channels.
    pub variance: f64,
    /// Wall time of one sample of one pixel, median over the repeats, seconds.
    pub seconds_per_sample: f64,
    /// `1 / (variance x time)`; zero where nothing was seen, and the variance is zero.
    pub efficiency: f64,
    /// Samples that were not finite.
    pub non_finite: u64,
    /// Error against time: repeats, seconds so far, root mean square difference to the reference.
    pub ladder: Vec<(u64, f64, f64)>,
}

/// An estimator that the scene or the parameter rules out.
#[derive(Clone, Debug, Serialize)]
struct Refused {
    param: String,
    estimator: Contestant,
    reason: String,
}

#[derive(Debug, Serialize)]
struct Report {
    scene: String,
    reference: String,
    spp: u32,
    #[serde(flatten)]
    samples: SampleArgs,
    /// What walks of all images came to.
    #[serde(flatten)]
    solved: Option<SolvedReport>,
    repeats: u32,
    threads: usize,
    seed: u64,
    z_limit: f64,
    /// Parameters and the larger step of their differences, where those are the reference.
    steps: Vec<(String, f64)>,
    rows: Vec<Row>,
    refused: Vec<Refused>,
}

/// How an estimator differs from the truth where it does most.
struct Difference<'a> {
    truth: &'a Series,
    block: usize,
    /// In standard errors.
    z: f64,
    /// What is beyond chance.
    z_limit: f64,
}

/// Sums over repeats of derivative images.
struct Series {
    width: usize,
    n: u64,
    /// Of every pixel and channel.
    sum: Vec<f64>,
    squares: Vec<f64>,
    /// Of every block, per repeat.
    blocks: Vec<[f64; BLOCKS * BLOCKS]>,
    means: Vec<f64>,
    seconds: Vec<f64>,
    bad: NonFinite,
    walks: Walks,
    cumulative: Vec<(u64, f64, Vec<f64>)>,
    /// Error that more repeats would not reduce, per block, and that of the mean.
    systematic: ([f64; BLOCKS * BLOCKS], f64),
}

impl Series {
    fn new(scene: &Scene) -> Self {
        let [width, height] = scene.film.crop_size.map(|n| n as usize);
        Self {
            width,
            n: 0,
            sum: vec![0.0; width * height * 3],
            squares: vec![0.0; width * height * 3],
            blocks: Vec::new(),
            means: Vec::new(),
            seconds: Vec::new(),
            bad: NonFinite::default(),
            walks: Walks::default(),
            cumulative: Vec::new(),
            systematic: ([0.0; BLOCKS * BLOCKS], 0.0),
        }
    }

    /// Means over the blocks and over all of a derivative image.
    fn averages(&self, derivative: &[f64]) -> ([f64; BLOCKS * BLOCKS], f64) {
        let height = derivative.len() / 3 / self.width;
        let mut blocks = [0.0; BLOCKS * BLOCKS];
        let mut counts = [0.0f64; BLOCKS * BLOCKS];
        for (i, &x) in derivative.iter().enumerate() {
            let (px, py) = (i / 3 % self.width, i / 3 / self.width);
            let block = py * BLOCKS / height * BLOCKS + px * BLOCKS / self.width;
            blocks[block] += x;
            counts[block] += 1.0;
        }
        for (b, n) in blocks.iter_mut().zip(counts) {
            *b /= n.max(1.0);
        }
        (
            blocks,
            derivative.iter().sum::<f64>() / derivative.len() as f64,
        )
    }

    fn add(&mut self, derivative: &[f64], seconds: f64) {
        for (i, &x) in derivative.iter().enumerate() {
            self.sum[i] += x;
            self.squares[i] += x * x;
        }
        let (blocks, mean) = self.averages(derivative);
        self.n += 1;
        self.blocks.push(blocks);
        self.means.push(mean);
        self.seconds.push(seconds);
        if self.n.is_power_of_two() {
            let time = self.seconds.iter().sum();
            let n = self.n as f64;
            let image = self.sum.iter().map(|s| s / n).collect();
            self.cumulative.push((self.n, time, image));
        }
    }

    /// Each repeat took so much longer.
    fn add_time(&mut self, seconds: f64) {
        self.seconds.iter_mut().for_each(|s| *s += seconds);
        for (n, time, _) in &mut self.cumulative {
            *time += *n as f64 * seconds;
        }
    }

    /// Mean over block `b` of all repeats, and what chance does to it.
    fn by_chance(&self, b: usize) -> Estimate {
        let values: Vec<f64> = self.blocks.iter().map(|r| r[b]).collect();
        Estimate::of(&values)
    }

    /// Mean over block `b`, and its error.
    fn block(&self, b: usize) -> Estimate {
        let Estimate { mean, se } = self.by_chance(b);
        let se = se.hypot(self.systematic.0[b]);
        Estimate { mean, se }
    }

    /// Mean over pixels and channels, and its error.
    fn mean(&self) -> Estimate {
        let Estimate { mean, se } = Estimate::of(&self.means);
        let se = se.hypot(self.systematic.1);
        Estimate { mean, se }
    }

    /// The block that differs most from another series, and how many standard errors that is.
    fn worst_block(&self, truth: &Self) -> (usize, f64) {
        (0..BLOCKS * BLOCKS)
            .map(|b| (b, self.block(b).z(&truth.block(b))))
            .fold(
                (0, 0.0f64),
                |m, z| if z.1.abs() > m.1.abs() { z } else { m },
            )
    }

    /// What extrapolation changes, and the noise of so many repeats: root mean squares over the blocks.
    fn errors(&self, repeats: u64) -> [f64; 2] {
        let rms = |of: &dyn Fn(usize) -> f64| {
            let squares = (0..BLOCKS * BLOCKS).map(|b| of(b).powi(2));
            (squares.sum::<f64>() / (BLOCKS * BLOCKS) as f64).sqrt()
        };
        let noise = |b: usize| self.by_chance(b).se;
        let fewer = (self.n as f64 / repeats as f64).sqrt();
        [rms(&|b| self.systematic.0[b]), rms(&noise) * fewer]
    }

    /// All means may be wrong by this part of themselves.
    fn doubt(&mut self, relative: f64) {
        for b in 0..BLOCKS * BLOCKS {
            let doubt = relative * self.block(b).mean;
            self.systematic.0[b] = self.systematic.0[b].hypot(doubt);
        }
        self.systematic.1 = self.systematic.1.hypot(relative * self.mean().mean);
    }

    fn image(&self) -> Vec<f64> {
        self.sum.iter().map(|s| s / self.n as f64).collect()
    }

    /// Variance of one repeat, per pixel and channel.
    fn variance(&self) -> Vec<f64> {
        let n = self.n as f64;
        let of = |(s, q): (&f64, &f64)| ((q - s * s / n) / (n - 1.0)).max(0.0);
        self.sum.iter().zip(&self.squares).map(of).collect()
    }
}

/// Standard deviation image of one sample, mean over channels.
fn deviation(series: &Series, spp: f64) -> Vec<f64> {
    let variance = series.variance();
    let pixel = |v: &[f64]| (v.iter().sum::<f64>() / 3.0 * spp).sqrt();
    variance.chunks_exact(3).map(pixel).collect()
}

struct Run<'a> {
    /// Moves while it is differentiated by differences.
    scene: &'a mut Scene,
    settings: Settings,
    seed: u64,
    /// What walks came to so far.
    walks: Walks,
    interrupt: &'a Interrupt,
}

impl Run<'_> {
    /// `repeats` derivative images made by `make`, which gets a seed and renders `passes` images. `None` if
    /// interrupted.
    fn series(
        &mut self,
        what: &str,
        stream: u64,
        repeats: u64,
        passes: u64,
        mut make: impl FnMut(
            &mut Scene,
            u64,
            &dyn Progress,
        ) -> Result<(Rendering, Vec<f64>), RenderError>,
    ) -> Result<Option<Series>, ToolError> {
        let pixels = self.scene.film.pixels() as u64;
        let bar = Bar::new(what, repeats * passes * pixels, self.interrupt);
        let mut series = Series::new(self.scene);
        for k in 0..repeats {
            let seed = self.seed.wrapping_add((stream << 32) + k);
            let start = Instant::now();
            let (rendering, derivative) = make(self.scene, seed, &bar)?;
            if rendering.cancelled || self.interrupt.is_set() {
                bar.finish();
                return Ok(None);
            }
            series.bad.merge(&rendering.non_finite);
            let came_to = Walks::of_image(&rendering);
            self.walks.merge(&came_to);
            series.walks.merge(&came_to);
            series.add(&derivative, start.elapsed().as_secs_f64());
        }
        bar.finish();
        report_non_finite(&series.bad, series.width, self.seed);
        Ok(Some(series))
    }

    fn estimate(
        &mut self,
        e: Contestant,
        param: &str,
        stream: u64,
        repeats: u64,
    ) -> Result<Option<Series>, ToolError> {
        let settings = self.settings;
        let spp = u64::from(settings.spp);
        let start = Instant::now();
        if e.double {
            return self.double(param, stream, repeats);
        }
        let mixture = match e.choice {
            Choice::One(e) => Mixture::only(self.scene, e, &[param]),
            Choice::Auto => {
                let ones = vec![1.0; self.scene.film.pixels() * 3];
                let seed = self.seed.wrapping_add(stream << 32);
                let found = auto::choose(
                    &Job::new(
                        self.scene,
                        &settings,
                        seed,
                        0..spp * repeats,
                        self.interrupt,
                    ),
                    &[param],
                    &ones,
                    &auto::candidates(self.scene),
                    Mode::Forward,
                )?;
                if self.interrupt.is_set() {
                    return Ok(None);
                }
                print::out(format_args!("{found}"));
                found
            }
        };
        let pilots = start.elapsed().as_secs_f64() / repeats as f64;
        let series = self.series(e.name(), stream, repeats, 1, |scene, seed, bar| {
            let r = mixture.forward_f32(&Job::new(scene, &settings, seed, 0..spp, bar), param)?;
            let n = r.samples as f64;
            let image = r.sums[1].iter().map(|s| s / n).collect();
            Ok((r, image))
        })?;
        Ok(series.map(|mut series| {
            series.add_time(pilots);
            series
        }))
    }

    /// What single precision costs: the default estimator in double precision.
    fn double(
        &mut self,
        param: &str,
        stream: u64,
        repeats: u64,
    ) -> Result<Option<Series>, ToolError> {
        let along = Direction::uniform(self.scene.params(), param)?;
        let settings = self.settings;
        let spp = u64::from(settings.spp);
        let what = Contestant::DOUBLE.name();
        self.series(what, stream, repeats, 1, |scene, seed, bar| {
            let r = forward_f64(&Job::new(scene, &settings, seed, 0..spp, bar), &along)?;
            let n = r.samples as f64;
            let image = r.sums[1].iter().map(|s| s / n).collect();
            Ok((r, image))
        })
    }

    /// Central differences in f64 with common random numbers, and the larger one of their two steps. Light sampling is
    /// smooth in all parameters of materials where light takes one bounce; longer paths jump, and need a wider step. Where
    /// something moves, images jump at outlines, and pilots choose the step ([`check::widest_step`]).
    fn reference_differences(
        &mut self,
        info: &ParamInfo,
        repeats: u64,
    ) -> Result<Option<(Series, f64)>, ToolError> {
        let span = Span::of(self.scene, info);
        let (estimator, step) = if info.kind.is_motion() {
            if span.most <= 0.0 {
                return Err(ToolError::Usage(format!(
                    "--reference fd: a value of `{}` is at an end of its interval, and cannot move both ways",
                    info.name
                )));
            }
            let step = check::widest_step(span.most, |step| {
                let pilot = self.differences(
                    ("choosing a step", PILOT),
                    info,
                    (Estimator::Mis, step),
                    check::PILOTS,
                )?;
                Ok::<_, ToolError>(pilot.map(|pilot| pilot.errors(repeats)))
            })?;
            let Some(step) = step else { return Ok(None) };
            (Estimator::Mis, step)
        } else {
            let values = &self.scene.params().values()[info.range()];
            let largest = values.iter().fold(0.0f32, |m, v| m.max(v.abs()));
            let size = if largest > 0.0 { largest.into() } else { 1.0 };
            match self.settings.max_depth {
                0..=2 => (Estimator::Emitter, 2e-4 * size),
                _ => (Estimator::Mis, 2e-2 * size),
            }
        };
        let what = ("finite differences", 1);
        let found = self.differences(what, info, (estimator, step), repeats)?;
        Ok(found.map(|mut series| {
            series.doubt(span.rounding / step);
            (series, step)
        }))
    }

    /// Differences of this step and of half of it, extrapolated to none (Richardson); what that changes is an error of the
    /// result. The scene is where it was.
    fn differences(
        &mut self,
        (what, stream): (&str, u64),
        info: &ParamInfo,
        (estimator, step): (Estimator, f64),
        repeats: u64,
    ) -> Result<Option<Series>, ToolError> {
        let single = self.scene.params().values().to_vec();
        let settings = self.settings;
        let spp = u64::from(settings.spp);
        let mut doubts = vec![0.0; self.scene.film.pixels() * 3];
        let series = self.series(what, stream, repeats, 4, |scene, seed, bar| {
            let mut at = |step: f64| {
                let mut moved: Vec<f64> = single.iter().map(|&v| v.into()).collect();
                moved[info.range()].iter_mut().for_each(|v| *v += step);
                if info.kind.is_motion() {
                    let rounded: Vec<f32> = moved.iter().map(|&v| v as f32).collect();
                    scene.set_params(&rounded)?;
                    moved = rounded.into_iter().map(f64::from).collect();
                }
                let theta = Theta::constant(&moved);
                let job = Job::new(scene, &settings, seed, 0..spp, bar);
                Ok::<_, RenderError>(render_f64(&job, &theta, estimator))
            };
            let mut difference = |h: f64| {
                let (up, down) = (at(h)?, at(-h)?);
                let scale = 1.0 / (2.0 * h * up.samples as f64);
                let pairs = up.sums[0].iter().zip(&down.sums[0]);
                let image: Vec<f64> = pairs.map(|(a, b)| (a - b) * scale).collect();
                Ok::<_, RenderError>((up, image))
            };
            let ((last, near), (_, wide)) = (difference(0.5 * step)?, difference(step)?);
            let corrections = near.iter().zip(&wide).map(|(n, w)| (n - w) / 3.0);
            let mut image = near.clone();
            for ((x, doubt), c) in image.iter_mut().zip(&mut doubts).zip(corrections) {
                *x += c;
                *doubt += c / repeats as f64;
            }
            Ok((last, image))
        });
        // It may have been left while something had moved.
        let restored = self.scene.set_params(&single);
        let series = series?;
        restored?;
        Ok(series.map(|mut series| {
            series.systematic = series.averages(&doubts);
            series
        }))
    }

    /// What an estimator's difference from the truth in one block says. `None` if interrupted.
    fn finding(
        &mut self,
        contestant: Contestant,
        param: &str,
        stream: u64,
        repeats: u64,
        &Difference {
            truth,
            block,
            z: z_block,
            z_limit,
        }: &Difference,
    ) -> Result<Option<Finding>, ToolError> {
        if z_block.abs() <= z_limit {
            return Ok(Some(Finding::Right));
        }
        if contestant.is_for_study() {
            return Ok(Some(Finding::Biased));
        }
        let (stream, repeats) = (stream + SECOND_LOOK, MORE_REPEATS * repeats);
        let again = self.estimate(contestant, param, stream, repeats)?;
        Ok(again.map(|again| {
            let found = again.block(block);
            let truth = truth.block(block);
            let z = found.z(&truth);
            let again_so = z.abs() > z_limit && z * z_block > 0.0;
            // Where rare samples carry the variance, a block that has met none of them has an error that is too small;
            // those of all blocks know of them.
            let [_, noise] = again.errors(again.n);
            let beyond_noise = (found.mean - truth.mean).abs() > z_limit * noise;
            // Without any spread it has seen nothing there.
            if again_so && beyond_noise && found.se > 0.0 {
                Finding::Biased
            } else {
                Finding::Unresolved
            }
        }))
    }
}

/// Runs the tool.
///
/// # Errors
/// Anything wrong with the arguments, the scene or the files.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Outcome, ToolError> {
    let (mut scene, _) = args.load.load(&args.scene)?;
    let args = &Args {
        params: cli::names_of(&mut scene, &args.params)?,
        ..args.clone()
    };
    interrupt.keep();
    let mut settings = scene.settings;
    settings.spp = args.spp.unwrap_or(settings.spp);
    args.samples.apply(&scene, &mut settings)?;
    args.manifold.apply(&scene, &mut settings)?;
    settings.max_depth = args.max_depth.unwrap_or(settings.max_depth);
    let estimators = match &args.estimators[..] {
        [all] if all == "all" => {
            let all = Estimator::ALL.iter().map(|e| Choice::One(*e));
            let auto = Contestant::single(Choice::Auto);
            all.map(Contestant::single)
                .chain([Contestant::DOUBLE, auto])
                .collect()
        }
        names => {
            let found: Result<Vec<_>, _> = names.iter().map(|n| Contestant::from_name(n)).collect();
            found?
        }
    };
    // Wrong names are noticed before the first minute of work.
    let infos = args.params.iter().map(|p| scene.params().find(p).cloned());
    let infos = infos.collect::<Result<Vec<_>, _>>()?;
    for info in &infos {
        stays(&settings, info)?;
        let mut refusals = estimators.iter().map(|e| e.able(&scene, info));
        let first = refusals.next().unwrap_or(Ok(()));
        if refusals.all(|r| r.is_err()) {
            first?;
        }
    }
    let reference = reference(args.reference.as_deref(), &scene, &infos)?;
    let reports = [args.out.join("report.json")]
        .into_iter()
        .chain(args.json.clone());
    output::prepare(&reports.collect::<Vec<_>>(), &[&args.scene])?;

    let repeats = u64::from(args.repeats);
    let tests = BLOCKS * BLOCKS * estimators.len() * args.params.len();
    let z_limit = statistics::z_limit(tests, repeats, SIGNIFICANCE);
    args.threads.run(|threads| {
        (args.samples).learn(&mut scene, &settings, args.seed, interrupt);
        let mut run = Run {
            scene: &mut scene,
            settings,
            seed: args.seed,
            walks: Walks::default(),
            interrupt,
        };
        let mut report = Report {
            scene: args.scene.display().to_string(),
            reference: reference.map_or("fd", Contestant::name).into(),
            spp: settings.spp,
            samples: args.samples.filled(),
            solved: None,
            repeats: args.repeats,
            threads,
            seed: args.seed,
            z_limit,
            steps: Vec::new(),
            rows: Vec::new(),
            refused: Vec::new(),
        };
        for (param, info) in args.params.iter().zip(&infos) {
            let many = MORE_REPEATS * repeats;
            let truth = match reference {
                Some(e) => run.estimate(e, param, 1, many)?,
                None => run.reference_differences(info, many)?.map(|(truth, step)| {
                    report.steps.push((param.clone(), step));
                    truth
                }),
            };
            let Some(truth) = truth else {
                break;
            };
            let mut panels = Vec::new();
            for &e in &estimators {
                if let Err(reason) = e.able(run.scene, info) {
                    report.refused.push(Refused {
                        param: param.clone(),
                        estimator: e,
                        reason: reason.to_string(),
                    });
                    continue;
                }
                // The numbers of an estimator do not depend on which others are asked for.
                // Double precision has the random numbers of single precision: rounding is the difference.
                let place = (Estimator::ALL.iter()).position(|x| Choice::One(*x) == e.choice);
                let stream = 2 + place.unwrap_or(Estimator::ALL.len()) as u64;
                let Some(series) = run.estimate(e, param, stream, repeats)? else {
                    break;
                };
                let (block, z) = series.worst_block(&truth);
                let worst = Difference {
                    truth: &truth,
                    block,
                    z,
                    z_limit,
                };
                let finding = run.finding(e, param, stream, repeats, &worst)?;
                let Some(finding) = finding else {
                    break;
                };
                let labels = series.walks.labels(&settings, &series.bad);
                let deviation = deviation(&series, f64::from(settings.spp));
                panels.push((e.name(), deviation, labels));
                let row = row(param, e, &series, &truth, &settings, finding);
                say!("{}", line(&row));
                report.rows.push(row);
            }
            let labels = truth.walks.labels(&settings, &truth.bad);
            let reference = (&truth, &labels);
            write_images(&args.out, param, run.scene, reference, &panels)?;
            write_chart(&args.out, param, &report.rows)?;
            if interrupt.is_set() {
                break;
            }
        }
        report.solved = Some(run.walks.report(&settings));
        let verdict = verdict(&report);
        print::out(format_args!("{verdict}"));
        write_report(args, &report, &verdict)?;
        Ok(())
    })?;
    if interrupt.is_set() {
        complain!("interrupted: the estimators so far were written");
        return Ok(Outcome::Interrupted);
    }
    Ok(Outcome::Done)
}

/// The estimator that is the reference, if differences are not; by default the first one that sees the parameters.
fn reference(
    name: Option<&str>,
    scene: &Scene,
    infos: &[ParamInfo],
) -> Result<Option<Contestant>, ToolError> {
    let sees = |e: Contestant| infos.iter().try_for_each(|info| e.able(scene, info));
    let one = |e| Contestant::single(Choice::One(e));
    match name {
        Some("fd") => Ok(None),
        Some(name) => {
            let e = one(Estimator::from_name(name)?);
            match sees(e) {
                Ok(()) => Ok(Some(e)),
                Err(error) => Err(ToolError::Usage(format!("--reference {name}: {error}"))),
            }
        }
        None => {
            let [mis, edges, follows] = [
                Estimator::Mis,
                Estimator::Edges,
                Estimator::ReparameterisedMis,
            ]
            .map(one);
            match sees(mis) {
                Ok(()) => Ok(Some(mis)),
                // What it says of others names those that see them.
                Err(error) => match [edges, follows].into_iter().find(|e| sees(*e).is_ok()) {
                    Some(e) => Ok(Some(e)),
                    None => Err(sees(edges).err().unwrap_or(error).into()),
                },
            }
        }
    }
}

fn row(
    param: &str,
    e: Contestant,
    series: &Series,
    truth: &Series,
    settings: &Settings,
    finding: Finding,
) -> Row {
    let mean = series.mean();
    let variance = series.variance();
    let variance = variance.iter().sum::<f64>() / variance.len() as f64 * f64::from(settings.spp);
    let pixels = series.sum.len() as f64 / 3.0;
    let seconds_per_sample =
        median(&series.seconds).unwrap_or(0.0) / pixels / f64::from(settings.spp);
    let exact = truth.image();
    let rms = |image: &[f64]| {
        let squares = image.iter().zip(&exact).map(|(a, b)| (a - b).powi(2));
        (squares.sum::<f64>() / exact.len() as f64).sqrt()
    };
    Row {
        param: param.into(),
        estimator: e,
        mean: [mean.mean, mean.se],
        z: mean.z(&truth.mean()),
        z_block: series.worst_block(truth).1,
        finding,
        variance,
        seconds_per_sample,
        efficiency: if variance > 0.0 {
            1.0 / (variance * seconds_per_sample)
        } else {
            0.0
        },
        non_finite: series.bad.count,
        ladder: (series.cumulative.iter())
            .map(|(n, t, image)| (*n, *t, rms(image)))
            .collect(),
    }
}

fn line(r: &Row) -> String {
    format!(
        "{:<34} {:>12.5e} +- {:.1e}  z {:>6.2} (block {:>6.2})  variance {:.3e}  {:.2} us  efficiency {:.3e}{}",
        r.estimator,
        r.mean[0],
        r.mean[1],
        r.z,
        r.z_block,
        r.variance,
        r.seconds_per_sample * 1e6,
        r.efficiency,
        match r.finding {
            Finding::Right => String::new(),
            other => format!("  {}", other.name().to_uppercase()),
        }
    )
}

/// A few sentences.
fn verdict(report: &Report) -> String {
    let mut text = String::new();
    let mut params: Vec<&str> = report.rows.iter().map(|r| r.param.as_str()).collect();
    params.dedup();
    for param in params {
        let rows = || report.rows.iter().filter(|r| r.param == param);
        text += &format!("{param}:\n");
        if let Some((_, step)) = report.steps.iter().find(|(name, _)| name == param) {
            text += &format!(
                "  reference: differences of steps {step:.2e} and {:.2e}\n",
                0.5 * step
            );
        }
        let right = |r: &&Row| r.finding == Finding::Right && r.efficiency > 0.0;
        let sound = rows().filter(right);
        if let Some(best) = sound.max_by(|a, b| a.efficiency.total_cmp(&b.efficiency)) {
            text += &format!("  most efficient: {}", best.estimator);
            let usual = Contestant::DEFAULT;
            if let Some(row) = rows().find(|r| r.estimator == usual) {
                let gain = best.efficiency / row.efficiency;
                text += &format!(", {gain:.2} x {usual}");
            }
            text += "\n";
        }
        let mean = |of| rows().find(|r| r.estimator == of).map(|r| r.mean);
        let pair = [Contestant::DEFAULT, Contestant::DOUBLE].map(mean);
        if let [Some([single, error]), Some([double, _])] = pair {
            let off = (single - double).abs();
            text += &format!(
                "  single precision: mean off by {off:.1e} with equal random numbers, {:.2} standard errors\n",
                off / error
            );
        }
        for r in rows().filter(|r| r.finding != Finding::Right) {
            let on_purpose = r.estimator.is_for_study();
            let why = match r.finding {
                Finding::Unresolved => {
                    ": four times the samples do not confirm it; it hardly ever samples what matters there, and its \
                     variance says nothing"
                }
                Finding::Biased if !on_purpose => {
                    ": again so with four times the samples; wrong here, or blind to what the reference sees"
                }
                _ => "",
            };
            text += &format!(
                "  {}: {} (|z| {:.1} in a block, limit {:.1}){why}\n",
                r.finding.name(),
                r.estimator,
                r.z_block.abs(),
                report.z_limit
            );
        }
        for r in rows().filter(|r| r.variance == 0.0) {
            text += &format!(
                "  nothing seen: {} is {:e} everywhere\n",
                r.estimator, r.mean[0]
            );
        }
        for r in rows().filter(|r| r.non_finite > 0) {
            let (name, n) = (r.estimator, r.non_finite);
            text += &format!("  not finite: {n} samples of {name}\n");
        }
    }
    for r in &report.refused {
        text += &format!("  refused: {} for {}: {}\n", r.estimator, r.param, r.reason);
    }
    text
}

fn write_report(args: &Args, report: &Report, verdict: &str) -> Result<(), ToolError> {
    let mut table = String::from(
        "param,estimator,mean,std_error,z,z_block,finding,variance,seconds_per_sample,efficiency,non_finite\n",
    );
    let mut ladder = String::from("param,estimator,repeats,seconds,rms_error\n");
    for r in &report.rows {
        let [mean, error] = r.mean;
        table += &format!(
            "{},{},{mean},{error},{},{},{},{},{},{},{}\n",
            r.param,
            r.estimator,
            r.z,
            r.z_block,
            r.finding.name(),
            r.variance,
            r.seconds_per_sample,
            r.efficiency,
            r.non_finite
        );
        for (n, t, error) in &r.ladder {
            ladder += &format!("{},{},{n},{t},{error}\n", r.param, r.estimator);
        }
    }
    let write = |name: &str, text: &str| {
        image_io::write_atomically(&args.out.join(name), text.as_bytes()).map_err(ToolError::from)
    };
    write("table.csv", &table)?;
    write("ladder.csv", &ladder)?;
    write("verdict.txt", verdict)?;
    output::write_json(&args.out.join("report.json"), report)?;
    if let Some(path) = &args.json {
        output::write_json(path, report)?;
    }
    Ok(())
}

fn write_chart(out: &Path, param: &str, rows: &[Row]) -> Result<(), ToolError> {
    let title = format!("derivative in {param}: error against time");
    let mut chart = LineChart::new(&title, "wall time (s)", "RMS error of the derivative image")
        .log_x()
        .log_y();
    for r in rows.iter().filter(|r| r.param == param) {
        let label = match r.finding {
            Finding::Right => r.estimator.to_string(),
            other => format!("{} ({})", r.estimator, other.name()),
        };
        let points = r.ladder.iter().map(|(_, t, e)| (*t, *e));
        chart = chart.measured(&label, points);
    }
    output::write_chart(
        &out.join(format!("{}.error.svg", output::file_name(param))),
        &chart,
    )
}

/// The reference's derivative image, and the standard deviation of each estimator on one scale, with what files say of them.
fn write_images(
    out: &Path,
    param: &str,
    scene: &Scene,
    (truth, labels): (&Series, &Labels),
    deviations: &[(&str, Vec<f64>, Labels)],
) -> Result<(), ToolError> {
    let [width, height] = scene.film.crop_size.map(|n| n as usize);
    let name = output::file_name(param);
    let mut image = Image::new(width, height);
    for (o, x) in image.data.iter_mut().zip(truth.image()) {
        *o = x as f32;
    }
    let file = out.join(format!("{name}.reference.exr"));
    image_io::write_exr_with(&file, &image, None, labels)?;
    let mut panels = vec![output::signed_panel("reference", &image)];
    let mut all: Vec<f64> = deviations
        .iter()
        .flat_map(|d| d.1.iter().copied())
        .collect();
    // Most pixels may not depend on the parameter at all.
    let largest = all.iter().copied().fold(0.0, f64::max);
    all.retain(|x| *x > 1e-3 * largest);
    all.sort_by(f64::total_cmp);
    let scale = all.get(all.len() * 8 / 10).copied().unwrap_or(1.0);
    for (estimator, values, labels) in deviations {
        let mut image = Image::new(width, height);
        for (o, &x) in image.data.chunks_exact_mut(3).zip(values) {
            o.fill(x as f32);
        }
        let file = out.join(format!("{name}.std.{estimator}.exr"));
        image_io::write_exr_with(&file, &image, None, labels)?;
        let label = format!("std: {estimator}");
        let panel = Panel::signed(&label, width, values, Some(scale));
        panels.push(output::readable(panel));
    }
    let columns = panels.len().min(4);
    let path = out.join(format!("{name}.std.png"));
    let png = crate::chart::grid(columns, &panels).map_err(|e| ToolError::file(&path, e))?;
    Ok(image_io::write_atomically(&path, &png)?)
}
