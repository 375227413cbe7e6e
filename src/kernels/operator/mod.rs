//! The Fourier neural operator, kernel by kernel (paper section 4).

pub mod activate;
pub mod block;
pub mod gelu_adj;
pub mod head_weight_adj;
pub mod multiply_add;
pub mod pointwise;
pub mod pointwise_weight_adj;
pub mod pool_adj;
pub mod pool_rows;
pub mod project;
pub mod project_adj;
pub mod scalar_head;
pub mod spectral;
pub mod spectral_transpose;
pub mod spectral_weight_adj;
pub mod sum_parts;
pub mod transform_rows;
pub mod transpose;

pub use activate::Activate;
pub use block::{Block, BlockTensors, Epilogue, Inputs, LayerSize, Lifting};
pub use gelu_adj::GeluAdj;
pub use head_weight_adj::HeadWeightAdj;
pub use multiply_add::MultiplyAdd;
pub use pointwise::Pointwise;
pub use pointwise_weight_adj::{Parts, PointwiseWeightAdj};
pub use pool_adj::{PoolAdj, PoolAdjTensors};
pub use pool_rows::PoolRows;
pub use project::Project;
pub use project_adj::ProjectAdj;
pub use scalar_head::{LastStep, ScalarHead, Scales};
pub use spectral::{Spectral, SpectralSize, SpectralTensors};
pub use spectral_transpose::SpectralTranspose;
pub use spectral_weight_adj::SpectralWeightAdj;
pub use sum_parts::SumParts;
pub use transform_rows::TransformRows;
pub use transpose::Transpose;

use crate::gpu::Tensor;

/// Weight and bias of a layer on the device.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Weight, in the layout of the kernel that takes it.
    pub weight: Tensor,
    /// Bias, shape `[out]`.
    pub bias: Tensor,
}

/// Weight and bias of a layer on the device in one tensor, or their gradient.
#[derive(Clone, Debug)]
pub struct JoinedLayer {
    /// The weight in the layout of the kernels, then the bias.
    pub weight_and_bias: Tensor,
    /// First element of the bias.
    pub bias: usize,
}

impl JoinedLayer {
    /// Panics unless this is a head with one output of this many inputs.
    pub(in crate::kernels) fn check_head(&self, inputs: usize) {
        let len = self.weight_and_bias.len();
        assert!(inputs <= self.bias && self.bias < len, "a head of {inputs} inputs, of {len} elements");
    }
}
