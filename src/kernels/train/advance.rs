//! Host side of `shaders/train/advance.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::StateTensors;
use crate::kernels::optim::Iterate;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "advance",
    wgsl: include_str!("../../../shaders/train/advance.wgsl"),
    appended: &[common::MARK, common::DRAWN, pieces::TARGET],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
}

/// Ends the frame of some cloths of a batch.
#[derive(Clone, Debug)]
pub struct Advance {
    kernel: Kernel,
}

impl Advance {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// For the cloths marked in `drawn` \[B\], moves `state` to where `iterate` leads and zeroes `iterate.a`.
    pub fn push(&self, schedule: &mut Schedule, drawn: &Tensor, state: StateTensors<'_>, iterate: &Iterate) {
        let (samples, n) = iterate.samples_and_particles();
        assert_eq!((state.x.len(), state.v.len()), (samples * n, samples * n));
        assert_eq!(drawn.bytes() as usize, samples / 3 * size_of::<super::Drawn>());
        let params = Params { particles: size(n) };
        let Iterate { marks, a, base, .. } = iterate;
        let tensors = [drawn, marks, state.targets, base, state.x, state.v, a];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.groups([n, samples, 1]));
    }
}
