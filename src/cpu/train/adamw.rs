//! AdamW (Loshchilov and Hutter 2019) with gradient clipping by norm, on one flat vector of weights.

use crate::cpu::Real;
use rayon::prelude::*;

/// Number of weights per task.
const CHUNK: usize = 1 << 14;

/// Settings of AdamW on any device.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct AdamWSettings {
    /// Decay rates of the means of the gradient and of its square.
    pub betas: [f64; 2],
    /// Added to the denominator.
    pub epsilon: f64,
    /// Weight decay, multiplied by the learning rate and decoupled from the gradient.
    pub weight_decay: f64,
    /// Norm to which longer gradients are clipped.
    pub clip: f64,
}

/// The factors of one update of each weight: `g <- clip g`, the means of g and g^2 are updated, then
/// `w <- decay w - step_size mean / (sqrt(square) / sqrt_correction + epsilon)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamWFactors {
    /// Factor applied to the gradient.
    pub clip: f64,
    /// Factor applied to the weights.
    pub decay: f64,
    /// The learning rate over the bias correction of the mean gradient.
    pub step_size: f64,
    /// Square root of the bias correction of the mean squared gradient.
    pub sqrt_correction: f64,
}

impl Default for AdamWSettings {
    /// Returns the authors' settings: decay rates 0.9 and 0.999, weight decay 0.01, gradients clipped to 1.
    fn default() -> Self {
        Self { betas: [0.9, 0.999], epsilon: 1e-8, weight_decay: 0.01, clip: 1.0 }
    }
}

impl AdamWSettings {
    /// Returns the factors of update number `number`, counted from 1, for a gradient of this norm.
    pub fn factors(&self, norm: f64, number: u64, rate: f64) -> AdamWFactors {
        let number = i32::try_from(number).unwrap_or(i32::MAX);
        let [first, second] = self.betas.map(|beta| 1.0 - beta.powi(number));
        AdamWFactors {
            // The small constant is PyTorch's.
            clip: (self.clip / (norm + 1e-6)).min(1.0),
            decay: 1.0 - rate * self.weight_decay,
            step_size: rate / first,
            sqrt_correction: second.sqrt(),
        }
    }
}

/// AdamW with its moments.
#[derive(Clone, Debug)]
pub struct AdamW<T> {
    /// The settings.
    pub settings: AdamWSettings,
    /// Mean gradient, as long as the weights.
    pub mean: Vec<T>,
    /// Mean squared gradient, as long as the weights.
    pub square: Vec<T>,
}

impl<T: Real> AdamW<T> {
    /// Builds AdamW with zero moments for this many weights.
    pub fn new(settings: AdamWSettings, weights: usize) -> Self {
        let zeros = || vec![T::zero(); weights];
        Self { settings, mean: zeros(), square: zeros() }
    }

    /// Returns the norm of a gradient, independent of the number of threads.
    pub fn norm(gradient: &[T]) -> f64 {
        let square = |g: &[T]| g.iter().map(|g| g.f64() * g.f64()).sum::<f64>();
        gradient.par_chunks(CHUNK).map(square).collect::<Vec<f64>>().iter().sum::<f64>().sqrt()
    }

    /// Applies update number `number`, counted from 1, to `weights`, given the gradient and its norm.
    pub fn step(&mut self, weights: &mut [T], (gradient, norm): (&[T], f64), number: u64, rate: f64) {
        let AdamWSettings { betas, epsilon, .. } = self.settings;
        let AdamWFactors { clip, decay, step_size, sqrt_correction } =
            self.settings.factors(norm, number, rate);
        let [clip, decay, step_size, sqrt_correction, epsilon] =
            [clip, decay, step_size, sqrt_correction, epsilon].map(T::of);
        let [keep1, keep2] = betas.map(T::of);
        let [add1, add2] = betas.map(|beta| T::of(1.0 - beta));
        let memory = self.mean.par_chunks_mut(CHUNK).zip(self.square.par_chunks_mut(CHUNK));
        let all = weights.par_chunks_mut(CHUNK).zip(gradient.par_chunks(CHUNK)).zip(memory);
        all.for_each(|((weights, gradient), (mean, square))| {
            let memory = mean.iter_mut().zip(square);
            for ((weight, &gradient), (mean, square)) in weights.iter_mut().zip(gradient).zip(memory) {
                let gradient = gradient * clip;
                *mean = *mean * keep1 + gradient * add1;
                *square = *square * keep2 + gradient * gradient * add2;
                *weight = *weight * decay - step_size * *mean / (square.sqrt() / sqrt_correction + epsilon);
            }
        });
    }
}
