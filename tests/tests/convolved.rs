//! Derivatives in what moves, by directions that follow outlines: against edges, central differences, and where they are
//! known. By auxiliary rays they are right in the limit of a narrow kernel: a part of the largest derivative is allowed for
//! that; where outlines are known in closed form, nothing is.

use std::f64::consts::PI;

use ad_core::Vec3;
use render::estimator::{
    AttachedWeights, BsdfOnly, Convolved, Detached, DetachedMis, Followed, Interior, Mis, Outlines,
    Reparameterised, Unbiased,
};
use render::film::PixelFilter;
use render::instances::{Direction, Estimator};
use render::integrator::convolved::field::{LARGEST, Neighbour, boundary_test, convolve};
use render::integrator::gradient::Active;
use render::math::Frame;
use render::params::Theta;
use render::sampler::{Independent, Points, Sampler};
use render::statistics::{Estimate, z_limit};
use render::{Job, Scene};
use tests::moving::{self, BALL, CUBE, DISK, FLOOR, TUBE, differences, scene};
use tests::{mean_adjoint, values};

type Follows = Convolved<Mis<Reparameterised, Detached, AttachedWeights>>;
type Exactly = Followed<Mis<Reparameterised, Detached, AttachedWeights>>;
type FollowsBsdf = Convolved<BsdfOnly<Reparameterised>>;
type ByEdges = Outlines<Interior<DetachedMis>>;

const RUNS: u64 = 8;

/// Derivatives of the mean of all pixels and channels in double precision.
fn gradient<E: Unbiased>(s: &Scene, names: &[&str], spp: u64) -> Vec<Estimate> {
    moving::gradient::<E>(s, names, RUNS, spp)
}

/// Asserts that a gradient is another one, of which `bias` times the largest is allowed for the kernel.
fn agrees(what: &str, found: &[Estimate], expected: &[Estimate], bias: f64) {
    moving::agrees(what, found, expected, bias, RUNS);
}

