//! The Blinn-Phong material: density, energy, derivatives, and numbers at the edge of the valid range.

use std::f64::consts::PI;

use ad_core::{Const, Dual, Real, Vec3};
use render::bsdf::{BlinnPhongLobe, BlinnPhongSampling, Lobe, TransportMode};
use render::math::Rgb;
use render::sampler::{Independent, Sampler};
use render::statistics::{p_value, sidak, z_limit};

const MODE: TransportMode = TransportMode::Radiance;

fn lobe<R: Real>(diffuse: f64, specular: f64, exponent: R) -> BlinnPhongLobe<R> {
    let sampling = BlinnPhongSampling::Importance;
    let grey = |v| Rgb::splat(R::of(v));
    BlinnPhongLobe::new(grey(diffuse), grey(specular), exponent, sampling)
}

fn direction(theta: f64, phi: f64) -> Vec3<f64> {
    Vec3::new(
        theta.sin() * phi.cos(),
        theta.sin() * phi.sin(),
        theta.cos(),
    )
}

/// Integral over the upper hemisphere by the midpoint rule in `(cos^2, phi)`, fine near the pole.
fn hemisphere(mut f: impl FnMut(Vec3<f64>) -> f64) -> f64 {
    let (n, m) = (1500, 360);
    let mut sum = 0.0;
    for i in 0..n {
        // theta = pi/2 x^2: points gather at the pole.
        let x = (f64::from(i) + 0.5) / f64::from(n);
        let theta = PI / 2.0 * x * x;
        for j in 0..m {
            let phi = 2.0 * PI * (f64::from(j) + 0.5) / f64::from(m);
            sum += f(direction(theta, phi)) * theta.sin() * x;
        }
    }
    sum * PI / f64::from(n) * 2.0 * PI / f64::from(m)
}

/// Chi-square test of sampled directions against the density, over 20 x 20 cells and the lost mass, for eight
/// configurations; significance 0.01 over all.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn samples_follow_the_density() {
    let (n, cells, fine) = (200_000u64, 20usize, 12usize);
    let cases: Vec<(f64, f64)> = [0.0, 5.0, 50.0, 500.0]
        .into_iter()
        .flat_map(|e| [(e, 0.3), (e, 1.2)])
        .collect();
    let least = sidak(cases.len(), 0.01);
    for (case, &(exponent, theta_o)) in cases.iter().enumerate() {
        let lobe = lobe(0.3, 0.5, exponent);
        let wo = direction(theta_o, 0.4);
        let mut counts = vec![0.0; cells * cells + 1];
        let cell = |x: f64| ((x * cells as f64) as usize).min(cells - 1);
        for i in 0..n {
            let mut sampler = Independent::new(2, case as u64, i);
            let at = match lobe.sample(wo, sampler.next_3d(), MODE) {
                None => cells * cells,
                Some(s) => {
                    let phi = s.wi.y.atan2(s.wi.x) / (2.0 * PI) + 0.5;
                    cell(s.wi.z) * cells + cell(phi)
                }
            };
            counts[at] += 1.0;
        }
        // Uniform in cos and phi: midpoint rule within each cell, normalised to what is not lost.
        let mut expected = vec![0.0; cells * cells];
        let steps = cells * fine;
        for i in 0..steps {
            for j in 0..steps {
                let cos = (i as f64 + 0.5) / steps as f64;
                let phi = ((j as f64 + 0.5) / steps as f64 - 0.5) * 2.0 * PI;
                let p = lobe.pdf(wo, direction(cos.acos(), phi), MODE);
                expected[i / fine * cells + j / fine] +=
                    p * n as f64 * 2.0 * PI / (steps * steps) as f64;
            }
        }
        let lost = n as f64 - expected.iter().sum::<f64>();
        assert!(
            lost > -1e-3 * n as f64,
            "mass {lost} at {exponent}, {theta_o}"
        );
        expected.push(lost.max(0.0));
        let p = p_value(counts.into_iter().zip(expected));
        assert!(p > least, "exponent {exponent}, angle {theta_o}: p = {p:e}");
    }
}

/// The density of normals has mean cosine (e + 2) / (e + 3), significance 1e-3 over four exponents (errata S-B2).
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn sampled_normals_have_the_right_mean() {
    let n = 100_000;
    for exponent in [0.0, 5.0, 50.0, 500.0] {
        let lobe = lobe(0.3, 0.5, exponent);
        let cosines = (0..n).map(|i| lobe.sample_normal(Independent::new(3, 0, i).next_2d()).z);
        let (sum, squares) = cosines.fold((0.0, 0.0), |(s, q), c: f64| (s + c, q + c * c));
        let mean = sum / n as f64;
        let error = ((squares / n as f64 - mean * mean) / n as f64).sqrt();
        let expected = (exponent + 2.0) / (exponent + 3.0);
        assert!(
            (mean - expected).abs() < z_limit(4, n, 1e-3) * error,
            "{exponent}: {mean} {expected}"
        );
    }
}

/// What microfacets reflect at a fixed `wo` is what they were sampled with: at most 1, and the
/// values of errata S-C2 for exponent 10.
#[test]
fn microfacets_conserve_energy_for_a_fixed_view() {
    for exponent in [0.0, 10.0, 100.0] {
        for theta_o in [0.0, 0.8, 1.4] {
            let wo = direction(theta_o, 0.0);
            let white = lobe(0.0, 1.0, exponent);
            let albedo = hemisphere(|wi| white.eval(wo, wi, MODE).r);
            assert!(
                albedo > 0.3 && albedo < 1.0 + 1e-3,
                "{exponent} {theta_o}: {albedo}"
            );
        }
    }
    let white = lobe(0.0, 1.0, 10.0);
    let wi = direction(80f64.to_radians(), 0.0);
    let gain = hemisphere(|wo| white.eval(wo, wi, MODE).r / wi.z * wo.z);
    assert!((gain - 1.50).abs() < 0.01, "fixed light direction: {gain}");
}

