//! Materials made of other materials: densities, weights and derivatives.

use std::path::Path;

use ad_core::{Dual, Real, Vec2, Vec3};
use proptest::prelude::*;
use render::bsdf::{Bsdf, Component, DeltaKind, Material, Part, Shading, TransportMode, Use};
use render::image_io::{Pixels, write_exr_pixels};
use render::math::Rgb;
use render::params::{GradSink, ParamKind, ParamRef, Tangent, Theta};
use render::sampler::{Independent, Sampler};
use render::scene::LoadOptions;
use render::statistics::{p_value, sidak, z_limit};
use render::{Scene, SceneError};
use tempfile::TempDir;

use crate::common::Gradient;

const MODE: TransportMode = TransportMode::Radiance;

/// A scene of one rectangle with this material. `weights.exr` and `normals.exr` lie beside it.
fn load(bsdf: &str) -> Result<Scene, SceneError> {
    loaded(bsdf).map(|(scene, _)| scene)
}

/// [`load`], with warnings.
fn loaded(bsdf: &str) -> Result<(Scene, Vec<String>), SceneError> {
    let dir = TempDir::new().unwrap();
    let wave = |i: usize, k: f32| 0.5 + 0.45 * (i as f32 * k).sin();
    let image = |name: &str, channels: usize, data: Vec<f32>| {
        let pixels = Pixels {
            width: 3,
            height: 2,
            channels,
            data,
        };
        write_exr_pixels(&dir.path().join(name), &pixels).unwrap();
    };
    image("weights.exr", 1, (0..6).map(|i| wave(i, 2.3)).collect());
    let normals = (0..6).flat_map(|i| {
        let (x, y) = (0.6 * (wave(i, 1.7) - 0.5), 0.6 * (wave(i, 3.1) - 0.5));
        let z = (1.0 - 4.0 * (x * x + y * y)).sqrt() / 2.0;
        [0.5 + x, 0.5 + y, 0.5 + z]
    });
    image("normals.exr", 3, normals.collect());
    let path = dir.path().join("scene.xml");
    let xml = format!(
        r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor>
        <shape type="rectangle" id="s">{bsdf}</shape></scene>"#
    );
    std::fs::write(&path, xml).unwrap();
    Scene::load(Path::new(&path), &LoadOptions::default())
}

