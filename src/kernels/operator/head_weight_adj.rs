//! Host side of `shaders/operator/head_weight_adj.wgsl`.

use super::pointwise::lines;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "head_weight_adj",
    wgsl: include_str!("../../../shaders/operator/head_weight_adj.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    width: u32,
    lines: u32,
    bias: u32,
}

/// Computes the gradient with respect to weight and bias of a head with one output.
#[derive(Clone, Debug)]
pub struct HeadWeightAdj {
    kernel: Kernel,
}

impl HeadWeightAdj {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Adds to `gradient`, which holds the weight \[C\] first and the bias at element `bias`. `x` [.., C, W']
    /// are the head's inputs, `adj` [.., W'] the cotangents of its output.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        x: &Tensor,
        adj: &Tensor,
        (gradient, bias): (&Tensor, usize),
    ) {
        let &[.., channels, width] = x.shape() else { panic!("head_weight_adj: {:?}", x.shape()) };
        let lines = lines(x);
        assert_eq!(adj.len(), lines * width);
        assert!(bias >= channels && bias < gradient.len(), "the bias comes after the weight");
        let params =
            Params { channels: size(channels), width: size(width), lines: size(lines), bias: size(bias) };
        schedule.dispatch(&self.kernel, &params, &[x, adj, gradient], [size(channels + 1), 1, 1]);
    }
}
