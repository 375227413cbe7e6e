//! The frames of a run.

use super::atomic::UNFINISHED;
use super::{Format, create_folder, entries, mdd, mesh, npy, npz, obj, pc2, ply, read_obj, write_atomic};
use crate::cloth::{Grid, Intersection, intersections};
use crate::{Error, Result, memory};
use ndarray::{ArrayD, ArrayView3};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// The frames of one cloth: positions and velocities at equal time intervals.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    grid: Grid,
    fps: f64,
    positions: Vec<[f32; 3]>,
    velocities: Vec<[f32; 3]>,
    /// Arrays that an NPZ file holds beside the frames.
    beside: Vec<(String, ArrayD<f64>)>,
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
    /// Shape of the positions in the file; [`read_parts`] joins the axes of a grid to one of vertices.
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
        Self { grid, fps, positions: Vec::new(), velocities: Vec::new(), beside: Vec::new() }
    }

    /// Puts an array beside the frames, which only NPZ files hold and [`Trajectory::read`] does not read. It replaces one
    /// of the same name.
    pub fn put_beside(&mut self, name: &str, array: ArrayD<f64>) {
        self.beside.retain(|(other, _)| other != name);
        self.beside.push((name.to_owned(), array));
    }

    /// Returns the arrays beside the frames with their names.
    pub(super) fn beside(&self) -> &[(String, ArrayD<f64>)] {
        &self.beside
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
        let positions = self.frame(frame);
        let by_axis = (0..3).flat_map(|c| positions.iter().map(move |p| f64::from(p[c])));
        intersections(&self.grid.faces(), &by_axis.collect::<Vec<_>>())
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

    /// Writes the trajectory into the folder `dir` and returns the path: the file `NAME.EXT`, or for OBJ and
    /// PLY the folder `NAME_EXT` with a file `00000.EXT` per frame. Each file appears only once it is
    /// complete. Files that a longer run left in such a folder are removed. Fails if the format
    /// [cannot hold](Format::check_capacity) the trajectory.
    pub fn write(&self, dir: impl AsRef<Path>, name: &str, format: Format) -> Result<PathBuf> {
        let file = dir.as_ref().join(format!("{name}.{format}"));
        let folder = dir.as_ref().join(format!("{name}_{format}"));
        format.check_capacity(self.frames(), &file.display().to_string())?;
        match format {
            Format::Npz => write_atomic(&file, |w| npz::write(self, w)).map(|()| file),
            Format::Npy => {
                let positions = self.positions();
                let write = |w: &mut _| npy::write(w, positions.shape(), positions.iter().copied());
                write_atomic(&file, write).map(|()| file)
            }
            Format::Pc2 => write_atomic(&file, |w| pc2::write(self, w)).map(|()| file),
            Format::Mdd => write_atomic(&file, |w| mdd::write(self, w)).map(|()| file),
            Format::Obj | Format::Ply => self.write_frames(folder, format),
        }
    }

    /// Writes frame 0 as an OBJ file: the mesh that a PC2 cache animates. Panics if there are no frames.
    pub fn write_mesh(&self, path: impl AsRef<Path>) -> Result<()> {
        write_atomic(path, |w| obj::write(self.grid, self.frame(0), w))
    }

    fn write_frames(&self, folder: PathBuf, format: Format) -> Result<PathBuf> {
        let name = |f: usize| format!("{f:05}.{format}");
        create_folder(&folder)?;
        // Only names that a run would have written are replaced: `7.obj` belongs to the user.
        let mut earlier = frame_files(&folder, format)?;
        earlier.retain(|(_, f, path)| path.file_name().is_some_and(|found| *found == *name(*f)));
        let earlier: Vec<PathBuf> = earlier.into_iter().map(|(.., path)| path).collect();
        let new = (0..self.frames()).map(|f| folder.join(name(f)));
        if let Some(in_the_way) = new.chain(earlier.iter().cloned()).find(|path| path.is_dir()) {
            return Err(Error::invalid(in_the_way.display().to_string(), "type", "a file", "a folder"));
        }
        // Frames of two runs in one folder would be read as one sequence, so none is in its place before all
        // are written. What a run that was killed has left is of no use.
        for left in unfinished(&folder)? {
            std::fs::remove_dir_all(&left).map_err(|e| Error::io(&left, "cannot remove", e))?;
        }
        let unfinished = tempfile::Builder::new().prefix(UNFINISHED).tempdir_in(&folder);
        let unfinished = unfinished.map_err(|e| Error::io(&folder, "cannot create a folder", e))?;
        (0..self.frames()).into_par_iter().try_for_each(|f| {
            write_atomic(unfinished.path().join(name(f)), |w| match format {
                Format::Ply => ply::write(self.grid, self.frame(f), w),
                _ => obj::write(self.grid, self.frame(f), w),
            })
        })?;
        earlier.iter().try_for_each(|path| super::remove(path))?;
        for f in 0..self.frames() {
            let to = folder.join(name(f));
            std::fs::rename(unfinished.path().join(name(f)), &to)
                .map_err(|e| Error::io(&to, "cannot write", e))?;
        }
        Ok(folder)
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

fn read_parts(path: &Path) -> Result<Parts> {
    let mut parts = read_file(path)?;
    if let &[frames, h, w, 3] = &parts.shape[..] {
        parts.grid = Some(Grid { h, w });
        parts.shape = vec![frames, h.saturating_mul(w), 3];
    }
    Ok(parts)
}

fn read_file(path: &Path) -> Result<Parts> {
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    match extension.to_str() {
        _ if path.is_dir() => read_folder(path),
        Some("npz") => npz::read(path),
        Some("pc2") => pc2::read(path),
        Some("mdd") => mdd::read(path),
        Some("npy") => {
            let mut array = npy::open_npy(path)?.of_floats()?;
            let shape = array.shape.clone();
            Ok(Parts { shape, positions: array.triples(|x| x as f32)?, ..Parts::default() })
        }
        _ => {
            let expected = "an npz, npy, pc2 or mdd file or a folder of OBJ files";
            Err(Error::invalid(path.display().to_string(), "type", expected, "another one"))
        }
    }
}

/// Returns the numbered files of a folder of frames, in order, each with the beginning of its name, its number,
/// and its path: `cloth_0007.obj` begins with `cloth_` and has number 7.
fn frame_files(folder: &Path, format: Format) -> Result<Vec<(String, usize, PathBuf)>> {
    let mut files = Vec::new();
    for path in entries(folder)? {
        let of_format = path.extension().is_some_and(|e| e == format.name());
        let stem = path.file_stem().and_then(|s| s.to_str()).filter(|_| of_format).unwrap_or_default();
        let name = stem.trim_end_matches(|c: char| c.is_ascii_digit());
        if let Ok(number) = stem[name.len()..].parse() {
            files.push((name.to_owned(), number, path));
        }
    }
    files.sort();
    Ok(files)
}

/// Returns the folders of frames that a run has not put into their place. Only one that was killed leaves any.
fn unfinished(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = entries(folder)?;
    let is_prefixed = |path: &PathBuf| {
        path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.starts_with(UNFINISHED))
    };
    found.retain(|path| is_prefixed(path) && path.is_dir());
    Ok(found)
}

/// Reads a sequence of OBJ files with consecutive numbers, which may begin anywhere.
fn read_folder(folder: &Path) -> Result<Parts> {
    // The files beside it may be a part of one run, or parts of two.
    if let Some(left) = unfinished(folder)?.first() {
        let expected = format!("all frames in their place; {} is of a run that was killed", left.display());
        return Err(Error::invalid(folder.display().to_string(), "frames", expected, "perhaps a part"));
    }
    let mut files = frame_files(folder, Format::Obj)?;
    // Next to files that are called by their number alone, others are not frames.
    if files.first().is_some_and(|(name, ..)| name.is_empty()) {
        files.retain(|(name, ..)| name.is_empty());
    }
    let mut parts = Parts::default();
    for (k, (name, number, path)) in files.iter().enumerate() {
        let bad = |field: &str, expected: String, found: String| {
            Err(Error::invalid(path.display().to_string(), field, expected, found))
        };
        let (first_name, first, _) = &files[0];
        if name != first_name {
            let expected = format!("'{first_name}' and a number, as in the other files");
            return bad("name", expected, format!("'{name}'"));
        }
        if *number != first + k {
            return bad("number", (first + k).to_string(), number.to_string());
        }
        let mesh = read_obj(path)?;
        if k == 0 {
            parts.shape = vec![files.len(), mesh.positions.len(), 3];
            parts.faces = mesh.faces;
        } else if mesh.positions.len() != parts.shape[1] {
            return bad(
                "vertices",
                format!("{} as in the first file", parts.shape[1]),
                mesh.positions.len().to_string(),
            );
        }
        parts.positions.extend(mesh.positions);
    }
    if files.is_empty() {
        let expected = "numbered OBJ files such as 00000.obj";
        return Err(Error::invalid(folder.display().to_string(), "content", expected, "none"));
    }
    Ok(parts)
}
