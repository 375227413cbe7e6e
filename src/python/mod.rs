//! The Python package `fnopt` (docs/python.md): scenes, simulations and rollouts as classes, states as NumPy arrays in SI
//! units. Whatever takes time runs without the interpreter's lock.

mod arrays;
mod errors;
mod log;
mod measures;
mod rollout;
mod scene;
mod simulation;

use crate::bindings;
use crate::gpu::{self, AdapterKind};
use errors::{NonFiniteError, raised};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use rollout::PyRollout;
use scene::PyScene;
use simulation::{PyControl, PySimulation, PySnapshot};

/// The compiled part of the package.
#[pymodule]
fn _fnopt(module: &Bound<'_, PyModule>) -> PyResult<()> {
    log::install();
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("NonFiniteError", module.py().get_type::<NonFiniteError>())?;
    module.add_class::<PyScene>()?;
    module.add_class::<PySimulation>()?;
    module.add_class::<PyControl>()?;
    module.add_class::<PySnapshot>()?;
    module.add_class::<PyRollout>()?;
    module.add_function(wrap_pyfunction!(rollout::rollout, module)?)?;
    module.add_function(wrap_pyfunction!(solvers, module)?)?;
    module.add_function(wrap_pyfunction!(adapters, module)?)?;
    module.add_function(wrap_pyfunction!(measures::compare, module)?)?;
    module.add_function(wrap_pyfunction!(measures::chamfer, module)?)?;
    module.add_function(wrap_pyfunction!(measures::intersections, module)?)?;
    module.add_function(wrap_pyfunction!(measures::soundness, module)?)
}

/// The solvers by name: their iterations per frame where none are given (None for newton, which iterates until it
/// converges), and the devices that run them.
#[pyfunction]
fn solvers(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let all = PyDict::new(py);
    for optimizer in bindings::solvers().map_err(raised)? {
        let of = PyDict::new(py);
        of.set_item("iterations", (!optimizer.converges()).then(|| optimizer.default_iterations()))?;
        of.set_item("devices", if optimizer.runs_on_gpu() { vec!["cpu", "gpu"] } else { vec!["cpu"] })?;
        all.set_item(optimizer.name(), of)?;
    }
    Ok(all)
}

/// The adapters of this machine, in the order in which `adapter="0"`, "1", .. number them: name, driver, backend, kind
/// ("hardware" or "software"), and why fnopt cannot run on it, or None.
#[pyfunction]
fn adapters(py: Python<'_>) -> PyResult<Bound<'_, PyList>> {
    let all = PyList::empty(py);
    for adapter in py.detach(gpu::adapters) {
        let of = PyDict::new(py);
        of.set_item("name", &adapter.info.name)?;
        of.set_item("driver", format!("{} {}", adapter.info.driver, adapter.info.driver_info).trim())?;
        of.set_item("backend", adapter.info.backend.to_str())?;
        let kind = match adapter.kind() {
            AdapterKind::Hardware => "hardware",
            AdapterKind::Software => "software",
        };
        of.set_item("kind", kind)?;
        of.set_item("unusable", &adapter.unusable)?;
        all.append(of)?;
    }
    Ok(all)
}
