//! `transform_rows` against the CPU path.

use super::operator::{CHANNELS, MODES, activations, config};
use crate::common::{
    ROUNDING, assert_close, cases, context, device, largest, poisoned, read, run, sharings, tensor,
};
use fnopt::cpu::operator::Transform;
use fnopt::kernels::operator::TransformRows;
use fnopt::kernels::padded;
use fnopt::network::tables;

#[test]
fn rows_match() {
    let _turn = device();
    for modes in MODES {
        let config = config(modes, CHANNELS);
        let columns = 2 * config.modes_w;
        let kernels =
            sharings().map(|tuning| TransformRows::new(context(), &tuning, config.modes_w).unwrap());
        for (grid, batch) in cases() {
            // The content of the padding must not count.
            let (x, x_tensor) = activations(batch, CHANNELS, grid, 1e3);
            let transform = Transform::<f64>::new(&config, grid, CHANNELS).unwrap();
            let mut expected = vec![0.0; batch * grid.h * transform.row_len()];
            for (row, out) in expected.chunks_exact_mut(transform.row_len()).enumerate() {
                let (s, i) = (row / grid.h, row % grid.h);
                let at = |j: usize, c: usize| x[((s * CHANNELS + c) * grid.h + i) * grid.w + j];
                let row: Vec<f64> =
                    (0..grid.w).flat_map(|j| (0..CHANNELS).map(move |c| f64::from(at(j, c)))).collect();
                transform.row_forward(out, &row);
            }
            let shape = [padded(grid.w) / 4, columns, 4];
            let table = tensor("table", &shape, &tables::forward_rows(&config, grid.h, grid.w));
            for kernel in &kernels {
                let r = poisoned("r", &[batch, grid.h, columns, CHANNELS]);
                run(|schedule| kernel.push(schedule, &table, &x_tensor, &r));
                // The roundings of sums of W terms grow as the root of W.
                let atol = ROUNDING * (grid.w as f64).sqrt() * largest(&expected);
                assert_close(&format!("transform_rows {batch} x {grid}"), &read(&r), &expected, (atol, 0.0));
            }
        }
    }
}
