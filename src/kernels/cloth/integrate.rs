//! Host side of `shaders/cloth/integrate.wgsl`.

use super::StateTensors;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source};
use crate::kernels::optim::Iterate;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "integrate",
    wgsl: include_str!("../../../shaders/cloth/integrate.wgsl"),
    appended: &[common::MARK, pieces::TARGET],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
}

/// Ends a frame.
#[derive(Clone, Debug)]
pub struct Integrate {
    kernel: Kernel,
}

impl Integrate {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Advances positions and velocities to the end of the frame.
    pub fn push(&self, schedule: &mut Schedule, state: StateTensors<'_>, iterate: &Iterate) {
        let (samples, n) = iterate.samples_and_particles();
        let StateTensors { x, v, targets } = state;
        assert_eq!((x.len(), v.len()), (samples * n, samples * n));
        let params = Params { particles: size(n) };
        let tensors = [&iterate.marks, targets, &iterate.base, &iterate.a, x, v];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, samples));
    }
}
