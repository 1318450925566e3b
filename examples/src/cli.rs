//! What all tools share: arguments of scenes, errors, exit codes.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use clap::{ArgMatches, Args, Parser};
use optim::OptimError;
use render::auto;
use render::emitter::Emitter;
use render::estimator::{Capabilities, Refusal};
use render::image_io::Encoding;
use render::instances::Estimator;
use render::integrator::particle;
use render::integrator::render::{NonFinite, Progress};
use render::params::{ParamInfo, ParamShape};
use render::sampler::Points;
use render::scene::{Caustics, LightChoice, LoadOptions};
use render::{RenderError, Scene, SceneError, Settings, image_io};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::progress::{INTERRUPTED, Interrupt};
use crate::{complain, print};

/// What a tool can fail with. The message names the thing.
#[derive(Debug, thiserror::Error)]
pub enum ToolError {
    /// The scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Rendering.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Optimisation.
    #[error(transparent)]
    Optim(#[from] OptimError),
    /// An output or input file.
    #[error("{}: {message}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        message: String,
    },
    /// Arguments that do not fit together or do not fit the scene.
    #[error("{0}")]
    Usage(String),
}

impl ToolError {
    /// An error about a file.
    pub fn file(path: &Path, message: impl std::fmt::Display) -> Self {
        Self::File {
            path: path.to_owned(),
            message: message.to_string(),
        }
    }
}

/// How a tool ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All done.
    Done,
    /// All done, and the answer is an exit code of its own.
    Answered(u8),
    /// Stopped by Ctrl-C; what was there has been written.
    Interrupted,
}

/// Parses the arguments, runs the tool and turns its outcome into an exit code: 0, 1 for an error, 2
/// for wrong arguments, [`INTERRUPTED`] after Ctrl-C, or what the tool answers. Standard output that cannot be written is an error as well, once all
/// files are; that its reader has gone is none.
pub fn main<A: Parser>(run: fn(&A, &Interrupt) -> Result<Outcome, ToolError>) -> ExitCode {
    let asked = |args: &A| check_threads().and_then(|()| run(args, &Interrupt::on_signal()));
    // A negative number is a value that is wrong, not an option that nobody knows.
    let takes = |arg: clap::Arg| match arg.get_action() {
        clap::ArgAction::Set | clap::ArgAction::Append => arg.allow_negative_numbers(true),
        _ => arg,
    };
    let parsed = A::command()
        .mut_args(takes)
        .try_get_matches()
        .and_then(|matches| {
            if ListArgs::asked(&matches) {
                return Ok(None);
            }
            A::from_arg_matches(&matches).map(Some)
        });
    let done = match parsed {
        Ok(Some(args)) => asked(&args),
        Ok(None) => {
            print::out(format_args!("{}", list_estimators()));
            Ok(Outcome::Done)
        }
        Err(e) => return ExitCode::from(usage(&e)),
    };
    let code = match done {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Answered(answer)) => ExitCode::from(answer),
        Ok(Outcome::Interrupted) => ExitCode::from(INTERRUPTED),
        Err(e) => {
            complain!("error: {}", shortened(&e.to_string(), LONGEST_MESSAGE));
            ExitCode::FAILURE
        }
    };
    match print::finish() {
        Ok(()) => code,
        Err(e) => {
            complain!("error: standard output: {e}");
            ExitCode::FAILURE
        }
    }
}

/// Characters of a message, and of an argument that it quotes.
const LONGEST_MESSAGE: usize = 8192;
const LONGEST_ARGUMENT: usize = 80;

