//! Every estimator of derivatives against finite differences and against each other: unbiased ones
//! agree, biased ones are noticed, forward and reverse mode are the same sum.

use std::sync::Arc;

use ad_core::Dual;
use render::Job;
use render::bsdf::{Conductor, Interpolation, NormalMap};
use render::estimator::{AllowBias, Attached, AttachedRoulette, BsdfOnly, Detached, EmitterOnly};
use render::instances::{Direction, Estimator, forward_f32, forward_f64, render_f32};
use render::integrator::render::render;
use render::params::{ParamKind, Tangent, Theta};
use render::sampler::Independent;
use render::scene::{Builder, LightChoice};
use render::{RenderError, Scene, Settings};
use tests::stats::{Estimate, z_limit};
use tests::{dot, forward_by, image, mean_adjoint, scene, values};

const REPEATS: u64 = 32;
const ALPHA: f64 = 1e-3;

fn camera(size: u32, depth: u32) -> String {
    format!(
        r#"<sensor type="perspective">
        <float name="fov" value="30"/>
        <transform name="to_world"><lookat origin="0, 2.2, 3.6" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="{size}"/><integer name="height" value="{size}"/>
            <rfilter type="box"/>
        </film>
        </sensor>
        <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>"#
    )
}

fn plate(ndf: &str, alpha: f64) -> String {
    format!(
        r#"<shape type="rectangle" id="plate">
        <transform name="to_world"><rotate x="1" angle="-90"/></transform>
        <bsdf type="roughconductor" id="metal">
            <string name="material" value="Cu"/>
            <string name="distribution" value="{ndf}"/><float name="alpha" value="{alpha}"/>
            <boolean name="sample_visible" value="false"/>
        </bsdf></shape>"#
    )
}

const BALL_LIGHT: &str = r#"<shape type="sphere" id="light">
    <point name="center" value="0, 2, -3.2"/><float name="radius" value="0.5"/>
    <emitter type="area"><rgb name="radiance" value="4, 3, 2"/></emitter></shape>"#;

const LOBES: &str = r#"
    <emitter type="vmf"><vector name="direction" value="0.1, 0.55, -0.8"/><float name="kappa" value="12"/>
        <rgb name="radiance" value="3, 2, 1"/></emitter>
    <emitter type="constant"><rgb name="radiance" value="0.2, 0.3, 0.4"/></emitter>"#;

const OFF: &str = r#"<emitter type="point"><point name="position" value="1, 2, 1"/>
    <rgb name="intensity" value="0"/></emitter>"#;

/// Half of the plate's light is hidden by a ball.
const BLOCKER: &str = r#"<shape type="sphere"><point name="center" value="0.3, 1, -1.6"/>
    <float name="radius" value="0.4"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.1"/></bsdf></shape>"#;

struct Case {
    name: &'static str,
    scene: Scene,
    param: &'static str,
    spp: u64,
}

fn cases() -> Vec<Case> {
    let plate_scene = |ndf: &str, alpha: f64, rest: &str, depth: u32| {
        scene(&format!("{}{}{rest}", camera(6, depth), plate(ndf, alpha)))
    };
    let wall = r#"<shape type="rectangle" id="wall">
        <transform name="to_world"><translate z="-1"/></transform>
        <bsdf type="roughconductor" id="wall_metal"><string name="material" value="Al"/>
        <string name="distribution" value="ggx"/><float name="alpha" value="0.3"/></bsdf></shape>"#;
    let between = format!("{BALL_LIGHT}{wall}{LOBES}");
    vec![
        Case {
            name: "plate under a ball light",
            scene: plate_scene("beckmann", 0.12, BALL_LIGHT, 2),
            param: "metal.alpha.value",
            spp: 1500,
        },
        Case {
            name: "plate under smooth lobes",
            scene: plate_scene("ggx", 0.2, LOBES, 2),
            param: "metal.alpha.value",
            spp: 1500,
        },
        Case {
            name: "plate under lobes half hidden, sampled unevenly",
            scene: unevenly(plate_scene("ggx", 0.2, &format!("{LOBES}{BLOCKER}"), 2)),
            param: "metal.alpha.value",
            spp: 1500,
        },
        Case {
            name: "glossy interreflection",
            scene: plate_scene("ggx", 0.15, &between, 4),
            param: "metal.alpha.value",
            spp: 1500,
        },
        Case {
            name: "plate under smooth lobes, all weighed",
            scene: weighed(plate_scene("ggx", 0.2, LOBES, 2)),
            param: "metal.alpha.value",
            spp: 500,
        },
        Case {
            name: "glossy interreflection, all lights weighed",
            scene: weighed(plate_scene("ggx", 0.15, &between, 4)),
            param: "metal.alpha.value",
            spp: 500,
        },
    ]
}

