//! Images by which derivatives are checked: differences, in double precision.

use render::Job;
use render::instances::{Estimator, render_f64};
use render::params::Theta;

/// An image with parameters moved forth less that with them moved back, with common random numbers: `[height][width][3]`, summed
/// over samples. `steps`: which of the values move, and how far. The derivative is this over twice the step and the number of
/// samples.
pub fn central(job: &Job, e: Estimator, steps: &[(usize, f64)]) -> Vec<f64> {
    let values = job.scene.params().values();
    let shot = |sign: f64| {
        let mut moved: Vec<f64> = values.iter().map(|&v| v.into()).collect();
        for &(i, step) in steps {
            moved[i] += sign * step;
        }
        render_f64(job, &Theta::constant(&moved), e)
    };
    let (up, down) = (shot(1.0), shot(-1.0));
    let pairs = up.sums[0].iter().zip(&down.sums[0]);
    pairs.map(|(a, b)| a - b).collect()
}
