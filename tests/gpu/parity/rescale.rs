//! `rescale` against its formula.

use crate::common::{ROUNDING, assert_close, context, device, read, run, tensor};
use fnopt::kernels::optim::Rescale;

#[test]
fn scales_match() {
    let _turn = device();
    let kernel = Rescale::new(context()).unwrap();
    for samples in [3, 9, 200] {
        let scalar: Vec<f32> = (0..samples).map(|s| (s as f32 - 1.0) * 1.3 - 2.0).collect();
        let scale: Vec<f32> = (0..samples).map(|s| 0.05 * (s + 1) as f32).collect();
        let next = |(&c, &s): (&f32, &f32)| f64::from(s) * (2.0 * (f64::from(c) / 2.0).tanh() - 1.0).exp();
        let expected: Vec<f64> = scalar.iter().zip(&scale).map(next).collect();
        let scalar = tensor("scalar", &[samples], &scalar);
        // In place, and from one part of the tensor to another.
        for [before, after] in [[0, 0], [samples, 0], [0, samples]] {
            let parts = tensor("scale", &[2, samples], &[scale.as_slice(), &scale].concat());
            run(|schedule| kernel.push(schedule, &scalar, &parts, [before, after]));
            let (found, other) = (read(&parts), samples - after);
            let what = format!("rescale {samples}");
            assert_close(&what, &found[after..][..samples], &expected, (0.0, 16.0 * ROUNDING));
            assert_eq!(found[other..][..samples], scale, "the other part stays");
        }
    }
}
