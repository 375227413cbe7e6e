//! The Fourier neural operator on the CPU (paper section 4), one file per stage.
//!
//! Activations are stored as [S, H, W, C], channels innermost and padded to whole registers. Every stage is
//! then a product of small matrices whose columns are channels, and no grid size needs padding. A sample (S
//! of them) is one component of one cloth.

mod adjoint;
mod block;
mod lifting;
mod network;
mod pointwise;
mod projection;
mod scalar_head;
mod spectral;
mod transform;

pub use adjoint::{Adjoint, LaidOut};
pub use network::{Network, Stage};
pub use spectral::Spectral;
pub use transform::Transform;

use super::matmul::LANES;
use crate::cloth::Grid;

/// Positions of a row that pass through a hidden layer at a time. Their activations stay in the first-level
/// cache.
const SEGMENT: usize = 24;

/// Positions that pass through a hidden layer at a time in the backward pass. Sums over positions favour
/// longer segments, and this many fit into the second-level cache.
const ADJOINT_SEGMENT: usize = 96;

/// Largest number of positions per task, approximately.
const BAND: usize = 256;

/// Tasks per thread, at least: few samples on many threads are divided into smaller tasks.
const TASKS: usize = 2;

/// Samples pass through the network in groups of about this many positions, whose activations stay in the
/// last-level cache.
const PASS: usize = 12 << 10;

/// Returns the number of channels padded to whole registers.
fn padded(channels: usize) -> usize {
    channels.next_multiple_of(LANES)
}

/// Returns how many rows of a grid of width `w` are processed at a time.
fn band_rows(w: usize) -> usize {
    (BAND / w).max(1)
}

/// Returns how many rows one task of a forward pass processes. Rows do not depend on each other, so neither do
/// the bits on the number of threads.
fn task_rows(grid: Grid, samples: usize) -> usize {
    let tasks = TASKS * rayon::current_num_threads();
    (samples * grid.h).div_ceil(tasks).min(band_rows(grid.w))
}

/// Returns how many numbers the activations of a pass have ([`Network`]).
pub(super) fn activations_len(channels: usize, grid: Grid, samples: usize) -> usize {
    2 * samples_per_pass(grid, samples) * padded(channels) * grid.particles()
}

/// Returns how many of `samples` samples pass through the network at a time: a divisor of their number, of about
/// [`PASS`] positions or, on many threads, as many as make tasks of full size for each. The three samples of a
/// cloth stay together unless they are so large that it hardly matters how often the spectral product reads its
/// weights.
pub(crate) fn samples_per_pass(grid: Grid, samples: usize) -> usize {
    let rows = TASKS * rayon::current_num_threads() * band_rows(grid.w);
    let least = if grid.particles() > PASS { 1 } else { 3 };
    let most = (PASS / grid.particles()).max(rows.div_ceil(grid.h)).max(least);
    (1..=samples.min(most)).rev().find(|&some| samples.is_multiple_of(some)).unwrap_or(1)
}
