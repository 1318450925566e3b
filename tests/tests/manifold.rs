//! Manifold connections: the same light as paths find by themselves, where these do.

use std::sync::Arc;

use render::Job;
use render::bsdf::{Dielectric, Diffuse, Interpolation, NormalMap};
use render::camera::{Camera, FovAxis};
use render::emitter::{Area, Vmf};
use render::estimator::{BsdfOnly, Detached, DetachedMis, DetachedWeights, Differential, Mis};
use render::film::PixelFilter;
use render::instances::{Direction, Estimator, backward_f32, chains_by_particles_f32, render_f32};
use render::integrator::gradient::Active;
use render::integrator::render::render;
use render::math::Transform;
use render::params::{ParamKind, Theta};
use render::sampler::Independent;
use render::scene::{Builder, Caustics, Connections, Constraint, Method, Starts, Uniqueness};
use render::shape::{Mesh, MeshData, Patch, Rectangle, smooth_normals};
use render::{Film, Scene, Settings};
use tests::stats::{Estimate, z_limit};
use tests::{
    forward_by, mean_adjoint, on_any_threads, picture, reverse_by, scene, smooth_params, values,
};

pub(crate) const ALPHA: f64 = 1e-3;

pub(crate) fn camera(origin: &str, target: &str, depth: u32) -> String {
    format!(
        r#"<integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
        <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="{origin}" target="{target}" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
        <rfilter type="box"/></film></sensor>"#
    )
}

pub(crate) const FLOOR: &str = r#"<shape type="rectangle"><bsdf type="diffuse" id="floor"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf>
    <transform name="to_world"><scale value="4"/><rotate x="1" angle="-90"/></transform></shape>"#;

pub(crate) fn lamp(size: f64, to: &str) -> String {
    format!(
        r#"<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="{size}"/>{to}</transform>
        <emitter type="area"><rgb name="radiance" value="9, 8, 7"/></emitter></shape>"#
    )
}

/// A lamp that looks at a wall of metal and away from the floor, which sees it in there: one reflection, and after the floor.
fn mirror() -> String {
    let wall = r#"<shape type="rectangle"><bsdf type="twosided"><bsdf type="conductor" id="metal">
        <rgb name="specular_reflectance" value="0.9, 0.7, 0.5"/></bsdf></bsdf>
        <transform name="to_world"><scale value="1.5"/><translate y="1.5" z="-1.5"/></transform></shape>"#;
    let lamp = lamp(
        0.5,
        r#"<rotate y="1" angle="180"/><translate y="1.2" z="1.5"/>"#,
    );
    format!("{}{FLOOR}{wall}{lamp}", camera("3, 3, 4", "0, 0.3, 0", 5))
}

/// A ball of metal over the floor.
fn ball_of_metal() -> String {
    let ball = r#"<shape type="sphere"><point name="center" value="0, 0.9, 0"/><float name="radius" value="0.8"/>
        <bsdf type="conductor"/></shape>"#;
    let lamp = lamp(
        0.6,
        r#"<rotate x="1" angle="60"/><translate y="3" z="-2"/>"#,
    );
    format!("{}{FLOOR}{ball}{lamp}", camera("0, 3, 5", "0, 0.3, 0", 5))
}

/// A ball of glass over the floor: light through it, off it, and after two reflections within.
fn ball_of_glass() -> String {
    let ball = r#"<shape type="sphere"><point name="center" value="0, 0.9, 0"/><float name="radius" value="0.7"/>
        <bsdf type="dielectric" id="glass"/></shape>"#;
    let lamp = lamp(
        0.8,
        r#"<rotate x="1" angle="90"/><translate x="0.5" y="3"/>"#,
    );
    format!("{}{FLOOR}{ball}{lamp}", camera("0, 3, 4", "0, 0.2, 0", 6))
}

