//! Where a camera and a lamp are, found from one picture [Zeltner 2021, figure 4.24].

use optim::{
    Adam, AnyOptimizer, Constrained, GaussNewton, GaussNewtonOptions, Loss, LossKind, Rates,
    Schedule,
};
use rayon::prelude::*;
use render::instances::{Estimator, render_f32};
use render::integrator::gradient::Active;
use render::params::Theta;
use render::sampler::mix64;
use render::statistics::{Estimate, z_limit};
use render::{Image, Job, RenderError, Scene};

use crate::common_scenes::{BISHOP, PAWN, ROOK, table};
use crate::statistics::per_pixel;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::optimise::{Algorithm, Problem, Target};
use examples::scene_builder::{self, SceneBuilder, View};
use examples::tools::recover::groups;

const SEED: u64 = 424;
const NAMES: [&str; 3] = ["sensor.translation", "sensor.rotation", "light.translation"];
const LABELS: [&str; 9] = [
    "camera x", "camera y", "camera z", "turn x", "turn y", "turn z", "lamp x", "lamp y", "lamp z",
];
const EYE: [f64; 3] = [0.6, 2.4, 5.2];
const LAMP: [f64; 3] = [-1.6, 4.2, 1.8];
/// What the picture is not: a camera that is off by a fifth of its distance and nine degrees, and a lamp by an eighth of
/// its distance. The truth is zero.
const START: [f32; 9] = [0.65, -0.45, 0.6, 0.09, 0.11, 0.07, 0.35, -0.3, 0.35];
/// No variable moves further in a Gauss-Newton step; a tenth of a radian is six degrees.
const MAX_STEP: f64 = 0.1;
/// What a step of Adam is, for each of the three.
const RATES: [f64; 3] = [0.025, 0.006, 0.02];

/// Three turned pieces and two metal balls on a table of rough metal, below a spherical lamp that is not in view.
fn scene(width: u32) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    table(&mut builder, 0.4)?;
    let black = builder.matt("black", [0.0; 3])?;
    // Slightly above the table: surfaces that touch would meet in a line that moves with neither, and light between those
    // that nearly do is rare and bright in derivatives.
    const GAP: f64 = 0.05;
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
    let light = builder.ball("light", LAMP, 0.4, &black)?;
    builder.lamp("light", light, [70.0, 64.0, 54.0])?;
    builder.ambient([0.15, 0.17, 0.2])?;
    let view = View {
        eye: EYE,
        target: [0.05, 0.5, 0.0],
        fov: 34.0,
        size: [width, width * 3 / 4],
    };
    let mut scene = builder.finish(&view, 3)?;
    scene.make_movable(&NAMES)?;
    Ok(scene)
}

/// Steps at one size of images.
#[derive(Clone, Copy)]
struct Stage {
    /// Columns of images; three quarters as many rows.
    width: u32,
    /// Samples per pixel of derivatives, and of images.
    spp: [u32; 2],
    steps: u64,
}

const fn stage(width: u32, spp: [u32; 2], steps: u64) -> Stage {
    Stage { width, spp, steps }
}

/// The picture, and how others are compared with it.
struct Search {
    target: Image,
    loss: LossKind,
}

/// The values before every step and after the last one, the loss that each step saw, and the number of steps at the end of
/// every stage.
struct Descent {
    values: Vec<[f32; 9]>,
    losses: Vec<f64>,
    ends: Vec<usize>,
    bad: u64,
}

/// The largest distance from the truth, over that at the start.
fn worst(values: &[f32; 9]) -> f64 {
    errors(values).into_iter().fold(0.0, f64::max)
}

fn errors(values: &[f32; 9]) -> [f64; 9] {
    std::array::from_fn(|i| f64::from(values[i] / START[i]).abs())
}

impl Descent {
    fn last(&self) -> [f32; 9] {
        self.values.last().copied().unwrap_or(START)
    }

    /// The largest error at the start and at the end of every stage.
    fn by_stage(&self) -> Vec<f64> {
        let steps = std::iter::once(&0).chain(&self.ends);
        steps.map(|&step| worst(&self.values[step])).collect()
    }
}

/// Means over squares of pixels: what a coarser film sees, as its filter is a box.
fn coarser(image: &Image, width: usize) -> Image {
    let side = image.width / width;
    let mut out = Image::new(width, image.height / side);
    let scale = 1.0 / (side * side) as f32;
    for y in 0..out.height * side {
        for x in 0..width * side {
            let into = ((y / side) * width + x / side) * 3;
            for (c, v) in image.pixel(x, y).into_iter().enumerate() {
                out.data[into + c] += scale * v;
            }
        }
    }
    out
}

