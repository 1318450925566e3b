//! Derivatives in what moves, by edges: against central differences, and where they are known.

use std::path::Path;

use ad_core::Vec3;
use render::estimator::{
    AllowBias, AttachedWeights, Convolved, Detached, DetachedMis, Interior, Mis, Outlines,
    Reparameterised,
};
use render::instances::{Direction, Estimator};
use render::params::Theta;
use render::scene::LoadOptions;
use render::statistics::{Estimate, z_limit};
use render::{Job, Scene};
use tests::moving::{self, BALL, CUBE, DISK, FLOOR, TUBE, agrees, differences, scene};
use tests::{mean_adjoint, shared_dir, values};

type ByEdges = Outlines<Interior<DetachedMis>>;
type Follows = Convolved<Mis<Reparameterised, Detached, AttachedWeights>>;

/// Derivatives of the mean of all pixels and channels in double precision, from `runs` seeds.
fn gradient(s: &Scene, names: &[&str], runs: u64, spp: u64) -> Vec<Estimate> {
    moving::gradient::<ByEdges>(s, names, runs, spp)
}

/// Shapes before a floor, lit by a lamp, directly and through more bounces: whatever of them moves, and the lamp and the
/// camera. 8 runs of 128 samples of 256 pixels, and differences of 8 runs of 384.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn edges_agree_with_differences() {
    for (what, body, depth) in [
        ("cube", CUBE, 2),
        ("ball", BALL, 2),
        ("disk", DISK, 2),
        ("tube", TUBE, 2),
        ("cube through bounces", CUBE, 4),
        ("ball through bounces", BALL, 5),
    ] {
        let metal = body.replace("grey", "metal");
        let body = if depth > 4 { metal.as_str() } else { body };
        let mut s = scene(&format!("{FLOOR}{body}"), depth);
        let names = ["it.translation", "lamp.translation", "sensor.translation"];
        s.make_movable(&names).expect("known");
        let found = gradient(&s, &names, 8, 256);
        let expected = differences(&mut s, &names, 1.0 / 32.0, 8, 1024);
        agrees(what, &found, &expected, 1e-2, 8);
    }
}

/// Outlines of the shadows of a point and of a spot beside a lamp: whatever moves, the lights, too. 8 runs of 256 samples of
/// 256 pixels, and differences of 8 runs of 512.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn shadows_of_points_agree_with_differences() {
    let lights = r#"<emitter type="point" id="bulb"><point name="position" x="-1" y="3" z="0.5"/>
        <rgb name="intensity" value="9, 8, 7"/></emitter>
        <emitter type="spot" id="torch"><transform name="to_world">
        <lookat origin="1.5, 3, 1" target="0, 0.5, 0" up="0, 0, 1"/></transform>
        <float name="cutoff_angle" value="40"/><rgb name="intensity" value="8, 9, 10"/></emitter>"#;
    for (what, body, movers) in [("cube", CUBE, 4), ("ball", BALL, 1)] {
        let mut s = scene(&format!("{FLOOR}{lights}{body}"), 2);
        let names = [
            "it.translation",
            "bulb.position",
            "torch.position",
            "floor.rotation",
        ];
        let names = &names[..movers];
        s.make_movable(names).expect("known");
        let found = gradient(&s, names, 8, 256);
        let expected = differences(&mut s, names, 1.0 / 64.0, 8, 512);
        agrees(what, &found, &expected, 1e-2, 8);
    }
}

