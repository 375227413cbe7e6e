//! Host side of `shaders/optim/cosine_rows.wgsl`.

use super::Iterate;
use crate::Result;
use crate::cloth::Grid;
use crate::cloth::modes::cosine;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "cosine_rows",
    wgsl: include_str!("../../../shaders/optim/cosine_rows.wgsl"),
    appended: &[common::MARK, pieces::FOUR_FIELDS],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// Transforms the rows of forces: in the axes of the world and across the sheet, or along it.
#[derive(Clone, Debug)]
pub struct CosineRows {
    kernel: Kernel,
    fields: Fields,
}

/// The fields of a cloth that are transformed together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fields {
    /// The three components in the axes of the world, and that across the sheet.
    SpaceAndNormal,
    /// Those along the two tangents of the sheet.
    Tangents,
}

impl Fields {
    /// Returns their number.
    pub fn count(self) -> usize {
        match self {
            Self::SpaceAndNormal => 4,
            Self::Tangents => 2,
        }
    }

    /// Returns their shape for each of `batch` cloths, [B, 4 or 2, H, W].
    pub fn shape(self, batch: usize, grid: Grid) -> [usize; 4] {
        [batch, self.count(), grid.h, grid.w]
    }

    /// Returns the constant that tells a kernel.
    pub(super) fn constant(self) -> (&'static str, f64) {
        ("FIELDS", self.count() as f64)
    }
}

/// Returns the orthonormal cosine matrix (DCT-II) of `n` points [n, n], whose row k is mode k.
pub fn table(context: &Context, n: usize) -> Result<Tensor> {
    // Devices disagree on cosines, so these are computed here, in double precision.
    let values: Vec<f32> = (0..n * n).map(|at| cosine(n, at / n, at % n) as f32).collect();
    Tensor::from_slice(context, "cosines", &[n, n], &values)
}

impl CosineRows {
    /// Builds the kernel.
    pub fn new(context: &Context, fields: Fields) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[fields.constant()])?, fields })
    }

    /// Sets `z` ([`Fields::shape`]) from `forces` [B, 3, n] on the particles of `iterate`, the `axes` [B, 16, n] of the sheet and
    /// the [`table`] of W points.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (iterate, forces): (&Iterate, &Tensor),
        (axes, table): (&Tensor, &Tensor),
        z: &Tensor,
    ) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        assert_eq!((n, axes.shape()), (grid.particles(), &[batch, AXES, n][..]));
        assert_eq!(forces.len(), samples * n);
        assert_eq!((table.shape(), z.shape()), (&[grid.w; 2][..], &self.fields.shape(batch, grid)[..]));
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        let tensors = [forces, &iterate.marks, axes, table, z];
        let groups = [grid.w.div_ceil(32), grid.h.div_ceil(8), batch].map(size);
        schedule.dispatch(&self.kernel, &params, &tensors, groups);
    }
}
