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
    pad: [u32; 3],
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

    /// `scalar` `[S]`, `scale` `[S]`.
    pub fn push(&self, schedule: &mut Schedule, scalar: &Tensor, scale: &Tensor) {
        assert_eq!(scalar.len(), scale.len());
        let params = Params { samples: size(scalar.len()), pad: [0; 3] };
        schedule.dispatch(&self.kernel, &params, &[scalar, scale], [groups(scalar.len(), 64), 1, 1]);
    }
}