/// Prints the help that was asked for, or what is wrong with the arguments. The exit code.
pub(crate) fn usage(e: &clap::Error) -> u8 {
    let args: Vec<String> = std::env::args_os()
        .map(|arg| arg.to_string_lossy().into_owned())
        .collect();
    let values = args.iter().flat_map(|arg| {
        let value = arg.split_once('=').map(|(_, value)| value);
        [Some(arg.as_str()), value].into_iter().flatten()
    });
    let long: Vec<&str> = values
        .filter(|value| value.chars().count() > LONGEST_ARGUMENT)
        .collect();
    if e.use_stderr() {
        if long.is_empty() {
            // As all on standard error.
            let _ = e.print();
        } else {
            let shorter = |text: String, value: &&str| {
                text.replace(value, &shortened(value, LONGEST_ARGUMENT))
            };
            let text = long.iter().fold(e.render().to_string(), shorter);
            print::err(format_args!("{}", shortened(&text, LONGEST_MESSAGE)));
        }
        return 2;
    }
    match print::wanted(e.print()) {
        Ok(()) => 0,
        Err(e) => {
            complain!("error: standard output: {e}");
            1
        }
    }
}

/// The start of a text, and how long it is, where it is longer than this.
fn shortened(text: &str, longest: usize) -> Cow<'_, str> {
    match text.char_indices().nth(longest) {
        Some((end, _)) => Cow::Owned(format!("{}... ({} bytes)", &text[..end], text.len())),
        None => Cow::Borrowed(text),
    }
}

/// Most threads that can be asked for.
pub(crate) const MOST_THREADS: i64 = 1024;

/// What the environment asks for, where `--threads` does not. Even a scene that is loaded starts threads.
///
/// # Errors
/// Too many.
pub(crate) fn check_threads() -> Result<(), ToolError> {
    const NAME: &str = "RAYON_NUM_THREADS";
    let Ok(text) = std::env::var(NAME) else {
        return Ok(());
    };
    match text.trim().parse::<i64>() {
        Ok(n) if n > MOST_THREADS => Err(ToolError::Usage(format!(
            "{NAME}: expected at most {MOST_THREADS} threads, found {n}"
        ))),
        _ => Ok(()),
    }
}

/// `--list-estimators`, which stands alone: [`main`] answers it.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct ListArgs {
    /// Print all estimators, with what they see, where they are right and what they refuse, and do nothing else
    #[arg(long, exclusive = true)]
    pub list_estimators: bool,
}

impl ListArgs {
    /// Whether a command line asks for the list: not all tools have it.
    fn asked(matches: &ArgMatches) -> bool {
        matches!(matches.try_get_one("list_estimators"), Ok(Some(true)))
    }
}

/// All estimators and what they can do, read from [`Estimator::capabilities`].
fn list_estimators() -> String {
    let mut text = String::new();
    let mut refusals: Vec<(Refusal, Vec<&str>)> = Vec::new();
    for e in Estimator::ALL {
        let c = e.capabilities();
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{}\n    {}\n    {c}", e.name(), e.summary());
        for refusal in c.refusals() {
            match refusals.iter_mut().find(|(r, _)| *r == refusal) {
                Some((_, names)) => names.push(e.name()),
                None => refusals.push((refusal, vec![e.name()])),
            }
        }
    }
    text += "auto\n    What pilots choose: one of the above, or a sum with weights for each part of the image \
             (compare, gradient). What moves is taken by edges, over mirrors and smooth glass by \
             reparameterised-mis.\n\n";
    for line in Capabilities::LEGEND {
        let _ = writeln!(text, "{}: {}", line.0, line.1);
    }
    text += "\nRefused by name:\n";
    for (refusal, names) in refusals {
        let all = names.len() == Estimator::ALL.len();
        let by = if all { "all".into() } else { names.join(", ") };
        let _ = writeln!(text, "  {refusal}\n    by {by}");
    }
    text
}

/// Whether the estimator of this name is like that; `auto` and double precision are no names of estimators.
pub fn can(estimator: &str, like: impl Fn(Capabilities) -> bool) -> bool {
    Estimator::from_name(estimator).is_ok_and(|e| like(e.capabilities()))
}

/// Says why an estimator is biased, if it is.
pub fn warn_of_failures(estimator: Estimator) {
    for failure in estimator.capabilities().failures.iter() {
        complain!(
            "warning: `{}` is biased on purpose: {} ({})",
            estimator.name(),
            failure.name(),
            failure.number()
        );
    }
}

