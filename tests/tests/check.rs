//! Checks of gradients: what is right is called right, what is biased on purpose wrong, and what a budget cannot decide
//! is not decided.

use render::auto::Mixture;
use render::check::{Along, DIRECTIONS, Options, Report, Verdict, check, most_passes};
use render::image_io::write_exr;
use render::instances::Estimator;
use render::integrator::render::Progress;
use render::{Image, Scene, Settings};
use tests::moving::{self, BALL, FLOOR};
use tests::{mean_adjoint, scene};

const OPTIONS: Options = Options {
    repeats: 32,
    tolerance: 0.2,
    significance: 1e-3,
    seed: 1,
};

/// A plate of rough metal that mirrors two ball lights, and paint that wears off metal beside it, under a dim sky.
fn plates() -> Scene {
    let ball = |center: &str, radius: f64, radiance: &str| {
        format!(
            r#"<shape type="sphere"><point name="center" value="{center}"/><float name="radius" value="{radius}"/>
            <emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter></shape>"#
        )
    };
    scene(&format!(
        r#"<sensor type="perspective"><float name="fov" value="24"/>
        <transform name="to_world"><lookat origin="0, 2.2, 3.6" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
        <rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="3"/></integrator>
        <bsdf type="roughconductor" id="metal"><float name="alpha" value="0.15"/>
        <string name="material" value="none"/><rgb name="specular_reflectance" value="1, 0.5, 0"/></bsdf>
        <bsdf type="blendbsdf" id="worn"><float name="weight" value="0.4"/>
        <bsdf type="diffuse"><texture type="checkerboard" name="reflectance"/></bsdf><ref id="metal"/></bsdf>
        <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><translate x="-1"/></transform>
        <ref id="metal"/></shape>
        <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><translate x="1"/></transform>
        <ref id="worn"/></shape>{}{}
        <emitter type="constant" id="sky"><rgb name="radiance" value="0.3, 0.2, 0"/></emitter>"#,
        ball("-0.6, 2, -3.2", 0.6, "4, 3, 2"),
        ball("1.2, 2.2, -3", 0.3, "6, 7, 8"),
    ))
}

fn run(scene: &mut Scene, estimator: Estimator, names: &[&str], spp: u32) -> Report {
    run_with(scene, estimator, names, spp, &OPTIONS)
}

fn run_with(
    scene: &mut Scene,
    estimator: Estimator,
    names: &[&str],
    spp: u32,
    options: &Options,
) -> Report {
    let adjoint = mean_adjoint(scene);
    run_along(scene, estimator, names, spp, options, &adjoint)
}

fn run_along(
    scene: &mut Scene,
    estimator: Estimator,
    names: &[&str],
    spp: u32,
    options: &Options,
    adjoint: &[f32],
) -> Report {
    let settings = Settings {
        spp,
        ..scene.settings
    };
    let mixture = Mixture::only(scene, estimator, names);
    let report = check(scene, &settings, names, &mixture, adjoint, options, &());
    let report = report
        .expect("parameters that are seen")
        .expect("nobody stops it");
    println!("{}\n{report}", estimator.name());
    report
}

/// 32 repeats of 64 samples; a significance of 1e-3. Colours at both ends of their interval among them.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn what_is_right_is_called_right() {
    let mut s = plates();
    let names = [
        "metal.alpha.value",
        "metal.specular_reflectance.value",
        "worn.weight.value",
        "sky.radiance.value",
    ];
    let before = s.params().values().to_vec();
    for estimator in [Estimator::Mis, Estimator::DifferentialMis] {
        let report = run(&mut s, estimator, &names, 64);
        assert_eq!(report.verdict(), Verdict::Right);
        assert_eq!(report.params.len(), names.len());
        assert_eq!(report.params[1].comparisons.len(), 3);
        assert_eq!(report.params[1].comparisons[2].along, Along::Value(2));
    }
    assert_eq!(s.params().values(), before);
}

