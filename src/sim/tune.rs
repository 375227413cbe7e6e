//! The search for an adapter's fastest tile sizes.

use super::{Optimizer, Solver, SolverOptions};
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
/// search, which then returns the table's.
pub fn tune(
    context: &Context,
    (model, start): (&Model, &State<f32>),
    optimizer: &Optimizer,
    iterations: usize,
    mut tried: impl FnMut(&Tuning, f64) -> ControlFlow<()>,
) -> Result<Tuning> {
    let solver = |tuning: &Tuning| {
        Solver::new(context, model, optimizer, &SolverOptions { iterations, tuning: Some(*tuning) })
    };
    let frame = |solver: &Solver| -> Result<f64> {
        solver.set_state(start);
        context.wait()?;
        let begun = Instant::now();
        context.submit(|encoder| solver.record(encoder));
        context.wait()?;
        Ok(1e3 * begun.elapsed().as_secs_f64())
    };
    let mut time = |tuning: &Tuning, solver: &Solver| -> Result<(f64, ControlFlow<()>)> {
        frame(solver)?;
        let (begun, mut frames, mut least) = (Instant::now(), 0, f64::INFINITY);
        while frames < FRAMES || begun.elapsed().as_secs_f64() < SECONDS {
            least = least.min(frame(solver)?);
            frames += 1;
        }
        Ok((least, tried(tuning, least)))
    };
    let table = Tuning::table(context);
    let mut best = table;
    let of_best = solver(&best)?;
    let mut dispatches = of_best.schedule().dispatches();
    let (mut least, mut flow) = time(&best, &of_best)?;
    drop(of_best);
    for respect in 0..best.neighbours(context).len() {
        let before = best;
        for tuning in &before.neighbours(context)[respect] {
            if flow.is_break() {
                return Ok(table);
            }
            let tried = match solver(tuning) {
                Ok(tried) => tried,
                // Too much for the device; the others may do.
                Err(Error::Device(_)) => continue,
                Err(error) => return Err(error),
            };
            // Skip activation limits that lead to as many passes here: chance would choose between them, and
            // other batches would bear the consequences.
            let same_passes = tried.schedule().dispatches() == dispatches;
            if same_passes && (Tuning { activation_bytes: best.activation_bytes, ..*tuning }) == best {
                continue;
            }
            let measured;
            (measured, flow) = time(tuning, &tried)?;
            if measured < GAIN * least {
                (best, least, dispatches) = (*tuning, measured, tried.schedule().dispatches());
            }
        }
    }
    if best == table || flow.is_break() {
        return Ok(table);
    }
    let (ours, of_table) = match (solver(&best), solver(&table)) {
        (Ok(ours), Ok(of_table)) => (ours, of_table),
        // If both do not fit in memory together, the gain cannot be confirmed.
        (Err(Error::Device(_)), _) | (_, Err(Error::Device(_))) => return Ok(table),
        (Err(error), _) | (_, Err(error)) => return Err(error),
    };
    let mut least = [f64::INFINITY; 2];
    [&ours, &of_table].into_iter().try_for_each(|solver| frame(solver).map(drop))?;
    for _ in 0..DUEL {
        least = [least[0].min(frame(&ours)?), least[1].min(frame(&of_table)?)];
    }
    Ok(if least[0] < GAIN * least[1] { best } else { table })
}
