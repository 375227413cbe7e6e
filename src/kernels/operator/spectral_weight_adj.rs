//! Host side of `shaders/operator/spectral_weight_adj.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor, Tuning};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "spectral_weight_adj",
    wgsl: include_str!("../../../shaders/operator/spectral_weight_adj.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    inputs: u32,
    outputs: u32,
    modes: u32,
    samples: u32,
}

/// Number of inputs that share a read of the cotangents; an even divisor of [`crate::kernels::CHANNEL_MULTIPLE`].
const TILE: usize = 4;

/// Computes the gradient with respect to the weight of the spectral product.
#[derive(Clone, Debug)]
pub struct SpectralWeightAdj {
    kernel: Kernel,
}

impl SpectralWeightAdj {
    /// Builds the kernel.
    pub fn new(context: &Context, tuning: &Tuning) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, tuning.unroll(TILE), &[])? })
    }

    /// Adds to `gradient` [modes, I / 2, O, 4], in the order of [`super::spectral::index`]. `x` [S, .., I, 2] is
    /// the input of the product, `adj` [S, .., O, 2] the cotangent of its output.
    pub fn push(&self, schedule: &mut Schedule, x: &Tensor, adj: &Tensor, gradient: &Tensor) {
        let &[modes, pairs, outputs, 4] = gradient.shape() else {
            panic!("spectral_weight_adj: {:?}", gradient.shape())
        };
        let (samples, inputs) = (x.shape()[0], 2 * pairs);
        assert_eq!((x.len(), adj.len()), (samples * modes * inputs * 2, samples * modes * outputs * 2));
        assert_eq!(inputs % TILE, 0, "inputs are whole tiles");
        let params = Params {
            inputs: size(inputs),
            outputs: size(outputs),
            modes: size(modes),
            samples: size(samples),
        };
        let count = self.kernel.groups([outputs, modes, inputs / TILE]);
        schedule.dispatch(&self.kernel, &params, &[x, adj, gradient], count);
    }
}
