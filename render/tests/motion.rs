//! What moves: parameters of shapes, cameras and lights, what follows from them, and how points move.

use ad_core::{Dual, Real, Vec3};
use render::bsdf::Diffuse;
use render::camera::{Camera, CameraSample, FovAxis};
use render::emitter::{Constant, Emitter, Spot};
use render::instances::{Estimator, render_f32};
use render::math::{Ray, RayAdjoint, Transform};
use render::params::{ParamKind, Params, Tangent, Theta};
use render::sampler::{Independent, Sampler};
use render::scene::{Builder, LoadOptions, Settings};
use render::shape::{
    AnyShape, Cube, Cylinder, Disk, Instance, Mesh, MeshData, Patch, Rectangle, Shape, Sphere,
    SurfaceAdjoint, SurfaceCoordinates, SurfaceInteraction,
};
use render::{Film, Job, Scene};

use crate::common::Gradient;

type D1 = Dual<f64, 1>;

/// A waving sheet with a seam of texture coordinates, whose normals follow its positions.
fn sheet() -> MeshData {
    let n = 5u32;
    let mut mesh = MeshData::default();
    // Two halves that share the positions of the middle column only.
    for (from, to) in [(0, 2), (2, 4)] {
        let first = mesh.positions.len() as u32;
        let columns = to - from + 1;
        for i in from..=to {
            for j in 0..n {
                let [x, y] = [i, j].map(|k| 0.5 * k as f32 - 1.0);
                let z = 0.25 * (2.0 * x + y).sin();
                mesh.positions.push([x, y, z]);
                let u = 0.4 * (i - from) as f32 / columns as f32 + 0.5 * (from / 2) as f32;
                mesh.uvs.push([u, 0.2 * j as f32]);
            }
        }
        for i in 0..columns - 1 {
            for j in 0..n - 1 {
                let a = first + i * n + j;
                mesh.triangles.push([a, a + n, a + n + 1]);
                mesh.triangles.push([a, a + n + 1, a + 1]);
            }
        }
    }
    mesh
}

/// Every shape, turned and displaced.
fn shapes() -> Vec<(&'static str, AnyShape)> {
    let to_world = Transform::sequence([
        Transform::scale([0.75; 3]),
        Transform::rotate([1.0, 2.0, -0.5], 70.0).unwrap(),
        Transform::translate([0.25, -0.25, 0.5]),
    ]);
    let affine = Transform::scale([1.2, 0.6, 0.9]).then(&to_world);
    let mirrored = Transform::scale([1.0, -1.0, 1.0]).then(&to_world);
    let placed = |mesh: Result<Mesh, _>, map: &Transform| {
        let mesh: Result<Mesh, render::SceneError> = mesh;
        AnyShape::from(Instance::new(mesh.unwrap(), *map).unwrap())
    };
    let mut given = sheet();
    given.normals = vec![[0.1, -0.2, 1.0]; given.positions.len()];
    let bare = MeshData {
        uvs: Vec::new(),
        ..sheet()
    };
    let patch = Patch::new([-0.9, -0.8, 0.1], [1.7, 0.2, 0.3], [0.1, 1.6, -0.2], true);
    let (p0, p1) = ([0.1, -0.8, 0.2], [0.3, 0.7, -0.1]);
    vec![
        (
            "sphere",
            Sphere::transformed(&to_world, false).unwrap().into(),
        ),
        ("disk", Disk::new(&affine, false).unwrap().into()),
        ("rectangle", Rectangle(patch.unwrap()).into()),
        ("cube", Cube::new(&affine, false).unwrap().into()),
        (
            "cylinder",
            Cylinder::new(p0, p1, 0.6, false).unwrap().into(),
        ),
        (
            "smooth mesh",
            Mesh::smoothed(sheet(), false).unwrap().into(),
        ),
        (
            "mesh with normals",
            Mesh::new(given.clone(), false).unwrap().into(),
        ),
        ("flat mesh", Mesh::new(sheet(), true).unwrap().into()),
        (
            "bare mesh",
            Mesh::smoothed(bare.clone(), false).unwrap().into(),
        ),
        ("instance", placed(Mesh::new(given, false), &affine)),
        (
            "mirrored instance",
            placed(Mesh::smoothed(sheet(), true), &mirrored),
        ),
        ("bare instance", placed(Mesh::new(bare, false), &mirrored)),
    ]
}

/// One shape with a texture under a sky.
fn scene(shape: AnyShape) -> Scene {
    let mut build = Builder::new();
    let texels: Vec<f32> = (0..48).map(|i| (i * 7 % 10) as f32 / 10.0).collect();
    let reflectance = build.texels("wood", [4, 4], &texels, (0.0, 1.0)).unwrap();
    let wood = build.add_material(Diffuse { reflectance });
    build.add_shape("it", shape, wood);
    let radiance = build.rgb("sky", [1.0; 3], (0.0, 9.0)).unwrap();
    build.add_emitter(Constant { radiance }, None);
    let view = Transform::look_at([0.5, 0.25, 6.0], [0.0; 3], [0.0, 1.0, 0.0]).unwrap();
    let camera = Camera::new(view, 30.0, FovAxis::Smaller, [16, 16]).unwrap();
    build
        .build(camera, Film::new(16, 16), Settings::default())
        .unwrap()
}

