//! Parallel light, projectors and slides: against formulas, cameras and the lights that they are made of.

use std::f64::consts::PI;
use std::path::Path;

use ad_core::{Dual, Vec2, Vec3};
use render::Scene;
use render::camera::{Camera, FovAxis};
use render::emitter::{AnyEmitter, Ball, Emitter};
use render::estimator::DetachedMis;
use render::math::Transform;
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::scene::LoadOptions;

const VIEW: &str = r#"<transform name="to_world"><lookat origin="1, 2, 3" target="0.3, -0.2, 0.1" up="0.1, 1, 0"/></transform>"#;
const BOARD: &str = r#"<texture name="NAME" type="checkerboard"><rgb name="color0" value="0.5, 1, 2"/>
    <rgb name="color1" value="4, 0.25, 1"/><transform name="to_uv"><scale value="6"/></transform></texture>"#;

fn board(name: &str) -> String {
    BOARD.replace("NAME", name)
}

fn load(emitter: &str) -> Result<Scene, String> {
    let text = format!(
        "<scene version=\"3.0.0\">\n{emitter}<sensor type=\"perspective\"/><shape type=\"sphere\"/></scene>"
    );
    let loaded = Scene::from_xml(&text, Path::new("."), &LoadOptions::default());
    loaded.map(|(scene, _)| scene).map_err(|e| e.to_string())
}

fn scene(emitter: &str) -> Scene {
    load(emitter).unwrap_or_else(|e| panic!("{emitter}: {e}"))
}

fn view() -> Transform {
    let view = Transform::look_at([1.0, 2.0, 3.0], [0.3, -0.2, 0.1], [0.1, 1.0, 0.0]);
    view.expect("a view")
}

/// What arrives at a point, per channel.
fn arrives(scene: &Scene, from: Vec3<f64>) -> Option<(Vec3<f64>, [f64; 3], Vec2<f64>)> {
    let values: Vec<f64> = scene.params().values().iter().map(|&x| x.into()).collect();
    let light = &scene.emitters()[0];
    let s = light.sample(scene.lights(), from, [0.3, 0.7])?;
    assert_eq!(s.pdf, 1.0);
    let e = light.eval(&Theta::constant(&values), &s.emission);
    Some((s.d, e.to_array(), s.emission.uv))
}

#[test]
fn parallel_light_comes_from_one_direction() {
    for how in [
        r#"<vector name="direction" value="2, -1, 2"/>"#,
        r#"<transform name="to_world"><lookat origin="0, 0, 0" target="2, -1, 2" up="0, 1, 0"/></transform>"#,
    ] {
        let scene = scene(&format!(
            r#"<emitter type="directional" id="sun">{how}<rgb name="irradiance" value="3, 2, 1"/></emitter>"#
        ));
        let light = &scene.emitters()[0];
        assert!(light.is_delta() && light.is_infinite());
        assert!(light.hit(Vec3::new(0.0, 0.0, 1.0), None).is_none());
        let (d, e, _) = arrives(&scene, Vec3::new(5.0, 6.0, 7.0)).expect("light");
        let towards = Vec3::new(-2.0, 1.0, -2.0) * (1.0 / 3.0);
        assert!((d - towards).length() < 1e-6 && e == [3.0, 2.0, 1.0]);
        // Particles carry all that meets the disk around the scene.
        let ball = Ball::around(scene.shapes()).expect("a ball");
        let start = light.sample_ray(
            &Theta::still(),
            scene.lights(),
            Some(ball),
            [0.1, 0.6, 0.2, 0.9],
        );
        let start = start.expect("a particle");
        assert!((start.ray.d + towards).length() < 1e-6);
        assert!((start.weight() / (PI * ball.radius * ball.radius) - 1.0).abs() < 1e-12);
    }
}

