//! Host side of `shaders/cloth/layer_order.wgsl`.

use super::Pairs;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "layer_order",
    wgsl: include_str!("../../../shaders/cloth/layer_order.wgsl"),
    appended: &[pieces::BUCKET],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    buckets: u32,
    room: u32,
}

/// Sorts the pairs of each particle.
#[derive(Clone, Debug)]
pub struct LayerOrder {
    kernel: Kernel,
}

impl LayerOrder {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sorts the lists of `pairs`, and sets `counts` [B, buckets] to 0.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, pairs: &Pairs, counts: &Tensor) {
        let &[batch, buckets] = counts.shape() else { panic!("layer_order: {:?}", counts.shape()) };
        let n = grid.particles();
        let params = Params { particles: size(n), buckets: size(buckets), room: size(pairs.room()) };
        let tensors = [&pairs.list_ends, counts, &pairs.lists];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, batch));
    }
}