/// A pool: the floor under water that is bumpy by its normals, camera and lamp above.
fn pool() -> String {
    let water = r#"<shape type="rectangle"><transform name="to_world"><scale value="4"/><rotate x="1" angle="-90"/>
        <translate y="0.6"/></transform>
        <bsdf type="dielectric" id="water"><string name="int_ior" value="water"/></bsdf></shape>"#;
    let lamp = lamp(0.7, r#"<rotate x="1" angle="90"/><translate y="2.5"/>"#);
    format!("{}{FLOOR}{water}{lamp}", camera("0, 3, 4", "0, 0.2, 0", 5))
}

/// A half-buried ball, as in the authors' figures: one refraction, from glass.
fn buried_ball() -> String {
    let ball = r#"<shape type="sphere"><float name="radius" value="1.2"/><bsdf type="dielectric" id="glass"/></shape>"#;
    let lamp = lamp(
        0.8,
        r#"<rotate x="1" angle="90"/><rotate z="1" angle="-40"/><translate x="2" y="2.5"/>"#,
    );
    format!("{}{FLOOR}{ball}{lamp}", camera("2, 3, 4", "0, 0.1, 0", 5))
}

/// A floor within a hollow ball of metal, which is met in several places on the way to a lamp.
fn hollow_ball() -> String {
    let ball = r#"<shape type="sphere"><point name="center" value="0, 1, 0"/><float name="radius" value="5"/>
        <bsdf type="twosided"><bsdf type="conductor"><rgb name="specular_reflectance" value="0.9, 0.8, 0.7"/></bsdf></bsdf></shape>"#;
    let lamp = lamp(
        1.0,
        r#"<rotate x="1" angle="-60"/><translate x="0.7" y="1.5" z="-1"/>"#,
    );
    let floor = FLOOR.replace(r#"value="4""#, r#"value="1.5""#);
    format!("{}{floor}{ball}{lamp}", camera("0, 2, 3", "0, 0.1, 0", 3))
}

/// Two walls of metal and a lacquered floor, which a lamp lights over both.
fn two_mirrors() -> String {
    let wall = |to: &str| {
        format!(
            r#"<shape type="rectangle"><bsdf type="twosided"><bsdf type="conductor"><rgb name="specular_reflectance" value="0.9, 0.8, 0.7"/>
            </bsdf></bsdf><transform name="to_world"><scale value="1.5"/>{to}</transform></shape>"#
        )
    };
    let walls = [
        wall(r#"<translate y="1.5" z="-1.5"/>"#),
        wall(r#"<rotate y="1" angle="90"/><translate x="-1.6" y="1.5"/>"#),
    ];
    let floor = FLOOR.replace(
        r#"<bsdf type="diffuse" id="floor"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf>"#,
        r#"<bsdf type="roughplastic" id="floor"><float name="alpha" value="0.3"/></bsdf>"#,
    );
    let lamp = lamp(
        0.6,
        r#"<rotate y="1" angle="200"/><translate x="0.4" y="1.2" z="1.5"/>"#,
    );
    format!(
        "{}{floor}{}{lamp}",
        camera("3, 3, 4", "0, 0.3, 0", 5),
        walls.concat()
    )
}

/// A lamp before some metal that stands on the floor.
fn metal(shape: &str, inside: &str, to: &str) -> String {
    let lamp = lamp(
        0.6,
        r#"<rotate x="1" angle="60"/><translate x="-0.5" y="2.6" z="-1.6"/>"#,
    );
    format!(
        r#"{}{FLOOR}<shape type="{shape}">{inside}<transform name="to_world">{to}</transform></shape>{lamp}"#,
        camera("0, 3, 5", "0, 0.3, 0", 5)
    )
}

const METAL: &str = r#"<bsdf type="twosided"><bsdf type="conductor"><rgb name="specular_reflectance" value="0.9, 0.8, 0.6"/>
    </bsdf></bsdf>"#;

/// An upright tube, which is met from outside and, after its open end, from inside.
fn tube() -> String {
    let ends = r#"<point name="p1" value="0, 1.2, 0"/><float name="radius" value="0.7"/>"#;
    metal(
        "cylinder",
        &format!("{ends}{METAL}"),
        r#"<translate z="0.4"/>"#,
    )
}

/// A round mirror that leans.
fn round_mirror() -> String {
    metal(
        "disk",
        METAL,
        r#"<rotate x="1" angle="-10"/><translate y="1" z="0.6"/><scale value="1.2"/><rotate y="1" angle="180"/>"#,
    )
}

/// A block of glass over the floor.
fn block_of_glass() -> String {
    metal(
        "cube",
        r#"<bsdf type="dielectric"/>"#,
        r#"<scale x="0.8" y="0.3" z="0.6"/><rotate y="1" angle="30"/><translate y="0.7"/>"#,
    )
}

/// Two instances of a ball of metal, one of them turned over and larger.
fn instances() -> String {
    let lamp = lamp(
        0.6,
        r#"<rotate x="1" angle="60"/><translate y="3" z="-2"/>"#,
    );
    let instance = |to: &str| {
        format!(
            r#"<shape type="instance"><ref id="group"/><transform name="to_world">{to}</transform></shape>"#
        )
    };
    format!(
        r#"{}{FLOOR}<shape type="shapegroup" id="group"><shape type="sphere"><point name="center" value="0, 1, 0"/>
        <float name="radius" value="0.5"/><bsdf type="conductor"/></shape></shape>{}{}{lamp}"#,
        camera("0, 3, 5", "0, 0.3, 0", 5),
        instance(r#"<translate x="-0.8" y="-0.3"/>"#),
        instance(r#"<rotate z="1" angle="180"/><scale value="1.3"/><translate x="0.8" y="2.1"/>"#),
    )
}

pub(crate) fn with(s: &Scene, connections: Option<Connections>) -> Settings {
    Settings {
        connections,
        ..s.settings
    }
}

/// Blocks of pixels agree with paths alone, in scenes whose lamps are large enough for these: reflection, refraction, all kinds
/// of shapes, chains of one and of two vertices, at depth limits that cut chains. 48 runs of 16 samples against 48 of 256; significance 1e-3 over all
/// comparisons.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn connections_find_the_light_that_paths_leave_out() {
    let scenes = [
        ("mirror", mirror(), 1),
        ("mirror, long chains", mirror(), 3),
        ("ball of metal", ball_of_metal(), 1),
        ("ball of glass", ball_of_glass(), 2),
        ("ball of glass, single", ball_of_glass(), 1),
        ("pool", pool(), 1),
        ("buried ball", buried_ball(), 2),
        ("two mirrors", two_mirrors(), 2),
        ("tube", tube(), 1),
        ("round mirror", round_mirror(), 1),
        ("block of glass", block_of_glass(), 2),
        ("instances", instances(), 1),
    ];
    let limit = z_limit(scenes.len() * 4 * 3, 48, ALPHA);
    for (name, body, bounces) in scenes {
        let s = scene(&body);
        let connections = Connections {
            bounces,
            ..Connections::new(Method::Sms)
        };
        let paths = picture(&s, &with(&s, None), 1000, 48, 256);
        let ours = picture(&s, &with(&s, Some(connections)), 2000, 48, 16);
        let left = picture(&s, &with(&s, None), 3000, 2, 1);
        assert_eq!(left.len(), paths.len());
        let mean = |e: &[Estimate]| e.iter().map(|e| e.mean).sum::<f64>() / e.len() as f64;
        let worst = ours
            .iter()
            .zip(&paths)
            .map(|(a, b)| a.z(b).abs())
            .fold(0.0, f64::max);
        println!(
            "{name}: |z| up to {worst:.2} of {limit:.2}; mean {:.5} of {:.5}",
            mean(&ours),
            mean(&paths)
        );
        assert!(worst < limit, "{name}: |z| = {worst}");
    }
}

fn sms(bounces: u32) -> Connections {
    Connections {
        bounces,
        ..Connections::new(Method::Sms)
    }
}

/// A point light and a sun over a ball of glass, and a spot light before a mirror: paths cannot meet them at all, particles can. 32 runs
/// of 32 samples of connections against 32 runs of 128 of particles, one per pixel; significance 1e-3 over all blocks.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn connections_find_the_light_that_particles_find() {
    let point = r#"<emitter type="point"><point name="position" value="0.5, 2.5, 1"/>
        <rgb name="intensity" value="9, 8, 7"/></emitter>"#;
    let spot = r#"<emitter type="spot"><rgb name="intensity" value="9, 8, 7"/><float name="cutoff_angle" value="40"/>
        <transform name="to_world"><lookat origin="0.3, 2.5, 1" target="0, 0.5, -0.5" up="0, 0, 1"/></transform></emitter>"#;
    let sun = r#"<emitter type="directional"><vector name="direction" value="-0.3, -1, -0.2"/>
        <rgb name="irradiance" value="3, 2.5, 2"/></emitter>"#;
    let ball = r#"<shape type="sphere"><point name="center" value="0, 0.9, 0"/><float name="radius" value="0.7"/>
        <bsdf type="dielectric"/></shape>"#;
    let wall = r#"<shape type="rectangle"><bsdf type="twosided"><bsdf type="conductor"/></bsdf>
        <transform name="to_world"><scale value="1.5"/><translate y="1.5" z="-1.5"/></transform></shape>"#;
    // As deep as there is no caustic that the camera sees in a mirror or through glass: those are not the particles'.
    let camera = |depth| camera("1, 3, 4", "0, 0.2, 0", depth);
    let scenes = [
        ("glass", format!("{}{FLOOR}{ball}{point}", camera(4))),
        ("glass, sun", format!("{}{FLOOR}{ball}{sun}", camera(4))),
        ("mirror", format!("{}{FLOOR}{wall}{spot}", camera(3))),
    ];
    let limit = z_limit(scenes.len() * 4 * 3, 32, ALPHA);
    for (name, body) in scenes {
        let s = scene(&body);
        let by_particles = Settings {
            caustics: Caustics::Particles,
            pixels_per_particle: 1,
            ..s.settings
        };
        // Chains of up to three vertices: all that four edges can have.
        let ours = picture(&s, &with(&s, Some(sms(2))), 10, 32, 32);
        let theirs = picture(&s, &by_particles, 1000, 32, 128);
        let worst = ours
            .iter()
            .zip(&theirs)
            .map(|(a, b)| a.z(b).abs())
            .fold(0.0, f64::max);
        println!("{name}: |z| up to {worst:.2} of {limit:.2}");
        assert!(worst < limit, "{name}: |z| = {worst}");
        // Paths alone miss it.
        let chains = by_chains(&s, sms(2), 16, 16);
        assert!(chains.mean > 4.0 * chains.se, "{name}: {chains:?}");
    }
}

/// The mean of the light that connections bring: of images less those at the same seeds that leave it out.
fn by_chains(s: &Scene, connections: Connections, runs: u64, spp: u64) -> Estimate {
    let theta = Theta::constant(s.params().values());
    let none = Connections {
        method: Method::LeftOut,
        ..connections
    };
    let each = (0..runs).map(|seed| {
        let [with, without] = [connections, none].map(|connections| {
            let settings = with(s, Some(connections));
            let job = Job::new(s, &settings, seed, 0..spp, &());
            let r = render_f32(&job, &theta, Estimator::Mis);
            r.mean(0).iter().sum::<f64>() / 3.0
        });
        with - without
    });
    Estimate::of(&each.collect::<Vec<_>>())
}

/// Chains that are asked for by their events bring their light and no other: images are those of paths alone in each case, the light of
/// all kinds is that of all chains, and that of some is less. 48
/// runs of 16 samples against 48 of 256, and 24 of 64; significance 1e-3 over all comparisons.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn chains_that_are_asked_for_bring_their_light() {
    let asked = |chains: &str| Connections {
        kinds: Some(chains.parse().expect("chains")),
        ..Connections::new(Method::Sms)
    };
    let scenes = [
        ("ball of glass", ball_of_glass(), ["TT", "R", "TRT,TT"]),
        ("two mirrors", two_mirrors(), ["RR", "R", "TT"]),
        ("buried ball", buried_ball(), ["T", "TR", "R,TT"]),
    ];
    let limit = z_limit(scenes.len() * (3 * 4 * 3 + 1), 24, ALPHA);
    for (name, body, each) in scenes {
        let s = scene(&body);
        let paths = picture(&s, &with(&s, None), 1000, 48, 256);
        for chains in each {
            let ours = picture(&s, &with(&s, Some(asked(chains))), 2000, 48, 16);
            let z = ours.iter().zip(&paths).map(|(a, b)| a.z(b).abs());
            let worst = z.fold(0.0, f64::max);
            println!("{name}, {chains}: |z| up to {worst:.2} of {limit:.2}");
            assert!(worst < limit, "{name}, {chains}: {worst}");
        }
        if name == "ball of glass" {
            // Particles, but for the bias of their kernel.
            for chains in ["TT", "R"] {
                let settings = with(&s, Some(asked(chains)));
                let job = Job::new(&s, &settings, 5, 0..256, &());
                let theta = Theta::constant(s.params().values());
                let found = chains_by_particles_f32(&job, &theta, 1 << 20).expect("chains");
                let by_particles = found.image.mean(0).iter().sum::<f64>() / 3.0;
                let ratio = by_particles / by_chains(&s, asked(chains), 24, 64).mean;
                println!("{name}, {chains}: {ratio:.3} by particles");
                assert!((ratio - 1.0).abs() < 0.1, "{chains}: {ratio}");
            }
        }
        let all = by_chains(&s, sms(2), 24, 64);
        let sum = by_chains(&s, asked("R,T,RR,RT,TR,TT"), 24, 64);
        let z = sum.z(&all);
        println!("{name}: {all:?}, kind by kind {sum:?}");
        assert!(z.abs() < limit && all.mean > limit * all.se, "{name}: {z}");
        let less = by_chains(&s, asked(each[1]), 24, 64);
        assert!(
            less.mean < all.mean - 3.0 * all.se,
            "{name}: {less:?} {all:?}"
        );
    }
}

/// Half vectors find the same light, more slowly; trial sets find less of it, the more walks the more; one start, and the
/// published threshold at a large value, find no more (F16, F23), all from uniform starts. 12 runs of 16 samples each, significance 1e-3.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn what_estimators_lose_is_what_they_should() {
    let limit = z_limit(4, 12, ALPHA);
    let of = |s: &Scene, connections: Connections| {
        let starts = Starts::Uniform;
        by_chains(
            s,
            Connections {
                starts,
                ..connections
            },
            12,
            16,
        )
    };
    let flat = scene(&mirror());
    let all = of(&flat, sms(1));
    let half = Connections {
        constraint: Constraint::HalfVector,
        ..sms(1)
    };
    let half = of(&flat, half);
    assert!(
        half.z(&all).abs() < limit && all.mean > limit * all.se,
        "{half:?} {all:?}"
    );
    let ball = scene(&ball_of_glass());
    let all = of(&ball, sms(2));
    let sets = [1, 4, 16].map(|m| of(&ball, Connections::new(Method::SmsBiased(m))));
    assert!(sets[0].mean < sets[1].mean, "{sets:?}");
    assert!(sets[1].mean < sets[2].mean + 3.0 * sets[2].se, "{sets:?}");
    assert!(sets[2].z(&all).abs() < limit, "{sets:?} {all:?}");
    assert!(sets[0].mean < all.mean - 3.0 * all.se, "{sets:?} {all:?}");
    let merged = Connections {
        uniqueness: Uniqueness::Threshold(0.1),
        ..sms(2)
    };
    for less in [Connections::new(Method::Mnee), merged] {
        let found = of(&ball, less);
        assert!(
            found.mean > 0.0 && found.mean < all.mean + 3.0 * all.se,
            "{found:?} {all:?}"
        );
    }
}

/// One walk misses light, and with paths for the chains that it misses all light is there: in hollow metal with several
/// solutions, between walls, through smooth and rough glass, and to a lobe of the sky. 48 runs of 32
/// samples against 48 of 256 by paths alone, significance 1e-3 over all blocks. Some of the paths that met light over a chain count,
/// and some do not.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn one_walk_and_paths_for_what_it_misses_bring_all_light() {
    let rough = rough_scenes([0.15, 0.1, 0.05]);
    let [_, (_, rough_glass, _), _] = &rough;
    // One lobe of a sky instead of the lamp.
    let glass = ball_of_glass();
    let at = glass
        .find(r#"<shape type="rectangle" id="lamp">"#)
        .expect("a lamp");
    let lobe = r#"<emitter type="vmf"><vector name="direction" value="0.3, 1, 0.1"/><float name="kappa" value="150"/>
        <rgb name="radiance" value="9, 8, 7"/></emitter>"#;
    let sky = format!("{}{lobe}", &glass[..at]);
    let scenes = [
        ("hollow ball", scene(&hollow_ball()), 1),
        ("two mirrors", scene(&two_mirrors()), 2),
        ("ball of glass", scene(&ball_of_glass()), 2),
        ("rough glass", scene(rough_glass), 2),
        ("glass under a sky", scene(&sky), 2),
    ];
    let limit = z_limit(scenes.len() * 4 * 3, 48, ALPHA);
    for (name, s, bounces) in scenes {
        let of = |method: Method| Connections {
            bounces,
            roughness: 0.2,
            ..Connections::new(method)
        };
        let all = with(&s, Some(of(Method::MneeUnbiased)));
        let paths = picture(&s, &with(&s, None), 1000, 48, 256);
        let ours = picture(&s, &all, 2000, 48, 32);
        let each = ours.iter().zip(&paths).map(|(a, b)| a.z(b).abs());
        let worst = each.fold(0.0, f64::max);
        // Both share all paths and connections: their difference is what counts of the light that paths meet.
        let theta = Theta::constant(s.params().values());
        let (mut met, mut missed) = (0, 0);
        let counted = (0..16).map(|seed| {
            let [one, both] = [Method::Mnee, Method::MneeUnbiased].map(|method| {
                let settings = with(&s, Some(of(method)));
                let job = Job::new(&s, &settings, seed, 0..16, &());
                let r = render_f32(&job, &theta, Estimator::Mis);
                met += r.connections.met;
                missed += r.connections.missed;
                r.mean(0).iter().sum::<f64>() / 3.0
            });
            both - one
        });
        let counted = Estimate::of(&counted.collect::<Vec<_>>());
        let all = ours.iter().map(|e| e.mean).sum::<f64>() / ours.len() as f64;
        println!(
            "{name}: |z| up to {worst:.2} of {limit:.2}; {missed} of {met} paths count, with {:.4} of {all:.4}",
            counted.mean
        );
        assert!(worst < limit, "{name}: {worst}");
        assert!(counted.mean > 3.0 * counted.se, "{name}: {counted:?}");
        assert!(missed > 0 && missed < met, "{name}: {missed} of {met}");
    }
}

/// In double precision the same paths count, but for a few that rounding takes elsewhere.
#[test]
fn missed_chains_are_told_in_either_precision() {
    let s = scene(&ball_of_glass());
    let settings = with(&s, Some(Connections::new(Method::MneeUnbiased)));
    let job = Job::new(&s, &settings, 1, 0..64, &());
    let v = values::<f64>(&s);
    let double = render::<f64, DetachedMis, Independent>(&job, &Theta::constant(&v));
    let double = double.expect("nothing moves");
    let single = render_f32(&job, &Theta::constant(s.params().values()), Estimator::Mis);
    let counts = [&single, &double].map(|r| [r.connections.met, r.connections.missed]);
    let [[met, missed], [met_too, missed_too]] = counts;
    assert!(missed > 10 && met > missed + 10, "{counts:?}");
    assert!(
        met.abs_diff(met_too) <= 2 && missed.abs_diff(missed_too) <= 2,
        "{counts:?}"
    );
    let [a, b] = [&single, &double].map(|r| r.mean(0).iter().sum::<f64>());
    assert!((a - b).abs() < 1e-2 * a, "{a} {b}");
}

/// Images, statistics and gradients are those of the seed, for any number of threads.
#[test]
fn results_depend_on_the_seed_alone() {
    for method in [Method::Sms, Method::MneeUnbiased] {
        depend_on_the_seed_alone(method);
    }
}

fn depend_on_the_seed_alone(method: Method) {
    let s = scene(&ball_of_glass());
    let settings = with(&s, Some(Connections::new(method)));
    let active = Active::new(&s, &["floor.reflectance.value"]).expect("a parameter");
    let theta = Theta::constant(s.params().values());
    let (sums, statistics, gradient) = on_any_threads(|| {
        let job = Job::new(&s, &settings, 3, 0..4, &());
        let image = render_f32(&job, &theta, Estimator::Mis);
        let adjoint = mean_adjoint(&s);
        let g = backward_f32(&job, &theta, &active, &adjoint).expect("a gradient");
        (image.sums, image.connections, g.values)
    });
    assert!(sums[0].iter().any(|x| *x > 0.0) && gradient[0].iter().any(|x| *x > 0.0));
    assert!(
        statistics.found > 0 && statistics.walks >= statistics.attempts,
        "{statistics:?}"
    );
    assert!(statistics.converged <= statistics.walks && statistics.trials >= statistics.solutions);
    assert_eq!(statistics.met > 0, method == Method::MneeUnbiased);
}

/// Where there is nothing to connect, images are those without connections, bit by bit.
#[test]
fn nothing_changes_where_nothing_is_connected() {
    let plain = scene(&format!(
        "{}{FLOOR}{}",
        camera("0, 3, 4", "0, 0.2, 0", 5),
        lamp(0.5, r#"<rotate x="1" angle="90"/><translate y="2"/>"#)
    ));
    let theta = Theta::constant(plain.params().values());
    let image = |connections| {
        let settings = with(&plain, connections);
        render_f32(
            &Job::new(&plain, &settings, 1, 0..8, &()),
            &theta,
            Estimator::Mis,
        )
        .sums
    };
    assert_eq!(image(Some(sms(2))), image(None));
    assert!(image(None)[0].iter().any(|x| *x > 0.0));
}

/// Forward and reverse mode are one linear map and its transpose, in f64, at equal seeds; both are the central difference of
/// the image with common random numbers: albedo of the floor, emission, reflectance of metal, transmittance of glass.
#[test]
fn derivatives_of_chains_that_stay_are_right() {
    for method in [Method::Sms, Method::MneeUnbiased] {
        derivatives_are_right(method);
    }
}

fn derivatives_are_right(method: Method) {
    for (body, keys) in [
        (
            mirror(),
            &[
                "floor.reflectance.value",
                "metal.specular_reflectance.value",
                "lamp.emitter.radiance.value",
            ][..],
        ),
        (
            buried_ball(),
            &[
                "floor.reflectance.value",
                "glass.specular_transmittance.value",
                "glass.specular_reflectance.value",
                "lamp.emitter.radiance.value",
            ][..],
        ),
    ] {
        let s = scene(&body);
        // No roulette, which common random numbers would play otherwise.
        let settings = Settings {
            rr_depth: u32::MAX,
            ..with(&s, Some(Connections::new(method)))
        };
        let adjoint = mean_adjoint(&s);
        let params: Vec<_> = smooth_params(&s)
            .into_iter()
            .filter(|p| keys.contains(&p.name.as_str()))
            .collect();
        assert_eq!(
            params.len(),
            keys.len(),
            "{:?}",
            smooth_params(&s)
                .iter()
                .map(|p| p.name.clone())
                .collect::<Vec<_>>()
        );
        let (seed, spp) = (5, 8);
        let gradient = reverse_by::<f64, DetachedMis>(&s, &params, &adjoint, &settings, seed, spp);
        for (info, gradient) in params.iter().zip(&gradient) {
            let mut direction = vec![0.0; s.params().values().len()];
            direction[info.range()].fill(1.0);
            let forward = forward_by::<DetachedMis>(&s, &direction, &adjoint, &settings, seed, spp);
            let reverse: f64 = gradient.iter().sum();
            let size = reverse.abs().max(1e-12);
            assert!(
                (forward - reverse).abs() < 1e-9 * size,
                "{}: {forward} {reverse}",
                info.name
            );
            let value = |h: f64| {
                let mut v = values::<f64>(&s);
                for i in info.range() {
                    v[i] += h;
                }
                let theta = Theta::constant(&v);
                let job = Job::new(&s, &settings, seed, 0..spp, &());
                let r =
                    render::<f64, DetachedMis, Independent>(&job, &theta).expect("nothing moves");
                r.mean(0).iter().sum::<f64>() / 3.0
            };
            let difference = (value(1e-4) - value(-1e-4)) / 2e-4;
            assert!(
                (difference - reverse).abs() < 1e-5 * size,
                "{}: {difference} {reverse}",
                info.name
            );
        }
    }
}

/// The part of a gradient that chains bring is there for every estimator, with the same expectation: 16 runs of 32 samples of
/// reverse mode, with a differential pair or without, against paths alone with 16 times as many; significance 1e-3.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn gradients_have_the_light_of_chains() {
    let s = scene(&mirror());
    let params: Vec<_> = smooth_params(&s)
        .into_iter()
        .filter(|p| p.kind == ParamKind::Smooth)
        .collect();
    let adjoint = mean_adjoint(&s);
    let sum = |g: Vec<Vec<f64>>| g.iter().flatten().sum::<f64>();
    let settings = with(&s, Some(sms(1)));
    let ours = [0, 1, 2].map(|which| {
        let runs = (0..16).map(|seed| {
            sum(match which {
                0 => reverse_by::<f32, DetachedMis>(&s, &params, &adjoint, &settings, seed, 32),
                1 => reverse_by::<f32, BsdfOnly<Detached>>(
                    &s, &params, &adjoint, &settings, seed, 32,
                ),
                _ => reverse_by::<f32, Mis<Differential, Detached, DetachedWeights>>(
                    &s, &params, &adjoint, &settings, seed, 32,
                ),
            })
        });
        Estimate::of(&runs.collect::<Vec<_>>())
    });
    let plain = with(&s, None);
    let runs = (100..116).map(|seed| {
        sum(reverse_by::<f32, DetachedMis>(
            &s, &params, &adjoint, &plain, seed, 512,
        ))
    });
    let paths = Estimate::of(&runs.collect::<Vec<_>>());
    let limit = z_limit(3, 16, ALPHA);
    for e in ours {
        assert!(
            e.z(&paths).abs() < limit && e.se < 0.2 * e.mean,
            "{e:?} {paths:?}"
        );
    }
}

/// What moves chains is refused by name, and so is what has no part for them.
#[test]
fn what_is_not_covered_is_refused() {
    let s = scene(&ball_of_glass());
    let settings = with(&s, Some(sms(2)));
    let job = Job::new(&s, &settings, 0, 0..1, &());
    let along = [Direction::uniform(s.params(), "floor.reflectance.value").expect("a parameter")];
    let attached = Estimator::from_name("attached-path").expect("an estimator");
    let error = attached
        .forward_f32(&job, s.params().values(), &along)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("manifold connections") || error.contains("discontinuities"),
        "{error}"
    );
    let eta = [Direction::uniform(s.params(), "glass.eta.value").expect("a parameter")];
    let error = Estimator::Mis
        .forward_f32(&job, s.params().values(), &eta)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains(
            "parameter `glass.eta.value` moves chains, which have derivatives only where they stay; expected `--manifold off`, \
             and an estimator that sees it"
        ),
        "{error}"
    );

    // One walk, and paths for the rest, which never meet a bulb.
    let bulb =
        r#"<emitter type="point" id="bulb"><point name="position" value="0.5, 4, 1"/></emitter>"#;
    let s = scene(&format!("{}{bulb}", ball_of_glass()));
    let settings = with(&s, Some(Connections::new(Method::MneeUnbiased)));
    let job = Job::new(&s, &settings, 0, 0..1, &());
    let along = [Direction::uniform(s.params(), "floor.reflectance.value").expect("a parameter")];
    let forward = Estimator::Mis.forward_f32(&job, s.params().values(), &along);
    let active = Active::new(&s, &["floor.reflectance.value"]).expect("a parameter");
    let theta = Theta::constant(s.params().values());
    let reverse = backward_f32(&job, &theta, &active, &mean_adjoint(&s));
    for error in [
        forward.err().map(|e| e.to_string()),
        reverse.err().map(|e| e.to_string()),
    ] {
        let error = error.expect("refused");
        assert!(error.contains("bulb.intensity.value"), "{error}");
    }
}