fn settings(scene: &Scene) -> Settings {
    scene.settings
}

/// With all lights weighed at every point.
fn weighed(mut scene: Scene) -> Scene {
    scene.settings.lights = LightChoice::All;
    scene
}

/// With lights of different sampling weights.
fn unevenly(mut scene: Scene) -> Scene {
    let weights: Vec<f64> = (0..scene.emitters().len())
        .map(|i| 0.5 + 2.0 * i as f64)
        .collect();
    assert!(weights.len() > 1);
    scene.set_sampling_weights(&weights).expect("positive");
    scene
}

/// Mean over pixels and channels of the derivative image, over independent repeats.
fn derivative(e: Estimator, case: &Case, seed: u64) -> Estimate {
    let s = &case.scene;
    let direction = Direction::uniform(s.params(), case.param).expect("a parameter");
    let means: Vec<f64> = (0..REPEATS)
        .map(|r| {
            let image = e
                .forward_f32(
                    &Job::new(s, &settings(s), seed * 1000 + r, 0..case.spp, &()),
                    s.params().values(),
                    std::slice::from_ref(&direction),
                )
                .expect("an estimator that is allowed here");
            assert_eq!(image.non_finite.count, 0, "{} {}", case.name, e.name());
            image.mean(1).iter().sum::<f64>() / 3.0
        })
        .collect();
    Estimate::of(&means)
}

/// Central differences of images made by light sampling alone: smooth in roughness with common random
/// numbers where light takes one bounce.
fn differences(case: &Case) -> Estimate {
    let s = &case.scene;
    let info = s.params().find(case.param).expect("a parameter");
    let h = 1e-4;
    let means: Vec<f64> = (0..REPEATS)
        .map(|r| {
            let at = |sign: f64| {
                let mut v = values::<f64>(s);
                v[info.offset] += sign * h;
                let theta = Theta::constant(&v);
                let settings = Settings {
                    lights: LightChoice::One,
                    ..settings(s)
                };
                let image = render::<f64, EmitterOnly<Detached>, Independent>(
                    &Job::new(s, &settings, 77_000 + r, 0..case.spp, &()),
                    &theta,
                )
                .expect("nothing moves");
                image.mean(0).iter().sum::<f64>() / 3.0
            };
            (at(1.0) - at(-1.0)) / (2.0 * h)
        })
        .collect();
    Estimate::of(&means)
}

fn biased(e: Estimator) -> bool {
    matches!(
        e,
        Estimator::AttachedNaive
            | Estimator::AttachedMisNaive
            | Estimator::BiasedWeights
            | Estimator::BiasedAttachedWeights
            | Estimator::BiasedRoulette
            | Estimator::BiasedChoice
            | Estimator::BiasedMixed
    )
}

