//! `pool_rows` against the maximum of each row.

use super::operator::{CHANNELS, activations};
use crate::common::{cases, context, device, poisoned, read, run};
use fnopt::kernels::operator::PoolRows;

#[test]
fn maxima_of_rows_are_exact() {
    let _turn = device();
    let kernel = PoolRows::new(context()).unwrap();
    for (grid, batch) in cases() {
        // The padding is larger than everything, and must not count.
        let (x, x_tensor) = activations(batch, CHANNELS, grid, 1e6);
        let mut expected = vec![f32::NEG_INFINITY; batch * grid.h * CHANNELS];
        for (index, row) in x.chunks_exact(grid.w).enumerate() {
            let (i, c, s) = (index % grid.h, index / grid.h % CHANNELS, index / (grid.h * CHANNELS));
            expected[(s * grid.h + i) * CHANNELS + c] = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        }
        let rows_max = poisoned("rows_max", &[batch, grid.h, CHANNELS]);
        run(|schedule| kernel.push(schedule, grid.w, &x_tensor, &rows_max));
        assert_eq!(read(&rows_max), expected, "{batch} x {grid}");
    }
}
