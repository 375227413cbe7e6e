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
    x_plane: u32,
    y_plane: u32,
    x_first: u32,
    y_first: u32,
    pad: u32,
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
        self.push_samples(schedule, layer, (x, y), all);
    }

    /// The same for some of the samples of `x` and `y`.
    pub fn push_samples(
        &self,
        schedule: &mut Schedule,
        layer: &Layer,
        (x, y): (&Tensor, &Tensor),
        samples: Samples,
    ) {
        let rows = Rows { count: x.shape()[2], x_first: 0, y_first: 0 };
        self.push_rows(schedule, layer, (x, y), (samples, rows));
    }

    /// The same for some of their rows, of which `x` and `y` may have other numbers.
    pub fn push_rows(
        &self,
        schedule: &mut Schedule,
        layer: &Layer,
        (x, y): (&Tensor, &Tensor),
        (samples, rows): (Samples, Rows),
    ) {
        let (&[x_samples, inputs, x_h, w], &[y_samples, outputs, y_h, y_w]) = (x.shape(), y.shape()) else {
            panic!("pointwise: {:?} to {:?}", x.shape(), y.shape());
        };
        assert_eq!(y_w, w);
        assert!(samples.x_first + samples.count <= x_samples && samples.y_first + samples.count <= y_samples);
        assert!(rows.x_first + rows.count <= x_h && rows.y_first + rows.count <= y_h);
        assert_eq!(layer.weight.shape(), [outputs / self.tile, inputs, self.tile]);
        assert_eq!((layer.bias.len(), w % 4, outputs % self.tile), (outputs, 0, 0));
        let first = |sample: usize, channels: usize, (row, h): (usize, usize)| {
            size((sample * channels * h + row) * w / 4)
        };
        let quads = rows.count * w / 4;
        let params = Params {
            inputs: size(inputs),
            outputs: size(outputs),
            quads: size(quads),
            x_plane: size(x_h * w / 4),
            y_plane: size(y_h * w / 4),
            x_first: first(samples.x_first, inputs, (rows.x_first, x_h)),
            y_first: first(samples.y_first, outputs, (rows.y_first, y_h)),
            pad: 0,
        };
        let count = [quads.div_ceil(self.group), outputs / self.tile, samples.count].map(size);
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

/// Which rows of these samples.
#[derive(Clone, Copy, Debug)]
pub struct Rows {
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
