//! Host side of `shaders/optim/sheet_steps.wgsl`.

use super::{Fields, Iterate, Reacting, directions};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "sheet_steps",
    wgsl: include_str!("../../../shaders/optim/sheet_steps.wgsl"),
    appended: &[common::MARK, pieces::FOUR_FIELDS, pieces::ROWS_BACK],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    room: u32,
    slot: u32,
}

/// Transforms the rows of the fields along a sheet back, where handles hold, and makes the steps of all its fields.
#[derive(Clone, Debug)]
pub struct SheetSteps {
    kernel: Kernel,
}

impl SheetSteps {
    /// Builds the kernel, whose operands go through workgroup memory if `staged`.
    pub fn new(context: &Context, staged: bool) -> Result<Self> {
        let constants = [("STAGED", f64::from(u8::from(staged)))];
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &constants)? })
    }

    /// Transforms [`Fields::Tangents`] of `z` ([`Fields::shape`]) with [`super::cosine_rows::table`] of W points, and sets the spectral and
    /// the co-rotated slot of `directions` ([`directions::shape`]) from these and the other fields of `y`, with the `axes`
    /// [B, 16, n] of the sheet.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (iterate, axes, reacting): (&Iterate, &Tensor, &Reacting),
        [table, z, y, directions]: [&Tensor; 4],
    ) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        assert_eq!((n, axes.shape()), (grid.particles(), &[batch, AXES, n][..]));
        assert_eq!(table.shape(), [grid.w; 2]);
        assert_eq!([z, y].map(Tensor::shape), [&Fields::shape(batch, grid)[..]; 2]);
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            room: size(reacting.room(batch, n)),
            slot: size(directions::slot(directions, iterate)),
        };
        let Reacting { handles, fields } = reacting;
        let tensors = [table, z, &iterate.marks, axes, handles, fields, y, directions];
        let groups = [grid.w.div_ceil(32), grid.h.div_ceil(8), batch].map(size);
        schedule.dispatch(&self.kernel, &params, &tensors, groups);
    }
}
