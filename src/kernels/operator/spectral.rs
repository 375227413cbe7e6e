//! Host side of `shaders/operator/spectral.wgsl`.

use crate::gpu::{AdapterKind, Context, Kernel, Schedule, Sharing, Source, Tensor, Unroll};
use crate::kernels::{Tuning, groups, size};
use crate::network::Config;
use crate::{Error, Result};

/// The WGSL.
pub const SOURCE: Source =
    Source { name: "spectral", wgsl: include_str!("../../../shaders/operator/spectral.wgsl"), common: &[] };

/// Samples that share one reading of the weights: the three components of a cloth.
const TILE: usize = 3;

/// Workgroups that keep a large device busy; with fewer, each sample has its own rather than share the weights.
const ENOUGH: usize = 128;

/// Rows of the inverse per invocation: few enough to share them out, enough to read a column's modes seldom.
const STRIP: usize = 8;

/// Channels of a workgroup.
const ACROSS: usize = 64;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    rows: u32,
    modes_w: u32,
    strip: u32,
}

/// Spectral convolution along the columns.
#[derive(Clone, Debug)]
pub struct Spectral {
    kernel: Kernel,
    /// Samples per workgroup.
    tile: usize,
    modes_h: usize,
    modes_w: usize,
    channels: usize,
    keep: bool,
    /// What is bound where the spectrum is not kept.
    nothing: Tensor,
}

/// What a spectral convolution reads and writes.
#[derive(Clone, Copy, Debug)]
pub struct SpectralTensors<'a> {
    /// Column transform, shape [H, modes_h, 2].
    pub table: &'a Tensor,
    /// Rows' spectra of the input, shape [S, H, 2 modes_w, C].
    pub r: &'a Tensor,
    /// Rows' spectra of the output, shape [S, H, 2 modes_w, C].
    pub inverse: &'a Tensor,
    /// Spectrum of the input, shape [S, modes_h, modes_w, C, 2]; given if and only if it is kept.
    pub spectrum: Option<&'a Tensor>,
}

impl Spectral {
    /// Compiles it for the modes and channels of a padded `config` and for `samples` samples, whose spectra it keeps or not.
    ///
    /// An error if the spectrum of a column does not fit the device's workgroup memory.
    pub fn new(
        context: &Context,
        tuning: &Tuning,
        config: &Config,
        samples: usize,
        keep: bool,
    ) -> Result<Self> {
        assert!(
            tuning.sharing == Sharing::Loads || tuning.spectral_teams == 1,
            "a subgroup shares operands within one team"
        );
        let Config { modes_h, modes_w, channels, .. } = *config;
        let complex = |tile: usize, channels: usize| tile * modes_h * channels;
        let bytes = |tile: usize| 8 * (complex(tile, channels) + complex(tile, ACROSS));
        let room = context.device.limits().max_compute_workgroup_storage_size as usize;
        if bytes(1) > room {
            return Err(Error::Device(format!(
                "{}: {modes_h} rows of modes of {channels} channels take {} bytes of workgroup memory, and it has {room}",
                context.name(),
                bytes(1)
            )));
        }
        let few = samples / TILE * modes_w * channels.div_ceil(ACROSS) < ENOUGH;
        let alone = !samples.is_multiple_of(TILE)
            || bytes(TILE) > room
            || (few && context.kind() == AdapterKind::Hardware);
        let tile = if alone { 1 } else { TILE };
        let constants = [
            ("KEEP", f64::from(u8::from(keep))),
            ("TEAMS", f64::from(tuning.spectral_teams)),
            ("INPUTS", complex(tile, channels) as f64),
            ("OUTPUTS", complex(tile, ACROSS) as f64),
        ];
        let unroll = Unroll { second: tile, ..tuning.unroll(modes_h) };
        let kernel = Kernel::new(context, &SOURCE, unroll, &constants)?;
        Ok(Self {
            kernel,
            tile,
            modes_h,
            modes_w,
            channels,
            keep,
            nothing: Tensor::zeros(context, "no spectrum", &[2])?,
        })
    }

    /// `weight` [modes, C, C, 2] (see [`by_mode`]).
    pub fn push(&self, schedule: &mut Schedule, weight: &Tensor, tensors: SpectralTensors<'_>) {
        let SpectralTensors { table, r, inverse, spectrum } = tensors;
        let &[samples, h, columns, channels] = r.shape() else { panic!("spectral: {:?}", r.shape()) };
        let modes_w = self.modes_w;
        assert_eq!((columns, channels), (2 * modes_w, self.channels));
        assert!(samples.is_multiple_of(self.tile), "{samples} samples in tiles of {}", self.tile);
        assert_eq!(spectrum.is_some(), self.keep);
        assert_eq!(inverse.shape(), r.shape());
        assert_eq!(table.shape(), [h, self.modes_h, 2]);
        assert_eq!(weight.shape(), [self.modes_h * modes_w, channels, channels, 2]);
        if let Some(spectrum) = spectrum {
            assert_eq!(spectrum.shape(), [samples, self.modes_h, modes_w, channels, 2]);
        }
        let params =
            Params { channels: size(channels), rows: size(h), modes_w: size(modes_w), strip: size(STRIP) };
        let tensors = [table, weight, r, inverse, spectrum.unwrap_or(&self.nothing)];
        let across = modes_w * groups(channels, ACROSS as u32) as usize;
        schedule.dispatch(&self.kernel, &params, &tensors, [size(across), size(samples / self.tile), 1]);
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
