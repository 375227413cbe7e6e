//! The plan that sorts the particles of a trial by the cells of a uniform grid in space.

use super::{CellCount, CellFill, CellOrder, CellScan, Trial};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Schedule, Tensor};

/// The particles of a trial, sorted by cells that are hashed into buckets. The neighbours of a particle are
/// in its own cell and the 26 around it.
#[derive(Clone, Debug)]
pub struct Cells {
    count: CellCount,
    scan: CellScan,
    fill: CellFill,
    order: CellOrder,
    /// Number of particles in each bucket while they are counted, otherwise 0; shape [B, buckets].
    counts: Tensor,
    /// Position of each particle, and how many came to its bucket before it, shape [B, n, 4].
    placed: Tensor,
    /// Bucket of each particle, shape [B, n].
    in_bucket: Tensor,
    /// Particles of each bucket, shape [B, n].
    numbers: Tensor,
    /// Ends of the buckets among the sorted particles, shape [B, buckets]; integers.
    pub ends: Tensor,
    /// Particles sorted by bucket, then by number, shape [B, n, 4]: bits of the position \[edges\], and the
    /// number.
    pub sorted: Tensor,
}

/// Returns the number of buckets of a cloth, a power of two: about one per particle, so that few hold
/// particles of several cells.
pub fn buckets(grid: Grid) -> usize {
    grid.particles().next_power_of_two().max(CellScan::MULTIPLE)
}

impl Cells {
    /// Builds the kernels and tensors for this many cloths on a grid.
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
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>) {
        self.count.push(schedule, trial, self.counted());
        self.sort(schedule);
    }

    /// Returns what a kernel sets that counts the particles in each bucket ([`CellCount::push`]).
    pub fn counted(&self) -> [&Tensor; 3] {
        [&self.counts, &self.placed, &self.in_bucket]
    }

    /// Sorts what was counted.
    pub fn sort(&self, schedule: &mut Schedule) {
        let Self { counts, placed, in_bucket, numbers, ends, sorted, .. } = self;
        self.scan.push(schedule, counts, ends);
        self.fill.push(schedule, [ends, placed, in_bucket], numbers);
        self.order.push(schedule, [ends, placed, in_bucket, numbers], sorted);
    }
}
