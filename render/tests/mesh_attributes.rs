//! Textures that are numbers of a mesh, and shapes that are drawn several times.

use ad_core::Vec3;
use render::bsdf::{Bsdf, Shading, TransportMode};
use render::instances::{backward_f32, render_f32};
use render::integrator::gradient::Active;
use render::math::{Ray, Rgb};
use render::params::Theta;
use render::scene::LoadOptions;
use render::{Job, Scene, instances::Estimator};

/// A square of two triangles in the plane z = 0, colours at its corners, a weight and bytes of a colour on its faces.
const SQUARE: &str = "ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float r
property float g
property float b
property float heat
element face 2
property list uchar int vertex_index
property float weight
property uchar red
property uchar green
property uchar blue
end_header
-1 -1 0 0.9 0.1 0.2 0.25
1 -1 0 0.1 0.8 0.3 0.5
1 1 0 0.4 0.5 0.6 0.75
-1 1 0 0.2 0.2 0.9 1
3 0 1 2 0.2 255 0 128
3 0 2 3 0.7 0 255 64
";

fn load(file: &str, inner: &str) -> Result<Scene, String> {
    let dir = tempfile::tempdir().expect("a folder");
    std::fs::write(dir.path().join("square.ply"), file).expect("a file");
    let text = format!(
        "<scene version=\"3.0.0\">\n<integrator type=\"path\"><integer name=\"max_depth\" value=\"2\"/></integrator>
        <sensor type=\"perspective\"><float name=\"fov\" value=\"40\"/><transform name=\"to_world\">
        <lookat origin=\"0, 0, 3\" target=\"0, 0, 0\" up=\"0, 1, 0\"/></transform><film type=\"hdrfilm\">
        <integer name=\"width\" value=\"12\"/><integer name=\"height\" value=\"12\"/><rfilter type=\"box\"/></film></sensor>
        <emitter type=\"constant\"/>{inner}</scene>"
    );
    let loaded = Scene::from_xml(&text, dir.path(), &LoadOptions::default());
    loaded.map(|(scene, _)| scene).map_err(|e| e.to_string())
}

fn square(id: &str, material: &str) -> String {
    format!(
        "<shape type=\"ply\" id=\"{id}\"><string name=\"filename\" value=\"square.ply\"/>{material}</shape>"
    )
}

fn diffuse(attribute: &str) -> String {
    format!(
        "<bsdf type=\"diffuse\"><texture name=\"reflectance\" type=\"mesh_attribute\"><string name=\"name\" value=\"{attribute}\"/></texture></bsdf>"
    )
}

/// The reflectance of a diffuse surface below a point.
fn reflectance(scene: &Scene, x: f64, y: f64) -> Rgb<f64> {
    let values: Vec<f64> = scene.params().values().iter().map(|&x| x.into()).collect();
    let ray = Ray::new(Vec3::new(x, y, 1.0), Vec3::new(0.0, 0.0, -1.0));
    let hit = scene.intersect(&ray).expect("the square");
    let at = Shading::new(Theta::constant(&values), hit.si.uv);
    let up = Vec3::new(0.0, 0.0, 1.0);
    let material = scene.material(hit.shape);
    material.eval(&at, up, up, TransportMode::Radiance) * std::f64::consts::PI
}

#[test]
fn attributes_are_interpolated_over_faces() {
    let vertices = load(SQUARE, &square("m", &diffuse("vertex_color"))).expect("a scene");
    let colours: [[f64; 3]; 4] = [
        [0.9, 0.1, 0.2],
        [0.1, 0.8, 0.3],
        [0.4, 0.5, 0.6],
        [0.2, 0.2, 0.9],
    ];
    let faces = load(SQUARE, &square("m", &diffuse("face_color"))).expect("a scene");
    let linear = |byte: f64| render::image_io::srgb_to_linear(byte / 255.0);
    for i in 0..17 {
        for j in 0..17 {
            let (x, y) = (-0.97 + 0.12 * f64::from(i), -0.93 + 0.11 * f64::from(j));
            if (x - y).abs() < 0.01 {
                continue;
            }
            // Of (-1, -1), (1, -1), (1, 1) or (-1, -1), (1, 1), (-1, 1).
            let (corners, b) = if x > y {
                ([0, 1, 2], [0.5 * (1.0 - x), 0.5 * (x - y), 0.5 * (1.0 + y)])
            } else {
                ([0, 2, 3], [0.5 * (1.0 - y), 0.5 * (1.0 + x), 0.5 * (y - x)])
            };
            let found = reflectance(&vertices, x, y);
            for c in 0..3 {
                let expected: f64 = (0..3).map(|k| b[k] * colours[corners[k]][c]).sum();
                assert!(
                    (found[c] - expected).abs() < 1e-5,
                    "{x} {y} {c}: {} {expected}",
                    found[c]
                );
            }
            let found = reflectance(&faces, x, y);
            let bytes = if x > y {
                [255.0, 0.0, 128.0]
            } else {
                [0.0, 255.0, 64.0]
            };
            for c in 0..3 {
                assert!((found[c] - linear(bytes[c])).abs() < 1e-6);
            }
        }
    }
}

