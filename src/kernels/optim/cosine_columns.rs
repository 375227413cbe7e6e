//! Host side of `shaders/optim/cosine_columns.wgsl`.

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

    /// Returns the first of them among those of both.
    pub fn first(self) -> usize {
        match self {
            Self::SpaceAndNormal => 0,
            Self::Tangents => 4,
        }
    }

    /// Returns the shape of both of `batch` cloths, [B, 6, H, W].
    pub fn shape(batch: usize, grid: Grid) -> [usize; 4] {
        [batch, 6, grid.h, grid.w]
    }
}

/// Multiplies fields by their inverse Hessian, between the transforms of their rows.
#[derive(Clone, Debug)]
pub struct CosineColumns {
    kernel: Kernel,
    fields: Fields,
    grid: Grid,
}

/// Returns `2 - 2 cos(pi k / n)` of the modes of the columns, then of the rows, [H + W].
pub fn squared_frequencies(context: &Context, grid: Grid) -> Result<Tensor> {
    let Grid { h, w } = grid;
    let values: Vec<f32> =
        (0..h).map(|k| mu(h, k)).chain((0..w).map(|l| mu(w, l))).map(|mu| mu as f32).collect();
    Tensor::from_slice(context, "squared frequencies", &[h + w], &values)
}

/// Returns the number of invocations of a workgroup: as many as there are rows, rounded up, but no more than 128.
fn lanes(grid: Grid) -> usize {
    grid.h.next_multiple_of(32).min(128)
}

impl CosineColumns {
    /// Builds the kernel for columns of this grid, which go through workgroup memory if `staged`.
    pub fn new(context: &Context, fields: Fields, grid: Grid, staged: bool) -> Result<Self> {
        let of_sheet = SheetConstants::FITTED;
        let constants = [
            ("FIELDS", fields.count() as f64),
            ("FIRST", fields.first() as f64),
            ("STAGED", f64::from(u8::from(staged))),
            ("LANES", lanes(grid) as f64),
            ("TAU", TENSION),
            ("TANGENTIAL", of_sheet.tangential_inertia),
            ("CONTACT", of_sheet.tangential_contact),
            ("NORMAL", of_sheet.normal_inertia),
            ("BEND", of_sheet.normal_bend),
        ];
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &constants)?, fields, grid })
    }

    /// Multiplies its fields of `z` ([`Fields::shape`]), with the materials of `cloths` \[B\], [`super::cosine_rows::table`] of H points
    /// and [`squared_frequencies`]. The same fields of `y`, of the same shape, are overwritten.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        (cloths, table, mu): (&Tensor, &Tensor, &Tensor),
        [z, y]: [&Tensor; 2],
    ) {
        let (grid, batch) = (self.grid, z.shape()[0]);
        assert_eq!([z, y].map(Tensor::shape), [&Fields::shape(batch, grid)[..]; 2]);
        assert_eq!(cloths.bytes() as usize, batch * size_of::<ClothParams>());
        assert_eq!((table.shape(), mu.len()), (&[grid.h; 2][..], grid.h + grid.w));
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        let groups = [grid.w.div_ceil(16), self.fields.count() * batch, 1].map(size);
        schedule.dispatch(&self.kernel, &params, &[cloths, table, mu, z, y], groups);
    }
}