/// What others get wrong: a cube whose faces share no corners is the same as one whose faces do, and as one without a
/// mesh; a ball casts the same shadow however it is turned about itself. 8 runs of 64 samples of 256 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn corners_and_turns_change_nothing() {
    let folder = std::env::temp_dir().join(format!("corners-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    // Corners in binary: x, y, z.
    let faces = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    let corner = |i: usize| {
        let [x, y, z] = [0, 1, 2].map(|k| if i >> k & 1 == 1 { 1 } else { -1 });
        format!("v {x} {y} {z}\n")
    };
    let quad = |[a, b, c, d]: [usize; 4]| {
        let [a, b, c, d] = [a, b, c, d].map(|i| i + 1);
        format!("f {a} {b} {c}\nf {a} {c} {d}\n")
    };
    let shared: String = (0..8).map(corner).chain(faces.map(quad)).collect();
    let split: String = (faces.iter().enumerate())
        .map(|(k, f)| {
            let corners: String = f.iter().map(|&i| corner(i)).collect();
            corners + &quad([0, 1, 2, 3].map(|i| 4 * k + i))
        })
        .collect();
    let placed = CUBE.split_once("id=\"it\">").expect("a cube").1;
    let mesh = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).expect("a file");
        format!(
            r#"<shape type="obj" id="it"><string name="filename" value="{}"/><boolean name="face_normals" value="true"/>{placed}"#,
            path.display()
        )
    };
    let meshes = [mesh("shared.obj", &shared), mesh("split.obj", &split)];
    let turned = BALL;
    let ball = turned.replace(r#"<rotate y="1" angle="25"/>"#, "");
    assert_ne!(ball, turned);
    let of = |shape: &str| {
        let mut s = scene(&format!("{FLOOR}{shape}"), 2);
        s.make_movable(&["it.translation"]).expect("known");
        gradient(&s, &["it.translation"], 8, 64)
    };
    let cube = of(CUBE);
    for mesh in meshes {
        agrees("a mesh", &of(&mesh), &cube, 0.0, 8);
    }
    agrees("a ball that is turned", &of(turned), &of(&ball), 0.0, 8);
    std::fs::remove_dir_all(&folder).expect("the folder goes");
}

/// Few faces with interpolated normals: each hides light from itself, so that what is seen jumps at its sides and as the lamp
/// passes its horizon, and it is black where its normals turn away. Whatever moves, on the film and in the light, normals
/// among it. 8 runs of 128 samples of 256 pixels, and differences of 8 runs of 384 (of normals, 256).
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn coarse_faces_with_smooth_normals_agree_with_differences() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = octahedron(&folder);
    let shape = format!(
        r#"<shape type="obj" id="it"><string name="filename" value="{}"/><transform name="to_world">
        <scale value="0.8"/><rotate y="1" angle="25"/><rotate x="1" angle="20"/><translate y="1.1"/></transform>
        <ref id="grey"/></shape>"#,
        path.display()
    );
    let mut s = scene(&format!("{FLOOR}{shape}"), 2);
    for name in ["sensor.translation", "it.translation", "lamp.translation"] {
        s.make_movable(&[name]).expect("known");
        let found = gradient(&s, &[name], 8, 128);
        let expected = differences(&mut s, &[name], 1.0 / 64.0, 8, 384);
        agrees(name, &found, &expected, 1e-2, 8);
    }
    // Normals that turn by themselves take along where they turn away.
    s.make_movable(&["it.vertex_normals"]).expect("known");
    let found = gradient(&s, &["it.vertex_normals"], 8, 128);
    let expected = differences(&mut s, &["it.vertex_normals"], 1.0 / 32.0, 8, 256);
    agrees("normals", &found, &expected, 1e-2, 8);
}

