//! Scenes: the description of a simulation in SI units, and its conversion into a [`Setup`] in grid units.
//!
//! A [`Scene`] is read from a file ([`Scene::load`]) or filled in by hand. Its fields may be changed freely
//! afterwards: [`Scene::setup`] checks everything again, reads the files that the scene names, and converts
//! it to grid units, z up.
//!
//! ```
//! use fnopt::scene::{Motion, Scene};
//! use fnopt::cloth::Grid;
//! use std::path::{Path, PathBuf};
//!
//! let mut scene = Scene::default();
//! scene.regrid(Grid::new(48, 40, "example")?)?;
//! scene.motion = Motion::parse("rot_h0", "example", Path::new(""))?;
//! let setup = scene.setup()?;
//! assert_eq!(setup.frames(), 391);
//! let metres = setup.vertices_m(&setup.start.x);
//! assert_eq!(metres.len(), 48 * 40);
//! # Ok::<(), fnopt::Error>(())
//! ```
//!
//! # The format
//!
//! A scene file is a JSON object. Every field is optional: a field that is missing or null takes its value
//! from the default scene, so `{}` is [`Scene::default`]. Unknown fields are errors, at the top level and in
//! nested objects. Vectors, and positions in files, are in the scene's axes. Paths are relative to the scene
//! file.
//!
//! | field | value | unit | default |
//! |---|---|---|---|
//! | `grid` | `[H, W]`, particles along the height and the width, 8 to 4096 each, or one number for both | | `[32, 32]` |
//! | `side_m` | side along the height, from which the width follows as cells are square; or `[height, width]`, which must make cells square to within 0.1 % | m | `1` |
//! | `mask` | the part of the sheet that the cloth has, see below | | all of it |
//! | `mesh` | the path of an `.obj`, `.glb` or `.gltf`, or `{"file", "object"}`: a mesh with texture coordinates that the cloth carries along, see below | | the grid's own |
//! | `mass_kg` or `areal_mass_kg_m2` | mass of the whole sheet, before it is cut, or mass per area; above 0 | kg or kg/m^2 | areal, that of the fabric, or else `0.187` |
//! | `material` | grid coefficients `{"stretch", "shear", "bend"}`, each optional; or SI moduli `{"stretch_modulus", "shear_modulus", "bending_stiffness"}`, all three required; or `"paper"`, which is `{"stretch": 1000, "shear": 8, "bend": 0.5}`; or the name of a fabric, see below. Stretch and bend may be two numbers, `[along the height, along the width]`: warp and weft | 1; or N/m, N/m, N m | `{"stretch_modulus": 1492.888, "shear_modulus": 44.8333, "bending_stiffness": 0.000752464}` |
//! | `damping_s` | strain-rate damping: how long stretched edges resist a change of their length, the stiffness-proportional (Rayleigh) coefficient of stretch | s | `0` |
//! | `maps` | where the sheet is heavier or stiffer, `{"density", "stiffness"}`, see below | | none |
//! | `rest_shape` | how the sheet is bent where nothing pulls at it, `{"creases", "pleats", "curvature_per_m"}`, see below | | flat |
//! | `gravity` | vector, or its magnitude, which points down whatever its sign | m/s^2 | 9.8 downwards |
//! | `wind` | `{"velocity": [x, y, z], "density", "drag", "gusts"}`; gusts are `{"speed_m_s", "frequency_hz", "seed"}`: a velocity of this root mean square that is added, takes a new direction so often (1 if left out) and is the same for the same seed (0) | m/s, kg/m^3, N s/m^3 | `[0, 0, 0]`, `1`, `0`, none |
//! | `repulsion` | repulsion between the layers of the cloth: `{"strength", "distance"}`, each 1 if left out; `true` for both defaults; or `false` for none | m^2/s^2, edges | `false` |
//! | `self_contact` | contact of the cloth with itself: `{"thickness_m", "friction"}`, those of the cloth if left out; `true` for both; or `false` for none | m | `false` |
//! | `bodies` | bodies that the cloth meets, `[{"shape", ..}, ..]`, see below; 32 at most | | `[]` |
//! | `friction` | the cloth's coefficient of friction; between cloth and body the smaller of both counts | | `1` |
//! | `thickness_m` | distance that the cloth's particles keep from bodies, 0.001 to 10 edges | m | 0.16 edges, and on a ball or capsule of radius R at least `edge^2 / (8 R)` |
//! | `frame_time_s` | duration of a frame | s | `1/60` |
//! | `frames` | number of frames, including the start | | the length of the motion; 391 without a motion |
//! | `start` | `"settled"`, `"flat"`, `"hanging"`, the path of an `.obj`, `.npy` or `.npz`, `{"file", "grid", "transform"}`, or the positions themselves, `{"vertices": [[x, y, z], ..], "grid"}` | m | `"settled"` |
//! | `handles` | the name of a placement, pairs `[[i, j], ..]`, or vertex numbers `[k, ..]` with `k = i W + j` | | `"corners"` |
//! | `attached` | handles that follow bodies, `[{"body", "handles"}, ..]`, see below | | `[]` |
//! | `motion` | a built-in name, `"none"`, the path of a `.npy`, or the positions themselves, `[[[x, y, z], ..], ..]`: one row per frame time with the positions of all handles | m | `"xy_v2"` |
//! | `speed` | factor by which the motion is played faster | | `1` |
//! | `events` | what changes on the way, `[{"frame", ..}, ..]` in the order of time, see below | | `[]` |
//! | `up` | `"y"` or `"z"`, the axis that points up | | `"y"` |
//!
//! **Grid and material.** One rest length l serves both directions: `l = side / (H - 1)`. Grid coefficients
//! are used as given, so a finer grid is a softer cloth. Moduli describe the same cloth on every grid: with
//! areal mass rho and frame time T, `k_stretch = Y T^2 / (2 s rho l^2)`, `k_shear = G T^2 / (8 rho l^2)`,
//! `k_bend = D T^2 / (2 sqrt(s) rho l^4)` with `s = H W / ((H - 1)(W - 1))` ([`Units::material`]).
//!
//! **Fabrics.** `"material": "denim"` is a fabric that was measured ([`fabrics`] lists them): its moduli, and its mass per area
//! if the scene gives no mass of its own. A scene is written with both as numbers. An event that names a fabric changes
//! the stiffness alone, as the mass of a cloth stays.
//!
//! **Mask.** A cloth need not be a rectangle. A `mask` is a region of the sheet, or `{"outline", "holes"}`, a region that is
//! kept (the whole sheet if left out) and a list of those that are cut out of it. A region is `"disc"`, the largest in the
//! middle; `"triangle"`, which hangs from the edge j = 0 with its tip down; `{"circle": [u, v], "radius_m"}`;
//! `{"polygon": [[u, v], ..]}`; or a file, a `.png` whose bright and opaque pixels are kept, or a `.npy` [rows, columns] that
//! is not zero where particles are. (u, v) are texture coordinates, 0 to 1: u to the right and v up on a sheet that hangs from
//! the edge j = 0. The cloth consists of the cells of the grid that lie in the region with all four corners. Without a `start`
//! such a cloth begins `flat`, since it has no settled drape, and its handles must be particles that it has.
//!
//! **Maps.** Each of `maps` is a `.npy` [rows, columns] of factors over the particles' rows and columns, or `{"file": "seams.png",
//! "range": [1, 20]}`, a picture that lies on the sheet as a mask does, with the factors of what is black or transparent and of what
//! is white; between them, and between particles, it is interpolated. Factors are 0.001 to 1000, kept to 0.05 %. `density`
//! multiplies the mass per area; `stiffness` stretch, shear and bend. Such a cloth, too, begins `flat` without a `start`.
//!
//! **Rest shape.** `creases` are lines along which the sheet is folded, `[{"u": 0.25, "angle": 90}, {"v": 0.5, "angle": -60}, ..]`, in
//! texture coordinates and degrees; positive angles turn it towards its front, the side on which its texture is not mirrored. `pleats` are creases
//! that turn one way and the other, `{"count": 8, "angle": 90, "along": "u"}` (u if left out). `curvature_per_m`, `[along the height, along the width]`,
//! curls the sheet to radii of one over that. They bend a cloth as strongly as its own stiffness holds it flat, so a soft one straightens under its
//! weight. Without a `start` it begins `flat` and takes its shape in the first frames. [`crate::cloth::RestAngles`] takes any angles.
//!
//! ```
//! # use fnopt::scene::Scene;
//! let text = r#"{"rest_shape": {"pleats": {"count": 6, "angle": 80}}, "gravity": 0, "motion": "none"}"#;
//! let setup = Scene::parse(text, "fan.json", "".as_ref())?.setup()?;
//! assert!(setup.model.has_rest_angles());
//! # Ok::<(), fnopt::Error>(())
//! ```
//!
//! ```
//! # use fnopt::scene::Scene;
//! let text = r#"{"mask": {"outline": "disc", "holes": [{"circle": [0.5, 0.5], "radius_m": 0.1}]}, "grid": [33, 33],
//!     "handles": [[1, 16]], "motion": "none"}"#;
//! let setup = Scene::parse(text, "ring.json", "".as_ref())?.setup()?;
//! assert!(!setup.model.cloths[0].contains(16 * 33 + 16));
//! # Ok::<(), fnopt::Error>(())
//! ```
//!
//! **Mesh.** A cloth may look like any mesh that lies on the sheet by its texture coordinates, (u, v) as in a mask, in any order
//! and of any polygons. The particles are simulated and carry its vertices along, bilinearly within their cells
//! ([`crate::cloth::Embedding`]); files for other programs then hold that mesh ([`Setup::topology`], [`Setup::points`]). Its
//! positions in the file do not matter. A vertex that lies beyond the mask, by an edge at most, stays at the border of the
//! cloth; along a seam there is a vertex for each side.
//!
//! ```
//! # use fnopt::scene::Scene;
//! # let folder = tempfile::tempdir().unwrap();
//! # let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0.5 1\nf 1/1 2/2 3/3\n";
//! # std::fs::write(folder.path().join("flag.obj"), triangle).unwrap();
//! let setup = Scene::parse(r#"{"mesh": "flag.obj"}"#, "flag.json", folder.path())?.setup()?;
//! assert_eq!(setup.topology().vertices(), 3);
//! let [positions, _] = setup.points(&setup.start.cast());
//! assert_eq!(positions.len(), 3);
//! # Ok::<(), fnopt::Error>(())
//! ```
//!
//! **Repulsion.** Two particles that are not joined by an edge of the triangulated grid repel each other when
//! they are closer than `distance`, which is 0.001 to 1 edges ([`crate::cloth::Repulsion`]). `strength` is an
//! energy per unit mass, so the speed needed to overcome it is the same on every grid. Repulsion acts between
//! particles, not triangles: at a distance below 1, layers slip through the gaps between particles. It also
//! reaches no further than one edge: layers that approach each other by about two edges per frame or more
//! pass through each other undetected.
//!
//! **Self-contact.** Particles meet triangles and edges meet edges when they come nearer than the thickness, which is 0.001 to
//! 0.5 edges ([`crate::cloth::SelfContact`]), whatever their speed. It is the stricter way to keep layers apart.
//!
//! **Bodies.** A body has a `shape`: `plane` (everything below it, with a `normal`), `sphere` (`radius_m`), `capsule`
//! (`radius_m`, `length_m` between the centres of its ends, `axis`), `box` (`sides_m`) or `mesh` (the `file` of an `.obj`, `.glb` or `.gltf`, with an `object` in it, or
//! `vertices` and `faces`, with `unit_m`, the length of its unit, and `cells`, the samples of its distance along its longest
//! side, 8 to 256, 64 if left out). A mesh must be closed; edges finer than a cell are rounded. A body is at `position_m`, rotated by
//! `rotation`, `[degrees, x, y, z]`; in place of a rotation, `normal` and `axis` tell where its up axis points. It has a
//! coefficient of `friction` (0.3 if left out), and a `thickness_m` (0) that is added to the cloth's. `motion` moves it:
//! keys `[{"time_s", "position_m", "rotation"}, ..]`, straight and evenly from one to the next, or the path of a `.npy` with
//! a row for each frame, [frames, 3] for positions or [frames, 7] for positions and quaternions (x, y, z, w). Bodies may
//! be fast: a particle meets what is on its way. They move the cloth and are not moved by it. Particles of the
//! start that are inside a body are moved out. A body that is not `visible` (true if left out) is not there until an event
//! shows it.
//!
//! **Attachment.** Handles in `attached` follow a body as if they were glued to it where they begin, and `motion` moves the
//! others: `"body"` is its number in `bodies`, `"handles"` are numbers of handles in the scene's list, all if left out.
//!
//! **Events.** An event has a `frame`, the first one with the change, from 1 to the last frame, and any of: `release`, handles
//! that are let go, given like `handles`, or `"all"`; `grab`, particles that become handles, likewise, which stay where they
//! are by then or, with a `body`, follow it; `wind`, `gravity` and `material`, as above, from then on; `hide` and `show`,
//! numbers of bodies. An event first releases, then grabs.
//!
//! ```
//! # use fnopt::scene::Scene;
//! // A curtain on a rod that moves, which is let go after a second.
//! let text = r#"{
//!     "start": "hanging", "handles": [[0, 0], [10, 0], [21, 0], [31, 0]], "attached": [{"body": 0}], "motion": "none",
//!     "bodies": [{"shape": "capsule", "radius_m": 0.02, "length_m": 1.2, "axis": [0, 0, 1], "friction": 0.2,
//!         "motion": [{"time_s": 0, "position_m": [0, 0.53, 0]}, {"time_s": 1, "position_m": [1, 0.53, 0]}]}],
//!     "events": [{"frame": 60, "release": "all"}, {"frame": 90, "wind": {"velocity": [0, 0, 3]}}]
//! }"#;
//! let setup = Scene::parse(text, "curtain.json", "".as_ref())?.setup()?;
//! assert_eq!(setup.changes.len(), 2);
//! # Ok::<(), fnopt::Error>(())
//! ```
//!
//! **Start.** The start states:
//!
//! - `settled` hangs still from the corners (H-1, 0) and (0, 0), at (0, 0.5, +-0.45) times the side, y up: in the
//!   equilibrium of the scene's cloth under its gravity, in still air. It is computed when the scene is set up, which
//!   takes up to a second on 64x64 particles; on grids finer than 128x128 it is resampled.
//! - `flat` has particle (i, j) at `(j, i - (H-1)/2, 0)` edges, z up.
//! - `hanging` is a vertical plane whose upper edge, j = 0, is `(0, 0.5, z)` times the side.
//! - An OBJ has vertex `i W + j` for particle (i, j). Its faces, if it has any, cover each cell by two
//!   triangles or one quadrilateral. In another order its faces tell which vertex is which particle, up to turns of the sheet:
//!   its texture coordinates choose among these if it has any, otherwise the side to which its faces turn and the order of
//!   its vertices do.
//! - A `.npy` (`f2`, `f4` or `f8`) has shape [H, W, 3] or [H W, 3], or that of a trajectory,
//!   [frames, H W, 3], whose first frame is used.
//! - A `.npz` as written by a rollout (`rollout.npz`, `replay.npz`) supplies its last frame, with velocities.
//!   The motion restarts from its beginning, and the optimizer starts afresh.
//!
//! `grid` is the grid of the file if it differs from the scene's; the sheet is then resampled. `transform` is
//! applied to the positions in the file: a 4x4 or 3x4 matrix in rows, a translation `[x, y, z]`, or
//! `{"rotate": [degrees, x, y, z], "scale": s, "translate": [x, y, z]}`, applied in this order. Velocities
//! are zero except from a `.npz`.
//!
//! **Handles.** Placements, h0 first: `corners` (H-1, 0), (0, 0); `diagonal` (H-1, W-1), (0, 0); `mid-edge`
//! (H-1, W/2), (0, W/2); `corner-center` (H-1, 0), (H/2, W/2); `single-mid-edge` (H/2, 0); `single-center`
//! (H/2, W/2); `single-corner` (H-1, 0). An empty list gives a free cloth, for which the motion must be
//! `"none"`.
//!
//! **Motion.** Built-in motions rest for 0.5 s, make three moves of 1 s each over 1 m (there, back and there
//! again) with `s(t) = (1 - cos(pi t)) / 2`, and rest for 3 s. They start from the positions of the handles.
//! Each has an opposite, such as `xy_v2_opp`.
//!
//! - Translations, y up: `fwd` (1,0,0), `side` (0,0,1), `updown` (0,1,0), `xy` (1,0,1), `yz` (0,1,1), `xz`
//!   (1,1,0), `xyz` (1,1,1), `xy_v2` (1,0,-1), `yz_v2` (0,1,-1), `xz_v2` (1,-1,0), `xyz_v2` (1,1,-1),
//!   `xyz_v3` (1,-1,1), `xyz_v4` (-1,1,1).
//! - Rotations `rot_h0` and `rot_h1`: the first or second handle is fixed and the others circle the vertical
//!   axis through it, the farthest along an arc of 1 m. A single handle does not move.
//!
//! A recorded motion, a `.npy`, has shape [frames, handles, 3], one row per frame time; row 0 holds the
//! positions of the handles at the start. Frame f samples the motion at `f * speed` frame times: exactly for
//! a built-in motion, by linear interpolation between rows for a recorded one. Past its end, a motion keeps
//! its last position.
//!
//! # Scenes by name
//!
//! Some scenes come with the library. [`Scene::named`] returns one, and [`named_scenes`] lists them all with their scene
//! files, which are a start for files of one's own. On the command line, `fnopt rollout sphere` runs one, `fnopt scenes`
//! lists them and `fnopt scenes sphere` prints a file.
//!
//! ```
//! let scene = fnopt::scene::Scene::named("sphere")?;
//! assert_eq!(scene.bodies.len(), 2);
//! # Ok::<(), fnopt::Error>(())
//! ```
//!
//! # The authors' scene files
//!
//! A document with a field `mesh_..` or `handle_ind_list` is read as a scene of the authors of the method: z
//! up, frame time 1/50 s, gravity 9.76 m/s^2 unless given, the paper's coefficients, no motion. Everything else is as in the default
//! scene.
//!
//! | field | value |
//! |---|---|
//! | `mesh_file` | OBJ, relative to the scene file or, if it is not there, to `dataset_dir`; required |
//! | `mesh_resolution`, or `mesh_resolution_h` and `mesh_resolution_w` | particles per side, required: one number, `[H, W]`, or one field per side. In the authors' code H is `_w` and W is `_h`; if the faces of the mesh fit only the other order, that order is used |
//! | `mesh_size`, or `mesh_size_h` and `mesh_size_w` | sides \[m\], in the same order; default 1. The side along the height sets the scale; the other is ignored |
//! | `transform` | as above; the authors write `{"rotate": [degrees, x, y, z], "translate": [x, y, z]}` |
//! | `gravity` | vector, or its magnitude, which points down whatever its sign [m/s^2] |
//! | `handle_ind_list` | vertex numbers, from the last handle to h0: `[0, 992]` means h0 = 992; default `corners` |
//!
//! Other fields (cameras, pictures, results) are ignored, but one that looks like a misspelling of a field
//! above is an error.

