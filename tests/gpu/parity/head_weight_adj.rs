//! `head_weight_adj` against the sum over all positions.

use crate::common::{ROUNDING, assert_close, context, device, largest, noise, read, run, tensor};
use fnopt::kernels::operator::HeadWeightAdj;

#[test]
fn gradients_over_a_heads_weights_match() {
    let _turn = device();
    let kernel = HeadWeightAdj::new(context()).unwrap();
    // A field head, and a scalar head, which has one position per sample.
    for (lines, channels, width) in [(93, 40, 36), (7, 80, 1)] {
        let (x, adj) = (noise(lines * channels * width, 56), noise(lines * width, 57));
        let bias_at = channels + 24;
        let before = noise(bias_at + 4, 58);
        let mut expected: Vec<f64> = before.iter().map(|&b| f64::from(b)).collect();
        for (l, adj) in adj.chunks_exact(width).enumerate() {
            expected[bias_at] += adj.iter().map(|&a| f64::from(a)).sum::<f64>();
            for c in 0..channels {
                let x = &x[(l * channels + c) * width..][..width];
                expected[c] += x.iter().zip(adj).map(|(&x, &a)| f64::from(x) * f64::from(a)).sum::<f64>();
            }
        }
        let gradient = tensor("gradient", &[before.len()], &before);
        let x = tensor("x", &[lines, channels, width], &x);
        let adj = tensor("adj", &[lines, width], &adj);
        run(|schedule| kernel.push(schedule, &x, &adj, (&gradient, bias_at)));
        // The roundings of 50 terms per invocation, then those of the tree.
        let atol = 8.0 * ROUNDING * largest(&expected).max(1.0);
        assert_close(&format!("head {lines} {channels}"), &read(&gradient), &expected, (atol, 0.0));
    }
}
