//! Statistical and numerical tests of every material: one harness, one line per material. What is known of single ones is in
//! `models`.

use std::f64::consts::PI;
use std::sync::Arc;

use ad_core::check::central_difference;
use ad_core::{Dual, Float, Real, Vec3};
use render::bsdf::{Bsdf, BsdfSample, Component, DeltaKind, Material, Part, TransportMode, Use};
use render::math::Rgb;
use render::params::{ParamRef, Params, Tangent, Theta};
use render::sampler::{Independent, Sampler};
use render::statistics::{p_value, sidak, z_limit};

use crate::common::Gradient;
use crate::common::materials::{at, build, integrate, polar};

mod models;

/// How a material turns random numbers into a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Sampled {
    /// Continuously: densities can be differentiated.
    Once,
    /// After a discrete choice between parts that reach different directions. The choice is primal,
    /// so the density's derivative is that at fixed probability.
    ByChoice,
    /// After a discrete choice between parts that may reach the same direction.
    AsMixture,
    /// The same, and the number that chooses is used once more, stretched over its part: directions at fixed random numbers
    /// move with probabilities, which derivatives leave constant.
    Stretched,
}

/// All materials under test: a name, the plugin, its content, and how it is
/// sampled.
const MATERIALS: &[(&str, &str, &str, Sampled)] = &[
    (
        "diffuse",
        "diffuse",
        r#"<rgb name="reflectance" value=".9 .5 .2"/>"#,
        Sampled::Once,
    ),
    ("mirror", "conductor", "", Sampled::Once),
    (
        "gold",
        "conductor",
        r#"<string name="material" value="Au"/>"#,
        Sampled::Once,
    ),
    (
        "glass",
        "dielectric",
        r#"<float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/>"#,
        Sampled::ByChoice,
    ),
    (
        "ggx .3",
        "roughconductor",
        r#"<float name="alpha" value=".3"/><string name="distribution" value="ggx"/>"#,
        Sampled::Once,
    ),
    (
        "beckmann .3",
        "roughconductor",
        r#"<float name="alpha" value=".3"/><string name="material" value="Cu"/>"#,
        Sampled::Once,
    ),
    (
        "ggx .05, all normals",
        "roughconductor",
        r#"<float name="alpha" value=".05"/><string name="distribution" value="ggx"/>
           <boolean name="sample_visible" value="false"/><rgb name="eta" value=".2 .9 1.1"/>
           <rgb name="k" value="3.9 2.4 2.1"/>"#,
        Sampled::Once,
    ),
    (
        "beckmann .9, all normals",
        "roughconductor",
        r#"<float name="alpha" value=".9"/><boolean name="sample_visible" value="false"/>"#,
        Sampled::Once,
    ),
    (
        "beckmann .02",
        "roughconductor",
        r#"<float name="alpha" value=".02"/><rgb name="specular_reflectance" value=".9 .5 .1"/>"#,
        Sampled::Once,
    ),
    (
        "brushed, ggx .4 and .1",
        "roughconductor",
        r#"<float name="alpha_u" value=".4"/><float name="alpha_v" value=".1"/>
           <string name="distribution" value="ggx"/><string name="material" value="Cu"/>"#,
        Sampled::Once,
    ),
    (
        "brushed, beckmann .1 and .5",
        "roughconductor",
        r#"<float name="alpha_u" value=".1"/><float name="alpha_v" value=".5"/>"#,
        Sampled::Once,
    ),
    (
        "brushed, beckmann .2 and .6, all normals",
        "roughconductor",
        r#"<float name="alpha_u" value=".2"/><float name="alpha_v" value=".6"/>
           <boolean name="sample_visible" value="false"/>"#,
        Sampled::Once,
    ),
    (
        "brushed glass",
        "roughdielectric",
        r#"<float name="alpha_u" value=".4"/><float name="alpha_v" value=".15"/>
           <string name="distribution" value="ggx"/><float name="int_ior" value="1.5"/>"#,
        Sampled::ByChoice,
    ),
    (
        "rough glass ggx .3",
        "roughdielectric",
        r#"<float name="alpha" value=".3"/><string name="distribution" value="ggx"/>
           <float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/>"#,
        Sampled::ByChoice,
    ),
    (
        "rough glass beckmann .1",
        "roughdielectric",
        r#"<float name="alpha" value=".1"/><rgb name="specular_transmittance" value=".9 .8 .7"/>"#,
        Sampled::ByChoice,
    ),
    (
        "rough bubble ggx .5, all normals",
        "roughdielectric",
        r#"<float name="alpha" value=".5"/><string name="distribution" value="ggx"/>
           <float name="int_ior" value="1"/><float name="ext_ior" value="1.33"/>
           <boolean name="sample_visible" value="false"/>"#,
        Sampled::ByChoice,
    ),
    (
        "plastic",
        "plastic",
        r#"<rgb name="diffuse_reflectance" value=".6 .3 .1"/><boolean name="nonlinear" value="true"/>"#,
        Sampled::ByChoice,
    ),
    (
        "plastic in water",
        "plastic",
        r#"<rgb name="diffuse_reflectance" value=".6 .3 .1"/><boolean name="nonlinear" value="true"/>
           <float name="int_ior" value="1"/><float name="ext_ior" value="1.33"/>"#,
        Sampled::ByChoice,
    ),
    (
        "rough plastic beckmann .3",
        "roughplastic",
        r#"<float name="alpha" value=".3"/><rgb name="diffuse_reflectance" value=".6 .3 .1"/>"#,
        Sampled::AsMixture,
    ),
    (
        "rough plastic ggx .1",
        "roughplastic",
        r#"<float name="alpha" value=".1"/><string name="distribution" value="ggx"/>
           <rgb name="diffuse_reflectance" value=".01 .02 .05"/><float name="int_ior" value="1.9"/>
           <boolean name="nonlinear" value="true"/>"#,
        Sampled::AsMixture,
    ),
    (
        "blinn-phong",
        "blinnphong",
        r#"<float name="exponent" value="20"/><rgb name="specular_reflectance" value=".3 .2 .1"/>"#,
        Sampled::AsMixture,
    ),
    (
        "two sides of copper",
        "twosided",
        r#"<bsdf type="roughconductor"><float name="alpha" value=".2"/>
           <string name="material" value="Cu"/></bsdf>"#,
        Sampled::Once,
    ),
    (
        "window",
        "thindielectric",
        r#"<float name="int_ior" value="1.5"/><rgb name="specular_transmittance" value=".9 .8 .7"/>"#,
        Sampled::ByChoice,
    ),
    ("nothing", "null", "", Sampled::Once),
    (
        "principled",
        "principled",
        r#"<rgb name="base_color" value=".7 .4 .1"/><float name="metallic" value=".4"/>
           <float name="roughness" value=".6"/>"#,
        Sampled::AsMixture,
    ),
    (
        "principled with all parts",
        "principled",
        r#"<rgb name="base_color" value=".7 .4 .1"/><float name="metallic" value=".3"/>
           <float name="roughness" value=".5"/><float name="eta" value="1.6"/>
           <float name="flatness" value=".4"/><float name="sheen" value=".7"/>
           <float name="clearcoat" value=".8"/><float name="clearcoat_gloss" value=".2"/>"#,
        Sampled::AsMixture,
    ),
    (
        "principled with tints",
        "principled",
        r#"<rgb name="base_color" value=".7 .4 .1"/><float name="metallic" value=".3"/>
           <float name="roughness" value=".5"/><float name="eta" value="1.6"/>
           <float name="sheen" value=".7"/><float name="flatness" value=".4"/>
           <float name="spec_tint" value=".6"/><float name="sheen_tint" value=".8"/>"#,
        Sampled::AsMixture,
    ),
    (
        "brushed principled",
        "principled",
        r#"<rgb name="base_color" value=".7 .4 .1"/><float name="metallic" value=".3"/>
           <float name="roughness" value=".6"/><float name="anisotropic" value=".8"/>
           <float name="flatness" value=".4"/><float name="sheen" value=".7"/>
           <float name="clearcoat" value=".8"/><float name="clearcoat_gloss" value=".2"/>"#,
        Sampled::AsMixture,
    ),
    (
        "principled glass",
        "principled",
        r#"<rgb name="base_color" value=".7 .4 .1"/><float name="metallic" value=".2"/>
           <float name="roughness" value=".6"/><float name="spec_trans" value=".6"/>
           <float name="specular" value=".5"/>"#,
        Sampled::AsMixture,
    ),
    (
        "brushed principled glass",
        "principled",
        r#"<rgb name="base_color" value=".7 .4 .1"/><float name="metallic" value=".2"/>
           <float name="roughness" value=".6"/><float name="anisotropic" value=".7"/>
           <float name="eta" value="1.5"/><float name="spec_trans" value=".6"/>
           <float name="flatness" value=".4"/><float name="sheen" value=".7"/>
           <float name="clearcoat" value=".8"/><float name="clearcoat_gloss" value=".2"/>"#,
        Sampled::AsMixture,
    ),
    (
        "principled thin",
        "principledthin",
        r#"<rgb name="base_color" value=".7 .4 .1"/><float name="roughness" value=".6"/>
           <float name="spec_trans" value=".6"/><float name="eta" value="1.4"/><float name="spec_tint" value=".5"/>
           <float name="diff_trans" value=".7"/><float name="flatness" value=".4"/><float name="sheen" value=".7"/>
           <float name="sheen_tint" value=".3"/>"#,
        Sampled::AsMixture,
    ),
    (
        "principled thin, brushed",
        "principledthin",
        r#"<rgb name="base_color" value=".7 .4 .1"/><float name="roughness" value=".6"/>
           <float name="spec_trans" value=".9"/><float name="anisotropic" value=".7"/>"#,
        Sampled::AsMixture,
    ),
    ("hair", "hair", "", Sampled::Stretched),
    (
        "white hair",
        "hair",
        r#"<rgb name="sigma_a" value=".03 .05 .1"/><float name="scale" value="2"/>
           <float name="longitudinal_roughness" value=".2"/><float name="azimuthal_roughness" value=".6"/>
           <float name="scale_tilt" value="-5"/><float name="int_ior" value="1.4"/>"#,
        Sampled::Stretched,
    ),
    (
        "stained metal",
        "blendbsdf",
        r#"<float name="weight" value=".3"/><bsdf type="roughconductor"/><bsdf type="diffuse"/>"#,
        Sampled::AsMixture,
    ),
];

