//! `render`: a scene to an image.

mod energy;

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Parser, ValueEnum};
use render::Job;
use render::bsdf::kernel::{Rules, Symmetry};
use render::bsdf::nesting::{flips_normals, scatters_deltas};
use render::instances::{Estimator, density_f32, particles_f32, render_f32};
use render::integrator::coverage;
use render::integrator::density::Convention;
use render::integrator::particle;
use render::integrator::render::{Progress, Rendering};
use render::params::Theta;
use render::scene::{Caustics, LightChoice};
use render::{RenderError, Scene, Settings, image_io};
use serde::Serialize;

use crate::cli::{
    LoadArgs, Outcome, SampleArgs, ThreadArgs, ToolError, depth, report_non_finite, sample_count,
    warn_of_unsampled,
};
use crate::output;
use crate::progress::{Bar, Interrupt};
use crate::solved::{ManifoldArgs, SolvedReport, Walks, complain_of_more_light, manifold_planes};
use crate::tools::check;
use crate::{complain, say};
use energy::Energy;

const EXAMPLES: &str = "\
Examples:
  render scene.xml                               scene.exr and scene.png
  render scene.xml -o out.exr --spp 256 -D depth=12
  render scene.xml --strategy bsdf --json out.json
  render scene.xml --integrator particle         light tracing
  render pool.xml --integrator density --radius 0.02
  render scene.xml -P wall.reflectance.value=0.8 -P '*.alpha'=0.2
  render scene.xml -P wall.reflectance=0.8 --save new/scene.xml
  render scene.xml --check --json found.json     what of it is understood
  render --schema scene.rng                      for editors that complete scene files
  render pool.xml --manifold sms --bounces 1     caustics by specular manifold sampling

Ctrl-C keeps the samples so far (exit code 130).";

/// Renders a scene to an EXR image and a tone-mapped PNG beside it
#[derive(Parser, Clone, Debug)]
#[command(name = "render", after_help = EXAMPLES)]
pub struct Args {
    /// Scene file, Mitsuba XML
    #[arg(required_unless_present = "schema")]
    pub scene: Option<PathBuf>,
    /// Image to write [default: the scene's name in the current folder]
    #[arg(short, long, value_name = "OUT.EXR")]
    pub output: Option<PathBuf>,
    /// Scene options
    #[command(flatten)]
    pub load: LoadArgs,
    /// Samples per pixel [default: the scene's]
    #[arg(long, value_name = "N", value_parser = sample_count())]
    pub spp: Option<u32>,
    /// How samples are made
    #[command(flatten)]
    pub samples: SampleArgs,
    /// Light over specular chains
    #[command(flatten)]
    pub manifold: ManifoldArgs,
    /// Largest number of path edges: 1 is emission, 2 direct light; -1 for no limit [default: the scene's]
    #[arg(long, value_name = "N", value_parser = depth)]
    pub max_depth: Option<u32>,
    /// Seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Threads
    #[command(flatten)]
    pub threads: ThreadArgs,
    /// Say whether manifold connections miss any light: by means of blocks of the light of chains, which particles that land
    /// on receivers bring as well; takes about as long again
    #[arg(long)]
    pub manifold_check: bool,
    /// Write what manifold connections came to in each pixel: channels success_rate (of walks), steps (per walk), trials (per
    /// solution) and share (of the light)
    #[arg(long, value_name = "OUT.EXR")]
    pub manifold_picture: Option<PathBuf>,
    /// Where light is followed from
    #[arg(long, value_enum, default_value_t)]
    pub integrator: IntegratorArg,
    /// Radius within which `--integrator density` collects particles, world space
    #[arg(long, value_name = "R", value_parser = radius, required_if_eq("integrator", "density"))]
    pub radius: Option<f64>,
    /// The mistake, on purpose: particles scatter like viewing rays, and refraction scales neither
    #[arg(long)]
    pub ignore_non_symmetry: bool,
    /// Techniques for direct light
    #[arg(long, value_enum, default_value_t)]
    pub strategy: StrategyArg,
    /// Weights where techniques are combined
    #[arg(long, value_enum, default_value_t)]
    pub heuristic: HeuristicArg,
    /// Read everything, files that are missing or not, say what is understood, substituted, ignored or refused, with its
    /// line, and do nothing else; the exit code says whether the scene would render
    #[arg(long, conflicts_with_all = ["output", "spp", "max_depth", "radius", "ignore_non_symmetry", "SampleArgs", "ThreadArgs"])]
    pub check: bool,
    /// Write the scene with its parameters as they are, for this renderer and Mitsuba 3, with its textures and meshes in
    /// folders beside it, and do nothing else
    #[arg(long, value_name = "OUT.XML", conflicts_with_all = ["output", "spp", "max_depth", "radius", "ignore_non_symmetry", "json", "check", "SampleArgs", "ThreadArgs"])]
    pub save: Option<PathBuf>,
    /// Write a schema of scene files, RELAX NG, by which editors complete and check them, and do nothing else
    #[arg(long, value_name = "OUT.RNG", exclusive = true)]
    pub schema: Option<PathBuf>,
    /// Write size, samples and times, or what was found, to this file
    #[arg(long, value_name = "OUT.JSON")]
    pub json: Option<PathBuf>,
}

