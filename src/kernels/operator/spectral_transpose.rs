//! Host side of `shaders/operator/spectral_transpose.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "spectral_transpose",
    wgsl: include_str!("../../../shaders/operator/spectral_transpose.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    inputs: u32,
    outputs: u32,
}

/// Computes the conjugate transpose of the spectral product's weight.
#[derive(Clone, Debug)]
pub struct SpectralTranspose {
    kernel: Kernel,
}

impl SpectralTranspose {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `transposed` [modes, O / 2, I, 4] to the conjugate transpose of `weight` [modes, I / 2, O, 4], both
    /// in the order of [`super::spectral::index`].
    pub fn push(&self, schedule: &mut Schedule, weight: &Tensor, transposed: &Tensor) {
        let &[modes, pairs, outputs, 4] = weight.shape() else {
            panic!("spectral_transpose: {:?}", weight.shape())
        };
        let inputs = 2 * pairs;
        assert_eq!(transposed.shape(), [modes, outputs / 2, inputs, 4]);
        let params = Params { inputs: size(inputs), outputs: size(outputs) };
        let count = self.kernel.groups([inputs, outputs, modes]);
        schedule.dispatch(&self.kernel, &params, &[weight, transposed], count);
    }
}