// ---- Harness ------------------------------------------------------------------------------------

/// A material with its own parameter vector.
struct Case {
    name: &'static str,
    sampled: Sampled,
    material: Arc<Material>,
    params: Params,
}

fn cases() -> impl Iterator<Item = Case> {
    MATERIALS.iter().map(|&(name, plugin, content, sampled)| {
        let (material, params) = build(plugin, content).unwrap_or_else(|e| panic!("{name}: {e}"));
        Case {
            name,
            sampled,
            material,
            params,
        }
    })
}

impl Case {
    fn values<P: Float>(&self) -> Vec<P> {
        self.params
            .values()
            .iter()
            .map(|&v| P::from_f32(v))
            .collect()
    }

    /// Ranges of parameters, as many as a local Jacobian can hold.
    fn handles(&self) -> Vec<ParamRef> {
        let mut handles = Vec::new();
        self.material.visit_params(&mut |p| {
            if !handles.contains(&p) {
                handles.push(p);
            }
        });
        handles
    }

    fn range(&self, p: ParamRef) -> std::ops::Range<usize> {
        self.params.infos()[p.id as usize].range()
    }
}

const MODES: [TransportMode; 2] = [TransportMode::Radiance, TransportMode::Importance];

const DELTAS: [DeltaKind; 3] = [
    DeltaKind::Reflection,
    DeltaKind::Transmission,
    DeltaKind::Passthrough,
];

