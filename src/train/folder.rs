//! The folder of a run.

use super::checkpoint::Checkpoint;
use crate::{Error, Result, io};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Checkpoints that are kept.
const KEPT: usize = 3;

/// Paths inside the folder of a run.
#[derive(Clone, Debug)]
pub(super) struct Folder {
    root: PathBuf,
}

impl Folder {
    /// Begins a run in a folder, which is made if it is not there; refuses one that holds
    /// checkpoints.
    pub fn create(root: &Path, config: &str) -> Result<Self> {
        let folder = Self { root: root.to_owned() };
        if let Some(path) = folder.checkpoints()?.first() {
            let expected = "none in the folder of a new run (--resume continues an old one)";
            return Err(Error::invalid(root.display().to_string(), "checkpoints", expected, path.display()));
        }
        io::write_atomic(folder.config(), |file| file.write_all(config.as_bytes()))?;
        Ok(folder)
    }

    /// The folder of a run that was begun.
    pub fn open(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    /// The configuration.
    pub fn config(&self) -> PathBuf {
        self.root.join("config.toml")
    }

    /// Means over steps.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.csv")
    }

    /// Validation rollouts.
    pub fn validation(&self) -> PathBuf {
        self.root.join("validation.csv")
    }

    /// The curves.
    pub fn plot(&self) -> PathBuf {
        self.root.join("plot.png")
    }

    /// Weights; `name` is `best` or `last`.
    pub fn weights(&self, name: &str) -> PathBuf {
        self.root.join("weights").join(format!("{name}.safetensors"))
    }

    /// Writes a checkpoint, and only then removes the oldest.
    pub fn keep(&self, checkpoint: &Checkpoint) -> Result<()> {
        let name = format!("step-{:08}.safetensors", checkpoint.counters.step);
        checkpoint.write(&self.checkpoint_dir().join(name))?;
        for path in self.checkpoints()?.iter().skip(KEPT) {
            std::fs::remove_file(path).map_err(|e| Error::io(path, "cannot remove", e))?;
        }
        Ok(())
    }

    /// The newest checkpoint that is whole, and what was wrong with newer ones.
    pub fn newest(&self) -> Result<(Checkpoint, Vec<Error>)> {
        let mut passed_over = Vec::new();
        for path in self.checkpoints()? {
            match Checkpoint::read(&path) {
                Ok(checkpoint) => return Ok((checkpoint, passed_over)),
                Err(error) => passed_over.push(error),
            }
        }
        let found = match passed_over.first() {
            Some(error) => format!("none ({error})"),
            None => "none".to_owned(),
        };
        let dir = self.checkpoint_dir().display().to_string();
        Err(Error::invalid(dir, "checkpoints", "a whole one to resume from", found))
    }

    /// All checkpoints, the newest first; a folder that is missing has none.
    fn checkpoints(&self) -> Result<Vec<PathBuf>> {
        let dir = self.checkpoint_dir();
        let fail = |e| Error::io(&dir, "cannot read", e);
        let mut found: Vec<(u64, PathBuf)> = Vec::new();
        let entries = match std::fs::read_dir(&dir) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(fail)?,
        };
        for entry in entries {
            let path = entry.map_err(fail)?.path();
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let step = name.strip_prefix("step-").and_then(|n| n.strip_suffix(".safetensors"));
            if let Some(step) = step.and_then(|n| n.parse().ok()) {
                found.push((step, path));
            }
        }
        found.sort_by(|a, b| b.cmp(a));
        Ok(found.into_iter().map(|(_, path)| path).collect())
    }

    fn checkpoint_dir(&self) -> PathBuf {
        self.root.join("checkpoints")
    }
}