/// Water over a floor: `waves` is a mesh with interpolated normals, or else the normals of a plane are mapped. Lit by a narrow
/// lobe of the sky or by a lamp.
fn bumpy_pool(waves: bool, sky: bool) -> Scene {
    let mut build = Builder::new();
    let reflectance = build.rgb("floor.reflectance.value", [0.6, 0.5, 0.4], (0.0, 1.0));
    let floor = build.add_material(Diffuse {
        reflectance: reflectance.expect("valid"),
    });
    let one = |build: &mut Builder, name: &str| {
        let name = format!("water.{name}.value");
        build.rgb(&name, [1.0; 3], (0.0, 1.0)).expect("valid")
    };
    let glass = Dielectric {
        eta: build
            .scalar("water.eta.value", 1.33, (0.1, 10.0))
            .expect("valid"),
        specular_reflectance: one(&mut build, "specular_reflectance"),
        specular_transmittance: one(&mut build, "specular_transmittance"),
    };
    let quad = |y: f64, half: f64| {
        let edges = [[0.0, 0.0, 2.0 * half], [2.0 * half, 0.0, 0.0]];
        Patch::new([-half, y, -half], edges[0], edges[1], false).expect("an area")
    };
    build.add_shape("floor", Rectangle(quad(0.0, 3.0)), floor);
    let wave = |x: f32, z: f32| (2.1 * x + 0.4).sin() * (1.7 * z - 0.3).cos();
    if waves {
        let water = build.add_material(glass);
        let n = 24u32;
        let at = |i: u32| 6.0 * i as f32 / n as f32 - 3.0;
        let positions: Vec<[f32; 3]> = (0..=n)
            .flat_map(|i| (0..=n).map(move |j| (at(i), at(j))))
            .map(|(x, z)| [x, 0.7 + 0.06 * wave(x, z), z])
            .collect();
        let triangles: Vec<[u32; 3]> = (0..n)
            .flat_map(|i| (0..n).map(move |j| (i * (n + 1) + j, (i + 1) * (n + 1) + j)))
            .flat_map(|(a, b)| [[a, a + 1, b + 1], [a, b + 1, b]])
            .collect();
        let data = MeshData {
            normals: smooth_normals(&positions, &triangles),
            positions,
            triangles,
            ..Default::default()
        };
        build.add_shape("water", Mesh::new(data, false).expect("a mesh"), water);
    } else {
        let n = 8;
        let texels: Vec<f32> = (0..n * n)
            .flat_map(|i| {
                let (x, z) = ((i % n) as f32, (i / n) as f32);
                [0.5 + 0.06 * wave(x, z), 0.5 + 0.06 * wave(z + 2.0, x), 1.0]
            })
            .collect();
        let map = build
            .texels("normals", [n as u32; 2], &texels, (-1.0, 2.0))
            .expect("valid");
        let mapped = NormalMap::new(map, Interpolation::Normals, Arc::new(glass.into()));
        let water = build.add_material(mapped.expect("few levels"));
        build.add_shape("water", Rectangle(quad(0.7, 3.0)), water);
    }
    if sky {
        let radiance = build.rgb("sky.radiance.value", [9.0, 8.0, 7.0], (0.0, f64::INFINITY));
        let lobe = Vmf::new(radiance.expect("valid"), [0.2, 1.0, 0.1], 150.0);
        build.add_emitter(lobe.expect("a direction"), None);
    } else {
        let black = build
            .rgb("lamp.reflectance.value", [0.0; 3], (0.0, 1.0))
            .expect("valid");
        let black = build.add_material(Diffuse { reflectance: black });
        let corner = Patch::new([-0.6, 2.6, -0.6], [1.2, 0.0, 0.0], [0.0, 0.0, 1.2], false);
        let shape = build.add_shape("lamp", Rectangle(corner.expect("an area")), black);
        let radiance = build.rgb("lamp.radiance.value", [9.0, 8.0, 7.0], (0.0, f64::INFINITY));
        let light = Area {
            radiance: radiance.expect("valid"),
            exponent: 0.0,
            shape,
        };
        build.add_emitter(light, Some(shape));
    }
    let view = Transform::look_at([0.0, 3.0, 4.0], [0.0, 0.2, 0.0], [0.0, 1.0, 0.0]);
    let camera = Camera::new(view.expect("a view"), 40.0, FovAxis::Smaller, [8, 8]);
    let film = Film {
        filter: PixelFilter::Box,
        ..Film::new(8, 8)
    };
    let settings = Settings {
        max_depth: 5,
        ..Settings::default()
    };
    build
        .build(camera.expect("a camera"), film, settings)
        .expect("a scene")
}