mod authors;
mod bodies;
mod drape;
mod events;
mod fabric;
pub(crate) mod file;
mod gusts;
mod handles;
mod lattice;
mod maps;
mod mask;
mod motion;
mod named;
mod obj;
mod picture;
mod plausible;
mod points;
mod rest_shape;
mod script;
mod setup;
mod start;
mod surface;
mod units;

pub use bodies::{BodyMotion, BodyPose, BodySettings, BodyShape, MeshSource};
pub use events::{Attachment, Event, Release};
pub use fabric::{Fabric, fabrics};
pub use gusts::{Airflow, Gusts};
pub use handles::{Handles, Placement};
pub use maps::{MapFile, MapSettings};
pub use mask::{MaskSettings, Region};
pub use motion::{BuiltIn, Motion};
pub use named::{NamedScene, named_scenes};
pub use rest_shape::{Crease, CreaseLine, RestShape};
pub use script::{Change, Course, Lead, Script, Scripts};
pub use setup::{Batch, EmbeddedMesh, MAX_FRAMES, Setup};
pub use start::{Start, StartFile, Transform};
pub use units::{Moduli, Units, UpAxis};

use crate::cloth::{Grid, Material, Repulsion, SelfContact, Weave};
use crate::io::MeshFile;
use crate::{Error, Result};
use std::path::Path;