fn diffuse(r: f64, g: f64, b: f64) -> String {
    format!(r#"<bsdf type="diffuse"><rgb name="reflectance" value="{r} {g} {b}"/></bsdf>"#)
}

fn blend(weight: f64, parts: &str) -> String {
    format!(r#"<bsdf type="blendbsdf"><float name="weight" value="{weight}"/>{parts}</bsdf>"#)
}

fn mask(opacity: f64, nested: &str) -> String {
    format!(r#"<bsdf type="mask"><float name="opacity" value="{opacity}"/>{nested}</bsdf>"#)
}

fn two_sided(nested: &str) -> String {
    format!(r#"<bsdf type="twosided">{nested}</bsdf>"#)
}

fn normal_map(nested: &str, extra: &str) -> String {
    format!(
        r#"<bsdf type="normalmap"><string name="filename" value="normals.exr"/>{extra}{nested}</bsdf>"#
    )
}

/// Heights are the weights of blends, times `scale`.
fn bump_map(scale: f64, nested: &str, extra: &str) -> String {
    let heights = WEIGHTS.replace("\"weight\"", "\"heights\"");
    format!(
        r#"<bsdf type="bumpmap">{heights}<float name="scale" value="{scale}"/>{extra}{nested}</bsdf>"#
    )
}

const SLOPES_OFF: &str = r#"<boolean name="use_slopes" value="false"/>"#;

/// More options of a normal map.
fn correct(flip: bool, shadowing: bool) -> String {
    format!(
        r#"<boolean name="flip_invalid_normals" value="{flip}"/><boolean name="use_shadowing_function" value="{shadowing}"/>"#
    )
}

const GLASS: &str = r#"<bsdf type="dielectric"/>"#;

const WEIGHTS: &str = r#"<texture name="weight" type="bitmap"><string name="filename" value="weights.exr"/></texture>"#;

/// One of every kind, and kinds within kinds.
fn zoo() -> Vec<(&'static str, String)> {
    let (red, blue) = (diffuse(0.8, 0.3, 0.1), diffuse(0.1, 0.2, 0.7));
    let textured = format!(r#"<bsdf type="blendbsdf">{WEIGHTS}{red}{blue}</bsdf>"#);
    let opacity = WEIGHTS.replace("weight\"", "opacity\"");
    let holes = format!(r#"<bsdf type="mask">{opacity}{red}</bsdf>"#);
    vec![
        ("two-sided", two_sided(&red)),
        ("two-sided, two colours", two_sided(&format!("{red}{blue}"))),
        ("blend", blend(0.3, &format!("{red}{blue}"))),
        ("blend, textured", textured.clone()),
        ("mask", mask(0.6, &red)),
        ("mask, textured", holes.clone()),
        (
            "normal map, slopes",
            normal_map(&red, r#"<float name="tiles" value="3"/>"#),
        ),
        (
            "normal map, normals",
            normal_map(&two_sided(&red), SLOPES_OFF),
        ),
        ("normal map of a mask", normal_map(&holes, "")),
        (
            "normal map, flipped",
            normal_map(&textured, &correct(true, false)),
        ),
        (
            "normal map, shadowed",
            normal_map(&two_sided(&red), &correct(false, true)),
        ),
        (
            "normal map of glass, corrected",
            mask(
                0.8,
                &normal_map(&blend(0.6, &format!("{GLASS}{red}")), &correct(true, true)),
            ),
        ),
        ("bump map", bump_map(0.2, &two_sided(&red), "")),
        (
            "bump map, uncorrected",
            bump_map(-0.3, &textured, &correct(false, false)),
        ),
        (
            "bump map of glass in a mask",
            mask(
                0.8,
                &bump_map(0.3, &blend(0.6, &format!("{GLASS}{red}")), ""),
            ),
        ),
        (
            "blend of masks",
            blend(0.7, &format!("{holes}{}", mask(0.2, &blue))),
        ),
        (
            "everything",
            two_sided(&blend(
                0.4,
                &format!("{}{textured}", normal_map(&textured, "")),
            )),
        ),
    ]
}

fn directions() -> Vec<Vec3<f64>> {
    [
        [0.0, 0.0, 1.0],
        [0.4, -0.3, 0.7],
        [-0.9, 0.1, 0.2],
        [0.1, 0.2, -0.8],
        [0.7, 0.7, 1e-3],
    ]
    .map(|d| Vec3::from(d).normalize())
    .to_vec()
}

const UV: [[f64; 2]; 4] = [[0.31, 0.62], [0.9, 0.05], [0.5, 0.25], [-7.3, 1e6]];

fn values(scene: &Scene) -> Vec<f64> {
    scene
        .params()
        .values()
        .iter()
        .map(|&x| f64::from(x))
        .collect()
}

fn shading<'a, R: Real>(theta: Theta<'a, R>, uv: [f64; 2]) -> Shading<'a, R> {
    Shading::new(theta, Vec2::new(R::of(uv[0]), R::of(uv[1])))
}

fn numbers(seed: u64) -> impl FnMut() -> [f64; 3] {
    let mut index = 0;
    move || {
        index += 1;
        Independent::new(seed, 0, index).next_3d()
    }
}

/// Continuous and delta uses of a material at one point, with some adjoints.
fn uses(material: &Material, at: &Shading<f64>, wo: Vec3<f64>) -> Vec<Use<f64>> {
    let mut next = numbers(7);
    let mut all: Vec<_> = directions()
        .into_iter()
        .map(|wi| (wi, Component::Continuous))
        .collect();
    for _ in 0..40 {
        if let Some(s) = material.sample(at, wo, next(), MODE) {
            all.push((s.wi, s.component));
        }
    }
    let d = |i: usize| Rgb::new(0.3 + i as f64, 1.0 - 0.2 * i as f64, 0.5);
    let with_adjoint = |(i, (wi, component))| Use {
        wi,
        component,
        part: Part::All,
        d: d(i),
    };
    all.into_iter().enumerate().map(with_adjoint).collect()
}

/// What the adjoints in `uses` are the derivatives of.
fn objective<R: Real<Primal = f64>>(
    material: &Material,
    at: &Shading<R>,
    wo: Vec3<f64>,
    uses: &[Use<f64>],
) -> R {
    let value = |u: &Use<f64>| {
        let wi = Vec3::lift(u.wi);
        let f = material.eval_component(at, Vec3::lift(wo), wi, u.component, MODE);
        (f * Rgb::lift(u.d)).sum()
    };
    uses.iter().map(value).sum()
}

#[test]
fn reverse_equals_forward_equals_differences() {
    for (name, xml) in zoo() {
        let scene = load(&xml).unwrap();
        let material = scene.material(0);
        let theta = values(&scene);
        for (wo, uv) in directions().into_iter().flat_map(|d| UV.map(|uv| (d, uv))) {
            let at = shading(Theta::constant(&theta), uv);
            let uses = uses(material, &at, wo);
            let mut grad = Gradient(vec![0.0; theta.len()]);
            material.backward(&at, wo, &uses, MODE, &mut grad);
            let scale = 1.0 + grad.0.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
            for i in 0..theta.len() {
                let tangents: Vec<_> = (scene.params().infos().iter())
                    .map(|info| {
                        if info.range().contains(&i) {
                            let one_hot = info
                                .range()
                                .map(|j| Dual::new(0.0, [f64::from(u8::from(i == j))]));
                            Tangent::Dense(one_hot.collect())
                        } else {
                            Tangent::None
                        }
                    })
                    .collect();
                let moving = Theta::with_tangents(&theta, &tangents);
                let forward: Dual<f64, 1> = objective(material, &shading(moving, uv), wo, &uses);
                let difference = (forward.eps[0] - grad.0[i]).abs();
                assert!(
                    difference < 1e-12 * scale,
                    "{name} {i}: {forward:?} {}",
                    grad.0[i]
                );

                let at_offset = |h: f64| {
                    let mut moved = theta.clone();
                    moved[i] += h;
                    let at = shading(Theta::constant(&moved), uv);
                    objective::<f64>(material, &at, wo, &uses)
                };
                let h = 1e-5;
                let central = (at_offset(h) - at_offset(-h)) / (2.0 * h);
                let difference = (central - grad.0[i]).abs();
                assert!(
                    difference < 1e-6 * scale,
                    "{name} {i}: {central} {}",
                    grad.0[i]
                );
            }
        }
    }
}

/// The derivative of a density is that through choices and that through parts, of a delta's probability that through
/// choices: of blends, masks and what they hold, under normals that tilt, with all parameters, whichever way is chosen.
#[test]
fn densities_change_through_choices_and_through_parts() {
    type D = Dual<f64, 1>;
    let mut changes = 0;
    for (name, xml) in zoo() {
        let scene = load(&xml).unwrap();
        let material = scene.material(0);
        let theta = values(&scene);
        let mut next = numbers(19);
        for wo in directions() {
            let Some(s) =
                material.sample(&shading(Theta::constant(&theta), UV[0]), wo, next(), MODE)
            else {
                continue;
            };
            for k in 0..theta.len() {
                let seed = |i| D::new(0.0, [f64::from(u8::from(i == k))]);
                let tangents: Vec<Tangent<D>> = (scene.params().infos().iter())
                    .map(|info| Tangent::Dense(info.range().map(seed).collect()))
                    .collect();
                let at = shading(Theta::with_tangents(&theta, &tangents), UV[0]);
                let (o, i) = (Vec3::lift(wo), Vec3::lift(s.wi));
                let choices = material.choice_pdf(&at, o, i, s.component, MODE).eps[0];
                let continuous = s.component == Component::Continuous;
                let parts = if continuous {
                    material.eval_pdf(&at, o, i, MODE).1.eps[0]
                } else {
                    0.0
                };
                let density = |h: f64| {
                    let mut theta = theta.clone();
                    theta[k] += h;
                    let at = shading(Theta::constant(&theta), UV[0]);
                    if continuous {
                        material.eval_pdf(&at, wo, s.wi, MODE).1
                    } else {
                        material.choice_pdf(&at, wo, s.wi, s.component, MODE)
                    }
                };
                let h = 1e-5;
                let central = (density(h) - density(-h)) / (2.0 * h);
                let difference = (choices + parts - central).abs();
                assert!(
                    difference < 1e-6 * (1.0 + central.abs()),
                    "{name} {k}: {choices} + {parts}, {central}"
                );
                changes += u32::from(choices != 0.0);
            }
        }
    }
    assert!(changes > 20, "{changes}");
}

#[test]
fn inactive_parameters_get_nothing() {
    struct Only(ParamRef, Vec<f64>);
    impl GradSink<f64> for Only {
        fn active(&self, p: ParamRef) -> bool {
            p == self.0
        }
        fn add(&mut self, p: ParamRef, i: usize, d: f64) {
            assert_eq!(p, self.0);
            self.1[i] += d;
        }
    }
    for (name, xml) in zoo() {
        let scene = load(&xml).unwrap();
        let material = scene.material(0);
        let theta = values(&scene);
        let at = shading(Theta::constant(&theta), UV[0]);
        let wo = directions()[1];
        let uses = uses(material, &at, wo);
        let mut all = Gradient(vec![0.0; theta.len()]);
        material.backward(&at, wo, &uses, MODE, &mut all);
        for info in scene.params().infos() {
            let p = scene.params().handle(info);
            let mut only = Only(p, vec![0.0; info.shape.len()]);
            material.backward(&at, wo, &uses, MODE, &mut only);
            for (a, b) in only.1.iter().zip(&all.0[info.range()]) {
                assert!(
                    (a - b).abs() <= 1e-12 * (1.0 + b.abs()),
                    "{name} {}",
                    info.name
                );
            }
        }
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn samples_follow_their_density() {
    const SAMPLES: usize = 30_000;
    const ROWS: usize = 12;
    const COLUMNS: usize = 8;
    let cell = |d: Vec3<f64>| {
        let row = ((d.z + 1.0) / 2.0 * ROWS as f64) as usize;
        let phi = d.y.atan2(d.x) / std::f64::consts::TAU;
        let column = ((phi + 1.0).fract() * COLUMNS as f64) as usize;
        row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)
    };
    let tests = zoo().len() * directions().len();
    let significance = sidak(tests, 1e-3);
    for (name, xml) in zoo() {
        let scene = load(&xml).unwrap();
        let material = scene.material(0);
        let theta = values(&scene);
        let at = shading(Theta::constant(&theta), UV[0]);
        for (k, wo) in directions().into_iter().enumerate() {
            let mut next = numbers(11 + k as u64);
            let mut counts = [0.0; ROWS * COLUMNS + 1];
            for _ in 0..SAMPLES {
                let sample = material.sample(&at, wo, next(), MODE);
                if let Some(s) = &sample {
                    let chosen = material.choice_pdf(&at, wo, s.wi, s.component, MODE);
                    assert_eq!(chosen.to_bits(), s.pdf.to_bits(), "{name}");
                }
                match sample {
                    Some(s) if s.component == Component::Continuous => {
                        assert!((s.wi.length() - 1.0).abs() < 1e-9);
                        let (_, pdf) = material.eval_pdf(&at, wo, s.wi, MODE);
                        assert_eq!(pdf.to_bits(), s.pdf.to_bits(), "{name}");
                        counts[cell(s.wi)] += 1.0;
                    }
                    _ => counts[ROWS * COLUMNS] += 1.0,
                }
            }
            let mut expected = [0.0; ROWS * COLUMNS + 1];
            const SUB: usize = 20;
            let area = 4.0 * std::f64::consts::PI / (ROWS * COLUMNS * SUB * SUB) as f64;
            for i in 0..ROWS * SUB {
                let z = 2.0 * (i as f64 + 0.5) / (ROWS * SUB) as f64 - 1.0;
                let r = (1.0 - z * z).sqrt();
                for j in 0..COLUMNS * SUB {
                    let phi = std::f64::consts::TAU * (j as f64 + 0.5) / (COLUMNS * SUB) as f64;
                    let wi = Vec3::new(r * phi.cos(), r * phi.sin(), z);
                    let (_, pdf) = material.eval_pdf(&at, wo, wi, MODE);
                    assert!(pdf >= 0.0);
                    // Of a direction that another part of a blend has drawn, too.
                    if j % 16 == 0 {
                        let chosen = material.choice_pdf(&at, wo, wi, Component::Continuous, MODE);
                        assert_eq!(chosen.to_bits(), pdf.to_bits(), "{name}");
                    }
                    expected[cell(wi)] += pdf * area * SAMPLES as f64;
                }
            }
            let inside: f64 = expected.iter().sum();
            assert!(inside <= SAMPLES as f64 * 1.001, "{name}: {inside}");
            expected[ROWS * COLUMNS] = (SAMPLES as f64 - inside).max(0.0);
            let p = p_value(counts.into_iter().zip(expected));
            assert!(p > significance, "{name}, direction {k}: p = {p:e}");
        }
    }
}

/// Mean and standard error of value over density, and of its derivative along `tangents`.
fn estimate(scene: &Scene, tangents: &[Tangent<Dual<f64, 1>>], wo: Vec3<f64>) -> [[f64; 2]; 2] {
    let material = scene.material(0);
    let theta = values(scene);
    let at = shading(Theta::constant(&theta), UV[0]);
    let moving = shading(Theta::with_tangents(&theta, tangents), UV[0]);
    let mut next = numbers(3);
    const SAMPLES: usize = 100_000;
    let mut sums = [[0.0f64; 2]; 2];
    for _ in 0..SAMPLES {
        let Some(s) = material.sample(&at, wo, next(), MODE) else {
            continue;
        };
        let (wo, wi) = (Vec3::lift(wo), Vec3::lift(s.wi));
        let f = material
            .eval_component(&moving, wo, wi, s.component, MODE)
            .r;
        for (sum, x) in sums.iter_mut().zip([f.re / s.pdf, f.eps[0] / s.pdf]) {
            sum[0] += x;
            sum[1] += x * x;
        }
    }
    let n = SAMPLES as f64;
    sums.map(|[sum, squares]| {
        let mean = sum / n;
        [mean, ((squares / n - mean * mean).max(0.0) / n).sqrt()]
    })
}

fn assert_mean([mean, error]: [f64; 2], expected: f64) {
    let z = (mean - expected).abs() / (error + 1e-7);
    assert!(
        z < z_limit(14, 100_000, 1e-3),
        "{mean} +- {error}, expected {expected}"
    );
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn weights_are_unbiased_also_where_a_part_is_invisible() {
    let wo = directions()[1];
    for weight in [0.0, 0.25, 1.0] {
        let (a, b) = (0.8, 0.3);
        let parts = format!("{}{}", diffuse(a, a, a), diffuse(b, b, b));
        for (xml, value, slope) in [
            (blend(weight, &parts), a + weight * (b - a), b - a),
            (
                mask(weight, &diffuse(a, a, a)),
                1.0 + weight * (a - 1.0),
                a - 1.0,
            ),
        ] {
            let scene = load(&xml).unwrap();
            let is_weight = |name: &str| name.ends_with("weight.value") || name.contains("opacity");
            let infos = scene.params().infos();
            let tangents: Vec<_> = (infos.iter())
                .map(|info| {
                    if is_weight(&info.name) {
                        Tangent::Uniform(Dual::new(0.0, [1.0]))
                    } else {
                        Tangent::None
                    }
                })
                .collect();
            let [primal, derivative] = estimate(&scene, &tangents, wo);
            assert_mean(primal, value);
            assert_mean(derivative, slope);
        }
    }
}

#[test]
fn deltas_are_found_again_through_eight_levels() {
    // A different opacity per level, so that a swapped route shows.
    let opacity = |level: usize| 0.5 + 0.05 * level as f64;
    let mut xml = diffuse(0.5, 0.5, 0.5);
    let mut expected = 0.5;
    for level in 0..8 {
        xml = if level == 4 {
            expected = 0.3 * 0.9 + 0.7 * expected;
            blend(0.7, &format!("{}{xml}", diffuse(0.9, 0.9, 0.9)))
        } else {
            expected = 1.0 - opacity(level) + opacity(level) * expected;
            mask(opacity(level), &xml)
        };
    }
    let scene = load(&xml).unwrap();
    let tangents = vec![Tangent::None; scene.params().infos().len()];
    let [primal, _] = estimate(&scene, &tangents, directions()[1]);
    assert_mean(primal, expected);
    let error = load(&mask(0.5, &xml)).unwrap_err().to_string();
    assert!(
        error.contains(
            "scene.xml:2: `bsdf`: expected materials nested at most 8 levels deep, found 9"
        ),
        "{error}"
    );
}

#[test]
fn holes_let_light_straight_through() {
    let scene = load(&mask(0.25, &diffuse(0.5, 0.5, 0.5))).unwrap();
    let theta = values(&scene);
    let at = shading(Theta::constant(&theta), UV[0]);
    let material = scene.material(0);
    for wo in directions() {
        let s = material.sample(&at, wo, [0.1, 0.2, 0.3], MODE).unwrap();
        let Component::Delta { kind, route } = s.component else {
            panic!("{s:?}");
        };
        assert_eq!((kind, s.wi, s.eta), (DeltaKind::Passthrough, -wo, 1.0));
        let f = material.eval_delta(&at, wo, s.wi, kind, route, MODE);
        assert_eq!(f, Rgb::splat(0.75));
    }
}

/// What surrounds a tilted piece of glass does not change how much it refracts of particles.
#[test]
fn tilted_glass_refracts_the_same_within_others() {
    let tilted = normal_map(GLASS, "");
    let dark = diffuse(0.0, 0.0, 0.0);
    let refracted = |xml: &str| {
        let scene = load(xml).unwrap();
        let theta = values(&scene);
        let at = shading(Theta::constant(&theta), UV[0]);
        let (material, wo) = (scene.material(0), directions()[1]);
        let mut next = numbers(5);
        for _ in 0..1000 {
            let sample = material.sample(&at, wo, next(), TransportMode::Importance);
            let Some(s) = sample.filter(|s| s.wi.z < 0.0 && s.wi != -wo) else {
                continue;
            };
            let (wo, wi) = (Vec3::lift(wo), Vec3::lift(s.wi));
            return material
                .eval_component(&at, wo, wi, s.component, TransportMode::Importance)
                .r;
        }
        panic!("nothing is refracted by {xml}");
    };
    let alone: f64 = refracted(&tilted);
    for (within, share) in [
        (mask(0.25, &tilted), 0.25),
        (blend(0.7, &format!("{dark}{tilted}")), 0.7),
        (blend(0.3, &format!("{tilted}{dark}")), 0.7),
    ] {
        let value = refracted(&within) / share;
        assert!((value / alone - 1.0).abs() < 1e-6, "{value} {alone}");
    }
}

#[test]
fn two_sided_shows_the_right_side() {
    let (red, blue) = (diffuse(0.8, 0.0, 0.0), diffuse(0.0, 0.0, 0.7));
    let scene = load(&two_sided(&format!("{red}{blue}"))).unwrap();
    let names: Vec<_> = scene.params().infos().iter().map(|i| &i.name[..]).collect();
    let expected = [
        "s.bsdf.brdf_0.reflectance.value",
        "s.bsdf.brdf_1.reflectance.value",
    ];
    assert_eq!(names, expected);
    let theta = values(&scene);
    let at = shading(Theta::constant(&theta), UV[0]);
    let material = scene.material(0);
    let z = |z: f64| Vec3::new(0.6, 0.0, z);
    let eval = |o: f64, i: f64| material.eval(&at, z(o), z(i), MODE);
    let inv_pi = std::f64::consts::FRAC_1_PI;
    assert!((eval(0.8, 0.8).r - 0.8 * 0.8 * inv_pi).abs() < 1e-7);
    assert!((eval(-0.8, -0.8).b - 0.7 * 0.8 * inv_pi).abs() < 1e-7);
    assert_eq!(eval(-0.8, -0.8).r, 0.0);
    assert!(eval(0.8, -0.8).is_black() && eval(-0.8, 0.8).is_black());
}

/// A scene whose normal map has these texels, in one row.
fn with_normals(texels: &[[f32; 3]], extra: &str) -> Scene {
    with_normals_over(&diffuse(0.5, 0.6, 0.7), texels, extra)
}

/// [`with_normals`] of another material.
fn with_normals_over(nested: &str, texels: &[[f32; 3]], extra: &str) -> Scene {
    let mut scene = load(&normal_map(nested, extra)).unwrap();
    // The map has 3 x 2 texels: the columns are repeated in both rows.
    let info = scene
        .params()
        .find("s.bsdf.normalmap.data")
        .unwrap()
        .clone();
    let mut theta = scene.params().values().to_vec();
    for i in 0..6 {
        let at = info.offset + 3 * i;
        theta[at..at + 3].copy_from_slice(&texels[(i % 3).min(texels.len() - 1)]);
    }
    scene.set_params(&theta).unwrap();
    scene
}

fn encode(n: [f64; 3]) -> [f32; 3] {
    n.map(|x| ((x + 1.0) / 2.0) as f32)
}

#[test]
fn normal_maps_agree_with_mitsuba() {
    // Mitsuba 3.9.1, `eval` of a diffuse surface with reflectances 0.5, 0.6, 0.7: its wi and wo, and the red
    // value without corrections, with shadowing, with flipped normals, with both.
    let wide = [0.5, 0.2, 0.8];
    let steep = [0.9, 0.3, 0.3];
    let [up, left, away] = [[0.0, 0.0, 1.0], [-0.6, 0.0, 0.8], [-0.95, 0.0, 0.31]];
    for (normal, o, i, values) in [
        (
            wide,
            up,
            [0.3, 0.4, 0.866],
            [0.152299, 0.151586, 0.152299, 0.151586],
        ),
        (wide, up, [-0.9, 0.0, 0.43], [0.0; 4]),
        (
            wide,
            left,
            [0.9, 0.1, 0.4],
            [0.131702, 0.123322, 0.131702, 0.123322],
        ),
        (
            wide,
            away,
            [0.3, 0.4, 0.866],
            [0.0, 0.0, 0.076380, 0.076023],
        ),
        (
            wide,
            away,
            [-0.7, -0.1, 0.2],
            [0.0, 0.0, 0.119030, 0.103195],
        ),
        (
            steep,
            up,
            [0.3, 0.4, 0.866],
            [0.103942, 0.096479, 0.103942, 0.096479],
        ),
        (steep, left, [0.9, 0.1, 0.4], [0.0; 4]),
        (
            steep,
            away,
            [-0.7, -0.1, 0.2],
            [0.0, 0.0, 0.156725, 0.067059],
        ),
    ] {
        let n = Vec3::from(normal).normalize().to_array();
        let (o, i) = (Vec3::from(o).normalize(), Vec3::from(i).normalize());
        for (k, value) in values.into_iter().enumerate() {
            let options = correct(k & 2 != 0, k & 1 != 0);
            let scene = with_normals(&[encode(n)], &format!("{SLOPES_OFF}{options}"));
            let theta = self::values(&scene);
            let at = shading(Theta::constant(&theta), UV[0]);
            let f = scene.material(0).eval(&at, o, i, MODE);
            for (f, reflectance) in f.to_array().into_iter().zip([0.5, 0.6, 0.7]) {
                let expected = value * reflectance / 0.5;
                assert!(
                    (f - expected).abs() < 2e-6,
                    "{o:?} {i:?} {options}: {f} {expected}"
                );
            }
        }
    }
}

/// Reflectance of a mirror below flipped and shadowed normals, from the same source.
#[test]
fn shadowing_darkens_mirrors() {
    let n = Vec3::new(0.5, 0.2, 0.8).normalize().to_array();
    let mirror = r#"<bsdf type="conductor"/>"#;
    let scene = with_normals_over(mirror, &[encode(n)], &correct(true, true));
    let theta = values(&scene);
    let at = shading(Theta::constant(&theta), UV[0]);
    for (o, i, value) in [
        ([0.0, 0.0, 1.0], [0.860215, 0.344086, 0.376344], 0.926358),
        (
            [-0.95, 0.0, 0.31],
            [0.172701, -0.311186, 0.934525],
            0.997955,
        ),
    ] {
        let wo = Vec3::from(o).normalize();
        let s = scene.material(0).sample(&at, wo, [0.3; 3], MODE).unwrap();
        assert!((s.wi - Vec3::from(i)).length() < 2e-6, "{:?}", s.wi);
        let f = scene
            .material(0)
            .eval_component(&at, wo, s.wi, s.component, MODE);
        assert!((f.r - value).abs() < 2e-6, "{f:?}");
    }
}

/// Everything that scatters is seen by somebody: no viewer above the surface meets the back of a normal.
#[test]
fn flipped_normals_face_every_viewer() {
    let n = Vec3::new(0.9, 0.3, 0.3).normalize().to_array();
    let scene = with_normals(
        &[encode(n)],
        &format!("{SLOPES_OFF}{}", correct(true, false)),
    );
    let theta = values(&scene);
    let at = shading(Theta::constant(&theta), UV[0]);
    let material = scene.material(0);
    let mut next = numbers(17);
    for _ in 0..1000 {
        let [x, y, z] = next();
        let wo = Vec3::new(2.0 * x - 1.0, 2.0 * y - 1.0, z + 1e-6).normalize();
        assert!(
            (0..100).any(|_| material.sample(&at, wo, next(), MODE).is_some()),
            "{wo:?}"
        );
        let particle = material.sample(&at, wo, next(), TransportMode::Importance);
        assert!(particle.is_none() || wo.dot(Vec3::from(n)) > 0.0);
    }
}

#[test]
fn slopes_or_normals_are_interpolated() {
    // Half way between a slope of 3/4 and none.
    let texels = [encode([0.6, 0.0, 0.8]), encode([0.0, 0.0, 1.0])];
    for (extra, slope) in [("", 0.375), (SLOPES_OFF, 1.0 / 3.0)] {
        let scene = with_normals(&texels, extra);
        let theta = values(&scene);
        let at = shading(Theta::constant(&theta), [1.0 / 3.0, 0.5]);
        let up = Vec3::new(0.0, 0.0, 1.0);
        let f = scene.material(0).eval(&at, up, up, MODE).r;
        let cos = 1.0 / f64::hypot(1.0, slope);
        assert!((f - 0.5 * std::f64::consts::FRAC_1_PI * cos).abs() < 1e-7);
    }
}

#[test]
fn faulty_descriptions_are_named() {
    let d = diffuse(0.5, 0.5, 0.5);
    let weightless = format!(r#"<bsdf type="blendbsdf">{d}{d}</bsdf>"#);
    let flip = r#"<string name="flip_invalid_normals" value="often"/>"#;
    for (xml, expected) in [
        (two_sided(""), "one or two nested <bsdf>"),
        (two_sided(&format!("{d}{d}{d}")), "found 3 of them"),
        (
            two_sided(&mask(0.5, &d)),
            "a nested <bsdf> that only reflects, found bsdf `mask`",
        ),
        (
            two_sided(&blend(0.5, &format!("{d}{}", mask(0.5, &d)))),
            "a nested <bsdf> that only reflects, found bsdf `blendbsdf`",
        ),
        (
            two_sided(r#"<bsdf type="null"/>"#),
            "a nested <bsdf> that only reflects, found bsdf `null`",
        ),
        (
            two_sided(r#"<bsdf type="thindielectric"/>"#),
            "a nested <bsdf> that only reflects, found bsdf `thindielectric`",
        ),
        (blend(0.5, &d), "two nested <bsdf>"),
        (weightless, "has no `weight`"),
        (blend(1.5, &format!("{d}{d}")), "weight.value"),
        (mask(-0.1, &d), "opacity.value"),
        (mask(0.5, ""), "one nested <bsdf>"),
        (normal_map("", ""), "one nested <bsdf>"),
        (normal_map(&d, flip), "flip_invalid_normals"),
        (
            format!(r#"<bsdf type="normalmap">{d}</bsdf>"#),
            "has no `filename`",
        ),
        (
            format!(r#"<bsdf type="bumpmap">{d}</bsdf>"#),
            "has no `texture`",
        ),
        (bump_map(1.0, "", ""), "one nested <bsdf>"),
        (bump_map(1.0, &d, WEIGHTS), "<texture>"),
        (
            format!(r#"<bsdf type="bumpmap"><texture name="a" type="checkerboard"/>{d}</bsdf>"#),
            "the slope of heights other than those of an image is not there",
        ),
    ] {
        let error = load(&xml).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

/// Whoever wrote a scene for Mitsuba 3.9 sees its corrections there.
#[test]
fn maps_without_corrections_are_warned_of() {
    let map = |extra: &str| {
        let texture = r#"<texture name="normalmap" type="bitmap"><string name="filename" value="normals.exr"/></texture>"#;
        let nested = diffuse(0.5, 0.5, 0.5);
        let bsdf = format!(r#"<bsdf type="normalmap">{texture}{extra}{nested}</bsdf>"#);
        loaded(&bsdf).unwrap().1
    };
    let flip = r#"<boolean name="flip_invalid_normals" value="false"/>"#;
    for extra in ["", flip] {
        let [warning] = &map(extra)[..] else {
            panic!("{extra}: {:?}", map(extra));
        };
        assert!(
            warning.contains("Mitsuba 3.9 turns those over"),
            "{warning}"
        );
    }
    for both in [correct(false, false), correct(true, true)] {
        assert_eq!(map(&both), Vec::<String>::new());
    }
    // That of older programs.
    let (_, warnings) = loaded(&normal_map(&diffuse(0.5, 0.5, 0.5), "")).unwrap();
    assert_eq!(warnings, Vec::<String>::new());
}

#[test]
fn normals_over_deltas_are_marked() {
    let scene = load(&normal_map(&diffuse(0.5, 0.5, 0.5), "")).unwrap();
    let of = |scene: &Scene| {
        let info = scene.params().find("s.bsdf.normalmap.data").unwrap();
        info.kind
    };
    assert_eq!(of(&scene), ParamKind::Normals);
    let mirror = r#"<bsdf type="conductor"/>"#;
    let partly = blend(0.5, &format!("{}{mirror}", diffuse(0.5, 0.5, 0.5)));
    for nested in [mirror.to_owned(), two_sided(mirror), partly] {
        let scene = load(&normal_map(&nested, "")).unwrap();
        assert_eq!(of(&scene), ParamKind::Delta, "{nested}");
    }
}

#[test]
fn sideways_normals_still_have_a_slope() {
    // x = 0.005, z = 0: a slope of 0.005 over the least z.
    let scene = with_normals(&[[0.5025, 0.5, 0.5]], "");
    let theta = values(&scene);
    let at = shading(Theta::constant(&theta), UV[0]);
    let up = Vec3::new(0.0, 0.0, 1.0);
    let f = scene.material(0).eval(&at, up, up, MODE).r;
    let cos = 1.0 / f64::hypot(1.0, 0.5);
    assert!((f - 0.5 * std::f64::consts::FRAC_1_PI * cos).abs() < 1e-4);
}

proptest! {
    /// Any texel, any pair of directions: values, densities and derivatives are finite.
    #[test]
    fn degenerate_normals_are_harmless(
        texel in prop::array::uniform3(prop::sample::select(vec![-1.0f32, 0.0, 0.25, 0.5, 0.505, 1.0, 2.0])),
        other in prop::array::uniform3(prop::sample::select(vec![0.0f32, 0.5, 1.0])),
        u in prop::array::uniform3(0.0f32..1.0),
        v in prop::array::uniform2(-1.0f32..1.0),
        [slopes, flip, shadowing] in any::<[bool; 3]>(),
    ) {
        let slopes = format!(r#"<boolean name="use_slopes" value="{slopes}"/>"#);
        let extra = slopes + &correct(flip, shadowing);
        let scene = with_normals(&[texel, other], &extra);
        let material = scene.material(0);
        let theta = scene.params().values();
        let tangents: Vec<Tangent<Dual<f32, 1>>> = (scene.params().infos().iter())
            .map(|_| Tangent::Uniform(Dual::new(0.0, [1.0])))
            .collect();
        let at = Shading::new(Theta::with_tangents(theta, &tangents), Vec2::new(Dual::lift(u[0]), Dual::lift(u[1])));
        let z = 1.0 - 2.0 * u[2];
        let wo = Vec3::new(v[0], v[1], z).normalize();
        if let Some(s) = material.sample(&at.primal(), wo, u, MODE) {
            prop_assert!(s.wi.is_finite() && s.pdf.is_finite() && s.pdf > 0.0);
            let f = material.eval_component(&at, Vec3::lift(wo), Vec3::lift(s.wi), s.component, MODE);
            prop_assert!(f.is_finite());
        }
        let moving = material.sample(&at, Vec3::lift(wo), u, MODE);
        prop_assert!(moving.is_none_or(|s| s.wi.is_finite() && s.pdf.is_finite()));
        let wi = Vec3::lift(Vec3::new(-v[1], v[0], z).normalize());
        let (f, pdf) = material.eval_pdf(&at, Vec3::lift(wo), wi, MODE);
        prop_assert!(f.is_finite() && pdf.is_finite());
    }
}
