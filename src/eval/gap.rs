//! The energy gap: how close a solver comes to the minimum of a frame, on the device it runs on, and how long it
//! takes.

use crate::Device;
use crate::Result;
use crate::cpu::{self, Track};
use crate::scene::Setup;
use crate::sim::{Optimizer, Solver};
use crate::statistics::median_time;
use std::ops::ControlFlow;
use std::time::Instant;

/// What an optimizer reaches on the frames of a converged simulation, and what it takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// Median energy gap `(L_N - L_ref) / (L_0 - L_ref)`; infinite if one of the gaps is not finite, or if there
    /// are none.
    pub median: f64,
    /// Median wall time of the same frames \[ms\], without the warm-up if there are more; NaN without frames. Of
    /// each frame alone: on a GPU from its recording until the device has finished it, with nothing else in flight.
    /// The transfer of states and controls, the readback and the evaluation of the energy are not in it.
    pub ms_per_frame: f64,
}

/// Computes the converged frames of a scene, with a warning if some do not converge: they have no gap. `tick`
/// is called before each frame; if it breaks, the result is `None`.
pub fn track(setup: &Setup, mut tick: impl FnMut() -> ControlFlow<()>) -> Result<Option<Track>> {
    let mut ended = false;
    let controls = (1..setup.frames()).map(|frame| setup.control(frame)).take_while(|_| {
        ended = tick().is_break();
        !ended
    });
    let track = Track::new(&setup.model, setup.start.clone(), controls)?;
    if track.unconverged() > 0 {
        let (unconverged, frames) = (track.unconverged(), setup.frames() - 1);
        tracing::warn!(
            "newton did not converge in {unconverged} of {frames} frames, which energy gaps leave out"
        );
    }
    Ok((!ended).then_some(track))
}

/// Returns the median energy gap of an optimizer after `iterations` on the frames of `track`; infinite if one
/// of the gaps is not finite, or if there are none. `tick` is called before each frame; if it breaks, the
/// result is `None`.
pub fn median_gap(
    track: &Track,
    solver: (&Optimizer, usize),
    device: &Device,
    tick: impl FnMut() -> ControlFlow<()>,
) -> Result<Option<f64>> {
    Ok(timed_gap(track, solver, device, tick)?.map(|gap| gap.median))
}

/// Returns the energy gap of an optimizer after `iterations` on the frames of `track`, and the time that those
/// frames take. `tick` is called before each frame; if it breaks, the result is `None`.
pub fn timed_gap(
    track: &Track,
    (optimizer, iterations): (&Optimizer, usize),
    device: &Device,
    mut tick: impl FnMut() -> ControlFlow<()>,
) -> Result<Option<Gap>> {
    let mut times_ms = Vec::new();
    let mut took = |begun: Instant| times_ms.push(begun.elapsed().as_secs_f64() * 1e3);
    let median = match device {
        Device::Cpu => {
            let mut solver = cpu::Solver::<f32>::new(track.model(), optimizer, iterations)?;
            track.median_gap(|before, control| {
                if tick().is_break() {
                    return Ok(None);
                }
                let mut state = before.clone();
                let begun = Instant::now();
                solver.step(&mut state, control);
                took(begun);
                Ok(Some(solver.accelerations().to_vec()))
            })?
        }
        Device::Gpu(context) => {
            let solver = Solver::new(context, track.model(), optimizer, iterations)?;
            track.median_gap(|before, control| {
                if tick().is_break() {
                    return Ok(None);
                }
                solver.replace_state(before);
                solver.set_control(control);
                // What was written goes to the device with the next submission, which is not to be the frame's.
                context.submit(|_| {});
                context.wait()?;
                let begun = Instant::now();
                context.submit(|encoder| solver.record(encoder));
                context.wait()?;
                took(begun);
                solver.accelerations().read(context).map(Some)
            })?
        }
    };
    Ok(median.map(|median| Gap { median, ms_per_frame: median_time(&times_ms) }))
}
