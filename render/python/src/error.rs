//! Errors of the crates as exceptions, with their messages.

use std::io::ErrorKind;

use optim::OptimError;
use pyo3::PyErr;
use pyo3::exceptions::{
    PyFileNotFoundError, PyKeyError, PyOSError, PyPermissionError, PyValueError,
};
use render::{RenderError, SceneError};

/// What a computation can fail with.
#[derive(Debug)]
pub enum Error {
    Scene(SceneError),
    Render(RenderError),
    Optim(OptimError),
}

impl From<SceneError> for Error {
    fn from(e: SceneError) -> Self {
        Self::Scene(e)
    }
}

impl From<RenderError> for Error {
    fn from(e: RenderError) -> Self {
        Self::Render(e)
    }
}

impl From<OptimError> for Error {
    fn from(e: OptimError) -> Self {
        Self::Optim(e)
    }
}

/// `OSError` and its kin for files, `KeyError` for names of parameters, `ValueError` for everything else.
impl From<Error> for PyErr {
    fn from(e: Error) -> Self {
        match e {
            Error::Scene(e) => {
                let message = e.to_string();
                match &e {
                    SceneError::Io { source, .. } | SceneError::Write { source, .. } => {
                        match source.kind() {
                            ErrorKind::NotFound => PyFileNotFoundError::new_err(message),
                            ErrorKind::PermissionDenied => PyPermissionError::new_err(message),
                            _ => PyOSError::new_err(message),
                        }
                    }
                    _ => PyValueError::new_err(message),
                }
            }
            Error::Render(RenderError::UnknownParameter { name, closest }) => {
                let closest = closest.join(", ");
                PyKeyError::new_err(format!(
                    "no parameter `{name}`; closest: {closest}; `scene.keys()` lists all, and `scene.movables()` what is one after \
                     `scene.make_movable`"
                ))
            }
            Error::Render(e) => PyValueError::new_err(e.to_string()),
            Error::Optim(e) => PyValueError::new_err(e.to_string()),
        }
    }
}