/// Gravity of a scene that does not specify it [m/s^2].
const GRAVITY_M_S2: f64 = 9.8;
/// Largest relative deviation of the width from square cells: more than rounding, less than one edge on any
/// grid below 1000.
const SQUARE: f64 = 1e-3;

/// Lengths of the sheet's sides \[m\]. One rest length serves both directions, so cells are square.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Side {
    /// The side along the height; the width follows from the grid.
    Height(f64),
    /// The sides along the height and the width, which must make cells square to within 0.1 %.
    Both([f64; 2]),
}

impl Side {
    /// Returns the side along the height \[m\].
    pub fn height(self) -> f64 {
        match self {
            Side::Height(height) | Side::Both([height, _]) => height,
        }
    }
}

/// Mass of the sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mass {
    /// Mass of the whole sheet \[kg\].
    Total(f64),
    /// Mass per area [kg/m^2].
    Areal(f64),
}

impl Default for Mass {
    fn default() -> Self {
        Mass::Areal(0.187)
    }
}

impl Mass {
    /// Keeps the mass per area when the area is multiplied by `ratio`.
    fn scale_area(&mut self, ratio: f64) {
        if let Mass::Total(kg) = self {
            *kg *= ratio;
        }
    }
}

/// Stiffness of the sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stiffness {
    /// Coefficients of the energy in grid units, used as given: a finer grid or a shorter frame is then a softer cloth.
    Grid(Material),
    /// Moduli in SI units: the same cloth on every grid.
    Moduli(Moduli),
}

