//! What moves, in scenes where nothing becomes visible or hidden: the interior term against differences and closed forms.

use std::f64::consts::PI;
use std::sync::Arc;

use ad_core::{Dual, Float, Vec3};
use render::bsdf::microfacet::Ndf;
use render::bsdf::{
    Conductor, Diffuse, Interpolation, Material, NormalMap, RoughConductor, Roughness, TwoSided,
};
use render::camera::{Camera, FovAxis};
use render::emitter::{Area, Envmap, Point, Spot, Vmf};
use render::estimator::{AllowBias, DetachedMis, Failure, Failures, Interior};
use render::film::PixelFilter;
use render::instances::{Estimator, render_f64};
use render::integrator::gradient::{Gradient, backward};
use render::integrator::render::render;
use render::math::Transform;
use render::params::{ParamKind, Tangent, Theta};
use render::sampler::Spread;
use render::scene::{Builder, Settings};
use render::shape::{AnyShape, Cube, Cylinder, Disk, Mesh, MeshData, Patch, Rectangle, Sphere};
use render::statistics::{Estimate, z_limit};
use render::{Film, Image, Job, Scene};

type Moving = AllowBias<Interior<DetachedMis>>;

/// Pixels per side.
const SIZE: u32 = 4;
const REPEATS: u64 = 12;

fn single(v: [f64; 3]) -> [f32; 3] {
    v.map(|x| x as f32)
}

/// Texels that wave, `[height][width][3]`, between `low` and `high`, for surfaces that close on themselves, too.
fn waves(size: [u32; 2], low: f64, high: f64) -> Vec<f32> {
    let [w, h] = size;
    let texel = |i: u32| {
        let (x, y, c) = (i / 3 % w, i / 3 / w, i % 3);
        let phase = 2.0 * PI * f64::from(x) / f64::from(w) + 1.3 * f64::from(y) + f64::from(c);
        (low + (high - low) * (0.5 + 0.5 * phase.sin())) as f32
    };
    (0..w * h * 3).map(texel).collect()
}

fn painted(build: &mut Builder, name: &str) -> Arc<Material> {
    let reflectance = build.texels(name, [8, 5], &waves([8, 5], 0.2, 0.8), (0.0, 1.0));
    let reflectance = reflectance.unwrap();
    let paint = Arc::new(Material::from(Diffuse { reflectance }));
    Arc::new(TwoSided::new([paint.clone(), paint]).unwrap().into())
}

fn metal(build: &mut Builder, alpha: f64) -> Arc<Material> {
    let specular_reflectance = build.rgb("metal", [0.9, 0.7, 0.5], (0.0, 1.0)).unwrap();
    let alpha = build.scalar("alpha", alpha, (0.01, 1.0)).unwrap();
    let roughness = Roughness {
        kind: Ndf::Ggx,
        alpha,
        visible: true,
    };
    Arc::new(Material::from(RoughConductor {
        roughness,
        conductor: Conductor {
            specular_reflectance,
            index: None,
        },
    }))
}

/// A camera that looks from `eye` to `target`.
fn finish(build: Builder, eye: [f64; 3], target: [f64; 3], fov: f64, depth: u32) -> Scene {
    let view = Transform::look_at(eye, target, [0.0, 1.0, 0.1]).unwrap();
    let camera = Camera::new(view, fov, FovAxis::Smaller, [SIZE, SIZE]).unwrap();
    let film = Film {
        filter: PixelFilter::Box,
        ..Film::new(SIZE, SIZE)
    };
    let settings = Settings {
        max_depth: depth,
        rr_depth: 100,
        ..Settings::default()
    };
    build.build(camera, film, settings).unwrap()
}

fn bulb(build: &mut Builder, at: [f64; 3]) {
    let intensity = build
        .rgb("bulb.intensity.value", [30.0, 20.0, 25.0], (0.0, 1e3))
        .unwrap();
    build.add_emitter(Point::new(intensity, single(at)), None);
}

fn spot(build: &mut Builder, at: [f64; 3], axis: [f64; 3]) {
    let intensity = build
        .rgb("spot.intensity.value", [40.0, 50.0, 30.0], (0.0, 1e3))
        .unwrap();
    let spot = Spot::new(intensity, at, axis, 5.0, 80.0).unwrap();
    build.add_emitter(spot, None);
}

