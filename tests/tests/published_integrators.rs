//! The integrators of the authors of specular manifold sampling, in scene files: the light that they keep, by connections and by
//! paths, and what their options are here.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use render::Job;
use render::instances::{Estimator, chains_by_particles_f32, render_f32};
use render::integrator::render::Progress;
use render::params::Theta;
use render::scene::{
    CasterLight, Connections, Constraint, GlintMethod, GlintTechniques, Glints, LoadOptions,
    Method, Seen, Starts, Uniqueness,
};
use render::{Scene, Settings};
use tests::stats::{Estimate, z_limit};
use tests::{picture, scene};

const ALPHA: f64 = 1e-3;

fn with(s: &Scene, connections: Connections) -> Settings {
    Settings {
        connections: Some(connections),
        ..s.settings
    }
}

fn view(integrator: &str, depth: u32, options: &str, origin: &str) -> String {
    format!(
        r#"<integrator type="{integrator}"><integer name="max_depth" value="{depth}"/>{options}</integrator>
        <sensor type="perspective"><float name="fov" value="45"/>
        <transform name="to_world"><lookat origin="{origin}" target="0, 0.4, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
        <rfilter type="box"/></film></sensor>"#
    )
}

const FLOOR: &str = r#"<shape type="rectangle"><boolean name="caustic_receiver" value="true"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf>
    <transform name="to_world"><scale value="4"/><rotate x="1" angle="-90"/></transform></shape>"#;

/// Neither receiver nor caster: what is seen in it is left out where it comes over casters.
const WALL: &str = r#"<shape type="rectangle"><bsdf type="diffuse"/>
    <transform name="to_world"><scale value="2"/><rotate y="1" angle="90"/><translate x="-1.8" y="1.5"/></transform></shape>"#;

