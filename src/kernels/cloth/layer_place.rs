//! Host side of `shaders/cloth/layer_place.wgsl`.

use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "layer_place",
    wgsl: include_str!("../../../shaders/cloth/layer_place.wgsl"),
    appended: &[common::CELL, pieces::PATCH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    buckets: u32,
}

/// Counts the patches of a cloth in each bucket of cells.
#[derive(Clone, Debug)]
pub struct LayerPlace {
    kernel: Kernel,
}

impl LayerPlace {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Adds the patches, from `motion` [B, n, 8] and `extents` [B, 4], to `counts` [B, buckets], and sets `placed`
    /// [B, n, 4] and `in_bucket` [B, n].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        [motion, extents]: [&Tensor; 2],
        [counts, placed, in_bucket]: [&Tensor; 3],
    ) {
        let (&[batch, buckets], n) = (counts.shape(), grid.particles()) else {
            panic!("layer_place: {:?}", counts.shape())
        };
        assert_eq!([motion, extents, placed].map(Tensor::len), [8 * batch * n, 4 * batch, 4 * batch * n]);
        assert!(buckets.is_power_of_two(), "{buckets} buckets");
        let params = Params { rows: size(grid.h), columns: size(grid.w), buckets: size(buckets) };
        let tensors = [motion, extents, counts, placed, in_bucket];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, batch));
    }
}
