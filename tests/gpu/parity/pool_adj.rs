//! `pool_adj` against a search for the first largest element.

use super::operator::{CHANNELS, head};
use crate::common::{
    ROUNDING, assert_close, by_rows, cases, context, device, noise, poisoned, read, run, tensor,
};
use fnopt::kernels::operator::{PoolAdj, PoolAdjTensors, PoolRows};
use fnopt::kernels::padded;

#[test]
fn the_first_largest_position_takes_the_cotangent() {
    let _turn = device();
    let (kernel, pool) = (PoolAdj::new(context()).unwrap(), PoolRows::new(context()).unwrap());
    for (grid, samples) in cases() {
        let n = grid.particles();
        // Multiples of a quarter, so that most maxima occur more than once. The padding is larger.
        let x: Vec<f32> = noise(samples * CHANNELS * n, 61).iter().map(|v| (4.0 * v).round() / 4.0).collect();
        let (weight, _, layer) = head(CHANNELS);
        let (adj_scalar, before) = (noise(samples, 62), noise(x.len(), 63));
        let mut expected: Vec<f64> = before.iter().map(|&b| f64::from(b)).collect();
        let mut largest = Vec::new();
        for (index, plane) in x.chunks_exact(n).enumerate() {
            let most = plane.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let first = plane.iter().position(|&v| v == most).unwrap();
            let back = f64::from(weight[index % CHANNELS]) * f64::from(adj_scalar[index / CHANNELS]);
            expected[index * n + first] += back;
            largest.push(most);
        }
        let shape = [samples, grid.h, CHANNELS, padded(grid.w)];
        let x = tensor("x", &shape, &by_rows(&x, CHANNELS, grid, 9.0));
        let adj = tensor("adj", &shape, &by_rows(&before, CHANNELS, grid, 0.0));
        let adj_scalar = tensor("adj_scalar", &[samples], &adj_scalar);
        let rows_max = poisoned("rows_max", &[samples, grid.h, CHANNELS]);
        let pooled = poisoned("pooled", &[samples, CHANNELS]);
        run(|schedule| {
            pool.push(schedule, grid.w, &x, &rows_max);
            let from =
                PoolAdjTensors { adj_scalar: &adj_scalar, rows_max: &rows_max, x: &x, columns: grid.w };
            kernel.push(schedule, &layer.weight, from, (&adj, &pooled));
        });
        assert_eq!(read(&pooled), largest);
        let found = crate::common::read_channels(&adj, grid);
        assert_close(&format!("pool_adj {samples} x {grid}"), &found, &expected, (ROUNDING, ROUNDING));
        let padding = read(&adj);
        let beyond = padding.chunks_exact(padded(grid.w)).flat_map(|row| &row[grid.w..]);
        assert!(beyond.into_iter().all(|&v| v == 0.0), "nothing goes into the padding");
    }
}
