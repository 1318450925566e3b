//! Instances are what copies of their groups are: the same hits, the same images, the same derivatives, without the memory.

use std::fmt::Write as _;
use std::path::Path;

use ad_core::Vec3;
use render::accel::{PACKET_SIZE, RayPacket};
use render::bsdf::Diffuse;
use render::camera::{Camera, FovAxis};
use render::emitter::Constant;
use render::estimator::{DetachedMis, Interior, Outlines};
use render::film::Image;
use render::image_io::write_exr;
use render::instances::{Estimator, render_f32};
use render::math::{NOWHERE, Ray, Transform};
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::scene::{Builder, LoadOptions, Settings};
use render::shape::{AnyShape, Instance, Mesh, MeshData, Patch, Rectangle, Shape, smooth_normals};
use render::statistics::z_limit;
use render::{Film, Job, Scene};
use tests::moving::{FLOOR, agrees, differences, gradient};
use tests::picture;

type ByEdges = Outlines<Interior<DetachedMis>>;

/// A ball with bumps around a centre, of about unit radius and `2 rows^2` triangles.
fn ball(rows: u32, centre: [f32; 3]) -> MeshData {
    let mut data = MeshData::default();
    for i in 0..=rows {
        for j in 0..=rows {
            let [u, v] = [j, i].map(|k| k as f32 / rows as f32);
            let (sin, cos) = (std::f32::consts::PI * v).sin_cos();
            let (y, x) = (std::f32::consts::TAU * (j % rows) as f32 / rows as f32).sin_cos();
            let n = [sin * x, cos, -sin * y];
            let r = 1.0 + 0.15 * (4.0 * n[0]).sin() * (3.0 * n[1] + 1.0).cos();
            data.positions.push([0, 1, 2].map(|k| centre[k] + r * n[k]));
            data.uvs.push([u, v]);
        }
    }
    let at = |i: u32, j: u32| i * (rows + 1) + j;
    for (i, j) in (0..rows).flat_map(|i| (0..rows).map(move |j| (i, j))) {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        data.triangles.extend([[a, b, c], [a, c, d]]);
    }
    data
}

/// The same as an OBJ file, with normals if it has any.
fn obj(data: &MeshData) -> String {
    let mut text = String::new();
    let three = |kind: &str, v: &[f32; 3]| format!("{kind} {} {} {}\n", v[0], v[1], v[2]);
    text.extend(data.positions.iter().map(|v| three("v", v)));
    text.extend(data.uvs.iter().map(|v| format!("vt {} {}\n", v[0], v[1])));
    text.extend(data.normals.iter().map(|v| three("vn", v)));
    for t in &data.triangles {
        let corner = |i: u32| {
            if data.normals.is_empty() {
                format!("{0}/{0}", i + 1)
            } else {
                format!("{0}/{0}/{0}", i + 1)
            }
        };
        let [a, b, c] = t.map(corner);
        writeln!(text, "f {a} {b} {c}").expect("a string");
    }
    text
}

/// Maps of all kinds: near and far, small and large, uneven, mirrored.
fn maps() -> Vec<Transform> {
    let turn = |degrees: f64| Transform::rotate([1.0, 2.0, -0.5], degrees).expect("an axis");
    let at = |x: f64, y: f64, z: f64| Transform::translate([x, y, z]);
    vec![
        Transform::IDENTITY,
        turn(70.0).then(&at(3.0, 0.5, 0.0)),
        Transform::scale([0.5, 1.5, 0.8])
            .then(&turn(20.0))
            .then(&at(-3.0, 0.0, 1.0)),
        Transform::scale([-1.0, 1.0, 1.0])
            .then(&turn(130.0))
            .then(&at(0.0, 3.0, 0.0)),
        Transform::scale([0.4, -0.7, 1.1]).then(&at(0.0, -3.0, 0.5)),
        Transform::scale([1e-3; 3]).then(&at(1.5, 1.5, 1.5)),
        Transform::scale([40.0, 1.0, 40.0]).then(&at(0.0, -9.0, 0.0)),
        turn(10.0).then(&at(0.2, 0.3, 0.4)),
    ]
}

