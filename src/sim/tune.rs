//! Which tile sizes are fastest on the adapter at hand.

use super::{Model, Optimizer, Solver, SolverOptions, State};
use crate::Result;
use crate::gpu::Context;
use crate::kernels::Tuning;
use std::ops::ControlFlow;
use std::time::Instant;

/// Least frames of a measurement after the first, which is not timed, because drivers compile then; and its least time \[s\], for
/// devices that raise their clocks only under load.
const FRAMES: usize = 4;
const SECONDS: f64 = 0.1;
/// How much faster another tuning must be to be taken: less is noise.
const GAIN: f64 = 0.98;
/// Frames of the best tuning and of the table's in turn, at the end. Of many measurements the least is the luckiest one: what was
/// found must win again, in the same moments.
const DUEL: usize = 10;

/// Searches the tuning with the least time per frame of `optimizer` on `model`, from `start`: respect by respect from the
/// table's, each time keeping the best; the table's, unless the best one wins against it once more. `tried` is called with each
/// tuning and its time \[ms\] and may end the search, with nothing found.
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
    let mut dispatches = of_best.frame().dispatches();
    let (mut least, mut flow) = time(&best, &of_best)?;
    drop(of_best);
    for respect in 0..best.neighbours(context).len() {
        let before = best;
        for tuning in &before.neighbours(context)[respect] {
            if flow.is_break() {
                return Ok(table);
            }
            let tried = solver(tuning)?;
            // Turns of another length that come to the same here are for chance to choose, and for other batches to bear.
            let as_many_turns = tried.frame().dispatches() == dispatches;
            if as_many_turns && (Tuning { activation_bytes: best.activation_bytes, ..*tuning }) == best {
                continue;
            }
            let measured;
            (measured, flow) = time(tuning, &tried)?;
            if measured < GAIN * least {
                (best, least, dispatches) = (*tuning, measured, tried.frame().dispatches());
            }
        }
    }
    if best == table {
        return Ok(table);
    }
    // Where both do not fit side by side nothing can be shown.
    let (Ok(ours), Ok(of_table)) = (solver(&best), solver(&table)) else { return Ok(table) };
    let mut least = [f64::INFINITY; 2];
    [&ours, &of_table].into_iter().try_for_each(|solver| frame(solver).map(drop))?;
    for _ in 0..DUEL {
        least = [least[0].min(frame(&ours)?), least[1].min(frame(&of_table)?)];
    }
    Ok(if least[0] < GAIN * least[1] { best } else { table })
}
