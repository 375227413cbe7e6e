//! Frames, wherever they are kept, and what every format makes of them.

use super::{Format, Topology, folder, glb, mdd, npy, npz, obj, pc2, usda, write_atomic};
use crate::{Error, Result};
use ndarray::ArrayD;
use std::{
    borrow::Cow,
    io::{self, Write},
    path::{Path, PathBuf},
};

/// The frames of a trajectory at equal time intervals, in memory ([`Trajectory`](super::Trajectory)) or on disk
/// ([`Recording`](super::Recording)).
pub trait Frames: Sync {
    /// Returns the mesh that moves.
    fn topology(&self) -> Cow<'_, Topology>;

    /// Returns the number of frames per second [1/s].
    fn fps(&self) -> f64;

    /// Returns the number of frames (F).
    fn frames(&self) -> usize;

    /// Returns the positions of one frame \[m\], shape [V, 3]. Fails if they cannot be read back. Panics if there is no
    /// such frame.
    fn positions_of(&self, frame: usize) -> io::Result<Cow<'_, [[f32; 3]]>>;

    /// Returns the velocities of one frame [m/s] like [`Frames::positions_of`].
    fn velocities_of(&self, frame: usize) -> io::Result<Cow<'_, [[f32; 3]]>>;

    /// Returns arrays, with their names, that only NPZ files hold.
    fn beside(&self) -> &[(String, ArrayD<f64>)] {
        &[]
    }
}

/// What a file is to be like, beyond the frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WriteOptions {
    /// Frames per second that the file names, if not those of the frames: more let them play faster. Velocities stay what
    /// they are, except in USD, whose are those of the file's own time.
    pub fps: Option<f64>,
    /// Number of the first frame in PC2's header, in USD's time codes and in the names of OBJ and PLY files.
    pub start_frame: u32,
    /// Whether z points up instead of y; USD says so, and glTF, which is always y up, is turned.
    pub z_up: bool,
    /// Whether NPZ and NPY files hold positions and velocities in 16 bits: half the size, and 0.5 mm between
    /// neighbouring numbers near 1 m.
    pub half: bool,
    /// Whether NPZ files are deflated.
    pub compress: bool,
}

impl WriteOptions {
    /// Returns the first option that is set, but that none of `formats` heeds, and in words which formats do.
    pub fn unheeded(&self, formats: &[Format]) -> Option<(&'static str, String)> {
        use Format::{Npy, Npz, Obj, Pc2, Ply, Usda};
        let options: [(_, _, &[Format]); 3] = [
            ("half", self.half, &[Npz, Npy]),
            ("compress", self.compress, &[Npz]),
            ("start_frame", self.start_frame > 0, &[Pc2, Usda, Obj, Ply]),
        ];
        let unheeded = |of: &&(_, bool, &[Format])| of.1 && !of.2.iter().any(|f| formats.contains(f));
        let &(name, _, heeding) = options.iter().find(unheeded)?;
        let names: Vec<_> = heeding.iter().map(|format| format.name()).collect();
        Some((name, format!("{}, which it is about", names.join(" or "))))
    }
}

/// Writes frames into the folder `dir` and returns the path: the file `NAME.EXT`, or for OBJ and PLY the folder
/// `NAME_EXT` with a file `00000.EXT` per frame. Each file appears only once it is complete. Files that a longer run left
/// in such a folder are removed. The memory this takes does not depend on the number of frames. Fails if the format
/// [cannot hold](Format::check_capacity) the frames.
pub fn write(
    frames: &dyn Frames,
    dir: impl AsRef<Path>,
    name: &str,
    format: Format,
    options: &WriteOptions,
) -> Result<PathBuf> {
    let file = dir.as_ref().join(format!("{name}.{format}"));
    if let Some(fps) = options.fps.filter(|fps| !(fps.is_finite() && *fps > 0.0)) {
        return Err(Error::invalid(file.display().to_string(), "fps", "a number above 0", fps));
    }
    let clip = Clip { frames, topology: &frames.topology(), options };
    format.check_capacity(clip.topology, clip.count(), &file.display().to_string())?;
    let write: fn(&Clip, &mut io::BufWriter<std::fs::File>) -> io::Result<()> = match format {
        Format::Npz => |clip, writer| npz::write(clip, writer),
        Format::Npy => |clip, writer| npy::write_positions(clip, writer),
        Format::Pc2 => |clip, writer| pc2::write(clip, writer),
        Format::Mdd => |clip, writer| mdd::write(clip, writer),
        Format::Usda => |clip, writer| usda::write(clip, writer),
        Format::Glb => |clip, writer| glb::write(clip, writer),
        Format::Obj | Format::Ply => {
            return folder::write(&clip, dir.as_ref().join(format!("{name}_{format}")), format);
        }
    };
    write_atomic(&file, |writer| write(&clip, writer)).map(|()| file)
}

/// Writes frame 0 as an OBJ file: the mesh that a vertex cache animates. Panics if there are no frames.
pub fn write_mesh(frames: &dyn Frames, path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    let positions = frames.positions_of(0).map_err(|e| Error::io(path, "cannot read back", e))?;
    write_atomic(path, |writer| obj::write(&positions, &obj::rest(&frames.topology()), writer))
}

/// What the writer of a format takes.
pub(super) struct Clip<'a> {
    pub frames: &'a dyn Frames,
    pub topology: &'a Topology,
    pub options: &'a WriteOptions,
}

impl Clip<'_> {
    /// Returns the number of frames.
    pub fn count(&self) -> usize {
        self.frames.frames()
    }

    /// Returns the frames per second that the file names [1/s].
    pub fn fps(&self) -> f64 {
        self.options.fps.unwrap_or(self.frames.fps())
    }

    /// Returns the number of the first frame.
    pub fn start(&self) -> usize {
        self.options.start_frame as usize
    }

    /// Writes the positions of all frames, number by number.
    pub fn write_positions(&self, writer: &mut impl Write, bytes: fn(f32) -> [u8; 4]) -> io::Result<()> {
        let mut buffer = Vec::new();
        for frame in 0..self.count() {
            buffer.clear();
            buffer.extend(self.frames.positions_of(frame)?.as_flattened().iter().flat_map(|&x| bytes(x)));
            writer.write_all(&buffer)?;
        }
        Ok(())
    }
}
