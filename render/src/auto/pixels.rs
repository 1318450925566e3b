//! How often to sample each pixel.

use std::ops::Range;

use crate::error::RenderError;
use crate::instances::Estimator;
use crate::integrator::Job;
use crate::integrator::noise::{Noise, PixelNoise};
use crate::integrator::render::Progress;
use crate::params::Theta;
use crate::sampler::Family;
use crate::scene::{Scene, Settings};

/// Samples that are taken in all, as far as [`LEAST`] per pixel are not more.
const SAMPLES: usize = 1 << 17;
/// Samples per pixel, at least.
const LEAST: usize = 8;
/// How many times fewer tell how noisy each of several parameters is.
const FEWER: u64 = 4;
/// A square of pixels is believed to be like the square around it as much as so many samples of its own say, if all
/// had the same part of the variance.
const PRIOR: f64 = 4.0;

/// Squares of one size, row by row.
struct Level {
    width: usize,
    squares: Vec<PixelNoise>,
}

impl Level {
    /// Squares twice as wide.
    fn joined(&self) -> Self {
        let height = self.squares.len().div_ceil(self.width);
        let width = self.width.div_ceil(2);
        let mut squares = vec![PixelNoise::default(); width * height.div_ceil(2)];
        for (i, s) in self.squares.iter().enumerate() {
            squares[self.around(i)].merge(s);
        }
        Self { width, squares }
    }

    /// The square twice as wide that one is part of.
    fn around(&self, i: usize) -> usize {
        i / self.width / 2 * self.width.div_ceil(2) + i % self.width / 2
    }
}

