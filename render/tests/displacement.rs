//! Meshes displaced by a texture: where their points are, and how they move with the texels.

use ad_core::{Dual, Vec2, Vec3};
use render::bsdf::Diffuse;
use render::camera::{Camera, FovAxis};
use render::emitter::Constant;
use render::math::Transform;
use render::params::{ParamKind, Tangent, Theta};
use render::sampler::{Independent, Sampler};
use render::scene::{Builder, LoadOptions, Settings};
use render::shape::{AnyShape, HEIGHTS, Mesh, MeshData, Shape, SurfaceAdjoint, SurfaceCoordinates};
use render::{Film, Scene};

use crate::common::Gradient;

type D1 = Dual<f64, 1>;

const NAME: &str = "it.displacement.data";

/// A ball of latitudes and longitudes with a seam of texture coordinates, and several vertices at its poles.
fn ball(around: u32, up: u32) -> MeshData {
    let mut mesh = MeshData::default();
    for j in 0..=up {
        for i in 0..=around {
            let [u, v] = [i as f32 / around as f32, j as f32 / up as f32];
            // The same bits at both ends.
            let turn = std::f32::consts::TAU * (i % around) as f32 / around as f32;
            let (s, c) = if j == 0 || j == up {
                (0.0, [-1.0, 1.0][(j / up) as usize])
            } else {
                let tilt = std::f32::consts::PI * v;
                (tilt.sin(), -tilt.cos())
            };
            mesh.positions.push([s * turn.cos(), c, -s * turn.sin()]);
            mesh.uvs.push([u, v]);
        }
    }
    let row = around + 1;
    for j in 0..up {
        for i in 0..around {
            let a = j * row + i;
            if j > 0 {
                mesh.triangles.push([a, a + 1, a + row + 1]);
            }
            if j + 1 < up {
                mesh.triangles.push([a, a + row + 1, a + row]);
            }
        }
    }
    mesh
}

/// The ball, displaced by texels, under a sky.
fn scene(mesh: Mesh, size: [u32; 2], texels: &[f32]) -> Scene {
    let mut build = Builder::new();
    let heights = build
        .texels::<1>("it.displacement", size, texels, HEIGHTS)
        .expect("texels");
    let mesh = mesh.displaced(&heights, build.params()).expect("a mesh");
    let reflectance = build.rgb("wood", [0.5; 3], (0.0, 1.0)).expect("a colour");
    let wood = build.add_material(Diffuse { reflectance });
    build.add_shape("it", mesh, wood);
    let radiance = build.rgb("sky", [1.0; 3], (0.0, 9.0)).expect("a colour");
    build.add_emitter(Constant { radiance }, None);
    let view = Transform::look_at([0.5, 0.75, 6.0], [0.0; 3], [0.0, 1.0, 0.0]).expect("a view");
    let camera = Camera::new(view, 30.0, FovAxis::Smaller, [16, 16]).expect("a camera");
    let scene = build.build(camera, Film::new(16, 16), Settings::default());
    scene.expect("a scene")
}

fn waves(n: usize) -> Vec<f32> {
    (0..n).map(|i| 0.1 * (i as f32 * 1.7).sin()).collect()
}

fn smooth() -> Mesh {
    Mesh::smoothed(ball(12, 8), false).expect("a mesh")
}

fn mesh_of(scene: &Scene) -> &Mesh {
    match &scene.shapes()[0] {
        AnyShape::Mesh(mesh) => mesh,
        _ => panic!("a mesh"),
    }
}

/// A height everywhere makes a ball of another radius, up to the tilt of its discrete normals; its sign is that of the side
/// that the surface shows.
#[test]
fn a_ball_grows() {
    let radius = |flip: bool| {
        let mesh = Mesh::smoothed(ball(48, 32), flip).expect("a mesh");
        let scene = scene(mesh, [4, 2], &[0.25; 8]);
        let lengths = mesh_of(&scene)
            .data()
            .positions
            .iter()
            .map(|p| Vec3::from(*p).length());
        lengths.fold((f32::MAX, 0.0f32), |(a, b), x| (a.min(x), b.max(x)))
    };
    let (least, most) = radius(false);
    assert!(least > 1.248 && most < 1.2501, "{least} {most}");
    let (least, most) = radius(true);
    assert!(least > 0.7499 && most < 0.752, "{least} {most}");
}

/// Vertices that are one point stay one, along the seam and at the poles, whatever the texels are; normals follow.
#[test]
fn seams_do_not_tear() {
    let scene = scene(smooth(), [5, 7], &waves(35));
    let (mesh, rest) = (mesh_of(&scene), ball(12, 8));
    let mut same = 0;
    for (i, a) in rest.positions.iter().enumerate() {
        for (j, b) in rest.positions[..i].iter().enumerate() {
            if a == b {
                same += 1;
                assert_eq!(
                    mesh.data().positions[i],
                    mesh.data().positions[j],
                    "{i} {j}"
                );
            }
        }
    }
    assert!(same > 100, "{same}");
    let normals = render::shape::smooth_normals(&mesh.data().positions, &mesh.data().triangles);
    assert_eq!(mesh.data().normals, normals);
    assert_eq!(
        scene.params().find(NAME).expect("known").kind,
        ParamKind::Position
    );
    let points = scene
        .movables()
        .iter()
        .any(|m| m.name == "it.vertex_positions");
    assert!(!points, "its texels are its parameters");
    assert!(mesh.folded().is_empty());
}

