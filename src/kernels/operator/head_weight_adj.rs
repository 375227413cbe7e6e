//! Host side of `shaders/operator/head_weight_adj.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "head_weight_adj",
    wgsl: include_str!("../../../shaders/operator/head_weight_adj.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    positions: u32,
    samples: u32,
    bias: u32,
}

/// Gradient over weight and bias of a head with one output.
#[derive(Clone, Debug)]
pub struct HeadWeightAdj {
    kernel: Kernel,
}

impl HeadWeightAdj {
    /// Makes it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Adds to `gradient`, which holds the weight \[C\] first and the bias at element `bias`: `x` \[S, C, ..\] are the head's
    /// inputs, `adj` [S, ..] the cotangents of its output.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        x: &Tensor,
        adj: &Tensor,
        (gradient, bias): (&Tensor, usize),
    ) {
        let &[samples, channels, ..] = x.shape() else { panic!("head_weight_adj: {:?}", x.shape()) };
        let positions = x.len() / (samples * channels);
        assert_eq!((adj.len(), adj.shape()[0]), (samples * positions, samples));
        assert!(bias >= channels && bias < gradient.len(), "the bias comes after the weight");
        let params = Params {
            channels: size(channels),
            positions: size(positions),
            samples: size(samples),
            bias: size(bias),
        };
        schedule.dispatch(&self.kernel, &params, &[x, adj, gradient], [size(channels + 1), 1, 1]);
    }
}
