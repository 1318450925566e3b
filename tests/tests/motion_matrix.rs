//! Every estimator of what moves against central differences, for every motion of every kind of shape, of cameras and
//! lights.
//!
//! Each range of parameters moves along fixed numbers, and what is compared is the change of the mean of an image and of a
//! sum over its blocks of 4 x 4 pixels, each times a number of its own. Differences have two steps, which are extrapolated;
//! what that changes counts as an error. Errors are relative to the change of a block, the root of the mean of squares.

use std::path::Path;

use render::image_io::write_exr;
use render::instances::{Estimator, render_f64};
use render::params::Theta;
use render::statistics::{Estimate, z_limit};
use render::{Image, Job, Scene};
use tests::moving::{BALL, CORNERS, CUBE, DISK, FACES, TUBE, scene};
use tests::values;

const RUNS: u64 = 32;
/// Samples per pixel of a run of differences, at each of four places.
const REFERENCE: u64 = 32;
/// Blocks of the image of [`scene`], times channels.
const BLOCKS: usize = 48;
/// At most so many in a test, with a significance of 1 % over all of them. Seeds are fixed.
const COMPARISONS: usize = 440;
const ALPHA: f64 = 0.01;

/// What an estimator is asked for, and what is allowed.
#[derive(Clone, Copy)]
struct Asked {
    estimator: Estimator,
    /// Samples per pixel of a run.
    spp: u64,
    /// Parts of the change of a block: what a kernel leaves, and the largest errors by chance of the mean and of the sum
    /// over blocks.
    bias: f64,
    noise: [f64; 2],
}

const EDGES: Asked = Asked {
    estimator: Estimator::Edges,
    spp: 16,
    bias: 0.01,
    noise: [0.12, 0.03],
};
const FOLLOWS: Asked = Asked {
    estimator: Estimator::ReparameterisedMis,
    spp: 8,
    bias: 0.03,
    noise: [0.4, 0.08],
};
const FOLLOWS_BSDF: Asked = Asked {
    estimator: Estimator::Reparameterised,
    spp: 8,
    bias: 0.03,
    noise: [0.6, 0.15],
};
/// Its outlines are known: nothing is left by a kernel.
const FOLLOWS_EXACTLY: Asked = Asked {
    estimator: Estimator::ReparameterisedExact,
    bias: 0.01,
    ..FOLLOWS
};
const INTERIOR: Asked = Asked {
    estimator: Estimator::Interior,
    ..EDGES
};

struct Case {
    what: &'static str,
    scene: Scene,
    moves: Vec<&'static str>,
    asked: Vec<Asked>,
}

/// The change of the mean and of the sum over blocks.
type Changes = [Estimate; 2];

/// A number for each block, between -1 and 1.
fn block_weight(block: usize) -> f64 {
    (2.7 * block as f64 + 0.3).sin()
}

/// Along what the element of a range moves.
fn along(name: &str, i: usize) -> f64 {
    let unit = if name.ends_with("fov") { 20.0 } else { 1.0 };
    unit * (1.9 * i as f64 + name.len() as f64).cos()
}

/// Of the block that holds number `i` of an image.
fn block_of(s: &Scene, i: usize) -> usize {
    let [width, height] = s.film.crop_size.map(|n| n as usize);
    let (x, y, channel) = (i / 3 % width, i / 3 / width, i % 3);
    (y * 4 / height * 4 + x * 4 / width) * 3 + channel
}

/// What images are multiplied by for the two sums.
fn adjoints(s: &Scene) -> [Vec<f32>; 2] {
    let n = s.film.pixels() * 3;
    let all = |f: &dyn Fn(usize) -> f64| (0..n).map(|i| (f(i) / n as f64) as f32).collect();
    [all(&|_| 1.0), all(&|i| block_weight(block_of(s, i)))]
}

