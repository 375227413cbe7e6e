//! Host side of `shaders/operator/sum_parts.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "sum_parts",
    wgsl: include_str!("../../../shaders/operator/sum_parts.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    stride: u32,
    parts: u32,
}

/// Sums the parts of a gradient.
#[derive(Clone, Debug)]
pub struct SumParts {
    kernel: Kernel,
}

impl SumParts {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Adds the first `parts` rows of `partial`, each as long as `gradient`, to `gradient`.
    pub fn push(&self, schedule: &mut Schedule, (partial, parts): (&Tensor, usize), gradient: &Tensor) {
        let len = gradient.len();
        assert_eq!(len % 4, 0, "a gradient is whole quads");
        assert!(parts * len <= partial.len(), "{parts} parts of {len} in {:?}", partial.shape());
        let params = Params { stride: size(len / 4), parts: size(parts) };
        schedule.dispatch(&self.kernel, &params, &[partial, gradient], self.kernel.groups([len / 4, 1, 1]));
    }
}
