//! Stanford PLY meshes, binary little-endian.

use super::vertex_normals;
use crate::cloth::Grid;
use std::io::{self, Write};

/// Writes a frame of a grid with normals.
pub(super) fn write(grid: Grid, positions: &[[f32; 3]], mut writer: impl Write) -> io::Result<()> {
    let faces = grid.faces();
    let normals = vertex_normals(positions, &faces);
    write!(writer, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", positions.len())?;
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        writeln!(writer, "property float {name}")?;
    }
    write!(writer, "element face {}\nproperty list uchar int vertex_indices\nend_header\n", faces.len())?;
    for (position, normal) in positions.iter().zip(&normals) {
        for x in position.iter().chain(normal) {
            writer.write_all(&x.to_le_bytes())?;
        }
    }
    for face in faces {
        writer.write_all(&[3])?;
        for k in face {
            writer.write_all(&k.to_le_bytes())?;
        }
    }
    Ok(())
}
