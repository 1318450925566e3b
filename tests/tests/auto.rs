//! The estimator that chooses: unbiased, deterministic, and not fooled by what sees nothing.

use render::Job;
use render::auto::{self, Mixture, candidates};
use render::image_io::write_exr;
use render::instances::{Estimator, Mode};
use render::params::Theta;
use render::sampler::Points;
use render::{Image, RenderError, Scene};
use tests::moving::{self, BALL, CUBE, FLOOR, agrees};
use tests::stats::{Estimate, z_limit};
use tests::{mean_adjoint, on_any_threads, scene};

const REPEATS: u64 = 32;
/// Chance of a false alarm of one test.
const ALPHA: f64 = 1e-3;

fn camera(size: u32, eye: &str, depth: u32) -> String {
    format!(
        r#"<sensor type="perspective"><float name="fov" value="30"/>
        <transform name="to_world"><lookat origin="{eye}" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{size}"/><integer name="height" value="{size}"/>
        <rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>"#
    )
}

fn metal(id: &str, alpha: f64) -> String {
    format!(
        r#"<bsdf type="roughconductor" id="{id}"><string name="material" value="none"/>
        <string name="distribution" value="beckmann"/><float name="alpha" value="{alpha}"/>
        <boolean name="sample_visible" value="false"/></bsdf>"#
    )
}

fn ball(id: &str, x: f64, radius: f64, radiance: f64) -> String {
    format!(
        r#"<shape type="sphere" id="{id}"><point name="center" value="{x}, 1, -3"/>
        <float name="radius" value="{radius}"/>
        <emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter></shape>"#
    )
}

fn plate(x: f64, bsdf: &str) -> String {
    format!(
        r#"<shape type="rectangle"><transform name="to_world"><scale x="0.95"/><rotate x="1" angle="-90"/>
        <translate x="{x}"/></transform>{bsdf}</shape>"#
    )
}

/// Left a large ball, right a small one.
fn balls() -> [String; 2] {
    [
        ball("large", -0.9, 0.7, 1.0),
        ball("small", 0.9, 0.02, 1250.0),
    ]
}

/// Left a smooth plate below the large ball, right a rough one below the small one.
fn halves(size: u32) -> Scene {
    let plates = [
        camera(size, "0, 1.5, 4", 2),
        plate(-1.0, &metal("smooth", 0.02)),
        plate(1.0, &metal("rough", 0.25)),
    ];
    scene(&[plates.concat(), balls().concat()].concat())
}

/// Left smooth metal, right something matt, below one lobe of light: what shows the lobe itself is for BSDF
/// samples, what it lights from afar for light samples.
fn lobed(size: u32) -> Scene {
    let matt = r#"<bsdf type="diffuse" id="matt"><rgb name="reflectance" value="0.9"/></bsdf>"#;
    let dark = r#"<rgb name="specular_reflectance" value="0.1"/></bsdf>"#;
    let dull = metal("smooth", 0.03).replace("</bsdf>", dark);
    let body = [
        camera(size, "0, 1.5, 4", 2),
        plate(-1.0, &dull),
        plate(1.0, matt),
        r#"<emitter type="vmf" id="lobe"><vector name="direction" value="0, 0.35, -0.94"/>
        <float name="kappa" value="60"/><rgb name="radiance" value="3, 2, 1"/></emitter>"#
            .to_owned(),
    ];
    scene(&body.concat())
}

const LOBED: [&str; 3] = [
    "smooth.alpha.value",
    "matt.reflectance.value",
    "lobe.radiance.value",
];
const NAMES: [&str; 3] = [
    "smooth.alpha.value",
    "rough.alpha.value",
    "large.emitter.radiance.value",
];

/// Single techniques: what they cannot do alone they must share.
const SINGLE: [Estimator; 3] = [
    Estimator::Emitter,
    Estimator::Detached,
    Estimator::Differential,
];

fn chosen(scene: &Scene, names: &[&str], candidates: &[Estimator], budget: u64) -> Mixture {
    let adjoint = mean_adjoint(scene);
    let s = &scene.settings;
    auto::choose(
        &Job::new(scene, s, 5, 0..budget, &()),
        names,
        &adjoint,
        candidates,
        Mode::Reverse,
    )
    .expect("parameters that candidates see")
}

