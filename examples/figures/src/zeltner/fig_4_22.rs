//! A texture of roughness found from a picture by gradient descent, with three estimators of the
//! gradient [Zeltner 2021, figure 4.22].

use optim::{Constrained, Groups, Loss, Parameterisation, Sgd};
use rayon::prelude::*;
use render::Job;
use render::bsdf::microfacet::Ndf;
use render::instances::{Direction, Estimator};
use render::params::Theta;
use render::sampler::mix64;
use render::statistics::{Estimate, z_limit};
use render::{Image, Scene};

use crate::statistics::blocks;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::optimise::Problem;
use examples::scene_builder;
use examples::scene_builder::{SceneBuilder, View};

const SEED: u64 = 422;
pub(crate) const NAME: &str = "plate.alpha.data";
const STEPS: u64 = 100;
const ESTIMATORS: [Estimator; 3] = [
    Estimator::Detached,
    Estimator::Differential,
    Estimator::Attached,
];
const DETACHED: usize = 0;
const DIFFERENTIAL: usize = 1;
const ATTACHED: usize = 2;
/// Material of a plate and its lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Condition {
    /// Rough GGX below the many lights of a hall.
    RoughInHall,
    /// Smooth Beckmann below three wide lobes of different colour.
    SmoothUnderLobes,
}

impl Condition {
    pub(crate) const BOTH: [Self; 2] = [Self::RoughInHall, Self::SmoothUnderLobes];

    pub(crate) fn label(self) -> &'static str {
        match self {
            Self::RoughInHall => "A",
            Self::SmoothUnderLobes => "B",
        }
    }

    fn ndf(self) -> Ndf {
        match self {
            Self::RoughInHall => Ndf::Ggx,
            Self::SmoothUnderLobes => Ndf::Beckmann,
        }
    }

    /// Least and largest roughness of the picture to be matched, and of the start.
    pub(crate) fn range(self) -> [f64; 2] {
        match self {
            Self::RoughInHall => [0.15, 0.5],
            Self::SmoothUnderLobes => [0.02, 0.08],
        }
    }

    /// Learning rate in units of the inverse of the mean curvature: small enough for texels of many times
    /// that, and for the noise.
    fn step(self) -> f64 {
        match self {
            Self::RoughInHall => 0.02,
            Self::SmoothUnderLobes => 0.06,
        }
    }

    pub(crate) fn scene(self, pixels: u32, texels: &[f32]) -> Result<Scene> {
        let mut builder = SceneBuilder::default();
        let roughness = builder.rough_texels("plate", self.ndf(), texels)?;
        let metal = builder.metal_of("plate", [0.95; 3], roughness)?;
        let sides = [[2.4, 0.0, 0.0], [0.0, 0.0, -2.8]];
        builder.quad("plate", [[-1.2, 0.0, 1.2], sides[0], sides[1]], &metal)?;
        match self {
            Self::RoughInHall => builder.hall(1.0)?,
            Self::SmoothUnderLobes => {
                let lobes = [
                    ([-0.12, 0.64, -0.76], [2.0, 0.4, 0.2]),
                    ([0.12, 0.64, -0.76], [0.25, 0.5, 2.0]),
                    ([0.0, 0.79, -0.62], [0.3, 1.8, 0.4]),
                ];
                for (direction, colour) in lobes {
                    builder.lobe("lobe", colour, direction, 60.0)?;
                }
            }
        }
        let view = View {
            eye: [0.0, 3.2, 3.2],
            target: [0.0; 3],
            fov: 22.0,
            size: [pixels; 2],
        };
        builder.finish(&view, 2)
    }
}

