//! Host side of `shaders/fft/join_spectra.wgsl`.

use super::Fields;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "join_spectra",
    wgsl: include_str!("../../../shaders/fft/join_spectra.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    count: u32,
}

/// Joins the spectra of two real rows into that of their complex row.
#[derive(Clone, Debug)]
pub struct JoinSpectra {
    kernel: Kernel,
}

impl JoinSpectra {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `z` [B, ceil(H / 2), W, 2] from `y` [B, H, W / 2 + 1, 2]. Both may be larger.
    pub fn push(&self, schedule: &mut Schedule, fields: Fields, y: &Tensor, z: &Tensor) {
        let Fields { batch, h, w } = fields;
        let count = fields.pairs() * fields.half();
        assert!(y.len() >= 2 * batch * h * fields.half(), "{:?} for {fields:?}", y.shape());
        assert!(z.len() >= 2 * batch * fields.pairs() * w, "join_spectra: {:?} for {fields:?}", z.shape());
        let params = Params { rows: size(h), columns: size(w), count: size(count) };
        schedule.dispatch(&self.kernel, &params, &[y, z], self.kernel.spread(count, batch));
    }
}
