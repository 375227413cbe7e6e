//! The start state: positions and velocities at frame 0.

use super::drape::settled;
use super::obj::Mesh;
use super::points;
use super::surface::Sheet;
use super::units::{Units, UpAxis};
use crate::cloth::{Cloth, Grid};
use crate::io::{Node, ReadOptions, Trajectory};
use crate::{Error, Result, io};
use std::path::{Path, PathBuf};

/// An affine map of positions in a scene's axes \[m\]: three rows, whose last column is the translation.
pub type Transform = [[f64; 4]; 3];

/// A file with the positions of all particles.
#[derive(Clone, Debug, PartialEq)]
pub struct StartFile {
    /// An OBJ file whose vertex `i W + j` is particle (i, j), or in another order if its faces are the cells of the grid; a `.npy` of shape [H, W, 3], [H W, 3] or, for a
    /// trajectory whose first frame is used, [frames, H W, 3] or [frames, H, W, 3]; or the `.npz` of a rollout,
    /// whose last frame is used with its velocities. Positions are in the scene's axes \[m\].
    pub path: PathBuf,
    /// The grid of the file, unless it is a `.npz` whose faces determine another. `None` means the scene's
    /// grid. If the grid of the file differs from the scene's, the sheet is resampled.
    pub grid: Option<Grid>,
    /// Transform applied to the file's positions.
    pub transform: Option<Transform>,
}

/// The start state of a scene. Velocities are zero except from a `.npz`.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Start {
    /// `settled`: the drape that hangs still from its corners (H-1, 0) and (0, 0), which are 0.9 of the side apart: in
    /// the equilibrium of the scene's cloth under its gravity.
    #[default]
    Settled,
    /// `flat`: horizontal, particle (i, j) at (j, i - (H-1)/2, 0) edges, z up.
    Flat,
    /// `hanging`: a vertical plane that hangs from its edge j = 0.
    Hanging,
    /// Positions from a file.
    File(StartFile),
    /// Positions of the particles of a grid, in particle order and the scene's axes \[m\]. On another grid
    /// the sheet is resampled.
    Vertices(Grid, Vec<[f64; 3]>),
}

/// Names of the start states that need no file.
const NAMES: [&str; 3] = ["settled", "flat", "hanging"];

/// Whether a text is more likely the path of a file than the misspelt name of something built in.
pub(super) fn looks_like_a_path(text: &str) -> bool {
    text.contains(['.', '/', '\\'])
}

fn is_file(text: &str) -> bool {
    let text = text.to_ascii_lowercase();
    [".obj", ".npy", ".npz"].iter().any(|ending| text.ends_with(ending))
}

impl Start {
    /// Parses the name of a built-in start state, or the path of an `.obj`, `.npy` or `.npz` file relative to
    /// `folder`. `origin` is the file or option that the text comes from.
    pub fn parse(text: &str, origin: &str, folder: &Path) -> Result<Self> {
        match text {
            "settled" => Ok(Start::Settled),
            "flat" => Ok(Start::Flat),
            "hanging" => Ok(Start::Hanging),
            _ if is_file(text) => {
                Ok(Start::File(StartFile { path: folder.join(text), grid: None, transform: None }))
            }
            _ if looks_like_a_path(text) => {
                let expected = format!("{} or an .obj, .npy or .npz file", NAMES.join(", "));
                Err(Error::invalid(origin, "start", expected, text))
            }
            _ => Err(Error::unknown(origin, "start state", text, NAMES)),
        }
    }

    /// Returns the name of a built-in start state.
    pub(super) fn name(&self) -> Option<&'static str> {
        match self {
            Start::Settled => Some(NAMES[0]),
            Start::Flat => Some(NAMES[1]),
            Start::Hanging => Some(NAMES[2]),
            Start::File(_) | Start::Vertices(..) => None,
        }
    }

    /// Returns the positions and velocities of the particles of `grid`, in particle order; grid units, z up. `cloth` is
    /// the scene's and `origin` names the scene in warnings.
    pub(super) fn on(
        &self,
        cloth: &Cloth,
        units: &Units,
        (grid, up): (Grid, UpAxis),
        origin: &str,
    ) -> Result<[Vec<[f64; 3]>; 2]> {
        let points = match self {
            Start::Settled => settled(grid, units, cloth, origin)?.to_vec(),
            Start::Flat => (0..grid.particles()).map(|p| grid.rest(p)).collect(),
            // In the axes of the drape: with y up, i runs along +z and the upper edge is half a side above
            // the origin.
            Start::Hanging => {
                let half = (grid.h - 1) as f64 / 2.0;
                let upright = |p: usize| [0.0, half - (p / grid.w) as f64, half - (p % grid.w) as f64];
                (0..grid.particles()).map(upright).collect()
            }
            Start::File(file) => {
                let (sheet, velocities) = file.read(grid)?;
                let inside = |p: [f64; 3]| units.position(up.to_z_up(file.transformed(p, 1.0)));
                let points: Vec<[f64; 3]> = sheet.regrid(grid).points.into_iter().map(inside).collect();
                if let Some(velocities) = velocities {
                    let inside = |v: [f64; 3]| units.velocity(up.to_z_up(file.transformed(v, 0.0)));
                    return Ok([
                        points,
                        velocities.regrid_velocities(grid).points.into_iter().map(inside).collect(),
                    ]);
                }
                points
            }
            Start::Vertices(of, points) => {
                let sheet = Sheet { grid: *of, points: points.clone() }.regrid(grid);
                sheet.points.into_iter().map(|p| units.position(up.to_z_up(p))).collect()
            }
        };
        let still = vec![[0.0; 3]; points.len()];
        Ok([points, still])
    }
}

