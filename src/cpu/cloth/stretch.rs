//! How far the edges are from their rest length.

use super::vector::{at, length, sub};
use crate::cpu::Real;
use crate::sim::Grid;

/// The largest `|e| - 1` and the mean of `| |e| - 1 |` over the edges of one cloth, positions `x` [3, H, W] in grid units.
pub fn stretch<T: Real>(grid: Grid, x: &[T]) -> (f64, f64) {
    let Grid { h, w } = grid;
    let n = h * w;
    let (mut largest, mut sum) = (f64::NEG_INFINITY, 0.0);
    let mut count = |p: usize, q: usize| {
        let excess = (length(sub(at(x, n, q), at(x, n, p))) - T::one()).f64();
        // A maximum swallows a NaN; the sum keeps it.
        largest = largest.max(excess);
        sum += excess.abs();
    };
    for p in 0..n {
        if p + w < n {
            count(p, p + w);
        }
        if p % w + 1 < w {
            count(p, p + 1);
        }
    }
    (largest, sum / ((h - 1) * w + h * (w - 1)) as f64)
}