impl Search {
    fn problem(&self, stage: Stage) -> Result<Problem> {
        let scene = scene(stage.width)?;
        let active = Estimator::Edges.active(&scene, &NAMES)?;
        let mut settings = scene.settings;
        settings.spp = stage.spp[0];
        Ok(Problem {
            scene,
            settings,
            image_spp: Some(stage.spp[1]),
            active,
            estimator: Estimator::Edges,
            loss: self.loss,
            targets: vec![Target::of(coarser(&self.target, stage.width as usize))],
        })
    }

    fn descend(
        &self,
        stages: &[Stage],
        mut algorithm: impl FnMut(&Active) -> Result<Option<Algorithm>>,
    ) -> Result<Descent> {
        let mut out = Descent {
            values: vec![START],
            losses: Vec::new(),
            ends: Vec::new(),
            bad: 0,
        };
        let mut current = None;
        for stage in stages {
            let mut problem = self.problem(*stage)?;
            current = algorithm(&problem.active)?.or(current);
            let current = current.as_mut().ok_or("no algorithm")?;
            for _ in 0..stage.steps {
                let n = 2 * out.losses.len() as u64;
                let seeds = [n, n + 1].map(|s| mix64(SEED + 10 + s));
                let mut values = out.last();
                let report = problem.advance(&mut values, current, seeds, &())?;
                let report = report.ok_or("stopped")?;
                out.losses.push(report.loss);
                out.values.push(values);
                out.bad += report.non_finite.iter().map(|n| n.count).sum::<u64>();
            }
            out.ends.push(out.losses.len());
        }
        Ok(out)
    }

    /// Damping begins anew with every size of images.
    fn newton(&self, stages: &[Stage]) -> Result<Descent> {
        self.descend(stages, |active| {
            let options = GaussNewtonOptions {
                max_step: MAX_STEP,
                ..Default::default()
            };
            let newton = GaussNewton::new(Rates::new(9, 1.0)?, groups(active, &START)?, options)?;
            Ok(Some(Algorithm::GaussNewton(newton)))
        })
    }

    /// One run of Adam through all sizes.
    fn adam(&self, stages: &[Stage]) -> Result<Descent> {
        let steps = stages.iter().map(|s| s.steps).sum();
        let mut begun = false;
        self.descend(stages, |active| {
            if std::mem::replace(&mut begun, true) {
                return Ok(None);
            }
            let cosine = Schedule::Cosine { steps, floor: 0.02 };
            let mut rates = Rates::new(9, 1.0)?.with_schedule(cosine)?;
            for (k, rate) in RATES.into_iter().enumerate() {
                rates.set_rate(3 * k..3 * k + 3, rate)?;
            }
            let adam = AnyOptimizer::Adam(Adam::with_options(rates, Default::default())?);
            let adam = Constrained::new(adam, groups(active, &START)?)?;
            Ok(Some(Algorithm::FirstOrder(adam)))
        })
    }

    /// The picture from there, at the full size.
    fn picture(&self, values: &[f32; 9], spp: u64) -> Result<Image> {
        let mut problem = self.problem(stage(self.target.width as u32, [1, 1], 0))?;
        problem.set(values)?;
        Ok(scene_builder::picture(&problem.scene, SEED + 1, spp).image(0))
    }
}

/// `zeltner-4-24`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let many = fig.pick(512, 4096);
    let stages = &fig.pick(
        vec![
            stage(6, [128, 256], 3),
            stage(12, [64, 256], 5),
            stage(24, [16, 256], 7),
        ],
        vec![
            stage(6, [256, 512], 3),
            stage(12, [256, 512], 5),
            stage(24, [128, 512], 4),
            stage(48, [64, 512], 3),
        ],
    );
    let alone = fig.pick(stage(24, [4, 128], 15), stage(48, [64, 512], 15));
    let few = &fig.pick(
        vec![stage(6, [8, 8], 40), stage(12, [4, 8], 40)],
        vec![
            stage(6, [16, 16], 80),
            stage(12, [8, 16], 120),
            stage(24, [8, 16], 120),
            stage(48, [4, 8], 80),
        ],
    );
    let width = alone.width;
    let steps: u64 = stages.iter().map(|s| s.steps).sum();
    fig.note("pixels", width * width * 3 / 4);
    fig.note("Gauss-Newton steps", steps);
    fig.note("steps of Adam", few.iter().map(|s| s.steps).sum::<u64>());
    fig.note("samples per pixel of the picture", many);
    fig.note("seed", SEED);
    let search = Search {
        target: scene_builder::picture(&scene(width)?, SEED, many).image(0),
        loss: "relative-l2".parse()?,
    };
    gradients(fig, &search)?;
    let runs = [
        ("coarse to fine", search.newton(stages)?),
        ("one size", search.newton(&[alone])?),
        ("Adam", search.adam(few)?),
    ];
    judge(fig, &search, &runs)?;
    show(fig, &search, &runs)
}

