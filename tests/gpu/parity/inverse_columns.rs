//! `inverse_columns` against its formula.

use super::operator::{CHANNELS, MODES, config, turn};
use crate::common::{
    ROUNDING, assert_close, cases, context, device, largest, noise, poisoned, read, run, sharings, tensor,
};
use fnopt::kernels::operator::InverseColumns;
use fnopt::network::tables;

#[test]
fn columns_match() {
    let _turn = device();
    for modes in MODES {
        let config = config(modes, CHANNELS);
        let [modes_h, modes_w] = modes;
        let kernels = sharings().map(|tuning| InverseColumns::new(context(), &tuning, modes_h).unwrap());
        for (grid, batch) in cases() {
            let z = noise(batch * modes_h * modes_w * CHANNELS * 2, 41);
            let mut expected = Vec::with_capacity(batch * grid.h * 2 * modes_w * CHANNELS);
            for s in 0..batch {
                for i in 0..grid.h {
                    for (k_w, part) in (0..modes_w).flat_map(|k| [(k, 0), (k, 1)]) {
                        expected.extend((0..CHANNELS).map(|c| {
                            let mode = |m: usize| {
                                let at = (((s * modes_h + m) * modes_w + k_w) * CHANNELS + c) * 2;
                                let (re, im) = (f64::from(z[at]), f64::from(z[at + 1]));
                                let (cos, sin) = turn(m as i64 - (modes_h / 2) as i64, i, grid.h);
                                if part == 0 { re * cos - im * sin } else { re * sin + im * cos }
                            };
                            (0..modes_h).map(mode).sum::<f64>()
                        }));
                    }
                }
            }
            let table = tensor("table", &[grid.h, modes_h, 2], &tables::columns(&config, grid.h, true));
            let spectrum = tensor("spectrum", &[batch, modes_h, modes_w, CHANNELS, 2], &z);
            for kernel in &kernels {
                let r = poisoned("r", &[batch, grid.h, 2 * modes_w, CHANNELS]);
                run(|schedule| kernel.push(schedule, &table, &spectrum, &r));
                // A rounding of each of the products.
                let atol = 3.0 * ROUNDING * largest(&expected);
                assert_close(&format!("inverse_columns {batch} x {grid}"), &read(&r), &expected, (atol, 0.0));
            }
        }
    }
}
