//! Gradient descent with a fixed rate.

use super::Minimizer;
use crate::cpu::Real;

/// Gradient descent: `a <- a - rate g`.
pub struct GradientDescent {
    rate: f64,
}

impl GradientDescent {
    /// Builds gradient descent with this rate.
    pub fn new(rate: f64) -> Self {
        Self { rate }
    }
}

impl<T: Real> Minimizer<T> for GradientDescent {
    fn step(&mut self, grad: &[T], _norms: &[f64], a: &mut [T]) {
        let rate = T::of(self.rate);
        for (a, &g) in a.iter_mut().zip(grad) {
            *a = *a - rate * g;
        }
    }
}