/// What `estimator_matrix` has not: smooth lobes, lights of different shares, all of them weighed. 32 x 36 x 1500 = 1.7e6
/// samples per estimate, a third where lights are weighed; significance 1e-3 over all comparisons.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn unbiased_estimators_equal_finite_differences() {
    let cases = cases();
    let compared = [1, 2, 4, 5];
    let limit = z_limit(compared.len() * Estimator::ALL.len(), REPEATS, ALPHA);
    let mut failed = Vec::new();
    for case in compared.map(|i| &cases[i]) {
        let one_bounce = case.scene.settings.max_depth == 2;
        let reference = if one_bounce {
            differences(case)
        } else {
            derivative(Estimator::Mis, &cases[3], 1)
        };
        println!(
            "{}: reference {:.6} +- {:.6}",
            case.name, reference.mean, reference.se
        );
        for (i, &e) in Estimator::ALL.iter().enumerate() {
            if biased(e) || e.check(&case.scene).is_err() {
                continue;
            }
            let d = derivative(e, case, 10 + i as u64);
            let z = d.z(&reference);
            println!(
                "  {:<34} {:>10.6} +- {:.6}  z {z:>6.2}",
                e.name(),
                d.mean,
                d.se
            );
            if z.abs() > limit {
                failed.push(format!("{} in {}: z = {z:.2}", e.name(), case.name));
            }
        }
    }
    assert!(failed.is_empty(), "limit {limit:.2}: {failed:#?}");
}

/// The same test notices what is biased on purpose. (What naive attached samples miss here, light sampling
/// covers: `attached-mis-naive` is noticed on the smoother plate of the figure `zeltner-tab-4-5-1`.)
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn biased_estimators_are_noticed() {
    let cases = cases();
    let noticed = |e: Estimator, case: &Case| {
        let z = derivative(e, case, 500).z(&differences(case));
        println!("{} in {}: z {z:.1}", e.name(), case.name);
        z.abs() > 5.0
    };
    assert!(noticed(Estimator::AttachedNaive, &cases[0]));
    assert!(noticed(Estimator::AttachedNaive, &cases[2]));
    for e in [
        Estimator::BiasedWeights,
        Estimator::BiasedAttachedWeights,
        Estimator::BiasedMixed,
    ] {
        assert!(cases[..3].iter().any(|c| noticed(e, c)), "{}", e.name());
    }
}

/// The picture does not depend on how lights are chosen: 64 pixels by 3 channels, 2e5 samples each, with and without
/// scattered directions that find lights, in f32. A light that is off keeps its share.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn however_lights_are_chosen_the_picture_is_the_same() {
    let xml = format!(
        "{}{}{BALL_LIGHT}{LOBES}{BLOCKER}{OFF}",
        camera(8, 4),
        plate("ggx", 0.2)
    );
    let unevenly = unevenly(scene(&xml));
    let scene = scene(&xml);
    let limit = z_limit(2 * 2 * 64 * 3, 20, ALPHA);
    for estimator in [Estimator::Mis, Estimator::Emitter] {
        let pictures = |scene: &Scene, lights, seed: u64| -> Vec<Vec<f64>> {
            let settings = Settings {
                lights,
                ..scene.settings
            };
            let theta = Theta::constant(scene.params().values());
            (0..20)
                .map(|r| {
                    let seed = seed + r;
                    let image = render_f32(
                        &Job::new(scene, &settings, seed, 0..10_000, &()),
                        &theta,
                        estimator,
                    );
                    assert_eq!(image.non_finite.count, 0);
                    image.sums[0].clone()
                })
                .collect()
        };
        let one = pictures(&scene, LightChoice::One, 100);
        let all = pictures(&scene, LightChoice::All, 200);
        let uneven = pictures(&unevenly, LightChoice::One, 300);
        for (how, other) in [("all", all), ("uneven", uneven)] {
            for i in 0..64 * 3 {
                let at = |p: &[Vec<f64>]| Estimate::of(&p.iter().map(|p| p[i]).collect::<Vec<_>>());
                let z = at(&other).z(&at(&one));
                assert!(
                    z.abs() < limit,
                    "{estimator:?}, {how}, {i}: z = {z:.2} of {limit:.2}"
                );
            }
        }
    }
}

