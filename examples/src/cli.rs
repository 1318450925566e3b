//! What all tools share: arguments of scenes, errors, exit codes.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use std::time::Instant;

use clap::{ArgMatches, Args, Parser, ValueEnum};
use optim::OptimError;
use render::auto;
use render::emitter::Emitter;
use render::estimator::{Capabilities, Refusal};
use render::glint::glinty_shapes;
use render::image_io::{Encoding, Labels};
use render::instances::Estimator;
use render::integrator::gradient::Gradient;
use render::integrator::particle;
use render::integrator::render::{NonFinite, Progress};
use render::integrator::render::{PixelConnections, Rendering};
use render::manifold::{Split, Statistics};
use render::params::{ParamInfo, ParamShape};
use render::sampler::Points;
use render::scene::{
    CasterLight, Caustics, ChainKinds, Connections, Constraint, GlintMethod, GlintRegion,
    GlintWeights, Glints, LightChoice, LoadOptions, Method, Starts, Uniqueness,
};
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

/// `--chains`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Chains(ChainKinds);

impl FromStr for Chains {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.parse().map(Self)
    }
}

impl TryFrom<String> for Chains {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Chains> for String {
    fn from(Chains(kinds): Chains) -> Self {
        kinds.to_string()
    }
}

/// `--manifold` and its companions.
#[derive(Args, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ManifoldArgs {
    /// How light over chains of mirrors and smooth glass is found that sampling cannot find: sms (unbiased), sms-biased
    /// (distinct solutions of --trials walks), mnee (one walk, towards the light), mnee-unbiased (that walk, and paths for the
    /// chains that it misses), or off: paths find it, but with --bounces, --chains or --caster-roughness the light of such chains is left
    /// out [default: the scene's integrator]
    #[arg(long, value_name = "NAME", value_enum)]
    pub manifold: Option<ManifoldArg>,
    /// Walks of a trial set of --manifold sms-biased [default: 16]; of --manifold sms, most trials of an estimate, which
    /// bias it where they are used up [default: 65536]
    #[arg(long, value_name = "M", requires = "manifold",
          value_parser = clap::value_parser!(u32).range(1..=i64::from(Connections::MOST_WALKS)))]
    pub trials: Option<u32>,
    /// Most specular vertices of a chain [default: 2]
    #[arg(long, value_name = "K", requires = "manifold",
          value_parser = clap::value_parser!(u32).range(1..=i64::from(Connections::MOST_BOUNCES)))]
    pub bounces: Option<u32>,
    /// Connect over these chains alone: words of R (reflection) and T (refraction), from the receiver to the light, such as R,TT; paths
    /// find the light of others
    #[arg(
        long,
        value_name = "WORDS",
        requires = "manifold",
        conflicts_with = "bounces"
    )]
    pub chains: Option<Chains>,
    /// The function whose roots are sought
    #[arg(long, value_name = "NAME", value_enum, requires = "manifold")]
    pub constraint: Option<ConstraintArg>,
    /// Tell solutions apart as published: by one minus the cosine between their directions, at least this; merges some of
    /// them [default: by bounds of their errors]
    #[arg(long, value_name = "X", requires = "manifold", value_parser = threshold)]
    #[serde(with = "optim::exact::optional")]
    pub uniqueness_threshold: Option<f64>,
    /// Prove of one in so many walks that it ended in the solution that it was taken for; 1 of all, 0 of none. Changes no image
    /// [default: 256]
    #[arg(
        long,
        value_name = "N",
        requires = "manifold",
        conflicts_with = "uniqueness_threshold"
    )]
    pub proofs: Option<u32>,
    /// Where walks start: at random points (uniform), after a walk over the surfaces without their normal maps (two-stage), or
    /// where particles passed that landed nearby, whose solutions count without trials, and else in two stages (particles)
    /// [default: particles]
    #[arg(long, value_name = "NAME", value_enum, requires = "manifold")]
    pub starts: Option<StartsArg>,
    /// Metal and glass that is no rougher than this throws light over chains, too [default: 0.02]
    #[arg(long, value_name = "ALPHA", requires = "manifold", value_parser = roughness)]
    #[serde(with = "optim::exact::optional")]
    pub caster_roughness: Option<f64>,
    /// Those of glints.
    #[command(flatten)]
    #[serde(flatten)]
    pub glints: GlintArgs,
}

