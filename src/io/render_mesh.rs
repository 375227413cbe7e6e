//! Meshes with texture coordinates, which a cloth can carry along.

use super::gltf::{Triangles, is_gltf};
use super::{MeshFile, Polygons, Topology};
use crate::{Error, Result};

/// How far beyond 0 to 1 a texture coordinate may be rounded.
const ROUNDING: f64 = 1e-6;

/// A mesh of polygons with texture coordinates, of any shape and order.
///
/// A vertex of an OBJ file that has several texture coordinates, at a seam, becomes as many vertices here, as it is in glTF
/// files already; one of no face is left out. Otherwise they keep the order of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderMesh {
    topology: Topology,
    positions: Vec<[f32; 3]>,
    sources: Vec<u32>,
}

impl RenderMesh {
    /// Reads an OBJ or glTF file (`.glb`, `.gltf`), by its ending, or one object in it ([`MeshFile`]). In glTF all meshes of the scene are one, where their nodes
    /// place them, in their shape without morph targets, skins and animations. Fails if it has no faces, if a corner of one has
    /// no texture coordinates, or if one of them is not finite or not between 0 and 1.
    pub fn read(file: impl Into<MeshFile>) -> Result<Self> {
        let file = file.into();
        match is_gltf(&file.path) {
            true => Self::of_triangles(Triangles::read(&file)?),
            false => Self::of(Polygons::read(&file)?),
        }
    }

    /// Returns its polygons and texture coordinates, with normals.
    pub fn topology(&self) -> &Topology {
        &self.topology
    }

    /// Returns the positions in the file, shape [V, 3]; those of glTF are y up.
    pub fn positions(&self) -> &[[f32; 3]] {
        &self.positions
    }

    /// Returns the zero-based number in the file of each vertex, which those along a seam of an OBJ share; those of glTF are
    /// counted through all meshes of the scene, or of the object. Shape \[V\].
    pub fn sources(&self) -> &[u32] {
        &self.sources
    }

    fn of_triangles(mesh: Triangles) -> Result<Self> {
        let Triangles { origin, positions, uv, faces, parts } = &mesh;
        if parts.iter().all(|part| !part.has_uv) {
            let expected = "texture coordinates (TEXCOORD_0), which place it on the cloth";
            return Err(Error::invalid(origin, "meshes", expected, "a mesh without UVs"));
        }
        let mut number = vec![None; positions.len()];
        for &vertex in faces.as_flattened() {
            number[vertex as usize] = Some(0);
        }
        let (mut own, mut sources) = (Vec::new(), Vec::new());
        for (vertex, number) in number.iter_mut().enumerate().filter(|(_, number)| number.is_some()) {
            // Here v points down.
            let [u, v] = uv[vertex];
            let place = checked([u, 1.0 - v]).ok_or_else(|| {
                let expected = "finite texture coordinates from 0 to 1 (TEXCOORD_0)";
                let has_uv = mesh.part(vertex).has_uv;
                let found = if has_uv { format!("uv [{u}, {v}]") } else { "none".into() };
                Error::invalid(origin, mesh.place(vertex), expected, found)
            })?;
            *number = Some(sources.len() as u32);
            own.push(place);
            sources.push(vertex as u32);
        }
        let faces = faces.iter().map(|face| face.map(|k| number[k as usize].unwrap_or_default()));
        let topology = Topology::new(sources.len(), faces)?.with_uv(own)?.with_normals();
        let positions = sources.iter().map(|&vertex| positions[vertex as usize]).collect();
        Ok(Self { topology, positions, sources })
    }

