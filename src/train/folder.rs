//! The folder of a run.

use super::checkpoint::Checkpoint;
use super::ranks::Ranks;
use crate::{Error, Result, io};
use std::fs::{File, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Number of checkpoints to keep.
const KEPT: usize = 3;

/// Step that [`Folder::newest`] broadcasts when no checkpoint is left.
const NONE: u64 = u64::MAX;

/// The folder of a run and the paths inside it.
#[derive(Debug)]
pub(super) struct Folder {
    root: PathBuf,
    /// The lock file, kept open and locked while this process writes into the folder.
    lock: Option<File>,
}

/// A checkpoint file: the state of one rank after a step.
struct Saved {
    step: u64,
    rank: usize,
    path: PathBuf,
}

impl Folder {
    /// Starts a run in a folder, creating it if necessary. Fails if the folder holds checkpoints or weights.
    pub fn create(root: &Path, config: &str) -> Result<Self> {
        let mut folder = Self::open(root);
        io::create_folder(root)?;
        folder.claim()?;
        let checkpoint = folder.checkpoints()?.into_iter().map(|saved| saved.path).next();
        let weights =
            ["best", "last"].map(|name| folder.weights(name)).into_iter().find(|path| path.exists());
        // Tables next to a configuration belong to a run that ended before its first checkpoint.
        let tables = [folder.metrics(), folder.validation()].into_iter();
        let table = tables.into_iter().find(|path| path.exists() && !folder.config().exists());
        let resumable = checkpoint.is_some();
        for (what, found) in [("checkpoints", checkpoint), ("weights", weights), ("tables", table)] {
            if let Some(path) = found {
                let expected = match resumable {
                    true => "none in the folder of a new run (--resume continues an existing run)",
                    false => "none in the folder of a new run",
                };
                return Err(Error::invalid(root.display().to_string(), what, expected, path.display()));
            }
        }
        // If such a run is restarted, the configuration is the same. Any other may be the only copy: keep it.
        let other = std::fs::read(folder.config()).is_ok_and(|found| found != config.as_bytes());
        if other {
            let expected = "no config.toml of another run in the folder of a new run";
            let found = folder.config().display().to_string();
            return Err(Error::invalid(root.display().to_string(), "configuration", expected, found));
        }
        io::write_atomic(folder.config(), |file| file.write_all(config.as_bytes()))?;
        Ok(folder)
    }

    /// Opens the folder of an existing run.
    pub fn open(root: &Path) -> Self {
        Self { root: root.to_owned(), lock: None }
    }

    /// Locks the folder against other processes until `self` is dropped, and removes unfinished files. Fails
    /// if another process holds the lock; only warns if the folder cannot be locked.
    pub fn claim(&mut self) -> Result<()> {
        let path = self.root.join("run.lock");
        let file = File::create(&path).map_err(|e| Error::io(&path, "cannot create", e))?;
        match file.try_lock() {
            Ok(()) => {
                self.lock = Some(file);
                self.remove_leftovers()?;
            }
            Err(TryLockError::WouldBlock) => {
                let origin = self.root.display().to_string();
                let (expected, found) =
                    ("no other process training in the folder", "one that holds the lock");
                return Err(Error::invalid(origin, "run.lock", expected, found));
            }
            // Some shared file systems do not support locks.
            Err(TryLockError::Error(e)) => {
                tracing::warn!("{}: {e}; nothing keeps another process from training there", path.display());
            }
        }
        Ok(())
    }

    /// Removes unfinished files of processes that were killed while writing.
    fn remove_leftovers(&self) -> Result<()> {
        let folders = [self.root.clone(), self.root.join("weights"), self.checkpoint_dir()];
        let entries = folders.iter().flat_map(std::fs::read_dir).flatten().flatten();
        let unfinished = |path: &PathBuf| {
            path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(io::UNFINISHED))
        };
        for path in entries.map(|entry| entry.path()).filter(unfinished) {
            io::remove(&path)?;
        }
        Ok(())
    }

    /// Returns the path of the configuration.
    pub fn config(&self) -> PathBuf {
        self.root.join("config.toml")
    }

    /// Returns the path of the table of means over steps.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.csv")
    }

    /// Returns the path of the table of validation rollouts.
    pub fn validation(&self) -> PathBuf {
        self.root.join("validation.csv")
    }

    /// Returns the path of the plot.
    pub fn plot(&self) -> PathBuf {
        self.root.join("plot.png")
    }

    /// Returns the path of weights; `name` is `best` or `last`.
    pub fn weights(&self, name: &str) -> PathBuf {
        self.root.join("weights").join(format!("{name}.safetensors"))
    }

    /// Writes the checkpoint of all ranks, and only then removes the oldest ones.
    pub fn keep(&self, checkpoint: &Checkpoint, ranks: &dyn Ranks) -> Result<()> {
        let path = self.checkpoint(checkpoint.counters.step, ranks.rank());
        // Rank 0's file marks a checkpoint as complete, so it is written after those of the other ranks.
        if ranks.rank() != 0 {
            checkpoint.write(&path)?;
        }
        ranks.all(true);
        if ranks.rank() != 0 {
            return Ok(());
        }
        checkpoint.write(&path)?;
        let files = self.checkpoints()?;
        // Newer ones are damaged and were passed over.
        let whole = files.iter().filter(|f| f.rank == 0 && f.step <= checkpoint.counters.step);
        let kept: Vec<u64> = whole.map(|f| f.step).take(KEPT).collect();
        for Saved { path, .. } in files.iter().filter(|file| !kept.contains(&file.step)) {
            io::remove(path)?;
        }
        Ok(())
    }

    /// Returns this rank's part of the newest checkpoint that is intact on all ranks, and the errors of newer
    /// ones that this rank could not read. Fails if the run began with another number of ranks.
    pub fn newest(&self, ranks: &dyn Ranks) -> Result<(Option<Checkpoint>, Vec<Error>)> {
        let mut passed_over = Vec::new();
        let count = ranks.count() as u64;
        let mut steps = self.checkpoints()?.into_iter().filter(|file| file.rank == 0).map(|file| file.step);
        loop {
            let step = ranks.broadcast_u64(steps.next().unwrap_or(NONE));
            if step == NONE {
                return Ok((None, passed_over));
            }
            let read = Checkpoint::read(&self.checkpoint(step, ranks.rank()));
            let began = ranks.broadcast_u64(read.as_ref().map_or(count, |c| c.counters.ranks as u64));
            if began != count {
                let expected = format!("{began}, as many as the run began with");
                return Err(Error::invalid(self.root.display().to_string(), "ranks", expected, count));
            }
            let whole = ranks.all(read.is_ok());
            match read {
                Ok(checkpoint) if whole => return Ok((Some(checkpoint), passed_over)),
                // Another rank reports the error.
                Ok(_) => {}
                Err(error) => passed_over.push(error),
            }
        }
    }

    /// Returns the error that no checkpoint is intact, given those that were passed over.
    pub fn none_whole(&self, passed_over: &[Error]) -> Error {
        let found = match passed_over.first() {
            Some(error) => format!("none ({error})"),
            None => "none".to_owned(),
        };
        let dir = self.checkpoint_dir().display().to_string();
        Error::invalid(dir, "checkpoints", "a whole one to resume from", found)
    }

    /// Removes the checkpoint of a step if an older one is intact. Returns whether it did.
    pub fn remove_if_older(&self, step: u64) -> Result<bool> {
        let files = self.checkpoints()?;
        let older = |file: &&Saved| file.rank == 0 && file.step < step;
        if !files.iter().filter(older).any(|file| Checkpoint::read(&file.path).is_ok()) {
            return Ok(false);
        }
        for Saved { path, .. } in files.iter().filter(|file| file.step == step) {
            io::remove(path)?;
        }
        Ok(true)
    }

    /// Returns the files of all checkpoints and ranks, newest first; empty if there is no such folder.
    fn checkpoints(&self) -> Result<Vec<Saved>> {
        let dir = self.checkpoint_dir();
        let mut found = Vec::new();
        if matches!(dir.try_exists(), Ok(false)) {
            return Ok(found);
        }
        for path in io::entries(&dir)? {
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let Some(name) = name.strip_prefix("step-").and_then(|n| n.strip_suffix(".safetensors")) else {
                continue;
            };
            let (step, rank) = name.split_once(".rank").unwrap_or((name, "0"));
            if let (Ok(step), Ok(rank)) = (step.parse(), rank.parse()) {
                found.push(Saved { step, rank, path });
            }
        }
        found.sort_by_key(|file| (std::cmp::Reverse(file.step), file.rank));
        Ok(found)
    }

    /// Returns the path of a rank's part of the checkpoint after a step.
    fn checkpoint(&self, step: u64, rank: usize) -> PathBuf {
        let rank = if rank == 0 { String::new() } else { format!(".rank{rank}") };
        self.checkpoint_dir().join(format!("step-{step:08}{rank}.safetensors"))
    }

    fn checkpoint_dir(&self) -> PathBuf {
        self.root.join("checkpoints")
    }
}
