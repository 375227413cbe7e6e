//! The frames of a run.

use super::{Format, Frames, Topology, WriteOptions, folder, mdd, mesh, npy, npz, pc2, write, write_mesh};
use crate::cloth::{Grid, Intersection, Mask, intersections};
use crate::{Error, Result, memory};
use ndarray::ArrayView3;
use std::{
    borrow::Cow,
    io,
    path::{Path, PathBuf},
};

/// The frames of one cloth: positions and velocities at equal time intervals.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    grid: Grid,
    mask: Option<Mask>,
    fps: f64,
    positions: Vec<[f32; 3]>,
    velocities: Vec<[f32; 3]>,
}

/// Properties of a trajectory that a file may lack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadOptions {
    /// The grid. If `None`, it is the one that the faces in the file determine.
    pub grid: Option<Grid>,
    /// The grid of a file that has as many vertices and whose faces do not determine one. With other numbers
    /// of vertices, or if `None`, it must be square.
    pub likely_grid: Option<Grid>,
    /// Frames per second [1/s] if the file does not specify them.
    pub fps: f64,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { grid: None, likely_grid: None, fps: 60.0 }
    }
}

/// The contents of a file, as found by a reader.
#[derive(Default)]
pub(super) struct Parts {
    /// Shape of the positions in the file; [`with_vertices`] joins the axes of a grid to one of vertices.
    pub shape: Vec<usize>,
    /// The grid, if the positions had its axes.
    pub grid: Option<Grid>,
    pub positions: Vec<[f32; 3]>,
    pub velocities: Option<Vec<[f32; 3]>>,
    pub faces: Vec<[u32; 3]>,
    pub fps: Option<f64>,
}

impl Trajectory {
    /// Creates a trajectory without frames; `fps` is the number of frames per second [1/s]. Panics if there
    /// are no particles, or if `fps` is not a finite number above 0.
    pub fn new(grid: Grid, fps: f64) -> Self {
        assert!(grid.particles() > 0, "a trajectory has particles");
        assert!(fps.is_finite() && fps > 0.0, "frames per second are above 0");
        Self { grid, mask: None, fps, positions: Vec::new(), velocities: Vec::new() }
    }

    /// Returns it as that of a cloth with this mask. Panics if the mask is of another grid.
    pub fn with_mask(self, mask: Option<Mask>) -> Self {
        assert!(mask.as_ref().is_none_or(|mask| mask.grid() == self.grid), "a mask is of the cloth's grid");
        Self { mask, ..self }
    }

    /// Reserves room for `frames` more frames, so that pushing them does not reallocate. Fails if there is
    /// not enough memory.
    pub fn reserve(&mut self, frames: usize) -> Result<()> {
        let points = frames.saturating_mul(self.grid.particles());
        let what = format!("{frames} frames of {}", self.grid);
        memory::reserve_each([&mut self.positions, &mut self.velocities], points, &what)
    }

    /// Appends a frame: positions \[m\] and velocities [m/s], shape [V, 3] each. Panics on other shapes.
    pub fn push(&mut self, positions: &[[f32; 3]], velocities: &[[f32; 3]]) {
        let vertices = self.grid.particles();
        assert!(
            positions.len() == vertices && velocities.len() == vertices,
            "a frame has a position and a velocity for each particle"
        );
        self.positions.extend_from_slice(positions);
        self.velocities.extend_from_slice(velocities);
    }

    /// Returns the triangles of the cloth, particles by number.
    pub fn faces(&self) -> Vec<[u32; 3]> {
        self.mask.as_ref().map_or_else(|| self.grid.faces(), Mask::faces)
    }

    /// Returns the grid of particles.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Returns the number of frames per second [1/s].
    pub fn fps(&self) -> f64 {
        self.fps
    }

    /// Returns the number of frames (F).
    pub fn frames(&self) -> usize {
        self.positions.len() / self.grid.particles()
    }

    /// Returns the positions of one frame \[m\], shape [V, 3]. Panics if there is no such frame.
    pub fn frame(&self, frame: usize) -> &[[f32; 3]] {
        let vertices = self.grid.particles();
        &self.positions[frame * vertices..][..vertices]
    }

    /// Returns where the cloth passes through itself in one frame ([`intersections`]). Panics if there is no such frame.
    pub fn intersections(&self, frame: usize) -> Vec<Intersection> {
        intersections_of(&self.faces(), self.frame(frame))
    }

