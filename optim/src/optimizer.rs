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

/// An optimiser that was chosen at run time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", bound = "")]
pub enum AnyOptimizer<T: Scalar> {
    /// [`Sgd`].
    Sgd(Sgd<T>),
    /// [`Adam`].
    Adam(Adam<T>),
}

impl<T: Scalar> AnyOptimizer<T> {
    /// The names that [`new`](Self::new) knows.
    pub const NAMES: [&'static str; 2] = ["adam", "sgd"];

    /// The optimiser of the given name with its default options.
    pub fn new(name: &str, rates: Rates) -> Result<Self, OptimError> {
        match name {
            "adam" => Ok(Self::Adam(Adam::with_options(rates, Default::default())?)),
            "sgd" => Ok(Self::Sgd(Sgd::with_options(rates, Default::default())?)),
            _ => Err(OptimError::UnknownName {
                what: "optimizer",
                expected: Self::NAMES.join(", "),
                found: name.to_owned(),
            }),
        }
    }

    fn inner(&self) -> &dyn Optimizer<T> {
        match self {
            Self::Sgd(o) => o,
            Self::Adam(o) => o,
        }
    }

    fn inner_mut(&mut self) -> &mut dyn Optimizer<T> {
        match self {
            Self::Sgd(o) => o,
            Self::Adam(o) => o,
        }
    }
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
