//! Host side of `shaders/operator/pointwise.wgsl`.

use super::Layer;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{Tuning, common, size};

/// The WGSL.
pub const SOURCE: Source = Source {
    name: "pointwise",
    wgsl: include_str!("../../../shaders/operator/pointwise.wgsl"),
    common: &[common::GELU],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    inputs: u32,
    quads: u32,
    outputs: u32,
    x_first: u32,
    y_first: u32,
    pad: [u32; 3],
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

    /// `layer.weight` [O / tile, I, tile] (see [`index`]), `x` [S, I, H, W'], `y` [S, O, H, W'] with padded rows.
    pub fn push(&self, schedule: &mut Schedule, layer: &Layer, x: &Tensor, y: &Tensor) {
        let all = Samples { count: x.shape()[0], x_first: 0, y_first: 0 };
        self.push_part(schedule, layer, (x, y), all);
    }

    /// The same for some of the samples of `x` and `y`.
    pub fn push_part(
        &self,
        schedule: &mut Schedule,
        layer: &Layer,
        (x, y): (&Tensor, &Tensor),
        part: Samples,
    ) {
        let (&[x_samples, inputs, h, w], &[y_samples, outputs, y_h, y_w]) = (x.shape(), y.shape()) else {
            panic!("pointwise: {:?} to {:?}", x.shape(), y.shape());
        };
        assert_eq!((y_h, y_w), (h, w));
        assert!(part.x_first + part.count <= x_samples && part.y_first + part.count <= y_samples);
        assert_eq!(layer.weight.shape(), [outputs / self.tile, inputs, self.tile]);
        assert_eq!((layer.bias.len(), w % 4, outputs % self.tile), (outputs, 0, 0));
        let quads = h * w / 4;
        let params = Params {
            inputs: size(inputs),
            quads: size(quads),
            outputs: size(outputs),
            x_first: size(part.x_first),
            y_first: size(part.y_first),
            pad: [0; 3],
        };
        let count = [quads.div_ceil(self.group), outputs / self.tile, part.count].map(size);
        schedule.dispatch(&self.kernel, &params, &[&layer.weight, &layer.bias, x, y], count);
    }
}

/// Which samples of input and output a dispatch takes.
#[derive(Clone, Copy, Debug)]
pub struct Samples {
    /// How many.
    pub count: usize,
    /// The first one of the input.
    pub x_first: usize,
    /// The first one of the output.
    pub y_first: usize,
}

/// Where the weight from input `input` to output `output` lies in the order of the kernels, [O / tile, I, tile].
pub fn index(output: usize, input: usize, (inputs, tile): (usize, usize)) -> usize {
    (output / tile * inputs + input) * tile + output % tile
}