/// A lamp of a few faces with interpolated normals is dark where those turn away, and so is what it lights from there:
/// whatever moves, normals among it. 8 runs of 256 samples of 256 pixels, and differences of 8 runs of 1024.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn coarse_lamps_with_smooth_normals_agree_with_differences() {
    let folder = tempfile::tempdir().expect("a folder");
    // Above the film, and lower on one side.
    let lamp = format!(
        r#"<shape type="obj" id="coarse"><string name="filename" value="{}"/><transform name="to_world">
        <scale x="0.9" y="0.4" z="0.7"/><rotate x="1" z="1" angle="30"/><translate x="0.4" y="2.6" z="0.6"/></transform>
        <emitter type="area"><rgb name="radiance" value="6, 7, 8"/></emitter></shape>"#,
        octahedron(&folder).display()
    );
    let mut s = scene(&format!("{FLOOR}{lamp}"), 2);
    for (name, step) in [
        ("floor.translation", 64.0),
        ("coarse.translation", 64.0),
        ("coarse.rotation", 64.0),
        ("coarse.vertex_normals", 32.0),
    ] {
        s.make_movable(&[name]).expect("known");
        let found = gradient(&s, &[name], 8, 256);
        let expected = differences(&mut s, &[name], 1.0 / step, 8, 1024);
        agrees(name, &found, &expected, 1e-2, 8);
    }
    let name = "coarse.vertex_normals";
    let all = values::<f32>(&s);
    let job = Job::new(&s, &s.settings, 0, 0..4, &());
    let active = Estimator::Edges.active(&s, &[name]).expect("seen");
    let adjoint = mean_adjoint(&s);
    let reverse = Estimator::Edges.backward_f32(&job, &Theta::constant(&all), &active, &adjoint);
    let reverse: f64 = reverse.expect("admitted").values.concat().iter().sum();
    let along = [Direction::uniform(s.params(), name).expect("known")];
    let forward = Estimator::Edges.forward_f32(&job, s.params().values(), &along);
    let image = forward.expect("admitted").image(1);
    let forward = image.data.iter().zip(&adjoint);
    let forward: f64 = forward.map(|(x, a)| f64::from(x * a)).sum();
    assert!(
        (forward - reverse).abs() < 1e-4 * reverse.abs(),
        "{forward} {reverse}"
    );
}

/// The file of an octahedron with normals as at the points of a ball.
fn octahedron(folder: &tempfile::TempDir) -> std::path::PathBuf {
    let path = folder.path().join("octahedron.obj");
    let mut text = String::new();
    for k in 0..3 {
        for sign in [1, -1] {
            let [x, y, z] = [0, 1, 2].map(|i| if i == k { sign } else { 0 });
            text += &format!("v {x} {y} {z}\nvn {x} {y} {z}\n");
        }
    }
    for octant in 0..8 {
        let [x, y, z] = [0, 1, 2].map(|k| 2 * k + 1 + (octant >> k & 1));
        let (y, z) = if i32::count_ones(octant) % 2 == 1 {
            (z, y)
        } else {
            (y, z)
        };
        text += &format!("f {x}//{x} {y}//{y} {z}//{z}\n");
    }
    std::fs::write(&path, text).expect("a file");
    path
}

/// Tubes of long, thin, smooth faces. What is seen just inside of a side is not hidden by the neighbour, and rays that pass
/// the rim of the tube do not meet it. Of the finer one, normals turn away on a face that lies just behind its outline.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn long_thin_faces_with_smooth_normals_agree_with_differences() {
    for count in [48, 96] {
        smooth_tube(count);
    }
}

fn smooth_tube(count: u32) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("tube.obj");
    let mut text = String::new();
    for k in 0..count {
        let (z, x) = (std::f64::consts::TAU * f64::from(k) / f64::from(count)).sin_cos();
        let (px, pz) = (0.28 * x, 0.28 * z);
        text += &format!("v {px} 0 {pz}\nv {px} 1.16 {pz}\nvn {x} 0 {z}\n");
    }
    for k in 0..count {
        let next = (k + 1) % count;
        let [a, b, c, d] = [2 * k + 1, 2 * k + 2, 2 * next + 2, 2 * next + 1];
        let (n, m) = (k + 1, next + 1);
        text += &format!("f {a}//{n} {b}//{n} {c}//{m}\nf {a}//{n} {c}//{m} {d}//{m}\n");
    }
    std::fs::write(&path, text).expect("a file");
    let shape = format!(
        r#"<shape type="obj" id="it"><string name="filename" value="{}"/><transform name="to_world">
        <translate y="0.4"/></transform><ref id="grey"/></shape>"#,
        path.display()
    );
    let mut s = scene(&format!("{FLOOR}{shape}"), 2);
    let name = "it.translation";
    s.make_movable(&[name]).expect("known");
    let found = gradient(&s, &[name], 8, 128);
    let expected = differences(&mut s, &[name], 1.0 / 64.0, 8, 1024);
    agrees(&format!("{count} faces"), &found, &expected, 1e-2, 16);
}

