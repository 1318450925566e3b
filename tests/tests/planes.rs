//! Surfaces that touch, coincide or nearly do: which of them a ray meets is the same for all techniques.

use render::Job;
use render::bsdf::kernel::Rules;
use render::finite_element::{FiniteElements, Options};
use render::instances::{
    Estimator, backward_f32, backward_particles_f32, particles_f32, render_f32, render_f64,
};
use render::integrator::gradient::Active;
use render::params::{ParamKind, Theta};
use render::{Scene, Settings};
use tests::stats::{Estimate, z_limit};
use tests::{scene, with_warnings};

const TECHNIQUES: [Estimator; 4] = [
    Estimator::Mis,
    Estimator::MisBalance,
    Estimator::Detached,
    Estimator::Emitter,
];

/// Turns a scene away from the axes, so that no coordinate is exact.
const TURNED: &str =
    r#"<rotate x="1" y="0.4" z="-0.3" angle="37"/><translate x="0.3" y="-0.7" z="0.2"/>"#;

/// A camera at `height` looking down, and what is between it and a floor, if that is turned by `turn`.
fn view(height: f64, depth: u32, turn: &str) -> String {
    format!(
        r#"<integrator type="path"><integer name="max_depth" value="{depth}"/>
            <integer name="rr_depth" value="100"/></integrator>
        <sensor type="perspective"><float name="fov" value="40"/>
            <transform name="to_world">
                <lookat origin="0,{height},0" target="0,0,0" up="0,0,1"/>{turn}</transform>
            <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
                <rfilter type="box"/></film></sensor>"#
    )
}

fn diffuse(albedo: f64) -> String {
    format!(
        r#"<bsdf type="twosided"><bsdf type="diffuse">
            <rgb name="reflectance" value="{albedo}"/></bsdf></bsdf>"#
    )
}

/// A flat shape across the vertical axis, facing up or down.
fn plate(kind: &str, inside: &str, size: f64, height: f64, up: bool, turn: &str) -> String {
    let angle = if up { -90 } else { 90 };
    format!(
        r#"<shape type="{kind}"><transform name="to_world"><scale value="{size}"/>
            <rotate x="1" angle="{angle}"/><translate y="{height}"/>{turn}</transform>{inside}</shape>"#
    )
}

const LAMP: &str = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
    <emitter type="area"><rgb name="radiance" value="5"/></emitter>"#;

/// Things far below that nothing sees: enough of them that rays go through a hierarchy.
fn crowd(turn: &str) -> String {
    let one = |i: i32| {
        let up = i % 2 == 0;
        plate(
            "rectangle",
            &diffuse(0.5),
            0.1,
            -20.0 - f64::from(i),
            up,
            turn,
        )
    };
    (0..150).map(one).collect()
}

fn by(scene: &Scene, estimator: Estimator, spp: u64) -> Vec<f32> {
    let theta = Theta::constant(scene.params().values());
    let settings = &scene.settings;
    render_f32(
        &Job::new(scene, settings, 3, 0..spp, &()),
        &theta,
        estimator,
    )
    .image(0)
    .data
}

fn by_particles(scene: &Scene, spp: u64) -> Vec<f32> {
    let theta = Theta::constant(scene.params().values());
    let rules = Rules::default();
    let r = particles_f32(
        &Job::new(scene, &scene.settings, 3, 0..spp, &()),
        &theta,
        rules,
    );
    r.expect("no flipped normals").image(0).data
}

fn mean(image: &[f32]) -> f64 {
    image.iter().map(|x| f64::from(*x)).sum::<f64>() / image.len() as f64
}

/// The gradient of the mean, by paths and by particles, in the radiance of the only emitter.
fn gradients(scene: &Scene) -> [Vec<f64>; 2] {
    let infos = scene.params().infos().iter();
    let emission = infos.filter(|i| i.kind == ParamKind::Emission);
    let name: Vec<_> = emission.map(|i| &i.name).collect();
    let active = Active::new(scene, &name).expect("the radiance");
    let theta = Theta::constant(scene.params().values());
    let adjoint = vec![1.0 / 64.0; 8 * 8 * 3];
    let s = &scene.settings;
    let paths = backward_f32(
        &Job::new(scene, s, 5, 0..64, &()),
        &theta,
        &active,
        &adjoint,
    );
    let particles = backward_particles_f32(
        &Job::new(scene, s, 5, 0..64, &()),
        &theta,
        &active,
        &adjoint,
    );
    [
        paths.expect("valid").values.concat(),
        particles.expect("valid").gradient.values.concat(),
    ]
}