impl Stiffness {
    /// The paper's typical coefficients (1000, 8, 0.5), whatever the grid.
    pub fn paper() -> Self {
        Stiffness::Grid(Material::default())
    }

    /// Returns the material called `name`: `paper` ([`Stiffness::paper`]), `default`, or that of a fabric ([`fabrics`]), whose mass
    /// is another matter ([`Scene::set_fabric`]). `origin` is the file or option that the name comes from.
    pub fn named(name: &str, origin: &str) -> Result<Self> {
        match name {
            "paper" => Ok(Self::paper()),
            "default" => Ok(Self::default()),
            _ => match Fabric::known(name) {
                Some(fabric) => Ok(fabric.stiffness()),
                None => {
                    let known = fabrics().iter().map(|fabric| fabric.name);
                    Err(Error::unknown(origin, "material", name, known.chain(["paper", "default"])))
                }
            },
        }
    }
}

impl Default for Stiffness {
    /// Returns the moduli that the paper's typical coefficients give a sheet of 1 m with 32x32 particles.
    fn default() -> Self {
        Stiffness::Moduli(Moduli {
            stretch_modulus: 1492.888,
            shear_modulus: 44.8333,
            bending_stiffness: 0.000752464,
            weave: Weave::EVEN,
        })
    }
}

