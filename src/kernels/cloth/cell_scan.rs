//! Host side of `shaders/cloth/cell_scan.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

/// The WGSL.
pub const SOURCE: Source =
    Source { name: "cell_scan", wgsl: include_str!("../../../shaders/cloth/cell_scan.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    buckets: u32,
    pad: [u32; 3],
}

/// Where the buckets end.
#[derive(Clone, Debug)]
pub struct CellScan {
    kernel: Kernel,
}

impl CellScan {
    /// What the number of buckets is a multiple of: four for each invocation.
    pub const MULTIPLE: usize = 1024;

    /// Makes it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `ends` [B, buckets] from `counts`, and these to 0.
    pub fn push(&self, schedule: &mut Schedule, counts: &Tensor, ends: &Tensor) {
        let &[batch, buckets] = counts.shape() else { panic!("cell_scan: {:?}", counts.shape()) };
        assert_eq!(ends.shape(), counts.shape());
        assert!(buckets.is_multiple_of(Self::MULTIPLE), "{buckets} buckets");
        let params = Params { buckets: size(buckets), pad: [0; 3] };
        schedule.dispatch(&self.kernel, &params, &[counts, ends], [size(batch), 1, 1]);
    }
}
