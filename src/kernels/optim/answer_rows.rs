//! Host side of `shaders/optim/answer_rows.wgsl`.

use super::{Fields, Iterate};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "answer_rows",
    wgsl: include_str!("../../../shaders/optim/answer_rows.wgsl"),
    appended: &[common::MARK, pieces::FOUR_FIELDS],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// Finds what the step across a sheet leaves to be done along it, and transforms its rows.
#[derive(Clone, Debug)]
pub struct AnswerRows {
    kernel: Kernel,
}

impl AnswerRows {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &Fields::Tangents.constants()[..1])? })
    }

    /// Sets `z` ([`Fields::Tangents`]) from the gradient [B, 3, n] of `iterate`, the `axes` [B, 16, n] of the sheet, the first
    /// four fields of `y` ([`Fields::shape_of_all`]) and [`super::cosine_rows::table`] of W points.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (iterate, axes): (&Iterate, &Tensor),
        [table, y, z]: [&Tensor; 3],
    ) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        assert_eq!((n, axes.shape()), (grid.particles(), &[batch, AXES, n][..]));
        assert_eq!((table.shape(), y.shape()), (&[grid.w; 2][..], &Fields::shape_of_all(batch, grid)[..]));
        assert_eq!(z.shape(), Fields::Tangents.shape(batch, grid));
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        let tensors = [&iterate.grad, &iterate.marks, axes, table, y, z];
        let groups = [grid.w.div_ceil(32), grid.h.div_ceil(8), batch].map(size);
        schedule.dispatch(&self.kernel, &params, &tensors, groups);
    }
}
