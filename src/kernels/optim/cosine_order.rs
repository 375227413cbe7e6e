//! Host side of `shaders/optim/cosine_order.wgsl`.

use super::{Iterate, LbfgsMemory};
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, size};

pub(crate) const SOURCE: Source = Source {
    name: "cosine_order",
    wgsl: include_str!("../../../shaders/optim/cosine_order.wgsl"),
    appended: &[common::MARK],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// Puts a field into the order in which its Fourier transform gives its cosine transform, or back.
#[derive(Clone, Debug)]
pub struct CosineOrder {
    kernel: Kernel,
}

impl CosineOrder {
    /// Builds the kernel for one direction.
    pub fn new(context: &Context, back: bool) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[("BACK", f64::from(u8::from(back)))])? })
    }

    /// Copies between the direction that L-BFGS modifies (`memory.last`) and `ordered` [3 B, H, W].
    pub fn push(&self, schedule: &mut Schedule, iterate: &Iterate, memory: &LbfgsMemory, ordered: &Tensor) {
        let &[samples, h, w] = ordered.shape() else { panic!("cosine_order: {:?}", ordered.shape()) };
        assert_eq!(iterate.samples_and_particles(), (samples, h * w));
        assert_eq!(memory.last.len(), 2 * samples * h * w);
        let params = Params { rows: size(h), columns: size(w) };
        let tensors = [&iterate.marks, &memory.last, ordered];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(h * w, samples));
    }
}
