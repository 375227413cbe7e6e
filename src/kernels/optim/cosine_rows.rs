//! Host side of `shaders/optim/cosine_rows.wgsl`.

use super::Iterate;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::{common, pieces, size};
use std::f64::consts::PI;

pub(crate) const SOURCE: Source = Source {
    name: "cosine_rows",
    wgsl: include_str!("../../../shaders/optim/cosine_rows.wgsl"),
    appended: &[common::MARK, pieces::SIX_FIELDS],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// Transforms the rows of the gradient, in the axes of the world and of the sheet.
#[derive(Clone, Debug)]
pub struct CosineRows {
    kernel: Kernel,
}

/// Returns the orthonormal cosine matrix (DCT-II) of `n` points [n, n], whose row k is mode k.
pub fn table(context: &Context, n: usize) -> Result<Tensor> {
    // Devices disagree on cosines, so these are computed here, in double precision.
    let cosine = |k: usize, i: usize| {
        let scale = if k == 0 { 1.0 } else { 2.0 };
        // Reducing the argument exactly keeps long transforms accurate to the last bit.
        let angle = PI * (k * (2 * i + 1) % (4 * n)) as f64 / (2 * n) as f64;
        ((scale / n as f64).sqrt() * angle.cos()) as f32
    };
    let values: Vec<f32> = (0..n * n).map(|at| cosine(at / n, at % n)).collect();
    Tensor::from_slice(context, "cosines", &[n, n], &values)
}

/// Returns the shape of the six fields of each of `batch` cloths, [B, 6, H, W].
pub fn fields_shape(batch: usize, grid: Grid) -> [usize; 4] {
    [batch, 6, grid.h, grid.w]
}

impl CosineRows {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `z` [B, 6, H, W] from `iterate.grad`, the `axes` [B, 10, n] of the sheet and the [`table`] of W
    /// points.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (iterate, axes, table): (&Iterate, &Tensor, &Tensor),
        z: &Tensor,
    ) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        assert_eq!((n, axes.shape()), (grid.particles(), &[batch, AXES, n][..]));
        assert_eq!((table.shape(), z.shape()), (&[grid.w; 2][..], &fields_shape(batch, grid)[..]));
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        let tensors = [&iterate.grad, &iterate.marks, axes, table, z];
        let groups = [grid.w.div_ceil(32), grid.h.div_ceil(8), batch].map(size);
        schedule.dispatch(&self.kernel, &params, &tensors, groups);
    }
}
