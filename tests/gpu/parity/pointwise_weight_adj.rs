//! `pointwise_weight_adj` with `sum_parts` against the sum over all positions.

use super::operator::tiled;
use crate::common::{
    ROUNDING, assert_close, by_rows, cases, context, device, largest, noise, poisoned, read, run, tensor,
};
use fnopt::cloth::Grid;
use fnopt::kernels::operator::{Parts, PointwiseWeightAdj, SumParts, pointwise::Lines, pointwise_weight_adj};
use fnopt::kernels::padded;

/// Returns the gradients over weight [O, I] and bias of a layer.
fn expected(x: &[f32], adj: &[f32], (outputs, inputs, n): (usize, usize, usize)) -> (Vec<f64>, Vec<f64>) {
    let (mut weight, mut bias) = (vec![0.0; outputs * inputs], vec![0.0; outputs]);
    for (x, adj) in x.chunks_exact(inputs * n).zip(adj.chunks_exact(outputs * n)) {
        for (o, adj) in adj.chunks_exact(n).enumerate() {
            bias[o] += adj.iter().map(|&a| f64::from(a)).sum::<f64>();
            for (i, x) in x.chunks_exact(n).enumerate() {
                let products = adj.iter().zip(x).map(|(&a, &x)| f64::from(a) * f64::from(x));
                weight[o * inputs + i] += products.sum::<f64>();
            }
        }
    }
    (weight, bias)
}

#[test]
fn gradients_over_the_weights_match() {
    let _turn = device();
    let kernel = PointwiseWeightAdj::new(context()).unwrap();
    let sum = SumParts::new(context()).unwrap();
    let large = Grid { h: 100, w: 100 };
    // Inputs that do not fill a tile, several tiles, and tiles of another width.
    let sizes = [(64, 5, 8), (32, 96, 32), (48, 40, 16)];
    for (index, (grid, samples)) in cases().filter(|case| case.0 != large).chain([(large, 1)]).enumerate() {
        let (outputs, inputs, tile) = sizes[index % sizes.len()];
        let (w, n) = (padded(grid.w), grid.h * padded(grid.w));
        let (x, mut adj) = (noise(samples * inputs * n, 43), noise(samples * outputs * n, 44));
        // As for any cotangents, the padding is zero.
        adj.iter_mut().enumerate().filter(|(k, _)| k % w >= grid.w).for_each(|(_, adj)| *adj = 0.0);
        let (weight, bias) = expected(&x, &adj, (outputs, inputs, n));
        let narrow: Vec<f32> = weight.iter().map(|&w| w as f32).collect();
        let gap = 16;
        let parts = pointwise_weight_adj::parts(samples * n / 4);
        let len = outputs * inputs + gap + outputs;
        let before = noise(len, 45);
        let gradient = tensor("gradient", &[len], &before);
        let partial = poisoned("partial", &[parts, len]);
        let whole_rows = Grid { w, ..grid };
        let x = tensor("x", &[samples, grid.h, inputs, w], &by_rows(&x, inputs, whole_rows, 0.0));
        let adj = by_rows(&adj, outputs, whole_rows, 0.0);
        let adj = tensor("adj", &[samples, grid.h, outputs, w], &adj);
        let all = Lines { count: samples * grid.h, x_first: 0, y_first: 0 };
        run(|schedule| {
            let to = Parts { partial: &partial, len, bias: len - outputs, tile };
            let count = kernel.push(schedule, (&x, &adj), all, to);
            assert_eq!(count, parts);
            sum.push(schedule, (&partial, count), &gradient);
        });
        let found = read(&gradient);
        let order = tiled(&(0..narrow.len()).map(|k| k as f32).collect::<Vec<_>>(), inputs, tile);
        let mut whole: Vec<f64> = order.iter().map(|&k| weight[k as usize]).collect();
        whole.extend(vec![0.0; gap]);
        whole.extend(&bias);
        whole.iter_mut().zip(&before).for_each(|(expected, &before)| *expected += f64::from(before));
        // An invocation sums up to 2048 products one by one, whose roundings add up like a random walk.
        let atol = 0.5 * ROUNDING * (n.min(2048) as f64).sqrt() * largest(&whole);
        assert_close(&format!("weights {outputs}x{inputs} {samples} x {grid}"), &found, &whole, (atol, 0.0));
    }
}

#[test]
fn some_of_the_lines_alone() {
    let _turn = device();
    let kernel = PointwiseWeightAdj::new(context()).unwrap();
    let (outputs, inputs, tile, w, lines) = (32, 32, 8, 100, 27);
    let (x, adj) = (noise(40 * inputs * w, 46), noise(60 * outputs * w, 47));
    // Lines of `x` from 7 on and of the cotangents from 11 on, each as if it were a sample.
    let (weight, _) =
        expected(&x[7 * inputs * w..][..lines * inputs * w], &adj[11 * outputs * w..], (outputs, inputs, w));
    let len = outputs * inputs + outputs;
    let parts = pointwise_weight_adj::parts(lines * w / 4);
    assert!(parts > 1, "a line is divided");
    let partial = poisoned("partial", &[parts, len]);
    let [x, adj] = [(40, inputs, &x), (60, outputs, &adj)].map(|(l, c, data)| tensor("x", &[l, c, w], data));
    let part = Lines { count: lines, x_first: 7, y_first: 11 };
    run(|schedule| {
        let to = Parts { partial: &partial, len, bias: outputs * inputs, tile };
        kernel.push(schedule, (&x, &adj), part, to);
    });
    let rows = read(&partial);
    let order = tiled(&(0..weight.len()).map(|k| k as f32).collect::<Vec<_>>(), inputs, tile);
    let found: Vec<f32> =
        (0..weight.len()).map(|k| (0..parts).map(|part| rows[part * len + k]).sum()).collect();
    let expected: Vec<f64> = order.iter().map(|&k| weight[k as usize]).collect();
    // An invocation sums up to 1024 products one by one, whose roundings add up like a random walk.
    assert_close("some lines", &found, &expected, (16.0 * ROUNDING * largest(&expected), 0.0));
}
