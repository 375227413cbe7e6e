//! Host side of `shaders/cloth/cell_fill.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "cell_fill",
    wgsl: include_str!("../../../shaders/cloth/cell_fill.wgsl"),
    appended: &[pieces::BUCKET],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    buckets: u32,
}

/// Lists the particles of each bucket.
#[derive(Clone, Debug)]
pub struct CellFill {
    kernel: Kernel,
}

impl CellFill {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `numbers` [B, n] from `ends` [B, buckets], `placed` [B, n, 4] and `in_bucket` [B, n].
    pub fn push(&self, schedule: &mut Schedule, [ends, placed, in_bucket]: [&Tensor; 3], numbers: &Tensor) {
        let (&[batch, buckets], &[_, n]) = (ends.shape(), numbers.shape()) else {
            panic!("cell_fill: {:?}, {:?}", ends.shape(), numbers.shape())
        };
        assert_eq!((placed.shape(), in_bucket.shape()), (&[batch, n, 4][..], &[batch, n][..]));
        let params = Params { particles: size(n), buckets: size(buckets) };
        let tensors = [ends, placed, in_bucket, numbers];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, batch));
    }
}
