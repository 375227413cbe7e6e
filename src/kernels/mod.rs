//! The host side of every WGSL file, in the same tree as `shaders/`: parameters, shape checks and dispatch.
//!
//! A kernel is built once per device and pushed onto [`crate::gpu::Schedule`]s. Tensors carry their shapes,
//! so a push takes tensors and little else, and asserts that they fit. No algorithm lives here.

pub mod cloth;
pub mod fft;
pub mod operator;
pub mod optim;
pub mod train;

#[cfg(test)]
mod tests;

/// Channel counts are padded to a multiple of this.
pub const CHANNEL_MULTIPLE: usize = 32;

/// Shader text that holds only functions and constants, appended to the kernels that call them.
pub(crate) mod common {
    pub const CELL: &str = include_str!("../../shaders/common/cell.wgsl");
    pub const CLOTH: &str = include_str!("../../shaders/common/cloth.wgsl");
    pub const DRAWN: &str = include_str!("../../shaders/common/drawn.wgsl");
    pub const FACES: &str = include_str!("../../shaders/common/faces.wgsl");
    pub const FINITE: &str = include_str!("../../shaders/common/finite.wgsl");
    pub const GELU: &str = include_str!("../../shaders/common/gelu.wgsl");
    pub const JOINED: &str = include_str!("../../shaders/common/joined.wgsl");
    pub const MARK: &str = include_str!("../../shaders/common/mark.wgsl");
    pub const NEAREST: &str = include_str!("../../shaders/common/nearest.wgsl");
    pub const OFFSET: &str = include_str!("../../shaders/common/offset.wgsl");
    pub const TEXEL: &str = include_str!("../../shaders/common/texel.wgsl");
    pub const TANH: &str = include_str!("../../shaders/common/tanh.wgsl");
}

/// The local terms of the energy, each with its energy, gradient and second derivatives, appended to the kernels that
/// sum them over a cloth. [`crate::cloth::terms`] defines them.
pub(crate) mod terms {
    pub const ANGLE: &str = include_str!("../../shaders/terms/angle.wgsl");
    pub const CONTACT: &str = include_str!("../../shaders/terms/contact.wgsl");
    pub const EDGE: &str = include_str!("../../shaders/terms/edge.wgsl");
    pub const PARTICLE: &str = include_str!("../../shaders/terms/particle.wgsl");
}

/// Shader text that depends on a kernel's bindings: what is common to kernels with the same bindings, and
/// what differs between kernels of one file.
pub(crate) mod pieces {
    pub const ACROSS: &str = include_str!("../../shaders/pieces/across.wgsl");
    pub const BLOCK_INPUTS: &str = include_str!("../../shaders/pieces/block_inputs.wgsl");
    pub const BLOCK_OUTPUT: &str = include_str!("../../shaders/pieces/block_output.wgsl");
    pub const BODY: &str = include_str!("../../shaders/pieces/body.wgsl");
    pub const BUCKET: &str = include_str!("../../shaders/pieces/bucket.wgsl");
    pub const CONTACT_PRODUCTS: &str = include_str!("../../shaders/pieces/contact_products.wgsl");
    pub const DISPLACED: &str = include_str!("../../shaders/pieces/displaced.wgsl");
    pub const ELASTIC_ALONG: &str = include_str!("../../shaders/pieces/elastic_along.wgsl");
    pub const FEATURES: &str = include_str!("../../shaders/pieces/features.wgsl");
    pub const FOUR_FIELDS: &str = include_str!("../../shaders/pieces/four_fields.wgsl");
    pub const HINGE: &str = include_str!("../../shaders/pieces/hinge.wgsl");
    pub const HINGE_ENERGY: &str = include_str!("../../shaders/pieces/hinge_energy.wgsl");
    pub const LIFTED_EMBEDDING: &str = include_str!("../../shaders/pieces/lifted_embedding.wgsl");
    pub const LIFTED_FIELDS: &str = include_str!("../../shaders/pieces/lifted_fields.wgsl");
    pub const LIFTING_INPUTS: &str = include_str!("../../shaders/pieces/lifting_inputs.wgsl");
    pub const PAIR: &str = include_str!("../../shaders/pieces/pair.wgsl");
    pub const PAIRS_OF: &str = include_str!("../../shaders/pieces/pairs_of.wgsl");
    pub const PATCH: &str = include_str!("../../shaders/pieces/patch.wgsl");
    pub const POSITION_FORCE: &str = include_str!("../../shaders/pieces/position_force.wgsl");
    pub const PRODUCTS: &str = include_str!("../../shaders/pieces/products.wgsl");
    pub const PRODUCTS_PART: &str = include_str!("../../shaders/pieces/products_part.wgsl");
    pub const ROWS_BACK: &str = include_str!("../../shaders/pieces/rows_back.wgsl");
    pub const ROWS_FORWARD: &str = include_str!("../../shaders/pieces/rows_forward.wgsl");
    pub const SCALAR_HEAD: &str = include_str!("../../shaders/pieces/scalar_head.wgsl");
    pub const TARGET: &str = include_str!("../../shaders/pieces/target.wgsl");
    pub const TRIAL: &str = include_str!("../../shaders/pieces/trial.wgsl");
}

/// Returns the padded width W' of a network tensor's rows: the grid's columns, rounded up to quads.
pub fn padded(columns: usize) -> usize {
    columns.next_multiple_of(4)
}

/// Converts a size to the type that the kernels take.
pub(crate) fn size(n: usize) -> u32 {
    u32::try_from(n).expect("sizes are checked against the device's limits, which fit 32 bits")
}
