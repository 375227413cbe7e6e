//! A training run: its loop, and what it writes.

use super::card::Card;
use super::checkpoint::{Checkpoint, Counters};
use super::config::{Config, Every};
use super::folder::Folder;
use super::learner::{Batch, Learner, StepReport, Update};
use super::pool::Pool;
use super::ranks::Ranks;
use super::records::Records;
use super::validation::{SceneScore, Validation};
use crate::network::Weights;
use crate::{Error, Result, io};
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Steps in a row that may be skipped because they are not finite.
const MOST_SKIPPED: u32 = 10;

/// A run and its folder, on one of the [`Ranks`] that train together.
pub struct Run {
    config: Config,
    text: String,
    folder: Folder,
    ranks: Rc<dyn Ranks>,
    learner: Box<dyn Learner>,
    pools: Vec<Pool>,
    counters: Counters,
    /// On rank 0 only.
    records: Option<Records>,
}

/// Where a session ends, if not at the end of the run. The run can be resumed there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Limits<'a> {
    /// When the run has done this many steps, those of earlier sessions included.
    pub steps: Option<u64>,
    /// After this many minutes of this session.
    pub minutes: Option<f64>,
    /// As soon as this is set: after a step, or within a validation, which is made up for when the run is resumed.
    pub interrupted: Option<&'a AtomicBool>,
}

impl Limits<'_> {
    fn go_on(&self) -> ControlFlow<()> {
        match self.interrupted.is_some_and(|interrupted| interrupted.load(Ordering::Relaxed)) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }
}

/// How a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The run or the session's [`Limits`] are reached.
    Done,
    /// It was asked to stop.
    Interrupted,
    /// Ten steps in a row were not finite, or the last one made weights that are not; the weights are those before them.
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
    /// Validation, if this step was followed by one; on rank 0 only.
    pub validation: Option<&'a [SceneScore]>,
}

impl Run {
    /// Begins a run in the folder `root`. `text` is the configuration as it was read; `learner` holds the first weights.
    pub fn create(
        root: &Path,
        text: &str,
        config: Config,
        learner: Box<dyn Learner>,
        ranks: Rc<dyn Ranks>,
    ) -> Result<Self> {
        // Before the folder: what is wrong with the configuration leaves no trace.
        Validation::new(&config.validation)?;
        let folder = if ranks.rank() == 0 { Folder::create(root, text)? } else { Folder::open(root) };
        let text = shared(text, &*ranks);
        // Weights are found elsewhere on another machine; those of rank 0 count.
        let first = Config { init: config.init.clone(), ..Config::parse(&text, &folder.config())? };
        if !ranks.all(first == config) {
            let expected = "the same one on all ranks";
            return Err(Error::invalid("ranks", "configuration", expected, "several"));
        }
        Self::open((config, text), folder, Counters::default(), (learner, ranks))
    }

    /// Continues the run in the folder `root`, on the learner that `learner` makes for its configuration. `given` is
    /// the configuration that it is expected to have, if any. Also tells which damaged checkpoints were passed over.
    pub fn resume(
        root: &Path,
        given: Option<&Config>,
        learner: impl FnOnce(&Config) -> Result<Box<dyn Learner>>,
        ranks: Rc<dyn Ranks>,
    ) -> Result<(Self, Vec<Error>)> {
        let mut folder = Folder::open(root);
        let config = Config::parse(&Config::text(&folder.config())?, &folder.config())?;
        let origin = folder.config().display().to_string();
        let other = |found: &str| {
            Err(Error::invalid(&origin, "configuration", "the one that the run began with", found))
        };
        if given.is_some_and(|given| *given != config) {
            return other("another than the one given with --resume");
        }
        if ranks.rank() == 0 {
            folder.claim()?;
        }
        let (newest, passed_over) = folder.newest(&*ranks)?;
        let Some(Checkpoint { config: text, counters, tensors }) = newest else {
            return Err(folder.none_whole(&passed_over));
        };
        if Config::parse(&text, &folder.config())? != config {
            return other("another than in the checkpoints");
        }
        let mut learner = learner(&config)?;
        learner.load(&tensors)?;
        tell_other_device(&counters.device, &learner.device());
        let run = Self::open((config, text), folder, counters, (learner, ranks))?;
        Ok((run, passed_over))
    }

