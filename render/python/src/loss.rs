//! Losses between images, and the limit of z-tests.

use numpy::{PyArrayDyn, PyUntypedArrayMethods};
use optim::{Loss, LossKind};
use pyo3::prelude::*;
use render::statistics;

use crate::arrays::{Like, array, values};
use crate::error::Error;

/// The loss between an image and a target of the same shape, and its derivative in every entry of the image: the
/// adjoint that `Scene.backward` takes. Both are means over all entries.
///
/// `name` is one of l1, l2, relative-l1, relative-l2, log-l2. The adjoints of l2 and relative-l2 are free of bias by the
/// noise of the image, if the gradient takes another seed.
#[pyfunction]
#[pyo3(signature = (image, target, name = "l2"))]
pub fn loss<'py>(
    py: Python<'py>,
    image: Like<'py>,
    target: Like<'py>,
    name: &str,
) -> PyResult<(f64, Bound<'py, PyArrayDyn<f32>>)> {
    let kind: LossKind = name.parse().map_err(Error::from)?;
    let shape = image.shape().to_vec();
    let (image, target) = (
        values("image", &image, &shape)?,
        values("target", &target, &shape)?,
    );
    let mut adjoint = vec![0.0; image.len()];
    let value = kind.value(&image, &target).map_err(Error::from)?;
    kind.gradient(&image, &target, &mut adjoint)
        .map_err(Error::from)?;
    Ok((value, array(py, adjoint, &shape)?))
}

/// What `tests` independent values of |z| stay below with probability `1 - significance` if all expectations are equal,
/// for standard errors from `runs` repetitions.
#[pyfunction]
#[pyo3(signature = (tests, runs, significance = 1e-3))]
pub fn z_limit(tests: usize, runs: u64, significance: f64) -> f64 {
    statistics::z_limit(tests, runs, significance)
}
