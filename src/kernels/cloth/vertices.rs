//! Host side of `shaders/cloth/vertices.wgsl`.

use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, size};

pub(crate) const SOURCE: Source = Source {
    name: "vertices",
    wgsl: include_str!("../../../shaders/cloth/vertices.wgsl"),
    appended: &[common::MARK],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// Computes positions and normals for rendering.
#[derive(Clone, Debug)]
pub struct Vertices {
    kernel: Kernel,
}

impl Vertices {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `interleaved` [B, H W, 6] from `marks` [B, H W], positions `x` and velocities `v` [B, 3, H W], each cloth
    /// seen as in its `view` [B, 4, 4] ([`crate::cloth::VertexView::to_rows`]).
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (marks, view, x, v): (&Tensor, &Tensor, &Tensor, &Tensor),
        interleaved: &Tensor,
    ) {
        let n = grid.particles();
        let batch = x.len() / (3 * n);
        assert_eq!(interleaved.shape(), [batch, n, 6]);
        assert_eq!((view.shape(), x.len(), v.len()), (&[batch, 4, 4][..], 3 * batch * n, 3 * batch * n));
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        schedule.dispatch(
            &self.kernel,
            &params,
            &[marks, view, x, v, interleaved],
            self.kernel.spread(n, batch),
        );
    }
}
