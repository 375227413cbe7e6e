//! The function `rollout` and what it returns.

use super::arrays::to_python;
use super::errors::raised;
use super::scene::scene_of;
use super::simulation::rows;
use crate::bindings::{Report, Settings, Status, change_scene};
use crate::device::store_pipelines;
use crate::eval::{FrameReport, Soundness};
use crate::io::{Format, Frames, Trajectory, WriteOptions, create_folder, folder_of, write, write_mesh};
use crate::scene::{EmbeddedMesh, Script, UpAxis};
use crate::{Device, Error, Simulator};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How often a rollout looks for Ctrl-C and moves its progress bar.
const BREATH: Duration = Duration::from_millis(100);

/// The frames of a rollout of one cloth. Positions and velocities are views, which cannot be written to.
#[pyclass(name = "Rollout", module = "fnopt", frozen)]
pub(super) struct PyRollout {
    trajectory: Trajectory,
    /// The mesh that the cloth carries along, which files for other programs hold.
    embedding: Option<Arc<EmbeddedMesh>>,
    up: UpAxis,
    report: serde_json::Value,
}

#[pymethods]
impl PyRollout {
    /// Positions [m], float32 [frames, particles, 3].
    #[getter]
    fn positions<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        view(slf, Trajectory::positions)
    }

    /// Velocities [m/s], float32 [frames, particles, 3].
    #[getter]
    fn velocities<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        view(slf, Trajectory::velocities)
    }

    /// Triangles, [triangles, 3].
    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        rows(py, self.trajectory.faces())
    }

    /// Texture coordinates, [particles, 2].
    #[getter]
    fn uv<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        rows(py, self.trajectory.grid().texture_coordinates())
    }

    /// Frames per second [1/s].
    #[getter]
    fn fps(&self) -> f64 {
        self.trajectory.fps()
    }

    /// Particles along the height and the width.
    #[getter]
    fn grid(&self) -> (usize, usize) {
        (self.trajectory.grid().h, self.trajectory.grid().w)
    }

    /// The report, with the fields of the command's `report.json` but for `files` and `intersections`.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.report)
    }

    /// How it ended: "done", "interrupted", "non-finite" or "failed".
    #[getter]
    fn status(&self) -> &str {
        self.report["status"].as_str().unwrap_or_default()
    }

    /// Whether it can be trusted: no edge stretched more than cloth, no frame far from its minimum.
    #[getter]
    fn sound(&self) -> bool {
        self.report["sound"].as_bool().unwrap_or_default()
    }

    /// Writes the frames in a format of the library, that of the ending unless `format` names one, and returns the path:
    /// npz, npy, pc2, mdd, usda and glb make a file, obj and ply a folder of files NAME_obj or NAME_ply. Beside a pc2 or mdd goes
    /// the mesh that it moves, an OBJ.
    ///
    /// fps is the rate that the file names (more play faster), start_frame the number of its first frame (pc2, usda, obj, ply);
    /// half keeps 16 bits of each number (npz, npy), compress deflates (npz).
    #[pyo3(signature = (path, format = None, *, fps = None, start_frame = 0, half = false, compress = false))]
    #[allow(clippy::too_many_arguments)]
    fn save(
        &self,
        py: Python<'_>,
        path: PathBuf,
        format: Option<&str>,
        fps: Option<f64>,
        start_frame: u32,
        half: bool,
        compress: bool,
    ) -> PyResult<PathBuf> {
        let options = WriteOptions { fps, start_frame, z_up: self.up == UpAxis::Z, half, compress };
        py.detach(|| self.write(&path, format, &options)).map_err(raised)
    }

    fn __len__(&self) -> usize {
        self.trajectory.frames()
    }

    fn __repr__(&self) -> String {
        let (frames, grid) = (self.trajectory.frames(), self.trajectory.grid());
        format!("<fnopt.Rollout, {frames} frames of {grid}, {}>", self.status())
    }
}

impl PyRollout {
    fn write(&self, path: &Path, format: Option<&str>, options: &WriteOptions) -> crate::Result<PathBuf> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().into_owned());
        let (format, name) = match (format, &ending) {
            (None, None) => {
                let expected = "a file name that ends in a format, or a format";
                return Err(Error::invalid("Rollout.save", "format", expected, path.display()));
            }
            (Some(format), _) => {
                let format: Format = format.parse()?;
                let is_own = ending.is_some_and(|ending| ending.eq_ignore_ascii_case(format.name()));
                (format, if is_own { path.file_stem() } else { path.file_name() })
            }
            (None, Some(ending)) => (ending.parse()?, path.file_stem()),
        };
        if let Some((option, expected)) = options.unheeded(&[format]) {
            return Err(Error::invalid("Rollout.save", option, expected, format));
        }
        let name = name.unwrap_or_default().to_string_lossy();
        if name.is_empty() {
            return Err(Error::invalid("Rollout.save", "path", "the name of a file", path.display()));
        }
        let folder = folder_of(path);
        create_folder(folder)?;
        let embedded = self.embedding.as_ref().map(|mesh| mesh.frames(&self.trajectory));
        let frames: &dyn Frames = match &embedded {
            Some(embedded) if !format.holds_particles() => embedded,
            _ => &self.trajectory,
        };
        if format.is_vertex_cache() {
            write_mesh(frames, folder.join(format!("{name}.obj")))?;
        }
        write(frames, folder, &name, format, options)
    }
}

