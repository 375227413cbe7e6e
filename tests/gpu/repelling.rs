//! Frames of cloths with repulsion: against the CPU path, repeated, and with repulsion added and removed.

use crate::common::{assert_close, context, device, largest};
use crate::solver::{
    assert_repeats, assert_same, optimizers, solver, starter, statistics, step, varied_batch,
};
use fnopt::cloth::{Cloth, Control, Model, Repulsion, State};
use fnopt::cpu;
use fnopt::sim::{FrameStats, Optimizer};

/// Builds cloths that are contracted until their layers repel each other, and one without repulsion.
pub fn crowded() -> (Model, State<f32>, Control<f32>) {
    let (mut model, mut state, control) = varied_batch();
    model.cloths[0].repulsion = Some(Repulsion { strength: 0.05, distance: 0.8 });
    model.cloths[2].repulsion = Some(Repulsion { strength: 0.2, distance: 1.0 });
    state.x.iter_mut().for_each(|x| *x *= 0.5);
    let n = model.grid.particles();
    let at = |(b, p): (usize, usize)| [0, 1, 2].map(|c| state.x[(3 * b + c) * n + p]);
    let held = model.cloths.iter().enumerate().flat_map(|(b, c)| c.handles.iter().map(move |&p| (b, p)));
    let handles = held.map(at).collect();
    (model, state, Control { handles, ..control })
}

/// Repulsion agrees with the host for every optimizer. Runs repeat, and several frames in one submission
/// equal frames submitted one by one.
#[test]
fn frames_of_cloths_that_repel_themselves_agree_with_the_host() {
    let _turn = device();
    let (model, start, control) = crowded();
    for optimizer in optimizers() {
        let name = optimizer.name();
        let solver = solver(&model, &optimizer, 3, &start);
        let mut host = cpu::Solver::<f64>::new(&model, &optimizer, 3).unwrap();
        let mut expected = start.cast::<f64>();
        let found = step(&solver, &control);
        let stats = host.step(&mut expected, &control.cast());
        // As without repulsion (`frames_of_all_optimizers_agree_with_the_host`).
        let digits = if matches!(name, "adam" | "lbfgs" | "quasi-newton") { 2e-4 } else { 2e-5 };
        let atol = digits * largest(&expected.v);
        assert_close(name, &found.x, &expected.x, (atol, 2e-7));
        assert_close(name, &found.v, &expected.v, (atol, 2e-7));
        let energies = |stats: &[FrameStats]| stats.iter().map(|s| s.energy.repulsion).collect::<Vec<_>>();
        let (of_device, wanted) = (energies(&statistics(&solver)), energies(&stats));
        assert!(wanted[0] != 0.0 && wanted[1] == 0.0 && wanted[2] != 0.0, "{wanted:?}");
        let of_device: Vec<f32> = of_device.iter().map(|&e| e as f32).collect();
        assert_close(&format!("repulsion of {name}"), &of_device, &wanted, (digits * largest(&wanted), 0.0));
        assert_repeats(name, &solver, &start, &[control.clone(), control.clone()], &found.x);
    }
}

/// Particles counted but never sorted, as when a kernel is timed alone, affect no frame but the next one.
#[test]
fn counts_that_are_left_over_are_harmless() {
    let _turn = device();
    let (model, start, control) = crowded();
    let solver = solver(&model, &Optimizer::gradient_descent(), 2, &start);
    let expected = step(&solver, &control);
    let alone = solver.schedule().only("cell_count");
    context().submit(|encoder| alone.record(encoder));
    step(&solver, &control);
    solver.set_state(&start);
    assert_same("positions", &step(&solver, &control).x, &expected.x);
}

/// Removed repulsion has zero strength and pushes nothing: the bits are those of a solver that never had any.
#[test]
fn cloths_that_no_longer_repel_themselves_are_as_those_that_never_did() {
    let _turn = device();
    let (model, start, control) = crowded();
    let none: Vec<_> = model.cloths.iter().map(|c| Cloth { repulsion: None, ..c.clone() }).collect();
    let never = Model { grid: model.grid, cloths: none.clone() };
    let optimizer = Optimizer::paper(starter().clone());
    let mut changed = solver(&model, &optimizer, 3, &start);
    changed.set_cloths(&none).unwrap();
    let expected = step(&solver(&never, &optimizer, 3, &start), &control);
    assert_same("positions", &step(&changed, &control).x, &expected.x);
    // And back again.
    changed.set_cloths(&model.cloths).unwrap();
    changed.set_state(&start);
    let expected = step(&solver(&model, &optimizer, 3, &start), &control);
    assert_same("positions", &step(&changed, &control).x, &expected.x);
}

#[test]
fn a_solver_without_repulsion_refuses_it_later() {
    let _turn = device();
    let (model, start, _) = varied_batch();
    let mut solver = solver(&model, &Optimizer::gradient_descent(), 1, &start);
    let error = solver.set_cloths(&crowded().0.cloths).unwrap_err().to_string();
    assert!(error.contains("repulsion"), "{error}");
    assert_eq!(*solver.model(), model);
}

#[test]
fn invalid_repulsions_are_refused() {
    let (mut model, ..) = crowded();
    for (strength, distance, field) in [
        (-1.0, 1.0, "strength"),
        (f64::NAN, 1.0, "strength"),
        (1e38, 1.0, "strength"),
        (1.0, 0.0, "distance"),
        (1.0, 1e-39, "distance"),
        (1.0, 1.1, "distance"),
        (1.0, f64::NAN, "distance"),
    ] {
        model.cloths[2].repulsion = Some(Repulsion { strength, distance });
        let error = model.check().unwrap_err().to_string();
        assert!(error.contains(&format!("repulsion of cloth 2.{field}")), "{error}");
    }
}
