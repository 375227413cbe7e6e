//! `gradient_descent` against the CPU path.

use super::classical::frames_match;
use crate::common::{ROUNDING, cases, context, device};
use fnopt::kernels::optim::GradientDescent;
use fnopt::sim::Optimizer;

#[test]
fn steps_match() {
    let _turn = device();
    let kernel = GradientDescent::new(context()).unwrap();
    for case in cases() {
        let optimizer = Optimizer::descent(0.3);
        frames_match(&optimizer, &|s, _, iterate| kernel.push(s, 0.3, iterate), case, 12.0 * ROUNDING);
    }
}
