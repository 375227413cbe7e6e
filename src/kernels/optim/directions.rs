//! The tensor of the directions of a subspace method.

use super::Iterate;
use crate::cloth::Grid;
use crate::gpu::Tensor;

/// Slot of the spectral direction.
pub const SPECTRAL: usize = 0;
/// Slot of the co-rotated direction.
pub const ROTATED: usize = 1;
/// Slot of the last step.
pub const LAST_STEP: usize = 2;
/// Slot of the network's step.
pub const LEARNED: usize = 3;

/// Returns the shape of `count` directions, each a field [B, 3, n] of `batch` cloths: [count, slot], where a
/// slot is a little longer than a field, so that each can be viewed.
pub fn shape(count: usize, batch: usize, grid: Grid) -> [usize; 2] {
    [count, (3 * batch * grid.particles()).next_multiple_of(Tensor::VIEW_ALIGNMENT)]
}

/// Returns one of the directions of `batch` cloths, shape [B, 3, n]. Panics if there are fewer.
pub fn one(directions: &Tensor, index: usize, batch: usize, grid: Grid) -> Tensor {
    let &[_, slot] = directions.shape() else { panic!("directions: {:?}", directions.shape()) };
    directions.view(index * slot, &[batch, 3, grid.particles()])
}

/// Returns the number of elements from a direction to the next. Panics if the directions are not those of
/// `iterate`, or if there are fewer than three.
pub(crate) fn slot(directions: &Tensor, iterate: &Iterate) -> usize {
    let &[count, slot] = directions.shape() else { panic!("directions: {:?}", directions.shape()) };
    let (samples, n) = iterate.samples_and_particles();
    assert!(count > LAST_STEP, "{count} directions");
    assert_eq!(slot, (samples * n).next_multiple_of(Tensor::VIEW_ALIGNMENT));
    slot
}
