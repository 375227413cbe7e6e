//! Stanford PLY meshes, binary little-endian.

use super::Topology;
use std::io::{self, Write};

/// Whether a face has more corners than a byte can say.
fn is_long(topology: &Topology) -> bool {
    topology.counts().iter().any(|&count| count > u8::MAX.into())
}

/// Writes a frame; `rest` is the same in all frames ([`rest`]).
pub(super) fn write(
    topology: &Topology,
    positions: &[[f32; 3]],
    rest: &[u8],
    writer: &mut impl Write,
) -> io::Result<()> {
    let normals = if topology.has_normals() { topology.normals(positions) } else { Vec::new() };
    write!(writer, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", positions.len())?;
    for name in &["x", "y", "z", "nx", "ny", "nz"][..if topology.has_normals() { 6 } else { 3 }] {
        writeln!(writer, "property float {name}")?;
    }
    let (faces, count) = (topology.counts().len(), if is_long(topology) { "int" } else { "uchar" });
    write!(writer, "element face {faces}\nproperty list {count} int vertex_indices\nend_header\n")?;
    for (k, position) in positions.iter().enumerate() {
        for x in position.iter().chain(normals.get(k).into_iter().flatten()) {
            writer.write_all(&x.to_le_bytes())?;
        }
    }
    writer.write_all(rest)
}

/// Returns what follows the vertices: the faces.
pub(super) fn rest(topology: &Topology) -> Vec<u8> {
    let (mut bytes, is_long) = (Vec::new(), is_long(topology));
    for face in topology.faces() {
        let count = (face.len() as u32).to_le_bytes();
        bytes.extend(if is_long { &count[..] } else { &count[..1] });
        bytes.extend(face.iter().flat_map(|k| k.to_le_bytes()));
    }
    bytes
}
