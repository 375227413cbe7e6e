//! Host side of `shaders/optim/gradient_descent.wgsl`.

use super::Iterate;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "gradient_descent",
    wgsl: include_str!("../../../shaders/optim/gradient_descent.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    rate: f32,
}

/// Gradient descent.
#[derive(Clone, Debug)]
pub struct GradientDescent {
    kernel: Kernel,
}

impl GradientDescent {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Moves `iterate` by one step.
    pub fn push(&self, schedule: &mut Schedule, rate: f64, iterate: &Iterate) {
        let (samples, n) = iterate.samples_and_particles();
        let params = Params { particles: size(n), rate: rate as f32 };
        let count = self.kernel.spread(n, samples);
        schedule.dispatch(&self.kernel, &params, &[&iterate.grad, &iterate.a], count);
    }
}
