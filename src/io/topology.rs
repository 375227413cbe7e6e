//! What the frames of a trajectory have in common.

use super::mesh::polygon_normals;
use crate::cloth::{Grid, Mask};
use crate::{Error, Result};

/// The mesh that moves in a trajectory: its polygons and texture coordinates, without positions.
#[derive(Clone, Debug, PartialEq)]
pub struct Topology {
    vertices: usize,
    /// Number of corners of each polygon.
    counts: Vec<u32>,
    /// The corners of all polygons, one after another.
    corners: Vec<u32>,
    uv: Vec<[f32; 2]>,
    has_normals: bool,
}

impl Topology {
    /// Describes a mesh of V `vertices`, some of which may belong to no face; `faces` are polygons of zero-based vertex
    /// numbers, counter-clockwise seen from the front. Fails if there are no vertices or more than 2^31 - 1, if a face has
    /// fewer than three corners, or a corner is not a vertex.
    pub fn new(vertices: usize, faces: impl IntoIterator<Item: AsRef<[u32]>>) -> Result<Self> {
        let invalid = |field: String, expected: String, found: String| {
            Err(Error::invalid("topology", field, expected, found))
        };
        if vertices == 0 || i32::try_from(vertices).is_err() {
            return invalid("vertices".into(), "1 to 2^31 - 1".into(), vertices.to_string());
        }
        let (mut counts, mut corners) = (Vec::new(), Vec::new());
        for (k, face) in faces.into_iter().enumerate() {
            let face = face.as_ref();
            if face.len() < 3 || face.iter().any(|&v| v as usize >= vertices) {
                let expected = format!("three or more vertices below {vertices}");
                return invalid(format!("face {k}"), expected, format!("{face:?}"));
            }
            counts.push(face.len() as u32);
            corners.extend_from_slice(face);
        }
        Ok(Self { vertices, counts, corners, uv: Vec::new(), has_normals: false })
    }

    /// Adds texture coordinates, shape [V, 2], with v upwards. Fails on another shape.
    pub fn with_uv(self, uv: Vec<[f32; 2]>) -> Result<Self> {
        if uv.len() != self.vertices {
            return Err(Error::invalid("topology", "uv", format!("{} pairs", self.vertices), uv.len()));
        }
        Ok(Self { uv, ..self })
    }

    /// Asks for smooth normals in the formats that can hold them: PLY, USD and glTF. Without them, most programs draw
    /// every face flat.
    pub fn with_normals(self) -> Self {
        Self { has_normals: true, ..self }
    }

    /// Returns the triangles of a cloth and the texture coordinates of its grid, with normals; vertices that its mask leaves out
    /// belong to no triangle. Panics if the grid has no particles.
    pub fn of_cloth(grid: Grid, mask: Option<&Mask>) -> Self {
        let faces = mask.map_or_else(|| grid.faces(), Mask::faces);
        let described = Self::new(grid.particles(), faces);
        let described = described.and_then(|topology| topology.with_uv(grid.texture_coordinates()));
        described.expect("a grid has particles").with_normals()
    }

    /// Returns the number of vertices (V).
    pub fn vertices(&self) -> usize {
        self.vertices
    }

    /// Returns the texture coordinates, shape [V, 2]; empty if there are none.
    pub fn uv(&self) -> &[[f32; 2]] {
        &self.uv
    }

    /// Whether files are to have normals.
    pub fn has_normals(&self) -> bool {
        self.has_normals
    }

    /// Returns the number of polygons, and the corners of each.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Returns the corners of all polygons, one after another.
    pub fn corners(&self) -> &[u32] {
        &self.corners
    }

    /// Iterates over the polygons.
    pub fn faces(&self) -> impl Iterator<Item = &[u32]> {
        let mut rest = &self.corners[..];
        self.counts.iter().map(move |&count| {
            let (face, others) = rest.split_at(count as usize);
            rest = others;
            face
        })
    }

    /// Iterates over the polygons cut into triangles, fans around their first corners.
    pub fn triangles(&self) -> impl Iterator<Item = [u32; 3]> {
        self.faces().flat_map(|face| face[1..].windows(2).map(|pair| [face[0], pair[0], pair[1]]))
    }

    /// Returns the smooth normals of these positions ([`vertex_normals`](super::vertex_normals)).
    pub(super) fn normals(&self, positions: &[[f32; 3]]) -> Vec<[f32; 3]> {
        polygon_normals(positions, self.faces())
    }
}

impl From<Grid> for Topology {
    /// Returns the triangles and the texture coordinates of a grid, with normals. Panics if it has no particles.
    fn from(grid: Grid) -> Self {
        Self::of_cloth(grid, None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygons_are_cut_into_fans() {
        let faces = [&[0, 1, 2, 3][..], &[3, 2, 4]];
        let mesh = Topology::new(6, faces).unwrap();
        assert_eq!(mesh.faces().collect::<Vec<_>>(), faces);
        assert_eq!(mesh.triangles().collect::<Vec<_>>(), [[0, 1, 2], [0, 2, 3], [3, 2, 4]]);
        let flat =
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 2.0, 0.0], [9.0; 3]];
        let mut expected = vec![[0.0, 0.0, 1.0]; 5];
        // A vertex without a face has no normal.
        expected.push([0.0; 3]);
        assert_eq!(mesh.normals(&flat), expected);
    }

    #[test]
    fn faces_that_are_none_are_named() {
        let error = |faces: &[&[u32]]| Topology::new(3, faces).unwrap_err().to_string();
        assert!(error(&[&[0, 1, 2], &[0, 1]]).contains("face 1: expected three or more"));
        assert!(error(&[&[0, 1, 3]]).contains("below 3, found [0, 1, 3]"));
        assert!(Topology::new(0, [[0u32; 3]; 0]).is_err());
        let uv = Topology::new(3, [[0, 1, 2]]).unwrap().with_uv(vec![[0.0; 2]]);
        assert!(uv.unwrap_err().to_string().contains("uv: expected 3 pairs, found 1"));
    }
}