/// Walls that scatter most of the light, and a cube of rough metal.
fn between_walls() -> String {
    let walls = r#"<shape type="rectangle"><transform name="to_world"><scale value="4"/><translate y="3" z="-1.6"/></transform>
        <ref id="grey"/></shape><shape type="rectangle"><transform name="to_world"><scale value="4"/>
        <rotate y="1" angle="90"/><translate x="-1.8" y="3"/></transform><ref id="grey"/></shape>"#;
    let body = format!("{FLOOR}{walls}{}", CUBE.replace("grey", "metal"));
    body.replace("0.6, 0.5, 0.4", "0.9, 0.8, 0.8")
}

/// Light that reaches the camera after up to five bounces, between walls, as a cube moves: with one bounce it is another
/// derivative. 8 runs of 256 samples of 256 pixels, and differences of 8 runs of 1024.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn edges_agree_with_differences_through_five_bounces() {
    let body = between_walls();
    let names = ["it.translation"];
    let of = |depth: u32| {
        let mut s = scene(&body, depth);
        s.make_movable(&names).expect("known");
        let found = gradient(&s, &names, 8, 256);
        (s, found)
    };
    let (mut s, found) = of(6);
    let expected = differences(&mut s, &names, 1.0 / 16.0, 8, 1024);
    agrees("five bounces", &found, &expected, 1e-2, 8);
    let (_, direct) = of(2);
    let off = found.iter().zip(&direct).map(|(a, b)| a.z(b).abs());
    assert!(off.fold(0.0, f64::max) > 10.0, "{found:?} {direct:?}");
}

/// Roulette ends paths, and what is behind edges, and adds noise alone: means of derivatives with and without it, by edges and
/// by directions that follow them, between walls and of a ball. 8 runs of 256 samples of 256 pixels, by edges with roulette 512.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn roulette_changes_no_derivative() {
    let names = ["it.translation"];
    for (what, body, depth) in [
        ("between walls", between_walls(), 6),
        ("a ball", format!("{FLOOR}{BALL}"), 5),
    ] {
        let mut s = scene(&body, depth);
        s.make_movable(&names).expect("known");
        assert!(s.settings.rr_depth > depth);
        let without = gradient(&s, &names, 8, 256);
        s.settings.rr_depth = 2;
        let edges = gradient(&s, &names, 8, 512);
        agrees(&format!("{what}, edges"), &edges, &without, 0.0, 8);
        let follows = moving::gradient::<Follows>(&s, &names, 8, 256);
        agrees(&format!("{what}, follows"), &follows, &without, 2e-2, 8);
    }
}

/// Without what becomes visible or hidden, derivatives of a ball and its shadow have other signs, as those of Mitsuba 3 without
/// its projective samples have; with edges they are those of differences of its images [`shared/peer`, failure 9]. 8 runs of 128
/// samples of 1024 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn a_ball_and_its_shadow_are_those_of_mitsuba() {
    let mut s = tests::scene(
        r#"<integrator type="path"><integer name="max_depth" value="2"/></integrator>
        <sensor type="perspective"><string name="fov_axis" value="x"/><float name="fov" value="42"/>
            <transform name="to_world"><lookat origin="-0.6, 3.2, 4.2" target="-0.2, 0.4, 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/>
            <rfilter type="box"/></film></sensor>
        <shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.6"/></bsdf></shape>
        <shape type="sphere" id="it"><transform name="to_world"><scale value="0.45"/><translate y="1"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.3, 0.2"/></bsdf></shape>
        <shape type="rectangle"><transform name="to_world"><scale value="0.4"/><rotate x="1" angle="90"/>
            <translate x="0.8" y="3"/></transform><emitter type="area"><rgb name="radiance" value="12"/></emitter></shape>"#,
    );
    let names = ["it.translation"];
    s.make_movable(&names).expect("known");
    let exact = |known: [f64; 3]| known.map(Estimate::exact);
    let found = gradient(&s, &names, 8, 128);
    let differences = exact([-0.00214, 0.00177, -0.01032]);
    agrees("edges", &found, &differences, 1e-2, 8);
    let interior = moving::gradient::<AllowBias<Interior<DetachedMis>>>(&s, &names, 8, 128);
    let known = exact([-0.00326, -0.00723, 0.00210]);
    agrees("interior", &interior, &known, 1e-2, 8);
}

