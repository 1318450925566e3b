//! Derivatives in what moves where there are mirrors, smooth glass and holes: by directions that follow outlines, also those
//! that are seen over such surfaces. They are right in the limit of a narrow kernel: a part of the largest derivative is
//! allowed for that.

use render::estimator::{
    AttachedWeights, BsdfOnly, Convolved, Detached, Mis, Reparameterised, Unbiased,
};
use render::instances::{Direction, Estimator};
use render::integrator::gradient::{Active, backward};
use render::params::Theta;
use render::sampler::Independent;
use render::statistics::Estimate;
use render::{Job, Scene};
use tests::moving::{self, FLOOR, differences, scene};
use tests::{mean_adjoint, values};

type Follows = Convolved<Mis<Reparameterised, Detached, AttachedWeights>>;
type FollowsBsdf = Convolved<BsdfOnly<Reparameterised>>;

const RUNS: u64 = 8;

/// A ball `it`, and a mirror behind it.
const BALL_AND_MIRROR: &str = r#"
    <shape type="sphere" id="it"><float name="radius" value="0.6"/><transform name="to_world">
        <translate x="-0.4" y="0.9" z="0.4"/></transform><ref id="grey"/></shape>
    <shape type="rectangle" id="mirror"><transform name="to_world"><scale x="1.6" y="1"/><rotate y="1" angle="12"/>
        <translate x="0.3" y="1.1" z="-1"/></transform><bsdf type="conductor"/></shape>"#;

/// A ball of glass `it` above the floor.
const GLASS: &str = r#"
    <shape type="sphere" id="it"><float name="radius" value="0.7"/><transform name="to_world">
        <translate x="0.1" y="1" z="0.6"/></transform><bsdf type="dielectric"/></shape>
    <shape type="cube" id="block"><transform name="to_world"><scale value="0.3"/><rotate y="1" angle="25"/>
        <translate x="-0.2" y="0.3" z="-0.9"/></transform><ref id="grey"/></shape>"#;

/// A lacquered ball `it` and a pane with holes, before a block.
const LACQUER: &str = r#"
    <shape type="sphere" id="it"><float name="radius" value="0.6"/><transform name="to_world">
        <translate x="-0.9" y="0.9" z="0.2"/></transform><bsdf type="plastic"/></shape>
    <shape type="rectangle" id="pane"><transform name="to_world"><scale value="0.8"/><rotate y="1" angle="-20"/>
        <translate x="0.5" y="0.9" z="0.9"/></transform><bsdf type="mask"><float name="opacity" value="0.5"/>
        <bsdf type="thindielectric"/></bsdf></shape>
    <shape type="cube" id="block"><transform name="to_world"><scale value="0.3"/><rotate y="1" angle="25"/>
        <translate x="0.5" y="0.4" z="-0.5"/></transform><ref id="grey"/></shape>"#;

fn movable(body: &str, depth: u32, names: &[&str]) -> Scene {
    let mut s = scene(&format!("{FLOOR}{body}"), depth);
    s.make_movable(names).expect("known");
    s
}

fn gradient<E: Unbiased>(s: &Scene, names: &[&str], spp: u64) -> Vec<Estimate> {
    moving::gradient::<E>(s, names, RUNS, spp)
}

/// A square that glows above the axis of view, in a mirror that stands across: the derivative of a projected area, of the
/// square that seems to be behind the mirror. The mirror, moved along the axis, moves it twice as far along its normal. 8 runs
/// of 64 samples of 256 pixels.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn what_a_mirror_shows_changes_as_it_should() {
    let width = 2.0 * 25f64.to_radians().tan();
    let (before, beyond) = (3.0, 2.0);
    let distance = before + beyond;
    let mut s = tests::scene(&format!(
        r#"<integrator type="path"><integer name="max_depth" value="3"/></integrator>
        <sensor type="perspective"><float name="fov" value="50"/><film type="hdrfilm">
        <integer name="width" value="16"/><integer name="height" value="16"/><rfilter type="box"/></film></sensor>
        <shape type="rectangle" id="mirror"><transform name="to_world"><scale value="40"/><rotate x="1" angle="-135"/>
        <translate z="{before}"/></transform><bsdf type="twosided"><bsdf type="conductor"/></bsdf></shape>
        <shape type="rectangle" id="it"><transform name="to_world"><rotate x="1" angle="90"/>
        <translate y="{beyond}" z="{before}"/></transform>
        <bsdf type="diffuse"/><emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>"#
    ));
    let names = [
        "it.translation",
        "it.scale",
        "mirror.translation",
        "sensor.translation",
    ];
    s.make_movable(&names).expect("known");
    let part = 4.0 / (distance * width).powi(2);
    let away = -2.0 * part / distance;
    let expected = [
        [0.0, away, 0.0].as_slice(),
        &[2.0 * part],
        &[0.0, -away, away],
        &[0.0, 0.0, -away],
    ]
    .concat();
    let known: Vec<_> = expected.into_iter().map(Estimate::exact).collect();
    moving::agrees(
        "mirror",
        &gradient::<Follows>(&s, &names, 64),
        &known,
        1e-2,
        RUNS,
    );
    moving::agrees(
        "mirror",
        &gradient::<FollowsBsdf>(&s, &names, 64),
        &known,
        1e-2,
        RUNS,
    );
}

