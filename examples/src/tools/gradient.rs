//! `gradient`: derivatives of an image, or of a loss, with respect to a scene's parameters.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Parser;
use optim::{Loss, LossKind, OptimError};
use render::Job;
use render::auto::{self, Mixture};
use render::image_io::Labels;
use render::instances::{Direction, Estimator, Mode, forward_f32, render_f32};
use render::integrator::render::{NonFinite, Progress, stays};
use render::params::{ParamInfo, ParamKind, ParamShape, Theta};
use render::scene::LightChoice;
use render::{Image, Scene, Settings, image_io};
use serde::Serialize;

use crate::cli::{
    self, Choice, ListArgs, LoadArgs, Outcome, SampleArgs, ThreadArgs, ToolError, depth,
    report_non_finite, sample_count,
};
use crate::output;
use crate::progress::{Bar, Interrupt};
use crate::ranks::median;
use crate::solved::{ManifoldArgs, SolvedReport, Walks};
use crate::{complain, print, say};

pub mod check;

const EXAMPLES: &str = "\
Examples:
  gradient scene.xml --list
  gradient scene.xml --param red.reflectance.value --repeats 8 --json out.json
  gradient scene.xml --param a.alpha.value --loss l2 --target photo.exr
  gradient scene.xml --param a.alpha.value --images folder
  gradient scene.xml --param lamp.emitter.radiance.value --measure-lights
  gradient scene.xml --param a.alpha.value --estimator differential-mis --measure-pixels
  gradient scene.xml --param a.alpha.value --estimator differential-mis --check

The objective is the mean of all pixel values and channels, unless --adjoint or --loss is given. Standard
errors come from independent repeats. With --loss, the image that the loss sees is rendered with other
random numbers than the gradient. Gradients of textures are written as EXR beside the JSON.
Ctrl-C keeps the repeats so far (exit code 130).

With --check, every derivative is compared with central differences of the image in double precision: value by
value, or along four random directions for textures. Differences use common random numbers and a step that
pilots choose; two steps are extrapolated, and what that changes counts as an error. Right: both agree, and an
error of --tolerance would have been noticed (exit code 0). Wrong: they differ beyond chance (significance 1e-3
over all derivatives), and again with four times the repeats and a quarter of the step (exit code 3). Cannot
tell: the noise of --spp and --repeats, or what the step changes, is too large for either (exit code 4). Without
--param: all parameters that the estimator sees. With --loss the adjoint image is held fixed: what noise does to
a loss is not judged.";

/// The help of `--estimator`.
fn estimators() -> String {
    let of_use = Estimator::ALL.iter().filter(|e| !e.capabilities().study);
    let names: Vec<&str> = of_use.map(|e| e.name()).collect();
    format!(
        "Where derivatives flow: {}; `--list-estimators` says what each does and refuses. Or auto: pilots choose and mix, for the \
         work of as many samples of mis",
        names.join(", ")
    )
}