/// Says how many emitters an estimator never meets, if any: those that are found only by sampling them.
pub fn warn_of_unsampled(scene: &Scene, estimator: Estimator) {
    let missed = scene.emitters().iter().filter(|e| e.is_delta()).count();
    if missed > 0 && !estimator.capabilities().samples_emitters {
        complain!(
            "warning: {missed} of {} emitters bring nothing: no sampled direction meets a point, a spot, a projector or \
             parallel light; `mis` samples them",
            scene.emitters().len()
        );
    }
}

/// Warns of shapes of which samples of edges do not tell how they cross, if these parameters are differentiated by any.
pub fn warn_of_crossings(scene: &Scene, estimator: Estimator, names: &[String]) {
    for doubt in estimator.doubts(scene, names) {
        complain!("warning: {doubt}");
    }
}

/// `-D` and its companions.
#[derive(Args, Clone, Debug, Default)]
pub struct LoadArgs {
    /// Value for a `$name` of the scene file
    #[arg(short = 'D', long = "define", value_name = "NAME=VALUE", value_parser = define,
          requires = "scene")]
    pub defines: Vec<(String, String)>,
    /// Substitute mid-grey for texture files that are missing
    #[arg(long, requires = "scene")]
    pub allow_missing: bool,
    /// The sensor to look through, by its id or number [default: the first]
    #[arg(long, value_name = "ID", requires = "scene")]
    pub sensor: Option<String>,
    /// Value of a parameter: a number, three for a colour, or an image of its size for texels, decoded as the scene's own is;
    /// FILE.EXR:LAYER names a layer. 16 numbers, row by row, for the matrix `ball.to_world` of a shape or `sensor.to_world`,
    /// where they turn, move and scale evenly. The key may be that of Mitsuba, and `*` stands for any text in it
    #[arg(short = 'P', long = "set", value_name = "KEY=VALUE", value_parser = define,
          requires = "scene")]
    pub values: Vec<(String, String)>,
}

fn define(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.into(), value.into())),
        _ => Err("expected NAME=VALUE".into()),
    }
}

impl LoadArgs {
    /// As the library takes them.
    pub fn options(&self) -> LoadOptions {
        LoadOptions {
            defines: self.defines.clone(),
            allow_missing: self.allow_missing,
            sensor: self.sensor.clone(),
            several_sensors: false,
        }
    }

    /// Loads the scene, prints its warnings, and says how many seconds it took.
    ///
    /// # Errors
    /// Anything wrong with the file.
    pub fn load(&self, path: &Path) -> Result<(Scene, f64), ToolError> {
        self.load_with(path, &self.options())
    }

    /// The same, by options that are more than these.
    ///
    /// # Errors
    /// As [`LoadArgs::load`].
    pub fn load_with(&self, path: &Path, options: &LoadOptions) -> Result<(Scene, f64), ToolError> {
        let start = Instant::now();
        let (mut scene, warnings) = Scene::load(path, options)?;
        for w in warnings {
            complain!("warning: {w}");
        }
        if scene.emitters().is_empty() {
            complain!(
                "warning: {}: there is no emitter: all is black",
                path.display()
            );
        }
        self.set(&mut scene)?;
        Ok((scene, start.elapsed().as_secs_f64()))
    }

    /// Gives parameters the values of `-P`.
    ///
    /// # Errors
    /// A key that nothing has, or a value that it cannot have.
    pub fn set(&self, scene: &mut Scene) -> Result<(), ToolError> {
        if self.values.is_empty() {
            return Ok(());
        }
        let (matrices, others): (Vec<_>, Vec<_>) = self
            .values
            .iter()
            .partition(|(key, _)| Scene::is_matrix(key));
        for (key, text) in matrices {
            let matrix = numbers(text).ok_or_else(|| {
                ToolError::Usage(format!(
                    "-P {key}: expected 16 numbers, row by row, found `{text}`"
                ))
            })?;
            scene.set([(key, &matrix[..])])?;
        }
        let keys: Vec<&String> = others.iter().map(|(key, _)| key).collect();
        scene.make_movable(&keys)?;
        let mut values = scene.params().values().to_vec();
        for (key, text) in others {
            for info in scene.params().matching(key)? {
                let encoding = scene.params().encoding(info);
                assign(info, text, encoding, &mut values[info.range()])?;
            }
        }
        scene.set_params(&values)?;
        Ok(())
    }
}

