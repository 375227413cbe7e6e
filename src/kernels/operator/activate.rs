//! Host side of `shaders/operator/activate.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, size};

pub(crate) const SOURCE: Source = Source {
    name: "activate",
    wgsl: include_str!("../../../shaders/operator/activate.wgsl"),
    appended: &[common::GELU],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    quads: u32,
}

/// Applies GELU to each element.
#[derive(Clone, Debug)]
pub struct Activate {
    kernel: Kernel,
}

impl Activate {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `y = gelu(x)`. Both have the same shape, with padded rows.
    pub fn push(&self, schedule: &mut Schedule, x: &Tensor, y: &Tensor) {
        assert_eq!((x.shape(), x.len() % 4), (y.shape(), 0));
        let quads = x.len() / 4;
        let params = Params { quads: size(quads) };
        schedule.dispatch(&self.kernel, &params, &[x, y], self.kernel.spread(quads, 1));
    }
}
