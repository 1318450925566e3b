//! Where a camera and a lamp are, found from one picture [Zeltner 2021, figure 4.24].

use optim::{Adam, AnyOptimizer, Constrained, GaussNewton, Loss, LossKind, Rates, Schedule};
use rayon::prelude::*;
use render::instances::{Estimator, render_f32};
use render::params::Theta;
use render::sampler::mix64;
use render::statistics::z_limit;
use render::{Image, Job, Scene};

use crate::chart::{LineChart, Panel};
use crate::figure::{Figure, Result};
use crate::figures::common_scenes::{BISHOP, PAWN, ROOK};
use crate::figures::statistics::Estimate;
use crate::optimise::{Algorithm, Problem, Target};
use crate::scene_builder::{self, SceneBuilder, View};
use crate::tools::recover::{WHOLE_STEPS, groups};

const SEED: u64 = 424;
const NAMES: [&str; 3] = ["sensor.translation", "sensor.rotation", "light.translation"];
const LABELS: [&str; 9] = [
    "camera x", "camera y", "camera z", "turn x", "turn y", "turn z", "lamp x", "lamp y", "lamp z",
];
const EYE: [f64; 3] = [0.6, 2.4, 5.2];
const TARGET: [f64; 3] = [0.05, 0.5, 0.0];
/// What the picture is not: a camera that is off by a fifth of its distance and nearly ten degrees, a lamp by a fifth of
/// its distance. The truth is zero.
const START: [f32; 9] = [0.65, -0.45, 0.6, 0.09, 0.11, 0.07, 0.35, -0.3, 0.35];
/// What a step of Adam is, for each of the three.
const RATES: [f64; 3] = [0.025, 0.006, 0.02];

fn scene(size: [u32; 2]) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let floor = builder.matt("floor", [0.35, 0.32, 0.3])?;
    let table = builder.metal("table", [0.7, 0.62, 0.5], 0.4)?;
    let black = builder.matt("black", [0.0; 3])?;
    let flat = |half: f64, y: f64| {
        let side = 2.0 * half;
        [[-half, y, half], [side, 0.0, 0.0], [0.0, 0.0, -side]]
    };
    builder.quad("floor", flat(12.0, -0.6), &floor)?;
    builder.quad("table", flat(2.0, 0.0), &table)?;
    // Slightly above the table: surfaces that touch would meet in a line that moves with neither.
    const GAP: f64 = 0.004;
    for (name, profile, at, colour) in [
        ("bishop", &BISHOP[..], [-0.45, GAP, 0.2], [0.6, 0.25, 0.15]),
        ("rook", &ROOK, [0.85, GAP, -0.5], [0.75, 0.72, 0.65]),
        ("pawn", &PAWN, [-1.15, GAP, -0.7], [0.25, 0.3, 0.45]),
    ] {
        let matt = builder.matt(name, colour)?;
        builder.turned(name, profile, at, &matt)?;
    }
    for (name, at, radius, colour) in [
        ("gold", [0.45, 0.36, 0.7], 0.35, [0.95, 0.75, 0.35]),
        ("steel", [0.0, 0.26, -0.75], 0.25, [0.8, 0.85, 0.9]),
    ] {
        let metal = builder.front_metal(name, colour, 0.2)?;
        builder.ball(name, at, radius, &metal)?;
    }
    let light = builder.ball("light", [-1.7, 2.7, 0.9], 0.3, &black)?;
    builder.lamp("light", light, [60.0, 55.0, 46.0])?;
    builder.ambient([0.15, 0.17, 0.2])?;
    let view = View {
        eye: EYE,
        target: TARGET,
        fov: 34.0,
        size,
    };
    let mut scene = builder.finish(&view, 4)?;
    scene.make_movable(&NAMES)?;
    Ok(scene)
}

struct Effort {
    /// Samples per pixel of pictures that are looked at.
    many: u64,
    /// Samples per pixel and steps of Adam, and of Gauss-Newton.
    adam: (u32, u64),
    newton: (u32, u64),
}

struct Setup {
    problem: Problem,
    effort: Effort,
}

/// The values before every step, and the loss that each step saw.
struct Descent {
    values: Vec<Vec<f32>>,
    losses: Vec<f64>,
    bad: u64,
}

impl Descent {
    /// The mean over the last quarter, whose noise it removes.
    fn end(&self) -> Vec<f64> {
        let from = self.values.len() - self.values.len().div_ceil(4);
        let tail = &self.values[from..];
        let mean = |i: usize| tail.iter().map(|v| f64::from(v[i])).sum::<f64>() / tail.len() as f64;
        (0..9).map(mean).collect()
    }

