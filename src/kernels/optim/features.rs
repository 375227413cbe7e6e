//! Host side of `shaders/optim/features.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, padded, size};
use crate::sim::Grid;

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "features",
    wgsl: include_str!("../../../shaders/optim/features.wgsl"),
    common: &[common::TANH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    row_quads: u32,
    parts: u32,
    samples: u32,
    first: u32,
    first_sum: u32,
    pad: u32,
}

/// Input of the network from gradient and hidden state.
#[derive(Clone, Debug)]
pub struct Features {
    kernel: Kernel,
}

/// What the features are made of.
#[derive(Clone, Copy, Debug)]
pub struct FeatureTensors<'a> {
    /// Gradient, shape [S, n].
    pub grad: &'a Tensor,
    /// Last gradient and last step, shape [2, S, n].
    pub hidden: &'a Tensor,
    /// Partial sums of squares, shape [S, parts, 2].
    pub partial: &'a Tensor,
}

impl Features {
    /// Makes it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// `embedded` [s, 5, H, W'], of the s samples from `first` on.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        from: FeatureTensors<'_>,
        (embedded, first): (&Tensor, usize),
    ) {
        let &[samples, parts, 2] = from.partial.shape() else {
            panic!("features: {:?}", from.partial.shape())
        };
        let w = padded(grid.w);
        let made = embedded.shape()[0];
        assert_eq!(embedded.shape(), [made, 5, grid.h, w]);
        assert!(first + made <= samples, "features: {made} samples from {first} on of {samples}");
        assert_eq!((from.grad.len(), from.hidden.len()), (samples * grid.particles(), 2 * from.grad.len()));
        let (partial, first_sum) = &from.partial.whole();
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            row_quads: size(w / 4),
            parts: size(parts),
            samples: size(samples),
            first: size(first),
            // Views begin at an even element.
            first_sum: size(first_sum / 2),
            pad: 0,
        };
        let tensors = [from.grad, from.hidden, partial, embedded];
        let count = self.kernel.groups([w / 4, grid.h, made]);
        schedule.dispatch(&self.kernel, &params, &tensors, count);
    }
}