/// Means of blocks, at a part of the way along a range.
fn blocks(s: &mut Scene, name: &str, start: &[f32], by: f64) -> Vec<[f64; BLOCKS]> {
    let mut moved = start.to_vec();
    let range = s.params().find(name).expect("known").range();
    for (i, x) in moved[range].iter_mut().enumerate() {
        *x += (by * along(name, i)) as f32;
    }
    s.set_params(&moved).expect("valid");
    let all = values::<f64>(s);
    let runs = (0..RUNS).map(|seed| {
        let job = Job::new(s, &s.settings, 1000 + seed, 0..REFERENCE, &());
        let image = render_f64(&job, &Theta::constant(&all), Estimator::Mis);
        let per = (REFERENCE * 3 * s.film.pixels() as u64) as f64 / BLOCKS as f64;
        let mut sums = [0.0; BLOCKS];
        for (i, x) in image.sums[0].iter().enumerate() {
            sums[block_of(s, i)] += x / per;
        }
        sums
    });
    runs.collect()
}

/// Central differences with common random numbers in double precision, what their extrapolation changes, and the change
/// of a block.
fn differences(s: &mut Scene, name: &str) -> (Changes, [f64; 2], f64) {
    let start = s.params().values().to_vec();
    let [wide, narrow] = [1.0 / 16.0, 1.0 / 32.0].map(|h: f64| {
        let [up, down] = [h, -h].map(|h| blocks(s, name, &start, h));
        let change =
            |a: [f64; BLOCKS], b: [f64; BLOCKS]| std::array::from_fn(|k| (a[k] - b[k]) / (2.0 * h));
        let changes = up.into_iter().zip(down).map(|(a, b)| change(a, b));
        changes.collect::<Vec<[f64; BLOCKS]>>()
    });
    s.set_params(&start).expect("valid");
    let sums: [&dyn Fn(usize) -> f64; 2] = [&|_| 1.0, &block_weight];
    let of = |run: &[f64; BLOCKS], weight: &dyn Fn(usize) -> f64| {
        let parts = run.iter().enumerate().map(|(k, x)| x * weight(k));
        parts.sum::<f64>() / BLOCKS as f64
    };
    let changes = sums.map(|weight| {
        let runs = wide.iter().zip(&narrow);
        let runs = runs.map(|(a, b)| (4.0 * of(b, weight) - of(a, weight)) / 3.0);
        Estimate::of(&runs.collect::<Vec<f64>>())
    });
    let steps = sums.map(|weight| {
        let runs = wide.iter().zip(&narrow);
        let sum: f64 = runs.map(|(a, b)| of(b, weight) - of(a, weight)).sum();
        (sum / 3.0 / RUNS as f64).abs()
    });
    let mean = |k: usize| narrow.iter().map(|run| run[k]).sum::<f64>() / RUNS as f64;
    let squares: f64 = (0..BLOCKS).map(|k| mean(k).powi(2)).sum();
    (changes, steps, (squares / BLOCKS as f64).sqrt())
}

/// The same by an estimator, for each range.
fn estimates(case: &Case, asked: Asked) -> Vec<Changes> {
    let s = &case.scene;
    let active = (asked.estimator)
        .active(s, &case.moves)
        .expect("parameters of motion");
    let theta = Theta::constant(s.params().values());
    let runs = adjoints(s).map(|adjoint| {
        let run = |seed: u64| {
            let job = Job::new(s, &s.settings, seed, 0..asked.spp, &());
            let g = (asked.estimator).backward_f32(&job, &theta, &active, &adjoint);
            let g = g.expect("admitted");
            assert_eq!(g.non_finite.count, 0, "{}", case.what);
            let ranges = case.moves.iter().zip(&g.values);
            let changes = ranges.map(|(name, g)| {
                let sums = g.iter().enumerate().map(|(i, g)| g * along(name, i));
                sums.sum::<f64>()
            });
            changes.collect::<Vec<f64>>()
        };
        (0..RUNS).map(run).collect::<Vec<Vec<f64>>>()
    });
    let of = |k: usize| {
        [0, 1].map(|sum: usize| {
            let runs = runs[sum].iter().map(|run| run[k]);
            Estimate::of(&runs.collect::<Vec<f64>>())
        })
    };
    (0..case.moves.len()).map(of).collect()
}

