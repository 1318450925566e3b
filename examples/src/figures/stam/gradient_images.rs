//! [Stam 2020, figures 7 and 8]: the image and one derivative image per control; directions at the
//! sphere drawn cosine-weighted, or from the Blinn-Phong density.

use std::f64::consts::PI;

use ad_core::Dual;
use render::Scene;
use render::bsdf::{BlinnPhongLobe, BlinnPhongSampling};
use render::estimator::{AllowBias, Attached, BsdfOnly, Detached, Unbiased};
use render::instances::{Direction, Estimator, backward_f32, forward_f32, render_f64};
use render::integrator::gradient::Active;
use render::integrator::render::{Rendering, render};
use render::math::Rgb;
use render::params::{Tangent, Theta};
use render::sampler::Independent;

use super::brdf;
use super::cornell::{CONTROLS, Cornell, LABELS, NAMES, SPHERE, perturbed};
use super::fixed_path::{FixedPath, Vertex, images};
use super::printed;
use crate::chart::{LineChart, Panel};
use crate::figure::{Figure, Result};

/// Bright enough to be seen; the sphere has a wide and visible highlight.
const THETA: [f64; CONTROLS] = [12.0, 0.0, 0.15, 0.45, 40.0, 0.0, 0.7];
const EXPONENT: usize = 4;
/// The controls that something reads.
const USED: [usize; 5] = [0, 2, 3, 4, 6];
const BATCHES: u64 = 16;
const FD_STEP: f64 = 1e-3;

fn scene(
    theta: [f64; CONTROLS],
    sampling: BlinnPhongSampling,
    size: u32,
    depth: u32,
) -> Result<Scene> {
    Cornell {
        theta,
        sampling,
        size,
        max_depth: depth,
    }
    .build()
}

/// Image and seven derivative images in double precision. The paper samples the BSDF alone. The first
/// channel of [`Rendering`] is meant: all colours are grey.
fn forward<S: Unbiased>(
    scene: &Scene,
    seed: u64,
    samples: std::ops::Range<u64>,
) -> Result<Rendering> {
    let values = perturbed(scene, 0, 0.0)?;
    let mut tangents = vec![Tangent::None; scene.params().infos().len()];
    for (k, name) in NAMES.iter().enumerate() {
        let id = scene.params().handle(scene.params().find(name)?).id as usize;
        let direction = Dual::<f64, CONTROLS>::var(0.0, k);
        tangents[id] = Tangent::Uniform(direction);
    }
    let theta = Theta::with_tangents(&values, &tangents);
    render::<Dual<f64, CONTROLS>, S, Independent>(
        scene,
        &theta,
        &scene.settings,
        seed,
        samples,
        &(),
    )
    .map_err(Into::into)
}

/// Per component and pixel: mean and its standard error, from independent batches.
struct Batched {
    mean: Vec<Vec<f64>>,
    error: Vec<Vec<f64>>,
    /// Sum over the pixels per batch and component.
    totals: Vec<Vec<f64>>,
    bad: u64,
}

fn batched(
    spp: u64,
    mut one: impl FnMut(std::ops::Range<u64>) -> Result<Vec<Vec<f64>>>,
) -> Result<Batched> {
    let per = (spp / BATCHES).max(1);
    let mut parts = Vec::new();
    for b in 0..BATCHES {
        parts.push(one(b * per..(b + 1) * per)?);
    }
    let n = BATCHES as f64;
    let (components, pixels) = (parts[0].len(), parts[0][0].len());
    let mut out = Batched {
        mean: vec![vec![0.0; pixels]; components],
        error: vec![vec![0.0; pixels]; components],
        totals: parts
            .iter()
            .map(|p| p.iter().map(|c| c.iter().sum()).collect())
            .collect(),
        bad: 0,
    };
    for k in 0..components {
        for i in 0..pixels {
            let mean = parts.iter().map(|p| p[k][i]).sum::<f64>() / n;
            let var = parts.iter().map(|p| (p[k][i] - mean).powi(2)).sum::<f64>() / (n - 1.0);
            out.mean[k][i] = mean;
            out.error[k][i] = (var / n).sqrt();
        }
    }
    Ok(out)
}

