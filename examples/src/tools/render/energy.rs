//! Whether manifold connections find all light that is theirs.

use render::Job;
use render::emitter::Emitter;
use render::instances::{Estimator, render_f32};
use render::integrator::render::Progress;
use render::params::Theta;
use render::scene::Caustics;
use render::statistics::{Estimate, z_limit};
use render::{Scene, Settings};
use serde::Serialize;

use crate::{complain, say};

/// Independent images of either kind.
const RUNS: u64 = 16;
/// Blocks of the image, in each direction.
const BLOCKS: usize = 4;
/// Chance that light is said to be missing that is not.
const LEVEL: f64 = 1e-3;
/// So that the images are not those that were rendered.
const STREAM: u64 = 0x656e_6572_6779;

/// What came of the comparison.
#[derive(Clone, Debug, Serialize)]
pub struct Energy {
    /// Who finds the light in the images without connections.
    against: &'static str,
    /// Mean of the images with connections over that of those without, and its standard error.
    ratio: f64,
    error: f64,
    /// Largest difference of a block, in standard errors, and what it is expected to stay below.
    worst_z: f64,
    limit_z: f64,
    /// Column and row of that block.
    block: [usize; 2],
}

/// Compares means of blocks of the image with and without connections. `None` if interrupted.
pub fn check(
    scene: &Scene,
    settings: &Settings,
    seed: u64,
    progress: &dyn Progress,
) -> Option<Energy> {
    let points = scene.emitters().iter().any(Emitter::is_delta);
    let (caustics, against) = if points {
        (Caustics::Particles, "particles")
    } else {
        (Caustics::Paths, "paths")
    };
    let without = Settings {
        connections: None,
        caustics,
        pixels_per_particle: 1,
        ..*settings
    };
    let [ours, theirs] = [(settings, 0), (&without, RUNS)].map(|(settings, first)| {
        let spp = (u64::from(settings.spp) / RUNS).max(1);
        let theta = Theta::constant(scene.params().values());
        let seed = seed ^ STREAM;
        let images = (first..first + RUNS).map(|run| {
            let job = Job::new(scene, settings, seed.wrapping_add(run), 0..spp, progress);
            blocks(
                &render_f32(&job, &theta, Estimator::Mis).image(0).data,
                scene,
            )
        });
        images.collect::<Vec<_>>()
    });
    if progress.cancelled() {
        return None;
    }
    let of = |images: &[Vec<f64>], i: usize| {
        Estimate::of(&images.iter().map(|b| b[i]).collect::<Vec<_>>())
    };
    let n = BLOCKS * BLOCKS;
    let z = (0..n).map(|i| (of(&ours, i).z(&of(&theirs, i)).abs(), i));
    let (worst_z, at) = z.fold((0.0, 0), |a, b| if b.0 > a.0 { b } else { a });
    let total = |images: &[Vec<f64>]| {
        let sums = images.iter().map(|b| b.iter().sum::<f64>());
        Estimate::of(&sums.collect::<Vec<_>>())
    };
    let (a, b) = (total(&ours), total(&theirs));
    let ratio = a.mean / b.mean;
    Some(Energy {
        against,
        ratio,
        error: ratio.abs() * (a.se / a.mean).hypot(b.se / b.mean),
        worst_z,
        limit_z: z_limit(n, RUNS, LEVEL),
        block: [at % BLOCKS, at / BLOCKS],
    })
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
    /// Says so.
    pub fn say(&self) {
        let Self {
            against,
            ratio,
            error,
            worst_z,
            limit_z,
            block: [x, y],
        } = self;
        say!(
            "manifold check: {ratio:.4} ± {error:.4} of the light that {against} find; blocks differ by up to {worst_z:.2} \
             standard errors, expected below {limit_z:.2}"
        );
        if worst_z > limit_z {
            let less = if *ratio < 1.0 { "less" } else { "more" };
            complain!(
                "warning: manifold check: {less} light than by {against}, worst in column {x}, row {y} of {BLOCKS} x {BLOCKS} \
                 blocks: a biased method, options that merge solutions, or lights that {against} hardly meet"
            );
        }
    }
}