/// f*(i -> o) = f(o -> i), and it is not symmetric.
#[test]
fn importance_is_the_adjoint() {
    let lobe = lobe(0.2, 0.6, 20.0);
    let (a, b) = (direction(0.4, 0.3), direction(1.1, 2.0));
    let radiance = lobe.eval(a, b, MODE).r / b.z;
    let importance = lobe.eval(b, a, TransportMode::Importance).r / a.z;
    assert!((radiance - importance).abs() < 1e-14);
    assert!((radiance / (lobe.eval(b, a, MODE).r / a.z) - 1.0).abs() > 0.1);
}

/// Derivatives in exponent and directions against central differences, and the closed form in the
/// exponent.
#[test]
fn derivatives() {
    let (wo, wi, e, h) = (direction(0.5, 0.2), direction(0.7, 2.9), 17.0, 1e-5);
    let value = |e: f64, x: f64| {
        lobe(0.2, 0.6, e)
            .eval(wo, wi + Vec3::new(x, -x, 0.5 * x), MODE)
            .r
    };
    let dual = |e: Dual<f64, 2>, x: Dual<f64, 2>| {
        let step = Vec3::new(x, -x, x * Const(0.5));
        lobe(0.2, 0.6, e)
            .eval(Vec3::lift(wo), Vec3::lift(wi) + step, MODE)
            .r
    };
    let d = dual(Dual::var(e, 0), Dual::var(0.0, 1));
    let fd = [
        (value(e + h, 0.0) - value(e - h, 0.0)) / (2.0 * h),
        (value(e, h) - value(e, -h)) / (2.0 * h),
    ];
    for (ad, fd) in d.eps.iter().zip(fd) {
        assert!((ad / fd - 1.0).abs() < 1e-7, "{ad} {fd}");
    }
    let cos = (wo + wi).normalize().z;
    let specular = 0.6 * lobe(0.2, 0.6, e).microfacet_pdf(wo, wi);
    let closed = specular * (1.0 / (e + 2.0) + cos.ln());
    assert!((d.eps[0] / closed - 1.0).abs() < 1e-12);
}

/// Attached sampling moves with the exponent as differences say, and its weight stays 1: the density
/// of a sample times the Jacobian does not depend on the exponent.
#[test]
fn samples_move_with_the_exponent() {
    let (wo, u, h) = (direction(0.6, 1.0), [0.1, 0.37, 0.81], 1e-5);
    let at = |e: f64| lobe(0.0, 1.0, e).sample(wo, u, MODE).map(|s| s.wi);
    let sample = lobe(0.0, 1.0, Dual::<f64, 1>::var(30.0, 0)).sample(Vec3::lift(wo), u, MODE);
    let (Some(sample), Some(up), Some(down)) = (sample, at(30.0 + h), at(30.0 - h)) else {
        panic!("a direction above the horizon was expected");
    };
    for k in 0..3 {
        let fd = (up[k] - down[k]) / (2.0 * h);
        assert!(
            (sample.wi[k].eps[0] - fd).abs() < 1e-8,
            "{k}: {} {fd}",
            sample.wi[k].eps[0]
        );
    }
}

/// No value or derivative is NaN or infinite, up to the ends of the valid range.
#[test]
fn everything_is_finite() {
    let cosines = [0.0, 1e-30, 6e-8, 1.3e-7, 1e-4, 0.5, 1.0f32];
    let wise = |c: f32, phi: f32| {
        let s = (1.0 - c * c).sqrt();
        Vec3::new(s * phi.cos(), s * phi.sin(), c)
    };
    type D = Dual<f32, 3>;
    for exponent in [0.0, 1.0, 1e3, 1e6f32] {
        for (d, s) in [(0.0, 0.0), (0.5, 0.0), (0.0, 1.0), (0.5, 0.5)] {
            let grey = |v: f32, k| Rgb::splat(D::var(v, k));
            for sampling in [BlinnPhongSampling::Importance, BlinnPhongSampling::Cosine] {
                let lobe =
                    BlinnPhongLobe::new(grey(d, 0), grey(s, 1), D::var(exponent, 2), sampling);
                for &co in &cosines {
                    let wo = Vec3::lift(wise(co, 0.0));
                    for &ci in &cosines {
                        for phi in [0.0, 1.0, std::f32::consts::PI] {
                            for mode in [MODE, TransportMode::Importance] {
                                let (f, p) = lobe.eval_pdf(wo, Vec3::lift(wise(ci, phi)), mode);
                                let ok = f.is_finite() && p.is_finite() && p.re >= 0.0;
                                assert!(ok, "{exponent} {d} {s} {co} {ci} {phi}: {f:?} {p:?}");
                            }
                        }
                    }
                    for u in [0.0, 0.3, 1.0 - f32::EPSILON / 2.0] {
                        for v in [0.0, 0.4, 1.0 - f32::EPSILON / 2.0] {
                            if let Some(s) = lobe.sample(wo, [v, u, v], MODE) {
                                let ok = s.wi.is_finite() && s.pdf.is_finite() && s.pdf.re > 0.0;
                                assert!(ok, "{exponent} {d} {co} {u} {v}: {s:?}");
                            }
                        }
                    }
                }
            }
        }
    }
}
