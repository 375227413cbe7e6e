//! `step_scale` against the CPU path.

use crate::common::{ROUNDING, assert_close, cases, context, device, noise, read, run, tensor, widened};
use fnopt::cpu::optim::Hidden;
use fnopt::kernels::cloth::gradient;
use fnopt::kernels::operator::Scales;
use fnopt::kernels::optim::StepScale;

/// Components of different sizes, one of them smaller than counts, and a cloth without a step.
#[test]
fn scales_match() {
    let _turn = device();
    let kernel = StepScale::new(context()).unwrap();
    for (grid, batch) in cases() {
        let (n, samples) = (grid.particles(), 3 * batch);
        let mut step = noise(samples * n, 171);
        for (sample, step) in step.chunks_exact_mut(n).enumerate() {
            let factor = if sample < 3 { [1.0, 0.3, 1e-6][sample] } else { 0.0 };
            step.iter_mut().for_each(|step| *step *= factor);
        }
        let scale: Vec<f32> = (0..samples).map(|sample| 0.05 + sample as f32).collect();
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
        let scales = tensor("scales", &[2 * samples], &[scale.clone(), vec![f32::NAN; samples]].concat());
        run(|schedule| {
            kernel.push(schedule, grid, &sums, Scales { tensor: &scales, before: 0, after: samples });
        });
        let (last_grad, last_step) = (vec![0.0; samples * n], widened(&step));
        let mut hidden = Hidden { last_grad, last_step, scale: widened(&scale) };
        hidden.scale_to_step();
        let what = format!("scales of {batch} x {grid}");
        assert_close(&what, &read(&scales)[samples..], &hidden.scale, (0.0, 16.0 * ROUNDING));
        assert!((hidden.scale[2] / hidden.scale[0] - 0.01).abs() < 1e-6, "{:?}", hidden.scale);
    }
}
