//! Frames on disk, for runs of any length.

use super::{Format, Frames, Topology, WriteOptions, npz, write};
use crate::{Error, Result};
use ndarray::ArrayD;
use std::{
    borrow::Cow,
    fs::File,
    io::{self, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

/// The sink of a run: takes its frames one after another and writes them in any [`Format`]. Meanwhile they are in
/// temporary files without a name, so its memory does not depend on their number, and a run that is killed leaves nothing.
///
/// ```
/// use fnopt::io::{Format, Recording, Topology, WriteOptions};
///
/// let folder = tempfile::tempdir().unwrap();
/// let square = Topology::new(4, [[0, 1, 2, 3]])?.with_normals();
/// let mut recording = Recording::new(folder.path(), square, 24.0)?;
/// for frame in 0..48 {
///     let z = 0.1 * frame as f32;
///     let positions = [[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]];
///     recording.push(&positions, &[[0.0, 0.0, 2.4]; 4])?;
/// }
/// recording.write(folder.path(), "square", Format::Usda, &WriteOptions::default())?;
/// # Ok::<(), fnopt::Error>(())
/// ```
pub struct Recording {
    topology: Topology,
    fps: f64,
    frames: usize,
    /// Positions and velocities.
    spools: [Spool; 2],
    beside: Vec<(String, ArrayD<f64>)>,
}

impl Recording {
    /// Creates a recording without frames, whose temporary files are in `folder`; `fps` is the number of frames per second
    /// [1/s]. Fails if the files cannot be created. Panics if `fps` is not a finite number above 0.
    pub fn new(folder: impl AsRef<Path>, topology: impl Into<Topology>, fps: f64) -> Result<Self> {
        assert!(fps.is_finite() && fps > 0.0, "frames per second are above 0");
        let spool = || Spool::new(folder.as_ref());
        let spools = [spool()?, spool()?];
        Ok(Self { topology: topology.into(), fps, frames: 0, spools, beside: Vec::new() })
    }

    /// Appends a frame: positions \[m\] and velocities [m/s], shape [V, 3] each. Fails, and keeps the frames before it, if
    /// the disk is full. Panics on other shapes.
    pub fn push(&mut self, positions: &[[f32; 3]], velocities: &[[f32; 3]]) -> Result<()> {
        let vertices = self.topology.vertices();
        let given = [positions.len(), velocities.len()];
        assert_eq!(given, [vertices; 2], "positions and velocities of a frame, for vertices of the topology");
        for (spool, points) in self.spools.iter_mut().zip([positions, velocities]) {
            spool.put(self.frames, points)?;
        }
        self.frames += 1;
        Ok(())
    }

    /// Appends the frames of an NPZ file that a rollout has written, one by one, like [`Recording::push`]. Fails if they
    /// have another number of vertices or numbers that are not finite.
    pub fn extend_from(&mut self, path: impl AsRef<Path>) -> Result<()> {
        let (path, vertices) = (path.as_ref(), self.topology.vertices());
        let origin = path.display().to_string();
        let shape = npz::read_outline(path)?.shape;
        let &[frames, found, 3] = &shape[..] else {
            return Err(Error::invalid(origin, "shape", "[frames, vertices, 3]", format!("{shape:?}")));
        };
        if found != vertices {
            return Err(Error::invalid(origin, "vertices", vertices.to_string(), found));
        }
        let mut next = [self.frames; 2];
        npz::for_each_frame(path, vertices, |which, points| {
            if let Some(at) = points.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
                let field = format!("frame {}, vertex {at}", next[which] - self.frames);
                return Err(Error::invalid(&origin, field, "finite numbers", format!("{:?}", points[at])));
            }
            self.spools[which].put(next[which], points)?;
            next[which] += 1;
            Ok(())
        })?;
        self.frames += frames;
        Ok(())
    }

    /// Puts an array beside the frames, which only NPZ files hold ([`read_npz_array`](super::read_npz_array)). It replaces one of the same
    /// name.
    pub fn put_beside(&mut self, name: &str, array: ArrayD<f64>) {
        self.beside.retain(|(other, _)| other != name);
        self.beside.push((name.to_owned(), array));
    }

    /// Writes the frames so far as [`write()`] does. A vertex cache ([`Format::is_vertex_cache`]) moves the vertices of a mesh beside it, which
    /// [`write_mesh`](super::write_mesh) writes.
    pub fn write(
        &self,
        dir: impl AsRef<Path>,
        name: &str,
        format: Format,
        options: &WriteOptions,
    ) -> Result<PathBuf> {
        write(self, dir, name, format, options)
    }

    fn get(&self, which: usize, frame: usize) -> io::Result<Cow<'_, [[f32; 3]]>> {
        assert!(frame < self.frames, "frame {frame} of {}", self.frames);
        self.spools[which].get(frame, self.topology.vertices()).map(Cow::Owned)
    }
}

impl Frames for Recording {
    fn topology(&self) -> Cow<'_, Topology> {
        Cow::Borrowed(&self.topology)
    }

    fn fps(&self) -> f64 {
        self.fps
    }

    fn frames(&self) -> usize {
        self.frames
    }

    fn positions_of(&self, frame: usize) -> io::Result<Cow<'_, [[f32; 3]]>> {
        self.get(0, frame)
    }

    fn velocities_of(&self, frame: usize) -> io::Result<Cow<'_, [[f32; 3]]>> {
        self.get(1, frame)
    }

    fn beside(&self) -> &[(String, ArrayD<f64>)] {
        &self.beside
    }
}

/// A temporary file of arrays of the same length.
struct Spool {
    /// Pictures are drawn by several threads.
    file: Mutex<File>,
    folder: PathBuf,
}

impl Spool {
    fn new(folder: &Path) -> Result<Self> {
        let file = tempfile::tempfile_in(folder);
        let file = file.map_err(|e| Error::io(folder, "cannot create a temporary file", e))?;
        Ok(Self { file: Mutex::new(file), folder: folder.to_owned() })
    }

    /// Writes an array in the place of number `k`.
    fn put(&mut self, k: usize, points: &[[f32; 3]]) -> Result<()> {
        let file = self.file.get_mut().unwrap_or_else(PoisonError::into_inner);
        let written = file
            .seek(SeekFrom::Start((k * size_of_val(points)) as u64))
            .and_then(|_| file.write_all(bytemuck::cast_slice(points)));
        written.map_err(|e| Error::io(&self.folder, "cannot write a temporary file", e))
    }

    /// Reads array `k` back, each of which has so many points.
    fn get(&self, k: usize, points: usize) -> io::Result<Vec<[f32; 3]>> {
        let mut found = vec![[0.0; 3]; points];
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start((k * size_of_val(&found[..])) as u64))?;
        file.read_exact(bytemuck::cast_slice_mut(&mut found))?;
        Ok(found)
    }
}