impl StartFile {
    /// Reads the sheet on the grid of the file, before the transform, and its velocities [m/s] if the file
    /// has them.
    fn read(&self, scene_grid: Grid) -> Result<(Sheet, Option<Sheet>)> {
        let grid = self.grid.unwrap_or(scene_grid);
        // A trajectory may have a grid and velocities of its own.
        if self.path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz")) {
            let options = ReadOptions { likely_grid: Some(grid), ..Default::default() };
            let trajectory = Trajectory::read(&self.path, &options)?;
            let Grid { h, w } = trajectory.grid();
            let grid = Grid::new(h, w, &self.path.display().to_string())?;
            let last = trajectory.frames() - 1;
            let sheet = |points: &[[f32; 3]]| Sheet {
                grid,
                points: points.iter().map(|p| p.map(f64::from)).collect(),
            };
            return Ok((sheet(trajectory.frame(last)), Some(sheet(trajectory.frame_velocities(last)))));
        }
        let origin = self.path.display().to_string();
        let points = match self.path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase) {
            Some(e) if e == "obj" => Mesh::read(&self.path)?.into_points(grid)?,
            Some(e) if e == "npy" => {
                let array = io::read_npy(&self.path)?;
                let (shape, n) = (array.shape(), grid.particles());
                let Grid { h, w } = grid;
                let fits = match *shape {
                    [vertices, 3] => vertices == n,
                    [rows, columns, 3] if (rows, columns) == (h, w) => true,
                    [frames, vertices, 3] => frames > 0 && vertices == n,
                    [frames, rows, columns, 3] => frames > 0 && (rows, columns) == (h, w),
                    _ => false,
                };
                if !fits {
                    let expected = format!(
                        "[{h}, {w}, 3], [{n}, 3], [frames, {n}, 3] or [frames, {h}, {w}, 3]; \
                         the grid of a file other than the scene's is its \"grid\" in {{\"file\", \"grid\"}}"
                    );
                    return Err(Error::invalid(origin, "shape", expected, format!("{shape:?}")));
                }
                let mut points = points::from_array(&origin, &array)?;
                points.truncate(n);
                points
            }
            _ => {
                return Err(Error::invalid(
                    origin,
                    "start",
                    "an .obj, .npy or .npz file",
                    "another extension",
                ));
            }
        };
        Ok((Sheet { grid, points }, None))
    }

    /// Applies the transform to a position (`weight` 1) or a velocity (`weight` 0).
    fn transformed(&self, p: [f64; 3], weight: f64) -> [f64; 3] {
        let row = |r: [f64; 4]| r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + weight * r[3];
        self.transform.map_or(p, |t| t.map(row))
    }
}

/// Reads a transform: a matrix of 4x4 or 3x4 numbers, a translation [x, y, z], or
/// `{"rotate": [degrees, x, y, z], "scale": s, "translate": [x, y, z]}`, applied in this order.
pub(super) fn read_transform(node: &Node) -> Result<Transform> {
    if node.value.is_object() {
        node.deny_unknown(&["rotate", "scale", "translate"])?;
        let rotate = |n: &Node| n.array("[degrees, x, y, z]", Node::number).and_then(|r| rotation(n, r));
        let turn = node.get_or("rotate", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], rotate)?;
        let scale = node.get_or("scale", 1.0, Node::number)?;
        let shift = node.get_or("translate", [0.0; 3], Node::vector)?;
        let entry = |r: usize, c: usize| if c < 3 { scale * turn[r][c] } else { shift[r] };
        return Ok(std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c))));
    }
    let expected = "a 4x4 or 3x4 matrix, a translation [x, y, z] or {rotate, scale, translate}";
    let rows = node.value.as_array().ok_or_else(|| node.invalid(expected))?;
    if rows.len() == 3 && rows.iter().all(serde_json::Value::is_number) {
        let [x, y, z] = node.vector()?;
        return Ok([[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z]]);
    }
    if rows.len() != 3 && rows.len() != 4 {
        return Err(node.invalid(expected));
    }
    let rows: Vec<[f64; 4]> =
        node.items()?.iter().map(|row| row.array("four numbers", Node::number)).collect::<Result<_>>()?;
    if rows.get(3).is_some_and(|last| *last != [0.0, 0.0, 0.0, 1.0]) {
        return Err(node.invalid("a matrix whose last row is [0, 0, 0, 1]"));
    }
    Ok([rows[0], rows[1], rows[2]])
}

/// Returns the matrix of a rotation about an axis (Rodrigues).
fn rotation(node: &Node, [degrees, x, y, z]: [f64; 4]) -> Result<[[f64; 3]; 3]> {
    let length = points::norm([x, y, z]);
    if length == 0.0 || !length.is_finite() {
        return Err(node.invalid("an axis that is not zero"));
    }
    let axis = [x / length, y / length, z / length];
    let (sin, cos) = degrees.to_radians().sin_cos();
    let cross = [[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]];
    let entry = |r: usize, c: usize| {
        let identity = if r == c { cos } else { 0.0 };
        identity + (1.0 - cos) * axis[r] * axis[c] + sin * cross[r][c]
    };
    Ok(std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c))))
}
