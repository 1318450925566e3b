//! Whether estimates agree within chance, the same way in all tests and tools that compare them.
//!
//! ```
//! use render::statistics::{Estimate, z_limit};
//!
//! // Two estimators of one derivative, four independent runs each, at a significance of 1 in 1000.
//! let a = Estimate::of(&[1.02, 0.97, 1.05, 0.99]);
//! let b = Estimate::of(&[1.01, 1.04, 0.95, 1.03]);
//! assert!(a.z(&b).abs() < z_limit(1, 4, 1e-3));
//! ```

use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

/// A mean and its standard error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Mean.
    pub mean: f64,
    /// Standard error of the mean; zero if it is exact.
    pub se: f64,
}

impl Estimate {
    /// From independent repetitions, at least two: of fewer, the standard error is NaN, and so is every [`Estimate::z`].
    pub fn of(samples: &[f64]) -> Self {
        let n = samples.len() as f64;
        let mean = samples.iter().sum::<f64>() / n;
        let var = samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
        Self {
            mean,
            se: (var / n).sqrt(),
        }
    }

    /// A mean that is known.
    pub fn exact(mean: f64) -> Self {
        Self { mean, se: 0.0 }
    }

    /// Difference to another estimate in standard errors; zero if both are exactly equal, infinite if both are exact and
    /// differ.
    pub fn z(&self, other: &Self) -> f64 {
        let d = self.mean - other.mean;
        if d == 0.0 {
            0.0
        } else {
            d / self.se.hypot(other.se)
        }
    }
}

/// Significance of each of `tests` independent tests such that together they have significance `level`: if all hypotheses
/// are true, any of them is rejected with this probability (Sidak's correction). With no test at all, `level`.
pub fn sidak(tests: usize, level: f64) -> f64 {
    -((-level).ln_1p() / tests.max(1) as f64).exp_m1()
}

/// What `tests` independent values of |z| stay below with probability `1 - level` if all expectations are equal
/// ([`sidak`]), for standard errors from `runs` repetitions, by Student's distribution. For a difference of two estimates
/// with as many repetitions each that is a little more than needed. Infinite for fewer than two runs.
pub fn z_limit(tests: usize, runs: u64, level: f64) -> f64 {
    match StudentsT::new(0.0, 1.0, runs as f64 - 1.0) {
        Ok(t) => t.inverse_cdf(1.0 - 0.5 * sidak(tests, level)),
        Err(_) => f64::INFINITY,
    }
}

/// Pearson's chi-square test of pairs of observed and expected counts, of the same sum: the probability of a statistic as
/// large as theirs. Bins are pooled, those that expect least first, until they expect five; 1 if there are then fewer than
/// two, and 0 if there are thirty samples or more where next to none are expected.
pub fn p_value(bins: impl IntoIterator<Item = (f64, f64)>) -> f64 {
    let mut bins: Vec<(f64, f64)> = bins.into_iter().collect();
    bins.sort_by(|a, b| a.1.total_cmp(&b.1));
    let (mut statistic, mut freedom) = (0.0, -1.0);
    let mut pool = (0.0, 0.0);
    for (observed, expected) in bins {
        pool = (pool.0 + observed, pool.1 + expected);
        if pool.1 >= 5.0 {
            statistic += (pool.0 - pool.1).powi(2) / pool.1;
            freedom += 1.0;
            pool = (0.0, 0.0);
        }
    }
    // What is left is the total, if that is small at all.
    if pool.0 >= 30.0 {
        return 0.0;
    }
    match ChiSquared::new(freedom) {
        Ok(chi_squared) => chi_squared.sf(statistic),
        Err(_) => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_by_hand() {
        // Student's t with 15 degrees of freedom and the normal distribution, two-sided 1e-3.
        assert!((z_limit(1, 16, 1e-3) - 4.0728).abs() < 1e-3);
        assert!((z_limit(1, 1_000_000, 1e-3) - 3.2905).abs() < 1e-3);
        assert!(z_limit(100, 16, 1e-3) > z_limit(10, 16, 1e-3));
        assert_eq!(z_limit(1, 1, 1e-3), f64::INFINITY);
        // Two tests of 1 % each: 1 - 0.99^2.
        assert!((sidak(2, 0.0199) - 0.01).abs() < 1e-15);
        assert_eq!(sidak(0, 0.01), sidak(1, 0.01));
    }

    #[test]
    fn estimates_by_hand() {
        let e = Estimate::of(&[1.0, 2.0, 6.0]);
        assert_eq!(e.mean, 3.0);
        assert!((e.se - (7.0f64 / 3.0).sqrt()).abs() < 1e-15);
        assert_eq!(e.z(&Estimate::exact(3.0)), 0.0);
        assert!((e.z(&Estimate::exact(0.0)) - 3.0 / e.se).abs() < 1e-15);
        assert!(Estimate::of(&[1.0]).z(&e).is_nan());
    }

    #[test]
    fn p_values_by_hand() {
        // One degree of freedom: sf(4) = 0.0455.
        assert!((p_value([(60.0, 50.0), (40.0, 50.0)]) - 0.0455).abs() < 1e-4);
        assert_eq!(p_value([(50.0, 50.0), (50.0, 50.0)]), 1.0);
        // Three bins of two counts make one of six, and the rest is another.
        let pooled = p_value([(1.0, 2.0), (2.0, 2.0), (0.0, 2.0), (9.0, 6.0)]);
        assert!((pooled - p_value([(3.0, 6.0), (9.0, 6.0)])).abs() < 1e-15);
        assert!(p_value([(1000.0, 500.0), (0.0, 500.0)]) < 1e-100);
        assert_eq!(p_value([(30.0, 0.0)]), 0.0);
        assert_eq!(p_value([]), 1.0);
    }
}
