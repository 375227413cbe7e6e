//! `transform_columns` against the CPU path.

use super::operator::{CHANNELS, MODES, config};
use crate::common::{
    ROUNDING, assert_close, cases, context, device, largest, noise, poisoned, read, run, sharings, tensor,
    widened,
};
use fnopt::cpu::operator::Transform;
use fnopt::kernels::operator::TransformColumns;
use fnopt::network::tables;

#[test]
fn columns_match() {
    let _turn = device();
    for modes in MODES {
        let config = config(modes, CHANNELS);
        let [modes_h, modes_w] = modes;
        let kernels = sharings().map(|tuning| TransformColumns::new(context(), &tuning, modes_h).unwrap());
        for (grid, batch) in cases() {
            let transform = Transform::<f64>::new(&config, grid, CHANNELS).unwrap();
            let r = noise(batch * grid.h * transform.row_len(), 31);
            let spectrum_len = modes_h * modes_w * CHANNELS * 2;
            let mut expected = vec![0.0; batch * spectrum_len];
            let mut sums = vec![0.0; transform.column_len() / modes_w];
            let samples =
                r.chunks_exact(grid.h * transform.row_len()).zip(expected.chunks_exact_mut(spectrum_len));
            for (rows, spectrum) in samples {
                let rows = widened(rows);
                for k_w in 0..modes_w {
                    transform.column_forward(&mut sums, &rows, k_w);
                    for (m_h, c) in (0..modes_h).flat_map(|m| (0..CHANNELS).map(move |c| (m, c))) {
                        let (re, im) = transform.mode(&sums, m_h, c);
                        let at = ((m_h * modes_w + k_w) * CHANNELS + c) * 2;
                        (spectrum[at], spectrum[at + 1]) = (re, im);
                    }
                }
            }
            let table = tensor("table", &[grid.h, modes_h, 2], &tables::columns(&config, grid.h, false));
            let r = tensor("r", &[batch, grid.h, 2 * modes_w, CHANNELS], &r);
            for kernel in &kernels {
                let spectrum = poisoned("spectrum", &[batch, modes_h, modes_w, CHANNELS, 2]);
                run(|schedule| kernel.push(schedule, &table, &r, &spectrum));
                let atol = ROUNDING * (grid.h as f64).sqrt() * largest(&expected);
                let what = format!("transform_columns {batch} x {grid}");
                assert_close(&what, &read(&spectrum), &expected, (atol, 0.0));
            }
        }
    }
}
