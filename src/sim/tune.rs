//! Which tile sizes are fastest on the adapter at hand.

use super::{Model, Optimizer, Solver, SolverOptions, State};
use crate::Result;
use crate::gpu::Context;
use crate::kernels::Tuning;
use std::ops::ControlFlow;
use std::time::Instant;

/// Frames of a measurement; the first is not timed, because drivers compile then.
const FRAMES: usize = 5;
/// How much faster another tuning must be to be taken: less is noise.
const GAIN: f64 = 0.98;

/// Searches the tuning with the least time per frame of `optimizer` on `model`, from `start`: respect by respect from the
/// table's, each time keeping the best. `tried` is called with each tuning and its time \[ms\] and may end the search.
pub fn tune(
    context: &Context,
    (model, start): (&Model, &State<f32>),
    optimizer: &Optimizer,
    iterations: usize,
    mut tried: impl FnMut(&Tuning, f64) -> ControlFlow<()>,
) -> Result<Tuning> {
    let mut time = |tuning: &Tuning| -> Result<(f64, ControlFlow<()>)> {
        let options = SolverOptions { iterations, tuning: Some(*tuning) };
        let solver = Solver::new(context, model, optimizer, &options)?;
        let mut least = f64::INFINITY;
        for frame in 0..FRAMES {
            solver.set_state(start);
            context.wait()?;
            let begun = Instant::now();
            context.submit(|encoder| solver.record(encoder));
            context.wait()?;
            if frame > 0 {
                least = least.min(1e3 * begun.elapsed().as_secs_f64());
            }
        }
        Ok((least, tried(tuning, least)))
    };
    let mut best = Tuning::table(context);
    let (mut least, mut flow) = time(&best)?;
    for respect in 0..best.neighbours(context).len() {
        let before = best;
        for tuning in &before.neighbours(context)[respect] {
            if flow.is_break() {
                return Ok(best);
            }
            let measured;
            (measured, flow) = time(tuning)?;
            if measured < GAIN * least {
                (best, least) = (*tuning, measured);
            }
        }
    }
    Ok(best)
}