    fn last(&self) -> Vec<f64> {
        self.values
            .last()
            .map_or(Vec::new(), |v| v.iter().map(|&x| x.into()).collect())
    }
}

/// Distance from the truth, over that at the start.
fn errors(values: &[f64]) -> Vec<f64> {
    values
        .iter()
        .zip(START)
        .map(|(v, s)| (v / f64::from(s)).abs())
        .collect()
}

fn worst(values: &[f64]) -> f64 {
    errors(values).into_iter().fold(0.0, f64::max)
}

impl Setup {
    fn picture(&mut self, values: &[f64], seed: u64) -> Result<Image> {
        let values: Vec<f32> = values.iter().map(|&v| v as f32).collect();
        self.problem.set(&values)?;
        let image = scene_builder::picture(&self.problem.scene, seed, self.effort.many);
        Ok(image.image(0))
    }

    /// The loss with little noise.
    fn loss(&mut self, values: &[f64]) -> Result<f64> {
        let image = self.picture(values, SEED + 1)?;
        let target = &self.problem.targets[0].image;
        Ok(self.problem.loss.value(&image.data, &target.data)?)
    }

    fn descend(&mut self, mut algorithm: Algorithm, (spp, steps): (u32, u64)) -> Result<Descent> {
        self.problem.settings.spp = spp;
        let mut values = START.to_vec();
        let mut out = Descent {
            values: vec![values.clone()],
            losses: Vec::new(),
            bad: 0,
        };
        for i in 0..steps {
            let seeds = [2 * i, 2 * i + 1].map(|s| mix64(SEED + 10 + s));
            let report = self
                .problem
                .advance(&mut values, &mut algorithm, seeds, &())?;
            let report = report.ok_or("stopped")?;
            out.losses.push(report.loss);
            out.values.push(values.clone());
            out.bad += report.non_finite.iter().map(|n| n.count).sum::<u64>();
        }
        Ok(out)
    }

    fn adam(&mut self) -> Result<Descent> {
        let steps = self.effort.adam.1;
        let groups = groups(&self.problem.active, &START)?;
        let cosine = Schedule::Cosine { steps, floor: 0.02 };
        let mut rates = Rates::new(9, 1.0)?.with_schedule(cosine)?;
        for (k, rate) in RATES.into_iter().enumerate() {
            rates.set_rate(3 * k..3 * k + 3, rate)?;
        }
        let adam = AnyOptimizer::Adam(Adam::with_options(rates, Default::default())?);
        let adam = Constrained::new(adam, groups)?;
        self.descend(Algorithm::FirstOrder(adam), self.effort.adam)
    }

    fn newton(&mut self) -> Result<Descent> {
        let groups = groups(&self.problem.active, &START)?;
        let whole = Schedule::Harmonic { hold: WHOLE_STEPS };
        let rates = Rates::new(9, 1.0)?.with_schedule(whole)?;
        let newton = GaussNewton::new(rates, groups, Default::default())?;
        self.descend(Algorithm::GaussNewton(newton), self.effort.newton)
    }
}

/// `zeltner-4-24`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick([24, 18], [64, 48]);
    let effort = Effort {
        many: fig.pick(256, 1024),
        adam: fig.pick((4, 120), (8, 400)),
        newton: fig.pick((16, 15), (64, 15)),
    };
    fig.note("pixels", size[0] * size[1]);
    fig.note("steps of Adam", effort.adam.1);
    fig.note("samples per pixel of a step of Adam", effort.adam.0);
    fig.note("samples per pixel of a Gauss-Newton step", effort.newton.0);
    fig.note("seed", SEED);
    let scene = scene(size)?;
    let target = scene_builder::picture(&scene, SEED, 4 * effort.many).image(0);
    let active = Estimator::Edges.active(&scene, &NAMES)?;
    let settings = scene.settings;
    let mut setup = Setup {
        problem: Problem {
            scene,
            settings,
            active,
            estimator: Estimator::Edges,
            loss: "relative-l2".parse::<LossKind>()?,
            targets: vec![Target::of(target)],
        },
        effort,
    };
    gradients(fig, &mut setup)?;
    let adam = setup.adam()?;
    let newton = setup.newton()?;
    judge(fig, &mut setup, &adam, &newton)?;
    show(fig, &mut setup, &adam, &newton)
}