/// Differentiates an image of a scene, in reverse mode
#[derive(Parser, Clone, Debug)]
#[command(name = "gradient", after_help = EXAMPLES)]
pub struct Args {
    /// Scene file, Mitsuba XML
    pub scene: PathBuf,
    /// Parameter to differentiate with respect to; may be given several times
    #[arg(long = "param", value_name = "KEY", required_unless_present_any = ["list", "check"])]
    pub params: Vec<String>,
    /// Print the scene's parameters and do nothing else
    #[arg(long)]
    pub list: bool,
    /// Say whether the gradient is right, by central differences
    #[arg(long, conflicts_with_all = ["list", "images"])]
    pub check: bool,
    /// Smallest relative error of a derivative that --check has to notice before it says right
    #[arg(long, value_name = "X", default_value_t = 0.1, value_parser = tolerance, requires = "check")]
    pub tolerance: f64,
    /// Scene options
    #[command(flatten)]
    pub load: LoadArgs,
    /// Where derivatives flow
    #[arg(long, value_name = "NAME", default_value = "mis", value_parser = cli::estimator, help = estimators())]
    pub estimator: Choice,
    /// Samples per pixel and repeat [default: the scene's]
    #[arg(long, value_name = "N", value_parser = sample_count())]
    pub spp: Option<u32>,
    /// How samples are made
    #[command(flatten)]
    pub samples: SampleArgs,
    /// Light over specular chains
    #[command(flatten)]
    pub manifold: ManifoldArgs,
    /// Pilots choose how often each light is sampled, for these parameters [default: as the scene says]
    #[arg(long)]
    pub measure_lights: bool,
    /// A short pass before decides how often each pixel is sampled, for these parameters [default: as often]
    #[arg(long)]
    pub measure_pixels: bool,
    /// Largest number of path edges; -1 for no limit [default: the scene's]
    #[arg(long, value_name = "N", value_parser = depth)]
    pub max_depth: Option<u32>,
    /// Seed of the first repeat; the others follow
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Independent repeats; two or more give standard errors [default: 1; with --check 32, and at least 4]
    #[arg(long, value_name = "K", default_value_t = 1, default_value_if("check", "true", "32"),
          hide_default_value = true, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub repeats: u32,
    /// Derivative of the objective with respect to every pixel, as an image
    #[arg(long, value_name = "IMG.EXR", conflicts_with_all = ["loss", "target"])]
    pub adjoint: Option<PathBuf>,
    /// Loss between image and target: l1, l2 (mse), relative-l1, relative-l2, log-l2
    #[arg(long, value_name = "NAME", requires = "target")]
    pub loss: Option<LossKind>,
    /// Target image of the loss, or a layer of one
    #[arg(long, value_name = "IMG.EXR[:LAYER]", requires = "loss")]
    pub target: Option<PathBuf>,
    /// Write values, gradients, errors and times to this file
    #[arg(long, value_name = "OUT.JSON")]
    pub json: Option<PathBuf>,
    /// Write the derivative of every pixel with respect to each parameter (forward mode) to this
    /// folder, as EXR and in false colours
    #[arg(long, value_name = "DIR")]
    pub images: Option<PathBuf>,
    /// Threads
    #[command(flatten)]
    pub threads: ThreadArgs,
    /// What there is
    #[command(flatten)]
    pub list_estimators: ListArgs,
}

/// Numbers in the report, or the image that holds them.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Numbers {
    Values(Vec<f64>),
    File(String),
}

#[derive(Debug, Serialize)]
struct ParamReport {
    value: Numbers,
    gradient: Numbers,
    /// None with a single repeat.
    std_error: Option<Numbers>,
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct Report {
    scene: String,
    estimator: &'static str,
    /// What `auto` chose, and why.
    #[serde(skip_serializing_if = "Option::is_none")]
    mixture: Option<String>,
    spp: u32,
    #[serde(flatten)]
    samples: SampleArgs,
    #[serde(flatten)]
    solved: SolvedReport,
    /// What `--measure-lights` found, per emitter.
    #[serde(skip_serializing_if = "Option::is_none")]
    sampling_weights: Option<Vec<f64>>,
    /// Image of the weights that `--measure-pixels` found, beside this file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pixel_weights: Option<String>,
    repeats: u64,
    threads: usize,
    /// What `--guide`, `--measure-lights`, `--measure-pixels` and the pilots of `auto` took, once.
    seconds_pilots: f64,
    seconds_primal: f64,
    seconds_gradient: f64,
    /// Mean over the repeats; only with `--loss`.
    #[serde(skip_serializing_if = "Option::is_none")]
    loss: Option<f64>,
    params: BTreeMap<String, ParamReport>,
}

/// What the gradient is taken of.
enum Objective {
    /// The scalar product of the image with this one.
    Linear(Vec<f32>),
    /// A loss between the image and this one.
    Loss(LossKind, Vec<f32>),
}

impl Objective {
    /// What pilots measure: the derivative with respect to the image.
    fn adjoint(
        &self,
        args: &Args,
        scene: &Scene,
        settings: &Settings,
        progress: &dyn Progress,
    ) -> Result<Vec<f32>, ToolError> {
        match self {
            Self::Linear(adjoint) => Ok(adjoint.clone()),
            Self::Loss(loss, target) => {
                let theta = Theta::constant(scene.params().values());
                let (seed, samples) = (seed_of_loss(args.seed), 0..u64::from(settings.spp));
                let job = Job::new(scene, settings, seed, samples, progress);
                let image = render_f32(&job, &theta, Estimator::Mis);
                let mut adjoint = vec![0.0; target.len()];
                loss.gradient(&image.image(0).data, target, &mut adjoint)?;
                Ok(adjoint)
            }
        }
    }
}

/// A tolerance: a part of one.
fn tolerance(text: &str) -> Result<f64, String> {
    let found = text.parse::<f64>().ok().filter(|x| *x > 0.0 && *x < 1.0);
    found.ok_or_else(|| "expected a number between 0 and 1".into())
}

/// Runs the tool.
///
/// # Errors
/// Anything wrong with the arguments, the scene or the files.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Outcome, ToolError> {
    let (mut scene, _) = args.load.load(&args.scene)?;
    if args.list {
        print::out(format_args!("{}", listing(&scene)));
        return Ok(Outcome::Done);
    }
    let args = &Args {
        params: cli::names_of(&mut scene, &args.params)?,
        ..args.clone()
    };
    if args.measure_lights && args.samples.lights == Some(LightChoice::All) {
        let message = "--measure-lights: all lights are sampled alike; expected --lights one";
        return Err(ToolError::Usage(message.into()));
    }
    let mut settings = scene.settings;
    settings.spp = args.spp.unwrap_or(settings.spp);
    args.samples.apply(&scene, &mut settings)?;
    args.manifold.apply(&scene, &mut settings)?;
    settings.max_depth = args.max_depth.unwrap_or(settings.max_depth);
    for name in &args.params {
        stays(&settings, scene.params().find(name)?)?;
    }
    if let Choice::One(e) = args.estimator {
        args.samples.check_guided(e)?;
        e.check(&scene)?;
        e.active(&scene, &args.params)?;
        cli::warn_of_failures(e);
        cli::warn_of_unsampled(&scene, e);
        cli::warn_of_crossings(&scene, e, &args.params);
    }
    let ranges = ranges(args, &scene)?;
    let objective = objective(args, &scene)?;
    interrupt.keep();
    let read = [
        Some(&args.scene),
        args.adjoint.as_ref(),
        args.target.as_ref(),
    ];
    let read: Vec<&Path> = read.into_iter().flatten().map(PathBuf::as_path).collect();
    if args.check {
        return check::run(args, &mut scene, &settings, &objective, &read, interrupt);
    }
    output::prepare(&files(args, &ranges), &read)?;

