//! Host side of `shaders/operator/multiply_add.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "multiply_add",
    wgsl: include_str!("../../../shaders/operator/multiply_add.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    quads: u32,
    steps: u32,
    factor: f32,
    term: f32,
}

/// Multiply-adds in registers, which measure the most that a device can compute.
#[derive(Clone, Debug)]
pub struct MultiplyAdd {
    kernel: Kernel,
}

impl MultiplyAdd {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Floating-point operations per element and step.
    pub const FLOP: usize = 2 * 3 * 16;

    /// Sets `y = f(x) + f(x + 1) + f(x - 1)`, where f applies `t = factor t + term` 16 `steps` times. Both
    /// tensors have the same number of elements, a multiple of four.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        (steps, factor, term): (u32, f32, f32),
        x: &Tensor,
        y: &Tensor,
    ) {
        assert_eq!((x.len(), x.len() % 4), (y.len(), 0));
        let quads = x.len() / 4;
        let params = Params { quads: size(quads), steps, factor, term };
        schedule.dispatch(&self.kernel, &params, &[x, y], self.kernel.spread(quads, 1));
    }
}
