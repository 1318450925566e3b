//! Where lamps are hidden, the camera sees what lies behind them, and everything else stays as it is.

use ad_core::{Dual, Vec3};
use render::accel::Hit;
use render::estimator::{
    AttachedWeights, Convolved, Detached, DetachedMis, Interior, Mis, Outlines, Reparameterised,
    Unbiased,
};
use render::film::PixelFilter;
use render::instances::{
    Direction, Estimator, backward_f32, backward_particles_f32, density_f32, forward_f32,
    hessian_vector_f32, particles_f32, render_f32,
};
use render::integrator::coverage::coverage;
use render::integrator::density::Convention;
use render::integrator::gradient::{Active, backward};
use render::integrator::render::render;
use render::math::{NOWHERE, Ray, Segment};
use render::params::{Tangent, Theta};
use render::sampler::Independent;
use render::scene::{Caustics, Connections, Method};
use render::statistics::{Estimate, z_limit};
use render::{Job, Scene, Settings};
use tests::moving::{self, agrees, differences};
use tests::{picture, scene, smooth_params, values};

type ByEdges = Outlines<Interior<DetachedMis>>;
type Follows = Convolved<Mis<Reparameterised, Detached, AttachedWeights>>;

fn integrator(depth: u32) -> String {
    format!(
        r#"<integrator type="path"><integer name="max_depth" value="{depth}"/><integer name="rr_depth" value="100"/>
        <boolean name="hide_emitters" value="true"/></integrator>"#
    )
}

/// From above a floor, which lies in the plane z = 0, 8 by 8 units of it.
fn above(depth: u32, size: u32) -> String {
    format!(
        r#"{}<sensor type="perspective"><float name="fov" value="53.13010235415598"/>
        <transform name="to_world"><lookat origin="0, 0, 8" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{size}"/><integer name="height" value="{size}"/>
        <rfilter type="box"/></film></sensor>"#,
        integrator(depth)
    )
}

fn lamp(shape: &str, radiance: &str) -> String {
    let (kind, inside) = shape.split_once('|').expect("a kind");
    format!(
        r#"<shape type="{kind}">{inside}<bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>
        <emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter></shape>"#
    )
}

const FLOOR: &str = r#"<shape type="rectangle" id="floor"><transform name="to_world"><scale value="6"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf></shape>"#;

/// The shape that a ray met, and where, bit by bit.
fn met(s: &Scene, ray: &Ray<f32>, hit: Option<Hit>) -> Option<(u32, [u32; 6])> {
    let hit = hit?;
    let found = s.interaction(&Theta::still(), ray, &hit);
    let [x, y, z] = found.si.p.to_array();
    Some((
        found.shape,
        [hit.t, hit.u, hit.v, x, y, z].map(f32::to_bits),
    ))
}

