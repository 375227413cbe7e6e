//! Host side of `shaders/cloth/predict.wgsl`.

use super::StateTensors;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source};
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "predict",
    wgsl: include_str!("../../../shaders/cloth/predict.wgsl"),
    appended: &[common::MARK, pieces::TARGET],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
}

/// Starts a frame.
#[derive(Clone, Debug)]
pub struct Predict {
    kernel: Kernel,
}

impl Predict {
    /// Builds the kernel for the start of a frame.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Builds the kernel for the middle of a frame, where `iterate.a` is left unchanged.
    pub fn in_a_frame(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[("FRESH", 0.0)])? })
    }

    /// Sets `iterate.base`, and at the start of a frame sets `iterate.a` to 0.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        state: StateTensors<'_>,
        iterate: &crate::kernels::optim::Iterate,
    ) {
        let (samples, n) = iterate.samples_and_particles();
        assert_eq!((state.x.len(), state.v.len()), (samples * n, samples * n));
        let params = Params { particles: size(n) };
        let tensors = [state.x, state.v, &iterate.marks, state.targets, &iterate.base, &iterate.a];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, samples));
    }
}
