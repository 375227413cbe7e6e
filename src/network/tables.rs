//! Trigonometric tables of the truncated transforms, computed in double precision.
//!
//! Devices disagree on sines and cosines by up to 2e-4, so no shader evaluates them.

use super::Config;
use std::f64::consts::TAU;

/// Returns `2 pi k n / size`, with the product reduced first so that large ones lose no precision.
fn angle(k: i64, n: usize, size: usize) -> f64 {
    let reduced = (k * n as i64).rem_euclid(size as i64);
    TAU * reduced as f64 / size as f64
}

/// Returns column `k` of the transform of rows of width `w` at position `j`: the cosine of mode `k / 2`, or
/// minus its sine.
fn row_wave(k: usize, j: usize, w: usize) -> f64 {
    let theta = angle((k / 2) as i64, j, w);
    if k.is_multiple_of(2) { theta.cos() } else { -theta.sin() }
}

/// Returns the table of the row transform, shape [W' / 4, 2 modes_w, 4]: cos and -sin, divided by `h w`; zero
/// beyond column `w`.
pub fn forward_rows(config: &Config, h: usize, w: usize) -> Vec<f32> {
    by_quads(config, w, |j, k| row_wave(k, j, w) / (h * w) as f64)
}

/// Returns the table of the inverse row transform's adjoint, in the order of a row transform's table.
pub fn inverse_rows_adj(config: &Config, w: usize) -> Vec<f32> {
    by_quads(config, w, |j, k| inverse_wave(k, j, w))
}

/// Returns the table of the inverse row transform, shape [2 modes_w, W']: f cos and -f sin, zero beyond
/// column `w`. The factor f is 2, to account for the conjugate column, or 1 for a column that is its own
/// conjugate (column 0, and the Nyquist column of an even width).
pub fn inverse_rows(config: &Config, w: usize) -> Vec<f32> {
    by_columns(config, w, |j, k| inverse_wave(k, j, w))
}

/// Returns the table of the row transform's adjoint, in the order of an inverse row transform's table.
pub fn forward_rows_adj(config: &Config, h: usize, w: usize) -> Vec<f32> {
    by_columns(config, w, |j, k| row_wave(k, j, w) / (h * w) as f64)
}

/// Returns column `k` of the inverse transform of rows of width `w` at position `j`.
fn inverse_wave(k: usize, j: usize, w: usize) -> f64 {
    let mode = k / 2;
    let f = if mode == 0 || 2 * mode == w { 1.0 } else { 2.0 };
    f * row_wave(k, j, w)
}

/// Tabulates values at position j of column k, shape [W' / 4, 2 modes_w, 4].
fn by_quads(config: &Config, w: usize, value: impl Fn(usize, usize) -> f64) -> Vec<f32> {
    let columns = 2 * config.modes_w;
    let places =
        (0..w.div_ceil(4)).flat_map(|q| (0..columns).flat_map(move |k| (0..4).map(move |e| (4 * q + e, k))));
    places.map(|(j, k)| if j < w { value(j, k) as f32 } else { 0.0 }).collect()
}

/// Tabulates values at position j of column k, shape [2 modes_w, W'].
fn by_columns(config: &Config, w: usize, value: impl Fn(usize, usize) -> f64) -> Vec<f32> {
    let places = (0..2 * config.modes_w).flat_map(|k| (0..w.next_multiple_of(4)).map(move |j| (j, k)));
    places.map(|(j, k)| if j < w { value(j, k) as f32 } else { 0.0 }).collect()
}

/// Returns the table of the column transform and its inverse, shape [H, modes_h / 2 + 1, 2]: cosine and sine
/// of `2 pi k i / H` for each magnitude k of the kept rows of modes.
pub fn columns(config: &Config, h: usize) -> Vec<f32> {
    let places = (0..h).flat_map(|i| (0..=config.modes_h / 2).map(move |k| angle(k as i64, i, h)));
    places.flat_map(|theta| [theta.cos() as f32, theta.sin() as f32]).collect()
}
