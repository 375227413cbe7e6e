//! Host side of `shaders/operator/block.wgsl`.

use super::Layer;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Sharing, Source, Tensor, Unroll};
use crate::kernels::{Tuning, common, groups, padded, size};

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
    width: u32,
    pad: [u32; 3],
}

/// What a block does beside the linear part of its output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct After {
    /// The activation.
    pub gelu: bool,
    /// The row transform of the output, for the next block.
    pub rows: bool,
    /// The largest value of each row of the output, for the scalar head.
    pub pool: bool,
}

/// A Fourier block after its columns: inverse rows, skip, bias, activation, and what the next kernels want of its rows.
#[derive(Clone, Debug)]
pub struct Block {
    kernel: Kernel,
    tile: usize,
    workgroup: [u32; 2],
    row_quads: usize,
    columns: usize,
    after: After,
    /// What is bound where nothing is made of the rows.
    nothing: [Tensor; 2],
}

/// Invocations of a block's workgroup along a row and over rows.
fn workgroup(tuning: &Tuning, row_quads: usize, whole_rows: bool) -> [u32; 2] {
    // In steps of the narrowest lanes there are.
    let row = size(row_quads).next_multiple_of(8);
    let (wide, high) = (tuning.block_wide.min(row), tuning.block_high);
    if whole_rows { [row, (wide * high / row).clamp(1, high)] } else { [wide, high] }
}

/// Quads of workgroup memory that the output of a workgroup takes, an odd number to each row.
fn held(tuning: &Tuning, row_quads: usize) -> usize {
    let [_, high] = workgroup(tuning, row_quads, true);
    high as usize * tuning.channels * (row_quads | 1)
}

impl Block {
    /// Whether a whole row of `row_quads` quads fits a workgroup, as [`After::rows`] and [`After::pool`] want it, and whether
    /// the tuning wants it there.
    pub fn takes_rows(context: &Context, tuning: &Tuning, row_quads: usize) -> bool {
        let limits = context.device.limits();
        let [wide, high] = workgroup(tuning, row_quads, true);
        let invocations =
            limits.max_compute_invocations_per_workgroup.min(limits.max_compute_workgroup_size_x);
        let bytes = 16 * held(tuning, row_quads);
        tuning.rows_in_blocks
            && wide * high <= invocations
            && bytes <= limits.max_compute_workgroup_storage_size as usize
    }

    /// Compiles it for rows of `row_quads` quads and `modes_w` kept columns.
    pub fn new(
        context: &Context,
        tuning: &Tuning,
        (row_quads, modes_w): (usize, usize),
        after: After,
    ) -> Result<Self> {
        assert!(
            tuning.sharing == Sharing::Loads || tuning.block_high == 1,
            "a subgroup shares operands within one row"
        );
        let (columns, whole_rows) = (2 * modes_w, after.rows || after.pool);
        let workgroup = workgroup(tuning, row_quads, whole_rows);
        let flag = |flag: bool| f64::from(u8::from(flag));
        let constants = [
            ("GELU", flag(after.gelu)),
            ("ROWS", flag(after.rows)),
            ("POOL", flag(after.pool)),
            ("WIDE", f64::from(workgroup[0])),
            ("HIGH", f64::from(workgroup[1])),
            ("HELD", if whole_rows { held(tuning, row_quads) as f64 } else { 1.0 }),
        ];
        // Where operands are broadcast, loads are dear, and a row is read once for all columns; else invocations share them.
        let second = if tuning.sharing == Sharing::Broadcast { columns } else { 2 };
        let unroll = Unroll { second, ..tuning.unroll(tuning.channels) };
        let kernel = Kernel::new(context, &SOURCE, unroll, &constants)?;
        let nothing = || Tensor::zeros(context, "nothing", &[1]);
        Ok(Self {
            kernel,
            tile: tuning.channels,
            workgroup,
            row_quads,
            columns,
            after,
            nothing: [nothing()?, nothing()?],
        })
    }

    /// What it does beside the linear part.
    pub fn after(&self) -> After {
        self.after
    }

    /// `skip.weight` [C / tile, C, tile]; `tables` [2 modes_w, W'], or [2, 2 modes_w, W'] with the row transform's table
    /// [W' / 4, 2 modes_w, 4] behind it if that is what comes after; `width` is the number of columns of the grid.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        skip: &Layer,
        (tables, width): (&Tensor, usize),
        tensors: BlockTensors<'_>,
    ) {
        let BlockTensors { x, r, y, rows, rows_max } = tensors;
        let &[samples, channels, h, w] = x.shape() else { panic!("block: {:?}", x.shape()) };
        let &[_, _, columns, _] = r.shape() else { panic!("block: {:?}", r.shape()) };
        assert_eq!((w / 4, columns, padded(width)), (self.row_quads, self.columns, w));
        assert_eq!(y.shape(), x.shape());
        assert_eq!(r.shape(), [samples, h, columns, channels]);
        assert!(tables.len() >= columns * w * if self.after.rows { 2 } else { 1 });
        assert_eq!(skip.weight.shape(), [channels / self.tile, channels, self.tile]);
        assert_eq!(skip.bias.len(), channels);
        assert_eq!((rows.is_some(), rows_max.is_some()), (self.after.rows, self.after.pool));
        assert!(rows.is_none_or(|rows| rows.shape() == r.shape()));
        assert!(rows_max.is_none_or(|most| most.shape() == [samples, h, channels]));
        let params = Params {
            channels: size(channels),
            rows: size(h),
            row_quads: size(w / 4),
            columns: size(columns),
            width: size(width),
            pad: [0; 3],
        };
        let tiles = samples * channels / self.tile;
        let count = [groups(w / 4, self.workgroup[0]), groups(h, self.workgroup[1]), size(tiles)];
        let [no_rows, no_maxima] = &self.nothing;
        let (rows, rows_max) = (rows.unwrap_or(no_rows), rows_max.unwrap_or(no_maxima));
        let tensors = [&skip.weight, &skip.bias, tables, x, r, y, rows, rows_max];
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
    /// Rows' spectra of the output, shape [S, H, 2 modes_w, C]; given if and only if they are wanted.
    pub rows: Option<&'a Tensor>,
    /// Largest values of the output's rows, shape [S, H, C]; given if and only if they are wanted.
    pub rows_max: Option<&'a Tensor>,
}
