//! Stochastic gradient descent.

use crate::error::{OptimError, require, require_len};
use crate::optimizer::{Optimizer, check_inputs, require_finite};
use crate::rates::Rates;
use crate::scalar::Scalar;
use serde::{Deserialize, Serialize};

/// Options of [`Sgd`]; the default is plain gradient descent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SgdOptions {
    /// Weight of the previous velocity, in [0, 1).
    #[serde(with = "crate::exact::number")]
    pub momentum: f64,
    /// Look ahead along the velocity; needs a positive momentum.
    pub nesterov: bool,
    /// Take an exactly zero gradient for "not observed": neither parameter nor velocity change.
    pub mask_updates: bool,
}

impl SgdOptions {
    fn validate(&self) -> Result<(), OptimError> {
        let m = self.momentum;
        require((0.0..1.0).contains(&m), "momentum", "a value in [0, 1)", m)?;
        let usable = !self.nesterov || m > 0.0;
        require(
            usable,
            "momentum",
            "a positive value with Nesterov's method",
            m,
        )
    }
}

/// Stochastic gradient descent with momentum: `v = momentum * v + g`, `p -= rate * v`, or with
/// Nesterov's look-ahead `p -= rate * (g + momentum * v)`.
///
/// The conventions of PyTorch and Mitsuba 3: the velocity starts at zero, carries no learning rate,
/// and the first gradient enters with full weight. With momentum m a steady gradient moves a
/// parameter by `rate / (1 - m)` per unit.
///
/// Steps are proportional to the gradient: an objective that is a thousand times as small needs a rate a thousand times
/// as large, and so do the texels of a texture under the mean over a picture, the more of them there are.
/// [`Adam`](crate::Adam) and [`GaussNewton`](crate::GaussNewton) do not depend on the scale.
///
/// ```
/// use optim::{Optimizer, Rates, Sgd, SgdOptions};
///
/// let mut params = [1.0f64];
/// Sgd::new(1, 0.1)?.step(&mut params, &[2.0])?;
/// assert!((params[0] - (1.0 - 0.1 * 2.0)).abs() < 1e-12);
///
/// let options = SgdOptions { momentum: 0.5, ..SgdOptions::default() };
/// let mut sgd = Sgd::with_options(Rates::new(1, 0.1)?, options)?;
/// let mut params = [0.0f64];
/// for _ in 0..2 {
///     sgd.step(&mut params, &[1.0])?;
/// }
/// assert!((params[0] + 0.1 * (1.0 + 1.5)).abs() < 1e-12); // the velocity was 1, then 1.5
/// # Ok::<(), optim::OptimError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawSgd<T>", bound = "")]
pub struct Sgd<T: Scalar> {
    options: SgdOptions,
    rates: Rates,
    steps: u64,
    /// Empty without momentum.
    #[serde(with = "crate::exact::slice")]
    velocity: Vec<T>,
}

#[derive(Deserialize)]
#[serde(bound = "")]
struct RawSgd<T: Scalar> {
    options: SgdOptions,
    rates: Rates,
    steps: u64,
    #[serde(with = "crate::exact::slice")]
    velocity: Vec<T>,
}

impl<T: Scalar> TryFrom<RawSgd<T>> for Sgd<T> {
    type Error = OptimError;
    fn try_from(raw: RawSgd<T>) -> Result<Self, OptimError> {
        let fresh = Self::with_options(raw.rates, raw.options)?;
        require_len("velocity", fresh.velocity.len(), raw.velocity.len())?;
        require_finite("velocity", &raw.velocity)?;
        Ok(Self {
            steps: raw.steps,
            velocity: raw.velocity,
            ..fresh
        })
    }
}

impl<T: Scalar> Sgd<T> {
    /// Plain gradient descent for `len` parameters.
    ///
    /// # Errors
    /// A rate that is not positive and finite.
    pub fn new(len: usize, rate: f64) -> Result<Self, OptimError> {
        Self::with_options(Rates::new(len, rate)?, SgdOptions::default())
    }

    /// With rates per range, a schedule, and options.
    ///
    /// # Errors
    /// An option outside of its range.
    pub fn with_options(rates: Rates, options: SgdOptions) -> Result<Self, OptimError> {
        options.validate()?;
        let len = if options.momentum > 0.0 {
            rates.len()
        } else {
            0
        };
        Ok(Self {
            options,
            rates,
            steps: 0,
            velocity: vec![T::default(); len],
        })
    }

    /// The options.
    pub fn options(&self) -> &SgdOptions {
        &self.options
    }
}

impl<T: Scalar> Optimizer<T> for Sgd<T> {
    fn step(&mut self, params: &mut [T], grad: &[T]) -> Result<(), OptimError> {
        check_inputs(self.rates.len(), params, grad)?;
        let has_momentum = self.options.momentum > 0.0;
        if has_momentum {
            require_len("rates", self.velocity.len(), self.rates.len())?;
        }
        let momentum = T::from_f64(self.options.momentum);
        let (nesterov, mask) = (self.options.nesterov, self.options.mask_updates);
        let next = |p: T, g: T, v: T, rate: T| {
            if mask && g == T::default() {
                return (p, v);
            }
            let v = momentum * v + g;
            let direction = if nesterov { g + momentum * v } else { v };
            (p - rate * direction, v)
        };
        let old = |velocity: &[T], i: usize| velocity.get(i).copied().unwrap_or_default();

        for (range, rate) in self.rates.at(self.steps) {
            let rate = T::from_f64(rate);
            for index in range {
                let (p, v) = next(params[index], grad[index], old(&self.velocity, index), rate);
                if !(p.is_finite() && v.is_finite()) {
                    return Err(OptimError::Overflow {
                        what: "SGD step",
                        index,
                    });
                }
            }
        }
        for (range, rate) in self.rates.at(self.steps) {
            let rate = T::from_f64(rate);
            for i in range {
                let (p, v) = next(params[i], grad[i], old(&self.velocity, i), rate);
                params[i] = p;
                if has_momentum {
                    self.velocity[i] = v;
                }
            }
        }
        self.steps = self.steps.saturating_add(1);
        Ok(())
    }