/// Each mesh has its own numbers, also where two share a material.
#[test]
fn meshes_that_share_a_material_have_their_own_numbers() {
    let shared = format!(
        "<bsdf type=\"twosided\" id=\"shared\">{}</bsdf>",
        diffuse("vertex_color")
    );
    let scene = load(
        SQUARE,
        &format!(
            "{shared}{}{}",
            square("a", "<ref id=\"shared\"/>"),
            square("b", "<ref id=\"shared\"/>")
        ),
    );
    let scene = scene.expect("a scene");
    let names: Vec<_> = (scene.params().infos().iter())
        .map(|p| p.name.as_str())
        .collect();
    assert!(
        names.contains(&"a.vertex_color") && names.contains(&"b.vertex_color"),
        "{names:?}"
    );
    assert_eq!(
        scene
            .params()
            .find("a.vertex_color")
            .expect("a range")
            .shape
            .len(),
        12
    );
}

/// The image is linear in the colours at depth two, and the gradient is that map.
#[test]
fn gradients_reach_attributes() {
    for attribute in ["vertex_color", "face_color"] {
        let scene = load(SQUARE, &square("m", &diffuse(attribute))).expect("a scene");
        let name = format!("m.{attribute}");
        let info = scene.params().find(&name).expect("a range").clone();
        let active = Active::new(&scene, &[name.as_str()]).expect("a parameter");
        let image = |values: &[f32]| {
            let job = Job::new(&scene, &scene.settings, 3, 0..16, &());
            render_f32(&job, &Theta::constant(values), Estimator::Mis)
                .image(0)
                .data
        };
        let values = scene.params().values().to_vec();
        let black = {
            let mut values = values.clone();
            values[info.range()].fill(0.0);
            image(&values)
        };
        let adjoint: Vec<f32> = (0..black.len())
            .map(|i| (i % 7) as f32 * 0.3 - 1.0)
            .collect();
        let job = Job::new(&scene, &scene.settings, 3, 0..16, &());
        let gradient =
            backward_f32(&job, &Theta::constant(&values), &active, &adjoint).expect("a gradient");
        for i in 0..info.shape.len() {
            let mut one = values.clone();
            one[info.range()].fill(0.0);
            one[info.offset + i] = 1.0;
            let column = image(&one);
            let pairs = column.iter().zip(&black).zip(&adjoint);
            let expected: f64 = pairs
                .map(|((a, b), d)| f64::from(a - b) * f64::from(*d))
                .sum();
            let found = gradient.values[0][i];
            assert!(
                (found - expected).abs() < 1e-3 * expected.abs().max(1.0),
                "{attribute} {i}: {found} {expected}"
            );
        }
    }
}

