//! Whether manifold connections find all light that is theirs.

use render::Job;
use render::instances::{Estimator, chains_by_particles_f32, render_f32};
use render::integrator::render::Progress;
use render::params::Theta;
use render::scene::{Connections, Method};
use render::statistics::{Estimate, z_limit};
use render::{RenderError, Scene, Settings};
use serde::Serialize;

use crate::{complain, say};

/// Independent images of either kind.
const RUNS: u64 = 16;
/// Fewest particles of each.
const PARTICLES: u64 = 1 << 17;
/// Blocks of the image, in each direction.
const BLOCKS: usize = 4;
/// Chance that light is said to be missing that is not.
const LEVEL: f64 = 1e-3;
/// So that the images are not those that were rendered.
const STREAM: u64 = 0x656e_6572_6779;

/// What came of the comparison.
#[derive(Clone, Debug, Serialize)]
pub struct Energy {
    /// Light of chains by connections over that by particles, and its standard error. None where either found nothing.
    ratio: Option<f64>,
    error: Option<f64>,
    /// Largest difference of a block, in standard errors, and what it is expected to stay below.
    worst_z: f64,
    limit_z: f64,
    /// Column and row of that block.
    block: [usize; 2],
    /// Radius on receivers within which particles are collected, world space. None where too few landed.
    radius: Option<f64>,
}

/// Compares means of blocks of the light of chains, by connections and by particles. `None` if interrupted.
///
/// The light that connections leave to ordinary sampling is taken away at the same seeds, exactly.
///
/// # Errors
/// A scene that particles see otherwise than paths do.
pub fn check(
    scene: &Scene,
    settings: &Settings,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Option<Energy>, RenderError> {
    let rest = Settings {
        connections: settings.connections.map(|c| Connections {
            method: Method::LeftOut,
            ..c
        }),
        ..*settings
    };
    let theta = Theta::constant(scene.params().values());
    let spp = (u64::from(settings.spp) / RUNS).max(1);
    let seed = |run: u64| (seed ^ STREAM).wrapping_add(run);
    let images = |settings: &Settings| {
        let image = |run: u64| {
            let job = Job::new(scene, settings, seed(run), 0..spp, progress);
            let image = render_f32(&job, &theta, Estimator::Mis).image(0);
            blocks(&image.data, scene)
        };
        (0..RUNS).map(image).collect::<Vec<_>>()
    };
    let ours = less(&images(settings), &images(&rest));
    let (mut theirs, mut radii) = (Vec::new(), Vec::new());
    let particles = (spp * scene.film.pixels() as u64).max(PARTICLES);
    for run in RUNS..2 * RUNS {
        let job = Job::new(scene, settings, seed(run), 0..spp, progress);
        let found = chains_by_particles_f32(&job, &theta, particles)?;
        theirs.push(blocks(&found.image.image(0).data, scene));
        radii.extend(found.radius);
    }
    let radius = (!radii.is_empty()).then(|| radii.iter().sum::<f64>() / radii.len() as f64);
    Ok((!progress.cancelled()).then(|| Energy::of(&ours, &theirs, radius)))
}

/// Images without those at the same seeds of other light.
fn less(images: &[Vec<f64>], others: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let difference = |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).map(|(a, b)| a - b).collect();
    images.iter().zip(others).map(difference).collect()
}

/// Estimates of each block.
fn estimates(images: &[Vec<f64>]) -> Vec<Estimate> {
    let of = |i: usize| Estimate::of(&images.iter().map(|b| b[i]).collect::<Vec<_>>());
    (0..images[0].len()).map(of).collect()
}

impl Energy {
    /// By independent images, of so many blocks each.
    ///
    /// Either side may meet light so seldom that in some blocks it never did: their own variance then says that it is certain of
    /// that. If all light is found, light that is met at random has a variance in proportion to its mean, and so each block
    /// has at least its share of the variance of all, by the light that connections find there.
    fn of(ours: &[Vec<f64>], theirs: &[Vec<f64>], radius: Option<f64>) -> Self {
        let shares = estimates(ours).into_iter().map(|e| e.mean.max(0.0));
        let shares: Vec<f64> = shares.collect();
        let all: f64 = shares.iter().sum();
        let floored = |images: &[Vec<f64>]| {
            let mut each = estimates(images);
            let variance: f64 = each.iter().map(|e| e.se * e.se).sum();
            for (e, share) in each.iter_mut().zip(&shares) {
                let share = if all > 0.0 { share / all } else { 0.0 };
                e.se = e.se.max((variance * share).sqrt());
            }
            each
        };
        let (a, b) = (floored(ours), floored(theirs));
        let z = a.iter().zip(&b).map(|(a, b)| a.z(b).abs()).enumerate();
        let (at, worst_z) = z.fold((0, 0.0), |a, b| if b.1 > a.1 { b } else { a });
        let total = |images: &[Vec<f64>]| {
            let sums = images.iter().map(|b| b.iter().sum::<f64>());
            Estimate::of(&sums.collect::<Vec<_>>())
        };
        let limit_z = z_limit(BLOCKS * BLOCKS, RUNS, LEVEL);
        let (a, b) = (total(ours), total(theirs));
        let met = b.mean > 0.0;
        let ratio = a.mean / b.mean;
        let error = ratio.abs() * (a.se / a.mean).hypot(b.se / b.mean);
        Self {
            ratio: Some(ratio).filter(|_| met),
            error: Some(error).filter(|e| met && e.is_finite()),
            // Nothing to compare with.
            worst_z: if met { worst_z } else { 0.0 },
            limit_z,
            block: [at % BLOCKS, at / BLOCKS],
            radius,
        }
    }
}

