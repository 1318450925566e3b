//! [Stam 2020, figure 7]: the image and one derivative image per control; directions at the sphere drawn
//! cosine-weighted.

use render::Job;
use render::Scene;
use render::bsdf::BlinnPhongSampling;
use render::estimator::{BsdfOnly, Detached};
use render::instances::{Estimator, backward_f32, render_f64};
use render::integrator::gradient::Active;
use render::integrator::render::Rendering;
use render::params::Theta;

use super::cornell::{LABELS, NAMES, SPHERE, perturbed};
use super::fixed_path::images;
use super::gradient_images::{
    BATCHES, EXPONENT, FD_STEP, Setup, THETA, clean, forward_batched, grey, panels, scene, setup,
};
use examples::figure::{Figure, Result};

/// (e) One backward pass against derivative images; returns these, with emitters sampled.
fn reverse_mode(fig: &mut Figure, scene: &Scene, s: &Setup) -> Result<Rendering> {
    let spp = s.spp.min(64);
    let mis = clean(scene, s.seed, spp)?;
    let active = Active::new(scene, &NAMES)?;
    let adjoint = vec![1.0f32; scene.film.pixels() * 3];
    let theta = Theta::<f32>::constant(scene.params().values());
    let g = backward_f32(
        &Job::new(scene, &scene.settings, s.seed, 0..spp, &()),
        &theta,
        &active,
        &adjoint,
    )?;
    let pixels = scene.film.pixels() as f64;
    let mut worst = 0.0f64;
    let mut text = Vec::new();
    for (k, d) in g.values.iter().enumerate() {
        let images: f64 = mis.mean(k + 1).iter().sum::<f64>() * pixels;
        let reverse: f64 = d.iter().sum();
        worst = worst.max((images - reverse).abs() / images.abs().max(1.0));
        text.push(format!("{reverse:.4}"));
    }
    fig.check(
        "(e) one backward pass gives the sums of all seven derivative images over the same paths",
        worst < 1e-4,
        format!(
            "largest relative difference {worst:.1e}; {}",
            text.join(", ")
        ),
    );
    Ok(mis)
}