fn sky(build: &mut Builder) {
    let (width, height) = (8, 5);
    let image = Image {
        width,
        height,
        data: waves([8, 5], 0.3, 1.5),
    };
    let to_world = Transform::rotate([1.0, 0.5, 0.2], 40.0).unwrap();
    let map = Envmap::new(build.registry(), "sky", &image, &to_world, 1.0).unwrap();
    build.add_emitter(map, None);
    let radiance = build
        .rgb("sun.radiance.value", [2.0, 1.5, 1.0], (0.0, 1e3))
        .unwrap();
    build.add_emitter(Vmf::new(radiance, [0.3, 0.5, 1.0], 4.0).unwrap(), None);
}

/// Makes a shape emit a pattern.
fn glow(build: &mut Builder, name: &str, shape: u32, exponent: f32) {
    let name = format!("{name}.radiance");
    let radiance = build
        .texels(&name, [8, 5], &waves([8, 5], 0.3, 1.2), (0.0, 1e3))
        .unwrap();
    let light = Area {
        radiance,
        exponent,
        shape,
    };
    build.add_emitter(light, Some(shape));
}

/// Faces around a ball of about this radius, seen from within, as flat triangles or with normals that follow.
fn ball(radius: f32) -> MeshData {
    let (rows, columns) = (7u32, 10u32);
    let mut mesh = MeshData::default();
    for i in 0..=rows {
        for j in 0..=columns {
            let theta = std::f32::consts::PI * i as f32 / rows as f32;
            let phi = 2.0 * std::f32::consts::PI * (j % columns) as f32 / columns as f32;
            let ring = if i == 0 || i == rows {
                0.0
            } else {
                theta.sin()
            };
            let p = [ring * phi.cos(), ring * phi.sin(), theta.cos()];
            mesh.positions.push(p.map(|x| radius * x));
            mesh.uvs
                .push([j as f32 / columns as f32, i as f32 / rows as f32]);
        }
    }
    for i in 0..rows {
        for j in 0..columns {
            let [a, b] = [i, i + 1].map(|i| i * (columns + 1) + j);
            if i > 0 {
                mesh.triangles.push([a, a + 1, b]);
            }
            if i + 1 < rows {
                mesh.triangles.push([a + 1, b + 1, b]);
            }
        }
    }
    mesh
}

/// One surface that fills the view, under points, a spot and a sky.
fn outside(
    shape: AnyShape,
    eye: [f64; 3],
    fov: f64,
    material: impl Fn(&mut Builder) -> Arc<Material>,
) -> Scene {
    let mut build = Builder::new();
    let material = material(&mut build);
    let material = build.add_shared_material(material);
    build.add_shape("it", shape, material);
    bulb(&mut build, [1.5, 2.0, 4.0]);
    spot(&mut build, [-2.0, 1.0, 5.0], [0.4, -0.2, -1.0]);
    sky(&mut build);
    finish(build, eye, [0.0; 3], fov, 2)
}

/// The inside of a convex shape whose walls glow and reflect, with a bulb.
fn inside(shape: AnyShape, target: [f64; 3], fov: f64, depth: u32, exponent: f32) -> Scene {
    let mut build = Builder::new();
    let walls = painted(&mut build, "walls");
    let walls = build.add_shared_material(walls);
    let room = build.add_shape("it", shape, walls);
    glow(&mut build, "it", room, exponent);
    bulb(&mut build, [0.3, -0.4, 0.5]);
    finish(build, [-0.4, 0.2, 0.3], target, fov, depth)
}

/// A plate in the middle of a glowing ball: a light that moves against what it lights.
fn plate() -> Scene {
    let mut build = Builder::new();
    let grey = painted(&mut build, "grey");
    let grey = build.add_shared_material(grey);
    let dark = build.rgb("dark", [0.0; 3], (0.0, 1.0)).unwrap();
    let dark = build.add_material(Diffuse { reflectance: dark });
    let patch = Patch::new([-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], false).unwrap();
    build.add_shape("plate", Rectangle(patch), grey);
    let ball = Sphere::new([0.3, 0.2, 0.1], 4.0, true).unwrap();
    let ball = build.add_shape("it", ball, dark);
    glow(&mut build, "it", ball, 2.0);
    finish(build, [0.1, 0.2, 1.5], [0.0; 3], 30.0, 2)
}

