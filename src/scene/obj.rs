//! Wavefront OBJ files whose vertices are the particles of a grid, in their order.
//!
//! Vertices are read here rather than by a mesh library because those renumber them by their faces, and here the number
//! of a vertex is its place in the grid.

use crate::sim::Grid;
use crate::{Error, Result};
use std::path::Path;

/// Vertices and polygons of an OBJ file.
#[derive(Clone, Debug)]
pub(super) struct Mesh {
    /// The file, for errors.
    origin: String,
    /// Positions, in the order of the file.
    pub points: Vec<[f64; 3]>,
    /// Vertex numbers of each face, from 0, and the line of the file that it stands in.
    faces: Vec<(Vec<usize>, usize)>,
}

impl Mesh {
    /// Reads the `v` and `f` lines of a file.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, "cannot read", e))?;
        // Comments and material names may be in any encoding; numbers are ASCII.
        Self::parse(&path.display().to_string(), &String::from_utf8_lossy(&bytes))
    }

    fn parse(origin: &str, text: &str) -> Result<Self> {
        let mut mesh = Self { origin: origin.to_owned(), points: Vec::new(), faces: Vec::new() };
        for (k, line) in text.lines().enumerate() {
            let mut words = line.split_whitespace();
            match words.next() {
                Some("v") => {
                    let numbers: Vec<f64> = words.take(3).map_while(|w| w.parse().ok()).collect();
                    let point: [f64; 3] =
                        numbers.try_into().map_err(|_| mesh.invalid(k, "v X Y Z", line.trim()))?;
                    if point.iter().any(|c| !c.is_finite()) {
                        return Err(mesh.invalid(k, "finite numbers", line.trim()));
                    }
                    mesh.points.push(point);
                }
                Some("f") => {
                    let face: Option<Vec<usize>> = words.map(|w| mesh.vertex(w)).collect();
                    let face = face.ok_or_else(|| mesh.invalid(k, "vertices that exist", line.trim()))?;
                    mesh.faces.push((face, k + 1));
                }
                _ => {}
            }
        }
        Ok(mesh)
    }

    /// The vertex of a word of a face, as in `7`, `7/2/3` or `-1`, which counts back from the last one.
    fn vertex(&self, word: &str) -> Option<usize> {
        let number: i64 = word.split('/').next()?.parse().ok()?;
        let index = if number < 0 { self.points.len() as i64 + number } else { number - 1 };
        usize::try_from(index).ok().filter(|&v| v < self.points.len())
    }

    fn invalid(&self, line: usize, expected: &str, found: &str) -> Error {
        Error::invalid(&self.origin, format!("line {}", line + 1), expected, found)
    }

    /// Checks that the vertices are those of `grid` and that the faces, if there are any, cover each of its cells once
    /// by a quadrilateral or by two triangles.
    pub fn check(&self, grid: Grid) -> Result<()> {
        if self.points.len() != grid.particles() {
            let expected = format!("{} for the {grid} grid", grid.particles());
            return Err(Error::invalid(&self.origin, "vertices", expected, self.points.len()));
        }
        if self.faces.is_empty() {
            return Ok(());
        }
        // For each cell: how many triangles cover it, and which of its corners they leave out.
        let mut cells = vec![(0u32, 0u8); grid.particles()];
        for (face, line) in &self.faces {
            let (cell, triangles, left_out) = place(grid, face).ok_or_else(|| {
                let expected = format!(
                    "the corners of one cell of the {grid} grid, vertex (i, j) being i*{} + j",
                    grid.w
                );
                let found = format!("vertices {face:?} (from 0){}", self.hint(grid));
                Error::invalid(&self.origin, format!("line {line}"), expected, found)
            })?;
            cells[cell].0 += triangles;
            cells[cell].1 |= left_out;
        }
        for i in 0..grid.h - 1 {
            for j in 0..grid.w - 1 {
                let (triangles, left_out) = cells[i * grid.w + j];
                // Two triangles cover a cell when the corners that they leave out are opposite.
                if triangles != 2 || !matches!(left_out, 0 | 0b0101 | 0b1010) {
                    let field = format!("faces of cell ({i}, {j})");
                    let found = format!("{triangles} triangles that do not");
                    return Err(Error::invalid(&self.origin, field, "two triangles that cover it", found));
                }
            }
        }
        Ok(())
    }

    /// Whether the faces fit `grid`, for files that leave the order of the sides open.
    pub fn fits(&self, grid: Grid) -> bool {
        self.check(grid).is_ok()
    }

    /// A remark for faces that do not fit: most often the sides are exchanged.
    fn hint(&self, grid: Grid) -> String {
        let turned = Grid { h: grid.w, w: grid.h };
        let fits = |grid| self.faces.iter().all(|(face, _)| place(grid, face).is_some());
        if grid.h != grid.w && fits(turned) { format!("; they fit {turned}") } else { String::new() }
    }
}

/// The cell that a face lies in, the number of triangles that it counts for, and the corners of the cell that it leaves
/// out, as bits in the order around the cell.
fn place(grid: Grid, face: &[usize]) -> Option<(usize, u32, u8)> {
    let i = face.iter().map(|v| v / grid.w).min()?;
    let j = face.iter().map(|v| v % grid.w).min()?;
    let mut corners = 0u8;
    for v in face {
        corners |= match (v / grid.w - i, v % grid.w - j) {
            (0, 0) => 1,
            (1, 0) => 2,
            (1, 1) => 4,
            (0, 1) => 8,
            _ => return None,
        };
    }
    let inside = i + 1 < grid.h && j + 1 < grid.w;
    let distinct = corners.count_ones() as usize == face.len();
    match face.len() {
        3 if inside && distinct => Some((i * grid.w + j, 1, !corners & 15)),
        4 if inside && distinct => Some((i * grid.w + j, 2, 0)),
        _ => None,
    }
}
