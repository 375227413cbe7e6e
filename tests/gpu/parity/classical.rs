//! Helpers shared by the tests of the classical optimizers: frames with the same gradients on both sides.

use super::cloth::{field, iterate, model};
use crate::common::{assert_close, context, largest, narrowed, read, run, widened};
use fnopt::cloth::Grid;
use fnopt::cpu::optim::minimizer;
use fnopt::gpu::Schedule;
use fnopt::kernels::optim::Iterate;
use fnopt::sim::Optimizer;

/// Iterations per frame.
const ITERATIONS: usize = 12;

/// Appends an iteration's dispatch.
pub type Push<'a> = &'a dyn Fn(&mut Schedule, usize, &Iterate);

/// Runs two frames of `optimizer` on a quadratic energy of a batch with handles, on the device with `push`
/// and on the CPU path in double precision with the device's gradients. Asserts that the accelerations agree
/// to `tolerance` of the largest. In one iteration of each frame, long before it converges, the energy changes
/// sign, so that some curvature is negative.
pub fn frames_match(optimizer: &Optimizer, push: Push<'_>, (grid, batch): (Grid, usize), tolerance: f64) {
    let model = model(grid, batch);
    let n = grid.particles();
    let iterate = iterate(&model);
    let start = widened(&field(&model, 1.0, 112));
    // As stiff as the inertia in the Hessian at rest.
    let scale = if optimizer.name() == "quasi-newton" { 1.0 / n as f64 } else { 1.0 };
    let stiffness: Vec<f64> = field(&model, 0.7, 113).iter().map(|&d| scale * (1.0 + f64::from(d))).collect();
    let mut host = minimizer::<f64>(optimizer, &model).unwrap();
    for frame in 0..2 {
        let mut a = vec![0.0; start.len()];
        iterate.a.write(context(), &narrowed(&a));
        host.begin_frame();
        for iteration in 0..ITERATIONS {
            let sign = if iteration == 3 { -1.0 } else { 1.0 };
            let on_device = widened(&read(&iterate.a));
            let grad: Vec<f64> =
                (0..a.len()).map(|k| sign * (stiffness[k] * on_device[k] + start[k])).collect();
            let grad = narrowed(&grad);
            iterate.grad.write(context(), &grad);
            run(|schedule| push(schedule, iteration, &iterate));
            host.step(&widened(&grad), &[], &mut a);
            let what = format!("{} {batch} x {grid}, frame {frame}, iteration {iteration}", optimizer.name());
            let atol = tolerance * largest(&a);
            assert_close(&what, &read(&iterate.a), &a, (atol, 0.0));
        }
    }
}
