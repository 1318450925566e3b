//! `recover`: a scene's parameters from images of it, by gradient descent or Gauss-Newton steps.
//!
//! Every iteration renders the image that the loss sees and pulls its adjoint back with other random
//! numbers: with common ones even the squared error is biased (errata Z-4.4). All of them follow from
//! the seed and the number of the iteration, so a run that is resumed from its checkpoint
//! continues bit for bit.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Parser;
use optim::{
    AnyOptimizer, Coarse, Constrained, Diffusion, GaussNewton, Group, Groups, LossKind, Optimizer,
    Parameterisation, Rates, Schedule,
};
use render::instances::{Estimator, hessian_vector_f32};
use render::integrator::gradient::Active;
use render::integrator::render::{Rendering, stays};
use render::integrator::second_order::MAX_VALUES;
use render::params::{ParamShape, Theta};
use render::sampler::mix64;
use render::scene::LoadOptions;
use render::{Image, RenderError, Scene, Settings, image_io};
use serde::{Deserialize, Serialize};

mod file_path;
mod job;
mod results;
mod store;

use self::file_path::FilePath;
use self::job::{Job, Unknown, loss_name, optimizer_name, target_argument};
pub use self::job::{OptimizerArg, TargetArg};
use self::store::{Inputs, Store};
use super::render::{Method, in_passes, passes};
use crate::builtin_scene;
use crate::cli::{
    ListArgs, LoadArgs, Outcome, SampleArgs, ThreadArgs, ToolError, depth, names_of,
    report_non_finite, sample_count, warn_of_crossings,
};
use crate::complain;
use crate::optimise::{Algorithm, Problem, Target};
use crate::output;
use crate::progress::{Bar, Interrupt};
use crate::solved::{ManifoldArgs, Walks};

/// Values of `--iterations`.
const ITERATIONS: RangeInclusive<i64> = 1..=1 << 24;
/// Values of `--size`.
const SIZES: RangeInclusive<i64> = 1..=4096;

const EXAMPLES: &str = "\
Examples:
  recover                                        a built-in room: two walls, a roughness and the light
  recover scene.xml --target photo.exr --param red.reflectance.value --param lamp.emitter.radiance.value
  recover --out folder --resume                  continues where Ctrl-C or a crash ended it
  recover --optimizer gauss-newton               the same room in fewer, dearer steps
  recover scene.xml --target photo.exr --estimator edges --param bunny.vertex_positions:smooth=20,lr=0.002 \
      --param bunny.reflectance.data:coarse=16   shape and texture

Starts from the values of the scene file (-D changes them). Targets are images of the sensor that is looked
through, or, as SENSOR=IMG.EXR, of another one of the scene: the loss is the sum over sensors. Several targets of one
sensor are averaged. The folder receives before, after and target as EXR and side by side, values and loss
of all iterations, charts, and the result as JSON. Ctrl-C keeps everything so far (exit code 130); the
pictures are then left for --resume to complete.";

