//! Host side of `shaders/operator/block.wgsl`.

use super::Layer;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Sharing, Source, Tensor};
use crate::kernels::{Tuning, common, groups, size};

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "block",
    wgsl: include_str!("../../../shaders/operator/block.wgsl"),
    common: &[common::GELU],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    rows: u32,
    row_quads: u32,
    columns: u32,
}

/// A Fourier block after its columns: inverse rows, skip, bias and activation.
#[derive(Clone, Debug)]
pub struct Block {
    kernel: Kernel,
    tile: usize,
    workgroup: [u32; 2],
}

impl Block {
    /// Compiles it for rows of `row_quads` quads, with GELU after it or without.
    pub fn new(context: &Context, tuning: &Tuning, row_quads: usize, gelu: bool) -> Result<Self> {
        assert!(
            tuning.sharing == Sharing::Loads || tuning.block_high == 1,
            "a subgroup shares operands within one row"
        );
        // No wider than a row, in steps of the narrowest lanes there are.
        let wide = tuning.block_wide.min(size(row_quads).next_multiple_of(8));
        let workgroup = [wide, tuning.block_high];
        let constants = [
            ("GELU", f64::from(u8::from(gelu))),
            ("WIDE", f64::from(wide)),
            ("HIGH", f64::from(tuning.block_high)),
        ];
        let kernel = Kernel::new(context, &SOURCE, tuning.unroll(tuning.channels), &constants)?;
        Ok(Self { kernel, tile: tuning.channels, workgroup })
    }

    /// `skip.weight` [C / tile, C, tile], `table` [2 modes_w, W'], `r` [S, H, 2 modes_w, C], `x` and `y` [S, C, H, W'].
    pub fn push(&self, schedule: &mut Schedule, skip: &Layer, table: &Tensor, tensors: BlockTensors<'_>) {
        let BlockTensors { x, r, y } = tensors;
        let &[samples, channels, h, w] = x.shape() else { panic!("block: {:?}", x.shape()) };
        let &[_, _, columns, _] = r.shape() else { panic!("block: {:?}", r.shape()) };
        assert_eq!(y.shape(), x.shape());
        assert_eq!(r.shape(), [samples, h, columns, channels]);
        assert_eq!(table.shape(), [columns, w]);
        assert_eq!(skip.weight.shape(), [channels / self.tile, channels, self.tile]);
        assert_eq!(skip.bias.len(), channels);
        let params = Params {
            channels: size(channels),
            rows: size(h),
            row_quads: size(w / 4),
            columns: size(columns),
        };
        let tiles = samples * channels / self.tile;
        let count = [groups(w / 4, self.workgroup[0]), groups(h, self.workgroup[1]), size(tiles)];
        let tensors = [&skip.weight, &skip.bias, table, x, r, y];
        schedule.dispatch(&self.kernel, &params, &tensors, count);
    }
}

/// What a block reads and writes.
#[derive(Clone, Copy, Debug)]
pub struct BlockTensors<'a> {
    /// Input, shape [S, C, H, W'].
    pub x: &'a Tensor,
    /// Inverse columns of the spectral product, shape [S, H, 2 modes_w, C].
    pub r: &'a Tensor,
    /// Output, shape [S, C, H, W'].
    pub y: &'a Tensor,
}