    /// Returns the velocities of one frame [m/s], shape [V, 3]. Panics if there is no such frame.
    pub fn frame_velocities(&self, frame: usize) -> &[[f32; 3]] {
        let vertices = self.grid.particles();
        &self.velocities[frame * vertices..][..vertices]
    }

    /// Returns the positions \[m\], shape [F, V, 3].
    pub fn positions(&self) -> ArrayView3<'_, f32> {
        self.view(&self.positions)
    }

    /// Returns the velocities [m/s], shape [F, V, 3].
    pub fn velocities(&self) -> ArrayView3<'_, f32> {
        self.view(&self.velocities)
    }

    fn view<'a>(&self, data: &'a [[f32; 3]]) -> ArrayView3<'a, f32> {
        let shape = (self.frames(), self.grid.particles(), 3);
        ArrayView3::from_shape(shape, data.as_flattened()).expect("whole frames were pushed")
    }

    /// Writes the trajectory into the folder `dir`, with the default options, as [`write()`] does.
    pub fn write(&self, dir: impl AsRef<Path>, name: &str, format: Format) -> Result<PathBuf> {
        write(self, dir, name, format, &WriteOptions::default())
    }

    /// Writes frame 0 as an OBJ file: the mesh that a vertex cache animates. Panics if there are no frames.
    pub fn write_mesh(&self, path: impl AsRef<Path>) -> Result<()> {
        write_mesh(self, path)
    }

    /// Reads a trajectory from an npz, npy, pc2 or mdd file or a folder of OBJ files, whose names end in
    /// consecutive numbers. Arrays are [frames, vertices, 3] or [frames, H, W, 3]. Positions and velocities
    /// must be finite. If the file has no velocities, they are the differences to the previous positions over
    /// the frame time, and 0 in the first frame.
    pub fn read(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Self> {
        let path = path.as_ref();
        Self::read_as_it_is(path, options)?.finite(path)
    }

    /// Reads a trajectory like [`Trajectory::read`], but accepts non-finite numbers.
    pub(crate) fn read_as_it_is(path: &Path, options: &ReadOptions) -> Result<Self> {
        Self::from_parts(read_parts(path)?, options, &path.display().to_string())
    }

    /// Reads what an NPZ file says of its frames, without them: their grid and rate, of a trajectory without frames, and
    /// their number.
    pub fn read_outline(path: impl AsRef<Path>, options: &ReadOptions) -> Result<(Self, usize)> {
        let path = path.as_ref();
        let parts = Parts { velocities: Some(Vec::new()), ..with_vertices(npz::read_outline(path)?) };
        let frames = parts.shape.first().copied().unwrap_or_default();
        Ok((Self::from_parts(parts, options, &path.display().to_string())?, frames))
    }

    /// Reads vertices that need not form a grid, as a grid of a single row. Accepts non-finite numbers.
    pub(crate) fn read_vertices(path: &Path, fps: f64) -> Result<Self> {
        let parts = Parts { faces: Vec::new(), grid: None, ..read_parts(path)? };
        let grid = parts.shape.get(1).map(|&vertices| Grid { h: 1, w: vertices });
        Self::from_parts(parts, &ReadOptions { grid, likely_grid: None, fps }, &path.display().to_string())
    }

    fn from_parts(parts: Parts, options: &ReadOptions, origin: &str) -> Result<Self> {
        let &[frames, vertices, 3] = &parts.shape[..] else {
            let expected = "[frames, vertices, 3] or [frames, H, W, 3]";
            return Err(Error::invalid(origin, "shape", expected, format!("{:?}", parts.shape)));
        };
        if !(options.fps.is_finite() && options.fps > 0.0) {
            return Err(Error::invalid(origin, "fps", "a number above 0", options.fps));
        }
        if frames == 0 || vertices == 0 {
            let found = format!("{frames} frames of {vertices}");
            return Err(Error::invalid(origin, "shape", "at least one frame and vertex", found));
        }
        let side = vertices.isqrt();
        let square = (side * side == vertices).then_some(Grid { h: side, w: side });
        let of_faces = mesh::grid_of(vertices, &parts.faces);
        for (field, of_file) in [("faces", of_faces), ("shape", parts.grid)] {
            if let (Some(given), Some(of_file)) = (options.grid, of_file)
                && given != of_file
            {
                let (expected, found) = (format!("those of {given}"), format!("those of {of_file}"));
                return Err(Error::invalid(origin, field, expected, found));
            }
        }
        let likely = options.likely_grid.filter(|grid| grid.particles() == vertices);
        let grid = options.grid.or(of_faces).or(parts.grid).or(likely).or(square);
        let Some(grid) = grid.filter(|g| g.particles() == vertices) else {
            let expected = match (options.grid, options.likely_grid) {
                (Some(grid), _) => format!("those of {grid}"),
                (None, Some(grid)) => format!("those of {grid} or of a square grid"),
                (None, None) => "those of a square grid".into(),
            };
            return Err(Error::invalid(origin, "vertices", expected, vertices));
        };
        let mut trajectory = Self::new(grid, parts.fps.unwrap_or(options.fps));
        let fps = trajectory.fps as f32;
        let velocities = parts.velocities.unwrap_or_else(|| {
            let moved = parts.positions.iter().zip(&parts.positions[vertices..]);
            let velocities = moved.map(|(a, b)| std::array::from_fn(|k| (b[k] - a[k]) * fps));
            std::iter::repeat_n([0.0; 3], vertices).chain(velocities).collect()
        });
        (trajectory.positions, trajectory.velocities) = (parts.positions, velocities);
        Ok(trajectory)
    }

    /// Returns this trajectory, which was read from `origin`. Fails if one of its numbers is not finite.
    pub(crate) fn finite(self, origin: &Path) -> Result<Self> {
        let vertices = self.grid.particles();
        for values in [&self.positions, &self.velocities] {
            if let Some(at) = values.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
                let (origin, found) = (origin.display().to_string(), format!("{:?}", values[at]));
                let field = format!("frame {}, vertex {}", at / vertices, at % vertices);
                return Err(Error::invalid(origin, field, "finite numbers", found));
            }
        }
        Ok(self)
    }
}

