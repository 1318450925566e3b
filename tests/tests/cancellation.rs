//! Computations that are cancelled: soon, and without a trace in results that are called complete.

use std::sync::atomic::{AtomicU64, Ordering};

use render::Job;
use render::bsdf::kernel::Rules;
use render::instances::{
    Direction, Estimator, density_f32, forward_f64, particles_f32, render_f32, render_f64,
};
use render::integrator::density::Convention;
use render::integrator::render::{Progress, Rendering};
use render::params::Theta;
use render::scene::Caustics;
use render::{Scene, Settings};
use tests::scene;

/// Cancelled once it was asked so many times.
struct Patience(u64, AtomicU64);

impl Patience {
    fn of(questions: u64) -> Self {
        Self(questions, AtomicU64::new(0))
    }
}

impl Progress for Patience {
    fn cancelled(&self) -> bool {
        self.1.fetch_add(1, Ordering::Relaxed) >= self.0
    }
}

/// A closed box of four mirrors and two rough walls around a lamp and the camera: one tile.
fn mirrors() -> Scene {
    let wall = |id: &str, turn: &str| {
        format!(
            r#"<shape type="rectangle"><transform name="to_world"><scale value="2"/><translate z="-2"/>{turn}</transform><ref id="{id}"/></shape>"#
        )
    };
    scene(&format!(
        r#"<sensor type="perspective"><float name="fov" value="60"/>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="-1"/></integrator>
        <bsdf type="conductor" id="mirror"><string name="material" value="none"/></bsdf>
        <bsdf type="roughconductor" id="metal"><float name="alpha" value="0.3"/></bsdf>
        {}{}{}{}{}{}
        <shape type="sphere"><float name="radius" value="0.1"/><point name="center" value="1, 1, 1"/>
        <emitter type="area"><rgb name="radiance" value="9"/></emitter></shape>"#,
        wall("mirror", ""),
        wall("mirror", r#"<rotate y="1" angle="180"/>"#),
        wall("mirror", r#"<rotate y="1" angle="90"/>"#),
        wall("metal", r#"<rotate y="1" angle="-90"/>"#),
        wall("mirror", r#"<rotate x="1" angle="90"/>"#),
        wall("metal", r#"<rotate x="1" angle="-90"/>"#),
    ))
}

const PARAM: &str = "metal.alpha.value";

/// A result as a list of numbers, and whether it is said to be cut short.
type Found = (Vec<f64>, bool);

/// What makes one, given settings and samples.
type Computation<'a> = Box<dyn Fn(&Settings, u64, &dyn Progress) -> Found + 'a>;

fn numbers(r: Rendering) -> Found {
    (r.sums.concat(), r.cancelled)
}

fn jobs(scene: &Scene) -> Vec<(String, Computation<'_>)> {
    let values = scene.params().values();
    let along = Direction::uniform(scene.params(), PARAM).expect("a parameter");
    let ones = vec![1.0; scene.film.pixels() * 3];
    let mut jobs: Vec<(String, Computation<'_>)> = vec![
        (
            "waves".into(),
            Box::new(|s, spp, p| {
                let theta = Theta::constant(values);
                numbers(render_f32(
                    &Job::new(scene, s, 1, 0..spp, p),
                    &theta,
                    Estimator::Mis,
                ))
            }),
        ),
        (
            "single paths".into(),
            Box::new(|s, spp, p| {
                let values: Vec<f64> = values.iter().map(|&v| v.into()).collect();
                let theta = Theta::constant(&values);
                numbers(render_f64(
                    &Job::new(scene, s, 1, 0..spp, p),
                    &theta,
                    Estimator::Mis,
                ))
            }),
        ),
        (
            "forward in double precision".into(),
            Box::new({
                let along = along.clone();
                move |s, spp, p| {
                    numbers(forward_f64(&Job::new(scene, s, 1, 0..spp, p), &along).expect("known"))
                }
            }),
        ),
        (
            "particles".into(),
            Box::new(|s, spp, p| {
                let theta = Theta::constant(values);
                let r = particles_f32(&Job::new(scene, s, 1, 0..spp, p), &theta, Rules::default());
                numbers(r.expect("no flipped normals"))
            }),
        ),
        (
            "density".into(),
            Box::new(|s, spp, p| {
                let (theta, convention) = (Theta::constant(values), Convention::Radiance);
                let rules = Rules::default();
                let r = density_f32(
                    &Job::new(scene, s, 1, 0..spp, p),
                    &theta,
                    rules,
                    convention,
                    0.1,
                );
                numbers(r.expect("no flipped normals"))
            }),
        ),
    ];
    for e in [
        Estimator::Mis,
        Estimator::DifferentialMis,
        Estimator::AttachedNaive,
    ] {
        let (along, ones) = (along.clone(), ones.clone());
        jobs.push((
            format!("forward {}", e.name()),
            Box::new(move |s, spp, p| {
                let along = [along.clone()];
                let r = e.forward_f32(&Job::new(scene, s, 1, 0..spp, p), values, &along);
                numbers(r.expect("allowed"))
            }),
        ));
        let active = e.active(scene, &[PARAM]).expect("a parameter");
        jobs.push((
            format!("reverse {}", e.name()),
            Box::new(move |s, spp, p| {
                let theta = Theta::constant(values);
                let g = e.backward_f32(&Job::new(scene, s, 1, 0..spp, p), &theta, &active, &ones);
                let g = g.expect("allowed");
                (g.values.concat(), g.cancelled)
            }),
        ));
    }
    jobs
}

/// Whenever the answer comes, a result is complete or says that it is not.
#[test]
fn what_is_cut_short_says_so() {
    let scene = mirrors();
    for caustics in [Caustics::Paths, Caustics::Particles] {
        let settings = Settings {
            max_depth: 12,
            caustics,
            ..scene.settings
        };
        for (name, job) in jobs(&scene) {
            let (whole, cancelled) = job(&settings, 8, &());
            assert!(!cancelled, "{name}");
            let (mut cut, mut complete) = (0, 0);
            for questions in (0..40).chain((40..).step_by(37)) {
                let (found, cancelled) = job(&settings, 8, &Patience::of(questions));
                if cancelled {
                    cut += 1;
                    continue;
                }
                let same = found
                    .iter()
                    .zip(&whole)
                    .all(|(a, b)| a.to_bits() == b.to_bits());
                assert!(
                    same && found.len() == whole.len(),
                    "{name}: {questions} questions"
                );
                complete += 1;
                if complete == 3 {
                    break;
                }
            }
            // Asked many times within a tile.
            assert!(cut > 5, "{name}: {cut}");
        }
    }
}

/// Within one tile with more samples than anybody waits for, and on paths that never end.
#[test]
fn no_job_is_too_long_to_be_cancelled() {
    let scene = mirrors();
    let endless = Settings {
        rr_depth: u32::MAX,
        max_depth: u32::MAX,
        ..scene.settings
    };
    let many = Settings {
        max_depth: 3,
        ..scene.settings
    };
    for (name, job) in jobs(&scene) {
        for (settings, spp) in [(&endless, 1), (&many, 1 << 30)] {
            // All particles of a map are kept at once.
            if name == "density" && spp > 1 {
                continue;
            }
            let (_, cancelled) = job(settings, spp, &Patience::of(300));
            assert!(cancelled, "{name}");
        }
    }
}
