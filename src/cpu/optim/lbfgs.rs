//! Limited-memory BFGS by the two-loop recursion, with step 1 and a history that is cleared every frame; from a multiple of
//! the identity, or from the Hessian at rest, with which it is the quasi-Newton method.

use super::{FactoredRestHessian, InverseHessian, Minimizer, RestHessian};
use crate::Result;
use crate::cpu::Real;
use crate::sim::Model;
use rayon::prelude::*;

/// L-BFGS for a batch of cloths, each with its own history.
pub struct Lbfgs<T> {
    cloths: Vec<History<T>>,
    curvature: f64,
    /// Unknowns of one cloth.
    len: usize,
}

/// What L-BFGS remembers of one cloth.
pub(in crate::cpu) struct History<T> {
    /// Pairs of step s and gradient difference y with `1 / (s . y)`; only `pairs` of them, the oldest first, count.
    ring: Vec<Pair<T>>,
    pairs: usize,
    pub last_grad: Vec<T>,
    pub last_step: Vec<T>,
    /// Whether `last_grad` and `last_step` are those of this frame.
    started: bool,
    pub direction: Vec<T>,
    /// The inverse Hessian without history; the identity, scaled by the newest pair, if there is none.
    initial: Option<Box<dyn InverseHessian<T>>>,
}

struct Pair<T> {
    s: Vec<T>,
    y: Vec<T>,
    inverse: f64,
}

impl<T: Real> Lbfgs<T> {
    /// L-BFGS for `batch` cloths of `len` unknowns each, with at most `history` pairs of `s . y > curvature`.
    pub fn new(history: usize, curvature: f64, len: usize, batch: usize) -> Self {
        Self { cloths: (0..batch).map(|_| History::new(history, len, None)).collect(), curvature, len }
    }

    /// The quasi-Newton method: the same for the cloths of `model`, from their Hessians at rest, which are `factored` or
    /// inverted by a cosine transform; an error when there is no memory for the factors.
    pub fn from_rest((history, curvature): (usize, f64), factored: bool, model: &Model) -> Result<Self> {
        let len = 3 * model.grid.particles();
        let initial = |cloth| -> Result<Box<dyn InverseHessian<T>>> {
            Ok(match factored {
                true => Box::new(FactoredRestHessian::new(model.grid, cloth)?),
                false => Box::new(RestHessian::new(model.grid, cloth)),
            })
        };
        let cloth = |cloth| Ok(History::new(history, len, Some(initial(cloth)?)));
        Ok(Self { cloths: model.cloths.iter().map(cloth).collect::<Result<_>>()?, curvature, len })
    }
}

impl<T: Real> Minimizer<T> for Lbfgs<T> {
    fn begin_frame(&mut self) {
        self.reset();
    }

    fn step(&mut self, grad: &[T], _norms: &[f64], a: &mut [T]) {
        let curvature = self.curvature;
        let batch = grad.par_chunks(self.len).zip(a.par_chunks_mut(self.len));
        self.cloths.par_iter_mut().zip(batch).for_each(|(history, (grad, a))| {
            if history.started {
                history.remember(grad, curvature);
            }
            history.turn(grad);
            for ((a, step), &d) in a.iter_mut().zip(&mut history.last_step).zip(&history.direction) {
                *step = -d;
                *a = *a - d;
            }
            history.last_grad.copy_from_slice(grad);
            history.started = true;
        });
    }

    fn reset(&mut self) {
        for history in &mut self.cloths {
            history.pairs = 0;
            history.started = false;
        }
    }
}

impl<T: Real> History<T> {
    /// An empty history of at most `pairs` pairs for `len` unknowns.
    pub fn new(pairs: usize, len: usize, initial: Option<Box<dyn InverseHessian<T>>>) -> Self {
        let zeros = || vec![T::zero(); len];
        let pair = |_| Pair { s: zeros(), y: zeros(), inverse: 0.0 };
        Self {
            ring: (0..pairs).map(pair).collect(),
            pairs: 0,
            last_grad: zeros(),
            last_step: zeros(),
            started: false,
            direction: zeros(),
            initial,
        }
    }

    /// Keeps the pair of the last step if its curvature suffices, in place of the oldest if the ring is full.
    pub fn remember(&mut self, grad: &[T], curvature: f64) {
        let product: f64 = (self.last_step.iter().zip(grad).zip(&self.last_grad))
            .map(|((&s, &g), &last)| s.f64() * (g - last).f64())
            .sum();
        if product.is_nan() || product <= curvature || self.ring.is_empty() {
            return;
        }
        if self.pairs == self.ring.len() {
            self.ring.rotate_left(1);
        } else {
            self.pairs += 1;
        }
        let pair = &mut self.ring[self.pairs - 1];
        pair.inverse = product.recip();
        pair.s.copy_from_slice(&self.last_step);
        for ((y, &g), &last) in pair.y.iter_mut().zip(grad).zip(&self.last_grad) {
            *y = g - last;
        }
    }

    /// Sets `direction` to the inverse Hessian of the history times `grad`.
    pub fn turn(&mut self, grad: &[T]) {
        let pairs = &self.ring[..self.pairs];
        let direction = &mut self.direction;
        direction.copy_from_slice(grad);
        let mut weights = vec![0.0; pairs.len()];
        for (pair, weight) in pairs.iter().zip(&mut weights).rev() {
            *weight = pair.inverse * dot(&pair.s, direction);
            add_scaled(direction, &pair.y, -*weight);
        }
        if let Some(initial) = &mut self.initial {
            initial.apply(direction);
        } else if let Some(newest) = pairs.last() {
            let gamma = T::of((newest.inverse * dot(&newest.y, &newest.y)).recip());
            direction.iter_mut().for_each(|d| *d = *d * gamma);
        }
        for (pair, weight) in pairs.iter().zip(&weights) {
            let correction = pair.inverse * dot(&pair.y, direction);
            add_scaled(direction, &pair.s, weight - correction);
        }
    }
}

pub(in crate::cpu) fn dot<T: Real>(u: &[T], w: &[T]) -> f64 {
    u.iter().zip(w).map(|(&u, &w)| u.f64() * w.f64()).sum()
}

fn add_scaled<T: Real>(to: &mut [T], u: &[T], factor: f64) {
    let factor = T::of(factor);
    for (to, &u) in to.iter_mut().zip(u) {
        *to = *to + factor * u;
    }
}