/// The irradiance at `p`, with the unit normal `n`, of a rectangle across x that sends a unit of radiance there, and that `n`
/// sees all of [Lambert].
fn irradiance(p: Vec3<f64>, n: Vec3<f64>, x: f64, y: [f64; 2], z: [f64; 2]) -> f64 {
    let corners = [[0, 0], [1, 0], [1, 1], [0, 1]]
        .map(|[i, k]: [usize; 2]| (Vec3::new(x, y[i], z[k]) - p).normalize());
    let sides = (0..4).map(|k| {
        let [a, b] = [corners[k], corners[(k + 1) % 4]];
        a.cross(b).normalize().dot(n) * a.dot(b).acos()
    });
    0.5 * sides.sum::<f64>().abs()
}

/// A camera at the origin that looks along z, with this angle of view.
const LOOKS_ALONG_Z: &str = r#"<integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="perspective"><float name="fov" value="50"/><film type="hdrfilm"><integer name="width" value="24"/>
    <integer name="height" value="24"/><rfilter type="box"/></film></sensor>"#;

/// Two faces with one tilted normal everywhere, under a lamp that is half below the plane of one of them: what is seen jumps
/// at the side that they share, by light that grazes one of them and passes close over the other, and changes in one of them
/// as its plane passes over the lamp. The image is known, and so is how it changes. 8 runs of 256 samples of 576 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn faces_with_one_normal_hide_light_by_their_planes() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("it.obj");
    let bend = 0.5f64;
    let (sin, cos) = bend.sin_cos();
    let shading = Vec3::new((0.5 * bend).sin(), 0.0, -(0.5 * bend).cos());
    let side = Vec3::new(0.1, 0.0, 5.0);
    let mut text = String::new();
    for [x, z] in [[0.0, 0.0], [-10.0, 0.0], [10.0 * cos, 10.0 * sin]] {
        for y in [-10, 10] {
            text += &format!("v {} {y} {}\n", side.x + x, side.z + z);
        }
    }
    text += &format!("vn {} {} {}\n", shading.x, shading.y, shading.z);
    for f in [[3, 4, 2], [3, 2, 1], [1, 2, 6], [1, 6, 5]] {
        text += &format!("f {0}//1 {1}//1 {2}//1\n", f[0], f[1], f[2]);
    }
    std::fs::write(&path, text).expect("a file");
    let centre = Vec3::new(-2.9, 0.3, 3.36);
    let mut s = tests::scene(&format!(
        r#"{LOOKS_ALONG_Z}<shape type="obj" id="it"><string name="filename" value="{}"/>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape>
        <shape type="rectangle" id="lamp"><transform name="to_world"><scale x="0.4" y="0.5"/><rotate y="1" angle="90"/>
            <translate x="{}" y="{}" z="{}"/></transform>
            <emitter type="area"><rgb name="radiance" value="10, 20, 30"/></emitter></shape>"#,
        path.display(),
        centre.x,
        centre.y,
        centre.z
    ));
    let names = ["it.translation", "lamp.translation", "sensor.translation"];
    s.make_movable(&names).expect("known");
    let found = gradient(&s, &names, 8, 256);

    // The mean of the image where the faces and the lamp are moved and the camera stays.
    let half = 25f64.to_radians().tan();
    let mean = |faces: Vec3<f64>, lamp: Vec3<f64>| {
        let (side, lamp) = (side + faces, centre + lamp);
        let (y, z) = ([lamp.y - 0.5, lamp.y + 0.5], [lamp.z - 0.4, lamp.z + 0.4]);
        // Where the plane of the second face meets the lamp.
        let cut = side.z - (side.x - lamp.x) * sin / cos;
        assert!(z[0] < cut && cut < z[1]);
        let at = side.x / side.z;
        let n = 200;
        let part = |i: i32, [low, high]: [f64; 2]| {
            low + (f64::from(i) + 0.5) / f64::from(n) * (high - low)
        };
        let sum = |x: [f64; 2], lit: [f64; 2], of: &dyn Fn(Vec3<f64>) -> Vec3<f64>| {
            let points = (0..n).flat_map(|i| (0..n).map(move |k| (i, k)));
            let points =
                points.map(|(i, k)| of(Vec3::new(part(i, x), part(k, [-half, half]), 1.0)));
            let sum: f64 = points.map(|p| irradiance(p, shading, lamp.x, y, lit)).sum();
            sum / f64::from(n * n) * (x[1] - x[0]) / (2.0 * half)
        };
        let first = sum([-half, at], z, &|d| d * side.z);
        let second = sum([at, half], [z[0], cut], &|d| {
            d * ((sin * side.x - cos * side.z) / (sin * d.x - cos))
        });
        20.0 * 0.5 / std::f64::consts::PI * (first + second)
    };
    let expected = [[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]].map(|[faces, lamp]: [f64; 2]| {
        [0, 1, 2].map(|axis: usize| {
            let along = |h: f64| {
                let mut v = [0.0; 3];
                v[axis] = h;
                mean(Vec3::from(v) * faces, Vec3::from(v) * lamp)
            };
            let mean = (along(1e-4) - along(-1e-4)) / 2e-4;
            Estimate::exact(mean)
        })
    });
    let expected = expected.concat();
    agrees("two faces", &found, &expected, 2e-3, 8);
    let size = expected.iter().fold(0.0, |m: f64, e| m.max(e.mean.abs()));
    assert!(found.iter().all(|e| e.se < 5e-3 * size), "{found:?}");
}