/// Meshes with interpolated normals, mapped normals, and directions of the sky: as paths alone, 48 runs of 16 samples against
/// 48 of 256; significance 1e-3 over all blocks.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn bumpy_water_keeps_its_energy() {
    let limit = z_limit(4 * 4 * 3, 48, ALPHA);
    for (waves, sky) in [(true, false), (true, true), (false, false), (false, true)] {
        let s = bumpy_pool(waves, sky);
        let paths = picture(&s, &with(&s, None), 1000, 48, 256);
        let ours = picture(&s, &with(&s, Some(sms(1))), 2000, 48, 16);
        let none = Connections {
            method: Method::LeftOut,
            ..sms(1)
        };
        let rest = picture(&s, &with(&s, Some(none)), 3000, 48, 16);
        let worst = ours
            .iter()
            .zip(&paths)
            .map(|(a, b)| a.z(b).abs())
            .fold(0.0, f64::max);
        let seen = ours
            .iter()
            .zip(&rest)
            .map(|(a, b)| a.z(b))
            .fold(0.0, f64::max);
        println!(
            "waves {waves}, sky {sky}: |z| up to {worst:.2} of {limit:.2}; chains are worth {seen:.1}"
        );
        assert!(worst < limit, "waves {waves}, sky {sky}: {worst}");
        assert!(seen > 2.0 * limit, "waves {waves}, sky {sky}: {seen}");
    }
}

