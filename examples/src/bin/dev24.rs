// Where a camera and a lamp are, found from one picture [Zeltner 2021, figure 4.24].

use optim::{Adam, AnyOptimizer, Constrained, GaussNewton, Loss, LossKind, Rates, Schedule};
use rayon::prelude::*;
use render::instances::{Estimator, render_f32};
use render::params::Theta;
use render::sampler::mix64;
use render::statistics::z_limit;
use render::{Image, Job, Scene};

use examples::figure::Result;
use examples::figures::common_scenes::{BISHOP, PAWN, ROOK};
use examples::figures::statistics::Estimate;
use examples::optimise::{Algorithm, Problem, Target};
use examples::scene_builder::{self, SceneBuilder, View};

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
    let light = builder.ball("light", [-1.6, 4.2, 1.8], 0.4, &black)?;
    builder.lamp("light", light, [70.0, 64.0, 54.0])?;
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
        let newton = GaussNewton::new(rates, groups, optim::GaussNewtonOptions { max_step: env("MAXSTEP", 0.5), damping: env("DAMP", 1e-2), ..Default::default() })?;
        self.descend(Algorithm::GaussNewton(newton), self.effort.newton)
    }
}


const WHOLE_STEPS: u64 = 5;
fn env<T: std::str::FromStr>(name: &str, default: T) -> T { std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default) }
fn groups(active: &render::integrator::gradient::Active, values: &[f32]) -> Result<optim::Groups> {
    let mut groups = optim::Groups::new(values.len());
    let mut at = 0;
    for info in active.ranges() {
        let range = at..at + info.shape.len();
        at = range.end;
        groups.add(info.name.clone(), range, optim::Parameterisation::Identity)?;
    }
    Ok(groups)
}
fn main() -> Result {
    let size = [env("W", 24), env("W", 24) * 3 / 4];
    let effort = Effort { many: env("MANY", 256), adam: (env("ASPP", 4), env("ASTEPS", 120)), newton: (env("NSPP", 16), env("NSTEPS", 15)) };
    let mut scene = scene(size)?;
    scene.settings.max_depth = env("DEPTH", 4);
    let target = scene_builder::picture(&scene, SEED, 4 * effort.many).image(0);
    let active = Estimator::Edges.active(&scene, &NAMES)?;
    let settings = scene.settings;
    let mut setup = Setup { problem: Problem { scene, settings, active, estimator: Estimator::Edges, loss: std::env::var("LOSS").unwrap_or("relative-l2".into()).parse::<LossKind>()?, targets: vec![Target::of(target)] }, effort };
    let t = std::time::Instant::now();
    if env("NOISE", 0) == 1 {
        let start: Vec<f64> = START.iter().map(|&x| x.into()).collect();
        setup.picture(&start, 1)?;
        setup.problem.settings.spp = setup.effort.newton.0;
        let mut all = Vec::new();
        for k in 0..8u64 { let c = setup.problem.evaluate_curved([2*k+100, 2*k+101], &())?.unwrap(); all.push(c.derivatives.gradient.clone()); if k == 0 { for i in 0..9 { println!("H {:?}", (0..9).map(|j| format!("{:8.3}", c.derivatives.matrix[i*9+j])).collect::<Vec<_>>()); } } }
        for i in 0..9 { let e = Estimate::of(all.iter().map(|g| g[i])); println!("{} curved {:.4} single-sd {:.4}", LABELS[i], e.mean, e.error * 8f64.sqrt()); }
        println!("curved: {:.2} s each", t.elapsed().as_secs_f64() / 8.0);
        let t = std::time::Instant::now();
        setup.problem.settings.spp = setup.effort.adam.0;
        let mut all: Vec<Vec<f64>> = Vec::new();
        for k in 0..8u64 { let c = setup.problem.evaluate([2*k+100, 2*k+101], &())?.unwrap(); all.push(c.gradient.values.concat()); }
        for i in 0..9 { let e = Estimate::of(all.iter().map(|g| g[i])); println!("{} reverse {:.4} single-sd {:.4}", LABELS[i], e.mean, e.error * 8f64.sqrt()); }
        println!("reverse: {:.2} s each", t.elapsed().as_secs_f64() / 8.0);
    }
    let show = |run: &Descent, every: usize| { for (i, v) in run.values.iter().enumerate() { if i % every == 0 || i + 1 == run.values.len() { let v: Vec<f64> = v.iter().map(|&x| x.into()).collect(); println!("{i:4} loss {:.3e} worst {:6.3}  {}", run.losses.get(i).copied().unwrap_or(f64::NAN), worst(&v), v.iter().map(|e| format!("{e:7.4}")).collect::<Vec<_>>().join(" ")); } } };
    if env("NEWTON", 0) == 1 { let t = std::time::Instant::now(); let run = setup.newton()?; show(&run, 1); println!("newton {:.2} s", t.elapsed().as_secs_f64()); }
    if let Ok(stages) = std::env::var("STAGES") {
        let t = std::time::Instant::now();
        let mut values: Vec<f32> = START.iter().map(|s| s * env::<f32>("FAR", 1.0)).collect();
        let mut count = 0;
        for stage in stages.split(',') {
            let p: Vec<u32> = stage.split(':').map(|x| x.parse().unwrap()).collect();
            let mut scene = self::scene([4 * p[0], 3 * p[0]])?;
            scene.settings.max_depth = env("DEPTH", 3);
            setup.problem.targets[0] = Target::of(scene_builder::picture(&scene, SEED, 16 * u64::from(p[1])).image(0));
            setup.problem.active = Estimator::Edges.active(&scene, &NAMES)?;
            setup.problem.settings = scene.settings;
            setup.problem.settings.spp = p[1];
            setup.problem.scene = scene;
            let groups = groups(&setup.problem.active, &START)?;
            let rates = Rates::new(9, 1.0)?;
            let mut newton = GaussNewton::new(rates, groups, optim::GaussNewtonOptions { max_step: env("MAXSTEP", 0.15), damping: env("DAMP", 1e-2), ..Default::default() })?;
            for _ in 0..p[2] {
                let n = 2 * count + 77 + 1000 * env("SEED", 0u64);
                setup.problem.set(&values)?;
                let c = setup.problem.evaluate_curved([mix64(n), mix64(n + 1)], &())?.unwrap();
                let halves: Vec<Image> = (0..2u64).map(|h| scene_builder::picture(&setup.problem.scene, mix64(n) ^ h, u64::from(p[1])).image(0)).collect();
                let mean: Vec<f32> = halves[0].data.iter().zip(&halves[1].data).map(|(a, b)| 0.5 * (a + b)).collect();
                let target = &setup.problem.targets[0].image.data;
                let loss = setup.problem.loss.value(&mean, target)?;
                let mut g = vec![0.0f32; mean.len()];
                let mut w = vec![0.0f32; mean.len()];
                setup.problem.loss.gradient(&mean, target, &mut g)?;
                setup.problem.loss.curvature(&mean, target, &mut w)?;
                let mut var = 0.0f64;
                for i in 0..mean.len() { let d = 0.5 * f64::from(halves[0].data[i] - halves[1].data[i]); var += (f64::from(g[i]) * d).powi(2) + 0.5 * (f64::from(w[i]) * d * d).powi(2); }
                let gradient: Vec<f32> = c.derivatives.gradient.iter().map(|&g| g as f32).collect();
                let matrix = optim::NormalMatrix::new(9, c.derivatives.matrix)?;
                let out = newton.step(&mut values, &optim::Evaluation { loss, loss_error: var.sqrt(), gradient: &gradient }, &matrix)?;
                struct R { loss: f64 }
                let report = R { loss };
                print!("{out:?} +- {:.1e} (spatial {:.1e}) damping {:.1e} ", var.sqrt(), c.loss_error, newton.damping());
                let v: Vec<f64> = values.iter().map(|&x| x.into()).collect();
                count += 1;
                println!("{count:3} size {} loss {:.3e} worst {:6.3}  {}  {:.1} s", p[0], report.loss, worst(&v), v.iter().map(|e| format!("{e:7.4}")).collect::<Vec<_>>().join(" "), t.elapsed().as_secs_f64());
            }
        }
    }
    if env("ADAM", 0) == 1 { let t = std::time::Instant::now(); let run = setup.adam()?; show(&run, (setup.effort.adam.1 / 12) as usize); println!("adam {:.2} s", t.elapsed().as_secs_f64()); }
    Ok(())
}