fn wide<P: Float>(scene: &Scene) -> Vec<P> {
    scene
        .params()
        .values()
        .iter()
        .map(|&v| P::from_f32(v))
        .collect()
}

/// Weights of pixels and channels that nothing cancels in.
fn weights() -> Vec<f32> {
    (0..SIZE * SIZE * 3)
        .map(|i| 1.0 + 0.5 * (1.7 * i as f32).sin())
        .collect()
}

fn weighed(image: &[f64]) -> f64 {
    let all = image.iter().zip(weights());
    all.map(|(x, w)| x * f64::from(w)).sum()
}

/// `<weights, image>`.
fn value(scene: &Scene, seed: u64, spp: u64) -> f64 {
    let values = wide::<f64>(scene);
    let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
    let found = render_f64(&job, &Theta::constant(&values), Estimator::Interior);
    assert_eq!(found.non_finite.count, 0);
    weighed(&found.sums[0]) / spp as f64
}

fn gradient<P: Float>(scene: &Scene, names: &[&str], seed: u64, spp: u64) -> Gradient {
    let values = wide::<P>(scene);
    let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
    let active = Estimator::Interior.active(scene, names).unwrap();
    let theta = Theta::constant(&values);
    let found = backward::<P, Moving, Spread>(&job, &theta, &active, &weights()).unwrap();
    assert_eq!(found.non_finite.count, 0);
    found
}

fn step(scene: &mut Scene, name: &str, along: &[f32], h: f32) {
    let mut values = scene.params().values().to_vec();
    let range = scene.params().find(name).unwrap().range();
    for (v, d) in values[range].iter_mut().zip(along) {
        *v += h * d;
    }
    scene.set_params(&values).unwrap();
}

/// Central differences at two steps with common random numbers, and their limit.
fn difference(scene: &mut Scene, name: &str, along: &[f32], h: f32, seed: u64, spp: u64) -> f64 {
    let start = scene.params().values().to_vec();
    let mut at = |h: f32| {
        step(scene, name, along, h);
        let found = value(scene, seed, spp);
        scene.set_params(&start).unwrap();
        found
    };
    let wide = (at(h) - at(-h)) / f64::from(2.0 * h);
    let narrow = (at(0.5 * h) - at(-0.5 * h)) / f64::from(h);
    (4.0 * narrow - wide) / 3.0
}

/// Directions to differentiate in: every component of what moves as a whole, a stretch and a wave of vertices.
fn directions(scene: &Scene, name: &str) -> Vec<Vec<f32>> {
    let info = scene.params().find(name).unwrap();
    let n = info.shape.len();
    if n <= 3 {
        let unit = |k: usize| (0..n).map(|i| if i == k { 1.0 } else { 0.0 }).collect();
        return (0..n).map(unit).collect();
    }
    let points = scene.params().values()[info.range()].as_chunks::<3>().0;
    let stretch = points.iter().flat_map(|p| [0.3 * p[1], 0.0, 0.2 * p[2]]);
    let wave = points.iter().flat_map(|p| {
        let by = 0.05 * (2.0 * p[0] + p[1]).sin();
        [by * p[0], by * p[1], by * p[2]]
    });
    vec![stretch.collect(), wave.collect()]
}

/// Compares all that may move with differences.
fn compare(what: &str, scene: Scene, spp: u64) {
    compare_at(what, scene, true, spp);
}

