//! `multiply_add` against the same steps in double precision.

use crate::common::{ROUNDING, assert_close, context, device, noise, poisoned, read, run, tensor, widened};
use fnopt::kernels::operator::MultiplyAdd;

#[test]
fn chains_match() {
    let _turn = device();
    let kernel = MultiplyAdd::new(context()).unwrap();
    // The last size is not a multiple of the workgroup size.
    for (n, steps, factor, term) in [(4, 1, 0.5, 0.5), (256, 3, -0.97, 0.1), (100_004, 9, 0.99, -0.02)] {
        let x = noise(n, 33);
        let after = |mut t: f64| {
            for _ in 0..16 * steps {
                t = f64::from(factor) * t + f64::from(term);
            }
            t
        };
        let expected: Vec<f64> =
            widened(&x).iter().map(|&x| after(x) + after(x + 1.0) + after(x - 1.0)).collect();
        let (x, y) = (tensor("x", &[n], &x), poisoned("y", &[n]));
        run(|schedule| kernel.push(schedule, (steps, factor, term), &x, &y));
        assert_close(&format!("multiply_add {n}"), &read(&y), &expected, (20.0 * ROUNDING, 20.0 * ROUNDING));
    }
}
