//! Host side of `shaders/cloth/repulsion.wgsl`.

use super::{Cells, Trial, energy};
use crate::Result;
use crate::cloth::{self, Grid};
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "repulsion",
    wgsl: include_str!("../../../shaders/cloth/repulsion.wgsl"),
    appended: &[common::CLOTH, common::MARK, common::CELL, common::JOINED, pieces::BUCKET],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    buckets: u32,
    groups: u32,
    first_external: u32,
    first_total: u32,
}

/// Computes the repulsion between particles within its range, including the search for them.
#[derive(Clone, Debug)]
pub struct Repulsion {
    cells: Cells,
    kernel: Kernel,
}

impl Repulsion {
    /// Builds the kernels and tensors for this many cloths on a grid.
    pub fn new(context: &Context, batch: usize, grid: Grid) -> Result<Self> {
        Ok(Self {
            cells: Cells::new(context, batch, grid)?,
            kernel: Kernel::new(context, &SOURCE, 0, &[("SOFTENING", cloth::Repulsion::SOFTENING)])?,
        })
    }

    /// Returns the particles, sorted where [`Repulsion::push`] was called last.
    pub fn cells(&self) -> &Cells {
        &self.cells
    }

    /// Sets `iterate.total` at `iterate.a`, and the repulsion's term in the `parts` of the energy [B, parts, 8].
    /// Panics if the iterate has no total.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, parts: &Tensor) {
        let (grid, batch) = (trial.grid, trial.batch());
        let shape @ [_, groups, _] = energy::parts_shape(batch, grid);
        assert_eq!(parts.shape(), shape);
        let Self { cells, kernel } = self;
        cells.push(schedule, trial);
        let Cells { ends, sorted, .. } = cells;
        let buckets = size(ends.shape()[1]);
        let (given, external, total) = &trial.iterate.given();
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            buckets,
            groups: size(groups),
            first_external: size(*external),
            first_total: size(total.expect("the iterate has a total")),
        };
        let tensors = [trial.cloths, &trial.iterate.marks, ends, sorted, given, parts];
        schedule.dispatch(kernel, &params, &tensors, kernel.spread(grid.particles(), batch));
    }
}