/// `--starts`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartsArg {
    /// At random points of casters
    Uniform,
    /// After a walk over the surfaces without their normal maps
    TwoStage,
    /// Where particles passed that landed nearby, and else in two stages
    Particles,
}

/// `--glints` and its companions.
#[derive(Args, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct GlintArgs {
    /// How glints are found, reflections of lights in smooth metal under a fine normal map: unbiased, biased (distinct
    /// solutions of --glint-trials walks), or off [default: the scene's integrator]
    #[arg(long, value_name = "NAME", value_enum)]
    pub glints: Option<GlintArg>,
    /// Walks of a trial set of --glints biased [default: 16]; of --glints unbiased, most trials of an estimate, which
    /// bias it where they are used up [default: 1048576]
    #[arg(long, value_name = "M", value_parser = clap::value_parser!(u32).range(1..), requires = "glints")]
    pub glint_trials: Option<u32>,
    /// Where walks start: in a cell between texels that fits, or anywhere in the footprint, as published
    #[arg(long, value_name = "NAME", value_enum, requires = "glints")]
    pub glint_region: Option<GlintRegionArg>,
    /// How walks and scattered directions share the light: by their densities, or by the lobe of filtered slopes, as
    /// published
    #[arg(long, value_name = "NAME", value_enum, requires = "glints")]
    pub glint_weights: Option<GlintWeightsArg>,
}

/// `--glints`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GlintArg {
    /// Reciprocal probabilities from trials
    Unbiased,
    /// Distinct solutions of a trial set
    Biased,
    /// Paths find all light
    Off,
}

/// `--glint-region`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GlintRegionArg {
    /// One cell between texels
    Texels,
    /// The whole footprint
    Footprint,
}

/// `--glint-weights`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GlintWeightsArg {
    /// Densities of paths
    Densities,
    /// Densities of directions, from filtered slopes
    Lobe,
}

/// Says which shapes are flagged as glinty and are not.
fn complain_of_flags(scene: &Scene) {
    let glinty = glinty_shapes(scene).unwrap_or_default();
    for shape in 0..scene.shapes().len() as u32 {
        let info = scene.shape_info(shape);
        if info.hints.glinty && glinty.get(shape as usize) != Some(&true) {
            complain!(
                "warning: shape `{}`: `glinty`, but no smooth metal under a normal map that is an image; paths find its light",
                info.name
            );
        }
    }
    if glinty.is_empty() {
        complain!(
            "warning: the scene asks for glints, and nothing in it is glinty; paths find all light"
        );
    }
}

impl GlintArgs {
    /// Says so in `settings`.
    ///
    /// # Errors
    /// Options without effect, and scenes without anything glinty.
    fn apply(self, scene: &Scene, settings: &mut Settings) -> Result<(), ToolError> {
        let usage = |message: &str| Err(ToolError::Usage(message.into()));
        let method = match self.glints {
            None => {
                if settings.glints.is_some() {
                    complain_of_flags(scene);
                }
                return Ok(());
            }
            Some(GlintArg::Off) => {
                let others = self.glint_trials.is_some()
                    || self.glint_region.is_some()
                    || self.glint_weights.is_some();
                if others {
                    return usage("--glints off: its other options are without effect");
                }
                settings.glints = None;
                return Ok(());
            }
            Some(GlintArg::Unbiased) => GlintMethod::Unbiased,
            Some(GlintArg::Biased) => {
                GlintMethod::Biased(self.glint_trials.unwrap_or(Glints::TRIALS))
            }
        };
        if glinty_shapes(scene).is_none() {
            return usage(
                "--glints: no shape of the scene is smooth metal under a normal map that is an image; expected such a \
                 shape, or --glints off",
            );
        }
        let mut glints = Glints::new(method);
        if let (GlintMethod::Unbiased, Some(trials)) = (method, self.glint_trials) {
            glints.budget = trials;
        }
        if self.glint_region == Some(GlintRegionArg::Footprint) {
            glints.region = GlintRegion::Footprint;
        }
        if self.glint_weights == Some(GlintWeightsArg::Lobe) {
            glints.weights = GlintWeights::Lobe;
        }
        settings.glints = Some(glints);
        Ok(())
    }
}