impl Stiffness {
    /// Returns the coefficients of the energy.
    fn in_grid_units(self, units: &Units, grid: Grid) -> Material {
        match self {
            Stiffness::Grid(material) => material,
            Stiffness::Moduli(moduli) => units.material(grid, moduli),
        }
    }
}

/// The air and its motion.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Wind {
    /// Velocity [m/s] in the scene's axes.
    pub velocity: [f64; 3],
    /// Density [kg/m^3]: resistance to motion along the normal of the sheet. 0 for a vacuum.
    pub density: f64,
    /// Drag [N s/m^3]: resistance to motion in the plane of the sheet.
    pub drag: f64,
    /// How the velocity changes; `None` for a steady wind.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gusts: Option<Gusts>,
}

impl Default for Wind {
    /// Still air of density 1 without drag, as in the reference data.
    fn default() -> Self {
        Self { velocity: [0.0; 3], density: 1.0, drag: 0.0, gusts: None }
    }
}

/// Repulsion that keeps the layers of a cloth apart: particles that come close without sharing an edge repel
/// each other ([`crate::cloth::Repulsion`]).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct RepulsionSettings {
    /// Strength, as an energy per unit mass [m^2/s^2].
    pub strength: f64,
    /// Distance below which particles repel each other \[edges\], 0.001 to 1.
    pub distance: f64,
}

