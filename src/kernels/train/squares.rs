//! Host side of `shaders/train/squares.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source =
    Source { name: "squares", wgsl: include_str!("../../../shaders/train/squares.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n: u32,
    parts: u32,
}

/// Number of elements in a part, approximately.
const PART: usize = 4096;

/// Sums the squares of a vector.
#[derive(Clone, Debug)]
pub struct Squares {
    of_parts: Kernel,
    of_sums: Kernel,
}

/// Returns the number of parts in which the squares of a vector of `n` elements are summed.
pub fn parts(n: usize) -> usize {
    n.div_ceil(PART)
}

impl Squares {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel =
            |square: bool| Kernel::new(context, &SOURCE, 0, &[("SQUARE", f64::from(u8::from(square)))]);
        Ok(Self { of_parts: kernel(true)?, of_sums: kernel(false)? })
    }

    /// Sets `sum` \[1\] to the sum of the squares of `x`, by way of `sums`, which has one element for each of
    /// its [`parts`].
    pub fn push(&self, schedule: &mut Schedule, x: &Tensor, sums: &Tensor, sum: &Tensor) {
        assert_eq!((sums.len(), sum.len()), (parts(x.len()), 1));
        let params = |n: usize, parts: usize| Params { n: size(n), parts: size(parts) };
        let parts = sums.len();
        schedule.dispatch(&self.of_parts, &params(x.len(), parts), &[x, sums], [size(parts), 1, 1]);
        schedule.dispatch(&self.of_sums, &params(parts, 1), &[sums, sum], [1, 1, 1]);
    }
}