/// A half-plane between a floor and a lamp. The lamp moves and the half-plane does not: the lamp's light passes the edge
/// as fast as the lamp does behind it, seen from the floor. That is what edges add to the interior. The camera is below and
/// sees the floor alone. 8 runs of 256 samples of 576 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn a_lamp_moves_behind_an_edge_at_rest() {
    let mut s = tests::scene(&format!(
        r#"{LOOKS_ALONG_Z}
        <shape type="rectangle" id="lamp"><transform name="to_world"><scale value="3"/><translate x="2" z="-3"/></transform>
            <emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter></shape>
        <shape type="rectangle" id="floor"><transform name="to_world"><scale value="100"/>
            <rotate y="1" angle="180"/><translate z="2"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape>
        <shape type="rectangle" id="it"><transform name="to_world"><scale x="100" y="400"/>
            <translate x="-99.7" z="-1"/></transform>
            <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf></bsdf></shape>"#
    ));
    let names = ["lamp.translation"];
    s.make_movable(&names).expect("known");
    let all = gradient(&s, &names, 8, 256);
    let interior = moving::gradient::<AllowBias<Interior<DetachedMis>>>(&s, &names, 8, 256);
    let pairs = all.iter().zip(&interior);
    let found: Vec<Estimate> = pairs
        .map(|(a, b)| Estimate {
            mean: a.mean - b.mean,
            se: a.se.hypot(b.se),
        })
        .collect();
    let (edge, to_edge, to_lamp) = (0.3, 3.0, 5.0);
    let half = 2.0 * 25f64.to_radians().tan();
    let n = 500;
    let at = |i: i32| ((f64::from(i) + 0.5) / f64::from(n) * 2.0 - 1.0) * half;
    // Along x and z, a mean over the film.
    let mut known = [0.0; 3];
    for (i, k) in (0..n).flat_map(|i| (0..n).map(move |k| (i, k))) {
        let (x, y) = (at(i), at(k));
        let (sin, cos) = f64::atan((edge - x) / to_edge).sin_cos();
        // With the angle a from the plane across the edge, a point behind it is `to_lamp / (cos cos a)` away, and what it
        // sends counts cos cos a.
        let whole = |a: f64| 0.5 * a + 0.25 * (2.0 * a).sin();
        let [first, last] = [-3.0, 3.0].map(|end: f64| whole(((end - y) * cos / to_lamp).atan()));
        let scale = 2.0 * 0.5 / std::f64::consts::PI / f64::from(n * n);
        let passes = scale * cos * cos / to_lamp * (last - first);
        known[0] += passes * cos;
        // Away from the floor is towards negative z.
        known[2] += passes * sin;
    }
    let known = known.map(Estimate::exact);
    agrees("a lamp behind an edge", &found, &known, 2e-3, 8);
    assert!(
        found.iter().all(|e| e.se < 0.02 * known[0].mean),
        "{found:?}"
    );
}

