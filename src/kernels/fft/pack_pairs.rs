//! Host side of `shaders/fft/pack_pairs.wgsl`.

use super::Fields;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source =
    Source { name: "pack_pairs", wgsl: include_str!("../../../shaders/fft/pack_pairs.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    count: u32,
    scale: f32,
}

/// Packs two real rows into one complex row.
#[derive(Clone, Debug)]
pub struct PackPairs {
    kernel: Kernel,
}

impl PackPairs {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `z` [B, ceil(H / 2), W, 2] to `x` [B, H, W] times `scale`, packed.
    pub fn push(&self, schedule: &mut Schedule, fields: Fields, scale: f32, x: &Tensor, z: &Tensor) {
        let Fields { batch, h, w } = fields;
        let count = fields.pairs() * w;
        assert_eq!(x.shape(), [batch, h, w]);
        assert!(z.len() >= 2 * batch * fields.pairs() * w, "pack_pairs: {:?} for {fields:?}", z.shape());
        let params = Params { rows: size(h), columns: size(w), count: size(count), scale };
        schedule.dispatch(&self.kernel, &params, &[x, z], self.kernel.spread(count, batch));
    }
}
