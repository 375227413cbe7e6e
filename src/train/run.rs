//! A training run: its loop, and the files it writes.

use super::card::Card;
use super::checkpoint::{Checkpoint, Counters};
use super::config::{Config, Every};
use super::folder::Folder;
use super::learner::{Batch, Learner, StepReport, WeightUpdate};
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

/// Number of consecutive non-finite steps at which a session gives up.
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
    /// `Some` on rank 0 only.
    records: Option<Records>,
}

/// Limits at which a session ends before the run does. The run can be resumed from there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Limits<'a> {
    /// Number of steps of the run at which to stop, including those of earlier sessions.
    pub steps: Option<u64>,
    /// Length of this session in minutes.
    pub minutes: Option<f64>,
    /// Flag that stops the session once it is set: after a step, or within a validation, which is repeated
    /// when the run is resumed.
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
    /// The end of the run or one of the session's [`Limits`] was reached.
    Done,
    /// The session was asked to stop.
    Interrupted,
    /// Ten consecutive steps were not finite, or the last one made the weights non-finite. The weights that
    /// are kept predate these steps.
    NonFinite,
}

/// The report after each step, and after a validation that is made up for.
#[derive(Clone, Debug)]
pub struct Progress<'a> {
    /// Number of steps done.
    pub step: u64,
    /// Step at which the session ends.
    pub steps: u64,
    /// Result of the step; `None` if an earlier session took it.
    pub report: Option<&'a StepReport>,
    /// Validation, if one followed this step; on rank 0 only.
    pub validation: Option<&'a [SceneScore]>,
}

impl Run {
    /// Starts a run in the folder `root`. `text` is the configuration as it was read; `learner` holds the
    /// initial weights.
    pub fn create(
        root: &Path,
        text: &str,
        config: Config,
        learner: Box<dyn Learner>,
        ranks: Rc<dyn Ranks>,
    ) -> Result<Self> {
        // Validate first: an invalid configuration must not leave a folder behind.
        Validation::new(&config.validation)?;
        let folder = if ranks.rank() == 0 { Folder::create(root, text)? } else { Folder::open(root) };
        let text = shared(text, &*ranks);
        // The paths of `init` may differ between machines; rank 0's weights are used.
        let first = Config { init: config.init.clone(), ..Config::parse(&text, &folder.config())? };
        if !ranks.all(first == config) {
            let expected = "the same one on all ranks";
            return Err(Error::invalid("ranks", "configuration", expected, "several"));
        }
        Self::open((config, text), folder, Counters::default(), (learner, ranks))
    }

