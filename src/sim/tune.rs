//! The search for an adapter's fastest tile sizes.

use super::{Optimizer, Solver};
use crate::cloth::{Model, State};
use crate::gpu::{Context, Tuning};
use crate::{Error, Result};
use std::ops::ControlFlow;
use std::time::Instant;

/// Minimum number of timed frames per measurement. One untimed frame precedes them, in which drivers compile.
const FRAMES: usize = 4;
/// Minimum time of a measurement \[s\], for devices that raise their clocks only under load.
const SECONDS: f64 = 0.1;
/// Largest time, relative to the best so far, at which another tuning replaces it. Smaller gains are noise.
const GAIN: f64 = 0.98;
/// Frames of the best tuning and of the table's, which alternate at the end. The minimum of many measurements
/// owes something to luck, so the winner must win again, measured over the same period.
const DUEL: usize = 10;

/// Searches for the tuning with the least time per frame of `optimizer` on `model`, from `start`. Begins with
/// the table's tuning, varies one aspect at a time and keeps the best. Returns the table's tuning unless the
/// best one beats it again at the end. `tried` is called with each tuning and its time \[ms\] and may end the
/// search, which then returns the table's. Panics if a length of `start` does not match the model.
pub fn tune(
    context: &Context,
    (model, start): (&Model, &State<f32>),
    optimizer: &Optimizer,
    iterations: usize,
    mut tried: impl FnMut(&Tuning, f64) -> ControlFlow<()>,
) -> Result<Tuning> {
    let watch = Stopwatch { context, model, start, optimizer, iterations };
    let table = Tuning::table(context);
    let best = watch.search(table, &mut tried)?;
    Ok(if best != table && watch.beats(&best, &table)? { best } else { table })
}

/// Times the frames of one simulation.
struct Stopwatch<'a> {
    context: &'a Context,
    model: &'a Model,
    start: &'a State<f32>,
    optimizer: &'a Optimizer,
    iterations: usize,
}

impl Stopwatch<'_> {
    fn solver(&self, tuning: &Tuning) -> Result<Solver> {
        let context = self.context.with_tuning(*tuning)?;
        Solver::new(&context, self.model, self.optimizer, self.iterations)
    }

    /// Returns the time of the first frame from the start \[ms\].
    fn frame(&self, solver: &Solver) -> Result<f64> {
        solver.set_state(self.start);
        self.context.wait()?;
        let begun = Instant::now();
        self.context.submit(|encoder| solver.record(encoder));
        self.context.wait()?;
        Ok(1e3 * begun.elapsed().as_secs_f64())
    }

    /// Returns the least time of several frames \[ms\].
    fn least(&self, solver: &Solver) -> Result<f64> {
        self.frame(solver)?;
        let (begun, mut frames, mut least) = (Instant::now(), 0, f64::INFINITY);
        while frames < FRAMES || begun.elapsed().as_secs_f64() < SECONDS {
            least = least.min(self.frame(solver)?);
            frames += 1;
        }
        Ok(least)
    }

    /// Returns the fastest tuning found from `table` on, or `table` if `tried` ends the search.
    fn search(
        &self,
        table: Tuning,
        tried: &mut dyn FnMut(&Tuning, f64) -> ControlFlow<()>,
    ) -> Result<Tuning> {
        let solver = self.solver(&table)?;
        let (mut best, mut least, mut dispatches) =
            (table, self.least(&solver)?, solver.schedule().dispatches());
        drop(solver);
        let mut flow = tried(&best, least);
        for respect in 0..table.neighbours(self.context).len() {
            let before = best;
            for tuning in &before.neighbours(self.context)[respect] {
                if flow.is_break() {
                    return Ok(table);
                }
                // Where blocks have one row per invocation anyway, chance would choose how many batches have.
                let takes_lines = before.takes_lines() && self.model.batch() >= Tuning::BATCH;
                if tuning.block_lines != before.block_lines && !takes_lines {
                    continue;
                }
                let solver = match self.solver(tuning) {
                    Ok(solver) => solver,
                    // Too much for the device; the others may do.
                    Err(Error::Device(_)) => continue,
                    Err(error) => return Err(error),
                };
                // Skip activation limits that lead to as many passes here: chance would choose between them,
                // and other batches would bear the consequences.
                let same_passes = solver.schedule().dispatches() == dispatches;
                if same_passes && (Tuning { activation_bytes: best.activation_bytes, ..*tuning }) == best {
                    continue;
                }
                let measured = self.least(&solver)?;
                flow = tried(tuning, measured);
                if measured < GAIN * least {
                    (best, least, dispatches) = (*tuning, measured, solver.schedule().dispatches());
                }
            }
        }
        Ok(if flow.is_break() { table } else { best })
    }

    /// Whether one tuning beats another when their frames alternate.
    fn beats(&self, one: &Tuning, other: &Tuning) -> Result<bool> {
        let (one, other) = match (self.solver(one), self.solver(other)) {
            (Ok(one), Ok(other)) => (one, other),
            // If both do not fit in memory together, the gain cannot be confirmed.
            (Err(Error::Device(_)), _) | (_, Err(Error::Device(_))) => return Ok(false),
            (Err(error), _) | (_, Err(error)) => return Err(error),
        };
        [&one, &other].into_iter().try_for_each(|solver| self.frame(solver).map(drop))?;
        let mut least = [f64::INFINITY; 2];
        for _ in 0..DUEL {
            least = [least[0].min(self.frame(&one)?), least[1].min(self.frame(&other)?)];
        }
        Ok(least[0] < GAIN * least[1])
    }
}