/// (a) The gradient at the start against central differences, of which 2 % are allowed for the step.
fn gradients(fig: &mut Figure, search: &Search) -> Result {
    let (runs, step) = (fig.pick(8, 16), 1.0f32 / 64.0);
    let [spp, more] = fig.pick([144, 640], [320, 256]);
    let mut problem = search.problem(stage(fig.pick(12, 24), [1, 1], 0))?;
    problem.set(&START)?;
    let image = scene_builder::picture(&problem.scene, SEED + 2, 512).image(0);
    let mut adjoint = vec![0.0; image.data.len()];
    let target = &problem.targets[0].image;
    (problem.loss).gradient(&image.data, &target.data, &mut adjoint)?;
    let scene = &problem.scene;
    let theta = Theta::constant(scene.params().values());
    let gradient = |run: u64| {
        let seed = mix64(SEED + 100 + run);
        let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
        let g = Estimator::Edges.backward_f32(&job, &theta, &problem.active, &adjoint)?;
        Ok(g.values.concat())
    };
    let found: std::result::Result<Vec<Vec<f64>>, RenderError> =
        (0..runs).into_par_iter().map(gradient).collect();
    let found = per_pixel(&found?);
    let mut differences = Vec::new();
    for i in 0..9 {
        // Rotations turn what is five away.
        let h = step / if (3..6).contains(&i) { 5.0 } else { 1.0 };
        let mut sides = [Vec::new(), Vec::new()];
        for (sign, out) in [1.0, -1.0].into_iter().zip(&mut sides) {
            let mut values = START;
            values[i] += sign * h;
            problem.set(&values)?;
            let scene = &problem.scene;
            let theta = Theta::constant(scene.params().values());
            let along = |run: u64| {
                let seed = mix64(SEED + 200 + run);
                let job = Job::new(scene, &scene.settings, seed, 0..more, &());
                let image = render_f32(&job, &theta, Estimator::Mis).image(0);
                let pairs = image.data.iter().zip(&adjoint);
                pairs
                    .map(|(x, d)| f64::from(*x) * f64::from(*d))
                    .sum::<f64>()
            };
            *out = (0..runs).into_par_iter().map(along).collect::<Vec<f64>>();
        }
        let [up, down] = &sides;
        let pairs = up.iter().zip(down);
        let each = pairs.map(|(a, b)| (a - b) / (2.0 * f64::from(h)));
        differences.push(Estimate::of(&each.collect::<Vec<_>>()));
    }
    let limit = z_limit(9, runs, 1e-3);
    let (mut largest, mut fewest) = (0.0f64, f64::INFINITY);
    let mut rows = Vec::new();
    for kind in 0..3 {
        let own = 3 * kind..3 * kind + 3;
        let sizes = differences[own.clone()].iter().map(|d| d.mean.abs());
        let size = sizes.fold(0.0, f64::max);
        for i in own {
            let (g, d) = (found[i], differences[i]);
            let error = g.se.hypot(d.se);
            let off = ((g.mean - d.mean).abs() - 0.02 * size).max(0.0);
            largest = largest.max(off / error);
            fewest = fewest.min(size / error);
            rows.push([i as f64, g.mean, g.se, d.mean, d.se]);
        }
    }
    let header = ["parameter", "gradient", "error", "difference", "its error"];
    fig.csv("gradients", &header, rows);
    fig.check(
        "(a) at the start, the gradient in each of nine parameters is that of central differences",
        largest < limit && fewest > fig.pick(1.5, 4.0),
        format!(
            "largest |z| {largest:.2}, limit {limit:.2}; the largest of each kind is at least {fewest:.1} standard errors"
        ),
    );
    Ok(())
}

