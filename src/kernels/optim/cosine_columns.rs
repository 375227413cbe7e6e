//! Host side of `shaders/optim/cosine_columns.wgsl`.

use super::Fields;
use crate::Result;
use crate::cloth::Grid;
use crate::cloth::modes::{SheetConstants, TENSION, mu};
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::ClothParams;
use crate::kernels::{common, size};

pub(crate) const SOURCE: Source = Source {
    name: "cosine_columns",
    wgsl: include_str!("../../../shaders/optim/cosine_columns.wgsl"),
    appended: &[common::CLOTH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// Transforms the columns of fields and divides them by their eigenvalues, or transforms them back.
#[derive(Clone, Debug)]
pub struct CosineColumns {
    kernel: Kernel,
    fields: Fields,
}

/// Returns `2 - 2 cos(pi k / n)` of the modes of the columns, then of the rows, [H + W].
pub fn squared_frequencies(context: &Context, grid: Grid) -> Result<Tensor> {
    let Grid { h, w } = grid;
    let values: Vec<f32> =
        (0..h).map(|k| mu(h, k)).chain((0..w).map(|l| mu(w, l))).map(|mu| mu as f32).collect();
    Tensor::from_slice(context, "squared frequencies", &[h + w], &values)
}

impl CosineColumns {
    /// Builds the kernel, of the inverse transform if `inverse`.
    pub fn new(context: &Context, fields: Fields, inverse: bool) -> Result<Self> {
        let of_sheet = SheetConstants::FITTED;
        let constants = [
            ("INVERSE", f64::from(u8::from(inverse))),
            ("TAU", TENSION),
            fields.constant(),
            ("TANGENTIAL", of_sheet.tangential_inertia),
            ("NORMAL", of_sheet.normal_inertia),
            ("BEND", of_sheet.normal_bend),
        ];
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &constants)?, fields })
    }

    /// Sets `out` from `z`, both of [`Fields::shape`], with the materials of `cloths` \[B\],
    /// [`super::cosine_rows::table`] of H points and [`squared_frequencies`].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (cloths, table, mu): (&Tensor, &Tensor, &Tensor),
        [z, out]: [&Tensor; 2],
    ) {
        let batch = z.shape()[0];
        assert_eq!([z, out].map(Tensor::shape), [&self.fields.shape(batch, grid)[..]; 2]);
        assert_eq!(cloths.bytes() as usize, batch * size_of::<ClothParams>());
        assert_eq!((table.shape(), mu.len()), (&[grid.h; 2][..], grid.h + grid.w));
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        let groups = [grid.w.div_ceil(32), grid.h.div_ceil(32), self.fields.count() * batch].map(size);
        schedule.dispatch(&self.kernel, &params, &[cloths, table, mu, z, out], groups);
    }
}