/// Every ray of the camera meets, bit by bit, what it would meet without lamps, and every point is in sight that would be:
/// through balls, disks, meshes and both sides of rectangles, one behind the other, in one plane with what is behind; in
/// lists, in hierarchies, between instances; and after lamps and others have moved.
#[test]
fn what_is_seen_is_what_is_there_without_lamps() {
    let lamps = [
        r#"sphere|<point name="center" x="0.5" y="0.3" z="3"/>"#,
        r#"rectangle|<transform name="to_world"><scale value="1.5"/><translate x="-1"/></transform>"#,
        r#"disk|<transform name="to_world"><rotate x="1" angle="160"/><translate x="-1" y="0.5" z="2"/></transform>"#,
        r#"cube|<transform name="to_world"><scale value="0.4"/><rotate y="1" angle="40"/><translate y="-1" z="5"/></transform>"#,
        r#"cylinder|<point name="p0" x="1" y="1" z="4"/><point name="p1" x="-2" y="2" z="4.5"/><float name="radius" value="0.3"/>"#,
    ]
    .map(|shape| lamp(shape, "1"))
    .concat();
    let boxes = |n: u32| {
        let each = |i: u32| {
            let (x, y) = (f64::from(i % 7) * 1.1 - 3.3, f64::from(i / 7) * 1.1 - 3.3);
            format!(
                r#"<shape type="instance"><ref id="group"/><transform name="to_world"><scale value="0.3"/>
                <rotate x="1" angle="{}"/><translate x="{x}" y="{y}" z="0.5"/></transform></shape>"#,
                40 * i
            )
        };
        let group = r#"<shape type="shapegroup" id="group"><shape type="cube"/></shape>"#;
        if n == 0 {
            String::new()
        } else {
            group.to_owned() + &(0..n).map(each).collect::<String>()
        }
    };
    let sky = r#"<emitter type="constant"/>"#;
    let balls: String = (0..40)
        .map(|i| {
            let at = [7 * i % 11, 5 * i % 13].map(|k| 0.5 * f64::from(k) - 3.0);
            format!(
                r#"<shape type="sphere"><point name="center" x="{}" y="{}" z="1"/><float name="radius" value="0.3"/></shape>"#,
                at[0], at[1]
            )
        })
        .collect();
    for (what, others) in [
        ("a list", String::new()),
        ("a hierarchy", balls),
        ("instances", boxes(49)),
    ] {
        let body = format!("{}{sky}{FLOOR}{others}", above(3, 64));
        let mut bare = scene(&body);
        let mut all = scene(&format!("{body}{lamps}"));
        let lamp_names: Vec<String> = (all.movables().iter())
            .map(|m| m.name.clone())
            .filter(|n| {
                n.ends_with(".translation") && !bare.movables().iter().any(|b| b.name == *n)
            })
            .collect();
        assert_eq!(lamp_names.len(), 5);
        bare.make_movable(&["floor.translation"]).expect("known");
        all.make_movable(&["floor.translation"]).expect("known");
        all.make_movable(&lamp_names).expect("known");
        let (mut through, mut blocked) = (0, 0);
        for step in 0..3 {
            let by = [0.1, -0.2, 0.3].map(|x| x * step as f32);
            bare.set([("floor.translation", &by[..])]).expect("near");
            all.set([("floor.translation", &by[..])]).expect("near");
            let shifts: Vec<_> = lamp_names.iter().map(|n| (n.as_str(), &by[..])).collect();
            all.set(shifts).expect("near");
            for i in 0..64 * 64 {
                let [x, y] = [i % 64, i / 64].map(|k| k as f32 + 0.5);
                let ray: Ray<f32> = all.camera.ray(x, y);
                let hit = all.seen(&ray, true);
                let expected = met(&bare, &ray, bare.nearest(&ray));
                assert_eq!(met(&all, &ray, hit), expected, "{what} {step} {i}");
                let shown = all.seen(&ray, false);
                assert_eq!(shown, all.nearest(&ray));
                through += usize::from(shown != hit);
                let (Some(hit), Some(alone)) = (hit, bare.nearest(&ray)) else {
                    continue;
                };
                let si = all.interaction(&Theta::still(), &ray, &hit).si;
                let to_camera = |exit| si.shadow_ray(-ray.d, si.t, exit, NOWHERE);
                let [here, there] = [all.exit(hit.prim), bare.exit(alone.prim)].map(to_camera);
                assert_eq!(all.out_of_sight(&here, true), bare.occluded(&there));
                blocked += usize::from(all.out_of_sight(&here, false));
                let aside = Segment {
                    ray: Ray::new(si.p + Vec3::new(0.0, 0.0, 0.2), Vec3::new(0.6, 0.0, 0.8)),
                    length: 5.0,
                    to: NOWHERE,
                };
                assert_eq!(all.out_of_sight(&aside, true), bare.occluded(&aside));
                assert_eq!(all.out_of_sight(&aside, false), all.occluded(&aside));
            }
        }
        assert!(
            through > 3000 && blocked > 1000,
            "{what}: {through} {blocked}"
        );
    }
}

