//! Host side of `shaders/fft/radix_prime.wgsl`.

use super::Pass;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "radix_prime",
    wgsl: include_str!("../../../shaders/fft/radix_prime.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    count: u32,
    length: u32,
    inner: u32,
    span: u32,
    radix: u32,
    sign: f32,
}

/// A pass of any radix.
#[derive(Clone, Debug)]
pub struct RadixPrime {
    kernel: Kernel,
}

impl RadixPrime {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Computes `result` from `source`, both [batch, lines, length, inner, 2] or larger, with `table`
    /// [length, 2] of the roots of unity.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        pass: Pass,
        table: &Tensor,
        (source, result): (&Tensor, &Tensor),
    ) {
        pass.check(table, source, result);
        let count = pass.elements();
        let params = Params {
            count: size(count),
            length: size(pass.length),
            inner: size(pass.inner),
            span: size(pass.span),
            radix: size(pass.radix),
            sign: pass.sign(),
        };
        let groups = self.kernel.spread(count, pass.batch);
        schedule.dispatch(&self.kernel, &params, &[table, source, result], groups);
    }
}
