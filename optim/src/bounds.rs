//! Parameterisations: from unbounded variables that an optimiser moves to physical values.

use crate::error::{OptimError, require};
use crate::scalar::Scalar;
use serde::{Deserialize, Serialize};

/// How a physical value p depends on the variable u that the optimiser moves.
///
/// Learning rates are in units of u. The derivatives never vanish and every p can be left again:
/// - The box does *not* differentiate its projection. `d max(p, 0) / dp = 0` would hold a value at
///   its bound for ever; here p always lies inside the box, the gradient is the one at p, and the
///   step is projected afterwards. An outward gradient at a bound still enters the optimiser's
///   means: leaving out the outward half of a noisy gradient would push the value inwards.
/// - Sigmoids saturate; u is therefore kept within +-[`SIGMOID_LIMIT`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", try_from = "RawParameterisation")]
#[non_exhaustive]
pub enum Parameterisation {
    /// p = u.
    #[default]
    Identity,
    /// p = u, projected to [lo, hi] after every step; an infinite bound is none.
    /// For albedos and emission, which may end exactly at a bound.
    Box {
        /// Lower bound.
        #[serde(with = "crate::exact::number")]
        lo: f64,
        /// Upper bound.
        #[serde(with = "crate::exact::number")]
        hi: f64,
    },
    /// p = exp(u), projected to [lo, hi], 0 < lo. Steps are relative changes of p.
    /// For roughness, lengths, intensities: positive values of unknown magnitude.
    Log {
        /// Lower bound, positive.
        #[serde(with = "crate::exact::number")]
        lo: f64,
        /// Upper bound, maybe infinite.
        #[serde(with = "crate::exact::number")]
        hi: f64,
    },
    /// p = lo + (hi - lo) / (1 + exp(-u)). For fractions that stay off their bounds.
    Sigmoid {
        /// Lower bound.
        #[serde(with = "crate::exact::number")]
        lo: f64,
        /// Upper bound.
        #[serde(with = "crate::exact::number")]
        hi: f64,
    },
}

/// Largest magnitude of a sigmoid's variable: p keeps 4.5e-5 (hi - lo) off its bounds.
pub const SIGMOID_LIMIT: f64 = 10.0;

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
enum RawParameterisation {
    Identity,
    Box {
        #[serde(with = "crate::exact::number")]
        lo: f64,
        #[serde(with = "crate::exact::number")]
        hi: f64,
    },
    Log {
        #[serde(with = "crate::exact::number")]
        lo: f64,
        #[serde(with = "crate::exact::number")]
        hi: f64,
    },
    Sigmoid {
        #[serde(with = "crate::exact::number")]
        lo: f64,
        #[serde(with = "crate::exact::number")]
        hi: f64,
    },
}

impl TryFrom<RawParameterisation> for Parameterisation {
    type Error = OptimError;
    fn try_from(raw: RawParameterisation) -> Result<Self, OptimError> {
        match raw {
            RawParameterisation::Identity => Ok(Self::Identity),
            RawParameterisation::Box { lo, hi } => Self::bounded(lo, hi),
            RawParameterisation::Log { lo, hi } => Self::log_within(lo, hi),
            RawParameterisation::Sigmoid { lo, hi } => Self::sigmoid(lo, hi),
        }
    }
}

impl Parameterisation {
    /// [`Box`](Self::Box) with lo < hi.
    ///
    /// # Errors
    /// Bounds in the wrong order, or not numbers.
    pub fn bounded(lo: f64, hi: f64) -> Result<Self, OptimError> {
        Self::Box { lo, hi }.validated()
    }

    /// [`Log`](Self::Log) over all positive values.
    pub fn log() -> Self {
        Self::Log {
            lo: f64::MIN_POSITIVE,
            hi: f64::INFINITY,
        }
    }