    fn open(
        (config, text): (Config, String),
        folder: Folder,
        mut counters: Counters,
        (learner, ranks): (Box<dyn Learner>, Rc<dyn Ranks>),
    ) -> Result<Self> {
        let (seed, rules) = (ranks.seed(config.seed), (config.motion, config.reset));
        let of = |(index, pool): (usize, &super::PoolConfig)| Pool::new(index, seed, pool.clone(), rules);
        let mut pools: Vec<Pool> = config.pools.iter().enumerate().map(of).collect();
        restore(&mut pools, &mut counters)?;
        counters.ranks = ranks.count();
        // The sums of gradients mean something only where all vectors have one order.
        let order = learner.order();
        let alike = ranks.first(order) == order;
        if !ranks.all(alike) {
            let expected = "devices of one kind, whose gradients have one order";
            return Err(Error::invalid("ranks", "devices", expected, "several kinds"));
        }
        let records = || {
            let validation = Validation::new(&config.validation)?;
            Records::open(&folder, &config, validation, counters.step)
        };
        let records = (ranks.rank() == 0).then(records).transpose()?;
        Ok(Self { config, text, folder, ranks, learner, pools, counters, records })
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

    /// Trains until the end of the run, a limit, or until `watch`, which sees every step, breaks off. The folder then holds
    /// the weights and what is needed to resume; after [`End::NonFinite`] what is needed to resume before those steps, if
    /// there was a checkpoint, and after an error whatever was saved before it. All ranks end at the same step: rank 0's clock and
    /// `watch` count.
    pub fn train(
        &mut self,
        limits: &Limits<'_>,
        mut watch: impl FnMut(&Progress<'_>) -> ControlFlow<()>,
    ) -> Result<End> {
        let steps = self.ranks.first(limits.steps.unwrap_or(u64::MAX)).min(self.config.steps);
        let session = Clock::new(limits.minutes.map_or(Every::Steps(u64::MAX), Every::Minutes));
        let mut validate = Clock::new(self.config.validation.every);
        let mut checkpoint = Clock::new(self.config.checkpoint);
        let (first, before) = (self.counters.step, self.counters.seconds);
        // A run that is new has nothing to be resumed from yet.
        let mut saved = (first > 0).then_some(first);
        // A validation that was cut off is made up for. One that failed may fail again, and shall not keep the run from going on.
        if self.ranks.decide(self.is_validation_missing()) {
            let cut_off = match self.validate(limits) {
                Ok(whole) => !whole,
                Err(error) => {
                    tracing::warn!("the validation after step {first} is left out: {error}");
                    false
                }
            };
            if self.ranks.decide(cut_off) {
                return Ok(End::Interrupted);
            }
        }
        self.counters.validation_due = false;
        let updates = self.counters.updates;
        let end = loop {
            if self.counters.step >= steps {
                break End::Done;
            }
            let report = self.advance()?;
            let step = self.counters.step;
            self.counters.seconds = before + session.since.elapsed().as_secs_f64();
            let skipped = if report.is_finite() { 0 } else { self.counters.skipped_in_a_row + 1 };
            self.counters.skipped_in_a_row = skipped;
            if skipped >= MOST_SKIPPED {
                break End::NonFinite;
            }
            if step.is_multiple_of(self.config.log_every)
                && let Err(error) = self.flush()
            {
                // No step is lost; with other ranks, which wait elsewhere, all end as they are.
                if self.ranks.count() == 1 && skipped == 0 && self.is_sound()? {
                    self.keep()?;
                }
                return Err(error);
            }
            let last = self.ranks.decide(step == steps || session.is_due(step));
            let due = self.ranks.decide(last || validate.is_due(step));
            let kept = self.ranks.decide(due || checkpoint.is_due(step));
            // A validation takes a while and may fail: what was computed is safe before. A state that makes steps that are
            // not finite would push out better ones.
            let sound = kept && self.ranks.all(self.is_sound()?);
            let validated = due && sound;
            self.counters.validation_due = validated;
            if sound && skipped == 0 {
                self.save()?;
                saved = Some(step);
                checkpoint.restart();
            }
            if validated {
                let whole = self.validate(limits)?;
                if !self.ranks.decide(whole) {
                    break End::Interrupted;
                }
                validate.restart();
            }
            let records = self.records.as_ref().filter(|_| validated);
            let validation = records.map(|records| records.scores(step));
            let watched = watch(&Progress { step, steps, report: &report, validation });
            let stop = self.ranks.decide(watched.is_break() || limits.go_on().is_break());
            if last {
                break End::Done;
            }
            if stop {
                break End::Interrupted;
            }
        };
        let sound = self.ranks.all(self.is_sound()?);
        // The last step may have been too large, and no other follows that would show it.
        let end = if sound { end } else { End::NonFinite };
        match end {
            _ if saved == Some(self.counters.step) => {}
            End::Done | End::Interrupted => self.save()?,
            End::NonFinite => {
                let fruitless = first > 0 && self.counters.updates == updates;
                self.leave_weights(sound, fruitless.then_some(first))?;
            }
        }
        Ok(end)
    }

    /// After steps that were not finite: leaves the weights before them, if they are sound, else those of a checkpoint. The
    /// checkpoints may be of a better state than one that only makes such steps, and it is not saved; the one of step
    /// `fruitless`, which was followed by nothing else, is not of a better one.
    fn leave_weights(&mut self, sound: bool, fruitless: Option<u64>) -> Result<()> {
        self.flush()?;
        let given_up = fruitless.map_or(Ok(false), |step| self.give_up(step))?;
        if (sound && !given_up) || self.step_back()? {
            self.write_weights("last")?;
        }
        Ok(())
    }

    /// Whether the weights are finite, as those are not that a step too large has made.
    fn is_sound(&self) -> Result<bool> {
        let weights = self.weights()?;
        Ok(weights.parameters().into_iter().flatten().all(|w| w.is_finite()))
    }

    /// Whether there was to be a validation after the last step, and there was none.
    fn is_validation_missing(&self) -> bool {
        let validated = |records: &Records| records.is_validated(self.counters.step);
        self.counters.validation_due && self.records.as_ref().is_some_and(|records| !validated(records))
    }

    /// Removes a checkpoint if there is an older one that is whole; whether there is.
    fn give_up(&self, step: u64) -> Result<bool> {
        let removed = self.ranks.rank() == 0 && self.folder.remove_if_older(step)?;
        if removed {
            tracing::warn!("after the checkpoint of step {step} no step is finite: the one before it counts");
        }
        Ok(self.ranks.decide(removed))
    }

    /// Goes back to the newest checkpoint; whether there is one.
    fn step_back(&mut self) -> Result<bool> {
        let (newest, _) = self.folder.newest(&*self.ranks)?;
        let Some(Checkpoint { mut counters, tensors, .. }) = newest else { return Ok(false) };
        self.learner.load(&tensors)?;
        restore(&mut self.pools, &mut counters)?;
        self.counters = counters;
        Ok(true)
    }

    /// One training step.
    fn advance(&mut self) -> Result<StepReport> {
        let began = Instant::now();
        let step = self.counters.step;
        let pools = self.pools.iter().filter(|pool| pool.takes_part(step));
        let batches: Vec<Batch> = pools.map(|pool| pool.draw(step)).collect();
        let number = self.counters.updates + 1;
        // A mean over a long time begins as one over a short time, or it would remember the first weights for long.
        let average = self.config.average.min(number as f64 / (number + 9) as f64);
        let rate = self.config.schedule.rate(self.config.optimizer.rate, step, self.config.steps);
        let update = Update { number, rate, average };
        let report = self.learner.step(&batches, update, &*self.ranks)?;
        for batch in &batches {
            self.pools[batch.pool].record(batch, &report.outcomes[batch.pool]);
        }
        self.pools.iter_mut().for_each(|pool| pool.rotate(step));
        self.counters.step += 1;
        self.counters.updates += u64::from(report.is_finite());
        self.records.iter_mut().for_each(|records| records.add(&report, rate, began.elapsed()));
        Ok(report)
    }

    fn flush(&mut self) -> Result<()> {
        let (step, seconds) = (self.counters.step, self.counters.seconds);
        self.records.iter_mut().try_for_each(|records| records.flush(step, seconds))
    }

    /// Rolls the scenes out and keeps the weights if they are the best so far; whether it was not interrupted. Only rank 0 does.
    fn validate(&mut self, limits: &Limits<'_>) -> Result<bool> {
        let Some(records) = &mut self.records else { return Ok(true) };
        let weights = self.learner.averaged()?;
        let Some(score) = records.validate(self.counters.step, &weights, || limits.go_on())? else {
            return Ok(false);
        };
        self.counters.validation_due = false;
        if records.best.is_none_or(|best| score < best) {
            self.write_weights("best")?;
            self.records.iter_mut().for_each(|records| records.best = Some(score));
        }
        // The table last: what stands there is not made up for.
        self.records.iter().try_for_each(Records::tell_scores)?;
        self.show()?;
        Ok(true)
    }

    /// Writes the whole state of this rank; on rank 0 also what is shown of it.
    fn save(&mut self) -> Result<()> {
        self.keep()?;
        self.flush()?;
        self.show()
    }

    /// Writes the last weights, with the validation if there was one after this step, and the plot. Only rank 0 does.
    fn show(&self) -> Result<()> {
        self.write_weights("last")?;
        self.records.iter().try_for_each(|records| records.plot(&self.folder, &self.config))
    }

    /// Writes the whole state of this rank.
    fn keep(&self) -> Result<()> {
        let pools = self.pools.iter().map(|pool| pool.slots().to_vec()).collect();
        let checkpoint = Checkpoint {
            config: self.text.clone(),
            counters: Counters { pools, device: self.learner.device(), ..self.counters.clone() },
            tensors: self.learner.save()?,
        };
        self.folder.keep(&checkpoint, &*self.ranks)
    }

    fn write_weights(&self, name: &str) -> Result<()> {
        let Some(records) = &self.records else { return Ok(()) };
        let weights = self.weights()?;
        let path = self.folder.weights(name);
        io::write_atomic(&path, |file| file.write_all(&weights.to_bytes()))?;
        let card = Card {
            steps: self.counters.step,
            skipped: self.skipped(),
            seconds: self.counters.seconds,
            device: &self.learner.device(),
            ranks: self.ranks.count(),
            version: env!("CARGO_PKG_VERSION"),
            parameters: weights.parameter_count(),
            validation: records.scores(self.counters.step),
            config: &self.config,
        };
        card.write(&path)
    }
}

/// Gives pools the slots of a checkpoint, which counters keep no longer than that.
fn restore(pools: &mut [Pool], counters: &mut Counters) -> Result<()> {
    let all = std::mem::take(&mut counters.pools);
    pools.iter_mut().zip(all).try_for_each(|(pool, slots)| pool.restore(slots, "checkpoint"))
}

/// Says so where a run goes on on another device: it then does not come to the same bits. Threads of a CPU do not matter.
fn tell_other_device(before: &str, now: &str) {
    let kind = |name: &str| name.split(',').next().map(str::to_owned);
    if !before.is_empty() && kind(before) != kind(now) {
        tracing::warn!("the run was on {before} so far; on {now} it does not continue to the same bits");
    }
}

/// Rank 0's text: the same folder may have another absolute path on another machine.
fn shared(text: &str, ranks: &dyn Ranks) -> String {
    let mut bytes = text.as_bytes().to_vec();
    bytes.resize(ranks.first(bytes.len() as u64) as usize, 0);
    ranks.broadcast(&mut bytes);
    String::from_utf8_lossy(&bytes).into_owned()
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

    /// Begins the time anew.
    fn restart(&mut self) {
        self.since = Instant::now();
    }
}