fn wide(params: &Params) -> Vec<f64> {
    params.values().iter().map(|&v| v.into()).collect()
}

/// The parameters of a scene, of which element `at` of the range `name` moves.
fn tangents(scene: &Scene, name: &str, at: usize) -> Vec<Tangent<D1>> {
    let mut all = vec![Tangent::None; scene.params().infos().len()];
    let info = scene.params().find(name).unwrap();
    let mut own = vec![Dual::new(0.0, [0.0]); info.shape.len()];
    own[at].eps[0] = 1.0;
    all[scene.params().handle(info).id as usize] = Tangent::Dense(own);
    all
}

fn set(scene: &mut Scene, name: &str, at: usize, value: impl Fn(f32) -> f32) {
    let mut values = scene.params().values().to_vec();
    let i = scene.params().find(name).unwrap().offset + at;
    values[i] = value(values[i]);
    scene.set_params(&values).unwrap();
}

/// Every number of an interaction.
fn numbers<R: Real>(si: &SurfaceInteraction<R>) -> Vec<R> {
    let vectors = [si.p, si.n_geo, si.frame.s, si.frame.t, si.frame.n];
    let all = vectors.iter().flat_map(|v| v.to_array());
    all.chain([si.uv.x, si.uv.y]).collect()
}

/// Adjoints without a pattern.
fn adjoint(s: &mut Independent) -> SurfaceAdjoint<f64> {
    let mut next = || Vec3::new(s.next_1d(), s.next_1d(), s.next_1d()) - Vec3::new(0.5, 0.5, 0.5);
    let mut d = SurfaceAdjoint::zero();
    (d.p, d.n_geo, d.frame.s, d.frame.t, d.frame.n) = (next(), next(), next(), next(), next());
    (d.uv.x, d.uv.y) = (next().x, next().x);
    d
}

/// A ray at the shapes from somewhere around them.
fn ray(s: &mut Independent) -> Ray<f64> {
    let mut unit = || {
        let mut next = || s.next_1d::<f64>() - 0.5;
        Vec3::new(next(), next(), next())
    };
    let o = unit().normalize() * 4.0;
    Ray::new(o, (unit() * 1.2 - o).normalize())
}

const NAMES: [&str; 5] = [
    "it.translation",
    "it.rotation",
    "it.scale",
    "it.vertex_positions",
    "it.vertex_normals",
];

/// The parameters of these that the shape has, moved from where they were at rest.
fn moved(shape: AnyShape) -> (Scene, Vec<&'static str>) {
    let mut scene = scene(shape);
    let names: Vec<_> = NAMES
        .into_iter()
        .filter(|n| scene.movables().iter().any(|m| m.name == *n))
        .collect();
    scene.make_movable(&names).unwrap();
    for (at, by) in [0.25, -0.5, 0.125].into_iter().enumerate() {
        set(&mut scene, "it.translation", at, |_| by);
        set(&mut scene, "it.rotation", at, |_| 2.0 * by);
    }
    set(&mut scene, "it.scale", 0, |_| 1.25);
    for name in &names[3..] {
        set(&mut scene, name, 20, |z| z + 0.125);
    }
    (scene, names)
}

/// Whether a step may cross a place where coordinates jump, or an edge.
fn jumps(a: &SurfaceInteraction<f64>, b: &SurfaceInteraction<f64>) -> bool {
    let pairs = numbers(a).into_iter().zip(numbers(b));
    pairs.into_iter().any(|(x, y)| (x - y).abs() > 0.1)
}