    /// [`Log`](Self::Log) with 0 < lo < hi.
    ///
    /// # Errors
    /// Bounds in the wrong order, or of which the lower one is not positive.
    pub fn log_within(lo: f64, hi: f64) -> Result<Self, OptimError> {
        Self::Log { lo, hi }.validated()
    }

    /// [`Sigmoid`](Self::Sigmoid) with finite lo < hi.
    ///
    /// # Errors
    /// Bounds in the wrong order, or not finite.
    pub fn sigmoid(lo: f64, hi: f64) -> Result<Self, OptimError> {
        Self::Sigmoid { lo, hi }.validated()
    }

    /// What is usual for `values` that are valid within an interval, whose ends may be infinite: positive numbers of unknown
    /// magnitude move by factors, everything else by steps within its bounds.
    ///
    /// ```
    /// use optim::Parameterisation;
    /// let roughness = Parameterisation::usual((1e-4, 1.0), &[0.2f32])?;
    /// assert_eq!(roughness, Parameterisation::log_within(1e-4, 1.0)?);
    /// assert_eq!(Parameterisation::usual((0.0, f64::INFINITY), &[14.0f32])?, Parameterisation::log());
    /// assert_eq!(Parameterisation::usual((0.0, 1.0), &[0.5f32])?, Parameterisation::bounded(0.0, 1.0)?);
    /// # Ok::<(), optim::OptimError>(())
    /// ```
    ///
    /// # Errors
    /// Ends that are in the wrong order, or not numbers.
    pub fn usual<T: Scalar>((lo, hi): (f64, f64), values: &[T]) -> Result<Self, OptimError> {
        let positive = lo >= 0.0 && values.iter().all(|v| v.to_f64() > 0.0);
        if lo > 0.0 {
            Self::log_within(lo, hi)
        } else if positive && hi.is_infinite() {
            Ok(Self::log())
        } else if lo.is_finite() || hi.is_finite() {
            Self::bounded(lo, hi)
        } else {
            Ok(Self::Identity)
        }
    }

    /// Checks the bounds, for values that were built as a literal.
    ///
    /// # Errors
    /// Those of the function that makes this variant.
    pub fn validated(self) -> Result<Self, OptimError> {
        let ordered = |lo: f64, hi: f64| {
            require(!lo.is_nan(), "lower bound", "a number", lo)?;
            require(lo < hi, "upper bound", "a value above the lower bound", hi)
        };
        match self {
            Self::Identity => {}
            Self::Box { lo, hi } => {
                ordered(lo, hi)?;
                require(
                    lo < f64::INFINITY,
                    "lower bound",
                    "a finite value or -inf",
                    lo,
                )?;
                require(
                    hi > f64::NEG_INFINITY,
                    "upper bound",
                    "a finite value or inf",
                    hi,
                )?;
            }
            Self::Log { lo, hi } => {
                require(lo > 0.0, "lower bound", "a positive value", lo)?;
                ordered(lo, hi)?;
            }
            Self::Sigmoid { lo, hi } => {
                ordered(lo, hi)?;
                let finite = (hi - lo).is_finite();
                require(
                    finite,
                    "upper bound",
                    "a finite value at a finite distance",
                    hi,
                )?;
            }
        }
        Ok(self)
    }

    /// The closed interval of p, as values of the scalar type.
    pub fn range<T: Scalar>(&self) -> (T, T) {
        let (lo, hi) = match *self {
            Self::Identity => (f64::NEG_INFINITY, f64::INFINITY),
            Self::Box { lo, hi } | Self::Log { lo, hi } | Self::Sigmoid { lo, hi } => (lo, hi),
        };
        let lo = match self {
            Self::Log { .. } => lo.max(T::MIN_POSITIVE.to_f64()),
            _ => lo,
        };
        let max = T::MAX.to_f64();
        (
            T::from_f64(lo.clamp(-max, max)),
            T::from_f64(hi.clamp(-max, max)),
        )
    }

