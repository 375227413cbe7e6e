//! OBJ files whose vertices are the particles of a grid, in order.

use crate::cloth::Grid;
use crate::{Error, Result, io::Polygons};
use std::path::Path;

/// The vertices and polygons of an OBJ file.
#[derive(Clone, Debug)]
pub(super) struct Mesh(Polygons<f64>);

impl Mesh {
    /// Reads an OBJ file.
    pub fn read(path: &Path) -> Result<Self> {
        Polygons::read(path).map(Self)
    }

    /// Returns the positions, in the order of the file.
    pub fn into_points(self) -> Vec<[f64; 3]> {
        self.0.positions
    }

    /// Checks that there is one vertex per particle of `grid` and that the faces, if there are any, cover
    /// each of its cells once, by a quadrilateral or by two triangles.
    pub fn check(&self, grid: Grid) -> Result<()> {
        let Polygons { origin, positions, faces } = &self.0;
        if positions.len() != grid.particles() {
            let expected = format!("{} for the {grid} grid (\"grid\" names another)", grid.particles());
            return Err(Error::invalid(origin, "vertices", expected, positions.len()));
        }
        if faces.is_empty() {
            return Ok(());
        }
        // For each cell: the number of triangles that cover it, and which of its corners they leave out.
        let mut cells = vec![(0u32, 0u8); grid.particles()];
        for (face, line) in faces {
            let (cell, triangles, left_out) = place(grid, face).ok_or_else(|| {
                let expected = format!(
                    "the corners of one cell of the {grid} grid, vertex (i, j) being i*{} + j",
                    grid.w
                );
                let found = format!("vertices {face:?} (from 0){}", self.hint(grid));
                Error::invalid(origin, format!("line {line}"), expected, found)
            })?;
            cells[cell].0 += triangles;
            cells[cell].1 |= left_out;
        }
        for i in 0..grid.h - 1 {
            for j in 0..grid.w - 1 {
                let (triangles, left_out) = cells[i * grid.w + j];
                // Two triangles cover a cell if the corners that they leave out are opposite.
                if triangles != 2 || !matches!(left_out, 0 | 0b0101 | 0b1010) {
                    let field = format!("faces of cell ({i}, {j})");
                    let found = format!("{triangles} triangles that do not");
                    return Err(Error::invalid(origin, field, "two triangles that cover the cell", found));
                }
            }
        }
        Ok(())
    }

    /// Whether the mesh fits `grid`, for files that leave the order of the sides open.
    pub fn fits(&self, grid: Grid) -> bool {
        self.check(grid).is_ok()
    }

    /// Returns a hint for faces that do not fit: most often the sides are swapped.
    fn hint(&self, grid: Grid) -> String {
        let swapped = Grid { h: grid.w, w: grid.h };
        let fits = |grid| self.0.faces.iter().all(|(face, _)| place(grid, face).is_some());
        if grid.h != grid.w && fits(swapped) { format!("; they fit {swapped}") } else { String::new() }
    }
}

/// Returns the cell that a face lies in, the number of triangles that it counts for, and the corners of the
/// cell that it leaves out, as bits in order around the cell.
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
