//! Automatic choice of estimators against every single estimator, on the scenes of the figures; and weights by the
//! measured variance of the derivative against the balance heuristic.

use std::time::Instant;

use rayon::prelude::*;
use render::Job;
use render::auto::{self, Mixture};
use render::bsdf::microfacet::Ndf;
use render::instances::{Direction, Estimator, Mode};
use render::params::Theta;
use render::{RenderError, Scene};

use crate::common_scenes::{self, TRAY, Walls, plates_of};
use crate::statistics::variance;
use crate::zeltner::alg_4_1;
use crate::zeltner::fig_4_18::Edge;
use crate::zeltner::fig_4_22::{self, Condition};
use crate::zeltner::{fig_4_19, fig_4_20};
use examples::builtin_scene;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};
use examples::ranks::median;

const SEED: u64 = 77;
/// Samples of `mis` per pixel for which `auto` plans.
const BUDGET: u64 = 4096;
/// Number of runs whose pilots have seeds of their own.
const PILOTS: u64 = 4;
/// Number of passes whose median is the time of one.
const TURNS: u64 = 5;
/// Combinations of light and BSDF samples whose weights are chosen by the variance that pilots measure; and the
/// heuristics.
const FAMILY: [Estimator; 3] = [
    Estimator::MisBalance,
    Estimator::MisTrustLights,
    Estimator::MisTrustBsdf,
];
/// The estimators that the chart shows; the table has all.
const CHARTED: [Estimator; 7] = [
    Estimator::Emitter,
    Estimator::Detached,
    Estimator::Differential,
    Estimator::Attached,
    Estimator::Reparameterised,
    Estimator::MisBalance,
    Estimator::DifferentialMisBalance,
];
const HEURISTICS: [Estimator; 2] = [Estimator::MisBalance, Estimator::Mis];

/// The scenes of [`subjects`] as charts number them.
pub(super) const SCENES: &str =
    "scene: 1 plates, 2 tray, 3 room, 4 room of recover, 5 outline, 6 horizon, 7 and 8 textures";

/// A scene and what is differentiated in it.
pub(super) struct Subject {
    pub name: &'static str,
    pub scene: Scene,
    pub params: Vec<String>,
}

/// The scenes of the figures, and what is differentiated in them.
///
/// # Errors
/// None for built-in scenes.
pub(super) fn subjects(quick: bool) -> Result<Vec<Subject>> {
    let pick = |a: u32, b: u32| if quick { a } else { b };
    let width = pick(64, 96);
    let alpha = |names: &[&str]| names.iter().map(|n| format!("{n}.alpha.value")).collect();
    let mut out = vec![
        Subject {
            name: "plates (4.19)",
            scene: plates_of(width, fig_4_19::ALPHAS, Ndf::Beckmann, false)?.scene,
            params: alpha(&["plate 0", "plate 1", "plate 2", "plate 3"]),
        },
        Subject {
            name: "tray (4.20)",
            scene: common_scenes::tray([pick(48, 64), pick(36, 48)], fig_4_20::DEPTH)?,
            params: TRAY
                .iter()
                .map(|(n, _)| format!("{n}.alpha.value"))
                .collect(),
        },
        Subject {
            name: "room (alg. 4.1)",
            scene: common_scenes::cornell(pick(32, 48), Walls::GlossyBack, 5)?,
            params: alg_4_1::NAMES.map(str::to_owned).to_vec(),
        },
        Subject {
            name: "room of recover",
            scene: render::scene::room(pick(32, 48), pick(32, 48))?,
            params: builtin_scene::cornell_unknowns()
                .iter()
                .map(|u| u.name.to_owned())
                .collect(),
        },
    ];
    for edge in [Edge::Ball, Edge::Horizon] {
        out.push(Subject {
            name: match edge {
                Edge::Ball => "outline (4.18 a)",
                Edge::Horizon => "horizon (4.18 b)",
            },
            scene: edge.scene(pick(48, 64))?,
            params: vec![edge.name().to_owned()],
        });
    }
    for condition in Condition::BOTH {
        let side = pick(64, 80);
        let truth = fig_4_22::pattern(side as usize);
        let truth = fig_4_22::within(condition.range(), &truth);
        out.push(Subject {
            name: match condition {
                Condition::RoughInHall => "texture A (4.22)",
                Condition::SmoothUnderLobes => "texture B (4.22)",
            },
            scene: condition.scene(side, &truth)?,
            params: vec![fig_4_22::NAME.to_owned()],
        });
    }
    Ok(out)
}