/// Rings and a bar: edges and slopes, between 0 and 1.
pub(crate) fn pattern(side: usize) -> Vec<f64> {
    let value = |i: usize| {
        let [x, y] = [i % side, i / side].map(|k| 2.0 * (k as f64 + 0.5) / side as f64 - 1.0);
        let rings = 0.5 + 0.5 * (9.0 * x.hypot(y)).sin();
        let bar = f64::from((x - 0.3 * y).abs() < 0.15);
        (0.75 * rings + 0.5 * bar).clamp(0.0, 1.0)
    };
    (0..side * side).map(value).collect()
}

/// Independent values between 0 and 1.
fn noise(side: usize) -> Vec<f64> {
    let unit = |i: usize| (mix64(SEED + i as u64) >> 11) as f64 / (1u64 << 53) as f64;
    (0..side * side).map(unit).collect()
}

pub(crate) fn within([low, high]: [f64; 2], values: &[f64]) -> Vec<f32> {
    let value = |t: &f64| (low + t * (high - low)) as f32;
    values.iter().map(value).collect()
}

/// Side of the texture, and numbers of samples.
#[derive(Clone, Copy, Debug)]
struct Effort {
    side: usize,
    spp: u64,
    many: u64,
}

struct Setup {
    problem: Problem,
    start: Vec<f32>,
    truth: Vec<f32>,
    effort: Effort,
}

/// A descent: the loss at every step, measured afterwards without noise, and where it ended.
struct Descent {
    losses: Vec<(u64, f64)>,
    values: Vec<f32>,
    bad: u64,
}

impl Setup {
    fn new(condition: Condition, effort: Effort) -> Result<Self> {
        let truth = within(condition.range(), &pattern(effort.side));
        let start = within(condition.range(), &noise(effort.side));
        let scene = condition.scene(effort.side as u32, &truth)?;
        let target = picture(&scene, effort.many);
        let mut problem = Problem::of(scene, &[NAME], "l2".parse()?, target)?;
        problem.settings.spp = effort.spp as u32;
        Ok(Self {
            problem,
            start,
            truth,
            effort,
        })
    }

    /// Loss of the image without noise: with the samples of the target, what differs is the texture.
    fn loss(&self) -> Result<f64> {
        let image = picture(&self.problem.scene, self.effort.many);
        let target = &self.problem.targets[0].image;
        Ok(self.problem.loss.value(&image.data, &target.data)?)
    }

    /// The gradients of the loss at the start, from many independent runs: means over blocks of texels.
    fn gradients(&mut self, e: Estimator, runs: u64) -> Result<Vec<Estimate>> {
        self.problem.set(&self.start)?;
        let scene = &self.problem.scene;
        let image = picture(scene, self.effort.many);
        let mut adjoint = vec![0.0; image.data.len()];
        let target = &self.problem.targets[0].image;
        self.problem
            .loss
            .gradient(&image.data, &target.data, &mut adjoint)?;
        let theta = Theta::constant(scene.params().values());
        let (active, settings) = (&self.problem.active, &self.problem.settings);
        let samples = 0..2 * self.effort.spp;
        let stream = 1 + Estimator::ALL.iter().position(|x| *x == e).unwrap_or(0) as u64;
        let run = |k: u64| {
            let seed = mix64(SEED + stream * 1000 + k);
            let samples = samples.clone();
            let g = e.backward_f32(
                &Job::new(scene, settings, seed, samples, &()),
                &theta,
                active,
                &adjoint,
            )?;
            Ok(blocks(&g.values[0], self.effort.side, self.effort.side / 4))
        };
        let runs: std::result::Result<Vec<_>, render::RenderError> =
            (0..runs).into_par_iter().map(run).collect();
        Ok(crate::statistics::per_pixel(&runs?))
    }

