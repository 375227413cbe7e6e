//! `pointwise` against its formula.

use super::operator::{activate, activations, dense, layer};
use crate::common::{
    ROUNDING, assert_close, cases, context, device, largest, poisoned, read, read_unpadded, run, tunings,
};
use fnopt::kernels::operator::{
    Pointwise,
    pointwise::{Rows, Samples},
};
use fnopt::kernels::padded;
use fnopt::sim::Grid;

/// One rounding for each of the inputs' products, whose sum is a few times larger than they are; and the activation, whose
/// polynomial is good to 4e-7 of its argument.
fn tolerance(inputs: usize, expected: &[f64], gelu: bool) -> (f64, f64) {
    let sums = ROUNDING * (inputs as f64).sqrt() * largest(expected);
    (sums + if gelu { 3e-7 * largest(expected) } else { 0.0 }, ROUNDING)
}

#[test]
fn layers_of_all_tiles_match() {
    let _turn = device();
    for tuning in tunings() {
        for gelu in [false, true] {
            let kernel = Pointwise::new(context(), &tuning, gelu).unwrap();
            for (grid, batch) in cases() {
                for (inputs, outputs) in [(5, 32), (33, 64)] {
                    let (x, x_tensor) = activations(batch, inputs, grid, 0.5);
                    let (weight, bias, layer) = layer(outputs, inputs, tuning.channels);
                    let mut expected = dense(&weight, &bias, &x, grid.particles());
                    activate(&mut expected, gelu);
                    let y = poisoned("y", &[batch, outputs, grid.h, padded(grid.w)]);
                    run(|schedule| kernel.push(schedule, &layer, &x_tensor, &y));
                    let what = format!("pointwise {} gelu {gelu} {batch} x {grid}", tuning.channels);
                    let tolerance = tolerance(inputs, &expected, gelu);
                    assert_close(&what, &read_unpadded(&y, grid), &expected, tolerance);
                    assert!(read(&y).iter().all(|y| y.is_finite()), "the padding stays finite");
                }
            }
        }
    }
}

/// The lifting takes some samples or rows at a time, from and to any place.
#[test]
fn parts_of_the_samples_and_rows_are_taken_alone() {
    let _turn = device();
    let (tuning, grid) = (tunings()[0], crate::common::GRIDS[1]);
    let (x, x_tensor) = activations(5, 5, grid, 0.5);
    let (weight, bias, layer) = layer(32, 5, 32);
    let n = grid.particles();
    let expected = dense(&weight, &bias, &x[2 * 5 * n..4 * 5 * n], n);
    let y = poisoned("y", &[4, 32, grid.h, padded(grid.w)]);
    let kernel = Pointwise::new(context(), &tuning, false).unwrap();
    let part = Samples { count: 2, x_first: 2, y_first: 1 };
    run(|schedule| kernel.push_samples(schedule, &layer, (&x_tensor, &y), part));
    let found = read_unpadded(&y, grid);
    let sample = 32 * n;
    assert_close("part", &found[sample..3 * sample], &expected, tolerance(5, &expected, false));
    assert!(
        found[..sample].iter().chain(&found[3 * sample..]).all(|y| y.is_nan()),
        "other samples were written"
    );

    // Three rows from the third on, to a plane of four.
    let (w, few) = (grid.w, Grid { h: 4, ..grid });
    let y = poisoned("y", &[4, 32, few.h, padded(w)]);
    let rows = Rows { count: 3, x_first: 2, y_first: 1 };
    run(|schedule| kernel.push_rows(schedule, &layer, (&x_tensor, &y), (part, rows)));
    let found = read_unpadded(&y, few);
    let planes = found.chunks_exact(few.particles()).enumerate();
    for (k, plane) in planes {
        let (sample, untouched) = (k / 32, |y: &[f32]| y.iter().all(|y| y.is_nan()));
        if (1..3).contains(&sample) {
            let expected = &expected[(k - 32) * n..][2 * w..5 * w];
            assert_close("rows", &plane[w..], expected, tolerance(5, expected, false));
            assert!(untouched(&plane[..w]), "another row was written");
        } else {
            assert!(untouched(plane), "another sample was written");
        }
    }
}

/// Far from zero the activation is its argument or nothing.
#[test]
fn gelu_of_large_arguments() {
    let _turn = device();
    let (tuning, grid) = (tunings()[0], crate::common::GRIDS[0]);
    let x: Vec<f32> = (0..64).map(|k| (k as f32 - 32.0) * 1.7).collect();
    let x_tensor = crate::common::tensor("x", &[1, 1, 8, 8], &x);
    let (_, _, mut layer) = layer(32, 1, 32);
    layer.weight.write(context(), &[1f32; 32]);
    layer.bias = crate::common::tensor("bias", &[32], &[0.0; 32]);
    let y = poisoned("y", &[1, 32, grid.h, grid.w]);
    let kernel = Pointwise::new(context(), &tuning, true).unwrap();
    run(|schedule| kernel.push(schedule, &layer, &x_tensor, &y));
    let mut expected = crate::common::widened(&x);
    activate(&mut expected, true);
    // 1 + erf keeps an error of a few roundings where it should vanish.
    assert_close("gelu", &read(&y)[..64], &expected, (4.0 * ROUNDING * 55.0, 2.0 * ROUNDING));
}
