//! The class `Simulation`.

use super::arrays::{Points, points_array, take_rows, to_python};
use super::errors::raised;
use super::scene::scene_of;
use crate::bindings::Settings;
use crate::eval::FrameReport;
use crate::scene::{BodyPose, Scene};
use crate::{Prescribed, Simulation, Snapshot};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyList, PyTuple};
use std::path::PathBuf;

/// What to prescribe in a step, in SI units and the scene's axes. What is None is as in the scene.
#[pyclass(name = "Control", module = "fnopt", get_all, set_all)]
pub(super) struct PyControl {
    /// Targets of the handles [m], [handles, 3]: all of cloth 0, then of cloth 1, and so on.
    handles: Option<Py<PyAny>>,
    /// Wind velocity [m/s], [3] or [cloths, 3].
    wind: Option<Py<PyAny>>,
    /// Accelerations [m/s^2] in addition to gravity and air, [3], [particles, 3] or [cloths, particles, 3].
    accelerations: Option<Py<PyAny>>,
    /// Where the bodies are at the end of the frame, [bodies, 7]: position [m] and quaternion (x, y, z, w), all of cloth 0, then of
    /// cloth 1, and so on. They move there from where the frame before left them, and what is attached to them goes along.
    bodies: Option<Py<PyAny>>,
}

#[pymethods]
impl PyControl {
    #[new]
    #[pyo3(signature = (handles = None, wind = None, accelerations = None, bodies = None))]
    fn new(
        handles: Option<Py<PyAny>>,
        wind: Option<Py<PyAny>>,
        accelerations: Option<Py<PyAny>>,
        bodies: Option<Py<PyAny>>,
    ) -> Self {
        Self { handles, wind, accelerations, bodies }
    }
}

/// A simulation at one of its frames, from which it goes on to the same bits.
#[pyclass(name = "Snapshot", module = "fnopt", frozen)]
pub(super) struct PySnapshot(Snapshot);

/// One cloth or a batch of cloths on one grid, advancing frame by frame.
///
/// Arrays are float32, [cloths, particles, 3], in metres and the axes of each scene; particle (i, j) has number i W + j.
#[pyclass(name = "Simulation", module = "fnopt")]
pub(super) struct PySimulation {
    simulation: Simulation,
}

