//! OBJ files whose vertices are the particles of a grid.

use super::lattice;
use crate::cloth::Grid;
use crate::{Error, Result, io::Polygons};
use std::path::Path;

/// The vertices and polygons of an OBJ file.
#[derive(Clone, Debug)]
pub(super) struct Mesh(Polygons<f64>);

impl Mesh {
    /// Reads an OBJ file.
    pub fn read(path: &Path) -> Result<Self> {
        Polygons::read(&path.into()).map(Self)
    }

    /// Returns the positions of the particles of `grid`: in the order of the file if its faces, if there are any, allow that,
    /// otherwise in one in which they do. Fails as [`Mesh::check`] does if there is none, or if it is that of the grid with its
    /// sides swapped, which is a mistake more often than meant.
    pub fn into_points(self, grid: Grid) -> Result<Vec<[f64; 3]>> {
        let Err(error) = self.check(grid) else { return Ok(self.0.positions) };
        let order = if self.hint(grid).is_empty() { self.order(grid) } else { None }.ok_or(error)?;
        Ok(order.into_iter().map(|vertex| self.0.positions[vertex]).collect())
    }

    /// Returns the vertex that is each particle of `grid`, by its texture coordinates if all have some.
    fn order(&self, grid: Grid) -> Option<Vec<usize>> {
        let Polygons { positions, faces, uv, uv_of, .. } = &self.0;
        let mut own = vec![[f64::NAN; 2]; positions.len()];
        for ((face, _), uv_of) in faces.iter().zip(uv_of) {
            face.iter()
                .zip(uv_of)
                .for_each(|(&vertex, at)| own[vertex] = at.map_or(own[vertex], |at| uv[at]));
        }
        let has_uv = own.as_flattened().iter().all(|c| c.is_finite());
        let faces: Vec<Vec<usize>> = faces.iter().map(|(face, _)| face.clone()).collect();
        lattice::order(grid, positions.len(), &faces, has_uv.then_some(&own[..]))
    }

    /// Checks that there is one vertex per particle of `grid` and that the faces, if there are any, cover
    /// each of its cells once, by a quadrilateral or by two triangles.
    pub fn check(&self, grid: Grid) -> Result<()> {
        let Polygons { origin, positions, faces, .. } = &self.0;
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
