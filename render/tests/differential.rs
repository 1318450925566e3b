//! Sampling of the derivative of microfacet distributions: normals, directions, and the integrals
//! estimated with them. Numbers from errata section 9.

use std::f64::consts::{E, PI};

use ad_core::{Const, Dual, Float, Real, Vec3};
use render::bsdf::microfacet::{Microfacet, Ndf};
use render::bsdf::{
    Bsdf, ConductorLobe, DiffLobe, Lobe, Material, RoughConductorLobe, Shading, TransportMode,
};
use render::math::Rgb;
use render::params::{Params, Tangent, Theta};
use render::sampler::{Independent, Sampler};
use render::statistics::{p_value, sidak, z_limit};

use crate::common::materials::{at, build, integrate, polar};

const KINDS: [Ndf; 2] = [Ndf::Ggx, Ndf::Beckmann];
const MODE: TransportMode = TransportMode::Radiance;

fn microfacet<R: Real>(kind: Ndf, alpha: R) -> Microfacet<R> {
    Microfacet {
        kind,
        alpha,
        visible: false,
    }
}

/// Materials with differential sampling: name, plugin, content.
const MATERIALS: &[(&str, &str, &str)] = &[
    (
        "ggx .3",
        "roughconductor",
        r#"<float name="alpha" value=".3"/><string name="distribution" value="ggx"/>"#,
    ),
    (
        "beckmann .2",
        "roughconductor",
        r#"<float name="alpha" value=".2"/><boolean name="sample_visible" value="false"/>
           <string name="material" value="Cu"/>"#,
    ),
    (
        "rough glass ggx .2",
        "roughdielectric",
        r#"<float name="alpha" value=".2"/><string name="distribution" value="ggx"/>
           <float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/>"#,
    ),
    (
        "rough bubble beckmann .4",
        "roughdielectric",
        r#"<float name="alpha" value=".4"/>
           <float name="int_ior" value="1"/><float name="ext_ior" value="1.33"/>"#,
    ),
    (
        "rough plastic",
        "roughplastic",
        r#"<float name="alpha" value=".3"/><rgb name="diffuse_reflectance" value=".3 .6 .1"/>"#,
    ),
    (
        "two sides",
        "twosided",
        r#"<bsdf type="roughconductor"><float name="alpha" value=".3"/></bsdf>"#,
    ),
    (
        "blend of a metal and paint",
        "blendbsdf",
        r#"<float name="weight" value=".3"/>
           <bsdf type="roughconductor"><float name="alpha" value=".3"/></bsdf>
           <bsdf type="diffuse"/>"#,
    ),
    (
        "blend of two metals",
        "blendbsdf",
        r#"<float name="weight" value=".3"/>
           <bsdf type="roughconductor"><float name="alpha" value=".3"/></bsdf>
           <bsdf type="roughconductor"><float name="alpha" value=".5"/>
           <string name="distribution" value="ggx"/></bsdf>"#,
    ),
    (
        "metal with holes",
        "mask",
        r#"<float name="opacity" value=".6"/>
           <bsdf type="roughconductor"><float name="alpha" value=".3"/></bsdf>"#,
    ),
    (
        "tilted metal",
        "normalmap",
        r#"<texture name="normalmap" type="checkerboard"><rgb name="color0" value=".6 .45 .95"/>
           <rgb name="color1" value=".6 .45 .95"/></texture>
           <bsdf type="roughconductor"><float name="alpha" value=".3"/></bsdf>"#,
    ),
];

/// Name, material, its parameters.
fn materials() -> impl Iterator<Item = (&'static str, std::sync::Arc<Material>, Params)> {
    MATERIALS.iter().map(|&(name, plugin, content)| {
        let (material, params) = build(plugin, content).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(material.has_differential(), "{name}");
        (name, material, params)
    })
}

fn values<P: Float>(params: &Params) -> Vec<P> {
    params.values().iter().map(|&v| P::from_f32(v)).collect()
}

fn set_alpha<P: Float>(params: &Params, values: &mut [P], alpha: f64) {
    for info in params.infos() {
        if info.name.ends_with("alpha.value") {
            values[info.offset] = P::of(alpha);
        }
    }
}

