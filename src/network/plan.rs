//! What the forward pass is made for, and what its blocks do there.

use super::{Config, Layout};
use crate::gpu::{Context, WORKGROUPS};
use crate::kernels::operator::{Block, Epilogue, LayerSize};
use crate::kernels::{CHANNEL_MULTIPLE, Tuning, padded};
use crate::sim::Grid;

/// What a network on a device is made for.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Particles of a sample.
    pub grid: Grid,
    /// Samples of a pass (S), three to a cloth.
    pub samples: usize,
    /// Tile sizes.
    pub tuning: Tuning,
    /// What is kept of the activations.
    pub keep: Keep,
}

/// What is kept of the activations between the layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// Two buffers in turn.
    Nothing,
    /// Every block's output, for checks.
    Blocks,
    /// Every block's output, what is before its GELU, and its modes: for the backward pass ([`super::Backward`]).
    Adjoint,
}

impl Plan {
    /// The same for as many samples in turn as activations no larger than the tuning wants, and the device binds and dispatches, are of: whole
    /// cloths in turns of nearly one length, or single samples where no cloth fits.
    pub fn in_turns(&self, context: &Context, config: Config) -> Self {
        let layout = Layout::new(config, self.tuning.channels);
        let widest = layout.padded().channels.max(layout.padded().projection);
        let bound = self.tuning.most_samples(context, widest * self.grid.h * padded(self.grid.w));
        // A workgroup of a block has so many channels, and only so many workgroups go along its dimension of a dispatch.
        let dispatched = WORKGROUPS as usize * layout.tile() * self.tuning.block_deep as usize / widest;
        let cloths = bound.min(dispatched) / 3;
        let samples = match cloths {
            0 => 1,
            _ => self.samples.div_ceil(self.samples.div_ceil(3 * cloths).max(1)).next_multiple_of(3),
        };
        Self { samples, ..*self }
    }

    /// Where the weights of such a network lie for it: in tiles of the tuning's channels, or of no more than [`CHANNEL_MULTIPLE`]
    /// where rows fit a workgroup only then.
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

/// Sizes of the blocks of a network.
pub(super) fn block_size(config: &Config, grid: Grid) -> LayerSize {
    let &Config { modes_w, channels, .. } = config;
    LayerSize { row_quads: padded(grid.w) / 4, modes_w, channels, lifting: None }
}

/// What a block of the network does beside the linear part of its output.
pub(super) fn epilogue(
    config: &Config,
    block: usize,
    keep: Keep,
    joins_head: bool,
    rows_in_blocks: bool,
) -> Epilogue {
    let last = block + 1 == config.layers;
    Epilogue {
        gelu: if last { joins_head } else { keep != Keep::Adjoint },
        field: last && joins_head,
        rows: rows_in_blocks && !last,
        pool: rows_in_blocks && block == config.scalar_block(),
    }
}
