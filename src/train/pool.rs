//! A pool of cloths: drawing batches, tracking progress, resetting cloths (paper section 3.3, after Stotko et
//! al. 2024).

use super::config::{MotionRanges, PoolConfig, ResetRules};
use super::learner::{Batch, Drawn, Outcome};
use super::random::{Purpose, generator};
use super::script::Script;
use crate::{Error, Result};

/// Maximum number of handles of a cloth in a pool.
pub const MAX_HANDLES: usize = 16;

/// The host's side of a pool: the progress of each cloth. The [`super::Learner`] holds its arrays.
#[derive(Clone, Debug)]
pub struct Pool {
    index: usize,
    seed: u64,
    config: PoolConfig,
    motion: MotionRanges,
    reset: ResetRules,
    slots: Vec<Slot>,
}

/// The progress of a cloth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(super) struct Slot {
    /// Number of lives before this one.
    generation: u32,
    /// Number of completed frames of this life.
    frame: u32,
    /// Number of completed iterations of the current frame.
    iterations: u32,
    /// Whether the arrays hold this life; if not, it starts when the cloth is next drawn.
    begun: bool,
}

impl Slot {
    /// Starts the next life.
    fn reset(&mut self) {
        *self = Self { generation: self.generation + 1, ..Self::default() };
    }
}

impl Pool {
    /// Creates the pool with index `index` of a run with this seed; none of its cloths has started.
    pub fn new(
        index: usize,
        seed: u64,
        config: PoolConfig,
        (motion, reset): (MotionRanges, ResetRules),
    ) -> Self {
        let slots = vec![Slot::default(); config.cloths];
        Self { index, seed, config, motion, reset, slots }
    }

    /// Returns the configuration of the pool.
    pub fn config(&self) -> &PoolConfig {
        &self.config
    }

    /// Returns whether training step `step` draws from this pool. Consecutive pools with the same `every`
    /// take turns.
    pub fn takes_part(&self, step: u64) -> bool {
        (step + self.index as u64).is_multiple_of(self.config.every)
    }

    /// Draws the cloths of training step `step`, all distinct.
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

    /// Counts the completed iteration of the cloths of `batch`, and resets cloths that went wrong.
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
                slot.reset();
            }
        }
    }

    /// Resets the cloths that are due after training step `step`, round-robin, so that lives last
    /// `sequence_length` frames on average.
    pub fn rotate(&mut self, step: u64) {
        // Iterations per life. Each draw performs `batch` of them, and every `life` iterations one cloth is
        // reset.
        let frames = self.config.sequence_length.unwrap_or(self.reset.sequence_length);
        let life = u128::from(frames) * u128::from(self.config.iterations);
        let resets = |steps: u64| u128::from(steps / self.config.every) * self.config.batch as u128 / life;
        for reset in resets(step)..resets(step + 1) {
            let slot = (reset % self.slots.len() as u128) as usize;
            self.slots[slot].reset();
        }
    }

    /// Returns the progress of each cloth, for a checkpoint.
    pub(super) fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// Restores the progress from [`Pool::slots`] of a checkpoint; `origin` names it in errors. Fails if the
    /// number of cloths differs.
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
    /// Returns whether a step left a cloth in a state that is useless for training.
    fn wrong(&self, outcome: &Outcome) -> bool {
        let e = &outcome.energy;
        let inner = e.stretch + e.shear + e.bend;
        let inside = |&scale: &f64| match self.scale {
            Some([smallest, largest]) => (smallest..=largest).contains(&scale),
            None => scale.is_finite(),
        };
        // Comparisons with NaN are false, so NaN counts as wrong.
        !(inner <= self.energy && e.total().is_finite() && outcome.scale.iter().all(inside))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloth::EnergyTerms;

    #[test]
    fn cloths_start_over_when_their_energy_or_scale_leaves_the_bounds() {
        let rules = ResetRules { energy: 10.0, sequence_length: 5, scale: Some([0.01, 2.0]) };
        let wrong = |energy: EnergyTerms, scale: f64| {
            rules.wrong(&Outcome { energy, log_gradient: 0.0, scale: [0.05, scale, 0.05] })
        };
        let with = |stretch, shear, bend, external| EnergyTerms {
            stretch,
            shear,
            bend,
            external,
            ..EnergyTerms::default()
        };
        // Stretch, shear and bend count together; work of gravity does not.
        assert!(!wrong(with(4.0, 3.0, 3.0, 1e6), 0.05));
        for energy in [with(4.1, 3.0, 3.0, 0.0), with(4.0, 3.1, 3.0, 0.0), with(4.0, 3.0, 3.1, 0.0)] {
            assert!(wrong(energy, 0.05), "{energy:?}");
        }
        assert!(wrong(with(1.0, 1.0, 1.0, f64::NAN), 0.05) && wrong(with(f64::NAN, 0.0, 0.0, 0.0), 0.05));
        let calm = with(1.0, 1.0, 1.0, 0.0);
        assert!(!wrong(calm, 2.0) && !wrong(calm, 0.01));
        assert!(wrong(calm, 2.1) && wrong(calm, 0.009) && wrong(calm, f64::NAN));
        let free = ResetRules { scale: None, ..rules };
        assert!(!free.wrong(&Outcome { energy: calm, log_gradient: 0.0, scale: [1e6; 3] }));
        assert!(free.wrong(&Outcome { energy: calm, log_gradient: 0.0, scale: [f64::INFINITY; 3] }));
    }
}
