//! Host side of `shaders/operator/spectral.wgsl`.

use crate::gpu::{Context, Kernel, Schedule, Source, Tensor, Tuning, Unroll};
use crate::kernels::{common, size};
use crate::{Error, Result};

pub(crate) const SOURCE: Source = Source {
    name: "spectral",
    wgsl: include_str!("../../../shaders/operator/spectral.wgsl"),
    appended: &[common::TEXEL],
};

/// Number of samples that share a read of the weights: the three components of a cloth.
const TILE: usize = 3;

/// Numbers of output channels that a workgroup may have, in descending order.
const OUT_CHANNELS: [usize; 4] = [64, 32, 16, 8];

/// Most workgroup memory with which sums are still divided \[bytes\]: beyond it, too few workgroups run on a
/// processor at once.
const DIVIDED_BYTES: usize = 32 << 10;

/// Most rows of the inverse per invocation: few enough to spread the work, enough that a column's modes are
/// seldom read.
const STRIP: usize = 8;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    rows: u32,
    modes_w: u32,
    strip: u32,
}

/// Sizes of a spectral convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpectralSize {
    /// Kept rows of modes.
    pub modes_h: usize,
    /// Kept columns of modes.
    pub modes_w: usize,
    /// Channels (C).
    pub channels: usize,
}

/// How the work is divided, see the WGSL.
#[derive(Clone, Copy, Debug)]
struct Division {
    /// Number of invocations per workgroup.
    lanes: usize,
    /// Number of samples per workgroup.
    tile: usize,
    /// Number of output channels per workgroup.
    out_channels: usize,
    /// Number of parts of every sum, however the work is divided: one per team.
    parts: usize,
    /// Parts that separate invocations sum: of the rows, then of the inputs. 1 if none do, otherwise `parts`.
    row_parts: usize,
    input_parts: usize,
}

impl Division {
    /// Chooses the largest workgroups that keep the adapter busy, and in them gives parts to separate
    /// invocations if there are invocations to spare. `None` if not even the smallest workgroup fits
    /// `capacity` bytes of memory.
    fn new(tuning: &Tuning, size: &SpectralSize, samples: usize, capacity: usize) -> Option<Self> {
        let parts = tuning.spectral_teams as usize;
        let tiles = [TILE, 1].into_iter().filter(|&tile| samples.is_multiple_of(tile));
        let all = tiles.flat_map(|tile| OUT_CHANNELS.map(|out_channels| (tile, out_channels)));
        let whole = |(tile, out_channels)| Self {
            lanes: 64 * parts,
            tile,
            out_channels,
            parts,
            row_parts: 1,
            input_parts: 1,
        };
        let fit: Vec<Self> = all.map(whole).filter(|division| division.bytes(size) <= capacity).collect();
        let busy = |d: &&Self| samples / d.tile * d.groups(size) >= tuning.busy_groups;
        let chosen = *fit.iter().find(busy).or(fit.last())?;
        let spare = |pieces: usize| if pieces < chosen.lanes { parts } else { 1 };
        let rows = spare(chosen.tile * size.channels);
        let inputs = spare(size.modes_h * chosen.out_channels);
        let divided = [(rows, inputs), (1, inputs), (rows, 1)];
        let divided = divided.map(|(row_parts, input_parts)| Self { row_parts, input_parts, ..chosen });
        let small = |division: &Self| division.bytes(size) <= capacity.min(DIVIDED_BYTES);
        Some(divided.into_iter().find(small).unwrap_or(chosen))
    }

    /// Returns the number of workgroups per tile of samples.
    fn groups(&self, size: &SpectralSize) -> usize {
        size.modes_w * size.channels.div_ceil(self.out_channels)
    }

    /// Returns how many complex numbers of the spectrum and of the products a workgroup holds.
    fn held(&self, size: &SpectralSize) -> [usize; 2] {
        let rows_of_modes = self.tile * size.modes_h;
        [rows_of_modes * size.channels * self.row_parts, rows_of_modes * self.out_channels * self.input_parts]
    }

    fn bytes(&self, size: &SpectralSize) -> usize {
        8 * self.held(size).iter().sum::<usize>()
    }

    /// Returns the number of consecutive rows of the inverse that an invocation computes.
    fn strip(&self, rows: usize) -> usize {
        (rows * self.tile * self.out_channels).div_ceil(self.lanes).clamp(1, STRIP)
    }
}

/// Spectral convolution along the columns.
#[derive(Clone, Debug)]
pub struct Spectral {
    kernel: Kernel,
    division: Division,
    size: SpectralSize,
    keep: bool,
    /// Bound in place of the spectrum if it is not kept.
    nothing: Tensor,
}

