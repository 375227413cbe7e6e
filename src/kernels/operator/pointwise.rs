//! Host side of `shaders/operator/pointwise.wgsl`.

use super::Layer;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor, Tuning};
use crate::kernels::{common, size};

pub(crate) const SOURCE: Source = Source {
    name: "pointwise",
    wgsl: include_str!("../../../shaders/operator/pointwise.wgsl"),
    appended: &[common::GELU],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    inputs: u32,
    outputs: u32,
    quads: u32,
    row_quads: u32,
    x_first: u32,
    y_first: u32,
}

/// A pointwise layer, `y = act(weight x + bias)` at every position.
#[derive(Clone, Debug)]
pub struct Pointwise {
    kernel: Kernel,
    tile: usize,
    group: usize,
}

impl Pointwise {
    /// Builds the kernel, with or without a GELU after the layer.
    pub fn new(context: &Context, tuning: &Tuning, gelu: bool) -> Result<Self> {
        let group = tuning.pointwise_group as usize;
        let constants = [("GELU", f64::from(u8::from(gelu))), ("WORKGROUP", group as f64)];
        let kernel = Kernel::new(context, &SOURCE, tuning.unroll(tuning.channels), &constants)?;
        Ok(Self { kernel, tile: tuning.channels, group })
    }

    /// Computes `y` [.., O, W'] from `x` [.., I, W'], both with padded rows and the same number of lines. The
    /// shape of `layer.weight` is [O / tile, I, tile] (see [`index`]).
    pub fn push(&self, schedule: &mut Schedule, layer: &Layer, x: &Tensor, y: &Tensor) {
        assert_eq!(lines(x), lines(y));
        let all = Lines { count: lines(x), x_first: 0, y_first: 0 };
        self.push_lines(schedule, layer, (x, y), all);
    }

    /// As [`Pointwise::push`], for some of the lines.
    pub fn push_lines(
        &self,
        schedule: &mut Schedule,
        layer: &Layer,
        (x, y): (&Tensor, &Tensor),
        part: Lines,
    ) {
        let (&[.., inputs, w], &[.., outputs, y_w]) = (x.shape(), y.shape()) else {
            panic!("pointwise: {:?} to {:?}", x.shape(), y.shape());
        };
        assert_eq!(y_w, w);
        assert!(part.x_first + part.count <= lines(x) && part.y_first + part.count <= lines(y));
        assert_eq!(layer.weight.shape(), [outputs / self.tile, inputs, self.tile]);
        assert_eq!((layer.bias.len(), w % 4, outputs % self.tile), (outputs, 0, 0));
        let quads = part.count * w / 4;
        let params = Params {
            inputs: size(inputs),
            outputs: size(outputs),
            quads: size(quads),
            row_quads: size(w / 4),
            x_first: size(part.x_first),
            y_first: size(part.y_first),
        };
        let [across, down, tiles] =
            Kernel::spread_groups(size(quads.div_ceil(self.group)), size(outputs / self.tile));
        let tensors = [&layer.weight, &layer.bias, x, y];
        schedule.dispatch(&self.kernel, &params, &tensors, [tiles, across, down]);
    }
}

/// The lines of input and output that a dispatch processes. A line is a row of a sample, with all channels.
#[derive(Clone, Copy, Debug)]
pub struct Lines {
    /// Number of lines.
    pub count: usize,
    /// First line of the input.
    pub x_first: usize,
    /// First line of the output.
    pub y_first: usize,
}

/// Returns the number of lines of a tensor [.., C, W'].
pub(crate) fn lines(tensor: &Tensor) -> usize {
    let &[ref lines @ .., _, _] = tensor.shape() else { panic!("no lines: {:?}", tensor.shape()) };
    lines.iter().product()
}

/// Returns the index of the weight from input `input` to output `output` in the order of the kernels,
/// [O / tile, I, tile].
pub fn index(output: usize, input: usize, (inputs, tile): (usize, usize)) -> usize {
    (output / tile * inputs + input) * tile + output % tile
}
