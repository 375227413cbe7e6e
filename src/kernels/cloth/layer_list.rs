//! Host side of `shaders/cloth/layer_list.wgsl`.

use super::Pairs;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "layer_list",
    wgsl: include_str!("../../../shaders/cloth/layer_list.wgsl"),
    appended: &[terms::CONTACT, pieces::BUCKET, pieces::PAIR, pieces::PAIRS_OF],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    buckets: u32,
    room: u32,
}

/// Lists the pairs of each particle.
#[derive(Clone, Debug)]
pub struct LayerList {
    kernel: Kernel,
}

impl LayerList {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets the lists of `pairs`, which end where its `list_ends` say, and increases `counts` [B, buckets] from 0 to their
    /// lengths.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, pairs: &Pairs, counts: &Tensor) {
        let &[batch, buckets] = counts.shape() else { panic!("layer_list: {:?}", counts.shape()) };
        let params = Params { buckets: size(buckets), room: size(pairs.room()) };
        let Pairs { ends, pairs, list_ends, lists, .. } = pairs;
        let tensors = [ends, pairs, list_ends, counts, lists];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(grid.particles(), batch));
    }
}
