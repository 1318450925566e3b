//! Second derivatives in inverse rendering: the times in which Gauss-Newton steps and Adam recover parameters, and the
//! whole Hessian beside its Gauss-Newton part.

use std::time::{Duration, Instant};

use optim::{Adam, AnyOptimizer, Constrained, GaussNewton, Rates, Schedule};
use render::sampler::mix64;

use examples::builtin_scene;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};
use examples::optimise::{Algorithm, Problem};
use examples::say;
use examples::scene_builder::picture;
use examples::tools::recover::{WHOLE_STEPS, groups};

const SEED: u64 = 5;
/// Largest relative errors of the parameters: the times to reach them are compared.
const GOALS: [f64; 3] = [0.1, 0.02, 0.01];

/// The built-in scene of `recover`, and what is to be found in it.
struct Setup {
    problem: Problem,
    start: Vec<f32>,
    truth: Vec<f32>,
}

fn setup(fig: &Figure) -> Result<Setup> {
    let size = fig.pick(32, 64);
    let scene = render::scene::room(size, size)?;
    let unknowns = builtin_scene::cornell_unknowns();
    let names: Vec<&str> = unknowns.iter().map(|u| u.name).collect();
    let target = picture(&scene, 1, fig.pick(1024, 4096)).image(0);
    let problem = Problem::of(scene, &names, "relative-l2".parse()?, target)?;
    let truth = problem.values();
    let start = unknowns.into_iter().flat_map(|u| u.start).collect();
    Ok(Setup {
        problem,
        start,
        truth,
    })
}

/// A run of one algorithm.
struct Run {
    label: String,
    steps: u64,
    spp: u32,
    algorithm: Algorithm,
    values: Vec<f32>,
    done: u64,
    time: Duration,
    /// Seconds since the start, and the largest relative error at that time, after every step.
    errors: Vec<(f64, f64)>,
}

impl Run {
    fn new(setup: &Setup, name: &str, (steps, spp): (u64, u32), algorithm: Algorithm) -> Self {
        let values = setup.start.clone();
        Self {
            label: format!("{name}, {steps} steps of {spp} samples"),
            steps,
            spp,
            algorithm,
            errors: vec![(0.0, error(&values, &setup.truth))],
            values,
            done: 0,
            time: Duration::ZERO,
        }
    }

    fn step(&mut self, setup: &mut Setup) -> Result {
        let n = SEED + 2 * self.done;
        let seeds = [n, n + 1].map(mix64);
        let start = Instant::now();
        let problem = &mut setup.problem;
        problem.settings.spp = self.spp;
        let step = problem.advance(&mut self.values, &mut self.algorithm, seeds, &())?;
        self.time += start.elapsed();
        step.ok_or("stopped")?;
        self.done += 1;
        let e = error(&self.values, &setup.truth);
        self.errors.push((self.time.as_secs_f64(), e));
        Ok(())
    }

    /// Seconds after which the error stays below `goal`.
    fn time_to(&self, goal: f64) -> Option<f64> {
        let above = self.errors.iter().rposition(|(_, e)| *e >= goal);
        let first = above.map_or(0, |k| k + 1);
        self.errors.get(first).map(|(t, _)| *t)
    }
}

fn error(values: &[f32], truth: &[f32]) -> f64 {
    let relative = |(v, t): (&f32, &f32)| f64::from((v - t).abs() / t);
    values.iter().zip(truth).map(relative).fold(0.0, f64::max)
}

fn runs(fig: &Figure, setup: &Setup) -> Result<Vec<Run>> {
    let groups = groups(&setup.problem.active, &setup.start)?;
    let n = setup.start.len();
    let whole = Schedule::Harmonic { hold: WHOLE_STEPS };
    let rates = Rates::new(n, 1.0)?.with_schedule(whole)?;
    let newton = GaussNewton::new(rates, groups.clone(), Default::default())?;
    let size = fig.pick((12, 48), (40, 48));
    let newton = Algorithm::GaussNewton(newton);
    let mut runs = vec![Run::new(setup, "Gauss-Newton", size, newton)];
    // The tool's setting, a shorter run with longer steps, and one with less noise.
    let settings = [(400, 12, 0.03), (150, 12, 0.06), (150, 48, 0.06)];
    for &(steps, spp, rate) in &settings[..fig.pick(1, 3)] {
        let floor = 0.01;
        let rates = Rates::new(n, rate)?.with_schedule(Schedule::Cosine { steps, floor })?;
        let adam = AnyOptimizer::Adam(Adam::with_options(rates, Default::default())?);
        let adam = Algorithm::FirstOrder(Constrained::new(adam, groups.clone())?);
        runs.push(Run::new(setup, "Adam", (steps, spp), adam));
    }
    Ok(runs)
}

/// `second-order`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let mut setup = setup(fig)?;
    fig.note("pixels", setup.problem.scene.film.pixels());
    fig.note("seed", SEED);
    race(fig, &mut setup)?;
    hessian(fig, &mut setup)
}

