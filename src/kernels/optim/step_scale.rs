//! Host side of `shaders/optim/step_scale.wgsl`.

use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::gradient;
use crate::kernels::operator::Scales;
use crate::kernels::{common, size};

pub(crate) const SOURCE: Source = Source {
    name: "step_scale",
    wgsl: include_str!("../../../shaders/optim/step_scale.wgsl"),
    appended: &[common::FINITE],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    parts: u32,
    first_sum: u32,
    before: u32,
    after: u32,
}

/// Scales the steps of a network to the last step.
#[derive(Clone, Debug)]
pub struct StepScale {
    kernel: Kernel,
}

impl StepScale {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets the scales after it of the three samples of each cloth from the partial `sums` of squares of the gradient and the
    /// last step [S, parts, 2], or to those before.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, sums: &Tensor, scales: Scales<'_>) {
        let &[samples, parts, 2] = sums.shape() else { panic!("step_scale: {:?}", sums.shape()) };
        assert_eq!(parts, gradient::parts(grid));
        let (sums, first_sum) = sums.whole();
        let params = Params {
            particles: size(grid.particles()),
            parts: size(parts),
            // Views begin at an even element.
            first_sum: size(first_sum / 2),
            before: size(scales.before),
            after: size(scales.after),
        };
        schedule.dispatch(&self.kernel, &params, &[&sums, scales.tensor], [size(samples / 3), 1, 1]);
    }
}
