//! A pool of cloths: who is drawn, how far each is, who begins anew (paper section 3.3, after Wandel et al. 2020).

use super::config::{MotionRanges, PoolConfig, ResetRules};
use super::learner::{Batch, Drawn, Outcome};
use super::random::{Purpose, generator};
use super::script::Script;
use crate::{Error, Result};

/// The most handles of a cloth of a pool.
pub const MAX_HANDLES: usize = 16;

/// The host's side of a pool: how far each cloth is. Its arrays are the [`super::Learner`]'s.
#[derive(Clone, Debug)]
pub struct Pool {
    index: usize,
    seed: u64,
    config: PoolConfig,
    motion: MotionRanges,
    reset: ResetRules,
    slots: Vec<Slot>,
}

/// How far a cloth is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(super) struct Slot {
    /// How many lives it had before this one.
    generation: u32,
    /// Frames of this life that are done.
    frame: u32,
    /// Iterations of the present frame that are done.
    iterations: u32,
    /// Whether the arrays hold this life; else it starts when it is next drawn.
    begun: bool,
}

impl Slot {
    /// The next life.
    fn begin_anew(&mut self) {
        *self = Self { generation: self.generation + 1, ..Self::default() };
    }
}

impl Pool {
    /// The pool of index `index` in a run with this seed, none of its cloths begun.
    pub fn new(
        index: usize,
        seed: u64,
        config: PoolConfig,
        (motion, reset): (MotionRanges, ResetRules),
    ) -> Self {
        let slots = vec![Slot::default(); config.cloths];
        Self { index, seed, config, motion, reset, slots }
    }

    /// What it was made from.
    pub fn config(&self) -> &PoolConfig {
        &self.config
    }

    /// Whether training step `step` draws from this pool. Pools that are drawn from equally seldom and follow each other take
    /// turns.
    pub fn takes_part(&self, step: u64) -> bool {
        (step + self.index as u64).is_multiple_of(self.config.every)
    }

    /// The cloths of training step `step`, all different.
    pub fn draw(&self, step: u64) -> Batch {
        let mut random = generator(self.seed, Purpose::Batch { pool: self.index }, step);
        let slots = rand::seq::index::sample(&mut random, self.config.cloths, self.config.batch);
        let drawn = |slot: usize| {
            let Slot { generation, frame, iterations, begun } = self.slots[slot];
            let script = Script::new(self.seed, &self.motion, (self.index, &self.config), (slot, generation));
            Drawn {
                slot,
                targets: script.targets(frame + 1),
                start: (!begun).then(|| script.start()),
                advance: iterations + 1 == self.config.iterations,
                damping: script.damping,
                cloth: script.cloth,
            }
        };
        Batch { pool: self.index, cloths: slots.into_iter().map(drawn).collect() }
    }

    /// Counts the iteration that the cloths of `batch` have done; one that came out wrong begins anew.
    pub fn record(&mut self, batch: &Batch, outcomes: &[Outcome]) {
        assert_eq!(batch.cloths.len(), outcomes.len(), "every cloth has an outcome");
        for (drawn, outcome) in batch.cloths.iter().zip(outcomes) {
            let slot = &mut self.slots[drawn.slot];
            slot.begun = true;
            slot.iterations += 1;
            if drawn.advance {
                slot.iterations = 0;
                slot.frame += 1;
            }
            if self.reset.wrong(outcome) {
                slot.begin_anew();
            }
        }
    }

    /// After training step `step`: now and then the next cloth in turn begins anew, so that lives last
    /// `sequence_length` frames on average.
    pub fn rotate(&mut self, step: u64) {
        // Iterations of a life, over the whole pool and drawn `batch` at a time.
        let frames = self.config.sequence_length.unwrap_or(self.reset.sequence_length);
        let life = u128::from(frames) * u128::from(self.config.iterations);
        let turns = |steps: u64| u128::from(steps / self.config.every) * self.config.batch as u128 / life;
        for turn in turns(step)..turns(step + 1) {
            let slot = (turn % self.slots.len() as u128) as usize;
            self.slots[slot].begin_anew();
        }
    }

    /// How far each cloth is, for a checkpoint.
    pub(super) fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// Goes on from [`Pool::slots`] of a checkpoint; `origin` names it in errors.
    pub(super) fn restore(&mut self, slots: Vec<Slot>, origin: &str) -> Result<()> {
        if slots.len() != self.slots.len() {
            let (field, expected) = (format!("pool {}", self.index), format!("{} cloths", self.slots.len()));
            return Err(Error::invalid(origin, field, expected, slots.len()));
        }
        self.slots = slots;
        Ok(())
    }
}

impl ResetRules {
    /// Whether a cloth came out of a step in a state that nothing is to be learned from.
    fn wrong(&self, outcome: &Outcome) -> bool {
        let e = &outcome.energy;
        let inner = e.stretch + e.shear + e.bend;
        let inside = |&scale: &f64| match self.scale {
            Some([smallest, largest]) => (smallest..=largest).contains(&scale),
            None => scale.is_finite(),
        };
        // A comparison with NaN is false, so that NaN is wrong too.
        !(inner <= self.energy && e.total().is_finite() && outcome.scale.iter().all(inside))
    }
}
