//! Host side of `shaders/operator/transform_columns.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{Tuning, groups, size};

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "transform_columns",
    wgsl: include_str!("../../../shaders/operator/transform_columns.wgsl"),
    common: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    rows: u32,
    modes_w: u32,
    pad: u32,
}

/// Columns of the truncated transform.
#[derive(Clone, Debug)]
pub struct TransformColumns {
    kernel: Kernel,
    modes_h: usize,
}

impl TransformColumns {
    /// Compiles it for `modes_h` kept rows.
    pub fn new(context: &Context, tuning: &Tuning, modes_h: usize) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, tuning.unroll(modes_h), &[])?, modes_h })
    }

    /// `table` [H, modes_h, 2], `r` [S, H, 2 modes_w, C], `spectrum` [S, modes_h, modes_w, C, 2].
    pub fn push(&self, schedule: &mut Schedule, table: &Tensor, r: &Tensor, spectrum: &Tensor) {
        let &[samples, h, columns, channels] = r.shape() else {
            panic!("transform_columns: {:?}", r.shape())
        };
        let modes_w = columns / 2;
        assert_eq!(table.shape(), [h, self.modes_h, 2]);
        assert_eq!(spectrum.shape(), [samples, self.modes_h, modes_w, channels, 2]);
        let params = Params { channels: size(channels), rows: size(h), modes_w: size(modes_w), pad: 0 };
        let count = [groups(channels, 64), size(modes_w), size(samples)];
        schedule.dispatch(&self.kernel, &params, &[table, r, spectrum], count);
    }
}
