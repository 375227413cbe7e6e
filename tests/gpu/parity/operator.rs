//! Helpers shared by the tests of the operator kernels.

use crate::common::{by_rows, noise, tensor};
use fnopt::cloth::Grid;
use fnopt::cpu::Real;
use fnopt::gpu::Tensor;
use fnopt::kernels::operator::{JoinedLayer, Layer, pointwise, spectral};
use fnopt::kernels::padded;
use fnopt::network::Config;
use std::f64::consts::TAU;

/// The network's modes, and fewer modes with an odd number of rows.
pub const MODES: [[usize; 2]; 2] = [[8, 5], [7, 3]];
/// More channels than a workgroup has invocations.
pub const CHANNELS: usize = 80;

/// Returns a configuration with these modes and channels.
pub fn config([modes_h, modes_w]: [usize; 2], channels: usize) -> Config {
    Config { modes_h, modes_w, channels, ..Config::default() }
}

/// Returns random activations: dense [S, C, H, W] for formulas, and as a tensor with `filler` in the padding.
pub fn activations(samples: usize, channels: usize, grid: Grid, filler: f32) -> (Vec<f32>, Tensor) {
    let dense = noise(samples * channels * grid.particles(), 11);
    let shape = [samples, grid.h, channels, padded(grid.w)];
    let padded = tensor("x", &shape, &by_rows(&dense, channels, grid, filler));
    (dense, padded)
}

/// Reorders a weight [O, I] for the kernels.
pub fn tiled(weight: &[f32], inputs: usize, tile: usize) -> Vec<f32> {
    let mut ordered = vec![0.0; weight.len()];
    for (k, &w) in weight.iter().enumerate() {
        ordered[pointwise::index(k / inputs, k % inputs, (inputs, tile))] = w;
    }
    ordered
}

/// Reorders a checkpoint's spectral weight [I, O, modes, 2] for the kernel.
pub fn by_mode(weight: &[f32], inputs: usize, outputs: usize) -> Vec<f32> {
    let modes = weight.len() / (2 * inputs * outputs);
    let mut ordered = vec![0.0; weight.len()];
    for (k, pair) in weight.chunks_exact(2).enumerate() {
        let (io, mode) = (k / modes, k % modes);
        let at = spectral::index(mode, (io / outputs, io % outputs), (inputs, outputs));
        ordered[at..at + 2].copy_from_slice(pair);
    }
    ordered
}

/// Returns a random layer: weight [outputs, inputs] and bias [outputs] for formulas, and tensors in tiles.
pub fn layer(outputs: usize, inputs: usize, tile: usize) -> (Vec<f32>, Vec<f32>, Layer) {
    let (weight, bias) = (noise(outputs * inputs, 12), noise(outputs, 13));
    let shape = [outputs / tile, inputs, tile];
    let on_device = Layer {
        weight: tensor("weight", &shape, &tiled(&weight, inputs, tile)),
        bias: tensor("bias", &[outputs], &bias),
    };
    (weight, bias, on_device)
}

/// Returns a random layer with one output, as in the heads.
pub fn head(inputs: usize) -> (Vec<f32>, f32, Layer) {
    let (weight, bias) = (noise(inputs, 14), 0.3);
    let on_device =
        Layer { weight: tensor("weight", &[inputs], &weight), bias: tensor("bias", &[1], &[bias]) };
    (weight, bias, on_device)
}

/// As [`head`], in one tensor, where the bias is not next to the weight.
pub fn joined_head(inputs: usize) -> (Vec<f32>, f32, JoinedLayer) {
    let (weight, bias) = (noise(inputs, 14), 0.3);
    let both = [&weight[..], &[f32::NAN; 3], &[bias]].concat();
    let weight_and_bias = tensor("weight and bias", &[inputs + 4], &both);
    (weight, bias, JoinedLayer { weight_and_bias, bias: inputs + 3 })
}

/// Returns `weight x + bias` at every position, [S, O, n] from `x` [S, I, n].
pub fn dense(weight: &[f32], bias: &[f32], x: &[f32], n: usize) -> Vec<f64> {
    let (outputs, inputs) = (bias.len(), weight.len() / bias.len());
    let mut y = Vec::with_capacity(x.len() / inputs * outputs);
    for x in x.chunks_exact(inputs * n) {
        for (weight, &bias) in weight.chunks_exact(inputs).zip(bias) {
            let mut sum = vec![f64::from(bias); n];
            for (&w, x) in weight.iter().zip(x.chunks_exact(n)) {
                sum.iter_mut().zip(x).for_each(|(sum, &x)| *sum += f64::from(w) * f64::from(x));
            }
            y.extend(sum);
        }
    }
    y
}

/// Applies the activation if `gelu` is set.
pub fn activate(y: &mut [f64], gelu: bool) {
    if gelu {
        f64::gelu(y);
    }
}

/// Returns the cosine and sine of `2 pi k j / n`; k may be negative.
pub fn turn(k: i64, j: usize, n: usize) -> (f64, f64) {
    let theta = TAU * (k * j as i64).rem_euclid(n as i64) as f64 / n as f64;
    (theta.cos(), theta.sin())
}

/// Returns how often a kept column counts in the inverse: twice if it also stands for its conjugate.
pub fn copies(mode: usize, w: usize) -> f64 {
    if mode == 0 || 2 * mode == w { 1.0 } else { 2.0 }
}
