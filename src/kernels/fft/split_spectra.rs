//! Host side of `shaders/fft/split_spectra.wgsl`.

use super::Fields;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "split_spectra",
    wgsl: include_str!("../../../shaders/fft/split_spectra.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    count: u32,
}

/// Splits the spectrum of a complex row into those of its two real rows.
#[derive(Clone, Debug)]
pub struct SplitSpectra {
    kernel: Kernel,
}

impl SplitSpectra {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `y` [B, H, W / 2 + 1, 2] from `z` [B, ceil(H / 2), W, 2]. Both may be larger.
    pub fn push(&self, schedule: &mut Schedule, fields: Fields, z: &Tensor, y: &Tensor) {
        let Fields { batch, h, w } = fields;
        let count = fields.pairs() * fields.half();
        assert!(y.len() >= 2 * batch * h * fields.half(), "{:?} for {fields:?}", y.shape());
        assert!(z.len() >= 2 * batch * fields.pairs() * w, "split_spectra: {:?} for {fields:?}", z.shape());
        let params = Params { rows: size(h), columns: size(w), count: size(count) };
        schedule.dispatch(&self.kernel, &params, &[z, y], self.kernel.spread(count, batch));
    }
}