/// `--manifold`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ManifoldArg {
    /// Unbiased specular manifold sampling
    Sms,
    /// Distinct solutions of a trial set
    SmsBiased,
    /// Manifold next event estimation
    Mnee,
    /// The same, and paths for what it misses
    MneeUnbiased,
    /// Every solution of one vertex, by proof, over smooth surfaces without normal maps
    Complete,
    /// Paths find all light, or all but that of the chains that options name
    Off,
}

/// `--constraint`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ConstraintArg {
    /// Differences of angles
    Angle,
    /// Half vectors
    HalfVector,
}

fn threshold(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x > 0.0 && x <= 2.0 => Ok(x),
        _ => Err("expected a number in (0, 2]".into()),
    }
}

fn roughness(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if (0.0..=1.0).contains(&x) => Ok(x),
        _ => Err("expected a number in [0, 1]".into()),
    }
}

impl ManifoldArgs {
    /// The first option that is given here and is another one in `job`: its name, and what both say.
    pub fn differs(&self, job: &Self) -> Option<(String, [String; 2])> {
        let [given, job] = [self, job].map(|args| serde_json::json!(args));
        let given = given.as_object()?.iter().filter(|(_, x)| !x.is_null());
        let (key, x) = given
            .into_iter()
            .find(|(key, x)| job[key.as_str()] != **x)?;
        let option = format!("--{}", key.replace('_', "-"));
        Some((option, [&job[key.as_str()], x].map(|x| x.to_string())))
    }

    /// Says so in `settings`.
    ///
    /// # Errors
    /// Options without effect, connections beside particles, and glints where nothing is glinty.
    pub fn apply(self, scene: &Scene, settings: &mut Settings) -> Result<(), ToolError> {
        self.glints.apply(scene, settings)?;
        let usage = |message: &str| Err(ToolError::Usage(message.into()));
        let method = match self.manifold {
            None => {
                if let Some(connections) = &settings.connections {
                    if settings.caustics == Caustics::Particles {
                        return usage(
                            "--caustics particles: the scene's integrator says who finds that light; expected --manifold off, or \
                             --caustics paths",
                        );
                    }
                    complain_of_casters(scene, connections);
                }
                return admits(scene, settings);
            }
            Some(ManifoldArg::Off) => {
                let others = self.trials.is_some()
                    || self.constraint.is_some()
                    || self.uniqueness_threshold.is_some()
                    || self.proofs.is_some()
                    || self.starts.is_some();
                if others {
                    return usage("--manifold off: options of walks are without effect");
                }
                let named = self.bounces.is_some() || self.chains.is_some();
                if !named && self.caster_roughness.is_none() {
                    complain_of_more_light(settings, "--manifold");
                    settings.connections = None;
                    return Ok(());
                }
                // Chains are named: their light is left out.
                Method::LeftOut
            }
            Some(ManifoldArg::Sms) => Method::Sms,
            Some(ManifoldArg::SmsBiased) => {
                Method::SmsBiased(self.trials.unwrap_or(Connections::TRIALS))
            }
            Some(ManifoldArg::Mnee) => Method::Mnee,
            Some(ManifoldArg::MneeUnbiased) => Method::MneeUnbiased,
            Some(ManifoldArg::Complete) => Method::Complete,
        };
        let compares = self.proofs.is_some() || self.uniqueness_threshold.is_some();
        if method == Method::Complete && compares {
            return usage(
                "--manifold complete: proves all solutions; --proofs and --uniqueness-threshold are without effect",
            );
        }
        if method.is_deterministic() && self.trials.is_some() {
            return usage("--trials: without effect; expected --manifold sms or sms-biased");
        }
        if method.is_deterministic() && self.starts.is_some() {
            return usage("--starts: without effect; expected --manifold sms or sms-biased");
        }
        if settings.caustics == Caustics::Particles {
            return usage(
                "--caustics particles: --manifold finds that light; expected one of them",
            );
        }
        let mut connections = Connections::new(method);
        let bounces = if method == Method::Complete {
            1
        } else {
            connections.bounces
        };
        connections.bounces = self.bounces.unwrap_or(bounces);
        connections.kinds = self.chains.map(|Chains(kinds)| kinds);
        if let (Method::Sms, Some(trials)) = (method, self.trials) {
            connections.budget = trials;
        }
        if self.constraint == Some(ConstraintArg::HalfVector) {
            connections.constraint = Constraint::HalfVector;
        }
        if let Some(starts) = self.starts {
            connections.starts = match starts {
                StartsArg::Uniform => Starts::Uniform,
                StartsArg::TwoStage => Starts::TwoStage,
                StartsArg::Particles => Starts::Particles,
            };
        }
        connections.roughness = self.caster_roughness.unwrap_or(connections.roughness);
        if let Some(threshold) = self.uniqueness_threshold {
            connections.uniqueness = Uniqueness::Threshold(threshold);
        }
        connections.proofs = self.proofs.unwrap_or(connections.proofs);
        complain_of_casters(scene, &connections);
        if Split::of(scene, &connections).is_none() {
            complain!(
                "warning: --manifold: nothing smooth to connect lights over, or none but wide ones; paths find all light"
            );
        }
        if method.walks() {
            complain_of_more_light(settings, "--manifold");
        }
        settings.connections = Some(connections);
        admits(scene, settings)
    }
}

