//! `block` against its formula: inverse rows, skip, bias and activation.

use super::operator::{MODES, activate, activations, config, copies, dense, layer, turn};
use crate::common::{
    ROUNDING, assert_close, cases, context, device, largest, noise, poisoned, read, read_unpadded, run,
    tensor, tunings,
};
use fnopt::kernels::operator::{Block, BlockTensors};
use fnopt::kernels::padded;
use fnopt::network::tables;
use fnopt::sim::Grid;

const CHANNELS: usize = 32;

/// Adds the inverse rows of `r` [S, H, 2 modes_w, C] to `y` [S, C, H, W].
fn add_inverse_rows(y: &mut [f64], r: &[f32], modes_w: usize, grid: Grid) {
    let Grid { h, w } = grid;
    for (index, y) in y.iter_mut().enumerate() {
        let (j, i, c, s) = (index % w, index / w % h, index / (w * h) % CHANNELS, index / (w * h * CHANNELS));
        let r = |k: usize| f64::from(r[((s * h + i) * 2 * modes_w + k) * CHANNELS + c]);
        for m in 0..modes_w {
            let (cos, sin) = turn(m as i64, j, w);
            *y += copies(m, w) * (r(2 * m) * cos - r(2 * m + 1) * sin);
        }
    }
}

#[test]
fn blocks_of_all_tiles_match() {
    let _turn = device();
    for tuning in tunings() {
        for (gelu, modes) in [(false, MODES[1]), (true, MODES[0])] {
            for (grid, batch) in cases() {
                let config = config(modes, CHANNELS);
                let columns = 2 * config.modes_w;
                let (x, x_tensor) = activations(batch, CHANNELS, grid, 0.5);
                let (weight, bias, skip) = layer(CHANNELS, CHANNELS, tuning.channels);
                let r = noise(batch * grid.h * columns * CHANNELS, 21);
                let mut expected = dense(&weight, &bias, &x, grid.particles());
                add_inverse_rows(&mut expected, &r, config.modes_w, grid);
                activate(&mut expected, gelu);
                let w = padded(grid.w);
                let table = tensor("table", &[columns, w], &tables::inverse_rows(&config, grid.w));
                let r = tensor("r", &[batch, grid.h, columns, CHANNELS], &r);
                let y = poisoned("y", &[batch, CHANNELS, grid.h, w]);
                let kernel = Block::new(context(), &tuning, w / 4, gelu).unwrap();
                let tensors = BlockTensors { x: &x_tensor, r: &r, y: &y };
                run(|schedule| kernel.push(schedule, &skip, &table, tensors));
                let what = format!("block {} gelu {gelu} {batch} x {grid}", tuning.channels);
                // A rounding for each of the 42 products, of sums about as large as the result.
                let atol = (7.0 * ROUNDING + if gelu { 3e-7 } else { 0.0 }) * largest(&expected);
                assert_close(&what, &read_unpadded(&y, grid), &expected, (atol, ROUNDING));
                assert!(read(&y).iter().all(|y| y.is_finite()), "the padding stays finite");
            }
        }
    }
}
