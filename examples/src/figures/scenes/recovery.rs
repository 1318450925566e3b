//! A scene rendered forward and recovered backward [Zeltner 2021, figure 1.1], and the loop that does it
//! [Zeltner 2021, figure 4.2].

use optim::{
    Adam, Constrained, Groups, Loss, LossKind, Optimizer, Parameterisation, Rates, Sgd, SgdOptions,
};
use render::instances::Estimator;
use render::integrator::gradient::Active;
use render::{Image, Scene};

use crate::chart::{LineChart, Panel};
use crate::figure::{Figure, Result};
use crate::figures::stage::{self, Walls, cornell};
use crate::optimise::Problem;

/// The unknown.
const NAME: &str = "left.reflectance.value";
/// Where the search starts.
const START: [f32; 3] = [0.3, 0.3, 0.3];
const SEED: u64 = 11;
const TARGET_SEED: u64 = 1;
const STEPS: u64 = 90;

struct Setup {
    problem: Problem,
    truth: Vec<f32>,
    target_spp: u64,
}

fn setup(fig: &Figure) -> Result<Setup> {
    let scene = cornell(fig.pick(32, 64), Walls::Matt, 4)?;
    let mut settings = scene.settings;
    settings.spp = fig.pick(16, 32);
    let target_spp = fig.pick(512, 1024);
    let target = picture(&scene, target_spp, TARGET_SEED);
    let active = Active::new(&scene, &[NAME])?;
    let problem = Problem {
        scene,
        settings,
        active,
        estimator: Estimator::Mis,
        loss: "l2".parse::<LossKind>()?,
        target,
    };
    let truth = problem.values();
    Ok(Setup {
        problem,
        truth,
        target_spp,
    })
}

fn picture(scene: &Scene, spp: u64, seed: u64) -> Image {
    stage::picture(scene, seed, spp).image(0)
}

/// An optimiser that keeps the albedo within its range.
fn bounded<O: Optimizer<f32>>(inner: O) -> Result<Constrained<O, f32>> {
    let mut groups = Groups::new(START.len());
    groups.add(NAME, 0..START.len(), Parameterisation::bounded(0.0, 1.0)?)?;
    Ok(Constrained::new(inner, groups)?)
}

/// Values and loss of every step, the last values last.
type Path = Vec<(Vec<f32>, f64)>;

fn descend(
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
        bad += step.seen.non_finite.count + step.gradient.non_finite.count;
        path.push((before, step.loss));
    }
    problem.set(&values)?;
    path.push((values, f64::NAN));
    Ok((path, bad))
}

fn error(values: &[f32], truth: &[f32]) -> f64 {
    let relative = values.iter().zip(truth).map(|(v, t)| {
        let (v, t) = (f64::from(*v), f64::from(*t));
        (v - t).abs() / t
    });
    relative.fold(0.0, f64::max)
}

/// `zeltner-1-1`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn pair(fig: &mut Figure) -> Result {
    let mut setup = setup(fig)?;
    note(fig, &setup);
    setup.problem.set(&START)?;
    let spp = fig.pick(128, 512);
    let before = picture(&setup.problem.scene, spp, TARGET_SEED + 1);
    let mut adam = bounded(Adam::new(3, 0.04)?)?;
    let (path, bad) = descend(&mut setup.problem, &mut adam, STEPS, 0.02)?;
    let (found, _) = path.last().ok_or("no steps")?;
    let e = error(found, &setup.truth);
    fig.check(
        "the round trip recovers the albedo to 1 % in fewer than 100 Adam steps",
        e < 0.01 && STEPS < 100 && bad == 0,
        format!(
            "{STEPS} steps: {found:.4?}, truth {:.4?}, largest relative error {:.2} %",
            setup.truth,
            100.0 * e
        ),
    );
    let after = picture(&setup.problem.scene, spp, TARGET_SEED + 1);
    let panel = |label: &str, image: &Image| Panel::tonemapped(label, image, 1.0).enlarged(4);
    let panels = [
        panel("start", &before),
        panel("recovered", &after),
        panel("target", &setup.problem.target),
    ];
    fig.images("forward-inverse", 3, &panels);
    report(fig, "steps", &path, &setup.truth);
    Ok(())
}