/// A projector lights the way that a camera looks, and a constant image is a constant irradiance.
#[test]
fn projectors_are_cameras_in_reverse() {
    let constant = scene(&format!(
        r#"<emitter type="projector">{VIEW}<float name="fov" value="50"/><float name="scale" value="1.5"/>
        <rgb name="irradiance" value="2"/></emitter>"#
    ));
    // The image of a constant is square.
    let camera = Camera::new(view(), 50.0, FovAxis::X, [40, 40]).expect("a camera");
    let forward = Vec3::from(view().vector([0.0, 0.0, 1.0]));
    for i in 0..200 {
        let mut s = Independent::new(1, 0, i);
        let (x, y) = (40.0 * s.next_1d::<f64>(), 40.0 * s.next_1d::<f64>());
        let ray = camera.ray(x, y);
        let depth = 0.2 + 3.0 * s.next_1d::<f64>();
        let p = ray.o + ray.d * (depth / ray.d.dot(forward));
        let (d, e, uv) = arrives(&constant, p).expect("light");
        let irradiance = e[0] * -d.dot(forward) * depth * depth;
        assert!(
            (irradiance / (PI * 1.5 * 2.0) - 1.0).abs() < 1e-5,
            "{irradiance}"
        );
        assert!((uv.x - x / 40.0).abs() < 1e-5 && (uv.y - y / 40.0).abs() < 1e-5);
        // Behind it is nothing, nor beside the image.
        assert!(arrives(&constant, ray.o - ray.d).is_none());
        let beside = camera.ray(x + 40.0, y);
        assert!(arrives(&constant, beside.o + beside.d).is_none());
    }
    assert!(arrives(&constant, Vec3::new(1.0, 2.0, 3.0)).is_none());
}

/// Particles leave as paths find them, and densities integrate to one over the image.
#[test]
fn particles_of_projectors_and_slides_agree_with_paths() {
    let projector = scene(&format!(
        r#"<emitter type="projector">{VIEW}<float name="fov" value="70"/>{}</emitter>"#,
        board("irradiance")
    ));
    let slide = scene(&format!(
        r#"<emitter type="spot">{VIEW}<float name="cutoff_angle" value="40"/>{}</emitter>"#,
        board("texture")
    ));
    for (scene, name) in [(&projector, "projector"), (&slide, "slide")] {
        let light: &AnyEmitter = &scene.emitters()[0];
        let n = 200;
        let mut solid_angle = 0.0;
        for i in 0..n * n {
            let u = [i % n, i / n].map(|k| (f64::from(k) + 0.5) / f64::from(n));
            let start = light
                .sample_ray(
                    &Theta::still(),
                    scene.lights(),
                    None,
                    [0.0, 0.0, u[0], u[1]],
                )
                .expect("a particle");
            solid_angle += start.pdf_direction.recip() / f64::from(n * n);
            let (emission, pdf) = light.leaves(start.ray.d, None).expect("the same");
            assert!((pdf / start.pdf_direction - 1.0).abs() < 1e-9);
            assert!((emission.uv.x - start.emission.uv.x).abs() < 1e-9);
            if i % 97 != 0 || start.emission.falloff < 1e-3 {
                continue;
            }
            let p = start.ray.o + start.ray.d * 2.0;
            let s = light.sample(scene.lights(), p, [0.0; 2]).expect("light");
            assert!((s.d + start.ray.d).length() < 1e-6, "{name}");
            assert!((s.emission.falloff * 4.0 / start.emission.falloff - 1.0).abs() < 1e-6);
            assert!((s.emission.uv.x - start.emission.uv.x).abs() < 1e-6);
            assert!((s.emission.uv.y - start.emission.uv.y).abs() < 1e-6);
        }
        let half = 35f64.to_radians().tan();
        let exact = match name {
            // The solid angle of a square.
            "projector" => 4.0 * (half * half / (1.0 + half * half)).asin(),
            _ => 2.0 * PI * (1.0 - 40f64.to_radians().cos()),
        };
        assert!(
            (solid_angle / exact - 1.0).abs() < 1e-4,
            "{name}: {solid_angle} {exact}"
        );
    }
}

