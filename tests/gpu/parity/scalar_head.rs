//! `scalar_head` against its formula.

use super::operator::{CHANNELS, head};
use crate::common::{ROUNDING, assert_close, cases, context, device, noise, poisoned, read, run, tensor};
use fnopt::kernels::operator::ScalarHead;

#[test]
fn scalars_match() {
    let _turn = device();
    let kernel = ScalarHead::new(context()).unwrap();
    let (weight, bias, layer) = head(CHANNELS);
    for (grid, batch) in cases() {
        let rows: Vec<f32> = noise(batch * grid.h * CHANNELS, 61).iter().map(|v| v - 2.0).collect();
        let scalar = |rows: &[f32]| {
            let most =
                |c: usize| rows[c..].iter().step_by(CHANNELS).copied().fold(f32::NEG_INFINITY, f32::max);
            let sum: f64 = (0..CHANNELS).map(|c| f64::from(weight[c]) * f64::from(most(c))).sum();
            sum + f64::from(bias)
        };
        let expected: Vec<f64> = rows.chunks_exact(grid.h * CHANNELS).map(scalar).collect();
        let rows = tensor("rows_max", &[batch, grid.h, CHANNELS], &rows);
        let found = poisoned("scalar", &[batch]);
        run(|schedule| kernel.push(schedule, &layer, &rows, &found));
        // A rounding of each of the terms, which are at most 3.
        let atol = 3.0 * ROUNDING * (CHANNELS as f64).sqrt();
        assert_close(&format!("scalar_head {batch} x {grid}"), &read(&found), &expected, (atol, 0.0));
    }
}