/// A smooth plate mirrors a lit wall: both samples of the pair find it equally bright, and their sum hardly
/// varies, although three of four samples of the lights at the wall are dark: they are the same for both.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn the_pair_sees_light_that_is_reflected_on() {
    let wall = r#"<shape type="rectangle">
        <transform name="to_world"><scale value="8"/><translate z="-4"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf></shape>
        <emitter type="point"><point name="position" value="0, 3, 2"/>
        <rgb name="intensity" value="40"/></emitter>"#;
    let case = Case {
        name: "plate before a wall",
        scene: scene(&format!(
            "{}{}{wall}{OFF}{OFF}{OFF}",
            camera(6, 3),
            plate("ggx", 0.03)
        )),
        param: "metal.alpha.value",
        spp: 64,
    };
    let [mis, pair] = [Estimator::Mis, Estimator::DifferentialMis].map(|e| derivative(e, &case, 5));
    let ratio = (pair.se / mis.se).powi(2);
    assert!(ratio < 0.05, "{ratio}: {pair:?} {mis:?}");
    assert!(
        mis.z(&pair).abs() < z_limit(1, REPEATS, ALPHA),
        "{pair:?} {mis:?}"
    );
}

/// Only roughness has a pair, and no other derivative changes with it: the reflectance alone has the gradient, to
/// the last bit, that it has beside roughness, and the derivative image that it has without a pair.
#[test]
fn the_pair_serves_roughness_alone() {
    let names = ["metal.specular_reflectance.value", "metal.alpha.value"];
    for case in cases() {
        let s = &case.scene;
        let theta = Theta::constant(s.params().values());
        let adjoint = mean_adjoint(s);
        let of = |names: &[&str]| {
            let e = Estimator::DifferentialMis;
            let active = e.active(s, names).expect("parameters");
            let g = e.backward_f32(
                &Job::new(s, &settings(s), 9, 0..64, &()),
                &theta,
                &active,
                &adjoint,
            );
            g.expect("allowed").values.swap_remove(0)
        };
        let alone = of(&names[..1]);
        assert!(alone.iter().any(|&g| g != 0.0), "{}", case.name);
        assert_eq!(alone, of(&names), "{}", case.name);
        // In forward mode it is not even drawn.
        let direction = [Direction::uniform(s.params(), names[0]).expect("a parameter")];
        let image = |e: Estimator| {
            let image = e.forward_f32(
                &Job::new(s, &settings(s), 9, 0..64, &()),
                s.params().values(),
                &direction,
            );
            image.expect("allowed").sums
        };
        let [mis, pair] = [Estimator::Mis, Estimator::DifferentialMis].map(image);
        assert_eq!(mis, pair, "{}", case.name);
    }
}

/// Reverse mode is the same estimate as forward mode, sample by sample: equal to rounding of f32.
#[test]
fn reverse_mode_equals_forward_mode() {
    for case in cases() {
        let s = &case.scene;
        let direction = Direction::uniform(s.params(), case.param).expect("a parameter");
        for &e in Estimator::ALL {
            if e.check(s).is_err() {
                continue;
            }
            let image = e
                .forward_f32(
                    &Job::new(s, &settings(s), 3, 0..64, &()),
                    s.params().values(),
                    std::slice::from_ref(&direction),
                )
                .expect("allowed");
            let forward = image.mean(1).iter().sum::<f64>() / 3.0;
            let active = e.active(s, &[case.param]).expect("a parameter");
            let theta = Theta::constant(s.params().values());
            let adjoint = mean_adjoint(s);
            let gradient = e
                .backward_f32(
                    &Job::new(s, &settings(s), 3, 0..64, &()),
                    &theta,
                    &active,
                    &adjoint,
                )
                .expect("allowed");
            let reverse: f64 = gradient.values[0].iter().sum();
            let close = (forward - reverse).abs() < 2e-4 * forward.abs().max(1e-2);
            assert!(close, "{} in {}: {forward} {reverse}", e.name(), case.name);
        }
    }
}

/// Naive attached sampling is refused where something may occlude (F8).
#[test]
fn naive_attached_sampling_is_refused_where_it_is_biased() {
    let cases = cases();
    for e in [
        Estimator::Attached,
        Estimator::AttachedPath,
        Estimator::AttachedMis,
        Estimator::AttachedBoth,
        Estimator::EmitterAttached,
    ] {
        assert!(e.check(&cases[0].scene).is_err());
        assert!(e.check(&cases[1].scene).is_ok());
        let message = e.check(&cases[2].scene).unwrap_err().to_string();
        assert!(message.contains("occlusion"), "{message}");
    }
    assert!(Estimator::Reparameterised.check(&cases[0].scene).is_ok());
}

