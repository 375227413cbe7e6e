//! Adam with bias correction, restarted every frame.

use super::Minimizer;
use crate::cpu::Real;

/// `a <- a - rate m / (sqrt(v) + epsilon)` with the corrected moments m and v of the frame's gradients.
pub struct Adam<T> {
    rate: f64,
    beta1: f64,
    beta2: f64,
    epsilon: f64,
    mean: Vec<T>,
    square: Vec<T>,
    /// Steps taken in this frame.
    steps: i32,
}

impl<T: Real> Adam<T> {
    /// Adam for `len` unknowns with `[rate, beta1, beta2, epsilon]`.
    pub fn new([rate, beta1, beta2, epsilon]: [f64; 4], len: usize) -> Self {
        let zeros = || vec![T::zero(); len];
        Self { rate, beta1, beta2, epsilon, mean: zeros(), square: zeros(), steps: 0 }
    }
}

impl<T: Real> Minimizer<T> for Adam<T> {
    fn begin_frame(&mut self) {
        self.reset();
    }

    fn step(&mut self, grad: &[T], _norms: &[f64], a: &mut [T]) {
        self.steps += 1;
        let (beta1, beta2) = (T::of(self.beta1), T::of(self.beta2));
        let rate = T::of(self.rate / (1.0 - self.beta1.powi(self.steps)));
        let root = T::of((1.0 - self.beta2.powi(self.steps)).sqrt().recip());
        let epsilon = T::of(self.epsilon);
        let moments = self.mean.iter_mut().zip(&mut self.square);
        for ((a, &g), (mean, square)) in a.iter_mut().zip(grad).zip(moments) {
            *mean = beta1 * *mean + (T::one() - beta1) * g;
            *square = beta2 * *square + (T::one() - beta2) * g * g;
            *a = *a - rate * *mean / (root * square.sqrt() + epsilon);
        }
    }

    fn reset(&mut self) {
        self.mean.fill(T::zero());
        self.square.fill(T::zero());
        self.steps = 0;
    }
}
