//! How often each emitter is sampled.

use ad_core::Float;

use crate::sampler::index_below;

/// Least part of an emitter: its inverse is a number in single precision.
const LEAST: f64 = 1e-30;

/// The parts that emitters have of all samples of emitters: positive, and one in all.
#[derive(Clone, Debug)]
pub(crate) enum Shares {
    /// The same for each of so many, and how much that is.
    Even(usize, f64),
    /// Of each, and the sum of those up to it.
    Weighted(Vec<(f64, f64)>),
}

impl Shares {
    /// In proportion to weights, which are positive and finite.
    pub fn new(weights: &[f64]) -> Self {
        if weights.windows(2).all(|w| w[0] == w[1]) {
            let n = weights.len();
            return Self::Even(n, if n > 0 { 1.0 / n as f64 } else { 0.0 });
        }
        // Of numbers of any size, the sum is finite.
        let largest = weights.iter().copied().fold(0.0, f64::max);
        let total: f64 = weights.iter().map(|w| w / largest).sum();
        let mut end = 0.0;
        let each = weights.iter().map(|w| {
            // What vanishes beside the largest is sampled all the same.
            let share = (w / largest / total).max(LEAST);
            end += share;
            (share, end)
        });
        Self::Weighted(each.collect())
    }

    /// The part of emitter `i`; zero if there is none.
    #[inline(always)]
    pub fn of(&self, i: usize) -> f64 {
        match self {
            Self::Even(_, share) => *share,
            Self::Weighted(each) => each[i].0,
        }
    }

    /// An emitter, and one of so many other things that are chosen evenly, from 64 random bits. There must be
    /// one of each.
    #[inline(always)]
    pub fn choose(&self, bits: u64, others: usize) -> (usize, usize) {
        match self {
            Self::Even(n, _) => {
                let both = index_below(bits, n * others);
                (both / others, both % others)
            }
            Self::Weighted(each) => {
                let u = f64::from_bits_unit(bits);
                let below = each.partition_point(|(_, end)| *end <= u);
                // Rounding may leave a little beyond the last end.
                let i = below.min(each.len() - 1);
                let (share, end) = each[i];
                let within = (u - (end - share)) / share;
                (i, ((within * others as f64) as usize).min(others - 1))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::mix64;
    use crate::statistics::z_limit;

    /// Frequencies of 1e5 draws (9 emitters, significance 1e-3 together).
    #[test]
    fn emitters_are_chosen_as_often_as_their_weights_say() {
        for weights in [vec![1.0; 3], vec![5.0, 1.0, 0.25, 20.0], vec![1e300, 3e300]] {
            let shares = Shares::new(&weights);
            let n = 100_000;
            let mut count = vec![0.0; weights.len()];
            for i in 0..n {
                count[shares.choose(mix64(i), 1).0] += 1.0;
            }
            let total: f64 = (0..weights.len()).map(|i| shares.of(i)).sum();
            assert!((total - 1.0).abs() < 1e-12);
            for (i, c) in count.iter().enumerate() {
                let p = shares.of(i);
                let ratio = weights[i] / weights[0];
                assert!((p / shares.of(0) / ratio - 1.0).abs() < 1e-12);
                let sd = (n as f64 * p * (1.0 - p)).sqrt();
                let z = (c - n as f64 * p) / sd;
                assert!(z.abs() < z_limit(9, n, 1e-3), "{weights:?} {i}: {c}");
            }
        }
    }

    /// Frequencies of all combinations in 1e5 draws (8 cells, significance 1e-3 together).
    #[test]
    fn other_things_are_chosen_evenly() {
        let shares = Shares::new(&[3.0, 1.0]);
        let n = 100_000;
        let mut count = [[0.0; 4]; 2];
        for i in 0..n {
            let (emitter, other) = shares.choose(mix64(i), 4);
            count[emitter][other] += 1.0;
        }
        for (i, row) in count.iter().enumerate() {
            for c in row {
                let p = shares.of(i) / 4.0;
                let sd = (n as f64 * p * (1.0 - p)).sqrt();
                let z = (c - n as f64 * p) / sd;
                assert!(z.abs() < z_limit(8, n, 1e-3), "{i}: {row:?}");
            }
        }
    }

    #[test]
    fn the_ends_of_the_random_numbers_are_in_range() {
        let shares = Shares::new(&[1e-300, 1.0, 1e-300]);
        for bits in [0, u64::MAX] {
            let (emitter, other) = shares.choose(bits, 7);
            assert!(emitter < 3 && other < 7);
        }
        assert!(shares.of(0) > 0.0 && shares.of(2) > 0.0);
        assert_eq!(Shares::new(&[]).of(0), 0.0);
    }
}