/// Says that an option takes the place of the scene's integrator, where that leaves light out.
pub fn complain_of_more_light(settings: &Settings, option: &str) {
    if (settings.connections).is_some_and(|c| c.light != CasterLight::All) {
        complain!(
            "warning: {option}: takes the place of the scene's integrator: what that leaves out of the light over casters is there"
        );
    }
}

/// Says which shapes are flagged as casters and can be none.
fn complain_of_casters(scene: &Scene, connections: &Connections) {
    for shape in Split::unheeded(scene, connections) {
        complain!(
            "warning: shape `{}`: flagged as a caster, but no metal or glass of one roughness without bump maps; paths find its \
             light",
            scene.shape_info(shape).name
        );
    }
}

/// Whether the method finds all light that it takes from paths.
fn admits(scene: &Scene, settings: &Settings) -> Result<(), ToolError> {
    if let Some(connections) = &settings.connections
        && let Some(split) = Split::of(scene, connections)
    {
        split.admits(scene, connections.method)?;
    }
    Ok(())
}

/// What walks to solutions came to, for reports.
#[derive(Clone, Debug, Serialize)]
pub struct WalkReport {
    /// What was to be connected, and how much of it was.
    pub attempts: u64,
    /// See `attempts`.
    pub found: u64,
    /// Walks, and the part of them that converged.
    pub walks: u64,
    /// See `walks`.
    pub success_rate: f64,
    /// Steps per walk.
    pub steps_per_walk: f64,
    /// Trials per solution that counts.
    pub trials_per_solution: f64,
    /// Reciprocals that ran out of trials.
    pub exhausted: u64,
}

impl WalkReport {
    fn of(s: &Statistics) -> Self {
        Self {
            attempts: s.attempts,
            found: s.found,
            walks: s.walks,
            success_rate: per(s.converged, s.walks),
            steps_per_walk: per(s.steps, s.walks),
            trials_per_solution: per(s.trials, s.solutions),
            exhausted: s.exhausted,
        }
    }
}

/// What happened to estimates that are exhausted.
const TRIALS: &str = "ran out of trials";

