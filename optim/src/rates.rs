//! Learning rates: one per range of parameters, times a schedule.

use crate::error::{OptimError, require};
use crate::schedule::Schedule;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// The learning rate of every parameter: a rate per range times the [`Schedule`]'s factor.
///
/// The ranges partition `0..len`.
///
/// ```
/// use optim::{Rates, Schedule};
///
/// let mut rates = Rates::new(4, 0.02)?.with_schedule(Schedule::Exponential { decay: 0.5 })?;
/// rates.set_rate(1..3, 0.1)?;
/// let second: Vec<_> = rates.at(1).collect(); // ranges in order, with their rates at the second step
/// assert_eq!(second, [(0..1, 0.01), (1..3, 0.05), (3..4, 0.01)]);
/// # Ok::<(), optim::OptimError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawRates")]
pub struct Rates {
    len: usize,
    segments: Vec<Segment>,
    schedule: Schedule,
}

/// Consecutive parameters from the end of the previous segment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Segment {
    end: usize,
    #[serde(with = "crate::exact::number")]
    rate: f64,
    /// Whether they move together.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    tied: bool,
}

#[derive(Deserialize)]
struct RawRates {
    len: usize,
    segments: Vec<Segment>,
    schedule: Schedule,
}

impl TryFrom<RawRates> for Rates {
    type Error = OptimError;
    fn try_from(raw: RawRates) -> Result<Self, OptimError> {
        let mut start = 0;
        for segment in &raw.segments {
            if segment.end <= start {
                return Err(OptimError::Range {
                    range: start..segment.end,
                    len: raw.len,
                });
            }
            check_rate(segment.rate)?;
            start = segment.end;
        }
        if start != raw.len {
            return Err(OptimError::Length {
                what: "rates",
                expected: raw.len,
                found: start,
            });
        }
        raw.schedule.validate()?;
        Ok(Self {
            len: raw.len,
            segments: raw.segments,
            schedule: raw.schedule,
        })
    }
}

impl Rates {
    /// One constant rate for `len` parameters; it must be positive and finite.
    ///
    /// # Errors
    /// A rate that is not.
    pub fn new(len: usize, rate: f64) -> Result<Self, OptimError> {
        check_rate(rate)?;
        let segments = if len == 0 {
            Vec::new()
        } else {
            let tied = false;
            vec![Segment {
                end: len,
                rate,
                tied,
            }]
        };
        Ok(Self {
            len,
            segments,
            schedule: Schedule::Constant,
        })
    }

    /// The same rates under another schedule.
    ///
    /// # Errors
    /// A number of the schedule outside of its range.
    pub fn with_schedule(mut self, schedule: Schedule) -> Result<Self, OptimError> {
        schedule.validate()?;
        self.schedule = schedule;
        Ok(self)
    }

    /// Gives a range its own rate; the last call wins where ranges overlap.
    ///
    /// # Errors
    /// A range that is none of the vector, or a rate that is not positive and finite.
    pub fn set_rate(&mut self, range: Range<usize>, rate: f64) -> Result<(), OptimError> {
        check_rate(rate)?;
        self.separate(&range)?;
        let mut start = 0;
        for segment in &mut self.segments {
            if start >= range.start && segment.end <= range.end {
                segment.rate = rate;
            }
            start = segment.end;
        }
        Ok(())
    }

    /// Makes a range a union of whole segments, without changing a rate.
    pub(crate) fn separate(&mut self, range: &Range<usize>) -> Result<(), OptimError> {
        if range.start > range.end || range.end > self.len {
            return Err(OptimError::Range {
                range: range.clone(),
                len: self.len,
            });
        }
        for end in [range.start, range.end] {
            let at = self.segments.partition_point(|s| s.end < end);
            if end > 0 && self.segments.get(at).is_some_and(|s| s.end > end) {
                let segment = self.segments[at].clone();
                self.segments.insert(at, Segment { end, ..segment });
            }
        }
        Ok(())
    }

