//! The tensor of the directions of a subspace method.

use super::Iterate;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Source, Tensor};

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

/// A kernel for three directions, and for four.
#[derive(Clone, Debug)]
pub(crate) struct ByCount {
    three: Kernel,
    four: Kernel,
}

impl ByCount {
    /// Builds the kernels, whose constant K is the number of directions.
    pub fn new(
        context: &Context,
        source: &'static Source,
        constants: &[(&'static str, f64)],
    ) -> Result<Self> {
        let kernel = |count: f64| {
            let constants = [&[("K", count)], constants].concat();
            Kernel::new(context, source, 0, &constants)
        };
        Ok(Self { three: kernel(3.0)?, four: kernel(4.0)? })
    }

    /// Returns the kernel for these directions. Panics if they are fewer or more.
    pub fn of(&self, directions: &Tensor) -> &Kernel {
        match directions.shape()[0] {
            3 => &self.three,
            4 => &self.four,
            other => panic!("three or four directions, not {other}"),
        }
    }
}
