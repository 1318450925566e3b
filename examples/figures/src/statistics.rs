//! Means of repeated estimates, and how far apart they may lie.

use std::time::Instant;

use rayon::prelude::*;
use render::Job;
use render::instances::Estimator;
use render::integrator::gradient::Active;
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::statistics::{Estimate, p_value, z_limit};
use render::{RenderError, Scene, Settings};

use examples::figure::Figure;

/// Moments of independent samples, so many that none is kept.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    n: f64,
    /// Their mean.
    pub mean: f64,
    /// Sums of the second to fourth powers of the differences from the mean.
    sums: [f64; 3],
}

impl Moments {
    /// Adds a sample [Pébay 2008].
    pub fn add(&mut self, x: f64) {
        let before = self.n;
        self.n += 1.0;
        let n = self.n;
        let d = (x - self.mean) / n;
        let [s2, s3, s4] = self.sums;
        let t = d * d * n * before;
        self.mean += d;
        self.sums = [
            s2 + t,
            s3 + t * d * (n - 2.0) - 3.0 * d * s2,
            s4 + t * d * d * (n * n - 3.0 * n + 3.0) + 6.0 * d * d * s2 - 4.0 * d * s3,
        ];
    }

    /// The moments of `n` samples `f(random numbers)`: a pure function of `seed` and `n`.
    pub fn of(n: u64, seed: u64, mut f: impl FnMut(&mut Independent) -> f64) -> Self {
        (0..n)
            .map(|i| f(&mut Independent::new(seed, 0, i)))
            .collect()
    }

    /// Number of samples.
    pub fn samples(&self) -> u64 {
        self.n as u64
    }

    /// Variance of one sample.
    pub fn variance(&self) -> f64 {
        self.sums[0] / (self.n - 1.0)
    }

    /// The mean and its standard error.
    pub fn of_mean(&self) -> Estimate {
        Estimate {
            mean: self.mean,
            se: (self.variance() / self.n).sqrt(),
        }
    }

    /// The variance and its standard error, from the fourth moment.
    pub fn of_variance(&self) -> Estimate {
        let v = self.sums[0] / self.n;
        Estimate {
            mean: self.variance(),
            se: ((self.sums[2] / self.n - v * v).max(0.0) / self.n).sqrt(),
        }
    }

    /// Distance of the mean from what is exact, in standard errors.
    pub fn z(&self, exact: f64) -> f64 {
        self.of_mean().z(&Estimate::exact(exact))
    }
}

impl FromIterator<f64> for Moments {
    fn from_iter<I: IntoIterator<Item = f64>>(samples: I) -> Self {
        let mut moments = Self::default();
        samples.into_iter().for_each(|x| moments.add(x));
        moments
    }
}

/// Pearson's chi-square test.
#[derive(Clone, Copy, Debug)]
pub struct ChiSquare {
    /// Probability of a statistic as large.
    pub p_value: f64,
    /// Standard normal deviate of the statistic before bins are pooled [Wilson and Hilferty 1931], which also says how far
    /// off what fails is.
    pub deviate: f64,
}

impl ChiSquare {
    /// From pairs of observed and expected counts, of the same sum.
    pub fn of(bins: &[(f64, f64)]) -> Self {
        let statistic = bins
            .iter()
            .map(|(n, expected)| (n - expected).powi(2) / expected);
        let freedom = bins.len() as f64 - 1.0;
        let v = 2.0 / (9.0 * freedom);
        Self {
            p_value: p_value(bins.iter().copied()),
            deviate: ((statistic.sum::<f64>() / freedom).cbrt() - (1.0 - v)) / v.sqrt(),
        }
    }
}

