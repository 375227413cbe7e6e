//! The Fourier neural operator, kernel by kernel (paper section 4).

pub mod block;
pub mod inverse_columns;
pub mod pointwise;
pub mod pool_rows;
pub mod project;
pub mod scalar_head;
pub mod spectral;
pub mod transform_columns;
pub mod transform_rows;

pub use block::{Block, BlockTensors};
pub use inverse_columns::InverseColumns;
pub use pointwise::Pointwise;
pub use pool_rows::PoolRows;
pub use project::Project;
pub use scalar_head::ScalarHead;
pub use spectral::Spectral;
pub use transform_columns::TransformColumns;
pub use transform_rows::TransformRows;

use crate::gpu::Tensor;

/// Weight and bias of a layer on the device.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Weight, in the layout of the kernel that takes it.
    pub weight: Tensor,
    /// Bias, shape `[out]`.
    pub bias: Tensor,
}
