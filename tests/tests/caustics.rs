//! Caustics by particles: the same light and the same derivatives as by paths alone.

use std::sync::atomic::{AtomicU64, Ordering};

use render::Job;
use render::estimator::{
    AllowBias, Attached, BsdfOnly, Detached, DetachedMis, DetachedWeights, Differential, Mis,
    Unbiased,
};
use render::instances::{Direction, Estimator, backward_f32, render_f32};
use render::integrator::gradient::Active;
use render::integrator::render::{Progress, render};
use render::params::{ParamKind, Theta};
use render::sampler::{Independent, Points};
use render::scene::Caustics;
use render::{Scene, Settings};
use tests::stats::{Estimate, z_limit};
use tests::{
    cases, forward_by, image, mean_adjoint, on_any_threads, picture, reverse, reverse_by, scene,
    smooth_params, values,
};

const ALPHA: f64 = 1e-3;

const CAMERA: &str = r#"
    <integrator type="path"><integer name="max_depth" value="5"/><integer name="rr_depth" value="4"/></integrator>
    <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 2, 5" target="0, 0.6, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
        <rfilter type="gaussian"/></film></sensor>"#;

/// A floor and a bumpy wall under a lamp and a sky that is sampled less, with a metal plate, a lacquered one and a ball of rough
/// glass. The camera sees all of them.
const ROOM: &str = r#"
    <shape type="rectangle">
        <transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>
        <bsdf type="diffuse" id="floor"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf></shape>
    <shape type="rectangle">
        <transform name="to_world"><scale value="3"/><translate z="-1.5"/></transform>
        <bsdf type="normalmap">
            <texture name="normalmap" type="checkerboard"><rgb name="color0" value="0.6, 0.45, 0.95"/>
            <rgb name="color1" value="0.45, 0.6, 0.95"/></texture>
            <bsdf type="diffuse" id="wall"><rgb name="reflectance" value="0.7, 0.2, 0"/></bsdf></bsdf></shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate y="1" angle="60"/><translate x="-1.4" y="0.9"/></transform>
        <bsdf type="twosided"><bsdf type="roughconductor" id="metal"><string name="distribution" value="ggx"/>
            <boolean name="sample_visible" value="false"/>
            <float name="alpha" value="0.2"/><rgb name="specular_reflectance" value="0.9, 0.8, 0.7"/></bsdf></bsdf></shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate y="1" angle="-60"/><translate x="1.6" y="0.9"/></transform>
        <bsdf type="roughplastic" id="lacquer"><float name="alpha" value="0.15"/></bsdf></shape>
    <shape type="sphere"><point name="center" value="0.2, 0.6, 0.3"/><float name="radius" value="0.5"/>
        <bsdf type="roughdielectric" id="glass"><string name="distribution" value="ggx"/>
            <float name="alpha" value="0.25"/></bsdf></shape>
    <shape type="rectangle">
        <transform name="to_world"><scale value="0.4"/><rotate x="1" angle="90"/><translate y="2.6"/></transform>
        <emitter type="area"><float name="sampling_weight" value="3"/>
            <rgb name="radiance" value="9, 8, 7"/></emitter></shape>
    <emitter type="constant"><rgb name="radiance" value="0.1, 0.2, 0.3"/></emitter>"#;

fn room() -> Scene {
    scene(&format!("{CAMERA}{ROOM}"))
}

/// A wall that a small lamp lights by way of a metal plate, which is seen nowhere else.
fn wall() -> Scene {
    let near = CAMERA
        .replace("0, 2, 5", "0, 1.2, 2")
        .replace("0, 0.6, 0", "0, 1.2, -1.5");
    let rest = r#"<shape type="rectangle">
        <transform name="to_world"><scale value="3"/><translate z="-1.5"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.2, 0.1"/></bsdf></shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate x="1" angle="-90"/></transform>
        <bsdf type="roughconductor" id="metal"><string name="distribution" value="ggx"/>
            <boolean name="sample_visible" value="false"/><float name="alpha" value="0.2"/></bsdf></shape>
    <shape type="rectangle">
        <transform name="to_world"><scale value="0.2"/><rotate x="1" angle="90"/><translate y="2" z="1.5"/></transform>
        <emitter type="area"><rgb name="radiance" value="90, 80, 70"/></emitter></shape>"#;
    scene(&format!("{near}{rest}"))
}

