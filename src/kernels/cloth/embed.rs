//! Host side of `shaders/cloth/embed.wgsl`.

use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source =
    Source { name: "embed", wgsl: include_str!("../../../shaders/cloth/embed.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    columns: u32,
    vertices: u32,
}

/// Computes the vertices of a mesh that the cloths carry along.
#[derive(Clone, Debug)]
pub struct Embed {
    kernel: Kernel,
}

impl Embed {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `embedded` [B, V, 6] from the particles' `interleaved` [B, H W, 6], for vertices in these `cells` \[V\] with these
    /// `weights` [V, 2] ([`crate::cloth::Embedding`]).
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (cells, weights, interleaved): (&Tensor, &Tensor, &Tensor),
        embedded: &Tensor,
    ) {
        let (n, vertices) = (grid.particles(), cells.len());
        let batch = interleaved.len() / (6 * n);
        assert_eq!(interleaved.shape(), [batch, n, 6]);
        assert_eq!((embedded.shape(), weights.shape()), (&[batch, vertices, 6][..], &[vertices, 2][..]));
        let params = Params { particles: size(n), columns: size(grid.w), vertices: size(vertices) };
        schedule.dispatch(
            &self.kernel,
            &params,
            &[cells, weights, interleaved, embedded],
            self.kernel.spread(vertices, batch),
        );
    }
}