/// (a) The gradient at the start against central differences, of which 2 % are allowed for the step.
fn gradients(fig: &mut Figure, setup: &mut Setup) -> Result {
    let (runs, spp, step) = (fig.pick(8, 16), fig.pick(48, 128), 1.0f32 / 64.0);
    let start: Vec<f64> = START.iter().map(|&x| x.into()).collect();
    let image = setup.picture(&start, SEED + 2)?;
    let problem = &mut setup.problem;
    let mut adjoint = vec![0.0; image.data.len()];
    let target = &problem.targets[0].image;
    (problem.loss).gradient(&image.data, &target.data, &mut adjoint)?;
    let scene = &problem.scene;
    let theta = Theta::constant(scene.params().values());
    let gradient = |seed: u64| {
        let job = Job::new(
            scene,
            &scene.settings,
            mix64(SEED + 100 + seed),
            0..spp,
            &(),
        );
        let g = Estimator::Edges.backward_f32(&job, &theta, &problem.active, &adjoint)?;
        Ok(g.values.concat())
    };
    let found: std::result::Result<Vec<Vec<f64>>, render::RenderError> =
        (0..runs).into_par_iter().map(gradient).collect();
    let found = crate::figures::statistics::per_pixel(&found?);
    let mut differences = Vec::new();
    for i in 0..9 {
        // Rotations turn what is five away.
        let h = if (3..6).contains(&i) {
            step / 5.0
        } else {
            step
        };
        let mut sides = [Vec::new(), Vec::new()];
        for (sign, out) in [1.0, -1.0].into_iter().zip(&mut sides) {
            let mut values = START;
            values[i] += sign * h;
            problem.set(&values)?;
            let scene = &problem.scene;
            let theta = Theta::constant(scene.params().values());
            let along = |seed: u64| {
                let seed = mix64(SEED + 200 + seed);
                let job = Job::new(scene, &scene.settings, seed, 0..2 * spp, &());
                let image = render_f32(&job, &theta, Estimator::Mis).image(0);
                let pairs = image.data.iter().zip(&adjoint);
                pairs
                    .map(|(x, d)| f64::from(*x) * f64::from(*d))
                    .sum::<f64>()
            };
            *out = (0..runs).into_par_iter().map(along).collect::<Vec<f64>>();
        }
        let [up, down] = &sides;
        let slopes = up
            .iter()
            .zip(down)
            .map(|(a, b)| (a - b) / (2.0 * f64::from(h)));
        differences.push(Estimate::of(slopes));
    }
    let limit = z_limit(9, runs, 1e-3);
    let (mut largest, mut fewest) = (0.0f64, f64::INFINITY);
    let mut rows = Vec::new();
    for kind in 0..3 {
        let own = 3 * kind..3 * kind + 3;
        let size = differences[own.clone()]
            .iter()
            .fold(0.0, |m: f64, d| m.max(d.mean.abs()));
        for i in own {
            let (g, d) = (found[i], differences[i]);
            let error = g.error.hypot(d.error);
            let off = ((g.mean - d.mean).abs() - 0.02 * size).max(0.0);
            largest = largest.max(off / error);
            fewest = fewest.min(size / error);
            rows.push([i as f64, g.mean, g.error, d.mean, d.error]);
        }
    }
    let header = ["parameter", "gradient", "error", "difference", "its error"];
    fig.csv("gradients", &header, rows);
    fig.check(
        "(a) at the start, the gradient in each of nine parameters is that of central differences",
        largest < limit && fewest > fig.pick(3.0, 5.0),
        format!(
            "largest |z| {largest:.2}, limit {limit:.2}; the largest of each kind is at least {fewest:.0} standard errors"
        ),
    );
    Ok(())
}

