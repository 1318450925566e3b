//! Probabilities of lobes that are differentiated (F6): what is wrong is what theory says, and nothing but that changes.

use ad_core::Vec3;
use render::Scene;
use render::bsdf::{Bsdf, Material, Shading, TransportMode};
use render::estimator::{AllowBias, AttachedChoice, BsdfOnly, Detached, DetachedMis, Unbiased};
use render::instances::Estimator;
use render::params::{ParamKind, Theta};
use render::sampler::mix64;
use tests::stats::{Estimate, z_limit};
use tests::{
    cases, derivative_image, forward_by, mean_adjoint, reverse_by, scene, smooth_params, values,
};

type Paths = BsdfOnly<Detached>;
type Wrong<S> = AllowBias<AttachedChoice<S>>;

const REPEATS: u64 = 32;
const SKY: f64 = 0.6;
/// How far probabilities stay away from 0 and 1, whatever the weight.
const LEAST_CHOICE: f64 = 0.05;

/// A plate under a constant sky, seen in one direction only, of a blend of two materials.
fn plate(weight: f64, parts: &str) -> Scene {
    scene(&format!(
        r#"<sensor type="perspective"><float name="fov" value="0.01"/>
        <transform name="to_world"><lookat origin="0, 3, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/>
        <rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="2"/></integrator>
        <emitter type="constant"><rgb name="radiance" value="{SKY}"/></emitter>
        <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/></transform>
        <bsdf type="blendbsdf" id="blend"><float name="weight" value="{weight}"/>{parts}</bsdf></shape>"#
    ))
}

/// The derivative of the radiance in the weight of the blend.
fn derivative<S: Unbiased>(s: &Scene, spp: u64) -> Estimate {
    let mut along = vec![0.0; values::<f64>(s).len()];
    let weight = s.params().find("blend.weight.value").expect("a weight");
    along[weight.offset] = 1.0;
    let adjoint = mean_adjoint(s);
    let each = |seed| forward_by::<S>(s, &along, &adjoint, &s.settings, seed, spp);
    Estimate::of(&(0..REPEATS).map(each).collect::<Vec<_>>())
}

/// The estimate has the `expected` mean, and not `other`.
fn assert_tells(found: &Estimate, expected: f64, other: f64) {
    let z = [expected, other].map(|x| found.z(&Estimate::exact(x)));
    println!("{found:?} expected {expected}: z {:.2}, {:.1}", z[0], z[1]);
    assert!(z[0].abs() < z_limit(8, REPEATS, 1e-3), "{z:?}");
    assert!(z[1].abs() > 20.0, "{z:?}");
}

/// Probabilities of the two parts, and their derivative in the weight.
fn choice(w: f64) -> ([f64; 2], f64) {
    let slope = 1.0 - 2.0 * LEAST_CHOICE;
    let second = LEAST_CHOICE + slope * w;
    ([1.0 - second, second], slope)
}

/// F6 itself: two mirrors, `I = (1 - w) A + w B`, chosen with probabilities close to their weights. The derivative is
/// `B - A`; a part whose `1 / P` is differentiated lacks its value times `P' / P`, which leaves next to nothing. 32 x 16 x
/// 500 samples.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn mirrors_of_a_blend_hide_their_difference() {
    for w in [0.3, 0.6] {
        let mirror = |r: f64| {
            format!(
                r#"<bsdf type="conductor"><rgb name="specular_reflectance" value="{r}"/></bsdf>"#
            )
        };
        let [a, b] = [0.8, 0.3];
        let s = plate(w, &format!("{}{}", mirror(a), mirror(b)));
        let (p, slope) = choice(w);
        let right = SKY * (b - a);
        let wrong = right - SKY * (w * b * slope / p[1] - (1.0 - w) * a * slope / p[0]);
        assert!(wrong.abs() < 0.2 * right.abs());
        assert_tells(&derivative::<Paths>(&s, 500), right, wrong);
        assert_tells(&derivative::<Wrong<Paths>>(&s, 500), wrong, right);
    }
}

