//! Host side of `shaders/optim/update.wgsl`.

use super::Iterate;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, size};
use crate::sim::Grid;

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "update",
    wgsl: include_str!("../../../shaders/optim/update.wgsl"),
    common: &[common::TANH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    row_quads: u32,
    samples: u32,
    parts: u32,
    pad: [u32; 3],
}

/// The learned step.
#[derive(Clone, Debug)]
pub struct Update {
    kernel: Kernel,
}

/// What the learned step is made of, beside the iterate.
#[derive(Clone, Copy, Debug)]
pub struct UpdateTensors<'a> {
    /// Field head in parts to be added up, shape [parts, S, H, W'].
    pub field: &'a Tensor,
    /// Persistent scale, shape `[S]`.
    pub scale: &'a Tensor,
    /// Last gradient and last step, shape [2, S, n]: written.
    pub hidden: &'a Tensor,
}

impl Update {
    /// Compiles it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Moves `iterate` by one learned step.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, from: UpdateTensors<'_>, iterate: &Iterate) {
        let &[parts, samples, h, w] = from.field.shape() else { panic!("update: {:?}", from.field.shape()) };
        let n = grid.particles();
        assert_eq!((h, from.scale.len(), from.hidden.len()), (grid.h, samples, 2 * samples * n));
        assert_eq!(iterate.samples_and_particles(), (samples, n));
        let [rows, columns, row_quads] = [h, grid.w, w / 4].map(size);
        let params =
            Params { rows, columns, row_quads, samples: size(samples), parts: size(parts), pad: [0; 3] };
        let Iterate { grad, base, slots, a, shift } = iterate;
        let tensors = [from.field, from.scale, grad, base, slots, from.hidden, a, shift];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.groups([n, samples, 1]));
    }
}