/// One derivative, by duals: `dD cos / d alpha` is the density times the mass of a part, and its sign that of the part.
#[test]
fn densities_are_the_two_parts_of_the_derivative() {
    for kind in KINDS {
        for alpha in [1e-4, 0.01, 0.3, 1.0] {
            let mass = match kind {
                Ndf::Ggx => 1.0 / (2.0 * alpha),
                Ndf::Beckmann => 2.0 / (alpha * E),
            };
            let plain = microfacet(kind, alpha);
            let dual = microfacet(kind, Dual::<f64, 1>::var(alpha, 0));
            for i in 0..20_000 {
                let u: [f64; 3] = Independent::new(1, 0, i).next_3d();
                let m = if u[2] < 0.5 {
                    plain.sample_differential([u[0], u[1]])[i as usize % 2]
                } else {
                    plain.sample_all([u[0], u[1]])
                };
                let density = plain.pdf_differential(m);
                let signed = match plain.part_of(m) {
                    DiffLobe::Plus => density,
                    DiffLobe::Minus => -density,
                };
                let exact = (dual.d(Vec3::lift(m)) * Const(m.z)).eps[0];
                let gap = (mass * signed - exact).abs();
                assert!(
                    gap <= 1e-11 * plain.pdf_all(m) * mass,
                    "{kind:?} {alpha} {m:?}: {signed} {exact}"
                );
            }
        }
    }
}

/// Chi-square of a million normals of each part against its density, integrated numerically, which also
/// integrates to 1; 1 % significance for all 16 tests together.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn normals_follow_their_density() {
    const N: u64 = 1_000_000;
    const AZIMUTHS: usize = 12;
    // tan(theta) / alpha
    let edges = [
        0.0,
        0.15,
        0.3,
        0.45,
        0.6,
        0.75,
        0.9,
        1.0,
        1.1,
        1.25,
        1.4,
        1.6,
        1.9,
        2.3,
        3.0,
        5.0,
        10.0,
        f64::INFINITY,
    ];
    for kind in KINDS {
        for alpha in [1e-4, 0.05, 0.5, 1.0] {
            let d = microfacet(kind, alpha);
            for (k, sign) in DiffLobe::BOTH.into_iter().enumerate() {
                let mut observed = vec![0.0; (edges.len() - 1) * AZIMUTHS];
                for i in 0..N {
                    let u: [f64; 2] = Independent::new(2 + k as u64, 0, i).next_2d();
                    let m = d.sample_differential(u)[k];
                    let t = m.x.hypot(m.y) / m.z / alpha;
                    let row = edges.partition_point(|&e| e <= t) - 1;
                    let phi = m.y.atan2(m.x).rem_euclid(2.0 * PI) / (2.0 * PI);
                    let column = ((phi * AZIMUTHS as f64) as usize).min(AZIMUTHS - 1);
                    observed[row * AZIMUTHS + column] += 1.0;
                }
                let density = |theta: f64, phi: f64| {
                    let m = Vec3::new(
                        theta.sin() * phi.cos(),
                        theta.sin() * phi.sin(),
                        theta.cos(),
                    );
                    let here = if d.part_of(m) == sign { 1.0 } else { 0.0 };
                    here * d.pdf_differential(m) * theta.sin()
                };
                let mut bins = Vec::new();
                for (i, count) in observed.into_iter().enumerate() {
                    let (row, column) = (i / AZIMUTHS, (i % AZIMUTHS) as f64);
                    let [a, b] = [edges[row], edges[row + 1]].map(|t| (alpha * t).atan());
                    let step = 2.0 * PI / AZIMUTHS as f64;
                    let cell = [a, b, column * step, (column + 1.0) * step];
                    bins.push((count, N as f64 * integrate(&density, cell, 1e-8, 14)));
                }
                let total: f64 = bins.iter().map(|b| b.1).sum();
                assert!(
                    (total / N as f64 - 1.0).abs() < 1e-6,
                    "{kind:?} {alpha} {sign:?}: {total}"
                );
                let p = p_value(bins);
                assert!(p > sidak(16, 0.01), "{kind:?} {alpha} {sign:?}: {p:e}");
            }
        }
    }
}

