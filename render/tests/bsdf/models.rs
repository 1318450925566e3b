//! Closed forms, published values and bad descriptions of single models.

use std::f64::consts::PI;

use ad_core::{Dual, Real, Vec3};
use render::bsdf::microfacet::{Microfacet, Ndf};
use render::bsdf::{
    Bsdf, Coat, ConductorLobe, DeltaKind, Lobe, RoughConductorLobe, TransportMode, fresnel,
};
use render::math::Rgb;
use render::params::{Params, Theta};
use render::sampler::{Independent, Sampler};

use super::{MODES, cases, directions};
use crate::common::materials::{at, build, polar};

// ---- Oracles ------------------------------------------------------------------------------------

const NDFS: [Ndf; 2] = [Ndf::Beckmann, Ndf::Ggx];

fn microfacet<R: Real>(kind: Ndf, alpha: R) -> Microfacet<R> {
    Microfacet {
        kind,
        alpha,
        visible: true,
    }
}

fn tilted(theta: f64) -> Vec3<f64> {
    Vec3::new(theta.sin(), 0.0, theta.cos())
}

#[test]
fn fresnel_of_glass() {
    let f = |degrees: f64, eta: f64| fresnel::dielectric(degrees.to_radians().cos(), eta);
    assert!((f(0.0, 1.5).reflect - 0.04).abs() < 1e-15);
    // Brewster: only one polarisation is reflected, and the refracted ray is perpendicular.
    let brewster = f(56.309_932_474_020_2, 1.5);
    let r_s: f64 = (1.0 - 2.25) / (1.0 + 2.25);
    assert!((brewster.reflect - 0.5 * r_s * r_s).abs() < 1e-12);
    assert!((brewster.cos_t - 56.309_932_474_020_2f64.to_radians().sin()).abs() < 1e-12);
    assert!(f(41.81, 1.0 / 1.5).reflect < 1.0 && f(41.811, 1.0 / 1.5).reflect == 1.0);
    for eta in [0.5, 0.75, 1.0, 1.33, 2.4] {
        for i in 1..=100 {
            let f = fresnel::dielectric(f64::from(i) / 100.0, eta);
            assert!((f.reflect + f.transmit - 1.0).abs() < 1e-15);
        }
    }
    // Total internal reflection: one, with zero derivative.
    let total = fresnel::dielectric(Dual::<f64, 2>::var(0.3, 0), Dual::var(0.5, 1));
    assert_eq!((total.reflect.re, total.reflect.eps), (1.0, [0.0; 2]));
    // Grazing, in single precision: what little passes is right to rounding, not 1 - F.
    let (cos, eta) = (1e-6f32, 1.5f32);
    let exact = fresnel::dielectric(f64::from(cos), f64::from(eta)).transmit;
    let single = fresnel::dielectric(cos, eta).transmit;
    assert!((f64::from(single) / exact - 1.0).abs() < 1e-6);
}

/// The average over a diffuse side, against a fine midpoint rule and the identity
/// `1 - inside = (1 - outside) / eta^2`.
#[test]
fn diffuse_fresnel() {
    for eta in [1.1, 1.33, 1.5, 2.4f64] {
        let (outside, inside) = (
            fresnel::dielectric_diffuse(eta),
            fresnel::dielectric_diffuse(1.0 / eta),
        );
        let n = 200_000;
        let sum: f64 = (0..n)
            .map(|i| (f64::from(i) + 0.5) / f64::from(n))
            .map(|mu| 2.0 * mu * fresnel::dielectric(mu, eta).reflect / f64::from(n))
            .sum();
        assert!((outside - sum).abs() < 1e-5, "{eta}: {outside} {sum}");
        assert!(((1.0 - inside) - (1.0 - outside) / (eta * eta)).abs() < 1e-5);
    }
}

/// Against complex arithmetic; and with `k = 0` against a dielectric.
#[test]
fn fresnel_of_metals() {
    type C = (f64, f64);
    fn mul(a: C, b: C) -> C {
        (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0)
    }
    fn ratio(a: C, b: C) -> f64 {
        (a.0 * a.0 + a.1 * a.1) / (b.0 * b.0 + b.1 * b.1)
    }
    fn sqrt(z: C) -> C {
        let (r, phi) = (z.0.hypot(z.1).sqrt(), z.1.atan2(z.0) / 2.0);
        (r * phi.cos(), r * phi.sin())
    }
    for (eta, k) in [
        (0.2, 3.9),
        (1.66, 9.2),
        (1.44, 1.6),
        (0.14, 0.01),
        (3.0, 2.0),
    ] {
        for i in 1..=50 {
            let c = f64::from(i) / 50.0;
            let n2 = mul((eta, k), (eta, k));
            let q = sqrt((n2.0 - 1.0 + c * c, n2.1));
            let r_s = ratio((c - q.0, -q.1), (c + q.0, q.1));
            let p = (n2.0 * c, n2.1 * c);
            let r_p = ratio((p.0 - q.0, p.1 - q.1), (p.0 + q.0, p.1 + q.1));
            let f = fresnel::conductor(c, eta, k);
            assert!((f - 0.5 * (r_s + r_p)).abs() < 1e-14, "{eta} {k} {c}: {f}");
            assert_eq!(f, fresnel::conductor(c, eta, -k));
        }
    }
    for c in [0.01, 0.5, 1.0] {
        for eta in [0.4, 1.0, 1.5] {
            let glass = fresnel::dielectric(c, eta).reflect;
            assert!(
                (fresnel::conductor(c, eta, 0.0) - glass).abs() < 1e-14,
                "{c} {eta}"
            );
        }
        // The default index of scene files reflects everything, exactly.
        assert_eq!(fresnel::conductor(c, 0.0, 1.0), 1.0);
    }
}