/// Gradients of the mean of the image, all numbers in a row, with independent seeds.
fn gradients(
    scene: &Scene,
    mixture: &Mixture,
    names: &[&str],
    spp: u64,
    seed: u64,
) -> Vec<Estimate> {
    let theta = Theta::constant(scene.params().values());
    let adjoint = mean_adjoint(scene);
    let runs: Vec<Vec<f64>> = (0..REPEATS)
        .map(|r| {
            let s = &scene.settings;
            let g = mixture
                .backward_f32(
                    &Job::new(scene, s, seed + r, 0..spp, &()),
                    &theta,
                    names,
                    &adjoint,
                )
                .expect("an estimator that is right here");
            assert_eq!((g.non_finite.count, g.cancelled), (0, false));
            g.values.concat()
        })
        .collect();
    (0..runs[0].len())
        .map(|k| Estimate::of(&runs.iter().map(|r| r[k]).collect::<Vec<_>>()))
        .collect()
}

/// A mixture of several estimators has the expectation of one, where parameters have estimators of their own
/// and where parts of the image do: ten numbers, 32 repeats of 256 samples of each pixel (Sidak, 1e-3).
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn mixtures_are_unbiased() {
    for (scene, names) in [(lobed(32), &LOBED[..]), (lobed(64), &LOBED[2..])] {
        let mixture = chosen(&scene, names, &SINGLE, 1 << 16);
        println!("{mixture}");
        assert!(
            mixture.shares().len() > 1,
            "one estimator would prove nothing"
        );
        let found = gradients(&scene, &mixture, names, 256, 100);
        let alone = Mixture::only(&scene, Estimator::Mis, names);
        let expected = gradients(&scene, &alone, names, 256, 900);
        let limit = z_limit(10, REPEATS, ALPHA);
        for (k, (a, b)) in found.iter().zip(&expected).enumerate() {
            println!(
                "{k}: {:.5} +- {:.5}, {:.5} +- {:.5}",
                a.mean, a.se, b.mean, b.se
            );
            assert!(a.z(b).abs() < limit, "{k}: {a:?} {b:?}");
        }
    }
}

/// Weights add up to one in every block whatever the numbers of samples: the image of a mixture is that of
/// its members, exactly where all see the same.
#[test]
fn forward_and_reverse_mode_are_the_same_sum() {
    let scene = lobed(64);
    let name = [LOBED[2]];
    let mixture = chosen(&scene, &name, &SINGLE, 1 << 16);
    let theta = Theta::constant(scene.params().values());
    let adjoint = mean_adjoint(&scene);
    for samples in [1, 2, 16, 37] {
        let s = &scene.settings;
        let forward = mixture
            .forward_f32(&Job::new(&scene, s, 3, 0..samples, &()), name[0])
            .expect("an estimator that is right here");
        let mean: f64 = forward.mean(1).iter().sum::<f64>() / 3.0;
        let reverse = mixture
            .backward_f32(
                &Job::new(&scene, s, 3, 0..samples, &()),
                &theta,
                &name,
                &adjoint,
            )
            .expect("an estimator that is right here");
        let other: f64 = reverse.values[0].iter().sum();
        assert!(
            (mean - other).abs() < 2e-4 * mean.abs(),
            "{samples}: {mean} {other}"
        );
    }
}

/// What is chosen and what comes out of it: the same bits for 1, 2 and 7 threads, and another draw for another
/// seed.
#[test]
fn the_seed_decides_alone() {
    let scene = lobed(32);
    let (mixture, _) = on_any_threads(|| {
        let mixture = chosen(&scene, &LOBED, &SINGLE, 8192);
        let theta = Theta::constant(scene.params().values());
        let adjoint = mean_adjoint(&scene);
        let s = &scene.settings;
        let g = mixture
            .backward_f32(
                &Job::new(&scene, s, 3, 0..32, &()),
                &theta,
                &LOBED,
                &adjoint,
            )
            .expect("an estimator that is right here");
        (mixture.to_string(), g.values)
    });
    println!("{mixture}");
}