/// All glossy cases, all emitters with a metal ball, the room, and more things than are aimed at one by one.
fn glossy() -> Vec<(String, Scene)> {
    let matt = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf>"#;
    let metal = r#"<bsdf type="roughconductor" id="metal"><string name="material" value="Cu"/>
        <float name="alpha" value="0.3"/></bsdf>"#;
    let mut bodies: Vec<_> = (cases::all().into_iter())
        .map(|c| (c.name.to_owned(), c.body.replace(matt, metal)))
        .collect();
    bodies.push(("room".into(), format!("{CAMERA}{ROOM}")));
    let ball = |i: u32| {
        format!(
            r#"<shape type="sphere"><point name="center" value="{}, 0.2, {}"/><float name="radius" value="0.2"/>
            <bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf></shape>"#,
            f64::from(i % 5) * 0.6 - 1.2,
            f64::from(i / 5) * 0.6 - 1.0
        )
    };
    let (floor, lamp) = (
        ROOM.find("<shape").expect("a floor"),
        ROOM.rfind("<shape").expect("a lamp"),
    );
    let wall = ROOM[floor + 1..].find("<shape").expect("a wall") + floor + 1;
    let balls: String = (0..20).map(ball).collect();
    bodies.push((
        "balls".into(),
        format!("{CAMERA}{}{balls}{}", &ROOM[..wall], &ROOM[lamp..]),
    ));
    let scenes = bodies.into_iter().map(|(name, body)| (name, scene(&body)));
    let glossy = |s: &Scene| (0..s.shapes().len()).any(|i| s.shape_info(i as u32).glossy);
    scenes.filter(|(_, s)| glossy(s)).collect()
}

fn with(s: &Scene, caustics: Caustics) -> Settings {
    Settings {
        caustics,
        ..s.settings
    }
}

/// In blocks of pixels (a single one may see what matters too rarely), for all glossy materials, deltas included:
/// 256 runs of 64 samples, spread or not; significance 1e-3 over all comparisons.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn particles_find_the_light_that_paths_leave_out() {
    let scenes = glossy();
    assert!(scenes.len() >= 20);
    let limit = z_limit(scenes.len() * 2 * 4 * 3, 256, ALPHA);
    for (name, s) in &scenes {
        let paths = picture(s, &with(s, Caustics::Paths), 1000, 256, 64);
        for points in [Points::Independent, Points::Sobol] {
            let settings = Settings {
                points,
                ..with(s, Caustics::Particles)
            };
            let particles = picture(s, &settings, 2000, 256, 64);
            let z = particles.iter().zip(&paths).map(|(a, b)| a.z(b).abs());
            let worst = z.fold(0.0, f64::max);
            println!("{name}, {points:?}: |z| up to {worst:.2} of {limit:.2}");
            assert!(worst < limit, "{name}: |z| = {worst}");
        }
    }
}

/// In the roughness of a plate, which only its caustics show, over 24 x 64 x 200 = 3e5 samples each: every estimator
/// with particles against paths alone, so that no light is counted twice or left out by any of them; significance
/// 1e-3 over all.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn derivatives_are_the_same_whatever_the_estimator() {
    let s = wall();
    let direction = Direction::uniform(s.params(), "metal.alpha.value").expect("a parameter");
    let derivative = |e: Estimator, caustics, seed: u64| {
        let means: Vec<f64> = (0..24)
            .map(|r| {
                let image = e.forward_f32(
                    &Job::new(&s, &with(&s, caustics), seed + r, 0..200, &()),
                    s.params().values(),
                    std::slice::from_ref(&direction),
                );
                let image = image.expect("an estimator that is allowed here");
                assert_eq!(image.non_finite.count, 0, "{}", e.name());
                image.mean(1).iter().sum::<f64>() / 3.0
            })
            .collect();
        Estimate::of(&means)
    };
    let reference = derivative(Estimator::DifferentialMis, Caustics::Paths, 1);
    println!("reference {:.6} +- {:.6}", reference.mean, reference.se);
    assert!(reference.mean.abs() > 10.0 * reference.se);
    let unbiased = |e: &&Estimator| e.check(&s).is_ok() && !e.capabilities().study;
    let limit = z_limit(Estimator::ALL.len(), 24, ALPHA);
    for (i, &e) in Estimator::ALL.iter().filter(unbiased).enumerate() {
        let d = derivative(e, Caustics::Particles, 1000 + 100 * i as u64);
        let z = d.z(&reference);
        println!("{:<34} {:.6} +- {:.6}, z {z:.2}", e.name(), d.mean, d.se);
        assert!(z.abs() < limit, "{}: z = {z:.2} of {limit:.2}", e.name());
    }
}