/// The floor under a ball that hangs above its middle has the radiance `rho L (r / d)^2 cos`, and is seen through it; the sky
/// is not there. 16 runs of 64 samples of 32 x 32 pixels, in blocks of 4 x 4.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn the_floor_is_seen_through_the_ball_that_lights_it() {
    const SIZE: u32 = 32;
    const RUNS: u64 = 16;
    let ball = |z: f64, r: f64, l: &str| {
        let shape = format!(
            r#"sphere|<point name="center" x="0" y="0" z="{z}"/><float name="radius" value="{r}"/>"#
        );
        lamp(&shape, l)
    };
    // One of them inside of the other sends nothing that leaves it.
    let s = scene(&format!(
        "{}{FLOOR}{}{}",
        above(2, SIZE),
        ball(2.0, 0.75, "4, 5, 6"),
        ball(2.0, 0.5, "7")
    ));
    let found = picture(&s, &s.settings, 1, RUNS, 64);
    let blocks = SIZE / 4;
    let fine = 16;
    let limit = z_limit(found.len(), RUNS, 1e-3);
    for (i, found) in found.iter().enumerate() {
        let (at, c) = ((i / 3) as u32, i % 3);
        let (x, y) = (at % blocks, at / blocks);
        let mut sum = 0.0;
        for k in 0..fine * fine {
            let place = |block: u32, k: u32| {
                let part = (f64::from(k) + 0.5) / f64::from(fine);
                8.0 * ((f64::from(block) + part) / f64::from(blocks) - 0.5)
            };
            let (x, y) = (place(x, k % fine), place(y, k / fine));
            let d2 = x * x + y * y + 4.0;
            sum += 0.75f64.powi(2) / d2 * 2.0 / d2.sqrt();
        }
        let [albedo, radiance] = [[0.6, 0.5, 0.4][c], [4.0, 5.0, 6.0][c]];
        let expected = albedo * radiance * sum / f64::from(fine * fine);
        let z = found.z(&Estimate::exact(expected));
        assert!(z.abs() < limit, "{i}: {found:?}, not {expected}: {z}");
    }
    let cover = coverage(&Job::new(&s, &s.settings, 1, 0..4, &())).expect("nobody stops it");
    assert!(cover.iter().all(|a| *a == 1.0));
}