/// Inputs and outputs of a spectral convolution.
#[derive(Clone, Copy, Debug)]
pub struct SpectralTensors<'a> {
    /// Table of the column transform, shape [H, modes_h / 2 + 1, 2].
    pub table: &'a Tensor,
    /// Row spectra of the input, shape [S, H, 2 modes_w, C].
    pub r: &'a Tensor,
    /// Row spectra of the output, shape [S, H, 2 modes_w, C].
    pub inverse: &'a Tensor,
    /// Spectrum of the input, shape [S, modes_h, modes_w, C, 2]. Given if and only if it is kept.
    pub spectrum: Option<&'a Tensor>,
}

impl Spectral {
    /// Builds the kernel for these sizes and for `samples` samples, whose spectra are kept if `keep` is set.
    ///
    /// Fails if the spectrum of a column does not fit the device's workgroup memory.
    pub fn new(
        context: &Context,
        tuning: &Tuning,
        size: &SpectralSize,
        samples: usize,
        keep: bool,
    ) -> Result<Self> {
        let capacity = context.device.limits().max_compute_workgroup_storage_size as usize;
        let SpectralSize { modes_h, channels, .. } = *size;
        assert!(channels.is_multiple_of(16), "{channels} channels are not padded");
        let division = Division::new(tuning, size, samples, capacity).ok_or_else(|| {
            let least = 8 * modes_h * (channels + OUT_CHANNELS[OUT_CHANNELS.len() - 1]);
            Error::Device(format!(
                "{}: {modes_h} rows of modes with {channels} channels need {least} bytes of workgroup memory; the device has {capacity}",
                context.name()
            ))
        })?;
        let [inputs, outputs] = division.held(size).map(|n| n as f64);
        let constants = [
            ("KEEP", f64::from(u8::from(keep))),
            ("MODES", modes_h as f64),
            ("LANES", division.lanes as f64),
            ("OUT_CHANNELS", division.out_channels as f64),
            ("PARTS", division.parts as f64),
            ("ROW_PARTS", division.row_parts as f64),
            ("INPUT_PARTS", division.input_parts as f64),
            ("INPUTS", inputs),
            ("OUTPUTS", outputs),
        ];
        let texels = tuning.texels;
        let unroll = Unroll { second: division.tile, texels, ..tuning.unroll(modes_h / 2 + 1) };
        let kernel = Kernel::new(context, &SOURCE, unroll, &constants)?;
        let nothing = Tensor::zeros(context, "no spectrum", &[2])?;
        Ok(Self { kernel, division, size: *size, keep, nothing })
    }

    /// Convolves `tensors` with `weight` [modes, C / 2, C, 4] (see [`index`]), in texels if the kernel was
    /// built with [`Tuning::texels`]. So is the table.
    pub fn push(&self, schedule: &mut Schedule, weight: &Tensor, tensors: SpectralTensors<'_>) {
        let SpectralTensors { table, r, inverse, spectrum } = tensors;
        let &[samples, h, columns, c] = r.shape() else { panic!("spectral: {:?}", r.shape()) };
        let (division, SpectralSize { channels, modes_h, modes_w }) = (self.division, self.size);
        assert_eq!((columns, c), (2 * modes_w, channels));
        assert!(samples.is_multiple_of(division.tile), "{samples} samples in tiles of {}", division.tile);
        assert_eq!(spectrum.is_some(), self.keep);
        assert_eq!(inverse.shape(), r.shape());
        assert_eq!(table.shape(), [h, modes_h / 2 + 1, 2]);
        assert_eq!(weight.shape(), [modes_h * modes_w, channels / 2, channels, 4]);
        if let Some(spectrum) = spectrum {
            assert_eq!(spectrum.shape(), [samples, modes_h, modes_w, channels, 2]);
        }
        let strip = size(division.strip(h));
        let params = Params { channels: size(channels), rows: size(h), modes_w: size(modes_w), strip };
        let tensors = [table, weight, r, inverse, spectrum.unwrap_or(&self.nothing)];
        let count = [size(division.groups(&self.size)), size(samples / division.tile), 1];
        schedule.dispatch(&self.kernel, &params, &tensors, count);
    }
}

/// Returns the index of the real part of the weight of `mode` from input `i` to output `o` in the order of
/// the kernel, [modes, I / 2, O, 4]: an output's weights of two inputs, each real and imaginary.
pub fn index(mode: usize, (i, o): (usize, usize), (inputs, outputs): (usize, usize)) -> usize {
    4 * ((mode * inputs / 2 + i / 2) * outputs + o) + 2 * (i % 2)
}
