//! Checks of gradients.

use std::fmt::Write as _;

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use render::check::{Report, Verdict};

/// What a check of gradients found. As a text it is a line per derivative.
#[pyclass(frozen, module = "render_gradients")]
pub struct Check(pub Report);

#[pymethods]
impl Check {
    /// That of the worst derivative: right, cannot tell or wrong.
    #[getter]
    fn verdict(&self) -> &'static str {
        self.0.verdict().name()
    }

    /// Whether everything is right.
    fn __bool__(&self) -> bool {
        self.0.verdict() == Verdict::Right
    }

    /// What |z| stays below if all derivatives are right.
    #[getter]
    fn z_limit(&self) -> f64 {
        self.0.z_limit
    }

    /// Per key a list of dicts, one per value or random direction: along, gradient and differences (each with its
    /// standard error), step, step_error, z, resolution (the smallest relative error that would have been noticed),
    /// verdict.
    #[getter]
    fn params<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(py);
        for param in &self.0.params {
            let list = PyList::empty(py);
            for c in &param.comparisons {
                let row = PyDict::new(py);
                row.set_item("along", c.along.to_string().trim())?;
                row.set_item("gradient", (c.gradient.mean, c.gradient.se))?;
                row.set_item("differences", (c.differences.mean, c.differences.se))?;
                row.set_item("step", c.step)?;
                row.set_item("step_error", c.step_error)?;
                row.set_item("z", c.z)?;
                row.set_item("resolution", c.resolution)?;
                row.set_item("verdict", c.verdict.name())?;
                list.append(row)?;
            }
            all.set_item(&param.name, list)?;
        }
        Ok(all)
    }

    fn __str__(&self) -> String {
        self.0.to_string()
    }

    fn __repr__(&self) -> String {
        let mut text = format!("<check: {}", self.verdict());
        for param in &self.0.params {
            // Writing to a string cannot fail.
            let _ = write!(text, "; {}: {}", param.name, param.verdict().name());
        }
        text + ">"
    }
}