/// What glows in the dark, seen in a plane mirror and in a round one, through a ball of glass and through a pane with holes:
/// central differences of images with random numbers of their own. 8 runs of 128 samples of 256 pixels, and of 1024 for
/// differences.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn directions_that_follow_over_deltas_agree_with_differences() {
    let glows = r#"<emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter>"#;
    let glows = |body: &str| body.replace(r#"<ref id="grey"/>"#, glows);
    let round = r#"<shape type="sphere" id="round"><float name="radius" value="0.5"/><transform name="to_world">
        <translate x="0.7" y="0.5" z="0.8"/></transform><bsdf type="conductor"/></shape>"#;
    let mirrors = format!("{}{round}", glows(BALL_AND_MIRROR));
    let (glass, lacquer) = (glows(GLASS), glows(LACQUER));
    for (what, body, depth, names) in [
        ("glowing ball", &mirrors, 3, &["it.translation"][..]),
        (
            "mirrors",
            &mirrors,
            3,
            &["mirror.translation", "mirror.rotation", "round.translation"],
        ),
        ("glass", &glass, 4, &["it.translation", "it.scale"]),
        ("behind glass", &glass, 4, &["block.translation"]),
        (
            "behind a pane",
            &lacquer,
            3,
            &["block.translation", "pane.translation"],
        ),
    ] {
        let mut s = scene(body, depth);
        s.make_movable(names).expect("known");
        let found = gradient::<Follows>(&s, names, 128);
        let expected = differences(&mut s, names, 1.0 / 64.0, RUNS, 1024);
        moving::agrees(what, &found, &expected, 3e-2, RUNS);
    }
}

/// Nothing changes where all moves, to rounding: path by path, over mirrors, glass and holes.
#[test]
fn what_moves_as_a_whole_changes_nothing() {
    for (body, shapes) in [
        (BALL_AND_MIRROR, &["it", "mirror"][..]),
        (GLASS, &["it", "block"]),
        (LACQUER, &["it", "pane", "block"]),
    ] {
        let all = ["floor", "lamp", "sensor"].iter().chain(shapes);
        let names: Vec<String> = all.map(|name| format!("{name}.translation")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let s = movable(body, 5, &names);
        let all = values::<f64>(&s);
        let theta = Theta::constant(&all);
        let active = Active::seen_by::<Follows, _>(&s, &names).expect("seen");
        let job = Job::new(&s, &s.settings, 3, 0..4, &());
        let g = backward::<f64, Follows, Independent>(&job, &theta, &active, &mean_adjoint(&s));
        let g = g.expect("admitted");
        for axis in 0..3 {
            let each = g.values.iter().map(|v| v[axis]);
            let (sum, size) = (each.clone().sum::<f64>(), each.map(f64::abs).sum::<f64>());
            assert!(
                size > 1e-3 && sum.abs() < 1e-6 * size,
                "{axis}: {sum} of {size}"
            );
        }
    }
}

/// Forward mode is the transpose of reverse mode, to rounding.
#[test]
fn both_modes_are_one_linear_map() {
    for (body, names) in [
        (BALL_AND_MIRROR, &["it.translation", "mirror.rotation"][..]),
        (GLASS, &["it.scale", "sensor.translation"]),
    ] {
        let s = movable(body, 4, names);
        moving::modes_are_one_map::<Follows>("", &s, names);
    }
}

/// In single precision nothing is lost, whatever rays meet: images of mirrors in mirrors, total reflection and caustics. 64
/// samples of 256 pixels of each scene.
#[test]
fn derivatives_are_finite_in_single_precision() {
    let mirrors = BALL_AND_MIRROR.replace(r#"<ref id="grey"/>"#, r#"<bsdf type="conductor"/>"#);
    for body in [&mirrors, GLASS, LACQUER] {
        let names = ["it.translation", "sensor.rotation", "lamp.scale"];
        let s = movable(body, 8, &names);
        let all = values::<f32>(&s);
        let e = Estimator::ReparameterisedMis;
        let active = e.active(&s, &names).expect("seen");
        let job = Job::new(&s, &s.settings, 3, 0..64, &());
        let g = e.backward_f32(&job, &Theta::constant(&all), &active, &mean_adjoint(&s));
        let g = g.expect("admitted");
        assert_eq!(g.non_finite.count, 0);
        assert!(g.values.concat().iter().all(|d| d.is_finite()));
    }
}

/// Others refuse what moves there, and say why.
#[test]
fn others_refuse_deltas() {
    let s = movable(BALL_AND_MIRROR, 3, &["it.translation"]);
    for e in [
        Estimator::Edges,
        Estimator::Interior,
        Estimator::ReparameterisedExact,
    ] {
        let refused = e.active(&s, &["it.translation"]).map(|_| ());
        let message = refused.expect_err("refused").to_string();
        assert!(
            message.contains("`mirror` scatters along a Dirac delta"),
            "{e:?}: {message}"
        );
    }
    let direction = Direction::uniform(s.params(), "it.translation").expect("known");
    let job = Job::new(&s, &s.settings, 0, 0..1, &());
    let forward = Estimator::Edges.forward_f32(&job, s.params().values(), &[direction]);
    assert!(forward.is_err());
}
