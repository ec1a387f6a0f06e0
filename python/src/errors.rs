//! The engine's errors as Python's exceptions, with the engine's words.

use engine::pipeline::{Error, Exit};
use pyo3::exceptions::{
    PyFileNotFoundError, PyKeyboardInterrupt, PyMemoryError, PyOSError, PyRuntimeError, PyValueError,
};
use pyo3::prelude::*;
use std::error::Error as _;
use std::io;

pyo3::create_exception!(
    qirf_vk,
    DeviceError,
    PyRuntimeError,
    "A device that is missing, unsuitable or lost, or that computes wrong numbers."
);

/// The system's reason behind an error, if there is one.
fn system(error: &Error) -> Option<io::ErrorKind> {
    let mut cause = error.source();
    while let Some(at) = cause {
        if let Some(io) = at.downcast_ref::<io::Error>() {
            return Some(io.kind());
        }
        cause = at.source();
    }
    None
}

/// The exception for an error.
pub fn raised(error: impl Into<Error>) -> PyErr {
    let error = error.into();
    let text = error.to_string();
    match (Exit::of(&error), system(&error)) {
        (Exit::Interrupted, _) => PyKeyboardInterrupt::new_err(text),
        (Exit::Device, _) => DeviceError::new_err(text),
        (_, Some(io::ErrorKind::NotFound)) => PyFileNotFoundError::new_err(text),
        (Exit::Resources, None) => PyMemoryError::new_err(text),
        (_, Some(_)) => PyOSError::new_err(text),
        _ => PyValueError::new_err(text),
    }
}

/// An exception for a value that makes no sense.
pub fn wrong(what: impl Into<String>) -> PyErr {
    PyValueError::new_err(what.into())
}