/// `zeltner-4-2`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn optimisation_loop(fig: &mut Figure) -> Result {
    let mut setup = setup(fig)?;
    note(fig, &setup);
    setup.problem.set(&START)?;
    let step = setup.problem.evaluate([1, 2], &())?.ok_or("stopped")?;
    let (image, target) = (step.seen.image(0), setup.problem.target.clone());
    let n = image.data.len() as f64;
    let pairs = || image.data.iter().zip(&target.data);
    let off = step.adjoint.iter().zip(pairs()).map(|(a, (x, t))| {
        let expected = 2.0 * (f64::from(*x) - f64::from(*t)) / n;
        (f64::from(*a) - expected).abs() * n
    });
    let off = off.fold(0.0, f64::max);
    fig.check(
        "loss and adjoint image are those of the mean squared error",
        off < 1e-5,
        format!("loss {:.6}, adjoint off by {off:.1e} of 1/n", step.loss),
    );
    let difference = |x: &[f32]| x.iter().map(|&x| f64::from(x)).collect::<Vec<_>>();
    let width = image.width;
    let green = |x: &[f64]| x.iter().skip(1).step_by(3).copied().collect::<Vec<f64>>();
    let adjoint = green(&difference(&step.adjoint));
    let panels = [
        Panel::tonemapped("1. render", &image, 1.0).enlarged(4),
        Panel::tonemapped("2. compare with the target", &target, 1.0).enlarged(4),
        Panel::signed("3. adjoint image, green", width, &adjoint, None).enlarged(4),
    ];
    fig.images("loop", 3, &panels);

    let mut adam = bounded(Adam::new(3, 0.04)?)?;
    let (path, bad) = descend(&mut setup.problem, &mut adam, STEPS, 0.02)?;
    smoke(fig, "Adam", "adam", &path, bad, &mut setup)?;
    // The mean squared error is nearly quadratic, of a curvature that light and wall set per channel:
    // half a Newton step.
    let mut rates = Rates::new(3, 1.0)?;
    for (c, curvature) in curvature(&mut setup.problem)?.into_iter().enumerate() {
        rates.set_rate(c..c + 1, 0.5 / curvature)?;
    }
    let mut sgd = bounded(Sgd::with_options(rates, SgdOptions::default())?)?;
    let (path, bad) = descend(&mut setup.problem, &mut sgd, STEPS, 0.02)?;
    smoke(fig, "gradient descent", "sgd", &path, bad, &mut setup)?;
    Ok(())
}

/// Second derivatives of the loss by the channels, from gradients at two places.
fn curvature(problem: &mut Problem) -> Result<Vec<f64>> {
    let mut gradients = Vec::new();
    for offset in [0.0, 0.3] {
        problem.set(&START.map(|v| v + offset))?;
        let step = problem.evaluate([3, 4], &())?.ok_or("stopped")?;
        gradients.push(step.gradient.values.concat());
    }
    let slopes = gradients[0].iter().zip(&gradients[1]);
    let slopes = slopes.map(|(a, b)| ((b - a) / 0.3).max(f64::MIN_POSITIVE));
    Ok(slopes.collect())
}

fn smoke(
    fig: &mut Figure,
    name: &str,
    file: &str,
    path: &Path,
    bad: u64,
    setup: &mut Setup,
) -> Result {
    let (found, _) = path.last().ok_or("no steps")?;
    let truth = setup.truth.clone();
    let e = error(found, &truth);
    fig.check(
        format!("the loop recovers one albedo with {name}: error below 2 %"),
        e < 0.02 && bad == 0,
        format!(
            "{found:.4?}, truth {truth:.4?}, largest relative error {:.2} %, {bad} samples not finite",
            100.0 * e
        ),
    );
    // With the samples of the target: what differs is the albedo, not the noise.
    let mut losses = Vec::new();
    for values in [&START[..], found] {
        let problem = &mut setup.problem;
        problem.set(values)?;
        let image = picture(&problem.scene, setup.target_spp, TARGET_SEED);
        losses.push(problem.loss.value(&image.data, &problem.target.data)?);
    }
    fig.check(
        format!("the loss falls below 1/1000 with {name}"),
        losses[1] < 1e-3 * losses[0],
        format!("{:.3e} -> {:.3e}", losses[0], losses[1]),
    );
    report(fig, file, path, &truth);
    Ok(())
}

fn note(fig: &mut Figure, setup: &Setup) {
    fig.note("unknown", NAME);
    fig.note("start", START.to_vec());
    fig.note("spp", setup.problem.settings.spp);
    fig.note("steps", STEPS);
    fig.note("seeds", vec![SEED, TARGET_SEED]);
}

fn report(fig: &mut Figure, name: &str, path: &Path, truth: &[f32]) {
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
