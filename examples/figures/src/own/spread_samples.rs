//! Owen-scrambled Sobol points, antithetic pairs and lights weighed before one is chosen, against independent
//! samples of any light, for estimators of derivatives of every kind, on the scenes of the figures.

use std::time::Instant;

use rayon::prelude::*;
use render::Job;
use render::auto;
use render::instances::{Direction, Estimator};
use render::sampler::Points;
use render::scene::LightChoice;
use render::{RenderError, Scene, Settings};

use super::auto_estimator::{SCENES, Subject, subjects};
use crate::statistics::variance;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const SEED: u64 = 1024;
/// One estimator for each kind of sampling: weights hardly change what evenly spread samples gain.
const ESTIMATORS: [Estimator; 7] = [
    Estimator::Emitter,
    Estimator::Detached,
    Estimator::Differential,
    Estimator::Attached,
    Estimator::Reparameterised,
    Estimator::MisBalance,
    Estimator::DifferentialMis,
];

/// A way of generating samples, and the criterion for its gains.
struct Variant {
    name: &'static str,
    points: Points,
    lights: LightChoice,
    claim: &'static str,
    /// Criterion for the smallest and the median gain in variance.
    passed: fn(f64, f64) -> bool,
}

// Where few samples carry the variance, its estimate is uncertain by some tens of per cent.
const VARIANTS: [Variant; 4] = [
    Variant {
        name: "sobol",
        points: Points::Sobol,
        lights: LightChoice::One,
        claim: "(a) Sobol points: variance of independent samples over theirs, never much below 1, above it as a rule",
        passed: |worst, middle| worst > 0.5 && middle > 1.05,
    },
    Variant {
        name: "antithetic",
        points: Points::Antithetic,
        lights: LightChoice::One,
        claim: "(b) antithetic pairs: the same, never below a half (each pair could be one sample)",
        passed: |worst, _| worst > 0.8 * 0.5,
    },
    Variant {
        name: "all lights",
        points: Points::Independent,
        lights: LightChoice::All,
        // Lights that contribute little may change much in variance.
        claim: "(c) all lights weighed, where there are several: above 1 as a rule, never below a quarter",
        passed: |worst, middle| worst > 0.25 && middle > 1.05,
    },
    Variant {
        name: "sobol, all lights",
        points: Points::Sobol,
        lights: LightChoice::All,
        claim: "(d) both: never much below 1, above it as a rule",
        passed: |worst, middle| worst > 0.5 && middle > 1.05,
    },
];

/// Sum over the pixels of the variance of derivative images, and seconds per image.
#[derive(Clone, Copy, Debug)]
struct Noise {
    variance: f64,
    seconds: f64,
}

fn noise(
    scene: &Scene,
    e: Estimator,
    along: &[Direction],
    (points, lights): (Points, LightChoice),
    spp: u64,
    runs: u64,
) -> Result<Noise> {
    let settings = Settings {
        points,
        lights,
        ..scene.settings
    };
    let start = Instant::now();
    let images: std::result::Result<Vec<Vec<f64>>, RenderError> = (0..runs)
        .into_par_iter()
        .map(|run| {
            let values = scene.params().values();
            let seed = SEED + run;
            let r = e.forward_f32(
                &Job::new(scene, &settings, seed, 0..spp, &()),
                values,
                along,
            )?;
            Ok(r.sums[1].iter().map(|x| x / spp as f64).collect())
        })
        .collect();
    let images = images?;
    let seconds = start.elapsed().as_secs_f64();
    Ok(Noise {
        variance: variance(&images),
        seconds: seconds / runs as f64,
    })
}

/// What is differentiated: all parameters of a kind at once.
fn directions(subject: &Subject) -> Result<Vec<Direction>> {
    let params = subject.scene.params();
    let first = subject.params[0]
        .split_once('.')
        .map_or("", |(_, kind)| kind);
    let alike = subject.params.iter().filter(|p| p.ends_with(first));
    let all: std::result::Result<Vec<_>, _> =
        alike.map(|p| Direction::uniform(params, p)).collect();
    Ok(all?)
}

/// `spread-samples`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let (spp, runs) = (fig.pick(32, 64), fig.pick(6, 12));
    fig.note("samples per pixel", spp);
    fig.note("runs", runs);
    fig.note("seed", SEED);
    let mut rows = Vec::new();
    let mut series: Vec<(String, Vec<(f64, f64)>)> = Vec::new();
    let mut gains: [Vec<(f64, f64, String)>; 4] = Default::default();
    let all = subjects(fig.quick())?;
    for (k, subject) in all.iter().enumerate() {
        let scene = &subject.scene;
        let along = directions(subject)?;
        let info = scene.params().find(&subject.params[0])?;
        for e in ESTIMATORS {
            if auto::able(scene, info, &[e]).is_err() {
                continue;
            }
            let of = |how| noise(scene, e, &along, how, spp, runs);
            let base = of((Points::Independent, LightChoice::One))?;
            for (v, gains) in VARIANTS.iter().zip(&mut gains) {
                let chooses = v.lights == LightChoice::All;
                // There is only one light, or the estimator samples none.
                if chooses && (scene.emitters().len() < 2 || !e.capabilities().samples_emitters) {
                    continue;
                }
                let found = of((v.points, v.lights))?;
                let gain = base.variance / found.variance;
                let faster = gain * base.seconds / found.seconds;
                gains.push((gain, faster, format!("{} in {}", e.name(), subject.name)));
                rows.push([
                    subject.name.to_owned(),
                    e.name().to_owned(),
                    v.name.to_owned(),
                    gain.to_string(),
                    faster.to_string(),
                ]);
                if v.name == "sobol" {
                    match series.iter_mut().find(|s| s.0 == e.name()) {
                        Some((_, line)) => line.push((k as f64 + 1.0, gain)),
                        None => series.push((e.name().to_owned(), vec![(k as f64 + 1.0, gain)])),
                    }
                }
            }
        }
    }
    for (v, mut gains) in VARIANTS.iter().zip(gains) {
        gains.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (Some(worst), Some(best)) = (gains.first(), gains.last()) else {
            continue;
        };
        let middle = gains[gains.len() / 2].0;
        let paid = gains.iter().filter(|g| g.1 > 1.0).count();
        fig.check(
            v.claim,
            (v.passed)(worst.0, middle),
            format!(
                "from {:.2} ({}) over {middle:.2} (median) to {:.2} ({}); pays on the clock in {paid} of {} cases",
                worst.0,
                worst.2,
                best.0,
                best.2,
                gains.len()
            ),
        );
    }
    let header = [
        "scene",
        "estimator",
        "samples",
        "gain in variance",
        "gain in efficiency",
    ];
    fig.csv_text("gains", &header, rows);
    let mut chart = LineChart::new(
        "Sobol points: variance of independent samples over theirs",
        SCENES,
        "gain",
    )
    .x_range(0.5, 10.0)
    .log_y();
    for (name, points) in series {
        chart = chart.points(&name, points);
    }
    fig.chart("gains", &chart);
    Ok(())
}
