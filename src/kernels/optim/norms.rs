//! Host side of `shaders/optim/norms.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

/// The WGSL.
pub const SOURCE: Source =
    Source { name: "norms", wgsl: include_str!("../../../shaders/optim/norms.wgsl"), common: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    parts: u32,
    samples: u32,
    first: u32,
}

/// Partial sums of squares of gradient and last step.
#[derive(Clone, Debug)]
pub struct Norms {
    kernel: Kernel,
    last_step: bool,
}

/// Number of parts that a sample of `particles` is summed in.
pub fn parts(particles: usize) -> usize {
    particles.div_ceil(2048).clamp(1, 64)
}

impl Norms {
    /// Makes it; without `last_step` only the gradient is summed and `hidden` is not read.
    pub fn new(context: &Context, last_step: bool) -> Result<Self> {
        let constants = [("LAST_STEP", f64::from(u8::from(last_step)))];
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &constants)?, last_step })
    }

    /// `grad` [S, n], `hidden` [2, S, n], `partial` [S, parts, 2].
    pub fn push(&self, schedule: &mut Schedule, grad: &Tensor, hidden: &Tensor, partial: &Tensor) {
        let &[samples, parts, 2] = partial.shape() else { panic!("norms: {:?}", partial.shape()) };
        let particles = grad.len() / samples;
        assert_eq!(grad.len(), samples * particles);
        assert!(!self.last_step || hidden.len() == 2 * grad.len(), "norms: hidden {:?}", hidden.shape());
        let (partial, first) = &partial.whole();
        let params = Params {
            particles: size(particles),
            parts: size(parts),
            samples: size(samples),
            // Views begin at an even element.
            first: size(first / 2),
        };
        let count = [size(parts), size(samples), 1];
        schedule.dispatch(&self.kernel, &params, &[grad, hidden, partial], count);
    }
}
