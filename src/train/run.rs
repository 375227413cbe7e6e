//! A training run: its loop, and what it writes.

use super::card::Card;
use super::checkpoint::{Checkpoint, Counters};
use super::config::{Config, Every};
use super::folder::Folder;
use super::learner::{Batch, Learner, StepReport, Update};
use super::metrics::Metrics;
use super::plot;
use super::pool::Pool;
use super::table::Table;
use super::validation::{SceneScore, Validation};
use crate::network::Weights;
use crate::{Error, Result, io, render};
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

/// Steps in a row that may be skipped because they are not finite.
const MOST_SKIPPED: u32 = 10;
/// Columns of `validation.csv`.
const VALIDATION_COLUMNS: [&str; 5] = ["step", "scene", "gap", "largest_stretch", "stable"];

/// A run and its folder.
pub struct Run {
    config: Config,
    text: String,
    folder: Folder,
    learner: Box<dyn Learner>,
    pools: Vec<Pool>,
    counters: Counters,
    metrics: Metrics,
    validation: Validation,
    validations: Table,
    /// The last validation and its step.
    scores: (u64, Vec<SceneScore>),
}

/// Where a session ends, if not at the end of the run. The run can be resumed there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limits {
    /// When the run has done this many steps, those of earlier sessions included.
    pub steps: Option<u64>,
    /// After this many minutes of this session.
    pub minutes: Option<f64>,
}

/// How a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The run or the session's [`Limits`] are reached.
    Done,
    /// It was asked to stop.
    Interrupted,
    /// Ten steps in a row were not finite; the weights are those before them.
    NonFinite,
}

/// What is told after each step.
#[derive(Clone, Debug)]
pub struct Progress<'a> {
    /// Steps done.
    pub step: u64,
    /// The step at which the session ends.
    pub steps: u64,
    /// What the step told.
    pub report: &'a StepReport,
    /// Validation, if this step was followed by one.
    pub validation: Option<&'a [SceneScore]>,
}

impl Run {
    /// Begins a run in the folder `root`. `text` is the configuration as it was read; `learner` holds the first weights.
    pub fn create(root: &Path, text: &str, config: Config, learner: Box<dyn Learner>) -> Result<Self> {
        let validation = Validation::new(&config.validation)?;
        let folder = Folder::create(root, text)?;
        Self::open((config, text.to_owned()), folder, learner, (Counters::default(), validation))
    }

    /// Continues the run in the folder `root`, on the learner that `learner` makes for its configuration. `given` is
    /// the configuration that it is expected to have, if any. Also tells which damaged checkpoints were passed over.
    pub fn resume(
        root: &Path,
        given: Option<&Config>,
        learner: impl FnOnce(&Config) -> Result<Box<dyn Learner>>,
    ) -> Result<(Self, Vec<Error>)> {
        let folder = Folder::open(root);
        let (_, config) = Config::load(&folder.config())?;
        let other = |found: &str| {
            let origin = folder.config().display().to_string();
            Err(Error::invalid(origin, "configuration", "the one that the run began with", found))
        };
        if given.is_some_and(|given| *given != config) {
            return other("another than the one given with --resume");
        }
        let (Checkpoint { config: text, counters, tensors }, passed_over) = folder.newest()?;
        if Config::parse(&text, &folder.config())? != config {
            return other("another than in the checkpoints");
        }
        let mut learner = learner(&config)?;
        learner.load(&tensors)?;
        let validation = Validation::new(&config.validation)?;
        let run = Self::open((config, text), folder, learner, (counters, validation))?;
        Ok((run, passed_over))
    }

    fn open(
        (config, text): (Config, String),
        folder: Folder,
        learner: Box<dyn Learner>,
        (mut counters, validation): (Counters, Validation),
    ) -> Result<Self> {
        let rules = (config.motion, config.reset);
        let of =
            |(index, pool): (usize, &super::PoolConfig)| Pool::new(index, config.seed, pool.clone(), rules);
        let mut pools: Vec<Pool> = config.pools.iter().enumerate().map(of).collect();
        for (pool, slots) in pools.iter_mut().zip(std::mem::take(&mut counters.pools)) {
            pool.restore(slots, "checkpoint")?;
        }
        let metrics = Metrics::open(folder.metrics(), &config.pools, counters.step)?;
        let columns = VALIDATION_COLUMNS.map(str::to_owned).to_vec();
        let validations = Table::open(folder.validation(), columns, counters.step)?;
        let scores = (counters.step, Vec::new());
        Ok(Self { config, text, folder, learner, pools, counters, metrics, validation, validations, scores })
    }

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Steps done.
    pub fn step(&self) -> u64 {
        self.counters.step
    }

    /// Steps that were skipped because they were not finite.
    pub fn skipped(&self) -> u64 {
        self.counters.step - self.counters.updates
    }

    /// The weights as they are validated and kept.
    pub fn weights(&self) -> Result<Weights> {
        self.learner.averaged()
    }

