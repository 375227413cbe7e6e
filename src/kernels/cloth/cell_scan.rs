//! Host side of `shaders/cloth/cell_scan.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source =
    Source { name: "cell_scan", wgsl: include_str!("../../../shaders/cloth/cell_scan.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    buckets: u32,
}

/// Finds where each bucket ends among the sorted particles.
#[derive(Clone, Debug)]
pub struct CellScan {
    kernel: Kernel,
}

impl CellScan {
    /// Divisor of the number of buckets: four for each invocation.
    pub const MULTIPLE: usize = 1024;

    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `ends` [B, buckets] from `counts`, then `counts` to 0.
    pub fn push(&self, schedule: &mut Schedule, counts: &Tensor, ends: &Tensor) {
        let &[batch, buckets] = counts.shape() else { panic!("cell_scan: {:?}", counts.shape()) };
        assert_eq!(ends.shape(), counts.shape());
        assert!(buckets.is_multiple_of(Self::MULTIPLE), "{buckets} buckets");
        let params = Params { buckets: size(buckets) };
        schedule.dispatch(&self.kernel, &params, &[counts, ends], [size(batch), 1, 1]);
    }
}
