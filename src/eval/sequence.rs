//! Sequences: recorded trajectories of other simulators, in the layout of the MeshGraphNetRP data set.

use super::Physics;
use super::flat_mesh::FlatMesh;
use crate::cloth::Grid;
use crate::io::{Node, ReadOptions, Trajectory};
use crate::scene::file::read_stiffness;
use crate::scene::{Handles, Mass, Motion, Placement, Scene, Side, Start, StartFile, Stiffness, Wind};
use crate::{Error, Result, io};
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::path::{Path, PathBuf};

/// A recorded trajectory, read from a folder with these files:
///
/// - `cloth_pos.npy` [frames, vertices, 3], the only required file: the positions \[m\], y up;
/// - `meta.json`, optional: a description of the cloth, see below. Without a `grid` in it, and without a
///   mesh, the vertices are those of a square grid;
/// - `mesh.obj`, or the OBJ file that `obj_code` in `meta.json` names, in the folder or next to it, required
///   if the vertices do not form a grid: the mesh at rest, a flat rectangle in two of the axes. It is ignored
///   if `meta.json` has a `grid`, and requires `handle_vertices`;
/// - `handles.npy` [frames, handles, 3], optional: the positions of the handles \[m\], for as many frames as
///   `cloth_pos.npy` has. Without it, the handles follow their vertices;
/// - `start.npy` [vertices, 3], optional, for a grid only: the first frame \[m\], more precise than in
///   `cloth_pos.npy`. Half precision is enough for positions to compare with, but not for the edge lengths of
///   a start.
///
/// `meta.json` is an object. A missing key takes its value from the default scene. Other keys are ignored,
/// but one that looks like a misspelling of a key below is an error.
///
/// | key | value | unit | default |
/// |---|---|---|---|
/// | `fps` | frames per second | 1/s | 60 |
/// | `grid` | `[H, W]`, particles along the height and the width | | square |
/// | `obj_code` | name of the OBJ file of the mesh, without the extension | | `mesh` |
/// | `side_length_m` | length of the side along the height, which is the one between the handles if the sheet hangs from two corners | m | that of the mesh, or 1 |
/// | `mass_per_area_kg_m2` | mass per area | kg/m^2 | 0.187 |
/// | `gravity_m_s2` | `[x, y, z]` | m/s^2 | `[0, -9.8, 0]` |
/// | `wind` | `{"velocity": [x, y, z], "density", "drag"}` | m/s, kg/m^3, N s/m^3 | `[0, 0, 0]`, 1, 0 |
/// | `handle_vertices` | vertex numbers, counted from 0, `[k, ..]` or `{"h0": k, ..}`, in the order of `handles.npy` | | (H-1, 0), (0, 0) |
#[derive(Clone, Debug)]
pub struct Sequence {
    /// Name of the folder.
    pub name: String,
    folder: PathBuf,
    meta: Meta,
    /// The positions \[m\], y up; those of a mesh are resampled to a grid.
    pub truth: Trajectory,
    /// The mesh and its positions, if the vertices do not form a grid.
    mesh: Option<(FlatMesh, Trajectory)>,
    /// The handles, on the grid of the truth.
    handles: Handles,
    motion: Motion,
    checksum: u32,
}

/// The content of `meta.json`.
#[derive(Clone, Debug)]
struct Meta {
    origin: String,
    fps: f64,
    grid: Option<Grid>,
    /// Name of the OBJ file of the mesh, without the extension.
    obj_code: Option<String>,
    side_m: Option<f64>,
    mass: Mass,
    gravity: [f64; 3],
    wind: Wind,
    stiffness: Option<Stiffness>,
    /// Vertex numbers of the handles, in the order of `handles.npy`.
    handle_vertices: Option<Vec<usize>>,
}

