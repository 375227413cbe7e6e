//! Host side of `shaders/operator/spectral.wgsl`.

use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{Tuning, groups, size};

/// The WGSL.
pub const SOURCE: Source =
    Source { name: "spectral", wgsl: include_str!("../../../shaders/operator/spectral.wgsl"), common: &[] };

/// Samples that share one reading of the weights: the three components of a cloth.
const TILE: usize = 3;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    inputs: u32,
    outputs: u32,
    modes: u32,
    pad: u32,
}

/// Channel product of each kept mode.
#[derive(Clone, Debug)]
pub struct Spectral {
    tiled: Kernel,
    single: Kernel,
}

impl Spectral {
    /// Compiles it.
    pub fn new(context: &Context, tuning: &Tuning) -> Result<Self> {
        let tiled = Kernel::new(context, &SOURCE, tuning.unroll(TILE), &[])?;
        Ok(Self { tiled, single: Kernel::new(context, &SOURCE, tuning.unroll(1), &[])? })
    }

    /// `weight` [modes, I, O, 2] (see [`by_mode`]), `x` and `y` [S, modes_h, modes_w, C, 2].
    pub fn push(&self, schedule: &mut Schedule, weight: &Tensor, x: &Tensor, y: &Tensor) {
        let (&[samples, mh, mw, inputs, 2], &[_, _, _, outputs, 2]) = (x.shape(), y.shape()) else {
            panic!("spectral: {:?} to {:?}", x.shape(), y.shape());
        };
        assert_eq!(y.shape(), [samples, mh, mw, outputs, 2]);
        assert_eq!(weight.shape(), [mh * mw, inputs, outputs, 2]);
        let modes = mh * mw;
        let params = Params { inputs: size(inputs), outputs: size(outputs), modes: size(modes), pad: 0 };
        let (kernel, tile) = if samples % TILE == 0 { (&self.tiled, TILE) } else { (&self.single, 1) };
        let count = [groups(outputs, 64), size(modes), size(samples / tile)];
        schedule.dispatch(kernel, &params, &[weight, x, y], count);
    }
}

/// Where the real part of the weight of `mode` from input `i` to output `o` lies in the order of the kernel,
/// [modes, I, O, 2].
pub fn index(mode: usize, (i, o): (usize, usize), (inputs, outputs): (usize, usize)) -> usize {
    2 * ((mode * inputs + i) * outputs + o)
}

/// A checkpoint's spectral weight [I, O, modes, 2] in the order of the kernel.
pub fn by_mode(weight: &[f32], inputs: usize, outputs: usize) -> Vec<f32> {
    let modes = weight.len() / (2 * inputs * outputs);
    let mut ordered = vec![0.0; weight.len()];
    for (k, pair) in weight.chunks_exact(2).enumerate() {
        let (io, mode) = (k / modes, k % modes);
        let at = index(mode, (io / outputs, io % outputs), (inputs, outputs));
        ordered[at..at + 2].copy_from_slice(pair);
    }
    ordered
}
