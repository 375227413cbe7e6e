//! The position-wise half of a Fourier block: `y = K(x) + S x + bias`, fused with the inverse transform.

use super::padded;
use super::pointwise::{straight, transposed};
use super::transform::Transform;
use crate::cpu::matmul::{Start, Target, Term, product};
use crate::cpu::real::Real;
use crate::network::{self, Config};

/// The skip and the bias of a Fourier block.
pub(super) struct Skip<T> {
    /// Transposed weight of `S`, shape [C, C].
    weight: Vec<T>,
    bias: Vec<T>,
}

impl<T: Real> Skip<T> {
    pub fn new(config: &Config, block: &network::Block) -> Self {
        let (n, c) = (config.channels, padded(config.channels));
        let mut bias = vec![T::zero(); c];
        for (to, &from) in bias.iter_mut().zip(&block.bias) {
            *to = T::of(from as f64);
        }
        Self { weight: transposed(&block.skip, n, n, c), bias }
    }

    /// Builds the adjoint, for cotangents: `adj_x = S^T adj_y` plus the adjoint transform of the spectral
    /// product's cotangents.
    pub fn adjoint(config: &Config, block: &network::Block) -> Self {
        let c = config.channels;
        Self { weight: straight(&block.skip, c, c), bias: vec![T::zero(); padded(c)] }
    }

    /// Computes one row of the grid: `out` [W, C] from `x` [W, C] and the row spectrum `z` [modes_w, 2, C]
    /// that the inverse transform along the columns produced. The caller applies the GELU.
    pub fn row(&self, out: &mut [T], x: &[T], z: &[T], transform: &Transform<T>) {
        let c = self.bias.len();
        let skip = Term::new((x, c), (&self.weight, c), c);
        product(
            Target { rows: out.len() / c, out, stride: c, columns: c, start: Start::Row(&self.bias) },
            &[skip, transform.row_inverse(z)],
        );
    }
}