/// Five directions: normal incidence, two oblique ones, a grazing one, and one from below.
fn directions() -> [Vec3<f64>; 5] {
    [(1.0, 0.0), (0.8, 0.4), (0.3, 2.5), (0.02, 4.0), (-0.6, 1.2)].map(|(z, phi)| polar(z, phi))
}

// ---- Sampling -----------------------------------------------------------------------------------

/// p-value of the samples' histogram (over the sphere, plus one bin for each delta and one for
/// failures) against the density.
fn chi_square(case: &Case, wo: Vec3<f64>, mode: TransportMode, seed: u64) -> f64 {
    const N: u64 = 40_000;
    const ROWS: usize = 16;
    const COLUMNS: usize = 24;
    let values = case.values::<f64>();
    let at = at(Theta::constant(&values));
    let mut observed = vec![0.0; ROWS * COLUMNS];
    let mut deltas = [(0.0, 0.0); 3];
    let mut failed = 0.0;
    for i in 0..N {
        let u = Independent::new(seed, 0, i).next_3d();
        let Some(s) = case.material.sample(&at, wo, u, mode) else {
            failed += 1.0;
            continue;
        };
        match s.component {
            Component::Continuous => {
                assert!((s.wi.length() - 1.0).abs() < 1e-12, "{}", case.name);
                let row = ((s.wi.z + 1.0) / 2.0 * ROWS as f64) as usize;
                let phi = s.wi.y.atan2(s.wi.x).rem_euclid(2.0 * PI) / (2.0 * PI);
                let column = (phi * COLUMNS as f64) as usize;
                observed[row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)] += 1.0;
            }
            Component::Delta { kind, .. } => {
                let bin = DELTAS.iter().position(|&k| k == kind).unwrap();
                deltas[bin].0 += 1.0;
                deltas[bin].1 = s.pdf;
            }
        }
    }
    let density = |z: f64, phi: f64| case.material.eval_pdf(&at, wo, polar(z, phi), mode).1;
    let n = N as f64;
    let mut bins: Vec<(f64, f64)> = Vec::new();
    for (i, &count) in observed.iter().enumerate() {
        let (row, column) = ((i / COLUMNS) as f64, (i % COLUMNS) as f64);
        let (dz, dphi) = (2.0 / ROWS as f64, 2.0 * PI / COLUMNS as f64);
        let z0 = row * dz - 1.0;
        let cell = [z0, z0 + dz, column * dphi, (column + 1.0) * dphi];
        bins.push((count, n * integrate(&density, cell, 1e-6, 9)));
    }
    bins.extend(deltas.iter().map(|&(count, p)| (count, n * p)));
    let expected: f64 = bins.iter().map(|b| b.1).sum();
    assert!(
        expected < n * (1.0 + 1e-3),
        "{}: density integrates to {}",
        case.name,
        expected / n
    );
    bins.push((failed, (n - expected).max(0.0)));
    p_value(bins)
}

/// Chi-square test of every material, five directions, both modes; significance 1 % for all of
/// them together.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn samples_follow_the_density() {
    let limit = sidak(MATERIALS.len() * 10, 0.01);
    for (k, case) in cases().enumerate() {
        for (i, wo) in directions().into_iter().enumerate() {
            for (j, mode) in MODES.into_iter().enumerate() {
                let p = chi_square(&case, wo, mode, (k * 100 + i * 10 + j) as u64);
                assert!(
                    p > limit,
                    "{}, {wo:?}, {mode:?}: p = {p:e} < {limit:e}",
                    case.name
                );
            }
        }
    }
}

/// The chi-square test notices a density that is off by 10 % on each side.
#[test]
fn chi_square_can_fail() {
    let mut bins = Vec::new();
    for i in 0..100 {
        let tilt = if i < 50 { 1.1 } else { 0.9 };
        bins.push((400.0, 400.0 * tilt));
    }
    assert!(p_value(bins) < 1e-4);
}

/// The map from random numbers to directions has the Jacobian that the density says: summed over
/// the parts (coat and base, reflection and refraction) at one point of the square,
/// `sum of pdf |d wi / d u|` is 1, less the probability of deltas. For mixtures each density is
/// part of the total, so the sum is larger.
#[test]
fn density_is_the_inverse_jacobian() {
    let mut compared = 0;
    // Where the number that chooses moves directions, too, two others alone do not have the density.
    for case in cases().filter(|c| c.sampled != Sampled::Stretched) {
        let values = case.values::<f64>();
        let at = at(Theta::constant(&values));
        let draw = |wo, u| case.material.sample(&at, wo, u, MODES[0]);
        for wo in directions() {
            for i in 0..50 {
                let u: [f64; 2] = Independent::new(11, 0, i).next_2d();
                // Far enough from the edges for finite differences.
                let u = u.map(|u| 0.01 + 0.98 * u);
                // One choice for each part of the material: what differs in its direction.
                let choices = (0..=32).map(|k| (f64::from(k) / 32.0).min(1.0 - 1e-12));
                let mut parts = Vec::<(f64, BsdfSample<f64>)>::new();
                let mut whole = true;
                for u0 in choices {
                    match draw(wo, [u0, u[0], u[1]]) {
                        Some(s) if parts.iter().all(|(_, t)| (s.wi - t.wi).length() > 1e-9) => {
                            parts.push((u0, s));
                        }
                        Some(_) => {}
                        None => whole = false,
                    }
                }
                if !whole {
                    continue;
                }
                let mut total = 0.0;
                for (u0, s) in &parts {
                    if s.component != Component::Continuous {
                        total += s.pdf;
                        continue;
                    }
                    let h = 1e-5;
                    let difference = |a, b| {
                        let plus = draw(wo, [*u0, u[0] + a, u[1] + b])?.wi;
                        Some((plus - draw(wo, [*u0, u[0] - a, u[1] - b])?.wi) / (2.0 * h))
                    };
                    let (Some(du), Some(dv)) = (difference(h, 0.0), difference(0.0, h)) else {
                        total = f64::NAN;
                        break;
                    };
                    total += s.pdf * du.cross(dv).length();
                }
                if total.is_nan() {
                    continue;
                }
                compared += 1;
                let off = total - 1.0;
                let wrong = match case.sampled {
                    Sampled::AsMixture => off < -1e-4,
                    _ => off.abs() > 1e-4,
                };
                assert!(!wrong, "{}, {wo:?}, u = {u:?}: {total}", case.name);
            }
        }
    }
    assert!(compared > 1000, "{compared}");
}