/// An octahedron, faces or smooth.
fn octahedron(name: &str, faces: bool) -> String {
    let folder = std::env::temp_dir().join(format!("convolved-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join(format!("{name}.obj"));
    std::fs::write(&path, moving::octahedron()).expect("a file");
    format!(
        r#"<shape type="obj" id="it"><string name="filename" value="{}"/><boolean name="face_normals" value="{faces}"/>
        <transform name="to_world"><scale value="0.8"/><rotate y="1" angle="25"/><translate x="0.1" y="1.3" z="0.2"/>
        </transform><ref id="grey"/></shape>"#,
        path.display()
    )
}

/// Shapes that glow before nothing: the derivative of a projected area. 8 runs of 64 samples of 256 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn projected_areas_change_as_they_should() {
    let width = 2.0 * (25f64.to_radians()).tan();
    let distance = 4.0;
    let flat = |area: f64| {
        let part = area / (distance * width).powi(2);
        [0.0, 0.0, -2.0 * part / distance, 2.0 * part]
    };
    let round = |r: f64| {
        let free = distance * distance - r * r;
        let part = 2.0 * PI * (r * distance / (free * width)).powi(2);
        [0.0, 0.0, -part / distance, part]
    };
    for (what, shape, expected) in [
        ("square", r#"<shape type="rectangle" id="it">"#, flat(4.0)),
        ("disk", r#"<shape type="disk" id="it">"#, flat(PI)),
        ("ball", r#"<shape type="sphere" id="it">"#, round(1.0)),
    ] {
        let turn = if what == "ball" {
            ""
        } else {
            r#"<rotate y="1" angle="180"/>"#
        };
        let mut s = tests::scene(&format!(
            r#"<integrator type="path"><integer name="max_depth" value="1"/></integrator>
            <sensor type="perspective"><float name="fov" value="50"/><film type="hdrfilm">
            <integer name="width" value="16"/><integer name="height" value="16"/><rfilter type="box"/></film></sensor>
            {shape}<transform name="to_world">{turn}<translate z="{distance}"/></transform>
            <emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>"#
        ));
        let names = ["it.translation", "it.scale"];
        s.make_movable(&names).expect("known");
        let known = expected.map(|mean| Estimate { mean, se: 0.0 });
        // The velocity of a ball changes with the root of the distance from its outline.
        let bias = if what == "ball" { 1.5e-2 } else { 1e-2 };
        agrees(what, &gradient::<Follows>(&s, &names, 64), &known, bias);
        if what != "disk" {
            agrees(what, &gradient::<Exactly>(&s, &names, 64), &known, 0.0);
        }
        // What the film has of a smooth filter inside is the same.
        s.film.filter = PixelFilter::Gaussian { stddev: 0.5 };
        agrees(what, &gradient::<FollowsBsdf>(&s, &names, 64), &known, bias);
    }
}

/// Shapes before a floor, lit by a lamp, directly and through more bounces: whatever of them moves, and the lamp and the
/// camera, as edges have it. 8 runs of 128 samples of 256 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn directions_that_follow_agree_with_edges() {
    let all = ["it.translation", "lamp.translation", "sensor.translation"];
    let turns = ["it.rotation", "it.scale", "sensor.rotation", "sensor.fov"];
    let points = ["it.vertex_positions"];
    let faces = octahedron("faces", true);
    for (what, body, depth, names) in [
        ("cube", CUBE, 2, &all[..]),
        ("ball", BALL, 2, &all[..]),
        ("disk", DISK, 2, &all[..]),
        ("tube", TUBE, 2, &all[..]),
        ("turned cube", CUBE, 2, &turns[..]),
        ("faces", &faces, 2, &points[..]),
        ("ball through bounces", BALL, 4, &all[..]),
    ] {
        agrees_with_edges::<Follows>(what, body, depth, names, 2e-2);
    }
}

/// Asserts that derivatives in what moves are those by edges, of which `bias` times the largest is allowed for a kernel.
fn agrees_with_edges<E: Unbiased>(what: &str, body: &str, depth: u32, names: &[&str], bias: f64) {
    let mut s = scene(&format!("{FLOOR}{body}"), depth);
    s.make_movable(names).expect("known");
    let found = gradient::<E>(&s, names, 128);
    let expected = gradient::<ByEdges>(&s, names, 128);
    agrees(what, &found, &expected, bias);
}

/// The same with outlines in closed form, without anything allowed for a kernel.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn directions_that_follow_closed_forms_agree_with_edges() {
    let all = ["it.translation", "lamp.translation", "sensor.translation"];
    let turns = ["it.rotation", "it.scale", "sensor.rotation", "lamp.scale"];
    let faces = octahedron("solid", true);
    for (what, body, depth, names) in [
        ("cube", CUBE, 2, &all[..]),
        ("turned cube", CUBE, 2, &turns[..]),
        ("ball", BALL, 2, &all[..]),
        ("faces", &faces, 2, &turns[..]),
        ("ball through bounces", BALL, 4, &all[..]),
    ] {
        agrees_with_edges::<Exactly>(what, body, depth, names, 0.0);
    }
}

/// Central differences of images with other random numbers than this has: metal, and a mesh whose normals are interpolated, of
/// which `edges` miss how its faces turn from the lamp. 8 runs of 128 samples, and of 1024 for differences.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn directions_that_follow_agree_with_differences() {
    let metal = CUBE.replace("grey", "metal");
    let smooth = octahedron("smooth", false);
    for (what, body, depth, name) in [
        ("metal", &metal, 3, "it.translation"),
        ("smooth faces", &smooth, 2, "sensor.translation"),
    ] {
        let mut s = scene(&format!("{FLOOR}{body}"), depth);
        s.make_movable(&[name]).expect("known");
        let found = gradient::<Follows>(&s, &[name], 128);
        let expected = differences(&mut s, &[name], 1.0 / 32.0, RUNS, 1024);
        agrees(what, &found, &expected, 2e-2);
    }
}

/// Forward mode is the transpose of reverse mode, to rounding, at every filter and depth.
#[test]
fn both_modes_are_one_linear_map() {
    modes_are_one_map::<Follows>(&["it.translation", "lamp.rotation", "sensor.fov"]);
    modes_are_one_map::<Exactly>(&["it.translation", "lamp.rotation", "sensor.rotation"]);
}

fn modes_are_one_map<E: Unbiased>(names: &[&str]) {
    for (filter, depth) in [
        (PixelFilter::Box, 3),
        (PixelFilter::Gaussian { stddev: 0.5 }, 4),
    ] {
        let mut s = scene(&format!("{FLOOR}{BALL}"), depth);
        s.film.filter = filter;
        s.make_movable(names).expect("known");
        moving::modes_are_one_map::<E>(&format!("depth {depth}"), &s, names);
    }
}

/// In single precision it is the same, but for rounding: hundreds of paths, of which a few may take another turn.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn single_precision_is_enough() {
    let mut s = scene(&format!("{FLOOR}{CUBE}"), 2);
    let names = ["sensor.translation"];
    s.make_movable(&names).expect("known");
    let all = values::<f32>(&s);
    let adjoint = mean_adjoint(&s);
    let active = Active::seen_by::<Follows, _>(&s, &names).expect("seen");
    let theta = Theta::constant(&all);
    let runs: Vec<Vec<f64>> = (0..RUNS)
        .map(|seed| {
            let job = Job::new(&s, &s.settings, 50 + seed, 0..128, &());
            let e = Estimator::ReparameterisedMis;
            let g = e
                .backward_f32(&job, &theta, &active, &adjoint)
                .expect("admitted");
            assert_eq!(g.non_finite.count, 0);
            g.values.concat()
        })
        .collect();
    let found: Vec<_> = (0..runs[0].len())
        .map(|i| Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>()))
        .collect();
    agrees("f32", &found, &gradient::<Follows>(&s, &names, 128), 0.0);
}