/// `--strategy`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum StrategyArg {
    /// BSDF and emitter sampling, combined
    #[default]
    Mis,
    /// BSDF sampling
    Bsdf,
    /// Emitter sampling
    Emitter,
}

/// `--integrator`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum IntegratorArg {
    /// The path tracer: from the camera
    #[default]
    Path,
    /// The light tracer: particles from the lights, connected to the pinhole
    Particle,
    /// Particles collected where viewing rays land: caustics seen through water, slightly blurred
    Density,
}

/// How the image is made.
#[derive(Clone, Copy, Debug)]
pub enum Method {
    /// By paths from the camera, with the techniques of an estimator.
    Paths(Estimator),
    /// By particles that are connected to the camera.
    Particles(Rules),
    /// By particles that are collected within a radius.
    Density(Rules, f64),
}

/// A radius: a positive number.
fn radius(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(r) if r > 0.0 && (1e-30..1e30).contains(&r) => Ok(r),
        _ => Err("expected a positive length".into()),
    }
}

/// `--heuristic`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum HeuristicArg {
    /// Squared densities
    #[default]
    Power,
    /// Densities
    Balance,
}

impl Args {
    /// What the arguments ask for.
    ///
    /// # Errors
    /// Arguments that mean nothing together.
    fn method(&self) -> Result<Method, ToolError> {
        let symmetry = if self.ignore_non_symmetry {
            Symmetry::Ignored
        } else {
            Symmetry::Respected
        };
        let rules = Rules {
            symmetry,
            side_tests: false,
        };
        let paths = self.integrator == IntegratorArg::Path;
        let lights = self.samples.lights.unwrap_or_default() != LightChoice::One;
        let caustics = self.samples.caustics.unwrap_or_default() != Caustics::Paths;
        let strategy = self.strategy != StrategyArg::Mis;
        let heuristic = self.heuristic != HeuristicArg::Power;
        // What would have no effect.
        for (idle, message) in [
            (
                lights && !paths,
                "--lights: particles choose no lights; expected --integrator path",
            ),
            (
                lights && self.strategy == StrategyArg::Bsdf,
                "--lights: BSDF sampling chooses no lights; expected --strategy mis or emitter",
            ),
            (
                caustics && !paths,
                "--caustics: all light is particles' here; expected --integrator path",
            ),
            (
                self.manifold.manifold.is_some() && !paths,
                "--manifold: all light is particles' here; expected --integrator path",
            ),
            (
                self.manifold.glints.glints.is_some() && !paths,
                "--glints: all light is particles' here; expected --integrator path",
            ),
            (
                self.samples.guide && !paths,
                "--guide: particles are not guided; expected --integrator path",
            ),
            (
                strategy && !paths,
                "--strategy: particles find the camera in one way only; expected --integrator path",
            ),
            (
                heuristic && !paths,
                "--heuristic: particles combine no techniques; expected --integrator path",
            ),
            (
                heuristic && strategy,
                "--heuristic: a single technique has no weights; expected --strategy mis",
            ),
        ] {
            if idle {
                return Err(ToolError::Usage(message.into()));
            }
        }
        match (self.integrator, self.radius) {
            (IntegratorArg::Path, None) if !self.ignore_non_symmetry => {
                Ok(Method::Paths(self.estimator()))
            }
            (IntegratorArg::Particle, None) => Ok(Method::Particles(rules)),
            (IntegratorArg::Density, Some(radius)) => Ok(Method::Density(rules, radius)),
            _ => Err(ToolError::Usage(
                "--radius belongs to --integrator density, --ignore-non-symmetry to particle and \
                 density"
                    .into(),
            )),
        }
    }

