//! Host side of `shaders/operator/scalar_head.wgsl`.

use super::Layer;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "scalar_head",
    wgsl: include_str!("../../../shaders/operator/scalar_head.wgsl"),
    common: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    rows: u32,
    pad: [u32; 2],
}

/// The scalar head after its rows' maxima.
#[derive(Clone, Debug)]
pub struct ScalarHead {
    kernel: Kernel,
}

impl ScalarHead {
    /// Compiles it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// `layer` `[C]` and `[1]`, `rows_max` [S, H, C], `scalar` `[S]`.
    pub fn push(&self, schedule: &mut Schedule, layer: &Layer, rows_max: &Tensor, scalar: &Tensor) {
        let &[samples, rows, channels] = rows_max.shape() else {
            panic!("scalar_head: {:?}", rows_max.shape())
        };
        assert_eq!((layer.weight.len(), layer.bias.len()), (channels, 1));
        assert_eq!(scalar.shape(), [samples]);
        let params = Params { channels: size(channels), rows: size(rows), pad: [0; 2] };
        let tensors = [&layer.weight, &layer.bias, rows_max, scalar];
        schedule.dispatch(&self.kernel, &params, &tensors, [size(samples), 1, 1]);
    }
}
