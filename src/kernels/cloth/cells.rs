//! Host side of `shaders/cloth/cells.wgsl`.

use super::Physics;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::optim::Iterate;
use crate::kernels::{common, pieces, size};
use crate::sim::Grid;

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "cells",
    wgsl: include_str!("../../../shaders/cloth/cells.wgsl"),
    appended: &[common::CLOTH, common::CELL, pieces::TRIAL],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    buckets: u32,
    pad: [u32; 2],
}

/// The particles of a trial, sorted by cells.
#[derive(Clone, Debug)]
pub struct CellTensors {
    /// Where the buckets end, shape [B, buckets]; of whole numbers.
    pub ends: Tensor,
    /// The particles by buckets, shape [B, n, 4].
    bucketed: Tensor,
    /// The particles by buckets and in these by number, shape [B, n, 4]: position \[edges\] and the bits of the number.
    pub sorted: Tensor,
}

impl CellTensors {
    /// For this many cloths on a grid.
    pub fn new(context: &Context, batch: usize, grid: Grid) -> Result<Self> {
        let particles = |label| Tensor::zeros(context, label, &[batch, grid.particles(), 4]);
        Ok(Self {
            ends: Tensor::zeros(context, "bucket ends", &[batch, buckets(grid)])?,
            bucketed: particles("bucketed particles")?,
            sorted: particles("sorted particles")?,
        })
    }
}

/// Number of buckets of a cloth: few of them hold particles of several cells, and each invocation has as many.
pub fn buckets(grid: Grid) -> usize {
    (2 * grid.particles()).next_power_of_two().max(256)
}

/// Sorts the particles of a trial by cells.
#[derive(Clone, Debug)]
pub struct Cells {
    kernel: Kernel,
}

impl Cells {
    /// Makes it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// `tensors` at `iterate.a`.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        physics: Physics<'_>,
        (iterate, tensors): (&Iterate, &CellTensors),
    ) {
        let batch = physics.batch(grid, iterate);
        let CellTensors { ends, bucketed, sorted } = tensors;
        assert_eq!(ends.shape(), [batch, buckets(grid)]);
        assert_eq!([bucketed, sorted].map(Tensor::len), [4 * batch * grid.particles(); 2]);
        let params = Params { particles: size(grid.particles()), buckets: size(buckets(grid)), pad: [0; 2] };
        let Iterate { slots, a, base, .. } = iterate;
        let tensors = [physics.cloths, slots, a, base, physics.x, ends, bucketed, sorted];
        schedule.dispatch(&self.kernel, &params, &tensors, [size(batch), 1, 1]);
    }
}
