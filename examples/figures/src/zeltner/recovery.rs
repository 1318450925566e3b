//! The albedo of a wall, recovered from a picture [Zeltner 2021, figures 1.1 and 4.2].

use optim::{Constrained, Groups, Optimizer, Parameterisation};
use render::{Image, Scene};

use crate::common_scenes::{Walls, cornell};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};
use examples::optimise::Problem;
use examples::scene_builder;

/// The unknown.
pub(super) const NAME: &str = "left.reflectance.value";
/// Where the search starts.
pub(super) const START: [f32; 3] = [0.3, 0.3, 0.3];
pub(super) const SEED: u64 = 11;
pub(super) const TARGET_SEED: u64 = 1;
pub(super) const STEPS: u64 = 90;

pub(super) struct Setup {
    pub(super) problem: Problem,
    pub(super) truth: Vec<f32>,
    pub(super) target_spp: u64,
}

pub(super) fn setup(fig: &Figure) -> Result<Setup> {
    let scene = cornell(fig.pick(32, 64), Walls::Matt, 4)?;
    let target_spp = fig.pick(512, 1024);
    let target = picture(&scene, target_spp, TARGET_SEED);
    let mut problem = Problem::of(scene, &[NAME], "l2".parse()?, target)?;
    problem.settings.spp = fig.pick(16, 32);
    let truth = problem.values();
    Ok(Setup {
        problem,
        truth,
        target_spp,
    })
}

pub(super) fn picture(scene: &Scene, spp: u64, seed: u64) -> Image {
    scene_builder::picture(scene, seed, spp).image(0)
}

/// An optimiser that keeps the albedo within its range.
pub(super) fn bounded<O: Optimizer<f32>>(inner: O) -> Result<Constrained<O, f32>> {
    let mut groups = Groups::new(START.len());
    groups.add(NAME, 0..START.len(), Parameterisation::bounded(0.0, 1.0)?)?;
    Ok(Constrained::new(inner, groups)?)
}

/// Values and loss of every step, the last values last.
pub(super) type Path = Vec<(Vec<f32>, f64)>;

pub(super) fn descend(
    problem: &mut Problem,
    optimizer: &mut impl Optimizer<f32>,
    steps: u64,
    decay: f64,
) -> Result<(Path, u64)> {
    let mut values = START.to_vec();
    let mut path = Path::new();
    let mut bad = 0;
    let rates: Vec<_> = optimizer.rates().at(0).collect();
    for i in 0..steps {
        // Down to `decay` of the first rate: the noise of the last steps is what is left.
        let t = i as f64 / steps as f64;
        for (range, rate) in &rates {
            let rate = rate * decay.powf(t);
            optimizer.rates_mut().set_rate(range.clone(), rate)?;
        }
        let before = values.clone();
        let seeds = [SEED + 2 * i, SEED + 2 * i + 1].map(render::sampler::mix64);
        let step = problem.step(&mut values, optimizer, seeds, &())?;
        let step = step.ok_or("stopped")?;
        bad += step.seen[0].non_finite.count + step.gradient.non_finite.count;
        path.push((before, step.loss));
    }
    problem.set(&values)?;
    path.push((values, f64::NAN));
    Ok((path, bad))
}

pub(super) fn error(values: &[f32], truth: &[f32]) -> f64 {
    let relative = values.iter().zip(truth).map(|(v, t)| {
        let (v, t) = (f64::from(*v), f64::from(*t));
        (v - t).abs() / t
    });
    relative.fold(0.0, f64::max)
}

pub(super) fn note(fig: &mut Figure, setup: &Setup) {
    fig.note("unknown", NAME);
    fig.note("start", START.to_vec());
    fig.note("spp", setup.problem.settings.spp);
    fig.note("steps", STEPS);
    fig.note("seeds", vec![SEED, TARGET_SEED]);
}

pub(super) fn report(fig: &mut Figure, name: &str, path: &Path, truth: &[f32]) {
    let rows = path.iter().enumerate().map(|(i, (v, loss))| {
        let [r, g, b] = [0, 1, 2].map(|c: usize| f64::from(v[c]));
        [i as f64, *loss, r, g, b]
    });
    fig.csv(name, &["step", "loss", "red", "green", "blue"], rows);
    let mut chart = LineChart::new("Albedo of the left wall", "step", "value");
    for (c, label) in ["red", "green", "blue"].into_iter().enumerate() {
        let values = path.iter().enumerate();
        let values = values.map(move |(i, (v, _))| (i as f64, f64::from(v[c])));
        let end = path.len() as f64 - 1.0;
        let t = f64::from(truth[c]);
        chart = chart
            .line(label, values)
            .dashed(&format!("{label}, truth"), [(0.0, t), (end, t)]);
    }
    fig.chart(name, &chart);
}
