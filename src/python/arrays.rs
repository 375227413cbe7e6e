//! Arrays and documents on their way in and out.

use numpy::{AllowTypeChange, IntoPyArray, PyArray2, PyArrayLikeDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde_json::Value;

/// Points of an array.
pub(super) struct Points {
    /// The axes before the last, which has length 3.
    pub axes: Vec<usize>,
    pub points: Vec<[f64; 3]>,
}

impl Points {
    /// Takes whatever NumPy makes an array of numbers of, with a last axis of length 3.
    pub fn take(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = array.extract().map_err(|error| {
            PyValueError::new_err(format!("{name}: expected an array of numbers [.., 3]: {error}"))
        })?;
        let view = array.as_array();
        let [axes @ .., 3] = view.shape() else {
            let found = format!("{:?}", view.shape());
            return Err(PyValueError::new_err(format!("{name}: expected an array [.., 3], found {found}")));
        };
        // An empty list of handles is an array [0].
        let flat: Vec<f64> = view.iter().copied().collect();
        let points = flat.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        Ok(Self { axes: axes.to_vec(), points })
    }

    /// Takes an array as [`Points::take`], of no points where there is nothing in it.
    pub fn take_or_none(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        match array.len() {
            Ok(0) => Ok(Self { axes: vec![0], points: Vec::new() }),
            _ => Self::take(array, name),
        }
    }

    /// Returns the points of an array whose axes before the last are `shape`, or the last ones of it, along which it is
    /// repeated.
    pub fn broadcast(self, shape: &[usize], name: &str) -> PyResult<Vec<[f64; 3]>> {
        let count = shape.iter().product();
        let fits = shape.ends_with(&self.axes) && !self.points.is_empty();
        if !fits {
            let axes = |axes: &[usize]| {
                axes.iter().map(|n| format!("{n}, ")).chain(["3".into()]).collect::<String>()
            };
            let (expected, found) = (axes(shape), axes(&self.axes));
            return Err(PyValueError::new_err(format!(
                "{name}: expected an array [{expected}], or of its last axes, found [{found}]"
            )));
        }
        Ok(self.points.iter().copied().cycle().take(count).collect())
    }
}

/// Takes an array of numbers [rows, N].
pub(super) fn take_rows<const N: usize>(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[f64; N]>> {
    let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = array.extract().map_err(|error| {
        PyValueError::new_err(format!("{name}: expected an array of numbers [{name}, {N}]: {error}"))
    })?;
    let view = array.as_array();
    let shape = view.shape();
    if !matches!(shape, [_, columns] if *columns == N) && shape != [0] {
        return Err(PyValueError::new_err(format!(
            "{name}: expected an array [{name}, {N}], found {shape:?}"
        )));
    }
    let flat: Vec<f64> = view.iter().copied().collect();
    Ok(flat.as_chunks::<N>().0.to_vec())
}

/// Returns points as an array [points, 3], without copying them.
pub(super) fn points_array<'py>(
    py: Python<'py>,
    points: Vec<[f64; 3]>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = points.len();
    let array = ndarray::Array2::from_shape_vec((rows, 3), points.into_flattened());
    Ok(array.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
}

/// Converts a document to dicts, lists and numbers.
pub(super) fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.to_string(),))
}

/// Converts dicts, lists, numbers, arrays and paths to the text of a JSON document.
pub(super) fn to_json(value: &Bound<'_, PyAny>) -> PyResult<String> {
    let py = value.py();
    let options = pyo3::types::PyDict::new(py);
    options.set_item("default", wrap_pyfunction!(plain, py)?)?;
    py.import("json")?.call_method("dumps", (value,), Some(&options))?.extract()
}

/// Returns an array as lists and a path as text, for `json.dumps`.
#[pyfunction]
fn plain<'py>(value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    match value.hasattr("tolist")? {
        true => value.call_method0("tolist"),
        false => value.py().import("os")?.call_method1("fspath", (value,)),
    }
}