    fn of(mesh: Polygons<f32>) -> Result<Self> {
        let Polygons { origin, positions, faces, uv, uv_of } = mesh;
        if faces.is_empty() {
            return Err(Error::invalid(origin, "faces", "at least one 'f' line", "none"));
        }
        if uv_of.iter().flatten().all(Option::is_none) {
            let expected =
                "texture coordinates ('vt' lines, and faces of 'v/vt'), which place it on the cloth";
            return Err(Error::invalid(origin, "mesh", expected, "a mesh without UVs"));
        }
        // The coordinates of each vertex, in the order in which faces use them.
        let mut own: Vec<Vec<[f32; 2]>> = vec![Vec::new(); positions.len()];
        let mut corners: Vec<Vec<(usize, usize)>> = Vec::with_capacity(faces.len());
        for ((face, line), uv_of) in faces.iter().zip(&uv_of) {
            let mut places = Vec::with_capacity(face.len());
            for (&vertex, at) in face.iter().zip(uv_of) {
                let Some(at) = *at else {
                    let (field, found) = (format!("line {line}"), format!("none at vertex {}", vertex + 1));
                    return Err(Error::invalid(
                        origin,
                        field,
                        "texture coordinates that exist at every corner",
                        found,
                    ));
                };
                let place = checked(uv[at]).ok_or_else(|| {
                    let (expected, [u, v]) = ("finite texture coordinates from 0 to 1", uv[at]);
                    let field = format!("line {line}, vertex {}", vertex + 1);
                    Error::invalid(&origin, field, expected, format!("uv [{u}, {v}]"))
                })?;
                let known = own[vertex].iter().position(|other| *other == place);
                places.push((vertex, known.unwrap_or(own[vertex].len())));
                if known.is_none() {
                    own[vertex].push(place);
                }
            }
            corners.push(places);
        }
        let mut first = Vec::with_capacity(positions.len());
        let mut sources = Vec::new();
        for (vertex, own) in own.iter().enumerate() {
            first.push(sources.len() as u32);
            sources.extend(own.iter().map(|_| vertex as u32));
        }
        let number = |&(vertex, which): &(usize, usize)| first[vertex] + which as u32;
        let polygons = corners.iter().map(|face| face.iter().map(number).collect::<Vec<_>>());
        let topology = Topology::new(sources.len(), polygons)?.with_uv(own.concat())?.with_normals();
        let positions = sources.iter().map(|&vertex| positions[vertex as usize]).collect();
        Ok(Self { topology, positions, sources })
    }
}

/// Returns texture coordinates in single precision if they are between 0 and 1.
fn checked(uv: [f64; 2]) -> Option<[f32; 2]> {
    let inside = |c: &f64| (-ROUNDING..=1.0 + ROUNDING).contains(c);
    // Adding zero makes that of -0.
    uv.iter().all(inside).then(|| uv.map(|c| c.clamp(0.0, 1.0) as f32 + 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<RenderMesh> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.obj");
        std::fs::write(&path, text).unwrap();
        RenderMesh::read(path)
    }

    /// Two quads and a triangle, with a seam between the quads.
    const SEAM: &str = "v 0 0 0\nv 9 9 9\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\n\
        vt 0 0\nvt .5 0\nvt .5 1\nvt 0 1\nvt 0.75 0\nvt 1 0\nvt 1.0000004 1\nvt 0.75 1\nvt 0.5 0\n\
        f 1/1 3/2/7 4/3/7 5/4\nf 3/5 6/6 7/7 4/8\nf -4/3 1/1 3/9\n";

    #[test]
    fn seams_become_vertices_of_their_own() {
        let mesh = read(SEAM).unwrap();
        // Equal coordinates are one vertex, whatever their numbers; the second vertex of the file has no face.
        assert_eq!(mesh.sources(), [0, 2, 2, 3, 3, 4, 5, 6]);
        let faces: Vec<&[u32]> = mesh.topology().faces().collect();
        assert_eq!(faces, [&[0, 1, 3, 5][..], &[2, 6, 7, 4], &[3, 0, 1]]);
        assert_eq!(mesh.topology().uv()[2..4], [[0.75, 0.0], [0.5, 1.0]]);
        assert_eq!((mesh.topology().uv()[7], mesh.positions()[7]), ([1.0, 1.0], [2.0, 1.0, 0.0]));
    }

    #[test]
    fn what_is_no_mesh_with_uvs_is_named() {
        let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\n";
        for (more, parts) in [
            ("", &["faces: expected at least one"][..]),
            ("f 1 2 3", &["found a mesh without UVs"]),
            ("f 1//1 2//1 3//1", &["found a mesh without UVs"]),
            ("vt 0 0\nf 1/1 2 3/1", &["line 5: expected texture coordinates", "none at vertex 2"]),
            ("vt 0 0\nf 1/1 2/1 3/2", &["line 5: ", "none at vertex 3"]),
            ("vt 0 0\nvt 1.5 0\nf 1/1 2/2 3/1", &["line 6, vertex 2: expected finite", "found uv [1.5, 0]"]),
            ("vt 0 0\nvt 0 -1\nf 1/1 2/2 3/1", &["found uv [0, -1]"]),
            ("vt 0 0\nvt nan 0\nf 1/1 2/2 3/1", &["found uv [NaN, 0]"]),
            ("vt 0 0\nvt x\nf 1/1 2/2 3/1", &["found uv [NaN, 0]"]),
        ] {
            let error = read(&format!("{square}{more}\n")).unwrap_err().to_string();
            assert!(parts.iter().all(|part| error.contains(part)), "{more:?}: {error}");
        }
    }
}