/// A black plate a twentieth of a per cent of the way in front of a lamp, which it covers: no light gets through, whatever
/// looks for it. The kind of layout is that of few primitives and of many.
#[test]
fn what_is_covered_closely_is_dark() {
    for turn in ["", TURNED] {
        for many in [false, true] {
            for lamp in ["rectangle", "disk"] {
                let s = scene(
                    &[
                        view(1.5, 6, turn),
                        plate("rectangle", &diffuse(0.5), 40.0, 0.0, true, turn),
                        plate(lamp, LAMP, 2.5, 10.0, false, turn),
                        plate("rectangle", &diffuse(0.0), 10.0 / 3.0, 9.995, false, turn),
                        if many { crowd(turn) } else { String::new() },
                    ]
                    .concat(),
                );
                for estimator in TECHNIQUES {
                    assert_eq!(
                        mean(&by(&s, estimator, 64)),
                        0.0,
                        "{estimator:?} {lamp} {turn}"
                    );
                }
                assert_eq!(mean(&by_particles(&s, 64)), 0.0, "{lamp} {turn}");
                for g in gradients(&s) {
                    assert!(g.iter().all(|g| *g == 0.0), "{g:?}");
                }
            }
        }
    }
}

/// A lamp in the plane of a black ceiling shines as it does without, whichever stands first, however the room is
/// turned, for every technique and in both precisions: pixel by pixel, since the same paths are followed.
#[test]
fn a_lamp_in_a_ceiling_shines_as_without() {
    for turn in ["", TURNED] {
        let floor = plate("rectangle", &diffuse(0.5), 4.0, 0.0, true, turn);
        for (lamp, ceiling, many) in [
            ("rectangle", "rectangle", false),
            ("rectangle", "rectangle", true),
            ("disk", "rectangle", false),
            ("rectangle", "disk", true),
        ] {
            let lamp = plate(lamp, LAMP, 1.0, 2.0, false, turn);
            let ceiling = plate(ceiling, &diffuse(0.0), 4.0, 2.0, false, turn);
            let room = |parts: &[&String]| {
                let parts: String = parts.iter().copied().cloned().collect();
                let crowd = if many { crowd(turn) } else { String::new() };
                scene(&[view(1.9, 6, turn), floor.clone(), parts, crowd].concat())
            };
            let without = room(&[&lamp]);
            for s in [room(&[&lamp, &ceiling]), room(&[&ceiling, &lamp])] {
                let same = |a: &[f32], b: &[f32], what: &str| {
                    for (a, b) in a.iter().zip(b) {
                        let close = (a - b).abs() <= 1e-4 * b.abs();
                        assert!(close && *b > 0.1, "{what}: {a} instead of {b} {turn}");
                    }
                };
                for estimator in TECHNIQUES {
                    let (a, b) = (by(&s, estimator, 256), by(&without, estimator, 256));
                    same(&a, &b, &format!("{estimator:?}"));
                }
                same(
                    &by_particles(&s, 256),
                    &by_particles(&without, 256),
                    "particles",
                );
                let double = |s: &Scene| {
                    let values: Vec<f64> = s.params().values().iter().map(|&v| v.into()).collect();
                    let (theta, t) = (Theta::constant(&values), Estimator::Mis);
                    render_f64(&Job::new(s, &s.settings, 3, 0..64, &()), &theta, t)
                        .image(0)
                        .data
                };
                same(&double(&s), &double(&without), "double precision");
                for (a, b) in gradients(&s).iter().zip(&gradients(&without)) {
                    for (a, b) in a.iter().zip(b) {
                        assert!((a - b).abs() < 1e-4 * b, "gradient {a} instead of {b}");
                    }
                }
            }
            // The form factor of a square of side 2 at distance 2, over what is seen of the floor.
            if turn.is_empty() && !many && lamp.contains("rectangle") {
                let found = mean(&by(&without, Estimator::Mis, 1024));
                assert!((found - 0.548).abs() < 2e-3, "{found}");
            }
        }
    }
}

