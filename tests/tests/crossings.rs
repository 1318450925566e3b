//! Derivatives in what moves where shapes cross each other, by edges: against central differences.

use std::fmt::Write;

use render::estimator::{DetachedMis, Interior, Outlines};
use render::instances::{Direction, Estimator};
use render::integrator::gradient::Active;
use render::params::Theta;
use render::statistics::Estimate;
use render::{Job, Scene};
use tests::moving::{self, FLOOR, agrees, differences, scene};
use tests::{mean_adjoint, values};

type ByEdges = Outlines<Interior<DetachedMis>>;

/// Derivatives of the mean of all pixels and channels in double precision, from 8 seeds.
fn gradient(s: &Scene, names: &[&str], spp: u64) -> Vec<Estimate> {
    moving::gradient::<ByEdges>(s, names, 8, spp)
}

/// A cube that is sunk in the floor.
const CUBE: &str = r#"<shape type="cube" id="it"><transform name="to_world"><scale value="0.6"/><rotate y="1" angle="25"/>
    <rotate x="1" angle="20"/><translate y="0.3"/></transform><ref id="grey"/></shape>"#;
/// Another one that crosses it.
const OTHER: &str = r#"<shape type="cube" id="other"><transform name="to_world"><scale x="0.3" y="0.3" z="0.9"/>
    <rotate y="1" angle="70"/><rotate z="1" angle="15"/><translate x="0.3" y="0.8" z="0.2"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.7, 0.3"/></bsdf></shape>"#;
const BALL: &str = r#"<shape type="sphere" id="it"><float name="radius" value="0.8"/><transform name="to_world">
    <translate x="0.2" y="0.3" z="0.1"/></transform><ref id="grey"/></shape>"#;
const DISK: &str = r#"<shape type="disk" id="it"><transform name="to_world"><scale x="0.9" y="0.7"/><rotate x="1" angle="-50"/>
    <rotate y="1" angle="20"/><translate y="0.25"/></transform><bsdf type="twosided"><ref id="grey"/></bsdf></shape>"#;

/// A sphere of triangles with its middle in the origin, of rings of so many points.
fn sphere_mesh(rings: u32, around: u32) -> String {
    let mut text = String::new();
    let point = |i: u32, j: u32| {
        let (y, r) = (std::f64::consts::PI * f64::from(i) / f64::from(rings)).sin_cos();
        let (sin, cos) = (std::f64::consts::TAU * f64::from(j) / f64::from(around)).sin_cos();
        (y * cos, if 2 * i == rings { 0.0 } else { r }, y * sin)
    };
    writeln!(text, "v 0 1 0\nv 0 -1 0").expect("a text");
    for i in 1..rings {
        for j in 0..around {
            let (x, y, z) = point(i, j);
            writeln!(text, "v {x} {y} {z}").expect("a text");
        }
    }
    let of = |i: u32, j: u32| 3 + (i - 1) * around + j % around;
    for j in 0..around {
        writeln!(text, "f 1 {} {}", of(1, j + 1), of(1, j)).expect("a text");
        writeln!(text, "f 2 {} {}", of(rings - 1, j), of(rings - 1, j + 1)).expect("a text");
        for i in 1..rings - 1 {
            let [a, b, c, d] = [of(i, j), of(i, j + 1), of(i + 1, j + 1), of(i + 1, j)];
            writeln!(text, "f {a} {b} {c}\nf {a} {c} {d}").expect("a text");
        }
    }
    text
}

/// A shape `it` from the text of a mesh with flat faces, placed by a transform.
fn mesh(folder: &tempfile::TempDir, name: &str, text: &str, placed: &str) -> String {
    let path = folder.path().join(name);
    std::fs::write(&path, text).expect("a file");
    format!(
        r#"<shape type="obj" id="it"><string name="filename" value="{}"/><boolean name="face_normals" value="true"/>
        <transform name="to_world">{placed}</transform><ref id="grey"/></shape>"#,
        path.display()
    )
}

