//! What stands in odd places, or folds over itself: derivatives in what moves are numbers, or refused by name, and right.

use render::RenderError;
use render::estimator::{
    AttachedWeights, Convolved, Detached, DetachedMis, Interior, Mis, Outlines, Reparameterised,
    Unbiased,
};
use render::instances::Estimator;
use render::integrator::gradient::{Active, backward};
use render::params::Theta;
use render::sampler::Independent;
use render::{Job, Scene};
use tests::moving::{self, CUBE, FLOOR, agrees, differences, differences_in, scene};
use tests::{mean_adjoint, values};

type ByEdges = Outlines<Interior<DetachedMis>>;
type Follows = Convolved<Mis<Reparameterised, Detached, AttachedWeights>>;

const RUNS: u64 = 8;
const SPP: u64 = 16;

/// A light at a point.
fn bulb(at: [f64; 3]) -> String {
    let [x, y, z] = at;
    format!(
        r#"<emitter type="point" id="bulb"><point name="position" x="{x}" y="{y}" z="{z}"/>
        <rgb name="intensity" value="9, 8, 7"/></emitter>"#
    )
}

/// A closed cube `it` of this half width around the camera of [`scene`].
fn closed(size: f64) -> String {
    format!(
        r#"<shape type="cube" id="it"><transform name="to_world"><scale value="{size}"/><rotate x="1" y="1" angle="20"/>
        <translate y="3" z="5"/></transform><bsdf type="twosided"><ref id="grey"/></bsdf></shape>"#
    )
}

/// The lamp of [`FLOOR`] goes through a cube `it`, in which most of it is hidden.
const SUNK: &str = r#"<shape type="cube" id="it"><transform name="to_world"><scale value="0.4"/><rotate y="1" angle="25"/>
    <translate x="0.7" y="3.1" z="-0.3"/></transform><ref id="grey"/></shape>"#;

/// Four faces around a vertex, the first of the file, which is pulled over one side: the face there is turned over.
fn folded(folder: &tempfile::TempDir) -> String {
    let path = folder.path().join("folded.obj");
    let text = "v 1.5 0.2 0.1\nv -0.8 0 -0.8\nv -0.8 0 0.8\nv 0.8 0 0.8\nv 0.8 0 -0.8\n\
                f 1 2 3\nf 1 3 4\nf 1 4 5\nf 1 5 2\n";
    std::fs::write(&path, text).expect("a file");
    format!(
        r#"<shape type="obj" id="it"><string name="filename" value="{}"/><boolean name="face_normals" value="true"/>
        <transform name="to_world"><rotate x="1" angle="15"/><translate x="-0.2" y="1"/></transform>
        <bsdf type="twosided"><ref id="grey"/></bsdf></shape>"#,
        path.display()
    )
}

/// In double precision.
fn wide<E: Unbiased>(s: &Scene, names: &[&str]) -> Result<Vec<f64>, RenderError> {
    let all = values::<f64>(s);
    let active = Active::seen_by::<E, _>(s, names)?;
    let job = Job::new(s, &s.settings, 3, 0..SPP, &());
    let theta = Theta::constant(&all);
    let g = backward::<f64, E, Independent>(&job, &theta, &active, &mean_adjoint(s))?;
    assert_eq!(g.non_finite.count, 0);
    Ok(g.values.concat())
}

/// In single precision.
fn single(e: Estimator, s: &Scene, names: &[&str]) -> Result<Vec<f64>, RenderError> {
    let active = e.active(s, names)?;
    let job = Job::new(s, &s.settings, 3, 0..SPP, &());
    let theta = Theta::constant(s.params().values());
    let g = e.backward_f32(&job, &theta, &active, &mean_adjoint(s))?;
    assert_eq!(g.non_finite.count, 0);
    Ok(g.values.concat())
}