    /// The one whose techniques these are.
    fn estimator(&self) -> Estimator {
        match (self.strategy, self.heuristic) {
            (StrategyArg::Mis, HeuristicArg::Power) => Estimator::Mis,
            (StrategyArg::Mis, HeuristicArg::Balance) => Estimator::MisBalance,
            (StrategyArg::Bsdf, _) => Estimator::Detached,
            (StrategyArg::Emitter, _) => Estimator::Emitter,
        }
    }
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct Report {
    scene: String,
    width: usize,
    height: usize,
    spp: u64,
    #[serde(flatten)]
    samples: SampleArgs,
    #[serde(flatten)]
    solved: SolvedReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    manifold_check: Option<Energy>,
    threads: usize,
    seconds_load: f64,
    seconds_render: f64,
}

/// Refuses what a method cannot do, and says what it does not show.
fn check_method(method: Method, scene: &Scene) -> Result<(), ToolError> {
    match method {
        Method::Paths(estimator) => warn_of_unsampled(scene, estimator),
        Method::Particles(_) => {
            particle::check(scene)?;
            warn_of_deltas(scene);
        }
        Method::Density(..) => particle::check(scene)?,
    }
    Ok(())
}

/// Refuses what `--manifold-check` cannot check, before there is an image to lose.
fn check_checkable(scene: &Scene, settings: &Settings) -> Result<(), ToolError> {
    let connects = (settings.connections).is_some_and(|c| c.method.walks());
    let message = if !connects {
        "--manifold-check: no connections to check; expected --manifold, or a scene that asks for them"
    } else if scene.materials().iter().any(|m| flips_normals(m)) {
        "--manifold-check: flip_invalid_normals turns normals to the viewer, whom particles do not know; expected a scene \
         without it, or no check"
    } else {
        return Ok(());
    };
    Err(ToolError::Usage(message.into()))
}

/// Says which shape, if any, particles do not show as it is: they reach the camera from no Dirac delta.
fn warn_of_deltas(scene: &Scene) {
    let shapes = 0..scene.shapes().len() as u32;
    let mut deltas = shapes.filter(|&shape| scatters_deltas(scene.material(shape)));
    if let Some(first) = deltas.next() {
        complain!(
            "warning: --integrator particle: what the camera sees by `{}`{} is dark where that mirrors, is smooth glass or has \
             holes, since no particle reaches it from there; --integrator density shows it, slightly blurred",
            scene.shape_info(first).name,
            match deltas.count() {
                0 => String::new(),
                n => format!(" and {n} more"),
            }
        );
    }
}

/// Runs the tool.
///
/// # Errors
/// Anything wrong with the arguments, the scene or the output files; nothing has been written then.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Outcome, ToolError> {
    if let Some(path) = &args.schema {
        require_extension(path, "rng")?;
        output::prepare(std::slice::from_ref(path), &[])?;
        image_io::write_atomically(path, Scene::schema().as_bytes())?;
        say!("{}", path.display());
        return Ok(Outcome::Done);
    }
    let Some(file) = &args.scene else {
        return Err(ToolError::Usage("expected a scene file".into()));
    };
    if args.check {
        return check::run(file, &args.load, args.json.as_deref());
    }
    if let Some(path) = &args.save {
        require_extension(path, "xml")?;
        output::prepare(std::slice::from_ref(path), &[file])?;
        let (scene, _) = args.load.load(file)?;
        for file in scene.save(path)? {
            say!("{}", file.display());
        }
        return Ok(Outcome::Done);
    }
    let exr = match &args.output {
        Some(path) => path.clone(),
        None => default_output(file)?,
    };
    require_extension(&exr, "exr")?;
    let method = args.method()?;
    let (mut scene, seconds_load) = args.load.load(file)?;
    interrupt.keep();
    check_method(method, &scene)?;
    let mut settings = scene.settings;
    settings.spp = args.spp.unwrap_or(settings.spp);
    args.samples.apply(&scene, &mut settings)?;
    args.manifold.apply(&scene, &mut settings)?;
    if !matches!(method, Method::Paths(_)) {
        // All light is particles' there.
        complain_of_more_light(&settings, "--integrator");
        settings.connections = None;
        settings.glints = None;
    }
    if args.manifold_check {
        check_checkable(&scene, &settings)?;
    }
    if args.manifold_picture.is_some() {
        let Some(connections) = &mut settings.connections else {
            let message = "--manifold-picture: no connections to picture; expected --manifold, or a scene that asks for them";
            return Err(ToolError::Usage(message.into()));
        };
        connections.by_pixel = true;
    }
    settings.max_depth = args.max_depth.unwrap_or(settings.max_depth);
    let png = exr.with_extension("png");
    let mut files = vec![exr.clone(), png.clone()];
    files.extend(args.json.clone());
    files.extend(args.manifold_picture.clone());
    output::prepare(&files, &[file])?;

