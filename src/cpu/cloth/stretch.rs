//! The deviation of the edges from their rest length.

use super::Trial;
use super::vector::length;
use crate::cloth::Grid;
use crate::cpu::Real;

/// Returns the largest `|e| - 1` and the mean of `| |e| - 1 |` over the edges of one cloth.
pub fn stretch<T: Real>(trial: &Trial<'_, T>) -> (f64, f64) {
    let Grid { h, w } = trial.grid;
    let (mut largest, mut sum, mut edges) = (f64::NEG_INFINITY, 0.0, 0);
    let mut count = |p: usize, q: usize| {
        if trial.marks[p].is_outside() || trial.marks[q].is_outside() {
            return;
        }
        let excess = (length(trial.edge(p, q)) - T::one()).f64();
        // A maximum swallows a NaN; the sum keeps it.
        largest = largest.max(excess);
        sum += excess.abs();
        edges += 1;
    };
    for i in 0..h {
        for j in 0..w {
            if i + 1 < h {
                count(i * w + j, (i + 1) * w + j);
            }
            if j + 1 < w {
                count(i * w + j, i * w + j + 1);
            }
        }
    }
    (largest, sum / f64::from(edges))
}
