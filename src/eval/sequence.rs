//! Trajectories of other simulators, in the layout of the MeshGraphNetRP data set.

use super::Physics;
use super::flat_mesh::FlatMesh;
use crate::io::{ReadOptions, Trajectory};
use crate::scene::{Handles, Mass, Motion, Placement, Scene, Side, Start, StartFile, Stiffness, Wind};
use crate::sim::Grid;
use crate::{Error, Result, io};
use serde_json::Value;
use std::borrow::Cow;
use std::path::{Path, PathBuf};

/// A recorded trajectory, in a folder:
///
/// - `cloth_pos.npy` [frames, vertices, 3]: the positions \[m\], y up;
/// - `meta.json`, if there is one: what is told of the cloth. Without `grid` in it, and without a mesh, the vertices are
///   those of a square grid;
/// - `mesh.obj`, or the OBJ file that `obj_code` in `meta.json` names, in the folder or beside it, where the vertices are no
///   grid: the mesh at rest, a flat rectangle in two of the axes. `handle_vertices` must then be given;
/// - `handles.npy` [frames, handles, 3], if there is one: where the handles are; else they are where their vertices are;
/// - `start.npy` [vertices, 3], if there is one: the first frame with more digits than in `cloth_pos.npy`. Half of them are
///   enough for a comparison, but not for edges.
#[derive(Clone, Debug)]
pub struct Sequence {
    /// Name of the folder.
    pub name: String,
    folder: PathBuf,
    meta: Meta,
    /// The positions \[m\], y up; those of a mesh carried to a grid.
    pub truth: Trajectory,
    /// The mesh, where the vertices are no grid, and its positions.
    mesh: Option<(FlatMesh, Trajectory)>,
    /// On the grid of the truth.
    handles: Handles,
    motion: Motion,
}

/// What `meta.json` tells.
#[derive(Clone, Debug)]
struct Meta {
    origin: String,
    fps: f64,
    grid: Option<Grid>,
    /// Name of the OBJ file of the mesh, without its ending.
    obj_code: Option<String>,
    side_m: Option<f64>,
    areal_mass: f64,
    gravity: [f64; 3],
    wind: Wind,
    /// Vertex numbers of the handles, in the order of `handles.npy`.
    handle_vertices: Option<Vec<usize>>,
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
        let meta = Meta::read(folder.join("meta.json"))?;
        let path = folder.join("cloth_pos.npy");
        let (truth, mesh, handles) = match meta.mesh_file(&folder) {
            None => {
                let truth = Trajectory::read(&path, &ReadOptions { grid: meta.grid, fps: meta.fps })?;
                let handles = match &meta.handle_vertices {
                    Some(vertices) => Handles::Vertices(vertices.clone()),
                    None => Handles::Placement(Placement::Corners),
                };
                (truth, None, handles)
            }
            Some(obj) => {
                let recorded = Trajectory::read_vertices(&path, meta.fps)?;
                let vertices = meta.handle_vertices.as_deref().ok_or_else(|| {
                    Error::invalid(
                        &meta.origin,
                        "handle_vertices",
                        "vertex numbers, as there is a mesh",
                        "none",
                    )
                })?;
                let mesh = FlatMesh::read(&obj, recorded.grid().particles(), vertices)?;
                let grid = mesh.grid();
                let carrier = mesh.carrier(grid)?;
                let mut truth = Trajectory::new(grid, meta.fps);
                for frame in 0..recorded.frames() {
                    let positions = carrier.apply(recorded.frame(frame));
                    let positions: Vec<_> = positions.into_iter().map(|p| p.map(|c| c as f32)).collect();
                    truth.push(&positions, &vec![[0.0; 3]; positions.len()]);
                }
                let handles = Handles::Cells(vertices.iter().map(|&v| mesh.cell(grid, v)).collect());
                (truth, Some((mesh, recorded)), handles)
            }
        };
        let recorded = mesh.as_ref().map_or(&truth, |(_, recorded)| recorded);
        let file = folder.join("handles.npy");
        let motion = match (&meta.handle_vertices, file.is_file()) {
            (_, true) => Motion::File(file),
            (Some(vertices), false) => Motion::Rows(rows(recorded, vertices, &meta.origin)?),
            (None, false) => {
                Motion::Rows(rows(recorded, &handles.on(truth.grid(), &meta.origin)?, &meta.origin)?)
            }
        };
        Ok(Self { name: name.to_owned(), folder, meta, truth, mesh, handles, motion })
    }

    /// Density and drag of its air, and its frame time \[s\].
    pub fn air_and_frame_time(&self) -> [f64; 3] {
        [self.meta.wind.density, self.meta.wind.drag, 1.0 / self.truth.fps()]
    }

    /// The grid of the truth.
    pub fn grid(&self) -> Grid {
        self.truth.grid()
    }

    /// The triangles of the cloth, and its vertices in a frame \[m\]: those of the mesh where there is one.
    pub fn surface(&self, frame: usize) -> (Vec<[f64; 3]>, Cow<'_, [[u32; 3]]>) {
        let (recorded, faces) = match &self.mesh {
            Some((mesh, recorded)) => (recorded, Cow::Borrowed(&mesh.faces[..])),
            None => (&self.truth, Cow::Owned(self.truth.grid().faces())),
        };
        (recorded.frame(frame).iter().map(|p| p.map(f64::from)).collect(), faces)
    }

    /// Where the cloth starts on a grid. A mesh is carried to the grid at once, except to one that is finer than the truth's:
    /// the triangles would leave creases in it.
    fn start(&self, grid: Grid) -> Result<Start> {
        let own = self.truth.grid();
        if let Some((mesh, recorded)) = &self.mesh {
            let grid = if grid.particles() <= own.particles() { grid } else { own };
            return Ok(Start::Vertices(grid, mesh.carrier(grid)?.apply(recorded.frame(0))));
        }
        let files = ["start.npy", "cloth_pos.npy"].map(|file| self.folder.join(file));
        let [precise, all] = files;
        let path = if precise.is_file() { precise } else { all };
        Ok(Start::File(StartFile { path, grid: Some(own), transform: None }))
    }

    /// The scene that repeats it: from its first frame, with its handles, on a grid.
    pub fn scene(&self, grid: Grid, physics: &Physics) -> Result<Scene> {
        let Meta { wind, side_m, areal_mass, gravity, .. } = self.meta;
        let side_m = side_m.or(self.mesh.as_ref().map(|(mesh, _)| mesh.sides[0]));
        let mut scene = Scene {
            grid: self.truth.grid(),
            side_m: Side::Height(side_m.unwrap_or(Scene::default().side_m.height())),
            mass: Mass::Areal(areal_mass),
            stiffness: Stiffness::Grid(physics.material),
            gravity,
            wind: Wind {
                density: physics.density.unwrap_or(wind.density),
                drag: physics.drag.unwrap_or(wind.drag),
                ..wind
            },
            frame_time_s: physics.frame_time_s.unwrap_or(1.0 / self.truth.fps()),
            frames: Some(self.truth.frames()),
            start: self.start(grid)?,
            handles: self.handles.clone(),
            motion: self.motion.clone(),
            origin: self.folder.display().to_string(),
            ..Scene::default()
        };
        scene.regrid(grid)?;
        Ok(scene)
    }
}

