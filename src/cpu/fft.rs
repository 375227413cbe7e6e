//! Full two-dimensional real Fourier transforms by a library: the reference for the operator's truncated
//! transform.

use super::Real;
use crate::cloth::Grid;
use crate::settings::Norm;
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::sync::Arc;

/// Transforms between fields [.., H, W] and their half spectra [.., H, W/2 + 1], whose first row is k_h = 0.
pub struct Fft2<T: Real> {
    grid: Grid,
    norm: Norm,
    row_forward: Arc<dyn RealToComplex<T>>,
    row_inverse: Arc<dyn ComplexToReal<T>>,
    column: Arc<dyn RealToComplex<T>>,
}

impl<T: Real> Fft2<T> {
    /// Plans the transforms on a grid.
    pub fn new(grid: Grid, norm: Norm) -> Self {
        let mut planner = RealFftPlanner::new();
        Self {
            grid,
            norm,
            row_forward: planner.plan_fft_forward(grid.w),
            row_inverse: planner.plan_fft_inverse(grid.w),
            column: planner.plan_fft_forward(grid.h),
        }
    }

    /// Returns the number of columns of a half spectrum, `W/2 + 1`.
    pub fn columns(&self) -> usize {
        self.grid.w / 2 + 1
    }

    /// Returns the half spectra of a batch of fields, shape [.., H, W].
    pub fn forward(&self, fields: &[T]) -> Vec<Complex<T>> {
        let factor = self.factor(Norm::Forward);
        let mut spectra = Vec::with_capacity(fields.len() / self.grid.w * self.columns());
        for row in fields.chunks_exact(self.grid.w) {
            let mut row = row.to_vec();
            let mut spectrum = self.row_forward.make_output_vec();
            self.row_forward.process(&mut row, &mut spectrum).expect("the lengths are those of the plan");
            spectra.extend(spectrum.iter().map(|z| z * factor));
        }
        self.along_columns(&mut spectra);
        spectra
    }

    /// Returns the fields of a batch of half spectra, shape [.., H, W/2 + 1]. Only the Hermitian part of
    /// columns that are their own conjugates counts.
    pub fn inverse(&self, spectra: &[Complex<T>]) -> Vec<T> {
        let factor = self.factor(Norm::Backward);
        // The inverse is the forward transform between two conjugations.
        let mut spectra: Vec<_> = spectra.iter().map(|z| z.conj()).collect();
        self.along_columns(&mut spectra);
        let mut fields = Vec::with_capacity(spectra.len() / self.columns() * self.grid.w);
        for row in spectra.chunks_exact(self.columns()) {
            let mut row: Vec<_> = row.iter().map(|z| z.conj() * factor).collect();
            let mut field = self.row_inverse.make_output_vec();
            row[0].im = T::zero();
            if self.grid.w.is_multiple_of(2) {
                row[self.grid.w / 2].im = T::zero();
            }
            self.row_inverse.process(&mut row, &mut field).expect("the lengths are those of the plan");
            fields.extend(field);
        }
        fields
    }

    fn factor(&self, direction: Norm) -> T {
        if self.norm == direction { T::of(1.0 / self.grid.particles() as f64) } else { T::one() }
    }

    /// Applies the complex transform to every column, composed of the real transforms of its real and
    /// imaginary parts.
    fn along_columns(&self, spectra: &mut [Complex<T>]) {
        let (h, columns) = (self.grid.h, self.columns());
        let transform = |mut part: Vec<T>| {
            let mut spectrum = self.column.make_output_vec();
            self.column.process(&mut part, &mut spectrum).expect("the lengths are those of the plan");
            move |k: usize| if k < spectrum.len() { spectrum[k] } else { spectrum[h - k].conj() }
        };
        for spectrum in spectra.chunks_exact_mut(h * columns) {
            for c in 0..columns {
                let column = spectrum.iter().skip(c).step_by(columns);
                let re = transform(column.clone().map(|z| z.re).collect());
                let im = transform(column.map(|z| z.im).collect());
                for k in 0..h {
                    spectrum[k * columns + c] = re(k) + im(k) * Complex::i();
                }
            }
        }
    }
}