/// Metals stay bright up to the largest index that single precision holds, and have derivatives. Against double
/// precision, whose range is far from its end.
#[test]
fn fresnel_of_extreme_metals() {
    for large in [9e5f32, 1.1e6, 4e9, 1e19, 3e38] {
        for (eta, k) in [(large, 0.0), (0.0, large), (large, large), (1.5, large)] {
            for cos in [1e-3f32, 0.3, 1.0] {
                let exact = fresnel::conductor(f64::from(cos), eta.into(), k.into());
                let f = fresnel::conductor(
                    Dual::<f32, 3>::var(cos, 0),
                    Dual::var(eta, 1),
                    Dual::var(k, 2),
                );
                let off = (f64::from(f.re) - exact).abs();
                assert!(off < 1e-5 && exact > 0.99, "{eta} {k} {cos}: {f:?} {exact}");
                assert!(f.eps.iter().all(|x| x.is_finite()), "{eta} {k}: {f:?}");
            }
        }
    }
}

#[test]
fn published_values_of_the_distributions() {
    let near = |a: f64, b: f64, tolerance: f64| {
        assert!((a - b).abs() < tolerance, "{a} instead of {b}");
    };
    let [beckmann, ggx] = NDFS.map(|kind| microfacet(kind, 0.5));
    let up = Vec3::new(0.0, 0.0, 1.0);
    near(beckmann.d(up), 1.27324, 1e-5);
    near(ggx.d(up), 1.27324, 1e-5);
    near(
        beckmann.d(tilted(0.67021)) / ggx.d(tilted(0.67021)),
        1.0,
        1e-4,
    );
    near(beckmann.d(tilted(1.2)), 2.4e-10, 1e-11);
    near(ggx.d(tilted(1.2)), 0.0979, 1e-4);
    near(beckmann.g1(tilted(1.0), up), 0.992509, 1e-6);
    near(ggx.g1(tilted(1.0), up), 0.882056, 1e-6);
    near(beckmann.g1(tilted(1.4), up), 0.707613, 1e-6);
    near(ggx.g1(tilted(1.4), up), 0.491815, 1e-6);
    assert_eq!(ggx.g1(tilted(1.4), -tilted(1.4)), 0.0);
    assert_eq!((beckmann.g1(up, up), ggx.g1(up, up)), (1.0, 1.0));
}

/// `sigma` is the projected area of the facets (weak white furnace): `E[max(w.m, 0) / m.z]` over
/// all normals, by a midpoint rule in the random numbers. At the same time a test of `sample_all`.
#[test]
fn masking_keeps_the_projected_area() {
    for kind in NDFS {
        for alpha in [0.01, 0.1, 0.5, 1.0] {
            let d = microfacet(kind, alpha);
            for theta in [0.0, 0.3, 1.0, 1.4, 1.55] {
                let w = tilted(theta);
                let n = 1000;
                let mut sum = 0.0;
                for i in 0..n * n {
                    let u = [i % n, i / n].map(|k| (f64::from(k) + 0.5) / f64::from(n));
                    // The tail of GGX slopes is heavy: square the distance from its end.
                    let v = 1.0 - u[0];
                    let m = d.sample_all([1.0 - v * v, u[1]]);
                    sum += w.dot(m).max(0.0) / m.z * 2.0 * v;
                }
                let area = sum / f64::from(n * n);
                let sigma = d.sigma(w);
                assert!(
                    (area / sigma - 1.0).abs() < 2e-5,
                    "{kind:?} {alpha} {theta}: {area} {sigma}"
                );
            }
        }
    }
}

/// Visible normals have the density that is claimed, seen through their moments: the means of `m`
/// and of `m.z^2` against quadrature over all normals. Complements the chi-square tests at a
/// roughness too small for a histogram.
#[test]
fn visible_normals_have_the_right_moments() {
    for kind in NDFS {
        for alpha in [1e-3, 0.2, 1.0] {
            let d = microfacet(kind, alpha);
            for z in [1.0, 0.6, 0.1, 1e-3] {
                let w = polar(z, 0.0);
                let (mut sampled, mut exact) = ([0.0; 4], [0.0; 4]);
                let n = 600;
                for i in 0..n * n {
                    let u = [i % n, i / n].map(|k| (f64::from(k) + 0.5) / f64::from(n));
                    // Slopes scaled by the roughness, bounded.
                    let moments = |m: Vec3<f64>| {
                        let (x, y) = (m.x / alpha, m.y / alpha);
                        let r = (x * x + y * y + m.z * m.z).sqrt();
                        [1.0, x / r, (y / r).powi(2), m.z / r]
                    };
                    let a = moments(d.sample_visible(w, u));
                    let v = 1.0 - u[0];
                    let m = d.sample_all([1.0 - v * v, u[1]]);
                    let weight = w.dot(m).max(0.0) / m.z * 2.0 * v / d.sigma(w);
                    let b = moments(m);
                    for k in 0..4 {
                        sampled[k] += a[k] / f64::from(n * n);
                        exact[k] += b[k] * weight / f64::from(n * n);
                    }
                }
                for k in 0..4 {
                    let gap = (sampled[k] - exact[k]).abs();
                    assert!(
                        gap < 3e-4,
                        "{kind:?} {alpha} {z}, moment {k}: {sampled:?} {exact:?}"
                    );
                }
            }
        }
    }
}

