//! Host side of `shaders/cloth/contact.wgsl`.

use super::Trial;
use super::force::{Force, Sums};
use crate::Result;
use crate::gpu::{Context, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "contact",
    wgsl: include_str!("../../../shaders/cloth/contact.wgsl"),
    appended: &[common::MARK, terms::CONTACT, pieces::DISPLACED, pieces::POSITION_FORCE],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    sums: Sums,
}

/// Computes the accelerations by contacts, and their energy.
#[derive(Clone, Debug)]
pub struct Contact(Force);

impl Contact {
    /// Builds the kernels for so many contacts of a particle.
    pub fn new(context: &Context, slots: usize) -> Result<Self> {
        Force::new(context, &SOURCE, &[("SLOTS", slots as f64)]).map(Self)
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
        let (grid, iterate) = (trial.grid, trial.iterate);
        let (kernel, sums) = self.0.of(trial, after_repulsion, parts);
        let params = Params { rows: size(grid.h), columns: size(grid.w), sums };
        let (given, ..) = &iterate.given();
        let tensors = [&iterate.marks, contacts, &iterate.a, given, parts];
        schedule.dispatch(kernel, &params, &tensors, kernel.spread(grid.particles(), trial.batch()));
    }
}
