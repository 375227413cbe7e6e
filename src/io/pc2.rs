//! PointCache2 (`.pc2`): a 32-byte header, then the positions of every point of every sample as `f32`.

use super::{clip::Clip, open, read_points, trajectory::Parts};
use crate::{Error, Result};
use std::{
    io::{self, BufReader, Read, Write},
    path::Path,
};

const MAGIC: &[u8; 12] = b"POINTCACHE2\0";
const HEADER_LEN: u64 = 32;

/// Writes the positions of a clip, one sample per frame.
pub(super) fn write(clip: &Clip, writer: &mut impl Write) -> io::Result<()> {
    let count = |n: usize| i32::try_from(n).map_err(io::Error::other);
    writer.write_all(MAGIC)?;
    writer.write_all(&1i32.to_le_bytes())?;
    writer.write_all(&count(clip.topology.vertices())?.to_le_bytes())?;
    writer.write_all(&(clip.start() as f32).to_le_bytes())?; // first frame
    writer.write_all(&1f32.to_le_bytes())?; // frames per sample
    writer.write_all(&count(clip.count())?.to_le_bytes())?;
    clip.write_positions(writer, f32::to_le_bytes)
}

/// Reads the positions of a cache.
pub(super) fn read(path: &Path) -> Result<Parts> {
    let origin = path.display().to_string();
    let (file, size) = open(path)?;
    let mut reader = BufReader::new(file);
    let mut header = [0; HEADER_LEN as usize];
    reader
        .read_exact(&mut header)
        .map_err(|_| Error::invalid(&origin, "header", "32 bytes", format!("{size} bytes")))?;
    let word = |at: usize| [header[at], header[at + 1], header[at + 2], header[at + 3]];
    if &header[..12] != MAGIC || word(12) != 1i32.to_le_bytes() {
        return Err(Error::invalid(&origin, "header", "POINTCACHE2, version 1", "something else"));
    }
    let [points, samples] = [16, 28].map(|at| u64::from(u32::from_le_bytes(word(at))));
    let data = points.checked_mul(samples).and_then(|n| n.checked_mul(12));
    if data.and_then(|d| d.checked_add(HEADER_LEN)) != Some(size) {
        let expected = format!("{samples} samples of {points} points");
        return Err(Error::invalid(&origin, "length", expected, format!("{size} bytes")));
    }
    let positions = read_points(&mut reader, points * samples, path, f32::from_le_bytes)?;
    Ok(Parts { shape: vec![samples as usize, points as usize, 3], positions, ..Parts::default() })
}