#[test]
fn wrong_attributes_are_errors() {
    let weight = |name: &str| {
        format!(
            "<bsdf type=\"blendbsdf\"><texture name=\"weight\" type=\"mesh_attribute\"><string name=\"name\" value=\"{name}\"/></texture>
            <bsdf type=\"diffuse\"/><bsdf type=\"diffuse\"/></bsdf>"
        )
    };
    for good in ["face_weight", "vertex_heat"] {
        assert!(load(SQUARE, &square("m", &weight(good))).is_ok(), "{good}");
    }
    let board =
        "<bsdf type=\"diffuse\"><texture name=\"reflectance\" type=\"checkerboard\"/></bsdf>";
    let blend = |second: &str| {
        format!(
            "<bsdf type=\"blendbsdf\"><float name=\"weight\" value=\"0.5\"/>{}{second}</bsdf>",
            diffuse("vertex_color")
        )
    };
    for (shape, expected) in [
        (
            square("m", &weight("vertex_color")),
            "an attribute of 1 numbers, not 3",
        ),
        (
            square("m", &diffuse("face_weight")),
            "an attribute of 3 numbers, not 1",
        ),
        (square("m", &diffuse("vertex_colour")), "`vertex_color`"),
        (
            square("m", &blend(board)),
            "beside attributes of the mesh is not there",
        ),
        (
            format!("<shape type=\"sphere\">{}</shape>", diffuse("vertex_color")),
            "an attribute of a PLY mesh",
        ),
        (
            square(
                "m",
                "<bsdf type=\"diffuse\"><texture name=\"reflectance\" type=\"mesh_attribute\"/></bsdf>",
            ),
            "such as `vertex_color`",
        ),
    ] {
        let error = load(SQUARE, &shape).map(|_| ()).expect_err(&shape);
        assert!(error.contains(expected), "{error}");
    }
    let bright = SQUARE.replace("-1 -1 0 0.9", "-1 -1 0 1.9");
    let error = load(&bright, &square("m", &diffuse("vertex_color")))
        .map(|_| ())
        .expect_err("too bright");
    assert!(
        error.contains("numbers from 0 to 1, none of them 1.9"),
        "{error}"
    );
}

/// An instance is where the shapes of its group are when they are moved there.
#[test]
fn instances_are_copies_of_a_group() {
    let group = "<shape type=\"shapegroup\" id=\"group\"><shape type=\"sphere\" id=\"ball\"><float name=\"radius\" value=\"0.5\"/>
        <bsdf type=\"diffuse\" id=\"red\"/></shape><shape type=\"cube\"><transform name=\"to_world\"><translate x=\"2\"/></transform></shape></shape>";
    let at = |inner: &str| format!("<shape type=\"instance\"><ref id=\"group\"/>{inner}</shape>");
    let scene = load(
        SQUARE,
        &format!(
            "{group}{}{}",
            at(""),
            at(
                "<transform name=\"to_world\"><scale value=\"2\"/><translate y=\"10\"/></transform>"
            )
        ),
    );
    let scene = scene.expect("a scene");
    assert_eq!(scene.shapes().len(), 4);
    let meets = |x: f64, y: f64| {
        let ray = Ray::new(Vec3::new(x, y, 50.0), Vec3::new(0.0, 0.0, -1.0));
        scene.intersect(&ray).map(|hit| (hit.shape, hit.si.p.z))
    };
    for (x, y, shape, z) in [
        (0.0, 0.0, 0, 0.5),
        (2.0, 0.0, 1, 1.0),
        (0.0, 10.0, 2, 1.0),
        (4.0, 10.0, 3, 2.0),
    ] {
        let (found, height) = meets(x, y).expect("a shape");
        assert!(
            found == shape && (height - z).abs() < 1e-5,
            "{x} {y}: {found} {height}"
        );
    }
    // The material is one.
    let of = |shape| scene.shape_info(shape).material;
    assert_eq!(of(0), of(2));
    let names: Vec<_> = (0..4).map(|i| scene.shape_info(i).name.clone()).collect();
    assert_eq!(names[0], "shape1.ball");
    for (shapes, expected) in [
        (at(""), "no element has the id"),
        (
            format!("{group}<shape type=\"instance\"/>"),
            "a reference to a group",
        ),
        (
            format!("{group}{}", at("<float name=\"radius\" value=\"2\"/>")),
            "radius",
        ),
        (
            format!(
                "{}{}",
                group.replace(
                    "<bsdf type=\"diffuse\" id=\"red\"/>",
                    "<emitter type=\"area\"/>"
                ),
                at("")
            ),
            "emitter `area`: shapes of a group that emit, in its instances, are not there",
        ),
        (
            format!(
                "{}{}",
                group.replace("type=\"sphere\"", "type=\"instance\""),
                at("")
            ),
            "shape `instance`: groups of groups and of instances are not there",
        ),
        (
            format!(
                "{group}{}",
                at("<transform name=\"to_world\"><scale value=\"1e30\"/></transform>")
            ),
            "to_world",
        ),
    ] {
        let error = load(SQUARE, &shapes).map(|_| ()).expect_err(&shapes);
        assert!(error.contains(expected), "{expected}: {error}");
    }
}
