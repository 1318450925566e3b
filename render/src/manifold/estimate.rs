//! The estimators, over whatever walks find.

use std::cell::Cell;

/// How many trials it takes to find a solution again: an unbiased estimate of the reciprocal of the probability to find it, from
/// a geometric distribution [Zeltner 2021, Eq. 3.17]. `again` makes one trial; one that finds nothing counts like one that
/// finds something else. At most `budget`, which biases the estimate (F13); the second value says whether it did.
///
/// ```
/// // Every third trial succeeds.
/// let mut n = 0;
/// let again = || { n += 1; n % 3 == 0 };
/// assert_eq!(render::manifold::trials(again, 100), (3, false));
/// assert_eq!(render::manifold::trials(|| false, 100), (100, true));
/// ```
pub fn trials(mut again: impl FnMut() -> bool, budget: u32) -> (u32, bool) {
    let budget = budget.max(1);
    for n in 1..=budget {
        if again() {
            return (n, false);
        }
    }
    (budget, true)
}

/// The distinct ones among so many solutions, in the order of their finding; walks that find nothing are left out
/// [Zeltner 2021, algorithm 3.3 with errata Z-Alg-3.1].
pub fn distinct<T>(
    walks: u32,
    mut walk: impl FnMut() -> Option<T>,
    same: impl Fn(&T, &T) -> bool,
) -> Vec<T> {
    let mut found: Vec<T> = Vec::new();
    for _ in 0..walks {
        if let Some(solution) = walk()
            && !found.iter().any(|s| same(s, &solution))
        {
            found.push(solution);
        }
    }
    found
}

/// Asks now and then whether to go on.
pub(crate) struct Asking<'c> {
    cancelled: &'c dyn Fn() -> bool,
    walks: Cell<u32>,
    stopped: Cell<bool>,
}

impl<'c> Asking<'c> {
    /// A question in so many walks.
    const EVERY: u32 = 256;

    pub(crate) fn new(cancelled: &'c dyn Fn() -> bool) -> Self {
        Self {
            cancelled,
            walks: Cell::new(0),
            stopped: Cell::new(false),
        }
    }

    /// Before a walk: whether it is not wanted any more.
    pub(crate) fn now(&self) -> bool {
        self.walks.set(self.walks.get().wrapping_add(1));
        if self.walks.get().is_multiple_of(Self::EVERY) && (self.cancelled)() {
            self.stopped.set(true);
        }
        self.stopped()
    }

