//! Host side of `shaders/cloth/gradient.wgsl`.

use super::Physics;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source};
use crate::kernels::optim::Iterate;
use crate::kernels::{common, size};
use crate::sim::Grid;

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "gradient",
    wgsl: include_str!("../../../shaders/cloth/gradient.wgsl"),
    common: &[common::CLOTH, common::ANGLE, common::OFFSET],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    zero: u32,
    pad: u32,
}

/// Gradient of the energy with respect to the acceleration.
#[derive(Clone, Debug)]
pub struct Gradient {
    kernel: Kernel,
}

impl Gradient {
    /// Makes it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `iterate.grad` at `iterate.a`.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, physics: Physics<'_>, iterate: &Iterate) {
        let Physics { cloths, external, x } = physics;
        let batch = physics.batch(grid, iterate);
        let params = Params { rows: size(grid.h), columns: size(grid.w), zero: 0, pad: 0 };
        let tensors = [cloths, &iterate.slots, external, &iterate.a, x, &iterate.shift, &iterate.grad];
        let count = self.kernel.groups([grid.w, grid.h, batch]);
        schedule.dispatch(&self.kernel, &params, &tensors, count);
    }
}