    let (statistics, images, learned, threads) = args.threads.run(|threads| {
        let mut learned = learn(args, &mut scene, &settings, &objective, interrupt)?;
        let Some(mixture) = learned.mixture.take() else {
            return Ok((None, Vec::new(), learned, threads));
        };
        let mut statistics = repeat(args, &scene, &settings, &mixture, &objective, interrupt)?;
        let images = match (&args.images, &mut statistics) {
            (Some(_), Some(Statistics { walks, .. })) if !interrupt.is_set() => {
                gradient_images(args, &scene, &settings, &mixture, &ranges, walks, interrupt)?
            }
            _ => Vec::new(),
        };
        Ok((statistics.map(|s| (s, mixture)), images, learned, threads))
    })?;
    let Some((statistics, mixture)) = statistics else {
        complain!("interrupted before the first repeat was complete: nothing was written");
        return Ok(Outcome::Interrupted);
    };
    statistics.check(&ranges)?;
    for (info, (image, _)) in ranges.iter().zip(&images) {
        let pixels = image.data.iter().map(|&x| f64::from(x));
        require_finite("derivative image", info, pixels)?;
    }
    statistics.print(&scene, &ranges);
    let solved = statistics.walks.report(&settings);
    if let Some(dir) = &args.images {
        for (info, (image, labels)) in ranges.iter().zip(&images) {
            let [exr, png] = image_files(dir, info);
            image_io::write_exr_with(&exr, image, None, labels)?;
            let panel = output::signed_panel(&format!("d image / d {}", info.name), image);
            output::write_panels(&png, 1, &[panel])?;
        }
    }
    if let Some(path) = &args.json {
        let report = Report {
            scene: args.scene.display().to_string(),
            estimator: args.estimator.name(),
            mixture: (args.estimator == Choice::Auto).then(|| mixture.to_string()),
            spp: settings.spp,
            samples: args.samples.filled(),
            solved,
            sampling_weights: learned.weights,
            pixel_weights: (learned.pixels.map(|p| pixel_image(&scene, &p, path))).transpose()?,
            repeats: statistics.repeats,
            threads,
            seconds_pilots: learned.seconds,
            seconds_primal: median(&statistics.seconds_primal).unwrap_or(0.0),
            seconds_gradient: median(&statistics.seconds_gradient).unwrap_or(0.0),
            loss: statistics.loss(),
            params: statistics.params(&scene, &ranges, path)?,
        };
        output::write_json(path, &report)?;
    }
    if interrupt.is_set() {
        complain!(
            "interrupted: {} of {} repeats were complete",
            statistics.repeats,
            args.repeats
        );
        return Ok(Outcome::Interrupted);
    }
    Ok(Outcome::Done)
}