/// What manifold connections came to, for reports.
#[derive(Clone, Debug, Serialize)]
pub struct ManifoldReport {
    /// The estimator.
    pub method: String,
    /// Whether its expectation is that of the light: an estimate that ran out of trials is not.
    pub unbiased: bool,
    /// Most vertices of a chain.
    pub bounces: u32,
    /// Which chains, where not all are looked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chains: Option<String>,
    /// Whether light over casters is there that is not of such chains.
    pub other_light: bool,
    /// What walks came to, of vertices and light samples.
    #[serde(flatten)]
    pub walks: WalkReport,
    /// Of those walks that `--proofs` chooses: how many are proved to have ended in the solution that they were taken for.
    pub proved: u64,
    /// And how many not.
    pub unproved: u64,
    /// The part of the image's light that they brought, of an image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub share_of_light: Option<f64>,
    /// What that means of those that are exhausted: shortly, and at length.
    #[serde(skip)]
    ran_out: [&'static str; 2],
    /// Of mnee-unbiased: paths that met light over a chain.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paths_met: Option<u64>,
    /// Those of which the walk missed the chain, so that they count.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paths_counted: Option<u64>,
}

/// A part of a number; zero of nothing.
fn per(a: u64, b: u64) -> f64 {
    a as f64 / b.max(1) as f64
}

/// What manifold connections came to in each pixel, as channels of an image: `success_rate` of walks, `steps` per walk,
/// `trials` per solution that counts, and `share` of the light.
pub fn manifold_planes(rendering: &Rendering) -> Vec<(&'static str, Vec<f32>)> {
    let pixels = || (rendering.connections_by_pixel.iter()).zip(rendering.sums[0].chunks_exact(3));
    let plane = |f: fn(&PixelConnections, f64) -> f64| {
        let each = pixels().map(|(p, sums)| f(p, sums.iter().sum::<f64>() / 3.0) as f32);
        each.collect()
    };
    vec![
        (
            "share",
            plane(|p, light| if light > 0.0 { p.light / light } else { 0.0 }),
        ),
        (
            "steps",
            plane(|p, _| per(p.statistics.steps, p.statistics.walks)),
        ),
        (
            "success_rate",
            plane(|p, _| per(p.statistics.converged, p.statistics.walks)),
        ),
        (
            "trials",
            plane(|p, _| per(p.statistics.trials, p.statistics.solutions)),
        ),
    ]
}

impl ManifoldReport {
    /// Of a rendering with these settings; `None` without connections.
    pub fn of_image(settings: &Settings, rendering: &Rendering) -> Option<Self> {
        let light: f64 = rendering.sums[0].iter().sum::<f64>() / 3.0;
        let share = if light > 0.0 {
            rendering.light_of_connections / light
        } else {
            0.0
        };
        Some(Self {
            share_of_light: Some(share),
            ..Self::of(settings, &rendering.connections)?
        })
    }

    /// Of what walks came to, with these settings; `None` without connections.
    pub fn of(settings: &Settings, s: &Statistics) -> Option<Self> {
        let connections = settings.connections?;
        let (method, unbiased) = match connections.method {
            Method::Sms => ("sms".to_owned(), true),
            Method::SmsBiased(trials) => (format!("sms-biased, {trials} walks"), false),
            Method::Mnee => ("mnee".to_owned(), false),
            Method::MneeUnbiased => ("mnee-unbiased".to_owned(), true),
            Method::Complete => ("complete".to_owned(), true),
            Method::LeftOut => ("left out".to_owned(), false),
            Method::Paths => ("paths".to_owned(), true),
        };
        let ran_out = match connections.method {
            Method::Complete => [
                "searches are not complete",
                "left places undecided: solutions may be missing there",
            ],
            _ => [
                TRIALS,
                "ran out of trials: what they bring is biased; more by --trials",
            ],
        };
        let with_paths = connections.method == Method::MneeUnbiased;
        Some(Self {
            ran_out,
            method,
            unbiased: unbiased
                && s.exhausted == 0
                && connections.uniqueness == Uniqueness::ErrorBounds,
            bounces: connections.longest(),
            chains: connections.kinds.map(|kinds| kinds.to_string()),
            other_light: connections.light == CasterLight::All,
            walks: WalkReport::of(s),
            proved: s.proved,
            unproved: s.unproved,
            share_of_light: None,
            paths_met: with_paths.then_some(s.met),
            paths_counted: with_paths.then_some(s.missed),
        })
    }

    /// Says what went wrong.
    fn complain(&self) {
        if self.walks.exhausted > 0 {
            complain!(
                "warning: {} manifold connections {}",
                self.walks.exhausted,
                self.ran_out[1]
            );
        }
    }
}

/// What walks to glints came to, for reports.
#[derive(Clone, Debug, Serialize)]
pub struct GlintReport {
    /// The estimator.
    pub method: String,
    /// Whether it counts every solution: an estimate that ran out of trials does not.
    pub unbiased: bool,
    /// What walks came to, of footprints and light samples.
    #[serde(flatten)]
    pub walks: WalkReport,
}

impl GlintReport {
    /// Of what walks came to, with these settings; `None` without glints.
    pub fn of(settings: &Settings, s: &Statistics) -> Option<Self> {
        let glints = settings.glints?;
        let (method, unbiased) = match glints.method {
            GlintMethod::Unbiased => ("unbiased".to_owned(), true),
            GlintMethod::Biased(trials) => (format!("biased, {trials} walks"), false),
        };
        Some(Self {
            method,
            unbiased: unbiased && s.exhausted == 0 && glints.threshold.is_none(),
            walks: WalkReport::of(s),
        })
    }

