//! `gradient_size` against a mean.

use crate::common::{ROUNDING, assert_close, cases, context, device, noise, poisoned, read, run, tensor};
use fnopt::kernels::train::GradientSize;

#[test]
fn mean_magnitudes_match() {
    let _turn = device();
    let kernel = GradientSize::new(context()).unwrap();
    for (grid, batch) in cases() {
        let n = grid.particles();
        let grad = noise(batch * 3 * n, 161);
        let mean = |g: &[f32]| g.iter().map(|&g| f64::from(g.abs())).sum::<f64>() / (3 * n) as f64;
        let expected: Vec<f64> = grad.chunks_exact(3 * n).map(mean).collect();
        let (grad, sizes) = (tensor("grad", &[batch, 3, n], &grad), poisoned("sizes", &[batch]));
        run(|schedule| kernel.push(schedule, &grad, &sizes));
        assert_close(&format!("size {batch} x {grid}"), &read(&sizes), &expected, (0.0, 16.0 * ROUNDING));
    }
}
