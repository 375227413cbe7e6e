//! Host side of `shaders/cloth/repulsion.wgsl`.

use super::{Cells, EnergyTensors, energy};
use crate::Result;
use crate::cloth::{self, Grid};
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::optim::Iterate;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "repulsion",
    wgsl: include_str!("../../../shaders/cloth/repulsion.wgsl"),
    appended: &[common::CLOTH, common::CELL, pieces::BUCKET],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    buckets: u32,
    groups: u32,
}

/// Computes the repulsion between particles within its range, including the search for them.
#[derive(Clone, Debug)]
pub struct Repulsion {
    cells: Cells,
    kernel: Kernel,
    /// External accelerations plus those of the repulsion [edges / frame^2], shape [B, 3, n]. A gradient
    /// takes these in place of the external ones, since the repulsion depends on positions alone.
    pub total_acceleration: Tensor,
}

impl Repulsion {
    /// Builds the kernels and tensors for this many cloths on a grid.
    pub fn new(context: &Context, batch: usize, grid: Grid) -> Result<Self> {
        Ok(Self {
            cells: Cells::new(context, batch, grid)?,
            kernel: Kernel::new(context, &SOURCE, 0, &[("SOFTENING", cloth::Repulsion::SOFTENING)])?,
            total_acceleration: Tensor::zeros(context, "total acceleration", &[batch, 3, grid.particles()])?,
        })
    }

    /// Sets [`Repulsion::total_acceleration`] at `iterate.a`, and the repulsion's term in the `parts` of the
    /// energy [B, parts, 8].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        physics: EnergyTensors<'_>,
        (iterate, parts): (&Iterate, &Tensor),
    ) {
        let batch = physics.batch(grid, iterate);
        let shape @ [_, groups, _] = energy::parts_shape(batch, grid);
        assert_eq!(
            (parts.shape(), self.total_acceleration.len()),
            (&shape[..], 3 * batch * grid.particles())
        );
        let Self { cells, kernel, total_acceleration } = self;
        cells.push(schedule, grid, physics, iterate);
        let Cells { ends, sorted, .. } = cells;
        let buckets = size(ends.shape()[1]);
        let params = Params { rows: size(grid.h), columns: size(grid.w), buckets, groups: size(groups) };
        let tensors =
            [physics.cloths, &iterate.slots, physics.external, ends, sorted, total_acceleration, parts];
        schedule.dispatch(kernel, &params, &tensors, kernel.spread(grid.particles(), batch));
    }
}
