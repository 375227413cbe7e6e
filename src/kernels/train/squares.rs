//! Host side of `shaders/train/squares.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

/// The WGSL.
pub const SOURCE: Source =
    Source { name: "squares", wgsl: include_str!("../../../shaders/train/squares.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n: u32,
    parts: u32,
    pad: [u32; 2],
}

/// Elements of a part, about.
const PART: usize = 4096;

/// Sum of the squares of a vector.
#[derive(Clone, Debug)]
pub struct Squares {
    of_parts: Kernel,
    of_sums: Kernel,
}

/// Number of parts that a vector's squares are summed in.
pub fn parts(n: usize) -> usize {
    n.div_ceil(PART)
}

impl Squares {
    /// Makes it.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel =
            |square: bool| Kernel::new(context, &SOURCE, 0, &[("SQUARE", f64::from(u8::from(square)))]);
        Ok(Self { of_parts: kernel(true)?, of_sums: kernel(false)? })
    }

    /// `sum` \[1\] of the squares of `x`, through `sums` with an element for each of its [`parts`].
    pub fn push(&self, schedule: &mut Schedule, x: &Tensor, sums: &Tensor, sum: &Tensor) {
        assert_eq!((sums.len(), sum.len()), (parts(x.len()), 1));
        let params = |n: usize, parts: usize| Params { n: size(n), parts: size(parts), pad: [0; 2] };
        let parts = sums.len();
        schedule.dispatch(&self.of_parts, &params(x.len(), parts), &[x, sums], [size(parts), 1, 1]);
        schedule.dispatch(&self.of_sums, &params(parts, 1), &[sums, sum], [1, 1, 1]);
    }
}