/// Sky over the hemisphere by a midpoint rule: what the derivative in the weight of the blend is, and what it lacks where
/// scattered directions have the MIS weight `hit(p)`: `f L hit(p) p' / p`, with the density `p` of the mixture.
fn integrals(s: &Scene, hit: impl Fn(f64) -> f64) -> [f64; 2] {
    let blend = s.materials().iter().find_map(|m| match &**m {
        Material::Blend(blend) => Some(blend),
        _ => None,
    });
    let parts = blend.expect("a blend").parts();
    let values = values::<f64>(s);
    let weight = s.params().find("blend.weight.value").expect("a weight");
    let w = values[weight.offset];
    let (probability, slope) = choice(w);
    let at = Shading::new(Theta::constant(&values), ad_core::Vec2::new(0.5, 0.5));
    let wo = Vec3::new(0.0, -0.8, 0.6);
    let n = 500;
    let area = std::f64::consts::TAU / f64::from(n * n);
    let [mut all, mut lacks] = [0.0; 2];
    for i in 0..n * n {
        let [u, v] = [i % n, i / n].map(|k| (f64::from(k) + 0.5) / f64::from(n));
        let (sin, phi) = ((1.0 - u * u).sqrt(), std::f64::consts::TAU * v);
        let wi = Vec3::new(sin * phi.cos(), sin * phi.sin(), u);
        let [(a, p_a), (b, p_b)] =
            [0, 1].map(|k| parts[k].eval_pdf(&at, wo, wi, TransportMode::Radiance));
        let p = probability[0] * p_a + probability[1] * p_b;
        let f = a.mean() * (1.0 - w) + b.mean() * w;
        all += SKY * area * (b.mean() - a.mean());
        if p > 0.0 {
            lacks += SKY * area * f * hit(p) * slope * (p_b - p_a) / p;
        }
    }
    [all, lacks]
}

/// Paint and metal: parts without deltas, weighed by the density of their mixture, alone and beside sampled lights. Two
/// paints have the same density, of which nothing is missing. 32 x 16 x 2000 samples.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn what_mixtures_lack_is_the_change_of_their_density() {
    let paint =
        |r: f64| format!(r#"<bsdf type="diffuse"><rgb name="reflectance" value="{r}"/></bsdf>"#);
    let metal = r#"<bsdf type="roughconductor"><string name="distribution" value="ggx"/>
        <float name="alpha" value="0.3"/><rgb name="specular_reflectance" value="0.9, 0.8, 0.7"/></bsdf>"#;
    let s = plate(0.35, &format!("{}{metal}", paint(0.2)));
    let [right, lacks] = integrals(&s, |_| 1.0);
    assert_tells(&derivative::<Paths>(&s, 2000), right, right - lacks);
    assert_tells(&derivative::<Wrong<Paths>>(&s, 2000), right - lacks, right);

    let light = 0.25 / std::f64::consts::PI;
    let [right, lacks] = integrals(&s, |p| p * p / (p * p + light * light));
    assert_tells(&derivative::<DetachedMis>(&s, 2000), right, right - lacks);
    assert_tells(
        &derivative::<Wrong<DetachedMis>>(&s, 2000),
        right - lacks,
        right,
    );

    let s = plate(0.35, &format!("{}{}", paint(0.2), paint(0.9)));
    let [found, wrong] = [
        derivative::<Paths>(&s, 20),
        derivative::<Wrong<Paths>>(&s, 20),
    ];
    assert!((found.mean - SKY * 0.7).abs() < 1e-6, "{found:?}");
    assert!((found.mean - wrong.mean).abs() < 1e-12, "{wrong:?}");
}

