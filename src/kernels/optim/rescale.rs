//! Host side of `shaders/optim/rescale.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, groups, size};

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "rescale",
    wgsl: include_str!("../../../shaders/optim/rescale.wgsl"),
    common: &[common::TANH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    samples: u32,
    before: u32,
    after: u32,
    pad: u32,
}

/// The persistent scale from the scalar head.
#[derive(Clone, Debug)]
pub struct Rescale {
    kernel: Kernel,
}

impl Rescale {
    /// Compiles it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// `scalar` `[S]`; in `scale`, the S elements from `after` on become those from `before` on, rescaled.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        scalar: &Tensor,
        scale: &Tensor,
        [before, after]: [usize; 2],
    ) {
        let samples = scalar.len();
        assert!(before.max(after) + samples <= scale.len());
        let params = Params { samples: size(samples), before: size(before), after: size(after), pad: 0 };
        schedule.dispatch(&self.kernel, &params, &[scalar, scale], [groups(scalar.len(), 64), 1, 1]);
    }
}
