//! Host side of `shaders/train/gradient_size.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "gradient_size",
    wgsl: include_str!("../../../shaders/train/gradient_size.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    elements: u32,
}

/// Computes the mean magnitude of the gradient of each cloth.
#[derive(Clone, Debug)]
pub struct GradientSize {
    kernel: Kernel,
}

impl GradientSize {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `sizes` \[B\] from `grad` \[B, 3, n\].
    pub fn push(&self, schedule: &mut Schedule, grad: &Tensor, sizes: &Tensor) {
        let batch = sizes.len();
        assert_eq!(grad.shape()[0], batch);
        let params = Params { elements: size(grad.len() / batch) };
        schedule.dispatch(&self.kernel, &params, &[grad, sizes], [size(batch), 1, 1]);
    }
}
