//! `adam` against the CPU path.

use super::classical::frames_match;
use crate::common::{ROUNDING, cases, context, device, poisoned};
use fnopt::kernels::optim::Adam;
use fnopt::settings::AdamSettings;
use fnopt::sim::Optimizer;

#[test]
fn steps_match() {
    let _turn = device();
    let kernel = Adam::new(context()).unwrap();
    let settings = AdamSettings { rate: 0.1, beta1: 0.9, beta2: 0.999, epsilon: 1e-8 };
    for (grid, batch) in cases() {
        // Whatever the moments hold, a frame starts without them.
        let moments = poisoned("moments", &[3 * batch, grid.particles(), 2]);
        let push =
            |s: &mut _, iteration, iterate: &_| kernel.push(s, settings, iteration, (iterate, &moments));
        // A dozen steps, each with half a dozen roundings. In single precision, 1 - beta2 has a relative
        // error of 6e-5, which the bias correction of the first iterations undoes.
        frames_match(&Optimizer::adam(), &push, (grid, batch), 100.0 * ROUNDING);
    }
}
