//! [Stam 2020, appendix C]: the Blinn-Phong BRDF, its sample weight and its exponent gradient, as printed
//! and as corrected.

use std::f64::consts::{PI, TAU};

use ad_core::{Dual, Real, Vec3};
use render::bsdf::{BlinnPhongLobe, BlinnPhongSampling, Lobe, TransportMode};
use render::math::Rgb;
use render::sampler::{Independent, Sampler};
use render::statistics::{Estimate, z_limit};

use super::printed;
use crate::statistics::Moments;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const MODE: TransportMode = TransportMode::Radiance;

/// A purely specular, white surface.
pub fn white<R: Real>(exponent: R) -> BlinnPhongLobe<R> {
    let sampling = BlinnPhongSampling::Importance;
    BlinnPhongLobe::new(Rgb::black(), Rgb::splat(R::one()), exponent, sampling)
}

/// A light in the far distance, as a function of the direction.
#[derive(Clone, Copy, Debug)]
pub enum Light {
    /// `exp(6 (w . d - 1)) w_z^2`: smooth, and dark at the horizon, where attached sampling has no boundary
    /// term to miss (F9).
    Smooth(Vec3<f64>),
    /// 1 on one side of a plane, 0 on the other: a step.
    HalfPlane(Vec3<f64>),
}

impl Light {
    fn radiance<R: Real<Primal = f64>>(self, w: Vec3<R>) -> R {
        match self {
            Self::Smooth(d) => ((w.dot(Vec3::lift(d)) - R::one()) * R::c(6.0)).exp() * w.z * w.z,
            Self::HalfPlane(n) if w.primal().dot(n) > 0.0 => R::one(),
            Self::HalfPlane(_) => R::zero(),
        }
    }
}

/// Integral over normals of `density-weighted g(wi, cos_m)`, by the midpoint rule in `(u, phi)`, where u is
/// the random number that makes the cosine at `exponent`.
fn quadrature(exponent: f64, wo: Vec3<f64>, g: impl Fn(Vec3<f64>, f64) -> f64) -> f64 {
    let (n, m) = (2000, 720);
    let lobe = white(exponent);
    let mut sum = 0.0;
    for i in 0..n {
        for j in 0..m {
            let u = [
                (f64::from(i) + 0.5) / f64::from(n),
                (f64::from(j) + 0.5) / f64::from(m),
            ];
            let normal = lobe.sample_normal(u);
            let cos_mo = normal.dot(wo);
            let wi = normal * (2.0 * cos_mo) - wo;
            if cos_mo > 0.0 && wi.z > 0.0 {
                sum += g(wi, normal.z);
            }
        }
    }
    sum / f64::from(n * m)
}

/// All estimates of the derivative in the exponent of the light reflected by [`white`].
struct Gradients {
    truth: f64,
    detached: Moments,
    attached: Moments,
    truth_printed_weight: f64,
    printed: Moments,
}

fn gradients(exponent: f64, wo: Vec3<f64>, light: Light, n: u64) -> Gradients {
    // At fixed directions: the integrand's own derivative, so a step of the light does not matter.
    let score = |cos: f64| 1.0 / (exponent + 2.0) + cos.ln();
    let truth = quadrature(exponent, wo, |wi, c| light.radiance(wi) * score(c));
    let truth_printed_weight = quadrature(exponent, wo, |wi, c| {
        light.radiance(wi) * printed::weight(c) * score(c)
    });
    let mut out = Gradients {
        truth,
        detached: Moments::default(),
        attached: Moments::default(),
        truth_printed_weight,
        printed: Moments::default(),
    };
    let dual = white(Dual::<f64, 1>::var(exponent, 0));
    let plain = white(exponent);
    for i in 0..n {
        let u: [f64; 2] = Independent::new(11, 0, i).next_2d();
        let m = plain.sample_normal(u);
        let cos_mo = m.dot(wo);
        let wi = m * (2.0 * cos_mo) - wo;
        if cos_mo <= 0.0 || wi.z <= 0.0 {
            out.detached.add(0.0);
            out.attached.add(0.0);
            out.printed.add(0.0);
            continue;
        }
        // Detached: derivative of the value over the constant density.
        let value = dual.eval(Vec3::lift(wo), Vec3::lift(wi), MODE).r;
        let pdf = plain.microfacet_pdf(wo, wi);
        out.detached.add(value.eps[0] / pdf * light.radiance(wi));
        // Attached: the sample moves, its weight stays 1.
        let m = dual.sample_normal(u);
        let wo_d = Vec3::lift(wo);
        let moved = m * (m.dot(wo_d) * Dual::of(2.0)) - wo_d;
        out.attached.add(light.radiance(moved).eps[0]);
        let cos_m = (wo + wi).normalize().z;
        out.printed
            .add(printed::weight_derivative(cos_m, exponent) * light.radiance(wi));
    }
    out
}