fn against_differences(what: &str, body: &str, depth: u32, names: &[&str], spp: [u64; 2], h: f32) {
    let mut s = scene(&format!("{FLOOR}{body}"), depth);
    s.make_movable(names).expect("known");
    let found = gradient(&s, names, spp[0]);
    let expected = differences(&mut s, names, h, 8, spp[1]);
    agrees(what, &found, &expected, 1e-2, 8);
}

/// Shapes that are sunk in the floor, and two that cross each other: whatever of them moves, the camera, too, directly and
/// through bounces. 8 runs of 128 samples of 256 pixels, and differences of 8 runs of 256.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn shapes_that_cross_agree_with_differences() {
    let both = format!("{CUBE}{OTHER}");
    for (what, body, depth) in [
        ("cube", CUBE, 2),
        ("ball", BALL, 2),
        ("disk", DISK, 2),
        ("two cubes", &both, 2),
        ("two cubes through bounces", &both, 4),
        ("ball through bounces", BALL, 4),
    ] {
        let names = ["it.translation", "floor.translation", "sensor.translation"];
        against_differences(what, body, depth, &names, [128, 256], 1.0 / 32.0);
    }
}

/// Turns and sizes of both shapes at a line. 8 runs of 256 samples of 256 pixels, and differences of 8 runs of 512.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn turns_of_shapes_that_cross_agree_with_differences() {
    let both = format!("{CUBE}{OTHER}");
    let names = [
        "it.rotation",
        "it.scale",
        "other.rotation",
        "floor.rotation",
    ];
    against_differences("turns", &both, 3, &names, [256, 512], 1.0 / 32.0);
}

/// Tubes: in the floor, through a ball, through another tube, and beside one that is parallel. 8 runs of 256 samples of 256
/// pixels, and differences of 8 runs of 512.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn tubes_that_cross_agree_with_differences() {
    let tube = |id: &str, p: [f64; 3], q: [f64; 3], radius: f64| {
        let at = |name: &str, [x, y, z]: [f64; 3]| {
            format!(r#"<point name="{name}" x="{x}" y="{y}" z="{z}"/>"#)
        };
        format!(
            r#"<shape type="cylinder" id="{id}">{}{}<float name="radius" value="{radius}"/><bsdf type="twosided">
            <bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.7, 0.4"/></bsdf></bsdf></shape>"#,
            at("p0", p),
            at("p1", q)
        )
    };
    let leaning = tube("it", [-0.3, -0.5, 0.2], [0.5, 1.3, 0.0], 0.45);
    let through = tube("other", [-0.9, 0.7, 0.6], [0.9, 0.5, 0.3], 0.3);
    let beside = tube("other", [0.2, -0.3, 0.4], [1.0, 1.5, 0.2], 0.4);
    for (what, body) in [
        ("in the floor", leaning.clone()),
        ("through a tube", format!("{leaning}{through}")),
        ("beside a tube", format!("{leaning}{beside}")),
        ("through a ball", format!("{BALL}{through}")),
    ] {
        against_differences(what, &body, 2, &["it.translation"], [256, 1024], 1.0 / 32.0);
    }
}

