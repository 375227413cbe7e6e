//! Host side of `shaders/cloth/predict.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{groups, size};

/// The WGSL.
pub const SOURCE: Source =
    Source { name: "predict", wgsl: include_str!("../../../shaders/cloth/predict.wgsl"), common: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    pad: [u32; 3],
}

/// Start of a frame.
#[derive(Clone, Debug)]
pub struct Predict {
    kernel: Kernel,
}

/// What the prediction reads and writes.
#[derive(Clone, Copy, Debug)]
pub struct PredictTensors<'a> {
    /// Positions, shape [B, 3, n].
    pub x: &'a Tensor,
    /// Velocities, shape [B, 3, n].
    pub v: &'a Tensor,
    /// Handle positions, shape [handles, 3].
    pub targets: &'a Tensor,
}

impl Predict {
    /// Compiles it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets base, a and trial of `iterate`.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        from: PredictTensors<'_>,
        iterate: &crate::kernels::optim::Iterate,
    ) {
        let (samples, n) = iterate.samples_and_particles();
        assert_eq!((from.x.len(), from.v.len()), (samples * n, samples * n));
        let params = Params { particles: size(n), pad: [0; 3] };
        let tensors =
            [from.x, from.v, &iterate.slots, from.targets, &iterate.base, &iterate.a, &iterate.trial];
        schedule.dispatch(&self.kernel, &params, &tensors, [groups(n, 64), size(samples), 1]);
    }
}
