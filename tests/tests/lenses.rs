//! Derivatives in what moves, through cameras that are no pinholes: where they are known, and against central differences.

use std::f64::consts::PI;

use render::estimator::{
    AllowBias, AttachedWeights, Convolved, Detached, DetachedMis, Followed, Interior, Mis,
    Outlines, Reparameterised, Unbiased,
};
use render::sampler::Points;
use render::statistics::{Estimate, z_limit};
use render::{Scene, Settings};
use tests::moving::{self, BALL, CUBE, DISK, FLOOR, TUBE, agrees, differences};

type ByEdges = Outlines<Interior<DetachedMis>>;
type Follows = Convolved<Mis<Reparameterised, Detached, AttachedWeights>>;
type Exactly = Followed<Mis<Reparameterised, Detached, AttachedWeights>>;

const RUNS: u64 = 8;

fn gradient<E: Unbiased>(s: &Scene, names: &[&str], spp: u64) -> Vec<Estimate> {
    moving::gradient::<E>(s, names, RUNS, spp)
}

/// What a scene, which is loaded in single precision, is off by where a derivative has next to no variance.
const LOADED: f64 = 1e-6;

fn exactly(known: impl IntoIterator<Item = f64>) -> Vec<Estimate> {
    known.into_iter().map(Estimate::exact).collect()
}

const FILM: &str = r#"<film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/>
    <rfilter type="box"/></film>"#;

/// The scenes of [`moving::scene`] through another sensor.
fn seen_through(plugin: &str, body: &str, depth: u32) -> Scene {
    let looks = match plugin {
        "orthographic" => {
            r#"<scale x="1.6" y="1.6"/><lookat origin="0, 3, 5" target="0, 0.4, 0" up="0, 1, 0"/>"#
        }
        _ => r#"<lookat origin="0, 3, 5" target="0, 0.4, 0" up="0, 1, 0"/>"#,
    };
    let own = match plugin {
        "orthographic" => "",
        _ => {
            r#"<float name="fov" value="45"/><float name="aperture_radius" value="0.25"/>
            <float name="focus_distance" value="4"/>"#
        }
    };
    tests::scene(&format!(
        r#"<integrator type="path"><integer name="max_depth" value="{depth}"/><integer name="rr_depth" value="100"/></integrator>
        <sensor type="{plugin}">{own}<transform name="to_world">{looks}</transform>{FILM}</sensor>{body}"#
    ))
}

/// A square, a disk and a ball that glow, by parallel rays: the derivative of the mean is that of a projected area, which
/// grows with the square of a scale and of the cosine of a turn, and does not change as anything moves within the film.
/// 8 runs of 64 samples of 256 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn parallel_rays_see_projected_areas() {
    let film = 4.0 * 1.5 * 1.5;
    let tilt = 40f64.to_radians();
    for (what, shape, area, turns) in [
        ("square", "rectangle", 0.64 * 4.0, true),
        ("disk", "disk", 0.64 * PI, true),
        ("ball", "sphere", 0.64 * PI, false),
    ] {
        let tilted = if turns {
            r#"<rotate y="1" angle="140"/>"#
        } else {
            ""
        };
        let mut s = tests::scene(&format!(
            r#"<integrator type="path"><integer name="max_depth" value="1"/></integrator>
            <sensor type="orthographic"><transform name="to_world"><scale x="1.5" y="1.5"/></transform>{FILM}</sensor>
            <shape type="{shape}" id="it"><transform name="to_world"><scale value="0.8"/>{tilted}
            <translate x="0.1" y="-0.2" z="3"/></transform>
            <emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>"#
        ));
        let names = [
            "it.translation",
            "it.scale",
            "it.rotation",
            "sensor.translation",
            "sensor.rotation",
        ];
        s.make_movable(&names).expect("known");
        let seen = if turns { area * tilt.cos() } else { area } / film;
        // A turn about the vertical axis: the face is turned by 140 degrees, 40 away from the camera.
        let turned = if turns { area * tilt.sin() / film } else { 0.0 };
        let mut known = vec![0.0, 0.0, 0.0, 2.0 * seen, 0.0, turned, 0.0];
        known.extend([0.0, 0.0, 0.0, 0.0, -turned, 0.0]);
        agrees(
            what,
            &gradient::<ByEdges>(&s, &names, 64),
            &exactly(known),
            LOADED,
            RUNS,
        );
        let directions =
            s.admits_outlines::<Follows>(s.params().find("it.scale").expect("known"), 1);
        let message = directions.expect_err("refused").to_string();
        assert!(message.contains("parallel"), "{message}");
    }
}