/// Numbers of runs and samples.
#[derive(Clone, Copy, Debug)]
struct Effort {
    runs: u64,
    /// Work per pixel and run, in samples of `mis`.
    spp: u64,
}

/// Variance of the derivative image times work, and times seconds, for one parameter.
#[derive(Clone, Copy, Debug)]
struct Spent {
    work: f64,
    seconds: f64,
}

/// Variance of the derivative image, summed, of a mixture: `plan(run)` has pilots of its own, and says how many samples.
/// All mixtures use the same random numbers: equal choices give equal images.
fn spread<'a>(
    subject: &Subject,
    param: &str,
    effort: Effort,
    plan: impl Fn(u64) -> (&'a Mixture, u64) + Sync,
) -> Result<f64> {
    let images: std::result::Result<Vec<Vec<f64>>, RenderError> = (0..effort.runs)
        .into_par_iter()
        .map(|run| {
            let (m, spp) = plan(run);
            let s = &subject.scene.settings;
            let r = m.forward_f32(&Job::new(&subject.scene, s, SEED + run, 0..spp, &()), param)?;
            let n = r.samples as f64;
            Ok(r.sums[1].iter().map(|x| x / n).collect())
        })
        .collect();
    Ok(variance(&images?))
}

/// Cost of a sample of each estimator: for each parameter in forward mode, for all together in reverse mode.
struct Clock {
    mode: Mode,
    samples: Vec<(Estimator, Vec<Sample>)>,
}

/// Seconds, the median of passes in turns, and counted work.
#[derive(Clone, Copy, Debug)]
struct Sample {
    seconds: f64,
    work: f64,
}

impl Clock {
    fn of(subject: &Subject, estimators: &[Estimator], effort: Effort, mode: Mode) -> Result<Self> {
        let (scene, s) = (&subject.scene, &subject.scene.settings);
        let theta = Theta::constant(scene.params().values());
        let ones = vec![1.0; scene.film.pixels() * 3];
        let spp = (effort.spp / TURNS).max(1);
        let mut samples: Vec<_> = estimators.iter().map(|&e| (e, Vec::new())).collect();
        let passes = match mode {
            Mode::Forward => subject.params.chunks(1),
            Mode::Reverse => subject.params.chunks(subject.params.len()),
        };
        for names in passes {
            let along = [Direction::uniform(scene.params(), &names[0])?];
            let works = auto::costs(scene, names, estimators, mode, s, SEED)?;
            let mut seconds = vec![Vec::new(); estimators.len()];
            for round in 0..TURNS {
                for (e, seconds) in estimators.iter().zip(&mut seconds) {
                    let active = e.active(scene, names);
                    let start = Instant::now();
                    match mode {
                        Mode::Forward => {
                            let values = scene.params().values();
                            e.forward_f32(&Job::new(scene, s, round, 0..spp, &()), values, &along)?;
                        }
                        Mode::Reverse => {
                            e.backward_f32(
                                &Job::new(scene, s, round, 0..spp, &()),
                                &theta,
                                &active?,
                                &ones,
                            )?;
                        }
                    }
                    seconds.push(start.elapsed().as_secs_f64() / spp as f64);
                }
            }
            for ((_, of), (seconds, work)) in samples.iter_mut().zip(seconds.into_iter().zip(works))
            {
                let seconds = median(&seconds).ok_or("no passes")?;
                of.push(Sample { seconds, work });
            }
        }
        Ok(Self { mode, samples })
    }

    /// The cost of a sample of an estimator, for the parameter with this index.
    fn sample(&self, e: Estimator, param: usize) -> Result<Sample> {
        let found = self.samples.iter().find(|(known, _)| *known == e);
        let of = &found.ok_or("an estimator that was not timed")?.1;
        Ok(match self.mode {
            Mode::Forward => of[param],
            Mode::Reverse => of[0],
        })
    }