/// Wherever walks start, they bring the same light: over glass with chains of two, and over water with mapped normals, against
/// uniform starts; 32 runs of 16 samples each, significance 1e-3 over all blocks. Starts where particles passed find light
/// more often.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn starts_bring_the_same_light() {
    let scenes = [
        ("glass", scene(&ball_of_glass()), 2),
        ("bumps", bumpy_pool(false, false), 1),
    ];
    let limit = z_limit(scenes.len() * 2 * 4 * 3, 32, ALPHA);
    for (name, s, bounces) in scenes {
        let of = |starts: Starts, seed: u64| {
            let connections = Connections {
                starts,
                ..sms(bounces)
            };
            let settings = with(&s, Some(connections));
            let theta = Theta::constant(s.params().values());
            let job = Job::new(&s, &settings, seed, 0..16, &());
            let found = render_f32(&job, &theta, Estimator::Mis).connections;
            let rate = found.converged as f64 / found.walks as f64;
            (picture(&s, &settings, seed, 32, 16), rate)
        };
        let (uniform, rate) = of(Starts::Uniform, 100);
        for (starts, seed) in [(Starts::TwoStage, 200), (Starts::Particles, 300)] {
            let (ours, by) = of(starts, seed);
            let each = ours.iter().zip(&uniform).map(|(a, b)| a.z(b).abs());
            let worst = each.fold(0.0, f64::max);
            println!(
                "{name}, {starts:?}: |z| up to {worst:.2} of {limit:.2}; {by:.3} of walks, {rate:.3} of uniform ones"
            );
            assert!(worst < limit, "{name}, {starts:?}: {worst}");
            assert!(
                starts != Starts::Particles || by > rate,
                "{name}: {by} {rate}"
            );
        }
    }
}

