//! The deviation of the edges from their rest length.

use super::Trial;
use super::vector::length;
use crate::cloth::Grid;
use crate::cpu::Real;

/// Returns the largest `|e| - 1` and the mean of `| |e| - 1 |` over the edges of one cloth.
pub fn stretch<T: Real>(trial: &Trial<'_, T>) -> (f64, f64) {
    let Grid { h, w } = trial.grid;
    let (mut largest, mut sum) = (f64::NEG_INFINITY, 0.0);
    let mut count = |edge: [T; 3]| {
        let excess = (length(edge) - T::one()).f64();
        // A maximum swallows a NaN; the sum keeps it.
        largest = largest.max(excess);
        sum += excess.abs();
    };
    for i in 0..h {
        for j in 0..w {
            if i + 1 < h {
                count(trial.vertical(i, j));
            }
            if j + 1 < w {
                count(trial.horizontal(i, j));
            }
        }
    }
    (largest, sum / ((h - 1) * w + h * (w - 1)) as f64)
}
