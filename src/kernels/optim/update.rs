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
    first: u32,
    in_field: u32,
    first_scale: u32,
}

/// The learned step.
#[derive(Clone, Debug)]
pub struct Update {
    kernel: Kernel,
}

/// What the learned step is made of, beside the iterate.
#[derive(Clone, Copy, Debug)]
pub struct UpdateTensors<'a> {
    /// Field head in parts to be added up, shape [parts, s, H, W'].
    pub field: &'a Tensor,
    /// The sample of S that is the field's first.
    pub first: usize,
    /// Persistent scale, shape `[S]`.
    pub scale: &'a Tensor,
    /// Last gradient and last step, shape [2, S, n]: written.
    pub hidden: &'a Tensor,
}

impl Update {
    /// Makes it.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Moves the samples of `iterate` that the field is of by one learned step.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, from: UpdateTensors<'_>, iterate: &Iterate) {
        let &[parts, in_field, h, w] = from.field.shape() else { panic!("update: {:?}", from.field.shape()) };
        let (samples, n) = iterate.samples_and_particles();
        assert_eq!((h, n), (grid.h, grid.particles()));
        assert_eq!((from.scale.len(), from.hidden.len()), (samples, 2 * samples * n));
        assert!(from.first + in_field <= samples, "update: {in_field} samples from {} on", from.first);
        let (scale, first_scale) = &from.scale.whole();
        let params = Params {
            rows: size(h),
            columns: size(grid.w),
            row_quads: size(w / 4),
            samples: size(samples),
            parts: size(parts),
            first: size(from.first),
            in_field: size(in_field),
            first_scale: size(*first_scale),
        };
        let Iterate { grad, base, slots, a, shift } = iterate;
        let tensors = [from.field, scale, grad, base, slots, from.hidden, a, shift];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, in_field));
    }
}
