//! Adam.

use crate::error::{OptimError, require, require_len};
use crate::optimizer::{Optimizer, check_inputs, require_finite};
use crate::rates::Rates;
use crate::scalar::Scalar;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// What keeps [`Adam`] from dividing by zero, and small gradients from moving like large ones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Epsilon {
    /// A multiple of the largest root mean square that the range (see [`Rates`]; a group of
    /// [`Constrained`](crate::Constrained) is one) has had so far: how a parameter moves does not depend on the scale of
    /// the objective, be it the brightness of a picture or the number of its pixels, and steps still end where gradients
    /// vanish.
    Relative(#[serde(with = "crate::exact::number")] f64),
    /// The same number for all parameters, in units of the gradient, as in Mitsuba 3 and PyTorch: gradients that are
    /// much smaller do not move anything.
    Absolute(#[serde(with = "crate::exact::number")] f64),
}

impl Epsilon {
    fn number(self) -> f64 {
        match self {
            Self::Relative(e) | Self::Absolute(e) => e,
        }
    }
}

/// Options of [`Adam`]; the names and, but for epsilon, the defaults are Mitsuba 3's.
///
/// ```
/// use optim::{Adam, AdamOptions, Optimizer, Rates};
///
/// // Texels that no path has met stay where they are, momentum or not.
/// let options = AdamOptions { mask_updates: true, ..AdamOptions::default() };
/// let mut adam = Adam::with_options(Rates::new(2, 0.1)?, options)?;
/// let mut texels = [0.5f32, 0.5];
/// adam.step(&mut texels, &[1.0, 1.0])?;
/// let seen = texels[1];
/// adam.step(&mut texels, &[1.0, 0.0])?;
/// assert!(texels[0] < seen && texels[1] == seen);
/// # Ok::<(), optim::OptimError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdamOptions {
    /// Decay of the mean gradient, in [0, 1).
    #[serde(with = "crate::exact::number")]
    pub beta1: f64,
    /// Decay of the mean squared gradient, in [0, 1).
    #[serde(with = "crate::exact::number")]
    pub beta2: f64,
    /// Added to the root of the mean square; positive.
    pub epsilon: Epsilon,
    /// Undo the pull of both means towards their initial zero.
    pub bias_correction: bool,
    /// Take an exactly zero gradient for "not observed": neither parameter nor means change.
    /// For sparse gradients, such as texels that no path of this step has met. The step count
    /// behind the bias correction advances all the same.
    pub mask_updates: bool,
    /// Divide by the largest mean square of the range (see [`Rates`]) instead of each parameter's
    /// own [Nicolet et al. 2021]: keeps the gradient's direction within the range.
    pub uniform: bool,
}

impl Default for AdamOptions {
    fn default() -> Self {
        Self {
            beta1: 0.9,
            beta2: 0.999,
            epsilon: Epsilon::Relative(1e-10),
            bias_correction: true,
            mask_updates: false,
            uniform: false,
        }
    }
}

impl AdamOptions {
    fn validate<T: Scalar>(&self) -> Result<(), OptimError> {
        let fraction =
            |name, x: f64| require((0.0..1.0).contains(&x), name, "a value in [0, 1)", x);
        fraction("beta1", self.beta1)?;
        fraction("beta2", self.beta2)?;
        // Positive also after rounding to the scalar type.
        let e = T::from_f64(self.epsilon.number());
        let valid = e > T::default() && e.is_finite();
        let found = self.epsilon.number();
        require(valid, "epsilon", "a positive finite value", found)
    }

    /// `sqrt(1 - beta2^t) / (1 - beta1^t)` at the step with number `t`, from 1.
    fn correction(&self, t: u64) -> f64 {
        if !self.bias_correction {
            return 1.0;
        }
        let t = t as f64;
        (1.0 - self.beta2.powf(t)).sqrt() / (1.0 - self.beta1.powf(t))
    }
}