/// A half-buried ball of glass before a wall of metal, and a lamp that shines on both: chains of one vertex over either, of two over
/// both, reflections off the ball, and all of that seen from the camera directly and in the casters.
fn single(integrator: &str, options: &str, alpha: Option<f64>) -> Scene {
    let [glass, metal] = [
        ("dielectric", ""),
        (
            "conductor",
            r#"<rgb name="specular_reflectance" value="0.9, 0.8, 0.7"/>"#,
        ),
    ]
    .map(|(kind, inside)| match alpha {
        Some(alpha) => format!(
            r#"<bsdf type="rough{kind}"><float name="alpha" value="{alpha}"/>{inside}</bsdf>"#
        ),
        None => format!(r#"<bsdf type="{kind}">{inside}</bsdf>"#),
    });
    let caster = r#"<boolean name="caustic_caster_single" value="true"/>"#;
    scene(&format!(
        r#"{}{FLOOR}{WALL}
        <shape type="sphere">{caster}<float name="radius" value="0.9"/>{glass}</shape>
        <shape type="rectangle">{caster}<bsdf type="twosided">{metal}</bsdf>
        <transform name="to_world"><scale value="1.5"/><translate y="1.5" z="-1.5"/></transform></shape>
        <shape type="rectangle"><transform name="to_world"><scale value="0.6"/><rotate x="1" angle="90"/><rotate x="1" angle="35"/>
        <translate y="2.6" z="1.2"/></transform>
        <emitter type="area"><boolean name="caustic_emitter_single" value="true"/><rgb name="radiance" value="9, 8, 7"/></emitter></shape>"#,
        view(integrator, 5, options, "1, 3, 4"),
    ))
}

/// A slab of glass over the floor and a wall of metal beside it: chains through both faces of the slab, off the wall and through
/// one of them only, and of further reflections within.
fn double(integrator: &str, options: &str) -> Scene {
    let face = |flag: &str, turn: i32, y: f64| {
        format!(
            r#"<shape type="rectangle"><boolean name="{flag}" value="true"/><bsdf type="dielectric"/>
            <transform name="to_world"><scale value="1.6"/><rotate x="1" angle="{turn}"/><translate y="{y}"/></transform></shape>"#
        )
    };
    scene(&format!(
        r#"{}{FLOOR}{WALL}{}{}
        <shape type="rectangle"><boolean name="caustic_caster_multi" value="true"/><bsdf type="twosided"><bsdf type="conductor"/></bsdf>
        <transform name="to_world"><scale value="1.5"/><translate y="1.5" z="-1.8"/></transform></shape>
        <shape type="rectangle"><transform name="to_world"><scale value="0.6"/><rotate x="1" angle="90"/>
        <translate x="0.3" y="3.2" z="0.2"/></transform>
        <emitter type="area"><boolean name="caustic_emitter_multi" value="true"/><rgb name="radiance" value="9, 8, 7"/></emitter></shape>"#,
        view(integrator, 6, options, "1, 1.6, 5"),
        face("caustic_caster_multi", 90, 0.8),
        face("caustic_bouncer", -90, 1.3),
    ))
}

/// `path_filtered_*` and `path_sms_*` of one file bring the same light, by blocks, and less than all; so does
/// `mnee-unbiased`. One vertex with and without lights that the camera sees in casters, over
/// rough casters, and two and three vertices. 48 runs of 32 samples against 48 of 256 by paths, which `mnee-unbiased` has, too;
/// significance 1e-3 over all blocks.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn filtered_and_connected_integrators_bring_the_same_light() {
    let no_glints = r#"<boolean name="disable_reflected_emitters" value="true"/>"#;
    let three = r#"<integer name="bounces" value="3"/>"#;
    type Make = Box<dyn Fn(&str) -> Scene>;
    let scenes: [(&str, &str, Make); 5] = [
        ("one", "ss", Box::new(|i| single(i, "", None))),
        (
            "unseen",
            "ss",
            Box::new(move |i| single(i, no_glints, None)),
        ),
        ("rough", "ss", Box::new(|i| single(i, "", Some(0.15)))),
        ("two", "ms", Box::new(|i| double(i, ""))),
        ("three", "ms", Box::new(move |i| double(i, three))),
    ];
    let limit = z_limit(scenes.len() * 2 * 4 * 3, 48, ALPHA);
    let mean = |e: &[Estimate]| e.iter().map(|e| e.mean).sum::<f64>() / e.len() as f64;
    let worst = |a: &[Estimate], b: &[Estimate]| {
        let each = a.iter().zip(b).map(|(a, b)| a.z(b));
        each.fold((0.0f64, 0.0f64), |(most, largest), z| {
            (most.max(z), largest.max(z.abs()))
        })
    };
    for (name, kind, make) in scenes {
        let connected = make(&format!("path_sms_{kind}"));
        let filtered = make(&format!("path_filtered_{kind}"));
        let [ours, theirs] =
            [&connected, &filtered].map(|s| s.settings.connections.expect("of the file"));
        assert_eq!((ours.method, theirs.method), (Method::Sms, Method::Paths));
        assert_eq!((ours.light, ours.bounces), (theirs.light, theirs.bounces));
        let paths = picture(&filtered, &filtered.settings, 1000, 48, 256);
        let all = picture(
            &filtered,
            &with(&filtered, Connections::new(Method::Paths)),
            5000,
            48,
            256,
        );
        let (of_chains, _) = worst(&all, &paths);
        let chains = picture(
            &connected,
            &with(
                &connected,
                Connections {
                    method: Method::LeftOut,
                    ..ours
                },
            ),
            4000,
            48,
            16,
        );
        // Paths find nearly all of some chains for one walk, which is seldom.
        for (method, seed, spp) in [(Method::Sms, 2000, 32), (Method::MneeUnbiased, 3000, 256)] {
            let connections = Connections { method, ..ours };
            let found = picture(&connected, &with(&connected, connections), seed, 48, spp);
            let (_, z) = worst(&found, &paths);
            let (seen, _) = worst(&paths, &chains);
            println!(
                "{name}, {method:?}: |z| up to {z:.2} of {limit:.2}; {:.4} of {:.4}; left out {of_chains:.1}, chains {seen:.1}",
                mean(&found),
                mean(&paths)
            );
            assert!(z < limit, "{name}, {method:?}: {z}");
            assert!(
                seen > limit && of_chains > limit,
                "{name}: {seen} {of_chains}"
            );
        }
    }
}