impl Frames for Trajectory {
    fn topology(&self) -> Cow<'_, Topology> {
        Cow::Owned(Topology::of_cloth(self.grid, self.mask.as_ref()))
    }

    fn fps(&self) -> f64 {
        self.fps
    }

    fn frames(&self) -> usize {
        self.frames()
    }

    fn positions_of(&self, frame: usize) -> io::Result<Cow<'_, [[f32; 3]]>> {
        Ok(self.frame(frame).into())
    }

    fn velocities_of(&self, frame: usize) -> io::Result<Cow<'_, [[f32; 3]]>> {
        Ok(self.frame_velocities(frame).into())
    }
}

/// Returns where a cloth at these positions passes through itself ([`intersections`]).
pub(crate) fn intersections_of(faces: &[[u32; 3]], positions: &[[f32; 3]]) -> Vec<Intersection> {
    let by_axis = (0..3).flat_map(|c| positions.iter().map(move |p| f64::from(p[c])));
    intersections(faces, &by_axis.collect::<Vec<_>>())
}

fn read_parts(path: &Path) -> Result<Parts> {
    read_file(path).map(with_vertices)
}

/// Joins the axes of a grid to one of vertices.
fn with_vertices(mut parts: Parts) -> Parts {
    if let &[frames, h, w, 3] = &parts.shape[..] {
        parts.grid = Some(Grid { h, w });
        parts.shape = vec![frames, h.saturating_mul(w), 3];
    }
    parts
}

fn read_file(path: &Path) -> Result<Parts> {
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    match extension.to_str() {
        _ if path.is_dir() => folder::read(path),
        Some("npz") => npz::read(path),
        Some("pc2") => pc2::read(path),
        Some("mdd") => mdd::read(path),
        Some("npy") => {
            let mut array = npy::open_npy(path)?.of_floats()?;
            let shape = array.shape.clone();
            Ok(Parts { shape, positions: array.triples(|x| x as f32)?, ..Parts::default() })
        }
        other => {
            let expected = "an npz, npy, pc2 or mdd file or a folder of OBJ files";
            let found = match other.and_then(|name| name.parse::<Format>().ok()) {
                Some(format) => format!("{format}, which is written only"),
                None => "another one".into(),
            };
            Err(Error::invalid(path.display().to_string(), "type", expected, found))
        }
    }
}