/// A mesh under some maps over a rectangle, as instances or as copies.
fn placed(mesh: &Mesh, maps: &[Transform], copies: bool) -> Scene {
    let mut build = Builder::new();
    let reflectance = build.rgb("grey", [0.5; 3], (0.0, 1.0)).expect("valid");
    let grey = build.add_material(Diffuse { reflectance });
    let floor = Patch::new(
        [-20.0, -5.0, -20.0],
        [40.0, 0.0, 0.0],
        [0.0, 0.0, 40.0],
        true,
    );
    build.add_shape("floor", Rectangle(floor.expect("an area")), grey);
    for (i, map) in maps.iter().enumerate() {
        let instance = Instance::new(mesh.clone(), *map).expect("in reach");
        let shape = if copies {
            AnyShape::from(instance.copied())
        } else {
            instance.into()
        };
        build.add_shape(&format!("it{i}"), shape, grey);
    }
    let radiance = build
        .rgb("sky", [1.0; 3], (0.0, f64::INFINITY))
        .expect("valid");
    build.add_emitter(Constant { radiance }, None);
    let view = Transform::look_at([0.0, 2.0, 9.0], [0.0; 3], [0.0, 1.0, 0.0]).expect("a view");
    let camera = Camera::new(view, 50.0, FovAxis::Smaller, [16, 16]).expect("a camera");
    let film = Film::new(16, 16);
    build
        .build(camera, film, Settings::default())
        .expect("a scene")
}

/// Rays from around towards some shape: 4 000 for each kind of mesh. What copies say but for rounding is what instances
/// say, of surfaces over numbers with and without tangents and of shadows; packets say what single rays do, bit by bit.
#[test]
fn hits_are_those_of_copies() {
    let data = ball(24, [0.3, -0.2, 0.1]);
    let mut bent = data.clone();
    bent.normals = smooth_normals(&bent.positions, &bent.triangles);
    let bare = MeshData {
        uvs: Vec::new(),
        ..data.clone()
    };
    let meshes = [
        ("flat", Mesh::new(data, false)),
        ("turned around", Mesh::new(bare, true)),
        ("bent", Mesh::new(bent, false)),
    ];
    for (what, mesh) in meshes {
        let mesh = mesh.expect("a mesh");
        let maps = maps();
        let [instances, copies] = [false, true].map(|copies| placed(&mesh, &maps, copies));
        assert!(
            instances.memory_bytes() < copies.memory_bytes() / 4,
            "{what}"
        );
        let mut random = Independent::new(5, 0, 0);
        let (mut apart, mut met, mut hidden) = (0, 0, 0);
        let mut rays = Vec::new();
        for i in 0..4000 {
            let mut near = |scale: f32| {
                let [x, y] = random.next_2d::<f32>();
                let z = random.next_1d::<f32>();
                Vec3::new(x, y, z) * (2.0 * scale) - Vec3::new(1.0, 1.0, 1.0) * scale
            };
            let o = near(8.0);
            let to = Vec3::from(maps[i % maps.len()].translation.map(|x| x as f32)) + near(1.2);
            rays.push(Ray::new(o, (to - o).normalize()));
        }
        for ray in &rays {
            let [a, b] = [&instances, &copies].map(|s| s.intersect(ray));
            let far = ray.o + ray.d * 5.0;
            let free = [&instances, &copies].map(|s| {
                let si = s.intersect(&Ray::new(ray.o, -ray.d))?.si;
                let d = far - si.p;
                let segment = si.shadow_ray(d.normalize(), d.length(), s.exit(0), NOWHERE);
                Some(s.occluded(&segment))
            });
            hidden += u32::from(free[0] != free[1]);
            let (Some(a), Some(b)) = (a, b) else {
                apart += u32::from(a.is_some() != b.is_some());
                continue;
            };
            met += u32::from(a.shape > 0);
            let size = 1.0 + ray.o.length() + b.si.t;
            let same = a.shape == b.shape
                && (a.si.p - b.si.p).length() < 2e-5 * size
                && (a.si.t - b.si.t).abs() < 1e-4 * size
                && a.si.n_geo.dot(b.si.n_geo) > 0.9999
                && a.si.frame.n.dot(b.si.frame.n) > 0.999
                && a.si.frame.s.dot(b.si.frame.s) > 0.99
                && (a.si.uv.x - b.si.uv.x).abs() < 1e-2;
            apart += u32::from(!same);
        }
        assert!(met > 1500, "{what}: {met}");
        assert!(
            apart <= 8 && hidden <= 8,
            "{what}: {apart} and {hidden} of {met}"
        );
        for rays in rays.chunks(PACKET_SIZE) {
            let mut packet = RayPacket::default();
            for (i, r) in rays.iter().enumerate() {
                let limit = if i % 3 == 0 { 7.0 } else { f32::INFINITY };
                packet.push(r.o.to_array(), r.d.to_array(), limit, [NOWHERE; 2]);
            }
            let hits = instances.nearest_packet(&packet);
            let blocked = instances.occluded_packet(&packet);
            for (i, ray) in rays.iter().enumerate() {
                let single = instances.nearest(ray);
                if i % 3 != 0 {
                    assert_eq!(hits[i], single, "{what}");
                }
                assert_eq!(blocked >> i & 1 != 0, hits[i].is_some(), "{what}");
            }
        }
    }
}

