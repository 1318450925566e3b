//! [Stam 2020, figure 8]: the image and one derivative image per control; directions at the sphere drawn from the
//! Blinn-Phong density.

use std::f64::consts::PI;

use render::Job;
use render::Scene;
use render::bsdf::{BlinnPhongLobe, BlinnPhongSampling};
use render::estimator::{AllowBias, Attached, BsdfOnly, Detached};
use render::instances::{Estimator, render_f64};
use render::math::Rgb;
use render::params::Theta;
use render::statistics::{Estimate, z_limit};

use super::alg_c;
use super::cornell::{LABELS, NAMES, SPHERE, perturbed};
use super::fixed_path::{FixedPath, Vertex, images};
use super::gradient_images::{
    BATCHES, Batched, EXPONENT, FD_STEP, Setup, THETA, batched, forward_batched, grey, highlight,
    panels, scene, setup,
};
use super::printed;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::ranks::percentile;

/// Indices of the controls that the image depends on: all but the ambient terms.
const USED: [usize; 5] = [0, 2, 3, 4, 6];

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

/// (a) Noise in the highlight.
fn noise(fig: &mut Figure, s: &Setup) -> Result {
    let mut rows = Vec::new();
    let mut ratios = Vec::new();
    for exponent in [20.0, 80.0, 320.0] {
        let ([image, derivative], pixels) = noise_ratios(exponent, s, fig.pick(64, 256))?;
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
    Ok(())
}

/// Differences in every control of [`USED`], of an estimator whose paths do not depend on the controls, with emitters
/// sampled.
fn differences(scene: &Scene, s: &Setup) -> Result<Vec<Batched>> {
    let mut reference = Vec::new();
    for &k in &USED {
        let fd = batched(s.spp.min(128), |samples| {
            let at = |sign: f64| -> Result<Vec<f64>> {
                let values = perturbed(scene, k, sign * FD_STEP)?;
                let theta = Theta::<f64>::constant(&values);
                let r = render_f64(
                    &Job::new(scene, &scene.settings, s.seed + 2, samples.clone(), &()),
                    &theta,
                    Estimator::Mis,
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
    Ok(reference)
}

fn text(e: Estimate) -> String {
    format!("{:.4} ± {:.4}", e.mean, e.se)
}

/// (b) Detached derivatives against differences.
fn detached(fig: &mut Figure, b: &Batched, reference: &[Batched]) {
    let limit = z_limit(USED.len(), BATCHES, 1e-2);
    let mut rows = Vec::new();
    for (&k, fd) in USED.iter().zip(reference) {
        let (found, truth) = (b.totals[k + 1], fd.totals[0]);
        let z = found.z(&truth).abs();
        fig.check(
            format!(
                "(b) variant ii, {}: detached derivative matches differences",
                LABELS[k]
            ),
            z < limit,
            format!(
                "sum over the image {}, differences {}, deviate {z:.2}, limit {limit:.2}",
                text(found),
                text(truth)
            ),
        );
        rows.push([k as f64, found.mean, found.se, truth.mean, truth.se]);
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
    for (statement, passed, found) in alg_c::attached_outcomes(fig.pick(100_000, 1_000_000)) {
        fig.check(format!("(b) variant iii, {statement}"), passed, found);
    }
}

/// (c) The printed rule: its image and its exponent derivative.
fn as_printed(
    fig: &mut Figure,
    scene: &Scene,
    s: &Setup,
    differences: &Batched,
) -> Result<Batched> {
    let values = perturbed(scene, 0, 0.0)?;
    let lobe = sphere_lobe(&values, scene)?;
    let theta = Theta::<f64>::constant(&values);
    let measured = batched(s.spp, |samples| {
        let found = images(scene, &values, s.seed, samples, |p: &FixedPath<f64>| {
            let mut score = 0.0;
            let l = p.radiance_with(scene, &theta, |v| {
                if v.shape == SPHERE {
                    let (f, d) = printed_lobe(&lobe, v);
                    score += d;
                    Rgb::splat(f)
                } else {
                    Rgb::splat(THETA[6] * v.wi.z / PI)
                }
            });
            [l.r, l.r * score, p.radiance(scene, &theta).r]
        });
        Ok(found.to_vec())
    })?;
    let (found, truth) = (measured.totals[1], differences.totals[0]);
    fig.check(
        "(c) variant i, printed exponent gradient is wrong (errata S-C1, S-C3)",
        found.z(&truth).abs() > 6.0,
        format!("sum over the image {}, true {}", text(found), text(truth)),
    );
    let region = highlight(THETA, s)?;
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
        let found = alg_c::mean_printed_weight(exponent, fig.pick(50_000, 400_000));
        fig.check(
            format!("(c) variant i, exponent {exponent}: energy E[sin theta_m]"),
            (found - expected).abs() < 2e-3,
            format!("{found:.4}, expected {expected}"),
        );
    }
    Ok(measured)
}

/// (d) Albedo-like controls.
fn albedos(fig: &mut Figure, b: &Batched, attached: &Batched, b7: &Batched) {
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
    let limit = z_limit(4, BATCHES, 1e-2);
    for k in [0, 2, 3, 6] {
        let (a, c) = (b.totals[k + 1], b7.totals[k + 1]);
        fig.check(
            format!("(d) {}: importance and cosine sampling agree", LABELS[k]),
            a.z(&c).abs() < limit,
            format!(
                "{}, {}, deviate {:.2}, limit {limit:.2}",
                text(a),
                text(c),
                a.z(&c)
            ),
        );
    }
}

/// `stam-08`.
pub fn figure(fig: &mut Figure) -> Result {
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

    noise(fig, &s)?;
    let reference = differences(&scene7, &s)?;
    detached(fig, &b, &reference);
    let attached = forward_batched::<AllowBias<BsdfOnly<Attached>>>(&scene8, s.seed, s.spp)?;
    let (found, truth) = (attached.totals[EXPONENT + 1], reference[3].totals[0]);
    fig.check(
        "(b) attached sampling without reparameterisation misses the edge of the light (F8)",
        found.z(&truth).abs() > 6.0,
        format!("{}, differences {}", text(found), text(truth)),
    );
    let measured = as_printed(fig, &scene8, &s, &reference[3])?;
    albedos(fig, &b, &attached, &b7);

    fig.images(
        "figure",
        4,
        &panels(&b.mean, s.size, "image, importance sampling", s.factor),
    );
    let width = s.size as usize;
    let scale = percentile(&reference[3].mean[0], 0.99);
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