impl RepulsionSettings {
    /// Fails if a number is out of range; `origin` and `field` name its source in the error.
    pub fn check(&self, origin: &str, field: &str) -> Result<()> {
        Repulsion { strength: self.strength, distance: self.distance }.check(origin, field)
    }
}

impl Default for RepulsionSettings {
    /// A strength that stops particles meeting at a few metres per second, and a distance at which layers do
    /// not slip through each other's gaps.
    fn default() -> Self {
        Self { strength: 1.0, distance: 1.0 }
    }
}

/// Contact of the cloth with itself ([`crate::cloth::SelfContact`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct SelfContactSettings {
    /// Distance that layers keep from each other \[m\]; `None` for that of the cloth ([`Scene::thickness_m`]), or half an
    /// edge if that is less.
    pub thickness_m: Option<f64>,
    /// Coefficient of friction between layers; `None` for that of the cloth.
    pub friction: Option<f64>,
}

/// A cloth, the forces on it and the motion of its handles, in SI units and the scene's axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Particles along the height and the width.
    pub grid: Grid,
    /// Side lengths \[m\].
    pub side_m: Side,
    /// The part of the sheet that the cloth has; `None` for all of it.
    pub mask: Option<MaskSettings>,
    /// Where it is heavier or stiffer than elsewhere.
    pub maps: MapSettings,
    /// How it is bent where nothing pulls at it.
    pub rest_shape: RestShape,
    /// An OBJ or glTF file with texture coordinates: the mesh that the cloth carries along ([`RenderMesh`](crate::io::RenderMesh)).
    pub mesh: Option<MeshFile>,
    /// Mass of the sheet.
    pub mass: Mass,
    /// Stiffness of the sheet.
    pub stiffness: Stiffness,
    /// Strain-rate damping of its edges \[s\]: the stiffness-proportional (Rayleigh) coefficient of its stretch.
    pub damping_s: f64,
    /// Gravity [m/s^2].
    pub gravity: [f64; 3],
    /// The air.
    pub wind: Wind,
    /// Repulsion between the layers of the cloth, the cheaper and looser way to keep them apart.
    pub repulsion: Option<RepulsionSettings>,
    /// Contact of the cloth with itself; `None` for a cloth that passes through itself.
    pub self_contact: Option<SelfContactSettings>,
    /// Bodies that the cloth meets.
    pub bodies: Vec<BodySettings>,
    /// Distance that the cloth keeps from bodies \[m\], to which theirs is added; `None` for 0.16 edges.
    pub thickness_m: Option<f64>,
    /// The cloth's coefficient of friction; between cloth and body the smaller of both counts.
    pub friction: f64,
    /// Duration of a frame \[s\].
    pub frame_time_s: f64,
    /// Number of frames, including the start; `None` for the length of the motion.
    pub frames: Option<usize>,
    /// The start state.
    pub start: Start,
    /// The particles whose positions are prescribed.
    pub handles: Handles,
    /// Handles that follow bodies.
    pub attached: Vec<Attachment>,
    /// How the other handles move.
    pub motion: Motion,
    /// Factor by which the motion is played faster; at 2 it takes half the frames.
    pub speed: f64,
    /// What changes on the way, in the order of time.
    pub events: Vec<Event>,
    /// The axis that points up in this scene's vectors and files.
    pub up: UpAxis,
    /// Where the scene comes from, for error messages.
    pub origin: String,
}