#[pymethods]
impl PySimulation {
    #[new]
    #[pyo3(signature = (scene, solver = "fnopt", iterations = None, device = "auto", adapter = None, cloths = 1, *,
        checkpoint = None, precision = "f32"))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        scene: &Bound<'_, PyAny>,
        solver: &str,
        iterations: Option<usize>,
        device: &str,
        adapter: Option<String>,
        cloths: usize,
        checkpoint: Option<PathBuf>,
        precision: &str,
    ) -> PyResult<Self> {
        let several = scene.cast::<PyList>().is_ok() || scene.cast::<PyTuple>().is_ok();
        let scenes: Vec<Scene> = match several {
            true => scene.try_iter()?.map(|scene| scene_of(&scene?)).collect::<PyResult<_>>()?,
            false => vec![scene_of(scene)?],
        };
        let settings = Settings {
            solver: solver.into(),
            iterations,
            checkpoint,
            device: device.into(),
            adapter,
            precision: precision.into(),
        };
        let simulation = py.detach(|| settings.simulation(&scenes.iter().collect::<Vec<_>>(), cloths));
        Ok(Self { simulation: simulation.map_err(raised)? })
    }

    /// Computes the next frame as the scene has it, events among it, but for what `control` prescribes. After the last frame
    /// of the scene, handles and bodies stay where they are.
    #[pyo3(signature = (control = None))]
    fn step(&mut self, py: Python<'_>, control: Option<&PyControl>) -> PyResult<()> {
        let given = match control {
            Some(control) => self.given(py, control)?,
            None => Prescribed::default(),
        };
        py.detach(|| self.simulation.step_with(&given).map(|_| ())).map_err(raised)
    }

    /// What the scene prescribes in the next step, as a start for a control of one's own.
    fn control(&mut self, py: Python<'_>) -> PyResult<PyControl> {
        let control = self.simulation.prescribed().map_err(raised)?;
        let array = |points: Option<Vec<[f64; 3]>>| {
            points.map(|points| Ok::<_, PyErr>(points_array(py, points)?.into_any().unbind())).transpose()
        };
        let bodies = control.bodies.map(|poses| Ok::<_, PyErr>(poses_array(py, poses)?.into_any().unbind()));
        Ok(PyControl {
            handles: array(control.handles)?,
            wind: array(control.wind)?,
            accelerations: None,
            bodies: bodies.transpose()?,
        })
    }

    /// Where the bodies are at the end of the last frame, [bodies, 7]: position [m] and quaternion (x, y, z, w), all of cloth 0, then of
    /// cloth 1, and so on.
    #[getter]
    fn bodies<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        poses_array(py, self.simulation.bodies())
    }

    /// Positions [m]. Each access makes a new array, which stays as it is.
    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        self.array(py, |out| self.simulation.write_positions(out))
    }

    /// Velocities [m/s]. Each access makes a new array, which stays as it is.
    #[getter]
    fn velocities<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        self.array(py, |out| self.simulation.write_velocities(out))
    }

    /// Triangles of a cloth, [triangles, 3].
    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        rows(py, self.simulation.faces())
    }

    /// Texture coordinates of a cloth, [particles, 2].
    #[getter]
    fn uv<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        rows(py, self.simulation.setups()[0].model.grid.texture_coordinates())
    }

    /// Particles that are held now, an array for each cloth.
    #[getter]
    fn handles<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyArray1<usize>>> {
        self.simulation.cloths().iter().map(|cloth| cloth.handles.clone().into_pyarray(py)).collect()
    }

    /// Number of the last frame; the start is 0.
    #[getter]
    fn frame(&self) -> usize {
        self.simulation.frame().index
    }

    /// Number of frames of the scene, including the start.
    #[getter]
    fn frames(&self) -> usize {
        self.simulation.frames()
    }

    /// Time since the start [s].
    #[getter]
    fn time(&self) -> f64 {
        self.frame() as f64 * self.frame_dt()
    }

    /// Duration of a frame [s].
    #[getter]
    fn frame_dt(&self) -> f64 {
        self.simulation.setups()[0].units.frame_time_s
    }

    /// Particles along the height and the width.
    #[getter]
    fn grid(&self) -> (usize, usize) {
        let grid = self.simulation.setups()[0].model.grid;
        (grid.h, grid.w)
    }

    /// Number of cloths.
    #[getter]
    fn cloths(&self) -> usize {
        self.simulation.setups().len()
    }

    /// Number of particles of a cloth.
    #[getter]
    fn particle_count(&self) -> usize {
        self.simulation.particles()
    }

    /// The device that computes.
    #[getter]
    fn device(&self) -> String {
        self.simulation.device().name()
    }

    /// What each cloth was like in the last frame, with the fields of `per_frame` in a report; empty at the start.
    #[getter]
    fn stats<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let frame = self.simulation.frame();
        let of = |b| {
            to_python(
                py,
                &serde_json::to_value(FrameReport::new(frame, b, &self.simulation.setups()[b]))
                    .unwrap_or_default(),
            )
        };
        (0..frame.stats.len()).map(of).collect()
    }

    /// Replaces positions [m] and velocities [m/s] (0 if left out) of all cloths, or of one: [cloths, particles, 3], or
    /// [particles, 3]. The solver forgets what it remembers of the frames before. Frames are counted on.
    #[pyo3(signature = (positions, velocities = None, *, cloth = None))]
    fn set_state(
        &mut self,
        py: Python<'_>,
        positions: &Bound<'_, PyAny>,
        velocities: Option<&Bound<'_, PyAny>>,
        cloth: Option<usize>,
    ) -> PyResult<()> {
        let n = self.simulation.particles();
        let cloths = cloth.map_or(0..self.cloths(), |b| b..b + 1);
        let shape = if cloth.is_some() { vec![n] } else { vec![self.cloths(), n] };
        let take = |array: &Bound<'_, PyAny>, name: &str| Points::take(array, name)?.broadcast(&shape, name);
        let positions = take(positions, "positions")?;
        let velocities = match velocities {
            Some(velocities) => take(velocities, "velocities")?,
            None => vec![[0.0; 3]; positions.len()],
        };
        let (simulation, first) = (&mut self.simulation, cloths.start);
        py.detach(|| {
            cloths.into_iter().try_for_each(|b| {
                let own = (b - first) * n..(b - first + 1) * n;
                simulation.set_cloth_state(b, &positions[own.clone()], &velocities[own])
            })
        })
        .map_err(raised)
    }

    /// Goes back to the start of the scene.
    fn reset(&mut self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.simulation.reset()).map_err(raised)
    }

    /// The simulation as it is now, for `restore`.
    fn snapshot(&mut self, py: Python<'_>) -> PyResult<PySnapshot> {
        py.detach(|| self.simulation.snapshot()).map(PySnapshot).map_err(raised)
    }

    /// Goes on from a snapshot of this simulation, or of one of the same scenes and solver, to the same bits.
    fn restore(&mut self, py: Python<'_>, snapshot: &PySnapshot) -> PyResult<()> {
        py.detach(|| self.simulation.restore(&snapshot.0)).map_err(raised)
    }

    fn __repr__(&self) -> String {
        let (cloths, grid) = (self.cloths(), self.simulation.setups()[0].model.grid);
        let plural = if cloths == 1 { "" } else { "s" };
        format!("<fnopt.Simulation, {cloths} cloth{plural} of {grid}, frame {}>", self.frame())
    }
}