/// Slopes of Beckmann are drawn by inverting their CDF: the first random number is recovered from
/// the slope to 1e-5 in single precision, for any angle and roughness.
#[test]
fn beckmann_inversion_is_exact() {
    let d = microfacet(Ndf::Beckmann, 1.0f32);
    for z in [1.0, 0.9, 0.3, 1e-2, 1e-4] {
        let w = polar(z, 0.0);
        for i in 0..20_000u64 {
            let [u]: [f32; 1] = [Independent::new(41, 0, i).next_1d()];
            let m = d.sample_visible(w.map(f32::of), [u, 0.5]);
            // The slope along w, negated: facets tilt towards the viewer.
            let x = -f64::from(m.x) / f64::from(m.z);
            let (c, s) = (z, (1.0 - z * z).sqrt());
            let cdf = |x: f64| 0.5 * (c * (1.0 + Real::erf(x)) + s * (-x * x).exp() / PI.sqrt());
            let total = if s == 0.0 { c } else { cdf(c / s) };
            let back = cdf(x) / total;
            assert!((back - f64::from(u)).abs() < 1e-5, "{z} {u}: {back}");
        }
    }
}

fn rough_mirror<R: Real>(kind: Ndf, alpha: R) -> RoughConductorLobe<R> {
    RoughConductorLobe {
        microfacet: microfacet(kind, alpha),
        facet: ConductorLobe {
            specular_reflectance: Rgb::splat(R::one()),
            index: None,
        },
    }
}

/// Integral over the upper hemisphere of `f`, by a midpoint rule in `(cos theta, phi)`.
fn hemisphere<R: Real>(n: u32, mut f: impl FnMut(Vec3<f64>) -> R) -> R {
    let mut sum = R::zero();
    for i in 0..n {
        for j in 0..2 * n {
            let t = (f64::from(i) + 0.5) / f64::from(n);
            let phi = (f64::from(j) + 0.5) * PI / f64::from(n);
            sum += f(polar(t, phi));
        }
    }
    sum * R::c(PI / f64::from(n * n))
}

#[test]
fn directional_albedo_of_ggx() {
    let expect = [(0.1, 1.4, 0.8906), (0.5, 0.0, 0.6878), (1.0, 1.4, 0.5245)];
    for (alpha, theta, expected) in expect {
        let lobe = rough_mirror(Ndf::Ggx, alpha);
        let a = hemisphere(700, |wi| lobe.eval(tilted(theta), wi, MODES[0]).r);
        assert!((a - expected).abs() < 2e-4, "{alpha} {theta}: {a}");
    }
}

/// The derivative of reflected light with respect to roughness (errata, section 9).
#[test]
fn derivative_of_an_integral_over_roughness() {
    let expect = [(Ndf::Ggx, -1.365277), (Ndf::Beckmann, -1.163722)];
    for (kind, expected) in expect {
        let lobe = rough_mirror(kind, Dual::<f64, 1>::var(0.3, 0));
        let (wo, d) = (tilted(0.7), tilted(-0.7));
        let i = hemisphere(700, |wi| {
            let light = 1.0 + 0.5 * wi.x + 0.8 * (6.0 * (wi.dot(d) - 1.0)).exp();
            lobe.eval(Vec3::lift(wo), Vec3::lift(wi), MODES[0]).r * <Dual<f64, 1>>::c(light)
        });
        assert!((i.eps[0] - expected).abs() < 2e-5, "{kind:?}: {}", i.eps[0]);
    }
}

/// The table of the rough coat: what passes is what an independent sum over directions does not
/// reflect, to 2e-3, on and between nodes; and the smooth limit is Fresnel's.
#[test]
fn rough_coats_pass_what_they_do_not_reflect() {
    for kind in NDFS {
        let coat = Coat::get(kind, 1.5);
        for (alpha, z) in [
            (0.37, 1.0),
            (0.37, 0.4),
            (0.12, 0.25),
            (0.9, 0.05),
            (0.2, 0.7),
        ] {
            let d = microfacet(kind, alpha);
            let wo = polar(z, 0.0);
            let reflected = hemisphere(500, |wi| {
                let m = (wo + wi).normalize();
                let f = fresnel::dielectric(wo.dot(m), 1.5).reflect;
                f * d.d(m) * d.g1(wo, m) * d.g1(wi, m) / (4.0 * z)
            });
            let passed = coat.passes(alpha, 1.5).transmit(z);
            assert!(
                (1.0 - reflected - passed).abs() < 2e-3,
                "{kind:?} {alpha} {z}: {reflected} {passed}"
            );
        }
        let smooth_coat = coat.passes(1e-4, 1.5);
        for z in [1.0, 0.5, 0.1] {
            let smooth = fresnel::dielectric(z, 1.5).transmit;
            assert!(
                (smooth_coat.transmit(z) - smooth).abs() < 2e-3,
                "{kind:?} {z}"
            );
        }
        let inside = fresnel::dielectric_diffuse(1.0 / 1.5);
        assert!(
            (smooth_coat.inside() - inside).abs() < 2e-3,
            "{kind:?}: {inside}"
        );
    }
}

