//! First-order and Gauss-Newton optimisers, parameter bounds and image losses over flat slices of f32 or f64.
//!
//! An optimiser takes a parameter vector and the gradient of an objective and moves the parameters;
//! where either comes from is not its concern. [`Groups`] names ranges of the vector and gives them
//! bounds, a change of variables and learning rates of their own. Everything that an
//! optimiser remembers serialises, and a run that is resumed from the file continues bit for bit.
//! Mistakes and non-finite numbers are [`OptimError`]s; nothing has changed when one is returned.
//!
//! ```
//! use optim::{Adam, AdamOptions, Constrained, Groups, Optimizer, Parameterisation, Rates, Schedule};
//!
//! // A roughness of unknown magnitude, and an albedo that may touch its bounds.
//! let mut groups = Groups::new(4);
//! groups.add("glass.alpha", 0..1, Parameterisation::log_within(1e-4, 1.0)?)?;
//! groups.add("wall.reflectance", 1..4, Parameterisation::bounded(0.0, 1.0)?)?;
//!
//! let rates = Rates::new(4, 0.02)?.with_schedule(Schedule::Cosine { steps: 400, floor: 0.01 })?;
//! let adam = Adam::with_options(rates, AdamOptions::default())?;
//! let mut optimizer = Constrained::new(adam, groups)?;
//! optimizer.set_rate("glass.alpha", 0.05)?; // 5 % per step
//!
//! let truth: [f64; 4] = [0.2, 0.6, 0.0, 1.0];
//! let mut params = [0.5; 4];
//! for _ in 0..400 {
//!     let gradient: Vec<_> = params.iter().zip(truth).map(|(p, t)| 2.0 * (p - t)).collect();
//!     optimizer.step(&mut params, &gradient)?;
//! }
//! for (p, t) in params.iter().zip(truth) {
//!     assert!((p - t).abs() < 1e-3);
//! }
//!
//! let checkpoint = serde_json::to_string(&optimizer)?;
//! let resumed: Constrained<Adam<f64>, f64> = serde_json::from_str(&checkpoint)?;
//! assert_eq!(resumed, optimizer);
//!
//! let error = optimizer.step(&mut params, &[0.0, 0.0, f64::NAN, 0.0]).unwrap_err();
//! assert_eq!(
//!     error.to_string(),
//!     "gradient: expected a finite value, found NaN at index 2 (in `wall.reflectance`)"
//! );
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | module | contents |
//! |---|---|
//! | `optimizer` | the trait [`Optimizer`] and the list of optimisers, [`AnyOptimizer`] |
//! | `sgd`, `adam` | one algorithm each |
//! | `gauss_newton` | [`GaussNewton`]: damped steps for least squares, by conjugate gradients |
//! | `schedule`, `rates` | learning rates over time and per range |
//! | `bounds` | changes of variables and projections of single values |
//! | `diffusion` | a change of variables for the vertices of a mesh |
//! | `coarse` | a change of variables for images, whose resolution doubles by a schedule |
//! | `groups` | named ranges, and [`Constrained`], which applies all of the above to them |
//! | [`loss`] | losses, adjoint images, and what noise does to them |
//! | [`exact`] | numbers that survive JSON bit for bit, also for the caller's own checkpoints |

mod adam;
mod bounds;
mod coarse;
mod diffusion;
mod error;
pub mod exact;
mod gauss_newton;
mod groups;
pub mod loss;
mod optimizer;
mod rates;
mod scalar;
mod schedule;
mod sgd;
#[cfg(test)]
mod test_functions;

pub use adam::{Adam, AdamOptions, Epsilon};
pub use bounds::{Parameterisation, SIGMOID_LIMIT};
pub use coarse::Coarse;
pub use diffusion::Diffusion;
pub use error::OptimError;
pub use gauss_newton::{
    Curvature, Evaluation, GaussNewton, GaussNewtonOptions, NormalMatrix, Outcome,
};
pub use groups::{Constrained, Group, Groups};
pub use loss::{Loss, LossKind, PixelLoss};
pub use optimizer::{AnyOptimizer, Optimizer};
pub use rates::Rates;
pub use scalar::Scalar;
pub use schedule::Schedule;
pub use sgd::{Sgd, SgdOptions};
