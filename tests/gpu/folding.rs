//! Frames of cloths that are not flat at rest: against the CPU path, repeated, and with angles added and removed.

use crate::cloths::among_bodies;
use crate::common::{assert_close, device, largest};
use crate::solver::{assert_repeats, assert_same, optimizers, solver, statistics, step};
use fnopt::cloth::{Cloth, Control, Grid, Model, Repulsion, RestAngles, SelfContact, State};
use fnopt::cpu;
use fnopt::sim::Optimizer;

pub const GRID: Grid = Grid { h: 12, w: 17 };

/// Returns angles at rest along both axes, up to a right angle.
fn rest_angles(grid: Grid, seed: u64) -> RestAngles {
    let noise = crate::noise::noise(2 * grid.particles(), seed);
    let angles: Vec<[f64; 2]> = noise.chunks_exact(2).map(|a| [1.5 * a[0], 0.5 * a[1]]).collect();
    RestAngles::new(grid, &angles, "a test", "angles").unwrap()
}

/// Builds a batch of which two cloths have angles at rest, one of them with holes.
pub fn bent(grid: Grid) -> (Model, State<f32>, Control<f32>) {
    let (mut model, mut state, control) = crate::cloths::varied_batch(grid);
    for (cloth, seed) in model.cloths.iter_mut().skip(1).zip(40..) {
        cloth.material.bend = 2.0;
        cloth.rest_angles = Some(rest_angles(grid, seed));
    }
    let moves = crate::noise::noise(state.v.len(), 50);
    state.v.iter_mut().zip(moves).for_each(|(v, noise)| *v = 0.1 * noise as f32);
    (model, state, control)
}

#[test]
fn frames_of_bent_cloths_agree_with_the_host() {
    let _turn = device();
    let (model, start, control) = bent(GRID);
    for optimizer in optimizers() {
        let name = optimizer.name();
        let solver = solver(&model, &optimizer, 3, &start);
        let mut host = cpu::Solver::<f64>::new(&model, &optimizer, 3).unwrap();
        let mut expected = start.cast::<f64>();
        let found = step(&solver, &control);
        let stats = host.step(&mut expected, &control.cast());
        let digits = if matches!(name, "adam" | "lbfgs" | "quasi-newton") { 2e-4 } else { 2e-5 };
        let atol = digits * largest(&expected.v);
        assert_close(name, &found.x, &expected.x, (atol, 2e-7));
        assert_close(name, &found.v, &expected.v, (atol, 2e-7));
        for (found, wanted) in statistics(&solver).iter().zip(&stats) {
            let (found, wanted) = (found.energy.bend, wanted.energy.bend);
            assert!((found - wanted).abs() <= 1e-3 * wanted, "{name}: {found}, not {wanted}");
        }
        assert_repeats(name, &solver, &start, &[control.clone(), control.clone()], &found.x);
    }
}

/// Couples act beside repulsion, self-contact and bodies.
#[test]
fn bent_cloths_among_bodies_agree_with_the_host() {
    let _turn = device();
    let (mut model, mut start, control) = among_bodies(GRID);
    start.v.iter_mut().for_each(|v| *v *= 0.2);
    model.cloths[0].rest_angles = Some(rest_angles(GRID, 44));
    model.cloths[0].material.bend = 2.0;
    model.cloths[0].repulsion = Some(Repulsion { strength: 0.05, distance: 0.9 });
    model.cloths[0].self_contact = Some(SelfContact { thickness: 0.2, friction: 0.3 });
    for optimizer in [Optimizer::spectral(), Optimizer::gradient_descent()] {
        let solver = solver(&model, &optimizer, 1, &start);
        let mut host = cpu::Solver::<f64>::new(&model, &optimizer, 1).unwrap();
        let mut expected = start.cast::<f64>();
        let found = step(&solver, &control);
        host.step(&mut expected, &control.cast());
        assert_close(optimizer.name(), &found.x, &expected.x, (1e-3 * largest(&expected.v), 2e-7));
    }
}

/// A cloth whose angles were removed is as one that never had any, and they may come back.
#[test]
fn angles_come_and_go() {
    let _turn = device();
    let (model, start, control) = bent(GRID);
    let none: Vec<_> = model.cloths.iter().map(|c| Cloth { rest_angles: None, ..c.clone() }).collect();
    let never = Model { grid: model.grid, cloths: none.clone() };
    let mut changed = solver(&model, &Optimizer::spectral(), 3, &start);
    let expected = step(&changed, &control);
    changed.set_cloths(&none).unwrap();
    changed.set_state(&start);
    let flat = step(&solver(&never, &Optimizer::spectral(), 3, &start), &control);
    assert_same("positions", &step(&changed, &control).x, &flat.x);
    changed.set_cloths(&model.cloths).unwrap();
    changed.set_state(&start);
    assert_same("positions", &step(&changed, &control).x, &expected.x);
    // There is no room for them where there were none.
    let error = solver(&never, &Optimizer::spectral(), 3, &start).set_cloths(&model.cloths).unwrap_err();
    assert!(error.to_string().contains("rest angles of cloth 1"), "{error}");
}
