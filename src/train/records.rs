//! What rank 0 alone measures and writes while a run goes on: means over steps, validation rollouts, the plot.

use super::card::Card;
use super::config::Config;
use super::folder::Folder;
use super::learner::StepReport;
use super::metrics::Metrics;
use super::plot;
use super::table::Table;
use super::validation::{SceneScore, Validation};
use crate::network::Weights;
use crate::{Result, render};
use std::ops::ControlFlow;
use std::time::Duration;

/// Columns of `validation.csv`.
const VALIDATION_COLUMNS: [&str; 5] = ["step", "scene", "gap", "largest_stretch", "stable"];

/// The records of a run.
pub(super) struct Records {
    metrics: Metrics,
    validation: Validation,
    validations: Table,
    /// The last validation and its step.
    scores: (u64, Vec<SceneScore>),
    /// Score of the weights that are kept as the best; none if there are none.
    pub best: Option<f64>,
}

impl Records {
    /// Opens the tables in the folder; rows after `step` are given up.
    pub fn open(folder: &Folder, config: &Config, validation: Validation, step: u64) -> Result<Self> {
        let metrics = Metrics::open(folder.metrics(), &config.pools, step)?;
        let columns = VALIDATION_COLUMNS.map(str::to_owned).to_vec();
        let validations = Table::open(folder.validation(), columns, step)?;
        let best = Card::validation(&folder.weights("best"))?.map(|scores| Validation::score(&scores));
        Ok(Self { metrics, validation, validations, scores: (step, Vec::new()), best })
    }

    /// Adds a step, the learning rate it was taken with and the time it took.
    pub fn add(&mut self, report: &StepReport, rate: f64, took: Duration) {
        self.metrics.add(report, rate, took);
    }

    /// Writes the means over the steps up to `step`, if there were any since the last.
    pub fn flush(&mut self, step: u64, seconds: f64) -> Result<()> {
        self.metrics.flush(step, seconds)
    }

    /// Rolls the scenes out with the weights after `step` steps, and gives their score; nothing when `tick`, called in each
    /// frame, ended it.
    pub fn validate(
        &mut self,
        step: u64,
        weights: &Weights,
        tick: impl FnMut() -> ControlFlow<()>,
    ) -> Result<Option<f64>> {
        let Some(scores) = self.validation.run(weights, tick)? else { return Ok(None) };
        let score = Validation::score(&scores);
        self.scores = (step, scores);
        Ok(Some(score))
    }

    /// Adds the last validation to the table, all of it at once.
    pub fn tell_scores(&self) -> Result<()> {
        let (step, scores) = &self.scores;
        let row = |score: &SceneScore| {
            let gap = score.gap.map_or_else(String::new, |gap| format!("{gap:.6}"));
            let stretch = format!("{:.6}", score.largest_stretch);
            let stable = u8::from(score.stable).to_string();
            vec![step.to_string(), score.scene.clone(), gap, stretch, stable]
        };
        self.validations.push_all(&scores.iter().map(row).collect::<Vec<_>>())
    }

    /// Whether the table has a validation of the weights after `step` steps.
    pub fn is_validated(&self, step: u64) -> bool {
        let of_step = |text: &str| {
            let mut rows = self.validations.rows(text);
            rows.any(|row| row.split(',').next() == Some(&step.to_string()))
        };
        self.validations.text().is_ok_and(|text| of_step(&text))
    }

    /// The validation of the weights after `step` steps; empty if there was none, as figures of other weights would not be
    /// theirs.
    pub fn scores(&self, step: u64) -> &[SceneScore] {
        let (validated, scores) = &self.scores;
        if *validated == step { scores } else { &[] }
    }

    /// Draws the curves so far.
    pub fn plot(&self, folder: &Folder, config: &Config) -> Result<()> {
        let image = plot::draw(self.metrics.table(), &config.pools, &self.validations)?;
        render::write_png(folder.plot(), &image)
    }
}
