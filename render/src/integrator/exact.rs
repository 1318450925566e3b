//! Sums that do not depend on the order of what is added.
//!
//! A number goes to one of several fixed-point integers, by its own exponent alone, and integer addition is
//! associative. Numbers of the usual size have their integers side by side in one array, and cost one atomic
//! addition. The integers for all others are made where they are needed, in blocks.

use std::array;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

use crate::prefetch::prefetch;

/// A number with its leading bit at `2^n` quanta, `FIRST <= n < FIRST + STEP`, belongs to the level of that quantum:
/// rounding costs at most `2^-(FIRST + 1)` of it.
const FIRST: i32 = 14;
/// One quantum is `2^STEP` of the next level's below.
const STEP: i32 = 40;
/// Where the number that is expected to be large has its leading bit. What adjoints are multiplied by on their
/// way is rarely more than `2^(FIRST + STEP - EXPECTED)`, and rarely less than `2^(FIRST - EXPECTED)`.
const EXPECTED: i32 = 42;
/// An integer of this size hands its upper bits to the next level. Hundreds of threads may add the largest number of a
/// level to it before that is done.
const FULL: u64 = 1 << 61;
/// Levels above and below the usual one reach over all of f64.
const LEVELS: usize = 128;
const USUAL: usize = LEVELS / 2;
/// Integers that are made together.
const BLOCK: usize = 64;

type Block = Box<[AtomicI64; BLOCK]>;
type Level = OnceLock<Box<[OnceLock<Block>]>>;

/// Sums of many numbers of any size: each number is rounded to 15 bits or more, by a rule that looks at nothing but the
/// number, and the rest is exact. So a sum has the same bits in any order, and it is as good for small numbers beside
/// large ones, in other sums, as alone. An infinite number, or one that is none, makes its sum so.
pub(super) struct ExactBuffer {
    /// The usual level.
    cells: Vec<AtomicI64>,
    /// The other ones, the lowest first.
    levels: [Level; LEVELS],
    /// Sums that are not finite.
    special: Mutex<BTreeMap<usize, f64>>,
    /// Exponent of the usual quantum.
    exponent: i32,
    /// One over that quantum.
    scale: f64,
}

/// `2^n`, a normal number.
const fn power(n: i32) -> f64 {
    f64::from_bits(((n + 1023) as u64) << 52)
}

/// `x = m 2^e` for positive finite `x`.
fn mantissa(x: f64) -> (u64, i32) {
    let bits = x.abs().to_bits();
    let fraction = bits & ((1 << 52) - 1);
    match (bits >> 52) as i32 {
        0 => (fraction, -1074),
        e => (fraction | 1 << 52, e - 1075),
    }
}

impl ExactBuffer {
    /// `len` sums of numbers of about the size of `largest`, zero or positive. It decides over the time they take,
    /// not over how good they are.
    pub(super) fn new(len: usize, largest: f64) -> Self {
        // The scale and the quantum are normal numbers.
        let largest = if largest.is_finite() {
            largest.clamp(power(-900), power(900))
        } else {
            1.0
        };
        let (_, e) = mantissa(largest);
        let exponent = e + 52 - EXPECTED;
        Self {
            cells: (0..len).map(|_| AtomicI64::new(0)).collect(),
            levels: array::from_fn(|_| OnceLock::new()),
            special: Mutex::default(),
            exponent,
            scale: power(-exponent),
        }
    }

    /// Adds `d` to sum `i`.
    #[inline]
    pub(super) fn add(&self, i: usize, d: f64) {
        const RANGE: Range<f64> = power(FIRST)..power(FIRST + STEP);
        let q = d * self.scale;
        if RANGE.contains(&q.abs()) {
            let n = q.round_ties_even() as i64;
            let old = self.cells[i].fetch_add(n, Ordering::Relaxed);
            if old.unsigned_abs() >= FULL {
                self.carry(USUAL, i);
            }
        } else if d != 0.0 {
            self.add_unusual(i, d);
        }
    }

    #[cold]
    #[inline(never)]
    fn add_unusual(&self, i: usize, d: f64) {
        if !d.is_finite() {
            let mut special = self.special.lock().unwrap_or_else(PoisonError::into_inner);
            let sum = special.entry(i).or_insert(0.0);
            *sum += d;
            return;
        }
        let (m, e) = mantissa(d);
        let leading = e + m.ilog2() as i32;
        let level = (leading - self.exponent - FIRST).div_euclid(STEP);
        let shift = self.exponent + level * STEP - e;
        // Half a quantum is rounded to even, as it is in the usual level.
        let n = if shift > 0 {
            let (n, rest, half) = (m >> shift, m & ((1 << shift) - 1), 1 << (shift - 1));
            n + u64::from(rest > half || rest == half && n & 1 == 1)
        } else {
            m << -shift
        };
        let n = n as i64;
        let level = (USUAL as i32 + level) as usize;
        self.add_integer(level, i, if d < 0.0 { -n } else { n });
    }

