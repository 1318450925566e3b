//! Estimators of manifold connections, compared: the light of chains alone, its noise, and what walks came to.

use std::time::Instant;

use rayon::prelude::*;
use render::instances::{Estimator, chains_by_particles_f32, render_f32};
use render::integrator::render::Rendering;
use render::manifold::Statistics;
use render::params::Theta;
use render::scene::{Connections, Method, Starts};
use render::statistics::Estimate;
use render::{Job, RenderError, Scene, Settings};

use crate::statistics::{Series, grey};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::ranks::median;

/// Pixels of each side of the blocks in which means are compared.
const BLOCK: usize = 4;

/// The light of chains in a scene, by somebody.
pub struct Measured {
    /// Its image, over independent runs.
    pub series: Series,
    /// What walks came to, over all runs.
    pub found: Statistics,
    /// The same by pixel, where connections ask for it.
    pub by_pixel: Vec<Statistics>,
    /// Seconds that all runs took together; images that leave chains out are not counted.
    pub seconds: f64,
    /// Samples per pixel of a run.
    pub spp: u64,
    width: usize,
}

impl Measured {
    /// The part of walks that converged.
    pub fn success(&self) -> f64 {
        self.found.converged as f64 / self.found.walks.max(1) as f64
    }

    /// The part of estimates that found light: of first walks, but for trial sets.
    pub fn lit(&self) -> f64 {
        self.found.found as f64 / self.found.attempts.max(1) as f64
    }

    /// Walks that it took to know what a solution counts, per solution.
    pub fn trials(&self) -> f64 {
        self.found.trials as f64 / self.found.solutions.max(1) as f64
    }

    /// Mean over the pixels.
    pub fn mean(&self) -> f64 {
        let means = self.series.means();
        means.iter().sum::<f64>() / means.len() as f64
    }

    /// Variance of the mean of all runs, summed over the pixels.
    pub fn variance(&self) -> f64 {
        let each = self.series.pixels.iter().map(|e| e.se * e.se);
        each.sum()
    }

    /// Mean over the pixels, and its error.
    pub fn whole(&self) -> Estimate {
        Estimate {
            mean: self.mean(),
            se: self.variance().sqrt() / self.series.pixels.len() as f64,
        }
    }

    /// From how many repetitions the errors of all of these are known, at least.
    pub fn repeats(all: &[&Self]) -> u64 {
        let each = all.iter().map(|m| m.series.repeats());
        each.min().unwrap_or(0)
    }

    /// Square of what it misses, summed over the pixels, against what is unbiased: noise of both is taken off.
    pub fn squared_bias(&self, unbiased: &Self) -> f64 {
        let each = self.squared_bias_by_pixel(unbiased);
        each.iter().sum::<f64>().max(0.0)
    }

    /// Square of what each pixel misses against what is unbiased: noise of both is taken off, so that it may be negative.
    pub fn squared_bias_by_pixel(&self, unbiased: &Self) -> Vec<f64> {
        let pairs = self.series.pixels.iter().zip(&unbiased.series.pixels);
        pairs
            .map(|(a, b)| (a.mean - b.mean).powi(2) - a.se * a.se - b.se * b.se)
            .collect()
    }

    /// The part of the light that is missing against what is unbiased, over pixels that are chosen without a look at either.
    pub fn loss(&self, unbiased: &Self, chosen: impl Fn(usize) -> bool) -> Estimate {
        let [part, whole] = [self, unbiased].map(|m| {
            let pixels = m.series.pixels.iter().enumerate();
            let (mean, square) = pixels
                .filter(|(i, _)| chosen(*i))
                .fold((0.0, 0.0), |(mean, square), (_, e)| {
                    (mean + e.mean, square + e.se * e.se)
                });
            let se = square.sqrt();
            Estimate { mean, se }
        });
        let ratio = part.mean / whole.mean;
        let se = (part.se / whole.mean).hypot(ratio * whole.se / whole.mean);
        Estimate {
            mean: 1.0 - ratio,
            se,
        }
    }