/// The keys of `meta.json` that are read, and those of its `wind`.
const FIELDS: [&str; 9] = [
    "material",
    "fps",
    "grid",
    "obj_code",
    "side_length_m",
    "mass_per_area_kg_m2",
    "gravity_m_s2",
    "wind",
    "handle_vertices",
];
const WIND_FIELDS: [&str; 3] = ["velocity", "density", "drag"];

impl Sequence {
    /// Returns the sorted names of the sequences in a folder. Fails if there are none.
    pub fn names(folder: &Path) -> Result<Vec<String>> {
        let sequences = io::entries(folder)?.into_iter().filter(|path| path.join("cloth_pos.npy").is_file());
        let name = |path: PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
        let names: Vec<String> = sequences.filter_map(name).collect();
        if names.is_empty() {
            let origin = folder.display().to_string();
            return Err(Error::invalid(origin, "sequences", "folders with a cloth_pos.npy", "none"));
        }
        Ok(names)
    }

    /// Reads the named sequences of a folder, each once, or all of them. Fails if a name is unknown. A
    /// sequence that cannot be read does not affect the others.
    pub fn load_all(folder: &Path, named: Option<&[String]>) -> Result<Vec<Result<Self>>> {
        let known = Self::names(folder)?;
        let named = named.unwrap_or(&known);
        if let Some(unknown) = named.iter().find(|name| !known.contains(name)) {
            let origin = folder.display().to_string();
            return Err(Error::unknown(origin, "sequence", unknown, known.iter().map(String::as_str)));
        }
        let first = |&(k, name): &(usize, &String)| !named[..k].contains(name);
        Ok(named.iter().enumerate().filter(first).map(|(_, name)| Self::load(folder, name)).collect())
    }

    /// Reads the sequence `name` of a folder. Without `meta.json` the cloth is taken to be that of the
    /// default scene, on a square grid, and a warning is logged.
    pub fn load(folder: &Path, name: &str) -> Result<Self> {
        let folder = folder.join(name);
        let meta = Meta::read(folder.join("meta.json"))?;
        let [path, of_handles, of_start] =
            ["cloth_pos.npy", "handles.npy", "start.npy"].map(|file| folder.join(file));
        let obj = meta.mesh_file(&folder);
        let others = [folder.join("meta.json"), of_handles.clone(), of_start];
        let files = others.iter().chain(&obj).filter(|file| file.is_file());
        let checksum = checksum(std::iter::once(&path).chain(files))?;
        let (truth, mesh, handles) = match obj {
            None => {
                let truth = Trajectory::read(
                    &path,
                    &ReadOptions { grid: meta.grid, likely_grid: None, fps: meta.fps },
                )?;
                let handles = match &meta.handle_vertices {
                    Some(vertices) => Handles::Vertices(vertices.clone()),
                    None => Handles::Placement(Placement::Corners),
                };
                handles.on(truth.grid(), &meta.origin)?;
                (truth, None, handles)
            }
            Some(obj) => {
                let recorded = Trajectory::read_vertices(&path, meta.fps)?.finite(&path)?;
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
                let interpolation = mesh.interpolation_to(grid)?;
                let truth = interpolation.trajectory(&recorded, grid);
                let handles = Handles::Cells(vertices.iter().map(|&v| mesh.cell(grid, v)).collect());
                (truth, Some((mesh, recorded)), handles)
            }
        };
        let recorded = mesh.as_ref().map_or(&truth, |(_, recorded)| recorded);
        check(&truth, recorded, &path)?;
        let vertices = match &meta.handle_vertices {
            Some(vertices) => vertices.clone(),
            None => handles.on(truth.grid(), &meta.origin)?,
        };
        let motion = Motion::Rows(match of_handles.is_file() {
            true => handle_rows(&of_handles, truth.frames(), vertices.len())?,
            false => rows(recorded, &vertices, &meta.origin)?,
        });
        Ok(Self { name: name.to_owned(), folder, meta, truth, mesh, handles, motion, checksum })
    }

    /// Returns a checksum of the names and contents of all its files.
    pub fn checksum(&self) -> u32 {
        self.checksum
    }