/// What a film of parallel rays cuts off: a square that moves over its border, and the camera that moves along.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn parallel_rays_end_at_the_film() {
    let mut s = tests::scene(&format!(
        r#"<integrator type="path"><integer name="max_depth" value="1"/></integrator>
        <sensor type="orthographic">{FILM}</sensor>
        <shape type="rectangle" id="it"><transform name="to_world"><scale x="0.5" y="0.3"/><rotate y="1" angle="180"/>
        <translate x="0.9" y="0.1" z="2"/></transform>
        <emitter type="area"><rgb name="radiance" value="2"/></emitter></shape>"#
    ));
    let names = ["it.translation", "sensor.translation"];
    s.make_movable(&names).expect("known");
    // A side as high as 0.6 of 2, on a film as wide as 2.
    let side = 2.0 * 0.6 / 4.0;
    let known = [-side, 0.0, 0.0, side, 0.0, 0.0];
    agrees(
        "border",
        &gradient::<ByEdges>(&s, &names, 64),
        &exactly(known),
        0.0,
        RUNS,
    );
}

/// A half plane that glows, far out of focus. A place `(a, b)` of the lens sees a point `X` of the film, at unit distance, at
/// depth `z` at `a (1 - z / F) + z X`, so that the part of the lens that sees the half plane beyond `e` is a segment of a
/// circle, `(acos c - c sqrt(1 - c^2)) / pi` with `c = (e - z X) / (R |1 - z / F|)`, and its derivative in `c` is
/// `-2 sqrt(1 - c^2) / pi`. What is left is an integral over the film, by the midpoint rule. 8 runs of 64 samples.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn blurred_edges_are_segments_of_a_circle() {
    let (z, edge, fov) = (4.0, 0.11, 6f64);
    for (radius, focus) in [(0.3, 2.5), (0.25, 9.0)] {
        let mut s = tests::scene(&format!(
            r#"<integrator type="path"><integer name="max_depth" value="1"/></integrator>
            <sensor type="thinlens"><float name="fov" value="{fov}"/><float name="aperture_radius" value="{radius}"/>
            <float name="focus_distance" value="{focus}"/>{FILM}</sensor>
            <shape type="rectangle" id="it"><transform name="to_world"><scale x="30" y="30"/><rotate y="1" angle="180"/>
            <translate x="{}" z="{z}"/></transform>
            <emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>"#,
            30.0 + edge
        ));
        let names = [
            "it.translation",
            "sensor.translation",
            "sensor.fov",
            "sensor.aperture_radius",
            "sensor.focus_distance",
        ];
        s.make_movable(&names).expect("known");
        let out = 1.0 - z / focus;
        let blur = radius * f64::abs(out);
        let half = (fov.to_radians() / 2.0).tan();
        let n = 100_000;
        let mut known = [0.0; 5];
        for i in 0..n {
            let x = half * (2.0 * (f64::from(i) + 0.5) / f64::from(n) - 1.0);
            let c = (edge - z * x) / blur;
            if c.abs() >= 1.0 {
                continue;
            }
            let by_c = -2.0 / PI * (1.0 - c * c).sqrt() / f64::from(n);
            let by_out = -by_c * c / out;
            known[0] += by_c / blur;
            // Depth moves what is seen, and how far out of focus it is.
            known[1] += by_c * -x / blur - by_out / focus;
            // The angle widens by this.
            let widens = (1.0 + half * half) / half * 0.5f64.to_radians();
            known[2] += by_c * -z * x / blur * widens;
            known[3] += -by_c * c / radius;
            known[4] += by_out * z / (focus * focus);
        }
        let [by_edge, by_depth, by_fov, by_radius, by_focus] = known;
        let known = exactly([
            by_edge, 0.0, by_depth, -by_edge, 0.0, -by_depth, by_fov, by_radius, by_focus,
        ]);
        agrees(
            "edges",
            &gradient::<ByEdges>(&s, &names, 64),
            &known,
            0.0,
            RUNS,
        );
        agrees(
            "directions",
            &gradient::<Follows>(&s, &names, 64),
            &known,
            1e-2,
            RUNS,
        );
        let found = gradient::<Exactly>(&s, &names[..2], 64);
        agrees("closed", &found, &known[..6], 0.0, RUNS);
        for name in &names[2..] {
            let info = s.params().find(name).expect("known");
            let refused = s.admits_outlines::<Exactly>(info, 1).expect_err("refused");
            assert!(refused.to_string().contains("no closed form"), "{refused}");
        }
    }
}

