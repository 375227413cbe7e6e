//! Host side of `shaders/train/adamw.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source =
    Source { name: "adamw", wgsl: include_str!("../../../shaders/train/adamw.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n: u32,
}

/// The factors of a step, computed by the host in double precision: the content of a tensor of 10 elements.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Factors {
    /// Factor of the gradient that limits its norm: `min(largest norm / (norm + 1e-6), 1)`.
    pub clip: f32,
    /// Factor of the weights: `1 - rate weight_decay`.
    pub decay: f32,
    /// `rate / (1 - beta1^t)`.
    pub step_size: f32,
    /// `sqrt(1 - beta2^t)`.
    pub sqrt_correction: f32,
    /// Decay of the mean gradient.
    pub beta1: f32,
    /// Decay of the mean squared gradient.
    pub beta2: f32,
    /// `1 - beta1`.
    pub add1: f32,
    /// `1 - beta2`.
    pub add2: f32,
    /// Added to the denominator.
    pub epsilon: f32,
    /// Decay of the running mean of the weights.
    pub average: f32,
}

/// The optimizer's vectors, all of the same length.
#[derive(Clone, Debug)]
pub struct Moments {
    /// Mean gradient.
    pub mean: Tensor,
    /// Mean squared gradient.
    pub square: Tensor,
    /// Running mean of the weights.
    pub averaged: Tensor,
}

/// A step of AdamW.
#[derive(Clone, Debug)]
pub struct AdamW {
    kernel: Kernel,
}

impl AdamW {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Moves `weight` along `gradient`, by the [`Factors`] that the tensor `factors` holds when the kernel
    /// runs.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        factors: &Tensor,
        (gradient, weight): (&Tensor, &Tensor),
        moments: &Moments,
    ) {
        let n = weight.len();
        let Moments { mean, square, averaged } = moments;
        assert_eq!([gradient.len(), mean.len(), square.len(), averaged.len()], [n; 4]);
        assert_eq!(factors.bytes() as usize, size_of::<Factors>());
        let params = Params { n: size(n) };
        let tensors = [factors, gradient, weight, mean, square, averaged];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, 1));
    }
}