/// `stam-07`.
pub fn figure(fig: &mut Figure) -> Result {
    let s = setup(fig);
    let scene7 = scene(THETA, BlinnPhongSampling::Cosine, s.size, s.depth)?;
    let b = forward_batched::<BsdfOnly<Detached>>(&scene7, s.seed, s.spp)?;
    fig.check("no sample is NaN or infinite", b.bad == 0, b.bad);

    // ---- (a) Differences with common random numbers ----
    let mut rows = Vec::new();
    for (k, label) in LABELS.iter().enumerate() {
        let at = |sign: f64| -> Result<Vec<f64>> {
            let values = perturbed(&scene7, k, sign * FD_STEP)?;
            let theta = Theta::<f64>::constant(&values);
            let range = 0..s.spp / BATCHES * BATCHES;
            let r = render_f64(
                &Job::new(&scene7, &scene7.settings, s.seed, range, &()),
                &theta,
                Estimator::Detached,
            );
            Ok(grey(&r).swap_remove(0))
        };
        let (up, down) = (at(1.0)?, at(-1.0)?);
        let fd: Vec<f64> = up
            .iter()
            .zip(&down)
            .map(|(u, d)| (u - d) / (2.0 * FD_STEP))
            .collect();
        let (d, e) = (&b.mean[k + 1], &b.error[k + 1]);
        // Rounding of the difference itself, for pixels without variance.
        let floor = 1e-12 * up.iter().fold(0.0f64, |m, x| m.max(x.abs())) / FD_STEP;
        let worst = (0..d.len())
            .map(|i| (fd[i] - d[i]).abs() / (e[i] + floor))
            .fold(0.0f64, f64::max);
        let (gap, size) = (0..d.len()).fold((0.0, 0.0), |(g, s), i| {
            (g + (fd[i] - d[i]).abs(), s + d[i].abs())
        });
        let relative = if size > 0.0 { gap / size } else { gap };
        fig.check(
            format!("(a) {label}: derivative image equals differences of the same samples in every pixel, by far within the noise"),
            worst < 0.1 && relative < 1e-4,
            format!("{worst:.1e} standard errors at worst; {relative:.1e} of the image in all"),
        );
        let sum = b.totals[k + 1];
        rows.push([
            label.to_string(),
            sum.mean.to_string(),
            sum.se.to_string(),
            fd.iter().sum::<f64>().to_string(),
        ]);
    }
    fig.csv_text(
        "totals",
        &["control", "sum", "standard_error", "fd_sum"],
        rows,
    );

    // ---- (b) Emission ----
    let off = b.mean[0].iter().zip(&b.mean[1]);
    let off = off
        .map(|(l, d)| (l / THETA[0] - d).abs() / l.max(1e-300))
        .fold(0.0f64, f64::max);
    fig.check(
        "(b) derivative in the emission equals the image divided by the emission, pixel by pixel",
        off < 1e-12,
        format!("largest relative difference {off:.1e}"),
    );

    // ---- (c) Exponent ----
    let values = perturbed(&scene7, 0, 0.0)?;
    let [via] = images(
        &scene7,
        &values,
        s.seed,
        0..s.spp / BATCHES * BATCHES,
        |p| [f64::from(u8::from(p.hits(|shape| shape == SPHERE) > 0))],
    );
    let exponent = &b.mean[EXPONENT + 1];
    let agree = via
        .iter()
        .zip(exponent)
        .filter(|(v, d)| (**v > 0.0) == (**d != 0.0))
        .count();
    let lit = via.iter().filter(|v| **v > 0.0).count();
    fig.check(
        "(c) the exponent image is non-zero exactly where light arrived via the sphere",
        agree == via.len() && lit > 0 && lit < via.len(),
        format!(
            "{agree} of {} pixels agree; light via the sphere in {lit}",
            via.len()
        ),
    );
    // Direct light without noise: emitter sampling, one bounce.
    let direct = scene(THETA, BlinnPhongSampling::Cosine, s.size, 2)?;
    let shine = grey(&clean(&direct, s.seed, 64)?);
    let highlight = &shine[4];
    let peak = highlight.iter().fold(0.0f64, |m, x| m.max(*x));
    let part = |low: f64, high: f64| {
        let within = |i: &usize| highlight[*i] > low * peak && highlight[*i] <= high * peak;
        let chosen: Vec<usize> = (0..highlight.len()).filter(within).collect();
        let sum: f64 = chosen.iter().map(|&i| shine[EXPONENT + 1][i]).sum();
        (sum / chosen.len().max(1) as f64, chosen.len())
    };
    let (centre, around) = (part(0.8, 1.0), part(0.02, 0.3));
    fig.check(
        "(c) positive at the centre of the highlight, negative around it (exponent 40)",
        centre.0 > 0.0 && around.0 < 0.0 && centre.1 > 0 && around.1 > 0,
        format!(
            "mean {:.2e} over {} pixels, {:.2e} over {}",
            centre.0, centre.1, around.0, around.1
        ),
    );

    // ---- (d) Ambient ----
    let ambient = |k: usize| b.mean[k + 1].iter().all(|&x| x == 0.0);
    fig.check(
        "(d) the ambient controls, which no equation uses, have derivative 0 everywhere",
        ambient(1) && ambient(5),
        "exactly 0 in all pixels",
    );

    let mis = reverse_mode(fig, &scene7, &s)?;

    fig.images(
        "figure",
        4,
        &panels(&b.mean, s.size, "image, cosine sampling", s.factor),
    );
    let title = "image, emitters sampled too";
    fig.images(
        "figure-mis",
        4,
        &panels(&grey(&mis), s.size, title, s.factor),
    );
    Ok(())
}