    /// Trials per solution in each pixel; zero where there is no solution. Of connections that ask for it.
    pub fn trials_by_pixel(&self) -> Vec<f64> {
        let each = self.by_pixel.iter();
        each.map(|s| s.trials as f64 / s.solutions.max(1) as f64)
            .collect()
    }

    /// Variance of a single sample per run, summed over the pixels.
    pub fn variance_of_one(&self) -> f64 {
        self.variance() * self.spp as f64
    }

    /// Variance after so many seconds, summed over the pixels.
    pub fn variance_after(&self, seconds: f64) -> f64 {
        self.variance() * self.seconds / seconds
    }

    /// Root of the mean squared error of a pixel after so many seconds, of what is unbiased.
    pub fn error_after(&self, seconds: f64) -> f64 {
        (self.variance_after(seconds) / self.series.pixels.len() as f64).sqrt()
    }

    /// Its picture in false colour, twice the mean of `reference` in the middle of the scale, each pixel `factor` wide.
    pub fn panel(&self, label: &str, reference: &Self, factor: usize) -> Panel {
        let exposure = 0.5 / reference.mean().max(1e-9);
        let values: Vec<f64> = self.series.means().iter().map(|x| x * exposure).collect();
        Panel::false_colour(label, self.width, &values, 0.0, 2.0).enlarged(factor)
    }
}

/// How often a scene is rendered.
#[derive(Clone, Copy)]
pub struct Effort {
    /// Independent runs.
    pub runs: u64,
    /// Samples per pixel of each.
    pub spp: u64,
    /// Seed of the first.
    pub seed: u64,
}

impl Effort {
    /// Eight runs where a figure is quick, and sixteen otherwise, of so many samples per pixel in these two cases.
    pub fn of(fig: &Figure, [quick, full]: [u64; 2], seed: u64) -> Self {
        Self {
            runs: fig.pick(8, 16),
            spp: fig.pick(quick, full),
            seed,
        }
    }

    /// Keeps it, and the size of images, beside the results.
    pub fn note(&self, fig: &mut Figure, size: u32) {
        fig.note("size", size);
        fig.note("spp", self.spp);
        fig.note("runs", self.runs);
        fig.note("seed", self.seed);
    }

    /// As much with seeds of its own, different ones for each `k`.
    pub fn other(&self, k: u64) -> Self {
        let seed = self.seed + 1000 * k;
        Self { seed, ..*self }
    }
}

/// Connections over chains of one vertex.
pub fn single(method: Method, starts: Starts) -> Connections {
    Connections {
        bounces: 1,
        starts,
        ..Connections::new(method)
    }
}

/// The light of chains by connections, or by paths if `by_paths`: an image less that at the same seed which leaves it out.
///
/// # Errors
/// Those of rendering.
pub fn measure(
    scene: &Scene,
    connections: Connections,
    by_paths: bool,
    effort: Effort,
) -> Result<Measured> {
    measure_in(BLOCK, scene, connections, by_paths, effort)
}

