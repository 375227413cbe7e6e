//! Model cards: descriptions of weights and their origin.

use super::config::Config;
use super::validation::SceneScore;
use crate::{Error, Result, io};
use std::io::Write;
use std::path::Path;

/// The model card of a weights file.
#[derive(Clone, Debug, serde::Serialize)]
pub(super) struct Card<'a> {
    /// Number of training steps.
    pub steps: u64,
    /// Number of steps skipped because they were not finite.
    pub skipped: u64,
    /// Training time \[s\].
    pub seconds: f64,
    /// Device used for training.
    pub device: &'a str,
    /// Number of processes that trained together, each with its own batches.
    pub ranks: usize,
    /// Version of the program.
    pub version: &'static str,
    /// Number of real parameters of the network.
    pub parameters: usize,
    /// Results of the validation rollouts; empty if there were none.
    pub validation: &'a [SceneScore],
    /// Configuration of the run.
    pub config: &'a Config,
}

impl Card<'_> {
    /// Reads the validation from the card next to the weights in `path`. Returns `None` if it has none, or if
    /// either file is missing. Fails on a card that cannot be read, because otherwise the next weights would
    /// replace the best ones.
    pub(super) fn validation(path: &Path) -> Result<Option<Vec<SceneScore>>> {
        #[derive(serde::Deserialize)]
        struct Stored {
            validation: Vec<SceneScore>,
        }
        let card = path.with_extension("json");
        if !path.is_file() || !card.exists() {
            return Ok(None);
        }
        let bytes = std::fs::read(&card).map_err(|e| Error::io(&card, "cannot read", e))?;
        let Stored { validation } = serde_json::from_slice(&bytes).map_err(|e| {
            let expected = "the validation scores of the weights (delete both files to start over)";
            Error::invalid(card.display().to_string(), "validation", expected, e)
        })?;
        Ok(Some(validation).filter(|scores| !scores.is_empty()))
    }

    /// Writes the card as JSON next to the weights in `path`.
    pub(super) fn write(&self, path: &Path) -> Result<()> {
        let json = serde_json::to_string_pretty(self).map_err(std::io::Error::other);
        io::write_atomic(path.with_extension("json"), |file| writeln!(file, "{}", json?))
    }
}
