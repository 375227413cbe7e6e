//! The library's errors as exceptions, with the same texts.

use crate::Error;
use pyo3::exceptions::{PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

pyo3::create_exception!(
    fnopt,
    NonFiniteError,
    PyRuntimeError,
    "A simulation that became non-finite, in `frame`, cloth `cloth`."
);

/// Returns the exception of an error: ValueError for what is not valid, OSError for files, NonFiniteError, and
/// RuntimeError for devices.
pub(super) fn raised(error: Error) -> PyErr {
    let text = error.to_string();
    match error {
        // With its number, Python chooses FileNotFoundError and the like.
        Error::Io { source, .. } => match source.raw_os_error() {
            Some(number) => PyOSError::new_err((number, text)),
            None => PyOSError::new_err(text),
        },
        Error::Invalid { .. } | Error::Unknown { .. } => PyValueError::new_err(text),
        Error::Device(_) | Error::Lost(_) => PyRuntimeError::new_err(text),
        Error::NonFinite { frame, cloth } => Python::attach(|py| {
            let raised = NonFiniteError::new_err(text);
            let value = raised.value(py);
            let noted = value.setattr("frame", frame).and_then(|()| value.setattr("cloth", cloth));
            noted.err().unwrap_or(raised)
        }),
    }
}
