//! `project_adj` against an outer product.

use super::operator::{CHANNELS, head};
use crate::common::{ROUNDING, assert_close, cases, context, device, noise, poisoned, read, run, tensor};
use fnopt::kernels::operator::ProjectAdj;
use fnopt::kernels::padded;

#[test]
fn outer_products_match() {
    let _turn = device();
    let kernel = ProjectAdj::new(context()).unwrap();
    for (grid, samples) in cases() {
        let (h, w) = (grid.h, padded(grid.w));
        let (weight, _, layer) = head(CHANNELS);
        let adj_field = noise(samples * h * w, 64);
        let of = |k: usize| {
            let (j, c, line) = (k % w, k / w % CHANNELS, k / (w * CHANNELS));
            f64::from(weight[c]) * f64::from(adj_field[line * w + j])
        };
        let expected: Vec<f64> = (0..samples * CHANNELS * h * w).map(of).collect();
        let adj_field = tensor("adj_field", &[samples, h, w], &adj_field);
        let adj = poisoned("adj", &[samples, h, CHANNELS, w]);
        run(|schedule| kernel.push(schedule, &layer.weight, &adj_field, &adj));
        assert_close(&format!("project_adj {samples} x {grid}"), &read(&adj), &expected, (0.0, ROUNDING));
    }
}