/// 32 repeats of 64 samples; the differences are four times as sure at the second look.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn what_is_biased_is_called_wrong() {
    let mut s = plates();
    for (estimator, name) in [
        (Estimator::AttachedNaive, "metal.alpha.value"),
        (Estimator::BiasedWeights, "metal.alpha.value"),
        (Estimator::BiasedAttachedWeights, "metal.alpha.value"),
        (Estimator::BiasedMixed, "metal.alpha.value"),
        (Estimator::BiasedChoice, "worn.weight.value"),
    ] {
        let report = run(&mut s, estimator, &[name], 64);
        assert_eq!(report.verdict(), Verdict::Wrong, "{}", estimator.name());
    }
}

/// 8 samples cannot decide on a derivative whose noise is larger than itself; nor can any number on what is never seen.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn what_a_budget_cannot_tell_is_left_open() {
    let mut s = plates();
    let report = run(&mut s, Estimator::Mis, &["metal.alpha.value"], 8);
    assert_eq!(report.verdict(), Verdict::CannotTell);
    // Wrong, but noisier than that.
    let few = Options {
        repeats: 4,
        ..OPTIONS
    };
    let report = run_with(
        &mut s,
        Estimator::BiasedChoice,
        &["worn.weight.value"],
        1,
        &few,
    );
    assert_eq!(report.verdict(), Verdict::CannotTell);
    let mut s = scene(
        r#"<sensor type="perspective"><float name="fov" value="40"/>
        <film type="hdrfilm"><integer name="width" value="2"/><integer name="height" value="2"/></film></sensor>
        <bsdf type="diffuse" id="paint"/>
        <shape type="rectangle"><transform name="to_world"><translate z="-3"/></transform><ref id="paint"/></shape>
        <emitter type="constant"/>"#,
    );
    let report = run(&mut s, Estimator::Mis, &["paint.reflectance.value"], 8);
    assert_eq!(report.verdict(), Verdict::CannotTell);
    assert!(report.to_string().contains("nothing was seen of it"));
}

/// Textures along random directions, texels at the ends of their interval among them. 32 repeats of 64 samples.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn textures_are_checked_along_random_directions() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("paint.exr");
    let mut texels = Image::new(4, 4);
    for (i, x) in texels.data.iter_mut().enumerate() {
        *x = [0.0, 0.3, 0.9, 1.0, 0.5][i % 5];
    }
    write_exr(&path, &texels).expect("a folder to write to");
    let mut s = scene(&format!(
        r#"<sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
        <bsdf type="diffuse" id="paint"><texture type="bitmap" name="reflectance">
        <string name="filename" value="{}"/><boolean name="raw" value="true"/></texture></bsdf>
        <shape type="rectangle"><ref id="paint"/></shape>
        <emitter type="constant"/>"#,
        path.display()
    ));
    let key = "paint.reflectance.data";
    let report = run(&mut s, Estimator::Mis, &[key], 64);
    assert_eq!(report.verdict(), Verdict::Right);
    let comparisons = &report.params[0].comparisons;
    assert_eq!(comparisons.len(), DIRECTIONS as usize);
    // The directions differ.
    assert!(comparisons[0].differences.mean != comparisons[1].differences.mean);
}

/// An octahedron `it` above a floor, lit by a `bulb` and by a `sky` of a few texels, in 8 x 8 pixels.
fn octahedron(folder: &tempfile::TempDir) -> Scene {
    let [mesh, sky] = ["it.obj", "sky.exr"].map(|name| folder.path().join(name));
    std::fs::write(&mesh, moving::octahedron()).expect("a file");
    let mut texels = Image::new(8, 4);
    for (i, x) in texels.data.iter_mut().enumerate() {
        *x = (0.3 + 0.25 * (1.7 * (i / 3) as f64).sin()) as f32;
    }
    write_exr(&sky, &texels).expect("a folder to write to");
    scene(&format!(
        r#"<sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 2.5, 4.5" target="0, 0.6, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
        <rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="2"/></integrator>
        <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf>
        <shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>
        <ref id="grey"/></shape>
        <shape type="obj" id="it"><string name="filename" value="{}"/><boolean name="face_normals" value="true"/>
        <transform name="to_world"><scale value="0.8"/><rotate y="1" angle="25"/><rotate x="1" angle="20"/>
        <translate y="1.1"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.2, 0.9"/></bsdf></shape>
        <emitter type="point" id="bulb"><point name="position" x="-1" y="3" z="1.5"/>
        <rgb name="intensity" value="12, 11, 10"/></emitter>
        <emitter type="envmap" id="sky"><string name="filename" value="{}"/></emitter>"#,
        mesh.display(),
        sky.display()
    ))
}