/// A slide is the spot light times its texture, whose square is met by the cone.
#[test]
fn slides_multiply_spots() {
    let light = |inner: &str| {
        scene(&format!(
            r#"<emitter type="spot" id="lamp"><transform name="to_world"><translate z="2"/></transform>
            <float name="cutoff_angle" value="30"/><rgb name="intensity" value="8, 4, 2"/>{inner}</emitter>"#
        ))
    };
    let (plain, slide) = (light(""), light(&board("texture")));
    let names: Vec<_> = (slide.params().infos().iter())
        .map(|p| p.name.as_str())
        .collect();
    assert!(names.contains(&"lamp.intensity.color0.value"), "{names:?}");
    assert!(!names.contains(&"lamp.intensity.value"));
    let tan = 30f64.to_radians().tan();
    for i in 0..200 {
        let mut s = Independent::new(5, 0, i);
        let [x, y]: [f64; 2] = s.next_2d::<f64>().map(|u| 1.2 * (2.0 * u - 1.0) * tan);
        let p = Vec3::new(3.0 * x, 3.0 * y, 5.0);
        let (Some((_, a, _)), Some((_, b, uv))) = (arrives(&plain, p), arrives(&slide, p)) else {
            assert!(arrives(&plain, p).is_none() && arrives(&slide, p).is_none());
            continue;
        };
        let [u, v] = [x, y].map(|x| 0.5 + 0.5 * x / tan);
        assert!((uv.x - u).abs() < 1e-6 && (uv.y - v).abs() < 1e-6);
        // The board, by hand.
        let first = ((6.0 * u).rem_euclid(1.0) > 0.5) == ((6.0 * v).rem_euclid(1.0) > 0.5);
        let texture = if first {
            [0.5, 1.0, 2.0]
        } else {
            [4.0, 0.25, 1.0]
        };
        for c in 0..3 {
            assert!((b[c] / a[c] / texture[c] - 1.0).abs() < 1e-5, "{u} {v} {c}");
        }
    }
}

