//! `gradient` against the CPU path.

use super::cloth::{Doubles, constants, crumpled, field, iterate, model, upload};
use crate::common::{ROUNDING, assert_close, cases, context, device, largest, read, run};
use fnopt::cpu::cloth::{GradientRows, gradient};
use fnopt::kernels::cloth::{Gradient, Physics};
use fnopt::sim::{Model, State};

/// The gradient on the device, and in double precision, for positions, shifts, accelerations and external accelerations.
fn both(kernel: &Gradient, model: &Model, fields: [&[f32]; 4]) -> (Vec<f32>, Vec<f64>) {
    let iterate = iterate(model);
    let [x, shift, a, f] = fields;
    iterate.shift.write(context(), shift);
    iterate.a.write(context(), a);
    let (cloths, external, x) = (constants(model), upload("external", model, f), upload("x", model, x));
    let physics = Physics { cloths: &cloths, external: &external, x: &x };
    run(|schedule| kernel.push(schedule, model.grid, physics, &iterate));
    let doubles = Doubles::new(model, fields);
    let mut rows = GradientRows::new(model.grid);
    let mut expected = vec![0.0; a.len()];
    for (b, grad) in expected.chunks_exact_mut(3 * model.grid.particles()).enumerate() {
        gradient(&doubles.cloth(b), &mut rows, grad);
    }
    (read(&iterate.grad), expected)
}

#[test]
fn gradients_of_crumpled_cloths_match() {
    let _turn = device();
    let kernel = Gradient::new(context()).unwrap();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        for amplitude in [0.02, 0.4] {
            let (x, shift) = (crumpled(&model, amplitude), field(&model, 0.1 * amplitude, 79));
            let (a, f) = (field(&model, 0.1, 73), field(&model, 0.1, 74));
            let (found, expected) = both(&kernel, &model, [&x, &shift, &a, &f]);
            // Stretch dominates: four edges of nearly unit length, each rounded, times the coefficient over the edges.
            let edges = ((grid.h - 1) * grid.w) as f64;
            let atol = 8.0 * ROUNDING * 1000.0 / edges;
            let what = format!("gradient {amplitude} {batch} x {grid}");
            assert_close(&what, &found, &expected, (atol, 8.0 * ROUNDING));
        }
    }
}

/// At rest the edges are straight and square, where directions of angles are not defined: nothing but inertia remains.
#[test]
fn rest_has_no_gradient_but_inertia() {
    let _turn = device();
    let kernel = Gradient::new(context()).unwrap();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let x = State::<f32>::rest(grid, batch).x;
        let (a, f) = (field(&model, 0.1, 73), field(&model, 0.1, 74));
        let (found, expected) = both(&kernel, &model, [&x, &vec![0.0; x.len()], &a, &f]);
        // A right angle differs from the constant for it by a rounding.
        let count = grid.particles() as f64;
        let atol = 100.0 * ROUNDING / count;
        assert!(largest(&expected) < 0.3 / count, "the test's idea of a rest state");
        assert_close(
            &format!("gradient at rest {batch} x {grid}"),
            &found,
            &expected,
            (atol, 2.0 * ROUNDING),
        );
    }
}

/// Particles on top of each other and rows folded flat have edges without length and angles of pi; all stays finite.
#[test]
fn degenerate_cloths_have_finite_gradients() {
    let _turn = device();
    let kernel = Gradient::new(context()).unwrap();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let mut x = State::<f32>::rest(grid, batch).x;
        let n = grid.particles();
        for x in x.chunks_exact_mut(3 * n) {
            for j in 0..grid.w {
                // Row 2 falls onto row 0, and row 4 onto row 3.
                x[n + 2 * grid.w + j] = x[n + j];
                x[n + 4 * grid.w + j] = x[n + 3 * grid.w + j];
            }
        }
        let zero = vec![0.0; x.len()];
        let (found, expected) = both(&kernel, &model, [&x, &zero, &zero, &zero]);
        let atol = 8.0 * ROUNDING * 1000.0 / ((grid.h - 1) * grid.w) as f64;
        assert_close(&format!("gradient folded {batch} x {grid}"), &found, &expected, (atol, 8.0 * ROUNDING));
    }
}
