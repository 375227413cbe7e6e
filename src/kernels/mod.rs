//! The host side of every WGSL file, in the same tree as `shaders/`: parameters, shape checks and dispatch.
//!
//! A kernel is built once per device and pushed onto [`crate::gpu::Schedule`]s. Tensors carry their shapes,
//! so a push takes tensors and little else, and asserts that they fit. No algorithm lives here.

pub mod cloth;
pub mod fft;
pub mod operator;
pub mod optim;
pub mod train;

use crate::gpu::Source;

/// Channel counts are padded to a multiple of this.
pub const CHANNEL_MULTIPLE: usize = 32;

/// Shader text that holds only functions and constants, appended to the kernels that call them.
pub(crate) mod common {
    pub const ANGLE: &str = include_str!("../../shaders/common/angle.wgsl");
    pub const CELL: &str = include_str!("../../shaders/common/cell.wgsl");
    pub const CLOTH: &str = include_str!("../../shaders/common/cloth.wgsl");
    pub const DRAWN: &str = include_str!("../../shaders/common/drawn.wgsl");
    pub const GELU: &str = include_str!("../../shaders/common/gelu.wgsl");
    pub const OFFSET: &str = include_str!("../../shaders/common/offset.wgsl");
    pub const TEXEL: &str = include_str!("../../shaders/common/texel.wgsl");
    pub const TANH: &str = include_str!("../../shaders/common/tanh.wgsl");
}

/// Shader text that depends on a kernel's bindings: what is common to kernels with the same bindings, and
/// what differs between kernels of one file.
pub(crate) mod pieces {
    pub const BLOCK_INPUTS: &str = include_str!("../../shaders/pieces/block_inputs.wgsl");
    pub const BLOCK_OUTPUT: &str = include_str!("../../shaders/pieces/block_output.wgsl");
    pub const BUCKET: &str = include_str!("../../shaders/pieces/bucket.wgsl");
    pub const FEATURES: &str = include_str!("../../shaders/pieces/features.wgsl");
    pub const LIFTED_EMBEDDING: &str = include_str!("../../shaders/pieces/lifted_embedding.wgsl");
    pub const LIFTED_FIELDS: &str = include_str!("../../shaders/pieces/lifted_fields.wgsl");
    pub const LIFTING_INPUTS: &str = include_str!("../../shaders/pieces/lifting_inputs.wgsl");
    pub const SCALAR_HEAD: &str = include_str!("../../shaders/pieces/scalar_head.wgsl");
    pub const TARGET: &str = include_str!("../../shaders/pieces/target.wgsl");
    pub const TRIAL: &str = include_str!("../../shaders/pieces/trial.wgsl");
}

/// Every kernel, with a tile size for which it is unrolled somewhere (0 if it has no tile).
pub const ALL: &[(&Source, usize)] = &[
    (&cloth::external_force::SOURCE, 0),
    (&cloth::predict::SOURCE, 0),
    (&cloth::gradient::SOURCE, 0),
    (&cloth::cell_count::SOURCE, 0),
    (&cloth::cell_scan::SOURCE, 0),
    (&cloth::cell_fill::SOURCE, 0),
    (&cloth::cell_order::SOURCE, 0),
    (&cloth::repulsion::SOURCE, 0),
    (&cloth::energy::SOURCE, 0),
    (&cloth::energy_sum::SOURCE, 0),
    (&cloth::integrate::SOURCE, 0),
    (&cloth::vertices::SOURCE, 0),
    (&optim::features::SOURCE, 0),
    (&optim::update::SOURCE, 0),
    (&optim::gradient_descent::SOURCE, 0),
    (&optim::adam::SOURCE, 0),
    (&optim::lbfgs::SOURCE, 0),
    (&optim::cosine_order::SOURCE, 0),
    (&optim::rest_modes::SOURCE, 0),
    (&operator::pointwise::SOURCE, 16),
    (&operator::transform_rows::SOURCE, 10),
    (&operator::spectral::SOURCE, 5),
    (&operator::block::SOURCE, 16),
    (&operator::block::LIFTING, 16),
    (&operator::block::LIFTING_OF_FIELDS, 16),
    (&operator::pool_rows::SOURCE, 0),
    (&operator::scalar_head::SOURCE, 0),
    (&operator::project::SOURCE, 0),
    (&operator::activate::SOURCE, 0),
    (&operator::multiply_add::SOURCE, 0),
    (&operator::gelu_adj::SOURCE, 0),
    (&operator::transpose::SOURCE, 0),
    (&operator::spectral_transpose::SOURCE, 0),
    (&operator::pointwise_weight_adj::SOURCE, 0),
    (&operator::spectral_weight_adj::SOURCE, 4),
    (&operator::head_weight_adj::SOURCE, 0),
    (&operator::sum_parts::SOURCE, 0),
    (&operator::pool_adj::SOURCE, 0),
    (&operator::project_adj::SOURCE, 0),
    (&optim::update_adj::SOURCE, 0),
    (&train::draw::SOURCE, 0),
    (&train::advance::SOURCE, 0),
    (&train::store::SOURCE, 0),
    (&train::gradient_size::SOURCE, 0),
    (&train::squares::SOURCE, 0),
    (&train::adamw::SOURCE, 0),
    (&fft::pack_pairs::SOURCE, 0),
    (&fft::unpack_pairs::SOURCE, 0),
    (&fft::split_spectra::SOURCE, 0),
    (&fft::join_spectra::SOURCE, 0),
    (&fft::radix4::SOURCE, 0),
    (&fft::radix_prime::SOURCE, 0),
];

/// Returns the padded width W' of a network tensor's rows: the grid's columns, rounded up to quads.
pub fn padded(columns: usize) -> usize {
    columns.next_multiple_of(4)
}

/// Converts a size to the type that the kernels take.
pub(crate) fn size(n: usize) -> u32 {
    u32::try_from(n).expect("sizes are checked against the device's limits, which fit 32 bits")
}
