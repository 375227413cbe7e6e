//! `features` against its formula.

use crate::common::{
    ROUNDING, assert_close, cases, context, device, noise, poisoned, read, read_channels, run, tensor,
    widened,
};
use fnopt::cloth::{Grid, Mark};
use fnopt::kernels::cloth::gradient::parts;
use fnopt::kernels::optim::{FeatureInputs, Features, Iterate};
use fnopt::kernels::padded;

/// Returns `10 tanh(field / rms / 10)`, with the root mean square of `of`.
fn squashed(field: &[f32], of: &[f32]) -> Vec<f64> {
    let squares: f64 = widened(of).iter().map(|v| v * v).sum();
    // The shader clamps it to at least this, so that a zero field stays zero.
    let rms = (squares / of.len() as f64).sqrt().max(1e-19);
    field.iter().map(|&v| 10.0 * (f64::from(v) / rms / 10.0).tanh()).collect()
}

/// Returns partial sums of squares of two fields [S, n], shape [S, parts, 2], with particles dealt out in
/// turn.
pub fn sums(grid: Grid, samples: usize, fields: [&[f32]; 2]) -> Vec<f32> {
    let (n, count) = (grid.particles(), parts(grid));
    let mut sums = vec![0.0; samples * count * 2];
    for (which, field) in fields.into_iter().enumerate() {
        for (k, &v) in field.iter().enumerate() {
            sums[2 * (k / n * count + k % n % count) + which] += f64::from(v) * f64::from(v);
        }
    }
    sums.into_iter().map(|sum| sum as f32).collect()
}

fn check(kernel: &Features, (grid, samples): (Grid, usize), grad: &[f32], hidden: &[f32], what: &str) {
    let n = grid.particles();
    let mut expected = Vec::new();
    for s in 0..samples {
        let g = &grad[s * n..][..n];
        let step = &hidden[(samples + s) * n..][..n];
        expected.extend(squashed(g, g));
        expected.extend(squashed(&hidden[s * n..][..n], g));
        expected.extend(squashed(step, step));
        expected.extend((0..n).map(|p| (p / grid.w) as f64 / (grid.h - 1) as f64));
        expected.extend((0..n).map(|p| (p % grid.w) as f64 / (grid.w - 1) as f64));
    }
    let marks = vec![Mark::default(); samples / 3 * n];
    let iterate = Iterate::with_hidden(context(), samples / 3, &marks).unwrap();
    iterate.grad.write(context(), grad);
    iterate.hidden_state().write(context(), hidden);
    let squares = sums(grid, samples, [grad, &hidden[samples * n..]]);
    let rows = tensor("rows", &[128 + squares.len()], &[vec![f32::NAN; 128], squares].concat());
    let sums = &rows.view(128, &[samples, parts(grid), 2]);
    for (first, count) in [(0, samples), (1, samples - 2)] {
        let embedded = poisoned("embedded", &[count, grid.h, 5, padded(grid.w)]);
        run(|schedule| {
            kernel.push(schedule, grid, FeatureInputs { iterate: &iterate, sums, first }, &embedded);
        });
        let expected = &expected[5 * n * first..][..5 * n * count];
        // A few roundings each of the norm and of tanh.
        assert_close(what, &read_channels(&embedded, grid), expected, (1e-36, 8.0 * ROUNDING));
        let rows = read(&embedded);
        let padding = rows.chunks_exact(padded(grid.w)).flat_map(|row| &row[grid.w..]);
        assert!(padding.clone().all(|&v| v == 0.0), "{what}: the padding is zero");
    }
}

#[test]
fn normalised_fields_and_positions_match() {
    let _turn = device();
    let kernel = Features::new(context()).unwrap();
    for (grid, batch) in cases() {
        let (samples, n) = (3 * batch, grid.particles());
        // Samples of very different sizes. The high power of noise saturates some elements. None is so small
        // that a tenth of it is subnormal, which a device may flush to zero.
        let size = |s: usize| 10f32.powi(3 * (s % 3) as i32 - 6);
        let normal = |v: f32| if (0.1 * v).is_subnormal() { 0.0 } else { v };
        let spiky = |len, seed| {
            noise(len, seed).into_iter().enumerate().map(move |(k, v)| normal(size(k / n) * v.powi(9)))
        };
        let grad: Vec<f32> = spiky(samples * n, 91).collect();
        let hidden: Vec<f32> = spiky(2 * samples * n, 92).collect();
        check(&kernel, (grid, samples), &grad, &hidden, &format!("features {batch} x {grid}"));
    }
}

/// If squares fall below the normal numbers, where a device may flush them to zero, a field is not blown up.
#[test]
fn tiny_fields_stay_small() {
    let _turn = device();
    let kernel = Features::new(context()).unwrap();
    let (grid, samples) = (crate::common::GRIDS[1], 3);
    let tiny = |size: f32, seed| -> Vec<f32> {
        noise(samples * grid.particles(), seed).into_iter().map(|v| size * v).collect()
    };
    for size in [1e-21, 1e-23, 1e-30, 1e-38] {
        let (grad, step) = (tiny(size, 94), tiny(size, 95));
        let marks = vec![Mark::default(); grid.particles()];
        let iterate = Iterate::with_hidden(context(), 1, &marks).unwrap();
        iterate.grad.write(context(), &grad);
        iterate.hidden_state().write(context(), &[grad.clone(), step.clone()].concat());
        let squares = sums(grid, samples, [&grad, &step]);
        let sums = &tensor("sums", &[samples, parts(grid), 2], &squares);
        let embedded = poisoned("embedded", &[samples, grid.h, 5, padded(grid.w)]);
        let fields = FeatureInputs { iterate: &iterate, sums, first: 0 };
        run(|schedule| kernel.push(schedule, grid, fields, &embedded));
        let found = read_channels(&embedded, grid);
        let largest = found.iter().fold(0.0, |most: f32, v| most.max(v.abs()));
        assert!(found.iter().all(|v| v.is_finite()) && largest <= 2.0, "{size:e}: {largest}");
    }
}

/// The first iteration of a run has no last step, and a cloth at rest has no gradient: zero fields stay zero.
#[test]
fn zero_fields_stay_zero() {
    let _turn = device();
    let kernel = Features::new(context()).unwrap();
    let (grid, samples) = (crate::common::GRIDS[1], 3);
    let n = grid.particles();
    let mut grad = noise(samples * n, 93);
    grad[..n].fill(0.0);
    check(&kernel, (grid, samples), &grad, &vec![0.0; 2 * samples * n], "features of zero");
}