    /// Step length for all estimators alike, from the mean square of the image's derivative at the start.
    fn rate(&mut self, step: f64) -> Result<f64> {
        self.problem.set(&self.start)?;
        let scene = &self.problem.scene;
        let along = [Direction::uniform(scene.params(), NAME)?];
        let (values, s) = (scene.params().values(), &scene.settings);
        let spp = self.effort.many;
        let r = Estimator::DifferentialMis.forward_f32(
            &Job::new(scene, s, SEED, 0..spp, &()),
            values,
            &along,
        )?;
        let n = spp as f64;
        let square = r.sums[1].iter().map(|x| (x / n).powi(2)).sum::<f64>();
        let mean = square / r.sums[1].len() as f64;
        // The loss is a mean over pixels, and a texel is seen by about one of them.
        Ok(step * scene.film.pixels() as f64 / (2.0 * mean))
    }

    fn descend(&mut self, e: Estimator, rate: f64) -> Result<Descent> {
        self.problem.estimator = e;
        let len = self.start.len();
        let mut groups = Groups::new(len);
        groups.add(NAME, 0..len, Parameterisation::bounded(1e-3, 1.0)?)?;
        let mut sgd = Constrained::new(Sgd::new(len, rate)?, groups)?;
        let mut values = self.start.clone();
        let mut losses = Vec::new();
        let mut bad = 0;
        for i in 0..STEPS {
            if i % 10 == 0 {
                self.problem.set(&values)?;
                losses.push((i, self.loss()?));
            }
            let seeds = [2 * i, 2 * i + 1].map(|s| mix64(SEED + s));
            let step = self.problem.step(&mut values, &mut sgd, seeds, &())?;
            let step = step.ok_or("stopped")?;
            bad += step.seen[0].non_finite.count + step.gradient.non_finite.count;
        }
        self.problem.set(&values)?;
        losses.push((STEPS, self.loss()?));
        Ok(Descent {
            losses,
            values,
            bad,
        })
    }
}

fn picture(scene: &Scene, spp: u64) -> Image {
    scene_builder::picture(scene, SEED, spp).image(0)
}

/// `zeltner-4-22`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let effort = Effort {
        side: fig.pick(32, 64),
        spp: fig.pick(8, 16),
        many: fig.pick(128, 512),
    };
    fig.note("texels and pixels along a side", effort.side);
    fig.note("samples per pixel of a step", effort.spp);
    fig.note("steps", STEPS);
    fig.note("seed", SEED);
    let mut rows = Vec::new();
    for condition in Condition::BOTH {
        let mut setup = Setup::new(condition, effort)?;
        agree(fig, condition, &mut setup)?;
        let rate = setup.rate(condition.step())?;
        fig.note(&format!("rate {}", condition.label()), rate);
        let mut found = Vec::new();
        for e in ESTIMATORS {
            found.push(setup.descend(e, rate)?);
        }
        judge(fig, condition, &found);
        show(fig, condition, &mut setup, &found)?;
        for (e, d) in ESTIMATORS.iter().zip(&found) {
            rows.extend(d.losses.iter().map(|(step, loss)| {
                [
                    condition.label().to_owned(),
                    e.name().to_owned(),
                    step.to_string(),
                    loss.to_string(),
                ]
            }));
        }
    }
    fig.csv_text("losses", &["condition", "estimator", "step", "loss"], rows);
    Ok(())
}

