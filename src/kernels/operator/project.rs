//! Host side of `shaders/operator/project.wgsl`.

use super::Layer;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source =
    Source { name: "project", wgsl: include_str!("../../../shaders/operator/project.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    quads: u32,
    row_quads: u32,
}

/// Last layer of the field head.
#[derive(Clone, Debug)]
pub struct Project {
    kernel: Kernel,
}

impl Project {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Computes `field` [1, S, H, W'] from `x` [S, H, C, W'] with `layer` (weight `[C]`, bias `[1]`).
    pub fn push(&self, schedule: &mut Schedule, layer: &Layer, x: &Tensor, field: &Tensor) {
        let &[samples, h, channels, w] = x.shape() else { panic!("project: {:?}", x.shape()) };
        assert_eq!((layer.weight.len(), layer.bias.len()), (channels, 1));
        assert_eq!(field.shape(), [1, samples, h, w]);
        let quads = samples * h * w / 4;
        let params = Params { channels: size(channels), quads: size(quads), row_quads: size(w / 4) };
        let tensors = [&layer.weight, &layer.bias, x, field];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(quads, 1));
    }
}
