//! Trigonometric tables of the truncated transforms, computed in double precision.
//!
//! Devices disagree on sines and cosines by up to 2e-4, so no shader evaluates them.

use super::Config;
use std::f64::consts::TAU;

/// `2 pi k n / size` with the product reduced first, so that large ones lose nothing.
fn angle(k: i64, n: usize, size: usize) -> f64 {
    let reduced = (k * n as i64).rem_euclid(size as i64);
    TAU * reduced as f64 / size as f64
}

/// Column `k` of a transform of rows of width `w` at place `j`: the cosine of mode `k / 2`, or minus its sine.
fn row_wave(k: usize, j: usize, w: usize) -> f64 {
    let theta = angle((k / 2) as i64, j, w);
    if k.is_multiple_of(2) { theta.cos() } else { -theta.sin() }
}

/// Row transform: shape [W' / 4, 2 modes_w, 4]; cos and -sin, divided by `h w`, zero beyond column `w`.
pub fn forward_rows(config: &Config, h: usize, w: usize) -> Vec<f32> {
    by_quads(config, w, |j, k| row_wave(k, j, w) / (h * w) as f64)
}

/// The adjoint of the inverse row transform, taken like a row transform: its table in that order.
pub fn inverse_rows_adj(config: &Config, w: usize) -> Vec<f32> {
    by_quads(config, w, |j, k| inverse_wave(k, j, w))
}

/// Inverse row transform: shape [2 modes_w, W']; f cos and -f sin, where f counts the conjugate column unless a column
/// is its own (column 0, and the Nyquist column of an even width); zero beyond column `w`.
pub fn inverse_rows(config: &Config, w: usize) -> Vec<f32> {
    by_columns(config, w, |j, k| inverse_wave(k, j, w))
}

/// The adjoint of the row transform, taken like an inverse row transform: its table in that order.
pub fn forward_rows_adj(config: &Config, h: usize, w: usize) -> Vec<f32> {
    by_columns(config, w, |j, k| row_wave(k, j, w) / (h * w) as f64)
}

/// Column `k` of an inverse transform of rows of width `w` at place `j`.
fn inverse_wave(k: usize, j: usize, w: usize) -> f64 {
    let mode = k / 2;
    let f = if mode == 0 || 2 * mode == w { 1.0 } else { 2.0 };
    f * row_wave(k, j, w)
}

/// Values at place j of column k, shape [W' / 4, 2 modes_w, 4].
fn by_quads(config: &Config, w: usize, value: impl Fn(usize, usize) -> f64) -> Vec<f32> {
    let columns = 2 * config.modes_w;
    let places =
        (0..w.div_ceil(4)).flat_map(|q| (0..columns).flat_map(move |k| (0..4).map(move |e| (4 * q + e, k))));
    places.map(|(j, k)| if j < w { value(j, k) as f32 } else { 0.0 }).collect()
}

/// Values at place j of column k, shape [2 modes_w, W'].
fn by_columns(config: &Config, w: usize, value: impl Fn(usize, usize) -> f64) -> Vec<f32> {
    let places = (0..2 * config.modes_w).flat_map(|k| (0..w.next_multiple_of(4)).map(move |j| (j, k)));
    places.map(|(j, k)| if j < w { value(j, k) as f32 } else { 0.0 }).collect()
}

/// Column transform and its inverse: shape [H, modes_h / 2 + 1, 2]; cosine and sine of `2 pi k i / H` for each magnitude k of
/// the kept rows of modes.
pub fn columns(config: &Config, h: usize) -> Vec<f32> {
    let places = (0..h).flat_map(|i| (0..=config.modes_h / 2).map(move |k| angle(k as i64, i, h)));
    places.flat_map(|theta| [theta.cos() as f32, theta.sin() as f32]).collect()
}
