//! `scalar_head` against its formulas.

use super::operator::{CHANNELS, joined_head};
use crate::common::{
    ROUNDING, assert_close, cases, context, device, noise, poisoned, read, run, tensor, widened,
};
use fnopt::cpu::optim::Hidden;
use fnopt::kernels::cloth::gradient;
use fnopt::kernels::operator::{LastStep, ScalarHead, Scales};

#[test]
fn scalars_match() {
    let _turn = device();
    let kernel = ScalarHead::new(context()).unwrap();
    let (weight, bias, layer) = joined_head(CHANNELS);
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
    let (_, _, layer) = joined_head(CHANNELS);
    for samples in [3, 9, 200] {
        let rows = tensor("rows_max", &[samples, 8, CHANNELS], &noise(samples * 8 * CHANNELS, 62));
        let scale: Vec<f32> = (0..samples).map(|s| 0.05 * (s + 1) as f32).collect();
        for (before, after) in [(0, 0), (samples, 0), (0, samples)] {
            let parts = tensor("scale", &[2, samples], &[scale.as_slice(), &scale].concat());
            let scalar = poisoned("scalar", &[samples]);
            let scales = Scales { tensor: &parts, before, after, last_step: None };
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

/// Components of different sizes, one of them smaller than counts, and a cloth without a step; passes over all samples, and over some.
#[test]
fn scales_of_the_last_step_match() {
    let _turn = device();
    let kernel = ScalarHead::new(context()).unwrap();
    let (_, _, layer) = joined_head(CHANNELS);
    for (grid, batch) in cases() {
        let (n, samples) = (grid.particles(), 3 * batch);
        let mut step = noise(samples * n, 171);
        for (sample, step) in step.chunks_exact_mut(n).enumerate() {
            let factor = if sample < 3 { [1.0, 0.3, 1e-6][sample] } else { 0.0 };
            step.iter_mut().for_each(|step| *step *= factor);
        }
        let before: Vec<f32> = (0..samples).map(|sample| 0.05 + sample as f32).collect();
        let parts = gradient::parts(grid);
        let mut sums = vec![f32::NAN; 2 * samples * parts];
        for (sample, step) in step.chunks_exact(n).enumerate() {
            for part in 0..parts {
                let square = |k: usize| f64::from(step[k]).powi(2);
                let sum: f64 = (part..n).step_by(parts).map(square).sum();
                sums[2 * (sample * parts + part) + 1] = sum as f32;
            }
        }
        let sums = tensor("sums", &[samples, parts, 2], &sums);
        let rows = noise(samples * grid.h * CHANNELS, 62);
        let scales = tensor("scales", &[2 * samples], &[before.clone(), vec![f32::NAN; samples]].concat());
        let mut scalars = Vec::new();
        for (first, count) in [(0, 1), (1, samples - 1)] {
            let rows = &rows[first * grid.h * CHANNELS..][..count * grid.h * CHANNELS];
            let rows = tensor("rows_max", &[count, grid.h, CHANNELS], rows);
            let scalar = poisoned("scalar", &[count]);
            let last_step = Some(LastStep { sums: &sums, first, particles: n });
            let scales = Scales { tensor: &scales, before: first, after: samples + first, last_step };
            run(|schedule| kernel.push(schedule, &layer, (&rows, &scalar), Some(scales)));
            scalars.extend(widened(&read(&scalar)));
        }
        let (last_grad, last_step) = (vec![0.0; samples * n], widened(&step));
        let mut hidden = Hidden { last_grad, last_step, scale: widened(&before) };
        hidden.scale_to_step();
        assert!((hidden.scale[2] / hidden.scale[0] - 0.01).abs() < 1e-6, "{:?}", hidden.scale);
        let next = |(&c, &s): (&f64, &f64)| s * (2.0 * (c / 2.0).tanh() - 1.0).exp();
        let expected: Vec<f64> = scalars.iter().zip(&hidden.scale).map(next).collect();
        let what = format!("scales of {batch} x {grid}");
        assert_close(&what, &read(&scales)[samples..], &expected, (0.0, 24.0 * ROUNDING));
    }
}