/// [`mirror`], [`ball_of_glass`] and [`pool`] of this roughness.
fn rough_scenes(alpha: [f64; 3]) -> [(&'static str, String, u32); 3] {
    let rough = |body: String, smooth: &str, alpha: f64| {
        let with = format!(r#"<bsdf type="rough{smooth}><float name="alpha" value="{alpha}"/>"#);
        let smooth = format!(r#"<bsdf type="{smooth}>"#);
        let closed = smooth.replace('>', "/>");
        let body = body.replace(&closed, &format!("{with}</bsdf>"));
        body.replace(&smooth, &with)
    };
    let [a, b, c] = alpha;
    [
        ("mirror", rough(mirror(), r#"conductor" id="metal""#, a), 1),
        (
            "glass",
            rough(ball_of_glass(), r#"dielectric" id="glass""#, b),
            2,
        ),
        ("pool", rough(pool(), r#"dielectric" id="water""#, c), 1),
    ]
}

/// Over rough metal and glass connections bring the light that paths find: one reflection, and refraction through two surfaces
/// and one. 48 runs of 16 samples against 48 of 256, significance 1e-3 over all blocks. They bring it only where the
/// threshold says so; otherwise images are those of paths, bit by bit.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn rough_casters_bring_the_light_that_paths_find() {
    let scenes = rough_scenes([0.15, 0.1, 0.05]);
    let limit = z_limit(scenes.len() * 4 * 3, 48, ALPHA);
    for (name, body, bounces) in scenes {
        // Half in the floor: under a ball above it, few of the samples carry the light, and 48 runs tell little.
        let s = scene(&body.replace(r#"value="0, 0.9, 0""#, r#"value="0, 0, 0""#));
        let connections = |method: Method, roughness: f64| Connections {
            bounces,
            roughness,
            ..Connections::new(method)
        };
        let paths = picture(&s, &with(&s, None), 1000, 48, 256);
        let ours = picture(
            &s,
            &with(&s, Some(connections(Method::Sms, 0.2))),
            2000,
            48,
            16,
        );
        let rest = picture(
            &s,
            &with(&s, Some(connections(Method::LeftOut, 0.2))),
            3000,
            48,
            16,
        );
        let each = ours.iter().zip(&paths).map(|(a, b)| a.z(b).abs());
        let worst = each.fold(0.0, f64::max);
        let seen = ours
            .iter()
            .zip(&rest)
            .map(|(a, b)| a.z(b))
            .fold(0.0, f64::max);
        println!("{name}: |z| up to {worst:.2} of {limit:.2}; chains are worth {seen:.1}");
        assert!(worst < limit, "{name}: {worst}");
        assert!(seen > limit, "{name}: {seen}");
        let theta = Theta::constant(s.params().values());
        let image = |connections| {
            let settings = with(&s, connections);
            let job = Job::new(&s, &settings, 1, 0..4, &());
            render_f32(&job, &theta, Estimator::Mis).sums
        };
        assert_eq!(
            image(Some(connections(Method::Sms, 0.04))),
            image(None),
            "{name}"
        );
    }
}

/// Derivatives in the roughness and the index of rough casters, and in what they reflect: forward and reverse mode are one to
/// rounding, in f64 at equal seeds; 32 runs of reverse mode with 64 samples agree with central differences of paths alone,
/// 16 runs of 1024 samples with common random numbers, step a twentieth of the parameter; significance 1e-3.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn derivatives_of_rough_casters_are_right() {
    let [mirror, _, pool] = rough_scenes([0.2, 0.1, 0.15]);
    let cases = [
        (
            mirror,
            ["metal.alpha.value", "metal.specular_reflectance.value"],
        ),
        (pool, ["water.alpha.value", "water.eta.value"]),
    ];
    let limit = z_limit(4, 16, ALPHA);
    for ((name, body, bounces), keys) in cases {
        let s = scene(&body);
        let connections = Connections {
            roughness: 0.3,
            ..sms(bounces)
        };
        let adjoint = mean_adjoint(&s);
        for key in keys {
            let info = (s.params().infos().iter().find(|p| p.name == key)).expect("a parameter");
            let params = [info.clone()];
            let settings = with(&s, Some(connections));
            let mut direction = vec![0.0; s.params().values().len()];
            direction[info.range()].fill(1.0);
            let reverse = |seed: u64, spp: u64| {
                let g = reverse_by::<f64, DetachedMis>(&s, &params, &adjoint, &settings, seed, spp);
                g.iter().flatten().sum::<f64>()
            };
            let aimed = Connections {
                method: Method::MneeUnbiased,
                ..connections
            };
            for settings in [&settings, &with(&s, Some(aimed))] {
                let forward = forward_by::<DetachedMis>(&s, &direction, &adjoint, settings, 5, 16);
                let g = reverse_by::<f64, DetachedMis>(&s, &params, &adjoint, settings, 5, 16);
                let back = g.iter().flatten().sum::<f64>();
                let size = back.abs().max(1e-9);
                assert!(
                    (forward - back).abs() < 1e-8 * size,
                    "{name} {key}: {forward} {back}"
                );
            }
            let ours = Estimate::of(&(0..32).map(|r| reverse(100 + r, 64)).collect::<Vec<_>>());
            let h = 0.05 * f64::from(s.params().values()[info.range().start]);
            let plain = with(&s, None);
            let difference = |seed: u64| {
                let value = |h: f64| {
                    let mut v = values::<f64>(&s);
                    v[info.range()].iter_mut().for_each(|v| *v += h);
                    let theta = Theta::constant(&v);
                    let job = Job::new(&s, &plain, seed, 0..1024, &());
                    let r = render::<f64, DetachedMis, Independent>(&job, &theta);
                    r.expect("nothing moves").mean(0).iter().sum::<f64>() / 3.0
                };
                (value(h) - value(-h)) / (2.0 * h)
            };
            let paths = Estimate::of(&(0..16).map(|r| difference(500 + r)).collect::<Vec<_>>());
            println!(
                "{name} {key}: {ours:?} {paths:?}, z {:.2} of {limit:.2}",
                ours.z(&paths)
            );
            assert!(
                ours.z(&paths).abs() < limit,
                "{name} {key}: {ours:?} {paths:?}"
            );
            assert!(ours.se < 0.3 * ours.mean.abs(), "{name} {key}: {ours:?}");
        }
    }
}
