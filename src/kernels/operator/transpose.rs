//! Host side of `shaders/operator/transpose.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "transpose",
    wgsl: include_str!("../../../shaders/operator/transpose.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    outputs: u32,
    inputs: u32,
    tile: u32,
}

/// Transposes a pointwise layer's weight.
#[derive(Clone, Debug)]
pub struct Transpose {
    kernel: Kernel,
}

impl Transpose {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `transposed` [I / tile, O, tile] to the transpose of `weight` [O / tile, I, tile].
    pub fn push(&self, schedule: &mut Schedule, weight: &Tensor, transposed: &Tensor) {
        let &[tiles, inputs, tile] = weight.shape() else { panic!("transpose: {:?}", weight.shape()) };
        let outputs = tiles * tile;
        assert_eq!(transposed.shape(), [inputs / tile, outputs, tile]);
        assert_eq!(inputs % tile, 0, "the inputs must be whole tiles");
        let params = Params { outputs: size(outputs), inputs: size(inputs), tile: size(tile) };
        let count = self.kernel.groups([outputs * inputs, 1, 1]);
        schedule.dispatch(&self.kernel, &params, &[weight, transposed], count);
    }
}
