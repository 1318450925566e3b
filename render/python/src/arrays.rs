//! Arrays of numpy: those of images and of parameters.

use std::ops::Deref;

use numpy::{
    AllowTypeChange, Element, IntoPyArray, PyArray3, PyArrayDescrMethods, PyArrayDyn,
    PyArrayLikeDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use render::params::{ParamInfo, ParamShape};

type Floats<'py> = PyArrayLikeDyn<'py, f32, AllowTypeChange>;

/// Real numbers that numpy makes an array of. It would also make one of `None`, which is NaN there, and of the real parts of
/// complex numbers.
pub struct Like<'py>(Floats<'py>);

impl<'py> Deref for Like<'py> {
    type Target = Floats<'py>;
    fn deref(&self) -> &Floats<'py> {
        &self.0
    }
}

impl<'py> FromPyObject<'_, 'py> for Like<'py> {
    type Error = PyErr;

    fn extract(value: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if value.cast::<PyArrayDyn<f32>>().is_ok() {
            return value.extract().map(Self);
        }
        let given = value
            .py()
            .import("numpy")?
            .call_method1("asarray", (value,))?;
        let found = match given.cast::<PyUntypedArray>()?.dtype().kind() {
            _ if value.is_none() => "None",
            b'c' => "complex numbers",
            b'O' => "objects",
            b'S' | b'U' => "text",
            b'M' | b'm' => "times",
            _ => return given.extract().map(Self),
        };
        Err(PyTypeError::new_err(format!(
            "expected real numbers, found {found}"
        )))
    }
}

/// The numbers in a value, in whose errors it has a name.
///
/// # Errors
/// What is no number, or no array.
pub fn like<'py>(what: &str, value: &Bound<'py, PyAny>) -> PyResult<Like<'py>> {
    let py = value.py();
    value.extract().map_err(|e: PyErr| {
        let message = format!("{what}: {}", e.value(py));
        if e.is_instance_of::<PyTypeError>(py) {
            PyTypeError::new_err(message)
        } else if e.is_instance_of::<PyValueError>(py) {
            PyValueError::new_err(message)
        } else {
            e
        }
    })
}

/// The shape of a range as an array: `()`, `(3,)`, `(points, 3)` or `(height, width, channels)`.
pub fn shape(info: &ParamInfo) -> Vec<usize> {
    match info.shape {
        ParamShape::Scalar => Vec::new(),
        ParamShape::Rgb | ParamShape::Vector => vec![3],
        ParamShape::Points { count } => vec![count, 3],
        ParamShape::Texture {
            height,
            width,
            channels,
        } => vec![height, width, channels],
    }
}

/// Values as an array of this shape.
pub fn array<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    values.into_pyarray(py).reshape(shape.to_vec())
}

/// An image as an array of height x width x 3.
pub fn image<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    [width, height]: [usize; 2],
) -> PyResult<Bound<'py, PyArray3<T>>> {
    values.into_pyarray(py).reshape([height, width, 3])
}

/// The values of an array in the order of C.
///
/// # Errors
/// Another shape than the expected one.
pub fn values(what: &str, array: &Like<'_>, expected: &[usize]) -> PyResult<Vec<f32>> {
    check_shape(what, array, expected)?;
    Ok(array.as_array().iter().copied().collect())
}

fn check_shape(what: &str, array: &Like<'_>, expected: &[usize]) -> PyResult<()> {
    if array.shape() == expected {
        return Ok(());
    }
    Err(PyValueError::new_err(format!(
        "{what}: expected an array of shape {}, found {}",
        tuple(expected),
        tuple(array.shape())
    )))
}

/// The values of a range: an array of its shape, or one number for all of them.
///
/// # Errors
/// Another shape.
pub fn range(info: &ParamInfo, array: &Like<'_>) -> PyResult<Vec<f32>> {
    let single = array.as_array().iter().copied().next();
    match single {
        Some(value) if array.shape().is_empty() => Ok(vec![value; info.shape.len()]),
        _ => values(&format!("parameter `{}`", info.name), array, &shape(info)),
    }
}

/// The values of an image, all of them finite.
///
/// # Errors
/// Another size, or a value that is not finite, with its place.
pub fn pixels(what: &str, array: &Like<'_>, [width, height]: [usize; 2]) -> PyResult<Vec<f32>> {
    check_shape(what, array, &[height, width, 3])?;
    finite(what, array)
}

/// The values of a picture, whatever its shape.
///
/// # Errors
/// One that is not finite, with its place.
pub fn finite(what: &str, array: &Like<'_>) -> PyResult<Vec<f32>> {
    let values: Vec<f32> = array.as_array().iter().copied().collect();
    let Some(i) = values.iter().position(|v| !v.is_finite()) else {
        return Ok(values);
    };
    let mut place = Vec::new();
    let mut rest = i;
    for (&length, name) in array.shape().iter().zip(["row", "column", "channel"]).rev() {
        place.push(format!("{name} {}", rest % length));
        rest /= length;
    }
    place.reverse();
    Err(PyValueError::new_err(format!(
        "{what}: expected finite numbers, found {} in {}",
        values[i],
        place.join(", ")
    )))
}

/// A shape as Python writes it.
pub fn tuple(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => {
            let all: Vec<String> = shape.iter().map(ToString::to_string).collect();
            format!("({})", all.join(", "))
        }
    }
}