    /// Returns the length of the side along the height \[m\].
    pub fn side_m(&self) -> f64 {
        let of_mesh = || self.mesh.as_ref().map(|(mesh, _)| mesh.sides[0]);
        self.meta.side_m.or_else(of_mesh).unwrap_or(Scene::default().side_m.height())
    }

    /// Returns the density and drag of the air, and the frame time \[s\].
    pub fn air_and_frame_time(&self) -> [f64; 3] {
        [self.meta.wind.density, self.meta.wind.drag, 1.0 / self.truth.fps()]
    }

    /// Returns the material of its `meta.json`, if it has one.
    pub fn stiffness(&self) -> Option<Stiffness> {
        self.meta.stiffness
    }

    /// Returns the grid of the truth.
    pub fn grid(&self) -> Grid {
        self.truth.grid()
    }

    /// Returns the vertices \[m\] and the triangles of the cloth in a frame: those of the mesh if there is
    /// one.
    pub fn surface(&self, frame: usize) -> (Vec<[f64; 3]>, Cow<'_, [[u32; 3]]>) {
        let (recorded, faces) = match &self.mesh {
            Some((mesh, recorded)) => (recorded, Cow::Borrowed(&mesh.faces[..])),
            None => (&self.truth, Cow::Owned(self.truth.grid().faces())),
        };
        (recorded.frame(frame).iter().map(|p| p.map(f64::from)).collect(), faces)
    }

    /// Reads another system's trajectory of the cloth: an npz, npy, pc2 or mdd file or a folder of OBJ files. Its
    /// vertices are those of the mesh if there is one, otherwise those of the grid given by its faces, of the
    /// truth's grid, or of a square grid. Vertices of the mesh are returned as a single row, which
    /// [`Sequence::on_grid`] resamples to a grid. Numbers that are not finite are kept: that system diverged.
    pub fn read_other(&self, path: &Path) -> Result<Trajectory> {
        let fps = self.truth.fps();
        if let Some((_, recorded)) = &self.mesh {
            let found = Trajectory::read_vertices(path, fps)?;
            if found.grid() == recorded.grid() {
                return Ok(found);
            }
        }
        let options = ReadOptions { grid: None, likely_grid: Some(self.grid()), fps };
        Trajectory::read_as_it_is(path, &options)
    }

    /// Returns a trajectory on a grid: unchanged, or resampled to the truth's grid if its vertices are those
    /// of the mesh.
    pub fn on_grid<'a>(&self, found: &'a Trajectory) -> Result<Cow<'a, Trajectory>> {
        match self.mesh_of(found) {
            None => Ok(Cow::Borrowed(found)),
            Some(mesh) => Ok(Cow::Owned(mesh.interpolation_to(self.grid())?.trajectory(found, self.grid()))),
        }
    }

    /// Returns the mesh if the trajectory is a single row of as many vertices.
    pub(super) fn mesh_of(&self, found: &Trajectory) -> Option<&FlatMesh> {
        self.mesh.as_ref().filter(|(_, recorded)| recorded.grid() == found.grid()).map(|(mesh, _)| mesh)
    }

    /// Returns the start state on a grid. A mesh is resampled directly to `grid`, or to the truth's grid if
    /// `grid` is finer than that, because there the triangles of the mesh would leave creases.
    fn start(&self, grid: Grid) -> Result<Start> {
        let own = self.truth.grid();
        if let Some((mesh, recorded)) = &self.mesh {
            let grid = if grid.particles() <= own.particles() { grid } else { own };
            return Ok(Start::Vertices(grid, mesh.interpolation_to(grid)?.apply(recorded.frame(0))));
        }
        let files = ["start.npy", "cloth_pos.npy"].map(|file| self.folder.join(file));
        let [precise, all] = files;
        let path = if precise.is_file() { precise } else { all };
        Ok(Start::File(StartFile { path, grid: Some(own), transform: None }))
    }

    /// Returns the scene that repeats the sequence on a grid: from its first frame, with its handles.
    pub fn scene(&self, grid: Grid, physics: &Physics) -> Result<Scene> {
        self.check_shape(grid)?;
        let Meta { wind, mass, gravity, .. } = self.meta;
        let mut scene = Scene {
            grid: self.truth.grid(),
            side_m: Side::Height(self.side_m()),
            mass,
            gravity,
            wind,
            frame_time_s: 1.0 / self.truth.fps(),
            frames: Some(self.truth.frames()),
            start: self.start(grid)?,
            handles: self.handles.clone(),
            motion: self.motion.clone(),
            origin: self.folder.display().to_string(),
            ..Scene::default()
        };
        physics.apply(&mut scene);
        scene.regrid(grid)?;
        Ok(scene)
    }

    /// Fails if the square cells of `grid` would make the cloth wider or narrower by more than a column.
    fn check_shape(&self, grid: Grid) -> Result<()> {
        let own = self.grid();
        let columns = 1.0 + (grid.h - 1) as f64 * own.aspect();
        if (columns - grid.w as f64).abs() <= 1.0 {
            return Ok(());
        }
        let expected = format!("{}x{:.0}, to match its cloth of {own}", grid.h, columns);
        Err(Error::invalid(self.folder.display().to_string(), "grid to simulate on", expected, grid))
    }
}

