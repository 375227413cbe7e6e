//! Trajectories of other simulators, in the layout of the MeshGraphNetRP data set.

use super::Physics;
use crate::io::{ReadOptions, Trajectory};
use crate::scene::{Handles, Mass, Motion, Scene, Side, Start, StartFile, Stiffness, Wind};
use crate::sim::Grid;
use crate::{Error, Result, io};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A recorded trajectory: a folder with `cloth_pos.npy` [frames, vertices, 3] (metres, y up), `handles.npy`
/// [frames, handles, 3], and `meta.json`, which tells of the cloth. `start.npy` [vertices, 3] may hold the first frame with
/// more digits than `cloth_pos.npy`: half of them are enough for a comparison, but not for edges.
#[derive(Clone, Debug)]
pub struct Sequence {
    /// Name of the folder.
    pub name: String,
    folder: PathBuf,
    /// The positions \[m\], y up.
    pub truth: Trajectory,
    side_m: f64,
    areal_mass: f64,
    gravity: [f64; 3],
    wind: Wind,
    /// Vertex numbers of the handles, in the order of `handles.npy`; none for the corners.
    handles: Option<Vec<usize>>,
}

impl Sequence {
    /// Names of the sequences in a folder of them, sorted.
    pub fn names(folder: &Path) -> Result<Vec<String>> {
        let fail = |e| Error::io(folder, "cannot read the folder", e);
        let mut names = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            if path.join("cloth_pos.npy").is_file() {
                names.extend(path.file_name().map(|name| name.to_string_lossy().into_owned()));
            }
        }
        if names.is_empty() {
            let origin = folder.display().to_string();
            return Err(Error::invalid(origin, "sequences", "folders with a cloth_pos.npy", "none"));
        }
        names.sort();
        Ok(names)
    }

    /// Reads sequences of a folder: those that are named, or all of them.
    pub fn load_all(folder: &Path, named: Option<&[String]>) -> Result<Vec<Self>> {
        let known = Self::names(folder)?;
        let load = |name: &String| match known.contains(name) {
            true => Self::load(folder, name),
            false => {
                let origin = folder.display().to_string();
                Err(Error::unknown(origin, "sequence", name, known.iter().map(String::as_str)))
            }
        };
        named.unwrap_or(&known).iter().map(load).collect()
    }

    /// Reads the sequence `name` of a folder of them. Without `meta.json` the cloth is the default scene's, on a square grid,
    /// and a warning says so.
    pub fn load(folder: &Path, name: &str) -> Result<Self> {
        let folder = folder.join(name);
        let meta_path = folder.join("meta.json");
        let meta = if meta_path.is_file() {
            let bytes = io::read_bytes(&meta_path)?;
            let origin = meta_path.display().to_string();
            serde_json::from_slice(&bytes).map_err(|e| Error::invalid(origin, "text", "JSON", e))?
        } else {
            tracing::warn!(
                "{}: not there; the cloth is taken to be the default scene's",
                meta_path.display()
            );
            Value::Null
        };
        let origin = meta_path.display().to_string();
        let number = |key: &str, default: f64| match meta.get(key) {
            None => Ok(default),
            Some(value) => value
                .as_f64()
                .filter(|v| v.is_finite() && *v > 0.0)
                .ok_or_else(|| Error::invalid(&origin, key, "a positive number", value)),
        };
        let vector = |node: Option<&Value>, field: &str, default: [f64; 3]| match node {
            None => Ok(default),
            Some(value) => serde_json::from_value(value.clone())
                .map_err(|_| Error::invalid(&origin, field, "[x, y, z]", value)),
        };
        let default = Scene::default();
        let grid = meta.get("grid").map(|value| {
            let sides: [usize; 2] = serde_json::from_value(value.clone())
                .map_err(|_| Error::invalid(&origin, "grid", "[H, W]", value))?;
            Grid::new(sides[0], sides[1], &origin)
        });
        let options = ReadOptions { grid: grid.transpose()?, fps: number("fps", 60.0)? };
        let truth = Trajectory::read(folder.join("cloth_pos.npy"), &options)?;
        let wind = meta.get("wind");
        let part = |key: &str, default: f64| {
            wind.and_then(|w| w.get(key)).and_then(Value::as_f64).unwrap_or(default)
        };
        Ok(Self {
            name: name.to_owned(),
            truth,
            side_m: number("side_length_m", 1.0)?,
            areal_mass: number("mass_per_area_kg_m2", 0.187)?,
            gravity: vector(meta.get("gravity_m_s2"), "gravity_m_s2", default.gravity)?,
            wind: Wind {
                velocity: vector(wind.and_then(|w| w.get("velocity")), "wind.velocity", [0.0; 3])?,
                density: part("density", default.wind.density),
                drag: part("drag", default.wind.drag),
            },
            handles: handles(meta.get("handle_vertices"), &origin)?,
            folder,
        })
    }

    /// Density and drag of its air, and its frame time \[s\].
    pub fn air_and_frame_time(&self) -> [f64; 3] {
        [self.wind.density, self.wind.drag, 1.0 / self.truth.fps()]
    }

    /// The grid of the truth.
    pub fn grid(&self) -> Grid {
        self.truth.grid()
    }

    /// The scene that repeats it: from its first frame, with its handles, on a grid.
    pub fn scene(&self, grid: Grid, physics: &Physics) -> Result<Scene> {
        let of_truth = self.truth.grid();
        let start =
            StartFile { path: self.folder.join("cloth_pos.npy"), grid: Some(of_truth), transform: None };
        let mut scene = Scene {
            grid: of_truth,
            side_m: Side::Height(self.side_m),
            mass: Mass::Areal(self.areal_mass),
            stiffness: Stiffness::Grid(physics.material),
            gravity: self.gravity,
            wind: Wind {
                density: physics.density.unwrap_or(self.wind.density),
                drag: physics.drag.unwrap_or(self.wind.drag),
                ..self.wind
            },
            frame_time_s: physics.frame_time_s.unwrap_or(1.0 / self.truth.fps()),
            frames: Some(self.truth.frames()),
            start: Start::File(start),
            motion: Motion::File(self.folder.join("handles.npy")),
            origin: self.folder.display().to_string(),
            ..Scene::default()
        };
        if let Some(vertices) = &self.handles {
            scene.handles = Handles::Vertices(vertices.clone());
        }
        scene.regrid(grid)?;
        Ok(scene)
    }
}

/// The vertices of `{"h0": k, "h1": l, ..}` or `[k, l, ..]`, in this order.
fn handles(node: Option<&Value>, origin: &str) -> Result<Option<Vec<usize>>> {
    let Some(node) = node else { return Ok(None) };
    let vertex = |value: &Value| value.as_u64().map(|v| v as usize);
    let vertices: Option<Vec<usize>> = match node {
        Value::Array(values) => values.iter().map(vertex).collect(),
        Value::Object(named) => {
            let of = |k: usize| named.get(&format!("h{k}")).and_then(vertex);
            (0..named.len()).map(of).collect()
        }
        _ => None,
    };
    let expected = r#"vertex numbers, [k, ..] or {"h0": k, ..}"#;
    vertices.map(Some).ok_or_else(|| Error::invalid(origin, "handle_vertices", expected, node))
}
