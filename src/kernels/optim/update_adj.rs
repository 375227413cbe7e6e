//! Host side of `shaders/optim/update_adj.wgsl`.

use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, size};
use crate::settings::{CLAMP, Normalisation};

pub(crate) const SOURCE: Source = Source {
    name: "update_adj",
    wgsl: include_str!("../../../shaders/optim/update_adj.wgsl"),
    appended: &[common::TANH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    stride: u32,
    share: f32,
}

/// Backward pass of the update rule, with normalised cotangents.
#[derive(Clone, Debug)]
pub struct UpdateAdj {
    kernel: Kernel,
    /// Number of samples that share a norm.
    together: usize,
}

impl UpdateAdj {
    /// Builds the kernel.
    pub fn new(context: &Context, normalisation: Normalisation) -> Result<Self> {
        let together = normalisation.samples();
        let constants = [("TOGETHER", together as f64), ("CLAMP", CLAMP)];
        let kernel = Kernel::new(context, &SOURCE, 0, &constants)?;
        Ok(Self { kernel, together })
    }

    /// Sets the normalised cotangents of the field and the scalar of the step that was taken, for `share`
    /// times the gradient `grad` [S, n] at the point it reached.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (from, share): (UpdateAdjTensors<'_>, f32),
        (adj_field, adj_scalar): (&Tensor, &Tensor),
    ) {
        let UpdateAdjTensors { field, scalar, scale, grad } = from;
        let &[1, samples, h, w] = field.shape() else { panic!("update_adj: {:?}", field.shape()) };
        assert_eq!(adj_field.shape(), [samples, h, w]);
        assert_eq!((h, grad.len()), (grid.h, samples * grid.particles()));
        assert_eq!([scalar.len(), scale.len(), adj_scalar.len()], [samples; 3]);
        assert_eq!(samples % self.together, 0, "groups must be complete");
        let params = Params { rows: size(h), columns: size(grid.w), stride: size(w), share };
        let tensors = [field, scalar, scale, grad, adj_field, adj_scalar];
        schedule.dispatch(&self.kernel, &params, &tensors, [size(samples), 1, 1]);
    }
}

/// What the step was computed from, and the gradient at the point it reached.
#[derive(Clone, Copy, Debug)]
pub struct UpdateAdjTensors<'a> {
    /// Output of the field head, shape [1, S, H, W'].
    pub field: &'a Tensor,
    /// Output of the scalar head, shape `[S]`.
    pub scalar: &'a Tensor,
    /// Scale of the step, shape `[S]`.
    pub scale: &'a Tensor,
    /// dL/da after the step, shape [S, H, W].
    pub grad: &'a Tensor,
}