    /// Whether walks are not wanted any more.
    pub(crate) fn stopped(&self) -> bool {
        self.stopped.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{Independent, Sampler};
    use crate::statistics::z_limit;

    /// Draws solution `k` with the probability `p[k]`, or nothing.
    fn draw(s: &mut Independent, p: &[f64]) -> Option<usize> {
        let mut u = s.next_1d::<f64>();
        p.iter().position(|p| {
            u -= p;
            u < 0.0
        })
    }

    /// Algorithm 3.2 where solutions have these values.
    fn unbiased(s: &mut Independent, p: &[f64], f: &[f64], budget: u32) -> (f64, u32) {
        match draw(s, p) {
            // Back at once (F15).
            None => (0.0, 0),
            Some(k) => {
                let (n, _) = trials(|| draw(s, p) == Some(k), budget);
                (f[k] * f64::from(n), n)
            }
        }
    }

    fn moments(n: u64, mut x: impl FnMut(u64) -> f64) -> (f64, f64) {
        let (mut sum, mut squares) = (0.0, 0.0);
        for i in 0..n {
            let x = x(i);
            sum += x;
            squares += x * x;
        }
        let mean = sum / n as f64;
        (mean, squares / n as f64 - mean * mean)
    }

    /// Trials have mean 1 / P and variance (1 - P) / P^2 (F12), 200 000 of each; a budget gives (1 - (1 - P)^budget) / P (F13).
    /// Twelve tests of means, significance 1 in 1000 together.
    #[test]
    #[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
    fn trials_are_geometric() {
        let n = 200_000;
        let limit = z_limit(12, n, 1e-3);
        for p in [0.5, 0.1, 0.02] {
            let count = |budget: u32| {
                moments(n, |i| {
                    let mut s = Independent::new(7, u64::from(budget), i);
                    f64::from(trials(|| draw(&mut s, &[p]).is_some(), budget).0)
                })
            };
            let (mean, variance) = count(u32::MAX);
            let expected = (1.0 - p) / (p * p);
            assert!(
                (mean - 1.0 / p).abs() < limit * (expected / n as f64).sqrt(),
                "{p}: {mean}"
            );
            assert!((variance / expected - 1.0).abs() < 0.05, "{p}: {variance}");
            for budget in [8, 32, 128] {
                let (mean, variance) = count(budget);
                let expected = (1.0 - (1.0 - p).powi(budget as i32)) / p;
                let error = limit * (variance / n as f64).sqrt();
                assert!(
                    (mean - expected).abs() < error,
                    "{p} {budget}: {mean} {expected}"
                );
            }
        }
    }

    /// A mirror with two solutions: the mean is the sum of both, 400 000 estimates; merging them loses most of it (F14), as does
    /// a budget. Two tests, significance 1 in 1000 together.
    #[test]
    #[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
    fn two_solutions_add_up() {
        let (p, f, n) = ([0.3, 0.1], [1.0, 5.0], 400_000);
        let limit = z_limit(2, n, 1e-3);
        let run = |budget| {
            let (mean, variance) = moments(n, |i| {
                unbiased(&mut Independent::new(3, 0, i), &p, &f, budget).0
            });
            (mean, (variance / n as f64).sqrt())
        };
        let (mean, error) = run(u32::MAX);
        assert!(
            (mean - 6.0).abs() < limit * error && error < 0.05,
            "{mean} {error}"
        );
        let (mean, error) = run(4);
        let expected: f64 = (0..2).map(|k| f[k] * (1.0 - (1.0f64 - p[k]).powi(4))).sum();
        assert!(
            (mean - expected).abs() < limit * error && expected < 3.0,
            "{mean} {expected}"
        );
        // What finds itself in either of two: the value of whichever came first, over the probability of both.
        let (mean, _) = moments(n, |i| {
            let mut s = Independent::new(4, 0, i);
            match draw(&mut s, &p) {
                None => 0.0,
                Some(k) => f[k] * f64::from(trials(|| draw(&mut s, &p).is_some(), u32::MAX).0),
            }
        });
        assert!((mean - 2.0).abs() < 0.05, "{mean}");
    }

    /// A shading point without solutions costs one walk, and gives nothing (F15).
    #[test]
    fn a_failed_walk_ends_the_estimate() {
        let mut s = Independent::new(5, 0, 0);
        assert_eq!(unbiased(&mut s, &[], &[], 10), (0.0, 0));
    }

    /// The sum over the distinct solutions of M walks is that of f (1 - (1 - P)^M): the table of errata Z-3.18, 40 000
    /// estimates of each, and grows with M (F16). Five tests, significance 1 in 1000 together.
    #[test]
    #[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
    fn what_trial_sets_miss_is_known() {
        let (p, f) = ([0.5, 0.2, 0.05, 0.01], [1.0, 2.0, 3.0, 4.0]);
        let table = [(1, 1.09), (4, 2.83), (16, 5.22), (64, 7.79), (256, 9.69)];
        let n = 40_000;
        let limit = z_limit(5, n, 1e-3);
        for (m, expected) in table {
            let (mean, variance) = moments(n, |i| {
                let mut s = Independent::new(6, u64::from(m), i);
                let found = distinct(m, || draw(&mut s, &p), |a, b| a == b);
                found.iter().map(|&k| f[k]).sum()
            });
            let exact: f64 = (0..4)
                .map(|k| f[k] * (1.0 - (1.0f64 - p[k]).powi(m as i32)))
                .sum();
            assert!((exact - expected).abs() < 0.01, "{m}: {exact}");
            let error = limit * (variance / n as f64).sqrt();
            assert!((mean - exact).abs() < error, "{m}: {mean} {exact}");
        }
    }
}