/// The same at rest, or somewhere else.
fn compare_at(what: &str, mut scene: Scene, elsewhere: bool, spp: u64) {
    let names: Vec<String> = scene.movables().into_iter().map(|m| m.name).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    scene.make_movable(&names).unwrap();
    if elsewhere {
        step(&mut scene, "it.rotation", &[0.1, -0.05, 0.2], 1.0);
        step(&mut scene, "it.scale", &[0.125], 1.0);
    }
    let seeds = |part: u64| (0..REPEATS).map(move |i| 100 * part + i);
    let gradients: Vec<Gradient> = seeds(1)
        .map(|s| gradient::<f64>(&scene, &names, s, spp))
        .collect();
    // Some 250 comparisons in all tests, with a significance of 1 % over all of them.
    let limit = z_limit(250, REPEATS, 0.01);
    let mut failures = Vec::new();
    for (r, name) in names.iter().enumerate() {
        let h = match *name {
            "sensor.fov" => 0.5,
            n if n.ends_with("vertex_positions") => 1.0 / 8.0,
            _ => 1.0 / 64.0,
        };
        for along in directions(&scene, name) {
            let dot = |g: &Gradient| -> f64 {
                g.values[r]
                    .iter()
                    .zip(&along)
                    .map(|(g, d)| g * f64::from(*d))
                    .sum()
            };
            let found = Estimate::of(&gradients.iter().map(dot).collect::<Vec<_>>());
            let differences = seeds(2).map(|s| difference(&mut scene, name, &along, h, s, spp));
            let expected = Estimate::of(&differences.collect::<Vec<_>>());
            let z = found.z(&expected);
            println!(
                "{what} {name} {:?}: {:.5} +- {:.5}, {:.5} +- {:.5}: {z:.2}",
                &along[..along.len().min(3)],
                found.mean,
                found.se,
                expected.mean,
                expected.se
            );
            // Rounding of positions to single precision, seen through the step.
            let rounding = 1e-6 * (expected.mean.abs() + 10.0);
            if z.is_nan() || (z.abs() > limit && (found.mean - expected.mean).abs() > rounding) {
                failures.push(format!("{name}: {found:?} {expected:?} {z}"));
            }
        }
    }
    assert!(failures.is_empty(), "{what}, limit {limit}: {failures:#?}");
}

