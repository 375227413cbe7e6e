//! `update` against its formula.

use super::cloth::{field, iterate, model};
use crate::common::{
    ROUNDING, assert_close, cases, context, device, noise, pad, poisoned, read, run, tensor,
};
use fnopt::kernels::optim::{Update, UpdateTensors};
use fnopt::kernels::padded;
use fnopt::sim::Grid;

#[test]
fn learned_steps_match() {
    let _turn = device();
    let kernel = Update::new(context()).unwrap();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let (samples, n) = (3 * batch, grid.particles());
        let [grad, base, a] = [101, 102, 103].map(|seed| field(&model, 1.0, seed));
        // Some far beyond where tanh is 1, some tiny.
        let output: Vec<f32> = noise(samples * n, 104).iter().map(|v| 40.0 * v.powi(5)).collect();
        let scale: Vec<f32> = (0..samples).map(|s| 0.05 * (s + 1) as f32).collect();
        let slots = model.handle_slots();
        let step: Vec<f64> =
            output.iter().enumerate().map(|(k, &v)| f64::from(scale[k / n]) * f64::from(v).tanh()).collect();
        let next: Vec<f64> = a.iter().zip(&step).map(|(&a, step)| f64::from(a) + step).collect();
        let free = |k: usize| slots[k / (3 * n) * n + k % n] == 0;
        let shift: Vec<f64> =
            (0..next.len()).map(|k| f64::from(base[k]) + if free(k) { next[k] } else { 0.0 }).collect();

        let iterate = iterate(&model);
        iterate.grad.write(context(), &grad);
        iterate.base.write(context(), &base);
        iterate.a.write(context(), &a);
        let scale =
            tensor("scale", &[64 + samples], &[vec![f32::NAN; 64], scale].concat()).view(64, &[samples]);
        let hidden = poisoned("hidden", &[2, samples, n]);
        for (first, count) in [(0, 1), (1, samples - 1)] {
            let output = &output[first * n..][..count * n];
            // In parts whose sum is exact.
            let parts =
                [0.5, 0.25, 0.25].map(|part| output.iter().map(|v| part * v).collect::<Vec<_>>()).concat();
            let field = tensor("field", &[3, count, grid.h, padded(grid.w)], &pad(&parts, grid, f32::NAN));
            let from = UpdateTensors { field: &field, first, scale: &scale, hidden: &hidden };
            run(|schedule| kernel.push(schedule, grid, from, &iterate));
        }
        let what = format!("update {batch} x {grid}");
        let hidden = read(&hidden);
        assert_eq!(hidden[..samples * n], grad, "the last gradient");
        assert_close(&what, &hidden[samples * n..], &step, (1e-36, 8.0 * ROUNDING));
        assert_close(&what, &read(&iterate.a), &next, (8.0 * ROUNDING, ROUNDING));
        assert_close(&what, &read(&iterate.shift), &shift, (8.0 * ROUNDING, ROUNDING));
    }
}

/// Or a frame that is lost would look finite.
#[test]
fn what_is_no_number_stays_so() {
    let _turn = device();
    let grid = Grid { h: 8, w: 8 };
    let iterate = iterate(&model(grid, 1));
    let zeros = vec![0.0f32; 3 * 64];
    [&iterate.grad, &iterate.base, &iterate.a].iter().for_each(|tensor| tensor.write(context(), &zeros));
    let output: Vec<f32> = (0..3 * 64).map(|k| [0.1, f32::NAN, 9.0][k % 3]).collect();
    let field = tensor("field", &[1, 3, 8, 8], &output);
    let scale = tensor("scale", &[3], &[1.0; 3]);
    let hidden = poisoned("hidden", &[2, 3, 64]);
    let from = UpdateTensors { field: &field, first: 0, scale: &scale, hidden: &hidden };
    run(|schedule| Update::new(context()).unwrap().push(schedule, grid, from, &iterate));
    for (k, (a, output)) in read(&iterate.a).into_iter().zip(output).enumerate() {
        assert_eq!(a.is_nan(), output.is_nan(), "{k}: {a} of {output}");
    }
}
