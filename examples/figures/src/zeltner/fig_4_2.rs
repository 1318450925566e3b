//! The optimisation loop, with two optimisers [Zeltner 2021, figure 4.2].

use optim::{Adam, Loss, Rates, Sgd, SgdOptions};

use super::recovery::{
    Path, START, STEPS, Setup, TARGET_SEED, bounded, descend, error, note, picture, report, setup,
};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::optimise::Problem;

/// `zeltner-4-2`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let mut setup = setup(fig)?;
    note(fig, &setup);
    setup.problem.set(&START)?;
    let step = setup.problem.evaluate([1, 2], &())?.ok_or("stopped")?;
    let (image, target) = (
        step.seen[0].image(0),
        setup.problem.targets[0].image.clone(),
    );
    let n = image.data.len() as f64;
    let pairs = || image.data.iter().zip(&target.data);
    let off = step.adjoints[0].iter().zip(pairs()).map(|(a, (x, t))| {
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
    let adjoint = green(&difference(&step.adjoints[0]));
    let panels = [
        Panel::tonemapped("1. render", &image, 1.0).enlarged(4),
        Panel::tonemapped("2. compare with the target", &target, 1.0).enlarged(4),
        Panel::signed("3. adjoint image, green", width, &adjoint, None).enlarged(4),
    ];
    fig.images("loop", 3, &panels);

    let mut adam = bounded(Adam::new(3, 0.05)?)?;
    let (path, bad) = descend(&mut setup.problem, &mut adam, STEPS, 0.1)?;
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
    let most = fig.pick(0.03, 0.02);
    fig.check(
        format!(
            "the loop recovers one albedo with {name}: error below {:.0} %",
            100.0 * most
        ),
        e < most && bad == 0,
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
        losses.push(
            problem
                .loss
                .value(&image.data, &problem.targets[0].image.data)?,
        );
    }
    fig.check(
        format!("the loss falls below 1/1000 with {name}"),
        losses[1] < 1e-3 * losses[0],
        format!("{:.3e} -> {:.3e}", losses[0], losses[1]),
    );
    report(fig, file, path, &truth);
    Ok(())
}