/// Points that stay on the material and points that stay on a ray, areas, over duals, against differences of scenes that
/// are moved by parameters, at two steps. Positions are rounded to single precision: a step of 2^-7 sees them to 2e-5.
#[test]
fn points_move_as_differences_say() {
    const STEP: f32 = 1.0 / 128.0;
    for (name, shape) in shapes() {
        let (start, names) = moved(shape.clone());
        let values = wide(start.params());
        let mut s = Independent::new(7, 0, 0);
        let mut tested = 0;
        let mut vary = |param: &str, element: usize, rays: u32| {
            let all = tangents(&start, param, element);
            let theta = Theta::with_tangents(&values, &all);
            // Four scenes, by two steps apart.
            let apart = [STEP, -STEP, STEP / 2.0, -STEP / 2.0].map(|h| {
                let (mut scene, _) = moved(shape.clone());
                set(&mut scene, param, element, |v| v + h);
                scene
            });
            // Central differences, and their limit.
            let slopes = |all: [Vec<f64>; 4]| -> Vec<f64> {
                let step = f64::from(STEP);
                let each = |i: usize| {
                    let [a, b, c, d] = [0, 1, 2, 3].map(|k: usize| all[k][i]);
                    (4.0 * (c - d) / step - (a - b) / (2.0 * step)) / 3.0
                };
                (0..all[0].len()).map(each).collect()
            };
            for _ in 0..rays {
                let ray = ray(&mut s);
                let Some(hit) = start.intersect(&ray) else {
                    continue;
                };
                let at = start.coordinates(hit.prim, &hit.si);
                let still = Theta::still();
                let mut pairs: Vec<(D1, f64)> = Vec::new();
                let all =
                    [0, 1, 2, 3].map(|k: usize| apart[k].point_at::<f64>(&still, hit.prim, at));
                if all.iter().all(|si| !jumps(si, &hit.si)) {
                    let found = start.point_at(&theta, hit.prim, SurfaceCoordinates::lift(at));
                    let area = start.area_element(&theta, hit.prim);
                    let with_area = |k: usize| {
                        let mut all = numbers(&all[k]);
                        all.push(apart[k].area_element::<f64>(&still, hit.prim));
                        all
                    };
                    let found = numbers(&found).into_iter().chain([area]);
                    pairs.extend(found.zip(slopes([0, 1, 2, 3].map(with_area))));
                }
                let seen = [0, 1, 2, 3].map(|k: usize| apart[k].intersect(&ray));
                if let [Some(a), Some(b), Some(c), Some(d)] = seen
                    && [a, b, c, d]
                        .iter()
                        .all(|x| x.prim == hit.prim && !jumps(&x.si, &hit.si))
                    && hit.si.n_geo.dot(ray.d).abs() > 0.4
                {
                    let found = start.intersect_moving(&theta, &Ray::lift(ray)).unwrap().si;
                    let with_t = |si: &SurfaceInteraction<f64>| {
                        let mut all = numbers(si);
                        all.push(si.t);
                        all
                    };
                    let all = [a, b, c, d].map(|x| with_t(&x.si));
                    pairs.extend(
                        numbers(&found)
                            .into_iter()
                            .chain([found.t])
                            .zip(slopes(all)),
                    );
                }
                for (i, (found, expected)) in pairs.into_iter().enumerate() {
                    let error = (found.eps[0] - expected).abs();
                    assert!(
                        error < 1e-3 * (1.0 + expected.abs()),
                        "{name} {param}[{element}] {i}: {} {expected}",
                        found.eps[0]
                    );
                    tested += 1;
                }
            }
        };
        for param in names {
            let elements: &[usize] = match param {
                "it.scale" => &[0],
                "it.vertex_positions" | "it.vertex_normals" => &[18, 20, 36, 37],
                _ => &[0, 1, 2],
            };
            for &at in elements {
                vary(param, at, 60);
            }
        }
        assert!(tested > 1500, "{name}: {tested}");
    }
}

/// What adds adjoints is the transpose of what carries tangents: of points that stay on the material, of what rays meet,
/// and of the rays themselves.
#[test]
fn adjoints_are_the_transpose() {
    for (name, shape) in shapes() {
        let (mut scene, names) = moved(shape);
        scene
            .make_movable(&["sensor.translation", "sensor.rotation", "sensor.fov"])
            .unwrap();
        set(&mut scene, "sensor.rotation", 0, |_| 0.125);
        set(&mut scene, "sensor.fov", 0, |f| f + 2.0);
        let values = wide(scene.params());
        let still = Theta::<f64>::constant(&values);
        let mut s = Independent::new(8, 0, 0);
        let mut tested = 0;
        for _ in 0..160 {
            let d = adjoint(&mut s);
            let d_log_area = s.next_1d::<f64>();
            let at_camera = CameraSample {
                film: [16.0 * s.next_1d::<f64>(), 16.0 * s.next_1d::<f64>()],
                lens: [0.0; 2],
            };
            let ray = scene.camera.ray_of(&at_camera);
            let Some(hit) = scene.intersect(&ray) else {
                continue;
            };
            let at = scene.coordinates(hit.prim, &hit.si);
            let mut point = Gradient(vec![0.0; values.len()]);
            scene.scatter_point(&still, hit.prim, &hit.si, &d, d_log_area, &mut point);
            let mut seen = Gradient(vec![0.0; values.len()]);
            let back: RayAdjoint<f64> =
                scene.scatter_interaction(&still, hit.prim, &ray, &hit.si, &d, &mut seen);
            scene
                .camera
                .scatter_ray(&still, &at_camera, &back, &mut seen);
            for param in
                names
                    .iter()
                    .copied()
                    .chain(["sensor.translation", "sensor.rotation", "sensor.fov"])
            {
                let info = scene.params().find(param).unwrap().clone();
                for k in 0..info.shape.len() {
                    let all = tangents(&scene, param, k);
                    let theta = Theta::with_tangents(&values, &all);
                    let ray = scene.camera.ray_moving(&theta, &at_camera);
                    let found = scene.intersect_moving(&theta, &ray).unwrap();
                    let stays = scene.point_at(&theta, hit.prim, SurfaceCoordinates::lift(at));
                    let area = scene.area_element(&theta, hit.prim);
                    let along = d.of(&stays).eps[0] + d_log_area * area.eps[0] / area.re;
                    let pairs = [
                        (d.of(&found.si).eps[0], seen.0[info.offset + k]),
                        (along, point.0[info.offset + k]),
                    ];
                    for (forward, reverse) in pairs {
                        let error = (forward - reverse).abs();
                        assert!(
                            error < 1e-9 * (1.0 + forward.abs()),
                            "{name} {param}[{k}]: {forward} {reverse}"
                        );
                        tested += usize::from(forward != 0.0);
                    }
                }
            }
        }
        assert!(tested > 60, "{name}: {tested}");
    }
}