/// `sample`, `pdf` and `choice_pdf` agree to the last bit, in both precisions, whatever the roughness and however
/// grazing (Mitsuba 3 disagrees with itself by a factor of 15 at alpha 1e-4).
#[test]
fn sampled_and_evaluated_densities_are_identical() {
    fn check<P: Float>(case: &Case, n: &mut u32) {
        let mut values = case.values::<P>();
        for alpha in [1e-4, 1e-3, 1e-2, 0.1, 1.0] {
            set_alpha(case, &mut values, alpha);
            let at = at(Theta::constant(&values));
            for z in [1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-6, -0.5, -1e-4] {
                let wo = polar(z, 0.3).map(P::of);
                for i in 0..100 {
                    let u = Independent::new(3, 0, i).next_3d();
                    let Some(s) = case.material.sample(&at, wo, u, MODES[0]) else {
                        continue;
                    };
                    let (wo_d, wi_d) = (Vec3::lift(wo), Vec3::lift(s.wi));
                    let chosen: Dual<P, 1> =
                        (case.material).choice_pdf(&at.lift(), wo_d, wi_d, s.component, MODES[0]);
                    assert!(s.pdf == chosen.re, "{} {alpha} {z}", case.name);
                    if s.component == Component::Continuous {
                        let (f, pdf) = case.material.eval_pdf(&at, wo, s.wi, MODES[0]);
                        assert!(s.pdf == pdf, "{} {alpha} {z}: {} {pdf}", case.name, s.pdf);
                        assert!(pdf > P::zero() && f.is_finite());
                        *n += 1;
                    }
                }
            }
        }
    }
    let mut n = 0;
    for case in cases() {
        check::<f32>(&case, &mut n);
        check::<f64>(&case, &mut n);
    }
    assert!(n > 20_000, "{n}");
}

fn set_alpha<P: Float>(case: &Case, values: &mut [P], alpha: f64) {
    for info in case.params.infos() {
        if info.name.ends_with("alpha.value") {
            values[info.offset] = P::of(alpha);
        }
    }
}

/// What says that nothing passes to the other side is right: `twosided` relies on it.
#[test]
fn opaque_materials_keep_light_on_their_side() {
    let mut opaque = 0;
    for case in cases() {
        let values = case.values::<f64>();
        let at = at(Theta::constant(&values));
        let passes = (0..4000).any(|i| {
            let [z, a, u, v, w]: [f64; 5] = {
                let mut s = Independent::new(6, 0, i);
                std::array::from_fn(|_| s.next_1d())
            };
            let wo = polar(2.0 * z - 1.0, 6.0 * a);
            let sample = (case.material).sample(&at, wo, [u, v, w], TransportMode::Radiance);
            sample.is_some_and(|s| {
                let (mode, to) = (TransportMode::Radiance, s.component);
                let f = case.material.eval_component(&at, wo, s.wi, to, mode);
                s.wi.z * wo.z < 0.0 && f.max_component() > 0.0
            })
        });
        assert_eq!(case.material.is_opaque(), !passes, "{}", case.name);
        opaque += u32::from(!passes);
    }
    assert!(opaque > 10, "{opaque}");
}

// ---- Energy and symmetry ------------------------------------------------------------------------

/// All light that arrives from one direction: `sum of f cos / pdf` over scattered directions, with
/// its standard error, brightest channel.
fn albedo(case: &Case, w: Vec3<f64>, values: &[f64]) -> (f64, f64) {
    let at = at(Theta::constant(values));
    let n = 128u64;
    let (mut sum, mut square) = (0.0, 0.0);
    for i in 0..n * n {
        let jitter: [f64; 3] = Independent::new(17, 0, i).next_3d();
        let stratum = [(i % n) as f64, (i / n) as f64].map(|x| x / n as f64);
        let u = [
            jitter[0],
            stratum[0] + jitter[1] / n as f64,
            stratum[1] + jitter[2] / n as f64,
        ];
        let Some(s) = case.material.sample(&at, w, u, TransportMode::Importance) else {
            continue;
        };
        let f = case
            .material
            .eval_component(&at, w, s.wi, s.component, TransportMode::Importance);
        let weight = f.max_component() / s.pdf;
        sum += weight;
        square += weight * weight;
    }
    let n = (n * n) as f64;
    let mean = sum / n;
    (mean, ((square / n - mean * mean).max(0.0) / n).sqrt())
}

/// No material scatters more light than arrives (errata Z-2.15: fixed incident direction, sum over
/// outgoing ones); significance 1e-3 over 400 comparisons.
/// Rough plastic is a model whose table is exact to 3e-3.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn white_furnace_gains_nothing() {
    // Blinn-Phong and hair conserve energy for fixed outgoing directions only (errata S-C2); what is principled does not
    // promise it.
    let may_gain = |c: &Case| {
        let named = |part| c.name.contains(part);
        named("blinn-phong") || named("hair") || c.name.starts_with("principled")
    };
    for case in cases().filter(|c| !may_gain(c)) {
        let mut values = vec![1.0; case.params.values().len()];
        for info in case.params.infos() {
            // Reflectances are white; indices stay.
            if info.valid.1 != 1.0 {
                let own = case.values::<f64>();
                values[info.range()].copy_from_slice(&own[info.range()]);
            }
        }
        for alpha in [1e-4, 0.05, 0.3, 1.0] {
            set_alpha(&case, &mut values, alpha);
            for z in [1.0, 0.7, 0.2, 0.01, -0.9, -0.1] {
                let (a, se) = albedo(&case, polar(z, 0.5), &values);
                assert!(
                    a <= 1.0 + z_limit(400, 128 * 128, 1e-3) * se + 1e-9,
                    "{} {alpha} {z}: {a} +- {se}",
                    case.name
                );
            }
        }
    }
}