/// Returns an array of the trajectory of a rollout, without copying it.
fn view<'py>(
    rollout: &Bound<'py, PyRollout>,
    of: impl Fn(&Trajectory) -> ndarray::ArrayView3<'_, f32>,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let array = of(&rollout.get().trajectory);
    // SAFETY: the class is frozen, so nothing moves or changes its trajectory; the array keeps the object alive that owns it,
    // and is made read-only before anyone sees it. NumPy refuses to undo that where the base is no writable buffer.
    #[allow(unsafe_code)]
    let array = unsafe { PyArray3::borrow_from_array(&array, rollout.clone().into_any()) };
    let flags = PyDict::new(rollout.py());
    flags.set_item("write", false)?;
    array.call_method("setflags", (), Some(&flags))?;
    Ok(array)
}

/// Simulates the frames of a scene (a Scene, a dict, a file or a name) and returns them.
///
/// Ctrl-C raises KeyboardInterrupt, a simulation that becomes non-finite NonFiniteError, and a device that fails RuntimeError;
/// the frames until then are in the attribute `rollout` of each. The progress bar needs tqdm.
#[pyfunction]
#[pyo3(signature = (scene, solver = "fnopt", *, iterations = None, frames = None, device = "auto", adapter = None,
    checkpoint = None, precision = "f32", progress = true))]
#[allow(clippy::too_many_arguments)]
pub(super) fn rollout(
    py: Python<'_>,
    scene: &Bound<'_, PyAny>,
    solver: &str,
    iterations: Option<usize>,
    frames: Option<usize>,
    device: &str,
    adapter: Option<String>,
    checkpoint: Option<PathBuf>,
    precision: &str,
    progress: bool,
) -> PyResult<PyRollout> {
    let mut scene = scene_of(scene)?;
    change_scene(&mut scene, None, frames).map_err(raised)?;
    let settings = Settings {
        solver: solver.into(),
        iterations,
        checkpoint,
        device: device.into(),
        adapter,
        precision: precision.into(),
    };
    let optimizer = settings.optimizer().map_err(raised)?;
    let made = py.detach(|| {
        let setup = scene.setup()?;
        let trajectory = setup.trajectory()?;
        settings.check_grid(&optimizer, setup.model.grid)?;
        let (choice, iterations) = (settings.device()?, settings.iterations(&optimizer)?);
        let (simulator, opened) = Simulator::on(&choice, &setup.model, &optimizer, iterations)?;
        store_pipelines();
        Ok((setup, trajectory, simulator, opened.device))
    });
    let (setup, mut trajectory, mut simulator, device): (_, _, _, Device) = made.map_err(raised)?;
    let bar = match progress {
        true => Bar::new(py, setup.frames() - 1),
        false => None,
    };
    let mut soundness = Soundness::new(&setup);
    let mut per_frame = Vec::new();
    // What Python raised on the way: KeyboardInterrupt, as a rule.
    let mut stopped: Option<PyErr> = None;
    let outcome = py.detach(|| {
        simulator.set_state(&setup.start.cast());
        let mut breathed = Instant::now();
        simulator.play(&mut Script::new(&setup), |_, frame| {
            setup.push(&mut trajectory, &frame.state);
            soundness.judge(&frame);
            per_frame.push(FrameReport::new(&frame, 0, &setup));
            if breathed.elapsed() < BREATH {
                return ControlFlow::Continue(());
            }
            breathed = Instant::now();
            let alive = Python::attach(|py| {
                py.check_signals()?;
                bar.as_ref().map_or(Ok(()), |bar| bar.reach(py, frame.index))
            });
            match alive {
                Ok(()) => ControlFlow::Continue(()),
                Err(error) => {
                    stopped = Some(error);
                    ControlFlow::Break(())
                }
            }
        })
    });
    if let Some(bar) = &bar {
        bar.reach(py, trajectory.frames() - 1)?;
        bar.bar.call_method0(py, "close")?;
    }
    let status = match (&outcome, &stopped) {
        (Ok(()), None) => Status::Done,
        (Ok(()), Some(_)) => Status::Interrupted,
        (Err(Error::NonFinite { .. }), _) => Status::NonFinite,
        (Err(_), _) => Status::Failed,
    };
    let report = Report {
        scene: &scene,
        settings: &settings,
        optimizer: &optimizer,
        device: device.name(),
        verdict: soundness.verdict(),
        frames: trajectory.frames(),
        per_frame: &per_frame,
    };
    let report = report.to_json(status);
    let rollout = PyRollout { trajectory, embedding: setup.embedding.clone(), up: setup.up, report };
    let Some(error) = outcome.err().map(raised).or(stopped) else { return Ok(rollout) };
    error.value(py).setattr("rollout", rollout)?;
    Err(error)
}

/// A progress bar of tqdm.
struct Bar {
    bar: Py<PyAny>,
}

impl Bar {
    /// Returns a bar of so many frames, or none if tqdm is not there.
    fn new(py: Python<'_>, frames: usize) -> Option<Self> {
        let options = PyDict::new(py);
        options.set_item("total", frames).and_then(|()| options.set_item("unit", "frame")).ok()?;
        let bar = py.import("tqdm.auto").and_then(|tqdm| tqdm.call_method("tqdm", (), Some(&options)));
        bar.ok().map(|bar| Self { bar: bar.unbind() })
    }

    /// Moves the bar to a frame.
    fn reach(&self, py: Python<'_>, frame: usize) -> PyResult<()> {
        let at: usize = self.bar.getattr(py, "n")?.extract(py)?;
        self.bar.call_method1(py, "update", (frame.saturating_sub(at),)).map(drop)
    }
}
