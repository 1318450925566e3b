//! How the samples of a pass are shared among pixels.

use std::ops::Range;

/// Least and largest part, as powers of two: no pixel is trusted to be as quiet, or as loud, as pilots say.
const LOGS: (i32, i32) = (-2, 6);
/// The golden ratio's fraction: its multiples are spread evenly between whole numbers.
const SPREAD: f64 = 0.618_033_988_749_894_9;

/// The samples of each pixel: a power of two times as many as of all, so that points stay balanced. Empty: as many
/// of each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct PixelShares(Vec<i8>);

impl PixelShares {
    /// In proportion to weights, which are finite and not negative, as far as powers of two and [`LOGS`] allow; as
    /// many samples in all as if they were equal.
    pub fn new(weights: &[f32]) -> Self {
        let largest = weights.iter().copied().fold(0.0, f32::max);
        if !weights.iter().any(|&w| w < largest) {
            return Self::default();
        }
        // Rounded up as often as the fraction says: neighbours of the same weight share what is left.
        let logs: Vec<f64> = (weights.iter().zip(0u32..))
            .map(|(&w, i)| f64::from(w / largest).log2() + (f64::from(i) * SPREAD).fract())
            .collect();
        let rounded = |log: f64, shift: f64| {
            let whole = (log + shift).floor();
            whole.clamp(f64::from(LOGS.0), f64::from(LOGS.1)) as i8
        };
        let total = |shift: f64| -> f64 {
            let each = logs.iter().map(|&l| f64::from(rounded(l, shift)).exp2());
            each.sum()
        };
        let (mut low, mut high) = (f64::from(LOGS.0) - 1.0, 200.0);
        for _ in 0..64 {
            let middle = 0.5 * (low + high);
            if total(middle) <= weights.len() as f64 {
                low = middle
            } else {
                high = middle
            }
        }
        Self(logs.iter().map(|&l| rounded(l, low)).collect())
    }

    /// The samples of a pixel, counted row by row, when each has those of a range: at least two, if that has
    /// two, and none of those that belong to another range.
    #[inline]
    pub fn samples(&self, pixel: usize, all: &Range<u64>) -> Range<u64> {
        let log = i32::from(self.0.get(pixel).copied().unwrap_or(0));
        let count = all.end.saturating_sub(all.start);
        if log >= 0 {
            return all.start << log..all.end.max(all.start) << log;
        }
        all.start..all.start + (count >> -log).max(count.min(2))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_weights_change_nothing() {
        for weights in [vec![], vec![0.0; 3], vec![7.0; 5]] {
            let shares = PixelShares::new(&weights);
            assert_eq!(shares, PixelShares::default());
            assert_eq!(shares.samples(2, &(3..9)), 3..9);
        }
    }

    /// Counts follow the weights within the factor of two that rounding leaves, and in all there are as many
    /// as without.
    #[test]
    fn counts_follow_the_weights() {
        let weights: Vec<f32> = (0..10_000).map(|i| (i % 100) as f32 + 20.0).collect();
        let shares = PixelShares::new(&weights);
        let count = |i: usize| {
            let n = shares.samples(i, &(64..128));
            n.end - n.start
        };
        let total: u64 = (0..weights.len()).map(count).sum();
        assert!((total as f64 / 640_000.0 - 1.0).abs() < 1e-3, "{total}");
        let mean = weights.iter().sum::<f32>() / weights.len() as f32;
        for (i, w) in weights.iter().enumerate() {
            let ratio = count(i) as f32 / 64.0 / (w / mean);
            assert!((0.45..2.2).contains(&ratio), "{i}: {ratio}");
        }
    }

    /// What one range gives to a pixel, no other range does; no pixel is left out; and extremes are limited.
    #[test]
    fn ranges_are_apart() {
        let shares = PixelShares::new(&[0.0, 1e-30, 1.0, 1e30, 3.0, 0.1]);
        for pixel in 0..6 {
            let mut next = 0;
            for range in [0..1, 1..3, 3..8, 8..64, 64..4096] {
                let found = shares.samples(pixel, &range);
                assert!(found.start >= next, "{pixel} {range:?}");
                let (n, all) = (found.end - found.start, range.end - range.start);
                assert!(
                    n >= all.min(2).max(all >> 2) && n <= all << 6,
                    "{pixel}: {n}"
                );
                next = found.end;
            }
        }
        assert!(shares.samples(3, &(5..5)).is_empty());
    }
}