/// At alpha 1e-4 nothing is lost, except at grazing angles.
#[test]
fn almost_smooth_surfaces_lose_nothing() {
    for case in cases().filter(|c| ["ggx .3", "rough glass ggx .3"].contains(&c.name)) {
        let mut values = case.values::<f64>();
        set_alpha(&case, &mut values, 1e-4);
        for z in [0.9, 0.3] {
            let (a, _) = albedo(&case, polar(z, 0.5), &values);
            assert!((a - 1.0).abs() < 1e-3, "{}: {a}", case.name);
        }
    }
}

/// What the coat of a white base sends back, the base sends up again, whichever side of the coat is denser; significance
/// 1e-3 over 10 comparisons.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn white_plastic_loses_nothing() {
    let plastic = |c: &Case| ["plastic", "plastic in water"].contains(&c.name);
    let cases: Vec<_> = cases().filter(plastic).collect();
    assert_eq!(cases.len(), 2);
    for case in cases {
        let values = vec![1.0; case.params.values().len()];
        for z in [1.0, 0.7, 0.5, 0.2, 0.01] {
            let (a, se) = albedo(&case, polar(z, 0.5), &values);
            let limit = z_limit(10, 128 * 128, 1e-3) * se + 1e-5;
            assert!((a - 1.0).abs() < limit, "{} {z}: {a} +- {se}", case.name);
        }
    }
}

/// The value for importance is that for radiance with the directions exchanged [Veach 1996]: with
/// the scaling at refraction this is `f(i -> o) / eta_o^2 = f(o -> i) / eta_i^2`.
#[test]
fn modes_are_adjoint_to_each_other() {
    let mut compared = 0;
    for case in cases() {
        let values = case.values::<f64>();
        let at = at(Theta::constant(&values));
        for i in 0..400 {
            let [a, b, c, d]: [f64; 4] = {
                let mut s = Independent::new(5, 0, i);
                std::array::from_fn(|_| s.next_1d())
            };
            let (wo, wi) = (polar(2.0 * a - 1.0, 6.0 * b), polar(2.0 * c - 1.0, 6.0 * d));
            let f = case.material.eval(&at, wo, wi, TransportMode::Importance);
            let g = case.material.eval(&at, wi, wo, TransportMode::Radiance);
            for (f, g) in f.to_array().into_iter().zip(g.to_array()) {
                let (f, g) = (f / wi.z.abs(), g / wo.z.abs());
                assert!(
                    (f - g).abs() <= 1e-11 * f.abs().max(g.abs()),
                    "{}: {f} {g}",
                    case.name
                );
                compared += u32::from(f > 1e-6);
            }
        }
    }
    assert!(compared > 1000, "{compared}");
}

// ---- Derivatives --------------------------------------------------------------------------------

/// Where densities are among the [`outputs`].
const DENSITIES: [usize; 2] = [0, 16];
/// Where outputs of a sampled direction begin.
const DRAWN: usize = 13;

/// Everything a material computes at one configuration.
fn outputs<R: Real>(
    case: &Case,
    theta: Theta<'_, R>,
    wo: Vec3<R>,
    wi: Vec3<R>,
    u: [R::Primal; 3],
    mode: TransportMode,
) -> Vec<R> {
    let at = at(theta);
    let (f, pdf) = case.material.eval_pdf(&at, wo, wi, mode);
    let mut out = vec![pdf];
    out.extend(f.to_array());
    for kind in DELTAS {
        out.extend(
            case.material
                .eval_delta(&at, wo, wi, kind, 0, mode)
                .to_array(),
        );
    }
    if let Some(s) = case.material.sample(&at, wo, u, mode) {
        out.extend([s.wi.x, s.wi.y, s.wi.z, s.pdf]);
        let f = case
            .material
            .eval_component(&at, wo, s.wi, s.component, mode);
        out.extend(f.to_array());
    }
    out
}

/// `wo`, `wi`, random numbers, mode.
type Configuration = (Vec3<f64>, Vec3<f64>, [f64; 3], TransportMode);

/// Configurations for derivative tests: pairs of directions that scatter well, and random numbers.
fn configurations(case: &Case, n: u64) -> Vec<Configuration> {
    let values = case.values::<f64>();
    let at = at(Theta::constant(&values));
    (0..n)
        .map(|i| {
            let mut s = Independent::new(23, 0, i);
            let [a, b]: [f64; 2] = s.next_2d();
            let wo = polar((0.05 + 0.9 * a).copysign(b - 0.4), 6.0 * b);
            let mode = MODES[i as usize % 2];
            // Half of the directions from the material itself, or lobes would be missed.
            let drawn = case.material.sample(&at, wo, s.next_3d(), mode);
            let [c, d]: [f64; 2] = s.next_2d();
            let wi = match drawn {
                Some(drawn) if i % 4 < 2 => drawn.wi,
                _ => polar(2.0 * c - 1.0, 6.0 * d),
            };
            (wo, wi, s.next_3d().map(|u: f64| 0.02 + 0.96 * u), mode)
        })
        .collect()
}