/// A bright speck that BSDF samples hardly ever find: their pilots see no derivative and no variance, and
/// must not win by that.
#[test]
fn what_sees_nothing_is_not_chosen() {
    let body = [
        camera(16, "0, 1.5, 4", 2),
        plate(0.0, &metal("plate", 0.3)),
        ball("speck", 0.0, 1e-5, 1e9),
    ];
    let scene = scene(&body.concat());
    let mixture = chosen(&scene, &["plate.alpha.value"], &candidates(&scene), 4096);
    println!("{mixture}");
    let finds = |m: &Mixture| {
        let shares = m.shares();
        shares
            .iter()
            .all(|(e, _)| e.capabilities().samples_emitters)
    };
    assert!(finds(&mixture));
    // Even if it would be the default.
    let listed = [Estimator::Detached, Estimator::Emitter];
    let mixture = chosen(&scene, &["plate.alpha.value"], &listed, 4096);
    assert!(finds(&mixture), "{mixture}");
    let weights = mixture.weights("plate.alpha.value", 16);
    let all = || weights.iter().flat_map(|(_, w)| w);
    assert!(all().count() > 0 && all().all(|w| w.is_finite()));
}

/// Two estimators that do the same where there is one bounce, one of them cheap in forward mode and dear in reverse
/// mode: the work that counts is that of the mode to come.
#[test]
fn work_is_that_of_the_mode_to_come() {
    let lobe = r#"<emitter type="vmf"><vector name="direction" value="0, 0.35, -0.94"/>
        <float name="kappa" value="20"/><rgb name="radiance" value="1, 1, 1"/></emitter>"#;
    let body = [
        camera(16, "0, 1.5, 4", 2),
        plate(0.0, &metal("plate", 0.2)),
        lobe.into(),
    ];
    let scene = scene(&body.concat());
    let (path, edge) = (Estimator::AttachedPath, Estimator::Attached);
    let names = ["plate.alpha.value"];
    for (mode, expected) in [(Mode::Forward, path), (Mode::Reverse, edge)] {
        let adjoint = mean_adjoint(&scene);
        let s = &scene.settings;
        let listed = [path, edge];
        let mixture = auto::choose(
            &Job::new(&scene, s, 5, 0..4096, &()),
            &names,
            &adjoint,
            &listed,
            mode,
        )
        .expect("both see the roughness");
        println!("{mixture}");
        let most = mixture
            .shares()
            .into_iter()
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let (chosen, share) = most.expect("somebody works");
        assert!(chosen == expected && share > 0.9, "{mode:?}: {mixture}");
    }
}

/// Pilots cost what they may, parameters are measured together where they must be, and without a
/// budget nothing is measured.
#[test]
fn pilots_keep_to_the_budget() {
    let scene = halves(16);
    for budget in [1, 100, 500, 2000, 10_000, 100_000] {
        let mixture = chosen(&scene, &NAMES, &candidates(&scene), budget);
        assert!(mixture.spent() <= auto::PILOTS * budget as f64, "{budget}");
        let shares: f64 = mixture.shares().iter().map(|s| s.1).sum();
        assert!((shares - 1.0).abs() < 1e-9, "{budget}: {shares}");
        if budget == 1 {
            assert_eq!(mixture.spent(), 0.0);
            assert!(
                mixture
                    .shares()
                    .iter()
                    .all(|(e, _)| *e == Estimator::MisBalance)
            );
        }
        let groups = mixture.findings().len();
        let expected = match budget {
            100_000 => Some(3),
            500 => Some(1),
            2000 => Some(3),
            _ => None,
        };
        assert!(
            expected.is_none_or(|n| n == groups),
            "{budget}: {groups} groups"
        );
    }
}

/// Passes take the work that is asked for, as costs in the mode of the passes count it.
#[test]
fn passes_take_the_work_asked_for() {
    let scene = halves(16);
    let names = &NAMES[..1];
    let mixture = chosen(&scene, names, &candidates(&scene), 100_000);
    let (estimators, samples): (Vec<_>, Vec<_>) = mixture.passes(1000).into_iter().unzip();
    let s = &scene.settings;
    let costs = auto::costs(&scene, names, &estimators, Mode::Reverse, s, 5).expect("a name");
    let work: f64 = costs.iter().zip(&samples).map(|(c, &n)| c * n as f64).sum();
    assert!(
        (work / 1000.0 - 1.0).abs() < 0.1,
        "{work}: {estimators:?} {samples:?} {costs:?}"
    );
}