/// One estimate per pixel, from independent images.
pub fn per_pixel(images: &[Vec<f64>]) -> Vec<Estimate> {
    let pixels = images.first().map_or(0, Vec::len);
    (0..pixels)
        .map(|p| Estimate::of(&images.iter().map(|i| i[p]).collect::<Vec<_>>()))
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
    runs: u64,
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
        let means = images
            .iter()
            .map(|i| i.iter().sum::<f64>() / i.len() as f64);
        Ok(Self {
            pixels: per_pixel(&images),
            blocks: per_pixel(&averaged),
            whole: Estimate::of(&means.collect::<Vec<_>>()),
            runs,
        })
    }

    /// From how many repetitions of one value the sum of the pixels' squared errors is known as well (Satterthwaite): at least
    /// the number of runs, more where many pixels share the variance.
    pub fn repeats(&self) -> u64 {
        let variances = self.pixels.iter().map(|e| e.se * e.se);
        let (sum, squares) = variances.fold((0.0, 0.0), |(a, b), v| (a + v, b + v * v));
        let pixels = if squares > 0.0 {
            sum * sum / squares
        } else {
            1.0
        };
        1 + (pixels * (self.runs as f64 - 1.0)) as u64
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
        let limit = z_limit(z.len(), runs, level);
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
    let of = |k: usize| Estimate::of(&each.iter().map(|g| g[k]).collect::<Vec<_>>());
    Ok(((0..names.len()).map(of).collect(), seconds))
}

/// Variance of one of independent images, summed over the pixels.
pub fn variance(images: &[Vec<f64>]) -> f64 {
    let squares = per_pixel(images).into_iter().map(|e| e.se * e.se);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_of_a_few_numbers() {
        let numbers = [1.0f64, 2.0, 4.0, 8.0, 16.0, 3.0, -5.0];
        let m: Moments = numbers.into_iter().collect();
        let n = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / n;
        let power = |k: i32| numbers.iter().map(|x| (x - mean).powi(k)).sum::<f64>() / n;
        let variance_error = ((power(4) - power(2).powi(2)) / n).sqrt();
        let known = Estimate::of(&numbers);
        assert!((m.mean - mean).abs() < 1e-12 && (m.of_mean().se - known.se).abs() < 1e-12);
        assert!((m.variance() - power(2) * n / (n - 1.0)).abs() < 1e-12);
        assert!((m.of_variance().se - variance_error).abs() < 1e-10);
    }

    /// Mean, variance and their errors of 100 000 uniform numbers: 1/2, 1/12, and a fourth moment of 1/80. Two tests,
    /// significance 1 in 1000 together.
    #[test]
    fn moments_of_uniform_numbers() {
        let n = 100_000;
        let limit = z_limit(2, n, 1e-3);
        let m = Moments::of(n, 1, |s| s.next_1d());
        assert!(m.z(0.5).abs() < limit);
        let variance = m.of_variance();
        assert!(variance.z(&Estimate::exact(1.0 / 12.0)).abs() < limit);
        let expected = ((1.0 / 80.0 - 1.0 / 144.0) / n as f64).sqrt();
        assert!((variance.se / expected - 1.0).abs() < 0.02);
    }

    #[test]
    fn chi_square_by_hand() {
        // 99 degrees of freedom: the statistic 138.99 has probability 0.005, 2.576 deviates.
        let mut bins = vec![(100.0, 100.0); 100];
        let off = (138.99f64 * 100.0 / 2.0).sqrt();
        (bins[0].0, bins[1].0) = (100.0 + off, 100.0 - off);
        let found = ChiSquare::of(&bins);
        assert!((found.p_value - 0.005).abs() < 1e-4, "{found:?}");
        assert!((found.deviate - 2.576).abs() < 0.01, "{found:?}");
    }

    /// Pixels of one variance count for as many runs each, and one that has it all for itself.
    #[test]
    fn repeats_by_hand() {
        let series = |[a, b]: [f64; 2]| {
            let image = |run| Ok::<_, ()>(vec![a * (run as f64), b * (run as f64)]);
            Series::of(8, [2, 1], image).map(|s| s.repeats())
        };
        assert_eq!(series([1.0, 1.0]), Ok(15));
        assert_eq!(series([1.0, 0.0]), Ok(8));
        assert_eq!(series([0.0, 0.0]), Ok(8));
    }
}