    /// Continues the run in the folder `root`, on the learner that `learner` creates for its configuration.
    /// Fails if `given` differs from that configuration. Also returns the errors of damaged checkpoints that
    /// were passed over.
    pub fn resume(
        root: &Path,
        given: Option<&Config>,
        learner: impl FnOnce(&Config) -> Result<Box<dyn Learner>>,
        ranks: Rc<dyn Ranks>,
    ) -> Result<(Self, Vec<Error>)> {
        let mut folder = Folder::open(root);
        let config = Config::parse(&io::read_text(&folder.config())?, &folder.config())?;
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
        warn_of_other_device(&counters.device, &learner.device());
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
        // Gradients can only be summed if all ranks order them alike.
        let order = learner.gradient_order();
        let alike = ranks.broadcast_u64(order) == order;
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

    /// Returns the configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Returns the number of steps done.
    pub fn step(&self) -> u64 {
        self.counters.step
    }

    /// Returns the number of steps that were skipped because they were not finite.
    pub fn skipped(&self) -> u64 {
        self.counters.step - self.counters.updates
    }

    /// Returns the weights as they are validated and saved.
    pub fn weights(&self) -> Result<Weights> {
        self.learner.averaged()
    }

    /// Trains until the run ends, a limit is reached, or `watch`, which is called after every step, breaks.
    /// The folder then holds the weights and a checkpoint to resume from. After [`End::NonFinite`] the
    /// checkpoint, if any, predates the non-finite steps; after an error the folder holds whatever was saved
    /// before it. All ranks end at the same step, decided by rank 0's clock and `watch`.
    pub fn train(
        &mut self,
        limits: &Limits<'_>,
        mut watch: impl FnMut(&Progress<'_>) -> ControlFlow<()>,
    ) -> Result<End> {
        let steps = self.ranks.broadcast_u64(limits.steps.unwrap_or(u64::MAX)).min(self.config.steps);
        let session = Clock::new(limits.minutes.map_or(Every::Steps(u64::MAX), Every::Minutes));
        let mut validate = Clock::new(self.config.validation.every);
        let mut checkpoint = Clock::new(self.config.checkpoint);
        let (first, before) = (self.counters.step, self.counters.seconds);
        // A new run has no checkpoint yet.
        let mut saved = (first > 0).then_some(first);
        // Repeat a validation that was cut short. If it failed, it may fail again, which must not keep the
        // run from continuing.
        if self.ranks.decide(self.is_validation_missing()) {
            let stop = match self.validate(limits) {
                Ok(false) => true,
                Ok(true) => {
                    let validation = self.records.as_ref().map(|records| records.scores(first));
                    watch(&Progress { step: first, steps, report: None, validation }).is_break()
                }
                Err(error) => {
                    tracing::warn!("skipping the validation after step {first}: {error}");
                    false
                }
            };
            if self.ranks.decide(stop) {
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
                // Save, so that no step is lost. With several ranks the others are waiting at another
                // collective, so all end without saving.
                if self.ranks.count() == 1 && skipped == 0 && self.weights_are_finite()? {
                    self.write_checkpoint()?;
                }
                return Err(error);
            }
            let last = self.ranks.decide(step == steps || session.is_due(step));
            let due = self.ranks.decide(last || validate.is_due(step));
            let kept = self.ranks.decide(due || checkpoint.is_due(step));
            // Save before validating, which takes a while and may fail. Do not save after a skipped step: a
            // state that only produces non-finite steps would push out better checkpoints.
            let sound = kept && self.ranks.all(self.weights_are_finite()?);
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
            let watched = watch(&Progress { step, steps, report: Some(&report), validation });
            let stop = self.ranks.decide(watched.is_break() || limits.go_on().is_break());
            if last {
                break End::Done;
            }
            if stop {
                break End::Interrupted;
            }
        };
        let sound = self.ranks.all(self.weights_are_finite()?);
        // The last step may have been too large, with no further step to reveal it.
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

    /// Writes the weights to keep after non-finite steps. Does not save the current state, because the
    /// checkpoints may hold a better one than a state that produces only such steps. The checkpoint of step
    /// `fruitless`, after which no step was finite, is not better; it is removed if an older one is intact.
    /// The weights are the current ones if they are `sound` and no checkpoint was removed, else those of the
    /// newest checkpoint.
    fn leave_weights(&mut self, sound: bool, fruitless: Option<u64>) -> Result<()> {
        self.flush()?;
        let given_up = fruitless.map_or(Ok(false), |step| self.give_up(step))?;
        if (sound && !given_up) || self.step_back()? {
            self.write_weights("last")?;
        }
        Ok(())
    }

    /// Returns whether the weights are finite; a step that is too large makes them non-finite.
    fn weights_are_finite(&self) -> Result<bool> {
        let weights = self.weights()?;
        Ok(weights.parameters().into_iter().flatten().all(|w| w.is_finite()))
    }

    /// Returns whether the validation due after the last step is missing.
    fn is_validation_missing(&self) -> bool {
        let validated = |records: &Records| records.is_validated(self.counters.step);
        self.counters.validation_due && self.records.as_ref().is_some_and(|records| !validated(records))
    }

    /// Removes the checkpoint of `step` if an older one is intact. Returns whether it did.
    fn give_up(&self, step: u64) -> Result<bool> {
        let removed = self.ranks.rank() == 0 && self.folder.remove_if_older(step)?;
        if removed {
            tracing::warn!(
                "no finite step followed the checkpoint of step {step}; going back to the one before"
            );
        }
        Ok(self.ranks.decide(removed))
    }

    /// Restores the newest checkpoint. Returns whether there is one.
    fn step_back(&mut self) -> Result<bool> {
        let (newest, _) = self.folder.newest(&*self.ranks)?;
        let Some(Checkpoint { mut counters, tensors, .. }) = newest else { return Ok(false) };
        self.learner.load(&tensors)?;
        restore(&mut self.pools, &mut counters)?;
        self.counters = counters;
        Ok(true)
    }

    /// Performs one training step.
    fn advance(&mut self) -> Result<StepReport> {
        let began = Instant::now();
        let step = self.counters.step;
        let pools = self.pools.iter().filter(|pool| pool.takes_part(step));
        let batches: Vec<Batch> = pools.map(|pool| pool.draw(step)).collect();
        let number = self.counters.updates + 1;
        // Ramp up the decay, or a slow mean would remember the initial weights for too long.
        let average = self.config.average.min(number as f64 / (number + 9) as f64);
        let rate = self.config.schedule.rate(self.config.optimizer.rate, step, self.config.steps);
        let update = WeightUpdate { number, rate, average };
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

    /// Runs the validation rollouts and saves the weights if they are the best so far. Returns whether it
    /// completed without interruption. Only rank 0 validates.
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
        // The card first: a validation that the table lists is not repeated.
        self.write_weights("last")?;
        self.records.iter().try_for_each(Records::append_scores)?;
        self.plot()?;
        Ok(true)
    }

    /// Writes the complete state of this rank; on rank 0 also metrics, weights and plot.
    fn save(&mut self) -> Result<()> {
        // Metrics first: those after the newest checkpoint are computed again, those before it are not. A
        // table that cannot be written does not take the checkpoint with it.
        let flushed = self.flush();
        self.write_checkpoint()?;
        flushed?;
        self.write_weights("last")?;
        self.plot()
    }

    /// Plots the curves so far, on rank 0.
    fn plot(&self) -> Result<()> {
        self.records.iter().try_for_each(|records| records.plot(&self.folder, &self.config))
    }

    /// Writes the complete state of this rank.
    fn write_checkpoint(&self) -> Result<()> {
        let pools = self.pools.iter().map(|pool| pool.slots().to_vec()).collect();
        let checkpoint = Checkpoint {
            config: self.text.clone(),
            counters: Counters { pools, device: self.learner.device(), ..self.counters.clone() },
            tensors: self.learner.save()?,
        };
        self.folder.keep(&checkpoint, &*self.ranks)
    }

    /// Writes the weights under this name, with the validation if one followed this step. Only rank 0 writes.
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

/// Moves the slots of a checkpoint from `counters` into the pools.
fn restore(pools: &mut [Pool], counters: &mut Counters) -> Result<()> {
    let all = std::mem::take(&mut counters.pools);
    pools.iter_mut().zip(all).try_for_each(|(pool, slots)| pool.restore(slots, "checkpoint"))
}

/// Warns if a run continues on another device, where it is not bit-reproducible. The number of CPU threads
/// does not matter.
fn warn_of_other_device(before: &str, now: &str) {
    let kind = |name: &str| name.split(',').next().map(str::to_owned);
    if !before.is_empty() && kind(before) != kind(now) {
        tracing::warn!("the run was trained on {before}; on {now} it does not continue to the same bits");
    }
}

/// Returns rank 0's text: the absolute path of the same folder may differ between machines.
fn shared(text: &str, ranks: &dyn Ranks) -> String {
    let mut bytes = text.as_bytes().to_vec();
    bytes.resize(ranks.broadcast_u64(bytes.len() as u64) as usize, 0);
    ranks.broadcast(&mut bytes);
    String::from_utf8_lossy(&bytes).into_owned()
}

/// A timer for recurring work.
struct Clock {
    every: Every,
    since: Instant,
}

impl Clock {
    fn new(every: Every) -> Self {
        Self { every, since: Instant::now() }
    }

    /// Returns whether the work is due after `step` steps.
    fn is_due(&self, step: u64) -> bool {
        match self.every {
            Every::Steps(steps) => step > 0 && step.is_multiple_of(steps),
            Every::Minutes(minutes) => self.since.elapsed().as_secs_f64() >= 60.0 * minutes,
        }
    }

    /// Restarts the timer.
    fn restart(&mut self) {
        self.since = Instant::now();
    }
}

#[cfg(test)]
mod tests {
    use super::{Clock, Every};
    use std::time::{Duration, Instant};

    #[test]
    fn a_clock_counts_minutes_since_its_restart() {
        let ago =
            |seconds| Instant::now().checked_sub(Duration::from_secs(seconds)).expect("a time since boot");
        let mut clock = Clock { every: Every::Minutes(0.5), since: ago(25) };
        assert!(!clock.is_due(7));
        clock.since = ago(31);
        assert!(clock.is_due(7));
        clock.restart();
        assert!(!clock.is_due(7));
        let steps = Clock::new(Every::Steps(3));
        assert_eq!([0, 1, 3, 4, 6].map(|step| steps.is_due(step)), [false, false, true, false, true]);
    }
}