/// Adam [Kingma and Ba 2015, Alg. 1, in the reordered form of their section 2]:
/// `m = beta1 m + (1 - beta1) g`, `v = beta2 v + (1 - beta2) g^2`,
/// `p -= rate * sqrt(1 - beta2^t) / (1 - beta1^t) * m / (sqrt(v) + epsilon)`.
///
/// A parameter moves by about the rate per step, whatever the gradient's scale: objectives that differ by a factor give
/// the same steps, to rounding, for all gradients that the scalar type can hold ([`Epsilon::Relative`]; the root of
/// `v` is kept instead of `v`, whose range would be half of that). Epsilon joins the uncorrected root as in
/// Mitsuba 3; PyTorch adds it after the correction.
///
/// ```
/// use optim::{Adam, Optimizer};
///
/// let mut adam = Adam::new(2, 0.02)?;
/// let mut params = [0.5, 0.5];
/// adam.step(&mut params, &[1e-3, -3.0])?; // the gradient of the objective, one number per parameter
/// // The first step is the rate, downhill, whatever the size of the derivative.
/// assert!((params[0] - 0.48f64).abs() < 1e-6 && (params[1] - 0.52).abs() < 1e-6, "{params:?}");
/// assert_eq!(adam.steps(), 1);
/// # Ok::<(), optim::OptimError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawAdam<T>", bound = "")]
pub struct Adam<T: Scalar> {
    options: AdamOptions,
    rates: Rates,
    steps: u64,
    #[serde(with = "crate::exact::slice")]
    mean: Vec<T>,
    /// Square roots of `v`.
    #[serde(with = "crate::exact::slice")]
    root_mean_square: Vec<T>,
    sizes: Vec<Size>,
}

/// How large the gradients of a range have been, for [`Epsilon::Relative`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Size {
    /// The first parameter behind the range, which begins where the one before ends.
    end: usize,
    /// The largest root mean square so far.
    #[serde(with = "crate::exact::number")]
    largest: f64,
}

#[derive(Deserialize)]
#[serde(bound = "")]
struct RawAdam<T: Scalar> {
    options: AdamOptions,
    rates: Rates,
    steps: u64,
    #[serde(with = "crate::exact::slice")]
    mean: Vec<T>,
    #[serde(with = "crate::exact::slice")]
    root_mean_square: Vec<T>,
    sizes: Vec<Size>,
}

impl<T: Scalar> TryFrom<RawAdam<T>> for Adam<T> {
    type Error = OptimError;
    fn try_from(raw: RawAdam<T>) -> Result<Self, OptimError> {
        let RawAdam {
            options,
            rates,
            steps,
            mean,
            root_mean_square,
            sizes,
        } = raw;
        options.validate::<T>()?;
        for (what, values) in [("mean", &mean), ("root_mean_square", &root_mean_square)] {
            require_len(what, rates.len(), values.len())?;
            require_finite(what, values)?;
        }
        if let Some(v) = root_mean_square.iter().find(|v| **v < T::default()) {
            require(
                false,
                "root_mean_square",
                "values of at least 0",
                v.to_f64(),
            )?;
        }
        let mut start = 0;
        for &Size { end, largest } in &sizes {
            if end <= start || end > rates.len() {
                let (range, len) = (start..end, rates.len());
                return Err(OptimError::Range { range, len });
            }
            let valid = largest >= 0.0 && largest.is_finite();
            require(valid, "sizes", "finite values of at least 0", largest)?;
            start = end;
        }
        Ok(Self {
            options,
            rates,
            steps,
            mean,
            root_mean_square,
            sizes,
        })
    }
}

impl<T: Scalar> Adam<T> {
    /// Default options for `len` parameters.
    ///
    /// # Errors
    /// A rate that is not positive and finite.
    pub fn new(len: usize, rate: f64) -> Result<Self, OptimError> {
        Self::with_options(Rates::new(len, rate)?, AdamOptions::default())
    }

    /// With rates per range, a schedule, and options.
    ///
    /// # Errors
    /// An option outside of its range.
    pub fn with_options(rates: Rates, options: AdamOptions) -> Result<Self, OptimError> {
        options.validate::<T>()?;
        let zeros = vec![T::default(); rates.len()];
        Ok(Self {
            options,
            rates,
            steps: 0,
            mean: zeros.clone(),
            root_mean_square: zeros,
            sizes: Vec::new(),
        })
    }

    /// The options.
    pub fn options(&self) -> &AdamOptions {
        &self.options
    }

    /// The largest root mean square so far of any range that overlaps this one.
    fn size(&self, range: &Range<usize>) -> f64 {
        let mut start = 0;
        self.sizes.iter().fold(0.0, |size: f64, s| {
            let overlaps = start < range.end && range.start < s.end;
            start = s.end;
            if overlaps { size.max(s.largest) } else { size }
        })
    }
}

/// What becomes of one parameter and its two state entries in a step.
struct Moved<T> {
    param: T,
    state: [T; 2],
}

impl<T: Scalar> Moved<T> {
    fn is_finite(&self) -> bool {
        self.param.is_finite() && self.state.iter().all(|s| s.is_finite())
    }
}