    /// The cost of a mixture that spends all of `work`: for one parameter in forward mode.
    fn all(&self, m: &Mixture, subject: &Subject, param: usize, work: u64) -> Result<Sample> {
        let passes = match self.mode {
            Mode::Forward => m.samples(&subject.params[param], work),
            Mode::Reverse => m.passes(work),
        };
        let mut sum = Sample {
            seconds: 0.0,
            work: 0.0,
        };
        for (e, samples) in passes {
            let one = self.sample(e, param)?;
            sum.seconds += samples as f64 * one.seconds;
            sum.work += samples as f64 * one.work;
        }
        Ok(sum)
    }
}

/// Variance of a sample, for each parameter.
type Variances = Vec<f64>;

/// Measurements in one scene and mode: per estimator, per parameter.
struct Trial {
    singles: Vec<(Estimator, Vec<Spent>)>,
    auto: Vec<Spent>,
    chosen: Mixture,
}

/// Variances of a single estimator, with as many samples as the work pays for in forward mode.
fn single(subject: &Subject, e: Estimator, effort: Effort, forward: &Clock) -> Result<Variances> {
    let only = Mixture::only(&subject.scene, e, &subject.params);
    let of = |(k, param): (usize, &String)| {
        let work = forward.sample(e, k)?.work;
        let spp = ((effort.spp as f64 / work).round() as u64).max(1);
        Ok(spread(subject, param, effort, |_| (&only, spp))? * spp as f64)
    };
    subject.params.iter().enumerate().map(of).collect()
}

fn spent(e: Estimator, variances: &Variances, clock: &Clock) -> Result<Vec<Spent>> {
    let of = |(k, variance): (usize, &f64)| {
        let Sample { work, seconds } = clock.sample(e, k)?;
        Ok(Spent {
            work: variance * work,
            seconds: variance * seconds,
        })
    };
    variances.iter().enumerate().map(of).collect()
}

fn mixed(
    subject: &Subject,
    candidates: &[Estimator],
    effort: Effort,
    clock: &Clock,
) -> Result<(Vec<Spent>, Mixture)> {
    let scene = &subject.scene;
    let ones = vec![1.0; scene.film.pixels() * 3];
    let mut mixtures: Vec<Mixture> = Vec::new();
    let start = Instant::now();
    for pilot in 0..PILOTS {
        let s = &scene.settings;
        let p = &subject.params;
        let seed = SEED + pilot;
        mixtures.push(auto::choose(
            &Job::new(scene, s, seed, 0..BUDGET, &()),
            p,
            &ones,
            candidates,
            clock.mode,
        )?);
    }
    // The measured runs are a part of the budget, and bear that part of the cost of the pilots.
    let part = effort.spp as f64 / BUDGET as f64;
    let pilots = start.elapsed().as_secs_f64() / PILOTS as f64;
    let spent = mixtures.iter().map(Mixture::spent).sum::<f64>() / PILOTS as f64;
    let of = |(k, param): (usize, &String)| {
        // Each pilot's plan in turn, the parameter with its share of the work.
        let plan = |run: u64| {
            let m = &mixtures[(run % PILOTS) as usize];
            let share = effort.spp as f64 * m.share(param);
            (m, share.round().max(1.0) as u64)
        };
        let variance = spread(subject, param, effort, plan)?;
        let (mut work, mut seconds) = (spent * part, pilots * part);
        for m in &mixtures {
            let all = clock.all(m, subject, k, effort.spp)?;
            work += all.work / PILOTS as f64;
            seconds += all.seconds / PILOTS as f64;
        }
        Ok(Spent {
            work: variance * work,
            seconds: variance * seconds,
        })
    };
    let spent: Result<Vec<Spent>> = subject.params.iter().enumerate().map(of).collect();
    Ok((spent?, mixtures.swap_remove(0)))
}

/// `1 / (variance x work)`: parameters count alike, each in units of the best single estimator for it.
fn efficiency(of: &[Spent], best: &[f64], pick: impl Fn(&Spent) -> f64) -> f64 {
    let sum: f64 = of.iter().zip(best).map(|(s, b)| pick(s) / b).sum();
    of.len() as f64 / sum
}