impl Default for Scene {
    /// The default scene of the command line: a square of 1 m on a 32x32 grid that moves through `xy_v2`,
    /// starting from its settled drape.
    fn default() -> Self {
        let up = UpAxis::Y;
        Self {
            grid: Grid { h: 32, w: 32 },
            side_m: Side::Height(1.0),
            mask: None,
            maps: MapSettings::default(),
            rest_shape: RestShape::default(),
            damping_s: 0.0,
            mesh: None,
            mass: Mass::default(),
            stiffness: Stiffness::default(),
            gravity: up.down(GRAVITY_M_S2),
            wind: Wind::default(),
            repulsion: None,
            self_contact: None,
            bodies: Vec::new(),
            thickness_m: None,
            friction: 1.0,
            frame_time_s: 1.0 / 60.0,
            frames: None,
            start: Start::default(),
            handles: Handles::Placement(Placement::Corners),
            attached: Vec::new(),
            motion: BuiltIn::named("xy_v2").map_or(Motion::Still, Motion::BuiltIn),
            speed: 1.0,
            events: Vec::new(),
            up,
            origin: "scene".to_owned(),
        }
    }
}

impl Scene {
    /// Returns the default sheet, let go at one of its corners: it moves from the first frame on.
    pub fn released() -> Self {
        Self { handles: Handles::Placement(Placement::Diagonal), motion: Motion::Still, ..Self::default() }
    }