/// A bulb in a cube, on the floor and on its corner, a lamp that is sunk in a cube, a camera in a closed cube, dark or with the lamp
/// in it, and a mesh that folds, each by samples of edges and by directions that follow them, in both precisions.
#[test]
fn odd_places_are_finite_or_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let bulbs = [
        ("bulb in a cube", [0.0, 1.1, 0.0]),
        ("bulb on the floor", [0.5, 0.0, 0.5]),
        ("bulb on the corner of the floor", [4.0, 0.0, -4.0]),
    ];
    let mut cases: Vec<(&str, String, u32, Vec<&str>)> = Vec::new();
    for (what, at) in bulbs {
        let names = vec!["it.translation", "bulb.position", "sensor.translation"];
        cases.push((what, format!("{CUBE}{}", bulb(at)), 2, names));
    }
    let camera = vec!["it.translation", "it.rotation", "sensor.translation"];
    let lamp = vec!["it.translation", "lamp.translation", "lamp.scale"];
    let points = vec!["it.vertex_positions", "it.translation"];
    cases.push(("sunk lamp", SUNK.into(), 4, lamp));
    cases.push(("camera in a dark cube", closed(0.7), 4, camera.clone()));
    cases.push(("camera in a cube with a lamp", closed(7.0), 4, camera));
    cases.push(("folded mesh", folded(&folder), 4, points));
    for (what, body, depth, names) in cases {
        let mut s = scene(&format!("{FLOOR}{body}"), depth);
        s.make_movable(&names).expect("known");
        let follows = Estimator::ReparameterisedMis;
        let found = [
            wide::<ByEdges>(&s, &names),
            single(Estimator::Edges, &s, &names),
            wide::<Follows>(&s, &names),
            single(follows, &s, &names),
        ];
        for (k, found) in found.into_iter().enumerate() {
            match found {
                Ok(all) => {
                    assert!(all.iter().all(|d| d.is_finite()), "{what} {k}: {all:?}");
                    let dark = what == "camera in a dark cube";
                    assert_eq!(all.iter().all(|d| *d == 0.0), dark, "{what} {k}: {all:?}");
                }
                Err(e) => {
                    let message = e.to_string();
                    let named = "shadows of lights without area have outlines without samples";
                    assert!(message.contains(named), "{what} {k}: {message}");
                    assert!(k >= 2 && what.starts_with("bulb"), "{what} {k}: {message}");
                }
            }
        }
    }
}

/// Particles know no lens: what bounces from where shadows of a bulb end has no samples there, and is refused by name.
#[test]
fn shadows_that_bounce_are_refused_through_a_lens() {
    let bulb = r#"<emitter type="point"><point name="position" x="-1" y="3" z="0.5"/></emitter>"#;
    let of = |depth: u32| {
        let text = format!(
            r#"<integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
            <sensor type="thinlens"><float name="fov" value="45"/><float name="aperture_radius" value="0.1"/>
            <float name="focus_distance" value="5"/><transform name="to_world"><lookat origin="0, 3, 5"
            target="0, 0.4, 0" up="0, 1, 0"/></transform><film type="hdrfilm"><integer name="width" value="8"/>
            <integer name="height" value="8"/><rfilter type="box"/></film></sensor>{FLOOR}{bulb}{CUBE}"#
        );
        let mut s = tests::scene(&text);
        let names = ["it.translation"];
        s.make_movable(&names).expect("known");
        single(Estimator::Edges, &s, &names)
    };
    let all = of(2).expect("admitted");
    assert!(all.iter().all(|d| d.is_finite() && *d != 0.0), "{all:?}");
    let message = of(3).expect_err("refused").to_string();
    assert!(message.contains("the camera is no pinhole"), "{message}");
}