/// Behind holes, `null` and smooth panes the sky is hidden, and alpha says what of it is: in images of all estimators, in double
/// precision, by particles that land, and in the gradient of the sky. Lamps are seen there, and the sky behind glass that
/// refracts, and in mirrors. 16 runs of 64 samples of 16 x 16 pixels, in blocks of 4 x 4.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn the_sky_behind_holes_and_panes_is_hidden() {
    const RUNS: u64 = 16;
    let plate = |bsdf: &str| {
        scene(&format!(
            r#"{}<emitter type="constant" id="sky"><rgb name="radiance" value="1"/></emitter><shape type="rectangle"><transform name="to_world"><scale value="6"/>
            </transform>{bsdf}</shape>"#,
            above(4, 16)
        ))
    };
    let grey = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>"#;
    let null = r#"<bsdf type="null"/>"#;
    let thin = r#"<bsdf type="thindielectric"/>"#;
    let part = r#"<float name="weight" value="0.7"/>"#;
    for (bsdf, expected) in [
        (null.to_owned(), Some([0.0, 0.0])),
        (thin.to_owned(), None),
        (
            format!(r#"<bsdf type="mask"><float name="opacity" value="0.3"/>{grey}</bsdf>"#),
            Some([0.15, 0.3]),
        ),
        (
            format!(r#"<bsdf type="blendbsdf">{part}{grey}{null}</bsdf>"#),
            Some([0.15, 0.3]),
        ),
        (
            r#"<bsdf type="conductor"><string name="material" value="none"/></bsdf>"#.to_owned(),
            Some([1.0, 1.0]),
        ),
        // Radiance from within is less by the square of the index.
        (
            r#"<bsdf type="dielectric"><float name="int_ior" value="1.0001"/><float name="ext_ior" value="1"/></bsdf>"#
                .to_owned(),
            Some([1.0 / 1.0001f64.powi(2), 1.0]),
        ),
    ] {
        let s = plate(&bsdf);
        let job = Job::new(&s, &s.settings, 1, 0..64, &());
        let cover = coverage(&job).expect("nobody stops it");
        let covered = cover.iter().map(|a| f64::from(*a)).sum::<f64>() / cover.len() as f64;
        let alpha = expected.map_or(covered, |[_, alpha]| alpha);
        assert!((covered - alpha).abs() < 1e-5, "{bsdf}: {covered}");
        let found = picture(&s, &s.settings, 1, RUNS, 64);
        let limit = z_limit(found.len(), RUNS, 1e-3);
        for (i, found) in found.iter().enumerate() {
            // A pane shows of the sky what it reflects, which is more at larger angles.
            let of_block = || {
                let at = |k: usize| (i / 12 * 4 + k / 4) * 16 + i / 3 % 4 * 4 + k % 4;
                (0..16).map(|k| f64::from(cover[at(k)])).sum::<f64>() / 16.0
            };
            let colour = expected.map_or_else(of_block, |[colour, _]| colour);
            let off = found.mean - colour;
            let z = found.z(&Estimate::exact(colour));
            assert!(off.abs() < 1e-5 || z.abs() < limit, "{bsdf} {i}: {found:?} {z}");
        }
    }
    // Nothing covers nothing: bit by bit, whoever looks.
    for lamps in [false, true] {
        let lit = lamp(
            r#"rectangle|<transform name="to_world"><scale value="6"/><translate z="-1"/></transform>"#,
            "2",
        );
        let s = scene(&format!(
            r#"{}<emitter type="constant" id="sky"><rgb name="radiance" value="1"/></emitter><shape type="rectangle"><transform name="to_world"><scale value="9"/>
            </transform>{null}</shape>{}"#,
            above(2, 16),
            if lamps { &lit } else { "" }
        ));
        let expected = if lamps { 2.0 } else { 0.0 };
        let theta = Theta::constant(s.params().values());
        let doubles = values::<f64>(&s);
        let job = Job::new(&s, &s.settings, 3, 0..4, &());
        let mut images = Vec::new();
        for &estimator in Estimator::ALL {
            if estimator.check(&s).is_ok() {
                images.push((
                    estimator.name(),
                    render_f32(&job, &theta, estimator).image(0),
                ));
            }
        }
        let double = Theta::constant(&doubles);
        let image = render::<f64, DetachedMis, Independent>(&job, &double).expect("an image");
        images.push(("double precision", image.image(0)));
        let density = density_f32(&job, &theta, Default::default(), Convention::Radiance, 0.2);
        images.push(("density", density.expect("a radius").image(0)));
        for (name, image) in images {
            let right = |x: &f32| (*x - expected).abs() < 1e-5;
            assert!(
                image.data.iter().all(right),
                "{name}: {:?}",
                &image.data[..3]
            );
        }
        let names = ["sky.radiance.value"];
        let adjoint = vec![1.0; 16 * 16 * 3];
        let gradient = |settings: &Settings| {
            let job = Job::new(&s, settings, 3, 0..4, &());
            let active = Active::new(&s, &names).expect("known");
            let found = backward_f32(&job, &theta, &active, &adjoint).expect("admitted");
            found.values.concat().iter().map(|x| x.abs()).sum::<f64>()
        };
        let shown = Settings {
            hide_emitters: false,
            ..s.settings
        };
        assert_eq!(gradient(&s.settings), 0.0);
        assert_eq!(gradient(&shown) > 0.0, !lamps);
        let cover = coverage(&job).expect("nobody stops it");
        assert!(cover.iter().all(|a| *a == if lamps { 1.0 } else { 0.0 }));
    }
}

/// A dark lamp before the whole camera that is sampled next to never.
fn dark(z: f64) -> String {
    format!(
        r#"<shape type="rectangle" id="dark"><transform name="to_world"><scale value="0.2"/><translate z="{z}"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
        <emitter type="area"><rgb name="radiance" value="0"/><float name="sampling_weight" value="1e-35"/></emitter></shape>"#
    )
}

/// Things of several kinds under two lamps, the glossy ones among them.
fn still_life() -> String {
    let lamps = [
        r#"rectangle|<transform name="to_world"><scale value="0.5"/><rotate x="1" angle="180"/><translate x="3" z="4"/></transform>"#,
        r#"sphere|<point name="center" x="-2" y="1" z="3"/><float name="radius" value="0.3"/>"#,
    ]
    .map(|shape| lamp(shape, "9, 8, 7"))
    .concat();
    format!(
        r#"{}{FLOOR}{lamps}<shape type="sphere" id="ball"><point name="center" x="1" y="0.5" z="1"/>
        <bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf></shape>
        <shape type="cube" id="block"><transform name="to_world"><scale value="0.6"/><rotate z="1" angle="30"/>
        <translate x="-1" y="-1" z="0.7"/></transform><bsdf type="plastic"/></shape>"#,
        above(4, 16)
    )
}

/// A dark lamp right before the camera changes nothing, bit by bit: images and gradients of all estimators, by waves, by
/// single paths and in double precision, by particles and density, second order, and who finds caustics.
#[test]
fn a_dark_lamp_before_the_camera_changes_nothing() {
    let life = still_life();
    let [bare, mut all] = ["".into(), dark(7.8)].map(|dark| scene(&format!("{life}{dark}")));
    assert!(all.settings.hide_emitters && all.shapes().len() == bare.shapes().len() + 1);
    let n = bare.params().values().len();
    assert_eq!(bare.params().values(), &all.params().values()[..n]);
    let adjoint: Vec<f32> = (0..16 * 16 * 3).map(|i| (1.3 * i as f32).sin()).collect();
    let shown = Settings {
        hide_emitters: false,
        ..all.settings
    };
    let of = |s: &Scene, settings: &Settings| {
        let theta = Theta::constant(s.params().values());
        let doubles = values::<f64>(s);
        let job = Job::new(s, settings, 3, 0..4, &());
        let infos: Vec<_> = smooth_params(&bare).into_iter().map(|p| p.name).collect();
        let active = Active::new(s, &infos).expect("smooth parameters");
        let mut found: Vec<(String, Vec<f64>)> = Vec::new();
        let mut keep = |what: &str, numbers: Vec<f64>| found.push((what.to_owned(), numbers));
        for &estimator in Estimator::ALL {
            if estimator.check(s).is_err() || estimator.active(s, &infos).is_err() {
                continue;
            }
            let image = render_f32(&job, &theta, estimator);
            keep(estimator.name(), image.sums.concat());
            let gradient = estimator.backward_f32(&job, &theta, &active, &adjoint);
            keep(
                estimator.name(),
                gradient.expect("admitted").values.concat(),
            );
        }
        for caustics in [Caustics::Paths, Caustics::Particles] {
            let settings = Settings {
                caustics,
                ..*settings
            };
            let job = Job::new(s, &settings, 3, 0..4, &());
            let gradient = backward_f32(&job, &theta, &active, &adjoint).expect("admitted");
            keep("caustics", gradient.values.concat());
            let image = render_f32(&job, &theta, Estimator::Mis);
            keep("caustics", image.sums.concat());
        }
        let double = Theta::constant(&doubles);
        let image = render::<f64, DetachedMis, Independent>(&job, &double).expect("an image");
        keep("double precision", image.sums.concat());
        let g = backward::<f64, DetachedMis, Independent>(&job, &double, &active, &adjoint);
        keep("double precision", g.expect("admitted").values.concat());
        let rules = Default::default();
        let particles = particles_f32(&job, &theta, rules).expect("a pinhole");
        keep("particles", particles.sums.concat());
        let measured = backward_particles_f32(&job, &theta, &active, &adjoint).expect("admitted");
        keep("particles", measured.gradient.values.concat());
        let density = density_f32(&job, &theta, rules, Convention::Radiance, 0.2);
        keep("density", density.expect("a radius").sums.concat());
        let directions =
            [Direction::uniform(s.params(), "ball.bsdf.alpha.value")].map(|d| d.expect("known"));
        let forward = forward_f32(&job, s.params().values(), &directions).expect("admitted");
        keep("forward mode", forward.sums.concat());
        let ones = vec![1.0; active.len()];
        let second = hessian_vector_f32(&job, &theta, &active, &ones, [&adjoint, &adjoint]);
        keep("second order", second.expect("admitted").values.concat());
        found
    };
    let (with, without) = (of(&all, &all.settings), of(&bare, &bare.settings));
    assert!(with.len() > 25, "{}", with.len());
    for ((what, a), (other, b)) in with.iter().zip(&without) {
        assert_eq!(what, other);
        assert!(a == b, "{what}");
        assert!(a.iter().any(|x| *x != 0.0), "{what} says nothing");
    }
    // The lamp is in the way, and nothing is seen if it is.
    let theta = Theta::constant(all.params().values());
    let black = render_f32(
        &Job::new(&all, &shown, 3, 0..4, &()),
        &theta,
        Estimator::Mis,
    );
    assert!(black.sums.concat().iter().all(|x| *x == 0.0));
    // It may be moved there, too.
    let elsewhere = scene(&format!("{life}{}", dark(90.0)));
    let before = elsewhere.params().values().to_vec();
    all = elsewhere;
    all.make_movable(&["dark.translation"]).expect("known");
    for z in [0.0, -82.2] {
        all.set([("dark.translation", &[0.0, 0.0, z][..])])
            .expect("near");
        let theta = Theta::constant(all.params().values());
        let job = Job::new(&all, &all.settings, 3, 0..4, &());
        let image = render_f32(&job, &theta, Estimator::Mis).sums.concat();
        assert_eq!(image, without[index_of(&without, "mis")].1, "{z}");
    }
    assert_eq!(before, all.params().values()[..before.len()]);
}

fn index_of(found: &[(String, Vec<f64>)], name: &str) -> usize {
    (found.iter().position(|(n, _)| n == name)).expect("the estimator")
}

/// Light over chains has the same mean: who looks for starts of walks draws other numbers where there is a lamp more. 16 runs
/// of 4 samples of 16 x 16 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn chains_are_seen_through_lamps() {
    const RUNS: u64 = 16;
    let mirror = r#"<shape type="sphere" id="mirror"><point name="center" x="1" y="0.5" z="1"/>
        <bsdf type="conductor"/></shape>"#;
    let small = lamp(
        r#"sphere|<point name="center" x="-2" y="1" z="4"/><float name="radius" value="0.1"/>"#,
        "90",
    );
    let body = format!("{}{FLOOR}{mirror}{small}", above(4, 16));
    let of = |s: &Scene| {
        let settings = Settings {
            connections: Some(Connections::new(Method::Sms)),
            ..s.settings
        };
        let theta = Theta::constant(s.params().values());
        let light = |seed| {
            let job = Job::new(s, &settings, seed, 0..4, &());
            render_f32(&job, &theta, Estimator::Mis).light_of_connections
        };
        Estimate::of(&(0..RUNS).map(light).collect::<Vec<_>>())
    };
    let [with, without] = [dark(7.8), String::new()].map(|d| of(&scene(&format!("{body}{d}"))));
    let z = with.z(&without);
    assert!(z.abs() < z_limit(1, RUNS, 1e-3), "{with:?} {without:?}");
    assert!(without.se < 0.05 * without.mean, "{without:?} says nothing");
}

