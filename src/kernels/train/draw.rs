//! Host side of `shaders/train/draw.wgsl`.

use super::{BatchTensors, PoolTensors};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, size};

pub(crate) const SOURCE: Source = Source {
    name: "draw",
    wgsl: include_str!("../../../shaders/train/draw.wgsl"),
    appended: &[common::DRAWN],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    samples: u32,
    scale: f32,
}

/// Copies the cloths of a batch out of their pool.
#[derive(Clone, Debug)]
pub struct Draw {
    kernel: Kernel,
}

impl Draw {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Fills the tensors of the batch from `pool`. Cloths that are reset start with the persistent scale
    /// `scale`.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        (grid, scale): (Grid, f32),
        (drawn, pool): (&Tensor, PoolTensors<'_>),
        batch: BatchTensors<'_>,
    ) {
        let samples = super::samples(grid, drawn, pool, batch);
        let params = Params { rows: size(grid.h), columns: size(grid.w), samples: size(samples), scale };
        let BatchTensors { x, v, a, hidden, scale } = batch;
        let tensors = [drawn, pool.fields, pool.scale, x, v, a, hidden, scale];
        schedule.dispatch(
            &self.kernel,
            &params,
            &tensors,
            self.kernel.groups([grid.particles(), samples, 1]),
        );
    }
}
