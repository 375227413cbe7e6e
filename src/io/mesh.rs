//! Triangle meshes.

use super::gltf::{Triangles, is_gltf};
use super::obj::Polygons;
use crate::Result;
use crate::cloth::Grid;
use glam::Vec3;
use std::fmt;
use std::path::{Path, PathBuf};

/// A file of meshes, or one object in it. A path is the file with all of its objects.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MeshFile {
    /// An OBJ or glTF file (`.glb`, `.gltf`).
    pub path: PathBuf,
    /// The name of an object: in glTF a node, with those below it, or a mesh; in an OBJ an object (`o`) or a group (`g`). `None` for all.
    pub object: Option<String>,
}

impl<P: AsRef<Path>> From<P> for MeshFile {
    fn from(path: P) -> Self {
        Self { path: path.as_ref().to_owned(), object: None }
    }
}

impl fmt::Display for MeshFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.object {
            Some(object) => write!(f, "{}: {object}", self.path.display()),
            None => write!(f, "{}", self.path.display()),
        }
    }
}

/// A triangle mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions \[m\], shape [V, 3], in the order of the file.
    pub positions: Vec<[f32; 3]>,
    /// Triangles as zero-based vertex indices, shape [T, 3], all below V.
    pub faces: Vec<[u32; 3]>,
}

/// Reads the triangles of an OBJ or glTF file (`.glb`, `.gltf`), by its ending: those of [`read_obj`](super::read_obj), or all meshes of the
/// glTF scene where their nodes place them, y up, in their shape without morph targets, skins and animations. Of one object
/// ([`MeshFile`]) it returns the triangles and their vertices alone, and fails if the file has none of that name.
pub fn read_mesh(file: impl Into<MeshFile>) -> Result<Mesh> {
    let file = file.into();
    if is_gltf(&file.path) {
        let Triangles { positions, faces, .. } = Triangles::read(&file)?;
        return Ok(Mesh { positions, faces });
    }
    let mesh = Polygons::read(&file)?.into_mesh()?;
    Ok(if file.object.is_some() { mesh.without_unused() } else { mesh })
}

impl Mesh {
    /// Returns it without the vertices of no face.
    fn without_unused(mut self) -> Self {
        let mut number = vec![None; self.positions.len()];
        for &vertex in self.faces.as_flattened() {
            number[vertex as usize] = Some(0);
        }
        let mut positions = Vec::new();
        for (position, number) in
            self.positions.iter().zip(&mut number).filter(|(_, number)| number.is_some())
        {
            *number = Some(positions.len() as u32);
            positions.push(*position);
        }
        for vertex in self.faces.as_flattened_mut() {
            *vertex = number[*vertex as usize].unwrap_or_default();
        }
        Self { positions, ..self }
    }
}

/// Computes smooth unit normals, shape [V, 3]: the area-weighted mean of the normals of the adjacent
/// triangles. Triangles with a non-finite normal are ignored; a vertex without a usable triangle gets the
/// zero vector. Panics if a face has a vertex beyond V.
pub fn vertex_normals(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<[f32; 3]> {
    polygon_normals(positions, faces)
}

/// Computes the same from polygons, which have three corners or more.
pub(super) fn polygon_normals(
    positions: &[[f32; 3]],
    faces: impl IntoIterator<Item: AsRef<[u32]>>,
) -> Vec<[f32; 3]> {
    let mut sums = vec![Vec3::ZERO; positions.len()];
    for face in faces {
        let face = face.as_ref();
        let at = |k: u32| Vec3::from(positions[k as usize]);
        let a = at(face[0]);
        let halves = face[1..].windows(2).map(|pair| (at(pair[0]) - a).cross(at(pair[1]) - a));
        let normal: Vec3 = halves.reduce(|a, b| a + b).expect("a face has three corners");
        if normal.is_finite() {
            face.iter().for_each(|&k| sums[k as usize] += normal);
        }
    }
    sums.into_iter().map(|n| n.normalize_or_zero().to_array()).collect()
}

/// Returns the grid whose `vertices`, numbered row by row, these triangles connect, or `None` if they do not
/// look like one.
///
/// With H W vertices and 2 (H-1)(W-1) triangles, H and W are the two roots of a quadratic. The first triangle
/// shows which is which: its sides join neighbours in a row (difference 1) and in a column (difference W).
/// Its diagonal may look like a column side if H and W differ by one, so every triangle must also lie within
/// a cell.
pub(super) fn grid_of(vertices: usize, faces: &[[u32; 3]]) -> Option<Grid> {
    let [a, b, c] = faces.first()?.map(i64::from);
    let sides = [(a - b).abs(), (b - c).abs(), (c - a).abs()];
    let grid = |w: usize| Grid { h: vertices / w.max(1), w };
    let fits = |g: &Grid| {
        g.h > 1 && g.w > 1 && g.particles() == vertices && 2 * (g.h - 1) * (g.w - 1) == faces.len()
    };
    let within_cells = |g: &Grid| {
        let span = |of: fn(usize, usize) -> usize, face: &[u32; 3]| {
            let [a, b, c] = face.map(|k| of(k as usize, g.w));
            a.max(b).max(c) - a.min(b).min(c)
        };
        faces.iter().all(|face| span(|k, w| k / w, face) == 1 && span(|k, w| k % w, face) == 1)
    };
    sides.into_iter().map(|w| grid(w as usize)).find(|g| fits(g) && within_cells(g))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_of_a_flat_sheet_point_along_z() {
        let grid = Grid { h: 3, w: 4 };
        let mut positions: Vec<[f32; 3]> = (0..12).map(|p| [(p % 4) as f32, (p / 4) as f32, 0.0]).collect();
        let normals = vertex_normals(&positions, &grid.faces());
        assert!(normals.iter().all(|n| n.map(f32::abs) == [0.0, 0.0, 1.0]));
        positions[0] = [f32::NAN; 3];
        let normals = vertex_normals(&positions, &grid.faces());
        assert_eq!(normals[0], [0.0; 3]);
        assert_eq!(normals[5].map(f32::abs), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn the_grid_follows_from_the_triangles() {
        for (h, w) in [(8, 8), (8, 13), (13, 8), (31, 33), (8, 9), (9, 8)] {
            let grid = Grid { h, w };
            assert_eq!(grid_of(h * w, &grid.faces()), Some(grid));
            // The vertices numbered from the other end.
            let other: Vec<_> = grid.faces().iter().map(|f| f.map(|k| (h * w) as u32 - 1 - k)).collect();
            assert_eq!(grid_of(h * w, &other), Some(grid));
            // Cut either way, with the diagonal first.
            let cells = (0..(h - 1) * (w - 1)).map(|k| (k / (w - 1) * w + k % (w - 1)) as u32);
            let (right, down) = (1, w as u32);
            let falling = cells
                .clone()
                .flat_map(|a| [[a, a + down + right, a + down], [a, a + right, a + down + right]]);
            let rising =
                cells.flat_map(|a| [[a + down, a + right, a], [a + right, a + down, a + down + right]]);
            assert_eq!(grid_of(h * w, &falling.collect::<Vec<_>>()), Some(grid), "{grid}");
            assert_eq!(grid_of(h * w, &rising.collect::<Vec<_>>()), Some(grid), "{grid}");
            assert_eq!(grid_of(h * w + 1, &grid.faces()), None);
        }
        assert_eq!(grid_of(0, &[]), None);
    }
}