/// Means of blocks of an image over all channels; what is left at its edges belongs to the last ones.
fn blocks(image: &[f32], scene: &Scene) -> Vec<f64> {
    let [width, height] = scene.film.crop_size.map(|n| n as usize);
    let mut sums = vec![(0.0, 0usize); BLOCKS * BLOCKS];
    for (i, pixel) in image.chunks_exact(3).enumerate() {
        let (x, y) = (i % width * BLOCKS / width, i / width * BLOCKS / height);
        let (sum, n) = &mut sums[y * BLOCKS + x];
        *sum += pixel.iter().map(|&c| f64::from(c)).sum::<f64>() / 3.0;
        *n += 1;
    }
    let mean = |(sum, n): (f64, usize)| sum / n.max(1) as f64;
    sums.into_iter().map(mean).collect()
}

impl Energy {
    /// Says so; `unbiased`: whether connections are.
    pub fn say(&self, unbiased: bool) {
        let Self {
            worst_z,
            limit_z,
            block: [x, y],
            ..
        } = self;
        let (Some(ratio), Some(error)) = (self.ratio, self.error) else {
            complain!(
                "warning: manifold check: particles brought no light over chains: nothing can be said; more by --spp"
            );
            return;
        };
        say!(
            "manifold check: {ratio:.4} ± {error:.4} of the light of chains that particles find; blocks differ by up to \
             {worst_z:.2} standard errors, expected below {limit_z:.2}"
        );
        if worst_z > limit_z {
            let less = if ratio < 1.0 { "less" } else { "more" };
            let why = if unbiased {
                "connections are unbiased, so rare samples carry much of the light, as near focal points; more by --spp"
            } else {
                "a biased method, options that merge solutions, or trials that ran out"
            };
            complain!(
                "warning: manifold check: {less} light than by particles, worst in column {x}, row {y} of {BLOCKS} x {BLOCKS} \
                 blocks: {why}"
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use render::sampler::{Independent, Sampler};

    use super::*;

    /// Images of blocks that meet light at random: `found` of `events` per block and run on average, each worth one over
    /// `events`; the light of block `i` is `i + 1`.
    fn seldom(seed: u64, events: f64, found: f64) -> Vec<Vec<f64>> {
        let run = |run: u64| {
            let block = |i: usize| {
                let mut s = Independent::new(seed, run, i as u64);
                let mean = found * events * (i + 1) as f64;
                // Poisson numbers, by the product of uniform ones.
                let (mut n, mut product) = (0.0, s.next_1d::<f64>());
                while product > (-mean).exp() {
                    n += 1.0;
                    product *= s.next_1d::<f64>();
                }
                n / events
            };
            (0..BLOCKS * BLOCKS).map(block).collect()
        };
        (0..RUNS).map(run).collect()
    }

    /// Light that is met twice in three blocks and never in the others, or everywhere now and then, is no alarm in any of 200
    /// comparisons at a significance of 1e-3 each, beyond three of them; a loss of a fifth is one where light is met often.
    #[test]
    fn light_that_is_seldom_met_is_no_alarm() {
        let alarms = |events: f64, found: f64| {
            let alarm = |seed: u64| {
                let ours = seldom(2 * seed, 20.0, found);
                let e = Energy::of(&ours, &seldom(2 * seed + 1, events, 1.0), None);
                u32::from(e.worst_z > e.limit_z)
            };
            (0..200).map(alarm).sum::<u32>()
        };
        for events in [0.002, 0.01, 0.05, 5.0] {
            let n = alarms(events, 1.0);
            assert!(n <= 3, "{events}: {n}");
        }
        assert!(alarms(20.0, 0.8) > 190);
        // Nothing at all says nothing.
        let none = vec![vec![0.0; BLOCKS * BLOCKS]; RUNS as usize];
        let e = Energy::of(&seldom(1, 20.0, 1.0), &none, None);
        assert!(e.ratio.is_none() && e.worst_z == 0.0);
    }
}