/// Every parameter of every material: the picture is that of `mis`, bit by bit, and so is the derivative in parameters
/// that no probability of a lobe depends on. The others are these.
#[test]
fn nothing_changes_but_derivatives_in_what_choices_depend_on() {
    let choices = [
        "rough dielectric: ball.bsdf.eta.value",
        "plastic: ball.bsdf.eta.value",
        "plastic: ball.bsdf.diffuse_reflectance.value",
        "plastic: ball.bsdf.specular_reflectance.value",
        "rough plastic: ball.bsdf.alpha.value",
        "rough plastic: ball.bsdf.eta.value",
        "rough plastic: ball.bsdf.diffuse_reflectance.value",
        "rough plastic: ball.bsdf.specular_reflectance.value",
        "blinn-phong: ball.bsdf.diffuse_reflectance.value",
        "blinn-phong: ball.bsdf.specular_reflectance.value",
        "two-sided blend: ball.bsdf.brdf_0.weight.value",
        "mask: ball.bsdf.opacity.value",
        "window: ball.bsdf.eta.value",
        "principled: ball.bsdf.metallic.value",
        "principled: ball.bsdf.clearcoat.value",
        "principled with tints: ball.bsdf.metallic.value",
        "principled glass: ball.bsdf.metallic.value",
        "principled glass: ball.bsdf.spec_trans.value",
        "principled glass: ball.bsdf.eta.value",
        "principled thin: ball.bsdf.spec_trans.value",
        "principled thin: ball.bsdf.diff_trans.value",
        "hair: ball.bsdf.eta.value",
        "hair: ball.bsdf.eumelanin.value",
        "hair: ball.bsdf.pheomelanin.value",
        "white hair: ball.bsdf.eta.value",
        "white hair: ball.bsdf.sigma_a.value",
        "white hair: ball.bsdf.scale.value",
        "brushed principled: ball.bsdf.metallic.value",
        "brushed pane: ball.bsdf.spec_trans.value",
        "brushed glass: ball.bsdf.eta.value",
    ];
    let mut changed = Vec::new();
    for case in cases::all() {
        let s = scene(&case.body);
        for p in smooth_params(&s) {
            let mut along = vec![0.0; values::<f64>(&s).len()];
            along[p.range()].fill(1.0);
            let [a, b] = [
                derivative_image::<DetachedMis>(&s, &along, &s.settings, 3, 16),
                derivative_image::<Wrong<DetachedMis>>(&s, &along, &s.settings, 3, 16),
            ];
            assert_eq!(a.sums[0], b.sums[0], "{}: {}", case.name, p.name);
            if a.sums[1] != b.sums[1] {
                changed.push(format!("{}: {}", case.name, p.name));
            }
        }
    }
    assert_eq!(changed, choices);
    // A guide's density has no lobes.
    assert!(!Estimator::BiasedChoice.capabilities().guided);
}

/// Colours of which probabilities take means, that are images of several values, and normals that tilt: what is not in
/// `gradients.rs`. `<adjoint, J d_theta> = <J^T adjoint, d_theta>` to 1e-9 in f64.
#[test]
fn reverse_equals_forward_where_channels_mix() {
    fn noise(i: usize) -> f64 {
        mix64(i as u64 + 1) as f64 / u64::MAX as f64 * 2.0 - 1.0
    }
    let squares = |name: &str, a: &str, b: &str| {
        format!(
            r#"<texture name="{name}" type="checkerboard"><rgb name="color0" value="{a}"/>
            <rgb name="color1" value="{b}"/></texture>"#
        )
    };
    let colours = |name: &str| squares(name, "0.7, 0.3, 0.1", "0.2, 0.6, 0.4");
    let normals = squares("normalmap", "0.6, 0.45, 0.95", "0.45, 0.55, 0.98");
    let body = cases::all().swap_remove(0).body;
    let (before, _) = body.split_once("<shape type=\"sphere\"").expect("a ball");
    let s = scene(&format!(
        r#"{before}<shape type="rectangle"><transform name="to_world"><translate y="1" z="-1"/></transform>
        <bsdf type="normalmap" id="map">{normals}<bsdf type="blendbsdf"><float name="weight" value="0.4"/>
        <bsdf type="plastic">{}</bsdf><bsdf type="blinnphong">{}<float name="exponent" value="9"/></bsdf>
        </bsdf></bsdf></shape>"#,
        colours("diffuse_reflectance"),
        colours("specular_reflectance")
    ));
    let params: Vec<_> = (smooth_params(&s).into_iter())
        .filter(|p| p.name.starts_with("map"))
        .collect();
    assert_eq!(params.len(), 11);
    let adjoint: Vec<f32> = (0..s.film.pixels() * 3).map(|i| noise(i) as f32).collect();
    let g = reverse_by::<f64, Wrong<DetachedMis>>(&s, &params, &adjoint, &s.settings, 5, 64);
    let mis = reverse_by::<f64, DetachedMis>(&s, &params, &adjoint, &s.settings, 5, 64);
    for (p, (g, mis)) in params.iter().zip(g.iter().zip(&mis)) {
        let mut along = vec![0.0; s.params().values().len()];
        for i in p.range() {
            along[i] = noise(i + 7919);
        }
        let forward = forward_by::<Wrong<DetachedMis>>(&s, &along, &adjoint, &s.settings, 5, 64);
        let terms = || g.iter().zip(&along[p.range()]).map(|(g, d)| g * d);
        let (reverse, scale) = (terms().sum::<f64>(), terms().map(f64::abs).sum::<f64>());
        let close = (forward - reverse).abs() < 1e-9 * scale;
        assert!(close, "{}: {forward} {reverse}", p.name);
        // No probability depends on it.
        assert_eq!(g == mis, p.kind == ParamKind::Roughness, "{}", p.name);
    }
}