/// What is learned before the first repeat.
#[derive(Default)]
struct Learned {
    /// None if interrupted.
    mixture: Option<Mixture>,
    /// What `--measure-lights` found, and `--measure-pixels`.
    weights: Option<Vec<f64>>,
    pixels: Option<Vec<f32>>,
    seconds: f64,
}

/// Learns what was asked for, and tells the scene.
fn learn(
    args: &Args,
    scene: &mut Scene,
    settings: &Settings,
    objective: &Objective,
    interrupt: &Interrupt,
) -> Result<Learned, ToolError> {
    let start = Instant::now();
    let mut out = Learned::default();
    (args.samples).learn(scene, settings, args.seed, interrupt);
    if args.measure_lights {
        let Some(found) = measure_lights(args, scene, settings, objective, interrupt)? else {
            return Ok(out);
        };
        scene.set_sampling_weights(&found)?;
        out.weights = Some(found);
    }
    if args.measure_pixels {
        let Some(found) = measure_pixels(args, scene, settings, objective, interrupt)? else {
            return Ok(out);
        };
        scene.set_pixel_weights(&found)?;
        out.pixels = Some(found);
    }
    out.mixture = mixture(args, scene, settings, objective, interrupt)?;
    out.seconds = start.elapsed().as_secs_f64();
    Ok(out)
}

/// The parameters asked for, each once.
fn ranges(args: &Args, scene: &Scene) -> Result<Vec<ParamInfo>, ToolError> {
    let mut out: Vec<ParamInfo> = Vec::new();
    for name in &args.params {
        let info = scene.params().find(name)?;
        if !out.contains(info) {
            out.push(info.clone());
        }
    }
    Ok(out)
}

/// All files that the arguments ask for.
fn files(args: &Args, ranges: &[ParamInfo]) -> Vec<PathBuf> {
    let mut out = Vec::new();
    if let Some(dir) = &args.images {
        out.extend(ranges.iter().flat_map(|info| image_files(dir, info)));
    }
    if let Some(json) = &args.json {
        out.push(json.clone());
        if args.measure_pixels {
            out.push(pixel_file(json));
        }
        let textures = (ranges.iter()).filter(|i| matches!(i.shape, ParamShape::Texture { .. }));
        for info in textures {
            out.extend(["value", "gradient"].map(|what| texture_file(info, what, json)));
            if args.repeats > 1 {
                out.push(texture_file(info, "std_error", json));
            }
        }
    }
    out
}

/// The derivative image of a parameter, as numbers and in false colours.
fn image_files(dir: &Path, info: &ParamInfo) -> [PathBuf; 2] {
    let name = output::file_name(&info.name);
    ["exr", "png"].map(|extension| dir.join(format!("{name}.{extension}")))
}

/// The image of what `--measure-pixels` found, beside `json`.
fn pixel_file(json: &Path) -> PathBuf {
    output::beside(json, "pixel_weights.exr")
}

/// The image of a texture's numbers, beside `json`.
fn texture_file(info: &ParamInfo, what: &str, json: &Path) -> PathBuf {
    let suffix = format!("{}.{what}.exr", output::file_name(&info.name));
    output::beside(json, &suffix)
}

/// The estimator that lights and pixels are measured with.
fn measuring(args: &Args) -> Estimator {
    match args.estimator {
        Choice::One(e) => e,
        Choice::Auto => Estimator::MisBalance,
    }
}

/// How often to sample each pixel, as a short pass tells; says how much they differ. `None` if
/// interrupted.
fn measure_pixels(
    args: &Args,
    scene: &Scene,
    settings: &Settings,
    objective: &Objective,
    interrupt: &Interrupt,
) -> Result<Option<Vec<f32>>, ToolError> {
    let (names, estimator) = (&args.params, measuring(args));
    let adjoint = objective.adjoint(args, scene, settings, interrupt)?;
    let seed = args.seed;
    let weights =
        auto::pixel_weights(scene, names, &adjoint, estimator, settings, seed, interrupt)?;
    if interrupt.is_set() {
        return Ok(None);
    }
    let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
    let mut sorted = weights.clone();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let mut sum = 0.0;
    let half = sorted.iter().take_while(|&&w| {
        sum += f64::from(w);
        sum < 0.5 * total
    });
    let part = 100.0 * half.count() as f64 / weights.len().max(1) as f64;
    say!("half of the samples: in {part:.0} % of the pixels");
    Ok(Some(weights))
}