/// Rays of all kinds of cameras, with all that moves them: what carries tangents has the derivatives of differences, what adds
/// adjoints is its transpose, and neither changes the ray.
#[test]
fn rays_of_cameras_move_as_differences_say() {
    let view = r#"<transform name="to_world"><lookat origin="1, 2, 3" target="0.3, -0.2, 0.1" up="0.1, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="30"/></film>"#;
    let angle =
        r#"<float name="fov" value="50"/><float name="principal_point_offset_x" value="0.1"/>"#;
    let lens = r#"<float name="aperture_radius" value="0.375"/><float name="focus_distance" value="2.5"/>"#;
    for (plugin, own, keys) in [
        ("perspective", angle.to_string(), &["fov"][..]),
        ("orthographic", String::new(), &[][..]),
        (
            "thinlens",
            format!("{angle}{lens}"),
            &["fov", "aperture_radius", "focus_distance"],
        ),
    ] {
        let mut scene = load(&format!(
            r#"<scene version="3.0.0"><sensor type="{plugin}">{own}{view}</sensor><shape type="sphere"/></scene>"#
        ));
        let names: Vec<String> = (scene.movables().into_iter())
            .map(|m| m.name)
            .filter(|name| name.starts_with("sensor."))
            .collect();
        let expected = ["translation", "rotation"].iter().chain(keys);
        assert!(
            names.iter().eq(expected
                .map(|key| format!("sensor.{key}"))
                .collect::<Vec<_>>()
                .iter())
        );
        scene.make_movable(&names).unwrap();
        // At rest, nothing has changed.
        let at = CameraSample {
            film: [13.25, 7.5],
            lens: [0.3, 0.8],
        };
        let start: Ray<f64> = scene.camera.ray_of(&at);
        for (i, by) in [0.25, -0.5, 0.125].into_iter().enumerate() {
            set(&mut scene, "sensor.translation", i, |_| by);
            set(&mut scene, "sensor.rotation", i, |_| 2.0 * by);
        }
        for key in keys {
            set(&mut scene, &format!("sensor.{key}"), 0, |x| 1.125 * x);
        }
        let values = wide(scene.params());
        let still = Theta::<f64>::constant(&values);
        let here: Ray<f64> = scene.camera.ray_of(&at);
        assert!((here.o - start.o).length() > 0.1 && (here.d - start.d).length() > 0.1);
        let d = RayAdjoint {
            o: Vec3::new(0.3, -0.7, 1.1),
            d: Vec3::new(-0.2, 0.9, 0.4),
        };
        let mut pulled = Gradient(vec![0.0; values.len()]);
        scene.camera.scatter_ray(&still, &at, &d, &mut pulled);
        for name in &names {
            let info = scene.params().find(name).unwrap().clone();
            for k in 0..info.shape.len() {
                let all = tangents(&scene, name, k);
                let moving = scene
                    .camera
                    .ray_moving(&Theta::with_tangents(&values, &all), &at);
                let primal = moving.primal();
                assert!(
                    (primal.o - here.o).length() < 1e-12 && (primal.d - here.d).length() < 1e-12
                );
                let slope = |v: Vec3<D1>| v.map(|x| x.eps[0]);
                let pushed = slope(moving.o).dot(d.o) + slope(moving.d).dot(d.d);
                let back = pulled.0[info.offset + k];
                assert!((pushed - back).abs() < 1e-12, "{name} {k}: {pushed} {back}");

                let h = 1.0 / 512.0;
                let mut by = |h: f32| -> Ray<f64> {
                    set(&mut scene, name, k, |x| x + h);
                    let ray = scene.camera.ray_of(&at);
                    set(&mut scene, name, k, |x| x - h);
                    ray
                };
                let (a, b) = (by(h), by(-h));
                let scale = f64::from(0.5 / h);
                let o = (a.o - b.o) * scale - slope(moving.o);
                let d = (a.d - b.d) * scale - slope(moving.d);
                assert!(
                    o.length() < 2e-5 && d.length() < 2e-5,
                    "{plugin} {name} {k}: {o:?} {d:?}"
                );
            }
        }
    }
}

fn load(text: &str) -> Scene {
    let (scene, warnings) = Scene::from_xml(text, "".as_ref(), &LoadOptions::default()).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    scene
}

fn render(scene: &Scene) -> Vec<f32> {
    let job = Job::new(scene, &scene.settings, 3, 0..16, &());
    let theta = Theta::constant(scene.params().values());
    render_f32(&job, &theta, Estimator::Mis).image(0).data
}

