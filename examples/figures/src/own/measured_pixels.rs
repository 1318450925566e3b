//! Samples allotted to pixels by the variance that a short first pass measures, against the same number in every
//! pixel, on the scenes of the figures.

use std::time::Instant;

use render::Job;
use render::auto;
use render::instances::{Estimator, render_f32};
use render::params::Theta;
use render::statistics::{Estimate, z_limit};

use super::auto_estimator::{Subject, subjects};
use crate::statistics::per_pixel;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::ranks::median;

const SEED: u64 = 2048;
const ESTIMATORS: [Estimator; 2] = [Estimator::MisBalance, Estimator::DifferentialMis];

/// Gradients of independent passes.
struct Passes {
    /// For each pass, every derivative times the size of its parameter.
    scaled: Vec<Vec<f64>>,
    /// How many values each parameter has.
    lengths: Vec<usize>,
    /// Seconds of a pass, the median.
    seconds: f64,
}

impl Passes {
    fn of(
        subject: &Subject,
        e: Estimator,
        adjoint: &[f32],
        [first, runs, spp]: [u64; 3],
    ) -> Result<Self> {
        let scene = &subject.scene;
        let theta = Theta::constant(scene.params().values());
        let active = e.active(scene, &subject.params)?;
        let lengths: Vec<usize> = active.ranges().iter().map(|r| r.shape.len()).collect();
        let sizes: Vec<f64> = (active.ranges().iter())
            .flat_map(|info| vec![scene.params().size(info); info.shape.len()])
            .collect();
        let mut scaled = Vec::new();
        let mut seconds = Vec::new();
        for seed in first..first + runs {
            let start = Instant::now();
            let s = &scene.settings;
            let g = e.backward_f32(
                &Job::new(scene, s, seed, 0..spp, &()),
                &theta,
                &active,
                adjoint,
            )?;
            seconds.push(start.elapsed().as_secs_f64());
            let all = g.values.iter().flatten().zip(&sizes);
            scaled.push(all.map(|(d, size)| d * size).collect());
        }
        Ok(Self {
            scaled,
            lengths,
            seconds: median(&seconds).ok_or("no runs")?,
        })
    }

    /// The variance of each parameter, summed over its values.
    fn variances(&self) -> Vec<f64> {
        let values = per_pixel(&self.scaled);
        let mut rest = values.iter().map(|e| e.se * e.se);
        let of = |&n: &usize| rest.by_ref().take(n).sum();
        self.lengths.iter().map(of).collect()
    }

    /// Ratio of the variances to those of `others`: the geometric mean over the parameters, and the least.
    fn gain(&self, others: &Self) -> [f64; 2] {
        let both = self.variances().into_iter().zip(others.variances());
        let ratios = both.filter(|(a, _)| *a > 0.0).map(|(a, b)| a / b);
        let (n, logs, least) = ratios.fold((0.0, 0.0, f64::INFINITY), |(n, logs, least), r| {
            (n + 1.0, logs + r.ln(), least.min(r))
        });
        [(logs / f64::max(n, 1.0)).exp(), least]
    }

    /// The sum of all derivatives: the derivative along all parameters at once.
    fn sum(&self) -> Estimate {
        let sums: Vec<f64> = self.scaled.iter().map(|g| g.iter().sum()).collect();
        Estimate::of(&sums)
    }
}

/// Pictures of the image, and of the number of samples in its pixels.
fn panels(subject: &Subject, weights: &[f32], spp: u64) -> [Panel; 2] {
    let scene = &subject.scene;
    let theta = Theta::constant(scene.params().values());
    let s = &scene.settings;
    let image = render_f32(
        &Job::new(scene, s, SEED, 0..spp, &()),
        &theta,
        Estimator::Mis,
    );
    let width = scene.film.crop_size[0] as usize;
    let mean = weights.iter().map(|&w| f64::from(w)).sum::<f64>() / weights.len() as f64;
    let log = |w: &f32| (f64::from(*w) / mean).max(0.25).log2();
    let logs: Vec<f64> = weights.iter().map(log).collect();
    let label = format!("{}: log2 of samples over their mean", subject.name);
    [
        Panel::tonemapped(subject.name, &image.image(0), 1.0).enlarged(4),
        Panel::false_colour(&label, width, &logs, -2.0, 4.0).enlarged(4),
    ]
}

