//! What all first-order optimisers share, and the list of them.

use crate::adam::Adam;
use crate::error::{OptimError, require_len};
use crate::rates::Rates;
use crate::scalar::Scalar;
use crate::sgd::Sgd;
use serde::{Deserialize, Serialize};

/// A first-order optimiser over a flat parameter vector.
///
/// Its state, options and rates serialise together; what is read back continues bit for bit.
pub trait Optimizer<T: Scalar> {
    /// Moves the parameters by one step that reduces the objective whose gradient is given.
    ///
    /// Both slices hold [`Rates::len`] entries in the same order.
    ///
    /// # Errors
    /// A wrong length, a non-finite entry, or a result outside the scalar's range. Neither the
    /// parameters nor the optimiser have changed then: the caller may render again and retry.
    fn step(&mut self, params: &mut [T], grad: &[T]) -> Result<(), OptimError>;

    /// Number of successful steps so far.
    fn steps(&self) -> u64;

    /// Learning rates and schedule.
    fn rates(&self) -> &Rates;

    /// Learning rates and schedule, to change between steps; the number of parameters must stay.
    fn rates_mut(&mut self) -> &mut Rates;
}

macro_rules! optimizers {
    ($($variant:ident $name:literal $rate:literal;)*) => {
        /// An optimiser that was chosen at run time.
        ///
        /// ```
        /// use optim::{AnyOptimizer, Optimizer, Rates};
        ///
        /// let rate = AnyOptimizer::<f64>::usual_rate("adam").expect("a known name");
        /// let mut optimizer = AnyOptimizer::new("adam", Rates::new(1, rate)?)?;
        /// let mut params = [0.5f64];
        /// optimizer.step(&mut params, &[1.0])?;
        /// assert!((params[0] - (0.5 - rate)).abs() < 1e-6);
        ///
        /// // A step that is refused changes nothing: render again, and retry.
        /// let before = (params, optimizer.clone());
        /// assert!(optimizer.step(&mut params, &[f64::NAN]).is_err());
        /// assert_eq!((params, optimizer), before);
        /// assert!(AnyOptimizer::<f64>::new("newton", Rates::new(1, rate)?).is_err());
        /// # Ok::<(), optim::OptimError>(())
        /// ```
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(bound = "")]
        pub enum AnyOptimizer<T: Scalar> {
            $(
                #[doc = concat!("See [`", stringify!($variant), "`].")]
                #[serde(rename = $name)]
                $variant($variant<T>),
            )*
        }

        impl<T: Scalar> AnyOptimizer<T> {
            /// The names that [`new`](Self::new) knows.
            pub const NAMES: [&'static str; [$($name),*].len()] = [$($name),*];

            /// The optimiser of the given name with its default options.
            ///
            /// # Errors
            /// An unknown name, with the known ones.
            pub fn new(name: &str, rates: Rates) -> Result<Self, OptimError> {
                match name {
                    $($name => Ok(Self::$variant($variant::with_options(rates, Default::default())?)),)*
                    _ => Err(OptimError::UnknownName {
                        what: "optimizer",
                        expected: Self::NAMES.join(", "),
                        found: name.to_owned(),
                    }),
                }
            }

            /// A learning rate to begin with under that name, for variables of the order of 1.
            pub fn usual_rate(name: &str) -> Option<f64> {
                match name {
                    $($name => Some($rate),)*
                    _ => None,
                }
            }

            /// Its name among [`NAMES`](Self::NAMES).
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$variant(_) => $name,)*
                }
            }

            fn inner(&self) -> &dyn Optimizer<T> {
                match self {
                    $(Self::$variant(o) => o,)*
                }
            }

            fn inner_mut(&mut self) -> &mut dyn Optimizer<T> {
                match self {
                    $(Self::$variant(o) => o,)*
                }
            }
        }
    };
}

// Type, name here and in files, usual rate.
optimizers! {
    Adam "adam" 0.03;
    Sgd "sgd" 1.0;
}

impl<T: Scalar> Optimizer<T> for AnyOptimizer<T> {
    fn step(&mut self, params: &mut [T], grad: &[T]) -> Result<(), OptimError> {
        self.inner_mut().step(params, grad)
    }
    fn steps(&self) -> u64 {
        self.inner().steps()
    }
    fn rates(&self) -> &Rates {
        self.inner().rates()
    }
    fn rates_mut(&mut self) -> &mut Rates {
        self.inner_mut().rates_mut()
    }
}

/// Lengths match and every entry is finite.
pub(crate) fn check_inputs<T: Scalar>(
    len: usize,
    params: &[T],
    grad: &[T],
) -> Result<(), OptimError> {
    require_len("params", len, params.len())?;
    require_len("grad", len, grad.len())?;
    if let Some(index) = grad.iter().position(|g| !g.is_finite()) {
        let value = grad[index].to_f64();
        return Err(OptimError::NonFiniteGradient {
            index,
            value,
            group: None,
        });
    }
    require_finite("params", params)
}

/// Every entry is finite.
pub(crate) fn require_finite<T: Scalar>(
    what: &'static str,
    values: &[T],
) -> Result<(), OptimError> {
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(index) => {
            let value = values[index].to_f64();
            Err(OptimError::NonFiniteValue {
                what,
                index,
                value,
                group: None,
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_are_known_by_one_name() {
        for name in AnyOptimizer::<f32>::NAMES {
            let rate = AnyOptimizer::<f32>::usual_rate(name).unwrap();
            let made = AnyOptimizer::<f32>::new(name, Rates::new(2, rate).unwrap()).unwrap();
            assert_eq!(made.name(), name);
            let text = serde_json::to_string(&made).unwrap();
            assert!(text.starts_with(&format!(r#"{{"{name}":{{"#)), "{text}");
            assert_eq!(
                serde_json::from_str::<AnyOptimizer<f32>>(&text).unwrap(),
                made
            );
        }
        let error = AnyOptimizer::<f32>::new("lbfgs", Rates::new(2, 1.0).unwrap()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "optimizer: expected one of adam, sgd, found `lbfgs`"
        );
        assert_eq!(AnyOptimizer::<f32>::usual_rate("lbfgs"), None);
    }
}
