//! Host side of `shaders/optim/cosine_rows.wgsl`.

use super::{Fields, Iterate};
use crate::Result;
use crate::cloth::Grid;
use crate::cloth::modes::cosine;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "cosine_rows",
    wgsl: include_str!("../../../shaders/optim/cosine_rows.wgsl"),
    appended: &[common::MARK, pieces::FOUR_FIELDS, pieces::ROWS_FORWARD],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// Transforms the rows of forces in the axes of the world and across the sheet.
#[derive(Clone, Debug)]
pub struct CosineRows {
    kernel: Kernel,
}

/// Returns the orthonormal cosine matrix (DCT-II) of `n` points [n, n], whose row k is mode k.
pub fn table(context: &Context, n: usize) -> Result<Tensor> {
    // Devices disagree on cosines, so these are computed here, in double precision.
    let values: Vec<f32> = (0..n * n).map(|at| cosine(n, at / n, at % n) as f32).collect();
    Tensor::from_slice(context, "cosines", &[n, n], &values)
}

impl CosineRows {
    /// Builds the kernel, whose operands go through workgroup memory if `staged`.
    pub fn new(context: &Context, staged: bool) -> Result<Self> {
        let constants = [("STAGED", f64::from(u8::from(staged)))];
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &constants)? })
    }

    /// Sets [`Fields::SpaceAndNormal`] of `z` ([`Fields::shape`]) from the gradient [B, 3, n] of `iterate`, the `axes` [B, 16, n] of the sheet and
    /// the [`table`] of W points.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (iterate, axes): (&Iterate, &Tensor),
        [table, z]: [&Tensor; 2],
    ) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        assert_eq!((n, axes.shape()), (grid.particles(), &[batch, AXES, n][..]));
        assert_eq!((table.shape(), z.shape()), (&[grid.w; 2][..], &Fields::shape(batch, grid)[..]));
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        let tensors = [&iterate.grad, &iterate.marks, axes, table, z];
        let groups = [grid.w.div_ceil(32), grid.h.div_ceil(8), batch].map(size);
        schedule.dispatch(&self.kernel, &params, &tensors, groups);
    }
}