/// Chi-square of a million pairs of directions against their density, for every material and three
/// directions of view; 1 % significance for all tests together.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn directions_follow_their_density() {
    const N: u64 = 1_000_000;
    const ROWS: usize = 24;
    const COLUMNS: usize = 24;
    let views = [polar(0.95, 0.4), polar(0.4, 2.5), polar(-0.7, 1.2)];
    let tests = MATERIALS.len() * views.len();
    let mut tested = 0;
    for (name, material, params) in materials() {
        let values = values::<f64>(&params);
        let at = at(Theta::constant(&values));
        for wo in views {
            let mut observed = vec![0.0; ROWS * COLUMNS];
            let mut failed = 0.0;
            for i in 0..2 * N {
                let u = Independent::new(4, 0, i).next_3d();
                match material.sample_differential(&at, wo, u, MODE)[i as usize % 2] {
                    None => failed += 1.0,
                    Some(s) => {
                        let row = ((s.wi.z + 1.0) / 2.0 * ROWS as f64) as usize;
                        let phi = s.wi.y.atan2(s.wi.x).rem_euclid(2.0 * PI) / (2.0 * PI);
                        let column = (phi * COLUMNS as f64) as usize;
                        observed[row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)] += 1.0;
                    }
                }
            }
            if failed == 2.0 * N as f64 {
                // One-sided, seen from behind.
                assert!(wo.z < 0.0, "{name}");
                continue;
            }
            let density = |z: f64, phi: f64| material.pdf_differential(&at, wo, polar(z, phi));
            let mut bins = Vec::new();
            for (i, count) in observed.into_iter().enumerate() {
                let (row, column) = ((i / COLUMNS) as f64, (i % COLUMNS) as f64);
                let (dz, dphi) = (2.0 / ROWS as f64, 2.0 * PI / COLUMNS as f64);
                let z0 = row * dz - 1.0;
                let cell = [z0, z0 + dz, column * dphi, (column + 1.0) * dphi];
                bins.push((count, N as f64 * integrate(&density, cell, 1e-7, 10)));
            }
            let expected: f64 = bins.iter().map(|b| b.1).sum();
            assert!(
                expected < 2.0 * N as f64 * (1.0 + 1e-4),
                "{name}: density integrates to {expected}"
            );
            bins.push((failed, (2.0 * N as f64 - expected).max(0.0)));
            let p = p_value(bins);
            assert!(p > sidak(tests, 0.01), "{name}, {wo:?}: {p:e}");
            tested += 1;
        }
    }
    assert!(tested >= 20, "{tested}");
}

/// Mean and standard error.
fn mean(n: u64, mut f: impl FnMut(&mut Independent) -> f64) -> (f64, f64) {
    let (mut sum, mut square) = (0.0, 0.0);
    for i in 0..n {
        let x = f(&mut Independent::new(5, 0, i));
        sum += x;
        square += x * x;
    }
    let n = n as f64;
    let mean = sum / n;
    (mean, ((square / n - mean * mean) / n).sqrt())
}

/// The derivative of reflected radiance with respect to roughness, against numbers computed elsewhere;
/// significance 1e-3 over four comparisons. The pair alone (its variance is infinite, but only logarithmically), and
/// combined with samples of the primal distribution. Averaged instead of summed (as printed) the result
/// would be half of it.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn both_lobes_sum_to_the_derivative() {
    let expected = [(Ndf::Ggx, -1.365277), (Ndf::Beckmann, -1.163722)];
    let (sin, cos) = 0.7f64.sin_cos();
    let wo = Vec3::new(sin, 0.0, cos);
    let light = |w: Vec3<f64>| {
        let d = Vec3::new(-sin, 0.0, cos);
        1.0 + 0.5 * w.x + 0.8 * (6.0 * (w.dot(d) - 1.0)).exp()
    };
    for (kind, expected) in expected {
        let lobe = |alpha: Dual<f64, 1>| RoughConductorLobe {
            microfacet: microfacet(kind, alpha),
            facet: ConductorLobe {
                index: None,
                specular_reflectance: Rgb::splat(Dual::one()),
            },
        };
        let lobe = lobe(Dual::var(0.3, 0));
        let integrand =
            |wi: Vec3<f64>| lobe.eval(Vec3::lift(wo), Vec3::lift(wi), MODE).r.eps[0] * light(wi);
        let primal = |wi: Vec3<f64>| lobe.pdf(Vec3::lift(wo), Vec3::lift(wi), MODE).re;
        let (pair, error) = mean(1_000_000, |s| {
            let u = s.next_3d();
            let samples = (lobe.sample_differential(wo, u, MODE).into_iter()).flatten();
            samples.map(|s| integrand(s.wi) / s.pdf).sum()
        });
        let z = (pair - expected) / error;
        assert!(
            z.abs() < z_limit(4, 1_000_000, 1e-3),
            "{kind:?}: {pair} +- {error}"
        );
        let densities = |wi| lobe.pdf_differential(wo, wi) + primal(wi);
        let (mixed, mixed_error) = mean(1_000_000, |s| {
            let u = s.next_3d();
            let v = s.next_3d();
            let samples = (lobe.sample_differential(wo, u, MODE))
                .map(|sample| sample.map(|s| s.wi))
                .into_iter()
                .chain([lobe
                    .sample(Vec3::lift(wo), v, MODE)
                    .map(|s| s.wi.map(|x| x.re))])
                .flatten();
            samples.map(|wi| integrand(wi) / densities(wi)).sum()
        });
        let z = (mixed - expected) / mixed_error;
        assert!(
            z.abs() < z_limit(4, 1_000_000, 1e-3),
            "{kind:?}: {mixed} +- {mixed_error}"
        );
    }
}