/// The names of all parameters that fit these, which may be patterns, each once. What moves becomes a parameter.
///
/// # Errors
/// One that nothing fits, with those that resemble it.
pub fn names_of(scene: &mut Scene, keys: &[String]) -> Result<Vec<String>, RenderError> {
    scene.make_movable(keys)?;
    let mut names: Vec<String> = Vec::new();
    for key in keys {
        for info in scene.params().matching(key)? {
            if !names.contains(&info.name) {
                names.push(info.name.clone());
            }
        }
    }
    Ok(names)
}

/// Numbers separated by commas or spaces.
fn numbers(text: &str) -> Option<Vec<f32>> {
    (text.split([',', ' ']).filter(|t| !t.is_empty()))
        .map(|t| t.parse().ok().filter(|x: &f32| x.is_finite()))
        .collect()
}

/// Reads the value of a parameter from a text: numbers, or the name of an image.
fn assign(
    info: &ParamInfo,
    text: &str,
    encoding: Encoding,
    values: &mut [f32],
) -> Result<(), ToolError> {
    let channels = match info.shape {
        ParamShape::Scalar => 1,
        ParamShape::Rgb | ParamShape::Vector | ParamShape::Points { .. } => 3,
        ParamShape::Texture { channels, .. } => channels,
    };
    if let Some(numbers) = numbers(text).filter(|n| n.len() == 1 || n.len() == channels) {
        for (value, x) in values.iter_mut().zip(numbers.iter().cycle()) {
            *value = *x;
        }
        return Ok(());
    }
    let wrong = |expected: &str| {
        ToolError::Usage(format!(
            "-P {}: expected {expected}, found `{text}`",
            info.name
        ))
    };
    let (file, layer) = image_io::split_layer(Path::new(text));
    let ParamShape::Texture { width, height, .. } = info.shape else {
        let numbers = match channels {
            1 => "a number",
            _ => "one or three numbers",
        };
        let constant = matches!(info.shape, ParamShape::Scalar | ParamShape::Rgb);
        return Err(match info.name.strip_suffix(".value") {
            Some(texture) if constant && file.is_file() => {
                let key = texture.rsplit('.').next().unwrap_or(texture);
                wrong(&format!(
                    "{numbers}, since it is the same everywhere (an image in its place is said in the scene file: \
                     <texture type=\"bitmap\" name=\"{key}\"><string name=\"filename\" value=\"{}\"/></texture>)",
                    file.display()
                ))
            }
            _ => wrong(numbers),
        });
    };
    if !file.is_file() {
        return Err(wrong("a number, or the name of an image that is there"));
    }
    let image = image_io::read_layer(&file, encoding, layer.as_deref())?;
    let found = (image.width, image.height);
    let image = match channels {
        1 => image.into_grey(),
        _ => image.into_rgb(),
    };
    if found != (width, height) || image.data.len() != values.len() {
        let (w, h) = found;
        return Err(ToolError::Usage(format!(
            "-P {}: expected an image of {width} x {height}, as the scene has it, found one of {w} x {h} in `{text}`; one of \
             another size is named in the scene file, or by -D where that has a `$name` for it",
            info.name
        )));
    }
    values.copy_from_slice(&image.data);
    Ok(())
}

/// `--sampler`, `--lights`, `--caustics`, `--pixels-per-particle` and `--guide`. Reports hold them by name.
#[derive(Args, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SampleArgs {
    /// How the samples of a pixel are spread: independent, sobol (Owen-scrambled, best with powers of two)
    /// or antithetic (pairs) [default: sobol]
    #[arg(long, value_name = "NAME", value_parser = |text: &str| named(&Points::NAMES, text))]
    #[serde(serialize_with = "write_points", deserialize_with = "read_points")]
    pub sampler: Option<Points>,
    /// How a point chooses the light that it samples: any one, or in proportion to what each would bring
    /// [default: one]
    #[arg(long, value_name = "one|all", value_parser = |text: &str| named(&LightChoice::NAMES, text))]
    #[serde(serialize_with = "write_lights", deserialize_with = "read_lights")]
    pub lights: Option<LightChoice>,
    /// Who finds the light that glossy things throw on diffuse ones: paths from the camera, or particles
    /// from the lights [default: paths]
    #[arg(long, value_name = "paths|particles",
          value_parser = |text: &str| named(&Caustics::NAMES, text))]
    #[serde(serialize_with = "write_caustics", deserialize_with = "read_caustics")]
    pub caustics: Option<Caustics>,
    /// How many pixels share one of those particles, per sample: fewer where caustics are what matters
    /// [default: 4]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixels_per_particle: Option<u32>,
    /// Paths before learn where light comes from, and half of what diffuse surfaces scatter goes there: for
    /// light that arrives through water or by mirrors
    #[arg(long)]
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub guide: bool,
}