/// The view of 0.5 rad, its mirror direction, and a plane close to it.
fn views() -> [Vec3<f64>; 3] {
    let view: f64 = 0.5;
    let wo = Vec3::new(view.sin(), 0.0, view.cos());
    let mirror = Vec3::new(-view.sin(), 0.0, view.cos());
    let edge = Vec3::new(1.0, 0.0, 0.0).cross(mirror).normalize();
    [wo, mirror, (edge + mirror * 0.15).normalize()]
}

/// Whether attached sampling at exponent 20 gives the derivative: statement, outcome and numbers for a
/// smooth light, and for a light with a step, which it must miss without reparameterisation.
pub fn attached_outcomes(n: u64) -> [(&'static str, bool, String); 2] {
    let [wo, mirror, tilted] = views();
    [
        (
            "light smooth and dark at the horizon: attached sampling is the derivative",
            Light::Smooth(mirror),
            true,
        ),
        (
            "light with a step: attached sampling is not",
            Light::HalfPlane(tilted),
            false,
        ),
    ]
    .map(|(statement, light, agrees)| {
        let g = gradients(20.0, wo, light, n);
        let z = g.attached.z(g.truth).abs();
        (
            statement,
            (z < z_limit(1, n, 1e-3)) == agrees,
            text(&g.attached, g.truth),
        )
    })
}

fn text(found: &Moments, truth: f64) -> String {
    let Estimate { mean, se } = found.of_mean();
    format!("{mean:.4e} ± {se:.0e}, true {truth:.4e}")
}

/// Mean sample weight of the printed rule, `E[sin theta_m]`.
pub fn mean_printed_weight(exponent: f64, n: u64) -> f64 {
    let lobe = white(exponent);
    let normal = |i: u64| lobe.sample_normal(Independent::new(14, 0, i).next_2d());
    (0..n).map(|i| printed::weight(normal(i).z)).sum::<f64>() / n as f64
}

/// Normalisation and weight of samples.
fn weight(fig: &mut Figure, n: u64) {
    let mut rows = Vec::new();
    let mut worst = 0.0f64;
    let means = [
        (0.0, 0.667),
        (10.0, 0.341),
        (100.0, 0.123),
        (1e3, 0.0396),
        (1e4, 0.0125),
    ];
    let n = n.min(400_000);
    let limit = z_limit(means.len(), n, 1e-3);
    for (exponent, expected) in means {
        let wo = Vec3::new(0.0, 0.0, 1.0);
        // The integral of D cos over the hemisphere by the midpoint rule, denser at the pole.
        let steps = 20_000;
        let d_cos = (0..steps).map(|i| {
            let x = (f64::from(i) + 0.5) / f64::from(steps);
            let (sin, cos) = (PI / 2.0 * x * x).sin_cos();
            (exponent + 2.0) / TAU * cos.powf(exponent) * cos * TAU * sin * PI * x
        });
        let d_cos: f64 = d_cos.sum::<f64>() / f64::from(steps);
        let mut sine = Moments::default();
        for i in 0..n {
            let m = white(exponent).sample_normal(Independent::new(12, 0, i).next_2d());
            sine.add(printed::weight(m.z));
            let wi = m * (2.0 * m.z) - wo;
            if wi.z > 1e-6 {
                // The density of the normal, by the formula of the text, and dw_i = 4 cos_mo dw_m.
                let p = (exponent + 2.0) / TAU * m.z.powf(exponent + 1.0) / (4.0 * m.z);
                let weight = white(exponent).eval(wo, wi, MODE).r / p;
                worst = worst.max((weight - 1.0).abs());
            }
        }
        fig.check(
            format!("exponent {exponent}: the printed weight darkens the highlight to E[sin theta_m] (errata S-C1)"),
            (sine.mean - expected).abs() < 5e-4 + limit * sine.of_mean().se && (d_cos - 1.0).abs() < 1e-6,
            format!("{:.4}, expected {expected}; integral of D cos is {d_cos:.6}", sine.mean),
        );
        rows.push([exponent, sine.mean, (PI / (2.0 * (exponent + 2.0))).sqrt()]);
    }
    fig.check(
        "corrected, a sample weighs 1 at every exponent",
        worst < 1e-9,
        format!("largest deviation {worst:.1e}"),
    );
    let chart = LineChart::new(
        "Reflectance of a white surface",
        "exponent + 1",
        "mean sample weight",
    )
    .log_x()
    .log_y()
    .measured(
        "printed: E[sin theta_m]",
        rows.iter().map(|r| (r[0] + 1.0, r[1])),
    )
    .dashed(
        "sqrt(pi / (2 (e + 2)))",
        rows.iter().map(|r| (r[0] + 1.0, r[2])),
    )
    .line("corrected: 1", rows.iter().map(|r| (r[0] + 1.0, 1.0)));
    fig.csv(
        "weight",
        &["exponent", "mean_printed_weight", "asymptote"],
        rows,
    );
    fig.chart("weight", &chart);
}

/// The derivative in the exponent.
fn exponent_derivative(fig: &mut Figure, n: u64) {
    let [wo, mirror, tilted] = views();
    // Detached and attached derivatives for two lights.
    let limit = z_limit(4, n, 1e-3);
    let mut rows = Vec::new();
    for exponent in [5.0, 20.0, 80.0] {
        for (name, light) in [
            ("smooth light", Light::Smooth(mirror)),
            ("step light", Light::HalfPlane(tilted)),
        ] {
            let g = gradients(exponent, wo, light, n);
            rows.push([
                exponent,
                f64::from(u8::from(matches!(light, Light::HalfPlane(_)))),
                g.truth,
                g.detached.mean,
                g.attached.mean,
                g.truth_printed_weight,
                g.printed.mean,
            ]);
            if exponent != 20.0 {
                continue;
            }
            fig.check(
                format!("exponent 20, {name}: detached gradient 1/(e+2) + ln cos theta_m is the derivative"),
                g.detached.z(g.truth).abs() < limit,
                text(&g.detached, g.truth),
            );
            let smooth = matches!(light, Light::Smooth(_));
            fig.check(
                if smooth {
                    format!("exponent 20, {name}: attached sampling agrees")
                } else {
                    format!("exponent 20, {name}: attached sampling misses the step (F8)")
                },
                (g.attached.z(g.truth).abs() < limit) == smooth,
                text(&g.attached, g.truth),
            );
            fig.check(
                format!("exponent 20, {name}: the printed update is not the derivative, not even of the printed weight (errata S-C3)"),
                g.printed.z(g.truth_printed_weight).abs() > 10.0 && g.printed.z(g.truth).abs() > 10.0,
                format!(
                    "{:.4e} ± {:.0e}; true {:.4e} with weight sin theta_m, {:.4e} with weight 1",
                    g.printed.mean,
                    g.printed.of_mean().se,
                    g.truth_printed_weight,
                    g.truth
                ),
            );
        }
    }
    let header = [
        "exponent",
        "step_light",
        "true",
        "detached",
        "attached",
        "true_printed_weight",
        "printed",
    ];
    fig.csv("exponent_gradient", &header, rows);
}

/// Numbers at the pole, and symmetry.
fn pole_and_symmetry(fig: &mut Figure) {
    let m = Vec3::new(0.0, 0.0, 1.0f32);
    let at_pole = white(Dual::<f32, 1>::var(20.0, 0))
        .eval(Vec3::lift(m), Vec3::lift(m), MODE)
        .r;
    let relative = at_pole.eps[0] / at_pole.re;
    fig.check(
        "theta_m = 0 gives a finite derivative, 1/(e+2) of the value (errata S-C4)",
        (relative * 22.0 - 1.0).abs() < 1e-5,
        format!("{relative:.6}, expected {:.6}", 1.0 / 22.0),
    );
    let unit = (0..100_000u64).map(|i| {
        let m = white(0.0f32).sample_normal(Independent::new(13, 0, i).next_2d());
        printed::sin_m_of_code(m.to_array())
    });
    let (nan, sum) = unit.fold((0u32, 0.0f64), |(nan, sum), s| {
        (
            nan + u32::from(s.is_nan()),
            if s.is_nan() { sum } else { sum + f64::from(s) },
        )
    });
    fig.check(
        "sqrt(1 - dir_m*dir_m) of the pseudocode is rounding noise (errata S-D1)",
        nan > 0 && sum / 1e5 < 1e-3,
        format!(
            "NaN for {:.1} % of unit vectors, mean {:.1e} otherwise",
            f64::from(nan) / 1e3,
            sum / 1e5
        ),
    );
    let [wo, ..] = views();
    let (a, b) = (wo, Vec3::new(0.3, 0.8, 0.52).normalize());
    let f = |o: Vec3<f64>, i: Vec3<f64>| white(10.0).eval(o, i, MODE).r / i.z;
    let adjoint = white(10.0).eval(b, a, TransportMode::Importance).r / a.z;
    fig.check(
        "the BRDF is not reciprocal; particles use f*(i->o) = f(o->i) (errata S-C2)",
        (f(a, b) / f(b, a) - 1.0).abs() > 0.05 && (adjoint / f(a, b) - 1.0).abs() < 1e-12,
        format!(
            "f(o,i) = {:.5}, f(i,o) = {:.5}, f* = {adjoint:.5}",
            f(a, b),
            f(b, a)
        ),
    );
}

/// `stam-alg-c`.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(200_000u64, 4_000_000);
    fig.note("samples", n);
    fig.note("seed", 11);

    weight(fig, n);
    exponent_derivative(fig, n);
    pole_and_symmetry(fig);
    Ok(())
}
