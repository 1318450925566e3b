//! Learning-rate schedules.

use crate::error::{OptimError, require};
use serde::{Deserialize, Serialize};

/// A dimensionless factor on all learning rates as a function of the step number, which starts at 0.
///
/// ```
/// use optim::Schedule;
/// let schedule = Schedule::Cosine { steps: 100, floor: 0.1 }.after_warm_up(10);
/// assert_eq!(schedule.factor(0), 0.1);
/// assert_eq!(schedule.factor(10), 1.0);
/// assert!((schedule.factor(60) - 0.55).abs() < 1e-12);
/// assert_eq!(schedule.factor(1000), 0.1);
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Schedule {
    /// Always 1.
    #[default]
    Constant,
    /// `decay^step`.
    Exponential {
        /// Factor per step, in (0, 1].
        #[serde(with = "crate::exact::number")]
        decay: f64,
    },
    /// `decay^(step / every)` with integer division.
    Step {
        /// Number of steps between two drops, at least 1.
        every: u64,
        /// Factor per drop, in (0, 1].
        #[serde(with = "crate::exact::number")]
        decay: f64,
    },
    /// Half a cosine wave from 1 at step 0 to `floor` at step `steps`, constant afterwards
    /// [Loshchilov and Hutter 2017, Eq. 5, without restarts].
    Cosine {
        /// Length of the half wave, at least 1.
        steps: u64,
        /// Final factor, in [0, 1].
        #[serde(with = "crate::exact::number")]
        floor: f64,
    },
    /// 1 for the first `hold` steps, then 1/2, 1/3, .. Newton steps this long average the solutions of all
    /// noisy steps from the last whole one on.
    Harmonic {
        /// Number of whole steps, at least 1.
        hold: u64,
    },
    /// `(step + 1) / steps` for the first `steps` steps, then another schedule from its beginning.
    WarmUp {
        /// Length of the ramp, at least 1.
        steps: u64,
        /// What follows.
        then: Box<Schedule>,
    },
}

impl Schedule {
    /// The schedule, preceded by a linear ramp of the given length.
    pub fn after_warm_up(self, steps: u64) -> Self {
        Self::WarmUp {
            steps,
            then: Box::new(self),
        }
    }

    /// The factor at a step, in [0, 1].
    pub fn factor(&self, step: u64) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Exponential { decay } => decay.powf(step as f64),
            Self::Step { every, decay } => decay.powf((step / every.max(&1)) as f64),
            Self::Cosine { steps, floor } => {
                if step >= *steps {
                    return *floor;
                }
                let phase = std::f64::consts::PI * step as f64 / *steps as f64;
                floor + (1.0 - floor) * 0.5 * (1.0 + phase.cos())
            }
            Self::Harmonic { hold } => match step.checked_sub(*hold) {
                None => 1.0,
                Some(after) => 1.0 / (after as f64 + 2.0),
            },
            Self::WarmUp { steps, then } => {
                if step < *steps {
                    (step + 1) as f64 / *steps as f64
                } else {
                    then.factor(step - steps)
                }
            }
        }
    }

    /// Checks the ranges that the variants document.
    ///
    /// # Errors
    /// A number outside of its range, by its name.
    pub fn validate(&self) -> Result<(), OptimError> {
        let fraction = |name, x: f64| require(x > 0.0 && x <= 1.0, name, "a value in (0, 1]", x);
        let count = |name, n: u64| require(n >= 1, name, "at least 1", n as f64);
        match self {
            Self::Constant => Ok(()),
            Self::Exponential { decay } => fraction("schedule decay", *decay),
            Self::Step { every, decay } => {
                count("schedule every", *every)?;
                fraction("schedule decay", *decay)
            }
            Self::Cosine { steps, floor } => {
                count("schedule steps", *steps)?;
                let valid = (0.0..=1.0).contains(floor);
                require(valid, "schedule floor", "a value in [0, 1]", *floor)
            }
            Self::Harmonic { hold } => count("schedule hold", *hold),
            Self::WarmUp { steps, then } => {
                count("warm-up steps", *steps)?;
                then.validate()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Schedule::{self, *};
    use approx::assert_relative_eq;

    #[test]
    fn factors_by_hand() {
        assert_eq!(Constant.factor(7), 1.0);
        assert_relative_eq!(Exponential { decay: 0.9 }.factor(3), 0.729, epsilon = 1e-15);
        let drops = Step {
            every: 10,
            decay: 0.5,
        };
        assert_eq!(
            [0, 9, 10, 19, 20].map(|t| drops.factor(t)),
            [1.0, 1.0, 0.5, 0.5, 0.25]
        );
        let wave = Cosine {
            steps: 4,
            floor: 0.2,
        };
        for (step, expected) in [
            (0, 1.0),
            (1, 0.6 + 0.4 * 0.5f64.sqrt()),
            (2, 0.6),
            (4, 0.2),
            (9, 0.2),
        ] {
            assert_relative_eq!(wave.factor(step), expected, epsilon = 1e-15);
        }
        assert_eq!(
            [0, 2, 3, 5].map(|t| Harmonic { hold: 3 }.factor(t)),
            [1.0, 1.0, 0.5, 0.25]
        );
        let ramp = drops.after_warm_up(4);
        assert_eq!(
            [0, 1, 3, 4, 13, 14].map(|t| ramp.factor(t)),
            [0.25, 0.5, 1.0, 1.0, 1.0, 0.5]
        );
    }

    #[test]
    fn factors_stay_in_the_unit_interval_for_any_step() {
        for schedule in [
            Exponential { decay: 1e-300 },
            Harmonic { hold: u64::MAX },
            Harmonic { hold: 1 },
            Step {
                every: 1,
                decay: 0.1,
            },
            Cosine {
                steps: u64::MAX,
                floor: 0.0,
            }
            .after_warm_up(u64::MAX),
        ] {
            assert_eq!(schedule.validate(), Ok(()));
            for step in [0, 1, 1 << 40, u64::MAX - 1, u64::MAX] {
                assert!(
                    (0.0..=1.0).contains(&schedule.factor(step)),
                    "{schedule:?} {step}"
                );
            }
        }
    }

    #[test]
    fn bad_options_are_named() {
        for (schedule, message) in [
            (
                Exponential { decay: 0.0 },
                "schedule decay: expected a value in (0, 1], found 0",
            ),
            (
                Exponential { decay: f64::NAN },
                "schedule decay: expected a value in (0, 1], found NaN",
            ),
            (
                Step {
                    every: 0,
                    decay: 0.5,
                },
                "schedule every: expected at least 1, found 0",
            ),
            (
                Cosine {
                    steps: 5,
                    floor: 1.5,
                },
                "schedule floor: expected a value in [0, 1], found 1.5",
            ),
            (
                Harmonic { hold: 0 },
                "schedule hold: expected at least 1, found 0",
            ),
            (
                Constant.after_warm_up(0),
                "warm-up steps: expected at least 1, found 0",
            ),
            (
                Cosine {
                    steps: 0,
                    floor: 0.5,
                }
                .after_warm_up(3),
                "schedule steps: expected at least 1, found 0",
            ),
        ] {
            assert_eq!(schedule.validate().unwrap_err().to_string(), message);
            let _ = Schedule::factor(&schedule, 5);
        }
    }
}
