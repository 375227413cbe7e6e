//! The class `Scene`.

use super::arrays::{to_json, to_python};
use super::errors::raised;
use crate::bindings::{change_scene, find_scene};
use crate::scene::{Scene, named_scenes};
use crate::{Error, cloth::Grid};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use std::path::{Path, PathBuf};

/// A grid as Python gives it: N, or (H, W).
#[derive(FromPyObject)]
pub(super) enum GridArgument {
    Square(usize),
    Sides([usize; 2]),
}

impl GridArgument {
    pub fn sides(&self) -> [usize; 2] {
        match *self {
            Self::Square(n) => [n, n],
            Self::Sides(sides) => sides,
        }
    }

    /// Returns the grid. Fails if it is too small or too large.
    pub fn grid(&self) -> PyResult<Grid> {
        let [h, w] = self.sides();
        Grid::new(h, w, "grid").map_err(raised)
    }
}

/// A cloth, the forces on it and the motion of its handles, in SI units and the scene's axes. Never changes.
///
/// `Scene()` is the default one: a sheet of 1 m that hangs from two corners, which move.
#[pyclass(name = "Scene", module = "fnopt", frozen)]
pub(super) struct PyScene {
    pub scene: Scene,
}

#[pymethods]
impl PyScene {
    #[new]
    fn new() -> Self {
        Self { scene: Scene::default() }
    }

    /// Reads a scene file, or returns the scene of this name that comes with the library.
    #[staticmethod]
    #[pyo3(signature = (path, *, grid = None, frames = None))]
    fn from_file(path: PathBuf, grid: Option<GridArgument>, frames: Option<usize>) -> PyResult<Self> {
        let mut scene = find_scene(&path).map_err(raised)?;
        change_scene(&mut scene, grid.map(|grid| grid.sides()), frames).map_err(raised)?;
        Ok(Self { scene })
    }

    /// Reads a scene from a dict with the fields of scene files; arrays and paths may stand for lists and text. Relative
    /// paths in it are those of `folder`, or else of the current folder.
    #[staticmethod]
    #[pyo3(signature = (fields, folder = None))]
    fn from_dict(fields: &Bound<'_, PyDict>, folder: Option<PathBuf>) -> PyResult<Self> {
        parse(fields, folder.as_deref(), "Scene.from_dict").map(|scene| Self { scene })
    }

    /// The scenes that come with the library: their names, each with what happens in it.
    #[staticmethod]
    fn names(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
        let all = PyDict::new(py);
        named_scenes().iter().try_for_each(|scene| all.set_item(scene.name, scene.description))?;
        Ok(all)
    }

    /// Returns a copy with other values of these fields, which are those of scene files. `grid` moves the scene to another
    /// grid, with its handles and its start; fewer `frames` are a part of it.
    #[pyo3(signature = (**fields))]
    fn replace(&self, fields: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut scene = self.scene.clone();
        let Some(fields) = fields else { return Ok(Self { scene }) };
        let fields = fields.copy()?;
        let taken = |name: &str| -> PyResult<Option<Bound<'_, PyAny>>> {
            let value = fields.get_item(name)?.filter(|value| !value.is_none());
            if value.is_some() {
                fields.del_item(name)?;
            }
            Ok(value)
        };
        let grid = taken("grid")?.map(|grid| grid.extract::<GridArgument>()).transpose()?;
        let frames = taken("frames")?.map(|frames| frames.extract()).transpose()?;
        change_scene(&mut scene, grid.map(|grid| grid.sides()), frames).map_err(raised)?;
        if !fields.is_empty() {
            let all = to_python(fields.py(), &scene.to_json())?.cast_into::<PyDict>()?;
            // One of both says what the sheet weighs.
            for [mass, other] in [["mass_kg", "areal_mass_kg_m2"], ["areal_mass_kg_m2", "mass_kg"]] {
                if fields.contains(mass)? && all.contains(other)? {
                    all.del_item(other)?;
                }
            }
            all.update(fields.as_mapping())?;
            scene = parse(&all, None, &scene.origin)?;
        }
        Ok(Self { scene })
    }

    /// The scene as a dict with the fields of scene files.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.scene.to_json())
    }

    /// Particles along the height and the width.
    #[getter]
    fn grid(&self) -> (usize, usize) {
        (self.scene.grid.h, self.scene.grid.w)
    }

    /// Number of frames, including the start; None for the length of the motion.
    #[getter]
    fn frames(&self) -> Option<usize> {
        self.scene.frames
    }

    /// Duration of a frame [s].
    #[getter]
    fn frame_dt(&self) -> f64 {
        self.scene.frame_time_s
    }

    /// Where it comes from, for error messages.
    #[getter]
    fn origin(&self) -> &str {
        &self.scene.origin
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyAny>,))> {
        // For other processes and copies.
        Ok((py.get_type::<Self>().getattr("from_dict")?, (self.to_dict(py)?,)))
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        // Whatever they are called.
        other.cast::<Self>().is_ok_and(|other| {
            let other = &other.get().scene;
            self.scene == Scene { origin: self.scene.origin.clone(), ..other.clone() }
        })
    }

    fn __repr__(&self) -> String {
        format!("<fnopt.Scene {}, {} particles>", self.scene.origin, self.scene.grid)
    }
}

/// Parses a dict.
fn parse(fields: &Bound<'_, PyDict>, folder: Option<&Path>, origin: &str) -> PyResult<Scene> {
    let folder = folder.unwrap_or(Path::new("."));
    let folder = std::path::absolute(folder).map_err(|e| raised(Error::io(folder, "cannot find", e)))?;
    Scene::parse(&to_json(fields)?, origin, &folder).map_err(raised)
}

/// Returns the scene that an argument stands for: a Scene, a dict, the path of a file or a name.
pub(super) fn scene_of(argument: &Bound<'_, PyAny>) -> PyResult<Scene> {
    if let Ok(scene) = argument.cast::<PyScene>() {
        return Ok(scene.get().scene.clone());
    }
    if let Ok(fields) = argument.cast::<PyDict>() {
        return parse(fields, None, "scene");
    }
    if argument.cast::<PyString>().is_ok() || argument.hasattr("__fspath__")? {
        return find_scene(&argument.extract::<PathBuf>()?).map_err(raised);
    }
    let found = argument.get_type();
    Err(PyTypeError::new_err(format!("scene: expected a Scene, a dict, a path or a name, found {found}")))
}
