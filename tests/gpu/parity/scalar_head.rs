//! `scalar_head` against its formulas.

use super::operator::{CHANNELS, head};
use crate::common::{
    ROUNDING, assert_close, cases, context, device, noise, poisoned, read, run, tensor, widened,
};
use fnopt::kernels::operator::{ScalarHead, Scales};

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
        run(|schedule| kernel.push(schedule, &layer, (&rows, &found), None));
        // One rounding per term; terms are at most 3.
        let atol = 3.0 * ROUNDING * (CHANNELS as f64).sqrt();
        assert_close(&format!("scalar_head {batch} x {grid}"), &read(&found), &expected, (atol, 0.0));
    }
}

/// The scalar updates the persistent scale, in place or from one part of a tensor to another.
#[test]
fn scales_match() {
    let _turn = device();
    let kernel = ScalarHead::new(context()).unwrap();
    let (_, _, layer) = head(CHANNELS);
    for samples in [3, 9, 200] {
        let rows = tensor("rows_max", &[samples, 8, CHANNELS], &noise(samples * 8 * CHANNELS, 62));
        let scale: Vec<f32> = (0..samples).map(|s| 0.05 * (s + 1) as f32).collect();
        for (before, after) in [(0, 0), (samples, 0), (0, samples)] {
            let parts = tensor("scale", &[2, samples], &[scale.as_slice(), &scale].concat());
            let scalar = poisoned("scalar", &[samples]);
            let scales = Scales { tensor: &parts, before, after };
            run(|schedule| kernel.push(schedule, &layer, (&rows, &scalar), Some(scales)));
            let next = |(&c, &s): (&f64, &f32)| f64::from(s) * (2.0 * (c / 2.0).tanh() - 1.0).exp();
            let expected: Vec<f64> = widened(&read(&scalar)).iter().zip(&scale).map(next).collect();
            let (found, other) = (read(&parts), samples - after);
            let what = format!("scales {samples}");
            assert_close(&what, &found[after..][..samples], &expected, (0.0, 16.0 * ROUNDING));
            assert_eq!(found[other..][..samples], scale, "the other part stays");
        }
    }
}