    let start = Instant::now();
    let (rendering, threads, energy) = args.threads.run(|threads| {
        let pixels = scene.film.pixels() as u64;
        args.samples
            .learn(&mut scene, &settings, args.seed, interrupt);
        let bar = Bar::new("render", pixels * passes(&scene, &settings), interrupt);
        let rendering = in_passes(&scene, method, &settings, args.seed, &bar)?;
        bar.finish();
        let energy = if args.manifold_check && rendering.is_some() {
            energy::check(&scene, &settings, args.seed, interrupt)?
        } else {
            None
        };
        Ok((rendering, threads, energy))
    })?;
    let Some(rendering) = rendering else {
        complain!("interrupted before the first pass was complete: nothing was written");
        return Ok(Outcome::Interrupted);
    };
    let seconds_render = start.elapsed().as_secs_f64();

    report_non_finite(&rendering.non_finite, rendering.width, args.seed);
    let solved = SolvedReport::of_image(&settings, &rendering);
    let image = rendering.image(0);
    let alpha = scene.film.alpha.then(|| {
        // Of the samples that the image holds.
        let job = Job::new(&scene, &settings, args.seed, 0..rendering.samples, &());
        coverage::coverage(&job)
    });
    let labels = Walks::of_image(&rendering).labels(&settings, &rendering.non_finite);
    image_io::write_exr_with(&exr, &image, alpha.flatten().as_deref(), &labels)?;
    output::write_png(&png, &image)?;
    if let Some(path) = &args.manifold_picture {
        let planes = manifold_planes(&rendering);
        // Without connections that were made there is nothing to say of any pixel.
        if !rendering.connections_by_pixel.is_empty() {
            image_io::write_exr_planes(path, rendering.width, rendering.height, planes)?;
        } else {
            complain!("warning: --manifold-picture: nothing was connected; nothing was written");
        }
    }
    if let Some(energy) = &energy {
        energy.say(solved.manifold.as_ref().is_some_and(|m| m.unbiased));
    }
    if let Some(path) = &args.json {
        let report = Report {
            scene: file.display().to_string(),
            width: rendering.width,
            height: rendering.height,
            spp: rendering.samples,
            samples: args.samples.filled(),
            solved,
            manifold_check: energy,
            threads,
            seconds_load,
            seconds_render,
        };
        output::write_json(path, &report)?;
    }
    say!(
        "{}: {} x {}, {} spp in {seconds_render:.2} s",
        exr.display(),
        rendering.width,
        rendering.height,
        rendering.samples
    );
    if rendering.samples < u64::from(settings.spp) {
        complain!(
            "interrupted: the image holds {} of {} samples per pixel",
            rendering.samples,
            settings.spp
        );
        return Ok(Outcome::Interrupted);
    }
    Ok(Outcome::Done)
}

