//! Host side of `shaders/cloth/cell_count.wgsl`.

use super::Trial;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::optim::Iterate;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "cell_count",
    wgsl: include_str!("../../../shaders/cloth/cell_count.wgsl"),
    appended: &[common::CLOTH, common::MARK, common::CELL, pieces::TRIAL],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    buckets: u32,
}

/// Counts the particles in each bucket of cells.
#[derive(Clone, Debug)]
pub struct CellCount {
    kernel: Kernel,
}

impl CellCount {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Adds the particles at `iterate.a` to `counts` [B, buckets], and sets `placed` [B, n, 4] and
    /// `in_bucket` [B, n].
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, [counts, placed, in_bucket]: [&Tensor; 3]) {
        let (batch, n) = (trial.batch(), trial.grid.particles());
        let &[_, buckets] = counts.shape() else { panic!("cell_count: {:?}", counts.shape()) };
        assert_eq!([counts, placed, in_bucket].map(Tensor::len), [batch * buckets, 4 * batch * n, batch * n]);
        assert!(buckets.is_power_of_two(), "{buckets} buckets");
        let params = Params { particles: size(n), buckets: size(buckets) };
        let Iterate { marks, a, base, .. } = trial.iterate;
        let tensors = [trial.cloths, marks, a, base, trial.x, counts, placed, in_bucket];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, batch));
    }
}
