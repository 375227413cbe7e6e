//! `pointwise` against its formula.

use super::operator::{activate, activations, dense, layer};
use crate::common::{
    ROUNDING, assert_close, cases, context, device, largest, poisoned, read, read_channels, read_unpadded,
    run, tunings,
};
use fnopt::kernels::operator::{Pointwise, pointwise::Lines};
use fnopt::kernels::padded;

/// One rounding per product, with sums a few times larger than the products, and the activation, whose
/// polynomial is accurate to 4e-7 of its argument.
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
                for (inputs, outputs) in [(5, 64), (33, 128)] {
                    let (x, x_tensor) = activations(batch, inputs, grid, 0.5);
                    let (weight, bias, layer) = layer(outputs, inputs, tuning.channels);
                    let mut expected = dense(&weight, &bias, &x, grid.particles());
                    activate(&mut expected, gelu);
                    let y = poisoned("y", &[batch, grid.h, outputs, padded(grid.w)]);
                    run(|schedule| kernel.push(schedule, &layer, &x_tensor, &y));
                    let what = format!("pointwise {} gelu {gelu} {batch} x {grid}", tuning.channels);
                    let tolerance = tolerance(inputs, &expected, gelu);
                    assert_close(&what, &read_channels(&y, grid), &expected, tolerance);
                    assert!(read(&y).iter().all(|y| y.is_finite()), "the padding stays finite");
                }
            }
        }
    }
}

/// The lifting takes some lines at a time, at any offset. They need not be whole samples.
#[test]
fn some_of_the_lines_are_taken_alone() {
    let _turn = device();
    let (tuning, grid) = (tunings()[0], crate::common::GRIDS[1]);
    let (x, x_tensor) = activations(3, 5, grid, 0.5);
    let (weight, bias, layer) = layer(64, 5, tuning.channels);
    let expected = dense(&weight, &bias, &x, grid.particles());
    let (w, lines) = (grid.w, 50);
    let y = poisoned("y", &[lines, 64, padded(w)]);
    let kernel = Pointwise::new(context(), &tuning, false).unwrap();
    // From row 20 of the first sample to row 5 of the third.
    let part = Lines { count: 48, x_first: 20, y_first: 1 };
    run(|schedule| kernel.push_lines(schedule, &layer, (&x_tensor, &y), part));
    let found = read_unpadded(&y, grid);
    for (k, row) in found.chunks_exact(w).enumerate() {
        let (line, channel) = (k / 64, k % 64);
        if (1..49).contains(&line) {
            let (sample, i) = ((line + 19) / grid.h, (line + 19) % grid.h);
            let expected = &expected[((sample * 64 + channel) * grid.h + i) * w..][..w];
            assert_close("lines", row, expected, tolerance(5, expected, false));
        } else {
            assert!(row.iter().all(|y| y.is_nan()), "another line was written");
        }
    }
}

/// Far from zero, GELU is its argument or zero.
#[test]
fn gelu_of_large_arguments() {
    let _turn = device();
    let (tuning, grid) = (tunings()[0], crate::common::GRIDS[0]);
    let x: Vec<f32> = (0..64).map(|k| (k as f32 - 32.0) * 1.7).collect();
    let x_tensor = crate::common::tensor("x", &[1, 8, 1, 8], &x);
    let (_, _, mut layer) = layer(64, 1, tuning.channels);
    layer.weight.write(context(), &[1f32; 64]);
    layer.bias = crate::common::tensor("bias", &[64], &[0.0; 64]);
    let y = poisoned("y", &[1, grid.h, 64, grid.w]);
    let kernel = Pointwise::new(context(), &tuning, true).unwrap();
    run(|schedule| kernel.push(schedule, &layer, &x_tensor, &y));
    let mut expected = crate::common::widened(&x);
    activate(&mut expected, true);
    // 1 + erf keeps an error of a few roundings where it should vanish.
    assert_close("gelu", &read_channels(&y, grid)[..64], &expected, (4.0 * ROUNDING * 55.0, 2.0 * ROUNDING));
}