    fn steps(&self) -> u64 {
        self.steps
    }
    fn rates(&self) -> &Rates {
        &self.rates
    }
    fn rates_mut(&mut self) -> &mut Rates {
        &mut self.rates
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_functions::{MITSUBA_GRADIENTS, MITSUBA_START, descend, quadratic, rosenbrock};
    use approx::assert_relative_eq;

    fn sgd(momentum: f64, nesterov: bool, mask_updates: bool, len: usize, rate: f64) -> Sgd<f64> {
        let options = SgdOptions {
            momentum,
            nesterov,
            mask_updates,
        };
        Sgd::with_options(Rates::new(len, rate).unwrap(), options).unwrap()
    }

    #[test]
    fn two_steps_by_hand() {
        // v: 2, 0.5 * 2 + 4 = 5; p: 1 - 0.1 * 2 = 0.8, 0.8 - 0.1 * 5 = 0.3.
        let mut p = [1.0];
        let mut heavy = sgd(0.5, false, false, 1, 0.1);
        heavy.step(&mut p, &[2.0]).unwrap();
        assert_relative_eq!(p[0], 0.8);
        heavy.step(&mut p, &[4.0]).unwrap();
        assert_relative_eq!(p[0], 0.3, epsilon = 1e-15);
        // Nesterov: directions 2 + 0.5 * 2 = 3 and 4 + 0.5 * 5 = 6.5.
        let mut p = [1.0];
        let mut ahead = sgd(0.5, true, false, 1, 0.1);
        ahead.step(&mut p, &[2.0]).unwrap();
        assert_relative_eq!(p[0], 0.7);
        ahead.step(&mut p, &[4.0]).unwrap();
        assert_relative_eq!(p[0], 0.05, epsilon = 1e-15);
    }

    /// Five steps of `drjit.opt.SGD` (Mitsuba 3.9.1, double precision).
    #[test]
    fn agrees_with_mitsuba() {
        for (mut optimizer, expected) in [
            (sgd(0.0, false, false, 3, 0.05), [0.1625, -0.73125, 0.95]),
            (
                sgd(0.9, false, false, 3, 0.05),
                [-0.01813, -0.7982775, 0.62861],
            ),
            (
                sgd(0.9, true, false, 3, 0.05),
                [-0.123817, -0.81969975, 0.525749],
            ),
            (
                sgd(0.9, false, true, 3, 0.05),
                [0.014675, -0.749475, 0.62861],
            ),
        ] {
            let mut p = MITSUBA_START;
            for g in MITSUBA_GRADIENTS {
                optimizer.step(&mut p, &g).unwrap();
            }
            for (p, e) in p.iter().zip(expected) {
                assert_relative_eq!(*p, e, epsilon = 1e-14);
            }
        }
    }

    #[test]
    fn converges() {
        let plain = descend(
            &mut sgd(0.0, false, false, 2, 0.09),
            quadratic,
            [3.0, -2.0],
            400,
        );
        assert_relative_eq!(plain[0], 1.0, epsilon = 1e-9);
        assert_relative_eq!(plain[1], -0.5, epsilon = 1e-9);
        for nesterov in [false, true] {
            let mut o = sgd(0.95, nesterov, false, 2, 2e-4);
            let p = descend(&mut o, rosenbrock, [-1.2, 1.0], 20_000);
            assert_relative_eq!(p[0], 1.0, epsilon = 1e-6);
            assert_relative_eq!(p[1], 1.0, epsilon = 1e-6);
        }
    }

    #[test]
    fn momentum_and_lookahead_pay() {
        // Condition number 10^2; each method at a rate of its own choosing would gain more.
        let valley = |p: [f64; 2]| [p[0], 100.0 * p[1]];
        let error = |mut o: Sgd<f64>| {
            let p = descend(&mut o, valley, [1.0, 1.0], 150);
            p[0].hypot(p[1])
        };
        let plain = error(sgd(0.0, false, false, 2, 0.01));
        let heavy = error(sgd(0.8, false, false, 2, 0.01));
        let ahead = error(sgd(0.8, true, false, 2, 0.01));
        assert!(plain > 0.2 && heavy < 0.01 * plain && ahead < 0.01 * plain);
    }

    #[test]
    fn bad_options_are_named() {
        let build = |momentum, nesterov| {
            let options = SgdOptions {
                momentum,
                nesterov,
                mask_updates: false,
            };
            Sgd::<f32>::with_options(Rates::new(1, 0.1).unwrap(), options)
        };
        for bad in [-0.1, 1.0, f64::NAN] {
            assert_eq!(
                build(bad, false).unwrap_err().to_string(),
                format!("momentum: expected a value in [0, 1), found {bad}")
            );
        }
        assert_eq!(
            build(0.0, true).unwrap_err().to_string(),
            "momentum: expected a positive value with Nesterov's method, found 0"
        );
        assert!(Sgd::<f32>::new(1, 0.0).is_err());
    }
}
