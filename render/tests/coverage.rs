//! Lights that the camera does not see, and how much of a pixel is covered.

use std::path::Path;

use render::instances::{Estimator, render_f32, render_f64};
use render::integrator::coverage::coverage;
use render::integrator::render::Rendering;
use render::params::Theta;
use render::scene::LoadOptions;
use render::{Job, Scene, Settings};

const SKY: f64 = 0.75;
const SPP: u64 = 16;

fn scene(filter: &str, body: &str) -> (Scene, Vec<String>) {
    let text = format!(
        r#"<scene version="3.0.0">
        <integrator type="path"><integer name="max_depth" value="4"/><boolean name="hide_emitters" value="true"/></integrator>
        <sensor type="perspective"><float name="fov" value="40"/><film type="hdrfilm">
            <integer name="width" value="24"/><integer name="height" value="17"/>
            <string name="pixel_format" value="rgba"/><rfilter type="{filter}"/></film></sensor>
        <emitter type="constant" id="sky"><rgb name="radiance" value="{SKY}"/></emitter>{body}</scene>"#
    );
    Scene::from_xml(&text, Path::new("."), &LoadOptions::default()).expect("a scene")
}

fn alpha(scene: &Scene, settings: &Settings) -> Vec<f32> {
    coverage(&Job::new(scene, settings, 3, 0..SPP, &())).expect("nobody stops it")
}

/// A plane in front of the camera through which light passes, and a ball behind it.
fn screen(opacity: f64, z: f64) -> String {
    format!(
        r#"<shape type="rectangle"><transform name="to_world"><scale value="50"/><translate z="{z}"/></transform>
        <bsdf type="mask"><float name="opacity" value="{opacity}"/><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf></shape>"#
    )
}

const BALL: &str = r#"<shape type="sphere"><point name="center" x="0.3" y="0" z="6"/>
    <bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf></shape>"#;

#[test]
fn holes_cover_in_part() {
    let (all, _) = scene("tent", &(screen(0.6, 5.0) + &screen(0.25, 7.0)));
    assert!(all.film.alpha && all.settings.hide_emitters);
    for a in alpha(&all, &all.settings) {
        assert!((a - (1.0 - 0.4 * 0.75)).abs() < 2e-6, "{a}");
    }
    let shown = Settings {
        hide_emitters: false,
        ..all.settings
    };
    assert!(alpha(&all, &shown).iter().all(|a| (a - 1.0).abs() < 1e-6));
    let (empty, _) = scene("mitchell", "");
    assert!(alpha(&empty, &empty.settings).iter().all(|a| *a == 0.0));
    let (null, _) = scene(
        "box",
        &format!(
            r#"{BALL}<shape type="sphere"><point name="center" x="0" y="0" z="5"/><bsdf type="null"/></shape>"#
        ),
    );
    let (ball, _) = scene("box", BALL);
    assert_eq!(alpha(&null, &null.settings), alpha(&ball, &ball.settings));
}

/// What the sky adds where nothing is, is all that is left out: with the same samples, in waves and by single paths.
#[test]
fn the_rest_of_the_image_is_as_before() {
    let (scene, warnings) = scene("mitchell", BALL);
    assert_eq!(warnings, Vec::<String>::new());
    let shown = Settings {
        hide_emitters: false,
        ..scene.settings
    };
    let cover = alpha(&scene, &scene.settings);
    // What the weights of the filter come to.
    let whole = alpha(&scene, &shown);
    let mean = cover.iter().sum::<f32>() / cover.len() as f32;
    assert!(mean > 0.1 && mean < 0.5, "{mean}");
    let doubles: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
    let single = |settings: &Settings| {
        let theta = Theta::constant(scene.params().values());
        render_f32(
            &Job::new(&scene, settings, 3, 0..SPP, &()),
            &theta,
            Estimator::Mis,
        )
    };
    let double = |settings: &Settings| {
        let theta = Theta::constant(&doubles);
        render_f64(
            &Job::new(&scene, settings, 3, 0..SPP, &()),
            &theta,
            Estimator::Mis,
        )
    };
    // Weights of the filter follow places, which have more digits in double precision.
    let check = |with: Rendering, without: Rendering, most: f32| {
        let both = with.image(0).data.into_iter().zip(without.image(0).data);
        for (i, (a, b)) in both.enumerate() {
            let sky = (whole[i / 3] - cover[i / 3]) * SKY as f32;
            assert!((a - b - sky).abs() < most, "{i}: {a} {b} {sky}");
        }
    };
    check(single(&shown), single(&scene.settings), 1e-5);
    check(double(&shown), double(&scene.settings), 2e-4);
}

/// Whatever lies behind lamps covers, be they one behind the other, of one side or in one plane with something; and lamps
/// cover where they are seen through something.
#[test]
fn lamps_do_not_cover() {
    let lamps = r#"<shape type="sphere"><point name="center" x="0" y="0" z="4"/><emitter type="area"/></shape>
        <shape type="disk"><transform name="to_world"><scale value="0.8"/><translate z="2.5"/></transform>
        <emitter type="area"/></shape><shape type="rectangle"><transform name="to_world"><translate z="5"/></transform>
        <emitter type="directionalarea"/></shape>"#;
    for behind in [
        BALL,
        "",
        &screen(0.3, 5.0),
        &(screen(0.6, 5.0) + &screen(0.25, 7.0)),
    ] {
        let [(with, warnings), (without, _)] =
            [lamps, ""].map(|lamps| scene("tent", &format!("{behind}{lamps}")));
        assert_eq!(warnings, Vec::<String>::new());
        let cover = alpha(&with, &with.settings);
        assert_eq!(cover, alpha(&without, &without.settings));
        let shown = Settings {
            hide_emitters: false,
            ..with.settings
        };
        let whole = alpha(&with, &shown);
        assert!(whole.iter().all(|a| (a - 1.0).abs() < 1e-6));
    }
    let (before, _) = scene("box", &format!("{}{lamps}", screen(0.25, 1.0)));
    let cover = alpha(&before, &before.settings);
    let values = || cover.iter().map(|a| f64::from(*a));
    assert!(values().any(|a| (a - 1.0).abs() < 1e-6), "a lamp");
    assert!(values().any(|a| (a - 0.25).abs() < 1e-6), "the sky");
}
