//! Connections to skies, and over casters whose surface is an image: the light that paths find, where these do.

use std::path::Path;

use ad_core::Vec3;
use rayon::prelude::*;
use render::film::Image;
use render::image_io::write_exr;
use render::instances::{Estimator, backward_f32, render_f32};
use render::integrator::gradient::Active;
use render::manifold::{Connector, Space, Split, Start};
use render::math::Ray;
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::scene::{Connections, Method, Starts};
use render::{Job, Scene};
use tests::stats::{Estimate, z_limit};
use tests::{mean_adjoint, on_any_threads, picture, scene};

use crate::manifold::{ALPHA, FLOOR, camera, lamp, with};

/// Writes an image of a function of its columns and rows.
fn image(
    folder: &Path,
    name: &str,
    size: [usize; 2],
    of: impl Fn(usize, usize) -> [f32; 3],
) -> String {
    let mut image = Image::new(size[0], size[1]);
    for (i, texel) in image.data.chunks_exact_mut(3).enumerate() {
        texel.copy_from_slice(&of(i % size[0], i / size[0]));
    }
    let path = folder.join(name);
    write_exr(&path, &image).expect("a folder to write to");
    format!(r#"<string name="filename" value="{}"/>"#, path.display())
}

/// A dim sky with a bright patch, high above the camera's left shoulder, on less than a hundredth of it.
fn patch(folder: &Path) -> String {
    let bright = |x: usize, y: usize| (28..31).contains(&x) && (6..10).contains(&y);
    let file = image(folder, "patch.exr", [64, 33], |x, y| {
        if bright(x, y) {
            [300.0, 250.0, 200.0]
        } else {
            [0.05; 3]
        }
    });
    format!(r#"<emitter type="envmap" id="sky">{file}</emitter>"#)
}

/// A sky that is everywhere about as bright; `more`: inside of the element.
fn gentle(folder: &Path, more: &str) -> String {
    let file = image(folder, "gentle.exr", [16, 9], |x, y| {
        [1.0, 1.5, 2.0].map(|c| c + 0.5 * (x as f32).sin() + 0.05 * y as f32)
    });
    format!(r#"<emitter type="envmap" id="sky">{file}{more}</emitter>"#)
}

/// A floor under something, that lets nothing shine: `above` is what does, and what is over the floor.
fn over_floor(above: &str) -> Scene {
    scene(&format!(
        "{}{FLOOR}{above}",
        camera("0, 3, 4", "0, 0.2, 0", 5)
    ))
}

fn ball(y: f64, material: &str) -> String {
    format!(
        r#"<shape type="sphere"><point name="center" value="0, {y}, 0"/><float name="radius" value="0.7"/>
        {material}</shape>"#
    )
}

const METAL: &str = r#"<bsdf type="conductor"/>"#;

/// What connections bring agrees with paths, and is so much that paths without it would not. 48 runs of 16 samples against 48
/// of `spp`.
fn assert_as_paths(name: &str, s: &Scene, connections: Connections, spp: u64, limit: f64) {
    let settings = with(s, Some(connections));
    let split = Split::of(s, &connections);
    assert!(split.is_some_and(|s| s.connects()), "{name}");
    let left_out = Connections {
        method: Method::LeftOut,
        ..connections
    };
    let paths = picture(s, &with(s, None), 1000, 48, spp);
    let ours = picture(s, &settings, 2000, 48, 16);
    let less = picture(s, &with(s, Some(left_out)), 3000, 48, spp);
    let worst = |e: &[Estimate]| {
        let z = e.iter().zip(&paths).map(|(a, b)| a.z(b).abs());
        z.fold(0.0, f64::max)
    };
    let (z, without) = (worst(&ours), worst(&less));
    println!("{name}: |z| up to {z:.2} of {limit:.2}, without connections {without:.1}");
    assert!(z < limit, "{name}: |z| = {z}");
    assert!(without > 2.0 * limit, "{name}: |z| = {without} is no test");
}

/// Blocks of pixels under skies: one with a small bright patch, over a ball of metal, a plane of water, and a ball of glass so high
/// that it has no focus near the floor; wide ones, a constant one and an image, that a flag names. Significance 1e-3 over all
/// comparisons.
#[test]
fn skies_light_what_is_below_chains() {
    let dir = tempfile::tempdir().expect("a folder");
    let patch = patch(dir.path());
    let water = r#"<shape type="rectangle"><transform name="to_world"><scale value="4"/><rotate x="1" angle="-90"/>
        <translate y="0.6"/></transform><bsdf type="dielectric"><string name="int_ior" value="water"/></bsdf></shape>"#;
    let flag = r#"<boolean name="caustic_emitter_single" value="true"/>"#;
    let constant = format!(
        r#"<emitter type="constant"><rgb name="radiance" value="1, 2, 3"/>{flag}</emitter>"#
    );
    let glass = r#"<bsdf type="dielectric"/>"#;
    let cases = [
        (
            "patch, metal",
            format!("{patch}{}", ball(0.9, METAL)),
            1,
            1024,
        ),
        ("patch, water", format!("{patch}{water}"), 1, 1024),
        (
            "patch, glass",
            format!("{patch}{}", ball(2.4, glass)),
            2,
            1024,
        ),
        (
            "constant, metal",
            format!("{constant}{}", ball(0.9, METAL)),
            1,
            64,
        ),
        (
            "gentle, metal",
            format!("{}{}", gentle(dir.path(), flag), ball(0.9, METAL)),
            1,
            64,
        ),
    ];
    let limit = z_limit(cases.len() * 4 * 3, 48, ALPHA);
    for (name, above, bounces, spp) in cases {
        let connections = Connections {
            bounces,
            ..Connections::new(Method::Sms)
        };
        assert_as_paths(name, &over_floor(&above), connections, spp, limit);
    }
}

/// Paths find wide light by themselves, unless a flag names it; small light is for connections in any sky.
#[test]
fn wide_skies_are_left_to_paths() {
    let dir = tempfile::tempdir().expect("a folder");
    let connects = |sky: &str| {
        let s = over_floor(&format!("{sky}{}", ball(0.9, METAL)));
        Split::of(&s, &Connections::new(Method::Sms)).is_some()
    };
    let flag = r#"<boolean name="caustic_emitter_single" value="true"/>"#;
    for (sky, expected) in [
        (gentle(dir.path(), ""), false),
        (gentle(dir.path(), flag), true),
        (patch(dir.path()), true),
        (r#"<emitter type="constant"/>"#.to_owned(), false),
        (
            format!(r#"<emitter type="constant">{flag}</emitter>"#),
            true,
        ),
    ] {
        assert_eq!(connects(&sky), expected, "{sky}");
    }
    // A lamp that a flag names leaves the others to paths, whatever they are.
    let named =
        lamp(0.5, r#"<translate y="2"/>"#).replace("</emitter>", &format!("{flag}</emitter>"));
    let s = over_floor(&format!("{}{named}{}", patch(dir.path()), ball(0.9, METAL)));
    let split = Split::of(&s, &Connections::new(Method::Sms)).expect("a lamp");
    let connected = [0, 1].map(|e| split.is_connected(e));
    assert_eq!(connected.iter().filter(|c| **c).count(), 1);
}

/// Casters whose normals are an image, on a ball and on a cylinder, and a mesh that an image displaces. Significance 1e-3 over
/// all blocks.
#[test]
fn casters_may_be_images() {
    let dir = tempfile::tempdir().expect("a folder");
    let wave = |x: usize, y: usize| (0.8 * x as f32 + 0.3 * y as f32).sin();
    let normals = image(dir.path(), "normals.exr", [8, 8], |x, y| {
        [0.5 + 0.04 * wave(x, y), 0.5 + 0.04 * wave(y, x), 1.0]
    });
    let mapped = format!(
        r#"<bsdf type="normalmap"><texture type="bitmap" name="normalmap">{normals}<boolean name="raw" value="true"/></texture>
        {METAL}</bsdf>"#
    );
    let heights = image(dir.path(), "heights.exr", [6, 6], |x, y| {
        [0.03 * wave(x, y); 3]
    });
    let mut text = String::new();
    let n = 12;
    for (i, j) in (0..=n).flat_map(|i| (0..=n).map(move |j| (i, j))) {
        let [u, v] = [i, j].map(|k| f64::from(k) / f64::from(n));
        text += &format!(
            "v {} {} 0\nvt {u} {v}\nvn 0 0 1\n",
            2.4 * u - 1.2,
            2.4 * v - 1.2
        );
    }
    for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
        let at = |i: i32, j: i32| format!("{0}/{0}/{0}", (n + 1) * i + j + 1);
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        text += &format!("f {a} {b} {c} {d}\n");
    }
    let mesh = dir.path().join("plate.obj");
    std::fs::write(&mesh, text).expect("a file");
    let plate = format!(
        r#"<shape type="obj"><string name="filename" value="{}"/><texture type="bitmap" name="displacement">{heights}
        <boolean name="raw" value="true"/></texture>{METAL}
        <transform name="to_world"><translate y="1.4" z="-1.2"/></transform></shape>"#,
        mesh.display()
    );
    let cylinder = format!(
        r#"<shape type="cylinder"><point name="p0" value="-1, 0.9, 0"/><point name="p1" value="1, 0.9, 0"/>
        <float name="radius" value="0.6"/>{mapped}</shape>"#
    );
    let above = lamp(
        0.8,
        r#"<rotate x="1" angle="60"/><translate y="3" z="-2"/>"#,
    );
    let before = lamp(
        0.8,
        r#"<rotate x="1" angle="150"/><translate y="2.4" z="1.5"/>"#,
    );
    let cases = [
        ("mapped ball", format!("{above}{}", ball(0.9, &mapped))),
        ("mapped cylinder", format!("{before}{cylinder}")),
        ("displaced mesh", format!("{before}{plate}")),
    ];
    let limit = z_limit(cases.len() * 4 * 3, 48, ALPHA);
    for (name, above) in cases {
        let connections = Connections {
            bounces: 1,
            ..Connections::new(Method::Sms)
        };
        assert_as_paths(name, &over_floor(&above), connections, 512, limit);
    }
}

/// Under a ball of glass, with suns in random directions: connections are worth the sum over all solutions, with starts from
/// particles and without, in focus and out of it. 120 points and suns, 500 connections of each, by the mean of their ratios to the
/// sum over the distinct ends of 2000 walks; significance 1e-3 over both. A solution that is left out would be half of such a sum.
#[test]
fn suns_in_all_directions_count_once() {
    let limit = z_limit(2, 120, ALPHA);
    for starts in [Starts::Particles, Starts::Uniform] {
        let ratio = |k: u64| {
            let mut rng = Independent::new(1, 2, k);
            let [height, turn] = rng.next_2d::<f64>();
            let (y, phi) = (0.05 + 0.95 * height, std::f64::consts::TAU * turn);
            let r = (1.0 - y * y).sqrt();
            let sun = format!(
                r#"<emitter type="directional"><vector name="direction" value="{}, {}, {}"/></emitter>"#,
                -r * phi.cos(),
                -y,
                -r * phi.sin()
            );
            let s = over_floor(&format!(
                "{sun}{}",
                ball(0.7, r#"<bsdf type="dielectric"/>"#)
            ));
            let values: Vec<f64> = s.params().values().iter().map(|&v| v.into()).collect();
            let connections = |method: Method, starts: Starts| Connections {
                starts,
                ..Connections::new(method)
            };
            let split = Split::of(&s, &connections(Method::Sms, starts)).expect("a sun");
            let connector = |connections: Connections| {
                let space = Space {
                    scene: &s,
                    theta: Theta::constant(&values),
                    constraint: connections.constraint,
                    steps: connections.steps,
                };
                Connector::new(space, &split, connections)
            };
            let x = 0.05 + 0.9 * rng.next_1d::<f64>();
            let down = Ray::new(Vec3::new(x, 1e-5, 0.0), Vec3::new(0.0, -1.0, 0.0));
            let floor = s.intersect(&down).expect("a floor");
            let start = Start {
                si: floor.si,
                exit: s.exit(floor.prim),
            };
            let light = |connector: &Connector, seed: u64, i: u64| {
                let mut out = Vec::new();
                let mut rng = Independent::new(seed, k, i);
                connector.connect(&start, 4, &mut rng, &|| false, &mut out);
                out.iter().map(|c| c.weight).sum::<f64>()
            };
            let all = connector(connections(Method::SmsBiased(2000), Starts::Uniform));
            let all = light(&all, 3, 0);
            let mut sms = connector(connections(Method::Sms, starts));
            if starts == Starts::Particles {
                sms.learn(4, 1 << 12);
            }
            let mean = (0..500).map(|i| light(&sms, 5, i)).sum::<f64>() / 500.0;
            (all > 0.0).then_some(mean / all)
        };
        let ratios: Vec<f64> = (0..120).into_par_iter().filter_map(ratio).collect();
        let found = Estimate::of(&ratios);
        println!(
            "{starts:?}: {:.4} +- {:.4} of {}",
            found.mean,
            found.se,
            ratios.len()
        );
        assert!(ratios.len() > 60 && found.se < 0.05, "{found:?}");
        assert!((found.mean - 1.0).abs() < limit * found.se, "{found:?}");
    }
}

/// A gradient says what its walks came to: what those of the image at its seed did, for any number of threads. With one trial each
/// some run out.
#[test]
fn gradients_say_what_walks_came_to() {
    let lamp = lamp(
        0.8,
        r#"<rotate x="1" angle="90"/><translate x="0.5" y="3"/>"#,
    );
    let s = over_floor(&format!(
        "{lamp}{}",
        ball(0.9, r#"<bsdf type="dielectric"/>"#)
    ));
    let connections = Connections {
        budget: 1,
        starts: Starts::Uniform,
        ..Connections::new(Method::Sms)
    };
    let settings = with(&s, Some(connections));
    let job = Job::new(&s, &settings, 5, 0..4, &());
    let theta = Theta::constant(s.params().values());
    let image = render_f32(&job, &theta, Estimator::Mis).connections;
    assert!(image.walks > 0 && image.exhausted > 0, "{image:?}");
    let active = Active::new(&s, &["floor.reflectance.value"]).expect("a parameter");
    let adjoint = mean_adjoint(&s);
    let gradient = || {
        let found = backward_f32(&job, &theta, &active, &adjoint).expect("a gradient");
        (found.connections, found.glints)
    };
    assert_eq!(on_any_threads(gradient), (image, Default::default()));
}
