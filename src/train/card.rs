//! Model cards: what weights are and where they come from.

use super::config::Config;
use super::validation::SceneScore;
use crate::{Error, Result, io};
use std::io::Write;
use std::path::Path;

/// What is told of weights beside their file.
#[derive(Clone, Debug, serde::Serialize)]
pub(super) struct Card<'a> {
    /// Training steps behind them.
    pub steps: u64,
    /// Of them, steps skipped because they were not finite.
    pub skipped: u64,
    /// Time spent on them \[s\].
    pub seconds: f64,
    /// Device they were trained on.
    pub device: &'a str,
    /// Processes that trained them together, each with batches of its own.
    pub ranks: usize,
    /// Version of the program.
    pub version: &'static str,
    /// Real parameters of the network.
    pub parameters: usize,
    /// How they did in the validation rollouts; empty when there was none.
    pub validation: &'a [SceneScore],
    /// Configuration of the run.
    pub config: &'a Config,
}

impl Card<'_> {
    /// The validation that the card beside the weights in `path` tells; none if there was none, or either file is missing.
    /// A card that cannot be read is an error, as weights that it calls the best would else give way to the next ones.
    pub(super) fn validation(path: &Path) -> Result<Option<Vec<SceneScore>>> {
        #[derive(serde::Deserialize)]
        struct Told {
            validation: Vec<SceneScore>,
        }
        let card = path.with_extension("json");
        if !path.is_file() || !card.exists() {
            return Ok(None);
        }
        let bytes = std::fs::read(&card).map_err(|e| Error::io(&card, "cannot read", e))?;
        let Told { validation } = serde_json::from_slice(&bytes).map_err(|e| {
            let expected =
                "the scores of the weights beside it (without both files the next weights are the best)";
            Error::invalid(card.display().to_string(), "validation", expected, e)
        })?;
        Ok(Some(validation).filter(|scores| !scores.is_empty()))
    }

    /// Writes the card as JSON beside the weights in `path`.
    pub(super) fn write(&self, path: &Path) -> Result<()> {
        let json = serde_json::to_string_pretty(self).map_err(std::io::Error::other);
        io::write_atomic(path.with_extension("json"), |file| writeln!(file, "{}", json?))
    }
}
