//! `lbfgs` against the CPU path.

use super::classical::frames_match;
use crate::common::{GRIDS, cases, context, device};
use fnopt::cloth::Grid;
use fnopt::gpu::AdapterKind;
use fnopt::kernels::optim::{Lbfgs, LbfgsMemory, Part};
use fnopt::settings::LbfgsSettings;
use fnopt::sim::{Direction, Initial, Length, Optimizer};

/// Two dozen iterations amplify the roundings of the sums by the condition number of the problem, about 6.
const TOLERANCE: f64 = 2e-5;

/// Steps along secants, from the identity.
#[test]
fn steps_along_secants_match() {
    let _turn = device();
    for (grid, batch) in cases() {
        let settings = LbfgsSettings { history: 5, curvature: 1e-12 };
        let kernel = Lbfgs::along_secants(context(), settings, Part::Whole).unwrap();
        let memory = forgotten(grid, batch, 5);
        let push = |s: &mut _, iteration, iterate: &_| kernel.push(s, iteration, iterate, &memory);
        let direction = Direction::Lbfgs { settings, initial: Initial::Identity };
        let optimizer = Optimizer { directions: vec![direction], length: Length::Secant };
        frames_match(&optimizer, &push, (grid, batch), TOLERANCE);
    }
}

/// Whatever the memory holds, a frame starts without it.
fn forgotten(grid: Grid, batch: usize, history: usize) -> LbfgsMemory {
    let memory = LbfgsMemory::new(context(), batch, grid.particles(), history).unwrap();
    for tensor in [&memory.history, &memory.last, &memory.pairs] {
        tensor.write(context(), &vec![f32::NAN; tensor.len()]);
    }
    memory
}

fn check(history: usize, curvature: f64, (grid, batch): (Grid, usize)) {
    let settings = LbfgsSettings { history, curvature };
    let kernel = Lbfgs::new(context(), settings).unwrap();
    let memory = forgotten(grid, batch, history);
    let push = |s: &mut _, iteration, iterate: &_| kernel.push(s, iteration, iterate, &memory);
    frames_match(&Optimizer::lbfgs_with(settings), &push, (grid, batch), TOLERANCE);
}

#[test]
fn steps_match() {
    let _turn = device();
    for case in cases() {
        check(5, 1e-12, case);
    }
}

/// Histories of one pair, of more pairs than a frame produces, and of the most that the kernel holds.
#[test]
fn histories_of_all_lengths_match() {
    let _turn = device();
    for history in [1, 11, 32] {
        check(history, 1e-12, (GRIDS[1], 2));
    }
}

/// Software drivers stop long loops silently, so larger sizes are refused there.
#[test]
fn sizes_beyond_the_loop_limit_are_refused() {
    let kernel = Lbfgs::new(context(), LbfgsSettings { history: 32, curvature: 1e-12 }).unwrap();
    let refused = kernel.check_size(context(), 512 * 512).is_err();
    assert_eq!(refused, context().kind() == AdapterKind::Software);
    assert!(kernel.check_size(context(), 100 * 100).is_ok());
}
