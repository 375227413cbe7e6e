//! Host side of `shaders/cloth/layer_find.wgsl`.

use super::{Cells, Pairs};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "layer_find",
    wgsl: include_str!("../../../shaders/cloth/layer_find.wgsl"),
    appended: &[
        common::CLOTH,
        common::CELL,
        common::FACES,
        common::NEAREST,
        terms::CONTACT,
        pieces::BUCKET,
        pieces::ELASTIC_ALONG,
        pieces::PAIR,
        pieces::PATCH,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    buckets: u32,
    room: u32,
    writes: u32,
}

/// What a search does with the pairs that it finds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finds {
    /// Counts those of each patch.
    Counts,
    /// Writes them, and counts those of each particle.
    Writes,
}

/// Finds the pairs of parts of a cloth that come near each other.
#[derive(Clone, Debug)]
pub struct LayerFind {
    kernel: Kernel,
}

impl LayerFind {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `counts` [B, buckets], or increases them and sets `pairs`, which end where the counts said, from the sorted
    /// patches in `cells`, their `motion` [B, n, 8] and `extents` [B, 4].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        (grid, finds): (Grid, Finds),
        (cells, pairs): (&Cells, &Pairs),
        [cloths, motion, extents, counts]: [&Tensor; 4],
    ) {
        let &[batch, buckets] = counts.shape() else { panic!("layer_find: {:?}", counts.shape()) };
        let n = grid.particles();
        assert_eq!([motion, extents].map(Tensor::len), [8 * batch * n, 4 * batch]);
        assert_eq!([&cells.ends, &pairs.ends].map(Tensor::shape), [counts.shape(); 2]);
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            buckets: size(buckets),
            room: size(pairs.room()),
            writes: u32::from(finds == Finds::Writes),
        };
        let Pairs { ends, pairs, .. } = pairs;
        let tensors = [cloths, motion, extents, &cells.ends, &cells.sorted, ends, counts, pairs];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, batch));
    }
}
