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
    /// Builds the kernel.
    pub fn new(context: &Context, fields: Fields) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[fields.constant()])?, fields })
    }

    /// Sets `out` from `z`, both of [`Fields::shape`], with [`super::cosine_rows::table`] of W points.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, table: &Tensor, [z, out]: [&Tensor; 2]) {
        let batch = z.shape()[0];
        assert_eq!([z, out].map(Tensor::shape), [&self.fields.shape(batch, grid)[..]; 2]);
        assert_eq!(table.shape(), [grid.w; 2]);
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        let groups = [grid.w.div_ceil(32), grid.h.div_ceil(8), batch].map(size);
        schedule.dispatch(&self.kernel, &params, &[table, z, out], groups);
    }
}
