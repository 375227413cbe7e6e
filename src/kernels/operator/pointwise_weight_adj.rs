//! Host side of `shaders/operator/pointwise_weight_adj.wgsl`.

use super::pointwise::{Lines, lines};
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "pointwise_weight_adj",
    wgsl: include_str!("../../../shaders/operator/pointwise_weight_adj.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    inputs: u32,
    outputs: u32,
    quads: u32,
    row_quads: u32,
    parts: u32,
    x_first: u32,
    adj_first: u32,
    tile: u32,
    stride: u32,
    bias: u32,
}

/// Number of outputs, and of inputs, per workgroup.
const SIDE: usize = 32;
/// Most quads of positions per part: enough to keep a workgroup busy, few enough for a sum in single
/// precision.
const PART: usize = 256;

/// Computes the gradient with respect to weight and bias of a pointwise layer, in parts.
#[derive(Clone, Debug)]
pub struct PointwiseWeightAdj {
    kernel: Kernel,
}

/// Where the gradient of a layer is summed.
#[derive(Clone, Copy, Debug)]
pub struct Parts<'a> {
    /// The partial gradients, one row for each part of the positions.
    pub partial: &'a Tensor,
    /// Number of elements in a row: weight and bias, with the gap between them.
    pub len: usize,
    /// Index of the first element of the bias in a row.
    pub bias: usize,
    /// Output channels per tile of the weight.
    pub tile: usize,
}

/// Returns the number of parts in which this many quads of positions are summed.
pub fn parts(quads: usize) -> usize {
    quads.div_ceil(PART)
}

impl PointwiseWeightAdj {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets rows of `to` for some lines of the layer's input `x` [.., I, W'] and of the cotangents `adj`
    /// [.., O, W'] of its output, whose first line is `part.y_first`. Returns the number of rows.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        (x, adj): (&Tensor, &Tensor),
        part: Lines,
        to: Parts<'_>,
    ) -> usize {
        let (&[.., inputs, w], &[.., outputs, adj_w]) = (x.shape(), adj.shape()) else {
            panic!("pointwise_weight_adj: {:?} and {:?}", x.shape(), adj.shape());
        };
        assert_eq!(adj_w, w);
        assert!(part.x_first + part.count <= lines(x) && part.y_first + part.count <= lines(adj));
        assert_eq!((outputs % to.tile, to.tile % 4, to.bias % 4, to.len % 4), (0, 0, 0, 0));
        assert!(to.bias >= outputs * inputs && to.len >= to.bias + outputs);
        let quads = part.count * w / 4;
        let parts = parts(quads);
        assert!(parts * to.len <= to.partial.len(), "{:?}", to.partial.shape());
        let params = Params {
            inputs: size(inputs),
            outputs: size(outputs),
            quads: size(quads),
            row_quads: size(w / 4),
            parts: size(parts),
            x_first: size(part.x_first),
            adj_first: size(part.y_first),
            tile: size(to.tile),
            stride: size(to.len / 4),
            bias: size(to.bias / 4),
        };
        let tiles = outputs.div_ceil(SIDE) * inputs.div_ceil(SIDE);
        let count = [size(tiles), size(parts), 1];
        schedule.dispatch(&self.kernel, &params, &[x, adj, to.partial], count);
        parts
    }
}