    fn add_integer(&self, level: usize, i: usize, n: i64) {
        let old = self.cell(level, i).fetch_add(n, Ordering::Relaxed);
        if old.unsigned_abs() >= FULL {
            self.carry(level, i);
        }
    }

    /// Hands the upper bits of an integer to the next level. When that happens depends on the order; the sum of all
    /// levels does not.
    #[cold]
    #[inline(never)]
    fn carry(&self, level: usize, i: usize) {
        let n = self.cell(level, i).swap(0, Ordering::Relaxed);
        self.add_integer(level + 1, i, n >> STEP);
        self.add_integer(level, i, n & ((1 << STEP) - 1));
    }

    fn cell(&self, level: usize, i: usize) -> &AtomicI64 {
        if level == USUAL {
            return &self.cells[i];
        }
        let blocks = self.cells.len().div_ceil(BLOCK);
        let level =
            self.levels[level].get_or_init(|| (0..blocks).map(|_| OnceLock::new()).collect());
        let zeros = || Box::new(array::from_fn(|_| AtomicI64::new(0)));
        &level[i / BLOCK].get_or_init(zeros)[i % BLOCK]
    }

    /// Brings a sum near. Additions wait for their memory one after another.
    #[inline(always)]
    pub(super) fn fetch(&self, i: usize) {
        prefetch(&self.cells[i]);
    }

    /// The sums of a range, each the number in double precision that is next to it.
    pub(super) fn get(&self, range: Range<usize>) -> Vec<f64> {
        let used = |level: &usize| self.levels[*level].get().is_some();
        let lowest = (0..USUAL).find(used).unwrap_or(USUAL);
        let highest = (USUAL..LEVELS).rfind(used).unwrap_or(USUAL);
        let special = self.special.lock().unwrap_or_else(PoisonError::into_inner);
        let mut levels = Vec::new();
        let each = |i| {
            levels.clear();
            levels.extend((lowest..=highest).map(|level| self.digit(level, i)));
            match special.get(&i) {
                Some(sum) if sum.is_nan() => f64::NAN,
                Some(&sum) => sum,
                None => {
                    let first = lowest as i32 - USUAL as i32;
                    value(&levels, self.exponent + first * STEP)
                }
            }
        };
        range.map(each).collect()
    }

    fn digit(&self, level: usize, i: usize) -> i64 {
        let cell = match level {
            USUAL => Some(&self.cells[i]),
            _ => (self.levels[level].get())
                .and_then(|blocks| blocks[i / BLOCK].get())
                .map(|block| &block[i % BLOCK]),
        };
        cell.map_or(0, |c| c.load(Ordering::Relaxed))
    }
}

/// The number next to the sum over `levels[k] 2^(exponent + k STEP)`.
fn value(levels: &[i64], exponent: i32) -> f64 {
    // One digit, as a rule.
    let mut set = (levels.iter().zip(0..)).filter(|(n, _)| **n != 0);
    match (set.next(), set.next()) {
        (None, _) => return 0.0,
        (Some((&n, k)), None) if levels.len() == 1 || n.unsigned_abs() < 1 << 53 => {
            return scaled(n as f64, exponent + k * STEP);
        }
        _ => {}
    }
    // Digits between zero and 2^STEP, of the sum's magnitude.
    let digits = |sign: i128| {
        let mut carry = 0i128;
        let all = levels.iter().copied().chain([0, 0]);
        let digits: Vec<u64> = all
            .map(|n| {
                let n = sign * i128::from(n) + carry;
                carry = n >> STEP;
                (n & ((1 << STEP) - 1)) as u64
            })
            .collect();
        (digits, carry < 0)
    };
    let (mut digits_of_sum, negative) = digits(1);
    if negative {
        digits_of_sum = digits(-1).0;
    }
    let Some(top) = digits_of_sum.iter().rposition(|&d| d != 0) else {
        return 0.0;
    };
    // Three digits are more than 80 bits, of which 53 are kept: what lies below them only breaks ties.
    let first = top.saturating_sub(2);
    let fold = |n: u128, &d: &u64| n << STEP | u128::from(d);
    let mut n = digits_of_sum[first..=top].iter().rev().fold(0, fold);
    n |= u128::from(digits_of_sum[..first].iter().any(|&d| d != 0));
    let magnitude = scaled(n as f64, exponent + first as i32 * STEP);
    if negative { -magnitude } else { magnitude }
}