/// The scene's name with the extension of an image, in the current folder.
fn default_output(scene: &Path) -> Result<PathBuf, ToolError> {
    match scene.file_name() {
        Some(name) => Ok(output::beside(Path::new(name), "exr")),
        None => Err(ToolError::file(
            scene,
            "expected a scene file, found a folder",
        )),
    }
}

/// An error unless the path ends in `.extension`.
///
/// # Errors
/// Names the path.
pub fn require_extension(path: &Path, extension: &str) -> Result<(), ToolError> {
    if path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case(extension))
    {
        return Ok(());
    }
    Err(ToolError::file(
        path,
        format!("expected a file name that ends in .{extension}"),
    ))
}

/// Samples per pixel of one pass: what is lost at most when the user stops. Depends on the resolution
/// only, so that the order of summation, hence the last bit, never depends on the machine.
fn pass_length(scene: &Scene) -> u64 {
    const SAMPLES: u64 = 1 << 20;
    (SAMPLES / scene.film.pixels().max(1) as u64).max(1)
}

/// Number of passes that [`in_passes`] makes.
pub fn passes(scene: &Scene, settings: &Settings) -> u64 {
    u64::from(settings.spp).div_ceil(pass_length(scene))
}

/// The image as the sum of passes, each over some of the samples. When stopped, the passes that
/// were complete; `None` if there is none.
///
/// # Errors
/// As those of [`particles_f32`] and [`density_f32`].
pub fn in_passes(
    scene: &Scene,
    method: Method,
    settings: &Settings,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Option<Rendering>, RenderError> {
    let theta = Theta::constant(scene.params().values());
    let spp = u64::from(settings.spp);
    let mut sum: Option<Rendering> = None;
    let mut done = 0;
    while done < spp {
        let next = (done + pass_length(scene)).min(spp);
        let samples = done..next;
        let pass = match method {
            Method::Paths(estimator) => render_f32(
                &Job::new(scene, settings, seed, samples, progress),
                &theta,
                estimator,
            ),
            Method::Particles(rules) => particles_f32(
                &Job::new(scene, settings, seed, samples, progress),
                &theta,
                rules,
            )?,
            Method::Density(rules, radius) => {
                let convention = Convention::Radiance;
                density_f32(
                    &Job::new(scene, settings, seed, samples, progress),
                    &theta,
                    rules,
                    convention,
                    radius,
                )?
            }
        };
        if pass.cancelled {
            break;
        }
        match &mut sum {
            Some(sum) => sum.merge(&pass),
            None => sum = Some(pass),
        }
        done = next;
    }
    Ok(sum)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    /// Stops after a number of pixels.
    struct StopAfter(u64, AtomicU64);

    impl Progress for StopAfter {
        fn advance(&self, n: u64) {
            self.1.fetch_add(n, Ordering::Relaxed);
        }
        fn cancelled(&self) -> bool {
            self.1.load(Ordering::Relaxed) >= self.0
        }
    }

    #[test]
    fn an_interrupted_image_holds_the_complete_passes() {
        let scene = render::scene::room(256, 256).unwrap();
        let mut settings = scene.settings;
        settings.spp = 40;
        settings.max_depth = 2;
        let pixels = scene.film.pixels() as u64;
        let length = pass_length(&scene);
        assert_eq!((length, passes(&scene, &settings)), (16, 3));
        let render = |settings: &Settings, limit| {
            let progress = StopAfter(limit, AtomicU64::new(0));
            in_passes(
                &scene,
                Method::Paths(Estimator::Mis),
                settings,
                0,
                &progress,
            )
            .unwrap()
        };
        assert!(render(&settings, pixels / 2).is_none());
        let part = render(&settings, pixels + pixels / 2).unwrap();
        assert_eq!((part.samples, part.cancelled), (16, false));
        settings.spp = 16;
        let whole = render(&settings, u64::MAX).unwrap();
        assert_eq!(part.sums, whole.sums);
    }

    #[test]
    fn arguments_are_consistent() {
        use clap::CommandFactory;
        Args::command().debug_assert();
        crate::tools::gradient::Args::command().debug_assert();
        crate::tools::recover::Args::command().debug_assert();
    }
}