/// How tools spread the samples of a pixel unless they are told. Their standard errors are those of repeats, each with a
/// scrambling of its own, and hold for any points.
const POINTS: Points = Points::Sobol;

impl SampleArgs {
    /// Learns where light comes from, if asked to; says so if there is none.
    pub fn learn(self, scene: &mut Scene, settings: &Settings, seed: u64, progress: &dyn Progress) {
        if self.guide && !auto::guide(scene, settings, seed, progress) && !progress.cancelled() {
            complain!("warning: --guide: no light meets anything diffuse; paths are not guided");
        }
    }

    /// What is guided at all.
    ///
    /// # Errors
    /// An estimator that is not, with `--guide`.
    pub fn check_guided(self, estimator: Estimator) -> Result<(), ToolError> {
        if !self.guide || estimator.capabilities().guided {
            return Ok(());
        }
        let guided = Estimator::ALL.iter().filter(|e| e.capabilities().guided);
        let names: Vec<&str> = guided.map(|e| e.name()).collect();
        Err(ToolError::Usage(format!(
            "--guide: samples or weights of {} move with the parameters; expected one of {}",
            estimator.name(),
            names.join(", ")
        )))
    }

    /// Says so in `settings`.
    ///
    /// # Errors
    /// Particles in a scene that they see otherwise than paths do.
    pub fn apply(self, scene: &Scene, settings: &mut Settings) -> Result<(), ToolError> {
        settings.points = self.sampler.unwrap_or(POINTS);
        settings.lights = self.lights.unwrap_or_default();
        settings.caustics = self.caustics.unwrap_or_default();
        if settings.caustics == Caustics::Particles {
            particle::check(scene)?;
        } else if self.pixels_per_particle.is_some() {
            let message = "--pixels-per-particle: without effect; expected --caustics particles";
            return Err(ToolError::Usage(message.into()));
        }
        let default = settings.pixels_per_particle;
        settings.pixels_per_particle = self.pixels_per_particle.unwrap_or(default);
        Ok(())
    }

    /// With the defaults said.
    pub fn filled(self) -> Self {
        Self {
            sampler: Some(self.sampler.unwrap_or(POINTS)),
            lights: Some(self.lights.unwrap_or_default()),
            caustics: Some(self.caustics.unwrap_or_default()),
            pixels_per_particle: (self.caustics == Some(Caustics::Particles)).then(|| {
                let default = Settings::default().pixels_per_particle;
                self.pixels_per_particle.unwrap_or(default)
            }),
            guide: self.guide,
        }
    }
}

fn write_points<S: Serializer>(value: &Option<Points>, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(name_in(&Points::NAMES, &value.unwrap_or(POINTS)))
}

fn read_points<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Points>, D::Error> {
    read_name(&Points::NAMES, from)
}

fn write_lights<S: Serializer>(value: &Option<LightChoice>, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(name_in(&LightChoice::NAMES, &value.unwrap_or_default()))
}

fn read_lights<'de, D: Deserializer<'de>>(from: D) -> Result<Option<LightChoice>, D::Error> {
    read_name(&LightChoice::NAMES, from)
}

fn write_caustics<S: Serializer>(value: &Option<Caustics>, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(name_in(&Caustics::NAMES, &value.unwrap_or_default()))
}

fn read_caustics<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Caustics>, D::Error> {
    read_name(&Caustics::NAMES, from)
}

