//! Guided paths: the same light and the same derivatives as by the material alone, with less noise where lamps are
//! not in sight.

use render::Job;
use render::auto;
use render::estimator::{Detached, DetachedMis, DetachedWeights, Differential, Mis, Unbiased};
use render::instances::{Direction, Estimator};
use render::sampler::Points;
use render::{Scene, Settings};
use tests::stats::{Estimate, z_limit};
use tests::{
    cases, forward_by, image, mean_adjoint, on_any_threads, picture, reverse, reverse_by, scene,
    smooth_params, values,
};

const ALPHA: f64 = 1e-3;

/// A tank below a small lamp, seen from above: light reaches its floor through water that is tilted, and partly by a
/// plate of metal. The floor is a blend of two colours.
const TANK: &str = r#"
    <integrator type="path"><integer name="max_depth" value="6"/><integer name="rr_depth" value="4"/></integrator>
    <sensor type="perspective"><float name="fov" value="30"/>
        <transform name="to_world"><lookat origin="0, 4, 3" target="0, -0.5, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
        <rfilter type="box"/></film></sensor>
    <shape type="rectangle">
        <transform name="to_world"><scale value="1.5"/><rotate x="1" angle="-90"/><translate y="-1"/></transform>
        <bsdf type="blendbsdf" id="floor"><float name="weight" value="0.3"/>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.6, 0.4"/></bsdf>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.3, 0.8"/></bsdf></bsdf></shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate y="1" angle="70"/><translate x="-1" y="-0.6"/></transform>
        <bsdf type="roughconductor" id="metal"><string name="distribution" value="ggx"/>
            <boolean name="sample_visible" value="false"/><float name="alpha" value="0.3"/></bsdf></shape>
    <shape type="rectangle">
        <transform name="to_world"><scale value="1.5"/><rotate x="1" angle="-85"/></transform>
        <bsdf type="dielectric"><float name="int_ior" value="1.33"/></bsdf></shape>
    <shape type="rectangle" id="lamp">
        <transform name="to_world"><scale value="0.3"/><rotate x="1" angle="90"/><translate x="0.4" y="2.5"/></transform>
        <emitter type="area"><rgb name="radiance" value="60, 55, 50"/></emitter></shape>"#;

fn guided(body: &str) -> Scene {
    let mut s = scene(body);
    let settings = s.settings;
    assert!(auto::guide(&mut s, &settings, 1, &()), "no light: {body}");
    s
}

/// The tank, and every material and emitter over or on something diffuse.
fn all() -> Vec<(&'static str, String)> {
    let mut bodies: Vec<_> = (cases::all().into_iter())
        .map(|c| (c.name, c.body))
        .collect();
    bodies.push(("tank", TANK.into()));
    bodies
}

/// In blocks of pixels, independent and spread samples: 64 runs of 64 samples; significance 1e-3 over all comparisons.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn guided_paths_find_the_same_light() {
    let all = all();
    let limit = z_limit(all.len() * 2 * 4 * 3, 64, ALPHA);
    for (name, body) in &all {
        let (plain, guided) = (scene(body), guided(body));
        let expected = picture(&plain, &plain.settings, 1000, 64, 64);
        for points in [Points::Independent, Points::Sobol] {
            let settings = Settings {
                points,
                ..plain.settings
            };
            let found = picture(&guided, &settings, 2000, 64, 64);
            let z = found.iter().zip(&expected).map(|(a, b)| a.z(b).abs());
            let worst = z.fold(0.0, f64::max);
            println!("{name}, {points:?}: |z| up to {worst:.2} of {limit:.2}");
            assert!(worst < limit, "{name}: |z| = {worst}");
        }
    }
}

/// Derivatives in what the tank is made of, over 32 x 64 x 100 = 2e5 samples each: every unbiased estimator in the guided
/// scene, guided or not concerned, against detached sampling without a guide; significance 1e-3 over all.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn derivatives_are_the_same_whatever_the_estimator() {
    let (plain, guided) = (scene(TANK), guided(TANK));
    let names = [
        "metal.alpha.value",
        "floor.bsdf_0.reflectance.value",
        "lamp.emitter.radiance.value",
    ];
    let derivative = |s: &Scene, e: Estimator, name: &str, seed: u64| {
        let direction = [Direction::uniform(s.params(), name).expect("a parameter")];
        let means: Vec<f64> = (0..32)
            .map(|r| {
                let values = s.params().values();
                let seed = seed + r;
                let image = e
                    .forward_f32(
                        &Job::new(s, &s.settings, seed, 0..100, &()),
                        values,
                        &direction,
                    )
                    .expect("an estimator that is allowed here");
                assert_eq!(image.non_finite.count, 0, "{}", e.name());
                image.mean(1).iter().sum()
            })
            .collect();
        Estimate::of(&means)
    };
    let usable = |e: &&Estimator| e.check(&plain).is_ok() && !e.capabilities().study;
    let usable: Vec<Estimator> = Estimator::ALL.iter().filter(usable).copied().collect();
    let can_be = |e: &&Estimator| e.capabilities().guided;
    assert!((1..usable.len()).contains(&usable.iter().filter(can_be).count()));
    let limit = z_limit(names.len() * usable.len(), 32, ALPHA);
    for (k, name) in names.iter().enumerate() {
        let seed = 1000 * k as u64;
        let reference = derivative(&plain, Estimator::DifferentialMis, name, seed);
        for (i, e) in usable.iter().enumerate() {
            let d = derivative(&guided, *e, name, 100_000 + seed + 40 * i as u64);
            let z = d.z(&reference);
            println!(
                "{name}, {:<34} {:.6} +- {:.6}, z {z:.2}",
                e.name(),
                d.mean,
                d.se
            );
            assert!(z.abs() < limit, "{name}, {}: z = {z:.2}", e.name());
        }
    }
}

