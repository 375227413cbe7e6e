//! Host side of `shaders/cloth/sheet_axes.wgsl`.

use super::ClothParams;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::optim::{Iterate, directions};
use crate::kernels::{common, size};
use crate::settings::{ARCHING, HANDLE_REACH, HANDLE_SHARE, WARMEST};

pub(crate) const SOURCE: Source = Source {
    name: "sheet_axes",
    wgsl: include_str!("../../../shaders/cloth/sheet_axes.wgsl"),
    appended: &[common::CLOTH, common::MARK, common::OFFSET, common::FINITE],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    slot: u32,
    zero: u32,
}

pub use crate::settings::AXES;

/// Computes the sheet's own axes at each particle, and makes the accelerations of the last frames directions.
#[derive(Clone, Debug)]
pub struct SheetAxes {
    kernel: Kernel,
}

impl SheetAxes {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        let constants = [
            ("HANDLE_SHARE", HANDLE_SHARE),
            ("HANDLE_REACH", HANDLE_REACH as f64),
            ("ARCHING", ARCHING),
            ("WARMEST", WARMEST),
        ];
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &constants)? })
    }

    /// Sets `axes` [B, 16, n] from the materials of `cloths` \[B\] and the predicted positions `x + iterate.base`, moves `iterate.a` to the last
    /// step's slot of `directions` ([`directions::shape`]) and to `earlier` [B, 3, n], and sets it to 0. What it was, and `earlier` was, leaves
    /// in the spectral slot what [`Extrapolate`](crate::kernels::optim::Extrapolate) smooths.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (cloths, iterate, x): (&Tensor, &Iterate, &Tensor),
        [axes, directions, earlier]: [&Tensor; 3],
    ) {
        let (samples, n) = iterate.samples_and_particles();
        assert_eq!((n, x.len()), (grid.particles(), samples * n));
        assert_eq!((axes.shape(), earlier.len()), (&[samples / 3, AXES, n][..], samples * n));
        assert_eq!(cloths.bytes() as usize, samples / 3 * size_of::<ClothParams>());
        let slot = directions::slot(directions, iterate);
        let params = Params { rows: size(grid.h), columns: size(grid.w), slot: size(slot), zero: 0 };
        let Iterate { marks, a, base, .. } = iterate;
        let tensors = [cloths, marks, x, base, axes, directions, a, earlier];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, samples / 3));
    }
}