/// By edges: shapes as a whole and point by point, the camera, lights. An image that is weighed unevenly, so that what crosses
/// it counts. 32 repeats of 96 samples of 64 pixels; how the octahedron and
/// the camera turn and how its points move need not be told at that budget.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn what_moves_is_checked() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut s = octahedron(&folder);
    let names = [
        "it.translation",
        "it.rotation",
        "it.scale",
        "it.vertex_positions",
        "sensor.rotation",
        "sensor.fov",
        "bulb.position",
        "sky.rotation",
    ];
    s.make_movable(&names).expect("things that move");
    let before = s.params().values().to_vec();
    let options = Options {
        tolerance: 0.6,
        ..OPTIONS
    };
    let weight = |i: usize| 1.0 + 2.0 * (i / 3 % 8) as f32 - 1.5 * (i / 24) as f32;
    let uneven: Vec<f32> = (0..192).map(|i| weight(i) / 192.0).collect();
    let edges = Estimator::Edges;
    let report = run_along(&mut s, edges, &names, 96, &options, &uneven);
    let hard = ["it.rotation", "it.vertex_positions", "sensor.rotation"];
    for param in &report.params {
        let verdict = param.verdict();
        let told = verdict == Verdict::Right;
        let open = verdict == Verdict::CannotTell && hard.contains(&param.name.as_str());
        assert!(told || open, "{}: {verdict:?}", param.name);
        let along = [Along::Value(0), Along::Random(0)];
        let whole = param.name != "it.vertex_positions";
        assert_eq!(param.comparisons[0].along, along[usize::from(!whole)]);
    }
    assert_eq!((report.params.len(), report.non_finite), (names.len(), 0));
    assert_eq!(s.params().values(), before);
    // The same with hardly any samples.
    let few = Options {
        repeats: 4,
        ..options
    };
    let report = run_along(&mut s, edges, &names[..1], 1, &few, &uneven);
    assert_eq!(report.verdict(), Verdict::CannotTell);
    // What becomes visible or hidden is most of the derivative of a ball.
    let mut s = moving::scene(&format!("{FLOOR}{BALL}"), 2);
    s.make_movable(&names[..1]).expect("a ball");
    let report = run(&mut s, Estimator::Interior, &names[..1], 8);
    assert_eq!(report.verdict(), Verdict::Wrong);
}

/// A glowing mesh of two squares, of which one ends in the picture and the other begins 0.03 outside of it: steps up to a fifth
/// of the whole move that into view, on one side, where two of them agree on the wrong derivative. The smallest look sees it.
/// 8 repeats of 64 samples.
#[test]
fn kinks_within_the_step_are_not_called_wrong() {
    let folder = tempfile::tempdir().expect("a folder");
    let mesh = folder.path().join("squares.obj");
    let square = |x: [f64; 2], k: usize| {
        let corners = [[x[0], -1.0], [x[1], -1.0], [x[1], 1.0], [x[0], 1.0]];
        let corners = corners.map(|[x, y]| format!("v {x} {y} 0\n")).concat();
        corners + &format!("f {} {} {} {}\n", k + 1, k + 2, k + 3, k + 4)
    };
    // The picture is from -2 to 2.
    let squares = square([0.5, 6.0], 0) + &square([-6.0, -2.03], 4);
    std::fs::write(&mesh, squares).expect("a file");
    let mut scene = scene(&format!(
        r#"<integrator type="path"><integer name="max_depth" value="1"/></integrator>
        <sensor type="orthographic"><transform name="to_world"><scale x="2" y="2"/>
        <lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
        <rfilter type="box"/></film></sensor>
        <shape type="obj" id="it"><string name="filename" value="{}"/><boolean name="face_normals" value="true"/>
        <bsdf type="diffuse"/><emitter type="area"/></shape>"#,
        mesh.display()
    ));
    scene.make_movable(&["it.translation"]).expect("a mesh");
    let options = Options {
        repeats: 8,
        ..Options::default()
    };
    let report = run_with(
        &mut scene,
        Estimator::Edges,
        &["it.translation"],
        64,
        &options,
    );
    let across = &report.params[0].comparisons[0];
    assert!((across.gradient.mean + 0.125).abs() < 0.01, "{report}");
    assert_eq!(across.verdict, Verdict::CannotTell, "{report}");
}

