//! `activate` and `gelu_adj` against the CPU path's GELU.

use crate::common::{ROUNDING, assert_close, context, device, noise, poisoned, read, run, tensor, widened};
use fnopt::cpu::Real;
use fnopt::kernels::operator::{Activate, GeluAdj};

#[test]
fn values_and_slopes_match() {
    let _turn = device();
    let (activate, gelu_adj) = (Activate::new(context()).unwrap(), GeluAdj::new(context()).unwrap());
    // From deep in both tails to tiny. The last size is not a multiple of the workgroup size.
    for n in [4, 256, 100_004] {
        let x: Vec<f32> = noise(n, 31).iter().map(|v| 30.0 * v.powi(3)).collect();
        let adj = noise(n, 32);
        let (mut values, mut slopes) = (widened(&x), vec![0.0; n]);
        f64::gelu_and_slope(&mut values, &mut slopes);
        let expected: Vec<f64> =
            slopes.iter().zip(&adj).map(|(slope, &adj)| slope * f64::from(adj)).collect();
        let (x, adj, y) = (tensor("x", &[n], &x), tensor("adj", &[n], &adj), poisoned("y", &[n]));
        run(|schedule| {
            activate.push(schedule, &x, &y);
            gelu_adj.push(schedule, &x, &adj);
        });
        // The error of the fit to erf, times an x of up to 30.
        let tolerance = (2e-6, 8.0 * ROUNDING);
        assert_close(&format!("activate {n}"), &read(&y), &values, tolerance);
        assert_close(&format!("gelu_adj {n}, values"), &read(&x), &values, tolerance);
        assert_close(&format!("gelu_adj {n}, cotangents"), &read(&adj), &expected, (1e-6, 8.0 * ROUNDING));
    }
}
