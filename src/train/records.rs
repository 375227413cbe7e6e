//! The records that rank 0 alone keeps during a run: means over steps, validation rollouts, the plot.

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
const VALIDATION_COLUMNS: [&str; 5] = ["step", "scene", "gap", "stretch_largest", "sound"];

/// The records of a run.
pub(super) struct Records {
    metrics: Metrics,
    validation: Validation,
    validations: Table,
    /// The last validation and its step.
    scores: (u64, Vec<SceneScore>),
    /// Score of the best weights so far; `None` if there are none.
    pub best: Option<f64>,
}

impl Records {
    /// Opens the tables in the folder, dropping rows after `step`.
    pub fn open(folder: &Folder, config: &Config, validation: Validation, step: u64) -> Result<Self> {
        let metrics = Metrics::open(folder.metrics(), &config.pools, step)?;
        let columns = VALIDATION_COLUMNS.map(str::to_owned).to_vec();
        let validations = Table::open(folder.validation(), columns, step)?;
        let best = Card::validation(&folder.weights("best"))?.map(|scores| Validation::score(&scores));
        Ok(Self { metrics, validation, validations, scores: (step, Vec::new()), best })
    }

    /// Adds a step with its learning rate and duration.
    pub fn add(&mut self, report: &StepReport, rate: f64, took: Duration) {
        self.metrics.add(report, rate, took);
    }

    /// Writes the means over the steps up to `step`, if there were any since the last row.
    pub fn flush(&mut self, step: u64, seconds: f64) -> Result<()> {
        self.metrics.flush(step, seconds)
    }

    /// Rolls out the scenes with the weights after `step` steps and returns their score, or `None` if `tick`,
    /// which is called in each frame, breaks.
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

    /// Appends the last validation to the table in a single write.
    pub fn append_scores(&self) -> Result<()> {
        let (step, scores) = &self.scores;
        let row = |score: &SceneScore| {
            let gap = score.gap.map_or_else(String::new, |gap| format!("{gap:.6}"));
            let stretch = score.stretch_largest.map_or_else(String::new, |stretch| format!("{stretch:.6}"));
            let sound = u8::from(score.sound).to_string();
            vec![step.to_string(), score.scene.clone(), gap, stretch, sound]
        };
        self.validations.push_all(&scores.iter().map(row).collect::<Vec<_>>())
    }

    /// Returns whether the table has a validation of the weights after `step` steps.
    pub fn is_validated(&self, step: u64) -> bool {
        let of_step = |text: &str| {
            let mut rows = self.validations.rows(text);
            rows.any(|row| row.split(',').next() == Some(&step.to_string()))
        };
        self.validations.text().is_ok_and(|text| of_step(&text))
    }

    /// Returns the validation of the weights after `step` steps; empty if the last validation was of other
    /// weights.
    pub fn scores(&self, step: u64) -> &[SceneScore] {
        let (validated, scores) = &self.scores;
        if *validated == step { scores } else { &[] }
    }

    /// Plots the curves so far.
    pub fn plot(&self, folder: &Folder, config: &Config) -> Result<()> {
        let image = plot::draw(self.metrics.table(), &config.pools, &self.validations)?;
        render::write_png(folder.plot(), &image)
    }
}