/// A ray that leaves a point of an instance meets other points of it, and never the one that it leaves.
#[test]
fn rays_leave_instances() {
    let mesh = Mesh::new(ball(24, [0.0; 3]), false).expect("a mesh");
    let far = Transform::scale([0.7; 3]).then(&Transform::translate([300.0, -500.0, 200.0]));
    let scene = placed(&mesh, &[Transform::IDENTITY, far], false);
    let mut random = Independent::new(1, 0, 0);
    let mut left = 0;
    for i in 0..4000 {
        let centre = Vec3::from([[0.0; 3], [300.0, -500.0, 200.0]][i % 2]);
        let mut around = || {
            let [x, y] = random.next_2d::<f32>();
            Vec3::new(x - 0.5, y - 0.5, random.next_1d::<f32>() - 0.5).normalize()
        };
        let (o, d) = (centre + around() * 3.0, around());
        let Some(hit) = scene.intersect(&Ray::new(o, (centre - o).normalize())) else {
            continue;
        };
        // From a ball with shallow bumps, seen from far outside, most leave for good.
        let d = if d.dot(hit.si.n_geo) < 0.0 { -d } else { d };
        let next = scene.intersect(&hit.si.spawn_ray(d, scene.exit(hit.prim)));
        match next {
            Some(next) if next.shape == hit.shape => {
                assert!(next.prim != hit.prim && next.si.t > 0.0);
            }
            _ => left += 1,
        }
    }
    assert!(left > 3000, "{left}");
}

/// Two balls and a box of a group, of which one has a texture, and both transforms of their own, three times.
struct Grove {
    folder: tempfile::TempDir,
    instances: String,
    copies: String,
}

const VIEW: &str = r#"<integrator type="path"><integer name="max_depth" value="5"/></integrator>
    <sensor type="perspective"><float name="fov" value="45"/><transform name="to_world">
    <lookat origin="0, 3, 8" target="0, 0.5, 0" up="0, 1, 0"/></transform><film type="hdrfilm">
    <integer name="width" value="24"/><integer name="height" value="24"/><rfilter type="box"/></film></sensor>
    <bsdf type="diffuse" id="clay"><rgb name="reflectance" value="0.7, 0.5, 0.3"/></bsdf>
    <shape type="rectangle" id="floor"><transform name="to_world"><scale value="6"/><rotate x="1" angle="-90"/>
    <translate y="-0.5"/></transform></shape>
    <shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.8"/><rotate x="1" angle="90"/>
    <translate x="1" y="5" z="1"/></transform><emitter type="area"><rgb name="radiance" value="20"/></emitter></shape>
    <emitter type="constant"><rgb name="radiance" value="0.2"/></emitter>"#;