/// Weights of pixels, for [`Scene::set_pixel_weights`], with which `estimator` tells most in equal time about the
/// derivatives of `<adjoint, image>` in the named parameters, as far as a short pass before can tell.
///
/// Pixels are not alike: few see what a parameter changes, and fewer see it with noise. The pass measures the variance
/// and the work of a sample of each; what to do with it is said at [`pixel_weights_of`]. Several parameters count
/// alike, whatever their units: the variance of each is divided by what it is in all pixels together, which a quarter
/// as many samples tell before. So none pays much for another that is noisier. In an optimisation every pass can measure
/// on its way ([`Active::with_noise`](crate::integrator::gradient::Active::with_noise)), which costs next to nothing.
///
/// Light that is hardly ever found, such as caustics by paths, is missed by a short pass as well. No pixel has less than
/// a quarter of its even share, so its variance rises to four times at most, if its samples are independent. The variance
/// of Sobol points, which the pass does not know, can rise by more where light is smooth.
///
/// ```
/// use render::auto::pixel_weights;
/// use render::instances::Estimator;
///
/// let mut room = render::scene::room(8, 8)?;
/// let adjoint = vec![1.0 / 192.0; 8 * 8 * 3]; // of the mean of all pixels and channels
/// let (names, settings) = (["sphere.alpha.value"], room.settings);
/// let weights = pixel_weights(&room, &names, &adjoint, Estimator::Mis, &settings, 1, &())?;
/// assert_eq!(weights.len(), 8 * 8); // [height][width]
/// // The roughness of the sphere, at the lower right, matters more there than in the opposite corner.
/// let at = |x: usize, y: usize| weights[8 * y + x];
/// assert!(at(5, 5) > 2.0 * at(0, 0));
/// room.set_pixel_weights(&weights)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// An unknown name, an adjoint of the wrong size, a parameter or scene that is not for this estimator.
pub fn pixel_weights<N: AsRef<str>>(
    scene: &Scene,
    names: &[N],
    adjoint: &[f32],
    estimator: Estimator,
    settings: &Settings,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Vec<f32>, RenderError> {
    let active = estimator.active(scene, names)?;
    let theta = Theta::constant(scene.params().values());
    let samples = SAMPLES.div_ceil(scene.film.pixels().max(1)).max(LEAST) as u64;
    let first = samples / FEWER;
    let noise = |scales: &[f64], samples: Range<u64>| {
        let found = estimator.backward_f32(
            &Job::new(
                scene,
                settings,
                Family::Pilots.seed(seed),
                samples,
                progress,
            ),
            &theta,
            &active.clone().with_noise(scene, scales),
            adjoint,
        )?;
        Ok::<Noise, RenderError>(found.noise.unwrap_or_default())
    };
    let scales = match active.ranges().len() {
        0 | 1 => Vec::new(),
        _ => alike(&noise(&[], 0..first)?.variances),
    };
    let found = noise(&scales, first..first + samples)?;
    let width = scene.film.crop_size[0] as usize;
    Ok(pixel_weights_of(&found.pixels, width))
}

/// Scales that make variances equal. Where no variance was met there is nothing to compare, and the scale is that of the
/// noisiest.
fn alike(variances: &[f64]) -> Vec<f64> {
    let largest = variances.iter().copied().fold(0.0, f64::max);
    let scale = |&v: &f64| 1.0 / if v > 0.0 { v } else { largest }.sqrt();
    if largest > 0.0 {
        variances.iter().map(scale).collect()
    } else {
        vec![1.0; variances.len()]
    }
}

/// Weights of pixels, `width` in a row, with which the measured variance becomes least for the same work: the root
/// of variance over work (the allocation of Neyman). A square of pixels is believed as far as there are
/// samples that carry its variance, and otherwise to be like the square of twice the width that it is part of. Equal
/// where there is no noise at all.
pub fn pixel_weights_of(noise: &[PixelNoise], width: usize) -> Vec<f32> {
    let mut levels = vec![Level {
        width: width.max(1),
        squares: noise.to_vec(),
    }];
    while let Some(last) = levels.last()
        && last.squares.len() > 1
    {
        levels.push(last.joined());
    }
    // Variance and work of a sample, and how many of them carry the variance [Kish 1965].
    let found = |s: &PixelNoise| {
        let n = s.samples.max(1) as f64;
        [s.squares / n, s.work as f64 / n]
    };
    let evenness = |s: &PixelNoise| {
        if s.spread > 0.0 {
            s.squares * s.squares / s.spread / s.samples.max(1) as f64
        } else {
            1.0
        }
    };
    let mut above: Option<(Level, Vec<[f64; 2]>)> = None;
    while let Some(level) = levels.pop() {
        let believed = level.squares.iter().enumerate().map(|(i, s)| {
            let own = found(s);
            let Some((outer, believed)) = &above else {
                return own;
            };
            let around = level.around(i);
            let evidence = s.samples as f64 * evenness(&outer.squares[around]);
            let mix =
                |k: usize| (evidence * own[k] + PRIOR * believed[around][k]) / (evidence + PRIOR);
            [mix(0), mix(1)]
        });
        let believed = believed.collect();
        above = Some((level, believed));
    }
    let believed = above.map(|(_, b)| b).unwrap_or_default();
    let weights: Vec<f64> = believed
        .iter()
        .map(|[v, w]| (v / w.max(1.0)).sqrt())
        .collect();
    // Of numbers of any size.
    let largest = weights.iter().copied().fold(0.0, f64::max);
    if largest > 0.0 && largest.is_finite() {
        weights.iter().map(|w| (w / largest) as f32).collect()
    } else {
        vec![1.0; weights.len()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixel(samples: u64, variance: f64, work: u64) -> PixelNoise {
        let n = samples as f64;
        PixelNoise {
            samples,
            squares: n * variance,
            spread: n * variance * variance,
            work: samples * work,
        }
    }

    /// Where many samples agree, weights are roots of variance over work; borders of squares are no borders.
    #[test]
    fn weights_follow_what_is_known() {
        let quiet = pixel(10_000, 1.0, 4);
        let noisy = pixel(10_000, 100.0, 4);
        let dear = pixel(10_000, 100.0, 16);
        let noise: Vec<PixelNoise> = (0..7 * 5)
            .map(|i| match i % 7 {
                0..3 => quiet,
                3..5 => noisy,
                _ => dear,
            })
            .collect();
        let weights = pixel_weights_of(&noise, 7);
        assert_eq!(weights.len(), 35);
        for (i, w) in weights.iter().enumerate() {
            let expected = [0.1, 0.1, 0.1, 1.0, 1.0, 0.5, 0.5][i % 7];
            assert!((w / expected - 1.0).abs() < 0.02, "{i}: {w}");
        }
    }

    /// One loud sample among few moves its pixel less than many would.
    #[test]
    fn few_samples_are_believed_less() {
        let weight = |samples| {
            let mut noise = vec![pixel(samples, 1.0, 1); 64];
            noise[27] = pixel(samples, 400.0, 1);
            let weights = pixel_weights_of(&noise, 8);
            weights[27] / weights[0]
        };
        assert!(weight(1) > 1.2 && weight(1) < 8.0, "{}", weight(1));
        assert!(weight(100_000) > 18.0, "{}", weight(100_000));
    }

    /// A parameter that was not seen is left what it is beside the noisiest.
    #[test]
    fn variances_become_equal() {
        for (variances, expected) in [
            (&[4.0, 0.0, 1e-8][..], &[0.5, 0.5, 1e4][..]),
            (&[0.0, 0.0], &[1.0, 1.0]),
        ] {
            assert_eq!(alike(variances), expected);
        }
    }

    #[test]
    fn without_noise_all_are_equal() {
        assert!(pixel_weights_of(&[], 0).is_empty());
        assert_eq!(pixel_weights_of(&[PixelNoise::default(); 3], 0), [1.0; 3]);
        assert_eq!(pixel_weights_of(&[PixelNoise::default(); 6], 3), [1.0; 6]);
        let mut silent = [pixel(4, 1.0, 1); 4];
        silent[0].squares = f64::MAX;
        silent[1] = PixelNoise::default();
        let weights = pixel_weights_of(&silent, 2);
        assert!(
            weights.iter().all(|w| w.is_finite() && *w >= 0.0),
            "{weights:?}"
        );
    }
}