/// Says what differs; counts comparisons.
fn compare(case: &mut Case, failed: &mut Vec<String>) -> usize {
    let limit = z_limit(COMPARISONS, RUNS, ALPHA);
    let moves = case.moves.clone();
    let references: Vec<_> = (moves.iter())
        .map(|name| differences(&mut case.scene, name))
        .collect();
    let mut compared = 0;
    for &asked in &case.asked {
        let found = estimates(case, asked);
        for ((name, found), (expected, steps, size)) in moves.iter().zip(found).zip(&references) {
            assert!(*size > 0.0, "{}: {name} changes nothing", case.what);
            for (k, sum) in ["mean", "blocks"].into_iter().enumerate() {
                compared += 1;
                let (a, b) = (found[k], expected[k]);
                let noise = a.se.hypot(b.se);
                let off = (a.mean - b.mean).abs() - asked.bias * size - steps[k];
                let line = format!(
                    "{}, {}, {name}, {sum}: {:+.3e} +- {:.1e}, differences {:+.3e} +- {:.1e} (step {:.1e}) of {size:.1e}",
                    case.what,
                    asked.estimator.name(),
                    a.mean,
                    a.se,
                    b.mean,
                    b.se,
                    steps[k],
                );
                let verdict = if off > limit * noise {
                    "wrong"
                } else if noise > asked.noise[k] * size || steps[k] > 0.1 * size {
                    "says nothing"
                } else {
                    ""
                };
                println!("{line} {verdict}");
                if !verdict.is_empty() {
                    failed.push(format!("{line}: {verdict}"));
                }
            }
        }
    }
    compared
}

const MATERIALS: &str =
    r#"<bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf>"#;
const FLOOR: &str = r#"<shape type="rectangle" id="floor"><transform name="to_world"><scale value="6"/>
    <rotate x="1" angle="-90"/></transform><ref id="grey"/></shape>"#;
/// Large, so that scattered directions find it.
const LAMP: &str = r#"<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="1.4"/>
    <rotate x="1" angle="90"/><rotate z="1" angle="20"/><translate x="0.5" y="3.6" z="0.4"/></transform>
    <emitter type="area"><rgb name="radiance" value="3, 4, 5"/></emitter></shape>"#;
const BULB: &str = r#"<emitter type="point" id="bulb"><point name="position" x="-1" y="3" z="0.5"/>
    <rgb name="intensity" value="9, 8, 7"/></emitter>"#;
const TORCH: &str = r#"<emitter type="spot" id="torch"><transform name="to_world">
    <lookat origin="1.5, 3, 1" target="0, 0.5, 0" up="0, 0, 1"/></transform>
    <float name="cutoff_angle" value="40"/><rgb name="intensity" value="8, 9, 10"/></emitter>"#;
const SUN: &str = r#"<emitter type="directional" id="sun"><vector name="direction" x="0.4" y="-1" z="-0.3"/>
    <rgb name="irradiance" value="2, 1.8, 1.6"/></emitter>"#;
/// What it throws ends on the floor, and on what stands there.
const PROJECTOR: &str = r#"<emitter type="projector"><transform name="to_world">
    <lookat origin="1.5, 4, 1.5" target="0.2, 0.5, 0" up="0, 0, 1"/></transform><float name="fov" value="24"/>
    IMAGE</emitter>"#;
/// Glossy, behind what moves.
const WALL: &str = r#"<shape type="rectangle"><transform name="to_world"><scale value="5"/><translate z="-1.6"/></transform>
    <bsdf type="roughconductor"><float name="alpha" value="0.4"/></bsdf></shape>"#;
const PLATE: &str = r#"<shape type="rectangle" id="it"><transform name="to_world"><scale x="0.8" y="0.6"/>
    <rotate x="1" angle="-60"/><rotate y="1" angle="20"/><translate y="1.1"/></transform>
    <bsdf type="twosided"><ref id="grey"/></bsdf></shape>"#;

const BODY: [&str; 3] = ["it.translation", "it.rotation", "it.scale"];
const POINTS: [&str; 4] = [
    "it.translation",
    "it.rotation",
    "it.scale",
    "it.vertex_positions",
];
/// Of the first shape of an instance.
const PART: [&str; 4] = [
    "it.shape0.translation",
    "it.shape0.rotation",
    "it.shape0.scale",
    "it.shape0.vertex_positions",
];
const CAMERA: [&str; 3] = ["sensor.translation", "sensor.rotation", "sensor.fov"];