fn best(singles: &[(Estimator, Vec<Spent>)], pick: impl Fn(&Spent) -> f64) -> Vec<f64> {
    let params = singles.first().map_or(0, |s| s.1.len());
    let least = |g: usize| {
        let all = singles.iter().map(|(_, spent)| pick(&spent[g]));
        all.fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE)
    };
    (0..params).map(least).collect()
}

/// Efficiencies in one mode, over that of the best single estimator.
struct Standing {
    /// Efficiency of each estimator by counted work and by time.
    singles: Vec<(Estimator, [f64; 2])>,
    auto: [f64; 2],
    favourite: Estimator,
}

impl Standing {
    fn of(trial: &Trial) -> Result<Self> {
        let picks: [fn(&Spent) -> f64; 2] = [|s| s.work, |s| s.seconds];
        let units = picks.map(|pick| best(&trial.singles, pick));
        let of = |spent: &[Spent]| [0, 1].map(|i| efficiency(spent, &units[i], picks[i]));
        let singles: Vec<_> = (trial.singles.iter())
            .map(|(e, spent)| (*e, of(spent)))
            .collect();
        let most = |i: usize| singles.iter().max_by(|a, b| a.1[i].total_cmp(&b.1[i]));
        let (Some(by_work), Some(by_clock)) = (most(0), most(1)) else {
            return Err("no estimator".into());
        };
        let relative = |[work, clock]: [f64; 2]| [work / by_work.1[0], clock / by_clock.1[1]];
        Ok(Self {
            favourite: by_work.0,
            auto: relative(of(&trial.auto)),
            singles: singles
                .iter()
                .map(|(e, found)| (*e, relative(*found)))
                .collect(),
        })
    }
}

/// `auto-estimator`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let effort = Effort {
        runs: fig.pick(8, 16),
        spp: fig.pick(32, 64),
    };
    fig.note("runs", effort.runs);
    fig.note("work per pixel and run", effort.spp);
    fig.note("budget", BUDGET);
    fig.note("seed", SEED);
    let mut rows = Vec::new();
    let mut series: Vec<(&'static str, Vec<(f64, f64)>)> = Vec::new();
    let mut weights = Vec::new();
    for (k, subject) in subjects(fig.quick())?.iter().enumerate() {
        let (trials, measured) = trial(subject, effort, k < 2)?;
        for (mode, auto, trial) in [
            ("forward", "auto", &trials[0]),
            ("reverse", "auto, reverse mode", &trials[1]),
        ] {
            let standing = Standing::of(trial)?;
            let chosen: Vec<String> = (trial.chosen.shares().iter())
                .map(|(e, share)| format!("{} {:.0} %", e.name(), 100.0 * share))
                .collect();
            let [work, clock] = standing.auto;
            fig.check(
                format!(
                    "(a) {}, {mode} mode: auto is at least 0.9 times as efficient as the best single one, by work",
                    subject.name
                ),
                work >= 0.9,
                format!(
                    "by work {work:.2} times {}, by the clock {clock:.2} times the best; chose {}; pilots {:.1} % of the work",
                    standing.favourite.name(),
                    chosen.join(" + "),
                    100.0 * trial.chosen.spent() / BUDGET as f64
                ),
            );
            let singles = standing.singles.iter().map(|(e, found)| (e.name(), *found));
            for (name, [work, clock]) in singles.chain([("auto", standing.auto)]) {
                rows.push([
                    subject.name.to_owned(),
                    mode.to_owned(),
                    name.to_owned(),
                    work.to_string(),
                    clock.to_string(),
                ]);
                let shown = match (name, mode) {
                    ("auto", _) => auto,
                    (_, "forward") => name,
                    _ => continue,
                };
                match series.iter_mut().find(|s| s.0 == shown) {
                    Some((_, points)) => points.push((k as f64 + 1.0, work)),
                    None => series.push((shown, vec![(k as f64 + 1.0, work)])),
                }
            }
        }
        if let Some(measured) = measured {
            weights.push((subject.name, measured));
        }
    }
    signed(fig, &weights);
    fig.csv_text(
        "efficiency",
        &[
            "scene",
            "mode",
            "estimator",
            "1 / (variance x work)",
            "1 / (variance x seconds)",
        ],
        rows,
    );
    let mut chart = LineChart::new(
        "Efficiency over that of the best single estimator",
        SCENES,
        "1 / (variance x work)",
    )
    .x_range(0.5, 12.0)
    .log_y();
    for (name, points) in series {
        chart = match name {
            "auto" => chart.measured(name, points),
            "auto, reverse mode" => chart.points(name, points),
            _ if CHARTED.iter().any(|e| e.name() == name) => chart.points(name, points),
            _ => chart,
        };
    }
    fig.chart("efficiency", &chart);
    Ok(())
}

