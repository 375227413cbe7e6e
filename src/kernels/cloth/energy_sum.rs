//! Host side of `shaders/cloth/energy_sum.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "energy_sum",
    wgsl: include_str!("../../../shaders/cloth/energy_sum.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    groups: u32,
    pad: [u32; 3],
}

/// Energy terms of each cloth from their parts.
#[derive(Clone, Debug)]
pub struct EnergySum {
    kernel: Kernel,
}

impl EnergySum {
    /// Makes it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// `parts` [B, parts, 8], `terms` [B, 8].
    pub fn push(&self, schedule: &mut Schedule, parts: &Tensor, terms: &Tensor) {
        let &[batch, count, 8] = parts.shape() else { panic!("energy_sum: {:?}", parts.shape()) };
        assert_eq!(terms.shape(), [batch, 8]);
        let params = Params { groups: size(count), pad: [0; 3] };
        schedule.dispatch(&self.kernel, &params, &[parts, terms], [size(batch), 1, 1]);
    }
}