/// Derivatives with respect to every element of every parameter, and all components of both
/// directions, against central differences (f64, relative 1e-6 plus the differences' own error).
#[test]
fn derivatives_agree_with_differences() {
    type D = Dual<f64, 1>;
    let (mut compared, mut nonzero) = (0, 0);
    for case in cases() {
        let values = case.values::<f64>();
        for (wo, wi, u, mode) in configurations(&case, 24) {
            let inputs = values.len() + 6;
            for k in 0..inputs {
                let dual = {
                    let seed = |i: usize, x: f64| D::new(x, [f64::from(u8::from(i == k))]);
                    let tangents: Vec<Tangent<D>> = (case.params.infos().iter())
                        .map(|info| Tangent::Dense(info.range().map(|i| seed(i, 0.0)).collect()))
                        .collect();
                    let theta = Theta::with_tangents(&values, &tangents);
                    let v = |j: usize, w: Vec3<f64>| {
                        Vec3::new(seed(j, w.x), seed(j + 1, w.y), seed(j + 2, w.z))
                    };
                    outputs(
                        &case,
                        theta,
                        v(values.len(), wo),
                        v(values.len() + 3, wi),
                        u,
                        mode,
                    )
                };
                let mut flat: Vec<f64> = values.clone();
                flat.extend(wo.to_array());
                flat.extend(wi.to_array());
                let shifted = |x: f64, output: usize| {
                    let mut flat = flat.clone();
                    flat[k] = x;
                    let n = values.len();
                    let wo = Vec3::new(flat[n], flat[n + 1], flat[n + 2]);
                    let wi = Vec3::new(flat[n + 3], flat[n + 4], flat[n + 5]);
                    let out = outputs(&case, Theta::constant(&flat[..n]), wo, wi, u, mode);
                    out.get(output).copied().unwrap_or(f64::NAN)
                };
                for (o, d) in dual.iter().enumerate() {
                    if case.sampled != Sampled::Once && DENSITIES.contains(&o) {
                        continue;
                    }
                    // `bsdf::hair` compares its samples itself.
                    if case.sampled == Sampled::Stretched && o >= DRAWN {
                        continue;
                    }
                    let fd = central_difference(
                        |x| shifted(x, o),
                        flat[k],
                        1e-3 * flat[k].abs().max(0.02),
                    );
                    let scale = d.eps[0].abs().max(fd.value.abs()).max(1e-6 * d.re.abs());
                    let allowed = 1e-6 * scale + 10.0 * fd.error + 1e-12;
                    assert!(
                        (d.eps[0] - fd.value).abs() <= allowed,
                        "{}, input {k}, output {o}, wo {wo:?}, wi {wi:?}, u {u:?}: {:e} against {:e} +- {:e}",
                        case.name,
                        d.eps[0],
                        fd.value,
                        fd.error
                    );
                    compared += 1;
                    nonzero += u32::from(d.eps[0] != 0.0);
                }
            }
        }
    }
    assert!(compared > 20_000 && nonzero > 5_000, "{compared} {nonzero}");
}

/// Values over densities with all that is shared cancelled, against their quotient: derivatives with respect to every
/// parameter and `wo` (f64, relative 1e-9). `None` exactly together.
#[test]
fn weights_are_values_over_densities() {
    type D = Dual<f64, 16>;
    let mut compared = 0;
    for case in cases() {
        let values = case.values::<f64>();
        assert!(values.len() + 3 <= 16);
        let tangents: Vec<Tangent<D>> = (case.params.infos().iter())
            .map(|info| Tangent::Dense(info.range().map(|i| D::var(0.0, i)).collect()))
            .collect();
        let at = at(Theta::with_tangents(&values, &tangents));
        for (wo, _, u, mode) in configurations(&case, 200) {
            let wo = Vec3::new(
                D::var(wo.x, values.len()),
                D::var(wo.y, values.len() + 1),
                D::var(wo.z, values.len() + 2),
            );
            let weight = case.material.sample_weight(&at, wo, u, mode);
            let sample = case.material.sample_eval(&at, wo, u, mode);
            assert_eq!(weight.is_some(), sample.is_some(), "{} {wo:?}", case.name);
            let (Some((wi, weight)), Some((sample, f))) = (weight, sample) else {
                continue;
            };
            let expected = f * sample.pdf.recip();
            for (x, y) in (wi.to_array().into_iter().chain(weight.to_array()))
                .zip(sample.wi.to_array().into_iter().chain(expected.to_array()))
            {
                let scale = y.eps.iter().fold(1.0, |m: f64, e| m.max(e.abs()));
                let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * scale;
                assert!(
                    close(x.re, y.re) && x.eps.iter().zip(y.eps).all(|(&a, b)| close(a, b)),
                    "{}, wo {wo:?}, u {u:?}: {x:?} against {y:?}",
                    case.name
                );
            }
            compared += 1;
        }
    }
    assert!(compared > 2_000, "{compared}");
}

