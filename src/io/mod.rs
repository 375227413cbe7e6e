//! Readers and writers of trajectories, meshes and arrays.
//!
//! Frames in memory are a [`Trajectory`], those of a run a [`Recording`] on disk; both are written in any [`Format`]
//! ([`write()`]). A [`RenderMesh`] is one that a cloth carries along, and [`Embedded`] its frames. Readers are strict: a file
//! that is truncated, too long or inconsistent is rejected with its name and the offending field, and the
//! sizes in a header are checked against the length of the file before anything is allocated for them.

mod atomic;
mod clip;
mod document;
mod embedded;
mod folder;
mod format;
mod glb;
mod gltf;
mod mdd;
mod mesh;
mod npy;
mod npz;
mod obj;
mod pc2;
mod ply;
mod recording;
mod render_mesh;
mod topology;
mod trajectory;
mod usda;
mod zip;

pub(crate) use atomic::{UNFINISHED, replace};
pub use atomic::{folder_of, is_stream, target_of, write_atomic};
pub use clip::{Frames, WriteOptions, write, write_mesh};
#[cfg(feature = "lab")]
pub(crate) use document::parse_toml;
pub(crate) use document::{Node, parse_json};
pub use embedded::Embedded;
pub use format::Format;
pub(crate) use gltf::is_gltf;
pub use mesh::{Mesh, MeshFile, read_mesh, vertex_normals};
pub use npy::{parse_npy, read_npy};
pub use npz::read_npz_array;
pub(crate) use obj::Polygons;
pub use obj::read_obj;
pub use recording::Recording;
pub use render_mesh::RenderMesh;
pub use topology::Topology;
pub(crate) use trajectory::intersections_of;
pub use trajectory::{ReadOptions, Trajectory};

use crate::{Error, Result, memory};
use std::{
    fs::File,
    io::Read,
    path::{Path, PathBuf},
};

/// Opens a file for reading. Also returns its length in bytes.
fn open(path: &Path) -> Result<(File, u64)> {
    let fail = |e| Error::io(path, "cannot read", e);
    let file = File::open(path).map_err(fail)?;
    let meta = file.metadata().map_err(fail)?;
    if meta.is_dir() {
        return Err(Error::invalid(path.display().to_string(), "type", "a file", "a folder"));
    }
    Ok((file, meta.len()))
}

/// Reads so many points of three 32-bit words each.
fn read_points(
    reader: &mut impl Read,
    count: u64,
    path: &Path,
    number: fn([u8; 4]) -> f32,
) -> Result<Vec<[f32; 3]>> {
    let mut positions: Vec<[f32; 3]> = Vec::new();
    memory::reserve(&mut positions, count as usize, &path.display().to_string())?;
    let mut point = [0; 12];
    for _ in 0..count {
        reader.read_exact(&mut point).map_err(|e| Error::io(path, "cannot read", e))?;
        positions.push([0, 4, 8].map(|k| number([point[k], point[k + 1], point[k + 2], point[k + 3]])));
    }
    Ok(positions)
}

/// Creates a folder, and those above it, unless it exists.
pub fn create_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).map_err(|e| Error::io(path, "cannot create the folder", e))
}

/// Returns the paths of what is in a folder, sorted.
pub fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let fail = |e| Error::io(folder, "cannot read the folder", e);
    let entries = std::fs::read_dir(folder).map_err(fail)?;
    let paths: std::io::Result<Vec<_>> = entries.map(|entry| entry.map(|e| e.path())).collect();
    let mut paths = paths.map_err(fail)?;
    paths.sort();
    Ok(paths)
}

/// Removes a file. Succeeds if there is no such file.
pub fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io(path, "cannot remove", e)),
        _ => Ok(()),
    }
}

/// Reads a text file. Fails if it is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read_bytes(path)?).map_err(|e| {
        let found = match e.as_bytes().first_chunk() {
            // Of its byte-order mark; a Windows shell writes it.
            Some([0xff, 0xfe] | [0xfe, 0xff]) => "UTF-16".into(),
            _ => format!("byte {}", e.utf8_error().valid_up_to()),
        };
        Error::invalid(path.display().to_string(), "text", "UTF-8", found)
    })
}

/// Reads all bytes of a file.
pub(crate) fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let (mut file, size) = open(path)?;
    memory::reserve(&mut bytes, usize::try_from(size).unwrap_or(usize::MAX), &path.display().to_string())?;
    file.read_to_end(&mut bytes).map_err(|e| Error::io(path, "cannot read", e))?;
    Ok(bytes)
}