impl Meta {
    /// Reads `meta.json`; missing keys take their values from the default scene.
    fn read(path: PathBuf) -> Result<Self> {
        let origin = path.display().to_string();
        let document = if path.is_file() {
            io::parse_json(&origin, &io::read_text(&path)?)?
        } else {
            tracing::warn!("{origin}: not found; using the cloth of the default scene");
            Value::Object(Map::new())
        };
        let node = Node::root(&origin, &document);
        node.no_misspelling(&FIELDS)?;
        let default = Scene::default();
        let wind = match node.get("wind") {
            None => default.wind,
            Some(wind) => {
                wind.no_misspelling(&WIND_FIELDS)?;
                Wind {
                    velocity: wind.get_or("velocity", default.wind.velocity, Node::vector)?,
                    density: wind.get_or("density", default.wind.density, Node::not_negative)?,
                    drag: wind.get_or("drag", default.wind.drag, Node::not_negative)?,
                    gusts: None,
                }
            }
        };
        let grid = |node: &Node| {
            let [h, w] = node.array("[H, W]", Node::count)?;
            Grid::new(h, w, node.origin).map(Some)
        };
        Ok(Self {
            fps: node.get_or("fps", ReadOptions::default().fps, Node::positive)?,
            grid: node.get_or("grid", None, grid)?,
            obj_code: node.get_or("obj_code", None, |n| Ok(Some(n.text()?.to_owned())))?,
            side_m: node.get_or("side_length_m", None, |n| n.positive().map(Some))?,
            mass: node.get_or("mass_per_area_kg_m2", default.mass, |n| n.positive().map(Mass::Areal))?,
            gravity: node.get_or("gravity_m_s2", default.gravity, Node::vector)?,
            wind,
            stiffness: match node.get("material") {
                // A text is a note.
                Some(material) if material.value.is_object() => Some(read_stiffness(&material)?),
                _ => None,
            },
            handle_vertices: node.get_or("handle_vertices", None, |n| handle_vertices(n).map(Some))?,
            origin: origin.clone(),
        })
    }

    /// Returns the mesh file of the sequence in `folder`; `None` if its vertices form a grid or there is no
    /// such file.
    fn mesh_file(&self, folder: &Path) -> Option<PathBuf> {
        let named = self.obj_code.iter().map(|code| format!("{code}.obj"));
        let candidates = named.flat_map(|name| [folder.join(&name), folder.join("..").join(&name)]);
        let mut files = std::iter::once(folder.join("mesh.obj")).chain(candidates);
        files.find(|file| self.grid.is_none() && file.is_file())
    }
}