/// The chains that such a file names, by particles that land on receivers: mean over the image, 16 runs of 32 samples of connections and
/// of 20 000 particles with 32 samples; significance 1e-3.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn particles_bring_the_same_chains() {
    let limit = z_limit(2, 16, ALPHA);
    for s in [single("path_sms_ss", "", None), double("path_sms_ms", "")] {
        let connections = s.settings.connections.expect("of the file");
        let theta = Theta::constant(s.params().values());
        let image = |settings: &Settings, seed: u64| {
            let job = Job::new(&s, settings, seed, 0..32, &());
            render_f32(&job, &theta, Estimator::Mis)
                .mean(0)
                .iter()
                .sum::<f64>()
                / 3.0
        };
        let rest = with(
            &s,
            Connections {
                method: Method::LeftOut,
                ..connections
            },
        );
        let ours = (0..16).map(|seed| image(&s.settings, seed) - image(&rest, seed));
        let theirs = (100..116).map(|seed| {
            let job = Job::new(&s, &s.settings, seed, 0..32, &());
            let found = chains_by_particles_f32(&job, &theta, 20_000).expect("seen by particles");
            found.image.mean(0).iter().sum::<f64>() / 3.0
        });
        let [ours, theirs] = [
            Estimate::of(&ours.collect::<Vec<_>>()),
            Estimate::of(&theirs.collect::<Vec<_>>()),
        ];
        println!("{ours:?} {theirs:?}");
        assert!(
            ours.z(&theirs).abs() < limit && ours.mean > 5.0 * ours.se,
            "{ours:?} {theirs:?}"
        );
    }
}

fn load(integrator: &str, options: &str) -> Result<(Settings, Vec<String>), String> {
    let text = format!(
        r#"<scene version="2.0.0"><integrator type="{integrator}">{options}</integrator>
        <sensor type="perspective"><float name="fov" value="40"/></sensor></scene>"#
    );
    Scene::from_xml(&text, Path::new("."), &LoadOptions::default())
        .map(|(s, warnings)| (s.settings, warnings))
        .map_err(|e| e.to_string())
}

