//! Training: the pools of cloths, the norm of the gradient and the optimizer of the weights (paper sections
//! 3.3 and 4).

pub mod adamw;
pub mod advance;
pub mod draw;
pub mod gradient_size;
pub mod squares;
pub mod store;

pub use adamw::{AdamW, Factors, Moments};
pub use advance::Advance;
pub use draw::Draw;
pub use gradient_size::GradientSize;
pub use squares::Squares;
pub use store::Store;

use crate::cloth::Grid;
use crate::gpu::Tensor;

/// One element of the WGSL's `array<Drawn>`: a cloth of a pool that takes part in a step.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Drawn {
    /// Index of the cloth in the pool.
    pub slot: u32,
    /// 1 if the cloth is reset to its start, otherwise 0.
    pub begin: u32,
    /// 1 if the frame ends after this iteration, otherwise 0.
    pub advance: u32,
    /// Fraction of the velocity that remains when the frame ends.
    pub keep: f32,
    /// Rows of the matrix that rotates the sheet at rest to its start; the last column is unused.
    pub rotation: [[f32; 4]; 3],
}

/// All cloths of a pool.
#[derive(Clone, Copy, Debug)]
pub struct PoolTensors<'a> {
    /// x, v, a, last gradient, last step, shape [P, 5, 3, n].
    pub fields: &'a Tensor,
    /// Persistent scale, shape [P, 3].
    pub scale: &'a Tensor,
}

/// The cloths of a batch.
#[derive(Clone, Copy, Debug)]
pub struct BatchTensors<'a> {
    /// Positions, shape [B, 3, n].
    pub x: &'a Tensor,
    /// Velocities, shape [B, 3, n].
    pub v: &'a Tensor,
    /// Accelerations so far, shape [B, 3, n].
    pub a: &'a Tensor,
    /// Last gradient and last step, shape [2, 3 B, n].
    pub hidden: &'a Tensor,
    /// Persistent scale, shape [3 B].
    pub scale: &'a Tensor,
}

/// Returns the number of samples of a batch. Panics if its tensors do not fit each other and the pool.
fn samples(grid: Grid, drawn: &Tensor, pool: PoolTensors<'_>, batch: BatchTensors<'_>) -> usize {
    let (n, samples) = (grid.particles(), batch.scale.len());
    let BatchTensors { x, v, a, hidden, .. } = batch;
    assert_eq!([x.len(), v.len(), a.len(), hidden.len() / 2], [samples * n; 4]);
    assert_eq!(drawn.bytes() as usize, samples / 3 * size_of::<Drawn>());
    assert_eq!(pool.fields.len(), 5 * pool.scale.len() * n);
    samples
}
