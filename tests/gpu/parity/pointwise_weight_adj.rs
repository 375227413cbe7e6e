//! `pointwise_weight_adj` with `sum_parts` against the sum over all positions.

use super::operator::tiled;
use crate::common::{
    ROUNDING, assert_close, cases, context, device, largest, noise, poisoned, read, run, tensor,
};
use fnopt::kernels::operator::{
    Parts, PointwiseWeightAdj, SumParts, pointwise::Samples, pointwise_weight_adj,
};
use fnopt::kernels::padded;
use fnopt::sim::Grid;

/// Gradient over weight and bias of a layer in tiles, with `gap` elements in between.
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
    // Inputs that fill no tile, several tiles, and tiles of another width.
    let sizes = [(64, 5, 8), (32, 96, 32), (48, 40, 16)];
    for (index, (grid, samples)) in cases().filter(|case| case.0 != large).chain([(large, 1)]).enumerate() {
        let (outputs, inputs, tile) = sizes[index % sizes.len()];
        let (w, n) = (padded(grid.w), grid.h * padded(grid.w));
        let (x, mut adj) = (noise(samples * inputs * n, 43), noise(samples * outputs * n, 44));
        // As cotangents are: nothing in the padding.
        adj.iter_mut().enumerate().filter(|(k, _)| k % w >= grid.w).for_each(|(_, adj)| *adj = 0.0);
        let (weight, bias) = expected(&x, &adj, (outputs, inputs, n));
        let narrow: Vec<f32> = weight.iter().map(|&w| w as f32).collect();
        let gap = 16;
        let parts = pointwise_weight_adj::parts(n / 4);
        let len = outputs * inputs + gap + outputs;
        let before = noise(len, 45);
        let gradient = tensor("gradient", &[len], &before);
        let partial = poisoned("partial", &[samples * parts, len]);
        let x = tensor("x", &[samples, inputs, grid.h, w], &x);
        let adj = tensor("adj", &[samples, outputs, grid.h, w], &adj);
        let all = Samples { count: samples, x_first: 0, y_first: 0 };
        run(|schedule| {
            let to = Parts { partial: &partial, len, bias: len - outputs, tile };
            let count = kernel.push(schedule, (&x, &adj), all, to);
            assert_eq!(count, samples * parts);
            sum.push(schedule, (&partial, count), &gradient);
        });
        let found = read(&gradient);
        let order = tiled(&(0..narrow.len()).map(|k| k as f32).collect::<Vec<_>>(), inputs, tile);
        let mut whole: Vec<f64> = order.iter().map(|&k| weight[k as usize]).collect();
        whole.extend(vec![0.0; gap]);
        whole.extend(&bias);
        whole.iter_mut().zip(&before).for_each(|(expected, &before)| *expected += f64::from(before));
        // An invocation sums up to 2048 products one by one, whose roundings add up like a walk.
        let atol = 0.5 * ROUNDING * (n.min(2048) as f64).sqrt() * largest(&whole);
        assert_close(&format!("weights {outputs}x{inputs} {samples} x {grid}"), &found, &whole, (atol, 0.0));
    }
}

#[test]
fn some_of_the_samples_alone() {
    let _turn = device();
    let kernel = PointwiseWeightAdj::new(context()).unwrap();
    let (outputs, inputs, tile, h, w) = (32, 32, 8, 9, 12);
    let n = h * w;
    let (x, adj) = (noise(3 * inputs * n, 46), noise(4 * outputs * n, 47));
    // Samples 1 and 2 of x, 2 and 3 of the cotangents.
    let (weight, _) = expected(&x[inputs * n..], &adj[2 * outputs * n..], (outputs, inputs, n));
    let len = outputs * inputs + outputs;
    let partial = poisoned("partial", &[2, len]);
    let [x, adj] = [(3, inputs, &x), (4, outputs, &adj)].map(|(s, c, data)| tensor("x", &[s, c, h, w], data));
    let part = Samples { count: 2, x_first: 1, y_first: 2 };
    run(|schedule| {
        let to = Parts { partial: &partial, len, bias: outputs * inputs, tile };
        kernel.push(schedule, (&x, &adj), part, to);
    });
    let rows = read(&partial);
    let order = tiled(&(0..weight.len()).map(|k| k as f32).collect::<Vec<_>>(), inputs, tile);
    let found: Vec<f32> = (0..weight.len()).map(|k| rows[k] + rows[len + k]).collect();
    let expected: Vec<f64> = order.iter().map(|&k| weight[k as usize]).collect();
    assert_close("some samples", &found, &expected, (8.0 * ROUNDING * largest(&expected), 0.0));
}