/// Weights of pixels as an image beside `json`.
fn pixel_image(scene: &Scene, weights: &[f32], json: &Path) -> Result<String, ToolError> {
    let [width, height] = scene.film.crop_size.map(|n| n as usize);
    let mut image = Image::new(width, height);
    image.data = weights.iter().flat_map(|&w| [w; 3]).collect();
    let path = pixel_file(json);
    image_io::write_exr(&path, &image)?;
    Ok(path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned())
}

/// How often to sample each light, as pilots tell; says so. `None` if interrupted.
fn measure_lights(
    args: &Args,
    scene: &Scene,
    settings: &Settings,
    objective: &Objective,
    interrupt: &Interrupt,
) -> Result<Option<Vec<f64>>, ToolError> {
    let estimator = measuring(args);
    let names = &args.params;
    let adjoint = objective.adjoint(args, scene, settings, interrupt)?;
    let seed = args.seed;
    let weights =
        auto::sampling_weights(scene, names, &adjoint, estimator, settings, seed, interrupt)?;
    if interrupt.is_set() {
        return Ok(None);
    }
    let total: f64 = weights.iter().sum();
    let parts = weights
        .iter()
        .map(|w| format!("{:.0} %", 100.0 * w / total));
    let parts: Vec<String> = parts.collect();
    say!("samples of lights: {}", parts.join(", "));
    Ok(Some(weights))
}

/// The estimator asked for, or what pilots choose; says what that is. `None` if interrupted.
fn mixture(
    args: &Args,
    scene: &Scene,
    settings: &Settings,
    objective: &Objective,
    interrupt: &Interrupt,
) -> Result<Option<Mixture>, ToolError> {
    let names = &args.params;
    let estimator = match args.estimator {
        Choice::One(e) => e,
        Choice::Auto => {
            let spp = u64::from(settings.spp);
            let budget = spp * u64::from(args.repeats);
            let most = auto::PILOTS * budget as f64 * scene.film.pixels() as f64;
            let bar = Bar::new("pilots", most as u64, interrupt);
            let adjoint = objective.adjoint(args, scene, settings, &bar)?;
            let found = auto::choose(
                &Job::new(scene, settings, args.seed, 0..budget, &bar),
                names,
                &adjoint,
                &auto::candidates(scene),
                Mode::Reverse,
            )?;
            bar.finish();
            if interrupt.is_set() {
                return Ok(None);
            }
            print::out(format_args!("{found}"));
            return Ok(Some(found));
        }
    };
    Ok(Some(Mixture::only(scene, estimator, names)))
}

/// The arrangement of a parameter.
fn arrangement(shape: ParamShape) -> String {
    match shape {
        ParamShape::Scalar => "scalar".to_owned(),
        ParamShape::Rgb => "rgb".to_owned(),
        ParamShape::Vector => "vector".to_owned(),
        ParamShape::Points { count } => format!("{count} x 3"),
        ParamShape::Texture {
            height,
            width,
            channels,
        } => format!("{height} x {width} x {channels}"),
    }
}

/// A line per parameter, and one for what becomes a parameter when somebody asks for it.
fn listing(scene: &Scene) -> String {
    let infos = scene.params().infos();
    let movables = scene.movables();
    let names = infos.iter().map(|i| &i.name);
    let matrices = scene.matrices();
    let names = names.chain(movables.iter().map(|m| &m.name));
    let names = names.chain(matrices.iter().map(|(name, _)| name));
    let wide = names.map(String::len).max().unwrap_or(0);
    let other = |info| scene.params().other_name(info);
    let mut text = String::new();
    for info in infos {
        let values = &scene.params().values()[info.range()];
        let shape = arrangement(info.shape);
        let value = if values.len() <= 3 {
            format!("{values:?}")
        } else {
            let sum: f64 = values.iter().map(|&v| f64::from(v)).sum();
            format!("mean {:.6}", sum / values.len() as f64)
        };
        let note = if info.kind == ParamKind::Delta {
            "  (moves a Dirac delta: no detached derivative)"
        } else {
            ""
        };
        let (lo, hi) = info.valid;
        let also = other(info).map_or(String::new(), |name| format!("  also {name}"));
        let line = format!(
            "{:wide$}  {shape:16}  in [{lo}, {hi}]  {value}{also}{note}\n",
            info.name
        );
        text.push_str(&line);
    }
    for movable in movables {
        let (lo, hi) = movable.valid;
        let line = format!(
            "{:wide$}  {:16}  in [{lo}, {hi}]  (moves: estimators with `motion`)\n",
            movable.name,
            arrangement(movable.shape)
        );
        text.push_str(&line);
    }
    for (name, matrix) in matrices {
        let matrix = matrix.to_f32();
        let values: Vec<String> = (matrix.as_flattened().iter())
            .map(|x| (x + 0.0).to_string())
            .collect();
        let values = values.join(",");
        text.push_str(&format!(
            "{name:wide$}  {:16}  {values}  (is set and read; has no derivative)\n",
            "4 x 4"
        ));
    }
    text
}

