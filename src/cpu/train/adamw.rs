//! AdamW (Loshchilov and Hutter 2019) with the gradient clipped to a norm, on one flat vector of weights.

use crate::cpu::Real;
use rayon::prelude::*;

/// Numbers that one task updates.
const CHUNK: usize = 1 << 14;

/// Settings and memory of AdamW.
#[derive(Clone, Debug)]
pub struct AdamW<T> {
    /// Decay of the mean gradient.
    pub beta1: f64,
    /// Decay of the mean squared gradient.
    pub beta2: f64,
    /// Added to the denominator.
    pub epsilon: f64,
    /// Weight decay, times the rate and apart from the gradient.
    pub decay: f64,
    /// Largest norm of a gradient; a longer one is shortened.
    pub clip: f64,
    /// Mean gradient, as long as the weights.
    pub mean: Vec<T>,
    /// Mean squared gradient, as long as the weights.
    pub square: Vec<T>,
}

impl<T: Real> AdamW<T> {
    /// The paper's settings for this many weights: decays 0.9 and 0.999, weight decay 0.01, gradients clipped to 1.
    pub fn new(weights: usize) -> Self {
        let zeros = || vec![T::zero(); weights];
        let (mean, square) = (zeros(), zeros());
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8, decay: 0.01, clip: 1.0, mean, square }
    }

    /// The norm of a gradient, the same whatever the number of threads.
    pub fn norm(gradient: &[T]) -> f64 {
        let square = |g: &[T]| g.iter().map(|g| g.f64() * g.f64()).sum::<f64>();
        gradient.par_chunks(CHUNK).map(square).collect::<Vec<f64>>().iter().sum::<f64>().sqrt()
    }

    /// Moves `weights` by update number `number`, from 1 on, given the gradient and its norm.
    pub fn step(&mut self, weights: &mut [T], (gradient, norm): (&[T], f64), number: u64, rate: f64) {
        let number = i32::try_from(number).unwrap_or(i32::MAX);
        let correction1 = 1.0 - self.beta1.powi(number);
        let correction2 = 1.0 - self.beta2.powi(number);
        // The small number is PyTorch's.
        let shorten = T::of((self.clip / (norm + 1e-6)).min(1.0));
        let [keep1, keep2] = [self.beta1, self.beta2].map(T::of);
        let [add1, add2] = [1.0 - self.beta1, 1.0 - self.beta2].map(T::of);
        let shrink = T::of(1.0 - rate * self.decay);
        let (pace, epsilon) = (T::of(rate / correction1), T::of(self.epsilon));
        let root = T::of(correction2.sqrt());
        let memory = self.mean.par_chunks_mut(CHUNK).zip(self.square.par_chunks_mut(CHUNK));
        let all = weights.par_chunks_mut(CHUNK).zip(gradient.par_chunks(CHUNK)).zip(memory);
        all.for_each(|((weights, gradient), (mean, square))| {
            let memory = mean.iter_mut().zip(square);
            for ((weight, &gradient), (mean, square)) in weights.iter_mut().zip(gradient).zip(memory) {
                let gradient = gradient * shorten;
                *mean = *mean * keep1 + gradient * add1;
                *square = *square * keep2 + gradient * gradient * add2;
                *weight = *weight * shrink - pace * *mean / (square.sqrt() / root + epsilon);
            }
        });
    }
}