fn read_name<'de, T: Copy, D: Deserializer<'de>>(
    names: &[(&str, T)],
    from: D,
) -> Result<Option<T>, D::Error> {
    let text = String::deserialize(from)?;
    named(names, &text).map(Some).map_err(D::Error::custom)
}

/// `--threads`.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct ThreadArgs {
    /// Number of threads [default: one per processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=MOST_THREADS))]
    pub threads: Option<u16>,
}

impl ThreadArgs {
    /// Runs `f` on a pool of its own; it is told the number of threads.
    ///
    /// # Errors
    /// Those of `f`, or that threads cannot be started.
    pub fn run<T: Send>(
        &self,
        f: impl FnOnce(usize) -> Result<T, ToolError> + Send,
    ) -> Result<T, ToolError> {
        let threads = self.threads.unwrap_or(0).into();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .map_err(|e| ToolError::Usage(format!("--threads: cannot start {threads}: {e}")))?;
        pool.install(|| f(rayon::current_num_threads()))
    }
}

/// Values of `--spp`.
pub const SAMPLE_COUNTS: RangeInclusive<i64> = 1..=1 << 30;

/// The parser of [`SAMPLE_COUNTS`].
pub fn sample_count() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(SAMPLE_COUNTS)
}

/// A depth limit: -1 for none, or a number of path edges.
///
/// # Errors
/// Anything else, in words.
pub fn depth(text: &str) -> Result<u32, String> {
    match text.parse::<i64>() {
        Ok(-1) => Ok(u32::MAX),
        Ok(d) if (1..=i64::from(u32::MAX)).contains(&d) => Ok(d as u32),
        _ => Err("expected -1 for no limit, or at least one path edge".into()),
    }
}

/// An estimator, or one for the program to choose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// `auto`: [`render::auto`].
    Auto,
    /// Any other name.
    One(Estimator),
}

impl Choice {
    /// Its name on command lines and in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::One(e) => e.name(),
        }
    }
}

/// The estimator called `text`, or `auto`.
///
/// # Errors
/// An unknown name, with all known ones.
pub fn estimator(text: &str) -> Result<Choice, RenderError> {
    estimator_or(text, &[("auto", Choice::Auto)], Choice::One)
}

/// What `text` stands for in `others`, or `of` the estimator called that.
///
/// # Errors
/// An unknown name, with all known ones.
pub fn estimator_or<T: Copy>(
    text: &str,
    others: &[(&str, T)],
    of: impl Fn(Estimator) -> T,
) -> Result<T, RenderError> {
    if let Some((_, other)) = others.iter().find(|(name, _)| *name == text) {
        return Ok(*other);
    }
    Estimator::from_name(text).map(of).map_err(|e| match e {
        RenderError::UnknownEstimator { name, known } => {
            let others: Vec<&str> = others.iter().map(|(name, _)| *name).collect();
            let known = format!("{}, {known}", others.join(", "));
            RenderError::UnknownEstimator { name, known }
        }
        other => other,
    })
}

/// What `text` stands for in a list of names.
fn named<T: Copy>(names: &[(&str, T)], text: &str) -> Result<T, String> {
    let found = names.iter().find(|(name, _)| *name == text);
    found.map(|(_, value)| *value).ok_or_else(|| {
        let known: Vec<&str> = names.iter().map(|(name, _)| *name).collect();
        format!("expected one of {}", known.join(", "))
    })
}

/// What `value` is called in a list of names of all values.
fn name_in<T: PartialEq>(names: &[(&'static str, T)], value: &T) -> &'static str {
    let found = names.iter().find(|(_, v)| v == value);
    found.map_or("", |(name, _)| name)
}

/// Tells the user about samples that were left out because they were not finite.
pub fn report_non_finite(bad: &NonFinite, width: usize, seed: u64) {
    if let Some((pixel, sample)) = bad.first {
        let (x, y) = (pixel % width as u64, pixel / width as u64);
        complain!(
            "warning: {} samples were not finite and are left out; the first is sample {sample} of \
             pixel ({x}, {y}) with seed {seed}",
            bad.count
        );
    }
}