fn objective(args: &Args, scene: &Scene) -> Result<Objective, ToolError> {
    let size = scene.film.crop_size.map(|n| n as usize);
    let read = |path: &Path| Ok::<_, ToolError>(output::read_image(path, size)?.data);
    match (&args.adjoint, &args.loss, &args.target) {
        (Some(path), _, _) => Ok(Objective::Linear(read(path)?)),
        (_, Some(loss), Some(path)) => Ok(Objective::Loss(*loss, read(path)?)),
        _ => {
            let n = scene.film.pixels() * 3;
            Ok(Objective::Linear(vec![(1.0 / n as f64) as f32; n]))
        }
    }
}

/// Sums over independent repeats.
struct Statistics {
    repeats: u64,
    /// Mean gradient, per range.
    mean: Vec<Vec<f64>>,
    /// Sum of squared deviations from the mean [Welford 1962]; empty until the second repeat.
    squares: Vec<Vec<f64>>,
    losses: Vec<f64>,
    walks: Walks,
    seconds_primal: Vec<f64>,
    seconds_gradient: Vec<f64>,
}

impl Statistics {
    fn add(&mut self, gradient: Vec<Vec<f64>>) {
        self.repeats += 1;
        if self.repeats == 1 {
            self.mean = gradient;
            return;
        }
        if self.squares.is_empty() {
            self.squares = self.mean.iter().map(|m| vec![0.0; m.len()]).collect();
        }
        let n = self.repeats as f64;
        for ((mean, squares), new) in self.mean.iter_mut().zip(&mut self.squares).zip(gradient) {
            for ((m, s), x) in mean.iter_mut().zip(squares).zip(new) {
                let before = x - *m;
                *m += before / n;
                *s += before * (x - *m);
            }
        }
    }

    /// Standard error of the mean of range `r`.
    fn std_error(&self, r: usize) -> Option<Vec<f64>> {
        let n = self.repeats as f64;
        let squares = self.squares.get(r)?;
        Some(squares.iter().map(|s| (s / (n - 1.0) / n).sqrt()).collect())
    }

    /// Means and standard errors are numbers: lights and adjoints near the end of single precision overflow.
    fn check(&self, ranges: &[ParamInfo]) -> Result<(), ToolError> {
        for (r, info) in ranges.iter().enumerate() {
            // As they are written.
            let written = |x: f64| match info.shape {
                ParamShape::Texture { .. } => f64::from(x as f32),
                _ => x,
            };
            let mean = self.mean[r].iter().copied();
            require_finite("gradient", info, mean.map(written))?;
            if let Some(error) = self.std_error(r) {
                require_finite("standard error", info, error.into_iter().map(written))?;
            }
        }
        Ok(())
    }

    fn loss(&self) -> Option<f64> {
        let n = self.losses.len();
        (n > 0).then(|| self.losses.iter().sum::<f64>() / n as f64)
    }

    fn print(&self, scene: &Scene, ranges: &[ParamInfo]) {
        if let Some(loss) = self.loss() {
            say!("loss {loss:.6e}");
        }
        for (r, info) in ranges.iter().enumerate() {
            let values = &scene.params().values()[info.range()];
            let error = self.std_error(r);
            if values.len() <= 3 {
                for (i, (value, gradient)) in values.iter().zip(&self.mean[r]).enumerate() {
                    let error = match &error {
                        Some(e) => format!(" +- {:.2e}", e[i]),
                        None => String::new(),
                    };
                    let name = &info.name;
                    say!("{name}[{i}] = {value}: {gradient:.6e}{error}");
                }
            } else {
                let sum: f64 = self.mean[r].iter().sum();
                say!("{}: {} values, sum {sum:.6e}", info.name, values.len());
            }
        }
        say!(
            "{} repeats: {:.3} s primal, {:.3} s gradient each",
            self.repeats,
            median(&self.seconds_primal).unwrap_or(0.0),
            median(&self.seconds_gradient).unwrap_or(0.0)
        );
    }