/// Meshes: a sphere that is sunk in the floor, and, of an octahedron that is sunk and crosses another one of the
/// same mesh, its points. 8 runs of 256 samples of 256 pixels, and differences of 8 runs of 512.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn meshes_that_cross_agree_with_differences() {
    let folder = tempfile::tempdir().expect("a folder");
    let sphere = mesh(
        &folder,
        "sphere.obj",
        &sphere_mesh(10, 16),
        r#"<scale value="0.8"/><translate y="-0.1"/>"#,
    );
    let names = ["it.translation", "it.rotation"];
    against_differences("ball of faces", &sphere, 2, &names, [256, 512], 1.0 / 32.0);

    let mut text = String::new();
    for (x, y) in [(0.0, 0.0), (0.5, 0.45)] {
        for k in 0..3 {
            for sign in [1.0, -1.0] {
                let [a, b, c] = [0, 1, 2].map(|i| if i == k { sign } else { 0.0 });
                writeln!(text, "v {} {} {c}", a + x, b + y).expect("a text");
            }
        }
    }
    for first in [0, 6] {
        for octant in 0..8 {
            let [x, y, z] = [0, 1, 2].map(|k| first + 2 * k + 1 + (octant >> k & 1));
            let (y, z) = if i32::count_ones(octant) % 2 == 1 {
                (z, y)
            } else {
                (y, z)
            };
            writeln!(text, "f {x} {y} {z}").expect("a text");
        }
    }
    let placed = r#"<scale value="0.7"/><rotate y="1" angle="25"/><rotate x="1" angle="20"/><translate y="0.2"/>"#;
    let octahedra = mesh(&folder, "octahedra.obj", &text, placed);
    against_differences(
        "points",
        &octahedra,
        2,
        &["it.vertex_positions"],
        [256, 256],
        1.0 / 32.0,
    );
}

/// A lamp that a cube cuts: whatever moves, light at the last vertex comes from the line, too. 8 runs of 256 samples of 256
/// pixels, and differences of 8 runs of 512.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn lamps_that_cross_agree_with_differences() {
    let cut = r#"<shape type="cube" id="it"><transform name="to_world"><scale value="0.35"/><rotate y="1" angle="25"/>
        <rotate x="1" angle="20"/><translate x="0.5" y="3" z="-0.2"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.7, 0.4"/></bsdf></shape>"#;
    let names = ["it.translation", "lamp.translation"];
    against_differences("a lamp", cut, 2, &names, [256, 512], 1.0 / 32.0);
}

/// Forward and reverse mode are one linear map, in single precision, too.
#[test]
fn forward_is_reverse_where_shapes_cross() {
    let mut s = scene(
        &format!("{FLOOR}{CUBE}{OTHER}{}", BALL.replace("it", "ball")),
        4,
    );
    let name = "it.translation";
    s.make_movable(&[name]).expect("known");
    let job = Job::new(&s, &s.settings, 5, 0..4, &());
    let adjoint = mean_adjoint(&s);
    let all = values::<f32>(&s);
    let theta = Theta::constant(&all);
    let active = Active::seen_by::<ByEdges, _>(&s, &[name]).expect("seen");
    let reverse = Estimator::Edges.backward_f32(&job, &theta, &active, &adjoint);
    let reverse: f64 = reverse.expect("admitted").values.concat().iter().sum();
    let along = [Direction::uniform(s.params(), name).expect("known")];
    let image = Estimator::Edges.forward_f32(&job, s.params().values(), &along);
    let forward = tests::dot(&adjoint, &image.expect("admitted"), 1);
    assert!(
        reverse.abs() > 1e-3 && (forward - reverse).abs() < 1e-4 * reverse.abs(),
        "{forward} {reverse}"
    );
}

/// A cube on another one, whose sides lie in its sides, as the camera moves: the crease of neither is seen between them, and
/// what goes on behind an outline has none there. 8 runs of 256 samples of 256 pixels, and differences of 8 runs of 512.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn sides_that_lie_in_sides_agree_with_differences() {
    let cube = |id: &str, y: f64, radiance: f64| {
        format!(
            r#"<shape type="cube" id="{id}"><transform name="to_world"><scale value="0.5"/><rotate y="1" angle="25"/>
            <translate y="{y}"/></transform><emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter></shape>"#
        )
    };
    let stack = format!("{}{}", cube("low", 0.5, 1.0), cube("it", 1.5, 3.0));
    let mut s = scene(&stack, 1);
    let names = ["sensor.translation"];
    s.make_movable(&names).expect("known");
    let found = gradient(&s, &names, 256);
    let expected = differences(&mut s, &names, 1.0 / 32.0, 8, 512);
    agrees("stack", &found, &expected, 1e-2, 8);
}
