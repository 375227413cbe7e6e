//! Host side of `shaders/operator/pointwise.wgsl`.

use super::Layer;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{Tuning, common, size};

/// The WGSL.
pub const SOURCE: Source = Source {
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
    pad: [u32; 2],
}

/// A pointwise layer, `y = act(weight x + bias)` at every position.
#[derive(Clone, Debug)]
pub struct Pointwise {
    kernel: Kernel,
    tile: usize,
    group: usize,
}

impl Pointwise {
    /// Compiles the layer, with GELU after it or without.
    pub fn new(context: &Context, tuning: &Tuning, gelu: bool) -> Result<Self> {
        let group = tuning.pointwise_group as usize;
        let constants = [("GELU", f64::from(u8::from(gelu))), ("WORKGROUP", group as f64)];
        let kernel = Kernel::new(context, &SOURCE, tuning.unroll(tuning.channels), &constants)?;
        Ok(Self { kernel, tile: tuning.channels, group })
    }

    /// `layer.weight` [O / tile, I, tile] (see [`index`]), `x` [.., I, W'], `y` [.., O, W'] with padded rows, of as many lines.
    pub fn push(&self, schedule: &mut Schedule, layer: &Layer, x: &Tensor, y: &Tensor) {
        assert_eq!(lines(x), lines(y));
        let all = Lines { count: lines(x), x_first: 0, y_first: 0 };
        self.push_lines(schedule, layer, (x, y), all);
    }

    /// The same for some of their lines.
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
            pad: [0; 2],
        };
        let count = Kernel::spread_groups(size(quads.div_ceil(self.group)), size(outputs / self.tile));
        schedule.dispatch(&self.kernel, &params, &[&layer.weight, &layer.bias, x, y], count);
    }
}

/// Which lines of input and output a dispatch takes: a line is a row of a sample, with all channels.
#[derive(Clone, Copy, Debug)]
pub struct Lines {
    /// How many.
    pub count: usize,
    /// The first one of the input.
    pub x_first: usize,
    /// The first one of the output.
    pub y_first: usize,
}

/// The lines of a tensor [.., C, W'].
pub(crate) fn lines(tensor: &Tensor) -> usize {
    let &[ref lines @ .., _, _] = tensor.shape() else { panic!("no lines: {:?}", tensor.shape()) };
    lines.iter().product()
}

/// Where the weight from input `input` to output `output` lies in the order of the kernels, [O / tile, I, tile].
pub fn index(output: usize, input: usize, (inputs, tile): (usize, usize)) -> usize {
    (output / tile * inputs + input) * tile + output % tile
}