/// The options in the scalar type.
struct Update<T> {
    beta1: T,
    rest1: T,
    beta2: f64,
    rest2: f64,
    mask: bool,
}

impl<T: Scalar> Update<T> {
    fn new(options: &AdamOptions) -> Self {
        Self {
            beta1: T::from_f64(options.beta1),
            rest1: T::from_f64(1.0 - options.beta1),
            beta2: options.beta2,
            rest2: 1.0 - options.beta2,
            mask: options.mask_updates,
        }
    }

    /// The next root mean square, where squares may be out of range.
    fn root_mean_square(&self, g: T, root: T) -> T {
        let (g, v) = (g.to_f64().abs(), root.to_f64());
        let size = g.max(v);
        if self.mask && g == 0.0 || size == 0.0 {
            return root;
        }
        let mean = |g: f64, v: f64| (self.beta2 * v * v + self.rest2 * g * g).sqrt();
        // The squares of single precision are all in range.
        T::from_f64(if (1e-140..1e140).contains(&size) {
            mean(g, v)
        } else {
            size * mean(g / size, v / size)
        })
    }

    fn apply(&self, p: T, g: T, state: [T; 2], range: &OfRange<T>) -> Moved<T> {
        if self.mask && g == T::default() {
            return Moved { param: p, state };
        }
        let m = self.beta1 * state[0] + self.rest1 * g;
        let root = self.root_mean_square(g, state[1]);
        // No overflow: neither is larger than the largest gradient so far, and their quotient is moderate.
        let (m64, root64) = (m.to_f64(), range.shared.unwrap_or(root).to_f64());
        let step = if m64 == 0.0 {
            0.0
        } else {
            m64 / (root64 + range.epsilon)
        };
        Moved {
            param: p - range.scale * T::from_f64(step),
            state: [m, root],
        }
    }
}

/// What the parameters of a range have in common in one step.
struct OfRange<T> {
    scale: T,
    epsilon: f64,
    /// The largest root mean square after this step, for the uniform variant.
    shared: Option<T>,
}

