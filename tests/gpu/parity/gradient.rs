//! `gradient` against the CPU path.

use super::cloth::{Doubles, OnDevice, crumpled, field, iterate, iterate_with_hidden, model};
use crate::common::{ROUNDING, assert_close, cases, context, device, largest, noise, poisoned, read, run};
use fnopt::cloth::{Grid, Model, State};
use fnopt::cpu::cloth::{GradientRows, gradient};
use fnopt::kernels::cloth::{Gradient, gradient::parts};

/// Returns the gradient on the device and in double precision, for positions, displacements at a = 0,
/// accelerations and external accelerations.
fn both(kernel: &Gradient, model: &Model, fields: [&[f32]; 4]) -> (Vec<f32>, Vec<f64>) {
    let cloths = OnDevice::new(model, fields);
    let sums = poisoned("sums", &[3 * model.batch(), parts(model.grid), 2]);
    run(|schedule| kernel.push(schedule, cloths.trial(), &sums));
    let doubles = Doubles::new(model, fields);
    let mut rows = GradientRows::new(model.grid);
    let mut expected = vec![0.0; fields[0].len()];
    for (b, grad) in expected.chunks_exact_mut(3 * model.grid.particles()).enumerate() {
        gradient(&doubles.cloth(b), &mut rows, grad);
    }
    (read(&cloths.iterate.grad), expected)
}

/// A grid with more tiles than parts, so that a workgroup takes several tiles.
const LARGE: Grid = Grid { h: 130, w: 139 };

#[test]
fn gradients_of_crumpled_cloths_match() {
    let _turn = device();
    let kernel = Gradient::new(context()).unwrap();
    for (grid, batch) in cases().chain([(LARGE, 1)]) {
        let model = model(grid, batch);
        for amplitude in [0.02, 0.4] {
            let (x, base) = (crumpled(&model, amplitude), field(&model, 0.1 * amplitude, 79));
            let (a, f) = (field(&model, 0.1 * amplitude, 73), field(&model, 0.1, 74));
            let (found, expected) = both(&kernel, &model, [&x, &base, &a, &f]);
            // Stretch dominates: four edges of nearly unit length, each rounded, times the coefficient over
            // the number of edges.
            let edges = ((grid.h - 1) * grid.w) as f64;
            let atol = 8.0 * ROUNDING * 1000.0 / edges;
            let what = format!("gradient {amplitude} {batch} x {grid}");
            assert_close(&what, &found, &expected, (atol, 8.0 * ROUNDING));
        }
    }
}

/// At rest the edges are straight and square, and angles have no direction. Nothing but inertia remains.
#[test]
fn rest_has_no_gradient_but_inertia() {
    let _turn = device();
    let kernel = Gradient::new(context()).unwrap();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let x = State::<f32>::rest(grid, batch).x;
        let (a, f) = (field(&model, 0.1, 73), field(&model, 0.1, 74));
        // The sheet stays at rest: `base` cancels the displacement by the acceleration.
        let (marks, n) = (model.marks(), grid.particles());
        let free = |k: usize| marks[k / (3 * n) * n + k % n].is_free();
        let base: Vec<f32> = (0..a.len()).map(|k| if free(k) { -a[k] } else { 0.0 }).collect();
        let (found, expected) = both(&kernel, &model, [&x, &base, &a, &f]);
        // A right angle differs from its constant by a rounding.
        let count = grid.particles() as f64;
        let atol = 100.0 * ROUNDING / count;
        // The densest particle has twice the mass of others.
        assert!(largest(&expected) < 2.0 * 0.3 / count, "at rest the gradient is that of inertia alone");
        assert_close(
            &format!("gradient at rest {batch} x {grid}"),
            &found,
            &expected,
            (atol, 2.0 * ROUNDING),
        );
    }
}

