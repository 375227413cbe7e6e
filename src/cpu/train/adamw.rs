//! AdamW (Loshchilov and Hutter 2019) with the gradient clipped to a norm, on one flat vector of weights.

use crate::cpu::Real;
use rayon::prelude::*;

/// Numbers that one task updates.
const CHUNK: usize = 1 << 14;

/// Settings of AdamW, on any device.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct AdamWSettings {
    /// Decays of the means of the gradient and of its square.
    pub betas: [f64; 2],
    /// Added to the denominator.
    pub epsilon: f64,
    /// Weight decay, times the rate and apart from the gradient.
    pub weight_decay: f64,
    /// Largest norm of a gradient; a longer one is shortened.
    pub clip: f64,
}

/// What an update does to each weight: `g <- shorten g`, the means of g and g^2, `w <- shrink w - pace mean / (sqrt(square) /
/// root + epsilon)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamWFactors {
    /// What the gradient is multiplied by.
    pub shorten: f64,
    /// What the weights are multiplied by.
    pub shrink: f64,
    /// The rate over the correction of the mean gradient.
    pub pace: f64,
    /// Square root of the correction of the mean squared gradient.
    pub root: f64,
}

impl Default for AdamWSettings {
    /// The paper's: decays 0.9 and 0.999, weight decay 0.01, gradients clipped to 1.
    fn default() -> Self {
        Self { betas: [0.9, 0.999], epsilon: 1e-8, weight_decay: 0.01, clip: 1.0 }
    }
}

impl AdamWSettings {
    /// Update number `number`, from 1 on, with a gradient of this norm.
    pub fn factors(&self, norm: f64, number: u64, rate: f64) -> AdamWFactors {
        let number = i32::try_from(number).unwrap_or(i32::MAX);
        let [first, second] = self.betas.map(|beta| 1.0 - beta.powi(number));
        AdamWFactors {
            // The small number is PyTorch's.
            shorten: (self.clip / (norm + 1e-6)).min(1.0),
            shrink: 1.0 - rate * self.weight_decay,
            pace: rate / first,
            root: second.sqrt(),
        }
    }
}

/// AdamW with its memory.
#[derive(Clone, Debug)]
pub struct AdamW<T> {
    /// Settings.
    pub settings: AdamWSettings,
    /// Mean gradient, as long as the weights.
    pub mean: Vec<T>,
    /// Mean squared gradient, as long as the weights.
    pub square: Vec<T>,
}

impl<T: Real> AdamW<T> {
    /// With a fresh memory for this many weights.
    pub fn new(settings: AdamWSettings, weights: usize) -> Self {
        let zeros = || vec![T::zero(); weights];
        Self { settings, mean: zeros(), square: zeros() }
    }

    /// The norm of a gradient, the same whatever the number of threads.
    pub fn norm(gradient: &[T]) -> f64 {
        let square = |g: &[T]| g.iter().map(|g| g.f64() * g.f64()).sum::<f64>();
        gradient.par_chunks(CHUNK).map(square).collect::<Vec<f64>>().iter().sum::<f64>().sqrt()
    }

    /// Moves `weights` by update number `number`, from 1 on, given the gradient and its norm.
    pub fn step(&mut self, weights: &mut [T], (gradient, norm): (&[T], f64), number: u64, rate: f64) {
        let AdamWSettings { betas, epsilon, .. } = self.settings;
        let AdamWFactors { shorten, shrink, pace, root } = self.settings.factors(norm, number, rate);
        let [shorten, shrink, pace, root, epsilon] = [shorten, shrink, pace, root, epsilon].map(T::of);
        let [keep1, keep2] = betas.map(T::of);
        let [add1, add2] = betas.map(|beta| T::of(1.0 - beta));
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