/// A ball and a block behind a lamp that hangs before the camera, which shows nothing of it but its light and shadow.
fn moving_life(depth: u32) -> Scene {
    let bulb = r#"<shape type="sphere" id="bulb"><point name="center" x="0.1" y="1.6" z="2.6"/>
        <float name="radius" value="0.35"/><bsdf type="diffuse"><rgb name="reflectance" value="0.2"/></bsdf>
        <emitter type="area"><rgb name="radiance" value="6, 5, 4"/></emitter></shape>"#;
    let panel = r#"<shape type="cube" id="panel"><transform name="to_world"><scale value="0.2"/><rotate y="1" angle="30"/>
        <translate x="-0.3" y="1.3" z="2"/></transform>
        <emitter type="area"><rgb name="radiance" value="4, 5, 6"/></emitter></shape>"#;
    let mut s = moving::scene(
        &format!("{}{}{bulb}{panel}", moving::FLOOR, moving::CUBE),
        depth,
    );
    s.settings.hide_emitters = true;
    s
}

const MOVERS: [&str; 3] = ["it.translation", "bulb.translation", "sensor.translation"];

/// What moves behind hidden lamps, the lamps, and the camera: outlines of the lamps are none on the film, and those of
/// others are seen through them. 8 runs of 128 samples of 256 pixels, and differences of 8 runs of 192.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn edges_behind_lamps_agree_with_differences() {
    let mut s = moving_life(2);
    s.make_movable(&MOVERS).expect("known");
    let found = moving::gradient::<ByEdges>(&s, &MOVERS, 8, 128);
    let expected = differences(&mut s, &MOVERS, 1.0 / 32.0, 8, 192);
    agrees("edges", &found, &expected, 1e-2, 8);
}

