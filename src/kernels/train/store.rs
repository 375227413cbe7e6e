//! Host side of `shaders/train/store.wgsl`.

use super::{BatchTensors, PoolTensors};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, size};

pub(crate) const SOURCE: Source = Source {
    name: "store",
    wgsl: include_str!("../../../shaders/train/store.wgsl"),
    appended: &[common::DRAWN],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    samples: u32,
}

/// Copies the cloths of a batch back into their pool.
#[derive(Clone, Debug)]
pub struct Store {
    kernel: Kernel,
}

impl Store {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Copies the tensors of the batch into `pool`.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (drawn, pool): (&Tensor, PoolTensors<'_>),
        batch: BatchTensors<'_>,
    ) {
        let samples = super::samples(grid, drawn, pool, batch);
        let n = grid.particles();
        let params = Params { particles: size(n), samples: size(samples) };
        let BatchTensors { x, v, a, hidden, scale } = batch;
        let tensors = [drawn, x, v, a, hidden, scale, pool.fields, pool.scale];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.groups([n, samples, 1]));
    }
}
