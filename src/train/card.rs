//! Model cards: what weights are and where they come from.

use super::config::Config;
use super::validation::SceneScore;
use crate::{Result, io};
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
    /// The validation that the card beside the weights in `path` tells; none without whole weights and card, or if there was none.
    pub(super) fn validation(path: &Path) -> Option<Vec<SceneScore>> {
        #[derive(serde::Deserialize)]
        struct Told {
            validation: Vec<SceneScore>,
        }
        let card = std::fs::read(path.with_extension("json")).ok().filter(|_| path.is_file())?;
        let Told { validation } = serde_json::from_slice(&card).ok()?;
        Some(validation).filter(|scores| !scores.is_empty())
    }

    /// Writes the card as JSON beside the weights in `path`.
    pub(super) fn write(&self, path: &Path) -> Result<()> {
        let json = serde_json::to_string_pretty(self).map_err(std::io::Error::other);
        io::write_atomic(path.with_extension("json"), |file| writeln!(file, "{}", json?))
    }
}