/// With directions that follow what they meet, the same derivatives as with edges. 8 runs of 64 samples.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn directions_that_follow_see_through_lamps() {
    let names = ["bulb.translation", "sensor.translation"];
    let mut s = moving_life(2);
    s.make_movable(&names).expect("known");
    let found = moving::gradient::<Follows>(&s, &names, 8, 64);
    let expected = moving::gradient::<ByEdges>(&s, &names, 8, 64);
    agrees("following", &found, &expected, 2e-2, 8);
}

/// Forward mode is the transpose of reverse mode, to rounding, whatever moves before or behind.
#[test]
fn both_modes_are_one_linear_map() {
    fn check<S: Unbiased>(s: &Scene) {
        type R = Dual<f64, 1>;
        let all = values::<f64>(s);
        let job = Job::new(s, &s.settings, 3, 0..2, &());
        let n = s.film.pixels() * 3;
        let adjoint: Vec<f32> = (0..n).map(|i| (1.3 * i as f32).sin()).collect();
        let active = Active::seen_by::<S, _>(s, &MOVERS).expect("seen");
        let theta = Theta::constant(&all);
        let pulled = backward::<f64, S, Independent>(&job, &theta, &active, &adjoint);
        let pulled = pulled.expect("admitted").values.concat();
        let weights: Vec<f64> = (0..pulled.len()).map(|i| (2.1 * i as f64).cos()).collect();
        let mut tangents = vec![Tangent::None; s.params().infos().len()];
        let mut rest = &weights[..];
        for info in active.ranges() {
            let (own, later) = rest.split_at(info.range().len());
            rest = later;
            let own = own.iter().map(|w| R::new(0.0, [*w])).collect();
            tangents[s.params().handle(info).id as usize] = Tangent::Dense(own);
        }
        let theta = Theta::<R>::with_tangents(&all, &tangents);
        let r = render::<R, S, Independent>(&job, &theta).expect("admitted");
        let products = r.sums[1].iter().zip(&adjoint);
        let pushed: f64 = products.map(|(s, &a)| s * f64::from(a) / 2.0).sum();
        let pairs = || pulled.iter().zip(&weights).map(|(a, b)| a * b);
        let (sum, size) = (pairs().sum::<f64>(), pairs().map(f64::abs).sum::<f64>());
        assert!(
            size > 0.0 && (pushed - sum).abs() <= 1e-8 * size,
            "{pushed} {sum} of {size}"
        );
    }
    let mut s = moving_life(3);
    s.film.filter = PixelFilter::Box;
    s.make_movable(&MOVERS).expect("known");
    check::<ByEdges>(&s);
    check::<Follows>(&s);
}
