//! The full two-dimensional real Fourier transform of a batch, of any size: [`RealFft2`] and its passes.
//!
//! The quasi-Newton method uses it to invert the Hessian of a flat sheet
//! ([`crate::kernels::optim::QuasiNewton`]). The operator keeps few modes and has truncated transforms
//! instead ([`crate::kernels::operator`]).

pub mod join_spectra;
pub mod pack_pairs;
pub mod radix4;
pub mod radix_prime;
mod real_fft2;
pub mod split_spectra;
pub mod unpack_pairs;

pub use join_spectra::JoinSpectra;
pub use pack_pairs::PackPairs;
pub use radix_prime::RadixPrime;
pub use radix4::Radix4;
pub use real_fft2::{MAX_LENGTH, RealFft2};
pub use split_spectra::SplitSpectra;
pub use unpack_pairs::UnpackPairs;

use crate::gpu::Tensor;

/// The fields to transform: `batch` of them, each with `h` rows of `w` numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fields {
    /// Number of fields (B).
    pub batch: usize,
    /// Rows of a field (H).
    pub h: usize,
    /// Numbers in a row (W).
    pub w: usize,
}

impl Fields {
    /// Returns the number of complex rows, each of which packs two real rows: `ceil(H / 2)`.
    pub fn pairs(&self) -> usize {
        self.h.div_ceil(2)
    }

    /// Returns the number of columns of a half spectrum, `floor(W / 2) + 1`.
    pub fn half(&self) -> usize {
        self.w / 2 + 1
    }
}

/// One pass of a complex transform along the `length` axis of [batch, lines, length, inner].
#[derive(Clone, Copy, Debug)]
pub struct Pass {
    /// Number of items in the batch.
    pub batch: usize,
    /// Size of an item's axes before the transformed one.
    pub lines: usize,
    /// Length of the transforms.
    pub length: usize,
    /// Size of an item's axes after the transformed one.
    pub inner: usize,
    /// Product of the radices of the passes before this one.
    pub span: usize,
    /// Radix of this pass; `span * radix` divides `length`.
    pub radix: usize,
    /// Whether the exponent is positive.
    pub inverse: bool,
}

impl Pass {
    /// Returns the number of complex elements of one item of the batch.
    pub fn elements(&self) -> usize {
        self.lines * self.length * self.inner
    }

    fn sign(&self) -> f32 {
        if self.inverse { 1.0 } else { -1.0 }
    }

    fn check(&self, table: &Tensor, source: &Tensor, result: &Tensor) {
        assert!(self.length.is_multiple_of(self.span * self.radix), "{self:?}");
        assert_eq!(table.shape(), [self.length, 2]);
        let needed = 2 * self.batch * self.elements();
        assert!(source.len() >= needed && result.len() >= needed, "{self:?}");
    }
}