/// The size of a floor that reaches over the film changes nothing: what is left of terms that cancel is not wrong.
#[test]
fn rounding_is_not_wrong() {
    let mut scene = scene(
        r#"<integrator type="path"><integer name="max_depth" value="2"/></integrator>
        <sensor type="perspective"><transform name="to_world"><lookat origin="0,3,1" target="0.2,0,0.1" up="0,0,1"/>
        </transform><film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="6"/>
        <rfilter type="box"/></film></sensor>
        <shape type="rectangle" id="floor"><transform name="to_world"><scale value="9"/><rotate x="1" angle="-90"/>
        </transform></shape><emitter type="constant"/>"#,
    );
    let names = ["floor.scale", "floor.translation"];
    scene.make_movable(&names).expect("things that move");
    let report = short(&mut scene, &names);
    assert_ne!(report.verdict(), Verdict::Wrong, "{report}");
}

/// Derivatives by lengths are those of the scene in other units, over the unit: steps that were too long or too short
/// for a scene would see another one, or no outline at all.
#[test]
fn steps_are_in_units_of_the_scene() {
    let names = ["ball.translation", "lamp.position", "sensor.translation"];
    let found = [1.0, 1.0 / 8192.0, 8192.0].map(|unit: f64| {
        let mut scene = scene(&format!(
            r#"<integrator type="path"><integer name="max_depth" value="2"/></integrator>
            <sensor type="perspective"><float name="fov" value="50"/><transform name="to_world">
            <lookat origin="0,2,4" target="0,0,0" up="0,1,0"/><scale value="{unit}"/></transform>
            <film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="6"/>
            <rfilter type="box"/></film></sensor>
            <shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/>
            <translate y="-1"/><scale value="{unit}"/></transform></shape>
            <shape type="sphere" id="ball"><transform name="to_world"><scale value="{unit}"/></transform></shape>
            <emitter type="point" id="lamp"><point name="position" x="{unit}" y="{}" z="{unit}"/>
            <rgb name="intensity" value="{}"/></emitter>"#,
            3.0 * unit,
            10.0 * unit * unit,
        ));
        scene.make_movable(&names).expect("things that move");
        let report = short(&mut scene, &names);
        assert_ne!(report.verdict(), Verdict::Wrong, "{unit}: {report}");
        let all = report.params.iter().flat_map(|p| &p.comparisons);
        all.map(|c| [c.differences.mean * unit, c.differences.se * unit, c.step / unit])
            .collect::<Vec<_>>()
    });
    for other in &found[1..] {
        for ([a, a_se, a_step], [b, b_se, b_step]) in found[0].iter().zip(other) {
            assert!((a_step / b_step - 1.0).abs() < 1e-5, "{a_step} {b_step}");
            assert!((a - b).abs() < 0.5 * a_se.hypot(*b_se), "{a} {b}");
        }
    }
}

/// `edges` with few samples.
fn short(scene: &mut Scene, names: &[&str]) -> Report {
    let options = Options {
        repeats: 8,
        ..Options::default()
    };
    run_with(scene, Estimator::Edges, names, 16, &options)
}

