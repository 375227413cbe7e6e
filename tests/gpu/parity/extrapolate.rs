//! `extrapolate` against the CPU path.

use super::cloth::{field, iterate, model};
use crate::common::{assert_close, cases, context, device, poisoned, read, run};
use fnopt::cpu::optim::Extrapolation;
use fnopt::kernels::optim::{Extrapolate, directions};

#[test]
fn smooth_parts_match() {
    let _turn = device();
    let kernel = Extrapolate::new(context()).unwrap();
    for (grid, batch) in cases() {
        let (model, n) = (model(grid, batch), grid.particles());
        let marks = model.marks();
        let is_free = |k: usize| marks[k / (3 * n) * n + k % n].is_free();
        let mut given = field(&model, 0.3, 83);
        (0..given.len()).filter(|&k| !is_free(k)).for_each(|k| given[k] = 0.0);
        let all = poisoned("directions", &directions::shape(3, batch, grid));
        let slot = |at| directions::one(&all, at, batch, grid);
        slot(directions::SPECTRAL).write(context(), &given);
        run(|schedule| kernel.push(schedule, grid, &iterate(&model), &all));
        // The host subtracts one field from a multiple of the other.
        let zero = vec![0.0; 3 * n];
        let minus: Vec<f64> = given.iter().map(|&v| -f64::from(v)).collect();
        let mut expected = vec![0.0; minus.len()];
        for (b, to) in expected.chunks_exact_mut(3 * n).enumerate() {
            let held: Vec<usize> = (0..n).filter(|p| !marks[b * n + p].is_free()).collect();
            Extrapolation::new(grid, &held).smooth([&zero, &minus[3 * b * n..][..3 * n]], to);
        }
        let what = format!("smooth {batch} x {grid}");
        assert_close(&what, &read(&slot(directions::ROTATED)), &expected, (1e-7, 1e-6));
        let given: Vec<f64> = given.into_iter().map(f64::from).collect();
        assert_close(&what, &read(&slot(directions::SPECTRAL)), &given, (0.0, 0.0));
        assert!(read(&slot(directions::LAST_STEP)).iter().all(|v| v.is_nan()), "{what}: another slot");
    }
}