fn plane() -> Patch {
    Patch::new(
        [-8.0, -7.0, 0.5],
        [16.0, 0.5, -0.5],
        [0.2, 15.0, 0.3],
        false,
    )
    .unwrap()
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn a_plane_moves_as_differences_say() {
    let scene = outside(Rectangle(plane()).into(), [0.5, 0.3, 4.0], 25.0, |b| {
        painted(b, "it")
    });
    compare("plane", scene, 512);
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn rough_metal_moves_as_differences_say() {
    let scene = outside(Rectangle(plane()).into(), [0.5, 0.3, 4.0], 25.0, |b| {
        metal(b, 0.4)
    });
    compare("metal", scene, 1024);
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn mapped_normals_move_as_differences_say() {
    // Under a sky, the horizon of a tilted normal would be a boundary (F9).
    let mut build = Builder::new();
    let mut normals = waves([8, 5], 0.4, 0.6);
    normals.iter_mut().skip(2).step_by(3).for_each(|z| *z = 1.0);
    let map = build
        .texels("normals", [8, 5], &normals, (0.0, 1.0))
        .unwrap();
    let metal = metal(&mut build, 0.5);
    let map = NormalMap::new(map, Interpolation::Normals, metal).unwrap();
    let map = build.add_material(map);
    build.add_shape("it", Rectangle(plane()), map);
    bulb(&mut build, [1.5, 2.0, 4.0]);
    spot(&mut build, [-2.0, 1.0, 5.0], [0.4, -0.2, -1.0]);
    let scene = finish(build, [0.5, 0.3, 4.0], [0.0; 3], 25.0, 2);
    compare("mapped normals", scene, 512);
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn round_shapes_move_as_differences_say() {
    let shapes: [(&str, AnyShape); 3] = [
        (
            "sphere",
            Sphere::new([0.0, 0.0, -2.0], 2.0, false).unwrap().into(),
        ),
        (
            "disk",
            Disk::new(&Transform::scale([9.0, 8.0, 1.0]), false)
                .unwrap()
                .into(),
        ),
        (
            "cylinder",
            Cylinder::new([-9.0, 0.2, -2.0], [8.0, 0.0, -2.1], 2.0, false)
                .unwrap()
                .into(),
        ),
    ];
    for (name, shape) in shapes {
        let scene = outside(shape, [0.5, 0.4, 3.0], 12.0, |b| painted(b, "it"));
        compare(name, scene, 256);
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn rooms_move_as_differences_say_through_five_edges() {
    let cube = Transform::sequence([
        Transform::scale([1.5, 1.2, 1.3]),
        Transform::rotate([1.0, 2.0, 3.0], 20.0).unwrap(),
    ]);
    let cube = Cube::new(&cube, true).unwrap();
    let sphere = Sphere::new([0.1, 0.0, -0.2], 1.5, true).unwrap();
    compare(
        "sphere room",
        inside(sphere.into(), [1.0, 0.5, -0.2], 40.0, 5, 0.0),
        256,
    );
    // One wall in view: what moves on the film behind an edge is no business of the interior.
    compare(
        "cube room",
        inside(cube.into(), [1.0, 0.1, -0.1], 12.0, 5, 0.0),
        256,
    );
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn meshes_move_as_differences_say() {
    // The middle of one triangle in view: where a film point slides towards a concave crease, the light of its other side
    // has derivatives of any size, and few samples say all.
    let mesh = ball(1.6);
    let corners = mesh.triangles[50].map(|i| Vec3::from(mesh.positions[i as usize]));
    let middle = (corners[0] + corners[1] + corners[2]) * (1.0 / 3.0);
    let middle = middle.to_array().map(f64::from);
    let smooth = Mesh::smoothed(ball(1.6), false).unwrap();
    let scene = inside(smooth.into(), middle, 5.0, 5, 0.0);
    compare_at("smooth mesh", scene, false, 256);
    let flat = Mesh::new(mesh, false).unwrap();
    compare_at(
        "flat mesh",
        inside(flat.into(), middle, 5.0, 3, 1.0),
        false,
        256,
    );
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn lamps_move_against_what_they_light() {
    compare("plate", plate(), 512);
}

/// A scene in which everything moves alike changes nothing: exactly, path by path.
#[test]
fn what_moves_as_a_whole_changes_nothing() {
    let flat = Mesh::new(ball(1.6), false).unwrap();
    let rooms: [AnyShape; 3] = [
        Sphere::new([0.1, 0.0, -0.2], 1.5, true).unwrap().into(),
        Cube::new(&Transform::scale([1.5, 1.2, 1.3]), true)
            .unwrap()
            .into(),
        flat.into(),
    ];
    for room in rooms {
        let mut scene = inside(room, [1.0, 0.5, -0.2], 60.0, 5, 3.0);
        let names = [
            "it.translation",
            "it.rotation",
            "sensor.translation",
            "sensor.rotation",
            "bulb.position",
        ];
        scene.make_movable(&names).unwrap();
        let c = Vec3::from(render::shape::Shape::centroid(&scene.shapes()[0]));
        let g = gradient::<f64>(&scene, &names, 5, 64).values;
        let [room, turn, eye, look, light] =
            [0, 1, 2, 3, 4].map(|i: usize| Vec3::new(g[i][0], g[i][1], g[i][2]));
        let size = room.length() + eye.length() + light.length();
        let moved = room + eye + light;
        assert!(moved.length() < 1e-9 * size, "{moved:?} of {size}");
        let from = |at: [f64; 3], d: Vec3<f64>| (Vec3::from(at) - c).cross(d);
        let bulb: Vec3<f64> = Vec3::new(f64::from(0.3f32), f64::from(-0.4f32), 0.5);
        let turned = turn + look + from(scene.camera.origin(), eye) + from(bulb.to_array(), light);
        assert!(turned.length() < 1e-9 * size, "{turned:?} of {size}");
        assert!(size > 1e-3);
    }
}

/// Forward mode is the same linear map, in double precision to 1e-9; single precision agrees with it to its rounding.
#[test]
fn modes_and_precisions_agree() {
    let smooth = Mesh::smoothed(ball(1.6), false).unwrap();
    for mut scene in [
        inside(smooth.into(), [1.0, 0.4, -0.2], 30.0, 5, 2.0),
        plate(),
    ] {
        let names: Vec<String> = scene.movables().into_iter().map(|m| m.name).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        scene.make_movable(&names).unwrap();
        let reverse = gradient::<f64>(&scene, &names, 7, 64).values;
        let single = gradient::<f32>(&scene, &names, 7, 64).values;
        let values = wide::<f64>(&scene);
        let job = Job::new(&scene, &scene.settings, 7, 0..64, &());
        for (r, name) in names.iter().enumerate() {
            let info = scene.params().find(name).unwrap();
            let along: Vec<f64> = (0..info.shape.len())
                .map(|i| (1.0 + i as f64).cos())
                .collect();
            let mut tangents = vec![Tangent::None; scene.params().infos().len()];
            let own = along
                .iter()
                .map(|&d| Dual::<f64, 1>::new(0.0, [d]))
                .collect();
            tangents[scene.params().handle(info).id as usize] = Tangent::Dense(own);
            let theta = Theta::with_tangents(&values, &tangents);
            let forward = render::<Dual<f64, 1>, Moving, Spread>(&job, &theta).unwrap();
            let forward = weighed(&forward.sums[1]) / 64.0;
            let dot = |g: &[f64]| g.iter().zip(&along).map(|(g, d)| g * d).sum::<f64>();
            let size: f64 = reverse[r].iter().map(|g| g.abs()).sum();
            let (double, single) = (dot(&reverse[r]), dot(&single[r]));
            assert!(
                (forward - double).abs() < 1e-9 * size,
                "{name}: {forward} {double}"
            );
            assert!(
                (single - double).abs() < 3e-3 * size,
                "{name}: {single} {double}"
            );
            assert!(size > 0.0, "{name}");
        }
    }
}

/// Gradients have the same bits for any number of threads, thousands of vertices among them.
#[test]
fn threads_do_not_matter() {
    let smooth = Mesh::smoothed(ball(1.6), false).unwrap();
    let mut scene = inside(smooth.into(), [1.0, 0.4, -0.2], 30.0, 4, 0.0);
    let names = [
        "it.translation",
        "it.vertex_positions",
        "sensor.fov",
        "it.radiance.data",
    ];
    scene.make_movable(&names).unwrap();
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| gradient::<f32>(&scene, &names, 3, 32).values)
    };
    let one = with(1);
    assert_eq!(one, with(3));
    assert!(one.iter().all(|g| g.iter().any(|&d| d != 0.0)));
    // What is asked for together adds up: each is what it is alone.
    let alone = |name| gradient::<f32>(&scene, &[name], 3, 32).values.remove(0);
    assert_eq!(one[3], alone("it.radiance.data"));
    assert_eq!(one[2], alone("sensor.fov"));
}

/// A bulb straight over a white plane: the radiance is `I / (pi h^2)`.
#[test]
fn a_bulb_over_a_plane_is_known() {
    let mut build = Builder::new();
    let white = build.rgb("white", [0.8; 3], (0.0, 1.0)).unwrap();
    let white = build.add_material(Diffuse { reflectance: white });
    let patch = Patch::new([-9.0, -9.0, 0.0], [18.0, 0.0, 0.0], [0.0, 18.0, 0.0], false).unwrap();
    build.add_shape("it", Rectangle(patch), white);
    let intensity = build
        .rgb("bulb.intensity.value", [7.0; 3], (0.0, 1e3))
        .unwrap();
    build.add_emitter(Point::new(intensity, [0.0, 0.0, 2.0]), None);
    let mut scene = finish(build, [0.0, 0.0, 5.0], [0.0; 3], 0.001, 2);
    scene
        .make_movable(&[
            "bulb.position",
            "it.translation",
            "it.scale",
            "sensor.translation",
        ])
        .unwrap();
    let names = [
        "bulb.position",
        "it.translation",
        "it.scale",
        "sensor.translation",
    ];
    let g = gradient::<f64>(&scene, &names, 1, 4).values;
    let total: f64 = weights().iter().map(|&w| f64::from(w)).sum();
    let slope = -2.0 * 0.8 * 7.0 / (PI * 8.0) * total;
    let near = |found: f64, expected: f64| {
        assert!(
            (found - expected).abs() < 1e-4 * slope.abs(),
            "{found} {expected}"
        );
    };
    near(g[0][2], slope);
    near(g[1][2], -slope);
    (0..2).for_each(|k| near(g[0][k], 0.0));
    near(g[2][0], 0.0);
    (0..3).for_each(|k| near(g[3][k], 0.0));
}

/// The interior of a bright plate on black is nothing: all of its derivative is at its outline, which is what `interior`
/// leaves out.
#[test]
fn outlines_are_left_out() {
    let mut build = Builder::new();
    let dark = build.rgb("dark", [0.0; 3], (0.0, 1.0)).unwrap();
    let dark = build.add_material(Diffuse { reflectance: dark });
    let patch = Patch::new([-0.5, -0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], false).unwrap();
    let shape = build.add_shape("it", Rectangle(patch), dark);
    let radiance = build
        .rgb("it.radiance.value", [1.0; 3], (0.0, 9.0))
        .unwrap();
    let light = Area {
        radiance,
        exponent: 0.0,
        shape,
    };
    build.add_emitter(light, Some(shape));
    let mut scene = finish(build, [0.0, 0.0, 3.0], [0.0; 3], 30.0, 2);
    let names = ["it.translation", "it.scale", "sensor.rotation"];
    scene.make_movable(&names).unwrap();
    let g = gradient::<f64>(&scene, &names, 1, 64).values;
    assert!(g.iter().flatten().all(|&d| d == 0.0), "{g:?}");
    let c = Estimator::Interior.capabilities();
    assert!(c.study && c.sees(ParamKind::Position) && !c.failures.is_empty());
}

/// A bulb in a white ball lights all of its inside equally from the second bounce on, wherever it hangs: a ball that moves
/// changes its direct light only. Rays that stay where they are change the rest, too, if they are followed by another (F44):
/// with two bounces, by rho times the mean of the direct irradiance less that at the point that is seen, over the radius.
#[test]
fn a_bulb_in_a_ball() {
    const RHO: f64 = 0.8;
    let scene_of = |depth| {
        let mut build = Builder::new();
        let reflectance = build.rgb("white", [RHO; 3], (0.0, 1.0)).unwrap();
        let white = build.add_material(Diffuse { reflectance });
        let inside = Sphere::new([0.0; 3], 1.0, true).unwrap();
        build.add_shape("ball", inside, white);
        bulb(&mut build, [-0.5, 0.0, 0.0]);
        let mut scene = finish(build, [0.0; 3], [1.0, 0.0, 0.0], 1e-3, depth);
        scene.make_movable(&["ball.translation"]).unwrap();
        scene
    };
    let adjoint = [1.0; 3 * (SIZE * SIZE) as usize];
    // Means and standard errors of the derivative of one pixel, over all channels.
    let slope = |scene: &Scene, e: Estimator| {
        let active = e.active(scene, &["ball.translation"]).unwrap();
        let values = wide::<f32>(scene);
        let theta = Theta::constant(&values);
        let of = |seed| {
            let job = Job::new(scene, &scene.settings, seed, 0..512, &());
            let g = e.backward_f32(&job, &theta, &active, &adjoint).unwrap();
            g.values[0][0] / f64::from(SIZE * SIZE)
        };
        Estimate::of(&(0..REPEATS).map(of).collect::<Vec<_>>())
    };
    let limit = z_limit(6, REPEATS, 1e-3);
    // All channels of the bulb, at one and a half of the radius from the point that is seen.
    let unit = RHO / PI * 75.0;
    let truth = -2.0 * unit / 1.5f64.powi(3);
    let lost = RHO * unit * (1.0 - 1.5f64.powi(-2));
    for depth in [2, 3, 6] {
        let scene = scene_of(depth);
        let z = |e, expected: f64| {
            let found = slope(&scene, e);
            assert!(found.se < 0.15 * lost, "{found:?}");
            (found.mean - expected) / found.se.max(1e-5 * truth.abs())
        };
        let right = z(Estimator::Interior, truth);
        assert!(right.abs() < limit, "{depth}: {right}");
        match depth {
            2 => assert!(z(Estimator::BiasedRays, truth).abs() < limit),
            3 => assert!(z(Estimator::BiasedRays, truth + lost).abs() < limit),
            _ => assert!(z(Estimator::BiasedRays, truth).abs() > limit),
        }
    }
    let failures = Estimator::BiasedRays.capabilities().failures;
    assert_eq!(failures, Failures::of(&[Failure::RaysAtRest]));
}

/// Mirrors and textures that jump are refused by name, where they matter.
#[test]
fn deltas_and_jumps_are_refused_by_name() {
    let mut build = Builder::new();
    let specular_reflectance = build.rgb("silver", [0.9; 3], (0.0, 1.0)).unwrap();
    let mirror = build.add_material(Conductor {
        specular_reflectance,
        index: None,
    });
    build.add_shape("glass wall", Rectangle(plane()), mirror);
    bulb(&mut build, [0.0, 0.0, 2.0]);
    let mut scene = finish(build, [0.0, 0.0, 5.0], [0.0; 3], 30.0, 2);
    let names = ["bulb.position", "sensor.fov"];
    scene.make_movable(&names).unwrap();
    for name in names {
        let message = Estimator::Interior
            .active(&scene, &[name])
            .unwrap_err()
            .to_string();
        assert!(
            message.contains(name) && message.contains("`glass wall`"),
            "{message}"
        );
    }
    assert!(Estimator::Interior.active(&scene, &["silver"]).is_ok());
    // A gradient by somebody who has no terms for it.
    let mut scene = plate();
    scene.make_movable(&["plate.scale"]).unwrap();
    let active = Estimator::Interior
        .active(&scene, &["plate.scale"])
        .unwrap();
    let job = Job::new(&scene, &scene.settings, 1, 0..1, &());
    let values = wide::<f32>(&scene);
    let theta = Theta::constant(&values);
    let refused = Estimator::Mis.backward_f32(&job, &theta, &active, &weights());
    assert!(refused.unwrap_err().to_string().contains("`plate.scale`"));
}

/// What has no terms is refused by name, with what is in the way: brushed metal whose axes jump on smooth faces, lamps that send
/// beams, shapes that cross each other where directions follow closed forms, and images in light that jump.
#[test]
fn what_has_no_terms_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let mut mesh = String::new();
    for v in ["1 0 0", "-1 0 0", "0 1 0", "0 -1 0", "0 0 1", "0 0 -1"] {
        mesh += &format!("v {v}\nvn {v}\n");
    }
    for [a, b, c] in [
        [1, 3, 5],
        [3, 2, 5],
        [2, 4, 5],
        [4, 1, 5],
        [3, 1, 6],
        [2, 3, 6],
        [4, 2, 6],
        [1, 4, 6],
    ] {
        mesh += &format!("f {a}//{a} {b}//{b} {c}//{c}\n");
    }
    std::fs::write(folder.path().join("it.obj"), mesh).unwrap();
    let brushed = r#"<shape type="obj" id="it"><string name="filename" value="it.obj"/><bsdf type="roughconductor">
        <float name="alpha_u" value="0.1"/><float name="alpha_v" value="0.4"/></bsdf></shape>"#;
    let cube = r#"<shape type="cube" id="it"/>"#;
    let beam = r#"<shape type="rectangle" id="it"><emitter type="directionalarea"/></shape>"#;
    let other = r#"<shape type="cube" id="other"><transform name="to_world"><rotate x="1" y="2" angle="30"/>
        <translate x="1"/></transform></shape>"#;
    let slide = r#"<emitter type="projector"><transform name="to_world"><lookat origin="0, 0, 9" target="0, 0, 0"
        up="0, 1, 0"/></transform><float name="fov" value="40"/><texture name="irradiance" type="checkerboard"/></emitter>
        <shape type="rectangle"><transform name="to_world"><translate z="-3"/></transform></shape>"#;
    let sky = r#"<emitter type="constant"/>"#;
    for (e, body, culprit) in [
        (
            Estimator::Edges,
            [brushed, sky],
            "`it` has a brushed material or mapped normals, and smooth normals that cross the plane",
        ),
        (Estimator::Edges, [beam, ""], "`it` sends a beam"),
        (
            Estimator::ReparameterisedExact,
            [cube, other],
            "`it` and `other` cross each other along a line that directions do not follow",
        ),
        (
            Estimator::Edges,
            [cube, slide],
            "colours an image that jumps where things slide through its light",
        ),
    ] {
        let text = format!(
            r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="2"/></integrator>
            <sensor type="perspective"><transform name="to_world"><lookat origin="0, 1, 8" target="0, 0, 0" up="0, 1, 0"/>
            </transform><film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/>
            <rfilter type="box"/></film></sensor>{}{}</scene>"#,
            body[0], body[1],
        );
        let (mut scene, _) = Scene::from_xml(&text, folder.path(), &Default::default())
            .unwrap_or_else(|e| panic!("{e}"));
        scene.make_movable(&["it.translation"]).unwrap();
        let values = wide::<f32>(&scene);
        let job = Job::new(&scene, &scene.settings, 1, 0..1, &());
        let refused = e.active(&scene, &["it.translation"]).and_then(|active| {
            e.backward_f32(&job, &Theta::constant(&values), &active, &weights())
        });
        let message = refused.expect_err("refused").to_string();
        assert!(
            message.contains("`it.translation`") && message.contains(culprit),
            "{message}"
        );
    }
}
