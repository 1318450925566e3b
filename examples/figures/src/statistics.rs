//! Means of repeated estimates, and how far apart they may lie.

use std::time::Instant;

use rayon::prelude::*;
use render::Job;
use render::instances::Estimator;
use render::integrator::gradient::Active;
use render::params::Theta;
/// What |z| stays below by chance.
pub use render::statistics::z_limit as limit;
use render::{RenderError, Scene, Settings};

use examples::figure::Figure;

/// A mean and its standard error.
#[derive(Clone, Copy, Debug, Default)]
pub struct Estimate {
    /// Mean.
    pub mean: f64,
    /// Standard error of the mean; zero if exact.
    pub error: f64,
}

impl Estimate {
    /// From independent repetitions, at least two.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let values: Vec<f64> = values.into_iter().collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares = values.iter().map(|x| (x - mean).powi(2));
        Self {
            mean,
            error: (squares.sum::<f64>() / (n * (n - 1.0))).sqrt(),
        }
    }

    /// Difference to another one in standard errors.
    pub fn z(&self, other: &Self) -> f64 {
        let d = self.mean - other.mean;
        if d == 0.0 {
            0.0
        } else {
            d / self.error.hypot(other.error)
        }
    }
}

/// One estimate per pixel, from independent images.
pub fn per_pixel(images: &[Vec<f64>]) -> Vec<Estimate> {
    let pixels = images.first().map_or(0, Vec::len);
    (0..pixels)
        .map(|p| Estimate::of(images.iter().map(|i| i[p])))
        .collect()
}

/// Images of independent runs, as they are and in blocks.
pub struct Series {
    /// Per pixel.
    pub pixels: Vec<Estimate>,
    /// Per block, row by row.
    pub blocks: Vec<Estimate>,
    /// Of the mean over all pixels.
    pub whole: Estimate,
}

impl Series {
    /// From `image(0..runs)`, each `width` pixels wide, in blocks of `side` x `side` pixels.
    ///
    /// # Errors
    /// Those of `image`.
    pub fn of<E: Send>(
        runs: u64,
        [width, side]: [usize; 2],
        image: impl Fn(u64) -> Result<Vec<f64>, E> + Sync + Send,
    ) -> Result<Self, E> {
        let images: Result<Vec<_>, E> = (0..runs).into_par_iter().map(image).collect();
        let images = images?;
        let averaged: Vec<_> = images.iter().map(|i| blocks(i, width, side)).collect();
        Ok(Self {
            pixels: per_pixel(&images),
            blocks: per_pixel(&averaged),
            whole: Estimate::of(
                images
                    .iter()
                    .map(|i| i.iter().sum::<f64>() / i.len() as f64),
            ),
        })
    }

    /// Means of the pixels.
    pub fn means(&self) -> Vec<f64> {
        self.pixels.iter().map(|e| e.mean).collect()
    }
}

/// Checks that two series have the same expectation in all blocks, of which there are as many for each statement, one
/// statement after another.
pub fn check_same(
    fig: &mut Figure,
    statements: &[&str],
    [a, b]: [&Series; 2],
    runs: u64,
    level: f64,
) {
    let z: Vec<f64> = (a.blocks.iter().zip(&b.blocks))
        .map(|(a, b)| a.z(b).abs())
        .collect();
    let each = z.len() / statements.len().max(1);
    for (statement, z) in statements.iter().zip(z.chunks(each.max(1))) {
        let worst = z.iter().copied().fold(0.0, f64::max);
        let limit = limit(z.len(), runs, level);
        fig.check(
            *statement,
            worst < limit,
            format!(
                "largest |z| of {} blocks: {worst:.2}, limit {limit:.2}",
                z.len()
            ),
        );
    }
}

/// Derivatives of the mean of the image in the named parameters, each summed over its values, from the runs with seeds
/// from `seed` on, and seconds per run.
///
/// # Errors
/// Those of [`Estimator::backward_f32`], and unknown names.
pub fn gradients(
    scene: &Scene,
    e: Estimator,
    settings: &Settings,
    names: &[&str],
    seed: u64,
    spp: u64,
    runs: u64,
) -> Result<(Vec<Estimate>, f64), RenderError> {
    let active = Active::new(scene, names)?;
    let theta = Theta::constant(scene.params().values());
    let values = scene.film.pixels() * 3;
    let adjoint = vec![1.0 / values as f32; values];
    let start = Instant::now();
    let run = |run: u64| {
        let seed = seed + run;
        let g = e.backward_f32(
            &Job::new(scene, settings, seed, 0..spp, &()),
            &theta,
            &active,
            &adjoint,
        )?;
        Ok(g.values.iter().map(|v| v.iter().sum()).collect())
    };
    let each: Result<Vec<Vec<f64>>, RenderError> = (0..runs).into_par_iter().map(run).collect();
    let each = each?;
    let seconds = start.elapsed().as_secs_f64() / runs as f64;
    let of = |k: usize| Estimate::of(each.iter().map(|g| g[k]));
    Ok(((0..names.len()).map(of).collect(), seconds))
}

/// Standard normal deviate of a chi-square statistic [Wilson and Hilferty 1931].
pub fn deviate(statistic: f64, freedom: f64) -> f64 {
    let v = 2.0 / (9.0 * freedom);
    ((statistic / freedom).cbrt() - (1.0 - v)) / v.sqrt()
}

/// Variance of one of independent images, summed over the pixels.
pub fn variance(images: &[Vec<f64>]) -> f64 {
    let squares = per_pixel(images).into_iter().map(|e| e.error * e.error);
    squares.sum::<f64>() * images.len() as f64
}

/// Means over squares of `side` x `side` pixels; what does not fill one is left out.
pub fn blocks(image: &[f64], width: usize, side: usize) -> Vec<f64> {
    let (columns, rows) = (width / side, image.len() / width / side);
    let block = |x: usize, y: usize| {
        let rows = (0..side).map(|k| &image[(y * side + k) * width + x * side..][..side]);
        rows.flatten().sum::<f64>() / (side * side) as f64
    };
    (0..rows)
        .flat_map(|y| (0..columns).map(move |x| (x, y)))
        .map(|(x, y)| block(x, y))
        .collect()
}

/// Mean of the channels of each pixel of sums over samples, times `scale`.
pub fn grey(sums: &[f64], scale: f64) -> Vec<f64> {
    let pixel = |p: &[f64]| p.iter().sum::<f64>() / 3.0 * scale;
    sums.chunks_exact(3).map(pixel).collect()
}
