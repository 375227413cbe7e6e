//! The Fourier neural operator on the CPU (paper section 4), one file per stage.
//!
//! Activations are stored as [S, H, W, C], channels innermost and padded to whole registers: every stage is then a
//! product of small matrices whose columns are channels, and no grid size needs padding. A sample (S of them) is one
//! component of one cloth.

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

/// Positions of a row that pass through a hidden layer at a time: its activations then stay in the first-level cache.
const SEGMENT: usize = 24;

/// Positions that pass through a hidden layer at a time on the way back: a sum over positions wants to be longer, and the
/// second-level cache holds this many.
const ADJOINT_SEGMENT: usize = 96;

/// Positions of the rows that one task processes, about.
const BAND: usize = 256;

/// A number of channels padded to whole registers.
fn padded(channels: usize) -> usize {
    channels.next_multiple_of(LANES)
}

/// Rows of a grid of this width that one task processes.
fn band_rows(w: usize) -> usize {
    (BAND / w).max(1)
}