impl<T: Scalar> Optimizer<T> for Adam<T> {
    fn step(&mut self, params: &mut [T], grad: &[T]) -> Result<(), OptimError> {
        check_inputs(self.rates.len(), params, grad)?;
        require_len("rates", self.mean.len(), self.rates.len())?;
        let update = Update::new(&self.options);
        let correction = self.options.correction(self.steps.saturating_add(1));
        let (mut ranges, mut sizes) = (Vec::new(), Vec::new());
        for (range, rate) in self.rates.at(self.steps) {
            let relative = matches!(self.options.epsilon, Epsilon::Relative(_));
            let uniform = self.options.uniform || self.rates.is_tied(range.start);
            let largest = (relative || uniform).then(|| {
                range.clone().fold(T::default(), |largest, i| {
                    let root = update.root_mean_square(grad[i], self.root_mean_square[i]);
                    if root > largest { root } else { largest }
                })
            });
            let of_range = OfRange {
                scale: T::from_f64(rate * correction),
                epsilon: match (self.options.epsilon, largest) {
                    (Epsilon::Relative(e), Some(now)) => {
                        let largest = now.to_f64().max(self.size(&range));
                        let end = range.end;
                        sizes.push(Size { end, largest });
                        e * largest
                    }
                    (e, _) => e.number(),
                },
                shared: largest.filter(|_| uniform),
            };
            for index in range.clone() {
                let state = [self.mean[index], self.root_mean_square[index]];
                if !update
                    .apply(params[index], grad[index], state, &of_range)
                    .is_finite()
                {
                    return Err(OptimError::Overflow {
                        what: "Adam step",
                        index,
                    });
                }
            }
            ranges.push((range, of_range));
        }
        for (range, of_range) in ranges {
            for i in range {
                let state = [self.mean[i], self.root_mean_square[i]];
                let moved = update.apply(params[i], grad[i], state, &of_range);
                params[i] = moved.param;
                [self.mean[i], self.root_mean_square[i]] = moved.state;
            }
        }
        self.sizes = sizes;
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

    fn adam(len: usize, rate: f64, options: AdamOptions) -> Adam<f64> {
        Adam::with_options(Rates::new(len, rate).unwrap(), options).unwrap()
    }

    #[test]
    fn two_steps_by_hand() {
        // beta1 = 0.5, beta2 = 0.75, g = 2 then -1:
        // m = 1, 0; v = 1, 1; corrections 0.5 / 0.5 and sqrt(0.4375) / 0.75.
        let options = AdamOptions {
            beta1: 0.5,
            beta2: 0.75,
            epsilon: Epsilon::Absolute(1.0),
            ..Default::default()
        };
        let mut p = [1.0];
        let mut o = adam(1, 0.1, options.clone());
        o.step(&mut p, &[2.0]).unwrap();
        assert_relative_eq!(p[0], 1.0 - 0.1 * 0.5, epsilon = 1e-15);
        o.step(&mut p, &[-1.0]).unwrap();
        assert_relative_eq!(p[0], 0.95, epsilon = 1e-15);
        // g = 3: m = 1.5, v = 3, correction sqrt(1 - 27/64) / (7/8).
        o.step(&mut p, &[3.0]).unwrap();
        let step = (37.0f64 / 64.0).sqrt() / 0.875 * 1.5 / (3.0f64.sqrt() + 1.0);
        assert_relative_eq!(p[0], 0.95 - 0.1 * step, epsilon = 1e-15);
        // Without bias correction the first step is 0.1 * 1 / (1 + 1) as well, the third is not.
        let mut p = [1.0];
        let mut o = adam(
            1,
            0.1,
            AdamOptions {
                bias_correction: false,
                ..options
            },
        );
        for g in [2.0, -1.0, 3.0] {
            o.step(&mut p, &[g]).unwrap();
        }
        assert_relative_eq!(
            p[0],
            0.95 - 0.1 * 1.5 / (3.0f64.sqrt() + 1.0),
            epsilon = 1e-15
        );
    }

    #[test]
    fn first_step_has_the_length_of_the_rate() {
        for g in [1e-6, 1.0, -1e30] {
            let mut p = [0.0];
            adam(
                1,
                0.01,
                AdamOptions {
                    epsilon: Epsilon::Absolute(1e-20),
                    ..Default::default()
                },
            )
            .step(&mut p, &[g])
            .unwrap();
            assert_relative_eq!(p[0], -0.01 * f64::signum(g), max_relative = 1e-10);
        }
    }

    /// Five steps of `drjit.opt.Adam` (Mitsuba 3.9.1, llvm, double precision; its factor of rate
    /// and bias correction is rounded to single precision).
    #[test]
    fn agrees_with_mitsuba() {
        let base = AdamOptions {
            epsilon: Epsilon::Absolute(1e-4),
            ..Default::default()
        };
        for (options, expected) in [
            (
                base.clone(),
                [0.16339531345291372, -0.6854236736011678, 0.9743408646118127],
            ),
            (
                AdamOptions {
                    mask_updates: true,
                    ..base.clone()
                },
                [0.19268192420329042, -0.677497325072158, 0.9743408646118127],
            ),
            (
                AdamOptions {
                    uniform: true,
                    beta1: 0.8,
                    beta2: 0.95,
                    ..base
                },
                [0.23684103177776825, -0.6858664840757568, 1.0236479792984374],
            ),
        ] {
            let mut optimizer = adam(3, 0.05, options);
            let mut p = MITSUBA_START;
            for g in MITSUBA_GRADIENTS {
                optimizer.step(&mut p, &g).unwrap();
            }
            for (p, e) in p.iter().zip(expected) {
                assert_relative_eq!(*p, e, epsilon = 1e-7);
            }
        }
    }

    #[test]
    fn uniform_variant_takes_its_maximum_per_range() {
        let mut rates = Rates::new(3, 0.1).unwrap();
        rates.set_rate(2..3, 0.2).unwrap();
        let options = AdamOptions {
            uniform: true,
            epsilon: Epsilon::Absolute(1e-12),
            ..Default::default()
        };
        let mut p = [0.0; 3];
        Adam::with_options(rates, options)
            .unwrap()
            .step(&mut p, &[1.0, 4.0, 0.5])
            .unwrap();
        for (p, e) in p.iter().zip([-0.025, -0.1, -0.2]) {
            assert_relative_eq!(*p, e, epsilon = 1e-9);
        }
    }

    #[test]
    fn converges() {
        let p = descend(
            &mut adam(2, 0.05, Default::default()),
            quadratic,
            [3.0, -2.0],
            3000,
        );
        assert_relative_eq!(p[0], 1.0, epsilon = 1e-6);
        assert_relative_eq!(p[1], -0.5, epsilon = 1e-6);
        let p = descend(
            &mut adam(2, 0.01, Default::default()),
            rosenbrock,
            [-1.2, 1.0],
            20_000,
        );
        assert_relative_eq!(p[0], 1.0, epsilon = 1e-5);
        assert_relative_eq!(p[1], 1.0, epsilon = 1e-5);
    }

    #[test]
    fn bad_options_are_named() {
        let build = |options| Adam::<f32>::with_options(Rates::new(1, 0.1).unwrap(), options);
        let message = |options| build(options).unwrap_err().to_string();
        for bad in [1.0, -0.5, f64::NAN] {
            assert_eq!(
                message(AdamOptions {
                    beta1: bad,
                    ..Default::default()
                }),
                format!("beta1: expected a value in [0, 1), found {bad}")
            );
            assert_eq!(
                message(AdamOptions {
                    beta2: bad,
                    ..Default::default()
                }),
                format!("beta2: expected a value in [0, 1), found {bad}")
            );
        }
        // The last one is positive, but zero in single precision.
        for bad in [0.0, -1.0, f64::INFINITY, f64::NAN, 1e-60] {
            for epsilon in [Epsilon::Absolute(bad), Epsilon::Relative(bad)] {
                assert_eq!(
                    message(AdamOptions {
                        epsilon,
                        ..Default::default()
                    }),
                    format!("epsilon: expected a positive finite value, found {bad}")
                );
            }
        }
    }

    /// Objectives that differ by a power of two give the same steps bit by bit, those of 1e-30 and 1e30 the same
    /// to rounding, in both precisions: also where squares of gradients are out of range.
    #[test]
    fn the_scale_of_the_objective_does_not_matter() {
        fn path<T: Scalar>(scale: f64, uniform: bool) -> Vec<f64> {
            let mut rates = Rates::new(4, 0.03).unwrap();
            // Two groups; the gradients of the second one are much smaller.
            rates.separate(&(0..2)).unwrap();
            let options = AdamOptions {
                uniform,
                ..Default::default()
            };
            let mut adam = Adam::<T>::with_options(rates, options).unwrap();
            let mut p = [0.9, -0.4, 0.3, 2.0].map(T::from_f64);
            for _ in 0..50 {
                let grad: Vec<T> = (p.iter().zip([1.0, 1e-3, 1e-6, 1e-5]))
                    .map(|(p, size)| T::from_f64(p.to_f64() * size * scale))
                    .collect();
                adam.step(&mut p, &grad).unwrap();
            }
            p.iter().map(|p| p.to_f64()).collect()
        }
        for uniform in [false, true] {
            let single = path::<f32>(1.0, uniform);
            assert!((single[0] - 0.9).abs() > 0.5, "{single:?}");
            assert!(uniform || (single[2] - 0.3).abs() > 0.2, "{single:?}");
            for exponent in [-80, 80] {
                assert_eq!(path::<f32>(f64::from(exponent).exp2(), uniform), single);
            }
            let double = path::<f64>(1.0, uniform);
            for scale in [1e-30, 1e-12, 1e12, 1e30] {
                for (p, expected) in path::<f32>(scale, uniform).iter().zip(&single) {
                    assert_relative_eq!(p, expected, epsilon = 1e-4);
                }
                for (p, expected) in path::<f64>(scale * scale * scale, uniform)
                    .iter()
                    .zip(&double)
                {
                    assert_relative_eq!(p, expected, epsilon = 1e-12);
                }
            }
            for scale in [1e-290, 1e290] {
                for (p, expected) in path::<f64>(scale, uniform).iter().zip(&double) {
                    assert_relative_eq!(p, expected, epsilon = 1e-12);
                }
            }
        }
    }

    /// Nothing is known of a parameter whose gradient has always been zero: it stays.
    #[test]
    fn zero_gradients_move_nothing() {
        for epsilon in [Epsilon::Relative(1e-8), Epsilon::Absolute(1e-8)] {
            let options = AdamOptions {
                epsilon,
                ..Default::default()
            };
            let mut p = [1.0, 2.0];
            let mut o = adam(2, 0.1, options);
            o.step(&mut p, &[0.0, 0.0]).unwrap();
            assert_eq!(p, [1.0, 2.0]);
            o.step(&mut p, &[0.0, 1.0]).unwrap();
            assert_eq!(p[0], 1.0);
            assert!(p[1] < 2.0);
        }
    }

    #[test]
    fn a_step_beyond_the_range_is_an_error() {
        let mut o = Adam::<f32>::new(2, 1e38).unwrap();
        let fresh = o.clone();
        let mut p = [1.0, f32::MAX];
        let error = o.step(&mut p, &[0.0, -1.0]).unwrap_err();
        assert_eq!(
            error,
            OptimError::Overflow {
                what: "Adam step",
                index: 1
            }
        );
        assert_eq!((p, o), ([1.0, f32::MAX], fresh));
    }
}