/// Recovers parameters of a scene from images of it
#[derive(Parser, Clone, Debug)]
#[command(name = "recover", after_help = EXAMPLES)]
pub struct Args {
    /// Scene file, Mitsuba XML [default: a built-in room]
    pub scene: Option<PathBuf>,
    /// Image of the scene, or of one of its sensors, or a layer of one; may be given several times
    #[arg(long = "target", value_name = "[SENSOR=]IMG.EXR[:LAYER]", requires = "scene", value_parser = target_argument())]
    pub targets: Vec<TargetArg>,
    /// Unknown parameter; may be given several times. Behind a colon, how it moves: `lr=RATE` for a rate of its own;
    /// `smooth=LAMBDA` for points of a mesh that move with their neighbours, over a width of about the root of LAMBDA
    /// edges [Nicolet et al. 2021]; `coarse=SIDE` for texels that begin with SIDE along the longer side of the texture
    /// and double until, after three fifths of the iterations, they are its own
    #[arg(long = "param", value_name = "KEY[:OPTION=VALUE,..]")]
    pub params: Vec<String>,
    /// Scene options
    #[command(flatten)]
    pub load: LoadArgs,
    /// Algorithm; steps of sgd are proportional to the derivatives, and small for dim and for large pictures, those
    /// of the others are not [default: adam]
    #[arg(long, value_name = "NAME", value_parser = optimizer_name())]
    pub optimizer: Option<OptimizerArg>,
    /// Number of steps [default: 400; 24 for gauss-newton]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(ITERATIONS))]
    pub iterations: Option<u32>,
    /// Learning rate at the beginning; it falls along a cosine [default: the optimizer's, such as 0.03 for
    /// adam and 1 for sgd]. For gauss-newton the fraction of a step; it falls as one over the number of
    /// steps after the first five [default: 1]
    #[arg(long, value_name = "RATE")]
    pub lr: Option<f64>,
    /// Samples per pixel of each of the two renders of an iteration [default: 12; 48 for gauss-newton]
    #[arg(long, value_name = "N", value_parser = sample_count())]
    pub spp: Option<u32>,
    /// Largest number of path edges; -1 for no limit [default: the scene's]
    #[arg(long, value_name = "N", value_parser = depth)]
    pub max_depth: Option<u32>,
    /// How samples are made
    #[command(flatten)]
    pub samples: SampleArgs,
    /// How chains of smooth surfaces and glints are found, in images and derivatives
    #[command(flatten)]
    pub manifold: ManifoldArgs,
    /// Where derivatives flow: as in `gradient`, but not auto; mis, or edges for what moves, for gauss-newton [default: mis]
    #[arg(long, value_name = "NAME", value_parser = Estimator::from_name)]
    pub estimator: Option<Estimator>,
    /// l1, l2 (mse), relative-l1, relative-l2 or log-l2 [default: relative-l2]
    #[arg(long, value_name = "NAME", value_parser = loss_name)]
    pub loss: Option<String>,
    /// Seed of the random numbers [default: 0]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Resolution of the built-in room [default: 96]
    // To clap a missing scene is no mistake where it would conflict, hence those that require it.
    #[arg(long, value_name = "PIXELS",
          conflicts_with_all = ["scene", "targets", "defines", "allow_missing", "sensor", "values"],
          value_parser = clap::value_parser!(u32).range(SIZES))]
    pub size: Option<u32>,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "out/recover")]
    pub out: PathBuf,
    /// Continue from the folder's checkpoint
    #[arg(long)]
    pub resume: bool,
    /// End after this many iterations of this run, as Ctrl-C does
    #[arg(long, value_name = "N")]
    pub stop_after: Option<u32>,
    /// Threads
    #[command(flatten)]
    pub threads: ThreadArgs,
    /// What there is
    #[command(flatten)]
    pub list_estimators: ListArgs,
}

/// Loss and values before a step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Row {
    #[serde(with = "optim::exact::number")]
    loss: f64,
    /// Up to three values of a parameter, the mean of a texture.
    #[serde(with = "optim::exact::slice")]
    values: Vec<f64>,
}

/// The state of a run; numbers are kept to the last bit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Checkpoint {
    job: Job,
    /// Steps taken.
    iteration: u32,
    /// The unknowns, one after another.
    #[serde(with = "optim::exact::slice")]
    values: Vec<f32>,
    /// Where the scene starts.
    #[serde(skip)]
    start: Vec<f32>,
    optimizer: Algorithm,
    /// Sum of the values after the steps that [`Job::tail`] counts, whose noise it removes; empty before.
    #[serde(with = "optim::exact::slice")]
    tail_sum: Vec<f64>,
    tail: u32,
    history: Vec<Row>,
}

impl Checkpoint {
    /// The best estimate so far.
    fn estimate(&self) -> Vec<f32> {
        if self.tail == 0 {
            return self.values.clone();
        }
        let n = f64::from(self.tail);
        self.tail_sum.iter().map(|s| (s / n) as f32).collect()
    }

    /// What to say where hardly anything has moved, once. Gauss-Newton steps have the right length or a reason.
    fn stalled(&self) -> Option<String> {
        let Algorithm::FirstOrder(optimizer) = &self.optimizer else {
            return None;
        };
        if self.iteration != WATCHED {
            return None;
        }
        let moved = |group: &Group| {
            let change = |i: usize| {
                let [from, to] = [&self.start, &self.values].map(|v| f64::from(v[i]));
                match group.parameterisation {
                    Parameterisation::Log { .. } => (to / from).ln().abs(),
                    _ => (to - from).abs(),
                }
            };
            group.range.clone().map(change).fold(0.0, f64::max)
        };
        let most = optimizer.groups().iter().map(moved).fold(0.0, f64::max);
        let step = most / f64::from(WATCHED);
        let in_all = step * f64::from(self.job.iterations);
        if step >= SLOW * self.job.lr || in_all >= UNSEEN {
            return None;
        }
        let why = match optimizer.inner() {
            AnyOptimizer::Sgd(_) => {
                "its steps are --lr times the derivative, which is small in dim and in large pictures; expected \
                 a larger --lr, or another --optimizer"
            }
            _ => "the image does not depend on them, or too little for single precision",
        };
        Some(format!(
            "no unknown has moved by more than {most:.1e} in {WATCHED} steps of {} at --lr {}: {why}",
            optimizer.inner().name(),
            self.job.lr
        ))
    }
}

