//! What refraction does to radiance and not to particles [Veach 1996, plate 2].

use render::Scene;
use render::bsdf::kernel::Rules;
use render::integrator::density::Convention;
use render::integrator::render::Rendering;

use super::pool::{RADIUS, WATER, gather, pool};
use super::{IGNORED, paths};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::ranks::median;

/// Whether a pixel sees the surface of the water, at its centre and all corners.
fn mask(scene: &Scene, surface: u32) -> Vec<[bool; 2]> {
    let [width, height] = scene.film.size;
    (0..width * height)
        .map(|i| {
            let (x, y) = (f64::from(i % width), f64::from(i / width));
            let sees =
                [(0.5, 0.5), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(dx, dy)| {
                    let hit = scene.intersect(&scene.camera.ray(x + dx, y + dy));
                    hit.is_some_and(|h| h.shape == surface)
                });
            [sees.iter().all(|&s| s), sees.iter().all(|&s| !s)]
        })
        .collect()
}

/// `veach-plate-2`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let width = fig.pick(64, 192);
    let spp = fig.pick(32, 128);
    fig.note("particles and viewing rays per pixel", spp);
    fig.note("radius", RADIUS);
    let (scene, surface) = pool(width, 1.0)?;
    let mask = mask(&scene, surface);
    let a = gather(&scene, Rules::default(), Convention::Radiance, spp)?;
    let b = gather(&scene, IGNORED, Convention::Radiance, spp)?;
    // All light is transmitted, as in the paper's derivation: reflections are not scaled.
    let (clear, _) = pool(width, 0.0)?;
    let ca = gather(&clear, Rules::default(), Convention::Radiance, spp)?;
    let cb = gather(&clear, IGNORED, Convention::Radiance, spp)?;
    let expected = WATER * WATER;
    let ratios = |a: &Rendering, b: &Rendering, k: usize| -> Vec<f64> {
        let pixels = a.sums[0].chunks_exact(3).zip(b.sums[0].chunks_exact(3));
        (pixels.zip(&mask))
            .filter(|((a, _), m)| m[k] && a.iter().sum::<f64>() > 0.0)
            .map(|((a, b), _)| b.iter().sum::<f64>() / a.iter().sum::<f64>())
            .collect()
    };
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let transmitted = ratios(&ca, &cb, 0);
    fig.check(
        format!("below the water, light that is transmitted: mean of (b) / (a) is 1.33^2 = {expected:.4}, to 1 %"),
        (mean(&transmitted) / expected - 1.0).abs() < 0.01,
        format!("{:.4} in {} pixels", mean(&transmitted), transmitted.len()),
    );
    let all = ratios(&a, &b, 0);
    let median = median(&all).ok_or("no water in sight")?;
    fig.check(
        "with reflections (which are not scaled): the median of the pixels below the water is no larger, and within 5 % of it",
        median < 1.001 * expected && median > 0.95 * expected,
        format!("median {median:.4}, mean {:.4}", mean(&all)),
    );
    let dry = ratios(&a, &b, 1);
    fig.check(
        "pixels above the water are unchanged, to 1 % in the mean",
        (mean(&dry) - 1.0).abs() < 0.01 && dry.len() > 100,
        format!("{:.5} in {} pixels", mean(&dry), dry.len()),
    );
    // The path tracer hits the large lamps through the water.
    let reference = paths(&scene, &scene.settings, 9, fig.pick(512, 2048));
    let brightness = |r: &Rendering, k: usize| {
        let pixels = r.sums[0].chunks_exact(3).zip(&mask).filter(|(_, m)| m[k]);
        pixels.map(|(p, _)| p.iter().sum::<f64>()).sum::<f64>() / r.samples as f64
    };
    for (k, name, tolerance) in [(0, "below", 0.03), (1, "above", 0.02)] {
        let ratio = brightness(&a, k) / brightness(&reference, k);
        fig.check(
            format!("(a) is as bright as the path tracer {name} the water, to {} % (bias at edges included)", tolerance * 100.0),
            (ratio - 1.0).abs() < tolerance,
            format!("{:+.2} %", (ratio - 1.0) * 100.0),
        );
    }
    fig.csv(
        "ratios",
        &["eta^2", "transmitted", "median", "mean", "above the water"],
        [[expected, mean(&transmitted), median, mean(&all), mean(&dry)]],
    );
    let enlarge = fig.pick(4, 2);
    let panel =
        |label: &str, r: &Rendering| Panel::tonemapped(label, &r.image(0), 1.0).enlarged(enlarge);
    fig.images(
        "plate",
        3,
        &[
            panel("(a) radiance scaled, particles not", &a),
            panel("(b) neither scaled", &b),
            panel("path tracer", &reference),
        ],
    );
    Ok(())
}