/// Seen from a point that moves: duals against differences of samples.
#[test]
fn light_through_images_follows_the_point() {
    type D = Dual<f64, 3>;
    for emitter in [
        format!(r#"<emitter type="projector">{VIEW}<rgb name="irradiance" value="1"/></emitter>"#),
        format!(
            r#"<emitter type="spot">{VIEW}<float name="cutoff_angle" value="40"/>{}</emitter>"#,
            board("texture")
        ),
    ] {
        let scene = scene(&emitter);
        let light = &scene.emitters()[0];
        for p in [[0.4, 0.1, 0.2], [-0.2, -1.0, -1.5]] {
            let sample = |p: Vec3<f64>| light.sample(scene.lights(), p, [0.0; 2]).expect("light");
            let moving = Vec3::new(D::var(p[0], 0), D::var(p[1], 1), D::var(p[2], 2));
            let seen = light.connect(&sample(p.into()), moving);
            for (k, axis) in Transform::IDENTITY.linear.into_iter().enumerate() {
                let step = Vec3::from(axis) * 1e-5;
                let (a, b) = (sample(Vec3::from(p) + step), sample(Vec3::from(p) - step));
                let change = |x: f64, y: f64| (x - y) / 2e-5;
                for (found, expected) in [
                    (
                        seen.emission.falloff,
                        change(a.emission.falloff, b.emission.falloff),
                    ),
                    (seen.emission.uv.x, change(a.emission.uv.x, b.emission.uv.x)),
                    (seen.emission.uv.y, change(a.emission.uv.y, b.emission.uv.y)),
                    (seen.d.x, change(a.d.x, b.d.x)),
                ] {
                    let error = (found.eps[k] - expected).abs();
                    assert!(
                        error < 1e-6 * (1.0 + expected.abs()),
                        "{k}: {found:?} {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn bad_descriptions_name_their_line_and_key() {
    for (plugin, inner, key) in [
        (
            "directional",
            r#"<vector name="direction" value="0, 0, 0"/>"#,
            "direction",
        ),
        (
            "directional",
            r#"<vector name="direction" value="0, 0, 1"/><transform name="to_world"/>"#,
            "direction",
        ),
        (
            "directional",
            r#"<rgb name="irradiance" value="-1"/>"#,
            "irradiance",
        ),
        (
            "directional",
            r#"<rgb name="radiance" value="1"/>"#,
            "radiance",
        ),
        ("projector", r#"<float name="fov" value="180"/>"#, "fov"),
        ("projector", r#"<float name="scale" value="-1"/>"#, "scale"),
        (
            "projector",
            r#"<transform name="to_world"><scale value="2"/></transform>"#,
            "to_world",
        ),
        (
            "projector",
            r#"<float name="fov" value="20"/><string name="focal_length" value="50mm"/>"#,
            "focal_length",
        ),
        (
            "spot",
            &format!(
                r#"<float name="cutoff_angle" value="100"/>{}"#,
                board("texture")
            ),
            "cutoff_angle",
        ),
        (
            "spot",
            &format!(
                r#"<float name="beam_width" value="100"/>{}"#,
                board("texture")
            ),
            "beam_width",
        ),
        (
            "spot",
            &format!(r#"<rgb name="intensity" value="-1"/>{}"#, board("texture")),
            "intensity",
        ),
        ("directionalarea", "", "an area light inside a <shape>"),
        ("sunsky", "", "models of the sky are not there"),
    ] {
        let text = format!("<emitter type=\"{plugin}\">{inner}</emitter>");
        let error = load(&text).map(|_| ()).expect_err(&text);
        assert!(
            error.contains("<text>:2") && error.contains(key),
            "{text}: {error}"
        );
    }
}

/// Inside its beam a flat lamp is a directional light, outside there is none; particles carry its power.
#[test]
fn beams_have_the_form_of_their_lamp() {
    let lamp = |shape: &str| {
        format!(
            r#"<shape type="{shape}" id="lamp"><transform name="to_world"><scale x="2" y="0.5"/><rotate y="1" angle="90"/>
            <translate x="1" y="2" z="3"/></transform><emitter type="directionalarea"><rgb name="radiance" value="3, 2, 1"/></emitter></shape>"#
        )
    };
    // The x axis of the lamp has become -z, its normal x.
    for (shape, area, corner) in [("rectangle", 4.0, true), ("disk", PI, false)] {
        let scene = scene(&lamp(shape));
        let light = &scene.emitters()[0];
        assert!(light.is_delta() && !light.is_infinite());
        for (p, lit) in [
            ([6.0, 2.0, 3.0], true),
            ([1.5, 2.4, 3.0], true),
            ([6.0, 2.0, 4.9], true),
            ([6.0, 2.45, 4.8], corner),
            ([6.0, 2.6, 3.0], false),
            ([6.0, 2.0, 5.1], false),
            ([0.5, 2.0, 3.0], false),
            ([1.0, 2.0, 3.0], false),
        ] {
            let found = arrives(&scene, Vec3::from(p));
            assert_eq!(found.is_some(), lit, "{shape} {p:?}");
            if let Some((d, e, _)) = found {
                assert!((d - Vec3::new(-1.0, 0.0, 0.0)).length() < 1e-6);
                assert_eq!(e, [3.0, 2.0, 1.0]);
            }
        }
        let start = light.sample_ray::<f64>(&Theta::still(), scene.lights(), None, [0.3; 4]);
        let start = start.expect("a particle");
        assert!((start.ray.d - Vec3::new(1.0, 0.0, 0.0)).length() < 1e-6);
        assert!(
            (start.weight() / area - 1.0).abs() < 1e-6,
            "{}",
            start.weight()
        );
    }
    let error = load(&lamp("sphere").replace("<scale x=\"2\" y=\"0.5\"/>", "")).map(|_| ());
    let error = error.expect_err("no direction");
    assert!(
        error.contains("<text>:2") || error.contains("<text>:3"),
        "{error}"
    );
    assert!(
        error.contains("rectangles and disks is not there"),
        "{error}"
    );
    let mut scene = scene(&lamp("disk"));
    scene
        .make_movable(&["lamp.translation"])
        .expect("a parameter");
    let info = scene
        .params()
        .find("lamp.translation")
        .expect("a parameter")
        .clone();
    let error = scene
        .admits_motion::<DetachedMis>(&info)
        .expect_err("an edge")
        .to_string();
    assert!(error.contains("sends a beam"), "{error}");
}