/// Single precision against double on identical inputs, facets drawn from the lobe: relative error
/// of the value below `1e-6 + 3e-7 / alpha` (the half-vector is conditioned like that).
#[test]
fn single_precision_is_enough() {
    for kind in NDFS {
        for alpha in [1e-4f32, 1e-3, 1e-2, 0.1, 1.0] {
            let lobe = rough_mirror(kind, alpha);
            let reference = rough_mirror(kind, f64::from(alpha));
            let mut errors = Vec::new();
            for i in 0..2000 {
                let mut s = Independent::new(7, 0, i);
                let wo = polar(0.1 + 0.9 * s.next_1d::<f64>(), 1.0).map(f32::of);
                let Some(drawn) = lobe.sample(wo, s.next_3d(), MODES[0]) else {
                    continue;
                };
                let wide = |w: Vec3<f32>| w.map(f64::from);
                let exact = reference.eval(wide(wo), wide(drawn.wi), MODES[0]).r;
                let value = f64::from(lobe.eval(wo, drawn.wi, MODES[0]).r);
                errors.push((value / exact - 1.0).abs());
            }
            errors.sort_by(f64::total_cmp);
            let worst = errors[errors.len() * 99 / 100];
            let allowed = 2e-6 + 1e-6 / f64::from(alpha);
            assert!(worst < allowed, "{kind:?} {alpha}: {worst:e} > {allowed:e}");
        }
    }
}

/// Radiance is compressed into the denser medium: 1.5^2 times 0.96 at normal incidence.
#[test]
fn refracted_radiance_is_scaled() {
    let case = cases().find(|c| c.name == "glass").unwrap();
    let values = case.values::<f64>();
    let at = at(Theta::constant(&values));
    // Seen from inside: light arrives from outside and is compressed.
    let wo = Vec3::new(0.0, 0.0, -1.0);
    let weight = |mode| {
        case.material
            .eval_delta(&at, wo, -wo, DeltaKind::Transmission, 0, mode)
            .r
    };
    assert!((weight(TransportMode::Radiance) - 2.16).abs() < 1e-6);
    assert!((weight(TransportMode::Importance) - 0.96).abs() < 1e-6);
    let s = case
        .material
        .sample(&at, tilted(1.0), [0.9, 0.5, 0.5], MODES[0])
        .unwrap();
    assert!((s.wi.x + 1f64.sin() / 1.5).abs() < 1e-7 && s.wi.z < 0.0);
    assert!((s.eta - 1.5).abs() < 1e-6);
}

// ---- Descriptions -------------------------------------------------------------------------------