impl PySimulation {
    /// Takes a control.
    fn given(&self, py: Python<'_>, control: &PyControl) -> PyResult<Prescribed> {
        let [cloths, n] = [self.cloths(), self.simulation.particles()];
        let take = |array: &Option<Py<PyAny>>, name: &str, shape: &[usize]| {
            let take = |array: &Py<PyAny>| Points::take(array.bind(py), name)?.broadcast(shape, name);
            array.as_ref().map(take).transpose()
        };
        // The simulation knows how many there are by then.
        let handles = |array: &Py<PyAny>| Points::take_or_none(array.bind(py), "handles").map(|h| h.points);
        Ok(Prescribed {
            handles: control.handles.as_ref().map(handles).transpose()?,
            wind: take(&control.wind, "wind", &[cloths])?,
            accelerations: take(&control.accelerations, "accelerations", &[cloths, n])?,
            bodies: control.bodies.as_ref().map(|array| poses(array.bind(py))).transpose()?,
        })
    }

    /// Returns an array [cloths, particles, 3] that `fill` writes.
    fn array<'py>(
        &self,
        py: Python<'py>,
        fill: impl FnOnce(&mut [f32]) + Send,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let shape = (self.cloths(), self.simulation.particles(), 3);
        let mut values = vec![0.0; shape.0 * shape.1 * shape.2];
        py.detach(|| fill(&mut values));
        let array = ndarray::Array3::from_shape_vec(shape, values);
        Ok(array.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
    }
}

/// Returns poses as an array [bodies, 7].
fn poses_array(py: Python<'_>, poses: Vec<BodyPose>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    rows(py, poses.into_iter().map(<[f64; 7]>::from).collect())
}

/// Takes poses from an array [bodies, 7].
fn poses(array: &Bound<'_, PyAny>) -> PyResult<Vec<BodyPose>> {
    Ok(take_rows::<7>(array, "bodies")?.into_iter().map(BodyPose::from).collect())
}

/// Returns rows of numbers as an array.
pub(super) fn rows<'py, T: numpy::Element + Clone, const N: usize>(
    py: Python<'py>,
    rows: Vec<[T; N]>,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let count = rows.len();
    let array = ndarray::Array2::from_shape_vec((count, N), rows.into_flattened());
    Ok(array.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
}
