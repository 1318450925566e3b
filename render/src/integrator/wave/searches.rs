//! Searches of many paths, which take their steps together.

use super::lanes::{Field, Lane, WAVE_SIZE};
use crate::math::search::halve;

/// What each path searches: one of the places from the first to the last.
///
/// Steps of one search wait for what it has read before, and end where nobody can predict. Where all searches take each step
/// before any takes the next one, these times pass together.
#[derive(Clone, Debug)]
pub struct Searches {
    first: Lane<u32>,
    last: Lane<u32>,
}

impl Searches {
    /// None.
    pub fn new() -> Self {
        Self {
            first: Lane::zero(),
            last: Lane::zero(),
        }
    }

    /// Search `k` is among these places.
    #[inline(always)]
    pub fn put(&mut self, k: usize, [first, last]: [usize; 2]) {
        (self.first[k], self.last[k]) = (first as u32, last as u32);
    }

    /// Ends the first `n` searches, each with the first place that is not `before`, or the last one.
    #[inline(always)]
    pub fn run(&mut self, n: usize, before: impl Fn(usize, usize) -> bool) {
        // Mostly there are up to three places, which takes two steps.
        let mut open = [0; WAVE_SIZE];
        let mut count = 0;
        for k in 0..n.min(WAVE_SIZE) {
            self.step(k, &before);
            open[count % WAVE_SIZE] = k;
            count += usize::from(self.step(k, &before));
        }
        while count > 0 {
            let all = std::mem::take(&mut count);
            for at in 0..all.min(WAVE_SIZE) {
                let k = open[at] % WAVE_SIZE;
                open[count % WAVE_SIZE] = k;
                count += usize::from(self.step(k, &before));
            }
        }
    }

    /// Whether search `k` goes on after this step.
    #[inline(always)]
    fn step(&mut self, k: usize, before: impl Fn(usize, usize) -> bool) -> bool {
        let range = [self.first[k] as usize, self.last[k] as usize];
        let [first, last] = halve(range, |place| before(k, place));
        self.put(k, [first, last]);
        first < last
    }

    /// Where search `k` has ended.
    #[inline(always)]
    pub fn found(&self, k: usize) -> usize {
        self.first[k] as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Searches of any lengths, beside each other, find what counting finds; those that nothing ends, the last place.
    #[test]
    fn searches_end_where_counting_ends() {
        let first = |k: usize| k % 7;
        let last = |k: usize| first(k) + k * k % 41;
        for turn in 0..50 {
            let passed = |k: usize| (k * 13 + turn * 5) % 50;
            for n in [0, 1, 5, WAVE_SIZE] {
                let mut searches = Searches::new();
                for k in 0..n {
                    searches.put(k, [first(k), last(k)]);
                }
                searches.run(n, |k, place| place < passed(k));
                for k in 0..n {
                    let expected = passed(k).clamp(first(k), last(k));
                    assert_eq!(searches.found(k), expected, "{turn} {n} {k}");
                }
            }
        }
    }
}
