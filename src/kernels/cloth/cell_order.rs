//! Host side of `shaders/cloth/cell_order.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "cell_order",
    wgsl: include_str!("../../../shaders/cloth/cell_order.wgsl"),
    appended: &[pieces::BUCKET],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    buckets: u32,
}

/// Sorts the particles of each bucket by number.
#[derive(Clone, Debug)]
pub struct CellOrder {
    kernel: Kernel,
}

impl CellOrder {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `sorted` [B, n, 4] from `ends` [B, buckets], `placed` [B, n, 4], `in_bucket` and `numbers`
    /// [B, n].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        [ends, placed, in_bucket, numbers]: [&Tensor; 4],
        sorted: &Tensor,
    ) {
        let (&[batch, buckets], &[_, n]) = (ends.shape(), numbers.shape()) else {
            panic!("cell_order: {:?}, {:?}", ends.shape(), numbers.shape())
        };
        assert_eq!([placed, sorted].map(Tensor::shape), [[batch, n, 4]; 2]);
        assert_eq!(in_bucket.shape(), numbers.shape());
        let params = Params { particles: size(n), buckets: size(buckets) };
        let tensors = [ends, placed, in_bucket, numbers, sorted];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, batch));
    }
}