/// To rounding, in f64, for all parameters of all glossy materials.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn reverse_mode_equals_forward_mode() {
    reverse_equals_forward::<DetachedMis>();
}

/// The same where the change of normals has samples of its own, of particles too.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn reverse_mode_equals_forward_mode_with_pairs() {
    reverse_equals_forward::<Mis<Differential, Detached, DetachedWeights>>();
}

fn reverse_equals_forward<S: Unbiased>() {
    for (name, s) in glossy() {
        let settings = with(&s, Caustics::Particles);
        let params = smooth_params(&s);
        let adjoint: Vec<f32> = (0..s.film.pixels() * 3)
            .map(|i| (i % 7) as f32 - 2.0)
            .collect();
        let gradient = reverse_by::<f64, S>(&s, &params, &adjoint, &settings, 5, 16);
        for (p, gradient) in params.iter().zip(&gradient) {
            for (i, &reverse) in gradient.iter().enumerate() {
                let mut direction = vec![0.0; s.params().values().len()];
                direction[p.offset + i] = 1.0;
                let forward = forward_by::<S>(&s, &direction, &adjoint, &settings, 5, 16);
                let close =
                    (reverse - forward).abs() <= 1e-9 * (reverse.abs() + forward.abs()) + 1e-12;
                assert!(close, "{name}, {}[{i}]: {reverse} {forward}", p.name);
            }
        }
    }
}

#[test]
fn nothing_depends_on_threads() {
    let s = scene(&format!("{CAMERA}{ROOM}").replace("value=\"8\"", "value=\"40\""));
    assert_eq!(s.film.crop_size, [40, 40]);
    let settings = with(&s, Caustics::Particles);
    let params = smooth_params(&s);
    let adjoint = mean_adjoint(&s);
    let (sums, _) = on_any_threads(|| {
        let i = image::<f32>(&s, &values(&s), &settings, 5, 4);
        let g = reverse::<f32>(&s, &params, &adjoint, &settings, 6, 4);
        (i.sums, g)
    });
    assert!(sums[0].iter().any(|&x| x > 0.0));
}

/// Both parts of the work together count every pixel once.
#[test]
fn progress_counts_every_pixel_once() {
    struct Count(AtomicU64);
    impl Progress for Count {
        fn advance(&self, n: u64) {
            self.0.fetch_add(n, Ordering::Relaxed);
        }
    }
    let s = room();
    let pixels = s.film.pixels() as u64;
    let values = s.params().values();
    let theta = Theta::constant(values);
    for caustics in [Caustics::Paths, Caustics::Particles] {
        let (settings, count) = (with(&s, caustics), Count(AtomicU64::new(0)));
        let estimator = Estimator::Mis;
        render_f32(&Job::new(&s, &settings, 1, 0..2, &count), &theta, estimator);
        assert_eq!(count.0.load(Ordering::Relaxed), pixels);
        let active = Active::new(&s, &["metal.alpha.value"]).expect("a parameter");
        let adjoint = mean_adjoint(&s);
        backward_f32(
            &Job::new(&s, &settings, 1, 0..2, &count),
            &theta,
            &active,
            &adjoint,
        )
        .expect("an adjoint of the right size");
        assert_eq!(count.0.load(Ordering::Relaxed), 2 * pixels);
    }
}