impl Meta {
    /// Reads `meta.json`; what is not told is the default scene's.
    fn read(path: PathBuf) -> Result<Self> {
        let origin = path.display().to_string();
        let meta = if path.is_file() {
            let bytes = io::read_bytes(&path)?;
            serde_json::from_slice(&bytes).map_err(|e| Error::invalid(&origin, "text", "JSON", e))?
        } else {
            tracing::warn!("{origin}: not there; the cloth is taken to be the default scene's");
            Value::Null
        };
        let number = |key: &str| match meta.get(key) {
            None => Ok(None),
            Some(value) => match value.as_f64().filter(|v| v.is_finite() && *v > 0.0) {
                None => Err(Error::invalid(&origin, key, "a positive number", value)),
                number => Ok(number),
            },
        };
        let vector = |node: Option<&Value>, field: &str, default: [f64; 3]| match node {
            None => Ok(default),
            Some(value) => serde_json::from_value(value.clone())
                .map_err(|_| Error::invalid(&origin, field, "[x, y, z]", value)),
        };
        let grid = meta.get("grid").map(|value| {
            let sides: [usize; 2] = serde_json::from_value(value.clone())
                .map_err(|_| Error::invalid(&origin, "grid", "[H, W]", value))?;
            Grid::new(sides[0], sides[1], &origin)
        });
        let default = Scene::default();
        let wind = meta.get("wind");
        let part = |key: &str, default: f64| {
            wind.and_then(|w| w.get(key)).and_then(Value::as_f64).unwrap_or(default)
        };
        Ok(Self {
            fps: number("fps")?.unwrap_or(60.0),
            grid: grid.transpose()?,
            obj_code: meta.get("obj_code").and_then(Value::as_str).map(str::to_owned),
            side_m: number("side_length_m")?,
            areal_mass: number("mass_per_area_kg_m2")?.unwrap_or(0.187),
            gravity: vector(meta.get("gravity_m_s2"), "gravity_m_s2", default.gravity)?,
            wind: Wind {
                velocity: vector(wind.and_then(|w| w.get("velocity")), "wind.velocity", [0.0; 3])?,
                density: part("density", default.wind.density),
                drag: part("drag", default.wind.drag),
            },
            handle_vertices: handle_vertices(meta.get("handle_vertices"), &origin)?,
            origin,
        })
    }

    /// The mesh of a sequence in `folder`, if its vertices are no grid and there is one.
    fn mesh_file(&self, folder: &Path) -> Option<PathBuf> {
        let named = self.obj_code.iter().map(|code| format!("{code}.obj"));
        let beside = named.flat_map(|name| [folder.join(&name), folder.join("..").join(&name)]);
        let mut files = std::iter::once(folder.join("mesh.obj")).chain(beside);
        files.find(|file| self.grid.is_none() && file.is_file())
    }
}

/// Where some vertices are in each frame.
fn rows(recorded: &Trajectory, vertices: &[usize], origin: &str) -> Result<Vec<Vec<[f64; 3]>>> {
    let count = recorded.grid().particles();
    if let Some(&vertex) = vertices.iter().find(|&&vertex| vertex >= count) {
        return Err(Error::invalid(origin, "handle_vertices", format!("vertices below {count}"), vertex));
    }
    let row = |frame| vertices.iter().map(|&v| recorded.frame(frame)[v].map(f64::from)).collect();
    Ok((0..recorded.frames()).map(row).collect())
}

/// The vertices of `{"h0": k, "h1": l, ..}` or `[k, l, ..]`, in this order.
fn handle_vertices(node: Option<&Value>, origin: &str) -> Result<Option<Vec<usize>>> {
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
