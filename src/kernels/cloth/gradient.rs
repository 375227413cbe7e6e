//! Host side of `shaders/cloth/gradient.wgsl`.

use super::Trial;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "gradient",
    wgsl: include_str!("../../../shaders/cloth/gradient.wgsl"),
    appended: &[
        common::CLOTH,
        common::MARK,
        common::OFFSET,
        terms::PARTICLE,
        terms::EDGE,
        terms::ANGLE,
        pieces::TRIAL,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    parts: u32,
    first_sum: u32,
    last_step: u32,
    first_external: u32,
    zero: u32,
}

/// Computes the gradient of the energy with respect to the acceleration, and partial sums of squares for its
/// norm and that of the last step.
#[derive(Clone, Debug)]
pub struct Gradient {
    alone: Kernel,
    with_last_step: Kernel,
}

/// Most parts in which a sample is summed. Kernels that need the whole sum add them up.
const MAX_PARTS: usize = 256;

/// Returns the number of parts in which the squares of a sample are summed.
pub fn parts(grid: Grid) -> usize {
    let Grid { h, w } = grid;
    (h.div_ceil(8) * w.div_ceil(8)).min(MAX_PARTS)
}

impl Gradient {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |last_step: f64| Kernel::new(context, &SOURCE, 0, &[("LAST_STEP", last_step)]);
        Ok(Self { alone: kernel(0.0)?, with_last_step: kernel(1.0)? })
    }

    /// Sets `iterate.grad` at `iterate.a`, under `iterate.total` if there is one, else `iterate.external`. Sets
    /// `sums` [S, parts, 2] to the partial sums of squares of the gradient and of the last step. The latter are 0
    /// if the iterate has no hidden state.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, sums: &Tensor) {
        let Trial { grid, cloths, x, iterate } = trial;
        let batch = trial.batch();
        assert_eq!(sums.shape(), [3 * batch, parts(grid), 2]);
        let (sums, first) = &sums.whole();
        let (fields, hidden) = &iterate.fields();
        let (given, external, total) = &iterate.given();
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            parts: size(parts(grid)),
            // Views begin at an even element.
            first_sum: size(first / 2),
            last_step: size(hidden.unwrap_or(0) + iterate.grad.len()),
            first_external: size(total.unwrap_or(*external)),
            zero: 0,
        };
        let kernel = if hidden.is_some() { &self.with_last_step } else { &self.alone };
        let tensors = [cloths, &iterate.marks, &iterate.a, given, x, fields, sums];
        schedule.dispatch(kernel, &params, &tensors, [size(parts(grid)), size(batch), 1]);
    }
}