/// To rounding, in f64, for all parameters of all materials and emitters.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn reverse_mode_equals_forward_mode() {
    reverse_equals_forward::<DetachedMis>();
    reverse_equals_forward::<Mis<Differential, Detached, DetachedWeights>>();
}

fn reverse_equals_forward<S: Unbiased>() {
    for (name, body) in all() {
        let s = guided(&body);
        let params = smooth_params(&s);
        let n = s.film.pixels() * 3;
        let adjoint: Vec<f32> = (0..n).map(|i| (i % 7) as f32 - 2.0).collect();
        let gradient = reverse_by::<f64, S>(&s, &params, &adjoint, &s.settings, 5, 8);
        for (p, gradient) in params.iter().zip(&gradient) {
            for (i, &reverse) in gradient.iter().enumerate() {
                let mut direction = vec![0.0; s.params().values().len()];
                direction[p.offset + i] = 1.0;
                let forward = forward_by::<S>(&s, &direction, &adjoint, &s.settings, 5, 8);
                let close =
                    (reverse - forward).abs() <= 1e-9 * (reverse.abs() + forward.abs()) + 1e-12;
                assert!(close, "{name}, {}[{i}]: {reverse} {forward}", p.name);
            }
        }
    }
}

/// What is learned, and what comes of it.
#[test]
fn nothing_depends_on_threads() {
    let body = TANK.replace("value=\"8\"", "value=\"40\"");
    let (sums, _) = on_any_threads(|| {
        let s = guided(&body);
        assert_eq!(s.film.crop_size, [40, 40]);
        let i = image::<f32>(&s, &values(&s), &s.settings, 5, 4);
        let params = smooth_params(&s);
        let g = reverse::<f32>(&s, &params, &mean_adjoint(&s), &s.settings, 6, 4);
        (i.sums, g)
    });
    assert!(sums[0].iter().any(|&x| x > 0.0));
}

/// Through water by far: the variance of blocks of the image, at equal samples, without the plate of metal, whose own
/// noise paths cannot help.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn light_through_water_has_less_noise() {
    let body = TANK.replace("<translate x=\"-1\" y=\"-0.6\"/>", "<translate y=\"-9\"/>");
    let (plain, guided) = (scene(&body), guided(&body));
    let variance = |s: &Scene| -> f64 {
        let blocks = picture(s, &s.settings, 7, 64, 64);
        blocks.iter().map(|e| e.se * e.se).sum()
    };
    let gain = variance(&plain) / variance(&guided);
    println!("variance {gain:.1} times less");
    assert!(gain > 2.5, "{gain}");
}

/// Nothing to learn from: a scene without light, and one where all is metal.
#[test]
fn without_light_there_is_no_guide() {
    let dark = TANK.replace("60, 55, 50", "0, 0, 0");
    let metal = TANK
        .replace("type=\"blendbsdf\" id=\"floor\"", "type=\"roughconductor\"")
        .replace("<float name=\"weight\" value=\"0.3\"/>", "");
    let metal = match (
        metal.find("<bsdf type=\"diffuse\">"),
        metal.find("</bsdf></bsdf>"),
    ) {
        (Some(a), Some(b)) => format!("{}{}", &metal[..a], &metal[b + "</bsdf>".len()..]),
        _ => panic!("two colours"),
    };
    let metal = metal.replace("<emitter", r#"<bsdf type="conductor"/><emitter"#);
    for body in [dark, metal] {
        let mut s = scene(&body);
        let settings = s.settings;
        assert!(!auto::guide(&mut s, &settings, 1, &()));
        let expected = image::<f32>(&scene(&body), &values(&s), &settings, 5, 4);
        assert_eq!(
            image::<f32>(&s, &values(&s), &settings, 5, 4).sums,
            expected.sums
        );
    }
}