/// Checks that a recording has at least two frames, a grid of at least one cell, and no frame of zeros only:
/// errors are measured on the triangles of the cloth, and relative to its size.
fn check(truth: &Trajectory, recorded: &Trajectory, path: &Path) -> Result<()> {
    let invalid = |field: &str, expected: &str, found: &dyn std::fmt::Display| {
        Err(Error::invalid(path.display().to_string(), field, expected, found))
    };
    let grid = truth.grid();
    if truth.frames() < 2 {
        return invalid("frames", "at least 2", &truth.frames());
    }
    if grid.h < 2 || grid.w < 2 {
        return invalid("vertices", "those of a grid of at least 2x2", &grid);
    }
    let nowhere = |&frame: &usize| recorded.frame(frame).as_flattened().iter().all(|&v| v == 0.0);
    match (0..recorded.frames()).find(nowhere) {
        Some(frame) => invalid(&format!("frame {frame}"), "positions", &"zeros only"),
        None => Ok(()),
    }
}

/// Returns the positions of some vertices in each frame.
fn rows(recorded: &Trajectory, vertices: &[usize], origin: &str) -> Result<Vec<Vec<[f64; 3]>>> {
    let count = recorded.grid().particles();
    if let Some(&vertex) = vertices.iter().find(|&&vertex| vertex >= count) {
        return Err(Error::invalid(origin, "handle_vertices", format!("vertices below {count}"), vertex));
    }
    let row = |frame| vertices.iter().map(|&v| recorded.frame(frame)[v].map(f64::from)).collect();
    Ok((0..recorded.frames()).map(row).collect())
}

/// Reads the positions of the handles in each frame from a file of shape [`frames`, `handles`, 3].
fn handle_rows(path: &Path, frames: usize, handles: usize) -> Result<Vec<Vec<[f64; 3]>>> {
    let array = io::read_npy(path)?;
    let bad = |field: String, expected: String, found: String| {
        Err(Error::invalid(path.display().to_string(), field, expected, found))
    };
    if array.shape() != [frames, handles, 3] {
        let expected = format!("[{frames}, {handles}, 3]: the frames of cloth_pos.npy, and its handles");
        return bad("shape".into(), expected, format!("{:?}", array.shape()));
    }
    let at = |frame: usize, handle: usize| std::array::from_fn(|c| array[[frame, handle, c]]);
    let rows: Vec<Vec<[f64; 3]>> =
        (0..frames).map(|frame| (0..handles).map(|handle| at(frame, handle)).collect()).collect();
    match rows.iter().position(|row| !row.as_flattened().iter().all(|v| v.is_finite())) {
        None => Ok(rows),
        Some(frame) => bad(format!("frame {frame}"), "finite numbers".into(), format!("{:?}", rows[frame])),
    }
}

/// Reads the vertices of `{"h0": k, "h1": l, ..}` or `[k, l, ..]`, in this order.
fn handle_vertices(node: &Node) -> Result<Vec<usize>> {
    match node.value {
        Value::Array(_) => node.items()?.iter().map(Node::count).collect(),
        Value::Object(named) => {
            let of =
                |k: usize| node.get(&format!("h{k}")).ok_or_else(|| node.invalid(format!("a field h{k}")));
            (0..named.len()).map(|k| of(k)?.count()).collect()
        }
        _ => Err(node.invalid(r#"vertex numbers, [k, ..] or {"h0": k, ..}"#)),
    }
}

/// Returns a checksum of the names and contents of files.
fn checksum<'a>(files: impl Iterator<Item = &'a PathBuf>) -> Result<u32> {
    let mut sum = crc32fast::Hasher::new();
    for file in files {
        let bytes = io::read_bytes(file)?;
        sum.update(file.file_name().unwrap_or_default().as_encoded_bytes());
        sum.update(&(bytes.len() as u64).to_le_bytes());
        sum.update(&bytes);
    }
    Ok(sum.finalize())
}
