//! Host side of `shaders/operator/transform_rows.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor, Tuning};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "transform_rows",
    wgsl: include_str!("../../../shaders/operator/transform_rows.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    rows: u32,
    row_quads: u32,
}

/// Row part of the truncated transform.
#[derive(Clone, Debug)]
pub struct TransformRows {
    kernel: Kernel,
    columns: usize,
}

impl TransformRows {
    /// Builds the kernel for `modes_w` kept columns.
    pub fn new(context: &Context, tuning: &Tuning, modes_w: usize) -> Result<Self> {
        let columns = 2 * modes_w;
        Ok(Self { kernel: Kernel::new(context, &SOURCE, tuning.unroll(columns), &[])?, columns })
    }

    /// Computes `r` [S, H, 2 modes_w, C] from `x` [S, H, C, W'] with `table` [W' / 4, 2 modes_w, 4].
    pub fn push(&self, schedule: &mut Schedule, table: &Tensor, x: &Tensor, r: &Tensor) {
        let &[samples, h, channels, w] = x.shape() else { panic!("transform_rows: {:?}", x.shape()) };
        assert_eq!(table.shape(), [w / 4, self.columns, 4]);
        assert_eq!(r.shape(), [samples, h, self.columns, channels]);
        let params = Params { channels: size(channels), rows: size(h), row_quads: size(w / 4) };
        let count = self.kernel.groups([channels, h, samples]);
        schedule.dispatch(&self.kernel, &params, &[table, x, r], count);
    }
}