/// Coincident particles and flat folds have edges without length and angles of pi. The gradient stays finite
/// and matches.
#[test]
fn degenerate_cloths_have_the_gradients_of_the_host() {
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

/// Edges have hardly any length, and divisions by it must not overflow.
#[test]
fn collapsed_cloths_have_finite_gradients() {
    let _turn = device();
    let kernel = Gradient::new(context()).unwrap();
    let grid = Grid { h: 9, w: 8 };
    let (model, n) = (model(grid, 1), grid.particles());
    for size in [1e-9, 2e-10, 1e-15, 1e-19, 1e-30] {
        // A plane, a sheet whose rows all lie on one line, and a crumpled lump.
        let plane: Vec<f32> = State::<f32>::rest(grid, 1).x.iter().map(|x| size * x).collect();
        let line: Vec<f32> = plane.iter().enumerate().map(|(k, x)| if k < n { *x } else { 0.0 }).collect();
        let lump: Vec<f32> = noise(3 * n, 86).into_iter().map(|v| size * v).collect();
        for x in [plane, line, lump] {
            let zero = vec![0.0; x.len()];
            let (found, _) = both(&kernel, &model, [&x, &zero, &zero, &zero]);
            let largest = found.iter().fold(0.0, |most: f64, v| most.max(f64::from(v.abs())));
            // The gradient of an angle is at most pi over a side.
            let bound = 1e3 * (1.0 + 1.0 / f64::from(size).max(1e-18));
            assert!(found.iter().all(|v| v.is_finite()) && largest < bound, "{size:e}: {largest:e}");
        }
    }
}

/// The gradient leaves sums of squares for its norm and for that of the last step. Most grids have as many
/// parts as tiles, one has fewer.
#[test]
fn partial_sums_of_squares_match() {
    let _turn = device();
    let kernel = Gradient::new(context()).unwrap();
    assert!(parts(LARGE) < LARGE.h.div_ceil(8) * LARGE.w.div_ceil(8), "some parts are of several tiles");
    for ((grid, batch), with_hidden) in
        cases().chain([(LARGE, 2)]).flat_map(|case| [(case, true), (case, false)])
    {
        let (model, n, count) = (model(grid, batch), grid.particles(), parts(grid));
        let samples = 3 * batch;
        let last_step = noise(samples * n, 82);
        let iterate = if with_hidden {
            let iterate = iterate_with_hidden(&model);
            iterate.hidden_state().write_at(context(), samples * n, &last_step);
            iterate
        } else {
            iterate(&model)
        };
        let [base, a, f] = [79, 73, 74].map(|seed| field(&model, 0.1, seed));
        let cloths = OnDevice::with(&model, iterate, [&crumpled(&model, 0.1), &base, &a, &f]);
        // A view, like the rows of a solver's iterations.
        let rows = poisoned("sums", &[192 + 2 * samples * count]);
        let sums = rows.view(192, &[samples, count, 2]);
        run(|schedule| kernel.push(schedule, cloths.trial(), &sums));
        // Tiles of 8 x 8 particles, dealt out to the parts.
        let across = grid.w.div_ceil(8);
        let part = |p: usize| (p / grid.w / 8 * across + p % grid.w / 8) % count;
        let mut expected = vec![0.0; 2 * samples * count];
        for (k, (&g, &d)) in read(&cloths.iterate.grad).iter().zip(&last_step).enumerate() {
            let at = 2 * (k / n * count + part(k % n));
            expected[at] += f64::from(g) * f64::from(g);
            expected[at + 1] += if with_hidden { f64::from(d) * f64::from(d) } else { 0.0 };
        }
        let what = format!("sums {with_hidden} {batch} x {grid}");
        // A few squares one by one, then eight sums and eight of those.
        assert_close(&what, &read(&sums), &expected, (0.0, 16.0 * ROUNDING));
        assert!(read(&rows)[..192].iter().all(|v| v.is_nan()), "{what} wrote in front of its view");
        if with_hidden {
            let memory = read(cloths.iterate.hidden_state());
            assert!(memory[..samples * n].iter().all(|v| v.is_nan()), "{what} changed the last gradient");
            assert_eq!(memory[samples * n..], last_step, "{what} changed the last step");
        }
    }
}
