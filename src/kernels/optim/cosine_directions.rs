//! Host side of `shaders/optim/cosine_directions.wgsl`.

use super::cosine_rows::fields_shape;
use super::{Iterate, directions};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "cosine_directions",
    wgsl: include_str!("../../../shaders/optim/cosine_directions.wgsl"),
    appended: &[common::MARK, pieces::SIX_FIELDS],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    slot: u32,
}

/// Transforms the rows of six fields back, which ends the spectral and the co-rotated direction.
#[derive(Clone, Debug)]
pub struct CosineDirections {
    kernel: Kernel,
}

impl CosineDirections {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets the first two slots of `directions` ([`directions::shape`]) from `z` [B, 6, H, W], the `axes`
    /// [B, 10, n] of the sheet and [`super::cosine_rows::table`] of W points.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (iterate, axes, table): (&Iterate, &Tensor, &Tensor),
        [z, directions]: [&Tensor; 2],
    ) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        assert_eq!((n, axes.shape()), (grid.particles(), &[batch, AXES, n][..]));
        assert_eq!((table.shape(), z.shape()), (&[grid.w; 2][..], &fields_shape(batch, grid)[..]));
        let slot = directions::slot(directions, iterate);
        let params = Params { rows: size(grid.h), columns: size(grid.w), slot: size(slot) };
        let tensors = [&iterate.marks, axes, table, z, directions];
        let groups = [grid.w.div_ceil(32), grid.h.div_ceil(8), batch].map(size);
        schedule.dispatch(&self.kernel, &params, &tensors, groups);
    }
}