#[test]
fn what_nobody_sees_is_an_error() {
    let scene = halves(16);
    let adjoint = mean_adjoint(&scene);
    let ask = |names: &[&str], adjoint: &[f32], candidates: &[Estimator]| {
        let s = &scene.settings;
        auto::choose(
            &Job::new(&scene, s, 0, 0..4096, &()),
            names,
            adjoint,
            candidates,
            Mode::Reverse,
        )
        .map(|_| ())
    };
    let unknown = ask(&["rough.alfa.value"], &adjoint, &candidates(&scene));
    assert!(matches!(unknown, Err(RenderError::UnknownParameter { .. })));
    let short = ask(&NAMES, &adjoint[1..], &candidates(&scene));
    assert!(matches!(short, Err(RenderError::WrongLength { .. })));
    let none = ask(&NAMES, &adjoint, &[]);
    assert!(matches!(none, Err(RenderError::Count { .. })));
    // Attached samples alone: the balls have edges.
    let refused = ask(&NAMES, &adjoint, &[Estimator::Attached]);
    assert!(matches!(refused, Err(RenderError::Discontinuous { .. })));
    let mixture = chosen(&scene, &NAMES[..1], &candidates(&scene), 4096);
    let other = mixture.forward_f32(&Job::new(&scene, &scene.settings, 0, 0..4, &()), NAMES[1]);
    assert!(matches!(other, Err(RenderError::UnknownParameter { .. })));
}

/// The other kinds of points pass through: same expectation, for each member.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn spread_points_are_unbiased() {
    let mut scene = halves(16);
    let names = &NAMES[1..2];
    let mixture = Mixture::only(&scene, Estimator::DifferentialMis, names);
    let expected = gradients(&scene, &mixture, names, 256, 1)[0];
    let limit = z_limit(2, REPEATS, ALPHA);
    for (k, points) in [Points::Sobol, Points::Antithetic].into_iter().enumerate() {
        scene.settings.points = points;
        let found = gradients(&scene, &mixture, names, 256, 1000 * (k as u64 + 1))[0];
        println!(
            "{points:?}: {:.6} +- {:.6} against +- {:.6}",
            found.mean, found.se, expected.se
        );
        assert!(
            found.z(&expected).abs() < limit,
            "{points:?} {found:?} {expected:?}"
        );
        if points == Points::Sobol {
            assert!(
                found.se < 0.8 * expected.se,
                "no better than independent ones"
            );
        }
    }
}

