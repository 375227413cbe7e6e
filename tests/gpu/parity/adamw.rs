//! `squares` and `adamw` against the CPU path.

use crate::common::{ROUNDING, assert_close, context, device, largest, noise, read, run, tensor, widened};
use fnopt::cpu::train::{AdamW, AdamWSettings};
use fnopt::train::DeviceAdamW;

#[test]
fn updates_and_the_running_mean_match() {
    let _turn = device();
    // Exact in single precision; otherwise its rounding would dominate the error of the running mean.
    let average = 0.875;
    // A sum of squares in one part, and in several.
    for n in [61, 70_000] {
        let settings = AdamWSettings { clip: 0.5, ..Default::default() };
        let mut host = AdamW::<f64>::new(settings, n);
        let start = noise(n, 171);
        let (mut weights, mut averaged) = (widened(&start), widened(&noise(n, 172)));
        let on_device = tensor("weights", &[n], &start);
        let adamw = DeviceAdamW::new(context(), n, settings).unwrap();
        adamw.moments.averaged.write(context(), &noise(n, 172));
        for number in 1..4_u64 {
            // The first gradient is short enough not to be clipped.
            let size = [1e-4, 1.0, 30.0][number as usize - 1];
            let gradient: Vec<f32> = noise(n, 173 + number).iter().map(|g| g * size).collect();
            let norm = AdamW::norm(&widened(&gradient));
            host.step(&mut weights, (&widened(&gradient), norm), number, 0.01);
            for (mean, weight) in averaged.iter_mut().zip(&weights) {
                *mean = average * *mean + (1.0 - average) * weight;
            }
            adamw.gradient.write(context(), &gradient);
            run(|schedule| adamw.push_norm(schedule).unwrap());
            let squared = f64::from(read(&adamw.norm_squared)[0]);
            assert!((squared / (norm * norm) - 1.0).abs() < 1e-6, "{squared} and {}", norm * norm);
            adamw.set_factors(norm, number, (0.01, average));
            run(|schedule| adamw.push_step(schedule, &on_device).unwrap());
        }
        // In steps of 0.01, the roundings of a few operations show.
        let tolerance = (1e-7, 4.0 * ROUNDING);
        assert_close(&format!("adamw {n}"), &read(&on_device), &weights, tolerance);
        assert_close(&format!("adamw {n}, mean"), &read(&adamw.moments.averaged), &averaged, tolerance);
        // Gradients of either sign cancel, which leaves an absolute error; squares do not.
        let tolerance = (8.0 * ROUNDING * largest(&host.mean), 4.0 * ROUNDING);
        assert_close("mean gradient", &read(&adamw.moments.mean), &host.mean, tolerance);
        assert_close("mean square", &read(&adamw.moments.square), &host.square, (0.0, 16.0 * ROUNDING));
    }
}