    /// The nearest valid variable; finite where u is not NaN.
    pub fn project<T: Scalar>(&self, u: T) -> T {
        let (lo, hi) = self.range::<T>();
        match self {
            Self::Identity | Self::Box { .. } => clamp(u, lo, hi),
            Self::Log { .. } => clamp(
                u,
                T::from_f64(lo.to_f64().ln()),
                T::from_f64(hi.to_f64().ln()),
            ),
            Self::Sigmoid { .. } => {
                clamp(u, T::from_f64(-SIGMOID_LIMIT), T::from_f64(SIGMOID_LIMIT))
            }
        }
    }

    /// p of u; within [`range`](Self::range) where u is not NaN.
    pub fn forward<T: Scalar>(&self, u: T) -> T {
        let (lo, hi) = self.range::<T>();
        let p = match *self {
            Self::Identity | Self::Box { .. } => u,
            Self::Log { .. } => T::from_f64(u.to_f64().exp()),
            Self::Sigmoid { lo, hi } => T::from_f64(lo + (hi - lo) * sigmoid(u.to_f64())),
        };
        clamp(p, lo, hi)
    }

    /// dp/du at u, the projection left out.
    pub fn derivative<T: Scalar>(&self, u: T) -> T {
        match *self {
            Self::Identity | Self::Box { .. } => T::from_f64(1.0),
            Self::Log { .. } => self.forward(u),
            Self::Sigmoid { lo, hi } => {
                let u = u.to_f64();
                T::from_f64((hi - lo) * (sigmoid(u) * sigmoid(-u)))
            }
        }
    }

    /// The valid variable nearest to a physical value. `None` for a non-finite value and where a
    /// log or sigmoid has no variable for it; the box projects.
    pub fn inverse<T: Scalar>(&self, p: T) -> Option<T> {
        let (lo, hi) = self.range::<T>();
        let inside = p >= lo && p <= hi;
        let u = match *self {
            Self::Identity | Self::Box { .. } => p.is_finite().then_some(p),
            Self::Log { .. } => inside.then(|| T::from_f64(p.to_f64().ln())),
            Self::Sigmoid { lo, hi } => inside.then(|| {
                let p = p.to_f64();
                T::from_f64(((p - lo).max(0.0) / (hi - p).max(0.0)).ln())
            }),
        };
        u.map(|u| self.project(u))
    }

    /// The valid physical values, in words.
    pub fn domain(&self) -> String {
        match self {
            Self::Identity => "a finite value".to_owned(),
            Self::Box { lo, hi } | Self::Log { lo, hi } | Self::Sigmoid { lo, hi } => {
                format!("a value in [{lo:?}, {hi:?}]")
            }
        }
    }
}

fn clamp<T: Scalar>(x: T, lo: T, hi: T) -> T {
    if x < lo {
        lo
    } else if x > hi {
        hi
    } else {
        x
    }
}

fn sigmoid(u: f64) -> f64 {
    1.0 / (1.0 + (-u).exp())
}

#[cfg(test)]
mod tests {
    use super::Parameterisation as P;
    use super::*;
    use approx::assert_relative_eq;

    fn all() -> [P; 6] {
        [
            P::Identity,
            P::bounded(-1.0, 2.0).unwrap(),
            P::bounded(0.0, f64::INFINITY).unwrap(),
            P::log(),
            P::log_within(1e-4, 1.0).unwrap(),
            P::sigmoid(-1.0, 3.0).unwrap(),
        ]
    }

    #[test]
    fn values_by_hand() {
        let log = P::log();
        assert_relative_eq!(log.forward(2.0f64), 2.0f64.exp());
        assert_eq!(log.inverse(1.0f32), Some(0.0));
        let s = P::sigmoid(-1.0, 3.0).unwrap();
        assert_eq!(s.forward(0.0f64), 1.0);
        assert_eq!(s.derivative(0.0f64), 1.0);
        assert_relative_eq!(s.forward(3.0f64.ln()), 2.0, epsilon = 1e-15);
        assert_relative_eq!(s.inverse(2.0f64).unwrap(), 3.0f64.ln(), epsilon = 1e-15);
        assert_eq!(P::bounded(0.0, 1.0).unwrap().forward(1.5f32), 1.0);
    }