/// A point light, and the same one behind a mirror: no path finds it there. Its image lights the floor as a
/// point light would that stands behind the plane of the mirror, seen through the mirror's outline. 1e6 particles.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn a_mirror_throws_the_light_of_a_point() {
    let body = r#"<integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective"><float name="fov" value="2"/>
        <transform name="to_world"><lookat origin="0, 6, 0" target="0, 0, 0" up="0, 0, 1"/></transform>
        <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/>
        <rfilter type="box"/></film></sensor>
    <shape type="rectangle">
        <transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape>
    <shape type="rectangle">
        <transform name="to_world"><scale value="2"/><rotate y="1" angle="90"/><translate x="-2" y="1"/></transform>
        <bsdf type="conductor" id="mirror"><rgb name="specular_reflectance" value="0.8"/></bsdf></shape>
    <emitter type="point"><point name="position" value="-1, 1, 0"/><rgb name="intensity" value="3"/></emitter>"#;
    let s = scene(body);
    let mean = |caustics| {
        let settings = Settings {
            pixels_per_particle: 1,
            ..with(&s, caustics)
        };
        let runs = picture(&s, &settings, 1, 64, 1000);
        let mean = runs.iter().map(|e| e.mean).sum::<f64>() / runs.len() as f64;
        let se = runs.iter().map(|e| e.se * e.se).sum::<f64>().sqrt() / runs.len() as f64;
        (mean, se)
    };
    // The mirror is the plane x = -2, hence the image at (-3, 1, 0).
    let light = |x: f64| {
        let d2 = x * x + 1.0;
        0.5 / std::f64::consts::PI * 3.0 / (d2 * d2.sqrt())
    };
    let direct = mean(Caustics::Paths).0;
    assert!(
        (direct / light(1.0) - 1.0).abs() < 2e-3,
        "{direct} {}",
        light(1.0)
    );
    let (both, se) = mean(Caustics::Particles);
    let expected = light(1.0) + 0.8 * light(3.0);
    println!("{both} +- {se}, expected {expected}");
    let z = ((both - expected).abs() - 1e-3 * expected) / se;
    assert!(se < 5e-3 * expected && z < z_limit(1, 64, 1e-3));
}

/// Where particles would miss something, the setting changes nothing: whole paths that move, normals that are
/// flipped to the viewer, scenes without caustics.
#[test]
fn paths_keep_what_particles_would_miss() {
    let same = |s: &Scene, e: Estimator, name: &str| {
        let direction = Direction::uniform(s.params(), name).expect("a parameter");
        let [a, b] = [Caustics::Paths, Caustics::Particles].map(|caustics| {
            let directions = std::slice::from_ref(&direction);
            let settings = with(s, caustics);
            e.forward_f32(
                &Job::new(s, &settings, 3, 0..8, &()),
                s.params().values(),
                directions,
            )
            .expect("an estimator that is allowed here")
            .sums
        });
        a == b
    };
    let room_moving = |caustics| {
        let (s, theta) = (room(), room().params().values().to_vec());
        let theta = Theta::constant(&theta);
        type Moving = AllowBias<BsdfOnly<Attached>>;
        let settings = with(&s, caustics);
        render::<f32, Moving, Independent>(&Job::new(&s, &settings, 3, 0..8, &()), &theta)
            .expect("nothing moves")
            .sums
    };
    assert!(room_moving(Caustics::Paths) == room_moving(Caustics::Particles));
    let mis = Estimator::Mis;
    assert!(!same(&room(), mis, "metal.alpha.value"));
    let flips = r#"<bsdf type="normalmap"><boolean name="flip_invalid_normals" value="true"/>"#;
    let flipping = format!("{CAMERA}{ROOM}").replace("<bsdf type=\"normalmap\">", flips);
    assert!(same(&scene(&flipping), mis, "metal.alpha.value"));
    let short = format!("{CAMERA}{ROOM}").replace("value=\"5\"", "value=\"2\"");
    assert!(same(&scene(&short), mis, "metal.alpha.value"));
}

