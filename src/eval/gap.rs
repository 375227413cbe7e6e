//! How close a solver comes to the minimum of a frame, on the device it runs on.

use crate::Result;
use crate::cpu::Track;
use crate::sim::{Device, Optimizer, Solver, SolverOptions};

/// The median energy gap of an optimizer after `iterations` on the frames of `track`; infinite when one of them is no number.
pub fn median_gap(
    track: &Track,
    (optimizer, iterations): (&Optimizer, usize),
    device: &Device,
) -> Result<f64> {
    let Device::Gpu(context) = device else { return track.median_gap(optimizer, iterations) };
    let options = SolverOptions { iterations, ..Default::default() };
    let solver = Solver::new(context, track.model(), optimizer, &options)?;
    track.median_gap_of(|before, control| {
        solver.place(before);
        solver.set_control(control);
        context.submit(|encoder| solver.record(encoder));
        solver.accelerations().read(context)
    })
}