/// Grey pixel values of all components.
fn grey(r: &Rendering) -> Vec<Vec<f64>> {
    let n = r.samples.max(1) as f64;
    r.sums
        .iter()
        .map(|s| s.iter().step_by(3).map(|x| x / n).collect())
        .collect()
}

fn forward_batched<S: Unbiased>(scene: &Scene, seed: u64, spp: u64) -> Result<Batched> {
    let mut bad = 0;
    let mut out = batched(spp, |samples| {
        let r = forward::<S>(scene, seed, samples)?;
        bad += r.non_finite.count;
        Ok(grey(&r))
    })?;
    out.bad = bad;
    Ok(out)
}

/// Mean over the batches of a component's sum over the image, and its standard error.
fn total(b: &Batched, k: usize) -> (f64, f64) {
    let n = b.totals.len() as f64;
    let mean = b.totals.iter().map(|t| t[k]).sum::<f64>() / n;
    let var = b.totals.iter().map(|t| (t[k] - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (var / n).sqrt())
}

fn panels(mean: &[Vec<f64>], size: u32, title: &str, factor: usize) -> Vec<Panel> {
    let width = size as usize;
    let data = mean[0].iter().flat_map(|&v| [v as f32; 3]).collect();
    let image = render::Image {
        width,
        height: width,
        data,
    };
    let mut all = vec![Panel::tonemapped(title, &image, 1.3).enlarged(factor)];
    for (k, label) in LABELS.iter().enumerate() {
        // Noise in the brightest pixels must not set the scale.
        all.push(
            Panel::signed(&format!("d / d {label}"), width, &mean[k + 1], None).enlarged(factor),
        );
    }
    all
}

/// Derivative image along the directions of all controls by MIS: less noise than the paper has.
fn clean(scene: &Scene, seed: u64, spp: u64) -> Result<Rendering> {
    let directions = NAMES.map(|n| Direction::uniform(scene.params(), n));
    let directions = directions
        .into_iter()
        .collect::<std::result::Result<Vec<_>, _>>()?;
    let values = scene.params().values();
    Ok(forward_f32(
        scene,
        values,
        &directions,
        &scene.settings,
        seed,
        0..spp,
        &(),
    )?)
}

/// Settings shared by both figures.
struct Setup {
    size: u32,
    spp: u64,
    depth: u32,
    seed: u64,
    factor: usize,
}

fn setup(fig: &mut Figure) -> Setup {
    let s = Setup {
        size: fig.pick(40, 128),
        spp: fig.pick(64, 128),
        depth: 5,
        seed: 7,
        factor: fig.pick(6, 2),
    };
    fig.note("theta", THETA.to_vec());
    fig.note("size", s.size);
    fig.note("spp", s.spp);
    fig.note("seed", s.seed);
    fig.note("max_depth", s.depth);
    s
}

/// `stam-07`.
pub fn cosine(fig: &mut Figure) -> Result {
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
                &scene7,
                &theta,
                Estimator::Detached,
                &scene7.settings,
                s.seed,
                range,
                &(),
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
            format!("(a) {label}: derivative image equals differences in every pixel within 4 standard errors"),
            worst < 4.0 && relative < 1e-4,
            format!("{worst:.1e} standard errors at worst; {relative:.1e} of the image in all"),
        );
        let (sum, error) = total(&b, k + 1);
        rows.push([
            label.to_string(),
            sum.to_string(),
            error.to_string(),
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

    // ---- (e) Reverse mode ----
    let spp = s.spp.min(64);
    let mis = clean(&scene7, s.seed, spp)?;
    let active = Active::new(&scene7, &NAMES)?;
    let adjoint = vec![1.0f32; scene7.film.pixels() * 3];
    let theta = Theta::<f32>::constant(scene7.params().values());
    let g = backward_f32(
        &scene7,
        &theta,
        &active,
        &adjoint,
        &scene7.settings,
        s.seed,
        0..spp,
        &(),
    )?;
    let pixels = scene7.film.pixels() as f64;
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

/// The sphere's lobe without tangents.
fn sphere_lobe(values: &[f64], scene: &Scene) -> Result<BlinnPhongLobe<f64>> {
    let at = |k: usize| -> Result<f64> { Ok(values[scene.params().find(NAMES[k])?.offset]) };
    let sampling = BlinnPhongSampling::Importance;
    Ok(BlinnPhongLobe::new(
        Rgb::splat(at(2)?),
        Rgb::splat(at(3)?),
        at(4)?,
        sampling,
    ))
}

/// `f cos` of the sphere as printed: the microfacets carry an extra `sin theta_m`; and its share that
/// the printed exponent update differentiates, over the whole.
fn printed_lobe(lobe: &BlinnPhongLobe<f64>, v: &Vertex<f64>) -> (f64, f64) {
    let cos_m = (v.wo + v.wi).normalize().z.min(1.0);
    let microfacets = lobe.specular.r * lobe.microfacet_pdf(v.wo, v.wi);
    let f = lobe.diffuse.r * v.wi.z / PI + microfacets * printed::weight(cos_m);
    let d = microfacets * printed::weight_derivative(cos_m, lobe.exponent);
    (f, if f > 0.0 { d / f } else { 0.0 })
}

/// Exponent derivative of a path over its radiance, with the corrected weight.
fn exponent_score(lobe: &BlinnPhongLobe<f64>, v: &Vertex<f64>) -> f64 {
    let cos_m = (v.wo + v.wi).normalize().z.min(1.0);
    let microfacets = lobe.specular.r * lobe.microfacet_pdf(v.wo, v.wi);
    let f = lobe.diffuse.r * v.wi.z / PI + microfacets;
    microfacets / f * (1.0 / (lobe.exponent + 2.0) + cos_m.ln())
}

/// Standard deviation of one sample with cosine sampling at the sphere over that with importance
/// sampling, in the image and in the exponent derivative, over the highlight.
///
/// Both second moments are estimated from the same importance-sampled paths: with densities p and q of
/// cosine and importance sampling, `E_p[(f/p)^2] = E_q[(f/p)(f/q)]`. Cosine sampling alone rarely meets a narrow
/// highlight, and its sample variance is too small then.
fn noise_ratios(exponent: f64, s: &Setup, spp: u64) -> Result<([f64; 2], usize)> {
    let mut theta = THETA;
    theta[EXPONENT] = exponent;
    let region = highlight(theta, s)?;
    let scene = scene(theta, BlinnPhongSampling::Importance, s.size, s.depth)?;
    let values = perturbed(&scene, 0, 0.0)?;
    let lobe = sphere_lobe(&values, &scene)?;
    let at = Theta::<f64>::constant(&values);
    let found = images(&scene, &values, s.seed, 0..spp, |p| {
        let l = p.radiance(&scene, &at).r;
        let (mut ratio, mut score) = (1.0, 0.0);
        for v in p.vertices.iter().filter(|v| v.shape == SPHERE) {
            ratio *= PI / (v.wi.z * v.weight);
            score += exponent_score(&lobe, v);
        }
        let d = l * score;
        [l, l * l, l * l * ratio, d, d * d, d * d * ratio]
    });
    // Sum over the region of second moment minus square of the mean.
    let variance = |mean: usize, second: usize| -> f64 {
        region
            .iter()
            .map(|&i| found[second][i] - found[mean][i].powi(2))
            .sum()
    };
    let image = (variance(0, 2) / variance(0, 1)).sqrt();
    let derivative = (variance(3, 5) / variance(3, 4)).sqrt();
    Ok(([image, derivative], region.len()))
}

/// Pixels whose direct specular light is at least 0.3 of the brightest.
fn highlight(theta: [f64; CONTROLS], s: &Setup) -> Result<Vec<usize>> {
    let direct = scene(theta, BlinnPhongSampling::Cosine, s.size, 2)?;
    let shine = &grey(&clean(&direct, s.seed, 32)?)[4];
    let peak = shine.iter().fold(0.0f64, |m, x| m.max(*x));
    Ok((0..shine.len())
        .filter(|&i| shine[i] > 0.3 * peak)
        .collect())
}

/// `stam-08`.
pub fn importance(fig: &mut Figure) -> Result {
    let s = setup(fig);
    let scene8 = scene(THETA, BlinnPhongSampling::Importance, s.size, s.depth)?;
    let scene7 = scene(THETA, BlinnPhongSampling::Cosine, s.size, s.depth)?;
    let b = forward_batched::<BsdfOnly<Detached>>(&scene8, s.seed, s.spp)?;
    let b7 = forward_batched::<BsdfOnly<Detached>>(&scene7, s.seed + 1, s.spp)?;
    fig.check(
        "no sample is NaN or infinite",
        b.bad + b7.bad == 0,
        b.bad + b7.bad,
    );

    // ---- (a) Noise in the highlight ----
    let mut rows = Vec::new();
    let mut ratios = Vec::new();
    for exponent in [20.0, 80.0, 320.0] {
        let ([image, derivative], pixels) = noise_ratios(exponent, &s, fig.pick(64, 256))?;
        fig.check(
            format!("(a) exponent {exponent}: less noise in the highlight than cosine sampling"),
            image > 1.0 && derivative > 1.0,
            format!(
                "standard deviation {image:.2} times smaller in the image, {derivative:.2} times in the exponent derivative ({} pixels)",
                pixels
            ),
        );
        ratios.push(image);
        rows.push([exponent, image, derivative]);
    }
    fig.check(
        "(a) the gain grows with the exponent",
        ratios.windows(2).all(|w| w[1] > w[0]),
        format!(
            "{:.2}, {:.2}, {:.2} for exponent 20, 80, 320",
            ratios[0], ratios[1], ratios[2]
        ),
    );
    let chart = LineChart::new(
        "Noise of cosine sampling over importance sampling",
        "exponent",
        "ratio of standard deviations",
    )
    .log_x()
    .measured("image", rows.iter().map(|r| (r[0], r[1])))
    .measured("exponent derivative", rows.iter().map(|r| (r[0], r[2])));
    fig.chart("noise", &chart);
    fig.csv(
        "noise",
        &["exponent", "ratio_image", "ratio_exponent_derivative"],
        rows,
    );

    // ---- (b) Detached against differences ----
    // Differences of an estimator whose paths do not depend on the controls, with emitters sampled.
    let mut reference = Vec::new();
    for &k in &USED {
        let fd = batched(s.spp.min(128), |samples| {
            let at = |sign: f64| -> Result<Vec<f64>> {
                let values = perturbed(&scene7, k, sign * FD_STEP)?;
                let theta = Theta::<f64>::constant(&values);
                let r = render_f64(
                    &scene7,
                    &theta,
                    Estimator::Mis,
                    &scene7.settings,
                    s.seed + 2,
                    samples.clone(),
                    &(),
                );
                Ok(grey(&r).swap_remove(0))
            };
            let (up, down) = (at(1.0)?, at(-1.0)?);
            Ok(vec![
                up.iter()
                    .zip(&down)
                    .map(|(u, d)| (u - d) / (2.0 * FD_STEP))
                    .collect(),
            ])
        })?;
        reference.push(fd);
    }
    let mut rows = Vec::new();
    for (&k, fd) in USED.iter().zip(&reference) {
        let (found, error) = total(&b, k + 1);
        let (truth, fd_error) = total(fd, 0);
        let z = (found - truth).abs() / error.hypot(fd_error);
        fig.check(
            format!(
                "(b) variant ii, {}: detached derivative matches differences",
                LABELS[k]
            ),
            z < 4.0,
            format!(
                "sum over the image {found:.4} ± {error:.4}, differences {truth:.4} ± {fd_error:.4}"
            ),
        );
        rows.push([k as f64, found, error, truth, fd_error]);
    }
    fig.csv(
        "totals",
        &[
            "control",
            "sum",
            "standard_error",
            "fd_sum",
            "fd_standard_error",
        ],
        rows,
    );
    for (statement, passed, found) in brdf::attached_outcomes(fig.pick(100_000, 1_000_000)) {
        fig.check(format!("(b) variant iii, {statement}"), passed, found);
    }
    let attached = forward_batched::<AllowBias<BsdfOnly<Attached>>>(&scene8, s.seed, s.spp)?;
    let (found, error) = total(&attached, EXPONENT + 1);
    let (truth, fd_error) = total(&reference[3], 0);
    fig.check(
        "(b) attached sampling without reparameterisation misses the edge of the light (F8)",
        (found - truth).abs() > 6.0 * error.hypot(fd_error),
        format!("{found:.4} ± {error:.4}, differences {truth:.4} ± {fd_error:.4}"),
    );

    // ---- (c) The printed rule ----
    let values = perturbed(&scene8, 0, 0.0)?;
    let lobe = sphere_lobe(&values, &scene8)?;
    let theta = Theta::<f64>::constant(&values);
    let measured = batched(s.spp, |samples| {
        let found = images(&scene8, &values, s.seed, samples, |p: &FixedPath<f64>| {
            let mut score = 0.0;
            let l = p.radiance_with(&scene8, &theta, |v| {
                if v.shape == SPHERE {
                    let (f, d) = printed_lobe(&lobe, v);
                    score += d;
                    Rgb::splat(f)
                } else {
                    Rgb::splat(THETA[6] * v.wi.z / PI)
                }
            });
            [l.r, l.r * score, p.radiance(&scene8, &theta).r]
        });
        Ok(found.to_vec())
    })?;
    let (found, error) = total(&measured, 1);
    fig.check(
        "(c) variant i, printed exponent gradient is wrong (errata S-C1, S-C3)",
        (found - truth).abs() > 6.0 * error.hypot(fd_error),
        format!("sum over the image {found:.4} ± {error:.4}, true {truth:.4} ± {fd_error:.4}"),
    );
    let region = highlight(THETA, &s)?;
    let sum = |k: usize| region.iter().map(|&i| measured.mean[k][i]).sum::<f64>();
    fig.check(
        "(c) variant i loses the highlight",
        sum(0) < 0.7 * sum(2),
        format!(
            "{:.3} of the radiance in {} pixels of the highlight",
            sum(0) / sum(2),
            region.len()
        ),
    );
    for (exponent, expected) in [(10.0, 0.341), (100.0, 0.123), (1000.0, 0.040)] {
        let found = brdf::mean_printed_weight(exponent, fig.pick(50_000, 400_000));
        fig.check(
            format!("(c) variant i, exponent {exponent}: energy E[sin theta_m]"),
            (found - expected).abs() < 2e-3,
            format!("{found:.4}, expected {expected}"),
        );
    }

    // ---- (d) Albedo-like controls ----
    let same = [0, 2, 3, 6]
        .iter()
        .flat_map(|&k| b.mean[k + 1].iter().zip(&attached.mean[k + 1]));
    let same = same
        .map(|(a, b)| (a - b).abs() / a.abs().max(1e-6))
        .fold(0.0f64, f64::max);
    fig.check(
        "(d) emission and albedos: detached and attached derivative images are the same",
        same < 1e-9,
        format!("largest relative difference {same:.1e}"),
    );
    for k in [0, 2, 3, 6] {
        let (a, ea) = total(&b, k + 1);
        let (c, ec) = total(&b7, k + 1);
        fig.check(
            format!("(d) {}: importance and cosine sampling agree", LABELS[k]),
            (a - c).abs() < 4.0 * ea.hypot(ec),
            format!("{a:.4} ± {ea:.4}, {c:.4} ± {ec:.4}"),
        );
    }

    fig.images(
        "figure",
        4,
        &panels(&b.mean, s.size, "image, importance sampling", s.factor),
    );
    let width = s.size as usize;
    let scale = {
        let mut m: Vec<f64> = reference[3].mean[0].iter().map(|x| x.abs()).collect();
        m.sort_by(f64::total_cmp);
        m[(m.len() - 1) * 99 / 100]
    };
    let exponent = |label: &str, values: &[f64]| {
        Panel::signed(label, width, values, Some(scale)).enlarged(s.factor)
    };
    let image = |label: &str, values: &[f64]| {
        let data = values.iter().flat_map(|&v| [v as f32; 3]).collect();
        let image = render::Image {
            width,
            height: width,
            data,
        };
        Panel::tonemapped(label, &image, 1.3).enlarged(s.factor)
    };
    fig.images(
        "variants",
        3,
        &[
            image("ii: corrected image", &b.mean[0]),
            image("i: printed image", &measured.mean[0]),
            exponent("differences", &reference[3].mean[0]),
            exponent("ii: detached", &b.mean[EXPONENT + 1]),
            exponent("i: printed", &measured.mean[1]),
            exponent("attached, edge missed", &attached.mean[EXPONENT + 1]),
        ],
    );
    Ok(())
}
