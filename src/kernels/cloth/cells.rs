//! The plan of sorting the particles of a trial by the cells of a uniform grid in space.

use super::{CellCount, CellFill, CellOrder, CellScan, Physics};
use crate::Result;
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::optim::Iterate;
use crate::sim::Grid;

/// The particles of a trial, sorted by cells that are hashed into buckets: what is near a particle is in 27 of them.
#[derive(Clone, Debug)]
pub struct Cells {
    count: CellCount,
    scan: CellScan,
    fill: CellFill,
    order: CellOrder,
    /// Particles in each bucket while they are counted, else 0, shape [B, buckets].
    counts: Tensor,
    /// Where each particle is, and how many came to its bucket before, shape [B, n, 4].
    placed: Tensor,
    /// The bucket of each particle, shape [B, n].
    in_bucket: Tensor,
    /// The particles of each bucket, shape [B, n].
    numbers: Tensor,
    /// Where the buckets end, shape [B, buckets]; of whole numbers.
    pub ends: Tensor,
    /// The particles by buckets and in these by number, shape [B, n, 4]: bits of the position \[edges\], and the number.
    pub sorted: Tensor,
}

/// Number of buckets of a cloth, a power of two: about as many as particles, so that few hold those of several cells.
pub fn buckets(grid: Grid) -> usize {
    grid.particles().next_power_of_two().max(CellScan::MULTIPLE)
}

impl Cells {
    /// For this many cloths on a grid.
    pub fn new(context: &Context, batch: usize, grid: Grid) -> Result<Self> {
        let (n, buckets) = (grid.particles(), buckets(grid));
        Ok(Self {
            count: CellCount::new(context)?,
            scan: CellScan::new(context)?,
            fill: CellFill::new(context)?,
            order: CellOrder::new(context)?,
            counts: Tensor::zeros(context, "bucket counts", &[batch, buckets])?,
            placed: Tensor::zeros(context, "placed particles", &[batch, n, 4])?,
            in_bucket: Tensor::zeros(context, "buckets", &[batch, n])?,
            numbers: Tensor::zeros(context, "bucketed particles", &[batch, n])?,
            ends: Tensor::zeros(context, "bucket ends", &[batch, buckets])?,
            sorted: Tensor::zeros(context, "sorted particles", &[batch, n, 4])?,
        })
    }

    /// Sorts the particles at `iterate.a`.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, physics: Physics<'_>, iterate: &Iterate) {
        let Self { counts, placed, in_bucket, numbers, ends, sorted, .. } = self;
        self.count.push(schedule, grid, physics, iterate, [counts, placed, in_bucket]);
        self.scan.push(schedule, counts, ends);
        self.fill.push(schedule, [ends, placed, in_bucket], numbers);
        self.order.push(schedule, [ends, placed, in_bucket, numbers], sorted);
    }
}
