//! Host side of `shaders/cloth/contact_find.wgsl`.

use super::Trial;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "contact_find",
    wgsl: include_str!("../../../shaders/cloth/contact_find.wgsl"),
    appended: &[common::CLOTH, common::MARK, pieces::BODY, pieces::ELASTIC_ALONG, terms::CONTACT],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    bodies: u32,
}

/// Finds the contacts of a frame.
#[derive(Clone, Debug)]
pub struct ContactFind {
    kernel: Kernel,
}

impl ContactFind {
    /// Builds the kernel for so many contacts of a particle.
    pub fn new(context: &Context, slots: usize) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[("SLOTS", slots as f64)])? })
    }

    /// Sets `contacts` [B, slots n, 12] from the `bodies` [B, count, 24], the `fields` of those that are meshes and where
    /// the trial begins: `x` and `iterate.base`.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, [bodies, fields, contacts]: [&Tensor; 3]) {
        let (grid, batch) = (trial.grid, trial.batch());
        let &[_, count, _] = bodies.shape() else { panic!("contact_find: {:?}", bodies.shape()) };
        let params = Params { rows: size(grid.h), columns: size(grid.w), bodies: size(count) };
        let of_trial = [&trial.iterate.marks, trial.x, &trial.iterate.base];
        let tensors = [trial.cloths, bodies, of_trial[0], of_trial[1], of_trial[2], fields, contacts];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(grid.particles(), batch));
    }
}
