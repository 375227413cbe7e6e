//! Host side of `shaders/optim/cosine_back.wgsl`.

use super::Fields;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "cosine_back",
    wgsl: include_str!("../../../shaders/optim/cosine_back.wgsl"),
    appended: &[pieces::FOUR_FIELDS],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// Transforms the rows of fields back.
#[derive(Clone, Debug)]
pub struct CosineBack {
    kernel: Kernel,
    fields: Fields,
}

impl CosineBack {
    /// Builds the kernel, whose operands go through workgroup memory if `staged`.
    pub fn new(context: &Context, fields: Fields, staged: bool) -> Result<Self> {
        let [count, first] = fields.constants();
        let constants = [count, first, ("STAGED", f64::from(u8::from(staged)))];
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &constants)?, fields })
    }

    /// Sets these fields of `y` ([`Fields::shape_of_all`]) from `z` ([`Fields::shape`]), with [`super::cosine_rows::table`] of W points.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, table: &Tensor, [z, y]: [&Tensor; 2]) {
        let batch = z.shape()[0];
        assert_eq!(z.shape(), self.fields.shape(batch, grid));
        assert_eq!(y.shape(), Fields::shape_of_all(batch, grid));
        assert_eq!(table.shape(), [grid.w; 2]);
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        let groups = [grid.w.div_ceil(32), grid.h.div_ceil(8), batch].map(size);
        schedule.dispatch(&self.kernel, &params, &[table, z, y], groups);
    }
}