/// Rays begin on the film of a camera whose rays are parallel, and on a lens: a shape that reaches through that is cut, and where it
/// is cut moves without samples. It is refused by name, with what moves it and with what moves the camera, and not where it
/// only passes beside or behind.
#[test]
fn what_the_camera_cuts_is_refused() {
    let at = r#"<transform name="to_world">SCALE<lookat origin="0, 1, 0.5" target="0, 1, -4" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film>"#;
    let scaled = at.replace("SCALE", r#"<scale x="0.6" y="0.6"/>"#);
    let parallel = format!(r#"<sensor type="orthographic" id="sensor">{scaled}</sensor>"#);
    let lens = format!(
        r#"<sensor type="thinlens" id="sensor"><float name="fov" value="45"/><float name="aperture_radius" value="0.2"/>
        <float name="focus_distance" value="3"/>{}</sensor>"#,
        at.replace("SCALE", "")
    );
    let ball = |x: f64, z: f64| {
        format!(
            r#"<shape type="sphere" id="it"><point name="center" x="{x}" y="1" z="{z}"/><float name="radius" value="0.3"/>
            <ref id="grey"/></shape>"#
        )
    };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("octahedron.obj");
    std::fs::write(&path, moving::octahedron()).expect("a file");
    // Its equator is in the plane of the film.
    let mesh = format!(
        r#"<shape type="obj" id="it"><string name="filename" value="{}"/><transform name="to_world"><scale value="0.15"/>
        <translate y="1" z="0.5"/></transform><ref id="grey"/></shape>"#,
        path.display()
    );
    for (what, camera, it, cut) in [
        ("a ball on the film", &parallel, ball(0.1, 0.4), true),
        ("a mesh on the film", &parallel, mesh.clone(), true),
        ("a ball on the lens", &lens, ball(0.1, 0.4), true),
        ("a mesh on the lens", &lens, mesh, true),
        ("a ball before the film", &parallel, ball(0.1, 0.0), false),
        ("a ball beside the film", &parallel, ball(1.0, 0.5), false),
        ("a ball behind the film", &parallel, ball(0.1, 1.0), false),
        ("a ball beside the lens", &lens, ball(0.6, 0.5), false),
    ] {
        let mut s = tests::scene(&format!("{camera}{FLOOR}{it}"));
        let names = ["it.translation", "sensor.translation", "floor.translation"];
        s.make_movable(&names).expect("known");
        for (name, cut) in names.into_iter().zip([cut, cut, false]) {
            let found = single(Estimator::Edges, &s, &[name]);
            match found {
                Ok(_) => assert!(!cut, "{what}: {name}"),
                Err(e) => {
                    let message = e.to_string();
                    let named = message.contains("`it` reaches through the surface");
                    assert!(cut && named && message.contains(name), "{what}: {message}");
                }
            }
        }
    }
}

/// Where a ball goes through what sends a beam, that ends at the line along which they cross: it has no samples, and is refused by
/// name. A ball above or below it is not.
#[test]
fn beams_that_are_crossed_are_refused() {
    let of = |y: f64| {
        let mut s = scene(
            &format!(
                r#"{FLOOR}<shape type="sphere" id="it"><point name="center" x="0" y="{y}" z="0"/><float name="radius" value="0.4"/>
                <ref id="grey"/></shape><shape type="rectangle" id="beam"><transform name="to_world">
                <rotate x="1" angle="90"/><translate y="1.5"/></transform>
                <emitter type="directionalarea"/></shape>"#
            ),
            2,
        );
        let names = ["it.translation"];
        s.make_movable(&names).expect("known");
        single(Estimator::Edges, &s, &names)
    };
    for y in [0.8, 2.2] {
        assert!(
            of(y).expect("admitted").iter().all(|d| d.is_finite()),
            "{y}"
        );
    }
    let message = of(1.7).expect_err("refused").to_string();
    assert!(message.contains("`it` goes through `beam`"), "{message}");
}

/// Faces as wide as corners are rounded, between others and beside them, change nothing: a turned square of two faces with
/// such ones in it, and without. 4 runs of 16 samples with the same seeds.
#[test]
fn needles_have_no_outlines() {
    let folder = tempfile::tempdir().expect("a folder");
    let square = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nv 0 0 0\nf 1 4 3\nf 1 3 2\n";
    let of = |name: &str, more: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, format!("{square}{more}")).expect("a file");
        let mut s = scene(
            &format!(
                r#"{FLOOR}<shape type="obj" id="it"><string name="filename" value="{}"/><boolean name="face_normals" value="true"/>
                <transform name="to_world"><scale value="0.7"/><rotate x="1" y="0.3" angle="17"/><translate x="0.1" y="1"/>
                </transform><bsdf type="twosided"><ref id="grey"/></bsdf></shape>"#,
                path.display()
            ),
            2,
        );
        let names = ["it.translation", "it.rotation"];
        s.make_movable(&names).expect("known");
        moving::gradient::<ByEdges>(&s, &names, 4, 16)
    };
    let plain = of("plain.obj", "");
    let needles = of("needles.obj", "f 1 5 3\nf 1 1 2\nf 3 5 1\n");
    for (a, b) in plain.iter().zip(&needles) {
        assert!(
            (a.mean - b.mean).abs() <= 1e-4 * a.mean.abs() + 1e-7,
            "{a:?} {b:?}"
        );
    }
}

/// Of a mesh that folds, as a whole and at the vertex that is pulled, and of a lamp that is sunk in a cube. 8 runs of 256
/// samples of 256 pixels, and differences of 8 runs of 512.
#[test]
fn folds_and_sunk_lamps_agree_with_differences() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut s = scene(&format!("{FLOOR}{}", folded(&folder)), 2);
    let names = ["it.translation", "it.vertex_positions"];
    s.make_movable(&names).expect("known");
    assert_eq!(s.folded(), [("it".to_owned(), 1, 4)]);
    let found = moving::gradient::<ByEdges>(&s, &names, RUNS, 256);
    let first = |name: &str| s.params().find(name).expect("known").offset;
    let elements: Vec<usize> = (names.map(first).iter().flat_map(|&i| i..i + 3)).collect();
    let expected = differences_in(&mut s, &elements, 1.0 / 64.0, RUNS, 512);
    agrees("folded", &found[..6], &expected, 1e-2, RUNS);

    let mut s = scene(&format!("{FLOOR}{SUNK}"), 2);
    let names = ["it.translation", "lamp.translation"];
    s.make_movable(&names).expect("known");
    let found = moving::gradient::<ByEdges>(&s, &names, RUNS, 256);
    let expected = differences(&mut s, &names, 1.0 / 64.0, RUNS, 512);
    agrees("sunk", &found, &expected, 1e-2, RUNS);
}