/// Pilots see emission that is an image, on a surface or around the scene, as they see numbers.
#[test]
fn images_that_emit_are_weighed_too() {
    let dir = tempfile::tempdir().expect("a folder");
    let file = |name: &str, scale: f32| {
        let mut image = Image::new(8, 4);
        let texels = image.data.iter_mut().enumerate();
        texels.for_each(|(i, x)| *x = scale * (1.0 + 0.5 * (i as f32).sin()));
        let path = dir.path().join(name);
        write_exr(&path, &image).expect("a folder to write to");
        format!(r#"<string name="filename" value="{}"/>"#, path.display())
    };
    let s = scene(&format!(
        r#"{}{}<emitter type="envmap" id="sky">{}</emitter>
        <shape type="rectangle" id="lamp">
        <transform name="to_world"><rotate x="1" angle="90"/><translate y="1"/></transform><emitter type="area">
        <texture type="bitmap" name="radiance">{}<boolean name="raw" value="true"/></texture></emitter></shape>"#,
        camera(16, "0, 1.5, 4", 2),
        plate(0.0, r#"<bsdf type="diffuse" id="matt"/>"#),
        file("sky.exr", 0.01),
        file("lamp.exr", 10.0),
    ));
    let ones = mean_adjoint(&s);
    let measure = |names: &[&str]| {
        let e = Estimator::MisBalance;
        auto::sampling_weights(&s, names, &ones, e, &s.settings, 1, &()).expect("weights")
    };
    let sky = measure(&["sky.data"]);
    let lamp = measure(&["lamp.emitter.radiance.data"]);
    // The smallest share goes to what says nothing about the other's texels.
    let least = |w: &[f64]| w.iter().position(|w| (w - 0.05).abs() < 1e-12);
    assert_eq!((sky.len(), lamp.len()), (2, 2));
    let (of_sky, of_lamp) = (least(&lamp), least(&sky));
    assert!(of_sky.is_some() && of_lamp.is_some() && of_sky != of_lamp);
    let image = measure(&[]);
    let share = |k: Option<usize>| k.map_or(0.0, |k| image[k]);
    assert!(
        share(of_lamp) > 0.9,
        "a thousand times as bright: {image:?}"
    );
    assert!(share(of_sky) > 0.05, "{image:?}");
    // Each image is dark while the other is measured.
    let matt = measure(&["matt.reflectance.value"]);
    let of_lamp = of_lamp.map(|k| matt[k]);
    assert!(of_lamp.is_some_and(|w| w > 0.9), "{matt:?}");
}

/// Sampling weights from pilots: what emits, and nothing else, counts for its own derivative; the rest is spread
/// evenly.
#[test]
fn lights_are_sampled_where_they_matter() {
    let s = halves(16);
    let ones = mean_adjoint(&s);
    let measure = |names: &[&str], seed| {
        let e = Estimator::MisBalance;
        auto::sampling_weights(&s, names, &ones, e, &s.settings, seed, &()).expect("weights")
    };
    let large = measure(&["large.emitter.radiance.value"], 1);
    assert_eq!(large.len(), 2);
    assert!(
        (large[0] - 0.95).abs() < 1e-12 && (large[1] - 0.05).abs() < 1e-12,
        "{large:?}"
    );
    // The rough plate has light from both, its own ball is above it.
    let rough = measure(&["rough.alpha.value"], 1);
    assert!(rough[1] > rough[0], "{rough:?}");
    assert_eq!(rough, measure(&["rough.alpha.value"], 1));
    assert_ne!(rough, measure(&["rough.alpha.value"], 2));
    let image = measure(&[], 1);
    assert!(image.iter().all(|w| *w > 0.05) && (image.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    let no_names: [&str; 0] = [];
    let e = Estimator::MisBalance;
    let wrong = auto::sampling_weights(&s, &no_names, &ones[1..], e, &s.settings, 1, &());
    assert!(matches!(wrong, Err(RenderError::WrongLength { .. })));
    let unknown = auto::sampling_weights(&s, &["roof"], &ones, e, &s.settings, 1, &());
    assert!(unknown.is_err());
}

/// The measured weights make less noise where lights differ in what they tell, for the sum of the variances of all
/// derivatives in emission: on matt plates, where it comes from the choice (64 repeats each, whose variances are good
/// to a sixth).
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn measured_sampling_weights_make_less_noise() {
    let matt = r#"<bsdf type="diffuse"/>"#;
    let plates = [
        camera(16, "0, 1.5, 4", 2),
        plate(-1.0, matt),
        plate(1.0, matt),
    ];
    // Above what the camera sees.
    let balls = balls().map(|b| b.replace(", 1, -3", ", 3, 0"));
    let mut s = scene(&[plates.concat(), balls.concat()].concat());
    let names = [
        "large.emitter.radiance.value",
        "small.emitter.radiance.value",
    ];
    let ones = mean_adjoint(&s);
    let variance = |s: &Scene| {
        let theta = Theta::constant(s.params().values());
        let e = Estimator::MisBalance;
        let active = e.active(s, &names).expect("parameters");
        let runs: Vec<Vec<f64>> = (0..64)
            .map(|seed| {
                let g = e.backward_f32(
                    &Job::new(s, &s.settings, seed, 0..16, &()),
                    &theta,
                    &active,
                    &ones,
                );
                g.expect("a gradient").values.concat()
            })
            .collect();
        let each = (0..runs[0].len()).map(|i| {
            let numbers: Vec<f64> = runs.iter().map(|r| r[i]).collect();
            Estimate::of(&numbers).se.powi(2)
        });
        each.sum::<f64>()
    };
    let even = variance(&s);
    let e = Estimator::MisBalance;
    let weights =
        auto::sampling_weights(&s, &names, &ones, e, &s.settings, 1, &()).expect("weights");
    s.set_sampling_weights(&weights).expect("positive");
    let ratio = even / variance(&s);
    assert!(ratio > 1.3, "{ratio}, {weights:?}");
    for bad in [
        vec![1.0],
        vec![1.0, 0.0],
        vec![1.0, f64::NAN],
        vec![f64::INFINITY, 1.0],
    ] {
        assert!(s.set_sampling_weights(&bad).is_err(), "{bad:?}");
    }
}

/// What moves and a roughness at once: edges take what moves, whoever takes the rest, and the sum is that of edges alone. 32
/// repeats of 256 samples of 256 pixels, and of 64 by edges.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn what_moves_is_left_to_edges() {
    let shiny = FLOOR.replace(
        r#"</transform><ref id="grey"/>"#,
        r#"</transform><ref id="metal"/>"#,
    );
    assert_ne!(shiny, FLOOR);
    let mut scene = moving::scene(&format!("{shiny}{BALL}"), 2);
    let names = ["it.translation", "metal.alpha.value"];
    scene.make_movable(&names[..1]).expect("a ball");
    let mixture = chosen(&scene, &names, &candidates(&scene), 8192);
    println!("{mixture}");
    let shares = mixture.shares();
    assert!(shares.iter().any(|(e, _)| *e == Estimator::Edges));
    let found = gradients(&scene, &mixture, &names, 256, 100);
    let alone = Mixture::only(&scene, Estimator::Edges, &names);
    let expected = gradients(&scene, &alone, &names, 64, 900);
    for (what, range) in [("translation", 0..3), ("roughness", 3..4)] {
        let (found, expected) = (&found[range.clone()], &expected[range]);
        agrees(what, found, expected, 0.0, REPEATS);
    }
}

/// Over a mirror edges are refused, and directions that follow outlines are chosen; what nobody has outlines of is refused by
/// name, whatever the budget.
#[test]
fn what_moves_over_mirrors_follows_directions() {
    let silver = r#"<shape type="sphere" id="silver"><transform name="to_world"><scale value="0.5"/>
        <translate x="-1.2" y="0.5"/></transform><bsdf type="conductor"/></shape>"#;
    let bulb = r#"<emitter type="point"><point name="position" x="0" y="4" z="0"/></emitter>"#;
    let slide = r#"<emitter type="projector"><transform name="to_world"><lookat origin="1, 4, 1" target="0, 0, 0"
        up="0, 0, 1"/></transform><float name="fov" value="40"/><texture name="irradiance" type="checkerboard"/></emitter>"#;
    let name = "it.translation";
    let of = |more: &str| {
        let mut scene = moving::scene(&format!("{FLOOR}{CUBE}{more}"), 3);
        scene.make_movable(&[name]).expect("a cube");
        scene
    };
    let mirror = of(silver);
    for budget in [1, 512] {
        let mixture = chosen(&mirror, &[name], &candidates(&mirror), budget);
        let all = mixture.shares();
        assert!(all.len() == 1 && all[0].0 == Estimator::ReparameterisedMis);
    }
    let lit = of(bulb);
    for budget in [1, 512] {
        let mixture = chosen(&lit, &[name], &candidates(&lit), budget);
        let all = mixture.shares();
        assert!(all.len() == 1 && all[0].0 == Estimator::Edges);
    }
    let lit = of(slide);
    let adjoint = mean_adjoint(&lit);
    let theta = Theta::constant(lit.params().values());
    for budget in [1, 512] {
        let job = Job::new(&lit, &lit.settings, 5, 0..budget, &());
        let all = candidates(&lit);
        let mixture = auto::choose(&job, &[name], &adjoint, &all, Mode::Reverse);
        let refused = mixture.and_then(|m| m.backward_f32(&job, &theta, &[name], &adjoint));
        let message = refused.expect_err("refused").to_string();
        assert!(
            message.contains("`it.translation`") && message.contains("image that jumps"),
            "{message}"
        );
    }
}