    /// Trains until the end of the run, a limit, or until `watch`, which sees every step, breaks off. Whatever the end,
    /// the folder holds the weights, and what is needed to resume.
    pub fn train(
        &mut self,
        limits: &Limits,
        mut watch: impl FnMut(&Progress<'_>) -> ControlFlow<()>,
    ) -> Result<End> {
        let steps = limits.steps.unwrap_or(u64::MAX).min(self.config.steps);
        let session = Clock::new(limits.minutes.map_or(Every::Steps(u64::MAX), Every::Minutes));
        let mut validate = Clock::new(self.config.validation.every);
        let mut checkpoint = Clock::new(self.config.checkpoint);
        let (first, before) = (self.counters.step, self.counters.seconds);
        let (mut skipped, mut saved) = (0, first);
        let end = loop {
            if self.counters.step >= steps {
                break End::Done;
            }
            let report = self.advance()?;
            let step = self.counters.step;
            self.counters.seconds = before + session.since.elapsed().as_secs_f64();
            self.metrics.add(&report);
            skipped = if report.is_finite() { 0 } else { skipped + 1 };
            if skipped == MOST_SKIPPED {
                break End::NonFinite;
            }
            if step.is_multiple_of(self.config.log_every) {
                self.flush()?;
            }
            let last = step == steps || session.is_due(step);
            let validated = last || validate.restart_if_due(step);
            let improved = validated && self.validate()?;
            if improved || checkpoint.restart_if_due(step) {
                self.save()?;
                saved = step;
            }
            let validation = validated.then_some(&self.scores.1[..]);
            if watch(&Progress { step, steps, report: &report, validation }).is_break() {
                break End::Interrupted;
            }
            if last {
                break End::Done;
            }
        };
        match end {
            _ if self.counters.step == saved => {}
            // The checkpoints before may be of a better state than one that only makes such steps.
            End::NonFinite => {
                self.flush()?;
                self.write_weights("last")?;
            }
            End::Done | End::Interrupted => self.save()?,
        }
        Ok(end)
    }

    /// One training step.
    fn advance(&mut self) -> Result<StepReport> {
        let step = self.counters.step;
        let batches: Vec<Batch> = self.pools.iter().map(|pool| pool.draw(step)).collect();
        let number = self.counters.updates + 1;
        // A mean over a long time begins as one over a short time, or it would remember the first weights for long.
        let average = self.config.average.min(number as f64 / (number + 9) as f64);
        let report = self.learner.step(&batches, Update { number, rate: self.rate(), average })?;
        for ((pool, batch), outcomes) in self.pools.iter_mut().zip(&batches).zip(&report.outcomes) {
            pool.record(batch, outcomes);
            pool.rotate(step);
        }
        self.counters.step += 1;
        self.counters.updates += u64::from(report.is_finite());
        Ok(report)
    }

    fn rate(&self) -> f64 {
        self.config.schedule.rate(self.config.optimizer.rate, self.counters.step, self.config.steps)
    }

    fn flush(&mut self) -> Result<()> {
        self.metrics.flush(self.counters.step, self.counters.seconds, self.rate())
    }

    /// Rolls the scenes out; keeps the weights if they are the best so far, and tells whether they are.
    fn validate(&mut self) -> Result<bool> {
        let step = self.counters.step;
        self.scores = (step, self.validation.run(&self.weights()?)?);
        for score in &self.scores.1 {
            let gap = score.gap.map_or_else(String::new, |gap| format!("{gap:.6}"));
            let stretch = format!("{:.6}", score.largest_stretch);
            let stable = u8::from(score.stable).to_string();
            self.validations.push(&[step.to_string(), score.scene.clone(), gap, stretch, stable])?;
        }
        let score = Validation::score(&self.scores.1);
        let improved = self.counters.best.is_none_or(|best| score < best);
        if improved {
            self.counters.best = Some(score);
            self.write_weights("best")?;
        }
        Ok(improved)
    }

    /// Writes the whole state, the last weights and the plot.
    fn save(&mut self) -> Result<()> {
        self.flush()?;
        let pools = self.pools.iter().map(|pool| pool.slots().to_vec()).collect();
        let checkpoint = Checkpoint {
            config: self.text.clone(),
            counters: Counters { pools, ..self.counters.clone() },
            tensors: self.learner.save()?,
        };
        self.folder.keep(&checkpoint)?;
        self.write_weights("last")?;
        let image = plot::draw(self.metrics.table(), &self.config.pools, &self.validations)?;
        render::write_png(self.folder.plot(), &image)
    }

    fn write_weights(&self, name: &str) -> Result<()> {
        let weights = self.weights()?;
        let path = self.folder.weights(name);
        io::write_atomic(&path, |file| file.write_all(&weights.to_bytes()))?;
        let (validated, scores) = &self.scores;
        let card = Card {
            steps: self.counters.step,
            skipped: self.skipped(),
            seconds: self.counters.seconds,
            device: &self.learner.device(),
            version: env!("CARGO_PKG_VERSION"),
            parameters: weights.parameter_count(),
            // Figures of other weights would not be theirs.
            validation: if *validated == self.counters.step { scores } else { &[] },
            config: &self.config,
        };
        card.write(&path)
    }
}

/// Tells when something is due again.
struct Clock {
    every: Every,
    since: Instant,
}

impl Clock {
    fn new(every: Every) -> Self {
        Self { every, since: Instant::now() }
    }

    /// Whether it is time, when `step` steps are done.
    fn is_due(&self, step: u64) -> bool {
        match self.every {
            Every::Steps(steps) => step > 0 && step.is_multiple_of(steps),
            Every::Minutes(minutes) => self.since.elapsed().as_secs_f64() >= 60.0 * minutes,
        }
    }

    /// [`Clock::is_due`]; if so, the time begins anew.
    fn restart_if_due(&mut self, step: u64) -> bool {
        let due = self.is_due(step);
        if due {
            self.since = Instant::now();
        }
        due
    }
}
