//! What tools say and report of light that is found by solving equations: over chains of mirrors and glass, and in glints.

use std::str::FromStr;

use clap::{Args, ValueEnum};
use render::glint::glinty_shapes;
use render::image_io::Labels;
use render::integrator::gradient::Gradient;
use render::integrator::render::{NonFinite, PixelConnections, Rendering};
use render::manifold::{Split, Statistics};
use render::scene::{
    CasterLight, Caustics, ChainKinds, Connections, Constraint, GlintMethod, GlintRegion,
    GlintWeights, Glints, Method, Starts, Uniqueness,
};
use render::{Scene, Settings};
use serde::{Deserialize, Serialize};

use crate::cli::ToolError;
use crate::complain;

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