fn tangents(scene: &Scene, at: usize) -> Vec<Tangent<D1>> {
    let mut all = vec![Tangent::None; scene.params().infos().len()];
    let info = scene.params().find(NAME).expect("known");
    let mut own = vec![Dual::new(0.0, [0.0]); info.shape.len()];
    own[at].eps[0] = 1.0;
    all[scene.params().handle(info).id as usize] = Tangent::Dense(own);
    all
}

fn all_values(scene: &Scene) -> Vec<f64> {
    scene.params().values().iter().map(|&v| v.into()).collect()
}

/// Points, normals and areas against differences of displaced scenes, and adjoints as the transpose, also where the mesh
/// has turned and grown as a whole, smooth and flat.
#[test]
fn points_move_with_texels() {
    let flat = Mesh::new(ball(12, 8), true).expect("a mesh");
    let (mut tested, mut met) = (0, 0);
    for (what, mesh) in [("smooth", smooth()), ("flat", flat)] {
        let mut start = scene(mesh, [5, 4], &waves(20));
        start
            .make_movable(&["it.rotation", "it.scale"])
            .expect("known");
        start
            .set([
                ("it.rotation", &[0.5, -0.25, 0.125][..]),
                ("it.scale", &[1.25]),
            ])
            .expect("valid");
        let values = all_values(&start);
        let still = Theta::<f64>::constant(&values);
        let mut s = Independent::new(3, 0, 0);
        for _ in 0..24 {
            let ray = start.camera.ray(
                4.0 + 8.0 * s.next_1d::<f64>(),
                4.0 + 8.0 * s.next_1d::<f64>(),
            );
            let Some(hit) = start.intersect(&ray) else {
                continue;
            };
            met += 1;
            let at = start.coordinates(hit.prim, &hit.si);
            let mut next =
                || Vec3::new(s.next_1d(), s.next_1d(), s.next_1d()) - Vec3::new(0.5, 0.5, 0.5);
            let mut d = SurfaceAdjoint::zero();
            (d.p, d.n_geo, d.frame.n) = (next(), next(), next());
            let d_log_area = next().x;
            let mut reverse = Gradient(vec![0.0; values.len()]);
            start.scatter_point(&still, hit.prim, &hit.si, &d, d_log_area, &mut reverse);
            let offset = start.params().find(NAME).expect("known").offset;
            for texel in 0..20 {
                let all = tangents(&start, texel);
                let theta = Theta::with_tangents(&values, &all);
                let found = start.point_at(&theta, hit.prim, SurfaceCoordinates::lift(at));
                let area = start.area_element(&theta, hit.prim);
                let along = d.of(&found).eps[0] + d_log_area * area.eps[0] / area.re;
                let error = (along - reverse.0[offset + texel]).abs();
                assert!(
                    error < 1e-9 * (1.0 + along.abs()),
                    "{what} {texel}: {along}"
                );
                if along == 0.0 {
                    continue;
                }
                let mut far = |h: f32| {
                    let mut values = start.params().values().to_vec();
                    values[offset + texel] += h;
                    start.set_params(&values).expect("valid");
                    let si = start.point_at::<f64>(&Theta::still(), hit.prim, at);
                    let area = start.area_element::<f64>(&Theta::still(), hit.prim);
                    values[offset + texel] -= h;
                    start.set_params(&values).expect("valid");
                    let n = si.frame.n;
                    [si.p.x, si.p.y, si.p.z, n.x, n.y, n.z, area]
                };
                let h = 1.0 / 64.0;
                let all = [h, -h, h / 2.0, -h / 2.0].map(&mut far);
                let (p, n) = (found.p, found.frame.n);
                for (i, x) in [p.x, p.y, p.z, n.x, n.y, n.z, area].into_iter().enumerate() {
                    let [a, b, c, e] = [0, 1, 2, 3].map(|k: usize| all[k][i]);
                    let h = f64::from(h);
                    let expected = (4.0 * (c - e) / h - (a - b) / (2.0 * h)) / 3.0;
                    let error = (x.eps[0] - expected).abs();
                    assert!(
                        error < 1e-3 * (1.0 + expected.abs()),
                        "{what} {texel} {i}: {} {expected}",
                        x.eps[0]
                    );
                    tested += 1;
                }
            }
        }
    }
    assert!(met > 20 && tested > 300, "{met} {tested}");
}

