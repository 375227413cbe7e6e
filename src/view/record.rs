//! What the viewer writes: recordings and pictures, under names that are not taken.

use crate::Result;
use crate::io::{Format, Frames, Recording, WriteOptions, create_folder};
use crate::scene::Setup;
use std::path::{Path, PathBuf};

/// A recording in progress: its frames are in temporary files until it ends.
pub struct Recorder {
    recording: Recording,
    folder: PathBuf,
}

impl Recorder {
    /// Begins a recording without frames in a folder, which is created if there is none. Fails if that cannot be written into.
    pub fn new(folder: &Path, setup: &Setup) -> Result<Self> {
        create_folder(folder)?;
        let recording = Recording::new(folder, setup.particle_topology(), 1.0 / setup.units.frame_time_s)?;
        Ok(Self { recording, folder: folder.to_owned() })
    }

    pub(super) fn push(&mut self, positions: &[[f32; 3]], velocities: &[[f32; 3]]) -> Result<()> {
        self.recording.push(positions, velocities)
    }

    /// Returns the number of frames so far.
    pub fn frames(&self) -> usize {
        self.recording.frames()
    }

    /// Writes the frames as an NPZ file, as a rollout does, and returns its path; `None` if there are no frames.
    pub fn finish(self) -> Result<Option<PathBuf>> {
        if self.frames() == 0 {
            return Ok(None);
        }
        let name = free_name(&self.folder, "view", "npz");
        self.recording.write(&self.folder, &name, Format::Npz, &WriteOptions::default()).map(Some)
    }
}

/// Returns the first of NAME, NAME-2, NAME-3, .. that is no file's in the folder with this extension.
pub(super) fn free_name(folder: &Path, name: &str, extension: &str) -> String {
    let numbered = (2..).map(|k| format!("{name}-{k}"));
    let mut names = std::iter::once(name.to_owned()).chain(numbered);
    names.find(|name| !folder.join(format!("{name}.{extension}")).exists()).unwrap_or_default()
}
