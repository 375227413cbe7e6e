//! Host side of `shaders/optim/rest_modes.wgsl`.

use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::ClothParams;
use crate::kernels::{common, size};
use std::f64::consts::PI;

pub(crate) const SOURCE: Source = Source {
    name: "rest_modes",
    wgsl: include_str!("../../../shaders/optim/rest_modes.wgsl"),
    appended: &[common::CLOTH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// Applies the inverse Hessian of a flat sheet to spectra.
#[derive(Clone, Debug)]
pub struct RestModes {
    grid: Grid,
    kernel: Kernel,
    row_twiddles: Tensor,
    column_twiddles: Tensor,
}

impl RestModes {
    /// Builds the kernel and the tables for a grid.
    pub fn new(context: &Context, grid: Grid) -> Result<Self> {
        // Devices disagree on sines and cosines, so these are computed here, in double precision.
        let table = |label, length: usize, count: usize| {
            let angle = |k: usize| PI * k as f64 / (2 * length) as f64;
            let values: Vec<_> = (0..count).map(|k| [angle(k).cos() as f32, angle(k).sin() as f32]).collect();
            Tensor::from_slice(context, label, &[count, 2], &values)
        };
        Ok(Self {
            grid,
            kernel: Kernel::new(context, &SOURCE, 0, &[])?,
            row_twiddles: table("rest_modes.row_twiddles", grid.h, grid.h)?,
            column_twiddles: table("rest_modes.column_twiddles", grid.w, grid.w / 2 + 1)?,
        })
    }

    /// Sets `out` from `spectrum`, both [3 B, H, W / 2 + 1, 2], with the materials of `cloths` \[B\].
    pub fn push(&self, schedule: &mut Schedule, cloths: &Tensor, spectrum: &Tensor, out: &Tensor) {
        let Grid { h, w } = self.grid;
        let (samples, half) = (spectrum.shape()[0], w / 2 + 1);
        assert_eq!(spectrum.shape(), [samples, h, half, 2]);
        assert_eq!(out.shape(), spectrum.shape());
        assert_eq!(3 * cloths.bytes() as usize, samples * size_of::<ClothParams>());
        let params = Params { rows: size(h), columns: size(w) };
        let tensors = [cloths, &self.row_twiddles, &self.column_twiddles, spectrum, out];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(h * half, samples));
    }
}
