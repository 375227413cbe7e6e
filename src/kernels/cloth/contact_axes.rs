//! Host side of `shaders/cloth/contact_axes.wgsl`.

use super::Trial;
use super::sheet_axes::AXES;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{pieces, size, terms};
use crate::settings::HOLDING;

pub(crate) const SOURCE: Source = Source {
    name: "contact_axes",
    wgsl: include_str!("../../../shaders/cloth/contact_axes.wgsl"),
    appended: &[terms::CONTACT, pieces::DISPLACED],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
}

/// Shortens the axes of the sheet at the particles that bodies hold.
#[derive(Clone, Debug)]
pub struct ContactAxes {
    kernel: Kernel,
}

impl ContactAxes {
    /// Builds the kernel for so many contacts of a particle.
    pub fn new(context: &Context, slots: usize) -> Result<Self> {
        let constants = [("SLOTS", slots as f64), ("HOLDING", HOLDING)];
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &constants)? })
    }

    /// Shortens `axes` [B, 16, n] by what `contacts` [B, slots n, 12] resist at `iterate.a`.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, [contacts, axes]: [&Tensor; 2]) {
        let (n, batch) = (trial.grid.particles(), trial.batch());
        assert_eq!(axes.shape(), [batch, AXES, n]);
        let (given, ..) = &trial.iterate.given();
        let tensors = [contacts, &trial.iterate.a, given, axes];
        let params = Params { particles: size(n) };
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, batch));
    }
}
