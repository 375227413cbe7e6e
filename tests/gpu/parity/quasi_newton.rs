//! `cosine_order` and `rest_modes`, with both parts of `lbfgs`: the quasi-Newton step against the CPU path,
//! whose cosine transforms are dense matrices.

use super::classical::frames_match;
use super::cloth::{constants, field, iterate, model};
use crate::common::{assert_close, cases, context, device, largest, poisoned, read, run, widened};
use fnopt::cloth::Grid;
use fnopt::cpu::optim::minimizer;
use fnopt::kernels::cloth::ClothParams;
use fnopt::kernels::optim::{LbfgsMemory, QuasiNewton};
use fnopt::settings::LbfgsSettings;
use fnopt::sim::Optimizer;

const SETTINGS: LbfgsSettings = LbfgsSettings { history: 5, curvature: 1e-12 };

fn memory(grid: Grid, batch: usize, history: usize) -> LbfgsMemory {
    let memory = LbfgsMemory::new(context(), batch, grid.particles(), history).unwrap();
    // Whatever the memory holds, a frame starts without it.
    for tensor in [&memory.history, &memory.last, &memory.pairs] {
        tensor.write(context(), &vec![f32::NAN; tensor.len()]);
    }
    memory
}

/// Without history, the step is the inverse Hessian at rest times the gradient. Grids have sides of all
/// parities, some of them prime.
#[test]
fn first_steps_match() {
    let _turn = device();
    let odd = [(9, 31), (47, 8), (100, 64), (33, 33)].map(|(h, w)| (Grid { h, w }, 2));
    for (grid, batch) in cases().chain(odd) {
        let model = model(grid, batch);
        let (iterate, memory) = (iterate(&model), memory(grid, batch, 5));
        let (base, grad) = (field(&model, 1.0, 121), field(&model, 1.0, 122));
        iterate.base.write(context(), &base);
        iterate.grad.write(context(), &grad);
        iterate.a.write(context(), &vec![0f32; grad.len()]);
        let plan = QuasiNewton::new(context(), SETTINGS, (grid, batch)).unwrap();
        run(|schedule| plan.push(schedule, 0, (&iterate, &constants(&model)), &memory));

        let mut exact = vec![0.0; grad.len()];
        let mut host = minimizer::<f64>(&Optimizer::quasi_newton(), &model).unwrap();
        host.begin_frame();
        host.step(&widened(&grad), &[], &mut exact);
        let name = format!("{batch} x {grid}");
        assert_close(&name, &read(&iterate.a), &exact, (5e-6 * largest(&exact), 0.0));
    }
}

/// With history, the pairs of earlier steps are applied before and after the inverse Hessian at rest.
#[test]
fn steps_match() {
    let _turn = device();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let (memory, cloths) = (memory(grid, batch, 5), constants(&model));
        let plan = QuasiNewton::new(context(), SETTINGS, (grid, batch)).unwrap();
        let push = |s: &mut _, iteration, iterate: &_| plan.push(s, iteration, (iterate, &cloths), &memory);
        frames_match(&Optimizer::quasi_newton(), &push, (grid, batch), 1e-4);
    }
}

#[test]
fn constants_of_other_cloths_are_refused() {
    let _turn = device();
    let grid = Grid { h: 12, w: 10 };
    let (model, plan) = (model(grid, 2), QuasiNewton::new(context(), SETTINGS, (grid, 2)).unwrap());
    let (iterate, memory, cloths) =
        (iterate(&model), memory(grid, 2, 5), poisoned("cloths", &[3, ClothParams::LEN]));
    let pushed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        run(|schedule| plan.push(schedule, 0, (&iterate, &cloths), &memory));
    }));
    assert!(pushed.is_err(), "constants of three cloths for two");
}