const CHECKPOINT: &str = "checkpoint.json";
const PANELS: &str = "before-after-target.png";
/// The scene with what was recovered, with its textures and meshes beside it.
const SAVED: &str = "scene/scene.xml";
/// Time between two checkpoints: what a crash costs at most. Large ones take their time, of which they may have a
/// twentieth.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(5);
const CHECKPOINT_SHARE: u32 = 20;
/// Steps after which a run says that hardly anything has moved: less than this part of the rate per step, and so
/// little that all steps together would hardly be seen.
const WATCHED: u32 = 10;
const SLOW: f64 = 1e-3;
const UNSEEN: f64 = 1e-2;
/// What keeps meshes from folding on their way.
const UNFOLDED: &str = "a smaller lr, or a larger smooth or smaller coarse";
/// Samples per pixel of the built-in target.
const TARGET_SPP: u32 = 2048;
/// Samples per pixel of the pictures before and after.
const PICTURE_SPP: u64 = 512;

/// A seed of its own for every purpose.
fn stream(seed: u64, n: u64) -> u64 {
    mix64(mix64(seed ^ 0x5eed_0f5e_ed0f_5eed).wrapping_add(n.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
}
const TARGET_STREAM: u64 = u64::MAX;
const PICTURE_STREAM: u64 = u64::MAX - 1;
const GUIDE_STREAM: u64 = u64::MAX - 2;

/// The problem, and its solution for the built-in scene.
struct Recovery {
    problem: Problem,
    /// One per target of the problem.
    views: Vec<View>,
    /// The true values.
    truth: Option<Vec<f32>>,
    /// Triangles that are turned over at the start, or were when that was said last.
    folded: BTreeMap<String, usize>,
    /// What walks to solutions came to, since the run was started or resumed.
    walks: Walks,
}

/// Runs the tool.
///
/// # Errors
/// Anything wrong with the arguments, the scene, the checkpoint or the files.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Outcome, ToolError> {
    args.threads.run(|_| recover(args, interrupt))
}

fn recover(args: &Args, interrupt: &Interrupt) -> Result<Outcome, ToolError> {
    let (job, resumed, store) = if args.resume {
        let mut store = Store::existing(&args.out, CHECKPOINT)?;
        let (checkpoint, inputs) = store.read()?;
        checkpoint.job.require_same(args)?;
        let job = checkpoint.job.clone();
        (job, Some((checkpoint, inputs)), Some(store))
    } else {
        let job = Job::new(args)?;
        let there = args.out.is_dir();
        let store = there.then(|| Store::open(&args.out, CHECKPOINT));
        (job, None, store.transpose()?)
    };
    let estimator = Estimator::from_name(&job.estimator)?;
    let (mut scene, settings, active, start, truth) = load(&job, estimator)?;
    interrupt.keep();
    estimator.check(&scene)?;
    check_derivatives(&job, (&scene, &settings), estimator, &active)?;
    let loss: LossKind = job.loss.parse()?;
    let panels_file = args.out.join(PANELS);
    let views = views(&job, &scene)?;
    let files = |kind: &str| {
        views
            .iter()
            .map(|v| args.out.join(v.file(kind)))
            .collect::<Vec<_>>()
    };
    let [target_files, before_files, after_files] = ["target", "before", "after"].map(files);
    let given = args.resume.then_some(&target_files[..]);
    let Some(targets) = targets(&job, &views, given, &mut scene, &settings, interrupt)? else {
        complain!("interrupted before the target was complete: nothing was written");
        return Ok(Outcome::Interrupted);
    };
    // Guides and measured pixels are those of the first view.
    views[0].look(&mut scene)?;
    let mut store = match store {
        Some(store) => store,
        None => Store::open(&args.out, CHECKPOINT)?,
    };
    let (mut state, inputs) = match resumed {
        Some((state, inputs)) => {
            inputs.require_same(&scene, &start, (&targets, &target_files), store.path())?;
            (Checkpoint { start, ..state }, inputs)
        }
        None => {
            let state = Checkpoint {
                optimizer: optimizer(&job, &scene, &active, &start)?,
                job: job.clone(),
                iteration: 0,
                values: start.clone(),
                tail_sum: Vec::new(),
                tail: 0,
                history: Vec::new(),
                start,
            };
            let inputs = Inputs::of(&scene, &state.start, &job.targets, &targets)?;
            (state, inputs)
        }
    };
    let problem = Problem {
        scene,
        settings,
        image_spp: None,
        active,
        estimator,
        loss,
        targets,
    };
    let mut recovery = Recovery {
        problem,
        views,
        truth,
        folded: BTreeMap::new(),
        walks: Walks::default(),
    };
    if args.resume {
        recovery.check(&state, store.path())?;
    }
    // As every run and every continuation of it starts.
    recovery.problem.set(&state.start)?;
    recovery.report_folds("a mesh without folds to start from");
    let seed = stream(job.seed, GUIDE_STREAM);
    (job.samples).learn(&mut recovery.problem.scene, &settings, seed, interrupt);
    if !args.resume {
        // Those of another job.
        store.clear()?;
        for file in before_files
            .iter()
            .chain(&after_files)
            .chain([&panels_file])
        {
            output::remove(file)?;
        }
        for (file, target) in target_files.iter().zip(&recovery.problem.targets) {
            image_io::write_exr(file, &target.image)?;
        }
        store.write(&state, &inputs)?;
    }
    let before = recovery.pictures_before(&before_files, job.seed, interrupt)?;

    let first = state.iteration;
    let left = job.iterations.saturating_sub(first);
    let stop = first + args.stop_after.unwrap_or(left).min(left);
    recovery.steps(&mut state, stop, (&mut store, &inputs), interrupt)?;
    if state.iteration != first {
        // They show other values.
        for file in after_files.iter().chain([&panels_file]) {
            output::remove(file)?;
        }
    }
    let samples = recovery.write_results(&args.out, &state, &before, interrupt)?;
    if state.iteration == job.iterations && samples == PICTURE_SPP {
        return Ok(Outcome::Done);
    }
    let picture = match samples {
        n if n == PICTURE_SPP => String::new(),
        n => format!(", with {n} of {PICTURE_SPP} samples per pixel of the picture after"),
    };
    complain!(
        "stopped after {} of {} iterations{picture}; --resume --out {} continues",
        state.iteration,
        job.iterations,
        args.out.display()
    );
    Ok(Outcome::Interrupted)
}

impl Recovery {
    /// The pictures before: those that are there, and what is missing where it is made in time.
    fn pictures_before(
        &mut self,
        files: &[PathBuf],
        seed: u64,
        interrupt: &Interrupt,
    ) -> Result<Vec<Option<Image>>, ToolError> {
        let mut before = Vec::new();
        for (view, file) in files.iter().enumerate() {
            self.look(view)?;
            if !file.exists() {
                // Complete or not at all: a run that is resumed makes one that is missing.
                let picture = self.picture("before", seed, interrupt)?;
                if let Some(picture) = picture.filter(is_complete) {
                    self.write_picture(file, &picture)?;
                }
            }
            before.push(if file.exists() {
                Some(read_size(file, &self.problem.scene)?)
            } else {
                None
            });
        }
        self.look(0)?;
        Ok(before)
    }

    /// Steps until as many are done, with a checkpoint every now and then, and one at the end.
    fn steps(
        &mut self,
        state: &mut Checkpoint,
        stop: u32,
        (store, inputs): (&mut Store, &Inputs),
        interrupt: &Interrupt,
    ) -> Result<(), ToolError> {
        let bar = Bar::new("recover", state.job.iterations.into(), interrupt);
        let (mut last_save, mut save_every) = (Instant::now(), CHECKPOINT_EVERY);
        while state.iteration < stop && !interrupt.is_set() {
            bar.set(state.iteration.into());
            // What was there before a failing step is worth keeping, too.
            match self.step(state, interrupt) {
                Ok(true) => {}
                Ok(false) => break,
                Err(e) => {
                    store.write(state, inputs)?;
                    return Err(e);
                }
            }
            if let Some(row) = state.history.last() {
                bar.message(format!("loss {:.3e}", row.loss));
            }
            if let Some(warning) = state.stalled() {
                complain!("warning: {warning}");
            }
            if last_save.elapsed() > save_every {
                let begin = Instant::now();
                store.write(state, inputs)?;
                last_save = Instant::now();
                save_every = CHECKPOINT_EVERY.max(CHECKPOINT_SHARE * (last_save - begin));
            }
        }
        bar.finish();
        store.write(state, inputs)
    }
}

/// The target of every view: those of an earlier run, or as the job says. `None` if interrupted before they are complete.
fn targets(
    job: &Job,
    views: &[View],
    given: Option<&[PathBuf]>,
    scene: &mut Scene,
    settings: &Settings,
    interrupt: &Interrupt,
) -> Result<Option<Vec<Target>>, ToolError> {
    let mut targets = Vec::new();
    for (i, view) in views.iter().enumerate() {
        view.look(scene)?;
        let image = match given {
            Some(files) => Some(read_size(&files[i], scene)?),
            None => target(job, view, scene, settings, interrupt)?,
        };
        let Some(image) = image else {
            return Ok(None);
        };
        targets.push(Target {
            sensor: view.sensor,
            image,
        });
    }
    Ok(Some(targets))
}

/// How its images and derivatives by the named parameters are made.
///
/// # Errors
/// What cannot be made like that.
fn settings<N: AsRef<str>>(job: &Job, scene: &Scene, names: &[N]) -> Result<Settings, ToolError> {
    let mut settings = scene.settings;
    settings.spp = job.spp;
    settings.max_depth = job.max_depth.unwrap_or(settings.max_depth);
    job.samples.apply(scene, &mut settings)?;
    job.manifold.apply(scene, &mut settings)?;
    for name in names {
        stays(&settings, scene.params().find(name.as_ref())?)?;
    }
    Ok(settings)
}

/// Whether the derivatives can be had.
///
/// # Errors
/// What they cannot be had with, before anything is made or written.
fn check_derivatives(
    job: &Job,
    (scene, settings): (&Scene, &Settings),
    estimator: Estimator,
    active: &Active,
) -> Result<(), ToolError> {
    job.samples.check_guided(estimator)?;
    // Without samples they check what they are asked for, and do nothing else.
    let none = render::Job::new(scene, settings, 0, 0..0, &());
    let theta = Theta::constant(scene.params().values());
    let adjoint = vec![0.0; scene.film.pixels() * 3];
    if job.optimizer == OptimizerArg::GaussNewton && estimator == Estimator::SECOND_ORDER {
        let still = vec![0.0; active.len()];
        hessian_vector_f32(&none, &theta, active, &still, [&adjoint, &adjoint])?;
    } else {
        estimator.backward_f32(&none, &theta, active, &adjoint)?;
    }
    Ok(())
}

/// A scene, how its images are made, its unknowns, their start values and, if known, the truth.
type Loaded = (Scene, Settings, Active, Vec<f32>, Option<Vec<f32>>);

fn load(job: &Job, estimator: Estimator) -> Result<Loaded, ToolError> {
    let Some(path) = &job.scene else {
        let mut scene = render::scene::room(job.size, job.size)?;
        let unknowns = builtin_scene::cornell_unknowns();
        let names = names_of(&mut scene, &job.keys()?)?;
        let settings = settings(job, &scene, &names)?;
        let active = estimator.active(&scene, &names)?;
        let (mut start, mut truth) = (Vec::new(), Vec::new());
        for info in active.ranges() {
            let values = &scene.params().values()[info.range()];
            truth.extend_from_slice(values);
            match unknowns.iter().find(|u| u.name == info.name) {
                Some(u) => start.extend_from_slice(&u.start),
                None => start.extend_from_slice(values),
            }
        }
        return Ok((scene, settings, active, start, Some(truth)));
    };
    let load = LoadArgs {
        defines: job.defines.clone(),
        allow_missing: job.allow_missing,
        sensor: job.sensor.clone(),
        values: job.values.clone(),
    };
    let options = LoadOptions {
        several_sensors: job.targets.iter().any(|t| t.sensor.is_some()),
        ..load.options()
    };
    let (mut scene, _) = load.load_with(&path.0, &options)?;
    let names = names_of(&mut scene, &job.keys()?)?;
    let settings = settings(job, &scene, &names)?;
    let active = estimator.active(&scene, &names)?;
    warn_of_crossings(&scene, estimator, &names);
    let mut start = Vec::new();
    for info in active.ranges() {
        start.extend_from_slice(&scene.params().values()[info.range()]);
    }
    Ok((scene, settings, active, start, None))
}

/// Whether a picture has all of its samples.
fn is_complete(picture: &Rendering) -> bool {
    picture.samples == PICTURE_SPP
}

/// What a run compares: the images of one sensor.
struct View {
    /// Its number in the scene, if there are several views or it was named.
    sensor: Option<usize>,
    /// Its name; none where there is one view.
    name: Option<String>,
    /// Its images.
    images: Vec<FilePath>,
}

impl View {
    /// The file of its `kind` of picture.
    fn file(&self, kind: &str) -> String {
        match &self.name {
            None => format!("{kind}.exr"),
            Some(name) => format!("{kind}-{}.exr", output::file_name(name)),
        }
    }

    /// Looks through its sensor.
    fn look(&self, scene: &mut Scene) -> Result<(), RenderError> {
        self.sensor
            .map_or(Ok(()), |sensor| scene.look_through(sensor))
    }
}

/// The views that the targets of a job are of, in the order of their first one.
///
/// # Errors
/// A sensor that the scene does not have.
fn views(job: &Job, scene: &Scene) -> Result<Vec<View>, ToolError> {
    let numbered = |name: &str| {
        let number = scene.sensor_called(name);
        number.map_err(|e| ToolError::Usage(format!("--target: {e}")))
    };
    if job.targets.iter().all(|t| t.sensor.is_none()) {
        return Ok(vec![View {
            sensor: None,
            name: None,
            images: job.targets.iter().map(|t| t.image.clone()).collect(),
        }]);
    }
    let looked_through = job.sensor.as_deref().map_or(Ok(0), numbered)?;
    let mut views = Vec::<View>::new();
    for target in &job.targets {
        let sensor = target
            .sensor
            .as_deref()
            .map_or(Ok(looked_through), numbered)?;
        match views.iter_mut().find(|v| v.sensor == Some(sensor)) {
            Some(view) => view.images.push(target.image.clone()),
            None => views.push(View {
                sensor: Some(sensor),
                name: Some(scene.sensors()[sensor].name.clone()),
                images: vec![target.image.clone()],
            }),
        }
    }
    if let [only] = &mut views[..] {
        only.name = None;
    }
    Ok(views)
}

/// What the image of a view is compared with; `None` if interrupted.
fn target(
    job: &Job,
    view: &View,
    scene: &Scene,
    settings: &Settings,
    interrupt: &Interrupt,
) -> Result<Option<Image>, ToolError> {
    if view.images.is_empty() {
        let mut settings = *settings;
        settings.spp = TARGET_SPP;
        let total = scene.film.pixels() as u64 * passes(scene, &settings);
        let bar = Bar::new("target", total, interrupt);
        let seed = stream(job.seed, TARGET_STREAM);
        let rendering = in_passes(scene, Method::Paths(Estimator::Mis), &settings, seed, &bar)?;
        bar.finish();
        let complete = rendering.filter(|r| r.samples == u64::from(TARGET_SPP));
        return Ok(complete.map(|r| r.image(0)));
    }
    let mut sum = vec![0.0f64; scene.film.pixels() * 3];
    for path in &view.images {
        let image = read_size(&path.0, scene)?;
        for (s, x) in sum.iter_mut().zip(&image.data) {
            *s += f64::from(*x);
        }
    }
    let [width, height] = scene.film.crop_size;
    let mut mean = Image::new(width as usize, height as usize);
    for (m, s) in mean.data.iter_mut().zip(sum) {
        *m = (s / view.images.len() as f64) as f32;
    }
    Ok(Some(mean))
}

fn read_size(path: &Path, scene: &Scene) -> Result<Image, ToolError> {
    output::read_image(path, scene.film.crop_size.map(|n| n as usize))
}

/// Name, number of steps, groups and rates of an algorithm: what follows from the job.
fn plan(algorithm: &Algorithm) -> (&'static str, u64, &Groups, &Rates) {
    match algorithm {
        Algorithm::FirstOrder(o) => (o.inner().name(), o.steps(), o.groups(), o.rates()),
        Algorithm::GaussNewton(o) => (
            OptimizerArg::GaussNewton.name(),
            o.steps(),
            o.groups(),
            o.rates(),
        ),
    }
}

/// The unknowns with their bounds, starting from `values`.
///
/// # Errors
/// None that a scene can cause.
pub fn groups(active: &Active, values: &[f32]) -> Result<Groups, ToolError> {
    let mut groups = Groups::new(values.len());
    let mut at = 0;
    for info in active.ranges() {
        let range = at..at + info.shape.len();
        at = range.end;
        // Coordinates have no bounds that anybody would reach.
        let map = match info.shape {
            ParamShape::Points { .. } => Parameterisation::Identity,
            _ => Parameterisation::usual(info.valid, &values[range.clone()])?,
        };
        groups.add(info.name.clone(), range, map)?;
    }
    Ok(groups)
}

/// Whole Gauss-Newton steps; those after them average.
pub const WHOLE_STEPS: u64 = 5;

/// What a range cannot be asked for.
fn unsuited(name: &str, expected: &str, option: &str) -> ToolError {
    ToolError::Usage(format!(
        "--param: expected {expected} for {option}, found `{name}`"
    ))
}

/// The unknowns with their rates, and how they move together.
fn plans(
    job: &Job,
    scene: &Scene,
    active: &Active,
    values: &[f32],
) -> Result<(Rates, Groups), ToolError> {
    let mut rates = Rates::new(values.len(), job.lr)?;
    let mut groups = groups(active, values)?;
    let unknowns = job.unknowns().map_err(ToolError::Usage)?;
    let mut at = 0;
    for info in active.ranges() {
        let range = at..at + info.shape.len();
        at = range.end;
        let mine = |u: &&Unknown| {
            let fitting = scene.params().matching(&u.key);
            fitting.is_ok_and(|all| all.iter().any(|i| i.name == info.name))
        };
        let Some(unknown) = unknowns.iter().find(mine) else {
            continue;
        };
        if let Some(lr) = unknown.lr {
            rates.set_rate(range.clone(), lr)?;
        }
        if let Some(lambda) = unknown.smooth {
            let mesh = scene.mesh_of(info);
            let mesh = mesh.ok_or_else(|| unsuited(&info.name, "points of a mesh", "smooth"))?;
            let triangles = mesh.welding().triangles(mesh.data());
            let points: Vec<u64> = (0..mesh.points() as u64).collect();
            groups.tie(
                &info.name,
                Diffusion::of_triangles(&points, &triangles, lambda)?,
            )?;
        }
        if let Some(side) = unknown.coarse {
            let ParamShape::Texture {
                height,
                width,
                channels,
            } = info.shape
            else {
                return Err(unsuited(&info.name, "texels", "coarse"));
            };
            let doublings = (height.max(width).div_ceil(side))
                .next_power_of_two()
                .ilog2();
            let every = 3 * u64::from(job.iterations) / (5 * u64::from(doublings.max(1)));
            let coarse = Coarse::new([width, height], channels, side, every.max(1))?;
            groups.coarsen(&info.name, coarse)?;
        }
    }
    Ok((rates, groups))
}

fn optimizer(
    job: &Job,
    scene: &Scene,
    active: &Active,
    values: &[f32],
) -> Result<Algorithm, ToolError> {
    let (rates, groups) = plans(job, scene, active, values)?;
    match job.optimizer {
        OptimizerArg::FirstOrder(name) => {
            let schedule = Schedule::Cosine {
                steps: job.iterations.into(),
                floor: 0.01,
            };
            let inner = AnyOptimizer::new(name, rates.with_schedule(schedule)?)?;
            Ok(Algorithm::FirstOrder(Constrained::new(inner, groups)?))
        }
        OptimizerArg::GaussNewton => {
            if values.len() > MAX_VALUES {
                return Err(ToolError::Usage(format!(
                    "--param: expected at most {MAX_VALUES} unknown values for gauss-newton, found {}",
                    values.len()
                )));
            }
            let schedule = Schedule::Harmonic { hold: WHOLE_STEPS };
            let rates = rates.with_schedule(schedule)?;
            let inner = GaussNewton::new(rates, groups, Default::default())?;
            Ok(Algorithm::GaussNewton(inner))
        }
    }
}

impl Recovery {
    /// Whether a run of this job can have left this state, as far as a look at it tells.
    fn check(&mut self, state: &Checkpoint, path: &Path) -> Result<(), ToolError> {
        let (job, start) = (&state.job, &state.start);
        let require = |holds: bool, key: &str, expected: &dyn Display, found: &dyn Display| {
            if holds {
                return Ok(());
            }
            let message = format!("{key}: expected {expected}, found {found}");
            Err(ToolError::file(path, message))
        };
        let (expected, found) = (start.len(), state.values.len());
        let what = format!("{expected} values as in the scene");
        require(found == expected, "values", &what, &found)?;

        let (n, last) = (state.iteration, job.iterations);
        let expected = format!("at most the {last} of job.iterations");
        require(n <= last, "iteration", &expected, &n)?;
        let rows = state.history.len();
        let expected = format!("a row for each of {n} iterations");
        require(rows == n as usize, "history", &expected, &rows)?;
        let names = self.tracked_names().len();
        for (i, row) in state.history.iter().enumerate() {
            let key = format!("history[{i}].loss");
            require(row.loss.is_finite(), &key, &"a finite number", &row.loss)?;
            let (key, found) = (format!("history[{i}].values"), row.values.len());
            require(found == names, &key, &format!("{names} values"), &found)?;
            for v in &row.values {
                require(v.is_finite(), &key, &"finite values", v)?;
            }
        }
        let tail = job.tail(n);
        let expected = format!("{tail} after {n} of {last} iterations");
        require(state.tail == tail, "tail", &expected, &state.tail)?;
        let expected = if tail > 0 { start.len() } else { 0 };
        let what = format!("{expected} values with a tail of {tail}");
        let found = state.tail_sum.len();
        require(found == expected, "tail_sum", &what, &found)?;

        let fresh = optimizer(job, &self.problem.scene, &self.problem.active, start)?;
        let (expected, found) = (plan(&fresh), plan(&state.optimizer));
        require(found.0 == expected.0, "optimizer", &expected.0, &found.0)?;
        // A Gauss-Newton step may have been taken back.
        let steps = match state.optimizer {
            Algorithm::FirstOrder(_) => u64::from(n)..=n.into(),
            Algorithm::GaussNewton(_) => 0..=n.into(),
        };
        let what = format!("{} to {} steps", steps.start(), steps.end());
        require(steps.contains(&found.1), "optimizer.steps", &what, &found.1)?;
        let groups = expected.2 == found.2;
        require(groups, "optimizer.groups", &"those of the scene", &"others")?;
        let rates = expected.3 == found.3;
        require(rates, "optimizer.rates", &"those of the job", &"others")?;

        // Finite and within the bounds of the scene.
        for (key, values) in [("tail_sum", &state.estimate()), ("values", &state.values)] {
            (self.problem.set(values)).map_err(|e| ToolError::file(path, format!("{key}: {e}")))?;
        }
        Ok(())
    }

    /// One iteration. `false` if interrupted: nothing has changed then.
    fn step(&mut self, state: &mut Checkpoint, interrupt: &Interrupt) -> Result<bool, ToolError> {
        let i = u64::from(state.iteration);
        let seeds = [2 * i, 2 * i + 1].map(|n| stream(state.job.seed, n));
        let values = self.tracked(&state.values);
        let Checkpoint {
            values: unknowns,
            optimizer,
            ..
        } = state;
        let step = self
            .problem
            .advance(unknowns, optimizer, seeds, interrupt)?;
        let Some(step) = step else {
            return Ok(false);
        };
        let width = self.problem.scene.film.crop_size[0] as usize;
        for (bad, seed) in step.non_finite.iter().zip(seeds) {
            report_non_finite(bad, width, seed);
        }
        self.walks.merge(&step.walks);
        self.report_folds(UNFOLDED);
        let loss = step.loss;
        state.history.push(Row { loss, values });
        state.iteration += 1;
        let tail = state.job.tail(state.iteration);
        if tail > 0 {
            state.tail = tail;
            state.tail_sum.resize(state.values.len(), 0.0);
            for (s, v) in state.tail_sum.iter_mut().zip(&state.values) {
                *s += f64::from(*v);
            }
        }
        Ok(true)
    }

    /// Triangles that are turned over, by mesh.
    fn folds(&self) -> BTreeMap<String, usize> {
        let folded = self.problem.scene.folded().into_iter();
        folded.map(|(name, count, _)| (name, count)).collect()
    }

    /// Says of meshes that fold over themselves by more triangles than was said before, twice as many at least, what was
    /// expected instead.
    fn report_folds(&mut self, expected: &str) {
        for (name, folded, all) in self.problem.scene.folded() {
            let said = self.folded.entry(name.clone()).or_default();
            if folded >= (2 * *said).max(1) {
                *said = folded;
                complain!(
                    "warning: `{name}` folds over itself: {folded} of {all} triangles are turned over; expected {expected}"
                );
            }
        }
    }

    /// What is kept of every iteration: up to three values per parameter, the mean of a texture.
    fn tracked(&self, values: &[f32]) -> Vec<f64> {
        let mut out = Vec::new();
        let mut at = 0;
        for info in self.problem.active.ranges() {
            let own = &values[at..at + info.shape.len()];
            at += own.len();
            if own.len() <= 3 {
                out.extend(own.iter().map(|&v| f64::from(v)));
            } else {
                out.push(own.iter().map(|&v| f64::from(v)).sum::<f64>() / own.len() as f64);
            }
        }
        out
    }

    /// Names of the tracked numbers.
    fn tracked_names(&self) -> Vec<String> {
        let mut out = Vec::new();
        for info in self.problem.active.ranges() {
            match info.shape.len() {
                1 => out.push(info.name.clone()),
                n @ 2..=3 => out.extend((0..n).map(|i| format!("{}[{i}]", info.name))),
                _ => out.push(format!("mean of {}", info.name)),
            }
        }
        out
    }

    /// Looks through the sensor of a view.
    fn look(&mut self, view: usize) -> Result<(), RenderError> {
        self.views[view].look(&mut self.problem.scene)
    }

    /// The scene as it is, with little noise. When stopped, the passes that were complete; `None` if there
    /// is none.
    fn picture(
        &self,
        what: &str,
        seed: u64,
        interrupt: &Interrupt,
    ) -> Result<Option<Rendering>, RenderError> {
        let scene = &self.problem.scene;
        let settings = Settings {
            spp: PICTURE_SPP as u32,
            ..self.problem.settings
        };
        let total = scene.film.pixels() as u64 * passes(scene, &settings);
        let bar = Bar::new(what, total, interrupt);
        let method = Method::Paths(Estimator::Mis);
        let seed = stream(seed, PICTURE_STREAM);
        let picture = in_passes(scene, method, &settings, seed, &bar)?;
        bar.finish();
        Ok(picture)
    }

    /// Writes it with what is to be said of it.
    fn write_picture(&self, file: &Path, picture: &Rendering) -> Result<Image, ToolError> {
        let walks = Walks::of_image(picture);
        let labels = walks.labels(&self.problem.settings, &picture.non_finite);
        let image = picture.image(0);
        image_io::write_exr_with(file, &image, None, &labels)?;
        Ok(image)
    }
}