/// A scene file with one shape, of which the transform ends with `more`.
fn file(plugin: &str, own: &str, more: &str, sensor: &str, lights: &str) -> String {
    format!(
        r#"<scene version="3.0.0">
            <integrator type="path"><integer name="max_depth" value="3"/></integrator>
            <sensor type="perspective">{sensor}
                <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="24"/>
                <rfilter type="box"/></film></sensor>
            <shape type="{plugin}" id="it">{own}<transform name="to_world">
                <scale x="1.25" y="1.25" z="1.25"/><rotate x="0.894427" y="0.447214" angle="25"/>
                <translate x="0.25" y="-0.5"/>{more}</transform>
                <bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
            <shape type="rectangle" id="floor"><transform name="to_world">
                <scale value="8"/><translate z="-3"/></transform></shape>
            {lights}
        </scene>"#
    )
}

const SENSOR: &str = r#"<float name="fov" value="40"/><transform name="to_world">
    <lookat origin="0.5, 1, 7" target="0, 0, 0" up="0, 1, 0"/></transform>"#;
const LIGHTS: &str = r#"<emitter type="point" id="bulb"><point name="position" x="2" y="3" z="5"/>
        <rgb name="intensity" value="40"/></emitter>
    <emitter type="constant"><rgb name="radiance" value="0.5"/></emitter>"#;

/// Relative difference of most pixels, and of the whole: outlines may move by a rounding.
fn assert_alike(name: &str, a: &[f32], b: &[f32]) {
    let mean = |x: &[f32]| x.iter().map(|&x| f64::from(x)).sum::<f64>() / x.len() as f64;
    let off = a
        .iter()
        .zip(b)
        .filter(|(a, b)| (*a - *b).abs() > 1e-4 * a.abs().max(1.0))
        .count();
    assert!(off * 50 < a.len(), "{name}: {off} of {}", a.len());
    assert!(
        (mean(a) / mean(b) - 1.0).abs() < 1e-3,
        "{name}: {} {}",
        mean(a),
        mean(b)
    );
}

/// Scenes that parameters have moved look like those that were loaded there; where they are at rest, bit by bit.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn moved_scenes_are_those_that_are_loaded_there() {
    let plugins = [
        ("sphere", ""),
        ("disk", ""),
        ("rectangle", ""),
        ("cube", ""),
        ("cylinder", ""),
    ];
    for (plugin, own) in plugins {
        let mut scene = load(&file(plugin, own, "", SENSOR, LIGHTS));
        let start = render(&scene);
        let [x, y, z] = scene.shapes()[0].centroid();
        let names = ["it.translation", "it.rotation", "it.scale"];
        scene.make_movable(&names).unwrap();
        assert_eq!(start, render(&scene), "{plugin}");
        set(&mut scene, "it.translation", 1, |_| 0.75);
        let angle = 40.0f32;
        set(&mut scene, "it.rotation", 2, |_| 0.6 * angle.to_radians());
        set(&mut scene, "it.rotation", 0, |_| 0.8 * angle.to_radians());
        set(&mut scene, "it.scale", 0, |_| 1.5);
        let there = format!(
            r#"<translate x="{}" y="{}" z="{}"/><scale value="1.5"/><rotate x="0.8" y="0" z="0.6" angle="40"/>
               <translate x="{x}" y="{}" z="{z}"/>"#,
            -x,
            -y,
            -z,
            y + 0.75
        );
        let moved = render(&scene);
        assert!(moved != start);
        assert_alike(
            plugin,
            &moved,
            &render(&load(&file(plugin, own, &there, SENSOR, LIGHTS))),
        );
        // And back again.
        for (name, count) in [("it.translation", 3), ("it.rotation", 3)] {
            (0..count).for_each(|k| set(&mut scene, name, k, |_| 0.0));
        }
        set(&mut scene, "it.scale", 0, |_| 1.0);
        assert_eq!(start, render(&scene), "{plugin}");
    }
}

/// The same of meshes whose vertices are moved one by one, with normals that follow.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn moved_vertices_are_those_that_are_loaded_there() {
    let mut scene = scene(Mesh::smoothed(sheet(), false).unwrap().into());
    let start = render(&scene);
    scene.make_movable(&["it.positions"]).unwrap();
    let info = scene.params().find("it.vertex_positions").unwrap().clone();
    // Five vertices on the seam are one point each.
    assert_eq!((info.shape.len(), info.kind), (3 * 25, ParamKind::Position));
    assert_eq!(start, render(&scene));
    let wave = |p: [f32; 3]| [p[0] + 0.125, p[1], p[2] + 0.25 * (3.0 * p[0]).sin()];
    let mut values = scene.params().values().to_vec();
    for p in values[info.range()].as_chunks_mut::<3>().0 {
        *p = wave(*p);
    }
    scene.set_params(&values).unwrap();
    let mut there = sheet();
    there.positions.iter_mut().for_each(|p| *p = wave(*p));
    let there = self::scene(Mesh::smoothed(there, false).unwrap().into());
    assert!(render(&scene) != start);
    assert_eq!(render(&scene), render(&there));
}