fn judge(fig: &mut Figure, search: &Search, runs: &[(&str, Descent); 3]) -> Result {
    let [(_, found), (_, alone), (_, adam)] = runs;
    let percents = |values: &[f64]| {
        let each: Vec<String> = values.iter().map(|e| format!("{:.1}", 100.0 * e)).collect();
        each.join(", ")
    };
    let end = found.last();
    let goal = fig.pick(0.25, 0.05);
    let steps = found.losses.len();
    let bad: u64 = runs.iter().map(|(_, run)| run.bad).sum();
    fig.check(
        format!(
            "(b) after {steps} Gauss-Newton steps all nine errors are below {:.0} % of those at the start",
            100.0 * goal
        ),
        worst(&end) < goal && bad == 0,
        format!("{} %; {bad} samples left out", percents(&errors(&end))),
    );
    let many = fig.pick(256, 1024);
    let loss = |values: &[f32; 9]| -> Result<f64> {
        let image = search.picture(values, many)?;
        Ok(search.loss.value(&image.data, &search.target.data)?)
    };
    let [first, last, by_one] = [loss(&START)?, loss(&end)?, loss(&alone.last())?];
    let ratio = fig.pick(50.0, 100.0);
    fig.check(
        format!("(c) the loss falls by a factor of more than {ratio}"),
        last * ratio < first,
        format!("from {first:.3e} to {last:.3e}, by {:.0}", first / last),
    );
    let stages = found.by_stage();
    fig.check(
        "(d) at each size of images the largest of the nine errors ends lower than at the one before",
        (stages[1..].windows(2)).all(|pair| pair[1] < pair[0]),
        format!("{} % at the start and at the end of each size", percents(&stages)),
    );
    fig.check(
        "(e) with images of the full size from the beginning, as many steps do not find it",
        worst(&alone.last()) > 1.0 && by_one > 10.0 * last,
        format!(
            "the largest error is {:.0} % of that at the start, the loss {by_one:.3e}",
            100.0 * worst(&alone.last())
        ),
    );
    fig.check(
        "(f) Adam, which takes no notice of what undoes each other, is farther away after more steps",
        worst(&adam.last()) > 2.0 * worst(&end),
        format!(
            "largest error {:.1} % after {} steps",
            100.0 * worst(&adam.last()),
            adam.losses.len()
        ),
    );
    Ok(())
}

fn show(fig: &mut Figure, search: &Search, runs: &[(&str, Descent); 3]) -> Result {
    let mut largest = LineChart::new("Largest of nine errors", "step", "over that at the start")
        .log_x()
        .log_y();
    let mut above =
        LineChart::new("Seen from above: cameras and lamps", "x", "z").x_range(-3.0, 4.0);
    for (label, run) in runs {
        let rows = run.values.iter().enumerate().map(|(i, values)| {
            let mut row = [0.0; 11];
            row[0] = i as f64;
            row[1] = run.losses.get(i).copied().unwrap_or(f64::NAN);
            (row[2..].iter_mut().zip(values)).for_each(|(out, v)| *out = (*v).into());
            row
        });
        let mut header = ["step", "loss seen", "", "", "", "", "", "", "", "", ""];
        header[2..].copy_from_slice(&LABELS);
        fig.csv(
            &format!("values-{}", label.replace(' ', "-")),
            &header,
            rows,
        );
        let steps = run.values.iter().enumerate().skip(1);
        largest = largest.line(label, steps.map(|(i, v)| (i as f64, worst(v))));
        let path = |from: [f64; 3], x: usize, z: usize| {
            let points = run.values.iter();
            points
                .map(|v| (from[0] + f64::from(v[x]), from[2] + f64::from(v[z])))
                .collect::<Vec<_>>()
        };
        above = above.line(&format!("camera, {label}"), path(EYE, 0, 2));
        above = above.line(&format!("lamp, {label}"), path(LAMP, 6, 8));
    }
    let found = &runs[0].1;
    for (what, own) in [("camera", 0..6), ("lamp", 6..9)] {
        let title = format!("The {what} by Gauss-Newton, coarse to fine");
        let mut errors = LineChart::new(&title, "step", "error over that at the start");
        for k in own {
            let values = found.values.iter().enumerate();
            let error = |(i, v): (usize, &[f32; 9])| (i as f64, f64::from(v[k] / START[k]));
            errors = errors.line(LABELS[k], values.map(error));
        }
        fig.chart(&format!("errors-{what}"), &errors);
    }
    fig.chart("largest", &largest);
    let truth = [(EYE[0], EYE[2]), (LAMP[0], LAMP[2])];
    fig.chart("above", &above.points("where they are", truth));
    let (enlarge, spp) = (fig.pick(6, 4), fig.pick(64, 256));
    let mut panels = Vec::new();
    let mut add = |label: &str, values: &[f32; 9]| -> Result {
        let image = search.picture(values, spp)?;
        panels.push(Panel::tonemapped(label, &image, 1.0).enlarged(enlarge));
        Ok(())
    };
    add("start", &START)?;
    for step in &found.ends {
        add(&format!("step {step}"), &found.values[*step])?;
    }
    for (label, run) in &runs[1..] {
        add(&format!("{label}, step {}", run.losses.len()), &run.last())?;
    }
    panels.push(Panel::tonemapped("picture", &search.target, 1.0).enlarged(enlarge));
    fig.images("pictures", 4, &panels);
    Ok(())
}
