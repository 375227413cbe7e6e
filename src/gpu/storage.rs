//! How a device stores what the network computes with.

/// How activations and weights of the network are stored on a device. Sums, norms, spectra and everything outside the network
/// are in single precision whatever the storage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Storage {
    /// 32-bit floating point.
    #[default]
    F32,
    /// 16-bit floating point ([`wgpu::Features::SHADER_F16`]): half the memory and traffic of
    /// activations and weights. For inference: training is in single precision on every context.
    F16,
}

impl Storage {
    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F16 => 2,
        }
    }

    /// `f32` or `f16`, as WGSL has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
        }
    }
}