/// An octahedron `it`, straight or turned, whose normals are those of its faces or of a ball.
fn octahedron(folder: &Path, smooth: bool, turn: &str, more: &str) -> String {
    let path = folder.join("octahedron.obj");
    let mut text = String::new();
    for [x, y, z] in CORNERS {
        let u = 0.5 + 0.3 * f64::from(x) + 0.1 * f64::from(z);
        let v = 0.5 + 0.3 * f64::from(y) - 0.1 * f64::from(z);
        text += &format!("v {x} {y} {z}\nvt {u} {v}\n");
    }
    for [a, b, c] in FACES {
        text += &format!("f {a}/{a} {b}/{b} {c}/{c}\n");
    }
    std::fs::write(&path, text).expect("a file");
    format!(
        r#"<shape type="obj" id="it"><string name="filename" value="{}"/>
        <boolean name="face_normals" value="{}"/><transform name="to_world"><scale value="0.8"/>{turn}
        <translate y="1.1"/></transform>{more}</shape>"#,
        path.display(),
        !smooth
    )
}

/// An image in a file, and a texture of it.
fn bitmap(folder: &Path, key: &str, size: [usize; 2], middle: f64, height: f64) -> String {
    let mut image = Image::new(size[0], size[1]);
    for (i, x) in image.data.iter_mut().enumerate() {
        *x = (middle + height * (1.7 * (i / 3) as f64).sin()) as f32;
    }
    let path = folder.join(format!("{key}.exr"));
    write_exr(&path, &image).expect("a folder to write to");
    format!(
        r#"<texture type="bitmap" name="{key}"><string name="filename" value="{}"/><boolean name="raw" value="true"/>
        </texture>"#,
        path.display()
    )
}

fn case(what: &'static str, body: &str, moves: &[&'static str], asked: &[Asked]) -> Case {
    case_of_depth(2, what, body, moves, asked)
}