/// `x 2^n`, where the power itself may be out of range.
fn scaled(x: f64, n: i32) -> f64 {
    let half = n / 2;
    x * power(half) * power(n - half)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers with random bits and exponents between `2^lo` and `2^hi`, of both signs.
    fn numbers(count: usize, lo: i32, hi: i32, mut state: u64) -> Vec<f64> {
        let mut next = || {
            state = crate::sampler::mix64(state.wrapping_add(0x9e37_79b9_7f4a_7c15));
            state
        };
        let span = (hi - lo) as u64;
        (0..count)
            .map(|_| {
                let (bits, e) = (next(), lo + (next() % span) as i32);
                let sign = if bits & 1 == 1 { -1.0 } else { 1.0 };
                sign * (1.0 + (bits >> 12) as f64 * power(-52)) * power(e)
            })
            .collect()
    }

    #[test]
    fn every_size_keeps_fifteen_bits() {
        for largest in [0.0, 1e-300, 1e-30, 1.0, 1e30, 1e300, f64::INFINITY] {
            let all = numbers(4000, -1000, 1000, 1);
            let buffer = ExactBuffer::new(all.len(), largest);
            all.iter().enumerate().for_each(|(i, &d)| buffer.add(i, d));
            for (sum, d) in buffer.get(0..all.len()).iter().zip(&all) {
                assert!((sum - d).abs() <= d.abs() * power(-15), "{sum:e} for {d:e}");
            }
        }
        let buffer = ExactBuffer::new(2, 1.0);
        buffer.add(0, f64::from_bits(3));
        buffer.add(1, 1e308);
        assert_eq!(buffer.get(0..2)[0], f64::from_bits(3));
        assert!((buffer.get(1..2)[0] / 1e308 - 1.0).abs() < 1e-4);
    }

    /// Numbers whose bits all fit have exact sums, whatever else is added and taken away again.
    #[test]
    fn sums_are_exact_and_do_not_depend_on_order() {
        let small: Vec<f64> = numbers(3000, -8, 8, 2)
            .iter()
            .map(|d| (d * 64.0).round())
            .collect();
        let large = numbers(3000, -120, 120, 3);
        let mut all = small.clone();
        all.extend(large.iter().flat_map(|&d| [d, -d]));
        let exact: f64 = small.iter().sum();
        let mut bits = Vec::new();
        for (step, threads) in [(1, 1), (7, 1), (11, 3), (1, 4)] {
            let buffer = ExactBuffer::new(65, 1.0);
            std::thread::scope(|scope| {
                for t in 0..threads {
                    let (buffer, all) = (&buffer, &all);
                    scope.spawn(move || {
                        for k in (t..all.len()).step_by(threads) {
                            buffer.add(64, all[k * step % all.len()]);
                        }
                    });
                }
            });
            bits.push(buffer.get(64..65)[0].to_bits());
        }
        assert_eq!(bits, [exact.to_bits(); 4]);
    }

    #[test]
    fn a_full_integer_carries() {
        // The largest number of the usual level, half a million times: many times what an i64 holds.
        let d = 1.5 * power(FIRST + STEP - 1 - EXPECTED);
        for sign in [1.0, -1.0] {
            let buffer = ExactBuffer::new(3, 1.0);
            std::thread::scope(|scope| {
                for _ in 0..4 {
                    scope.spawn(|| (0..131_072).for_each(|_| buffer.add(1, sign * d)));
                }
            });
            assert_eq!(buffer.get(0..3), [0.0, sign * d * 524_288.0, 0.0]);
            // Back below what one integer holds: the same bits as without a carry.
            (0..524_287).for_each(|_| buffer.add(1, -sign * d));
            assert_eq!(buffer.get(1..2), [sign * d]);
        }
    }

    #[test]
    fn what_is_not_finite_is_not_lost() {
        let buffer = ExactBuffer::new(4, 1.0);
        buffer.add(0, f64::INFINITY);
        buffer.add(0, 1.0);
        buffer.add(1, f64::NEG_INFINITY);
        buffer.add(1, f64::INFINITY);
        buffer.add(2, f64::NAN);
        buffer.add(3, 1.0);
        let sums = buffer.get(0..4);
        assert_eq!((sums[0], sums[3]), (f64::INFINITY, 1.0));
        assert!(sums[1].is_nan() && sums[2].is_nan());
    }
}