/// Asserts that both modes refuse a parameter, in these words.
fn refuses(s: &Scene, e: Estimator, name: &str, words: &[&str]) {
    let all = values::<f32>(s);
    let theta = Theta::constant(&all);
    let job = Job::new(s, &s.settings, 0, 0..1, &());
    let direction = Direction::uniform(s.params(), name).expect("known");
    let message = match e.active(s, &[name]) {
        Err(e) => e.to_string(),
        Ok(active) => {
            let reverse = e.backward_f32(&job, &theta, &active, &mean_adjoint(s));
            reverse.expect_err("refused").to_string()
        }
    };
    for word in words {
        assert!(message.contains(word), "{message}");
    }
    let forward = e.forward_f32(&job, s.params().values(), &[direction]);
    assert_eq!(forward.expect_err("refused").to_string(), message);
}

/// What has no samples is refused by name, in both modes.
#[test]
fn what_is_not_covered_is_refused() {
    let refused = |body: &str, filter: PixelFilter, words: &[&str]| {
        let mut s = scene(&format!("{FLOOR}{CUBE}{body}"), 2);
        s.film.filter = filter;
        s.make_movable(&["it.translation"]).expect("known");
        refuses(&s, Estimator::ReparameterisedMis, "it.translation", words);
    };
    let point = r#"<emitter type="point"><point name="position" x="0" y="4" z="0"/></emitter>"#;
    let plain = PixelFilter::Box;
    refused(point, plain, &["it.translation", "lights without area"]);
    let tent = PixelFilter::Tent { radius: 1.0 };
    refused("", tent, &["it.translation", "box or a Gaussian"]);
    let squares = r#"<shape type="rectangle" id="squares"><bsdf type="diffuse"><texture type="checkerboard"
        name="reflectance"/></bsdf></shape>"#;
    refused(
        squares,
        plain,
        &["it.translation", "`squares` has a texture that jumps"],
    );
    let lamp =
        octahedron("lamp", false).replace(r#"<ref id="grey"/>"#, r#"<emitter type="area"/>"#);
    let lamp = lamp.replace(r#"id="it""#, r#"id="coarse""#);
    refused(
        &lamp,
        plain,
        &["it.translation", "interpolated normals of `coarse`"],
    );
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("face.obj");
    let face = "v 0 1 0\nv 1 1 0\nv 0 1 1\nvn 0 1 0.2\nf 1//1 2//1 3//1\n";
    std::fs::write(&path, face).expect("a file");
    let face = format!(
        r#"<shape type="obj" id="face"><string name="filename" value="{}"/></shape>"#,
        path.display()
    );
    let mut s = scene(&format!("{FLOOR}{face}"), 2);
    let name = "face.vertex_normals";
    s.make_movable(&[name]).expect("known");
    refuses(&s, Estimator::Mis, name, &[name, "normals at vertices"]);
    let follows = Estimator::ReparameterisedMis;
    refuses(&s, follows, name, &[name, "normals turn away"]);
}

/// Closed forms are for some outlines only.
#[test]
fn outlines_without_closed_forms_are_refused() {
    let smooth = octahedron("round", false);
    let faces = octahedron("points", true);
    for (body, name, culprit) in [
        (DISK, "it.translation", "`it` is no sphere"),
        (&smooth, "lamp.translation", "`it` is no sphere"),
        (
            &faces,
            "it.vertex_positions",
            "`it` does not move as a whole",
        ),
        (CUBE, "sensor.fov", "angle of view"),
    ] {
        let mut s = scene(&format!("{FLOOR}{body}"), 2);
        s.make_movable(&[name]).expect("known");
        refuses(&s, Estimator::ReparameterisedExact, name, &[name, culprit]);
    }
}

/// A ball in front of the sky turns about the viewer: the derivative of the integral of `y` over the sky that it leaves
/// free, in units of the true one, which is `-pi sin(radius)^2`.
fn turning_ball(rays: usize, seed: u64) -> f64 {
    const RADIUS: f64 = 0.3;
    const SAMPLES: u64 = 20_000;
    let kappa = 1e4;
    // Directions of the sky that have neighbours on the ball.
    let ring = [RADIUS, RADIUS + 7.0 / f64::sqrt(kappa)];
    let [most, least] = ring.map(f64::cos);
    let area = 2.0 * PI * (most - least);
    let speed = |d: Vec3<f64>| Vec3::new(-d.y, d.x, 0.0);
    let mut influences = Vec::new();
    let mut sum = 0.0;
    for i in 0..SAMPLES {
        let mut sampler = Independent::spread(Points::Independent, seed, 0, i);
        let [u, v]: [f64; 2] = sampler.next_2d();
        let cosine = least + (most - least) * u;
        let sine = (1.0 - cosine * cosine).sqrt();
        let (y, x) = (2.0 * PI * v).sin_cos();
        let w = Vec3::new(cosine, sine * x, sine * y);
        let frame = Frame::from_normal(w);
        let neighbours: Vec<_> = (0..rays)
            .map(|_| {
                let neighbour = Neighbour::sample(&frame, kappa, sampler.next_2d());
                let inside = RADIUS - neighbour.d.x.min(1.0).acos();
                let on_ball = inside > 0.0;
                let test = if on_ball {
                    boundary_test(kappa, inside)
                } else {
                    LARGEST
                };
                (neighbour, test)
            })
            .collect();
        convolve(w, kappa, &neighbours, &mut influences);
        let (mut v, mut divergence) = (Vec3::zero(), 0.0);
        for ((n, _), i) in neighbours.iter().zip(&influences) {
            if n.d.x > RADIUS.cos() {
                v += speed(n.d) * i.share;
                divergence += i.divergence.dot(speed(n.d));
            }
        }
        v -= w * w.dot(v);
        sum += (v.y + w.y * divergence) * area;
    }
    sum / SAMPLES as f64 / (-PI * RADIUS.sin().powi(2))
}

/// Sixteen neighbours are enough, and two miss a quarter. 8 runs of 20000 directions.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn a_few_neighbours_know_the_divergence() {
    let of = |rays| Estimate::of(&(0..RUNS).map(|s| turning_ball(rays, s)).collect::<Vec<_>>());
    let (many, two) = (of(16), of(2));
    println!("16: {many:?}, 2: {two:?}");
    let limit = z_limit(1, RUNS, 1e-3);
    assert!((many.mean - 1.0).abs() < 5e-3 + limit * many.se, "{many:?}");
    assert!(many.se < 0.02, "{many:?}");
    assert!(1.0 - two.mean > 0.1 + limit * two.se, "{two:?}");
}

/// Shares add up to one, and a velocity that is the same everywhere has the divergence of its part along the sphere.
#[test]
fn what_is_alike_stays_alike() {
    let w = Vec3::new(0.2, -0.5, 0.7).normalize();
    let frame = Frame::from_normal(w);
    let numbers = [[0.9, 0.1], [0.2, 0.4], [0.999, 0.8], [0.0, 0.0], [0.5, 0.6]];
    let tests = [0.0, LARGEST, 1e-3, 0.5, 1.0];
    let sample = |u| Neighbour::sample(&frame, 1e5, u);
    let neighbours: Vec<_> = numbers.map(sample).into_iter().zip(tests).collect();
    let mut influences = Vec::new();
    convolve(w, 1e5, &neighbours, &mut influences);
    let share: f64 = influences.iter().map(|i| i.share).sum();
    let divergence = (influences.iter()).fold(Vec3::zero(), |sum, i| sum + i.divergence);
    assert!((share - 1.0).abs() < 1e-12);
    let off = (divergence + w * 2.0).length();
    assert!(off < 1e-6, "{off}");
}
