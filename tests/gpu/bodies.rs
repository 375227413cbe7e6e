//! Frames of cloths among bodies: against the CPU path, repeated, and with bodies changed.

use crate::cloths::among_bodies;
use crate::common::{assert_close, device, largest};
use crate::solver::{assert_repeats, assert_same, optimizers, solver, statistics, step};
use fnopt::cloth::{Cloth, Control, Grid, Repulsion};
use fnopt::cpu;
use fnopt::sim::Optimizer;

const GRID: Grid = Grid { h: 18, w: 20 };

/// Frames agree with the host for every optimizer. Runs repeat, and several frames in one submission equal frames
/// submitted one by one.
#[test]
fn frames_among_bodies_agree_with_the_host() {
    let _turn = device();
    let (model, mut start, control) = among_bodies(GRID);
    start.v.iter_mut().for_each(|v| *v *= 0.2);
    for optimizer in optimizers() {
        let name = optimizer.name();
        let solver = solver(&model, &optimizer, 3, &start);
        let mut host = cpu::Solver::<f64>::new(&model, &optimizer, 3).unwrap();
        let mut expected = start.cast::<f64>();
        let found = step(&solver, &control);
        let stats = host.step(&mut expected, &control.cast());
        // The barrier is far steeper than the cloth where a particle is deep in it.
        let digits = if matches!(name, "spectral" | "fnopt") { 1e-3 } else { 5e-3 };
        let atol = digits * largest(&expected.v);
        assert_close(name, &found.x, &expected.x, (atol, 2e-7));
        let of_device = statistics(&solver);
        for (b, (found, wanted)) in of_device.iter().zip(&stats).enumerate() {
            assert_eq!(found.bodies.len(), model.cloths[b].bodies.len());
            let (energy, expected) = (found.energy.contact, wanted.energy.contact);
            assert!((energy - expected).abs() <= 0.02 * expected, "{name} {b}: {energy} {expected}");
        }
        assert!(stats[0].energy.contact > 0.0 && stats[1].energy.contact == 0.0, "{stats:?}");
        let still = Control { bodies: Vec::new(), ..control.clone() };
        assert_repeats(name, &solver, &start, &[control.clone(), still], &found.x);
    }
}

/// Repulsion and bodies act together.
#[test]
fn cloths_that_repel_themselves_among_bodies_agree_with_the_host() {
    let _turn = device();
    let (mut model, mut start, control) = among_bodies(GRID);
    start.v.iter_mut().for_each(|v| *v *= 0.2);
    start.x.iter_mut().for_each(|x| *x *= 0.7);
    model.cloths[0].repulsion = Some(Repulsion { strength: 0.05, distance: 0.9 });
    for optimizer in [Optimizer::spectral(), Optimizer::gradient_descent()] {
        let name = optimizer.name();
        let solver = solver(&model, &optimizer, 1, &start);
        let mut host = cpu::Solver::<f64>::new(&model, &optimizer, 1).unwrap();
        let mut expected = start.cast::<f64>();
        let found = step(&solver, &control);
        let stats = host.step(&mut expected, &control.cast());
        assert_close(name, &found.x, &expected.x, (1e-3 * largest(&expected.v), 2e-7));
        let energy = stats[0].energy;
        assert!(energy.contact > 0.0 && energy.repulsion != 0.0, "{energy:?}");
        let of_device = statistics(&solver)[0].energy;
        for (found, wanted) in [(of_device.contact, energy.contact), (of_device.repulsion, energy.repulsion)]
        {
            assert!((found - wanted).abs() <= 0.01 * wanted.abs(), "{name}: {found} {wanted}");
        }
    }
}

/// Bodies may be removed and come back, but there is no more room than the solver was built with.
#[test]
fn bodies_come_and_go() {
    let _turn = device();
    let (model, start, control) = among_bodies(GRID);
    let mut solver = solver(&model, &Optimizer::spectral(), 3, &start);
    let with = step(&solver, &control).x;
    let free: Vec<_> = model.cloths.iter().map(|c| Cloth { bodies: Vec::new(), ..c.clone() }).collect();
    solver.set_cloths(&free).unwrap();
    solver.set_state(&start);
    let without = step(&solver, &Control { bodies: Vec::new(), ..control.clone() });
    assert!(statistics(&solver).iter().all(|s| s.bodies.is_empty() && s.energy.contact == 0.0));
    assert!(without.x != with, "the bodies do nothing");
    solver.set_cloths(&model.cloths).unwrap();
    solver.set_state(&start);
    assert_same("bodies that are back", &step(&solver, &control).x, &with);
    let mut many = model.cloths.clone();
    many[1].bodies = vec![model.cloths[0].bodies[0].clone(); 6];
    let error = solver.set_cloths(&many).unwrap_err().to_string();
    assert!(error.contains("bodies of cloth 1") && error.contains("5 at most"), "{error}");
    assert_same(
        "after a refusal",
        &{
            solver.set_state(&start);
            step(&solver, &control).x
        },
        &with,
    );
}