/// The three gradients at the start.
fn agree(fig: &mut Figure, condition: Condition, setup: &mut Setup) -> Result {
    let runs = 32;
    let mut gradients = Vec::new();
    for e in ESTIMATORS {
        gradients.push(setup.gradients(e, runs)?);
    }
    let pairs = [
        (DETACHED, DIFFERENTIAL),
        (DETACHED, ATTACHED),
        (DIFFERENTIAL, ATTACHED),
    ];
    let n = gradients[0].len();
    let limit = z_limit(pairs.len() * n, runs, 1e-3);
    let mut worst = (0.0f64, pairs[0], 0);
    for (a, b) in pairs {
        for (i, (x, y)) in gradients[a].iter().zip(&gradients[b]).enumerate() {
            let z = x.z(y);
            if z.abs() > worst.0.abs() {
                worst = (z, (a, b), i);
            }
        }
    }
    let (z, (a, b), i) = worst;
    // The gradient itself in standard errors: how small a difference the data could have shown.
    let strongest = gradients[DIFFERENTIAL]
        .iter()
        .map(|g| g.mean.abs() / g.se)
        .fold(0.0, f64::max);
    let noise = |k: usize| {
        let squares = gradients[k].iter().map(|g| g.se * g.se).sum::<f64>();
        squares.sqrt()
    };
    let noise = [DIFFERENTIAL, ATTACHED].map(|k| noise(k) / noise(DETACHED));
    fig.check(
        format!(
            "{}: the three gradients agree in mean at the start, in blocks of texels",
            condition.label()
        ),
        z.abs() < limit && strongest > 5.0,
        format!(
            "largest |z| of {}: {z:.2} ({} and {}, block {i}), limit {limit:.2}; \
             the gradient itself is up to {strongest:.0} standard errors; std over that of detached: \
             differential {:.2}, attached {:.2}",
            pairs.len() * n,
            ESTIMATORS[a].name(),
            ESTIMATORS[b].name(),
            noise[0],
            noise[1]
        ),
    );
    Ok(())
}

fn judge(fig: &mut Figure, condition: Condition, found: &[Descent]) {
    let last = |k: usize| found[k].losses.last().map_or(f64::NAN, |l| l.1);
    let (detached, differential, attached) = (last(DETACHED), last(DIFFERENTIAL), last(ATTACHED));
    let numbers = format!(
        "from {:.2e}: detached {detached:.2e}, differential {differential:.2e}, attached {attached:.2e}",
        found[0].losses[0].1
    );
    let (statement, holds) = match condition {
        Condition::RoughInHall => (
            "A: final loss of differential <= detached < attached",
            differential <= detached && detached < attached,
        ),
        // A pair of samples that share their azimuth is as good as one that moves: what is left is the same.
        Condition::SmoothUnderLobes => (
            "B: final loss of attached <= differential (to 5 %) < detached",
            attached <= 1.05 * differential && differential < detached,
        ),
    };
    let bad: u64 = found.iter().map(|d| d.bad).sum();
    fig.check(statement, holds && bad == 0, numbers);
}

fn show(fig: &mut Figure, condition: Condition, setup: &mut Setup, found: &[Descent]) -> Result {
    let label = condition.label();
    let mut chart = LineChart::new(&format!("Condition {label}"), "step", "loss").log_y();
    for (e, d) in ESTIMATORS.iter().zip(found) {
        let points = d.losses.iter().map(|(i, l)| (*i as f64, *l));
        chart = chart.measured(e.name(), points);
    }
    fig.chart(&format!("losses-{label}"), &chart);
    let [low, high] = condition.range();
    let side = setup.effort.side;
    let enlarge = 256 / side;
    let texture = |label: &str, values: &[f32]| {
        let values: Vec<f64> = values.iter().map(|&v| v.into()).collect();
        Panel::false_colour(label, side, &values, low, high).enlarged(enlarge)
    };
    let mut textures = vec![
        texture("start", &setup.start),
        texture("target", &setup.truth),
    ];
    let mut images = Vec::new();
    setup.problem.set(&setup.start)?;
    let start = picture(&setup.problem.scene, setup.effort.many);
    let panel = |label: &str, image: &Image| Panel::tonemapped(label, image, 0.5).enlarged(enlarge);
    images.push(panel("start", &start));
    images.push(panel("target", &setup.problem.targets[0].image));
    for (e, d) in ESTIMATORS.iter().zip(found) {
        textures.push(texture(e.name(), &d.values));
        setup.problem.set(&d.values)?;
        let image = picture(&setup.problem.scene, setup.effort.many);
        images.push(panel(e.name(), &image));
    }
    textures.append(&mut images);
    fig.images(&format!("textures-{label}"), 5, &textures);
    Ok(())
}