/// Whole paths slide over what is behind a vertex: edges and textures that jump there bias them, and only them (F8).
#[test]
fn paths_do_not_slide_over_edges_and_jumps() {
    let lit = |shape: &str, tint: &str| {
        let glass = format!(r#"<bsdf type="dielectric">{tint}</bsdf>"#);
        let shape = format!(r#"<shape type="{shape}" id="thing">{glass}</shape>"#);
        scene(&format!("{}{shape}{LOBES}", camera(6, 5)))
    };
    let checks = r#"<texture name="specular_transmittance" type="checkerboard"/>"#;
    let cases = [
        (lit("sphere", ""), None),
        (lit("cube", ""), Some("edges of `thing`")),
        (lit("sphere", checks), Some("texture of `thing` that jumps")),
        (lit("rectangle", checks), None),
    ];
    for (s, culprit) in &cases {
        assert!(Estimator::Attached.check(s).is_ok());
        match (Estimator::AttachedPath.check(s), culprit) {
            (Ok(()), None) => {}
            (Err(e), Some(culprit)) => assert!(e.to_string().contains(culprit), "{e}"),
            (found, _) => panic!("expected {culprit:?}, found {found:?}"),
        }
    }
}

/// The library's own forward mode refuses what tools refuse, instead of giving zero: a scene made by code, and one from a
/// file (F2, F8).
#[test]
fn forward_mode_refuses_deltas_and_discontinuities() {
    let s = glass().scene;
    let eta = Direction::uniform(s.params(), "glass.eta.value").expect("a parameter");
    let (values, direction) = (s.params().values(), std::slice::from_ref(&eta));
    let single = forward_f32(&Job::new(&s, &s.settings, 1, 0..1, &()), values, direction);
    let double = forward_f64(&Job::new(&s, &s.settings, 1, 0..1, &()), &eta);
    for found in [single, double] {
        assert!(matches!(found, Err(RenderError::DeltaParameter { .. })));
    }

    let mut build = Builder::new();
    let texels = [0.5, 0.5, 1.0, 0.6, 0.5, 0.9];
    let map = build
        .texels("map", [2, 1], &texels, (0.0, 1.0))
        .expect("two texels");
    let mirror = Conductor {
        index: None,
        specular_reflectance: build.rgb("mirror", [1.0; 3], (0.0, 1.0)).expect("white"),
    };
    let mapped = NormalMap::new(map, Interpolation::Normals, Arc::new(mirror.into()));
    build.add_material(mapped.expect("one level"));
    let (camera, film) = (s.camera.clone(), s.film);
    let made = build.build(camera, film, s.settings).expect("a scene");
    assert!(Estimator::Mis.active(&made, &["map.data"]).is_err());
    assert!(Estimator::AttachedPath.active(&made, &["map.data"]).is_ok());

    let hidden = &cases()[2].scene;
    let moving = values_with_tangent(hidden);
    let theta = Theta::with_tangents(hidden.params().values(), &moving);
    let found = render::<Dual<f32, 1>, BsdfOnly<Attached>, Independent>(
        &Job::new(hidden, &hidden.settings, 1, 0..1, &()),
        &theta,
    );
    assert!(matches!(found, Err(RenderError::Discontinuous { .. })));
}

/// One number is added to everything.
fn values_with_tangent(s: &Scene) -> Vec<Tangent<Dual<f32, 1>>> {
    vec![Tangent::Uniform(Dual::new(0.0, [1.0])); s.params().infos().len()]
}

/// A mirror whose normals are turned, in a gradient environment: the derivative that constant directions cannot see (F2)
/// equals differences of the same samples to 1e-4, in both modes.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn normals_of_a_mirror_have_a_derivative() {
    let plate = r#"<shape type="rectangle" id="plate">
        <transform name="to_world"><rotate x="1" angle="-90"/></transform>
        <bsdf type="normalmap" id="map">
            <texture name="normalmap" type="checkerboard"><rgb name="color0" value="0.6, 0.45, 0.95"/>
                <rgb name="color1" value="0.48, 0.55, 0.98"/></texture>
            <bsdf type="conductor"><string name="material" value="Cu"/></bsdf></bsdf></shape>"#;
    let s = &scene(&format!("{}{plate}{LOBES}", camera(8, 3)));
    let name = "map.normalmap.color0.value";
    let (info, spp) = (s.params().find(name).expect("a parameter"), 16);
    let adjoint = mean_adjoint(s);
    for channel in 0..3 {
        let mut direction = vec![0.0; s.params().values().len()];
        direction[info.offset + channel] = 1.0;
        let forward =
            forward_by::<BsdfOnly<Attached>>(s, &direction, &adjoint, &s.settings, 5, spp);
        let at = |h: f64| {
            let mut v = values::<f64>(s);
            v[info.offset + channel] += h;
            dot(&adjoint, &image(s, &v, &s.settings, 5, spp), 0)
        };
        let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
        let close = (forward - difference).abs() < 1e-4 * difference.abs();
        assert!(close && difference.abs() > 0.01, "{forward} {difference}");

        let moving = Estimator::AttachedPath;
        let active = moving.active(s, &[name]).expect("a moving path");
        let theta = Theta::constant(s.params().values());
        let gradient = moving
            .backward_f32(
                &Job::new(s, &s.settings, 5, 0..spp, &()),
                &theta,
                &active,
                &adjoint,
            )
            .expect("allowed");
        let reverse = gradient.values[0][channel];
        assert!(
            (reverse - forward).abs() < 1e-3 * forward.abs(),
            "{reverse} {forward}"
        );
    }
}

/// A grey plate of albedo rho under a constant sky, roulette from the first bounce: survival has the probability rho, so
/// that a weight 1 / rho that is differentiated hides the derivative, which is the light that arrives (F5). In a room
/// where everything counts, forward and reverse mode have the same wrong derivative, and it is noticed.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn roulette_that_is_differentiated_is_wrong_and_noticed() {
    type Wrong = AllowBias<AttachedRoulette<BsdfOnly<Detached>>>;
    let sky = r#"<emitter type="constant"><rgb name="radiance" value="0.6"/></emitter>"#;
    let plate = r#"<shape type="rectangle"><transform name="to_world"><scale value="9"/><rotate x="1" angle="-90"/>
        </transform><bsdf type="diffuse" id="wall"><rgb name="reflectance" value="0.5"/></bsdf></shape>"#;
    let roulette = |mut s: Scene, max_depth: u32| {
        (s.settings.rr_depth, s.settings.max_depth) = (1, max_depth);
        s
    };
    let open = roulette(scene(&format!("{}{plate}{sky}", camera(6, 2))), 2);
    let mut along = vec![0.0; open.params().values().len()];
    let range = open
        .params()
        .find("wall.reflectance.value")
        .expect("a parameter")
        .range();
    along[range].fill(1.0);
    let adjoint = mean_adjoint(&open);
    let right = forward_by::<BsdfOnly<Detached>>(&open, &along, &adjoint, &open.settings, 3, 4000);
    let wrong = forward_by::<Wrong>(&open, &along, &adjoint, &open.settings, 3, 4000);
    assert!((right - 0.6).abs() < 0.01, "{right}");
    assert!(wrong.abs() < 1e-12, "{wrong}");

    let wall = r#"<shape type="rectangle"><transform name="to_world"><scale value="9"/><translate z="-4"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.2, 0.5"/></bsdf></shape>"#;
    let case = Case {
        name: "room",
        scene: roulette(scene(&format!("{}{plate}{wall}{LOBES}", camera(6, 6))), 6),
        param: "wall.reflectance.value",
        spp: 500,
    };
    let [wrong, right] =
        [Estimator::BiasedRoulette, Estimator::Mis].map(|e| derivative(e, &case, 7));
    assert!(wrong.z(&right).abs() > 5.0, "{wrong:?} {right:?}");
    let s = &case.scene;
    let e = Estimator::BiasedRoulette;
    let direction = Direction::uniform(s.params(), case.param).expect("a parameter");
    let forward = e
        .forward_f32(
            &Job::new(s, &s.settings, 5, 0..64, &()),
            s.params().values(),
            &[direction],
        )
        .expect("allowed");
    let forward = forward.mean(1).iter().sum::<f64>() / 3.0;
    let active = e.active(s, &[case.param]).expect("a parameter");
    let theta = Theta::constant(s.params().values());
    let adjoint = mean_adjoint(s);
    let gradient = e
        .backward_f32(
            &Job::new(s, &s.settings, 5, 0..64, &()),
            &theta,
            &active,
            &adjoint,
        )
        .expect("allowed");
    let reverse: f64 = gradient.values[0].iter().sum();
    assert!(
        (forward - reverse).abs() < 1e-4 * forward.abs(),
        "{forward} {reverse}"
    );
}