/// For every material: the two parts and primal sampling, combined by the balance heuristic, estimate
/// the derivative with respect to roughness of an integral over directions, whose reference is the
/// difference of two integrals by quadrature; significance 1e-3 over 60 comparisons.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn estimates_agree_with_differences_of_integrals() {
    type D = Dual<f64, 1>;
    let light = |w: Vec3<f64>| 1.0 + 0.5 * w.x - 0.3 * w.y * w.z + 0.2 * w.z;
    let mut compared = 0;
    for (name, material, params) in materials() {
        let values = values::<f64>(&params);
        let tangents: Vec<Tangent<D>> = (params.infos().iter())
            .map(|i| {
                if i.name.ends_with("alpha.value") {
                    Tangent::Uniform(D::var(0.0, 0))
                } else {
                    Tangent::None
                }
            })
            .collect();
        let moving = at(Theta::with_tangents(&values, &tangents));
        let fixed: Shading<f64> = at(Theta::constant(&values));
        for wo in [polar(0.9, 0.4), polar(0.5, 2.5), polar(-0.8, 1.2)] {
            let integral = |h: f64| {
                let mut moved = values.clone();
                for info in params.infos() {
                    if info.name.ends_with("alpha.value") {
                        moved[info.offset] += h;
                    }
                }
                let at = at(Theta::constant(&moved));
                let f = |z: f64, phi: f64| {
                    let wi = polar(z, phi);
                    material.eval(&at, wo, wi, MODE).r * light(wi)
                };
                [[-1.0, 0.0], [0.0, 1.0]]
                    .map(|[a, b]| integrate(&f, [a, b, 0.0, 2.0 * PI], 1e-7, 12))
                    .iter()
                    .sum::<f64>()
            };
            let h = 1e-3;
            let expected = (integral(h) - integral(-h)) / (2.0 * h);
            let weighted = |wi: Vec3<f64>| {
                let f = material.eval(&moving, Vec3::lift(wo), Vec3::lift(wi), MODE);
                let pair = material.pdf_differential(&fixed, wo, wi);
                let (_, primal) = material.eval_pdf(&fixed, wo, wi, MODE);
                f.r.eps[0] * light(wi) / (pair + primal)
            };
            let (estimate, error) = mean(100_000, |s| {
                let u = s.next_3d();
                let v = s.next_3d();
                let pair = material.sample_differential(&fixed, wo, u, MODE);
                let primal = material
                    .sample(&fixed, wo, v, MODE)
                    .filter(|s| s.component == render::bsdf::Component::Continuous);
                pair.into_iter()
                    .chain([primal])
                    .flatten()
                    .map(|s| weighted(s.wi))
                    .sum()
            });
            assert!(
                (estimate - expected).abs() <= z_limit(60, 100_000, 1e-3) * error + 1e-5,
                "{name}, {wo:?}: {estimate} +- {error}, expected {expected}"
            );
            compared += u32::from(expected.abs() > 0.01);
        }
    }
    assert!(compared > 20, "{compared}");
}