/// [`measure`] with blocks of `side` by `side` pixels.
///
/// # Errors
/// Those of rendering.
pub fn measure_in(
    side: usize,
    scene: &Scene,
    connections: Connections,
    by_paths: bool,
    effort: Effort,
) -> Result<Measured> {
    let theta = Theta::constant(scene.params().values());
    let width = scene.film.crop_size[0] as usize;
    let of = |connections: Option<Connections>| -> Vec<Rendering> {
        let settings = Settings {
            connections,
            ..scene.settings
        };
        let run = |run: u64| {
            let job = Job::new(scene, &settings, effort.seed + run, 0..effort.spp, &());
            render_f32(&job, &theta, Estimator::Mis)
        };
        (0..effort.runs).into_par_iter().map(run).collect()
    };
    let start = Instant::now();
    let with = of(Some(connections).filter(|_| !by_paths));
    let seconds = start.elapsed().as_secs_f64();
    let without = of(Some(Connections {
        method: Method::LeftOut,
        ..connections
    }));
    let mut found = Statistics::default();
    let mut by_pixel = Vec::new();
    for image in &with {
        found.merge(&image.connections);
        by_pixel.resize(image.connections_by_pixel.len(), Statistics::default());
        for (sum, pixel) in by_pixel.iter_mut().zip(&image.connections_by_pixel) {
            sum.merge(&pixel.statistics);
        }
    }
    let scale = 1.0 / effort.spp as f64;
    let series = Series::of(effort.runs, [width, side], |run| {
        let [with, without] = [&with, &without].map(|images| &images[run as usize].sums[0]);
        let difference: Vec<f64> = with.iter().zip(without).map(|(a, b)| a - b).collect();
        Ok::<_, RenderError>(grey(&difference, scale))
    })?;
    Ok(Measured {
        series,
        found,
        by_pixel,
        seconds,
        spp: effort.spp,
        width,
    })
}

/// The light of chains by so many particles in each run, which land, in blocks of `side` by `side` pixels.
///
/// # Errors
/// Those of rendering.
pub fn by_particles(
    side: usize,
    scene: &Scene,
    connections: Connections,
    effort: Effort,
    particles: u64,
) -> Result<Measured> {
    let theta = Theta::constant(scene.params().values());
    let width = scene.film.crop_size[0] as usize;
    let settings = Settings {
        connections: Some(connections),
        ..scene.settings
    };
    let start = Instant::now();
    let series = Series::of(effort.runs, [width, side], |run| {
        let job = Job::new(scene, &settings, effort.seed + run, 0..effort.spp, &());
        let found = chains_by_particles_f32(&job, &theta, particles)?;
        Ok::<_, RenderError>(grey(&found.image.sums[0], 1.0 / effort.spp as f64))
    })?;
    Ok(Measured {
        series,
        found: Statistics::default(),
        by_pixel: Vec::new(),
        seconds: start.elapsed().as_secs_f64(),
        spp: effort.spp,
        width,
    })
}

/// How many trials the solutions of each pixel take: where they take many they are rare.
pub struct Rare {
    /// Zero where there are none.
    pub trials: Vec<f64>,
    /// The middle of those that there are.
    median: f64,
}

impl Rare {
    /// By unbiased estimates with these connections, whose seeds nothing else has.
    ///
    /// # Errors
    /// Those of rendering; no solutions.
    pub fn of(scene: &Scene, connections: Connections, effort: Effort) -> Result<Self> {
        let connections = Connections {
            by_pixel: true,
            ..connections
        };
        let trials = measure(scene, connections, false, effort)?.trials_by_pixel();
        let some: Vec<f64> = trials.iter().copied().filter(|t| *t > 0.0).collect();
        let median = median(&some).ok_or("no solutions")?;
        Ok(Self { trials, median })
    }

    /// What a trial set misses of all light where solutions are rare, and where they are not.
    pub fn losses(&self, set: &Measured, all: &Measured) -> [Estimate; 2] {
        let is_rare = |i: usize| self.trials[i] > self.median;
        let is_common = |i: usize| self.trials[i] > 0.0 && !is_rare(i);
        [set.loss(all, is_rare), set.loss(all, is_common)]
    }
}

/// How alike two differences of images are, over blocks: from -1 to 1.
pub fn correlation(a: [&Measured; 2], b: [&Measured; 2]) -> f64 {
    let difference = |[x, y]: [&Measured; 2]| -> Vec<f64> {
        let blocks = x.series.blocks.iter().zip(&y.series.blocks);
        blocks.map(|(x, y)| x.mean - y.mean).collect()
    };
    let (a, b) = (difference(a), difference(b));
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    product(&a, &b) / (product(&a, &a) * product(&b, &b)).sqrt().max(1e-30)
}
