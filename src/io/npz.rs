//! Trajectories as NumPy archives (`.npz`).

use super::{clip::Clip, npy, npy::Array, open, trajectory::Parts, zip::Archive};
use crate::{Error, Result};
use ::zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};
use ndarray::ArrayD;
use std::{
    fs::File,
    io::{self, BufReader, Seek, Write},
    path::Path,
};

const POSITIONS: &str = "vertices_seq";
const VELOCITIES: &str = "velocities_seq";
const FACES: &str = "faces";
const COORDINATES: &str = "vertices_uv";
const RATE: &str = "fps";

/// Writes a clip array by array.
pub(super) fn write(clip: &Clip, writer: impl Write + Seek) -> io::Result<()> {
    let bytes = if clip.options.half { 2 } else { 4 };
    // The header makes an array slightly longer.
    let longest = 3 * bytes * clip.count() as u64 * clip.topology.vertices() as u64 + 1024;
    write_arrays(clip, writer, longest > u64::from(u32::MAX))
}

/// Writes with 64-bit lengths if `large`, else with 32-bit lengths, which more programs can read.
fn write_arrays(clip: &Clip, writer: impl Write + Seek, large: bool) -> io::Result<()> {
    let (frames, topology) = (clip.frames, clip.topology);
    let options = match clip.options.compress {
        // Positions compress little, and hardly more at higher levels.
        true => SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(1)),
        false => SimpleFileOptions::default().compression_method(CompressionMethod::Stored),
    }
    .large_file(large);
    let mut archive = ZipWriter::new(writer);
    let arrays = (|| {
        start(&mut archive, (POSITIONS, options))?;
        npy::write_frames(clip, &mut archive, |frame| frames.positions_of(frame))?;
        start(&mut archive, (VELOCITIES, options))?;
        npy::write_frames(clip, &mut archive, |frame| frames.velocities_of(frame))?;
        let corners: Vec<i32> = topology.triangles().flatten().map(|k| k as i32).collect();
        add(&mut archive, (FACES, options), &[corners.len() / 3, 3], corners.into_iter())?;
        if !topology.uv().is_empty() {
            let flat = topology.uv().as_flattened();
            add(&mut archive, (COORDINATES, options), &[flat.len() / 2, 2], flat.iter().copied())?;
        }
        add(&mut archive, (RATE, options), &[], [clip.fps()].into_iter())?;
        let mut beside = frames.beside().iter();
        beside.try_for_each(|(name, array)| {
            add(&mut archive, (name, options), array.shape(), array.iter().copied())
        })
    })();
    if let Err(error) = arrays {
        // Dropping the writer would try to finish the archive, and print that it cannot.
        std::mem::forget(archive);
        return Err(error);
    }
    archive.finish().map(drop).map_err(io::Error::other)
}

/// Begins an array of an archive.
fn start(
    archive: &mut ZipWriter<impl Write + Seek>,
    (name, options): (&str, SimpleFileOptions),
) -> io::Result<()> {
    archive.start_file(format!("{name}.npy"), options).map_err(io::Error::other)
}

/// Appends an array to an archive.
fn add<T: npy::Number>(
    archive: &mut ZipWriter<impl Write + Seek>,
    named: (&str, SimpleFileOptions),
    shape: &[usize],
    values: impl ExactSizeIterator<Item = T>,
) -> io::Result<()> {
    start(archive, named)?;
    npy::write(archive, shape, values)
}

/// Reads an archive. Only the positions are required.
pub(super) fn read(path: &Path) -> Result<Parts> {
    let mut archive = archive(path)?;
    let mut parts = outline(&mut archive, path)?;
    parts.positions = array(&mut archive, path, POSITIONS)?.of_floats()?.triples(|x| x as f32)?;
    if has(&archive, VELOCITIES) {
        parts.velocities = Some(array(&mut archive, path, VELOCITIES)?.of_floats()?.triples(|x| x as f32)?);
    }
    Ok(parts)
}

/// Reads an archive without its positions and velocities.
pub(super) fn read_outline(path: &Path) -> Result<Parts> {
    outline(&mut archive(path)?, path)
}