    /// Says what went wrong.
    fn complain(&self) {
        if self.walks.exhausted > 0 {
            complain!(
                "warning: {} glints ran out of trials: what they bring is biased; more by --glint-trials",
                self.walks.exhausted
            );
        }
    }
}

/// What walks came to, over images and gradients.
#[derive(Clone, Copy, Debug, Default)]
pub struct Walks {
    connections: Statistics,
    glints: Statistics,
}

impl Walks {
    /// Those of an image.
    pub fn of_image(image: &Rendering) -> Self {
        Self {
            connections: image.connections,
            glints: image.glints,
        }
    }

    /// Those of a gradient.
    pub fn of_gradient(gradient: &Gradient) -> Self {
        Self {
            connections: gradient.connections,
            glints: gradient.glints,
        }
    }

    /// Adds others.
    pub fn merge(&mut self, other: &Self) {
        self.connections.merge(&other.connections);
        self.glints.merge(&other.glints);
    }

    /// Says what went wrong, and reports.
    pub fn report(&self, settings: &Settings) -> SolvedReport {
        let out = self.solved(settings);
        out.complain();
        out
    }

    fn solved(&self, settings: &Settings) -> SolvedReport {
        SolvedReport {
            manifold: ManifoldReport::of(settings, &self.connections),
            glints: GlintReport::of(settings, &self.glints),
        }
    }

    /// What the file of an image says that was made with these settings, of which so many samples were not finite: what reports say
    /// of estimators that solve equations, under the same names, and in `comments` whatever makes it biased.
    pub fn labels(&self, settings: &Settings, bad: &NonFinite) -> Labels {
        let SolvedReport { manifold, glints } = self.solved(settings);
        let manifold = manifold.map(|m| {
            let exhausted = (m.walks.exhausted, m.ran_out[0]);
            ("manifold", m.method, m.unbiased, exhausted)
        });
        let glints = glints.map(|g| ("glints", g.method, g.unbiased, (g.walks.exhausted, TRIALS)));
        let mut labels = Labels::new();
        let mut remarks = Vec::new();
        for (of, method, unbiased, (exhausted, ran_out)) in manifold.into_iter().chain(glints) {
            if exhausted > 0 {
                remarks.push(format!("{of} ({method}): biased, {exhausted} {ran_out}"));
            } else if !unbiased {
                remarks.push(format!("{of} ({method}): biased"));
            }
            labels.insert(format!("{of}.method"), method);
            labels.insert(format!("{of}.unbiased"), unbiased.to_string());
            labels.insert(format!("{of}.exhausted"), exhausted.to_string());
        }
        if bad.count > 0 {
            remarks.push(format!(
                "biased, {} samples were not finite and are left out",
                bad.count
            ));
            labels.insert("non_finite".into(), bad.count.to_string());
        }
        if !remarks.is_empty() {
            labels.insert("comments".into(), remarks.join("; "));
        }
        labels
    }
}

/// What light came to that is found by solving equations, for reports.
#[derive(Clone, Debug, Serialize)]
pub struct SolvedReport {
    /// Over chains.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub manifold: Option<ManifoldReport>,
    /// In glints.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub glints: Option<GlintReport>,
}

impl SolvedReport {
    /// Of an image with these settings. Says what went wrong.
    pub fn of_image(settings: &Settings, image: &Rendering) -> Self {
        let out = Self {
            manifold: ManifoldReport::of_image(settings, image),
            glints: GlintReport::of(settings, &image.glints),
        };
        out.complain();
        out
    }

    fn complain(&self) {
        if let Some(manifold) = &self.manifold {
            manifold.complain();
        }
        if let Some(glints) = &self.glints {
            glints.complain();
        }
    }
}

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