/// (a) Error against time.
fn race(fig: &mut Figure, setup: &mut Setup) -> Result {
    let mut runs = runs(fig, setup)?;
    // Runs alternate, so that other load on the machine slows all of them alike.
    let most = runs.iter().map(|r| r.steps).max().unwrap_or(0);
    for k in 1..=most {
        for run in &mut runs {
            while run.done * most < run.steps * k {
                run.step(setup)?;
            }
        }
    }
    let label = "largest relative error of the ten unknowns";
    let mut chart = LineChart::new("Time to error", "seconds", label).log_y();
    let mut table = Vec::new();
    for run in &runs {
        chart = chart.line(&run.label, run.errors.iter().copied());
        let each = 1e3 * run.time.as_secs_f64() / run.done.max(1) as f64;
        say!("  {}: {each:.1} ms per step", run.label);
        fig.note(&format!("ms per step, {}", run.label), each);
        let rows = run.errors.iter().enumerate();
        table.extend(rows.map(|(k, (t, e))| {
            [
                run.label.clone(),
                k.to_string(),
                t.to_string(),
                e.to_string(),
            ]
        }));
    }
    fig.chart("time-to-error", &chart);
    let header = ["algorithm", "step", "seconds", "largest relative error"];
    fig.csv_text("time-to-error", &header, table);

    let [newton, adam @ ..] = &runs[..] else {
        return Err("no runs".into());
    };
    let show = |t: Option<f64>| t.map_or("never".into(), |t| format!("{t:.2} s"));
    for goal in &GOALS[..fig.pick(1, 3)] {
        let mine = newton.time_to(*goal);
        let others: Vec<_> = adam.iter().map(|r| r.time_to(*goal)).collect();
        let best = others
            .iter()
            .flatten()
            .copied()
            .fold(f64::INFINITY, f64::min);
        let found: Vec<String> = adam
            .iter()
            .zip(&others)
            .map(|(r, t)| format!("{} {}", r.label, show(*t)))
            .collect();
        fig.check(
            format!(
                "(a) Gauss-Newton is within {} % of all unknowns before every Adam, for good",
                100.0 * goal
            ),
            mine.is_some_and(|t| t < best),
            format!(
                "Gauss-Newton {} ({:.1} times faster than the best); {}",
                show(mine),
                best / mine.unwrap_or(f64::INFINITY),
                found.join("; ")
            ),
        );
    }
    Ok(())
}

/// (b) At the truth the residuals vanish, and with them all of the Hessian but its Gauss-Newton part.
fn hessian(fig: &mut Figure, setup: &mut Setup) -> Result {
    let n = setup.truth.len();
    setup.problem.settings.spp = fig.pick(64, 128);
    let mut distances = Vec::new();
    let starts = [setup.truth.clone(), setup.start.clone()];
    for (k, values) in starts.iter().enumerate() {
        setup.problem.set(values)?;
        let seed = |j: u64| mix64(1000 * (k as u64 + 1) + j);
        let curved = setup.problem.evaluate_curved([seed(0), seed(1)], &())?;
        let newton = curved.ok_or("stopped")?.derivatives.matrix;
        let mut whole = vec![0.0; n * n];
        for j in 0..n {
            let mut unit = vec![0.0; n];
            unit[j] = 1.0;
            let seeds = [2, 3].map(|i| seed(i + 2 * j as u64));
            let column = setup.problem.hessian_vector(&unit, seeds, &())?;
            for (i, h) in column.ok_or("stopped")?.values.concat().iter().enumerate() {
                whole[i * n + j] = *h;
            }
        }
        // In units in which the Gauss-Newton diagonal is one.
        let scale: Vec<f64> = (0..n).map(|i| newton[i * n + i].max(0.0).sqrt()).collect();
        let unit = |m: &[f64], e: usize| m[e] / (scale[e / n] * scale[e % n]);
        let norm = |f: &dyn Fn(usize) -> f64| (0..n * n).map(|e| f(e) * f(e)).sum::<f64>().sqrt();
        let distance = norm(&|e| unit(&whole, e) - unit(&newton, e)) / norm(&|e| unit(&newton, e));
        let skew = norm(&|e| unit(&whole, e) - unit(&whole, e % n * n + e / n))
            / norm(&|e| unit(&whole, e));
        distances.push((distance, skew));
        let name = ["hessian-at-truth", "hessian-at-start"][k];
        let rows = (0..n * n).map(|e| [(e / n) as f64, (e % n) as f64, whole[e], newton[e]]);
        fig.csv(name, &["row", "column", "hessian", "gauss-newton"], rows);
    }
    let [(truth, skew), (start, _)] = distances[..] else {
        return Err("two matrices".into());
    };
    fig.check(
        "(b) the Hessian, column by column, is its Gauss-Newton part where the residuals vanish, and not where \
         the search starts",
        truth < fig.pick(0.3, 0.1) && start > 3.0 * truth,
        format!(
            "relative distance {truth:.3} at the truth (asymmetry by noise {skew:.3}), {start:.3} at the start"
        ),
    );
    Ok(())
}