/// Normals that a mesh was given turn by themselves, and with the mesh; they have a length.
#[test]
fn turned_normals_are_those_that_are_loaded_so() {
    let given = |x: f32| {
        let mut mesh = sheet();
        mesh.normals = (mesh.positions.iter())
            .map(|p| Vec3::new(f64::from(x * p[1]), -0.2, 1.0 + f64::from(p[0].abs())))
            .map(|n| n.normalize().to_array().map(|x| x as f32))
            .collect();
        AnyShape::from(Mesh::new(mesh, true).unwrap())
    };
    let seen = |scene: &Scene| -> Vec<_> {
        let points = (0..64).map(|i| [i % 8, i / 8].map(|x| 2.0 * f64::from(x) + 1.0));
        let hits = points.filter_map(|[x, y]| scene.intersect(&scene.camera.ray(x, y)));
        hits.map(|hit| numbers::<f64>(&hit.si)).collect()
    };
    let there = seen(&scene(given(0.75)));
    let mut scene = scene(given(0.25));
    assert!(there.len() > 20 && seen(&scene) != there);
    scene
        .make_movable(&["it.rotation", "it.vertex_normals"])
        .unwrap();
    let info = scene.params().find("it.vertex_normals").unwrap().clone();
    // Those on the seam are two each.
    assert_eq!(
        (info.shape.len(), info.kind),
        (3 * 30, ParamKind::VertexNormals)
    );
    let mut values = scene.params().values().to_vec();
    let normals = values[info.range()].as_chunks_mut::<3>().0;
    normals.iter_mut().for_each(|n| n[0] *= 3.0);
    scene.set_params(&values).unwrap();
    let near = |scene: &Scene| {
        let pairs = seen(scene).concat().into_iter().zip(there.concat());
        pairs.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
    };
    assert!(near(&scene) < 1e-6, "{}", near(&scene));
    values[info.offset + 6..][..3].fill(0.0);
    let message = scene.set_params(&values).unwrap_err().to_string();
    assert!(message.contains("none at vertex 2"), "{message}");
    assert!(near(&scene) < 1e-6);
    // Lengths have no parameter.
    for (length, culprit) in [(0.0, "vertex 3 has no normal"), (2.0, "vertex 3 weighs")] {
        let mut mesh = sheet();
        mesh.normals = vec![[0.0, 0.0, 1.0]; mesh.positions.len()];
        mesh.normals[3][2] = length;
        let mut scene = self::scene(Mesh::new(mesh, false).unwrap().into());
        let message = scene.make_movable(&["it.vertex_normals"]).unwrap_err();
        let message = message.to_string();
        assert!(
            message.contains("`it.vertex_normals`") && message.contains(culprit),
            "{message}"
        );
    }
}

/// Cameras and lights, too.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn moved_cameras_and_lights_are_those_that_are_loaded_there() {
    let spot = r#"<emitter type="point" id="bulb"><point name="position" x="2.5" y="3" z="4.5"/>
            <rgb name="intensity" value="40"/></emitter>
        <emitter type="constant"><rgb name="radiance" value="0.5"/></emitter>"#;
    let sensor = r#"<float name="fov" value="35"/><transform name="to_world">
        <lookat origin="0.5, 1, 7" target="0, 0, 0" up="0, 1, 0"/><translate x="-0.5" y="-1" z="-7"/>
        <rotate x="0" y="1" z="0" angle="5"/><translate x="0.25" y="1" z="7.5"/></transform>"#;
    let mut scene = load(&file("cube", "", "", SENSOR, LIGHTS));
    let start = render(&scene);
    let names = [
        "sensor.x_fov",
        "sensor.rotation",
        "sensor.translation",
        "bulb.position",
    ];
    scene.make_movable(&names).unwrap();
    assert_eq!(start, render(&scene));
    set(&mut scene, "sensor.fov", 0, |_| 35.0);
    set(&mut scene, "sensor.rotation", 1, |_| 5f32.to_radians());
    set(&mut scene, "sensor.translation", 0, |_| -0.25);
    set(&mut scene, "sensor.translation", 2, |_| 0.5);
    set(&mut scene, "bulb.position", 0, |_| 2.5);
    set(&mut scene, "bulb.position", 2, |_| 4.5);
    let there = load(&file("cube", "", "", sensor, spot));
    assert_alike("camera", &render(&scene), &render(&there));
}

