//! Host side of `shaders/operator/project.wgsl`.

use super::Layer;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

/// The WGSL.
pub const SOURCE: Source =
    Source { name: "project", wgsl: include_str!("../../../shaders/operator/project.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    quads: u32,
    pad: [u32; 2],
}

/// Last layer of the field head.
#[derive(Clone, Debug)]
pub struct Project {
    kernel: Kernel,
}

impl Project {
    /// Makes it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// `layer` `[C]` and `[1]`, `x` [S, C, H, W'], `field` [1, S, H, W'].
    pub fn push(&self, schedule: &mut Schedule, layer: &Layer, x: &Tensor, field: &Tensor) {
        let &[samples, channels, h, w] = x.shape() else { panic!("project: {:?}", x.shape()) };
        assert_eq!((layer.weight.len(), layer.bias.len()), (channels, 1));
        assert_eq!(field.shape(), [1, samples, h, w]);
        let quads = h * w / 4;
        let params = Params { channels: size(channels), quads: size(quads), pad: [0; 2] };
        let tensors = [&layer.weight, &layer.bias, x, field];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.groups([quads, samples, 1]));
    }
}