    /// The report's parameters; textures are written beside `json`.
    fn params(
        &self,
        scene: &Scene,
        ranges: &[ParamInfo],
        json: &Path,
    ) -> Result<BTreeMap<String, ParamReport>, ToolError> {
        let mut out = BTreeMap::new();
        for (r, info) in ranges.iter().enumerate() {
            let value = &scene.params().values()[info.range()];
            let value = value.iter().map(|&v| f64::from(v)).collect();
            let put = |what: &str, numbers: Vec<f64>| numbers_or_file(info, what, numbers, json);
            let report = ParamReport {
                value: put("value", value)?,
                gradient: put("gradient", self.mean[r].clone())?,
                std_error: match self.std_error(r) {
                    Some(e) => Some(put("std_error", e)?),
                    None => None,
                },
            };
            out.insert(info.name.clone(), report);
        }
        Ok(out)
    }
}

/// An error for the first number of a parameter that is not finite.
fn require_finite(
    what: &'static str,
    info: &ParamInfo,
    numbers: impl IntoIterator<Item = f64>,
) -> Result<(), ToolError> {
    match numbers
        .into_iter()
        .enumerate()
        .find(|(_, x)| !x.is_finite())
    {
        None => Ok(()),
        Some((index, value)) => Err(ToolError::Optim(OptimError::NonFiniteValue {
            what,
            index,
            value,
            group: Some(info.name.clone()),
        })),
    }
}

/// A texture as an image beside `json`, anything else as numbers.
fn numbers_or_file(
    info: &ParamInfo,
    what: &str,
    numbers: Vec<f64>,
    json: &Path,
) -> Result<Numbers, ToolError> {
    let ParamShape::Texture {
        height,
        width,
        channels,
    } = info.shape
    else {
        return Ok(Numbers::Values(numbers));
    };
    let path = texture_file(info, what, json);
    output::write_texture(&path, [height, width, channels], &numbers)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    Ok(Numbers::File(name.into_owned()))
}

/// The seed of the image that a loss sees: other random numbers than those of the gradient, since with
/// common ones even the squared error is biased (errata Z-4.4).
fn seed_of_loss(seed: u64) -> u64 {
    !seed
}

/// Gradients with independent seeds. `None` if interrupted before the first is complete.
fn repeat(
    args: &Args,
    scene: &Scene,
    settings: &Settings,
    mixture: &Mixture,
    objective: &Objective,
    interrupt: &Interrupt,
) -> Result<Option<Statistics>, ToolError> {
    /// Primal renders that only serve to be timed.
    const TIMED: u64 = 3;
    let theta = Theta::constant(scene.params().values());
    let spp = u64::from(settings.spp);
    let pixels = scene.film.pixels() as u64;
    let repeats = u64::from(args.repeats);
    let primals = match objective {
        Objective::Linear(_) => repeats.min(TIMED),
        Objective::Loss(..) => repeats,
    };
    let passes = repeats * mixture.passes(spp).len() as u64 + primals;
    let bar = Bar::new("gradient", pixels * passes, interrupt);
    let mut out = Statistics {
        repeats: 0,
        mean: Vec::new(),
        squares: Vec::new(),
        losses: Vec::new(),
        walks: Walks::default(),
        seconds_primal: Vec::new(),
        seconds_gradient: Vec::new(),
    };
    let mut bad = NonFinite::default();
    for k in 0..repeats {
        let seed = args.seed.wrapping_add(k);
        let mut d_image = Vec::new();
        if k < primals {
            let seed = match objective {
                Objective::Linear(_) => seed,
                Objective::Loss(..) => seed_of_loss(seed),
            };
            let start = Instant::now();
            let job = Job::new(scene, settings, seed, 0..spp, &bar);
            let primal = render_f32(&job, &theta, Estimator::Mis);
            let seconds = start.elapsed().as_secs_f64();
            if primal.cancelled {
                break;
            }
            out.seconds_primal.push(seconds);
            if let Objective::Loss(loss, target) = objective {
                let image = primal.image(0);
                d_image = vec![0.0; image.data.len()];
                loss.gradient(&image.data, target, &mut d_image)?;
                out.losses.push(loss.value(&image.data, target)?);
                out.walks.merge(&Walks::of_image(&primal));
            }
        }
        let adjoint = match objective {
            Objective::Linear(adjoint) => adjoint,
            Objective::Loss(..) => &d_image,
        };
        let start = Instant::now();
        let names = &args.params;
        let gradient = mixture.backward_f32(
            &Job::new(scene, settings, seed, 0..spp, &bar),
            &theta,
            names,
            adjoint,
        )?;
        let seconds = start.elapsed().as_secs_f64();
        if gradient.cancelled {
            out.losses.truncate(k as usize);
            break;
        }
        if bad.count == 0 {
            let width = scene.film.crop_size[0] as usize;
            report_non_finite(&gradient.non_finite, width, seed);
        }
        bad.merge(&gradient.non_finite);
        out.walks.merge(&Walks::of_gradient(&gradient));
        out.seconds_gradient.push(seconds);
        out.add(gradient.values);
    }
    bar.finish();
    Ok((out.repeats > 0).then_some(out))
}