/// Matrices of shapes and sensors are those of Mitsuba, and a scene in which they are set is one that was loaded with them.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn scenes_with_matrices_are_those_that_are_loaded_with_them() {
    let dir = tempfile::tempdir().unwrap();
    let obj = dir.path().join("roof.obj");
    std::fs::write(
        &obj,
        "v -1 -1 0\nv 1 -1 0.5\nv 1 1 0\nv -1 1 0.5\nf 1 2 3\nf 1 3 4\n",
    )
    .unwrap();
    let obj = format!(r#"<string name="filename" value="{}"/>"#, obj.display());
    let ball =
        r#"<point name="center" x="0.5" y="-0.25" z="1"/><float name="radius" value="0.75"/>"#;
    let pipe = r#"<point name="p0" x="0.1" y="-0.8" z="0.2"/><point name="p1" x="0.3" y="0.7" z="-0.1"/>
        <float name="radius" value="0.6"/>"#;
    let more = r#"<rotate x="0.6" y="0.8" angle="160"/><scale value="0.75"/><translate x="0.5" y="0.25" z="-0.5"/>"#;
    let sensor = r#"<float name="fov" value="40"/><transform name="to_world">
        <lookat origin="-1, 1.5, 6.5" target="0.25, 0, 0" up="0.1, 1, 0"/></transform>"#;
    let shapes = [
        ("sphere", ball),
        ("disk", ""),
        ("rectangle", ""),
        ("cube", ""),
        ("cylinder", pipe),
        ("obj", &obj[..]),
    ];
    for (plugin, own) in shapes {
        let there = load(&file(plugin, own, more, sensor, LIGHTS));
        let mut scene = load(&file(plugin, own, "", SENSOR, LIGHTS));
        let start = render(&scene);
        let names = ["it.to_world", "sensor.to_world"];
        let matrices = names.map(|name| there.to_world(name).unwrap().to_f32());
        let given = names.iter().zip(matrices.iter().map(|m| m.as_flattened()));
        scene.set(given).unwrap();
        for (name, matrix) in names.iter().zip(&matrices) {
            let found = scene.to_world(name).unwrap().matrix();
            for (a, b) in found.iter().flatten().zip(matrix.iter().flatten()) {
                assert!((a - f64::from(*b)).abs() < 2e-6, "{plugin} {name}: {a} {b}");
            }
        }
        let centroids = [&scene, &there].map(|s| s.shapes()[0].centroid());
        let off = (0..3).map(|k| (centroids[0][k] - centroids[1][k]).abs());
        assert!(off.fold(0.0, f64::max) < 2e-6, "{plugin}: {centroids:?}");
        let moved = render(&scene);
        assert!(moved != start);
        assert_alike(plugin, &moved, &render(&there));
        // And back again, to where nothing is left of it; only what moves is a parameter.
        let loaded = load(&file(plugin, own, "", SENSOR, LIGHTS));
        let matrices = names.map(|name| loaded.to_world(name).unwrap().to_f32());
        let given = names.iter().zip(matrices.iter().map(|m| m.as_flattened()));
        scene.set(given).unwrap();
        assert_eq!(start, render(&scene), "{plugin}");
        assert!(scene.params().find("floor.translation").is_err());
    }
}

/// What Mitsuba 3.9.1 has for these: matrices hold centre and radius of a sphere, and the axis of a cylinder.
#[test]
fn matrices_are_those_of_mitsuba() {
    let scene = load(
        r#"<scene version="3.0.0"><sensor type="perspective" id="eye"/>
        <shape type="sphere" id="ball"><point name="center" x="1" y="2" z="3"/><float name="radius" value="0.25"/>
            <transform name="to_world"><rotate y="1" angle="30"/><scale value="2"/></transform></shape>
        <shape type="cylinder"><point name="p0" x="1" y="0" z="0"/><point name="p1" x="1" y="2" z="1"/>
            <float name="radius" value="0.3"/></shape>
        <emitter type="constant"/></scene>"#,
    );
    let ball = [
        0.4330127, 0.0, 0.25, 4.7320508, 0.0, 0.5, 0.0, 4.0, -0.25, 0.0, 0.4330127, 4.1961524,
    ];
    let pipe = [
        0.3, 0.0, 0.0, 1.0, 0.0, 0.1341641, 2.0, 0.0, 0.0, -0.2683282, 1.0, 0.0,
    ];
    for (name, expected) in [("ball.to_world", ball), ("Cylinder.to_world", pipe)] {
        let found = scene.to_world(name).unwrap().matrix();
        for (a, b) in found.iter().flatten().zip(expected) {
            assert!((a - b).abs() < 1e-6, "{name}: {found:?}");
        }
    }
    for name in [
        "sensor.to_world",
        "eye.to_world",
        "PerspectiveCamera.to_world",
    ] {
        assert_eq!(scene.to_world(name).unwrap(), Transform::IDENTITY);
    }
    let names: Vec<String> = scene.matrices().into_iter().map(|(name, _)| name).collect();
    assert_eq!(
        names,
        ["ball.to_world", "shape1.to_world", "sensor.to_world"]
    );
}