/// Answers after so many questions that nobody wants to know any more.
#[derive(Default)]
struct Patience(std::sync::atomic::AtomicU64, u64);

impl Progress for Patience {
    fn cancelled(&self) -> bool {
        self.0.fetch_add(1, std::sync::atomic::Ordering::Relaxed) >= self.1
    }
}

/// Wherever it is stopped, there is no report, and the scene is as before.
#[test]
fn a_check_can_be_stopped() {
    let mut s = plates();
    let names = ["metal.alpha.value"];
    let before = s.params().values().to_vec();
    let mixture = Mixture::only(&s, Estimator::Mis, &names);
    let adjoint = mean_adjoint(&s);
    let options = Options {
        repeats: 4,
        ..OPTIONS
    };
    let settings = Settings {
        spp: 1,
        ..s.settings
    };
    for questions in [0, 10, 100] {
        let patience = Patience(Default::default(), questions);
        let report = check(
            &mut s, &settings, &names, &mixture, &adjoint, &options, &patience,
        );
        assert_eq!(report.expect("no error"), None);
        assert_eq!(s.params().values(), before);
    }
}

#[test]
fn mistakes_are_named() {
    let mut s = plates();
    let settings = Settings {
        spp: 1,
        ..s.settings
    };
    let mut failure = |names: &[&str], estimator, adjoint: &[f32], options: Options| {
        let mixture = Mixture::only(&s, estimator, names);
        let found = check(&mut s, &settings, names, &mixture, adjoint, &options, &());
        found.expect_err("a mistake").to_string()
    };
    let adjoint = vec![1.0; 192];
    let alpha = ["metal.alpha.value"];
    let few = Options {
        repeats: 3,
        ..OPTIONS
    };
    let found = failure(&alpha, Estimator::Mis, &adjoint, few);
    assert_eq!(found, "repeats: expected at least four, found 3");
    let vague = Options {
        tolerance: 1.0,
        ..OPTIONS
    };
    let found = failure(&alpha, Estimator::Mis, &adjoint, vague);
    assert_eq!(
        found,
        "tolerance: expected a number between 0 and 1, found 1"
    );
    let found = failure(&["metal.alhpa.value"], Estimator::Mis, &adjoint, OPTIONS);
    assert!(
        found.starts_with("no parameter `metal.alhpa.value`; closest: metal.alpha.value"),
        "{found}"
    );
    let found = failure(&alpha, Estimator::Mis, &adjoint[1..], OPTIONS);
    assert!(
        found.starts_with("adjoint image: expected 192 values"),
        "{found}"
    );
    let found = failure(&alpha, Estimator::Attached, &adjoint, OPTIONS);
    assert!(found.contains("discontinuities"), "{found}");
    let found = failure(&alpha, Estimator::Mis, &[f32::MAX; 192], OPTIONS);
    assert!(
        found.contains("overflow") || found.contains("finite"),
        "{found}"
    );
}

/// How much there is to do is known before: no bar ends beyond its end.
#[test]
fn work_stays_within_what_is_announced() {
    struct Count(std::sync::atomic::AtomicU64);
    impl Progress for Count {
        fn advance(&self, n: u64) {
            self.0.fetch_add(n, std::sync::atomic::Ordering::Relaxed);
        }
    }
    let mut s = plates();
    let names = ["metal.alpha.value", "metal.specular_reflectance.value"];
    let options = Options {
        repeats: 4,
        ..OPTIONS
    };
    let settings = Settings {
        spp: 1,
        ..s.settings
    };
    let mixture = Mixture::only(&s, Estimator::BiasedWeights, &names);
    let adjoint = mean_adjoint(&s);
    let count = Count(Default::default());
    check(
        &mut s, &settings, &names, &mixture, &adjoint, &options, &count,
    )
    .expect("no error");
    let passes = count.0.into_inner() / s.film.pixels() as u64;
    assert!(
        passes > 40 && passes <= most_passes(&s, &names, &options),
        "{passes}"
    );
}
