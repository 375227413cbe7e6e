//! Host side of `shaders/operator/project_adj.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "project_adj",
    wgsl: include_str!("../../../shaders/operator/project_adj.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    quads: u32,
    row_quads: u32,
}

/// Adjoint of the last layer of the field head.
#[derive(Clone, Debug)]
pub struct ProjectAdj {
    kernel: Kernel,
}

impl ProjectAdj {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Computes `adj` [S, H, C, W'] from `adj_field` [S, H, W'], through the layer with weight `[C]`.
    pub fn push(&self, schedule: &mut Schedule, weight: &Tensor, adj_field: &Tensor, adj: &Tensor) {
        let &[samples, h, channels, w] = adj.shape() else { panic!("project_adj: {:?}", adj.shape()) };
        assert_eq!((adj_field.shape(), weight.len()), (&[samples, h, w][..], channels));
        let quads = samples * h * w / 4;
        let params = Params { channels: size(channels), quads: size(quads), row_quads: size(w / 4) };
        let count = self.kernel.spread(quads, channels);
        schedule.dispatch(&self.kernel, &params, &[weight, adj_field, adj], count);
    }
}