/// Derivative images, one per parameter, and what their files say: one number added to the whole range. None if interrupted.
fn gradient_images(
    args: &Args,
    scene: &Scene,
    settings: &Settings,
    mixture: &Mixture,
    ranges: &[ParamInfo],
    walks: &mut Walks,
    interrupt: &Interrupt,
) -> Result<Vec<(Image, Labels)>, ToolError> {
    let seed = args.seed;
    let spp = u64::from(settings.spp);
    let pixels = scene.film.pixels() as u64;
    if args.estimator != Choice::One(Estimator::Mis) {
        let passes = (ranges.len() * mixture.passes(spp).len()) as u64;
        let bar = Bar::new("images", pixels * passes, interrupt);
        let mut images = Vec::new();
        for info in ranges {
            let rendering =
                mixture.forward_f32(&Job::new(scene, settings, seed, 0..spp, &bar), &info.name)?;
            report_non_finite(&rendering.non_finite, rendering.width, seed);
            let came_to = Walks::of_image(&rendering);
            walks.merge(&came_to);
            if bar.cancelled() {
                return Ok(Vec::new());
            }
            let labels = came_to.labels(settings, &rendering.non_finite);
            images.push((rendering.image(1), labels));
        }
        bar.finish();
        return Ok(images);
    }
    let directions: Vec<Direction> = ranges
        .iter()
        .map(|info| Direction::uniform(scene.params(), &info.name))
        .collect::<Result<_, _>>()?;
    let bar = Bar::new(
        "images",
        pixels * forward_passes(directions.len()),
        interrupt,
    );
    let values = scene.params().values();
    let rendering = forward_f32(
        &Job::new(scene, settings, seed, 0..spp, &bar),
        values,
        &directions,
    )?;
    bar.finish();
    report_non_finite(&rendering.non_finite, rendering.width, seed);
    let came_to = Walks::of_image(&rendering);
    walks.merge(&came_to);
    if bar.cancelled() {
        return Ok(Vec::new());
    }
    let labels = came_to.labels(settings, &rendering.non_finite);
    let image = |k: usize| (rendering.image(k), labels.clone());
    Ok((1..=directions.len()).map(image).collect())
}

/// How many passes [`forward_f32`] makes for `n` directions.
fn forward_passes(n: usize) -> u64 {
    (n / 8) as u64 + (n % 8).count_ones() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_standard_error_by_hand() {
        let mut s = Statistics {
            repeats: 0,
            mean: Vec::new(),
            squares: Vec::new(),
            losses: Vec::new(),
            walks: Walks::default(),
            seconds_primal: Vec::new(),
            seconds_gradient: vec![3.0, 1.0, 2.0],
        };
        s.add(vec![vec![1.0]]);
        assert!(s.std_error(0).is_none());
        s.add(vec![vec![2.0]]);
        s.add(vec![vec![6.0]]);
        assert_eq!(s.mean, [[3.0]]);
        // Deviations -2, -1, 3: variance 7, error of the mean sqrt(7 / 3).
        let error = s.std_error(0).unwrap()[0];
        assert!((error - (7.0f64 / 3.0).sqrt()).abs() < 1e-15);
    }
}