    /// Says that the parameters of a range move together: [`Adam`](crate::Adam) keeps the direction of their gradient, as
    /// with [`AdamOptions::uniform`](crate::AdamOptions::uniform).
    ///
    /// # Errors
    /// As [`Rates::set_rate`].
    pub(crate) fn tie(&mut self, range: Range<usize>) -> Result<(), OptimError> {
        self.separate(&range)?;
        let mut start = 0;
        for segment in &mut self.segments {
            segment.tied |= start >= range.start && segment.end <= range.end;
            start = segment.end;
        }
        Ok(())
    }

    /// Whether a parameter moves together with others.
    pub(crate) fn is_tied(&self, index: usize) -> bool {
        let at = self.segments.partition_point(|s| s.end <= index);
        self.segments.get(at).is_some_and(|s| s.tied)
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no parameters.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The ranges in order with their rates at a step.
    pub fn at(&self, step: u64) -> impl Iterator<Item = (Range<usize>, f64)> + '_ {
        let factor = self.schedule.factor(step);
        self.segments.iter().scan(0, move |start, segment| {
            let range = *start..segment.end;
            *start = segment.end;
            Some((range, segment.rate * factor))
        })
    }
}

fn check_rate(rate: f64) -> Result<(), OptimError> {
    let valid = rate > 0.0 && rate.is_finite();
    require(valid, "learning rate", "a positive finite value", rate)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(rates: &Rates, step: u64) -> Vec<(Range<usize>, f64)> {
        rates.at(step).collect()
    }

    #[test]
    fn ranges_split_and_overwrite() {
        let mut rates = Rates::new(10, 1.0).unwrap();
        rates.set_rate(2..5, 2.0).unwrap();
        assert_eq!(listed(&rates, 0), [(0..2, 1.0), (2..5, 2.0), (5..10, 1.0)]);
        rates.set_rate(4..10, 3.0).unwrap();
        assert_eq!(
            listed(&rates, 0),
            [(0..2, 1.0), (2..4, 2.0), (4..5, 3.0), (5..10, 3.0)]
        );
        rates.set_rate(0..0, 9.0).unwrap();
        rates.set_rate(7..7, 9.0).unwrap();
        assert!(rates.at(0).all(|(_, r)| r < 9.0));
        rates.set_rate(0..10, 0.5).unwrap();
        assert!(rates.at(0).all(|(_, r)| r == 0.5));
        assert_eq!(rates.at(0).map(|(r, _)| r.len()).sum::<usize>(), 10);
    }

    #[test]
    fn schedule_multiplies_every_range() {
        let mut rates = Rates::new(2, 4.0)
            .unwrap()
            .with_schedule(Schedule::Exponential { decay: 0.5 })
            .unwrap();
        rates.set_rate(1..2, 8.0).unwrap();
        assert_eq!(listed(&rates, 2), [(0..1, 1.0), (1..2, 2.0)]);
    }

    #[test]
    fn errors_name_what_was_expected() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(
                Rates::new(3, bad).unwrap_err().to_string(),
                format!("learning rate: expected a positive finite value, found {bad}")
            );
        }
        let mut rates = Rates::new(3, 1.0).unwrap();
        let error = rates.set_rate(2..4, 1.0).unwrap_err();
        assert_eq!(
            error.to_string(),
            "range 2..4: expected a non-empty range within 0..3"
        );
        #[allow(clippy::reversed_empty_ranges)]
        let reversed = 2..1;
        assert!(rates.set_rate(reversed, 1.0).is_err());
        assert!(Rates::new(0, 1.0).unwrap().is_empty());
        for text in [
            r#"{"len":3,"segments":[{"end":2,"rate":1.0}],"schedule":"constant"}"#,
            r#"{"len":2,"segments":[{"end":2,"rate":1.0},{"end":2,"rate":1}],"schedule":"constant"}"#,
            r#"{"len":2,"segments":[{"end":2,"rate":-1.0}],"schedule":"constant"}"#,
            r#"{"len":0,"segments":[],"schedule":{"exponential":{"decay":2}}}"#,
        ] {
            assert!(serde_json::from_str::<Rates>(text).is_err(), "{text}");
        }
    }
}