/// What is no rotation, even scale and translation of the matrix in the file is refused by name, and changes nothing.
#[test]
fn matrices_that_nothing_of_ours_means_are_refused() {
    let mut scene = load(&file("cube", "", "", SENSOR, LIGHTS));
    let before = scene.params().clone();
    let own = scene.to_world("it.to_world").unwrap();
    let by = |first: &Transform| first.then(&own).to_f32().as_flattened().to_vec();
    let stretched = by(&Transform::scale([1.0, 1.0, 1.001]));
    let mirrored = by(&Transform::scale([1.0, -1.0, 1.0]));
    let flat = by(&Transform::scale([1.0, 1.0, 0.0]));
    let sheared = by(&Transform::from_linear(&[
        1.0, 0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0,
    ]));
    let mut projective = by(&Transform::IDENTITY);
    projective[14] = 0.5;
    let mut nothing = by(&Transform::IDENTITY);
    nothing[5] = f32::NAN;
    let few = vec![1.0; 15];
    let view = scene.to_world("sensor.to_world").unwrap();
    let larger = Transform::scale([2.0; 3])
        .then(&view)
        .to_f32()
        .as_flattened()
        .to_vec();
    for (name, matrix, words) in [
        ("it.to_world", &stretched, "scales axes unequally"),
        ("it.to_world", &mirrored, "mirrors"),
        ("it.to_world", &flat, "singular"),
        ("it.to_world", &sheared, "shears"),
        ("it.to_world", &projective, "0, 0, 0.5, 1"),
        ("it.to_world", &nothing, "`it.to_world`"),
        ("it.to_world", &few, "15"),
        ("sensor.to_world", &larger, "scale by 2"),
        ("its.to_world", &mirrored, " it.to_world"),
        ("bulb.to_world", &mirrored, "`bulb.position` moves"),
    ] {
        let error = scene.set([(name, &matrix[..])]).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(words), "{error}");
        assert_eq!(scene.params().values(), before.values());
    }
    // It has no derivative of its own, but what it means has.
    let error = scene
        .make_movable(&["it.to_world"])
        .unwrap_err()
        .to_string();
    for part in [
        "`it.to_world`",
        "`it.translation`",
        "`it.rotation`",
        "`it.scale`",
    ] {
        assert!(error.contains(part), "{error}");
    }
    // A scene from code has none; one that is turned by nothing but rounding gets no parameters.
    let made = self::scene(Sphere::new([0.0; 3], 1.0, false).unwrap().into());
    let error = made.to_world("it.to_world").unwrap_err().to_string();
    assert!(error.contains("not read from a file"), "{error}");
    let same = by(&Transform::IDENTITY);
    scene.set([("it.to_world", &same[..])]).unwrap();
    assert_eq!(scene.params().infos().len(), before.infos().len());
}

/// Names, once per shape; what has no name; and values that nothing can have.
#[test]
fn bad_requests_are_refused_by_name() {
    let mut scene = load(&file("sphere", "", "", SENSOR, LIGHTS));
    let names: Vec<String> = scene.movables().into_iter().map(|m| m.name).collect();
    let parts = ["translation", "rotation", "scale"];
    let mut expected: Vec<String> = (["it", "floor"].iter())
        .flat_map(|s| parts.iter().map(move |p| format!("{s}.{p}")))
        .collect();
    expected.extend(
        [
            "sensor.translation",
            "sensor.rotation",
            "sensor.fov",
            "bulb.position",
        ]
        .map(String::from),
    );
    assert_eq!(names, expected);
    let before = scene.params().values().len();
    let message = scene
        .make_movable(&["it.to_world"])
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("`it.to_world`") && message.contains("it.translation"),
        "{message}"
    );
    assert_eq!(scene.params().values().len(), before);
    scene
        .make_movable(&["it.scale", "it.translation", "it.scale", "sensor.fov"])
        .unwrap();
    assert_eq!(scene.params().values().len(), before + 5);

    let start = scene.params().values().to_vec();
    let mut refused = |name: &str, value: f32, words: &[&str]| {
        let mut values = start.clone();
        values[scene.params().find(name).unwrap().offset] = value;
        let message = scene.set_params(&values).unwrap_err().to_string();
        for word in words {
            assert!(message.contains(word), "{message}");
        }
        assert_eq!(scene.params().values(), start);
    };
    refused("it.scale", 0.0, &["`it.scale`[0]", "found 0"]);
    refused("it.scale", -1.0, &["`it.scale`[0]"]);
    refused("it.translation", f32::NAN, &["`it.translation`[0]", "NaN"]);
    refused("it.translation", 2e12, &["`it`", "1e12"]);
    refused("it.translation", 3e12, &["`it.translation`[0]"]);
    refused("sensor.fov", 180.0, &["`sensor.fov`[0]"]);

    // Estimators without terms for what moves say so.
    for &e in Estimator::ALL {
        if e.capabilities().sees(ParamKind::Position) {
            continue;
        }
        for name in ["it.translation", "sensor.fov"] {
            let message = e.active(&scene, &[name]).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
    }

    let mut flat = self::scene(Mesh::new(sheet(), false).unwrap().into());
    flat.make_movable(&["it.vertex_positions"]).unwrap();
    let range = flat.params().find("it.vertex_positions").unwrap().range();
    let mut values = flat.params().values().to_vec();
    values[range.clone()].fill(0.0);
    let message = flat.set_params(&values).unwrap_err().to_string();
    assert!(
        message.contains("`it`") && message.contains("area"),
        "{message}"
    );
    values[range.start + 7] = f32::NAN;
    let message = flat.set_params(&values).unwrap_err().to_string();
    assert!(message.contains("`it.vertex_positions`[7]"), "{message}");
}

/// Lobes and spots move, too, and say by what.
#[test]
fn lights_say_what_moves_them() {
    let mut build = Builder::new();
    let white = build.rgb("w", [1.0; 3], (0.0, 9.0)).unwrap();
    let spot = Spot::new(white, [1.0, 2.0, 3.0], [0.0, 0.0, -1.0], 10.0, 20.0).unwrap();
    assert_eq!(spot.mobility(), Some(("position", [1.0, 2.0, 3.0])));
    assert_eq!(spot.moved_by(), None);
}