/// A glass ball under smooth lobes: nothing occludes anything but itself.
fn glass() -> Case {
    let ball = r#"<shape type="sphere" id="ball"><float name="radius" value="0.9"/>
        <bsdf type="dielectric" id="glass"><float name="int_ior" value="1.5"/></bsdf></shape>"#;
    Case {
        name: "glass ball",
        scene: scene(&format!("{}{ball}{LOBES}", camera(6, 5))),
        param: "glass.eta.value",
        spp: 1500,
    }
}

/// The index of smooth glass moves Dirac deltas: constant paths must refuse it instead of giving zero (F2),
/// moving paths have its derivative, in both modes. 32 x 36 x 1500 samples; differences of images that
/// jump with the index, so with a wide step.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn the_index_of_smooth_glass_has_a_derivative() {
    let case = glass();
    let s = &case.scene;
    let direction = Direction::uniform(s.params(), case.param).expect("a parameter");
    for &e in Estimator::ALL {
        let moving = e.capabilities().sees(ParamKind::Delta);
        assert_eq!(e.active(s, &[case.param]).is_ok(), moving, "{}", e.name());
        let forward = e.forward_f32(
            &Job::new(s, &s.settings, 1, 0..1, &()),
            s.params().values(),
            std::slice::from_ref(&direction),
        );
        assert_eq!(forward.is_ok(), moving, "{}", e.name());
    }
    let d = derivative(Estimator::AttachedPath, &case, 21);
    let info = s.params().find(case.param).expect("a parameter");
    let h = 0.01;
    let differences: Vec<f64> = (0..REPEATS)
        .map(|r| {
            let at = |sign: f64| {
                let mut v = values::<f64>(s);
                v[info.offset] += sign * h;
                let theta = Theta::constant(&v);
                let image = render::<f64, BsdfOnly<Detached>, Independent>(
                    &Job::new(s, &s.settings, 31_000 + r, 0..case.spp, &()),
                    &theta,
                )
                .expect("nothing moves");
                image.mean(0).iter().sum::<f64>() / 3.0
            };
            (at(1.0) - at(-1.0)) / (2.0 * h)
        })
        .collect();
    let differences = Estimate::of(&differences);
    let z = d.z(&differences);
    println!("{d:?} {differences:?} z {z:.2}");
    assert!(z.abs() < z_limit(1, REPEATS, ALPHA), "z = {z}");
    assert!(d.mean.abs() > 10.0 * d.se, "{d:?} says nothing");

    let active = Estimator::AttachedPath
        .active(s, &[case.param])
        .expect("a moving path");
    let image = Estimator::AttachedPath
        .forward_f32(
            &Job::new(s, &s.settings, 3, 0..64, &()),
            s.params().values(),
            std::slice::from_ref(&direction),
        )
        .expect("allowed");
    let forward = image.mean(1).iter().sum::<f64>() / 3.0;
    let theta = Theta::constant(s.params().values());
    let adjoint = mean_adjoint(s);
    let gradient = Estimator::AttachedPath
        .backward_f32(
            &Job::new(s, &s.settings, 3, 0..64, &()),
            &theta,
            &active,
            &adjoint,
        )
        .expect("allowed");
    let reverse: f64 = gradient.values[0].iter().sum();
    assert!(
        (forward - reverse).abs() < 1e-3 * forward.abs(),
        "{forward} {reverse}"
    );
}
