//! `cosine_rows`, `cosine_columns` and `cosine_directions` together, against dense sums in double precision.

use super::cloth::{constants, field, iterate, model};
use crate::common::{assert_close, cases, context, device, largest, noise, poisoned, read, run, tensor};
use fnopt::cloth::{Cloth, Grid, Material, Model};
use fnopt::kernels::cloth::sheet_axes::AXES;
use fnopt::kernels::optim::cosine_columns::squared_frequencies;
use fnopt::kernels::optim::cosine_rows::{fields_shape, table};
use fnopt::kernels::optim::{CosineColumns, CosineDirections, CosineRows, directions};
use fnopt::settings::{SheetConstants, TENSION};
use std::f64::consts::PI;

/// Returns the orthonormal DCT-II of n points, row by row.
fn cosines(n: usize) -> Vec<f64> {
    let of = |k: usize, i: usize| {
        let scale = if k == 0 { 1.0 } else { 2.0 };
        (scale / n as f64).sqrt() * (PI * k as f64 * (2 * i + 1) as f64 / (2 * n) as f64).cos()
    };
    (0..n * n).map(|at| of(at / n, at % n)).collect()
}

/// Returns the eigenvalue of one of the six fields in mode (k, l), of a share of the stiffness across
/// an edge and along the normal.
fn eigenvalue(grid: Grid, cloth: &Cloth, field: usize, (k, l): (usize, usize)) -> f64 {
    let (h, w, n) = (grid.h as f64, grid.w as f64, grid.particles() as f64);
    let Material { stretch, shear, .. } = cloth.material;
    let ([of_u, of_v], [down, across]) = (cloth.material.stretches(), cloth.material.bends());
    let twice = 2.0 * (1.0 + cloth.damping);
    let (m, q) = (2.0 - 2.0 * (PI * k as f64 / h).cos(), 2.0 - 2.0 * (PI * l as f64 / w).cos());
    let (w_u, w_v, tau) = (twice * of_u / ((h - 1.0) * w), twice * of_v / (h * (w - 1.0)), TENSION);
    match field {
        3 => {
            SheetConstants::FITTED.tangential_inertia / n
                + w_u * (m + tau * q)
                + 8.0 * shear * q / n
                + 2.0 * across * q * q / n
        }
        4 => {
            SheetConstants::FITTED.tangential_inertia / n
                + w_v * (q + tau * m)
                + 8.0 * shear * m / n
                + 2.0 * down * m * m / n
        }
        5 => {
            (1.0 + 2.0 * TENSION * stretch) / n
                + tau * (w_u * m + w_v * q)
                + 2.0 * SheetConstants::FITTED.normal_bend * (down * m * m + across * q * q) / n
        }
        _ => {
            SheetConstants::FITTED.spatial_inertia / n
                + w_u * m
                + w_v * q
                + 2.0 / n * (down * m * m + across * q * q)
                + 4.0 * shear / n * (m + q)
        }
    }
}

/// Returns the product of matrices [rows, depth] and [depth, columns].
fn product(a: &[f64], b: &[f64], (depth, columns): (usize, usize)) -> Vec<f64> {
    let row = |a: &[f64]| {
        let mut row = vec![0.0; columns];
        for (&a, b) in a.iter().zip(b.chunks_exact(columns)) {
            row.iter_mut().zip(b).for_each(|(to, &b)| *to += a * b);
        }
        row
    };
    a.chunks_exact(depth).flat_map(row).collect()
}

fn transposed(a: &[f64], columns: usize) -> Vec<f64> {
    (0..columns).flat_map(|c| a[c..].iter().step_by(columns).copied()).collect()
}

/// Applies the inverse of the eigenvalues in cosine space.
fn divided(grid: Grid, values: &[f64], eigenvalue: &dyn Fn((usize, usize)) -> f64) -> Vec<f64> {
    let Grid { h, w } = grid;
    let (along, across) = (cosines(h), cosines(w));
    let z = product(&along, &product(values, &transposed(&across, w), (w, w)), (h, w));
    let z: Vec<f64> = z.iter().enumerate().map(|(at, z)| z / eigenvalue((at / w, at % w))).collect();
    product(&transposed(&along, h), &product(&z, &across, (w, w)), (h, w))
}

