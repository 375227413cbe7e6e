//! Host side of `shaders/operator/gelu_adj.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, size};

pub(crate) const SOURCE: Source = Source {
    name: "gelu_adj",
    wgsl: include_str!("../../../shaders/operator/gelu_adj.wgsl"),
    appended: &[common::GELU],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    quads: u32,
}

/// Adjoint of GELU.
#[derive(Clone, Debug)]
pub struct GeluAdj {
    kernel: Kernel,
}

impl GeluAdj {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `adj *= gelu'(x)`, then `x = gelu(x)`. Both have the same shape, with padded rows.
    pub fn push(&self, schedule: &mut Schedule, x: &Tensor, adj: &Tensor) {
        assert_eq!((x.shape(), x.len() % 4), (adj.shape(), 0));
        let quads = x.len() / 4;
        let params = Params { quads: size(quads) };
        schedule.dispatch(&self.kernel, &params, &[x, adj], self.kernel.spread(quads, 1));
    }
}
