//! Host side of `shaders/cloth/contact.wgsl`.

use super::{Trial, energy};
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "contact",
    wgsl: include_str!("../../../shaders/cloth/contact.wgsl"),
    appended: &[common::MARK, terms::CONTACT, pieces::DISPLACED, pieces::POSITION_ENERGY],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    groups: u32,
    first_source: u32,
    first_total: u32,
}

/// Computes the accelerations by contacts, and their energy.
#[derive(Clone, Debug)]
pub struct Contact {
    alone: Kernel,
    after_repulsion: Kernel,
}

impl Contact {
    /// Builds the kernels for so many contacts of a particle.
    pub fn new(context: &Context, slots: usize) -> Result<Self> {
        let kernel = |sets: f64| {
            let constants = [("SLOTS", slots as f64), ("SETS", sets)];
            Kernel::new(context, &SOURCE, 0, &constants)
        };
        Ok(Self { alone: kernel(1.0)?, after_repulsion: kernel(0.0)? })
    }

    /// Sets `iterate.total` at `iterate.a` to the external accelerations and those by `contacts` [B, slots n, 12], and the
    /// last number of each of the `parts` of the energy [B, parts, 8]. After a repulsion, which has set both, it adds.
    /// Panics if the iterate has no total.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        after_repulsion: bool,
        [contacts, parts]: [&Tensor; 2],
    ) {
        let (grid, batch) = (trial.grid, trial.batch());
        let shape @ [_, groups, _] = energy::parts_shape(batch, grid);
        assert_eq!(parts.shape(), shape);
        let (given, external, total) = &trial.iterate.given();
        let total = total.expect("the iterate has a total");
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            groups: size(groups),
            first_source: size(if after_repulsion { total } else { *external }),
            first_total: size(total),
        };
        let kernel = if after_repulsion { &self.after_repulsion } else { &self.alone };
        let tensors = [&trial.iterate.marks, contacts, &trial.iterate.a, given, parts];
        schedule.dispatch(kernel, &params, &tensors, kernel.spread(grid.particles(), batch));
    }
}