/// The same for finite elements, against paths.
#[test]
fn elements_see_a_lamp_in_a_ceiling() {
    let floor = plate("rectangle", &diffuse(0.5), 4.0, 0.0, true, "");
    let lamp = plate("rectangle", LAMP, 1.0, 2.0, false, "");
    let ceiling = plate("rectangle", &diffuse(0.4), 4.0, 2.0, false, "");
    let view = view(1.9, u32::MAX, "");
    let rooms = [[&floor, &lamp, &ceiling], [&floor, &ceiling, &lamp]];
    let means = rooms.map(|parts| {
        let body: String = [&view].into_iter().chain(parts).cloned().collect();
        let s = scene(&body);
        let options = Options {
            importance: false,
            ..Options::default()
        };
        let mut elements = FiniteElements::new(&s, options).expect("flat and diffuse");
        for _ in 0..3 {
            elements.solve().expect("it converges");
            elements.refine(1e-5);
        }
        elements.solve().expect("it converges");
        let settings = Settings {
            max_depth: 32,
            ..s.settings
        };
        let theta = Theta::constant(s.params().values());
        let estimator = Estimator::Mis;
        let paths = render_f32(&Job::new(&s, &settings, 3, 0..4096, &()), &theta, estimator);
        [mean(&elements.flat().data), mean(&paths.image(0).data)]
    });
    println!("{means:?}");
    for [elements, paths] in means {
        assert!((elements / paths - 1.0).abs() < 0.01, "{elements} {paths}");
    }
    assert!((means[0][0] / means[1][0] - 1.0).abs() < 1e-6, "{means:?}");
}

/// Clear slabs in a furnace are not seen, however thin: two rectangles, or a flattened cube.
#[test]
fn thin_slabs_have_two_faces() {
    let glass = r#"<bsdf type="dielectric"><float name="int_ior" value="1.5"/>
        <float name="ext_ior" value="1"/></bsdf>"#;
    let turned = r#"<rotate x="1" y="0.4" z="-0.3" angle="37"/>"#;
    for (turn, thickness) in [
        ("", 1e-3),
        ("", 1e-5),
        ("", 1e-6),
        (turned, 1e-3),
        (turned, 1e-5),
        (turned, 3e-6),
    ] {
        let rectangles = [
            plate("rectangle", glass, 1.0, 0.0, true, turn),
            plate("rectangle", glass, 1.0, -thickness, false, turn),
        ];
        let cube = format!(
            r#"<shape type="cube"><transform name="to_world"><scale x="1" y="{}" z="1"/>{turn}
                </transform>{glass}</shape>"#,
            0.5 * thickness
        );
        for (slab, kind) in [(rectangles.concat(), "rectangles"), (cube, "cube")] {
            for many in [false, true] {
                let crowd = if many { crowd(turn) } else { String::new() };
                let s = scene(
                    &[
                        view(4.0, 64, turn).replace("value=\"40\"", "value=\"20\""),
                        r#"<emitter type="constant"><rgb name="radiance" value="1"/></emitter>"#
                            .into(),
                        slab.clone(),
                        crowd.replace("reflectance\" value=\"0.5\"", "reflectance\" value=\"1\""),
                    ]
                    .concat(),
                );
                let found = mean(&by(&s, Estimator::Mis, 64));
                let what = format!("{kind} {thickness:e} {many} {turn}");
                assert!((found - 1.0).abs() < 2e-3, "{what}: {found}");
            }
        }
    }
}

