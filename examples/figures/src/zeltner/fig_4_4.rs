//! Derivatives sent forward from the parameters through a scene [Zeltner 2021, figure 4.4].

use render::Job;
use render::instances::{Estimator, render_f32};
use render::params::Theta;

use super::propagation::{CHANGE, NAME, SEED, bishop, board, grey};
use examples::chart::Panel;
use examples::figure::{Figure, Result};

/// `zeltner-4-4`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let board = board(fig)?;
    board.identities(fig)?;
    let rendering = board.derivative(SEED)?;

    // Differences of images with the same samples; the image is a polynomial in the colour.
    let step = 0.05;
    let info = board.scene.params().find(NAME)?.clone();
    let moved = |sign: f32| {
        let mut values = board.scene.params().values().to_vec();
        for (v, d) in values[info.range()].iter_mut().zip(CHANGE) {
            *v += sign * step * d as f32;
        }
        let theta = Theta::constant(&values);
        let (scene, samples) = (&board.scene, 0..board.spp);
        let job = Job::new(scene, &scene.settings, SEED, samples, &());
        render_f32(&job, &theta, Estimator::Mis)
    };
    let (plus, minus) = (moved(1.0), moved(-1.0));
    let n = board.spp as f64;
    let pairs = plus.sums[0].iter().zip(&minus.sums[0]);
    let difference: Vec<f64> = pairs
        .map(|(p, m)| (p - m) / (2.0 * f64::from(step) * n))
        .collect();
    let derivative: Vec<f64> = rendering.sums[1].iter().map(|s| s / n).collect();
    let norm = |x: &mut dyn Iterator<Item = f64>| x.map(|x| x * x).sum::<f64>().sqrt();
    let mut errors = difference.iter().zip(&derivative).map(|(a, b)| a - b);
    let error = norm(&mut errors) / norm(&mut derivative.iter().copied());
    fig.check(
        "the derivative image equals central differences with common samples",
        error < 0.01,
        format!("relative L2 distance {error:.1e}, step {step} of the change"),
    );

    let shown = bishop(&board.scene);
    let colour = grey(derivative.iter().map(|d| d.abs()));
    let sum = |inside: bool| -> f64 {
        let chosen = colour.iter().zip(&shown).filter(|(_, s)| **s == inside);
        chosen.map(|(c, _)| c).sum()
    };
    let reached = colour
        .iter()
        .zip(&shown)
        .filter(|(c, s)| !**s && **c > 1e-4);
    let reached = reached.count();
    let others = shown.iter().filter(|s| !**s).count();
    let (on, off) = (sum(true), sum(false));
    fig.check(
        "differential radiance is emitted by the bishop and scattered by everything else",
        on > off && off > 0.01 * on && reached * 10 > others,
        format!(
            "{:.1} % of it on the bishop; {reached} of {others} other pixels above 1e-4",
            100.0 * on / (on + off)
        ),
    );

    let width = board.image.width;
    let enlarge = fig.pick(4, 2);
    let colours = |k: usize| {
        derivative
            .iter()
            .skip(k)
            .step_by(3)
            .copied()
            .collect::<Vec<_>>()
    };
    let panel = |label: &str, values: &[f64], scale| {
        Panel::signed(label, width, values, scale).enlarged(enlarge)
    };
    let panels = [
        Panel::tonemapped("image", &board.image, 1.0).enlarged(enlarge),
        panel("derivative, red", &colours(0), None),
        panel("derivative, green", &colours(1), None),
        panel("red, scattered light: scale / 10", &colours(0), Some(0.01)),
    ];
    fig.images("forward", 2, &panels);
    Ok(())
}