/// What `choice_pdf` leaves constant is all that `pdf` differentiates: with every parameter, their derivatives add up to
/// that of the density, and that of a delta's probability is all in the former. Central differences (f64, relative 1e-6
/// plus their own error).
#[test]
fn densities_change_through_choices_and_through_parts() {
    type D = Dual<f64, 1>;
    let (mut deltas, mut mixtures) = (0, 0);
    for case in cases() {
        let values = case.values::<f64>();
        for (wo, wi, u, mode) in configurations(&case, 24) {
            let density = |values: &[f64], component| {
                let at = at(Theta::constant(values));
                match component {
                    Component::Continuous => case.material.eval_pdf(&at, wo, wi, mode).1,
                    Component::Delta { .. } => {
                        let s = case.material.sample(&at, wo, u, mode);
                        s.filter(|s| s.component == component)
                            .map_or(f64::NAN, |s| s.pdf)
                    }
                }
            };
            // Of a direction that another part of a blend has drawn, too.
            for wo in [wo, -wo] {
                let at = at(Theta::constant(&values));
                let pdf = case.material.eval_pdf(&at, wo, wi, mode).1;
                let chosen = (case.material).choice_pdf(&at, wo, wi, Component::Continuous, mode);
                assert!(pdf == chosen, "{} {wo:?} {wi:?}: {pdf} {chosen}", case.name);
            }
            let drawn = (case.material).sample(&at(Theta::constant(&values)), wo, u, mode);
            let delta = drawn.map(|s| s.component);
            let delta = delta.filter(|c| *c != Component::Continuous);
            for component in [Some(Component::Continuous), delta].into_iter().flatten() {
                for k in 0..values.len() {
                    let seed = |i| D::new(0.0, [f64::from(u8::from(i == k))]);
                    let tangents: Vec<Tangent<D>> = (case.params.infos().iter())
                        .map(|info| Tangent::Dense(info.range().map(seed).collect()))
                        .collect();
                    let at = at(Theta::with_tangents(&values, &tangents));
                    let (wo, wi) = (Vec3::lift(wo), Vec3::lift(wi));
                    let choices = case.material.choice_pdf(&at, wo, wi, component, mode).eps[0];
                    let parts = match component {
                        Component::Continuous => case.material.eval_pdf(&at, wo, wi, mode).1.eps[0],
                        Component::Delta { .. } => 0.0,
                    };
                    let fd = central_difference(
                        |x| {
                            let mut values = values.clone();
                            values[k] = x;
                            density(&values, component)
                        },
                        values[k],
                        1e-3 * values[k].abs().max(0.02),
                    );
                    let allowed = 1e-6 * fd.value.abs() + 10.0 * fd.error + 1e-9;
                    assert!(
                        (choices + parts - fd.value).abs() <= allowed,
                        "{}, parameter {k}, {component:?}: {choices:e} + {parts:e}, {:e}",
                        case.name,
                        fd.value
                    );
                    match component {
                        Component::Continuous => mixtures += u32::from(choices != 0.0),
                        Component::Delta { .. } => deltas += u32::from(choices != 0.0),
                    }
                }
            }
        }
    }
    assert!(deltas > 20 && mixtures > 200, "{deltas} {mixtures}");
}

/// Attached sampling, where directions and densities move with the parameters, gives the same
/// derivative of an integral as detached sampling: here of `integral of f cos g dw` with respect to
/// the roughness, for a smooth `g` that vanishes at the horizon. A midpoint rule in the random
/// numbers, exact in the one that chooses; error below 3e-3.
#[test]
fn attached_and_detached_sampling_agree() {
    type D = Dual<f64, 1>;
    let g = |w: Vec3<D>| w.z.square() * (w.x * D::c(0.5) + D::c(1.0));
    let mut compared = 0;
    for case in cases() {
        let mut infos = case.params.infos().iter();
        let Some(alpha) = infos.position(|i| i.name.ends_with("alpha.value")) else {
            continue;
        };
        let mut values = case.values::<f64>();
        set_alpha(&case, &mut values, 0.4);
        let mut tangents = vec![Tangent::None; case.params.infos().len()];
        tangents[alpha] = Tangent::Uniform(D::var(0.0, 0));
        let moving = at(Theta::with_tangents(&values, &tangents));
        let fixed = at(Theta::constant(&values));
        let mode = MODES[0];
        let eta = case
            .params
            .find("m.eta.value")
            .ok()
            .map(|i| values[i.offset]);
        for wo in [polar(0.7, 0.4), polar(-0.6, 2.0)] {
            // At the critical angle, Fresnel's slope is infinite: no quadrature would do.
            if eta.is_some_and(|eta| (eta > 1.0) != (wo.z > 0.0)) {
                continue;
            }
            let n = 150;
            let (mut attached, mut detached) = (0.0, 0.0);
            for i in 0..n * n {
                // Substituted, against the logarithmic singularities at the ends.
                let v = [i % n, i / n].map(|k| (f64::from(k) + 0.5) / f64::from(n));
                let u = v.map(|v| v * v * (3.0 - 2.0 * v));
                let density: f64 = v.iter().map(|v| 6.0 * v * (1.0 - v)).product();
                let draw = |u0| case.material.sample(&fixed, wo, [u0, u[0], u[1]], mode);
                let part = |u0| draw(u0).map(|s| s.wi.to_array());
                // The value of the first number where the other part begins.
                let (mut lo, mut hi) = (0.0, 1.0 - 1e-12);
                let split = part(lo) != part(hi);
                for _ in 0..if split { 40 } else { 0 } {
                    let middle = 0.5 * (lo + hi);
                    if part(middle) == part(0.0) {
                        lo = middle;
                    } else {
                        hi = middle;
                    }
                }
                for (u0, weight) in [(0.0, hi), (1.0 - 1e-12, 1.0 - hi)] {
                    let weight = weight * density;
                    let u = [u0, u[0], u[1]];
                    if let Some(s) = case.material.sample(&moving, Vec3::lift(wo), u, mode) {
                        let f = case.material.eval(&moving, Vec3::lift(wo), s.wi, mode).r;
                        attached += weight * (f * g(s.wi) / s.pdf).eps[0];
                    }
                    if let Some(s) = draw(u0) {
                        let wi = Vec3::lift(s.wi);
                        let f = case.material.eval(&moving, Vec3::lift(wo), wi, mode).r;
                        detached += weight * (f * g(wi)).eps[0] / s.pdf;
                    }
                }
            }
            let (a, d) = (attached / f64::from(n * n), detached / f64::from(n * n));
            assert!((a - d).abs() < 3e-3, "{}, {wo:?}: {a} {d}", case.name);
            compared += u32::from(a.abs() > 0.02);
        }
    }
    assert!(compared >= 8, "{compared}");
}