/// Plugins, what is wrong inside them, and what the message has to name.
const MISTAKES: &[(&str, &str, &str)] = &[
    (
        "roughconductor",
        r#"<float name="alpha" value="-1e-5"/>"#,
        "alpha",
    ),
    (
        "roughconductor",
        r#"<float name="alpha" value="1.5"/>"#,
        "alpha",
    ),
    (
        "roughconductor",
        r#"<string name="distribution" value="phong"/>"#,
        "distribution",
    ),
    (
        "conductor",
        r#"<string name="material" value="Unobtainium"/>"#,
        "material",
    ),
    (
        "conductor",
        r#"<string name="material" value="Au"/><rgb name="k" value="1"/>"#,
        "material",
    ),
    (
        "dielectric",
        r#"<float name="int_ior" value="-1"/>"#,
        "int_ior",
    ),
    (
        "dielectric",
        r#"<string name="int_ior" value="plutonium"/>"#,
        "int_ior",
    ),
    (
        "roughdielectric",
        r#"<float name="int_ior" value="1"/><float name="ext_ior" value="1"/>"#,
        "int_ior",
    ),
    (
        "conductor",
        r#"<rgb name="specular_reflectance" value="1.1"/>"#,
        "specular_reflectance",
    ),
    (
        "roughconductor",
        r#"<float name="roughness" value=".1"/>"#,
        "roughness",
    ),
    (
        "thindielectric",
        r#"<float name="int_ior" value="30"/>"#,
        "int_ior",
    ),
    ("null", r#"<float name="opacity" value=".1"/>"#, "opacity"),
    (
        "mask",
        r#"<rgb name="opacity" value="2"/><bsdf type="diffuse"/>"#,
        "opacity",
    ),
    ("polarizer", "", "polarisation is not there"),
    ("ward", "", "that Mitsuba 3 has no more is not there"),
    ("coating", "", "layers over other materials are not there"),
    (
        "principled",
        r#"<float name="spec_trans" value="1.1"/>"#,
        "spec_trans",
    ),
    (
        "principled",
        r#"<float name="spec_trans" value=".1"/><float name="specular" value="0"/>"#,
        "specular",
    ),
    (
        "twosided",
        r#"<bsdf type="principled"><float name="spec_trans" value=".1"/></bsdf>"#,
        "principled",
    ),
    (
        "principled",
        r#"<float name="anisotropic" value="1.1"/>"#,
        "anisotropic",
    ),
    (
        "principled",
        r#"<float name="spec_tint" value="-.1"/>"#,
        "spec_tint",
    ),
    (
        "principled",
        r#"<float name="sheen" value=".1"/><float name="sheen_tint" value="1.1"/>"#,
        "sheen_tint",
    ),
    (
        "principled",
        r#"<float name="eta" value="1.5"/><float name="specular" value=".1"/>"#,
        "specular",
    ),
    (
        "twosided",
        r#"<bsdf type="principledthin"/>"#,
        "principledthin",
    ),
    (
        "principledthin",
        r#"<float name="diff_trans" value="2.1"/>"#,
        "diff_trans",
    ),
    (
        "principledthin",
        r#"<float name="spec_trans" value="1"/><float name="eta" value="0.9"/>"#,
        "eta",
    ),
    (
        "principledthin",
        r#"<float name="metallic" value="0.1"/>"#,
        "metallic",
    ),
    (
        "dielectric",
        r#"<float name="ext_ior" value="0.01"/>"#,
        "`ext_ior`: expected an index inside between",
    ),
    (
        "roughplastic",
        r#"<float name="ext_ior" value="2"/>"#,
        "`ext_ior`: expected a rough coat denser",
    ),
    (
        "diffuse",
        r#"<bsdf name="reflectance" type="conductor"/>"#,
        "`reflectance`: expected a texture, a colour or a number, found bsdf `conductor`",
    ),
    ("principled", r#"<float name="eta" value="1"/>"#, "eta"),
    (
        "principled",
        r#"<float name="roughness" value="1.5"/>"#,
        "roughness",
    ),
    (
        "roughplastic",
        r#"<float name="alpha_u" value=".1"/><float name="alpha_v" value=".2"/>"#,
        "anisotropic roughness is not there",
    ),
    (
        "roughconductor",
        r#"<float name="alpha_u" value=".1"/>"#,
        "`alpha_v`",
    ),
    (
        "roughconductor",
        r#"<float name="alpha_u" value=".1"/><float name="alpha_v" value="2"/>"#,
        "alpha_v",
    ),
    (
        "roughdielectric",
        r#"<float name="alpha_u" value=".1"/><float name="alpha" value=".2"/>"#,
        "alpha",
    ),
    (
        "hair",
        r#"<rgb name="sigma_a" value="1"/><float name="pheomelanin" value="1"/>"#,
        "`pheomelanin`: expected none beside `sigma_a`",
    ),
    (
        "hair",
        r#"<float name="longitudinal_roughness" value="0"/>"#,
        "longitudinal_roughness",
    ),
    (
        "hair",
        r#"<float name="azimuthal_roughness" value="1.1"/>"#,
        "azimuthal_roughness",
    ),
    (
        "hair",
        r#"<float name="eumelanin" value="-1"/>"#,
        "eumelanin",
    ),
    (
        "hair",
        r#"<float name="scale_tilt" value="91"/>"#,
        "scale_tilt",
    ),
    (
        "hair",
        r#"<float name="ext_ior" value="1.6"/>"#,
        "`ext_ior`: expected a fibre denser",
    ),
    ("twosided", r#"<bsdf type="hair"/>"#, "hair"),
    ("irawan", "", "threads"),
    ("roughconductor_heitz", "", "facets"),
];

/// Mistakes are errors that name the key, not clamps.
#[test]
fn bad_descriptions_are_errors() {
    for (plugin, content, key) in MISTAKES {
        let built = build(plugin, content).map(|_| ());
        let error = built.expect_err(&format!("{plugin} {content}"));
        assert!(error.to_string().contains(key), "{plugin}: {error}");
    }
    // Named indices.
    let (_, params) = build("dielectric", r#"<string name="int_ior" value="water"/>"#).unwrap();
    let eta = params.find("m.eta.value").unwrap();
    assert!((params.values()[eta.offset] - 1.333 / 1.000277).abs() < 1e-6);
}

/// The metals of Mitsuba, but for one whose colour RGB cannot show: finite, and no mirror gains light.
#[test]
fn metals_are_known_by_name() {
    let names = "a-C Ag Al AlAs Au Be Cr CsI Cu Cu2O CuO d-C Hg HgTe Ir K Li MgO Mo Na_palik Nb Ni_palik Rh Se SiC SnTe Ta \
                 Te ThF4 TiC TiN TiO2 VC VN V_palik W";
    let names: Vec<_> = names.split_whitespace().collect();
    assert_eq!(names.len(), 36);
    for name in names {
        let content = format!(r#"<string name="material" value="{name}"/>"#);
        let (material, params) = build("conductor", &content).expect(name);
        let values: Vec<f64> = params.values().iter().map(|&v| v.into()).collect();
        let at = at(Theta::constant(&values));
        let wo = polar(0.8, 1.0);
        let (kind, mode) = (DeltaKind::Reflection, TransportMode::Radiance);
        let f = material.eval_delta(&at, wo, Vec3::new(-wo.x, -wo.y, wo.z), kind, 0, mode);
        let channels = f.to_array();
        assert!(
            channels.iter().all(|f| (0.01..1.0).contains(f)),
            "{name}: {channels:?}"
        );
    }
}

/// A sheet of glass passes and reflects what all internal reflections add up to, from either side.
#[test]
fn thin_glass_adds_up_its_reflections() {
    let content = r#"<float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/>"#;
    let (material, params) = build("thindielectric", content).expect("a material");
    let values: Vec<f64> = params.values().iter().map(|&v| v.into()).collect();
    let at = at(Theta::constant(&values));
    for z in [1.0, 0.6, 0.05, -0.3] {
        let wo = polar(z, 0.3);
        let one = fresnel::dielectric(f64::abs(z), 1.5);
        // r + t r t + t r^3 t + ..
        let (r, t) = (one.reflect, one.transmit);
        let between: f64 = (0..200).map(|k| t * t * r.powi(2 * k + 1)).sum();
        let mode = TransportMode::Importance;
        let reflect = material
            .eval_delta(&at, wo, wo, DeltaKind::Reflection, 0, mode)
            .g;
        let pass = material
            .eval_delta(&at, wo, wo, DeltaKind::Transmission, 0, mode)
            .g;
        assert!((reflect - r - between).abs() < 1e-7, "{z}: {reflect}");
        assert!((reflect + pass - 1.0).abs() < 1e-12);
    }
}

/// A colour where a number is wanted counts as its luminance, and a spectrum that is the same everywhere as a number.
#[test]
fn numbers_may_be_colours() {
    let opacity = |inner: &str| {
        let content = format!("{inner}<bsdf type=\"diffuse\"/>");
        let (_, params) = build("mask", &content).expect("a mask");
        params.values()[params.find("m.opacity.value").expect("an opacity").offset]
    };
    assert_eq!(opacity(r#"<rgb name="opacity" value="0.3"/>"#), 0.3);
    assert_eq!(opacity(r#"<float name="opacity" value="0.3"/>"#), 0.3);
    assert_eq!(
        opacity(r#"<rgb name="opacity" value="0, 1, 0"/>"#),
        0.715_16
    );
    let uniform =
        r#"<texture name="opacity" type="uniform"><float name="value" value="0.3"/></texture>"#;
    assert_eq!(opacity(uniform), 0.3);
}

/// White principled glass is rough glass of the same facets, from both sides and for particles; and its values and samples
/// are finite where colours are black or nothing is glass.
#[test]
fn principled_glass_is_rough_glass() {
    let node = |transmission: &str, base: &str| {
        let content = format!(
            r#"<rgb name="base_color" value="{base}"/><float name="roughness" value=".6"/><float name="eta" value="1.5"/>
            <float name="spec_trans" value="{transmission}"/>"#
        );
        build("principled", &content).expect(&content)
    };
    let (ours, params) = node("1", "1 1 1");
    let (rough, rough_params) = build(
        "roughdielectric",
        r#"<string name="distribution" value="ggx"/><float name="alpha" value=".36"/>
        <float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/>"#,
    )
    .unwrap();
    let numbers = |p: &Params| -> Vec<f64> { p.values().iter().map(|&v| v.into()).collect() };
    let (a, mut b) = (numbers(&params), numbers(&rough_params));
    let offset = |p: &Params, name: &str| {
        let found = p.infos().iter().find(|i| i.name.ends_with(name));
        found.expect(name).offset
    };
    let roughness = a[offset(&params, "roughness.value")];
    b[offset(&rough_params, "alpha.value")] = roughness * roughness;
    let mut lit = 0;
    for wo in directions() {
        for wi in directions().into_iter().chain(directions().map(|w| -w)) {
            for mode in MODES {
                let [f, g] = [(&ours, &a), (&rough, &b)]
                    .map(|(m, v)| m.eval(&at(Theta::constant(v)), wo, wi, mode).to_array());
                for (f, g) in f.into_iter().zip(g) {
                    assert!(
                        (f - g).abs() < 1e-6 * g.abs().max(1e-3),
                        "{wo:?} {wi:?}: {f} {g}"
                    );
                    lit += u32::from(g > 0.0);
                }
            }
        }
    }
    assert!(lit > 60, "{lit}");
    for (transmission, base) in [("1", "0 0 0"), ("1e-30", "1 1 1"), ("1e-30", "0 0 0")] {
        let (m, params) = node(transmission, base);
        let values = numbers(&params);
        let at = at(Theta::constant(&values));
        for (i, wo) in directions().into_iter().enumerate() {
            for k in 0..200 {
                let u = Independent::new(5, i as u64, k).next_3d();
                if let Some(s) = m.sample(&at, wo, u, MODES[0]) {
                    let f = m.eval(&at, wo, s.wi, MODES[0]);
                    assert!(f.is_finite() && s.pdf > 0.0 && s.pdf.is_finite());
                }
            }
        }
    }
}

/// Of the parts of a principled material: what is white, smooth and without reflection is diffuse, a metal is a rough
/// conductor of Schlick's reflectance, and the clear coat's normals are a distribution.
#[test]
fn principled_parts_are_what_they_should() {
    let eval = |content: &str, wo: Vec3<f64>, wi: Vec3<f64>| {
        let (material, params) = build("principled", content).expect(content);
        let values: Vec<f64> = params.values().iter().map(|&v| v.into()).collect();
        let at = at(Theta::constant(&values));
        material.eval(&at, wo, wi, TransportMode::Radiance)
    };
    let (up, wi) = (polar(1.0, 0.0), polar(0.6, 1.0));
    // At normal incidence and exitance, diffuse: Schlick's weights vanish.
    let plain = r#"<rgb name="base_color" value=".5 .3 .2"/><float name="specular" value="0"/>"#;
    let f = eval(plain, up, up).to_array();
    for (f, albedo) in f.into_iter().zip([0.5, 0.3, 0.2]) {
        assert!((f * PI - albedo).abs() < 1e-6);
    }
    let wo = polar(0.7, 4.0);
    let metal = r#"<rgb name="base_color" value=".9 .5 .2"/><float name="metallic" value="1"/>
        <float name="roughness" value=".5"/>"#;
    let mirror = rough_mirror(Ndf::Ggx, 0.25)
        .eval(wo, wi, TransportMode::Radiance)
        .g;
    let m = (wo + wi).normalize();
    let grazing = (1.0 - wo.dot(m)).powi(5);
    for (f, base) in eval(metal, wo, wi)
        .to_array()
        .into_iter()
        .zip([0.9, 0.5, 0.2])
    {
        let expected = mirror * (base + (1.0 - base) * grazing);
        assert!((f / expected - 1.0).abs() < 1e-6, "{f} {expected}");
    }
    // Sheen by itself.
    let cloth = r#"<rgb name="base_color" value="0"/><float name="specular" value="0"/><float name="sheen" value="0.5"/>"#;
    let f = eval(cloth, wo, wi).g;
    assert!((f / (0.5 * grazing * wi.z) - 1.0).abs() < 1e-6);
    // The coat by itself, against the formula of its authors with the masking of Mitsuba 3.
    let coat = r#"<rgb name="base_color" value="0"/><float name="specular" value="0"/>
        <float name="clearcoat" value="1"/><float name="clearcoat_gloss" value="0.5"/>"#;
    let a2 = 0.0505f64.powi(2);
    let g1 = |c: f64| 2.0 / (1.0 + (1.0 + 0.0625 * (1.0 - c * c) / (c * c)).sqrt());
    let d = (a2 - 1.0) / (PI * a2.ln() * (1.0 + (a2 - 1.0) * m.z * m.z));
    let expected = 0.25 * (0.04 + 0.96 * grazing) * d * g1(wo.z) * g1(wi.z) * wi.z;
    let f = eval(coat, wo, wi).g;
    assert!((f / expected - 1.0).abs() < 1e-5, "{f} {expected}");
}

/// Of the parts of a thin material: what is neither a pane nor lets light through is principled without reflection, from
/// both sides; all that passes a white one is diffuse; a pane reflects as rough glass of the same facets does, and lets
/// through what mirrors of other facets send to the other side, all in proportion to their shares.
#[test]
fn thin_parts_are_what_they_should() {
    let eval = |plugin: &str, content: &str, wo: Vec3<f64>, wi: Vec3<f64>| {
        let (material, params) = build(plugin, content).expect(content);
        let values: Vec<f64> = params.values().iter().map(|&v| v.into()).collect();
        let at = at(Theta::constant(&values));
        let f = material.eval(&at, wo, wi, TransportMode::Radiance);
        f.to_array()
    };
    let close = |a: [f64; 3], b: [f64; 3], factor: f64| {
        for (a, b) in a.into_iter().zip(b) {
            assert!((a - factor * b).abs() < 2e-6 * a.abs(), "{a} {b}");
        }
    };
    let below = |w: Vec3<f64>| Vec3::new(w.x, w.y, -w.z);
    let [wo, wi] = [polar(0.7, 4.0), polar(0.4, 1.2)];
    let cloth = r#"<rgb name="base_color" value=".7 .4 .1"/><float name="roughness" value=".4"/>
        <float name="flatness" value=".3"/><float name="sheen" value=".5"/><float name="sheen_tint" value=".6"/>"#;
    let opaque = eval(
        "principled",
        &format!(r#"{cloth}<float name="specular" value="0"/>"#),
        wo,
        wi,
    );
    close(eval("principledthin", cloth, wo, wi), opaque, 1.0);
    close(
        eval("principledthin", cloth, below(wo), below(wi)),
        opaque,
        1.0,
    );
    assert_eq!(eval("principledthin", cloth, wo, below(wi)), [0.0; 3]);
    let paper = format!(r#"{cloth}<float name="diff_trans" value=".5"/>"#);
    close(eval("principledthin", &paper, wo, wi), opaque, 0.75);
    let passes = eval("principledthin", &paper, wo, below(wi));
    close(passes, [0.7, 0.4, 0.1], 0.25 * wi.z / PI);
    close(eval("principledthin", &paper, below(wo), wi), passes, 1.0);

    let pane = r#"<rgb name="base_color" value="1"/><float name="roughness" value=".5"/><float name="eta" value="1.4"/>"#;
    let pane = |share: f64| format!(r#"{pane}<float name="spec_trans" value="{share}"/>"#);
    let glass = r#"<string name="distribution" value="ggx"/><float name="alpha" value=".25"/>
        <float name="int_ior" value="1.4"/><float name="ext_ior" value="1"/>"#;
    let reflected = eval("roughdielectric", glass, wo, wi);
    close(eval("principledthin", &pane(1.0), wo, wi), reflected, 1.0);
    close(
        eval("principledthin", &pane(1.0), below(wo), below(wi)),
        reflected,
        1.0,
    );
    let alpha = ((0.65 * 1.4 - 0.35) * 0.5f64).powi(2);
    let mirrors = rough_mirror(Ndf::Ggx, alpha).eval(wo, wi, TransportMode::Radiance);
    let m = (wo + wi).normalize();
    let transmit = render::bsdf::fresnel::dielectric(wo.dot(m), 1.4).transmit;
    let through = eval("principledthin", &pane(1.0), wo, below(wi));
    close(through, mirrors.to_array(), transmit);
    close(
        eval("principledthin", &pane(0.3), wo, below(wi)),
        through,
        0.3,
    );
}

/// Values of Mitsuba 3.9.1, to 6e-3: its function of Bessel is a series of eleven terms, which lacks as much at its end.
#[test]
fn hair_is_that_of_mitsuba() {
    let published = [
        (
            "",
            [0.363537, 0.864299, 0.347603],
            [-0.790571, 0.549242, 0.270797],
            [3.98468e-06, 8.40043e-07, 6.42619e-07],
        ),
        (
            "",
            [-0.616362, 0.667058, 0.418488],
            [0.47329, 0.045734, 0.879719],
            [0.001_684_21, 0.001_661_41, 0.001_659_20],
        ),
        (
            "",
            [-0.82269, -0.181986, -0.538574],
            [0.896977, 0.059497, -0.438054],
            [0.157_276, 0.157_244, 0.157_239],
        ),
        (
            DARK,
            [-0.949885, -0.312444, 0.009891],
            [-0.165772, 0.778364, 0.605532],
            [0.000_203_588, 0.000_146_722, 0.000_129_888],
        ),
        (
            DARK,
            [-0.819336, -0.570876, -0.052818],
            [-0.81083, 0.410308, 0.417374],
            [0.033_002_3, 0.014_227_1, 0.001_553_28],
        ),
        (
            DARK,
            [0.874542, -0.459199, -0.155928],
            [0.910755, 0.288328, 0.295622],
            [0.083_802_7, 0.040_252_1, 0.005_679_98],
        ),
        (
            FUR,
            [-0.296347, -0.950188, 0.096551],
            [0.077374, -0.871125, -0.484927],
            [0.026_869_2, 0.025_901_5, 0.022_283_4],
        ),
        (
            FUR,
            [-0.07563, -0.991785, -0.103162],
            [0.184885, 0.068906, -0.980341],
            [0.080_842_9, 0.078_963_6, 0.070_945_3],
        ),
        (
            FUR,
            [0.531137, 0.797193, 0.287015],
            [-0.678042, 0.606297, -0.415528],
            [0.024_596_1, 0.023_781_6, 0.019_216_6],
        ),
    ];
    const DARK: &str = r#"<float name="eumelanin" value="0.3"/><float name="pheomelanin" value="0.7"/>
        <float name="longitudinal_roughness" value="0.15"/><float name="azimuthal_roughness" value="0.5"/>
        <float name="scale_tilt" value="5"/><float name="int_ior" value="1.4"/>"#;
    const FUR: &str = r#"<rgb name="sigma_a" value="0.2 0.25 0.7"/><float name="scale" value="0.5"/>
        <float name="longitudinal_roughness" value="0.8"/><float name="azimuthal_roughness" value="0.9"/>
        <float name="scale_tilt" value="-3"/>"#;
    for (content, wo, wi, expected) in published {
        let (material, params) = build("hair", content).expect(content);
        let values: Vec<f64> = params.values().iter().map(|&v| v.into()).collect();
        let at = at(Theta::constant(&values));
        let [wo, wi] = [wo, wi].map(Vec3::<f64>::from);
        let f = material.eval(&at, wo, wi, TransportMode::Radiance);
        for (f, expected) in f.to_array().into_iter().zip(expected) {
            let off: f64 = (f / expected - 1.0f64).abs();
            assert!(off < 6e-3, "{wo:?} {wi:?}: {f} {expected}");
        }
    }
}

/// A viewer sees all light of a fibre that takes none, however rough it is (2e-4, by a midpoint rule over both angles); one
/// that takes some is darker.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn fibres_that_take_nothing_are_white() {
    let (rows, columns) = (400, 300);
    for (along, around) in [(0.1, 0.3), (0.3, 0.1), (0.3, 0.3), (1.0, 0.9)] {
        for (sigma, tilt) in [(0.0, 2.0), (0.0, -10.0), (0.5, 2.0)] {
            let content = format!(
                r#"<float name="sigma_a" value="{sigma}"/><float name="longitudinal_roughness" value="{along}"/>
                <float name="azimuthal_roughness" value="{around}"/><float name="scale_tilt" value="{tilt}"/>"#
            );
            let (material, params) = build("hair", &content).expect("a material");
            let values: Vec<f64> = params.values().iter().map(|&v| v.into()).collect();
            let at = at(Theta::constant(&values));
            for (z, phi) in [(1.0, 0.0), (0.3, 1.4), (0.02, 4.0), (-0.6, 2.0)] {
                let wo = polar(z, phi);
                let mut whole = 0.0;
                for k in 0..rows * columns {
                    let [row, column] = [k / columns, k % columns].map(|k| f64::from(k) + 0.5);
                    // The pole is along the fibre, which is y.
                    let theta = PI * (row / f64::from(rows) - 0.5);
                    let w = polar(theta.sin(), 2.0 * PI * column / f64::from(columns));
                    let wi = Vec3::new(w.x, w.z, w.y);
                    let f = material.eval(&at, wo, wi, TransportMode::Radiance);
                    whole += f.g * theta.cos();
                }
                whole *= 2.0 * PI * PI / f64::from(rows * columns);
                let fits = if sigma == 0.0 {
                    (whole - 1.0f64).abs() < 2e-4
                } else {
                    whole > 0.0 && whole < 1.0 - 1e-3
                };
                assert!(fits, "{content} {wo:?}: {whole}");
            }
        }
    }
}

/// Names of tables of their own are those of the metals that Mitsuba has the same numbers for.
#[test]
fn metals_may_be_named_with_their_table() {
    let index = |name: &str| {
        let content = format!(r#"<string name="material" value="{name}"/>"#);
        build("conductor", &content).map(|(_, params)| params.values().to_vec())
    };
    assert_eq!(index("Mo_palik").unwrap(), index("Mo").unwrap());
    assert_ne!(index("Cu_palik").unwrap(), index("Cu").unwrap());
    for unknown in ["Au_palik_palik", "none_palik", "AlSb"] {
        let refused = index(unknown).unwrap_err().to_string();
        assert!(refused.contains(unknown), "{refused}");
    }
}
