//! What a recovery is asked for, on a command line or in a checkpoint.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::builder::{OsStringValueParser, PossibleValuesParser, TypedValueParser};
use optim::{AnyOptimizer, LossKind, PixelLoss};
use render::instances::Estimator;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::file_path::FilePath;
use super::{Args, ITERATIONS, SIZES};
use crate::builtin_scene;
use crate::cli::{self, SAMPLE_COUNTS, SampleArgs, ToolError};
use crate::solved::ManifoldArgs;

/// `--target`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TargetArg {
    /// The sensor's name or number; `None`: the one that is looked through.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) sensor: Option<String>,
    pub(super) image: FilePath,
}

/// A name before the first `=` is a sensor's, unless it has a folder: `./a=b.exr` is a file.
pub(super) fn target_argument() -> impl TypedValueParser<Value = TargetArg> {
    OsStringValueParser::new().try_map(|text| {
        let (sensor, image) = match text.to_str().and_then(|text| text.split_once('=')) {
            Some((sensor, image)) if !sensor.contains(['/', '\\']) => {
                (Some(sensor.to_owned()), PathBuf::from(image))
            }
            _ => (None, PathBuf::from(&text)),
        };
        if image.as_os_str().is_empty() || sensor.as_ref().is_some_and(String::is_empty) {
            let found = text.display();
            return Err(format!("expected IMG.EXR or SENSOR=IMG.EXR, found {found}"));
        }
        Ok(TargetArg {
            sensor,
            image: FilePath(image),
        })
    })
}

/// `--optimizer`, in files by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptimizerArg {
    /// One of [`AnyOptimizer`], by name.
    FirstOrder(&'static str),
    /// Damped Gauss-Newton steps, for up to 1024 unknown values.
    GaussNewton,
}

impl OptimizerArg {
    pub(super) const ADAM: Self = Self::FirstOrder("adam");

    pub(super) fn all() -> impl Iterator<Item = Self> {
        let first_order = AnyOptimizer::<f32>::NAMES.map(Self::FirstOrder);
        first_order.into_iter().chain([Self::GaussNewton])
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::FirstOrder(name) => name,
            Self::GaussNewton => "gauss-newton",
        }
    }

    pub(super) fn usual_rate(self) -> f64 {
        match self {
            Self::FirstOrder(name) => AnyOptimizer::<f32>::usual_rate(name).unwrap_or(1.0),
            Self::GaussNewton => 1.0,
        }
    }
}

impl TryFrom<String> for OptimizerArg {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        Self::all().find(|o| o.name() == text).ok_or_else(|| {
            let known: Vec<_> = Self::all().map(Self::name).collect();
            format!("expected one of {}, found {text}", known.join(", "))
        })
    }
}

impl Serialize for OptimizerArg {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for OptimizerArg {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Self::try_from(String::deserialize(from)?).map_err(D::Error::custom)
    }
}

/// Shown by `--help` with all names.
pub(super) fn optimizer_name() -> impl TypedValueParser<Value = OptimizerArg> {
    let names = OptimizerArg::all().map(OptimizerArg::name);
    PossibleValuesParser::new(names).try_map(OptimizerArg::try_from)
}

pub(super) fn loss_name(text: &str) -> Result<String, String> {
    match text.parse::<LossKind>() {
        Ok(_) => Ok(text.to_owned()),
        Err(e) => Err(e.to_string()),
    }
}

/// A `--param`, taken apart.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Unknown {
    pub(super) key: String,
    pub(super) lr: Option<f64>,
    pub(super) smooth: Option<f64>,
    pub(super) coarse: Option<usize>,
}

impl std::str::FromStr for Unknown {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let options = text.rsplit_once(':').filter(|(_, o)| o.contains('='));
        let (key, options) = options.map_or((text, ""), |(key, options)| (key, options));
        let mut found = Self {
            key: key.to_owned(),
            lr: None,
            smooth: None,
            coarse: None,
        };
        for option in options.split(',').filter(|o| !o.is_empty()) {
            let (name, value) = option.split_once('=').unwrap_or((option, ""));
            let number = value
                .parse::<f64>()
                .ok()
                .filter(|x| x.is_finite() && *x > 0.0);
            let side = value.parse::<usize>().ok().filter(|n| *n > 0);
            match (name, number, side) {
                ("lr", Some(_), _) => found.lr = number,
                ("smooth", Some(_), _) => found.smooth = number,
                ("coarse", _, Some(_)) => found.coarse = side,
                ("lr" | "smooth" | "coarse", ..) => {
                    return Err(format!(
                        "{key}: expected a positive number for {name}, found {value}"
                    ));
                }
                _ => {
                    return Err(format!(
                        "{key}: expected lr, smooth or coarse, found {option}"
                    ));
                }
            }
        }
        Ok(found)
    }
}