/// Passes on the positions (0) of all frames, `vertices` each, and after them the velocities (1), which must be there.
pub(super) fn for_each_frame(
    path: &Path,
    vertices: usize,
    mut take: impl FnMut(usize, &[[f32; 3]]) -> Result<()>,
) -> Result<()> {
    let mut archive = archive(path)?;
    for (which, name) in [POSITIONS, VELOCITIES].into_iter().enumerate() {
        let mut array = array(&mut archive, path, name)?.of_floats()?;
        array.triples_at_a_time(vertices, |points| take(which, points))?;
    }
    Ok(())
}

fn archive(path: &Path) -> Result<Archive<BufReader<File>>> {
    let (file, size) = open(path)?;
    Archive::open(BufReader::new(file), size, path.display().to_string())
}

fn has<R>(archive: &Archive<R>, name: &str) -> bool {
    archive.entries.iter().any(|e| e.name == format!("{name}.npy"))
}

/// Reads what an archive says of its frames: their shape, which that of the velocities must be, the faces and the rate.
fn outline(archive: &mut Archive<BufReader<File>>, path: &Path) -> Result<Parts> {
    let shape = array(archive, path, POSITIONS)?.of_floats()?.shape;
    if has(archive, VELOCITIES) {
        let array = array(archive, path, VELOCITIES)?;
        if array.shape != shape {
            let expected = format!("the shape of {POSITIONS}, {shape:?}");
            return Err(array.invalid("shape", &expected, format!("{:?}", array.shape)));
        }
    }
    let mut parts = Parts { shape, ..Parts::default() };
    if has(archive, FACES) {
        let mut array = array(archive, path, FACES)?;
        let axes = parts.shape.get(1..parts.shape.len().max(2) - 1).unwrap_or_default();
        let vertices = axes.iter().map(|&axis| axis as f64).product::<f64>();
        // An invalid vertex index becomes `u32::MAX`, which the test below finds.
        let number = |x: f64| if x >= 0.0 && x < vertices && x.fract() == 0.0 { x as u32 } else { u32::MAX };
        let faces = array.triples(number)?;
        if faces.as_flattened().contains(&u32::MAX) {
            return Err(array.invalid("elements", &format!("vertex numbers below {vertices}"), "others"));
        }
        parts.faces = faces;
    }
    if has(archive, RATE) {
        let mut array = array(archive, path, RATE)?;
        let values = array.read(|x| x)?;
        let rate = values.first().copied().filter(|x| values.len() == 1 && x.is_finite() && *x > 0.0);
        parts.fps = Some(rate.ok_or_else(|| array.invalid("value", "one number above 0 [1/s]", &values))?);
    }
    Ok(parts)
}

/// Reads one array of floating-point numbers of an NPZ file; `None` if it has none of this name.
pub fn read_npz_array(path: impl AsRef<Path>, name: &str) -> Result<Option<ArrayD<f64>>> {
    let path = path.as_ref();
    let mut archive = archive(path)?;
    if !has(&archive, name) {
        return Ok(None);
    }
    array(&mut archive, path, name)?.of_floats()?.read(|x| x).map(Some)
}

/// Opens an array of an archive.
fn array<'a, R: io::Read + Seek>(
    archive: &'a mut Archive<R>,
    path: &Path,
    name: &str,
) -> Result<Array<impl io::Read + 'a>, Error> {
    let (reader, size) = archive.entry(&format!("{name}.npy"))?;
    Array::open(reader, size, format!("{}: {name}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloth::Grid;
    use crate::io::{Frames, ReadOptions, Trajectory, WriteOptions};

    #[test]
    fn archives_of_long_entries_are_read_too() {
        let mut trajectory = Trajectory::new(Grid { h: 3, w: 4 }, 24.0);
        for frame in 0..5 {
            let points: Vec<[f32; 3]> = (0..12).map(|p| [p as f32, frame as f32, 0.5]).collect();
            trajectory.push(&points, &points);
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("long.npz");
        let (topology, options) = (trajectory.topology(), &WriteOptions::default());
        let clip = Clip { frames: &trajectory, topology: &topology, options };
        write_arrays(&clip, std::fs::File::create(&path).unwrap(), true).unwrap();
        assert_eq!(Trajectory::read(&path, &ReadOptions::default()).unwrap(), trajectory);
    }
}
