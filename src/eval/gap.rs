//! The energy gap: how close a solver comes to the minimum of a frame, on the device it runs on.

use crate::Device;
use crate::Result;
use crate::cpu::{self, Track};
use crate::scene::Setup;
use crate::sim::{Optimizer, Solver};
use std::ops::ControlFlow;

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
    (optimizer, iterations): (&Optimizer, usize),
    device: &Device,
    mut tick: impl FnMut() -> ControlFlow<()>,
) -> Result<Option<f64>> {
    let Device::Gpu(context) = device else {
        let mut solver = cpu::Solver::<f32>::new(track.model(), optimizer, iterations)?;
        return track.median_gap(|before, control| {
            if tick().is_break() {
                return Ok(None);
            }
            solver.step(&mut before.clone(), control);
            Ok(Some(solver.accelerations().to_vec()))
        });
    };
    let solver = Solver::new(context, track.model(), optimizer, iterations)?;
    track.median_gap(|before, control| {
        if tick().is_break() {
            return Ok(None);
        }
        solver.replace_state(before);
        solver.set_control(control);
        context.submit(|encoder| solver.record(encoder));
        solver.accelerations().read(context).map(Some)
    })
}
