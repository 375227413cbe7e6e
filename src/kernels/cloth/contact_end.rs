//! Host side of `shaders/cloth/contact_end.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "contact_end",
    wgsl: include_str!("../../../shaders/cloth/contact_end.wgsl"),
    appended: &[terms::CONTACT],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
}

/// Corrects the end of a frame with bodies.
#[derive(Clone, Debug)]
pub struct ContactEnd {
    kernel: Kernel,
}

impl ContactEnd {
    /// Builds the kernel for so many contacts of a particle.
    pub fn new(context: &Context, slots: usize) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[("SLOTS", slots as f64)])? })
    }

    /// Moves the particles of `x` and `v` [B, 3, n], of which the latter are the displacements of the frame, by what the
    /// `contacts` [B, slots n, 12] demand.
    pub fn push(&self, schedule: &mut Schedule, [contacts, x, v]: [&Tensor; 3]) {
        let &[batch, 3, n] = x.shape() else { panic!("contact_end: {:?}", x.shape()) };
        assert_eq!(v.shape(), x.shape());
        let params = Params { particles: size(n) };
        schedule.dispatch(&self.kernel, &params, &[contacts, x, v], self.kernel.spread(n, batch));
    }
}
