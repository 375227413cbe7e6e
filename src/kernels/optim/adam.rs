//! Host side of `shaders/optim/adam.wgsl`.

use super::Iterate;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;
use crate::settings::AdamSettings;

pub(crate) const SOURCE: Source =
    Source { name: "adam", wgsl: include_str!("../../../shaders/optim/adam.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    first: u32,
    rate: f32,
    beta1: f32,
    beta2: f32,
    epsilon: f32,
    correction1: f32,
    correction2: f32,
    weight1: f32,
    weight2: f32,
}

/// The Adam optimizer.
#[derive(Clone, Debug)]
pub struct Adam {
    kernel: Kernel,
}

impl Adam {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Moves `iterate` by the step of `iteration`, counted from 0. `moments` has shape [S, n, 2].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        settings: AdamSettings,
        iteration: usize,
        tensors: (&Iterate, &Tensor),
    ) {
        let (iterate, moments) = tensors;
        let (samples, n) = iterate.samples_and_particles();
        assert_eq!(moments.len(), 2 * samples * n);
        let AdamSettings { rate, beta1, beta2, epsilon } = settings;
        let t = iteration as i32 + 1;
        let params = Params {
            particles: size(n),
            first: u32::from(iteration == 0),
            rate: rate as f32,
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            epsilon: epsilon as f32,
            correction1: (1.0 / (1.0 - beta1.powi(t))) as f32,
            correction2: (1.0 / (1.0 - beta2.powi(t))) as f32,
            // In single precision 1 - beta2 would be too large by 5e-5 of itself.
            weight1: (1.0 - beta1) as f32,
            weight2: (1.0 - beta2) as f32,
        };
        let tensors = [&iterate.grad, moments, &iterate.a];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, samples));
    }
}