/// Returns both directions of one cloth, from its gradient [3, n] and axes [10, n].
fn expected(model: &Model, b: usize, grad: &[f32], axes: &[f32]) -> [Vec<f64>; 2] {
    let (grid, n) = (model.grid, model.grid.particles());
    let marks = &model.marks()[b * n..][..n];
    let (mut spectral, mut rotated) = (vec![0.0; 3 * n], vec![0.0; 3 * n]);
    for field in 0..6 {
        let weights = |p: usize| {
            let at = |c: usize| f64::from(axes[c * n + p]);
            match field {
                3..6 => [0, 1, 2].map(|c| at(3 * (field - 3) + c)),
                _ => [0, 1, 2].map(|c| if c == field { at(AXES - 1) } else { 0.0 }),
            }
        };
        let free = |p: usize| f64::from(u8::from(marks[p].is_free()));
        let of = |p: usize| (0..3).map(|c| weights(p)[c] * f64::from(grad[c * n + p])).sum::<f64>();
        let values: Vec<f64> = (0..n).map(|p| free(p) * of(p)).collect();
        let cloth = &model.cloths[b];
        let y = divided(grid, &values, &|mode| eigenvalue(grid, cloth, field, mode));
        let out = if field < 3 { &mut spectral } else { &mut rotated };
        for (p, y) in y.iter().enumerate() {
            (0..3).for_each(|c| out[c * n + p] -= free(p) * weights(p)[c] * y);
        }
    }
    [spectral, rotated]
}

#[test]
fn directions_match() {
    let _turn = device();
    let rows = CosineRows::new(context()).unwrap();
    let [forward, inverse] = [false, true].map(|i| CosineColumns::new(context(), i).unwrap());
    let kernel = CosineDirections::new(context()).unwrap();
    // Sides of all parities, shorter and longer than the tiles.
    let odd = [(9, 31), (70, 8), (33, 65)].map(|(h, w)| (Grid { h, w }, 2));
    for (grid, batch) in cases().chain(odd) {
        let (model, n) = (model(grid, batch), grid.particles());
        let (iterate, grad) = (iterate(&model), field(&model, 1.0, 122));
        iterate.grad.write(context(), &grad);
        // Three vectors and a factor for each particle, whatever they are.
        let own = noise(AXES * batch * n, 131);
        let axes = tensor("axes", &[batch, AXES, n], &own);
        let [along_column, along_row] = [grid.h, grid.w].map(|n| table(context(), n).unwrap());
        let (mu, cloths) = (squared_frequencies(context(), grid).unwrap(), constants(&model));
        let [z, other] = [(); 2].map(|()| poisoned("fields", &fields_shape(batch, grid)));
        let all = poisoned("directions", &directions::shape(3, batch, grid));
        run(|schedule| {
            rows.push(schedule, grid, (&iterate, &axes, &along_row), &z);
            forward.push(schedule, grid, (&cloths, &along_column, &mu), [&z, &other]);
            inverse.push(schedule, grid, (&cloths, &along_column, &mu), [&other, &z]);
            kernel.push(schedule, grid, (&iterate, &axes, &along_row), [&z, &all]);
        });
        let mut exact = [vec![], vec![]];
        for b in 0..batch {
            let of_cloth = expected(&model, b, &grad[3 * b * n..][..3 * n], &own[AXES * b * n..][..AXES * n]);
            exact.iter_mut().zip(of_cloth).for_each(|(all, one)| all.extend(one));
        }
        for (at, exact) in exact.iter().enumerate() {
            let found = read(&directions::one(&all, at, batch, grid));
            // Low modes are much larger than the others, so that every element has their rounding.
            let what = format!("direction {at} {batch} x {grid}");
            assert_close(&what, &found, exact, (2e-6 * largest(exact), 0.0));
        }
        let last = read(&directions::one(&all, directions::LAST_STEP, batch, grid));
        assert!(last.iter().all(|v| v.is_nan()), "the last step is not written");
    }
}