/// Everything that the numbers of a run depend on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Job {
    pub(super) scene: Option<FilePath>,
    pub(super) targets: Vec<TargetArg>,
    pub(super) params: Vec<String>,
    pub(super) defines: Vec<(String, String)>,
    pub(super) allow_missing: bool,
    #[serde(default)]
    pub(super) sensor: Option<String>,
    #[serde(default)]
    pub(super) values: Vec<(String, String)>,
    pub(super) optimizer: OptimizerArg,
    pub(super) iterations: u32,
    #[serde(with = "optim::exact::number")]
    pub(super) lr: f64,
    pub(super) spp: u32,
    pub(super) max_depth: Option<u32>,
    pub(super) samples: SampleArgs,
    #[serde(default)]
    pub(super) manifold: ManifoldArgs,
    pub(super) estimator: String,
    pub(super) loss: String,
    pub(super) seed: u64,
    pub(super) size: u32,
}

impl Job {
    pub(super) fn new(args: &Args) -> Result<Self, ToolError> {
        let optimizer = args.optimizer.unwrap_or(OptimizerArg::ADAM);
        let mut params = args.params.clone();
        if args.scene.is_none() && params.is_empty() {
            let unknowns = builtin_scene::cornell_unknowns();
            params = unknowns.iter().map(|u| u.name.to_owned()).collect();
        }
        let loss = args.loss.clone().unwrap_or_else(|| "relative-l2".into());
        let estimator = args.estimator.unwrap_or(Estimator::Mis);
        let spp = args.spp.unwrap_or(match optimizer {
            OptimizerArg::FirstOrder(_) => 12,
            OptimizerArg::GaussNewton => 48,
        });
        let job = Self {
            scene: args.scene.clone().map(FilePath),
            targets: args.targets.clone(),
            params,
            defines: args.load.defines.clone(),
            allow_missing: args.load.allow_missing,
            sensor: args.load.sensor.clone(),
            values: args.load.values.clone(),
            optimizer,
            iterations: args.iterations.unwrap_or(match optimizer {
                OptimizerArg::FirstOrder(_) => 400,
                OptimizerArg::GaussNewton => 24,
            }),
            lr: args.lr.unwrap_or(optimizer.usual_rate()),
            spp,
            max_depth: args.max_depth,
            samples: args.samples.filled(),
            manifold: args.manifold,
            estimator: estimator.name().to_owned(),
            loss,
            seed: args.seed.unwrap_or(0),
            size: args.size.unwrap_or(96),
        };
        job.check()
            .map_err(|wrong| ToolError::Usage(format!("{}: {}", wrong.option, wrong.message)))?;
        Ok(job)
    }

    /// Whether it could come from a command line.
    pub(super) fn check(&self) -> Result<(), Wrong> {
        let wrong = |option, key, message: String| {
            Err(Wrong {
                option,
                key,
                message,
            })
        };
        let within = |option, key, range: &RangeInclusive<i64>, found: u32| {
            if range.contains(&found.into()) {
                return Ok(());
            }
            let (lo, hi) = (range.start(), range.end());
            wrong(
                option,
                key,
                format!("expected a number from {lo} to {hi}, found {found}"),
            )
        };
        if self.scene.is_some() && self.targets.is_empty() {
            let message = "expected an image of the scene, found none";
            return wrong("--target", "targets", message.into());
        }
        if self.params.is_empty() {
            let message = "expected the key of an unknown parameter, found none; `gradient SCENE --list` \
                           prints all";
            return wrong("--param", "params", message.into());
        }
        if let Err(e) = self.unknowns() {
            return wrong("--param", "params", e);
        }
        within("--iterations", "iterations", &ITERATIONS, self.iterations)?;
        within("--spp", "spp", &SAMPLE_COUNTS, self.spp)?;
        within("--size", "size", &SIZES, self.size)?;
        if !(self.lr > 0.0 && self.lr.is_finite()) {
            let message = format!("expected a positive finite rate, found {}", self.lr);
            return wrong("--lr", "lr", message);
        }
        if self.samples.pixels_per_particle == Some(0) {
            let message = "expected at least 1, found 0";
            return wrong(
                "--pixels-per-particle",
                "samples.pixels_per_particle",
                message.into(),
            );
        }
        if let Err(e) = Estimator::from_name(&self.estimator) {
            return wrong("--estimator", "estimator", e.to_string());
        }
        let loss = match self.loss.parse::<LossKind>() {
            Ok(loss) => loss,
            Err(e) => return wrong("--loss", "loss", e.to_string()),
        };
        if self.optimizer != OptimizerArg::GaussNewton {
            return Ok(());
        }
        let edges = cli::can(&self.estimator, |c| c.samples_edges && !c.study);
        if !edges && !cli::can(&self.estimator, |c| c.modes.second_order) {
            let message = format!(
                "expected {}, or {} for what moves, for gauss-newton, which has no other, found {}",
                Estimator::SECOND_ORDER.name(),
                Estimator::Edges.name(),
                self.estimator
            );
            return wrong("--estimator", "estimator", message);
        }
        if loss.dd_pixel(1.0, 1.0) == 0.0 {
            let message = format!(
                "expected l2, relative-l2 or log-l2 for gauss-newton, found {}, which has no curvature",
                self.loss
            );
            return wrong("--loss", "loss", message);
        }
        if self.spp < 2 {
            let message = format!(
                "expected at least 2 samples per pixel for gauss-newton, found {}",
                self.spp
            );
            return wrong("--spp", "spp", message);
        }
        Ok(())
    }

