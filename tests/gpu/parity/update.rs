//! `update` against its formula.

use super::cloth::{field, iterate_with_hidden, model};
use super::operator::joined_head;
use crate::common::{
    ROUNDING, assert_close, cases, context, device, noise, pad, poisoned, read, run, tensor,
};
use fnopt::cloth::Grid;
use fnopt::kernels::cloth::gradient;
use fnopt::kernels::operator::{LastStep, ScalarHead, Scales};
use fnopt::kernels::optim::{Update, UpdateTensors};
use fnopt::kernels::padded;

/// A grid with more particles than the workgroups of a sample have invocations.
const LARGE: Grid = Grid { h: 130, w: 139 };

#[test]
fn learned_steps_match() {
    let _turn = device();
    let kernel = Update::new(context()).unwrap();
    for (grid, batch) in cases().chain([(LARGE, 1)]) {
        let model = model(grid, batch);
        let (samples, n) = (3 * batch, grid.particles());
        let [grad, a] = [101, 103].map(|seed| field(&model, 1.0, seed));
        // Some far beyond where tanh saturates, some tiny.
        let output: Vec<f32> = noise(samples * n, 104).iter().map(|v| 40.0 * v.powi(5)).collect();
        let scale: Vec<f32> = (0..samples).map(|s| 0.05 * (s + 1) as f32).collect();
        let step: Vec<f64> =
            output.iter().enumerate().map(|(k, &v)| f64::from(scale[k / n]) * f64::from(v).tanh()).collect();
        let next: Vec<f64> = a.iter().zip(&step).map(|(&a, step)| f64::from(a) + step).collect();

        let iterate = iterate_with_hidden(&model);
        iterate.grad.write(context(), &grad);
        iterate.a.write(context(), &a);
        let scale = tensor("scale", &[64 + samples], &[vec![f32::NAN; 64], scale].concat());
        for (first, count) in [(0, 1), (1, samples - 1)] {
            let output = &output[first * n..][..count * n];
            // Split into parts whose sum is exact.
            let parts =
                [0.5, 0.25, 0.25].map(|part| output.iter().map(|v| part * v).collect::<Vec<_>>()).concat();
            let field = tensor("field", &[3, count, grid.h, padded(grid.w)], &pad(&parts, grid, f32::NAN));
            let scales = Scales { tensor: &scale, before: 0, after: 64 + first, last_step: None };
            let from = UpdateTensors { field: &field, first, scales, head: None, direction: None };
            run(|schedule| kernel.push(schedule, grid, from, &iterate));
        }
        let what = format!("update {batch} x {grid}");
        let hidden = read(iterate.hidden_state());
        assert_eq!(hidden[..samples * n], grad, "the last gradient");
        assert_close(&what, &hidden[samples * n..], &step, (1e-36, 8.0 * ROUNDING));
        assert_close(&what, &read(&iterate.a), &next, (8.0 * ROUNDING, ROUNDING));
    }
}

/// NaN stays NaN. Otherwise a frame that is lost would look finite.
#[test]
fn non_finite_numbers_stay_non_finite() {
    let _turn = device();
    let grid = Grid { h: 8, w: 8 };
    let iterate = iterate_with_hidden(&model(grid, 1));
    let zeros = vec![0.0f32; 3 * 64];
    [&iterate.grad, &iterate.a].iter().for_each(|tensor| tensor.write(context(), &zeros));
    let output: Vec<f32> = (0..3 * 64).map(|k| [0.1, f32::NAN, 9.0][k % 3]).collect();
    let field = tensor("field", &[1, 3, 8, 8], &output);
    let scale = tensor("scale", &[3], &[1.0; 3]);
    let scales = Scales::in_place(&scale);
    let from = UpdateTensors { field: &field, first: 0, scales, head: None, direction: None };
    run(|schedule| Update::new(context()).unwrap().push(schedule, grid, from, &iterate));
    for (k, (a, output)) in read(&iterate.a).into_iter().zip(output).enumerate() {
        assert_eq!(a.is_nan(), output.is_nan(), "{k}: {a} of {output}");
    }
}

/// Steps that compute the scale themselves have the bits of a scalar head followed by a step, also as directions, whose scales begin with
/// the size of the last step.
#[test]
fn steps_with_the_scalar_head_match() {
    let _turn = device();
    let (kernel, scalar_head) = (Update::new(context()).unwrap(), ScalarHead::new(context()).unwrap());
    let sizes = [(40, false), (64, true), (130, false), (40, true)];
    for ((grid, batch), (channels, proposes)) in
        cases().chain([(LARGE, 1)]).flat_map(|case| sizes.map(|size| (case, size)))
    {
        let model = model(grid, batch);
        let (samples, n) = (3 * batch, grid.particles());
        let (_, _, layer) = joined_head(channels);
        let parts = gradient::parts(grid);
        let sums: Vec<f32> = noise(2 * samples * parts, 108).iter().map(|v| v * v).collect();
        let sums = tensor("sums", &[samples, parts, 2], &sums);
        let [grad, a] = [101, 103].map(|seed| field(&model, 1.0, seed));
        let before: Vec<f32> = (0..samples).map(|s| 0.05 * (s + 1) as f32).collect();
        let scales = [before, vec![f32::NAN; samples]].concat();
        let outcomes = [false, true].map(|fused| {
            let iterate = iterate_with_hidden(&model);
            iterate.grad.write(context(), &grad);
            iterate.a.write(context(), &a);
            let scale = tensor("scale", &[2 * samples], &scales);
            let direction = proposes.then(|| poisoned("direction", &[batch, 3, n]));
            for (first, count) in [(0, 1), (1, samples - 1)] {
                let output = noise(count * n, 104 + first as u64);
                let field = pad(&output, grid, f32::NAN);
                let field = tensor("field", &[1, count, grid.h, padded(grid.w)], &field);
                let rows = noise(count * grid.h * channels, 107 + first as u64);
                let rows_max = tensor("rows_max", &[count, grid.h, channels], &rows);
                run(|schedule| {
                    let last_step = proposes.then_some(LastStep { sums: &sums, first, particles: n });
                    let scales = Scales { tensor: &scale, before: first, after: samples + first, last_step };
                    if !fused {
                        let scalar = poisoned("scalar", &[count]);
                        scalar_head.push(schedule, &layer, (&rows_max, &scalar), Some(scales));
                    }
                    let head = fused.then_some((&layer, &rows_max));
                    kernel.push(
                        schedule,
                        grid,
                        UpdateTensors { field: &field, first, scales, head, direction: direction.as_ref() },
                        &iterate,
                    );
                });
            }
            let step = read(direction.as_ref().unwrap_or(&iterate.a));
            (read(&scale), step, read(iterate.hidden_state()))
        });
        let [alone, fused] = outcomes;
        assert!(fused.1.iter().all(|a| a.is_finite()), "{batch} x {grid}");
        assert_eq!(alone, fused, "{channels} channels, {batch} x {grid}");
    }
}