/// Shapes before a floor, lit by a lamp, directly and through more bounces, by parallel rays and through a lens: whatever
/// moves; a camera sees all of it, lamp and floor, the other way.
/// 8 runs of 128 samples of 256 pixels, and differences of 8 runs of 256.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn edges_agree_with_differences() {
    for (plugin, what, body, depth) in [
        ("orthographic", "cube", CUBE, 2),
        ("orthographic", "ball", BALL, 3),
        ("orthographic", "tube", TUBE, 2),
        ("thinlens", "cube", CUBE, 3),
        ("thinlens", "ball", BALL, 2),
        ("thinlens", "disk", DISK, 2),
        ("thinlens", "tube", TUBE, 2),
    ] {
        let mut s = seen_through(plugin, &format!("{FLOOR}{body}"), depth);
        let names = ["it.translation", "sensor.translation"];
        s.make_movable(&names).expect("known");
        let found = gradient::<ByEdges>(&s, &names, 128);
        let expected = differences(&mut s, &names, 1.0 / 32.0, RUNS, 256);
        agrees(&format!("{plugin} {what}"), &found, &expected, 1e-2, RUNS);
    }
}

/// Turns, sizes and the angle of view, as above, with differences of 8 runs of 512 samples; what a lens is has closed forms.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn edges_agree_with_differences_of_turns_and_angles() {
    for (plugin, step) in [("orthographic", 128.0), ("thinlens", 32.0)] {
        let mut s = seen_through(plugin, &format!("{FLOOR}{CUBE}"), 2);
        let names = ["it.rotation", "it.scale", "sensor.rotation"];
        s.make_movable(&names).expect("known");
        let found = gradient::<ByEdges>(&s, &names, 128);
        let expected = differences(&mut s, &names, 1.0 / step, RUNS, 512);
        agrees(plugin, &found, &expected, 1e-2, RUNS);
        if plugin == "thinlens" {
            let name = "sensor.fov";
            s.make_movable(&[name]).expect("known");
            let found = gradient::<ByEdges>(&s, &[name], 128);
            let expected = differences(&mut s, &[name], 0.5, RUNS, 512);
            agrees(name, &found, &expected, 1e-2, RUNS);
        }
    }
}

/// Directions that follow, through a lens, as edges have it. 8 runs of 64 samples of 256 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn directions_through_a_lens_agree_with_edges() {
    let names = &["it.translation", "sensor.translation", "sensor.rotation"][..];
    for body in [CUBE, BALL] {
        let mut s = seen_through("thinlens", &format!("{FLOOR}{body}"), 2);
        s.make_movable(names).expect("known");
        let expected = gradient::<ByEdges>(&s, names, 64);
        agrees(
            "sampled",
            &gradient::<Follows>(&s, names, 64),
            &expected,
            2e-2,
            RUNS,
        );
        agrees(
            "closed",
            &gradient::<Exactly>(&s, names, 64),
            &expected,
            0.0,
            RUNS,
        );
        let name = "sensor.fov";
        s.make_movable(&[name]).expect("known");
        let expected = gradient::<ByEdges>(&s, &[name], 64);
        let found = gradient::<Follows>(&s, &[name], 64);
        agrees(name, &found, &expected, 2e-2, RUNS);
    }
}

