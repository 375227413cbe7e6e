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

/// Positions of a row that pass through a hidden layer at a time. Their activations stay in the first-level
/// cache.
const SEGMENT: usize = 24;

/// Positions that pass through a hidden layer at a time in the backward pass. Sums over positions favour
/// longer segments, and this many fit into the second-level cache.
const ADJOINT_SEGMENT: usize = 96;

/// Approximate number of positions per task.
const BAND: usize = 256;

/// Returns the number of channels padded to whole registers.
fn padded(channels: usize) -> usize {
    channels.next_multiple_of(LANES)
}

/// Returns how many rows of a grid of width `w` one task processes.
fn band_rows(w: usize) -> usize {
    (BAND / w).max(1)
}
