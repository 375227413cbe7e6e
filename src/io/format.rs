//! The file formats for trajectories.

use super::{Topology, glb};
use crate::{Error, Result};
use std::{fmt, str::FromStr};

/// A file format for a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Format {
    /// NumPy archive: `vertices_seq` and `velocities_seq [F, V, 3]`, `faces [T, 3]`, `vertices_uv [V, 2]`, `fps`.
    Npz,
    /// NumPy array of positions, `[F, V, 3]`.
    Npy,
    /// A folder with a Wavefront OBJ file per frame, with texture coordinates.
    Obj,
    /// A folder with a binary little-endian PLY file per frame, with normals.
    Ply,
    /// PointCache2, the vertex cache of Blender's Mesh Cache modifier and of 3ds Max.
    Pc2,
    /// NewTek's MDD, a vertex cache that Blender's Mesh Cache modifier, Maya, Houdini and LightWave read.
    Mdd,
    /// USD as text: a mesh with time-sampled points, velocities, normals and extent, in metres.
    Usda,
    /// Binary glTF: a morph target for each frame but the first, for short clips.
    Glb,
}

impl Format {
    /// All formats.
    pub const ALL: [Format; 8] =
        [Self::Npz, Self::Npy, Self::Obj, Self::Ply, Self::Pc2, Self::Mdd, Self::Usda, Self::Glb];

    /// Those of which a single file holds a trajectory that can be read ([`Trajectory::read`](super::Trajectory::read)).
    pub const SINGLE_FILES: [Format; 4] = [Self::Npz, Self::Npy, Self::Pc2, Self::Mdd];

    /// Whether it holds positions alone, and moves the vertices of a mesh that is imported beside it.
    pub fn is_vertex_cache(self) -> bool {
        matches!(self, Self::Pc2 | Self::Mdd)
    }

    /// Whether it holds the particles of a cloth even if that carries a mesh along: simulations go on from it.
    pub fn holds_particles(self) -> bool {
        matches!(self, Self::Npz | Self::Npy)
    }

    /// Returns the name of the format, which is also its file extension.
    pub fn name(self) -> &'static str {
        match self {
            Self::Npz => "npz",
            Self::Npy => "npy",
            Self::Obj => "obj",
            Self::Ply => "ply",
            Self::Pc2 => "pc2",
            Self::Mdd => "mdd",
            Self::Usda => "usda",
            Self::Glb => "glb",
        }
    }

    /// Whether it is a folder with a file per frame.
    pub fn is_folder(self) -> bool {
        matches!(self, Self::Obj | Self::Ply)
    }

    /// Checks that a file of this format can hold `frames` frames of a mesh. Fails with an error that names `origin`.
    pub fn check_capacity(self, topology: &Topology, frames: usize, origin: &str) -> Result<()> {
        match self {
            cache if cache.is_vertex_cache() && i32::try_from(frames).is_err() => {
                Err(Error::invalid(origin, self.name(), "at most 2^31 - 1 frames", frames))
            }
            Self::Glb => glb::check_capacity(topology, frames, origin),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Format {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|f| f.name().eq_ignore_ascii_case(name.trim()));
        known.ok_or_else(|| Error::unknown("trajectory", "format", name, Self::ALL.map(Self::name)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloth::Grid;

    #[test]
    fn names_round_trip_and_misspellings_get_a_suggestion() {
        for format in Format::ALL {
            assert_eq!(format.to_string().parse::<Format>().unwrap(), format);
        }
        let error = "npzz".parse::<Format>().unwrap_err().to_string();
        assert!(error.contains("unknown format 'npzz' (did you mean npz"), "{error}");
    }

    #[test]
    fn frames_beyond_a_format_are_refused_beforehand() {
        let topology = Topology::from(Grid { h: 8, w: 8 });
        for format in Format::ALL.into_iter().filter(|format| *format != Format::Glb) {
            format.check_capacity(&topology, 1_000_000, "--format").unwrap();
        }
        let error = Format::Pc2.check_capacity(&topology, 1 << 31, "--format").unwrap_err().to_string();
        assert!(error.contains("pc2: expected at most 2^31 - 1 frames"), "{error}");
    }
}