    /// Returns the files that [`Scene::setup`] reads.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let start = match &self.start {
            Start::File(file) => Some(&*file.path),
            _ => None,
        };
        let motion = match &self.motion {
            Motion::File(path) => Some(&**path),
            _ => None,
        };
        let poses = self.bodies.iter().filter_map(|body| match &body.motion {
            BodyMotion::File(path) => Some(&**path),
            _ => None,
        });
        let meshes = self.bodies.iter().filter_map(|body| match &body.shape {
            BodyShape::Mesh { source: MeshSource::File(file), .. } => Some(&*file.path),
            _ => None,
        });
        let masks = self.mask.iter().flat_map(MaskSettings::files).chain(self.maps.files());
        let mesh = self.mesh.as_ref().map(|file| &*file.path);
        start.into_iter().chain(motion).chain(poses).chain(meshes).chain(masks).chain(mesh)
    }

    /// Checks everything that can be checked without reading a file, and returns the units that follow from
    /// it.
    fn check(&self) -> Result<Units> {
        let grid = Grid::new(self.grid.h, self.grid.w, &self.origin)?;
        let height = self.side_m.height();
        self.positive("side_m", height)?;
        let length_m = height / (grid.h - 1) as f64;
        let width = length_m * (grid.w - 1) as f64;
        if let Side::Both([_, given]) = self.side_m {
            self.positive("side_m", given)?;
            if (given - width).abs() > SQUARE * width {
                let fits = |h: usize| {
                    let w = (given / height * (h - 1) as f64).round().clamp(7.0, 4095.0) as usize + 1;
                    let found = Grid { h, w };
                    ((given / height - found.aspect()).abs() <= SQUARE * found.aspect()).then_some(found)
                };
                let fitting = (grid.h..=2 * grid.h).find_map(fits);
                let other = fitting.map_or(String::new(), |grid| format!(", or a {grid} grid"));
                let expected = format!(
                    "a width of {width:.6} m, for square cells on a {grid} grid {height} m high{other}"
                );
                return Err(Error::invalid(&self.origin, "side_m", expected, format!("{given} m")));
            }
        }
        let areal_mass_kg_m2 = match self.mass {
            Mass::Total(kg) => self.positive("mass_kg", kg)? / (height * width),
            Mass::Areal(kg_m2) => kg_m2,
        };
        self.positive("areal_mass_kg_m2", areal_mass_kg_m2)?;
        self.positive("frame_time_s", self.frame_time_s)?;
        if !self.frame_time_s.recip().is_finite() {
            let (expected, found) = ("a time whose reciprocal is finite", self.frame_time_s);
            return Err(Error::invalid(&self.origin, "frame_time_s", expected, format!("{found:e}")));
        }
        self.positive("speed", self.speed)?;
        self.check_stiffness("material", self.stiffness)?;
        self.not_negative("damping_s", self.damping_s)?;
        self.check_wind("wind", &self.wind)?;
        self.finite("gravity", self.gravity)?;
        self.not_negative("friction", self.friction)?;
        self.thickness_m.map_or(Ok(0.0), |thickness| self.positive("thickness_m", thickness))?;
        let of = match &self.start {
            Start::Vertices(of, _) => Some(*of),
            Start::File(file) => file.grid,
            _ => None,
        };
        of.map(|of| Grid::new(of.h, of.w, &format!("{}: start", self.origin))).transpose()?;
        if let Start::Vertices(of, points) = &self.start
            && points.len() != of.particles()
        {
            let expected = format!("{} for the {of} grid", of.particles());
            return Err(Error::invalid(&self.origin, "start.vertices", expected, points.len()));
        }
        if self.frames == Some(0) {
            return Err(Error::invalid(&self.origin, "frames", "1 or more", 0));
        }
        let units = Units { length_m, frame_time_s: self.frame_time_s, areal_mass_kg_m2 };
        if let Some(settings) = self.repulsion {
            settings.check(&self.origin, "repulsion")?;
            units.repulsion(settings).check(&self.origin, "repulsion")?;
        }
        if let Some(settings) = self.self_contact {
            settings
                .thickness_m
                .map_or(Ok(0.0), |thickness| self.positive("self_contact.thickness_m", thickness))?;
            settings
                .friction
                .map_or(Ok(()), |friction| self.not_negative("self_contact.friction", friction))?;
            self.of_layers(&units, settings).check(&self.origin, "self_contact")?;
        }
        Ok(units)
    }

    /// Converts self-contact to grid units.
    fn of_layers(&self, units: &Units, settings: SelfContactSettings) -> SelfContact {
        let edges = |m: f64| m / units.length_m;
        SelfContact {
            thickness: match settings.thickness_m {
                Some(thickness) => edges(thickness),
                None => self.thickness_m.map_or(bodies::THICKNESS, edges).min(0.5),
            },
            friction: settings.friction.unwrap_or(self.friction),
        }
    }

    fn check_wind(&self, field: &str, wind: &Wind) -> Result<()> {
        self.not_negative(&format!("{field}.density"), wind.density)?;
        self.not_negative(&format!("{field}.drag"), wind.drag)?;
        if let Some(gusts) = wind.gusts {
            gusts.check(&self.origin, &format!("{field}.gusts"))?;
        }
        self.finite(&format!("{field}.velocity"), wind.velocity)
    }

    fn finite(&self, field: &str, vector: [f64; 3]) -> Result<()> {
        match vector.iter().all(|c| c.is_finite()) {
            true => Ok(()),
            false => Err(Error::invalid(&self.origin, field, "finite numbers", format!("{vector:?}"))),
        }
    }

    fn check_stiffness(&self, field: &str, stiffness: Stiffness) -> Result<()> {
        let fields = match stiffness {
            Stiffness::Grid(m) => [("stretch", m.stretch), ("shear", m.shear), ("bend", m.bend)],
            Stiffness::Moduli(m) => [
                ("stretch_modulus", m.stretch_modulus),
                ("shear_modulus", m.shear_modulus),
                ("bending_stiffness", m.bending_stiffness),
            ],
        };
        fields.iter().try_for_each(|(name, value)| self.not_negative(&format!("{field}.{name}"), *value))
    }

    fn positive(&self, field: &str, value: f64) -> Result<f64> {
        if value.is_finite() && value > 0.0 {
            return Ok(value);
        }
        Err(Error::invalid(&self.origin, field, "a finite number above 0", value))
    }

    fn not_negative(&self, field: &str, value: f64) -> Result<()> {
        if value.is_finite() && value >= 0.0 {
            return Ok(());
        }
        Err(Error::invalid(&self.origin, field, "a finite number, 0 or more", value))
    }
}