fn case_of_depth(
    depth: u32,
    what: &'static str,
    body: &str,
    moves: &[&'static str],
    asked: &[Asked],
) -> Case {
    let mut s = scene(&format!("{MATERIALS}{body}"), depth);
    s.make_movable(moves).expect("known");
    Case {
        what,
        scene: s,
        moves: moves.into(),
        asked: asked.into(),
    }
}

/// Compares all, and fails if anything differs or says nothing.
fn compare_all(cases: Vec<Case>) {
    let mut failed = Vec::new();
    let mut compared = 0;
    for mut case in cases {
        let start = std::time::Instant::now();
        compared += compare(&mut case, &mut failed);
        println!("{}: {:.1} s", case.what, start.elapsed().as_secs_f64());
    }
    println!("{compared} comparisons");
    assert!(compared <= COMPARISONS, "{compared}");
    assert!(failed.is_empty(), "\n{}", failed.join("\n"));
}

#[test]
fn all_motions_of_all_shapes() {
    let dir = tempfile::tempdir().expect("a folder");
    let folder = dir.path();
    let room = format!("{FLOOR}{LAMP}");
    let all = [EDGES, FOLLOWS, FOLLOWS_BSDF];
    let grey = r#"<ref id="grey"/>"#;
    let turn = r#"<rotate y="1" angle="25"/><rotate x="1" angle="20"/>"#;
    let faces = octahedron(folder, false, turn, grey);
    let smooth = octahedron(folder, true, "", grey);
    let grouped = faces.replace(" id=\"it\"", "");
    let instance = format!(
        r#"<shape type="shapegroup" id="group">{grouped}</shape><shape type="instance" id="it"><ref id="group"/>
        <transform name="to_world"><scale x="1" y="0.8" z="0.9"/><translate x="0.1" y="0.2"/></transform></shape>"#
    );
    let with = |a: &[&'static str], b: &[&'static str]| [a, b].concat();
    let camera = with(&BODY, &CAMERA);
    // A turn of a ball without a texture changes nothing.
    let round = with(&["it.translation", "it.scale"], &CAMERA);
    let lamp = ["lamp.translation", "lamp.rotation", "lamp.scale"];
    let mut cases = vec![
        case("rectangle", &format!("{room}{PLATE}"), &BODY, &all),
        case("disk", &format!("{room}{DISK}"), &BODY, &all),
        case("sphere", &format!("{room}{BALL}"), &round, &all),
        case("cylinder", &format!("{room}{TUBE}"), &BODY, &all),
        case(
            "cube",
            &format!("{room}{CUBE}"),
            &with(&camera, &lamp),
            &all,
        ),
        case("faces", &format!("{room}{faces}"), &POINTS, &all),
        case(
            "smooth faces",
            &format!("{room}{smooth}"),
            &with(&POINTS, &CAMERA),
            &all,
        ),
        case("instance", &format!("{room}{instance}"), &PART, &all),
    ];
    let lights = format!("{FLOOR}{BULB}{TORCH}");
    let moves = ["it.translation", "bulb.position", "torch.position"];
    cases.push(case("lights", &format!("{lights}{CUBE}"), &moves, &[EDGES]));
    let sky = bitmap(folder, "sky", [8, 4], 0.8, 0.5);
    let sky = sky.split_once("<string").expect("a texture").1;
    let sky = sky.split_once("<boolean").expect("a texture").0;
    let sky = format!(r#"<emitter type="envmap" id="sky"><string{sky}</emitter>"#);
    let moves = ["it.translation", "sky.rotation", "sensor.rotation"];
    cases.push(case("sky", &format!("{FLOOR}{sky}{CUBE}"), &moves, &all));
    let paint = bitmap(folder, "reflectance", [5, 4], 0.5, 0.4);
    let paint = format!(r#"<bsdf type="twosided"><bsdf type="diffuse">{paint}</bsdf></bsdf>"#);
    let painted = PLATE.replace(r#"<bsdf type="twosided"><ref id="grey"/></bsdf>"#, &paint);
    let moves = with(&BODY, &["sensor.translation"]);
    cases.push(case(
        "painted rectangle",
        &format!("{room}{painted}"),
        &moves,
        &all,
    ));
    let painted = BALL.replace(grey, &paint);
    assert_ne!(painted, BALL);
    cases.push(case(
        "painted ball",
        &format!("{room}{painted}"),
        &BODY,
        &all,
    ));
    let painted = octahedron(folder, true, turn, &paint);
    cases.push(case(
        "painted faces",
        &format!("{room}{painted}"),
        &POINTS,
        &all,
    ));
    let heights = bitmap(folder, "displacement", [4, 3], 0.0, 0.2);
    let displaced = octahedron(folder, true, turn, &format!("{heights}{grey}"));
    let moves = with(&BODY, &["it.displacement.data"]);
    cases.push(case(
        "displaced faces",
        &format!("{room}{displaced}"),
        &moves,
        &all,
    ));

    // Nothing becomes visible: one floor below a lamp, a ball from inside.
    let all = [INTERIOR, EDGES, FOLLOWS, FOLLOWS_BSDF];
    let floor = FLOOR.replace("value=\"6\"", "value=\"100\"");
    let moves = with(&lamp, &["floor.translation", "floor.rotation"]);
    cases.push(case(
        "floor",
        &format!("{floor}{LAMP}"),
        &with(&moves, &CAMERA),
        &all,
    ));
    let ball = format!(
        r#"{BULB}<shape type="sphere" id="it"><float name="radius" value="9"/><boolean name="flip_normals" value="true"/>
        <ref id="grey"/></shape>"#
    );
    let moves = with(&["it.translation", "it.scale", "bulb.position"], &CAMERA);
    cases.push(case("ball from inside", &ball, &moves, &[INTERIOR, EDGES]));
    compare_all(cases);
}

/// Few faces with interpolated normals, straight and turned, so that the lamp is above the planes of all of their faces or
/// below those of some: as the camera, the mesh and its points move, over a floor and alone.
#[test]
fn coarse_faces_with_smooth_normals_in_any_pose() {
    let dir = tempfile::tempdir().expect("a folder");
    let behind = LAMP
        .replace("value=\"1.4\"", "value=\"0.6\"")
        .replace(r#"x="0.5" y="3.6" z="0.4""#, r#"x="0.7" y="4" z="4""#);
    assert_ne!(behind, LAMP);
    let above = LAMP.replace("value=\"1.4\"", "value=\"0.6\"");
    let moves = [&POINTS[..], &CAMERA[..]].concat();
    let cases = [
        ("straight", "", "", &behind),
        ("straight over a floor", "", FLOOR, &above),
        ("turned by 2", r#"<rotate y="1" angle="2"/>"#, "", &behind),
        ("turned by 10", r#"<rotate y="1" angle="10"/>"#, "", &behind),
        (
            "turned by 25 and 20",
            r#"<rotate y="1" angle="25"/><rotate x="1" angle="20"/>"#,
            FLOOR,
            &above,
        ),
        (
            "turned over",
            r#"<rotate x="1" z="0.4" angle="70"/>"#,
            FLOOR,
            &behind,
        ),
    ];
    let of = |(what, turn, floor, lamp): (&'static str, &str, &str, &String)| {
        let mesh = octahedron(dir.path(), true, turn, r#"<ref id="grey"/>"#);
        case(what, &format!("{floor}{lamp}{mesh}"), &moves, &[EDGES])
    };
    compare_all(cases.map(of).into());
}

/// Directions that follow outlines in closed form: spheres and flat faces that move as a whole, the camera and the lamp.
#[test]
fn outlines_that_are_followed_exactly() {
    let dir = tempfile::tempdir().expect("a folder");
    let room = format!("{FLOOR}{LAMP}");
    let turn = r#"<rotate y="1" angle="25"/><rotate x="1" angle="20"/>"#;
    let faces = octahedron(dir.path(), false, turn, r#"<ref id="grey"/>"#);
    let camera = ["sensor.translation", "sensor.rotation"];
    let ball = [&["it.translation", "it.scale"], &camera[..]].concat();
    let cube = [&BODY, &camera[..], &["lamp.translation", "lamp.scale"]].concat();
    let cases = [
        ("rectangle", PLATE, &BODY[..]),
        ("sphere", BALL, &ball),
        ("cube", CUBE, &cube),
        ("faces", &faces, &BODY),
    ];
    let of = |(what, body, moves): (&'static str, &str, &[&'static str])| {
        case(what, &format!("{room}{body}"), moves, &[FOLLOWS_EXACTLY])
    };
    compare_all(cases.map(of).into());
}

/// A glossy wall behind what moves, and a floor: five bounces between them, and the light of a lamp above.
#[test]
fn all_shapes_through_five_bounces() {
    let dir = tempfile::tempdir().expect("a folder");
    let folder = dir.path();
    let room = format!("{FLOOR}{LAMP}{WALL}");
    let grey = r#"<ref id="grey"/>"#;
    let turn = r#"<rotate y="1" angle="25"/><rotate x="1" angle="20"/>"#;
    let faces = octahedron(folder, false, turn, grey);
    let smooth = octahedron(folder, true, turn, grey);
    let cases = [
        ("rectangle", PLATE, &BODY[1..]),
        ("disk", DISK, &BODY[..2]),
        ("sphere", BALL, &["it.translation", "it.scale"]),
        ("cylinder", TUBE, &BODY[1..]),
        ("cube", CUBE, &["it.rotation", "lamp.translation"]),
        ("faces", &faces, &POINTS[2..]),
        (
            "smooth faces",
            &smooth,
            &["it.rotation", "it.vertex_positions"],
        ),
    ];
    let of = |(what, body, moves): (&'static str, &str, &[&'static str])| {
        case_of_depth(6, what, &format!("{room}{body}"), moves, &[EDGES])
    };
    let mut cases = Vec::from(cases.map(of));
    // No path finds what edges hide of these: light goes on from where their shadows end.
    let lights = format!("{FLOOR}{BULB}{TORCH}{WALL}{CUBE}");
    let moves = ["it.translation", "bulb.position", "torch.position"];
    cases.push(case_of_depth(6, "lights", &lights, &moves, &[EDGES]));
    compare_all(cases);
}

/// Shadows of parallel light, of projectors, of beams and of spot lights that end at once, and where those end: on what stands
/// still, and on what moves. A bulb at the pinhole throws shadows that the camera does not see.
#[test]
fn lights_that_no_path_meets() {
    let dir = tempfile::tempdir().expect("a folder");
    let beam = |shape: &str, scale: &str| {
        format!(
            r#"<shape type="{shape}" id="beam"><transform name="to_world"><scale value="{scale}"/>
            <rotate x="1" angle="90"/><rotate z="1" angle="15"/><translate x="0.3" y="4" z="0.2"/></transform>
            <emitter type="directionalarea"><rgb name="radiance" value="2, 2.5, 3"/></emitter></shape>"#
        )
    };
    let turn = r#"<rotate y="1" angle="25"/><rotate x="1" angle="20"/>"#;
    let smooth = octahedron(dir.path(), true, turn, r#"<ref id="grey"/>"#);
    let seen = ["it.translation", "floor.rotation", "sensor.translation"];
    let body = ["it.translation", "it.rotation", "floor.translation"];
    let under = ["it.translation", "sun.rotation", "floor.rotation"];
    let points = ["it.vertex_positions", "floor.rotation"];
    let [square, disk] =
        [("rectangle", "1"), ("disk", "0.9")].map(|(shape, scale)| beam(shape, scale));
    let image = bitmap(dir.path(), "irradiance", [4, 3], 8.0, 5.0);
    let (sun, projector) = (SUN.to_owned(), PROJECTOR.replace("IMAGE", &image));
    let spot = r#"<emitter type="spot" id="bulb"><float name="cutoff_angle" value="13"/><float name="beam_width" value="13"/>
        <rgb name="intensity" value="30, 28, 26"/><transform name="to_world">
        <lookat origin="1, 4, 0.6" target="0.1, 0, 0.2" up="0, 0, 1"/></transform></emitter>"#;
    let flash = r#"<emitter type="point"><point name="position" x="0" y="3" z="5"/>
        <rgb name="intensity" value="50, 45, 40"/></emitter>"#;
    let (spot, flash) = (spot.to_owned(), flash.to_owned());
    let lit = ["it.translation", "bulb.position", "floor.translation"];
    let cases = [
        ("sun, cube", 2, &sun, CUBE, &under[..]),
        ("sun, ball", 2, &sun, BALL, &seen),
        ("sun, tube", 2, &sun, TUBE, &body[1..]),
        ("sun, disk", 2, &sun, DISK, &under),
        ("sun, smooth faces", 2, &sun, &smooth, &points),
        ("sun, five bounces", 6, &sun, CUBE, &under[..2]),
        ("projector, cube", 2, &projector, CUBE, &body),
        ("projector, ball", 2, &projector, BALL, &seen),
        ("projector, five bounces", 6, &projector, CUBE, &body),
        ("square beam, cube", 2, &square, CUBE, &body),
        ("square beam, smooth faces", 2, &square, &smooth, &points),
        ("round beam, ball", 2, &disk, BALL, &seen),
        ("round beam, five bounces", 6, &disk, CUBE, &body),
        ("spot, cube", 2, &spot, CUBE, &lit[..2]),
        ("spot, ball", 2, &spot, BALL, &lit),
        ("spot, five bounces", 6, &spot, CUBE, &lit[..2]),
        ("flash, cube", 2, &flash, CUBE, &body),
        ("flash, smooth faces", 2, &flash, &smooth, &points),
    ];
    let of =
        |(what, depth, light, it, moves): (&'static str, u32, &String, &str, &[&'static str])| {
            let wall = if depth > 2 { WALL } else { "" };
            case_of_depth(
                depth,
                what,
                &format!("{FLOOR}{wall}{light}{it}"),
                moves,
                &[EDGES],
            )
        };
    let mut cases = Vec::from(cases.map(of));
    // Nothing becomes visible: all of the floor is lit.
    let metal = r#"<bsdf type="roughconductor"><float name="alpha" value="0.4"/></bsdf>"#;
    let floor = FLOOR
        .replace("value=\"6\"", "value=\"100\"")
        .replace(r#"<ref id="grey"/>"#, metal);
    let moves = ["floor.rotation", "sensor.rotation", "sun.rotation"];
    let all = [INTERIOR, EDGES];
    cases.push(case("sun, floor", &format!("{floor}{SUN}"), &moves, &all));
    compare_all(cases);
}