fn judge(fig: &mut Figure, setup: &mut Setup, adam: &Descent, newton: &Descent) -> Result {
    let start: Vec<f64> = START.iter().map(|&x| x.into()).collect();
    let (end, stepped) = (adam.end(), newton.last());
    let first = setup.loss(&start)?;
    let [last, by_newton] = [setup.loss(&end)?, setup.loss(&stepped)?];
    let percents = |values: &[f64]| {
        let each = errors(values);
        let each: Vec<String> = each.iter().map(|e| format!("{:.1}", 100.0 * e)).collect();
        each.join(", ")
    };
    fig.check(
        "(b) Adam: all nine errors end below 5 % of those at the start",
        worst(&end) < 0.05 && adam.bad == 0,
        format!("{} %", percents(&end)),
    );
    let ratio = fig.pick(50.0, 100.0);
    fig.check(
        format!("(c) Adam: the loss falls by a factor of more than {ratio}"),
        last * ratio < first,
        format!("from {first:.3e} to {last:.3e}, by {:.0}", first / last),
    );
    // Of the largest of the nine, over tenths of the steps.
    let tenth = adam.values.len() / 10;
    let means: Vec<f64> = (0..10)
        .map(|k| {
            let part = &adam.values[k * tenth..(k + 1) * tenth];
            let norm = |v: &Vec<f32>| {
                let v: Vec<f64> = v.iter().map(|&x| x.into()).collect();
                errors(&v).iter().map(|e| e * e).sum::<f64>().sqrt()
            };
            part.iter().map(norm).sum::<f64>() / part.len() as f64
        })
        .collect();
    // Once it is down to noise there is no trend.
    let falls = means.windows(2).all(|w| w[1] < w[0] || w[1] < 0.15);
    fig.check(
        "(d) Adam: the error falls from tenth to tenth of the steps",
        falls,
        means
            .iter()
            .map(|m| format!("{m:.3}"))
            .collect::<Vec<_>>()
            .join(", "),
    );
    fig.check(
        "(e) Gauss-Newton: all nine errors are below 5 % of those at the start after 15 steps",
        worst(&stepped) < 0.05 && newton.bad == 0,
        format!(
            "{} %; the loss falls by {:.0}",
            percents(&stepped),
            first / by_newton
        ),
    );
    Ok(())
}

fn show(fig: &mut Figure, setup: &mut Setup, adam: &Descent, newton: &Descent) -> Result {
    for (name, label, run) in [("adam", "Adam", adam), ("newton", "Gauss-Newton", newton)] {
        let title = format!("{label}: error over that at the start");
        let mut chart = LineChart::new(&title, "step", "error").log_y();
        for (k, label) in LABELS.into_iter().enumerate() {
            let points = run
                .values
                .iter()
                .enumerate()
                .map(|(i, v)| (i as f64, f64::from((v[k] / START[k]).abs()).max(1e-4)));
            chart = chart.line(label, points);
        }
        fig.chart(&format!("errors-{name}"), &chart);
        let rows = run.values.iter().enumerate().map(|(i, v)| {
            let mut row = [i as f64; 11];
            row[1] = run.losses.get(i).copied().unwrap_or(f64::NAN);
            v.iter()
                .zip(&mut row[2..])
                .for_each(|(v, out)| *out = (*v).into());
            row
        });
        let mut header = ["step", "loss seen", "", "", "", "", "", "", "", "", ""];
        header[2..].copy_from_slice(&LABELS);
        fig.csv(&format!("values-{name}"), &header, rows);
    }
    let mut losses = LineChart::new("Loss that steps see", "step", "relative L2").log_y();
    let mut above = LineChart::new("Seen from above: cameras and lamp", "x", "z");
    for (label, run) in [("Adam", adam), ("Gauss-Newton", newton)] {
        losses = losses.line(
            label,
            run.losses.iter().enumerate().map(|(i, l)| (i as f64, *l)),
        );
        let path = |from: [f64; 2], x: usize, z: usize| {
            let points = run.values.iter();
            points
                .map(|v| (from[0] + f64::from(v[x]), from[1] + f64::from(v[z])))
                .collect::<Vec<_>>()
        };
        above = above.line(&format!("camera, {label}"), path([EYE[0], EYE[2]], 0, 2));
        above = above.line(&format!("lamp, {label}"), path([-1.7, 0.9], 6, 8));
    }
    fig.chart("losses", &losses);
    fig.chart(
        "above",
        &above.points("where they are", [(EYE[0], EYE[2]), (-1.7, 0.9)]),
    );
    let enlarge = fig.pick(8, 4);
    let mut panels = Vec::new();
    let all = |v: &Vec<f32>| v.iter().map(|&x| x.into()).collect::<Vec<f64>>();
    for (label, run) in [("Adam", adam), ("Gauss-Newton", newton)] {
        let last = run.values.len() - 1;
        for step in [0, last / 8, last / 3, last] {
            let image = setup.picture(&all(&run.values[step]), SEED + 3)?;
            panels.push(
                Panel::tonemapped(&format!("{label}, step {step}"), &image, 1.0).enlarged(enlarge),
            );
        }
        let target = &setup.problem.targets[0].image;
        panels.push(Panel::tonemapped("target", target, 1.0).enlarged(enlarge));
    }
    fig.images("pictures", 5, &panels);
    Ok(())
}