/// Efficiency of weights by measured variance over balance and power heuristic, and of lights trusted eight times more and
/// less over balance.
struct Measured {
    gains: [f64; 2],
    fixed: [f64; 2],
}

/// Weights by measured variance against the heuristics.
fn signed(fig: &mut Figure, found: &[(&str, Measured)]) {
    let text = |(scene, found): &(&str, Measured)| {
        let ([balance, power], [more, less]) = (found.gains, found.fixed);
        format!(
            "{scene}: {balance:.2} and {power:.2} times; lights trusted 8 times more {more:.2}, less {less:.2} \
             times balance"
        )
    };
    let texts: Vec<String> = found.iter().map(text).collect();
    let worst = (found.iter().map(|(_, f)| f.gains[0])).fold(f64::INFINITY, f64::min);
    fig.check(
        "(b) trust in lights by the measured variance of the derivative: not worse than the balance heuristic \
         by more than the pilots and 10 %",
        worst > 0.85,
        format!(
            "efficiency over balance and power heuristic: {}",
            texts.join("; ")
        ),
    );
}

/// Forward and reverse mode, and in the former weights by measured variance if `heuristics`.
fn trial(
    subject: &Subject,
    effort: Effort,
    heuristics: bool,
) -> Result<([Trial; 2], Option<Measured>)> {
    let params = subject.scene.params();
    let mut estimators = Vec::new();
    for &e in Estimator::ALL {
        if e.capabilities().study {
            continue;
        }
        let sees = |name: &String| -> Result<bool> {
            Ok(auto::able(&subject.scene, params.find(name)?, &[e]).is_ok())
        };
        let all: Result<Vec<bool>> = subject.params.iter().map(sees).collect();
        if all?.iter().all(|b| *b) {
            estimators.push(e);
        }
    }
    let forward = Clock::of(subject, &estimators, effort, Mode::Forward)?;
    let reverse = Clock::of(subject, &estimators, effort, Mode::Reverse)?;
    let variances = (estimators.iter()).map(|&e| Ok((e, single(subject, e, effort, &forward)?)));
    let variances: Vec<(Estimator, Variances)> = variances.collect::<Result<_>>()?;
    let candidates = auto::candidates(&subject.scene);
    let of = |clock: &Clock| -> Result<Trial> {
        let singles = (variances.iter()).map(|(e, found)| Ok((*e, spent(*e, found, clock)?)));
        let (auto, chosen) = mixed(subject, &candidates, effort, clock)?;
        Ok(Trial {
            singles: singles.collect::<Result<_>>()?,
            auto,
            chosen,
        })
    };
    let (first, second) = (of(&forward)?, of(&reverse)?);
    let measured = if heuristics {
        let units = best(&first.singles, |s| s.work);
        let of = |spent: &[Spent]| efficiency(spent, &units, |s| s.work);
        let alone = |e: Estimator| {
            let found = first.singles.iter().find(|s| s.0 == e);
            found.map_or(0.0, |s| of(&s.1))
        };
        let own = of(&mixed(subject, &FAMILY, effort, &forward)?.0);
        let [balance, power] = HEURISTICS.map(alone);
        let fixed = [Estimator::MisTrustLights, Estimator::MisTrustBsdf];
        Some(Measured {
            gains: [own / balance, own / power],
            fixed: fixed.map(|e| alone(e) / balance),
        })
    } else {
        None
    };
    Ok(([first, second], measured))
}