/// Without edges, the same test notices that visibility is missing.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn the_interior_alone_is_noticed() {
    let mut s = scene(&format!("{FLOOR}{BALL}"), 2);
    s.make_movable(&["it.translation"]).expect("known");
    let right = gradient(&s, &["it.translation"], 8, 256);
    let wrong =
        moving::gradient::<AllowBias<Interior<DetachedMis>>>(&s, &["it.translation"], 8, 256);
    let off = right.iter().zip(&wrong).map(|(a, b)| a.z(b).abs());
    assert!(
        off.fold(0.0, f64::max) > 2.0 * z_limit(3, 8, 1e-3),
        "{right:?} {wrong:?}"
    );
}

/// Shadows of lights without area have samples where light bounces, too: both modes are one map.
#[test]
fn shadows_that_bounce_are_one_map_in_both_modes() {
    let bulb = r#"<emitter type="point"><point name="position" x="0" y="4" z="0"/></emitter>"#;
    let sun = r#"<emitter type="directional" id="sun"><vector name="direction" x="0.2" y="-1" z="0.1"/></emitter>"#;
    let projector = r#"<emitter type="projector"><transform name="to_world"><lookat origin="1, 4, 1" target="0, 0.5, 0"
        up="0, 0, 1"/></transform><float name="fov" value="24"/></emitter>"#;
    let it = "it.translation";
    for (what, light, names) in [
        ("bulb", bulb, vec![it]),
        ("sun", sun, vec![it, "sun.rotation"]),
        ("projector", projector, vec![it]),
    ] {
        let mut s = scene(&format!("{FLOOR}{CUBE}{light}"), 4);
        s.make_movable(&names).expect("known");
        moving::modes_are_one_map::<ByEdges>(what, &s, &names);
    }
}

/// A mesh just above a floor under a sky: rays that pass its edges from nearby clear the seams of its own faces.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn edges_near_what_they_shade_clear_their_own_faces() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("plate.obj");
    std::fs::write(
        &path,
        "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nf 1 3 2\nf 1 4 3\n",
    )
    .expect("a file");
    let floor = FLOOR
        .split_once(r#"<shape type="rectangle" id="lamp">"#)
        .expect("a lamp")
        .0;
    let body = format!(
        r#"{floor}<emitter type="constant"/><shape type="obj" id="it"><string name="filename" value="{}"/>
        <transform name="to_world"><translate y="0.04"/></transform><ref id="grey"/></shape>"#,
        path.display()
    );
    let mut s = scene(&body, 2);
    let names = ["it.translation", "it.scale"];
    s.make_movable(&names).expect("known");
    let found = gradient(&s, &names, 16, 256);
    let expected = differences(&mut s, &names, 0.02, 16, 512);
    agrees("plate", &found, &expected, 0.01, 16);
}

/// A convex body under a sky hides no light from itself: all that there is are its outlines on the film, at any depth. 32 x 32
/// pixels of 256 samples, with seeds of which one took an edge of the face that a vertex lies on for one of something else.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn faces_do_not_hide_light_from_themselves() {
    let text = r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="3"/></integrator>
        <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0,1.5,5" target="0,0.3,0" up="0,1,0"/></transform>
        <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/><rfilter type="box"/></film></sensor>
        <emitter type="constant"><rgb name="radiance" value="0.3,0.4,0.5"/></emitter>
        <shape type="cube" id="it"><transform name="to_world"><scale value="0.6"/><rotate y="1" angle="30"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.7,0.3,0.2"/></bsdf></shape></scene>"#;
    let loaded = Scene::from_xml(text, Path::new("."), &LoadOptions::default());
    let (mut s, _) = loaded.expect("valid");
    s.make_movable(&["it.translation"]).expect("known");
    let along = [Direction::uniform(s.params(), "it.translation").expect("known")];
    for seed in 34..38 {
        let job = Job::new(&s, &s.settings, seed, 0..256, &());
        let image = Estimator::Edges.forward_f32(&job, s.params().values(), &along);
        let image = image.expect("admitted").image(1);
        let largest = image.data.iter().fold(0.0f32, |m, x| m.max(x.abs()));
        assert!((1.0..10.0).contains(&largest), "{seed}: {largest}");
    }
}