    /// The unknowns, taken apart.
    pub(super) fn unknowns(&self) -> Result<Vec<Unknown>, String> {
        self.params.iter().map(|text| text.parse()).collect()
    }

    /// Their keys.
    pub(super) fn keys(&self) -> Result<Vec<String>, ToolError> {
        let unknowns = self.unknowns();
        let unknowns = unknowns.map_err(|e| ToolError::Usage(format!("--param: {e}")))?;
        Ok(unknowns.into_iter().map(|u| u.key).collect())
    }

    /// How many of the first `iteration` steps end in the last quarter of the run, whose values are averaged.
    /// Gauss-Newton steps average by themselves.
    pub(super) fn tail(&self, iteration: u32) -> u32 {
        match self.optimizer {
            OptimizerArg::FirstOrder(_) => {
                iteration.saturating_sub(self.iterations - self.iterations / 4)
            }
            OptimizerArg::GaussNewton => 0,
        }
    }

    /// An error if the arguments ask for another job than this one, which is being resumed.
    pub(super) fn require_same(&self, args: &Args) -> Result<(), ToolError> {
        fn another(what: &str, job: &str, given: &str) -> ToolError {
            ToolError::Usage(format!(
                "{what}: expected {job} as in the checkpoint, found {given}; leave it out to resume"
            ))
        }
        fn same<T: PartialEq>(
            what: &str,
            given: Option<T>,
            job: T,
            show: impl Fn(&T) -> String,
        ) -> Result<(), ToolError> {
            match given {
                Some(given) if given != job => Err(another(what, &show(&job), &show(&given))),
                _ => Ok(()),
            }
        }
        fn text<T: Display>(x: &T) -> String {
            x.to_string()
        }
        fn debug<T: std::fmt::Debug>(x: &T) -> String {
            format!("{x:?}")
        }
        fn some<T: Clone>(list: &[T]) -> Option<Vec<T>> {
            (!list.is_empty()).then(|| list.to_vec())
        }
        same(
            "SCENE",
            args.scene.clone().map(|path| Some(FilePath(path))),
            self.scene.clone(),
            debug,
        )?;
        same("--target", some(&args.targets), self.targets.clone(), debug)?;
        same("--param", some(&args.params), self.params.clone(), debug)?;
        same("-D", some(&args.load.defines), self.defines.clone(), debug)?;
        same("--optimizer", args.optimizer, self.optimizer, |o| {
            o.name().to_owned()
        })?;
        same("--iterations", args.iterations, self.iterations, text)?;
        same("--lr", args.lr, self.lr, text)?;
        same("--spp", args.spp, self.spp, text)?;
        same(
            "--max-depth",
            args.max_depth.map(Some),
            self.max_depth,
            debug,
        )?;
        let (given, job) = (args.samples, self.samples);
        same("--sampler", given.sampler.map(Some), job.sampler, debug)?;
        same("--lights", given.lights.map(Some), job.lights, debug)?;
        same("--caustics", given.caustics.map(Some), job.caustics, debug)?;
        let (shared, by) = (given.pixels_per_particle, job.pixels_per_particle);
        same("--pixels-per-particle", shared.map(Some), by, debug)?;
        same("--guide", given.guide.then_some(true), job.guide, text)?;
        if let Some((option, [job, given])) = args.manifold.differs(&self.manifold) {
            return Err(another(&option, &job, &given));
        }
        let given = args.estimator.map(|e| e.name().to_owned());
        same("--estimator", given, self.estimator.clone(), text)?;
        same("--loss", args.loss.clone(), self.loss.clone(), text)?;
        same("--seed", args.seed, self.seed, text)?;
        same("--size", args.size, self.size, text)
    }
}

/// What is wrong with a [`Job`]: the option, the key in a checkpoint, what was expected and what was found.
pub(super) struct Wrong {
    pub(super) option: &'static str,
    pub(super) key: &'static str,
    pub(super) message: String,
}