/// A pair of particles knows the change of normals of something smooth better than particles that carry it along.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn pairs_of_particles_make_less_noise() {
    let mut s = wall();
    let mut parameters = s.params().values().to_vec();
    let alpha = s.params().find("metal.alpha.value").expect("a parameter");
    let params = [alpha.clone()];
    parameters[alpha.offset] = 0.05;
    s.set_params(&parameters).expect("a roughness");
    let (adjoint, settings) = (mean_adjoint(&s), with(&s, Caustics::Particles));
    let variance = |gradient: &dyn Fn(u64) -> Vec<Vec<f64>>| {
        let runs: Vec<f64> = (0..64).map(|seed| gradient(seed)[0][0]).collect();
        Estimate::of(&runs).se.powi(2)
    };
    let without = variance(&|seed| reverse::<f32>(&s, &params, &adjoint, &settings, seed, 64));
    let with = variance(&|seed| {
        type Pair = Mis<Differential, Detached, DetachedWeights>;
        reverse_by::<f32, Pair>(&s, &params, &adjoint, &settings, seed, 64)
    });
    let gain = without / with;
    println!("variance falls {gain:.1} times");
    assert!(gain > 2.0);
}

/// Fewer particles bring the same light and the same derivatives, with more noise; none at all is not possible.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn the_number_of_particles_does_not_matter() {
    let s = wall();
    let params = smooth_params(&s);
    let adjoint = mean_adjoint(&s);
    let of = |pixels_per_particle, seed: u64, spp| {
        let settings = Settings {
            pixels_per_particle,
            ..with(&s, Caustics::Particles)
        };
        reverse::<f32>(&s, &params, &adjoint, &settings, seed, spp)
    };
    assert_eq!(of(0, 1, 4), of(1, 1, 4));
    // 64 pixels share one particle.
    assert_eq!(of(u32::MAX, 1, 4), of(64, 1, 4));
    let runs = |shared, seed: u64| -> Vec<Vec<f64>> {
        let run = |r| of(shared, seed + r, 64).concat();
        (0..64).map(run).collect()
    };
    let (many, few) = (runs(1, 100), runs(7, 1100));
    let n = many[0].len();
    let limit = z_limit(n, 64, ALPHA);
    let mut louder = 0.0f64;
    for i in 0..n {
        let [many, few] =
            [&many, &few].map(|runs| Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>()));
        assert!(few.z(&many).abs() < limit, "{i}: {few:?} {many:?}");
        if many.se > 0.0 {
            louder = louder.max(few.se / many.se);
        }
    }
    println!("{n} derivatives; noise grows up to {louder:.2} times");
    assert!(louder > 1.5);
}

/// What it is for: the wall and its derivatives in roughness and emission, at equal samples, with a smoother plate.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn particles_make_less_noise() {
    let mut s = wall();
    let mut parameters = s.params().values().to_vec();
    let alpha = s.params().find("metal.alpha.value").expect("a parameter");
    parameters[alpha.offset] = 0.05;
    s.set_params(&parameters).expect("a roughness");
    let params: Vec<_> = (smooth_params(&s).into_iter())
        .filter(|p| [ParamKind::Roughness, ParamKind::Emission].contains(&p.kind))
        .collect();
    let adjoint = mean_adjoint(&s);
    let variances = |caustics| {
        let settings = with(&s, caustics);
        let runs: Vec<[f64; 2]> = (0..64)
            .map(|seed| {
                let g = reverse::<f32>(&s, &params, &adjoint, &settings, seed, 64);
                [g[0][0], g[1][0]]
            })
            .collect();
        let of = |i: usize| runs.iter().map(|r| r[i]).collect::<Vec<_>>();
        [of(0), of(1)].map(|runs| Estimate::of(&runs).se.powi(2))
    };
    let (paths, particles) = (variances(Caustics::Paths), variances(Caustics::Particles));
    for (p, (paths, particles)) in params.iter().zip(paths.iter().zip(particles)) {
        let gain = paths / particles;
        println!("{}: variance falls {gain:.1} times", p.name);
        assert!(gain > 2.0);
    }
}