/// The adjoint of every parameter, pulled back through evaluations, each part of their derivatives, and deltas at
/// once, is the transpose of the forward derivative.
#[test]
fn reverse_is_the_transpose_of_forward() {
    type D = Dual<f64, 1>;
    for case in cases() {
        let values = case.values::<f64>();
        let (mut pulled, mut pushed) = (0.0f64, 0);
        for (i, (wo, wi, _, mode)) in configurations(&case, 40).into_iter().enumerate() {
            let mut s = Independent::new(31, 0, i as u64);
            let parts = [Part::All, Part::Normals, Part::Rest];
            let mut uses = parts.map(|part| (Component::Continuous, part)).to_vec();
            let delta = |&kind| (Component::Delta { kind, route: 0 }, Part::All);
            uses.extend(DELTAS[..2].iter().map(delta));
            let uses: Vec<Use<f64>> = uses
                .into_iter()
                .map(|(component, part)| Use {
                    wi,
                    component,
                    part,
                    d: Rgb::from([s.next_1d(), s.next_1d(), s.next_1d::<f64>() - 0.7]),
                })
                .collect();
            let mut sink = Gradient(vec![0.0; values.len()]);
            let point = at(Theta::constant(&values));
            case.material.backward(&point, wo, &uses, mode, &mut sink);
            for p in case.handles() {
                for k in case.range(p) {
                    let tangents: Vec<Tangent<D>> = (case.params.infos().iter())
                        .map(|info| {
                            let one = |i| D::new(0.0, [f64::from(u8::from(i == k))]);
                            Tangent::Dense(info.range().map(one).collect())
                        })
                        .collect();
                    let at = at(Theta::with_tangents(&values, &tangents));
                    let forward: f64 = uses
                        .iter()
                        .map(|u| {
                            let (moving_wo, wi) = (Vec3::lift(wo), Vec3::lift(u.wi));
                            let all = || {
                                let m = &case.material;
                                m.eval_component(&at, moving_wo, wi, u.component, mode)
                            };
                            let normals = || case.material.eval_normals(&at, wo, u.wi, mode);
                            let f = match u.part {
                                Part::All => all(),
                                Part::Normals => normals(),
                                Part::Rest => all() - normals(),
                            };
                            f.r.eps[0] * u.d.r + f.g.eps[0] * u.d.g + f.b.eps[0] * u.d.b
                        })
                        .sum();
                    let gap = (forward - sink.0[k]).abs();
                    assert!(
                        gap <= 1e-12 * forward.abs().max(1.0),
                        "{}, parameter {k}: {forward:e} and {:e}",
                        case.name,
                        sink.0[k]
                    );
                    pulled = pulled.max(forward.abs());
                    pushed += 1;
                }
            }
        }
        assert!(pushed == 0 || pulled > 1e-3, "{}", case.name);
    }
}

// ---- Finiteness ---------------------------------------------------------------------------------

/// Values, densities, samples and all their derivatives are finite for any roughness in range and any
/// direction: exactly normal, exactly grazing, almost so, equal, opposite, mirrored; and for the
/// extreme random numbers (F31, F43).
#[test]
fn everything_is_finite_everywhere() {
    fn check<P: Float>(case: &Case, last: f64) {
        type D<P> = Dual<P, 10>;
        let mut values = case.values::<P>();
        let tangents: Vec<Tangent<D<P>>> = (0..case.params.infos().len())
            .map(|i| Tangent::Uniform(D::var(P::zero(), i)))
            .collect();
        let mut directions: Vec<Vec3<P>> = Vec::new();
        for z in [1.0, 1.0 - 1e-7, 0.5, 1e-3, 1e-6, 1e-12, 1e-30, 0.0] {
            for phi in [0.0, 2.0, PI] {
                let w = polar(z, phi).map(P::of);
                directions.extend([w, Vec3::new(w.x, w.y, -w.z)]);
            }
        }
        for alpha in [1e-4, 1e-2, 1.0] {
            set_alpha(case, &mut values, alpha);
            let theta = Theta::with_tangents(&values, &tangents);
            let point = at(theta);
            let plain = at(Theta::constant(&values));
            for &wo in &directions {
                let dual = |w: Vec3<P>, i| {
                    Vec3::new(D::var(w.x, i), D::var(w.y, i + 1), D::var(w.z, i + 2))
                };
                let look_at = |wi: Vec3<P>, mode| {
                    let (f, pdf) = case
                        .material
                        .eval_pdf(&point, dual(wo, 4), dual(wi, 7), mode);
                    assert!(
                        f.is_finite() && pdf.is_finite() && pdf.re >= P::zero(),
                        "{}, alpha {alpha}, wo {wo:?}, wi {wi:?}: {f:?} {pdf:?}",
                        case.name
                    );
                    let (f, pdf) = case.material.eval_pdf(&plain, wo, wi, mode);
                    assert!(f.is_finite() && pdf.is_finite());
                };
                for mode in MODES {
                    for &wi in &directions {
                        look_at(wi, mode);
                    }
                    for kind in DELTAS {
                        let (wo, wi) = (dual(wo, 4), dual(directions[0], 7));
                        let f = case.material.eval_delta(&point, wo, wi, kind, 0, mode);
                        assert!(f.is_finite(), "{}, wo {wo:?}: {f:?}", case.name);
                    }
                    for i in 0..64 {
                        let corner = |k: u32| [0.0, 0.25, 0.5, last][(i >> (2 * k) & 3) as usize];
                        let u = [corner(0), corner(1), corner(2)].map(P::of);
                        let s: Option<BsdfSample<D<P>>> =
                            case.material.sample(&point, dual(wo, 4), u, mode);
                        let Some(s) = s else { continue };
                        assert!(
                            s.wi.is_finite() && s.pdf.is_finite() && s.pdf.re > P::zero(),
                            "{}, alpha {alpha}, wo {wo:?}, u {u:?}: {s:?}",
                            case.name
                        );
                        look_at(s.wi.primal(), mode);
                        let weight = case.material.sample_weight(&point, dual(wo, 4), u, mode);
                        let (_, weight) = weight.expect("what is sampled has a weight");
                        assert!(weight.is_finite(), "{}, wo {wo:?}: {weight:?}", case.name);
                    }
                }
            }
        }
    }
    for case in cases() {
        check::<f32>(&case, 1.0 - f64::powi(2.0, -24));
        check::<f64>(&case, 1.0 - f64::powi(2.0, -53));
    }
}
