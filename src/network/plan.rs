//! The plan of a forward pass, and what its blocks compute.
//!
//! One set of kernels serves a single cloth, which waits for dispatches, and large batches, which wait for
//! memory and arithmetic. What a pass consists of follows from grid, samples, the device's limits and the
//! [`Tuning`], which [`crate::gpu::Context::with_tuning`] overrides:
//!
//! - If a row of all channels fits the workgroup memory and [`Tuning::rows_in_blocks`] is set, the lifting and
//!   the blocks transform their rows and reduce their maxima on the way: 11 dispatches per iteration. Else
//!   these are dispatches of their own, and rows may have any length.
//! - A spectral convolution has one workgroup per kept column and tile of samples, and is divided by output
//!   channels until there are [`Tuning::busy_groups`] of them: one cloth repeats some column transforms to fill
//!   the device, a batch that fills it repeats none.
//! - From [`Tuning::BATCH`] cloths in a pass on, an invocation of a block takes [`Tuning::block_lines`] rows, so that a workgroup reads
//!   weights once for all of them. Fewer cloths fill the device better with a row each.
//! - Samples whose activations exceed [`Tuning::activation_bytes`], or what the device binds, take turns in
//!   passes of nearly equal length ([`Plan::fit_passes`]).

use super::{Config, Layout};
use crate::cloth::Grid;
use crate::gpu::{Context, Tuning, WORKGROUPS};
use crate::kernels::operator::{Block, Epilogue, LayerSize, SpectralSize};
use crate::kernels::{CHANNEL_MULTIPLE, padded};

/// What a network on a device is built for.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Grid of a sample.
    pub grid: Grid,
    /// Samples per pass (S), three for each cloth.
    pub samples: usize,
    /// Tile sizes.
    pub tuning: Tuning,
    /// Activations to keep.
    pub keep: Keep,
}

/// Activations to keep after a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// None: two buffers alternate.
    Nothing,
    /// Every block's output, for checks.
    Blocks,
    /// Every block's output, pre-activations and modes, for the backward pass ([`super::Backward`]).
    Adjoint,
}

impl Plan {
    /// Returns a plan with as many samples per pass as fit: within the tuning's limit on activations and
    /// within what the device can bind and dispatch. A batch is divided into passes of nearly equal length,
    /// of whole cloths or, if no cloth fits, of single samples.
    pub fn fit_passes(&self, context: &Context, config: Config) -> Self {
        let layout = Layout::new(config, self.tuning.channels);
        let widest = layout.padded().channels.max(layout.padded().projection);
        let bound = self.tuning.most_samples(context, widest * self.grid.h * padded(self.grid.w));
        // A workgroup of a block covers this many channels, and their axis of a dispatch is limited to
        // `WORKGROUPS`.
        let covered = widest.min(layout.tile() * self.tuning.block_deep as usize);
        let dispatched = WORKGROUPS as usize * covered / widest;
        let cloths = bound.min(dispatched) / 3;
        let samples = match cloths {
            0 => 1,
            _ => self.samples.div_ceil(self.samples.div_ceil(3 * cloths).max(1)).next_multiple_of(3),
        };
        Self { samples, ..*self }
    }

    /// Returns the most rows per invocation of a block.
    pub(super) fn block_lines(&self) -> u32 {
        if self.samples < 3 * Tuning::BATCH { 1 } else { self.tuning.block_lines }
    }

    /// Returns the layout of the weights of a network for this plan: in tiles of the tuning's channels, or of
    /// at most [`CHANNEL_MULTIPLE`] if rows fit a workgroup only then.
    pub(super) fn layout(&self, context: &Context, config: Config) -> Layout {
        let takes_rows = |layout: &Layout| {
            let tuning = Tuning { channels: layout.tile(), ..self.tuning };
            Block::takes_rows(context, &tuning, &block_size(&layout.padded(), self.grid))
        };
        let wide = Layout::new(config, self.tuning.channels);
        if wide.tile() > CHANNEL_MULTIPLE && !takes_rows(&wide) {
            let narrow = Layout::new(config, CHANNEL_MULTIPLE);
            if takes_rows(&narrow) {
                return narrow;
            }
        }
        wide
    }
}

/// Returns the sizes of a network's blocks.
pub(super) fn block_size(config: &Config, grid: Grid) -> LayerSize {
    let &Config { modes_w, channels, .. } = config;
    LayerSize { row_quads: padded(grid.w) / 4, modes_w, channels, lifting: None }
}

/// Returns the sizes of a network's spectral convolutions.
pub(super) fn spectral_size(config: &Config) -> SpectralSize {
    let &Config { modes_h, modes_w, channels, .. } = config;
    SpectralSize { modes_h, modes_w, channels }
}

/// Returns what a block of the network computes besides the linear part of its output.
pub(super) fn epilogue(
    config: &Config,
    block: usize,
    keep: Keep,
    fuses_field_head: bool,
    rows_in_blocks: bool,
) -> Epilogue {
    let last = block + 1 == config.layers;
    Epilogue {
        gelu: if last { fuses_field_head } else { keep != Keep::Adjoint },
        field: last && fuses_field_head,
        rows: rows_in_blocks && !last,
        pool: rows_in_blocks && block == config.scalar_block(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterKind, Sharing};

    #[test]
    fn only_batches_have_several_rows_in_an_invocation() {
        let tuning = Tuning::of(AdapterKind::Hardware, Sharing::Loads);
        let of_cloths = |cloths: usize| {
            let plan = Plan { grid: Grid { h: 32, w: 32 }, samples: 3 * cloths, tuning, keep: Keep::Nothing };
            plan.block_lines()
        };
        assert_eq!([1, 15, 16, 256].map(of_cloths), [1, 1, 2, 2]);
    }
}