/// A closed box with a lamp inside that moves as a whole with the camera: nothing changes, path by path and outline by outline.
#[test]
fn a_box_that_moves_with_its_camera_stays_as_it_is() {
    let body = r#"<bsdf type="diffuse" id="grey"/>
        <shape type="cube" id="box"><transform name="to_world"><scale value="6"/></transform>
            <bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
        <shape type="sphere" id="lamp"><transform name="to_world"><scale value="0.7"/><translate x="-1" y="2.5"/></transform>
            <emitter type="area"><rgb name="radiance" value="3, 4, 5"/></emitter></shape>"#;
    let names = [
        "box.translation",
        "lamp.translation",
        "it.translation",
        "sensor.translation",
    ];
    for plugin in ["orthographic", "thinlens"] {
        let mut s = seen_through(plugin, &format!("{body}{BALL}"), 3);
        s.make_movable(&names).expect("known");
        let inside = moving::gradient::<AllowBias<Interior<DetachedMis>>>(&s, &names, 2, 4);
        let all = moving::gradient::<ByEdges>(&s, &names, 2, 4);
        for found in [inside, all] {
            let size = found.iter().fold(0.0, |m: f64, e| m.max(e.mean.abs()));
            assert!(size > 1e-3, "{plugin} says nothing");
            for k in 0..3 {
                let sum: f64 = [0, 1, 2, 3].iter().map(|i| found[3 * i + k].mean).sum();
                assert!(sum.abs() < 1e-9 * size, "{plugin} {k}: {sum} of {size}");
            }
        }
    }
}

/// Where a lens is passed and which light is sampled are unrelated, however numbers are spread: a soft shadow out of focus has
/// the mean that it has by points of a sequence. 16 runs of 4096 samples of 64 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn places_on_the_lens_have_numbers_of_their_own() {
    let s = tests::scene(
        r#"<integrator type="path"><integer name="max_depth" value="2"/></integrator>
        <sensor type="thinlens"><float name="fov" value="20"/><float name="aperture_radius" value="0.8"/>
            <float name="focus_distance" value="30"/>
            <transform name="to_world"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
        <shape type="rectangle"><transform name="to_world"><scale value="5"/></transform></shape>
        <shape type="rectangle"><transform name="to_world"><scale x="1.5" y="1.5"/><rotate y="1" angle="180"/>
            <translate x="1" z="0.7"/></transform>
            <emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>"#,
    );
    let of = |points: Points| {
        let settings = Settings {
            points,
            ..s.settings
        };
        tests::picture(&s, &settings, 7, 16, 4096)
    };
    let sobol = of(Points::Sobol);
    for points in [Points::Independent, Points::Antithetic] {
        let other = of(points);
        let limit = z_limit(2 * other.len(), 16, 1e-3);
        for (a, b) in other.iter().zip(&sobol) {
            assert!(a.z(b).abs() < limit, "{points:?}: {a:?}, not {b:?}");
        }
    }
}

/// Forward mode is the transpose of reverse mode, whatever moves.
#[test]
fn modes_are_one_map() {
    let optics = [
        "sensor.fov",
        "sensor.aperture_radius",
        "sensor.focus_distance",
    ];
    let mut names = vec![
        "it.translation",
        "it.rotation",
        "lamp.scale",
        "sensor.translation",
        "sensor.rotation",
    ];
    modes_are_one::<ByEdges>("orthographic", &names);
    names.extend(optics);
    modes_are_one::<ByEdges>("thinlens", &names);
    modes_are_one::<Follows>("thinlens", &names);
    modes_are_one::<Exactly>("thinlens", &names[..5]);
}

fn modes_are_one<E: Unbiased>(plugin: &str, names: &[&str]) {
    let mut s = seen_through(plugin, &format!("{FLOOR}{BALL}"), 3);
    s.make_movable(names).expect("known");
    for d in moving::both_modes::<E>(&s, names) {
        let moving::BothModes {
            what,
            pushed,
            pulled,
            ..
        } = d;
        assert!(
            (pushed - pulled).abs() < 1e-9 * pulled.abs().max(1.0),
            "{plugin} {what}: {pushed} {pulled}"
        );
        assert!(
            pulled != 0.0 || plugin == "orthographic",
            "{what} says nothing"
        );
    }
}
