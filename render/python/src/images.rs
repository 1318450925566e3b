//! Image files as arrays.

use std::path::PathBuf;

use numpy::{PyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use render::Image;
use render::image_io::{self, Encoding, Pixels};

use crate::arrays::{self, Like, finite, tuple};
use crate::work::{apart, work};

/// Reads a picture as an array of height x width x 3, float32, linear RGB, row 0 at the top: OpenEXR, Radiance, PFM, PNG,
/// JPEG, BMP, TGA, PBM, PGM or PPM, told apart by what is in the file. Files of 8 or 16 bits are decoded from sRGB, unless
/// `raw` says that their numbers are no colours; grey is three times the same, and alpha is left out.
///
/// `layer` names a layer of an OpenEXR file. Without it, this is the unnamed one, `Combined`, `beauty` or `RGBA`, or the only
/// picture in it; where there is none, or several, the error lists them.
#[pyfunction]
#[pyo3(signature = (path, *, layer = None, raw = false))]
pub fn read_image<'py>(
    py: Python<'py>,
    path: PathBuf,
    layer: Option<String>,
    raw: bool,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let encoding = if raw { Encoding::Raw } else { Encoding::Srgb };
    let found = apart(py, move || {
        Ok(image_io::read_layer(&path, encoding, layer.as_deref())?)
    })?;
    let size = [found.width, found.height];
    arrays::image(py, found.into_rgb().data, size)
}

/// Writes an array of height x width x 3, or of height x width for grey, linear: as OpenEXR, every bit of float32, or as PNG for
/// the eye, on the sRGB curve, made brighter by so many `stops` and cut to what that can show. The ending of the name,
/// `.exr` or `.png`, says which.
#[pyfunction]
#[pyo3(signature = (path, image, *, stops = 0.0))]
pub fn write_image(py: Python<'_>, path: PathBuf, image: Like<'_>, stops: f64) -> PyResult<()> {
    let shape = image.shape();
    let (height, width, channels) = match *shape {
        [height, width] => (height, width, 1),
        [height, width, channels @ (1 | 3)] => (height, width, channels),
        _ => {
            return Err(PyValueError::new_err(format!(
                "image: expected an array of shape (height, width, 3) or (height, width), found {}",
                tuple(shape)
            )));
        }
    };
    let pixels = Pixels {
        width,
        height,
        channels,
        data: finite("image", &image)?,
    };
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("exr") if stops != 0.0 => Err(PyValueError::new_err(format!(
            "stops: expected none for an OpenEXR file, which has the numbers as they are, found {stops}"
        ))),
        Some("exr") => work(py, 1, None, |_| {
            Ok(image_io::write_exr_pixels(&path, &pixels)?)
        }),
        Some("png") if !stops.is_finite() => Err(PyValueError::new_err(format!(
            "stops: expected a finite number, found {stops}"
        ))),
        Some("png") => work(py, 1, None, |_| {
            Ok(image_io::write_png(&path, &Image::from(pixels), stops)?)
        }),
        _ => Err(PyValueError::new_err(format!(
            "path: expected a name that ends in `.exr` or `.png`, found `{}`",
            path.display()
        ))),
    }
}
