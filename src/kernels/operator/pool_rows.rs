//! Host side of `shaders/operator/pool_rows.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{padded, size};

pub(crate) const SOURCE: Source = Source {
    name: "pool_rows",
    wgsl: include_str!("../../../shaders/operator/pool_rows.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    rows: u32,
    row_quads: u32,
    columns: u32,
}

/// Computes the largest value of each row.
#[derive(Clone, Debug)]
pub struct PoolRows {
    kernel: Kernel,
}

impl PoolRows {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `rows_max` [S, H, C] from the first `columns` columns of `x` [S, H, C, W'].
    pub fn push(&self, schedule: &mut Schedule, columns: usize, x: &Tensor, rows_max: &Tensor) {
        let &[samples, h, channels, w] = x.shape() else { panic!("pool_rows: {:?}", x.shape()) };
        assert_eq!(rows_max.shape(), [samples, h, channels]);
        assert_eq!(padded(columns), w);
        let params = Params {
            channels: size(channels),
            rows: size(h),
            row_quads: size(w / 4),
            columns: size(columns),
        };
        let count = self.kernel.groups([channels, h, samples]);
        schedule.dispatch(&self.kernel, &params, &[x, rows_max], count);
    }
}
