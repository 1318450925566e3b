//! Statistics with corrections for many tests.

use statrs::distribution::{ContinuousCDF, Normal};

/// Mean and its standard error.
#[derive(Clone, Copy, Debug, Default)]
pub struct Estimate {
    /// Mean.
    pub mean: f64,
    /// Standard error of the mean.
    pub se: f64,
}

impl Estimate {
    /// From independent repetitions.
    pub fn of(samples: &[f64]) -> Self {
        let n = samples.len() as f64;
        let mean = samples.iter().sum::<f64>() / n;
        let var = samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
        Self {
            mean,
            se: (var / n).sqrt(),
        }
    }

    /// Difference to another estimate in standard errors; zero if both are exactly equal.
    pub fn z(&self, other: &Self) -> f64 {
        let d = self.mean - other.mean;
        if d == 0.0 {
            0.0
        } else {
            d / self.se.hypot(other.se)
        }
    }
}

/// Largest |z| that `tests` independent true hypotheses stay below with probability `1 - alpha`
/// (Sidak). With estimated standard errors from `n` repetitions the tails are those of Student's t;
/// callers use at least 32 repetitions or add that slack themselves.
pub fn z_limit(tests: usize, alpha: f64) -> f64 {
    let each = 1.0 - (1.0 - alpha).powf(1.0 / tests as f64);
    Normal::standard().inverse_cdf(1.0 - each / 2.0)
}