/// One option of one of the integrators: its type, name and value.
type Option3 = (&'static str, &'static str, &'static str);

fn element((kind, name, value): &Option3) -> String {
    format!(r#"<{kind} name="{name}" value="{value}"/>"#)
}

/// Every option of `path_sms_ss` and `path_sms_ms` is a setting, is warned of by name, or is refused by name.
#[test]
fn options_of_connected_integrators_are_honoured_or_named() {
    type Honoured = fn(&Connections) -> bool;
    let settings: &[(&[Option3], Honoured)] = &[
        (&[], |c| {
            c.method == Method::Sms
                && c.budget == Connections::BUDGET
                && c.starts == Starts::Particles
                && c.uniqueness == Uniqueness::ErrorBounds
                && c.constraint == Constraint::Angle
        }),
        (
            &[
                ("boolean", "biased", "true"),
                ("integer", "max_trials", "8"),
            ],
            |c| c.method == Method::SmsBiased(8),
        ),
        (&[("integer", "max_trials", "1000")], |c| {
            (c.method, c.budget) == (Method::Sms, 1000)
        }),
        (&[("integer", "max_trials", "-1")], |c| {
            c.budget == Connections::BUDGET
        }),
        (&[("boolean", "mnee_init", "true")], |c| {
            c.method == Method::MneeUnbiased
        }),
        (
            &[
                ("boolean", "mnee_init", "true"),
                ("boolean", "biased_mnee", "false"),
            ],
            |c| c.method == Method::MneeUnbiased,
        ),
        (
            &[
                ("boolean", "mnee_init", "true"),
                ("boolean", "biased_mnee", "true"),
            ],
            |c| c.method == Method::Mnee,
        ),
        (&[("boolean", "twostage", "true")], |c| {
            c.starts == Starts::TwoStage
        }),
        (&[("boolean", "twostage", "false")], |c| {
            c.starts == Starts::Uniform
        }),
        (&[("boolean", "halfvector_constraints", "true")], |c| {
            c.constraint == Constraint::HalfVector
        }),
        (&[("float", "step_scale", "0.5")], |c| c.steps.scale == 0.5),
        (&[("integer", "max_iterations", "50")], |c| {
            c.steps.most == 50
        }),
        (&[("float", "solver_threshold", "0.001")], |c| {
            c.steps.tolerance == 1e-3
        }),
        (&[("float", "uniqueness_threshold", "0.0001")], |c| {
            c.uniqueness == Uniqueness::Threshold(1e-4)
        }),
    ];
    for plugin in ["path_sms_ss", "path_sms_ms"] {
        for (options, honoured) in settings {
            let text: String = options.iter().map(element).collect();
            let (found, _) = load(plugin, &text).expect("valid");
            let found = found.connections.expect("connections");
            assert!(honoured(&found), "{plugin} {options:?}: {found:?}");
        }
        let warned: &[&[Option3]] = &[
            &[("float", "uniqueness_threshold", "0.01")],
            &[("boolean", "biased_mnee", "true")],
            &[
                ("boolean", "twostage", "true"),
                ("boolean", "mnee_init", "true"),
            ],
            &[
                ("integer", "max_trials", "-1"),
                ("boolean", "biased", "true"),
            ],
            &[("integer", "samples_per_pass", "4")],
            &[("float", "timeout", "3")],
        ];
        for options in warned {
            let (_, name, _) = options[0];
            let text: String = options.iter().map(element).collect();
            let (_, warnings) = load(plugin, &text).expect("valid");
            assert!(
                warnings.iter().any(|w| w.contains(&format!("`{name}`"))),
                "{name}: {warnings:?}"
            );
        }
        for (option, part) in [
            (
                ("float", "uniqueness_threshold", "0"),
                "uniqueness_threshold",
            ),
            (("integer", "max_trials", "0"), "max_trials"),
            (("integer", "max_iterations", "0"), "max_iterations"),
            (("float", "step_scale", "2"), "step_scale"),
            (("float", "solver_threshold", "0"), "solver_threshold"),
            (("float", "no_such_thing", "1"), "no_such_thing"),
        ] {
            let error = load(plugin, &element(&option)).expect_err("refused");
            assert!(error.contains(part), "{error}");
        }
        let too_many = [
            ("boolean", "biased", "true"),
            ("integer", "max_trials", "2000000"),
        ];
        let error =
            load(plugin, &too_many.iter().map(element).collect::<String>()).expect_err("refused");
        assert!(
            error.contains("max_trials") && error.contains("1048576"),
            "{error}"
        );
        // Defaults of the authors' program are nothing to warn of, but for what is left out.
        let defaults = [
            ("integer", "max_iterations", "20"),
            ("float", "step_scale", "1"),
            ("boolean", "biased_mnee", "false"),
        ];
        let (_, warnings) =
            load(plugin, &defaults.iter().map(element).collect::<String>()).expect("valid");
        assert!(
            warnings.len() == 1 && warnings[0].contains("left out"),
            "{warnings:?}"
        );
    }
}

/// Which light there is, of all four: `bounces` of several vertices, `disable_reflected_emitters` of one; other integrators leave
/// nothing out.
#[test]
fn files_say_which_light_there_is() {
    for kind in ["sms", "filtered"] {
        let method = if kind == "sms" {
            Method::Sms
        } else {
            Method::Paths
        };
        let of = |many: &str, options: &str| {
            let (found, warnings) = load(&format!("path_{kind}_{many}"), options).expect("valid");
            assert!(
                warnings.iter().any(|w| w.contains("left out")),
                "{warnings:?}"
            );
            let found = found.connections.expect("connections");
            assert_eq!(found.method, method);
            (found.bounces, found.light)
        };
        let published = CasterLight::Published;
        assert_eq!(of("ss", ""), (1, published(Seen::Directly)));
        let none = r#"<boolean name="disable_reflected_emitters" value="true"/>"#;
        assert_eq!(of("ss", none), (1, published(Seen::Nothing)));
        assert_eq!(of("ms", ""), (2, published(Seen::AlongDeltas)));
        let three = r#"<integer name="bounces" value="3"/>"#;
        assert_eq!(of("ms", three), (3, published(Seen::AlongDeltas)));
        let error = load(
            &format!("path_{kind}_ms"),
            r#"<integer name="bounces" value="0"/>"#,
        )
        .expect_err("refused");
        assert!(
            error.contains("bounces") && error.contains("from 1 to 8"),
            "{error}"
        );
        let error = load(&format!("path_{kind}_ms"), none).expect_err("refused");
        assert!(error.contains("disable_reflected_emitters"), "{error}");
        let error = load(&format!("path_{kind}_ss"), three).expect_err("refused");
        assert!(error.contains("bounces"), "{error}");
    }
    assert_eq!(load("path", "").expect("valid").0.connections, None);
    let error = load("path_sms_teaser", "").expect_err("refused");
    assert!(error.contains("path_sms_teaser"), "{error}");
}

/// The same of `path_sms_glints`.
#[test]
fn options_of_glints_are_honoured_or_named() {
    type Honoured = fn(&Glints) -> bool;
    let settings: &[(&[Option3], Honoured)] = &[
        (&[], |g| {
            g.method == GlintMethod::Unbiased && g.threshold.is_none() && g.steps == 20
        }),
        (
            &[
                ("boolean", "biased", "true"),
                ("integer", "max_trials", "8"),
            ],
            |g| g.method == GlintMethod::Biased(8),
        ),
        (&[("integer", "max_trials", "1000")], |g| g.budget == 1000),
        (&[("integer", "max_iterations", "7")], |g| g.steps == 7),
        (&[("float", "uniqueness_threshold", "0.001")], |g| {
            g.threshold == Some(1e-3)
        }),
        (&[("boolean", "bsdf_strategy_only", "true")], |g| {
            g.techniques == GlintTechniques::Scattering
        }),
        (&[("boolean", "sms_strategy_only", "true")], |g| {
            g.techniques == GlintTechniques::Walks
        }),
    ];
    for (options, honoured) in settings {
        let text: String = options.iter().map(element).collect();
        let (found, _) = load("path_sms_glints", &text).expect("valid");
        let found = found.glints.expect("glints");
        assert!(honoured(&found), "{options:?}: {found:?}");
    }
    for option in [
        ("float", "step_scale", "0.5"),
        ("float", "solver_threshold", "0.001"),
        ("boolean", "glints_vectorized", "true"),
        ("boolean", "biased", "true"),
        ("float", "glint_diff_scale_factor_clamp", "0.5"),
    ] {
        let (_, warnings) = load("path_sms_glints", &element(&option)).expect("valid");
        assert!(
            warnings
                .iter()
                .any(|w| w.contains(&format!("`{}`", option.1))),
            "{warnings:?}"
        );
    }
}

/// Cancelled from a moment on, which it remembers.
struct Moment {
    start: Instant,
    after: Duration,
    asked: AtomicBool,
}

impl Progress for Moment {
    fn cancelled(&self) -> bool {
        let late = self.start.elapsed() > self.after;
        self.asked.fetch_or(late, Ordering::Relaxed);
        late
    }
}

/// Solutions that are never found again: by a threshold that nothing is below.
fn isolated(s: &Scene, budget: u32) -> Settings {
    let connections = Connections {
        uniqueness: Uniqueness::Threshold(-1.0),
        starts: Starts::Uniform,
        budget,
        ..Connections::new(Method::Sms)
    };
    with(s, connections)
}

/// Trials without end stop within a second of being told to, in images and in trial sets; trials that run out are counted, the same for
/// any seed again, and weigh as many as they were.
#[test]
#[cfg_attr(debug_assertions, ignore = "many walks: runs with --release")]
fn isolated_solutions_hold_nobody() {
    let s = single("path_sms_ss", "", None);
    let theta = Theta::constant(s.params().values());
    let sets = with(
        &s,
        Connections::new(Method::SmsBiased(Connections::MOST_WALKS)),
    );
    for settings in [isolated(&s, u32::MAX), sets] {
        let after = Duration::from_millis(300);
        let moment = Moment {
            start: Instant::now(),
            after,
            asked: AtomicBool::new(false),
        };
        let image = render_f32(
            &Job::new(&s, &settings, 1, 0..64, &moment),
            &theta,
            Estimator::Mis,
        );
        let late = moment.start.elapsed() - after;
        assert!(image.cancelled && moment.asked.load(Ordering::Relaxed));
        assert!(late < Duration::from_secs(1), "{late:?}");
    }
    let [some, again, more] = [100, 100, 200].map(|budget| {
        let settings = isolated(&s, budget);
        let image = render_f32(
            &Job::new(&s, &settings, 1, 0..4, &()),
            &theta,
            Estimator::Mis,
        );
        (image.connections, image.mean(0))
    });
    assert_eq!(some, again);
    assert!(
        some.0.exhausted > 10 && some.0.exhausted == some.0.solutions,
        "{some:?}"
    );
    assert_eq!(some.0.trials, 100 * some.0.exhausted);
    assert!(more.1[0] > some.1[0], "{some:?} {more:?}");
}