/// What is kept of normals belongs to where the mesh is, and not to where it was.
#[test]
fn adjoints_of_normals_follow() {
    const PRIM: u32 = 40;
    let at = SurfaceCoordinates(Vec2::new(0.3, 0.25));
    let mut scene = scene(smooth(), [5, 4], &waves(20));
    let mut all = Vec::new();
    for grown in [1.0, -2.0] {
        let texels: Vec<f32> = waves(20).iter().map(|x| grown * x).collect();
        scene.set([(NAME, &texels[..])]).expect("valid");
        let values = all_values(&scene);
        let still = Theta::<f64>::constant(&values);
        let si = scene.point_at::<f64>(&Theta::still(), PRIM, at);
        let mut d = SurfaceAdjoint::zero();
        d.frame.n = Vec3::new(0.3, -0.5, 0.2);
        let mut reverse = Gradient(vec![0.0; values.len()]);
        scene.scatter_point(&still, PRIM, &si, &d, 0.0, &mut reverse);
        let offset = scene.params().find(NAME).expect("known").offset;
        let found = reverse.0[offset..offset + 20].to_vec();
        for (texel, reverse) in found.iter().enumerate() {
            let tangents = tangents(&scene, texel);
            let theta = Theta::with_tangents(&values, &tangents);
            let moved = scene.point_at(&theta, PRIM, SurfaceCoordinates::lift(at));
            let along = d.of(&moved).eps[0];
            assert!(
                (along - reverse).abs() < 1e-12,
                "{grown} {texel}: {along} {reverse}"
            );
        }
        all.push(found);
    }
    let change = all[0].iter().zip(&all[1]).map(|(a, b)| (a - b).abs());
    assert!(change.fold(0.0, f64::max) > 1e-2);
}

/// Triangles that are turned over are counted, and others are not, however sharp the mesh is.
#[test]
fn folds_are_found() {
    let n = 6u32;
    let mut sheet = MeshData::default();
    for i in 0..n * n {
        sheet.positions.push([(i % n) as f32, (i / n) as f32, 0.0]);
    }
    for j in 0..n - 1 {
        for i in 0..n - 1 {
            let a = j * n + i;
            sheet
                .triangles
                .extend([[a, a + 1, a + n + 1], [a, a + n + 1, a + n]]);
        }
    }
    let folded = |sheet: &MeshData| Mesh::new(sheet.clone(), false).expect("a mesh").folded();
    assert!(folded(&sheet).is_empty());
    // Pulled over its neighbour.
    sheet.positions[(2 * n + 2) as usize] = [3.5, 2.2, 0.0];
    let found = folded(&sheet);
    assert!((1..=3).contains(&found.len()), "{found:?}");
    assert!(folded(&ball(3, 2)).is_empty());
}

/// Scene files ask for it by a nested texture; what it needs is said.
#[test]
fn scene_files_displace() {
    let dir = tempfile::tempdir().expect("a folder");
    let mesh = Mesh::smoothed(ball(12, 8), false).expect("a mesh");
    std::fs::write(dir.path().join("ball.ply"), mesh.to_ply()).expect("a file");
    std::fs::write(
        dir.path().join("bare.obj"),
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    )
    .expect("a file");
    let pixels = render::image_io::Pixels {
        width: 5,
        height: 4,
        channels: 3,
        data: waves(20).into_iter().flat_map(|x| [x; 3]).collect(),
    };
    render::image_io::write_exr_pixels(&dir.path().join("d.exr"), &pixels).expect("an image");
    let load = |shape: &str| {
        let text = format!(
            r#"<scene version="3.0.0"><sensor type="perspective"/><shape {shape}
            <texture type="bitmap" name="displacement"><string name="filename" value="d.exr"/></texture></shape></scene>"#
        );
        Scene::from_xml(&text, dir.path(), &LoadOptions::default())
    };
    let (loaded, warnings) =
        load(r#"type="ply" id="it"><string name="filename" value="ball.ply"/>"#).expect("a scene");
    assert!(warnings.is_empty(), "{warnings:?}");
    let expected = scene(mesh, [5, 4], &waves(20));
    let (a, b) = (mesh_of(&loaded).data(), mesh_of(&expected).data());
    for (a, b) in a.positions.iter().zip(&b.positions) {
        assert!((Vec3::from(*a) - Vec3::from(*b)).length() < 1e-6);
    }
    assert_eq!(loaded.params().get(NAME).expect("known").len(), 20);
    let error = load(r#"type="obj" id="it"><string name="filename" value="bare.obj"/>"#);
    let error = error.expect_err("no coordinates").to_string();
    assert!(error.contains("a mesh with texture coordinates"), "{error}");

    // Written, it is a mesh of its own, without displacement.
    let to = dir.path().join("out/new.xml");
    loaded.save(&to).expect("files");
    let (again, warnings) = Scene::load(&to, &LoadOptions::default()).expect("a scene");
    assert!(warnings.is_empty(), "{warnings:?}");
    assert!(again.params().find(NAME).is_err());
    assert_eq!(
        mesh_of(&again).data().positions,
        mesh_of(&loaded).data().positions
    );
    assert_eq!(
        mesh_of(&again).data().normals,
        mesh_of(&loaded).data().normals
    );
    assert_eq!(mesh_of(&again).area(), mesh_of(&loaded).area());
}