impl Grove {
    fn new(material: &str, uneven: bool) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let mut data = ball(20, [0.0; 3]);
        data.normals = smooth_normals(&data.positions, &data.triangles);
        let smooth = obj(&data);
        data.normals.clear();
        for (name, text) in [("smooth.obj", smooth), ("plain.obj", obj(&data))] {
            std::fs::write(folder.path().join(name), text).expect("a file");
        }
        let picture = |name: &str, value: fn(usize) -> f32| {
            let image = Image {
                width: 8,
                height: 8,
                data: (0..192).map(value).collect(),
            };
            write_exr(&folder.path().join(name), &image).expect("a file");
        };
        picture("tiles.exr", |i| 0.5 + 0.4 * (1.3 * i as f32).sin());
        // Smooth over the seam, and off the poles only.
        picture("normals.exr", |i| match i % 3 {
            2 => 0.95,
            k => 0.5 + 0.15 * ((i / 3 * (k + 2)) as f32 * std::f32::consts::TAU / 8.0).sin(),
        });
        let parts = [
            ("smooth.obj", r#"<rotate x="1" angle="30"/>"#, material),
            (
                "plain.obj",
                r#"<scale value="0.5"/><translate y="1.3"/>"#,
                r#"<ref id="clay"/>"#,
            ),
        ];
        let uneven = if uneven {
            [
                r#"<scale value="0.8, 1.3, 0.6"/>"#,
                r#"<scale x="-1" y="1.1" z="0.9"/>"#,
            ]
        } else {
            [r#"<scale value="0.8"/>"#, r#"<scale value="0.9"/>"#]
        };
        let places = [
            r#"<translate x="-2.4"/>"#.to_owned(),
            format!(
                r#"{}<rotate y="1" angle="40"/><translate z="0.5"/>"#,
                uneven[0]
            ),
            format!(
                r#"{}<rotate y="1" angle="200"/><translate x="2.4"/>"#,
                uneven[1]
            ),
        ];
        let shape = |(file, own, material): (&str, &str, &str), more: &str| {
            let id = file.trim_end_matches(".obj");
            format!(
                r#"<shape type="obj" id="{id}"><string name="filename" value="{file}"/>
                <transform name="to_world">{own}{more}</transform>{material}</shape>"#
            )
        };
        let group: String = parts.iter().map(|p| shape(*p, "")).collect();
        let mut instances = format!(r#"<shape type="shapegroup" id="group">{group}</shape>"#);
        let mut copies = String::new();
        for (i, place) in places.iter().enumerate() {
            write!(
                instances,
                r#"<shape type="instance" id="i{i}"><ref id="group"/><transform name="to_world">{place}</transform></shape>"#
            )
            .expect("a string");
            for part in parts {
                copies += &shape(part, place)
                    .replace("id=\"smooth\"", "")
                    .replace("id=\"plain\"", "");
            }
        }
        Self {
            folder,
            instances,
            copies,
        }
    }

    fn load(&self, shapes: &str) -> (Scene, Vec<String>) {
        let text = format!("<scene version=\"3.0.0\">{VIEW}{shapes}</scene>");
        match Scene::from_xml(&text, self.folder.path(), &LoadOptions::default()) {
            Ok(loaded) => loaded,
            Err(e) => panic!("{e}\n{text}"),
        }
    }

    fn pair(&self) -> [Scene; 2] {
        [&self.instances, &self.copies].map(|shapes| self.load(shapes).0)
    }
}

fn render(s: &Scene, seed: u64, spp: u64) -> Vec<f32> {
    let theta = Theta::constant(s.params().values());
    let job = Job::new(s, &s.settings, seed, 0..spp, &());
    let r = render_f32(&job, &theta, Estimator::Mis);
    let image = r.image(0);
    assert!(image.data.iter().all(|x| x.is_finite()));
    image.data
}

/// How much of one image is not that of another, up to rounding.
fn off(a: &[f32], b: &[f32]) -> f64 {
    let far = |(a, b): (&f32, &f32)| (a - b).abs() > 1e-3 * a.abs().max(0.05);
    a.iter().zip(b).filter(|pair| far(*pair)).count() as f64 / a.len() as f64
}

const TILES: &str = r#"<bsdf type="diffuse"><texture type="bitmap" name="reflectance">
    <string name="filename" value="tiles.exr"/></texture></bsdf>"#;
const METAL: &str = r#"<bsdf type="roughconductor"><float name="alpha_u" value="0.1"/><float name="alpha_v" value="0.4"/></bsdf>"#;
const GLASS: &str = r#"<bsdf type="dielectric"/>"#;
const MAPPED: &str = r#"<bsdf type="normalmap"><texture type="bitmap" name="normalmap"><boolean name="raw" value="true"/>
    <string name="filename" value="normals.exr"/></texture><bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf></bsdf>"#;
const BUMPED: &str = r#"<bsdf type="bumpmap"><texture type="bitmap" name="arbitrary"><boolean name="raw" value="true"/>
    <string name="filename" value="tiles.exr"/></texture><float name="scale" value="0.05"/><bsdf type="diffuse"/></bsdf>"#;

/// Images with instances are those of shapes that are written out, with the same seed up to rounding and by chance with
/// another: transforms one in another, mirrored and uneven, materials that read coordinates and frames. 24 x 24 pixels of
/// 16 samples, and 4 runs of 16 samples.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn images_are_those_of_copies() {
    for (what, material, uneven) in [
        ("tiles", TILES, false),
        ("metal", METAL, true),
        ("glass", GLASS, true),
        ("mapped", MAPPED, true),
        ("bumped", BUMPED, false),
    ] {
        let grove = Grove::new(material, uneven);
        let [instances, mut copies] = grove.pair();
        if uneven {
            // Smooth normals are made in the group's space.
            copies = grove
                .load(&grove.copies.replace("plain.obj", "smooth.obj"))
                .0;
            assert_eq!(copies.shapes().len(), instances.shapes().len());
        }
        let [instances, copies] = if uneven {
            let shapes = grove.instances.replace("plain.obj", "smooth.obj");
            [grove.load(&shapes).0, copies]
        } else {
            [instances, copies]
        };
        let placed = |s: &Scene| {
            (s.shapes().iter())
                .filter(|s| matches!(s, AnyShape::Instance(_)))
                .count()
        };
        assert_eq!(placed(&copies), 0, "{what}");
        assert_eq!(
            placed(&instances),
            if what == "bumped" { 3 } else { 6 },
            "{what}"
        );
        let [a, b] = [&instances, &copies].map(|s| render(s, 3, 16));
        let part = off(&a, &b);
        println!("{what}: {part}");
        assert!(part < 0.03, "{what}: {part} of the image is another");
        let [a, b] =
            [(&instances, 10), (&copies, 20)].map(|(s, seed)| picture(s, &s.settings, seed, 4, 16));
        let limit = z_limit(a.len() / 16, 4, 1e-3);
        for (i, (a, b)) in (a.chunks(16).zip(b.chunks(16))).enumerate() {
            let sum = |e: &[render::statistics::Estimate]| {
                let mean = e.iter().map(|e| e.mean).sum::<f64>();
                (mean, e.iter().map(|e| e.se * e.se).sum::<f64>().sqrt())
            };
            let ((a, da), (b, db)) = (sum(a), sum(b));
            assert!(
                (a - b).abs() <= limit * da.hypot(db) + 1e-9,
                "{what} {i}: {a} {b}"
            );
        }
    }
}

/// Reflections keep the outside outside, as in Mitsuba, also of meshes whose normals follow from the order of corners.
#[test]
fn mirrored_instances_keep_their_outside() {
    let mesh = Mesh::smoothed(ball(12, [0.0; 3]), false).expect("a mesh");
    let flat = Mesh::new(ball(12, [0.0; 3]), false).expect("a mesh");
    for mesh in [mesh, flat] {
        for map in maps() {
            let instance = Instance::new(mesh.clone(), map).expect("in reach");
            let centre = Vec3::from(map.point([0.0; 3]));
            for prim in [0, 77, 200] {
                let at = render::shape::SurfaceCoordinates([0.3, 0.4].into());
                for shape in [AnyShape::from(instance.clone()), instance.copied().into()] {
                    let si = shape.point_at::<f64>(&Theta::still(), prim, at);
                    assert!(
                        si.n_geo.dot(si.p - centre) >= 0.0 && si.frame.n.dot(si.p - centre) >= 0.0
                    );
                }
            }
        }
    }
}

/// A mirror of an instance turns no ball inside out, unlike one of the ball's own; a flag does.
#[test]
fn mirrored_instances_keep_the_outside_of_balls() {
    let folder = tempfile::tempdir().expect("a folder");
    let load = |flags: &str, own: &str, place: &str| {
        let text = format!(
            r#"<scene version="3.0.0">{VIEW}<shape type="shapegroup" id="group"><shape type="sphere">{flags}
            <transform name="to_world">{own}</transform></shape></shape>
            <shape type="instance" id="it"><ref id="group"/><transform name="to_world">{place}</transform></shape></scene>"#
        );
        let loaded = Scene::from_xml(&text, folder.path(), &LoadOptions::default());
        let (scene, _) = loaded.expect("valid");
        let Some(AnyShape::Sphere(ball)) = scene.shapes().get(2) else {
            panic!("no ball");
        };
        let at = render::shape::SurfaceCoordinates([0.3, 0.4].into());
        let si = ball.point_at::<f64>(&Theta::still(), 0, at);
        si.n_geo.dot(si.p) > 0.0
    };
    let (mirror, flip) = (
        r#"<scale x="-1"/>"#,
        r#"<boolean name="flip_normals" value="true"/>"#,
    );
    for place in ["", mirror, r#"<scale value="-2"/>"#] {
        assert!(load("", "", place), "{place}");
        assert!(!load(flip, "", place), "{place}");
        assert!(!load("", mirror, place), "{place}");
        assert!(load(flip, mirror, place), "{place}");
    }
}

/// What instances cannot be is refused, with the line and a reason; what they are is loaded without a warning.
#[test]
fn what_cannot_be_placed_is_refused() {
    let grove = Grove::new(TILES, false);
    let (scene, warnings) = grove.load(&grove.instances);
    assert_eq!(warnings, Vec::<String>::new());
    let names: Vec<_> = (2..8).map(|i| scene.shape_info(i).name.as_str()).collect();
    assert_eq!(names[0], "i0.smooth");
    assert_eq!(names[5], "i2.plain");
    // One material, by the name that the first has given it.
    assert!((1..4).all(|i| scene.shape_info(2 * i).material == scene.shape_info(2).material));
    assert!(
        scene
            .params()
            .find("i0.smooth.bsdf.reflectance.data")
            .is_ok()
    );
    assert!(
        scene
            .params()
            .find("i2.plain.bsdf.reflectance.value")
            .is_ok()
    );
    let (_, warnings) = Grove::new(BUMPED, false).load(&grove.instances.replace(TILES, BUMPED));
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(
        warnings.iter().all(|w| w.contains("copied")),
        "{warnings:?}"
    );
    let load = |shapes: &str| {
        let text = format!("<scene version=\"3.0.0\">{VIEW}{shapes}</scene>");
        let loaded = Scene::from_xml(&text, grove.folder.path(), &LoadOptions::default());
        loaded.map(|_| ()).expect_err(shapes).to_string()
    };
    for (place, expected) in [
        (r#"<scale value="1, 0, 1"/>"#, "to_world"),
        (r#"<scale value="1e13"/>"#, "to_world"),
        (r#"<translate x="1e13"/>"#, "to_world"),
    ] {
        let error = load(&grove.instances.replace(r#"<translate x="-2.4"/>"#, place));
        assert!(
            error.contains(expected) && error.contains("<text>:"),
            "{error}"
        );
    }
    // Balls that are none any more.
    let balls = r#"<shape type="shapegroup" id="balls"><shape type="sphere" id="ball"/></shape>
        <shape type="instance"><ref id="balls"/><transform name="to_world"><scale value="1, 2, 1"/></transform></shape>"#;
    let error = load(balls);
    assert!(
        error.contains("to_world") || error.contains("scale"),
        "{error}"
    );
}

/// A thousand instances of ten thousand triangles take the memory of one and a little more, and can be seen.
#[test]
fn memory_does_not_grow_with_instances() {
    let mesh = Mesh::new(ball(72, [0.0; 3]), false).expect("a mesh");
    let maps: Vec<Transform> = (0..1000u32)
        .map(|i| {
            let [x, y, z] = [i % 10, i / 10 % 10, i / 100].map(|k| f64::from(k) - 4.5);
            Transform::scale([0.4; 3]).then(&Transform::translate([x, y, z]))
        })
        .collect();
    let [one, all] = [1, 1000].map(|n| placed(&mesh, &maps[..n], false));
    let per_instance = (all.memory_bytes() - one.memory_bytes()) / 999;
    println!(
        "{} bytes, and {per_instance} for each more",
        one.memory_bytes()
    );
    assert!(per_instance < 400 && one.memory_bytes() > 1_000_000);
    let image = render(&all, 0, 4);
    let mean = image.iter().sum::<f32>() / image.len() as f32;
    assert!(mean > 0.1 && mean < 1.0, "{mean}");
    assert!(
        all.intersect(&Ray::new(
            Vec3::new(4.6f32, 4.6, 20.0),
            Vec3::new(0.0, 0.0, -1.0)
        ))
        .is_some()
    );
}

/// A lamp that lies on a face of an instance is met before it, as on that of a copy.
#[test]
fn lamps_on_instances_shine() {
    let plate = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nf 1 4 3 2\n";
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("plate.obj"), plate).expect("a file");
    let scene = |shapes: &str| {
        let text = format!(
            r#"<scene version="3.0.0">{VIEW}
            <shape type="rectangle" id="light"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="-90"/>
            <rotate z="1" angle="13"/><translate y="0.7"/></transform><emitter type="area"><rgb name="radiance" value="3"/></emitter>
            </shape>{shapes}</scene>"#
        );
        Scene::from_xml(&text, folder.path(), &LoadOptions::default())
            .expect("a scene")
            .0
    };
    let place = r#"<rotate z="1" angle="13"/><translate y="0.7"/>"#;
    let far = r#"<translate y="-3"/>"#;
    let instances = scene(&format!(
        r#"<shape type="shapegroup" id="g"><shape type="obj"><string name="filename" value="plate.obj"/></shape></shape>
        <shape type="instance"><ref id="g"/><transform name="to_world">{place}</transform></shape>
        <shape type="instance"><ref id="g"/><transform name="to_world">{far}</transform></shape>"#
    ));
    let kinds: Vec<bool> = (instances.shapes().iter())
        .map(|s| matches!(s, AnyShape::Instance(_)))
        .collect();
    assert_eq!(kinds, [false, false, false, false, true]);
    for x in [-0.3, 0.0, 0.4] {
        let down = Ray::new(Vec3::new(x, 3.0f32, 0.1), Vec3::new(0.0, -1.0, 0.0));
        assert_eq!(instances.intersect(&down).expect("a hit").shape, 2);
    }
}

fn octahedron(folder: &Path) -> String {
    let text = "v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n\
        f 3 5 1\nf 3 1 6\nf 3 6 2\nf 3 2 5\nf 4 1 5\nf 4 6 1\nf 4 2 6\nf 4 5 2\n";
    let path = folder.join("octahedron.obj");
    std::fs::write(&path, text).expect("a file");
    format!(
        r#"{FLOOR}<shape type="shapegroup" id="group"><shape type="obj" id="it"><string name="filename" value="{}"/>
        <boolean name="face_normals" value="true"/><ref id="grey"/></shape></shape>
        <shape type="instance" id="a"><ref id="group"/><transform name="to_world"><scale value="0.6, 0.5, 0.7"/>
        <rotate y="1" angle="25"/><translate x="-0.5" y="1.1"/></transform></shape>
        <shape type="instance" id="b"><ref id="group"/><transform name="to_world"><scale value="-0.4, 0.4, 0.4"/>
        <rotate z="1" angle="20"/><translate x="0.9" y="0.8" z="0.6"/></transform></shape>"#,
        path.display()
    )
}

/// Instances move by themselves, before each other, and have outlines when the camera moves: by edges against central
/// differences. 8 runs of 64 samples of 256 pixels, and differences of 8 runs of 160.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn edges_of_instances_agree_with_differences() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut s = tests::moving::scene(&octahedron(folder.path()), 3);
    let names = ["a.it.translation", "sensor.translation"];
    s.make_movable(&names).expect("known");
    assert!(
        (s.shapes().iter())
            .filter(|s| matches!(s, AnyShape::Instance(_)))
            .count()
            == 2
    );
    let found = gradient::<ByEdges>(&s, &names, 8, 64);
    let expected = differences(&mut s, &names, 1.0 / 32.0, 8, 160);
    agrees("instances", &found, &expected, 1e-2, 8);
}

/// Points that rounding makes one far away are as many as in the group.
#[test]
fn points_are_those_of_the_group() {
    let mesh = Mesh::new(ball(24, [0.0; 3]), false).expect("a mesh");
    let map = Transform::scale([1e-3; 3]).then(&Transform::translate([900.0, 0.0, 0.0]));
    let copy = Instance::new(mesh.clone(), map).expect("in reach").copied();
    let own = Mesh::new(copy.data().clone(), false).expect("a mesh");
    assert!(own.points() < mesh.points());
    assert_eq!(copy.points(), mesh.points());
}

/// Points of an instance become parameters, and it a copy: nothing else has changed. Where normals would not follow, that
/// is refused.
#[test]
fn points_of_instances_are_copied() {
    let folder = tempfile::tempdir().expect("a folder");
    let body = octahedron(folder.path());
    let mut s = tests::moving::scene(&body, 3);
    let before = render(&s, 1, 16);
    s.make_movable(&["b.it.translation", "b.it.vertex_positions"])
        .expect("known");
    assert!(
        matches!(s.shapes()[3], AnyShape::Mesh(_))
            && matches!(s.shapes()[2], AnyShape::Instance(_))
    );
    assert!(off(&before, &render(&s, 1, 16)) < 0.02);
    let mut points = s
        .params()
        .get("b.it.vertex_positions")
        .expect("known")
        .to_vec();
    assert_eq!(points.len(), 18);
    points.iter_mut().for_each(|x| *x += 0.25);
    s.set([("b.it.vertex_positions", &points[..])])
        .expect("valid");
    let moved = render(&s, 1, 16);
    assert!(off(&before, &moved) > 0.05);
    // The same by the other parameter.
    let mut other = tests::moving::scene(&body, 3);
    other.make_movable(&["b.it.translation"]).expect("known");
    other
        .set([("b.it.translation", &[0.25f32; 3][..])])
        .expect("valid");
    assert!(matches!(other.shapes()[3], AnyShape::Instance(_)));
    assert!(off(&moved, &render(&other, 1, 16)) < 0.02);
    let smooth = body.replace(r#"<boolean name="face_normals" value="true"/>"#, "");
    let mut s = tests::moving::scene(&smooth, 3);
    s.make_movable(&["b.it.vertex_positions"])
        .expect("scaled evenly");
    let error = s
        .make_movable(&["a.it.vertex_positions"])
        .expect_err("uneven")
        .to_string();
    assert!(
        error.contains("a.it.vertex_positions") && error.contains("normals"),
        "{error}"
    );
}
