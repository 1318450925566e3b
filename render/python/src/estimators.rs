//! The list of estimators.

use pyo3::prelude::*;
use render::RenderError;
use render::instances::Estimator;

/// What an estimator is, and what it can do.
#[pyclass(frozen, get_all, module = "render_gradients")]
pub struct EstimatorInfo {
    /// Its name, as other functions take it.
    name: &'static str,
    /// What it is, in a sentence.
    summary: &'static str,
    /// Where it is right and what it has, in few words.
    capabilities: String,
    /// All that it refuses, and why.
    refuses: Vec<String>,
    /// Whether it is wrong on purpose, for study.
    biased: bool,
}

#[pymethods]
impl EstimatorInfo {
    fn __repr__(&self) -> String {
        format!(
            "<estimator {}: {} {}>",
            self.name, self.summary, self.capabilities
        )
    }
}

/// All estimators of derivatives, with what each can do and what it refuses. Wherever an estimator is asked for, `auto`
/// is understood as well where that is said: pilots choose.
#[pyfunction]
pub fn estimators() -> Vec<EstimatorInfo> {
    let info = |e: &Estimator| {
        let can = e.capabilities();
        EstimatorInfo {
            name: e.name(),
            summary: e.summary(),
            capabilities: can.to_string(),
            refuses: can.refusals().iter().map(ToString::to_string).collect(),
            biased: can.study,
        }
    };
    Estimator::ALL.iter().map(info).collect()
}

/// The estimator called `name`, or none for `auto`.
///
/// # Errors
/// An unknown name, with all known ones.
pub fn or_auto(name: &str) -> Result<Option<Estimator>, RenderError> {
    match name {
        "auto" => Ok(None),
        _ => Estimator::from_name(name).map(Some).map_err(|e| match e {
            RenderError::UnknownEstimator { name, known } => RenderError::UnknownEstimator {
                name,
                known: format!("auto, {known}"),
            },
            other => other,
        }),
    }
}