/// Where single precision has no second face left, loading says so: slabs far from the origin, panes that touch, decals
/// on walls; and nothing where panes are side by side, or lamps lie on something.
#[test]
fn faces_that_are_one_are_told() {
    let glass = r#"<bsdf type="dielectric"/>"#;
    let pane = |y: f32, x: f32, up: bool, inside: &str, far: f32| {
        let turn = format!(r#"<translate x="{}" y="{far}" z="{far}"/>"#, x + far);
        plate("rectangle", inside, 1.0, y.into(), up, &turn)
    };
    let mask = format!(
        r#"<bsdf type="mask"><float name="opacity" value="0.5"/>{}</bsdf>"#,
        diffuse(0.5)
    );
    let cube = |half: f32, far: f32| {
        format!(
            r#"<shape type="cube"><transform name="to_world"><scale x="1" y="{half}" z="1"/>
                <translate x="{far}" y="{far}" z="{far}"/></transform>{glass}</shape>"#
        )
    };
    let pair = |a: String, b: String| [a, b].concat();
    let slab = |thickness: f32, far: f32| {
        pair(
            pane(0.0, 0.0, true, glass, far),
            pane(-thickness, 0.0, false, glass, far),
        )
    };
    let on =
        |a: &str, b: &str, x: f32| pair(pane(0.0, 0.0, true, a, 0.0), pane(0.0, x, true, b, 0.0));
    let grey = diffuse(0.5);
    let cases = [
        ("slab", slab(1e-5, 0.0), false),
        ("slab far away", slab(1e-5, 1000.0), true),
        ("thicker slab far away", slab(1e-2, 1000.0), false),
        ("cube", cube(5e-6, 0.0), false),
        ("cube far away", cube(5e-5, 1000.0), true),
        ("thicker cube far away", cube(1e-2, 1000.0), false),
        ("panes", on(glass, glass, 1.5), true),
        ("panes side by side", on(glass, glass, 2.0), false),
        ("decal", on(&grey, &mask, 0.0), true),
        ("walls", on(&grey, &grey, 0.0), false),
        ("lamp on glass", on(glass, LAMP, 0.0), false),
    ];
    for (what, body, expected) in cases {
        let (_, warnings) = with_warnings(&[&view(4.0, 4, ""), &*body].concat());
        let told = warnings
            .iter()
            .any(|w| w.contains("lies on one plane with"));
        assert_eq!(told, expected, "{what}: {warnings:?}");
    }
}

/// What emits and has no material reflects nothing; what does not emit is grey.
#[test]
fn lamps_reflect_nothing_unless_they_say_so() {
    let sky = r#"<emitter type="constant"><rgb name="radiance" value="1"/></emitter>"#;
    let dark = r#"<emitter type="area"><rgb name="radiance" value="0"/></emitter>"#;
    let black = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.25"/></bsdf>"#;
    let both = [dark, black].concat();
    for (inside, expected) in [("", 0.5), (dark, 0.0), (&*both, 0.25)] {
        let floor = plate("rectangle", inside, 40.0, 0.0, true, "");
        let s = scene(&[&view(1.9, 6, ""), sky, &floor].concat());
        for estimator in TECHNIQUES {
            let found = mean(&by(&s, estimator, 256));
            assert!((found - expected).abs() < 0.02, "{estimator:?}: {found}");
        }
    }
}

/// Curved lights that do not hide themselves from their own samples do where they should: the inside of an open tube,
/// seen from beside it. 32 runs of 64 samples each way; significance 1e-3 over both pairs.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn curved_lights_hide_their_far_side() {
    for flip in [false, true] {
        let body = format!(
            r#"{}{}<shape type="cylinder"><point name="p0" x="0" y="2.6" z="-0.7"/>
                <point name="p1" x="0" y="3.6" z="0.7"/><float name="radius" value="0.6"/>
                <boolean name="flip_normals" value="{flip}"/>{LAMP}</shape>"#,
            view(2.0, 2, ""),
            plate("rectangle", &diffuse(0.5), 4.0, 0.0, true, ""),
        );
        let s = scene(&body);
        let theta = Theta::constant(s.params().values());
        let run = |estimator, first: u64| {
            let one = |seed| {
                let r = render_f32(
                    &Job::new(&s, &s.settings, seed, 0..64, &()),
                    &theta,
                    estimator,
                );
                mean(&r.image(0).data)
            };
            Estimate::of(&(first..first + 32).map(one).collect::<Vec<_>>())
        };
        let (a, b) = (run(Estimator::Emitter, 0), run(Estimator::Detached, 100));
        let z = a.z(&b).abs();
        assert!(z < z_limit(2, 32, 1e-3), "{flip}: {} {}", a.mean, b.mean);
        assert!(a.mean > 1e-3);
    }
}
