//! `energy` and `energy_sum` against the CPU path.

use super::cloth::{Doubles, OnDevice, crumpled, field, model};
use crate::common::{ROUNDING, assert_close, cases, context, device, poisoned, read, run};
use fnopt::cloth::{Grid, State};
use fnopt::cpu::cloth::{energy, stretch};
use fnopt::kernels::cloth::{Energy, EnergySum, TERMS, energy::parts_shape};

#[test]
fn energies_and_stretch_match() {
    let _turn = device();
    let (kernel, sum) = (Energy::new(context()).unwrap(), EnergySum::new(context()).unwrap());
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let rest = State::<f32>::rest(grid, batch).x;
        let shrunk = rest.iter().map(|x| 0.75 * x).collect();
        for (name, x) in [
            ("rest", rest),
            ("shrunk", shrunk),
            ("wavy", crumpled(&model, 0.02)),
            ("crumpled", crumpled(&model, 0.4)),
        ] {
            let (a, f) = (field(&model, 0.1, 73), field(&model, 0.1, 74));
            let base = field(&model, if name == "crumpled" { 0.1 } else { 0.0 }, 79);
            let cloths = OnDevice::new(&model, [&x, &base, &a, &f]);
            let partial = poisoned("parts", &parts_shape(batch, grid));
            let terms = poisoned("terms", &[batch, TERMS]);
            run(|schedule| {
                kernel.push(schedule, cloths.trial(), None, &partial);
                sum.push(schedule, &partial, &terms);
            });
            let doubles = Doubles::new(&model, [&x, &base, &a, &f]);
            for (b, found) in read(&terms).chunks_exact(TERMS).enumerate() {
                let e = energy(&doubles.cloth(b));
                let (largest, mean) = stretch(&doubles.cloth(b));
                let edges = model.cloths[b].edges(grid) as f64;
                let expected = [e.stretch, e.shear, e.bend, e.inertia, e.external, largest, mean * edges];
                // Squares of strains and angles, which the rounding of an edge changes by the absolute
                // tolerance, and sums of positive terms. The terms of the external energy have both signs, so
                // its tolerance is relative to their size.
                let what = format!("energy {name} {b} of {batch} x {grid}");
                assert_close(&what, &found[..4], &expected[..4], (1e-9, 16.0 * ROUNDING));
                assert_close(&what, &found[4..5], &expected[4..5], (4.0 * ROUNDING * 0.03, 4.0 * ROUNDING));
                assert_close(&what, &found[5..6], &expected[5..6], (4.0 * ROUNDING, 0.0));
                assert_close(&what, &found[6..7], &expected[6..7], (ROUNDING * edges, 4.0 * ROUNDING));
            }
        }
    }
}

/// Particles that coincide have edges without length. The energies stay finite and match.
#[test]
fn degenerate_cloths_have_the_energies_of_the_host() {
    let _turn = device();
    let (kernel, sum) = (Energy::new(context()).unwrap(), EnergySum::new(context()).unwrap());
    let grid = Grid { h: 8, w: 9 };
    let model = model(grid, 1);
    let (n, mut x) = (grid.particles(), State::<f32>::rest(grid, 1).x);
    for c in 0..3 {
        x[c * n + 1] = x[c * n];
        x[c * n + 4 * grid.w + 4] = x[c * n + 4 * grid.w + 3];
        x[c * n + 5 * grid.w + 3] = x[c * n + 4 * grid.w + 3];
    }
    let zero = vec![0.0; x.len()];
    let cloths = OnDevice::new(&model, [&x, &zero, &zero, &zero]);
    let (partial, terms) = (poisoned("parts", &parts_shape(1, grid)), poisoned("terms", &[1, TERMS]));
    run(|schedule| {
        kernel.push(schedule, cloths.trial(), None, &partial);
        sum.push(schedule, &partial, &terms);
    });
    let e = energy(&Doubles::new(&model, [&x, &zero, &zero, &zero]).cloth(0));
    let expected = [e.stretch, e.shear, e.bend, e.inertia];
    assert_close("energy of coinciding particles", &read(&terms)[..4], &expected, (1e-9, 16.0 * ROUNDING));
}

/// There are more parts than a workgroup has invocations, so each invocation takes several.
#[test]
fn many_parts_are_all_summed() {
    let _turn = device();
    let sum = EnergySum::new(context()).unwrap();
    let [_, count, _] = parts_shape(2, Grid { h: 100, w: 100 });
    assert!(count > 64);
    let values: Vec<f32> =
        (0..2 * count * TERMS).map(|k| (k / TERMS % count) as f32 + (k % TERMS) as f32).collect();
    let partial = crate::common::tensor("parts", &[2, count, TERMS], &values);
    let terms = poisoned("terms", &[2, TERMS]);
    run(|schedule| sum.push(schedule, &partial, &terms));
    let total = |k: usize| (count * (count - 1) / 2 + count * k) as f64;
    let one = [total(0), total(1), total(2), total(3), total(4), (count - 1 + 5) as f64, total(6), total(7)];
    assert_close("energy_sum", &read(&terms), &[one, one].concat(), (0.0, 2.0 * ROUNDING));
}
