//! How a device stores the network's activations and weights.

/// How the network's activations and weights are stored on a device. Sums, norms, spectra and everything
/// outside the network are in single precision regardless.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Storage {
    /// 32-bit floating point.
    #[default]
    F32,
    /// 16-bit floating point ([`wgpu::Features::SHADER_F16`]), which halves the size and the memory traffic
    /// of activations and weights. For inference only: training is in single precision on every context.
    F16,
}

impl Storage {
    /// Returns the size of a number in bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F16 => 2,
        }
    }

    /// Returns the format of texels with four numbers.
    pub(super) fn texels(self) -> wgpu::TextureFormat {
        match self {
            Self::F32 => wgpu::TextureFormat::Rgba32Float,
            Self::F16 => wgpu::TextureFormat::Rgba16Float,
        }
    }

    /// Returns the type's name in WGSL, `f32` or `f16`.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
        }
    }
}