    #[test]
    fn inverse_and_derivative_agree_with_forward() {
        for map in all() {
            for u in [-6.0, -0.9, 0.0, 0.3, 0.99] {
                let u = map.project(u);
                let p = map.forward(u);
                assert_relative_eq!(map.inverse(p).unwrap(), u, max_relative = 1e-12);
                let h = 1e-5;
                let clamped = map.project(u + h) != u + h || map.project(u - h) != u - h;
                if !clamped {
                    let difference = (map.forward(u + h) - map.forward(u - h)) / (2.0 * h);
                    assert_relative_eq!(map.derivative(u), difference, max_relative = 1e-8);
                }
            }
        }
    }

    #[test]
    fn any_variable_gives_a_finite_value_in_range() {
        fn check<T: Scalar>() {
            for map in all() {
                let (lo, hi) = map.range::<T>();
                for u in [
                    -f64::INFINITY,
                    -1e300,
                    -800.0,
                    -95.0,
                    0.0,
                    17.0,
                    89.0,
                    710.0,
                    f64::MAX,
                ] {
                    let u = map.project(T::from_f64(u));
                    let p = map.forward(u);
                    assert!(
                        u.is_finite() && p.is_finite() && p >= lo && p <= hi,
                        "{map:?} {u}"
                    );
                    let slope = map.derivative(u);
                    assert!(slope > T::default() && slope.is_finite(), "{map:?} {u}");
                    let again = map.inverse(p).unwrap();
                    assert!(again.is_finite(), "{map:?} {u}");
                }
                for p in [lo, hi] {
                    assert!(
                        map.derivative(map.inverse(p).unwrap()) > T::default(),
                        "{map:?}"
                    );
                }
            }
        }
        check::<f32>();
        check::<f64>();
    }

    #[test]
    fn values_outside_have_no_variable() {
        assert_eq!(P::log().inverse(0.0f64), None);
        assert_eq!(P::log_within(1e-4, 1.0).unwrap().inverse(1.5f32), None);
        assert_eq!(P::sigmoid(0.0, 1.0).unwrap().inverse(-0.1f64), None);
        assert_eq!(P::bounded(0.0, 1.0).unwrap().inverse(-0.1f64), Some(0.0));
        for map in all() {
            assert_eq!(map.inverse(f64::NAN), None);
        }
    }

    #[test]
    fn bad_bounds_are_named() {
        let inf = f64::INFINITY;
        for (result, message) in [
            (
                P::bounded(1.0, 1.0),
                "upper bound: expected a value above the lower bound, found 1",
            ),
            (
                P::bounded(f64::NAN, 1.0),
                "lower bound: expected a number, found NaN",
            ),
            (
                P::bounded(0.0, f64::NAN),
                "upper bound: expected a value above the lower bound, found NaN",
            ),
            (
                P::log_within(0.0, 1.0),
                "lower bound: expected a positive value, found 0",
            ),
            (
                P::log_within(2.0, 1.0),
                "upper bound: expected a value above the lower bound, found 1",
            ),
            (
                P::sigmoid(0.0, inf),
                "upper bound: expected a finite value at a finite distance, found inf",
            ),
        ] {
            assert_eq!(result.unwrap_err().to_string(), message);
        }
        let read = |text| serde_json::from_str::<P>(text);
        assert!(read(r#"{"box":{"lo":"0.0","hi":"inf"}}"#).is_ok());
        assert!(read(r#"{"log":{"lo":0,"hi":1}}"#).is_err());
    }
}