/// `measured-pixels`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let (spp, runs) = (fig.pick(16, 32), fig.pick(16, 32));
    fig.note("samples per pixel", spp);
    fig.note("runs", runs);
    fig.note("seed", SEED);
    let mut all = subjects(fig.quick())?;
    let cases = all.len() * ESTIMATORS.len();
    let most = z_limit(cases, runs, 1e-3);
    let mut worst_z = 0.0f64;
    let mut gains: Vec<(f64, f64, String)> = Vec::new();
    let mut series = ESTIMATORS.map(|e| (e.name(), Vec::new()));
    let (mut rows, mut pictures) = (Vec::new(), Vec::new());
    for (k, subject) in all.iter_mut().enumerate() {
        let n = subject.scene.film.pixels() * 3;
        let adjoint = vec![1.0 / n as f32; n];
        for (e, (_, points)) in ESTIMATORS.into_iter().zip(&mut series) {
            let even = Passes::of(subject, e, &adjoint, [SEED, runs, spp])?;
            let start = Instant::now();
            let Subject { scene, params, .. } = &*subject;
            let s = &scene.settings;
            let weights = auto::pixel_weights(scene, params, &adjoint, e, s, SEED, &())?;
            let pilot = start.elapsed().as_secs_f64();
            subject.scene.set_pixel_weights(&weights)?;
            let shared = Passes::of(subject, e, &adjoint, [SEED + runs, runs, spp])?;
            subject.scene.set_pixel_weights(&vec![1.0; n / 3])?;
            let z = even.sum().z(&shared.sum());
            worst_z = worst_z.max(z.abs());
            let [gain, least] = even.gain(&shared);
            let faster = gain * even.seconds / shared.seconds;
            gains.push((gain, faster, format!("{} in {}", e.name(), subject.name)));
            points.push((k as f64 + 1.0, gain));
            rows.push([
                subject.name.to_owned(),
                e.name().to_owned(),
                gain.to_string(),
                least.to_string(),
                faster.to_string(),
                (pilot / shared.seconds).to_string(),
                z.to_string(),
            ]);
            if e == ESTIMATORS[1] {
                pictures.extend(panels(subject, &weights, spp));
            }
        }
    }
    gains.sort_by(|a, b| a.0.total_cmp(&b.0));
    fig.check(
        "(a) gradients along all parameters are the same, at significance 1e-3 over all cases",
        worst_z < most,
        format!("largest |z| {worst_z:.2} of {cases}, limit {most:.2}"),
    );
    let (least, largest) = (&gains[0], &gains[gains.len() - 1]);
    let middle = gains[gains.len() / 2].0;
    let paid = gains.iter().filter(|g| g.1 > 1.0).count();
    // Where few samples carry the variance, its estimate is uncertain by some tens of per cent.
    fig.check(
        "(b) variance of as many samples of each pixel over that of shared ones: never much below 1, above it as a rule",
        least.0 > 0.5 && middle > 1.2,
        format!(
            "from {:.2} ({}) over {middle:.2} (median) to {:.2} ({}); pays on the clock in {paid} of {cases} cases",
            least.0, least.2, largest.0, largest.2,
        ),
    );
    let header = [
        "scene",
        "estimator",
        "gain in variance",
        "least of a parameter",
        "gain in efficiency",
        "measuring over a pass",
        "z",
    ];
    fig.csv_text("gains", &header, rows);
    let names: Vec<String> = (all.iter().enumerate())
        .map(|(k, s)| format!("{} {}", k + 1, s.name))
        .collect();
    let title = "samples where the noise is: variance of even ones over theirs";
    let mut chart = LineChart::new(title, &names.join(", "), "gain")
        .x_range(0.5, 10.0)
        .log_y();
    for (name, points) in series {
        chart = chart.points(name, points);
    }
    fig.chart("gains", &chart);
    fig.images("samples", 4, &pictures);
    Ok(())
}
