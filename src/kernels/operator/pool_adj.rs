//! Host side of `shaders/operator/pool_adj.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source =
    Source { name: "pool_adj", wgsl: include_str!("../../../shaders/operator/pool_adj.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    rows: u32,
    stride: u32,
    columns: u32,
}

/// Adjoint of the scalar head and its maximum.
#[derive(Clone, Debug)]
pub struct PoolAdj {
    kernel: Kernel,
}

impl PoolAdj {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Adds to `adj` [S, H, C, W'] the cotangent that passes back through the head with weight `[C]`, and
    /// sets `pooled` [S, C].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        weight: &Tensor,
        from: PoolAdjTensors<'_>,
        (adj, pooled): (&Tensor, &Tensor),
    ) {
        let PoolAdjTensors { adj_scalar, rows_max, x, columns } = from;
        let &[samples, h, channels, w] = x.shape() else { panic!("pool_adj: {:?}", x.shape()) };
        assert_eq!((adj.shape(), pooled.shape()), (x.shape(), &[samples, channels][..]));
        assert_eq!((weight.len(), adj_scalar.len()), (channels, samples));
        assert_eq!(rows_max.shape(), [samples, h, channels]);
        assert!(columns <= w);
        let params =
            Params { channels: size(channels), rows: size(h), stride: size(w), columns: size(columns) };
        let tensors = [weight, adj_scalar, rows_max, x, adj, pooled];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.groups([channels, samples, 1]));
    }
}

/// The values of which the maximum was taken, and the cotangent of the scalar.
#[derive(Clone, Copy, Debug)]
pub struct PoolAdjTensors<'a> {
    /// Cotangent of the scalar, shape `[S]`.
    pub adj_scalar: &'a Tensor,
    /// Largest value of each row, shape [S, H, C].
    pub rows_max: &'a Tensor,
    /// Values of which the maximum was taken, shape [S, H, C, W'].
    pub x: &'a Tensor,
    /// Number of columns of a row without the padding (W).
    pub columns: usize,
}