/// Sampled and evaluated densities are the same number, positive and finite, in both precisions, for
/// any roughness, any direction (exactly normal, grazing, from below), and the extreme random
/// numbers.
#[test]
fn finite_and_consistent_everywhere() {
    fn check<P: Float>(material: &Material, params: &Params, name: &str, last: f64, n: &mut u32) {
        let mut values = values::<P>(params);
        for alpha in [1e-4, 1e-2, 1.0] {
            set_alpha(params, &mut values, alpha);
            let at = at(Theta::constant(&values));
            for z in [
                1.0,
                1.0 - 1e-7,
                0.5,
                1e-3,
                1e-6,
                1e-30,
                0.0,
                -1e-4,
                -0.6,
                -1.0,
            ] {
                let wo = polar(z, 2.0).map(P::of);
                for i in 0..40 {
                    let random: [f64; 3] = Independent::new(6, 0, i).next_3d();
                    let ends = [0.0, last, 1e-9];
                    let u = std::array::from_fn(|k| match i {
                        0..27 => ends[i as usize / 3usize.pow(k as u32) % 3],
                        _ => random[k],
                    })
                    .map(P::of);
                    let pair = material.sample_differential(&at, wo, u, MODE);
                    for s in pair.into_iter().flatten() {
                        let pdf = material.pdf_differential(&at, wo, s.wi);
                        assert!(s.wi.is_finite(), "{name} {alpha} {z} {u:?}");
                        assert!(
                            pdf == s.pdf && pdf > P::zero() && pdf.is_finite(),
                            "{name} {alpha} {z} {u:?}: {pdf} {}",
                            s.pdf
                        );
                        *n += 1;
                    }
                }
                for wi in [
                    polar(-z, 2.0),
                    polar(z, 2.0),
                    polar(z, 2.0 - PI),
                    polar(1.0, 0.0),
                ] {
                    let pdf = material.pdf_differential(&at, wo, wi.map(P::of));
                    assert!(
                        pdf.is_finite() && pdf >= P::zero(),
                        "{name} {alpha} {z} {wi:?}"
                    );
                }
            }
        }
    }
    let mut n = 0;
    for (name, material, params) in materials() {
        check::<f32>(
            &material,
            &params,
            name,
            f64::from(1.0 - f32::EPSILON / 2.0),
            &mut n,
        );
        check::<f64>(&material, &params, name, 1.0 - f64::EPSILON / 2.0, &mut n);
    }
    assert!(n > 10_000, "{n}");
}

/// Single against double precision: slopes of sampled normals at the same random numbers, and
/// densities of directions at the same directions.
#[test]
fn single_precision_is_enough() {
    for kind in KINDS {
        for alpha in [1e-4f32, 1.0] {
            let single = microfacet(kind, alpha);
            let double = microfacet(kind, f64::from(alpha));
            let wo = Vec3::new(0.5f32, -0.3, 0.8).normalize();
            for (i, k) in (0..20_000).flat_map(|i| [0, 1].map(|k: usize| (i, k))) {
                let sign = DiffLobe::BOTH[k];
                let u: [f32; 2] = Independent::new(7, 0, i).next_2d();
                let m = single.sample_differential(u)[k];
                let exact = double.sample_differential(u.map(f64::from))[k];
                let slope = f64::from(m.x.hypot(m.y) / m.z);
                let exact_slope = exact.x.hypot(exact.y) / exact.z;
                let gap = (slope - exact_slope).abs();
                assert!(
                    gap <= 4e-6 * exact_slope,
                    "{kind:?} {alpha} {u:?} {sign:?}: {gap:e}"
                );

                let h = m.map(f64::from).normalize();
                let pdf = f64::from(single.pdf_differential(m));
                let pdf_all = double.pdf_all(h);
                let exact = double.pdf_differential(h);
                // A multiple of the primal density: the difference in it cancels at s = 1.
                let gap = (pdf - exact).abs() / (exact + pdf_all);
                assert!(gap < 2e-5, "{kind:?} {alpha} {u:?} {sign:?}: {gap:e}");

                let lobe = RoughConductorLobe {
                    microfacet: single,
                    facet: ConductorLobe {
                        index: None,
                        specular_reflectance: Rgb::splat(1.0),
                    },
                };
                let v = [0.0, u[0], u[1]];
                if let Some(s) = lobe.sample_differential(wo, v, MODE)[k] {
                    let (o, i) = (wo.map(f64::from), s.wi.map(f64::from));
                    let h = (o + i).normalize();
                    let exact = double.pdf_differential_reflected(o, h);
                    let gap =
                        (f64::from(s.pdf) - exact).abs() / (exact + double.pdf_reflected(o, h));
                    assert!(gap < 1e-4, "{kind:?} {alpha} {u:?} {sign:?}: {gap:e}");
                }
            }
        }
    }
}

/// Materials without a distribution of normals say so.
#[test]
fn others_have_none() {
    for plugin in [
        "diffuse",
        "conductor",
        "plastic",
        "dielectric",
        "blinnphong",
    ] {
        let (material, params) = build(plugin, "").unwrap_or_else(|e| panic!("{plugin}: {e}"));
        let values = values::<f64>(&params);
        let at = at(Theta::constant(&values));
        let (wo, wi) = (polar(0.8, 0.0), polar(0.8, PI));
        assert!(!material.has_differential());
        let pair = material.sample_differential(&at, wo, [0.5; 3], MODE);
        assert!(pair.iter().all(Option::is_none));
        assert_eq!(material.pdf_differential(&at, wo, wi), 0.0);
    }
}