/// Turns, sizes and angles of view.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn edges_agree_with_differences_of_turns() {
    let mut s = scene(&format!("{FLOOR}{CUBE}"), 3);
    let names = ["it.rotation", "it.scale", "sensor.rotation"];
    s.make_movable(&names).expect("known");
    let found = gradient(&s, &names, 8, 256);
    let expected = differences(&mut s, &names, 1.0 / 32.0, 8, 1024);
    agrees("turns", &found, &expected, 1e-2, 8);
}

/// One rectangle as a parallelogram, as two triangles and as 200 with a seam of texture coordinates.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn tessellation_changes_nothing() {
    let folder = std::env::temp_dir().join(format!("outlines-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let mesh = |n: u32, seam: bool| {
        let mut text = String::new();
        let mut count = 0;
        for i in 0..n {
            for j in 0..n {
                let corner =
                    |a: u32, b: u32| [a, b].map(|k| f64::from(k) / f64::from(n) * 2.0 - 1.0);
                for [x, y] in [
                    corner(i, j),
                    corner(i + 1, j),
                    corner(i + 1, j + 1),
                    corner(i, j + 1),
                ] {
                    text += &format!(
                        "v {x} {y} 0\nvt {} {y}\n",
                        if seam && i >= n / 2 { x + 3.0 } else { x }
                    );
                }
                let k = |d: u32| format!("{0}/{0}", count + d);
                text += &format!(
                    "f {} {} {}\nf {} {} {}\n",
                    k(1),
                    k(2),
                    k(3),
                    k(1),
                    k(3),
                    k(4)
                );
                count += 4;
            }
        }
        let path = folder.join(format!("{n}.obj"));
        std::fs::write(&path, text).expect("a file");
        path
    };
    let placed = r#"<transform name="to_world"><scale value="0.7"/><rotate x="1" angle="-70"/>
        <translate y="1.2"/></transform><bsdf type="twosided"><ref id="grey"/></bsdf>"#;
    let shapes = [
        format!(r#"<shape type="rectangle" id="it">{placed}</shape>"#),
        format!(
            r#"<shape type="obj" id="it"><string name="filename" value="{}"/><boolean name="face_normals" value="true"/>{placed}</shape>"#,
            mesh(1, false).display()
        ),
        format!(
            r#"<shape type="obj" id="it"><string name="filename" value="{}"/><boolean name="face_normals" value="true"/>{placed}</shape>"#,
            mesh(10, true).display()
        ),
    ];
    let names = ["it.translation", "it.scale", "sensor.translation"];
    let found = shapes.map(|shape| {
        let mut s = scene(&format!("{FLOOR}{shape}"), 2);
        s.make_movable(&names).expect("known");
        gradient(&s, &names, 8, 256)
    });
    std::fs::remove_dir_all(&folder).expect("the folder goes");
    agrees("two triangles", &found[1], &found[0], 0.0, 8);
    agrees("two hundred", &found[2], &found[0], 0.0, 8);
}

/// The cube and the lamp of Mitsuba 3, of which differences are known [`shared/peer`]: its own edges have the wrong sign
/// there. 8 runs of 64 samples of 128 x 128 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn a_cube_and_its_shadow_are_those_of_mitsuba() {
    let Some(shared) = shared_dir() else { return };
    let path = shared.join("peer/scenes/shadow-translate.xml");
    if !path.exists() {
        println!("skipped: no {}", path.display());
        return;
    }
    let options = LoadOptions {
        defines: vec![("res".into(), "128".into())],
        ..Default::default()
    };
    let (mut s, _) = Scene::load(Path::new(&path), &options).expect("a scene");
    s.make_movable(&["occluder.translation"]).expect("known");
    let found = gradient(&s, &["occluder.translation"], 8, 64);
    let known = [(-0.001741, 8e-6), (-0.001486, 7e-6), (-0.014275, 1.4e-5)];
    let known = known.map(|(mean, se)| Estimate { mean, se });
    agrees("shadow-translate", &found, &known, 0.0, 8);
}
