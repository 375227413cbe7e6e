//! Host side of `shaders/cloth/cell_fill.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size};

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "cell_fill",
    wgsl: include_str!("../../../shaders/cloth/cell_fill.wgsl"),
    appended: &[common::CLOTH, common::CELL, pieces::BUCKET],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    buckets: u32,
    pad: [u32; 2],
}

/// The particles of each bucket.
#[derive(Clone, Debug)]
pub struct CellFill {
    kernel: Kernel,
}

impl CellFill {
    /// Makes it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// `numbers` [B, n] from `ends` [B, buckets] and `placed` [B, n, 4].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        cloths: &Tensor,
        (ends, placed): (&Tensor, &Tensor),
        numbers: &Tensor,
    ) {
        let (&[batch, buckets], &[_, n]) = (ends.shape(), numbers.shape()) else {
            panic!("cell_fill: {:?}, {:?}", ends.shape(), numbers.shape())
        };
        assert_eq!(placed.shape(), [batch, n, 4]);
        let params = Params { particles: size(n), buckets: size(buckets), pad: [0; 2] };
        let tensors = [cloths, ends, placed, numbers];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, batch));
    }
}
